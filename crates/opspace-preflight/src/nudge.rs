//! Simulated motion of an arm after a short push (nudge), which tells whether it is stable with its transformer.
//!
//! The arm is the nominal one of an experiment, or a variation of it, without gravity, Coulomb friction, limits,
//! quantisation and noise. It starts in the start posture of the task. The nudge starts a motion under −D q̇ and the
//! compensation of the viscous friction, D = −∂τ/∂q̇ being the damping of the task's control law (n × n). For a long delay q̇ is
//! [predicted](Prediction), as in a run. The transformer
//! is that of the experiment; it knows nothing of the variation. Gains that are estimated during a run stay nominal,
//! because so small a motion contains no information.

use nalgebra::{DMatrix, DVector, Vector3};
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_backend::{Backend, CommandKind, Observable, Sample, SignalRecorder};
use opspace_control::{ControlContext, ControlInput, Controller, Measurement, Prediction, Targets};
use opspace_experiment::run::experiment::{Experiment, RunOptions};
use opspace_loop::{ControlLoop, LoopConfig, SafetyParameters};
use opspace_model::{Data, update};
use opspace_sim::{ArmConfig, SimulatedArm, SimulatedParameters};
use opspace_transformer::{FrictionCompensation, Transformer, TransformerName};

/// Duration of the run after a nudge, s: negative damping of 1 % of kv doubles the motion within a few tenths of a
/// second.
const FOLLOWED_S: f64 = 1.6;

/// Speed of the arm after the nudge, rad/s: low, so that quadratic terms in the speeds are negligible.
const NUDGE_RAD_PER_S: f64 = 1e-5;

/// Duration of the nudge, interface cycles.
const NUDGED_TICKS: u32 = 10;

/// Speeds, relative to the speed after the nudge, at which the motion has certainly grown or decayed.
const GROWN: f64 = 30.0;
const GONE: f64 = 1e-4;

/// Acceleration per speed after the nudge, 1/s, below which it is no oscillation.
const STEADY_PER_S: f64 = 0.1;

/// Physics steps per step that the integration of elastic gears needs to be stable: with three, their resonances are
/// right within 1 %.
const ACCURATE_STEPS: f64 = 3.0;

/// Largest number of steps in place of one. Faster vibrations are damped by the simulation: they are not what a nudge looks for.
const MAX_STEPS: f64 = 20.0;

/// Needed number of steps in place of one above which none are added: vibrations so fast are damped with any number that takes
/// little time, and each step of such an arm takes long, too.
const HOPELESS_STEPS: f64 = 200.0;

/// Outcome of a nudge.
pub(super) enum Nudge {
    DiesOut,
    /// The motion grows, and this joint gets the most power from its drive.
    Grows(usize),
}

/// Nominal arm of an experiment, without effects that hide the growth of a motion.
pub(super) struct NudgedArm {
    bare: Experiment,
    nominal: ArmConfig,
    /// Torque per velocity, Nms/rad (n × n).
    law: DMatrix<f64>,
    /// Torque of the push, Nm (n).
    push: DVector<f64>,
    /// Damping of the servos, Nms/rad (n); their stiffness, Nm/rad, if all are without damping.
    kv: Vec<f64>,
}

impl NudgedArm {
    /// Returns the nominal arm of an experiment, with this transformer; `None` if the experiment cannot be run.
    pub(super) fn new(experiment: &Experiment, transformer: &TransformerName) -> Option<Self> {
        let bare = bare(experiment, transformer)?;
        let (robot, profile) = (bare.robot(), bare.profile().1);
        let n = robot.model.n();
        let law = -law_damping(experiment)?;
        let mut data = Data::new(&robot.model);
        update(&robot.model, &mut data, &bare.start().ok()?, &vec![0.0; n]).then_some(())?;
        let acceleration = NUDGE_RAD_PER_S / (f64::from(NUDGED_TICKS) * profile.period_s());
        let push = &data.mass_matrix
            * DVector::from_fn(n, |i, _| acceleration * if i % 2 == 0 { 1.0 } else { -0.7 });
        let gains = bare.servo_gains().ok()?;
        let is_damped = gains.iter().any(|gains| gains.damping > 0.0);
        let kv = gains.iter().map(|gains| if is_damped { gains.damping } else { gains.stiffness }).collect();
        let nominal = bare.arm_config().ok()?;
        Some(Self { bare, nominal, law, push, kv })
    }

    /// Returns the arm with this fraction of the damping of its tasks.
    pub(super) fn with_gains(self, fraction: f64) -> Self {
        Self { law: self.law * fraction, ..self }
    }

    /// Configuration of the nominal arm, of which variations are made.
    pub(super) fn nominal(&self) -> &ArmConfig {
        &self.nominal
    }

    /// Experiment with the nominal arm.
    pub(super) fn experiment(&self) -> &Experiment {
        &self.bare
    }

