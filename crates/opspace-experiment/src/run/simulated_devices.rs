//! Simulated devices in place of a real robot: the arm of an experiment behind the protocol of its driver.

use crate::extensions::Extensions;
use crate::files::source::FileError;
use crate::run::experiment::Experiment;
use opspace_backend::quantity::Count;
use opspace_backend::{CommandKind, Measured, ServedDevices, Settings, SimulatedDevices};
use opspace_model::{Data, gravity, kinematics};
use opspace_sim::{ArmConfig, SimulatedArm};
use std::path::PathBuf;

impl Experiment {
    /// Builds the simulated arm without its servos: it accepts torques of the motors at the rate of the servos, and measures
    /// positions and velocities exactly. Friction, gears and environment are those of [`arm_config`](Self::arm_config).
    ///
    /// # Errors
    /// A robot file without `[simulated]`, or parameters that contradict each other.
    pub fn motor_arm(&self) -> Result<SimulatedArm, FileError> {
        let mut config: ArmConfig = self.arm_config()?;
        config.profile.servo_ticks_per_cycle = Count::literal(1);
        config.profile.delay_servo_ticks = Some(0);
        config.simulated.delay_servo_ticks = None;
        config.simulated.encoder_quantisation = false;
        config.simulated.bus = Default::default();
        config.rest_s = 0.0;
        let period_s = config.profile.servo_period_s();
        config.capabilities = self
            .robot()
            .capabilities(CommandKind::Torque, period_s)
            .measuring(&[Measured::Position, Measured::Velocity])
            .with_brakes(false)
            .simulated();
        self.simulated_arm_of(config)
    }

    /// Serves the simulated devices of the robot's driver with the arm of the experiment behind them, and calls `serve` once
    /// with their place and what was written for them; it returns when they are to end. Returns a sentence about how it went.
    ///
    /// # Errors
    /// A robot that cannot be simulated, an unknown driver, wrong settings or options, or devices that cannot be served.
    pub fn serve_devices(
        &self,
        extensions: &Extensions,
        link: Option<PathBuf>,
        options: impl FnOnce(Settings) -> Settings,
        serve: &mut dyn FnMut(&ServedDevices),
    ) -> Result<String, FileError> {
        let driver = self.robot().driver(extensions)?;
        let mut devices = self.simulated_devices()?;
        devices.options = options(devices.options);
        devices.link = link;
        let settings = self.driver_settings();
        driver.simulate(&settings, devices, serve).map_err(|error| self.robot().driver_error(driver, &error))
    }

    /// Arm of the experiment for simulated devices.
    ///
    /// # Errors
    /// A robot that cannot be simulated.
    pub fn simulated_devices(&self) -> Result<SimulatedDevices, FileError> {
        let (model, start) = (&self.robot().model, self.start()?);
        let mut data = Data::new(model);
        kinematics(model, &mut data, &start, &vec![0.0; model.n()]);
        gravity(model, &mut data);
        let ranges = model.joints().iter().map(|joint| (joint.limits.lower, joint.limits.upper));
        Ok(SimulatedDevices::new(
            Box::new(self.motor_arm()?),
            data.gravity.as_slice().to_vec(),
            ranges.collect(),
        ))
    }
}
