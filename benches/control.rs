//! Cost of a control cycle, dynamics and control together, beside Pinocchio and TSID: `cargo bench --bench control`,
//! with the names of cycles behind `--` for those alone.
//!
//! Peers are measured in the same run if they have been built by `benches/pinocchio/build target/pinocchio` and
//! `benches/tsid/build target/tsid`. All cycle over random states of a seven-joint arm with a pose task and a posture,
//! and print the median over repetitions. The last line compares cycles with and without the distances that the arm keeps
//! from itself, in turns. Pinocchio's cycle has no limits and no damping; TSID's has bounds on torques,
//! velocities and accelerations, and weighs its two tasks in one QP.

#![expect(clippy::expect_used, clippy::print_stdout, reason = "a bench")]

use opspace_control::{
    CollisionLimits, ControlContext, ControlInput, Controller, JointLimits, Measurement,
    OperationalSpaceController, Targets, TaskParameters, TaskSetParameters,
};
use opspace_model::collision::{CapsuleSource, CollisionModel, LinkCapsule, PairSampling};
use opspace_model::{Data, Model, update};
use opspace_testing::oracle::{urdf, urdf_path};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::hint::black_box;
use std::path::Path;

#[path = "common/timing.rs"]
mod timing;
use timing::{CALLS, STATES, measure_peer, time};

const TIP: &str = "panda_hand_tcp";

const TASKS: &str = r#"
[hand.cartesian]
frame = "panda_hand_tcp"
axes = { x = "motion", y = "motion", z = "motion", rx = "motion", ry = "motion", rz = "motion" }
reference = "hold"
gains = { frequency_rad_per_s = 14.142, damping_ratio = 1.0 }

[rest.joint-posture]
frequency_rad_per_s = 6.325
damping_ratio = 0.79
"#;

/// Acceleration limit, equal to that of the TSID peer.
const ACCELERATION_LIMIT_RAD_PER_S2: f64 = 500.0;

fn main() {
    let testing = std::env::args().any(|a| a == "--test");
    let calls = if testing { 1 } else { CALLS };
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let model = Model::from_urdf(&urdf("panda_arm7")).expect("it is a good one").model;

    let limits = JointLimits {
        acceleration: vec![ACCELERATION_LIMIT_RAD_PER_S2; model.n()],
        ..JointLimits::of(&model)
    };
    // One state after the other is a jump, which a rate would cut.
    let wide = JointLimits { torque_rate: vec![1e9; model.n()], ..limits.clone() };
    let mut rows = Vec::new();
    let names: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let mut row = |name: &'static str, limits: &JointLimits, states: &dyn Fn() -> States| {
        if !names.is_empty() && !names.iter().any(|n| n == name) {
            return;
        }
        let states = states();
        let mut bench = Bench::new(&model, limits, None);
        let (damped, limited) = bench.shares(&states);
        rows.push((name, bench.measure(&states, calls), damped, limited));
    };
    row("free", &wide, &|| states(&model, &wide, 0.2, false, |share, limited| share == 1.0 && !limited));
    row("damped", &wide, &|| states(&model, &wide, 0.1, true, |share, limited| share < 1.0 && !limited));
    row("limits", &limits, &|| states(&model, &limits, 0.9, false, |_, _| true));

    if names.is_empty() || names.iter().any(|name| name == "pairs") {
        compare_pairs(&model, &wide, calls);
    }

    let peer = |name: &str| {
        let path = root.join("target").join(name).join("peer");
        let built = path.exists() && !testing;
        if built { measure_peer(&path, Path::new(&urdf_path("panda_arm7")), TIP) } else { BTreeMap::new() }
    };
    let (pinocchio, tsid) = (peer("pinocchio"), peer("tsid"));
    let theirs = |of: &BTreeMap<String, f64>, name: &str, ns: f64| {
        of.get(name).map_or_else(|| format!("{:>18}", "–"), |peer| format!("{peer:10.0} {:7.2}", ns / peer))
    };
    println!("\npanda_arm7, pose and posture, 7 joints: ns, and ours over theirs");
    println!(
        "{:10}{:>10}{:>10}{:>10}{:>18}{:>18}",
        "tick", "opspace", "damped", "limited", "pinocchio", "tsid"
    );
    for (name, ns, damped, limited) in rows {
        let of_tsid = if name == "limits" { "tick_limits" } else { "tick_free" };
        let (p, t) = (theirs(&pinocchio, "osc_tick", ns), theirs(&tsid, of_tsid, ns));
        println!("{name:10}{ns:10.0}{:9.0}%{:9.0}%{p}{t}", 100.0 * damped, 100.0 * limited);
    }
}

