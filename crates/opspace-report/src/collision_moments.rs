//! Arm, collision geometry and environment at a few moments of a run, from the joint positions in its log.

use crate::environment_shapes::{PlacedObject, environment_shapes};
use nalgebra::Vector3;
use opspace_backend::signal_names::Q;
use opspace_control::TaskParameters;
use opspace_experiment::evaluate::metrics::run_log::Run;
use opspace_experiment::run::experiment::Experiment;
use opspace_experiment::text::format_short;
use opspace_model::collision::{
    Capsule, CollisionData, CollisionModel, CollisionShape, Holder, Proximity, collision_distances,
};
use opspace_model::{Data, Frame, FrameId, Model, forward_kinematics, frame_placement};

/// Radius of the lines that stand for links without collision geometry, m.
pub(crate) const LINE_RADIUS_M: f64 = 0.008;

/// Arm, obstacles and environment at a moment of a run, or the links of an arm at several moments, in world axes.
#[derive(Clone, Debug)]
pub struct CollisionMoment {
    /// Name: start, least distance, end; that of all moments for links without collision geometry.
    pub name: String,
    /// Time after the start of control, s; that of the last of several moments.
    pub time_s: f64,
    /// Capsules of the arm, then obstacles.
    pub shapes: Vec<PlacedShape>,
    /// Closest of the pairs that are kept apart; `None` if there are none.
    pub closest: Option<ClosestPair>,
    /// Objects of the environment that have a shape.
    pub environment: Vec<PlacedObject>,
    /// True if the robot has no collision geometry, and its links are drawn as lines.
    pub is_sketch: bool,
}

/// Capsule of the arm, or obstacle, in world axes.
#[derive(Clone, Debug)]
pub struct PlacedShape {
    /// Name of the capsule or the obstacle.
    pub name: String,
    /// True for an obstacle.
    pub is_obstacle: bool,
    /// Index of the moment at which the shape is here: 0 at the start, 1 farthest from it, 2 at the end. Zero for a shape that is
    /// drawn at one moment.
    pub moment: usize,
    /// Shape in world axes.
    pub shape: CollisionShape,
}

/// Pair of shapes at a moment.
#[derive(Clone, Copy, Debug)]
pub struct ClosestPair {
    /// Indices of both in [`CollisionMoment::shapes`].
    pub shapes: [usize; 2],
    /// Distance of their surfaces, m; negative if they penetrate each other.
    pub distance_m: f64,
    /// Closest points of their surfaces in world axes, m.
    pub points_m: [Vector3<f64>; 2],
}

/// Row of a log.
#[derive(Clone, Debug)]
struct Row {
    /// Time after the start of control, s.
    time_s: f64,
    /// Measured joint positions (n; rad or m).
    q: Vec<f64>,
}

/// First, closest, farthest and last row of control while segments of a log arrive.
pub(crate) struct CollisionMoments<'a> {
    model: &'a Model,
    /// Collision geometry with its distances; `None` for a robot without.
    geometry: Option<(&'a CollisionModel, CollisionData)>,
    environment: Vec<PlacedObject>,
    data: Data,
    start: Option<Row>,
    /// Row with the smallest distance, and this distance, m.
    least: Option<(Row, f64)>,
    /// Frame whose displacement decides which row is the farthest: that of the first Cartesian task, otherwise that of the last link.
    frame: Option<FrameId>,
    /// Position of this frame at the start, m.
    origin: Option<Vector3<f64>>,
    /// Row with the largest displacement, and this displacement, m.
    farthest: Option<(Row, f64)>,
    end: Option<Row>,
}

impl<'a> CollisionMoments<'a> {
    pub(crate) fn new(experiment: &'a Experiment) -> Self {
        let geometry = experiment.kept_distances().map(|kept| &kept.limits.geometry);
        let model = &experiment.robot().model;
        let tasks = experiment.task().tasks_of_the_run();
        let of_task = tasks.into_iter().find_map(|(_, task)| match task {
            TaskParameters::Cartesian(task) => model.frame_id(&task.frame).ok(),
            _ => None,
        });
        let last = || model.frame_id(&model.frames().last()?.name).ok();
        Self {
            model,
            geometry: geometry.map(|geometry| (geometry, CollisionData::new(geometry))),
            environment: environment_shapes(experiment),
            data: Data::new(model),
            start: None,
            least: None,
            frame: of_task.or_else(last),
            origin: None,
            farthest: None,
            end: None,
        }
    }

    /// Adds the next segment of the log.
    pub(crate) fn add(&mut self, run: &Run<'_>) {
        let Some(q) = run.tick.signal(Q) else { return };
        for (k, &time_s) in run.tick.time_s.iter().enumerate() {
            let is_controlled = time_s >= run.start_s - run.same_s && time_s <= run.to_s + run.same_s;
            if !is_controlled || q.row(k).iter().any(|q| !q.is_finite()) {
                continue;
            }
            let row = || Row { time_s: time_s - run.start_s, q: q.row(k).to_vec() };
            self.start.get_or_insert_with(row);
            let least_m = self.least.as_ref().map_or(f64::INFINITY, |(_, least_m)| *least_m);
            if let Some((_, proximity)) = self.closest(q.row(k), least_m)
                && proximity.distance_m < least_m
            {
                self.least = Some((row(), proximity.distance_m));
            }
            if let Some(moved_m) = self.displacement(q.row(k))
                && self.farthest.as_ref().is_none_or(|(_, farthest_m)| moved_m > *farthest_m)
            {
                self.farthest = Some((row(), moved_m));
            }
            let end = self.end.get_or_insert_with(row);
            end.time_s = time_s - run.start_s;
            end.q.copy_from_slice(q.row(k));
        }
    }

