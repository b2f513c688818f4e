//! Teleoperation in which the program of one robot is restarted, so that its packets, energies and displacements begin anew, or
//! in which a robot is held.

use crate::coupled_common::{
    CALM_RAD_PER_S, LEADER_STEP_N, NEAR_TABLE, NO_TABLE, PERIOD_S, REFERENCE_M_PER_S, STORE_J, teleoperation,
};
use opspace_backend::signal_names::{
    self, DISPLACEMENT, PORT_CLOSED, PORT_ENERGY_IN, PORT_FORCE, PORT_LIMITED, PORT_SESSION, REFERENCE,
};
use opspace_backend::{Backend, GroundTruth, Layout, Sample, TICK, TruthRow};
use opspace_control::HoldCause;
use opspace_coupling::CouplingKind;
use opspace_experiment::{Experiment, Scenario};
use opspace_loop::{ChannelParameters, Link, Run, Timeline};
use opspace_sim::SimulatedArm;
use std::sync::atomic::{AtomicBool, Ordering};

/// Operator who lowers the hand by 20 mm before the restart, and by 40 mm afterwards. During the restart he pulls at nothing:
/// a program that starts takes what its force sensor reads for the bias.
const MOVED: &str = "leader.environment.operator.spring.motion.scripted={ reach = [{ at_s = 0.3, duration_s = 0.5, \
                     by_m = [0.0, 0.0, -0.02] }, { at_s = 2.0, duration_s = 0.7, by_m = [0.0, 0.0, -0.04] }] }";
/// Times of the restart, of the comparison's begin, and of the end, s.
const RESTART_S: f64 = 1.2;
const COMPARED_S: f64 = 2.1;
/// Time until which steps after a restart are compared, s: the coupling has closed, and the table is not reached yet.
const CLOSED_S: f64 = 2.2;
const END_S: f64 = 3.0;
/// Force that the operator feels of the table at least, N.
const CONTACT_N: f64 = 3.0;
/// Largest difference of the motions after the restart, m: that of 50 ms at the operator's largest speed of 0.11 m/s, and 2 mm.
const TRACKING_M: f64 = 0.0075;
/// Least motion of a hand in the comparison, m: half of the operator's.
const MOVED_M: f64 = 0.02;

/// Robot of the experiment, and its program while it runs.
struct Robot<'a> {
    experiment: &'a Experiment,
    arm: SimulatedArm,
    sample: Sample,
    run: Option<Run<'static>>,
    stop: &'static AtomicBool,
    layout: Layout,
    /// Work of the environment on the robot so far, J, that part of it while its program controls the robot, and largest speed of a joint after the restart, rad/s.
    all_work_j: f64,
    work_j: f64,
    fastest_rad_per_s: f64,
    /// Energy that has flowed into the coupling at this port, J, and its last position and force.
    flowed_in_j: f64,
    port: Option<[Vec<f64>; 2]>,
}

impl<'a> Robot<'a> {
    fn new(experiment: &'a Experiment) -> Self {
        let arm = experiment.simulated_arm().unwrap_or_else(|error| panic!("{error}"));
        let sample = Sample::new(arm.capabilities());
        let stop: &AtomicBool = Box::leak(Box::default());
        let run = start(experiment, stop);
        let layout = Run::layouts(run.control(), None).swap_remove(TICK);
        Self {
            experiment,
            arm,
            sample,
            run: Some(run),
            stop,
            layout,
            all_work_j: 0.0,
            work_j: 0.0,
            fastest_rad_per_s: 0.0,
            flowed_in_j: 0.0,
            port: None,
        }
    }

    /// Values of a signal of the task `hand` in the last cycle; none while no program runs.
    fn hand(&self, quantity: &str) -> Option<Vec<f64>> {
        let columns = self.layout.columns(&signal_names::of("hand", quantity));
        let columns = columns.unwrap_or_else(|| panic!("no {quantity}"));
        self.run.as_ref().map(|run| run.row()[columns].to_vec())
    }

