//! Tests of the round trip of values, layouts and files, and of the messages for viewers.
#![expect(clippy::unwrap_used, reason = "tests")]

use crate::common::{bits, channels, header, log, row, time};
use foxglove::messages::{FrameTransform, FrameTransforms, JointStates, PoseInFrame, SceneUpdate};
use mcap::MessageStream;
use opspace_backend::{Layout, Signal};
use opspace_log::{
    Channel, ForceArrow, Header, LOG, LogError, ObjectShape, Pace, Recording, Scene, SceneCapsule,
    SceneObject, TIME_ZERO_NS, Wall, record,
};
use opspace_model::{Data, Model, Placement, frame_placement, kinematics};
use prost::Message;
use prost_types::FileDescriptorSet;
use std::io::Cursor;
use std::sync::Arc;

/// Compared bit for bit: rows read and rows pushed, over several chunks.
#[test]
fn values_round_trip_bit_for_bit() {
    let ticks = 4000;
    let (written, bytes) = log(header(), ticks);
    assert_eq!((written.records, written.dropped), (3 * ticks as u64, 0));
    let recording = Recording::from_bytes(&bytes).unwrap();
    assert_eq!(recording.damage, None);
    let (tick, servo) = (&recording.channels[0], &recording.channels[1]);
    assert_eq!((tick.len(), servo.len()), (ticks, 2 * ticks));
    for k in 0..ticks {
        assert_eq!(tick.time_s[k].to_bits(), time(k).to_bits());
        assert_eq!(bits(tick.row(k)), bits(&row(k, 9)), "tick {k}");
        assert_eq!(bits(servo.row(2 * k + 1)), bits(&row(2 * k + 1, 1)), "servo row of tick {k}");
    }
}

/// Compared: layouts, metadata and attachments read, and those recorded; signals are looked up by name.
#[test]
fn layout_and_attachments_round_trip() {
    let (_, bytes) = log(header(), 3);
    let recording = Recording::from_bytes(&bytes).unwrap();
    let read: Vec<_> = recording.channels.iter().map(|c| c.layout.clone()).collect();
    let given: Vec<_> = channels().into_iter().map(|c| c.layout).collect();
    assert_eq!(read, given);
    assert_eq!(recording.attachments, header().attachments);
    assert_eq!(recording.metadata("run"), Some(&header().metadata[0].1));
    assert_eq!(recording.metadata(LOG).unwrap()["time_zero_ns"], TIME_ZERO_NS.to_string());
    assert_eq!(recording.library, concat!("opspace ", env!("CARGO_PKG_VERSION")));
    assert_eq!(recording.dropped(), 0);

    let tick = recording.channel("tick").unwrap();
    let dq = tick.signal("dq").unwrap();
    assert_eq!(
        (dq.elements(), dq.unit(), dq.len()),
        (&given[0].signals[1].elements[..], "rad/s".to_owned(), 3)
    );
    assert_eq!(bits(dq.row(2)), bits(&row(2, 9)[2..4]));
    let hand = tick.signal("hand.position").unwrap();
    assert_eq!(bits(&hand.rows().flatten().copied().collect::<Vec<_>>()[6..]), bits(&row(2, 9)[6..]));
    assert!(tick.signal("no.joints").is_none(), "it has no element");
    assert!(tick.signal("nothing").is_none() && recording.channel("nothing").is_none());
}

/// Compared byte for byte: two recordings of the same rows. They don't depend on the wall clock or on thread timing.
#[test]
fn equal_rows_make_equal_files() {
    let (_, one) = log(header(), 3000);
    let (_, other) = log(header(), 3000);
    assert!(one == other);
}

/// Checks that a log without rows is complete and has its layouts.
#[test]
fn empty_run_keeps_its_layouts() {
    let (_, bytes) = log(header(), 0);
    let recording = Recording::from_bytes(&bytes).unwrap();
    assert_eq!(recording.damage, None);
    assert_eq!(recording.channels[0].layout, channels()[0].layout);
    assert!(recording.channels[0].is_empty());
}

