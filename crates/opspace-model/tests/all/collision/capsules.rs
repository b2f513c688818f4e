//! Capsules that enclose shapes, meshes and inertias.
#![expect(clippy::unwrap_used, reason = "a test")]

use nalgebra::{Matrix3, Vector3};
use opspace_model::collision::{
    Capsule, CapsuleSource, CapsuleWarning, GeneratedCapsules, LinkCapsule, enclosing_capsule,
    generate_capsules,
};
use opspace_model::urdf::link_shapes;
use opspace_model::{Inertia, Placement};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::PI;
use std::fs;
use std::path::Path;

/// Distance by which a point may seem to be outside because of rounding errors, relative to the size of the shape.
const ROUNDING: f64 = 1e-14;

/// Links named l0, l1, ... with these elements, the first of which is the root.
fn robot_of(links: &[String]) -> String {
    let link = |(i, content): (usize, &String)| {
        let joint =
            format!("<joint name='j{i}' type='fixed'><parent link='l0'/><child link='l{i}'/></joint>");
        format!("<link name='l{i}'>{content}</link>\n{}", if i == 0 { "" } else { &joint })
    };
    let links: Vec<String> = links.iter().enumerate().map(link).collect();
    format!("<robot name='r'>\n{}</robot>", links.join("\n"))
}

fn collision(geometry: &str) -> String {
    format!(
        "<collision><origin xyz='0.1 -0.2 0.3' rpy='0.4 0.5 -0.6'/><geometry>{geometry}</geometry></collision>"
    )
}

/// Pose of the shapes of [`collision`].
fn place() -> Placement {
    Placement::from_rpy([0.4, 0.5, -0.6], [0.1, -0.2, 0.3])
}

fn generated(links: &[String], urdf: Option<&Path>) -> GeneratedCapsules {
    generate_capsules(&link_shapes(&robot_of(links)).unwrap(), urdf).unwrap()
}

/// Largest distance of any point from the capsule, m; not positive if it encloses all.
fn outside(capsule: &Capsule, points: impl IntoIterator<Item = Vector3<f64>>) -> f64 {
    points.into_iter().map(|point| capsule.distance_m(&point)).fold(f64::NEG_INFINITY, f64::max)
}

fn corners(half: Vector3<f64>) -> impl Iterator<Item = Vector3<f64>> {
    let signs = [-1.0, 1.0];
    signs.into_iter().flat_map(move |x| {
        signs
            .into_iter()
            .flat_map(move |y| signs.into_iter().map(move |z| half.component_mul(&Vector3::new(x, y, z))))
    })
}

fn rims(radius: f64, half_length: f64) -> impl Iterator<Item = Vector3<f64>> {
    (0..360).flat_map(move |degree| {
        let (sin, cos) = (f64::from(degree) * PI / 180.0).sin_cos();
        [-half_length, half_length].map(|z| Vector3::new(radius * cos, radius * sin, z))
    })
}

/// Points that are distributed evenly over the unit sphere.
fn sphere_points(count: usize) -> impl Iterator<Item = Vector3<f64>> {
    (0..count).map(move |i| {
        let z = 1.0 - (2.0 * i as f64 + 1.0) / count as f64;
        let (sin, cos) = (PI * (3.0 - 5.0_f64.sqrt()) * i as f64).sin_cos();
        Vector3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
    })
}

