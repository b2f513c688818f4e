//! Bias of a force sensor and weight of the load beyond it, which are taken off its readings.
//!
//! In the axes of the sensor, with gravity minus the acceleration of the sensor, u, a sensor that nothing touches reads
//!
//! ```text
//! f = b_f + m u          μ = b_μ + s × u
//! ```
//!
//! with the mass m of the load and its first moment s = m c. Without `estimate` the load is the stated one, and the bias is
//! the stated one or that of the mean reading at rest before control begins. With `estimate` a Kalman filter for each of the two equations
//! follows b_f and m, b_μ and s, while nothing touches: its innovation is at most `contact_n` and `contact_nm` beyond three
//! standard deviations of what the filter predicts. Both sides of the equations pass the same low-pass of 10 Hz, so that the
//! acceleration is a difference of velocities and not of their noise. Load and bias differ only when the hand turns. Until it
//! has turned, the deviation is large in other orientations, and contact there is taken for load.
//!
//! From readings the weight of the load is taken off, and not its inertia.

use nalgebra::{SMatrix, SVector, Vector3};
use opspace_backend::quantity::{NonNegative, Positive, exactly};
use opspace_model::{Force, Motion};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Corner frequency of the low-pass of readings and motion, rad/s.
const FILTER_RAD_PER_S: f64 = 62.8;

/// Time for which an error of a reading lasts while the hand moves, s.
const CORRELATION_S: f64 = 0.1;

/// Standard deviations of the prediction within which a reading is no contact.
const DEVIATIONS: f64 = 3.0;

/// Standard deviations before the first reading: of the bias (N, Nm), and of an unknown load (kg, kg m).
const UNKNOWN_BIAS: [f64; 2] = [50.0, 5.0];
const UNKNOWN_LOAD: [f64; 2] = [2.0, 0.3];

/// Standard deviation of a stated load, as a fraction of it.
const STATED_LOAD: f64 = 0.2;

/// Load beyond a force sensor, a point mass.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct SensorLoadParameters {
    /// Mass, kg.
    pub mass_kg: NonNegative,
    /// Centre of mass in the axes of the sensor, m.
    #[serde(deserialize_with = "exactly")]
    pub centre_m: [f64; 3],
}

/// Bias of a force sensor, in its axes: what it reads when no load is mounted and nothing touches.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct SensorBiasParameters {
    /// Force, N.
    #[serde(deserialize_with = "exactly")]
    pub force_n: [f64; 3],
    /// Moment, Nm.
    #[serde(deserialize_with = "exactly")]
    pub moment_nm: [f64; 3],
}

/// Estimation of a force sensor's bias, and of the load beyond it, while nothing touches.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct SensorEstimateParameters {
    /// Force beyond the predicted one above which something touches, N. A smaller one that lasts is taken for bias.
    pub contact_n: Positive,
    /// Moment beyond the predicted one above which something touches, Nm.
    pub contact_nm: Positive,
    /// Rms error of a force component, N: noise, and inertia of the load that is not known.
    pub noise_n: Positive,
    /// Rms error of a moment component, Nm.
    pub noise_nm: Positive,
    /// Time over which the estimate follows a bias that drifts, s.
    pub time_s: Positive,
}

impl Default for SensorEstimateParameters {
    fn default() -> Self {
        Self {
            contact_n: Positive::literal(1.0),
            contact_nm: Positive::literal(0.1),
            noise_n: Positive::literal(0.2),
            noise_nm: Positive::literal(0.01),
            time_s: Positive::literal(10.0),
        }
    }
}

/// Motion of a force sensor, in its axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SensorMotion {
    /// Gravity, m/s².
    pub(crate) gravity: Vector3<f64>,
    /// Velocity of its origin (m/s) and angular velocity (rad/s).
    pub(crate) velocity: Motion,
}

/// Compensation of a force sensor: see the [module](self). Allocates nothing.
#[derive(Clone, Debug)]
pub struct SensorCompensation {
    bias: Force,
    /// True if the bias is stated: the readings at rest are not taken for it.
    is_stated: bool,
    /// Mass (kg) and first moment (kg m) of the load.
    mass: f64,
    moment: Vector3<f64>,
    /// Number of readings at rest.
    rested: f64,
    pub(crate) estimate: Option<SensorEstimate>,
}

