//! Tests of arms of one simulation that are driven together.

use crate::common::{self, parsed};
use opspace_backend::quantity::Positive;
use opspace_backend::{Capabilities, CommandKind, Sink, TIMING};
use opspace_control::{
    Compensation, ControlContext, JointGains, JointPostureParameters, LimitParameters,
    OperationalSpaceController, TaskParameters, TaskSet,
};
use opspace_loop::{ControlLoop, Driven, LoopConfig, Run, RunOutcome, Timeline, drive, drive_together};
use opspace_sim::{ArmConfig, SimulatedArm, Simulation, SimulationConfig};

/// Duration of control, s.
const DURATION_S: f64 = 0.5;

/// Interface rates of the two arms, Hz.
const RATES_HZ: [u32; 2] = [1000, 500];

fn capabilities(rate_hz: u32) -> Capabilities {
    Capabilities::new(["shoulder", "elbow"], CommandKind::Torque, 1.0 / f64::from(rate_hz)).simulated()
}

/// Returns an arm whose bus loses a tenth of its cycles.
fn arm_config(arm: usize) -> ArmConfig {
    let mut config =
        ArmConfig::ideal(common::model(), capabilities(RATES_HZ[arm]), Vec::new()).expect("a period");
    config.simulated.physics_hz = Positive::literal(10_000.0);
    config.simulated.bus = parsed("lost_cycles_share = 0.1");
    ArmConfig { seed: 7 + arm as u64, start: vec![0.2, -0.5], ..config }
}

/// Returns a loop that moves the arm to a posture away from its start.
fn control_loop(arm: usize) -> ControlLoop {
    let (model, capabilities) = (common::model(), capabilities(RATES_HZ[arm]));
    let context = ControlContext::new(&model, capabilities.period_s);
    let gains = JointGains::new(10.0, 1.0).expect("good gains");
    let mut posture = JointPostureParameters::new(gains);
    posture.posture_rad = [("shoulder".to_owned(), 0.5)].into_iter().collect();
    let tasks = TaskSet::builder(&model, &context)
        .from_parameters("rest", &TaskParameters::JointPosture(posture))
        .expect("a good task")
        .build();
    let limits = LimitParameters::default();
    let controller =
        OperationalSpaceController::from_tasks(&model, tasks, &context, Compensation::Bias, &limits);
    ControlLoop::new(LoopConfig::new(model, capabilities, Box::new(controller))).expect("parts that fit")
}

/// Sink that keeps the rows of an arm as bits, without the wall-clock times of the steps.
#[derive(Default)]
struct Rows(Vec<u64>);

impl Sink for Rows {
    fn row(&mut self, channel: usize, time_s: f64, row: &[f64]) {
        if channel != TIMING {
            self.0.push(time_s.to_bits());
            self.0.extend(row.iter().map(|value| value.to_bits()));
        }
    }
}

/// Returns the rows of an arm alone in its simulation.
fn single_arm_rows(arm: usize) -> Vec<u64> {
    let mut rows = Rows::default();
    let mut run = Run::new(control_loop(arm), DURATION_S, &mut rows);
    let mut robot = SimulatedArm::new(arm_config(arm)).expect("an arm");
    drive(&mut robot, &mut run);
    assert_eq!(run.finish(), RunOutcome::Completed);
    rows.0
}

/// Compared: the rows of two arms in one simulation, whose buses lose cycles, and the rows of each arm alone.
#[test]
fn lost_cycles_do_not_affect_the_other_arm() {
    let config = SimulationConfig { arms: vec![arm_config(0), arm_config(1)], ..SimulationConfig::default() };
    let mut arms = Simulation::new(config).expect("a simulation").into_arms();
    let [first, second] = &mut arms[..] else { panic!("two arms") };
    let mut rows = [Rows::default(), Rows::default()];
    let [first_rows, second_rows] = &mut rows;
    let mut runs = [
        Run::new(control_loop(0), DURATION_S, first_rows),
        Run::new(control_loop(1), DURATION_S, second_rows),
    ];
    let [first_run, second_run] = &mut runs;
    let mut robots = [Driven { backend: first, run: first_run }, Driven { backend: second, run: second_run }];
    let mut timeline = Timeline::new(&RATES_HZ).expect("a clock");
    drive_together(&mut robots, &mut [], &mut timeline);
    for run in runs {
        assert_eq!(run.finish(), RunOutcome::Completed);
    }
    for (arm, rows) in rows.iter().enumerate() {
        assert!(rows.0 == single_arm_rows(arm), "arm {arm}");
    }
}
