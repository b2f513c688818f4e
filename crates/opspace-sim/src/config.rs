//! Configuration of simulated arms: nominal parameters, and differences of the plant from them.

use crate::bus::MAX_DROPOUT_S;
use crate::drivetrain::{Brake, Drivetrain, Encoder, EndStop};
use crate::environment::{EnvironmentObject, EnvironmentObjectParameters, OperatorMotion};
use crate::error::SimulationError;
use crate::force_sensor::SimulatedForceSensor;
use crate::friction::LuGre;
use crate::gear::{ElasticGear, GearConfig, MAX_STEPS};
use crate::held_object::HeldObjectConfig;
use crate::motor::{AngleTorque, Motor};
use crate::own_gravity::OwnGravity;
use crate::parameters::{EncoderSide, SimulatedParameters};
use crate::random::{RngStream, generator};
use crate::sensor_load::SensorLoad;
use crate::stiffness::{LinkElements, explicit_gear_hz, link_steps};
use crate::timing::{Clock, Timing};
use nalgebra::{DVector, Vector3};
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_backend::{Capabilities, CommandKind, GravityCompensation, MAX_DELAY_CYCLES};
use opspace_model::collision::LinkCapsule;
use opspace_model::{Data, FrameId, Inertia, Model, Placement, crba, frame_placement, kinematics};
use opspace_transformer::{
    FrictionParameters, JointParameters, ProfileParameters, ServoLaw, ServoParameters,
};
use std::f64::consts::TAU;

/// Largest lateness of measured torques, servo ticks; more indicates a mistake in a unit.
const MAX_TORQUE_DELAY: u32 = 10_000;

