//! Floating bases: configuration space, and motion without external forces.
//!
//! Identities that hold for every tree are tested in `identities.rs` and `trees.rs`, also with floating bases.
#![expect(clippy::unwrap_used, reason = "a test")]

use crate::common::{
    Case, DIFFERENCE, INVERSE, ROUNDING, STEP, close, close_placement, config, evaluated, fixed, floating,
    inertia, jacobian, moved, placement, plus, triple, vector,
};
use nalgebra::{DMatrix, Matrix3, Matrix4, Quaternion, UnitQuaternion, Vector3};
use opspace_model::{
    Data, Inertia, Joint, JointKind, Limits, Model, Placement, UrdfErrorKind, UrdfOptions, aba,
    center_of_mass, centroidal_momentum, crba, difference, forward_kinematics, frame_placement, integrate,
    kinematics, local_jacobian, local_jacobian_rate, neutral, rnea,
};
use proptest::prelude::*;
use std::f64::consts::PI;

/// Returns q for a base at a placement, followed by the joint positions.
fn at(base: &Placement, joints: &[f64]) -> Vec<f64> {
    let rotation = UnitQuaternion::from_matrix(&base.rotation);
    [base.translation.as_slice(), rotation.coords.as_slice(), joints].concat()
}

fn base_of(q: &[f64]) -> Placement {
    let rotation = UnitQuaternion::new_normalize(Quaternion::new(q[6], q[3], q[4], q[5]));
    Placement {
        rotation: rotation.to_rotation_matrix().into_inner(),
        translation: Vector3::from_column_slice(&q[..3]),
    }
}

fn homogeneous(p: &Placement) -> Matrix4<f64> {
    let mut out = p.rotation.to_homogeneous();
    out.fixed_view_mut::<3, 1>(0, 3).copy_from(&p.translation);
    out
}

fn direction() -> impl Strategy<Value = Vector3<f64>> {
    triple(1.0)
        .prop_filter("a direction", |x| Vector3::from(*x).norm() > 0.1)
        .prop_map(|x| Vector3::from(x).normalize())
}

/// Angles at which formulas change or lose digits, and angles in between.
fn angle() -> impl Strategy<Value = f64> {
    prop_oneof![
        Just(0.0),
        Just(1e-12),
        Just(1e-9),
        Just(1e-5),
        Just(0.999e-2),
        Just(1.001e-2),
        0.0..3.1,
        Just(PI - 1e-3),
        Just(PI - 1e-6),
        Just(PI - 1e-9),
    ]
}

/// Returns the momentum about the centre of mass, linear part first.
fn momentum(case: &Case) -> Vec<f64> {
    let momentum = centroidal_momentum(&case.model, &case.evaluated());
    momentum.linear.iter().chain(&momentum.angular).copied().collect()
}

