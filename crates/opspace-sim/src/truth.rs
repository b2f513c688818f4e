//! Rows of the true state of an arm between two reads.

use crate::engine::Plant;
use crate::environment::EnvironmentObject;
use crate::external::{self, ExternalForce, ExternalRows};
use crate::held_object::HeldObject;
use crate::timing::Timing;
use nalgebra::{UnitQuaternion, Vector3};
use opspace_backend::signal_names::{
    DQ, FORCE, MOMENT, MOTOR_TORQUE, Q, SERVO_CHANNEL, SETPOINT_LIMITED, TRUTH_CHANNEL, WORK,
};
use opspace_backend::{Layout, Signal, SignalRecorder, TruthLayouts, TruthRow};
use opspace_model::{JointUnits, Model};
use std::ops::Range;

/// Rows since the last read. Memory for many missed cycles is preallocated.
pub(crate) struct TruthRows {
    arm: ArmSignals,
    /// Signals of the channel `truth`.
    signals: Vec<Signal>,
    truth: Vec<f64>,
    truth_width: usize,
    servo: Vec<f64>,
    servo_commands: Vec<Option<u64>>,
    external: Option<ExternalRows>,
    /// True if the rows were read; the next row replaces them.
    read: bool,
    /// True if the rows may still be read.
    kept: bool,
}

/// Contents of the rows besides the motion.
pub(crate) struct TruthConfig {
    /// Contacts.
    pub contacts: Vec<ContactSignals>,
    /// Held objects: names, and indices in the plant.
    pub held: Vec<(String, usize)>,
    /// Environment objects at the start, which are the first contacts.
    pub objects: Vec<EnvironmentObject>,
    /// True if external forces may be applied.
    pub has_external: bool,
    /// True if the drives limit their setpoints.
    pub has_setpoint_limits: bool,
}

/// Signals of a contact.
#[derive(Clone, Debug)]
pub(crate) struct ContactSignals {
    /// Name that they begin with.
    pub name: String,
    /// True if it can exert a moment.
    pub has_moment: bool,
}

/// Signals of the true state of an arm.
struct ArmSignals {
    joints: Vec<String>,
    units: JointUnits,
    contacts: Vec<ContactSignals>,
    held: Vec<(String, usize)>,
    has_setpoint_limits: bool,
}

impl ContactSignals {
    /// Returns those of a contact that exerts no moment.
    pub fn without_moment(name: &str) -> Self {
        Self { name: name.to_owned(), has_moment: false }
    }
}

/// Contacts of an arm in the last step.
trait Contacts {
    /// Force of a contact on the arm, world axes (N).
    fn force(&self, contact: usize) -> Vector3<f64>;

    /// Work of a contact on the arm since the start of control, J.
    fn work(&self, contact: usize) -> f64;

    /// Moment of a contact on the arm, world axes (Nm).
    fn moment(&self, contact: usize) -> Vector3<f64>;

    /// Environment object of a contact, if it is one.
    fn object(&self, contact: usize) -> Option<&EnvironmentObject>;

    /// Records the state of an object of the plant that arms hold.
    fn record_held(&self, object: usize, name: &str, out: &mut SignalRecorder<'_>);
}

/// Contacts before the first step.
struct AtStart<'a>(&'a [EnvironmentObject]);

impl Contacts for AtStart<'_> {
    fn force(&self, _contact: usize) -> Vector3<f64> {
        Vector3::zeros()
    }

    fn work(&self, _contact: usize) -> f64 {
        0.0
    }

    fn moment(&self, _contact: usize) -> Vector3<f64> {
        Vector3::zeros()
    }

    fn object(&self, contact: usize) -> Option<&EnvironmentObject> {
        self.0.get(contact)
    }

    fn record_held(&self, _object: usize, name: &str, out: &mut SignalRecorder<'_>) {
        HeldObject::record_state(
            name,
            &Vector3::zeros(),
            &UnitQuaternion::identity(),
            &Vector3::zeros(),
            out,
        );
    }
}

/// Contacts of an arm in a plant.
struct InPlant<'a> {
    plant: &'a dyn Plant,
    arm: usize,
}

impl Contacts for InPlant<'_> {
    fn force(&self, contact: usize) -> Vector3<f64> {
        self.plant.contact_force(self.arm, contact)
    }

    fn work(&self, contact: usize) -> f64 {
        self.plant.contact_work(self.arm, contact)
    }

    fn moment(&self, contact: usize) -> Vector3<f64> {
        self.plant.contact_moment(self.arm, contact)
    }

    fn object(&self, contact: usize) -> Option<&EnvironmentObject> {
        self.plant.environment_object(self.arm, contact)
    }

    fn record_held(&self, object: usize, name: &str, out: &mut SignalRecorder<'_>) {
        self.plant.held_object(object).record(name, out);
    }
}

impl ArmSignals {
    fn record(
        &self,
        q: &[f64],
        dq: &[f64],
        contacts: &impl Contacts,
        setpoint_limited: &[f64],
        out: &mut SignalRecorder<'_>,
    ) {
        out.signal(Q, &self.units.position, &self.joints, q);
        out.signal(DQ, &self.units.velocity, &self.joints, dq);
        for (i, ContactSignals { name, has_moment }) in self.contacts.iter().enumerate() {
            out.signal((name, FORCE), "N", &["x", "y", "z"], contacts.force(i).as_slice());
            if *has_moment {
                out.signal((name, MOMENT), "Nm", &["x", "y", "z"], contacts.moment(i).as_slice());
            }
            out.scalar((name, WORK), "J", contacts.work(i));
            if let Some(object) = contacts.object(i) {
                object.record(name, out);
            }
        }
        for (name, object) in &self.held {
            contacts.record_held(*object, name, out);
        }
        if self.has_setpoint_limits {
            out.signal(SETPOINT_LIMITED, "1", &self.joints, setpoint_limited);
        }
    }
}

