//! Distances of a robot from itself and from the floor, for the choice of a posture. They need no `[collision]` in robot.toml,
//! but keep its margin if there is one. The floor of an arm on a wall or a ceiling is this surface.
//!
//! Links without a capsule, often the base, which has neither a readable shape nor an inertia, get one along their *skeleton*:
//! from their joint towards the next ones.

use crate::files::collision::generated_capsules;
use crate::files::robot::RobotDefinition;
use crate::files::source::Source;
use nalgebra::Vector3;
use opspace_model::collision::{
    CapsuleSource, CollisionData, CollisionModel, CollisionShape, HalfSpace, LinkCapsule, PairSampling,
    collision_distances,
};
use opspace_model::{Data, Frame, JointKind, Model, Placement, forward_kinematics};

/// Radius of a skeleton over the length of the arm: that of UR5e and Panda is 0.05 to 0.07.
const SKELETON_RADIUS: f64 = 0.05;

/// Radius of a skeleton over its own length, at most: short links are thin.
const SKELETON_SLENDERNESS: f64 = 0.5;

/// Part of the way to the next joint that a skeleton covers: there the next link begins.
const SKELETON_PART: f64 = 0.7;

/// Least length of a skeleton over the length of the arm.
const SKELETON_LENGTH: f64 = 0.02;

/// Height of the first joint above the base over the length of the arm, from which on the arm stands on a floor.
const STANDING_HEIGHT: f64 = 0.05;

/// Name of the floor among the objects.
const FLOOR: &str = "the floor";

/// Links that are too near to each other, or to the floor.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Contacts {
    /// The two nearest links.
    pub links: Option<[String; 2]>,
    /// The link nearest to the floor.
    pub with_floor: Option<String>,
}

/// Capsules of a robot's own links, and the floor on which it stands.
#[derive(Clone, Debug)]
pub struct OwnBody {
    collision: CollisionModel,
    data: CollisionData,
    margin_m: f64,
}

impl OwnBody {
    /// Capsules of the links of a model, whose length is `reach_m`: generated from the URDF, or those of `stated`. Pairs that
    /// are always nearer than `within_m` do not count. `None` if no two links can touch.
    #[must_use]
    pub fn new(
        model: &Model,
        urdf: &Source,
        stated: Option<&[LinkCapsule]>,
        reach_m: f64,
        within_m: f64,
    ) -> Option<Self> {
        Self::with_pairs(model, urdf, stated, &[], reach_m, within_m)
    }

    /// Capsules of the links of a robot folder, without the pairs that its `[collision]` drops, with the margin that it keeps
    /// between the others.
    #[must_use]
    pub fn of_robot(robot: &RobotDefinition, reach_m: f64) -> Option<Self> {
        let (model, stated) = (&robot.model, Some(robot.capsules()).filter(|capsules| !capsules.is_empty()));
        let Some(file) = &robot.file.collision else {
            return Self::new(model, &robot.urdf, stated, reach_m, 0.0);
        };
        let margin_m = file.margin_m.get();
        let own = Self::with_pairs(model, &robot.urdf, stated, &file.drop, reach_m, margin_m)?;
        Some(Self { margin_m, ..own })
    }

    /// Capsules as for [`new`](Self::new), without the pairs of `dropped` capsules.
    fn with_pairs(
        model: &Model,
        urdf: &Source,
        stated: Option<&[LinkCapsule]>,
        dropped: &[[String; 2]],
        reach_m: f64,
        within_m: f64,
    ) -> Option<Self> {
        let mut capsules = match stated {
            Some(stated) => stated.to_vec(),
            None => generated_capsules(urdf).map(|generated| generated.capsules).unwrap_or_default(),
        };
        capsules.retain(|capsule| model.frame_id(&capsule.link).is_ok());
        capsules.extend(skeletons(model, &capsules, reach_m));
        let mut collision = CollisionModel::new(model, &capsules).ok()?;
        if stands(model, reach_m) {
            let Placement { rotation, translation } = model.base();
            let normal = rotation.column(2).into_owned();
            let floor = CollisionShape::HalfSpace(HalfSpace { normal, offset_m: normal.dot(&translation) });
            collision.add_obstacle(FLOOR, floor).ok()?;
        }
        for [first, second] in dropped {
            collision.drop_pairs(first, second).ok()?;
        }
        let sampling = PairSampling { colliding_m: within_m, ..PairSampling::default() };
        collision.drop_unneeded_pairs(model, &sampling);
        let data = CollisionData::new(&collision);
        (!collision.pairs().is_empty()).then_some(Self { collision, data, margin_m: 0.0 })
    }

