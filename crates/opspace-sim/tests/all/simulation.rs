//! Tests of several arms in one simulation.

use crate::common::{START, arm, object, parsed, robot, setup};
use nalgebra::{DVector, Vector3};
use opspace_backend::quantity::NonNegative;
use opspace_backend::{Backend, Command, CommandKind, GroundTruth, Sample, Setpoints, TruthRow};
use opspace_model::{Data, Model, Placement, frame_placement, kinematics};
use opspace_sim::{
    ArmConfig, CouplingConfig, JointTorque, Plant, PlantArms, RigidPlant, SimulatedArm, Simulation,
    SimulationConfig, SimulationError,
};

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

const CYCLES: u32 = 120;

/// Returns an arm with all random sources and internal states: noise, quantisation, current loop, bus, an operator.
fn general(command: CommandKind, profile: &str, seed: u64) -> ArmConfig {
    let mut config = setup(command, profile);
    config.simulated = robot().simulated;
    config.simulated.torque_noise_nm = NonNegative::literal(0.03);
    config.simulated.bus = parsed("lost_cycles_share = 0.05\njitter_servo_ticks = 2");
    config.environment = vec![(
        "operator".to_owned(),
        object(
            "[spring]\nframe = 'hand'\nstiffness_n_per_m = 300.0\ndamping_ns_per_m = 15.0\nmotion.random = { rms_m = 0.04, from_hz = 0.1, to_hz = 0.7, ramp_s = 0.1 }",
        ),
    )];
    config.capabilities.setpoints = Setpoints::Interpolated;
    ArmConfig { seed, ..config }
}

fn simulated(arms: Vec<ArmConfig>) -> Vec<SimulatedArm> {
    let config = SimulationConfig { arms, ..SimulationConfig::default() };
    Simulation::new(config).unwrap_or_else(|e| panic!("{e}")).into_arms()
}

/// All outputs of an arm as bits: its samples and the rows of its true state.
#[derive(Default, PartialEq, Debug)]
struct Seen(Vec<u64>);

impl Seen {
    fn put(&mut self, values: &[f64]) {
        self.0.extend(values.iter().map(|value| value.to_bits()));
    }

    fn truth(&mut self, arm: &SimulatedArm) {
        arm.visit(&mut |row| match row {
            TruthRow::State { time_s, row } | TruthRow::External { time_s, row } => {
                self.put(&[time_s]);
                self.put(row);
            }
            TruthRow::Servo { time_s, command, row } => {
                self.put(&[time_s, command.map_or(-1.0, |number| number as f64)]);
                self.put(row);
            }
            other => panic!("{other:?}"),
        });
    }

    fn sample(&mut self, sample: &Sample) {
        self.put(&[sample.time_s]);
        self.put(&sample.q);
        self.put(sample.motor_torque.as_ref().expect("measured"));
        self.put(&sample.wrenches[0]);
    }
}

/// Reads an arm and writes its next command: motion, then hold, then motion.
fn cycle(arm: &mut SimulatedArm, seen: &mut Seen) -> f64 {
    let mut sample = Sample::new(arm.capabilities());
    arm.read(&mut sample).expect("the arm can be read");
    seen.truth(arm);
    seen.sample(&sample);
    let t = sample.time_s;
    let position = START.map(|q| q + 0.1 * (20.0 * t).sin());
    let command = match arm.capabilities().command {
        _ if (0.03..0.04).contains(&t) => Command::Hold,
        CommandKind::Position => Command::Position(&position),
        _ => Command::Torque(&[-4.0, 2.0, 1.0, 3.0]),
    };
    arm.write(command).expect("it takes them");
    t
}

/// Runs arms in the order of their next samples for `duration_s`. Of arms with samples at the same time, the first in
/// `order` is read first.
fn run(arms: &mut [SimulatedArm], order: &[usize], duration_s: f64) -> Vec<Seen> {
    let mut seen: Vec<Seen> = arms.iter().map(|_| Seen::default()).collect();
    // Times in servo ticks of the fastest arm, because equal times may differ by rounding.
    let due = |arm: &SimulatedArm| (arm.next_sample_s() * 5000.0).round() as i64;
    loop {
        let next = order.iter().copied().min_by_key(|&i| due(&arms[i])).expect("an arm");
        let due_s = arms[next].next_sample_s();
        if due_s >= duration_s {
            return seen;
        }
        assert_eq!(cycle(&mut arms[next], &mut seen[next]), due_s);
    }
}

