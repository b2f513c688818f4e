//! Checks with a counting allocator that no algorithm allocates after its data are created.
#![expect(clippy::unwrap_used, reason = "a test")]

use crate::collision::robot;
use nalgebra::{DMatrix, Matrix3xX, Matrix6xX, Vector3};
use opspace_model::batch::{self, Lanes};
use opspace_model::collision::{
    Capsule, CollisionData, CollisionShape, HalfSpace, collision_distances, distance_bias_acceleration,
    distance_gradient, pair_proximity, place_capsules,
};
use opspace_model::{
    Data, Force, FrameId, Inertia, Limits, Model, OperationalSpace, Placement, Real, UrdfOptions, aba,
    aba_derivatives, aba_external, bias, center_of_mass, centroidal_map, centroidal_momentum, cholesky,
    com_jacobian, coriolis, crba, difference, forward_kinematics, frame_bias_acceleration, frame_jacobian,
    frame_jacobian_rate, frame_placement, frame_velocity, generalized_momentum, gravity, inertial_parameters,
    integrate, kinematics, kinetic_energy, local_jacobian, local_jacobian_rate, mass_matrix_inverse, neutral,
    point_jacobian, potential_energy, relative_jacobian, rnea, rnea_derivatives, rnea_external,
    torque_regressor, update, world_jacobian, world_jacobian_rate,
};
use opspace_testing::allocation::counted;
use opspace_testing::oracle::urdf;
use std::hint::black_box;

/// Returns the number of allocations, reallocations and frees during `work`.
fn allocations(work: impl FnOnce()) -> usize {
    let ((), count) = counted(work);
    count.allocations + count.frees
}

#[test]
fn allocation_counter_counts() {
    // One allocation, one free.
    assert_eq!(allocations(|| drop(black_box(vec![1.0; 7]))), 2);
}

fn load(robot: &str, options: UrdfOptions) -> Model {
    Model::from_urdf_with(&urdf(robot), options).unwrap().model
}

/// Robots with a fixed base, a floating base, a mimic joint, and many branches, each with two of its frames.
fn robots() -> Vec<(&'static str, Model, [FrameId; 2])> {
    let plain = UrdfOptions::default();
    let floating = UrdfOptions { floating_base: true, ..plain };
    let folding = UrdfOptions { enforce_mimic: true, ..plain };
    let robots = [
        ("panda_arm7", plain, ["panda_hand_tcp", "panda_link4"]),
        ("anymal_c", floating, ["LF_FOOT", "RH_FOOT"]),
        ("panda", folding, ["panda_leftfinger", "panda_rightfinger"]),
        ("g1_29dof", plain, ["left_rubber_hand", "right_rubber_hand"]),
        ("ur5", plain, ["tool0", "forearm_link"]),
    ];
    let loaded = robots.map(|(robot, options, frames)| {
        let model = load(robot, options);
        let frames = frames.map(|frame| model.frame_id(frame).unwrap());
        (robot, model, frames)
    });
    loaded.into()
}

/// Returns a configuration without zeros.
fn state(model: &Model) -> Vec<f64> {
    let mut q = neutral(model);
    let step: Vec<f64> = (0..model.n()).map(|i| 0.3 + 0.07 * i as f64).collect();
    integrate(model, &neutral(model), &step, &mut q);
    q
}