    /// Simulates a nudge of a variation of the arm; `None` if it cannot be simulated.
    pub(super) fn nudge(&self, varied: &ArmConfig) -> Option<Nudge> {
        let law = self.law.clone();
        self.follow(varied, self.control_loop(law, self.bare.loop_config().ok()?)?)
    }

    /// Simulates a nudge of a variation of the arm whose drives keep their setpoints after it.
    pub(super) fn nudge_drives_alone(&self, varied: &ArmConfig) -> Option<Nudge> {
        let config = self.bare.loop_config().ok()?;
        let takes = self.bare.command_kind();
        let compliance = match takes {
            CommandKind::Velocity => config.servo_gains.iter().map(|gains| 1.0 / gains.damping).collect(),
            _ => config.servo_gains.iter().map(|gains| 1.0 / gains.stiffness).collect(),
        };
        let rest = match takes {
            CommandKind::Velocity => vec![0.0; self.push.len()],
            _ => self.nominal.start.clone(),
        };
        let transformer = Box::new(HeldSetpoints { takes, rest, compliance });
        let n = self.push.len();
        let friction = FrictionCompensation::none(n);
        let alone = LoopConfig { transformer, friction, friction_observer: None, ..config };
        self.follow(varied, self.control_loop(DMatrix::zeros(n, n), alone)?)
    }

    /// Simulates a nudge of a variation of the arm with a control loop.
    fn follow(&self, varied: &ArmConfig, mut control: ControlLoop) -> Option<Nudge> {
        let period_s = self.bare.profile().1.period_s();
        let n = self.push.len();
        let grows = |dq: &DVector<f64>| {
            let fed = |joint: &usize| self.kv[*joint] * dq[*joint] * dq[*joint];
            (0..n).max_by(|a, b| fed(a).total_cmp(&fed(b))).map(Nudge::Grows)
        };
        let mut arm = simulated(varied)?;
        let (mut sample, targets) = (Sample::new(arm.capabilities()), control.targets());
        let quarter = ((FOLLOWED_S / period_s) as u32 / 4).max(2 * NUDGED_TICKS);
        // Highest speeds and accelerations of the second and the last quarter.
        let (mut before, mut after) = (Motion::default(), Motion::default());
        let (mut dq, mut last) = (DVector::zeros(n), DVector::zeros(n));
        for tick in 0..4 * quarter {
            // A fault after such a small nudge means that the motion has grown.
            if arm.read(&mut sample).is_err() || control.step(&sample, &targets).fault.is_some() {
                return grows(&dq);
            }
            std::mem::swap(&mut dq, &mut last);
            dq.copy_from(&control.measurement().dq);
            let speed = dq.amax() / NUDGE_RAD_PER_S;
            if speed > GROWN {
                return grows(&dq);
            }
            last -= &dq;
            let acceleration = last.amax() / (NUDGE_RAD_PER_S * period_s);
            match tick / quarter {
                1 => before.add(speed, acceleration),
                3 => after.add(speed, acceleration),
                _ => {}
            }
            if tick >= 2 * quarter && before.speed < GONE {
                return Some(Nudge::DiesOut);
            }
            if let Some(command) = control.result().command
                && arm.write(command).is_err()
            {
                return grows(&dq);
            }
        }
        if after.has_grown_from(&before) { grows(&dq) } else { Some(Nudge::DiesOut) }
    }

    /// Control loop without rest period and torque ramp.
    fn control_loop(&self, law: DMatrix<f64>, config: LoopConfig) -> Option<ControlLoop> {
        let safety = SafetyParameters {
            torque_ramp_s: NonNegative::default(),
            tare_s: NonNegative::default(),
            ..config.safety
        };
        let context = ControlContext {
            command_delay_s: config.command_delay_s,
            sensors: self.bare.robot().sensors.clone(),
            ..ControlContext::new(&config.model, self.bare.profile().1.period_s())
        };
        let controller = Box::new(NudgedDamping {
            law,
            push: self.push.clone(),
            cycles: 0,
            prediction: Prediction::new(&config.model, &context),
            torque: DVector::zeros(self.push.len()),
        });
        ControlLoop::new(LoopConfig { controller, safety, ..config }).ok()
    }
}

/// Transformer that gives a torque to an arm at rest and does not react to its motion.
struct HeldSetpoints {
    takes: CommandKind,
    /// Setpoints at rest (n).
    rest: Vec<f64>,
    /// Setpoint per torque (n).
    compliance: Vec<f64>,
}

impl Transformer for HeldSetpoints {
    fn takes(&self) -> CommandKind {
        self.takes
    }

    fn transform(&mut self, _data: &Data, torque: &[f64], command: &mut [f64]) {
        for (i, command) in command.iter_mut().enumerate() {
            *command = self.rest[i] + self.compliance[i] * torque[i];
        }
    }
}

/// Highest speed and acceleration of a part of a motion, relative to the speed after the nudge (1; 1/s).
#[derive(Default)]
struct Motion {
    speed: f64,
    acceleration: f64,
}

