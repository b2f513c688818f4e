//! `opspace driver`: the drivers of the program, and the devices that they find.

use crate::cli::{DriverCommand, DriverScanArgs};
use crate::console::{Console, Exit, Failure, Outcome, print_exactly};
use opspace_experiment::Extensions;

pub fn driver(command: &DriverCommand, extensions: &Extensions, console: Console) -> Outcome {
    match command {
        DriverCommand::List => list(extensions),
        DriverCommand::Scan(args) => scan(args, extensions, console),
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
        return Err(Failure::Other("no device has answered: is its power on?".to_owned(), Exit::Bad));
    }
    Ok(Exit::Done)
}
