//! Wrenches of force sensors as they arrive: frame, sign, silence and tare. No input and no output.

use crate::config::RosConfig;
use crate::fault::RosFault;
use crate::messages::WrenchStamped;
use crate::states::Failure;
use opspace_backend::ForceSensor;

/// Reader of the wrenches of all force sensors.
#[derive(Clone, Debug)]
pub struct WrenchReader {
    sensors: Vec<ForceSensor>,
    sign: f64,
    silence_s: f64,
    values: Vec<[f64; 6]>,
    arrivals_s: Vec<Option<f64>>,
}

impl WrenchReader {
    /// Returns a reader without a wrench so far.
    #[must_use]
    pub fn new(config: &RosConfig) -> Self {
        let sensors = config.force_sensors.clone();
        Self {
            sign: if config.wrenches_inverted { -1.0 } else { 1.0 },
            silence_s: config.silence.as_secs_f64(),
            values: vec![[0.0; 6]; sensors.len()],
            arrivals_s: vec![None; sensors.len()],
            sensors,
        }
    }

    /// Last wrenches ON the robot, in the axes of the sensors, N and Nm.
    #[must_use]
    pub fn values(&self) -> &[[f64; 6]] {
        &self.values
    }

    /// Reads the message of a sensor that arrived at `arrival_s` on the computer's clock (s).
    ///
    /// # Errors
    /// A wrench in another frame than that of the sensor, or one that is not finite.
    pub fn read(&mut self, sensor: usize, message: &WrenchStamped, arrival_s: f64) -> Result<(), Failure> {
        let ForceSensor { name, frame, .. } = &self.sensors[sensor];
        let stated = message.header.frame_id.trim_start_matches('/');
        if !stated.is_empty() && stated != frame {
            let details = format!("sensor '{name}' is at '{frame}' in robot.toml, its topic has '{stated}'");
            return Err((RosFault::WrenchMalformed, details));
        }
        let (force, moment) = (message.wrench.force, message.wrench.torque);
        let wrench = [force.x, force.y, force.z, moment.x, moment.y, moment.z];
        if wrench.iter().any(|value| !value.is_finite()) {
            return Err((RosFault::WrenchMalformed, format!("sensor '{name}'")));
        }
        self.values[sensor] = wrench.map(|value| self.sign * value);
        self.arrivals_s[sensor] = Some(arrival_s);
        Ok(())
    }

    /// Checks that all sensors have sent something of late.
    ///
    /// # Errors
    /// A sensor that is silent; one that has sent nothing yet counts from the time zero on.
    pub fn check_silence(&self, arrival_s: f64) -> Result<(), Failure> {
        let is_silent = |arrival: &Option<f64>| arrival_s - arrival.unwrap_or(0.0) > self.silence_s;
        let silent = self.arrivals_s.iter().position(is_silent);
        silent.map_or(Ok(()), |sensor| Err((RosFault::WrenchSilent, self.sensors[sensor].name.clone())))
    }
}
