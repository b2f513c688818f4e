//! Random joints with the truth about them.
//!
//! A truth is the nominal value times a factor from 0.3 to 3, uniform in its logarithm. Combinations whose servo would
//! not be usable are drawn again: see [`Truth::is_usable`].

use opspace_backend::quantity::{Count, Fraction, NonNegative, Positive};
use opspace_backend::{Capabilities, CommandKind, Measured, Setpoints};
use opspace_identify::session::ExcitationSession;
use opspace_identify::{ExcitationPlan, Identification, KnownParameters, identify};
use opspace_model::{JointKind, Model};
use opspace_sim::parameters::{
    CurrentMeasurementParameters, GearParameters, ScaleParameters, SimulatedParameters,
};
use opspace_sim::{ArmConfig, SimulatedArm};
use opspace_transformer::SetpointFilter;
use opspace_transformer::{CascadedServo, FrictionParameters, RotorParameters, ServoParameters};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Name of the joint.
const JOINT: &str = "hinge";

/// Motor turns per joint turn.
const GEAR_RATIO: f64 = 100.0;

/// Least rate of the plant, Hz.
const PHYSICS_HZ: f64 = 16_000.0;

/// Error of the declaration, in addition to what an identification is for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Deceit {
    /// Measured over true motor torque; 1 if `None`.
    pub current_scale: Option<f64>,
    /// True inertia over that of URDF and rotor; 1 if `None`.
    pub inertia: Option<f64>,
    /// Speed limit, rad/s, that leaves too little room to separate Coulomb and viscous friction.
    pub speed_limit: Option<f64>,
    /// Feed-forward of the setpoint's velocity.
    pub feed_forward: Option<f64>,
    /// Cut-off of a setpoint filter of first order, Hz.
    pub setpoint_filter_hz: Option<f64>,
}

/// Kind of a case.
#[derive(Clone, Copy, Debug, Default)]
pub struct Kind {
    /// True if the robot measures no motor current.
    pub without_current: bool,
    /// Errors of the declaration.
    pub deceit: Deceit,
    /// Longest delay of setpoints, interface cycles; 1 if `None`.
    pub longest_delay_cycles: Option<u32>,
}

/// True parameters of a joint.
#[derive(Clone, Debug)]
pub struct Truth {
    pub kp: f64,
    pub kv: f64,
    pub filter_hz: f64,
    pub current_loop_hz: f64,
    pub delay: u32,
    /// Inertia of the link, and that of the rotor at the joint, kg m².
    pub link: f64,
    pub rotor: f64,
    pub coulomb: f64,
    pub static_friction: f64,
    pub stribeck: f64,
    pub viscous: f64,
    /// Stiffness (Nm/rad) and damping (Nms/rad) of an elastic gear.
    pub gear: Option<[f64; 2]>,
    pub torque_noise: f64,
    pub counts: u32,
    pub servo_hz: f64,
    pub ratio: u32,
    pub interpolated: bool,
    pub torque_limit: f64,
    pub speed_limit: f64,
    pub position_limit: f64,
    /// Mass (kg) at a distance (m) from the axis, which is horizontal.
    pub mass: f64,
    pub arm: f64,
}

impl Truth {
    /// Inertia that the servo moves, kg m².
    pub fn inertia(&self) -> f64 {
        self.link + self.rotor
    }

    /// True if the servo is damped and its velocity loop is far from instability: `kv ≥ kp I` (damping ratio ½ of the
    /// position loop), and a phase lag of the velocity loop at its crossover of at most half a radian, with the inertia
    /// that it moves there.
    fn is_usable(&self) -> bool {
        let lag_s = 1.5 / self.servo_hz + 1.0 / (TAU * self.filter_hz) + 1.0 / (TAU * self.current_loop_hz);
        let fast = if self.gear.is_some() { self.rotor } else { self.inertia() };
        self.kv >= self.kp * self.inertia() && self.kv / fast * lag_s < 0.5
    }

