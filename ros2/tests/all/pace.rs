//! Intervals of the states.

use opspace_ros2::pace::Pace;

/// Compared: mean and quantiles by hand.
#[test]
fn intervals_are_counted_in_twentieths_of_a_period() {
    let mut pace = Pace::new(0.01);
    for cycle in 0..100 {
        pace.add(if cycle == 99 { 0.2 } else { 0.0101 });
    }
    assert_eq!(pace.count(), 100);
    assert!((pace.mean_s() - (99.0 * 0.0101 + 0.2) / 100.0).abs() < 1e-12);
    assert!((pace.quantile_s(0.5) - 0.0105).abs() < 1e-12);
    assert!((pace.quantile_s(0.99) - 0.0105).abs() < 1e-12);
    assert!((pace.quantile_s(1.0) - 0.2).abs() < 1e-12);
    let text = pace.to_string();
    assert!(text.starts_with("100 states, every 12.00 ms on average (10.00 ms stated)"), "{text}");
}
