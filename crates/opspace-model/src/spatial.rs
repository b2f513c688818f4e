//! Rigid-body quantities as pairs of 3-vectors: placements, motions, forces and inertias.
//!
//! Linear part first, angular part second, everywhere in opspace. A 6×6 matrix is never formed: the
//! products below are what Featherstone's spatial operators (RBDA, table 2.1) come to when their
//! zeros are left out.

use nalgebra::{Matrix3, Rotation3, Vector3};
use std::ops::{Add, AddAssign, Mul, Neg, Sub};

/// The pose of a frame B in a frame A: `p_A = rotation · p_B + translation` (m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Axes of B in A.
    pub rotation: Matrix3<f64>,
    /// Origin of B in A, m.
    pub translation: Vector3<f64>,
}

impl Placement {
    /// The two frames coincide.
    #[must_use]
    pub fn identity() -> Self {
        Self { rotation: Matrix3::identity(), translation: Vector3::zeros() }
    }

    /// A placement from URDF's `rpy` (rad; fixed axes x, y, z in that order) and `xyz` (m).
    #[must_use]
    pub fn from_rpy(rpy: [f64; 3], xyz: [f64; 3]) -> Self {
        Self {
            rotation: *Rotation3::from_euler_angles(rpy[0], rpy[1], rpy[2]).matrix(),
            translation: Vector3::from(xyz),
        }
    }

    /// The pose of A in B.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self { rotation, translation: -(rotation * self.translation) }
    }

    /// A point given in B, in A (m).
    #[must_use]
    pub fn act_point(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.translation
    }

    /// A motion given at B's origin in B's axes, at A's origin in A's axes.
    #[inline]
    #[must_use]
    pub fn act_motion(&self, m: &Motion) -> Motion {
        let angular = self.rotation * m.angular;
        Motion { linear: self.rotation * m.linear + self.translation.cross(&angular), angular }
    }

    /// A motion given in A, in B: the inverse of [`act_motion`](Self::act_motion).
    #[inline]
    #[must_use]
    pub fn act_inverse_motion(&self, m: &Motion) -> Motion {
        Motion {
            linear: self.rotation.tr_mul(&(m.linear - self.translation.cross(&m.angular))),
            angular: self.rotation.tr_mul(&m.angular),
        }
    }

    /// A force given at B's origin in B's axes, at A's origin in A's axes.
    #[inline]
    #[must_use]
    pub fn act_force(&self, f: &Force) -> Force {
        let linear = self.rotation * f.linear;
        Force { linear, angular: self.rotation * f.angular + self.translation.cross(&linear) }
    }

    /// An inertia given in B, in A.
    #[must_use]
    pub fn act_inertia(&self, inertia: &Inertia) -> Inertia {
        Inertia {
            mass: inertia.mass,
            com: self.act_point(&inertia.com),
            rotational: self.rotation * inertia.rotational * self.rotation.transpose(),
        }
    }
}

impl Mul for Placement {
    type Output = Self;

    /// `X_AC = X_AB · X_BC`.
    #[inline]
    fn mul(self, other: Self) -> Self {
        Self {
            rotation: self.rotation * other.rotation,
            translation: self.rotation * other.translation + self.translation,
        }
    }
}

/// A velocity (m/s, rad/s) or an acceleration (m/s², rad/s²).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Of the body's point at the frame's origin.
    pub linear: Vector3<f64>,
    /// Of the body.
    pub angular: Vector3<f64>,
}

/// A force and the moment about the frame's origin (N, Nm); also a momentum (Ns, Nms).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Force {
    /// Force, N.
    pub linear: Vector3<f64>,
    /// Moment about the frame's origin, Nm.
    pub angular: Vector3<f64>,
}

impl Motion {
    /// At rest.
    #[must_use]
    pub fn zero() -> Self {
        Self { linear: Vector3::zeros(), angular: Vector3::zeros() }
    }

