//! Margins of a task with its transformer. Compared: ranges and formulas, gears on which the arm oscillates and runs of
//! the simulated robot, the torque error of an encoder and simulated rounding.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use crate::project;
use opspace_backend::CommandKind;
use opspace_experiment::{Code, Experiment, Files, Progress, RunOptions};
use opspace_loop::RunOutcome;
use opspace_preflight::{
    Quantity, Variation, diagnostics, floors, gear_margin, impedances, loop_margin, margins_with, refusals,
};
use opspace_transformer::{ServoLaw, TransformerName};
use std::io::Cursor;
use std::path::Path;

/// Typical stiffness of the gears of the ASIMO-like arm, Nm/rad.
const TYPICAL_NM_PER_RAD: [(&str, f64); 4] =
    [("shoulder_pitch", 20e3), ("shoulder_roll", 12e3), ("shoulder_yaw", 8e3), ("elbow", 5e3)];

fn typical_gears() -> Vec<String> {
    let gear = |(joint, stiffness): (&str, f64)| {
        format!("robot.joint.{joint}.gear_stiffness_nm_per_rad={stiffness:?}")
    };
    TYPICAL_NM_PER_RAD.into_iter().map(gear).collect()
}

/// Gravity compensation by the ASIMO-like arm, with settings.
fn experiment(backend: CommandKind, transformer: Option<&str>, settings: &[String]) -> Experiment {
    let transformer = transformer.map(|name| TransformerName::from(name.to_owned()));
    let options = RunOptions { backend, transformer, duration_s: Some(2.0), ..RunOptions::default() };
    let path = Path::new("tasks/gravity-compensation.toml");
    Experiment::load(Files::Embedded, path, None, options, settings).unwrap()
}

fn position(transformer: &str, settings: &[String]) -> Experiment {
    experiment(CommandKind::Position, Some(transformer), settings)
}

/// Compared: the largest kp with the emulation, and the formula ε kv < (1 − γ) b of the worst joint; any gain that is too
/// low is tolerated, and elastic gears are not.
#[test]
fn largest_gain_of_position_loops_matches_formula() {
    const TOLERANCE: f64 = 0.003;
    let emulation = TransformerName::from("emulation");
    let margins = margins_with(&position("emulation", &[]), &emulation).unwrap();
    assert_eq!(margins.unstable, None);
    let gain = margins.ranges.iter().find(|r| r.quantity == Quantity::Factor(Variation::PositionGain));
    let [least, most] = &gain.unwrap().ends;
    let formula = 1.0 + 0.2 * 2.0 / 94.6;
    assert!((most.value - formula).abs() < TOLERANCE, "{} for {formula}", most.value);
    assert_eq!(most.joint.as_deref(), Some("shoulder_pitch"));
    assert_eq!(least.joint, None);
    let delay = margins.ranges.iter().find(|r| r.quantity == Quantity::Delay).unwrap();
    assert!(delay.ends[1].value <= 5.0, "{delay}: at most an interface period");
    let text = margins.to_string();
    assert!(text.contains("elastic gears             oscillates at antiresonances of"), "{text}");
    assert!(text.lines().all(|line| line.chars().count() <= 98), "{text}");
}

/// Compared: true gains of the simulated servos inside and outside the range that the margins state, and the diagnostic.
#[test]
fn simulated_servos_outside_the_stable_range_are_found() {
    let found = |kp: &str| {
        let settings = [format!("robot.simulated.true_over_nominal.kp={kp}")];
        let experiment = position("paper", &settings);
        let transformer = TransformerName::from("paper");
        margins_with(&experiment, &transformer).unwrap().finding(&experiment)
    };
    assert_eq!(found("1.0"), None);
    let unstable = found("2.9").unwrap();
    assert_eq!(unstable.code, opspace_experiment::Code::UnstableSimulation);
    assert_eq!(unstable.key(), "simulated.true_over_nominal.kp");
    let proposed = unstable.help.split_whitespace().nth(2).unwrap();
    assert_eq!(found(proposed), None, "{unstable:?}");
}

/// Compared: the largest kv of a velocity robot through extrapolation, and the formula (1 + ε) γ b < b.
#[test]
fn largest_gain_of_velocity_loops_matches_formula() {
    const TOLERANCE: f64 = 0.03;
    let experiment = experiment(CommandKind::Velocity, Some("extrapolation"), &[]);
    let margins = margins_with(&experiment, &experiment.transformer_name().unwrap()).unwrap();
    let most = &margins.ranges[0].ends[1];
    assert_eq!(margins.ranges[0].quantity, Quantity::Factor(Variation::VelocityGain));
    assert!((most.value - 1.0 / 0.8).abs() < TOLERANCE, "{most:?}");
}

