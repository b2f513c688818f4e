//! Files with mistakes are refused with exit code 2, file, line, mistake and remedy; no file content makes the
//! program panic. Files created by `opspace new` run once they are completed.

#![expect(clippy::unwrap_used, clippy::expect_used, reason = "a test")]

use crate::cli_common::{Ran, opspace, project, read, scratch};
use std::fs;
use std::path::Path;

/// Creates a folder with the arm and a valid task.
fn arm() -> tempfile::TempDir {
    let folder = scratch();
    for file in ["robot.toml", "asimo-arm.urdf"] {
        fs::copy(project(&format!("robots/asimo-arm/{file}")), folder.path().join(file)).unwrap();
    }
    let task = read(project("tasks/compliant-x.toml")).replace("../robots/asimo-arm", ".");
    fs::write(folder.path().join("task.toml"), task).unwrap();
    opspace(folder.path(), &["check", "robot.toml", "task.toml", "asimo-arm.urdf"]).exits(0);
    folder
}

/// Checks `file` with `old` replaced by `new`: the error must contain `line` of this file and all `words`.
#[track_caller]
fn refused(file: &str, old: &str, new: &str, line: Option<&str>, words: &[&str]) -> Ran {
    let folder = arm();
    let path = folder.path().join(file);
    let text = read(&path);
    assert!(text.contains(old), "'{old}' isn't in {file}");
    let text = text.replacen(old, new, 1);
    fs::write(&path, &text).unwrap();
    let checked = if file.ends_with("urdf") { file } else { "task.toml" };
    let ran = opspace(folder.path(), &["check", checked]).exits(2).says(words);
    assert_eq!(ran.stdout, "", "nothing is said to be right");
    let first = ran.stderr.lines().next().unwrap();
    if let Some(line) = line {
        let number = text.lines().position(|l| l.contains(line)).expect("the line is there") + 1;
        assert!(first.contains(&format!("{file}:{number}: ")), "line {number}:\n{}", ran.stderr);
        let shown = line.trim();
        assert!(ran.stderr.contains(shown), "the line itself is shown:\n{}", ran.stderr);
    } else {
        assert!(first.contains(&format!("{file}: ")), "{}", ran.stderr);
    }
    ran
}

#[test]
fn friction_observer_without_force_sensor_is_refused() {
    let folder = scratch();
    let task = read(project("tasks/panda-reach.toml"))
        .replace("../robots/panda", &project("robots/panda"))
        .replace("gain = 0.8 }", "gain = 0.8, observer_rad_per_s = 60.0 }");
    fs::write(folder.path().join("task.toml"), &task).unwrap();
    let number = task.lines().position(|line| line.contains("observer_rad_per_s")).unwrap() + 1;
    opspace(folder.path(), &["check", "task.toml"]).exits(2).says(&[
        &format!("task.toml:{number}: "),
        "the friction observer needs a force sensor",
        "omit observer_rad_per_s",
    ]);
}

macro_rules! refused {
    ($($name:ident: $file:literal, $old:literal => $new:literal, $line:expr, $words:expr;)*) => { $(
        #[test]
        fn $name() {
            refused($file, $old, $new, $line, &$words);
        }
    )* };
}

