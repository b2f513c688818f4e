//! First task of a new robot: its tip moves and returns.

use crate::first_motion::{ControlledAxes, FirstMotion};
use opspace_model::Model;
use std::fmt::Write as _;
use toml_edit::{Key, Value};

/// Fraction of the friction that is compensated: with 0.8, an assumed UR5e and Panda end five times closer to their start
/// than without (other arms less so), and friction may be a fifth less than stated.
const FRICTION_GAIN: f64 = 0.8;

/// Time after the motion, s.
const REST_S: f64 = 1.0;

/// Returns a first task for the robot: the tip moves along one axis and returns, and keeps its orientation if the arm can.
#[must_use]
pub fn first_task_toml(model: &Model, motion: &FirstMotion) -> String {
    let FirstMotion { frame, axes, axis, distance_m, duration_s, .. } = motion;
    let name = ["x", "y", "z"][*axis];
    let mut text = String::from("#:schema task.schema.json\n");
    let end_s = 2.0 * duration_s + REST_S;
    let (about, priority) = match distance_m {
        0.0 => ("Each joint holds its start position like a damped spring.".to_owned(), "\"posture\""),
        _ => {
            let holds = if *axes == ControlledAxes::Pose { ", keeps its orientation" } else { "" };
            let cm = 100.0 * distance_m.abs();
            (format!("The tip moves {cm:.0} cm along {name}{holds}, and returns."), "\"tip\", \"posture\"")
        }
    };
    let _ = write!(
        text,
        "# {about}\nrobot = \".\"\nduration_s = {end_s:.1}\nsettle_s = 0.5\npriority = [{priority}]\n\
         # Part of the friction in robot.toml that is compensated; above 1 the arm oscillates.\n\
         friction_compensation = {{ gain = {FRICTION_GAIN:?} }}\n"
    );
    if *distance_m != 0.0 {
        let controlled: Vec<String> = match axes {
            ControlledAxes::Pose => ["x", "y", "z", "rx", "ry", "rz"].map(str::to_owned).into(),
            ControlledAxes::Position => ["x", "y", "z"].map(str::to_owned).into(),
            ControlledAxes::One => vec![name.to_owned()],
        };
        let controlled: Vec<String> = controlled.iter().map(|axis| format!("{axis} = \"motion\"")).collect();
        let _ = write!(
            text,
            "\n[task.tip.cartesian]\nframe = {}\naxes = {{ {} }}\n\
             gains = {{ frequency_rad_per_s = 15.0, damping_ratio = 1.0 }}\n",
            Value::from(frame.as_str()),
            controlled.join(", ")
        );
        for (time_s, distance_m) in [(*duration_s, *distance_m), (2.0 * duration_s, 0.0)] {
            let mut offset = [0.0; 3];
            offset[*axis] = distance_m;
            let _ = write!(
                text,
                "\n[[task.tip.cartesian.reference.waypoints]]\ntime_s = {time_s:.1}\nposition = {{ offset_m = {offset:?} }}\n"
            );
            if *axes == ControlledAxes::Pose {
                text += "orientation = { offset_rpy_rad = [0.0, 0.0, 0.0] }\n";
            }
        }
    }
    text += "\n# Each joint returns to its start position like a damped spring, as far as the tip permits.\n\
             [task.posture.joint-posture]\nfrequency_rad_per_s = 6.0\ndamping_ratio = 1.0\n\n\
             # Start positions, rad (m): away from limits, singular poses and other links.\n[start_rad]\n";
    for (joint, start) in model.joints().iter().zip(&motion.start) {
        let _ = writeln!(text, "{} = {start:?}", Key::new(&joint.name));
    }
    text
}
