//! Force axes that press away from every surface: the sign of their target, their direction or the object is wrong.
//!
//! An axis with the target force F moves against F until it touches. From the hand's positions along the references, the direction
//! −F is searched for the objects of the environment that act on the hand.

use super::case::PreflightCase;
use super::diagnostic::{at_least, short};
use super::motion::Motion;
use super::objects::depth;
use nalgebra::Vector3;
use opspace_control::{AXIS_NAMES, AxisMode, ControlledFrame, ForceParameters, reach};
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_experiment::run::rollout::{Instant, Rollout};
use opspace_model::{FrameId, frame_placement, update};
use opspace_sim::EnvironmentObjectParameters;

/// Distance between two points at which objects are searched, m.
const STEP_M: f64 = 2e-3;

/// Largest number of instants at which objects are searched.
const INSTANTS: usize = 20;

/// Force axis whose hand has surfaces.
struct Approach<'a> {
    case: &'a PreflightCase<'a>,
    task_set: usize,
    motion: &'a Motion<'a>,
    force: &'a ForceParameters,
    axis: usize,
    /// Force on the hand that it should reach, N.
    target_n: f64,
    /// Surfaces that act on the hand, with their names and the frames on which they act.
    surfaces: Vec<(&'a str, &'a EnvironmentObjectParameters, FrameId)>,
}

/// Distance to a surface along a direction, and its name.
type Ahead<'a> = Option<(f64, &'a str)>;

/// Reports each force axis that leads away from the surfaces of the environment, or reaches them after the run.
pub(crate) fn of_force_axes(case: &PreflightCase<'_>, followed: &Rollout) -> Vec<Finding> {
    let mut found: Vec<Finding> = Vec::new();
    for (number, stack) in case.task_sets.iter().enumerate() {
        for motion in &stack.motions {
            let finding =
                approaches(case, number, motion).into_iter().find_map(|axis| axis.finding(followed));
            found.extend(finding.filter(|new| !found.iter().any(|old| old.place == new.place)));
        }
    }
    found
}

/// Translational force axes of a task with a target, if every object that acts on the hand has a surface. A hand that an operator or a
/// drawer holds may press in every direction, and a scene of another engine has surfaces of its own.
fn approaches<'a>(case: &'a PreflightCase<'a>, task_set: usize, motion: &'a Motion<'a>) -> Vec<Approach<'a>> {
    let ControlledFrame::Frame(frame) = motion.controlled else { return Vec::new() };
    let Some(force) = motion.parameters.force.as_ref() else { return Vec::new() };
    let experiment = case.experiment;
    let file = &experiment.robot().file;
    if file.driver.is_some() || file.simulated.is_none() || experiment.scene().is_some() {
        return Vec::new();
    }
    let mut surfaces = Vec::new();
    for (name, object) in &experiment.task().file.environment {
        let Ok(of_object) = case.model.frame_id(object.frame()) else { continue };
        if case.model.frame(of_object).body != case.model.frame(frame).body {
            continue;
        }
        use EnvironmentObjectParameters::{Cylinder, Hole, Mass, Pushes, Wall};
        match object {
            Wall(_) | Cylinder(_) | Hole(_) => surfaces.push((name.as_str(), object, of_object)),
            Mass(_) | Pushes(_) => {}
            _ => return Vec::new(),
        }
    }
    // A surface that the task states need not be in the environment.
    if surfaces.is_empty() && force.surface.is_some() {
        return Vec::new();
    }
    let in_force = motion.parameters.axes.with_mode(AxisMode::Force);
    let target_n = |axis: usize| motion.parameters.target_force()[axis];
    (0..3)
        .filter(|&axis| in_force[axis] && target_n(axis) != 0.0)
        .map(|axis| Approach {
            case,
            task_set,
            motion,
            force,
            axis,
            target_n: target_n(axis),
            surfaces: surfaces.clone(),
        })
        .collect()
}

impl<'a> Approach<'a> {
    fn finding(&self, followed: &Rollout) -> Option<Finding> {
        let in_force: Vec<&Instant> =
            followed.instants.iter().filter(|instant| instant.task_set == self.task_set).collect();
        let every = in_force.len().div_ceil(INSTANTS).max(1);
        let mut behind: Ahead<'_> = None;
        let mut late: Option<(f64, &str, f64)> = None;
        for instant in in_force.into_iter().step_by(every) {
            let (ahead, opposite) = self.look(instant)?;
            if let Some((distance_m, name)) = ahead {
                let left_s = self.end_s() - instant.time_s;
                let needed_s = distance_m / self.speed_m_per_s()?;
                if needed_s <= left_s {
                    return None;
                }
                late = late.or(Some((distance_m, name, needed_s)));
            }
            behind = behind.or(opposite);
        }
        Some(match (late, behind) {
            (Some(late), _) => self.late(late),
            (None, Some(behind)) => self.wrong_sign(behind),
            (None, None) => self.nothing_ahead(),
        })
    }