refused! {
    event_on_the_contact_of_a_task_that_does_not_approach_is_refused: "task.toml",
        "[task.hand.cartesian]" => "[[event]]\ntime_s = 2.0\ncontact = { task = \"hand\", is = \"made\" }\nset = []\n[task.hand.cartesian]",
        Some("contact = "), ["no task 'hand' that approaches is active before this event", "`force.contact`"];
    surface_without_a_force_axis_is_refused: "task.toml",
        "[task.hand.cartesian]" => "[task.hand.cartesian]\naxes_frame = { surface = {} }",
        Some("axes_frame"), ["a surface has one normal: make exactly one of x, y and z `force`"];
    mistyped_key_is_refused: "task.toml", "settle_s = " => "setle_s = ", Some("setle_s"),
        ["unknown key `setle_s`", "did you mean `settle_s`?", "allowed here"];
    estimated_force_with_the_name_of_a_sensor_is_refused: "robot.toml",
        "[force_sensor.wrist]" => "[estimated_force.wrist]\nframe = \"hand\"\n[force_sensor.wrist]",
        Some("[estimated_force.wrist]"), ["'wrist' is also the name of a force sensor", "another name"];
    estimated_force_on_an_unknown_frame_is_refused: "robot.toml",
        "[force_sensor.wrist]" => "[estimated_force.motors]\nframe = \"hnad\"\n[force_sensor.wrist]",
        Some("frame = \"hnad\""), ["the robot has no frame 'hnad'", "did you mean 'hand'?"];
    retraction_above_a_speed_limit_is_refused: "robot.toml",
        "[force_sensor.wrist]" =>
            "[collision_detection]\nreaction.retract = { distance_rad = 3.0 }\n[force_sensor.wrist]",
        Some("reaction.retract = "),
        ["1.875 distance_rad/duration_s = 9.375 rad/s (m/s); joint 'shoulder_pitch' at most at 8", "a larger duration_s"];
    retraction_by_no_distance_is_refused: "robot.toml",
        "[force_sensor.wrist]" =>
            "[collision_detection]\nreaction.retract = { distance_rad = 0.0 }\n[force_sensor.wrist]",
        Some("reaction.retract = "), ["expected a number above 0, got 0"];
    mistyped_key_of_a_retraction_is_refused: "robot.toml",
        "[force_sensor.wrist]" =>
            "[collision_detection]\nreaction.retract = { distance_m = 0.1 }\n[force_sensor.wrist]",
        Some("reaction.retract = "), ["distance_m", "distance_rad"];
    unknown_reaction_is_refused: "robot.toml",
        "[force_sensor.wrist]" => "[collision_detection]\nreaction = \"retreat\"\n[force_sensor.wrist]",
        Some("reaction = "), ["retreat", "retract"];
    mistyped_task_key_is_refused: "task.toml", "damping_ratio = 1.0" => "damping_rato = 1.0", Some("damping_rato"),
        ["unknown key `damping_rato`", "did you mean `damping_ratio`?"];
    mistyped_kind_is_refused: "task.toml", "[task.hand.cartesian]" => "[task.hand.cartesan]", Some("cartesan"),
        ["`cartesan`", "did you mean `cartesian`?"];
    wrong_unit_in_key_is_refused: "task.toml", "duration_s = 8.0" => "duration_ms = 8000.0", Some("duration_ms"),
        ["unknown key `duration_ms`", "`duration_s`"];
    unit_in_value_is_refused: "task.toml", "duration_s = 8.0" => "duration_s = \"8 s\"", Some("duration_s"),
        ["expected a number", "\"8 s\""];
    nan_is_refused: "task.toml", "settle_s = 1.5" => "settle_s = nan", Some("settle_s"), ["finite", "nan"];
    infinite_number_is_refused: "robot.toml", "servo_hz = 5000.0" => "servo_hz = inf", Some("servo_hz"), ["finite", "inf"];
    overflowing_number_is_refused: "robot.toml", "servo_hz = 5000.0" => "servo_hz = 1e999", Some("servo_hz"), ["finite"];
    negative_duration_is_refused: "task.toml", "duration_s = 8.0" => "duration_s = -8.0", Some("duration_s"), ["above 0"];
    unknown_frame_is_refused: "task.toml", "frame = \"hand\"" => "frame = \"hnad\"", Some("frame = \"hnad\""),
        ["no frame 'hnad'", "did you mean 'hand'?", "forearm"];
    unknown_environment_frame_is_refused: "task.toml",
        "[environment.operator.spring]\nframe = \"hand\"" => "[environment.operator.spring]\nframe = \"fist\"",
        Some("\"fist\""), ["no frame 'fist'", "forearm"];
    peg_without_a_radius_is_refused: "task.toml", "[environment.operator.spring]" =>
        "[environment.bore.hole]\nframe = \"hand\"\npoint_m = [0.4, 0.0, 0.0]\nnormal = [0.0, 0.0, 1.0]\nradius_m = 0.01\n\
         clearance_m = 0.02\ndepth_m = 0.02\nstiffness_n_per_m = 1e4\ndamping_ns_per_m = 0.0\n\n[environment.operator.spring]",
        Some("clearance_m = 0.02"), ["radius of the hole, 0.01 m"];
    edge_along_the_normal_is_refused: "task.toml", "[environment.operator.spring]" =>
        "[environment.table.wall]\nframe = \"hand\"\npoint_m = [0.4, 0.0, 0.0]\nnormal = [0.0, 0.0, 1.0]\n\
         edge = { toward = [0.0, 0.0, 1.0], at_m = 0.3 }\nstiffness_n_per_m = 1e4\ndamping_ns_per_m = 0.0\n\n[environment.operator.spring]",
        Some("edge = {"), ["direction along the wall"];
    unknown_kind_of_object_is_refused: "task.toml", "[environment.operator.spring]" => "[environment.operator.sping]",
        Some("sping"), ["`sping`", "did you mean `spring`?"];
    too_few_gains_are_refused: "task.toml", "gain = [1.0, 0.15, 0.15]" => "gain = [1.0, 0.15]", Some("gain = ["), ["3", "2"];
    too_many_gains_are_refused: "task.toml", "gain = [1.0, 0.15, 0.15]" => "gain = [1, 1, 1, 1]", Some("gain = ["), ["3", "4"];
    gain_of_unknown_axis_is_refused: "task.toml",
        "gains = { frequency_rad_per_s = 14.142" => "gains = { frequency_rad_per_s = { w = 1.0 }",
        Some("{ w = 1.0 }"), ["`w`"];
    pose_task_on_four_joints_is_refused: "task.toml",
        "z = \"motion\" }" => "z = \"motion\", rx = \"motion\", ry = \"motion\", rz = \"motion\" }",
        Some("axes"), ["4"];
    unknown_sensor_is_refused: "task.toml", "sensor = \"wrist\"" => "sensor = \"ankle\"", Some("ankle"),
        ["no force sensor 'ankle'", "wrist"];
    unknown_task_in_priority_is_refused: "task.toml", "priority = [\"hand\", \"rest\"]" => "priority = [\"hand\", \"rst\"]",
        Some("priority"), ["'rst'", "did you mean 'rest'?"];
    task_without_priority_is_refused: "task.toml", "priority = [\"hand\", \"rest\"]" => "priority = [\"hand\"]",
        Some("[task.rest.joint-posture]"), ["rest", "priority"];
    repeated_task_in_priority_is_refused: "task.toml", "priority = [\"hand\"," => "priority = [\"hand\", \"hand\",",
        Some("priority"), ["hand"];
    start_of_unknown_joint_is_refused: "task.toml", "elbow = -1.35" => "elbo = -1.35", Some("elbo ="),
        ["no joint 'elbo'", "did you mean 'elbow'?", "shoulder_yaw"];
    start_outside_limits_is_refused: "task.toml", "elbow = -1.35" => "elbow = 1.35", Some("elbow = 1.35"),
        ["1.35 is outside", "from -2.26", "to 0"];
    distant_start_is_refused: "task.toml", "elbow = -1.35" => "elbow = -2e4", Some("elbow = -2e4"),
        ["-2e4 is too far from 0", "from -2.26", "to 0"];
    huge_number_is_refused: "task.toml", "duration_s = 8.0" => "duration_s = 2e12", Some("duration_s"),
        ["2e12 is too large", "from -1e12 to 1e12"];
    settling_beyond_the_run_is_refused: "task.toml", "settle_s = 1.5" => "settle_s = 9", Some("settle_s"), ["8 s"];
    unknown_reference_is_refused: "task.toml", "reference = \"hold\"" => "reference = \"hodl\"", Some("hodl"), ["`hold`"];
    value_of_wrong_type_is_refused: "task.toml", "seed = 1" => "seed = \"one\"", Some("seed"), ["\"one\""];
    missing_robot_is_refused: "task.toml", "robot = \".\"" => "robot = \"robto.toml\"", Some("robto.toml"),
        ["`robto.toml`: there is no such file", "did you mean `robot.toml`?"];
    invalid_toml_is_refused: "task.toml", "seed = 1" => "seed 1", Some("seed 1"), ["not TOML"];
    repeated_key_is_refused: "task.toml", "seed = 1" => "seed = 1\nseed = 2", Some("seed = 2"), ["seed"];
    zero_servo_ticks_per_cycle_is_refused: "robot.toml", "servo_ticks_per_cycle = 5" => "servo_ticks_per_cycle = 0", Some("servo_ticks_per_cycle = 0"), ["above 0"];
    fractional_servo_ticks_per_cycle_is_refused: "robot.toml", "servo_ticks_per_cycle = 5" => "servo_ticks_per_cycle = 2.5", Some("servo_ticks_per_cycle = 2.5"), ["2.5"];
    delay_of_more_than_32_cycles_is_refused: "robot.toml", "delay_servo_ticks = 0" => "delay_servo_ticks = 161",
        Some("delay_servo_ticks = 161"), ["161 servo ticks", "32 interface periods, 160 servo ticks"];
    non_multiple_physics_rate_is_refused: "robot.toml", "physics_hz = 20000.0" => "physics_hz = 12000.0", Some("physics_hz"),
        ["multiple", "5000"];
    unknown_profile_is_refused: "robot.toml", "default_profile = \"a-med\"" => "default_profile = \"a-mad\"",
        Some("default_profile"), ["no profile 'a-mad'", "did you mean 'a-med'?", "b-soft"];
    drive_of_unknown_joint_is_refused: "robot.toml", "[joint.elbow]" => "[joint.elbov]", Some("[joint.elbov]"),
        ["no moving joint 'elbov'", "did you mean 'elbow'?"];
    joint_without_servo_is_refused: "robot.toml", "elbow = { cascaded" => "# elbow = { cascaded",
        Some("[profile.a-med.servo]"), ["joint 'elbow'", "missing"];
    missing_key_is_refused: "robot.toml", "coulomb_nm = 1.8, " => "", Some("friction = { static_nm"),
        ["missing key `coulomb_nm` in `joint.shoulder_pitch.friction`", "Nm", "opspace identify"];
    sensor_on_unknown_link_is_refused: "robot.toml", "frame = \"hand\"" => "frame = \"palm\"", Some("palm"),
        ["no link 'palm'", "hand"];
    unknown_transformer_is_refused: "robot.toml", "servo_ticks_per_cycle = 5" => "servo_ticks_per_cycle = 5\ntransformer = \"peper\"", Some("peper"),
        ["'paper'"];
    missing_urdf_is_refused: "robot.toml", "asimo-arm.urdf" => "asimo-arn.urdf", Some("asimo-arn.urdf"),
        ["asimo-arn.urdf`: there is no such file", "did you mean `./asimo-arm.urdf`?"];
}

