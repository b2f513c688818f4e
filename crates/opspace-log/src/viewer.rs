//! Messages for viewers, computed from the rows on the writer's thread.
//!
//! | topic | message | when |
//! |---|---|---|
//! | `/robot_description` | `std_msgs/msg/String`: the URDF | once |
//! | `/tf_static` | `foxglove.FrameTransforms`: the base in the world, and frames that are fixed to a link | once |
//! | `/scene/environment` | `foxglove.SceneUpdate`: walls | once |
//! | `/scene/collision` | `foxglove.SceneUpdate`: capsules of the links, obstacles and cylinders | once |
//! | `/joint_states` | `foxglove.JointStates` | 50 Hz |
//! | `/tf` | `foxglove.FrameTransforms`: each moving link in its parent, as in the URDF | 50 Hz |
//! | `/TASK/reference`, `/TASK/controlled_frame` | `foxglove.PoseInFrame` | 50 Hz |
//! | `/scene/forces` | `foxglove.SceneUpdate`: arrows | 50 Hz |
//! | `/scene/objects` | `foxglove.SceneUpdate`: objects that robots hold | 50 Hz |
//! | `/scene/paths` | `foxglove.SceneUpdate`: references of the last two seconds | 10 Hz |
//!
//! A message that is written once has a topic of its own, so that a viewer that seeks still finds it as the last message
//! of its topic. A quantity that does not apply has no message.

use crate::error::LogError;
use crate::foxglove::{
    Arrow, Cube, Cylinder, Encode, FrameTransform, FrameTransforms, JointState, JointStates, Kind, Line,
    Message, Pose, PoseInFrame, RosText, SceneEntity, SceneUpdate, Sphere, Timestamp, Warning,
};
use crate::header::{ObjectShape, Scene, SceneCapsule, SceneObject, TIME_ZERO_NS, Wall};
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use opspace_backend::Layout;
use opspace_backend::signal_names::{
    self, DQ, EXTERNAL_CHANNEL, FORCE, MOTOR_TORQUE, ORIENTATION, POSITION, Q, REFERENCE,
    REFERENCE_ORIENTATION, TICK_CHANNEL, TRUTH_CHANNEL,
};
use opspace_model::{Data, FrameId, Model, Placement, frame_placement, kinematics};
use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;

/// Time between two messages, ns: 50 Hz looks smooth, and is a small part of the log.
const PERIOD_NS: u64 = 20_000_000;

/// Number of messages per message of paths.
const PATH_EVERY: usize = 5;

/// Number of points of a path: two seconds.
const PATH_POINTS: usize = 100;

/// Length of the arrow of a force, m/N.
const ARROW_M_PER_N: f64 = 0.01;

/// Size of a wall along its plane, and its thickness, m.
const WALL_M: [f64; 2] = [1.0, 0.01];

const WALL_COLOR: [f64; 4] = [0.6, 0.6, 0.65, 0.5];
const LINK_COLOR: [f64; 4] = [0.2, 0.6, 0.4, 0.3];
const OBSTACLE_COLOR: [f64; 4] = [0.8, 0.5, 0.1, 0.5];
const OBJECT_COLOR: [f64; 4] = [0.8, 0.5, 0.1, 1.0];
const FORCE_COLOR: [f64; 4] = [0.85, 0.3, 0.1, 1.0];
const PATH_COLOR: [f64; 4] = [0.1, 0.45, 0.8, 1.0];

/// Receiver of messages, with the index of their topic in [`Viewer::topics`].
pub(crate) type Put<'p> = dyn FnMut(usize, &dyn Encode) -> Result<(), LogError> + 'p;

