//! Robots of which only the URDF is known: `opspace new --assume`, `check` and `run` without a value written by hand.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use crate::cli_common::{opspace, project, read, read_json, scratch};
use opspace_experiment::{Files, RobotDefinition};
use opspace_log::Recording;
use opspace_model::{Data, forward_kinematics, frame_placement};
use opspace_testing::random::Random;
use opspace_transformer::ServoParameters;
use std::fmt::Write as _;
use std::fs;

/// Largest error of the tip's displacement, as a fraction of it, and m, with gains that are known exactly.
const TOLERANCE: (f64, f64) = (0.06, 0.003);

/// Largest error with assumed gains, which leave damping to the joints.
const WITH_ASSUMED_GAINS: (f64, f64) = (0.3, 0.003);

/// URDF of a random tree of this many joints in its trunk: revolute, continuous, prismatic and fixed joints, with and
/// without branches, limits of effort and velocity, and friction.
fn random_urdf(random: &mut Random, joints: usize) -> String {
    let mut text = "<robot name=\"random\"><link name=\"base\"/>".to_owned();
    let (mut parent, mut length, mut axis) = ("base".to_owned(), 0.1, 2);
    for i in 0..joints {
        axis = (axis + 1 + usize::from(random.is(0.5))) % 3;
        let name = format!("l{i}");
        joint(&mut text, random, &format!("j{i}"), [&parent, &name], length, axis);
        length = random.between(0.08, 0.4);
        link(&mut text, &name, length, random.between(0.3, 5.0) * (1.0 - i as f64 / (joints as f64 + 1.0)));
        if random.is(0.25) {
            joint(&mut text, random, &format!("b{i}"), [&name, &format!("bl{i}")], 0.5 * length, 1);
            link(&mut text, &format!("bl{i}"), 0.1, 0.3);
        }
        if random.is(0.2) {
            let _ = write!(
                text,
                "<joint name=\"f{i}\" type=\"fixed\"><parent link=\"{name}\"/><child link=\"fl{i}\"/></joint>"
            );
            link(&mut text, &format!("fl{i}"), 0.05, 0.1);
        }
        parent = name;
    }
    let _ = write!(
        text,
        "<joint name=\"end\" type=\"fixed\"><parent link=\"{parent}\"/><child link=\"tip\"/>\
         <origin xyz=\"0 0 {length}\"/></joint><link name=\"tip\"/></robot>"
    );
    text
}

fn link(text: &mut String, name: &str, length: f64, mass: f64) {
    let (across, along) = (mass * (length * length / 12.0 + 0.0005), mass * 0.0008);
    let _ = write!(
        text,
        "<link name=\"{name}\"><inertial><origin xyz=\"0 0 {}\"/><mass value=\"{mass}\"/><inertia ixx=\"{across}\" \
         iyy=\"{across}\" izz=\"{along}\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial></link>",
        0.5 * length
    );
}

fn joint(
    text: &mut String,
    random: &mut Random,
    name: &str,
    [parent, child]: [&str; 2],
    at: f64,
    axis: usize,
) {
    let kind = match random.next() {
        x if x < 0.7 => "revolute",
        x if x < 0.85 => "prismatic",
        _ => "continuous",
    };
    let range = match kind {
        "revolute" => {
            format!(" lower=\"{}\" upper=\"{}\"", -random.between(0.5, 3.0), random.between(1.0, 3.1))
        }
        "prismatic" => format!(" lower=\"0\" upper=\"{}\"", random.between(0.2, 0.6)),
        _ => String::new(),
    };
    let effort =
        if random.is(0.5) { format!(" effort=\"{}\"", random.between(20.0, 200.0)) } else { String::new() };
    let speed =
        if random.is(0.7) { format!(" velocity=\"{}\"", random.between(0.5, 5.0)) } else { String::new() };
    let axis = ["1 0 0", "0 1 0", "0 0 1"][axis];
    let _ = write!(
        text,
        "<joint name=\"{name}\" type=\"{kind}\"><parent link=\"{parent}\"/><child link=\"{child}\"/>\
         <origin xyz=\"0 0 {at}\"/><axis xyz=\"{axis}\"/><limit{range}{effort}{speed}/>"
    );
    if random.is(0.4) {
        let (damping, friction) = (random.between(0.0, 1.0), random.between(0.0, 0.5));
        let _ = write!(text, "<dynamics damping=\"{damping}\" friction=\"{friction}\"/>");
    }
    *text += "</joint>";
}

