//! Remedies for gains, drives and gears.

use super::case::{HAND, TaskCase, after, number_after, only};
use opspace_backend::CommandKind;
use opspace_experiment::{Code, Experiment, Finding};
use opspace_preflight::{JointImpedance, gain_margin, gear_margin, impedances, margins_with};

/// Joints of the ASIMO-like arm.
const ASIMO: [&str; 4] = ["shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow"];

const ELASTIC: &str = "robot.interface.gears=\"elastic\"";

pub fn gains_too_high(code: Code) {
    for (backend, frequency) in
        [(CommandKind::Torque, 800.0), (CommandKind::Position, 1000.0), (CommandKind::Velocity, 1000.0)]
    {
        let of = |frequency: f64| {
            TaskCase::of(HAND)
                .backend(backend)
                .set("robot.profile.a-med.estimator.velocity=\"filter\"")
                .set(format!("task.hand.gains.frequency_rad_per_s={frequency:?}"))
        };
        let lower = number_after(&of(frequency).only(code).help, "frequency_rad_per_s = ");
        of(frequency).is_helped(code, &[of(lower)]);
    }
}

/// Settings in the text of a remedy: `key = value` in back quotes, or after "write" with a quoted value.
fn settings(help: &str) -> Vec<String> {
    let quoted = help.split('`').skip(1).step_by(2).filter(|part| part.contains(" = "));
    let mut settings: Vec<String> = quoted.map(|setting| in_file(&setting.replacen(" = ", "=", 1))).collect();
    if let Some((_, written)) = help.split_once("write ") {
        let (key, value) = written.split_once(" = ").unwrap();
        settings.push(in_file(&format!("{key}={}", after(value, "\"").trim_end_matches('"'))));
    }
    settings
}

/// A key of robot.toml begins with `robot.` in a setting of a task; the key `gears` is in a table.
fn in_file(setting: &str) -> String {
    match setting.split('.').next().unwrap() {
        "profile" | "joint" => format!("robot.{setting}"),
        start if start.starts_with("gears") => format!("robot.interface.{setting}"),
        _ => setting.to_owned(),
    }
}

pub fn small_gain_margin(code: Code) {
    let found = |case: &TaskCase| {
        let experiment = case.experiment();
        gain_margin(&experiment).and_then(|margin| margin.finding(&experiment))
    };
    let led = |transformer: &str| {
        TaskCase::project("gravity-compensation")
            .set(format!("robot.profile.a-med.transformer={transformer}"))
    };
    let compliant = TaskCase::project("compliant-x")
        .set("robot.profile.a-med.transformer=emulation")
        .set("friction_compensation.gain=0.95");
    let damped = led("emulation").set("task.rest.joint-damping.damping_nms_per_rad=0.5");
    let elastic = TaskCase::of(HAND).set(ELASTIC).set("robot.profile.a-med.transformer=extrapolation");
    let mut kinds: Vec<String> = Vec::new();
    for case in [led("emulation"), damped, compliant, elastic] {
        let finding = found(&case).expect("a small margin");
        assert_eq!(finding.code, code);
        let remedies = settings(&finding.help);
        assert!(!remedies.is_empty(), "{}", finding.help);
        for setting in remedies {
            assert_eq!(found(&case.clone().set(&setting)), None, "{setting} of {}", finding.help);
            kinds.push(setting.split('=').next().unwrap().to_owned());
        }
    }
    for kind in ["transformer", "friction_compensation.gain", "damping_nms_per_rad"] {
        assert!(kinds.iter().any(|named| named.ends_with(kind)), "{kind} in {kinds:?}");
    }
}

pub fn unstable_simulation(code: Code) {
    let gain = |kp: f64| {
        TaskCase::project("gravity-compensation")
            .transformer("paper")
            .set(format!("robot.simulated.true_over_nominal.kp={kp:?}"))
    };
    let found = |case: &TaskCase| {
        let experiment = case.experiment();
        margins_with(&experiment, &experiment.transformer_name().unwrap()).unwrap().finding(&experiment)
    };
    let finding = found(&gain(2.9)).unwrap();
    assert_eq!(finding.code, code);
    let proposed = finding.help.split_whitespace().nth(2).unwrap().parse().unwrap();
    assert_eq!(found(&gain(proposed)), None, "{}", finding.help);
}

