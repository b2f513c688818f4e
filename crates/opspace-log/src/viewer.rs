//! Messages for viewers, `foxglove.JointStates` and `foxglove.FrameTransforms`, computed from the rows of the channel
//! `tick` on the writer's thread.

use crate::error::LogError;
use crate::foxglove::{FrameTransform, FrameTransforms, JointState, JointStates, Timestamp, Warning};
use crate::header::TIME_ZERO_NS;
use nalgebra::{Rotation3, UnitQuaternion};
use opspace_backend::Layout;
use opspace_backend::signal_names::{DQ, MOTOR_TORQUE, Q, TICK_CHANNEL};
use opspace_model::{Data, FrameId, Model, Placement, frame_placement, kinematics};
use std::ops::Range;
use std::sync::Arc;

/// Time between two messages, ns: 50 Hz looks smooth, and is a small part of the log.
const PERIOD_NS: u64 = 20_000_000;

/// Messages for viewers, overwritten in place.
pub(crate) struct Viewer {
    /// Index of the channel `tick`.
    pub channel: usize,
    /// Message of `/joint_states`.
    pub joints: JointStates,
    /// Message of `/tf`.
    pub bodies: Option<Bodies>,
    q: Range<usize>,
    dq: Option<Range<usize>>,
    effort: Option<Range<usize>>,
    last_ns: Option<u64>,
}

/// Poses of the links.
pub(crate) struct Bodies {
    pub transforms: FrameTransforms,
    model: Arc<Model>,
    data: Data,
    frames: Vec<FrameId>,
    at_rest: Vec<f64>,
}

impl Viewer {
    /// Returns the messages of a log with these layouts; `None` without a channel `tick` that has a signal `q`.
    pub fn new(layouts: &[&Layout], model: Option<Arc<Model>>) -> Result<Option<Self>, LogError> {
        let Some(channel) = layouts.iter().position(|l| l.channel == TICK_CHANNEL) else {
            return Ok(None);
        };
        let Some(q) = layouts[channel].columns(Q) else {
            return Ok(None);
        };
        let alike = |name| layouts[channel].columns(name).filter(|c| c.len() == q.len());
        let names = layouts[channel].signals.iter().find(|s| s.name == Q).map(|s| &s.elements);
        let joint = |name: &String| JointState { name: name.clone(), ..JointState::default() };
        let joints = names.into_iter().flatten().map(joint).collect();
        Ok(Some(Self {
            channel,
            joints: JointStates { joints, ..JointStates::default() },
            bodies: model.map(|m| Bodies::new(m, q.len())).transpose()?,
            dq: alike(DQ),
            effort: alike(MOTOR_TORQUE),
            q,
            last_ns: None,
        }))
    }

    /// Updates the messages from a row if the last update is old enough; returns true if they must be written.
    pub fn show(&mut self, ns: u64, row: &[f64]) -> bool {
        if self.last_ns.is_some_and(|last| ns.abs_diff(last) < PERIOD_NS) {
            return false;
        }
        self.last_ns = Some(ns);
        self.joints.timestamp = timestamp(ns);
        let value = |columns: &Option<Range<usize>>, i| columns.as_ref().map(|c| row[c.start + i]);
        for (i, joint) in self.joints.joints.iter_mut().enumerate() {
            joint.position = Some(row[self.q.start + i]);
            joint.velocity = value(&self.dq, i);
            joint.effort = value(&self.effort, i);
        }
        if let Some(bodies) = &mut self.bodies {
            bodies.place(ns, &row[self.q.clone()]);
        }
        true
    }
}

impl Bodies {
    fn new(model: Arc<Model>, n: usize) -> Result<Self, LogError> {
        if model.n() != n {
            let model_name = model.name().to_owned();
            return Err(LogError::ModelMismatch { model: model_name, joints: model.n(), elements: n });
        }
        // A link may be named "world".
        let mut world = "world".to_owned();
        while model.frame_id(&world).is_ok() {
            world.push('_');
        }
        let transform = |name: &String| FrameTransform {
            parent_frame_id: world.clone(),
            child_frame_id: name.clone(),
            ..FrameTransform::default()
        };
        let transforms = model.frames().iter().map(|f| transform(&f.name)).collect();
        let frames = model.frames().iter().filter_map(|f| model.frame_id(&f.name).ok()).collect();
        let data = Data::new(&model);
        Ok(Self { transforms: FrameTransforms { transforms }, data, frames, at_rest: vec![0.0; n], model })
    }

    fn place(&mut self, ns: u64, q: &[f64]) {
        kinematics(&self.model, &mut self.data, q, &self.at_rest);
        for (&frame, transform) in self.frames.iter().zip(&mut self.transforms.transforms) {
            let Placement { rotation, translation: p } = frame_placement(&self.model, &self.data, frame);
            let r = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
            transform.timestamp = timestamp(ns);
            transform.translation = [p.x, p.y, p.z];
            transform.rotation = [r.i, r.j, r.k, r.w];
        }
    }
}

/// Returns a warning for `/log`.
pub(crate) fn warning(ns: u64, message: String) -> Warning {
    Warning { timestamp: timestamp(ns), message, name: "opspace".to_owned() }
}

/// Converts a time on the robot's clock (s) to a timestamp of the log (ns).
pub(crate) fn nanoseconds(time_s: f64) -> u64 {
    // The cast saturates, and converts NaN to 0.
    let since_zero = (time_s * 1e9).round() as i64;
    TIME_ZERO_NS.saturating_add_signed(since_zero)
}

fn timestamp(ns: u64) -> Timestamp {
    let (s, rest) = (ns / 1_000_000_000, (ns % 1_000_000_000) as u32);
    // Times after the year 2106 are replaced by the latest possible one.
    u32::try_from(s)
        .map_or(Timestamp { sec: u32::MAX, nsec: 999_999_999 }, |sec| Timestamp { sec, nsec: rest })
}
