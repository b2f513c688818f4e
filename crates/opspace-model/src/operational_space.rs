//! Operational-space quantities of a task: Λ, J̄ and N.
//!
//! Khatib, *A unified approach for motion and force control of robot manipulators: the operational
//! space formulation*, IEEE J. Robotics and Automation 3(1), 1987:
//!
//! ```text
//! Λ⁻¹ = J M⁻¹ Jᵀ          J̄ = M⁻¹ Jᵀ Λ          N = I − J̄ J
//! ```
//!
//! Close to a singularity, eigenvalues of Λ⁻¹ approach zero and Λ grows without bound. Each eigenvalue λ below the
//! threshold `threshold · λ_max` is therefore inverted as `λ/(λ² + μ²)`, with μ² that rises smoothly from 0 at the
//! threshold; larger eigenvalues are inverted exactly. The task controller uses [`Inversion::Adaptive`].
//! J̄ and N are computed from the same Λ: what damping takes from a task, a task of lower priority can use, or brake. Other methods from the literature are available for comparison: [`Inversion`].
//!
//! ```
//! # let urdf = include_str!("../urdf/ur5e.urdf");
//! use opspace_model::{Data, Model, OperationalSpace, frame_jacobian, update};
//!
//! let model = Model::from_urdf(urdf)?.model;
//! let mut data = Data::new(&model);
//! assert!(update(&model, &mut data, &[0.4; 6], &[0.0; 6]));
//! let tool = model.frame_id("flange").expect("a link of the file");
//! let mut jacobian = nalgebra::Matrix6xX::zeros(model.n());
//! frame_jacobian(&model, &data, tool, &mut jacobian);
//! // The hand's position, three rows: how heavy it is in each direction.
//! let mut space = OperationalSpace::new(model.n());
//! space.update(&data.mass_matrix_factor, &jacobian, 3, 1e-4);
//! assert!(space.task_inertia[(0, 0)] > 0.0, "kg");
//! // What is left of a torque that must not move it.
//! let mut torque = [1.0; 6];
//! space.project_torque(&jacobian, &mut torque);
//! # Ok::<(), opspace_model::UrdfError>(())
//! ```

use crate::cholesky::MassMatrixFactor;
use crate::partial_inverse::{PartialInverse, partial_inverse};
use nalgebra::{DMatrix, Matrix6, Matrix6xX, SymmetricEigen, Vector6};

/// Method of inverting Λ⁻¹ when an eigenvalue λ is close to zero. Thresholds t are relative to λ_ref, which is the
/// largest eigenvalue or the reference passed to [`update_with`](OperationalSpace::update_with).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Inversion {
    /// λ/(λ² + μ²) below the threshold t λ_ref, with μ = t λ_ref (1 − (λ/(t λ_ref))²); exactly 1/λ above it.
    Damped(f64),
    /// 1/(λ + m₀ f(λ/(t₀ λ_ref)) + m f(λ/(t λ_ref))) with f(x) = (1 − x²)² below 1 and 0 above it: the task's force along
    /// a singular direction is bounded. m₀ = t₀ λ_ref/2 is small; m = t λ_ref |a|/a₀ grows with the acceleration a that
    /// the task demands of the directions below t λ_ref, weighted by f. Slow motion is thus exact where fast motion,
    /// or a goal out of reach, needs damping.
    Adaptive {
        /// Threshold t₀ of a task without demand.
        least: f64,
        /// Highest threshold t.
        most: f64,
        /// Demand a₀ with which m reaches the highest threshold, in the unit of the task's scaled rows, m/s². It is
        /// also assumed where the demand is unknown.
        full_demand: f64,
    },
    /// 1/λ for every λ above zero, however small; 0 otherwise.
    Plain,
    /// λ/(λ² + μ²) with μ = t λ_ref for every λ (damped least squares). It is never exact.
    LeastSquares(f64),
    /// 1/max(λ, t λ_ref): the condition number is bounded, and forces still act along a singular direction.
    Clamped(f64),
}

impl Inversion {
    /// Returns the threshold below which directions may be modified, relative to λ_ref; 0 if none is modified.
    #[must_use]
    pub fn threshold(self) -> f64 {
        match self {
            Self::Damped(threshold) | Self::Clamped(threshold) | Self::Adaptive { most: threshold, .. } => {
                threshold
            }
            Self::Plain => 0.0,
            Self::LeastSquares(_) => f64::INFINITY,
        }
    }

