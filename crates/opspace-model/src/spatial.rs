//! Rigid-body quantities as pairs of 3-vectors: placements, motions, forces and inertias.
//!
//! The linear part precedes the angular part everywhere in opspace. No 6×6 matrix is formed: the products below are
//! Featherstone's spatial operators (RBDA, table 2.1) without their zero entries.
//!
//! ```
//! use nalgebra::Vector3;
//! use opspace_model::{Force, Motion, Placement};
//!
//! // Power is the same in any frame.
//! let place = Placement::from_rpy([0.1, -0.4, 2.0], [0.3, 0.0, -0.2]);
//! let v = Motion { linear: Vector3::new(0.1, 0.2, 0.3), angular: Vector3::new(1.0, -1.0, 0.5) };
//! let f = Force { linear: Vector3::new(3.0, 0.0, 1.0), angular: Vector3::new(0.0, 0.2, 0.1) };
//! let there = place.act_motion(&v).dot(&place.act_force(&f));
//! assert!((there - v.dot(&f)).abs() < 1e-15);
//! ```

use crate::real::Real;
use nalgebra::{Matrix3, Rotation3, SymmetricEigen, Vector3};
use std::ops::{Add, AddAssign, Mul, Neg, Sub};

/// Pose of a frame B in a frame A: `p_A = rotation · p_B + translation` (m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement<T = f64> {
    /// Rotation matrix from B to A: its columns are the axes of B in A.
    pub rotation: Matrix3<T>,
    /// Origin of B in A, m.
    pub translation: Vector3<T>,
}

impl Placement {
    /// Returns the placement given by the URDF attributes `rpy` (rad; rotations about the fixed axes x, y, z in that
    /// order) and `xyz` (m).
    #[must_use]
    pub fn from_rpy(rpy: [f64; 3], xyz: [f64; 3]) -> Self {
        Self {
            rotation: *Rotation3::from_euler_angles(rpy[0], rpy[1], rpy[2]).matrix(),
            translation: Vector3::from(xyz),
        }
    }

    /// Returns this placement, copied to every lane.
    #[must_use]
    pub fn splat<T: Real>(&self) -> Placement<T> {
        Placement { rotation: self.rotation.map(T::splat), translation: self.translation.map(T::splat) }
    }
}

impl<T: Real> Placement<T> {
    /// Returns the identity: the placement of two coincident frames.
    #[must_use]
    pub fn identity() -> Self {
        Self { rotation: Matrix3::identity(), translation: Vector3::zeros() }
    }

    /// Returns the inverse placement: the pose of A in B.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self { rotation, translation: -(rotation * self.translation) }
    }

    /// Transforms a point (m) from B to A.
    #[inline]
    #[must_use]
    pub fn act_point(&self, point: &Vector3<T>) -> Vector3<T> {
        apply(&self.rotation, point) + self.translation
    }

    /// Transforms a motion from B (at the origin and in the axes of B) to A.
    #[inline]
    #[must_use]
    pub fn act_motion(&self, m: &Motion<T>) -> Motion<T> {
        let angular = self.rotation * m.angular;
        Motion { linear: self.rotation * m.linear + self.translation.cross(&angular), angular }
    }

    /// Transforms a motion from A to B, the inverse of [`act_motion`](Self::act_motion).
    #[inline]
    #[must_use]
    pub fn act_inverse_motion(&self, m: &Motion<T>) -> Motion<T> {
        Motion {
            linear: self.rotation.tr_mul(&(m.linear - self.translation.cross(&m.angular))),
            angular: self.rotation.tr_mul(&m.angular),
        }
    }

    /// Transforms a force from B (at the origin and in the axes of B) to A.
    #[inline]
    #[must_use]
    pub fn act_force(&self, f: &Force<T>) -> Force<T> {
        let linear = self.rotation * f.linear;
        Force { linear, angular: self.rotation * f.angular + self.translation.cross(&linear) }
    }

    /// Transforms an inertia from B to A.
    #[inline]
    #[must_use]
    pub fn act_inertia(&self, inertia: &Inertia<T>) -> Inertia<T> {
        Inertia {
            mass: inertia.mass,
            com: self.act_point(&inertia.com),
            rotational: self.rotation * inertia.rotational * self.rotation.transpose(),
        }
    }
}