/// Makes the files of a robot, checks them, and runs the task. Compared: the displacement of the true tip, from the logged
/// positions by forward kinematics, and that which `new` announced.
#[track_caller]
fn runs_without_a_value(urdf: &str, about: &str) {
    let folder = scratch();
    let at = |path: &str| folder.path().join(path);
    fs::write(at("robot.urdf"), urdf).unwrap();
    let said = opspace(folder.path(), &["new", "mine", "--urdf", "robot.urdf", "--assume"]).exits(0).stdout;
    assert!(read(at("mine/first-task.toml")).contains("friction_compensation = { gain = 0.8 }"), "{about}");
    let checked = opspace(folder.path(), &["check", "mine", "mine/first-task.toml"]).exits(0).stdout;
    assert!(checked.contains("assumed values: "), "{about}: {checked}");
    let run = opspace(folder.path(), &["run", "mine/first-task.toml", "--out", "out"]).exits(0);
    let robot = RobotDefinition::load(Files::Disk, &at("mine"), &[]).unwrap();
    let settings = exact_gains(&robot);
    let mut exact = vec!["run", "mine/first-task.toml", "--out", "exact"];
    settings.iter().for_each(|setting| exact.extend(["--set", setting]));
    opspace(folder.path(), &exact).exits(0);
    assert!(run.stdout.contains("ASSUMED robot 'mine' has "), "{about}: {}", run.stdout);
    let summary = read_json(at("out/summary.json"));
    assert!(summary["assumed"].as_array().is_some_and(|keys| !keys.is_empty()), "{about}");
    assert!(read(at("out/report.html")).contains("rest on assumed values"), "{about}");

    let (_, rest) = said.split_once("moves it by ").unwrap_or_else(|| panic!("{about}: {said}"));
    let words: Vec<&str> = rest.split([' ', ',']).collect();
    let (asked_m, axis): (f64, usize) =
        (words[0].parse().unwrap(), ["x", "y", "z"].iter().position(|name| *name == words[3]).unwrap());
    let time_s: f64 = words[5].parse().unwrap();
    let (_, name) = said.split_once("The tip '").unwrap();
    let name = name.split('\'').next().unwrap();
    for (out, tolerance) in [("out", WITH_ASSUMED_GAINS), ("exact", TOLERANCE)] {
        let log = Recording::read(at(out).join("run.mcap")).unwrap();
        check_displacement(&robot, &log, name, (asked_m, axis, time_s), tolerance, about);
    }
}

/// Settings with which the gains of the servos are known exactly.
fn exact_gains(robot: &RobotDefinition) -> Vec<String> {
    let servos = robot.profile(None).unwrap().1.servo.iter();
    let of = |(joint, servo): (&String, &ServoParameters)| {
        let kind = if matches!(servo, ServoParameters::Pid(_)) { "pid" } else { "cascaded" };
        format!("robot.profile.default.servo.{joint}.{kind}.gain_uncertainty=0.0")
    };
    servos.map(of).collect()
}

/// Checks the displacement of the tip `name` along an axis: `asked_m` after `time_s`, and none after twice this time.
#[track_caller]
fn check_displacement(
    robot: &RobotDefinition,
    log: &Recording,
    name: &str,
    (asked_m, axis, time_s): (f64, usize, f64),
    tolerance: (f64, f64),
    about: &str,
) {
    let tick = log.channel("tick").unwrap();
    let q = tick.signal("q").unwrap();
    let mut data = Data::new(&robot.model);
    let mut place = |row: usize| {
        forward_kinematics(&robot.model, &mut data, q.row(row));
        frame_placement(&robot.model, &data, robot.model.frame_id(name).unwrap()).translation[axis]
    };
    // Before control begins, the robot rests for `tare_s`.
    let (rows, hz) = (tick.len(), 1.0 / robot.profile(None).unwrap().1.period_s());
    let begin = rows - 1 - ((2.0 * time_s + 1.0) * hz) as usize;
    let (start, out, end) = (place(begin), place(begin + (time_s * hz) as usize), place(rows - 1));
    let tolerance_m = tolerance.0 * asked_m.abs() + tolerance.1;
    assert!((out - start - asked_m).abs() < tolerance_m, "{about}: {} of {asked_m} m", out - start);
    assert!((end - start).abs() < tolerance_m, "{about}: returned to {} m", end - start);
}

