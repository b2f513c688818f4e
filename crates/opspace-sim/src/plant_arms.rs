//! Arms of a plant: their motion by midpoint steps, and the forces of environment, couplings, held objects and programs on
//! them.
//!
//! A physics engine computes the accelerations of the joints; everything else of a step is done here, and is the same for
//! every engine:
//!
//! 1. [`begin_step`](PlantArms::begin_step) predicts the middle of the step and adds the joint torques of all forces
//!    there to those of the drives;
//! 2. the engine computes the accelerations of the joints in the middle under these torques;
//! 3. [`end_step`](PlantArms::end_step) advances positions and velocities, and adds up the work of the forces.
//!
//! The work of a contact force in a step is that of its joint torques on the displacement of the joints, `(Jᵀ F)·Δq`: exactly
//! what it adds to the kinetic energy of the integrator if the mass matrix is constant, and otherwise to second order.

use crate::environment::EnvironmentObject;
use crate::external::ExternalForce;
use crate::held_object::{HandMotion, HeldObject};
use crate::integrator::Midpoint;
use crate::plant::{JointTorque, PlantArm, PlantConfig, PlantCoupling, PlantFrame, PlantObject};
use nalgebra::{DVector, Matrix6xX, Rotation3, UnitQuaternion, Vector3};
use opspace_model::{
    Data, Force, FrameId, Model, aba, cholesky, crba, frame_jacobian, frame_placement, frame_velocity,
    kinematics,
};
use std::ops::Range;

/// Arms of a plant, and the forces on them. Joint torques and contact forces are constant over a step, the latter those
/// in its middle.
pub struct PlantArms {
    arms: Vec<MovingArm>,
    couplings: Vec<Coupling>,
    held: Vec<Held>,
    q: DVector<f64>,
    dq: DVector<f64>,
    /// True if the present step is after the start of control.
    is_controlled: bool,
    /// True while a step is begun and not ended.
    is_begun: bool,
}

/// Arm, and the forces on it.
struct MovingArm {
    model: Model,
    integrator: Midpoint,
    joints: Range<usize>,
    torque: DVector<f64>,
    drives: DriveInertia,
    /// Mean velocities during the last step (n; rad/s, m/s).
    mean_dq: DVector<f64>,
    objects: Vec<EnvironmentObject>,
    /// Forces of the objects, then those of the couplings, then those of held objects.
    contacts: Vec<PointForce>,
    external: External,
}

/// Inertia by which the drives of an arm resist its acceleration, in addition to that of its rotors: see [`JointTorque`]. While it
/// is not zero, the rotors of the arm's model have it.
struct DriveInertia {
    /// Inertia of the rotors (n; kg m², kg).
    rotors: Vec<f64>,
    /// Inertia of the drives in the present step (n; kg m², kg).
    added: DVector<f64>,
    is_present: bool,
    /// Accelerations of the articulated-body algorithm, which another engine corrects (n; rad/s², m/s²).
    expected: DVector<f64>,
    data: Data,
}

impl DriveInertia {
    fn new(model: &Model) -> Self {
        let zero = DVector::zeros(model.n());
        let rotors = model.rotor_inertia().to_vec();
        Self { rotors, added: zero.clone(), is_present: false, expected: zero, data: Data::new(model) }
    }

    /// Sets the inertia of the drives, and that of the rotors in the model.
    fn set(&mut self, model: &mut Model, torques: &[JointTorque]) {
        let is_present = torques.iter().any(|torque| torque.inertia != 0.0);
        if is_present || self.is_present {
            for (joint, torque) in torques.iter().enumerate() {
                self.added[joint] = torque.inertia;
                model.set_rotor_inertia(joint, self.rotors[joint] + torque.inertia);
            }
        }
        self.is_present = is_present;
    }

