//! Timing law of a path: the coordinate s along the path as a function of time, from rest to rest, as fast as limits
//! allow. It is computed before a run.
//!
//! With x = ṡ², every limit is a bound on (s̈, x) at a place of the path. In the first step the jerk is unlimited: a pass
//! forward and one backward along the path give the largest x everywhere, as s̈ = ½ dx/ds (Bobrow, Dubowsky and Gibson
//! 1985; Shin and McKay 1985; in the form of Pham and Pham 2018, *A New Approach to Time-Optimal Path Parameterization
//! Based on Reachability Analysis*). In the second step a moving average of duration T makes the acceleration continuous:
//! the jerk is then (s̈(t) − s̈(t − T))/T. The average of speeds and accelerations within convex bounds keeps them,
//! provided that they apply to all places that an average contains: the bounds of each place with a largest speed c
//! therefore apply up to the distance c T from it, which the motion does not exceed within T.

use crate::references::acceleration_bound::AccelerationBound;

/// Piece of a path with constant bounds, which a part of its coordinate passes with
///
/// ```text
/// ṡ ≤ speed,   s̈² + (curvature ṡ²)² ≤ acceleration²,   cone[0] |s̈| + cone[1] ṡ² ≤ 1
/// ```
///
/// and with the bounds of the robot.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Span {
    pub length: f64,
    /// Highest speed; may be infinite if the other bounds are not.
    pub speed: f64,
    /// Curvature of the path; 0 for no bound.
    pub curvature: f64,
    /// Acceleration of another quantity, such as an orientation, per s̈ and per ṡ², relative to its limit.
    pub cone: [f64; 2],
    /// Bounds of the robot; the same ones in the same order in each span that has any.
    pub bounds: Vec<AccelerationBound>,
}

/// Direction in which a pass goes along a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pass {
    /// With the motion, which gains speed.
    Forward,
    /// Against the motion, which brakes.
    Backward,
}

impl Span {
    /// Span of a length without bounds.
    pub(crate) fn free(length: f64) -> Self {
        Self { length, speed: f64::INFINITY, curvature: 0.0, cone: [0.0; 2], bounds: Vec::new() }
    }

    /// Largest speed, at any acceleration.
    pub(crate) fn cap(&self, acceleration: f64) -> f64 {
        let path = self.speed.min((acceleration / self.curvature).sqrt()).min((1.0 / self.cone[1]).sqrt());
        let squared = self.bounds.iter().map(|bound| bound.squared_speed_s2_per_m2);
        path.min((1.0 / squared.fold(0.0, f64::max)).sqrt())
    }

    /// Returns true if the bound of the acceleration is the same at each speed.
    fn is_straight(&self) -> bool {
        self.curvature == 0.0 && self.cone == [0.0; 2] && self.bounds.is_empty()
    }

    /// Adds the bounds of `other`.
    fn add_bounds(&mut self, other: &Self) {
        self.speed = self.speed.min(other.speed);
        self.curvature = self.curvature.max(other.curvature);
        self.cone = [0, 1].map(|i| self.cone[i].max(other.cone[i]));
        AccelerationBound::merge(&mut self.bounds, &other.bounds);
    }

    /// Largest x at the other end of this span for `x` at the end that the pass comes to first, with constant acceleration
    /// up to `along`.
    fn step(&self, x: f64, along: f64, acceleration: f64, pass: Pass) -> f64 {
        let mut next = x + 2.0 * along * self.length;
        if self.curvature > 0.0 {
            // (next − x)²/(4 length²) + curvature² next² = acceleration²
            let h = 2.0 * self.length;
            let factor = 1.0 + (h * self.curvature).powi(2);
            let root = (x * x - factor * (x * x - (h * acceleration).powi(2))).max(0.0).sqrt();
            next = next.min((x + root) / factor);
        }
        if self.cone != [0.0; 2] {
            let per_x = self.cone[0] / (2.0 * self.length);
            next = next.min((1.0 + per_x * x) / (self.cone[1] + per_x));
        }
        for bound in &self.bounds {
            let along = match pass {
                Pass::Forward => bound.gaining_s2_per_m,
                Pass::Backward => bound.braking_s2_per_m,
            };
            let per_x = along / (2.0 * self.length);
            // Without either coefficient the quotient is infinite.
            next = next.min((1.0 + per_x * x) / (bound.squared_speed_s2_per_m2 + per_x));
        }
        next.min(self.cap(acceleration).powi(2))
    }
}