#[test]
fn random_robots_run_without_a_value() {
    let mut random = Random(1);
    for joints in [1, 3, 5, 7] {
        let urdf = random_urdf(&mut random, joints);
        runs_without_a_value(&urdf, &urdf);
    }
}

/// Three robots; `OPSPACE_SEED` draws others.
#[test]
fn robots_of_a_seed_run_without_a_value() {
    let seed = std::env::var("OPSPACE_SEED").map_or(3, |seed| seed.parse().unwrap());
    let mut random = Random(seed);
    for _ in 0..3 {
        let joints = random.between(1.0, 8.0) as usize;
        let urdf = random_urdf(&mut random, joints);
        runs_without_a_value(&urdf, &format!("OPSPACE_SEED={seed}: {urdf}"));
    }
}

/// A template brings an arm to a running task: values of a URDF with other names of joints, in the order of its chain.
#[test]
fn robot_with_the_values_of_a_template_runs() {
    let folder = scratch();
    let at = |path: &str| folder.path().join(path);
    // The UR5 of its manual: offsets and lengths by Denavit and Hartenberg, masses and centres of the links.
    let links: [([f64; 3], &str, f64); 6] = [
        ([0.0, 0.0, 0.089_159], "0 0 1", 3.7),
        ([0.0, 0.135_85, 0.0], "0 1 0", 8.393),
        ([0.0, -0.119_7, 0.425], "0 1 0", 2.275),
        ([0.0, 0.0, 0.392_25], "0 1 0", 1.219),
        ([0.0, 0.093, 0.0], "0 0 1", 1.219),
        ([0.0, 0.0, 0.094_65], "0 1 0", 0.187_9),
    ];
    let mut urdf = "<robot name=\"arm\"><link name=\"l0\"/>".to_owned();
    for (i, ([x, y, z], axis, mass)) in links.into_iter().enumerate() {
        let child = i + 1;
        let _ = write!(
            urdf,
            "<joint name=\"q{child}\" type=\"revolute\"><parent link=\"l{i}\"/><child link=\"l{child}\"/>\
             <origin xyz=\"{x} {y} {z}\"/><axis xyz=\"{axis}\"/>\
             <limit lower=\"-6.28\" upper=\"6.28\" effort=\"1\" velocity=\"1\"/></joint>"
        );
        link(&mut urdf, &format!("l{child}"), if i == 1 { 0.4 } else { 0.1 }, mass);
    }
    fs::write(at("arm.urdf"), urdf + "</robot>").unwrap();
    let wrong = opspace(folder.path(), &["new", "mine", "--urdf", "arm.urdf", "--like", "ur10"]).exits(2);
    wrong.says(&[
        "axes of 'q2' and 'q3' are 0.425 m apart, not 0.612 m",
        "template 'ur5' (Universal Robots UR5 (CB3)) fits",
    ]);
    let listed = opspace(folder.path(), &["new", "--like"]).exits(0).stdout;
    for name in
        ["ur3", "ur5e", "ur10", "xarm7", "panda", "fr3", "gen3", "so101", "so101-12v", "vx300s", "j2s6s200"]
    {
        assert!(listed.lines().any(|line| line.starts_with(&format!("{name} "))), "{listed}");
    }
    opspace(folder.path(), &["new", "mine", "--urdf", "arm.urdf", "--like", "ur6"])
        .exits(2)
        .says(&["did you mean"]);
    opspace(folder.path(), &["new", "mine", "--like", "ur5"]).exits(2).says(&["--urdf"]);
    let anyway = ["new", "anyway", "--urdf", "arm.urdf", "--like-anyway", "j2s6s200"];
    opspace(folder.path(), &anyway).exits(0);
    let assumed = fs::read_to_string(at("anyway/robot.toml")).unwrap();
    assert!(assumed.contains("command = \"velocity\"") && !assumed.contains("[P]"), "{assumed}");
    opspace(folder.path(), &["check", "anyway", "anyway/first-task.toml"]).exits(0);

    let said =
        opspace(folder.path(), &["new", "mine", "--urdf", "arm.urdf", "--like", "ur5"]).exits(0).stdout;
    assert!(
        said.contains("first-task.toml moves it by ") && said.contains("keeps its orientation"),
        "{said}"
    );
    let checked = opspace(folder.path(), &["check", "mine", "mine/first-task.toml"]).exits(0);
    assert_eq!(checked.stderr, "");
    assert!(checked.stdout.contains("\n  no problems found\n"), "{}", checked.stdout);
    assert!(checked.stdout.contains("assumed values: interface.gears"), "{}", checked.stdout);
    opspace(folder.path(), &["run", "mine/first-task.toml", "--out", "out"]).exits(0);
    let summary = read_json(at("out/summary.json"));
    let error_m = summary["metrics"]["position_rms_m"].as_f64().unwrap();
    assert!(error_m < 0.005, "{error_m} m");
}

