//! Drivetrain of a joint: motor with its current loop, friction, end stop, brake, encoder.
//!
//! With a rigid gear the motor moves with the link, the rotor's inertia is in the plant's mass matrix, and the torque on
//! the link is `((motor − friction) + end stop) + brake`. With an [elastic gear](crate::gear), motor, friction and brake
//! act on the rotor, whose motion is a state of the drivetrain, and the torque on the link is `gear + end stop`. Contact
//! forces are part of the [plant](crate::plant).
//!
//! The torques above are constant over a step, and computed at its begin, unless they are too stiff for that: such torques, and
//! those of an end stop that is touched, are part of an implicit step: see `implicit_step.rs`.

use crate::friction::LuGre;
use crate::gear::ElasticGear;
use crate::motor::{AngleTorque, Motor};
use crate::parameters::{BrakeParameters, EncoderSide, EndStopParameters};
use crate::plant::JointTorque;
use crate::stiff_joint::{Side, StiffJoint, decrease, end_velocity};
use opspace_model::Limits;

/// Elements of a joint that are integrated implicitly in a step.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Implicit {
    None,
    EndStop,
    All,
}

/// Drivetrain of one joint.
#[derive(Clone, Debug)]
pub struct Drivetrain {
    motor: Motor,
    friction: LuGre,
    end_stop: EndStop,
    brake: Brake,
    encoder: Encoder,
    interface_encoder: Encoder,
    gear: Option<ElasticGear>,
    stiff: StiffJoint,
    is_stiff: bool,
    implicit: Implicit,
    /// Position of the link before the present step, rad (m).
    link: f64,
    angle_torque: AngleTorque,
    current_torque: f64,
    motor_torque: f64,
    /// Torque of the motor that compensates gravity, in addition to `motor_torque`.
    gravity_torque: f64,
    joint_torque: f64,
}

impl Drivetrain {
    /// Returns a drivetrain with a rigid gear and its brake released. Drive and interface read the same encoder.
    #[must_use]
    pub fn new(motor: Motor, friction: LuGre, end_stop: EndStop, brake: Brake, encoder: Encoder) -> Self {
        let interface_encoder = encoder.clone();
        Self {
            motor,
            friction,
            end_stop,
            brake,
            encoder,
            interface_encoder,
            gear: None,
            stiff: StiffJoint::new(1.0),
            is_stiff: false,
            implicit: Implicit::None,
            link: 0.0,
            angle_torque: AngleTorque::default(),
            current_torque: 0.0,
            motor_torque: 0.0,
            gravity_torque: 0.0,
            joint_torque: 0.0,
        }
    }

    /// Replaces the rigid gear by an elastic one.
    #[must_use]
    pub fn with_gear(self, gear: ElasticGear) -> Self {
        Self { gear: Some(gear), ..self }
    }

    /// Adds torques of the motor that depend on its angle.
    #[must_use]
    pub fn with_angle_torque(self, angle_torque: AngleTorque) -> Self {
        Self { angle_torque, ..self }
    }

    /// Sets the encoder that the interface reports.
    #[must_use]
    pub fn with_interface_encoder(self, interface_encoder: Encoder) -> Self {
        Self { interface_encoder, ..self }
    }

    /// Sets the inertia of the link with the other joints free, without the rotor of an elastic gear (kg m², kg), from which an
    /// implicit step begins its search.
    #[must_use]
    pub fn with_link_inertia(self, inertia: f64) -> Self {
        Self { stiff: StiffJoint::new(inertia), ..self }
    }

    /// Integrates brake, end stop, friction and an elastic gear implicitly: they are too stiff for the step.
    #[must_use]
    pub fn with_implicit_steps(self) -> Self {
        Self { is_stiff: true, ..self }
    }

    /// Runs the current loop of the motor for a physics step, with `commanded` (Nm, N) as its input.
    pub fn drive(&mut self, commanded: f64) {
        self.current_torque = self.motor.step(commanded);
    }