/// Compared bit by bit: samples and true rows of two arms in one simulation, and of each arm alone. The two arms are
/// listed and read in either order.
#[test]
fn arms_in_one_simulation_equal_single_arms() {
    let configs = [general(CommandKind::Position, "a-med", 3), general(CommandKind::Torque, "a-med", 4)];
    let duration_s = f64::from(CYCLES) * 1e-3;
    let alone: Vec<Seen> =
        (configs.iter()).map(|config| run(&mut [arm(config.clone())], &[0], duration_s).remove(0)).collect();
    assert!(alone[0].0.len() > 100 * CYCLES as usize / 2 && alone[0] != alone[1]);
    for order in [[0, 1], [1, 0]] {
        let together = run(&mut simulated(configs.to_vec()), &order, duration_s);
        assert!(together == alone, "read in the order {order:?}");
        let stored = vec![configs[1].clone(), configs[0].clone()];
        let mut swapped = run(&mut simulated(stored), &order, duration_s);
        swapped.reverse();
        assert!(swapped == alone, "stored the other way round, read in the order {order:?}");
    }
}

/// Compared: two arms with drives of 5000 Hz and 1000 Hz in one simulation, in either order, bit by bit; and each of
/// them alone, up to rounding of the physics step.
#[test]
fn arms_may_have_different_rates() {
    /// Difference between rounded steps of 1/1000/20 and 1/5000/4, accumulated over the run.
    const ROUNDING_RAD: f64 = 1e-9;
    let mut configs = [general(CommandKind::Torque, "a-med", 3), general(CommandKind::Torque, "b-soft", 4)];
    for config in &mut configs {
        // With quantisation a rounding error could change a count.
        config.simulated.encoder_quantisation = false;
    }
    let duration_s = 0.2;
    let mut arms = simulated(configs.to_vec());
    let together = run(&mut arms, &[0, 1], duration_s);
    assert_ne!(together[0].0.len(), together[1].0.len());
    let mut stored = simulated(vec![configs[1].clone(), configs[0].clone()]);
    let mut swapped = run(&mut stored, &[0, 1], duration_s);
    swapped.reverse();
    assert!(swapped == together, "stored the other way round");
    for (config, seen) in configs.iter().zip(&together) {
        let mut single = [arm(config.clone())];
        let alone = run(&mut single, &[0], duration_s);
        assert_eq!(alone[0].0.len(), seen.0.len());
        let numbers = |seen: &Seen| seen.0.iter().map(|bits| f64::from_bits(*bits)).collect::<Vec<_>>();
        let (alone, together) = (numbers(&alone[0]), numbers(seen));
        let off = alone.iter().zip(&together).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < ROUNDING_RAD, "{off}");
    }
}

/// Compared: the sample of an arm that is read after another arm advanced the simulation, and the cycles that it
/// missed.
#[test]
fn unread_cycles_are_lost() {
    let configs = [setup(CommandKind::Position, "a-med"), setup(CommandKind::Position, "a-med")];
    let mut arms = simulated(configs.to_vec());
    let mut seen = Seen::default();
    for _ in 0..5 {
        cycle(&mut arms[0], &mut seen);
    }
    assert_eq!((arms[0].next_sample_cycle(), arms[1].next_sample_cycle()), (5, 4));
    let mut sample = Sample::new(arms[1].capabilities());
    arms[1].read(&mut sample).expect("the arm can be read");
    assert!((sample.time_s - 4e-3).abs() < 1e-12, "{} s", sample.time_s);
    let mut rows = Vec::new();
    arms[1].visit(&mut |row| {
        if let TruthRow::State { time_s, .. } = row {
            rows.push((time_s * 1e3).round());
        }
    });
    assert_eq!(rows, [0.0, 1.0, 2.0, 3.0, 4.0], "with the rows of the cycles that were lost");
    let other = arms.remove(1);
    drop(other);
    cycle(&mut arms[0], &mut seen);
}