/// `OPSPACE_SEED=7 cargo test --test all many_random_robots -- --ignored` draws others; `OPSPACE_ROBOTS` is their number.
#[test]
#[ignore = "more than ten seconds"]
fn many_random_robots_run_without_a_value() {
    let seed = std::env::var("OPSPACE_SEED").map_or(2, |seed| seed.parse().unwrap());
    let mut random = Random(seed);
    let robots = std::env::var("OPSPACE_ROBOTS").map_or(20, |robots| robots.parse().unwrap());
    for _ in 0..robots {
        let joints = random.between(1.0, 9.0) as usize;
        let urdf = random_urdf(&mut random, joints);
        runs_without_a_value(&urdf, &urdf);
    }
}

/// A value that is known is no longer listed once its entry is removed.
#[test]
fn removed_entry_is_no_longer_assumed() {
    let folder = scratch();
    fs::write(folder.path().join("robot.urdf"), random_urdf(&mut Random(3), 2)).unwrap();
    opspace(folder.path(), &["new", "mine", "--urdf", "robot.urdf", "--assume"]).exits(0);
    let path = folder.path().join("mine/robot.toml");
    let text = read(&path);
    assert!(text.contains("\"joint.j0.rotor\", "), "{text}");
    fs::write(&path, text.replace("\"joint.j0.rotor\", ", "")).unwrap();
    let checked = opspace(folder.path(), &["check", "mine", "-v"]).exits(0).stdout;
    assert!(!checked.contains("rotor of j0") && checked.contains("friction of j0"), "{checked}");
    fs::write(&path, text.replace("\"joint.j0.rotor\"", "\"joint.j0.rotr\"")).unwrap();
    opspace(folder.path(), &["check", "mine"]).exits(2).says(&[
        "`joint.j0.rotr` is marked as assumed",
        "has no key `rotr`",
        "did you mean 'rotor'",
    ]);
}

