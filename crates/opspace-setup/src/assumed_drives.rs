//! Assumed drives of a robot of which only the URDF is known.
//!
//! Each value follows from the *need* of a joint: the torque for weight and acceleration with a payload at the tip, and for the
//! friction of the URDF. No joint needs less than a share of what the joint before it needs: a last joint whose axis passes
//! through its centre of mass would otherwise get the motor of a watch. The torque limit is the effort of the URDF if that is
//! plausible, and otherwise follows from the need: many URDFs state efforts that no such drive has. It is the *size* of the drive,
//! from which rotor and friction follow. Small arms get [hobby servos](DriveKind::HobbyServo).

use nalgebra::{Matrix3, Vector3};
use opspace_experiment::postures::tip::{arms, tip};
use opspace_model::{
    Data, Inertia, Joint, JointDynamics, JointKind, Model, Postures, crba, forward_kinematics, gravity,
};
use std::f64::consts::TAU;

/// Number of postures from which weight and inertia of a joint are the largest.
const POSTURES: usize = 100;
/// Largest position of a joint in these postures, rad (m): a platform that can drive anywhere carries the same weight there.
pub const LARGEST_POSITION: f64 = 10.0;
/// Acceleration that a drive is sized for, rad/s² (m/s²).
pub const ACCELERATION: f64 = 10.0;
/// Speed that a drive is sized for, rad/s (m/s).
const FRICTION_SPEED: f64 = 1.0;
/// Payload that drives are sized for, over the mass that moves.
pub const PAYLOAD_SHARE: f64 = 0.1;
/// Distance of the centre of the payload from the tip over the reach: along the last axis, and across it.
const PAYLOAD_OFFSET: f64 = 0.06;
/// Least need of a joint over that of the joint before it.
pub const NEIGHBOUR_SHARE: f64 = 0.3;
/// Efforts of a URDF over the need that a drive can have.
pub const PLAUSIBLE_EFFORT: std::ops::RangeInclusive<f64> = 1.0..=30.0;
/// Torque limit, where the URDF has no plausible one, over the need.
pub const LIMIT_OVER_NEED: f64 = 2.0;
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

/// Largest moving mass of an arm with hobby servos, kg: that of a ViperX 300 S is 2.8 kg.
pub const HOBBY_MASS_KG: f64 = 3.0;
/// Largest length of an arm with hobby servos, m: the sum of the distances of its joints.
pub const HOBBY_LENGTH_M: f64 = 1.0;
/// Largest plausible effort of a hobby servo, Nm: two XM540-W270 together have 21 Nm.
const HOBBY_EFFORT_NM: f64 = 22.0;
/// Gear ratio of a hobby servo: that of an STS3215 is 345, that of an XM430-W350 is 353.5.
pub const HOBBY_GEAR_RATIO: f64 = 350.0;
/// Encoder steps of a hobby servo per turn of the joint: those of STS3215 and XM430.
pub const HOBBY_STEPS_PER_TURN: f64 = 4096.0;
/// Reflected inertia of a hobby servo over its size, kg m²/Nm: that of the SO-101's is 0.0147.
pub const HOBBY_KG_M2_PER_NM: f64 = 0.012;
/// Damping of a hobby servo over its size, 1/(rad/s): its speed without load is about 5 rad/s, where its torque vanishes.
pub const HOBBY_VISCOUS_S: f64 = 0.2;
/// Damping of a hobby servo that moves a slide over its size, 1/(m/s).
pub const HOBBY_VISCOUS_S_PER_M: f64 = 5.0;
/// Stiffness of the position loop of a hobby servo over its size, 1/rad: that of the SO-101's is 4.7 as LeRobot sets it, and at
/// most 9.3.
pub const HOBBY_STIFFNESS_PER_RAD: f64 = 6.0;
/// Stiffness of the position loop of a hobby servo that moves a slide over its size, 1/m: a finger moves by some millimetres.
pub const HOBBY_STIFFNESS_PER_M: f64 = 600.0;

/// Kind of drives that an arm of its size has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum DriveKind {
    /// Drives with velocity loops and fast interfaces.
    Industrial,
    /// Servos of a few newton metres on a serial bus, with proportional position loops without a velocity loop.
    HobbyServo,
}

impl DriveKind {
    /// Kind that an arm of a few kilograms and decimetres, or a larger one, has.
    #[must_use]
    pub fn of(model: &Model) -> Self {
        let Some(tip) = tip(model) else { return Self::Industrial };
        let chain: Vec<usize> = model.ancestors(tip).collect();
        let bodies = model.bodies();
        let moved = chain.iter().filter(|&&body| bodies[body].parent.is_some());
        let length_m = moved.map(|&body| bodies[body].origin.translation.norm()).sum::<f64>()
            + model.frame(tip).placement.translation.norm();
        let slides =
            chain.iter().any(|&body| model.joints()[bodies[body].joint].kind == JointKind::Prismatic);
        let is_small = model.total_mass() <= HOBBY_MASS_KG && length_m <= HOBBY_LENGTH_M;
        if is_small && !slides { Self::HobbyServo } else { Self::Industrial }
    }

    /// True for an effort of a URDF (Nm, N) that a drive with this need can have.
    fn is_plausible(self, effort: f64, need: f64) -> bool {
        let is_possible = self == Self::Industrial || effort <= HOBBY_EFFORT_NM;
        is_limit(effort) && is_possible && PLAUSIBLE_EFFORT.contains(&(effort / need))
    }
}

/// Assumed drive of a joint.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct AssumedDrive {
    /// Kind of the drives of the arm.
    pub kind: DriveKind,
    /// Torque limit (Nm, N), if the URDF has no plausible one.
    pub torque_limit: Option<f64>,
    /// Torque that the joint needs with a payload, Nm (N).
    pub need: f64,
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