    /// Returns true if it is for control: all others are for comparisons.
    #[must_use]
    pub fn is_for_control(self) -> bool {
        matches!(self, Self::Damped(_) | Self::Adaptive { .. })
    }

    /// Norm of the demand along the directions whose force it bounds, relative to the full demand. `spectrum` are eigenvalues
    /// with their directions; those above the threshold do not count.
    fn relative_demand(
        self,
        spectrum: impl Iterator<Item = (f64, Vector6<f64>)>,
        reference: f64,
        demand: Option<&Vector6<f64>>,
    ) -> f64 {
        let (Self::Adaptive { most, full_demand, .. }, Some(demand)) = (self, demand) else { return 1.0 };
        let sum: f64 = spectrum
            .map(|(value, direction)| fade(value, most * reference) * direction.dot(demand).powi(2))
            .sum();
        // Finite, so that its product with a weight of zero is zero.
        (sum.sqrt() / full_demand).min(MAX_DEMAND)
    }

    /// Returns the replacement for 1/`value`.
    fn reciprocal(self, value: f64, reference: f64, demand: f64) -> f64 {
        match self {
            Self::Damped(threshold) => damped_reciprocal(value, threshold * reference),
            Self::Adaptive { least, most, .. } => {
                let (value, least, most) = (value.max(0.0), least * reference, most * reference);
                let damped = value + 0.5 * least * fade(value, least) + most * demand * fade(value, most);
                if damped > 0.0 { 1.0 / damped } else { 0.0 }
            }
            Self::Plain => damped_reciprocal(value, 0.0),
            Self::LeastSquares(threshold) => {
                let (value, mu) = (value.max(0.0), threshold * reference);
                value / (value * value + mu * mu)
            }
            Self::Clamped(threshold) => 1.0 / value.max(threshold * reference),
        }
    }
}

/// Λ and J̄ of one task with up to six rows, preallocated for n joints.
#[derive(Clone, Debug)]
pub struct OperationalSpace {
    /// Task inertia Λ (6 × 6; kg, kg m, kg m²). Unused rows and columns are zero.
    pub task_inertia: Matrix6<f64>,
    /// J̄ᵀ (6 × n), with J̄ the dynamically consistent inverse of J. It maps joint torques to task forces. Unused rows
    /// are zero.
    pub jbar_transpose: Matrix6xX<f64>,
    /// Smallest gain over the eigenvectors of Λ⁻¹: the eigenvalue times its (damped) reciprocal. 1 without damping, 0
    /// if a direction is lost.
    pub min_singular_gain: f64,
    /// Sum of v vᵀ/(λ + t λ_ref) over the damped eigenvectors v of Λ⁻¹ (6 × 6; kg, kg m, kg m²), with t = 0.001: for a joint
    /// acceleration a, Jᵀ times this times J a is the part of M a from which damping takes. Zero without damping.
    pub damped_inertia: Matrix6<f64>,
}

impl OperationalSpace {
    /// Allocates the quantities of a task on a robot with `n` joints.
    #[must_use]
    pub fn new(n: usize) -> Self {
        Self {
            task_inertia: Matrix6::zeros(),
            jbar_transpose: Matrix6xX::zeros(n),
            min_singular_gain: 1.0,
            damped_inertia: Matrix6::zeros(),
        }
    }

    /// Computes Λ and J̄ for the first `rows` rows of `jacobian` (6 × n), with the factor of the mass matrix at the
    /// same state.
    ///
    /// A direction is damped if the ratio of its eigenvalue of Λ⁻¹ to the largest eigenvalue is below `threshold`; 0
    /// disables damping. The ratio is meaningful only if rows of different units were scaled to a common unit. If the
    /// Jacobian or the factor is not finite, Λ and [`min_singular_gain`](Self::min_singular_gain) are zero.
    ///
    /// # Panics
    /// If `rows` is larger than six, or if the sizes differ.
    pub fn update(
        &mut self,
        factor: &MassMatrixFactor,
        jacobian: &Matrix6xX<f64>,
        rows: usize,
        threshold: f64,
    ) {
        self.update_with(factor, jacobian, rows, Inversion::Damped(threshold), None);
    }