/// The tip of an arm is before its gripper: one jaw with a joint of its own, or two fingers. An arm whose joints have other names
/// ends at its last link.
#[test]
fn gripper_is_not_the_tip() {
    let arm = |hand: &str| {
        let mut urdf = "<robot name=\"arm\"><link name=\"l0\"/>".to_owned();
        for i in 1..=5 {
            let (parent, axis) = (format!("l{}", i - 1), ["0 0 1", "0 1 0"][usize::from(i % 2 == 0)]);
            let _ = write!(
                urdf,
                "<joint name=\"q{i}\" type=\"revolute\"><parent link=\"{parent}\"/><child link=\"l{i}\"/><origin xyz=\"0 0.02 0.2\"/>\
                 <axis xyz=\"{axis}\"/><limit lower=\"-2\" upper=\"2\" effort=\"60\" velocity=\"2\"/></joint>"
            );
            link(&mut urdf, &format!("l{i}"), 0.2, 1.0);
        }
        urdf + hand + "</robot>"
    };
    let moving = |kind: &str, name: &str, child: &str, at: f64| {
        let mut text = format!(
            "<joint name=\"{name}\" type=\"{kind}\"><parent link=\"l5\"/><child link=\"{child}\"/><origin xyz=\"0 {at} 0.1\"/>\
             <axis xyz=\"1 0 0\"/><limit lower=\"0\" upper=\"0.5\" effort=\"10\" velocity=\"1\"/></joint>"
        );
        link(&mut text, child, 0.05, 0.1);
        text
    };
    let jaw = moving("revolute", "jointGripper", "mover", 0.0);
    let fingers = moving("prismatic", "a", "left", 0.02) + &moving("prismatic", "b", "right", -0.02);
    let wrist = moving("revolute", "q6", "l6", 0.0);
    let cases = [
        (jaw, "The tip 'l5'", Some("joint 'jointGripper' is taken for that of a gripper: the tip is 'l5'")),
        (fingers, "The tip 'l5'", Some("joints 'a', 'b' are taken for those of a gripper: the tip is 'l5'")),
        (wrist, "The tip 'l6'", None),
    ];
    for (hand, tip, note) in cases {
        let folder = scratch();
        fs::write(folder.path().join("arm.urdf"), arm(&hand)).unwrap();
        let made = |options: &[&str]| {
            let arguments = [&["new", "mine", "--urdf", "arm.urdf", "--assume"], options].concat();
            opspace(folder.path(), &arguments).exits(0).stdout
        };
        let said = made(&[]);
        assert!(said.contains(tip), "{said}");
        assert!(said.contains("NOTE collisions are not avoided"), "{said}");
        match note {
            Some(note) => {
                assert!(said.contains(note) && said.contains("add `--to l5`"), "{said}");
                fs::remove_dir_all(folder.path().join("mine")).unwrap();
                let without = made(&["--to", "l5"]);
                assert!(!without.contains("gripper"), "{without}");
                let robot = RobotDefinition::load(Files::Disk, &folder.path().join("mine"), &[]).unwrap();
                assert_eq!(robot.model.n(), 5);
            }
            None => assert!(!said.contains("gripper"), "{said}"),
        }
    }
}

/// A URDF of an arm of two joints with these values of friction.
fn two_joints(friction: [f64; 2]) -> String {
    let mut text = "<robot name=\"arm\"><link name=\"base\"/>".to_owned();
    for (i, (parent, at)) in [("base", 0.1), ("l0", 0.3)].into_iter().enumerate() {
        let _ = write!(
            text,
            "<joint name=\"j{i}\" type=\"revolute\"><parent link=\"{parent}\"/><child link=\"l{i}\"/>\
             <origin xyz=\"0 0 {at}\"/><axis xyz=\"0 1 0\"/><limit lower=\"-2.5\" upper=\"2.5\" effort=\"80\" velocity=\"2\"/>\
             <dynamics damping=\"0.0\" friction=\"{}\"/></joint>",
            friction[i]
        );
        link(&mut text, &format!("l{i}"), 0.3, 2.0);
    }
    text + "</robot>"
}

#[test]
fn zero_friction_of_all_joints_is_a_placeholder() {
    let folder = scratch();
    let at = |path: &str| folder.path().join(path);
    for (name, friction, is_placeholder) in [("zero", [0.0, 0.0], true), ("one", [0.0, 1.5], false)] {
        let urdf = format!("{name}.urdf");
        fs::write(at(&urdf), two_joints(friction)).unwrap();
        let (assumed, plain) = (format!("{name}-assumed"), format!("{name}-plain"));
        let said = opspace(folder.path(), &["new", &assumed, "--urdf", &urdf, "--assume"]).exits(0).stdout;
        assert_eq!(said.contains("the URDF states zero friction"), is_placeholder, "{said}");
        let robot = RobotDefinition::load(Files::Disk, &at(&assumed), &[]).unwrap();
        let coulomb: Vec<f64> = robot.joints().iter().map(|j| j.friction.coulomb_nm.get()).collect();
        assert_eq!(coulomb[0] > 0.0, is_placeholder, "{coulomb:?}");
        assert_eq!(coulomb[1] > 0.0, is_placeholder || friction[1] > 0.0, "{coulomb:?}");
        assert_eq!(read(at(&format!("{assumed}/robot.toml"))).contains("% of the size"), is_placeholder);
        let said = opspace(folder.path(), &["new", &plain, "--urdf", &urdf]).exits(0).stdout;
        assert_eq!(said.contains("the URDF states zero friction"), is_placeholder, "{said}");
        // The missing values come first.
        let (_, next) = said.split_once("Next:\n").unwrap();
        assert!(
            next.trim_start().starts_with(&format!("opspace check {plain}   # lists the missing values")),
            "{said}"
        );
    }
}