    /// Computes the expected accelerations in the middle of a step, under `torque` (n; Nm, N).
    fn predict(&mut self, model: &Model, q: &[f64], dq: &[f64], torque: &DVector<f64>) {
        if self.is_present {
            kinematics(model, &mut self.data, q, dq);
            aba(model, &mut self.data, torque.as_slice());
            self.expected.copy_from(&self.data.ddq);
        }
    }

    /// Corrects accelerations (n; rad/s², m/s²) that an engine without the inertia of the drives has computed under the torques
    /// less G times the expected accelerations: with the inertia, `q̈ + (M + G)⁻¹ G (expected − q̈)`.
    fn correct(&mut self, model: &Model, ddq: &mut [f64]) {
        if !self.is_present {
            return;
        }
        crba(model, &mut self.data);
        if !cholesky(&mut self.data) {
            ddq.fill(f64::NAN);
            return;
        }
        for (i, ddq) in ddq.iter().enumerate() {
            self.data.ddq[i] = self.added[i] * (self.expected[i] - ddq);
        }
        self.data.mass_matrix_factor.solve(self.data.ddq.as_mut_slice());
        ddq.iter_mut().zip(&self.data.ddq).for_each(|(ddq, change)| *ddq += change);
    }
}

/// Contact force on the origin of a frame, and moment about it, during the last step.
struct PointForce {
    frame: FrameId,
    jacobian: Matrix6xX<f64>,
    force: Vector3<f64>,
    /// Moment, only of a grip (world axes, Nm).
    moment: Option<Vector3<f64>>,
    /// Work on the robot since the start of control, J.
    work: f64,
}

/// External force, and its wrench during the last step.
struct External {
    set: Option<ExternalForce>,
    jacobian: Matrix6xX<f64>,
    wrench: Force,
}

/// Object that arms hold.
struct Held {
    object: HeldObject,
    /// Indices of the forces of its hands in the contact lists of their arms.
    contacts: Vec<usize>,
}

/// Spring between two arms.
struct Coupling {
    parameters: PlantCoupling,
    /// Indices of its forces in the contact lists of the two arms.
    contacts: [usize; 2],
    /// Vector from the first frame to the second at the start, m.
    relaxed: Vector3<f64>,
}

impl PointForce {
    fn new(frame: FrameId, n: usize) -> Self {
        Self { frame, jacobian: Matrix6xX::zeros(n), force: Vector3::zeros(), moment: None, work: 0.0 }
    }

    /// Power on joints with the velocities `dq` (n; rad/s, m/s), W.
    fn power(&self, dq: &DVector<f64>) -> f64 {
        let moment = self.moment.unwrap_or_default();
        (self.jacobian.column_iter().zip(dq))
            .map(|(column, dq)| {
                let [force, moment] =
                    [column.fixed_rows::<3>(0).dot(&self.force), column.fixed_rows::<3>(3).dot(&moment)];
                (force + moment) * dq
            })
            .sum()
    }
}

/// Adds the joint torques Jᵀ F of a force, with J the three rows of the Jacobian from `first_row`.
fn add_torques(jacobian: &Matrix6xX<f64>, first_row: usize, force: &Vector3<f64>, torque: &mut DVector<f64>) {
    for i in 0..torque.len() {
        let column: Vector3<f64> = jacobian.fixed_view::<3, 1>(first_row, i).into_owned();
        torque[i] += column.dot(force);
    }
}

impl MovingArm {
    fn new(arm: PlantArm, first_joint: usize) -> Self {
        let n = arm.model.n();
        let mut integrator = Midpoint::new(&arm.model);
        integrator.predict(&arm.model, &arm.q, &vec![0.0; n], 0.0);
        let (frames, objects): (Vec<FrameId>, Vec<EnvironmentObject>) = arm.contacts.into_iter().unzip();
        Self {
            integrator,
            joints: first_joint..first_joint + n,
            torque: DVector::zeros(n),
            drives: DriveInertia::new(&arm.model),
            mean_dq: DVector::zeros(n),
            objects,
            contacts: frames.into_iter().map(|frame| PointForce::new(frame, n)).collect(),
            external: External { set: None, jacobian: Matrix6xX::zeros(n), wrench: Force::zero() },
            model: arm.model,
        }
    }