/// Finding about oscillation on elastic gears.
fn on_gears(case: &TaskCase) -> Option<Finding> {
    let experiment = case.experiment();
    gear_margin(&experiment)?.finding(&experiment)
}

pub fn gear_oscillation(code: Code) {
    let hold =
        |transformer: &str| TaskCase::of(HAND).set("task.hand.reference=\"hold\"").transformer(transformer);
    let declared = ASIMO.iter().zip([20e3, 12e3, 8e3, 5e3]).fold(
        hold("emulation+current"),
        |case, (joint, stiffness)| {
            case.set(format!("robot.joint.{joint}.gear_stiffness_nm_per_rad={stiffness:?}"))
        },
    );
    // A friction observer in place of a constant compensation, and the reverse.
    let cases = [
        hold("paper+current").set(ELASTIC),
        hold("emulation+current").set(ELASTIC),
        hold("emulation").set(ELASTIC).set("robot.interface.measured=[\"position\"]"),
        declared.clone(),
        TaskCase::project("follow-wall").transformer("extrapolation+current").set(ELASTIC),
    ];
    let mut named: Vec<&str> = Vec::new();
    for case in &cases {
        let finding = on_gears(case).expect("an oscillation");
        assert_eq!(finding.code, code);
        let help = &finding.help;
        let is_stable =
            |changed: TaskCase, what: &str| assert_eq!(on_gears(&changed), None, "{what} of {help}");
        if let Some((_, rest)) = help.split_once("use '") {
            let (transformer, _) = rest.split_once('\'').unwrap();
            is_stable(case.clone().transformer(transformer), transformer);
            named.push("transformer");
        }
        for setting in settings(help) {
            is_stable(case.clone().set(&setting), &setting);
            named.push(if setting.contains("observer_rad_per_s") { "observer" } else { "other" });
        }
        if help.contains("omit `friction_compensation.observer_rad_per_s`") {
            let present = case.experiment().task().file.friction_compensation.gain.get();
            is_stable(case.clone().set(format!("friction_compensation={{gain={present:?}}}")), "omitted");
            named.push("omitted");
        }
        if let Some((_, rest)) = help.split_once("lower the frequencies of the tasks to ") {
            let factor: f64 = rest.split(' ').next().unwrap().parse().unwrap();
            let lower = case
                .clone()
                .set(format!("task.hand.gains.frequency_rad_per_s={:?}", 14.0 * factor))
                .set(format!("task.rest.frequency_rad_per_s={:?}", 6.0 * factor));
            is_stable(lower, "lower");
            named.push("lower");
        }
    }
    for kind in ["transformer", "observer", "omitted"] {
        assert!(named.contains(&kind), "{kind} in {named:?}");
    }
    // A stiffness with which the gears are practically rigid.
    let stiff = ASIMO
        .iter()
        .fold(declared, |case, joint| case.set(format!("robot.joint.{joint}.gear_stiffness_nm_per_rad=4e5")));
    assert_eq!(on_gears(&stiff), None);
}

pub fn active_impedance(code: Code) {
    let found = |case: &TaskCase| {
        let experiment: Experiment = case.experiment();
        JointImpedance::finding(&impedances(&experiment).unwrap(), &experiment)
    };
    let soft = |transformer: &str| {
        TaskCase::of(HAND)
            .options(|options| options.profile = Some("b-soft".to_owned()))
            .set(ELASTIC)
            .transformer(transformer)
    };
    let late = soft("extrapolation+current").set("robot.profile.b-soft.delay_servo_ticks=5");
    let mut with_current = false;
    for case in [soft("emulation"), soft("emulation+current"), late] {
        let finding = found(&case).expect("an active joint");
        assert_eq!(finding.code, code);
        let (_, rest) = finding.help.split_once("use '").unwrap();
        let (transformer, _) = rest.split_once('\'').unwrap();
        assert_eq!(found(&case.clone().transformer(transformer)), None, "{}", finding.help);
        let remedies = settings(&finding.help);
        assert!(!remedies.is_empty(), "{}", finding.help);
        for setting in remedies {
            assert_eq!(found(&case.clone().set(&setting)), None, "{setting} of {}", finding.help);
            with_current |= setting.contains("servo_hz");
        }
    }
    assert!(with_current, "a faster interface helps where the correction by current is late");
}

