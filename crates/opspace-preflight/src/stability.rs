//! Gains that are too high for the rate, the delay and the servo of the robot: the phase margin of the loop.
//!
//! The model is one joint of inertia I under a sampled control law C(s) with the gains of the task. With the
//! interface period T, the servo period T_s, the servo delay of d servo ticks, and R = T/T_s,
//!
//! ```text
//! C(s) = k (1 + i/s) + c V(s)          V(s) = a (1 − z⁻¹)/T / (1 − (1 − a) z⁻¹),  z = exp(s T)
//! ```
//!
//! where V is the velocity estimate: a finite difference and a low-pass filter with a group delay of T/2 + T (1 −
//! a)/a. A torque robot holds the torque for one period:
//!
//! ```text
//! L(s) = C(s) exp(−s d T_s) Z(T)/s²     Z(T) = (1 − exp(−s T))/(s T), half a period of delay
//! ```
//!
//! A position robot holds the setpoint of equation (K10), which is computed for a stiffness K = kv kp and a damping D
//! = kv. Its servo closes an inner loop: S is the servo's torque for a setpoint and Y its torque for a position (for
//! equation (K9), S = kv kp and Y = −kv (kp + W) with the velocity filter W of the servo). B is the delay of the
//! setpoint and its hold over R servo ticks (twice the hold if the drive interpolates):
//!
//! ```text
//! L(s) = I C (S/K) B Z(T_s) / (I s² − Z(T_s) [(S/K) (K + D V) B + Y])
//! B(s) = exp(−s d T_s) (1 − exp(−s T))/(R (1 − exp(−s T_s)))
//! ```
//!
//! A velocity robot holds the velocity setpoint of its transformer, which inverts S, the servo's torque for a
//! setpoint (kv without an integral), and compensates kv q̇ with the estimated velocity; here Y = −S W:
//!
//! ```text
//! L(s) = I C B Z(T_s) / (I s² − Z(T_s) [S V B + Y])
//! ```
//!
//! In both cases the bracket is zero without hold and lag: the servo is then inverted exactly. With them, the first
//! terms of the bracket in s act as additional damping and inertia, like a servo that lags. At |L| = 1, the phase
//! margin is 180° + arg L. The emulating and extrapolating transformers are treated like that of the paper, and observers
//! like the filter: with an exact model an observer allows higher gains, but how exact the model is, is not known here. They also
//! take away the damping of a drive that lags, with which the loop of (K10) bears a long delay. Their loop must therefore have the
//! margin of the torque robot too, with a velocity that does not lag; the smaller one counts. If commands act so late that they are
//! predicted (below), these transformers foresee the state of the servo too, and theirs is the loop of the torque robot alone.
//!
//! Commands that act more than [`UNPREDICTED_S`] late are computed for the state that the controller predicts for that time, from the
//! measured one and the commands that act until then. With D = d T_s, the law is then
//!
//! ```text
//! C(s) = [k (1 + i/s) (1 + D V) + c V] / (1 + k (1 + i/s) M₂ + c M₁)
//! M₁ = Σ_j (t_j − t_{j−1}) e^(−j s T)      M₂ = Σ_j ½ (t_j² − t_{j−1}²) e^(−j s T)      t_j = min(j T, D)
//! ```
//!
//! This C may have unstable poles, and then the phase of L does not tell whether the loop is stable. The loop opened at the
//! controller's output has none, and decides the sign of the margin; its size is the least angle between L and −1 where |L| = 1.
//!
//! Drives that filter setpoints or feed their velocity forward are not inverted by (K10). The emulating and extrapolating
//! transformers invert them; with the mean torques h_k of the intervals after a desired torque of 1, for a joint at rest,
//!
//! ```text
//! L(s) = C(s) Z(T)/s² Σ h_k exp(−s k T)
//! ```
//!
//! The stiffness K of an impedance is an acceleration K/m of the mass m = 1/(J M⁻¹ Jᵀ) that the arm has along the axis at the
//! start.
//!
//! The coupling of joints, friction and the lag of the motor are not included. Force feedback, which depends on the stiffness of
//! the environment, is not examined, and neither are impedances that vary or shape the mass.

use super::case::PreflightCase;
use super::diagnostic::short;
use super::phase_margin::{
    GOOD_MARGIN_DEG, LEAST_MARGIN_DEG, Margin, filtered_difference, hold, least_distance, least_margin,
    of_commands_until, rounded_down,
};
use nalgebra::{Complex, Matrix6xX};
use opspace_backend::quantity::NonNegative;
use opspace_backend::{CommandKind, Sample, Setpoints};
use opspace_control::context::UNPREDICTED_S;
use opspace_control::{
    AXIS_NAMES, AxisMode, BuildTask, ImpedanceParameters, JointTask, PerAxis, RowGains, Task, TaskParameters,
};
use opspace_experiment::codes::Code;
use opspace_experiment::files::controller_kind::ControllerKind;
use opspace_experiment::finding::Finding;
use opspace_experiment::run::experiment::Experiment;
use opspace_transformer::impulse_response::ImpulseResponse;
use opspace_transformer::moving_joint::MovingJoint;
use opspace_transformer::{ProfileParameters, ServoGains, ServoLaw, ServoParameters, VelocityEstimator};
use std::f64::consts::TAU;
use std::fmt;

