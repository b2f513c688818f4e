//! `[driver]` of robot.toml on the command line: what is checked before anything is opened, and what is said about a robot.
#![expect(clippy::unwrap_used, reason = "a test")]

use crate::cli_common::{Ran, command, opspace, project, read, read_json, scratch};
use opspace_experiment::{Experiment, Files, RunOptions};
use opspace_feetech::simulated::{PseudoTerminal, bus_with_arm};
use serde_json::Value;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::Stdio;
use tempfile::TempDir;

/// Folder with the files of the SO-101, and its `[driver]` with replacements.
pub fn so101(replacements: &[(&str, &str)]) -> TempDir {
    let folder = scratch();
    for entry in fs::read_dir(project("examples/so101")).unwrap() {
        let path = entry.unwrap().path();
        fs::copy(&path, folder.path().join(path.file_name().unwrap())).unwrap();
    }
    let robot = folder.path().join("robot.toml");
    let mut text = fs::read_to_string(&robot).unwrap();
    for (from, to) in replacements {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, to);
    }
    fs::write(robot, text).unwrap();
    folder
}

/// Calibration of all five joints, as a text to be changed.
const CALIBRATION: &str = r#"{
    "shoulder_pan": {"id": 1, "drive_mode": 0, "homing_offset": 0, "range_min": 800, "range_max": 3300},
    "shoulder_lift": {"id": 2, "drive_mode": 0, "homing_offset": 0, "range_min": 800, "range_max": 3300},
    "elbow_flex": {"id": 3, "drive_mode": 0, "homing_offset": 0, "range_min": 800, "range_max": 3300},
    "wrist_flex": {"id": 4, "drive_mode": 0, "homing_offset": 0, "range_min": 800, "range_max": 3300},
    "wrist_roll": {"id": 5, "drive_mode": 0, "homing_offset": 0, "range_min": 800, "range_max": 3300}
}"#;

fn check(folder: &TempDir, file: &str) -> Ran {
    opspace(folder.path(), &["check", file])
}

/// A calibration or a port that is not there yet is a warning; with both there is none.
#[test]
fn check_warns_of_a_port_and_a_calibration_that_are_absent() {
    let folder = so101(&[("/dev/ttyACM0", "port")]);
    for file in ["hold-and-yield.toml", "robot.toml"] {
        let ran = check(&folder, file).exits(0);
        ran.prints(&[
            "so101.json",
            "lerobot-calibrate",
            "port does not exist",
            "[driver-doubt]",
            "robot.toml:6",
        ]);
    }
    fs::write(folder.path().join("so101.json"), CALIBRATION).unwrap();
    fs::write(folder.path().join("port"), "").unwrap();
    for file in ["hold-and-yield.toml", "robot.toml"] {
        let ran = check(&folder, file).exits(0);
        assert!(!ran.stdout.contains("driver-doubt"), "{}", ran.stdout);
    }
}

/// Values that the driver would refuse are errors of `check` and of `run`, at their line, before anything is opened or written.
#[test]
fn wrong_settings_of_a_driver_are_errors_at_their_line() {
    let cases: [(&str, &str, &[&str]); 6] = [
        ("i = 0", "i = 0\nbaudrate = 1000000", &["unknown key 'baudrate'", "the keys are: port, baud_hz"]),
        (
            "i = 0",
            "i = 0\ngoal_sped_rad_per_s = 1.0",
            &["unknown key 'goal_sped_rad_per_s'", "did you mean `goal_speed_rad_per_s`?"],
        ),
        ("\np = 16", "\np = 300", &["'p' is the content of a register, a whole number of 0 to 255, not 300"]),
        ("d = 32", "d = \"32\"", &["'d' must be a number, not \"32\""]),
        ("d = 32", "d = 32\nat_end = \"drop\"", &["'at_end' must be \"hold\" or \"lower\", not \"drop\""]),
        ("i = 0", "", &["the key 'i' is missing"]),
    ];
    for (from, to, words) in cases {
        let folder = so101(&[(from, to)]);
        let place = &["robot.toml:"][..];
        for file in ["hold-and-yield.toml", "robot.toml"] {
            check(&folder, file).exits(2).says(words).says(place);
        }
        opspace(folder.path(), &["run", "hold-and-yield.toml"]).exits(2).says(words).says(place);
        assert!(!folder.path().join("runs").exists());
        opspace(folder.path(), &["run", "hold-and-yield.toml", "--simulate", "--duration-s", "1.0"]).exits(0);
    }
}

