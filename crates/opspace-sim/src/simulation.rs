//! Simulation of any number of arms in one plant, on one clock.
//!
//! The rate of the clock is the least common multiple of the servo rates. Reading an arm advances the simulation to
//! that arm's next interface cycle that the bus does not lose, and no further. If arms are read in the order of their
//! [next samples](crate::SimulatedArm::next_sample_s), every command arrives in time, and arms with samples at the same
//! time may be read in either order. If the simulation passes a cycle of an arm before the arm is read, the cycle is
//! lost, as on a bus; its rows are kept until the arm is read or dropped.

use crate::config::{CouplingConfig, SimulationConfig};
use crate::engine::Plant;
use crate::environment::Mistake;
use crate::error::SimulationError;
use crate::fault;
use crate::interface::{ArmInterface, Place};
use crate::plant::{JointTorque, PlantArm, PlantConfig, PlantCoupling, PlantError, PlantFrame, PlantObject};
use crate::rigid::RigidPlant;
use crate::timing::Clock;
use crate::truth::ContactSignals;
use crate::turns::Turns;
use nalgebra::Vector3;
use opspace_backend::{DeviceFault, Sample, signal_names};
use opspace_model::{FrameId, Model};

/// Plant with the drives and sensors of its arms.
pub struct Simulation {
    pub(crate) plant: Box<dyn Plant>,
    pub(crate) arms: Vec<ArmInterface>,
    pub(crate) capabilities: Vec<opspace_backend::Capabilities>,
    clock: Clock,
    tick: u64,
    /// Ticks until the last controller starts.
    rest_ticks: f64,
    /// Torques on the links of all arms, one arm after the other.
    torques: Vec<JointTorque>,
    /// Velocities of all arms at the end of a step, rad/s or m/s.
    end: Vec<f64>,
    turns: Turns,
}

impl Simulation {
    /// Returns a simulation with the library's rigid-body plant. The arms are at rest at their start positions and hold
    /// themselves.
    ///
    /// # Errors
    /// If parameters contradict each other; the error names the key.
    pub fn new(config: SimulationConfig) -> Result<Self, SimulationError> {
        Self::with_plant(config, |plant| Ok(Box::new(RigidPlant::new(plant))))
    }

    /// Returns a simulation on another physics engine, which `build` creates from the parts of the plant.
    ///
    /// # Errors
    /// If parameters contradict each other, where the error names the key, or if `build` fails.
    pub fn with_plant(
        config: SimulationConfig,
        build: impl FnOnce(PlantConfig) -> Result<Box<dyn Plant>, PlantError>,
    ) -> Result<Self, SimulationError> {
        if config.arms.is_empty() {
            return Err(SimulationError::NoArm);
        }
        config.arms.iter().try_for_each(crate::config::ArmConfig::check)?;
        let rates =
            config.arms.iter().map(|arm| (arm.profile.servo_hz.get(), arm.simulated.physics_hz.get()));
        let clock = Clock::new(rates)?;
        let models: Vec<Model> = config.arms.iter().map(crate::config::ArmConfig::true_model).collect();
        let objects = held_objects(&config, &models, clock.physics_hz)?;
        let mut arms = Vec::new();
        let mut first_joint = 0;
        for (index, (arm, model)) in config.arms.iter().zip(&models).enumerate() {
            let joints = first_joint..first_joint + model.n();
            first_joint = joints.end;
            let couplings = config.couplings.iter().filter(|c| c.touches(index));
            let couplings = couplings.map(|c| ContactSignals::without_moment(&c.name));
            let named = || config.objects.iter().map(|object| &object.name).zip(&objects);
            let grips = named().flat_map(|(name, object)| grip_signals(name, object, index, model));
            let is_held = |object: &PlantObject| object.grips.iter().any(|grip| grip.frame.arm == index);
            let held = named().enumerate().filter(|(_, (_, object))| is_held(object));
            let held = held.map(|(object, (name, _))| (name.clone(), object)).collect();
            let place = Place { index, joints, contacts: couplings.chain(grips).collect(), held };
            arms.push(ArmInterface::new(arm, model, place, &clock)?);
        }
        let couplings =
            config.couplings.iter().map(|c| coupling(c, &models)).collect::<Result<Vec<_>, _>>()?;
        let rest = |arm: &ArmInterface| arm.timing.rest_ticks * arm.timing.ticks_per_servo as f64;
        let plant_arm = |(arm, model): (&crate::config::ArmConfig, Model)| PlantArm {
            contacts: arm.contacts(&model),
            capsules: frames_of(&model, arm.capsules.iter().map(|c| (c.link.as_str(), c.capsule()))),
            sensors: frames_of(&model, arm.capabilities.force_sensors.iter().map(|s| (s.frame.as_str(), ())))
                .into_iter()
                .map(|(frame, ())| frame)
                .collect(),
            q: arm.start.clone(),
            model,
        };
        Ok(Self {
            rest_ticks: arms.iter().map(rest).fold(0.0, f64::max),
            arms,
            plant: build(PlantConfig {
                arms: config.arms.iter().zip(models).map(plant_arm).collect(),
                couplings,
                objects,
                step_s: clock.step_s(),
            })
            .map_err(SimulationError::Plant)?,
            capabilities: config.arms.into_iter().map(|arm| arm.capabilities).collect(),
            clock,
            tick: 0,
            torques: vec![JointTorque::default(); first_joint],
            end: vec![0.0; first_joint],
            turns: Turns::new(first_joint),
        })
    }

