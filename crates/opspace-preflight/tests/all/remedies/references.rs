//! Remedies for references: reach, speed, time, and freedom.

use super::case::{HAND, JOINTS, TIP, TaskCase, after, number_after, number_before};
use opspace_experiment::Code;

/// Number by which a motion that is slower or smaller without a stated factor is divided.
const MUCH: f64 = 10.0;

/// The tip of the planar arm is to move along the direction of the stretched arm, which ends at `reach_m`.
fn far(reach_m: f64) -> TaskCase {
    TaskCase::of(TIP).replace(
        "reference = \"hold\"",
        &format!(
            "reference.point-to-point = {{ position = {{ absolute_m = [{reach_m:?}, 0.0, 0.5] }}, duration_s = 1.5 }}"
        ),
    )
}

pub fn goal_out_of_reach(code: Code) {
    const AWAY_M: f64 = 2.5;
    let found = far(AWAY_M).only(code);
    let closer_m = number_after(&found.help, "move it ");
    // The goal moves towards the first joint.
    let left = 1.0 - closer_m / AWAY_M.hypot(0.5);
    let closer =
        far(AWAY_M).replace("[2.5, 0.0, 0.5]", &format!("[{:?}, 0.0, {:?}]", left * AWAY_M, left * 0.5));
    far(AWAY_M).is_helped(code, &[closer]);
}

/// The elbow moves by some angle in some time.
fn elbow(by_rad: f64, duration_s: f64) -> TaskCase {
    TaskCase::of(JOINTS)
        .replace("elbow = 1.0", &format!("elbow = {by_rad:?}"))
        .replace("duration_s = 1.0", &format!("duration_s = {duration_s:?}"))
}

pub fn joint_too_fast(code: Code) {
    const FAST_S: f64 = 0.2;
    let times = number_before(&elbow(1.0, FAST_S).only(code).help, " times as long");
    elbow(1.0, FAST_S).is_helped(code, &[elbow(1.0, times * FAST_S), elbow(1.0 / times, FAST_S)]);
}

pub fn acceleration_above_limit(code: Code) {
    const LIMIT: &str = "robot.joint.elbow.acceleration_limit_rad_per_s2=20.0";
    const FAST_S: f64 = 0.4;
    let times = number_before(&elbow(1.0, FAST_S).set(LIMIT).only(code).help, " times as long");
    let longer = elbow(1.0, times * FAST_S).set(LIMIT);
    let smaller = elbow(1.0 / times.powi(2), FAST_S).set(LIMIT);
    elbow(1.0, FAST_S).set(LIMIT).is_helped(code, &[longer, smaller]);
}

pub fn torque_above_limit(code: Code) {
    const FAST_HZ: f64 = 5.0;
    let wave = |amplitude_m: f64, frequency_hz: f64| {
        let wave = format!(
            "reference.sinusoid.x = [{{ amplitude_m = {amplitude_m:?}, frequency_hz = {frequency_hz:?} }}]"
        );
        TaskCase::of(TIP).replace("reference = \"hold\"", &wave)
    };
    let times = number_before(&wave(0.1, FAST_HZ).only(code).help, " times as long");
    let remedied = [wave(0.1, FAST_HZ / times), wave(0.1 / times.powi(2), FAST_HZ)];
    wave(0.1, FAST_HZ).is_helped(code, &remedied);
}

pub fn moves_during_ramp(code: Code) {
    const RAMP: &str = "robot.safety.torque_ramp_s=0.2";
    let motion = |duration_s: f64| {
        format!(
            "reference = {{ point-to-point = {{ position = {{ offset_m = [0.05, 0.0, 0.03] }}, duration_s = {duration_s:?} }} }}"
        )
    };
    let line = HAND.lines().find(|line| line.starts_with("reference")).unwrap();
    let at_once = |duration_s: f64| TaskCase::of(HAND).replace(line, &motion(duration_s)).set(RAMP);
    let found = at_once(0.2).only(code);
    assert!(found.help.contains("[[event]]") && found.help.contains("more slowly"), "{}", found.help);
    let ramp_s = number_after(&found.message, "first ");
    let later = TaskCase::of(HAND).replace(line, "reference = \"hold\"").set(RAMP).add(&format!(
        "[[event]]\ntime_s = {ramp_s:?}\nset = [\"task.hand.cartesian.{}\"]",
        motion(0.2).replace('"', "\\\"")
    ));
    at_once(0.2).is_helped(code, &[later, at_once(1.0)]);
}

