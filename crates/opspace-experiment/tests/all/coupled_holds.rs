//! Holds of coupled robots: because of each other, and because nothing is heard.

use crate::coupled_common::{
    CALM_RAD_PER_S, CoupledRun, LEADER_STEP_N, NO_TABLE, PERIOD_S, REFERENCE_M_PER_S, STORE_J, largest_step,
    run, teleoperation,
};
use opspace_backend::signal_names::{PORT_FORCE, REFERENCE};
use opspace_loop::Phase;

/// Largest step of the force that is commanded to the follower, N: its damper of 60 Ns/m, when the coupling closes on a leader
/// that moves. The spring of 3 kN/m to where the leader has moved in the meantime would be 120 N.
const FOLLOWER_STEP_N: f64 = 60.0 * REFERENCE_M_PER_S + LEADER_STEP_N;

/// Intervals in which a robot was in a phase, s.
fn intervals(run: &CoupledRun, robot: &str, phase: Phase) -> Vec<(f64, f64)> {
    let mut found: Vec<(f64, f64)> = Vec::new();
    for (time_s, row) in run.signal(robot, "tick", "phase", 0.0, f64::INFINITY) {
        if row[0] != phase.code() {
            continue;
        }
        match found.last_mut().filter(|(_, until_s)| time_s - *until_s < 1.5 * PERIOD_S) {
            Some((_, until_s)) => *until_s = time_s,
            None => found.push((time_s, time_s)),
        }
    }
    found
}

/// Dropout of either robot's bus, for every kind of robot, short and long. Compared: the holds of both, and the dropout; the
/// steps of reference and force after the resume, and those of a coupling that continues from where the robots are; the
/// energy that the pair gave away, and the store.
#[test]
fn dropout_of_a_robot_holds_the_other_and_both_resume() {
    for (dropped, other, backend, reflect, duration_s) in [
        ("follower", "leader", "position", "measured-force", 0.2),
        ("leader", "follower", "position", "position", 0.2),
        ("follower", "leader", "torque", "measured-force", 0.1),
        ("leader", "follower", "torque", "controller-force", 0.1),
        ("follower", "leader", "velocity", "position", 0.2),
        ("leader", "follower", "position", "measured-force", 0.6),
    ] {
        let name = format!("{dropped} drops out for {duration_s} s, {backend}, {reflect}");
        let run = run(&teleoperation(&[
            NO_TABLE,
            &format!("robots.leader.backend=\"{backend}\""),
            &format!("robots.follower.backend=\"{backend}\""),
            &format!("couplings.hands.teleoperation.reflect=\"{reflect}\""),
            &format!("{dropped}.robot.simulated.bus.dropouts=[{{ at_s = 0.5, duration_s = {duration_s} }}]"),
        ]));
        let faults = run.summary.robots.values().filter_map(|robot| robot.faulted.as_ref());
        assert_eq!(faults.count(), 0, "{name}: {:?}", run.summary.failures());
        let holds = &run.summary.holds;
        assert!(holds.iter().all(|hold| hold.robot == other), "{name}: {holds:?}");
        let last = holds.last().unwrap_or_else(|| panic!("{name}: no hold"));
        assert_eq!(last.reason, format!("{dropped} is held or stopped"), "{name}");
        let ended_s = 0.5 + duration_s;
        assert!((last.from_s - ended_s).abs() < 2.5 * PERIOD_S, "{name}: {holds:?}");
        let silent = holds.iter().filter(|hold| hold.reason == format!("nothing arrives from {dropped}"));
        assert_eq!(silent.count(), usize::from(duration_s > 0.5), "{name}: {holds:?}");
        // Both are held once, and resume.
        for robot in [dropped, other] {
            let held = intervals(&run, robot, Phase::Held);
            assert_eq!(held.len(), 1, "{name}: {robot} was held in {held:?}");
            assert!(held[0].1 < ended_s + 0.4, "{name}: {robot} was held in {held:?}");
            assert_eq!(intervals(&run, robot, Phase::Resuming).len(), 1, "{name}: {robot}");
            let resumed_s = held[0].1 + 0.5 * PERIOD_S;
            let step = largest_step(&run.hand(robot, PORT_FORCE, resumed_s, 2.0));
            let bound = if robot == "leader" { LEADER_STEP_N } else { FOLLOWER_STEP_N };
            assert!(step < bound, "{name}: {robot} {step} N in a cycle");
            let speeds = run.signal(robot, "truth", "dq", resumed_s, 2.0);
            let speed = speeds.iter().flat_map(|(_, dq)| dq).fold(0.0, |most: f64, dq| most.max(dq.abs()));
            assert!(speed < CALM_RAD_PER_S, "{name}: {robot} {speed} rad/s");
            let reference = largest_step(&run.hand("follower", REFERENCE, resumed_s, 2.0));
            assert!(reference < REFERENCE_M_PER_S * PERIOD_S, "{name}: {reference} m in a cycle");
        }
        let extracted = run.summary.couplings["hands"].energy_extracted_j.unwrap_or(f64::NAN);
        assert!(extracted <= STORE_J, "{name}: {extracted} J");
    }
}

