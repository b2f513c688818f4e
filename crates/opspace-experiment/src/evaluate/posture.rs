//! A robot at rest in one posture: frames, condition of the Jacobian, torques of the weight, and effective masses.

use nalgebra::{DMatrix, Matrix6xX, Rotation3, UnitQuaternion};
use opspace_control::ControlledFrame;
use opspace_control::characteristic_length;
use opspace_model::{Data, FrameId, Model, frame_jacobian, frame_placement, gravity, update};

/// Ratio of singular values below which the smaller one is zero.
const ROUNDING: f64 = 1e-9;

/// Largest number of iterations of a decomposition: finite matrices of our sizes need some ten per row.
const MAX_ITERATIONS: usize = 1000;

/// Pose of a frame in world axes.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct FramePose {
    /// Name of the frame.
    pub name: String,
    /// Position of its origin, m.
    pub position_m: [f64; 3],
    /// Roll, pitch and yaw: rotations about the fixed axes x, y and z, in this order, rad.
    pub rpy_rad: [f64; 3],
    /// Unit quaternion x, y, z, w with w ≥ 0.
    pub quaternion: [f64; 4],
}

/// Largest and smallest singular value of rows of a Jacobian.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Conditioning {
    /// Largest one.
    pub largest: f64,
    /// Smallest one; zero if the frame cannot move in some direction.
    pub smallest: f64,
}

impl Conditioning {
    /// Condition number; `None` if the frame cannot move in some direction.
    #[must_use]
    pub fn condition(&self) -> Option<f64> {
        (self.smallest > 0.0).then(|| self.largest / self.smallest)
    }

    /// Singular values of a Jacobian with at least as many joints as rows; the missing ones of other robots are zero.
    fn of(rows: &DMatrix<f64>) -> Self {
        let decomposed = rows.clone().try_svd_unordered(false, false, f64::EPSILON, MAX_ITERATIONS);
        let Some(values) = decomposed.map(|decomposed| decomposed.singular_values) else {
            return Self { largest: f64::NAN, smallest: 0.0 };
        };
        let largest = values.max();
        let smallest = if rows.ncols() < rows.nrows() { 0.0 } else { values.min() };
        Self { largest, smallest: if smallest > ROUNDING * largest { smallest } else { 0.0 } }
    }
}

/// Robot at rest in one posture.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct PostureReport {
    /// Poses of all frames, in the model's order.
    pub frames: Vec<FramePose>,
    /// Name of the frame for which Jacobian and effective masses are computed.
    pub frame: String,
    /// Linear rows of its Jacobian, m per rad (or per m of a prismatic joint).
    pub linear: Conditioning,
    /// Angular rows of its Jacobian, rad per rad (rad/m).
    pub angular: Conditioning,
    /// All rows, with the angular ones multiplied by [`length_m`](Self::length_m).
    pub pose: Conditioning,
    /// Length by which angular rows are scaled, m: the one that the controllers use for this frame.
    pub length_m: f64,
    /// Torques that hold the weight, in the model's joint order (n; Nm or N).
    pub gravity: Vec<f64>,
    /// Effective mass along x, y and z of the world at the frame (kg), and effective inertia about them (kg m²), each 1/(J M⁻¹ Jᵀ)
    /// with all other directions free; `None` where the frame cannot move.
    pub effective_mass: [Option<f64>; 6],
}

impl PostureReport {
    /// Computes the report for a frame at the positions `q` (nq; rad or m). `None` if the mass matrix is not positive definite
    /// there.
    ///
    /// # Panics
    /// If `q` does not have the length of the model's positions.
    #[must_use]
    pub fn new(model: &Model, q: &[f64], frame: FrameId) -> Option<Self> {
        let mut data = Data::new(model);
        if !update(model, &mut data, q, &vec![0.0; model.n()]) {
            return None;
        }
        gravity(model, &mut data);
        let frames = model.frames().iter().map(|named| {
            let id = model.frame_id(&named.name).ok()?;
            Some(pose(&named.name, model, &data, id))
        });
        let mut jacobian = Matrix6xX::zeros(model.n());
        frame_jacobian(model, &data, frame, &mut jacobian);
        let length_m = characteristic_length(model, ControlledFrame::Frame(frame));
        let rows = |first: usize, count: usize, scale: f64| {
            let mut rows = DMatrix::from(jacobian.rows(first, count));
            if count == 6 {
                rows.rows_mut(3, 3).scale_mut(scale);
            }
            Conditioning::of(&rows)
        };
        let (linear, angular, all) = (rows(0, 3, 1.0), rows(3, 3, 1.0), rows(0, 6, length_m));
        let mobility = data.mass_matrix_factor.mobility(&mut jacobian);
        let largest = [0, 3].map(|first| (first..first + 3).map(|i| mobility[(i, i)]).fold(0.0, f64::max));
        let effective = |i: usize| {
            let own = mobility[(i, i)];
            (own > ROUNDING * largest[i / 3]).then(|| 1.0 / own)
        };
        Some(Self {
            frames: frames.collect::<Option<_>>()?,
            frame: model.frame(frame).name.clone(),
            linear,
            angular,
            pose: all,
            length_m,
            gravity: data.gravity.iter().copied().collect(),
            effective_mass: std::array::from_fn(effective),
        })
    }
}

fn pose(name: &str, model: &Model, data: &Data, frame: FrameId) -> FramePose {
    let placement = frame_placement(model, data, frame);
    let rotation = Rotation3::from_matrix_unchecked(placement.rotation);
    let (roll, pitch, yaw) = rotation.euler_angles();
    let quaternion = UnitQuaternion::from_rotation_matrix(&rotation).into_inner().coords;
    let sign = if quaternion.w < 0.0 { -1.0 } else { 1.0 };
    FramePose {
        name: name.to_owned(),
        position_m: placement.translation.into(),
        rpy_rad: [roll, pitch, yaw],
        quaternion: (sign * quaternion).into(),
    }
}
