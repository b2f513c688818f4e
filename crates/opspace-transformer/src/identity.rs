//! Transformer of a torque robot.

use crate::transformer::Transformer;
use opspace_backend::CommandKind;
use opspace_model::Data;

/// Transformer that returns the torques unchanged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Identity;

impl Transformer for Identity {
    fn takes(&self) -> CommandKind {
        CommandKind::Torque
    }

    fn transform(&mut self, _data: &Data, torque: &[f64], command: &mut [f64]) {
        command.copy_from_slice(torque);
    }
}