impl<T: Real> Mul for Placement<T> {
    type Output = Self;

    /// Returns the product of placements: `X_AC = X_AB · X_BC`.
    #[inline]
    fn mul(self, other: Self) -> Self {
        Self {
            rotation: product(&self.rotation, &other.rotation),
            translation: self.act_point(&other.translation),
        }
    }
}

/// A spatial velocity (m/s, rad/s) or acceleration (m/s², rad/s²).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion<T = f64> {
    /// Linear velocity (acceleration) of the body point at the origin of the frame, m/s (m/s²).
    pub linear: Vector3<T>,
    /// Angular velocity (acceleration) of the body, rad/s (rad/s²).
    pub angular: Vector3<T>,
}

/// A force with its moment about the origin of the frame (N, Nm), or a momentum (Ns, Nms).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Force<T = f64> {
    /// Force, N (linear momentum, Ns).
    pub linear: Vector3<T>,
    /// Moment about the origin of the frame, Nm (angular momentum, Nms).
    pub angular: Vector3<T>,
}

impl<T: Real> Motion<T> {
    /// Returns the zero motion.
    #[must_use]
    pub fn zero() -> Self {
        Self { linear: Vector3::zeros(), angular: Vector3::zeros() }
    }

    /// Returns this motion with the linear part taken at `point` (m), given relative to the current origin.
    #[inline]
    #[must_use]
    pub fn shifted_to(&self, point: &Vector3<T>) -> Self {
        Self { linear: self.linear + self.angular.cross(point), angular: self.angular }
    }

    /// Returns this motion in other axes: `rotation` maps the current axes to the new ones.
    #[inline]
    #[must_use]
    pub fn rotated(&self, rotation: &Matrix3<T>) -> Self {
        Self { linear: apply(rotation, &self.linear), angular: apply(rotation, &self.angular) }
    }

    /// Returns this motion in the axes that are the columns of `rotation`.
    #[inline]
    #[must_use]
    pub fn rotated_inverse(&self, rotation: &Matrix3<T>) -> Self {
        Self {
            linear: apply_transposed(rotation, &self.linear),
            angular: apply_transposed(rotation, &self.angular),
        }
    }

    /// Returns `v × m`: the rate of change of a motion `m` that is fixed in a frame moving with velocity `self` (RBDA
    /// eq. 2.31).
    #[inline]
    #[must_use]
    pub fn cross_motion(&self, m: &Motion<T>) -> Motion<T> {
        Motion {
            linear: self.angular.cross(&m.linear) + self.linear.cross(&m.angular),
            angular: self.angular.cross(&m.angular),
        }
    }

    /// Returns `v ×* f`: the rate of change of a force `f` that is fixed in a frame moving with velocity `self` (RBDA
    /// eq. 2.32).
    #[inline]
    #[must_use]
    pub fn cross_force(&self, f: &Force<T>) -> Force<T> {
        Force {
            linear: self.angular.cross(&f.linear),
            angular: self.angular.cross(&f.angular) + self.linear.cross(&f.linear),
        }
    }

    /// Returns the power of force `f` on this velocity, W.
    #[inline]
    #[must_use]
    pub fn dot(&self, f: &Force<T>) -> T {
        self.linear.dot(&f.linear) + self.angular.dot(&f.angular)
    }
}

impl<T: Real> Force<T> {
    /// Returns the zero force.
    #[must_use]
    pub fn zero() -> Self {
        Self { linear: Vector3::zeros(), angular: Vector3::zeros() }
    }

    /// Returns this force with its moment about `point` (m), given relative to the current origin.
    #[inline]
    #[must_use]
    pub fn shifted_to(&self, point: &Vector3<T>) -> Self {
        Self { linear: self.linear, angular: self.angular - point.cross(&self.linear) }
    }
}

