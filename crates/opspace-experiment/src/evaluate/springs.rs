//! Impedances that rest away from their references: which spring, and what holds it.

use crate::codes::Code;
use crate::evaluate::notes::REACHED;
use crate::files::controller_kind::ControllerKind;
use crate::finding::{Causes, Finding, Place, errors};
use crate::metrics::metric_tables::TaskMetrics;
use crate::run::experiment::Experiment;
use crate::text::format_short;
use nalgebra::Matrix6xX;
use opspace_control::{AXIS_NAMES, AxesFrameParameter, AxisMode, CartesianParameters, TaskParameters};
use opspace_log::OutcomeRecord;
use opspace_model::{Data, frame_jacobian, update};
use std::collections::BTreeMap;

/// Lever of a joint that counts, relative to that of the joint with the longest one.
const MIN_LEVER: f64 = 0.3;

/// Softest spring of an impedance in one unit, with its deflection at the end of a run.
struct Spring {
    axis: usize,
    /// N/m or Nm/rad.
    stiffness: f64,
    /// m or rad.
    deflection: f64,
}

/// Joint whose friction holds a spring.
struct Friction {
    joint: String,
    /// Static friction, Nm.
    friction_nm: f64,
    /// Largest torque of the spring on the joint, Nm.
    spring_nm: f64,
}

impl Spring {
    fn text(&self) -> String {
        let unit = if self.axis < 3 { "N/m" } else { "Nm/rad" };
        format!("a spring of {} {unit} along {}", format_short(self.stiffness), AXIS_NAMES[self.axis])
    }

    /// Force or torque of the spring.
    fn pull(&self) -> String {
        let unit = if self.axis < 3 { "N" } else { "Nm" };
        format!("{} {unit}", format_short(self.stiffness * self.deflection))
    }
}

impl Experiment {
    /// Describes the impedances of a completed run that rest away from their references at its end.
    pub(crate) fn deflected_springs(
        &self,
        metrics: &BTreeMap<String, TaskMetrics>,
        outcome: &OutcomeRecord,
    ) -> Vec<Finding> {
        if self.options().controller != ControllerKind::Osc || outcome.fault.is_some() || outcome.interrupted
        {
            return Vec::new();
        }
        let tasks = self.task().tasks_of_the_run().into_iter();
        let deflected = |(name, task): (&str, &TaskParameters)| match task {
            TaskParameters::Cartesian(task) => self.deflected_spring(name, task, metrics.get(name)?),
            _ => None,
        };
        tasks.filter_map(|(name, task)| deflected((name, task))).collect()
    }

