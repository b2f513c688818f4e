//! Operational-space control: tasks to torques.
//!
//! A task file's tasks ([`TaskParameters`]) in the order of their priority ([`Stack`]) make a
//! [`Controller`]: [`OperationalSpaceController`] commands torques, [`InverseKinematicsController`] joint
//! positions. Both see the robot through a [`Measurement`] alone. No update allocates.
//!
//! ```
//! use opspace_control::{
//!     Compensation, Controller, JointLimits, LimitParameters, Measurement, OperationalSpaceController, RobotFacts,
//!     Stack, TaskParameters,
//! };
//! use opspace_model::{Data, Model, aba, update};
//! use std::collections::BTreeMap;
//!
//! # let inertial = r#"<inertial><origin xyz="0 0 -0.2"/><mass value="1"/><inertia ixx="0.01" ixy="0" ixz="0"
//! #     iyy="0.01" iyz="0" izz="0.001"/></inertial>"#;
//! # let joint = |name: &str, parent: &str, child: &str, z: f64| format!(r#"<joint name="{name}" type="continuous">
//! #     <parent link="{parent}"/><child link="{child}"/><origin xyz="0 0 {z}"/><axis xyz="0 1 0"/></joint>"#);
//! # let urdf = format!(r#"<robot name="r"><link name="base"/><link name="upper">{inertial}</link>
//! #     <link name="lower">{inertial}</link><link name="hand"/>{}{}
//! #     <joint name="tip" type="fixed"><parent link="lower"/><child link="hand"/><origin xyz="0 0 -0.4"/></joint></robot>"#,
//! #     joint("shoulder", "base", "upper", 0.0), joint("elbow", "upper", "lower", -0.4));
//! // An arm of two joints in the x-z plane, from its URDF.
//! let model = Model::from_urdf(&urdf)?.model;
//! let task: BTreeMap<String, TaskParameters> = toml::from_str(r#"
//!     [hand.cartesian]
//!     frame = "hand"
//!     axes = { x = "motion", z = "motion" }
//!     reference.point-to-point = { position = { offset_m = [0.1, 0.0, 0.05] }, duration_s = 1.0 }
//!     gains = { frequency_rad_per_s = 20.0, damping_ratio = 1.0 }
//! "#)?;
//! let priority = ["hand".to_owned()];
//! let stack = Stack {
//!     priority: &priority,
//!     task: &task,
//!     compensation: Compensation::Bias,
//!     limits: LimitParameters::default(),
//! };
//! let limits = JointLimits::of(&model);
//! let robot = RobotFacts { period_s: 1e-3, sensors: vec![], gravity_by_robot: false, limits };
//! let mut controller = OperationalSpaceController::new(&model, &stack, &robot)?;
//!
//! let (mut data, mut seen, mut tau) = (Data::new(&model), Measurement::new(2, 0, false), [0.0; 2]);
//! seen.q.copy_from_slice(&[0.3, -0.9]);
//! for tick in 0..1500 {
//!     seen.time_s = f64::from(tick) * robot.period_s;
//!     assert!(update(&model, &mut data, seen.q.as_slice(), seen.dq.as_slice()));
//!     if tick == 0 {
//!         controller.start(&model, &data, &seen);
//!     }
//!     controller.update(&model, &data, &seen, &mut tau);
//!     // In place of a robot: forward dynamics, integrated.
//!     aba(&model, &mut data, &tau);
//!     seen.dq += &data.ddq * robot.period_s;
//!     seen.q += &seen.dq * robot.period_s;
//! }
//! assert!(seen.dq.norm() < 1e-3, "the arm has arrived");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

pub mod active_set;
pub mod axes;
pub mod cartesian;
pub mod controller;
pub mod error;
pub mod filter;
pub mod force;
mod hierarchy;
pub mod ik;
pub mod impedance;
pub mod interior_point;
pub mod joint;
pub mod joint_reference;
pub mod law;
mod level;
mod lexicographic;
pub mod limits;
pub mod measurement;
pub mod online;
pub mod orientation;
pub mod osc;
pub mod per_joint;
mod products;
pub mod qp;
pub mod ramp;
pub mod rank;
pub mod recorded;
pub mod reference;
pub mod stacks;
pub mod subject;
pub mod task;
pub mod task_axes;
pub mod wave;

pub use axes::{AXIS_NAMES, Axes, AxesIn, AxisMode, Directions, PerAxis};
pub use cartesian::{CartesianParameters, CenterOfMassParameters, Decoupling, Singularities};
pub use controller::Controller;
pub use error::{ControlError, Reason};
pub use force::ForceParameters;
pub use ik::{InverseKinematicsController, ServoLead};
pub use impedance::ImpedanceParameters;
pub use joint::{JointDampingParameters, JointGains, JointPostureParameters, JointTrackingParameters};
pub use joint_reference::JointReference;
pub use law::AxisGains;
pub use limits::{JointLimits, LimitParameters};
pub use measurement::Measurement;
pub use online::{MotionLimits, OnlineGoal};
pub use osc::OperationalSpaceController;
pub use per_joint::PerJoint;
pub use recorded::{PoseSample, RecordedError, RecordedPath, RecordedReason};
pub use reference::{CartesianReference, Target, Trajectory};
pub use stacks::PreparedStack;
pub use subject::Subject;
pub use task::{Compensation, RobotFacts, Stack, TaskParameters};
pub use task_axes::TaskAxes;
