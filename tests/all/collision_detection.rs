//! Detection of collisions from motor current.

#![expect(clippy::print_stdout, reason = "figures of the long versions")]

use crate::common;
use opspace_backend::signal_names::{
    COLLISION_DETECTED, COLLISION_THRESHOLD, COLLISION_TORQUE, TICK_CHANNEL, TRUTH_CHANNEL,
};
use opspace_experiment::{Experiment, Files, RunOptions};
use std::f64::consts::TAU;
use std::path::Path;

/// Numbers from 0 to 1 that look random, the same in each run.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }
}

/// Number of cases: `name` of the environment, or `short`.
fn cases(name: &str, short: u64) -> u64 {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(short)
}

fn load(reaction: &str, settings: &[String], duration_s: f64) -> Option<Experiment> {
    let mut all =
        vec![format!("robot.collision_detection.reaction=\"{reaction}\""), "settle_s=0.1".to_owned()];
    all.extend_from_slice(settings);
    let options = RunOptions { duration_s: Some(duration_s), ..RunOptions::default() };
    let path = Path::new("tasks/cartesian-tracking.toml");
    Experiment::load(Files::Embedded, path, None, options, &all).ok()
}

/// Start position of the hand at these joint positions, m.
fn hand(q: [f64; 4]) -> [f64; 3] {
    let robot = common::robot(&[]);
    let mut data = opspace_model::Data::new(&robot.model);
    opspace_model::forward_kinematics(&robot.model, &mut data, &q);
    let frame = robot.model.frame_id("hand").unwrap_or_else(|e| panic!("{e}"));
    opspace_model::frame_placement(&robot.model, &data, frame).translation.into()
}

/// Settings of a hand that moves by 10 cm in a random direction from a random posture, and meets a wall of 10 kN/m halfway
/// with 0.25 m/s.
fn random_collision(number: u64) -> Vec<String> {
    let mut numbers = Numbers(number + 1);
    let mut q = [0.0; 4];
    for (q, (low, high)) in q.iter_mut().zip([(-0.8, 0.2), (-0.7, -0.1), (-0.5, 0.5), (-1.9, -0.8)]) {
        *q = numbers.within(low, high);
    }
    let (height, angle) = (numbers.within(-1.0, 1.0), numbers.within(0.0, TAU));
    let flat = f64::sqrt(1.0 - height * height);
    let direction = [flat * angle.cos(), flat * angle.sin(), height];
    let offset = direction.map(|along| 0.1 * along);
    let start = hand(q);
    let wall: Vec<f64> = start.iter().zip(offset).map(|(start, offset)| start + 0.5 * offset).collect();
    vec![
        format!(
            "start_rad={{shoulder_pitch={:?},shoulder_roll={:?},shoulder_yaw={:?},elbow={:?}}}",
            q[0], q[1], q[2], q[3]
        ),
        format!(
            "task.hand.cartesian.reference={{point-to-point={{position={{offset_m={offset:?}}},duration_s=0.75}}}}"
        ),
        format!(
            "environment={{box={{wall={{frame=\"hand\",point_m={wall:?},normal={:?},stiffness_n_per_m=10000.0,damping_ns_per_m=50.0}}}}}}",
            direction.map(|along| -along)
        ),
    ]
}

/// Time from the first contact to the detection, s, and the largest force until then, N. The time is NaN without detection;
/// `None` if there was no contact.
fn detection(experiment: &Experiment) -> Option<(f64, f64)> {
    let run = common::run(experiment);
    let truth = run.channel(TRUTH_CHANNEL);
    let forces = run.signal(TRUTH_CHANNEL, "box.force");
    let force = |k: usize| forces.row(k).iter().map(|f| f * f).sum::<f64>().sqrt();
    let contact = (0..truth.time_s.len()).find(|k| force(*k) > 0.1)?;
    let detected = run.signal(TICK_CHANNEL, COLLISION_DETECTED);
    let ticks = &run.channel(TICK_CHANNEL).time_s;
    let at = (0..ticks.len()).find(|k| detected.row(*k)[0] == 1.0);
    let at_s = at.map_or(f64::NAN, |k| ticks[k]);
    let until = (contact..truth.time_s.len()).take_while(|k| truth.time_s[*k] <= at_s);
    Some((at_s - truth.time_s[contact], until.map(force).fold(0.0, f64::max)))
}

