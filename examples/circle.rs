//! The task of the README in code: the tip of a position-controlled arm follows a circle.
//!
//! `cargo run --release -p opspace --example circle` prints how far the tip is from the circle.

#![expect(clippy::print_stdout, reason = "an example shows what it did")]

use opspace::backend::quantity::NonNegative;
use opspace::backend::{CommandKind, Sink, TICK};
use opspace::control::{
    Axes, AxisGains, AxisMode, CartesianParameters, CartesianReference, CartesianTask, Compensation,
    ControlContext, LimitParameters, LinearWave, OperationalSpaceController, Sinusoid, TaskSet,
};
use opspace::control_loop::{ControlLoop, LoopConfig, Run, RunOutcome, drive};
use opspace::experiment::{Files, RobotDefinition};
use opspace::model::{Data, frame_placement, kinematics};
use opspace::sim::{ArmConfig, SimulatedArm};
use opspace::transformer::PaperTransformer;
use std::error::Error;
use std::f64::consts::FRAC_PI_2;
use std::ops::Range;

/// Radius of the circle, m.
const RADIUS_M: f64 = 0.1;
/// Cycles of 1 ms in which torque and reference ramp in.
const RAMP_ROWS: usize = 1500;

/// Sink that measures the distance of the tip from the circle.
struct Distance {
    /// Columns of the measured position of the tip in a row.
    position: Range<usize>,
    /// Centre of the circle in x and z, m.
    centre_m: [f64; 2],
    rows: usize,
    largest_m: f64,
}

impl Sink for Distance {
    fn row(&mut self, channel: usize, _time_s: f64, row: &[f64]) {
        if channel != TICK {
            return;
        }
        self.rows += 1;
        if self.rows > RAMP_ROWS {
            let position = &row[self.position.clone()];
            let radius_m = (position[0] - self.centre_m[0]).hypot(position[2] - self.centre_m[1]);
            self.largest_m = self.largest_m.max((radius_m - RADIUS_M).abs());
        }
    }
}

/// Runs the task, and fails if the tip is more than 10 mm from the circle.
///
/// # Errors
/// A robot folder that cannot be read, or a task that does not match the robot.
pub fn main() -> Result<(), Box<dyn Error>> {
    let robot = RobotDefinition::load(Files::Disk, "robots/planar-2-link".as_ref(), &[])?;
    let (_, profile) = robot.profile(None)?;
    let (model, servos) = (robot.model.clone(), robot.servos(profile));
    let servo_gains: Vec<_> = servos.iter().map(|servo| servo.gains(profile.servo_period_s())).collect();
    let capabilities = robot.capabilities(CommandKind::Position, profile.period_s()).simulated();
    // The circle begins at its top, where the tip is at the start.
    let start = [0.6, 1.2];
    let mut data = Data::new(&model);
    kinematics(&model, &mut data, &start, &[0.0; 2]);
    let top = frame_placement(&model, &data, model.frame_id("tip")?).translation;
    let context = ControlContext::new(&model, capabilities.period_s);
    let config = ArmConfig::ideal(model.clone(), capabilities.clone(), servos)?;
    let mut arm = SimulatedArm::new(ArmConfig { start: start.to_vec(), ..config })?;

    let (frequency_hz, limits) = (NonNegative::literal(0.5), LimitParameters::default());
    let wave = |phase_rad, offset_m| vec![LinearWave { amplitude_m: 0.1, frequency_hz, phase_rad, offset_m }];
    let circle = Sinusoid { x: wave(0.0, 0.0), z: wave(FRAC_PI_2, -0.1), ..Sinusoid::default() };
    let axes = Axes { x: AxisMode::Motion, z: AxisMode::Motion, ..Axes::default() };
    let tip = CartesianParameters::new("tip", axes, AxisGains::new(20.0, 1.0)?);
    let tip = tip.with_reference(CartesianReference::Sinusoid(circle));
    let tip = CartesianTask::new("tip", &tip, &model, &context)?;
    let tasks = TaskSet::builder(&model, &context).task(Box::new(tip))?.build();
    let osc = OperationalSpaceController::from_tasks(&model, tasks, &context, Compensation::Bias, &limits);
    let transformer = Box::new(PaperTransformer::new(servo_gains.clone()));
    let config = LoopConfig::new(model, capabilities, Box::new(osc));
    let control = ControlLoop::new(LoopConfig { transformer, servo_gains, ..config })?;

    let position = Run::layouts(&control, None)[TICK].columns("tip.position").ok_or("logged")?;
    let mut distance = Distance { position, centre_m: [top.x, top.z - RADIUS_M], rows: 0, largest_m: 0.0 };
    let mut run = Run::new(control, 6.0, &mut distance);
    drive(&mut arm, &mut run);

    let outcome = run.finish();
    println!("{outcome:?}: the tip is within {:.1} mm of the circle", 1e3 * distance.largest_m);
    assert!(outcome == RunOutcome::Completed && distance.rows > 6000 && distance.largest_m < 0.01);
    Ok(())
}
