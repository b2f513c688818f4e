//! Drivetrain of a joint: motor with its current loop, friction, end stop, brake, encoder.
//!
//! The torque on the link is `((motor − friction) + end stop) + brake`; contact forces are part of the
//! [plant](crate::plant). The gear is rigid: the motor moves with the link, and the rotor's inertia is in the plant's
//! mass matrix.

use crate::friction::LuGre;
use crate::motor::Motor;
use crate::parameters::{BrakeParameters, EndStopParameters};
use opspace_model::Limits;

/// Drivetrain of one joint.
#[derive(Clone, Debug)]
pub struct Drivetrain {
    motor: Motor,
    friction: LuGre,
    end_stop: EndStop,
    brake: Brake,
    encoder: Encoder,
    motor_torque: f64,
    joint_torque: f64,
}

impl Drivetrain {
    /// Returns a drivetrain with its brake released.
    #[must_use]
    pub fn new(motor: Motor, friction: LuGre, end_stop: EndStop, brake: Brake, encoder: Encoder) -> Self {
        Self { motor, friction, end_stop, brake, encoder, motor_torque: 0.0, joint_torque: 0.0 }
    }

    /// Returns the torque on the link (Nm, N), constant over the next `dt_s` (s), at position `q` (rad, m) and velocity
    /// `dq` (rad/s, m/s); `commanded` (Nm, N) is the input of the current loop.
    pub fn step(&mut self, q: f64, dq: f64, dt_s: f64, commanded: f64) -> f64 {
        let motor = self.motor.step(commanded);
        let friction = self.friction.step(dq, dt_s);
        let stop = self.end_stop.torque(q, dq);
        self.motor_torque = motor;
        self.joint_torque = motor - friction + stop + self.brake.torque(q, dq);
        self.joint_torque
    }

    /// Mean motor torque at the joint over the last step, Nm or N.
    #[must_use]
    pub fn motor_torque(&self) -> f64 {
        self.motor_torque
    }

    /// Torque on the link during the last step, Nm or N.
    #[must_use]
    pub fn joint_torque(&self) -> f64 {
        self.joint_torque
    }

    /// Returns the encoder reading at position `q` (rad, m).
    #[must_use]
    pub fn read_encoder(&self, q: f64) -> f64 {
        self.encoder.read(q)
    }

    /// Engages the brake at position `q` (rad, m). A brake that is already engaged keeps its position.
    pub fn engage_brake(&mut self, q: f64) {
        self.brake.engaged_at.get_or_insert(q);
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
    resolution_rad: Option<f64>,
}

impl Encoder {
    /// Returns an encoder with steps of `resolution_rad` (rad); `None` reads the exact position.
    #[must_use]
    pub fn new(resolution_rad: Option<f64>) -> Self {
        Self { resolution_rad }
    }

    fn read(&self, q: f64) -> f64 {
        match self.resolution_rad {
            Some(step) => (q / step).round() * step,
            None => q,
        }
    }
}