#[test]
fn wrong_calibrations_are_errors_of_check() {
    let folder = so101(&[]);
    for (from, to, words) in [
        ("\"wrist_flex\"", "\"wrist\"", "has no motor 'wrist_flex' for joint 'wrist_flex'; its motors are:"),
        ("\"range_max\": 3300", "\"range_max\": 800", "range_max is 800"),
        ("{", "", "not a calibration of LeRobot"),
    ] {
        fs::write(folder.path().join("so101.json"), CALIBRATION.replacen(from, to, 1)).unwrap();
        check(&folder, "hold-and-yield.toml").exits(2).says(&[words, "robot.toml:", "so101.json"]);
    }
}

/// An unknown name is an error of `check` and of `run`, as every unknown name is; simulations do without a driver, and so do suites.
#[test]
fn unknown_driver_is_an_error_with_the_names_of_the_others() {
    let folder = so101(&[("name = \"feetech\"", "name = \"feetec\"")]);
    let words = [
        "no driver 'feetec'",
        "did you mean 'feetech'? There are: feetech",
        "[missing-driver]",
        "robot.toml:",
    ];
    for file in ["hold-and-yield.toml", "robot.toml"] {
        check(&folder, file).exits(2).says(&words);
        opspace(folder.path(), &["check", file, "--simulate"]).exits(0);
    }
    opspace(folder.path(), &["run", "hold-and-yield.toml"]).exits(2).says(&words);
    assert!(!folder.path().join("runs").exists());
    let suite =
        "title = \"x\"\n[[run]]\ntasks = [\"hold-and-yield.toml\"]\nrobot = \".\"\nbackend = \"position\"\n";
    fs::write(folder.path().join("suite.toml"), suite).unwrap();
    check(&folder, "suite.toml").exits(0);
    for (from, to, words) in [
        ("name = \"feetec\"", "name = 3", "`name` must be a string, the name of a driver"),
        ("name = 3\n", "", "[driver] has no `name`"),
    ] {
        let robot = folder.path().join("robot.toml");
        fs::write(&robot, read(&robot).replace(from, to)).unwrap();
        check(&folder, "robot.toml").exits(2).says(&[words, "there are: feetech", "robot.toml:"]);
    }
}

/// The robots of an experiment, and another interface than that of robot.toml: `check` examines what a run would open.
#[test]
fn check_examines_the_drivers_that_a_run_opens() {
    let folder = scratch();
    let set = r#"robots.follower.set=["robot.driver.name=\"feetec\""]"#;
    let experiment = project("tasks/experiments/teleop-free.toml");
    for command in ["check", "run"] {
        let arguments = [command, &experiment, "--set", set];
        opspace(folder.path(), &arguments).exits(2).says(&["no driver 'feetec'", "did you mean 'feetech'?"]);
    }
    opspace(folder.path(), &["check", &experiment, "--set", set, "--simulate"]).exits(0);

    let folder = so101(&[]);
    let words = ["servos of this bus accept joint positions, not torques", "robot.toml:"];
    for command in ["check", "run"] {
        let arguments = [command, "hold-and-yield.toml", "--backend", "torque"];
        opspace(folder.path(), &arguments).exits(2).says(&words);
        if command == "check" {
            opspace(folder.path(), &[&arguments[..], &["--simulate"]].concat()).exits(0);
        }
    }
}

