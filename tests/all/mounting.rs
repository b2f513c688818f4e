//! Arms on walls, ceilings and slopes: `[mount]` of robot.toml.
//!
//! Physics gives three equalities. A robot whose URDF has the mounting as its first, fixed joint is the same robot. A turn about
//! the vertical, and a displacement, change nothing but the coordinates. Without gravity no rotation does; drives that compensate
//! gravity do so in servo periods, at measured positions.

#![expect(clippy::print_stdout, reason = "a test that says that it is skipped")]

use crate::cli_common::{opspace, project, scratch};
use crate::common::{Run, run};
use nalgebra::Vector3;
use opspace_backend::CommandKind;
use opspace_experiment::{Experiment, Files, RobotDefinition, RunOptions, Source};
use opspace_log::Recording;
use opspace_log::recording::ChannelData;
use opspace_loop::RunOutcome;
use opspace_model::{Data, Placement, Postures, gravity, kinematics};
use opspace_mujoco::Mujoco;
use std::f64::consts::{FRAC_PI_2, PI};
use std::path::Path;
use std::sync::Arc;

/// Bound on the rounding of a run, relative to the largest value of a signal, or to 1.
const ROUNDING: f64 = 1e-9;

/// Bound on the differences that remain of gravity when drives compensate it in servo periods, relative as above: 1.04e-4 was
/// the largest.
const COMPENSATED: f64 = 3e-4;

/// Mounting: position (m), and roll, pitch and yaw (rad), of the base.
#[derive(Clone, Copy, Debug)]
struct Mount([f64; 3], [f64; 3]);

const UPRIGHT: Mount = Mount([0.0; 3], [0.0; 3]);
const WALL: Mount = Mount([0.1, -0.3, 1.2], [0.0, FRAC_PI_2, 0.0]);
const CEILING: Mount = Mount([0.4, 0.2, 2.5], [PI, 0.0, 0.3]);
const SLOPE: Mount = Mount([-0.2, 0.5, 0.7], [0.4, -0.5, 1.1]);
const TURNED: Mount = Mount([0.3, -0.8, 0.5], [0.0, 0.0, 2.1]);

impl Mount {
    fn placement(&self) -> Placement {
        Placement::from_rpy(self.1, self.0)
    }

    /// Setting of the robot.
    fn setting(&self) -> String {
        format!("robot.mount={{ xyz_m = {:?}, rpy_rad = {:?} }}", self.0, self.1)
    }

    /// Point and direction of the upright task in the world of this mounting, as text.
    fn point(&self, point: [f64; 3]) -> String {
        let [x, y, z]: [f64; 3] = self.placement().act_point(&Vector3::from(point)).into();
        format!("[{x:?}, {y:?}, {z:?}]")
    }

    fn direction(&self, direction: [f64; 3]) -> String {
        let [x, y, z]: [f64; 3] = (self.placement().rotation * Vector3::from(direction)).into();
        format!("[{x:?}, {y:?}, {z:?}]")
    }

    /// Settings of a Cartesian task whose axes turn with the base.
    fn axes(&self, task: &str) -> String {
        format!("task.{task}.cartesian.axes_frame={{ rpy_rad = {:?} }}", self.1)
    }

    /// Settings that turn a shipped task with the base.
    fn task(&self, name: &str) -> Vec<String> {
        let wall = |object: &str, point, normal| {
            [
                format!("environment.{object}.wall.point_m={}", self.point(point)),
                format!("environment.{object}.wall.normal={}", self.direction(normal)),
            ]
        };
        let by = self.direction([0.03, 0.02, -0.04]);
        let operator = [
            "environment.operator.spring.gain=[1.0, 1.0, 1.0]".to_owned(),
            "environment.operator.spring.report=[\"x\"]".to_owned(),
            format!(
                "environment.operator.spring.motion={{ scripted = {{ reach = [{{ at_s = 0.2, duration_s = 0.8, by_m = {by} }}] }} }}"
            ),
        ];
        let mut settings = match name {
            "press-wall" => wall("board", [0.37, 0.0, 0.0], [-1.0, 0.0, 0.0]).to_vec(),
            "press-tool" => wall("board", [0.36, 0.0, -0.177], [0.0, 0.0, 1.0]).to_vec(),
            "compliant-x" | "gravity-compensation" => operator.to_vec(),
            _ => Vec::new(),
        };
        if name != "gravity-compensation" && name != "joint-tracking" {
            settings.push(self.axes("hand"));
        }
        settings
    }
}

