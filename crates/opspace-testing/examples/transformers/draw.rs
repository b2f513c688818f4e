//! An arm with random drives, and the tasks on it.

use crate::arms::{ARMS, Arm};
use nalgebra::DVector;
use opspace_experiment::{Files, RobotDefinition};
use opspace_model::{Data, frame_placement, update};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Bandwidths of the velocity loops for the inertia at the start, Hz.
const VELOCITY_LOOP_HZ: std::ops::Range<f64> = 8.0..40.0;

/// Bandwidth of the velocity loops of the arms in the repository, Hz.
const THEIR_VELOCITY_LOOP_HZ: f64 = 40.0;

/// Largest error of both gains, as a fraction of them.
pub const GAIN_ERROR: f64 = 0.2;

/// Postures about which the arms start, rad.
const USUAL: [(&str, &[f64]); 2] =
    [("panda", &[0.0, -0.8, 0.0, -2.3, 0.0, 1.5, 0.8]), ("ur5e", &[0.0, -1.5, -1.6, -1.5, 1.6, 0.0])];

/// An arm with drives, whose true parameters differ from those of its file.
pub struct Draw {
    pub name: String,
    arm: &'static Arm,
    settings: Vec<String>,
    start: String,
    height_m: f64,
}

/// One of several values.
fn one_of<T: Copy>(random: &mut impl Rng, of: &[T]) -> T {
    of[random.random_range(0..of.len())]
}

impl Draw {
    /// Returns the arm of this number and seed. Its gains are wrong by up to the `half_width` that its file states; by
    /// [`GAIN_ERROR`], and at the ends of the interval in two of five, if none is given.
    pub fn new(number: usize, seed: u64, measures_current: bool, half_width: Option<f64>) -> Self {
        Self::with_gain(number, seed, measures_current, half_width, None)
    }

    /// Returns the arm with its kp wrong by `kp_error`, if one is given.
    pub fn with_gain(
        number: usize,
        seed: u64,
        measures_current: bool,
        half_width: Option<f64>,
        given: Option<f64>,
    ) -> Self {
        let mixed = seed.wrapping_mul(0x9e37_79b9).wrapping_add(number as u64);
        let random = &mut ChaCha8Rng::seed_from_u64(mixed);
        let arm = &ARMS[number % ARMS.len()];
        let rate_hz = one_of(random, &[50.0, 100.0, 125.0, 250.0, 500.0, 1000.0]);
        let ratio = one_of(random, &[2_u32, 4, 5, 8]);
        let servo_hz = rate_hz * f64::from(ratio);
        // Slow interfaces belong to soft drives.
        let most_hz = VELOCITY_LOOP_HZ.end.min(0.15 * rate_hz);
        let velocity_loop_hz =
            random.random_range(0.2 * most_hz..most_hz).max(VELOCITY_LOOP_HZ.start.min(most_hz));
        let kp = random.random_range(10.0_f64..60.0).min(0.2 * rate_hz);
        let delay = random.random_range(0..=ratio);
        let most = half_width.unwrap_or(GAIN_ERROR);
        let is_at_end = random.random_bool(0.4);
        let mut error = |is_at_end: bool| match is_at_end {
            true => most * one_of(random, &[-1.0, 1.0]),
            false => most * random.random_range(-1.0..1.0),
        };
        let (kp_error, kv_error) = (error(is_at_end), error(false));
        let kp_error = given.unwrap_or(kp_error);
        let friction: f64 = 2.0_f64.powf(random.random_range(-1.0..1.0));
        let bits = one_of(random, &[12_i32, 14, 16, 18, 20]);
        let gears = one_of(random, &[None, Some(0.5), Some(1.0), Some(4.0), Some(16.0)]);

        let robot = RobotDefinition::load(Files::Disk, &arm.file(), &[]).expect("a robot of the repository");
        let profile = robot.file.default_profile.clone();
        let key = format!("robot.profile.{profile}");
        let kv_scale = velocity_loop_hz / THEIR_VELOCITY_LOOP_HZ;
        let filter_hz = 600.0_f64.min(0.15 * servo_hz);
        let servos: Vec<String> = (robot.model.joints().iter())
            .map(|joint| {
                let kv = kv_scale * robot.file.profile[&profile].servo[&joint.name].gains(1e-3).damping;
                format!(
                    "{} = {{ cascaded = {{ kp_per_s = {kp:?}, kv_nms_per_rad = {kv:?}, velocity_filter_hz = {filter_hz:?}, \
                     gain_uncertainty = {most:?} }} }}",
                    joint.name
                )
            })
            .collect();
        let measured = if measures_current { "\"position\", \"motor-current\"" } else { "\"position\"" };
        let physics_hz = servo_hz * (20e3 / servo_hz).floor().max(1.0);
        let mut settings = vec![
            "robot.interface.gears=\"elastic\"".to_owned(),
            "robot.estimated_force={}".to_owned(),
            format!("robot.interface.measured=[{measured}]"),
            format!("{key}.servo_hz={servo_hz:?}"),
            format!("{key}.servo_ticks_per_cycle={ratio}"),
            format!("{key}.delay_servo_ticks={delay}"),
            format!("{key}.estimator={{ velocity_filter_hz = {:?} }}", 0.2 * rate_hz),
            format!("{key}.servo={{ {} }}", servos.join(", ")),
            format!("robot.simulated.physics_hz={physics_hz:?}"),
            format!("robot.simulated.current_loop_hz={:?}", 1000.0_f64.min(0.3 * servo_hz)),
            format!(
                "robot.simulated.true_over_nominal={{ kp = {:?}, kv = {:?}, friction = {friction:?} }}",
                1.0 + kp_error,
                1.0 + kv_error
            ),
            "robot.force_sensor.tip={ frame = \"flange\" }".to_owned(),
            "robot.simulated.force_sensor.tip={ bandwidth_hz = 100.0, noise_n = 0.3, noise_nm = 0.02, bias_n = 0.0, \
             bias_nm = 0.0 }"
                .to_owned(),
        ];
        // Encoders on the motors, of so many counts per turn of the joint.
        for joint in robot.model.joints() {
            let ratio = robot.file.joint[&joint.name].rotor.gear_ratio.get();
            let counts = (2.0_f64.powi(bits) / ratio).ceil().max(16.0);
            settings.push(format!("robot.joint.{}.rotor.encoder_counts_per_turn={counts:.0}", joint.name));
        }
        settings.extend(gears.map(|scale| arm.elastic_gears(scale)));
        let (start, height_m) = start(arm, &robot, random);
        let name = format!(
            "{:5} {rate_hz:4} Hz, {ratio} ticks, delay {delay}, kp {kp:2.0} {:+3.0} %, kv for {velocity_loop_hz:2.0} Hz {:+3.0} %, \
             friction {friction:.1}, {bits} bit, gears {}",
            arm.folder,
            100.0 * kp_error,
            100.0 * kv_error,
            gears.map_or("rigid".to_owned(), |scale| format!("x {scale}")),
        );
        Self { name, arm, settings, start, height_m }
    }