proptest! {
    #![proptest_config(config(192))]

    /// Compared: inverse dynamics of the motion under joint torques alone, and these torques. No force or torque acts
    /// on the base.
    #[test]
    fn floating_base_is_unactuated(case in floating()) {
        let mut tau = case.tau.clone();
        tau[..6].fill(0.0);
        let mut data = case.evaluated();
        aba(&case.model, &mut data, &tau);
        let ddq = data.ddq.as_slice().to_vec();
        rnea(&case.model, &mut data, &ddq);
        close(&data.torque.as_slice()[..6], &[0.0; 6], INVERSE)?;
        close(&data.torque.as_slice()[6..], &tau[6..], INVERSE)?;
    }

    /// Compared: the rate of the centroidal momentum under joint torques, by central differences, and the weight. Joint
    /// torques do not change the momentum.
    #[test]
    fn only_gravity_changes_momentum(case in floating()) {
        let mut tau = case.tau.clone();
        tau[..6].fill(0.0);
        let mut data = case.evaluated();
        aba(&case.model, &mut data, &tau);
        let ddq = data.ddq.as_slice().to_vec();
        let step = STEP / data.ddq.amax().max(1.0).sqrt();
        let after = |t: f64| momentum(&Case {
            q: moved(&case.model, &case.q, &plus(&case.dq, &ddq, 0.5 * t), t),
            dq: plus(&case.dq, &ddq, t),
            ..case.clone()
        });
        let rate = (vector(&after(step)) - vector(&after(-step))) / (2.0 * step);
        let weight = case.model.gravity() * case.model.total_mass();
        close(&rate, weight.iter().chain(&[0.0; 3]), DIFFERENCE * STEP / step)?;
    }

    /// Compared: accelerations of a robot at rest without torques, and free fall. The base accelerates with gravity,
    /// the joints do not move.
    #[test]
    fn robot_at_rest_falls_freely(case in floating()) {
        let still = vec![0.0; case.model.n()];
        let mut data = evaluated(&case.model, &case.q, &still);
        aba(&case.model, &mut data, &still);
        let axes = data.placement[5].rotation;
        close(&data.ddq.as_slice()[..3], &(axes.transpose() * case.model.gravity()), INVERSE)?;
        close(&data.ddq.as_slice()[3..], &still[3..], INVERSE)?;
    }

    /// Compared: a robot that is moved by its q and rotated together with gravity, and the original robot.
    #[test]
    fn torques_are_independent_of_base_pose(case in floating(), world in placement()) {
        let model = case.model.clone().with_base(Placement::identity());
        let joints = &case.q[7..];
        let base = base_of(&case.q);
        let there = model.clone().with_gravity(world.rotation * model.gravity());
        let (mut a, mut b) =
            (evaluated(&model, &case.q, &case.dq), evaluated(&there, &at(&(world * base), joints), &case.dq));
        for (model, data) in [(&model, &mut a), (&there, &mut b)] {
            rnea(model, data, &case.ddq);
            aba(model, data, &case.tau);
        }
        close(&a.mass_matrix, &b.mass_matrix, ROUNDING)?;
        close(&a.coriolis_matrix, &b.coriolis_matrix, ROUNDING)?;
        close(&a.torque, &b.torque, ROUNDING)?;
        close(&a.ddq, &b.ddq, INVERSE)?;
        let expected = world * frame_placement(&model, &a, case.tip);
        close_placement(&frame_placement(&there, &b, case.tip), &expected, ROUNDING)?;
        let com = world.act_point(&center_of_mass(&model, &a).unwrap());
        close(&center_of_mass(&there, &b).unwrap(), &com, ROUNDING)?;
        // The same pose as the pose of the base frame, with neutral q.
        let stood = model.with_base(base);
        let mut neutral = neutral(&stood);
        neutral[7..].copy_from_slice(joints);
        let c = evaluated(&stood, &neutral, &case.dq);
        close(&a.mass_matrix, &c.mass_matrix, ROUNDING)?;
        close(&a.bias, &c.bias, ROUNDING)?;
    }

    /// Compared: a floating base at rest, and the same tree on a fixed base at the same pose. Joint quantities are
    /// equal.
    #[test]
    fn held_floating_base_equals_fixed_base(case in fixed(), root in inertia(), base in placement()) {
        // The same tree on a floating root.
        let mut model = Model::floating("tree", root).with_gravity(case.model.gravity());
        for (body, joint) in case.model.bodies().iter().zip(case.model.joints()) {
            model.add_body(body.parent.map(|p| p + 6), body.origin, joint.clone(), body.inertia);
        }
        let model = model.with_rotor_inertia(&[&[0.0; 6], case.model.rotor_inertia()].concat());
        let pad = |x: &[f64]| [&[0.0; 6], x].concat();
        let mut floats = evaluated(&model, &at(&base, &case.q), &pad(&case.dq));
        let stands = Case { model: case.model.clone().with_base(base), ..case };
        let mut data = stands.evaluated();
        let n = stands.model.n();
        close(floats.mass_matrix.view((6, 6), (n, n)).into_owned().iter(), &data.mass_matrix, ROUNDING)?;
        close(floats.coriolis_matrix.view((6, 6), (n, n)).into_owned().iter(), &data.coriolis_matrix, ROUNDING)?;
        close(&floats.gravity.as_slice()[6..], &data.gravity, ROUNDING)?;
        rnea(&model, &mut floats, &pad(&stands.ddq));
        rnea(&stands.model, &mut data, &stands.ddq);
        close(&floats.torque.as_slice()[6..], &data.torque, ROUNDING)?;
    }

    /// Compared: a floating body, and a body on three prismatic and three revolute joints without mass. M = Tᵀ M' T and
    /// τ = Tᵀ τ', where T is the Jacobian of that chain in body axes and q̈' = T q̈ + Ṫ q̇.
    #[test]
    fn floating_base_equals_six_joint_chain(
        case in fixed(),
        root in inertia(),
        state in prop::array::uniform6(-1.2..1.2f64),
    ) {
        let mut chain = Model::new("chain").with_gravity(case.model.gravity());
        // Axes x, y and z in turn: the z axis of each body is the x axis of the previous one.
        let turn = Placement::from_rpy([PI / 2.0, 0.0, PI / 2.0], [0.0; 3]);
        for i in 0..6_usize {
            let kind = if i < 3 { JointKind::Prismatic } else { JointKind::Continuous };
            let joint = Joint { name: format!("base{i}"), kind, limits: Limits::NONE };
            let inertia = if i == 5 { root } else { Inertia::zero() };
            chain.add_body(i.checked_sub(1), turn, joint, inertia);
        }
        let body = chain.add_frame("body", Some(5), Placement::identity());
        let mut free = Model::floating("body", root).with_gravity(case.model.gravity());
        for (body, joint) in case.model.bodies().iter().zip(case.model.joints()) {
            let parent = Some(body.parent.map_or(5, |p| p + 6));
            chain.add_body(parent, body.origin, joint.clone(), body.inertia);
            free.add_body(parent, body.origin, joint.clone(), body.inertia);
        }
        let n = chain.n();
        let (q, dq) = ([&state[..], &case.q].concat(), [&state.map(|x| 1.5 - x)[..], &case.dq].concat());
        let ddq = [&state.map(|x| 2.0 * x)[..], &case.ddq].concat();
        let mut a = Data::new(&chain);
        kinematics(&chain, &mut a, &q, &dq);
        crba(&chain, &mut a);
        rnea(&chain, &mut a, &ddq);

        let (mut map, mut map_rate) = (DMatrix::identity(n, n), DMatrix::zeros(n, n));
        let j = jacobian(n, |j| local_jacobian(&chain, &a, body, j));
        map.view_mut((0, 0), (6, n)).copy_from(&j);
        let j = jacobian(n, |j| local_jacobian_rate(&chain, &a, body, j));
        map_rate.view_mut((0, 0), (6, n)).copy_from(&j);
        let (v, acceleration) = (&map * vector(&dq), &map * vector(&ddq) + map_rate * vector(&dq));
        let mut b = evaluated(&free, &at(&frame_placement(&chain, &a, body), &case.q), v.as_slice());
        rnea(&free, &mut b, acceleration.as_slice());
        close(&a.mass_matrix, &(map.transpose() * &b.mass_matrix * &map), ROUNDING)?;
        close(&a.torque, &(map.transpose() * &b.torque), ROUNDING)?;
    }
}