/// Cutoff frequency of a velocity estimate that does not lag, Hz.
const IDEAL_FILTER_HZ: f64 = 1e6;

/// Damping ratio of an impedance whose file states neither a ratio nor a damping.
const IMPEDANCE_DAMPING_RATIO: f64 = 0.7;

/// Smallest phase margin of the control loops of an experiment, and the delay on which it depends.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct LoopMargin {
    /// Task with this margin, and its joint.
    pub task: String,
    /// Joint that moves it.
    pub joint: String,
    /// Phase margin, degrees; negative if the loop is unstable.
    pub degrees: f64,
    /// Frequency at which the loop has the gain 1, Hz.
    pub crossover_hz: f64,
    /// Declared delay from a sample until its command acts, interface cycles and s.
    pub delay_cycles: f64,
    /// Delay, s.
    pub delay_s: f64,
}

impl fmt::Display for LoopMargin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { task, joint, degrees, crossover_hz, delay_cycles, delay_s } = self;
        write!(
            f,
            "commands act {} interface cycles ({} ms) after their samples: the least phase margin is {degrees:.0}° at {} Hz \
             (task '{task}', joint '{joint}')",
            short(*delay_cycles),
            short(1e3 * delay_s),
            short(*crossover_hz),
        )
    }
}

/// Returns the smallest phase margin over all task sets at the declared delay. `None` without a loop whose gains are known, and
/// for inverse kinematics.
#[must_use]
pub fn loop_margin(experiment: &Experiment) -> Option<LoopMargin> {
    let is_torque = experiment.options().controller == ControllerKind::Osc;
    let case = is_torque.then(|| PreflightCase::new(experiment)).flatten()?;
    let responses = responses(&case);
    let mut least: Option<LoopMargin> = None;
    let profile = experiment.profile().1;
    let delay_s = f64::from(profile.delay()) * profile.servo_period_s();
    for stack in 0..case.task_sets.len() {
        for name in case.task_sets[stack].priority {
            for follower in followers(&case, &responses, stack, name) {
                let Some(margin) = follower.plant.least_margin(&follower.law) else { continue };
                if least.as_ref().is_none_or(|least| margin.degrees < least.degrees) {
                    least = Some(LoopMargin {
                        task: name.clone(),
                        joint: follower.joint.to_owned(),
                        degrees: margin.degrees,
                        crossover_hz: margin.crossover_rad_per_s / TAU,
                        delay_cycles: delay_s / profile.period_s(),
                        delay_s,
                    });
                }
            }
        }
    }
    least
}

/// Finds gains that are too high: for each task the worst axis or joint over all task sets.
pub(crate) fn stiff_gains(case: &PreflightCase<'_>) -> Vec<Finding> {
    gains_below(case, LEAST_MARGIN_DEG)
}

/// Finds gains with which a loop is unstable, like [`stiff_gains`].
pub(crate) fn unstable_gains(case: &PreflightCase<'_>) -> Vec<Finding> {
    gains_below(case, 0.0)
}

/// Finds gains with a phase margin below `least_deg`, for each task the worst axis or joint over all task sets.
fn gains_below(case: &PreflightCase<'_>, least_deg: f64) -> Vec<Finding> {
    let mut found: Vec<Finding> = Vec::new();
    let responses = responses(case);
    for stack in 0..case.task_sets.len() {
        for name in case.task_sets[stack].priority {
            let finding = stiff_task(case, &responses, stack, name, least_deg);
            found.extend(finding.filter(|new| !found.iter().any(|old| old.place == new.place)));
        }
    }
    found
}

/// Responses to a desired torque of the joints whose drives only the transformer inverts (n); empty for the others.
fn responses(case: &PreflightCase<'_>) -> Vec<Vec<f64>> {
    let experiment = case.experiment;
    let evaluates_law = experiment.transformer_traits().is_some_and(|traits| traits.evaluates_servo_law);
    let (n, timing) = (case.model.n(), experiment.drive_timing());
    let mut responses = vec![Vec::new(); n];
    let (Ok(mut transformer), Ok(servos), true) =
        (experiment.transformer(), experiment.servos(), evaluates_law)
    else {
        return responses;
    };
    for (joint, (response, servo)) in responses.iter_mut().zip(&servos).enumerate() {
        let law = ServoLaw::new(servo, timing.servo_period_s);
        let Some(law) = law.ok().filter(|_| !servo.has_plain_setpoint()) else { continue };
        let velocity = VelocityEstimator::new(n, &experiment.profile().1.estimator, timing.period_s());
        let sample = Sample::new(&experiment.capabilities());
        let mut arm = MovingJoint::new(&mut *transformer, &case.data, joint, velocity, sample);
        *response = ImpulseResponse::new(&mut arm, law, timing).torque;
    }
    responses
}