/// Filters of a sensor that is estimated.
#[derive(Clone, Debug)]
pub(crate) struct SensorEstimate {
    parameters: SensorEstimateParameters,
    /// Share of a cycle in the low-passes.
    gain: f64,
    /// Ratio of a low-passed acceleration to the velocity minus the low-passed one, 1/s.
    acceleration_per_s: f64,
    /// Share of a cycle in the time of the estimate.
    share: f64,
    /// Deviations of white noise in each reading that tells as little as the errors do, N and Nm.
    noise: [f64; 2],
    /// Low-passes of reading, of gravity minus the acceleration by the rotation of the axes, and of the velocity; `None` before
    /// the first reading.
    filtered: Option<(Force, Vector3<f64>, Vector3<f64>)>,
    /// Bias (N) and mass (kg).
    force: Kalman<4>,
    /// Bias (Nm) and first moment (kg m).
    moment: Kalman<6>,
    touches: bool,
}

impl SensorCompensation {
    /// Returns the compensation of a sensor with the stated load, if any, that is read every `period_s` (s).
    #[must_use]
    pub fn new(
        load: Option<&SensorLoadParameters>,
        estimate: Option<&SensorEstimateParameters>,
        period_s: f64,
    ) -> Self {
        let mass = load.map_or(0.0, |load| load.mass_kg.get());
        let moment = load.map_or(Vector3::zeros(), |load| Vector3::from(load.centre_m) * mass);
        let estimate = estimate.map(|&parameters| {
            let of_load = |unknown: f64, size: f64| if load.is_some() { STATED_LOAD * size } else { unknown };
            let (of_mass, of_moment) =
                (of_load(UNKNOWN_LOAD[0], mass), of_load(UNKNOWN_LOAD[1], moment.norm()));
            let [of_force, of_torque] = UNKNOWN_BIAS;
            let gain = 1.0 - (-FILTER_RAD_PER_S * period_s).exp();
            SensorEstimate {
                gain,
                // Of sampled velocities; it tends to the corner frequency for short periods.
                acceleration_per_s: gain / (period_s * (1.0 - gain)),
                share: period_s / parameters.time_s.get(),
                noise: [parameters.noise_n, parameters.noise_nm]
                    .map(|noise| noise.get() * f64::max(1.0, CORRELATION_S / period_s).sqrt()),
                filtered: None,
                parameters,
                force: Kalman::new(
                    SVector::from([0.0, 0.0, 0.0, mass]),
                    [of_force, of_force, of_force, of_mass],
                ),
                moment: Kalman::new(
                    SVector::from([0.0, 0.0, 0.0, moment.x, moment.y, moment.z]),
                    [of_torque, of_torque, of_torque, of_moment, of_moment, of_moment],
                ),
                touches: false,
            }
        });
        Self { bias: Force::zero(), is_stated: false, mass, moment, rested: 0.0, estimate }
    }

    /// Takes the stated bias in place of the mean reading at rest, so that something may touch before control begins. An
    /// estimate begins with it.
    #[must_use]
    pub fn with_bias(mut self, bias: &SensorBiasParameters) -> Self {
        let (force, moment) = (Vector3::from(bias.force_n), Vector3::from(bias.moment_nm));
        (self.bias, self.is_stated) = (Force { linear: force, angular: moment }, true);
        if let Some(estimate) = &mut self.estimate {
            let SensorEstimateParameters { contact_n, contact_nm, .. } = estimate.parameters;
            estimate.force.begin_at(&force, contact_n.get());
            estimate.moment.begin_at(&moment, contact_nm.get());
        }
        self
    }

    /// Adds a reading (N, Nm; axes of the sensor) at rest, while nothing touches unless the bias is stated.
    pub(crate) fn rest(&mut self, reading: &Force, motion: &SensorMotion) {
        if self.is_stated {
            self.update(reading, motion);
            return;
        }
        self.rested += 1.0;
        let bias = *reading - self.weight(&motion.gravity);
        self.bias += (bias - self.bias) * (1.0 / self.rested);
        if let Some(estimate) = &mut self.estimate {
            estimate.update(reading, motion, true);
            self.take_estimate();
        }
    }

    /// Updates the estimate, if there is one, and returns the force of what touches (N, Nm; axes of the sensor).
    pub(crate) fn update(&mut self, reading: &Force, motion: &SensorMotion) -> Force {
        if let Some(estimate) = &mut self.estimate {
            estimate.update(reading, motion, false);
            self.take_estimate();
        }
        self.contact(reading, &motion.gravity)
    }

    /// Returns the force of what touches, without a new estimate (N, Nm; axes of the sensor).
    pub(crate) fn contact(&self, reading: &Force, gravity: &Vector3<f64>) -> Force {
        *reading - self.bias - self.weight(gravity)
    }

