//! Arms that keep away from obstacles and from themselves: Panda, UR5e and random arms with random goals, from folded
//! postures and past obstacles. Their capsules are compared by a search that shares no code with the controller's.

use crate::common::{self, File, Link, Numbers, at_state, random_arm};
use crate::limited_motion::ROUNDING;
use nalgebra::{DVector, Vector3};
use opspace_control::{
    CollisionLimits, ControlContext, Controller, JointLimits, Measurement, OperationalSpaceController,
};
use opspace_model::collision::{
    Capsule, CapsuleSource, CollisionData, CollisionModel, CollisionShape, HalfSpace, Holder, LinkCapsule,
    PairSampling, collision_distances, generate_capsules,
};
use opspace_model::urdf::link_shapes;
use opspace_model::{Data, Model, aba, forward_kinematics, frame_placement, update};
use std::path::Path;

const PERIOD_S: f64 = 1e-3;
/// Distance that the controller keeps, m.
const MARGIN_M: f64 = 0.02;

/// An arm, its controlled frame, the capsules of its links and the limits of its joints.
#[derive(Clone)]
struct Robot {
    name: String,
    model: Model,
    hand: &'static str,
    capsules: Vec<LinkCapsule>,
    limits: JointLimits,
}

fn read(path: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(path);
    std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// The capsules of robot.toml if it lists any, else those that are generated.
fn of_project(name: &str) -> Robot {
    let urdf = read(&format!("robots/{name}/{name}.urdf"));
    let model = Model::from_urdf(&urdf).expect("a URDF").model;
    let file: toml::Table = toml::from_str(&read(&format!("robots/{name}/robot.toml"))).expect("TOML");
    let numbers = |value: &toml::Value| -> [f64; 3] {
        let list = value.as_array().expect("a list");
        [0, 1, 2].map(|i| list[i].as_float().expect("a number"))
    };
    let listed = file.get("collision").and_then(|c| c.get("capsule")).and_then(toml::Value::as_array);
    let capsules = match listed {
        Some(list) => (list.iter().enumerate())
            .map(|(number, capsule)| LinkCapsule {
                name: number.to_string(),
                link: capsule["link"].as_str().expect("a link").to_owned(),
                start_m: numbers(&capsule["start_m"]),
                end_m: numbers(&capsule["end_m"]),
                radius_m: capsule["radius_m"].as_float().expect("a number"),
                source: CapsuleSource::User,
            })
            .collect(),
        None => generate_capsules(&link_shapes(&urdf).expect("a URDF"), None).expect("no mesh").capsules,
    };
    let limits = JointLimits::of(&model);
    Robot { name: name.to_owned(), model, hand: "flange", capsules, limits }
}

/// A random arm with a capsule from each joint to the next one.
fn random(joints: usize, numbers: &mut Numbers) -> Robot {
    let mut model = random_arm(joints, numbers);
    model.add_frame("base", None, opspace_model::Placement::identity());
    let mut data = Data::new(&model);
    forward_kinematics(&model, &mut data, &vec![0.0; joints]);
    let place = |frame: &str| frame_placement(&model, &data, model.frame_id(frame).expect("a frame"));
    let names: Vec<String> = (1..=joints).map(|i| format!("j{i}")).chain(["hand".to_owned()]).collect();
    let mut capsules: Vec<LinkCapsule> = names
        .windows(2)
        .map(|pair| {
            let [own, next] = [place(&pair[0]), place(&pair[1])];
            let end = own.inverse().act_point(&next.translation);
            LinkCapsule {
                name: pair[0].clone(),
                link: pair[0].clone(),
                start_m: [0.0; 3],
                end_m: end.into(),
                radius_m: 0.03 + 0.015 * (0.5 + 0.5 * numbers.next()),
                source: CapsuleSource::User,
            }
        })
        .collect();
    let post = LinkCapsule {
        name: "base".into(),
        link: "base".into(),
        start_m: [0.0, 0.0, -0.5],
        ..capsules[0].clone()
    };
    capsules.push(LinkCapsule { end_m: [0.0; 3], radius_m: 0.06, ..post });
    let limits = JointLimits {
        velocity: vec![3.0; joints],
        torque: (0..joints).map(|i| 150.0 / (1.0 + i as f64)).collect(),
        ..JointLimits::of(&model)
    };
    Robot { name: format!("arm of {joints} joints"), model, hand: "hand", capsules, limits }
}

/// Number of points into which an axis is divided.
const POINTS: usize = 25;

/// Smallest distance of the pairs of a state, m: the axes of both capsules are divided into points, whose distances from
/// the other axis are computed. It exceeds the exact one by less than a millimetre.
fn sampled_distance(geometry: &CollisionModel, model: &Model, data: &Data) -> f64 {
    let placed = |object: usize| {
        let object = &geometry.objects()[object];
        let CollisionShape::Capsule(capsule) = object.shape else { panic!("a capsule") };
        match object.holder {
            Holder::World => capsule,
            Holder::Base => capsule.placed(&model.base()),
            Holder::Body(body) => capsule.placed(&data.placement[body]),
        }
    };
    let points = |capsule: &Capsule| {
        let Capsule { start_m, end_m, .. } = *capsule;
        (0..POINTS).map(move |i| start_m + (end_m - start_m) * (i as f64 / (POINTS - 1) as f64))
    };
    let mut least = f64::INFINITY;
    for pair in geometry.pairs() {
        let a = placed(pair.a);
        let distances: Vec<f64> = match geometry.objects()[pair.b].shape {
            CollisionShape::HalfSpace(HalfSpace { normal, offset_m }) => {
                points(&a).map(|point| normal.dot(&point) - offset_m).collect()
            }
            CollisionShape::Capsule(_) => {
                let b = placed(pair.b);
                let from_b = points(&a).map(|point| from_axis(&b, &point) - b.radius_m);
                let from_a = points(&b).map(|point| from_axis(&a, &point) - b.radius_m);
                from_b.chain(from_a).collect()
            }
        };
        least = distances.into_iter().fold(least, |least, distance| least.min(distance - a.radius_m));
    }
    least
}

/// Distance of a point from the axis of a capsule, m.
fn from_axis(capsule: &Capsule, point: &Vector3<f64>) -> f64 {
    let (along, to_point) = (capsule.end_m - capsule.start_m, point - capsule.start_m);
    let square = along.norm_squared();
    let fraction = if square > 0.0 { (to_point.dot(&along) / square).clamp(0.0, 1.0) } else { 0.0 };
    (to_point - along * fraction).norm()
}

/// A start, a goal, and obstacles between them.
struct Scene {
    robot: Robot,
    geometry: CollisionModel,
    start: Vec<f64>,
    goal: Vec<f64>,
}

impl Scene {
    /// Creates a scene whose start and goal keep the margin. With `folded`, links are close to each other at the goal.
    /// `None` if the arm collides with itself in nearly all postures.
    fn new(robot: Robot, folded: bool, numbers: &mut Numbers) -> Option<Self> {
        let model = &robot.model;
        let mut own = CollisionModel::new(model, &robot.capsules).expect("links of the model");
        let sampling = PairSampling { colliding_m: MARGIN_M, ..PairSampling::default() };
        own.drop_unneeded_pairs(model, &sampling);
        let mut data = Data::new(model);
        let mut distance = |geometry: &CollisionModel, q: &[f64]| {
            forward_kinematics(model, &mut data, q);
            let mut near = CollisionData::new(geometry);
            collision_distances(geometry, model, &data, f64::INFINITY, &mut near);
            near.near().map(|(_, proximity)| proximity.distance_m).fold(f64::INFINITY, f64::min)
        };
        let mut tries = 0;
        let mut posture = |closest: f64| loop {
            tries += 1;
            if tries > 20_000 {
                return None;
            }
            let q: Vec<f64> = (model.joints().iter())
                .map(|joint| {
                    let (lower, upper) = (joint.limits.lower.max(-3.0), joint.limits.upper.min(3.0));
                    numbers.between(lower + 0.05, upper - 0.05)
                })
                .collect();
            let distance = distance(&own, &q);
            // Some arms cannot fold.
            if distance > MARGIN_M + 0.002 && (distance < closest || tries > 2000) {
                return Some(q);
            }
        };
        let closest = if folded { MARGIN_M + 0.03 } else { f64::INFINITY };
        let (start, goal) = (posture(f64::INFINITY)?, posture(closest)?);
        let mut geometry = own.clone();
        if !folded {
            let hand = model.frame_id(robot.hand).expect("a hand");
            let mut data = Data::new(model);
            let [from, to] = [&start, &goal].map(|q| {
                forward_kinematics(model, &mut data, q);
                frame_placement(model, &data, hand).translation
            });
            let mut count = 0;
            while count < 3 {
                let middle = from + (to - from) * numbers.between(0.2, 0.8) + numbers.vector3(0.1);
                let shape = match numbers.below(3) {
                    0 => CollisionShape::Capsule(Capsule::sphere(middle, numbers.between(0.03, 0.15))),
                    1 => CollisionShape::Capsule(Capsule {
                        start_m: middle,
                        end_m: middle + numbers.vector3(0.5),
                        radius_m: numbers.between(0.02, 0.1),
                    }),
                    _ => {
                        let normal = numbers.vector3(1.0).normalize();
                        CollisionShape::HalfSpace(HalfSpace { normal, offset_m: normal.dot(&middle) - 0.1 })
                    }
                };
                let mut with = geometry.clone();
                with.add_obstacle(&format!("obstacle {count}"), shape).expect("a shape");
                // Links that cannot move away from an obstacle are of no interest.
                with.drop_unneeded_pairs(model, &PairSampling { postures: 200, ..sampling });
                let clear = [&start, &goal].iter().all(|q| {
                    forward_kinematics(model, &mut data, q);
                    let mut near = CollisionData::new(&with);
                    collision_distances(&with, model, &data, f64::INFINITY, &mut near);
                    near.near().all(|(_, proximity)| proximity.distance_m > MARGIN_M + 0.002)
                });
                if clear || numbers.below(200) == 0 {
                    count += 1;
                    if clear {
                        geometry = with;
                    }
                }
            }
        }
        Some(Self { robot, geometry, start, goal })
    }

    /// Tasks that move the hand to its pose at the goal: its position alone, or with its orientation.
    fn tasks(&self, pose: bool) -> String {
        let (model, mut data) = (&self.robot.model, Data::new(&self.robot.model));
        let hand = model.frame_id(self.robot.hand).expect("a hand");
        let [from, to] = [&self.start, &self.goal].map(|q| {
            forward_kinematics(model, &mut data, q);
            frame_placement(model, &data, hand)
        });
        let away = to.translation - from.translation;
        let (axes, turn) = if pose {
            let (roll, pitch, yaw) =
                nalgebra::Rotation3::from_matrix(&(to.rotation * from.rotation.transpose())).euler_angles();
            (
                ", rx = \"motion\", ry = \"motion\", rz = \"motion\"",
                format!(", orientation = {{ offset_rpy_rad = [{roll}, {pitch}, {yaw}] }}"),
            )
        } else {
            ("", String::new())
        };
        format!(
            "priority = [\"hand\", \"rest\"]\n[task.hand.cartesian]\nframe = \"{}\"\naxes = {{ x = \"motion\", y = \"motion\", z \
             = \"motion\"{axes} }}\ncharacteristic_length_m = 0.4\nreference.point-to-point = {{ position = {{ offset_m = [{}, {}, \
             {}] }}{turn}, duration_s = 1.5 }}\ngains = {{ frequency_rad_per_s = 14.0, damping_ratio = 1.0 \
             }}\n[task.rest.joint-posture]\nfrequency_rad_per_s = 4.0\ndamping_ratio = 1.0\n",
            self.robot.hand, away.x, away.y, away.z
        )
    }
}

/// Result of a motion.
#[derive(Debug)]
struct Motion {
    /// Smallest distance, m.
    least_m: f64,
    /// Highest joint speed in the last second, rad/s.
    final_speed: f64,
    /// Largest change of a torque between cycles in the last second, relative to its limit.
    final_jump: f64,
    /// Distance of the hand from its goal, m.
    missed_m: f64,
    /// True if the last second had cycles at a limit.
    limited: bool,
}

fn run(scene: &Scene, pose: bool, duration_s: f64, enforced: bool) -> Motion {
    let Robot { model, limits, .. } = &scene.robot;
    let file = File::read(&scene.tasks(pose));
    let collision = CollisionLimits { geometry: scene.geometry.clone(), margin_m: MARGIN_M };
    let context = ControlContext {
        limits: limits.clone(),
        collision: enforced.then_some(collision),
        ..ControlContext::new(model, PERIOD_S)
    };
    let mut controller =
        OperationalSpaceController::new(model, &file.task_set(), &context).expect("a good stack");
    let n = model.n();
    let (mut data, mut seen): (Data, Measurement) = at_state(model, &scene.start, &vec![0.0; n], 0.0);
    controller.start(&common::input(model, &data, &seen));
    let mut tau = DVector::zeros(n);
    let mut motion =
        Motion { least_m: f64::INFINITY, final_speed: 0.0, final_jump: 0.0, missed_m: 0.0, limited: false };
    let ticks = (duration_s / PERIOD_S) as usize;
    for tick in 0..ticks {
        let before = tau.clone();
        assert!(update(model, &mut data, seen.q.as_slice(), seen.dq.as_slice()));
        controller.update(&common::input(model, &data, &seen), tau.as_mut_slice());
        assert!(tau.iter().all(|t| t.is_finite()), "{}: {tau} at {} s", scene.robot.name, seen.time_s);
        if tick % 10 == 0 {
            motion.least_m = motion.least_m.min(sampled_distance(&scene.geometry, model, &data));
        }
        aba(model, &mut data, tau.as_slice());
        seen.q.axpy(PERIOD_S, &seen.dq, 1.0);
        seen.q.axpy(0.5 * PERIOD_S * PERIOD_S, &data.ddq, 1.0);
        seen.dq.axpy(PERIOD_S, &data.ddq, 1.0);
        seen.time_s += PERIOD_S;
        if tick + 1000 > ticks {
            motion.final_speed = motion.final_speed.max(seen.dq.amax());
            let jumps = (0..n).map(|i| (tau[i] - before[i]).abs() / limits.torque[i]);
            motion.final_jump = motion.final_jump.max(jumps.fold(0.0, f64::max));
            motion.limited |= controller.is_limited();
        }
    }
    let hand = model.frame_id(scene.robot.hand).expect("a hand");
    let at = frame_placement(model, &data, hand).translation;
    forward_kinematics(model, &mut data, &scene.goal);
    motion.missed_m = (frame_placement(model, &data, hand).translation - at).norm();
    motion
}

/// Every fourth scene is of the same arm; half of them have obstacles, the others folded arms; half have a goal of
/// position alone, the others a pose.
fn scene(number: u64) -> Option<(Scene, bool)> {
    let mut numbers = Numbers::new(1000 + number);
    let robot = match number % 4 {
        0 => of_project("panda"),
        1 => of_project("ur5e"),
        2 => random(6, &mut numbers),
        _ => random(7, &mut numbers),
    };
    let folded = (number / 4) % 2 == 1;
    Some((Scene::new(robot, folded, &mut numbers)?, (number / 8) % 2 == 1))
}

/// Distance from a goal at which it is reached, m.
const REACHED_M: f64 = 1e-3;

/// Distance from the margin within which an arm is at it, m. Sampled distances exceed exact ones by up to this. Measured:
/// arms pass their margin by 0.02 mm.
const AT_MARGIN_M: f64 = 1e-3;

/// Largest change of a torque between two cycles of an arm that rests at its goal, relative to the limit of the torque:
/// measured 1.5e-4. Arms that still move change it by up to 1.2e-2.
const JUMP_AT_REST: f64 = 1e-2;

/// Speed of an arm that does not come to rest, rad/s.
const IN_A_CYCLE: f64 = 0.5;

/// Duration of the motion of an arm that still moves fast at the end of the usual one, s: many slide along an obstacle
/// towards their goals for longer.
const LONG_S: f64 = 25.0;

/// Checks motions to random goals: no distance is below the margin by more than a millimetre, and an arm that reaches its
/// goal rests there, without a jump of its torques. Returns the number of arms that still move fast in the last second,
/// and the number of scenes.
fn check_scenes(range: std::ops::Range<u64>, duration_s: f64) -> [usize; 2] {
    let [mut limited, mut reached, mut moving, mut count] = [0; 4];
    for number in range {
        let Some((scene, pose)) = scene(number) else { continue };
        count += 1;
        let mut motion = run(&scene, pose, duration_s, true);
        if motion.final_speed > IN_A_CYCLE {
            motion = run(&scene, pose, LONG_S, true);
        }
        let name = format!("scene {number}, {}: {motion:?}", scene.robot.name);
        assert!(motion.least_m > MARGIN_M - AT_MARGIN_M, "{name}");
        moving += usize::from(motion.final_speed > IN_A_CYCLE);
        limited += usize::from(motion.least_m < MARGIN_M + AT_MARGIN_M);
        if motion.missed_m < REACHED_M && motion.final_speed < 1.0 {
            assert!(motion.final_jump < JUMP_AT_REST, "{name}");
            reached += 1;
        }
    }
    assert!(limited * 3 > count && reached * 5 > count, "{limited} and {reached} of {count}");
    [moving, count]
}

/// Compared, for two dozen scenes: the smallest distance of capsules on the way, by points on their axes, with the margin.
#[test]
fn arms_keep_their_distances() {
    check_scenes(0..24, 3.0);
}

/// Compared, for a thousand scenes: these distances with the margin. Most goals are blocked, and one arm in twenty still
/// slides along an obstacle or its limits after six seconds; none moves fast at the end of a longer time.
#[test]
#[ignore = "two minutes"]
fn arms_keep_their_distances_in_a_thousand_scenes() {
    let [moving, count] = check_scenes(0..1000, 6.0);
    assert!(moving == 0, "{moving} of {count} arms move");
}

/// Compared: the distances of the same scenes without limits: most of the arms collide.
#[test]
fn arms_without_distances_collide() {
    let collided = (0..16).filter(|&number| {
        scene(number).is_some_and(|(scene, pose)| run(&scene, pose, 2.0, false).least_m < 0.0)
    });
    let count = collided.count();
    assert!(count > 5, "{count} of 16");
}

/// A planar arm of three joints above the ground; its last link is a capsule.
fn planar_arm() -> Model {
    let link = |name, origin, mass: f64| Link {
        name,
        axis: [0.0, 1.0, 0.0],
        origin,
        mass,
        com: [0.2, 0.0, 0.0],
        inertia: [0.002, 0.02, 0.02],
        limits: [-3.0, 3.0],
        rotor: 0.05,
    };
    let reach = [0.4, 0.0, 0.0];
    let links = [link("j1", [0.0; 3], 2.0), link("j2", reach, 1.5), link("j3", reach, 1.0)];
    common::arm(&links, &[("hand", 2, reach), ("middle", 2, [0.2, 0.0, 0.0])], 1.0)
}

fn flat(name: &str, radius_m: f64) -> LinkCapsule {
    LinkCapsule {
        name: name.to_owned(),
        link: "j3".to_owned(),
        start_m: [0.05, 0.0, 0.0],
        end_m: [0.35, 0.0, 0.0],
        radius_m,
        source: CapsuleSource::User,
    }
}

fn half_space(normal: Vector3<f64>, offset_m: f64) -> CollisionShape {
    CollisionShape::HalfSpace(HalfSpace { normal, offset_m })
}

/// A motion of the planar arm with obstacles.
struct Planar {
    model: Model,
    controller: OperationalSpaceController,
    data: Data,
    seen: Measurement,
    tau: DVector<f64>,
}

/// Error of the height at which an arm comes to rest, m: ten times the largest measured one.
const HEIGHT_M: f64 = 1.5e-5;

/// Error of the height that noise of the positions causes, m/rad: ten times the measured one.
const HEIGHT_OF_NOISE: f64 = 7.5;

/// Change of the torques from cycle to cycle of an arm that lies flat, Nm: measured 2.3e-5 without noise, and 3.3e-3 with
/// noise of 1 µrad.
const STILL_NM: f64 = 1e-3;

/// Highest speed of an arm at rest between walls that are too close, rad/s: measured 2.1e-3.
const AT_REST: f64 = 1e-2;

/// Posture in which the last link is level.
const LEVEL: [f64; 3] = [-0.9, 1.4, -0.5];

impl Planar {
    fn new(tasks: &str, q: &[f64], obstacles: &[CollisionShape]) -> Self {
        let model = planar_arm();
        let mut geometry = CollisionModel::new(&model, &[flat("hand", 0.05)]).expect("a link");
        for (number, shape) in obstacles.iter().enumerate() {
            geometry.add_obstacle(&number.to_string(), *shape).expect("a shape");
        }
        let limits =
            JointLimits { torque: vec![80.0, 40.0, 20.0], velocity: vec![3.0; 3], ..JointLimits::of(&model) };
        let collision = Some(CollisionLimits { geometry, margin_m: MARGIN_M });
        let context = ControlContext { limits, collision, ..ControlContext::new(&model, PERIOD_S) };
        let file = File::read(tasks);
        let mut controller =
            OperationalSpaceController::new(&model, &file.task_set(), &context).expect("a good stack");
        let (data, seen) = at_state(&model, q, &[0.0; 3], 0.0);
        controller.start(&common::input(&model, &data, &seen));
        Self { model, controller, data, seen, tau: DVector::zeros(3) }
    }

    /// Controls and moves the arm by a cycle; the controller measures positions with `noise` (3; rad).
    fn step(&mut self, noise: &[f64]) {
        let mut measured = self.seen.clone();
        measured.q.iter_mut().zip(noise).for_each(|(q, noise)| *q += noise);
        let (model, data) = (&self.model, &mut self.data);
        assert!(update(model, data, measured.q.as_slice(), measured.dq.as_slice()));
        self.controller.update(&common::input(model, data, &measured), self.tau.as_mut_slice());
        assert!(self.tau.iter().all(|t| t.is_finite()), "{}", self.tau);
        assert!(update(model, data, self.seen.q.as_slice(), self.seen.dq.as_slice()));
        aba(model, data, self.tau.as_slice());
        self.seen.q.axpy(PERIOD_S, &self.seen.dq, 1.0);
        self.seen.q.axpy(0.5 * PERIOD_S * PERIOD_S, &data.ddq, 1.0);
        self.seen.dq.axpy(PERIOD_S, &data.ddq, 1.0);
        self.seen.time_s += PERIOD_S;
    }

    fn hand(&self) -> Vector3<f64> {
        let hand = self.model.frame_id("hand").expect("a hand");
        frame_placement(&self.model, &self.data, hand).translation
    }
}

/// Tasks that keep the last link level, and press the hand down.
fn press(down_m: f64) -> String {
    format!(
        "priority = [\"level\", \"hand\"]\n[task.level.cartesian]\nframe = \"hand\"\naxes = {{ ry = \"motion\" }}\nreference = \
         \"hold\"\ngains = {{ frequency_rad_per_s = 14.0, damping_ratio = 1.0 }}\n[task.hand.cartesian]\nframe = \"hand\"\naxes = \
         {{ x = \"motion\", z = \"motion\" }}\nreference.point-to-point = {{ position = {{ offset_m = [0.0, 0.0, {down_m}] }}, \
         duration_s = 0.8 }}\ngains = {{ frequency_rad_per_s = 14.0, damping_ratio = 1.0 }}\n"
    )
}

/// Both ends of a link that is pressed down at its middle are equally close to the ground, and noise decides which one is
/// closest. Compared: the change of torques from cycle to cycle with the size of the noise, and the height with the
/// margin.
#[test]
fn link_lies_flat_without_chatter() {
    let tasks = r#"
        priority = ["middle", "rest"]
        [task.middle.cartesian]
        frame = "middle"
        axes = { x = "motion", z = "motion" }
        reference.point-to-point = { position = { offset_m = [0.0, 0.0, -0.3] }, duration_s = 0.8 }
        gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }
        [task.rest.joint-posture]
        frequency_rad_per_s = 4.0
        damping_ratio = 1.0
    "#;
    let jump = |noise: f64| {
        let start = Planar::new(&press(0.0), &LEVEL, &[]).hand();
        let ground = half_space(Vector3::z(), start.z - 0.25);
        let mut arm = Planar::new(tasks, &LEVEL, &[ground]);
        let (mut numbers, mut worst) = (Numbers::new(3), 0.0_f64);
        for tick in 0..4000 {
            let before = arm.tau.clone();
            arm.step(&numbers.vector(3, noise));
            if tick > 3000 {
                worst = worst.max((&arm.tau - before).amax());
            }
        }
        let height = arm.hand().z - (start.z - 0.25);
        assert!((height - 0.05 - MARGIN_M).abs() < HEIGHT_M + HEIGHT_OF_NOISE * noise, "{height} m");
        worst
    };
    let (still, quiet, noisy) = (jump(0.0), jump(1e-6), jump(1e-5));
    assert!(still < STILL_NM, "{still} Nm without noise");
    assert!(quiet < 0.2 * noisy && noisy < 0.5, "{quiet} Nm for a tenth of what gives {noisy} Nm");
}

