//! Force at a frame of the robot, estimated from the torques of the motors instead of a sensor.
//!
//! ```text
//! F = J̄ᵀ r          τ̄ = τ_m + Cᵀ q̇ − g − n̂                                          (T55)
//! ```
//!
//! r is the residual of the [`MomentumObserver`] with the nominal friction n̂ among the known torques. J̄ is the dynamically
//! consistent inverse of the three linear rows of the frame's Jacobian: F is the force that explains the residual with a
//! contact at the frame, and if the contact is elsewhere, the force that would accelerate the frame alike. Directions in
//! which the arm cannot move are damped ([`OperationalSpace`]): a force along them causes no torques. The moment is assumed
//! to be zero, since each further component would take a joint away from the average over the friction of the others.

use nalgebra::{DVector, Matrix6xX, Vector3};
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_model::{Data, Force, FrameId, Inversion, Model, OperationalSpace, frame_jacobian};
use opspace_transformer::{
    FrictionCompensation, FrictionCompensationParameters, FrictionLaw, FrictionParameters, MomentumObserver,
};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Mobility of a direction, relative to the largest one, below which its force is damped.
pub const DAMPED_BELOW: f64 = 0.01;

/// A force sensor that is computed from the torques of the motors.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct EstimatedForceParameters {
    /// Frame at whose origin the force is assumed to act.
    pub frame: String,
    /// Corner frequency of the estimate, rad/s.
    #[serde(default = "default_observer")]
    pub observer_rad_per_s: Positive,
    /// Fraction of the nominal joint friction that is taken off.
    #[serde(default = "default_fraction")]
    pub friction_fraction: NonNegative,
}

const fn default_observer() -> Positive {
    Positive::literal(60.0)
}

const fn default_fraction() -> NonNegative {
    NonNegative::literal(1.0)
}

/// Estimate of the force at a frame: see the [module](self). Allocates only when it is created.
#[derive(Clone, Debug)]
pub struct EstimatedForce {
    /// Name of the sensor.
    pub(crate) name: String,
    frame: FrameId,
    observer: MomentumObserver,
    friction: FrictionCompensation,
    jacobian: Matrix6xX<f64>,
    space: OperationalSpace,
    force: Force,
}

impl EstimatedForce {
    /// Returns the sensor `name` at a frame of an arm with this nominal friction (n joints).
    #[must_use]
    pub fn new<'a>(
        name: &str,
        frame: FrameId,
        parameters: &EstimatedForceParameters,
        friction: impl ExactSizeIterator<Item = &'a FrictionParameters>,
    ) -> Self {
        let n = friction.len();
        // The friction at the motion that the joints have: it reverses over their presliding displacement.
        let compensation = FrictionCompensationParameters {
            gain: parameters.friction_fraction,
            follows: FrictionLaw::Displacement,
            ..FrictionCompensationParameters::default()
        };
        Self {
            name: name.to_owned(),
            frame,
            observer: MomentumObserver::new(n, parameters.observer_rad_per_s),
            friction: FrictionCompensation::new(friction, &compensation),
            jacobian: Matrix6xX::zeros(n),
            space: OperationalSpace::new(n),
            force: Force::zero(),
        }
    }

    /// Updates the estimate with a sample, `elapsed_s` (s) after the previous one, and the mean `driving` of
    /// τ_m + Cᵀ q̇ − g since then (n; Nm, N). `known` (n) is overwritten.
    pub(crate) fn update(
        &mut self,
        model: &Model,
        data: &Data,
        elapsed_s: f64,
        driving: &DVector<f64>,
        known: &mut DVector<f64>,
    ) {
        self.friction.advance(data.q.as_slice());
        for (i, (known, driving)) in known.iter_mut().zip(driving).enumerate() {
            *known = driving - self.friction.torque(i, data.dq[i]);
        }
        self.observer.update(elapsed_s, &data.momentum, known);
        frame_jacobian(model, data, self.frame, &mut self.jacobian);
        let factor = &data.mass_matrix_factor;
        self.space.update_inertia(factor, &self.jacobian, 3, Inversion::Damped(DAMPED_BELOW), None, None);
        // J̄ᵀ r = Λ J M⁻¹ r
        known.copy_from(self.observer.residual());
        factor.solve(known.as_mut_slice());
        let mut acceleration = Vector3::zeros();
        for (column, ddq) in self.jacobian.column_iter().zip(known.iter()) {
            acceleration += column.fixed_rows::<3>(0) * *ddq;
        }
        let force = self.space.task_inertia.fixed_view::<3, 3>(0, 0) * acceleration;
        self.force = Force { linear: force, angular: Vector3::zeros() };
    }

    /// Estimated force ON the robot (N; world axes); its moment is zero.
    pub(crate) fn force(&self) -> Force {
        self.force
    }

    /// Residual torques r (n; Nm, N).
    pub(crate) fn residual(&self) -> &DVector<f64> {
        self.observer.residual()
    }

    /// Starts the estimate anew, at zero.
    pub(crate) fn reset(&mut self) {
        self.observer.reset();
        self.friction.reset();
        self.force = Force::zero();
    }
}
