//! Mass properties of shapes and meshes that are filled with a material.

use nalgebra::{Matrix3, Vector3};
use opspace_model::collision::{Densities, MeshFormat, mesh_inertia, mesh_triangles, solid_inertia};
use opspace_model::urdf::{LinkShapes, link_shapes};
use std::fmt::Write as _;
use std::fs;

/// Errors of rounding, over values of the order of one.
const ROUNDING: f64 = 1e-12;

/// Faces of a box by the numbers of its corners, each with its outside in front.
const FACES: [[usize; 4]; 6] =
    [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];

fn corners(size: Vector3<f64>, at: Vector3<f64>) -> Vec<Vector3<f64>> {
    let corner = |i: usize| Vector3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2) as f64);
    (0..8).map(|i| at + (corner(i) - Vector3::repeat(0.5)).component_mul(&size)).collect()
}

fn triangles(corners: &[Vector3<f64>], faces: &[[usize; 4]]) -> Vec<[Vector3<f64>; 3]> {
    let of_face = |face: &[usize; 4]| {
        [[face[0], face[1], face[2]], [face[0], face[2], face[3]]].map(|t| t.map(|i| corners[i]))
    };
    faces.iter().flat_map(of_face).collect()
}

/// Inertia of a solid box of density one.
fn solid_box(size: Vector3<f64>) -> (f64, Matrix3<f64>) {
    let mass = size.product();
    let squares = size.component_mul(&size) * (mass / 12.0);
    (mass, Matrix3::identity() * squares.sum() - Matrix3::from_diagonal(&squares))
}

/// Compared: mass, centre and inertia of meshes of boxes, and those of solid boxes: closed, and inside out, and with triangles that
/// face both ways.
#[test]
fn closed_boxes_are_exact() {
    for (size, at) in [([0.2, 0.3, 0.5], [0.0; 3]), ([1.0, 0.01, 2.0], [3.0, -1.0, 0.4])] {
        let (size, at) = (Vector3::from(size), Vector3::from(at));
        let (mass, rotational) = solid_box(size);
        let out = triangles(&corners(size, at), &FACES);
        let inside_out: Vec<_> = out.iter().map(|[a, b, c]| [*a, *c, *b]).collect();
        let mixed: Vec<_> = out
            .iter()
            .enumerate()
            .map(|(i, [a, b, c])| if i % 3 == 0 { [*a, *c, *b] } else { [*a, *b, *c] })
            .collect();
        for mesh in [out, inside_out, mixed] {
            let found = mesh_inertia(&mesh);
            assert!((found.mass - mass).abs() < ROUNDING * mass, "{found:?}");
            assert!((found.com - at).norm() < ROUNDING, "{found:?}");
            assert!((found.rotational - rotational).norm() < ROUNDING * rotational.norm(), "{found:?}");
        }
    }
}

/// Compared: the mass of a box without one of its faces, and that of the solid box: the missing part is that between the face and
/// the centre.
#[test]
fn open_boxes_lack_a_part() {
    let size = Vector3::new(0.2, 0.3, 0.5);
    for missing in 0..6 {
        let faces: Vec<[usize; 4]> = (0..6).filter(|face| *face != missing).map(|face| FACES[face]).collect();
        let found = mesh_inertia(&triangles(&corners(size, Vector3::repeat(2.0)), &faces));
        assert!((0.7..1.1).contains(&(found.mass / size.product())), "{missing}: {found:?}");
    }
    assert_eq!(mesh_inertia(&[]).mass, 0.0);
}

/// Compared: the same box from an ASCII STL file and from an OBJ file whose faces have four corners and count from the end, scaled
/// to mm, and as a primitive; and a sphere and a capsule with formulas.
#[test]
fn meshes_and_primitives_agree() {
    let (size, folder) = (Vector3::new(200.0, 300.0, 500.0), tempfile::tempdir().expect("a folder"));
    let corners = corners(size, Vector3::zeros());
    let mut stl = "solid box\n".to_owned();
    for triangle in triangles(&corners, &FACES) {
        stl += "facet normal 0 0 0\nouter loop\n";
        triangle.iter().for_each(|c| writeln!(stl, "vertex {} {} {}", c.x, c.y, c.z).expect("text"));
        stl += "endloop\nendfacet\n";
    }
    stl += "endsolid box\n";
    let mut obj = String::new();
    corners.iter().for_each(|c| writeln!(obj, "v {} {} {}", c.x, c.y, c.z).expect("text"));
    for face in FACES {
        let numbers = face.map(|i| (i as i64 - 8).to_string() + "/1");
        writeln!(obj, "f {}", numbers.join(" ")).expect("text");
    }
    assert_eq!(mesh_triangles(obj.as_bytes(), MeshFormat::Obj).expect("a mesh").len(), 12);
    fs::write(folder.path().join("box.stl"), stl).expect("a file");
    fs::write(folder.path().join("box.obj"), obj).expect("a file");
    let link = |name: &str, shape: &str| {
        format!(
            "<link name=\"{name}\"><collision><origin xyz=\"0 0 1\"/><geometry>{shape}</geometry></collision></link>"
        )
    };
    let urdf = format!(
        "<robot name=\"r\">{}{}{}{}{}</robot>",
        link("stl", "<mesh filename=\"box.stl\" scale=\"0.001 0.001 0.001\"/>"),
        link("obj", "<mesh filename=\"box.obj\" scale=\"0.001 0.001 0.001\"/>"),
        link("box", "<box size=\"0.2 0.3 0.5\"/>"),
        link("sphere", "<sphere radius=\"0.1\"/>"),
        link("missing", "<mesh filename=\"none.stl\"/>"),
    );
    let file = folder.path().join("r.urdf");
    let filled = |mesh_kg_per_m3: f64, primitive_kg_per_m3: f64| -> Vec<_> {
        let densities = Densities { mesh_kg_per_m3, primitive_kg_per_m3 };
        let solid = |link: &LinkShapes| solid_inertia(link, Some(&file), densities).expect("readable meshes");
        link_shapes(&urdf).expect("shapes").iter().map(solid).collect()
    };
    let found = filled(1.0, 1.0);
    let (mass, rotational) = solid_box(size * 1e-3);
    for solid in &found[..3] {
        let solid = solid.expect("a shape");
        assert!(
            (solid.mass - mass).abs() < ROUNDING && (solid.com - Vector3::z()).norm() < ROUNDING,
            "{solid:?}"
        );
        assert!((solid.rotational - rotational).norm() < ROUNDING, "{solid:?}");
    }
    let sphere = found[3].expect("a shape");
    assert!((sphere.mass - 4.188_790_204_786_391e-3).abs() < 0.01 * ROUNDING, "{sphere:?}");
    assert!((sphere.rotational[(0, 0)] - 0.4 * sphere.mass * 0.01).abs() < 0.01 * ROUNDING);
    assert!(found[4].is_none());
    for (number, density) in [(0, 700.0), (1, 700.0), (2, 300.0), (3, 300.0)] {
        let (light, heavy) =
            (found[number].expect("a shape"), filled(700.0, 300.0)[number].expect("a shape"));
        assert!((heavy.mass - density * light.mass).abs() < 1e3 * ROUNDING, "{heavy:?}");
        assert!((heavy.com - light.com).norm() < ROUNDING, "{heavy:?}");
        assert!((heavy.rotational - density * light.rotational).norm() < 1e3 * ROUNDING, "{heavy:?}");
    }
}