/// Implements addition, negation and scaling, for motions and for forces.
macro_rules! pair_arithmetic {
    ($t:ident) => {
        impl<T: Real> Add for $t<T> {
            type Output = Self;
            #[inline]
            fn add(self, o: Self) -> Self {
                Self { linear: self.linear + o.linear, angular: self.angular + o.angular }
            }
        }
        impl<T: Real> AddAssign for $t<T> {
            #[inline]
            fn add_assign(&mut self, o: Self) {
                self.linear += o.linear;
                self.angular += o.angular;
            }
        }
        impl<T: Real> AddAssign<&Self> for $t<T> {
            #[inline]
            fn add_assign(&mut self, o: &Self) {
                self.linear += o.linear;
                self.angular += o.angular;
            }
        }
        impl<T: Real> Sub for $t<T> {
            type Output = Self;
            #[inline]
            fn sub(self, o: Self) -> Self {
                Self { linear: self.linear - o.linear, angular: self.angular - o.angular }
            }
        }
        impl<T: Real> Neg for $t<T> {
            type Output = Self;
            #[inline]
            fn neg(self) -> Self {
                Self { linear: -self.linear, angular: -self.angular }
            }
        }
        impl<T: Real> Mul<T> for $t<T> {
            type Output = Self;
            #[inline]
            fn mul(self, s: T) -> Self {
                Self { linear: self.linear * s, angular: self.angular * s }
            }
        }
    };
}
pair_arithmetic!(Motion);
pair_arithmetic!(Force);

/// Mass, centre of mass and rotational inertia of a rigid body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inertia<T = f64> {
    /// Mass, kg.
    pub mass: T,
    /// Centre of mass in the body's frame, m.
    pub com: Vector3<T>,
    /// Rotational inertia about the centre of mass, in the body's axes, kg m².
    pub rotational: Matrix3<T>,
}

impl Inertia {
    /// Returns this inertia, copied to every lane.
    #[must_use]
    pub fn splat<T: Real>(&self) -> Inertia<T> {
        Inertia {
            mass: T::splat(self.mass),
            com: self.com.map(T::splat),
            rotational: self.rotational.map(T::splat),
        }
    }
}

impl<T: Real> Inertia<T> {
    /// Returns the zero inertia.
    #[must_use]
    pub fn zero() -> Self {
        Self { mass: T::zero(), com: Vector3::zeros(), rotational: Matrix3::zeros() }
    }
}

impl Add for Inertia {
    type Output = Self;

    /// Returns the inertia of two rigidly connected bodies (parallel-axis theorem). Rotational inertias of massless
    /// bodies are included.
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

/// Largest number of iterations of a decomposition; some ten are enough.
const MAX_ITERATIONS: usize = 1000;

/// Returns the principal moments (eigenvalues) of a rotational inertia in ascending order, kg m²; NaN if it has a number
/// that is not finite.
#[must_use]
pub fn principal_moments(rotational: &Matrix3<f64>) -> [f64; 3] {
    // Scaled to order one first, because the square of a tiny or huge moment under- or overflows.
    let scale = rotational.amax();
    if scale == 0.0 {
        return [0.0; 3];
    }
    if !scale.is_finite() || rotational.iter().any(|moment| moment.is_nan()) {
        return [f64::NAN; 3];
    }
    let Some(decomposed) = SymmetricEigen::try_new(rotational / scale, f64::EPSILON, MAX_ITERATIONS) else {
        return [f64::NAN; 3];
    };
    let mut moments: [f64; 3] = (decomposed.eigenvalues * scale).into();
    moments.sort_by(f64::total_cmp);
    moments
}

/// Inertia of a rigid body about a fixed point, in fixed axes: `[f; n] = [m, −h×; h×, I] [v; ω]`, with the blocks of
/// RBDA eq. 2.63. The inertia of rigidly connected bodies is the sum of their inertias.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpatialInertia<T = f64> {
    /// Mass m, kg.
    pub mass: T,
    /// First moment h: mass times the position of the centre of mass relative to the point, kg m.
    pub first_moment: Vector3<T>,
    /// Second moment I: rotational inertia about the point, kg m².
    pub second_moment: Matrix3<T>,
}

