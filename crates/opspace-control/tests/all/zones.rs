//! Postures in which tasks at rest are damped: near their own singularities only, also below other tasks.

use crate::common::{self, File, Numbers, at_state, control_context, sampled, seven_joints};
use opspace_control::{Controller, OperationalSpaceController};
use opspace_model::Model;

const AXES: [&str; 6] = ["x", "y", "z", "rx", "ry", "rz"];

/// Gain of a damped inverse that counts as one without damping.
const WHOLE: f64 = 1.0 - 1e-9;

/// Number of random postures of each arm.
const POSTURES: usize = 400;

/// The Panda, the UR5e, and a seven-joint arm with offsets in all directions; each with its hand.
fn arms() -> [(Model, &'static str); 3] {
    let read = |text: &str| Model::from_urdf(text).expect("a URDF of the repository").model;
    [
        (read(include_str!("../../../../robots/panda/panda.urdf")), "flange"),
        (read(include_str!("../../../../robots/ur5e/ur5e.urdf")), "flange"),
        (seven_joints(), "hand"),
    ]
}

/// Text of tasks with the axes whose bits are set in `levels`, in order of priority.
fn tasks(frame: &str, levels: &[u32]) -> String {
    let names: Vec<String> = (0..levels.len()).map(|level| format!("\"level{level}\"")).collect();
    let mut text = format!("priority = [{}]\n", names.join(", "));
    for (level, axes) in levels.iter().enumerate() {
        let axes: Vec<String> = (0..6)
            .filter(|axis| axes >> axis & 1 == 1)
            .map(|axis| format!("{} = \"motion\"", AXES[axis]))
            .collect();
        text += &format!(
            "[task.level{level}.cartesian]\nframe = \"{frame}\"\naxes = {{ {} }}\nreference = \"hold\"\ngains = {{ \
             frequency_rad_per_s = 10.0, damping_ratio = 1.0 }}\n",
            axes.join(", ")
        );
    }
    text
}

/// Returns for each posture true if the last of the tasks is damped at rest.
fn damped(model: &Model, frame: &str, levels: &[u32], postures: &[Vec<f64>]) -> Vec<bool> {
    let file = File::read(&tasks(frame, levels));
    let mut controller =
        OperationalSpaceController::new(model, &file.task_set(), &control_context(model, frame))
            .expect("independent axes");
    let signal = format!("level{}.min_singular_gain", levels.len() - 1);
    let mut tau = vec![0.0; model.n()];
    let mut at = |q: &Vec<f64>| {
        let (data, measurement) = at_state(model, q, &vec![0.0; q.len()], 0.0);
        let input = common::input(model, &data, &measurement);
        controller.start(&input);
        controller.update(&input, &mut tau);
        sampled(&controller, &signal)[0] < WHOLE
    };
    postures.iter().map(&mut at).collect()
}

fn postures(model: &Model) -> Vec<Vec<f64>> {
    let mut numbers = Numbers::new(31);
    let limit = |end: f64| end.clamp(-3.1, 3.1);
    let random = |_| {
        let joints = model.joints().iter();
        joints
            .map(|joint| {
                let (lower, upper) = (limit(joint.limits.lower), limit(joint.limits.upper));
                lower + (upper - lower) * 0.5 * (1.0 + numbers.next())
            })
            .collect()
    };
    (0..POSTURES).map(random).collect()
}

/// Compared: the number of postures in which six axes in two levels are damped but not as one task, for every choice of
/// the upper level, with 5 % of the postures; and that in which they are damped as one task, with 10 %.
#[test]
fn lower_level_is_damped_only_near_its_singularities() {
    for (model, frame) in arms() {
        let postures = postures(&model);
        let alone = damped(&model, frame, &[63], &postures);
        let count = alone.iter().filter(|damped| **damped).count();
        assert!(10 * count <= POSTURES, "{}: one task is damped in {count} postures", model.name());
        for upper in 1..63_u32 {
            let lower = damped(&model, frame, &[upper, 63 - upper], &postures);
            let more = lower.iter().zip(&alone).filter(|(lower, alone)| **lower && !**alone).count();
            assert!(20 * more <= POSTURES, "{}: upper level {upper:06b}: {more} postures", model.name());
        }
    }
}
