//! Moving picture of a run: joint positions, references and forces at 50 Hz or less, which the player in a page turns into a scene by
//! forward kinematics.
//!
//! Numbers have 16 bits between the smallest and the largest value of their column. `run_data.ts` reads what is written here.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use opspace_backend::signal_names::{
    self, FORCE, ORIENTATION, POSITION, Q, REFERENCE, REFERENCE_ORIENTATION, TRUTH_CHANNEL, WRENCH,
};
use opspace_control::TaskParameters;
use opspace_experiment::evaluate::metrics::run_log::Run;
use opspace_experiment::run::experiment::Experiment;
use opspace_log::{ChannelData, ObjectShape, SceneObject};
use opspace_model::collision::{Capsule, CollisionShape, Holder};
use opspace_model::{Frame, JointKind, Model, Placement};
use serde::Serialize;
use std::f64::consts::{PI, TAU};

use crate::collision_moments::LINE_RADIUS_M;
use crate::environment_shapes::{EnvironmentShape, environment_shapes};

/// Least time between two pictures, s: that of the log's messages for viewers.
const PERIOD_S: f64 = 0.02;
/// Largest number of pictures; a longer run has fewer per second.
const MOST_PICTURES: usize = 2000;
/// Largest size of the links of a URDF, bytes; a larger one, which has more than simple shapes, is left out.
const MOST_URDF_BYTES: usize = 20_000;
/// Largest size of all numbers, bytes: less than 100 kB as base64.
const MOST_BYTES: usize = 74_000;
/// Length of a cylinder of the environment, which has no ends, to either side of its point, m.
const CYLINDER_M: f64 = 0.5;
/// Number of a value that does not apply.
const MISSING: u16 = u16::MAX;

/// Data of the player: all robots of a run.
#[derive(Serialize)]
struct AllPictures {
    are_compared: bool,
    robots: Vec<RunPictures>,
}

/// Data of the player about one robot.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct RunPictures {
    name: String,
    /// Start of control on the robot's clock, s.
    #[serde(skip)]
    control_s: f64,
    start_s: f64,
    period_s: f64,
    pictures: usize,
    base: [f64; 7],
    urdf: String,
    bodies: Vec<BodyData>,
    frames: Vec<FrameData>,
    capsules: Vec<CapsuleData>,
    walls: Vec<WallData>,
    tasks: Vec<TaskData>,
    forces: Vec<ForceData>,
    objects: Vec<ObjectData>,
    columns: Vec<(f64, f64)>,
    /// Columns of angles without limits, which are written modulo one turn.
    turning: Vec<usize>,
    /// Numbers of all pictures.
    #[serde(skip)]
    numbers: Vec<u16>,
    /// Numbers in base64.
    values: String,
}

#[derive(Clone, Debug, Serialize)]
struct BodyData {
    parent: isize,
    origin: [f64; 7],
    slides: bool,
    joint: usize,
    ratio: f64,
    offset: f64,
}

#[derive(Clone, Debug, Serialize)]
struct FrameData {
    name: String,
    body: isize,
    placement: [f64; 7],
}

#[derive(Clone, Debug, Serialize)]
struct CapsuleData {
    name: String,
    frame: isize,
    start_m: [f64; 3],
    end_m: [f64; 3],
    radius_m: f64,
}

#[derive(Clone, Debug, Serialize)]
struct WallData {
    name: String,
    point_m: [f64; 3],
    normal: [f64; 3],
}

#[derive(Clone, Debug, Serialize)]
struct TaskData {
    name: String,
    frame: isize,
    relative_to: isize,
    reference: usize,
}

#[derive(Clone, Debug, Serialize)]
struct ForceData {
    name: String,
    frame: usize,
    column: usize,
}

#[derive(Clone, Debug, Serialize)]
struct ObjectData {
    name: String,
    column: usize,
    orientation: isize,
    box_m: Option<[f64; 3]>,
    diameter_m: f64,
}