    fn draw(random: &mut ChaCha8Rng, elastic: bool) -> Self {
        let mut times =
            |nominal: f64| nominal * 10f64.powf(random.random_range(0.3f64.log10()..3f64.log10()));
        let (coulomb, stiffness) = (times(1.0), times(10_000.0));
        let mut truth = Self {
            kp: times(30.0),
            kv: times(22.0),
            filter_hz: times(500.0),
            current_loop_hz: times(1000.0),
            delay: 0,
            link: times(0.08),
            rotor: times(0.04),
            coulomb,
            static_friction: coulomb,
            stribeck: times(0.05),
            viscous: times(1.0),
            gear: elastic.then_some([stiffness, times(2.0)]),
            torque_noise: times(0.03),
            counts: 0,
            servo_hz: 0.0,
            ratio: 0,
            interpolated: false,
            torque_limit: times(40.0).max(10.0 * coulomb),
            speed_limit: times(4.0),
            position_limit: 0.0,
            mass: times(1.0),
            arm: 0.0,
        };
        truth.arm = 0.5 * (truth.link / truth.mass).sqrt();
        truth.static_friction *= random.random_range(1.0..1.5);
        let rates = [(5000.0, 5), (4000.0, 4), (2000.0, 4), (1000.0, 5), (8000.0, 8), (1000.0, 1)];
        (truth.servo_hz, truth.ratio) = rates[random.random_range(0..rates.len())];
        truth.delay = random.random_range(0..=truth.ratio);
        truth.counts = [2048, 4096, 16384, 65536][random.random_range(0..4)];
        truth.interpolated = random.random();
        truth.position_limit = random.random_range(0.8..3.0);
        truth
    }
}

/// A case: the truth, and what is declared about it.
pub struct Case {
    pub truth: Truth,
    pub kind: Kind,
    seed: u64,
}

impl Case {
    /// Case of this number and seed; every fourth has an elastic gear.
    pub fn new(number: usize, seed: u64, kind: Kind) -> Self {
        let stream = seed.wrapping_mul(0x9e37_79b9).wrapping_add(number as u64);
        let mut random = ChaCha8Rng::seed_from_u64(stream);
        let elastic = number % 4 == 3;
        let mut truth = Truth::draw(&mut random, elastic);
        while !truth.is_usable() {
            truth = Truth::draw(&mut random, elastic);
        }
        if let Some(limit) = kind.deceit.speed_limit {
            truth.speed_limit = limit;
        }
        if let Some(longest) = kind.longest_delay_cycles {
            truth.delay = random.random_range(0..=longest * truth.ratio);
        }
        Self { truth, kind, seed: stream % 100_000 }
    }

    /// Identifies the joint through the library.
    pub fn identify(&self) -> Identification {
        let mut arm = self.arm();
        let plan = ExcitationPlan { seed: self.seed, ..ExcitationPlan::default() };
        let interrupted = |_ticks: u64| false;
        let mut session = ExcitationSession::begin(&mut arm, &[JointKind::Revolute], &interrupted)
            .expect("a robot that holds itself");
        identify(&mut session, &self.known(), &plan).expect("a robot without faults")
    }

    /// Parameters that are known before the identification, according to URDF and data sheets.
    fn known(&self) -> KnownParameters {
        let truth = &self.truth;
        let inertia = truth.inertia() / self.kind.deceit.inertia.unwrap_or(1.0);
        KnownParameters {
            joint: 0,
            servo_period_s: 1.0 / truth.servo_hz,
            servo_ticks_per_cycle: truth.ratio,
            setpoints: truth.setpoints(),
            lower: -truth.position_limit,
            upper: truth.position_limit,
            speed_limit: truth.speed_limit,
            torque_limit: truth.torque_limit,
            resolution: truth.rotor_parameters().resolution_rad(),
            inertia: Some([inertia, inertia]),
            viscous_friction: if self.kind.without_current { truth.viscous } else { 0.0 },
        }
    }

