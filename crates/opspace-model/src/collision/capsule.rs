//! Capsules and half-spaces.

use super::segment::Segment;
use crate::spatial::Placement;
use nalgebra::Vector3;

/// Set of all points within a radius of a line segment. If its ends coincide, it is a sphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Capsule {
    /// First end of the axis, m.
    pub start_m: Vector3<f64>,
    /// Second end of the axis, m.
    pub end_m: Vector3<f64>,
    /// Radius, m.
    pub radius_m: f64,
}

impl Capsule {
    /// Returns the sphere with this centre and radius (m).
    #[must_use]
    pub fn sphere(center_m: Vector3<f64>, radius_m: f64) -> Self {
        Self { start_m: center_m, end_m: center_m, radius_m }
    }

    /// Returns this capsule, which is given in frame B, in frame A.
    #[inline]
    #[must_use]
    pub fn placed(&self, placement: &Placement) -> Self {
        Self {
            start_m: placement.act_point(&self.start_m),
            end_m: placement.act_point(&self.end_m),
            radius_m: self.radius_m,
        }
    }

    /// Returns the distance of a point from the surface, m; negative inside.
    #[must_use]
    pub fn distance_m(&self, point_m: &Vector3<f64>) -> f64 {
        self.axis().distance(point_m) - self.radius_m
    }

    /// Returns the volume, m³.
    #[must_use]
    pub fn volume_m3(&self) -> f64 {
        let length = (self.end_m - self.start_m).norm();
        std::f64::consts::PI * self.radius_m * self.radius_m * (length + 4.0 / 3.0 * self.radius_m)
    }

    /// Returns true if all numbers are finite and the radius is not negative.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        let finite = |point: &Vector3<f64>| point.iter().all(|x| x.abs() <= MAX_LENGTH_M);
        finite(&self.start_m) && finite(&self.end_m) && (0.0..=MAX_LENGTH_M).contains(&self.radius_m)
    }

    #[inline]
    pub(crate) fn axis(&self) -> Segment {
        Segment::new(self.start_m, self.end_m - self.start_m)
    }
}

/// Largest magnitude of a coordinate or a radius, m. Squares and products of it are far from the largest number.
pub(crate) const MAX_LENGTH_M: f64 = 1e9;

/// Half-space that bodies must not enter, for example the floor. Points x with `normal`ᵀ x > `offset_m` are outside it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfSpace {
    /// Unit normal of the plane, pointing out of the half-space.
    pub normal: Vector3<f64>,
    /// Distance of the plane from the origin along the normal, m.
    pub offset_m: f64,
}

/// Shape of a link or an obstacle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CollisionShape {
    /// Capsule or sphere.
    Capsule(Capsule),
    /// Half-space, for example the floor or a wall.
    HalfSpace(HalfSpace),
}

/// Origin of a capsule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CapsuleSource {
    /// `<sphere>` of the URDF.
    Sphere,
    /// `<cylinder>` of the URDF.
    Cylinder,
    /// `<capsule>` of the URDF.
    Capsule,
    /// `<box>` of the URDF.
    Box,
    /// `<mesh>` of the URDF.
    Mesh,
    /// Inertia of the link: the capsule encloses the uniform ellipsoid with the same mass and moments. The link itself
    /// may be larger.
    Inertia,
    /// Given by the user.
    User,
}

/// Capsule that is fixed to a link, in the form in which it is listed, corrected and read from a file.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkCapsule {
    /// Name of the capsule, which is unique: the link, with a number if the link has several capsules.
    pub name: String,
    /// Link or frame to which the capsule is fixed.
    pub link: String,
    /// First end of the axis in the frame of the link, m.
    pub start_m: [f64; 3],
    /// Second end of the axis in the frame of the link, m.
    pub end_m: [f64; 3],
    /// Radius, m.
    pub radius_m: f64,
    /// Origin of the capsule.
    pub source: CapsuleSource,
}

impl LinkCapsule {
    /// Returns the shape, in the frame of the link.
    #[must_use]
    pub fn capsule(&self) -> Capsule {
        Capsule { start_m: self.start_m.into(), end_m: self.end_m.into(), radius_m: self.radius_m }
    }
}
