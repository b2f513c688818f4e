//! Moving arms with limits: they return within them, stop at position limits, keep their direction, and recover from
//! NaN measurements. The motion is computed from the commands by forward dynamics.

use crate::common::stacks::{COMPLIANT, DAMPED, ELBOW, POSE, without_limits};
use crate::common::{self, File, Link, Numbers, arm, at_state, control_context, sampled, seven_joints};
use nalgebra::{DVector, Vector3};
use opspace_control::{ControlInput, Controller, JointLimits, Measurement, OperationalSpaceController};
use opspace_model::{Data, Model, aba, frame_placement, frame_velocity, update};

/// Relative tolerance of a bound: the bounds are widened slightly several times between levels.
pub const ROUNDING: f64 = 1e-8;

/// A simulated arm with its controller, at 1 kHz with torques constant over a period.
pub struct Run {
    pub model: Model,
    pub controller: OperationalSpaceController,
    pub data: Data,
    pub measurement: Measurement,
    pub tau: DVector<f64>,
}

const PERIOD_S: f64 = 1e-3;

impl Run {
    pub fn new(model: Model, text: &str, limits: &JointLimits, q: &[f64], dq: &[f64]) -> Self {
        Self::with_period([PERIOD_S, 0.0], model, text, limits, q, dq)
    }

    /// Creates an arm whose controller has a period and a delay that it knows, s.
    pub fn with_period(
        [period_s, command_delay_s]: [f64; 2],
        model: Model,
        text: &str,
        limits: &JointLimits,
        q: &[f64],
        dq: &[f64],
    ) -> Self {
        let (file, mut robot) = (File::read(text), control_context(&model, "hand"));
        (robot.period_s, robot.command_delay_s) = (period_s, command_delay_s);
        robot.limits = limits.clone();
        let mut controller =
            OperationalSpaceController::new(&model, &file.task_set(), &robot).expect("a good stack");
        let (data, measurement) = at_state(&model, q, dq, 0.0);
        controller.start(&common::input(&model, &data, &measurement));
        let tau = DVector::zeros(model.n());
        Self { model, controller, data, measurement, tau }
    }

    pub fn step(&mut self) {
        self.control();
        let tau = self.tau.clone();
        self.advance(&tau);
    }

    /// Computes the torques of a cycle.
    pub fn control(&mut self) {
        let seen = &self.measurement;
        assert!(update(&self.model, &mut self.data, seen.q.as_slice(), seen.dq.as_slice()));
        self.controller.update(&common::input(&self.model, &self.data, seen), self.tau.as_mut_slice());
        assert!(self.tau.iter().all(|t| t.is_finite()), "{} at {} s", self.tau, seen.time_s);
    }

    /// Moves the arm by a millisecond.
    pub fn advance(&mut self, tau: &DVector<f64>) {
        let seen = &mut self.measurement;
        assert!(update(&self.model, &mut self.data, seen.q.as_slice(), seen.dq.as_slice()));
        aba(&self.model, &mut self.data, tau.as_slice());
        seen.q.axpy(PERIOD_S, &seen.dq, 1.0);
        seen.q.axpy(0.5 * PERIOD_S * PERIOD_S, &self.data.ddq, 1.0);
        seen.dq.axpy(PERIOD_S, &self.data.ddq, 1.0);
        seen.time_s += PERIOD_S;
    }

    pub fn hand(&self) -> (Vector3<f64>, Vector3<f64>) {
        let hand = self.model.frame_id("hand").expect("hand");
        let velocity = frame_velocity(&self.model, &self.data, hand).linear;
        (frame_placement(&self.model, &self.data, hand).translation, velocity)
    }
}

/// Limits within which the seven-joint arm can perform its tasks.
pub fn moderate_limits() -> JointLimits {
    JointLimits {
        lower: vec![-1.6; 7],
        upper: vec![1.6; 7],
        velocity: vec![2.5; 7],
        torque: vec![120.0, 120.0, 80.0, 80.0, 30.0, 30.0, 30.0],
        ..JointLimits::none(7)
    }
}

pub const REACHED: [f64; 7] = [0.3, 0.7, -0.4, 0.9, 0.2, -0.8, 0.5];

