//! Additional requirements for a real robot: it must be at the start position of the task, and options that are only
//! for comparisons are rejected.

use crate::codes::Code;
use crate::extensions::Extensions;
use crate::files::controller_kind::ControllerKind;
use crate::files::source::{FileError, Source};
use crate::files::task::TaskDefinition;
use crate::run::comparisons::comparison_only;
use crate::run::error::RunError;
use crate::run::experiment::{Experiment, RunOptions};
use opspace_backend::{Backend, CommandKind, DeviceFault, Sample};
use opspace_loop::driver_calls::read_once;
use opspace_model::{Joint, JointKind};
use std::fmt::Write;
use std::path::Path;

/// Tolerance of the joints' start positions on a real robot, rad (m).
const START_TOLERANCE: f64 = 0.02;

/// Highest joint speed on the way to the start, rad/s and m/s.
const SPEED_RAD_PER_S: f64 = 0.2;
const SPEED_M_PER_S: f64 = 0.05;
/// Highest joint speed on the way to the start, as a fraction of the joint's velocity limit.
const SPEED_SHARE: f64 = 0.1;
/// Ratio of peak velocity to mean velocity of a minimum-jerk motion.
const MINIMUM_JERK_PEAK: f64 = 1.875;
/// Minimum duration of the motion, and settling time after it, s.
const SHORTEST_S: f64 = 1.0;
const SETTLE_S: f64 = 1.0;
/// Natural frequency of the joint position error on torque and velocity robots, rad/s. It is high because friction
/// leaves an error, but at most `FREQUENCY_SHARE` divided by the interface period.
const FREQUENCY_RAD_PER_S: f64 = 30.0;
const FREQUENCY_SHARE: f64 = 0.06;

impl Experiment {
    /// Rejects options that are only for comparisons.
    ///
    /// # Errors
    /// The first of these options, at its key.
    pub(super) fn refuse_comparison_options(&self) -> Result<(), FileError> {
        let simulation_only = self.transformer_traits().is_some_and(|traits| traits.simulation_only);
        if let Some(name) = self.transformer_name().filter(|_| simulation_only) {
            let message =
                format!("transformer '{name}' is only for comparisons in simulation, not for a real robot");
            let help = Some("use 'identified' or 'emulation'".to_owned());
            let key = ["profile", &self.profile_name];
            let found = FileError::at_key(&self.robot.source, key, message, help);
            return Err(found.refused(Code::ComparisonOnly));
        }
        if let Some(key) = comparison_only(&self.task) {
            let message =
                "this handling of singularities is only for comparisons in simulation, not for a real robot";
            let help = Some("omit it, or use \"damped\"".to_owned());
            let found = FileError::at_key(&self.task.source, key, message, help);
            return Err(found.refused(Code::ComparisonOnly));
        }
        Ok(())
    }

    /// Checks that a real robot is at the start position of the task, so that its setpoints do not jump.
    pub(crate) fn check_start(&self, backend: &mut dyn Backend) -> Result<(), RunError> {
        match self.joint_away_from_start(backend)? {
            None => Ok(()),
            Some((joint, q_rad, start_rad)) => Err(RunError::AwayFromStart { joint, q_rad, start_rad }),
        }
    }

    /// Checks that a motion to the start position of the task has led there.
    ///
    /// # Errors
    /// The first joint that is elsewhere.
    pub fn check_start_reached(&self, backend: &mut dyn Backend) -> Result<(), RunError> {
        match self.joint_away_from_start(backend)? {
            None => Ok(()),
            Some((joint, q_rad, start_rad)) => Err(RunError::StartNotReached { joint, q_rad, start_rad }),
        }
    }

    /// First joint that is not at its start position, with its position and start (rad or m).
    fn joint_away_from_start(
        &self,
        backend: &mut dyn Backend,
    ) -> Result<Option<(String, f64, f64)>, RunError> {
        let q = positions(backend)?;
        let joints = self.robot.model.joints().iter();
        let away = joints.zip(self.start()?).zip(q).find(|((_, start), q)| !is_at(*q, *start));
        Ok(away.map(|((joint, start_rad), q_rad)| (joint.name.clone(), q_rad, start_rad)))
    }

