//! Faults, injected one by one while the arm is read: each has its code and text, and comes in time.

use crate::common::{IDS, arm};
use opspace_backend::{Backend, Command, DeviceFault, Sample};
use opspace_feetech::BusFault;
use opspace_feetech::protocol::{ErrorFlags, Register};
use opspace_feetech::simulated::{SimulatedBus, SimulatedTransport};
use opspace_feetech::transport::Transport;
use std::time::Duration;

/// Reads ten samples, injects a defect, and returns the fault, and the time (s) from the last sample until it came.
fn fault(inject: impl FnOnce(&mut SimulatedBus)) -> (DeviceFault, f64) {
    let mut arm = arm(|_| {});
    let mut sample = Sample::new(arm.capabilities());
    let target = [0.1, -0.2, 0.1];
    for _ in 0..10 {
        arm.read(&mut sample).expect("a sample");
        arm.write(Command::Position(&target)).expect("a command");
    }
    let goals = arm.goals().to_vec();
    inject(&mut arm.transport_mut().bus);
    let fault = (0..1000)
        .find_map(|_| {
            let read = arm.read(&mut sample);
            read.and_then(|()| arm.write(Command::Position(&target))).err()
        })
        .expect("a fault");
    let time = opspace_feetech::transport::Transport::now(arm.transport_mut()).as_secs_f64();
    let last = sample.time_s;
    arm.stop();
    // Torque stays on at the last setpoint.
    for (id, goal) in IDS.into_iter().zip(goals) {
        let servo = arm.transport_mut().bus.servo(id).expect("a servo");
        assert!(servo.is_torque_on());
        assert_eq!(servo.get(Register::GOAL_POSITION), goal);
    }
    (fault, time - last)
}

/// Silence of 0.2 s is a fault within two cycles.
#[track_caller]
fn ends_in_silence(expected: BusFault, text: &str, (fault, after_s): (DeviceFault, f64)) {
    assert_eq!((fault.code, fault.words.as_ref()), (expected.code(), text));
    assert!((0.2..=0.22).contains(&after_s), "{after_s}");
}

/// A fault that a servo reports comes with the next sample.
#[track_caller]
fn check_report(expected: BusFault, text: &str, (fault, after_s): (DeviceFault, f64)) {
    assert_eq!((fault.code, fault.words.as_ref()), (expected.code(), text));
    assert!(after_s < 0.02, "{after_s}");
}

#[test]
fn silence_is_named() {
    let text = "no servo answers: check the power supply and the cable of the bus";
    ends_in_silence(BusFault::Silent, text, fault(|bus| bus.options.silent = true));
}

#[test]
fn missing_servo_is_named() {
    let text = "servo 3 (elbow_flex) does not answer, others do: check its cable and id";
    ends_in_silence(BusFault::ServoMissing, text, fault(|bus| bus.options.silent_ids = vec![3]));
}

#[test]
fn wrong_answers_are_named() {
    let text = "servo 4 (wrist_flex) sends other answers than are asked for; two may have the same id";
    ends_in_silence(BusFault::WrongAnswer, text, fault(|bus| bus.options.shortened = Some(4)));
    let text = "a servo sends other answers than are asked for; two may have the same id";
    ends_in_silence(BusFault::WrongAnswer, text, fault(|bus| bus.options.renamed = Some((3, 9))));
}

#[test]
fn wrong_checksums_are_named() {
    let text = "servo 2 (shoulder_lift) sends answers with wrong checksums: check its cable";
    ends_in_silence(BusFault::Checksum, text, fault(|bus| bus.options.wrong_checksum = Some(2)));
}

/// Answers that come a period late have the length of an earlier request, and are not taken for new ones.
#[test]
fn slow_bus_is_named() {
    for ms in [8, 12, 17] {
        let text = "answers arrive later than the rate allows";
        let slow = |bus: &mut SimulatedBus| bus.options.latency = Duration::from_millis(ms);
        ends_in_silence(BusFault::TooSlow, text, fault(slow));
    }
}

#[test]
fn lost_port_is_named_at_once() {
    let text = "the serial port is gone: its cable was pulled, or its adapter has failed";
    check_report(BusFault::PortGone, text, fault(|bus| bus.options.gone = true));
}

