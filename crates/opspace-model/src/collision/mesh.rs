//! Vertices of mesh files: binary and ASCII STL, and OBJ. Everything else in the files is ignored.

mod error;
mod obj;
mod stl;
mod vertex;

use super::capsule::MAX_LENGTH_M;
use crate::files::read_file;
pub use error::{MAX_MESH_BYTES, MeshError, MeshErrorKind};
use nalgebra::Vector3;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Format of a mesh file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeshFormat {
    /// STL, binary or ASCII.
    Stl,
    /// Wavefront OBJ.
    Obj,
}

impl MeshFormat {
    /// Returns the format of a file name; `None` if it is not read here.
    #[must_use]
    pub fn from_name(file: &str) -> Option<Self> {
        let (_, extension) = file.rsplit_once('.')?;
        match extension.to_ascii_lowercase().as_str() {
            "stl" => Some(Self::Stl),
            "obj" => Some(Self::Obj),
            _ => None,
        }
    }
}

/// Returns the vertices of a mesh file with these contents, in the units of the file. Vertices may be repeated.
///
/// # Errors
/// [`MeshErrorKind`] if the contents are incomplete or malformed, or a vertex is not finite or larger than 1e9.
pub fn mesh_vertices(bytes: &[u8], format: MeshFormat) -> Result<Vec<Vector3<f64>>, MeshErrorKind> {
    let vertices = match format {
        MeshFormat::Stl => stl::vertices(bytes)?,
        MeshFormat::Obj => obj::vertices(bytes)?,
    };
    check(&vertices)?;
    if vertices.is_empty() { Err(MeshErrorKind::Empty) } else { Ok(vertices) }
}

/// Reads the vertices of a file and scales them; m.
pub(super) fn read_mesh(
    path: &Path,
    format: MeshFormat,
    scale: &[f64; 3],
) -> Result<Vec<Vector3<f64>>, MeshErrorKind> {
    let scale = Vector3::from(*scale);
    let vertices = mesh_vertices(&read_bytes(path)?, format)?;
    let vertices: Vec<_> = vertices.iter().map(|vertex| vertex.component_mul(&scale)).collect();
    check(&vertices)?;
    Ok(vertices)
}

/// Reads the triangles of a file and scales them; m.
pub(super) fn read_triangles(
    path: &Path,
    format: MeshFormat,
    scale: &[f64; 3],
) -> Result<Vec<[Vector3<f64>; 3]>, MeshErrorKind> {
    let scale = Vector3::from(*scale);
    let triangles = mesh_triangles(&read_bytes(path)?, format)?;
    let scaled = triangles.into_iter().map(|corners| corners.map(|corner| corner.component_mul(&scale)));
    Ok(scaled.collect())
}

/// Returns the triangles of a mesh file with these contents, in the units of the file. Faces with more corners are divided from
/// their first corner.
///
/// # Errors
/// As [`mesh_vertices`].
pub fn mesh_triangles(bytes: &[u8], format: MeshFormat) -> Result<Vec<[Vector3<f64>; 3]>, MeshErrorKind> {
    let vertices = mesh_vertices(bytes, format)?;
    Ok(match format {
        MeshFormat::Stl => vertices.as_chunks::<3>().0.to_vec(),
        MeshFormat::Obj => obj::triangles(bytes, &vertices),
    })
}

/// Returns the path of a mesh that is named in a URDF; `None` if there is no such file.
///
/// A relative name is relative to the folder of the URDF. `package://NAME/...` is relative to the closest folder above
/// the URDF with the name of the package; `file://` precedes an absolute path.
#[must_use]
pub fn find_mesh(file: &str, urdf: Option<&Path>) -> Option<PathBuf> {
    let path = if let Some(path) = file.strip_prefix("file://") {
        PathBuf::from(path)
    } else {
        let folder = match urdf?.parent()? {
            current if current.as_os_str().is_empty() => Path::new("."),
            folder => folder,
        };
        match (file.strip_prefix("package://"), file.contains("://")) {
            (Some(within), _) => {
                let (package, file) = within.split_once('/')?;
                let inside = |above: &Path| (above.file_name()? == package).then(|| above.join(file));
                fs::canonicalize(folder).ok()?.ancestors().find_map(inside)?
            }
            (None, true) => return None,
            (None, false) => folder.join(file),
        }
    };
    path.exists().then_some(path)
}

/// Reads a file up to the largest size.
fn read_bytes(path: &Path) -> Result<Vec<u8>, MeshErrorKind> {
    read_file(path, MAX_MESH_BYTES as u64).map_err(|error| match error.kind() {
        ErrorKind::InvalidInput => MeshErrorKind::NotAFile,
        ErrorKind::FileTooLarge => {
            MeshErrorKind::TooLarge { bytes: fs::metadata(path).map_or(0, |metadata| metadata.len()) }
        }
        _ => MeshErrorKind::Unreadable { reason: error.to_string() },
    })
}

fn check(vertices: &[Vector3<f64>]) -> Result<(), MeshErrorKind> {
    let is_bad = |vertex: &Vector3<f64>| !vertex.iter().all(|x| x.abs() <= MAX_LENGTH_M);
    match vertices.iter().position(is_bad) {
        Some(vertex) => Err(MeshErrorKind::BadVertex { vertex }),
        None => Ok(()),
    }
}
