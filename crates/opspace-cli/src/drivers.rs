//! Drivers of the program itself.

use opspace_backend::Driver;
use opspace_experiment::Extensions;
use opspace_feetech::FeetechDriver;

/// Adds the drivers of the program. A driver of the same name that a user's program has added stays in its place.
pub fn with_drivers(extensions: Extensions) -> Extensions {
    let is_taken = extensions.drivers().any(|driver| driver.name() == FeetechDriver.name());
    if is_taken { extensions } else { extensions.with_driver(FeetechDriver) }
}