    /// Distance that the robot keeps between its links, m; 0 if it keeps none.
    #[must_use]
    pub fn margin_m(&self) -> f64 {
        self.margin_m
    }

    /// Contacts nearer than `within_m` in a posture `q` (n; rad, m). `data` gets the kinematics of this posture.
    pub fn contacts(&mut self, model: &Model, data: &mut Data, q: &[f64], within_m: f64) -> Contacts {
        forward_kinematics(model, data, q);
        collision_distances(&self.collision, model, data, within_m, &mut self.data);
        let is_floor = |pair: usize| self.link(self.collision.pairs()[pair].b).is_none();
        let nearest = |floor: bool| {
            let near = self.data.near().filter(|(pair, _)| is_floor(*pair) == floor);
            Some(self.collision.pairs()[near.min_by(|a, b| a.1.distance_m.total_cmp(&b.1.distance_m))?.0])
        };
        Contacts {
            links: nearest(false).and_then(|pair| Some([self.link(pair.a)?, self.link(pair.b)?])),
            with_floor: nearest(true).and_then(|pair| self.link(pair.a)),
        }
    }

    /// Name of the link of an object; `None` for the floor.
    fn link(&self, object: usize) -> Option<String> {
        self.collision.capsules().get(object).map(|capsule| capsule.link.clone())
    }
}

/// True if the first joint is above the base, so that a floor is below it: an arm whose first joint is at the height of its
/// base may hang.
fn stands(model: &Model, reach_m: f64) -> bool {
    let first = model.bodies().first().filter(|body| body.kind != JointKind::Floating);
    first.is_some_and(|body| body.origin.translation.z > STANDING_HEIGHT * reach_m)
}

/// Capsules along the bodies, and the base, that have none: from their joint to each joint that they hold, or
/// to their farthest frame if they hold none.
fn skeletons(model: &Model, capsules: &[LinkCapsule], reach_m: f64) -> Vec<LinkCapsule> {
    let holder = |capsule: &LinkCapsule| Some(model.frame(model.frame_id(&capsule.link).ok()?).body);
    let has_capsule = |body: Option<usize>| capsules.iter().any(|capsule| holder(capsule) == Some(body));
    let mut found = Vec::new();
    let mut add = |body: Option<usize>, end: &str, to: Vector3<f64>| {
        let Some(frame) = frame_of(model, body).filter(|_| !has_capsule(body)) else { return };
        let length_m = to.norm();
        if length_m < SKELETON_LENGTH * reach_m {
            return;
        }
        let in_link = frame.placement.inverse();
        found.push(LinkCapsule {
            name: format!("{} to {end}", frame.name),
            link: frame.name.clone(),
            start_m: in_link.act_point(&Vector3::zeros()).into(),
            end_m: in_link.act_point(&(to * SKELETON_PART)).into(),
            radius_m: (SKELETON_RADIUS * reach_m).min(SKELETON_SLENDERNESS * length_m),
            source: CapsuleSource::Inertia,
        });
    };
    for (number, body) in model.bodies().iter().enumerate() {
        if body.kind != JointKind::Floating {
            add(body.parent, &format!("body {number}"), body.origin.translation);
        }
        let is_last = model.bodies().iter().all(|child| child.parent != Some(number));
        let own = model.frames().iter().filter(|frame| frame.body == Some(number));
        let lengths = own.map(|frame| frame.placement.translation);
        let farthest = lengths.max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()));
        if let Some(farthest) = farthest.filter(|_| is_last) {
            add(Some(number), "its end", farthest);
        }
    }
    found
}

/// First frame of a body, or of the base.
fn frame_of(model: &Model, body: Option<usize>) -> Option<&Frame> {
    model.frames().iter().find(|frame| frame.body == body)
}