/// Configuration of a simulated arm.
#[derive(Clone, Debug)]
pub struct ArmConfig {
    /// Nominal rigid bodies, including rotors. Their base is placed in the world of the simulation.
    pub model: Model,
    /// Nominal drives (n).
    pub joints: Vec<JointParameters>,
    /// Nominal servos (n).
    pub servos: Vec<ServoParameters>,
    /// Rates and delay.
    pub profile: ProfileParameters,
    /// Declared properties: kind of robot, and measured quantities.
    pub capabilities: Capabilities,
    /// Differences of the plant from the nominal values.
    pub simulated: SimulatedParameters,
    /// Environment objects that act on the arm, by name; positions and directions are in the world of the simulation.
    pub environment: Vec<(String, EnvironmentObjectParameters)>,
    /// Collision geometry of the links, for physics engines that simulate contacts of bodies.
    pub capsules: Vec<LinkCapsule>,
    /// True if a program may apply external forces while the simulation runs.
    pub external_forces: bool,
    /// Start positions, at rest (n; rad or m).
    pub start: Vec<f64>,
    /// Time for which the arm holds itself before the controller starts, s.
    pub rest_s: f64,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// Configuration of a simulation.
#[derive(Clone, Debug, Default)]
pub struct SimulationConfig {
    /// Arms, in the order of their indices.
    pub arms: Vec<ArmConfig>,
    /// Springs between arms.
    pub couplings: Vec<CouplingConfig>,
    /// Objects that arms hold.
    pub objects: Vec<HeldObjectConfig>,
}

/// Spring and damper between the origins of frames of two arms, relaxed at the start: an elastic object without mass that
/// both arms hold.
#[derive(Clone, Debug, PartialEq)]
pub struct CouplingConfig {
    /// Name in the true rows of both arms.
    pub name: String,
    /// Index of the first arm, and name of its frame.
    pub first: (usize, String),
    /// Index of the second arm, and name of its frame.
    pub second: (usize, String),
    /// Stiffness, N/m.
    pub stiffness_n_per_m: NonNegative,
    /// Damping, Ns/m.
    pub damping_ns_per_m: NonNegative,
}

impl CouplingConfig {
    /// True if it is attached to a frame of the arm with this index.
    pub(crate) fn touches(&self, arm: usize) -> bool {
        self.first.0 == arm || self.second.0 == arm
    }
}

impl ArmConfig {
    pub(crate) fn check(&self) -> Result<(), SimulationError> {
        let joints = self.model.joints().iter().map(|joint| &joint.name);
        if !joints.eq(&self.capabilities.joints) {
            return Err(SimulationError::Joints { declared: self.capabilities.joints.clone() });
        }
        if self.servos.len() != self.model.n() {
            return Err(SimulationError::Servos { found: self.servos.len(), joints: self.model.n() });
        }
        let truths = [
            ("servo", self.simulated.servo.keys().collect::<Vec<_>>()),
            ("velocity_servo", self.simulated.velocity_servo.keys().collect()),
            ("friction", self.simulated.friction.keys().collect()),
            ("gear", self.simulated.gear.keys().collect()),
            (
                "current_measurement.joint_scale",
                self.simulated.current_measurement.joint_scale.keys().collect(),
            ),
            (
                "joint_torque_measurement.offset_nm",
                self.simulated.joint_torque_measurement.offset_nm.keys().collect(),
            ),
        ];
        for (section, joints) in truths {
            for joint in joints {
                self.model.joint(joint).map_err(|source| SimulationError::Joint { section, source })?;
            }
        }
        if let Some(limits) = &self.profile.setpoint_limits {
            for joint in limits.joint.keys() {
                self.model.joint(joint).map_err(|source| SimulationError::SetpointLimits { source })?;
            }
        }
        for joint in 0..self.model.n() {
            self.check_gear(joint)?;
        }
        let sensors = &self.simulated.joint_torque_measurement;
        for (section, delay) in [
            ("current_measurement", self.simulated.current_measurement.delay_servo_ticks),
            ("joint_torque_measurement", sensors.delay_servo_ticks),
        ] {
            if delay > MAX_TORQUE_DELAY {
                return Err(SimulationError::TorqueDelay { section, delay, most: MAX_TORQUE_DELAY });
            }
        }
        if let Some((joint, _)) = sensors.offset_nm.iter().find(|(_, offset)| !offset.is_finite()) {
            return Err(SimulationError::TorqueOffset { joint: joint.clone() });
        }
        for (name, payload) in &self.simulated.payload {
            self.model
                .frame_id(&payload.frame)
                .map_err(|source| SimulationError::Payload { payload: name.clone(), source })?;
        }
        for sensor in &self.capabilities.force_sensors {
            if !self.simulated.force_sensor.contains_key(&sensor.name) {
                return Err(SimulationError::UnknownSensorQuality { sensor: sensor.name.clone() });
            }
            self.model
                .frame_id(&sensor.frame)
                .map_err(|source| SimulationError::SensorFrame { sensor: sensor.name.clone(), source })?;
        }
        for (name, object) in &self.environment {
            self.model
                .frame_id(object.frame())
                .map_err(|source| SimulationError::Frame { object: name.clone(), source })?;
            match object {
                EnvironmentObjectParameters::Spring(spring) => {
                    if spring.report.is_empty() {
                        return Err(SimulationError::NothingReported { object: name.clone() });
                    }
                    if let OperatorMotion::Random(motion) = &spring.motion
                        && motion.to_hz < motion.from_hz
                    {
                        return Err(SimulationError::Band { object: name.clone() });
                    }
                }
                EnvironmentObjectParameters::Wall(wall) if Vector3::from(wall.normal).amax() == 0.0 => {
                    return Err(SimulationError::Normal { object: name.clone() });
                }
                _ => {}
            }
            object
                .check(self.simulated.physics_hz.get())
                .map_err(|mistake| SimulationError::EnvironmentObject { object: name.clone(), mistake })?;
        }
        Ok(())
    }