/// Bounds of the whole path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PathLimits {
    /// Largest |s̈|, and largest acceleration in curves.
    pub acceleration: f64,
    /// Largest jerk of s.
    pub jerk: f64,
}

/// Motion along a path.
#[derive(Clone, Debug)]
pub(crate) struct TimingLaw {
    /// Pieces of constant jerk, in order of time.
    pieces: Vec<Piece>,
    duration_s: f64,
    length: f64,
}

#[derive(Clone, Copy, Debug)]
struct Piece {
    begin_s: f64,
    /// s, ṡ and s̈ at the beginning.
    state: [f64; 3],
    jerk: f64,
}

impl Piece {
    fn at(&self, time_s: f64) -> [f64; 3] {
        let t = time_s - self.begin_s;
        let [s, v, a] = self.state;
        let j = self.jerk;
        [s + t * (v + t * (a / 2.0 + t * (j / 6.0))), v + t * (a + t * (j / 2.0)), a + t * j]
    }
}

/// Fractions of the acceleration that are tried for a section: a short one takes less time with less acceleration, which
/// it reaches sooner.
const FRACTIONS: [f64; 8] = [0.85, 0.7, 0.55, 0.4, 0.3, 0.2, 0.1, 0.05];

/// Relative rounding error of accelerations in very short spans.
const ROUNDING: f64 = 1e-6;

impl TimingLaw {
    /// Computes the law for a path of `sections`, at whose ends it comes to rest.
    pub(crate) fn new(sections: &[Vec<Span>], limits: &PathLimits) -> Self {
        let mut law = Self { pieces: Vec::new(), duration_s: 0.0, length: 0.0 };
        for section in sections {
            law.append(Self::of_section(section, limits));
        }
        law
    }

    fn append(&mut self, next: Self) {
        self.pieces.extend(next.pieces.iter().map(|piece| {
            let [s, v, a] = piece.state;
            Piece {
                begin_s: piece.begin_s + self.duration_s,
                state: [s + self.length, v, a],
                jerk: piece.jerk,
            }
        }));
        self.duration_s += next.duration_s;
        self.length += next.length;
    }

    /// The fastest of some laws for a section.
    fn of_section(spans: &[Span], limits: &PathLimits) -> Self {
        let law = |fraction: f64| {
            let along = fraction * limits.acceleration;
            let averaged = |window_s: f64| {
                Phases::new(&widened(spans, window_s, limits), along, limits.acceleration).averaged(window_s)
            };
            // The acceleration changes by at most twice its limit within T; in most sections by no more than once.
            let short = averaged(along / limits.jerk);
            if short.highest_jerk() <= limits.jerk * (1.0 + ROUNDING) {
                short
            } else {
                averaged(2.0 * along / limits.jerk)
            }
        };
        let mut best = law(1.0);
        for fraction in FRACTIONS {
            let other = law(fraction);
            if other.duration_s < best.duration_s {
                best = other;
            }
        }
        best
    }

    fn highest_jerk(&self) -> f64 {
        self.pieces.iter().map(|piece| piece.jerk.abs()).fold(0.0, f64::max)
    }

    /// Duration, s.
    pub(crate) fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// s, ṡ and s̈ at `time_s` (s) after the start; at rest before the start and after the end.
    pub(crate) fn at(&self, time_s: f64) -> [f64; 3] {
        if time_s >= self.duration_s {
            return [self.length, 0.0, 0.0];
        }
        match self.pieces.partition_point(|piece| piece.begin_s <= time_s) {
            0 => [0.0; 3],
            next => {
                let [s, v, a] = self.pieces[next - 1].at(time_s);
                [s.clamp(0.0, self.length), v, a]
            }
        }
    }
}

