//! Tests of the work of contact forces against the energy of the robot.

use crate::common::{START, object, setup};
use nalgebra::Vector3;
use opspace_backend::CommandKind;
use opspace_model::{
    Data, Model, forward_kinematics, frame_placement, kinematics, kinetic_energy, potential_energy,
};
use opspace_sim::random::{RngStream, generator};
use opspace_sim::{
    EnvironmentObject, JointTorque, Plant, PlantArm, PlantConfig, PlantCoupling, PlantFrame, RigidPlant,
};

/// Mass of 2 kg on a horizontal slide.
const SLIDER: &str = r#"<robot name="slider">
  <link name="base"/>
  <joint name="slide" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" effort="100" velocity="10"/></joint>
  <link name="cart"><inertial><mass value="2"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
</robot>"#;

fn placed(text: &str, home: Vector3<f64>, model: &Model) -> EnvironmentObject {
    EnvironmentObject::new(
        &object(text),
        home,
        model.gravity(),
        generator(1, RngStream::EnvironmentObject(0)),
    )
}

/// Compared: work of a spring since the start of control, and the kinetic energy that a slider has gained since then. With
/// a constant mass they are equal but for rounding.
#[test]
fn work_is_exactly_the_kinetic_energy_of_a_slider() {
    const STEP_S: f64 = 5e-5;
    const STEPS: u32 = 20_000;
    let model = Model::from_urdf(SLIDER).expect("a slider").model;
    let cart = model.frame_id("cart").expect("a cart");
    let spring = "[spring]\nframe = 'cart'\nstiffness_n_per_m = 300.0\ndamping_ns_per_m = 3.0\n\
                  point_m = [0.2, 0.0, 0.0]\nmotion.still = {}";
    let mut arm = PlantArm::new(model.clone(), vec![0.0]);
    arm.contacts = vec![(cart, placed(spring, Vector3::zeros(), &model))];
    let config = PlantConfig { arms: vec![arm], couplings: Vec::new(), objects: Vec::new(), step_s: STEP_S };
    let mut plant = RigidPlant::new(config);
    let kinetic = |plant: &RigidPlant| plant.dq()[0].powi(2);
    let (mut at_start, mut least, mut most) = (f64::NAN, f64::INFINITY, f64::NEG_INFINITY);
    for step in 0..STEPS {
        // Control starts in the middle.
        let time_s = (f64::from(step) - f64::from(STEPS / 2)) * STEP_S;
        if step == STEPS / 2 {
            at_start = kinetic(&plant);
        }
        plant.step(time_s, STEP_S, &[JointTorque::default()]);
        let work = plant.contact_work(0, 0);
        if step < STEPS / 2 {
            assert_eq!(work, 0.0, "before the start of control");
        } else {
            // Each step rounds energies of at most 6 J a few times.
            let tolerance = f64::from(STEPS) * 6.0 * f64::EPSILON;
            let gained = kinetic(&plant) - at_start;
            assert!((work - gained).abs() < tolerance, "{work} J of {gained} J");
            (least, most) = (least.min(work), most.max(work));
        }
    }
    assert!(most - least > 1.0, "the energy varies: {least} to {most} J");
}

/// Two arms without friction, and the works of their contacts.
struct Pair {
    plant: RigidPlant,
    model: Model,
    data: Data,
}

