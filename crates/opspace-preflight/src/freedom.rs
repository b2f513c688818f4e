//! Directions in which a task cannot move at its start (singularities), and degrees of freedom without a task.

use super::case::PreflightCase;
use super::diagnostic::short;
use nalgebra::{DMatrix, Matrix6xX, SymmetricEigen, Vector6};
use opspace_control::tasks::task::DEFAULT_INVERSION;
use opspace_control::{AXIS_NAMES, AxisMode, SingularEscape, TaskParameters};
use opspace_experiment::codes::Code;
use opspace_experiment::evaluate::direction::direction;
use opspace_experiment::files::controller_kind::ControllerKind;
use opspace_experiment::finding::Finding;
use opspace_model::{Data, OperationalSpace, Postures, update};
use opspace_sim::EnvironmentObjectParameters;
use std::fmt;

/// Step (rad or m) and maximum number of steps by which a joint is displaced in the search for a better start.
const BEND: f64 = 0.05;
const FARTHEST_BENDS: u32 = 30;
/// Maximum number of steps for two joints.
const FARTHEST_BENDS_OF_TWO: u32 = 10;

/// Vertical part of an axis of unit length up to which it counts as level.
const LEVEL: f64 = 0.02;

/// Finds degrees of freedom that no task controls.
pub(crate) fn uncontrolled(case: &PreflightCase<'_>) -> Option<Finding> {
    let n = case.model.n();
    (0..case.task_sets.len()).find_map(|number| {
        let stack = &case.task_sets[number];
        if stack.tasks.joint_task().is_some() {
            return None;
        }
        let used: usize = stack.tasks.tasks().map(|task| task.rows()).sum();
        let left = n.checked_sub(used).filter(|left| *left > 0)?;
        let message = match left {
            1 => format!(
                "1 of the {n} degrees of freedom is not controlled by any task: it is only damped, and may drift"
            ),
            _ => format!(
                "{left} of the {n} degrees of freedom are not controlled by any task: they are only damped, and may drift"
            ),
        };
        let help = "add [task.rest.joint-posture], or [task.rest.joint-damping] for damping of your own, with \"rest\" last in `priority`";
        let key = match number {
            0 => vec!["priority".to_owned()],
            event => vec!["event".to_owned(), (event - 1).to_string(), "set".to_owned()],
        };
        Some(Finding::new(Code::UncontrolledFreedom, &key, message, help.to_owned()))
    })
}

/// Finds tasks with compliant axes that nothing brings back after a push: no force is regulated, and no object of the
/// environment holds the frame. A load does not hold it: it falls with the frame.
pub(crate) fn drifting(case: &PreflightCase<'_>) -> Vec<Finding> {
    let mut found: Vec<Finding> = Vec::new();
    let mut named: Vec<&str> = Vec::new();
    for (number, stack) in case.task_sets.iter().enumerate() {
        for motion in &stack.motions {
            let parameters = &motion.parameters;
            let compliant = parameters.axes.with_mode(AxisMode::Compliant);
            let axes: Vec<&str> =
                AXIS_NAMES.into_iter().zip(compliant).filter(|(_, is)| *is).map(|(axis, _)| axis).collect();
            if axes.is_empty() || parameters.force.is_some() || named.contains(&motion.name) {
                continue;
            }
            let environment = &case.experiment.task().file.environment;
            let acts = |object: &&EnvironmentObjectParameters| object.frame() == parameters.frame;
            let holds = |object: &EnvironmentObjectParameters| {
                use EnvironmentObjectParameters::{Mass, Pushes};
                !matches!(object, Pushes(_) | Mass(_))
            };
            let is_held = environment.values().filter(acts).any(holds);
            if is_held || returns_later(case, number, motion.name, compliant) {
                continue;
            }
            named.push(motion.name);
            let load =
                environment.iter().filter(|(_, object)| acts(object)).find_map(
                    |(name, object)| match object {
                        EnvironmentObjectParameters::Mass(mass) => Some((name, mass.mass_kg.get())),
                        _ => None,
                    },
                );
            let subject = format!("task '{}': nothing", motion.name);
            let (hand, axes_text) = (motion.controlled_name(), axes.join(", "));
            // A load falls along an axis that is not level.
            let axes_in_world = motion.axes(case.model, &case.data);
            let falls = (0..3).any(|axis| compliant[axis] && axes_in_world[(2, axis)].abs() > LEVEL);
            let message = match load.filter(|_| falls) {
                Some((name, mass_kg)) => format!(
                    "{subject} holds the load '{name}' of {} kg along {axes_text}: {hand} falls with it, beyond what friction holds",
                    short(mass_kg)
                ),
                None => format!(
                    "{subject} brings {hand} back along {axes_text}: a compliant axis stays where it is pushed to"
                ),
            };
            let spring = match axes[0].len() {
                1 => format!("impedance = {{ stiffness_n_per_m = {{ {} = 100.0, ... }} }}", axes[0]),
                _ => format!("impedance = {{ stiffness_nm_per_rad = {{ {} = 10.0, ... }} }}", axes[0]),
            };
            let help = format!(
                "for an axis that yields and comes back, use \"motion\" with a spring: {spring}; for a hand that is led, nothing"
            );
            let kind = stack.task.get(motion.name).map_or("", TaskParameters::kind);
            let key = case.key(number, motion.name, &[kind, "axes"]);
            found.push(Finding::new(Code::CompliantDrift, &key, message, help));
        }
    }
    found
}

