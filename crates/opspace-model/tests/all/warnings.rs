//! Warnings about unusual values: valid bodies and robots, and the same models with typical errors.
#![expect(clippy::unwrap_used, reason = "a test")]

use nalgebra::{Matrix3, Vector3};
use opspace_model::{
    Inertia, Joint, JointKind, Limits, Model, ModelWarning, Placement, UrdfOptions, model_warnings,
};
use std::f64::consts::PI;
use std::fs;

const PROJECT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
/// Relative tolerance of densities and moments that are converted to each other and back.
const TOLERANCE: f64 = 1e-12;
const LIMITS: Limits = Limits { lower: -2.0, upper: 2.0, velocity: 3.0, effort: 40.0 };

fn robot(path: &str, options: UrdfOptions) -> Model {
    let text = fs::read_to_string(format!("{PROJECT}/{path}")).unwrap();
    Model::from_urdf_with(&text, options).unwrap().model
}

fn oracle(name: &str) -> Model {
    robot(&format!("tests/oracles/pinocchio/urdf/{name}.urdf"), UrdfOptions::default())
}

fn joint(kind: JointKind, limits: Limits) -> Joint {
    Joint { name: "hinge".into(), kind, limits }
}

/// A body on a hinge, with its centre of mass on the joint axis.
fn body(inertia: Inertia) -> Model {
    let mut model = Model::new("one");
    let on = model.add_body(None, Placement::identity(), joint(JointKind::Revolute, LIMITS), inertia);
    model.add_frame("link", Some(on), Placement::identity());
    model
}

/// A uniform ellipsoid with semi-axes in m: its moments are m/5 (b² + c²) and so on.
fn ellipsoid(density: f64, [a, b, c]: [f64; 3]) -> Inertia {
    let mass = density * 4.0 / 3.0 * PI * a * b * c;
    let moments = Vector3::new(b * b + c * c, a * a + c * c, a * a + b * b) * (mass / 5.0);
    Inertia { mass, com: Vector3::zeros(), rotational: Matrix3::from_diagonal(&moments) }
}

fn texts(model: &Model) -> Vec<String> {
    model_warnings(model).iter().map(ToString::to_string).collect()
}

/// Checks robots with measured or CAD data, of this project and of Pinocchio's set, with a fixed and a floating base.
#[test]
fn sound_robots_have_no_warnings() {
    let ours = ["asimo-arm", "panda", "planar-2-link", "ur5e"].map(|r| format!("robots/{r}/{r}.urdf"));
    let theirs = ["allegro_right_hand", "anymal_c", "g1_29dof", "kinova_j2s6s200", "panda", "xarm7_turned"]
        .map(|r| format!("tests/oracles/pinocchio/urdf/{r}.urdf"));
    for path in ours.iter().chain(&theirs) {
        for floating_base in [false, true] {
            for enforce_mimic in [false, true] {
                let model =
                    robot(path, UrdfOptions { floating_base, enforce_mimic, ..UrdfOptions::default() });
                assert_eq!(texts(&model), [""; 0], "{path}");
            }
        }
    }
}

/// Checks known errors: the wrists of the UR5 have the moments of cylinders of 0.6 m radius; the palms of the PR2, of
/// 0.6 kg, have those of a ball of 0.4 m diameter. The two robots have no other warnings.
#[test]
fn known_errors_in_published_robots_are_found() {
    let parts = |model: &Model| -> Vec<String> {
        let part = |s: ModelWarning| match s {
            ModelWarning::LargeInertia { part, .. } => part,
            other => panic!("{other}"),
        };
        model_warnings(model).into_iter().map(part).collect()
    };
    let fixed = "with the links fixed to it";
    let wrists = ["link 'wrist_1_link'", "link 'wrist_2_link'", &format!("link 'wrist_3_link' {fixed}")];
    assert_eq!(parts(&oracle("ur5")), wrists);
    let palms = ["l", "r"].map(|side| format!("link '{side}_wrist_roll_link' {fixed}"));
    assert_eq!(parts(&oracle("pr2")), palms);
    // The placeholder inertia of the root matters only on a floating base.
    let path = "tests/oracles/pinocchio/urdf/double_pendulum.urdf";
    let floating = robot(path, UrdfOptions { floating_base: true, ..UrdfOptions::default() });
    assert_eq!(parts(&floating), ["link 'base_link'"]);
    assert_eq!(texts(&oracle("double_pendulum")), [""; 0], "the reader has said that its limits are zero");
}

