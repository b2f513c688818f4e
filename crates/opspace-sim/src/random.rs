//! Random numbers: every source has a stream of its own, so that adding one leaves the others as they were.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// What a stream is for.
#[derive(Clone, Copy, Debug)]
pub enum Stream {
    /// Noise of the motor-torque measurement.
    MotorTorque,
    /// What the bus loses and delays.
    Bus,
    /// A force sensor, by its index.
    ForceSensor(u32),
    /// A surrounding, by its index in the order of names.
    Surrounding(u32),
}

/// The generator of one stream of a run's seed.
#[must_use]
pub fn generator(seed: u64, stream: Stream) -> ChaCha8Rng {
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    generator.set_stream(match stream {
        Stream::MotorTorque => 1,
        Stream::Bus => 2,
        Stream::ForceSensor(i) => (1 << 32) | u64::from(i),
        Stream::Surrounding(i) => (2 << 32) | u64::from(i),
    });
    generator
}