    /// Position (m) and velocity (m/s) of a frame's origin in the world, in the middle of the present step.
    fn point(&self, frame: FrameId) -> (Vector3<f64>, Vector3<f64>) {
        let middle = self.integrator.middle();
        let x = frame_placement(&self.model, middle, frame).translation;
        let v = frame_velocity(&self.model, middle, frame).linear;
        (x, v)
    }

    /// Motion of a frame in the middle of the present step.
    fn hand_motion(&self, frame: FrameId) -> HandMotion {
        let middle = self.integrator.middle();
        let placement = frame_placement(&self.model, middle, frame);
        let velocity = frame_velocity(&self.model, middle, frame);
        let rotation = Rotation3::from_matrix_unchecked(placement.rotation);
        HandMotion {
            position: placement.translation,
            velocity: velocity.linear,
            orientation: UnitQuaternion::from_rotation_matrix(&rotation),
            angular_velocity: velocity.angular,
        }
    }

    /// Advances the environment by a step of `dt_s` to the middle of the present step, and updates its forces and the
    /// external force.
    fn touch(&mut self, time_s: f64, dt_s: f64) {
        for index in 0..self.objects.len() {
            let (x, v) = self.point(self.contacts[index].frame);
            self.contacts[index].force = self.objects[index].force(time_s, dt_s, &x, &v);
        }
        if let Some(force) = self.external.set {
            let middle = self.integrator.middle();
            let placement = frame_placement(&self.model, middle, force.frame);
            let velocity = frame_velocity(&self.model, middle, force.frame);
            self.external.wrench = force.pull.wrench(&placement, &velocity);
        }
    }

    fn add_contact_torques(&mut self) {
        let middle = self.integrator.middle();
        for contact in &mut self.contacts {
            frame_jacobian(&self.model, middle, contact.frame, &mut contact.jacobian);
            add_torques(&contact.jacobian, 0, &contact.force, &mut self.torque);
            if let Some(moment) = &contact.moment {
                add_torques(&contact.jacobian, 3, moment, &mut self.torque);
            }
        }
        if let Some(force) = self.external.set {
            let External { jacobian, wrench, .. } = &mut self.external;
            frame_jacobian(&self.model, middle, force.frame, jacobian);
            add_torques(jacobian, 0, &wrench.linear, &mut self.torque);
            add_torques(jacobian, 3, &wrench.angular, &mut self.torque);
        }
    }

    /// Adds the work of a step of `dt_s` (s), during which the mean velocities were `mean_dq`.
    fn add_work(&mut self, dt_s: f64) {
        for contact in &mut self.contacts {
            if contact.force != Vector3::zeros() || contact.moment.is_some() {
                contact.work += contact.power(&self.mean_dq) * dt_s;
            }
        }
    }

    /// Wrench of the contacts on the body of a frame during the last step, where the arm was in its middle.
    fn contact_wrench(&self, frame: FrameId) -> Force {
        let (model, middle) = (&self.model, self.integrator.middle());
        let sensor = frame_placement(model, middle, frame);
        let body = model.frame(frame).body;
        let mut wrench = Force::zero();
        let mut add = |frame: FrameId, force: &Vector3<f64>, moment: Option<&Vector3<f64>>| {
            if model.frame(frame).body == body {
                let at = frame_placement(model, middle, frame).translation;
                wrench.linear += force;
                wrench.angular += (at - sensor.translation).cross(force);
                if let Some(moment) = moment {
                    wrench.angular += moment;
                }
            }
        };
        for contact in &self.contacts {
            add(contact.frame, &contact.force, contact.moment.as_ref());
        }
        if let Some(force) = self.external.set {
            add(force.frame, &self.external.wrench.linear, Some(&self.external.wrench.angular));
        }
        Force {
            linear: sensor.rotation.tr_mul(&wrench.linear),
            angular: sensor.rotation.tr_mul(&wrench.angular),
        }
    }
}