    fn arm(&self) -> SimulatedArm {
        let truth = &self.truth;
        let rotor = truth.rotor_parameters();
        let model = Model::from_urdf(&urdf(truth)).expect("a URDF").model.with_rotor_inertia(&[truth.rotor]);
        let period_s = f64::from(truth.ratio) / truth.servo_hz;
        let current: &[Measured] = if self.kind.without_current { &[] } else { &[Measured::MotorCurrent] };
        let capabilities = Capabilities::new([JOINT], CommandKind::Position, period_s)
            .measuring(current)
            .with_setpoints(truth.setpoints())
            .simulated();
        let mut servo = CascadedServo::new(positive(truth.kp), positive(truth.kv), positive(truth.filter_hz));
        servo.velocity_feed_forward = fraction(self.kind.deceit.feed_forward.unwrap_or(0.0));
        servo.setpoint_filter = (self.kind.deceit.setpoint_filter_hz)
            .map(|hz| SetpointFilter::FirstOrder { cutoff_hz: positive(hz) });
        let servos = vec![ServoParameters::Cascaded(servo)];
        let mut config = ArmConfig::ideal(model, capabilities, servos).expect("a period");
        config.profile.servo_hz = positive(truth.servo_hz);
        config.profile.servo_ticks_per_cycle = Count::try_from(truth.ratio).expect("a count");
        config.joints[0].torque_limit_nm = positive(truth.torque_limit);
        config.joints[0].rotor = rotor;
        config.joints[0].friction = FrictionParameters {
            coulomb_nm: not_negative(truth.coulomb),
            static_nm: not_negative(truth.static_friction),
            stribeck_rad_per_s: positive(truth.stribeck),
            viscous_nms_per_rad: not_negative(truth.viscous),
            presliding_rad: Positive::literal(0.001),
        };
        let gear = truth.gear.map(|[stiffness, damping]| GearParameters {
            stiffness_nm_per_rad: Some(positive(stiffness)),
            damping_nms_per_rad: not_negative(damping),
            ..GearParameters::default()
        });
        config.simulated = SimulatedParameters {
            physics_hz: positive((PHYSICS_HZ / truth.servo_hz).round() * truth.servo_hz),
            current_loop_hz: Some(positive(truth.current_loop_hz)),
            torque_noise_nm: not_negative(truth.torque_noise),
            encoder_quantisation: true,
            bristle: None,
            true_over_nominal: ScaleParameters::default(),
            gear: gear.map(|gear| (JOINT.to_owned(), gear)).into_iter().collect(),
            current_measurement: CurrentMeasurementParameters {
                scale: positive(self.kind.deceit.current_scale.unwrap_or(1.0)),
                ..CurrentMeasurementParameters::default()
            },
            delay_servo_ticks: Some(truth.delay),
            ..config.simulated
        };
        config.seed = self.seed;
        SimulatedArm::new(config).expect("a joint that can be simulated")
    }
}

impl Truth {
    fn setpoints(&self) -> Setpoints {
        if self.interpolated { Setpoints::Interpolated } else { Setpoints::Held }
    }

    fn rotor_parameters(&self) -> RotorParameters {
        RotorParameters {
            inertia_kg_m2: not_negative(self.rotor / (GEAR_RATIO * GEAR_RATIO)),
            gear_ratio: positive(GEAR_RATIO),
            encoder_counts_per_turn: Count::try_from(self.counts).expect("a count"),
        }
    }
}

fn positive(value: f64) -> Positive {
    Positive::try_from(value).expect("a positive number")
}

fn not_negative(value: f64) -> NonNegative {
    NonNegative::try_from(value).expect("a number from zero")
}

fn fraction(value: f64) -> Fraction {
    Fraction::try_from(value).expect("a fraction")
}

/// Returns the URDF of the true link.
fn urdf(truth: &Truth) -> String {
    let Truth { link, mass, arm, position_limit, torque_limit, speed_limit, .. } = truth;
    let moment = link - mass * arm * arm;
    format!(
        r#"<robot name="{JOINT}"><link name="base"/>
  <joint name="{JOINT}" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
    <limit lower="-{position_limit}" upper="{position_limit}" effort="{torque_limit}" velocity="{speed_limit}"/></joint>
  <link name="arm"><inertial><origin xyz="{arm} 0 0"/><mass value="{mass}"/>
    <inertia ixx="{moment}" ixy="0" ixz="0" iyy="{moment}" iyz="0" izz="{moment}"/></inertial></link></robot>"#
    )
}