/// Messages for viewers, overwritten in place.
pub(crate) struct Viewer {
    /// Index of the channel `tick`.
    channel: usize,
    topics: Vec<(String, Kind)>,
    once: Vec<(usize, Once)>,
    joints: JointStates,
    joints_topic: usize,
    q: Range<usize>,
    dq: Option<Range<usize>>,
    effort: Option<Range<usize>>,
    bodies: Option<(usize, Bodies)>,
    poses: Vec<TaskPose>,
    paths: Option<(usize, Vec<Path>)>,
    forces: Option<(usize, Vec<Force>, SceneUpdate)>,
    objects: Option<(usize, Vec<Object>, SceneUpdate)>,
    last_ns: Option<u64>,
    shown: usize,
}

/// Message that is written once, at the time of the first row.
enum Once {
    Text(RosText),
    Transforms(FrameTransforms),
    Scene(SceneUpdate),
}

/// Poses of the links.
struct Bodies {
    transforms: FrameTransforms,
    model: Arc<Model>,
    data: Data,
    /// Frames of the links, and those of their parents.
    frames: Vec<(FrameId, Option<FrameId>)>,
    at_rest: Vec<f64>,
}

/// Pose of a task: of its reference or of its controlled frame.
struct TaskPose {
    topic: usize,
    position: Range<usize>,
    orientation: Range<usize>,
    message: PoseInFrame,
}

/// Reference of a task over the last seconds.
struct Path {
    position: Range<usize>,
    id: String,
    frame_id: String,
    points: VecDeque<[f64; 3]>,
}

/// Force on a frame.
struct Force {
    channel: usize,
    columns: Range<usize>,
    frame: FrameId,
    /// Point on which it acts, fixed in the frame, m.
    point: Vector3<f64>,
    /// Columns of frame and point, if they are in the rows.
    place: Option<PlaceColumns>,
    id: String,
    value: Vector3<f64>,
}

/// Object that moves.
struct Object {
    channel: usize,
    position: Range<usize>,
    /// Columns of its orientation; `None` for a ball.
    orientation: Option<Range<usize>>,
    shape: ObjectShape,
    /// Pose in the last row; `None` while it is not there.
    pose: Option<Pose>,
}

/// Columns of the place of an external force.
struct PlaceColumns {
    /// Column of the index of the frame in the model.
    frame: usize,
    /// Columns of the point; `None` in older logs, whose forces act on the origin.
    point: Option<Range<usize>>,
    /// Frames of the model, in its order.
    frames: Vec<FrameId>,
}