/// Similar file names in the folder of a missing file.
#[test]
fn missing_file_error_names_similar_files() {
    let folder = arm();
    opspace(folder.path(), &["run", "tsk.toml"])
        .exits(2)
        .says(&["tsk.toml: there is no such file", "`task.toml`"]);
    opspace(folder.path(), &["run", "task"]).exits(2).says(&["did you mean `task.toml`?"]);
    opspace(folder.path(), &["run", "nowhere/task.toml"]).exits(2).says(&["no folder `nowhere`"]);
    opspace(folder.path(), &["run", "."]).exits(2).says(&["is a folder", "task.toml"]);
    let robot = ["run", "task.toml", "--robot", "robots"];
    opspace(folder.path(), &robot).exits(2).says(&["robots: there is no such file"]);
    let suite = "title = \"s\"\n[[run]]\ntasks = [\"task.toml\", \"tusk.toml\"]\nbackend = \"torque\"\ncontroller = \"osc\"\n";
    fs::write(folder.path().join("suite.toml"), suite).unwrap();
    let missing = ["suite.toml:3: `tusk.toml`: there is no such file", "did you mean `task.toml`?"];
    opspace(folder.path(), &["bench", "suite.toml"]).exits(2).says(&missing);
}

#[test]
fn setting_errors_match_file_errors() {
    let folder = arm();
    let set = |setting: &str, words: &[&str]| {
        opspace(folder.path(), &["run", "task.toml", "--set", setting]).exits(2).says(words);
    };
    set(
        "task.hand.gains.damping_rato=0.7",
        &["--set task.hand", "unknown key", "did you mean `damping_ratio`?"],
    );
    set("task.hnad.gains.damping_ratio=0.7", &["--set task.hnad", "hand"]);
    set("task.hand.gains.damping_ratio=-1", &["--set", "-1"]);
    set("task.hand.gains.damping_ratio=nan", &["--set", "finite"]);
    set("task.hand.gains.damping_ratio=abc", &["--set", "abc"]);
    set("task.hand.frame=fist", &["--set", "no frame 'fist'"]);
    set("robot.profile.a-med.servo_ticks_per_cycle=0", &["--set robot.profile", "above 0"]);
    set("robot.profile.a-med.delay_servo_ticks=199", &["--set", "199 servo ticks"]);
    set("robot.simulated.true_over_nominal.kq=1", &["--set", "kq", "kp"]);
    set("robot.simulated.physics_hz=12000", &["--set", "multiple"]);
    set("damping_ratio", &["a setting needs an `=`"]);
    set("=1", &["--set"]);
    set("", &["--set"]);
}

