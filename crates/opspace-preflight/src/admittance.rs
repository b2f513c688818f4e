//! Stability of force axes of inverse kinematics on the stiff objects of the environment: the phase margin of the loop.
//!
//! The arm has its inertia M at the start and a linear servo at each joint. With J the Jacobian of the axis, K and D stiffness
//! and damping of the object along it, and J⁺ the column of the task's pseudo-inverse, the loop from the force through the
//! admittance damping B_a, the integration and the servos to the force is
//!
//! ```text
//! L(s) = F(z)/B_a (K + D s) J [M s² − diag(Z Y) + Jᵀ (K + D s) J]⁻¹ diag(Z S B) J⁺ (T z⁻¹/(1 − z⁻¹) + 1/kp)
//! ```
//!
//! with the force filter F, z = exp(s T), the interface period T, and S, Y, B and Z of the servos as in `stability`; 1/kp only
//! for `ik-lead`. For an ideal robot and filter, L = K T/B_a z⁻¹/(1 − z⁻¹). Friction, the lag of the motors and the sensor's own
//! bandwidth are not included.

use super::case::PreflightCase;
use super::diagnostic::short;
use super::phase_margin::{GOOD_MARGIN_DEG, LEAST_MARGIN_DEG, Margin, hold, least_margin, rounded_down};
use super::surfaces::{Surface, largest_stable_stiffness, largest_true, surfaces};
use nalgebra::{Complex, DMatrix, DVector, Matrix6xX, RowDVector, Vector3};
use opspace_backend::Setpoints;
use opspace_backend::quantity::Positive;
use opspace_control::{AXIS_NAMES, CartesianParameters, TaskParameters};
use opspace_experiment::codes::Code;
use opspace_experiment::files::controller_kind::ControllerKind;
use opspace_experiment::finding::Finding;
use opspace_transformer::ServoLaw;
use std::f64::consts::TAU;

/// Force axis with an admittance, and the drives that move it.
struct ForceLoop {
    axis: usize,
    /// Direction of the axis in the world.
    direction: Vector3<f64>,
    admittance_ns_per_m: f64,
    filter_gain: f64,
    jacobian: RowDVector<Complex<f64>>,
    /// Column of the pseudo-inverse for the axis (n).
    inverse: DVector<f64>,
    mass_matrix: DMatrix<f64>,
    servos: Vec<ServoLaw>,
    /// Compensated lag of the servos 1/kp, s (n); 0 without compensation.
    lead_s: Vec<f64>,
    period_s: f64,
    servo_period_s: f64,
    delay_s: f64,
    setpoints: Setpoints,
}

/// Finds admittances that are too small for the objects that the task's frame touches.
pub(super) fn unstable_contacts(case: &PreflightCase<'_>) -> Vec<Finding> {
    let mut found: Vec<Finding> = Vec::new();
    for_each_loop(case, |stack, name, parameters, force_loop| {
        for (object, contact) in surfaces(case, &parameters.frame, &force_loop.direction) {
            let Some(margin) = force_loop.margin(contact, force_loop.admittance_ns_per_m) else { continue };
            if margin.degrees < LEAST_MARGIN_DEG {
                found.push(force_loop.finding(case, stack, name, object, contact, margin));
            }
        }
    });
    found
}

/// Lists force axes for which the environment has no object, with the stiffness up to which they are stable.
pub(super) fn unknown_contacts(case: &PreflightCase<'_>) -> Vec<Finding> {
    let mut found: Vec<Finding> = Vec::new();
    for_each_loop(case, |stack, name, parameters, force_loop| {
        if !surfaces(case, &parameters.frame, &force_loop.direction).is_empty() {
            return;
        }
        let axis = AXIS_NAMES[force_loop.axis];
        let Some(stiffness) = force_loop.largest_stiffness() else { return };
        let message = format!(
            "task '{name}': what the hand touches along {axis} is not known: with admittance_ns_per_m = {} it oscillates on \
             objects that are stiffer than {} N/m",
            short(force_loop.admittance_ns_per_m),
            rounded_down(stiffness),
        );
        let help = "raise admittance_ns_per_m for stiffer objects".to_owned();
        found.push(Finding::new(Code::UnknownContact, &key(case, stack, name), message, help));
    });
    found
}