proptest! {
    #![proptest_config(config(256))]

    /// Compared: an integration step of the base, and the matrix exponential of its twist (4 × 4); the norm of the
    /// quaternion, and 1.
    #[test]
    fn integration_step_is_twist_exponential(
        case in floating(),
        axis in direction(),
        angle in prop_oneof![angle(), 0.0..10.0f64],
    ) {
        let mut v = case.dq.clone();
        v[3..6].copy_from_slice((axis * angle).as_slice());
        let mut q = vec![f64::NAN; case.q.len()];
        integrate(&case.model, &case.q, &v, &mut q);
        let mut twist = Matrix4::zeros();
        twist.fixed_view_mut::<3, 3>(0, 0).copy_from(&(axis * angle).cross_matrix());
        twist.fixed_view_mut::<3, 1>(0, 3).copy_from_slice(&v[..3]);
        let expected = homogeneous(&base_of(&case.q)) * twist.exp();
        close(&homogeneous(&base_of(&q)), &expected, ROUNDING)?;
        close(&q[7..], &plus(&case.q[7..], &v[6..], 1.0), 0.0)?;
        close(&[vector(&q[3..7]).norm()], &[1.0], ROUNDING)?;
        // Two half steps reach the same pose as one step.
        let twice = moved(&case.model, &moved(&case.model, &case.q, &v, 0.5), &v, 0.5);
        close_placement(&base_of(&twice), &base_of(&q), ROUNDING)?;
    }

    /// Compared: (q ⊕ v) ⊖ q and v, for rotations up to π; `from` ⊕ (`to` ⊖ `from`) and `to`. Negating the quaternion
    /// of `to` makes no difference.
    #[test]
    fn difference_inverts_integrate(case in floating(), axis in direction(), angle in angle(), flip in any::<bool>()) {
        let model = &case.model;
        let mut v = case.dq.clone();
        v[3..6].copy_from_slice((axis * angle).as_slice());
        let mut to = moved(model, &case.q, &v, 1.0);
        if flip {
            to[3..7].iter_mut().for_each(|x| *x = -*x);
        }
        let mut back = vec![f64::NAN; model.n()];
        difference(model, &case.q, &to, &mut back);
        close(&back, &v, ROUNDING)?;
        let again = moved(model, &case.q, &back, 1.0);
        close_placement(&base_of(&again), &base_of(&to), ROUNDING)?;
        close(&again[7..], &to[7..], ROUNDING)?;
        // The reverse difference is the negative difference.
        let mut reverse = vec![f64::NAN; model.n()];
        difference(model, &to, &case.q, &mut reverse);
        close(&reverse, &(-vector(&back)), ROUNDING)?;
    }

    /// Compared: (q ⊕ v) ⊖ q and v, relative to v, for small rotations. No digits are lost.
    #[test]
    fn small_rotations_keep_their_precision(axis in direction(), small in -12.0..-2.0f64) {
        let model = Model::floating("box", Inertia { mass: 1.0, ..Inertia::zero() });
        let angular = axis * 10f64.powf(small);
        let start = neutral(&model);
        let v = [0.0, 0.0, 0.0, angular.x, angular.y, angular.z];
        let mut back = vec![f64::NAN; 6];
        difference(&model, &start, &moved(&model, &start, &v, 1.0), &mut back);
        let scaled = |v: &[f64]| v.iter().map(|x| x / angular.norm()).collect::<Vec<f64>>();
        close(&scaled(&back), &scaled(&v), ROUNDING)?;
    }

    /// Compared: differences after rotations beyond half a turn, and the shorter rotation, which leads to the same
    /// placement.
    #[test]
    fn difference_takes_shorter_rotation(axis in direction(), angle in 3.2..6.2f64, linear in triple(1.0)) {
        let model = Model::floating("box", Inertia { mass: 1.0, ..Inertia::zero() });
        let start = neutral(&model);
        let v = [&linear[..], (axis * angle).as_slice()].concat();
        let to = moved(&model, &start, &v, 1.0);
        let mut back = vec![f64::NAN; 6];
        difference(&model, &start, &to, &mut back);
        close(&back[3..], &(axis * (angle - 2.0 * PI)), ROUNDING)?;
        close_placement(&base_of(&moved(&model, &start, &back, 1.0)), &base_of(&to), ROUNDING)?;
    }

    /// Compared: a scaled and negated quaternion, and the normalized one.
    #[test]
    fn quaternion_length_and_sign_are_irrelevant(case in floating(), length in 0.5..2.0f64) {
        let mut scaled = case.q.clone();
        scaled[3..7].iter_mut().for_each(|x| *x *= -length);
        let place = |q: &[f64]| {
            let mut data = Data::new(&case.model);
            forward_kinematics(&case.model, &mut data, q);
            frame_placement(&case.model, &data, case.tip)
        };
        close_placement(&place(&scaled), &place(&case.q), ROUNDING)?;
        let still = vec![0.0; case.model.n()];
        let mut kept = vec![f64::NAN; case.q.len()];
        integrate(&case.model, &scaled, &still, &mut kept);
        close_placement(&base_of(&kept), &base_of(&case.q), ROUNDING)?;
        close(&[vector(&kept[3..7]).norm()], &[1.0], ROUNDING)?;
    }
}

