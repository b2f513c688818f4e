//! Tasks built in code: the same torques as from a file, and a user-defined task together with built-in ones.

use crate::common::{self, File, at_state, control_context, sampled, seven_joints};
use nalgebra::{Matrix6xX, Vector6};
use opspace_control::{
    Axes, AxisGains, AxisMode, CartesianParameters, CartesianTask, Compensation, ControlContext,
    ControlInput, Controller, JointDampingParameters, JointGains, JointPostureParameters, LimitParameters,
    OperationalSpaceController, Reason, Task, TaskInput, TaskParameters, TaskSet,
};
use opspace_model::{Data, Model, aba, update};

const Q: [f64; 7] = [0.3, -0.5, 0.2, -1.4, 0.4, 1.1, -0.2];

const FROM_FILE: &str = r#"
priority = ["hand", "rest"]
[task.hand.cartesian]
frame = "hand"
axes = { x = "motion", y = "motion", z = "motion" }
reference = "hold"
gains = { frequency_rad_per_s = 14.0, damping_ratio = 0.9 }
[task.rest.joint-posture]
frequency_rad_per_s = 6.0
damping_ratio = 0.8
"#;

fn hand() -> CartesianParameters {
    let gains = AxisGains::new(14.0, 0.9).expect("good gains");
    CartesianParameters::new("hand", Axes::position(AxisMode::Motion), gains)
}

/// Returns the torques at a few states along a motion.
fn torques(model: &Model, mut controller: OperationalSpaceController) -> Vec<f64> {
    let (data, measurement) = at_state(model, &Q, &[0.0; 7], 0.0);
    controller.start(&common::input(model, &data, &measurement));
    let mut torques = Vec::new();
    for step in 1..20 {
        let time_s = f64::from(step) * 1e-3;
        let q: Vec<f64> = Q.iter().map(|q| q + 0.1 * time_s).collect();
        let (data, measurement) = at_state(model, &q, &[0.1; 7], time_s);
        let mut torque = [0.0; 7];
        controller.update(&common::input(model, &data, &measurement), &mut torque);
        torques.extend(torque);
    }
    torques
}

/// Compared: torques of tasks built in code with those of the same tasks from a file, bit for bit.
#[test]
fn tasks_in_code_equal_tasks_from_file() {
    let model = seven_joints();
    let context = control_context(&model, "hand");
    let file = File::read(FROM_FILE);
    let of_file = OperationalSpaceController::new(&model, &file.task_set(), &context).expect("a good file");
    let rest = JointPostureParameters::new(JointGains::new(6.0, 0.8).expect("good gains"));
    let tasks = TaskSet::builder(&model, &context)
        .from_parameters("hand", &TaskParameters::Cartesian(Box::new(hand())))
        .and_then(|tasks| tasks.from_parameters("rest", &TaskParameters::JointPosture(rest)))
        .expect("good tasks")
        .build();
    let in_code = controller(&model, tasks, &context);
    assert_eq!(torques(&model, in_code), torques(&model, of_file));
}

fn controller(model: &Model, tasks: TaskSet, context: &ControlContext) -> OperationalSpaceController {
    let limits = LimitParameters::default();
    OperationalSpaceController::from_tasks(model, tasks, context, Compensation::Bias, &limits)
}

/// A user-defined task that controls the sum of two joint positions to a value.
struct JointSum {
    value: f64,
    error: f64,
    rate: f64,
}

const SUMMED: [usize; 2] = [1, 3];

impl JointSum {
    fn at(data: &Data) -> f64 {
        SUMMED.map(|joint| data.q[joint]).iter().sum()
    }
}

impl Task for JointSum {
    fn name(&self) -> &str {
        "sum"
    }

    fn rows(&self) -> usize {
        1
    }

    fn jacobian(&self, _model: &Model, _data: &Data, rows: &mut Matrix6xX<f64>) {
        rows.fill(0.0);
        SUMMED.iter().for_each(|&joint| rows[(0, joint)] = 1.0);
    }