    /// Variant of [`update`](Self::update) with another inversion of Λ⁻¹, or with thresholds relative to `reference`
    /// (1/kg) instead of the largest eigenvalue.
    ///
    /// # Panics
    /// As [`update`](Self::update).
    pub fn update_with(
        &mut self,
        factor: &MassMatrixFactor,
        jacobian: &Matrix6xX<f64>,
        rows: usize,
        inversion: Inversion,
        reference: Option<f64>,
    ) {
        self.update_inertia(factor, jacobian, rows, inversion, reference, None);
        self.compute_jbar(factor);
    }

    /// Computes Λ and [`min_singular_gain`](Self::min_singular_gain), the first half of
    /// [`update_with`](Self::update_with), for callers that may not need J̄. J̄ᵀ then contains an intermediate result
    /// for [`compute_jbar`](Self::compute_jbar). `demand` is the acceleration that the task demands of its rows, if it is known.
    ///
    /// # Panics
    /// As [`update`](Self::update).
    pub fn update_inertia(
        &mut self,
        factor: &MassMatrixFactor,
        jacobian: &Matrix6xX<f64>,
        rows: usize,
        inversion: Inversion,
        reference: Option<f64>,
        demand: Option<&Vector6<f64>>,
    ) {
        assert!(rows <= 6, "a task has six rows at most");
        let half = &mut self.jbar_transpose;
        half.as_mut_slice().copy_from_slice(jacobian.as_slice());
        for r in rows..6 {
            half.row_mut(r).fill(0.0);
        }
        let mobility = factor.mobility(half);
        self.invert(mobility, rows, inversion, reference, demand);
    }

    /// Computes all quantities except J̄ from the leading `rows` × `rows` block of Λ⁻¹.
    fn invert(
        &mut self,
        mut mobility: Matrix6<f64>,
        rows: usize,
        inversion: Inversion,
        reference: Option<f64>,
        demand: Option<&Vector6<f64>>,
    ) {
        if self.min_singular_gain < 1.0 {
            self.damped_inertia = Matrix6::zeros();
        }
        self.min_singular_gain = 0.0;
        let trace = mobility.trace();
        if trace.is_nan() || trace.is_infinite() || trace <= 0.0 {
            self.task_inertia = Matrix6::zeros();
            self.min_singular_gain = if rows == 0 && trace <= 0.0 { 1.0 } else { 0.0 };
            return;
        }
        // Unused rows become eigenvectors whose eigenvalues are larger than all eigenvalues of the task.
        let padding = 2.0 * trace;
        for r in rows..6 {
            mobility[(r, r)] = padding;
        }
        let largest_inverse = 1.0 / (inversion.threshold() * reference.unwrap_or(trace));
        match partial_inverse(&mobility, rows, trace, largest_inverse, &mut self.task_inertia) {
            PartialInverse::Whole => self.min_singular_gain = 1.0,
            PartialInverse::ButOne { value, vector } if reference.is_some() => {
                self.min_singular_gain = 1.0;
                let reference = reference.unwrap_or(trace);
                let demand = inversion.relative_demand(std::iter::once((value, vector)), reference, demand);
                self.add_direction(value, &vector, inversion, reference, demand);
            }
            _ => {
                self.task_inertia = Matrix6::zeros();
                if mobility.iter().all(|x| x.is_finite()) {
                    self.invert_spectrum(mobility, trace, inversion, reference, demand);
                }
            }
        }
        for r in rows..6 {
            self.task_inertia[(r, r)] = 0.0;
        }
    }

    /// Computes all quantities except J̄ from the eigenvectors of Λ⁻¹.
    fn invert_spectrum(
        &mut self,
        mobility: Matrix6<f64>,
        trace: f64,
        inversion: Inversion,
        reference: Option<f64>,
        demand: Option<&Vector6<f64>>,
    ) {
        // A matrix without a spectrum is not finite: the task gets no force.
        let Some(spectrum) = SymmetricEigen::try_new(mobility, f64::EPSILON, MAX_ITERATIONS) else { return };
        // The padding is larger than the trace; all eigenvalues of the task are smaller.
        let of_task = spectrum.eigenvalues.iter().zip(spectrum.eigenvectors.column_iter());
        let of_task = of_task.filter(|&(&value, _)| value <= 1.5 * trace);
        let of_task = of_task.map(|(&value, vector)| (value, vector.into_owned()));
        let largest = of_task.clone().fold(0.0, |largest: f64, (value, _)| largest.max(value));
        let reference = reference.unwrap_or(largest);
        let demand = inversion.relative_demand(of_task.clone(), reference, demand);
        self.min_singular_gain = 1.0;
        for (value, vector) in of_task {
            self.add_direction(value, &vector, inversion, reference, demand);
        }
    }