/// Options of a run of two seconds.
fn options(backend: CommandKind) -> RunOptions {
    RunOptions { backend, ..RunOptions::default() }
}

/// Loads a shipped task with settings; `surgery` mounts the robot by its URDF.
fn load(name: &str, backend: CommandKind, settings: &[String], surgery: Option<Mount>) -> Experiment {
    let path = project(&format!("tasks/{name}.toml"));
    let experiment = Experiment::load(Files::Disk, Path::new(&path), None, options(backend), settings)
        .unwrap_or_else(|error| panic!("{error}"));
    let Some(Mount(xyz, rpy)) = surgery else { return experiment };
    let list = |[x, y, z]: [f64; 3]| format!("{x:?} {y:?} {z:?}");
    let robot = experiment.robot();
    let text = robot.urdf.text().replace(
        "</robot>",
        &format!(
            "<link name=\"stand\"/><joint name=\"mounting\" type=\"fixed\"><parent link=\"stand\"/><child link=\"torso\"/>\
             <origin xyz=\"{}\" rpy=\"{}\"/></joint></robot>",
            list(xyz),
            list(rpy)
        ),
    );
    let urdf = Source::new(robot.urdf.name(), text);
    let robot =
        RobotDefinition::from_sources(robot.source.clone(), urdf).unwrap_or_else(|error| panic!("{error}"));
    Experiment::new(robot, experiment.task().clone(), options(backend), Vec::new())
        .unwrap_or_else(|error| panic!("{error}"))
}

/// Setting without which a rounding error would move an encoder by a count.
const EXACT_ENCODERS: &str = "robot.simulated.encoder_quantisation=false";

/// Settings of short runs.
const SHORT: [&str; 3] = ["duration_s=2.0", "settle_s=0.1", "expect={}"];

/// Runs a shipped task on the arm with this mounting in a world without gravity.
fn run_without_gravity(name: &str, backend: CommandKind, mount: Mount) -> Run {
    let mut settings = mount.task(name);
    settings.extend(SHORT.map(str::to_owned));
    settings.extend([EXACT_ENCODERS.to_owned(), mount.setting()]);
    let loaded = load(name, backend, &settings, None);
    let mut robot = loaded.robot().clone();
    robot.model = robot.model.with_gravity(Vector3::zeros());
    let experiment = Experiment::new(robot, loaded.task().clone(), options(backend), Vec::new());
    completed(&experiment.unwrap_or_else(|error| panic!("{error}")))
}

/// Runs a shipped task on the arm with this mounting, in `[mount]` or in the URDF. Both use these settings.
fn run_mounted(name: &str, backend: CommandKind, mount: Mount, in_urdf: bool, settings: &[String]) -> Run {
    let mut all = settings.to_vec();
    all.extend(SHORT.map(str::to_owned));
    all.push(EXACT_ENCODERS.to_owned());
    all.extend((!in_urdf).then(|| mount.setting()));
    completed(&load(name, backend, &all, in_urdf.then_some(mount)))
}

fn completed(experiment: &Experiment) -> Run {
    let run = run(experiment);
    assert_eq!(run.ending, RunOutcome::Completed);
    run
}

/// Checks that all signals of two recordings, except those that `skips` names, are equal within rounding of their largest values.
/// Wall-clock times are no results.
fn assert_equal(first: &Recording, second: &Recording, context: &str, skips: impl Fn(&str) -> bool) {
    assert_close(first, second, ROUNDING, context, skips);
}

/// As [`assert_equal`], within another bound.
fn assert_close(
    first: &Recording,
    second: &Recording,
    bound: f64,
    context: &str,
    skips: impl Fn(&str) -> bool,
) {
    let (mut compared, mut errors) = (0, Vec::new());
    for channel in first.channels.iter().filter(|channel| channel.layout.channel != "timing") {
        let other = second.channel(&channel.layout.channel).expect("the same channels");
        assert_eq!(channel.time_s, other.time_s, "{context}");
        let signals = channel.layout.signals.iter().map(|signal| signal.name.as_str());
        for name in signals.filter(|name| !skips(name)) {
            let values = |channel: &ChannelData| -> Vec<f64> {
                channel.signal(name).expect("the same signals").rows().flatten().copied().collect()
            };
            let (here, there) = (values(channel), values(other));
            let scale =
                here.iter().map(|value| value.abs()).filter(|value| value.is_finite()).fold(1.0, f64::max);
            let pairs = here.iter().zip(&there);
            let is_close = |(a, b): (&f64, &f64)| a.is_nan() && b.is_nan() || (a - b).abs() <= bound * scale;
            if here.len() != there.len() || !pairs.clone().all(is_close) {
                let error = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                errors.push(format!("{name}: {error:.1e} of {scale:.1e}"));
            }
            compared += 1;
        }
    }
    assert!(errors.is_empty(), "{context}: {}", errors.join(", "));
    assert!(compared >= 20, "{context}: {compared} signals");
}