impl FrameData {
    fn new(frame: &Frame) -> Self {
        Self { name: frame.name.clone(), body: index(frame.body), placement: numbers(&frame.placement) }
    }
}

/// Signal of the log whose elements are columns.
struct Source {
    is_truth: bool,
    signal: String,
    elements: usize,
    column: usize,
}

/// Pictures of a run while segments of its log arrive.
pub(crate) struct PictureRows<'a> {
    experiment: &'a Experiment,
    /// Fixed parts, once the signals of the log are known; `None` for a robot whose base floats.
    data: Option<RunPictures>,
    sources: Vec<Source>,
    rows: Vec<Vec<f64>>,
    next_s: f64,
    /// Last values of the true state.
    truth: Vec<f64>,
}

impl<'a> PictureRows<'a> {
    pub(crate) fn new(experiment: &'a Experiment) -> Self {
        let (sources, rows, truth) = (Vec::new(), Vec::new(), Vec::new());
        Self { experiment, data: None, sources, rows, next_s: f64::NEG_INFINITY, truth }
    }

    /// Adds the next segment of the log.
    pub(crate) fn add(&mut self, run: &Run<'_>) {
        if self.experiment.robot().model.is_floating() {
            return;
        }
        let truth = run.recording.channel(TRUTH_CHANNEL);
        if self.data.is_none() {
            self.begin(run, truth);
        }
        let Some(data) = &mut self.data else { return };
        let most = MOST_PICTURES.min(MOST_BYTES / (2 * data.columns.len()));
        let mut read = 0;
        for (k, &time_s) in run.tick.time_s.iter().enumerate() {
            let is_controlled = time_s >= run.start_s - run.same_s && time_s <= run.to_s + run.same_s;
            if !is_controlled || time_s < self.next_s - run.same_s {
                continue;
            }
            if let Some(truth) = truth {
                read += truth.time_s[read..].partition_point(|&t| t <= time_s + run.same_s);
                if let Some(last) = read.checked_sub(1) {
                    self.truth = truth.row(last).to_vec();
                }
            }
            let mut row = vec![f64::NAN; data.columns.len()];
            for source in &self.sources {
                let values = match (source.is_truth, truth) {
                    (false, _) => run.tick.signal(&source.signal).map(|column| column.row(k)),
                    (true, Some(truth)) => {
                        columns_of(truth, &source.signal).and_then(|columns| self.truth.get(columns))
                    }
                    (true, None) => None,
                };
                let Some(values) = values else { continue };
                for (value, number) in row[source.column..][..source.elements].iter_mut().zip(values) {
                    *value = *number;
                }
            }
            if self.rows.is_empty() {
                self.next_s = time_s;
                (data.start_s, data.control_s) = (time_s - run.start_s, run.start_s);
            }
            // A missed cycle leaves a gap, in which the last picture stays.
            while self.next_s <= time_s + run.same_s {
                let last = self.rows.last().filter(|_| self.next_s < time_s - run.same_s);
                self.rows.push(last.unwrap_or(&row).clone());
                self.next_s += data.period_s;
            }
            if self.rows.len() > most {
                let mut number = 0;
                self.rows.retain(|_| {
                    number += 1;
                    number % 2 == 1
                });
                data.period_s *= 2.0;
                self.next_s = run.start_s + data.start_s + data.period_s * self.rows.len() as f64;
            }
        }
    }