/// Starts beyond position limits and with excessive speeds. Commands are always finite and within the limits of torque
/// and torque rate; after one second, all quantities are within their limits and stay there.
#[test]
fn start_beyond_limits_returns_within_them() {
    let (limits, mut numbers) = (moderate_limits(), Numbers::new(17));
    let mut beyond = 0;
    for text in [POSE, ELBOW, DAMPED] {
        for _ in 0..3 {
            let q = REACHED.map(|q| q + 0.2 * numbers.next());
            let far: Vec<f64> =
                q.iter().map(|&q| if numbers.next() > 0.3 { 1.8 * q.signum() } else { q }).collect();
            let dq = numbers.vector(7, 5.0);
            beyond +=
                far.iter().filter(|q| q.abs() > 1.6).count() + dq.iter().filter(|v| v.abs() > 2.5).count();
            let mut run = Run::new(seven_joints(), text, &limits, &far, &dq);
            let mut before = run.data.gravity.clone();
            for tick in 0..1500 {
                run.step();
                for i in 0..7 {
                    let (t, limit) = (run.tau[i], limits.torque[i]);
                    assert!(t.abs() <= limit * (1.0 + ROUNDING), "joint {i}: {t} Nm of {limit}");
                    let step = (t - before[i].clamp(-limit, limit)).abs();
                    assert!(step <= 0.1 * limit + 2.0 * ROUNDING * limit, "joint {i}: a step of {step} Nm");
                    let (q, v) = (run.measurement.q[i], run.measurement.dq[i]);
                    if tick > 1000 {
                        assert!(
                            q.abs() < 1.6 && v.abs() < 2.5,
                            "joint {i} at tick {tick}: {q} rad, {v} rad/s"
                        );
                    }
                }
                before.copy_from(&run.tau);
            }
        }
    }
    assert!(beyond > 30, "{beyond} joints start beyond a limit");
}

/// After a command beyond the torque limit, the next command is within the limit, regardless of the rate limit.
#[test]
fn torque_beyond_limit_returns_immediately() {
    let (model, q) = (seven_joints(), [0.3, 1.2, -0.4, 0.9, 0.2, -0.8, 0.5]);
    let gravity = at_state(&model, &q, &[0.0; 7], 0.0).0.gravity;
    let limits = JointLimits {
        torque: gravity.iter().map(|g| 0.5 * g.abs() + 0.1).collect(),
        torque_rate: vec![1.0; 7],
        ..JointLimits::none(7)
    };
    let mut run = Run::new(model, DAMPED, &limits, &q, &[0.0; 7]);
    run.step();
    for i in 0..7 {
        assert!(
            run.tau[i].abs() <= limits.torque[i] * (1.0 + ROUNDING),
            "joint {i}: {} of {}",
            run.tau[i],
            limits.torque[i]
        );
        assert!(gravity[i].abs() < 0.5 || gravity[i].abs() > limits.torque[i]);
    }
}

/// A hand with an unreachable goal: every joint stays within its position limit.
#[test]
fn joints_stop_at_position_limits() {
    let mut stopped = 0;
    for (text, offset) in
        [(POSE, "[0.5, -0.4, -0.3]"), (ELBOW, "[-0.6, 0.5, 0.2]"), (DAMPED, "[0.4, 0.6, -0.5]")]
    {
        let reference = format!(
            "reference.point-to-point = {{ position = {{ offset_m = {offset} }}, duration_s = 0.4 }}"
        );
        let text = text.replacen("reference = \"hold\"", &reference, 1);
        let limits = JointLimits {
            lower: REACHED.map(|q| q - 0.25).to_vec(),
            upper: REACHED.map(|q| q + 0.25).to_vec(),
            ..moderate_limits()
        };
        let mut run = Run::new(seven_joints(), &text, &limits, &REACHED, &[0.0; 7]);
        let (mut worst, mut jump, mut before) = (f64::NEG_INFINITY, 0.0_f64, run.tau.clone());
        for tick in 0..1500 {
            before.copy_from(&run.tau);
            run.step();
            if tick > 1300 {
                jump = jump.max((&before - &run.tau).amax());
            }
            // Ranges are narrowed by a margin of 0.01 rad.
            worst = worst.max((&run.measurement.q - DVector::from(REACHED.to_vec())).amax() - 0.24);
        }
        assert!(worst < 1e-4, "{text}: {worst} rad beyond");
        stopped += (0..7).filter(|&i| (run.measurement.q[i] - REACHED[i]).abs() > 0.239).count();
        // The joints rest at their limits without chattering.
        assert!(jump < 0.05, "{text}: torques change by {jump} Nm from tick to tick");
    }
    assert!(stopped > 5, "joints stand at the ends of their ranges: {stopped}");
}