    fn take_estimate(&mut self) {
        let Some(SensorEstimate { force, moment, .. }) = &self.estimate else { return };
        let part = |place: usize, state: &[f64]| Vector3::from_column_slice(&state[place..place + 3]);
        self.bias =
            Force { linear: part(0, force.state.as_slice()), angular: part(0, moment.state.as_slice()) };
        (self.mass, self.moment) = (force.state[3], part(3, moment.state.as_slice()));
    }

    fn weight(&self, gravity: &Vector3<f64>) -> Force {
        Force { linear: gravity * self.mass, angular: self.moment.cross(gravity) }
    }

    /// Bias, fx, fy, fz (N) and mx, my, mz (Nm).
    pub(crate) fn bias(&self) -> [f64; 6] {
        let Force { linear, angular } = self.bias;
        [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
    }

    /// Mass (kg) and first moment (kg m) of the load.
    pub(crate) fn load(&self) -> [f64; 4] {
        [self.mass, self.moment.x, self.moment.y, self.moment.z]
    }
}

impl SensorEstimate {
    /// True if something touches.
    pub(crate) fn touches(&self) -> bool {
        self.touches
    }

    fn update(&mut self, reading: &Force, motion: &SensorMotion, is_free: bool) {
        let SensorEstimateParameters { contact_n, contact_nm, .. } = self.parameters;
        let [noise_n, noise_nm] = self.noise;
        // The axes turn: a = ẇ + ω × w for the velocity w in them.
        let Motion { linear, angular } = motion.velocity;
        let turning = motion.gravity - angular.cross(&linear);
        let (force, specific, velocity) = self.filtered.get_or_insert((*reading, turning, linear));
        *force += (*reading - *force) * self.gain;
        *specific += (turning - *specific) * self.gain;
        *velocity += (linear - *velocity) * self.gain;
        let (reading, gravity) = (*force, *specific - (linear - *velocity) * self.acceleration_per_s);
        let of_force = [0, 1, 2].map(|axis| {
            let mut row = SVector::<f64, 4>::ith(axis, 1.0);
            row[3] = gravity[axis];
            row
        });
        let turned = -gravity.cross_matrix();
        let of_moment = [0, 1, 2].map(|axis| {
            let mut row = SVector::<f64, 6>::ith(axis, 1.0);
            row.fixed_rows_mut::<3>(3).copy_from(&turned.row(axis).transpose());
            row
        });
        let free = self.force.predicts(&of_force, &reading.linear, contact_n.get(), self.touches)
            && self.moment.predicts(&of_moment, &reading.angular, contact_nm.get(), self.touches);
        self.touches = !(free || is_free);
        if self.touches {
            return;
        }
        self.force.correct(&of_force, &reading.linear, noise_n, self.share);
        self.moment.correct(&of_moment, &reading.angular, noise_nm, self.share);
    }
}

/// Kalman filter of a constant state, whose first three elements wander.
#[derive(Clone, Debug)]
struct Kalman<const N: usize> {
    state: SVector<f64, N>,
    covariance: SMatrix<f64, N, N>,
}

impl<const N: usize> Kalman<N> {
    fn new(state: SVector<f64, N>, deviations: [f64; N]) -> Self {
        let variances = SVector::from(deviations.map(|deviation| deviation * deviation));
        Self { state, covariance: SMatrix::from_diagonal(&variances) }
    }

    /// Sets the first three elements, and their standard deviation.
    fn begin_at(&mut self, known: &Vector3<f64>, deviation: f64) {
        for axis in 0..3 {
            self.state[axis] = known[axis];
            self.covariance[(axis, axis)] = deviation * deviation;
        }
    }

    /// Returns true if a reading is as predicted by its rows, within `allowed`, or within the deviation of the prediction
    /// unless something `touches` already.
    fn predicts(
        &self,
        rows: &[SVector<f64, N>; 3],
        reading: &Vector3<f64>,
        allowed: f64,
        touches: bool,
    ) -> bool {
        let innovation = Vector3::from_fn(|axis, _| reading[axis] - rows[axis].dot(&self.state)).norm();
        if innovation <= allowed || touches {
            return innovation <= allowed;
        }
        let variance: f64 = rows.iter().map(|row| row.dot(&(self.covariance * row))).sum();
        innovation <= allowed + DEVIATIONS * variance.max(0.0).sqrt()
    }

