//! Pace of a bus: an arm is held for a duration, and late and missed cycles are counted.
//!
//! `cargo run --release -p opspace-feetech --example pace -- PORT CALIBRATION.json SECONDS HZ MOTOR[,MOTOR...]` reads and
//! commands the arm behind a port. Its gains are LeRobot's: P = 16, I = 0, D = 32.

#![expect(clippy::print_stdout, reason = "an example shows what it did")]

#[cfg(target_os = "linux")]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    linux::main()
}

#[cfg(not(target_os = "linux"))]
fn main() {
    println!("serial ports are supported on Linux only so far");
}

#[cfg(target_os = "linux")]
mod linux {
    use opspace_backend::{Backend, Command, CommandKind, Sample, Setting, Settings};
    use opspace_feetech::serial_port::SerialPort;
    use opspace_feetech::{ArmConfig, FeetechArm};
    use std::error::Error;

    pub fn main() -> Result<(), Box<dyn Error>> {
        let arguments: Vec<String> = std::env::args().skip(1).collect();
        let [port, calibration, seconds, hz, motors] = arguments.as_slice() else {
            return Err("usage: pace PORT CALIBRATION.json SECONDS HZ MOTOR[,MOTOR...]".into());
        };
        let (seconds, hz): (f64, f64) = (seconds.parse()?, hz.parse()?);
        let joints = motors.split(',').map(str::to_owned).collect();
        let settings = Settings::new(CommandKind::Position, joints, 1.0 / hz)
            .with("calibration", Setting::Text(calibration.clone()))
            .with("p", Setting::Number(16.0))
            .with("i", Setting::Number(0.0))
            .with("d", Setting::Number(32.0));
        let config = ArmConfig::from_settings(&settings)?;
        let mut arm = FeetechArm::start(SerialPort::open(port.as_ref(), 1_000_000)?, config)?;
        println!(
            "a request to all servos and its answers take {:.3} ms (median)",
            arm.round().as_secs_f64() * 1e3
        );

        let mut sample = Sample::new(arm.capabilities());
        arm.read(&mut sample)?;
        let (first, q) = (sample.time_s, sample.q.clone());
        let (mut before, mut longest) = (first, 0.0_f64);
        while sample.time_s - first < seconds {
            arm.write(Command::Position(&q))?;
            arm.read(&mut sample)?;
            longest = longest.max(sample.time_s - before);
            before = sample.time_s;
        }
        arm.stop();
        let counts = arm.counts();
        println!(
            "{} cycles at {hz} Hz: {} missed, {} late; longest gap {:.1} ms",
            counts.cycles,
            counts.missed,
            counts.late,
            longest * 1e3
        );
        println!("q at the end, rad: {:.4?}", sample.q);
        Ok(())
    }
}
