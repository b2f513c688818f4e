//! Frames of targets.

use nalgebra::Vector3;
use opspace_model::{Data, Model, frame_placement, kinematics};
use opspace_ros2::frames::{FrameRef, Frames, placement};
use opspace_ros2::messages::{
    Header, Quaternion, TfMessage, Transform, TransformStamped, Vector3 as Components,
};

const URDF: &str = r#"<robot name="r"><link name="base"/><link name="arm"><inertial><mass value="1"/>
  <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 1"/><axis xyz="0 0 1"/>
  <limit lower="-2" upper="2" effort="1" velocity="1"/></joint></robot>"#;

fn fixed(parent: &str, child: &str, x: f64) -> TransformStamped {
    TransformStamped {
        header: Header { frame_id: parent.to_owned(), ..Header::default() },
        child_frame_id: child.to_owned(),
        transform: Transform {
            translation: Components { x, y: 0.0, z: 0.0 },
            rotation: Quaternion::default(),
        },
    }
}

/// Compared: a point by hand, at a quarter turn of the joint.
#[test]
fn frames_of_the_urdf_and_static_frames_on_them_are_found() {
    let model = Model::from_urdf(URDF).unwrap().model;
    let mut frames = Frames::new(model.clone());
    frames.add(&TfMessage { transforms: vec![fixed("camera", "/tag", 0.5), fixed("arm", "camera", 2.0)] });
    let at = |found: FrameRef, q: f64| {
        let mut data = Data::new(&model);
        kinematics(&model, &mut data, &[q], &[0.0]);
        let parent = found.frame.map(|frame| frame_placement(&model, &data, frame));
        parent.map_or(found.offset, |parent| parent * found.offset).translation
    };
    let tag = frames.find("tag").unwrap();
    assert!((at(tag, std::f64::consts::FRAC_PI_2) - Vector3::new(0.0, 2.5, 1.0)).norm() < 1e-12);
    assert!((at(frames.find("/base").unwrap(), 1.0) - Vector3::zeros()).norm() < 1e-12);
    assert_eq!(frames.find("").unwrap(), FrameRef::world());
    assert_eq!(frames.find("world").unwrap(), FrameRef::world());
}

#[test]
fn unknown_frames_and_circles_of_frames_are_refused() {
    let mut frames = Frames::new(Model::from_urdf(URDF).unwrap().model);
    frames.add(&TfMessage { transforms: vec![fixed("a", "b", 1.0), fixed("b", "a", 1.0)] });
    for name in ["a", "nowhere"] {
        let words = frames.find(name).expect_err("no frame");
        assert!(words.contains(name), "{words}");
    }
}

#[test]
fn only_unit_quaternions_are_orientations() {
    let zero = Components::default();
    assert!(placement(zero, Quaternion::default()).is_some());
    assert!(placement(zero, Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 0.0 }).is_none());
    assert!(placement(zero, Quaternion { x: f64::NAN, ..Quaternion::default() }).is_none());
    assert!(placement(Components { x: f64::INFINITY, ..zero }, Quaternion::default()).is_none());
}