/// True if a task set after this one controls the compliant axes of the task by a motion: their reference then brings them back.
fn returns_later(case: &PreflightCase<'_>, number: usize, name: &str, compliant: [bool; 6]) -> bool {
    let later = case.task_sets[number + 1..].iter().flat_map(|stack| &stack.motions);
    later.filter(|motion| motion.name == name).any(|motion| {
        let moves = motion.parameters.axes.with_mode(AxisMode::Motion);
        compliant.into_iter().zip(moves).all(|(is_compliant, moves)| moves || !is_compliant)
    })
}

/// Number of sampled postures.
const SAMPLES: usize = 400;

/// Nearly singular postures of a task among sampled ones: those in which it is damped at rest, below the tasks of higher
/// priority.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct SingularPostures {
    /// Name of the task.
    pub task: String,
    /// Number of nearly singular postures.
    pub singular: usize,
    /// Number of sampled postures; they fill the ranges of the joints evenly.
    pub sampled: usize,
}

impl fmt::Display for SingularPostures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { task, singular, sampled } = self;
        let percent = 100.0 * *singular as f64 / *sampled as f64;
        write!(
            f,
            "task '{task}': nearly singular in {percent:.1} % of {sampled} sampled postures within position limits"
        )
    }
}

/// Counts the nearly singular postures of each task of at most six rows that is active at the start.
pub(super) fn singular_postures_of(case: &PreflightCase<'_>) -> Vec<SingularPostures> {
    let (mut data, rest) = (case.data.clone(), vec![0.0; case.model.n()]);
    let postures = Postures::new(case.model, 1.0);
    let mut counts: Vec<SingularPostures> = (case.task_sets.first().into_iter())
        .flat_map(|set| set.tasks.tasks())
        .map(|task| SingularPostures { task: task.name().to_owned(), singular: 0, sampled: 0 })
        .collect();
    for number in 0..SAMPLES {
        if !update(case.model, &mut data, &postures.posture(number), &rest) {
            continue;
        }
        for spectrum in spectra(case, &data) {
            let Some(count) = counts.iter_mut().find(|count| count.task == spectrum.name) else { continue };
            count.sampled += 1;
            count.singular += usize::from(spectrum.share < WHOLE);
        }
    }
    counts.retain(|count| count.sampled > 0);
    counts
}

/// Finds tasks that can hardly move in a direction at the start, given the tasks of higher priority.
pub(crate) fn singular_start(case: &PreflightCase<'_>) -> Vec<Finding> {
    let spectra = spectra(case, &case.data);
    let is_osc = case.experiment.options().controller == ControllerKind::Osc;
    let weak = spectra.iter().enumerate().filter(|(_, spectrum)| spectrum.share < WHOLE);
    weak.map(|(level, spectrum)| {
        let lost = match spectrum.share {
            share if share < LOST => "cannot be moved".to_owned(),
            share => format!("retains only {} % of its force", short(100.0 * share)),
        };
        let where_it_is = if spectrum.share < 0.5 { "in a singular pose" } else { "near a singularity" };
        let message = format!(
            "task '{}': at the start it {lost} along {}: the arm is {where_it_is}{}{}",
            spectrum.name,
            spectrum.direction,
            if level > 0 { ", or tasks of higher priority use the required joints" } else { "" },
            match (spectrum.share < LOST, is_osc, spectrum.escapes) {
                (true, true, false) =>
                    "; towards a goal along that direction it leaves late, or not at all if the pose is exactly singular",
                (true, true, true) =>
                    "; it leaves towards a goal along that direction by motion in the null space (`escape`)",
                _ => "",
            },
        );
        let mut help = bend(case, level).unwrap_or_else(|| {
            "start in another posture, free that axis, or control it by a task of higher priority".to_owned()
        });
        let can_escape = is_osc && spectrum.share < LOST && !spectrum.escapes;
        if let Some(key) = spectrum.escape_key.as_ref().filter(|_| can_escape)
        {
            help += &format!(
                "; or set {key} = \"nullspace-step\": the arm then leaves by motion in the null space"
            );
        }
        Finding::new(Code::SingularStart, &["start_rad"], message, help)
    })
    .collect()
}