/// Compared: integration on a fixed base, where q is a vector, and vector addition.
#[test]
fn fixed_base_integration_is_addition() {
    let mut model = Model::new("slider");
    let joint = Joint { name: "slide".into(), kind: JointKind::Continuous, limits: Limits::NONE };
    model.add_body(None, Placement::identity(), joint, Inertia::zero());
    let (mut to, mut v) = ([0.0], [0.0]);
    integrate(&model, &[3.0], &[4.0], &mut to);
    difference(&model, &[3.0], &to, &mut v);
    assert_eq!((to, v), ([7.0], [4.0]), "a continuous joint isn't wrapped");
    assert_eq!(neutral(&model), [0.0]);
}

/// A hopper with a trunk of two links fixed to each other, and a leg.
const HOPPER: &str = r#"<robot name="hopper">
  <link name="root"/>
  <link name="trunk"><inertial><origin xyz="0 0 0.1"/><mass value="5"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.3"/></inertial></link>
  <link name="leg"><inertial><origin xyz="0 0 -0.2"/><mass value="1"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.001"/></inertial></link>
  <joint name="weld" type="fixed"><parent link="root"/><child link="trunk"/>
    <origin xyz="0 0 0.5" rpy="0 0 1.5707963267948966"/></joint>
  <joint name="hip" type="continuous"><parent link="trunk"/><child link="leg"/><axis xyz="0 1 0"/></joint>
