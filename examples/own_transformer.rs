//! User-defined transformer: the paper's formula at the position that is predicted for the time when the setpoint acts.
//!
//! `cargo run --release -p opspace --example own_transformer` writes to `runs/own_transformer`.

#![expect(clippy::print_stdout, reason = "an example shows what it did")]

#[path = "common/mod.rs"]
mod common;

use opspace::experiment::{
    Experiment, Extensions, Files, Progress, RunOptions, TransformerEntry, TransformerTraits,
};
use opspace::model::Data;
use opspace::transformer::{ServoGains, Transformer};

/// Equation (K10) of the paper, q_desired = kp⁻¹ (kv⁻¹ τ + q̇) + q, with q + q̇ t in place of q: t is the time until the
/// setpoint acts, s.
struct Predicting {
    gains: Vec<ServoGains>,
    delay_s: f64,
}

impl Transformer for Predicting {
    fn transform(&mut self, data: &Data, torque: &[f64], q_desired: &mut [f64]) {
        for (joint, gains) in self.gains.iter().enumerate() {
            let (q, dq) = (data.q[joint], data.dq[joint]);
            let lead = (torque[joint] + gains.damping * dq) / gains.stiffness;
            q_desired[joint] = lead + q + dq * self.delay_s;
        }
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let needs_delay = TransformerTraits { needs_delay: true, ..TransformerTraits::default() };
    let description = "equation (K10) at the position that is predicted for the time when the setpoint acts";
    let predicting = TransformerEntry::new("predicting", description, |setup| {
        let (gains, timing) = (setup.servo_gains()?, setup.timing());
        Ok(Box::new(Predicting { gains, delay_s: f64::from(timing.delay) * timing.servo_period_s }))
    })
    .with_traits(needs_delay);
    let extensions = Extensions::default().with(predicting);
    let task = "tasks/cartesian-tracking.toml".as_ref();
    let options = RunOptions { transformer: Some("predicting".into()), ..RunOptions::default() };
    let experiment = Experiment::load_with(&extensions, Files::Embedded, task, None, options, &[])?;
    common::record("own_transformer", &experiment, |log| experiment.run(log, &Progress::default()))
}
