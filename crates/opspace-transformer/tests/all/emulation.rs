//! Emulating transformer against drives simulated here independently, servo tick by servo tick: each servo is written
//! as a recursion and doesn't use the emulation.
#![expect(clippy::unwrap_used, reason = "a test")]

use nalgebra::{DVector, Matrix3, Vector3};
use opspace_backend::{Capabilities, CommandKind, GravityCompensation, Measured, Sample, Setpoints};
use opspace_model::{Data, Inertia, Joint, JointKind, Limits, Model, Placement, update};
use opspace_transformer::{
    EmulatingTransformer, EmulationError, EmulationSetup, FrictionCompensation,
    FrictionCompensationParameters, FrictionParameters, RemainingDamping, ServoParameters, TorqueObjective,
    Transformer,
};
use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::ops::Range;

pub(super) const SERVO_S: f64 = 1e-3;
pub(super) const RATIO: u32 = 5;
pub(super) const KP: [f64; 2] = [25.0, 20.0];
pub(super) const KV: [f64; 2] = [40.0, 8.0];
const FILTER_HZ: f64 = 200.0;

/// Delays of setpoints, servo ticks: all up to a whole interval, and some of several intervals.
pub(super) const DELAYS: [u32; 9] = [0, 1, 2, 3, 4, RATIO, RATIO + 2, 2 * RATIO, 3 * RATIO + 1];

/// Rounding error of an observer without an initial error: relative for torques, in m/s for velocities.
const EXACT: f64 = 1e-6;

/// Gravity along the lifts when they carry a load, m/s², and the forces that hold the lifts against it, N.
const GRAVITY: f64 = 9.81;
const LOAD: [f64; 2] = [0.5 * GRAVITY, 0.2 * GRAVITY];

/// Two prismatic joints in series along the same line: M is constant and couples them.
pub(super) fn model(loaded: bool) -> Model {
    let gravity = Vector3::z() * if loaded { -GRAVITY } else { 0.0 };
    let mut model = Model::new("lifts").with_gravity(gravity);
    for (i, mass) in [0.3, 0.2].into_iter().enumerate() {
        let joint = Joint { name: format!("lift_{i}"), kind: JointKind::Prismatic, limits: Limits::NONE };
        let inertia =
            Inertia { mass, com: Vector3::zeros(), rotational: Matrix3::from_diagonal_element(1e-3) };
        model.add_body(i.checked_sub(1), Placement::identity(), joint, inertia);
    }
    model
}

/// Structure of the drives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Servo {
    Cascade,
    /// With an integral of the velocity error.
    CascadeIntegral,
    Pid,
    /// Lead compensator with a delay of one servo tick.
    Late,
    /// A velocity loop alone.
    Velocity,
    /// With an integral of the velocity error.
    VelocityIntegral,
}

const INTEGRAL_TIME_S: f64 = 0.1;
pub(super) const POSITION_SERVOS: [Servo; 4] =
    [Servo::Cascade, Servo::CascadeIntegral, Servo::Pid, Servo::Late];
pub(super) const VELOCITY_SERVOS: [Servo; 2] = [Servo::Velocity, Servo::VelocityIntegral];

impl Servo {
    pub(super) fn takes(self) -> CommandKind {
        if VELOCITY_SERVOS.contains(&self) { CommandKind::Velocity } else { CommandKind::Position }
    }

    pub(super) fn parameters(self) -> Vec<ServoParameters> {
        let text = |i: usize| {
            let (kp, kv) = (KP[i], KV[i]);
            match self {
                Self::Cascade => format!(
                    "cascaded = {{ kp_per_s = {kp}, kv_nms_per_rad = {kv}, velocity_filter_hz = {FILTER_HZ} }}"
                ),
                Self::CascadeIntegral => format!(
                    "cascaded = {{ kp_per_s = {kp}, kv_nms_per_rad = {kv}, velocity_filter_hz = {FILTER_HZ}, \
                     velocity_integral_time_s = {INTEGRAL_TIME_S} }}"
                ),
                Self::Pid => format!(
                    "pid = {{ stiffness_nm_per_rad = {}, damping_nms_per_rad = {kv}, derivative_filter_hz = \
                     {FILTER_HZ}, integral_nm_per_rad_s = {} }}",
                    kp * kv,
                    kp * kv / INTEGRAL_TIME_S
                ),
                Self::Late => format!(
                    "transfer-function = {{ numerator = [0.0, {}, {}], denominator = [1.0, -0.5] }}",
                    10.0 * kv,
                    -7.0 * kv
                ),
                Self::Velocity => {
                    format!("velocity = {{ kv_nms_per_rad = {kv}, velocity_filter_hz = {FILTER_HZ} }}")
                }
                Self::VelocityIntegral => format!(
                    "velocity = {{ kv_nms_per_rad = {kv}, ki_nm_per_rad = {}, velocity_filter_hz = {FILTER_HZ} }}",
                    kv / INTEGRAL_TIME_S
                ),
            }
        };
        (0..2).map(|i| toml::from_str(&text(i)).unwrap()).collect()
    }
}

