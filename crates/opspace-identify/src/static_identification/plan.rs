//! Plan of the sweep of a joint: posture of the other joints, range, speed, and the worst case of all of them.
//!
//! The range ends before position limits, before links touch, and before a drive would need much of its torque. The other joints
//! stay at the start, unless gravity changes the torque clearly more in another posture that the arm can reach on a straight line.

use opspace_model::{Data, Model, Postures, forward_kinematics, gravity};
use thiserror::Error;

/// Distance from position limits, rad (m).
const FROM_LIMITS: f64 = 0.06;

/// Largest way from the posture in each direction, rad (m), and that of joints on which gravity has no effect.
const FURTHEST: f64 = 1.6;
const FURTHEST_WITHOUT_GRAVITY: f64 = 0.5;

/// Least range, rad (m).
const LEAST_RANGE: f64 = 0.3;

/// Distance between two postures that are checked, rad (m).
const STEP: f64 = 0.02;

/// Largest torque of gravity over the torque limit.
const LARGEST_LOAD: f64 = 0.6;

/// Fraction of the torque limit from which gravity has an effect.
const HAS_EFFECT: f64 = 0.01;

/// Speed of sweeps, rad/s (m/s), and over the speed limit, at most.
const SPEED: f64 = 0.4;
const SPEED_OF_LIMIT: f64 = 0.1;

/// Number of postures among which the best one is chosen, the part of the ranges in which they are, and the number that is checked.
const POSTURES: usize = 300;
const PART_OF_RANGE: f64 = 0.8;
const CHECKED: usize = 20;

/// Span of gravity at the start over the best one, from which the other joints stay at the start.
const ENOUGH: f64 = 0.7;

/// Planned sweep of a joint.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct SweepPlan {
    /// Index of the joint.
    pub joint: usize,
    /// Posture before the sweep (n; rad, m).
    pub posture: Vec<f64>,
    /// Lower end of its motion, rad (m).
    pub lower: f64,
    /// Upper end of its motion, rad (m).
    pub upper: f64,
    /// Largest speed, rad/s (m/s).
    pub speed: f64,
    /// Span of the torque of gravity over the range, Nm (N).
    pub gravity_span: f64,
    /// Largest torque of gravity of any joint over its torque limit.
    pub largest_load: f64,
}

/// Reason why a joint cannot be swept. The subject of each message is the joint.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum PlanFailure {
    /// Start posture in which links touch.
    #[error(
        "it cannot move, because {0} at the start: choose another start, or state the capsules of these links in [collision] of \
         robot.toml"
    )]
    Contact(String),
    /// Start posture in which a drive has too little torque.
    #[error(
        "it cannot move, because the weight of the arm at the start needs {:.0} % of a torque limit, more than {:.0} %: choose another start",
        100.0 * load, 100.0 * LARGEST_LOAD
    )]
    Load {
        /// Largest torque of gravity over the torque limit.
        load: f64,
    },
    /// Range that is too short.
    #[error(
        "it can move by {range:.2} rad (m) only, before a limit, a contact of links or a large load; {LEAST_RANGE} are needed: choose \
         another start"
    )]
    Range {
        /// Range, rad (m).
        range: f64,
    },
}

/// Conditions that a plan keeps.
pub struct Bounds<'a> {
    /// Model with all weights.
    pub model: &'a Model,
    /// Torque limits (n; Nm, N).
    pub torque_limits: &'a [f64],
    /// Returns which links touch in a posture (n; rad, m), as a clause; `None` if there are none.
    pub contact: &'a mut dyn FnMut(&[f64]) -> Option<String>,
}

/// Plans the sweep of a joint that begins and ends at `start` (n; rad, m).
///
/// # Errors
/// A start that cannot be held, and a range that is too short.
pub fn plan(bounds: Bounds<'_>, start: &[f64], joint: usize) -> Result<SweepPlan, PlanFailure> {
    let data = Data::new(bounds.model);
    let mut planner = Planner { bounds, data, joint };
    let (_, load) = planner.load(start);
    if load > LARGEST_LOAD {
        return Err(PlanFailure::Load { load });
    }
    if let Some(contact) = (planner.bounds.contact)(start) {
        return Err(PlanFailure::Contact(contact));
    }
    let at_start = planner.sweep(start, true);
    let mut others: Vec<SweepPlan> = (0..POSTURES)
        .map(|number| {
            let posture = planner.other(start, number);
            planner.sweep(&posture, false)
        })
        .filter(|other| ENOUGH * other.gravity_span > at_start.gravity_span)
        .collect();
    others.sort_by(|a, b| b.gravity_span.total_cmp(&a.gravity_span));
    let mut best = at_start.clone();
    for other in others.into_iter().take(CHECKED) {
        if other.gravity_span > best.gravity_span && planner.is_way_allowed(start, &other.posture) {
            let checked = planner.sweep(&other.posture, true);
            if checked.gravity_span > best.gravity_span {
                best = checked;
            }
        }
    }
    if ENOUGH * best.gravity_span <= at_start.gravity_span {
        best = at_start;
    }
    if best.gravity_span < HAS_EFFECT * planner.bounds.torque_limits[joint] {
        let at = best.posture[joint];
        best.lower = best.lower.max(at - FURTHEST_WITHOUT_GRAVITY);
        best.upper = best.upper.min(at + FURTHEST_WITHOUT_GRAVITY);
    }
    let range = best.upper - best.lower;
    if range < LEAST_RANGE { Err(PlanFailure::Range { range }) } else { Ok(best) }
}

struct Planner<'a> {
    bounds: Bounds<'a>,
    data: Data,
    joint: usize,
}