    /// Adds the work of the force of the last cycle, and returns the budget of a port that commands a force, J.
    fn budget_j(&mut self) -> f64 {
        let now = [DISPLACEMENT, PORT_FORCE].map(|what| self.hand(what).unwrap_or_default());
        if let Some([position, force]) = &self.port {
            let moved = now[0].iter().zip(position).map(|(now, before)| now - before);
            self.flowed_in_j -= moved.zip(force).map(|(moved, force)| moved * force).sum::<f64>();
        }
        self.port = Some(now);
        let sent_j = self.hand(PORT_ENERGY_IN).unwrap_or_default()[0];
        let columns = self.layout.columns("target.hand.energy_in").unwrap_or_else(|| panic!("no energy"));
        let received_j = self.run.as_ref().map_or(0.0, |run| run.row()[columns.start]);
        received_j + 0.5 * STORE_J + self.flowed_in_j - sent_j
    }

    /// Ends the program, which leaves the robot at rest. Its last packet is lost.
    fn end(&mut self) {
        let Some(mut run) = self.run.take() else { return };
        self.stop.store(true, Ordering::Relaxed);
        if let Some(command) = run.cycle(&self.sample) {
            self.arm.write(command).unwrap_or_else(|fault| panic!("{fault}"));
        }
        self.arm.stop();
        self.port = None;
    }

    fn read(&mut self, is_restarted: bool) {
        self.arm.read(&mut self.sample).unwrap_or_else(|fault| panic!("{fault}"));
        let truth = self.arm.layouts().truth;
        let works: Vec<_> = truth.signals.iter().filter(|signal| signal.name.ends_with(".work")).collect();
        let works: Vec<_> = works.iter().filter_map(|signal| truth.columns(&signal.name)).collect();
        let dq = truth.columns("dq").unwrap_or_else(|| panic!("no dq"));
        let is_controlled = self.hand(PORT_SESSION).is_some_and(|session| session[0].is_finite());
        let before_j = self.all_work_j;
        let (work_j, fastest) = (&mut self.all_work_j, &mut self.fastest_rad_per_s);
        self.arm.visit(&mut |row| {
            if let TruthRow::State { row, .. } = row {
                *work_j = works.iter().map(|range| row[range.start]).sum();
                if is_restarted {
                    *fastest = row[dq.clone()].iter().fold(*fastest, |most, dq| most.max(dq.abs()));
                }
            }
        });
        if is_controlled {
            self.work_j += self.all_work_j - before_j;
        }
    }
}

/// A program for the robot, before its first cycle.
fn start(experiment: &Experiment, stop: &'static AtomicBool) -> Run<'static> {
    stop.store(false, Ordering::Relaxed);
    let control = experiment.control_loop().unwrap_or_else(|error| panic!("{error}"));
    Run::new(control, 2.0 * END_S, Box::leak(Box::new(()))).with_stop_request(stop)
}

/// Disturbance of a robot during a run.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Interruption {
    None,
    Restart,
    Hold,
}