/// Drives of a robot, and the options of a test case.
#[derive(Clone, Copy, Debug)]
pub(super) struct Case {
    pub(super) servo: Servo,
    pub(super) setpoints: Setpoints,
    pub(super) delay: u32,
    pub(super) current: bool,
    /// Ratio of true to nominal gain: of the position loop, or of a velocity servo.
    pub(super) gain_scale: f64,
    pub(super) refined: bool,
    pub(super) loaded: bool,
    pub(super) has_brakes: bool,
}

pub(super) const CASE: Case = Case {
    servo: Servo::Cascade,
    setpoints: Setpoints::Held,
    delay: 0,
    current: false,
    gain_scale: 1.0,
    refined: false,
    loaded: false,
    has_brakes: false,
};

fn setup(case: Case) -> EmulationSetup {
    let none: FrictionParameters = toml::from_str(
        "coulomb_nm = 0.0\nstatic_nm = 0.0\nstribeck_rad_per_s = 0.1\nviscous_nms_per_rad = 0.0",
    )
    .unwrap();
    let friction = [none.clone(), none];
    EmulationSetup {
        servos: case.servo.parameters(),
        friction: FrictionCompensation::new(friction.iter(), &FrictionCompensationParameters::default()),
        resolution_rad: vec![1e-9; 2],
        // Inertia of each joint while the other is free.
        inertias: vec![0.3, 0.12],
        torque_limits: vec![10.0; 2],
        remaining_damping: vec![RemainingDamping::default(); 2],
        servo_period_s: SERVO_S,
        servo_ticks_per_cycle: RATIO,
        delay: case.delay,
        setpoints: case.setpoints,
        matching: if case.setpoints == Setpoints::Held {
            TorqueObjective::IntervalMean
        } else {
            TorqueObjective::PerTick
        },
        gravity_compensated_by: GravityCompensation::Controller,
        has_brakes: case.has_brakes,
        current: case.current,
        adapt_gains: case.refined.then(|| toml::from_str("time_s = 1.0\nmax_relative_change = 0.4").unwrap()),
    }
}

/// Two masses and their drives, simulated by servo periods.
pub(super) struct Drives {
    case: Case,
    pub(super) q: [f64; 2],
    dq: [f64; 2],
    seen: [f64; 2],
    velocity: [f64; 2],
    integral: [f64; 2],
    error: [f64; 2],
    last: [f64; 2],
}

impl Drives {
    pub(super) fn new(case: Case) -> Self {
        let q = [0.1, -0.2];
        let none = [0.0; 2];
        // Without brakes the integral holds the load.
        let integral = if case.loaded && !case.has_brakes { LOAD } else { none };
        Self { case, q, dq: none, seen: q, velocity: none, integral, error: none, last: none }
    }

