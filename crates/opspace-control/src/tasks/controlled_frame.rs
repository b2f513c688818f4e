//! Controlled frame of a Cartesian task: a frame in the world, a frame relative to another one, or the centre of mass.

use nalgebra::{Matrix3, Matrix6xX, Vector3};
use opspace_model::{
    Data, FrameId, Model, Motion, Placement, center_of_mass, com_bias_acceleration, com_velocity,
    frame_bias_acceleration, frame_jacobian, frame_placement, frame_velocity, relative_jacobian,
};

/// Controlled frame of a Cartesian task, and the coordinates of its pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControlledFrame {
    /// A frame in the world.
    Frame(FrameId),
    /// A frame in the coordinates of another frame, which can move too.
    Relative {
        /// The controlled frame.
        frame: FrameId,
        /// Frame in whose coordinates the pose is expressed.
        from: FrameId,
    },
    /// The centre of mass of all moving bodies, in the world. It has no orientation.
    CenterOfMass,
}

impl ControlledFrame {
    /// Axes of the coordinates in the world, one per column.
    #[must_use]
    pub fn coordinates(&self, model: &Model, data: &Data) -> Matrix3<f64> {
        match self {
            Self::Frame(_) | Self::CenterOfMass => Matrix3::identity(),
            Self::Relative { from, .. } => frame_placement(model, data, *from).rotation,
        }
    }

    /// Pose of the controlled frame, m.
    #[must_use]
    pub fn placement(&self, model: &Model, data: &Data) -> Placement {
        match self {
            Self::Frame(frame) => frame_placement(model, data, *frame),
            Self::Relative { frame, from } => {
                let [frame, from] = [frame, from].map(|f| frame_placement(model, data, *f));
                Placement {
                    rotation: from.rotation.tr_mul(&frame.rotation),
                    translation: from.rotation.tr_mul(&(frame.translation - from.translation)),
                }
            }
            Self::CenterOfMass => Placement {
                rotation: Matrix3::identity(),
                translation: center_of_mass(model, data).unwrap_or_else(Vector3::zeros),
            },
        }
    }

    /// Velocity of the controlled frame, m/s and rad/s.
    #[must_use]
    pub fn velocity(&self, model: &Model, data: &Data) -> Motion {
        match self {
            Self::Frame(frame) => frame_velocity(model, data, *frame),
            Self::Relative { frame, from } => Between::new(model, data, *frame, *from).velocity(),
            Self::CenterOfMass => Motion { linear: com_velocity(model, data), angular: Vector3::zeros() },
        }
    }

    /// Bias acceleration J̇ q̇, m/s² and rad/s²: the time derivative of [`velocity`](Self::velocity) with q̈ = 0.
    #[must_use]
    pub fn bias_acceleration(&self, model: &Model, data: &Data) -> Motion {
        match self {
            Self::Frame(frame) => frame_bias_acceleration(model, data, *frame),
            Self::Relative { frame, from } => {
                Between::new(model, data, *frame, *from).bias_acceleration(model, data, *frame, *from)
            }
            Self::CenterOfMass => {
                Motion { linear: com_bias_acceleration(model, data), angular: Vector3::zeros() }
            }
        }
    }

    /// Computes J (6 × n), linear rows first: J q̇ is the [`velocity`](Self::velocity).
    ///
    /// # Panics
    /// If `jacobian` does not have n columns.
    pub fn jacobian(&self, model: &Model, data: &Data, jacobian: &mut Matrix6xX<f64>) {
        match self {
            Self::Frame(frame) => frame_jacobian(model, data, *frame, jacobian),
            Self::Relative { frame, from } => relative_jacobian(model, data, *from, *frame, jacobian),
            Self::CenterOfMass => com_rows(model, data, jacobian),
        }
    }

    /// Position in the world, m.
    #[must_use]
    pub fn point(&self, model: &Model, data: &Data) -> Vector3<f64> {
        match self {
            Self::Frame(frame) | Self::Relative { frame, .. } => {
                frame_placement(model, data, *frame).translation
            }
            Self::CenterOfMass => center_of_mass(model, data).unwrap_or_else(Vector3::zeros),
        }
    }

    /// Returns true if the controlled frame has an orientation.
    #[must_use]
    pub fn turns(&self) -> bool {
        *self != Self::CenterOfMass
    }
}

/// Motion of a frame and of the frame that it is relative to, in world axes.
struct Between {
    axes: Matrix3<f64>,
    lever: Vector3<f64>,
    frame: Motion,
    from: Motion,
}

impl Between {
    fn new(model: &Model, data: &Data, frame: FrameId, from: FrameId) -> Self {
        let base = frame_placement(model, data, from);
        Self {
            axes: base.rotation,
            lever: frame_placement(model, data, frame).translation - base.translation,
            frame: frame_velocity(model, data, frame),
            from: frame_velocity(model, data, from),
        }
    }

    /// Velocity of the frame's origin relative to the other frame, which can rotate, m/s; world axes.
    fn seen(&self) -> Vector3<f64> {
        self.frame.linear - self.from.linear - self.from.angular.cross(&self.lever)
    }

    fn velocity(&self) -> Motion {
        Motion {
            linear: self.axes.tr_mul(&self.seen()),
            angular: self.axes.tr_mul(&(self.frame.angular - self.from.angular)),
        }
    }

    /// Bias acceleration relative to the other frame, with the centrifugal and Coriolis terms of its rotation.
    fn bias_acceleration(&self, model: &Model, data: &Data, frame: FrameId, from: FrameId) -> Motion {
        let [of_frame, of_from] = [frame, from].map(|f| frame_bias_acceleration(model, data, f));
        let omega = self.from.angular;
        let transported =
            of_from.linear + of_from.angular.cross(&self.lever) + omega.cross(&omega.cross(&self.lever));
        let linear = of_frame.linear - transported - omega.cross(&self.seen()) * 2.0;
        let angular = of_frame.angular - of_from.angular - omega.cross(&(self.frame.angular - omega));
        Motion { linear: self.axes.tr_mul(&linear), angular: self.axes.tr_mul(&angular) }
    }
}

/// Computes the Jacobian of the centre of mass (first three rows; the others are zero). Each body contributes to the
/// columns of its own joint and of all joints above it in the tree.
fn com_rows(model: &Model, data: &Data, jacobian: &mut Matrix6xX<f64>) {
    assert_eq!(jacobian.ncols(), model.n(), "one Jacobian column a joint");
    jacobian.fill(0.0);
    let mass = model.total_mass();
    if mass <= 0.0 {
        return;
    }
    for (body, placement) in data.placement.iter().enumerate() {
        let inertia = &model.bodies()[body].inertia;
        let com = placement.act_point(&inertia.com) - data.origin;
        let share = inertia.mass / mass;
        let mut ancestor = Some(body);
        while let Some(i) = ancestor {
            let mut column = jacobian.column_mut(model.bodies()[i].joint);
            let mut linear = column.fixed_rows_mut::<3>(0);
            linear += data.screw[i].shifted_to(&com).linear * share;
            ancestor = model.bodies()[i].parent;
        }
    }
}