/// Time from a measurement until its torque acts: none, a period that the controller knows, or one that it does not know.
#[derive(Clone, Copy, PartialEq)]
enum Delay {
    None,
    Known,
    Unknown,
}

/// Time in which the torque may rise from zero to its limit, if no rate is given, s.
const RISE_S: f64 = 0.01;

/// Moves an arm violently with a control period (ms), and returns the highest speed, rad/s. No joint crosses its position
/// limit, and no command the limits of torque and torque rate.
fn highest_speed(period_ms: u64, delay: Delay) -> f64 {
    let (mut fastest, mut numbers) = (0.0_f64, Numbers::new(23 + period_ms));
    for text in [POSE, ELBOW, DAMPED] {
        let mut wave = || {
            let (amplitude, frequency) = (0.5 + 0.3 * numbers.next(), 1.5 + numbers.next());
            format!("[{{ amplitude_m = {amplitude}, frequency_hz = {frequency} }}]")
        };
        let waves = format!("x = {}, y = {}, z = {}", wave(), wave(), wave());
        let reference = format!("reference.sinusoid = {{ ramp_s = 0.2, {waves} }}");
        let text = text.replacen("reference = \"hold\"", &reference, 1);
        let (limits, period_s) = (moderate_limits(), 1e-3 * period_ms as f64);
        let periods = [period_s, if delay == Delay::Known { period_s } else { 0.0 }];
        let mut run = Run::with_period(periods, seven_joints(), &text, &limits, &REACHED, &[0.0; 7]);
        let mut acting = run.data.gravity.clone();
        for _ in 0..4000 / period_ms {
            let before = acting.clone();
            run.control();
            acting.copy_from(&run.tau);
            for (i, &limit) in limits.torque.iter().enumerate() {
                let (torque, step) = (acting[i].abs(), (acting[i] - before[i]).abs());
                let rise = limit * period_s / RISE_S;
                assert!(torque <= limit * (1.0 + ROUNDING), "{period_ms} ms: {torque} Nm of {limit} Nm");
                assert!(step <= rise + ROUNDING * limit, "{period_ms} ms: a step of {step} Nm of {rise} Nm");
            }
            for _ in 0..period_ms {
                run.advance(if delay == Delay::None { &acting } else { &before });
                let q = run.measurement.q.amax();
                assert!(q < 1.6, "{period_ms} ms: {q} rad of 1.6 rad\n{text}");
                fastest = fastest.max(run.measurement.dq.amax());
            }
        }
    }
    fastest
}

/// Compared: the speed in violent motions at control periods from 1 to 20 ms with its limit of 2.5 rad/s, of which the
/// controller uses 0.9. Torques that act at most 10 ms late exceed it by less than 5 %; those that act 20 ms late do not if the
/// controller knows the delay, otherwise by 30 %.
#[test]
fn speed_limits_hold_at_any_period() {
    for period_ms in [1, 2, 8, 10, 20] {
        let [in_time, known, unknown] =
            [Delay::None, Delay::Known, Delay::Unknown].map(|delay| highest_speed(period_ms, delay));
        assert!((2.2..2.5).contains(&in_time), "{period_ms} ms: {in_time} rad/s");
        let [allowed_known, allowed] = if period_ms < 20 { [1.05; 2] } else { [1.0, 1.35] };
        assert!(known < allowed_known * 2.5, "{period_ms} ms, a period late: {known} rad/s");
        assert!(unknown < allowed * 2.5, "{period_ms} ms, a period late: {unknown} rad/s");
    }
}

