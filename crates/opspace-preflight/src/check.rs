//! Table of the checks before a run: each examines an experiment and returns its diagnostics.

use super::case::PreflightCase;
use super::{
    accelerations, admittance, approach, collisions, contact, freedom, goals, half_turns, ignored_compliance,
    jumps, limits, loads, objects, overcompensation, position_limits, ramp, reserves, sensor_loads,
    setpoint_filters, speeds, stability, times, torque_floor, weak_joints,
};
use opspace_experiment::codes::Code;
use opspace_experiment::extensions::Entry;
use opspace_experiment::files::controller_kind::ControllerKind;
use opspace_experiment::finding::Finding;
use opspace_experiment::run::experiment::Experiment;
use opspace_experiment::run::rollout::Rollout;
use std::fmt;
use std::sync::Arc;

/// Check of an experiment before a run.
#[derive(Clone)]
pub struct Check {
    /// Name of the check.
    pub name: &'static str,
    /// Problems that it finds, for example "gains too high for the rate".
    pub finds: &'static str,
    /// Condition under which it is made.
    condition: Condition,
    examine: Examine,
}

/// Condition under which a check is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Condition {
    /// Always.
    Always,
    /// With torque control.
    Torque,
    /// If no reference is out of reach: such a reference would require arbitrary speeds and torques.
    InReach,
    /// With torque control, if no reference is out of reach.
    TorqueInReach,
}

type OfStart = fn(&PreflightCase<'_>) -> Vec<Finding>;
type OfReferences = fn(&Preflight<'_>) -> Vec<Finding>;
type Added = dyn Fn(&Experiment) -> Vec<Finding> + Send + Sync;

#[derive(Clone)]
enum Examine {
    /// Examines the start posture, gains and contacts.
    Start(OfStart),
    /// Examines the references, too.
    References(OfReferences),
    /// Check of the program.
    Added(Arc<Added>),
}

/// Experiment whose references are rolled out, and the diagnostics so far.
pub(super) struct Preflight<'a> {
    pub(super) case: PreflightCase<'a>,
    pub(super) rollout: Rollout,
    /// Diagnostics of references that are out of reach.
    out_of_reach: Vec<Finding>,
    found: Vec<Finding>,
}

impl Preflight<'_> {
    fn has_found(&self, code: Code) -> bool {
        self.found.iter().any(|finding| finding.code == code)
    }
}

impl Check {
    /// Creates a check that `examine` makes before each run.
    #[must_use]
    pub fn new(
        name: &'static str,
        finds: &'static str,
        examine: impl Fn(&Experiment) -> Vec<Finding> + Send + Sync + 'static,
    ) -> Self {
        Self { name, finds, condition: Condition::Always, examine: Examine::Added(Arc::new(examine)) }
    }

    const fn start(name: &'static str, finds: &'static str, condition: Condition, examine: OfStart) -> Self {
        Self { name, finds, condition, examine: Examine::Start(examine) }
    }

    const fn references(
        name: &'static str,
        finds: &'static str,
        condition: Condition,
        examine: OfReferences,
    ) -> Self {
        Self { name, finds, condition, examine: Examine::References(examine) }
    }

    fn is_of_start(&self) -> bool {
        !matches!(self.examine, Examine::References(_))
    }
}

impl Condition {
    fn is_met(self, experiment: &Experiment, in_reach: bool) -> bool {
        let torque = experiment.options().controller == ControllerKind::Osc;
        match self {
            Self::Always => true,
            Self::Torque => torque,
            Self::InReach => in_reach,
            Self::TorqueInReach => torque && in_reach,
        }
    }
}

