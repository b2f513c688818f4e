//! Retraction of the arm after a collision.

#![expect(clippy::print_stdout, reason = "figures of the long version")]

use crate::collision_cases::{cases, collision, load, norm};
use crate::common::{self, Run};
use opspace_backend::CommandKind;
use opspace_backend::signal_names::{COLLISION_DETECTED, DQ, Q, TICK_CHANNEL, TORQUE_DESIRED, TRUTH_CHANNEL};
use opspace_experiment::{ControllerKind, RunOptions};
use opspace_loop::{Fault, RunOutcome};

/// First number of the collisions: those before are of the tests of the detection.
const FIRST: u64 = 5000;

/// Time after the detection at which the arm must be at rest, s: the duration of the retraction, and 0.1 s.
const AT_REST_S: f64 = 0.7;

const ROBOTS: [(CommandKind, ControllerKind); 4] = [
    (CommandKind::Position, ControllerKind::Osc),
    (CommandKind::Torque, ControllerKind::Osc),
    (CommandKind::Velocity, ControllerKind::Osc),
    (CommandKind::Position, ControllerKind::Ik),
];

/// Figures of a retraction.
#[derive(Clone, Copy, Debug, Default)]
struct Figures {
    /// Largest force, N.
    peak_n: f64,
    /// Time from the detection to the end of the contact, s.
    left_s: f64,
    /// Number of contacts.
    contacts: usize,
    /// Fastest joint once the arm must be at rest, rad/s.
    speed_at_rest: f64,
    /// Least distance of the joint that moved farthest, rad.
    moved_rad: f64,
    /// Fastest joint after the detection, rad/s.
    speed: f64,
    /// Largest desired torque relative to the limit of the joint.
    torque_of_limit: f64,
    /// Least distance from a position limit, rad.
    to_limit_rad: f64,
}

impl Figures {
    /// Returns the worst of both.
    fn worst(self, other: Self) -> Self {
        Self {
            peak_n: self.peak_n.max(other.peak_n),
            left_s: self.left_s.max(other.left_s),
            contacts: self.contacts.max(other.contacts),
            speed_at_rest: self.speed_at_rest.max(other.speed_at_rest),
            moved_rad: self.moved_rad.min(other.moved_rad),
            speed: self.speed.max(other.speed),
            torque_of_limit: self.torque_of_limit.max(other.torque_of_limit),
            to_limit_rad: self.to_limit_rad.min(other.to_limit_rad),
        }
    }
}

/// Returns the figures of a run; `None` without contact.
fn figures(run: &Run) -> Option<Figures> {
    let truth = run.channel(TRUTH_CHANNEL);
    let forces = run.signal(TRUTH_CHANNEL, "box.force");
    let (q, dq) = (run.signal(TRUTH_CHANNEL, Q), run.signal(TRUTH_CHANNEL, DQ));
    let (detected, desired) =
        (run.signal(TICK_CHANNEL, COLLISION_DETECTED), run.signal(TICK_CHANNEL, TORQUE_DESIRED));
    let force = |k: usize| norm(forces.row(k));
    let touches = |k: usize| force(k) > 0.0;
    let largest = |values: &[f64]| values.iter().fold(0.0, |largest, x| f64::max(largest, x.abs()));
    let rows = 0..truth.time_s.len();
    let last = rows.clone().rev().find(|k| touches(*k))?;
    let ticks = &run.channel(TICK_CHANNEL).time_s;
    let tick = (0..ticks.len()).find(|k| detected.row(*k)[0] == 1.0).expect("a detection");
    let found = rows.clone().find(|k| truth.time_s[*k] >= ticks[tick])?;
    let limits = common::robot(&[]).model;
    let limits: Vec<_> = limits.joints().iter().map(|joint| joint.limits).collect();
    let to_limit = |k: usize| {
        let pairs = q.row(k).iter().zip(&limits);
        pairs.map(|(q, limits)| (q - limits.lower).min(limits.upper - q)).fold(f64::INFINITY, f64::min)
    };
    let torque_of_limit = |k: usize| {
        let pairs = desired.row(k).iter().zip(&limits).filter(|(torque, _)| torque.is_finite());
        pairs.map(|(torque, limits)| torque.abs() / limits.effort).fold(0.0, f64::max)
    };
    let moved: Vec<f64> = q.row(rows.end - 1).iter().zip(q.row(found)).map(|(end, at)| end - at).collect();
    let is_late = |k: &usize| truth.time_s[*k] > ticks[tick] + AT_REST_S;
    assert!(rows.clone().any(|k| is_late(&k)), "rows after the retraction");
    Some(Figures {
        peak_n: rows.clone().map(force).fold(0.0, f64::max),
        left_s: truth.time_s[last] - ticks[tick],
        contacts: rows.clone().skip(1).filter(|k| touches(*k) && !touches(k - 1)).count(),
        speed_at_rest: rows.clone().filter(is_late).map(|k| largest(dq.row(k))).fold(0.0, f64::max),
        moved_rad: largest(&moved),
        speed: rows.clone().skip(found).map(|k| largest(dq.row(k))).fold(0.0, f64::max),
        torque_of_limit: (tick..ticks.len()).map(torque_of_limit).fold(0.0, f64::max),
        to_limit_rad: rows.skip(found).map(to_limit).fold(f64::INFINITY, f64::min),
    })
}