impl Viewer {
    /// Returns the messages of a log with these layouts; `None` without a channel `tick` that has a signal `q`.
    pub fn new(
        layouts: &[&Layout],
        model: Option<Arc<Model>>,
        mut scene: Scene,
    ) -> Result<Option<Self>, LogError> {
        let Some(channel) = layouts.iter().position(|l| l.channel == TICK_CHANNEL) else {
            return Ok(None);
        };
        let tick = layouts[channel];
        let Some(q) = tick.columns(Q) else {
            return Ok(None);
        };
        let bodies = model.map(|m| Bodies::new(m, q.len())).transpose()?;
        let world = bodies.as_ref().map_or_else(|| "world".to_owned(), |bodies| world(&bodies.model));
        let mut topics: Vec<(String, Kind)> = Vec::new();
        let mut add = |topic: String, kind| {
            topics.push((topic, kind));
            topics.len() - 1
        };
        let mut once = Vec::new();
        let joints_topic = add("/joint_states".to_owned(), JointStates::KIND);
        let bodies = bodies.map(|bodies| {
            let fixed = bodies.fixed(&world);
            let topic = add("/tf".to_owned(), FrameTransforms::KIND);
            once.push((add("/tf_static".to_owned(), FrameTransforms::KIND), Once::Transforms(fixed)));
            (topic, bodies)
        });
        if let Some(urdf) = scene.robot_description.take() {
            once.push((add("/robot_description".to_owned(), RosText::KIND), Once::Text(RosText(urdf))));
        }
        let (mut poses, mut paths) = (Vec::new(), Vec::new());
        for task in tick.signals.iter().filter_map(|s| s.name.strip_suffix(&format!(".{REFERENCE}"))) {
            let frame_id = scene.relative_to.get(task).unwrap_or(&world).clone();
            for (what, position, orientation) in
                [(REFERENCE, REFERENCE, REFERENCE_ORIENTATION), ("controlled_frame", POSITION, ORIENTATION)]
            {
                let columns = |signal, length| {
                    let columns = tick.columns(&signal_names::of(task, signal));
                    columns.filter(|columns| columns.len() == length)
                };
                let (Some(position), Some(orientation)) = (columns(position, 3), columns(orientation, 4))
                else {
                    continue;
                };
                if what == REFERENCE {
                    let (id, frame_id) = (signal_names::of(task, REFERENCE), frame_id.clone());
                    let points = VecDeque::with_capacity(PATH_POINTS);
                    paths.push(Path { position: position.clone(), id, frame_id, points });
                }
                poses.push(TaskPose {
                    topic: add(format!("/{task}/{what}"), PoseInFrame::KIND),
                    position,
                    orientation,
                    message: PoseInFrame { frame_id: frame_id.clone(), ..PoseInFrame::default() },
                });
            }
        }
        if !scene.walls.is_empty() {
            let entities = scene.walls.iter().map(|wall| wall_entity(wall, &world)).collect();
            let topic = add("/scene/environment".to_owned(), SceneUpdate::KIND);
            once.push((topic, Once::Scene(SceneUpdate { entities })));
        }
        if !scene.capsules.is_empty() {
            let entities = scene.capsules.iter().map(|capsule| capsule_entity(capsule, &world)).collect();
            let topic = add("/scene/collision".to_owned(), SceneUpdate::KIND);
            once.push((topic, Once::Scene(SceneUpdate { entities })));
        }
        let forces = bodies.as_ref().map(|(_, bodies)| Force::all(&scene, layouts, &bodies.model));
        let forces = forces.filter(|forces| !forces.is_empty()).map(|forces| {
            let entity = |force: &Force| SceneEntity {
                frame_id: world.clone(),
                id: force.id.clone(),
                ..SceneEntity::default()
            };
            let entities = forces.iter().map(entity).collect();
            (add("/scene/forces".to_owned(), SceneUpdate::KIND), forces, SceneUpdate { entities })
        });
        let found = scene.objects.iter().filter_map(|object| Some((object, Object::new(object, layouts)?)));
        let (shown, objects): (Vec<&SceneObject>, Vec<Object>) = found.unzip();
        let objects = (!objects.is_empty()).then(|| {
            let entity = |object: &&SceneObject| SceneEntity {
                frame_id: world.clone(),
                id: object.name.clone(),
                ..SceneEntity::default()
            };
            let entities = shown.iter().map(entity).collect();
            (add("/scene/objects".to_owned(), SceneUpdate::KIND), objects, SceneUpdate { entities })
        });
        let paths = (!paths.is_empty()).then(|| (add("/scene/paths".to_owned(), SceneUpdate::KIND), paths));
        let alike = |name| tick.columns(name).filter(|c| c.len() == q.len());
        let names = tick.signals.iter().find(|s| s.name == Q).map(|s| &s.elements);
        let joint = |name: &String| JointState { name: name.clone(), ..JointState::default() };
        let joints = names.into_iter().flatten().map(joint).collect();
        Ok(Some(Self {
            channel,
            topics,
            once,
            joints: JointStates { joints, ..JointStates::default() },
            joints_topic,
            dq: alike(DQ),
            effort: alike(MOTOR_TORQUE),
            q,
            bodies,
            poses,
            paths,
            forces,
            objects,
            last_ns: None,
            shown: 0,
        }))
    }

    /// Topics of the messages, with their types.
    pub fn topics(&self) -> &[(String, Kind)] {
        &self.topics
    }

