//! Motion without a collision, which the detection must not take for one.

#![expect(clippy::print_stdout, reason = "figures of the long version")]

use crate::collision_cases::{JOINTS, Numbers, cases, hand_motion, joint_motion, load, noise};
use crate::common;
use opspace_backend::signal_names::{
    COLLISION_CHANGE, COLLISION_CHANGE_THRESHOLD, COLLISION_THRESHOLD, COLLISION_TORQUE, DQ, TICK_CHANNEL,
};
use opspace_experiment::{Experiment, RunOptions};

/// Random motion, and random errors of the model: friction 30 %, inertia or load 10 %, four times the noise of encoders and
/// motor currents.
fn random_motion(number: u64, duration_s: f64) -> (String, Experiment) {
    let mut numbers = Numbers::new(1_000_003 * (number + 1));
    let profile = ["a-med", "b-soft"][number as usize % 2];
    let friction = [0.7, 1.3][number as usize / 2 % 2];
    let inertia = [1.1, 0.9, 1.0][number as usize / 4 % 3];
    let along_curve = number / 12 % 2 == 1;
    let (task, mut settings) = if along_curve {
        ("cartesian-tracking", hand_motion(&mut numbers))
    } else {
        ("joint-tracking", joint_motion(&mut numbers, duration_s))
    };
    settings.push(format!("robot.simulated.true_over_nominal={{friction={friction},inertia={inertia}}}"));
    settings.extend(noise());
    settings.push(format!("seed={}", number + 1));
    if inertia == 1.0 {
        settings.push("robot.simulated.payload.load={frame=\"hand\",mass_kg=0.1}".to_owned());
    }
    let options = RunOptions {
        duration_s: Some(duration_s),
        profile: Some(profile.to_owned()),
        ..RunOptions::default()
    };
    let name = format!("{task} {number}, {profile}, friction {friction}, inertia {inertia}");
    let Some(experiment) = load(task, "\"stop\"", &settings, options) else { panic!("{settings:?}") };
    (name, experiment)
}

/// Checks that motion without contact is no collision. `OPSPACE_MOTION_MINUTES=60` is an hour of it, in runs of a minute; with
/// `--nocapture` it prints the runs whose torque comes near its threshold. `OPSPACE_FIRST` is the number of the first run: each has its
/// own motion and noise.
#[test]
fn motion_without_contact_is_no_collision() {
    let minutes = cases("OPSPACE_MOTION_MINUTES", 0);
    let (runs, duration_s) = if minutes == 0 { (8, 2.0) } else { (minutes, 60.0) };
    let (mut alarms, mut largest) = (Vec::new(), 0.0);
    let first = cases("OPSPACE_FIRST", 0);
    for number in first..first + runs {
        let (name, experiment) = random_motion(number, duration_s);
        let (share, what) = largest_share(&experiment);
        if share > 0.9 {
            println!("{name}: at most {share:.3} of a threshold, {what}");
        }
        largest = f64::max(largest, share);
        if share >= 1.0 {
            alarms.push(name);
        }
    }
    println!(
        "{} false alarms in {runs} runs of {duration_s} s; at most {largest:.3} of a threshold",
        alarms.len()
    );
    assert!(alarms.is_empty(), "{alarms:?}");
    assert!(largest > 0.1, "the errors are there: {largest}");
}

/// Largest torque of a run relative to its threshold, and the joint and time of it.
fn largest_share(experiment: &Experiment) -> (f64, String) {
    let run = common::run(experiment);
    let velocities = run.signal(TICK_CHANNEL, DQ);
    let times = &run.channel(TICK_CHANNEL).time_s;
    let (mut largest, mut at) = (0.0, ("", 0, 0, 0.0));
    for (name, threshold, from_s) in
        [(COLLISION_TORQUE, COLLISION_THRESHOLD, 0.0), (COLLISION_CHANGE, COLLISION_CHANGE_THRESHOLD, 0.31)]
    {
        let (torques, thresholds) = (run.signal(TICK_CHANNEL, name), run.signal(TICK_CHANNEL, threshold));
        for k in (0..times.len()).filter(|k| times[*k] >= from_s) {
            for (joint, (torque, limit)) in torques.row(k).iter().zip(thresholds.row(k)).enumerate() {
                if torque.abs() / limit > largest {
                    (largest, at) = (torque.abs() / limit, (name, k, joint, *torque));
                }
            }
        }
    }
    let (name, k, joint, torque) = at;
    let fastest =
        (0..times.len()).flat_map(|k| velocities.row(k)).fold(0.0, |most, dq| f64::max(most, dq.abs()));
    let what = format!(
        "{name} of {} at {:.2} s of {:.1} s: {torque:.2} Nm, {:.2} rad/s; up to {fastest:.1} rad/s",
        JOINTS[joint],
        times[k],
        times[times.len() - 1],
        velocities.row(k)[joint],
    );
    (largest, what)
}
