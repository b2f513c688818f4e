//! Motion of a held object, and the forces of its grips.

use crate::environment::body::Body;
use crate::plant_object::{PlantFrame, PlantGrip, PlantObject};
use crate::rotating_body::RotatingBody;
use nalgebra::{UnitQuaternion, Vector3};
use opspace_backend::SignalRecorder;
use opspace_backend::signal_names::{ORIENTATION, POSITION, VELOCITY};
use opspace_model::Force;

/// Rigid object in a simulation, held by hands of arms.
#[derive(Clone, Debug)]
pub struct HeldObject {
    mass: f64,
    gravity: Vector3<f64>,
    supported_until_s: f64,
    translation: Body<3>,
    rotation: RotatingBody,
    grips: Vec<Grip>,
    hands: Vec<Hand>,
}

/// Frame of an arm that holds the object at some time.
#[derive(Clone, Debug)]
pub(crate) struct Hand {
    pub frame: PlantFrame,
    /// Motion in the middle of the present step.
    pub motion: HandMotion,
    /// Force and moment on the frame in the last step, world axes (N, Nm).
    pub wrench: Force,
}

/// Motion of a hand, in world axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HandMotion {
    /// Origin, m.
    pub position: Vector3<f64>,
    /// Velocity of the origin, m/s.
    pub velocity: Vector3<f64>,
    /// Orientation.
    pub orientation: UnitQuaternion<f64>,
    /// Angular velocity, rad/s.
    pub angular_velocity: Vector3<f64>,
}

/// Springs and dampers between the object and a hand.
#[derive(Clone, Debug)]
struct Grip {
    parameters: PlantGrip,
    /// Index of the hand.
    hand: usize,
    /// Place and orientation of the hand in the axes of the object where the springs are relaxed; `None` while it does not
    /// hold.
    relaxed: Option<(Vector3<f64>, UnitQuaternion<f64>)>,
}

impl HandMotion {
    const AT_REST: Self = Self {
        position: Vector3::new(0.0, 0.0, 0.0),
        velocity: Vector3::new(0.0, 0.0, 0.0),
        orientation: UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(1.0, 0.0, 0.0, 0.0)),
        angular_velocity: Vector3::new(0.0, 0.0, 0.0),
    };
}

impl HeldObject {
    /// Returns the object at rest at its start.
    #[must_use]
    pub fn new(parameters: PlantObject) -> Self {
        let hands = parameters.hands();
        let grip = |grip: PlantGrip| Grip {
            hand: hands.iter().position(|hand| *hand == grip.frame).unwrap_or_default(),
            parameters: grip,
            relaxed: None,
        };
        let hand =
            |frame: &PlantFrame| Hand { frame: *frame, motion: HandMotion::AT_REST, wrench: Force::zero() };
        Self {
            mass: parameters.mass_kg,
            gravity: parameters.gravity_m_per_s2,
            supported_until_s: parameters.supported_until_s,
            translation: Body::passing(parameters.position_m, Vector3::zeros(), 0.0),
            rotation: RotatingBody::at_rest(parameters.inertia_kg_m2),
            grips: parameters.grips.into_iter().map(grip).collect(),
            hands: hands.iter().map(hand).collect(),
        }
    }

    /// Position of the centre of mass, m.
    #[must_use]
    pub fn position(&self) -> Vector3<f64> {
        self.translation.position()
    }

    /// Velocity of the centre of mass, m/s.
    #[must_use]
    pub fn velocity(&self) -> Vector3<f64> {
        self.translation.velocity()
    }

    /// Orientation, which is the identity at the start.
    #[must_use]
    pub fn orientation(&self) -> UnitQuaternion<f64> {
        self.rotation.orientation()
    }

    /// Angular velocity in world axes, rad/s.
    #[must_use]
    pub fn angular_velocity(&self) -> Vector3<f64> {
        self.rotation.angular_velocity()
    }

    /// Hands, in the order of [`PlantObject::hands`].
    pub(crate) fn hands(&self) -> &[Hand] {
        &self.hands
    }

    /// Hands, whose motion is to be set before each step.
    pub(crate) fn hands_mut(&mut self) -> &mut [Hand] {
        &mut self.hands
    }

    /// Computes the forces on the hands in the middle of a step of `dt` (s), at `t` seconds after the start of control, and
    /// advances the object by the step.
    pub(crate) fn step(&mut self, t: f64, dt: f64) {
        let (position, velocity) = self.translation.middle(dt);
        let (orientation, angular_velocity) = self.rotation.middle(dt);
        let object = HandMotion { position, velocity, orientation, angular_velocity };
        let mut force = self.gravity * self.mass;
        let mut moment = Vector3::zeros();
        for hand in &mut self.hands {
            hand.wrench = Force::zero();
        }
        for grip in &mut self.grips {
            let hand = &mut self.hands[grip.hand];
            let wrench = grip.wrench(t, &object, &hand.motion);
            hand.wrench += wrench;
            force -= wrench.linear;
            moment -= wrench.angular + (hand.motion.position - position).cross(&wrench.linear);
        }
        if t >= self.supported_until_s {
            self.translation.advance(force / self.mass, dt);
            self.rotation.advance(moment, dt);
        }
    }

    /// Records position, orientation and velocity in signals that begin with `name`.
    pub(crate) fn record(&self, name: &str, out: &mut SignalRecorder<'_>) {
        Self::record_state(name, &self.position(), &self.orientation(), &self.velocity(), out);
    }

    /// Records a position (m), an orientation and a velocity (m/s) as those of an object.
    pub(crate) fn record_state(
        name: &str,
        position: &Vector3<f64>,
        orientation: &UnitQuaternion<f64>,
        velocity: &Vector3<f64>,
        out: &mut SignalRecorder<'_>,
    ) {
        let quaternion = [orientation.w, orientation.i, orientation.j, orientation.k];
        out.signal((name, POSITION), "m", &["x", "y", "z"], position.as_slice());
        out.signal((name, ORIENTATION), "1", &["w", "x", "y", "z"], &quaternion);
        out.signal((name, VELOCITY), "m/s", &["x", "y", "z"], velocity.as_slice());
    }
}

impl Grip {
    /// Returns force and moment (world axes; N, Nm) on the hand, in a step whose middle is at `t` seconds after the start of
    /// control.
    fn wrench(&mut self, t: f64, object: &HandMotion, hand: &HandMotion) -> Force {
        let p = &self.parameters;
        if t < p.from_s || t >= p.until_s {
            self.relaxed = None;
            return Force::zero();
        }
        let lever = hand.position - object.position;
        let (place, rotation) = self.relaxed.get_or_insert_with(|| {
            let inverse = object.orientation.inverse();
            (inverse * lever, inverse * hand.orientation)
        });
        let stretch = object.orientation * *place - lever;
        let speed = object.velocity + object.angular_velocity.cross(&lever) - hand.velocity;
        let linear = stretch * p.stiffness_n_per_m + speed * p.damping_ns_per_m;
        if !p.has_moment() {
            return Force { linear, angular: Vector3::zeros() };
        }
        let twist = (object.orientation * *rotation * hand.orientation.inverse()).scaled_axis();
        let spin = object.angular_velocity - hand.angular_velocity;
        Force { linear, angular: twist * p.stiffness_nm_per_rad + spin * p.damping_nms_per_rad }
    }
}
