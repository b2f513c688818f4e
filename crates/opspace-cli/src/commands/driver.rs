//! `opspace driver`: the drivers of the program, the devices that they find, and simulated ones.

use crate::cli::{DriverCommand, DriverScanArgs, DriverSimulateArgs};
use crate::commands::driver_read::read;
use crate::console::{Console, Exit, Failure, Outcome, print_exactly};
use crate::interrupt;
use opspace_backend::{ServedDevices, Setting};
use opspace_experiment::{Extensions, Files, RunOptions, Scenario};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

pub fn driver(command: &DriverCommand, extensions: &Extensions, console: Console) -> Outcome {
    match command {
        DriverCommand::List => list(extensions),
        DriverCommand::Scan(args) => scan(args, extensions, console),
        DriverCommand::Read(args) => read(args, extensions, console),
        DriverCommand::Simulate(args) => simulate(args, extensions, console),
    }
}

/// Prints the names of the drivers, as `[driver]` of robot.toml has them.
fn list(extensions: &Extensions) -> Outcome {
    let names: String = extensions.drivers().map(|driver| format!("{}\n", driver.name())).collect();
    if names.is_empty() {
        let text =
            "this program has no driver: build it with the feature `drivers`, or with a driver of your own";
        return Err(Failure::Other(text.to_owned(), Exit::Bad));
    }
    print_exactly(&names)?;
    Ok(Exit::Done)
}

/// Prints the devices that drivers find.
fn scan(args: &DriverScanArgs, extensions: &Extensions, console: Console) -> Outcome {
    let is_asked = |name: &str| args.driver.as_deref().is_none_or(|asked| asked == name);
    let drivers: Vec<_> = extensions.drivers().filter(|driver| is_asked(driver.name())).collect();
    if drivers.is_empty() {
        let known: Vec<&str> = extensions.drivers().map(|driver| driver.name()).collect();
        let asked = args.driver.as_deref().map_or_else(String::new, |asked| format!(" '{asked}'"));
        let text = format!("this program has no driver{asked}; it has: {}", known.join(", "));
        return Err(Failure::Other(text, Exit::Bad));
    }
    let mut count = 0;
    for driver in drivers {
        console.note(&format!("{}: searching", driver.name()));
        let place = args.port.as_deref();
        let found = driver
            .scan(place)
            .map_err(|error| Failure::Other(format!("{}: {error}", driver.name()), Exit::Bad))?;
        for device in found {
            count += 1;
            print_exactly(&format!("{}: {}; {}\n", driver.name(), device.place, device.description))?;
        }
    }
    if count == 0 {
        return Err(Failure::Other(
            "nothing has answered: is the robot's power on, and its driver or cable where the options say?"
                .to_owned(),
            Exit::Bad,
        ));
    }
    Ok(Exit::Done)
}

/// Serves simulated devices until a signal, or for the duration that is asked for.
fn simulate(args: &DriverSimulateArgs, extensions: &Extensions, console: Console) -> Outcome {
    let options = RunOptions { seed: args.seed, ..RunOptions::default() };
    let robot = args.robot.as_deref();
    let scenario = Scenario::load(extensions, Files::Disk, &args.task, robot, None, options, &args.set)?;
    let scenario = match args.plant.open(extensions)? {
        None => scenario,
        Some(engine) => scenario.on_engine(&engine)?,
    };
    let Some(experiment) = scenario.single() else {
        let text = "simulated devices are those of one robot: name the task of the robot".to_owned();
        return Err(Failure::Other(text, Exit::Bad));
    };
    let watch = interrupt::watch();
    let with_options = |settings| {
        args.option.iter().fold(settings, |settings: opspace_backend::Settings, (key, value)| {
            settings.with(key, Setting::Number(*value))
        })
    };
    let end = args.duration_s.map(|duration_s| Instant::now() + Duration::from_secs_f64(duration_s));
    let mut printed = Ok(());
    let mut serve = |devices: &ServedDevices| {
        printed = print_exactly(&format!("{}\n", devices.place));
        for (path, meaning) in &devices.written {
            console.note(&format!("wrote {}: {meaning}", path.display()));
        }
        console.note("the simulated arm is held until the first goal; Ctrl-C ends the simulation");
        while !watch.interrupt.load(Ordering::Relaxed) && end.is_none_or(|end| Instant::now() < end) {
            std::thread::sleep(Duration::from_millis(20));
        }
    };
    let ended = experiment.serve_devices(extensions, args.link.clone(), with_options, &mut serve)?;
    printed?;
    console.note(&ended);
    Ok(Exit::Done)
}