/// Compared: capsules of spheres, capsules, cylinders and boxes of many proportions, and their corners and rims; and
/// the volume, and that of a capsule whose axis is as long as the shape, or of a sphere.
#[test]
fn primitives_are_enclosed() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    for _ in 0..300 {
        let [x, y, z]: [f64; 3] = std::array::from_fn(|_| 10.0_f64.powf(rng.random_range(-2.5..0.3)));
        let links = [
            collision(&format!("<sphere radius='{x}'/>")),
            collision(&format!("<capsule radius='{x}' length='{y}'/>")),
            collision(&format!("<cylinder radius='{x}' length='{y}'/>")),
            collision(&format!("<box size='{x} {y} {z}'/>")),
        ];
        let all = generated(&links, None);
        assert!(all.warnings.is_empty());
        let capsules: Vec<Capsule> = all.capsules.iter().map(LinkCapsule::capsule).collect();
        let [sphere, capsule, cylinder, cuboid] = capsules[..] else { panic!("{all:?}") };
        assert_eq!(sphere, Capsule::sphere(place().translation, x));
        assert!((capsule.radius_m, (capsule.end_m - capsule.start_m).norm() - y) < (x + 1e-12, 1e-12));
        let size = x + y + z;
        let shown = |point: Vector3<f64>| place().act_point(&point);
        assert!(outside(&cylinder, rims(x, 0.5 * y).map(shown)) <= ROUNDING * size);
        assert!(outside(&cuboid, corners(Vector3::new(x, y, z) * 0.5).map(shown)) <= ROUNDING * size);
        let volume = |length: f64, radius: f64| PI * radius * radius * (length + 4.0 / 3.0 * radius);
        let simple = volume(y, x).min(volume(0.0, x.hypot(0.5 * y)));
        assert!(cylinder.volume_m3() <= simple * (1.0 + 1e-9));
    }
}

/// Compared: capsules around random points (a cloud, a plane, a line, one point), and the points; and the volume, and
/// that of the sphere around their mean.
#[test]
fn random_points_are_enclosed() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    for trial in 0..60 {
        let scale =
            Vector3::from([[1.0, 0.3, 0.2], [1.0, 1.0, 1.0], [1.0, 0.5, 0.0], [1.0, 0.0, 0.0]][trial % 4]);
        let offset = Vector3::from_fn(|_, _| rng.random_range(-5.0..5.0));
        let count = [1, 2, 3, 8, 300, 5000][trial % 6];
        let mut point = |_| Vector3::from_fn(|_, _| rng.random_range(-0.2..0.2)).component_mul(&scale);
        let points: Vec<Vector3<f64>> = (0..count).map(|i| place().act_point(&point(i)) + offset).collect();
        let capsule = enclosing_capsule(&points).unwrap();
        assert!(outside(&capsule, points.iter().copied()) <= 0.0, "{trial}: {capsule:?}");
        let mean = points.iter().sum::<Vector3<f64>>() / count as f64;
        let radius = points.iter().map(|p| (p - mean).norm()).fold(0.0, f64::max);
        assert!(capsule.volume_m3() <= 4.0 / 3.0 * PI * radius.powi(3) + 1e-12, "{trial}: {capsule:?}");
    }
    assert_eq!(enclosing_capsule(&[]), None);
}

/// Compared: capsules around the surface of a capsule, and this capsule: the volume is at most 2 % larger.
#[test]
fn capsule_around_a_capsule_is_tight() {
    let mut rng = ChaCha8Rng::seed_from_u64(10);
    for _ in 0..20 {
        let (half, radius) = (rng.random_range(0.0..0.4), rng.random_range(0.02..0.2));
        let on_surface = |p: Vector3<f64>| p * radius + Vector3::z() * half * p.z.signum();
        let points: Vec<_> = sphere_points(4000).map(|p| place().act_point(&on_surface(p))).collect();
        let capsule = enclosing_capsule(&points).unwrap();
        let exact = PI * radius * radius * (2.0 * half + 4.0 / 3.0 * radius);
        let ratio = capsule.volume_m3() / exact;
        assert!(ratio < 1.02, "half length {half}, radius {radius}: {ratio}");
    }
}

fn inertial(inertia: &Inertia) -> String {
    let (m, c) = (&inertia.rotational, &inertia.com);
    format!(
        "<inertial><origin xyz='{} {} {}'/><mass value='{}'/>\
         <inertia ixx='{}' ixy='{}' ixz='{}' iyy='{}' iyz='{}' izz='{}'/></inertial>",
        c.x,
        c.y,
        c.z,
        inertia.mass,
        m[(0, 0)],
        m[(0, 1)],
        m[(0, 2)],
        m[(1, 1)],
        m[(1, 2)],
        m[(2, 2)]
    )
}

