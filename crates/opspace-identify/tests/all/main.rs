//! Compared: 95 % intervals of identifications of simulated single joints through the library, and the parameters of the
//! simulation. The example `random-joints` does the same with any number of joints and any seed.

#[path = "../../examples/random-joints/cases.rs"]
mod cases;
#[expect(dead_code, reason = "the example uses all of it")]
#[path = "../../examples/random-joints/tally.rs"]
mod tally;
mod wrapped;

use cases::{Case, Deceit, Kind};
use std::thread;
use tally::Outcome;

/// Seed with which nothing was tuned.
const SEED: u64 = 77;

fn outcomes(numbers: std::ops::Range<usize>, kind: Kind) -> Vec<Outcome> {
    let one = |number: usize| {
        let case = Case::new(number, SEED, kind);
        Outcome::new(number, &case, &case.identify())
    };
    thread::scope(|scope| {
        let running: Vec<_> = numbers.map(|number| scope.spawn(move || one(number))).collect();
        running.into_iter().map(|thread| thread.join().expect("a thread")).collect()
    })
}

fn print(all: &[Outcome]) -> String {
    all.iter().map(|outcome| format!("{outcome}\n")).collect()
}

#[test]
fn intervals_of_ten_random_joints_hold_the_truth() {
    let all = outcomes(0..10, Kind::default());
    let estimates = || all.iter().flat_map(|outcome| &outcome.estimates);
    let given = estimates().filter(|e| e.interval.is_some()).count();
    let held = estimates().filter(|e| e.holds() == Some(true)).count();
    assert!(held as f64 >= 0.9 * given as f64, "{held} of {given}\n{}", print(&all));
    assert!(given as f64 >= 0.95 * estimates().count() as f64, "{given}\n{}", print(&all));
    for (index, most) in [(0, 0.001), (1, 0.005), (2, 0.1), (5, 0.1), (6, 0.1)] {
        let mut widths: Vec<f64> =
            all.iter().filter_map(|outcome| outcome.estimates[index].half_width()).collect();
        widths.sort_by(f64::total_cmp);
        let median = widths[widths.len() / 2];
        assert!(median < most, "{}: {median}\n{}", tally::NAMES[index], print(&all));
    }
}

#[test]
fn wrong_scale_of_torque_or_inertia_is_refused_or_doubted() {
    let scale = |current_scale| Deceit { current_scale: Some(current_scale), ..Deceit::default() };
    let inertia = Deceit { inertia: Some(0.5), ..Deceit::default() };
    for deceit in [scale(1.25), scale(0.75), inertia] {
        // The fourth joint has an elastic gear.
        let all = outcomes(2..4, Kind { deceit, ..Kind::default() });
        for outcome in &all {
            let is_marked = outcome.refused.is_some() || !outcome.doubts.is_empty();
            assert!(is_marked, "{deceit:?}\n{}", print(&all));
        }
    }
}

#[test]
fn feed_forward_and_setpoint_filter_are_told_apart() {
    use opspace_identify::interval::SetpointFilterModel;
    let identify = |deceit: Deceit| {
        let found = Case::new(1, SEED, Kind { deceit, ..Kind::default() }).identify();
        found.servo.expect("a servo")
    };
    let direct = identify(Deceit::default());
    assert_eq!(direct.velocity_feed_forward, 0.0);
    assert_eq!(direct.setpoint_filter, SetpointFilterModel::None);
    let forward = identify(Deceit { feed_forward: Some(0.7), ..Deceit::default() });
    assert!((forward.velocity_feed_forward - 0.7).abs() < 0.05, "{forward:?}");
    assert_eq!(forward.setpoint_filter, SetpointFilterModel::None);
    let filtered = identify(Deceit { setpoint_filter_hz: Some(20.0), ..Deceit::default() });
    assert_eq!(filtered.velocity_feed_forward, 0.0);
    match filtered.setpoint_filter {
        SetpointFilterModel::FirstOrder { cutoff_hz } => assert!((cutoff_hz / 20.0 - 1.0).abs() < 0.05),
        other => panic!("{other:?}"),
    }
}

/// Compared, of joints without friction and without motor current: the viscous friction, and that which is declared, which
/// no motion distinguishes from kv; the error of kp, and the bound of an identification with friction.
#[test]
fn joints_without_friction_get_no_viscous_friction() {
    const KP: f64 = 0.005;
    let identify = |number: usize, viscous: f64| {
        let mut case = Case::new(number, SEED, Kind { without_current: true, ..Kind::default() });
        let truth = &mut case.truth;
        (truth.coulomb, truth.static_friction, truth.viscous) = (0.0, 0.0, viscous * truth.viscous);
        let found = case.identify();
        (case.truth, found)
    };
    thread::scope(|scope| {
        for (number, viscous) in [(0, 0.0), (1, 0.0), (2, 0.0), (4, 1.0)] {
            scope.spawn(move || {
                let (truth, found) = identify(number, viscous);
                assert_eq!(found.refused, None, "{number}");
                let servo = found.servo.expect("a servo");
                let friction = servo.friction.expect("runs at several speeds");
                assert_eq!(friction.viscous, truth.viscous, "{number}: {friction:?}");
                assert!(friction.coulomb < 0.01 * truth.torque_limit, "{number}: {friction:?}");
                assert!((servo.kp / truth.kp - 1.0).abs() < KP, "{number}: {} of {}", servo.kp, truth.kp);
            });
        }
    });
}