/// Returns the number of allocations of all algorithms that are generic over lanes.
fn allocations_of_all<T: Real>(model: &Model<T>, [tip, second]: [FrameId; 2], q: &[T]) -> usize {
    let n = model.n();
    let (dq, ddq) = (vec![T::splat(0.2); n], vec![T::splat(-1.5); n]);
    let (tau, mut x) = (vec![T::splat(2.0); n], vec![T::one(); n]);
    let one = Vector3::repeat(T::one());
    let wrenches =
        [(tip, Force { linear: one, angular: one }), (second, Force { linear: -one, angular: one })];
    let mut data = Data::new(model);
    let mut j = Matrix6xX::zeros(n);
    let mut j_com = Matrix3xX::zeros(n);
    let mut inverse = DMatrix::zeros(n, n);
    let mut regressor = DMatrix::zeros(n, 10 * model.bodies().len());
    allocations(|| {
        assert!(update(model, &mut data, q, &dq));
        forward_kinematics(model, &mut data, q);
        kinematics(model, &mut data, q, &dq);
        black_box(frame_placement(model, &data, tip));
        black_box(frame_velocity(model, &data, tip));
        black_box(frame_bias_acceleration(model, &data, tip));
        frame_jacobian(model, &data, tip, &mut j);
        local_jacobian(model, &data, tip, &mut j);
        world_jacobian(model, &data, tip, &mut j);
        point_jacobian(model, &data, tip, &one, &mut j);
        relative_jacobian(model, &data, second, tip, &mut j);
        frame_jacobian_rate(model, &data, tip, &mut j);
        local_jacobian_rate(model, &data, tip, &mut j);
        world_jacobian_rate(model, &data, tip, &mut j);
        com_jacobian(model, &mut data, &mut j_com);
        black_box(center_of_mass(model, &data));
        black_box(kinetic_energy(model, &data) + potential_energy(model, &data));
        centroidal_map(model, &mut data);
        black_box(centroidal_momentum(model, &data));

        crba(model, &mut data);
        bias(model, &mut data);
        gravity(model, &mut data);
        coriolis(model, &mut data);
        generalized_momentum(model, &mut data);
        rnea(model, &mut data, &ddq);
        rnea_external(model, &mut data, &ddq, &wrenches);
        aba(model, &mut data, &tau);
        aba_external(model, &mut data, &tau, &wrenches);
        rnea_derivatives(model, &mut data, &ddq);
        torque_regressor(model, &mut data, &ddq, &mut regressor);

        assert!(cholesky(&mut data));
        mass_matrix_inverse(&mut data);
        aba_derivatives(model, &mut data, &tau);
        data.mass_matrix_factor.solve(&mut x);
        black_box(data.mass_matrix_factor.mobility(&mut j));
        data.mass_matrix_factor.finish_solve(&mut j);
        data.mass_matrix_factor.inverse(&mut inverse);
        data.mass_matrix_factor.set_identity();
        assert!(data.mass_matrix_factor.update(&data.mass_matrix));
    })
}

#[test]
fn no_algorithm_allocates() {
    for (robot, model, frames) in robots() {
        assert_eq!(allocations_of_all(&model, frames, &state(&model)), 0, "{robot}");
    }
}

#[test]
fn no_algorithm_allocates_for_lanes() {
    for (robot, model, frames) in robots() {
        let q: Vec<Lanes> = state(&model).into_iter().map(|x| Lanes::from([x; batch::COUNT])).collect();
        assert_eq!(allocations_of_all(&model.splat(), frames, &q), 0, "{robot}");
    }
    let (vectors, mut lanes, mut back) =
        ([[1.0; 9]; batch::COUNT], [Lanes::from([0.0; batch::COUNT]); 9], [0.0; 9]);
    let count = allocations(|| {
        batch::gather(&vectors.each_ref().map(|v| &v[..]), &mut lanes);
        batch::extract(&lanes, 1, &mut back);
    });
    assert_eq!(count, 0);
}

#[test]
fn no_task_allocates() {
    for (robot, model, [tip, _]) in robots() {
        let n = model.n();
        let mut data = Data::new(&model);
        let mut jacobian = Matrix6xX::zeros(n);
        let mut space = OperationalSpace::new(n);
        let (mut nullspace, mut tau) = (DMatrix::zeros(n, n), vec![2.0; n]);
        assert!(update(&model, &mut data, &state(&model), &vec![0.2; n]));
        frame_jacobian(&model, &data, tip, &mut jacobian);
        let mut shares = [f64::NAN; 3];
        let count = allocations(|| {
            // Undamped; damped in all directions except the most mobile one; with one direction lost.
            space.update(&data.mass_matrix_factor, &jacobian, 6, 0.0);
            shares[0] = space.min_singular_gain;
            space.update(&data.mass_matrix_factor, &jacobian, 3, 0.999);
            shares[1] = space.min_singular_gain;
            space.project_torque(&jacobian, &mut tau);
            space.nullspace(&jacobian, &mut nullspace);
            jacobian.row_mut(1).fill(0.0);
            space.update(&data.mass_matrix_factor, &jacobian, 6, 1e-3);
            shares[2] = space.min_singular_gain;
        });
        assert_eq!(count, 0, "{robot}");
        assert_eq!(shares[0], 1.0, "{robot}: the plain branch was taken");
        assert!(0.0 < shares[1] && shares[1] < 1.0, "{robot}: the damped branch was taken");
        assert!(shares[2].abs() < 1e-9, "{robot}: a direction was lost");
    }
}