    /// Passes the messages of a row to `put`, if the last ones are old enough.
    pub fn show(&mut self, channel: usize, ns: u64, row: &[f64], put: &mut Put<'_>) -> Result<(), LogError> {
        if let Some((_, forces, _)) = &mut self.forces {
            forces.iter_mut().filter(|force| force.channel == channel).for_each(|force| force.read(row));
        }
        if let Some((_, objects, _)) = &mut self.objects {
            objects.iter_mut().filter(|object| object.channel == channel).for_each(|object| object.read(row));
        }
        if channel != self.channel || self.last_ns.is_some_and(|last| ns.abs_diff(last) < PERIOD_NS) {
            return Ok(());
        }
        self.last_ns = Some(ns);
        let time = timestamp(ns);
        for (topic, message) in self.once.drain(..) {
            message.put(topic, time, put)?;
        }
        self.show_joints(time, row, put)?;
        let q = &row[self.q.clone()];
        if let Some((topic, bodies)) = self.bodies.as_mut().filter(|_| q.iter().all(|q| q.is_finite())) {
            bodies.place(time, q);
            put(*topic, &bodies.transforms)?;
            if let Some((topic, forces, scene)) = &mut self.forces {
                for (force, entity) in forces.iter().zip(&mut scene.entities) {
                    entity.timestamp = time;
                    entity.arrows.clear();
                    let frame = frame_placement(&bodies.model, &bodies.data, force.frame);
                    let origin = frame.translation + frame.rotation * force.point;
                    entity.arrows.extend(arrow(&origin, &force.value));
                }
                put(*topic, scene)?;
            }
        }
        if let Some((topic, objects, scene)) = &mut self.objects {
            for (object, entity) in objects.iter().zip(&mut scene.entities) {
                entity.timestamp = time;
                object.draw(entity);
            }
            put(*topic, scene)?;
        }
        for pose in &mut self.poses {
            if let Some(shown) = task_pose(&row[pose.position.clone()], &row[pose.orientation.clone()]) {
                pose.message.timestamp = time;
                pose.message.pose = shown;
                put(pose.topic, &pose.message)?;
            }
        }
        self.show_paths(time, row, put)?;
        self.shown += 1;
        Ok(())
    }

    fn show_joints(&mut self, time: Timestamp, row: &[f64], put: &mut Put<'_>) -> Result<(), LogError> {
        self.joints.timestamp = time;
        let value = |columns: &Option<Range<usize>>, i: usize| {
            columns.as_ref().map(|c| row[c.start + i]).filter(|value| !value.is_nan())
        };
        let q = Some(self.q.clone());
        for (i, joint) in self.joints.joints.iter_mut().enumerate() {
            joint.position = value(&q, i);
            joint.velocity = value(&self.dq, i);
            joint.effort = value(&self.effort, i);
        }
        put(self.joints_topic, &self.joints)
    }

    fn show_paths(&mut self, time: Timestamp, row: &[f64], put: &mut Put<'_>) -> Result<(), LogError> {
        let Some((topic, paths)) = &mut self.paths else { return Ok(()) };
        for path in paths.iter_mut() {
            if path.points.len() == PATH_POINTS {
                path.points.pop_front();
            }
            let point: [f64; 3] = std::array::from_fn(|i| row[path.position.start + i]);
            if point.iter().all(|x| x.is_finite()) {
                path.points.push_back(point);
            }
        }
        if !self.shown.is_multiple_of(PATH_EVERY) {
            return Ok(());
        }
        let entity = |path: &Path| SceneEntity {
            timestamp: time,
            frame_id: path.frame_id.clone(),
            id: path.id.clone(),
            lines: vec![Line {
                thickness: 2.0,
                points: path.points.iter().copied().collect(),
                color: PATH_COLOR,
            }],
            ..SceneEntity::default()
        };
        put(*topic, &SceneUpdate { entities: paths.iter().map(entity).collect() })
    }
}

impl Once {
    fn put(self, topic: usize, time: Timestamp, put: &mut Put<'_>) -> Result<(), LogError> {
        match self {
            Self::Text(text) => put(topic, &text),
            Self::Transforms(mut transforms) => {
                transforms.transforms.iter_mut().for_each(|transform| transform.timestamp = time);
                put(topic, &transforms)
            }
            Self::Scene(mut scene) => {
                scene.entities.iter_mut().for_each(|entity| entity.timestamp = time);
                put(topic, &scene)
            }
        }
    }
}

