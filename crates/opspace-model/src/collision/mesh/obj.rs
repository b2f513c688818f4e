//! Vertices of Wavefront OBJ files: the lines `v` and `f` of the format; all others are ignored.

use super::error::MeshErrorKind;
use super::vertex::three_numbers;
use nalgebra::Vector3;

/// Returns all vertices. Faces are read to detect a truncated file, in which they are missing or refer to missing
/// vertices.
pub(super) fn vertices(bytes: &[u8]) -> Result<Vec<Vector3<f64>>, MeshErrorKind> {
    let text = String::from_utf8_lossy(bytes);
    let mut vertices = Vec::new();
    let mut faces = 0;
    // Largest vertex number of a face, and its line.
    let mut highest = (0, 0);
    for (line, content) in (1..).zip(text.lines()) {
        let mut words = content.split_ascii_whitespace();
        let malformed = |reason| MeshErrorKind::Malformed { line, reason };
        match words.next() {
            Some("v") => {
                vertices.push(three_numbers(words).ok_or(malformed("a vertex needs three numbers"))?);
            }
            Some("f") => {
                faces += 1;
                for corner in words {
                    let number = corner.split('/').next().unwrap_or_default();
                    let number: i64 = number.parse().map_err(|_| malformed("a face needs vertex numbers"))?;
                    if number > highest.0 {
                        highest = (number, line);
                    }
                }
            }
            _ => {}
        }
    }
    if faces == 0 {
        return Err(MeshErrorKind::Empty);
    }
    if usize::try_from(highest.0).is_ok_and(|number| number > vertices.len()) {
        let reason = "a face refers to a vertex that the file does not have";
        return Err(MeshErrorKind::Malformed { line: highest.1, reason });
    }
    Ok(vertices)
}

/// Returns the triangles of the faces between vertices, which [`vertices`] has read from the same file. Numbers below zero count
/// from the last vertex; corners that do not exist are left out.
pub(super) fn triangles(bytes: &[u8], vertices: &[Vector3<f64>]) -> Vec<[Vector3<f64>; 3]> {
    let text = String::from_utf8_lossy(bytes);
    let (mut triangles, mut known) = (Vec::new(), 0);
    for content in text.lines() {
        let mut words = content.split_ascii_whitespace();
        match words.next() {
            Some("v") => known += 1,
            Some("f") => {
                let corner = |word: &str| {
                    let number: i64 = word.split('/').next()?.parse().ok()?;
                    let index = if number < 0 { known + number } else { number - 1 };
                    vertices.get(usize::try_from(index).ok()?).copied()
                };
                let corners: Vec<Vector3<f64>> = words.filter_map(corner).collect();
                if let Some((first, rest)) = corners.split_first() {
                    triangles.extend(rest.windows(2).map(|pair| [*first, pair[0], pair[1]]));
                }
            }
            _ => {}
        }
    }
    triangles
}
