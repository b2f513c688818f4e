//! Arms with random inertias, gears, friction, brakes and end stops over many orders of magnitude, and a motion of each that must
//! not gain energy.

use nalgebra::{DMatrix, DVector};
use opspace_backend::quantity::{Count, NonNegative, Positive};
use opspace_backend::{Backend, Capabilities, Command, CommandKind, DeviceFault, Sample};
use opspace_model::{Data, Model, crba, kinematics, kinetic_energy};
use opspace_sim::parameters::{BrakeParameters, BristleParameters, EndStopParameters, GearParameters};
use opspace_sim::random::{RngStream, generator};
use opspace_sim::{ArmConfig, SimulatedArm, SimulationError};
use rand::RngExt as _;
use std::fmt::Write as _;

/// Source of random numbers with the distributions that the draws need.
struct Draw(Box<dyn FnMut() -> f64>);

impl Draw {
    fn of(seed: u64) -> Self {
        let mut random = generator(seed, RngStream::Bus);
        Self(Box::new(move || random.random::<f64>()))
    }

    fn within(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * (self.0)()
    }

    /// Ten to the power of a number between these two.
    fn decades(&mut self, from: f64, to: f64) -> f64 {
        10f64.powf(self.within(from, to))
    }

    fn happens(&mut self, probability: f64) -> bool {
        (self.0)() < probability
    }

    fn positive(&mut self, from: f64, to: f64) -> Positive {
        Positive::try_from(self.decades(from, to)).expect("a positive number")
    }

    fn non_negative(&mut self, from: f64, to: f64) -> NonNegative {
        if self.happens(0.2) {
            return NonNegative::default();
        }
        NonNegative::try_from(self.decades(from, to)).expect("a number from zero on")
    }
}

/// Largest acceleration by the torques that drive a joint, rad/s²: what goes round in a few steps is no matter of stiffness.
const FASTEST_RAD_PER_S2: f64 = 500.0;

/// Largest acceleration of a joint by all torques together, rad/s²: the first step after the torques change is not divided.
const FASTEST_START_RAD_PER_S2: f64 = 20_000.0;

/// Range of each joint on both sides of zero, rad.
const RANGE_RAD: f64 = 1.0;

/// Largest energy of an arm over that which its motors, its weight and its gears can give it.
const LARGEST_RATIO: f64 = 1.5;

/// Draws each of which has shown a mistake: a stop on the link of an elastic gear in explicit steps, a rotor in several steps beside a
/// light link, gears judged at the start only or by stiffness and damping one at a time, joints that turn far in a step, a search that
/// creeps along a jump of the torque, and teeth that meet while several joints are stiff.
pub const FORMER_MISTAKES: [u64; 18] = [
    2, 96, 626, 1558, 1922, 2761, 3480, 4171, 4253, 5819, 6651, 9561, 9911, 13_018, 502_581, 506_693,
    507_269, 508_850,
];

/// Draws an arm for each seed. Returns the seeds whose arm `build` refuses, or which get more energy than they can have.
pub fn wrong_draws(
    seeds: impl IntoIterator<Item = u64>,
    build: impl Fn(ArmConfig) -> Result<SimulatedArm, SimulationError>,
) -> Vec<(u64, String)> {
    let result = |seed| {
        let config = random_arm(seed);
        let mut arm = build(config.clone()).map_err(|error| error.to_string())?;
        let ratio = largest_energy_ratio(&config, &mut arm).map_err(|fault| fault.to_string())?;
        if ratio < LARGEST_RATIO { Ok(()) } else { Err(format!("energy ratio {ratio}")) }
    };
    seeds.into_iter().filter_map(|seed| Some((seed, result(seed).err()?))).collect()
}

