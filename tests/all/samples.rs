//! Tests of `samples`: refused inputs, tasks without a result, and JSON keys.
#![expect(clippy::unwrap_used, reason = "a test")]

use opspace_cli::samples::{Quantities, Sample, SampleError, evaluate};
use opspace_model::{FrameId, Model, UrdfOptions};
use opspace_testing::oracle::urdf;

fn robot(name: &str, tip: &str) -> (Model, FrameId) {
    let model = Model::from_urdf(&urdf(name)).unwrap().model;
    let tip = model.frame_id(tip).unwrap();
    (model, tip)
}

fn at(q: &[f64], task_rows: &[usize]) -> Sample {
    let n = q.len();
    Sample {
        q: q.to_vec(),
        dq: vec![0.1; n],
        ddq: vec![-0.3; n],
        tau_in: vec![1.0; n],
        f_tip: vec![1.0, 2.0, 3.0, 0.1, 0.2, 0.3],
        task_rows: task_rows.to_vec(),
    }
}

const ALL: [usize; 6] = [0, 1, 2, 3, 4, 5];
const BENT: [f64; 6] = [0.3, -1.2, 1.4, -0.7, 0.9, 0.2];

/// Evaluates the UR5 at [`BENT`] with one joint at `angle`.
fn ur5_with(joint: usize, angle: f64) -> Quantities {
    let (model, tip) = robot("ur5", "tool0");
    let mut q = BENT;
    q[joint] = angle;
    evaluate(&model, tip, &at(&q, &ALL)).unwrap()
}

fn has_task(quantities: &Quantities) -> bool {
    let Quantities { task_inertia, dynamically_consistent_inverse, nullspace, .. } = quantities;
    let has = [task_inertia.is_some(), dynamically_consistent_inverse.is_some(), nullspace.is_some()];
    assert!(has.iter().all(|&h| h == has[0]), "all three or none");
    has[0]
}

/// Checks that a singular pose (UR5 with straight elbow or parallel wrist axes) has no task quantities, and that a pose
/// close to it has.
#[test]
fn singular_pose_has_no_task_quantities() {
    for joint in [2, 4] {
        assert!(!has_task(&ur5_with(joint, 0.0)));
        assert!(has_task(&ur5_with(joint, 1e-3)));
    }
}

#[test]
fn more_rows_than_joints_have_no_task_quantities() {
    let (model, tip) = robot("double_pendulum", "link3");
    let evaluated = |rows: &[usize]| evaluate(&model, tip, &at(&[0.4, 0.9], rows)).unwrap();
    assert!(!has_task(&evaluated(&ALL)));
    assert!(has_task(&evaluated(&[1, 2])));
    // The pendulum moves in the y-z plane: the row of x is zero.
    assert!(!has_task(&evaluated(&[0])));
    assert!(!has_task(&evaluated(&[0, 2])));
    let json = serde_json::to_value(evaluated(&ALL)).unwrap();
    assert!(json["Lambda"].is_null() && json["Jbar"].is_null() && json["N"].is_null());
}

/// Compared: the null-space projector of a task without rows, and the identity.
#[test]
fn empty_task_has_identity_nullspace() {
    let (model, tip) = robot("double_pendulum", "link3");
    let quantities = evaluate(&model, tip, &at(&[0.4, 0.9], &[])).unwrap();
    assert_eq!(quantities.task_inertia, Some(vec![]));
    assert_eq!(quantities.nullspace, Some(vec![1.0, 0.0, 0.0, 1.0]));
}

/// Compared: Λ for task rows in another order, and Λ with its rows and columns in that order.
#[test]
fn task_rows_accept_any_order() {
    let (model, tip) = robot("ur5", "tool0");
    let inertia = |rows: &[usize]| evaluate(&model, tip, &at(&BENT, rows)).unwrap().task_inertia.unwrap();
    let (ordered, swapped) = (inertia(&[1, 4]), inertia(&[4, 1]));
    for (i, j) in [(0, 3), (1, 2), (2, 1), (3, 0)] {
        assert!((ordered[i] - swapped[j]).abs() < 1e-12 * ordered[0].abs());
    }
}

#[test]
fn json_keys_match_contract() {
    let (model, tip) = robot("ur5", "tool0");
    let json = serde_json::to_value(evaluate(&model, tip, &at(&BENT, &ALL)).unwrap()).unwrap();
    let keys: Vec<&str> = json.as_object().unwrap().keys().map(String::as_str).collect();
    let mut expected = [
        "tip_R",
        "tip_p",
        "tip_vel",
        "J",
        "Jdot_dq",
        "M",
        "g",
        "nle",
        "C",
        "tau_rnea",
        "ddq_aba",
        "tau_rnea_fext",
        "ddq_aba_fext",
        "com",
        "kinetic_energy",
        "potential_energy",
        "Lambda",
        "Jbar",
        "N",
    ];
    let mut keys = keys;
    keys.sort_unstable();
    expected.sort_unstable();
    assert_eq!(keys, expected);
}

/// Compared: quantities read back from JSON, and the original ones, bit by bit.
#[test]
fn quantities_round_trip_through_json() {
    let (model, tip) = robot("ur5", "tool0");
    let quantities = evaluate(&model, tip, &at(&BENT, &ALL)).unwrap();
    let text = serde_json::to_string(&quantities).unwrap();
    assert_eq!(serde_json::from_str::<Quantities>(&text).unwrap(), quantities);
}

