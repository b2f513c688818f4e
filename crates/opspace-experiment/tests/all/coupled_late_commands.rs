//! Coupled robots whose commands act late.

use crate::coupled_common::{run, teleoperation};

/// Largest distance at the end, m: a fifteenth of the motion.
const DRIFT_M: f64 = 0.004;

/// Settings of both robots: cycles of 20 ms, and commands that act one cycle late, so that the controllers compute them for a
/// predicted state; with a coupling that is soft enough for that.
fn late() -> Vec<String> {
    let of_robot = |robot: &str| {
        [
            format!("robots.{robot}.profile=\"b-soft\""),
            format!("robots.{robot}.backend=\"torque\""),
            format!("{robot}.robot.profile.b-soft.servo_ticks_per_cycle=20"),
            format!("{robot}.robot.profile.b-soft.delay_servo_ticks=20"),
        ]
    };
    let coupling = "couplings.hands.teleoperation";
    let soft = [format!("{coupling}.stiffness_n_per_m=150.0"), format!("{coupling}.damping_ns_per_m=25.0")];
    ["leader", "follower"].iter().flat_map(|robot| of_robot(robot)).chain(soft).collect()
}

/// The operator moves the leader by 60 mm. Compared: the distance of the follower, which is 60 mm if the coupling
/// does not close.
#[test]
fn follower_with_late_commands_follows() {
    let settings = late();
    let mut settings: Vec<_> = settings.iter().map(String::as_str).collect();
    settings.push("duration_s=2.5");
    let run = run(&teleoperation(&settings));
    let drift_m = run.summary.couplings["hands"].drift_m.unwrap_or(f64::NAN);
    assert!(drift_m < DRIFT_M, "{drift_m} m");
}
