//! Operational-space control: tasks to torques.
//!
//! A [`Controller`] is built from the tasks of a task file ([`TaskParameters`]) in their order of priority
//! ([`TaskSetParameters`]): [`OperationalSpaceController`] commands torques, [`InverseKinematicsController`] joint
//! positions. The [`Measurement`] is the only data that a controller receives from the robot. Updates do not allocate.
//!
//! ```
//! use opspace_control::{
//!     ControlContext, ControlInput, Controller, Measurement,
//!     OperationalSpaceController, Targets, TaskParameters, TaskSetParameters,
//! };
//! use opspace_model::{Data, Model, aba, frame_placement, update};
//! use std::collections::BTreeMap;
//!
//! // An arm of two joints in the x-z plane: links of 0.4 m and 1 kg each.
//! let urdf = r#"<robot name="arm">
//!   <link name="base"/>
//!   <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/></joint>
//!   <link name="upper"><inertial><origin xyz="0 0 -0.2"/><mass value="1"/>
//!     <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.001"/></inertial></link>
//!   <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/>
//!     <origin xyz="0 0 -0.4"/><axis xyz="0 1 0"/></joint>
//!   <link name="lower"><inertial><origin xyz="0 0 -0.2"/><mass value="1"/>
//!     <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.001"/></inertial></link>
//!   <joint name="tip" type="fixed"><parent link="lower"/><child link="hand"/><origin xyz="0 0 -0.4"/></joint>
//!   <link name="hand"/>
//! </robot>"#;
//! let model = Model::from_urdf(urdf)?.model;
//! let task: BTreeMap<String, TaskParameters> = toml::from_str(r#"
//!     [hand.cartesian]
//!     frame = "hand"
//!     axes = { x = "motion", z = "motion" }
//!     reference.point-to-point = { position = { offset_m = [0.1, 0.0, 0.05] }, duration_s = 1.0 }
//!     gains = { frequency_rad_per_s = 20.0, damping_ratio = 1.0 }
//! "#)?;
//! let priority = ["hand".to_owned()];
//! let parameters = TaskSetParameters::new(&priority, &task);
//! let context = ControlContext::new(&model, 1e-3);
//! let mut controller = OperationalSpaceController::new(&model, &parameters, &context)?;
//!
//! let (mut data, mut seen, mut tau) = (Data::new(&model), Measurement::new(2, 0, false), [0.0; 2]);
//! seen.q.copy_from_slice(&[0.3, -0.9]);
//! let (no_targets, no_feedforward) = (Targets::none(), [0.0; 2]);
//! assert!(update(&model, &mut data, seen.q.as_slice(), seen.dq.as_slice()));
//! let hand = model.frame_id("hand")?;
//! let start = frame_placement(&model, &data, hand).translation;
//! for tick in 0..1500 {
//!     seen.time_s = f64::from(tick) * context.period_s;
//!     assert!(update(&model, &mut data, seen.q.as_slice(), seen.dq.as_slice()));
//!     let input = ControlInput::new(&model, &data, &seen, &no_feedforward, &no_targets);
//!     if tick == 0 {
//!         controller.start(&input);
//!     }
//!     controller.update(&input, &mut tau);
//!     // In place of a robot: forward dynamics, integrated.
//!     aba(&model, &mut data, &tau);
//!     seen.dq += &data.ddq * context.period_s;
//!     seen.q += &seen.dq * context.period_s;
//! }
//! let moved = frame_placement(&model, &data, hand).translation - start;
//! assert!((moved.x - 0.1).abs() < 1e-3 && (moved.z - 0.05).abs() < 1e-3, "the hand has arrived");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

pub(crate) mod algebra;
pub mod axis_mode;
pub mod context;
pub mod controller;
pub mod error;
pub mod hierarchy;
pub mod ik;
pub(crate) mod limiter;
pub mod limits;
pub mod measurement;
pub(crate) mod nullspace;
pub mod orientation;
pub mod osc;
pub mod per_joint;
pub mod prediction;
// The solvers are internal. They are hidden instead of private because tests and benchmarks use them.
#[doc(hidden)]
pub mod qp;
pub mod references;
pub mod targets;
pub mod tasks;

