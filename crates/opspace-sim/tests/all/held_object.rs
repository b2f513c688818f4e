//! Tests of objects that hands hold, against closed forms and conservation laws.

use crate::common::{arm, parsed, setup};
use nalgebra::{UnitQuaternion, Vector3};
use opspace_backend::{Backend, Command, CommandKind, GroundTruth, Sample, TruthRow};
use opspace_model::{Data, Model, Placement, forward_kinematics, frame_placement};
use opspace_sim::{
    ArmConfig, GripParameters, HeldObject, HeldObjectConfig, HeldObjectParameters, JointTorque, Key, Plant,
    PlantArm, PlantConfig, PlantFrame, PlantGrip, PlantObject, RigidPlant, Simulation, SimulationConfig,
    SimulationError,
};
use opspace_testing::allocation::allocations;

/// Duration of a step of the plant, s.
const STEP_S: f64 = 5e-5;

const G: f64 = 9.81;

const ZERO: Vector3<f64> = Vector3::new(0.0, 0.0, 0.0);

/// Gantry without weight: a hand of 3 kg on three slides, two of which move 1 kg each with it, and a frame `post` that is fixed to the world.
const GANTRY: &str = r#"<robot name="gantry">
  <link name="base"/><link name="post"/>
  <link name="a"><inertial><mass value="1"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <link name="b"><inertial><mass value="1"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <joint name="fixed" type="fixed"><parent link="base"/><child link="post"/></joint>
  <joint name="x" type="prismatic"><parent link="base"/><child link="a"/><axis xyz="1 0 0"/>
    <limit lower="-9" upper="9" effort="100" velocity="10"/></joint>
  <joint name="y" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
    <limit lower="-9" upper="9" effort="100" velocity="10"/></joint>
  <joint name="z" type="prismatic"><parent link="b"/><child link="hand"/><axis xyz="0 0 1"/>
    <limit lower="-9" upper="9" effort="100" velocity="10"/></joint>
  <link name="hand"><inertial><mass value="3"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
</robot>"#;

/// Mass that a gantry's hand moves along each axis, kg.
const HAND_KG: Vector3<f64> = Vector3::new(5.0, 4.0, 3.0);

fn gantry(at: Vector3<f64>) -> Model {
    let model = Model::from_urdf(GANTRY).expect("a gantry").model.with_gravity(ZERO);
    let base = Placement::from_rpy([0.0; 3], at.into()) * model.base();
    model.with_base(base)
}

/// Grip from the start of a hand of a gantry, or of its post.
fn grip(arm: usize, frame: &str, stiffness: f64, damping: f64) -> PlantGrip {
    PlantGrip {
        frame: PlantFrame { arm, frame: gantry(ZERO).frame_id(frame).expect("a frame") },
        stiffness_n_per_m: stiffness,
        damping_ns_per_m: damping,
        stiffness_nm_per_rad: 0.0,
        damping_nms_per_rad: 0.0,
        from_s: f64::NEG_INFINITY,
        until_s: f64::INFINITY,
    }
}

/// Object of 2 kg at the origin.
fn object(gravity: f64, grips: Vec<PlantGrip>) -> PlantObject {
    PlantObject {
        mass_kg: 2.0,
        inertia_kg_m2: Vector3::new(0.01, 0.02, 0.025),
        position_m: ZERO,
        gravity_m_per_s2: Vector3::new(0.0, 0.0, -gravity),
        supported_until_s: f64::NEG_INFINITY,
        grips,
    }
}

/// Returns a plant with gantries at these places.
fn plant(places: &[Vector3<f64>], object: PlantObject, step_s: f64) -> RigidPlant {
    let arms = places.iter().map(|at| PlantArm::new(gantry(*at), vec![0.0; 3])).collect();
    RigidPlant::new(PlantConfig { arms, couplings: Vec::new(), objects: vec![object], step_s })
}

/// Runs from `from_s` to `until_s` without torques, and calls `see` after each step with the time.
fn run(plant: &mut RigidPlant, from_s: f64, until_s: f64, mut see: impl FnMut(&mut RigidPlant, f64)) {
    let torques = vec![JointTorque::default(); plant.q().len()];
    let (first, last) = ((from_s / STEP_S).round() as i64, (until_s / STEP_S).round() as i64);
    for step in first..last {
        plant.step(step as f64 * STEP_S, STEP_S, &torques);
        see(plant, (step + 1) as f64 * STEP_S);
    }
}

