//! Joint torques to the commands that make a robot's servos produce them.

#![forbid(unsafe_code)]

pub mod closed_loop_transformer;
pub mod current;
pub mod estimator;
pub mod friction;
pub mod identity;
pub mod observer;
pub mod parameters;
pub mod polynomial;
pub mod refine;
pub mod servo;
pub mod servo_inversion;
pub mod servo_law;
pub mod servo_model_transformer;
pub mod transformer;
pub mod velocity_transformer;

pub use closed_loop_transformer::{IdentificationError, IdentifiedJoint, LiteralTransformer, Rational};
pub use current::{CurrentCorrected, CurrentObserver};
pub use estimator::{EstimatorParameters, VelocityEstimator};
pub use friction::{FrictionCompensation, FrictionCompensationParameters, FrictionParameters};
pub use identity::Identity;
pub use observer::{ObservedJoint, ObserverGain};
pub use parameters::{JointParameters, ProfileParameters, RotorParameters};
pub use refine::{Refinement, RefinementParameters};
pub use servo::{CascadedServo, ServoGains, ServoParameters, VelocityServo};
pub use servo_inversion::{EmulationError, Matching};
pub use servo_law::{ServoError, ServoLaw, ServoMemory};
pub use servo_model_transformer::{EmulatingTransformer, EmulationSetup};
pub use transformer::{Method, PaperTransformer, Transformer, TransformerKind};
pub use velocity_transformer::VelocityTransformer;
