//! Response of a controlled frame to external forces: deflection, stiffness, hysteresis and return along each axis of space.

use super::task_axes::{TaskAxes, TaskRow};
use crate::metrics::metric_tables::{ForceResponse, response_names};
use nalgebra::Vector3;
use std::collections::BTreeMap;

/// Smallest external force that is a push, N.
const PUSHED_N: f64 = 0.5;

/// Number of samples that are kept at most, and the time between two of them at first, s.
const MAX_SAMPLES: usize = 8192;
const SPACING_S: f64 = 1e-3;

/// Part of the spacing after which a sample is due: times are rounded.
const EARLY: f64 = 0.99;

/// Number of intervals of the force in which displacements are compared, and the fewest samples of each direction in one.
const BINS: usize = 20;
const LEAST_IN_BIN: usize = 3;

/// Change of the force that reverses its direction, relative to its range.
const REVERSED: f64 = 0.02;

/// Smallest force along an axis with which the response is its own, relative to the force along another axis.
const ALONG: f64 = 0.1;

/// Force that counts as none, relative to the largest.
const RELEASED: f64 = 0.05;

/// Smallest squared correlation of displacement and force with which their ratio is a stiffness.
const CORRELATED: f64 = 0.5;

/// Force and displacement along the axes of a task at one time; an axis that is not considered is NaN.
#[derive(Clone, Copy, Debug)]
pub struct ResponseSample {
    /// Time after the start of control, s.
    pub time_s: f64,
    /// External force on the frame, N.
    pub force_n: Vector3<f64>,
    /// Displacement from the first sample, m: of the deviation from the reference on motion axes, of the position on compliant axes.
    pub moved_m: Vector3<f64>,
}

/// Forces and displacements of a task while segments of a log arrive.
#[derive(Clone, Debug)]
pub struct Response {
    samples: Vec<ResponseSample>,
    spacing_s: f64,
    /// Largest magnitudes of force (N) and displacement (m) of all rows, also of those between two samples.
    largest: [Vector3<f64>; 2],
    /// Deviation (m) and modes at the first sample.
    first: Option<(Vector3<f64>, [AxisResponse; 3])>,
}

/// Response of an axis to a force.
#[derive(Clone, Copy, Debug, PartialEq)]
enum AxisResponse {
    /// Follows a reference, from which a force deflects it against the stiffness of an impedance, N/m, if there is one.
    Deflects(Option<f64>),
    /// Compliant, or not controlled.
    Moves,
}

/// Numbers of the response of one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisNumbers {
    /// Largest magnitude of the external force, N.
    pub force_max_n: f64,
    /// Largest magnitude of the displacement, m.
    pub deflection_max_m: f64,
    /// True if the axis follows a reference, from which the force deflects it.
    pub deflects: bool,
    /// Slope of the line of the force over the displacement, N/m.
    pub stiffness_n_per_m: Option<f64>,
    /// Largest difference of the displacement at one force, while it rises and while it falls, m; `None` without a stiffness.
    pub hysteresis_m: Option<f64>,
    /// Displacement at the end without force, magnitude, m.
    pub(crate) return_m: Option<f64>,
    /// Stiffness of the impedance, N/m; `None` without one.
    pub desired_n_per_m: Option<f64>,
}

impl Default for Response {
    fn default() -> Self {
        Self { samples: Vec::new(), spacing_s: SPACING_S, largest: [Vector3::zeros(); 2], first: None }
    }
}

impl Response {
    /// Adds the external force on the frame in the axes of the task (N), the axes, and the deviation from the reference in these axes
    /// (m; `None` without a reference). Rows of a task that controls a force are left out.
    pub fn add(
        &mut self,
        time_s: f64,
        row: &TaskRow,
        axes: &TaskAxes,
        force_n: &Vector3<f64>,
        error_m: Option<&Vector3<f64>>,
    ) {
        if axes.force.contains(&true) || (axes.motion[..3].contains(&true) && error_m.is_none()) {
            return;
        }
        let position_m = row.rotation.tr_mul(&row.pose.translation);
        let modes = [0, 1, 2].map(|axis| match axes.motion[axis] {
            true => AxisResponse::Deflects(axes.stiffness_n_per_m[axis]),
            false => AxisResponse::Moves,
        });
        let deviation_m = Vector3::from_fn(|axis, _| match (modes[axis], error_m) {
            (AxisResponse::Deflects(_), Some(error_m)) => error_m[axis],
            _ => position_m[axis],
        });
        let (first_m, first_modes) = *self.first.get_or_insert((deviation_m, modes));
        // An axis whose mode or stiffness has changed has another response.
        let is_same = |axis: usize| modes[axis] == first_modes[axis];
        let moved = deviation_m - first_m;
        let only_same = |v: &Vector3<f64>| Vector3::from_fn(|i, _| if is_same(i) { v[i] } else { f64::NAN });
        self.keep(ResponseSample { time_s, force_n: only_same(force_n), moved_m: only_same(&moved) });
    }