/// Mistakes that refuse every run are errors of `check`: limits that the robot keeps to and robot.toml does not state, and keys of the
/// control thread. By hand: 58 bytes at 38400 baud need 15.1 ms at least, of 7 ms; 254 times 100 counts/s² are 38.96 rad/s².
#[test]
fn what_refuses_every_run_is_an_error_of_check() {
    let cases: [(&str, &[&str]); 5] = [
        (
            "goal_speed_rad_per_s = 2.0",
            &["setpoint velocity limit of joint 'shoulder_pan'", "the robot itself keeps to 2"],
        ),
        (
            "baud_hz = 38400",
            &["bus slower than the rate asked", "at 38400 baud; at 100 Hz they may need 7.0 ms"],
        ),
        ("acceleration_rad_per_s2 = 39.1", &["'acceleration_rad_per_s2' must be at most 38.96"]),
        ("real_time = \"on\"", &["no scheduling is called 'on'", "auto", "required", "off"]),
        ("real_time_priority = 100", &["`real_time_priority` must be an integer from 1 to 99"]),
    ];
    for (line, words) in cases {
        let folder = so101(&[("i = 0", &format!("i = 0\n{line}"))]);
        fs::write(folder.path().join("so101.json"), CALIBRATION).unwrap();
        for command in ["check", "run"] {
            let arguments = [command, "hold-and-yield.toml"];
            opspace(folder.path(), &arguments).exits(2).says(words).says(&["robot.toml:"]);
        }
        assert!(!folder.path().join("runs").exists(), "{line}");
    }
}

/// By hand: twice the gain of a proportional servo is twice its stiffness, 2 · 8.9 Nm/rad.
#[test]
fn gain_that_the_stiffness_does_not_belong_to_is_refused() {
    let folder = so101(&[("\np = 16", "\np = 32")]);
    let words = [
        "p = 32, but the stiffness in [profile], 8.9 Nm/rad, is stated for P = 16; at P = 32 it would be 17.8 Nm/rad",
        "stiffness_at_p = 32, or p = 16",
        "robot.toml:",
    ];
    check(&folder, "hold-and-yield.toml").exits(2).says(&words);
    opspace(folder.path(), &["run", "hold-and-yield.toml"]).exits(2).says(&words);
    let both = so101(&[
        ("\np = 16", "\np = 32"),
        ("at_p = 16", "at_p = 32"),
        ("stiffness_nm_per_rad = 8.9", "stiffness_nm_per_rad = 17.8"),
    ]);
    check(&both, "hold-and-yield.toml").exits(0);
}

#[test]
fn gains_that_the_model_does_not_have_are_warned_of() {
    let folder = so101(&[("\ni = 0", "\ni = 5")]);
    check(&folder, "hold-and-yield.toml")
        .exits(0)
        .prints(&["i = 5, but the servos of [profile] have no integral"]);
    let folder = so101(&[("stiffness_at_p = 16\n", "")]);
    check(&folder, "hold-and-yield.toml")
        .exits(0)
        .prints(&["nothing says for which P", "state stiffness_at_p"]);
}

/// Serves the arm of a task of the folder behind a pseudo-terminal at the port that robot.toml states, with its calibration.
pub fn serve(folder: &TempDir, task: &str) -> PseudoTerminal {
    let path = folder.path().join(task);
    let experiment = Experiment::load(Files::Disk, &path, None, RunOptions::default(), &[])
        .unwrap_or_else(|error| panic!("{error}"));
    let settings = experiment.driver_settings();
    let bus = bus_with_arm(&settings, experiment.simulated_devices().unwrap());
    let terminal = PseudoTerminal::open(bus.unwrap_or_else(|error| panic!("{error}"))).unwrap();
    terminal.with_link(Path::new(settings.text("port").unwrap())).unwrap()
}

/// Folder of the SO-101 whose port is in the folder itself; a busy machine may keep its servos silent for two seconds.
pub fn so101_at_a_link() -> TempDir {
    let folder = so101(&[]);
    let link = folder.path().join("port");
    let robot = folder.path().join("robot.toml");
    let text = read(&robot).replace("/dev/ttyACM0", link.to_str().unwrap());
    fs::write(&robot, text + "silence_s = 2.0\n").unwrap();
    let text = read(&robot).replace("tare_s = 0.2", "tare_s = 0.2\nmax_dropout_s = 2.0");
    fs::write(&robot, text).unwrap();
    folder
}