    /// Nearest surface in the direction in which the hand presses, and in the opposite one; `None` if the posture is not known.
    fn look(&self, instant: &Instant) -> Option<(Ahead<'a>, Ahead<'a>)> {
        let (model, mut data) = (self.case.model, self.case.data.clone());
        if !update(model, &mut data, &instant.q, &vec![0.0; model.n()]) {
            return None;
        }
        let axis: Vector3<f64> = self.motion.axes(model, &data).column(self.axis).into();
        let pressing = -self.target_n.signum() * axis;
        let nearest = |direction: Vector3<f64>| {
            let distances = self.surfaces.iter().filter_map(|(name, object, frame)| {
                let from = frame_placement(model, &data, *frame).translation;
                Some((distance_m(object, &from, &direction, 2.0 * reach(model, *frame))?, *name))
            });
            distances.min_by(|a, b| a.0.total_cmp(&b.0))
        };
        Some((nearest(pressing), nearest(-pressing)))
    }

    /// Speed of the approach, m/s; `None` without one.
    fn speed_m_per_s(&self) -> Option<f64> {
        self.force.contact.map(|contact| contact.approach_m_per_s.get())
    }

    /// End of the task set, s.
    fn end_s(&self) -> f64 {
        let next = self.case.task_sets.get(self.task_set + 1).map(|next| next.from_s);
        next.unwrap_or_else(|| self.case.experiment.duration_s())
    }

    fn key(&self, key: &str) -> Vec<String> {
        self.case.key(self.task_set, self.motion.name, &["cartesian", "force", key])
    }

    /// Beginning of the messages.
    fn subject(&self) -> String {
        format!("task '{}' presses along {}{}", self.motion.name, self.sign(), AXIS_NAMES[self.axis])
    }

    /// Sign of the direction in which the hand presses.
    fn sign(&self) -> char {
        if self.target_n > 0.0 { '-' } else { '+' }
    }

    fn wrong_sign(&self, (distance_m, name): (f64, &str)) -> Finding {
        let message = format!(
            "{}, away from '{name}', which is {} m behind: the target is the force on the robot, and the hand moves against it",
            self.subject(),
            short(distance_m),
        );
        let help = format!("try {} = {}", AXIS_NAMES[self.axis], short(-self.target_n));
        Finding::new(Code::PressesAway, &self.key("target_n"), message, help)
    }

    fn nothing_ahead(&self) -> Finding {
        let (frame, axis) = (&self.motion.parameters.frame, AXIS_NAMES[self.axis]);
        let message = match self.surfaces.is_empty() {
            true => format!("{}, but the environment has no surface for '{frame}'", self.subject()),
            false => format!("{}, but no surface is there, neither ahead nor behind", self.subject()),
        };
        let help = format!(
            "check the axis {axis} and `axes_frame`, and the place of the surfaces in [environment]; start in front of one"
        );
        Finding::new(Code::NothingAhead, &self.key("target_n"), message, help)
    }

    fn late(&self, (distance_m, name, needed_s): (f64, &str, f64)) -> Finding {
        let speed = self.speed_m_per_s().unwrap_or(f64::NAN);
        let left_s = self.end_s() - self.case.task_sets[self.task_set].from_s;
        let message = format!(
            "{}, but '{name}' is {} m away: at {} m/s it is reached after {} s, and the task ends after {} s",
            self.subject(),
            short(distance_m),
            short(speed),
            short(needed_s),
            short(left_s),
        );
        let help = format!(
            "start closer, or approach faster or for longer: `contact = {{ approach_m_per_s = {} }}` is fast enough",
            at_least(1.2 * distance_m / left_s)
        );
        Finding::new(Code::NothingAhead, &self.key("contact"), message, help)
    }
}

/// Distance from a point to an object along a direction of unit length, m; `None` if the object is not there within `farthest_m`.
fn distance_m(
    object: &EnvironmentObjectParameters,
    from: &Vector3<f64>,
    direction: &Vector3<f64>,
    farthest_m: f64,
) -> Option<f64> {
    let steps = (farthest_m / STEP_M) as usize;
    let distances = (0..=steps).map(|step| step as f64 * STEP_M);
    // The first step may begin on the surface itself.
    distances.map(|distance_m| distance_m + 1e-4).find(|distance_m| {
        let at = from + direction * *distance_m;
        match object {
            // A peg above the hole touches its plane or its bottom.
            EnvironmentObjectParameters::Hole(hole) => {
                Vector3::from(hole.normal).dot(&(Vector3::from(hole.point_m) - at)) > 0.0
            }
            _ => depth(object, &at).is_some_and(|(depth_m, _)| depth_m > 0.0),
        }
    })
}
