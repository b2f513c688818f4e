//! Cost of the dynamics, beside Pinocchio: `cargo bench --bench dynamics`, with robots' names behind `--` for those
//! alone.
//!
//! Pinocchio is measured in the same run if it has been built by `benches/pinocchio/build target/pinocchio`; without it
//! ours is measured alone. Both cycle over many random states and print the median over repetitions. All start from q
//! but `cholesky`, which factors one M. benches/pinocchio/README.md says what the peer's rows are; its `crba` fills one
//! triangle, ours both, and its derivatives yield M besides.

#![expect(clippy::expect_used, clippy::print_stdout, reason = "a bench")]

use nalgebra::{Matrix6xX, Rotation3, UnitQuaternion, Vector3, Vector6};
use opspace_model::batch::{self, Lanes};
use opspace_model::collision::{
    CollisionData, CollisionModel, PairSampling, collision_distances, distance_bias_acceleration,
    distance_gradient, generate_capsules,
};
use opspace_model::urdf::link_shapes;
use opspace_model::{
    Data, FrameId, Inertia, Joint, JointKind, Limits, Model, OperationalSpace, Placement, Real, aba,
    aba_derivatives, bias, centroidal_map, cholesky, crba, forward_kinematics, frame_bias_acceleration,
    frame_jacobian, frame_placement, frame_velocity, gravity, kinematics, mass_matrix_inverse, rnea,
    rnea_derivatives, torque_regressor, update,
};
use opspace_testing::oracle::{urdf, urdf_path};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::hint::black_box;
use std::path::Path;

#[path = "common/timing.rs"]
mod timing;
use timing::{CALLS, STATES, measure_peer, time};

const ROBOTS: [(&str, &str); 4] = [
    ("panda_arm7", "panda_hand_tcp"),
    ("ur5", "tool0"),
    ("panda", "panda_hand_tcp"),
    ("g1_29dof", "left_rubber_hand"),
];

fn main() {
    // `cargo bench -- --test`: whether it runs, not how fast.
    let testing = std::env::args().any(|a| a == "--test");
    let calls = if testing { 1 } else { CALLS };
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let peer = root.join("target/pinocchio/peer");
    // Robots by name: these and nothing else.
    let names: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    for (robot, tip) in
        ROBOTS.into_iter().filter(|(robot, _)| names.is_empty() || names.iter().any(|n| n == robot))
    {
        let model = Model::from_urdf(&urdf(robot)).expect("it is a good one").model;
        let theirs = if peer.exists() && !testing {
            measure_peer(&peer, Path::new(&urdf_path(robot)), tip)
        } else {
            BTreeMap::new()
        };
        let mut bench = Bench::new(&model, model.frame_id(tip).expect("has that frame"));
        // The first tenth of a second after another program is a third slower: a first round warms up.
        bench.measure(calls);
        let ours = bench.measure(calls);
        println!("\n{robot}, {} joints: ns", model.n());
        println!("{:18}{:>10}{:>12}{:>8}", "", "opspace", "pinocchio", "ratio");
        for (operation, ns) in ours {
            match theirs.get(operation) {
                Some(peer) => println!("{operation:18}{ns:10.0}{peer:12.0}{:8.2}", ns / peer),
                None => println!("{operation:18}{ns:10.0}"),
            }
        }
    }
    if !peer.exists() {
        println!("\nPinocchio isn't built: benches/pinocchio/build target/pinocchio");
    }
    if names.is_empty() {
        scaling(calls);
        batches(calls);
        distances(calls);
    }
}

/// Random states: q within its limits, q̇, q̈ and τ in the ranges of an arm in motion.
struct States<T> {
    q: Vec<Vec<T>>,
    dq: Vec<Vec<T>>,
    ddq: Vec<Vec<T>>,
    tau: Vec<Vec<T>>,
}

