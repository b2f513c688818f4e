//! Messages of a page on its channels `/hand` and `/control`.

use crate::protocol::quote;
use serde::Deserialize;

/// Topic of the hand.
pub const HAND_TOPIC: &str = "/hand";

/// Topic of play, pause and gains.
pub const CONTROL_TOPIC: &str = "/control";

/// Stiffness of the hand unless the page states it, N/m.
pub const STIFFNESS_N_PER_M: f64 = 500.0;

/// Damping of the hand unless the page states it, Ns/m.
pub const DAMPING_NS_PER_M: f64 = 20.0;

/// Largest force of the hand unless the page states it, N.
pub const LARGEST_FORCE_N: f64 = 60.0;

/// Speeds of a view, as ratios of robot time to time.
pub const SPEEDS: [f64; 2] = [0.05, 4.0];

/// Bounds of what a page may ask for; a person's hand needs less.
const MOST_STIFFNESS_N_PER_M: f64 = 5000.0;
const MOST_DAMPING_NS_PER_M: f64 = 200.0;
const MOST_FORCE_N: f64 = 500.0;
const FARTHEST_M: f64 = 100.0;

/// Longest name of a frame, a task or an axis, bytes.
const LONGEST_NAME: usize = 256;

/// Spring between a point of a robot and a target.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Grasp {
    /// Name of the robot; all robots that have the link if absent.
    pub robot: Option<String>,
    /// Name of the link.
    pub frame: String,
    /// Point that is dragged, in the frame of the link, m.
    pub point_m: [f64; 3],
    /// Target, in the world, m.
    pub target_m: [f64; 3],
    /// Stiffness, N/m.
    pub stiffness_n_per_m: f64,
    /// Damping, Ns/m.
    pub damping_ns_per_m: f64,
    /// Largest force, N.
    pub largest_force_n: f64,
}

impl Default for Grasp {
    fn default() -> Self {
        Self {
            robot: None,
            frame: String::new(),
            point_m: [f64::NAN; 3],
            target_m: [f64::NAN; 3],
            stiffness_n_per_m: STIFFNESS_N_PER_M,
            damping_ns_per_m: DAMPING_NS_PER_M,
            largest_force_n: LARGEST_FORCE_N,
        }
    }
}

/// Message of the hand.
#[derive(Clone, Debug, PartialEq)]
pub enum HandMessage {
    /// Grasps or drags.
    Hold(Grasp),
    /// Lets go.
    Release,
}

/// Message of the controls.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "op", rename_all = "lowercase", deny_unknown_fields)]
pub enum ControlMessage {
    /// Continues.
    Play {},
    /// Pauses.
    Pause {},
    /// Executes one cycle while paused.
    Step {},
    /// Sets the ratio of robot time to time.
    Speed {
        /// Ratio.
        value: f64,
    },
    /// Begins a new run, or a log from its beginning.
    Restart {},
    /// Shows a log from another time on.
    Seek {
        /// Time on the robot's clock, s.
        time_s: f64,
    },
    /// Changes the gains of an axis of a task.
    Gains {
        /// Name of the task.
        task: String,
        /// Name of the axis.
        axis: String,
        /// Natural frequency, rad/s.
        natural_frequency_rad_per_s: f64,
        /// Damping ratio.
        damping_ratio: f64,
    },
    /// Changes the mode of an axis of a task.
    Mode {
        /// Name of the task.
        task: String,
        /// Name of the axis.
        axis: String,
        /// Name of the mode.
        mode: String,
    },
}

/// Message that lets go.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Release {
    release: bool,
}

/// Reads a message of the hand.
///
/// # Errors
/// A message that is not understood, with a description.
pub fn parse_hand(bytes: &[u8]) -> Result<HandMessage, String> {
    if serde_json::from_slice(bytes).is_ok_and(|Release { release }| release) {
        return Ok(HandMessage::Release);
    }
    let grasp: Grasp = parse(bytes)?;
    let is_within =
        |values: &[f64], [least, most]: [f64; 2]| values.iter().all(|value| (least..=most).contains(value));
    let everywhere = [-FARTHEST_M, FARTHEST_M];
    let bounds = [
        ("point_m", is_within(&grasp.point_m, everywhere)),
        ("target_m", is_within(&grasp.target_m, everywhere)),
        ("stiffness_n_per_m", is_within(&[grasp.stiffness_n_per_m], [0.0, MOST_STIFFNESS_N_PER_M])),
        ("damping_ns_per_m", is_within(&[grasp.damping_ns_per_m], [0.0, MOST_DAMPING_NS_PER_M])),
        ("largest_force_n", is_within(&[grasp.largest_force_n], [0.0, MOST_FORCE_N])),
        ("frame", (1..=LONGEST_NAME).contains(&grasp.frame.len())),
        ("robot", grasp.robot.as_ref().is_none_or(|robot| robot.len() <= LONGEST_NAME)),
    ];
    match bounds.into_iter().find(|(_, is_good)| !is_good) {
        Some((key, _)) => Err(format!("{HAND_TOPIC}: `{key}` is missing or out of range")),
        None => Ok(HandMessage::Hold(grasp)),
    }
}

