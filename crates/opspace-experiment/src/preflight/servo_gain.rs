//! Gain margin of position or velocity loops: the largest excess over the nominal gains at which a run stays bounded.
//!
//! A transformer cancels the stiffness and damping of the servo. If the gain of a position loop is (1 + ε) kp instead
//! of kp, the transformer cancels too little position feedback, and a torque ε kv q̇ remains in the direction of
//! motion. Together with all other damping of the joints, a run stays bounded as long as
//!
//! ```text
//! (1 + ε) Kv Kp t̄ + B − B̂ + D − ε Kv  is positive definite
//! t̄ = (d + (R−1)/2) Ts, or 0 if held setpoints are emulated
//! ```
//!
//! where Kv and Kp are the nominal gains, B is the viscous friction, B̂ its compensated part and D = −∂τ/∂q̇ the
//! damping of the task's control law (n × n; the other matrices are diagonal). For one joint this is
//!
//! ```text
//! 1 + ε < 1 + (1 + ε) kp t̄ + (b − b̂ + d)/kv
//! ```
//!
//! A velocity robot has no position loop. A velocity loop with a gain of (1 + ε) kv produces (1 + ε) times the
//! desired torque. A friction compensation can then exceed the friction and drive the joint; a run stays bounded as
//! long as
//!
//! ```text
//! B + (1 + ε) (D − B̂)  is positive definite
//! ```
//!
//! The reported bound is not computed from these formulas but by simulation, with the backend and the transformer of
//! the experiment. The simulated arm starts in the start posture of the task, without gravity, Coulomb friction,
//! limits and noise. A short push (nudge) starts a motion under −D q̇ and the compensation of B, with the same ε for
//! all joints; the bound on ε between decay and growth is found by bisection. The result therefore includes the
//! effect of a disturbance observer on the motor current.
//!
//! Coulomb friction is not included: it only brakes as long as the compensation does not exceed it. However, the
//! slope of a compensation at rest, Fc/v₀, is a negative damping while the joint moves only in presliding.

use super::case::input;
use super::diagnostic::{Diagnostic, short};
use crate::run::experiment::Experiment;
use nalgebra::{DMatrix, DVector, Vector3};
use opspace_backend::quantity::NonNegative;
use opspace_backend::{Backend, CommandKind, Measured, Observable, Sample, SignalRecorder};
use opspace_control::{ControlInput, Controller, Measurement, Targets};
use opspace_loop::{ControlLoop, LoopConfig, SafetyParameters};
use opspace_model::{Data, update};
use opspace_sim::SimulatedParameters;
use opspace_transformer::FrictionCompensation;
use std::fmt;

/// Excess below which the margin is reported: a slightly stiffer gear or a rounded gain would make the run unstable.
const LEAST_EXCESS: f64 = 0.05;

/// Largest excess that is examined: 2, that is, three times the nominal gains.
const MOST_EXCESS: f64 = 2.0;

/// Resolution of the bound.
const RESOLUTION: f64 = 1e-3;

/// Duration of the run after a nudge, s: negative damping of 1 % of kv doubles the motion within a few tenths of a
/// second.
const FOLLOWED_S: f64 = 4.0;

/// Speed of the arm after the nudge, rad/s: low, so that quadratic terms in the speeds are negligible.
const NUDGE_RAD_PER_S: f64 = 1e-3;

/// Duration of the nudge, interface cycles.
const NUDGED_TICKS: u32 = 10;

/// Speeds, relative to the speed after the nudge, at which the motion has certainly grown or decayed.
const GROWN: f64 = 30.0;
const GONE: f64 = 1e-4;

/// Servo loops for which a gain margin is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ServoLoop {
    /// The position loops of a position robot.
    Position,
    /// The velocity loops of a velocity robot.
    Velocity,
}

impl ServoLoop {
    /// Loops of a robot with the given command interface; `None` for torques.
    fn of(command: CommandKind) -> Option<Self> {
        match command {
            CommandKind::Position => Some(Self::Position),
            CommandKind::Velocity => Some(Self::Velocity),
            CommandKind::Torque => None,
        }
    }