impl<T: Real> SpatialInertia<T> {
    /// Returns the zero inertia.
    #[must_use]
    pub fn zero() -> Self {
        Self { mass: T::zero(), first_moment: Vector3::zeros(), second_moment: Matrix3::zeros() }
    }

    /// Returns the inertia of a body about a point: `rotation` maps body axes to the fixed axes, and `com` is the
    /// centre of mass relative to the point, in the fixed axes (m).
    #[inline]
    #[must_use]
    pub fn new(inertia: &Inertia<T>, rotation: &Matrix3<T>, com: &Vector3<T>) -> Self {
        let first_moment = com * inertia.mass;
        let turned = rotate_inertia(rotation, &inertia.rotational);
        Self { mass: inertia.mass, first_moment, second_moment: turned + parallel_axis(com, &first_moment) }
    }

    /// Returns the momentum of a body with velocity `v`, or I a for an acceleration `v`.
    #[inline]
    #[must_use]
    pub fn apply(&self, v: &Motion<T>) -> Force<T> {
        Force {
            linear: v.linear * self.mass - self.first_moment.cross(&v.angular),
            angular: apply(&self.second_moment, &v.angular) + self.first_moment.cross(&v.linear),
        }
    }
}

impl<T: Real> AddAssign<&Self> for SpatialInertia<T> {
    #[inline]
    fn add_assign(&mut self, o: &Self) {
        self.mass += o.mass;
        self.first_moment += o.first_moment;
        self.second_moment += o.second_moment;
    }
}

/// Returns R A Rᵀ for a symmetric A.
#[inline]
fn rotate_inertia<T: Real>(rotation: &Matrix3<T>, a: &Matrix3<T>) -> Matrix3<T> {
    let half = product(rotation, a);
    let entry = |r: usize, c: usize| {
        half[(r, 0)] * rotation[(c, 0)] + half[(r, 1)] * rotation[(c, 1)] + half[(r, 2)] * rotation[(c, 2)]
    };
    let (xx, xy, xz) = (entry(0, 0), entry(0, 1), entry(0, 2));
    let (yy, yz, zz) = (entry(1, 1), entry(1, 2), entry(2, 2));
    Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
}

/// Returns A x. Like [`product`] and [`apply_transposed`], it is written out: the operators of nalgebra are equally
/// fast for one number but store intermediate results in memory for lanes.
#[inline]
pub(crate) fn apply<T: Real>(a: &Matrix3<T>, x: &Vector3<T>) -> Vector3<T> {
    a.column(0) * x.x + a.column(1) * x.y + a.column(2) * x.z
}

/// Returns Aᵀ x.
#[inline]
pub(crate) fn apply_transposed<T: Real>(a: &Matrix3<T>, x: &Vector3<T>) -> Vector3<T> {
    let row = |c: usize| a[(0, c)] * x.x + a[(1, c)] * x.y + a[(2, c)] * x.z;
    Vector3::new(row(0), row(1), row(2))
}

/// Returns A B.
#[inline]
fn product<T: Real>(a: &Matrix3<T>, b: &Matrix3<T>) -> Matrix3<T> {
    let column = |c: usize| a.column(0) * b[(0, c)] + a.column(1) * b[(1, c)] + a.column(2) * b[(2, c)];
    Matrix3::from_columns(&[column(0), column(1), column(2)])
}

/// Returns the parallel-axis term (c·h) 1 − c hᵀ with h = m c.
#[inline]
fn parallel_axis<T: Real>(c: &Vector3<T>, h: &Vector3<T>) -> Matrix3<T> {
    let (xx, yy, zz) = (c.x * h.x, c.y * h.y, c.z * h.z);
    let (xy, xz, yz) = (-c.x * h.y, -c.x * h.z, -c.y * h.z);
    Matrix3::new(yy + zz, xy, xz, xy, xx + zz, yz, xz, yz, xx + yy)
}

/// Returns the matrix of the cross product `x ×`.
#[inline]
pub(crate) fn skew<T: Real>(x: &Vector3<T>) -> Matrix3<T> {
    let o = T::zero();
    Matrix3::new(o, -x.z, x.y, x.z, o, -x.x, -x.y, x.x, o)
}
