//! Control loop, and its execution: run, drive, timeline and links.
//!
//! [`ControlLoop::step`] computes a command from a sample. A [`Run`] adds duration, stop requests, rows and an outcome;
//! [`drive()`] reads the samples from a [`Backend`](opspace_backend::Backend) and writes the commands to it. If the
//! robot's library has its own loop, its callback calls [`Run::cycle`].
//!
//! ```
//! use opspace_backend::{Capabilities, CommandKind, TICK};
//! use opspace_control::{
//!     Compensation, ControlContext, JointGains, JointPostureParameters, LimitParameters,
//!     OperationalSpaceController, TaskParameters, TaskSet,
//! };
//! use opspace_loop::{ControlLoop, LoopConfig, Run, RunOutcome, drive};
//! use opspace_model::Model;
//! use opspace_sim::{ArmConfig, SimulatedArm};
//!
//! // A rod of 2 kg, its centre of mass 0.5 m from the hinge, on a motor that takes torques.
//! let urdf = r#"<robot name="pendulum">
//!   <link name="base"/>
//!   <joint name="hinge" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/></joint>
//!   <link name="rod"><inertial><origin xyz="0.5 0 0"/><mass value="2"/>
//!     <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
//! </robot>"#;
//! let model = Model::from_urdf(urdf)?.model;
//! let capabilities = Capabilities::new(["hinge"], CommandKind::Torque, 1e-3).simulated();
//! let mut arm = SimulatedArm::new(ArmConfig::ideal(model.clone(), capabilities.clone(), vec![])?)?;
//!
//! // One task: hold the posture of the start.
//! let context = ControlContext::new(&model, capabilities.period_s);
//! let hold = JointPostureParameters::new(JointGains::new(10.0, 1.0)?);
//! let tasks = TaskSet::builder(&model, &context)
//!     .from_parameters("hold", &TaskParameters::JointPosture(hold))?
//!     .build();
//! let limits = LimitParameters::default();
//! let controller =
//!     OperationalSpaceController::from_tasks(&model, tasks, &context, Compensation::Bias, &limits);
//!
//! // Two seconds of control; `()` discards the rows, which a recorder would log.
//! let control = ControlLoop::new(LoopConfig::new(model, capabilities, Box::new(controller)))?;
//! let mut rows = ();
//! let mut run = Run::new(control, 2.0, &mut rows);
//! drive(&mut arm, &mut run);
//!
//! // By hand: the torque that holds the rod level is −m g l.
//! let layout = Run::layouts(run.control(), None).swap_remove(TICK);
//! let torque = layout.columns("torque_desired").ok_or("a signal of each row")?;
//! assert!((run.row()[torque.start] + 2.0 * 9.81 * 0.5).abs() < 1e-2);
//! assert_eq!(run.finish(), RunOutcome::Completed);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

pub mod collision_detector;
pub mod control_loop;
pub mod drive;
pub mod driver_calls;
mod driving_torque;
pub mod estimated_force;
mod external_torque;
mod fast_residual;
pub mod fault;
mod guard;
pub mod high_pass;
pub mod late_commands;
pub mod link;
pub mod loop_config;
mod oscillation_detector;
pub mod pacer;
pub mod phase;
pub mod real_time;
mod reference_motion;
mod retraction;
pub mod run;
pub mod safety;
mod sample_rate;
pub mod sensor_compensation;
mod state_estimator;
pub mod supervisor;
pub mod target_stream;
pub mod timeline;
pub mod watchdog;

pub use collision_detector::{
    CollisionDetectionParameters, CollisionDetector, CollisionReaction, ExpectedContact,
};
pub use control_loop::{ControlLoop, Step};
pub use drive::{Driven, drive, drive_together, drive_together_with, drive_with};
pub use estimated_force::{EstimatedForce, EstimatedForceParameters};
pub use fault::Fault;
pub use late_commands::LateCommands;
pub use link::{ChannelParameters, Link, LinkError};
pub use loop_config::{LoopConfig, LoopError};
pub use pacer::{PaceControl, Pacer, SteadyClock, SystemClock};
pub use phase::Phase;
pub use real_time::{RealTime, RealTimeMode, RealTimeParameters};
pub use retraction::RetractionParameters;
pub use run::{Run, RunOutcome};
pub use safety::SafetyParameters;
pub use sensor_compensation::{
    SensorBiasParameters, SensorCompensation, SensorEstimateParameters, SensorLoadParameters,
};
pub use target_stream::{TargetReceiver, TargetSender, target_stream};
pub use timeline::{Cycle, Timeline, TimelineError};
pub use watchdog::{Watchdog, WatchdogParameters};

/// Code examples of the README, compiled and run as doctests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