fn stiff_task(
    case: &PreflightCase<'_>,
    responses: &[Vec<f64>],
    stack: usize,
    name: &str,
    least_deg: f64,
) -> Option<Finding> {
    let worst = followers(case, responses, stack, name).into_iter().filter_map(|follower| {
        let margin = follower.plant.least_margin(&follower.law)?;
        // If less than half of the margin of the ideal loop remains, the cause is delay and not low damping.
        let ideal = Plant::ideal().margin(&follower.law).map_or(90.0, |ideal| ideal.degrees);
        (margin.degrees < least_deg.min(0.5 * ideal)).then_some((follower, margin))
    });
    let (follower, margin) = worst.min_by(|a, b| a.1.degrees.total_cmp(&b.1.degrees))?;
    let AxisLoop { law, plant, of, joint, key, quantity, value, .. } = &follower;
    let how = if margin.degrees < 0.0 {
        format!("would be unstable on this robot: the phase margin is {:.0}°", margin.degrees)
    } else {
        format!("would oscillate on this robot: the phase margin is only {:.0}°", margin.degrees)
    };
    let message = format!(
        "task '{name}': {of} {how} at {} Hz, on joint '{joint}', with a delay of {} ms from measurement to torque{}",
        short(margin.crossover_rad_per_s / TAU),
        short(1e3 * plant.delay_s()),
        if plant.servo.is_some() { " in addition to the servo's lag" } else { "" },
    );
    let help = match plant.highest_scale(law) {
        Some(scale) => format!(
            "{quantity} = {} gives a phase margin of {GOOD_MARGIN_DEG:.0}°",
            rounded_down(scale.powi(follower.order) * value)
        ),
        None => "raise damping_ratio: with this one no stiffness has enough margin".to_owned(),
    };
    Some(Finding::new(Code::GainsTooHigh, &case.key(stack, name, key), message, help))
}

/// Control loop of an axis or a joint.
struct AxisLoop<'a> {
    law: AxisFeedback,
    plant: Plant<'a>,
    /// Description of the gains: quantity, value and axis.
    of: String,
    joint: &'a str,
    key: Vec<&'a str>,
    /// Quantity that makes the loop stiff, and its value.
    quantity: &'static str,
    value: f64,
    /// Power of the frequency of the loop to which the quantity is proportional: 2 for a stiffness.
    order: i32,
}

/// Lists tasks with unknown gains: their stability is not checked.
pub(crate) fn not_checked(case: &PreflightCase<'_>) -> Vec<Finding> {
    let mut found: Vec<Finding> = Vec::new();
    for (number, stack) in case.task_sets.iter().enumerate() {
        let rows = stack.tasks.tasks().map(|task| {
            let names = task.row_names().into_iter().enumerate();
            let unknown = names.filter(|(row, _)| task.gains(*row).is_none()).map(|(_, name)| name);
            (task.name(), unknown.collect::<Vec<_>>())
        });
        let joints = stack.tasks.joint_task().map(|task| {
            let unknown = (0..case.model.n()).filter(|&joint| task.gains(joint, 1.0).is_none());
            (task.name(), unknown.map(|joint| case.joint(joint).to_owned()).collect::<Vec<_>>())
        });
        for (name, unknown) in rows.chain(joints).filter(|(_, unknown)| !unknown.is_empty()) {
            let has_impedance = |parameters: &TaskParameters| match parameters {
                TaskParameters::Cartesian(parameters) => parameters.impedance.is_some(),
                _ => false,
            };
            let unknown = unknown.join(", ");
            let (key, message, help) = if stack.task.get(name).is_some_and(has_impedance) {
                let message = format!(
                    "task '{name}': how fast the impedance along {unknown} answers depends on the mass that the arm has there: \
                     its stability with the rate and delay of this robot is checked at the start at most"
                );
                let help = "run it in simulation, with the contacts and pushes that it will meet; `opspace model ROBOT` prints \
                            these masses, and the frequency is the square root of stiffness over mass";
                (case.key(number, name, &["cartesian", "impedance"]), message, help.to_owned())
            } else {
                let message = format!(
                    "task '{name}': the gains of {unknown} are not known before the run: their stability with the rate and \
                     delay of this robot is not checked"
                );
                (case.key(number, name, &[]), message, "test it in simulation".to_owned())
            };
            let finding = Finding::new(Code::UnknownGains, &key, message, help);
            if !found.contains(&finding) {
                found.push(finding);
            }
        }
    }
    found
}

/// Control loops of all rows or joints of a task.
fn followers<'a>(
    case: &'a PreflightCase<'_>,
    responses: &'a [Vec<f64>],
    stack: usize,
    name: &'a str,
) -> Vec<AxisLoop<'a>> {
    let in_force = &case.task_sets[stack];
    if let Some(task) = in_force.tasks.tasks().find(|task| task.name() == name) {
        return row_followers(case, responses, stack, task);
    }
    match in_force.tasks.joint_task().filter(|task| task.name() == name) {
        Some(task) => joint_followers(case, responses, stack, task),
        None => Vec::new(),
    }
}

