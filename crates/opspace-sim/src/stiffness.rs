//! Choice of the joints that are integrated implicitly: those whose elements are too stiff for the step of the plant.
//!
//! With the stiffness k and the damping d of the elements of each joint, an explicit step of h is stable if the largest
//! eigenvalue of `M⁻¹ diag(h² k + h d)` is small, and accurate if it is well below one. Joints leave the diagonal, the least
//! accurate one first, until that holds; they are integrated [implicitly](crate::stiff_joint).

use nalgebra::{DMatrix, DVector};
use opspace_model::{Data, Model, Postures, crba, forward_kinematics};

/// Largest share of h² k + h d in the inertia: explicit steps are stable up to 2.
const LARGEST_SHARE: f64 = 1.5;

/// Fastest growth of the energy of a spring without a damper that is accepted, 1/s.
const FASTEST_GAIN_PER_S: f64 = 1.0;

/// Largest product of a step and an angular frequency of links on elastic gears: the method is stable up to 2.
const LARGEST_GEAR_STEP: f64 = 1.5;

/// Number of postures besides the start at which inertias are computed.
const POSTURES: usize = 20;

/// Stiffness (Nm/rad, N/m) and damping (Nms/rad, Ns/m) of the elements on the link of a joint.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LinkElements {
    /// Sums over brake and friction on a rigid gear; an end stop is implicit while it is touched.
    pub stiffness: f64,
    pub damping: f64,
    /// Damping that these springs lack for explicit steps: such a step makes a spring gain energy, at half of this over the inertia.
    pub lacking_damping: f64,
    /// Elastic gear; zero if the gear is rigid.
    pub gear_stiffness: f64,
    pub gear_damping: f64,
    /// True if the rotor on the elastic gear is too light for the step.
    pub has_light_rotor: bool,
}

impl LinkElements {
    /// Share of the elements in the inertia of a link of 1 kg m² (kg): a step of `h` (s) is accurate well below one.
    fn share(&self, h: f64) -> f64 {
        (h * h * self.stiffness + h * self.damping) / LARGEST_SHARE
    }

    /// Share of the elastic gear in the inertia of a link of 1 kg m² (kg).
    fn gear_share(&self, h: f64) -> f64 {
        (h / LARGEST_GEAR_STEP).powi(2) * self.gear_stiffness + h * self.gear_damping
    }
}

/// Integration of the elements on the link of a joint.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LinkSteps {
    /// Least inertia of the link with the other joints free, kg m² (kg).
    pub inertia: f64,
    /// True if its elements are too stiff for explicit steps.
    pub is_stiff: bool,
}

/// Returns for each joint how its elements are integrated in steps of `h` (s); `None` without a positive definite mass matrix.
/// `model` has the true bodies, and the rotors on rigid gears.
pub(crate) fn link_steps(
    model: &Model,
    start: &[f64],
    elements: &[LinkElements],
    h: f64,
) -> Option<Vec<LinkSteps>> {
    let inverses = inverse_inertias(model, start)?;
    let least = |i: usize| 1.0 / inverses.iter().map(|inverse| inverse[(i, i)]).fold(0.0, f64::max);
    let mut implicit: Vec<bool> = elements.iter().map(|e| e.has_light_rotor).collect();
    limit_shares(&inverses, elements, &mut implicit, &|e| e.share(h));
    limit_shares(&inverses, elements, &mut implicit, &|e| e.gear_share(h));
    limit_shares(&inverses, elements, &mut implicit, &|e| 0.5 * e.lacking_damping / FASTEST_GAIN_PER_S);
    let steps = |(i, is_stiff)| LinkSteps { inertia: least(i), is_stiff };
    Some(implicit.into_iter().enumerate().map(steps).collect())
}

/// Makes joints implicit until the largest eigenvalue of the inverse inertias times the shares of the others is at most one.
fn limit_shares(
    inverses: &[DMatrix<f64>],
    elements: &[LinkElements],
    implicit: &mut [bool],
    share: &dyn Fn(&LinkElements) -> f64,
) {
    let n = elements.len();
    loop {
        let root = DVector::from_fn(n, |i, _| if implicit[i] { 0.0 } else { share(&elements[i]).sqrt() });
        let scaled =
            |inverse: &DMatrix<f64>| DMatrix::from_fn(n, n, |i, j| root[i] * inverse[(i, j)] * root[j]);
        let largest = |matrix: &DMatrix<f64>| matrix.symmetric_eigenvalues().max();
        let shares = inverses.iter().map(scaled).map(|matrix| (largest(&matrix), matrix));
        match shares.max_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((share, matrix)) if share > 1.0 => implicit[matrix.diagonal().imax()] = true,
            _ => break,
        }
    }
}

/// Rate of explicit steps that is enough for the links on elastic gears, Hz; `None` without a positive definite mass matrix.
pub(crate) fn explicit_gear_hz(model: &Model, start: &[f64], elements: &[LinkElements]) -> Option<f64> {
    let inverses = inverse_inertias(model, start)?;
    let largest = |of: fn(&LinkElements) -> f64| {
        let root = |i: usize| of(&elements[i]).sqrt();
        let scaled = |inverse: &DMatrix<f64>| {
            DMatrix::from_fn(model.n(), model.n(), |i, j| root(i) * inverse[(i, j)] * root(j))
        };
        inverses.iter().map(|inverse| scaled(inverse).symmetric_eigenvalues().max()).fold(0.0, f64::max)
    };
    // h² k + h d = 1, with the largest eigenvalues k and d, and h = 1/rate.
    let stiffness = largest(|gear| gear.gear_stiffness) / LARGEST_GEAR_STEP.powi(2);
    let damping = largest(|gear| gear.gear_damping);
    Some(0.5 * (damping + (damping * damping + 4.0 * stiffness).sqrt()))
}

/// Inverses of the mass matrix at the start and at other postures.
fn inverse_inertias(model: &Model, start: &[f64]) -> Option<Vec<DMatrix<f64>>> {
    let postures = Postures::new(model, 1.0);
    let others = (0..POSTURES).map(|number| postures.posture(number));
    std::iter::once(start.to_vec()).chain(others).map(|q| inverse_inertia(model, &q)).collect()
}

/// Inverse of the mass matrix at a posture.
fn inverse_inertia(model: &Model, q: &[f64]) -> Option<DMatrix<f64>> {
    let mut data = Data::new(model);
    forward_kinematics(model, &mut data, q);
    crba(model, &mut data);
    Some(data.mass_matrix.cholesky()?.inverse())
}
