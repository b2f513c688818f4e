//! What a control tick costs, dynamics and control together, beside Pinocchio and TSID: `cargo bench --bench control`.
//!
//! Peers are measured in the same run if they have been built by `benches/pinocchio/build target/pinocchio` and
//! `benches/tsid/build target/tsid`. All cycle over random states of a seven-joint arm with a pose task and a posture, and
//! print the median over repetitions. Pinocchio's tick has no limits and no damping; TSID's has bounds on torques,
//! velocities and accelerations, and weighs its two tasks in one QP.

#![expect(clippy::expect_used, clippy::print_stdout, reason = "a bench")]

use opspace_control::{
    Compensation, Controller, JointLimits, LimitParameters, Measurement, OperationalSpaceController,
    RobotFacts, Stack, TaskParameters,
};
use opspace_model::{Data, Model, update};
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

/// As the TSID peer's.
const ACCELERATION_LIMIT_RAD_PER_S2: f64 = 500.0;

fn main() {
    let testing = std::env::args().any(|a| a == "--test");
    let calls = if testing { 1 } else { CALLS };
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let urdf = root.join("tests/oracles/pinocchio/urdf/panda_arm7.urdf");
    let text = std::fs::read_to_string(&urdf).expect("the URDF is in the repository");
    let model = Model::from_urdf(&text).expect("it is a good one").model;

    let limits = JointLimits {
        acceleration: vec![ACCELERATION_LIMIT_RAD_PER_S2; model.n()],
        ..JointLimits::of(&model)
    };
    let wide = JointLimits { torque: vec![1e6; model.n()], ..JointLimits::none(model.n()) };
    let mut rows = Vec::new();
    let mut row = |name: &'static str, limits: &JointLimits, states: Vec<State>| {
        let mut bench = Bench::new(&model, limits);
        let (damped, limited) = bench.shares(&states);
        rows.push((name, bench.measure(&states, calls), damped, limited));
    };
    row("free", &wide, states(&model, 0.05, |share| share == 1.0));
    row("damped", &wide, states(&model, 0.05, |share| share < 1.0));
    row("limits", &limits, states(&model, 1.0, |_| true));

    let peer = |name: &str| {
        let path = root.join("target").join(name).join("peer");
        let built = path.exists() && !testing;
        if built { measure_peer(&path, &urdf, TIP) } else { BTreeMap::new() }
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

/// A state, and where the controller was started: its reference.
struct State {
    home: Vec<f64>,
    q: Vec<f64>,
    dq: Vec<f64>,
}

/// Random states within the arm's ranges, their references up to `away` (rad) from them in each joint, of which the
/// weakest share of the pose task is as it should be.
fn states(model: &Model, away: f64, wanted: impl Fn(f64) -> bool) -> Vec<State> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut bench = Bench::new(model, &JointLimits::none(model.n()));
    let mut states = Vec::with_capacity(STATES);
    while states.len() < STATES {
        let q: Vec<f64> =
            model.joints().iter().map(|j| rng.random_range(j.limits.lower..j.limits.upper)).collect();
        let mut q = q;
        // Straight elbows and wrists are rare at random: every other state has one nearly so.
        if states.len() % 2 == 1 && !wanted(1.0) {
            q[3] = -0.1;
        }
        let home = q.iter().map(|q| q + rng.random_range(-away..away)).collect();
        let dq = (0..model.n()).map(|_| rng.random_range(-1.0..1.0)).collect();
        let state = State { home, q, dq };
        if wanted(bench.weakest_share(&state)) {
            states.push(state);
        }
    }
    states
}

struct Bench<'a> {
    model: &'a Model,
    data: Data,
    seen: Measurement,
    controller: OperationalSpaceController,
    tau: Vec<f64>,
    row: Vec<f64>,
    /// Where in a row the share of the weakest direction stands.
    share: usize,
}

impl<'a> Bench<'a> {
    fn new(model: &'a Model, limits: &JointLimits) -> Self {
        let task: BTreeMap<String, TaskParameters> = toml::from_str(TASKS).expect("good tasks");
        let priority = ["hand".to_owned(), "rest".to_owned()];
        let stack = Stack {
            priority: &priority,
            task: &task,
            compensation: Compensation::Bias,
            limits: LimitParameters::default(),
        };
        let robot =
            RobotFacts { period_s: 1e-3, sensors: vec![], gravity_by_robot: false, limits: limits.clone() };
        let controller = OperationalSpaceController::new(model, &stack, &robot).expect("a good stack");
        let signals = opspace_control::Observable::signals(&controller);
        let before = signals.iter().take_while(|s| s.name != "hand.weakest_share");
        Self {
            model,
            data: Data::new(model),
            seen: Measurement::new(model.n(), 0, false),
            share: before.map(|s| s.len()).sum(),
            row: vec![0.0; signals.iter().map(|s| s.len()).sum()],
            controller,
            tau: vec![0.0; model.n()],
        }
    }

    /// The reference is the posture in the middle of all: what a tick costs doesn't depend on how far that is.
    fn start(&mut self, state: &State) {
        self.seen.q.copy_from_slice(&state.home);
        self.seen.dq.fill(0.0);
        assert!(update(self.model, &mut self.data, &state.home, self.seen.dq.as_slice()));
        self.controller.start(self.model, &self.data, &self.seen);
    }

    /// One tick.
    fn run(&mut self, state: &State) {
        self.seen.q.copy_from_slice(&state.q);
        self.seen.dq.copy_from_slice(&state.dq);
        assert!(update(self.model, &mut self.data, &state.q, &state.dq));
        self.controller.update(self.model, &self.data, black_box(&self.seen), &mut self.tau);
    }

    fn weakest_share(&mut self, state: &State) -> f64 {
        self.start(state);
        self.run(state);
        opspace_control::Observable::sample(&self.controller, &mut opspace_control::Row::new(&mut self.row));
        self.row[self.share]
    }

    /// Which share of the states is damped, and which is limited.
    fn shares(&mut self, states: &[State]) -> (f64, f64) {
        let (mut damped, mut limited) = (0, 0);
        for state in states {
            damped += usize::from(self.weakest_share(state) < 1.0);
            limited += usize::from(self.controller.is_limited());
        }
        (damped as f64 / states.len() as f64, limited as f64 / states.len() as f64)
    }

    fn measure(&mut self, states: &[State], calls: usize) -> f64 {
        let of = |bench: &mut Self| time(calls, |i| bench.run(&states[i]));
        of(self);
        of(self)
    }
}