impl Force {
    /// Forces of the environment, and the external force that a program or a hand applies.
    fn all(scene: &Scene, layouts: &[&Layout], model: &Model) -> Vec<Self> {
        let force = |channel: &str, signal: &str| {
            let channel = layouts.iter().position(|layout| layout.channel == channel)?;
            let columns = layouts[channel].columns(signal).filter(|columns| columns.len() >= 3)?;
            Some((channel, columns.start..columns.start + 3))
        };
        let of_environment = |arrow: &crate::header::ForceArrow| {
            let (channel, columns) = force(&arrow.channel, &arrow.signal)?;
            Some(Self {
                channel,
                columns,
                frame: model.frame_id(&arrow.frame).ok()?,
                point: Vector3::zeros(),
                place: None,
                id: arrow.signal.clone(),
                value: Vector3::from_element(f64::NAN),
            })
        };
        let external = || {
            let (channel, columns) = force(EXTERNAL_CHANNEL, FORCE)?;
            let frames: Vec<FrameId> =
                model.frames().iter().filter_map(|frame| model.frame_id(&frame.name).ok()).collect();
            let place = PlaceColumns {
                frame: layouts[channel].columns("frame")?.start,
                point: layouts[channel].columns("point").filter(|columns| columns.len() == 3),
                frames,
            };
            Some(Self {
                channel,
                columns,
                frame: *place.frames.first()?,
                point: Vector3::zeros(),
                place: Some(place),
                id: EXTERNAL_CHANNEL.to_owned(),
                value: Vector3::from_element(f64::NAN),
            })
        };
        scene.forces.iter().filter_map(of_environment).chain(external()).collect()
    }

    /// Reads the force from a row of its channel, and its place, which stays while none is set.
    fn read(&mut self, row: &[f64]) {
        self.value.copy_from_slice(&row[self.columns.clone()]);
        let Some(place) = &self.place else { return };
        let Some(frame) = place.frames.get(row[place.frame] as usize).filter(|_| row[place.frame] >= 0.0)
        else {
            return;
        };
        self.frame = *frame;
        let point = place.point.as_ref().map(|columns| Vector3::from_column_slice(&row[columns.clone()]));
        self.point = point.filter(|point| point.iter().all(|x| x.is_finite())).unwrap_or_default();
    }
}

impl Object {
    /// Returns an object whose pose is in the rows of the true state; `None` without it.
    fn new(object: &SceneObject, layouts: &[&Layout]) -> Option<Self> {
        let channel = layouts.iter().position(|layout| layout.channel == TRUTH_CHANNEL)?;
        let columns = |signal, length| {
            let columns = layouts[channel].columns(&signal_names::of(&object.name, signal));
            columns.filter(|columns| columns.len() == length)
        };
        let position = columns(POSITION, 3)?;
        let orientation = match object.shape {
            ObjectShape::Box(_) => Some(columns(ORIENTATION, 4)?),
            ObjectShape::Ball(_) => None,
        };
        Some(Self { channel, position, orientation, shape: object.shape, pose: None })
    }

    fn read(&mut self, row: &[f64]) {
        let upright = [1.0, 0.0, 0.0, 0.0];
        let orientation = self.orientation.clone().map_or(&upright[..], |columns| &row[columns]);
        self.pose = task_pose(&row[self.position.clone()], orientation);
    }

    fn draw(&self, entity: &mut SceneEntity) {
        entity.cubes.clear();
        entity.spheres.clear();
        let Some(pose) = self.pose else { return };
        match self.shape {
            ObjectShape::Box(size) => entity.cubes.push(Cube { pose, size, color: OBJECT_COLOR }),
            ObjectShape::Ball(diameter) => {
                entity.spheres.push(Sphere { pose, size: [diameter; 3], color: OBJECT_COLOR });
            }
        }
    }
}

