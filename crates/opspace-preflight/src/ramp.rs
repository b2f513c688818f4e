//! References that move fast while the torque ramps in at the start.
//!
//! The loop ramps the torque in from that which holds the arm at rest. With its share s(t), and a task of the natural
//! frequency ω with critical damping, a reference with the acceleration a leaves the error
//!
//! ```text
//! ë = a − s (a + ω² e + 2 ω ė)          s = t / torque_ramp_s, at most 1
//! ```

use super::case::PreflightCase;
use super::diagnostic::short;
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_experiment::run::rollout::{Instant, Rollout};

/// Natural frequency of a task, rad/s: that of the first task of a new robot.
const FREQUENCY_RAD_PER_S: f64 = 20.0;

/// Largest error that is not reported, m.
const LEAST_M: f64 = 0.01;

/// Longest step of the integration, s.
const STEP_S: f64 = 1e-3;

/// Reports the reference that gets farthest ahead of the arm while the torque ramps in, if any.
pub(crate) fn of_references(case: &PreflightCase<'_>, followed: &Rollout) -> Option<Finding> {
    let ramp_s = case.experiment.robot().file.safety.torque_ramp_s.get();
    let first: Vec<&Instant> = followed.instants.iter().filter(|instant| instant.task_set == 0).collect();
    let tasks = first.first()?.tasks.len();
    let speeds = |task: usize| {
        let speed = move |instant: &&Instant| Some((instant.time_s, instant.tasks.get(task)?.speeds[0]?));
        first.iter().filter_map(speed).collect::<Vec<_>>()
    };
    let errors_m = (0..tasks).map(|task| (task, largest_error_m(&speeds(task), ramp_s)));
    let (task, largest_m) =
        errors_m.max_by(|a, b| a.1.total_cmp(&b.1)).filter(|(_, error_m)| *error_m > LEAST_M)?;
    let name = case.task_sets[0].tasks.tasks().nth(task)?.name();
    let key = case.reference_key(0, name);
    let message = format!(
        "the reference moves while the torque ramps in over the first {} s (safety.torque_ramp_s): the hand stays some {} mm behind",
        short(ramp_s),
        short(1e3 * largest_m),
    );
    let help =
        "hold the start until then, and set the reference by an [[event]], or begin more slowly".to_owned();
    Some(Finding::new(Code::MovesDuringRamp, &key, message, help))
}

/// Largest error of an arm whose torque ramps in over `ramp_s` (s), for a reference with these times (s) and speeds (m/s).
fn largest_error_m(speeds: &[(f64, f64)], ramp_s: f64) -> f64 {
    let (mut error, mut rate, mut largest) = (0.0_f64, 0.0_f64, 0.0_f64);
    let omega = FREQUENCY_RAD_PER_S;
    // Starts at rest: a first speed that is not zero is a step.
    rate += speeds.first().map_or(0.0, |(_, speed)| *speed);
    for pair in speeds.windows(2) {
        let ([from_s, to_s], acceleration) =
            ([pair[0].0, pair[1].0], (pair[1].1 - pair[0].1) / (pair[1].0 - pair[0].0));
        if from_s > ramp_s || acceleration.is_nan() {
            break;
        }
        let steps = ((to_s - from_s) / STEP_S).ceil().max(1.0);
        let step_s = (to_s - from_s) / steps;
        for step in 0..steps as usize {
            let share = ((from_s + step as f64 * step_s) / ramp_s).min(1.0);
            let change = acceleration - share * (acceleration + omega * omega * error + 2.0 * omega * rate);
            rate += change * step_s;
            error += rate * step_s;
            largest = largest.max(error.abs());
        }
    }
    largest
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Error of an arm that has its torque from the start on, m; and part of the missing torque's error that a ramp leaves.
    const FOLLOWED_M: f64 = 1e-5;
    const LEAST_PART: f64 = 0.05;

    /// Speeds of a reference that accelerates from the start on (m/s²), or from `from_s` on.
    fn accelerating(acceleration: f64, from_s: f64) -> Vec<(f64, f64)> {
        (0..400)
            .map(|k| 1e-3 * f64::from(k))
            .map(|time_s| (time_s, acceleration * (time_s - from_s).max(0.0)))
            .collect()
    }

    /// Compared: an arm without torque stays behind by ½ a t², one with all its torque by nothing.
    #[test]
    fn error_is_that_of_the_missing_torque() {
        let of = |ramp_s: f64| largest_error_m(&accelerating(2.0, 0.0), ramp_s);
        // A ramp of 100 s gives hardly any torque in the 0.4 s of the reference.
        assert!((of(100.0) / (0.5 * 2.0 * 0.4 * 0.4) - 1.0).abs() < 0.1, "{}", of(100.0));
        assert!(of(1e-3) < FOLLOWED_M, "{}", of(1e-3));
        let without_m = 0.5 * 2.0 * 0.2 * 0.2;
        assert!(of(0.2) > LEAST_PART * without_m && of(0.2) < without_m, "{}", of(0.2));
        assert_eq!(largest_error_m(&accelerating(50.0, 0.3), 0.2), 0.0);
    }
}