impl PlantArms {
    /// Returns the arms at rest at their start.
    ///
    /// # Panics
    /// If the number of start positions differs from the number of joints, or a coupling or a grip names an arm that doesn't
    /// exist.
    #[must_use]
    pub fn new(config: PlantConfig) -> Self {
        let mut arms = Vec::new();
        let mut q = Vec::new();
        for arm in config.arms {
            assert_eq!(arm.q.len(), arm.model.n(), "one position per joint");
            let first_joint = q.len();
            q.extend_from_slice(&arm.q);
            arms.push(MovingArm::new(arm, first_joint));
        }
        let couplings = config.couplings.into_iter().map(|c| Coupling::new(c, &mut arms)).collect();
        let held = config.objects.into_iter().map(|object| Held::new(object, &mut arms)).collect();
        let dq = DVector::zeros(q.len());
        Self { arms, couplings, held, dq, q: DVector::from_vec(q), is_controlled: false, is_begun: false }
    }

    /// Positions of all joints, one arm after the other, rad or m.
    #[must_use]
    pub fn q(&self) -> &[f64] {
        self.q.as_slice()
    }

    /// Velocities of all joints, rad/s or m/s.
    #[must_use]
    pub fn dq(&self) -> &[f64] {
        self.dq.as_slice()
    }

    /// Predicts the middle of the next step of `dt_s` (s) from the time `time_s` (s after the start of control), and computes
    /// all forces there. `torques` are those of the drives.
    /// It may be called again with other torques before the step is ended.
    pub fn begin_step(&mut self, time_s: f64, dt_s: f64, torques: &[JointTorque]) {
        if !std::mem::replace(&mut self.is_begun, true) {
            self.predict(time_s, dt_s);
        }
        for arm in &mut self.arms {
            let torques = &torques[arm.joints.clone()];
            arm.torque.iter_mut().zip(torques).for_each(|(to, torque)| *to = torque.torque);
            arm.drives.set(&mut arm.model, torques);
            arm.add_contact_torques();
        }
    }

    /// Predicts the middle of a step, and updates the forces there.
    fn predict(&mut self, time_s: f64, dt_s: f64) {
        let middle_s = time_s + 0.5 * dt_s;
        self.is_controlled = middle_s >= 0.0;
        for arm in &mut self.arms {
            let (q, dq) = (&self.q.as_slice()[arm.joints.clone()], &self.dq.as_slice()[arm.joints.clone()]);
            arm.integrator.predict(&arm.model, q, dq, dt_s);
            arm.touch(middle_s, dt_s);
        }
        for coupling in &self.couplings {
            coupling.pull(&mut self.arms);
        }
        for held in &mut self.held {
            held.pull(&mut self.arms, middle_s, dt_s);
        }
    }

    /// Copies the middle of the step that was begun, in the order of [`q`](Self::q): positions (rad or m), velocities
    /// (rad/s or m/s), and torques of drives and forces (Nm or N), with which an engine computes the accelerations for
    /// [`end_step`](Self::end_step). The inertia of the drives is taken into account here and there.
    pub fn copy_middle(&mut self, q: &mut [f64], dq: &mut [f64], torques: &mut [f64]) {
        for arm in &mut self.arms {
            let middle = &arm.integrator;
            arm.drives.predict(&arm.model, middle.middle_q(), middle.middle_dq(), &arm.torque);
            q[arm.joints.clone()].copy_from_slice(arm.integrator.middle_q());
            dq[arm.joints.clone()].copy_from_slice(arm.integrator.middle_dq());
            torques[arm.joints.clone()].copy_from_slice(arm.torque.as_slice());
            if arm.drives.is_present {
                let resistance = arm.drives.added.iter().zip(&arm.drives.expected);
                let torques = torques[arm.joints.clone()].iter_mut();
                torques.zip(resistance).for_each(|(torque, (inertia, ddq))| *torque -= inertia * ddq);
            }
        }
    }