    pub(super) fn torque(&mut self, i: usize, setpoint: f64) -> f64 {
        let share = 1.0 - (-TAU * FILTER_HZ * SERVO_S).exp();
        self.velocity[i] += share * ((self.q[i] - self.seen[i]) / SERVO_S - self.velocity[i]);
        self.seen[i] = self.q[i];
        let scale = self.case.gain_scale;
        let (kp, kv) = match self.case.servo.takes() {
            CommandKind::Velocity => (0.0, scale * KV[i]),
            _ => (scale * KP[i], KV[i]),
        };
        let error = setpoint - self.q[i];
        let torque = match self.case.servo {
            Servo::Cascade => kv * (kp * error - self.velocity[i]),
            Servo::CascadeIntegral => {
                let wrong = kp * error - self.velocity[i];
                self.integral[i] += wrong * SERVO_S / INTEGRAL_TIME_S;
                kv * (wrong + self.integral[i])
            }
            Servo::Pid => {
                self.integral[i] += kp * kv / INTEGRAL_TIME_S * SERVO_S * error;
                kp * kv * error - kv * self.velocity[i] + self.integral[i]
            }
            Servo::Late => {
                // `integral` is the error of two ticks ago.
                let torque = 10.0 * kv * self.error[i] - 7.0 * kv * self.integral[i] + 0.5 * self.last[i];
                self.integral[i] = self.error[i];
                torque
            }
            Servo::Velocity => kv * (setpoint - self.velocity[i]),
            Servo::VelocityIntegral => {
                let wrong = setpoint - self.velocity[i];
                self.integral[i] += kv / INTEGRAL_TIME_S * SERVO_S * wrong;
                kv * wrong + self.integral[i]
            }
        };
        self.error[i] = error;
        self.last[i] = torque;
        torque
    }

    fn tick(&mut self, setpoint: &[f64; 2]) -> [f64; 2] {
        let torque = [0, 1].map(|i| self.torque(i, setpoint[i]));
        // M = [0.5 0.2; 0.2 0.2].
        let det = 0.5 * 0.2 - 0.2 * 0.2;
        let load = if self.case.loaded { LOAD } else { [0.0; 2] };
        let net = [torque[0] - load[0], torque[1] - load[1]];
        let ddq = [(0.2 * net[0] - 0.2 * net[1]) / det, (0.5 * net[1] - 0.2 * net[0]) / det];
        for ((q, dq), ddq) in self.q.iter_mut().zip(&mut self.dq).zip(ddq) {
            *q += SERVO_S * (*dq + 0.5 * SERVO_S * ddq);
            *dq += SERVO_S * ddq;
        }
        torque
    }
}

/// Result of a run.
struct Run {
    /// Desired torques, and the actual torques while each setpoint acts: their mean, and those of each servo tick.
    asked: Vec<[f64; 2]>,
    means: Vec<[f64; 2]>,
    torques: Vec<[f64; 2]>,
    /// Largest error of the transformer's velocity estimates, m/s.
    off: f64,
}

pub(super) fn sample(takes: CommandKind, current: bool) -> Sample {
    let capabilities = Capabilities::new(["first", "second"], takes, SERVO_S);
    Sample::new(&if current { capabilities.measuring(&[Measured::MotorCurrent]) } else { capabilities })
}

/// Runs a case; no setpoint is sent in the cycles `missed`.
fn run(case: Case, missed: Range<u32>) -> Run {
    let matching = if case.setpoints == Setpoints::Held {
        TorqueObjective::IntervalMean
    } else {
        TorqueObjective::PerTick
    };
    run_matching(case, matching, missed)
}

