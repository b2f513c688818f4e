//! Rigid-body quantities as pairs of 3-vectors: placements, motions, forces and inertias.
//!
//! Linear part first, angular part second, everywhere in opspace. A 6×6 matrix is never formed: the
//! products below are Featherstone's spatial operators (RBDA, table 2.1) with their zeros left out.
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
use nalgebra::{Matrix3, Rotation3, Vector3};
use std::ops::{Add, AddAssign, Mul, Neg, Sub};

/// Pose of a frame B in a frame A: `p_A = rotation · p_B + translation` (m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement<T = f64> {
    /// Axes of B in A.
    pub rotation: Matrix3<T>,
    /// Origin of B in A, m.
    pub translation: Vector3<T>,
}

impl Placement {
    /// Returns the placement of URDF's `rpy` (rad; fixed axes x, y, z in that order) and `xyz` (m).
    #[must_use]
    pub fn from_rpy(rpy: [f64; 3], xyz: [f64; 3]) -> Self {
        Self {
            rotation: *Rotation3::from_euler_angles(rpy[0], rpy[1], rpy[2]).matrix(),
            translation: Vector3::from(xyz),
        }
    }

    /// Returns this placement in every lane.
    #[must_use]
    pub fn splat<T: Real>(&self) -> Placement<T> {
        Placement { rotation: self.rotation.map(T::splat), translation: self.translation.map(T::splat) }
    }
}

impl<T: Real> Placement<T> {
    /// Placement of two frames that coincide.
    #[must_use]
    pub fn identity() -> Self {
        Self { rotation: Matrix3::identity(), translation: Vector3::zeros() }
    }

    /// Pose of A in B.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self { rotation, translation: -(rotation * self.translation) }
    }

    /// Transforms a point given in B to A (m).
    #[inline]
    #[must_use]
    pub fn act_point(&self, point: &Vector3<T>) -> Vector3<T> {
        apply(&self.rotation, point) + self.translation
    }

    /// Transforms a motion given at B's origin in B's axes to A's origin in A's axes.
    #[inline]
    #[must_use]
    pub fn act_motion(&self, m: &Motion<T>) -> Motion<T> {
        let angular = self.rotation * m.angular;
        Motion { linear: self.rotation * m.linear + self.translation.cross(&angular), angular }
    }

    /// Transforms a motion given in A to B: the inverse of [`act_motion`](Self::act_motion).
    #[inline]
    #[must_use]
    pub fn act_inverse_motion(&self, m: &Motion<T>) -> Motion<T> {
        Motion {
            linear: self.rotation.tr_mul(&(m.linear - self.translation.cross(&m.angular))),
            angular: self.rotation.tr_mul(&m.angular),
        }
    }

    /// Transforms a force given at B's origin in B's axes to A's origin in A's axes.
    #[inline]
    #[must_use]
    pub fn act_force(&self, f: &Force<T>) -> Force<T> {
        let linear = self.rotation * f.linear;
        Force { linear, angular: self.rotation * f.angular + self.translation.cross(&linear) }
    }

    /// Transforms an inertia given in B to A.
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

    /// Product of placements: `X_AC = X_AB · X_BC`.
    #[inline]
    fn mul(self, other: Self) -> Self {
        Self {
            rotation: product(&self.rotation, &other.rotation),
            translation: self.act_point(&other.translation),
        }
    }
}

/// A velocity (m/s, rad/s) or an acceleration (m/s², rad/s²).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion<T = f64> {
    /// Velocity (acceleration) of the body's point at the frame's origin.
    pub linear: Vector3<T>,
    /// Angular velocity (acceleration) of the body.
    pub angular: Vector3<T>,
}

/// A force and the moment about the frame's origin (N, Nm); also a momentum (Ns, Nms).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Force<T = f64> {
    /// Force, N.
    pub linear: Vector3<T>,
    /// Moment about the frame's origin, Nm.
    pub angular: Vector3<T>,
}

impl<T: Real> Motion<T> {
    /// Motion of a body at rest: zero.
    #[must_use]
    pub fn zero() -> Self {
        Self { linear: Vector3::zeros(), angular: Vector3::zeros() }
    }

    /// Motion of the body's point at `point` from the frame's origin.
    #[inline]
    #[must_use]
    pub fn shifted_to(&self, point: &Vector3<T>) -> Self {
        Self { linear: self.linear + self.angular.cross(point), angular: self.angular }
    }

    /// Motion in new axes: `rotation` has the axes used so far in the new ones.
    #[inline]
    #[must_use]
    pub fn rotated(&self, rotation: &Matrix3<T>) -> Self {
        Self { linear: apply(rotation, &self.linear), angular: apply(rotation, &self.angular) }
    }

    /// Motion in the axes that are the columns of `rotation`.
    #[inline]
    #[must_use]
    pub fn rotated_inverse(&self, rotation: &Matrix3<T>) -> Self {
        Self {
            linear: apply_transposed(rotation, &self.linear),
            angular: apply_transposed(rotation, &self.angular),
        }
    }

    /// `v ×`: the rate of change of a motion fixed in a frame that moves with `self` (RBDA eq. 2.31).
    #[inline]
    #[must_use]
    pub fn cross_motion(&self, m: &Motion<T>) -> Motion<T> {
        Motion {
            linear: self.angular.cross(&m.linear) + self.linear.cross(&m.angular),
            angular: self.angular.cross(&m.angular),
        }
    }