fn key(case: &PreflightCase<'_>, stack: usize, name: &str) -> Vec<String> {
    case.key(stack, name, &["cartesian", "force", "admittance_ns_per_m"])
}

/// Visits the loops of all translational axes that move with a force, with the number of their task set and their task.
fn for_each_loop(
    case: &PreflightCase<'_>,
    mut visit: impl FnMut(usize, &str, &CartesianParameters, &ForceLoop),
) {
    for (stack, in_force) in case.task_sets.iter().enumerate() {
        for name in in_force.priority {
            let before = stack.checked_sub(1).and_then(|before| case.task_sets[before].task.get(name));
            let parameters = in_force.task.get(name);
            let Some(TaskParameters::Cartesian(p)) = parameters.filter(|_| before != parameters) else {
                continue;
            };
            let held = p.force_axes();
            for axis in (0..3).filter(|&axis| held[axis]) {
                if let Some(force_loop) = ForceLoop::new(case, stack, name, p, axis) {
                    visit(stack, name, p, &force_loop);
                }
            }
        }
    }
}

/// Largest number of steps of a decomposition: it would not end if a number is not finite.
const MAX_ITERATIONS: usize = 1000;

impl ForceLoop {
    /// Creates the loop of an axis; `None` if the axis has no admittance, or for a robot without position servos.
    fn new(
        case: &PreflightCase<'_>,
        stack: usize,
        name: &str,
        parameters: &CartesianParameters,
        axis: usize,
    ) -> Option<Self> {
        let (model, data, experiment) = (case.model, &case.data, case.experiment);
        let force = parameters.force.as_ref()?;
        let admittance_ns_per_m = force.admittance_ns_per_m?.get(axis).map(Positive::get)?;
        let task = case.task_sets[stack].tasks.tasks().find(|task| task.name() == name)?;
        let row = (0..axis).filter(|&before| parameters.axes.active_axes()[before]).count();
        let mut jacobian = Matrix6xX::zeros(model.n());
        task.jacobian(model, data, &mut jacobian);
        let rows = jacobian.rows(0, task.rows()).into_owned();
        let decomposed = rows.clone().try_svd(true, true, f64::EPSILON, MAX_ITERATIONS)?;
        let inverse = decomposed.pseudo_inverse(1e-9).ok()?.column(row).into_owned();
        let controlled = parameters.controlled_frame(model).ok()?;
        let axes_frame = parameters.axes_frame.resolve(model, controlled).ok()?;
        let axes = controlled.coordinates(model, data) * axes_frame.rotation(model, data, controlled);
        let profile = experiment.profile().1;
        let laws = experiment.servos().ok()?;
        let laws = laws.iter().map(|servo| ServoLaw::new(servo, profile.servo_period_s()).ok());
        let leads = experiment.options().controller == ControllerKind::IkLead;
        let gains = experiment.servo_gains().ok()?;
        let period_s = profile.period_s();
        Some(Self {
            axis,
            direction: axes.column(axis).into(),
            admittance_ns_per_m,
            filter_gain: 1.0 - (-TAU * force.filter_hz.get() * period_s).exp(),
            jacobian: rows.row(row).map(Complex::from),
            inverse,
            mass_matrix: data.mass_matrix.clone(),
            servos: laws.collect::<Option<_>>()?,
            lead_s: gains.iter().map(|g| if leads { g.damping / g.stiffness } else { 0.0 }).collect(),
            period_s,
            servo_period_s: profile.servo_period_s(),
            delay_s: f64::from(profile.delay()) * profile.servo_period_s(),
            setpoints: experiment.robot().file.interface.setpoints,
        })
    }