/// The built-in checks, in the order of their diagnostics.
static BUILT_IN: &[Check] = &[
    Check::start(
        "limits",
        "limits that contradict each other, the start posture or the arm's weight",
        Condition::Always,
        limits::of_start,
    ),
    Check::start(
        "weak-joints",
        "torque limits that do not fit friction, rotors or the arm's weight",
        Condition::Always,
        |case| weak_joints::weak_joints(case.experiment.robot()),
    ),
    Check::start(
        "objects",
        "a start inside an object of the environment; objects out of reach",
        Condition::Always,
        objects::misplaced,
    ),
    Check::start(
        "sensor-loads",
        "force sensors whose load is unknown, because joints move what is beyond them",
        Condition::Always,
        sensor_loads::unknown,
    ),
    Check::start(
        "half-turns",
        "continuous joints that are half a turn away from their goal",
        Condition::Always,
        half_turns::of_goals,
    ),
    Check::start("singular-start", "a start at a singularity", Condition::Always, freedom::singular_start),
    Check::start("collision-at-start", "a start in collision", Condition::Torque, |case| {
        collisions::at_start(case).into_iter().collect()
    }),
    Check::start("uncontrolled-freedom", "degrees of freedom without a task", Condition::Torque, |case| {
        freedom::uncontrolled(case).into_iter().collect()
    }),
    Check::start("drift", "compliant axes that nothing brings back", Condition::Torque, freedom::drifting),
    Check::start(
        "stability",
        "gains too high for the rate, the delay and the servo",
        Condition::Torque,
        stability::stiff_gains,
    ),
    Check::start(
        "contact",
        "force axes whose contact would oscillate, or whose impact exceeds torque limits",
        Condition::Torque,
        contact::contacts,
    ),
    Check::start(
        "ignored-compliance",
        "impedances and compliant axes that inverse kinematics ignores, or the default transformer damps",
        Condition::Always,
        ignored_compliance::ignored,
    ),
    Check::start(
        "admittance",
        "force axes of inverse kinematics that oscillate on the objects of the environment",
        Condition::Always,
        admittance::unstable_contacts,
    ),
    Check::start("torque-floor", "velocity feed-forward with held setpoints", Condition::Always, |case| {
        torque_floor::feed_forward_impulses(case.experiment).into_iter().collect()
    }),
    Check::start(
        "setpoint-limits",
        "limits of setpoints that leave a small bandwidth to the torque",
        Condition::Torque,
        |case| torque_floor::narrow_limits(case.experiment).into_iter().collect(),
    ),
    Check::start(
        "resolutions",
        "encoders and setpoints whose resolution causes large torque errors",
        Condition::Torque,
        |case| torque_floor::coarse(case.experiment),
    ),
    Check::start(
        "friction",
        "compensation of more friction than the simulated joints have",
        Condition::Torque,
        |case| overcompensation::overcompensation(case).into_iter().collect(),
    ),
    Check::start(
        "setpoint-filters",
        "filters of setpoints that are too slow for the torque",
        Condition::Torque,
        |case| setpoint_filters::slow(case.experiment).into_iter().collect(),
    ),
    Check::references("jumps", "references that jump", Condition::InReach, |p| {
        jumps::of_references(&p.case, &p.rollout).into_iter().collect()
    }),
    Check::references(
        "limits-of-postures",
        "rest postures and goals at or beyond the position limits",
        Condition::Always,
        |p| limits::of_postures(&p.case, &p.rollout),
    ),
    // A jump explains speeds, accelerations and torques.
    Check::references("joint-speeds", "references faster than the joints", Condition::InReach, |p| {
        let found = || speeds::of_joints(&p.case, &p.rollout).into_iter().collect();
        if p.has_found(Code::ReferenceJump) { Vec::new() } else { found() }
    }),
    Check::references(
        "accelerations",
        "references that need more acceleration or torque of a joint than its limits",
        Condition::TorqueInReach,
        |p| {
            let found = || accelerations::of_joints(&p.case, &p.rollout);
            if p.has_found(Code::ReferenceJump) { Vec::new() } else { found() }
        },
    ),
    Check::references(
        "ramp",
        "references that move fast while the torque ramps in",
        Condition::TorqueInReach,
        |p| {
            let found = || ramp::of_references(&p.case, &p.rollout).into_iter().collect();
            if p.has_found(Code::ReferenceJump) { Vec::new() } else { found() }
        },
    ),
    Check::references(
        "approach",
        "force axes that press away from every surface, or reach one after the run",
        Condition::Always,
        |p| approach::of_force_axes(&p.case, &p.rollout),
    ),
    Check::references("target-forces", "target forces that a joint cannot exert", Condition::InReach, |p| {
        reserves::forces_above_limits(&p.case, &p.rollout).into_iter().collect()
    }),
    Check::references(
        "loads",
        "loads of the environment that a joint cannot hold",
        Condition::InReach,
        |p| loads::too_heavy(&p.case, &p.rollout),
    ),
    Check::references(
        "weight-on-the-way",
        "weight above the torque limits along the references",
        Condition::InReach,
        |p| limits::on_the_way(&p.case, &p.rollout),
    ),
    Check::references(
        "position-limits",
        "references that the position limits keep the task from, on the way from the start",
        Condition::InReach,
        |p| {
            // Targets beyond the limits explain themselves.
            let beyond = || position_limits::beyond_on_the_way(&p.case, &p.rollout);
            if p.has_found(Code::TargetBeyondLimits) { Vec::new() } else { beyond().into_iter().collect() }
        },
    ),
    Check::references(
        "goals",
        "references that are out of reach, or reachable only beyond the joint position limits",
        Condition::Always,
        |p| p.out_of_reach.clone(),
    ),
    Check::references(
        "collisions-on-the-way",
        "references in collision with an obstacle or the arm itself",
        Condition::Torque,
        |p| collisions::on_the_way(&p.case, &p.rollout),
    ),
    Check::references(
        "task-speeds",
        "references faster than the speed limit of the task",
        Condition::Always,
        |p| speeds::of_tasks(&p.case, &p.rollout),
    ),
    Check::references("times", "events and references that end after the run", Condition::Always, |p| {
        times::too_short(&p.case, &p.rollout)
    }),
];

