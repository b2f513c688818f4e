//! robot.toml with values of all joints, of groups, and of the URDF; parts of a robot.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use crate::cli_common::{opspace, project, read, scratch};
use opspace_experiment::{RobotDefinition, Source};
use std::fs;

/// Robot file for the planar arm with one value in each layer.
const LAYERS: &str = r#"
urdf = "planar-2-link.urdf"
[interface]
command = "position"
setpoints = "held"
gravity_compensated_by = "controller"
measured = ["position"]
[joint_defaults]
rotor = { inertia_kg_m2 = 1e-5, gear_ratio = 50.0 }
friction = { coulomb_nm = 0.5, viscous_nms_per_rad = 0.1 }
[group.upper]
joints = ["shoulder"]
rotor.gear_ratio = 80.0
friction.coulomb_nm = 0.7
[joint.shoulder]
friction.coulomb_nm = 0.9
[profile.only]
servo_hz = 4000.0
servo_ticks_per_cycle = 4
[profile.only.servo]
joint_defaults = { cascaded = { kp_per_s = 20.0, kv_nms_per_rad = 30.0, velocity_filter_hz = 300.0 } }
upper = { cascaded = { kv_nms_per_rad = 60.0 } }
[simulated]
"#;

fn urdf() -> String {
    read(project("robots/planar-2-link/planar-2-link.urdf"))
}

fn load(text: &str, urdf: &str) -> Result<RobotDefinition, String> {
    let (robot, urdf) = (Source::new("robot.toml", text), Source::new("arm.urdf", urdf));
    RobotDefinition::from_sources(robot, urdf).map_err(|e| format!("{e}; {}", e.help().unwrap_or_default()))
}

/// Compared: values of a file in layers, and those of the most specific layer that states them.
#[test]
fn joint_precedes_group_precedes_defaults_precede_urdf() {
    let robot = load(LAYERS, &urdf()).unwrap();
    let [shoulder, elbow] = ["shoulder", "elbow"].map(|name| robot.file.joint[name].clone());
    assert_eq!([&shoulder, &elbow].map(|joint| joint.rotor.gear_ratio.get()), [80.0, 50.0]);
    assert_eq!([&shoulder, &elbow].map(|joint| joint.rotor.inertia_kg_m2.get()), [1e-5, 1e-5]);
    assert_eq!([&shoulder, &elbow].map(|joint| joint.friction.coulomb_nm.get()), [0.9, 0.5]);
    assert_eq!([&shoulder, &elbow].map(|joint| joint.friction.static_nm.get()), [0.9, 0.5]);
    let efforts: Vec<f64> = robot.model.joints().iter().map(|joint| joint.limits.effort).collect();
    assert_eq!(robot.torque_limits(), efforts);
    let servos = robot.servos(robot.profile(None).unwrap().1);
    let gains: Vec<_> = servos.iter().map(|servo| servo.gains(1e-3)).collect();
    assert_eq!(gains.iter().map(|gains| gains.damping).collect::<Vec<_>>(), [60.0, 30.0]);
    assert_eq!(gains.iter().map(|gains| gains.stiffness).collect::<Vec<_>>(), [1200.0, 600.0]);
    assert_eq!(robot.file.simulated.unwrap().physics_hz.get(), 12_000.0);
    assert_eq!(robot.urdf_values.len(), 2, "the torque limits: friction is in the file");
}

#[test]
fn friction_of_urdf_is_read() {
    let with = urdf().replacen("</joint>", "<dynamics damping=\"0.25\" friction=\"0\"/></joint>", 1);
    let bare = LAYERS
        .replace("friction = { coulomb_nm = 0.5, viscous_nms_per_rad = 0.1 }\n", "")
        .replace("friction.coulomb_nm = 0.7\n", "")
        .replace("friction.coulomb_nm = 0.9\n", "");
    let missing = load(&bare, &with).unwrap_err();
    assert!(missing.contains("2 values are missing"), "{missing}");
    let robot = load(
        &bare.replace(
            "[profile.only]",
            "[joint.elbow]\nfriction = { coulomb_nm = 0.0, viscous_nms_per_rad = 0.0 }\n[profile.only]",
        ),
        &with,
    );
    let robot = robot.unwrap();
    let friction = &robot.file.joint["shoulder"].friction;
    assert_eq!((friction.coulomb_nm.get(), friction.viscous_nms_per_rad.get()), (0.0, 0.25));
    let negative = with.replace("friction=\"0\"", "friction=\"-1\"");
    assert!(load(&bare, &negative).unwrap_err().contains("must not be negative"));
}