impl Motion {
    fn add(&mut self, speed: f64, acceleration: f64) {
        self.speed = self.speed.max(speed);
        self.acceleration = self.acceleration.max(acceleration);
    }

    /// True if the motion has grown, or an oscillation in it that is still slower than the rest of it.
    fn has_grown_from(&self, before: &Self) -> bool {
        self.speed > before.speed
            || self.acceleration > before.acceleration && self.acceleration > STEADY_PER_S
    }
}

/// Simulated arm, at a physics rate at which its gears are accurate, if that takes little time.
fn simulated(config: &ArmConfig) -> Option<SimulatedArm> {
    let physics_hz = config.simulated.physics_hz.get();
    let steps = steps_in_place_of_one(config.explicit_gear_hz().unwrap_or(0.0) / physics_hz);
    let mut faster = config.clone();
    faster.simulated.physics_hz = Positive::try_from(steps * physics_hz).ok()?;
    SimulatedArm::new(faster).ok()
}

/// Number of physics steps in place of one, if explicit steps of the gears need this multiple of the physics rate.
fn steps_in_place_of_one(needed: f64) -> f64 {
    let steps = (ACCURATE_STEPS * needed).ceil();
    let is_hopeless = steps.is_nan() || steps > HOPELESS_STEPS;
    if needed <= 1.0 || is_hopeless { 1.0 } else { steps.min(MAX_STEPS) }
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
        controller.start(&ControlInput::new(model, &data, &measurement, &rest, &targets));
        measurement.dq = dq;
        update(model, &mut data, measurement.q.as_slice(), measurement.dq.as_slice()).then_some(())?;
        let mut torque = DVector::zeros(n);
        controller
            .update(&ControlInput::new(model, &data, &measurement, &rest, &targets), torque.as_mut_slice());
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

/// A linear law τ = L q̇ with an additional push in the first cycles.
struct NudgedDamping {
    law: DMatrix<f64>,
    push: DVector<f64>,
    cycles: u32,
    prediction: Option<Prediction>,
    /// Last torque, Nm (n).
    torque: DVector<f64>,
}

impl Controller for NudgedDamping {
    fn command_kind(&self) -> CommandKind {
        CommandKind::Torque
    }

    fn start(&mut self, _input: &ControlInput<'_>) {}

    fn update(&mut self, input: &ControlInput<'_>, command: &mut [f64]) {
        let predicted = self.prediction.as_mut().and_then(|prediction| prediction.of(input, &self.torque));
        self.torque = &self.law * &predicted.as_ref().unwrap_or(input).measurement.dq;
        if self.cycles < NUDGED_TICKS {
            self.torque += &self.push;
        }
        self.cycles += 1;
        command.copy_from_slice(self.torque.as_slice());
    }
}

impl Observable for NudgedDamping {
    fn record(&self, _out: &mut SignalRecorder<'_>) {}
}

/// Returns the experiment on the nominal arm without effects that hide the growth of a motion.
fn bare(experiment: &Experiment, transformer: &TransformerName) -> Option<Experiment> {
    let (mut robot, mut task) = (experiment.robot().clone(), experiment.task().clone());
    let servo_hz = experiment.profile().1.servo_hz.get();
    let current_loop_hz = robot.file.simulated.as_ref().and_then(|s| s.current_loop_hz);
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
         {}",
        sensors.collect::<String>()
    );
    robot.file.simulated = Some(toml::from_str::<SimulatedParameters>(&plant).ok()?);
    robot.file.joint.values_mut().for_each(|joint| {
        joint.friction.coulomb_nm = NonNegative::default();
        joint.friction.static_nm = NonNegative::default();
        joint.setpoint_resolution_rad = None;
        // The motion of a rotor without inertia cannot be integrated.
        if joint.rotor.reflected_inertia() == 0.0 {
            joint.gear_stiffness_nm_per_rad = None;
        }
    });
    let adapts_gains = experiment.traits_of(transformer).needs_current;
    robot.file.profile.values_mut().for_each(|profile| {
        profile.setpoint_limits = None;
        profile.adapt_gains = profile.adapt_gains.filter(|_| adapts_gains);
    });
    robot.model = robot.model.with_gravity(Vector3::zeros());
    task.file.environment.clear();
    let options = RunOptions { transformer: Some(transformer.clone()), ..experiment.options().clone() };
    experiment.with_parts(robot, task, options).ok()
}

#[cfg(test)]
mod tests {
    use super::steps_in_place_of_one;

    /// Compared: the number of steps and its bounds. Gears that are too stiff by orders of magnitude are not simulated with more steps.
    #[test]
    fn number_of_steps_is_bounded() {
        for (needed, steps) in [
            (0.0, 1.0),
            (1.0, 1.0),
            (2.0, 6.0),
            (6.5, 20.0),
            (60.0, 20.0),
            (70.0, 1.0),
            (1e6, 1.0),
            (f64::NAN, 1.0),
        ] {
            assert_eq!(steps_in_place_of_one(needed), steps, "{needed}");
        }
    }
}