impl Entry for Check {
    const KIND: &'static str = "check";

    fn built_in() -> &'static [Self] {
        BUILT_IN
    }

    fn name(&self) -> &str {
        self.name
    }
}

impl fmt::Debug for Check {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

/// Diagnostics of an experiment by these checks.
pub(super) fn diagnostics<'a>(
    experiment: &Experiment,
    checks: impl Iterator<Item = &'a Check>,
) -> Vec<Finding> {
    let Some(case) = PreflightCase::new(experiment) else { return Vec::new() };
    let rollout = Rollout::new(&case.rollout());
    let out_of_reach = goals::out_of_reach(&case, &rollout);
    let mut preflight = Preflight { case, rollout, out_of_reach, found: Vec::new() };
    for check in checks {
        if check.condition.is_met(experiment, preflight.out_of_reach.is_empty()) {
            let found = match &check.examine {
                Examine::Start(examine) => examine(&preflight.case),
                Examine::References(examine) => examine(&preflight),
                Examine::Added(examine) => examine(experiment),
            };
            preflight.found.extend(found);
        }
    }
    preflight.found
}

/// Diagnostics of an experiment by those of these checks that do not follow the references.
pub(super) fn start_diagnostics<'a>(
    experiment: &Experiment,
    checks: impl Iterator<Item = &'a Check>,
) -> Vec<Finding> {
    let Some(case) = PreflightCase::new(experiment) else { return Vec::new() };
    let made = checks.filter(|check| check.is_of_start() && check.condition.is_met(experiment, true));
    let found = made.map(|check| match &check.examine {
        Examine::Start(examine) => examine(&case),
        Examine::Added(examine) => examine(experiment),
        Examine::References(_) => Vec::new(),
    });
    found.flatten().collect()
}
