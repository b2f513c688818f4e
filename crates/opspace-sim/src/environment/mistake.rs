//! Contradictory parameters of an environment object.

use std::borrow::Cow;

/// Fewest physics steps in a period of a vibration.
const LEAST_STEPS: f64 = 20.0;

/// Key of an object's table that causes an error, and a description.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mistake {
    /// Key below the object's table, with a dot between the parts.
    pub key: Cow<'static, str>,
    /// Description of the mistake, and of what is allowed.
    pub message: Cow<'static, str>,
}

impl Mistake {
    /// Returns the mistake in the value of a key.
    pub(crate) fn new(key: impl Into<Cow<'static, str>>, message: impl Into<Cow<'static, str>>) -> Self {
        Self { key: key.into(), message: message.into() }
    }
}

/// Checks that a direction has a length.
pub(super) fn check_length(key: &'static str, direction: [f64; 3]) -> Result<(), Mistake> {
    if direction.iter().all(|component| *component == 0.0) {
        return Err(Mistake::new(key, "the direction has no length"));
    }
    Ok(())
}

/// Highest frequency that can be simulated with this physics rate, Hz.
pub(crate) fn highest_frequency(physics_hz: f64) -> f64 {
    physics_hz / LEAST_STEPS
}

/// Checks that a frequency (Hz) can be simulated with this physics rate (Hz).
pub(super) fn check_frequency(key: &'static str, frequency_hz: f64, physics_hz: f64) -> Result<(), Mistake> {
    let most = highest_frequency(physics_hz);
    if frequency_hz > most {
        return Err(Mistake::new(
            key,
            format!("at most a twentieth of the physics rate, {most} Hz, can be simulated"),
        ));
    }
    Ok(())
}
