//! External forces that a program applies to a frame of the robot during a simulation.
//!
//! A force is set through an [`ExternalForceHandle`], read once per interface cycle and held until the next one. The
//! rows of the channel `external` record it completely, so that a simulation can be repeated from its log.

use nalgebra::Vector3;
use opspace_backend::signal_names::EXTERNAL_CHANNEL;
use opspace_backend::{Layout, SignalRecorder};
use opspace_model::{Force, FrameId, Model, Motion, Placement};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::vec::IntoIter;

/// Force on a frame: on its origin, or on a point that is fixed in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExternalForce {
    /// Frame on which it acts.
    pub frame: FrameId,
    /// Force, or force and moment.
    pub pull: Pull,
}

/// Kind and parameters of an external force.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Pull {
    /// Spring to a target point, and damper: `F = K (x_target − x) − B ẋ`.
    Spring {
        /// Target point, world axes, m.
        target_m: Vector3<f64>,
        /// Stiffness K, N/m.
        stiffness_n_per_m: f64,
        /// Damping B, Ns/m.
        damping_ns_per_m: f64,
    },
    /// Constant force and moment, world axes (N, Nm).
    Wrench(Force),
    /// Spring from a point of the frame to a target point, and damper, as a hand that drags the point: `F = K (x_target − x) − B ẋ`,
    /// shortened to the largest force.
    Drag {
        /// Point that is dragged, fixed in the frame, m.
        point_m: Vector3<f64>,
        /// Target point, world axes, m.
        target_m: Vector3<f64>,
        /// Stiffness K, N/m.
        stiffness_n_per_m: f64,
        /// Damping B, Ns/m.
        damping_ns_per_m: f64,
        /// Largest force, N.
        largest_force_n: f64,
    },
}

impl Pull {
    /// Returns force and moment (world axes; N, Nm) on the origin of a frame with this placement and velocity in the world (m, m/s).
    #[must_use]
    pub fn wrench(&self, placement: &Placement, velocity: &Motion) -> Force {
        match self {
            Self::Spring { target_m, stiffness_n_per_m, damping_ns_per_m } => Force {
                linear: (target_m - placement.translation) * *stiffness_n_per_m
                    - velocity.linear * *damping_ns_per_m,
                angular: Vector3::zeros(),
            },
            Self::Wrench(wrench) => *wrench,
            Self::Drag { point_m, target_m, stiffness_n_per_m, damping_ns_per_m, largest_force_n } => {
                let arm = placement.rotation * point_m;
                let v = velocity.linear + velocity.angular.cross(&arm);
                let force =
                    (target_m - placement.translation - arm) * *stiffness_n_per_m - v * *damping_ns_per_m;
                // A force of zero has no direction.
                let shortened = (largest_force_n / force.norm()).min(1.0);
                let linear = force * shortened;
                Force { linear, angular: arm.cross(&linear) }
            }
        }
    }
}

/// Handle that sets the external force on one arm, from any thread. Clones set the same force.
#[derive(Clone, Debug, Default)]
pub struct ExternalForceHandle(Arc<Mutex<Forces>>);

/// Force that is set, or the forces of the cycles to come.
#[derive(Debug, Default)]
struct Forces {
    set: Option<ExternalForce>,
    recorded: Option<IntoIter<Option<ExternalForce>>>,
}

impl ExternalForceHandle {
    /// Sets the force from the next interface cycle on.
    pub fn apply(&self, frame: FrameId, pull: Pull) {
        self.set(Some(ExternalForce { frame, pull }));
    }

    /// Removes the force from the next interface cycle on.
    pub fn release(&self) {
        self.set(None);
    }

    /// Sets the force, or removes it, from the next interface cycle on.
    pub fn set(&self, force: Option<ExternalForce>) {
        *self.lock() = Forces { set: force, recorded: None };
    }

    /// Applies these forces in the next interface cycles, one in each, and none after them: those of a log, to repeat its
    /// simulation.
    pub fn repeat(&self, forces: Vec<Option<ExternalForce>>) {
        *self.lock() = Forces { set: None, recorded: Some(forces.into_iter()) };
    }