#[test]
fn default_task_has_six_rows() {
    let text = r#"{"q":[0],"dq":[0],"ddq":[0],"tau_in":[0],"f_tip":[0,0,0,0,0,0]}"#;
    assert_eq!(serde_json::from_str::<Sample>(text).unwrap().task_rows, ALL);
}

fn refused(change: impl FnOnce(&mut Sample), words: &str) {
    let (model, tip) = robot("ur5", "tool0");
    let mut sample = at(&BENT, &ALL);
    change(&mut sample);
    let said = evaluate(&model, tip, &sample).unwrap_err().to_string();
    assert!(said.contains(words), "\"{said}\" doesn't say \"{words}\"");
}

#[test]
fn wrong_lengths_are_refused_by_key() {
    refused(|s| s.q.truncate(5), "`q` has 5 numbers; it needs 6");
    refused(|s| s.dq.push(0.0), "`dq` has 7 numbers; it needs 6");
    refused(|s| s.ddq.clear(), "`ddq` has 0 numbers; it needs 6");
    refused(|s| s.tau_in.truncate(1), "`tau_in` has 1 numbers; it needs 6");
    refused(|s| s.f_tip.truncate(3), "`f_tip` has 3 numbers; it needs 6");
}

#[test]
fn non_finite_numbers_are_refused_by_index() {
    refused(|s| s.q[2] = f64::NAN, "`q`[2] is NaN");
    refused(|s| s.tau_in[5] = f64::INFINITY, "`tau_in`[5] is inf");
    refused(|s| s.f_tip[0] = f64::NEG_INFINITY, "`f_tip`[0] is -inf");
}

#[test]
fn invalid_or_repeated_task_rows_are_refused() {
    refused(|s| s.task_rows = vec![0, 6], "`task_rows` has 6; the rows are 0 1 2");
    refused(|s| s.task_rows = vec![1, 2, 1], "`task_rows` has 1 more than once");
}

/// Checks that a point mass on its own joint axis is refused: its acceleration would be infinite.
#[test]
fn singular_mass_matrix_is_refused() {
    let urdf = r#"<robot name="dot"><link name="base"/><link name="dot"><inertial><mass value="1"/>
        <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>
        <joint name="spin" type="continuous"><parent link="base"/><child link="dot"/></joint></robot>"#;
    let model = Model::from_urdf(urdf).unwrap().model;
    let tip = model.frame_id("dot").unwrap();
    assert_eq!(evaluate(&model, tip, &at(&[0.0], &[3])), Err(SampleError::SingularMassMatrix));
}

/// Checks that states whose numbers overflow are refused and never give NaN.
#[test]
fn overflowing_states_are_refused() {
    let (model, tip) = robot("ur5", "tool0");
    let good = at(&BENT, &ALL);
    let refused = |sample: &Sample| evaluate(&model, tip, sample).unwrap_err();
    assert_eq!(refused(&Sample { dq: vec![1e200; 6], ..good.clone() }), SampleError::Overflow);
    assert_eq!(refused(&Sample { tau_in: vec![f64::MAX; 6], ..good.clone() }), SampleError::Overflow);
    let q = vec![0.3, 2e6, 1.4, -0.7, 0.9, 0.2];
    let turned = SampleError::Turned { joint: "shoulder_lift_joint".to_owned(), angle: 2e6 };
    assert_eq!(refused(&Sample { q, ..good }), turned);
}

/// Checks that a floating base so far away that its centre of mass or its energy overflows is refused.
#[test]
fn overflowing_positions_are_refused() {
    let options = UrdfOptions { floating_base: true, ..UrdfOptions::default() };
    let model = Model::from_urdf_with(&urdf("ur5"), options).unwrap().model;
    let tip = model.frame_id("tool0").unwrap();
    for axis in 0..3 {
        let mut q = [0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0, 0.3, -1.2, 1.4, -0.7, 0.9, 0.2].to_vec();
        q[axis] = 1e308;
        let sample = Sample { q, ..at(&[0.1; 12], &ALL) };
        assert_eq!(evaluate(&model, tip, &sample), Err(SampleError::Overflow), "axis {axis}");
    }
}

/// Checks that a quaternion of a floating base that is not of unit length is refused.
#[test]
fn non_unit_quaternion_is_refused() {
    let options = UrdfOptions { floating_base: true, ..UrdfOptions::default() };
    let model = Model::from_urdf_with(&urdf("ur5"), options).unwrap().model;
    let tip = model.frame_id("tool0").unwrap();
    let sample = |w: f64| {
        let q = [0.1, 0.2, 0.3, 0.0, 0.0, 0.0, w, 0.3, -1.2, 1.4, -0.7, 0.9, 0.2].to_vec();
        Sample { q, ..at(&[0.1; 12], &ALL) }
    };
    assert!(evaluate(&model, tip, &sample(-1.0)).is_ok());
    assert_eq!(evaluate(&model, tip, &sample(5.0)), Err(SampleError::Quaternion { length: 5.0 }));
    assert_eq!(evaluate(&model, tip, &sample(0.0)), Err(SampleError::Quaternion { length: 0.0 }));
}
