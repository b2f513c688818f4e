//! Masses and inertias of links that replace those of the URDF, or that it does not state.

use crate::files::body::{BodyNumbers, check_body};
use crate::files::source::{FileError, Source};
use nalgebra::{Matrix3, Vector3};
use opspace_backend::quantity::{Positive, exactly};
use opspace_model::Inertia;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::BTreeMap;

/// Mass and inertia of a link of the URDF, in place of its `<inertial>`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct LinkFile {
    /// Mass, kg.
    pub mass_kg: Positive,
    /// Centre of mass in the axes of the link, from its origin, m.
    #[serde(deserialize_with = "exactly")]
    pub com_m: [f64; 3],
    /// Inertia xx, xy, xz, yy, yz, zz about the centre of mass, in the axes of the link, kg m².
    #[serde(deserialize_with = "exactly")]
    pub inertia_kg_m2: [f64; 6],
}

impl LinkFile {
    /// Inertia in the frame of the link.
    fn inertia(&self) -> Inertia {
        let [xx, xy, xz, yy, yz, zz] = self.inertia_kg_m2;
        Inertia {
            mass: self.mass_kg.get(),
            com: Vector3::from(self.com_m),
            rotational: Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz),
        }
    }
}

/// Inertias of the links of a robot file, by name.
pub(crate) fn inertias(
    source: &Source,
    links: &BTreeMap<String, LinkFile>,
) -> Result<Vec<(String, Inertia)>, FileError> {
    let inertia = |(name, link): (&String, &LinkFile)| {
        let numbers =
            BodyNumbers { com_m: link.com_m, mass_kg: link.mass_kg.get(), inertia_kg_m2: link.inertia_kg_m2 };
        check_body(source, ["link", name], &numbers)?;
        Ok((name.clone(), link.inertia()))
    };
    links.iter().map(inertia).collect()
}