/// Returns the displacement of the hand for joint displacements `offset` (rad), m.
fn hand_displacement(offset: &[f64; 7]) -> Vector3<f64> {
    let model = seven_joints();
    let hand = |q: &[f64]| {
        let data = at_state(&model, q, &[0.0; 7], 0.0).0;
        frame_placement(&model, &data, model.frame_id("hand").expect("hand")).translation
    };
    let q: Vec<f64> = REACHED.iter().zip(offset).map(|(q, d)| q + d).collect();
    hand(&q) - hand(&REACHED)
}

/// Simulates a hand whose reference is much faster than its limits allow, and returns the largest speed (m/s), the
/// largest angle (°) between its velocity and the straight path at speeds above 0.1 m/s, and the remaining distance
/// after `seconds` (m).
fn hurried_motion(limits: &JointLimits, more: &str, duration_s: f64, seconds: f64) -> (f64, f64, f64) {
    let way = hand_displacement(&[0.3, -0.2, 0.1, 0.4, -0.2, 0.3, 0.1]);
    let offset = way.as_slice();
    let reference = format!(
        "reference.point-to-point = {{ position = {{ offset_m = {offset:?} }}, duration_s = {duration_s} }}"
    );
    let text = DAMPED.replacen("reference = \"hold\"", &format!("{reference}\n{more}"), 1);
    let mut run = Run::new(seven_joints(), &text, limits, &REACHED, &[0.0; 7]);
    let (start, _) = run.hand();
    let (mut fastest, mut aside, mut limited) = (0.0_f64, 0.0_f64, 0);
    for _ in 0..(seconds / PERIOD_S) as usize {
        run.step();
        let (_, velocity) = run.hand();
        let left = start + way - run.hand().0;
        fastest = fastest.max(velocity.norm());
        if velocity.norm() > 0.1 && left.norm() > 0.05 {
            aside = aside.max(velocity.angle(&way));
        }
        limited += usize::from(run.controller.is_limited());
    }
    assert!(limited > 50, "{limited} ticks were limited");
    (fastest, aside.to_degrees(), (start + way - run.hand().0).norm())
}

/// Limits that are active only in fast motions.
fn generous_limits() -> JointLimits {
    JointLimits { lower: vec![-3.0; 7], upper: vec![3.0; 7], velocity: vec![20.0; 7], ..moderate_limits() }
}

/// Largest angle (°) to the straight path under limits that slowing down alone would satisfy: the weight of errors
/// perpendicular to the path is finite, ten times that of errors along it.
const ASIDE_DEG: f64 = 10.0;

/// Compared: the hand's speed with the limit of its task, and its direction with the straight line.
#[test]
fn hand_keeps_speed_limit_and_direction() {
    for duration_s in [0.2, 0.5] {
        let (fastest, aside, left) =
            hurried_motion(&generous_limits(), "speed_limit_m_per_s = 0.3", duration_s, 2.5);
        assert!(fastest < 0.3 * 1.02 && fastest > 0.29, "{fastest} m/s");
        assert!(aside < ASIDE_DEG, "{aside} degrees");
        assert!(left < 1e-4, "{left} m are left");
    }
}

/// The hand moves along the straight line and arrives, if joints are too slow, too weak, or limited in acceleration.
#[test]
fn limits_slow_hand_without_lateral_deviation() {
    for limits in [
        JointLimits { velocity: vec![0.6; 7], ..generous_limits() },
        JointLimits { acceleration: vec![4.0; 7], ..generous_limits() },
        JointLimits { torque: vec![60.0, 60.0, 30.0, 30.0, 5.0, 5.0, 5.0], ..generous_limits() },
    ] {
        let (_, aside, left) = hurried_motion(&limits, "", 0.2, 2.5);
        assert!(aside < ASIDE_DEG, "{aside} degrees under {limits:?}");
        assert!(left < 1e-4, "{left} m are left under {limits:?}");
    }
}