pub fn reference_too_fast(code: Code) {
    let limited = |limit: &str, duration_s: f64| {
        TaskCase::of(HAND)
            .replace("frame = \"hand\"", &format!("frame = \"hand\"\nspeed_limit_m_per_s = {limit}"))
            .replace("duration_s = 1.0", &format!("duration_s = {duration_s:?}"))
    };
    let found = limited("0.1", 1.0).only(code);
    let longer_s = number_before(&found.help, " times as long");
    let raised = format!("{:?}", 0.1 * longer_s);
    limited("0.1", 1.0).is_helped(code, &[limited("0.1", longer_s), limited(&raised, 1.0)]);
}

pub fn unfinished_reference(code: Code) {
    let late = |duration_s: f64, run_s: f64| {
        TaskCase::of(HAND)
            .replace("0.05] }, duration_s = 1.0", &format!("0.05] }}, duration_s = {duration_s:?}"))
            .set(format!("duration_s={run_s:?}"))
    };
    let run_s = number_after(&late(2.5, 2.0).only(code).help, "duration_s = ");
    late(2.5, 2.0).is_helped(code, &[late(2.5, run_s), late(2.0, 2.0)]);
    let line = HAND.lines().find(|line| line.starts_with("reference")).unwrap();
    let goal = |velocity: f64, run_s: f64| {
        let goal = format!(
            "reference.goal = {{ position = {{ offset_m = [0.05, 0.0, 0.05] }}, velocity_m_per_s = {velocity:?}, \
             acceleration_m_per_s2 = 1.0, jerk_m_per_s3 = 10.0 }}"
        );
        TaskCase::of(HAND).replace(line, &goal).set(format!("duration_s={run_s:?}"))
    };
    let help = goal(0.02, 2.0).only(code).help;
    assert!(help.contains("increase duration_s") && help.contains("limits of the goal's motion"), "{help}");
    goal(0.02, 2.0).is_helped(code, &[goal(0.02, 5.0), goal(0.2, 2.0)]);
}

pub fn half_turn(code: Code) {
    let reference = |goals: &str| {
        TaskCase::of(TIP).set("start_rad={ shoulder = 0.0 }").set("duration_s=10.0").set("priority=[\"arm\"]").set(format!(
            "task={{ arm = {{ joint-tracking = {{ gains = {{ frequency_rad_per_s = 14.0, damping_ratio = 1.0 }}, reference = {{ waypoints \
             = [{goals}] }} }} }} }}"
        ))
    };
    let to = |time_s: f64, goal: &str| format!("{{ time_s = {time_s:?}, goal = {{ {goal} }} }}");
    let goal = to(8.0, "absolute_rad = { shoulder = 3.1416 }");
    let absolute = reference(&goal);
    let help = absolute.only(code).help;
    assert!(help.contains("`offset_rad`") && help.contains("a waypoint between"), "{help}");
    let between = to(4.0, "absolute_rad = { shoulder = 1.5 }");
    let remedied = [to(8.0, "offset_rad = { shoulder = 3.1416 }"), format!("{between}, {goal}")];
    absolute.is_helped(code, &remedied.map(|goals| reference(&goals)));
}

pub fn late_event(code: Code) {
    let event = |time_s: f64, run_s: f64| {
        TaskCase::of(HAND).set(format!("duration_s={run_s:?}")).add(&format!(
            "[[event]]\ntime_s = {time_s:?}\nset = [\"task.hand.cartesian.gains.damping_ratio=0.9\"]"
        ))
    };
    let help = event(2.0, 2.0).only(code).help;
    let below_s = number_after(&help, "below ");
    assert!(help.contains("increase duration_s"), "{help}");
    event(2.0, 2.0).is_helped(code, &[event(below_s - 0.1, 2.0), event(2.0, 2.1)]);
}

pub fn early_statistics(code: Code) {
    let early = TaskCase::of(HAND).set("settle_s=0.1");
    let settle_s = number_after(&early.only(code).help, "settle_s = ");
    early.is_helped(code, &[early.clone().set(format!("settle_s={settle_s:?}"))]);
}

