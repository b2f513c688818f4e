//! Random trees in random states, and comparisons of numbers.
//!
//! The trees have all kinds of joints, arbitrary axes, branches, rotors, mimic joints, a fixed base at any placement or
//! a floating base, and gravity in any direction.
#![allow(dead_code, reason = "each file of tests uses its part")]

use nalgebra::{DMatrix, DVector, Matrix3, Matrix6xX, UnitQuaternion, Vector3};
use opspace_model::{
    Data, Force, FrameId, Inertia, Joint, JointKind, Limits, MimicConstraint, Model, Motion, Placement,
    coriolis, integrate, update,
};
use proptest::prelude::*;
use proptest::sample::Index;
use proptest::test_runner::RngSeed;

/// Relative tolerance for rounding errors: some thousand roundings.
pub const ROUNDING: f64 = 1e-12;
/// Tolerance for results that need M⁻¹; the condition number of M seldom exceeds 1e5 here.
pub const INVERSE: f64 = 1e-11;
/// Tolerance for central differences with [`STEP`]: truncation error (of order STEP²) and cancellation error (of order
/// ε/STEP), with a margin.
pub const DIFFERENCE: f64 = 1e-7;
pub const STEP: f64 = 1e-5;

/// Configuration that generates the same cases every time and writes none to disk.
pub fn config(cases: u32) -> ProptestConfig {
    ProptestConfig {
        failure_persistence: None,
        rng_seed: RngSeed::Fixed(7),
        ..ProptestConfig::with_cases(cases)
    }
}

/// A tree in a state.
#[derive(Clone, Debug)]
pub struct Case {
    pub model: Model,
    /// On the last body.
    pub tip: FrameId,
    /// On any body, or on the base.
    pub second: FrameId,
    pub q: Vec<f64>,
    pub dq: Vec<f64>,
    pub ddq: Vec<f64>,
    pub tau: Vec<f64>,
}

impl Case {
    /// Returns all quantities that [`update`] and [`coriolis`] compute.
    pub fn evaluated(&self) -> Data {
        evaluated(&self.model, &self.q, &self.dq)
    }

    /// Returns this case at the configuration `self.q` ⊕ `along` · `by`, with the same velocities.
    pub fn moved(&self, along: &[f64], by: f64) -> Self {
        Self { q: moved(&self.model, &self.q, along, by), ..self.clone() }
    }

    /// Length of q minus length of q̇.
    pub fn surplus_coordinates(&self) -> usize {
        self.model.nq() - self.model.n()
    }

    /// The first coordinate after those of a floating base.
    pub fn first_joint(&self) -> usize {
        first_joint(&self.model)
    }
}

pub fn first_joint(model: &Model) -> usize {
    if model.is_floating() { 6 } else { 0 }
}

/// A tree with mimic joints, and the same tree with all joints free.
#[derive(Clone, Debug)]
pub struct MimicTree {
    pub case: Case,
    pub whole: Model,
    pub followers: Vec<(usize, MimicConstraint)>,
}

impl MimicTree {
    /// Position of joint `joint` of the whole tree, for the positions `left` of the independent joints. For velocities,
    /// `left` contains velocities and `offsets` is 0; otherwise `offsets` is 1.
    fn position(&self, joint: usize, left: &[f64], offsets: f64) -> f64 {
        match self.followers.iter().find(|(follower, _)| *follower == joint) {
            Some((_, rule)) => rule.ratio * self.position(rule.leader, left, offsets) + offsets * rule.offset,
            None => left[self.independent_joints().iter().position(|&l| l == joint).expect("it is left")],
        }
    }

    /// Joints of the whole tree that are not mimic joints.
    pub fn independent_joints(&self) -> Vec<usize> {
        (0..self.whole.n()).filter(|joint| self.followers.iter().all(|(f, _)| f != joint)).collect()
    }

    /// q of the whole tree, for `q` of the tree with mimic joints.
    pub fn whole_q(&self, q: &[f64]) -> Vec<f64> {
        let ahead = self.case.surplus_coordinates();
        let joints = (ahead.min(1) * 6..self.whole.n()).map(|joint| self.position(joint, &q[ahead..], 1.0));
        let base = if ahead == 0 { &[] } else { &q[..7] };
        base.iter().copied().chain(joints).collect()
    }

    /// Matrix G (n' × n) with q̇' = G q̇, where q̇' belongs to the whole tree.
    pub fn map(&self) -> DMatrix<f64> {
        let n = self.case.model.n();
        DMatrix::from_fn(self.whole.n(), n, |joint, i| self.position(joint, &unit(n, i), 0.0))
    }
}

pub fn triple(range: f64) -> impl Strategy<Value = [f64; 3]> {
    [-range..range, -range..range, -range..range]
}

pub fn placement() -> impl Strategy<Value = Placement> {
    (triple(3.0), triple(0.5)).prop_map(|(rpy, xyz)| Placement::from_rpy(rpy, xyz))
}

