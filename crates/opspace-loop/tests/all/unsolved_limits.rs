//! Programs of the limits that the active-set method cannot solve, with and without a second solver.

use crate::common;
use opspace_backend::{Capabilities, CommandKind, Measured};
use opspace_control::{
    Compensation, ControlContext, JointGains, JointPostureParameters, LimitParameters,
    OperationalSpaceController, QpError, TaskParameters, TaskSet,
};
use opspace_loop::{ControlLoop, Fault, LoopConfig, Run, RunOutcome, drive};
use opspace_sim::{ArmConfig, SimulatedArm};

/// Largest difference of positions under two solvers of the same programs, rad.
const SAME_RAD: f64 = 1e-4;

/// Time within which the first cycle ends, s.
const FIRST_CYCLES_S: f64 = 0.01;

/// Moves an arm with a controller that `change` has prepared, and solves the program of each cycle.
fn outcome(change: impl FnOnce(&mut OperationalSpaceController)) -> (RunOutcome, Vec<f64>) {
    let model = common::model();
    let capabilities = Capabilities::new(["shoulder", "elbow"], CommandKind::Torque, 1e-3)
        .measuring(&[Measured::MotorCurrent])
        .simulated();
    let context = ControlContext::new(&model, capabilities.period_s);
    let mut posture = JointPostureParameters::new(JointGains::new(10.0, 1.0).expect("good gains"));
    posture.posture_rad = [("shoulder".to_owned(), 0.5)].into_iter().collect();
    let tasks = TaskSet::builder(&model, &context)
        .from_parameters("rest", &TaskParameters::JointPosture(posture))
        .expect("a good task")
        .build();
    let limits = LimitParameters::default();
    let mut controller =
        OperationalSpaceController::from_tasks(&model, tasks, &context, Compensation::Bias, &limits);
    controller.always_solve();
    change(&mut controller);
    let config = ArmConfig::ideal(model.clone(), capabilities.clone(), Vec::new()).expect("a period");
    let mut arm = SimulatedArm::new(ArmConfig { start: vec![0.2, -0.5], ..config }).expect("an arm");
    let control = ControlLoop::new(LoopConfig::new(model, capabilities, Box::new(controller)));
    let mut rows = ();
    let mut run = Run::new(control.expect("parts that fit"), 0.5, &mut rows);
    drive(&mut arm, &mut run);
    (run.finish(), arm.true_q().as_slice().to_vec())
}

/// Compared: the motion under the second solver, and under the active-set method. Both solve the same programs.
#[test]
fn second_solver_replaces_the_first() {
    let (plain, expected) = outcome(|_| {});
    let (replaced, q) = outcome(|controller| controller.fail_active_sets(true));
    assert_eq!((plain, replaced), (RunOutcome::Completed, RunOutcome::Completed));
    assert!((expected[0] - 0.2).abs() > 0.1, "the arm moves: {expected:?}");
    for (is, expected) in q.iter().zip(&expected) {
        assert!((is - expected).abs() < SAME_RAD, "{is} and {expected} rad");
    }
}

/// Without a second solver, a program that the first one cannot solve stops the robot, with the name of the remedy.
#[test]
fn unsolved_limits_fault_without_a_second_solver() {
    let (outcome, _) = outcome(|controller| controller.fail_active_sets(false));
    let RunOutcome::Faulted { fault, time_s } = outcome else { panic!("{outcome:?}") };
    assert_eq!(fault, Fault::UnsolvedLimits { error: QpError::Iterations });
    assert!(time_s < FIRST_CYCLES_S, "stopped in the first cycle: {time_s} s");
    assert!(fault.to_string().contains("feature `clarabel`"), "{fault}");
}
