//! Wrenches of force sensors as they arrive: frame, sign, silence and tare. No input and no output.

use crate::config::RosConfig;
use crate::fault::RosFault;
use crate::messages::WrenchStamped;
use crate::states::Failure;
use crate::tare::Tare;
use opspace_backend::ForceSensor;

/// Time over which a tare takes the mean, s.
const TARE_S: f64 = 0.2;

/// Reader of the wrenches of all force sensors.
#[derive(Clone, Debug)]
pub struct WrenchReader {
    sensors: Vec<ForceSensor>,
    sign: f64,
    silence_s: f64,
    values: Vec<[f64; 6]>,
    arrivals_s: Vec<Option<f64>>,
    tare: Tare,
    taring: Vec<Taring>,
}

/// Tare of a sensor.
#[derive(Clone, Debug, Default)]
struct Taring {
    /// Number of the request that was served last.
    request: u64,
    /// Begin of the tare, s, with the sum and the number of its wrenches.
    running: Option<(f64, [f64; 6], u32)>,
    zero: [f64; 6],
}

impl WrenchReader {
    /// Returns a reader without a wrench so far.
    #[must_use]
    pub fn new(config: &RosConfig, tare: Tare) -> Self {
        let sensors = config.force_sensors.clone();
        let served = Taring { request: tare.requests(), ..Taring::default() };
        Self {
            sign: if config.wrenches_inverted { -1.0 } else { 1.0 },
            silence_s: config.silence.as_secs_f64(),
            values: vec![[0.0; 6]; sensors.len()],
            arrivals_s: vec![None; sensors.len()],
            tare,
            taring: vec![served; sensors.len()],
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
        let zero = self.taring[sensor].zero(self.tare.requests(), &wrench, arrival_s);
        self.values[sensor] = std::array::from_fn(|axis| self.sign * (wrench[axis] - zero[axis]));
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

impl Taring {
    /// Zero of the sensor, after this wrench at `arrival_s` (s).
    fn zero(&mut self, requests: u64, wrench: &[f64; 6], arrival_s: f64) -> [f64; 6] {
        if requests != self.request {
            self.request = requests;
            self.running = Some((arrival_s, [0.0; 6], 0));
        }
        if let Some((began_s, sum, count)) = &mut self.running {
            *count += 1;
            for (sum, value) in sum.iter_mut().zip(wrench) {
                *sum += value;
            }
            if arrival_s - *began_s >= TARE_S {
                self.zero = sum.map(|sum| sum / f64::from(*count));
                self.running = None;
            }
        }
        self.zero
    }
}
