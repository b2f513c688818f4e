//! User-defined backend, run with a task file: an arm that accepts torques, here a model integrated by Euler's method.
//!
//! `cargo run --release -p opspace --example own_backend` writes log, summary and report to `runs/own_backend`.

#![expect(clippy::print_stdout, reason = "an example shows what it did")]

#[path = "common/mod.rs"]
mod common;

use opspace::backend::{Backend, Capabilities, Command, CommandKind, DeviceFault, Measured, Sample};
use opspace::experiment::{Experiment, Files, Progress, RunOptions};
use opspace::model::{Data, Model, aba, kinematics};

struct Arm {
    capabilities: Capabilities,
    model: Model,
    data: Data,
    time_s: f64,
    torque: Option<Vec<f64>>,
}

impl Backend for Arm {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        let period_s = self.capabilities.period_s;
        self.time_s += period_s;
        // Without a torque command the brakes hold the arm.
        if let Some(torque) = &self.torque {
            aba(&self.model, &mut self.data, torque);
            let dq = &self.data.dq + &self.data.ddq * period_s;
            let q = &self.data.q + &dq * period_s;
            kinematics(&self.model, &mut self.data, q.as_slice(), dq.as_slice());
        }
        sample.time_s = self.time_s;
        sample.q.copy_from_slice(self.data.q.as_slice());
        sample.motor_torque.as_mut().expect("declared").iter_mut().for_each(|torque| *torque = 0.0);
        Ok(())
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        match command {
            Command::Torque(torque) => self.torque = Some(torque.to_vec()),
            Command::Hold => self.torque = None,
            _ => return Err(DeviceFault::new(1, "this arm accepts only joint torques")),
        }
        Ok(())
    }

    fn stop(&mut self) {
        self.torque = None;
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let options = RunOptions { backend: CommandKind::Torque, ..RunOptions::default() };
    let task = "tasks/planar-2-link-reach.toml".as_ref();
    let experiment = Experiment::load(Files::Disk, task, None, options, &[])?;
    let capabilities = Capabilities::new(["shoulder", "elbow"], CommandKind::Torque, 1e-3);
    let (model, capabilities) =
        (experiment.robot().model.clone(), capabilities.measuring(&[Measured::MotorCurrent]));
    let mut data = Data::new(&model);
    kinematics(&model, &mut data, &[0.6, 1.2], &[0.0, 0.0]);
    let mut arm = Arm { capabilities, model, data, time_s: 1000.0, torque: None };
    common::record("own_backend", &experiment, |log| experiment.run_on(&mut arm, log, &Progress::default()))
}
