//! Random servos on random elastic gears, of which nothing but the nominal gains is told: `extrapolation+current` completes
//! its tasks with a small torque error.
//!
//! `OPSPACE_SEED=7 cargo test --test experiment random_servos -- --include-ignored` draws others.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use opspace_backend::CommandKind;
use opspace_experiment::{Experiment, Files, Progress, RunOptions};
use opspace_log::Recording;
use opspace_loop::RunOutcome;
use opspace_preflight::floors;
use opspace_transformer::{ServoParameters, TransformerName};
use std::io::Cursor;
use std::path::Path;

/// Largest error of interval means, relative to the desired torque, beside what the resolution of encoders causes.
const LARGEST_ERROR: f64 = 0.04;

/// Tasks of three robots.
const TASKS: [&str; 5] =
    ["cartesian-tracking", "gravity-compensation", "compliant-x", "panda-tracking", "ur5e-tracking"];

/// Stiffness of the gears at the base and at the tip, Nm/rad.
const STIFFNESS_NM_PER_RAD: [f64; 2] = [20e3, 5e3];

/// Pseudo-random numbers.
pub struct Random(pub u64);

impl Random {
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn one_of(&mut self, values: &[f64]) -> f64 {
        values[self.between(0.0, values.len() as f64) as usize]
    }
}

/// Experiment of 3 s of the task file `task`.
pub fn load(task: &Path, settings: &[String]) -> Experiment {
    let options = RunOptions {
        backend: CommandKind::Position,
        transformer: Some(TransformerName::from("extrapolation+current")),
        duration_s: Some(3.0),
        ..RunOptions::default()
    };
    Experiment::load(Files::Disk, task, None, options, settings).unwrap()
}

/// Settings of a random robot: gains of the servos, true gains, delay and gears.
pub fn random_settings(nominal: &Experiment, random: &mut Random) -> Vec<String> {
    let (name, profile) = nominal.profile();
    let joints = nominal.robot().model.joints();
    let mut settings = Vec::new();
    for (i, servo) in nominal.robot().servos(profile).iter().enumerate() {
        let ServoParameters::Cascaded(servo) = servo else { panic!("cascades") };
        let joint = &joints[i].name;
        let kp = random.between(15.0, 60.0);
        let kv = random.between(0.25, 1.1) * servo.kv_nms_per_rad.get();
        let filter_hz = servo.velocity_filter_hz.get();
        settings.push(format!(
            "robot.profile.{name}.servo.{joint}={{ cascaded = {{ kp_per_s = {kp:?}, kv_nms_per_rad = {kv:?}, \
             velocity_filter_hz = {filter_hz:?} }} }}"
        ));
        let [base, tip] = STIFFNESS_NM_PER_RAD;
        let share = i as f64 / (joints.len() - 1) as f64;
        let stiffness = base.powf(1.0 - share) * tip.powf(share) * random.between(0.5, 2.0);
        let damping = 4.0 - 3.0 * share;
        settings.push(format!(
            "robot.simulated.gear.{joint}={{ stiffness_nm_per_rad = {stiffness:?}, damping_nms_per_rad = {damping:?} }}"
        ));
    }
    settings.push("robot.interface.gears=elastic".to_owned());
    let softness = random.one_of(&[16.0, 4.0, 1.0, 0.5, 0.25]);
    let kp = random.one_of(&[0.6, 0.9, 1.0, 1.1, 1.4]);
    let delay = random.one_of(&[0.0, 1.0, 2.0]) as u32;
    settings.push(format!("robot.simulated.true_over_nominal.gear_stiffness={softness:?}"));
    settings.push(format!("robot.simulated.true_over_nominal.kp={kp:?}"));
    settings.push(format!("robot.profile.{name}.delay_servo_ticks={delay}"));
    settings
}

/// Runs a task, and checks that it completes with a small torque error. `number` tells which draw it is.
///
/// The resolution Δ of the encoders causes the error kv Δ/(√12 T) of a mean torque, whatever the transformer: up to 5.5 % of the
/// desired torque, where a stiff drive carries little.
pub fn check(task: &Path, settings: &[String], number: &str) {
    let experiment = load(task, settings);
    let finished = experiment.run(Cursor::new(Vec::new()), &Progress::default()).unwrap();
    let failed = format!("{number}, {} with {settings:#?}", task.display());
    assert!(matches!(finished.outcome, RunOutcome::Completed), "{:?}: {failed}", finished.outcome);
    let log = Recording::from_bytes(finished.sink.get_ref()).unwrap();
    let summary = experiment.summary(&log, &finished.record, None);
    let error = summary.metrics.torque_error_interval.unwrap();
    let error_nm = norm(summary.joints.values().map(|joint| joint.torque_error_rms_nm.unwrap()));
    let floor_nm = norm(floors(&experiment).unwrap().iter().map(|joint| joint.floor_nm));
    let largest = LARGEST_ERROR.hypot(floor_nm * error / error_nm);
    assert!(error < largest, "{error} above {largest}: {failed}");
}

fn norm(values: impl Iterator<Item = f64>) -> f64 {
    values.map(|value| value * value).sum::<f64>().sqrt()
}

/// Runs `rounds` random robots in each task.
fn run(rounds: usize, seed: u64) {
    let mut random = Random(seed);
    for task in TASKS {
        let task = format!("{}/../../tasks/{task}.toml", env!("CARGO_MANIFEST_DIR"));
        for _ in 0..rounds {
            let settings = random_settings(&load(Path::new(&task), &[]), &mut random);
            check(Path::new(&task), &settings, &format!("seed {seed}"));
        }
    }
}

/// Encoders on the links, 200 setpoints per second, and gears whose resonance is near an odd multiple of half of that: without
/// the correction for their twist the arm errs by several hundred per cent.
#[test]
fn extrapolation_masters_encoders_on_links() {
    let task = format!("{}/../../tasks/gravity-compensation.toml", env!("CARGO_MANIFEST_DIR"));
    for softness in [1.0, 0.93] {
        let gears =
            [("shoulder_pitch", 20e3), ("shoulder_roll", 12e3), ("shoulder_yaw", 8e3), ("elbow", 5e3)];
        let gear = |(joint, stiffness): (&str, f64)| {
            format!(
                "robot.simulated.gear.{joint}={{ stiffness_nm_per_rad = {:?}, damping_nms_per_rad = {:?} }}",
                softness * stiffness,
                0.25e-3 * stiffness
            )
        };
        let mut settings: Vec<String> = gears.into_iter().map(gear).collect();
        settings.push("robot.interface.gears=elastic".to_owned());
        settings.push("robot.default_profile=b-soft".to_owned());
        settings.push("robot.simulated.encoder.interface=link".to_owned());
        check(Path::new(&task), &settings, "encoders on links");
    }
}

#[test]
fn extrapolation_masters_random_servos() {
    run(4, 1);
}

#[test]
#[ignore = "more than ten seconds"]
fn extrapolation_masters_more_random_servos() {
    let seed = std::env::var("OPSPACE_SEED").map_or(2, |seed| seed.parse().unwrap());
    run(20, seed);
}