impl<T: Real> States<T> {
    fn new(model: &Model<T>) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut draw = |range: &dyn Fn(&Limits) -> (f64, f64)| -> Vec<Vec<T>> {
            let mut lanes = |(low, high): (f64, f64)| {
                let mut x = T::splat(0.0);
                (0..T::LANES).for_each(|lane| x.replace(lane, rng.random_range(low..high)));
                x
            };
            (0..STATES).map(|_| model.joints().iter().map(|j| lanes(range(&j.limits))).collect()).collect()
        };
        Self {
            q: draw(&|limits| {
                (limits.lower.max(-3.1), limits.upper.min(3.1).max(limits.lower.max(-3.1) + 1e-9))
            }),
            dq: draw(&|_| (-2.0, 2.0)),
            ddq: draw(&|_| (-5.0, 5.0)),
            tau: draw(&|_| (-20.0, 20.0)),
        }
    }
}

struct Bench<'a> {
    model: &'a Model,
    tip: FrameId,
    data: Data,
    states: States<f64>,
}

impl<'a> Bench<'a> {
    fn new(model: &'a Model, tip: FrameId) -> Self {
        Self { model, tip, data: Data::new(model), states: States::new(model) }
    }

    /// Measures each operation from q on, as Pinocchio's are measured.
    fn measure(&mut self, calls: usize) -> Vec<(&'static str, f64)> {
        let Self { model, tip, data, states } = self;
        let (model, tip, n) = (*model, *tip, model.n());
        let states = &*states;
        let States { q, dq, ddq, tau } = states;
        let mut jacobian = Matrix6xX::zeros(n);
        let mut regressor = nalgebra::DMatrix::zeros(n, 10 * n);
        let mut tick = Tick::new(n);
        let mut results = sweep(model, data, states, calls);
        let mut row = |name, call: &mut dyn FnMut(usize)| results.push((name, time(calls, call)));
        row("fk_jacobian", &mut |i| {
            forward_kinematics(model, data, black_box(&q[i]));
            frame_jacobian(model, data, tip, black_box(&mut jacobian));
        });
        row("bias", &mut |i| {
            kinematics(model, data, black_box(&q[i]), &dq[i]);
            bias(model, black_box(data));
        });
        row("minverse", &mut |i| {
            forward_kinematics(model, data, black_box(&q[i]));
            crba(model, data);
            assert!(cholesky(data));
            mass_matrix_inverse(black_box(data));
        });
        row("update", &mut |i| assert!(update(model, black_box(data), &q[i], &dq[i])));
        row("osc_tick", &mut |i| tick.run(model, data, tip, black_box(&q[i]), &dq[i]));
        row("cholesky", &mut |_| assert!(cholesky(black_box(data))));
        row("derivatives_rnea", &mut |i| {
            kinematics(model, data, black_box(&q[i]), &dq[i]);
            rnea_derivatives(model, black_box(data), &ddq[i]);
        });
        row("derivatives_aba", &mut |i| {
            kinematics(model, data, black_box(&q[i]), &dq[i]);
            crba(model, data);
            assert!(cholesky(data));
            aba_derivatives(model, black_box(data), &tau[i]);
        });
        row("centroidal", &mut |i| {
            kinematics(model, data, black_box(&q[i]), &dq[i]);
            centroidal_map(model, black_box(data));
        });
        row("regressor", &mut |i| {
            kinematics(model, data, black_box(&q[i]), &dq[i]);
            torque_regressor(model, data, &ddq[i], black_box(&mut regressor));
        });
        results
    }
}

/// One control cycle in operational space without limits and damping: a pose task of six rows over a posture.
struct Tick {
    desired: Placement,
    jacobian: Matrix6xX<f64>,
    space: OperationalSpace,
    posture: Vec<f64>,
    tau: Vec<f64>,
}

impl Tick {
    fn new(n: usize) -> Self {
        let jacobian = Matrix6xX::zeros(n);
        let desired = Placement::from_rpy([0.3, -0.2, 0.5], [0.4, 0.1, 0.5]);
        Self { desired, jacobian, space: OperationalSpace::new(n), posture: vec![0.0; n], tau: vec![0.0; n] }
    }