/// An arm is kept in a constant state for half a second. With a load that saturates a joint in the meantime, its
/// integral is equal to one that has just started; without the load, the integral has grown.
#[test]
fn integrals_freeze_while_limit_is_active() {
    let motion =
        DAMPED.replace("damping_ratio = 1.0 }", "damping_ratio = 1.0, integral_per_s = 5.0 }").replacen(
            "reference = \"hold\"",
            "reference.sinusoid.x = [{ amplitude_m = 0.0, frequency_hz = 1.0, offset_m = 0.1 }]",
            1,
        );
    let force = COMPLIANT
        .replace("x = \"compliant\"", "x = \"force\"")
        .replace("filter_hz = 100.0 }", "target_n = { x = 8.0 } }");
    for text in [motion, force] {
        let limits =
            JointLimits { torque: vec![300.0; 7], torque_rate: vec![1e9; 7], ..JointLimits::none(7) };
        let after = |ticks: usize, load: f64| {
            let mut run = Run::new(seven_joints(), &text, &limits, &REACHED, &[0.0; 7]);
            let (mut tau, mut seen) = (DVector::zeros(7), run.measurement.clone());
            seen.time_s = 2.0;
            for tick in 0..=ticks {
                // A load that exceeds the torque of the second joint's motor, then none.
                let mut feedforward_torque = [0.0; 7];
                feedforward_torque[1] = if tick == 0 || tick == ticks { 0.0 } else { load };
                let input = common::input(&run.model, &run.data, &seen);
                let input = ControlInput { feedforward_torque: &feedforward_torque, ..input };
                run.controller.update(&input, tau.as_mut_slice());
                assert_eq!(run.controller.is_limited(), feedforward_torque[1] != 0.0);
            }
            tau
        };
        // Two cycles integrate: the first one, and the one that detects the active limit.
        let (begun, held, free) = (after(1, 0.0), after(500, 400.0), after(500, 0.0));
        let size = (&free - &begun).amax();
        assert!(size > 1.0, "half a second of integral is {size} Nm");
        let off = (&held - &begun).amax();
        assert!(off < 3.0 * size / 500.0, "{text}: {off} Nm beside {size} Nm");
    }
}

/// If any measurement is NaN, the command is NaN too, for the backend to reject; there is no panic, and the command is
/// finite again after a restart.
#[test]
fn nan_measurement_gives_no_command() {
    type Break = fn(&mut Measurement);
    let breaks: [Break; 4] =
        [|m| m.q[2] = f64::NAN, |m| m.dq[5] = f64::NAN, |m| m.dq[0] = f64::INFINITY, |m| m.q.fill(f64::NAN)];
    for text in [POSE, ELBOW, DAMPED, COMPLIANT] {
        for spoil in breaks {
            let mut run = Run::new(seven_joints(), text, &moderate_limits(), &REACHED, &[0.0; 7]);
            run.step();
            let good = run.measurement.clone();
            let mut bad = good.clone();
            spoil(&mut bad);
            for _ in 0..3 {
                // The backend checks that M can be factored.
                let _ = update(&run.model, &mut run.data, bad.q.as_slice(), bad.dq.as_slice());
                run.controller.update(&common::input(&run.model, &run.data, &bad), run.tau.as_mut_slice());
                assert!(run.tau.iter().any(|t| !t.is_finite()), "{text}: {}", run.tau);
                assert_eq!(sampled(&run.controller, "limits_solver"), [3.0], "no solver");
            }
            let (q, dq) = (good.q.as_slice(), good.dq.as_slice());
            assert!(update(&run.model, &mut run.data, q, dq));
            run.controller.start(&common::input(&run.model, &run.data, &good));
            run.measurement = good;
            run.step();
            assert!(
                run.tau
                    .iter()
                    .zip(&moderate_limits().torque)
                    .all(|(t, limit)| t.abs() <= limit * (1.0 + ROUNDING))
            );
        }
        let mut run = Run::new(seven_joints(), text, &moderate_limits(), &REACHED, &[0.0; 7]);
        for added in [f64::NAN, f64::INFINITY, -f64::INFINITY] {
            let mut feedforward_torque = [0.0; 7];
            feedforward_torque[3] = added;
            let input = common::input(&run.model, &run.data, &run.measurement);
            let input = ControlInput { feedforward_torque: &feedforward_torque, ..input };
            run.controller.update(&input, run.tau.as_mut_slice());
        }
    }
}