/// Returns the hand's position in the world at `q`, m.
fn hand(model: &Model, q: &DVector<f64>) -> Vector3<f64> {
    let mut data = Data::new(model);
    kinematics(model, &mut data, q.as_slice(), &vec![0.0; model.n()]);
    frame_placement(model, &data, model.frame_id("hand").expect("the hand")).translation
}

/// Compared: forces of one wall on two arms side by side, one of them rotated, and the wall's stiffness times the depth
/// of each hand, from the kinematics of its own model and its placement.
#[test]
fn arm_bases_have_their_placements() {
    const STIFFNESS: f64 = 500.0;
    let base = Placement::from_rpy([0.0, 0.0, 2.0], [0.3, 1.0, 0.1]);
    let mut configs = [setup(CommandKind::Position, "a-med"), setup(CommandKind::Position, "a-med")];
    configs[1].model = configs[1].model.clone().with_base(base);
    let hands = |arms: &[SimulatedArm]| {
        let model = &setup(CommandKind::Position, "a-med").model;
        [hand(model, &arms[0].true_q()), base.act_point(&hand(model, &arms[1].true_q()))]
    };
    let start = hands(&simulated(configs.to_vec()));
    // Floor above both hands.
    let height = start[0].z.max(start[1].z) + 0.01;
    for config in &mut configs {
        let floor = format!(
            "[wall]\nframe = 'hand'\npoint_m = [0.0, 0.0, {height}]\nnormal = [0.0, 0.0, 1.0]\nstiffness_n_per_m = {STIFFNESS:.1}\ndamping_ns_per_m = 0.0"
        );
        config.environment = vec![("floor".to_owned(), object(&floor))];
        config.simulated.true_over_nominal.friction = NonNegative::literal(0.0);
    }
    let mut arms = simulated(configs.to_vec());
    let mut forces = [Vector3::zeros(); 2];
    for _ in 0..1000 {
        for (arm, force) in arms.iter_mut().zip(&mut forces) {
            let mut sample = Sample::new(arm.capabilities());
            arm.read(&mut sample).expect("the arm can be read");
            arm.visit(&mut |row| {
                if let TruthRow::State { row, .. } = row {
                    *force = Vector3::from_column_slice(&row[8..11]);
                }
            });
        }
    }
    for (force, hand) in forces.iter().zip(hands(&arms)) {
        let expected = Vector3::new(0.0, 0.0, STIFFNESS * (height - hand.z));
        assert!(expected.z > 3.0 && (force - expected).norm() < 1e-2, "{force} for {expected}");
    }
    assert!((forces[0] - forces[1]).norm() > 1e-2, "their hands are at different heights");
}

/// Compared: opposite forces on both arms of a spring between their hands, and its stiffness times the change of the
/// distance between the hands.
#[test]
fn coupling_forces_are_equal_and_opposite() {
    const STIFFNESS: f64 = 800.0;
    let base = Placement::from_rpy([0.0, 0.0, 0.0], [0.0, 0.5, 0.0]);
    let mut configs = [setup(CommandKind::Position, "a-med"), setup(CommandKind::Position, "a-med")];
    configs[1].model = configs[1].model.clone().with_base(base);
    let model = configs[0].model.clone();
    let coupling = CouplingConfig {
        name: "bar".to_owned(),
        first: (0, "hand".to_owned()),
        second: (1, "hand".to_owned()),
        stiffness_n_per_m: NonNegative::literal(STIFFNESS),
        damping_ns_per_m: NonNegative::literal(20.0),
    };
    let config = |coupling| SimulationConfig {
        arms: configs.to_vec(),
        couplings: vec![coupling],
        ..SimulationConfig::default()
    };
    let mut arms = Simulation::new(config(coupling.clone())).expect("two arms").into_arms();
    let mut forces = [Vector3::zeros(); 2];
    let goal = START.map(|q| q + 0.05);
    for _ in 0..1500 {
        for (index, (arm, force)) in arms.iter_mut().zip(&mut forces).enumerate() {
            let mut sample = Sample::new(arm.capabilities());
            arm.read(&mut sample).expect("the arm can be read");
            arm.visit(&mut |row| {
                if let TruthRow::State { row, .. } = row {
                    *force = Vector3::from_column_slice(&row[8..11]);
                }
            });
            arm.write(Command::Position(if index == 0 { &goal } else { &START })).expect("it takes them");
        }
    }
    let [first, second] = [0, 1].map(|i| hand(&model, &arms[i].true_q()));
    let expected = (second - first) * STIFFNESS;
    assert!(expected.norm() > 10.0 && (forces[0] - expected).norm() < 1e-2, "{} {expected}", forces[0]);
    assert_eq!(forces[0], -forces[1]);
    let names: Vec<String> =
        arms[1].layouts().truth.signals.iter().map(|signal| signal.name.clone()).collect();
    assert_eq!(names, ["q", "dq", "bar.force", "bar.work"]);
    for (second, reason) in [(2, "no arm 2"), (0, "both frames are on the same arm")] {
        let wrong = CouplingConfig { second: (second, "hand".to_owned()), ..coupling.clone() };
        let error = Simulation::new(config(wrong)).err().expect("refused");
        assert_eq!(error.to_string(), format!("coupling 'bar': {reason}"));
    }
}

