//! Random numbers: every source has its own stream, so that adding a source leaves the others unchanged.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Source of random numbers.
#[derive(Clone, Copy, Debug)]
pub enum RngStream {
    /// Noise of the motor-torque measurement.
    MotorTorque,
    /// Noise of the joints' torque sensors.
    JointTorque,
    /// Losses and delays of the bus.
    Bus,
    /// Force sensor, by its index.
    ForceSensor(u32),
    /// Environment object, by its index in the order of names.
    EnvironmentObject(u32),
}

/// Returns the random generator of one stream of a run with this seed.
#[must_use]
pub fn generator(seed: u64, stream: RngStream) -> ChaCha8Rng {
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    generator.set_stream(match stream {
        RngStream::MotorTorque => 1,
        RngStream::Bus => 2,
        RngStream::JointTorque => 3,
        RngStream::ForceSensor(i) => (1 << 32) | u64::from(i),
        RngStream::EnvironmentObject(i) => (2 << 32) | u64::from(i),
    });
    generator
}