/// Control loops of each row of a task with each joint that moves it.
fn row_followers<'a>(
    case: &'a PreflightCase<'_>,
    responses: &'a [Vec<f64>],
    stack: usize,
    task: &dyn Task,
) -> Vec<AxisLoop<'a>> {
    let Some(parameters) = case.task_sets[stack].task.get(task.name()) else { return Vec::new() };
    let (kind, names) = (parameters.kind(), task.row_names());
    let mut jacobian = Matrix6xX::zeros(case.model.n());
    task.jacobian(case.model, &case.data, &mut jacobian);
    let mut followers = Vec::new();
    for row in 0..task.rows() {
        let Some(gains) = task.gains(row) else { continue };
        let law = AxisFeedback::of_gains(&gains);
        let along = match parameters {
            TaskParameters::JointTracking(_) => String::new(),
            _ => format!(" along {}", names[row]),
        };
        let (quantity, value, key) = match (law.stiffness > 0.0, parameters) {
            (true, _) => match parameters.frequency_key() {
                None => ("natural frequency in rad/s", law.stiffness.sqrt(), vec![kind]),
                Some(keys) => (keys[keys.len() - 1], law.stiffness.sqrt(), below(kind, keys)),
            },
            (false, TaskParameters::Cartesian(cartesian)) if law.damping > 0.0 => {
                let in_force = cartesian.axes.with_mode(AxisMode::Force);
                let is_force =
                    AXIS_NAMES.iter().zip(in_force).any(|(name, force)| force && *name == names[row]);
                let (quantity, keys) = if is_force {
                    ("force.damping_per_s", vec![kind, "force", "damping_per_s"])
                } else {
                    ("compliant_damping_per_s", vec![kind, "compliant_damping_per_s"])
                };
                (quantity, law.damping, keys)
            }
            (false, TaskParameters::Registered(_)) if law.damping > 0.0 => {
                ("damping in 1/s", law.damping, vec![kind])
            }
            _ => continue,
        };
        let largest = jacobian.row(row).amax();
        let joints = (0..case.model.n()).filter(|&joint| jacobian[(row, joint)].abs() > 1e-6 * largest);
        followers.extend(joints.map(|joint| AxisLoop {
            law,
            plant: Plant::new(case, responses, joint),
            of: format!("{quantity} = {}{along}", short(value)),
            joint: case.joint(joint),
            key: key.clone(),
            quantity,
            value,
            order: 1,
        }));
    }
    followers.extend(impedance_followers(case, responses, stack, task, &jacobian));
    followers
}

/// Keys of a value below the kind of its task.
fn below<'a>(kind: &'a str, keys: &[&'a str]) -> Vec<&'a str> {
    std::iter::once(kind).chain(keys.iter().copied()).collect()
}

/// Control loops of each axis of an impedance with each joint that moves it. `jacobian` is that of the task at the start.
fn impedance_followers<'a>(
    case: &'a PreflightCase<'_>,
    responses: &'a [Vec<f64>],
    stack: usize,
    task: &dyn Task,
    jacobian: &Matrix6xX<f64>,
) -> Vec<AxisLoop<'a>> {
    let Some(TaskParameters::Cartesian(parameters)) = case.task_sets[stack].task.get(task.name()) else {
        return Vec::new();
    };
    let Some(impedance) = parameters.impedance.as_ref().filter(|impedance| is_constant(impedance)) else {
        return Vec::new();
    };
    let mobility = case.data.mass_matrix_factor.mobility(&mut jacobian.clone());
    let motion = parameters.axes.with_mode(AxisMode::Motion);
    let mut followers = Vec::new();
    for (row, name) in task.row_names().iter().enumerate() {
        let Some(axis) = AXIS_NAMES.iter().position(|axis| axis == name) else { continue };
        let (stiffness, damping, quantity) = match axis {
            0..3 => (impedance.stiffness_n_per_m, impedance.damping_ns_per_m, "stiffness_n_per_m"),
            _ => (impedance.stiffness_nm_per_rad, impedance.damping_nms_per_rad, "stiffness_nm_per_rad"),
        };
        let of_axis = |values: Option<PerAxis<NonNegative>>| values.and_then(|values| values.get(axis));
        let Some(stiffness) = of_axis(stiffness).map(NonNegative::get) else { continue };
        // Inverse of the mass, 1/kg, or of the moment of inertia, 1/(kg m²): rows of rotations are scaled to m.
        let mobility = mobility[(row, row)] / task.row_unit(row).1.powi(2);
        if !motion[axis] || stiffness == 0.0 || mobility <= 0.0 {
            continue;
        }
        let square = stiffness * mobility;
        let ratio = impedance.damping_ratio.map_or(IMPEDANCE_DAMPING_RATIO, NonNegative::get);
        let damping =
            of_axis(damping).map_or(2.0 * ratio * square.sqrt(), |damping| damping.get() * mobility);
        let law = AxisFeedback { stiffness: square, damping, integral: 0.0 };
        let largest = jacobian.row(row).amax();
        let joints = (0..case.model.n()).filter(|&joint| jacobian[(row, joint)].abs() > 1e-6 * largest);
        followers.extend(joints.map(|joint| AxisLoop {
            law,
            plant: Plant::new(case, responses, joint),
            of: format!(
                "{quantity} = {} along {} ({} rad/s with the mass at the start)",
                short(stiffness),
                AXIS_NAMES[axis],
                short(square.sqrt())
            ),
            joint: case.joint(joint),
            key: vec!["cartesian", "impedance", quantity],
            quantity,
            value: stiffness,
            order: 2,
        }));
    }
    followers
}

/// True if the gains of an impedance do not vary with time, and act on the arm's own mass.
fn is_constant(impedance: &ImpedanceParameters) -> bool {
    impedance.profile.is_none() && impedance.inertia_kg.is_none() && impedance.inertia_kg_m2.is_none()
}