/// NaN measurements have no effect after their cycle, without a restart and for any filters and integrals. Compared,
/// without limits: a controller whose wrench is lost in one cycle with a controller that is not evaluated in that
/// cycle.
#[test]
fn nan_measurement_is_forgotten_after_its_cycle() {
    type Break = fn(&mut Measurement);
    const LOST: usize = 0;
    let breaks: [Break; 5] = [
        |m| {
            m.wrenches[0].linear.fill(f64::NAN);
            m.wrenches[0].angular.fill(f64::NAN);
        },
        |m| m.wrenches[0].linear.y = f64::NAN,
        |m| m.wrenches[0].angular.z = f64::INFINITY,
        |m| m.q[2] = f64::NAN,
        |m| m.dq.fill(f64::NAN),
    ];
    let force = COMPLIANT
        .replace("x = \"compliant\"", "x = \"force\"")
        .replace("filter_hz = 100.0 }", "target_n = { x = 8.0 } }");
    let both = force.replace(
        "damping_ratio = 1.0 }",
        "damping_ratio = 1.0, integral_per_s = 5.0, integral_limit_m = 0.1 }",
    );
    for (text, limits) in [(both, Some(moderate_limits())), (without_limits(&force), None)] {
        let robot_limits = limits.clone().unwrap_or_else(|| JointLimits::none(7));
        let command = |run: &mut Run, seen: &Measurement| {
            // The backend checks that M can be factored.
            let _ = update(&run.model, &mut run.data, seen.q.as_slice(), seen.dq.as_slice());
            run.controller.update(&common::input(&run.model, &run.data, seen), run.tau.as_mut_slice());
        };
        for (kind, spoil) in breaks.into_iter().enumerate() {
            let [mut run, mut spared] =
                [(); 2].map(|()| Run::new(seven_joints(), &text, &robot_limits, &REACHED, &[0.0; 7]));
            let mut seen = run.measurement.clone();
            for tick in 0..20 {
                seen.time_s = PERIOD_S * f64::from(tick);
                seen.q[1] = REACHED[1] + 1e-4 * f64::from(tick);
                seen.wrenches[0].linear.x = f64::from(tick);
                if tick == 10 {
                    let mut bad = seen.clone();
                    spoil(&mut bad);
                    command(&mut run, &bad);
                    assert!(run.tau.iter().any(|t| !t.is_finite()), "case {kind}: {}", run.tau);
                    continue;
                }
                command(&mut run, &seen);
                assert!(run.tau.iter().all(|t| t.is_finite()), "case {kind}, tick {tick}: {}", run.tau);
                command(&mut spared, &seen);
            }
            if kind == LOST && limits.is_none() {
                assert_eq!(run.tau, spared.tau);
            }
        }
    }
}

/// With ranges of zero width, the joints keep their positions for any task of the hand.
#[test]
fn zero_width_range_holds_its_joint() {
    let limits = JointLimits { lower: REACHED.to_vec(), upper: REACHED.to_vec(), ..moderate_limits() };
    let reference =
        "reference.point-to-point = { position = { offset_m = [0.2, 0.1, -0.1] }, duration_s = 0.2 }";
    let text = POSE.replacen("reference = \"hold\"", reference, 1);
    let mut run = Run::new(seven_joints(), &text, &limits, &REACHED, &[0.0; 7]);
    for _ in 0..500 {
        run.step();
    }
    let away = (0..7).map(|i| (run.measurement.q[i] - REACHED[i]).abs()).fold(0.0, f64::max);
    assert!(away < 1e-4, "{away} rad from where the range is");
}