/// Returns an arm of one to three joints.
fn random_arm(seed: u64) -> ArmConfig {
    let draw = &mut Draw::of(seed);
    let n = 1 + draw.within(0.0, 2.999) as usize;
    let mut urdf = "<robot name=\"random\"><link name=\"l0\"/>".to_owned();
    for i in 1..=n {
        let (mass, length) = (draw.decades(-4.0, 1.5), draw.within(0.02, 0.5));
        let inertia = mass * (length * draw.decades(-2.0, -0.3)).powi(2);
        let axis = if draw.happens(0.5) { "0 1 0" } else { "0 0 1" };
        let (parent, centre) = (i - 1, draw.within(0.0, length));
        let _ = write!(
            urdf,
            "<joint name=\"j{i}\" type=\"revolute\"><parent link=\"l{parent}\"/><child link=\"l{i}\"/>\
             <origin xyz=\"{length} 0 0\"/><axis xyz=\"{axis}\"/>\
             <limit lower=\"-{RANGE_RAD}\" upper=\"{RANGE_RAD}\" effort=\"1\" velocity=\"10\"/></joint>\
             <link name=\"l{i}\"><inertial><origin xyz=\"{centre} 0 0\"/><mass value=\"{mass:e}\"/>\
             <inertia ixx=\"{inertia:e}\" iyy=\"{inertia:e}\" izz=\"{inertia:e}\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/>\
             </inertial></link>"
        );
    }
    let model = Model::from_urdf(&(urdf + "</robot>")).expect("a URDF").model;
    let names: Vec<String> = model.joints().iter().map(|joint| joint.name.clone()).collect();
    let capabilities =
        Capabilities::new(names.clone(), CommandKind::Torque, 1e-3).with_brakes(true).simulated();
    let mut config = ArmConfig::ideal(model, capabilities, Vec::new()).expect("an arm");
    config.profile.servo_ticks_per_cycle = Count::literal(1);
    config.profile.servo_hz = Positive::literal(1000.0);
    let rate = [1000.0, 2000.0, 5000.0, 10_000.0, 20_000.0][draw.within(0.0, 4.999) as usize];
    config.simulated.physics_hz = Positive::try_from(rate).expect("a rate");
    let strength = draw.decades(-2.0, 3.0);
    // Each spring is stated by its deflection under the torque that it bears, and its damper by a time.
    let spring = |draw: &mut Draw, torque: f64, softest: f64| {
        let stiffness = torque * draw.decades(softest, 4.0);
        let damping = if draw.happens(0.2) { 0.0 } else { stiffness * draw.decades(-5.0, -1.0) };
        let damping_nms_per_rad = NonNegative::try_from(damping).expect("a number from zero on");
        (Positive::try_from(stiffness).expect("a positive number"), damping_nms_per_rad)
    };
    let (stiffness_nm_per_rad, damping_nms_per_rad) = spring(draw, strength, 1.0);
    config.simulated.end_stop = Some(EndStopParameters { stiffness_nm_per_rad, damping_nms_per_rad });
    let holding_torque_ratio = draw.positive(-0.3, 1.0);
    let (stiffness_nm_per_rad, damping_nms_per_rad) =
        spring(draw, strength * holding_torque_ratio.get(), 1.0);
    config.simulated.brake =
        Some(BrakeParameters { holding_torque_ratio, stiffness_nm_per_rad, damping_nms_per_rad });
    let friction = strength * draw.decades(-4.0, 0.0);
    let (stiffness_nm_per_rad, damping_nms_per_rad) = spring(draw, friction, 2.0);
    config.simulated.bristle = Some(BristleParameters {
        stiffness_nm_per_rad,
        damping_nms_per_rad,
        damping_fade_velocity_rad_per_s: draw.positive(-2.0, 0.0),
    });
    let mut rotors = Vec::new();
    for (i, joint) in config.joints.iter_mut().enumerate() {
        let limit = strength * draw.decades(-1.0, 0.0);
        joint.torque_limit_nm = Positive::try_from(limit).expect("a positive number");
        let coulomb = friction * draw.decades(-1.0, 0.0);
        joint.friction.coulomb_nm = NonNegative::try_from(coulomb).expect("a number");
        joint.friction.static_nm = NonNegative::try_from(coulomb * draw.within(1.0, 1.5)).expect("a number");
        joint.friction.stribeck_rad_per_s = draw.positive(-3.0, 0.0);
        joint.friction.viscous_nms_per_rad = draw.non_negative(-5.0, 2.0);
        let is_elastic = draw.happens(0.5);
        let rotor = draw.decades(-8.0, 1.0);
        rotors.push(if is_elastic || draw.happens(0.7) { rotor } else { 0.0 });
        if is_elastic {
            let (stiffness, damping_nms_per_rad) = spring(draw, limit, 1.0);
            let gear = GearParameters {
                stiffness_nm_per_rad: Some(stiffness),
                damping_nms_per_rad,
                backlash_rad: if draw.happens(0.05) {
                    draw.non_negative(-4.0, -1.7)
                } else {
                    NonNegative::default()
                },
            };
            config.simulated.gear.insert(names[i].clone(), gear);
        }
        config.start[i] = draw.within(-0.99, 0.99) * RANGE_RAD;
    }
    config.model = config.model.with_rotor_inertia(&rotors);
    config.seed = seed;
    config
}

