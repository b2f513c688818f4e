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
