//! Force axes whose contact would oscillate, or whose impact exceeds what the joints can bear.
//!
//! The delayed force feedback acts on a surface of stiffness K as the negative damping −k K τ, with the gain k and the
//! delay τ from the contact to the torque. The contact is stable while the other dampings exceed it:
//!
//! ```text
//! k K τ < B (1 + k) + c Λ
//! ```
//!
//! with the damping B of the surface, the damping c of the axis and the effective mass Λ at the start. The peak force of an
//! impact with the speed v and the target F is 1.5 F + 0.5 v √(K Λ), a bound of the peaks of simulated impacts.
//!
//! For commands that act so late that the controller predicts the state, the [phase margin](super::contact_margin) takes the place of
//! this rule. It knows up to which stiffness an axis is stable if no surface is stated.

use super::case::PreflightCase;
use super::contact_margin::{ContactLoop, ForceGains};
use super::diagnostic::{at_least, short};
use super::phase_margin::{LEAST_MARGIN_DEG, Margin, rounded_down};
use super::surfaces::{Surface, largest_stable_stiffness, surfaces};
use nalgebra::{DVector, Matrix6xX};
use opspace_control::context::UNPREDICTED_S;
use opspace_control::{AXIS_NAMES, AxisMode, CartesianParameters, ForceParameters, Task, TaskParameters};
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_model::OperationalSpace;
use std::f64::consts::TAU;

/// A force axis of a task, and the surface in front of it.
struct PressingAxis<'a> {
    case: &'a PreflightCase<'a>,
    task_set: usize,
    name: &'a str,
    force: &'a ForceParameters,
    axis: usize,
    /// `None` if none is known.
    surface: Option<Surface>,
    /// Effective mass of the axis while the others are held, kg; mass that a force along the axis moves, kg.
    mass: f64,
    moved_mass: f64,
    /// Joint torques per newton (n; m).
    lever: DVector<f64>,
}

/// Returns a diagnostic for each force axis whose contact is predicted to oscillate or to exceed the torque limits.
pub(crate) fn contacts(case: &PreflightCase<'_>) -> Vec<Finding> {
    let of = |axis: &PressingAxis<'_>| [axis.oscillation(LEAST_MARGIN_DEG), axis.impact()];
    of_axes(case, |axis| of(axis).into_iter().flatten().collect())
}

/// Finds contacts that are unstable because commands act late: a real robot must not try them.
pub(super) fn unstable_contacts(case: &PreflightCase<'_>) -> Vec<Finding> {
    of_axes(case, |axis| axis.is_late().then(|| axis.oscillation(0.0)).flatten().into_iter().collect())
}

/// Lists force axes whose surface is not known, with the stiffness up to which they are stable.
pub(super) fn unknown_contacts(case: &PreflightCase<'_>) -> Vec<Finding> {
    of_axes(case, |axis| axis.unknown().into_iter().collect())
}

/// Findings of all force axes, each once.
fn of_axes(case: &PreflightCase<'_>, examine: impl Fn(&PressingAxis<'_>) -> Vec<Finding>) -> Vec<Finding> {
    let mut found = Vec::new();
    for (task_set, active) in case.task_sets.iter().enumerate() {
        for task in active.tasks.tasks() {
            let Some((name, TaskParameters::Cartesian(parameters))) = active.task.get_key_value(task.name())
            else {
                continue;
            };
            for axis in pressing_axes(case, task_set, (name, task), parameters) {
                for finding in examine(&axis) {
                    if !found.contains(&finding) {
                        found.push(finding);
                    }
                }
            }
        }
    }
    found
}