    /// Returns the closest pair at joint positions, with its index, if it is within a distance.
    fn closest(&mut self, q: &[f64], within_m: f64) -> Option<(usize, Proximity)> {
        let (geometry, distances) = self.geometry.as_mut()?;
        forward_kinematics(self.model, &mut self.data, q);
        collision_distances(geometry, self.model, &self.data, within_m, distances);
        let near = distances.near().map(|(pair, proximity)| (pair, *proximity));
        near.min_by(|(_, a), (_, b)| a.distance_m.total_cmp(&b.distance_m))
    }

    /// Displacement of the frame from its position at the start, m.
    fn displacement(&mut self, q: &[f64]) -> Option<f64> {
        let frame = self.frame?;
        forward_kinematics(self.model, &mut self.data, q);
        let position = frame_placement(self.model, &self.data, frame).translation;
        Some((position - *self.origin.get_or_insert(position)).norm())
    }

    /// Returns the links at the start, where they are farthest from it and at the end, and with collision geometry each moment
    /// in the order of their times; those at the same time are one.
    pub(crate) fn finish(mut self) -> (Option<CollisionMoment>, Vec<CollisionMoment>) {
        let links = self.links();
        if self.geometry.is_none() {
            return (links, Vec::new());
        }
        let rows = [
            ("start", self.start.take()),
            ("least distance", self.least.take().map(|(row, _)| row)),
            ("end", self.end.take()),
        ];
        let mut moments: Vec<CollisionMoment> = Vec::new();
        for (name, row) in rows {
            let Some(row) = row else { continue };
            match moments.iter_mut().find(|moment| moment.time_s == row.time_s) {
                Some(moment) => moment.name += &format!(" and {name}"),
                None => moments.push(self.moment(name, &row)),
            }
        }
        (links, moments)
    }

    /// Links at all moments.
    fn links(&mut self) -> Option<CollisionMoment> {
        let (start, end) = (self.start.clone()?, self.end.clone()?);
        // A row in which nothing has moved looks like the start.
        let farthest = self.farthest.take().filter(|(_, moved_m)| *moved_m > 2.0 * LINE_RADIUS_M);
        let farthest = farthest.map(|(row, _)| row).filter(|row| row.time_s < end.time_s);
        let mut name = "start".to_owned();
        if let Some(row) = &farthest {
            name += &format!(", farthest from it (at {} s)", format_short(row.time_s));
        }
        name += " and end";
        let mut shapes = Vec::new();
        for (moment, row) in [Some(&start), farthest.as_ref(), Some(&end)].into_iter().enumerate() {
            let Some(row) = row else { continue };
            forward_kinematics(self.model, &mut self.data, &row.q);
            let links = sketch(self.model, &self.data).into_iter();
            shapes.extend(links.map(|shape| PlacedShape { moment, ..shape }));
        }
        Some(CollisionMoment {
            name,
            time_s: end.time_s,
            shapes,
            closest: None,
            environment: self.environment.clone(),
            is_sketch: true,
        })
    }

    fn moment(&mut self, name: &str, row: &Row) -> CollisionMoment {
        let closest = self.closest(&row.q, f64::INFINITY);
        let moment = CollisionMoment {
            name: name.to_owned(),
            time_s: row.time_s,
            shapes: Vec::new(),
            closest: None,
            environment: self.environment.clone(),
            is_sketch: false,
        };
        let Some((geometry, _)) = &self.geometry else { return moment };
        let shapes = geometry.objects().iter().map(|object| PlacedShape {
            name: object.name.clone(),
            is_obstacle: object.holder == Holder::World,
            moment: 0,
            shape: match object.shape {
                CollisionShape::Capsule(capsule) => {
                    let placement = object.holder.placement(self.model, &self.data);
                    CollisionShape::Capsule(capsule.placed(&placement))
                }
                half_space @ CollisionShape::HalfSpace(_) => half_space,
            },
        });
        CollisionMoment {
            shapes: shapes.collect(),
            closest: closest.map(|(pair, proximity)| ClosestPair {
                shapes: [geometry.pairs()[pair].a, geometry.pairs()[pair].b],
                distance_m: proximity.distance_m,
                points_m: [proximity.point_a_m, proximity.point_b_m],
            }),
            ..moment
        }
    }
}

/// Links as thin capsules: from the joint of each body to the joints of its children, and to its other frames.
fn sketch(model: &Model, data: &Data) -> Vec<PlacedShape> {
    let place = |name: &str| model.frame_id(name).ok().map(|id| frame_placement(model, data, id).translation);
    // The first frame of a body is that of the link behind its joint; the first of the base is that of the root link.
    let joint_of = |body: Option<usize>| model.frames().iter().find(|frame| frame.body == body);
    let line = |name: &str, from: Option<&Frame>, to: &str| {
        let [start_m, end_m] = [place(&from?.name)?, place(to)?];
        let is_point = (end_m - start_m).norm() < LINE_RADIUS_M;
        let capsule = Capsule { start_m, end_m, radius_m: LINE_RADIUS_M };
        (!is_point).then(|| PlacedShape {
            name: name.to_owned(),
            is_obstacle: false,
            moment: 0,
            shape: CollisionShape::Capsule(capsule),
        })
    };
    let frames = model.frames().iter().filter_map(|frame| {
        let own = joint_of(frame.body)?;
        let from = if own.name == frame.name {
            joint_of(model.bodies().get(frame.body?)?.parent)
        } else {
            Some(own)
        };
        line(&frame.name, from, &frame.name)
    });
    frames.collect()
}