    /// File of the robot, and its settings.
    pub fn robot(&self) -> RobotDefinition {
        RobotDefinition::load(Files::Disk, &self.arm.file(), &self.settings).unwrap_or_else(|e| panic!("{e}"))
    }

    /// Tasks with their names.
    pub fn tasks(&self, seed: u64) -> [(&'static str, String); 4] {
        let hand = |rms_m: f64| {
            format!(
                "[environment.operator.spring]\nframe = \"flange\"\nstiffness_n_per_m = 200.0\ndamping_ns_per_m = 15.0\n\
                 motion.random = {{ rms_m = {rms_m:?}, from_hz = 0.1, to_hz = 0.7, ramp_s = 1.0 }}\n"
            )
        };
        let head = |priority: &str| {
            format!(
                "robot = \"unused\"\nduration_s = 5.0\nsettle_s = 1.5\nseed = {}\npriority = [{priority}]\n\
                 friction_compensation = {{ gain = 0.8 }}\nstart_rad = {{ {} }}\n",
                seed % 1_000_000,
                self.start
            )
        };
        let rest = "[task.rest.joint-posture]\nfrequency_rad_per_s = 6.325\ndamping_ratio = 1.0\n";
        let flange = |x: &str, z: &str, frequency: f64| {
            format!(
                "{}[task.flange.cartesian]\nframe = \"flange\"\naxes = {{ x = \"{x}\", y = \"motion\", z = \"{z}\", \
                 rx = \"motion\", ry = \"motion\", rz = \"motion\" }}\ngains = {{ frequency_rad_per_s = {frequency:?}, \
                 damping_ratio = 1.0 }}\n",
                head("\"flange\", \"rest\"")
            )
        };
        let circle = |x: &str, z: &str| {
            let amplitude_m = 0.045 * self.arm.reach_m;
            format!(
                "[task.flange.cartesian.reference.sinusoid]\nramp_s = 1.0\n\
                 {x} = [{{ amplitude_m = {amplitude_m:?}, frequency_hz = 0.5 }}]\n\
                 {z} = [{{ amplitude_m = {amplitude_m:?}, frequency_hz = 0.4 }}]\n"
            )
        };
        let press = "force = { sensor = \"tip\", target_n = { z = 20.0 } }\n";
        let wall = format!(
            "[environment.table.wall]\nframe = \"flange\"\npoint_m = [0.0, 0.0, {:?}]\nnormal = [0.0, 0.0, 1.0]\n\
             stiffness_n_per_m = 10000.0\ndamping_ns_per_m = 50.0\n",
            self.height_m - 0.005
        );
        [
            ("tracking", format!("{}{}{rest}", flange("motion", "motion", 15.0), circle("x", "z"))),
            (
                "pressing",
                format!("{}{press}{}{rest}{wall}", flange("motion", "force", 15.0), circle("x", "y")),
            ),
            (
                "gravity compensation",
                format!(
                    "{}compensation = \"gravity\"\n[task.rest.joint-damping]\ndamping_nms_per_rad = 0.0\n{}",
                    head("\"rest\""),
                    hand(0.04)
                ),
            ),
            (
                "free compliance",
                format!(
                    "{}reference = \"hold\"\ncompliant_damping_per_s = 2.0\n{rest}{}",
                    flange("compliant", "motion", 15.0),
                    hand(0.025)
                ),
            ),
        ]
    }
}

/// Start posture near the arm's usual one, and the height of the flange there, m.
fn start(arm: &Arm, robot: &RobotDefinition, random: &mut impl Rng) -> (String, f64) {
    let model = &robot.model;
    let usual = USUAL.iter().find(|(folder, _)| *folder == arm.folder).expect("a posture").1;
    let q: Vec<f64> = usual.iter().map(|q| q + random.random_range(-0.25..0.25)).collect();
    let mut data = Data::new(model);
    assert!(update(model, &mut data, &q, DVector::zeros(q.len()).as_slice()), "a posture");
    let flange = model.frame_id(arm.frame).expect("the frame");
    let height_m = frame_placement(model, &data, flange).translation.z;
    let joints = model.joints().iter().zip(&q).map(|(joint, q)| format!("{} = {q:?}", joint.name));
    (joints.collect::<Vec<_>>().join(", "), height_m)
}