/// Value of `Spectrum::share` below which a direction counts as lost.
const LOST: f64 = 0.005;

/// Value of `Spectrum::share` above which a task has full mobility.
const WHOLE: f64 = 1.0 - 1e-9;

/// Mobility of a task in its weakest direction; `share` is its remaining fraction, 1 if nothing is lost, 0 if it is
/// lost.
struct Spectrum {
    /// Name of the task.
    name: String,
    share: f64,
    /// True if the task has the option to escape from singular poses.
    escapes: bool,
    /// Key of this option in the task file; `None` if tasks of this kind do not have it.
    escape_key: Option<String>,
    /// Weakest direction in the task's rows, rotations scaled to m: `z`, or `0.71 x - 0.71 rz`.
    direction: String,
}

/// Spectra of the tasks at a state, each in the null space of the tasks of higher priority, computed as in the
/// controller at rest, or as with the default damping if a task has none.
fn spectra(case: &PreflightCase<'_>, data: &Data) -> Vec<Spectrum> {
    let (model, n, tasks) = (case.model, case.model.n(), &case.task_sets[0].tasks);
    let mut freedom: DMatrix<f64> = DMatrix::identity(n, n);
    let mut space = OperationalSpace::new(n);
    let mut left = freedom.clone();
    let mut found = Vec::new();
    let mut alone = Matrix6xX::zeros(n);
    for (task, typical) in tasks.tasks().zip(tasks.typical_mobilities()) {
        let rows = task.rows();
        task.jacobian(model, data, &mut alone);
        let projected = Matrix6xX::from_columns(&(&alone * &freedom).column_iter().collect::<Vec<_>>());
        let mobility = data.mass_matrix_factor.mobility(&mut projected.clone());
        let inversion = if task.inversion().is_for_control() { task.inversion() } else { DEFAULT_INVERSION };
        let (factor, reference, at_rest) = (&data.mass_matrix_factor, typical.dynamic, Vector6::zeros());
        space.update_inertia(factor, &projected, rows, inversion, Some(reference), Some(&at_rest));
        space.compute_jbar(factor);
        let mobility = mobility.view((0, 0), (rows, rows)).into_owned();
        let Some(spectrum) = SymmetricEigen::try_new(mobility, f64::EPSILON, MAX_ITERATIONS) else {
            continue;
        };
        let weakest = spectrum.eigenvectors.column(spectrum.eigenvalues.imin());
        let direction = direction(weakest.as_slice(), &task.row_names());
        found.push(Spectrum {
            name: task.name().to_owned(),
            share: space.min_singular_gain,
            escapes: task.escape() != SingularEscape::None,
            escape_key: task.rows_key().strip_suffix(".axes").map(|table| format!("{table}.escape")),
            direction,
        });
        space.nullspace(&projected, &mut left);
        freedom *= &left;
    }
    found
}

/// Largest number of iterations of a decomposition: finite matrices of our sizes need some ten per row.
const MAX_ITERATIONS: usize = 1000;

/// Smallest displacement of one joint, or of two, that gives full mobility to the task and to those of higher priority.
fn bend(case: &PreflightCase<'_>, level: usize) -> Option<String> {
    bend_of_one(case, level).or_else(|| bend_of_two(case, level))
}

/// Smallest equal displacement of two joints that gives full mobility.
fn bend_of_two(case: &PreflightCase<'_>, level: usize) -> Option<String> {
    let (mut data, rest, n) = (case.data.clone(), vec![0.0; case.model.n()], case.model.n());
    for bends in 1..=FARTHEST_BENDS_OF_TWO {
        let by = BEND * f64::from(bends);
        for (first, second) in (0..n).flat_map(|first| (first + 1..n).map(move |second| (first, second))) {
            for signs in [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]] {
                let mut q = case.start.clone();
                (q[first], q[second]) = (q[first] + signs[0] * by, q[second] + signs[1] * by);
                let is_inside = |joint: usize| {
                    let (lower, upper) = case.range(joint);
                    q[joint] >= lower && q[joint] <= upper
                };
                if !is_inside(first) || !is_inside(second) || !update(case.model, &mut data, &q, &rest) {
                    continue;
                }
                if spectra(case, &data)[..=level].iter().all(|spectrum| spectrum.share >= WHOLE) {
                    return Some(format!(
                        "start with joint '{}' at {} and joint '{}' at {}",
                        case.joint(first),
                        short(q[first]),
                        case.joint(second),
                        short(q[second])
                    ));
                }
            }
        }
    }
    None
}

/// Smallest displacement of one joint that gives full mobility.
fn bend_of_one(case: &PreflightCase<'_>, level: usize) -> Option<String> {
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
                        "start with joint '{name}' at {} instead of at {}",
                        short(q[joint]),
                        short(case.start[joint])
                    ));
                }
            }
        }
    }
    None
}