/// True for signals in the world, which the mounting moves or turns.
fn is_of_world(name: &str) -> bool {
    let of_world = [
        "position",
        "orientation",
        "velocity",
        "force",
        "moment",
        "wrench",
        "reference",
        "reference_velocity",
        "reference_acceleration",
        "reference_orientation",
    ];
    name.rsplit('.').next().is_some_and(|quantity| of_world.contains(&quantity))
}

const TASKS: [&str; 5] =
    ["press-wall", "gravity-compensation", "compliant-x", "press-tool", "joint-tracking"];
const BACKENDS: [CommandKind; 2] = [CommandKind::Position, CommandKind::Torque];

/// Compared: all signals of runs with `[mount]`, and with the mounting as the first joint of the URDF: force control on a wall, with
/// the weight of a tool in the sensor, compliant axes, gravity compensation and joint tracking, on position and torque robots.
#[test]
fn mount_equals_fixed_joint_of_the_urdf() {
    for name in TASKS {
        for backend in BACKENDS {
            for mount in [WALL, CEILING, SLOPE] {
                let mut settings = mount.task(name);
                settings.extend(["simulated.force_sensor", "force_sensor"].map(|sensor| {
                    format!("robot.{sensor}.wrist.load={{ mass_kg = 0.3, centre_m = [0.0, 0.01, -0.05] }}")
                }));
                let [here, there] =
                    [false, true].map(|in_urdf| run_mounted(name, backend, mount, in_urdf, &settings));
                assert_equal(
                    &here.recording,
                    &there.recording,
                    &format!("{name}, {backend:?}, {mount:?}"),
                    |_| false,
                );
            }
        }
    }
}

/// Compared: runs of an arm that is turned about the vertical and displaced, with its task, and of the upright arm: all signals that
/// are not in the world.
#[test]
fn turn_about_the_vertical_changes_coordinates_alone() {
    for name in TASKS {
        for backend in BACKENDS {
            let [upright, turned] =
                [UPRIGHT, TURNED].map(|mount| run_mounted(name, backend, mount, false, &mount.task(name)));
            assert_equal(&upright.recording, &turned.recording, &format!("{name}, {backend:?}"), is_of_world);
        }
    }
}

/// Compared: runs of an arm without gravity, on a wall, a ceiling and a slope with its task, and upright.
#[test]
fn arm_without_gravity_moves_alike_in_all_mountings() {
    for name in ["press-wall", "compliant-x"] {
        for backend in BACKENDS {
            let [upright, others @ ..] =
                [UPRIGHT, WALL, CEILING, SLOPE].map(|mount| run_without_gravity(name, backend, mount));
            for other in others {
                assert_equal(
                    &upright.recording,
                    &other.recording,
                    &format!("{name}, {backend:?}"),
                    is_of_world,
                );
            }
        }
    }
}

/// Compared: torques that hold the mounted arm, and those of the upright model under gravity turned back, for all shipped robots in
/// twenty postures; they differ from those of the upright arm.
#[test]
fn gravity_turns_with_the_mounting() {
    for name in ["asimo-arm", "panda", "ur5e", "planar-2-link"] {
        for mount in [WALL, CEILING, SLOPE] {
            let path = project(&format!("robots/{name}"));
            let load = |settings: &[String]| {
                RobotDefinition::load(Files::Disk, Path::new(&path), settings)
                    .unwrap_or_else(|error| panic!("{error}"))
                    .model
            };
            let (mounted, upright) = (load(&[mount.setting()]), load(&[]));
            let turned =
                upright.clone().with_gravity(mount.placement().rotation.transpose() * upright.gravity());
            let mut differs = 0.0_f64;
            for number in 0..20 {
                let q = Postures::new(&upright, 1.0).posture(number);
                let torques = [&mounted, &turned, &upright].map(|model| {
                    let mut data = Data::new(model);
                    kinematics(model, &mut data, &q, &vec![0.0; model.n()]);
                    gravity(model, &mut data);
                    data.gravity
                });
                let error = (&torques[0] - &torques[1]).amax();
                assert!(error < 1e-12 * torques[1].amax().max(1.0), "{name}, {mount:?}: {error}");
                differs = differs.max((&torques[0] - &torques[2]).amax());
            }
            assert!(differs > 1.0, "{name}, {mount:?}");
        }
    }
}