    fn deflected_spring(
        &self,
        name: &str,
        task: &CartesianParameters,
        metrics: &TaskMetrics,
    ) -> Option<Finding> {
        let impedance = task.impedance.as_ref()?;
        let motion = task.axes.with_mode(AxisMode::Motion);
        let finals = [metrics.pose.position_final_m, metrics.pose.orientation_final_rad];
        let stiffnesses = [&impedance.stiffness_n_per_m, &impedance.stiffness_nm_per_rad];
        let spring = (0..2).find_map(|unit| {
            let deflection = finals[unit].filter(|error| *error > REACHED[unit])?;
            let stiffness = |axis: usize| stiffnesses[unit].as_ref()?.get(axis).map(|value| value.get());
            let axes = (3 * unit..3 * unit + 3).filter(|&axis| motion[axis]);
            let softest = axes
                .filter_map(|axis| Some((axis, stiffness(axis).filter(|stiffness| *stiffness > 0.0)?)))
                .min_by(|a, b| a.1.total_cmp(&b.1))?;
            Some(Spring { axis: softest.0, stiffness: softest.1, deflection })
        })?;
        let environment: Vec<String> =
            self.task().file.environment.keys().map(|name| format!("'{name}'")).collect();
        let friction = self.friction_against(task, &spring);
        let [position_m, orientation_rad] = finals;
        let key = if spring.axis < 3 { "stiffness_n_per_m" } else { "stiffness_nm_per_rad" };
        // Friction that is smaller than the torque of the spring in every joint does not hold it: something of the environment does.
        let is_held_by_friction =
            friction.as_ref().is_some_and(|friction| friction.friction_nm >= friction.spring_nm);
        if !environment.is_empty() && !is_held_by_friction {
            let message = format!(
                "task '{name}': {} pulls with {} against {} of the environment, {} from its goal at the end",
                spring.text(),
                spring.pull(),
                environment.join(" or "),
                errors(position_m, orientation_rad)
            );
            let help = format!(
                "nothing, if it is to press or to yield: `task.{name}.cartesian.impedance.{key}` and the reference set the force; otherwise \
                 end the reference before the object"
            );
            let finding =
                Finding { help, ..Finding::of(Code::SpringDeflected, Place::Task(name.to_owned()), message) };
            return Some(
                finding
                    .with("position_m", position_m)
                    .with("orientation_rad", orientation_rad)
                    .with(key, Some(spring.stiffness)),
            );
        }
        let gain = self.task().file.friction_compensation.gain.get();
        let compensated =
            if gain > 0.0 { format!(" ({:.0} % of it compensated)", 100.0 * gain) } else { String::new() };
        let cause = match &friction {
            Some(friction) => format!(
                "friction of up to {} Nm in {}{compensated} over {}, which pulls with {}, at most {} Nm there",
                format_short(friction.friction_nm),
                friction.joint,
                spring.text(),
                spring.pull(),
                format_short(friction.spring_nm)
            ),
            None => format!("{}, which pulls with {}, is held", spring.text(), spring.pull()),
        };
        let others = match environment[..] {
            [] => String::new(),
            _ => format!("; or {} of the environment", environment.join(", ")),
        };
        let message = format!(
            "task '{name}': {} from the goal of its spring at the end: {cause}{others}",
            errors(position_m, orientation_rad)
        );
        let friction_remedy = match gain {
            gain if gain < 1.0 && friction.is_some() => {
                "compensate more friction (`--set friction_compensation.gain=1.0`), "
            }
            _ => "",
        };
        let help = format!(
            "{friction_remedy}or stiffen the spring: `task.{name}.cartesian.impedance.{key}`; a spring always yields to what pulls at it"
        );
        let help = help.strip_prefix("or ").unwrap_or(&help).to_owned();
        let causes = Causes {
            friction: friction.iter().map(|friction| friction.joint.clone()).collect(),
            ..Causes::default()
        };
        let finding = Finding {
            help,
            causes,
            ..Finding::of(Code::SpringDeflected, Place::Task(name.to_owned()), message)
        };
        Some(
            finding
                .with("position_m", position_m)
                .with("orientation_rad", orientation_rad)
                .with(key, Some(spring.stiffness))
                .with("friction_nm", friction.as_ref().map(|friction| friction.friction_nm))
                .with("spring_torque_nm", friction.as_ref().map(|friction| friction.spring_nm)),
        )
    }

    /// Joint with the most friction against the torque of a spring, at the start of the task; `None` without friction.
    fn friction_against(&self, task: &CartesianParameters, spring: &Spring) -> Option<Friction> {
        let model = &self.robot().model;
        let frame = model.frame_id(&task.frame).ok()?;
        let mut data = Data::new(model);
        update(model, &mut data, &self.start().ok()?, &vec![0.0; model.n()]).then_some(())?;
        let mut jacobian = Matrix6xX::zeros(model.n());
        frame_jacobian(model, &data, frame, &mut jacobian);
        // Directions of other axes than those of the world may move with the arm.
        let lever = |joint: usize| match task.axes_frame {
            AxesFrameParameter::World => jacobian[(spring.axis, joint)].abs(),
            _ => jacobian.column(joint).rows(3 * (spring.axis / 3), 3).norm(),
        };
        let levers: Vec<f64> = (0..model.n()).map(lever).collect();
        let longest = levers.iter().copied().fold(0.0, f64::max);
        let pull = spring.stiffness * spring.deflection;
        let joints = model.joints().iter().zip(self.robot().joints()).zip(&levers);
        let counted = joints.filter(|(_, lever)| **lever > MIN_LEVER * longest);
        let of_joint = counted.map(|((joint, parameters), lever)| Friction {
            joint: joint.name.clone(),
            friction_nm: parameters.friction.static_nm.get().max(parameters.friction.coulomb_nm.get()),
            spring_nm: pull * lever,
        });
        let with_friction = of_joint.filter(|joint| joint.friction_nm > 0.0 && joint.spring_nm > 0.0);
        with_friction.max_by(|a, b| (a.friction_nm / a.spring_nm).total_cmp(&(b.friction_nm / b.spring_nm)))
    }
}