    /// Keeps a sample if it is later than the last one by the spacing, which doubles when there are too many.
    fn keep(&mut self, sample: ResponseSample) {
        for (largest, values) in self.largest.iter_mut().zip([&sample.force_n, &sample.moved_m]) {
            // An axis that is not considered is NaN, which leaves the largest value.
            largest.zip_apply(values, |largest, value| *largest = largest.max(value.abs()));
        }
        if self.samples.last().is_some_and(|last| sample.time_s - last.time_s < EARLY * self.spacing_s) {
            return;
        }
        self.samples.push(sample);
        if self.samples.len() > MAX_SAMPLES {
            keep_every_second(&mut self.samples);
            self.spacing_s *= 2.0;
        }
    }

    /// Samples in the order of time.
    pub fn samples(&self) -> &[ResponseSample] {
        &self.samples
    }

    /// Returns the numbers of each axis; `None` if nothing pushed the frame. An axis without a force has a deflection alone.
    pub fn numbers(&self) -> Option<[AxisNumbers; 3]> {
        let (_, modes) = self.first?;
        let [forces, displacements] = self.largest;
        if forces.iter().all(|force| *force < PUSHED_N) {
            return None;
        }
        Some([0, 1, 2].map(|axis| {
            let points = self.points(axis);
            let is_pushed = forces[axis] >= PUSHED_N;
            let (deflects, desired_n_per_m) = match modes[axis] {
                AxisResponse::Deflects(stiffness) => (true, stiffness),
                AxisResponse::Moves => (false, None),
            };
            let line = line(&points).filter(|_| is_pushed && deflects);
            AxisNumbers {
                force_max_n: forces[axis],
                deflection_max_m: displacements[axis],
                deflects,
                stiffness_n_per_m: line.map(|(_, compliance)| 1.0 / compliance),
                hysteresis_m: line.and_then(|_| hysteresis(&points)),
                return_m: self
                    .returned()
                    .map(|moved_m| moved_m[axis].abs())
                    .filter(|moved_m| moved_m.is_finite()),
                desired_n_per_m,
            }
        }))
    }

    /// Forces (N) and displacements (m) along an axis, without the samples at which other axes alone are pushed.
    pub fn points(&self, axis: usize) -> Vec<(f64, f64)> {
        let is_of_another = |force_n: &Vector3<f64>| {
            force_n.iter().any(|other| other.abs() >= PUSHED_N && force_n[axis].abs() < ALONG * other.abs())
        };
        let own = self.samples.iter().filter(|sample| !is_of_another(&sample.force_n));
        let points = own.map(|sample| (sample.force_n[axis], sample.moved_m[axis]));
        points.filter(|(force, moved)| force.is_finite() && moved.is_finite()).collect()
    }

    /// Displacement at the end, if there is no force at the beginning and at the end, m.
    fn returned(&self) -> Option<Vector3<f64>> {
        let [first, .., last] = &self.samples[..] else { return None };
        let largest_n = self.largest[0].amax();
        let is_free =
            |sample: &ResponseSample| !sample.force_n.iter().any(|force| force.abs() > RELEASED * largest_n);
        (is_free(first) && is_free(last)).then_some(last.moved_m)
    }