/// Requirements of each transformer on the robot.
#[test]
fn unsupported_transformer_is_refused() {
    let folder = arm();
    let refused = |transformer: &str, settings: &[&str], words: &[&str]| {
        let mut arguments = vec!["run", "task.toml", "--transformer", transformer];
        settings.iter().for_each(|setting| arguments.extend(["--set", setting]));
        opspace(folder.path(), &arguments).exits(2).says(words);
    };
    refused("interpolating", &[], &["robot.toml", "setpoints", "these drives hold them", "use 'emulation'"]);
    let blind = r#"robot.interface.measured=["position"]"#;
    refused("paper+current", &[blind], &["needs motor current", "use 'paper'"]);
    refused("identified", &[], &["[profile.a-med]", "opspace identify"]);
    refused(
        "paper",
        &["robot.profile.a-med.adapt_gains={time_s=1.0,max_relative_change=0.3}"],
        &["adapt_gains", "emulation+current"],
    );
    let servo = |rational: &str| format!("robot.profile.a-med.servo.elbow={{transfer-function={rational}}}");
    let unstable = servo("{numerator=[-1500.0,1600.0],denominator=[1.0,-0.5]}");
    refused("emulation", &[&unstable], &["its inverse is unstable", "outside the unit circle"]);
    let improper = servo("{numerator=[1.0],denominator=[0.0,1.0]}");
    refused("paper", &[&improper], &["future errors"]);
    let joint = "{closed_loop={numerator=[1.0],denominator=[1.0,0.02,6.6e-5]},\
                 open_loop={numerator=[1.0],denominator=[0.0,2.0,0.3]},from_hz=0.5,to_hz=50.0}";
    let joints = ["shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow"];
    let all: Vec<String> = joints.iter().map(|name| format!("{name}={joint}")).collect();
    let identified = format!("robot.profile.a-med.identified={{{}}}", all.join(","));
    refused("identified-literal", &[&identified], &["possible values: paper", "opspace-comparisons"]);
    let literal = ["robot.profile.a-med.transformer=identified-literal", &identified];
    opspace(folder.path(), &["run", "task.toml", "--set", literal[0], "--set", literal[1]])
        .exits(2)
        .says(&["unknown transformer 'identified-literal'", "opspace-comparisons"]);
    let one = format!("robot.profile.a-med.identified={{{}}}", all[0]);
    refused("identified", &[&one], &["joint 'shoulder_roll'", "missing"]);
}

