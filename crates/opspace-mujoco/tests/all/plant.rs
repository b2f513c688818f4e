//! Comparison of motions: MuJoCo's plant and the library's own, under the same torques.

use crate::common::{mujoco, project};
use nalgebra::Vector3;
use opspace_backend::SignalRecorder;
use opspace_experiment::{Files, RobotDefinition};
use opspace_model::{Data, forward_kinematics, frame_placement};
use opspace_sim::random::{RngStream, generator};
use opspace_sim::{
    EnvironmentObject, ExternalForce, JointTorque, PhysicsEngine, Plant, PlantArm, PlantConfig,
    PlantCoupling, PlantFrame, PlantGrip, PlantObject, Pull, RigidPlant,
};

/// Start of the arm, rad.
/// The rounding errors of 10 000 steps, rad, and what they are at springs of some kN/m, N.
const TOLERANCE_RAD: f64 = 1e-10;
const TOLERANCE_N: f64 = 1e-6;

/// Force that a contact has at least, N: it is compared in contact.
const LEAST_N: f64 = 1.0;
/// Largest difference of works on the two plants, J.
const TOLERANCE_J: f64 = 1e-7;
/// Work that each object of a test does at least, J.
const LEAST_J: f64 = 1e-3;

const START: [f64; 7] = [0.1, -0.7, 0.2, -2.2, 0.3, 1.5, 0.7];

fn panda() -> RobotDefinition {
    RobotDefinition::load(Files::Disk, &project("robots/panda"), &[]).expect("a robot")
}

fn config(step_s: f64) -> PlantConfig {
    let model = panda().model;
    PlantConfig {
        arms: vec![PlantArm::new(model, START.to_vec())],
        couplings: Vec::new(),
        objects: Vec::new(),
        step_s,
    }
}

/// Moves a plant for `duration_s` under smooth torques that are functions of time, and returns its positions.
fn positions_after(plant: &mut dyn Plant, step_s: f64, duration_s: f64) -> Vec<f64> {
    let n = plant.q().len();
    let steps = (duration_s / step_s).round() as u32;
    for step in 0..steps {
        let time_s = f64::from(step) * step_s;
        // Torques of the step's middle: constant torques over a step would be an error of second order of their own.
        let middle_s = time_s + 0.5 * step_s;
        let torque =
            |i: usize| JointTorque::from(8.0 * (5.0 * middle_s + i as f64).sin() / (1.0 + 0.5 * i as f64));
        plant.step(time_s, step_s, &(0..n).map(torque).collect::<Vec<_>>());
    }
    plant.q().to_vec()
}

