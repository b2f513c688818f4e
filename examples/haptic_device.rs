//! A haptic device leads a robot, and its hand feels what the robot touches. The device has a thread and a clock of its own. It
//! writes its motion to the inputs of the robot's coupled task, and gets the force of the robot's sensor back. Both sides send
//! the energy that has entered the coupling, and limit what leaves it.
//!
//! `cargo run --release -p opspace --example haptic_device` runs for 6 s of real time, writes to `runs/haptic_device`, and
//! replays it: what the device sent is in the log. The device is simulated here, with the hand that moves it.

#![expect(clippy::print_stdout, reason = "an example shows what it did")]

#[path = "common/mod.rs"]
mod common;

use nalgebra::Vector6;
use opspace::backend::{Backend, Layout, Sample, TICK, signal_names};
use opspace::control::TargetError;
use opspace::control_loop::{Run, TargetSender, target_stream};
use opspace::coupling::{PortPassivity, PortPassivityParameters};
use opspace::experiment::{Experiment, Files, Progress};
use opspace::sim::SimulatedArm;
use std::ops::Range;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Coupled task of the robot.
const TASK: &str = "hand";
/// Period of the device, s, and its moving mass, kg.
const PERIOD_S: f64 = 1e-3;
const MASS_KG: f64 = 0.5;
/// Spring and damper of the hand that holds the device, N/m and Ns/m.
const HAND: [f64; 2] = [500.0, 10.0];
/// Damping of the device in contact, Ns/m: the force comes a few milliseconds late.
const CONTACT_NS_PER_M: f64 = 20.0;
const CONTACT_N: f64 = 2.0;

/// Values that the device gets from the robot in each of its cycles.
#[derive(Clone, Copy, Default)]
struct FromRobot {
    time_s: f64,
    session: f64,
    is_closed: bool,
    energy_in_j: f64,
    /// Force of the robot's sensor, N, along x, y and z.
    force: [f64; 3],
}

/// Columns of [`FromRobot`] in a row of the robot.
struct Columns([Range<usize>; 5]);

impl Columns {
    fn new(row: &Layout) -> Option<Self> {
        use signal_names::{PORT_CLOSED, PORT_ENERGY_IN, PORT_FORCE, PORT_SESSION, PORT_TIME};
        let column = |quantity| row.columns(&signal_names::of(TASK, quantity));
        let quantities = [PORT_TIME, PORT_SESSION, PORT_CLOSED, PORT_ENERGY_IN, PORT_FORCE];
        let [time, session, closed, energy, force] = quantities.map(column);
        Some(Self([time?, session?, closed?, energy?, force?]))
    }

    fn read(&self, row: &[f64]) -> FromRobot {
        let [time, session, closed, energy, force] = self.0.clone().map(|range| &row[range]);
        FromRobot {
            time_s: time[0],
            session: session[0],
            is_closed: closed[0] == 1.0,
            energy_in_j: energy[0],
            force: [force[0], force[1], force[2]],
        }
    }
}

/// Device with three axes, and the hand that moves it.
struct Device {
    position: Vector6<f64>,
    velocity: Vector6<f64>,
    /// Force of the motors, N.
    force: Vector6<f64>,
    port: PortPassivity,
}

impl Device {
    /// Moves the device for a period: the hand goes down by 90 mm within 3 s, and back.
    fn advance(&mut self, time_s: f64) {
        let hand = Vector6::z() * (-0.045 * (1.0 - (time_s * std::f64::consts::PI / 3.0).cos()));
        let pull = (hand - self.position) * HAND[0] - self.velocity * HAND[1];
        self.velocity += (pull + self.force) * (PERIOD_S / MASS_KG);
        self.position += self.velocity * PERIOD_S;
    }

    /// Computes the force of the motors: that of the robot's sensor, as far as the energies allow.
    fn feel(&mut self, robot: &FromRobot, moved: &Vector6<f64>) {
        self.port.receive(robot.energy_in_j);
        self.port.observe(&self.force, moved);
        let [x, y, z] = if robot.is_closed { robot.force } else { [0.0; 3] };
        let sensed = Vector6::new(x, y, z, 0.0, 0.0, 0.0);
        let contact = (sensed.norm() / CONTACT_N).min(1.0);
        let wanted = sensed - self.velocity * (contact * CONTACT_NS_PER_M);
        self.force = self.port.limit_force(&self.velocity, &wanted);
    }
}