/// Checks the URDF of the arm with one mistake.
#[track_caller]
fn urdf(old: &str, new: &str, line: Option<&str>, words: &[&str]) {
    refused("asimo-arm.urdf", old, new, line, words);
}

/// Checks an invalid URDF.
#[track_caller]
fn whole_urdf(text: &str, words: &[&str]) -> Ran {
    let folder = scratch();
    fs::write(folder.path().join("a.urdf"), text).unwrap();
    opspace(folder.path(), &["check", "a.urdf"]).exits(2).says(&["error: a.urdf"]).says(words)
}

const LINKS: &str = r#"<robot name="r">
<link name="a"/>
<link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="c"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
JOINTS
</robot>
"#;

const LIMIT: &str = r#"<limit effort="9" velocity="3"/>"#;

fn joint(name: &str, parent: &str, child: &str) -> String {
    format!(
        r#"<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{child}"/>{LIMIT}</joint>"#
    ) + "\n"
}

#[track_caller]
fn joints(joints: &[String], line: u32, words: &[&str]) {
    let text = LINKS.replace("JOINTS\n", &joints.concat());
    whole_urdf(&text, words).says(&[&format!("a.urdf:{line}: ")]);
}

#[test]
fn urdf_without_tree_structure_is_refused() {
    let (ab, bc) = (joint("j", "a", "b"), joint("k", "b", "c"));
    let right = LINKS.replace("JOINTS\n", &[ab.clone(), bc.clone()].concat());
    let folder = scratch();
    fs::write(folder.path().join("a.urdf"), right).unwrap();
    opspace(folder.path(), &["check", "a.urdf"]).exits(0);

    joints(&[ab.clone(), joint("k", "c", "c")], 6, &["cycle", "c"]);
    joints(&[joint("j", "b", "c"), joint("k", "c", "b")], 5, &["cycle", "b → c", "root"]);
    joints(&[ab.clone(), joint("k", "b", "d")], 6, &["joint 'k'", "child link 'd' doesn't exist", "a, b, c"]);
    joints(&[ab.clone(), joint("k", "d", "c")], 6, &["joint 'k'", "parent link 'd' doesn't exist"]);
    joints(&[ab.clone(), joint("j", "b", "c")], 6, &["joint 'j' is already defined, on line 5", "unique"]);
    joints(&[ab.clone(), bc, joint("l", "a", "c")], 7, &["'c' is the child of two joints, 'k' and 'l'"]);
    let roots = whole_urdf(&LINKS.replace("JOINTS\n", &ab), &["the links a, c", "one root", "fixed"]);
    assert!(roots.stderr.contains("a.urdf:"), "{}", roots.stderr);
    whole_urdf(
        &LINKS.replace("\"c\"", "\"b\"").replace("JOINTS\n", &ab),
        &["a.urdf:4: ", "link 'b' is already defined"],
    );
    whole_urdf("<robot name=\"r\"/>", &["no <link>"]);
    whole_urdf("<robot name=\"r\">\n<link/>\n</robot>", &["a.urdf:2: ", "no name"]);
}

