//! A simulated bus of six servos with the identifiers 1 to 6 behind a pseudo-terminal, for other programs.
//!
//! `cargo run -p opspace-feetech --example simulated-bus -- --link /tmp/arm` prints the path of the port, and runs until its
//! input ends or `--seconds` have passed. `--registers` prints the table of registers.

#![expect(clippy::print_stdout, reason = "an example shows what it did")]

#[cfg(target_os = "linux")]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    linux::main()
}

#[cfg(not(target_os = "linux"))]
fn main() {
    println!("there are pseudo-terminals on Linux only so far");
}

#[cfg(target_os = "linux")]
mod linux {
    use opspace_feetech::protocol::{REGISTERS, Register};
    use opspace_feetech::simulated::{
        BusOptions, PseudoTerminal, SeparateJoint, SeparateJoints, ServoOptions, SimulatedBus, SimulatedServo,
    };
    use std::error::Error;
    use std::io::Read;
    use std::path::PathBuf;
    use std::time::Duration;

    pub fn main() -> Result<(), Box<dyn Error>> {
        let (mut options, mut link, mut seconds) = (BusOptions::default(), None, None);
        let mut arguments = std::env::args().skip(1);
        while let Some(argument) = arguments.next() {
            let mut value = || arguments.next().ok_or_else(|| format!("{argument} needs a value"));
            match argument.as_str() {
                "--registers" => return print_registers(),
                "--link" => link = Some(PathBuf::from(value()?)),
                "--seconds" => seconds = Some(Duration::from_secs_f64(value()?.parse()?)),
                "--latency-ms" => options.latency = Duration::from_secs_f64(value()?.parse::<f64>()? / 1e3),
                "--lost" => options.lost_share = value()?.parse()?,
                "--damaged" => options.damaged_share = value()?.parse()?,
                _ => {
                    let known = "--registers, --link PATH, --seconds S, --latency-ms MS, --lost SHARE, --damaged SHARE";
                    return Err(format!("unknown option '{argument}'; the options are: {known}").into());
                }
            }
        }
        let mut terminal = PseudoTerminal::open(bus(options))?;
        if let Some(link) = &link {
            terminal = terminal.with_link(link)?;
        }
        println!("{}", link.as_deref().unwrap_or(terminal.path()).display());
        match seconds {
            Some(seconds) => std::thread::sleep(seconds),
            None => {
                std::io::stdin().read_to_end(&mut Vec::new())?;
            }
        }
        println!("longest pause of the simulation: {:.1} ms", terminal.longest_pause().as_secs_f64() * 1e3);
        Ok(())
    }

    /// Servos of a small arm: its second and third joint carry weight.
    fn bus(options: BusOptions) -> SimulatedBus {
        let joint = |weight_nm| SeparateJoint { weight_nm, ..SeparateJoint::default() };
        let weights = [0.0, -0.6, 0.4, 0.1, 0.0, 0.0];
        let joints = SeparateJoints::new(weights.map(joint).to_vec(), &[0.2, 0.3, -0.4, 0.2, 0.0, 0.5]);
        let servo = |id: u8| {
            let sensor_zero = 1500.0 + 200.0 * f64::from(id);
            let mut servo = SimulatedServo::new(id, ServoOptions { sensor_zero, ..ServoOptions::default() });
            servo.set(Register::RETURN_DELAY_TIME, 0);
            servo
        };
        SimulatedBus::new((1..=6).map(servo).collect(), Box::new(joints), options)
    }

    fn print_registers() -> Result<(), Box<dyn Error>> {
        for register in REGISTERS {
            let sign = register.sign_bit.map_or_else(String::new, |bit| bit.to_string());
            println!("{}\t{}\t{}\t{sign}", register.name, register.address, register.width);
        }
        Ok(())
    }
}
