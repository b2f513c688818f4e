//! Cost of a control cycle and of its parts: `cargo bench`.

use divan::{Bencher, black_box};
use nalgebra::Matrix6xX;
use opspace::backend::quantity::Positive;
use opspace::backend::{Capabilities, CommandKind, GravityCompensation, Measured, Sample, Setpoints};
use opspace::control::{ControlInput, Measurement, Targets};
use opspace::control_loop::Run;
use opspace::experiment::{Experiment, Files, RunOptions};
use opspace::log::{Channel, Header, Pace, record};
use opspace::model::{
    Data, Model, OperationalSpace, aba, bias, crba, frame_jacobian, gravity, kinematics, rnea, update,
};
use opspace::transformer::{
    CascadedServo, DriveTiming, EstimatorParameters, ExtrapolatingTransformer, ExtrapolationSetup,
    GainAdaptationParameters, Gears, PaperTransformer, RemainingDamping, ServoParameters, Transformer,
};
use opspace_testing::oracle::urdf;
use std::cell::RefCell;
use std::path::Path;

fn main() {
    divan::main();
}

const ROBOTS: [&str; 3] = ["double_pendulum", "panda_arm7", "g1_29dof"];

/// A robot in motion, away from zeros, and the frame furthest from its base.
fn robot(name: &str) -> (Model, Data, Vec<f64>, Vec<f64>) {
    let model = Model::from_urdf(&urdf(name)).expect("it is a good one").model;
    let q: Vec<f64> = (0..model.n()).map(|i| 0.3 + 0.1 * i as f64).collect();
    let dq: Vec<f64> = (0..model.n()).map(|i| 0.5 - 0.07 * i as f64).collect();
    let mut data = Data::new(&model);
    assert!(update(&model, &mut data, &q, &dq));
    (model, data, q, dq)
}

#[divan::bench(args = ROBOTS)]
fn forward_kinematics(bencher: Bencher, name: &str) {
    let (model, mut data, q, dq) = robot(name);
    bencher.bench_local(|| kinematics(&model, &mut data, black_box(&q), &dq));
}

#[divan::bench(args = ROBOTS)]
fn jacobian(bencher: Bencher, name: &str) {
    let (model, data, ..) = robot(name);
    let tip = model.frames().last().map(|f| f.name.clone()).expect("has a frame");
    let tip = model.frame_id(&tip).expect("just listed");
    let mut out = Matrix6xX::zeros(model.n());
    bencher.bench_local(|| frame_jacobian(&model, black_box(&data), tip, &mut out));
}

#[divan::bench(args = ROBOTS)]
fn mass_matrix_crba(bencher: Bencher, name: &str) {
    let (model, mut data, ..) = robot(name);
    bencher.bench_local(|| crba(&model, black_box(&mut data)));
}

#[divan::bench(args = ROBOTS)]
fn inverse_dynamics_rnea(bencher: Bencher, name: &str) {
    let (model, mut data, _, ddq) = robot(name);
    bencher.bench_local(|| rnea(&model, &mut data, black_box(&ddq)));
}

#[divan::bench(args = ROBOTS)]
fn bias_torque(bencher: Bencher, name: &str) {
    let (model, mut data, ..) = robot(name);
    bencher.bench_local(|| bias(&model, black_box(&mut data)));
}

#[divan::bench(args = ROBOTS)]
fn gravity_torque(bencher: Bencher, name: &str) {
    let (model, mut data, ..) = robot(name);
    bencher.bench_local(|| gravity(&model, black_box(&mut data)));
}

#[divan::bench(args = ROBOTS)]
fn forward_dynamics_aba(bencher: Bencher, name: &str) {
    let (model, mut data, _, tau) = robot(name);
    bencher.bench_local(|| aba(&model, &mut data, black_box(&tau)));
}

#[divan::bench(args = ROBOTS)]
fn whole_model_update(bencher: Bencher, name: &str) {
    let (model, mut data, q, dq) = robot(name);
    bencher.bench_local(|| update(&model, &mut data, black_box(&q), &dq));
}

#[divan::bench(args = ["panda_arm7", "g1_29dof"])]
fn operational_space(bencher: Bencher, name: &str) {
    let (model, data, ..) = robot(name);
    let tip = model.frames().last().map(|f| f.name.clone()).expect("has a frame");
    let tip = model.frame_id(&tip).expect("just listed");
    let mut jacobian = Matrix6xX::zeros(model.n());
    frame_jacobian(&model, &data, tip, &mut jacobian);
    let mut space = OperationalSpace::new(model.n());
    bencher.bench_local(|| space.update(black_box(&data.mass_matrix_factor), &jacobian, 6, 1e-3));
}