impl Bodies {
    fn new(model: Arc<Model>, n: usize) -> Result<Self, LogError> {
        if model.n() != n {
            let model_name = model.name().to_owned();
            return Err(LogError::ModelMismatch { model: model_name, joints: model.n(), elements: n });
        }
        let (mut transforms, mut frames) = (Vec::new(), Vec::new());
        for (k, frame) in model.frames().iter().enumerate() {
            let (Some(body), true) = (frame.body, link(&model, k) == k) else { continue };
            let Ok(id) = model.frame_id(&frame.name) else { continue };
            let parent = parent_link(&model, body).map(|parent| model.frames()[parent].name.clone());
            frames.push((id, parent.as_ref().and_then(|name| model.frame_id(name).ok())));
            transforms.push(FrameTransform {
                parent_frame_id: parent.unwrap_or_else(|| world(&model)),
                child_frame_id: frame.name.clone(),
                ..FrameTransform::default()
            });
        }
        let data = Data::new(&model);
        Ok(Self { transforms: FrameTransforms { transforms }, data, frames, at_rest: vec![0.0; n], model })
    }

    /// Frames that are fixed to the link frame of their body; the base, which is fixed to the world.
    fn fixed(&self, world: &str) -> FrameTransforms {
        let model = &self.model;
        let fixed = |(k, frame): (usize, &opspace_model::Frame)| {
            let (parent, placement) = match (frame.body, link(model, k)) {
                (None, link) if link == k => (world, model.base() * frame.placement),
                (Some(_), link) if link == k => return None,
                (_, link) => {
                    let link = &model.frames()[link];
                    (link.name.as_str(), link.placement.inverse() * frame.placement)
                }
            };
            let mut transform = FrameTransform {
                parent_frame_id: parent.to_owned(),
                child_frame_id: frame.name.clone(),
                ..FrameTransform::default()
            };
            set(&mut transform, placement);
            Some(transform)
        };
        FrameTransforms { transforms: model.frames().iter().enumerate().filter_map(fixed).collect() }
    }

    fn place(&mut self, time: Timestamp, q: &[f64]) {
        kinematics(&self.model, &mut self.data, q, &self.at_rest);
        for (&(frame, parent), transform) in self.frames.iter().zip(&mut self.transforms.transforms) {
            let in_world = |frame| frame_placement(&self.model, &self.data, frame);
            let placement = in_world(frame);
            transform.timestamp = time;
            set(transform, parent.map_or(placement, |parent| in_world(parent).inverse() * placement));
        }
    }
}

/// Index of the link frame of a body's parent; `None` if the parent is the world.
fn parent_link(model: &Model, body: usize) -> Option<usize> {
    let mut parent = model.bodies()[body].parent;
    loop {
        let link = model.frames().iter().position(|frame| frame.body == parent);
        if link.is_some() {
            return link;
        }
        // The joints of a floating base have no links between them.
        parent = model.bodies()[parent?].parent;
    }
}

/// Index of the first frame of a frame's body: the link after which the body is named.
fn link(model: &Model, frame: usize) -> usize {
    let body = model.frames()[frame].body;
    model.frames().iter().position(|other| other.body == body).unwrap_or(frame)
}

/// Name of the world's frame; a link may be named "world".
fn world(model: &Model) -> String {
    let mut world = "world".to_owned();
    while model.frame_id(&world).is_ok() {
        world.push('_');
    }
    world
}

fn set(transform: &mut FrameTransform, Placement { rotation, translation: p }: Placement) {
    let r = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    transform.translation = [p.x, p.y, p.z];
    transform.rotation = [r.i, r.j, r.k, r.w];
}

/// Pose of a position and of a quaternion w, x, y, z; `None` unless both are finite.
fn task_pose(position: &[f64], orientation: &[f64]) -> Option<Pose> {
    let (&[x, y, z], &[w, i, j, k]) = (position, orientation) else { return None };
    let finite = [x, y, z, w, i, j, k].iter().all(|value| value.is_finite());
    finite.then_some(Pose { position: [x, y, z], orientation: [i, j, k, w] })
}

