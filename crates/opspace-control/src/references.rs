//! Reference motions of tasks: position, velocity and acceleration.
//!
//! ```text
//! t → (x_d, ẋ_d, ẍ_d)
//! ```

pub mod acceleration_bound;
pub(crate) mod blend;
pub(crate) mod cubic_spline;
pub(crate) mod curve;
pub mod goal;
pub mod joint_reference;
pub mod online;
pub mod path_bounds;
pub mod path_motion;
pub mod path_reference;
pub(crate) mod path_shape;
pub mod ramp;
pub mod recorded;
pub mod reference;
pub mod scalar_reference;
pub mod streamed;
pub mod streamed_joints;
pub mod streamed_pose;
pub mod target;
pub(crate) mod timing_law;
pub mod wave;
