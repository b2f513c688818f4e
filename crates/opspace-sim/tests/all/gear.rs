//! Elastic gears against closed forms of two masses on a spring, and against the rigid drivetrain.

use crate::common::{START, arm, parsed, read, robot, setup};
use nalgebra::DVector;
use opspace_backend::{Backend, Command, CommandKind};
use opspace_model::{Data, gravity, kinematics, kinetic_energy, potential_energy};
use opspace_sim::drivetrain::{Brake, Drivetrain, Encoder, EndStop};
use opspace_sim::friction::LuGre;
use opspace_sim::gear::{ElasticGear, GearConfig};
use opspace_sim::motor::Motor;
use opspace_sim::{
    ArmConfig, JointTorque, Key, Plant, PlantArm, PlantConfig, RigidPlant, SimulatedArm, SimulationError,
};
use std::f64::consts::TAU;

const DT: f64 = 5e-5;

/// Stiffness, inertia of the rotor and of the link: angular frequencies of 280 and 231 rad/s.
const STIFFNESS: f64 = 20_000.0;
const ROTOR: f64 = 0.8;
const LINK: f64 = 0.375;

/// Two masses on a gear: the link is integrated as the plant integrates its joints.
struct TwoMasses {
    gear: ElasticGear,
    q: f64,
    dq: f64,
}

impl TwoMasses {
    fn new(config: GearConfig, steps: f64) -> Self {
        Self { gear: ElasticGear::new(&config, steps, 0.0, 0.0), q: 0.0, dq: 0.0 }
    }

    /// Advances by a step under a torque of the motor and on the link.
    fn step(&mut self, motor: f64, link: f64) {
        let torque = self.gear.step(self.q, self.dq, DT, |_, _, _| motor);
        let ddq = (torque + link) / LINK;
        self.q += DT * (self.dq + 0.5 * DT * ddq);
        self.dq += DT * ddq;
    }

    fn energy(&self) -> f64 {
        self.gear.energy(self.q) + 0.5 * LINK * self.dq * self.dq
    }
}

fn gear(damping: f64, backlash: f64) -> GearConfig {
    GearConfig { stiffness: STIFFNESS, damping, backlash, inertia: ROTOR }
}

/// Compared: the period of the free vibration of rotor and link, and 2π/√(K (1/B + 1/M)). The method raises the
/// frequency by (ω h)²/24.
#[test]
fn free_vibration_has_two_mass_resonance() {
    let frequency = (STIFFNESS * (1.0 / ROTOR + 1.0 / LINK)).sqrt();
    for steps in [1.0, 4.0] {
        let mut masses = TwoMasses::new(gear(0.0, 0.0), steps);
        masses.dq = 1.0;
        let twist = |masses: &TwoMasses| masses.gear.position() - masses.q;
        let (mut crossings, mut before) = (Vec::new(), 0.0);
        for step in 1..40_000_u32 {
            masses.step(0.0, 0.0);
            let now = twist(&masses);
            if before < 0.0 && now >= 0.0 {
                crossings.push((f64::from(step) - now / (now - before)) * DT);
            }
            before = now;
        }
        let periods = (crossings.len() - 1) as f64;
        let measured = TAU * periods / (crossings[crossings.len() - 1] - crossings[0]);
        let error = measured / frequency - 1.0;
        assert!(periods > 80.0 && error.abs() < (frequency * DT).powi(2) / 12.0, "{steps}: {error}");
    }
}

/// Compared: at the antiresonance √(K/M) the rotor rests under an oscillating torque of the motor, and the link moves
/// with the amplitude of the torque over the stiffness.
#[test]
fn rotor_rests_at_antiresonance() {
    let frequency = (STIFFNESS / LINK).sqrt();
    let amplitude = 10.0;
    let mut masses = TwoMasses::new(gear(0.0, 0.0), 1.0);
    masses.dq = -amplitude / STIFFNESS * frequency;
    let (mut rotor, mut link) = (0.0_f64, 0.0_f64);
    for step in 0..4000_u32 {
        masses.step(amplitude * (frequency * (f64::from(step) + 0.5) * DT).sin(), 0.0);
        rotor = rotor.max(masses.gear.position().abs());
        link = link.max(masses.q.abs());
    }
    assert!((link * STIFFNESS / amplitude - 1.0).abs() < 0.02, "{link}");
    assert!(rotor < 0.02 * link, "rotor {rotor}, link {link}");
}

