//! Joints that an external force pushes towards their limits.

use crate::common::{Numbers, jacobian, seven_joints};
use crate::limited_motion::{REACHED, Run, moderate_limits};
use nalgebra::DVector;

/// Position limit of [`moderate_limits`], rad.
const LIMIT: f64 = 1.6;

/// Position beyond which a joint is at its limit, with the margin of 0.01, rad.
const AT_LIMIT: f64 = 1.589;

/// Hand that follows every force.
const COMPLIANT_HAND: &str = r#"
priority = ["hand", "rest"]
[task.hand.cartesian]
frame = "hand"
axes = { x = "compliant", y = "compliant", z = "compliant" }
reference = "hold"
compliant_damping_per_s = 4.0
[task.rest.joint-damping]
damping_nms_per_rad = 2.0
"#;

/// An operator pulls a compliant hand with a constant force until joints are at their limits. No joint passes its limit, for
/// forces that need at most a third of the torque limits, at control periods of 1 and 2 ms.
#[test]
fn pulled_hand_stays_within_position_limits() {
    let (limits, mut numbers) = (moderate_limits(), Numbers::new(41));
    let mut held_ms = 0;
    for case in 0..24 {
        let period_ms = if case % 3 == 2 { 2 } else { 1 };
        let q = REACHED.map(|q| q + 0.2 * numbers.next());
        let periods = [1e-3 * f64::from(period_ms), 0.0];
        let mut run = Run::with_period(periods, seven_joints(), COMPLIANT_HAND, &limits, &q, &[0.0; 7]);
        let direction = DVector::from_vec(numbers.vector(3, 1.0)).normalize();
        let (force_n, rise_s) = (30.0 + 25.0 * numbers.next(), 0.25 + 0.2 * numbers.next());
        for _ in 0..3000 / period_ms {
            run.control();
            let (tau, mut at_limit) = (run.tau.clone(), false);
            for _ in 0..period_ms {
                let hand = jacobian(&run.model, &run.data, "hand");
                let share = (run.measurement.time_s / rise_s).min(1.0);
                let mut pull = hand.rows(0, 3).tr_mul(&direction) * force_n * share;
                for (pull, limit) in pull.iter_mut().zip(&limits.torque) {
                    *pull = pull.clamp(-limit / 3.0, limit / 3.0);
                }
                for i in 0..7 {
                    let q = run.measurement.q[i];
                    assert!(q.abs() < LIMIT, "case {case}, {period_ms} ms: joint {i} at {q} rad");
                    let outward = pull[i] * q.signum();
                    if q.abs() > AT_LIMIT && outward > 0.1 * limits.torque[i] {
                        at_limit = true;
                    }
                }
                run.advance(&(&tau + pull));
            }
            held_ms += u32::from(at_limit) * period_ms;
        }
    }
    assert!(held_ms > 1000, "for {held_ms} ms a joint is pulled at its limit");
}
