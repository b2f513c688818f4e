//! Observer of a joint's position, velocity, disturbance and servo memory from its encoder: a steady-state Kalman
//! filter whose prediction is the emulated drive.
//!
//! ```text
//! x = [q, q̇, servo, d]        x = x⁻ + L (y − q⁻)        ẋ: I (q̈ − d) = τ, the servo's, at every servo tick
//! ```
//!
//! d is the acceleration (rad/s²) that the prediction doesn't include: a random walk, constant between two servo ticks.
//! The gain is computed for the joint with its drive, not for a free mass: between two setpoints a stiff drive returns
//! the joint to its reference, and a gain computed for a free mass would correct that motion a second time.

use crate::servo_law::{MAX_ORDER, ServoLaw, ServoState};
use nalgebra::{DMatrix, DVector};

/// Random walk of the unknown acceleration, rad/s² per √s. A smaller value reacts less to the motion caused by a held
/// setpoint within a period; a larger one adapts faster to model errors.
const DISTURBANCE_RANDOM_WALK: f64 = 30.0;

/// Encoder error in addition to quantisation, rms, rad.
const NOISE_RAD: f64 = 2e-6;

/// Rms quantisation error of a position, as a fraction of an encoder count (0.29 for a uniform error).
const QUANTISATION: f64 = 0.35;

/// Largest number of steps of the Riccati recursion, which converges within some hundred.
const MAX_STEPS: u32 = 20_000;

/// Observer gain L of a joint: correction of position, velocity (1/s), servo memory and disturbance (1/s²) per
/// innovation (rad).
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct ObserverGain {
    /// Gain of the position.
    pub position: f64,
    /// Gain of the velocity, 1/s.
    pub velocity: f64,
    /// Gain of the servo's memory.
    pub memory: ServoState,
    /// Gain of the disturbance, 1/s².
    pub disturbance: f64,
}

/// Joint whose position is read every [`servo_ticks_per_cycle`](Self::servo_ticks_per_cycle) servo ticks.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct ObservedJoint<'a> {
    /// Servo law of its drive; `None` for a drive that takes torques.
    pub servo: Option<&'a ServoLaw>,
    /// Inertia that the drive moves, kg m² (kg).
    pub inertia: f64,
    /// Resolution of its encoder, rad (m).
    pub resolution_rad: f64,
    /// Time between two servo ticks, s.
    pub servo_period_s: f64,
    /// Servo ticks between two readings.
    pub servo_ticks_per_cycle: u32,
}

impl ObserverGain {
    /// Returns the steady-state gain of a joint of a torque robot, with an encoder of this resolution (rad, m) that is read
    /// every `period_s` (s).
    #[must_use]
    pub fn of_torque_drive(resolution_rad: f64, period_s: f64) -> Self {
        // Without a servo, the inertia has no influence.
        let free = ObservedJoint {
            servo: None,
            inertia: 1.0,
            resolution_rad,
            servo_period_s: period_s,
            servo_ticks_per_cycle: 1,
        };
        Self::steady(&free)
    }

    /// Returns the steady-state gain: the fixed point of the Riccati recursion.
    #[must_use]
    pub fn steady(joint: &ObservedJoint<'_>) -> Self {
        let step = joint.step();
        let n = step.nrows();
        let period_s = joint.servo_period_s * f64::from(joint.servo_ticks_per_cycle);
        let mut wander = DMatrix::zeros(n, n);
        wander[(n - 1, n - 1)] = DISTURBANCE_RANDOM_WALK * DISTURBANCE_RANDOM_WALK * period_s;
        let noise = (QUANTISATION * joint.resolution_rad + NOISE_RAD).powi(2);
        let mut covariance = DMatrix::identity(n, n);
        let mut gain = DVector::zeros(n);
        for _ in 0..MAX_STEPS {
            let predicted = &step * &covariance * step.transpose() + &wander;
            let before = gain;
            gain = predicted.column(0) / (predicted[(0, 0)] + noise);
            covariance = &predicted - &gain * predicted.row(0);
            // Keeps the covariance symmetric.
            covariance = 0.5 * (&covariance + covariance.transpose());
            if (&gain - before).amax() <= 1e-12 * gain.amax() {
                break;
            }
        }
        let order = joint.order();
        Self {
            position: gain[0],
            velocity: gain[1],
            memory: std::array::from_fn(|i| if i < order { gain[2 + i] } else { 0.0 }),
            disturbance: gain[n - 1],
        }
    }
}

