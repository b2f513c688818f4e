//! Faults, each with the code of the diagnostic that must name it.

use crate::arms::Posture;
use crate::good::{Base, DURATION_S, Drawn, direction, one_of, tool};
use nalgebra::Vector3;
use opspace_experiment::{Code, ControllerKind};
use rand::{Rng, RngExt};
use std::f64::consts::TAU;

/// Kind of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// The sign of a target force.
    ForceSign,
    /// An approach in a direction without a surface, or too slow for its distance.
    Nowhere,
    /// A load on an axis that has become compliant.
    FallingLoad,
    /// A load that a joint cannot hold.
    HeavyLoad,
    /// A tool that a joint cannot hold.
    HeavyTool,
    /// A reference that jumps between two samples.
    Jump,
    /// A target force that a joint cannot exert.
    LargeForce,
    /// An encoder with too few counts.
    CoarseEncoder,
    /// Setpoints that are rounded too much.
    CoarseSetpoints,
    /// Filters of setpoints that look ahead for too long.
    SlowFilter,
    /// An interface that is too slow and late for the gains.
    SlowInterface,
    /// Axes that yield, with a controller of positions.
    IgnoredMode,
}

pub const KINDS: [Kind; 12] = [
    Kind::ForceSign,
    Kind::Nowhere,
    Kind::FallingLoad,
    Kind::HeavyLoad,
    Kind::HeavyTool,
    Kind::Jump,
    Kind::LargeForce,
    Kind::CoarseEncoder,
    Kind::CoarseSetpoints,
    Kind::SlowFilter,
    Kind::SlowInterface,
    Kind::IgnoredMode,
];

impl Kind {
    /// Code of the diagnostic that names the fault.
    pub fn code(self) -> Code {
        match self {
            Self::ForceSign => Code::PressesAway,
            Self::Nowhere => Code::NothingAhead,
            Self::FallingLoad => Code::CompliantDrift,
            Self::HeavyLoad | Self::HeavyTool => Code::WeightAboveLimit,
            Self::Jump => Code::ReferenceJump,
            Self::LargeForce => Code::ForceAboveLimit,
            Self::CoarseEncoder => Code::CoarseEncoder,
            Self::CoarseSetpoints => Code::CoarseSetpoints,
            Self::SlowFilter => Code::SlowSetpointFilter,
            Self::SlowInterface => Code::GainsTooHigh,
            Self::IgnoredMode => Code::IgnoredCompliance,
        }
    }

    /// Kind of task that can have the fault; `None` for all.
    pub fn base(self) -> Option<Base> {
        match self {
            Self::ForceSign | Self::Nowhere | Self::LargeForce => Some(Base::Press),
            Self::FallingLoad | Self::HeavyLoad => Some(Base::Carry),
            Self::Jump => Some(Base::Reach),
            Self::SlowInterface => Some(Base::Track),
            Self::IgnoredMode => Some(Base::Yield),
            _ => None,
        }
    }

    /// Faults that a task can have in addition.
    pub fn companions(self) -> Vec<Self> {
        let of_robots = [Self::HeavyTool, Self::SlowInterface, Self::CoarseEncoder, Self::CoarseSetpoints];
        match self {
            // Inverse kinematics does not produce torques.
            Self::IgnoredMode => vec![Self::HeavyTool],
            // A setpoint filter at a slow interface is another filter.
            Self::SlowFilter | Self::SlowInterface => vec![Self::HeavyTool, Self::CoarseSetpoints],
            _ => of_robots.into_iter().filter(|kind| *kind != self).collect(),
        }
    }

    pub fn inject(self, drawn: &mut Drawn, random: &mut impl Rng) {
        match self {
            Self::ForceSign => {
                if let Some(force) = &mut drawn.force {
                    force.target_n = -force.target_n;
                }
            }
            Self::Nowhere => nowhere(drawn, random),
            Self::FallingLoad => drawn.set_mode("z", "compliant"),
            Self::HeavyLoad => {
                let most_kg = posture(drawn).largest_mass_kg();
                drawn.load_kg = Some(most_kg * random.random_range(1.3..3.0));
            }
            Self::HeavyTool => {
                drawn.settings.retain(|setting| !setting.starts_with("robot.tool."));
                let most_kg = posture(drawn).largest_mass_kg();
                drawn.settings.push(tool(drawn.arm, most_kg * random.random_range(1.3..3.0)));
            }
            Self::Jump => jump(drawn, random),
            Self::LargeForce => {
                let state = posture(drawn);
                if let Some(force) = &mut drawn.force {
                    let toward = -force.target_n.signum() * direction(force.axis);
                    let most_n = state.largest_force_n(&toward);
                    force.target_n = force.target_n.signum() * most_n * random.random_range(1.3..3.0);
                }
            }
            Self::CoarseEncoder => coarse_encoder(drawn, random),
            Self::CoarseSetpoints => coarse_setpoints(drawn, random),
            Self::SlowFilter => slow_filter(drawn, random),
            Self::SlowInterface => slow_interface(drawn, random),
            Self::IgnoredMode => drawn.controller = ControllerKind::Ik,
        }
    }
}

fn posture(drawn: &Drawn) -> Posture {
    Posture::new(drawn.arm, &drawn.settings, &drawn.start)
}