    /// Ends the step that was begun, with the joint accelerations in its middle (rad/s² or m/s²), which an engine has computed
    /// from [`copy_middle`](Self::copy_middle). They are corrected for the inertia of the drives.
    pub fn end_step(&mut self, dt_s: f64, ddq: &mut [f64]) {
        for arm in &mut self.arms {
            arm.drives.correct(&arm.model, &mut ddq[arm.joints.clone()]);
        }
        self.advance(dt_s, |arm, q, dq| arm.integrator.accelerate(q, dq, &ddq[arm.joints.clone()], dt_s));
    }

    /// Writes the velocities (rad/s or m/s) at the end of the step that was begun, with the accelerations of the articulated-body
    /// algorithm.
    pub fn end_velocities_rigid(&mut self, dt_s: f64, dq: &mut [f64]) {
        for arm in &mut self.arms {
            let ddq = arm.integrator.accelerations(&arm.model, arm.torque.as_slice());
            let before = &self.dq.as_slice()[arm.joints.clone()];
            let end = dq[arm.joints.clone()].iter_mut();
            end.zip(before).zip(ddq).for_each(|((end, before), ddq)| *end = before + dt_s * ddq);
        }
    }

    /// Writes the velocities (rad/s or m/s) at the end of the step that was begun, with the joint accelerations in its middle (rad/s²
    /// or m/s²) as in [`end_step`](Self::end_step), which are corrected.
    pub fn end_velocities(&mut self, dt_s: f64, ddq: &mut [f64], dq: &mut [f64]) {
        for arm in &mut self.arms {
            arm.drives.correct(&arm.model, &mut ddq[arm.joints.clone()]);
        }
        for ((end, before), ddq) in dq.iter_mut().zip(&self.dq).zip(ddq) {
            *end = before + dt_s * *ddq;
        }
    }

    /// Ends the step that was begun, with the accelerations of the articulated-body algorithm.
    pub fn end_step_rigid(&mut self, dt_s: f64) {
        self.advance(dt_s, |arm, q, dq| {
            arm.integrator.advance(&arm.model, q, dq, arm.torque.as_slice(), dt_s);
        });
    }

    /// Advances positions and velocities of each arm, and adds the work of the step.
    fn advance(&mut self, dt_s: f64, mut integrate: impl FnMut(&mut MovingArm, &mut [f64], &mut [f64])) {
        self.is_begun = false;
        for arm in &mut self.arms {
            let q = &mut self.q.as_mut_slice()[arm.joints.clone()];
            let dq = &mut self.dq.as_mut_slice()[arm.joints.clone()];
            arm.mean_dq.copy_from_slice(dq);
            integrate(arm, q, dq);
            if arm.drives.is_present {
                for (joint, q) in q.iter_mut().enumerate().filter(|(joint, _)| arm.drives.added[*joint] > 0.0)
                {
                    arm.integrator.step_backward(joint, q, dt_s);
                }
            }
            for (mean, dq) in arm.mean_dq.iter_mut().zip(dq) {
                *mean = 0.5 * (*mean + *dq);
            }
            if self.is_controlled {
                arm.add_work(dt_s);
            }
        }
    }

    /// Wrench of contacts and external force: see [`Plant::contact_wrench`](crate::Plant::contact_wrench).
    #[must_use]
    pub fn contact_wrench(&self, frame: PlantFrame) -> Force {
        self.arms[frame.arm].contact_wrench(frame.frame)
    }

    /// Force of a contact on an arm: see [`Plant::contact_force`](crate::Plant::contact_force).
    #[must_use]
    pub fn contact_force(&self, arm: usize, contact: usize) -> Vector3<f64> {
        self.arms[arm].contacts[contact].force
    }