    /// Returns an experiment that moves the robot from `q` (n; rad or m) to the start position of this experiment:
    /// along a straight line in joint space, at most 0.2 rad/s (0.05 m/s) and at most a tenth of the velocity limit
    /// in the URDF. Obstacles are not considered. `None` if the robot is already there.
    ///
    /// # Errors
    /// A position outside a joint's limits by more than the tolerance of start positions, 0.02 rad (m): an arm that lies on its end
    /// stops may be slightly outside.
    pub fn motion_to_start(&self, q: &[f64]) -> Result<Option<Self>, FileError> {
        let goal = self.start()?;
        let q = &self.within_limits(q)?;
        if q.iter().zip(&goal).all(|(q, goal)| is_at(*q, *goal)) {
            return Ok(None);
        }
        let joints = self.robot.model.joints();
        let durations = joints.iter().zip(q).zip(&goal);
        let motion_s = durations.fold(SHORTEST_S, |longest, ((joint, q), goal)| {
            longest.max(MINIMUM_JERK_PEAK * (goal - q).abs() / slow_speed(joint))
        });
        // The name places the file in the folder of the task, so that the robot's relative path stays valid.
        let name = Path::new(self.task.source.name()).with_file_name("move-to-start.toml");
        let text = self.motion_text(q, &goal, motion_s);
        let task = TaskDefinition::from_sources_with::<FileError>(
            &Extensions::default(),
            Source::new(name.display().to_string(), text),
            |named| Source::read(&named.path),
        )?;
        let controller = match self.options.backend {
            CommandKind::Position => ControllerKind::IkLead,
            CommandKind::Velocity | CommandKind::Torque => ControllerKind::Osc,
        };
        let options = RunOptions { controller, duration_s: None, label: None, ..self.options.clone() };
        self.with_parts(self.robot.clone(), task, options).map(Some)
    }

    /// Positions (n; rad or m) within the limits of the joints.
    fn within_limits(&self, q: &[f64]) -> Result<Vec<f64>, FileError> {
        let joints = self.robot.model.joints().iter().zip(q);
        let within = |(joint, &q): (&Joint, &f64)| {
            let (lower, upper) = (joint.limits.lower, joint.limits.upper);
            let inside = q.max(lower).min(upper);
            if is_at(q, inside) {
                return Ok(inside);
            }
            let message =
                format!("joint '{}' is at {q:.3} rad (m), outside its limits {lower} to {upper}", joint.name);
            let help = "switch its torque off and move it by hand: `opspace driver read` shows its position";
            Err(FileError::of_file(self.robot.source.name(), message, Some(help.to_owned())))
        };
        joints.map(within).collect()
    }

    /// Text of the task file of a motion from `q` to `goal`.
    fn motion_text(&self, q: &[f64], goal: &[f64], motion_s: f64) -> String {
        let list = |values: &[f64]| {
            let named = self.robot.model.joints().iter().zip(values);
            let entries: Vec<String> =
                named.map(|(joint, value)| format!("{:?} = {value:?}", joint.name)).collect();
            entries.join(", ")
        };
        let file = &self.task.file;
        let frequency_rad_per_s = FREQUENCY_RAD_PER_S.min(FREQUENCY_SHARE / self.profile.period_s());
        let mut text = String::new();
        let _ = writeln!(
            text,
            "# Moves the robot from its present position to the start of {}.",
            self.task.name()
        );
        let _ = writeln!(text, "robot = {:?}", file.robot.display().to_string());
        let _ = writeln!(text, "duration_s = {:?}", motion_s + SETTLE_S);
        let _ = writeln!(text, "priority = [\"joints\"]");
        let _ = writeln!(text, "friction_compensation.gain = {:?}", file.friction_compensation.gain.get());
        let _ = writeln!(text, "start_rad = {{ {} }}\n", list(q));
        let _ = writeln!(text, "[task.joints.joint-tracking]");
        let _ = writeln!(
            text,
            "gains = {{ frequency_rad_per_s = {frequency_rad_per_s:?}, damping_ratio = 1.0 }}"
        );
        let _ = writeln!(
            text,
            "reference.point-to-point = {{ duration_s = {motion_s:?}, goal.absolute_rad = {{ {} }} }}",
            list(goal)
        );
        text
    }
}

/// True if a joint is at its start position; false for NaN.
fn is_at(q: f64, start: f64) -> bool {
    (q - start).abs() < START_TOLERANCE
}

/// Reads the current joint positions of a robot (n; rad or m).
pub fn positions(backend: &mut dyn Backend) -> Result<Vec<f64>, RunError> {
    let mut sample = Sample::new(backend.capabilities());
    let read = read_once(backend, &mut sample).and_then(|()| match sample.q.iter().all(|q| q.is_finite()) {
        true => Ok(()),
        false => Err(DeviceFault::new(0, "a joint position is not a finite number")),
    });
    read.map_err(|fault| RunError::Unreadable { fault })?;
    Ok(sample.q)
}

/// Highest speed of a joint on the way to the start, rad/s or m/s.
fn slow_speed(joint: &Joint) -> f64 {
    let slow = match joint.kind {
        JointKind::Prismatic => SPEED_M_PER_S,
        _ => SPEED_RAD_PER_S,
    };
    if joint.limits.velocity > 0.0 { slow.min(SPEED_SHARE * joint.limits.velocity) } else { slow }
}