#[test]
fn urdf_with_impossible_numbers_is_refused() {
    let text = read(project("robots/asimo-arm/asimo-arm.urdf"));
    // First element with this tag, for any robot.
    let first = |tag: &str| {
        let begin = text.find(&format!("<{tag} ")).unwrap_or_else(|| panic!("<{tag}>"));
        let end = begin + text[begin..].find("/>").unwrap() + 2;
        text[begin..end].to_owned()
    };
    let mass = first("mass");
    urdf(&mass, "<mass value=\"-1\"/>", Some("\"-1\""), &["mass is -1 kg", "negative"]);
    urdf(&mass, "<mass value=\"nan\"/>", Some("nan"), &["<mass value>", "nan", "finite"]);
    urdf(&mass, "<mass value=\"1,5\"/>", Some("1,5"), &["1,5", "number"]);
    let limit = first("limit");
    urdf(&limit, "", Some("<joint"), &["has no <limit>", "write <limit lower"]);
    urdf(
        &limit,
        "<limit lower=\"1\" upper=\"-1\" effort=\"1\" velocity=\"1\"/>",
        Some("upper=\"-1\""),
        &["lower limit 1 is above upper limit -1", "swap"],
    );
    let axis = first("axis");
    urdf(&axis, "<axis xyz=\"0 0 0\"/>", Some("0 0 0"), &["axis is zero", "0 0 1"]);
    urdf(&axis, "<axis xyz=\"0 1\"/>", Some("\"0 1\""), &["<axis xyz>", "\"0 1\"", "three"]);
    let inertia = first("inertia");
    let negative = "<inertia ixx=\"1\" iyy=\"1\" izz=\"1\" ixy=\"2\" ixz=\"0\" iyz=\"0\"/>";
    urdf(&inertia, negative, Some("ixy=\"2\""), &["not positive semi-definite", "<inertia>"]);
    urdf(
        "type=\"revolute\"",
        "type=\"floating\"",
        Some("floating"),
        &["\"floating\" is not supported", "revolute, continuous, prismatic and fixed"],
    );
}

#[test]
fn moving_link_without_mass_is_named() {
    let massless = LINKS.replacen("<link name=\"b\">", "<link name=\"x\"/><link name=\"y\">", 1);
    let text = massless
        .replace("JOINTS\n", &[joint("j", "a", "x"), joint("k", "a", "y"), joint("l", "y", "c")].concat());
    whole_urdf(&text, &["a.urdf:5: ", "joint 'j' moves link 'x'", "no mass", "<inertial>"]);
}

#[test]
fn non_urdf_files_are_refused() {
    whole_urdf("", &["empty", "<robot>"]);
    whole_urdf("solid cube\nfacet", &["not XML"]);
    whole_urdf("<robot name=\"r\">\n<link name=\"a\">", &["truncated"]);
    whole_urdf("<robot name=\"r\">\n<link name=\"a\"></lnk>\n</robot>", &["a.urdf:2: ", "well-formed"]);
    whole_urdf("<sdf version=\"1.7\"><model name=\"m\"/></sdf>", &["SDF", "URDF"]);
    whole_urdf("<mujoco/>", &["<mujoco>", "<robot>"]);
    let xacro = "<robot name=\"r\" xmlns:xacro=\"http://www.ros.org/wiki/xacro\">\n<xacro:arm/>\n</robot>";
    whole_urdf(xacro, &["a.urdf:2: ", "xacro", "expand it first"]);
    let expression = LINKS.replace("value=\"1\"", "value=\"${m}\"").replace("JOINTS", "");
    whole_urdf(&expression, &["a.urdf:3: ", "xacro", "${m}"]);
    let bomb = "<!DOCTYPE r [<!ENTITY a \"aaaa\">]>\n<robot name=\"r\"><link name=\"&a;\"/></robot>";
    whole_urdf(bomb, &["DOCTYPE", "delete"]);
    whole_urdf(&("<robot>".to_owned() + &"<a>".repeat(200_000)), &["nested"]);
    whole_urdf(&("<robot>".to_owned() + &" ".repeat(5 << 20) + "</robot>"), &["4 MiB"]);
    let folder = scratch();
    fs::write(folder.path().join("a.urdf"), b"<robot name=\"\xff\"/>").unwrap();
    opspace(folder.path(), &["check", "a.urdf"]).exits(2).says(&["a.urdf: is not UTF-8 (line 1)", "UTF-8"]);
}