/// Control loops of the joints of a joint task.
fn joint_followers<'a>(
    case: &'a PreflightCase<'_>,
    responses: &'a [Vec<f64>],
    stack: usize,
    task: &dyn JointTask,
) -> Vec<AxisLoop<'a>> {
    let Some(parameters) = case.task_sets[stack].task.get(task.name()) else { return Vec::new() };
    let kind = parameters.kind();
    let mut followers = Vec::new();
    for joint in 0..case.model.n() {
        let plant = Plant::new(case, responses, joint);
        let Some(gains) = task.gains(joint, plant.inertia) else { continue };
        let law = AxisFeedback::of_gains(&gains);
        let (quantity, value, key) = match parameters {
            TaskParameters::JointDamping(_) => {
                let quantity = "damping_nms_per_rad";
                (quantity, law.damping * plant.inertia, vec![kind, quantity])
            }
            _ => {
                let Some(keys) = parameters.frequency_key() else { continue };
                (keys[keys.len() - 1], law.stiffness.sqrt(), below(kind, keys))
            }
        };
        if value > 0.0 {
            let of = format!("{quantity} = {}", short(value));
            let joint = case.joint(joint);
            followers.push(AxisLoop { law, plant, of, joint, key, quantity, value, order: 1 });
        }
    }
    followers
}

/// Control law: acceleration k (1 + i/s) times the position error plus c times the velocity error.
#[derive(Clone, Copy, Debug)]
struct AxisFeedback {
    /// Stiffness k, 1/s².
    stiffness: f64,
    /// Damping c, 1/s.
    damping: f64,
    /// Integral i, 1/s.
    integral: f64,
}

impl AxisFeedback {
    fn of_gains(gains: &RowGains) -> Self {
        let RowGains { stiffness_per_s2, damping_per_s, integral_per_s } = *gains;
        Self { stiffness: stiffness_per_s2, damping: damping_per_s, integral: integral_per_s }
    }

    #[cfg(test)]
    fn of(omega: f64, zeta: f64, integral: f64) -> Self {
        Self { stiffness: omega * omega, damping: 2.0 * zeta * omega, integral }
    }

    /// Returns the law with its frequency times `scale`.
    fn scaled(self, scale: f64) -> Self {
        Self { stiffness: scale * scale * self.stiffness, damping: scale * self.damping, ..self }
    }

    /// Crossover frequency of the law without any delay, rad/s.
    fn bandwidth(&self) -> f64 {
        let half = 0.5 * self.damping * self.damping;
        (half + (half * half + self.stiffness * self.stiffness).sqrt()).sqrt()
    }
}

/// Servo, and the gains that its transformer assumes.
#[derive(Clone, Copy, Debug)]
struct Servo {
    takes: CommandKind,
    law: ServoLaw,
    gains: ServoGains,
    setpoints: Setpoints,
}

impl Servo {
    fn of(servo: &ServoParameters, period_s: f64, setpoints: Setpoints) -> Option<Self> {
        let law = ServoLaw::new(servo, period_s).ok()?;
        Some(Self { takes: servo.takes(), law, gains: servo.gains(period_s), setpoints })
    }
}

/// Plant of the control law: a joint with its drive.
#[derive(Clone, Copy, Debug)]
struct Plant<'a> {
    /// Inertia, kg m².
    inertia: f64,
    /// Servo of the drive; `None` for a torque robot, and for a drive that only the transformer inverts.
    servo: Option<Servo>,
    /// Mean torques of the intervals after a desired torque of 1, if only the transformer inverts the drive; otherwise empty.
    response: &'a [f64],
    /// Interface period T and servo period T_s, s.
    period_s: f64,
    servo_period_s: f64,
    delay_s: f64,
    /// True if the controller predicts the state at which a command acts.
    is_predicted: bool,
    /// Cutoff frequency of the velocity estimate, Hz.
    filter_hz: f64,
    /// True if the transformer evaluates the law of the servo.
    is_inverted: bool,
}

impl<'a> Plant<'a> {
    fn new(case: &PreflightCase<'_>, responses: &'a [Vec<f64>], joint: usize) -> Self {
        let profile: &ProfileParameters = case.experiment.profile().1;
        let setpoints = case.experiment.robot().file.interface.setpoints;
        let servos = match case.experiment.command_kind() {
            CommandKind::Torque => Vec::new(),
            CommandKind::Position | CommandKind::Velocity => case.experiment.servos().unwrap_or_default(),
        };
        let servo = |servo| Servo::of(servo, profile.servo_period_s(), setpoints);
        let delay_s = f64::from(profile.delay()) * profile.servo_period_s();
        Self {
            inertia: case.data.mass_matrix[(joint, joint)],
            servo: servos.get(joint).filter(|_| responses[joint].is_empty()).and_then(servo),
            response: &responses[joint],
            period_s: profile.period_s(),
            servo_period_s: profile.servo_period_s(),
            delay_s,
            is_predicted: delay_s > UNPREDICTED_S,
            filter_hz: profile.estimator.velocity_filter_hz.get(),
            is_inverted: case
                .experiment
                .transformer_traits()
                .is_some_and(|traits| traits.evaluates_servo_law),
        }
    }