pub fn singular_start(code: Code) {
    let straight = TaskCase::of(TIP).replace("shoulder = 0.6, elbow = 1.2", "shoulder = 0.0, elbow = 0.0");
    let found = straight.only(code);
    let bent = straight.clone().set(format!("start_rad.elbow={}", after(&found.help, "'elbow' at ")));
    straight.is_helped(code, &[bent]);
    // The escape does not change the start, but the arm leaves it: the message says so.
    let (_, setting) = found.help.split_once("or set ").unwrap();
    let (setting, _) = setting.split_once(':').unwrap();
    let escapes = straight.set(setting.replace(' ', "")).only(code);
    assert!(found.message.contains("leaves late, or not at all"), "{}", found.message);
    assert!(
        escapes.message.contains("it leaves towards a goal along that direction by motion"),
        "{}",
        escapes.message
    );
}

pub fn uncontrolled_freedom(code: Code) {
    let rest = "[task.rest.joint-posture]\nfrequency_rad_per_s = 6.0\ndamping_ratio = 0.8\n";
    let free = TaskCase::of(HAND).replace("\"hand\", \"rest\"", "\"hand\"").replace(rest, "");
    let help = free.only(code).help;
    let with = |gains: &str| {
        let (table, _) = gains.split_once('\n').unwrap();
        assert!(help.contains(table), "{table} in {help}");
        free.clone().replace("[\"hand\"]", "[\"hand\", \"rest\"]").add(gains)
    };
    let damping = "[task.rest.joint-damping]\ndamping_nms_per_rad = 1.0";
    free.is_helped(code, &[with(rest), with(damping)]);
}

pub fn compliant_drift(code: Code) {
    let led = TaskCase::of(HAND).replace("x = \"motion\"", "x = \"compliant\"");
    let help = led.only(code).help;
    assert!(help.contains("use \"motion\" with a spring"), "{help}");
    let (_, spring) = help.split_once("stiffness_n_per_m = { ").unwrap();
    let (of_axis, _) = spring.split_once(',').unwrap();
    let gains = "gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }";
    let stiffness = MUCH * number_after(of_axis, "= ");
    let spring = format!(
        "impedance = {{ stiffness_n_per_m = {{ {of_axis}, y = {stiffness:?}, z = {stiffness:?} }}, damping_ratio = 0.7 }}"
    );
    led.is_helped(code, &[TaskCase::of(HAND).replace(gains, &spring)]);
    // A load does not hold the hand, but falls with it.
    let load = "environment.load.mass={ frame = \"hand\", mass_kg = 2.0, put_on_s = 0.5 }";
    let lowered = TaskCase::of(HAND).replace("z = \"motion\"", "z = \"compliant\"");
    let loaded = lowered.set(load).only(code).message;
    assert!(loaded.contains("holds the load 'load' of 2 kg"), "{loaded}");
    // Along a level axis it does not fall.
    let level = led.set(load).only(code).message;
    assert!(level.contains("brings 'hand' back along x"), "{level}");
}

pub fn reference_jump(code: Code) {
    const WITHIN_S: f64 = 0.003;
    // Joints that move within some cycles, a hand between two samples, and a hand that begins elsewhere.
    let least_s = number_after(&elbow(1.0, WITHIN_S).only(code).help, "at least ");
    elbow(1.0, WITHIN_S).is_helped(code, &[elbow(1.0, least_s)]);
    let hand = |at_s: f64| {
        TaskCase::of(HAND).replace(
            "reference.point-to-point = { position = { offset_m = [0.05, 0.0, 0.05] }, duration_s = 1.0 }",
            &format!(
                "reference.waypoints = [{{ time_s = 0.5, position = {{ offset_m = [0.0, 0.0, 0.0] }} }}, \
                 {{ time_s = {at_s:?}, position = {{ offset_m = [0.1, 0.0, 0.0] }} }}]"
            ),
        )
    };
    let least_s = number_after(&hand(0.5 + WITHIN_S).only(code).help, "at least ");
    hand(0.5 + WITHIN_S).is_helped(code, &[hand(0.5 + least_s)]);
    let beside = |offset_m: f64| {
        TaskCase::of(HAND).replace(
            "reference.point-to-point = { position = { offset_m = [0.05, 0.0, 0.05] }, duration_s = 1.0 }",
            &format!(
                "reference.sinusoid = {{ ramp_s = 0.001, z = [{{ amplitude_m = 0.0, frequency_hz = 1.0, offset_m = {offset_m:?} }}] }}"
            ),
        )
    };
    beside(0.1).is_helped(code, &[beside(0.0)]);
}