/// Two places apart along y.
const APART: [Vector3<f64>; 2] = [Vector3::new(0.0, -0.2, 0.0), Vector3::new(0.0, 0.2, 0.0)];

/// Compared: forces on two hands at rest that hold a load, half its weight each, its sag `m g/(2 K)`, and the wrenches of
/// their force sensors.
#[test]
fn two_hands_carry_half_each() {
    // Damped for 3 s at 20 1/s: what is left of the oscillation is below rounding.
    const TOLERANCE: f64 = 1e-10;
    let grips = vec![grip(0, "post", 2000.0, 40.0), grip(1, "post", 2000.0, 40.0)];
    let mut plant = plant(&APART, object(G, grips.clone()), STEP_S);
    run(&mut plant, 0.0, 3.0, |_, _| {});
    for (arm, grip) in grips.iter().enumerate() {
        let weight = Vector3::new(0.0, 0.0, -G);
        assert!((plant.contact_force(arm, 0) - weight).norm() < TOLERANCE, "{}", plant.contact_force(arm, 0));
        assert!((plant.contact_wrench(grip.frame).linear - weight).norm() < TOLERANCE);
    }
    let sag = -2.0 * G / (2.0 * 2000.0);
    assert!((plant.held_object(0).position() - Vector3::new(0.0, 0.0, sag)).norm() < TOLERANCE);
    assert!(plant.held_object(0).orientation().angle() < TOLERANCE);
}

/// Compared: a load on two springs of resting hands without damping, and `z = sag (cos ω t − 1)` with `ω² = 2 K/m`.
#[test]
fn load_oscillates_on_two_springs() {
    let omega = (2.0_f64 * 2000.0 / 2.0).sqrt();
    let sag = G / omega.powi(2);
    let grips = vec![grip(0, "post", 2000.0, 0.0), grip(1, "post", 2000.0, 0.0)];
    let mut plant = plant(&APART, object(G, grips), STEP_S);
    let mut worst = 0.0_f64;
    run(&mut plant, 0.0, 5.0, |plant, t| {
        let expected = sag * ((omega * t).cos() - 1.0);
        worst = worst.max((plant.held_object(0).position().z - expected).abs());
    });
    // The midpoint steps change the frequency by a share (ω h)²/6 at most, and the amplitude in higher order.
    let tolerance = sag * omega * 5.0 * (omega * STEP_S).powi(2) / 6.0;
    assert!(worst < tolerance, "{worst} m, tolerance {tolerance} m");
}

/// Compared: energy and momentum of two free hands and of the object between them after a push, and those at the end of the
/// push. The grips have no damping, resist rotation, and hold the object away from its centre, so that it turns as well.
/// Momentum is exact, the error of the energy is that of the steps: halving the step divides it by four.
#[test]
fn momentum_and_energy_are_conserved() {
    const DURATION_S: f64 = 1.0;
    let errors = [4.0, 2.0, 1.0].map(|parts| {
        let step_s = parts * STEP_S;
        let grips: Vec<PlantGrip> = [0, 1]
            .map(|arm| PlantGrip {
                stiffness_nm_per_rad: 1.5 + arm as f64,
                ..grip(arm, "hand", 800.0 + 300.0 * arm as f64, 0.0)
            })
            .to_vec();
        let places = [Vector3::new(0.05, -0.2, 0.03), Vector3::new(-0.04, 0.1, 0.0)];
        let mut plant = plant(&places, object(0.0, grips.clone()), step_s);
        let pushed = (0.1 / step_s).round() as u32;
        let mut at_start = None;
        let mut worst = [0.0_f64; 2];
        let mut most_turned = 0.0_f64;
        for step in 0..(DURATION_S / step_s).round() as u32 {
            let torques = if step < pushed { [3.0, -9.0, 20.0, 1.0, 6.0, -15.0] } else { [0.0; 6] };
            plant.step(f64::from(step) * step_s, step_s, &torques.map(JointTorque::from));
            if step + 1 < pushed {
                continue;
            }
            let (energy, momentum) = totals(&plant, &places, &grips);
            let (e, p) = *at_start.get_or_insert((energy, momentum));
            worst = [worst[0].max((energy - e).abs() / e), worst[1].max((momentum - p).norm() / p.norm())];
            most_turned = most_turned.max(plant.held_object(0).orientation().angle());
        }
        assert!(most_turned > 0.2, "it turns: {most_turned} rad");
        // Rounding of some forces per step.
        assert!(worst[1] < 20_000.0 * 4.0 * f64::EPSILON, "momentum: {worst:?}");
        worst[0]
    });
    assert!(errors[2] < 1e-5, "energy: {errors:?}");
    for pair in errors.windows(2) {
        let order = (pair[0] / pair[1]).log2();
        assert!((1.8..2.3).contains(&order), "order {order}: {errors:?}");
    }
}

