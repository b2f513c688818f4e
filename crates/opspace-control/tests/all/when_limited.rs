//! Tasks that limits keep from their desired acceleration: weights of axes, scaled tasks, and slack.

use crate::common::Numbers;
use crate::common::stacks::DAMPED;
use crate::limited_motion::{REACHED, Run, moderate_limits};
use crate::common::seven_joints;
use nalgebra::Vector3;
use opspace_control::JointLimits;

/// Largest distance of the hand from the straight line, and its remaining speed (joints, rad/s) and distance (m).
struct Line {
    aside_m: f64,
    speed: f64,
    left_m: f64,
    excess: f64,
}

fn line(limits: &JointLimits, way: &Vector3<f64>, more: &str, duration_s: f64, seconds: f64) -> Line {
    let offset = way.as_slice();
    let reference = format!(
        "reference.point-to-point = {{ position = {{ offset_m = {offset:?} }}, duration_s = {duration_s} }}"
    );
    let text = DAMPED.replacen("reference = \"hold\"", &format!("{reference}\n{more}"), 1).replace("[task.rest.joint-damping]\ndamping_nms_per_rad = 3.0", "[task.rest.joint-posture]\nfrequency_rad_per_s = 9.0\ndamping_ratio = 0.8");
assert!(text.contains("posture"));
    let mut run = Run::new(seven_joints(), &text, limits, &REACHED, &[0.0; 7]);
    let (start, _) = run.hand();
    let direction = way.normalize();
    let mut found = Line { aside_m: 0.0, speed: 0.0, left_m: 0.0, excess: f64::NEG_INFINITY };
    for _ in 0..(seconds * 1e3) as usize {
        run.step();
        let moved = run.hand().0 - start;
        found.aside_m = found.aside_m.max((moved - direction * direction.dot(&moved)).norm());
        for i in 0..7 {
            let (q, v) = (run.measurement.q[i], run.measurement.dq[i]);
            let beyond = (q - limits.upper[i]).max(limits.lower[i] - q).max((v.abs() - limits.velocity[i]) / limits.velocity[i]);
            found.excess = found.excess.max(beyond).max((run.tau[i].abs() - limits.torque[i]) / limits.torque[i]);
        }
    }
    found.speed = run.measurement.dq.amax();
    found.left_m = (start + way - run.hand().0).norm();
    found
}

#[test]
fn explore() {
    let mut numbers = Numbers::new(6);
    for case in 0..24 {
        let way = Vector3::from_fn(|_, _| numbers.next()) * 0.6;
        let limits = JointLimits {
            lower: REACHED.map(|q| q - 0.25).to_vec(),
            upper: REACHED.map(|q| q + 0.25).to_vec(),
            ..moderate_limits()
        };
            for more in ["", "when_limited = \"scaled\""] {
                for seconds in [4.0] {
                let l = line(&limits, &way, more, 0.4, seconds);
                println!("{case} {:.2} {seconds} {more:30} aside {:.4} mm, speed {:.1e}, left {:.4}, excess {:.2e}", way.norm(), 1e3*l.aside_m, l.speed, l.left_m, l.excess);
                }
            }
    }
}
