//! References of a joint-tracking task. Each begins, at time 0, at the posture at which the controller is
//! started; joints that aren't named stay there.

use crate::error::{ControlError, Reason};
use crate::per_joint::indices;
use crate::quantity::{NonNegative, Positive};
use crate::ramp::{minimum_jerk, product};
use crate::reference::default_ramp_s;
use crate::wave::{self, AngularWave, Wave};
use nalgebra::DVector;
use opspace_model::Model;
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::BTreeMap;

/// Where a joint-tracking task should lead the joints.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum JointReference {
    /// Stays at the start posture.
    Hold,
    /// Goes to one posture and stays there.
    PointToPoint(JointPointToPoint),
    /// Swings about the start posture.
    Sinusoid(JointSinusoid),
    /// Goes from posture to posture and stops at each.
    Waypoints(Vec<JointWaypoint>),
}

/// A minimum-jerk motion to one posture.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JointPointToPoint {
    /// Where to.
    pub goal: JointGoal,
    /// How long the motion takes, s.
    pub duration_s: Positive,
    /// When it sets out, s after the start; 0 if absent.
    #[serde(default)]
    pub start_s: NonNegative,
}

/// A posture to be at, reached with minimum jerk from the one before.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JointWaypoint {
    /// When to be there, s after the start.
    pub time_s: Positive,
    /// Where; joints that aren't named stay where they were.
    pub goal: JointGoal,
}

/// A posture to reach, by joint names.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
pub enum JointGoal {
    /// Joint positions, rad (m for a prismatic joint).
    #[serde(rename = "absolute_rad")]
    Absolute(BTreeMap<String, f64>),
    /// From the start posture, rad (m for a prismatic joint).
    #[serde(rename = "offset_rad")]
    Offset(BTreeMap<String, f64>),
}

/// Sums of sines, added to the start posture.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JointSinusoid {
    /// The sines of each joint, by its name.
    pub joints: BTreeMap<String, Vec<AngularWave>>,
    /// For how long the sines are faded in by the minimum-jerk ramp, s; 1 if absent.
    #[serde(default = "default_ramp_s")]
    pub ramp_s: Positive,
}

/// A [`JointReference`] ready to be followed.
#[derive(Clone, Debug)]
pub(crate) struct JointTrajectory {
    start: DVector<f64>,
    path: Path,
}

#[derive(Clone, Debug)]
enum Path {
    Legs(Vec<Leg>),
    Waves { joints: Vec<Vec<Wave>>, ramp_s: f64 },
}

#[derive(Clone, Debug)]
struct Leg {
    begin_s: f64,
    end_s: f64,
    goal: Vec<Goal>,
    from: DVector<f64>,
    to: DVector<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Goal {
    joint: usize,
    value: f64,
    from_start: bool,
}

impl JointTrajectory {
    /// `key` is where the reference stands in the file.
    pub(crate) fn new(reference: &JointReference, model: &Model, key: &str) -> Result<Self, ControlError> {
        let path = match reference {
            JointReference::Hold => Path::Legs(Vec::new()),
            JointReference::PointToPoint(p) => {
                let goal = goals(&p.goal, model, &format!("{key}.point-to-point.goal"))?;
                let begin_s = p.start_s.get();
                Path::Legs(vec![Leg::new(begin_s, begin_s + p.duration_s.get(), goal, model.n())])
            }
            JointReference::Waypoints(list) => {
                let key = format!("{key}.waypoints");
                check_times(list.iter().map(|w| w.time_s.get()), &key)?;
                let mut begin_s = 0.0;
                let mut legs = Vec::with_capacity(list.len());
                for w in list {
                    let goal = goals(&w.goal, model, &format!("{key}.goal"))?;
                    legs.push(Leg::new(begin_s, w.time_s.get(), goal, model.n()));
                    begin_s = w.time_s.get();
                }
                Path::Legs(legs)
            }
            JointReference::Sinusoid(s) => {
                let mut joints = vec![Vec::new(); model.n()];
                for (joint, waves) in indices(model, &format!("{key}.sinusoid.joints"), &s.joints)? {
                    joints[joint] = waves.iter().map(Wave::from).collect();
                }
                Path::Waves { joints, ramp_s: s.ramp_s.get() }
            }
        };
        Ok(Self { start: DVector::zeros(model.n()), path })
    }

    /// Begins at `q` (n).
    pub(crate) fn start(&mut self, q: &DVector<f64>) {
        self.start.copy_from(q);
        if let Path::Legs(legs) = &mut self.path {
            let mut from = q.clone();
            for leg in legs {
                leg.from.copy_from(&from);
                for goal in &leg.goal {
                    let base = if goal.from_start { q[goal.joint] } else { 0.0 };
                    from[goal.joint] = base + goal.value;
                }
                leg.to.copy_from(&from);
            }
        }
    }

    /// Position, velocity and acceleration of a joint at `time_s` after the start.
    pub(crate) fn at(&self, joint: usize, time_s: f64) -> [f64; 3] {
        let start = self.start[joint];
        match &self.path {
            Path::Legs(legs) => match legs.iter().rev().find(|leg| leg.begin_s <= time_s) {
                None => [start, 0.0, 0.0],
                Some(leg) => {
                    let [s, ds, dds] = minimum_jerk(time_s - leg.begin_s, leg.end_s - leg.begin_s);
                    let (from, way) = (leg.from[joint], leg.to[joint] - leg.from[joint]);
                    [from + way * s, way * ds, way * dds]
                }
            },
            Path::Waves { joints, ramp_s } => {
                let ramp = minimum_jerk(time_s, *ramp_s);
                let [q, dq, ddq] = product(ramp, wave::sum(&joints[joint], time_s));
                [start + q, dq, ddq]
            }
        }
    }
}

impl Leg {
    fn new(begin_s: f64, end_s: f64, goal: Vec<Goal>, n: usize) -> Self {
        Self { begin_s, end_s, goal, from: DVector::zeros(n), to: DVector::zeros(n) }
    }
}

fn goals(goal: &JointGoal, model: &Model, key: &str) -> Result<Vec<Goal>, ControlError> {
    let (map, from_start, kind) = match goal {
        JointGoal::Absolute(map) => (map, false, "absolute_rad"),
        JointGoal::Offset(map) => (map, true, "offset_rad"),
    };
    let named = indices(model, &format!("{key}.{kind}"), map)?;
    Ok(named.into_iter().map(|(joint, &value)| Goal { joint, value, from_start }).collect())
}

/// Waypoints must exist and go forward in time. `key` is where their list stands in the file.
pub(crate) fn check_times(times: impl Iterator<Item = f64>, key: &str) -> Result<(), ControlError> {
    let mut previous_s = 0.0;
    let mut count = 0;
    for (index, time_s) in times.enumerate() {
        if time_s <= previous_s {
            return Err(ControlError::new(key, Reason::WaypointTime { index, time_s, previous_s }));
        }
        previous_s = time_s;
        count += 1;
    }
    if count == 0 { Err(ControlError::new(key, Reason::NoWaypoint)) } else { Ok(()) }
}
