//! A robot that does not follow.

use opspace_ros2::following::FollowWatch;

#[test]
fn only_a_setpoint_that_moves_away_from_joints_at_rest_is_told() {
    let run = |q: &dyn Fn(f64) -> f64, setpoint: &dyn Fn(f64) -> f64| {
        let mut watch = FollowWatch::new(1, 0.1);
        (0..400)
            .map(|cycle| 0.01 * f64::from(cycle))
            .find(|t| watch.is_left_behind(*t, &[q(*t)], &[setpoint(*t)]))
    };
    let told = run(&|_| 0.3, &|t| 0.3 + 0.1 * t);
    assert!(told.is_some_and(|t| (1.0..1.1).contains(&t)), "{told:?}");
    // A jump is told after half a second.
    let told = run(&|_| 0.3, &|t| if t < 1.0 { 0.3 } else { 0.9 });
    assert!(told.is_some_and(|t| t >= 1.0), "{told:?}");
    assert_eq!(run(&|t| 0.3 + 0.1 * t, &|t| 0.4 + 0.1 * t), None);
    // A servo at a wall: the setpoint is away, but does not move on.
    assert_eq!(run(&|_| 0.3, &|_| 0.9), None);
    assert_eq!(run(&|_| 0.3, &|t| 0.3 + 0.05 * (9.0 * t).sin()), None);
}
