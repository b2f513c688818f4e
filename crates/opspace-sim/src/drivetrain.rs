//! Drivetrain of a joint: motor with its current loop, friction, end stop, brake, encoder.
//!
//! With a rigid gear the motor moves with the link, the rotor's inertia is in the plant's mass matrix, and the torque on
//! the link is `((motor − friction) + end stop) + brake`. With an [elastic gear](crate::gear), motor, friction and brake
//! act on the rotor, whose motion is a state of the drivetrain, and the torque on the link is `gear + end stop`. Contact
//! forces are part of the [plant](crate::plant).
//!
//! The torques above are constant over a step, and computed at its begin, unless they are too stiff for that: see
//! `stiff_joint.rs`.

use crate::friction::LuGre;
use crate::gear::ElasticGear;
use crate::motor::{AngleTorque, Motor};
use crate::parameters::{BrakeParameters, EncoderSide, EndStopParameters};
use crate::plant::JointTorque;
use crate::stiff_joint::{StiffJoint, decrease, end_velocity};
use opspace_model::Limits;

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
    stiff: Option<StiffJoint>,
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
            stiff: None,
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

    /// Integrates brake, end stop, friction and an elastic gear implicitly: they are too stiff for the step. The link has
    /// this inertia with the other joints free, without the rotor of an elastic gear (kg m², kg).
    #[must_use]
    pub fn with_implicit_steps(self, link_inertia: f64) -> Self {
        Self { stiff: Some(StiffJoint::new(link_inertia)), ..self }
    }

    /// Returns the torque on the link over the next `dt_s` (s) from position `q` (rad, m) and velocity `dq` (rad/s, m/s);
    /// `commanded` (Nm, N) is the input of the current loop.
    pub fn begin_step(&mut self, q: f64, dq: f64, dt_s: f64, commanded: f64) -> JointTorque {
        self.current_torque = self.motor.step(commanded);
        self.motor_torque = self.angle_torque.torque(self.current_torque, self.rotor_position(q));
        self.link = q;
        if let Some(mut stiff) = self.stiff.take() {
            let torque = |v: f64| self.end_torque(v, dt_s);
            let result = stiff.begin(dq, dt_s, torque, |v| self.end_slope(v, dt_s));
            self.stiff = Some(stiff);
            return result;
        }
        JointTorque { torque: self.step(q, dq, dt_s), inertia: 0.0 }
    }

    /// Revises the torque of the step of `dt_s` (s) that was begun for the velocity `dq` (rad/s, m/s) of the link at its end; `None` if
    /// it stays.
    pub fn revise_step(&mut self, dq: f64, dt_s: f64) -> Option<JointTorque> {
        let mut stiff = self.stiff.take()?;
        let torque = |v: f64| self.end_torque(v, dt_s);
        let revised = stiff.revise(dq, dt_s, torque, |v| self.end_slope(v, dt_s));
        self.stiff = Some(stiff);
        revised
    }

    /// True if its elements are integrated implicitly.
    #[must_use]
    pub fn is_implicit(&self) -> bool {
        self.stiff.is_some()
    }

    /// Ends the step of `dt_s` (s) that was begun, with the link at velocity `dq` (rad/s, m/s).
    pub fn end_step(&mut self, dq: f64, dt_s: f64) {
        let Some(stiff) = &mut self.stiff else { return };
        self.joint_torque = stiff.end(dq, dt_s);
        let rotor = self.rotor_velocity(dq, dt_s);
        self.friction.step(rotor, dt_s);
        let stop = self.end_stop.torque(self.link + dt_s * dq, dq);
        if let Some(gear) = &mut self.gear {
            gear.end_step(rotor, dt_s);
            self.joint_torque -= stop;
        }
    }

    /// Explicit step: returns the torque on the link (Nm, N), constant over the next `dt_s` (s).
    fn step(&mut self, q: f64, dq: f64, dt_s: f64) -> f64 {
        let motor = self.motor_torque + self.gravity_torque;
        let stop = self.end_stop.torque(q, dq);
        let Self { friction, brake, .. } = self;
        if let Some(gear) = &mut self.gear {
            let rotor = |q: f64, dq: f64, h: f64| motor - friction.step(dq, h) + brake.torque(q, dq);
            self.joint_torque = gear.step(q, dq, dt_s, rotor);
            return self.joint_torque + stop;
        }
        let friction = friction.step(dq, dt_s);
        self.joint_torque = motor - friction + stop + brake.torque(q, dq);
        self.joint_torque
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
        match &self.gear {
            None => self.rotor_torque(v, h) + stop,
            Some(gear) => gear.end_torque(self.link, v, self.rotor_velocity(v, h), h) + stop,
        }
    }

    /// Rate by which [`end_torque`](Self::end_torque) decreases with the velocity (Nms/rad, Ns/m).
    fn end_slope(&self, v: f64, h: f64) -> f64 {
        let stop = decrease(v, |v| self.end_stop.torque(self.link + h * v, v));
        let Some(gear) = &self.gear else { return decrease(v, |v| self.rotor_torque(v, h)) + stop };
        let rotor = self.rotor_velocity(v, h);
        let gear_slope = decrease(v, |v| gear.end_torque(self.link, v, rotor, h));
        let behind = gear.inertia() / h + decrease(rotor, |rotor| self.rotor_torque(rotor, h));
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