    /// Name of the loops in messages.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Position => "position loops",
            Self::Velocity => "velocity loops",
        }
    }
}

/// Largest excess of the position or velocity loop gains over their nominal values at which a task is stable.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct GainMargin {
    /// Loops to which the margin applies.
    pub servo_loop: ServoLoop,
    /// Largest relative increase of all these gains together, 0.05 = 5 %; `None` above three times the nominal gains.
    pub excess: Option<f64>,
    /// Joint that becomes unstable first, if any.
    pub joint: Option<String>,
    /// Name of the transformer.
    pub transformer: String,
}

/// Computes the gain margin in the initial tasks of an experiment: of the position loops of a position robot, or of
/// the velocity loops of a velocity robot. `None` if commands pass without a transformer.
#[must_use]
pub fn gain_margin(experiment: &Experiment) -> Option<GainMargin> {
    let servo_loop = ServoLoop::of(experiment.command_kind())?;
    let transformer = experiment.transformer_kind()?.name().to_owned();
    let damping = law_damping(experiment)?;
    let (mut low, mut high) = (0.0, MOST_EXCESS);
    let Nudge::Grows(mut first) = nudge(experiment, &damping, high)? else {
        return Some(GainMargin { servo_loop, excess: None, joint: None, transformer });
    };
    while high - low > RESOLUTION {
        // Most margins are small, so the first intervals are divided near their lower end.
        let share = if high > 4.0 * LEAST_EXCESS { 0.25 } else { 0.5 };
        let middle = low + share * (high - low);
        match nudge(experiment, &damping, middle)? {
            Nudge::DiesOut => low = middle,
            Nudge::Grows(joint) => (high, first) = (middle, joint),
        }
    }
    let joint = Some(experiment.robot().model.joints()[first].name.clone());
    Some(GainMargin { servo_loop, excess: Some(low), joint, transformer })
}

impl fmt::Display for GainMargin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let loops = self.servo_loop.name();
        match (self.excess, &self.joint) {
            (Some(excess), Some(joint)) => {
                write!(
                    f,
                    "{loops} tolerate up to {:.1} % more gain than nominal (joint '{joint}' becomes unstable first)",
                    100.0 * excess
                )?;
            }
            _ => write!(f, "{loops} tolerate at least {} times the nominal gain", 1.0 + MOST_EXCESS)?,
        }
        write!(f, ", with transformer '{}'", self.transformer)
    }
}

impl GainMargin {
    /// Returns a diagnostic if the margin is too small.
    #[must_use]
    pub fn finding(&self, experiment: &Experiment) -> Option<Diagnostic> {
        let excess = self.excess.filter(|excess| *excess < LEAST_EXCESS)?;
        let joint = self.joint.as_ref()?;
        let message = format!(
            "{} tolerate only {:.1} % more gain than nominal, with transformer '{}': beyond that the run is unstable, \
             joint '{joint}' first",
            self.servo_loop.name(),
            100.0 * excess,
            self.transformer,
        );
        let (profile, robot) = (experiment.profile().0, experiment.robot());
        let relief = match self.servo_loop {
            ServoLoop::Position => {
                let kv = experiment.servo_gains().ok()?[robot.model.joint(joint).ok()?].damping;
                format!(
                    "increase the damping of joint '{joint}' by {} Nms/rad",
                    short((LEAST_EXCESS - excess) * kv)
                )
            }
            ServoLoop::Velocity => {
                format!("compensate less of the friction of joint '{joint}' or add damping to it")
            }
        };
        let measured = robot.file.interface.measured.contains(&Measured::MotorCurrent);
        let name = if self.transformer.starts_with("paper") { "emulation" } else { &self.transformer };
        let current = match self.transformer.ends_with("+current") || !measured {
            true => String::new(),
            false => {
                format!("use '{name}+current', which corrects wrong gains by measured motor current, or ")
            }
        };
        let help = format!(
            "{current}{relief}, or raise the nominal gains: overestimated gains only make the response slower",
        );
        Some(Diagnostic::new(&["profile", profile, "transformer"], message, help).of_robot())
    }
}