/// Compared: gears on which the arm oscillates when nudged, and the simulated robot with friction, weight and noise.
#[test]
fn emulation_oscillates_on_elastic_gears_and_extrapolation_does_not() {
    for (transformer, oscillates) in
        [("emulation", true), ("emulation+current", true), ("extrapolation+current", false)]
    {
        let experiment = position(transformer, &typical_gears());
        let gears = gear_margin(&experiment).unwrap();
        let values: Vec<f64> = gears.oscillates.iter().map(|(value, _)| *value).collect();
        assert_eq!(values.contains(&1.0), oscillates, "{transformer}: {values:?}");
        assert!(oscillates || values.is_empty(), "{transformer}: {values:?}");
        assert!(!values.contains(&16.0), "{transformer}: {values:?}, nearly rigid gears");
        assert_eq!(gears.finding(&experiment).is_some(), oscillates, "{transformer}");
        assert_eq!(!refusals(&experiment).is_empty(), oscillates, "{transformer}");
    }
    for (transformer, completes) in [("emulation+current", false), ("extrapolation+current", true)] {
        let finished = position(transformer, &typical_gears())
            .run(Cursor::new(Vec::new()), &Progress::default())
            .unwrap();
        let completed = matches!(finished.outcome, RunOutcome::Completed);
        assert_eq!(completed, completes, "{transformer}: {:?}", finished.outcome);
    }
}

/// Compared: nudges of an arm under a friction observer, with and without a constant compensation of friction, and a run of the
/// simulated robot. What the constant part compensates is not compensated a second time by the observer.
#[test]
fn observed_friction_is_compensated_once() {
    let handle = |gain: f64, gears: &[String]| {
        let friction = format!("friction_compensation={{ gain = {gain:?}, observer_rad_per_s = 60.0 }}");
        let settings = [&[friction], gears].concat();
        let options = RunOptions {
            backend: CommandKind::Position,
            transformer: Some(TransformerName::EXTRAPOLATION.with_current(true)),
            duration_s: Some(2.0),
            ..RunOptions::default()
        };
        Experiment::load(Files::Disk, &project("tasks/handle.toml"), None, options, &settings).unwrap()
    };
    let elastic = ["robot.interface.gears=\"elastic\"".to_owned()];
    for gain in [0.0, 0.8] {
        assert_eq!(gear_margin(&handle(gain, &elastic)).unwrap().oscillates, [], "{gain}");
    }
    assert_eq!(refusals(&handle(0.8, &elastic)), []);
    let finished = handle(0.8, &typical_gears()).run(Cursor::new(Vec::new()), &Progress::default()).unwrap();
    assert_eq!(finished.outcome, RunOutcome::Completed);
}

/// Gears that are not declared rigid select another transformer, and say so; the emulation is then refused on a real
/// robot.
#[test]
fn gears_of_unknown_stiffness_are_taken_to_be_elastic() {
    let elastic = ["robot.interface.gears=\"elastic\"".to_owned()];
    let default = experiment(CommandKind::Position, None, &elastic);
    assert_eq!(default.transformer_name().unwrap().as_str(), "extrapolation+current");
    assert!(default.transformer_reason().unwrap().contains("the gears are not declared rigid"));
    assert_eq!(refusals(&default), []);
    let stated = experiment(CommandKind::Position, None, &typical_gears());
    assert_eq!(stated.transformer_name().unwrap().as_str(), "extrapolation+current", "stiffness is declared");
    let rigid = experiment(CommandKind::Position, None, &[]);
    assert_eq!(rigid.transformer_name().unwrap().as_str(), "emulation+current");
    assert_eq!(refusals(&rigid), []);

    let refused = refusals(&position("emulation+current", &elastic)).remove(0);
    for words in ["'emulation+current'", "oscillates at antiresonances of 20 Hz", "gears = \"rigid\""] {
        assert!(format!("{} {}", refused.message, refused.help).contains(words), "{words} in {refused:?}");
    }
    let refused = refusals(&position("emulation", &[])).remove(0);
    assert!(refused.message.ends_with("; a real robot must tolerate 1 %"), "{}", refused.message);
}