/// Runs the teleoperation for 1.5 s with both arms in this mounting, with settings for each of them, and returns their logs.
fn teleoperate(mount: &Mount, in_robot_file: bool, settings: &[String]) -> [Recording; 2] {
    let folder = scratch();
    let by = mount.direction([0.0, 0.0, -0.06]);
    let mut all = vec![
        "settle_s=0.1".to_owned(),
        "expect={}".to_owned(),
        format!(
            "leader.environment.operator.spring.motion={{ scripted = {{ reach = [{{ at_s = 0.3, duration_s = 0.7, by_m = {by} }}] }} }}"
        ),
        format!("follower.environment.table.wall.point_m={}", mount.point([0.36, 0.0, -0.187])),
        format!("follower.environment.table.wall.normal={}", mount.direction([0.0, 0.0, 1.0])),
    ];
    for robot in ["leader", "follower"] {
        all.push(format!("{robot}.robot.simulated.encoder_quantisation=false"));
        all.extend(settings.iter().map(|setting| format!("{robot}.{setting}")));
        all.push(format!("{robot}.task.hand.coupled.axes_rpy_rad={:?}", mount.1));
        if in_robot_file {
            all.push(format!("{robot}.{}", mount.setting()));
        } else {
            all.push(format!("robots.{robot}.base_m={:?}", mount.0));
            all.push(format!("robots.{robot}.base_rpy_rad={:?}", mount.1));
        }
    }
    let experiment = project("tasks/experiments/teleop-wall.toml");
    let mut arguments = vec!["run", &experiment, "--duration-s", "1.5", "--out", "out", "--quiet"];
    arguments.extend(all.iter().flat_map(|setting| ["--set", setting.as_str()]));
    opspace(folder.path(), &arguments).exits(0);
    let replayed = opspace(folder.path(), &["replay", "out"]).exits(0).stdout;
    assert!(replayed.contains("ticks are equal"), "{replayed}");
    ["leader", "follower"]
        .map(|robot| Recording::read(folder.path().join(format!("out/{robot}/run.mcap"))).expect("a log"))
}

/// Compared: a teleoperation with a table of two arms that are turned about the vertical, and of upright ones; with the placement in
/// the file of the experiment, and in the robot files.
#[test]
fn teleoperation_is_the_same_in_other_places() {
    let upright = teleoperate(&UPRIGHT, true, &[]);
    let turned = teleoperate(&TURNED, true, &[]);
    let placed = teleoperate(&TURNED, false, &[]);
    for (number, upright) in upright.iter().enumerate() {
        assert_equal(upright, &turned[number], "turned", is_of_world);
        assert_equal(&turned[number], &placed[number], "placed", |_| false);
    }
}

/// Compared: the teleoperation of two arms that compensate their own weight, on a wall, a ceiling and a slope with their task, and
/// upright.
#[test]
fn teleoperation_of_compensating_arms_is_the_same_in_all_mountings() {
    let weightless = ["robot.interface.gravity_compensated_by=robot".to_owned()];
    let [upright, others @ ..] =
        [UPRIGHT, WALL, CEILING, SLOPE].map(|mount| teleoperate(&mount, false, &weightless));
    for other in others {
        for (upright, other) in upright.iter().zip(&other) {
            assert_close(upright, other, COMPENSATED, "teleoperation", is_of_world);
        }
    }
}

