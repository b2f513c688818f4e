//! Vertices of STL files. The format has no specification; Wikipedia's page "STL (file format)" describes it.

use super::error::MeshErrorKind;
use super::vertex::three_numbers;
use nalgebra::Vector3;

/// Size of the header of a binary file: 80 bytes of text, and the number of triangles.
const HEADER: usize = 84;
/// Size of a triangle in a binary file: the normal and three vertices of three floats each, and two more bytes.
const TRIANGLE: usize = 50;
/// Size of the normal, which precedes the vertices.
const NORMAL: usize = 12;
/// Size of the vertices of a triangle.
const VERTICES: usize = 36;

pub(super) fn vertices(bytes: &[u8]) -> Result<Vec<Vector3<f64>>, MeshErrorKind> {
    let is_text = bytes.trim_ascii_start().starts_with(b"solid");
    let Some((header, triangles)) = bytes.split_at_checked(HEADER) else {
        return if is_text { text(bytes) } else { Err(MeshErrorKind::Empty) };
    };
    let count = u32::from_le_bytes([header[80], header[81], header[82], header[83]]);
    let needed = HEADER as u64 + u64::from(count) * TRIANGLE as u64;
    match bytes.len() as u64 {
        // Binary files may begin with "solid" too: their size tells them from text.
        size if size == needed => Ok(binary(triangles)),
        _ if is_text => text(bytes),
        // Some programs pad their files.
        size if size > needed => Ok(binary(&triangles[..usize::try_from(needed).unwrap_or(0) - HEADER])),
        _ => Err(MeshErrorKind::Incomplete { triangles: count, needed, bytes: bytes.len() }),
    }
}

fn binary(triangles: &[u8]) -> Vec<Vector3<f64>> {
    let (triangles, _) = triangles.as_chunks::<TRIANGLE>();
    let mut vertices = Vec::with_capacity(3 * triangles.len());
    for triangle in triangles {
        let (numbers, _) = triangle[NORMAL..NORMAL + VERTICES].as_chunks::<4>();
        let (corners, _) = numbers.as_chunks::<3>();
        vertices
            .extend(corners.iter().map(|xyz| Vector3::from(xyz.map(|x| f64::from(f32::from_le_bytes(x))))));
    }
    vertices
}

fn text(bytes: &[u8]) -> Result<Vec<Vector3<f64>>, MeshErrorKind> {
    let text = String::from_utf8_lossy(bytes);
    let mut vertices = Vec::new();
    let (mut last, mut ended) = (1, false);
    for (line, content) in (1..).zip(text.lines()) {
        let mut words = content.split_ascii_whitespace();
        let first = words.next().unwrap_or_default().to_ascii_lowercase();
        match first.as_str() {
            "vertex" => {
                let reason = "a vertex needs three numbers";
                vertices.push(three_numbers(words).ok_or(MeshErrorKind::Malformed { line, reason })?);
            }
            "endfacet" if vertices.len() % 3 != 0 => {
                return Err(MeshErrorKind::Malformed { line, reason: "a facet needs three vertices" });
            }
            _ => {}
        }
        ended = first == "endsolid" || ended && first.is_empty();
        last = line;
    }
    if ended {
        Ok(vertices)
    } else {
        Err(MeshErrorKind::Malformed {
            line: last,
            reason: "the file ends without 'endsolid': is it truncated?",
        })
    }
}
