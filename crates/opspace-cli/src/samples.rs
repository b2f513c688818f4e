//! Evaluation of all kinematic and dynamic quantities of one state, in a layout for comparison with other libraries.
//! `opspace model URDF --tip FRAME --samples FILE` reads and writes this format.
//!
//! Matrices are flat lists in row-major order. 6-vectors and Jacobians have the linear rows first, in world axes at the
//! origin of the tip. Not for control loops: it allocates.
//!
//! ```
//! use opspace_cli::samples::{Sample, evaluate};
//! use opspace_model::Model;
//!
//! // A rod of 2 kg that turns about the y axis, its centre of mass 0.5 m from the hinge.
//! let urdf = r#"<robot name="pendulum">
//!   <link name="base"/>
//!   <joint name="hinge" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/></joint>
//!   <link name="rod"><inertial><origin xyz="0.5 0 0"/><mass value="2"/>
//!     <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
//! </robot>"#;
//! let model = Model::from_urdf(urdf)?.model;
//! let line = r#"{"q":[0.1],"dq":[0],"ddq":[0],"tau_in":[0],"f_tip":[0,0,0,0,0,0],"task_rows":[2]}"#;
//! let sample: Sample = serde_json::from_str(line).expect("a state");
//! let rod = model.frame_id("rod").expect("a link of the file");
//! let all = evaluate(&model, rod, &sample).expect("a good state");
//! assert!((all.mass_matrix[0] - (2.0 * 0.5 * 0.5 + 0.1)).abs() < 1e-12);
//! # Ok::<(), opspace_model::UrdfError>(())
//! ```

use nalgebra::{DMatrix, Matrix6xX, Vector3};
use opspace_model::{
    Data, Force, FrameId, JointKind, Model, Motion, OperationalSpace, aba, aba_external, center_of_mass,
    coriolis, frame_bias_acceleration, frame_jacobian, frame_placement, frame_velocity, kinetic_energy,
    potential_energy, rnea, rnea_external, update,
};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Smallest ratio of the least to the largest singular value of J M^-½, with rows scaled to unit length, for a task of
/// full rank. Λ depends on the square of the ratio: below this value it has fewer than four accurate digits.
const RANK_TOLERANCE: f64 = 1e-6;

/// Largest angle for which sine and cosine are accurate: see [`forward_kinematics`](opspace_model::forward_kinematics).
const MOST_TURNED_RAD: f64 = 1e6;

/// Largest deviation of a quaternion's length from 1; files contain at least six digits.
const QUATERNION_TOLERANCE: f64 = 1e-5;

/// State of a robot with n joints, and the forces that act on it.
///
/// Unknown keys are ignored when a sample is read, so a line may also contain the results of another library.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sample {
    /// Joint positions, rad or m (nq: n, or n + 1 with a floating base, whose rotation is a quaternion).
    pub q: Vec<f64>,
    /// Joint velocities, rad/s or m/s (n).
    pub dq: Vec<f64>,
    /// Joint accelerations for the inverse dynamics, rad/s² or m/s² (n).
    pub ddq: Vec<f64>,
    /// Joint torques for the forward dynamics, Nm or N (n).
    pub tau_in: Vec<f64>,
    /// Force and moment that act on the robot at the tip, world axes, N and Nm (6).
    pub f_tip: Vec<f64>,
    /// Rows of the tip Jacobian that form the task: distinct, each from 0 to 5. All six by default.
    #[serde(default = "all_rows")]
    pub task_rows: Vec<usize>,
}

fn all_rows() -> Vec<usize> {
    (0..6).collect()
}

