//! The tasks that lead a frame or the centre of mass, as what is looked for needs them.

use nalgebra::{Matrix6xX, Vector6};
use opspace_control::rank::characteristic_length;
use opspace_control::{CartesianParameters, Directions, Subject, TaskAxes, TaskParameters, orientation};
use opspace_model::{Data, Model, Placement};
use std::borrow::Cow;
use std::collections::BTreeMap;

/// A task that leads a frame, or the centre of mass.
pub(crate) struct Motion<'a> {
    pub name: &'a str,
    pub kind: &'static str,
    pub parameters: Cow<'a, CartesianParameters>,
    pub subject: Subject,
    directions: Directions,
    length_m: f64,
}

/// Those of a stack, in the order of priority.
pub(crate) fn motions<'a>(
    priority: &'a [String],
    task: &'a BTreeMap<String, TaskParameters>,
    model: &Model,
) -> Vec<Motion<'a>> {
    priority.iter().filter_map(|name| Motion::new(name, task.get(name)?, model)).collect()
}

impl<'a> Motion<'a> {
    fn new(name: &'a str, parameters: &'a TaskParameters, model: &Model) -> Option<Self> {
        let (kind, parameters, subject) = match parameters {
            TaskParameters::Cartesian(p) => ("cartesian", Cow::Borrowed(&**p), p.subject(model).ok()?),
            TaskParameters::CenterOfMass(p) => {
                ("center-of-mass", Cow::Owned(p.as_cartesian()), Subject::CenterOfMass)
            }
            _ => return None,
        };
        let directions = parameters.axes_in.resolve(model, subject).ok()?;
        let given = parameters.characteristic_length_m.map(|length| length.get());
        let length_m = given.unwrap_or_else(|| characteristic_length(model, subject));
        Some(Self { name, kind, parameters, subject, directions, length_m })
    }

    /// What it leads, as a person would say it.
    pub(crate) fn led(&self) -> String {
        match self.subject {
            Subject::CenterOfMass => "the centre of mass".to_owned(),
            _ => format!("'{}'", self.parameters.frame),
        }
    }

    /// Those of its axes, at a state.
    pub(crate) fn axes(&self, model: &Model, data: &Data, of: [bool; 6]) -> TaskAxes {
        TaskAxes::new(self.subject, self.directions.rotation(model, data, self.subject), of, self.length_m)
    }

    /// The rows of some axes (6 × n), scaled: the first [`TaskAxes::rows`] of them.
    pub(crate) fn rows(&self, model: &Model, data: &Data, axes: &TaskAxes) -> Matrix6xX<f64> {
        let (mut world, mut rows) = (Matrix6xX::zeros(model.n()), Matrix6xX::zeros(model.n()));
        self.subject.jacobian(model, data, &mut world);
        axes.select(&world, &mut rows);
        rows
    }

    /// By how far `target` is away (m, rad; along and about the task's axes), as the task itself counts it: turns
    /// only about axes in motion.
    pub(crate) fn error(&self, model: &Model, data: &Data, target: &Placement) -> Vector6<f64> {
        let motion = self.parameters.motion_axes();
        let axes = self.directions.rotation(model, data, self.subject);
        let placement = self.subject.placement(model, data);
        let linear = axes.tr_mul(&(target.translation - placement.translation));
        let turn = axes.transpose() * target.rotation * placement.rotation.transpose() * axes;
        let angular = orientation::log_about(&turn, [motion[3], motion[4], motion[5]]);
        let error = Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z);
        Vector6::from_fn(|axis, _| if motion[axis] { error[axis] } else { 0.0 })
    }
}