/// Thread of the device, until the run of the robot is over. Prints what the hand felt.
fn lead(mut sender: TargetSender, robot: &Receiver<FromRobot>) -> Result<(), TargetError> {
    let targets = sender.targets().clone();
    let task = targets.task(TASK)?;
    let input = |name| targets.input(&task, name);
    let names =
        ["sequence", "time_sent", "echo", "closed", "limited", "energy_in", "session", "partner_session"];
    let scalars = names.map(input);
    // Wave variables also need the input `wave`.
    let vectors = ["position", "velocity", "force"].map(input);
    // The robot distinguishes the starts of this program by it.
    let session = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |time| time.as_secs_f64());
    let mut device = Device {
        position: Vector6::zeros(),
        velocity: Vector6::zeros(),
        force: Vector6::zeros(),
        port: PortPassivity::new(&PortPassivityParameters::default(), &[false; 6], PERIOD_S),
    };
    let (mut newest, mut largest_n, mut deepest_m) = (FromRobot::default(), 0.0, 0.0);
    let begun = Instant::now();
    for cycle in 1_u32.. {
        thread::sleep(Duration::from_secs_f64(PERIOD_S * f64::from(cycle)).saturating_sub(begun.elapsed()));
        if sender.is_closed() {
            break;
        }
        newest = robot.try_iter().last().unwrap_or(newest);
        let (time_s, before) = (PERIOD_S * f64::from(cycle), device.position);
        device.advance(time_s);
        let moved = device.position - before;
        device.feel(&newest, &moved);
        largest_n = device.force[2].max(largest_n);
        deepest_m = device.position[2].min(deepest_m);
        let energy_j = device.port.energy_in_j();
        let numbers = [f64::from(cycle), time_s, newest.time_s, 1.0, 0.0, energy_j, session, newest.session];
        let rows = [device.position, device.velocity, device.force].map(|v| [v[0], v[1], v[2]]);
        let mut packet = Vec::new();
        for (handle, number) in scalars.iter().zip(&numbers) {
            packet.push((handle.as_ref().map_err(Clone::clone)?, std::slice::from_ref(number)));
        }
        for (handle, row) in vectors.iter().zip(&rows) {
            packet.push((handle.as_ref().map_err(Clone::clone)?, &row[..]));
        }
        // If the ring is full, this packet is lost; the next one contains all that it contained.
        let _ = sender.send(&task, &packet)?;
    }
    println!("the hand was {:.0} mm down and felt {largest_n:.1} N", -1e3 * deepest_m);
    Ok(())
}

/// Drives the robot in real time, and sends a part of each row to the device.
fn follow(arm: &mut SimulatedArm, run: &mut Run<'_>, columns: &Columns, device: &SyncSender<FromRobot>) {
    let mut sample = Sample::new(arm.capabilities());
    let period = Duration::from_secs_f64(arm.capabilities().period_s);
    let mut next = Instant::now();
    while !run.is_over() {
        next += period;
        thread::sleep(next.saturating_duration_since(Instant::now()));
        let command = match arm.read(&mut sample) {
            Ok(()) => run.cycle(&sample),
            Err(fault) => run.fail(fault),
        };
        if let Some(Err(fault)) = command.map(|command| arm.write(command)) {
            run.refuse(fault);
        }
        // A device that does not read loses packets.
        let _ = device.try_send(columns.read(run.row()));
        run.between_cycles();
    }
    arm.stop();
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let task = "examples/tasks/haptic_device.toml".as_ref();
    let experiment = Experiment::load(Files::Disk, task, None, Default::default(), &[])?;
    let mut arm = experiment.simulated_arm()?;
    let capabilities = arm.capabilities().clone();
    let mut device = None;
    common::record("haptic_device", &experiment, |log| {
        experiment.run_with(&capabilities, None, log, &Progress::default(), |run| {
            let (sender, receiver) = target_stream(run.targets());
            run.set_target_stream(receiver);
            let (to_device, from_robot) = sync_channel(16);
            device = Some(thread::spawn(move || lead(sender, &from_robot)));
            let row = Run::layouts(run.control(), None).swap_remove(TICK);
            let columns = Columns::new(&row).expect("the task is a follower");
            follow(&mut arm, run, &columns, &to_device);
        })
    })?;
    if let Some(device) = device {
        device.join().map_err(|_| "the device has panicked")??;
    }
    Ok(())
}
