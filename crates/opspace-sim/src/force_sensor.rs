//! Six-axis force sensor: first-order bandwidth, constant bias, drift, white noise, and the load beyond it.

use crate::parameters::ForceSensorParameters;
use crate::sensor_load::SensorLoad;
use nalgebra::Vector3;
use opspace_backend::low_pass;
use opspace_model::Force;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Simulated force sensor, in its own axes.
#[derive(Clone, Debug)]
pub struct SimulatedForceSensor {
    gain: f64,
    noise: (f64, f64),
    bias: Force,
    /// Growth of the bias per update of the filter.
    drift: Force,
    load: Option<SensorLoad>,
    filtered: Force,
    random: ChaCha8Rng,
}

impl SimulatedForceSensor {
    /// Returns a sensor whose filter is updated every `period_s` (s); its bias and its drift are drawn once.
    #[must_use]
    pub fn new(parameters: &ForceSensorParameters, period_s: f64, mut random: ChaCha8Rng) -> Self {
        let mut uniform = |size: f64| Vector3::from_fn(|_, _| size * random.random_range(-1.0..=1.0));
        let bias =
            Force { linear: uniform(parameters.bias_n.get()), angular: uniform(parameters.bias_nm.get()) };
        let [force, moment] =
            [parameters.drift_n_per_s, parameters.drift_nm_per_s].map(|rate| rate.get() * period_s);
        // A sensor without drift draws none, and has the noise that it would have without this code.
        let drift = if force == 0.0 && moment == 0.0 {
            Force::zero()
        } else {
            Force { linear: uniform(force), angular: uniform(moment) }
        };
        Self {
            gain: low_pass::gain(parameters.bandwidth_hz.get(), period_s),
            noise: (parameters.noise_n.get(), parameters.noise_nm.get()),
            bias,
            drift,
            load: None,
            filtered: Force::zero(),
            random,
        }
    }

    /// Returns the sensor with a load beyond it, on an arm that has been at rest at `q` (n; rad, m) for long.
    pub(crate) fn with_load(self, load: Option<SensorLoad>, q: &[f64]) -> Self {
        let mut sensor = Self { load, ..self };
        sensor.filtered = sensor.load(q, &vec![0.0; q.len()]);
        sensor
    }

    /// Returns the wrench of the load on the sensor (sensor axes; N, Nm), of an arm with joint positions `q` (n; rad, m)
    /// and velocities `dq` (n; rad/s, m/s) at the end of a period.
    pub(crate) fn load(&mut self, q: &[f64], dq: &[f64]) -> Force {
        self.load.as_mut().map_or(Force::zero(), |load| load.wrench(q, dq))
    }

    /// Updates the filter with the true wrench (sensor axes; N, Nm) of a period.
    pub fn follow(&mut self, wrench: &Force) {
        self.filtered += (*wrench - self.filtered) * self.gain;
        self.bias += self.drift;
    }

    /// Returns a reading with bias and noise, sensor axes (N, Nm).
    pub fn read(&mut self) -> Force {
        let mut white = |size: f64| -> Vector3<f64> {
            Vector3::from_fn(|_, _| {
                let sample: f64 = StandardNormal.sample(&mut self.random);
                size * sample
            })
        };
        let noise = Force { linear: white(self.noise.0), angular: white(self.noise.1) };
        self.filtered + self.bias + noise
    }
}
