//! Robots that are read without being commanded.

use crate::backend::Backend;

/// Robot that is read while a person moves it, with what its devices report beside the sample.
pub trait Observed: Backend {
    /// Returns the last position of a joint as its device reports it, for example `2048 counts`.
    fn raw(&self, _joint: usize) -> Option<String> {
        None
    }

    /// Returns the state of the devices, for example their supply voltage, temperature and torque.
    fn state(&self) -> Option<String> {
        None
    }
}

/// Treatment of the torques of a robot that is to be observed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObservedTorque {
    /// They stay as they are: a robot that is held stays held.
    AsFound,
    /// A robot that is held is lowered, and then let go of.
    Released,
}
