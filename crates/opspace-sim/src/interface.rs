//! Interface of one arm of a simulation: clock, bus, drives, sensors, and rows of its true state.

use crate::bus::Bus;
use crate::command_queue::CommandQueue;
use crate::config::ArmConfig;
use crate::drives::Drives;
use crate::engine::Plant;
use crate::error::SimulationError;
use crate::external::ExternalForceHandle;
use crate::fault;
use crate::force_sensor::SimulatedForceSensor;
use crate::motors::Motors;
use crate::plant::{JointTorque, PlantFrame};
use crate::servo_drives::{ServoDrives, ServoDrivesConfig};
use crate::setpoint_check::SetpointCheck;
use crate::timing::{Clock, Timing};
use crate::torque_drives::TorqueDrives;
use crate::torque_sensor::TorqueSensor;
use crate::truth::{ContactSignals, TruthConfig, TruthRows};
use nalgebra::DVector;
use opspace_backend::{Capabilities, Command, CommandKind, DeviceFault, Sample, Status};
use opspace_model::{Data, FrameId, Model, gravity, kinematics};
use std::ops::Range;

/// Number of consecutive lost cycles, in addition to dropouts, for whose rows memory is preallocated.
const LOST_CYCLES: usize = 64;

/// Arm of a simulation, without its rigid bodies.
pub(crate) struct ArmInterface {
    pub timing: Timing,
    pub rows: TruthRows,
    pub external: Option<ExternalForceHandle>,
    index: usize,
    joints: Range<usize>,
    bus: Bus,
    /// Number of the next cycle that the bus does not lose.
    pub next_sample: u64,
    /// Additional delay, in servo ticks, of a command written in the last cycle that was not lost.
    late: u32,
    motors: Motors,
    drives: Drives,
    sensors: Vec<(FrameId, SimulatedForceSensor)>,
    current: TorqueSensor,
    joint_torque: TorqueSensor,
}

/// Position of an arm in its simulation.
pub(crate) struct Place {
    /// Index of the arm.
    pub index: usize,
    /// Range of its joints in the plant.
    pub joints: Range<usize>,
    /// Its couplings, then its frames that hold objects.
    pub contacts: Vec<ContactSignals>,
    /// Objects that it holds: names, and indices in the plant.
    pub held: Vec<(String, usize)>,
}

impl ArmInterface {
    /// Returns an arm at rest at its start position, holding itself. `model` has the true rigid bodies.
    pub fn new(
        config: &ArmConfig,
        model: &Model,
        place: Place,
        clock: &Clock,
    ) -> Result<Self, SimulationError> {
        let timing = config.timing(clock)?;
        let Capabilities { command, has_brakes, setpoints, .. } = config.capabilities;
        let weight = holding_torque(model, &config.start);
        let mut own_gravity = config.own_gravity();
        // What the robot's own compensation leaves to its servos and brakes.
        let holding = match &mut own_gravity {
            Some(own) => &weight - own.torques(&config.start),
            None => weight.clone(),
        };
        let motor_start = match command {
            CommandKind::Torque | CommandKind::Velocity if has_brakes => DVector::zeros(model.n()),
            _ => holding.clone(),
        };
        let drivetrains = config.drivetrains(model, &motor_start, &weight, clock.physics_hz)?;
        let laws = config.true_servos(timing.servo_period_s)?;
        let q = &config.start;
        let mut motors = Motors::new(drivetrains, config.torque_limits(), q).compensating(own_gravity);
        let check = SetpointCheck::new(config);
        let has_setpoint_limits = check.is_some();
        let most_pending = timing.most_pending(config.simulated.bus.jitter_servo_ticks);
        let queue = CommandQueue::new(model.n(), most_pending);
        let drives = match command {
            CommandKind::Torque if has_brakes => {
                Drives::Torque(TorqueDrives::with_brakes(&mut motors, q, queue))
            }
            CommandKind::Torque => Drives::Torque(TorqueDrives::with_servos(&motors, laws, &holding, queue)),
            CommandKind::Position | CommandKind::Velocity => {
                let servo_ticks_per_cycle = timing.servo_ticks_per_cycle;
                let holding = holding.clone();
                let config = ServoDrivesConfig {
                    takes: command,
                    has_brakes,
                    setpoints,
                    servo_ticks_per_cycle,
                    laws,
                    holding,
                    check,
                    steps: config.setpoint_steps(),
                    queue,
                };
                Drives::Servo(ServoDrives::new(config, &mut motors, q))
            }
        };
        let objects = config.environment.iter().map(|(name, _)| ContactSignals::without_moment(name));
        let contacts = objects.chain(place.contacts);
        let silent_s: f64 = config.simulated.bus.dropouts.iter().map(|d| d.duration_s.get()).sum();
        let cycles = (silent_s / config.profile.period_s()).ceil() as usize + LOST_CYCLES;
        let mut arm = Self {
            rows: TruthRows::new(
                model,
                TruthConfig {
                    contacts: contacts.collect(),
                    held: place.held,
                    objects: config.contacts(model).into_iter().map(|(_, object)| object).collect(),
                    has_external: config.external_forces,
                    has_setpoint_limits,
                },
                cycles,
                timing.servo_ticks_per_cycle as usize,
            ),
            external: config.external_forces.then(ExternalForceHandle::default),
            index: place.index,
            joints: place.joints,
            bus: Bus::new(&config.simulated.bus, config.seed),
            next_sample: 0,
            late: 0,
            motors,
            drives,
            sensors: config.force_sensors(model, timing.servo_period_s),
            current: TorqueSensor::of_motors(config, motor_start),
            joint_torque: TorqueSensor::of_links(config, holding),
            timing,
        };
        arm.find_next_sample(0);
        Ok(arm)
    }