/// Error (rms) of a first task that an arm follows, m.
const FOLLOWED_M: f64 = 0.01;

/// The robot that `identify` writes, of an arm without friction and without motor current, runs the first task.
#[test]
fn identified_arm_without_friction_runs() {
    let folder = scratch();
    let at = |path: &str| folder.path().join(path);
    fs::write(at("arm.urdf"), two_joints([0.0, 0.0])).unwrap();
    opspace(folder.path(), &["new", "mine", "--urdf", "arm.urdf", "--assume"]).exits(0);
    let without = |name: &str| {
        format!("robot.joint.{name}.friction={{coulomb_nm=0.0,viscous_nms_per_rad=0.0,presliding_rad=0.001}}")
    };
    let (first, second) = (without("j0"), without("j1"));
    let identify = ["identify", "mine", "--out", "found", "--set", &first, "--set", &second];
    let said = opspace(folder.path(), &identify).exits(0);
    let found = RobotDefinition::load(Files::Disk, &at("found"), &[]).unwrap();
    for joint in found.joints() {
        assert_eq!(joint.friction.viscous_nms_per_rad.get(), 0.0, "{}", said.stdout);
    }
    let results = read_json(at("found/identification.json"));
    for joint in ["j0", "j1"] {
        let kp = &results["joints"][joint]["servo"]["intervals"]["kp"];
        let [lower, upper] = [0, 1].map(|end| kp[end].as_f64().unwrap());
        assert!((lower..upper).contains(&40.0), "{joint}: {kp}");
    }
    opspace(folder.path(), &["run", "mine/first-task.toml", "--robot", "found", "--out", "out"]).exits(0);
    let summary = read_json(at("out/summary.json"));
    let error_m = summary["metrics"]["position_rms_m"].as_f64().unwrap();
    assert!(error_m < FOLLOWED_M, "{error_m} m");
}

/// Stiffness of the servos of an SO-101 in its template, Nm/rad, and the largest error of its estimate.
const SO101_NM_PER_RAD: f64 = 8.9;
const SO101_WITHIN: f64 = 0.05;

/// Compared, through the program: the stiffness that the weight of an SO-101 with backlash and twice the friction shows, and that of the
/// simulation; the plan of the motion is printed, and the robot that is written runs its first task.
#[test]
fn so101_is_identified_from_its_weight() {
    let folder = scratch();
    let urdf = project("examples/so101/so101.urdf");
    opspace(folder.path(), &["new", "so101", "--like", "so101", "--urdf", &urdf]).exits(0);
    let joints = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"];
    let gears = joints.map(|joint| {
        format!("robot.simulated.gear.{joint}={{stiffness_nm_per_rad=300.0,damping_nms_per_rad=0.3,backlash_rad=0.0175}}")
    });
    let mut how =
        vec!["identify", "so101", "--out", "found", "--set", "robot.simulated.true_over_nominal.friction=2"];
    how.extend(gears.iter().flat_map(|gear| ["--set", gear]));
    let said = opspace(folder.path(), &how).exits(0);
    let results = read_json(folder.path().join("found/identification.json"));
    for joint in joints {
        assert!(said.stderr.contains(&format!("{joint} will move from ")), "{}", said.stderr);
        let stiffness = results["joints"][joint]["static_servo"]["stiffness"].as_f64().unwrap();
        assert!((stiffness / SO101_NM_PER_RAD - 1.0).abs() < SO101_WITHIN, "{joint}: {stiffness}");
    }
    let page = read(folder.path().join("found/report.html"));
    assert!(page.contains("Offset of setpoint from position over the torque of gravity of elbow_flex"));
    opspace(folder.path(), &["run", "so101/first-task.toml", "--robot", "found", "--out", "out"]).exits(0);
}