/// Checks that the arm leaves the contact, does not touch again, and is at rest 0.1 s after the retraction, within its limits:
/// random postures and directions, soft and stiff walls, friction 30 % off, all kinds of robots. With `OPSPACE_RETRACTIONS=100`
/// and `--nocapture` it prints the figures of 100 for each robot, profile and wall.
#[test]
fn retraction_ends_the_contact() {
    let each = cases("OPSPACE_RETRACTIONS", 1);
    let (mut number, mut bad) = (FIRST, 0);
    for profile in ["a-med", "b-soft"] {
        for (backend, controller) in ROBOTS {
            for stiffness in [3e3, 1e4, 1e5] {
                let (mut worst, mut count, mut failed) = (
                    Figures { moved_rad: f64::INFINITY, to_limit_rad: f64::INFINITY, ..Figures::default() },
                    0,
                    Vec::new(),
                );
                for _ in 0..each {
                    number += 1;
                    let mut settings = collision(number, stiffness);
                    let friction = [0.7, 1.0, 1.3][number as usize % 3];
                    settings.push(format!("robot.simulated.true_over_nominal={{friction={friction}}}"));
                    let options = RunOptions {
                        backend,
                        controller,
                        duration_s: Some(2.0),
                        profile: Some(profile.to_owned()),
                        ..RunOptions::default()
                    };
                    let reaction = "{retract={}}";
                    let Some(experiment) = load("cartesian-tracking", reaction, &settings, options) else {
                        continue;
                    };
                    let run = common::run(&experiment);
                    if !matches!(run.ending, RunOutcome::Faulted { fault: Fault::Collision { .. }, .. }) {
                        println!(
                            "  {profile}, {backend:?}, {controller:?}, {stiffness} N/m, case {number}: {:?}",
                            run.ending
                        );
                        continue;
                    }
                    let Some(figures) = figures(&run) else {
                        panic!("case {number}: detected without contact")
                    };
                    count += 1;
                    worst = worst.worst(figures);
                    let is_good = figures.contacts == 1
                        && figures.speed_at_rest < 0.01
                        && figures.left_s < 0.4
                        && figures.moved_rad > 0.05
                        && figures.to_limit_rad > 0.0
                        && figures.torque_of_limit <= 1.0;
                    if !is_good {
                        failed.push((number, figures));
                    }
                }
                println!(
                    "{profile}, {backend:?}, {controller:?}, {stiffness} N/m: {count} of {each}, worst {worst:.3?}"
                );
                if let Some(first) = failed.first() {
                    println!("  {} failed, first {first:.3?}", failed.len());
                }
                bad += failed.len();
            }
        }
    }
    assert_eq!(bad, 0, "retractions that failed");
}
