//! Freedom that a task has lost where it starts, and freedom that nothing damps.

use super::motion::Motion;
use super::{Case, Finding, short};
use nalgebra::{DMatrix, Matrix6xX, SymmetricEigen, Vector6};
use opspace_control::joint::JOINTS_SINGULARITY_THRESHOLD;
use opspace_control::rank::{Rows, TypicalMobility};
use opspace_control::{AXIS_NAMES, JointTrackingParameters, TaskParameters};
use opspace_model::{Data, Inversion, OperationalSpace, update};

/// In what steps, and how far, a joint is bent in search of a better start, rad or m.
const BEND: f64 = 0.05;
const FARTHEST_BENDS: u32 = 30;

/// Joints that no task moves or damps.
pub(crate) fn undamped(case: &Case<'_>) -> Option<Finding> {
    let n = case.model.n();
    (0..case.stacks.len()).find_map(|number| {
        let stack = &case.stacks[number];
        let in_priority = || stack.priority.iter().filter_map(|name| stack.task.get(name));
        let mut used: usize = stack.motions.iter().map(|m| m.parameters.axes.in_task().iter().filter(|a| **a).count()).sum();
        for task in in_priority() {
            match task {
                TaskParameters::JointTracking(JointTrackingParameters { joints: Some(joints), .. }) => {
                    used += joints.len();
                }
                TaskParameters::JointTracking(_)
                | TaskParameters::JointPosture(_)
                | TaskParameters::JointDamping(_) => return None,
                TaskParameters::Cartesian(_) | TaskParameters::CenterOfMass(_) => {}
            }
        }
        let left = n.checked_sub(used).filter(|left| *left > 0)?;
        let message = match left {
            1 => format!("1 of the {n} joints' freedoms is neither led nor damped by any task: friction alone brakes it"),
            _ => format!(
                "{left} of the {n} joints' freedoms are neither led nor damped by any task: friction alone brakes them"
            ),
        };
        let help = "add [task.rest.joint-damping] or [task.rest.joint-posture], with \"rest\" last in `priority`";
        let key = match number {
            0 => vec!["priority".to_owned()],
            event => vec!["event".to_owned(), (event - 1).to_string(), "set".to_owned()],
        };
        Some(Finding::new(&key, message, help.to_owned()))
    })
}

/// Tasks that at the start can hardly move in some direction, with the tasks above them in force.
pub(crate) fn singular_start(case: &Case<'_>) -> Vec<Finding> {
    let spectra = spectra(case, &case.data);
    let weak = spectra.iter().enumerate().filter(|(_, spectrum)| spectrum.share < WHOLE);
    weak.map(|(level, spectrum)| {
        let motion = &case.stacks[0].motions[spectrum.motion];
        let lost = match spectrum.share {
            share if share < 0.005 => "can't be moved".to_owned(),
            share => format!("has {} % left of its force", short(100.0 * share)),
        };
        let where_it_is = if spectrum.share < 0.5 { "singular there" } else { "near a singularity" };
        let message = format!(
            "task '{}': at the start it {lost} along {}: the arm is {where_it_is}{}",
            motion.name,
            direction(&spectrum.direction),
            if level > 0 { ", or the tasks above take what it needs" } else { "" },
        );
        let help = bend(case, level).unwrap_or_else(|| {
            "start elsewhere, free that axis, or give it to a task that comes first".to_owned()
        });
        Finding::new(&["start_rad"], message, help)
    })
    .collect()
}

/// From that share on nothing is lost.
const WHOLE: f64 = 1.0 - 1e-9;

/// How well a task can move its weakest direction.
struct Spectrum {
    /// Which of the stack's motions.
    motion: usize,
    share: f64,
    /// A unit vector on the task's axes, rotations scaled to m.
    direction: Vector6<f64>,
}