    /// Returns the torque on the link over the next `dt_s` (s) from position `q` (rad, m) and velocity `dq` (rad/s, m/s).
    pub fn begin_step(&mut self, q: f64, dq: f64, dt_s: f64) -> JointTorque {
        self.motor_torque = self.angle_torque.torque(self.current_torque, self.rotor_position(q));
        self.friction.set_load(self.motor_torque + self.gravity_torque);
        self.link = q;
        if !self.is_stiff {
            self.step(q, dq, dt_s);
        }
        let before = self.implicit;
        self.implicit = match (self.is_stiff, self.end_stop.is_touched(q, q + dt_s * dq)) {
            (true, _) => Implicit::All,
            (false, true) => Implicit::EndStop,
            (false, false) => Implicit::None,
        };
        if self.implicit == Implicit::None {
            return JointTorque { torque: self.joint_torque, inertia: 0.0 };
        }
        if self.implicit != before {
            self.stiff.forget();
        }
        let mut stiff = self.stiff.clone();
        let result =
            stiff.begin(dq, dt_s, |v| self.end_torque(v, dt_s), |v, side| self.end_slope(v, side, dt_s));
        self.stiff = stiff;
        result
    }

    /// True if elements are integrated implicitly in the present step.
    #[must_use]
    pub fn is_implicit(&self) -> bool {
        self.implicit != Implicit::None
    }

    /// Notes that the torques of an implicit step of `h` (s) lead to the velocity `dq` (rad/s, m/s) of the link at its end. True if they
    /// are exact there.
    pub(crate) fn lead_to(&mut self, dq: f64, h: f64) -> bool {
        let mut stiff = self.stiff.clone();
        let is_exact = stiff.lead_to(dq, h, |v| self.end_torque(v, h));
        self.stiff = stiff;
        is_exact
    }

    /// See [`StiffJoint::gap`].
    pub(crate) fn gap(&self, share: f64, h: f64) -> f64 {
        self.stiff.gap(share, |v| self.end_torque(v, h))
    }

    /// See [`StiffJoint::advance`].
    pub(crate) fn advance(&mut self, share: f64, h: f64) -> JointTorque {
        let mut stiff = self.stiff.clone();
        let torque = stiff.advance(share, h, |v| self.end_torque(v, h), |v, side| self.end_slope(v, side, h));
        self.stiff = stiff;
        torque
    }

    /// See [`StiffJoint::settle`].
    pub(crate) fn settle(&mut self, h: f64) -> JointTorque {
        let mut stiff = self.stiff.clone();
        let torque = stiff.settle(h, |v, side| self.end_slope(v, side, h));
        self.stiff = stiff;
        torque
    }

    /// Ends the step of `dt_s` (s) that was begun, with the link at velocity `dq` (rad/s, m/s).
    pub fn end_step(&mut self, dq: f64, dt_s: f64) {
        if self.implicit == Implicit::None {
            return;
        }
        let torque = self.stiff.end(dq, dt_s);
        let stop = self.end_stop.torque(self.link + dt_s * dq, dq);
        match (self.implicit, &mut self.gear) {
            (Implicit::EndStop, None) => self.joint_torque += stop,
            (Implicit::EndStop, Some(_)) | (Implicit::None, _) => {}
            (Implicit::All, _) => {
                let rotor = self.rotor_velocity(dq, dt_s);
                self.friction.step(rotor, dt_s);
                self.joint_torque = torque;
                if let Some(gear) = &mut self.gear {
                    gear.end_step(rotor, dt_s);
                    self.joint_torque -= stop;
                }
            }
        }
    }

    /// Explicit step: computes the torque of the joint on the link (Nm, N), without its end stop, constant over the next `dt_s` (s).
    fn step(&mut self, q: f64, dq: f64, dt_s: f64) {
        let motor = self.motor_torque + self.gravity_torque;
        let Self { friction, brake, .. } = self;
        self.joint_torque = match &mut self.gear {
            Some(gear) => {
                let rotor = |q: f64, dq: f64, h: f64| motor - friction.step(dq, h) + brake.torque(q, dq);
                gear.step(q, dq, dt_s, rotor)
            }
            None => motor - friction.step(dq, dt_s) + brake.torque(q, dq),
        };
    }