/// Name of an error, its effect on a body, and the check of its warning.
type Slip = (&'static str, fn(Inertia) -> Inertia, fn(&ModelWarning) -> bool);

/// Checks that each typical error in each body of two valid robots is reported for that body.
#[test]
fn typical_errors_in_any_body_are_found() {
    let slips: [Slip; 5] = [
        (
            "centre in mm",
            |i| Inertia { com: i.com * 1e3, ..i },
            |s| matches!(s, ModelWarning::FarCentre { .. }),
        ),
        (
            "moments a thousandth",
            |i| Inertia { rotational: i.rotational * 1e-3, ..i },
            |s| matches!(s, ModelWarning::SmallInertia { .. }),
        ),
        (
            "moments in kg mm²",
            |i| Inertia { rotational: i.rotational * 1e6, ..i },
            |s| matches!(s, ModelWarning::LargeInertia { .. }),
        ),
        (
            "mass in g",
            |i| Inertia { mass: i.mass * 1e3, ..i },
            |s| matches!(s, ModelWarning::SmallInertia { .. }),
        ),
        (
            "mass in tonnes",
            |i| Inertia { mass: i.mass * 1e-3, ..i },
            |s| matches!(s, ModelWarning::LargeInertia { .. } | ModelWarning::UnequalMasses { .. }),
        ),
    ];
    for path in ["robots/panda/panda.urdf", "robots/ur5e/ur5e.urdf"] {
        let good = robot(path, UrdfOptions::default());
        for number in 0..good.bodies().len() {
            let link = &good.frames().iter().find(|f| f.body == Some(number)).unwrap().name;
            for (what, slip, is_it) in slips {
                let mut model = good.clone();
                model.set_inertia(number, slip(good.bodies()[number].inertia));
                let said = model_warnings(&model);
                let found = said.iter().any(|s| is_it(s) && s.to_string().contains(&format!("'{link}'")));
                assert!(found, "{path}, {link}, {what}: {said:?}");
            }
        }
    }
}

/// Compared: the reported density, and that of the solid from which the moments were computed; the threshold, and
/// densities just below and above it.
#[test]
fn too_low_density_is_reported() {
    for axes in [[0.1, 0.1, 0.1], [0.3, 0.05, 0.04], [0.2, 0.02, 0.3]] {
        let found = model_warnings(&body(ellipsoid(29.9, axes)));
        let [ModelWarning::LargeInertia { density, .. }] = found[..] else { panic!("{found:?}") };
        assert!((density / 29.9 - 1.0).abs() < TOLERANCE, "{density}");
        assert_eq!(texts(&body(ellipsoid(30.1, axes))), [""; 0]);
    }
    // The placeholder of many files is far below the threshold, not just below it.
    let placeholder = Inertia { mass: 5.0, com: Vector3::zeros(), rotational: Matrix3::identity() };
    let said = texts(&body(placeholder));
    assert!(
        said[0].contains("link 'link': its principal moments 1.00, 1.00, 1.00 kg m² with 5.00 kg"),
        "{said:?}"
    );
    assert!(said[0].contains("a solid of 3.38 kg/m³"), "{said:?}");
}

#[test]
fn too_high_density_is_reported() {
    for radius in [1e-3, 0.01, 0.1] {
        assert_eq!(texts(&body(ellipsoid(22_500.0, [radius; 3]))), [""; 0]);
        let found = model_warnings(&body(ellipsoid(22_700.0, [radius; 3])));
        assert!(matches!(found[..], [ModelWarning::SmallInertia { .. }]), "{found:?}");
        // A thin rod of the same metal has larger moments about its other axes, however thin it is.
        assert_eq!(texts(&body(ellipsoid(22_500.0, [radius / 1e3, radius / 1e3, radius]))), [""; 0]);
    }
    let point = Inertia { mass: 2.0, com: Vector3::zeros(), rotational: Matrix3::zeros() };
    let said = texts(&body(point));
    assert_eq!(said.len(), 1);
    assert!(
        said[0].contains("moment is 0 kg m²; a solid osmium sphere of its mass, 2.00 kg, has 0.000612:"),
        "{said:?}"
    );
}

#[test]
fn distant_centre_of_mass_is_reported() {
    let ball = ellipsoid(2700.0, [0.05; 3]);
    let radius = 0.05 * 0.4_f64.sqrt();
    let at = |radii: f64| body(Inertia { com: Vector3::new(0.0, radii * radius, 0.0), ..ball });
    assert_eq!(texts(&at(5.9)), [""; 0]);
    let found = model_warnings(&at(6.1));
    let [ModelWarning::FarCentre { distance_m, radius_m, .. }] = found[..] else { panic!("{found:?}") };
    assert!((distance_m - 6.1 * radius).abs() < TOLERANCE && (radius_m - radius).abs() < TOLERANCE);
    assert!(
        found[0]
            .to_string()
            .contains("is 0.193 m from its frame, 6 times its radius of gyration of 0.0316 m")
    );
    // A pendulum bob: a frame or the next joint shows that the link extends so far.
    let mut framed = at(20.0);
    framed.add_frame("bob", Some(0), Placement::from_rpy([0.0; 3], [0.0, 21.0 * radius, 0.0]));
    assert_eq!(texts(&framed), [""; 0]);
    let mut jointed = at(20.0);
    let next = Placement::from_rpy([0.0; 3], [0.0, 21.0 * radius, 0.0]);
    jointed.add_body(Some(0), next, joint(JointKind::Revolute, LIMITS), ball);
    assert_eq!(texts(&jointed), [""; 0]);
}

#[test]
fn extreme_mass_ratio_of_neighbours_is_reported() {
    let pair = |ratio: f64, light_first: bool| {
        let heavy = ellipsoid(2700.0, [0.1; 3]);
        // Of the same density: every length is smaller by the cube root of the ratio.
        let light = ellipsoid(2700.0, [0.1 / ratio.cbrt(); 3]);
        let (first, second) = if light_first { (light, heavy) } else { (heavy, light) };
        let mut model = body(first);
        let on = model.add_body(Some(0), Placement::identity(), joint(JointKind::Revolute, LIMITS), second);
        model.add_frame("next", Some(on), Placement::identity());
        model
    };
    for (light_first, light, heavy) in [(false, "next", "link"), (true, "link", "next")] {
        assert_eq!(texts(&pair(990.0, light_first)), [""; 0]);
        let said = texts(&pair(1010.0, light_first));
        assert_eq!(said.len(), 1);
        let words = format!("link '{heavy}' has 11.3 kg and the adjacent link '{light}' 0.0112 kg");
        assert!(said[0].contains(&words), "{said:?}");
    }
}

/// Checks that each missing limit is reported once for all joints; a floating base needs no limits.
#[test]
fn joints_without_limits_are_named() {
    let ball = ellipsoid(2700.0, [0.1; 3]);
    let mut model = Model::floating("free", ball);
    let limits = [
        ("a", LIMITS),
        ("b", Limits { effort: f64::INFINITY, ..LIMITS }),
        ("c", Limits { effort: f64::INFINITY, velocity: f64::INFINITY, ..LIMITS }),
        ("d", Limits { effort: 0.0, velocity: 0.0, ..LIMITS }),
    ];
    for (name, limits) in limits {
        let joint = Joint { name: name.into(), kind: JointKind::Revolute, limits };
        model.add_body(None, Placement::identity(), joint, ball);
    }
    let none = |joints: &[&str], limit| ModelWarning::NoLimit {
        joints: joints.iter().map(|&j| j.to_owned()).collect(),
        limit,
    };
    assert_eq!(model_warnings(&model), [none(&["c"], "velocity"), none(&["b", "c"], "effort")]);
    assert!(texts(&model)[0].starts_with("joint 'c': no velocity limit"), "{:?}", texts(&model));
    assert!(texts(&model)[1].starts_with("joints 'b', 'c': no effort limit"), "{:?}", texts(&model));
}

#[test]
fn implausible_joint_range_is_reported() {
    let of = |kind, lower, upper| {
        let mut model = Model::new("one");
        let joint = joint(kind, Limits { lower, upper, ..LIMITS });
        model.add_body(None, Placement::identity(), joint, ellipsoid(2700.0, [0.1; 3]));
        texts(&model)
    };
    assert_eq!(of(JointKind::Revolute, -15.0, 15.0), [""; 0]);
    assert_eq!(of(JointKind::Prismatic, 0.0, 15.0), [""; 0]);
    assert_eq!(of(JointKind::Continuous, -1e9, 1e9), [""; 0]);
    assert_eq!(of(JointKind::Revolute, f64::NEG_INFINITY, f64::INFINITY), [""; 0]);
    let degrees = of(JointKind::Revolute, -170.0, 170.0);
    assert!(degrees[0].contains("'hinge': its range from -170 to 170 rad") && degrees[0].contains("degrees"));
    let millimetres = of(JointKind::Prismatic, 0.0, 40.0);
    assert!(
        millimetres[0].contains("from 0 to 40.0 m is") && millimetres[0].contains("mm"),
        "{millimetres:?}"
    );
    // The range is so wide that the difference of its limits is infinite.
    assert_eq!(of(JointKind::Revolute, f64::MIN, f64::MAX).len(), 1);
}
