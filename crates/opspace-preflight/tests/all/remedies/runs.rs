//! Remedies for what a run shows: the finding of its summary is gone with the remedy of its page.

use super::case::{JOINTS, TaskCase, number_after};
use opspace_backend::CommandKind;
use opspace_experiment::Code;

/// Checks that the run of a case has a finding with the code, that its page has the advice, and that no run of `remedied` has it.
fn is_helped(code: Code, case: &TaskCase, advice: &str, remedied: &[TaskCase]) {
    let (_, what_to_do) = code.page().split_once("**What to do.**").unwrap();
    assert!(what_to_do.contains(advice), "{code}: {advice} in {what_to_do}");
    let found = |case: &TaskCase| case.run().findings.of(code).map(ToString::to_string).collect::<Vec<_>>();
    assert_ne!(found(case), [""; 0], "{code}");
    for (alternative, case) in remedied.iter().enumerate() {
        assert_eq!(found(case), [""; 0], "{code}, alternative {alternative} of: {advice}");
    }
}

fn torque(name: &str) -> TaskCase {
    TaskCase::project(name).backend(CommandKind::Torque)
}

pub fn never_touched(code: Code) {
    let press = torque("press-wall").set("duration_s=3.0").set("task.hand.reference=\"hold\"");
    let far = press.clone().set("environment.board.wall.point_m=[0.9, 0.0, 0.0]");
    is_helped(code, &far, "Start closer to the surface", std::slice::from_ref(&press));
    let pulls = press.clone().set("task.hand.force.target_n.x=10.0");
    is_helped(code, &pulls, "check the sign of the force", std::slice::from_ref(&press));
    // 30 mm at 10 mm/s.
    let slow = press
        .set("environment.board.wall.point_m=[0.41, 0.0, 0.0]")
        .set("task.hand.force.contact={approach_m_per_s=0.01}");
    is_helped(code, &slow, "approach it for longer", &[slow.clone().set("duration_s=8.0")]);
}

pub fn contact_lost(code: Code) {
    // The hand leaves the wall before the statistics begin.
    let leaves = torque("press-wall")
        .set("duration_s=4.0")
        .set("settle_s=3.5")
        .set("task.hand.reference=\"hold\"")
        .set("event=[{ time_s = 1.5, set = [\"task.hand.cartesian.force.target_n.x=20.0\"] }]");
    is_helped(code, &leaves, "a smaller `settle_s`", &[leaves.clone().set("settle_s=0.5")]);
}

pub fn joints_held(code: Code) {
    let held = TaskCase::of(JOINTS)
        .replace("elbow = 1.0", "elbow = 0.05")
        .backend(CommandKind::Torque)
        .set("friction_compensation.gain=0.0")
        .set("task.joints.gains.frequency_rad_per_s=3.0");
    is_helped(
        code,
        &held,
        "raise the gains",
        &[held.clone().set("task.joints.gains.frequency_rad_per_s=40.0")],
    );
    let corner = number_after(code.page(), "observer_rad_per_s = ");
    let observed =
        held.clone().set(format!("friction_compensation={{ gain = 0.8, observer_rad_per_s = {corner:?} }}"));
    is_helped(code, &held, "compensate it", &[observed]);
}

pub fn goal_not_reached(code: Code) {
    let goal = |offset: &str| {
        torque("panda-goals").set("event=[]").set("duration_s=3.0").set(format!(
            "task.flange.reference={{ point-to-point = {{ position = {{ offset_m = {offset} }}, duration_s = 1.0 }} }}"
        ))
    };
    let behind = goal("[-0.35, 0.0, -0.2]");
    let elsewhere = behind.clone().set("start_rad.joint2=-0.2").set("start_rad.joint4=-2.0");
    is_helped(code, &behind, "Move the goal", &[goal("[-0.05, 0.0, -0.1]"), elsewhere]);
    let rest = "task.rest={ joint-tracking = { joints = [\"joint4\"], gains = { frequency_rad_per_s = 10.0, damping_ratio = 1.0 }, reference = { \
                point-to-point = { goal = { offset_rad = { joint4 = 0.3 } }, duration_s = 1.0 } } } }";
    let below = goal("[0.0, 0.0, 0.0]").set(rest);
    let is_missed = |case: &TaskCase| case.run().findings.of(code).any(|goal| goal.task() == Some("rest"));
    assert!(is_missed(&below) && code.page().contains("reorder `priority`"));
    assert!(!is_missed(&below.set("priority=[\"rest\", \"flange\"]")));
}

pub fn reference_limited(code: Code) {
    let circle = |radius_m: f64, hz: f64| {
        torque("panda-goals").set("event=[]").set("duration_s=3.0").set("limits.velocity_fraction=0.2").set(format!(
            "task.flange.reference={{ sinusoid = {{ y = [{{ amplitude_m = {radius_m:?}, frequency_hz = {hz:?} }}] }} }}"
        ))
    };
    is_helped(
        code,
        &circle(0.12, 1.0),
        "Make the motion longer or smaller",
        &[circle(0.12, 0.2), circle(0.015, 1.0)],
    );
}

pub fn escaped_singularity(code: Code) {
    let straight = torque("ur5e-straight");
    let bent = straight.clone().set("start_rad.elbow=0.5");
    is_helped(code, &straight, "start away from the singular pose", &[bent]);
}

pub fn damped_direction(code: Code) {
    let pulled = |force_n: f64| {
        torque("ur5e-pulled-straight").set("duration_s=3.0").set(format!(
            "environment.someone.pushes.push=[{{ at_s = 0.5, duration_s = 2.0, force_n = [{force_n:?}, 0.0, 0.0] }}]"
        ))
    };
    is_helped(code, &pulled(40.0), "away from the singular pose", &[pulled(10.0)]);
}

pub fn compliant_axes_moved(code: Code) {
    let loaded = torque("panda-compliant")
        .replace("compliant_damping_per_s = 2.0", "")
        .set("duration_s=2.0")
        .set("task.flange.cartesian.axes.z=\"compliant\"")
        .set("environment={ load = { mass = { frame = \"flange\", mass_kg = 2.0, put_on_s = 0.5 } } }");
    let axes = ["x", "z"].map(|axis| format!("task.flange.cartesian.axes.{axis}=\"motion\""));
    let held = axes.iter().fold(loaded.clone(), |case, setting| case.set(setting));
    is_helped(code, &loaded, "make the axis `motion`", &[held]);
}

pub fn torques_saturated(code: Code) {
    let fast = torque("joint-tracking").set("duration_s=2.0");
    let weak = fast.clone().set("robot.joint.elbow.torque_limit_nm=1.0");
    is_helped(code, &weak, "declare its true limits", &[fast]);
}