    /// Collects what does not move, and the signals that are columns.
    fn begin(&mut self, run: &Run<'_>, truth: Option<&ChannelData>) {
        let experiment = self.experiment;
        let model = &experiment.robot().model;
        let mut columns = 0;
        let mut sources = Vec::new();
        let mut source = |is_truth, signal: String, elements| {
            let has = |channel: &ChannelData| {
                columns_of(channel, &signal).is_some_and(|columns| columns.len() >= elements)
            };
            if !(if is_truth { truth } else { Some(run.tick) }).is_some_and(has) {
                return None;
            }
            sources.push(Source { is_truth, signal, elements, column: columns });
            columns += elements;
            Some(columns - elements)
        };
        if source(false, Q.to_owned(), model.n()).is_none() {
            return;
        }
        let frames: Vec<FrameData> = model.frames().iter().map(FrameData::new).collect();
        let frame = |name: &str| frames.iter().position(|frame| frame.name == name);
        let mut tasks = Vec::new();
        for (name, task) in experiment.task().tasks_of_the_run() {
            let TaskParameters::Cartesian(task) = task else { continue };
            let of = |signal| signal_names::of(name, signal);
            let Some(reference) = source(false, of(REFERENCE), 3) else { continue };
            if source(false, of(REFERENCE_ORIENTATION), 4).is_none() {
                continue;
            }
            let relative_to = task.relative_to.as_deref().and_then(&frame);
            tasks.push(TaskData {
                name: name.to_owned(),
                frame: index(frame(&task.frame)),
                relative_to: index(relative_to),
                reference,
            });
        }
        let mut forces = Vec::new();
        for (name, object) in &experiment.task().file.environment {
            let force = source(true, signal_names::of(name, FORCE), 3);
            if let (Some(column), Some(frame)) = (force, frame(object.frame())) {
                forces.push(ForceData { name: name.clone(), frame, column });
            }
        }
        for (name, sensor) in &experiment.robot().file.force_sensor {
            let force = source(false, signal_names::of(name, WRENCH), 3);
            if let (Some(column), Some(frame)) = (force, frame(&sensor.frame)) {
                forces.push(ForceData { name: name.clone(), frame, column });
            }
        }
        let objects = experiment.scene_objects().into_iter().filter_map(|SceneObject { name, shape }| {
            let column = source(true, signal_names::of(&name, POSITION), 3)?;
            let (box_m, diameter_m) = match shape {
                ObjectShape::Box(size_m) => (Some(size_m), 0.0),
                ObjectShape::Ball(diameter_m) => (None, diameter_m),
            };
            let orientation = box_m.and_then(|_| source(true, signal_names::of(&name, ORIENTATION), 4));
            Some(ObjectData { name, column, orientation: index(orientation), box_m, diameter_m })
        });
        let objects = objects.collect();
        let (capsules, walls) = shapes(experiment, &frame);
        let cycle_s = experiment.profile().1.period_s();
        let turning = model.joints().iter().enumerate();
        let turning =
            turning.filter(|(_, joint)| joint.kind == JointKind::Continuous).map(|(j, _)| j).collect();
        self.data = Some(RunPictures {
            name: String::new(),
            control_s: 0.0,
            start_s: 0.0,
            period_s: cycle_s * (PERIOD_S / cycle_s).round().max(1.0),
            pictures: 0,
            base: numbers(&model.base()),
            // Capsules leave no gaps between links.
            urdf: match experiment.robot().capsules() {
                [] => links_of(experiment.robot().urdf.text()),
                _ => String::new(),
            },
            bodies: bodies(model),
            frames,
            capsules,
            walls,
            tasks,
            forces,
            objects,
            columns: vec![(0.0, 0.0); columns],
            turning,
            numbers: Vec::new(),
            values: String::new(),
        });
        self.sources = sources;
    }

    /// Returns the moving picture; `None` if nothing moves in it.
    pub(crate) fn finish(mut self) -> Option<RunPictures> {
        let mut data = self.data.take().filter(|_| self.rows.len() > 1)?;
        data.pictures = self.rows.len();
        for &column in &data.turning {
            self.rows.iter_mut().for_each(|row| row[column] = (row[column] + PI).rem_euclid(TAU) - PI);
        }
        for (column, range) in data.columns.iter_mut().enumerate() {
            let values = self.rows.iter().map(|row| row[column]).filter(|value| value.is_finite());
            let (low, high) =
                values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
            if low <= high {
                *range = (low, (high - low) / f64::from(MISSING - 1));
            }
        }
        let number = |(value, (low, step)): (&f64, &(f64, f64))| match *step {
            _ if !value.is_finite() => MISSING,
            0.0 => 0,
            // The cast saturates.
            step => (((value - low) / step).round() as u16).min(MISSING - 1),
        };
        data.numbers = self.rows.iter().flat_map(|row| row.iter().zip(&data.columns).map(number)).collect();
        Some(data)
    }
}

