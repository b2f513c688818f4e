//! Choice of pairs, obstacles and lists of capsules.
#![expect(clippy::unwrap_used, reason = "a test")]

use super::{oracle, robot};
use nalgebra::Vector3;
use opspace_model::collision::{
    Capsule, CapsuleSource, CollisionData, CollisionError, CollisionModel, CollisionShape, DropReason,
    HalfSpace, Holder, LinkCapsule, PairSampling, collision_distances, distance_gradient,
};
use opspace_model::{Data, Model, Placement, forward_kinematics, frame_placement};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::PI;

/// Rounding of distances, m, and of their derivatives.
const ROUNDING_M: f64 = 1e-12;

fn link_capsule(name: &str, link: &str) -> LinkCapsule {
    LinkCapsule {
        name: name.into(),
        link: link.into(),
        start_m: [0.0; 3],
        end_m: [0.1, 0.2, 0.3],
        radius_m: 0.05,
        source: CapsuleSource::User,
    }
}

fn random_posture(model: &Model, rng: &mut ChaCha8Rng) -> Vec<f64> {
    model.joints().iter().map(|j| rng.random_range(j.limits.lower.max(-PI)..j.limits.upper.min(PI))).collect()
}

/// Compared: the pairs that come near in no posture of the sequence, and random postures, which are independent of it:
/// in at least 99.9 % of them, no dropped pair collides.
#[test]
fn dropped_pairs_do_not_meet_in_random_postures() {
    let ours = ["panda", "ur5e", "asimo-arm"].map(|name| (name, robot(name)));
    let theirs = ["kinova_j2s6s200", "anymal_c", "g1_29dof"].map(|name| (name, oracle(name)));
    let mut total = 0;
    for (name, (model, all)) in ours.into_iter().chain(theirs) {
        let mut kept = all.clone();
        let dropped = kept.drop_unneeded_pairs(&model, &PairSampling::default());
        assert_eq!(kept.pairs().len() + dropped.len(), all.pairs().len());
        let never: Vec<usize> = (0..all.pairs().len())
            .filter(|&pair| {
                let names = all.pair_names(pair);
                dropped.iter().any(|d| d.names == names && d.reason == DropReason::NeverNear)
            })
            .collect();
        let (mut data, mut near) = (Data::new(&model), CollisionData::new(&all));
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let (postures, mut collisions) = (50_000, 0);
        for _ in 0..postures {
            forward_kinematics(&model, &mut data, &random_posture(&model, &mut rng));
            collision_distances(&all, &model, &data, 0.0, &mut near);
            collisions += usize::from(never.iter().any(|&pair| near.proximity[pair].is_some()));
        }
        total += never.len();
        assert!(collisions * 1000 <= postures, "{name}: {collisions} of {postures}");
    }
    assert!(total > 1000, "only {total} pairs were dropped");
}

/// Compared: pairs of a new model, and the tree: capsules of one body, and of parent and child, are not paired.
#[test]
fn connected_bodies_have_no_pair() {
    let (model, collision) = robot("panda");
    let holder = |object: usize| collision.objects()[object].holder;
    for (pair, indices) in collision.pairs().iter().enumerate() {
        let (a, b) = (holder(indices.a).body(), holder(indices.b).body());
        let parent = |body: Option<usize>| body.map(|body| model.bodies()[body].parent);
        assert!(a != b && parent(a) != Some(b) && parent(b) != Some(a), "{:?}", collision.pair_names(pair));
    }
    let capsules = [link_capsule("a", "link1"), link_capsule("b", "link2"), link_capsule("c", "link3")];
    let three = CollisionModel::new(&model, &capsules).unwrap();
    assert_eq!(three.pairs().len(), 1);
    assert_eq!(three.pair_names(0), ["a", "c"]);
}

/// Compared: a pair that always collides, one that never comes near, and the reasons for which they are dropped; and a
/// pair that does both, which is kept.
#[test]
fn reasons_of_dropped_pairs() {
    let (model, mut collision) = robot("ur5e");
    let wall = |offset_m| CollisionShape::HalfSpace(HalfSpace { normal: Vector3::z() * 3.0, offset_m });
    collision.add_obstacle("far", wall(-5.0)).unwrap();
    collision.add_obstacle("around", wall(5.0)).unwrap();
    collision.add_obstacle("floor", wall(0.0)).unwrap();
    let dropped = collision.drop_unneeded_pairs(&model, &PairSampling::default());
    let reasons = |name: &str| -> Vec<DropReason> {
        dropped.iter().filter(|d| d.names[1] == name).map(|d| d.reason).collect()
    };
    let moving = collision.objects().iter().filter(|o| o.holder.body().is_some()).count();
    assert_eq!(reasons("far"), vec![DropReason::NeverNear; moving]);
    assert_eq!(reasons("around"), vec![DropReason::AlwaysColliding; moving]);
    assert!(reasons("floor").len() < moving);
}