/// Compared: the lines of a new robot.toml that are to be filled in, and the values that `opspace check` calls missing.
#[test]
fn lines_to_fill_in_are_the_missing_values() {
    let folder = scratch();
    fs::write(folder.path().join("robot.urdf"), random_urdf(&mut Random(3), 2)).unwrap();
    opspace(folder.path(), &["new", "mine", "--urdf", "robot.urdf"]).exits(0);
    let text = read(folder.path().join("mine/robot.toml"));
    let meanings: Vec<&str> = text
        .lines()
        .filter(|line| line.starts_with("# ") && line.contains(" =  "))
        .filter_map(|line| Some(line[2..].split_once('#')?.1.trim()))
        .collect();
    assert!(meanings.len() >= 10, "{meanings:?}");
    opspace(folder.path(), &["check", "mine"]).exits(2).says(&meanings);
}

/// URDF of three joints, without a mass, or with these masses, (kg) and inertias; the last joint has this effort.
fn without_masses(inertials: Option<[&str; 3]>, effort: f64) -> String {
    let inertial = |i: usize| inertials.map_or(String::new(), |all| all[i].to_owned());
    let mut text = "<robot name=\"m\"><link name=\"base\"/>".to_owned();
    let joints = [("base", "0 0 0.1", "0 1 0"), ("l1", "0 0 0.4", "0 1 0"), ("l2", "0 0 0.4", "0 0 1")];
    for (i, (parent, at, axis)) in joints.into_iter().enumerate() {
        let child = i + 1;
        let limit = if i == 2 { effort } else { effort.min(150.0) };
        let _ = write!(
            text,
            "<joint name=\"j{child}\" type=\"revolute\"><parent link=\"{parent}\"/><child link=\"l{child}\"/><origin xyz=\"{at}\"/>\
             <axis xyz=\"{axis}\"/><limit lower=\"-2\" upper=\"2.5\" effort=\"{limit}\" velocity=\"3\"/></joint>\
             <link name=\"l{child}\">{}</link>",
            inertial(i)
        );
    }
    text + "</robot>"
}

const LIGHT_LAST_LINK: [&str; 3] = [
    "<inertial><origin xyz=\"0 0 0.2\"/><mass value=\"5\"/><inertia ixx=\"0.1\" iyy=\"0.1\" izz=\"0.02\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial>",
    "<inertial><origin xyz=\"0 0 0.2\"/><mass value=\"4\"/><inertia ixx=\"0.08\" iyy=\"0.08\" izz=\"0.01\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial>",
    "<inertial><origin xyz=\"0 0 0.02\"/><mass value=\"0.2\"/><inertia ixx=\"1e-4\" iyy=\"1e-4\" izz=\"1.3e-4\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial>",
];

const ZERO_INERTIA: [&str; 3] = [
    "<inertial><mass value=\"5\"/><inertia ixx=\"0\" iyy=\"0\" izz=\"0\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial>",
    "<inertial><mass value=\"3\"/><inertia ixx=\"0\" iyy=\"0\" izz=\"0\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial>",
    "<inertial><mass value=\"1\"/><inertia ixx=\"0\" iyy=\"0\" izz=\"0\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial>",
];

/// Largest distance from the goal of a first task at its end, m.
const AT_GOAL_M: f64 = 0.01;