fn run_matching(case: Case, matching: TorqueObjective, missed: Range<u32>) -> Run {
    let model = model(case.loaded);
    let mut data = Data::new(&model);
    let mut transformer = EmulatingTransformer::new(&EmulationSetup { matching, ..setup(case) }).unwrap();
    let takes = case.servo.takes();
    assert_eq!(transformer.takes(), takes);
    let mut drives = Drives::new(case);
    let mut sample = sample(takes, case.current);
    // At rest without a load the setpoint is the joint's position, or zero velocity.
    let rest = if takes == CommandKind::Velocity { [0.0; 2] } else { drives.q };
    let (mut from, mut to, mut new) = (rest, rest, DVector::from_column_slice(&rest));
    let mut ramp = RATIO;
    let mut waiting = VecDeque::new();
    let (mut asked, mut torques, mut off) = (Vec::new(), Vec::new(), 0.0_f64);
    for k in 0..400_u32 {
        sample.q.copy_from_slice(&drives.q);
        let dq = transformer.observe(&sample).unwrap();
        off = off.max((dq[0] - drives.dq[0]).abs()).max((dq[1] - drives.dq[1]).abs());
        assert!(update(&model, &mut data, &sample.q, dq));
        let t = f64::from(k * RATIO) * SERVO_S;
        let load = if case.loaded { LOAD } else { [0.0; 2] };
        let tau = [load[0] + (TAU * 0.7 * t).sin(), load[1] + 0.4 * (TAU * 1.1 * t).sin()];
        let sent = !missed.contains(&k);
        if sent {
            transformer.transform(&data, &tau, new.as_mut_slice());
            transformer.sent(&data, new.as_slice());
            waiting.push_back((k * RATIO + case.delay, [new[0], new[1]]));
        }
        asked.push(tau);
        let mut mean = DVector::zeros(2);
        for tick in k * RATIO..(k + 1) * RATIO {
            if let Some((_, acting)) = waiting.pop_front_if(|(acts_at, _)| *acts_at == tick) {
                (from, to, ramp) = (to, acting, 0);
            }
            if case.has_brakes && tick < case.delay {
                torques.push([0.0; 2]);
                continue;
            }
            ramp = (ramp + 1).min(RATIO);
            let share = match case.setpoints {
                Setpoints::Held => 1.0,
                Setpoints::Interpolated => f64::from(ramp) / f64::from(RATIO),
            };
            let torque = drives.tick(&[0, 1].map(|i| from[i] + share * (to[i] - from[i])));
            torques.push(torque);
            mean += DVector::from_column_slice(&torque) / f64::from(RATIO);
        }
        if let Some(measured) = &mut sample.motor_torque {
            measured.copy_from_slice(mean.as_slice());
        }
    }
    let torques = torques.split_off(case.delay as usize);
    let windows = torques.chunks_exact(RATIO as usize);
    let means = windows.map(|w| [0, 1].map(|i| w.iter().map(|t| t[i]).sum::<f64>() / f64::from(RATIO)));
    Run { asked, means: means.collect(), torques, off }
}

impl Run {
    /// Rms of actual minus desired mean torques, relative to the rms of the desired ones, after half a second.
    fn error(&self) -> f64 {
        relative(self.asked.iter().zip(&self.means).skip(100))
    }

    /// Relative error of the mean torques from the first interval on.
    fn error_from_the_start(&self) -> f64 {
        relative(self.asked.iter().zip(&self.means))
    }

    /// Relative error of the torques of every servo tick.
    fn error_at_ticks(&self) -> f64 {
        let each = self.asked.iter().flat_map(|asked| std::iter::repeat_n(asked, RATIO as usize));
        relative(each.zip(&self.torques).skip(100 * RATIO as usize))
    }
}

fn relative<'a>(pairs: impl Iterator<Item = (&'a [f64; 2], &'a [f64; 2])>) -> f64 {
    let (mut off, mut size) = (0.0, 0.0);
    for (asked, actual) in pairs {
        off += asked.iter().zip(actual).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
        size += asked.iter().map(|a| a * a).sum::<f64>();
    }
    (off / size).sqrt()
}

/// Compared: mean torques of servos with nominal gains and the desired ones, for delays up to several intervals;
/// and estimated velocity, from position readings 5 ms apart, and the true one.
#[test]
fn mean_torques_equal_desired_torques() {
    for servo in POSITION_SERVOS.into_iter().chain(VELOCITY_SERVOS) {
        for delay in DELAYS {
            for current in [false, true] {
                let case = Case { servo, delay, current, ..CASE };
                let run = run(case, 0..0);
                let error = run.error();
                assert!(error < EXACT, "{case:?}: {error}");
                assert!(run.off < EXACT, "{case:?}: {} m/s", run.off);
            }
        }
    }
}

/// Compared: mean torques and velocities of velocity servos under a load, from the first interval on, and the desired
/// and true ones. Until the first setpoint acts, brakes or the servos' integrals hold the load.
#[test]
fn velocity_robot_starts_from_brakes_or_integral() {
    for (servo, has_brakes) in
        [(Servo::Velocity, true), (Servo::VelocityIntegral, true), (Servo::VelocityIntegral, false)]
    {
        for setpoints in [Setpoints::Held, Setpoints::Interpolated] {
            for delay in DELAYS {
                for current in [false, true] {
                    let case = Case { servo, has_brakes, setpoints, delay, current, loaded: true, ..CASE };
                    let run = run_matching(case, TorqueObjective::IntervalMean, 0..0);
                    let error = run.error_from_the_start();
                    assert!(error < EXACT, "{case:?}: {error}");
                    assert!(run.off < EXACT, "{case:?}: {} m/s", run.off);
                }
            }
        }
    }
}