    /// Moment of a contact on an arm: see [`Plant::contact_moment`](crate::Plant::contact_moment).
    #[must_use]
    pub fn contact_moment(&self, arm: usize, contact: usize) -> Vector3<f64> {
        self.arms[arm].contacts[contact].moment.unwrap_or_default()
    }

    /// Work of a contact on an arm: see [`Plant::contact_work`](crate::Plant::contact_work).
    #[must_use]
    pub fn contact_work(&self, arm: usize, contact: usize) -> f64 {
        self.arms[arm].contacts[contact].work
    }

    /// Environment object of an arm: see [`Plant::environment_object`](crate::Plant::environment_object).
    #[must_use]
    pub fn environment_object(&self, arm: usize, contact: usize) -> Option<&EnvironmentObject> {
        self.arms[arm].objects.get(contact)
    }

    /// Object that arms hold: see [`Plant::held_object`](crate::Plant::held_object).
    #[must_use]
    pub fn held_object(&self, object: usize) -> &HeldObject {
        &self.held[object].object
    }

    /// Sets or removes the external force on an arm: see [`Plant::push`](crate::Plant::push).
    pub fn push(&mut self, arm: usize, force: Option<ExternalForce>) {
        let external = &mut self.arms[arm].external;
        external.set = force;
        if force.is_none() {
            external.wrench = Force::zero();
        }
    }

    /// External force on an arm during the last step, world axes (N).
    #[must_use]
    pub fn external_force(&self, arm: usize) -> Vector3<f64> {
        self.arms[arm].external.wrench.linear
    }
}

/// Adds a contact force on a frame, and returns its index in the arm's list.
fn add_contact(arms: &mut [MovingArm], at: PlantFrame) -> usize {
    let arm = &mut arms[at.arm];
    arm.contacts.push(PointForce::new(at.frame, arm.model.n()));
    arm.contacts.len() - 1
}

impl Held {
    fn new(object: PlantObject, arms: &mut [MovingArm]) -> Self {
        let object = HeldObject::new(object);
        let contacts = object.hands().iter().map(|hand| add_contact(arms, hand.frame)).collect();
        Self { object, contacts }
    }

    /// Updates the forces on the hands, and advances the object by a step of `dt_s` (s) with its middle at `time_s` (s).
    fn pull(&mut self, arms: &mut [MovingArm], time_s: f64, dt_s: f64) {
        for hand in self.object.hands_mut() {
            hand.motion = arms[hand.frame.arm].hand_motion(hand.frame.frame);
        }
        self.object.step(time_s, dt_s);
        for (hand, &index) in self.object.hands().iter().zip(&self.contacts) {
            let contact = &mut arms[hand.frame.arm].contacts[index];
            contact.force = hand.wrench.linear;
            contact.moment = (hand.wrench.angular != Vector3::zeros()).then_some(hand.wrench.angular);
        }
    }
}

impl Coupling {
    fn new(parameters: PlantCoupling, arms: &mut [MovingArm]) -> Self {
        let contacts = parameters.frames.map(|at| add_contact(arms, at));
        let [first, second] = parameters.frames.map(|at| arms[at.arm].point(at.frame).0);
        Self { parameters, contacts, relaxed: second - first }
    }

    /// Updates the spring's forces on the two arms.
    fn pull(&self, arms: &mut [MovingArm]) {
        let [(x, v), (y, w)] = self.parameters.frames.map(|at| arms[at.arm].point(at.frame));
        let stretch = (y - x) - self.relaxed;
        let force = stretch * self.parameters.stiffness_n_per_m + (w - v) * self.parameters.damping_ns_per_m;
        for (at, (index, force)) in
            self.parameters.frames.iter().zip(self.contacts.iter().zip([force, -force]))
        {
            arms[at.arm].contacts[*index].force = force;
        }
    }
}