/// Compared: the capsule of a link without shapes, and points of the uniform ellipsoid from which its inertia is
/// computed.
#[test]
fn ellipsoid_of_an_inertia_is_enclosed() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    for _ in 0..100 {
        let axes: Vector3<f64> = Vector3::from_fn(|_, _| rng.random_range(0.01..0.5));
        let squares = axes.component_mul(&axes);
        let mass = rng.random_range(0.1..10.0);
        let moments = Vector3::repeat(squares.sum()) - squares;
        let rotational = Matrix3::from_diagonal(&(moments * (mass / 5.0)));
        let inertia = place().act_inertia(&Inertia { mass, com: Vector3::zeros(), rotational });
        let all = generated(&[inertial(&inertia)], None);
        assert_eq!(all.warnings, [CapsuleWarning::NoShape { link: "l0".into() }]);
        let capsule = all.capsules[0].capsule();
        assert_eq!(all.capsules[0].source, CapsuleSource::Inertia);
        let surface = sphere_points(2000).map(|p| place().act_point(&p.component_mul(&axes)));
        let farthest = outside(&capsule, surface);
        assert!(farthest < 1e-7 && farthest > -0.05 * axes.max(), "{axes:?}: {farthest:e}");
    }
}

fn binary_stl(points: &[Vector3<f64>], header: &[u8]) -> Vec<u8> {
    let mut bytes = vec![b' '; 80];
    bytes[..header.len()].copy_from_slice(header);
    bytes.extend(u32::try_from(points.len() / 3).unwrap().to_le_bytes());
    for triangle in points.chunks_exact(3) {
        bytes.extend([0; 12]);
        triangle.iter().flatten().for_each(|&x| bytes.extend((x as f32).to_le_bytes()));
        bytes.extend([0; 2]);
    }
    bytes
}

fn text_stl(points: &[Vector3<f64>]) -> String {
    let vertex = |p: &Vector3<f64>| format!("      vertex {:e} {:e} {:e}\n", p.x, p.y, p.z);
    let facet = |corners: &[Vector3<f64>]| {
        let corners: String = corners.iter().map(vertex).collect();
        format!("  facet normal 0 0 1\n    outer loop\n{corners}    endloop\n  endfacet\n")
    };
    format!("solid part\n{}endsolid part\n", points.chunks_exact(3).map(facet).collect::<String>())
}

fn obj(points: &[Vector3<f64>]) -> String {
    let vertices: String = points.iter().map(|p| format!("v {} {} {}\n", p.x, p.y, p.z)).collect();
    let faces: String =
        (0..points.len() / 3).map(|i| format!("f {0}//1 {1}/2/3 {2}\n", 3 * i + 1, 3 * i + 2, -1)).collect();
    format!("# a comment\nmtllib x.mtl\n{vertices}vn 0 0 1\n{faces}")
}

/// Compared: capsules of meshes in all formats, found beside the URDF, in its package and by an absolute path, and all
/// vertices of the mesh at the pose and scale of the URDF.
#[test]
fn meshes_are_found_and_enclosed() {
    let folder = tempfile::tempdir().unwrap();
    let package = folder.path().join("arm_description");
    fs::create_dir_all(package.join("urdf")).unwrap();
    let urdf = package.join("urdf/arm.urdf");
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    // Numbers of single precision, as those of STL.
    let mut number = |range: f32| f64::from(rng.random_range(-range..range));
    let points: Vec<Vector3<f64>> =
        (0..600).map(|_| Vector3::new(number(200.0), number(40.0), number(60.0))).collect();
    fs::write(package.join("binary.STL"), binary_stl(&points, b"")).unwrap();
    fs::write(package.join("named.stl"), binary_stl(&points, b"solid of a program")).unwrap();
    let padded = [binary_stl(&points, b"x"), vec![0; 7]].concat();
    fs::write(package.join("padded.stl"), padded).unwrap();
    fs::write(package.join("text.stl"), text_stl(&points)).unwrap();
    fs::write(package.join("part.obj"), obj(&points)).unwrap();
    let mesh = |file: &str| collision(&format!("<mesh filename='{file}' scale='0.001 -0.002 0.001'/>"));
    let absolute = format!("file://{}", package.join("text.stl").display());
    let files =
        ["../binary.STL", "package://arm_description/named.stl", "../padded.stl", &absolute, "../part.obj"];
    let all = generated(&files.map(mesh), Some(&urdf));
    assert!(all.warnings.is_empty() && all.capsules.len() == 5, "{all:?}");
    let scale = Vector3::new(0.001, -0.002, 0.001);
    for capsule in &all.capsules {
        let vertices = points.iter().map(|p| place().act_point(&p.component_mul(&scale)));
        assert!(outside(&capsule.capsule(), vertices) <= 1e-15, "{capsule:?}");
        assert_eq!(capsule.source, CapsuleSource::Mesh);
        assert_eq!(capsule.capsule(), all.capsules[0].capsule());
    }
}

