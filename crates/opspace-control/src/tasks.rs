//! Tasks: Cartesian ones, the centre of mass, and those of the joints.

pub mod axes;
pub mod cartesian;
pub mod cartesian_parameters;
pub mod force;
pub mod gains;
pub mod impedance;
pub mod joint;
pub(crate) mod law;
pub mod subject;
pub mod task_axes;