/// Checks that any protobuf reader can read the rows: the definition in the file, decoded by prost's types, names the
/// fields of the encoded values.
#[test]
fn generic_protobuf_reader_finds_the_fields() {
    let (_, bytes) = log(Header::default(), 5);
    let message = MessageStream::new(&bytes).unwrap().map(Result::unwrap);
    let message = message.filter(|m| m.channel.topic == "/opspace/tick").nth(3).unwrap();
    assert_eq!(message.log_time, TIME_ZERO_NS + 1_000_000);
    assert_eq!(message.publish_time, message.log_time);
    let schema = message.channel.schema.clone().unwrap();
    assert_eq!((schema.name.as_str(), schema.encoding.as_str()), ("opspace.Tick", "protobuf"));
    let set = FileDescriptorSet::decode(&*schema.data).unwrap();
    let fields = &set.file[0].message_type[0].field;
    let names: Vec<_> = fields.iter().map(|f| (f.name(), f.number())).collect();
    let expected =
        [("t", 1), ("q", 2), ("dq", 3), ("motor_torque", 4), ("no_joints", 5), ("hand_position", 6)];
    assert_eq!(names, expected);

    /// Message of the channel `tick`, declared by hand.
    #[derive(Clone, PartialEq, prost::Message)]
    struct Tick {
        #[prost(double, tag = "1")]
        t: f64,
        #[prost(message, optional, tag = "2")]
        q: Option<Values>,
        #[prost(message, optional, tag = "6")]
        hand_position: Option<Values>,
    }

    /// Elements of a signal.
    #[derive(Clone, Copy, PartialEq, prost::Message)]
    struct Values {
        #[prost(double, optional, tag = "1")]
        first: Option<f64>,
        #[prost(double, optional, tag = "2")]
        second: Option<f64>,
        #[prost(double, optional, tag = "3")]
        third: Option<f64>,
    }
    let values = |values: &[f64]| values.iter().copied().map(Some).collect::<Vec<_>>();
    let tick = Tick::decode(&*message.data).unwrap();
    assert_eq!(tick.t, time(3));
    let (q, hand) = (tick.q.unwrap(), tick.hand_position.unwrap());
    assert_eq!([q.first, q.second].as_slice(), values(&row(3, 9)[..2]));
    assert_eq!([hand.first, hand.second, hand.third].as_slice(), values(&row(3, 9)[6..]));
}

const ARM: &str = r#"<robot name="arm">
  <link name="world"/>
  <link name="upper"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="lower"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="continuous"><parent link="world"/><child link="upper"/>
    <origin xyz="0.1 0.2 0.3" rpy="0.4 0.5 0.6"/><axis xyz="0 1 0"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/>
    <origin xyz="0 0 0.5"/><axis xyz="1 0 0"/></joint>
</robot>"#;