/// By hand: hold-and-yield starts at shoulder_lift -0.3 rad, 171.9 or 2048 - 195.6 counts.
#[test]
fn read_prints_angles_and_counts_and_marks_what_is_outside_limits() {
    let folder = so101_at_a_link();
    let text = read(folder.path().join("hold-and-yield.toml"));
    let terminal = serve(&folder, "hold-and-yield.toml");
    let lift = text.lines().find(|line| line.starts_with("start_rad")).unwrap();
    let lift: f64 = lift
        .split("shoulder_lift = ")
        .nth(1)
        .unwrap()
        .split([',', ' ', '}'])
        .next()
        .unwrap()
        .parse()
        .unwrap();
    for file in ["robot.toml", "hold-and-yield.toml"] {
        let arguments = ["driver", "read", file, "--duration-s", "0.3"];
        let ran = (0..10).map(|_| opspace(folder.path(), &arguments)).find(|ran| ran.code == 0).unwrap();
        let line = ran.stdout.lines().next().unwrap();
        // One line for each table, without control characters.
        assert!(ran.stdout.lines().all(|line| line.contains(" s: shoulder_pan ")), "{}", ran.stdout);
        assert!(!ran.stdout.contains('\x1b'), "{}", ran.stdout);
        for part in ["shoulder_pan ", " rad (", "°), ", " counts; ", "7.4 V, 30 °C, torque on"] {
            assert!(line.contains(part), "{part}: {line}");
        }
        let read_lift = line.split("shoulder_lift ").nth(1).unwrap().split(' ').next().unwrap();
        assert!((read_lift.parse::<f64>().unwrap() - lift).abs() < 0.003, "{line}");
        assert!(!line.contains("OUTSIDE"), "{line}");
    }
    // The same posture with a zero that is wrong by 2.5 rad.
    let robot = folder.path().join("robot.toml");
    fs::write(&robot, read(&robot) + "zeros_rad = { shoulder_lift = 2.5 }\n").unwrap();
    let arguments = ["driver", "read", "robot.toml", "--duration-s", "0.3"];
    let ran = (0..10).map(|_| opspace(folder.path(), &arguments)).find(|ran| ran.code == 0).unwrap();
    assert!(ran.stdout.contains("OUTSIDE its limits"), "{}", ran.stdout);
    drop(terminal);
    opspace(folder.path(), &arguments).exits(2).says(&["port", "robot.toml:"]);
}

/// First lines of a run: what it runs on. `--simulate`, no `[driver]`, and a driver.
#[test]
fn run_says_whether_the_robot_is_simulated() {
    let folder = so101_at_a_link();
    let run = ["run", "hold-and-yield.toml", "--duration-s", "1.0", "--out", "out", "--force"];
    let simulated = opspace(folder.path(), &[&run[..], &["--simulate"]].concat()).exits(0);
    let ran = simulated.says(&["hold-and-yield (simulated: --simulate asks for it) starts at"]);
    ran.prints(&[", simulated\n"]);
    let other = ["run", &project("tasks/compliant-x.toml"), "--duration-s", "2", "--out", "other"];
    opspace(folder.path(), &other).exits(0).says(&["(simulated: robot.toml has no [driver])"]);
}