/// Compared: the emulation is active and extrapolation is not; the resolution's torque error, and that of drives whose
/// positions are rounded within an interval, from the drive's state at its beginning.
#[test]
fn impedance_and_torque_error_of_encoder_are_stated() {
    const TOLERANCE: f64 = 0.1;
    let active = impedances(&position("emulation", &[])).unwrap();
    assert!(active.iter().all(|joint| joint.active_hz.is_some() && joint.least_nms_per_rad < 0.0));
    let passive = impedances(&position("extrapolation", &[])).unwrap();
    assert!(passive.iter().all(|joint| joint.active_hz.is_none()), "{passive:?}");

    // Practically no filter.
    let unfiltered = TYPICAL_NM_PER_RAD
        .map(|(joint, _)| format!("robot.profile.a-med.servo.{joint}.cascaded.velocity_filter_hz=1e5"));
    let experiment = position("emulation", &unfiltered);
    let (robot, profile) = (experiment.robot(), experiment.profile().1);
    let servos = robot.servos(profile);
    let ratio = profile.servo_ticks_per_cycle.get();
    for (i, floor) in floors(&experiment).unwrap().iter().enumerate() {
        let resolution = robot.joints()[i].rotor.resolution_rad();
        let law = ServoLaw::new(&servos[i], profile.servo_period_s()).unwrap();
        let (mut memory, _) = law.rest(0.0, 0.0);
        // A speed that is no simple fraction of the resolution per tick.
        let position = |tick: u32| f64::from(tick) * 0.618_034 * resolution;
        let (mut square, mut count) = (0.0, 0.0);
        for interval in 0..4000 {
            // The interface reads the rounded position at the tick before a setpoint acts (a delay of one tick).
            let mut exact = memory;
            let mut difference = 0.0;
            for tick in interval * ratio + 1..=(interval + 1) * ratio {
                let rounded = (position(tick) / resolution).round() * resolution;
                difference += law.step(&mut memory, 0.0, rounded) - law.step(&mut exact, 0.0, position(tick));
            }
            square += (difference / f64::from(ratio)).powi(2);
            count += 1.0;
        }
        let rms = f64::sqrt(square / count);
        assert!(
            (rms / floor.floor_nm - 1.0).abs() < TOLERANCE,
            "{}: {rms} for {}",
            floor.joint,
            floor.floor_nm
        );
    }
}

/// Compared: the torque error by the setpoints' resolution, and the rms torque of a spring on the rounding of a ramp.
#[test]
fn resolution_of_setpoints_is_a_torque_error() {
    /// Difference of a mean over a finite ramp.
    const TOLERANCE: f64 = 0.01;
    let step = 0.0015;
    let settings = [
        format!("robot.joint.elbow.setpoint_resolution_rad={step}"),
        "robot.profile.a-med.servo.elbow={ pid = { stiffness_nm_per_rad = 1500.0, damping_nms_per_rad = 0.0 } }".to_owned(),
    ];
    let experiment = position("extrapolation", &settings);
    let floors = floors(&experiment).unwrap();
    let rounding = |k: u32| {
        let setpoint = f64::from(k) * 0.618_034 * step;
        1500.0 * ((setpoint / step).round() * step - setpoint)
    };
    let rms = f64::sqrt((0..4000).map(|k| rounding(k).powi(2)).sum::<f64>() / 4000.0);
    for floor in floors {
        let expected = if floor.joint == "elbow" { rms } else { 0.0 };
        assert!((floor.setpoint_floor_nm - expected).abs() <= TOLERANCE * rms, "{floor:?}, {rms}");
    }
}