/// Force axes of a task, each with the stated surface, otherwise with the stiffest one of the environment.
fn pressing_axes<'a>(
    case: &'a PreflightCase<'a>,
    task_set: usize,
    (name, task): (&'a str, &dyn Task),
    parameters: &'a CartesianParameters,
) -> Vec<PressingAxis<'a>> {
    let (model, data) = (case.model, &case.data);
    let in_force = parameters.axes.with_mode(AxisMode::Force);
    let Some(force) = parameters.force.as_ref().filter(|_| in_force[..3].contains(&true)) else {
        return Vec::new();
    };
    let Ok(controlled) = parameters.controlled_frame(model) else { return Vec::new() };
    let Ok(directions) = parameters.axes_frame.resolve(model, controlled) else { return Vec::new() };
    let rotation = controlled.coordinates(model, data) * directions.rotation(model, data, controlled);
    let mut jacobian = Matrix6xX::zeros(model.n());
    task.jacobian(model, data, &mut jacobian);
    let mut space = OperationalSpace::new(model.n());
    space.update(&data.mass_matrix_factor, &jacobian, task.rows(), 0.0);
    let mobility = data.mass_matrix_factor.mobility(&mut jacobian.clone());
    let names = task.row_names();
    let pressing = |axis: usize| {
        let row = names.iter().position(|name| name == AXIS_NAMES[axis])?;
        let stated = force.surface.map(|surface| Surface {
            stiffness: surface.stiffness_n_per_m.get(),
            damping: surface.damping_ns_per_m.get(),
        });
        let present = surfaces(case, &parameters.frame, &rotation.column(axis).into_owned());
        let stiffest = present
            .into_iter()
            .map(|(_, surface)| surface)
            .max_by(|a, b| a.stiffness.total_cmp(&b.stiffness));
        Some(PressingAxis {
            case,
            task_set,
            name,
            force,
            axis,
            surface: stated.or(stiffest),
            mass: space.task_inertia[(row, row)],
            moved_mass: 1.0 / mobility[(row, row)],
            lever: jacobian.row(row).transpose(),
        })
    };
    (0..3).filter(|&axis| in_force[axis]).filter_map(pressing).collect()
}