/// Runs the first task of a URDF as a position and as a torque robot, with and without a gripper that the model does not have.
#[track_caller]
fn both_robots_reach(urdf: &str, about: &str) {
    let folder = scratch();
    let at = |path: &str| folder.path().join(path);
    fs::write(at("arm.urdf"), urdf).unwrap();
    opspace(folder.path(), &["new", "mine", "--urdf", "arm.urdf", "--assume"]).exits(0);
    opspace(folder.path(), &["check", "mine", "mine/first-task.toml"]).exits(0);
    let gripper =
        "robot.simulated.payload.gripper={ frame = \"l3\", mass_kg = 0.5, centre_m = [0.05, 0.0, 0.05] }";
    for backend in ["position", "torque"] {
        for (name, more) in [("free", &[][..]), ("loaded", &["--set", gripper])] {
            let out = format!("{backend}-{name}");
            let run = ["run", "mine/first-task.toml", "--backend", backend, "--out", &out];
            opspace(folder.path(), &[&run[..], more].concat()).exits(0);
            let summary = read_json(at(&out).join("summary.json"));
            let final_m = summary["metrics"]["position_final_m"].as_f64().unwrap_or_default();
            // Half a kilogram bends the task, which knows nothing of it.
            let bound_m = if name == "free" { AT_GOAL_M } else { 3.0 * AT_GOAL_M };
            assert!(summary["faulted"].is_null() && final_m < bound_m, "{about}, {out}: {final_m} m");
        }
    }
}

#[test]
fn urdf_without_masses_runs_on_both_robots() {
    both_robots_reach(&without_masses(None, 0.0), "no masses, efforts of zero");
}

#[test]
fn light_last_link_on_a_strong_drive_runs_on_both_robots() {
    both_robots_reach(&without_masses(Some(LIGHT_LAST_LINK), 28.0), "a light last link");
    both_robots_reach(
        &without_masses(Some(LIGHT_LAST_LINK), 2000.0),
        "a light last link, placeholder efforts",
    );
}

#[test]
fn inertias_of_zero_run_on_both_robots() {
    both_robots_reach(&without_masses(Some(ZERO_INERTIA), 60.0), "inertias of zero");
}

/// Compared: the sum of the assumed masses and the mass of the whole arm; no link is heavier than those before it. Without masses, what
/// needs none works, and what needs some says how to get them.
#[test]
fn assumed_masses_are_listed_and_known_ones_are_kept() {
    let folder = scratch();
    let at = |path: &str| folder.path().join(path);
    fs::write(at("arm.urdf"), without_masses(None, 0.0)).unwrap();
    let new = |name: &str, more: &[&str]| {
        opspace(folder.path(), &[&["new", name, "--urdf", "arm.urdf"][..], more].concat())
    };
    let said = new("heavy", &["--assume", "--mass", "25"]).exits(0).stdout;
    assert!(said.contains("are assumed: l1 "), "{said}");
    let robot = RobotDefinition::load(Files::Disk, &at("heavy"), &[]).unwrap();
    let masses: Vec<f64> = robot.model.bodies().iter().map(|body| body.inertia.mass).collect();
    let moving: f64 = masses.iter().sum();
    assert!((15.0..25.0).contains(&moving), "{masses:?}");
    assert!(masses[2] < masses[0] && masses[2] < masses[1], "{masses:?}");
    assert!(robot.file.assumed.contains(&"link.l1".to_owned()), "{:?}", robot.file.assumed);

    new("plain", &[]).exits(0);
    opspace(folder.path(), &["model", "arm.urdf"]).exits(0);
    opspace(folder.path(), &["model", "heavy"]).exits(0);
    fs::write(at("known.urdf"), without_masses(Some(LIGHT_LAST_LINK), 28.0)).unwrap();
    let known = ["new", "known", "--urdf", "known.urdf", "--assume", "--mass", "25"];
    opspace(folder.path(), &known).exits(2).says(&["states the masses of all links", "leave --mass out"]);
}

/// Without the program `xacro`, a file that needs it is refused with the command to type.
#[test]
fn xacro_is_expanded_by_its_program() {
    let folder = scratch();
    fs::write(folder.path().join("arm.urdf.xacro"), two_joints([0.0, 0.0])).unwrap();
    let arguments = ["new", "mine", "--urdf", "arm.urdf.xacro", "--assume"];
    opspace(folder.path(), &arguments).exits(2).says(&["xacro arm.urdf.xacro > arm.urdf"]);
}
