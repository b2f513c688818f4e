//! Targets from messages.

use opspace_control::AxisMode;
use opspace_model::Model;
use opspace_ros2::frames::Frames;
use opspace_ros2::inputs::{Input, gains, modes, pose, twist, wrench};
use opspace_ros2::messages::{
    Float64MultiArray, Header, MultiArrayLayout, PoseStamped, Stamp, Text, TwistStamped, Vector3,
    WrenchStamped,
};

fn frames() -> Frames {
    Frames::new(
        Model::from_urdf(
            r#"<robot name="r"><link name="base"/><link name="arm"><inertial><mass value="1"/>
            <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
            <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
            <limit lower="-2" upper="2" effort="1" velocity="1"/></joint></robot>"#,
        )
        .unwrap()
        .model,
    )
}

fn header(age_s: f64, frame: &str) -> Header {
    let stamp = if age_s.is_nan() { Stamp::default() } else { Stamp::from_seconds(100.0 - age_s) };
    Header { stamp, frame_id: frame.to_owned() }
}

const NOW: Stamp = Stamp { sec: 100, nanosec: 0 };

#[test]
fn old_targets_are_refused_and_those_without_a_stamp_are_not() {
    for (age_s, is_taken) in [(0.1, true), (f64::NAN, true), (0.6, false), (-0.6, false)] {
        let message = PoseStamped { header: header(age_s, ""), ..PoseStamped::default() };
        let taken = pose(0, &message, &frames(), NOW, 0.5);
        assert_eq!(taken.is_ok(), is_taken, "{age_s}: {taken:?}");
    }
}

#[test]
fn targets_in_unknown_frames_or_with_wrong_numbers_are_refused() {
    let unknown = PoseStamped { header: header(0.0, "moon"), ..PoseStamped::default() };
    assert!(pose(0, &unknown, &frames(), NOW, 0.5).is_err_and(|words| words.contains("moon")));
    let mut infinite = TwistStamped { header: header(0.0, "base"), ..TwistStamped::default() };
    infinite.twist.linear = Vector3 { x: f64::INFINITY, y: 0.0, z: 0.0 };
    assert!(twist(0, &infinite, &frames(), NOW, 0.5).is_err());
    let framed = WrenchStamped { header: header(0.0, "base"), ..WrenchStamped::default() };
    assert!(wrench(0, &framed, NOW, 0.5).is_err_and(|words| words.contains("axes of its task")));
}

#[test]
fn gains_and_modes_are_read() {
    let array = |data: Vec<f64>| Float64MultiArray { layout: MultiArrayLayout::default(), data };
    let data: Vec<f64> = (1..=12).map(f64::from).collect();
    let expected = Input::Gains(3, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [7.0, 8.0, 9.0, 10.0, 11.0, 12.0]);
    assert_eq!(gains(3, &array(data)), Ok(expected));
    assert!(gains(3, &array(vec![1.0])).is_err_and(|words| words.contains("not 1")));
    let text = |data: &str| Text { data: data.to_owned() };
    let mut wanted = [None; 6];
    (wanted[0], wanted[2]) = (Some(AxisMode::Compliant), Some(AxisMode::Force));
    assert_eq!(modes(1, &text("x=compliant  z=force")), Ok(Input::Modes(1, wanted)));
    for (wrong, words) in
        [("x", "AXIS=MODE"), ("w=force", "unknown axis 'w'"), ("x=soft", "unknown mode 'soft'")]
    {
        assert!(modes(1, &text(wrong)).is_err_and(|said| said.contains(words)), "{wrong}");
    }
}