    /// `v ×*`: the rate of change of a force fixed in a frame that moves with `self` (RBDA eq. 2.32).
    #[inline]
    #[must_use]
    pub fn cross_force(&self, f: &Force<T>) -> Force<T> {
        Force {
            linear: self.angular.cross(&f.linear),
            angular: self.angular.cross(&f.angular) + self.linear.cross(&f.linear),
        }
    }

    /// Power of a force on this motion, W.
    #[inline]
    #[must_use]
    pub fn dot(&self, f: &Force<T>) -> T {
        self.linear.dot(&f.linear) + self.angular.dot(&f.angular)
    }
}

impl<T: Real> Force<T> {
    /// Zero force.
    #[must_use]
    pub fn zero() -> Self {
        Self { linear: Vector3::zeros(), angular: Vector3::zeros() }
    }

    /// Returns this force with its moment taken about `point`, given relative to the point used so far.
    #[inline]
    #[must_use]
    pub fn shifted_to(&self, point: &Vector3<T>) -> Self {
        Self { linear: self.linear, angular: self.angular - point.cross(&self.linear) }
    }
}

/// Sums and scalings of motions and forces alike.
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
    /// Returns this inertia in every lane.
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
    /// Inertia of a body without mass.
    #[must_use]
    pub fn zero() -> Self {
        Self { mass: T::zero(), com: Vector3::zeros(), rotational: Matrix3::zeros() }
    }
}

impl Add for Inertia {
    type Output = Self;

    /// Inertia of two bodies joined rigidly (parallel-axis theorem). Massless ones keep their rotational part.
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

/// Eigenvalues of a rotational inertia, ascending, kg m².
#[must_use]
pub fn principal_moments(rotational: &Matrix3<f64>) -> [f64; 3] {
    // Of order one first: the square of a tiny or huge moment is zero or infinite.
    let scale = rotational.amax();
    if scale == 0.0 {
        return [0.0; 3];
    }
    let mut moments: [f64; 3] = ((rotational / scale).symmetric_eigenvalues() * scale).into();
    moments.sort_by(f64::total_cmp);
    moments
}

/// Rigid body's inertia about a fixed point, in fixed axes: the blocks of RBDA eq. 2.63,
/// `[f; n] = [m, −h×; h×, I] [v; ω]`. The inertias of bodies that move as one are summed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpatialInertia<T = f64> {
    /// m, kg.
    pub mass: T,
    /// h: mass times the position of the centre of mass, kg m.
    pub first_moment: Vector3<T>,
    /// I: rotational inertia about the point, kg m².
    pub second_moment: Matrix3<T>,
}

impl<T: Real> SpatialInertia<T> {
    /// Inertia of a body without mass.
    #[must_use]
    pub fn zero() -> Self {
        Self { mass: T::zero(), first_moment: Vector3::zeros(), second_moment: Matrix3::zeros() }
    }

    /// Returns the inertia of a body in a frame of which `rotation` gives the axes, with its centre of mass at `com`.
    #[inline]
    #[must_use]
    pub fn new(inertia: &Inertia<T>, rotation: &Matrix3<T>, com: &Vector3<T>) -> Self {
        let first_moment = com * inertia.mass;
        let turned = rotate_inertia(rotation, &inertia.rotational);
        Self { mass: inertia.mass, first_moment, second_moment: turned + parallel_axis(com, &first_moment) }
    }

    /// Momentum of the body moving at `v`, or its inertial force under the acceleration `v`.
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

/// R A Rᵀ of a symmetric A.
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

/// A x. Written out, as [`product`] and [`apply_transposed`] are: nalgebra's own are as fast for one number, but pass
/// through memory for lanes.
#[inline]
pub(crate) fn apply<T: Real>(a: &Matrix3<T>, x: &Vector3<T>) -> Vector3<T> {
    a.column(0) * x.x + a.column(1) * x.y + a.column(2) * x.z
}

/// Aᵀ x.
#[inline]
pub(crate) fn apply_transposed<T: Real>(a: &Matrix3<T>, x: &Vector3<T>) -> Vector3<T> {
    let row = |c: usize| a[(0, c)] * x.x + a[(1, c)] * x.y + a[(2, c)] * x.z;
    Vector3::new(row(0), row(1), row(2))
}

/// A B.
#[inline]
fn product<T: Real>(a: &Matrix3<T>, b: &Matrix3<T>) -> Matrix3<T> {
    let column = |c: usize| a.column(0) * b[(0, c)] + a.column(1) * b[(1, c)] + a.column(2) * b[(2, c)];
    Matrix3::from_columns(&[column(0), column(1), column(2)])
}

/// (c·h) 1 − c hᵀ with h = m c: the term of the parallel-axis theorem.
#[inline]
fn parallel_axis<T: Real>(c: &Vector3<T>, h: &Vector3<T>) -> Matrix3<T> {
    let (xx, yy, zz) = (c.x * h.x, c.y * h.y, c.z * h.z);
    let (xy, xz, yz) = (-c.x * h.y, -c.x * h.z, -c.y * h.z);
    Matrix3::new(yy + zz, xy, xz, xy, xx + zz, yz, xz, yz, xx + yy)
}

/// `x ×` as a matrix.
#[inline]
pub(crate) fn skew<T: Real>(x: &Vector3<T>) -> Matrix3<T> {
    let o = T::zero();
    Matrix3::new(o, -x.z, x.y, x.z, o, -x.x, -x.y, x.x, o)
}
