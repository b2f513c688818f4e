//! Limits of joints whose drives add torques that are known within intervals only.

use crate::common::stacks::DAMPED;
use crate::common::{self, Numbers, seven_joints};
use crate::limited_motion::{REACHED, Run, moderate_limits};
use nalgebra::DVector;
use opspace_control::{ControlInput, Controller, JointLimits};
use opspace_model::update;

/// Number of motions.
const MOTIONS: u64 = 60;

/// Duration of a motion in control periods.
const TICKS: usize = 1500;

/// Largest damping that may be left to each joint, for its inertia at the start, and largest one that may be taken away beyond
/// zero, 1/s: servos of 40 Hz whose gains are known to 10 % have 46 and 25.
const LEFT_PER_S: f64 = 46.0;
const DRIVING_PER_S: f64 = 10.0;

/// Distance beyond a limit, rad or rad/s, and joint, of a brisk motion to a random goal, within reach or not. `is_declared` if the
/// controller knows the intervals of the torques.
fn beyond(seed: u64, is_declared: bool) -> [f64; 2] {
    let mut numbers = Numbers::new(seed);
    let limits = JointLimits { torque: vec![400.0; 7], torque_rate: vec![1e5; 7], ..moderate_limits() };
    let goal = numbers.vector3(0.7);
    let reference = format!(
        "reference.point-to-point = {{ position = {{ offset_m = [{:?}, {:?}, {:?}] }}, duration_s = {:?} }}",
        goal.x,
        goal.y,
        goal.z,
        numbers.between(0.3, 1.0)
    );
    let text = DAMPED.replacen("reference = \"hold\"", &reference, 1);
    let start = REACHED.map(|q| q + 0.2 * numbers.next());
    let mut run = Run::new(seven_joints(), &text, &limits, &start, &[0.0; 7]);
    let inertia = run.data.mass_matrix.diagonal();
    // The part of the interval that a drive adds: an end of it in most cases.
    let parts: Vec<f64> = (0..7).map(|_| (2.0 * numbers.next()).clamp(-1.0, 1.0)).collect();
    let mut most = [0.0_f64; 2];
    for _ in 0..TICKS {
        let seen = &run.measurement;
        assert!(update(&run.model, &mut run.data, seen.q.as_slice(), seen.dq.as_slice()));
        let intervals: Vec<[f64; 2]> = (seen.dq.iter().zip(&inertia))
            .map(|(v, inertia)| {
                let [a, b] = [-LEFT_PER_S * inertia * v, DRIVING_PER_S * inertia * v];
                [a.min(b), a.max(b)]
            })
            .collect();
        let input = common::input(&run.model, &run.data, seen);
        let known: &[[f64; 2]] = if is_declared { &intervals } else { &[] };
        let input = ControlInput { damping_torque: known, ..input };
        run.controller.update(&input, run.tau.as_mut_slice());
        let added = intervals.iter().zip(&parts).zip(run.measurement.dq.iter()).map(|(([a, b], part), v)| {
            let [opposing, driving] = if *v > 0.0 { [a, b] } else { [b, a] };
            0.5 * (opposing + driving) + 0.5 * part * (driving - opposing)
        });
        let tau = &run.tau + DVector::from_iterator(7, added);
        run.advance(&tau);
        for i in 0..7 {
            most[0] = most[0].max(run.measurement.q[i].abs() - limits.upper[i]);
            most[1] = most[1].max(run.measurement.dq[i].abs() - limits.velocity[i]);
        }
        if most[1] > limits.velocity[0] {
            break;
        }
    }
    most
}

/// Compared: positions and speeds with their limits, for drives that add any torque of their intervals. Without the intervals, the
/// same motions exceed the limits.
#[test]
fn limits_hold_with_any_torque_of_the_drives() {
    /// Distance beyond a limit that a torque which rises within a period may cause, rad and rad/s.
    const TOLERANCE: [f64; 2] = [1e-3, 2e-2];
    let exceeding = |is_declared: bool| {
        let all = (0..MOTIONS).map(|seed| (seed, beyond(seed, is_declared)));
        all.filter(|(_, [q, v])| *q > TOLERANCE[0] || *v > TOLERANCE[1]).collect::<Vec<_>>()
    };
    let unknown = exceeding(false);
    assert!(unknown.len() > 10, "{unknown:?}");
    assert_eq!(exceeding(true), []);
}