/// Moves an arm: its brakes hold it, constant torques drive it into its end stops, and the brakes stop it. Returns the largest
/// energy over that which the motors, gravity and the gears at the start can give it.
///
/// # Errors
/// The fault of the arm.
fn largest_energy_ratio(config: &ArmConfig, arm: &mut SimulatedArm) -> Result<f64, DeviceFault> {
    let n = config.model.n();
    let draw = &mut Draw::of(config.seed ^ 0x5eed);
    let model = config.model.clone().with_rotor_inertia(&vec![0.0; n]);
    let (mut data, mut sample) = (Data::new(&model), Sample::new(arm.capabilities()));
    kinematics(&model, &mut data, &config.start, &vec![0.0; n]);
    crba(&model, &mut data);
    let torque = |i: usize| {
        let inertia = data.mass_matrix[(i, i)] + config.model.rotor_inertia()[i];
        let limit = config.joints[i].torque_limit_nm.get().min(FASTEST_RAD_PER_S2 * inertia);
        limit * draw.within(-1.0, 1.0)
    };
    let torques = DVector::from_iterator(n, (0..n).map(torque));
    let rotors = DVector::from_column_slice(config.model.rotor_inertia());
    let inertias = &data.mass_matrix + DMatrix::from_diagonal(&rotors);
    let fastest = inertias.cholesky().map_or(0.0, |factor| factor.solve(&torques).amax());
    let torques = torques * (FASTEST_START_RAD_PER_S2 / fastest).min(1.0);
    let torques = torques.as_slice();
    let stop = config.simulated.end_stop.as_ref().map_or(0.0, |stop| stop.stiffness_nm_per_rad.get());
    let lengths = 0.5 * n as f64;
    let weight = model.total_mass() * 9.81;
    let mut worst: f64 = 0.0;
    for cycle in 0..120 {
        arm.read(&mut sample)?;
        let (q, dq) = (arm.true_q(), arm.true_dq());
        kinematics(&model, &mut data, q.as_slice(), dq.as_slice());
        let mut energy = kinetic_energy(&model, &data);
        // A load that is at rest on its brake, and can be less than the energy of rounding.
        let mut available = 1e-6 + 2.0 * weight * lengths;
        for i in 0..n {
            let beyond = (q[i].abs() - RANGE_RAD).max(0.0);
            energy += 0.5 * stop * beyond * beyond;
            available += torques[i].abs() * (2.0 * RANGE_RAD + beyond);
            let gear = config.simulated.gear.get(&config.model.joints()[i].name);
            let stiffness =
                gear.and_then(|gear| gear.stiffness_nm_per_rad).map_or(f64::INFINITY, Positive::get);
            available += (weight * lengths).powi(2) / stiffness;
        }
        worst = worst.max(energy / available);
        match cycle {
            20..80 => arm.write(Command::Torque(torques))?,
            80 => arm.write(Command::Hold)?,
            _ => {}
        }
    }
    Ok(worst)
}
