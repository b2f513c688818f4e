//! Tests of a simulation's rows: each servo row has the desired torques of the command in effect.

use crate::common::{self, REST, Scripted, at_rest, capabilities, columns, config, gravity_controller};
use opspace_backend::{
    Backend, Capabilities, Command, CommandKind, DeviceFault, GroundTruth, Layout, SERVO, Sample, Signal,
    Sink, TICK, TIMING, TRUTH, TruthLayouts, TruthRow,
};
use opspace_loop::{ControlLoop, Run, drive};

/// Simulated robot that counts the commands written to it.
struct Simulated<B> {
    robot: B,
    commands: u64,
    in_force: Option<u64>,
    time_s: f64,
}

impl<B: Backend> Backend for Simulated<B> {
    fn capabilities(&self) -> &Capabilities {
        self.robot.capabilities()
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        self.robot.read(sample)?;
        self.time_s = sample.time_s;
        Ok(())
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        self.robot.write(command)?;
        self.commands += 1;
        self.in_force = Some(self.commands);
        Ok(())
    }

    fn stop(&mut self) {
        self.robot.stop();
        self.in_force = None;
    }

    fn ground_truth(&self) -> Option<&dyn GroundTruth> {
        Some(self)
    }
}

impl<B> GroundTruth for Simulated<B> {
    fn layouts(&self) -> TruthLayouts {
        let layout = |channel: &str| Layout {
            channel: channel.to_owned(),
            signals: vec![Signal::scalar("commands", "1")],
        };
        TruthLayouts::new(layout("truth"), layout("servo"))
    }

    fn visit(&self, visit: &mut dyn FnMut(TruthRow<'_>)) {
        let (time_s, row) = (self.time_s, &[self.commands as f64][..]);
        visit(TruthRow::State { time_s, row });
        visit(TruthRow::Servo { time_s, command: self.in_force, row });
    }
}

/// Sink that keeps the rows of all channels in their order.
#[derive(Default)]
struct All(Vec<(usize, Vec<f64>)>);

impl Sink for All {
    fn row(&mut self, channel: usize, _time_s: f64, row: &[f64]) {
        self.0.push((channel, row.to_vec()));
    }
}

/// Compared: the desired torques in a servo row, and those in the row of the cycle in which its command was written;
/// NaN at rest, during a hold and after the stop.
#[test]
fn servo_rows_have_torques_of_their_command() {
    for kind in common::KINDS {
        let script = |cycle: u64, sample: &mut Sample| {
            at_rest(cycle, sample);
            sample.time_s += if cycle >= 60 { 20.0 * common::PERIOD_S } else { 0.0 };
            sample.q[0] = if cycle == 150 { f64::NAN } else { sample.q[0] };
        };
        let robot = Scripted::new(capabilities(kind), script);
        let mut robot = Simulated { robot, commands: 0, in_force: None, time_s: 0.0 };
        let control =
            ControlLoop::new(config(capabilities(kind), gravity_controller(3.0))).expect("parts that fit");
        let layouts = Run::layouts(&control, robot.ground_truth().map(GroundTruth::layouts));
        assert_eq!(layouts[SERVO].signals[0].name, "torque_desired");
        let torque = columns(&layouts[TICK], "torque_desired");
        let mut all = All::default();
        let mut run = Run::new(control, 0.5, &mut all);
        drive(&mut robot, &mut run);
        drop(run);
        let channel = |channel| all.0.iter().filter(move |row| row.0 == channel).map(|row| &row.1[..]);
        let cycles: Vec<&[f64]> = channel(TICK).collect();
        let servos: Vec<&[f64]> = channel(SERVO).collect();
        assert_eq!((servos.len(), channel(TRUTH).count()), (cycles.len(), cycles.len()));
        let mut commanded = 0;
        for (cycle, servo) in servos.iter().enumerate().skip(1) {
            let stopped = cycle > 150;
            let expected = if stopped { &[f64::NAN; 2][..] } else { &cycles[cycle - 1][torque.clone()] };
            let bits = |values: &[f64]| values.iter().map(|v| v.to_bits()).collect::<Vec<u64>>();
            assert_eq!(bits(&servo[..2]), bits(expected), "{kind:?}, cycle {cycle}");
            commanded += usize::from(expected[0].is_finite());
        }
        // Before the dropout, and from the end of the hold to the fault.
        assert_eq!(commanded, (60 - REST as usize) + (150 - 110), "{kind:?}");
    }
}

/// Checks the order of the first rows: the true state precedes the row of its cycle.
#[test]
fn true_state_row_precedes_its_cycle_row() {
    let kind = CommandKind::Torque;
    let robot = Scripted::new(capabilities(kind), at_rest);
    let mut robot = Simulated { robot, commands: 0, in_force: None, time_s: 0.0 };
    let control =
        ControlLoop::new(config(capabilities(kind), gravity_controller(0.0))).expect("parts that fit");
    let mut all = All::default();
    let mut run = Run::new(control, 0.01, &mut all);
    drive(&mut robot, &mut run);
    drop(run);
    let channels: Vec<usize> = all.0.iter().take(8).map(|row| row.0).collect();
    assert_eq!(channels, [TRUTH, SERVO, TICK, TIMING, TRUTH, SERVO, TICK, TIMING]);
}