/// Compared: the distances of all pairs, and those of capsules that are placed by the poses of their links; for a robot
/// whose base is away from the world's origin, with capsules on frames that are rotated relative to their bodies.
#[test]
fn capsules_move_with_their_links() {
    let (model, _) = robot("ur5e");
    let model = model.with_base(Placement::from_rpy([0.3, -0.2, 0.5], [0.2, 0.1, -0.3]));
    let capsules: Vec<LinkCapsule> =
        model.frames().iter().map(|frame| link_capsule(&frame.name, &frame.name)).collect();
    let collision = CollisionModel::new(&model, &capsules).unwrap();
    let (mut data, mut near) = (Data::new(&model), CollisionData::new(&collision));
    let mut rng = ChaCha8Rng::seed_from_u64(14);
    for _ in 0..50 {
        forward_kinematics(&model, &mut data, &random_posture(&model, &mut rng));
        collision_distances(&collision, &model, &data, f64::INFINITY, &mut near);
        for (pair, proximity) in near.near() {
            let [a, b] = collision.pair_names(pair).map(|link| {
                let frame = model.frame_id(link).unwrap();
                link_capsule(link, link).capsule().placed(&frame_placement(&model, &data, frame))
            });
            let error = proximity.distance_m - a.proximity(&b).distance_m;
            assert!(error.abs() < 1e-12, "{:?}: {error:e}", collision.pair_names(pair));
        }
    }
}

/// Compared: pairs skipped by their enclosing spheres, and those whose exact distance is beyond the limit; and the
/// distances of the others with and without the limit.
#[test]
fn only_pairs_beyond_the_limit_are_skipped() {
    let (model, mut collision) = robot("panda");
    let floor = HalfSpace { normal: Vector3::z(), offset_m: 0.2 };
    collision.add_obstacle("floor", CollisionShape::HalfSpace(floor)).unwrap();
    let (mut data, mut all) = (Data::new(&model), CollisionData::new(&collision));
    let mut near = all.clone();
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut counts = [0; 2];
    for _ in 0..500 {
        forward_kinematics(&model, &mut data, &random_posture(&model, &mut rng));
        collision_distances(&collision, &model, &data, f64::INFINITY, &mut all);
        for within_m in [-0.05, 0.0, 0.1, 0.3] {
            collision_distances(&collision, &model, &data, within_m, &mut near);
            for (all, near) in all.proximity.iter().zip(&near.proximity) {
                let expected = all.filter(|proximity| proximity.distance_m <= within_m);
                assert_eq!(*near, expected);
                counts[usize::from(near.is_some())] += 1;
            }
        }
    }
    assert!(counts.iter().all(|&count| count > 1000), "{counts:?}");
}

/// Compared: changes of distances between random postures, and their bounds by the motion of the joints; and derivatives,
/// with the bounds. The bounds are not far above what the robots do.
#[test]
fn distances_change_at_most_by_their_bounds() {
    let ours = ["panda", "ur5e", "asimo-arm"].map(|name| (name, robot(name)));
    let theirs = ["kinova_j2s6s200", "g1_29dof", "pr2"].map(|name| (name, oracle(name)));
    for (name, (model, mut collision)) in ours.into_iter().chain(theirs) {
        let floor = HalfSpace { normal: Vector3::z(), offset_m: -0.2 };
        collision.add_obstacle("floor", CollisionShape::HalfSpace(floor)).unwrap();
        let bounds: Vec<Vec<f64>> = (0..collision.pairs().len())
            .map(|pair| {
                let mut bound = vec![0.0; model.n()];
                collision.distance_change_bound(&model, pair, &mut bound);
                bound
            })
            .collect();
        let (mut data, mut first) = (Data::new(&model), CollisionData::new(&collision));
        let (mut second, mut gradient) = (first.clone(), vec![0.0; model.n()]);
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        // Largest fraction of its bound by which a joint changes a distance.
        let mut largest = 0.0_f64;
        for _ in 0..300 {
            let from = random_posture(&model, &mut rng);
            let step = 10.0_f64.powf(rng.random_range(-4.0..0.5));
            let to: Vec<f64> = (from.iter().zip(random_posture(&model, &mut rng)))
                .map(|(from, to)| from + step.min(1.0) * (to - from))
                .collect();
            forward_kinematics(&model, &mut data, &from);
            collision_distances(&collision, &model, &data, f64::INFINITY, &mut first);
            forward_kinematics(&model, &mut data, &to);
            collision_distances(&collision, &model, &data, f64::INFINITY, &mut second);
            for (pair, bound) in bounds.iter().enumerate() {
                let [a, b] = [&first, &second].map(|near| near.proximity[pair].unwrap());
                let moved: f64 =
                    bound.iter().zip(from.iter().zip(&to)).map(|(bound, (a, b))| bound * (a - b).abs()).sum();
                let change = (a.distance_m - b.distance_m).abs();
                assert!(
                    change <= moved + ROUNDING_M,
                    "{name}, {:?}: {change} {moved}",
                    collision.pair_names(pair)
                );
                distance_gradient(&collision, &model, &data, pair, &b, &mut gradient);
                for (gradient, bound) in gradient.iter().zip(bound) {
                    assert!(gradient.abs() <= bound + ROUNDING_M, "{name}: {gradient} {bound}");
                    largest = if *bound > 0.0 { largest.max(gradient.abs() / bound) } else { largest };
                }
            }
        }
        assert!(largest > 0.8, "{name}: {largest}");
    }
}

