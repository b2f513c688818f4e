//! Robots as URDF.

use crate::edits::{apply_to_text, edited};
use crate::inputs::for_each_input;
use crate::limits::Target;
use crate::messages::{check_error, check_model};
use crate::states::{Sample, evaluate};
use crate::{CORPUS, text, texts};
use opspace_experiment::Source;
use opspace_experiment::files::robot::load_urdf;
use opspace_model::collision::{
    CollisionData, CollisionError, CollisionModel, collision_distances, generate_capsules,
};
use opspace_model::urdf::link_shapes;
use opspace_model::{Data, Model, UrdfOptions, forward_kinematics, model_warnings, neutral};
use opspace_setup::robot_template::{NewRobot, robot_toml};

/// Most memory for one file, bytes.
const MOST_BYTES: usize = 64 << 20;

/// Largest difference between the masses that two readers find, relative.
const ROUNDING: f64 = 1e-9;

/// An error names the file and an existing line. The model of an accepted file has finite numbers, orthonormal
/// rotations and unique names; its quantities at rest are finite or refused with a reason; its template of a robot.toml
/// is TOML; the capsules of its links are valid, and their distances finite. Compared: the numbers of joints and frames
/// and the mass, and those of a robot that the crate `urdf-rs` has read.
#[test]
#[ignore = "a fuzz target, which runs for a minute or longer: .ci/run fuzz"]
fn urdf() {
    let mut seeds: Vec<String> = ["asimo-arm", "panda", "planar-2-link", "ur5e"]
        .map(|name| text(&format!("robots/{name}/{name}.urdf")))
        .into();
    seeds.extend(texts(CORPUS, ".urdf"));
    let target = Target::new("urdf", MOST_BYTES);
    for_each_input(edited(seeds.len()), 800, |(seed, edits)| {
        let text = apply_to_text(&seeds, *seed, edits);
        target.check(text.as_bytes(), edits.is_empty(), || {
            let read = [(false, false), (true, false), (false, true), (true, true)].map(
                |(floating_base, enforce_mimic)| {
                    reads(&text, UrdfOptions { floating_base, enforce_mimic, ..UrdfOptions::default() })
                },
            );
            read[0]
        });
    });
}

/// Reads a URDF, and returns true if it is accepted.
fn reads(text: &str, options: UrdfOptions) -> bool {
    let source = Source::new("robot.urdf", text);
    let parsed = match load_urdf(&source, options) {
        Ok(parsed) => parsed,
        Err(error) => {
            check_error(&error, &["robot.urdf"]);
            return false;
        }
    };
    let model = &parsed.model;
    check_model(model);
    assert_eq!(model.is_floating(), options.floating_base);
    assert!(parsed.standing_kg.is_finite() && parsed.standing_kg >= 0.0);
    assert!(parsed.warnings.iter().all(|warning| !warning.to_string().is_empty()));
    assert!(model_warnings(model).iter().all(|warning| !warning.to_string().is_empty()));
    check_quantities(model);
    if options == UrdfOptions::default() {
        let robot = NewRobot {
            urdf: "robot.urdf",
            used: None,
            mount: None,
            enforce_mimic: false,
            locked_joints: &[],
            model,
            stated: &[],
            bodies: &[],
        };
        let template = robot_toml(&robot);
        assert!(template.parse::<toml::Table>().is_ok(), "the template is not TOML: {template}");
        check_capsules(text, model);
    }
    if let Ok(robot) = urdf_rs::read_from_string(text)
        && let Ok(other) = Model::from_urdf_rs(&robot, options)
    {
        assert_eq!((other.model.n(), other.model.frames().len()), (model.n(), model.frames().len()));
        let (one, other) =
            (model.total_mass() + parsed.standing_kg, other.model.total_mass() + other.standing_kg);
        assert!((one - other).abs() <= ROUNDING * one.max(other), "{one} kg, urdf-rs {other} kg");
    }
    true
}

/// Checks the quantities of the robot at rest, at positions of zero.
fn check_quantities(model: &Model) {
    let Some(tip) = model.frames().last().and_then(|frame| model.frame_id(&frame.name).ok()) else { return };
    let n = model.n();
    let mut q = vec![0.0; model.nq()];
    if model.is_floating() {
        q[6] = 1.0;
    }
    let sample = Sample {
        q,
        dq: vec![0.0; n],
        ddq: vec![0.0; n],
        tau_in: vec![0.0; n],
        f_tip: vec![0.0; 6],
        task_rows: vec![0, 1, 2],
    };
    match evaluate(model, tip, &sample) {
        Ok(quantities) => {
            let lists = [
                &quantities.mass_matrix,
                &quantities.gravity,
                &quantities.tip_position,
                &quantities.tip_rotation,
            ];
            assert!(lists.into_iter().flatten().all(|x| x.is_finite()), "{quantities:?}");
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

/// Checks the capsules of the links, and their distances at the neutral position. Shapes may be refused though the
/// model is accepted, and capsules that are farther away than any robot is large.
fn check_capsules(text: &str, model: &Model) {
    let links = match link_shapes(text) {
        Ok(links) => links,
        Err(error) => {
            let lines = text.split('\n').count() as u64;
            assert!(error.line().is_none_or(|line| (1..=lines).contains(&line.into())), "{error}");
            return;
        }
    };
    // Only names with file:// are found, and none of the seeds has one.
    let Ok(generated) = generate_capsules(&links, None) else { return };
    assert!(generated.warnings.iter().all(|warning| !warning.to_string().is_empty()));
    let collision = match CollisionModel::new(model, &generated.capsules) {
        Ok(collision) => collision,
        Err(error) => return assert!(matches!(error, CollisionError::BadNumber { .. }), "{error}"),
    };
    let (mut data, mut near) = (Data::new(model), CollisionData::new(&collision));
    forward_kinematics(model, &mut data, &neutral(model));
    collision_distances(&collision, model, &data, f64::INFINITY, &mut near);
    for row in &near.proximity {
        assert!(row.is_some_and(|row| row.distance_m.is_finite() && row.normal.norm() > 0.9), "{row:?}");
    }
}