/// Checks all changes that are allowed between two control cycles: integration of q, and changes of payloads, frames,
/// inertias and limits of the model.
#[test]
fn no_model_change_allocates() {
    for (robot, mut model, [tip, second]) in robots() {
        let (from, v) = (state(&model), vec![0.3; model.n()]);
        let (mut to, mut back) = (from.clone(), v.clone());
        let load = Inertia { mass: 0.5, ..Inertia::zero() };
        let offset = Placement::from_rpy([0.1, 0.2, 0.3], [0.0, 0.0, 0.1]);
        let (last, rest) = (model.n() - 1, model.frame(tip).placement);
        let count = allocations(|| {
            integrate(&model, &from, &v, &mut to);
            difference(&model, &from, &to, &mut back);
            black_box(inertial_parameters(&load));
            model.set_payload(tip, load);
            model.move_frame(tip, second, offset);
            model.set_payload(tip, Inertia::zero());
            model.set_inertia(model.bodies().len() - 1, load);
            model.set_limits(last, Limits::NONE);
            black_box(model.total_mass());
            black_box(model.ancestors(second).count());
        });
        assert_eq!(count, 0, "{robot}");
        assert_ne!(model.frame(tip).placement, rest, "{robot}: the frame was moved");
        assert_eq!(model.joints()[last].limits, Limits::NONE, "{robot}");
    }
}

/// Checks the distances of all pairs, with their derivatives, and obstacles that move between two cycles.
#[test]
fn no_distance_allocates() {
    let (model, mut collision) = robot("panda");
    let floor = HalfSpace { normal: Vector3::z(), offset_m: 0.0 };
    let ball = |x| CollisionShape::Capsule(Capsule::sphere(Vector3::new(x, 0.3, 0.3), 0.1));
    collision.add_obstacle("floor", CollisionShape::HalfSpace(floor)).unwrap();
    let obstacle = collision.add_obstacle("ball", ball(0.3)).unwrap();
    let (mut data, mut near) = (Data::new(&model), CollisionData::new(&collision));
    let mut gradient = vec![0.0; model.n()];
    let (q, dq) = (state(&model), vec![0.2; model.n()]);
    let mut rows = 0;
    let count = allocations(|| {
        kinematics(&model, &mut data, &q, &dq);
        for within_m in [0.0, 0.1, f64::INFINITY] {
            collision.move_obstacle(obstacle, ball(within_m.min(0.5))).unwrap();
            collision_distances(&collision, &model, &data, within_m, &mut near);
            for (pair, proximity) in near.near() {
                distance_gradient(&collision, &model, &data, pair, proximity, &mut gradient);
                black_box(distance_bias_acceleration(&collision, &data, pair, proximity));
                rows += 1;
            }
        }
        place_capsules(&collision, &model, &data, &mut near);
        for pair in 0..collision.pairs().len() {
            black_box(pair_proximity(&collision, &near, pair));
            collision.distance_change_bound(&model, pair, &mut gradient);
        }
    });
    assert_eq!(count, 0);
    assert!(rows >= collision.pairs().len(), "{rows}");
}

/// Checks that the factor refuses a non-finite state without an allocation.
#[test]
fn non_finite_state_does_not_allocate() {
    let model = load("ur5", UrdfOptions::default());
    let mut data = Data::new(&model);
    let q = vec![f64::NAN; model.n()];
    let count = allocations(|| assert!(!update(&model, &mut data, &q, &q)));
    assert_eq!(count, 0);
}