    /// Advances to the arm's next interface cycle that the bus does not lose, and reads the arm.
    pub(crate) fn read(&mut self, index: usize, sample: &mut Sample) -> Result<(), DeviceFault> {
        let result = self.read_cycle(index, sample);
        self.arms[index].rows.finish();
        result
    }

    fn read_cycle(&mut self, index: usize, sample: &mut Sample) -> Result<(), DeviceFault> {
        loop {
            while self.tick < self.arms[index].timing.next_cycle() {
                self.advance();
            }
            let arm = &mut self.arms[index];
            let passes = arm.begin_cycle(&mut *self.plant);
            let state = arm.q(&*self.plant).iter().chain(arm.dq(&*self.plant));
            if !state.into_iter().all(|value| value.is_finite()) {
                return Err(fault::diverged());
            }
            if passes {
                arm.measure(&*self.plant, sample);
                return Ok(());
            }
        }
    }

    /// Advances by one tick of the simulation.
    fn advance(&mut self) {
        let plant = &mut *self.plant;
        for arm in &mut self.arms {
            if self.tick == arm.timing.next_cycle() {
                // The arm was not read in time: its cycle is lost.
                arm.begin_cycle(plant);
            }
            if arm.timing.is_servo_tick(self.tick) {
                arm.servo_tick(plant);
            }
        }
        self.run_physics();
        self.tick += 1;
        for arm in &mut self.arms {
            if arm.timing.is_servo_tick(self.tick) {
                arm.end_servo_period(&mut *self.plant);
            }
        }
    }

    /// Revises the torques of joints that are integrated implicitly, until they are those of the velocities to which they lead.
    fn revise_torques(&mut self, time_s: f64, dt_s: f64) {
        let Self { plant, arms, torques, end, .. } = self;
        while plant.end_velocities(time_s, dt_s, torques, end) {
            let mut changes = false;
            for arm in arms.iter_mut() {
                changes |= arm.revise_step(end, dt_s, torques);
            }
            if !changes {
                break;
            }
        }
    }

    /// Runs the physics steps of a tick.
    fn run_physics(&mut self) {
        let period_s = 1.0 / self.clock.rate_hz;
        let dt_s = self.clock.step_s();
        let begin_s = (self.tick as f64 - self.rest_ticks) * period_s;
        for step in 0..self.clock.steps_per_tick {
            self.arms.iter_mut().for_each(ArmInterface::drive);
            let time_s = begin_s + f64::from(step) * dt_s;
            let mut left_s = dt_s;
            while left_s > 0.0 {
                let part_s = self.turns.part_s(self.plant.dq(), dt_s, left_s);
                self.run_step(time_s + (dt_s - left_s), part_s, part_s / dt_s);
                left_s = if part_s < left_s { left_s - part_s } else { 0.0 };
            }
        }
    }