/// The paper's tasks on the four-joint arm: controller and transformer, after the model's update.
#[divan::bench(args = ["cartesian-tracking", "compliant-x", "gravity-compensation", "joint-tracking"])]
fn controller_and_transformer(bencher: Bencher, task: &str) {
    let path = format!("tasks/{task}.toml");
    let experiment = Experiment::load(Files::Embedded, Path::new(&path), None, RunOptions::default(), &[])
        .expect("is embedded");
    let model = &experiment.robot().model;
    let mut data = Data::new(model);
    let mut measurement = Measurement::new(model.n(), experiment.robot().sensors.len(), true);
    measurement.q.copy_from_slice(&[-0.45, -0.35, 0.25, -1.35]);
    assert!(update(model, &mut data, measurement.q.as_slice(), measurement.dq.as_slice()));
    let mut controller = experiment.controller().expect("was checked");
    let (targets, feedforward) = (Targets::none(), vec![0.0; model.n()]);
    controller.start(&ControlInput::new(model, &data, &measurement, &feedforward, &targets));
    let profile = experiment.profile().1;
    let servos = experiment.robot().servos(profile);
    let gains = servos.iter().map(|servo| servo.gains(profile.servo_period_s())).collect();
    let mut transformer = PaperTransformer::new(gains);
    let mut tau = vec![0.0; model.n()];
    let mut q_desired = vec![0.0; model.n()];
    bencher.bench_local(|| {
        measurement.time_s += 1e-3;
        let input = ControlInput::new(model, &data, black_box(&measurement), &feedforward, &targets);
        controller.update(&input, &mut tau);
        transformer.transform(&data, &tau, &mut q_desired);
    });
}

/// One cycle of a transformer for seven joints, whose servos run five times per cycle: sample, conversion and setpoint. With
/// current, gains are estimated and recalculated in each cycle.
#[divan::bench(args = ["paper", "extrapolation", "extrapolation+current"])]
fn transformer_of_seven_joints(bencher: Bencher, name: &str) {
    let (_, data, ..) = robot("panda_arm7");
    let n = data.q.len();
    let [kp, kv, filter_hz] =
        [50.0, 30.0, 600.0].map(|value| Positive::try_from(value).expect("is positive"));
    let servo = ServoParameters::Cascaded(CascadedServo::new(kp, kv, filter_hz));
    let period_s = 2e-4;
    let mut transformer: Box<dyn Transformer> = match name {
        "paper" => Box::new(PaperTransformer::new(vec![servo.gains(period_s); n])),
        _ => Box::new(
            ExtrapolatingTransformer::new(&ExtrapolationSetup {
                servos: vec![servo; n],
                torque_limits: vec![80.0; n],
                remaining_damping: vec![RemainingDamping::default(); n],
                timing: DriveTiming {
                    servo_period_s: period_s,
                    servo_ticks_per_cycle: 5,
                    delay: 1,
                    setpoints: Setpoints::Held,
                },
                estimator: EstimatorParameters::default(),
                gravity_compensated_by: GravityCompensation::Controller,
                has_brakes: false,
                gears: Gears::Elastic,
                antiresonance_hz: None,
                setpoint_noise: Vec::new(),
                current: name.ends_with("+current").then(GainAdaptationParameters::usual),
            })
            .expect("can be inverted"),
        ),
    };
    let names: Vec<String> = (0..n).map(|i| format!("joint{i}")).collect();
    let capabilities =
        Capabilities::new(names, CommandKind::Position, 1e-3).measuring(&[Measured::MotorCurrent]);
    let mut sample = Sample::new(&capabilities);
    let (torque, mut setpoint) = (vec![3.0; n], vec![0.0; n]);
    let mut time_s = 0.0;
    bencher.bench_local(|| {
        time_s += 1e-3;
        for (i, q) in sample.q.iter_mut().enumerate() {
            *q = 0.3 * f64::sin(time_s + i as f64);
        }
        transformer.observe(black_box(&sample));
        transformer.set_reference_motion(&torque, &torque);
        transformer.transform(&data, &torque, &mut setpoint);
        transformer.sent(&data, &setpoint);
    });
}

/// Recording of the rows of a control cycle, those that a real robot has: what a log costs the control thread. The writer
/// runs on another core, and is waited for outside the measured time.
#[divan::bench(args = ["cartesian-tracking", "compliant-x"], sample_size = 100)]
fn record_a_cycle(bencher: Bencher, task: &str) {
    let path = format!("tasks/{task}.toml");
    let experiment = Experiment::load(Files::Embedded, Path::new(&path), None, RunOptions::default(), &[])
        .expect("is embedded");
    let layouts = Run::layouts(&experiment.control_loop().expect("was checked"), None);
    let rows: Vec<Vec<f64>> =
        layouts.iter().map(|layout| (0..layout.width()).map(|k| (k as f64).sin()).collect()).collect();
    let channels = layouts.into_iter().map(|layout| Channel { layout, rate_hz: 1000.0 }).collect();
    let (recorder, writer) =
        record(std::io::sink(), Header::default(), channels, Pace::Simulated).expect("a log");
    let recorder = RefCell::new(recorder);
    bencher.with_inputs(|| recorder.borrow_mut().wait_for_space()).bench_local_values(|()| {
        for (channel, row) in rows.iter().enumerate() {
            recorder.borrow_mut().push(channel, 0.0, black_box(row));
        }
    });
    drop(recorder);
    let (written, _) = writer.finish().expect("the sink does not fail");
    assert_eq!(written.dropped, 0);
}