/// Energy (J) and momentum (kg m/s) of two gantries at these places, and of the object that they hold.
fn totals(plant: &RigidPlant, places: &[Vector3<f64>; 2], grips: &[PlantGrip]) -> (f64, Vector3<f64>) {
    let held = plant.held_object(0);
    let mut energy = kinetic(held);
    let mut momentum = held.velocity() * 2.0;
    for (arm, (at, grip)) in places.iter().zip(grips).enumerate() {
        let of_arm = |values: &[f64]| Vector3::from_column_slice(&values[3 * arm..3 * arm + 3]);
        let velocity = of_arm(plant.dq());
        // The object was at the origin when the grips began, and the hands at their places; hands do not turn.
        let stretch = held.position() + held.orientation() * at - (at + of_arm(plant.q()));
        energy += 0.5 * HAND_KG.component_mul(&velocity).dot(&velocity)
            + 0.5 * grip.stiffness_n_per_m * stretch.norm_squared()
            + 0.5 * grip.stiffness_nm_per_rad * held.orientation().angle().powi(2);
        momentum += HAND_KG.component_mul(&velocity);
    }
    (energy, momentum)
}

/// Compared: works on two arms that fall with an object whose orientation they hold, and the energy that the object and the
/// springs of the grips lose. The hands turn. Halving the step divides the error by four.
#[test]
fn turning_hands_get_what_the_object_loses() {
    let model = setup(CommandKind::Torque, "a-med").model;
    let hand = model.frame_id("hand").expect("a hand");
    let starts = [crate::common::START, [0.2, -0.3, 0.4, -1.0]];
    let pose = |q: &[f64]| {
        let mut data = Data::new(&model);
        forward_kinematics(&model, &mut data, q);
        let at = frame_placement(&model, &data, hand);
        (at.translation, UnitQuaternion::from_matrix(&at.rotation))
    };
    let relaxed = starts.map(|q| pose(&q));
    let stiffness = [(200.0, 3.0), (150.0, 5.0)];
    let errors = [1e-3, 5e-4, 2.5e-4].map(|step_s| {
        let grips = [0, 1].map(|arm| PlantGrip {
            frame: PlantFrame { arm, frame: hand },
            stiffness_n_per_m: stiffness[arm].0,
            stiffness_nm_per_rad: stiffness[arm].1,
            ..grip(0, "hand", 1.0, 0.0)
        });
        let object = PlantObject { position_m: Vector3::new(0.3, -0.1, 0.0), ..object(G, grips.to_vec()) };
        let at_start = object.position_m;
        let arms = starts.iter().map(|q| PlantArm::new(model.clone(), q.to_vec())).collect();
        let mut plant =
            RigidPlant::new(PlantConfig { arms, couplings: Vec::new(), objects: vec![object], step_s });
        for step in 0..(0.5 / step_s).round() as u32 {
            plant.step(f64::from(step) * step_s, step_s, &[JointTorque::default(); 8]);
        }
        let held = plant.held_object(0);
        let mut energy = kinetic(held) + 2.0 * G * (held.position() - at_start).z;
        let mut work = 0.0;
        for (arm, (x, rotation)) in relaxed.iter().enumerate() {
            let (now, turned) = pose(&plant.q()[4 * arm..4 * arm + 4]);
            assert!(turned.angle_to(rotation) > 0.3, "the hand turns");
            let stretch = held.position() + held.orientation() * (x - at_start) - now;
            let twist = (held.orientation() * rotation * turned.inverse()).angle();
            energy +=
                0.5 * stiffness[arm].0 * stretch.norm_squared() + 0.5 * stiffness[arm].1 * twist.powi(2);
            work += plant.contact_work(arm, 0);
        }
        assert!(work.abs() > 0.1, "{work} J");
        (work + energy).abs() / work.abs()
    });
    for pair in errors.windows(2) {
        let order = (pair[0] / pair[1]).log2();
        assert!((1.8..2.3).contains(&order), "order {order}: {errors:?}");
    }
}