/// A run on a driver: the motion before it, and after it a verdict without tables, the state of the arm, and how it is let go of. A
/// busy machine misses cycles, for which a run may fail.
#[test]
fn run_on_a_driver_is_for_its_owner() {
    let folder = so101_at_a_link();
    // Without the table: nothing acts on the arm on its way.
    let terminal = serve(&folder, "press.toml");
    let run = ["run", "press.toml", "--duration-s", "1.0", "--out", "out", "--force"];
    let settings = ["--set", "settle_s=0.2", "--set", "environment={}", "--move-to-start"];
    let away = ["--set", "start_rad.shoulder_pan=0.1"];
    let run = |options: &[&str]| {
        let arguments = [&run[..], &settings, &away, options].concat();
        let ends = || {
            (0..5).map(|_| opspace(folder.path(), &arguments)).find(|ran| {
                ran.code < 2 && ["completed 1 s", "out\n"].iter().any(|end| ran.stdout.contains(end))
            })
        };
        ends().unwrap_or_else(|| opspace(folder.path(), &arguments).exits(0))
    };
    let ran = run(&[]);
    let ran = ran.says(&[
        "(on the real robot: driver 'feetech', port ",
        "moves to the start of the task within 2 s",
        "torque stays on, and the arm holds its last position: `opspace driver read ROBOT --release`",
    ]);
    let ran = ran.prints(&["completed 1 s", "missed cycles: ", "`-v` prints the tables"]);
    assert!(!ran.stdout.contains("───"), "{}", ran.stdout);
    // The numbers are those of the summary.
    let summary = read_json(folder.path().join("out/summary.json"));
    let number = |value: &Value| value.as_u64().unwrap_or_else(|| panic!("{summary}"));
    let (late, cycles) =
        (number(&summary["real_time"]["late_cycles"]), number(&summary["real_time"]["cycles"]));
    assert!(cycles > 0);
    let late = match late {
        0 => format!("no command of {cycles} was late"),
        _ => format!("{late} of {cycles} commands were late"),
    };
    let missed = format!("missed cycles: {} of ", number(&summary["missed_cycles"]));
    for line in [late, missed] {
        assert_eq!(
            ran.stdout.lines().filter(|said| said.starts_with(&line)).count(),
            1,
            "{line}: {}",
            ran.stdout
        );
    }
    let ran = run(&["--quiet"]);
    let mut lines: Vec<&str> = ran.stdout.lines().collect();
    assert_eq!((lines.pop(), ran.stderr.as_str()), (Some("out"), ""));
    assert!(lines.iter().all(|line| line.starts_with("FAILED ")), "{lines:?}");
    drop(terminal);
}

/// The calibration of a simulated arm is announced where it is new, and one that exists stays as it is.
#[test]
fn simulated_bus_announces_the_calibration_that_it_writes() {
    let folder = so101_at_a_link();
    let link = folder.path().join("port");
    let simulate = || {
        let arguments = ["driver", "simulate", "hold-and-yield.toml", "--link", link.to_str().unwrap()];
        let mut child = command(folder.path(), &[&arguments[..], &["--duration-s", "0.2"]].concat())
            .stderr(Stdio::piped())
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        let said: Vec<String> =
            BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap).collect();
        assert!(child.wait().unwrap().success(), "{said:?}");
        said.join("\n")
    };
    let said = simulate();
    assert!(said.contains("so101.json: the calibration of the simulated arm"), "{said}");
    let calibration = folder.path().join("so101.json");
    assert!(read(&calibration).contains("shoulder_lift"));
    fs::write(&calibration, CALIBRATION).unwrap();
    assert!(!simulate().contains("calibration"));
    assert_eq!(read(&calibration), CALIBRATION);
}

/// A spring that presses on a table is no spring that friction holds.
#[test]
fn spring_that_presses_is_not_held_by_friction() {
    let folder = so101(&[]);
    let ran = opspace(folder.path(), &["run", "press.toml", "--simulate", "--out", "out"]).exits(0);
    let note =
        ran.stdout.lines().find(|line| line.contains("[spring-deflected]")).unwrap_or_default().to_owned();
    assert!(
        note.contains("pulls with ") && note.contains("against 'table'") && !note.contains("friction"),
        "{note}"
    );
}

/// An arm that lies on its end stops is slightly outside the limits of the URDF: it moves to its start from there.
#[test]
fn motion_to_the_start_begins_slightly_outside_of_limits() {
    let task = project("examples/so101/hold-and-yield.toml");
    let experiment = Experiment::load(Files::Disk, Path::new(&task), None, RunOptions::default(), &[]);
    let experiment = experiment.unwrap_or_else(|error| panic!("{error}"));
    let upper = experiment.robot().model.joints()[1].limits.upper;
    let from = |lift: f64| experiment.motion_to_start(&[0.0, lift, 0.4, 0.5, 0.0]);
    assert!(from(upper + 0.005).unwrap_or_else(|error| panic!("{error}")).is_some());
    let error = from(upper + 0.05).err().unwrap();
    assert!(error.message().contains("joint 'shoulder_lift' is at 1.795"), "{error}");
    assert!(error.help().unwrap().contains("opspace driver read"));
}