/// Truncated files, files with changed bytes, and files with removed lines, as an editor or a disk may produce them.
/// They are accepted, or refused with a message; the helper `opspace` checks for panics.
#[test]
fn corrupted_file_never_panics() {
    let folder = arm();
    for file in ["robot.toml", "task.toml", "asimo-arm.urdf"] {
        let path = folder.path().join(file);
        let whole = fs::read(&path).unwrap();
        let mut state = 0x9e37_79b9_7f4a_7c15_u64;
        let mut random = |below: usize| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as usize % below
        };
        let mut refused = 0;
        for case in 0..60 {
            let mut bytes = whole.clone();
            match case % 4 {
                0 => bytes.truncate(random(whole.len())),
                1 => (0..3).for_each(|_| bytes[random(whole.len())] = random(256) as u8),
                2 => bytes[random(whole.len())] = b"0-9.\"[]{}=<>/ e\n"[random(16)],
                _ => {
                    let mut lines: Vec<&[u8]> = whole.split(|b| *b == b'\n').collect();
                    lines.remove(random(lines.len()));
                    bytes = lines.join(&b'\n');
                }
            }
            fs::write(&path, &bytes).unwrap();
            let ran = opspace(folder.path(), &["check", file]);
            assert!([0, 2].contains(&ran.code), "{file}, case {case}: {}", ran.stderr);
            assert_eq!(ran.code == 2, ran.stderr.contains("error: "), "{file}, case {case}: {}", ran.stderr);
            refused += i32::from(ran.code == 2);
        }
        assert!(refused > 20, "{file}: {refused} were refused");
        fs::write(&path, whole).unwrap();
    }
}

/// Returns a valid value for each key that `opspace new` leaves open; the values belong to no particular robot.
fn value_of(key: &str) -> &'static str {
    match key {
        "command" => "\"position\"",
        "gravity_compensated_by" => "\"controller\"",
        "measured" => "[\"position\"]",
        "torque_limit_nm" => "500.0",
        "inertia_kg_m2" => "1e-4",
        "gear_ratio" => "50.0",
        "encoder_counts_per_turn" => "65536",
        "coulomb_nm" => "0.1",
        "static_nm" => "0.12",
        "stribeck_rad_per_s" => "0.05",
        "viscous_nms_per_rad" => "0.5",
        "presliding_rad" => "0.001",
        "servo_hz" => "4000.0",
        "servo_ticks_per_cycle" => "4",
        "delay_servo_ticks" => "0",
        "velocity_filter_hz" => "300.0",
        "velocity_limit_rad_per_s" => "3.0",
        "kp_per_s" => "20.0",
        "kv_nms_per_rad" => "30.0",
        "physics_hz" => "8000.0",
        "current_loop_hz" => "1000.0",
        "torque_noise_nm" => "0.0",
        "stiffness_nm_per_rad" => "2000.0",
        "damping_nms_per_rad" => "20.0",
        "damping_fade_velocity_rad_per_s" => "0.1",
        "holding_torque_ratio" => "1.5",
        other => panic!("opspace new asks for `{other}`, for which this test has no value"),
    }
}

/// Returns the key of a commented-out line that requires a value; `None` for other lines.
fn to_fill(line: &str) -> Option<&str> {
    let (key, _) = line.strip_prefix("# ")?.split_once(" =")?;
    key.chars().all(|c| c.is_ascii_alphanumeric() || c == '_').then_some(key)
}

/// Calls `opspace new`, checks that all values that it leaves open are reported as missing, writes them, and runs a position
/// robot and a torque robot.
#[track_caller]
fn new_filled_and_run(robot: &str) {
    let folder = scratch();
    let urdf = project(&format!("tests/oracles/pinocchio/urdf/{robot}.urdf"));
    let made = opspace(folder.path(), &["new", "mine", "--urdf", &urdf]).exits(0).stdout;
    for file in ["mine/robot.toml", "mine/first-task.toml"] {
        assert!(made.contains(file) && folder.path().join(file).exists(), "{made}");
    }
    let path = folder.path().join("mine/robot.toml");
    let mut lines: Vec<String> = read(&path).lines().map(str::to_owned).collect();
    let asked = opspace(folder.path(), &["check", "mine"]).exits(2).stderr;
    assert!(asked.contains("values are missing"), "{asked}");
    for key in lines.iter().filter_map(|line| to_fill(line)) {
        assert!(asked.contains(&format!("{key} = ...")), "{key}: {asked}");
    }
    // One value alone is reported at its table.
    let first = lines.iter().position(|line| to_fill(line) == Some("gear_ratio")).unwrap();
    let open = lines[first].clone();
    fill(&mut lines);
    let filled = std::mem::replace(&mut lines[first], open);
    fs::write(&path, lines.join("\n")).unwrap();
    opspace(folder.path(), &["check", "mine"]).exits(2).says(&["gear_ratio", "missing"]);
    lines[first] = filled;
    fs::write(&path, lines.join("\n")).unwrap();
    opspace(folder.path(), &["check", "mine", "mine/first-task.toml"]).exits(0);
    for backend in ["position", "torque"] {
        let run =
            ["run", "mine/first-task.toml", "--duration-s", "1.3", "--backend", backend, "--out", backend];
        opspace(folder.path(), &run).exits(0);
        opspace(folder.path(), &["replay", backend]).exits(0);
    }
}