impl ObservedJoint<'_> {
    /// Number of memory entries of the servo.
    fn order(&self) -> usize {
        self.servo.map_or(0, ServoLaw::order)
    }

    /// Transition matrix of the state x over one reading, column by column. The setpoint is known and has no effect on
    /// the error.
    fn step(&self) -> DMatrix<f64> {
        let order = self.order();
        let n = order + 3;
        let mut step = DMatrix::zeros(n, n);
        for (column, mut after) in step.column_iter_mut().enumerate() {
            let of = |i: usize| if i == column { 1.0 } else { 0.0 };
            let (mut q, mut dq, disturbance) = (of(0), of(1), of(n - 1));
            let mut memory: ServoState =
                std::array::from_fn(|i| if i < order.min(MAX_ORDER) { of(2 + i) } else { 0.0 });
            for _ in 0..self.servo_ticks_per_cycle {
                let torque = self.servo.map_or(0.0, |servo| servo.step(&mut memory, 0.0, q));
                let ddq = torque / self.inertia + disturbance;
                q += self.servo_period_s * (dq + 0.5 * self.servo_period_s * ddq);
                dq += self.servo_period_s * ddq;
            }
            after[0] = q;
            after[1] = dq;
            after.rows_mut(2, order).copy_from_slice(&memory[..order]);
            after[n - 1] = disturbance;
        }
        step
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::servo::ServoParameters;

    /// Ratios of the joint's inertia to the inertia for which the gain is computed.
    const INERTIAS: [f64; 3] = [0.5, 1.0, 2.0];

    /// Encoder counts per motor turn, at a gear ratio of 100.
    const COUNTS: [f64; 3] = [1e3, 1.6e4, 1e6];

    const INERTIA: f64 = 0.3;

    fn law(servo: &str, servo_hz: f64) -> ServoLaw {
        let parameters: ServoParameters = toml::from_str(servo).expect("a servo");
        ServoLaw::new(&parameters, 1.0 / servo_hz).expect("a servo")
    }

    /// Moduli of the eigenvalues of the error dynamics (I − L H) F, in descending order. The joint has `scale` times
    /// the inertia for which the gain is computed.
    fn error_modes(servo: &ServoLaw, servo_hz: f64, ratio: u32, counts: f64, scale: f64) -> Vec<f64> {
        let joint = ObservedJoint {
            servo: Some(servo),
            inertia: INERTIA,
            resolution_rad: std::f64::consts::TAU / (counts * 100.0),
            servo_period_s: 1.0 / servo_hz,
            servo_ticks_per_cycle: ratio,
        };
        let gain = ObserverGain::steady(&joint);
        assert!(gain.position > 0.0);
        let n = servo.order() + 3;
        let mut l = DVector::zeros(n);
        l[0] = gain.position;
        l[1] = gain.velocity;
        l.rows_mut(2, servo.order()).copy_from_slice(&gain.memory[..servo.order()]);
        l[n - 1] = gain.disturbance;
        let step = ObservedJoint { inertia: INERTIA * scale, ..joint }.step();
        let error = &step - &l * step.row(0);
        let mut modes: Vec<f64> = error.complex_eigenvalues().iter().map(|v| v.norm()).collect();
        modes.sort_by(|a, b| b.total_cmp(a));
        modes
    }

    /// Checks that the eigenvalues of the error dynamics (I − L H) F of a joint with its drive lie within the unit
    /// circle: drives of 500 Hz to 5 kHz, read at every servo tick up to every tenth, with inertias other than that of
    /// the gain.
    #[test]
    fn observer_is_stable() {
        for servo_hz in [500.0, 1000.0, 5000.0] {
            let velocity_loop = std::f64::consts::TAU * (0.02 * servo_hz);
            let servo = format!(
                "cascaded = {{ kp_per_s = {}, kv_nms_per_rad = {}, velocity_filter_hz = {} }}",
                velocity_loop / 5.0,
                velocity_loop * INERTIA,
                0.12 * servo_hz
            );
            let servo = law(&servo, servo_hz);
            for ratio in [1, 2, 4, 5, 10] {
                for counts in COUNTS {
                    for scale in INERTIAS {
                        let largest = error_modes(&servo, servo_hz, ratio, counts, scale)[0];
                        assert!(
                            largest < 0.999,
                            "{servo_hz} Hz, 1:{ratio}, {counts} counts, inertia {scale}: {largest}"
                        );
                    }
                }
            }
        }
    }

    /// Velocity loops: ratio of bandwidth to servo rate, and integral gain divided by kv times the bandwidth in rad/s.
    const VELOCITY_LOOPS: [(f64, f64); 7] =
        [(0.004, 0.0), (0.004, 0.2), (0.008, 0.0), (0.008, 0.2), (0.02, 0.0), (0.02, 0.2), (0.04, 0.0)];

    /// Checks the error dynamics of a joint with a velocity drive. The delay of setpoints is not included, because they
    /// are known. An integral adds one unobservable mode with the eigenvalue 1: its torque cannot be distinguished from
    /// the unknown acceleration. The other eigenvalues must lie within the unit circle.
    #[test]
    fn observer_is_stable_with_velocity_drive() {
        /// Rounding of an eigenvalue of 1.
        const UNSEEN: f64 = 1e-6;
        for servo_hz in [500.0, 1000.0, 5000.0] {
            for (bandwidth, integral) in VELOCITY_LOOPS {
                let velocity_loop = std::f64::consts::TAU * (bandwidth * servo_hz);
                let kv = velocity_loop * INERTIA;
                let servo = format!(
                    "velocity = {{ kv_nms_per_rad = {kv}, ki_nm_per_rad = {}, velocity_filter_hz = {} }}",
                    integral * velocity_loop * kv,
                    0.12 * servo_hz
                );
                let servo = law(&servo, servo_hz);
                for ratio in [1, 2, 4, 5, 10] {
                    for (counts, scale) in COUNTS.into_iter().flat_map(|c| INERTIAS.map(|scale| (c, scale))) {
                        let modes = error_modes(&servo, servo_hz, ratio, counts, scale);
                        let unseen = usize::from(integral > 0.0);
                        assert!(
                            modes[unseen] < 0.999 && (unseen == 0 || (modes[0] - 1.0).abs() < UNSEEN),
                            "{servo_hz} Hz, {bandwidth}, {integral}, 1:{ratio}, {counts} counts, inertia {scale}: {modes:?}"
                        );
                    }
                }
            }
        }
    }
}