/// Compared: the energy of rotor, spring and link at any time, and at the start: constant within (ω h)² without damping,
/// with and without backlash and with several steps of the rotor; never above the start with damping.
#[test]
fn gear_creates_no_energy() {
    let frequency = (STIFFNESS * (1.0 / ROTOR + 1.0 / LINK)).sqrt();
    for (damping, backlash, steps) in [
        (0.0, 0.0, 1.0),
        (0.0, 0.0, 8.0),
        (0.0, 2e-3, 1.0),
        (0.0, 2e-3, 8.0),
        (30.0, 0.0, 1.0),
        (30.0, 2e-3, 1.0),
        (30.0, 2e-3, 8.0),
    ] {
        let mut masses = TwoMasses::new(gear(damping, backlash), steps);
        masses.dq = 1.0;
        let start = masses.energy();
        let (mut least, mut largest) = (start, start);
        for _ in 0..200_000 {
            masses.step(0.0, 0.0);
            least = masses.energy().min(least);
            largest = masses.energy().max(largest);
        }
        let tolerance = (frequency * DT).powi(2) * start;
        assert!(largest < start + tolerance, "{damping} {backlash} {steps}: {largest} of {start}");
        if damping == 0.0 {
            assert!(
                masses.energy() > start - tolerance && least > start - tolerance,
                "{backlash} {steps}: {least}"
            );
        } else {
            // What remains is the motion of both masses together: momentum is kept.
            let together = 0.5 * LINK * LINK / (LINK + ROTOR);
            assert!((masses.energy() - together).abs() < 0.05 * start, "{} for {together}", masses.energy());
        }
    }
}

/// Compared: the free play of the link with the rotor at rest, and the backlash; and the deflection under a torque
/// beyond it, torque over stiffness.
#[test]
fn link_has_free_play_of_backlash() {
    let backlash = 4e-3;
    let config = GearConfig { inertia: 1e9, ..gear(0.0, backlash) };
    let torque = |q: f64| ElasticGear::new(&config, 1.0, 0.0, 0.0).step(q, 0.0, DT, |_, _, _| 0.0);
    for inside in [-0.499, -0.2, 0.0, 0.3, 0.499] {
        assert_eq!(torque(inside * backlash), 0.0, "{inside}");
    }
    for direction in [-1.0, 1.0] {
        let beyond = torque(direction * (0.5 * backlash + 1e-3));
        assert!((beyond + direction * STIFFNESS * 1e-3).abs() < 1e-6, "{beyond}");
    }
    // At rest under a load, the rotor is ahead by half of the backlash and by the twist.
    for load in [-7.0, 7.0_f64] {
        let resting = ElasticGear::new(&config, 1.0, 0.5, load);
        let ahead = load / STIFFNESS + 0.5 * backlash * load.signum();
        assert!((resting.position() - 0.5 - ahead).abs() < 1e-12, "{}", resting.position());
    }
}

/// Checks that a rotor of a thousandth of the usual inertia, with all its friction and a brake, is stable on a stiff
/// gear: it follows its link.
#[test]
fn small_rotor_is_stable() {
    let simulated = robot().simulated;
    let friction =
        parsed("coulomb_nm = 1.8\nstatic_nm = 2.34\nstribeck_rad_per_s = 0.06\nviscous_nms_per_rad = 2.0");
    let config = GearConfig { stiffness: 320_000.0, damping: 10.0, backlash: 0.0, inertia: 1e-3 };
    let brake_stiffness = simulated.brake_of(40.0).stiffness_nm_per_rad.get()
        + simulated.bristle_of(&friction).stiffness_nm_per_rad.get();
    let brake_damping = simulated.brake_of(40.0).damping_nms_per_rad.get()
        + simulated.bristle_of(&friction).damping_nms_per_rad.get();
    let steps = config.steps(DT, brake_stiffness, brake_damping + 2.0);
    assert!(steps > 5.0, "{steps}");
    for braked in [false, true] {
        let mut drivetrain = Drivetrain::new(
            Motor::new(Some(1000.0), DT, 0.0),
            LuGre::new(&friction, &simulated.bristle_of(&friction), 1.0),
            EndStop::new(&opspace_model::Limits::NONE, &simulated.end_stop_of(40.0)),
            Brake::new(&simulated.brake_of(40.0), 50.0),
            Encoder::new(None),
        )
        .with_gear(ElasticGear::new(&config, steps, 0.0, 0.0));
        if braked {
            drivetrain.engage_brake(0.0);
        }
        let (mut q, mut dq) = (0.0, 2.0);
        for _ in 0..20_000 {
            drivetrain.drive(0.0);
            let ddq = drivetrain.begin_step(q, dq, DT).torque / LINK;
            q += DT * (dq + 0.5 * DT * ddq);
            dq += DT * ddq;
        }
        let twist = drivetrain.rotor_position(q) - q;
        assert!(dq.abs() < 1e-3 && twist.abs() < 1e-4, "braked {braked}: {dq} rad/s, {twist} rad");
    }
}