impl PressingAxis<'_> {
    fn key(&self, key: &str) -> Vec<String> {
        self.case.key(self.task_set, self.name, &["cartesian", "force", key])
    }

    /// Delay from the contact to the torque, s.
    fn delay_s(&self) -> f64 {
        let profile = self.case.experiment.profile().1;
        1.0 / (TAU * self.force.filter_hz.get()) + 1.5 * profile.period_s() + self.command_delay_s()
    }

    fn damping_per_s(&self) -> f64 {
        self.force.damping(self.axis, self.period_s())
    }

    fn period_s(&self) -> f64 {
        self.case.experiment.profile().1.period_s()
    }

    /// True if commands act so late that the controller predicts the state.
    fn is_late(&self) -> bool {
        self.command_delay_s() > UNPREDICTED_S
    }

    fn command_delay_s(&self) -> f64 {
        let profile = self.case.experiment.profile().1;
        f64::from(profile.delay()) * profile.servo_period_s()
    }

    fn contact_loop(&self, surface: Surface) -> ContactLoop {
        ContactLoop {
            mass: self.moved_mass,
            surface,
            period_s: self.period_s(),
            delay_s: self.command_delay_s(),
            filter_hz: self.force.filter_hz.get(),
            velocity_filter_hz: self.case.experiment.profile().1.estimator.velocity_filter_hz.get(),
        }
    }

    fn gains(&self) -> ForceGains {
        ForceGains {
            gain: self.force.force_gain(self.axis, self.period_s()),
            integral_per_s: self.force.integral(self.axis),
            damping_per_s: self.damping_per_s(),
        }
    }

    /// Oscillation of the contact with the known surface; of late commands, with a margin below `least_deg`.
    fn oscillation(&self, least_deg: f64) -> Option<Finding> {
        let surface = self.surface?;
        if !self.is_late() {
            return self.early_oscillation(surface);
        }
        let margin = self.contact_loop(surface).margin(&self.gains())?;
        (margin.degrees < least_deg).then(|| self.late_oscillation(surface, margin))
    }

    fn late_oscillation(&self, surface: Surface, margin: Margin) -> Finding {
        let contact = self.contact_loop(surface);
        let verdict = if margin.degrees < 0.0 { "is unstable" } else { "oscillates" };
        let message = format!(
            "task '{}' presses along {} on a surface of {} N/m, and commands act {} ms after their measurements: the contact \
             {verdict}, with a phase margin of {:.0}° at {} Hz",
            self.name,
            AXIS_NAMES[self.axis],
            short(surface.stiffness),
            short(1e3 * contact.delay_s),
            margin.degrees,
            short(margin.crossover_rad_per_s / TAU)
        );
        let reduced = self.gains().reduced();
        let help = if contact.margin(&reduced).is_none_or(|margin| margin.degrees >= LEAST_MARGIN_DEG) {
            format!(
                "try `gain = {}` and `integral_per_s = {}` in simulation, with the same damping; shorten the delay if you can",
                rounded_down(reduced.gain),
                rounded_down(reduced.integral_per_s)
            )
        } else {
            "a smaller gain leaves too little margin: press through something softer, or shorten the delay"
                .to_owned()
        };
        Finding::new(Code::ContactOscillation, &self.key("gain"), message, help)
    }

    /// Stiffness up to which an axis without a known surface is stable, if commands act late.
    fn unknown(&self) -> Option<Finding> {
        if self.surface.is_some() || !self.is_late() {
            return None;
        }
        let stiffness = largest_stable_stiffness(|surface| {
            let margin = self.contact_loop(surface).margin(&self.gains());
            margin.is_none_or(|margin| margin.degrees >= LEAST_MARGIN_DEG)
        })?;
        let message = format!(
            "task '{}': what the hand presses on along {} is not known: because commands act {} ms late it oscillates on \
             objects that are stiffer than {} N/m",
            self.name,
            AXIS_NAMES[self.axis],
            short(1e3 * self.command_delay_s()),
            rounded_down(stiffness),
        );
        let help = "state the object as `surface = { stiffness_n_per_m = ... }`; with a smaller `gain` it may be stiffer"
            .to_owned();
        Some(Finding::new(Code::UnknownContact, &self.key("gain"), message, help))
    }

    fn early_oscillation(&self, Surface { stiffness, damping }: Surface) -> Option<Finding> {
        let gain = self.force.force_gain(self.axis, self.period_s());
        let (delay_s, c) = (self.delay_s(), self.damping_per_s());
        let (added, present) = (stiffness * delay_s - damping, damping + c * self.mass);
        if gain * added < present {
            return None;
        }
        let largest = present / added;
        let passivity = if self.force.passivity.enabled {
            "; passivity control will reduce the gain as it does"
        } else {
            ""
        };
        let message = format!(
            "task '{}' presses along {} on a surface of {} N/m with the gain {}, and its force acts after {} ms: the \
             contact may oscillate{passivity}",
            self.name,
            AXIS_NAMES[self.axis],
            short(stiffness),
            short(gain),
            short(1e3 * delay_s)
        );
        let needed = (gain * added - damping) / self.mass;
        let help = format!(
            "set `gain` to at most {} or, if the velocity is known well enough, `damping_per_s` to {}",
            short(0.9 * largest),
            at_least(needed)
        );
        Some(Finding::new(Code::ContactOscillation, &self.key("gain"), message, help))
    }

    fn impact(&self) -> Option<Finding> {
        let target = self.force.largest_target(self.axis);
        let speed = match &self.force.contact {
            Some(contact) => contact.approach_m_per_s.get(),
            None => target / (self.damping_per_s() * self.mass),
        };
        let surface = self.surface?;
        let of_speed = 0.5 * (surface.stiffness * self.mass).sqrt();
        let peak = 1.5 * target + of_speed * speed;
        let limits = self.case.experiment.robot().torque_limits();
        let (joint, largest) = self
            .lever
            .iter()
            .enumerate()
            .map(|(joint, lever)| (joint, limits[joint] / lever.abs()))
            .min_by(|a, b| a.1.total_cmp(&b.1))?;
        if peak <= largest {
            return None;
        }
        let message = format!(
            "task '{}' touches a surface of {} N/m along {} at {} m/s: the peak of some {} N exceeds the torque limit of {}, \
             which bears {} N",
            self.name,
            short(surface.stiffness),
            AXIS_NAMES[self.axis],
            short(speed),
            short(peak),
            self.case.joint(joint),
            short(largest)
        );
        let slower = ((largest - 1.5 * target) / of_speed).max(0.0);
        let help = if slower > 0.0 {
            format!("approach with `contact = {{ approach_m_per_s = {} }}`", short(0.9 * slower))
        } else {
            format!("reduce the target, to at most {} N", short(largest / 1.5))
        };
        Some(Finding::new(Code::ContactImpact, &self.key("contact"), message, help))
    }
}