/// Compared: `/joint_states` and the rows, `/tf` with `/tf_static` and the model's kinematics, at no more than 50 Hz; fixed
/// frames are written once. The arm is mounted on a slope.
#[test]
fn viewers_get_joint_states_and_transforms() {
    let base = Placement::from_rpy([0.3, -1.2, 0.4], [0.5, -0.2, 1.5]);
    let model = Arc::new(Model::from_urdf(ARM).unwrap().model.with_base(base));
    let (_, bytes) = log(Header { model: Some(Arc::clone(&model)), ..Header::default() }, 101);
    let messages: Vec<_> = MessageStream::new(&bytes).unwrap().map(Result::unwrap).collect();
    let of = |topic: &str, schema: &str| {
        let of: Vec<_> = messages.iter().filter(|m| m.channel.topic == topic).collect();
        assert!(of.iter().all(|m| m.channel.schema.as_ref().unwrap().name == schema), "{topic}");
        of
    };
    let states = of("/joint_states", "foxglove.JointStates");
    let transforms = of("/tf", "foxglove.FrameTransforms");
    // Some rows have a position that is not finite.
    let finite = (0..=100).step_by(20).filter(|&k| row(k, 9)[..2].iter().all(|q| q.is_finite())).count();
    assert_eq!((states.len(), transforms.len()), (6, finite), "0.1 s at 50 Hz");

    let shown = 20;
    let shown_transforms = transforms.iter().find(|m| m.log_time == states[1].log_time).unwrap();
    assert_eq!(states[1].log_time, TIME_ZERO_NS + 18_000_000);
    let joints = JointStates::decode(&*states[1].data).unwrap().joints;
    let row = row(shown, 9);
    for (i, name) in ["shoulder", "elbow"].iter().enumerate() {
        assert_eq!(joints[i].name, *name);
        assert_eq!(joints[i].position.unwrap().to_bits(), row[i].to_bits());
        assert_eq!(joints[i].velocity.unwrap().to_bits(), row[2 + i].to_bits());
        assert_eq!(joints[i].effort.unwrap().to_bits(), row[4 + i].to_bits());
    }

    let transforms = FrameTransforms::decode(&*shown_transforms.data).unwrap().transforms;
    let mut data = Data::new(&model);
    kinematics(&model, &mut data, &row[..2], &[0.0; 2]);
    let fixed = of("/tf_static", "foxglove.FrameTransforms");
    assert_eq!((fixed.len(), fixed[0].log_time), (1, states[0].log_time));
    let fixed = FrameTransforms::decode(&*fixed[0].data).unwrap().transforms;
    let names = |transforms: &[FrameTransform]| {
        transforms.iter().map(|t| t.child_frame_id.clone()).collect::<Vec<_>>()
    };
    assert_eq!(
        (names(&transforms), names(&fixed)),
        (vec!["upper".to_owned(), "lower".to_owned()], vec!["world".to_owned()])
    );
    for transform in transforms.iter().chain(&fixed) {
        let of = |name: &str| frame_placement(&model, &data, model.frame_id(name).unwrap());
        // A link is named "world" here, which is the base.
        let (child, parent) = (transform.child_frame_id.as_str(), transform.parent_frame_id.as_str());
        let placement = match parent {
            "world_" => of(child),
            parent => of(parent).inverse() * of(child),
        };
        assert!(
            [("world", "world_"), ("upper", "world"), ("lower", "upper")].contains(&(child, parent)),
            "{child}"
        );
        let (p, r) = (transform.translation.unwrap(), transform.rotation.unwrap());
        let from_message = nalgebra::Quaternion::new(r.w, r.x, r.y, r.z);
        let rotation = nalgebra::UnitQuaternion::new_unchecked(from_message).to_rotation_matrix();
        // Conversion of a rotation matrix to a quaternion and back: about ten roundings of numbers up to 1.
        assert!((rotation.matrix() - placement.rotation).amax() < 16.0 * f64::EPSILON);
        assert_eq!([p.x, p.y, p.z], <[f64; 3]>::from(placement.translation));
    }
}