    /// Creates a plant with a period of 1 µs, practically without delay.
    fn ideal() -> Self {
        let tick_s = 1e-6;
        Self {
            inertia: 1.0,
            servo: None,
            response: &[],
            period_s: tick_s,
            servo_period_s: tick_s,
            delay_s: 0.0,
            is_predicted: false,
            filter_hz: IDEAL_FILTER_HZ,
            is_inverted: false,
        }
    }

    /// Delay from a position to the middle of the torque interval that responds to it, including the velocity
    /// estimate, s.
    fn delay_s(&self) -> f64 {
        let pole = (-TAU * self.filter_hz * self.period_s).exp();
        let of_drive_s = if self.response.is_empty() {
            self.delay_s
        } else {
            self.period_s
                * self.response.iter().zip(0_u32..).map(|(torque, k)| f64::from(k) * torque).sum::<f64>()
        };
        of_drive_s + self.period_s + self.period_s * pole / (1.0 - pole)
    }

    /// Open-loop transfer function L at an angular frequency, rad/s, opened at the plant.
    fn open_loop(&self, law: &AxisFeedback, omega: f64) -> Complex<f64> {
        let s = Complex::new(0.0, omega);
        let velocity = filtered_difference(s, self.period_s, self.filter_hz);
        self.of_position(law, s, velocity) * self.of_force(s, velocity) / (1.0 + self.of_commands(law, s))
    }

    /// Open-loop transfer function opened at the controller's output: the prediction is part of the loop.
    fn open_loop_of_controller(&self, law: &AxisFeedback, omega: f64) -> Complex<f64> {
        let s = Complex::new(0.0, omega);
        let velocity = filtered_difference(s, self.period_s, self.filter_hz);
        self.of_commands(law, s) + self.of_position(law, s, velocity) * self.of_force(s, velocity)
    }

    /// Transfer function from an acceleration, 1/s², that the law demands to the position of the joint.
    fn of_force(&self, s: Complex<f64>, velocity: Complex<f64>) -> Complex<f64> {
        let late = (-s * self.delay_s).exp();
        let Some(servo) = self.servo else {
            let back = (-s * self.period_s).exp();
            let response = self.response.iter().rev().fold(Complex::ZERO, |sum, torque| sum * back + torque);
            let of_drive = if self.response.is_empty() { late } else { response };
            return of_drive * hold(s, self.period_s) / (s * s);
        };
        let [of_setpoint, of_position] = servo.law.response((s * self.servo_period_s).exp());
        let own_hold = hold(s, self.servo_period_s);
        let held = hold(s, self.period_s) / own_hold;
        let setpoint = match servo.setpoints {
            Setpoints::Held => late * held,
            Setpoints::Interpolated => late * held * held,
        };
        let (led, servo_loop) = match servo.takes {
            CommandKind::Velocity => {
                let led = own_hold * setpoint;
                (led, led * of_setpoint * velocity + own_hold * of_position)
            }
            CommandKind::Position | CommandKind::Torque => {
                let ServoGains { stiffness, damping } = servo.gains;
                let led = own_hold * of_setpoint * setpoint / stiffness;
                (led, led * (stiffness + damping * velocity) + own_hold * of_position)
            }
        };
        self.inertia * led / (self.inertia * s * s - servo_loop)
    }

    /// Law from the measured position: C, or its numerator if the controller predicts.
    fn of_position(&self, law: &AxisFeedback, s: Complex<f64>, velocity: Complex<f64>) -> Complex<f64> {
        let ahead_s = if self.is_predicted { self.delay_s } else { 0.0 };
        law.damping * velocity + law.stiffness * (1.0 + law.integral / s) * (1.0 + ahead_s * velocity)
    }

    /// Law from the commands that act until then, k (1 + i/s) M₂ + c M₁; zero if the controller does not predict.
    fn of_commands(&self, law: &AxisFeedback, s: Complex<f64>) -> Complex<f64> {
        if !self.is_predicted {
            return Complex::ZERO;
        }
        let back = (-s * self.period_s).exp();
        let [of_velocity, of_position] = of_commands_until(self.delay_s, self.period_s, back);
        let stiffness = law.stiffness * (1.0 + law.integral / s);
        law.damping * of_velocity + stiffness * of_position
    }

    /// Smaller one of the margins with the drive and, if the transformer inverts it, with its torque as desired.
    fn least_margin(&self, law: &AxisFeedback) -> Option<Margin> {
        let inverted = self.is_inverted.then_some(Self { servo: None, filter_hz: IDEAL_FILTER_HZ, ..*self });
        let inverted = inverted.and_then(|plant| plant.margin(law));
        if self.is_predicted && inverted.is_some() {
            return inverted;
        }
        let with_drive = self.margin(law)?;
        inverted.into_iter().chain([with_drive]).min_by(|a, b| a.degrees.total_cmp(&b.degrees))
    }

    /// Smallest margin over all crossovers; `None` if the law has no stiffness and no damping.
    fn margin(&self, law: &AxisFeedback) -> Option<Margin> {
        if law.stiffness <= 0.0 && law.damping <= 0.0 {
            return None;
        }
        let first = 1e-3 * law.bandwidth();
        if !self.is_predicted {
            return least_margin(first, self.period_s, |omega| self.open_loop(law, omega));
        }
        // C may be unstable by itself, so that the phase of L does not tell whether the loop is stable.
        let nominal = least_margin(first, self.period_s, |omega| self.open_loop_of_controller(law, omega))?;
        if nominal.degrees <= 0.0 {
            return Some(nominal);
        }
        let at_plant = least_distance(first, self.period_s, |omega| self.open_loop(law, omega));
        at_plant.into_iter().chain([nominal]).min_by(|a, b| a.degrees.total_cmp(&b.degrees))
    }