    /// True positions of this arm (n; rad, m).
    pub fn q<'a>(&self, plant: &'a dyn Plant) -> &'a [f64] {
        &plant.q()[self.joints.clone()]
    }

    /// True velocities of this arm (n; rad/s, m/s).
    pub fn dq<'a>(&self, plant: &'a dyn Plant) -> &'a [f64] {
        &plant.dq()[self.joints.clone()]
    }

    /// Begins an interface cycle: records the true state and applies the external force that is set. Returns true if
    /// the bus does not lose the cycle.
    pub fn begin_cycle(&mut self, plant: &mut dyn Plant) -> bool {
        let cycle = self.timing.cycles;
        self.timing.cycles += 1;
        let limited = if let Drives::Servo(drives) = &self.drives { drives.limited() } else { &[] };
        self.rows.begin_cycle(plant, self.index, &self.joints, limited);
        if let Drives::Servo(drives) = &mut self.drives {
            drives.begin_cycle();
        }
        if let Some(handle) = &self.external {
            let force = handle.of_next_cycle();
            self.rows.add_external(force.as_ref(), &plant.external_force(self.index));
            plant.push(self.index, force);
        }
        let passes = cycle == self.next_sample;
        if passes {
            self.late = self.bus.late();
            self.find_next_sample(cycle + 1);
        }
        passes
    }

    /// Finds the first cycle, from `cycle` on, that the bus does not lose.
    fn find_next_sample(&mut self, cycle: u64) {
        self.next_sample = cycle;
        while !self.bus.passes(self.timing.cycle_time_s(self.next_sample)) {
            self.next_sample += 1;
        }
    }

    /// Time of the next sample on the robot's clock, s.
    pub fn next_sample_s(&self) -> f64 {
        self.timing.cycle_time_s(self.next_sample)
    }

    /// Reads the sensors at a cycle.
    pub fn measure(&mut self, plant: &dyn Plant, sample: &mut Sample) {
        sample.time_s = self.timing.time_s(self.timing.servo_tick);
        sample.q.copy_from_slice(self.motors.positions(&plant.q()[self.joints.clone()]));
        if let Some(measured) = &mut sample.dq {
            self.motors.velocities(&plant.dq()[self.joints.clone()], measured);
        }
        self.current.read(sample.motor_torque.as_mut());
        self.joint_torque.read(sample.joint_torque.as_mut());
        if let Some(status) = &mut sample.status {
            *status = Status::new(0, self.motors.take_limited());
        }
        for (to, (_, sensor)) in sample.wrenches.iter_mut().zip(&mut self.sensors) {
            let wrench = sensor.read();
            to[..3].copy_from_slice(wrench.linear.as_slice());
            to[3..].copy_from_slice(wrench.angular.as_slice());
        }
    }

    /// Accepts a command of a robot with servos at the present cycle.
    pub fn write_setpoints(&mut self, plant: &dyn Plant, command: Command<'_>) -> Result<(), DeviceFault> {
        let acts_at = self.acts_at();
        let Drives::Servo(drives) = &mut self.drives else {
            return Err(fault::wrong_command(CommandKind::Torque));
        };
        match (command, drives.takes()) {
            (Command::Hold, _) => {
                drives.hold(&mut self.motors, &plant.q()[self.joints.clone()], acts_at);
                Ok(())
            }
            (Command::Velocity(values), CommandKind::Velocity)
            | (Command::Position(values), CommandKind::Position) => {
                check_length(values, self.joints.len())?;
                drives.command(values, acts_at)
            }
            (_, takes) => Err(fault::wrong_command(takes)),
        }
    }

    /// Accepts a command of a torque robot at the present cycle.
    pub fn write_torques(&mut self, plant: &dyn Plant, command: Command<'_>) -> Result<(), DeviceFault> {
        let acts_at = self.acts_at();
        match (command, &mut self.drives) {
            (Command::Hold, Drives::Torque(drives)) => {
                drives.hold(&mut self.motors, &plant.q()[self.joints.clone()]);
            }
            (Command::Torque(torques), Drives::Torque(drives)) => {
                check_length(torques, self.joints.len())?;
                drives.command(torques, acts_at);
            }
            _ => return Err(fault::wrong_command(CommandKind::Torque)),
        }
        Ok(())
    }

    /// Servo tick at which a command of the present cycle takes effect.
    fn acts_at(&self) -> u64 {
        self.timing.servo_tick + u64::from(self.timing.delay + self.late)
    }

    /// Enters the safe state.
    pub fn stop(&mut self, plant: &dyn Plant) {
        let q = &plant.q()[self.joints.clone()];
        self.drives.stop(&mut self.motors, q);
    }

    /// Begins a servo period.
    pub fn servo_tick(&mut self, plant: &dyn Plant) {
        self.drives.servo_tick(&mut self.motors, &plant.q()[self.joints.clone()], self.timing.servo_tick);
        self.motors.compensate_gravity();
        self.rows.begin_servo_period(self.drives.command_in_force());
        self.timing.servo_tick += 1;
    }

    /// Runs the current loops of the motors for a physics step.
    pub fn drive(&mut self) {
        self.motors.drive();
    }

    /// Begins a step of `dt_s` (s) of the drives, and writes what acts on its links into the torques of all arms.
    pub fn begin_step(&mut self, plant: &dyn Plant, dt_s: f64, torques: &mut [JointTorque]) {
        let joints = self.joints.clone();
        let (q, dq) = (&plant.q()[joints.clone()], &plant.dq()[joints.clone()]);
        self.motors.begin_step(q, dq, dt_s, &mut torques[joints]);
    }

    /// True if a joint is integrated implicitly.
    pub fn is_implicit(&self) -> bool {
        self.motors.is_implicit()
    }

    /// Revises what acts on the links for the velocities `dq` of all arms (rad/s, m/s) at the end of a step of `dt_s` (s).
    /// Returns true if something changes.
    pub fn revise_step(&mut self, dq: &[f64], dt_s: f64, torques: &mut [JointTorque]) -> bool {
        let joints = self.joints.clone();
        self.motors.revise_step(&dq[joints.clone()], dt_s, &mut torques[joints])
    }

    /// Ends a step of `dt_s` (s) of the drives, which is this share of a physics step.
    pub fn end_step(&mut self, plant: &dyn Plant, dt_s: f64, share: f64) {
        self.motors.end_step(&plant.dq()[self.joints.clone()], dt_s);
        let steps = f64::from(self.timing.steps_per_servo) / share;
        for (sum, torque) in self.rows.servo_row().iter_mut().zip(self.motors.motor_torques()) {
            *sum += torque / steps;
        }
        self.current.add(self.motors.current_torques(), steps);
        self.joint_torque.add(self.motors.joint_torques(), steps);
    }

    /// Ends a servo period.
    pub fn end_servo_period(&mut self, plant: &mut dyn Plant) {
        self.current.end_tick();
        self.joint_torque.end_tick();
        for (frame, sensor) in &mut self.sensors {
            let contacts = plant.contact_wrench(PlantFrame { arm: self.index, frame: *frame });
            let [q, dq] = [plant.q(), plant.dq()].map(|all| &all[self.joints.clone()]);
            let load = sensor.load(q, dq);
            sensor.follow(&(contacts + load));
        }
    }
}

/// Returns the joint torques that hold an arm at rest (n; Nm, N).
fn holding_torque(model: &Model, q: &[f64]) -> DVector<f64> {
    let mut data = Data::new(model);
    kinematics(model, &mut data, q, &vec![0.0; model.n()]);
    gravity(model, &mut data);
    data.gravity
}

fn check_length(values: &[f64], joints: usize) -> Result<(), DeviceFault> {
    if values.len() == joints { Ok(()) } else { Err(fault::wrong_length()) }
}
