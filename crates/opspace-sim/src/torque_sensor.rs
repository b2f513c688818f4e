//! Measurement of the torques of an arm's joints, by motor current or by torque sensors: mean since the last sample, with
//! scale, offset, lateness and noise.

use crate::config::ArmConfig;
use crate::parameters::TorqueMeasurementParameters;
use crate::random::{RngStream, generator};
use nalgebra::DVector;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Torque sensors of an arm.
pub(crate) struct TorqueSensor {
    /// Measured over true torque (n).
    scale: Vec<f64>,
    /// Measured torque at a torque of zero (n; Nm, N).
    offset: Vec<f64>,
    noise: f64,
    random: ChaCha8Rng,
    /// Torques of the servo ticks that are not measured yet, the oldest first after `next` (Nm, N).
    late: Vec<DVector<f64>>,
    next: usize,
    /// Mean torque of the present servo tick (n; Nm, N).
    tick: DVector<f64>,
    /// Sum over the measured servo ticks since the last sample (n; Nm, N), and their number.
    sum: DVector<f64>,
    ticks: usize,
    /// Mean of the last sample (n; Nm, N).
    mean: DVector<f64>,
}

impl TorqueSensor {
    /// Returns the currents of motors that produced `torque` (n; Nm, N) so far.
    pub fn of_motors(config: &ArmConfig, torque: DVector<f64>) -> Self {
        let parameters = &config.simulated.current_measurement;
        let joint = |joint: &opspace_model::Joint| {
            let own = parameters.joint_scale.get(&joint.name).map_or(1.0, |scale| scale.get());
            own * parameters.scale.get()
        };
        let noise = config.simulated.torque_noise_nm.get();
        let sensor =
            Self::new(torque, noise, parameters.delay_servo_ticks, config.seed, RngStream::MotorTorque);
        Self { scale: config.model.joints().iter().map(joint).collect(), ..sensor }
    }

    /// Returns the torque sensors of joints whose links felt `torque` (n; Nm, N) so far.
    pub fn of_links(config: &ArmConfig, torque: DVector<f64>) -> Self {
        let TorqueMeasurementParameters { scale, offset_nm, noise_nm, delay_servo_ticks } =
            &config.simulated.joint_torque_measurement;
        let offset = |joint: &opspace_model::Joint| offset_nm.get(&joint.name).copied().unwrap_or(0.0);
        let joints = config.model.joints();
        let sensor =
            Self::new(torque, noise_nm.get(), *delay_servo_ticks, config.seed, RngStream::JointTorque);
        Self { scale: vec![scale.get(); joints.len()], offset: joints.iter().map(offset).collect(), ..sensor }
    }

    fn new(torque: DVector<f64>, noise: f64, delay: u32, seed: u64, stream: RngStream) -> Self {
        let zero = DVector::zeros(torque.len());
        Self {
            scale: vec![1.0; torque.len()],
            offset: vec![0.0; torque.len()],
            noise,
            random: generator(seed, stream),
            late: vec![torque.clone(); delay as usize],
            next: 0,
            tick: zero.clone(),
            sum: zero,
            ticks: 0,
            mean: torque,
        }
    }

    /// Adds the torques (n; Nm, N) of one of `steps` physics steps of a servo tick.
    pub fn add(&mut self, torques: impl Iterator<Item = f64>, steps: f64) {
        self.tick.iter_mut().zip(torques).for_each(|(sum, torque)| *sum += torque / steps);
    }

    /// Ends a servo tick.
    pub fn end_tick(&mut self) {
        if let Some(oldest) = self.late.get_mut(self.next) {
            std::mem::swap(oldest, &mut self.tick);
            self.next = (self.next + 1) % self.late.len();
        }
        self.sum += &self.tick;
        self.ticks += 1;
        self.tick.fill(0.0);
    }

    /// Writes the mean since the last call (n; Nm, N); the previous mean if no servo tick has ended since.
    pub fn read(&mut self, measured: Option<&mut Vec<f64>>) {
        if self.ticks > 0 {
            self.mean.copy_from(&self.sum);
            self.mean /= self.ticks as f64;
            self.sum.fill(0.0);
            self.ticks = 0;
        }
        for (i, to) in measured.into_iter().flatten().enumerate() {
            let white: f64 = StandardNormal.sample(&mut self.random);
            *to = self.scale[i] * self.mean[i] + self.offset[i] + self.noise * white;
        }
    }
}