</robot>"#;

const FLOATING: UrdfOptions =
    UrdfOptions { floating_base: true, enforce_mimic: false, allow_massless: false };

/// Compared: the root body of a URDF with all links fixed to it, and its expected inertia. Its mass counts on a
/// floating base, but not on a fixed base.
#[test]
fn floating_urdf_root_has_mass() -> Result<(), TestCaseError> {
    let floats = Model::from_urdf_with(HOPPER, FLOATING).unwrap().model;
    let stands = Model::from_urdf(HOPPER).unwrap().model;
    assert_eq!((floats.total_mass(), stands.total_mass()), (6.0, 1.0));
    assert_eq!((floats.nq(), floats.n(), stands.n()), (8, 7, 1));
    assert!(floats.is_floating() && !stands.is_floating());
    let names: Vec<&str> = floats.joints().iter().map(|j| j.name.as_str()).collect();
    assert_eq!(names[..2], ["base.linear.x", "base.linear.y"]);
    assert_eq!(names[5..], ["base.angular.z", "hip"]);
    // The trunk is 0.5 m above the root, rotated by a quarter turn.
    let root = floats.bodies()[5].inertia;
    close(&root.com, &[0.0, 0.0, 0.6], ROUNDING)?;
    close(&root.rotational, &Matrix3::from_diagonal(&Vector3::new(0.2, 0.1, 0.3)), ROUNDING)?;
    let data = evaluated(&floats, &neutral(&floats), &[0.0; 7]);
    close(&data.gravity, &[0.0, 0.0, 6.0 * 9.81, 0.0, 0.0, 0.0, 0.0], ROUNDING)
}

/// Checks the error for a floating URDF without mass: it names the root and its line.
#[test]
fn floating_urdf_without_mass_is_refused() {
    let text = "<robot name=\"ghost\">\n  <link name=\"spirit\"/>\n</robot>";
    assert_eq!(Model::from_urdf(text).unwrap().model.n(), 0);
    let error = Model::from_urdf_with(text, FLOATING).unwrap_err();
    assert_eq!(error.kind(), &UrdfErrorKind::WeightlessBase { link: "spirit".into() });
    assert_eq!(
        error.to_string(),
        "line 2: no body on the floating base 'spirit' has mass; give its links <inertial>"
    );
}

/// Checks that frames added to any of the six bodies of a floating base are attached to the last one, which has the
/// velocity of the base.
#[test]
fn floating_base_frames_share_one_body() {
    let mut model = Model::floating("box", Inertia { mass: 1.0, ..Inertia::zero() });
    for body in [None, Some(0), Some(4), Some(5)] {
        let frame = model.add_frame("anywhere", body, Placement::identity());
        assert_eq!(model.frame(frame).body, Some(5));
    }
}

#[test]
#[should_panic = "body 5 is the floating base"]
fn first_five_floating_base_bodies_refuse_inertia() {
    let mut model = Model::floating("box", Inertia { mass: 1.0, ..Inertia::zero() });
    model.set_inertia(2, Inertia { mass: 1.0, ..Inertia::zero() });
}

const WHEEL: &str = r#"<robot name="cart">
<link name="cart"><inertial><mass value="2"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<link name="wheel"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<joint name="axle" type="continuous"><parent link="cart"/><child link="wheel"/></joint>
</robot>"#;

/// Checks that a coordinate of the floating base is refused as a leader, and that a joint of the URDF with the name of
/// such a coordinate is refused.
#[test]
fn floating_base_coordinates_are_no_mimic_leaders() {
    let follows =
        WHEEL.replace(r#"<child link="wheel"/>"#, r#"<child link="wheel"/><mimic joint="base.linear.x"/>"#);
    let options = UrdfOptions { enforce_mimic: true, ..FLOATING };
    assert_eq!(
        Model::from_urdf_with(&follows, options).unwrap_err().to_string(),
        "line 4: joint 'axle' mimics 'base.linear.x', which is not a moving joint; the moving joints are: axle"
    );
    let named = WHEEL.replace("axle", "base.angular.z");
    assert_eq!(
        Model::from_urdf_with(&named, FLOATING).unwrap_err().to_string(),
        "line 4: joint 'base.angular.z' has the name of a coordinate of the floating base; rename it"
    );
    assert!(Model::from_urdf(&named).is_ok(), "no floating base, no conflict");
}