/// Compared: poses of tasks, walls, arrows of forces and the URDF, and the rows and the scene they are made from. A task
/// that does not apply (NaN) has no pose.
#[test]
fn viewers_get_tasks_and_scene() {
    let model = Arc::new(Model::from_urdf(ARM).unwrap().model);
    let xyz = ["x", "y", "z"];
    let wxyz = ["w", "x", "y", "z"];
    let tick = Layout {
        channel: "tick".to_owned(),
        signals: vec![
            Signal::new("q", "rad", &["shoulder", "elbow"]),
            Signal::new("hand.reference", "m", &xyz),
            Signal::new("hand.reference_orientation", "1", &wxyz),
            Signal::new("hand.position", "m", &xyz),
            Signal::new("hand.orientation", "1", &wxyz),
        ],
    };
    let truth = Layout {
        channel: "truth".to_owned(),
        signals: vec![
            Signal::new("wall.force", "N", &xyz),
            Signal::new("load.position", "m", &xyz),
            Signal::new("load.orientation", "1", &wxyz),
            Signal::new("weight.position", "m", &xyz),
        ],
    };
    let channels = [tick, truth].map(|layout| Channel { layout, rate_hz: 50.0 });
    let scene = Scene {
        robot_description: Some(ARM.to_owned()),
        relative_to: [("hand".to_owned(), "upper".to_owned())].into(),
        walls: vec![Wall { name: "wall".to_owned(), point_m: [0.5, 0.0, 0.2], normal: [-2.0, 0.0, 0.0] }],
        capsules: vec![SceneCapsule {
            name: "post".to_owned(),
            frame: None,
            start_m: [1.0, 0.0, 0.0],
            end_m: [1.0, 0.0, 0.5],
            radius_m: 0.1,
        }],
        forces: vec![ForceArrow {
            channel: "truth".to_owned(),
            signal: "wall.force".to_owned(),
            frame: "lower".to_owned(),
        }],
        objects: [
            ("load", ObjectShape::Box([0.4, 0.1, 0.2])),
            ("weight", ObjectShape::Ball(0.06)),
            ("absent", ObjectShape::Ball(0.06)),
        ]
        .map(|(name, shape)| SceneObject { name: name.to_owned(), shape })
        .into(),
    };
    let header = Header { model: Some(model), scene, ..Header::default() };
    let (mut recorder, writer) =
        record(Cursor::new(Vec::new()), header, channels.to_vec(), Pace::Simulated).unwrap();
    let pose = [0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0];
    for k in 0..10 {
        // The weight hangs at the arm in the second half.
        let weight = if k < 5 { [f64::NAN; 3] } else { [0.0, 0.7, 0.0] };
        let load = [0.5, 0.6, 0.7, 0.0, 0.0, 0.0, 1.0];
        recorder.push(1, k as f64 * 0.02, &[&[0.0, 0.0, 5.0], &load[..], &weight].concat());
        let reference = if k < 5 { pose } else { [f64::NAN; 7] };
        recorder.push(0, k as f64 * 0.02, &[&[0.3, 0.4], &reference[..], &pose].concat());
    }
    drop(recorder);
    let bytes = writer.finish().unwrap().1.into_inner();
    let messages: Vec<_> = MessageStream::new(&bytes).unwrap().map(Result::unwrap).collect();
    let of = |topic: &str| messages.iter().filter(|m| m.channel.topic == topic).collect::<Vec<_>>();

    assert_eq!((of("/hand/reference").len(), of("/hand/controlled_frame").len()), (5, 10));
    let shown = PoseInFrame::decode(&*of("/hand/reference")[0].data).unwrap();
    assert_eq!(shown.frame_id, "upper");
    let position = shown.pose.unwrap().position.unwrap();
    assert_eq!([position.x, position.y, position.z], [0.1, 0.2, 0.3]);

    let walls = of("/scene/environment");
    assert_eq!(walls.len(), 1);
    let walls = SceneUpdate::decode(&*walls[0].data).unwrap().entities;
    let center = walls[0].cubes[0].pose.unwrap().position.unwrap();
    assert_eq!((walls[0].id.as_str(), [center.x, center.y, center.z]), ("wall", [0.505, 0.0, 0.2]));

    let capsules = SceneUpdate::decode(&*of("/scene/collision")[0].data).unwrap().entities;
    let (cylinder, sphere) = (capsules[0].cylinders[0], capsules[0].spheres[1]);
    let (size, center) = (cylinder.size.unwrap(), cylinder.pose.unwrap().position.unwrap());
    assert_eq!(
        [size.x, size.y, size.z, cylinder.bottom_scale, cylinder.top_scale],
        [0.2, 0.2, 0.5, 1.0, 1.0]
    );
    assert_eq!([center.x, center.y, center.z], [1.0, 0.0, 0.25]);
    let (size, center) = (sphere.size.unwrap(), sphere.pose.unwrap().position.unwrap());
    assert_eq!([size.x, center.x, center.y, center.z], [0.2, 1.0, 0.0, 0.5]);
    assert!(cylinder.color.unwrap().a > 0.0 && sphere.color.unwrap().a > 0.0);

    let forces = SceneUpdate::decode(&*of("/scene/forces")[3].data).unwrap().entities;
    let arrow = forces[0].arrows[0];
    assert!((arrow.shaft_length + arrow.head_length - 0.05).abs() < 1e-15, "{arrow:?}");
    let r = arrow.pose.unwrap().orientation.unwrap();
    let up = nalgebra::UnitQuaternion::new_normalize(nalgebra::Quaternion::new(r.w, r.x, r.y, r.z))
        * nalgebra::Vector3::x();
    assert!((up - nalgebra::Vector3::z()).amax() < 8.0 * f64::EPSILON, "{up}");

    let objects = of("/scene/objects");
    assert_eq!(objects.len(), 10);
    let shown = |k: usize| SceneUpdate::decode(&*objects[k].data).unwrap().entities;
    let [load, weight] = &shown(9)[..] else { panic!("two objects have signals") };
    let (pose, size) = (load.cubes[0].pose.unwrap(), load.cubes[0].size.unwrap());
    let (position, turned) = (pose.position.unwrap(), pose.orientation.unwrap());
    assert_eq!((load.id.as_str(), [size.x, size.y, size.z]), ("load", [0.4, 0.1, 0.2]));
    assert_eq!([position.x, position.y, position.z, turned.w, turned.z], [0.5, 0.6, 0.7, 0.0, 1.0]);
    assert_eq!((weight.spheres[0].size.unwrap().y, shown(2)[1].spheres.len()), (0.06, 0));

    let paths = SceneUpdate::decode(&*of("/scene/paths")[1].data).unwrap().entities;
    assert_eq!((paths[0].frame_id.as_str(), paths[0].lines[0].points.len()), ("upper", 5));

    let urdf = of("/robot_description");
    assert_eq!(urdf.len(), 1);
    assert_eq!(urdf[0].channel.schema.as_ref().unwrap().name, "std_msgs/msg/String");
    assert_eq!(&urdf[0].data[8..urdf[0].data.len() - 1], ARM.as_bytes());
}