pub use axis_mode::AxisMode;
pub use context::ControlContext;
pub use controller::{CommandedAcceleration, ControlInput, Controller, StaleTarget};
pub use error::{ControlError, Reason};
pub use hierarchy::contact_condition::ContactCondition;
pub use hierarchy::rank;
pub use hierarchy::task_parameters::{Compensation, RegisteredTask, TaskParameters, TaskSetParameters};
pub use hierarchy::task_set::{TaskSet, TaskSetBuilder};
pub use ik::{InverseKinematicsController, ServoLead};
pub use limits::collision_limits::CollisionLimits;
pub use limits::joint_limits::{JointLimits, LimitParameters};
pub use limits::viable_speed::ViableSpeeds;
pub use measurement::Measurement;
pub use osc::OperationalSpaceController;
pub use per_joint::PerJoint;
pub use prediction::Prediction;
pub use qp::quadratic_program::QpError;
pub use references::acceleration_bound::AccelerationBound;
pub use references::goal::{OrientationGoal, PositionGoal};
pub use references::joint_reference::JointReference;
pub use references::online::{MotionLimits, OnlineGoal};
pub use references::path_bounds::{PartBounds, PathBounds, PathPlace};
pub use references::path_motion::{PathSummary, TimedReference};
pub use references::path_reference::{
    PathArc, PathCircle, PathLine, PathReference, PathSegment, PathSpline, PathStart, Triple,
};
pub use references::ramp;
pub use references::recorded::{self, PoseSample, RecordedError, RecordedPath, RecordedReason};
pub use references::reference::{CartesianReference, PointToPoint, Sinusoid, Trajectory, Waypoint};
pub use references::scalar_reference::{
    ScalarGoal, ScalarOnlineGoal, ScalarPointToPoint, ScalarReference, ScalarSinusoid,
};
pub use references::streamed::{OnTimeout, STOP_S, StreamedShape};
pub use references::streamed_joints::{JointShape, StreamedJointReference};
pub use references::streamed_pose::{PoseShape, QUATERNION_TOLERANCE, StreamedReference};
pub use references::target::Target;
pub use references::wave::{AngularWave, LinearWave};
pub use targets::{AllowedInputs, HoldCause, InputHandle, TargetError, Targets, TaskHandle, TaskTarget};
pub use tasks::admittance::AdmittanceLimits;
pub use tasks::axes::{AXIS_NAMES, Axes, AxesFrame, AxesFrameParameter, PerAxis, SurfaceAxesParameters};
pub use tasks::build_task::{BuildTask, BuiltTask, TaskReference};
pub use tasks::cartesian::CartesianTask;
pub use tasks::cartesian_parameters::{
    CartesianParameters, CenterOfMassParameters, Decoupling, SingularityHandling,
};
pub use tasks::cartesian_target::CartesianTarget;
pub use tasks::characteristic_length::{characteristic_length, reach};
pub use tasks::controlled_frame::ControlledFrame;
pub use tasks::coordinate::Coordinate;
pub use tasks::coordinate_task::{CoordinateGains, CoordinateTask};
pub use tasks::damping::Damping;
pub use tasks::damping_zone::DampingZone;
pub use tasks::energy_tank::TankParameters;
pub use tasks::force_parameters::{
    ContactParameters, ForceParameters, ForceProfiles, PassivityParameters, SurfaceParameters,
};
pub use tasks::gain_profile::{AxisProfiles, GainProfile};
pub use tasks::gains::AxisGains;
pub use tasks::impedance::{self, ImpedanceParameters};
pub use tasks::joint_parameters::{
    JointDampingParameters, JointGains, JointPostureParameters, JointTrackingParameters,
};
pub use tasks::joint_target::JointTarget;
pub use tasks::joint_task::JointTask;
pub use tasks::posture::Posture;
pub use tasks::selected_joints::SelectedJoints;
pub use tasks::sensed_force::SensedForce;
pub use tasks::singular_escape::SingularEscape;
pub use tasks::swivel::{SwivelAngle, SwivelParameters};
pub use tasks::task::{RowGains, SpeedLimit, Task, TaskInput, TaskSignals};
pub use tasks::task_axes::TaskAxes;
pub use tasks::tracking::Tracking;
pub use tasks::varying_gains::ImpedanceProfile;
pub use tasks::when_limited::WhenLimited;

/// Code examples of the README, compiled and run as doctests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