/// A servo whose kp is 30 % higher than assumed, which the torque watchdog stops, and a bus that is dead for too long.
#[test]
fn fault_of_a_robot_holds_the_other_until_the_end() {
    let unstable =
        ["robots.follower.transformer=\"paper\"", "follower.robot.simulated.true_over_nominal.kp=1.3"];
    let dead = ["follower.robot.simulated.bus.dropouts=[{ at_s = 0.3, duration_s = 1.2 }]"];
    for settings in [&unstable[..], &dead] {
        let run = run(&teleoperation(&[&[NO_TABLE], settings].concat()));
        assert!(run.summary.has_failed());
        let follower = &run.summary.robots["follower"];
        let fault_s = follower.fault_time_s.unwrap_or_else(|| panic!("{settings:?}: no fault"));
        let leader = &run.summary.robots["leader"];
        assert_eq!(leader.faulted, None, "{settings:?}");
        let last = run.summary.holds.iter().rfind(|hold| hold.robot == "leader");
        let last = last.unwrap_or_else(|| panic!("{settings:?}: the leader was not held"));
        assert_eq!(
            (last.until_s, last.reason.as_str()),
            (None, "follower is held or stopped"),
            "{settings:?}"
        );
        assert!((last.from_s - fault_s).abs() < 2.5 * PERIOD_S, "{settings:?}: {last:?} after {fault_s} s");
        let phases = run.signal("leader", "tick", "phase", fault_s + 3.0 * PERIOD_S, 2.0);
        assert!(!phases.is_empty() && phases.iter().all(|(_, p)| p[0] == Phase::Held.code()), "{settings:?}");
    }
}

/// A channel that loses everything. Compared: the beginning of the holds, and `hold_after_s` after the first cycle, which is
/// 0.2 s before control.
#[test]
fn silence_holds_both_robots() {
    let lost = ["channels.net={ loss = 1.0, hold_after_s = 0.4 }", "couplings.hands.channel=\"net\""];
    let run = run(&teleoperation(&[&[NO_TABLE, "duration_s=1.0"], &lost[..]].concat()));
    let mut holds: Vec<_> = run.summary.holds.iter().collect();
    holds.sort_by_key(|hold| hold.robot.clone());
    let named: Vec<_> = holds.iter().map(|hold| (hold.robot.as_str(), hold.reason.as_str())).collect();
    let expected = [("follower", "nothing arrives from leader"), ("leader", "nothing arrives from follower")];
    assert_eq!(named, expected);
    for hold in holds {
        assert!((hold.from_s - 0.2).abs() < 2.5 * PERIOD_S && hold.until_s.is_none(), "{hold:?}");
    }
}
