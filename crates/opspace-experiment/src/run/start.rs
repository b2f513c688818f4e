//! Start of an experiment in words, for a reader who is about to run it.

use crate::files::source::FileError;
use crate::run::experiment::Experiment;
use crate::text::{format_short, without_noise};
use opspace_control::TaskParameters;
use opspace_model::{Data, frame_placement, kinematics};

impl Experiment {
    /// Describes the start: joint positions, and the positions of the tasks' frames in the world.
    ///
    /// # Errors
    /// A start that the task file gives for a joint that the robot does not have, or outside its limits.
    pub fn start_text(&self) -> Result<String, FileError> {
        let (model, q) = (&self.robot().model, self.start()?);
        let mut data = Data::new(model);
        kinematics(model, &mut data, &q, &vec![0.0; model.n()]);
        let units = model.joint_units().position;
        let joints = model.joints().iter().zip(&q).zip(&units);
        let joints: Vec<String> = joints
            .map(|((joint, q), unit)| format!("{} {} {unit}", joint.name, format_short(without_noise(*q))))
            .collect();
        let mut text = format!("starts at {}", joints.join(", "));
        let file = &self.task().file;
        let mut named: Vec<&str> = Vec::new();
        for task in file.priority.iter().filter_map(|name| file.task.get(name)) {
            let TaskParameters::Cartesian(task) = task else { continue };
            let (name, Ok(frame)) = (task.frame.as_str(), model.frame_id(&task.frame)) else { continue };
            if !named.contains(&name) {
                named.push(name);
                let [x, y, z]: [f64; 3] = frame_placement(model, &data, frame).translation.into();
                let [x, y, z] = [x, y, z].map(|place_m| format_short(without_noise(place_m)));
                text += &format!("; '{name}' is at ({x}, {y}, {z}) m");
            }
        }
        Ok(text)
    }
}