    /// Torque on the rotor (Nm, N), without that of the gear, if the rotor has velocity `v` (rad/s, m/s) at the end of a step
    /// of `h` (s).
    fn rotor_torque(&self, v: f64, h: f64) -> f64 {
        let position = self.rotor_position(self.link) + h * v;
        self.motor_torque + self.gravity_torque - self.friction.torque(v, h) + self.brake.torque(position, v)
    }

    /// Velocity of the rotor at the end of a step of `h` (s), with that of the link (rad/s, m/s).
    fn rotor_velocity(&self, link: f64, h: f64) -> f64 {
        let Some(gear) = &self.gear else { return link };
        let torque = |v: f64| self.rotor_torque(v, h) - gear.end_torque(self.link, link, v, h);
        end_velocity(gear.inertia() / h, gear.velocity(), torque)
    }

    /// Torque on the link (Nm, N) if it has velocity `v` (rad/s, m/s) at the end of a step of `h` (s).
    fn end_torque(&self, v: f64, h: f64) -> f64 {
        let stop = self.end_stop.torque(self.link + h * v, v);
        if self.implicit == Implicit::EndStop {
            return self.joint_torque + stop;
        }
        match &self.gear {
            None => self.rotor_torque(v, h) + stop,
            Some(gear) => gear.end_torque(self.link, v, self.rotor_velocity(v, h), h) + stop,
        }
    }

    /// Rate by which [`end_torque`](Self::end_torque) decreases with the velocity on these sides (Nms/rad, Ns/m).
    fn end_slope(&self, v: f64, side: Side, h: f64) -> f64 {
        let stop = decrease(v, side, |v| self.end_stop.torque(self.link + h * v, v));
        if self.implicit == Implicit::EndStop {
            return stop;
        }
        let Some(gear) = &self.gear else { return decrease(v, side, |v| self.rotor_torque(v, h)) + stop };
        let rotor = self.rotor_velocity(v, h);
        let gear_slope = decrease(v, side, |v| gear.end_torque(self.link, v, rotor, h));
        let behind = gear.inertia() / h + decrease(rotor, side, |rotor| self.rotor_torque(rotor, h));
        gear_slope * behind / (gear_slope + behind) + stop
    }

    /// Sets the torque of the motor that compensates gravity (Nm, N), from the next step on.
    pub fn compensate(&mut self, gravity_torque: f64) {
        self.gravity_torque = gravity_torque;
    }

    /// Mean motor torque at the joint over the last step, Nm or N, without that which compensates gravity.
    #[must_use]
    pub fn motor_torque(&self) -> f64 {
        self.motor_torque
    }

    /// Mean torque over the last step that the current of the motor stands for, Nm or N: without cogging and ripple.
    #[must_use]
    pub fn current_torque(&self) -> f64 {
        self.current_torque
    }

    /// Torque of the gear on the link during the last step, Nm or N, without that which compensates gravity; of a rigid gear
    /// with that of the end stop.
    #[must_use]
    pub fn joint_torque(&self) -> f64 {
        self.joint_torque - self.gravity_torque
    }

    /// Returns the reading of the drive's encoder with the link at position `q` (rad, m).
    #[must_use]
    pub fn read_encoder(&self, q: f64) -> f64 {
        self.encoder.read(self.seen(&self.encoder, q))
    }

    /// Returns the reading of the interface's encoder with the link at position `q` (rad, m).
    #[must_use]
    pub fn read_interface_encoder(&self, q: f64) -> f64 {
        self.interface_encoder.read(self.seen(&self.interface_encoder, q))
    }

    /// Returns the velocity (rad/s, m/s) that the interface reports, with the link at velocity `dq` (rad/s, m/s).
    #[must_use]
    pub fn interface_velocity(&self, dq: f64) -> f64 {
        match (&self.gear, self.interface_encoder.side) {
            (Some(gear), EncoderSide::Motor) => gear.velocity(),
            _ => dq,
        }
    }

