//! Gain margin of position and velocity loops. Compared: the reported margin, a formula, and runs of the simulated
//! robot.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use opspace_backend::CommandKind;
use opspace_experiment::Progress;
use opspace_experiment::{Experiment, Files, RunOptions};
use opspace_log::Recording;
use opspace_loop::RunOutcome;
use opspace_preflight::{ServoLoop, gain_margin};
use std::io::Cursor;
use std::path::Path;

const PAPER: &str = "transformer=\"paper\"";
const EMULATION: &str = "transformer=\"emulation\"";
const EMULATION_CURRENT: &str = "transformer=\"emulation+current\"";

/// A task on the ASIMO-like arm as a position robot, with settings.
fn experiment(task: &str, profile: &str, transformer: &str, settings: &[String]) -> Experiment {
    on(CommandKind::Position, task, profile, transformer, settings)
}

/// A task on the ASIMO-like arm with the command interface `backend`, with settings.
fn on(backend: CommandKind, task: &str, profile: &str, transformer: &str, settings: &[String]) -> Experiment {
    let profile_name = Some(profile.to_owned());
    let options =
        RunOptions { backend, profile: profile_name, duration_s: Some(3.0), ..RunOptions::default() };
    let transformer = format!("robot.profile.{profile}.{transformer}");
    let settings: Vec<String> = std::iter::once(transformer).chain(settings.iter().cloned()).collect();
    let path = format!("tasks/{task}.toml");
    Experiment::load(Files::Embedded, Path::new(&path), None, options, &settings).unwrap()
}

fn excess(experiment: &Experiment) -> Option<f64> {
    gain_margin(experiment).unwrap().excess
}

/// Compared: the margin of gravity compensation, where all damping is known, and the formula ε < ((1 − gain) b +
/// d)/kv + (1 + ε) kp t̄ of the worst joint, with and without the delay of the hold, t̄ = (R−1)/2 Ts.
#[test]
fn gain_margin_matches_formula() {
    // 0.1 % for the bisection, and the rest for the observer and the filters, which the formula does not include.
    const TOLERANCE: f64 = 0.004;
    for (profile, kp, kv, hold_s) in [("a-med", 50.265, 94.6, 4e-4), ("b-soft", 25.133, 47.3, 2e-3)] {
        for damping in [0.0, 2.0] {
            for (transformer, lag_s) in [(PAPER, hold_s), (EMULATION, 0.0)] {
                let setting = format!("task.rest.joint-damping.damping_nms_per_rad={damping:?}");
                let margin =
                    gain_margin(&experiment("gravity-compensation", profile, transformer, &[setting]))
                        .unwrap();
                let told = margin.excess.unwrap();
                let added = (0.2 * 2.0 + damping) / kv;
                let formula = (added + kp * lag_s) / (1.0 - kp * lag_s);
                assert!(
                    (told - formula).abs() < TOLERANCE,
                    "{profile} {damping} {transformer}: {told} for {formula}"
                );
                assert_eq!(
                    margin.joint.as_deref(),
                    Some("shoulder_pitch"),
                    "the highest kv for its friction"
                );
            }
        }
    }
}

/// Compared: the margin of a velocity robot in gravity compensation, where an excess gain scales the torques, and the
/// formula (1 + ε) (gain b − d) < b of the joint with the most friction.
#[test]
fn velocity_robot_gain_margin_matches_formula() {
    // As in the test above.
    const TOLERANCE: f64 = 0.004;
    const FRICTION_NMS_PER_RAD: f64 = 2.0;
    for (profile, transformer, gain, damping) in [
        ("a-med", PAPER, 0.8, 0.0),
        ("a-med", EMULATION, 0.98, 0.0),
        ("b-soft", PAPER, 0.98, 0.0),
        ("b-soft", EMULATION, 0.8, 0.0),
        ("b-soft", EMULATION, 0.8, 0.5),
    ] {
        let settings = [
            format!("task.rest.joint-damping.damping_nms_per_rad={damping:?}"),
            format!("friction_compensation.gain={gain:?}"),
        ];
        let experiment = on(CommandKind::Velocity, "gravity-compensation", profile, transformer, &settings);
        let margin = gain_margin(&experiment).unwrap();
        let told = margin.excess.unwrap();
        let formula = FRICTION_NMS_PER_RAD / (gain * FRICTION_NMS_PER_RAD - damping) - 1.0;
        let case = format!("{profile} {transformer} {gain} {damping}");
        assert!((told - formula).abs() < TOLERANCE, "{case}: {told} for {formula}");
        assert_eq!(margin.servo_loop, ServoLoop::Velocity);
        let finding = margin.finding(&experiment);
        let words = finding.map(|finding| format!("{} {}", finding.message, finding.help));
        assert_eq!(words.is_some(), formula < 0.05, "{case}: {words:?}");
        assert!(words.is_none_or(|words| {
            words.contains("velocity loops tolerate only 2")
                && words.contains("set `friction_compensation.gain = ")
        }));
    }
}