/// Quantities computed from a [`Sample`] with k task rows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Quantities {
    /// Rotation matrix from the tip frame to the world (3 × 3).
    #[serde(rename = "tip_R")]
    pub tip_rotation: Vec<f64>,
    /// Position of the tip origin in the world, m (3).
    #[serde(rename = "tip_p")]
    pub tip_position: Vec<f64>,
    /// Velocity of the tip, J q̇, m/s and rad/s (6).
    #[serde(rename = "tip_vel")]
    pub tip_velocity: Vec<f64>,
    /// Jacobian J of the tip (6 × n).
    #[serde(rename = "J")]
    pub jacobian: Vec<f64>,
    /// Classical acceleration of the tip for q̈ = 0, J̇ q̇, m/s² and rad/s² (6).
    #[serde(rename = "Jdot_dq")]
    pub tip_bias_acceleration: Vec<f64>,
    /// Mass matrix M, kg m² (n × n).
    #[serde(rename = "M")]
    pub mass_matrix: Vec<f64>,
    /// Gravity torques g, Nm (n).
    #[serde(rename = "g")]
    pub gravity: Vec<f64>,
    /// Bias torques C q̇ + g, at q̈ = 0, Nm (n).
    #[serde(rename = "nle")]
    pub bias: Vec<f64>,
    /// Coriolis matrix C from Christoffel symbols, Nms/rad (n × n).
    #[serde(rename = "C")]
    pub coriolis_matrix: Vec<f64>,
    /// Torques of the inverse dynamics, M q̈ + C q̇ + g, Nm (n).
    pub tau_rnea: Vec<f64>,
    /// Accelerations of the forward dynamics, M⁻¹ (τ − C q̇ − g), rad/s² (n).
    pub ddq_aba: Vec<f64>,
    /// Torques of the inverse dynamics with the wrench at the tip, M q̈ + C q̇ + g − Jᵀ f, Nm (n).
    pub tau_rnea_fext: Vec<f64>,
    /// Accelerations of the forward dynamics with the wrench at the tip, M⁻¹ (τ − C q̇ − g + Jᵀ f), rad/s² (n).
    pub ddq_aba_fext: Vec<f64>,
    /// Centre of mass of all moving bodies in the world, m (3); none without moving mass.
    pub com: Option<Vec<f64>>,
    /// Kinetic energy, J.
    pub kinetic_energy: f64,
    /// Potential energy, J; zero for a centre of mass at the world origin.
    pub potential_energy: f64,
    /// Task inertia Λ = (J M⁻¹ Jᵀ)⁻¹ for the task rows, undamped, kg, kg m and kg m² (k × k); none if the task is
    /// rank-deficient.
    #[serde(rename = "Lambda")]
    pub task_inertia: Option<Vec<f64>>,
    /// Dynamically consistent inverse J̄ = M⁻¹ Jᵀ Λ (n × k); none if the task is rank-deficient.
    #[serde(rename = "Jbar")]
    pub dynamically_consistent_inverse: Option<Vec<f64>>,
    /// Null-space projector N = I − J̄ J, acting on velocities (n × n); none if the task is rank-deficient.
    #[serde(rename = "N")]
    pub nullspace: Option<Vec<f64>>,
}

impl Quantities {
    /// Returns true if all quantities are finite.
    fn is_finite(&self) -> bool {
        let lists = [
            &self.tip_rotation,
            &self.tip_position,
            &self.tip_velocity,
            &self.jacobian,
            &self.tip_bias_acceleration,
            &self.mass_matrix,
            &self.gravity,
            &self.bias,
            &self.coriolis_matrix,
            &self.tau_rnea,
            &self.ddq_aba,
            &self.tau_rnea_fext,
            &self.ddq_aba_fext,
        ];
        let optional = [&self.com, &self.task_inertia, &self.dynamically_consistent_inverse, &self.nullspace];
        let energies = [self.kinetic_energy, self.potential_energy];
        let present = optional.into_iter().flatten();
        lists.into_iter().chain(present).flatten().chain(&energies).all(|x| x.is_finite())
    }
}

