//! Damping zone of a task near its singular poses, for files and code.

use crate::error::{ControlError, Reason};
use crate::tasks::task::{FULL_DEMAND_M_PER_S2, LARGEST_THRESHOLD, THRESHOLD_AT_REST};
use opspace_backend::quantity::Positive;
use opspace_model::Inversion;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Mobilities (eigenvalues of Λ⁻¹) below which directions are damped, relative to the typical one: the median of the
/// lowest mobility over many postures. The threshold grows with the acceleration that the task demands of such
/// directions.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct DampingZone {
    /// Threshold of a task at rest: small, so that the task is exact nearly everywhere, but large enough that the force on
    /// a goal out of reach does not make the arm oscillate.
    pub at_rest: Positive,
    /// Highest threshold, from `at_rest` to 1. With 0.3, fast motion through a singular pose stays smooth; with 1, a fast
    /// task is damped at half of all postures.
    #[cfg_attr(feature = "schema", schemars(extend("maximum" = 1)))]
    pub most: Positive,
    /// Demanded acceleration that leads to the highest threshold, m/s² (rotations times the characteristic length); 4 is
    /// that of a quick motion of an arm. A smaller one damps slower motions.
    pub full_demand_m_per_s2: Positive,
}

impl Default for DampingZone {
    fn default() -> Self {
        Self {
            at_rest: Positive::literal(THRESHOLD_AT_REST),
            most: Positive::literal(LARGEST_THRESHOLD),
            full_demand_m_per_s2: Positive::literal(FULL_DEMAND_M_PER_S2),
        }
    }
}

impl DampingZone {
    /// Inversion with these thresholds.
    #[must_use]
    pub fn inversion(&self) -> Inversion {
        Inversion::Adaptive {
            least: self.at_rest.get(),
            most: self.most.get(),
            full_demand: self.full_demand_m_per_s2.get(),
        }
    }

    /// Checks that the thresholds are in order, and that no fixed threshold (`is_fixed`) excludes them. `key` is the path of
    /// the task in the file.
    pub(crate) fn check(&self, is_fixed: bool, key: &str) -> Result<(), ControlError> {
        let key = format!("{key}.damping_zone");
        let (at_rest, most) = (self.at_rest.get(), self.most.get());
        let error = |message: String| Err(ControlError::new(&key, Reason::Value { message }));
        if is_fixed {
            return error(
                "a zone that grows with the demand excludes a fixed `singularity_threshold`, and `singularities` other \
                 than \"damped\": remove one"
                    .to_owned(),
            );
        }
        if most > 1.0 {
            return error(format!(
                "`most` is {most}, above 1: at the typical mobility, where half of all postures are below, the task \
                 would never be exact in motion"
            ));
        }
        if at_rest > most {
            return error(format!(
                "`at_rest` is {at_rest}, above `most` = {most}: the zone grows with the demand, and does not shrink"
            ));
        }
        Ok(())
    }
}