    /// Adds an eigenvector of Λ⁻¹ with its eigenvalue.
    fn add_direction(
        &mut self,
        value: f64,
        vector: &Vector6<f64>,
        inversion: Inversion,
        reference: f64,
        demand: f64,
    ) {
        let reciprocal = inversion.reciprocal(value, reference, demand);
        let gain = (reciprocal * value).max(0.0);
        self.min_singular_gain = self.min_singular_gain.min(gain);
        let square = vector * vector.transpose();
        self.task_inertia += square * reciprocal;
        if gain < 1.0 {
            self.damped_inertia += square / (value.max(0.0) + LOST * reference);
        }
    }

    /// Computes J̄ᵀ, the second half of [`update_with`](Self::update_with). Call it at most once after each
    /// [`update_inertia`](Self::update_inertia).
    ///
    /// # Panics
    /// If the sizes differ.
    pub fn compute_jbar(&mut self, factor: &MassMatrixFactor) {
        let half = &mut self.jbar_transpose;
        factor.finish_solve(half);
        let (columns, _) = half.as_mut_slice().as_chunks_mut::<6>();
        for column in columns {
            *column = (self.task_inertia * Vector6::from(*column)).into();
        }
    }

    /// Replaces the joint torques τ in `tau` (n; Nm) by Nᵀ τ = τ − Jᵀ J̄ᵀ τ, the part of τ that does not accelerate the
    /// task. `jacobian` is the Jacobian of the last [`update`](Self::update).
    ///
    /// # Panics
    /// If the sizes differ.
    pub fn project_torque(&self, jacobian: &Matrix6xX<f64>, tau: &mut [f64]) {
        assert!(jacobian.ncols() == self.jbar_transpose.ncols() && tau.len() == jacobian.ncols());
        let mut force = Vector6::zeros();
        for (column, &t) in self.jbar_transpose.column_iter().zip(tau.iter()) {
            force += column * t;
        }
        for (t, column) in tau.iter_mut().zip(jacobian.column_iter()) {
            *t -= column.dot(&force);
        }
    }

    /// Computes N = I − J̄ J (n × n), the null-space projector of velocities; its transpose projects torques.
    /// `jacobian` is the Jacobian of the last [`update`](Self::update).
    ///
    /// # Panics
    /// If the sizes differ.
    pub fn nullspace(&self, jacobian: &Matrix6xX<f64>, out: &mut DMatrix<f64>) {
        let n = self.jbar_transpose.ncols();
        assert!(jacobian.ncols() == n && out.shape() == (n, n));
        for (k, column) in jacobian.column_iter().enumerate() {
            for (i, row) in self.jbar_transpose.column_iter().enumerate() {
                out[(i, k)] = f64::from(u8::from(i == k)) - row.dot(&column);
            }
        }
    }
}

/// Largest number of iterations of a decomposition: finite matrices of our sizes need some ten per row.
const MAX_ITERATIONS: usize = 1000;

/// Eigenvalue, relative to the reference, below which the joint motion of a direction is no longer known: its change with
/// the joint positions would act as a stiff spring.
const LOST: f64 = 0.001;

/// Largest relative demand; the force with it is negligible.
const MAX_DEMAND: f64 = 1e9;

/// Returns 1/λ for λ at or above `floor`, and λ/(λ² + μ²) with μ² = floor² (1 − (λ/floor)²)² below it. Value and slope
/// are continuous at `floor`, and the result goes to zero with λ.
fn damped_reciprocal(value: f64, floor: f64) -> f64 {
    if value >= floor && value > 0.0 {
        return 1.0 / value;
    }
    if value <= 0.0 {
        return 0.0;
    }
    let mu = floor * fade(value, floor).sqrt();
    value / (value * value + mu * mu)
}

/// Returns a weight that falls from 1 at 0 to 0 at `floor` and above, (1 − (λ/floor)²)².
fn fade(value: f64, floor: f64) -> f64 {
    let ratio = (value / floor).min(1.0);
    (1.0 - ratio * ratio).powi(2)
}
