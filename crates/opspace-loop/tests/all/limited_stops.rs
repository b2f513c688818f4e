//! Every setpoint of a run keeps the limits that the drives declare, and the speed limit of its joint, to the last one of a stop.

use crate::common::{
    Commanded, LIMITS, PERIOD_S, REST, Received, Rows, START, Scripted, at_rest, capabilities, config,
    drive_robot, position_controller, safety,
};
use opspace_backend::quantity::Positive;
use opspace_backend::{CommandKind, Sample, StopMethod};
use opspace_loop::{ControlLoop, Fault, LoopConfig, Phase, Run, RunOutcome, drive};
use opspace_testing::random::Random;
use opspace_transformer::setpoint_limits::{JointSetpointLimits, SetpointStream};
use std::f64::consts::TAU;
use std::sync::atomic::{AtomicBool, Ordering};

/// Number of runs of each test.
const RUNS: u64 = 400;

/// Speed of a setpoint at rest, rad/s: the effect of rounding is a hundredth of it.
const REST_RAD_PER_S: f64 = 1e-7;

/// Speed limit of the joints, rad/s.
const SPEED: f64 = 5.0;

/// Rounding of a step, rad.
const ROUNDING: f64 = 1e-12;

/// Way in which a run ends.
#[derive(Clone, Copy, Debug, PartialEq)]
enum End {
    Planned,
    Requested,
    NotFinite,
    Dropout,
    Unreadable,
    Refused,
}

const ENDS: [End; 6] =
    [End::Planned, End::Requested, End::NotFinite, End::Dropout, End::Unreadable, End::Refused];

/// A run with random limits, motion, noise, and end.
struct Draw {
    kind: CommandKind,
    on_stop: StopMethod,
    limits: [JointSetpointLimits; 2],
    end: End,
    /// Cycle of the end.
    at: u64,
    amplitude: [f64; 2],
    hz: [f64; 2],
    noise: f64,
    torque: f64,
    /// True if the controller commands positions.
    commands_positions: bool,
    seed: u64,
}

fn log_between(random: &mut Random, low: f64, high: f64) -> f64 {
    low * (high / low).powf(random.next())
}

impl Draw {
    fn new(seed: u64, limited: [bool; 2]) -> Self {
        let mut random = Random(seed);
        let random = &mut random;
        let limits = limited.map(|is_limited| {
            let mut limits = JointSetpointLimits::default();
            if !is_limited {
                return limits;
            }
            let mut drawn = |low, high, probability: f64| {
                random.is(probability).then(|| Positive::literal(log_between(random, low, high)))
            };
            limits.velocity_rad_per_s = drawn(0.3, 6.0, 0.7);
            limits.jerk_rad_per_s3 = drawn(30.0, 1e6, 0.6);
            // One limit at least.
            limits.acceleration_rad_per_s2 = drawn(3.0, 1000.0, 1.0);
            limits
        });
        let kind = if random.is(0.7) { CommandKind::Position } else { CommandKind::Velocity };
        Self {
            kind,
            on_stop: if random.is(0.7) { StopMethod::Setpoints } else { StopMethod::Robot },
            limits,
            end: ENDS[random.below(ENDS.len())],
            at: REST + 20 + random.below(400) as u64,
            amplitude: [0; 2].map(|_| random.between(0.0, 0.4)),
            hz: [0; 2].map(|_| log_between(random, 0.2, 3.0)),
            noise: if random.is(0.5) { log_between(random, 1e-7, 1e-4) } else { 0.0 },
            torque: random.between(0.0, 2.0),
            commands_positions: kind == CommandKind::Position && random.is(0.3),
            seed,
        }
    }

    fn describe(&self) -> String {
        let Self { kind, on_stop, limits, end, at, commands_positions, seed, .. } = self;
        format!("{seed}: {kind:?}, {on_stop:?}, {end:?} at {at}, positions: {commands_positions}, {limits:?}")
    }

