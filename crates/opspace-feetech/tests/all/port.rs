//! The serial port on a pseudo-terminal, in real time.

use crate::common::{CALIBRATION, bus, config, file, settings};
use opspace_backend::{Backend, Command, Driver, DriverError, Sample, Setting};
use opspace_feetech::bus::Bus;
use opspace_feetech::protocol::{ErrorFlags, Register};
use opspace_feetech::serial_port::SerialPort;
use opspace_feetech::simulated::PseudoTerminal;
use opspace_feetech::{FeetechArm, FeetechDriver};
use std::path::Path;
use std::time::Duration;

fn open(terminal: &PseudoTerminal) -> SerialPort {
    SerialPort::open(terminal.path(), 1_000_000).expect("a port")
}

/// Repeats a start that fails: on a busy machine the simulated servos may be silent for longer than a start permits, or as
/// slow as a bus that it refuses.
fn patiently<T>(mut start: impl FnMut() -> Result<T, DriverError>) -> T {
    for _ in 0..10 {
        if let Ok(started) = start() {
            return started;
        }
    }
    start().expect("one of eleven starts")
}

/// Twenty cycles at 100 Hz by the driver, as a program of opspace calls it. A busy machine may miss some.
#[test]
fn driver_runs_an_arm_behind_a_port() {
    let folder = tempfile::tempdir().expect("a folder");
    let link = folder.path().join("arm");
    let terminal = PseudoTerminal::open(bus()).expect("a pseudo-terminal").with_link(&link).expect("a link");
    let calibration = file(CALIBRATION);
    let settings = settings(&calibration)
        .with("port", Setting::Text(link.to_str().expect("a path").into()))
        .with("silence_s", Setting::Number(2.0));
    let mut samples = 0;
    let mut run = |arm: &mut dyn Backend| {
        let mut sample = Sample::new(arm.capabilities());
        for _ in 0..20 {
            arm.read(&mut sample).expect("a sample");
            arm.write(Command::Position(&[0.0; 3])).expect("a command");
            samples += 1;
        }
        arm.stop();
    };
    patiently(|| FeetechDriver.with(&settings, &mut run));
    assert_eq!(samples, 20);
    assert_eq!(terminal.bus().servo(3).expect("a servo").get(Register::GOAL_POSITION), 2050);
    drop(terminal);
    assert!(!link.is_symlink());
}

#[test]
fn faults_are_named_behind_a_port() {
    let start = || {
        let terminal = PseudoTerminal::open(bus()).expect("a pseudo-terminal");
        let config = || config(|settings| settings.with("silence_s", Setting::Number(0.6)));
        let arm = patiently(|| FeetechArm::start(open(&terminal), config()));
        (terminal, arm)
    };
    type Inject = fn(&PseudoTerminal);
    let cases: [(u32, Inject); 4] = [
        (10, |terminal| terminal.bus().options.gone = true),
        (11, |terminal| terminal.bus().options.silent = true),
        (12, |terminal| terminal.bus().options.silent_ids = vec![2]),
        (24, |terminal| terminal.bus().servo_mut(2).expect("a servo").flags = ErrorFlags::OVERLOAD),
    ];
    for (code, inject) in cases {
        let (terminal, mut arm) = start();
        let mut sample = Sample::new(arm.capabilities());
        arm.read(&mut sample).expect("a sample");
        inject(&terminal);
        let fault = (0..100).find_map(|_| arm.read(&mut sample).err()).expect("a fault");
        assert_eq!(fault.code, code, "{fault}");
        // Behind a pseudo-terminal there is another cause of silence than the cable.
        let is_silence = [11, 12].contains(&code);
        assert_eq!(
            fault.words.contains("a simulated bus is silent too while the computer is busy"),
            is_silence,
            "{fault}"
        );
        arm.stop();
    }
}

/// A request that comes while the simulation is kept from running is late by its fault, and counted; others are not.
#[test]
fn simulated_bus_counts_requests_that_it_answers_late() {
    let terminal = PseudoTerminal::open(bus()).expect("a pseudo-terminal");
    let mut bus = Bus::new(open(&terminal));
    let held = terminal.bus();
    let before = terminal.late_requests();
    let ping = std::thread::scope(|scope| {
        let asking = scope.spawn(|| bus.ping(3));
        std::thread::sleep(Duration::from_millis(30));
        drop(held);
        asking.join().expect("no panic")
    });
    ping.expect("an answer");
    assert!(terminal.late_requests() > before);
}

#[test]
fn ports_that_cannot_be_opened_are_named() {
    let calibration = file(CALIBRATION);
    let open = |port: &str| {
        let settings = settings(&calibration).with("port", Setting::Text(port.into()));
        FeetechDriver.with(&settings, &mut |_| {}).expect_err("refused")
    };
    let error = open("/dev/no-such-port");
    assert_eq!(error.key.as_deref(), Some("port"));
    assert!(error.words.contains("/dev/ttyACM0"), "{error}");
    assert!(open("/dev/null").words.contains("it is no serial port"), "{}", open("/dev/null"));
    let wrong =
        settings(&calibration).with("port", Setting::Text("x".into())).with("baud_hz", Setting::Number(1.5));
    let error = FeetechDriver.with(&wrong, &mut |_| {}).expect_err("refused");
    assert_eq!(error.key.as_deref(), Some("baud_hz"));
}

#[test]
fn a_link_in_use_is_not_replaced() {
    let taken = file("");
    let terminal = PseudoTerminal::open(bus()).expect("a pseudo-terminal");
    assert!(terminal.with_link(taken.path()).is_err());
    assert!(Path::new(taken.path()).exists());
}

/// A second program is kept out until the first one ends, with the process of the first one; also by the driver and its search.
#[test]
fn port_is_used_by_one_program_at_a_time() {
    let terminal = PseudoTerminal::open(bus()).expect("a pseudo-terminal");
    let first = open(&terminal);
    let second = SerialPort::open(terminal.path(), 1_000_000);
    let busy = second.expect_err("a port in use").to_string();
    // A user who is not the superuser cannot open the port, and learns no process.
    let expected = format!("the port is used by another program, process {}", std::process::id());
    assert!(busy == expected || busy == "the port is used by another program", "{busy}");
    let path = terminal.path().to_str().expect("a path");
    let calibration = file(CALIBRATION);
    let settings = settings(&calibration).with("port", Setting::Text(path.into()));
    let error = FeetechDriver.with(&settings, &mut |_| panic!("opened")).expect_err("a port in use");
    assert_eq!(error.key.as_deref(), Some("port"));
    assert!(error.words.contains("is used by another program"), "{error}");
    assert!(FeetechDriver.scan(Some(path)).expect_err("a port in use").words.contains("another program"));
    drop(first);
    SerialPort::open(terminal.path(), 1_000_000).expect("a free port");
}