fn difference(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Compared: positions after 0.5 s at the physics rate of the experiments.
#[test]
fn falling_arm_moves_as_on_the_own_plant() {
    const STEP_S: f64 = 5e-5;
    let Some(mujoco) = mujoco(None) else { return };
    let mut plant = mujoco.build(config(STEP_S)).expect("a plant");
    let q = positions_after(&mut *plant, STEP_S, 0.5);
    let own = positions_after(&mut RigidPlant::new(config(STEP_S)), STEP_S, 0.5);
    println!("after a motion of {:.2} rad: {:.1e} rad", difference(&q, &START), difference(&q, &own));
    assert!(difference(&q, &START) > 0.5);
    assert!(difference(&q, &own) < TOLERANCE_RAD, "{q:?} instead of {own:?}");
}

/// Checks that halving the step divides the error by four. Compared: positions after 0.2 s, and those with a step of an
/// eighth of the shortest.
#[test]
fn steps_are_of_second_order() {
    const STEP_S: f64 = 1e-3;
    let Some(mujoco) = mujoco(None) else { return };
    let after = |step_s: f64| {
        let mut plant = mujoco.build(config(step_s)).expect("a plant");
        positions_after(&mut *plant, step_s, 0.2)
    };
    let exact = after(STEP_S / 32.0);
    let errors = [1.0, 2.0, 4.0].map(|parts| difference(&after(STEP_S / parts), &exact));
    println!("errors with steps of 1, 0.5 and 0.25 ms: {errors:?} rad");
    for pair in errors.windows(2) {
        let order = (pair[0] / pair[1]).log2();
        assert!((1.8..2.2).contains(&order), "order {order:.2}: {errors:?}");
    }
}

/// Compared: positions of an arm that falls for 0.5 s under constant torques, on the library's own plant at the physics rate of
/// the experiments, and by MuJoCo's own Runge–Kutta steps of twice the length.
#[test]
fn midpoint_steps_agree_with_runge_kutta_steps_of_mujoco() {
    const STEP_S: f64 = 5e-5;
    const TOLERANCE_RAD: f64 = 1e-7;
    let Some(mujoco) = mujoco(None) else { return };
    let torques = [5.0, -8.0, 4.0, 6.0, -1.0, 0.5, 0.3];
    let config = config(STEP_S);
    let other = mujoco.runge_kutta(&config.arms[0], &torques, 2.0 * STEP_S, 5000).expect("an arm");
    let mut plant = RigidPlant::new(config);
    for step in 0..10_000 {
        plant.step(f64::from(step) * STEP_S, STEP_S, &torques.map(JointTorque::from));
    }
    let (apart, travel) = (difference(plant.q(), &other), difference(plant.q(), &START));
    println!("midpoint steps: {apart:.1e} rad from MuJoCo's Runge-Kutta steps after {travel:.2} rad");
    assert!(travel > 0.5 && apart < TOLERANCE_RAD, "{apart:e} rad");
}

/// Compared: the motion of an arm among objects with states of their own, on both plants, the forces of these objects and the
/// states that they record.
#[test]
fn environment_acts_as_on_the_own_plant() {
    const STEP_S: f64 = 5e-5;
    let Some(mujoco) = mujoco(None) else { return };
    let model = panda().model;
    let flange = model.frame_id("flange").expect("a flange");
    let mut data = Data::new(&model);
    forward_kinematics(&model, &mut data, &START);
    let at = frame_placement(&model, &data, flange).translation;
    let texts = [
        format!(
            "[wall]\nframe = 'flange'\npoint_m = [{}, {}, {}]\nnormal = [0.0, 0.0, 1.0]\nstiffness_n_per_m = 5e3\n\
             damping_ns_per_m = 20.0\nfriction = {{ coefficient = 0.3 }}",
            at.x,
            at.y,
            at.z + 0.01
        ),
        "[mass]\nframe = 'flange'\nmass_kg = 0.5".to_owned(),
        "[drawer]\nframe = 'flange'\ndirection = [0.0, 1.0, 0.0]\nmass_kg = 1.0\ntravel_m = 0.3\nopening_m = 0.1\n\
         friction_n = 2.0"
            .to_owned(),
    ];
    let config = || {
        let mut arm = PlantArm::new(model.clone(), START.to_vec());
        arm.contacts = texts
            .iter()
            .map(|text| {
                let parameters = toml::from_str(text).expect("an object");
                let random = generator(1, RngStream::EnvironmentObject(0));
                (flange, EnvironmentObject::new(&parameters, at, model.gravity(), random))
            })
            .collect();
        PlantConfig { arms: vec![arm], couplings: Vec::new(), objects: Vec::new(), step_s: STEP_S }
    };
    let moved = |mut plant: Box<dyn Plant>| {
        let q = positions_after(&mut *plant, STEP_S, 0.3);
        let forces = [0, 1, 2].map(|contact| plant.contact_force(0, contact));
        let work = [0, 1, 2].map(|contact| plant.contact_work(0, contact));
        let mut row = vec![0.0; 8];
        let mut out = SignalRecorder::sampling(&mut row);
        for contact in 0..3 {
            plant.environment_object(0, contact).expect("an object").record("thing", &mut out);
        }
        (q, forces, row, work)
    };
    let own = moved(Box::new(RigidPlant::new(config())));
    let other = moved(mujoco.build(config()).expect("a plant"));
    assert!(difference(&own.0, &other.0) < TOLERANCE_RAD && difference(&own.0, &START) > 0.01);
    for (own, other) in own.1.iter().zip(&other.1) {
        assert!((own - other).norm() < TOLERANCE_N && own.norm() > LEAST_N, "{own} {other}");
    }
    assert!(difference(&own.2, &other.2) < TOLERANCE_N, "{:?} {:?}", own.2, other.2);
    assert!(difference(&own.3, &other.3) < TOLERANCE_J, "{:?} {:?}", own.3, other.3);
    assert!(own.3.iter().all(|work| work.abs() > LEAST_J), "{:?}", own.3);
}

/// Compared: the motion of two coupled arms that hold an object, of which one is pulled, on both plants, and the forces and
/// the motion of the object that the plants report.
#[test]
fn couplings_and_external_forces_act_as_on_the_own_plant() {
    const STEP_S: f64 = 1e-4;
    let Some(mujoco) = mujoco(None) else { return };
    let model = panda().model;
    let flange = model.frame_id("flange").expect("a flange");
    let frames = [0, 1].map(|arm| PlantFrame { arm, frame: flange });
    let coupling = PlantCoupling { frames, stiffness_n_per_m: 500.0, damping_ns_per_m: 10.0 };
    let hold = |frame, lever_nm: f64| PlantGrip {
        frame,
        stiffness_n_per_m: 2000.0,
        damping_ns_per_m: 5.0,
        stiffness_nm_per_rad: lever_nm,
        damping_nms_per_rad: 0.0,
        from_s: f64::NEG_INFINITY,
        until_s: f64::INFINITY,
    };
    let object = PlantObject {
        mass_kg: 1.5,
        inertia_kg_m2: Vector3::new(0.01, 0.02, 0.02),
        position_m: Vector3::new(0.4, 0.1, 0.5),
        gravity_m_per_s2: model.gravity(),
        supported_until_s: 0.1,
        grips: vec![hold(frames[0], 0.0), hold(frames[1], 5.0)],
    };
    let config = || {
        let mut second = START;
        second[0] += 0.4;
        let arms = [START, second].map(|q| PlantArm::new(model.clone(), q.to_vec())).to_vec();
        PlantConfig { arms, couplings: vec![coupling], objects: vec![object.clone()], step_s: STEP_S }
    };
    let pull = Pull::Wrench(opspace_model::Force {
        linear: Vector3::new(10.0, -20.0, 30.0),
        angular: Vector3::new(1.0, 0.5, -1.0),
    });
    let moved = |mut plant: Box<dyn Plant>| {
        plant.push(1, Some(ExternalForce { frame: flange, pull }));
        let q = positions_after(&mut *plant, STEP_S, 0.3);
        let wrench = plant.contact_wrench(frames[1]);
        let object = plant.held_object(0);
        let held =
            (object.position(), object.orientation(), plant.contact_moment(1, 1), plant.contact_work(1, 1));
        (q, plant.contact_force(0, 0), plant.external_force(1), wrench, held)
    };
    let own = moved(Box::new(RigidPlant::new(config())));
    let other = moved(mujoco.build(config()).expect("a plant"));
    assert!(difference(&own.0, &other.0) < TOLERANCE_RAD);
    assert!((own.1 - other.1).norm() < TOLERANCE_N && own.1.norm() > LEAST_N, "{} {}", own.1, other.1);
    assert_eq!(own.2, other.2);
    assert!((own.3.linear - other.3.linear).norm() < TOLERANCE_N && own.3.linear.norm() > LEAST_N);
    let [(position, orientation, moment, work), other] = [own.4, other.4];
    assert!((position - other.0).norm() < TOLERANCE_RAD && orientation.angle_to(&other.1) < TOLERANCE_RAD);
    assert!(orientation.angle() > 0.1, "it turns");
    assert!((moment - other.2).norm() < TOLERANCE_N && moment.norm() > 0.1 * LEAST_N, "{moment}");
    assert!((work - other.3).abs() < TOLERANCE_J && work.abs() > LEAST_J, "{work}");
}