/// Kinetic energy of the object, J.
fn kinetic(held: &HeldObject) -> f64 {
    let spin = held.orientation().inverse() * held.angular_velocity();
    held.velocity().norm_squared() // ½ 2 kg
        + 0.5 * spin.component_mul(&spin).dot(&Vector3::new(0.01, 0.02, 0.025))
}

/// Compared: works of an object on two hands, and their kinetic energies.
#[test]
fn works_are_the_kinetic_energies_of_the_hands() {
    let grips = vec![grip(0, "hand", 2000.0, 5.0), grip(1, "hand", 700.0, 1.0)];
    let mut plant = plant(&APART, object(G, grips), STEP_S);
    run(&mut plant, 0.0, 0.5, |_, _| {});
    for arm in 0..2 {
        let velocity = Vector3::from_column_slice(&plant.dq()[3 * arm..3 * arm + 3]);
        let kinetic = 0.5 * HAND_KG.component_mul(&velocity).dot(&velocity);
        let work = plant.contact_work(arm, 0);
        // Rounding of 10 000 steps.
        assert!((work - kinetic).abs() < 1e4 * f64::EPSILON * kinetic, "{work} J, {kinetic} J");
        assert!(kinetic > 1.0, "{kinetic} J");
    }
}

/// Compared: the object before and after a second hand takes it over, and the sag and tilt of an object on one hand,
/// `m g/K` and `m g l/K_r` with the lever l. The motion is continuous and remains within twice the static deflection.
#[test]
fn hand_over_moves_the_object_by_its_sag() {
    const LEVER_M: f64 = 0.1;
    const STIFFNESS: f64 = 3000.0;
    const ROTATIONAL: f64 = 60.0;
    let places = [Vector3::new(0.0, -LEVER_M, 0.0), Vector3::new(0.0, LEVER_M, 0.0)];
    let hold = |arm, from_s, until_s| PlantGrip {
        stiffness_nm_per_rad: ROTATIONAL,
        damping_nms_per_rad: 1.0,
        from_s,
        until_s,
        ..grip(arm, "post", STIFFNESS, 80.0)
    };
    let grips = vec![hold(0, f64::NEG_INFINITY, 2.0), hold(1, 1.0, f64::INFINITY)];
    let mut plant = plant(&places, object(G, grips), STEP_S);
    let (mut last, mut before, mut fastest, mut lowest) = (ZERO, ZERO, 0.0_f64, 0.0_f64);
    run(&mut plant, 0.0, 4.0, |plant, t| {
        let position = plant.held_object(0).position();
        if t > 0.5 {
            fastest = fastest.max((position - last).norm() / STEP_S);
        }
        if t < 2.0 {
            before = position;
        } else {
            lowest = lowest.min(position.z - before.z);
        }
        last = position;
    });
    let (tilt, sag) = (2.0 * G * LEVER_M / ROTATIONAL, 2.0 * G / STIFFNESS);
    let static_m = sag + LEVER_M * tilt;
    assert!((before.z + static_m).abs() < 0.02 * static_m, "{before}: on the first hand {static_m} m");
    // The second hand took it where it was, and now carries all of it: it tilts back by what the first let it tilt.
    let settled = last - before;
    assert!((settled.z + static_m).abs() < 0.02 * static_m, "{settled}: on the second hand {static_m} m");
    assert!(lowest > -2.0 * static_m, "{lowest} m while {static_m} m are static");
    // An oscillation of that amplitude has this velocity at most; a jump would have more than 100 m/s.
    let omega = (STIFFNESS / 2.0_f64).sqrt();
    assert!(fastest < static_m * omega, "{fastest} m/s");
    assert_eq!(plant.contact_force(0, 0), ZERO, "the first hand has let go");
    assert!((plant.contact_force(1, 0).z + 2.0 * G).abs() < 1e-3);
    // The moment of the weight about the hand, which is 2 l from the side of the first.
    let moment = plant.contact_moment(1, 0);
    assert!((moment - Vector3::new(2.0 * G * LEVER_M, 0.0, 0.0)).norm() < 0.02, "{moment}");
}