/// Reads a message of the controls.
///
/// # Errors
/// A message that is not understood, with a description.
pub fn parse_control(bytes: &[u8]) -> Result<ControlMessage, String> {
    let message: ControlMessage = parse(bytes)?;
    let [slowest, fastest] = SPEEDS;
    let is_good = match &message {
        ControlMessage::Speed { value } => (slowest..=fastest).contains(value),
        ControlMessage::Seek { time_s } => time_s.is_finite(),
        ControlMessage::Gains { task, axis, natural_frequency_rad_per_s, damping_ratio } => {
            [task, axis].iter().all(|name| name.len() <= LONGEST_NAME)
                && natural_frequency_rad_per_s.is_finite()
                && damping_ratio.is_finite()
        }
        ControlMessage::Mode { task, axis, mode } => {
            [task, axis, mode].iter().all(|name| name.len() <= LONGEST_NAME)
        }
        _ => true,
    };
    if is_good { Ok(message) } else { Err(format!("out of range: {}", text(bytes))) }
}

fn parse<'a, T: Deserialize<'a>>(bytes: &'a [u8]) -> Result<T, String> {
    serde_json::from_slice(bytes).map_err(|error| format!("not understood: {} ({error})", text(bytes)))
}

fn text(bytes: &[u8]) -> String {
    // Enough of it for a quotation, whatever its length.
    quote(&String::from_utf8_lossy(&bytes[..bytes.len().min(1000)]))
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;

    /// Compared: messages of the page, and their meaning.
    #[test]
    fn messages_of_the_page_are_understood() {
        let hold =
            br#"{"frame": "tip", "point_m": [0, 0, 0.1], "target_m": [0.3, 0, 0.5], "largest_force_n": 30}"#;
        let expected = Grasp {
            frame: "tip".to_owned(),
            point_m: [0.0, 0.0, 0.1],
            target_m: [0.3, 0.0, 0.5],
            largest_force_n: 30.0,
            ..Grasp::default()
        };
        assert_eq!(parse_hand(hold).unwrap(), HandMessage::Hold(expected));
        assert_eq!(parse_hand(br#"{"release": true}"#).unwrap(), HandMessage::Release);
        assert_eq!(parse_control(br#"{"op": "play"}"#).unwrap(), ControlMessage::Play {});
        assert_eq!(
            parse_control(br#"{"op": "speed", "value": 0.25}"#).unwrap(),
            ControlMessage::Speed { value: 0.25 }
        );
    }

    /// Messages that would be no force, or are not JSON, are named and refused.
    #[test]
    fn other_messages_are_refused() {
        for bad in [
            "",
            "{",
            "null",
            r#"{"release": false}"#,
            r#"{"frame": "tip"}"#,
            r#"{"frame": "tip", "point_m": [0, 0, 0], "target_m": [1e99, 0, 0]}"#,
            r#"{"frame": "tip", "point_m": [0, 0, 0], "target_m": [NaN, 0, 0]}"#,
            r#"{"frame": "", "point_m": [0, 0, 0], "target_m": [0, 0, 0]}"#,
            r#"{"frame": "tip", "point_m": [0, 0], "target_m": [0, 0, 0]}"#,
            r#"{"frame": "tip", "point_m": [0, 0, 0], "target_m": [0, 0, 0], "stiffness_n_per_m": 1e9}"#,
            r#"{"frame": "tip", "point_m": [0, 0, 0], "target_m": [0, 0, 0], "more": 1}"#,
        ] {
            assert!(parse_hand(bad.as_bytes()).is_err(), "{bad}");
        }
        for bad in
            ["{}", r#"{"op": "explode"}"#, r#"{"op": "speed", "value": 0}"#, r#"{"op": "speed"}"#, "[]"]
        {
            assert!(parse_control(bad.as_bytes()).is_err(), "{bad}");
        }
        assert!(parse_control(&[0xff; 100_000]).unwrap_err().len() < 500);
    }
}
