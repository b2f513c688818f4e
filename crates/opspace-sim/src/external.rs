//! External forces, applied by a program to a frame of the robot while it runs.
//!
//! A force is set through a [`ExternalForceHandle`], read once per interface cycle and held until the next one. Rows of
//! the channel `external` hold all of it, so that a simulation can be repeated from its log.

use nalgebra::Vector3;
use opspace_backend::{Layout, Row, Signal};
use opspace_model::{Force, FrameId, Model};
use std::cell::Cell;
use std::rc::Rc;

/// A force on the origin of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExternalForce {
    /// The frame.
    pub frame: FrameId,
    /// The force on it.
    pub pull: Pull,
}

/// The kind of an external force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pull {
    /// A spring to a point and a damper: `F = K (x_target − x) − B ẋ`.
    Spring {
        /// The point, world axes, m.
        target_m: Vector3<f64>,
        /// K, N/m.
        stiffness_n_per_m: f64,
        /// B, Ns/m.
        damping_ns_per_m: f64,
    },
    /// A constant force and moment, world axes (N, Nm).
    Wrench(Force),
}

impl Pull {
    /// Force and moment on a frame at `x` (m) that moves at `v` (m/s), world axes (N, Nm).
    #[must_use]
    pub fn wrench(&self, x: &Vector3<f64>, v: &Vector3<f64>) -> Force {
        match self {
            Self::Spring { target_m, stiffness_n_per_m, damping_ns_per_m } => Force {
                linear: (target_m - x) * *stiffness_n_per_m - v * *damping_ns_per_m,
                angular: Vector3::zeros(),
            },
            Self::Wrench(wrench) => *wrench,
        }
    }
}

/// Sets the external force on one arm. Clones set the same force.
#[derive(Clone, Debug, Default)]
pub struct ExternalForceHandle(Rc<Cell<Option<ExternalForce>>>);

impl ExternalForceHandle {
    /// Sets the force from the next interface cycle on.
    pub fn apply(&self, frame: FrameId, pull: Pull) {
        self.0.set(Some(ExternalForce { frame, pull }));
    }

    /// Removes the force from the next interface cycle on.
    pub fn release(&self) {
        self.0.set(None);
    }

    /// Sets the force, or removes it, from the next interface cycle on.
    pub fn set(&self, force: Option<ExternalForce>) {
        self.0.set(force);
    }

    /// The force that is set.
    #[must_use]
    pub fn get(&self) -> Option<ExternalForce> {
        self.0.get()
    }
}

/// Width of a row.
const WIDTH: usize = 16;

/// The layout of the channel `external`.
#[must_use]
pub fn layout() -> Layout {
    let axes = ["x", "y", "z"];
    let signals = vec![
        Signal::new("pull", "1", &["0 none, 1 spring, 2 wrench"]),
        Signal::new("frame", "1", &["index in the model"]),
        Signal::new("target", "m", &axes),
        Signal::new("stiffness", "N/m", &["value"]),
        Signal::new("damping", "Ns/m", &["value"]),
        Signal::new("wrench", "N,Nm", &["fx", "fy", "fz", "mx", "my", "mz"]),
        Signal::new("force", "N", &axes),
    ];
    Layout { channel: "external".to_owned(), signals }
}

/// The external force of a row of the channel `external`; `None` where none was set, or if the row is of another model.
#[must_use]
pub fn decode(row: &[f64], model: &Model) -> Option<ExternalForce> {
    let [pull, frame, tx, ty, tz, stiffness, damping, fx, fy, fz, mx, my, mz, ..] = *row else {
        return None;
    };
    let pull = match pull {
        1.0 => Pull::Spring {
            target_m: Vector3::new(tx, ty, tz),
            stiffness_n_per_m: stiffness,
            damping_ns_per_m: damping,
        },
        2.0 => Pull::Wrench(Force { linear: Vector3::new(fx, fy, fz), angular: Vector3::new(mx, my, mz) }),
        _ => return None,
    };
    let frame = model.frames().get(frame as usize)?;
    Some(ExternalForce { frame: model.frame_id(&frame.name).ok()?, pull })
}

/// Rows of the channel `external` of one arm.
#[derive(Clone, Debug)]
pub(crate) struct ExternalRows {
    /// All frames of the model, in its order.
    frames: Vec<FrameId>,
    values: Vec<f64>,
}

impl ExternalRows {
    /// No rows, with room for `capacity`.
    pub fn new(model: &Model, capacity: usize) -> Self {
        let frames = model.frames().iter().filter_map(|frame| model.frame_id(&frame.name).ok()).collect();
        Self { frames, values: Vec::with_capacity(capacity * WIDTH) }
    }

    pub fn clear(&mut self) {
        self.values.clear();
    }

    /// Adds a row: the force that is set from this cycle on, and the force (N) that acted in the last step before it.
    pub fn push(&mut self, set: Option<&ExternalForce>, acting: &Vector3<f64>) {
        let begin = self.values.len();
        self.values.resize(begin + WIDTH, f64::NAN);
        let mut row = Row::new(&mut self.values[begin..]);
        row.put_one(match set.map(|force| force.pull) {
            None => 0.0,
            Some(Pull::Spring { .. }) => 1.0,
            Some(Pull::Wrench(_)) => 2.0,
        });
        let index = set.and_then(|force| self.frames.iter().position(|frame| *frame == force.frame));
        row.put_one(index.map_or(f64::NAN, |index| index as f64));
        match set.map(|force| force.pull) {
            None => row.skip(11),
            Some(Pull::Spring { target_m, stiffness_n_per_m, damping_ns_per_m }) => {
                row.put(target_m.as_slice());
                row.put(&[stiffness_n_per_m, damping_ns_per_m]);
                row.skip(6);
            }
            Some(Pull::Wrench(wrench)) => {
                row.skip(5);
                row.put(wrench.linear.as_slice());
                row.put(wrench.angular.as_slice());
            }
        }
        row.put(acting.as_slice());
    }

    /// The rows, in the order of time.
    pub fn iter(&self) -> impl Iterator<Item = &[f64]> {
        self.values.chunks_exact(WIDTH)
    }
}