/// Compared: an object on a support, at its start; and after both grips have ended, and a fall from there.
#[test]
fn object_without_hands_falls() {
    let until = |grip: PlantGrip| PlantGrip { until_s: 0.8, ..grip };
    let grips = vec![until(grip(0, "post", 2000.0, 10.0)), until(grip(1, "hand", 900.0, 0.0))];
    let mut supported = object(G, grips);
    supported.supported_until_s = 0.3;
    let mut plant = plant(&APART, supported, STEP_S);
    run(&mut plant, -0.1, 0.3, |plant, _| assert_eq!(plant.held_object(0).position(), ZERO));
    run(&mut plant, 0.3, 0.8, |_, _| {});
    let (x, v) = (plant.held_object(0).position(), plant.held_object(0).velocity());
    assert!(x.z < -1e-3, "it sags: {x}");
    run(&mut plant, 0.8, 1.8, |_, _| {});
    let fallen = x + v + Vector3::new(0.0, 0.0, -0.5 * G);
    // Rounding of 20 000 steps of at most 10 m.
    assert!((plant.held_object(0).position() - fallen).norm() < 2e4 * 10.0 * f64::EPSILON);
    assert_eq!(plant.contact_force(0, 0), ZERO);
    assert_eq!(plant.contact_force(1, 0), ZERO);
}

/// Checks that no step allocates, also those in which grips begin and end, and neither do cycles of arms that hold a load.
#[test]
fn steps_do_not_allocate() {
    let late =
        PlantGrip { from_s: 0.1, until_s: 0.3, stiffness_nm_per_rad: 5.0, ..grip(1, "hand", 900.0, 1.0) };
    let mut plant = plant(&APART, object(G, vec![grip(0, "post", 2000.0, 10.0), late]), STEP_S);
    let torques = vec![JointTorque::default(); 6];
    let steps = || {
        for step in 0..10_000 {
            plant.step(f64::from(step) * STEP_S, STEP_S, &torques);
        }
    };
    assert_eq!(allocations(steps), 0);
    let mut arms = Simulation::new(two_arms(parameters(""))).expect("two arms").into_arms();
    let mut sample = Sample::new(arms[0].capabilities());
    let cycles = || {
        for _ in 0..100 {
            for arm in &mut arms {
                arm.read(&mut sample).expect("the arm can be read");
                arm.write(Command::Position(&crate::common::START)).expect("it takes them");
            }
        }
    };
    assert_eq!(allocations(cycles), 0);
}

/// Compared: motion of an object and of two different hands, and the same with the arms in the other order.
#[test]
fn order_of_arms_does_not_matter() {
    let after = |order: [usize; 2]| {
        let places = order.map(|arm| APART[arm]);
        let at = |arm: usize| order.iter().position(|index| *index == arm).expect("an arm");
        let grips = vec![grip(at(0), "hand", 2000.0, 5.0), grip(at(1), "hand", 700.0, 1.0)];
        let mut plant = plant(&places, object(G, grips), STEP_S);
        run(&mut plant, 0.0, 0.5, |_, _| {});
        let hands = [0, 1].map(|arm| Vector3::from_column_slice(&plant.q()[3 * at(arm)..3 * at(arm) + 3]));
        (plant.held_object(0).position(), plant.held_object(0).orientation(), hands)
    };
    assert_eq!(after([0, 1]), after([1, 0]));
}