    /// Runs a step of `dt_s` (s) from the time `time_s` (s), which is this share of a physics step.
    fn run_step(&mut self, time_s: f64, dt_s: f64, share: f64) {
        for arm in &mut self.arms {
            arm.begin_step(&*self.plant, dt_s, &mut self.torques);
        }
        if self.arms.iter().any(ArmInterface::is_implicit) {
            self.revise_torques(time_s, dt_s);
        }
        self.plant.step(time_s, dt_s, &self.torques);
        for arm in &mut self.arms {
            arm.end_step(&*self.plant, dt_s, share);
        }
    }
}

/// Returns the items whose frames the model has.
fn frames_of<'a, T>(model: &Model, items: impl Iterator<Item = (&'a str, T)>) -> Vec<(FrameId, T)> {
    items.filter_map(|(frame, item)| Some((model.frame_id(frame).ok()?, item))).collect()
}

/// Returns the coupling with its frames resolved.
fn coupling(config: &CouplingConfig, models: &[Model]) -> Result<PlantCoupling, SimulationError> {
    let error = |reason: String| SimulationError::Coupling { coupling: config.name.clone(), reason };
    let find = |(arm, frame): &(usize, String)| {
        let model = models.get(*arm).ok_or_else(|| error(format!("no arm {arm}")))?;
        let frame = model.frame_id(frame).map_err(|source| error(source.to_string()))?;
        Ok(PlantFrame { arm: *arm, frame })
    };
    if config.first.0 == config.second.0 {
        return Err(error("both frames are on the same arm".to_owned()));
    }
    Ok(PlantCoupling {
        frames: [find(&config.first)?, find(&config.second)?],
        stiffness_n_per_m: config.stiffness_n_per_m.get(),
        damping_ns_per_m: config.damping_ns_per_m.get(),
    })
}

/// Returns the held objects with their frames resolved.
fn held_objects(
    config: &SimulationConfig,
    models: &[Model],
    physics_hz: f64,
) -> Result<Vec<PlantObject>, SimulationError> {
    let arms: Vec<(&Model, &[f64])> =
        models.iter().zip(&config.arms).map(|(model, arm)| (model, arm.start.as_slice())).collect();
    let gravity = config.arms.first().map_or_else(Vector3::zeros, |arm| arm.model.gravity());
    let mut objects = Vec::new();
    for (index, object) in config.objects.iter().enumerate() {
        let error = |mistake| SimulationError::HeldObject { object: object.name.clone(), mistake };
        let of_arms = config.arms.iter().flat_map(|arm| arm.environment.iter().map(|(name, _)| name));
        let others = of_arms.chain(config.couplings.iter().map(|coupling| &coupling.name));
        let mut others = others.chain(config.objects[..index].iter().map(|other| &other.name));
        if others.any(|name| *name == object.name) {
            return Err(error(Mistake::new("", "another object or coupling has the same name")));
        }
        objects.push(object.placed(&arms, gravity, physics_hz).map_err(error)?);
    }
    Ok(objects)
}

/// Returns the signals of the grips of one arm on an object.
fn grip_signals<'a>(
    name: &'a str,
    object: &'a PlantObject,
    arm: usize,
    model: &'a Model,
) -> impl Iterator<Item = ContactSignals> + 'a {
    let hands = object.hands().into_iter().filter(move |hand| hand.arm == arm);
    hands.map(move |hand| ContactSignals {
        name: signal_names::of(name, &model.frame(hand.frame).name),
        has_moment: object.grips.iter().any(|grip| grip.frame == hand && grip.has_moment()),
    })
}