/// A random inertia whose principal moments obey the triangle inequality.
pub fn inertia() -> impl Strategy<Value = Inertia> {
    (0.2..3.0, triple(0.3), triple(3.0), [0.01..0.2, 0.01..0.2, 0.01..0.2]).prop_map(
        |(mass, com, rpy, spread)| {
            let [x, y, z] = spread.map(|s: f64| s * s * mass);
            let turned = Placement::from_rpy(rpy, com);
            let rotational = Matrix3::from_diagonal(&Vector3::new(y + z, x + z, x + y));
            turned.act_inertia(&Inertia { mass, com: Vector3::zeros(), rotational })
        },
    )
}

pub fn wrench() -> impl Strategy<Value = Force> {
    (triple(20.0), triple(5.0)).prop_map(|(f, m)| Force { linear: f.into(), angular: m.into() })
}

/// A body to be added to a tree: its joint, its rotor, and the choice of its parent.
#[derive(Clone, Debug)]
struct Part {
    kind: JointKind,
    origin: Placement,
    inertia: Inertia,
    rotor: f64,
    branch: Index,
}

fn part() -> impl Strategy<Value = Part> {
    let kind =
        prop_oneof![Just(JointKind::Revolute), Just(JointKind::Continuous), Just(JointKind::Prismatic)];
    (kind, placement(), inertia(), 0.0..0.5, any::<Index>())
        .prop_map(|(kind, origin, inertia, rotor, branch)| Part { kind, origin, inertia, rotor, branch })
}

/// Adds the parts to `model` as a tree. Two thirds of the parts continue a chain, so that trees are deep and branched.
/// Adds a frame `tip` on the last body, and a frame `second` on any body or the base.
fn grow(mut model: Model, parts: &[Part], hand: Placement, second: (Index, Placement)) -> Model {
    let root = model.bodies().len();
    let mut rotors = model.rotor_inertia().to_vec();
    for (i, part) in parts.iter().enumerate() {
        let parent = (i > 0).then(|| root + if i % 3 == 2 { part.branch.index(i) } else { i - 1 });
        let limits = Limits { lower: -4.0 - i as f64, upper: 4.0 + i as f64, velocity: 3.0, effort: 30.0 };
        let joint = Joint { name: format!("joint{i}"), kind: part.kind, limits };
        model.add_body(parent, part.origin, joint, part.inertia);
        rotors.push(part.rotor);
    }
    model.add_frame("tip", model.bodies().len().checked_sub(1), hand);
    let parent = second.0.index(parts.len() + 1).checked_sub(1).map(|i| root + i);
    model.add_frame("second", parent, second.1);
    model.with_rotor_inertia(&rotors)
}

/// Strategy of trees whose number of parts is in `range`; `root` is the inertia of a floating base, or `None` for a
/// fixed base.
fn tree(
    root: impl Strategy<Value = Option<Inertia>>,
    range: std::ops::Range<usize>,
) -> impl Strategy<Value = Case> {
    let parts = prop::collection::vec(part(), range);
    let state = prop::collection::vec((-3.0..3.0, -2.0..2.0, -5.0..5.0, -20.0..20.0), 15);
    let second = (any::<Index>(), placement());
    (root, parts, placement(), second, placement(), triple(10.0), state).prop_map(
        |(root, parts, hand, second, base, gravity, state)| {
            let bare = root.map_or(Model::new("tree"), |root| Model::floating("tree", root));
            let model = grow(bare, &parts, hand, second).with_base(base).with_gravity(Vector3::from(gravity));
            let column =
                |pick: fn(&(f64, f64, f64, f64)) -> f64| state[..model.n()].iter().map(pick).collect();
            let mut q: Vec<f64> = column(|s| s.0);
            if model.is_floating() {
                // Rotated by up to 3√3 rad, so that w has either sign.
                let turned = UnitQuaternion::from_scaled_axis(Vector3::new(q[3], q[4], q[5]));
                q.splice(3..6, turned.coords.iter().copied());
            }
            Case {
                tip: model.frame_id("tip").expect("grown"),
                second: model.frame_id("second").expect("grown"),
                q,
                dq: column(|s| s.1),
                ddq: column(|s| s.2),
                tau: column(|s| s.3),
                model,
            }
        },
    )
}

/// Trees on a fixed base.
pub fn fixed() -> impl Strategy<Value = Case> {
    tree(Just(None), 1..9)
}

/// Trees on a floating base, including the base alone.
pub fn floating() -> impl Strategy<Value = Case> {
    tree(inertia().prop_map(Some), 0..7)
}