/// Distance that the arm keeps, m.
const MARGIN_M: f64 = 0.02;

/// Number of turns of the comparison with and without distances.
const TURNS: usize = 7;

/// Prints the duration of a free cycle without and with the distances of all pairs of the Panda's capsules.
fn compare_pairs(model: &Model, limits: &JointLimits, calls: usize) {
    let mut states = states(model, limits, 0.2, false, |share, limited| share == 1.0 && !limited);
    let mut geometry = CollisionModel::new(model, &capsules()).expect("links of the model");
    geometry.drop_unneeded_pairs(model, &PairSampling { colliding_m: MARGIN_M, ..PairSampling::default() });
    for [first, second] in
        [["1", "3"], ["3", "5"], ["5", "7"]].map(|pair| pair.map(|link| format!("panda_link{link}")))
    {
        geometry.drop_pairs(&first, &second).expect("links with capsules");
    }
    let pairs = geometry.pairs().len();
    let collision = CollisionLimits { geometry, margin_m: MARGIN_M };
    let (mut without, mut with) =
        (Bench::new(model, limits, None), Bench::new(model, limits, Some(collision)));
    // Only states in which no distance is in force: the others solve programs.
    with.start(&states.home);
    let is_free: Vec<bool> = (states.q.iter().zip(&states.dq))
        .map(|(q, dq)| {
            with.run(q, dq);
            !with.controller.is_limited()
        })
        .collect();
    let free: Vec<usize> = (0..STATES).filter(|&i| is_free[i]).collect();
    assert!(free.len() > STATES / 10, "{} free states", free.len());
    let again =
        |list: &[Vec<f64>]| (0..STATES).map(|i| list[free[i % free.len()]].clone()).collect::<Vec<_>>();
    (states.q, states.dq) = (again(&states.q), again(&states.dq));
    let (_, limited) = with.shares(&states);
    without.start(&states.home);
    let mut turns: Vec<[f64; 2]> =
        (0..TURNS).map(|_| [without.measure(&states, calls), with.measure(&states, calls)]).collect();
    turns.sort_by(|a, b| (a[1] - a[0]).total_cmp(&(b[1] - b[0])));
    let [without, with] = turns[TURNS / 2];
    println!(
        "free cycle with {pairs} pairs kept apart: {with:.0} ns, without {without:.0} ns, difference {:.0} ns; limited {:.0}%",
        with - without,
        100.0 * limited
    );
}

/// Capsules of robots/panda/robot.toml.
fn capsules() -> Vec<LinkCapsule> {
    #[derive(serde::Deserialize)]
    struct Capsule {
        link: String,
        start_m: [f64; 3],
        end_m: [f64; 3],
        radius_m: f64,
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../robots/panda/robot.toml");
    let text = std::fs::read_to_string(path).expect("a robot of the project");
    let file: toml::Table = toml::from_str(&text).expect("TOML");
    let list = file["collision"]["capsule"].clone().try_into::<Vec<Capsule>>().expect("capsules");
    let one = |(number, capsule): (usize, Capsule)| LinkCapsule {
        name: number.to_string(),
        link: format!("panda_{}", capsule.link),
        start_m: capsule.start_m,
        end_m: capsule.end_m,
        radius_m: capsule.radius_m,
        source: CapsuleSource::User,
    };
    list.into_iter().enumerate().map(one).collect()
}

/// Posture at the controller's start, which is its reference, and states of the arm.
struct States {
    home: Vec<f64>,
    q: Vec<Vec<f64>>,
    dq: Vec<Vec<f64>>,
}

/// Random states within `away` (rad) of a random posture, of which the weakest share of the pose task, and whether a
/// limit is in the way, are as they should be; with `straight`, of one with a nearly straight elbow.
fn states(
    model: &Model,
    limits: &JointLimits,
    away: f64,
    straight: bool,
    wanted: impl Fn(f64, bool) -> bool,
) -> States {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut bench = Bench::new(model, limits, None);
    let speed = away.min(1.0);
    loop {
        let between = |joint: &opspace_model::Joint| {
            let (lower, upper) = (joint.limits.lower, joint.limits.upper);
            (lower + 0.3 * (upper - lower))..(upper - 0.3 * (upper - lower))
        };
        let mut home: Vec<f64> = model.joints().iter().map(|j| rng.random_range(between(j))).collect();
        if straight {
            home[3] = -0.15;
        }
        bench.start(&home);
        let mut states = States { home, q: Vec::new(), dq: Vec::new() };
        for _ in 0..100 * STATES {
            let q: Vec<f64> = states.home.iter().map(|q| q + rng.random_range(-away..away)).collect();
            let dq: Vec<f64> = q.iter().map(|_| rng.random_range(-speed..speed)).collect();
            if wanted(bench.min_singular_gain(&q, &dq), bench.controller.is_limited()) {
                states.q.push(q);
                states.dq.push(dq);
            }
            if states.q.len() == STATES {
                return states;
            }
        }
    }
}

struct Bench<'a> {
    model: &'a Model,
    data: Data,
    seen: Measurement,
    controller: OperationalSpaceController,
    tau: Vec<f64>,
    row: Vec<f64>,
    /// Index in a row of the share of the weakest direction.
    share: usize,
    targets: Targets,
}