/// Compared: links with several shapes, missing meshes and other formats, and their capsules and warnings.
#[test]
fn missing_meshes_are_replaced_by_the_inertia() {
    let inertia =
        inertial(&Inertia { mass: 1.0, com: Vector3::zeros(), rotational: Matrix3::identity() * 0.01 });
    let sphere = collision("<sphere radius='0.1'/>");
    let mesh = |file: &str| collision(&format!("<mesh filename='{file}'/>"));
    let links = [
        format!("{inertia}{sphere}{}", mesh("package://arm/missing.stl")),
        format!("{inertia}{}", mesh("arm.dae")),
        mesh("missing.obj"),
        String::new(),
    ];
    let all = generated(&links, Some(Path::new("arm.urdf")));
    let names: Vec<(&str, CapsuleSource)> =
        all.capsules.iter().map(|c| (c.name.as_str(), c.source)).collect();
    let (inertia, sphere) = (CapsuleSource::Inertia, CapsuleSource::Sphere);
    assert_eq!(names, [("l0.1", sphere), ("l0.2", inertia), ("l1", inertia)]);
    let warnings: Vec<String> = all.warnings.iter().map(ToString::to_string).collect();
    assert_eq!(
        warnings,
        [
            "link 'l0': mesh package://arm/missing.stl was not found: a capsule is estimated from the inertia of the link",
            "link 'l1': mesh arm.dae is neither STL nor OBJ: a capsule is estimated from the inertia of the link",
            "link 'l2': mesh missing.obj was not found, and the link has no inertia: give it a capsule",
        ]
    );
}

/// Compared: malformed shapes, and the errors with their lines; a model is read nevertheless.
#[test]
fn malformed_shapes_are_refused() {
    for (geometry, message) in [
        ("<sphere/>", "line 2: link 'l0' has no <sphere radius>"),
        (
            "<sphere radius='0'/>",
            "line 2: link 'l0': <sphere radius> is \"0\"; give one positive number up to 1e9 (m)",
        ),
        ("<sphere radius='nan'/>", "line 2: link 'l0': <sphere radius> is \"nan\""),
        ("<cylinder radius='1' length='-1'/>", "line 2: link 'l0': <cylinder length> is \"-1\""),
        ("<box size='1 1'/>", "line 2: link 'l0': <box size> is \"1 1\"; give three finite numbers"),
        ("<box size='1 -1 1'/>", "line 2: link 'l0': <box size> is \"1 -1 1\""),
        ("<mesh/>", "line 2: link 'l0' has no <mesh filename>"),
        ("<mesh filename='a' scale='0 1 1'/>", "line 2: link 'l0': <mesh scale> is \"0 1 1\""),
        ("<plane/>", "line 2: link 'l0' has no shape in <geometry>"),
    ] {
        let text = robot_of(&[collision(geometry)]);
        let error = link_shapes(&text).unwrap_err().to_string();
        assert!(error.starts_with(message), "{error}");
        assert!(opspace_model::Model::from_urdf(&text).is_ok());
    }
    let none = robot_of(&["<collision/>".to_owned()]);
    assert!(link_shapes(&none).unwrap_err().to_string().starts_with("line 2: link 'l0' has no <geometry>"));
}
