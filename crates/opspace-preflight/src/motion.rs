//! Tasks that control a frame or the centre of mass, in the form required by the other checks.

use nalgebra::Matrix3;
use opspace_control::{AxesFrame, CartesianParameters, ControlledFrame, TaskParameters};
use opspace_model::{Data, Model};
use std::borrow::Cow;
use std::collections::BTreeMap;

/// A task that controls a frame or the centre of mass.
pub(crate) struct Motion<'a> {
    pub name: &'a str,
    pub parameters: Cow<'a, CartesianParameters>,
    pub controlled: ControlledFrame,
    axes_frame: AxesFrame,
}

/// Tasks of a set that control a frame or the centre of mass, in the order of priority.
pub(crate) fn motions<'a>(
    priority: &'a [String],
    task: &'a BTreeMap<String, TaskParameters>,
    model: &Model,
) -> Vec<Motion<'a>> {
    priority.iter().filter_map(|name| Motion::new(name, task.get(name)?, model)).collect()
}

impl<'a> Motion<'a> {
    fn new(name: &'a str, parameters: &'a TaskParameters, model: &Model) -> Option<Self> {
        let (parameters, controlled) = match parameters {
            TaskParameters::Cartesian(p) => (Cow::Borrowed(&**p), p.controlled_frame(model).ok()?),
            TaskParameters::CenterOfMass(p) => (Cow::Owned(p.as_cartesian()), ControlledFrame::CenterOfMass),
            _ => return None,
        };
        let axes_frame = parameters.axes_frame.resolve(model, controlled).ok()?;
        Some(Self { name, parameters, controlled, axes_frame })
    }

    /// Name of the controlled frame in messages.
    pub(crate) fn controlled_name(&self) -> String {
        match self.controlled {
            ControlledFrame::CenterOfMass => "the centre of mass".to_owned(),
            _ => format!("'{}'", self.parameters.frame),
        }
    }

    /// Axes of the task at a state, in the coordinates of the controlled frame: one per column.
    pub(crate) fn axes(&self, model: &Model, data: &Data) -> Matrix3<f64> {
        self.axes_frame.rotation(model, data, self.controlled)
    }
}