    /// Corrects the state with a reading of the given rms noise; the wandering elements follow it by `share` in the end.
    fn correct(&mut self, rows: &[SVector<f64, N>; 3], reading: &Vector3<f64>, noise: f64, share: f64) {
        for axis in 0..3 {
            self.covariance[(axis, axis)] += (noise * share).powi(2);
        }
        for (axis, row) in rows.iter().enumerate() {
            let spread = self.covariance * row;
            let gain = spread / (row.dot(&spread) + noise * noise);
            self.state += gain * (reading[axis] - row.dot(&self.state));
            self.covariance -= gain * spread.transpose();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    const PERIOD_S: f64 = 1e-3;

    /// Rms noise of the sensor, N and Nm.
    const NOISE: [f64; 2] = [0.1, 0.005];

    /// Largest mean error of an estimated sensor over 0.1 s: drift that is not followed yet, and noise; N and Nm.
    const ESTIMATED: [f64; 2] = [0.25, 0.025];

    /// Largest mean error of a sensor with a stated load: that of the tare, and noise; N and Nm.
    const STATED: [f64; 2] = [0.1, 0.005];

    /// Largest error of an estimated mass, kg.
    const MASS_KG: f64 = 0.02;

    /// Pseudo-random numbers from -1 to 1.
    struct Random(u64);

    impl Random {
        fn next(&mut self) -> f64 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
        }

        fn vector(&mut self, size: f64) -> Vector3<f64> {
            Vector3::from_fn(|_, _| size * self.next())
        }
    }

    /// A sensor with bias, drift and load, whose hand turns.
    struct Hand {
        random: Random,
        bias: Force,
        drift: Force,
        mass: f64,
        centre: Vector3<f64>,
        angles: Vector3<f64>,
    }

    impl Hand {
        fn new(seed: u64) -> Self {
            let mut random = Random(seed);
            random.vector(1.0);
            Self {
                bias: Force { linear: random.vector(10.0), angular: random.vector(0.5) },
                drift: Force { linear: random.vector(0.01), angular: random.vector(0.0005) },
                mass: 0.2 + 0.8 * random.next().abs(),
                centre: random.vector(0.1),
                angles: Vector3::zeros(),
                random,
            }
        }

        /// Motion of the sensor, which moves too slowly to matter.
        fn motion(&self) -> SensorMotion {
            SensorMotion { gravity: self.gravity(), velocity: Motion::zero() }
        }

        fn gravity(&self) -> Vector3<f64> {
            let [roll, pitch, yaw] = self.angles.into();
            UnitQuaternion::from_euler_angles(roll, pitch, yaw).inverse() * Vector3::new(0.0, 0.0, -9.81)
        }

        /// Reading with the force of a contact, in the axes of the sensor.
        fn reading(&mut self, contact: &Force) -> Force {
            self.bias += self.drift * PERIOD_S;
            let weight = self.gravity() * self.mass;
            let load = Force { linear: weight, angular: self.centre.cross(&weight) };
            // White noise of this rms.
            let white = 3.0_f64.sqrt();
            let noise = Force {
                linear: self.random.vector(white * NOISE[0]),
                angular: self.random.vector(white * NOISE[1]),
            };
            self.bias + load + noise + *contact
        }

        /// Turns by `angles` (rad) in five seconds, and returns the largest mean error over 0.1 s, N and Nm.
        fn turn(
            &mut self,
            sensor: &mut SensorCompensation,
            angles: Vector3<f64>,
            contact: &Force,
        ) -> [f64; 2] {
            let from = self.angles;
            let (mut largest, mut mean) = ([0.0_f64; 2], Force::zero());
            for step in 1..=5000 {
                let s = f64::from(step) / 5000.0;
                self.angles = from + angles * (s * s * (3.0 - 2.0 * s));
                let reading = self.reading(contact);
                mean += (sensor.update(&reading, &self.motion()) - *contact) * 0.01;
                if step % 100 == 0 {
                    largest = [largest[0].max(mean.linear.norm()), largest[1].max(mean.angular.norm())];
                    mean = Force::zero();
                }
            }
            largest
        }
    }

    /// A sensor that has found the bias and the load of a hand, by turning it.
    fn turned(seed: u64) -> (Hand, SensorCompensation) {
        let mut hand = Hand::new(seed);
        let parameters = SensorEstimateParameters::default();
        let mut sensor = SensorCompensation::new(None, Some(&parameters), PERIOD_S);
        for _ in 0..500 {
            let reading = hand.reading(&Force::zero());
            sensor.rest(&reading, &hand.motion());
        }
        hand.turn(&mut sensor, Vector3::new(0.6, 0.0, 0.0), &Force::zero());
        hand.turn(&mut sensor, Vector3::new(0.0, 0.6, 0.0), &Force::zero());
        (hand, sensor)
    }

    #[test]
    fn bias_and_load_are_found_while_the_hand_turns() {
        for seed in 1..=20 {
            let (mut hand, mut sensor) = turned(seed);
            // To an orientation that was not visited.
            let away = Vector3::new(-1.2, -0.9, 0.5);
            let [force, moment] = hand.turn(&mut sensor, away, &Force::zero());
            let load = sensor.load();
            assert!(force < ESTIMATED[0] && moment < ESTIMATED[1], "{force} N, {moment} Nm");
            assert!((load[0] - hand.mass).abs() < MASS_KG, "{} for {} kg", load[0], hand.mass);
        }
    }
    #[test]
    fn contact_is_not_taken_for_bias_or_load() {
        for seed in 21..=40 {
            let (mut hand, mut sensor) = turned(seed);
            let push = Force { linear: hand.random.vector(20.0), angular: hand.random.vector(1.0) };
            let push = push * (5.0 / push.linear.norm().min(5.0));
            let [force, moment] = hand.turn(&mut sensor, Vector3::new(-0.5, -0.5, 0.3), &push);
            assert!(sensor.estimate.as_ref().is_some_and(SensorEstimate::touches));
            assert!(force < ESTIMATED[0] && moment < ESTIMATED[1], "{force} N, {moment} Nm");
            let [force, moment] = hand.turn(&mut sensor, Vector3::new(0.3, 0.2, 0.0), &Force::zero());
            assert!(
                force < ESTIMATED[0] && moment < ESTIMATED[1],
                "after the contact: {force} N, {moment} Nm"
            );
            assert!(!sensor.estimate.as_ref().is_some_and(SensorEstimate::touches));
        }
    }

    #[test]
    fn stated_load_needs_no_motion() {
        let mut hand = Hand::new(41);
        hand.drift = Force::zero();
        let load = SensorLoadParameters { mass_kg: NonNegative::literal(0.5), centre_m: [0.0, 0.02, 0.06] };
        (hand.mass, hand.centre) = (0.5, Vector3::from(load.centre_m));
        let mut sensor = SensorCompensation::new(Some(&load), None, PERIOD_S);
        for _ in 0..500 {
            let reading = hand.reading(&Force::zero());
            sensor.rest(&reading, &hand.motion());
        }
        let [force, moment] = hand.turn(&mut sensor, Vector3::new(1.0, -0.7, 0.4), &Force::zero());
        assert!(force < STATED[0] && moment < STATED[1], "{force} N, {moment} Nm");
    }

    #[test]
    fn inertia_is_not_taken_for_weight_at_any_period() {
        for period_s in [1e-3, 5e-3, 8e-3] {
            let parameters = SensorEstimateParameters::default();
            let mut sensor = SensorCompensation::new(None, Some(&parameters), period_s);
            let mass = 0.8;
            // The hand swings, and accelerates by up to 3 m/s² as it tilts, so that inertia looks like weight.
            let motion = |time_s: f64| {
                let phase = std::f64::consts::PI * time_s;
                let rotation = UnitQuaternion::from_euler_angles(0.6 * phase.sin(), 0.3 * time_s.sin(), 0.0);
                let in_axes = |vector: Vector3<f64>| rotation.inverse() * vector;
                let velocity = Vector3::y() * (-3.0 / std::f64::consts::PI * phase.cos());
                let acceleration = Vector3::y() * (3.0 * phase.sin());
                let gravity = in_axes(Vector3::new(0.0, 0.0, -9.81));
                (gravity, in_axes(velocity), in_axes(acceleration), rotation)
            };
            for step in 1..(20.0 / period_s) as usize {
                let time_s = step as f64 * period_s;
                let (gravity, linear, _, rotation) = motion(time_s);
                let angular = (motion(time_s - period_s).3.inverse() * rotation).scaled_axis() / period_s;
                // The mean acceleration of a cycle, as a sensor that is as fast as the cycle reads it.
                let (.., acceleration, _) = motion(time_s - 0.5 * period_s);
                let reading = Force { linear: (gravity - acceleration) * mass, angular: Vector3::zeros() };
                let velocity = Motion { linear, angular };
                sensor.update(&reading, &SensorMotion { gravity, velocity });
            }
            let found = sensor.load()[0];
            assert!((found - mass).abs() < MASS_KG, "{period_s} s: {found} kg of {mass} kg");
        }
    }
}
