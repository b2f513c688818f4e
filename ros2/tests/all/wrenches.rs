//! Wrenches of force sensors.

use crate::common::{config, settings};
use opspace_backend::Setting;
use opspace_ros2::messages::{Header, Vector3, Wrench, WrenchStamped};
use opspace_ros2::tare::Tare;
use opspace_ros2::wrenches::WrenchReader;
use opspace_ros2::{RosConfig, RosFault};

fn message(frame: &str, z: f64) -> WrenchStamped {
    let force = Vector3 { x: 1.0, y: 2.0, z };
    let header = Header { frame_id: frame.to_owned(), ..Header::default() };
    WrenchStamped { header, wrench: Wrench { force, torque: Vector3 { x: 4.0, y: 5.0, z: 6.0 } } }
}

#[test]
fn wrenches_are_those_on_the_robot_in_the_frame_of_the_sensor() {
    let mut reader = WrenchReader::new(&config(), Tare::default());
    reader.read(0, &message("tool", 3.0), 0.0).unwrap();
    assert_eq!(reader.values(), [[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]]);
    let inverted =
        RosConfig::from_settings(&settings().with("wrenches_inverted", Setting::Flag(true))).unwrap();
    let mut reader = WrenchReader::new(&inverted, Tare::default());
    reader.read(0, &message("", 3.0), 0.0).unwrap();
    assert_eq!(reader.values(), [[-1.0, -2.0, -3.0, -4.0, -5.0, -6.0]]);
    let (fault, details) = reader.read(0, &message("ee", 3.0), 0.0).expect_err("another frame");
    assert_eq!(fault, RosFault::WrenchMalformed);
    assert!(details.contains("'tool'") && details.contains("'ee'"), "{details}");
    assert!(reader.read(0, &message("tool", f64::NAN), 0.0).is_err());
}

#[test]
fn a_silent_sensor_is_named() {
    let mut reader = WrenchReader::new(&config(), Tare::default());
    reader.read(0, &message("tool", 3.0), 1.0).unwrap();
    assert_eq!(reader.check_silence(1.05), Ok(()));
    assert_eq!(reader.check_silence(1.2), Err((RosFault::WrenchSilent, "tip".to_owned())));
}

/// Compared: values after a tare, and the wrench less its mean by hand.
#[test]
fn a_tare_makes_the_mean_the_zero() {
    let tare = Tare::default();
    let mut reader = WrenchReader::new(&config(), tare.clone());
    reader.read(0, &message("tool", 3.0), 0.0).unwrap();
    tare.ask();
    // Twenty wrenches in 0.209 s: five of 2 N and fifteen of 4 N.
    for cycle in 0..20 {
        let z = if cycle % 4 == 0 { 2.0 } else { 4.0 };
        reader.read(0, &message("tool", z), 1.0 + 0.011 * f64::from(cycle)).unwrap();
    }
    reader.read(0, &message("tool", 3.0), 2.0).unwrap();
    let [x, _, z, ..] = reader.values()[0];
    assert!(x.abs() < 1e-12 && (z + 0.5).abs() < 1e-12, "{x} {z}");
}