fn parameters(more: &str) -> HeldObjectParameters {
    parsed(&format!(
        "mass_kg = 0.6\ninertia_kg_m2 = [0.002, 0.001, 0.002]\n{more}\n\
         grip = [\n\
         {{ robot = 'left', frame = 'hand', stiffness_n_per_m = 4000.0, damping_ns_per_m = 40.0 }},\n\
         {{ robot = 'right', frame = 'hand', stiffness_n_per_m = 4000.0, damping_ns_per_m = 40.0, \
         stiffness_nm_per_rad = 10.0, damping_nms_per_rad = 0.1 }},\n]"
    ))
}

/// Returns two arms side by side, and the load that they hold.
fn two_arms(parameters: HeldObjectParameters) -> SimulationConfig {
    let mut left = setup(CommandKind::Position, "a-med");
    let quality = left.simulated.force_sensor.get_mut("wrist").expect("the wrist");
    *quality = parsed("bandwidth_hz = 500.0\nnoise_n = 0.0\nnoise_nm = 0.0\nbias_n = 0.0\nbias_nm = 0.0");
    let right = ArmConfig {
        model: left.model.clone().with_base(Placement::from_rpy([0.0; 3], [0.0, -0.4, 0.0])),
        ..left.clone()
    };
    let arms = ["left", "right"].map(str::to_owned).to_vec();
    let load = HeldObjectConfig { name: "load".to_owned(), arms, parameters };
    SimulationConfig { arms: vec![left, right], couplings: Vec::new(), objects: vec![load] }
}

/// Checks the true rows of two arms that hold a load. Compared: the sum of the forces on both and the weight, the position of
/// the load and the middle of the hands less the sag, and the readings of the force sensors and the forces.
#[test]
fn arms_of_a_simulation_hold_a_load() {
    let config = two_arms(parameters("supported_until_s = 0.2"));
    let model = config.arms[0].model.clone();
    let mut arms = Simulation::new(config).expect("two arms").into_arms();
    let mut rows = [Vec::new(), Vec::new()];
    let mut samples = [0, 1].map(|index: usize| Sample::new(arms[index].capabilities()));
    for _ in 0..2000 {
        for ((arm, row), sample) in arms.iter_mut().zip(&mut rows).zip(&mut samples) {
            arm.read(sample).expect("the arm can be read");
            arm.visit(&mut |truth| {
                if let TruthRow::State { row: state, .. } = truth {
                    *row = state.to_vec();
                }
            });
            arm.write(Command::Position(&crate::common::START)).expect("it takes them");
        }
    }
    let names = |index: usize| -> Vec<String> {
        arms[index].layouts().truth.signals.iter().map(|signal| signal.name.clone()).collect()
    };
    let state = ["load.position", "load.orientation", "load.velocity"];
    assert_eq!(names(0), [&["q", "dq", "load.hand.force", "load.hand.work"][..], &state].concat());
    let right = ["q", "dq", "load.hand.force", "load.hand.moment", "load.hand.work"];
    assert_eq!(names(1), [&right[..], &state].concat());
    let forces = [0, 1].map(|index: usize| Vector3::from_column_slice(&rows[index][8..11]));
    assert!((forces[0] + forces[1] - Vector3::new(0.0, 0.0, -0.6 * G)).norm() < 1e-3, "{forces:?}");
    // Both arms record the same object.
    assert_eq!(rows[0][12..], rows[1][15..]);
    let [mut left, mut right] = [0, 1].map(|index: usize| {
        let mut data = Data::new(&model);
        forward_kinematics(&model, &mut data, arms[index].true_q().as_slice());
        let hand = model.frame_id("hand").expect("a hand");
        frame_placement(&model, &data, hand)
    });
    for ((sample, force), at) in samples.iter().zip(&forces).zip([&mut left, &mut right]) {
        let felt = at.rotation * Vector3::from_column_slice(&sample.wrenches[0][..3]);
        assert!((felt - force).norm() < 1e-2, "{felt} for {force}");
    }
    let moment = Vector3::from_column_slice(&rows[1][11..14]);
    let felt = right.rotation * Vector3::from_column_slice(&samples[1].wrenches[0][3..6]);
    assert!(moment.norm() > 1e-4 && (felt - moment).norm() < 1e-6, "{felt} for {moment}");
    let middle = (left.translation + right.translation + Vector3::new(0.0, -0.4, 0.0)) / 2.0;
    let position = Vector3::from_column_slice(&rows[0][12..15]);
    let sag = Vector3::new(0.0, 0.0, -0.6 * G / 8000.0);
    assert!((position - middle - sag).norm() < 1e-4, "{position} for {}", middle + sag);
    let orientation = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(
        rows[0][15],
        rows[0][16],
        rows[0][17],
        rows[0][18],
    ));
    assert!(orientation.angle() < 1e-2, "{orientation}");
}