impl Planner<'_> {
    /// Posture of a number, in which the joint is at its start.
    fn other(&self, start: &[f64], number: usize) -> Vec<f64> {
        let mut posture = Postures::new(self.bounds.model, PART_OF_RANGE).posture(number);
        posture[self.joint] = start[self.joint];
        posture
    }

    /// Torque of gravity of the joint (Nm, N), and the largest load of all.
    fn load(&mut self, q: &[f64]) -> (f64, f64) {
        forward_kinematics(self.bounds.model, &mut self.data, q);
        gravity(self.bounds.model, &mut self.data);
        let loads = self.data.gravity.iter().zip(self.bounds.torque_limits).map(|(g, limit)| g.abs() / limit);
        (self.data.gravity[self.joint], loads.fold(0.0, f64::max))
    }

    fn is_allowed(&mut self, q: &[f64]) -> bool {
        self.load(q).1 <= LARGEST_LOAD && (self.bounds.contact)(q).is_none()
    }

    fn is_way_allowed(&mut self, from: &[f64], to: &[f64]) -> bool {
        let furthest = from.iter().zip(to).map(|(a, b)| (b - a).abs()).fold(0.0, f64::max);
        let steps = (furthest / STEP).ceil().max(1.0) as usize;
        (0..=steps).all(|k| {
            let share = k as f64 / steps as f64;
            let q: Vec<f64> = from.iter().zip(to).map(|(a, b)| a + share * (b - a)).collect();
            self.is_allowed(&q)
        })
    }

    /// Plan with the other joints in a posture; contacts are checked on request.
    fn sweep(&mut self, posture: &[f64], checks_contacts: bool) -> SweepPlan {
        let model = self.bounds.model;
        let limits = &model.joints()[self.joint].limits;
        let at = posture[self.joint];
        let (first, load) = self.load(posture);
        let (mut least, mut most, mut largest_load) = (first, first, load);
        let mut ends = [at, at];
        // A start beyond the margin from a limit has no way in that direction.
        let bounds = [
            (limits.lower + FROM_LIMITS).max(at - FURTHEST).min(at),
            (limits.upper - FROM_LIMITS).min(at + FURTHEST).max(at),
        ];
        for (end, bound) in ends.iter_mut().zip(bounds) {
            let mut q = posture.to_vec();
            loop {
                let way = bound - *end;
                if way.abs() < STEP || way.signum() != (bound - at).signum() {
                    break;
                }
                q[self.joint] = *end + STEP.copysign(way);
                let (torque, load) = self.load(&q);
                if load > LARGEST_LOAD || (checks_contacts && (self.bounds.contact)(&q).is_some()) {
                    break;
                }
                *end = q[self.joint];
                (least, most) = (least.min(torque), most.max(torque));
                largest_load = largest_load.max(load);
            }
        }
        SweepPlan {
            joint: self.joint,
            posture: posture.to_vec(),
            lower: ends[0],
            upper: ends[1],
            speed: SPEED.min(SPEED_OF_LIMIT * limits.velocity),
            gravity_span: most - least,
            largest_load,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two level links of 1 kg and 0.5 m, with limits of ±1.5 rad.
    fn model() -> Model {
        let joint = |name: &str, parent: &str, child: &str, x: f64| {
            format!(
                r#"<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><origin xyz="{x} 0 0"/>
                <axis xyz="0 1 0"/><limit lower="-1.5" upper="1.5" effort="30" velocity="3"/></joint>
                <link name="{child}"><inertial><origin xyz="0.25 0 0"/><mass value="1"/>
                <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>"#
            )
        };
        let links = joint("first", "base", "upper", 0.0) + &joint("second", "upper", "lower", 0.5);
        let text = format!(r#"<robot name="arm"><link name="base"/>{links}</robot>"#);
        Model::from_urdf(&text).expect("a URDF").model
    }

    fn planned(
        torque_limits: &[f64; 2],
        contact: &mut dyn FnMut(&[f64]) -> Option<String>,
    ) -> Result<SweepPlan, PlanFailure> {
        let model = model();
        plan(Bounds { model: &model, torque_limits, contact }, &[0.0, 0.0], 1)
    }

    #[test]
    fn range_ends_before_limits_and_contacts() {
        let free = planned(&[30.0, 30.0], &mut |_| None).expect("a plan");
        assert!(free.lower > -1.5 && free.upper < 1.5, "{free:?}");
        assert!(free.upper - free.lower > 2.8, "{free:?}");
        // The second link touches something when it is raised or the first one is.
        let mut checked = |q: &[f64]| (q[0] + q[1] < -0.8).then(|| "links touch".to_owned());
        let limited = planned(&[30.0, 30.0], &mut checked).expect("a plan");
        assert!(limited.posture[0] + limited.lower >= -0.8, "{limited:?}");
    }

    /// Compares the planned span with the torque of the second link: 1 kg at 0.25 m.
    #[test]
    fn span_is_that_of_the_best_posture() {
        let weight = 9.81 * 0.25;
        let found = planned(&[30.0, 30.0], &mut |_| None).expect("a plan");
        // Level in the middle of its range, the link has almost its whole torque as span; upright or hanging, twice as much.
        assert!(found.gravity_span > 1.3 * weight, "{found:?}");
        assert!(found.gravity_span <= 2.0 * weight, "{found:?}");
    }

    #[test]
    fn start_with_contact_or_load_is_refused() {
        let contact = planned(&[30.0, 30.0], &mut |_| Some("upper and lower touch".to_owned()));
        assert!(matches!(contact, Err(PlanFailure::Contact(_))), "{contact:?}");
        let load = planned(&[10.0, 30.0], &mut |_| None);
        assert!(matches!(load, Err(PlanFailure::Load { .. })), "{load:?}");
    }
}