    /// Fills a sample: the joints move as sines from the start posture.
    fn fill(&self, cycle: u64, random: &mut Random, sample: &mut Sample) {
        let t = cycle.saturating_sub(REST) as f64 * PERIOD_S;
        for (i, (q, start)) in sample.q.iter_mut().zip(START).enumerate() {
            let angle = TAU * self.hz[i] * t;
            *q = start + self.amplitude[i] * (1.0 - angle.cos()) + self.noise * random.between(-1.0, 1.0);
        }
        let is_late = self.end == End::Dropout && cycle >= self.at;
        sample.time_s = (cycle + if is_late { 50 } else { 0 }) as f64 * PERIOD_S;
        if self.end == End::NotFinite && cycle == self.at {
            sample.q[0] = f64::NAN;
        }
    }

    fn config(&self) -> LoopConfig {
        let capabilities = capabilities(self.kind).with_on_stop(self.on_stop);
        let setpoint_limits = self.limits.to_vec();
        let (torque, amplitude, hz) = (self.torque, self.amplitude[1], self.hz[1]);
        let config = if self.commands_positions {
            let moving = move |time_s: f64| amplitude * (1.0 - (TAU * hz * time_s).cos());
            config(capabilities, position_controller(moving))
        } else {
            let mut random = Random(self.seed);
            let controller = Commanded::torques(move |data, _, tau| {
                for (i, tau) in tau.iter_mut().enumerate() {
                    let commanded = data.gravity[i] + torque * LIMITS[i] * random.between(-1.0, 1.0);
                    *tau = commanded.clamp(-LIMITS[i], LIMITS[i]);
                }
            });
            config(capabilities, controller)
        };
        LoopConfig { setpoint_limits, safety: safety(), ..config }
    }
}

/// Commands of a run, and what they break.
struct Checked {
    setpoints: usize,
    /// Cycles between the first command of the stop and the robot's own stop.
    stopping: usize,
    problems: Vec<String>,
}

fn check(draw: &Draw) -> Checked {
    let request = AtomicBool::new(false);
    let mut random = Random(draw.seed ^ 1);
    let fill = |cycle: u64, sample: &mut Sample| {
        draw.fill(cycle, &mut random, sample);
        request.store(draw.end == End::Requested && cycle >= draw.at, Ordering::Relaxed);
    };
    let mut robot = Scripted::new(capabilities(draw.kind).with_on_stop(draw.on_stop), fill);
    match draw.end {
        End::Unreadable => robot.unreadable = draw.at..draw.at + 1,
        End::Refused => robot.refused = Some(draw.at),
        _ => {}
    }
    let duration_s = if draw.end == End::Planned { (draw.at - REST) as f64 * PERIOD_S } else { 1.0 };
    let record = drive_robot(draw.config(), duration_s, &request, robot);
    let mut problems = Vec::new();
    let mut streams = draw.limits.map(|limits| SetpointStream::new(&limits, draw.kind, PERIOD_S));
    let mut last: Option<[[f64; 2]; 2]> = None;
    let mut setpoints = 0;
    let mut is_kept = false;
    for (received, &cycle) in record.received.iter().zip(&record.received_in) {
        // In missed cycles, the drives keep their last setpoints.
        if draw.end == End::Dropout && cycle >= draw.at && !is_kept {
            is_kept = true;
            streams.iter_mut().for_each(SetpointStream::keep);
        }
        match received {
            Received::Positions(command) | Received::Velocities(command) => {
                setpoints += 1;
                for (i, stream) in streams.iter_mut().enumerate() {
                    let step = last.map_or(0.0, |[_, before]| (command[i] - before[i]).abs());
                    if draw.kind == CommandKind::Position && step > SPEED * PERIOD_S + ROUNDING {
                        problems.push(format!("setpoint {setpoints} of joint {i}: a step of {step:.2e} rad"));
                    }
                    if let Some(limit) = stream.exceeds(command[i]) {
                        problems.push(format!("setpoint {setpoints} of joint {i}: {}", limit.name()));
                    }
                    stream.take(command[i]);
                }
                let now = [command[0], command[1]];
                last = Some([last.map_or(now, |[_, before]| before), now]);
            }
            Received::Hold if draw.kind == CommandKind::Position => {
                streams.iter_mut().for_each(SetpointStream::keep)
            }
            _ => streams.iter_mut().for_each(SetpointStream::restart),
        }
    }
    let stopping = record.phases().iter().filter(|phase| **phase == Phase::Stopping.code()).count();
    let is_stop_of_robot = draw.on_stop == StopMethod::Robot
        || matches!(&record.outcome, RunOutcome::Faulted { fault: Fault::Device(_), .. });
    if is_stop_of_robot && stopping > 0 {
        problems.push(format!("{stopping} setpoints of a stop"));
    }
    // A velocity robot balances the weight at rest. A device fault may also come during a stop.
    let may_fail = matches!(draw.end, End::Unreadable | End::Refused);
    if !is_stop_of_robot && !may_fail && draw.kind == CommandKind::Position {
        let [before, at_end] = last.expect("it was commanded");
        for i in (0..2).filter(|i| draw.limits[*i] != JointSetpointLimits::default()) {
            let speed = (at_end[i] - before[i]).abs() / PERIOD_S;
            if speed > REST_RAD_PER_S {
                problems.push(format!("joint {i} is left at {speed:.2e} rad/s"));
            }
        }
    }
    Checked { setpoints, stopping, problems }
}