    /// Largest factor, at most 1, by which the frequency of the law can be multiplied for a margin of
    /// `GOOD_MARGIN_DEG`.
    fn highest_scale(&self, law: &AxisFeedback) -> Option<f64> {
        let good = |scale: f64| {
            self.least_margin(&law.scaled(scale)).is_some_and(|margin| margin.degrees >= GOOD_MARGIN_DEG)
        };
        let (mut low, mut high) = (1e-4, 1.0);
        if !good(low) {
            return None;
        }
        for _ in 0..40 {
            let middle = (low * high).sqrt();
            if good(middle) { low = middle } else { high = middle }
        }
        Some(low)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use opspace_backend::quantity::{NonNegative, Positive};
    use opspace_model::{Data, Joint, JointKind, Limits, Model};
    use opspace_model::{Inertia, Placement};
    use opspace_transformer::estimator::{EstimatorParameters, VelocityEstimator};
    use opspace_transformer::{
        CascadedServo, PaperTransformer, Transformer, VelocityServo, VelocityTransformer,
    };
    use std::f64::consts::PI;

    const INERTIA: f64 = 0.4;

    fn plant(
        servo_hz: f64,
        ratio: u32,
        delay: u32,
        filter_hz: f64,
        servo: Option<ServoParameters>,
    ) -> Plant<'static> {
        let servo = servo.and_then(|servo| Servo::of(&servo, 1.0 / servo_hz, Setpoints::Held));
        Plant {
            inertia: INERTIA,
            servo,
            response: &[],
            period_s: f64::from(ratio) / servo_hz,
            servo_period_s: 1.0 / servo_hz,
            delay_s: f64::from(delay) / servo_hz,
            is_predicted: f64::from(delay) / servo_hz > UNPREDICTED_S,
            filter_hz,
            is_inverted: false,
        }
    }

    /// Position servo as in the robots' profiles: a velocity loop with a bandwidth of `hz`, and a position loop with
    /// a fifth of it.
    fn servo(hz: f64, filter_hz: f64) -> ServoParameters {
        let (kp, kv) = (Positive::literal(TAU * hz / 5.0), Positive::literal(TAU * hz * INERTIA));
        ServoParameters::Cascaded(CascadedServo::new(kp, kv, Positive::literal(filter_hz)))
    }

    /// Velocity servo that consists of the velocity loop of `servo`.
    fn velocity_servo(hz: f64, filter_hz: f64) -> ServoParameters {
        ServoParameters::Velocity(VelocityServo {
            kv_nms_per_rad: Positive::literal(TAU * hz * INERTIA),
            ki_nm_per_rad: NonNegative::default(),
            velocity_filter_hz: Positive::literal(filter_hz),
        })
    }

    fn transformer(servo: &Servo) -> Box<dyn Transformer> {
        match servo.takes {
            CommandKind::Velocity => Box::new(VelocityTransformer::new(vec![servo.gains])),
            _ => Box::new(PaperTransformer::new(vec![servo.gains])),
        }
    }

    /// Fraction of the initial error that remains after `duration_s` in a simulation of the sampled loop, cycle by
    /// cycle, with the robots' estimator, transformer and servo, and an exactly integrated mass.
    fn simulated(plant: &Plant<'_>, law: &AxisFeedback, duration_s: f64) -> f64 {
        let ratio = (plant.period_s / plant.servo_period_s).round() as usize;
        let delay = (plant.delay_s / plant.servo_period_s).round() as usize;
        let ts = plant.servo_period_s;
        let parameters = EstimatorParameters {
            velocity_filter_hz: Positive::literal(plant.filter_hz),
            ..EstimatorParameters::default()
        };
        let mut estimator = VelocityEstimator::new(1, &parameters, plant.period_s);
        let (mut q, mut dq) = (1e-3, 0.0);
        let mut drive = plant.servo.map(|servo| (servo.law, servo.law.rest(q, 0.0).0));
        let transformer = plant.servo.as_ref().map(transformer);
        let mut model = Model::new("mass");
        let joint = Joint { name: "joint".into(), kind: JointKind::Continuous, limits: Limits::NONE };
        model.add_body(None, Placement::identity(), joint, Inertia::zero());
        let (mut data, mut transformer) = (Data::new(&model), transformer);
        // Setpoint at rest: the position, or zero velocity or torque.
        let holds_position = plant.servo.is_some_and(|servo| servo.takes == CommandKind::Position);
        let mut active = if holds_position { q } else { 0.0 };
        // Commands and desired torques of all cycles.
        let mut sent: Vec<(f64, f64)> = Vec::new();
        let mut largest = 0.0_f64;
        let ticks = (duration_s / ts) as usize;
        for tick in 0..ticks {
            if tick % ratio == 0 {
                data.q[0] = q;
                data.dq[0] = estimator.update(&[q])[0];
                let (mut position, mut velocity) = (q, data.dq[0]);
                for later in tick..if plant.is_predicted { tick + delay } else { tick } {
                    let acting = later.checked_sub(delay).and_then(|since| sent.get(since / ratio));
                    let a = acting.map_or(0.0, |(_, torque)| torque / plant.inertia);
                    position += ts * (velocity + 0.5 * ts * a);
                    velocity += ts * a;
                }
                let torque = -plant.inertia * (law.stiffness * position + law.damping * velocity);
                let mut command = [torque];
                if let Some(transformer) = &mut transformer {
                    transformer.transform(&data, &[torque], &mut command);
                }
                sent.push((command[0], torque));
            }
            if let Some((command, _)) = tick.checked_sub(delay).and_then(|since| sent.get(since / ratio)) {
                active = *command;
            }
            let torque = drive.as_mut().map_or(active, |(law, memory)| law.step(memory, active, q));
            let a = torque / plant.inertia;
            q += ts * (dq + 0.5 * ts * a);
            dq += ts * a;
            if tick > 3 * ticks / 4 {
                largest = largest.max(q.abs());
            }
            if q.abs() > 1e3 {
                return f64::INFINITY;
            }
        }
        largest / 1e-3
    }

