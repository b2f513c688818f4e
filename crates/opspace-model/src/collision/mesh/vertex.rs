//! Vertex of a mesh file in text.

use nalgebra::Vector3;

/// Returns the three numbers of a vertex; further numbers (a weight, a color) are ignored.
pub(super) fn three_numbers<'a>(mut words: impl Iterator<Item = &'a str>) -> Option<Vector3<f64>> {
    let mut next = || words.next()?.parse::<f64>().ok();
    Some(Vector3::new(next()?, next()?, next()?))
}