    /// Computes τ = Jᵀ Λ (a − J̇ q̇) + Nᵀ (M (−kp q − kv q̇)) + h, with a from the errors of position and rotation.
    #[inline(never)]
    fn run(&mut self, model: &Model, data: &mut Data, tip: FrameId, q: &[f64], dq: &[f64]) {
        kinematics(model, data, q, dq);
        crba(model, data);
        bias(model, data);
        assert!(cholesky(data));
        frame_jacobian(model, data, tip, &mut self.jacobian);
        self.space.update(&data.mass_matrix_factor, &self.jacobian, 6, 0.0);
        let drift = frame_bias_acceleration(model, data, tip);
        let velocity = frame_velocity(model, data, tip);
        let place = frame_placement(model, data, tip);
        let behind = self.desired.translation - place.translation;
        let turn = Rotation3::from_matrix_unchecked(self.desired.rotation * place.rotation.transpose());
        let linear = behind * 100.0 - velocity.linear * 20.0 - drift.linear;
        let angular = UnitQuaternion::from_rotation_matrix(&turn).scaled_axis() * 100.0
            - velocity.angular * 20.0
            - drift.angular;
        let wanted = Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z);
        let force = self.space.task_inertia * wanted;
        for (i, x) in self.posture.iter_mut().enumerate() {
            *x = -100.0 * q[i] - 20.0 * dq[i];
        }
        self.tau.fill(0.0);
        for (column, &x) in data.mass_matrix.column_iter().zip(&self.posture) {
            self.tau.iter_mut().zip(column.iter()).for_each(|(t, m)| *t += m * x);
        }
        self.space.project_torque(&self.jacobian, &mut self.tau);
        for (i, t) in self.tau.iter_mut().enumerate() {
            *t += self.jacobian.column(i).dot(&force) + data.bias[i];
        }
        black_box(&mut self.tau);
    }
}

/// A chain of `n` joints, each turned against the one before.
fn chain(n: usize) -> Model {
    let mut model = Model::new("chain");
    let inertia = Inertia {
        mass: 1.0,
        com: Vector3::new(0.02, 0.01, 0.1),
        rotational: nalgebra::Matrix3::from_diagonal(&Vector3::new(0.02, 0.03, 0.01)),
    };
    for i in 0..n {
        let joint = Joint { name: format!("j{i}"), kind: JointKind::Continuous, limits: Limits::NONE };
        let origin = Placement::from_rpy([1.1, 0.4, -0.3], [0.05, 0.02, 0.25]);
        model.add_body(i.checked_sub(1), origin, joint, inertia);
    }
    model
}

/// Measures inverse and forward dynamics over the number of joints, in which they are linear.
fn scaling(calls: usize) {
    println!("\na chain: ns, and ns per joint");
    println!("{:8}{:>10}{:>8}{:>10}{:>8}", "joints", "rnea", "", "aba", "");
    for n in [4, 8, 16, 32, 64] {
        let model = chain(n);
        let (mut data, States { q, dq, ddq, tau }) = (Data::new(&model), States::new(&model));
        let inverse = time(calls, |i| {
            kinematics(&model, &mut data, black_box(&q[i]), &dq[i]);
            rnea(&model, black_box(&mut data), &ddq[i]);
        });
        let forward = time(calls, |i| {
            kinematics(&model, &mut data, black_box(&q[i]), &dq[i]);
            aba(&model, black_box(&mut data), &tau[i]);
        });
        let each = |ns: f64| ns / n as f64;
        println!("{n:<8}{inverse:10.0}{:8.1}{forward:10.0}{:8.1}", each(inverse), each(forward));
    }
}

/// Measures states per second, one after another and in lanes.
fn batches(calls: usize) {
    let model = Model::from_urdf(&urdf("panda_arm7")).expect("it is a good one").model;
    let one = warm_sweep(&model, calls);
    let many = warm_sweep(&model.splat::<Lanes>(), calls);
    println!("\npanda_arm7, million states per second: alone, {} in lanes", batch::COUNT);
    for ((name, alone), (_, lanes)) in one.iter().zip(&many) {
        println!("{name:18}{:10.2}{:10.2}{:8.2} times", 1e3 / alone, 1e3 / lanes, alone / lanes);
    }
}

