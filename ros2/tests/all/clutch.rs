//! Clutch of a task.

use nalgebra::Vector3;
use opspace_model::Placement;
use opspace_ros2::clutch::Clutch;

fn at(x: f64, yaw: f64) -> Placement {
    Placement::from_rpy([0.0, 0.0, yaw], [x, 0.0, 0.0])
}

/// Compared: targets by hand.
#[test]
fn a_clutch_lets_displacements_through() {
    let mut clutch = Clutch::default();
    let task = at(5.0, 1.0);
    assert_eq!(clutch.target(&at(1.0, 0.0), &task), Some(at(1.0, 0.0)), "without a clutch the pose counts");
    clutch.set(false);
    assert_eq!(clutch.target(&at(1.0, 0.0), &task), None);
    clutch.set(true);
    let first = clutch.target(&at(1.0, 0.2), &task).unwrap();
    assert!((first.translation - task.translation).norm() < 1e-15);
    // The task has moved meanwhile: what counts is where it was.
    let next = clutch.target(&at(1.5, 0.3), &at(9.0, 0.0)).unwrap();
    assert!((next.translation - Vector3::new(5.5, 0.0, 0.0)).norm() < 1e-15);
    assert!((next.rotation - at(0.0, 1.1).rotation).norm() < 1e-12);
    clutch.set(true);
    assert!(clutch.target(&at(1.5, 0.3), &task).is_some_and(|again| again == next), "closed already");
    clutch.set(false);
    clutch.set(true);
    let again = clutch.target(&at(1.5, 0.3), &task).unwrap();
    assert!((again.translation - task.translation).norm() < 1e-15, "it begins anew");
}