    /// Adds the numbers of each axis by their names, and returns those of the axis with the largest force.
    pub(super) fn finish(&self, metrics: &mut BTreeMap<String, f64>) -> ForceResponse {
        let mut response = ForceResponse::default();
        let Some(axes) = self.numbers() else { return response };
        let pushed = axes.iter().filter(|axis| axis.force_max_n >= PUSHED_N);
        // An axis with a stiffness comes first.
        let rank = |axis: &AxisNumbers| (axis.stiffness_n_per_m.is_some(), axis.force_max_n);
        let first = pushed.max_by(|a, b| {
            let ((a, a_n), (b, b_n)) = (rank(a), rank(b));
            a.cmp(&b).then(a_n.total_cmp(&b_n))
        });
        if let Some(axis) = first {
            response.external_force_max_n = Some(axis.force_max_n);
            response.deflection_max_m = Some(axis.deflection_max_m);
            response.stiffness_n_per_m = axis.stiffness_n_per_m;
            response.hysteresis_m = axis.hysteresis_m;
            response.return_m = axis.return_m;
        }
        for (axis, numbers) in axes.iter().enumerate() {
            let values = [
                Some(numbers.force_max_n),
                Some(numbers.deflection_max_m),
                numbers.stiffness_n_per_m,
                numbers.hysteresis_m,
                numbers.return_m,
                numbers.desired_n_per_m,
            ];
            let named = response_names(axis).into_iter().zip(values);
            metrics.extend(named.filter_map(|(name, value)| Some((name, value?))));
        }
        response
    }
}

/// Drops every second sample, from the second one on.
pub fn keep_every_second<T>(samples: &mut Vec<T>) {
    let mut place = 0;
    samples.retain(|_| {
        place += 1;
        place % 2 == 1
    });
}

/// Line of the displacement over the force while a force acts, with the ratio of their standard deviations as its slope: displacement
/// without force (m) and compliance (m/N); `None` if the two are not correlated. It is the geometric mean of the least-squares lines in
/// both directions: one overrates the stiffness of a spring with friction or a damper by as much as the other one underrates it.
pub fn line(points: &[(f64, f64)]) -> Option<(f64, f64)> {
    let largest_n = points.iter().map(|(force, _)| force.abs()).fold(0.0, f64::max);
    let pushed = || points.iter().filter(|(force, _)| force.abs() >= RELEASED * largest_n);
    let count = pushed().count() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| pushed().map(of).sum::<f64>() / count;
    let (force, moved) = (mean(|point| point.0), mean(|point| point.1));
    let (mut forces, mut products, mut squares) = (0.0, 0.0, 0.0);
    for (f, x) in pushed() {
        forces += (f - force).powi(2);
        products += (f - force) * (x - moved);
        squares += (x - moved).powi(2);
    }
    let compliance = (squares / forces).sqrt();
    let is_correlated = products > 0.0 && products * products >= CORRELATED * forces * squares;
    (is_correlated && compliance.is_finite()).then_some((moved - compliance * force, compliance))
}

/// Largest difference of the median displacements in an interval of the force, while it rises and while it falls, m.
fn hysteresis(points: &[(f64, f64)]) -> Option<f64> {
    let &(first, _) = points.first()?;
    let (least, greatest) =
        points.iter().fold((first, first), |(low, high), (force, _)| (low.min(*force), high.max(*force)));
    let range = greatest - least;
    if range <= 0.0 {
        return None;
    }
    let mut bins: Vec<[Vec<f64>; 2]> = vec![[Vec::new(), Vec::new()]; BINS];
    let (mut low, mut high, mut rises) = (first, first, None);
    for &(force, moved) in points {
        if rises != Some(true) && force > low + REVERSED * range {
            (rises, high) = (Some(true), force);
        } else if rises != Some(false) && force < high - REVERSED * range {
            (rises, low) = (Some(false), force);
        }
        (low, high) = (low.min(force), high.max(force));
        let bin = ((force - least) / range * BINS as f64) as usize;
        if let Some(rises) = rises {
            bins[bin.min(BINS - 1)][usize::from(rises)].push(moved);
        }
    }
    let widths = bins.iter_mut().filter(|both| both.iter().all(|part| part.len() >= LEAST_IN_BIN));
    widths.map(|[falling, rising]| (median(falling) - median(rising)).abs()).reduce(f64::max)
}