pub fn feed_forward_impulse(code: Code) {
    let fed = TaskCase::of(HAND)
        .transformer("extrapolation")
        .set("robot.profile.a-med.servo.elbow.cascaded.velocity_feed_forward=1.0");
    let help = fed.only(code).help;
    let setpoints = help.split_once("setpoints = ").unwrap().1.split(')').next().unwrap();
    let none = number_after(&help, "velocity_feed_forward = ");
    fed.is_helped(
        code,
        &[
            fed.clone().set(format!("robot.interface.setpoints={setpoints}")),
            fed.clone()
                .set(format!("robot.profile.a-med.servo.elbow.cascaded.velocity_feed_forward={none:?}")),
        ],
    );
}

pub fn narrow_setpoint_limits(code: Code) {
    let of = |acceleration: f64| {
        TaskCase::of(HAND)
            .transformer("extrapolation")
            .set("robot.profile.a-med.setpoint_limits.reaction=\"clamp\"")
            .set(format!("robot.profile.a-med.setpoint_limits.joint.elbow={{ acceleration_rad_per_s2 = {acceleration:?} }}"))
    };
    let finding = only(code, &of(0.2).found());
    of(0.2).is_helped(code, &[of(number_after(&finding.help, "acceleration_rad_per_s2 = "))]);
}

pub fn slow_setpoint_filter(code: Code) {
    let filtered = |cutoff_hz: f64| {
        TaskCase::of(HAND).set(format!(
            "robot.profile.a-med.servo.elbow.cascaded.setpoint_filter={{ first-order = {{ cutoff_hz = {cutoff_hz:?} }} }}"
        ))
    };
    const INVERTED_HZ: f64 = 1.0;
    let times = number_after(&filtered(INVERTED_HZ).only(code).help, "make the filter ");
    filtered(INVERTED_HZ).is_helped(code, &[filtered(times * INVERTED_HZ)]);
    // One that the transformer does not invert.
    const IGNORED_HZ: f64 = 20.0;
    let ignored = |cutoff_hz: f64| filtered(cutoff_hz).transformer("paper");
    let help = ignored(IGNORED_HZ).only(code).help;
    let times = number_after(&help, "filter of the drives ");
    let named = help.split_once("--transformer ").unwrap().1.split('`').next().unwrap();
    ignored(IGNORED_HZ)
        .is_helped(code, &[ignored(times * IGNORED_HZ), filtered(IGNORED_HZ).transformer(named)]);
}

pub fn coarse_encoder(code: Code) {
    let counted = |counts: f64| {
        TaskCase::of(HAND).set(format!("robot.joint.elbow.rotor.encoder_counts_per_turn={counts:.0}"))
    };
    let finding = counted(200.0).only(code);
    counted(200.0).is_helped(code, &[counted(number_after(&finding.help, "motor: "))]);
}

pub fn coarse_setpoints(code: Code) {
    let rounded =
        |by_rad: f64| TaskCase::of(HAND).set(format!("robot.joint.elbow.setpoint_resolution_rad={by_rad:?}"));
    let finding = rounded(0.01).only(code);
    rounded(0.01).is_helped(code, &[rounded(number_after(&finding.help, "setpoint_resolution_rad: "))]);
}

pub fn overcompensated_friction(code: Code) {
    let of = |gain: f64| {
        TaskCase::of(HAND)
            .set("robot.simulated.true_over_nominal.friction=0.5")
            .set(format!("friction_compensation.gain={gain:?}"))
    };
    let finding = of(0.8).only(code);
    let observed = of(0.8).set("friction_compensation.observer_rad_per_s=60.0");
    assert!(observed.found().iter().all(|other| other.code != code), "the observer takes the surplus back");
    let enough = number_after(&finding.help, "friction_compensation.gain = ");
    assert!(enough <= 0.5 && enough > 0.45, "{enough}");
    of(0.8).is_helped(code, &[of(enough)]);
}
