//! Observer of the excess torque that the measured current shows.

use nalgebra::DVector;
use opspace_transformer::CurrentObserver;

/// Compared: δ after means that are not numbers, and δ without them; and δ after numbers without bounds, and its limits.
#[test]
fn excess_torque_stays_a_number() {
    let mut observer = CurrentObserver::new(&[10.0, 2.0]);
    observer.update(&[1.0, 1.0], &DVector::from_vec(vec![0.0, 0.5]));
    let before = observer.torque_disturbance().clone();
    assert!(before.iter().all(|torque| *torque > 0.0));
    observer.update(&[1.0, f64::NAN], &DVector::from_vec(vec![f64::NAN, 0.5]));
    observer.update(&[f64::INFINITY, 1.0], &DVector::from_vec(vec![f64::INFINITY, f64::NAN]));
    assert_eq!(*observer.torque_disturbance(), before);
    // Three times the torque limits.
    observer.update(&[f64::INFINITY, 1.0], &DVector::from_vec(vec![0.0, f64::INFINITY]));
    assert_eq!(observer.torque_disturbance().as_slice(), [30.0, -6.0]);
}