    /// Position that an encoder is on, with the link at `q` (rad, m).
    fn seen(&self, encoder: &Encoder, q: f64) -> f64 {
        match encoder.side {
            EncoderSide::Motor => self.rotor_position(q),
            EncoderSide::Link => q,
        }
    }

    /// Elastic gear; `None` if the gear is rigid.
    #[must_use]
    pub fn gear(&self) -> Option<&ElasticGear> {
        self.gear.as_ref()
    }

    /// Position of the rotor at the joint with the link at `q`, rad or m.
    #[must_use]
    pub fn rotor_position(&self, q: f64) -> f64 {
        self.gear.as_ref().map_or(q, ElasticGear::position)
    }

    /// Engages the brake with the link at position `q` (rad, m). A brake that is already engaged keeps its position.
    pub fn engage_brake(&mut self, q: f64) {
        let rotor = self.rotor_position(q);
        self.brake.engaged_at.get_or_insert(rotor);
    }

    /// Releases the brake.
    pub fn release_brake(&mut self) {
        self.brake.engaged_at = None;
    }
}

/// Spring and damper beyond each position limit of the joint.
#[derive(Clone, Debug)]
pub struct EndStop {
    limits: Limits,
    stiffness: f64,
    damping: f64,
}

impl EndStop {
    /// Returns end stops at the joint's position limits.
    #[must_use]
    pub fn new(limits: &Limits, parameters: &EndStopParameters) -> Self {
        Self {
            limits: *limits,
            stiffness: parameters.stiffness_nm_per_rad.get(),
            damping: parameters.damping_nms_per_rad.get(),
        }
    }

    /// True if a joint that moves from `q` to `end` (rad, m) touches a stop.
    fn is_touched(&self, q: f64, end: f64) -> bool {
        q.min(end) < self.limits.lower || q.max(end) > self.limits.upper
    }

    fn torque(&self, q: f64, dq: f64) -> f64 {
        let depth = (self.limits.lower - q).max(0.0) - (q - self.limits.upper).max(0.0);
        if depth == 0.0 {
            return 0.0;
        }
        let torque = self.stiffness * depth - self.damping * dq;
        // A stop only pushes back; it does not pull a joint that leaves it.
        if depth > 0.0 { torque.max(0.0) } else { torque.min(0.0) }
    }
}

/// Spring and damper to the position at which the brake was engaged; the brake slips above its slip torque.
#[derive(Clone, Debug)]
pub struct Brake {
    stiffness: f64,
    damping: f64,
    slip_torque: f64,
    engaged_at: Option<f64>,
}

impl Brake {
    /// Returns a released brake that slips at `slip_torque_nm` (Nm).
    #[must_use]
    pub fn new(parameters: &BrakeParameters, slip_torque_nm: f64) -> Self {
        Self {
            stiffness: parameters.stiffness_nm_per_rad.get(),
            damping: parameters.damping_nms_per_rad.get(),
            slip_torque: slip_torque_nm,
            engaged_at: None,
        }
    }

    fn torque(&self, q: f64, dq: f64) -> f64 {
        let Some(engaged_at) = self.engaged_at else {
            return 0.0;
        };
        let spring = self.stiffness * (engaged_at - q);
        (spring - self.damping * dq).clamp(-self.slip_torque, self.slip_torque)
    }
}

/// Position sensor with a finite resolution.
#[derive(Clone, Debug)]
pub struct Encoder {
    side: EncoderSide,
    resolution_rad: Option<f64>,
}

impl Encoder {
    /// Returns an encoder on the rotor with steps of `resolution_rad` (rad, at the joint); `None` reads the exact position.
    #[must_use]
    pub fn new(resolution_rad: Option<f64>) -> Self {
        Self { side: EncoderSide::Motor, resolution_rad }
    }

    /// Sets the side of the gear on which it is.
    #[must_use]
    pub fn on(self, side: EncoderSide) -> Self {
        Self { side, ..self }
    }

    fn read(&self, q: f64) -> f64 {
        match self.resolution_rad {
            Some(step) => (q / step).round() * step,
            None => q,
        }
    }
}
