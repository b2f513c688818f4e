//! Inputs of a target: random ones, or the same ones every time.

use bolero::generator::bolero_generator::driver::{ByteSliceDriver, Options};
use bolero::{ValueGenerator, check};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::fmt::Debug;
use std::panic::RefUnwindSafe;

/// Name of the environment variable that asks for the same inputs every time.
const REPEATABLE: &str = "OPSPACE_FUZZ_REPEATABLE";

/// Number of random bytes of which an input is made.
const BYTES: usize = 4096;

/// Passes inputs of a generator to `test`: `count` of them, unless bolero's environment variables choose another number.
pub fn for_each_input<G>(generator: G, count: usize, mut test: impl FnMut(&G::Output) + RefUnwindSafe)
where
    G: ValueGenerator + RefUnwindSafe,
    G::Output: Debug,
{
    if std::env::var_os(REPEATABLE).is_none() {
        check!().with_generator(generator).with_iterations(count).for_each(test);
        return;
    }
    for seed in 0..count {
        let mut bytes = [0; BYTES];
        ChaCha8Rng::seed_from_u64(seed as u64).fill_bytes(&mut bytes);
        if let Some(input) = generator.generate(&mut ByteSliceDriver::new(&bytes, &Options::default())) {
            test(&input);
        }
    }
}