fn add_mimic_constraints(whole: Case, shift: Index, rules: &[(bool, Index, f64, f64)]) -> MimicTree {
    let (first, count) = (whole.first_joint(), whole.model.n() - whole.first_joint());
    // Joints in cyclic order from a random one: each may follow any earlier joint in this order, and the last one does.
    let order: Vec<usize> = (0..count).map(|i| first + (i + shift.index(count)) % count).collect();
    let mut followers = Vec::new();
    for (i, &(follows, leader, ratio, offset)) in rules.iter().enumerate().take(count).skip(1) {
        if follows || i + 1 == count {
            followers.push((order[i], MimicConstraint { leader: order[leader.index(i)], ratio, offset }));
        }
    }
    let model = whole.model.with_mimic_constraints(&followers).expect("no joint follows itself");
    let left: Vec<usize> =
        (0..whole.model.n()).filter(|joint| followers.iter().all(|(f, _)| f != joint)).collect();
    let pick = |values: &[f64]| left.iter().map(|&i| values[i]).collect::<Vec<f64>>();
    let ahead = whole.surplus_coordinates();
    let q = whole.q[..ahead].iter().copied().chain(pick(&whole.q[ahead..])).collect();
    let (dq, ddq, tau) = (pick(&whole.dq), pick(&whole.ddq), pick(&whole.tau));
    MimicTree { case: Case { model, q, dq, ddq, tau, ..whole }, whole: whole.model, followers }
}

fn mimic_trees_of(whole: impl Strategy<Value = Case>) -> impl Strategy<Value = MimicTree> {
    let rule = (any::<bool>(), any::<Index>(), -2.0..2.0, -1.0..1.0);
    (whole, any::<Index>(), prop::collection::vec(rule, 8))
        .prop_map(|(whole, shift, rules)| add_mimic_constraints(whole, shift, &rules))
}

/// Trees with mimic joints of any kind, before or after their leaders in the tree. Leaders may be mimic joints
/// themselves.
pub fn mimic_tree() -> impl Strategy<Value = MimicTree> {
    prop_oneof![mimic_trees_of(tree(Just(None), 2..9)), mimic_trees_of(tree(inertia().prop_map(Some), 2..7))]
}

/// Strategy of trees on a fixed base, with or without mimic joints.
pub fn jointed() -> impl Strategy<Value = Case> {
    prop_oneof![fixed(), mimic_trees_of(tree(Just(None), 2..9)).prop_map(|f| f.case)]
}

/// Any tree.
pub fn case() -> impl Strategy<Value = Case> {
    prop_oneof![fixed(), floating(), mimic_tree().prop_map(|f| f.case)]
}

/// Returns all quantities that [`update`] and [`coriolis`] compute.
pub fn evaluated(model: &Model, q: &[f64], dq: &[f64]) -> Data {
    let mut data = Data::new(model);
    assert!(update(model, &mut data, q, dq), "M is positive definite");
    coriolis(model, &mut data);
    data
}

/// `q` ⊕ `along` · `by`.
pub fn moved(model: &Model, q: &[f64], along: &[f64], by: f64) -> Vec<f64> {
    let mut out = vec![0.0; model.nq()];
    integrate(model, q, &along.iter().map(|v| v * by).collect::<Vec<f64>>(), &mut out);
    out
}

/// `x` + `rate` · `t`.
pub fn plus(x: &[f64], rate: &[f64], t: f64) -> Vec<f64> {
    x.iter().zip(rate).map(|(x, v)| x + v * t).collect()
}

pub fn unit(n: usize, i: usize) -> Vec<f64> {
    (0..n).map(|j| if i == j { 1.0 } else { 0.0 }).collect()
}

pub fn vector(values: &[f64]) -> DVector<f64> {
    DVector::from_column_slice(values)
}

pub fn stacked(m: &Motion) -> Vec<f64> {
    m.linear.iter().chain(m.angular.iter()).copied().collect()
}

/// Returns the Jacobian that `fill` writes, with `n` columns, initially NaN.
pub fn jacobian(n: usize, fill: impl FnOnce(&mut Matrix6xX<f64>)) -> Matrix6xX<f64> {
    let mut out = Matrix6xX::repeat(n, f64::NAN);
    fill(&mut out);
    out
}

/// Asserts that the largest difference, relative to max(1, largest entry of either side), is within tolerance; NaN
/// never is.
pub fn close<'a>(
    a: impl IntoIterator<Item = &'a f64>,
    b: impl IntoIterator<Item = &'a f64>,
    tolerance: f64,
) -> Result<(), TestCaseError> {
    let (a, b): (Vec<f64>, Vec<f64>) = (a.into_iter().copied().collect(), b.into_iter().copied().collect());
    prop_assert_eq!(a.len(), b.len());
    let scale = a.iter().chain(&b).fold(1.0, |m: f64, x| m.max(x.abs()));
    for (i, (x, y)) in a.iter().zip(&b).enumerate() {
        prop_assert!((x - y).abs() <= tolerance * scale, "entry {}: {} against {}, scale {}", i, x, y, scale);
    }
    Ok(())
}

pub fn close_placement(a: &Placement, b: &Placement, tolerance: f64) -> Result<(), TestCaseError> {
    close(&a.translation, &b.translation, tolerance)?;
    close(&a.rotation, &b.rotation, tolerance)
}