/// Returns the arm of the paper with elastic gears of this stiffness, Nm/rad.
fn elastic(command: CommandKind, stiffness: f64) -> ArmConfig {
    let mut config = setup(command, "a-med");
    for joint in config.model.joints().to_vec() {
        let gear = parsed(&format!("stiffness_nm_per_rad = {stiffness:.1}\ndamping_nms_per_rad = 5.0"));
        config.simulated.gear.insert(joint.name, gear);
    }
    config
}

fn weight(config: &ArmConfig, q: &DVector<f64>) -> DVector<f64> {
    let mut data = Data::new(&config.model);
    kinematics(&config.model, &mut data, q.as_slice(), &[0.0; 4]);
    gravity(&config.model, &mut data);
    data.gravity
}

/// Compared: at rest under its weight, the arm stays where it starts, and the encoders of the rotors are ahead of those
/// of the links by the torque over the stiffness.
#[test]
fn resting_arm_twists_its_gears_by_its_weight() {
    let mut config = elastic(CommandKind::Position, 20_000.0);
    let twist = weight(&config, &DVector::from_column_slice(&START)) / 20_000.0;
    let mut by_rotor = arm(config.clone());
    config.simulated.encoder.interface =
        parsed::<opspace_sim::parameters::EncoderParameters>("interface = \"link\"").interface;
    let mut by_link = arm(config);
    for _ in 0..300 {
        let (rotor, link) = (read(&mut by_rotor), read(&mut by_link));
        assert!((by_rotor.true_q() - DVector::from_column_slice(&START)).amax() < 1e-9);
        for joint in 0..4 {
            assert!((link.q[joint] - START[joint]).abs() < 1e-9);
            let ahead = rotor.q[joint] - link.q[joint];
            assert!((ahead - twist[joint]).abs() < 1e-9, "joint {joint}: {ahead} for {}", twist[joint]);
        }
    }
    assert!(twist.amax() > 1e-4, "{twist}");
}

/// Moves all setpoints and returns the true positions after each cycle.
fn motion(config: ArmConfig) -> Vec<DVector<f64>> {
    let mut arm = arm(config);
    (0..400)
        .map(|cycle| {
            let sample = read(&mut arm);
            let at = 0.1 * (TAU * 1.5 * f64::from(cycle) * 1e-3).sin();
            let setpoints: Vec<f64> = START.iter().map(|q| q + at).collect();
            arm.write(Command::Position(&setpoints)).expect("they are accepted");
            assert!(sample.q.iter().all(|q| q.is_finite()));
            arm.true_q()
        })
        .collect()
}

/// Compared: the motion of an arm with stiffer and stiffer gears, and that with rigid ones: the difference is
/// proportional to the compliance.
#[test]
fn stiff_gears_approach_rigid_ones() {
    let rigid = motion(setup(CommandKind::Position, "a-med"));
    let difference = |stiffness: f64| {
        let elastic = motion(elastic(CommandKind::Position, stiffness));
        rigid.iter().zip(elastic).map(|(a, b)| (a - b).amax()).fold(0.0, f64::max)
    };
    let differences = [1e5, 4e5, 1.6e6].map(difference);
    assert!(differences[0] < 1e-3, "{differences:?}");
    for pair in differences.windows(2) {
        let ratio = pair[0] / pair[1];
        assert!((2.5..6.0).contains(&ratio), "{ratio}: {differences:?}");
    }
}

/// Compared: energy of arm, rotors and springs of a swinging arm, and at the start.
#[test]
fn swinging_elastic_arm_conserves_energy() {
    /// Relative to the range of kinetic energy.
    const DRIFT: f64 = 2e-4;
    let config = setup(CommandKind::Torque, "a-med");
    let rotors: Vec<f64> = config.model.rotor_inertia().to_vec();
    let model = config.model.with_rotor_inertia(&[0.0; 4]);
    let simulated = robot().simulated;
    let mut drivetrains: Vec<Drivetrain> = (0..4)
        .map(|i| {
            let friction = &config.joints[i].friction;
            let gear = GearConfig { stiffness: 8000.0, damping: 0.0, backlash: 1e-3, inertia: rotors[i] };
            Drivetrain::new(
                Motor::new(None, DT, 0.0),
                LuGre::new(friction, &simulated.bristle_of(friction), 0.0),
                EndStop::new(&opspace_model::Limits::NONE, &simulated.end_stop_of(40.0)),
                Brake::new(&simulated.brake_of(40.0), 0.0),
                Encoder::new(None),
            )
            .with_gear(ElasticGear::new(&gear, 1.0, START[i], 0.0))
        })
        .collect();
    let arm = PlantArm::new(model.clone(), START.to_vec());
    let mut plant = RigidPlant::new(PlantConfig {
        arms: vec![arm],
        couplings: Vec::new(),
        objects: Vec::new(),
        step_s: DT,
    });
    let mut data = Data::new(&model);
    let mut energy = |plant: &RigidPlant, drivetrains: &[Drivetrain]| {
        kinematics(&model, &mut data, plant.q(), plant.dq());
        let gears: f64 = drivetrains
            .iter()
            .zip(plant.q())
            .map(|(joint, &q)| joint.gear().map_or(0.0, |gear| gear.energy(q)))
            .sum();
        let kinetic = kinetic_energy(&model, &data);
        (kinetic, kinetic + potential_energy(&model, &data) + gears)
    };
    let (_, start) = energy(&plant, &drivetrains);
    let (mut drift, mut fastest) = (0.0_f64, 0.0_f64);
    for step in 0..60_000_u32 {
        let torques: Vec<JointTorque> = (drivetrains.iter_mut().enumerate())
            .map(|(i, joint)| joint.begin_step(plant.q()[i], plant.dq()[i], DT))
            .collect();
        plant.step(f64::from(step) * DT, DT, &torques);
        let (kinetic, total) = energy(&plant, &drivetrains);
        (drift, fastest) = (drift.max((total - start).abs()), fastest.max(kinetic));
    }
    assert!(fastest > 1.0 && drift < DRIFT * fastest, "{drift} J of {fastest} J");
}

