//! Goals out of reach without limits: the arm comes to rest near its singular posture.

use crate::common::{self, File, Link, Numbers, arm, at_state, control_context};
use nalgebra::Vector3;
use opspace_control::{Controller, JointLimits, OperationalSpaceController};
use opspace_model::{Data, Model, aba, frame_placement, update};

/// An arm with the proportions and masses of a UR10 (Universal Robots, "DH parameters for calculations of kinematics
/// and dynamics"), with reflected rotor inertias and without friction or limits.
pub fn ur10_like() -> Model {
    let link = |name, axis, origin, mass, com, inertia: [f64; 3], rotor| Link {
        name,
        axis,
        origin,
        mass,
        com,
        inertia,
        limits: [-6.3, 6.3],
        rotor,
    };
    let (up, side) = ([0.0, 0.0, 1.0], [0.0, -1.0, 0.0]);
    let links = [
        link("base", up, [0.0; 3], 7.1, [0.0, 0.0, 0.06], [0.03; 3], 0.1),
        link("shoulder", side, [0.0, 0.0, 0.1273], 12.7, [-0.306, -0.15, 0.0], [0.04, 0.42, 0.42], 0.1),
        link("elbow", side, [-0.612, 0.0, 0.0], 4.27, [-0.286, -0.04, 0.0], [0.008, 0.11, 0.11], 0.05),
        link("wrist_1", side, [-0.5723, 0.0, 0.0], 2.0, [0.0, -0.12, 0.0], [0.005; 3], 0.01),
        link("wrist_2", [0.0, 0.0, -1.0], [0.0, -0.1639, 0.0], 2.0, [0.0, 0.0, -0.09], [0.005; 3], 0.01),
        link("wrist_3", side, [0.0, 0.0, -0.1157], 0.37, [0.0, -0.03, 0.0], [3e-4; 3], 0.01),
    ];
    arm(&links, &[("hand", 5, [0.0, -0.0922, 0.0])], 1.0)
}

/// Motion of an arm under a controller, integrated with four steps per control cycle.
pub struct Motion {
    data: Data,
    pub q: Vec<f64>,
    pub dq: Vec<f64>,
    pub time_s: f64,
    /// Control period, s.
    pub period_s: f64,
}

const PERIOD_S: f64 = 1e-3;
const STEPS: usize = 4;

impl Motion {
    pub fn new(model: &Model, q: &[f64]) -> Self {
        let dq = vec![0.0; q.len()];
        Self { data: Data::new(model), q: q.to_vec(), dq, time_s: 0.0, period_s: PERIOD_S }
    }

    /// Controls and moves the arm by a cycle. Returns false if its torques or its motion are no longer finite.
    #[must_use]
    pub fn cycle(&mut self, model: &Model, controller: &mut dyn Controller, tau: &mut [f64]) -> bool {
        self.pushed_cycle(model, controller, tau, &[])
    }

    /// A cycle in which the joint torques `external` (n; none if empty) act in addition.
    #[must_use]
    pub fn pushed_cycle(
        &mut self,
        model: &Model,
        controller: &mut dyn Controller,
        tau: &mut [f64],
        external: &[f64],
    ) -> bool {
        let (data, measurement) = at_state(model, &self.q, &self.dq, self.time_s);
        let input = common::input(model, &data, &measurement);
        if self.time_s == 0.0 {
            controller.start(&input);
        }
        controller.update(&input, tau);
        let mut acting = tau.to_vec();
        acting.iter_mut().zip(external).for_each(|(torque, external)| *torque += external);
        let step = self.period_s / STEPS as f64;
        for _ in 0..STEPS {
            if !update(model, &mut self.data, &self.q, &self.dq) {
                return false;
            }
            aba(model, &mut self.data, &acting);
            for i in 0..self.q.len() {
                self.dq[i] += step * self.data.ddq[i];
                self.q[i] += step * self.dq[i];
            }
        }
        self.time_s += self.period_s;
        self.q.iter().chain(&self.dq).chain(tau.iter()).all(|value| value.is_finite())
    }

    pub fn speed(&self) -> f64 {
        self.dq.iter().fold(0.0, |m, v| m.max(v.abs()))
    }
}

/// Speed of an arm at rest, rad/s.
const AT_REST: f64 = 1e-3;

/// Speed far below that of a limit cycle, which is about 20 rad/s.
const IN_A_CYCLE: f64 = 0.5;

/// Number of goals in every run of the tests.
const GOALS: u64 = 20;

/// Half of the range of each joint around its start in the cases with limits, rad.
pub const HALF_RANGE: f64 = 0.6;

/// Limits of a UR10 (Universal Robots, technical specifications), and narrow position limits around `start`.
pub fn limits_around(start: &[f64; 6]) -> JointLimits {
    JointLimits {
        lower: start.map(|q| q - HALF_RANGE).to_vec(),
        upper: start.map(|q| q + HALF_RANGE).to_vec(),
        velocity: vec![2.0, 2.0, 3.0, 3.0, 3.0, 3.0],
        torque: vec![330.0, 330.0, 150.0, 54.0, 54.0, 54.0],
        ..JointLimits::none(6)
    }
}

/// Returns the highest speed in the last two seconds on the way to a goal beyond reach, rad/s. Limits are enforced if
/// `is_limited`.
fn final_speed(number: u64, is_limited: bool) -> f64 {
    at_end(number, is_limited, "").0
}