/// Compared bit by bit: an arm beside a load that another arm holds, and the arm alone.
#[test]
fn load_of_another_arm_changes_nothing() {
    let mut parameters = parameters("");
    parameters.grip.remove(1);
    let mut arms = Simulation::new(two_arms(parameters)).expect("two arms").into_arms();
    let mut alone = arm(two_arms(self::parameters("")).arms[1].clone());
    for _ in 0..50 {
        for arm in [&mut arms[1], &mut alone] {
            let mut sample = Sample::new(arm.capabilities());
            arm.read(&mut sample).expect("the arm can be read");
            arm.write(Command::Position(&[0.0; 4])).expect("it takes them");
        }
    }
    assert_eq!(arms[1].true_q(), alone.true_q());
    assert_eq!(arms[1].layouts().truth.signals.len(), 2, "it logs no load");
}

/// Checks key and message of the error for each set of contradictory parameters.
#[test]
fn contradictory_objects_are_refused_by_name() {
    let late =
        |grip: &mut GripParameters| grip.from_s = Some(opspace_backend::quantity::NonNegative::literal(3.0));
    type Change<'a> = &'a dyn Fn(&mut HeldObjectParameters);
    let changes: [(Change<'_>, &[&str], &str); 8] = [
        (&|p| p.grip.clear(), &["grip"], "no hand ever holds"),
        (&|p| p.grip[1].robot = "rihgt".to_owned(), &["grip", "1", "robot"], "robots: left, right"),
        (&|p| p.grip[1].frame = "hnad".to_owned(), &["grip", "1", "frame"], "hnad"),
        (&|p| p.grip.iter_mut().for_each(late), &["position_m"], "missing"),
        (
            &|p| {
                late(&mut p.grip[1]);
                p.grip[1].until_s = Some(opspace_backend::quantity::Positive::literal(3.0));
            },
            &["grip", "1", "until_s"],
            "before it begins",
        ),
        (&|p| *p = parameters_with("[0.002, 0.001, 0.0031]"), &["inertia_kg_m2"], "sum of the other two"),
        (
            &|p| p.grip[0].stiffness_n_per_m = opspace_backend::quantity::Positive::literal(1e7),
            &["grip"],
            "1000 Hz",
        ),
        (
            &|p| p.grip[0].damping_ns_per_m = opspace_backend::quantity::NonNegative::literal(1e4),
            &["grip"],
            "less damping",
        ),
    ];
    for (change, key, words) in changes {
        let mut parameters = parameters("");
        change(&mut parameters);
        let error = Simulation::new(two_arms(parameters)).err().expect("refused");
        assert!(
            error.to_string().starts_with("objects.load") && error.to_string().contains(words),
            "{error}"
        );
        let path = ["objects", "load"].iter().chain(key).map(|part| (*part).to_owned());
        assert_eq!(error.key(), Key::Simulation(path.collect()));
    }
    let mut config = two_arms(parameters(""));
    config.objects.push(config.objects[0].clone());
    let error = Simulation::new(config).err().expect("refused");
    assert!(matches!(&error, SimulationError::HeldObject { object, .. } if object == "load"), "{error}");
    assert!(error.to_string().contains("the same name"), "{error}");
}

/// Parameters with these moments of inertia.
fn parameters_with(inertia: &str) -> HeldObjectParameters {
    parsed(&format!(
        "mass_kg = 0.6\ninertia_kg_m2 = {inertia}\n[[grip]]\nrobot = 'left'\nframe = 'hand'\n\
         stiffness_n_per_m = 4000.0\ndamping_ns_per_m = 40.0"
    ))
}
