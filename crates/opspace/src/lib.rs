//! Operational-space control for robots that accept torques, and for robots that accept only positions.
//!
//! This crate re-exports all others, so that it is the only dependency needed. The crate `opspace-cli` has the
//! command-line tool.
//!
//! | task | crate |
//! |---|---|
//! | read a URDF, compute kinematics and dynamics | [`model`] |
//! | compute torques from tasks in your own loop | [`control`] |
//! | couple robots: teleoperation, carried objects | [`coupling`] |
//! | convert torques to the commands of a position or velocity robot | [`transformer`] |
//! | write a driver for a robot | [`backend`] |
//! | run a controller on a robot, with supervision | [`control_loop`] |
//! | simulate an arm with its servos and sensors | [`sim`] |
//! | record, read and replay runs | [`log`] |
//! | identify the servos of a robot | [`identify`] |
//! | find mistakes in them before a run | [`preflight`] |
//! | write the files of a new robot | [`setup`] |
//! | run a suite, and compare its results | [`suite`] |
//! | run robot and task files | [`experiment`] |
//! | draw figures and pages of runs, and keep them in folders | [`report`] |
//!
//! Example of a compliant position robot: its servo is stiff, but the transformer makes it produce the torques of a
//! task.
//!
//! ```
//! use opspace::backend::quantity::Positive;
//! use opspace::backend::{Backend, Capabilities, CommandKind, Measured, Sample};
//! use opspace::control::{
//!     Compensation, ControlContext, JointGains, JointPostureParameters, LimitParameters,
//!     OperationalSpaceController, TaskParameters, TaskSet,
//! };
//! use opspace::control_loop::{ControlLoop, LoopConfig, Run, RunOutcome, drive};
//! use opspace::model::Model;
//! use opspace::sim::{ArmConfig, SimulatedArm};
//! use opspace::transformer::{CascadedServo, PaperTransformer, ServoParameters};
//!
//! // A rod of 2 kg, its centre of mass 0.5 m from the hinge, moved by a position servo.
//! let urdf = r#"<robot name="pendulum">
//!   <link name="base"/>
//!   <joint name="hinge" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/></joint>
//!   <link name="rod"><inertial><origin xyz="0.5 0 0"/><mass value="2"/>
//!     <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
//! </robot>"#;
//! let model = Model::from_urdf(urdf)?.model;
//! let (kp_per_s, kv_nms_per_rad) = (Positive::literal(20.0), Positive::literal(30.0));
//! let velocity_filter_hz = Positive::literal(600.0);
//! let servo =
//!     ServoParameters::Cascaded(CascadedServo::new(kp_per_s, kv_nms_per_rad, velocity_filter_hz));
//! let capabilities = Capabilities::new(["hinge"], CommandKind::Position, 1e-3)
//!     .measuring(&[Measured::MotorCurrent])
//!     .simulated();
//! let gains = vec![servo.gains(2e-4)];
//! let mut arm = SimulatedArm::new(ArmConfig::ideal(model.clone(), capabilities.clone(), vec![servo])?)?;
//!
//! // Tasks to torques: a posture held by a soft spring.
//! let context = ControlContext::new(&model, capabilities.period_s);
//! let hold = JointPostureParameters::new(JointGains::new(5.0, 1.0)?);
//! let tasks = TaskSet::builder(&model, &context)
//!     .from_parameters("hold", &TaskParameters::JointPosture(hold))?
//!     .build();
//! let limits = LimitParameters::default();
//! let controller =
//!     OperationalSpaceController::from_tasks(&model, tasks, &context, Compensation::Bias, &limits);
//!
//! // Torques to positions, and both in a loop around the robot.
//! let control = ControlLoop::new(LoopConfig {
//!     transformer: Box::new(PaperTransformer::new(gains.clone())),
//!     servo_gains: gains,
//!     ..LoopConfig::new(model, capabilities, Box::new(controller))
//! })?;
//! let mut rows = ();
//! let mut run = Run::new(control, 2.0, &mut rows);
//! drive(&mut arm, &mut run);
//!
//! assert_eq!(run.finish(), RunOutcome::Completed);
//!
//! // By hand: the motor carries m g l. The servo alone would sag by 16 mrad to make it.
//! let mut sample = Sample::new(arm.capabilities());
//! arm.read(&mut sample)?;
//! let torque = sample.motor_torque.ok_or("measured")?;
//! assert!((torque[0] + 2.0 * 9.81 * 0.5).abs() < 1e-2);
//! assert!(sample.q[0].abs() < 1e-3);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

pub use opspace_backend as backend;
pub use opspace_control as control;
pub use opspace_coupling as coupling;
pub use opspace_experiment as experiment;
pub use opspace_identify as identify;
pub use opspace_log as log;
pub use opspace_loop as control_loop;
pub use opspace_model as model;
pub use opspace_preflight as preflight;
pub use opspace_report as report;
pub use opspace_setup as setup;
pub use opspace_sim as sim;
pub use opspace_suite as suite;
pub use opspace_transformer as transformer;

#[cfg(feature = "urdf-rs")]
pub mod urdf;

/// Code examples of the README, compiled and run as doctests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
