//! Faults of a robot behind topics, each with its code, name and text.

use opspace_backend::DeviceFault;

/// Fault of a robot behind topics.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum RosFault {
    /// A command of another kind, or one that is not finite.
    WrongCommand,
    /// No states arrive.
    StatesSilent,
    /// The publisher of the states has left.
    DriverGone,
    /// A state with wrong lengths, without stamps, or with numbers that are not finite.
    StateMalformed,
    /// States lack joints: they are renamed, or another controller publishes them.
    JointsMissing,
    /// The clock of the states jumped.
    ClockJumped,
    /// The states come from another publisher than before: the driver was restarted.
    DriverRestarted,
    /// Two publishers send states of the same joints.
    SecondStatePublisher,
    /// Another program publishes commands.
    SecondCommander,
    /// Nothing subscribes to the commands.
    ControllerGone,
    /// The states do not follow the commands.
    NotFollowing,
    /// A force sensor is silent.
    WrenchSilent,
    /// A force sensor sends wrenches in another frame, or numbers that are not finite.
    WrenchMalformed,
    /// The client of DDS failed.
    ClientFailed,
}

impl RosFault {
    /// All faults.
    pub const ALL: [Self; 14] = [
        Self::WrongCommand,
        Self::StatesSilent,
        Self::DriverGone,
        Self::StateMalformed,
        Self::JointsMissing,
        Self::ClockJumped,
        Self::DriverRestarted,
        Self::SecondStatePublisher,
        Self::SecondCommander,
        Self::ControllerGone,
        Self::NotFollowing,
        Self::WrenchSilent,
        Self::WrenchMalformed,
        Self::ClientFailed,
    ];

    /// Code of the [`DeviceFault`].
    #[must_use]
    pub const fn code(self) -> u32 {
        match self {
            Self::WrongCommand => 1,
            Self::StatesSilent => 10,
            Self::DriverGone => 11,
            Self::StateMalformed => 12,
            Self::JointsMissing => 13,
            Self::ClockJumped => 14,
            Self::DriverRestarted => 15,
            Self::SecondStatePublisher => 16,
            Self::SecondCommander => 20,
            Self::ControllerGone => 21,
            Self::NotFollowing => 22,
            Self::WrenchSilent => 30,
            Self::WrenchMalformed => 31,
            Self::ClientFailed => 40,
        }
    }

    /// Name in files and tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::WrongCommand => "wrong-command",
            Self::StatesSilent => "states-silent",
            Self::DriverGone => "driver-gone",
            Self::StateMalformed => "state-malformed",
            Self::JointsMissing => "joints-missing",
            Self::ClockJumped => "clock-jumped",
            Self::DriverRestarted => "driver-restarted",
            Self::SecondStatePublisher => "second-state-publisher",
            Self::SecondCommander => "second-commander",
            Self::ControllerGone => "controller-gone",
            Self::NotFollowing => "not-following",
            Self::WrenchSilent => "wrench-silent",
            Self::WrenchMalformed => "wrench-malformed",
            Self::ClientFailed => "client-failed",
        }
    }

    /// Text without a full stop.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::WrongCommand => "the controller accepts only finite commands of its kind",
            Self::StatesSilent => "no joint states arrive",
            Self::DriverGone => "the publisher of the joint states has left: its driver ended",
            Self::StateMalformed => "a joint state has wrong lengths or numbers that are not finite",
            Self::JointsMissing => "joint states lack joints of the robot",
            Self::ClockJumped => "the clock of the joint states jumped",
            Self::DriverRestarted => "the joint states come from another publisher: the driver was restarted",
            Self::SecondStatePublisher => "two publishers send states of the same joints",
            Self::SecondCommander => "another program publishes commands for the controller",
            Self::ControllerGone => {
                "nothing subscribes to the commands: the controller was unloaded or ended"
            }
            Self::NotFollowing => "the robot does not follow the commands: its controller may be inactive",
            Self::WrenchSilent => "no wrenches of a force sensor arrive",
            Self::WrenchMalformed => "a wrench is in another frame, or is not finite",
            Self::ClientFailed => "the DDS client failed",
        }
    }

    /// Fault of the device, with details if there are any. It begins with the name of the fault.
    #[must_use]
    pub fn device_fault(self, details: &str) -> DeviceFault {
        let colon = if details.is_empty() { "" } else { ": " };
        DeviceFault::new(self.code(), format!("{}: {}{colon}{details}", self.name(), self.text()))
    }
}