impl RunPictures {
    /// Leaves out every other picture until all numbers have at most this size, bytes.
    fn thin(&mut self, most_bytes: usize) {
        let columns = self.columns.len().max(1);
        while size_of::<u16>() * self.numbers.len() > most_bytes && self.pictures > 2 {
            let kept = self.numbers.chunks(columns).step_by(2);
            self.numbers = kept.flatten().copied().collect();
            self.pictures = self.pictures.div_ceil(2);
            self.period_s *= 2.0;
        }
    }
}

/// Returns the data of the robots of a run, with their names, as JSON that may be the text of an element. They share the size that a page
/// has for it. `are_compared`: all have the same task.
pub(crate) fn json(robots: &[(&str, &RunPictures)], are_compared: bool) -> String {
    let begin_s = robots.iter().map(|(_, pictures)| pictures.control_s).fold(f64::INFINITY, f64::min);
    let robot = |(name, pictures): &(&str, &RunPictures)| {
        let mut data = RunPictures { name: (*name).to_owned(), ..(*pictures).clone() };
        data.start_s += data.control_s - begin_s;
        data.thin(MOST_BYTES / robots.len());
        let bytes: Vec<u8> = data.numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        data.values = STANDARD.encode(bytes);
        data
    };
    let all = AllPictures { are_compared, robots: robots.iter().map(robot).collect() };
    // Only a map with other keys than texts, or a writer, could fail.
    let text = serde_json::to_string(&all).unwrap_or_default();
    text.replace('&', "\\u0026").replace('<', "\\u003c").replace('>', "\\u003e")
}

/// Columns of a signal in the rows of a channel.
fn columns_of(channel: &ChannelData, signal: &str) -> Option<std::ops::Range<usize>> {
    channel.layout.columns(signal)
}

/// Returns a URDF without joints, inertias, collision shapes and comments: what a page draws of it. Empty if it is large.
fn links_of(urdf: &str) -> String {
    let parts = [
        ("<!--", "-->"),
        ("<transmission", "</transmission>"),
        ("<gazebo", "</gazebo>"),
        ("<joint", "</joint>"),
        ("<inertial", "</inertial>"),
        ("<collision", "</collision>"),
    ];
    let mut text = urdf.to_owned();
    for (begin, end) in parts {
        let mut kept = String::with_capacity(text.len());
        let mut rest = text.as_str();
        while let Some(at) = rest.find(begin) {
            kept += &rest[..at];
            rest = rest[at..].find(end).map_or("", |length| &rest[at + length + end.len()..]);
        }
        text = kept + rest;
    }
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    if text.len() > MOST_URDF_BYTES { String::new() } else { text }
}

fn index(index: Option<usize>) -> isize {
    index.and_then(|index| isize::try_from(index).ok()).unwrap_or(-1)
}

fn bodies(model: &Model) -> Vec<BodyData> {
    let bodies = model.bodies().iter().map(|body| BodyData {
        parent: index(body.parent),
        origin: numbers(&body.origin),
        slides: body.kind == JointKind::Prismatic,
        joint: body.joint,
        ratio: body.ratio,
        offset: body.offset,
    });
    bodies.collect()
}

/// Position, and quaternion x, y, z, w.
fn numbers(placement: &Placement) -> [f64; 7] {
    let r = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(placement.rotation));
    let p = placement.translation;
    [p.x, p.y, p.z, r.i, r.j, r.k, r.w]
}