    /// `v ×`: the rate of change of a motion fixed in a frame that moves with `self` (RBDA eq. 2.31).
    #[inline]
    #[must_use]
    pub fn cross_motion(&self, m: &Motion) -> Motion {
        Motion {
            linear: self.angular.cross(&m.linear) + self.linear.cross(&m.angular),
            angular: self.angular.cross(&m.angular),
        }
    }

    /// `v ×*`: the same for a force (RBDA eq. 2.32).
    #[inline]
    #[must_use]
    pub fn cross_force(&self, f: &Force) -> Force {
        Force {
            linear: self.angular.cross(&f.linear),
            angular: self.angular.cross(&f.angular) + self.linear.cross(&f.linear),
        }
    }

    /// The power of a force on this motion, W.
    #[must_use]
    pub fn dot(&self, f: &Force) -> f64 {
        self.linear.dot(&f.linear) + self.angular.dot(&f.angular)
    }
}

impl Force {
    /// No force.
    #[must_use]
    pub fn zero() -> Self {
        Self { linear: Vector3::zeros(), angular: Vector3::zeros() }
    }
}

/// Sums and scalings, the same for motions and forces.
macro_rules! pair_arithmetic {
    ($t:ident) => {
        impl Add for $t {
            type Output = Self;
            #[inline]
            fn add(self, o: Self) -> Self {
                Self { linear: self.linear + o.linear, angular: self.angular + o.angular }
            }
        }
        impl AddAssign for $t {
            #[inline]
            fn add_assign(&mut self, o: Self) {
                self.linear += o.linear;
                self.angular += o.angular;
            }
        }
        impl Sub for $t {
            type Output = Self;
            #[inline]
            fn sub(self, o: Self) -> Self {
                Self { linear: self.linear - o.linear, angular: self.angular - o.angular }
            }
        }
        impl Neg for $t {
            type Output = Self;
            #[inline]
            fn neg(self) -> Self {
                Self { linear: -self.linear, angular: -self.angular }
            }
        }
        impl Mul<f64> for $t {
            type Output = Self;
            #[inline]
            fn mul(self, s: f64) -> Self {
                Self { linear: self.linear * s, angular: self.angular * s }
            }
        }
    };
}
pair_arithmetic!(Motion);
pair_arithmetic!(Force);

/// Mass, centre of mass and rotational inertia of a rigid body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inertia {
    /// kg.
    pub mass: f64,
    /// Centre of mass in the body's frame, m.
    pub com: Vector3<f64>,
    /// Rotational inertia about the centre of mass, in the body's axes, kg m².
    pub rotational: Matrix3<f64>,
}

impl Inertia {
    /// No mass.
    #[must_use]
    pub fn zero() -> Self {
        Self { mass: 0.0, com: Vector3::zeros(), rotational: Matrix3::zeros() }
    }

    /// The momentum of the body moving at `v`, or its inertial force under the acceleration `v`.
    #[inline]
    #[must_use]
    pub fn apply(&self, v: &Motion) -> Force {
        let linear = (v.linear - self.com.cross(&v.angular)) * self.mass;
        Force { linear, angular: self.rotational * v.angular + self.com.cross(&linear) }
    }
}

impl Add for Inertia {
    type Output = Self;

    /// Two bodies joined rigidly (parallel-axis theorem). Massless ones keep their rotational part.
    fn add(self, o: Self) -> Self {
        let mass = self.mass + o.mass;
        if mass == 0.0 {
            return Self { mass, com: self.com, rotational: self.rotational + o.rotational };
        }
        let d = self.com - o.com;
        let reduced = self.mass * o.mass / mass;
        Self {
            mass,
            com: (self.com * self.mass + o.com * o.mass) / mass,
            rotational: self.rotational
                + o.rotational
                + (Matrix3::from_diagonal_element(d.norm_squared()) - d * d.transpose()) * reduced,
        }
    }
}
