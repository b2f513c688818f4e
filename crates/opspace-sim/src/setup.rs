//! What a simulated arm is made of, and where truth differs from what is believed.

use crate::bus::LONGEST_DROPOUT_S;
use crate::error::SimulationError;
use crate::force_sensor::SimulatedForceSensor;
use crate::parameters::SimulatedParameters;
use crate::plant::Contact;
use crate::random::{Stream, generator};
use crate::surroundings::{HandMotion, Surrounding, SurroundingParameters};
use nalgebra::Vector3;
use opspace_backend::GravityBy;
use opspace_loop::Facts;
use opspace_model::{Data, FrameId, Model, frame_placement, kinematics};
use opspace_transformer::{
    FrictionParameters, JointParameters, ProfileParameters, ServoError, ServoLaw, ServoParameters,
};

/// Most physics steps per servo tick: more is a slip in a rate, and the run would not come back.
const MAX_STEPS: f64 = 10_000.0;

/// Everything that makes a simulated arm.
#[derive(Clone, Debug)]
pub struct Setup {
    /// The rigid bodies as believed, rotors included.
    pub model: Model,
    /// The drives as believed, one a joint.
    pub joints: Vec<JointParameters>,
    /// The servos as believed, one a joint.
    pub servos: Vec<ServoParameters>,
    /// Rates and delay.
    pub profile: ProfileParameters,
    /// What the robot declares of itself: which kind it is, what it measures.
    pub facts: Facts,
    /// Where truth differs.
    pub simulated: SimulatedParameters,
    /// What touches it, by name.
    pub surroundings: Vec<(String, SurroundingParameters)>,
    /// Where it stands, at rest, rad or m (n).
    pub start: Vec<f64>,
    /// How long it holds itself before the controller starts, s.
    pub rest_s: f64,
    /// Of everything random.
    pub seed: u64,
}

/// Ticks of the servo, counted from the first.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Timing {
    pub servo_period_s: f64,
    pub ratio: u32,
    pub delay: u32,
    pub physics_per_servo: u32,
    pub rest_ticks: f64,
    pub servo_tick: u64,
    pub started: bool,
}

impl Timing {
    /// Time of a servo tick on the robot's clock, which is 0 when the controller starts, s.
    pub fn time_s(&self, servo_tick: u64) -> f64 {
        (servo_tick as f64 - self.rest_ticks) * self.servo_period_s
    }
}

impl Setup {
    pub(crate) fn check(&self) -> Result<(), SimulationError> {
        let truths = [
            ("servo", self.simulated.servo.keys().collect::<Vec<_>>()),
            ("friction", self.simulated.friction.keys().collect()),
        ];
        for (section, joints) in truths {
            for joint in joints {
                self.model.joint(joint).map_err(|source| SimulationError::Joint { section, source })?;
            }
        }
        for sensor in &self.facts.sensors {
            if !self.simulated.force_sensor.contains_key(&sensor.name) {
                return Err(SimulationError::UnknownSensorQuality { sensor: sensor.name.clone() });
            }
        }
        for (name, surrounding) in &self.surroundings {
            self.model
                .frame(surrounding.frame())
                .map_err(|source| SimulationError::Frame { surrounding: name.clone(), source })?;
            match surrounding {
                SurroundingParameters::Spring(spring) => {
                    if spring.report.is_empty() {
                        return Err(SimulationError::NothingReported { surrounding: name.clone() });
                    }
                    if let HandMotion::Random(motion) = &spring.motion
                        && motion.to_hz < motion.from_hz
                    {
                        return Err(SimulationError::Band { surrounding: name.clone() });
                    }
                }
                SurroundingParameters::Wall(wall) => {
                    if Vector3::from(wall.normal).amax() == 0.0 {
                        return Err(SimulationError::Normal { surrounding: name.clone() });
                    }
                }
                SurroundingParameters::Pushes(_) => {}
            }
        }
        Ok(())
    }