/// Damping of the tasks' control law at the start, D = −∂τ/∂q̇, Nms/rad (n × n).
fn law_damping(experiment: &Experiment) -> Option<DMatrix<f64>> {
    const SPEED: f64 = 1e-3;
    let model = &experiment.robot().model;
    let n = model.n();
    let mut measurement = Measurement::new(n, experiment.robot().sensors.len(), false);
    measurement.q.copy_from_slice(&experiment.start().ok()?);
    let (mut data, rest, targets) = (Data::new(model), vec![0.0; n], Targets::none());
    let mut torque = |dq: DVector<f64>| {
        let mut controller = experiment.unlimited_controller(experiment.profile().1.period_s())?;
        update(model, &mut data, measurement.q.as_slice(), &rest).then_some(())?;
        measurement.dq.fill(0.0);
        controller.start(&input(model, &data, &measurement, &rest, &targets));
        measurement.dq = dq;
        update(model, &mut data, measurement.q.as_slice(), measurement.dq.as_slice()).then_some(())?;
        let mut torque = DVector::zeros(n);
        controller.update(&input(model, &data, &measurement, &rest, &targets), torque.as_mut_slice());
        Some(torque)
    };
    let mut damping = DMatrix::zeros(n, n);
    for joint in 0..n {
        let at = |speed: f64| DVector::from_fn(n, |i, _| if i == joint { speed } else { 0.0 });
        // Terms that are quadratic in the speed cancel.
        let slope = (torque(at(-SPEED))? - torque(at(SPEED))?) / (2.0 * SPEED);
        damping.set_column(joint, &slope);
    }
    Some(damping)
}

/// Outcome of a nudge.
enum Nudge {
    DiesOut,
    /// The motion grows; the excess gain supplies the most power to this joint.
    Grows(usize),
}

/// Simulates a nudge with ε = `excess`; `None` if the experiment cannot be run.
fn nudge(experiment: &Experiment, damping: &DMatrix<f64>, excess: f64) -> Option<Nudge> {
    let bare = bare(experiment, 1.0 + excess)?;
    let (robot, profile) = (bare.robot(), bare.profile().1);
    let (model, n) = (&robot.model, robot.model.n());
    let gain = bare.task().file.friction_compensation.gain.get();
    let compensated = robot.joints().iter().map(|j| gain * j.friction.viscous_nms_per_rad.get()).collect();
    let law = DMatrix::from_diagonal(&DVector::from_vec(compensated)) - damping;
    let kv: Vec<f64> = bare.servo_gains().ok()?.iter().map(|gains| gains.damping).collect();
    let grows = |dq: &DVector<f64>| {
        let fed = |joint: &usize| kv[*joint] * dq[*joint] * dq[*joint];
        (0..n).max_by(|a, b| fed(a).total_cmp(&fed(b))).map(Nudge::Grows)
    };

    let mut data = Data::new(model);
    update(model, &mut data, &bare.start().ok()?, &vec![0.0; n]).then_some(())?;
    let acceleration = NUDGE_RAD_PER_S / (f64::from(NUDGED_TICKS) * profile.period_s());
    let push =
        &data.mass_matrix * DVector::from_fn(n, |i, _| acceleration * if i % 2 == 0 { 1.0 } else { -0.7 });

    let mut arm = bare.simulated_arm().ok()?;
    let mut control = nudged_loop(&bare, law, push)?;
    let (mut sample, targets) = (Sample::new(arm.capabilities()), control.targets());
    let quarter = (FOLLOWED_S / profile.period_s()) as u32 / 4;
    // Highest speeds of the second and the last quarter.
    let (mut before, mut after, mut dq) = (0.0_f64, 0.0_f64, DVector::zeros(n));
    for tick in 0..4 * quarter {
        // A fault after such a small nudge means that the motion has grown.
        if arm.read(&mut sample).is_err() || control.step(&sample, &targets).fault.is_some() {
            return grows(&dq);
        }
        dq.copy_from(&control.measurement().dq);
        let speed = dq.amax() / NUDGE_RAD_PER_S;
        match tick / quarter {
            _ if speed > GROWN => return grows(&dq),
            1 => before = before.max(speed),
            3 => after = after.max(speed),
            _ => {}
        }
        if tick >= 2 * quarter && before < GONE {
            return Some(Nudge::DiesOut);
        }
        if let Some(command) = control.result().command
            && arm.write(command).is_err()
        {
            return grows(&dq);
        }
    }
    if after > before { grows(&dq) } else { Some(Nudge::DiesOut) }
}