/// Returns the assumed drives of a robot (n). `dynamics` is the friction that the URDF states (n); `payload_kg` is the payload of
/// each arm, or a share of the mass that moves.
#[must_use]
pub fn assumed_drives(
    model: &Model,
    dynamics: &[JointDynamics],
    payload_kg: Option<f64>,
    kind: DriveKind,
) -> Vec<AssumedDrive> {
    let needs = needs(model, dynamics, payload_kg.unwrap_or(PAYLOAD_SHARE * model.total_mass()));
    let drive = |(i, joint): (usize, &Joint)| {
        let slides = joint.kind == JointKind::Prismatic;
        let need = needs[i];
        let (effort, speed) = (joint.limits.effort, joint.limits.velocity);
        let torque_limit = (!kind.is_plausible(effort, need)).then(|| rounded(LIMIT_OVER_NEED * need));
        let default_speed = if slides { SPEED_M_PER_S } else { SPEED_RAD_PER_S };
        let velocity_limit = (!is_limit(speed)).then_some(default_speed);
        let size = torque_limit.unwrap_or(effort);
        let is_hobby = kind == DriveKind::HobbyServo;
        let [gear_ratio, reflected] = match (slides, is_hobby) {
            (true, _) => [GEAR_RAD_PER_M, ROTOR_KG_PER_N * size],
            (false, true) => [HOBBY_GEAR_RATIO, HOBBY_KG_M2_PER_NM * size],
            (false, false) => [GEAR_RATIO, ROTOR_KG_M2_PER_NM * size],
        };
        let viscous = match (slides, is_hobby) {
            (true, true) => HOBBY_VISCOUS_S_PER_M * size,
            (false, true) => HOBBY_VISCOUS_S * size,
            (_, false) => VISCOUS_SHARE * size / velocity_limit.unwrap_or(speed),
        };
        AssumedDrive {
            kind,
            torque_limit,
            need,
            velocity_limit,
            size,
            rotor_kg_m2: rounded(reflected / (gear_ratio * gear_ratio)),
            gear_ratio,
            coulomb: rounded(COULOMB_SHARE * size),
            viscous: rounded(viscous),
            presliding: match (slides, is_hobby) {
                (true, _) => 1e-4,
                // Not below the steps of the encoder.
                (false, true) => 5e-3,
                (false, false) => 1e-3,
            },
        }
    };
    model.joints().iter().enumerate().map(drive).collect()
}

/// Torques that the joints need with this payload on each arm (n; Nm, N).
fn needs(model: &Model, dynamics: &[JointDynamics], payload_kg: f64) -> Vec<f64> {
    let n = model.n();
    let loaded = with_payloads(model, payload_kg);
    let (mut weight, mut inertia) = (vec![0.0_f64; n], vec![0.0_f64; n]);
    let (mut data, postures) = (Data::new(&loaded), Postures::new(&loaded, 1.0));
    for number in 0..POSTURES {
        let mut q = postures.posture(number);
        q.iter_mut().for_each(|q| *q = q.clamp(-LARGEST_POSITION, LARGEST_POSITION));
        forward_kinematics(&loaded, &mut data, &q);
        gravity(&loaded, &mut data);
        crba(&loaded, &mut data);
        for i in 0..n {
            weight[i] = weight[i].max(data.gravity[i].abs());
            inertia[i] = inertia[i].max(data.mass_matrix[(i, i)]);
        }
    }
    let friction =
        |i: usize| dynamics[i].friction.unwrap_or(0.0) + FRICTION_SPEED * dynamics[i].damping.unwrap_or(0.0);
    let mut needs: Vec<f64> = (0..n).map(|i| weight[i] + ACCELERATION * inertia[i] + friction(i)).collect();
    for body in model.bodies().iter().filter(|body| !body.follows) {
        let Some(before) = body.parent.map(|parent| model.bodies()[parent].joint) else { continue };
        let is_same_kind = |a: usize, b: usize| {
            let slides = |joint: usize| model.joints()[joint].kind == JointKind::Prismatic;
            slides(a) == slides(b)
        };
        if is_same_kind(body.joint, before) {
            needs[body.joint] = needs[body.joint].max(NEIGHBOUR_SHARE * needs[before]);
        }
    }
    // A joint that moves along no weight and no inertia still has a drive.
    needs.into_iter().map(|need| need.max(1e-6)).collect()
}

/// Returns the robot with a payload at the tip of each arm.
fn with_payloads(model: &Model, payload_kg: f64) -> Model {
    let mut loaded = model.clone();
    let of_arms = arms(model).into_iter().filter_map(|arm| model.frame_id(&arm.to).ok());
    let mut bodies = Vec::new();
    for frame in tip(model).into_iter().chain(of_arms) {
        let at = model.frame(frame);
        let Some(body) = at.body.filter(|body| !bodies.contains(body)) else { continue };
        bodies.push(body);
        let reach_m: f64 =
            model.ancestors(frame).map(|body| model.bodies()[body].origin.translation.norm()).sum();
        let offset_m = PAYLOAD_OFFSET * (reach_m + at.placement.translation.norm());
        // The axis of the joint is z of its body.
        let centre = at.placement.translation + Vector3::new(offset_m, 0.0, offset_m);
        let own = loaded.add_frame_on("assumed payload", frame, at.placement.inverse());
        let sphere = Matrix3::identity() * (0.4 * payload_kg * offset_m * offset_m);
        loaded.set_payload(own, Inertia { mass: payload_kg, com: centre, rotational: sphere });
    }
    loaded
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