    /// Returns the timing of this arm in a simulation.
    pub(crate) fn timing(&self, clock: &Clock) -> Result<Timing, SimulationError> {
        let ratio = self.profile.servo_ticks_per_cycle.get();
        let nominal = self.profile.delay();
        let delay = self.simulated.delay_servo_ticks.unwrap_or(nominal);
        let most = MAX_DELAY_CYCLES * ratio;
        if delay > most {
            return Err(SimulationError::Delay { delay, most, truth: delay != nominal });
        }
        self.check_bus(ratio)?;
        let servo_hz = self.profile.servo_hz.get();
        let ticks_per_servo = clock.ticks_per_servo(servo_hz);
        Ok(Timing {
            servo_period_s: self.profile.servo_period_s(),
            servo_ticks_per_cycle: ratio,
            delay,
            rest_ticks: (self.rest_s / self.profile.period_s()).round() * f64::from(ratio),
            servo_tick: 0,
            cycles: 0,
            ticks_per_servo,
            steps_per_servo: clock.steps_per_tick * ticks_per_servo as u32,
        })
    }

    fn check_bus(&self, ratio: u32) -> Result<(), SimulationError> {
        let bus = &self.simulated.bus;
        if bus.lost_cycles_share.get() >= 1.0 {
            return Err(SimulationError::LostCycles { share: bus.lost_cycles_share.get() });
        }
        if let Some(long) = bus.dropouts.iter().find(|d| d.duration_s.get() > MAX_DROPOUT_S) {
            let duration_s = long.duration_s.get();
            return Err(SimulationError::Dropout { duration_s, longest_s: MAX_DROPOUT_S });
        }
        if bus.jitter_servo_ticks > 0 && bus.jitter_servo_ticks >= ratio {
            return Err(SimulationError::Jitter { jitter: bus.jitter_servo_ticks, ratio });
        }
        Ok(())
    }

    fn name(&self, joint: usize) -> &str {
        &self.model.joints()[joint].name
    }

    /// True friction of a joint in the plant.
    fn true_friction(&self, joint: usize) -> &FrictionParameters {
        self.simulated.friction.get(self.name(joint)).unwrap_or(&self.joints[joint].friction)
    }

    /// Returns the elastic gear of a joint; `None` if its gear is rigid.
    fn gear(&self, joint: usize) -> Option<GearConfig> {
        let gear = self.simulated.gear.get(self.name(joint));
        let nominal = self.joints[joint].gear_stiffness_nm_per_rad;
        let scale = &self.simulated.true_over_nominal;
        let stiffness = gear.and_then(|gear| gear.stiffness_nm_per_rad).or(nominal)?;
        Some(GearConfig {
            stiffness: stiffness.get() * scale.gear_stiffness.get(),
            damping: gear.map_or(0.0, |gear| gear.damping_nms_per_rad.get()),
            backlash: gear.map_or(0.0, |gear| gear.backlash_rad.get()),
            inertia: self.model.rotor_inertia()[joint] * scale.inertia.get(),
        })
    }

    fn check_gear(&self, joint: usize) -> Result<(), SimulationError> {
        let name = || self.name(joint).to_owned();
        match self.gear(joint) {
            Some(gear) if gear.inertia > 0.0 => Ok(()),
            Some(_) => Err(SimulationError::GearRotor { joint: name() }),
            None if self.simulated.gear.contains_key(self.name(joint)) => {
                Err(SimulationError::GearStiffness { joint: name() })
            }
            None => Ok(()),
        }
    }

    /// Name of the joint with the least inertia at the start.
    fn lightest_joint(&self, model: &Model) -> String {
        let mut data = Data::new(model);
        kinematics(model, &mut data, &self.start, &vec![0.0; model.n()]);
        crba(model, &mut data);
        self.name(data.mass_matrix.diagonal().imin()).to_owned()
    }