fn fill(lines: &mut [String]) {
    for line in lines {
        if let Some(key) = to_fill(line) {
            *line = format!("{key} = {}", value_of(key));
        }
    }
}

#[test]
fn new_robot_with_revolute_joints_runs() {
    new_filled_and_run("ur5");
}

#[test]
fn new_robot_with_prismatic_fingers_runs() {
    new_filled_and_run("panda");
}

#[test]
fn new_robot_keeps_existing_files() {
    let folder = scratch();
    let urdf = project("tests/oracles/pinocchio/urdf/ur5.urdf");
    let new = |dir: &str, urdf: &str| opspace(folder.path(), &["new", dir, "--urdf", urdf]);
    new("mine", &urdf).exits(0);
    new("mine", &urdf).exits(2).says(&[
        "mine/robot.toml: already exists",
        "another folder: `opspace new mine-2 --urdf ",
        "Or delete mine/robot.toml and mine/first-task.toml",
    ]);
    fs::create_dir(folder.path().join("other")).unwrap();
    fs::write(folder.path().join("other/ur5.urdf"), "<robot/>").unwrap();
    new("other", &urdf).exits(2).says(&["other/ur5.urdf: already exists and differs", "another folder"]);
    assert_eq!(read(folder.path().join("other/ur5.urdf")), "<robot/>");
    assert!(!folder.path().join("other/robot.toml").exists());
    new("third", "none.urdf").exits(2).says(&["none.urdf: there is no such file"]);
    assert!(!folder.path().join("third").exists(), "nothing is made of nothing");
    // The URDF may already be in the folder.
    fs::create_dir(folder.path().join("fourth")).unwrap();
    fs::copy(&urdf, folder.path().join("fourth/ur5.urdf")).unwrap();
    new("fourth", "fourth/ur5.urdf").exits(0);
    assert!(Path::new(&folder.path().join("fourth/robot.toml")).exists());
}

/// Values that a run requires and a URDF may lack: reported immediately, by joint.
#[test]
fn new_robot_lists_values_missing_from_urdf() {
    let folder = scratch();
    let urdf = project("tests/oracles/pinocchio/urdf/double_pendulum.urdf");
    opspace(folder.path(), &["new", "mine", "--urdf", &urdf])
        .exits(0)
        .says(&["joint1", "joint2", "velocity"]);
    let path = folder.path().join("mine/robot.toml");
    let mut lines: Vec<String> = read(&path).lines().map(str::to_owned).collect();
    fill(&mut lines);
    fs::write(&path, lines.join("\n")).unwrap();
    opspace(folder.path(), &["check", "mine"]).exits(0);
    let without: Vec<String> =
        lines.into_iter().filter(|line| !line.starts_with("velocity_limit_rad_per_s")).collect();
    fs::write(&path, without.join("\n")).unwrap();
    opspace(folder.path(), &["check", "mine"]).exits(2).says(&[
        "2 values are missing",
        "velocity_limit_rad_per_s = ...",
        "the URDF has none",
    ]);
}

/// A mistyped name of a profile makes a new profile without values: the error names those that there are.
#[test]
fn mistyped_profile_names_the_profiles() {
    let folder = scratch();
    let task = project("tasks/ur5e-reach.toml");
    let setting = "robot.profile.industral.servo_ticks_per_cycle=4";
    opspace(folder.path(), &["check", &task, "--set", setting]).exits(2).says(&[
        "values are missing in `profile.industral`",
        "if it is no new profile: did you mean 'industrial'?",
    ]);
}

/// Names that must be quoted in TOML.
#[test]
fn new_robot_accepts_any_names() {
    let folder = scratch();
    let odd = "j &quot;1&quot;.\\x";
    let text = LINKS.replace("JOINTS\n", &[joint(odd, "a", "b"), joint("k", "b", "c")].concat());
    fs::write(folder.path().join("a \"b\".urdf"), text.replace("name=\"r\"", "name=\"r&#10;r\"")).unwrap();
    opspace(folder.path(), &["new", "mine", "--urdf", "a \"b\".urdf"]).exits(0);
    let path = folder.path().join("mine/robot.toml");
    let mut lines: Vec<String> = read(&path).lines().map(str::to_owned).collect();
    fill(&mut lines);
    fs::write(&path, lines.join("\n")).unwrap();
    opspace(folder.path(), &["check", "mine", "mine/first-task.toml"]).exits(0);
}