/// Compared: a run on a wall with MuJoCo, with `[mount]` and with the mounting in the URDF, and with the own plant. Skipped without
/// MuJoCo.
#[test]
fn mujoco_simulates_the_mounted_arm() {
    let mujoco = match Mujoco::find(None) {
        Ok(mujoco) => Arc::new(mujoco),
        Err(error) => {
            println!("SKIPPED, a test with MuJoCo: {error}");
            return;
        }
    };
    let mut settings = WALL.task("press-wall");
    settings.extend(
        ["duration_s=1.0", "settle_s=0.1", "robot.simulated.encoder_quantisation=false"].map(str::to_owned),
    );
    let [here, there] = [None, Some(WALL)].map(|surgery| {
        let mut settings = settings.clone();
        settings.extend(surgery.is_none().then(|| WALL.setting()));
        load("press-wall", CommandKind::Torque, &settings, surgery)
    });
    let own = run(&here).recording;
    let [here, there] = [here, there].map(|experiment| {
        run(&experiment.on_engine(mujoco.clone()).unwrap_or_else(|error| panic!("{error}"))).recording
    });
    assert_equal(&here, &there, "MuJoCo", |_| false);
    let last = |recording: &Recording| {
        let q = recording.channel("tick").and_then(|tick| tick.signal("q")).expect("positions");
        Vec::from(q.rows().last().expect("rows"))
    };
    let error = last(&own).iter().zip(last(&here)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(error < 1e-3, "{error}");
}

/// Checks that a robot whose base is placed twice, or at angles in degrees, is refused with both keys.
#[test]
fn contradicting_placements_are_refused() {
    let folder = scratch();
    let experiment = project("tasks/experiments/two-arms-carry.toml");
    let check = |settings: &[&str]| {
        let mut arguments = vec!["check", experiment.as_str()];
        arguments.extend(settings.iter().flat_map(|setting| ["--set", setting]));
        opspace(folder.path(), &arguments)
    };
    check(&[]).exits(0);
    check(&["left.robot.mount.xyz_m=[0.0, 0.0, 1.0]"]).exits(2).says(&[
        "`base_m`",
        "robot.mount.xyz_m",
        "robot 'left'",
    ]);
    check(&["robots.right.base_rpy_rad=[0.0, 90.0, 0.0]"])
        .exits(2)
        .says(&["base_rpy_rad", "more than a turn"]);
    check(&["right.robot.mount.rpy_rad=[0.0, 90.0, 0.0]"]).exits(2).says(&["more than a turn", "1.570796"]);
    // The same with [mount] in the file of the robot.
    let robot = folder.path().join("arm");
    std::fs::create_dir(&robot).expect("a folder");
    for name in ["robot.toml", "asimo-arm.urdf"] {
        let text = std::fs::read_to_string(project(&format!("robots/asimo-arm/{name}"))).expect("a file");
        let mount = if name == "robot.toml" { "mount = { xyz_m = [0.0, 0.0, 1.0] }\n" } else { "" };
        std::fs::write(robot.join(name), format!("{mount}{text}")).expect("it is written");
    }
    let setting = format!("robots.left.robot=\"{}\"", robot.display());
    check(&[&setting]).exits(2).says(&["`base_m`", "[mount] of", "robot.toml", "robot 'left'"]);
    opspace(folder.path(), &["check", "arm"]).exits(0);
    let said = opspace(folder.path(), &["model", "arm"]).exits(0).stdout;
    assert!(said.contains("mounted with its base at [0, 0, 1] m"), "{said}");
}

/// Compared: the file that `opspace new --mount` writes, and its argument; and the tip of the first task, and a check of it. The arm
/// hangs, so that its first posture is below its base.
#[test]
fn new_robot_is_mounted() {
    let folder = scratch();
    let urdf = project("robots/ur5e/ur5e.urdf");
    let new = ["new", "arm", "--urdf", &urdf, "--assume", "--mount", "0,0,2.0,3.141592653589793,0,0"];
    let said = opspace(folder.path(), &new).exits(0).stdout;
    let text = std::fs::read_to_string(folder.path().join("arm/robot.toml")).expect("robot.toml");
    assert!(
        text.contains("\nmount = { xyz_m = [0.0, 0.0, 2.0], rpy_rad = [3.141592653589793, 0.0, 0.0] }"),
        "{text}"
    );
    let height = said.split("z = ").nth(1).and_then(|rest| rest.split(' ').next()).expect("the tip");
    assert!(height.parse::<f64>().expect("a number") < 2.0, "{said}");
    opspace(folder.path(), &["check", "arm/first-task.toml"]).exits(0);
    opspace(folder.path(), &["run", "arm/first-task.toml", "--duration-s", "1", "--set", "settle_s=0.1"])
        .exits(0);
    opspace(folder.path(), &["new", "b", "--urdf", &urdf, "--mount", "0,0"])
        .exits(2)
        .says(&["--mount has 2 values"]);
    opspace(folder.path(), &["new", "b", "--urdf", &urdf, "--mount", "0,0,0,90,0,0"])
        .exits(2)
        .says(&["more than a turn"]);
}