    /// Physics rate that is enough for explicit steps of the elastic gears, Hz; `None` if all gears are rigid. At lower rates, gears
    /// are integrated implicitly, which damps the vibrations of the links on them.
    #[must_use]
    pub fn explicit_gear_hz(&self) -> Option<f64> {
        let elements: Vec<LinkElements> =
            (0..self.model.n()).map(|joint| self.elements(joint, 0.0)).collect();
        let of_links = explicit_gear_hz(&self.true_model(), &self.start, &elements)?;
        let gears = (0..self.model.n()).filter_map(|joint| self.gear(joint));
        let hz = gears.map(|gear| gear.least_hz()).fold(of_links, f64::max);
        (hz > 0.0).then_some(hz)
    }

    /// Elements of a joint that act on its link; `dt` is the step of the plant (s).
    fn elements(&self, joint: usize, dt: f64) -> LinkElements {
        let torque_limit = self.joints[joint].torque_limit_nm.get();
        let brake = self.simulated.brake_of(torque_limit);
        let bristle = self.simulated.bristle_of(self.true_friction(joint));
        let scale = self.simulated.true_over_nominal.friction.get();
        let springs = [
            (brake.stiffness_nm_per_rad.get(), brake.damping_nms_per_rad.get()),
            (bristle.stiffness_nm_per_rad.get(), bristle.damping_nms_per_rad.get()),
        ];
        let [brake, mut bristle] = springs;
        bristle.1 += scale * self.true_friction(joint).viscous_nms_per_rad.get();
        let Some(gear) = self.gear(joint) else {
            return LinkElements {
                stiffness: brake.0 + bristle.0,
                damping: brake.1 + bristle.1,
                lacking_damping: springs
                    .iter()
                    .map(|(stiffness, damping)| (dt * stiffness - damping).max(0.0))
                    .sum(),
                ..LinkElements::default()
            };
        };
        // Brake and friction act on the rotor, which makes steps of its own.
        LinkElements {
            gear_stiffness: gear.stiffness,
            gear_damping: gear.damping,
            // The gear of such a rotor takes several steps while the link goes on at its velocity: without damping, both gain energy.
            has_light_rotor: gear.steps(dt, 0.0, 0.0) > 1.0
                || gear.steps(dt, brake.0 + bristle.0, brake.1 + bristle.1) > MAX_STEPS,
            ..LinkElements::default()
        }
    }

    /// Returns the drivetrains; at the start their motors produce `motor_torque` (n; Nm, N), and elastic gears carry
    /// `holding` (n; Nm, N).
    pub(crate) fn drivetrains(
        &self,
        model: &Model,
        motor_torque: &DVector<f64>,
        holding: &DVector<f64>,
        physics_hz: f64,
    ) -> Result<Vec<Drivetrain>, SimulationError> {
        let simulated = &self.simulated;
        let dt = 1.0 / physics_hz;
        let elements: Vec<LinkElements> = (0..model.n()).map(|joint| self.elements(joint, dt)).collect();
        let links = link_steps(model, &self.start, &elements, dt)
            .ok_or_else(|| SimulationError::NoInertia { joint: self.lightest_joint(model) })?;
        let bandwidth_hz = simulated.current_loop_hz.map(|hz| hz.get());
        let joint = |(i, parameters): (usize, &JointParameters)| {
            let torque_limit = parameters.torque_limit_nm.get();
            let bristle = simulated.bristle_of(self.true_friction(i));
            let brake = simulated.brake_of(torque_limit);
            let friction =
                LuGre::new(self.true_friction(i), &bristle, simulated.true_over_nominal.friction.get())
                    .with_friction_per_load(simulated.friction_per_load.get());
            let slip_torque = torque_limit * brake.holding_torque_ratio.get();
            let drivetrain = Drivetrain::new(
                Motor::new(bandwidth_hz, dt, motor_torque[i]),
                friction,
                EndStop::new(&model.joints()[i].limits, &simulated.end_stop_of(torque_limit)),
                Brake::new(&brake, slip_torque),
                self.encoder(parameters, simulated.encoder.drive),
            )
            .with_link_inertia(links[i].inertia);
            let angle_torque = AngleTorque::new(
                simulated.cogging.as_ref(),
                simulated.torque_ripple.as_ref(),
                parameters.rotor.gear_ratio.get(),
                parameters.torque_limit_nm.get(),
            );
            let drivetrain = drivetrain
                .with_angle_torque(angle_torque)
                .with_interface_encoder(self.encoder(parameters, simulated.encoder.interface));
            let drivetrain = if links[i].is_stiff { drivetrain.with_implicit_steps() } else { drivetrain };
            let Some(gear) = self.gear(i) else { return drivetrain };
            let damping = brake.damping_nms_per_rad.get()
                + bristle.damping_nms_per_rad.get()
                + simulated.true_over_nominal.friction.get()
                    * self.true_friction(i).viscous_nms_per_rad.get();
            let stiffness = brake.stiffness_nm_per_rad.get() + bristle.stiffness_nm_per_rad.get();
            let steps = gear.steps(dt, stiffness, damping);
            drivetrain.with_gear(ElasticGear::new(&gear, steps, self.start[i], holding[i]))
        };
        Ok(self.joints.iter().enumerate().map(joint).collect())
    }