/// Extends the bounds of each span by the distance that its highest speed travels in `window_s` (s).
fn widened(spans: &[Span], window_s: f64, limits: &PathLimits) -> Vec<Span> {
    let mut ranges = Vec::with_capacity(spans.len());
    let mut begin = 0.0;
    for span in spans {
        let (end, reach) = (begin + span.length, span.cap(limits.acceleration) * window_s);
        ranges.push((begin - reach, end + reach));
        begin = end;
    }
    let length = begin;
    let mut knots: Vec<f64> = vec![0.0, length];
    let mut begin = 0.0;
    for (span, (from, to)) in spans.iter().zip(&ranges) {
        knots.extend([begin, *from, *to].into_iter().filter(|knot| (0.0..length).contains(knot)));
        begin += span.length;
    }
    knots.sort_by(f64::total_cmp);
    let least = 1e-8 * length;
    knots.dedup_by(|later, earlier| *later - *earlier < least);
    // The last knot may have been merged into the one before it.
    let last = knots.len() - 1;
    knots[last] = length;
    // A tree over the intervals: node k has the nodes 2k and 2k + 1 below it, and its bounds are theirs too. A range of
    // intervals is the sum of a few nodes.
    let count = last;
    let mut nodes = vec![Span::free(0.0); 2 * count];
    for (span, (from, to)) in spans.iter().zip(&ranges) {
        // A range also bounds the intervals of which it covers a part by rounding.
        let mut first = count + knots[1..].partition_point(|knot| *knot <= *from + least);
        let mut end = count + knots[..count].partition_point(|knot| *knot + least < *to);
        while first < end {
            if first % 2 == 1 {
                nodes[first].add_bounds(span);
                first += 1;
            }
            if end % 2 == 1 {
                end -= 1;
                nodes[end].add_bounds(span);
            }
            first /= 2;
            end /= 2;
        }
    }
    for k in 1..count {
        let (above, below) = nodes.split_at_mut(2 * k);
        below[0].add_bounds(&above[k]);
        below[1].add_bounds(&above[k]);
    }
    let mut widened = nodes.split_off(count);
    for (interval, pair) in widened.iter_mut().zip(knots.windows(2)) {
        interval.length = pair[1] - pair[0];
    }
    widened
}

/// Motion of constant acceleration in each phase.
struct Phases {
    /// Begin of each phase (s) and its acceleration.
    phases: Vec<(f64, f64)>,
    duration_s: f64,
    length: f64,
}

impl Phases {
    /// Computes the fastest motion along `spans` from rest to rest.
    fn new(spans: &[Span], along: f64, acceleration: f64) -> Self {
        let count = spans.len();
        let mut x = vec![0.0; count + 1];
        for (k, span) in spans.iter().enumerate() {
            let next = spans.get(k + 1).map_or(0.0, |next| next.cap(acceleration).powi(2));
            x[k + 1] = span.step(x[k], along, acceleration, Pass::Forward).min(next);
        }
        for (k, span) in spans.iter().enumerate().rev() {
            x[k] = x[k].min(span.step(x[k + 1], along, acceleration, Pass::Backward));
        }
        let mut motion = Self { phases: Vec::with_capacity(2 * count), duration_s: 0.0, length: 0.0 };
        for (k, span) in spans.iter().enumerate() {
            let (from, to) = (x[k], x[k + 1]);
            let end = motion.length + span.length;
            if span.is_straight() {
                // Up to the highest speed or to the meeting point of acceleration and braking.
                let top = (0.5 * (from + to) + along * span.length).min(span.cap(acceleration).powi(2));
                let (rise, fall) = ((top - from) / (2.0 * along), (top - to) / (2.0 * along));
                motion.push(rise, from, top);
                motion.push(span.length - rise - fall, top, top);
                motion.push(fall, top, to);
            } else {
                motion.push(span.length, from, to);
            }
            motion.length = end;
        }
        motion
    }