/// Compared: the height of an arm that starts within the ground, before and after a second.
#[test]
fn arm_within_an_obstacle_leaves_it() {
    let start = Planar::new(&press(0.0), &LEVEL, &[]).hand();
    let ground = half_space(Vector3::z(), start.z + 0.03);
    let mut arm = Planar::new(&press(-0.1), &LEVEL, &[ground]);
    for _ in 0..2000 {
        arm.step(&[0.0; 3]);
    }
    let height = arm.hand().z - start.z - 0.03;
    assert!((height - 0.05 - MARGIN_M).abs() < HEIGHT_M, "{height} m");
}

/// Between two walls that leave too little room, bounds contradict each other: torques stay finite and within their
/// limits, and the arm comes to rest with equal distances.
#[test]
fn contradictory_distances_are_shared() {
    let start = Planar::new(&press(0.0), &LEVEL, &[]).hand();
    let walls = [half_space(Vector3::z(), start.z - 0.055), half_space(-Vector3::z(), -start.z - 0.045)];
    let mut arm = Planar::new(&press(0.1), &LEVEL, &walls);
    for _ in 0..3000 {
        arm.step(&[0.0; 3]);
        let within =
            arm.tau.iter().zip([80.0, 40.0, 20.0]).all(|(t, limit)| t.abs() <= limit * (1.0 + ROUNDING));
        assert!(within, "{}", arm.tau);
    }
    let moved = arm.hand().z - start.z;
    assert!((moved + 0.005).abs() < HEIGHT_M && arm.seen.dq.amax() < AT_REST, "{moved} m, {}", arm.seen.dq);
}

