//! Rows of a coupled task: axes of a frame, or joints, with their displacement since the start.
//!
//! ```text
//! frame    p = [Aᵀ (x − x₀); Aᵀ log(R R₀ᵀ)]        v = J q̇        A: axes of the task
//! joints   p = q − q₀                              v = q̇
//! ```

use crate::coupled_parameters::{CoupledParameters, DEFAULT_AXES};
use crate::error::Mistake;
use nalgebra::{Matrix6xX, Vector3, Vector6};
use opspace_control::tasks::selected_joints::selected_joints;
use opspace_control::{
    AXIS_NAMES, ControlContext, ControlError, ControlInput, ControlledFrame, Reason, SensedForce, TaskAxes,
    characteristic_length, orientation,
};
use opspace_model::{Data, Model, Placement, frame_jacobian};

/// Coupled rows of a robot, at most six.
#[derive(Clone, Debug)]
pub(crate) struct CoupledRows {
    kind: Kind,
    /// Name and position unit of each row.
    rows: Vec<(String, &'static str)>,
    sensor: Option<SensedForce>,
    /// True if the sensed force is not estimated.
    is_measured: bool,
    jacobian: Matrix6xX<f64>,
}

#[derive(Clone, Debug)]
enum Kind {
    /// Axes of a frame, and its pose at the start.
    Frame(Box<(TaskAxes, Placement)>),
    /// Joints, and their positions at the start (rad, m).
    Joints(Vec<usize>, Vector6<f64>),
}

/// Motion and sensed force of the rows, without the scale of rotations.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RowState {
    /// Displacement since the start, m or rad; rotations are a rotation vector.
    pub position: Vector6<f64>,
    /// Velocity, m/s or rad/s.
    pub velocity: Vector6<f64>,
    /// Sensed force ON the robot, N or Nm; zero without a sensor.
    pub sensed: Vector6<f64>,
}

impl Default for RowState {
    fn default() -> Self {
        let zero = Vector6::zeros();
        Self { position: zero, velocity: zero, sensed: zero }
    }
}

impl CoupledRows {
    pub(crate) fn new(
        p: &CoupledParameters,
        model: &Model,
        context: &ControlContext,
        key: &str,
    ) -> Result<Self, ControlError> {
        let at = |place: &str, reason: Reason| ControlError::new(format!("{key}.{place}"), reason);
        let (kind, rows) = match (&p.frame, &p.joints) {
            (Some(frame), None) => {
                let frame = model.frame_id(frame).map_err(|e| at("frame", e.into()))?;
                let named = p.axes.as_deref().unwrap_or(&DEFAULT_AXES);
                let mut used = [false; 6];
                for axis in named {
                    if std::mem::replace(&mut used[axis.index()], true) {
                        return Err(at("axes", Mistake::AxisList.into()));
                    }
                }
                if named.is_empty() {
                    return Err(at("axes", Mistake::AxisList.into()));
                }
                let controlled = ControlledFrame::Frame(frame);
                let directions = orientation::from_rpy(p.axes_rpy_rad);
                let axes =
                    TaskAxes::new(controlled, directions, used, characteristic_length(model, controlled));
                let names = axes
                    .axes()
                    .iter()
                    .map(|&axis| (AXIS_NAMES[axis].to_owned(), if axis < 3 { "m" } else { "rad" }));
                let names = names.collect();
                (Kind::Frame(Box::new((axes, Placement::identity()))), names)
            }
            (None, Some(names)) => {
                if p.axes.is_some() {
                    return Err(at("axes", Mistake::AxesOfJoints.into()));
                }
                let joints = selected_joints(names, model, &format!("{key}.joints"))?;
                let units = model.joint_units().position;
                let rows = joints.iter().map(|&joint| {
                    (model.joints()[joint].name.clone(), if units[joint] == "m" { "m" } else { "rad" })
                });
                let rows = rows.collect();
                (Kind::Joints(joints, Vector6::zeros()), rows)
            }
            _ => return Err(ControlError::new(key, Mistake::FrameOrJoints)),
        };
        let mut is_measured = false;
        let sensor = match &p.sensor {
            None => None,
            Some(name) => {
                let Some(index) = context.sensors.iter().position(|(known, _)| known == name) else {
                    let known = context.sensors.iter().map(|(name, _)| name.clone()).collect();
                    return Err(at("sensor", Reason::Sensor { name: name.clone(), known }));
                };
                let frame = context.sensors[index].1;
                is_measured = index + context.estimated_sensors < context.sensors.len();
                Some(SensedForce::new(index, frame, p.filter_hz.get(), context.period_s))
            }
        };
        Ok(Self { kind, rows, sensor, is_measured, jacobian: Matrix6xX::zeros(model.n()) })
    }