/// Those of the motions at a state, each within the freedom that the tasks above leave, as the controller counts it.
fn spectra(case: &Case<'_>, data: &Data) -> Vec<Spectrum> {
    let (model, n, stack) = (case.model, case.model.n(), &case.stacks[0]);
    let mut freedom: DMatrix<f64> = DMatrix::identity(n, n);
    let mut space = OperationalSpace::new(n);
    let mut left = freedom.clone();
    let mut found = Vec::new();
    for name in stack.priority {
        let selected = match stack.task.get(name) {
            Some(TaskParameters::JointTracking(JointTrackingParameters { joints: Some(names), .. })) => {
                let mut rows = Matrix6xX::zeros(n);
                let joints = names.iter().filter_map(|name| model.joint(name).ok());
                let joints: Vec<usize> = joints.collect();
                joints.iter().enumerate().for_each(|(row, &joint)| rows[(row, joint)] = 1.0);
                let typical = TypicalMobility::new(model, &Rows::Joints(&joints)).dynamic;
                Some((rows, names.len(), JOINTS_SINGULARITY_THRESHOLD, typical, None))
            }
            _ => stack.motions.iter().position(|motion| motion.name == name).map(|place| {
                let motion: &Motion<'_> = &stack.motions[place];
                let axes = motion.axes(model, data, motion.parameters.axes.in_task());
                let rows = motion.rows(model, data, &axes);
                let threshold = motion.parameters.singularity_threshold.get();
                let typical = TypicalMobility::new(model, &Rows::Axes(&axes)).dynamic;
                (rows, axes.rows(), threshold, typical, Some((place, axes)))
            }),
        };
        let Some((alone, rows, threshold, typical, motion)) = selected else { continue };
        let projected = Matrix6xX::from_columns(&(&alone * &freedom).column_iter().collect::<Vec<_>>());
        let mobility = data.mass_matrix_factor.mobility(&mut projected.clone());
        let inversion = Inversion::Damped(threshold);
        space.update_with(&data.mass_matrix_factor, &projected, rows, inversion, Some(typical));
        if let Some((motion, axes)) = motion {
            let spectrum = SymmetricEigen::new(mobility.view((0, 0), (rows, rows)).into_owned());
            let weakest = spectrum.eigenvectors.column(spectrum.eigenvalues.imin());
            let mut direction = Vector6::zeros();
            axes.axes().iter().zip(weakest.iter()).for_each(|(&axis, &x)| direction[axis] = x);
            found.push(Spectrum { motion, share: space.weakest_share, direction });
        }
        space.nullspace(&projected, &mut left);
        freedom *= &left;
    }
    found
}

/// A direction as a person would say it: `z`, or `0.71 x - 0.71 rz`.
fn direction(direction: &Vector6<f64>) -> String {
    // Either way is the same direction: the largest part is told as positive.
    let sign = direction[direction.iamax()].signum();
    let mut text = String::new();
    for (axis, name) in AXIS_NAMES.iter().enumerate() {
        let part = sign * direction[axis];
        if part.abs() < 0.05 {
            continue;
        }
        let joined = match (text.is_empty(), part < 0.0) {
            (true, false) => "",
            (true, true) => "-",
            (false, false) => " + ",
            (false, true) => " - ",
        };
        text += joined;
        if part.abs() < 0.995 {
            text += &format!("{:.2} ", part.abs());
        }
        text += name;
    }
    text
}

/// The smallest bend of one joint at which the task has lost nothing, and those above neither.
fn bend(case: &Case<'_>, level: usize) -> Option<String> {
    let mut data = case.data.clone();
    let rest = vec![0.0; case.model.n()];
    for bends in 1..=FARTHEST_BENDS {
        for joint in 0..case.model.n() {
            for sign in [1.0, -1.0] {
                let mut q = case.start.clone();
                q[joint] += sign * BEND * f64::from(bends);
                let (lower, upper) = case.range(joint);
                if q[joint] < lower || q[joint] > upper || !update(case.model, &mut data, &q, &rest) {
                    continue;
                }
                if spectra(case, &data)[..=level].iter().all(|spectrum| spectrum.share >= WHOLE) {
                    let name = case.joint(joint);
                    return Some(format!(
                        "start with joint '{name}' at {} instead of {}",
                        short(q[joint]),
                        short(case.start[joint])
                    ));
                }
            }
        }
    }
    None
}