/// Capsules of links and of the environment, lines for bodies without capsules, and walls.
fn shapes(
    experiment: &Experiment,
    frame: &impl Fn(&str) -> Option<usize>,
) -> (Vec<CapsuleData>, Vec<WallData>) {
    let robot = experiment.robot();
    let model = &robot.model;
    let (mut capsules, mut walls) = (Vec::new(), Vec::new());
    let mut add = |name: &str, frame, start: Vector3<f64>, end: Vector3<f64>, radius_m| {
        let (start_m, end_m) = (start.into(), end.into());
        capsules.push(CapsuleData { name: name.to_owned(), frame, start_m, end_m, radius_m });
    };
    let mut has_shape = vec![false; model.bodies().len()];
    for capsule in robot.capsules() {
        let Some(link) = frame(&capsule.link) else { continue };
        add(&capsule.name, index(Some(link)), capsule.start_m.into(), capsule.end_m.into(), capsule.radius_m);
        let body = model.frame_id(&capsule.link).ok().and_then(|id| model.frame(id).body);
        if let Some(body) = body {
            has_shape[body] = true;
        }
    }
    // The first frame of a body is that of the link behind its joint.
    let link_of = |body: Option<usize>| model.frames().iter().find(|frame| frame.body == body);
    for end in model.frames() {
        let is_link = link_of(end.body).is_some_and(|link| link.name == end.name);
        let (body, at) = match end.body.filter(|_| is_link).map(|body| &model.bodies()[body]) {
            Some(body) => (body.parent, body.origin),
            None => (end.body, end.placement),
        };
        let Some(link) = link_of(body).filter(|link| link.name != end.name) else { continue };
        if body.is_some_and(|body| has_shape[body]) {
            continue;
        }
        let to = (link.placement.inverse() * at).translation;
        if let (true, Some(number)) = (to.norm() > LINE_RADIUS_M, frame(&link.name)) {
            add(&link.name, index(Some(number)), Vector3::zeros(), to, LINE_RADIUS_M);
        }
    }
    for object in environment_shapes(experiment) {
        match object.shape {
            EnvironmentShape::Plane { below, .. } => {
                walls.push(wall(experiment, object.name, below.normal, below.offset_m));
            }
            EnvironmentShape::Cylinder { point_m, axis, radius_m } => {
                let half = axis * CYLINDER_M;
                add(&object.name, -1, point_m - half, point_m + half, radius_m);
            }
            EnvironmentShape::Rod { ends_m: [start, end], radius_m } => {
                add(&object.name, -1, start, end, radius_m);
            }
        }
    }
    let geometry = experiment.kept_distances().map(|kept| kept.limits.geometry.objects());
    for obstacle in geometry.into_iter().flatten().filter(|object| object.holder == Holder::World) {
        match obstacle.shape {
            CollisionShape::Capsule(Capsule { start_m, end_m, radius_m }) => {
                add(&obstacle.name, -1, start_m, end_m, radius_m);
            }
            CollisionShape::HalfSpace(space) => {
                walls.push(wall(experiment, obstacle.name.clone(), space.normal, space.offset_m));
            }
        }
    }
    (capsules, walls)
}

/// Wall around the point of a plane that is nearest to the start of the first controlled frame.
fn wall(experiment: &Experiment, name: String, normal: Vector3<f64>, offset_m: f64) -> WallData {
    let near = start_of_hand(experiment).unwrap_or_default();
    let point = near - normal * (normal.dot(&near) - offset_m);
    WallData { name, point_m: point.into(), normal: normal.into() }
}

/// Position of the first controlled frame at the start, m.
fn start_of_hand(experiment: &Experiment) -> Option<Vector3<f64>> {
    let tasks = experiment.task().tasks_of_the_run();
    let frame = tasks.into_iter().find_map(|(_, task)| match task {
        TaskParameters::Cartesian(task) => Some(task.frame.as_str()),
        _ => None,
    });
    crate::environment_shapes::start_of(experiment, frame?)
}