#[test]
fn error_flags_are_named() {
    for (flag, expected, what) in [
        (ErrorFlags::OVERLOAD, BusFault::Overload, "reports overload, and has reduced its torque"),
        (ErrorFlags::OVERHEAT, BusFault::Overheat, "reports overheat"),
        (ErrorFlags::OVERCURRENT, BusFault::Overcurrent, "reports overcurrent"),
        (ErrorFlags::SENSOR, BusFault::Sensor, "reports a disturbed position sensor"),
        (ErrorFlags::VOLTAGE, BusFault::Voltage, "reports a supply voltage outside its limits"),
    ] {
        let text = format!("servo 3 (elbow_flex) {what}");
        let set = |bus: &mut SimulatedBus| bus.servo_mut(3).expect("a servo").flags = flag;
        check_report(expected, &text, fault(set));
    }
}

#[test]
fn supply_and_heat_set_the_flags_of_the_simulated_servo() {
    let text = "servo 4 (wrist_flex) reports a supply voltage outside its limits";
    check_report(
        BusFault::Voltage,
        text,
        fault(|bus| bus.servo_mut(4).expect("a servo").options.voltage_v = 3.5),
    );
    let text = "servo 4 (wrist_flex) reports overheat";
    check_report(
        BusFault::Overheat,
        text,
        fault(|bus| bus.servo_mut(4).expect("a servo").options.temperature_c = 71.0),
    );
}

/// A lost answer is a missed cycle: a gap in the times, and no fault. Each sample that comes is one of its own time.
#[test]
fn lost_and_damaged_answers_are_missed_cycles() {
    let mut arm = arm(|_| {});
    let mut sample = Sample::new(arm.capabilities());
    arm.read(&mut sample).expect("a sample");
    arm.transport_mut().bus.options.lost_share = 0.05;
    arm.transport_mut().bus.options.damaged_share = 0.05;
    let (mut before, mut gaps) = (sample.time_s, 0);
    for _ in 0..1000 {
        arm.read(&mut sample).expect("a sample");
        arm.write(Command::Hold).expect("held");
        let cycles = (sample.time_s - before) / 0.01;
        assert!(cycles > 0.5 && (cycles - cycles.round()).abs() < 1e-6, "{cycles}");
        gaps += cycles.round() as u64 - 1;
        before = sample.time_s;
        let q = arm.transport_mut().bus.joints().q()[0];
        assert!((sample.q[0] - q).abs() < 0.05);
    }
    let counts = arm.counts();
    assert_eq!(counts.missed, gaps);
    // By hand: 1 − 0.95⁶ = 0.26 of the cycles.
    assert!((200..500).contains(&gaps), "{gaps}");
}

#[test]
fn codes_and_names_differ() {
    for (index, fault) in BusFault::ALL.into_iter().enumerate() {
        for other in &BusFault::ALL[..index] {
            assert_ne!(fault.code(), other.code());
            assert_ne!(fault.name(), other.name());
            assert_ne!(fault.text(), other.text());
        }
    }
}

/// A transport on which bytes of a generator follow one another without end, once it is disturbed.
struct Disturbed {
    bus: SimulatedTransport,
    /// State of the generator; `None` as long as the bus is not disturbed.
    noise: Option<u64>,
    /// Byte that is sent instead of random ones.
    only: Option<u8>,
}

impl Transport for Disturbed {
    fn now(&self) -> Duration {
        self.bus.now()
    }

    fn wait_until(&mut self, time: Duration) {
        self.bus.wait_until(time);
    }

    fn send(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.bus.send(bytes)
    }

    fn receive(&mut self, buffer: &mut [u8], deadline: Duration) -> std::io::Result<usize> {
        let Some(noise) = &mut self.noise else { return self.bus.receive(buffer, deadline) };
        for byte in buffer.iter_mut() {
            *noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            *byte = self.only.unwrap_or((*noise >> 56) as u8);
        }
        // 256 bytes take 2.56 ms.
        self.bus.wait_until(self.bus.now() + Duration::from_micros(2560));
        Ok(buffer.len())
    }
}

/// Bytes without end, of whatever kind, are a fault in time, not a program that hangs.
#[test]
fn endless_noise_is_a_fault() {
    for only in [None, Some(0xFF), Some(0x00), Some(0x02)] {
        let bus = SimulatedTransport::new(crate::common::bus());
        let transport = Disturbed { bus, noise: None, only };
        let config = crate::common::config(|settings| settings);
        let mut arm = opspace_feetech::FeetechArm::start(transport, config).expect("an arm");
        let mut sample = Sample::new(arm.capabilities());
        arm.read(&mut sample).expect("a sample");
        let before = sample.time_s;
        arm.transport_mut().noise = Some(7);
        let fault = arm.read(&mut sample).expect_err("a fault");
        assert_eq!(fault.code, BusFault::Checksum.code(), "{only:?}: {fault}");
        let after_s = arm.transport_mut().now().as_secs_f64() - before;
        assert!(after_s < 0.3, "{after_s}");
    }
}