    /// Force that is set, if any.
    #[must_use]
    pub fn get(&self) -> Option<ExternalForce> {
        self.lock().set
    }

    /// Returns the force of an interface cycle that begins.
    pub(crate) fn of_next_cycle(&self) -> Option<ExternalForce> {
        let mut forces = self.lock();
        if let Some(recorded) = &mut forces.recorded {
            forces.set = recorded.next().flatten();
        }
        forces.set
    }

    fn lock(&self) -> MutexGuard<'_, Forces> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Number of values in a row.
const WIDTH: usize = 20;

/// Number of values before those of a point and a largest force, which older logs do not have.
const OLDER_WIDTH: usize = 16;

/// Layout of the channel `external`.
#[must_use]
pub fn layout() -> Layout {
    let signals = SignalRecorder::describe(|out| record(None, f64::NAN, &Vector3::zeros(), out));
    Layout { channel: EXTERNAL_CHANNEL.to_owned(), signals }
}

/// Records the force that is set, the index of its frame, and the force that acted in the last step (N).
fn record(set: Option<Pull>, frame: f64, acting: &Vector3<f64>, out: &mut SignalRecorder<'_>) {
    let (mut target, mut gains, mut wrench) = ([f64::NAN; 3], [f64::NAN; 2], [f64::NAN; 6]);
    let (mut point, mut largest) = ([f64::NAN; 3], f64::NAN);
    let pull = match set {
        None => 0.0,
        Some(Pull::Spring { target_m, stiffness_n_per_m, damping_ns_per_m }) => {
            target = target_m.into();
            gains = [stiffness_n_per_m, damping_ns_per_m];
            1.0
        }
        Some(Pull::Wrench(Force { linear, angular })) => {
            wrench = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z];
            2.0
        }
        Some(Pull::Drag { point_m, target_m, stiffness_n_per_m, damping_ns_per_m, largest_force_n }) => {
            target = target_m.into();
            gains = [stiffness_n_per_m, damping_ns_per_m];
            (point, largest) = (point_m.into(), largest_force_n);
            3.0
        }
    };
    let axes = ["x", "y", "z"];
    out.signal("pull", "1", &["0 none, 1 spring, 2 wrench, 3 drag"], &[pull]);
    out.signal("frame", "1", &["index in the model"], &[frame]);
    out.signal("target", "m", &axes, &target);
    out.scalar("stiffness", "N/m", gains[0]);
    out.scalar("damping", "Ns/m", gains[1]);
    out.signal("wrench", "N,Nm", &["fx", "fy", "fz", "mx", "my", "mz"], &wrench);
    out.signal("force", "N", &axes, acting.as_slice());
    out.signal("point", "m", &axes, &point);
    out.scalar("largest_force", "N", largest);
}

/// Returns the external force of a row of the channel `external`; `None` if no force was set, or if the row doesn't fit
/// the model. Rows of older logs, which have no point, are decoded too.
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
        3.0 => {
            let [px, py, pz, largest_force_n] = *row.get(OLDER_WIDTH..)?.first_chunk()?;
            Pull::Drag {
                point_m: Vector3::new(px, py, pz),
                target_m: Vector3::new(tx, ty, tz),
                stiffness_n_per_m: stiffness,
                damping_ns_per_m: damping,
                largest_force_n,
            }
        }
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
    /// Returns empty rows with memory for `capacity` rows.
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
        let index = set.and_then(|force| self.frames.iter().position(|frame| *frame == force.frame));
        let frame = index.map_or(f64::NAN, |index| index as f64);
        let mut out = SignalRecorder::sampling(&mut self.values[begin..]);
        record(set.map(|force| force.pull), frame, acting, &mut out);
    }

    /// Rows in the order of time.
    pub fn iter(&self) -> impl Iterator<Item = &[f64]> {
        self.values.chunks_exact(WIDTH)
    }
}
