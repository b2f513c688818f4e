//! Comparison of a robot's declared capabilities with robot.toml.

use crate::files::source::FileError;
use crate::run::experiment::Experiment;
use opspace_backend::{Capabilities, ForceSensor};
use std::fmt::Debug;

/// Largest relative difference between two periods that are considered equal.
const SAME_PERIOD: f64 = 1e-9;

impl Experiment {
    /// Checks the capabilities that a robot reports against robot.toml.
    ///
    /// # Errors
    /// The first mismatch, with both values, at its key in robot.toml.
    pub fn compare_capabilities(&self, declared: &Capabilities) -> Result<(), FileError> {
        let stated = self.capabilities();
        self.same("joint", "joints", &stated.joints, &declared.joints)?;
        self.same("interface.command", "commands", &stated.command.name(), &declared.command.name())?;
        // False for NaN.
        let is_same = (stated.period_s - declared.period_s).abs() <= SAME_PERIOD * stated.period_s;
        if !is_same {
            let periods = [stated.period_s, declared.period_s];
            return Err(self.contradiction(
                "profile",
                "interface period in seconds",
                &periods[0],
                &periods[1],
            ));
        }
        self.same("interface.setpoints", "setpoints", &stated.setpoints, &declared.setpoints)?;
        let gravity = |c: &Capabilities| c.gravity_compensated_by;
        self.same(
            "interface.gravity_compensated_by",
            "gravity compensation",
            &gravity(&stated),
            &gravity(declared),
        )?;
        let missed = |c: &Capabilities| c.on_missed_cycle;
        self.same(
            "interface.on_missed_cycle",
            "behaviour on a missed cycle",
            &missed(&stated),
            &missed(declared),
        )?;
        self.same("interface.on_stop", "way to stop", &stated.on_stop, &declared.on_stop)?;
        self.same("interface.brakes", "brakes", &stated.has_brakes, &declared.has_brakes)?;
        self.same("interface.measured", "measured quantities", &measured(&stated), &measured(declared))?;
        let sensors = |c: &Capabilities| -> Vec<ForceSensor> { c.force_sensors.clone() };
        self.same("force_sensor", "force sensors", &sensors(&stated), &sensors(declared))
    }

    fn same<T: PartialEq + Debug>(
        &self,
        key: &str,
        what: &str,
        stated: &T,
        declared: &T,
    ) -> Result<(), FileError> {
        if stated == declared { Ok(()) } else { Err(self.contradiction(key, what, stated, declared)) }
    }

    fn contradiction(&self, key: &str, what: &str, stated: &dyn Debug, declared: &dyn Debug) -> FileError {
        let message = format!("{what}: robot.toml states {stated:?}, the robot declares {declared:?}");
        let help = Some("correct robot.toml or the driver".to_owned());
        FileError::at_key(&self.robot().source, key, message, help)
    }
}

/// Names of the measured quantities except positions.
fn measured(capabilities: &Capabilities) -> Vec<&'static str> {
    let quantities = [
        ("velocity", capabilities.measures_velocity),
        ("motor-current", capabilities.measures_motor_torque),
        ("joint-torque", capabilities.measures_joint_torque),
    ];
    quantities.into_iter().filter(|(_, measured)| *measured).map(|(name, _)| name).collect()
}
