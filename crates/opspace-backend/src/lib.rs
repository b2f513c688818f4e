//! Robots behind one trait: torque or position, and the transformer between them.
//!
//! A [`Robot`] adapter is a [`PositionRobot`] or a [`TorqueRobot`]; a [`Backend`] makes either one take
//! torques; the [`ControlLoop`] runs a controller on a backend and never knows which it is.

pub mod backend;
pub mod control_loop;
pub mod current;
pub mod emulation;
pub mod estimator;
pub mod fault;
pub mod friction;
pub mod identification;
pub mod identified;
pub mod interface;
pub mod inverse;
pub mod observer;
pub mod parameters;
pub mod polynomial;
pub mod position;
pub mod refine;
pub mod robot;
pub mod sensing;
pub mod servo;
pub mod servo_law;
pub mod supervisor;
pub mod torque;
pub mod transformer;
pub mod watchdog;

pub use backend::{Backend, Command};
pub use control_loop::{ControlLoop, Ending, Phase, SERVO, Sink, TICK, TRUTH};
pub use current::{CurrentCorrected, CurrentObserver};
pub use emulation::{EmulatingTransformer, EmulationSetup};
pub use estimator::{EstimatorParameters, VelocityEstimator};
pub use fault::Fault;
pub use friction::{FrictionCompensation, FrictionCompensationParameters, FrictionParameters};
pub use identified::{IdentificationError, IdentifiedJoint, LiteralTransformer, Rational};
pub use interface::{Facts, ForceSensor, GravityBy, InterfaceParameters, Measured, SetPoints};
pub use inverse::{EmulationError, Matching};
pub use observer::{ObservedJoint, ObserverGain};
pub use parameters::{JointParameters, ProfileParameters, RotorParameters, SafetyParameters};
pub use position::PositionBackend;
pub use refine::{Refinement, RefinementParameters};
pub use robot::{PositionRobot, Robot, Sample, TorqueRobot, Trace, Traces};
pub use sensing::Sensing;
pub use servo::{CascadedServo, ServoGains, ServoParameters};
pub use servo_law::{ServoError, ServoLaw, ServoMemory};
pub use supervisor::Continuity;
pub use torque::TorqueBackend;
pub use transformer::{Method, PaperTransformer, Transformer, TransformerKind};
pub use watchdog::{Watchdog, WatchdogParameters};