/// Compared: the margins with and without measurement of the motor currents, which reveals a wrong gain: with it, the
/// margin is more than 50 %, and ten times as large as without.
#[test]
fn motor_current_raises_gain_margin() {
    for profile in ["a-med", "b-soft"] {
        let of = |transformer| excess(&experiment("gravity-compensation", profile, transformer, &[]));
        let (without, with) = (of(EMULATION).unwrap(), of(EMULATION_CURRENT));
        assert!(
            with.is_none_or(|with| with > 10.0 * without && with > 0.5),
            "{profile}: {with:?} for {without}"
        );
    }
}

/// Compared: the margin with the remedies that the diagnostic names, and without them.
#[test]
fn damping_of_free_motion_raises_gain_margin() {
    let of = |settings: &[String]| experiment("gravity-compensation", "a-med", EMULATION, settings);
    let before = of(&["task.rest.joint-damping.damping_nms_per_rad=0.0".to_owned()]);
    let help = gain_margin(&before).unwrap().finding(&before).unwrap().help;
    // The task has no compliant axes.
    assert!(!help.contains("compliant_damping_per_s") && !help.contains("raise the nominal"), "{help}");
    let (_, more) = help.rsplit_once("damping_nms_per_rad = ").unwrap();
    let more: f64 = more.trim_end_matches('`').parse().unwrap();
    let after = of(&[format!("task.rest.joint-damping.damping_nms_per_rad={more:?}")]);
    assert!(excess(&after).unwrap() > 0.049, "{more} Nms/rad: {:?}", excess(&after));

    let compliant = |damping: f64| {
        let setting = format!("task.hand.cartesian.compliant_damping_per_s={damping:?}");
        excess(&experiment("compliant-x", "a-med", EMULATION, &[setting]))
    };
    let (less, more) = (compliant(2.0).unwrap(), compliant(10.0));
    assert!(more.is_none_or(|more| more > 1.3 * less), "{less}, {more:?}");
}

/// Outcome of a run of the simulated robot whose position loop gains are increased by the fraction `excess`, and its
/// highest speed, rad/s.
fn run(task: &str, transformer: &str, excess: f64) -> (RunOutcome, Option<f64>) {
    let scale = format!("robot.simulated.true_over_nominal.kp={:?}", 1.0 + excess);
    let experiment = experiment(task, "a-med", transformer, &[scale]);
    let finished = experiment.run(Cursor::new(Vec::new()), &Progress::default()).unwrap();
    let recording = Recording::from_bytes(finished.sink.get_ref()).unwrap();
    let speed = experiment.summary(&recording, &finished.record, None).metrics.speed_max_rad_per_s;
    (finished.outcome, speed)
}

/// Compared: the margin, and the simulated robot with friction, weight and noise. Within the margin the arm moves
/// below its speed limit; clearly beyond it the run ends with a fault.
#[test]
fn simulated_robot_is_stable_only_within_margin() {
    const WITHIN: f64 = 0.8;
    const BEYOND: f64 = 0.04;
    const FAST_RAD_PER_S: f64 = 4.0;
    for task in ["gravity-compensation", "cartesian-tracking"] {
        for transformer in [PAPER, EMULATION] {
            let margin = excess(&experiment(task, "a-med", transformer, &[])).unwrap();
            let (ending, speed) = run(task, transformer, WITHIN * margin);
            assert!(
                matches!(ending, RunOutcome::Completed),
                "{task} {transformer}, within {margin}: {ending:?}"
            );
            assert!(
                speed.is_some_and(|speed| speed < FAST_RAD_PER_S),
                "{task} {transformer}: {speed:?} rad/s"
            );
            let (ending, _) = run(task, transformer, margin + BEYOND);
            assert!(
                matches!(ending, RunOutcome::Faulted { .. }),
                "{task} {transformer}, beyond {margin}: {ending:?}"
            );
        }
    }
}

/// A small margin is reported with its number and a remedy, a large one is not; without a transformer there is no
/// margin.
#[test]
fn small_gain_margin_is_reported() {
    let small = experiment("gravity-compensation", "a-med", EMULATION, &[]);
    let finding = gain_margin(&small).unwrap().finding(&small).unwrap();
    let told = format!("{} {} {}", finding.key(), finding.message, finding.help);
    for words in
        ["profile.a-med", "0.4 %", "'emulation'", "\"emulation+current\"", "damping_nms_per_rad = 4."]
    {
        assert!(told.contains(words), "`{words}` in {told}");
    }
    let large = experiment("gravity-compensation", "a-med", EMULATION_CURRENT, &[]);
    assert_eq!(gain_margin(&large).unwrap().finding(&large), None);
    let torque = RunOptions { backend: CommandKind::Torque, ..RunOptions::default() };
    let path = Path::new("tasks/gravity-compensation.toml");
    let torque = Experiment::load(Files::Embedded, path, None, torque, &[]).unwrap();
    assert_eq!(gain_margin(&torque), None);
}
