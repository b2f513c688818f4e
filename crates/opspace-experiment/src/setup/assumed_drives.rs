//! Assumed drives of a robot of which only the URDF is known.
//!
//! Each value follows from masses and inertias of the links, and from the efforts of the URDF. The *size* of a drive is its
//! torque limit or, if that is less, ten times the torque that the joint needs for weight, acceleration and the friction of
//! the URDF: many URDFs state efforts that no such drive has.

use opspace_model::{Data, JointDynamics, JointKind, Model, Postures, crba, forward_kinematics, gravity};
use std::f64::consts::TAU;

/// Number of postures from which weight and inertia of a joint are the largest.
const POSTURES: usize = 100;
/// Acceleration that a drive is sized for, rad/s² (m/s²).
pub const ACCELERATION: f64 = 10.0;
/// Speed that a drive is sized for, rad/s (m/s).
const FRICTION_SPEED: f64 = 1.0;
/// Largest size of a drive over the torque that its joint needs.
const LARGEST_SIZE: f64 = 10.0;
/// Torque limit, where the URDF has none, over the torque of weight and acceleration.
pub const LIMIT_OVER_NEED: f64 = 3.0;
/// Speed limit of a rotating joint, rad/s, where the URDF has none.
pub const SPEED_RAD_PER_S: f64 = 2.0;
/// Speed limit of a sliding joint, m/s, where the URDF has none.
pub const SPEED_M_PER_S: f64 = 0.5;
/// Reflected inertia of a rotor over the size of its drive, kg m²/Nm: that of UR5e and Panda is 0.005 to 0.017.
pub const ROTOR_KG_M2_PER_NM: f64 = 0.008;
/// Reflected mass of a rotor over the size of its drive, kg/N: it accelerates itself by 20 m/s².
pub const ROTOR_KG_PER_N: f64 = 0.05;
/// Gear ratio of a rotating joint.
pub const GEAR_RATIO: f64 = 100.0;
/// Gear ratio of a sliding joint, rad/m: a spindle of 6.3 mm per turn.
pub const GEAR_RAD_PER_M: f64 = 1000.0;
/// Coulomb friction over the size of a drive: UR5e 0.045, ASIMO-like arm 0.045.
pub const COULOMB_SHARE: f64 = 0.03;
/// Viscous friction at the speed limit over the size of a drive.
pub const VISCOUS_SHARE: f64 = 0.1;
/// Bandwidth of the velocity loops, Hz.
pub const VELOCITY_LOOP_HZ: f64 = 25.0;
/// Gain of the position loops, 1/s.
pub const KP_PER_S: f64 = 40.0;

/// Assumed drive of a joint.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct AssumedDrive {
    /// Torque limit (Nm, N), if the URDF has none.
    pub torque_limit: Option<f64>,
    /// Speed limit (rad/s, m/s), if the URDF has none.
    pub velocity_limit: Option<f64>,
    /// Size of the drive, Nm (N).
    pub size: f64,
    /// Inertia of the rotor, kg m².
    pub rotor_kg_m2: f64,
    /// Gear ratio; rad/m for a sliding joint.
    pub gear_ratio: f64,
    /// Coulomb friction, Nm (N).
    pub coulomb: f64,
    /// Viscous friction, Nms/rad (Ns/m).
    pub viscous: f64,
    /// Presliding displacement, rad (m).
    pub presliding: f64,
}

impl AssumedDrive {
    /// Inertia of the rotor at the joint, kg m² (kg).
    #[must_use]
    pub fn reflected_inertia(&self) -> f64 {
        self.rotor_kg_m2 * self.gear_ratio * self.gear_ratio
    }
}

/// Rounds to three digits.
#[must_use]
pub fn rounded(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}

/// Returns the assumed drives of a robot (n). `dynamics` is the friction that the URDF states (n).
#[must_use]
pub fn assumed_drives(model: &Model, dynamics: &[JointDynamics]) -> Vec<AssumedDrive> {
    let n = model.n();
    let (mut weight, mut inertia) = (vec![0.0_f64; n], vec![0.0_f64; n]);
    let (mut data, postures) = (Data::new(model), Postures::new(model, 1.0));
    for number in 0..POSTURES {
        forward_kinematics(model, &mut data, &postures.posture(number));
        gravity(model, &mut data);
        crba(model, &mut data);
        for i in 0..n {
            weight[i] = weight[i].max(data.gravity[i].abs());
            inertia[i] = inertia[i].max(data.mass_matrix[(i, i)]);
        }
    }
    let drive = |(i, joint): (usize, &opspace_model::Joint)| {
        let slides = joint.kind == JointKind::Prismatic;
        let friction =
            dynamics[i].friction.unwrap_or(0.0) + FRICTION_SPEED * dynamics[i].damping.unwrap_or(0.0);
        let need = weight[i] + ACCELERATION * inertia[i] + friction;
        let (effort, speed) = (joint.limits.effort, joint.limits.velocity);
        let torque_limit = (!is_limit(effort)).then(|| rounded(LIMIT_OVER_NEED * need));
        let default_speed = if slides { SPEED_M_PER_S } else { SPEED_RAD_PER_S };
        let velocity_limit = (!is_limit(speed)).then_some(default_speed);
        let size = torque_limit.unwrap_or(effort).min(LARGEST_SIZE * need);
        let gear_ratio = if slides { GEAR_RAD_PER_M } else { GEAR_RATIO };
        let reflected = size * if slides { ROTOR_KG_PER_N } else { ROTOR_KG_M2_PER_NM };
        AssumedDrive {
            torque_limit,
            velocity_limit,
            size,
            rotor_kg_m2: rounded(reflected / (gear_ratio * gear_ratio)),
            gear_ratio,
            coulomb: rounded(COULOMB_SHARE * size),
            viscous: rounded(VISCOUS_SHARE * size / velocity_limit.unwrap_or(speed)),
            presliding: if slides { 1e-4 } else { 1e-3 },
        }
    };
    model.joints().iter().enumerate().map(drive).collect()
}

/// True for a limit of a URDF that is one: zero and huge values stand for no limit.
fn is_limit(limit: f64) -> bool {
    limit > 0.0 && limit <= 1e6
}

/// Gains of velocity loops of [`VELOCITY_LOOP_HZ`] for the inertia of each joint at `start`, with its rotor (n; Nms/rad,
/// Ns/m).
#[must_use]
pub fn velocity_gains(model: &Model, drives: &[AssumedDrive], start: &[f64]) -> Vec<f64> {
    let rotors: Vec<f64> = drives.iter().map(AssumedDrive::reflected_inertia).collect();
    servo_gains(&model.clone().with_rotor_inertia(&rotors), VELOCITY_LOOP_HZ, start)
}

/// Gains of velocity loops of this bandwidth (Hz) for the inertia of each joint at `start`, with its rotor (n; Nms/rad, Ns/m).
#[must_use]
pub fn servo_gains(model: &Model, velocity_loop_hz: f64, start: &[f64]) -> Vec<f64> {
    let mut data = Data::new(model);
    forward_kinematics(model, &mut data, start);
    crba(model, &mut data);
    (0..model.n()).map(|i| rounded(TAU * velocity_loop_hz * data.mass_matrix[(i, i)])).collect()
}
