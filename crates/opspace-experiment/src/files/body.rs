//! Numbers of a rigid body in a file: which a body can have.

use crate::files::source::{FileError, Source};
use nalgebra::Matrix3;
use opspace_model::principal_moments;

/// Largest magnitude of a number of a body: that of a URDF's numbers.
pub(crate) const MAX_NUMBER: f64 = 1e9;

/// Tolerance for comparisons of principal moments, relative to the largest; data sheets give few digits.
const INERTIA_TOLERANCE: f64 = 1e-3;

/// Mass properties as a file states them.
pub(crate) struct BodyNumbers {
    pub mass_kg: f64,
    pub com_m: [f64; 3],
    /// xx, xy, xz, yy, yz, zz about the centre of mass, kg m².
    pub inertia_kg_m2: [f64; 6],
}

/// Checks that numbers of a table are not too large.
pub(crate) fn check_numbers(
    source: &Source,
    [table, name]: [&str; 2],
    numbers: &[(&str, &[f64])],
) -> Result<(), FileError> {
    for (key, numbers) in numbers {
        if let Some(number) = numbers.iter().find(|number| number.abs() > MAX_NUMBER) {
            let help = Some(format!("give numbers from -{MAX_NUMBER:e} to {MAX_NUMBER:e}"));
            return Err(FileError::at_key(
                source,
                [table, name, key],
                format!("{number:e} is too large"),
                help,
            ));
        }
    }
    Ok(())
}

/// Checks that a body can have these mass properties.
pub(crate) fn check_body(source: &Source, path: [&str; 2], body: &BodyNumbers) -> Result<(), FileError> {
    check_numbers(
        source,
        path,
        &[("mass_kg", &[body.mass_kg]), ("com_m", &body.com_m), ("inertia_kg_m2", &body.inertia_kg_m2)],
    )?;
    let refuse = |message: String, help: &str| {
        let key = [path[0], path[1], "inertia_kg_m2"];
        Err(FileError::at_key(source, key, message, Some(help.to_owned())))
    };
    let [xx, xy, xz, yy, yz, zz] = body.inertia_kg_m2;
    let moments = principal_moments(&Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz));
    let tolerance = INERTIA_TOLERANCE * moments[2].abs().max(moments[0].abs());
    if moments[0] < -tolerance || moments[0] + moments[1] < moments[2] - tolerance {
        let message = format!(
            "no body has the principal moments {:.3e}, {:.3e}, {:.3e} kg m²: they must not be negative, and the sum of \
             any two must not be less than the third",
            moments[0], moments[1], moments[2]
        );
        return refuse(message, "the order is xx, xy, xz, yy, yz, zz, about the centre of mass");
    }
    if body.mass_kg == 0.0 && moments[2] > 0.0 {
        return refuse("a body without mass has no inertia".to_owned(), "give mass_kg");
    }
    Ok(())
}