/// Reason why a [`Sample`] cannot be evaluated.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum SampleError {
    /// Input of a wrong length.
    #[error("`{key}` has {found} numbers; it needs {expected}")]
    Length {
        /// Key of the input.
        key: &'static str,
        /// Expected number of entries.
        expected: usize,
        /// Actual number of entries.
        found: usize,
    },
    /// Input that is infinite or not a number.
    #[error("`{key}`[{index}] is {value}; give a finite number")]
    NotFinite {
        /// Key of the input.
        key: &'static str,
        /// Index of the entry, from 0.
        index: usize,
        /// Value of the entry.
        value: f64,
    },
    /// Task row outside the range 0 to 5.
    #[error("`task_rows` has {row}; the rows are 0 1 2 (linear x y z) and 3 4 5 (angular x y z)")]
    NoSuchRow {
        /// Given row.
        row: usize,
    },
    /// Task row given twice.
    #[error("`task_rows` has {row} more than once; remove one")]
    RepeatedRow {
        /// Given row.
        row: usize,
    },
    /// Mass matrix that is not positive definite: a joint without inertia, or a state so large that products overflow.
    #[error(
        "the mass matrix is not positive definite at this `q`: a joint moves a body without inertia about its axis, or the \
         numbers overflow"
    )]
    SingularMassMatrix,
    /// Quaternion that is not of unit length.
    #[error("the quaternion `q`[3..7] has length {length}; give one of length 1: x, y, z, w")]
    Quaternion {
        /// Given length.
        length: f64,
    },
    /// Angle outside the range in which sine and cosine are accurate.
    #[error("`q`: joint '{joint}' is at {angle} rad; give at most {MOST_TURNED_RAD}")]
    Turned {
        /// Name of the joint.
        joint: String,
        /// Given angle, rad.
        angle: f64,
    },
    /// State so large that products overflow.
    #[error("the numbers overflow: `q`, `dq`, `ddq`, `tau_in` or `f_tip` is too large")]
    Overflow,
}

/// Computes all quantities of one state, for the frame `tip`.
///
/// # Errors
/// [`SampleError`], which names the invalid input.
pub fn evaluate(model: &Model, tip: FrameId, sample: &Sample) -> Result<Quantities, SampleError> {
    check(model, sample)?;
    let mut data = Data::new(model);
    if !update(model, &mut data, &sample.q, &sample.dq) {
        return Err(SampleError::SingularMassMatrix);
    }
    coriolis(model, &mut data);
    let mut jacobian = Matrix6xX::zeros(model.n());
    frame_jacobian(model, &data, tip, &mut jacobian);
    let (force, moment) = sample.f_tip.split_at(3);
    let wrench =
        Force { linear: Vector3::from_column_slice(force), angular: Vector3::from_column_slice(moment) };

    rnea(model, &mut data, &sample.ddq);
    let tau_rnea = data.torque.as_slice().to_vec();
    aba(model, &mut data, &sample.tau_in);
    let ddq_aba = data.ddq.as_slice().to_vec();
    rnea_external(model, &mut data, &sample.ddq, &[(tip, wrench)]);
    let tau_rnea_fext = data.torque.as_slice().to_vec();
    aba_external(model, &mut data, &sample.tau_in, &[(tip, wrench)]);

    let placement = frame_placement(model, &data, tip);
    let task = task(&data, &jacobian, &sample.task_rows);
    let (task_inertia, dynamically_consistent_inverse, nullspace) = match task {
        None => (None, None, None),
        Some(task) => (Some(task.inertia), Some(task.inverse), Some(task.nullspace)),
    };
    let quantities = Quantities {
        tip_rotation: row_major(&placement.rotation),
        tip_position: placement.translation.as_slice().to_vec(),
        tip_velocity: linear_first(&frame_velocity(model, &data, tip)),
        tip_bias_acceleration: linear_first(&frame_bias_acceleration(model, &data, tip)),
        mass_matrix: row_major(&data.mass_matrix),
        gravity: data.gravity.as_slice().to_vec(),
        bias: data.bias.as_slice().to_vec(),
        coriolis_matrix: row_major(&data.coriolis_matrix),
        tau_rnea_fext,
        tau_rnea,
        ddq_aba,
        ddq_aba_fext: data.ddq.as_slice().to_vec(),
        com: center_of_mass(model, &data).map(|com| com.as_slice().to_vec()),
        kinetic_energy: kinetic_energy(model, &data),
        potential_energy: potential_energy(model, &data),
        jacobian: row_major(&jacobian),
        task_inertia,
        dynamically_consistent_inverse,
        nullspace,
    };
    if quantities.is_finite() { Ok(quantities) } else { Err(SampleError::Overflow) }
}

