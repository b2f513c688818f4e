//! Six-axis force sensor: first-order bandwidth, constant bias, white noise.

use crate::parameters::ForceSensorParameters;
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
    filtered: Force,
    random: ChaCha8Rng,
}

impl SimulatedForceSensor {
    /// Returns a sensor whose filter is updated every `period_s` (s); its bias is drawn once.
    #[must_use]
    pub fn new(parameters: &ForceSensorParameters, period_s: f64, mut random: ChaCha8Rng) -> Self {
        let mut uniform = |size: f64| Vector3::from_fn(|_, _| size * random.random_range(-1.0..=1.0));
        let bias =
            Force { linear: uniform(parameters.bias_n.get()), angular: uniform(parameters.bias_nm.get()) };
        Self {
            gain: low_pass::gain(parameters.bandwidth_hz.get(), period_s),
            noise: (parameters.noise_n.get(), parameters.noise_nm.get()),
            bias,
            filtered: Force::zero(),
            random,
        }
    }

    /// Updates the filter with the true wrench (sensor axes; N, Nm) of a period.
    pub fn follow(&mut self, wrench: &Force) {
        self.filtered += (*wrench - self.filtered) * self.gain;
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
