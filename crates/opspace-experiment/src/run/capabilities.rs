//! Comparison of a robot's declared capabilities with robot.toml.

use crate::files::source::FileError;
use crate::run::experiment::Experiment;
use opspace_backend::quantity::Positive;
use opspace_backend::{Capabilities, DeviceLimits, ForceSensor};
use std::fmt::Debug;

/// Largest relative difference between two periods that are considered equal.
const SAME_PERIOD: f64 = 1e-9;

/// Largest relative excess of a limit that is considered equal.
const SAME_LIMIT: f64 = 1e-9;

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
        self.same("force_sensor", "force sensors", &sensors(&stated), &sensors(declared))?;
        self.compare_device_limits(&declared.joint_limits)
    }

    /// Checks that no limit of robot.toml or the URDF is above one that the device keeps by itself.
    fn compare_device_limits(&self, device: &[DeviceLimits]) -> Result<(), FileError> {
        let joints = self.robot().model.joints();
        if device.is_empty() {
            return Ok(());
        }
        self.same("joint", "number of joints with limits", &joints.len(), &device.len())?;
        let (own, setpoints) = (self.robot().joint_limits(), self.setpoint_limits());
        let of_joint = |joint: &str, key: &str| ["joint", joint, key].map(str::to_owned).to_vec();
        for (j, (joint, device)) in joints.iter().zip(device).enumerate() {
            let name = joint.name.as_str();
            let of_setpoints = |key: &str| {
                let table = ["profile", self.profile().0, "setpoint_limits", "joint", name, key];
                table.map(str::to_owned).to_vec()
            };
            let setpoint = setpoints.get(j).copied().unwrap_or_default();
            let given = |limit: Option<Positive>| limit.map_or(f64::INFINITY, Positive::get);
            let limits = [
                ("torque", of_joint(name, "torque_limit_nm"), own.torque[j], device.torque_nm),
                (
                    "speed",
                    of_joint(name, "velocity_limit_rad_per_s"),
                    own.velocity[j],
                    device.velocity_rad_per_s,
                ),
                (
                    "setpoint velocity",
                    of_setpoints("velocity_rad_per_s"),
                    given(setpoint.velocity_rad_per_s),
                    device.setpoint_velocity_rad_per_s,
                ),
                (
                    "setpoint acceleration",
                    of_setpoints("acceleration_rad_per_s2"),
                    given(setpoint.acceleration_rad_per_s2),
                    device.setpoint_acceleration_rad_per_s2,
                ),
                (
                    "setpoint jerk",
                    of_setpoints("jerk_rad_per_s3"),
                    given(setpoint.jerk_rad_per_s3),
                    device.setpoint_jerk_rad_per_s3,
                ),
            ];
            for (what, key, stated, reported) in limits {
                let Some(reported) = reported else { continue };
                // False for NaN.
                let is_within = reported > 0.0 && stated <= reported * (1.0 + SAME_LIMIT);
                if !is_within {
                    let own = self.statement(name, &key, stated);
                    return Err(self.above_device(what, name, &key, &own, reported));
                }
            }
        }
        Ok(())
    }

    /// Words about the file that states a limit of a joint, and the limit: those of torque and speed may be from the URDF.
    fn statement(&self, joint: &str, key: &[String], stated: f64) -> String {
        let robot = self.robot();
        let is_of_urdf = match key {
            [table, _, limit] if table == "joint" => stated.is_finite() && !robot.states(joint, limit),
            _ => false,
        };
        let file = if is_of_urdf { "the URDF" } else { "robot.toml" };
        let stated = if stated.is_finite() { stated.to_string() } else { "none".to_owned() };
        format!("{file} has {stated}")
    }

    fn above_device(&self, what: &str, joint: &str, key: &[String], own: &str, reported: f64) -> FileError {
        let message = format!("{what} limit of joint '{joint}': {own}, the robot itself keeps to {reported}");
        let Some((name, table)) = key.split_last() else {
            return FileError::of_file(self.robot().source.name(), message, None);
        };
        let table = table.join(".");
        let help = if reported > 0.0 {
            format!("write {name} = {reported:?} in [{table}]; the robot would stop the run at its own limit")
        } else {
            "correct the driver: a limit is a number above 0".to_owned()
        };
        FileError::at_key(&self.robot().source, key.to_vec(), message, Some(help))
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