impl TruthRows {
    /// Returns empty rows with memory for `cycles` interface cycles of `ratio` servo ticks.
    pub fn new(model: &Model, config: TruthConfig, cycles: usize, ratio: usize) -> Self {
        let joints: Vec<String> = model.joints().iter().map(|j| j.name.clone()).collect();
        let n = joints.len();
        let TruthConfig { contacts, held, objects, has_external, has_setpoint_limits } = config;
        let arm = ArmSignals { joints, units: model.joint_units(), contacts, held, has_setpoint_limits };
        let signals = SignalRecorder::describe(|out| arm.record(&[], &[], &AtStart(&objects), &[], out));
        let truth_width = signals.iter().map(|signal| signal.elements.len()).sum();
        Self {
            truth: Vec::with_capacity(cycles * truth_width),
            truth_width,
            servo: Vec::with_capacity(cycles * ratio * n),
            servo_commands: Vec::with_capacity(cycles * ratio),
            external: has_external.then(|| ExternalRows::new(model, cycles)),
            arm,
            signals,
            read: false,
            kept: true,
        }
    }

    pub fn layouts(&self) -> TruthLayouts {
        let servo = vec![Signal::new(MOTOR_TORQUE, &self.arm.units.torque, &self.arm.joints)];
        let layouts = TruthLayouts::new(
            Layout { channel: TRUTH_CHANNEL.to_owned(), signals: self.signals.clone() },
            Layout { channel: SERVO_CHANNEL.to_owned(), signals: servo },
        );
        match &self.external {
            Some(_) => layouts.with_external(external::layout()),
            None => layouts,
        }
    }

    /// Marks the rows as read; they are cleared when the next servo period begins.
    pub fn finish(&mut self) {
        self.read = true;
    }

    /// Declares that the rows are no longer read, so that they are not kept.
    pub fn abandon(&mut self) {
        self.kept = false;
    }

    fn clear_if_read(&mut self) {
        if self.read || !self.kept {
            self.read = false;
            self.servo_commands.clear();
            self.servo.clear();
            self.truth.clear();
            if let Some(external) = &mut self.external {
                external.clear();
            }
        }
    }

    /// Begins the row of a servo period.
    pub fn begin_servo_period(&mut self, command: Option<u64>) {
        self.clear_if_read();
        self.servo_commands.push(command);
        self.servo.resize(self.servo.len() + self.arm.joints.len(), 0.0);
    }

    /// Motor torques of the present servo period (n; Nm, N).
    pub fn servo_row(&mut self) -> &mut [f64] {
        let begin = self.servo.len() - self.arm.joints.len();
        &mut self.servo[begin..]
    }

    /// Adds the row of an interface cycle. `setpoint_limited` is 1 for each joint whose setpoint of the cycle before was
    /// beyond a limit of its drive (n); empty without such limits.
    pub fn begin_cycle(
        &mut self,
        plant: &dyn Plant,
        arm: usize,
        joints: &Range<usize>,
        setpoint_limited: &[f64],
    ) {
        self.clear_if_read();
        let begin = self.truth.len();
        self.truth.resize(begin + self.truth_width, f64::NAN);
        let (q, dq) = (&plant.q()[joints.clone()], &plant.dq()[joints.clone()]);
        let mut out = SignalRecorder::sampling(&mut self.truth[begin..]);
        self.arm.record(q, dq, &InPlant { plant, arm }, setpoint_limited, &mut out);
    }

    /// Adds a row: the external force that is set from this cycle on, and the force that acted before it (N).
    pub fn add_external(&mut self, set: Option<&ExternalForce>, acting: &Vector3<f64>) {
        if let Some(external) = &mut self.external {
            external.push(set, acting);
        }
    }

    /// Visits the rows in the order of time: for each interface period, the rows of the drives, then the true state at
    /// its end.
    pub fn visit(&self, timing: &Timing, visit: &mut dyn FnMut(TruthRow<'_>)) {
        let (n, ratio) = (self.arm.joints.len(), u64::from(timing.servo_ticks_per_cycle));
        let rows = self.servo_commands.iter().zip(self.servo.chunks_exact(n));
        let mut rows = (timing.servo_tick - rows.len() as u64..).zip(rows);
        let truths = self.truth.chunks_exact(self.truth_width);
        let first = timing.servo_tick - (truths.len() as u64).saturating_sub(1) * ratio;
        let mut external = self.external.iter().flat_map(ExternalRows::iter);
        for (tick, truth) in (first..).step_by(timing.servo_ticks_per_cycle as usize).zip(truths) {
            for (servo_tick, (&command, row)) in rows.by_ref().take(timing.servo_ticks_per_cycle as usize) {
                visit(TruthRow::Servo { time_s: timing.time_s(servo_tick), command, row });
            }
            visit(TruthRow::State { time_s: timing.time_s(tick), row: truth });
            if let Some(row) = external.next() {
                visit(TruthRow::External { time_s: timing.time_s(tick), row });
            }
        }
    }
}
