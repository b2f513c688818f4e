//! Random collisions and random motions of the arm of the paper.

use crate::common;
use opspace_experiment::{Experiment, Files, RunOptions};
use std::f64::consts::TAU;
use std::path::Path;

pub const JOINTS: [&str; 4] = ["shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow"];

/// Numbers from 0 to 1 that look random, the same in each run.
pub struct Numbers(u64);

impl Numbers {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }

    /// Number whose logarithm is evenly distributed.
    pub fn of_magnitude(&mut self, low: f64, high: f64) -> f64 {
        self.within(low.ln(), high.ln()).exp()
    }

    pub fn posture(&mut self, ranges: [(f64, f64); 4]) -> [f64; 4] {
        ranges.map(|(low, high)| self.within(low, high))
    }
}

/// Number of cases: `name` of the environment, or `short`.
pub fn cases(name: &str, short: u64) -> u64 {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(short)
}

/// Loads a task with the detection of collisions, whose `reaction` is a value in TOML.
pub fn load(task: &str, reaction: &str, settings: &[String], options: RunOptions) -> Option<Experiment> {
    let mut all = vec![format!("robot.collision_detection.reaction={reaction}"), "settle_s=0.1".to_owned()];
    all.extend_from_slice(settings);
    let path = format!("tasks/{task}.toml");
    Experiment::load(Files::Embedded, Path::new(&path), None, options, &all).ok()
}

/// Length of a vector.
pub fn norm(vector: &[f64]) -> f64 {
    vector.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Posture as an inline table in TOML.
fn table(q: [f64; 4]) -> String {
    let joints: Vec<String> = JOINTS.iter().zip(q).map(|(joint, q)| format!("{joint}={q:?}")).collect();
    format!("{{{}}}", joints.join(","))
}

/// Position of the hand at these joint positions, m.
fn hand(q: [f64; 4]) -> [f64; 3] {
    let robot = common::robot(&[]);
    let mut data = opspace_model::Data::new(&robot.model);
    opspace_model::forward_kinematics(&robot.model, &mut data, &q);
    let frame = robot.model.frame_id("hand").unwrap_or_else(|e| panic!("{e}"));
    opspace_model::frame_placement(&robot.model, &data, frame).translation.into()
}

/// Settings of `cartesian-tracking` with a hand that moves by 10 cm in a random direction from a random posture, and meets a
/// wall of this stiffness halfway with 0.25 m/s.
pub fn collision(number: u64, stiffness_n_per_m: f64) -> Vec<String> {
    let mut numbers = Numbers::new(number + 1);
    let q = numbers.posture([(-0.8, 0.2), (-0.7, -0.1), (-0.5, 0.5), (-1.9, -0.8)]);
    let (height, angle) = (numbers.within(-1.0, 1.0), numbers.within(0.0, TAU));
    let flat = f64::sqrt(1.0 - height * height);
    let direction = [flat * angle.cos(), flat * angle.sin(), height];
    let offset = direction.map(|along| 0.1 * along);
    let start = hand(q);
    let wall: Vec<f64> = start.iter().zip(offset).map(|(start, offset)| start + 0.5 * offset).collect();
    vec![
        format!("start_rad={}", table(q)),
        format!(
            "task.hand.cartesian.reference={{point-to-point={{position={{offset_m={offset:?}}},duration_s=0.75}}}}"
        ),
        format!(
            "environment={{box={{wall={{frame=\"hand\",point_m={wall:?},normal={:?},stiffness_n_per_m={stiffness_n_per_m:?},damping_ns_per_m=50.0}}}}}}",
            direction.map(|along| -along)
        ),
    ]
}

/// Settings of `joint-tracking` with a random motion of this duration over the workspace, from posture to posture: slow and up to
/// 3 rad/s, long and short, with reversals, rests and small steps.
pub fn joint_motion(numbers: &mut Numbers, duration_s: f64) -> Vec<String> {
    let ranges = [(-1.2, 0.6), (-1.3, -0.1), (-1.0, 1.0), (-2.0, -0.4)];
    let start = numbers.posture(ranges);
    let (mut q, mut before, mut time_s, mut list) = (start, start, 0.5, Vec::new());
    while time_s < duration_s {
        let goal = match numbers.within(0.0, 10.0) as u64 {
            0 | 1 => before,
            2 => q,
            3 | 4 => {
                let near = q.map(|q| numbers.within(q - 0.05, q + 0.05));
                std::array::from_fn(|i| near[i].clamp(ranges[i].0, ranges[i].1))
            }
            _ => numbers.posture(ranges),
        };
        let way = q.iter().zip(goal).map(|(q, goal)| (goal - q).abs()).fold(0.0, f64::max);
        let (speed, acceleration) = (numbers.of_magnitude(0.05, 3.0), numbers.of_magnitude(3.0, 20.0));
        // Highest speed and acceleration of a motion of minimum jerk.
        let takes_s = f64::max(1.875 * way / speed, f64::sqrt(5.774 * way / acceleration));
        time_s += takes_s.clamp(0.1, 8.0);
        list.push(format!("{{time_s={time_s:?},goal={{absolute_rad={}}}}}", table(goal)));
        (before, q) = (q, goal);
    }
    vec![
        format!("start_rad={}", table(start)),
        format!("task.joints.joint-tracking.reference={{waypoints=[{}]}}", list.join(",")),
    ]
}

/// Settings of `cartesian-tracking` with a random curve about a random posture: two sines along each axis.
pub fn hand_motion(numbers: &mut Numbers) -> Vec<String> {
    let q = numbers.posture([(-0.8, 0.2), (-0.7, -0.2), (-0.5, 0.5), (-1.8, -1.0)]);
    let mut waves = || {
        let one = |frequency_hz: f64, speed: f64, phase: f64| {
            let amplitude = (speed / (TAU * frequency_hz)).min(0.05);
            format!(
                "{{amplitude_m={amplitude:?},frequency_hz={frequency_hz:?},phase_rad={phase:?},offset_m={:?}}}",
                -amplitude * phase.sin()
            )
        };
        let mut wave = |low: f64, high: f64| {
            one(numbers.of_magnitude(low, high), numbers.of_magnitude(0.02, 0.4), numbers.within(0.0, TAU))
        };
        format!("[{},{}]", wave(0.05, 0.4), wave(0.4, 2.0))
    };
    vec![
        format!("start_rad={}", table(q)),
        format!(
            "task.hand.cartesian.reference={{sinusoid={{ramp_s=1.0,x={},y={},z={}}}}}",
            waves(),
            waves(),
            waves()
        ),
    ]
}

/// Settings of four times the noise of encoders and motor currents.
pub fn noise() -> Vec<String> {
    let counts = JOINTS.map(|joint| format!("robot.joint.{joint}.rotor.encoder_counts_per_turn=4096"));
    [vec!["robot.simulated.torque_noise_nm=0.12".to_owned()], counts.to_vec()].concat()
}