    pub(crate) fn timing(&self) -> Result<Timing, SimulationError> {
        let ratio = self.profile.ratio.get();
        let believed = self.profile.delay();
        let delay = self.simulated.delay_servo_ticks.unwrap_or(believed);
        if delay > ratio {
            return Err(SimulationError::Delay { delay, ratio, truth: delay != believed });
        }
        let bus = &self.simulated.bus;
        if bus.lost_cycles_share.get() >= 1.0 {
            return Err(SimulationError::LostCycles { share: bus.lost_cycles_share.get() });
        }
        if let Some(long) = bus.dropouts.iter().find(|d| d.duration_s.get() > LONGEST_DROPOUT_S) {
            let duration_s = long.duration_s.get();
            return Err(SimulationError::Dropout { duration_s, longest_s: LONGEST_DROPOUT_S });
        }
        if bus.jitter_servo_ticks > 0 && bus.jitter_servo_ticks >= ratio {
            return Err(SimulationError::Jitter { jitter: bus.jitter_servo_ticks, ratio });
        }
        let servo_hz = self.profile.servo_hz.get();
        let physics_hz = self.simulated.physics_hz.get();
        let steps = physics_hz / servo_hz;
        if !(1.0..=MAX_STEPS).contains(&steps) || (steps - steps.round()).abs() > 1e-9 * steps {
            return Err(SimulationError::PhysicsRate { physics_hz, servo_hz });
        }
        let period_s = self.profile.period_s();
        Ok(Timing {
            servo_period_s: self.profile.servo_period_s(),
            ratio,
            delay,
            physics_per_servo: steps.round() as u32,
            rest_ticks: (self.rest_s / period_s).round() * f64::from(ratio),
            servo_tick: 0,
            started: false,
        })
    }

    fn name(&self, joint: usize) -> &str {
        &self.model.joints()[joint].name
    }

    pub(crate) fn true_friction(&self) -> Vec<&FrictionParameters> {
        (self.joints.iter().enumerate())
            .map(|(joint, believed)| {
                self.simulated.friction.get(self.name(joint)).unwrap_or(&believed.friction)
            })
            .collect()
    }

    pub(crate) fn true_servos(&self, period_s: f64) -> Result<Vec<ServoLaw>, SimulationError> {
        let scale = &self.simulated.scale;
        (self.servos.iter().enumerate())
            .map(|(joint, believed)| {
                let servo = self.simulated.servo.get(self.name(joint)).unwrap_or(believed);
                let servo = servo.scaled(scale.kp.get(), scale.kv.get());
                ServoLaw::new(&servo, period_s).map_err(|source| self.servo_error(joint, source))
            })
            .collect()
    }

    fn servo_error(&self, joint: usize, source: ServoError) -> SimulationError {
        let joint = self.name(joint).to_owned();
        SimulationError::Servo { truth: self.simulated.servo.contains_key(&joint), joint, source }
    }

    pub(crate) fn true_model(&self) -> Model {
        let model = self.model.clone().with_scaled_inertia(self.simulated.scale.inertia.get());
        match self.facts.gravity_by {
            GravityBy::Controller => model,
            // A robot that carries its own weight is one that has none.
            GravityBy::Robot => model.with_gravity(Vector3::zeros()),
        }
    }

    pub(crate) fn contacts(&self, model: &Model) -> Vec<Contact> {
        let mut data = Data::new(model);
        kinematics(model, &mut data, &self.start, &vec![0.0; model.n()]);
        (self.surroundings.iter().zip(0..))
            .filter_map(|((_, parameters), index)| {
                let frame = model.frame(parameters.frame()).ok()?;
                let home = frame_placement(model, &data, frame).translation;
                let random = generator(self.seed, Stream::Surrounding(index));
                Some(Contact::new(frame, Surrounding::new(parameters, home, random), model.n()))
            })
            .collect()
    }

    pub(crate) fn simulated_sensors(&self, period_s: f64) -> Vec<(FrameId, SimulatedForceSensor)> {
        (self.facts.sensors.iter().zip(0..))
            .filter_map(|(sensor, index)| {
                let quality = self.simulated.force_sensor.get(&sensor.name)?;
                let random = generator(self.seed, Stream::ForceSensor(index));
                Some((sensor.frame, SimulatedForceSensor::new(quality, period_s, random)))
            })
            .collect()
    }
}