/// Each mistake, with the line and the words of its error.
#[test]
fn mistakes_in_layers_are_reported_at_their_lines() {
    let cases = [
        (
            "joints = [\"shoulder\"]",
            "joints = [\"sholder\"]",
            "robot.toml:12: the URDF has no moving joint 'sholder'; did you mean 'shoulder'",
        ),
        ("joints = [\"shoulder\"]", "joints = []", "robot.toml:12: group 'upper' has no list"),
        ("joints = [\"shoulder\"]\n", "", "group 'upper' has no list of names of joints; add joints"),
        (
            "joints = [\"shoulder\"]",
            "joints = [\"shoulder\", \"shoulder\"]",
            "joint 'shoulder' is named twice",
        ),
        (
            "[joint.shoulder]",
            "[group.other]\njoints = [\"elbow\", \"shoulder\"]\n[joint.shoulder]",
            "joint 'shoulder' is also in group",
        ),
        ("[group.upper]", "[group.elbow]", "'elbow' is not allowed as the name of a group"),
        (
            "gear_ratio = 50.0",
            "gear_ration = 50.0",
            "robot.toml:9: unknown key `gear_ration`; did you mean `gear_ratio`?",
        ),
        (
            "rotor.gear_ratio = 80.0",
            "rotor.gear_ratio = -80.0",
            "robot.toml:13: expected a number above 0, got -80",
        ),
        // No joint uses this value.
        ("friction.coulomb_nm = 0.7", "friction.coulomb_nm = \"0.7 Nm\"", "robot.toml:14: expected a number"),
        ("friction.coulomb_nm = 0.7", "friction.coulomb = 0.7", "robot.toml:14: unknown key `coulomb`"),
        ("friction.coulomb_nm = 0.7", "servo_hz = 0.7", "robot.toml:14: unknown key `servo_hz`"),
        (
            "upper = { cascaded = { kv_nms",
            "upper = { cascaded = { kw_nms",
            "robot.toml:22: unknown key `kw_nms_per_rad`",
        ),
        ("upper = { cas", "uper = { cas", "robot.toml:22: the URDF has no moving joint 'uper'"),
        (
            "friction.coulomb_nm = 0.9",
            "friction.static_nm = 0.2",
            "robot.toml:16: static friction must not be below",
        ),
    ];
    for (from, to, words) in cases {
        assert!(LAYERS.contains(from), "{from}");
        let error = load(&LAYERS.replace(from, to), &urdf()).unwrap_err();
        assert!(error.contains(words), "{to}: {error}");
    }
}

/// A torque robot needs no servos, and runs.
#[test]
fn torque_robot_needs_no_servo() {
    let folder = scratch();
    let at = |path: &str| folder.path().join(path);
    let (text, _) = LAYERS.split_once("[profile.only.servo]").unwrap();
    let text = text.replace("\"position\"\nsetpoints = \"held\"", "\"torque\"") + "[simulated]\n";
    fs::create_dir(at("arm")).unwrap();
    fs::write(at("arm/robot.toml"), text).unwrap();
    fs::write(at("arm/planar-2-link.urdf"), urdf()).unwrap();
    let task = "robot = \"arm\"\nduration_s = 0.5\npriority = [\"rest\"]\nstart_rad = { elbow = 1.0 }\n\
                [task.rest.joint-posture]\nfrequency_rad_per_s = 6.0\ndamping_ratio = 1.0\n";
    fs::write(at("hold.toml"), task).unwrap();
    opspace(folder.path(), &["check", "arm", "hold.toml"]).exits(0);
    opspace(folder.path(), &["run", "hold.toml", "--out", "out"]).exits(0);
    opspace(folder.path(), &["run", "hold.toml", "--backend", "position", "--out", "no"])
        .exits(2)
        .says(&["this robot accepts torques"]);
}

