//! Meshes as STL and OBJ.

use crate::edits::{apply, edited};
use crate::inputs::for_each_input;
use crate::limits::Target;
use opspace_model::collision::{MeshFormat, enclosing_capsule, mesh_vertices};

/// Most memory for one file, bytes.
const MOST_BYTES: usize = 32 << 20;

/// Coordinates of the vertices of the seeds.
const VERTICES: [[f32; 3]; 6] = [
    [0.0, 0.0, 0.0],
    [1.5, 0.0, 0.0],
    [0.0, 2.5, 0.0],
    [0.0, 0.0, -3.5e-2],
    [1.0, 1.0, 1.0],
    [-1e3, 7.0, 0.25],
];

/// An error has a reason. The vertices of an accepted file are finite, and a capsule encloses all of them.
#[test]
#[ignore = "a fuzz target, which runs for a minute or longer: .ci/run fuzz"]
fn mesh() {
    let files =
        [(binary(), MeshFormat::Stl), (text().into(), MeshFormat::Stl), (obj().into(), MeshFormat::Obj)];
    let seeds = files.each_ref().map(|(bytes, _)| bytes.clone());
    let target = Target::new("mesh", MOST_BYTES);
    for_each_input(edited(seeds.len()), 3000, |(seed, edits)| {
        let bytes = apply(&seeds, *seed, edits);
        let (_, format) = files[*seed];
        target.check(&bytes, edits.is_empty(), || match mesh_vertices(&bytes, format) {
            Ok(vertices) => {
                assert!(vertices.iter().flatten().all(|x| x.is_finite()));
                let capsule = enclosing_capsule(&vertices).expect("a mesh has vertices");
                assert!(vertices.iter().all(|vertex| capsule.distance_m(vertex) <= 0.0), "{capsule:?}");
                true
            }
            Err(error) => {
                assert!(!error.to_string().is_empty(), "{error:?}");
                false
            }
        });
    });
}

fn binary() -> Vec<u8> {
    let mut bytes = vec![0; 80];
    bytes.extend(2_u32.to_le_bytes());
    for triangle in VERTICES.chunks_exact(3) {
        bytes.extend([0; 12]);
        triangle.iter().flatten().for_each(|x| bytes.extend(x.to_le_bytes()));
        bytes.extend([0; 2]);
    }
    bytes
}

fn text() -> String {
    let vertex = |[x, y, z]: &[f32; 3]| format!("vertex {x} {y} {z}\n");
    let facet = |corners: &[[f32; 3]]| {
        let corners: String = corners.iter().map(vertex).collect();
        format!("facet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet\n")
    };
    format!("solid seed\n{}endsolid seed\n", VERTICES.chunks_exact(3).map(facet).collect::<String>())
}

fn obj() -> String {
    let vertices: String = VERTICES.iter().map(|[x, y, z]| format!("v {x} {y} {z}\n")).collect();
    format!("# seed\n{vertices}vn 0 0 1\nf 1//1 2//1 3//1\nf 4 5 -1\n")
}