/// Compared: the position of a held torque robot, and its start minus the twist of gears and brakes under its weight.
#[test]
fn brakes_hold_the_rotors() {
    let mut config = elastic(CommandKind::Torque, 20_000.0);
    config.simulated.true_over_nominal = parsed("friction = 0.0");
    let brake = config.simulated.brake_of(40.0).stiffness_nm_per_rad.get();
    let mut arm = arm(config.clone());
    for _ in 0..600 {
        read(&mut arm);
    }
    // The gears were twisted already at the start.
    let deflected = DVector::from_column_slice(&START) - weight(&config, &arm.true_q()) / brake;
    let error = (arm.true_q() - deflected).amax();
    assert!(error < 1e-6, "{error}");
    let sample = read(&mut arm);
    assert!(arm.true_dq().amax() < 1e-3, "{}", arm.true_dq());
    assert!(sample.q.iter().zip(arm.true_q().iter()).any(|(rotor, link)| (rotor - link).abs() > 1e-4));
}

/// Checks the errors of gears that cannot be simulated: each names what is wrong, and its key.
#[test]
fn impossible_gears_are_refused() {
    let refused = |config: ArmConfig| match SimulatedArm::new(config) {
        Ok(_) => panic!("it is refused"),
        Err(error) => error,
    };
    let robot_key = |path: &[&str]| Key::Robot(path.iter().map(|&part| part.to_owned()).collect());
    let mut unknown = elastic(CommandKind::Position, 2e4);
    unknown.simulated.gear.insert("elbw".to_owned(), parsed("stiffness_nm_per_rad = 100.0"));
    let error = refused(unknown);
    assert_eq!(error.key(), robot_key(&["simulated", "gear", "elbw"]), "{error}");
    let mut empty = elastic(CommandKind::Position, 2e4);
    empty.simulated.gear.insert("elbow".to_owned(), parsed("damping_nms_per_rad = 1.0"));
    let error = refused(empty);
    assert!(matches!(error, SimulationError::GearStiffness { .. }), "{error}");
    assert_eq!(error.key(), robot_key(&["simulated", "gear", "elbow"]));
    let mut light = elastic(CommandKind::Position, 2e4);
    light.model = light.model.with_rotor_inertia(&[0.4, 0.4, 0.4, 0.0]);
    let error = refused(light);
    assert_eq!(error.key(), robot_key(&["joint", "elbow", "rotor"]), "{error}");
}

/// Compared: the motion with a stiffness in `[simulated.gear]`, with the nominal one of the joints, and with a scale: the
/// same, bit for bit.
#[test]
fn stiffness_is_nominal_scaled_or_true() {
    let mut nominal = elastic(CommandKind::Position, 1.0);
    for (joint, gear) in nominal.joints.iter_mut().zip(nominal.simulated.gear.values_mut()) {
        joint.gear_stiffness_nm_per_rad =
            parsed::<opspace_sim::parameters::GearParameters>("stiffness_nm_per_rad = 20000.0")
                .stiffness_nm_per_rad;
        gear.stiffness_nm_per_rad = None;
    }
    let mut scaled = elastic(CommandKind::Position, 80_000.0);
    scaled.simulated.true_over_nominal = parsed("gear_stiffness = 0.25");
    let expected = motion(elastic(CommandKind::Position, 20_000.0));
    assert_eq!(motion(nominal), expected);
    assert_eq!(motion(scaled), expected);
}