/// A planar arm with two joints at their limits of speed, torque and position stays within all three limits.
#[test]
fn planar_arm_keeps_its_limits() {
    let link = |name, origin| Link {
        name,
        axis: [0.0, 1.0, 0.0],
        origin,
        mass: 1.0,
        com: [0.0, 0.0, -0.2],
        inertia: [0.01, 0.01, 0.002],
        limits: [-3.0, 3.0],
        rotor: 0.01,
    };
    let model = || {
        arm(
            &[link("shoulder", [0.0; 3]), link("elbow", [0.0, 0.0, -0.4])],
            &[("hand", 1, [0.0, 0.0, -0.4])],
            1.0,
        )
    };
    let text = r#"
        priority = ["hand"]
        [task.hand.cartesian]
        frame = "hand"
        axes = { x = "motion", z = "motion" }
        reference.point-to-point = { position = { offset_m = [0.3, 0.0, 0.3] }, duration_s = 0.1 }
        gains = { frequency_rad_per_s = 20.0, damping_ratio = 1.0 }
    "#;
    let limits = JointLimits {
        lower: vec![-0.5, -1.5],
        upper: vec![0.5, -0.2],
        velocity: vec![2.0; 2],
        torque: vec![9.0, 4.0],
        ..JointLimits::none(2)
    };
    let mut run = Run::new(model(), text, &limits, &[0.1, -0.7], &[0.0; 2]);
    let mut limited = 0;
    for _ in 0..2000 {
        run.step();
        limited += usize::from(run.controller.is_limited());
        for i in 0..2 {
            let (q, v, t) = (run.measurement.q[i], run.measurement.dq[i], run.tau[i]);
            assert!(q > limits.lower[i] && q < limits.upper[i], "joint {i}: {q} rad");
            assert!(v.abs() < limits.velocity[i], "joint {i}: {v} rad/s");
            assert!(t.abs() <= limits.torque[i] * (1.0 + ROUNDING), "joint {i}: {t} Nm");
        }
    }
    assert!(limited > 100, "{limited} ticks were limited");
}

/// A hand exceeds its speed limit, and its joints are too weak for the desired deceleration: they brake as hard as they
/// can. Compared: the braking time with that of the task's law alone.
#[test]
fn too_fast_hand_is_braked_at_torque_limits() {
    let slow_law = DAMPED.replace("frequency_rad_per_s = 14.0", "frequency_rad_per_s = 0.5");
    let until_slow = |more: &str| {
        let text = slow_law.replacen("reference = \"hold\"", &format!("reference = \"hold\"\n{more}"), 1);
        let limits = JointLimits { torque: vec![60.0, 70.0, 30.0, 30.0, 8.0, 8.0, 8.0], ..generous_limits() };
        let mut run =
            Run::new(seven_joints(), &text, &limits, &REACHED, &[1.5, 1.5, 1.5, -1.5, 0.0, 0.0, 0.0]);
        let first = run.hand().1.norm();
        (0..2000).find(|_| {
            run.step();
            run.hand().1.norm() < 0.5 * first
        })
    };
    let (with, without) = (until_slow("speed_limit_m_per_s = 0.1"), until_slow(""));
    assert!(
        with.is_some_and(|with| without.is_none_or(|without| 2 * with < without)),
        "{with:?}, {without:?} ticks"
    );
}

/// Compared: changes of the torques from cycle to cycle with the size of the velocity noise, for an arm that is too
/// weak to hold itself.
#[test]
fn velocity_noise_does_not_shake_saturated_torques() {
    let jump = |text: &str, noise: f64| {
        let gravity = at_state(&seven_joints(), &REACHED, &[0.0; 7], 0.0).0.gravity;
        let limits = JointLimits {
            torque: gravity.iter().map(|g| 0.9 * g.abs() + 0.01).collect(),
            torque_rate: vec![1e9; 7],
            ..JointLimits::none(7)
        };
        let mut run = Run::new(seven_joints(), text, &limits, &REACHED, &[0.0; 7]);
        let (mut numbers, mut worst) = (Numbers::new(18), 0.0_f64);
        let mut before: Option<DVector<f64>> = None;
        for _ in 0..200 {
            run.measurement.dq.copy_from_slice(&numbers.vector(7, noise));
            assert!(update(&run.model, &mut run.data, &REACHED, run.measurement.dq.as_slice()));
            run.controller
                .update(&common::input(&run.model, &run.data, &run.measurement), run.tau.as_mut_slice());
            assert!(run.controller.is_limited());
            if let Some(before) = before.replace(run.tau.clone()) {
                worst = worst.max((&run.tau - before).amax());
            }
        }
        worst
    };
    for text in [POSE, ELBOW, DAMPED] {
        let (noisy, quiet) = (jump(text, 1e-3), jump(text, 1e-4));
        assert!(quiet < 0.2 * noisy + 1e-6, "{text}: {quiet} Nm for a tenth of what gives {noisy} Nm");
    }
}