/// Runs every draw; returns the numbers of runs with more than one setpoint of a stop, by end.
fn check_all(limited: [bool; 2]) -> Vec<(End, usize)> {
    let mut slow: Vec<(End, usize)> = ENDS.map(|end| (end, 0)).to_vec();
    let mut found = Vec::new();
    for seed in 0..RUNS {
        let draw = Draw::new(seed, limited);
        let Checked { setpoints, stopping, problems } = check(&draw);
        assert!(setpoints > 5, "{}", draw.describe());
        let place = ENDS.iter().position(|end| *end == draw.end).expect("an end");
        slow[place].1 += usize::from(stopping > 0);
        if !problems.is_empty() {
            found.push(format!("{}\n    {}", draw.describe(), problems.join("\n    ")));
        }
    }
    assert!(found.is_empty(), "{} of {RUNS}:\n{}", found.len(), found[..found.len().min(5)].join("\n"));
    slow
}

/// Compared: each setpoint with the limits, and the speed of the last two with rest.
#[test]
fn setpoints_come_to_rest_within_their_limits() {
    for (end, runs) in check_all([true, true]) {
        // A device fault ends no stop slowly, unless another fault was first.
        let expected = if matches!(end, End::Unreadable | End::Refused) { 0 } else { 10 };
        assert!(runs >= expected, "{end:?}: {runs}");
    }
}

/// Compared: the same, where one of two joints has no limits.
#[test]
fn a_joint_without_limits_waits_for_the_other() {
    let slow = check_all([true, false]);
    assert!(slow.iter().map(|(_, runs)| runs).sum::<usize>() > 40, "{slow:?}");
}

/// A stop whose setpoints come to rest slowly, and a second request some cycles after the first: without it, and with it.
#[test]
fn second_request_ends_a_slow_stop() {
    const SECOND: u64 = 5;
    let mut limits = JointSetpointLimits::default();
    limits.acceleration_rad_per_s2 = Some(Positive::literal(3.0));
    let at = REST + 100;
    let stopped_in = |aborts: bool| {
        let (request, abort) = (AtomicBool::new(false), AtomicBool::new(false));
        let mut robot = Scripted::new(capabilities(CommandKind::Position), |cycle, sample: &mut Sample| {
            at_rest(cycle, sample);
            let t = cycle.saturating_sub(REST) as f64 * PERIOD_S;
            sample.q[1] += 0.5 * t * t;
            request.store(cycle >= at, Ordering::Relaxed);
            abort.store(aborts && cycle >= at + SECOND, Ordering::Relaxed);
        });
        let moving =
            config(capabilities(CommandKind::Position), position_controller(|time_s| 0.5 * time_s * time_s));
        let control =
            ControlLoop::new(LoopConfig { setpoint_limits: vec![limits; 2], safety: safety(), ..moving })
                .expect("parts that fit");
        let mut rows = Rows::default();
        let mut run =
            Run::new(control, 10.0, &mut rows).with_stop_request(&request).with_abort_request(&abort);
        drive(&mut robot, &mut run);
        assert!(matches!(run.finish(), RunOutcome::Interrupted { .. }));
        let stop = robot.received.iter().position(|received| *received == Received::Stop);
        robot.received_in[stop.expect("it is stopped")] - at
    };
    let (slow, quick) = (stopped_in(false), stopped_in(true));
    assert!(slow > 2 * SECOND, "{slow} cycles");
    assert_eq!(quick, SECOND, "{slow} cycles without it");
}