/// Compared bit by bit: an arm that is created and run in its own thread, and one in this thread.
#[test]
fn arms_can_be_made_in_worker_threads() {
    let config = general(CommandKind::Position, "a-med", 3);
    let here = run(&mut [arm(config.clone())], &[0], 0.02);
    let there = std::thread::spawn(move || run(&mut [arm(config)], &[0], 0.02)).join().expect("it ends");
    assert!(here == there);
}

/// Wrapper of the library's plant that counts its steps.
struct OtherEngine(RigidPlant, Arc<AtomicU64>);

impl Plant for OtherEngine {
    fn arms(&self) -> &PlantArms {
        self.0.arms()
    }

    fn arms_mut(&mut self) -> &mut PlantArms {
        self.0.arms_mut()
    }

    fn step(&mut self, time_s: f64, dt_s: f64, torques: &[JointTorque]) {
        self.1.fetch_add(1, Ordering::Relaxed);
        self.0.step(time_s, dt_s, torques);
    }
}

/// Compared bit by bit: an arm on a plant passed to the simulation, and on the default plant; and the number of steps,
/// and the physics rate times the time of the last cycle.
#[test]
fn plant_can_be_replaced() {
    let mut config = general(CommandKind::Torque, "a-med", 3);
    config.simulated.bus = parsed("");
    let expected = run(&mut [arm(config.clone())], &[0], 0.0195);
    let steps = Arc::new(AtomicU64::new(0));
    let counter = Arc::clone(&steps);
    let config = SimulationConfig { arms: vec![config], ..SimulationConfig::default() };
    let build = |parts| Ok(Box::new(OtherEngine(RigidPlant::new(parts), counter)) as Box<dyn Plant>);
    let mut arms = Simulation::with_plant(config, build).expect("an arm").into_arms();
    assert!(run(&mut arms, &[0], 0.0195) == expected);
    assert_eq!(steps.load(Ordering::Relaxed), 19 * 20, "20 kHz up to 19 ms");
}

/// Checks the errors for rates without a common clock.
#[test]
fn incompatible_rates_are_refused() {
    #[derive(serde::Deserialize)]
    struct Rate {
        hz: opspace_backend::quantity::Positive,
    }
    let mut configs = [setup(CommandKind::Position, "a-med"), setup(CommandKind::Position, "a-med")];
    let refused = |configs: &[ArmConfig; 2]| {
        let config = SimulationConfig { arms: configs.to_vec(), ..SimulationConfig::default() };
        Simulation::new(config).err().expect("refused")
    };
    configs[1].profile.servo_hz = parsed::<Rate>("hz = 4000.5").hz;
    let expected = SimulationError::ServoRates { first_hz: 5000.0, second_hz: 4000.5 };
    assert_eq!(refused(&configs), expected);
    configs[1].profile.servo_hz = parsed::<Rate>("hz = 3000.0").hz;
    let expected = SimulationError::PhysicsRate { physics_hz: 20_000.0, servo_hz: 15_000.0 };
    assert_eq!(refused(&configs), expected);
    let none = SimulationConfig { arms: Vec::new(), ..SimulationConfig::default() };
    assert_eq!(Simulation::new(none).err(), Some(SimulationError::NoArm));
}