/// Checks that a position that is not finite gives distances that are not, instead of pairs that seem to be far apart.
#[test]
fn non_finite_state_has_no_far_pairs() {
    let (model, collision) = robot("panda");
    let (mut data, mut near) = (Data::new(&model), CollisionData::new(&collision));
    forward_kinematics(&model, &mut data, &vec![f64::NAN; model.nq()]);
    collision_distances(&collision, &model, &data, 0.1, &mut near);
    assert!(near.proximity.iter().all(|row| row.is_some_and(|row| row.distance_m.is_nan())));
}

/// Compared: models of the same list of capsules; and pairs dropped by the names of capsules and links.
#[test]
fn capsules_are_listed_and_pairs_dropped_by_name() {
    let (model, mut collision) = robot("panda");
    let again = CollisionModel::new(&model, collision.capsules()).unwrap();
    assert_eq!((again.objects(), again.pairs()), (collision.objects(), collision.pairs()));
    let before = collision.pairs().len();
    assert_eq!(collision.drop_pairs("link5", "link1"), Ok(1));
    assert_eq!(collision.drop_pairs("link1", "link5"), Ok(0));
    assert_eq!(collision.pairs().len(), before - 1);
    let error = collision.drop_pairs("link1", "lnk5").unwrap_err();
    assert!(error.to_string().starts_with("no capsule, link or obstacle 'lnk5'; there are: link1,"));
}

/// Compared: invalid capsules and obstacles, and the errors that name them.
#[test]
fn invalid_objects_are_refused() {
    let (model, mut collision) = robot("ur5e");
    let refused = |capsule: LinkCapsule| CollisionModel::new(&model, &[capsule]).unwrap_err().to_string();
    assert!(refused(link_capsule("a", "b")).starts_with("capsule 'a': no link 'b'; the links are: "));
    for wrong in [f64::NAN, f64::INFINITY, 1e10, -0.1] {
        assert!(refused(LinkCapsule { radius_m: wrong, ..link_capsule("a", "flange") }).starts_with("'a': "));
    }
    for wrong in [f64::NAN, f64::INFINITY, 1e10] {
        let mut capsule = link_capsule("a", "flange");
        capsule.end_m[1] = wrong;
        assert!(refused(capsule).starts_with("'a': "));
        let plane = HalfSpace { normal: Vector3::z(), offset_m: wrong };
        let error = collision.add_obstacle("plane", CollisionShape::HalfSpace(plane)).unwrap_err();
        assert_eq!(error, CollisionError::BadNumber { name: "plane".into() });
    }
    let plane = HalfSpace { normal: Vector3::zeros(), offset_m: 0.0 };
    assert!(collision.add_obstacle("plane", CollisionShape::HalfSpace(plane)).is_err());
    let twice = [link_capsule("a", "flange"), link_capsule("a", "flange")];
    let error = CollisionModel::new(&model, &twice).unwrap_err();
    assert_eq!(error.to_string(), "there are two capsules or obstacles 'a': names must be unique");
}

/// Compared: the distance of an obstacle after it was moved, and that of a new obstacle at the same place.
#[test]
fn moved_obstacle_is_at_its_new_place() {
    let (model, collision) = robot("ur5e");
    let ball = |x: f64| CollisionShape::Capsule(Capsule::sphere(Vector3::new(x, 0.3, 0.2), 0.1));
    let distances = |collision: &CollisionModel| -> Vec<f64> {
        let (mut data, mut near) = (Data::new(&model), CollisionData::new(collision));
        forward_kinematics(&model, &mut data, &[0.3; 6]);
        collision_distances(collision, &model, &data, f64::INFINITY, &mut near);
        near.near().map(|(_, proximity)| proximity.distance_m).collect()
    };
    let (mut moved, mut new) = (collision.clone(), collision);
    let obstacle = moved.add_obstacle("ball", ball(2.0)).unwrap();
    assert_eq!(moved.objects()[obstacle].holder, Holder::World);
    moved.move_obstacle(obstacle, ball(0.4)).unwrap();
    new.add_obstacle("ball", ball(0.4)).unwrap();
    assert_eq!(distances(&moved), distances(&new));
    assert!(moved.move_obstacle(obstacle, ball(f64::NAN)).is_err());
}
