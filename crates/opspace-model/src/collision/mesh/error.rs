//! Errors of mesh files.

use thiserror::Error;

/// Largest size of a mesh file, bytes. The largest meshes for the display of a robot have some ten megabytes; those for
/// collisions are much smaller.
pub const MAX_MESH_BYTES: usize = 64 << 20;

/// Mesh file that cannot be used.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("link '{link}': mesh {file}: {kind}")]
#[non_exhaustive]
pub struct MeshError {
    /// Link to which the mesh belongs.
    pub link: String,
    /// Name of the file in the URDF.
    pub file: String,
    /// Kind of the error.
    pub kind: MeshErrorKind,
}

/// Reason why a mesh file cannot be used.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum MeshErrorKind {
    /// File that cannot be read.
    #[error("cannot be read: {reason}")]
    Unreadable {
        /// Message of the operating system.
        reason: String,
    },
    /// Folder or device instead of a file.
    #[error("is not a file")]
    NotAFile,
    /// File larger than meshes for collisions are.
    #[error("has {bytes} bytes; at most {MAX_MESH_BYTES} are read: reduce the number of its triangles")]
    TooLarge {
        /// Size of the file, bytes.
        bytes: u64,
    },
    /// File without triangles.
    #[error("has no triangles")]
    Empty,
    /// Binary STL file whose size does not match its number of triangles.
    #[error("is not complete: its {triangles} triangles need {needed} bytes, the file has {bytes}")]
    Incomplete {
        /// Number of triangles that the file states.
        triangles: u32,
        /// Number of bytes of that many triangles.
        needed: u64,
        /// Size of the file, bytes.
        bytes: usize,
    },
    /// Text that is not as the format requires.
    #[error("line {line}: {reason}")]
    Malformed {
        /// Line, from 1.
        line: usize,
        /// Description of the error.
        reason: &'static str,
    },
    /// Vertex that is not finite or too far away.
    #[error("vertex {vertex} has a coordinate that is not finite or larger than 1e9 m, with its scale")]
    BadVertex {
        /// Number of the vertex in the file, from 0.
        vertex: usize,
    },
}