/// Measures like [`sweep`], after a first round that warms up.
fn warm_sweep<T: Real>(model: &Model<T>, calls: usize) -> Vec<(&'static str, f64)> {
    let (mut data, states) = (Data::new(model), States::new(model));
    sweep(model, &mut data, &states, calls);
    sweep(model, &mut data, &states, calls)
}

/// Measures the algorithms that are written for one state and for lanes: ns per state.
fn sweep<T: Real>(
    model: &Model<T>,
    data: &mut Data<T>,
    States { q, dq, ddq, tau }: &States<T>,
    calls: usize,
) -> Vec<(&'static str, f64)> {
    let mut results = Vec::new();
    let mut row =
        |name, call: &mut dyn FnMut(usize)| results.push((name, time(calls, call) / T::LANES as f64));
    row("fk", &mut |i| forward_kinematics(model, data, black_box(&q[i])));
    row("gravity", &mut |i| {
        forward_kinematics(model, data, black_box(&q[i]));
        gravity(model, black_box(data));
    });
    row("crba", &mut |i| {
        forward_kinematics(model, data, black_box(&q[i]));
        crba(model, black_box(data));
    });
    row("rnea", &mut |i| {
        kinematics(model, data, black_box(&q[i]), &dq[i]);
        rnea(model, black_box(data), &ddq[i]);
    });
    row("aba", &mut |i| {
        kinematics(model, data, black_box(&q[i]), &dq[i]);
        aba(model, black_box(data), &tau[i]);
    });
    results
}

/// Largest distance of the pairs whose derivatives are computed, m.
const NEAR_M: f64 = 0.1;

/// Measures the distances of all pairs of capsules, and with the gradient and the bias acceleration of those that are near;
/// without the kinematics, which are measured alone and subtracted.
fn distances(calls: usize) {
    println!("\ndistances of capsules: ns without kinematics");
    println!("{:12}{:>8}{:>8}{:>12}{:>12}", "", "pairs", "near", "distances", "+ gradients");
    for robot in ["panda_arm7", "panda", "ur5"] {
        let text = urdf(robot);
        let model = Model::from_urdf(&text).expect("it is a good one").model;
        let links = link_shapes(&text).expect("it is a good one");
        let capsules = generate_capsules(&links, None).expect("no mesh").capsules;
        let all = CollisionModel::new(&model, &capsules).expect("links of the model");
        let mut chosen = all.clone();
        chosen.drop_unneeded_pairs(&model, &PairSampling::default());
        for collision in [all, chosen] {
            let (near, distances, gradients) = measure_distances(&model, &collision, calls);
            let pairs = collision.pairs().len();
            println!("{robot:12}{pairs:8}{near:8.1}{distances:12.0}{gradients:12.0}");
        }
    }
}

/// Returns the mean number of near pairs, and the times of their distances without and with derivatives, ns.
fn measure_distances(model: &Model, collision: &CollisionModel, calls: usize) -> (f64, f64, f64) {
    let (mut data, States { q, dq, .. }) = (Data::new(model), States::new(model));
    let mut near = CollisionData::new(collision);
    let mut gradient = vec![0.0; model.n()];
    let mut count = 0;
    for (q, dq) in q.iter().zip(&dq) {
        kinematics(model, &mut data, q, dq);
        collision_distances(collision, model, &data, NEAR_M, &mut near);
        count += near.near().count();
    }
    let mut measure = |stage: usize| {
        time(calls, |i| {
            kinematics(model, &mut data, black_box(&q[i]), &dq[i]);
            if stage > 0 {
                collision_distances(collision, model, &data, NEAR_M, black_box(&mut near));
            }
            if stage > 1 {
                for (pair, proximity) in near.near() {
                    distance_gradient(collision, model, &data, pair, proximity, black_box(&mut gradient));
                    black_box(distance_bias_acceleration(collision, &data, pair, proximity));
                }
            }
        })
    };
    // The first round warms up.
    let [_, alone, distances, gradients] = [1, 0, 1, 2].map(&mut measure);
    (count as f64 / STATES as f64, distances - alone, gradients - alone)
}