/// Compared: the mass matrix of the shoulder with the elbow locked, and that of both joints at the same position.
#[test]
fn locked_joints_and_chains_reduce_the_robot() {
    let own = |head: &str| {
        LAYERS.replace("urdf = \"planar-2-link.urdf\"", &format!("urdf = \"planar-2-link.urdf\"\n{head}"))
    };
    let whole = load(LAYERS, &urdf()).unwrap();
    let locked = load(&own("locked_joints = { elbow = 0.7 }"), &urdf()).unwrap();
    assert_eq!(locked.model.n(), 1);
    let inertia = |robot: &RobotDefinition, q: &[f64]| {
        let mut data = opspace_model::Data::new(&robot.model);
        opspace_model::forward_kinematics(&robot.model, &mut data, q);
        opspace_model::crba(&robot.model, &mut data);
        data.mass_matrix[(0, 0)]
    };
    let (one, both) = (inertia(&locked, &[0.2]), inertia(&whole, &[0.2, 0.7]));
    assert!((one - both).abs() < 1e-12 * both, "{one} {both}");
    let urdf_with_limits =
        urdf().replace("continuous", "revolute").replace("<limit ", "<limit lower=\"-3\" upper=\"3\" ");
    let first = whole.model.frames()[0].name.clone();
    let middle = whole.model.frames().iter().find(|frame| frame.body == Some(0)).unwrap().name.clone();
    let chain = load(&own(&format!("use = {{ from = \"{first}\", to = \"{middle}\" }}")), &urdf()).unwrap();
    assert_eq!(
        chain.model.joints().iter().map(|joint| joint.name.as_str()).collect::<Vec<_>>(),
        ["shoulder"]
    );
    for (head, words) in [
        (
            "locked_joints = { elbo = 0.7 }",
            "robot.toml:3: the URDF has no moving joint 'elbo'; did you mean 'elbow'",
        ),
        ("locked_joints = { elbow = 70.0 }", "robot.toml:3: joint 'elbow' cannot be locked at 70"),
        ("use = { from = \"nowhere\", to = \"tip\" }", "robot.toml:3: the URDF has no link 'nowhere'"),
        ("use = { from = \"tip\", to = \"tip\" }", "no joint moves between"),
        ("use = { from = \"tip\" }", "missing key `to` in `use`"),
    ] {
        let error = load(&own(head), &urdf_with_limits).unwrap_err();
        assert!(error.contains(words), "{head}: {error}");
    }
    let error = load(&own(&format!("use = {{ from = \"tip\", to = \"{middle}\" }}")), &urdf()).unwrap_err();
    assert!(error.contains("link 'tip' is not above link"), "{error}");
}

/// An inertia that no body has is refused on a link that moves, and reported on one that cannot.
#[test]
fn indefinite_inertia_is_refused_only_where_it_moves() {
    let antenna = "<link name=\"antenna\"><inertial><mass value=\"0.001\"/><inertia ixx=\"1e-9\" iyy=\"1e-9\" izz=\"1e-9\" \
                   ixy=\"1e-7\" ixz=\"0\" iyz=\"0\"/></inertial></link><joint name=\"mast\" type=\"fixed\"><parent \
                   link=\"PARENT\"/><child link=\"antenna\"/></joint></robot>";
    let whole = load(LAYERS, &urdf()).unwrap();
    let base = whole.model.frames().iter().find(|frame| frame.body.is_none()).unwrap().name.clone();
    let on = |link: &str| urdf().replace("</robot>", &antenna.replace("PARENT", link));
    let robot = load(LAYERS, &on(&base)).unwrap();
    assert!(
        robot.warnings.iter().any(|w| w.to_string().contains("the link cannot move")),
        "{:?}",
        robot.warnings
    );
    assert!(load(LAYERS, &on("tip")).unwrap_err().contains("not positive semi-definite"));
}