/// Setpoint limits bound the torque on a held joint, and velocity feed-forward with held setpoints is a finding.
#[test]
fn limits_and_feed_forward_of_setpoints_are_stated() {
    /// Relative rounding error.
    const TOLERANCE: f64 = 1e-6;
    let limits = [
        "robot.profile.a-med.setpoint_limits.reaction=\"clamp\"",
        "robot.profile.a-med.setpoint_limits.joint.elbow={ velocity_rad_per_s = 2.0, acceleration_rad_per_s2 = 10.0 }",
    ]
    .map(str::to_owned);
    let stated = floors(&position("extrapolation", &limits)).unwrap();
    let elbow = stated.iter().find(|floor| floor.joint == "elbow").unwrap();
    let amplitudes = elbow.within_setpoint_limits_nm.unwrap();
    // Without feed-forward, the response to a setpoint is the stiffness kv kp.
    let stiffness = 30.3 * 50.265;
    for (hz, amplitude) in [1.0, 5.0, 10.0, 20.0, 50.0].into_iter().zip(amplitudes) {
        let omega = std::f64::consts::TAU * hz;
        let expected = stiffness * (2.0 / omega).min(10.0 / (omega * omega));
        assert!((amplitude / expected - 1.0).abs() < TOLERANCE, "{hz} Hz: {amplitude} for {expected}");
    }
    assert!(stated.iter().filter(|floor| floor.within_setpoint_limits_nm.is_some()).count() == 1);

    // With a limit of acceleration only, a tenth of the torque limit at a frequency of √(10 stiffness/torque).
    let torque = 0.1 * elbow.torque_limit_nm;
    let expected = (10.0 * stiffness / torque).sqrt().max(0.0) / std::f64::consts::TAU;
    let bandwidth = elbow.bandwidth_hz.unwrap();
    assert!((bandwidth / expected - 1.0).abs() < TOLERANCE, "{bandwidth} for {expected}");
    let narrow = |limits: &[String]| {
        let found = diagnostics(&position("extrapolation", limits));
        found.into_iter().find(|found| found.code == Code::NarrowSetpointLimits)
    };
    assert!(narrow(&limits).is_none(), "{bandwidth} Hz are enough");
    // The remedy helps, and two thirds of it do not.
    let key = "robot.profile.a-med.setpoint_limits.joint.elbow";
    let few = |acceleration: f64| {
        [limits[0].clone(), format!("{key}={{ acceleration_rad_per_s2 = {acceleration:?} }}")]
    };
    let found = narrow(&few(0.2)).unwrap();
    let advised = found.help.split("acceleration_rad_per_s2 = ").nth(1).unwrap();
    let advised: f64 = advised.split(' ').next().unwrap().parse().unwrap();
    assert!(narrow(&few(advised)).is_none() && narrow(&few(advised / 1.5)).is_some(), "{found:?}");

    let fed = ["robot.profile.a-med.servo.elbow.cascaded.velocity_feed_forward=1.0".to_owned()];
    let found = diagnostics(&position("extrapolation", &fed));
    let of_feed_forward = |found: &[opspace_experiment::Finding]| {
        found
            .iter()
            .filter(|found| found.message.contains("velocity feed-forward with held setpoints"))
            .count()
    };
    assert_eq!(of_feed_forward(&found), 1, "{found:?}");
    let interpolated = [fed[0].clone(), "robot.interface.setpoints=\"interpolated\"".to_owned()];
    assert_eq!(of_feed_forward(&diagnostics(&position("extrapolation", &interpolated))), 0);
}

/// Compared: the smallest phase margin of a Cartesian task at several delays, with a textbook bound on what the delay takes; gains
/// that are stable without delay and not with it are refused on a real robot.
#[test]
fn delay_takes_phase_margin_and_unstable_gains_are_refused() {
    let late = |cycles: u32, frequency: f64| {
        let settings = [
            format!("robot.profile.b-soft.delay_servo_ticks={}", 5 * cycles),
            format!("task.hand.cartesian.gains.frequency_rad_per_s={frequency:?}"),
        ];
        let options = RunOptions { profile: Some("b-soft".to_owned()), ..RunOptions::default() };
        let path = Path::new("tasks/cartesian-tracking.toml");
        Experiment::load(Files::Embedded, path, None, options, &settings).unwrap()
    };
    let [none, some] = [0, 3].map(|cycles| loop_margin(&late(cycles, 14.0)).unwrap());
    assert_eq!([none.delay_cycles, none.delay_s], [0.0, 0.0]);
    assert!((some.delay_cycles - 3.0).abs() < 1e-12 && (some.delay_s - 0.015).abs() < 1e-12, "{some}");
    assert!(
        some.to_string().starts_with("commands act 3 interface cycles (15 ms) after their samples"),
        "{some}"
    );
    // A delay takes ω d at least at the crossover without it, or moves the crossover to where the loop has less.
    let taken = 360.0 * none.crossover_hz * some.delay_s;
    assert!(some.degrees < none.degrees - 0.5 * taken && some.degrees > 0.0, "{none}; {some}");
    for (cycles, is_refused) in [(0, false), (8, true)] {
        let experiment = late(cycles, 80.0);
        let refused = refusals(&experiment).iter().any(|finding| finding.code == Code::GainsTooHigh);
        assert_eq!(refused, is_refused, "{cycles} cycles: {}", loop_margin(&experiment).unwrap());
    }
}