fn check(model: &Model, sample: &Sample) -> Result<(), SampleError> {
    let n = model.n();
    let inputs = [
        ("q", &sample.q, model.nq()),
        ("dq", &sample.dq, n),
        ("ddq", &sample.ddq, n),
        ("tau_in", &sample.tau_in, n),
        ("f_tip", &sample.f_tip, 6),
    ];
    for (key, values, expected) in inputs {
        if values.len() != expected {
            return Err(SampleError::Length { key, expected, found: values.len() });
        }
        if let Some(index) = values.iter().position(|x| !x.is_finite()) {
            return Err(SampleError::NotFinite { key, index, value: values[index] });
        }
    }
    let ahead = model.nq() - model.n();
    if let (1, Some(quaternion)) = (ahead, sample.q.get(3..7)) {
        let length = quaternion.iter().map(|x| x * x).sum::<f64>().sqrt();
        if (length - 1.0).abs() > QUATERNION_TOLERANCE {
            return Err(SampleError::Quaternion { length });
        }
    }
    for (joint, &angle) in model.joints().iter().zip(&sample.q[ahead..]) {
        let turns = matches!(joint.kind, JointKind::Revolute | JointKind::Continuous);
        if turns && angle.abs() > MOST_TURNED_RAD {
            return Err(SampleError::Turned { joint: joint.name.clone(), angle });
        }
    }
    for (i, &row) in sample.task_rows.iter().enumerate() {
        if row > 5 {
            return Err(SampleError::NoSuchRow { row });
        }
        if sample.task_rows[..i].contains(&row) {
            return Err(SampleError::RepeatedRow { row });
        }
    }
    Ok(())
}

/// Λ, J̄ and N of a task, in row-major order.
struct Task {
    inertia: Vec<f64>,
    inverse: Vec<f64>,
    nullspace: Vec<f64>,
}

fn task(data: &Data, jacobian: &Matrix6xX<f64>, rows: &[usize]) -> Option<Task> {
    let (n, k) = (jacobian.ncols(), rows.len());
    let mut selected = Matrix6xX::zeros(n);
    for (to, &from) in rows.iter().enumerate() {
        selected.set_row(to, &jacobian.row(from));
    }
    if !has_full_rank(data, &selected, k) {
        return None;
    }
    let mut space = OperationalSpace::new(n);
    space.update(&data.mass_matrix_factor, &selected, k, 0.0);
    let mut nullspace = DMatrix::zeros(n, n);
    space.nullspace(&selected, &mut nullspace);
    Some(Task {
        inertia: row_major(&space.task_inertia.view((0, 0), (k, k))),
        inverse: row_major(&space.jbar_transpose.rows(0, k).transpose()),
        nullspace: row_major(&nullspace),
    })
}

/// Largest number of iterations of a decomposition: finite matrices of our sizes need some ten per row.
const MAX_ITERATIONS: usize = 1000;

/// Returns true if J M⁻¹ Jᵀ is invertible, judged by the singular values of L⁻¹ Jᵀ (M = L Lᵀ). Its columns have
/// different units and are first scaled to unit length.
fn has_full_rank(data: &Data, jacobian: &Matrix6xX<f64>, rows: usize) -> bool {
    let n = jacobian.ncols();
    if rows == 0 || rows > n {
        return rows == 0;
    }
    let mut half: DMatrix<f64> = jacobian.rows(0, rows).transpose();
    let Some(factor) = data.mass_matrix.clone().cholesky() else {
        return false;
    };
    if !factor.l_dirty().solve_lower_triangular_mut(&mut half) {
        return false;
    }
    for mut column in half.column_iter_mut() {
        let norm = column.norm();
        if norm == 0.0 {
            return false;
        }
        column /= norm;
    }
    let Some(decomposed) = half.try_svd_unordered(false, false, f64::EPSILON, MAX_ITERATIONS) else {
        return false;
    };
    let singular_values = decomposed.singular_values;
    singular_values.min() > RANK_TOLERANCE * singular_values.max()
}

fn linear_first(m: &Motion) -> Vec<f64> {
    m.linear.iter().chain(m.angular.iter()).copied().collect()
}

fn row_major<R, C, S>(matrix: &nalgebra::Matrix<f64, R, C, S>) -> Vec<f64>
where
    R: nalgebra::Dim,
    C: nalgebra::Dim,
    S: nalgebra::RawStorage<f64, R, C>,
{
    matrix.row_iter().flat_map(|row| row.iter().copied().collect::<Vec<_>>()).collect()
}