    fn update(&mut self, input: &TaskInput<'_>) {
        let data = input.control.data;
        self.error = self.value - Self::at(data);
        self.rate = SUMMED.map(|joint| data.dq[joint]).iter().sum();
    }

    fn bias(&self, _model: &Model, _data: &Data) -> Vector6<f64> {
        Vector6::zeros()
    }

    fn kinematic_target(&self, _model: &Model, data: &Data, gain_per_s: f64) -> Vector6<f64> {
        Vector6::x() * gain_per_s * (self.value - Self::at(data))
    }

    fn acceleration(&self) -> Vector6<f64> {
        Vector6::x() * (100.0 * self.error - 20.0 * self.rate)
    }
}

/// Compared: the sum of two joint positions after two seconds with its reference; and the final with the initial
/// position of the hand, which has higher priority, by forward kinematics.
#[test]
fn user_task_runs_below_built_in_task() {
    const SETTLED: f64 = 1e-4;
    let model = seven_joints();
    let context = control_context(&model, "hand");
    let (value, hand_task) = (-1.7, CartesianTask::new("hand", &hand(), &model, &context));
    let damping = JointDampingParameters::new(5.0).expect("good damping");
    let tasks = TaskSet::builder(&model, &context)
        .task(Box::new(hand_task.expect("a good task")))
        .and_then(|tasks| tasks.task(Box::new(JointSum { value, error: 0.0, rate: 0.0 })))
        .and_then(|tasks| tasks.from_parameters("rest", &TaskParameters::JointDamping(damping)))
        .expect("good tasks")
        .build();
    let mut controller = controller(&model, tasks, &context);
    let (mut data, mut measurement) = at_state(&model, &Q, &[0.0; 7], 0.0);
    let frame = model.frame_id("hand").expect("a frame");
    let begin = opspace_model::frame_placement(&model, &data, frame).translation;
    controller.start(&common::input(&model, &data, &measurement));
    let mut torque = [0.0; 7];
    for cycle in 0..2000 {
        measurement.time_s = f64::from(cycle) * 1e-3;
        assert!(update(&model, &mut data, measurement.q.as_slice(), measurement.dq.as_slice()));
        controller.update(&common::input(&model, &data, &measurement), &mut torque);
        aba(&model, &mut data, &torque);
        measurement.dq += &data.ddq * 1e-3;
        measurement.q += &measurement.dq * 1e-3;
    }
    let sum: f64 = SUMMED.map(|joint| measurement.q[joint]).iter().sum();
    assert!((sum - value).abs() < SETTLED, "{sum}");
    let moved = opspace_model::frame_placement(&model, &data, frame).translation - begin;
    assert!(moved.norm() < SETTLED, "{moved}");
    assert_eq!(sampled(&controller, "sum.force").len(), 1, "its force is in the log");
}

/// A repeated name, a task below a task of all joints, and a frequency of zero are rejected. The task trait is
/// object-safe.
#[test]
fn names_and_priority_are_checked() {
    let model = seven_joints();
    let context = control_context(&model, "hand");
    let sum = || Box::new(JointSum { value: 0.0, error: 0.0, rate: 0.0 });
    let one = TaskSet::builder(&model, &context).task(sum()).expect("one is good");
    let error = one.task(sum()).err().expect("the name is taken");
    assert_eq!(error.reason(), &Reason::Repeated { name: "sum".to_owned() });
    let damping = TaskParameters::JointDamping(JointDampingParameters::new(1.0).expect("good damping"));
    let last = TaskSet::builder(&model, &context).from_parameters("rest", &damping).expect("good");
    let error = last.task(sum()).err().expect("nothing comes below");
    assert!(matches!(error.reason(), Reason::NotLast { .. }), "{error}");
    assert!(AxisGains::new(0.0, 1.0).is_err(), "a frequency of zero");
    let _: fn(&mut dyn Task, &ControlInput<'_>) = |task, input| task.start(input);
}