    fn grid() -> Vec<(Plant<'static>, AxisFeedback)> {
        let mut grid = Vec::new();
        for (servo_hz, ratio, delay, filter_hz) in [
            (5000.0, 5, 0, 150.0),
            (5000.0, 5, 4, 150.0),
            (2500.0, 5, 2, 150.0),
            (1000.0, 5, 0, 80.0),
            (1000.0, 1, 0, 400.0),
            (5000.0, 5, 20, 150.0),
            // Predicted: three cycles of 4 ms, two of 10 ms.
            (5000.0, 20, 60, 80.0),
            (1000.0, 10, 20, 30.0),
        ] {
            let servos = [8.0, 20.0].map(|hz| {
                let filter_hz = 0.15 * servo_hz;
                [Some(servo(hz, filter_hz)), Some(velocity_servo(hz, filter_hz))]
            });
            for servo in std::iter::once(None).chain(servos.into_iter().flatten()) {
                for zeta in [0.4, 0.7, 1.0, 2.0] {
                    for step in 0..14 {
                        let omega = 10.0 * 1.5_f64.powi(step);
                        let plant = plant(servo_hz, ratio, delay, filter_hz, servo.clone());
                        grid.push((plant, AxisFeedback::of(omega, zeta, 0.0)));
                    }
                }
            }
        }
        grid
    }

    /// Compared: the sign of the margin of the closed form, and the behaviour of the sampled loop. Between −1° and
    /// 10° they may disagree: the formula ignores all dynamics above half the sampling rate.
    #[test]
    fn phase_margin_predicts_loop_stability() {
        // Counts for torque, position and velocity robots.
        let (mut stable, mut unstable) = ([0; 3], [0; 3]);
        for (plant, law) in grid() {
            let margin = plant.margin(&law).expect("a law").degrees;
            let bandwidth = law.bandwidth().min(PI / plant.period_s);
            let left = simulated(&plant, &law, 400.0 / bandwidth + 200.0 * plant.period_s);
            let kind = plant.servo.map_or(0, |servo| 1 + usize::from(servo.takes == CommandKind::Velocity));
            if margin < -1.0 {
                unstable[kind] += 1;
                assert!(left > 1.0, "{margin:.1}° and {left} left: {plant:?} {law:?}");
            } else if margin > 10.0 {
                stable[kind] += 1;
                assert!(left < 1.0, "{margin:.1}° and {left} left: {plant:?} {law:?}");
            }
        }
        let tried = |counts: [usize; 3]| counts.into_iter().all(|count| count > 50);
        assert!(tried(stable) && tried(unstable), "all are tried: {stable:?} and {unstable:?}");
    }

    /// Compared: the margin of a loop without delay, and the textbook formula tan φ = 2ζ w/ω at the crossover w.
    #[test]
    fn phase_margin_without_delay_matches_textbook() {
        for zeta in [0.2, 0.7, 1.0] {
            let law = AxisFeedback::of(30.0, zeta, 0.0);
            let margin = Plant::ideal().margin(&law).expect("a law");
            let w = law.bandwidth();
            let exact = (2.0 * zeta * w / 30.0).atan().to_degrees();
            // Interpolated between two of 600 steps.
            assert!((margin.degrees - exact).abs() < 0.05, "{} against {exact}", margin.degrees);
            assert!((margin.crossover_rad_per_s / w - 1.0).abs() < 1e-3);
        }
    }

    /// Compared: the margins at the proposed frequency and slightly above it, and the required one.
    #[test]
    fn proposed_frequency_has_promised_margin() {
        let plant = plant(1000.0, 5, 0, 80.0, None);
        let law = AxisFeedback::of(200.0, 1.0, 0.0);
        let scale = plant.highest_scale(&law).expect("some frequency");
        let degrees = |scale: f64| plant.margin(&law.scaled(scale)).expect("a law").degrees;
        assert!(degrees(1.0) < LEAST_MARGIN_DEG && degrees(scale) >= GOOD_MARGIN_DEG);
        assert!(degrees(1.02 * scale) < GOOD_MARGIN_DEG);
    }
}