/// The controller's input, without feed-forward torques.
fn input<'a>(
    model: &'a Model,
    data: &'a Data,
    measurement: &'a Measurement,
    targets: &'a Targets,
) -> ControlInput<'a> {
    static NO_FEEDFORWARD: [f64; 32] = [0.0; 32];
    let feedforward_torque = &NO_FEEDFORWARD[..model.n()];
    ControlInput::new(model, data, measurement, feedforward_torque, targets)
}

impl<'a> Bench<'a> {
    fn new(model: &'a Model, limits: &JointLimits, collision: Option<CollisionLimits>) -> Self {
        let task: BTreeMap<String, TaskParameters> = toml::from_str(TASKS).expect("good tasks");
        let priority = ["hand".to_owned(), "rest".to_owned()];
        let stack = TaskSetParameters::new(&priority, &task);
        let context =
            ControlContext { limits: limits.clone(), collision, ..ControlContext::new(model, 1e-3) };
        let controller = OperationalSpaceController::new(model, &stack, &context).expect("a good stack");
        let signals = opspace_backend::Observable::signals(&controller);
        let before = signals.iter().take_while(|s| s.name != "hand.min_singular_gain");
        Self {
            model,
            data: Data::new(model),
            seen: Measurement::new(model.n(), 0, false),
            share: before.map(|s| s.len()).sum(),
            row: vec![0.0; signals.iter().map(|s| s.len()).sum()],
            controller,
            tau: vec![0.0; model.n()],
            targets: Targets::none(),
        }
    }

    fn start(&mut self, home: &[f64]) {
        self.seen.q.copy_from_slice(home);
        self.seen.dq.fill(0.0);
        assert!(update(self.model, &mut self.data, home, self.seen.dq.as_slice()));
        self.controller.start(&input(self.model, &self.data, &self.seen, &self.targets));
    }

    /// Computes one control cycle.
    fn run(&mut self, q: &[f64], dq: &[f64]) {
        self.seen.q.copy_from_slice(q);
        self.seen.dq.copy_from_slice(dq);
        assert!(update(self.model, &mut self.data, q, dq));
        let input = input(self.model, &self.data, black_box(&self.seen), &self.targets);
        self.controller.update(&input, &mut self.tau);
    }

    fn min_singular_gain(&mut self, q: &[f64], dq: &[f64]) -> f64 {
        self.run(q, dq);
        opspace_backend::Observable::sample(&self.controller, &mut self.row);
        self.row[self.share]
    }

    /// Shares of the states that are damped, and that are limited, each state after the one before it.
    fn shares(&mut self, states: &States) -> (f64, f64) {
        let (mut damped, mut limited) = (0, 0);
        self.start(&states.home);
        for (q, dq) in states.q.iter().zip(&states.dq) {
            damped += usize::from(self.min_singular_gain(q, dq) < 1.0);
            limited += usize::from(self.controller.is_limited());
        }
        (damped as f64 / STATES as f64, limited as f64 / STATES as f64)
    }

    fn measure(&mut self, states: &States, calls: usize) -> f64 {
        let of = |bench: &mut Self| time(calls, |i| bench.run(&states.q[i], &states.dq[i]));
        of(self);
        of(self)
    }
}