/// Returns the highest speed in the last two seconds on the way to a goal beyond reach, rad/s, and the distance to the goal at
/// the end, m. `posture` is a task of all joints below that of the hand, or empty.
fn at_end(number: u64, is_limited: bool, posture: &str) -> (f64, f64) {
    let model = ur10_like();
    let mut numbers = Numbers::new(number + 1);
    let start = [
        3.0 * numbers.next(),
        -1.2 + 0.5 * numbers.next(),
        1.6 + 0.6 * numbers.next(),
        -1.5 + 0.8 * numbers.next(),
        1.5 + 0.8 * numbers.next(),
        2.0 * numbers.next(),
    ];
    let (data, _) = at_state(&model, &start, &[0.0; 6], 0.0);
    let hand = frame_placement(&model, &data, model.frame_id("hand").expect("hand")).translation;
    // A point 0.05 to 1 m beyond the reach of 1.5 m around the shoulder.
    let shoulder = Vector3::new(0.0, 0.0, 0.1273);
    let direction = Vector3::from_fn(|_, _| numbers.next()).normalize();
    let offset = shoulder + direction * (1.55 + 0.5 + 0.45 * numbers.next()) - hand;
    let axes =
        if number.is_multiple_of(2) { "" } else { ", rx = \"motion\", ry = \"motion\", rz = \"motion\"" };
    let rest = if posture.is_empty() { "" } else { ", \"rest\"" };
    let text = format!(
        "priority = [\"hand\"{rest}]\nlimits = {{ enforce = {is_limited}}}\n[task.hand.cartesian]\nframe = \"hand\"\naxes = {{ x = \
         \"motion\", y = \"motion\", z = \"motion\"{axes} }}\nreference.point-to-point = {{ position = {{ offset_m = \
         [{}, {}, {}] }}, duration_s = 1.0 }}\ngains = {{ frequency_rad_per_s = 20.0, damping_ratio = 1.0 }}\n{posture}",
        offset.x, offset.y, offset.z
    );
    let file = File::read(&text);
    let mut context = control_context(&model, "hand");
    if is_limited {
        context.limits = limits_around(&start);
    }
    let mut controller =
        OperationalSpaceController::new(&model, &file.task_set(), &context).expect("a good stack");
    let mut motion = Motion::new(&model, &start);
    let mut tau = [0.0; 6];
    let mut last = 0.0_f64;
    while motion.time_s < 8.0 {
        assert!(motion.cycle(&model, &mut controller, &mut tau), "{:?}", motion.dq);
        if motion.time_s > 6.0 {
            last = last.max(motion.speed());
        }
    }
    let (data, _) = at_state(&model, &motion.q, &[0.0; 6], 0.0);
    let end = frame_placement(&model, &data, model.frame_id("hand").expect("hand")).translation;
    (last, (hand + offset - end).norm())
}

/// Compared: the true speed in the last two of eight seconds with 1e-3 rad/s, for 3-D and 6-D goals.
#[test]
fn arm_without_limits_comes_to_rest() {
    for number in 0..GOALS {
        let speed = final_speed(number, false);
        assert!(speed < AT_REST, "goal {number}: {speed:e} rad/s");
    }
}

/// Compared: the same speed for two hundred more goals with one that excludes a limit cycle. At one of them the arm still
/// moves to a better posture, at 0.2 rad/s.
#[test]
#[ignore = "half a minute"]
fn arm_without_limits_has_no_limit_cycle() {
    for number in GOALS..GOALS + 200 {
        let speed = final_speed(number, false);
        assert!(speed < IN_A_CYCLE, "goal {number}: {speed:e} rad/s");
    }
}

/// Compared: the true speed in the last two of eight seconds, with joints at their limits, with 1e-3 rad/s. Without
/// resistance and standstill two of the twenty arms come to rest.
#[test]
fn arm_within_limits_comes_to_rest() {
    for number in 0..GOALS {
        let speed = final_speed(number, true);
        assert!(speed < AT_REST, "goal {number}: {speed:e} rad/s");
    }
}

/// Compared: the same for two hundred more goals.
#[test]
#[ignore = "half a minute"]
fn arm_within_limits_comes_to_rest_at_more_goals() {
    for number in GOALS..GOALS + 200 {
        let speed = final_speed(number, true);
        assert!(speed < AT_REST, "goal {number}: {speed:e} rad/s");
    }
}

/// A posture below the task does not draw the arm away from the goal. Compared: the distances to 3-D goals with and
/// without a posture task, and the true speeds at the end with 1e-3 rad/s. Drawn by the posture, the arms ended up to
/// 0.1 m farther away.
#[test]
fn posture_leaves_the_arm_at_the_closest_pose() {
    const POSTURE: &str = "[task.rest.joint-posture]\nfrequency_rad_per_s = 6.0\ndamping_ratio = 1.0\n";
    for number in (0..GOALS).step_by(2) {
        let (_, least) = at_end(number, false, "");
        let (speed, distance) = at_end(number, false, POSTURE);
        assert!(speed < AT_REST, "goal {number}: {speed:e} rad/s");
        assert!(distance < least + 0.01, "goal {number}: {distance} m away, {least} m without a posture");
    }
}