    /// Name and position unit of each row.
    pub(crate) fn names(&self) -> &[(String, &'static str)] {
        &self.rows
    }

    /// Joints of the task; `None` for a frame.
    pub(crate) fn is_of_joints(&self) -> bool {
        matches!(self.kind, Kind::Joints(..))
    }

    /// True if the rows are x, y and z of a frame.
    pub(crate) fn is_of_position(&self) -> bool {
        matches!(&self.kind, Kind::Frame(frame) if frame.0.axes() == [0, 1, 2])
    }

    /// True if the force is measured by a sensor, not estimated from the torques of the motors.
    pub(crate) fn is_measured(&self) -> bool {
        self.is_measured
    }

    /// True if the force is sensed.
    pub(crate) fn is_sensed(&self) -> bool {
        self.sensor.is_some()
    }

    /// Takes the present state as that of zero displacement.
    pub(crate) fn start(&mut self, input: &ControlInput<'_>) {
        let ControlInput { model, data, .. } = *input;
        match &mut self.kind {
            Kind::Frame(frame) => frame.1 = frame.0.controlled.placement(model, data),
            Kind::Joints(joints, home) => {
                for (row, &joint) in joints.iter().enumerate() {
                    home[row] = data.q[joint];
                }
            }
        }
        if let Some(sensor) = &mut self.sensor {
            let _ = sensor.start(input.measurement);
        }
    }

    /// State of the rows in this cycle. Allocates nothing.
    pub(crate) fn update(&mut self, input: &ControlInput<'_>) -> RowState {
        let ControlInput { model, data, measurement, .. } = *input;
        let reading = self.sensor.as_mut().map(|sensor| sensor.update(measurement));
        let sensor = self.sensor.as_ref().zip(reading);
        let mut state = RowState::default();
        match &self.kind {
            Kind::Frame(frame) => {
                let (axes, home) = &**frame;
                let placement = axes.controlled.placement(model, data);
                let linear = axes.rotation.tr_mul(&(placement.translation - home.translation));
                let turned = axes.axes().iter().any(|&axis| axis >= 3);
                let angular = if turned {
                    axes.rotation.tr_mul(&orientation::log(&(placement.rotation * home.rotation.transpose())))
                } else {
                    Vector3::zeros()
                };
                let position = Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z);
                let velocity = axes.of_motion(&axes.controlled.velocity(model, data));
                let sensed = sensor.map_or_else(Vector6::zeros, |(sensor, reading)| {
                    let point = axes.controlled.point(model, data);
                    sensor.at((model, data), &reading, &point, &axes.rotation)
                });
                for (row, &axis) in axes.axes().iter().enumerate() {
                    state.position[row] = position[axis];
                    state.velocity[row] = velocity[axis];
                    state.sensed[row] = sensed[axis];
                }
            }
            Kind::Joints(joints, home) => {
                if let Some((sensor, reading)) = sensor {
                    frame_jacobian(model, data, sensor.frame, &mut self.jacobian);
                    let reading = Vector6::from(reading);
                    for (row, &joint) in joints.iter().enumerate() {
                        state.sensed[row] = self.jacobian.column(joint).dot(&reading);
                    }
                }
                for (row, &joint) in joints.iter().enumerate() {
                    state.position[row] = data.q[joint] - home[row];
                    state.velocity[row] = data.dq[joint];
                }
            }
        }
        state
    }

    /// Factor of a row: the characteristic length (m) for the rotation of a frame, else 1.
    pub(crate) fn scale(&self, row: usize) -> f64 {
        match &self.kind {
            Kind::Frame(frame) => frame.0.axes().get(row).map_or(1.0, |&axis| frame.0.scale[axis]),
            Kind::Joints(..) => 1.0,
        }
    }

    /// Computes the scaled rows of the Jacobian (6 × n).
    pub(crate) fn jacobian(&self, model: &Model, data: &Data, rows: &mut Matrix6xX<f64>) {
        match &self.kind {
            Kind::Frame(frame) => {
                let axes = &frame.0;
                axes.controlled.jacobian(model, data, rows);
                axes.select_in_place(rows);
            }
            Kind::Joints(joints, _) => {
                rows.fill(0.0);
                for (row, &joint) in joints.iter().enumerate() {
                    rows[(row, joint)] = 1.0;
                }
            }
        }
    }

    /// J̇ q̇ of the scaled rows.
    pub(crate) fn bias(&self, model: &Model, data: &Data) -> Vector6<f64> {
        match &self.kind {
            Kind::Frame(frame) => {
                let axes = &frame.0;
                axes.rows_of(&axes.of_motion(&axes.controlled.bias_acceleration(model, data)))
            }
            Kind::Joints(..) => Vector6::zeros(),
        }
    }
}