    /// Returns an encoder of a joint on this side of its gear.
    fn encoder(&self, parameters: &JointParameters, side: EncoderSide) -> Encoder {
        let resolution_rad = match (side, self.simulated.encoder.link_counts_per_turn) {
            (EncoderSide::Link, Some(counts)) => TAU / f64::from(counts.get()),
            _ => parameters.rotor.resolution_rad(),
        };
        Encoder::new(self.simulated.encoder_quantisation.then_some(resolution_rad)).on(side)
    }

    /// Returns the drives' torque limits (n; Nm, N), if torque saturation is simulated.
    pub(crate) fn torque_limits(&self) -> Option<DVector<f64>> {
        let limits = self.joints.iter().map(|joint| joint.torque_limit_nm.get());
        self.simulated.torque_saturation.then(|| DVector::from_iterator(self.joints.len(), limits))
    }

    /// Returns the steps of position setpoints (n; rad, m), 0 for exact ones; empty if all are exact.
    pub(crate) fn setpoint_steps(&self) -> Vec<f64> {
        let steps = self.joints.iter().map(|joint| joint.setpoint_resolution_rad.map_or(0.0, Positive::get));
        let steps: Vec<f64> = steps.collect();
        let is_exact =
            self.capabilities.command != CommandKind::Position || steps.iter().all(|step| *step == 0.0);
        if is_exact { Vec::new() } else { steps }
    }

    pub(crate) fn true_servos(&self, period_s: f64) -> Result<Vec<ServoLaw>, SimulationError> {
        self.check_true_position_servos()?;
        let scale = &self.simulated.true_over_nominal;
        (self.servos.iter().enumerate())
            .map(|(joint, nominal)| {
                self.check_servo(joint, nominal)?;
                let truth = self.true_servo(joint, nominal);
                let servo = truth.as_ref().unwrap_or(nominal).scaled(scale.kp.get(), scale.kv.get());
                ServoLaw::new(&servo, period_s).map_err(|source| SimulationError::Servo {
                    joint: self.name(joint).to_owned(),
                    setpoints: nominal.takes(),
                    truth: truth.is_some(),
                    source,
                })
            })
            .collect()
    }

    /// Returns the true servo of a joint if it differs from the nominal one, from the table for servos of the nominal
    /// servo's kind.
    fn true_servo(&self, joint: usize, nominal: &ServoParameters) -> Option<ServoParameters> {
        let (simulated, name) = (&self.simulated, self.name(joint));
        match nominal.takes() {
            CommandKind::Velocity => {
                simulated.velocity_servo.get(name).copied().map(ServoParameters::Velocity)
            }
            _ => simulated.servo.get(name).cloned(),
        }
    }