/// Pose at a point with x along a direction.
fn along(point: &Vector3<f64>, direction: &Vector3<f64>) -> Pose {
    with_axis(point, &Vector3::x(), direction)
}

/// Pose at a point with `axis`, x or z, along a direction.
fn with_axis(point: &Vector3<f64>, axis: &Vector3<f64>, direction: &Vector3<f64>) -> Pose {
    // The opposite direction has no unique rotation: half a turn about y reverses x and z.
    let r = UnitQuaternion::rotation_between(axis, direction)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::PI));
    Pose { position: [point.x, point.y, point.z], orientation: [r.i, r.j, r.k, r.w] }
}

/// Arrow of a force (N); `None` for no force.
fn arrow(origin: &Vector3<f64>, force: &Vector3<f64>) -> Option<Arrow> {
    let length = force.norm() * ARROW_M_PER_N;
    (length.is_finite() && length > 0.0).then(|| Arrow {
        pose: along(origin, force),
        sizes: [0.8 * length, 0.01, 0.2 * length, 0.02],
        color: FORCE_COLOR,
    })
}

fn wall_entity(wall: &Wall, world: &str) -> SceneEntity {
    let normal = Vector3::from(wall.normal).normalize();
    let [size, thickness] = WALL_M;
    // Its surface is at the point.
    let center = Vector3::from(wall.point_m) - normal * (0.5 * thickness);
    SceneEntity {
        frame_id: world.to_owned(),
        id: wall.name.clone(),
        cubes: vec![Cube { pose: along(&center, &normal), size: [thickness, size, size], color: WALL_COLOR }],
        ..SceneEntity::default()
    }
}

fn capsule_entity(capsule: &SceneCapsule, world: &str) -> SceneEntity {
    let [start, end] = [capsule.start_m, capsule.end_m].map(Vector3::from);
    let color = if capsule.frame.is_some() { LINK_COLOR } else { OBSTACLE_COLOR };
    let diameter = 2.0 * capsule.radius_m;
    let sphere = |center: Vector3<f64>| Sphere {
        pose: with_axis(&center, &Vector3::x(), &Vector3::x()),
        size: [diameter; 3],
        color,
    };
    let axis = end - start;
    let cylinder = Cylinder {
        pose: with_axis(&(0.5 * (start + end)), &Vector3::z(), &axis),
        size: [diameter, diameter, axis.norm()],
        color,
    };
    let is_sphere = axis == Vector3::zeros();
    SceneEntity {
        frame_id: capsule.frame.clone().unwrap_or_else(|| world.to_owned()),
        id: capsule.name.clone(),
        spheres: if is_sphere { vec![sphere(start)] } else { vec![sphere(start), sphere(end)] },
        cylinders: if is_sphere { Vec::new() } else { vec![cylinder] },
        ..SceneEntity::default()
    }
}

/// Returns a warning for `/log`.
pub(crate) fn warning(ns: u64, message: String) -> Warning {
    Warning { timestamp: timestamp(ns), message, name: "opspace".to_owned() }
}

/// Converts a time on the robot's clock (s) to a timestamp of the log (ns).
pub(crate) fn nanoseconds(time_s: f64) -> u64 {
    // The cast saturates, and converts NaN to 0.
    let since_zero = (time_s * 1e9).round() as i64;
    TIME_ZERO_NS.saturating_add_signed(since_zero)
}

fn timestamp(ns: u64) -> Timestamp {
    let (s, rest) = (ns / 1_000_000_000, (ns % 1_000_000_000) as u32);
    // Times after the year 2106 are replaced by the latest possible one.
    u32::try_from(s)
        .map_or(Timestamp { sec: u32::MAX, nsec: 999_999_999 }, |sec| Timestamp { sec, nsec: rest })
}