fn nowhere(drawn: &mut Drawn, random: &mut impl Rng) {
    let Some((force, wall)) = drawn.force.as_mut().zip(drawn.wall.as_mut()) else { return };
    let toward = -wall.normal;
    match random.random_range(0..3) {
        // The wall is beside the hand, along another axis.
        0 => {
            let others: Vec<&str> = drawn
                .arm
                .axes
                .iter()
                .copied()
                .filter(|axis| axis.len() == 1 && *axis != force.axis)
                .collect();
            let beside = direction(one_of(random, &others)) * one_of(random, &[-1.0, 1.0]);
            wall.point += beside * 0.1;
            wall.normal = -beside;
        }
        // No wall at all.
        1 => drawn.wall = None,
        // Too slow for the distance.
        _ => {
            let distance_m = random.random_range(0.05..0.1);
            wall.point += toward * distance_m;
            force.approach_m_per_s = Some(distance_m / DURATION_S * random.random_range(0.2..0.8));
        }
    }
}

fn jump(drawn: &mut Drawn, random: &mut impl Rng) {
    let offset = Vector3::from(drawn.offset(random)).normalize() * drawn.arm.size_m;
    let [x, y, z]: [f64; 3] = offset.into();
    let within_s = random.random_range(0.001_f64..0.004);
    drawn.reference = match random.random_range(0..3) {
        0 => format!(
            "reference.point-to-point = {{ position = {{ offset_m = [{x:?}, {y:?}, {z:?}] }}, duration_s = {within_s:?} }}"
        ),
        1 => {
            let at_s = random.random_range(0.8..2.0);
            format!(
                "reference.waypoints = [{{ time_s = {at_s:?}, position = {{ offset_m = [0.0, 0.0, 0.0] }} }}, \
                 {{ time_s = {:?}, position = {{ offset_m = [{x:?}, {y:?}, {z:?}] }} }}]",
                at_s + within_s
            )
        }
        // An offset that is not ramped in.
        _ => {
            let axis = one_of(random, &drawn.translations());
            format!(
                "reference.sinusoid = {{ ramp_s = {within_s:?}, {axis} = [{{ amplitude_m = 0.0, frequency_hz = 0.5, offset_m = {:?} }}] }}",
                drawn.arm.size_m
            )
        }
    };
}

/// Names of the joint and of the profile of a robot fault, and the gains of that joint's servo.
struct Drive {
    joint: String,
    profile: String,
    stiffness: f64,
    damping: f64,
    torque_limit_nm: f64,
    gear_ratio: f64,
    period_s: f64,
}

fn drive(drawn: &Drawn, random: &mut impl Rng) -> Drive {
    let robot = drawn.arm.robot(&drawn.settings);
    let place = random.random_range(0..robot.model.n());
    let joint = robot.model.joints()[place].name.clone();
    let name = robot.file.default_profile.clone();
    let profile = &robot.file.profile[&name];
    let gains = profile.servo[&joint].gains(profile.servo_period_s());
    Drive {
        profile: name,
        stiffness: gains.stiffness,
        damping: gains.damping,
        torque_limit_nm: robot.torque_limits()[place],
        gear_ratio: robot.file.joint[&joint].rotor.gear_ratio.get(),
        period_s: profile.period_s(),
        joint,
    }
}

/// Torque error of a coarse resolution, as a share of the torque limit.
fn error(random: &mut impl Rng) -> f64 {
    random.random_range(0.08..0.4)
}

fn coarse_encoder(drawn: &mut Drawn, random: &mut impl Rng) {
    let drive = drive(drawn, random);
    let resolution_rad =
        error(random) * drive.torque_limit_nm * 12.0_f64.sqrt() * drive.period_s / drive.damping;
    let counts = (TAU / (resolution_rad * drive.gear_ratio)).floor().max(1.0);
    drawn.settings.push(format!("robot.joint.{}.rotor.encoder_counts_per_turn={counts:.0}", drive.joint));
}

fn coarse_setpoints(drawn: &mut Drawn, random: &mut impl Rng) {
    let drive = drive(drawn, random);
    let resolution_rad = error(random) * drive.torque_limit_nm * 12.0_f64.sqrt() / drive.stiffness;
    drawn.settings.push(format!("robot.joint.{}.setpoint_resolution_rad={resolution_rad:?}", drive.joint));
}

fn slow_filter(drawn: &mut Drawn, random: &mut impl Rng) {
    let drive = drive(drawn, random);
    // The look-ahead times of common interfaces. Filters of second order are refused: their inverse is unstable.
    let lag_s: f64 = random.random_range(0.05..0.25);
    let filter = format!("{{ first-order = {{ cutoff_hz = {:?} }} }}", 1.0 / (TAU * lag_s));
    drawn.settings.push(format!(
        "robot.profile.{}.servo.joint_defaults.cascaded.setpoint_filter={filter}",
        drive.profile
    ));
}

fn slow_interface(drawn: &mut Drawn, random: &mut impl Rng) {
    let drive = drive(drawn, random);
    let key = format!("robot.profile.{}", drive.profile);
    let robot = drawn.arm.robot(&drawn.settings);
    let servo_period_s = robot.file.profile[&drive.profile].servo_period_s();
    // Slower ones are refused.
    let rate_hz = random.random_range(50.5..70.0);
    let ticks = (1.0 / (rate_hz * servo_period_s)).round();
    drawn.settings.push(format!("{key}.servo_ticks_per_cycle={ticks:.0}"));
    drawn.settings.push(format!("{key}.delay_servo_ticks={ticks:.0}"));
    drawn.settings.push(format!("{key}.estimator={{ velocity_filter_hz = {:?} }}", 0.2 * rate_hz));
    drawn.frequency_rad_per_s = random.random_range(18.0..25.0);
}