/// Compared: torques of interpolating drives at every servo tick, and the desired ones. An error remains because
/// linearly interpolated setpoints cannot give a constant torque. Held setpoints are run for comparison.
#[test]
fn interpolated_setpoints_give_torque_throughout_interval() {
    for servo in [Servo::Cascade, Servo::CascadeIntegral, Servo::Pid].into_iter().chain(VELOCITY_SERVOS) {
        for delay in DELAYS {
            for current in [false, true] {
                let case = Case { servo, delay, current, setpoints: Setpoints::Interpolated, ..CASE };
                let (straight, held) =
                    (run(case, 0..0), run(Case { setpoints: Setpoints::Held, ..case }, 0..0));
                let (error, of_held) = (straight.error_at_ticks(), held.error_at_ticks());
                assert!(error < 0.02 && error < 0.1 * of_held, "{case:?}: {error}, {of_held} held");
                assert!(straight.off < EXACT, "{case:?}: {} m/s", straight.off);
            }
        }
    }
}

/// Compared: estimated and true velocities while setpoints are missed and the drives hold the last one.
#[test]
fn estimate_continues_through_missed_setpoints() {
    for servo in [Servo::Cascade].into_iter().chain(VELOCITY_SERVOS) {
        for setpoints in [Setpoints::Held, Setpoints::Interpolated] {
            for delay in [0, 2, RATIO, RATIO + 1, 3 * RATIO] {
                let run = run(Case { servo, delay, setpoints, ..CASE }, 200..230);
                assert!(run.off < EXACT, "{servo:?}, delay {delay}: {} m/s", run.off);
            }
        }
    }
}

/// Compared: torque errors of a position loop that is stiffer or softer than the nominal one, with and without
/// correction by motor current.
#[test]
fn motor_current_compensates_wrong_gain() {
    for gain_scale in [0.8, 1.1] {
        let [without, with] =
            [false, true].map(|current| run(Case { gain_scale, current, ..CASE }, 0..0).error());
        assert!(with < 0.5 * without && without > 0.1, "{gain_scale}: {with} with, {without} without");
    }
}

/// Compared: torque errors of a velocity loop whose gain is not the nominal one, with and without correction by motor
/// current.
#[test]
fn motor_current_compensates_wrong_velocity_gain() {
    for servo in VELOCITY_SERVOS {
        for gain_scale in [0.8, 1.3] {
            let [without, with] =
                [false, true].map(|current| run(Case { servo, gain_scale, current, ..CASE }, 0..0).error());
            assert!(
                with < 0.5 * without && without > 0.1,
                "{servo:?}, {gain_scale}: {with}, {without} without"
            );
        }
    }
}

/// Compared: the error with gains adapted during the run, after the transient, and the error with current correction
/// only.
#[test]
fn gain_adaptation_improves_on_current_feedback() {
    for gain_scale in [0.7, 1.3] {
        let [alone, refined] = [false, true]
            .map(|refined| run(Case { gain_scale, refined, current: true, ..CASE }, 0..0).error());
        assert!(refined < 0.1 * alone, "{gain_scale}: {refined} refined, {alone} without");
    }
}

/// Checks the errors for servos with an unstable inverse, or without torque before the next setpoint.
#[test]
fn non_invertible_servo_is_refused() {
    let refused = |numerator: &str| {
        let text = format!("transfer-function = {{ numerator = {numerator}, denominator = [1.0, -0.5] }}");
        let servos = vec![toml::from_str(&text).unwrap(); 2];
        EmulatingTransformer::new(&EmulationSetup { servos, ..setup(CASE) }).unwrap_err()
    };
    let (joint, unstable) = refused("[-10.0, 11.0]");
    assert_eq!(joint, 0);
    assert!(matches!(unstable, EmulationError::Unstable { growth } if growth > 1.0), "{unstable}");
    let (_, late) = refused("[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 10.0]");
    assert_eq!(late, EmulationError::NoTorque { ratio: RATIO });
    let mut servos = Servo::Cascade.parameters();
    servos[1] = Servo::Velocity.parameters().remove(1);
    let mixed = EmulatingTransformer::new(&EmulationSetup { servos, ..setup(CASE) }).unwrap_err();
    let kinds = EmulationError::Mixed { takes: CommandKind::Velocity, others: CommandKind::Position };
    assert_eq!(mixed, (1, kinds));
}