/// Control loop of a nudged arm, without rest period, torque ramp, and friction compensation besides that in the law.
fn nudged_loop(bare: &Experiment, law: DMatrix<f64>, push: DVector<f64>) -> Option<ControlLoop> {
    let config = bare.loop_config().ok()?;
    let n = config.model.n();
    let safety = SafetyParameters {
        torque_ramp_s: NonNegative::default(),
        tare_s: NonNegative::default(),
        ..config.safety
    };
    let controller = Box::new(NudgedDamping { law, push, cycles: 0 });
    let friction = FrictionCompensation::none(n);
    ControlLoop::new(LoopConfig { controller, safety, friction, ..config }).ok()
}

/// A linear law τ = L q̇ with an additional push in the first cycles.
struct NudgedDamping {
    law: DMatrix<f64>,
    push: DVector<f64>,
    cycles: u32,
}

impl Controller for NudgedDamping {
    fn command_kind(&self) -> CommandKind {
        CommandKind::Torque
    }

    fn start(&mut self, _input: &ControlInput<'_>) {}

    fn update(&mut self, input: &ControlInput<'_>, command: &mut [f64]) {
        let mut torque = &self.law * &input.measurement.dq;
        if self.cycles < NUDGED_TICKS {
            torque += &self.push;
        }
        self.cycles += 1;
        command.copy_from_slice(torque.as_slice());
    }
}

impl Observable for NudgedDamping {
    fn record(&self, _out: &mut SignalRecorder<'_>) {}
}

/// Returns the experiment on the nominal arm with the gains of its position or velocity loops multiplied by `gain`,
/// and without effects that hide the growth of a motion.
fn bare(experiment: &Experiment, gain: f64) -> Option<Experiment> {
    let (mut robot, mut task) = (experiment.robot().clone(), experiment.task().clone());
    let servo_hz = experiment.profile().1.servo_hz.get();
    let current_loop_hz = robot.file.simulated.as_ref().and_then(|s| s.current_loop_hz);
    let scaled = if experiment.command_kind() == CommandKind::Velocity { "kv" } else { "kp" };
    let lag = current_loop_hz.map_or_else(String::new, |hz| format!("current_loop_hz = {:?}\n", hz.get()));
    let sensors = robot.file.force_sensor.keys().map(|name| {
        format!(
            "[force_sensor.{name:?}]\nbandwidth_hz = 1e4\nnoise_n = 0.0\nnoise_nm = 0.0\nbias_n = 0.0\nbias_nm = 0.0\n"
        )
    });
    let plant = format!(
        "physics_hz = {servo_hz:?}\n{lag}encoder_quantisation = false\ntorque_saturation = false\n\
         bristle = {{ stiffness_nm_per_rad = 1.0, damping_nms_per_rad = 0.0, damping_fade_velocity_rad_per_s = 1.0 }}\n\
         end_stop = {{ stiffness_nm_per_rad = 1.0, damping_nms_per_rad = 0.0 }}\n\
         brake = {{ holding_torque_ratio = 1.0, stiffness_nm_per_rad = 1.0, damping_nms_per_rad = 0.0 }}\n\
         true_over_nominal = {{ {scaled} = {gain:?} }}\n{}",
        sensors.collect::<String>()
    );
    robot.file.simulated = Some(toml::from_str::<SimulatedParameters>(&plant).ok()?);
    robot.file.joint.values_mut().for_each(|joint| {
        joint.friction.coulomb_nm = NonNegative::default();
        joint.friction.static_nm = NonNegative::default();
        joint.gear_stiffness_nm_per_rad = None;
    });
    robot.file.profile.values_mut().for_each(|profile| profile.setpoint_limits = None);
    robot.model = robot.model.with_gravity(Vector3::zeros());
    task.file.environment.clear();
    Experiment::new(robot, task, experiment.options().clone(), Vec::new()).ok()
}