/// Upper median of some numbers.
fn median(numbers: &mut [f64]) -> f64 {
    let middle = numbers.len() / 2;
    *numbers.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::{MAX_SAMPLES, Response, ResponseSample, hysteresis, line};
    use nalgebra::Vector3;
    use std::f64::consts::PI;

    /// Relative rounding of a line through exact points.
    const ROUNDING: f64 = 1e-9;

    /// Error of a hysteresis, m: an interval spans a twentieth of the displacements, of which medians are compared.
    const INTERVAL_M: f64 = 1e-3;

    /// Checks that a spike of one row counts however few samples are kept, and that their number is bounded.
    #[test]
    fn short_forces_count_in_long_runs() {
        let mut response = Response::default();
        for k in 0..100_000_u32 {
            let force_n = if k == 77_777 { 30.0 } else { 1.0 };
            let (force_n, moved_m) = (Vector3::new(force_n, 0.0, f64::NAN), Vector3::repeat(1e-3 * force_n));
            response.keep(ResponseSample { time_s: 1e-3 * f64::from(k), force_n, moved_m });
        }
        assert!(response.samples.len() <= MAX_SAMPLES && response.samples.len() > MAX_SAMPLES / 4);
        assert_eq!(response.largest, [Vector3::new(30.0, 0.0, 0.0), Vector3::repeat(30e-3)]);
    }

    /// Displacement of a spring with dry friction, which starts to yield above the friction and holds back by it.
    fn with_friction(forces: impl Iterator<Item = f64>, stiffness: f64, friction: f64) -> Vec<(f64, f64)> {
        let mut moved = 0.0_f64;
        let points = forces.map(|force| {
            let reach = [(force - friction) / stiffness, (force + friction) / stiffness];
            moved = moved.clamp(reach[0], reach[1]);
            (force, moved)
        });
        points.collect()
    }

    /// Displacement that is left at the end, m.
    fn returned(points: &[(f64, f64)]) -> Option<f64> {
        let mut response = Response::default();
        for (k, (force, moved)) in (0..).zip(points) {
            let (force_n, moved_m) = (Vector3::new(*force, 0.0, 0.0), Vector3::new(*moved, 0.0, 0.0));
            response.keep(ResponseSample { time_s: f64::from(k), force_n, moved_m });
        }
        response.returned().map(|moved_m| moved_m.x.abs())
    }

    fn triangle(peak: f64) -> impl Iterator<Item = f64> {
        (0..=400).map(move |k| peak * (1.0 - (f64::from(k) / 200.0 - 1.0).abs()))
    }

    /// Without friction the stiffness is that of the spring, and there is no hysteresis.
    #[test]
    fn spring_has_its_stiffness_and_no_hysteresis() {
        for peak in [20.0, -20.0] {
            let points = with_friction(triangle(peak), 400.0, 0.0);
            let (_, compliance) = line(&points).unwrap_or_default();
            assert!((1.0 / compliance / 400.0 - 1.0).abs() < ROUNDING);
            assert!(hysteresis(&points).unwrap_or(1.0) < INTERVAL_M);
            assert!(returned(&points).unwrap_or(1.0) < ROUNDING);
        }
    }

    /// Compared: the stiffness of a spring with friction or a damper, and its own. The least-squares line of the displacement over the
    /// force has 1.15 and 1.23 times as much.
    #[test]
    fn friction_and_damping_are_no_stiffness() {
        const TOLERANCE: f64 = 0.01;
        let dry = with_friction(triangle(20.0), 400.0, 3.0);
        // F = K x + B dx/dt, pushed by a half sine, and at rest before and after it.
        let (mut moved, mut damped) = (0.0, Vec::new());
        for k in 0..3000 {
            let phase = (f64::from(k) - 1000.0) / 1000.0;
            let force = if (0.0..1.0).contains(&phase) { 20.0 * (PI * phase).sin() } else { 0.0 };
            moved += 1e-3 * (force - 400.0 * moved) / 40.0;
            damped.push((force, moved));
        }
        for points in [dry, damped] {
            let (_, compliance) = line(&points).unwrap_or_default();
            assert!((1.0 / compliance / 400.0 - 1.0).abs() < TOLERANCE, "{} N/m", 1.0 / compliance);
        }
    }

    /// Dry friction leaves the spring displaced by the friction over the stiffness; branches are apart by twice as much.
    #[test]
    fn friction_gives_hysteresis_and_a_return_error() {
        for peak in [20.0, -20.0] {
            let points = with_friction(triangle(peak), 400.0, 2.0);
            let width = hysteresis(&points).unwrap_or_default();
            assert!((width - 2.0 * 2.0 / 400.0).abs() < INTERVAL_M, "{width}");
            let returned = returned(&points).unwrap_or_default();
            assert!((returned - 2.0 / 400.0).abs() < ROUNDING, "{returned}");
        }
    }

    /// Displacements that have nothing to do with the force give no stiffness.
    #[test]
    fn uncorrelated_motion_has_no_stiffness() {
        let points: Vec<(f64, f64)> =
            (0..1000).map(|k| ((f64::from(k) * 0.1).sin(), (f64::from(k) * 0.37).sin())).collect();
        assert_eq!(line(&points), None);
    }
}