    /// Open-loop transfer function at an angular frequency (rad/s), times the admittance damping.
    fn open_loop(&self, contact: Surface, omega: f64) -> Complex<f64> {
        let s = Complex::new(0.0, omega);
        let back = (-s * self.period_s).exp();
        let filter = self.filter_gain / (1.0 - (1.0 - self.filter_gain) * back);
        let integral = self.period_s * back / (1.0 - back);
        let own_hold = hold(s, self.servo_period_s);
        let held = hold(s, self.period_s) / own_hold;
        let setpoint = (-s * self.delay_s).exp()
            * match self.setpoints {
                Setpoints::Held => held,
                Setpoints::Interpolated => held * held,
            };
        let wall = contact.damping * s + contact.stiffness;
        let mut arm = self.mass_matrix.map(|m| s * s * m) + self.jacobian.transpose() * &self.jacobian * wall;
        let mut push = DVector::zeros(self.servos.len());
        for (j, servo) in self.servos.iter().enumerate() {
            let [of_setpoint, of_position] = servo.response((s * self.servo_period_s).exp());
            arm[(j, j)] -= own_hold * of_position;
            push[j] = own_hold * of_setpoint * setpoint * (integral + self.lead_s[j]) * self.inverse[j];
        }
        // Singular only at an undamped resonance.
        let Some(q) = arm.lu().solve(&push) else { return Complex::from(f64::INFINITY) };
        filter * wall * (&self.jacobian * q)[0]
    }

    fn margin(&self, contact: Surface, admittance_ns_per_m: f64) -> Option<Margin> {
        let first = 1e-3 * contact.stiffness / admittance_ns_per_m;
        least_margin(first, self.period_s, |omega| self.open_loop(contact, omega) / admittance_ns_per_m)
    }

    /// Returns true if the margin is at least `degrees`, or if the gain is small everywhere.
    fn has_margin(&self, contact: Surface, admittance_ns_per_m: f64, degrees: f64) -> bool {
        self.margin(contact, admittance_ns_per_m).is_none_or(|margin| margin.degrees >= degrees)
    }

    /// Smallest admittance damping with a good margin; `None` if even a thousand times the present one has none.
    fn good_admittance(&self, contact: Surface) -> Option<f64> {
        let given = self.admittance_ns_per_m;
        largest_true(1e-3, 1.0, |share| self.has_margin(contact, given / share, GOOD_MARGIN_DEG))
            .map(|share| given / share)
    }

    /// Largest stiffness of an undamped object on which the loop does not oscillate.
    fn largest_stiffness(&self) -> Option<f64> {
        largest_stable_stiffness(|contact| {
            self.has_margin(contact, self.admittance_ns_per_m, LEAST_MARGIN_DEG)
        })
    }

    fn finding(
        &self,
        case: &PreflightCase<'_>,
        stack: usize,
        name: &str,
        object: &str,
        contact: Surface,
        margin: Margin,
    ) -> Finding {
        let axis = AXIS_NAMES[self.axis];
        let how = if margin.degrees < 0.0 { "would be unstable" } else { "would oscillate" };
        let message = format!(
            "task '{name}': with inverse kinematics, admittance_ns_per_m = {} along {axis} {how} on '{object}' of {} N/m: the phase margin is {:.0}° at \
             {} Hz (K T/B = {}; an ideal robot needs less than 2)",
            short(self.admittance_ns_per_m),
            short(contact.stiffness),
            margin.degrees,
            short(margin.crossover_rad_per_s / TAU),
            short(contact.stiffness * self.period_s / self.admittance_ns_per_m),
        );
        let help = match self.good_admittance(contact) {
            Some(good) => {
                format!(
                    "admittance_ns_per_m = {} gives a phase margin of {GOOD_MARGIN_DEG:.0}°",
                    short(good.ceil())
                )
            }
            None => "the object is too stiff for this robot".to_owned(),
        };
        Finding::new(Code::UnstableAdmittance, &key(case, stack, name), message, help)
    }
}
