//! The trait of everything that commands a robot.

use crate::measurement::Measurement;
use opspace_backend::{CommandKind, Observable};
use opspace_model::{Data, Model};

/// Measurements in, commands out. Never knows which robot it drives.
pub trait Controller: Observable + Send {
    /// What [`update`](Self::update) writes.
    fn command_kind(&self) -> CommandKind;

    /// Takes the robot's present state as the start: references begin here. `data` is up to date with
    /// `measurement`. May allocate.
    fn start(&mut self, model: &Model, data: &Data, measurement: &Measurement);

    /// The command of this tick, into `command` (n). `data` is up to date with `measurement`
    /// ([`opspace_model::update`]). Allocates, locks, logs and formats nothing.
    fn update(&mut self, model: &Model, data: &Data, measurement: &Measurement, command: &mut [f64]);

    /// Takes in a tick at which it commands nothing, since the robot is held. Allocates nothing.
    fn look_on(&mut self, _model: &Model, _data: &Data, _measurement: &Measurement) {}

    /// Goes on after the robot was held, at rest where it is now: without a jump, and back to its tasks. It begins anew
    /// unless it knows better. Allocates nothing in a controller that does.
    fn resume(&mut self, model: &Model, data: &Data, measurement: &Measurement) {
        self.start(model, data, measurement);
    }
}
