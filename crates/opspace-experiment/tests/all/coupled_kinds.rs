//! Every quantity that a teleoperation reflects, on every kind of robot.

use crate::coupled_common::{NEAR_TABLE, NO_TABLE, teleoperation};
use opspace_experiment::Progress;

/// Runs the experiment in free motion and against the table. Checks that no robot is stopped, that the metrics are finite, and
/// that the pair gives no more energy away than the store, 0.05 J.
fn check(settings: &[&str], name: &str) {
    for table in [NO_TABLE, NEAR_TABLE] {
        let experiment = teleoperation(&[&[table, "duration_s=1.6"], settings].concat());
        let summary = experiment.run_without_logs(&Progress::default());
        let summary = summary.unwrap_or_else(|error| panic!("{name}: {error}"));
        assert!(!summary.has_failed() && summary.holds.is_empty(), "{name}: {:?}", summary.failures());
        let metrics = &summary.couplings["hands"];
        let numbers = [metrics.tracking_rms_m, metrics.drift_m, metrics.hand_force_rms_n];
        for number in numbers {
            assert!(number.is_some_and(|number| number.is_finite() && number < 100.0), "{name}: {metrics:?}");
        }
        let extracted = metrics.energy_extracted_j.unwrap_or(f64::NAN);
        assert!(extracted <= 0.05, "{name}, {table}: {extracted} J");
    }
}

/// Runs a law on every pair of kinds of robots.
fn check_on_every_robot(reflect: &str, channel: &[&str]) {
    let law = format!("couplings.hands.teleoperation.reflect={reflect}");
    for leader in ["position", "velocity", "torque"] {
        for follower in ["position", "velocity", "torque"] {
            let kinds = [
                format!("robots.leader.backend=\"{leader}\""),
                format!("robots.follower.backend=\"{follower}\""),
            ];
            let settings = [&[law.as_str(), &kinds[0], &kinds[1]], channel].concat();
            check(&settings, &format!("{leader} leader, {follower} follower, {reflect}"));
        }
    }
}

#[test]
fn position_is_reflected_on_every_robot() {
    check_on_every_robot("\"position\"", &[]);
}

#[test]
fn controller_force_is_reflected_on_every_robot() {
    check_on_every_robot("\"controller-force\"", &[]);
}

#[test]
fn measured_force_is_reflected_on_every_robot() {
    check_on_every_robot("\"measured-force\"", &[]);
}

/// Constant delay, and an impedance of five times the damping of the follower's spring: with three times, the coupling is not
/// stable.
#[test]
fn waves_are_reflected_on_every_robot() {
    let channel = ["channels.net={ delay_s = 0.02 }", "couplings.hands.channel=\"net\""];
    check_on_every_robot("{ waves = { impedance_ns_per_m = 40.0 } }", &channel);
}

/// The follower's force is estimated from the currents of its motors.
#[test]
fn estimated_force_is_reflected() {
    let sensor = [
        "follower.robot.estimated_force.contact={ frame = \"hand\" }",
        "follower.task.hand.coupled.sensor=\"contact\"",
    ];
    check(&sensor, "estimated force");
}