impl Pair {
    /// Returns two arms with different start positions. An operator holds the first, a mass hangs at the second, and a spring
    /// of `stiffness` (N/m) and `damping` (Ns/m) connects their hands.
    fn new(step_s: f64, stiffness: f64, damping: f64) -> Self {
        let model = setup(CommandKind::Torque, "a-med").model;
        let hand = model.frame_id("hand").expect("a hand");
        let mut data = Data::new(&model);
        let mut arm = |q: [f64; 4], text: &str| {
            forward_kinematics(&model, &mut data, &q);
            let home = frame_placement(&model, &data, hand).translation;
            let mut arm = PlantArm::new(model.clone(), q.to_vec());
            arm.contacts = vec![(hand, placed(text, home, &model))];
            arm
        };
        let operator =
            "[spring]\nframe = 'hand'\nstiffness_n_per_m = 200.0\ndamping_ns_per_m = 4.0\nmotion.still = {}";
        let load = "[mass]\nframe = 'hand'\nmass_kg = 0.5\nfrequency_hz = 5.0";
        let arms = vec![arm(START, operator), arm([0.2, -0.3, 0.4, -1.0], load)];
        let frames = [0, 1].map(|arm| PlantFrame { arm, frame: hand });
        let coupling = PlantCoupling { frames, stiffness_n_per_m: stiffness, damping_ns_per_m: damping };
        let config = PlantConfig { arms, couplings: vec![coupling], objects: Vec::new(), step_s };
        Self { plant: RigidPlant::new(config), model, data }
    }

    /// Kinetic plus potential energy of an arm, J.
    fn energy(&mut self, arm: usize) -> f64 {
        let joints = 4 * arm..4 * arm + 4;
        kinematics(&self.model, &mut self.data, &self.plant.q()[joints.clone()], &self.plant.dq()[joints]);
        kinetic_energy(&self.model, &self.data) + potential_energy(&self.model, &self.data)
    }

    fn run(&mut self, step_s: f64, duration_s: f64) {
        for step in 0..(duration_s / step_s).round() as u32 {
            self.plant.step(f64::from(step) * step_s, step_s, &[JointTorque::default(); 8]);
        }
    }

    /// Vector from the first hand to the second, m.
    fn apart(&mut self) -> Vector3<f64> {
        let hand = self.model.frame_id("hand").expect("a hand");
        let [first, second] = [0, 4].map(|joint| {
            forward_kinematics(&self.model, &mut self.data, &self.plant.q()[joint..joint + 4]);
            frame_placement(&self.model, &self.data, hand).translation
        });
        second - first
    }
}

/// Compared: the works of all contacts of each arm, and the energy that the arm has gained. The error is that of the
/// integrator: halving the step divides it by four.
#[test]
fn works_of_all_contacts_are_the_energy_of_an_arm() {
    /// Error of steps of a millisecond relative to the works.
    const TOLERANCE: f64 = 1e-4;
    let errors = [1e-3, 5e-4, 2.5e-4].map(|step_s| {
        let mut pair = Pair::new(step_s, 100.0, 5.0);
        let start = [0, 1].map(|arm| pair.energy(arm));
        pair.run(step_s, 0.6);
        [0, 1].map(|arm| {
            let works = [0, 1].map(|contact| pair.plant.contact_work(arm, contact));
            assert!(works.iter().all(|work| work.abs() > 0.05), "{works:?} J");
            let gained = pair.energy(arm) - start[arm];
            (works[0] + works[1] - gained).abs() / (works[0].abs() + works[1].abs())
        })
    });
    for arm in 0..2 {
        assert!(errors[0][arm] < TOLERANCE, "{errors:?}");
        for pair in errors.windows(2) {
            let order = (pair[0][arm] / pair[1][arm]).log2();
            assert!((1.8..2.3).contains(&order), "order {order}: {errors:?}");
        }
    }
}

/// Compared: the sum of the works of a spring without damping on both arms, and the energy that it stores.
#[test]
fn spring_between_arms_gives_back_what_it_stores() {
    const STEP_S: f64 = 1e-4;
    const STIFFNESS: f64 = 100.0;
    /// Error of the steps relative to the stored energy.
    const TOLERANCE: f64 = 1e-5;
    let mut pair = Pair::new(STEP_S, STIFFNESS, 0.0);
    let relaxed = pair.apart();
    pair.run(STEP_S, 0.4);
    let stored = 0.5 * STIFFNESS * (pair.apart() - relaxed).norm_squared();
    let work = pair.plant.contact_work(0, 1) + pair.plant.contact_work(1, 1);
    assert!(stored > 0.05 && (work + stored).abs() < TOLERANCE * stored, "{work} J, stored {stored} J");
}