/// Measured values of a run.
#[derive(Debug)]
struct Outcome {
    extracted_j: f64,
    fastest_rad_per_s: f64,
    /// Largest step of the follower's reference, m, and of the leader's force, N, in a cycle after the restart.
    reference_step_m: f64,
    force_step_n: f64,
    /// Share of the cycles from the comparison's begin on in which both sides were closed.
    closed_share: f64,
    /// Displacement of both robots in the comparison, m, and their largest difference.
    moved_m: [f64; 2],
    difference_m: f64,
    /// Share of the cycles in the comparison in which the leader's force was reduced, and its largest force, N.
    limited_share: f64,
    force_n: f64,
    /// Force of the leader in the last cycle, N.
    last_force_n: f64,
    /// Budget of the leader before and after the interruption, and the least one from then on, J.
    budget_j: [f64; 3],
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// Runs the experiment. At `at_s` the program of the robot `restarted` ends, and a new one begins `down_s` later, or the
/// robot is held for this time.
fn run(
    experiment: &Scenario,
    (interruption, restarted): (Interruption, &str),
    [at_s, down_s]: [f64; 2],
    channel: ChannelParameters,
) -> Outcome {
    let coupling = &experiment.couplings[0];
    let ends = [coupling.leader.0, coupling.follower.0];
    let mut robots: Vec<Robot<'_>> =
        ends.iter().map(|&end| Robot::new(&experiment.members[end].experiment)).collect();
    let restarted = usize::from(restarted == "follower");
    let rates = [0, 1].map(|i| (1.0 / robots[i].arm.capabilities().period_s).round() as u32);
    let mut timeline = Timeline::new(&rates).unwrap_or_else(|error| panic!("{error}"));
    let copies: Vec<_> = CouplingKind::Teleoperation
        .packet_signals()
        .into_iter()
        .map(|(signal, input)| (signal_names::of("hand", signal), input))
        .collect();
    let copies: Vec<_> = copies.iter().map(|(signal, input)| (signal.as_str(), *input)).collect();
    let mut links: Vec<Link> = [0, 1]
        .map(|from| {
            let targets = robots[1 - from].run.as_ref().map(|run| run.control().targets());
            let targets = targets.unwrap_or_else(|| panic!("a program"));
            let parameters = ChannelParameters { seed: from as u64, ..channel };
            let to = (1 - from, &targets, "hand");
            Link::new(&timeline, (from, &robots[from].layout), to, &copies, parameters)
                .unwrap_or_else(|error| panic!("{error}"))
        })
        .into();
    let mut outcome = Outcome {
        extracted_j: 0.0,
        fastest_rad_per_s: 0.0,
        reference_step_m: 0.0,
        force_step_n: 0.0,
        closed_share: 0.0,
        moved_m: [0.0; 2],
        difference_m: 0.0,
        limited_share: 0.0,
        force_n: 0.0,
        last_force_n: 0.0,
        budget_j: [0.0, 0.0, f64::INFINITY],
    };
    // A held follower's reference is its position, but is not commanded.
    let begin_s = if interruption == Interruption::Hold { at_s + down_s } else { at_s };
    let (mut before, mut session) = ([None, None], [f64::NAN; 2]);
    let mut from: Option<[Vec<f64>; 2]> = None;
    let (mut cycles, mut closed, mut limited) = (0.0, 0.0, 0.0);
    loop {
        let next = timeline.next_cycle();
        let (i, time_s) = (next.robot, next.tick as f64 / timeline.ticks_per_s() as f64);
        if time_s > END_S {
            break;
        }
        let (is_restarted, is_down) = (time_s >= begin_s, (at_s..at_s + down_s).contains(&time_s));
        let steps_count = is_restarted && (interruption == Interruption::Hold || time_s < CLOSED_S);
        let robot = &mut robots[i];
        robot.read(is_restarted);
        let is_down = restarted == i && is_down;
        if interruption == Interruption::Restart && is_down {
            robot.end();
            continue;
        }
        if robot.run.is_none() {
            robot.run = Some(start(robot.experiment, robot.stop));
        }
        let Some(run) = &mut robot.run else { continue };
        let mut cause = None;
        for link in links.iter_mut().filter(|link| link.to() == i) {
            let of_link = link.deliver(next.tick, robot.sample.time_s, run.targets());
            cause = cause.or(of_link);
        }
        let is_held = interruption == Interruption::Hold && is_down;
        let cause = if is_held { Some(HoldCause::Requested) } else { cause };
        run.targets().hold_because(cause);
        let command = run.cycle(&robot.sample);
        command.map(|command| robot.arm.write(command)).transpose().unwrap_or_else(|fault| panic!("{fault}"));
        assert!(!run.is_stopped(), "{:?} at {time_s} s", run.outcome());
        for link in links.iter_mut().filter(|link| link.from() == i) {
            link.send(next.tick, run.row());
        }
        if i == 0 {
            let (budget_j, [before, after, least]) = (robots[0].budget_j(), &mut outcome.budget_j);
            match time_s {
                _ if time_s < at_s => *before = budget_j,
                COMPARED_S.. => *least = least.min(budget_j),
                _ => *after = budget_j,
            }
        }
        // What is commanded: the leader's force, and the follower's reference.
        let quantity = [PORT_FORCE, REFERENCE][i];
        let value = robots[i].hand(quantity).unwrap_or_default();
        let of = robots[i].hand(PORT_SESSION).map_or(f64::NAN, |session| session[0]);
        if let Some(before) = before[i].replace(value.clone()).filter(|_| steps_count && session[i] == of) {
            let step = [&mut outcome.force_step_n, &mut outcome.reference_step_m];
            let [force, reference] = step;
            let largest = if i == 0 { force } else { reference };
            *largest = largest.max(distance(&before, &value));
        }
        session[i] = of;
        outcome.extracted_j = outcome.extracted_j.max(-robots.iter().map(|robot| robot.work_j).sum::<f64>());
        if i == 1 && time_s >= COMPARED_S {
            let hands = [0, 1].map(|i| robots[i].hand(DISPLACEMENT).unwrap_or_default());
            let begin = from.get_or_insert_with(|| hands.clone());
            let [leader, follower]: [Vec<f64>; 2] =
                [0, 1].map(|i| hands[i].iter().zip(&begin[i]).map(|(now, begin)| now - begin).collect());
            outcome.moved_m = [distance(&hands[0], &begin[0]), distance(&hands[1], &begin[1])];
            outcome.difference_m = outcome.difference_m.max(distance(&leader, &follower));
            let is = |i: usize, what: &str| f64::from(u8::from(robots[i].hand(what) == Some(vec![1.0])));
            (cycles, closed) = (cycles + 1.0, closed + is(0, PORT_CLOSED) * is(1, PORT_CLOSED));
            limited += is(0, PORT_LIMITED);
            let force = robots[0].hand(PORT_FORCE).unwrap_or_default();
            outcome.last_force_n = distance(&force, &[0.0; 3]);
            outcome.force_n = outcome.force_n.max(outcome.last_force_n);
        }
    }
    outcome.fastest_rad_per_s = robots.iter().map(|robot| robot.fastest_rad_per_s).fold(0.0, f64::max);
    (outcome.closed_share, outcome.limited_share) = (closed / cycles, limited / cycles);
    outcome
}

/// Restart of a program away from the start, with downtimes that hold the other robot or not, before a motion and before a
/// contact. Compared: the energy that the pair gave away, and the store; the speeds of the joints and the steps of force and
/// reference, and those of operation; the motions of both robots afterwards, and the force in contact.
fn check(restarted: &str, cases: &[(&str, &str, &str, f64, f64)]) {
    for &(kind, reflect, table, down_s, delay_s) in cases {
        let jittery = ChannelParameters { delay_s, jitter_s: 0.01, loss: 0.05, ..Default::default() };
        let channel = if delay_s > 0.0 { jittery } else { ChannelParameters::default() };
        let name = format!("{restarted} restarts for {down_s} s, {kind}, {reflect}, {table}");
        let experiment = teleoperation(&[
            MOVED,
            table,
            &format!("robots.leader.backend=\"{kind}\""),
            &format!("robots.follower.backend=\"{kind}\""),
            &format!("couplings.hands.teleoperation.reflect=\"{reflect}\""),
        ]);
        let channel = ChannelParameters { hold_after_s: Some(0.5), reordering: true, ..channel };
        let outcome = run(&experiment, (Interruption::Restart, restarted), [RESTART_S, down_s], channel);
        assert!(outcome.extracted_j <= STORE_J, "{name}: {outcome:?}");
        assert!(outcome.fastest_rad_per_s < CALM_RAD_PER_S, "{name}: {outcome:?}");
        assert!(outcome.reference_step_m < REFERENCE_M_PER_S * PERIOD_S, "{name}: {outcome:?}");
        assert!(outcome.force_step_n < LEADER_STEP_N, "{name}: {outcome:?}");
        assert_eq!(outcome.closed_share, 1.0, "{name}: {outcome:?}");
        if table == NO_TABLE {
            assert!(outcome.difference_m < TRACKING_M, "{name}: {outcome:?}");
            assert!(outcome.moved_m.iter().all(|moved| *moved > MOVED_M), "{name}: {outcome:?}");
        } else {
            assert!(outcome.force_n > CONTACT_N, "{name}: {outcome:?}");
        }
    }
}

#[test]
fn coupling_closes_again_after_a_restart_of_the_leader() {
    check(
        "leader",
        &[
            ("position", "measured-force", NO_TABLE, 0.02, 0.0),
            ("position", "measured-force", NEAR_TABLE, 0.6, 0.03),
            ("velocity", "position", NEAR_TABLE, 0.02, 0.0),
            ("position", "controller-force", NEAR_TABLE, 0.02, 0.0),
        ],
    );
}

#[test]
fn coupling_closes_again_after_a_restart_of_the_follower() {
    check(
        "follower",
        &[
            ("position", "measured-force", NO_TABLE, 0.02, 0.0),
            ("velocity", "measured-force", NEAR_TABLE, 0.02, 0.03),
            ("position", "position", NO_TABLE, 0.6, 0.03),
        ],
    );
}

/// Operator who pulls at the leader with 10 N while its program starts: his hand moves on by 20 mm as it ends.
const PULLED: &str = "leader.environment.operator.spring.motion.scripted={ reach = [{ at_s = 0.3, duration_s = 0.5, \
                      by_m = [0.0, 0.0, -0.02] }, { at_s = 1.2, duration_s = 0.05, by_m = [0.0, 0.0, -0.02] }, \
                      { at_s = 2.0, duration_s = 0.7, by_m = [0.0, 0.0, 0.02] }] }";
/// Operator who presses on the table with the follower while its program starts.
const PRESSED: &str = "leader.environment.operator.spring.motion.scripted={ reach = [{ at_s = 0.3, duration_s = 0.5, \
                       by_m = [0.0, 0.0, -0.06] }, { at_s = 2.0, duration_s = 0.7, by_m = [0.0, 0.0, 0.06] }] }";
/// Energy that three starts of programs may give away, J: two, and a restart.
const OF_THREE_STARTS_J: f64 = 1.5 * STORE_J;

/// Force of the leader while nothing touches, N: noise of the follower's sensor, and the damping that it causes.
const FREE_N: f64 = 1.0;

/// Setting that states the bias of a robot's force sensor: its mean reading at rest, when nothing touches.
fn stated_bias(experiment: &Scenario, name: &str) -> String {
    const READINGS: u32 = 150;
    let member = experiment.members.iter().find(|member| member.name == name);
    let mut robot = Robot::new(&member.unwrap_or_else(|| panic!("no {name}")).experiment);
    let mut bias = [0.0; 6];
    for _ in 0..READINGS {
        robot.read(false);
        let readings = bias.iter_mut().zip(&robot.sample.wrenches[0]);
        readings.for_each(|(mean, reading)| *mean += reading / f64::from(READINGS));
    }
    let [force, moment] = [&bias[..3], &bias[3..]];
    format!("{name}.robot.force_sensor.wrist.bias={{ force_n = {force:?}, moment_nm = {moment:?} }}")
}

/// Restart of a program while a force acts at its sensor, whose bias is stated. Compared: the energy that the pair gave away, and
/// the store of three starts; the leader's force at the end, when nothing touches, and zero; speeds, and those of operation.
#[test]
fn stated_bias_allows_a_restart_under_load() {
    for (restarted, motion, table, down_s, delay_s) in [
        ("leader", PULLED, NO_TABLE, 0.02, 0.0),
        ("leader", PULLED, NEAR_TABLE, 0.6, 0.03),
        ("follower", PRESSED, NEAR_TABLE, 0.02, 0.0),
        ("follower", PRESSED, NEAR_TABLE, 0.6, 0.03),
    ] {
        let settings = [motion, table];
        let bias = stated_bias(&teleoperation(&settings), restarted);
        let experiment = teleoperation(&[&settings[..], &[&bias]].concat());
        let channel = ChannelParameters { delay_s, hold_after_s: Some(0.5), ..Default::default() };
        let outcome = run(&experiment, (Interruption::Restart, restarted), [RESTART_S, down_s], channel);
        let name = format!("{restarted} restarts for {down_s} s under load, {table}: {outcome:?}");
        assert!(outcome.extracted_j <= OF_THREE_STARTS_J, "{name}");
        assert!(outcome.fastest_rad_per_s < CALM_RAD_PER_S, "{name}");
        assert!(outcome.last_force_n < FREE_N, "{name}");
        assert_eq!(outcome.closed_share, 1.0, "{name}");
    }
}

/// Operator who presses on the table, lets go and presses again after the hold.
const PRESSES: &str = "leader.environment.operator.spring.motion.scripted={ reach = [{ at_s = 0.2, duration_s = 0.3, \
                       by_m = [0.0, 0.0, -0.06] }, { at_s = 2.0, duration_s = 0.3, by_m = [0.0, 0.0, 0.06] }, { at_s = 2.5, \
                       duration_s = 0.3, by_m = [0.0, 0.0, -0.06] }] }";
/// Damping of the leader that does not pay for the delay, so that the store is needed.
const LITTLE_DAMPING: &str = "couplings.hands.teleoperation.delay_damping_ratio=0.5";
/// Time and duration of the hold, s: the follower is in contact.
const HOLD_S: [f64; 2] = [1.4, 0.3];

/// Hold of either robot in contact, when the leader's half of the store is partly used. Compared with the run without a hold:
/// the leader's budget when it begins and after it, the time in which the leader is braked afterwards, and the energy given away;
/// with operation, the speeds and steps after it.
#[test]
fn energies_that_are_kept_over_a_hold_cost_nothing() {
    let wall = "follower.environment.table.wall.stiffness_n_per_m=1000.0";
    let experiment = teleoperation(&[PRESSES, NEAR_TABLE, LITTLE_DAMPING, wall]);
    let channel =
        ChannelParameters { delay_s: 0.1, jitter_s: 0.01, hold_after_s: Some(0.5), ..Default::default() };
    let without = run(&experiment, (Interruption::None, "leader"), HOLD_S, channel);
    for held in ["leader", "follower"] {
        let outcome = run(&experiment, (Interruption::Hold, held), HOLD_S, channel);
        let name = format!("{held} held: {outcome:?}, without a hold {without:?}");
        assert!(without.budget_j[0] < 0.4 * STORE_J, "{name}");
        assert!(outcome.budget_j[1] >= without.budget_j[1], "{name}");
        assert!(outcome.limited_share <= without.limited_share, "{name}");
        assert!(outcome.extracted_j <= STORE_J, "{name}");
        assert!(outcome.fastest_rad_per_s < CALM_RAD_PER_S, "{name}");
        assert!(outcome.reference_step_m < REFERENCE_M_PER_S * PERIOD_S, "{name}");
        assert!(outcome.force_step_n < LEADER_STEP_N, "{name}");
        assert!(outcome.force_n > 10.0, "{name}");
    }
}