    /// Returns an error for a velocity servo in the table of the true position servos.
    fn check_true_position_servos(&self) -> Result<(), SimulationError> {
        let mut servos = self.simulated.servo.iter();
        match servos.find(|(_, servo)| servo.takes() == CommandKind::Velocity) {
            None => Ok(()),
            Some((joint, _)) => Err(SimulationError::ServoKind {
                joint: joint.clone(),
                truth: true,
                setpoints: CommandKind::Position,
            }),
        }
    }

    /// Returns an error for a nominal servo whose setpoints are not of the kind that the robot needs.
    fn check_servo(&self, joint: usize, nominal: &ServoParameters) -> Result<(), SimulationError> {
        let setpoints = match self.capabilities.command {
            // The motors accept torques, and brakes hold the arm: servos are not used.
            CommandKind::Torque if self.capabilities.has_brakes => return Ok(()),
            CommandKind::Torque | CommandKind::Position => CommandKind::Position,
            CommandKind::Velocity => CommandKind::Velocity,
        };
        if nominal.takes() == setpoints {
            return Ok(());
        }
        Err(SimulationError::ServoKind { joint: self.name(joint).to_owned(), truth: false, setpoints })
    }

    /// Returns the true rigid bodies of the plant, without the rotors on elastic gears.
    pub(crate) fn true_model(&self) -> Model {
        let model = self.model.clone().with_scaled_inertia(self.simulated.true_over_nominal.inertia.get());
        let rotor = |(joint, &inertia)| if self.gear(joint).is_some() { 0.0 } else { inertia };
        let rotors: Vec<f64> = model.rotor_inertia().iter().enumerate().map(rotor).collect();
        self.with_payloads(model.with_rotor_inertia(&rotors))
    }

    /// Returns the drives' own compensation of gravity; `None` if the controller compensates it.
    pub(crate) fn own_gravity(&self) -> Option<OwnGravity> {
        let is_own = self.capabilities.gravity_compensated_by == GravityCompensation::Robot;
        is_own.then(|| OwnGravity::new(self.model.clone()))
    }

    /// Adds the loads that only the true arm has.
    fn with_payloads(&self, mut model: Model) -> Model {
        for (name, payload) in &self.simulated.payload {
            if let Ok(frame) = model.frame_id(&payload.frame) {
                // A frame of its own: the payload of that frame may be a tool.
                let offset = Placement::from_rpy([0.0; 3], payload.centre_m);
                let own = model.add_frame_on(&format!("payload {name}"), frame, offset);
                model.set_payload(own, Inertia { mass: payload.mass_kg.get(), ..Inertia::zero() });
            }
        }
        model
    }

    /// Returns the environment objects, each with its frame.
    pub(crate) fn contacts(&self, model: &Model) -> Vec<(FrameId, EnvironmentObject)> {
        let mut data = Data::new(model);
        kinematics(model, &mut data, &self.start, &vec![0.0; model.n()]);
        (self.environment.iter().zip(0..))
            .filter_map(|((_, parameters), index)| {
                let frame = model.frame_id(parameters.frame()).ok()?;
                let home = frame_placement(model, &data, frame).translation;
                let random = generator(self.seed, RngStream::EnvironmentObject(index));
                Some((frame, EnvironmentObject::new(parameters, home, self.model.gravity(), random)))
            })
            .collect()
    }

    /// Returns the force sensors, each with its frame.
    pub(crate) fn force_sensors(&self, model: &Model, period_s: f64) -> Vec<(FrameId, SimulatedForceSensor)> {
        (self.capabilities.force_sensors.iter().zip(0..))
            .filter_map(|(sensor, index)| {
                let quality = self.simulated.force_sensor.get(&sensor.name)?;
                let random = generator(self.seed, RngStream::ForceSensor(index));
                let frame = self.model.frame_id(&sensor.frame).ok()?;
                let sensor = SimulatedForceSensor::new(quality, period_s, random);
                let load = quality.load.as_ref();
                let load = load.map(|load| SensorLoad::new(load, model.clone(), frame, period_s));
                Some((frame, sensor.with_load(load, &self.start)))
            })
            .collect()
    }
}
