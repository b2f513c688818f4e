//! Detection of collisions from motor current.

#![expect(clippy::print_stdout, reason = "figures of the long versions")]

use crate::collision_cases::{cases, collision, load, noise, norm};
use crate::common;
use opspace_backend::signal_names::{COLLISION_DETECTED, TICK_CHANNEL, TRUTH_CHANNEL};
use opspace_experiment::{Experiment, RunOptions};

fn options(profile: &str, duration_s: f64) -> RunOptions {
    RunOptions { duration_s: Some(duration_s), profile: Some(profile.to_owned()), ..RunOptions::default() }
}

/// Time from the first contact to the detection, s, and the largest force until then, N. The time is NaN without detection;
/// `None` if there was no contact.
fn detection(experiment: &Experiment) -> Option<(f64, f64)> {
    let run = common::run(experiment);
    let truth = run.channel(TRUTH_CHANNEL);
    let forces = run.signal(TRUTH_CHANNEL, "box.force");
    let force = |k: usize| norm(forces.row(k));
    let contact = (0..truth.time_s.len()).find(|k| force(*k) > 0.1)?;
    let detected = run.signal(TICK_CHANNEL, COLLISION_DETECTED);
    let ticks = &run.channel(TICK_CHANNEL).time_s;
    let at = (0..ticks.len()).find(|k| detected.row(*k)[0] == 1.0);
    let at_s = at.map_or(f64::NAN, |k| ticks[k]);
    let until = (contact..truth.time_s.len()).take_while(|k| truth.time_s[*k] <= at_s);
    Some((at_s - truth.time_s[contact], until.map(force).fold(0.0, f64::max)))
}

/// Checks that collisions of the hand at 0.25 m/s with 10 kN/m are detected within 8 ms with the nominal arm, and within 30 ms or below
/// 20 N with friction 30 % off, a load and four times the noise. With `OPSPACE_COLLISIONS=100` and `--nocapture` it prints the figures of 100.
#[test]
fn collisions_are_detected_within_8_ms() {
    for (profile, is_nominal) in [("a-med", true), ("a-med", false), ("b-soft", true), ("b-soft", false)] {
        let (mut times, mut early, mut late) = (Vec::new(), Vec::new(), Vec::new());
        for number in 0..cases("OPSPACE_COLLISIONS", 4) {
            let mut settings = collision(number, 1e4);
            if !is_nominal {
                let friction = [0.7, 1.3][number as usize % 2];
                settings.push(format!("robot.simulated.true_over_nominal={{friction={friction}}}"));
                settings.push("robot.simulated.payload.load={frame=\"hand\",mass_kg=0.1}".to_owned());
                settings.extend(noise());
            }
            let experiment = load("cartesian-tracking", "\"stop\"", &settings, options(profile, 1.2));
            let Some((after_s, force)) = experiment.as_ref().and_then(detection) else { continue };
            // Of a wrong model: only what is pressed on.
            let (limit_s, limit_n) = if is_nominal { (0.0081, 0.0) } else { (0.0301, 20.0) };
            if after_s < 0.0 {
                early.push(number);
            } else if after_s.is_nan() || (after_s > limit_s && force > limit_n) {
                late.push((number, after_s, force));
            }
            times.push(after_s);
        }
        times.sort_by(f64::total_cmp);
        let quick = times.iter().filter(|after_s| **after_s <= 0.0081).count();
        println!(
            "{profile}, nominal {is_nominal}: {} collisions, {quick} within 8 ms, median {:.3} s, slowest {:.3} s; early {early:?}, late {late:?}",
            times.len(),
            times[times.len() / 2],
            times[times.len() - 1]
        );
        assert!(early.is_empty() && late.is_empty(), "{profile}: early {early:?}, late {late:?}");
        assert!(times.len() > 2, "{} collisions", times.len());
    }
}

/// Checks that an arm that reacts by compliance does not press on: the force of the contact ends, and the run does not.
#[test]
fn compliant_reaction_ends_the_contact() {
    let experiment = load("cartesian-tracking", "\"compliant\"", &collision(1, 1e4), options("a-med", 2.0))
        .expect("a case");
    let run = common::run(&experiment);
    let forces = run.signal(TRUTH_CHANNEL, "box.force");
    let last = run.channel(TRUTH_CHANNEL).time_s.len() - 1;
    let force = |k: usize| norm(forces.row(k));
    assert!((0..last).any(|k| force(k) > 5.0), "it collided");
    assert!(force(last) < 6.0, "{} N at the end", force(last));
    let ticks = &run.channel(TICK_CHANNEL).time_s;
    assert!(ticks[ticks.len() - 1] - ticks[0] > 1.9, "the run goes on");
}