/// Compared: the arrow of an external force on a point of a link, and the point by forward kinematics; none while no force acts.
#[test]
fn viewers_get_the_force_of_a_hand() {
    let model = Arc::new(Model::from_urdf(ARM).unwrap().model);
    let tick =
        Layout { channel: "tick".to_owned(), signals: vec![Signal::new("q", "rad", &["shoulder", "elbow"])] };
    let xyz = ["x", "y", "z"];
    let external = Layout {
        channel: "external".to_owned(),
        signals: vec![
            Signal::new("frame", "1", &["index"]),
            Signal::new("force", "N", &xyz),
            Signal::new("point", "m", &xyz),
        ],
    };
    let channels = [tick, external].map(|layout| Channel { layout, rate_hz: 50.0 });
    let scene = Scene { robot_description: Some(ARM.to_owned()), ..Scene::default() };
    let header = Header { model: Some(Arc::clone(&model)), scene, ..Header::default() };
    let (mut recorder, writer) =
        record(Cursor::new(Vec::new()), header, channels.to_vec(), Pace::Simulated).unwrap();
    let lower = model.frames().iter().position(|frame| frame.name == "lower").unwrap();
    let (q, point) = ([0.3, 0.4], [0.05, -0.02, 0.1]);
    let held = [&[lower as f64], &[0.0, 3.0, 4.0][..], &point].concat();
    let free = [&[f64::NAN], &[0.0; 3][..], &[f64::NAN; 3]].concat();
    for k in 0..10 {
        recorder.push(1, f64::from(k) * 0.02, if k < 5 { &held } else { &free });
        recorder.push(0, f64::from(k) * 0.02, &q);
    }
    drop(recorder);
    let bytes = writer.finish().unwrap().1.into_inner();
    let arrows: Vec<_> = MessageStream::new(&bytes)
        .unwrap()
        .map(Result::unwrap)
        .filter(|message| message.channel.topic == "/scene/forces")
        .map(|message| SceneUpdate::decode(&*message.data).unwrap().entities.remove(0).arrows)
        .collect();
    assert_eq!(arrows.iter().map(Vec::len).collect::<Vec<_>>(), [1, 1, 1, 1, 1, 0, 0, 0, 0, 0]);
    let mut data = opspace_model::Data::new(&model);
    opspace_model::kinematics(&model, &mut data, &q, &[0.0; 2]);
    let frame = opspace_model::frame_placement(&model, &data, model.frame_id("lower").unwrap());
    let expected = frame.translation + frame.rotation * nalgebra::Vector3::from(point);
    let at = arrows[3][0].pose.unwrap().position.unwrap();
    let away = nalgebra::Vector3::new(at.x, at.y, at.z) - expected;
    assert!(away.norm() < 8.0 * f64::EPSILON, "{away}");
    assert!((arrows[3][0].shaft_length + arrows[3][0].head_length - 0.05).abs() < 8.0 * f64::EPSILON);
}

/// Checks the errors for data that can't be recorded.
#[test]
fn mismatched_data_are_refused() {
    let twice = vec![channels().remove(0), channels().remove(0)];
    let error = record(Cursor::new(Vec::new()), Header::default(), twice, Pace::Simulated).unwrap_err();
    assert_eq!(error.to_string(), "two channels have the name 'tick'; names must be unique");

    let model = Some(Arc::new(Model::from_urdf(ARM).unwrap().model));
    let mut three = channels().remove(0);
    three.layout.signals[0].elements.push("wrist".to_owned());
    let three: Vec<Channel> = vec![three];
    let header = Header { model, ..Header::default() };
    let error = record(Cursor::new(Vec::new()), header, three, Pace::Simulated).unwrap_err();
    assert!(matches!(error, LogError::ModelMismatch { joints: 2, elements: 3, .. }), "{error}");
}