    /// Adds a phase of a length between two squared speeds.
    fn push(&mut self, length: f64, from: f64, to: f64) {
        let (before, after) = (from.max(0.0).sqrt(), to.max(0.0).sqrt());
        if length <= 0.0 || before + after <= 0.0 {
            return;
        }
        self.phases.push((self.duration_s, (to - from) / (2.0 * length)));
        self.duration_s += 2.0 * length / (before + after);
        self.length += length;
    }

    /// Acceleration at `time_s`; 0 before and after the motion.
    fn acceleration(&self, time_s: f64) -> f64 {
        if time_s >= self.duration_s {
            return 0.0;
        }
        let next = self.phases.partition_point(|(begin_s, _)| *begin_s <= time_s);
        if next == 0 { 0.0 } else { self.phases[next - 1].1 }
    }

    /// Moving average of the motion over `window_s` (s).
    fn averaged(&self, window_s: f64) -> TimingLaw {
        let begins = self.phases.iter().map(|(begin_s, _)| *begin_s).chain([self.duration_s]);
        let mut times: Vec<f64> = begins.flat_map(|time_s| [time_s, time_s + window_s]).collect();
        times.sort_by(f64::total_cmp);
        let mut pieces: Vec<Piece> = Vec::with_capacity(times.len());
        let mut state = [0.0; 3];
        for pair in times.windows(2).filter(|pair| pair[1] > pair[0]) {
            let middle_s = 0.5 * (pair[0] + pair[1]);
            let change = self.acceleration(middle_s) - self.acceleration(middle_s - window_s);
            let piece = Piece { begin_s: pair[0], state, jerk: change / window_s };
            state = piece.at(pair[1]);
            pieces.push(piece);
        }
        TimingLaw { pieces, duration_s: self.duration_s + window_s, length: self.length }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    /// Relative rounding errors: of the sum of lengths, of places and limits after the integration, and of jerks.
    const LENGTH: f64 = 1e-9;
    const INTEGRATED: f64 = 1e-6;
    const JERK: f64 = 1e-5;

    /// A bound of the robot with coefficients of which some are zero.
    fn bound() -> impl Strategy<Value = AccelerationBound> {
        let coefficient =
            || prop_oneof![1 => Just(0.0), 3 => (0.05_f64.ln()..5.0_f64.ln()).prop_map(f64::exp)];
        (coefficient(), coefficient(), coefficient()).prop_map(|(gaining, braking, squared_speed)| {
            AccelerationBound {
                gaining_s2_per_m: gaining,
                braking_s2_per_m: braking,
                squared_speed_s2_per_m2: squared_speed,
            }
        })
    }

    /// A span with up to `bounds` bounds of the robot.
    fn span(bounds: usize) -> impl Strategy<Value = Span> {
        let cone = prop_oneof![Just([0.0; 2]), prop::array::uniform2(0.05..1.0)];
        let curvature = prop_oneof![Just(0.0), 0.1..20.0];
        (0.002..0.1, 0.1..2.0, curvature, cone, prop::collection::vec(bound(), 0..=bounds)).prop_map(
            |(length, speed, curvature, cone, bounds)| Span { length, speed, curvature, cone, bounds },
        )
    }

    fn limits() -> impl Strategy<Value = PathLimits> {
        (0.5..20.0, 5.0..500.0).prop_map(|(acceleration, jerk)| PathLimits { acceleration, jerk })
    }

    proptest! {
        #![proptest_config(ProptestConfig {
            failure_persistence: None,
            rng_seed: RngSeed::Fixed(21),
            ..ProptestConfig::with_cases(200)
        })]

        /// Compared: speed, acceleration and jerk of the law at 2000 instants with all bounds of the spans there.
        #[test]
        fn laws_keep_their_bounds(spans in prop::collection::vec(span(3), 8..40), limits in limits()) {
            let law = TimingLaw::new(std::slice::from_ref(&spans), &limits);
            let length: f64 = spans.iter().map(|span| span.length).sum();
            prop_assert!((law.length - length).abs() < LENGTH * length);
            let end = law.pieces.last().expect("a motion").at(law.duration_s);
            prop_assert!((end[0] - length).abs() < INTEGRATED * length && end[1].abs() < INTEGRATED, "{end:?} of {length}");
            prop_assert!(law.highest_jerk() <= limits.jerk * (1.0 + JERK));
            let kept = 1.0 + INTEGRATED;
            for instant in 0..2000 {
                let [s, v, a] = law.at(law.duration_s() * f64::from(instant) / 2000.0);
                let mut end = 0.0;
                let at = spans.iter().find(|span| { end += span.length; s < end }).unwrap_or(&spans[spans.len() - 1]);
                prop_assert!(v <= at.speed * kept, "{v} of {}", at.speed);
                let whole = (a * a + (at.curvature * v * v).powi(2)).sqrt();
                prop_assert!(whole <= limits.acceleration * kept, "{whole} of {}", limits.acceleration);
                prop_assert!(at.cone[0] * a.abs() + at.cone[1] * v * v <= kept);
                for bound in &at.bounds {
                    prop_assert!(bound.usage(v, a) <= kept, "{} at {s}: {bound:?}", bound.usage(v, a));
                }
            }
        }

        /// Compared: the duration with that of a pass forward and one backward of 20 000 steps, for bounds that change slowly
        /// along a straight path whose jerk is hardly limited.
        #[test]
        fn laws_take_hardly_more_than_the_least_time(ends in prop::array::uniform3(bound()), other in bound()) {
            let count = 400;
            let length = 1.0;
            let limits = PathLimits { acceleration: 20.0, jerk: 2e4 };
            let at = |s: f64| {
                let (first, share) = if s < 0.5 { (0, 2.0 * s) } else { (1, 2.0 * s - 1.0) };
                let mix = |of: fn(&AccelerationBound) -> f64| {
                    (1.0 - share) * of(&ends[first]) + share * of(&ends[first + 1])
                };
                let changing = AccelerationBound {
                    gaining_s2_per_m: mix(|bound| bound.gaining_s2_per_m),
                    braking_s2_per_m: mix(|bound| bound.braking_s2_per_m),
                    squared_speed_s2_per_m2: mix(|bound| bound.squared_speed_s2_per_m2),
                };
                [changing, other]
            };
            let spans: Vec<Span> = (0..count)
                .map(|k| {
                    let place = |k: i32| at(length * f64::from(k) / f64::from(count));
                    let (begin, end) = (place(k), place(k + 1));
                    let bounds = begin.iter().zip(&end).map(|(a, b)| a.max(b)).collect();
                    Span { speed: 3.0, bounds, ..Span::free(length / f64::from(count)) }
                })
                .collect();
            let law = TimingLaw::new(&[spans], &limits);
            let steps = 20_000_usize;
            let step = length / steps as f64;
            let highest = |k: usize| {
                let squared = at(k as f64 * step).map(|bound| bound.squared_speed_s2_per_m2);
                (1.0 / squared[0].max(squared[1])).min(9.0)
            };
            let rate = |k: usize, x: f64, of: fn(&AccelerationBound) -> f64| {
                let bounds = at(k as f64 * step);
                let each = bounds.map(|bound| (1.0 - bound.squared_speed_s2_per_m2 * x).max(0.0) / of(&bound));
                each[0].min(each[1]).min(limits.acceleration)
            };
            let mut x: Vec<f64> = (0..=steps).map(highest).collect();
            (x[0], x[steps]) = (0.0, 0.0);
            for k in 0..steps {
                x[k + 1] = x[k + 1].min(x[k] + 2.0 * step * rate(k, x[k], |bound| bound.gaining_s2_per_m));
            }
            for k in (1..=steps).rev() {
                x[k - 1] = x[k - 1].min(x[k] + 2.0 * step * rate(k, x[k], |bound| bound.braking_s2_per_m));
            }
            let least_s: f64 = x.windows(2).map(|pair| 2.0 * step / (pair[0].sqrt() + pair[1].sqrt())).sum();
            let ratio = law.duration_s() / least_s;
            prop_assert!(ratio > 0.99 && ratio < 1.03, "{} of {least_s} s", law.duration_s());
        }
    }
}
