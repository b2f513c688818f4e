//! Damaged mesh files: each gives an error that names link and file.
#![expect(clippy::unwrap_used, reason = "a test")]

use opspace_model::collision::{MAX_MESH_BYTES, MeshErrorKind, MeshFormat, generate_capsules, mesh_vertices};
use opspace_model::urdf::link_shapes;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::fs::{self, File};

const TEXT: &str = "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1e0 0\nendloop\nendfacet\nendsolid\n";
const OBJ: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";

/// A binary file with two triangles.
fn binary() -> Vec<u8> {
    let mut bytes = vec![0; 80];
    bytes.extend(2_u32.to_le_bytes());
    bytes.extend((0..100_u8).map(|i| i % 7));
    bytes
}

fn error(bytes: &[u8], format: MeshFormat) -> String {
    mesh_vertices(bytes, format).unwrap_err().to_string()
}

#[test]
fn sound_meshes_have_vertices() {
    assert_eq!(mesh_vertices(&binary(), MeshFormat::Stl).unwrap().len(), 6);
    assert_eq!(mesh_vertices(TEXT.as_bytes(), MeshFormat::Stl).unwrap()[2].y, 1.0);
    assert_eq!(mesh_vertices(OBJ.as_bytes(), MeshFormat::Obj).unwrap()[1].x, 1.0);
}

/// Checks that every truncated file is an error, except one that lacks only what follows the last triangle.
#[test]
fn truncated_meshes_are_refused() {
    let bytes = binary();
    for length in 0..bytes.len() {
        assert!(mesh_vertices(&bytes[..length], MeshFormat::Stl).is_err(), "{length}");
    }
    for length in 0..TEXT.len() - 1 {
        assert!(mesh_vertices(&TEXT.as_bytes()[..length], MeshFormat::Stl).is_err(), "{length}");
    }
    for length in 0..OBJ.rfind('f').unwrap() {
        assert!(mesh_vertices(&OBJ.as_bytes()[..length], MeshFormat::Obj).is_err(), "{length}");
    }
    assert_eq!(
        error(&bytes[..130], MeshFormat::Stl),
        "is not complete: its 2 triangles need 184 bytes, the file has 130"
    );
}

#[test]
fn malformed_meshes_are_refused() {
    for (from, to, message) in [
        ("vertex 1 0 0", "vertex 1 0", "line 5: a vertex needs three numbers"),
        ("vertex 1 0 0", "vertex 1 0 x", "line 5: a vertex needs three numbers"),
        ("vertex 1 0 0\n", "", "line 7: a facet needs three vertices"),
        ("vertex 1 0 0", "vertex 1 0 nan", "vertex 1 has a coordinate that is not finite"),
        ("vertex 1 0 0", "vertex 1 0 1e10", "vertex 1 has a coordinate that is not finite"),
        ("endsolid", "", "line 9: the file ends without 'endsolid': is it truncated?"),
    ] {
        let message_found = error(TEXT.replace(from, to).as_bytes(), MeshFormat::Stl);
        assert!(message_found.starts_with(message), "{message_found}");
    }
    for (from, to, message) in [
        ("v 1 0 0", "v 1 0", "line 2: a vertex needs three numbers"),
        ("v 1 0 0", "v 1 inf 0", "vertex 1 has a coordinate that is not finite"),
        ("f 1 2 3", "f 1 2 4", "line 4: a face refers to a vertex that the file does not have"),
        ("f 1 2 3", "f 1 x 3", "line 4: a face needs vertex numbers"),
        ("f 1 2 3", "", "has no triangles"),
    ] {
        let message_found = error(OBJ.replace(from, to).as_bytes(), MeshFormat::Obj);
        assert!(message_found.starts_with(message), "{message_found}");
    }
    let mut infinite = binary();
    infinite[96..100].copy_from_slice(&f32::INFINITY.to_le_bytes());
    assert_eq!(mesh_vertices(&infinite, MeshFormat::Stl), Err(MeshErrorKind::BadVertex { vertex: 0 }));
}

/// Checks that random edits of sound files cause no panic, and that vertices are finite.
#[test]
fn edited_meshes_cause_no_panic() {
    let mut rng = ChaCha8Rng::seed_from_u64(13);
    let files = [
        (binary(), MeshFormat::Stl),
        (TEXT.as_bytes().to_vec(), MeshFormat::Stl),
        (OBJ.as_bytes().to_vec(), MeshFormat::Obj),
    ];
    for _ in 0..20_000 {
        let (mut bytes, format) = files[rng.random_range(0..3)].clone();
        for _ in 0..rng.random_range(1..6) {
            let i = rng.random_range(0..bytes.len());
            bytes[i] = rng.random();
        }
        if let Ok(vertices) = mesh_vertices(&bytes, format) {
            assert!(vertices.iter().flatten().all(|x| x.is_finite()));
        }
    }
}

/// Compared: files that cannot be used, and the errors, which name the link and the file.
#[test]
fn errors_name_link_and_file() {
    let folder = tempfile::tempdir().unwrap();
    let urdf = folder.path().join("arm.urdf");
    fs::write(folder.path().join("short.stl"), &binary()[..100]).unwrap();
    fs::create_dir(folder.path().join("folder.stl")).unwrap();
    File::create(folder.path().join("large.obj")).unwrap().set_len(MAX_MESH_BYTES as u64 + 1).unwrap();
    for (file, scale, message) in [
        ("short.stl", "1 1 1", "is not complete: its 2 triangles need 184 bytes, the file has 100"),
        ("folder.stl", "1 1 1", "is not a file"),
        ("large.obj", "1 1 1", "has 67108865 bytes; at most 67108864 are read"),
        ("far.obj", "1 1e9 1", "vertex 1 has a coordinate that is not finite"),
    ] {
        fs::write(folder.path().join("far.obj"), "v 0 0 0\nv 0 2 0\nv 0 1 0\nf 1 2 3").unwrap();
        let mesh = format!("<mesh filename='{file}' scale='{scale}'/>");
        let text = format!(
            "<robot name='r'><link name='hand'><collision><geometry>{mesh}</geometry></collision></link></robot>"
        );
        let error = generate_capsules(&link_shapes(&text).unwrap(), Some(&urdf)).unwrap_err();
        assert!(error.to_string().starts_with(&format!("link 'hand': mesh {file}: {message}")), "{error}");
        assert_eq!((error.link.as_str(), error.file.as_str()), ("hand", file));
    }
}