/// Checks that collisions of the hand at 0.25 m/s with 10 kN/m are detected within 20 ms. With `OPSPACE_COLLISIONS=100` and
/// `--nocapture` it prints the figures of 100.
#[test]
fn collisions_are_detected_within_20_ms() {
    let (mut slowest, mut count, mut times) = (0.0_f64, 0, Vec::new());
    for number in 0..cases("OPSPACE_COLLISIONS", 6) {
        let Some(experiment) = load("stop", &random_collision(number), 1.2) else { continue };
        let Some((after_s, force)) = detection(&experiment) else { continue };
        count += 1;
        assert!((0.0..=0.02).contains(&after_s), "case {number}: {after_s} s, {force} N");
        slowest = slowest.max(after_s);
        times.push(after_s);
    }
    times.sort_by(f64::total_cmp);
    assert!(count > 3, "{count} collisions");
    let quick = times.iter().filter(|after_s| **after_s <= 0.008).count();
    println!(
        "{count} collisions, {quick} within 8 ms, median {} s, slowest {slowest} s",
        times[times.len() / 2]
    );
}

/// Checks that motion without a collision is no collision, with friction and payload that differ from the nominal ones and
/// four times the noise. `OPSPACE_MOTION_MINUTES=15` for each of four cases is an hour.
#[test]
fn motion_without_contact_is_no_collision() {
    let minutes = cases("OPSPACE_MOTION_MINUTES", 0);
    let duration_s = if minutes == 0 { 4.0 } else { 60.0 };
    for (friction, inertia, load_kg) in [(0.7, 1.1, 0.0), (1.3, 1.1, 0.0), (0.7, 0.9, 0.0), (1.3, 1.0, 0.1)] {
        let mut largest = 0.0;
        for seed in 1..=minutes.max(1) {
            let settings = [
                format!("robot.simulated.true_over_nominal={{friction={friction},inertia={inertia}}}"),
                "robot.simulated.torque_noise_nm=0.12".to_owned(),
                format!("seed={seed}"),
                format!("robot.simulated.payload.load={{frame=\"hand\",mass_kg={load_kg:?}}}"),
                // A motion of its own each minute.
                format!("task.hand.cartesian.reference.sinusoid.ramp_s={:?}", 1.0 + 0.1 * seed as f64),
            ];
            let settings =
                if load_kg == 0.0 { [&settings[..3], &settings[4..]].concat() } else { settings.to_vec() };
            let Some(experiment) = load("stop", &settings, duration_s) else { panic!("{settings:?}") };
            let share = largest_share(&experiment);
            assert!(share < 1.0, "{settings:?}: {share} of a threshold");
            largest = f64::max(largest, share);
        }
        println!(
            "friction {friction}, inertia {inertia}, load {load_kg} kg: at most {largest} of a threshold"
        );
        assert!(largest > 0.1, "the errors are there: {largest}");
    }
}

/// Largest torque of a run relative to its threshold.
fn largest_share(experiment: &Experiment) -> f64 {
    let run = common::run(experiment);
    let torques = run.signal(TICK_CHANNEL, COLLISION_TORQUE);
    let thresholds = run.signal(TICK_CHANNEL, COLLISION_THRESHOLD);
    let cycles = 0..run.channel(TICK_CHANNEL).time_s.len();
    let pairs = cycles.flat_map(|k| torques.row(k).iter().zip(thresholds.row(k)));
    pairs.filter(|(_, limit)| **limit > 0.0).map(|(torque, limit)| torque.abs() / limit).fold(0.0, f64::max)
}

/// Checks that an arm that reacts by compliance does not press on: the force of the contact ends, and the run does not.
#[test]
fn compliant_reaction_ends_the_contact() {
    let Some(experiment) = load("compliant", &random_collision(1), 2.0) else { panic!("case") };
    let run = common::run(&experiment);
    let forces = run.signal(TRUTH_CHANNEL, "box.force");
    let last = run.channel(TRUTH_CHANNEL).time_s.len() - 1;
    let force = |k: usize| forces.row(k).iter().map(|f| f * f).sum::<f64>().sqrt();
    assert!((0..last).any(|k| force(k) > 5.0), "it collided");
    assert!(force(last) < 6.0, "{} N at the end", force(last));
    let ticks = &run.channel(TICK_CHANNEL).time_s;
    assert!(ticks[ticks.len() - 1] - ticks[0] > 1.9, "the run goes on");
}