/// Compared: torques with obstacles that are out of reach with those without obstacles, bit for bit.
#[test]
fn distant_obstacles_change_nothing() {
    let far = half_space(Vector3::z(), -5.0);
    let [mut with, mut without] =
        [&[far][..], &[]].map(|obstacles| Planar::new(&press(-0.3), &LEVEL, obstacles));
    for _ in 0..1500 {
        with.step(&[0.0; 3]);
        without.step(&[0.0; 3]);
        assert_eq!(with.tau, without.tau);
    }
}

/// Measurements that are not numbers give no command, and no panic.
#[test]
fn nan_distance_gives_no_command() {
    let start = Planar::new(&press(0.0), &LEVEL, &[]).hand();
    let mut arm = Planar::new(&press(-0.3), &LEVEL, &[half_space(Vector3::z(), start.z - 0.25)]);
    arm.step(&[0.0; 3]);
    let mut bad = arm.seen.clone();
    bad.q[1] = f64::NAN;
    let _ = update(&arm.model, &mut arm.data, bad.q.as_slice(), bad.dq.as_slice());
    arm.controller.update(&common::input(&arm.model, &arm.data, &bad), arm.tau.as_mut_slice());
    assert!(arm.tau.iter().any(|t| !t.is_finite()), "{}", arm.tau);
}
