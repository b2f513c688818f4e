//! Feasibility of tasks: the rank of their axes over sampled configurations, and the arm's reach.

use crate::tasks::controlled_frame::ControlledFrame;
use crate::tasks::task::Task;
use nalgebra::{DMatrix, Matrix6xX};
use opspace_model::{Data, FrameId, JointKind, Limits, Model, kinematics, update};
use std::f64::consts::PI;
use std::ops::Range;

/// Singular values below this share of the largest don't count: far above rounding, far below what an arm
/// that can move along an axis shows at its best.
const RANK_TOLERANCE: f64 = 1e-6;

/// Configurations tried. A rank deficiency is either nowhere (one generic sample shows full rank) or
/// everywhere.
const SAMPLES: usize = 64;

/// The highest rank of the tasks' rows, taken together, over configurations spread within the joint limits.
#[must_use]
pub fn sampled_rank(model: &Model, tasks: &[&dyn Task]) -> usize {
    let rows = tasks.iter().map(|task| task.rows()).sum();
    let mut jacobian = Matrix6xX::zeros(model.n());
    highest_rank(model, rows, |data, stacked| {
        let mut first = 0;
        for task in tasks {
            task.sampled_jacobian(model, data, &mut jacobian);
            stacked.rows_mut(first, task.rows()).copy_from(&jacobian.rows(0, task.rows()));
            first += task.rows();
        }
    })
}

/// The highest rank of a Jacobian of so many rows, over sampled configurations; `fill` computes it at a state.
fn highest_rank(model: &Model, rows: usize, mut fill: impl FnMut(&Data, &mut DMatrix<f64>)) -> usize {
    let n = model.n();
    let full = rows.min(n);
    let mut data = Data::new(model);
    let mut stacked = DMatrix::zeros(rows, n);
    let rest = vec![0.0; n];
    let mut best = 0;
    for sample in 0..SAMPLES {
        kinematics(model, &mut data, &configuration(model, sample), &rest);
        fill(&data, &mut stacked);
        best = best.max(rank(&stacked));
        if best == full {
            break;
        }
    }
    best
}

/// Median over many postures of the mobility of a task in its hardest direction: the smallest eigenvalue of
/// Λ⁻¹ = J M⁻¹ Jᵀ. A direction that is much harder to move than that is near a singular one, whatever the arm's masses
/// and the task's units.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct TypicalMobility {
    /// Mobility with the arm's M, 1/kg.
    pub dynamic: f64,
    /// Mobility with the identity in M's place: of J Jᵀ.
    pub kinematic: f64,
}

impl TypicalMobility {
    /// Typical mobility of a task's rows.
    #[must_use]
    pub fn new(model: &Model, task: &dyn Task) -> Self {
        let n = model.n();
        let mut data = Data::new(model);
        let mut jacobian = Matrix6xX::zeros(n);
        let identity = {
            let mut factor = data.mass_matrix_factor.clone();
            factor.set_identity();
            factor
        };
        let (mut dynamic, mut kinematic) = (Vec::with_capacity(SAMPLES), Vec::with_capacity(SAMPLES));
        for sample in 0..SAMPLES {
            if !update(model, &mut data, &configuration(model, sample), &vec![0.0; n]) {
                continue;
            }
            task.sampled_jacobian(model, &data, &mut jacobian);
            for (of, factor) in [(&mut dynamic, &data.mass_matrix_factor), (&mut kinematic, &identity)] {
                let mobility = factor.mobility(&mut jacobian.clone());
                let used = mobility.view((0, 0), (task.rows(), task.rows())).into_owned();
                of.push(used.symmetric_eigenvalues().min());
            }
        }
        let [dynamic, kinematic] = [dynamic, kinematic].map(|mut values| {
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or(0.0).max(0.0)
        });
        Self { dynamic, kinematic }
    }
}

/// Returns true if the arm can't turn a frame without also moving it, in any configuration: the rank of position and
/// orientation together is below the sum of their ranks. So it is with fewer than six joints, unless the arm is planar.
#[must_use]
pub fn orientation_is_coupled(model: &Model, controlled: ControlledFrame) -> bool {
    let mut jacobian = Matrix6xX::zeros(model.n());
    let mut directions = |rows: Range<usize>| {
        highest_rank(model, rows.len(), |data, stacked| {
            controlled.jacobian(model, data, &mut jacobian);
            stacked.copy_from(&jacobian.rows(rows.start, rows.len()));
        })
    };
    let (position, orientation) = (directions(0..3), directions(3..6));
    directions(0..6) < position + orientation
}

fn rank(matrix: &DMatrix<f64>) -> usize {
    if matrix.is_empty() {
        return 0;
    }
    let values = matrix.singular_values();
    let floor = RANK_TOLERANCE * values.max();
    values.iter().filter(|&&v| v > floor).count()
}

/// The `sample`-th of a sequence that fills the space between the joint limits evenly (Roberts'
/// generalised golden ratio).
pub(crate) fn configuration(model: &Model, sample: usize) -> Vec<f64> {
    let n = model.n();
    // The root of x^(n+1) = x + 1.
    let ratio = (0..64).fold(2.0_f64, |x, _| (1.0 + x).powf(1.0 / (n as f64 + 1.0)));
    (model.joints().iter().enumerate())
        .map(|(i, joint)| {
            let (lower, upper) = range(joint.kind, &joint.limits);
            let step = ratio.powi(-(i as i32 + 1));
            let u = (0.5 + step * (sample as f64 + 1.0)).fract();
            lower + (upper - lower) * u
        })
        .collect()
}

/// The limits of a joint; half a turn, or a metre, either way where it has none.
fn range(kind: JointKind, limits: &Limits) -> (f64, f64) {
    let far = if kind == JointKind::Prismatic { 1.0 } else { PI };
    let limited = kind != JointKind::Continuous;
    let or_far = |limit: f64, far: f64| if limited && limit.is_finite() { limit } else { far };
    (or_far(limits.lower, -far), or_far(limits.upper, far))
}

/// The length by which a task's rotations are weighed against its displacements, m: the reach of what it moves.
#[must_use]
pub fn characteristic_length(model: &Model, controlled: ControlledFrame) -> f64 {
    match controlled {
        ControlledFrame::Frame(frame) | ControlledFrame::Relative { frame, .. } => reach(model, frame),
        // It doesn't turn.
        ControlledFrame::CenterOfMass => 1.0,
    }
}

/// Largest distance of a frame from the first joint that moves it, m: the distances from joint to joint added up, with
/// the strokes of prismatic joints. 1 m if that is nothing.
#[must_use]
pub fn reach(model: &Model, frame: FrameId) -> f64 {
    let mut sum = model.frame(frame).placement.translation.norm();
    for i in model.ancestors(frame) {
        let body = &model.bodies()[i];
        if body.parent.is_some() {
            sum += body.origin.translation.norm();
        }
        if body.kind == JointKind::Prismatic {
            let (lower, upper) = range(body.kind, &model.joints()[body.joint].limits);
            sum += lower.abs().max(upper.abs());
        }
    }
    if sum > 0.0 { sum } else { 1.0 }
}
