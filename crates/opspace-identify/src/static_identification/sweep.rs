//! Motion of a joint through its range in both directions, and the mean offsets of setpoint from position near each posture.
//!
//! A sweep ends where the joint arrives, not where its setpoint does, so that no stiffness has to be known. Its offsets count
//! from the point at which the joint moves steadily: at the speed of its setpoint over many counts of the encoder, in which
//! friction before sliding, backlash and vibrations after the reversal have ended.

use super::failure::StaticFailure;
use super::parameters::StaticParameters;
use super::plan::SweepPlan;
use crate::session::{AbortReason, ExcitationSession, PEAK_OVER_MEAN};
use opspace_model::{Data, Model, forward_kinematics, gravity};
use serde::Serialize;

/// Speeds of the sweeps over that of the plan, the fastest first. Each takes the same time: a slower one has a shorter way.
const SPEEDS: [f64; 3] = [1.0, 0.5, 0.25];

/// Number of postures over the range.
pub const POSTURES: usize = 20;

/// Least part of the way past a posture over which its offsets are measured, and least number of samples.
const LEAST_PART: f64 = 0.5;
const LEAST_SAMPLES: usize = 4;

/// Distance from the ends of the planned range at which a sweep ends, rad (m): a joint may pass it when it stops.
const BEFORE_END: f64 = 0.04;

/// Largest viscous friction over stiffness that is expected, s: the time by which a joint lags, and for which it goes on.
const LAG_S: f64 = 0.12;

/// Duration of a change of speed from rest, s.
const RAMP_S: f64 = 0.5;

/// Length over which the joint's speed is compared with that of its setpoint, in counts, and the least duration, s.
const COMPARED_COUNTS: f64 = 8.0;
const COMPARED_S: f64 = 0.1;

/// Least and largest ratio of the joint's way to that of its setpoint in steady motion: weight changes it, too.
const STEADY: std::ops::RangeInclusive<f64> = 0.6..=1.6;

/// Least way after a reversal, rad (m): friction builds up over a part of it, and backlash is passed.
const TURNED_AFTER: f64 = 0.03;

/// Longest duration of a sweep, as a multiple of that of the setpoint alone, and in addition, s.
const MAX_DURATION: f64 = 1.5;
const MAX_EXTRA_S: f64 = 3.0;

/// Difference of a position for derivatives, rad (m).
const DIFFERENCE: f64 = 1e-4;

/// Mean offset near a posture in one direction.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct StaticPoint {
    /// Position of the joint, rad (m).
    pub position: f64,
    /// Mean velocity of the joint, rad/s (m/s).
    pub speed: f64,
    /// Torque of gravity without the hung weight, Nm (N).
    pub gravity: f64,
    /// Torque of gravity of the hung weight, Nm (N).
    pub weight: f64,
    /// Offset of setpoint from position, rad (m).
    pub offset: f64,
    /// Derivatives of the torque of gravity by the positions of all joints (n; Nm/rad).
    #[serde(skip)]
    pub slopes: Vec<f64>,
    /// Signs of the torques of gravity of all joints (n).
    #[serde(skip)]
    pub load_signs: Vec<f64>,
}

/// Returns the span of the torque of gravity (Nm, N) without hung weight.
#[must_use]
pub fn gravity_span(points: &[StaticPoint]) -> f64 {
    let (least, most) = points
        .iter()
        .filter(|p| p.weight == 0.0)
        .map(|p| p.gravity)
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), g| (least.min(g), most.max(g)));
    (most - least).max(0.0)
}

/// Sample of a sweep.
struct Row {
    /// Setpoint that was in effect, rad (m).
    setpoint: f64,
    /// Positions of all joints (n; rad, m).
    q: Vec<f64>,
    /// True if the setpoint moved at its full speed.
    is_full_speed: bool,
}

/// Moves the arm to the posture of the plan, sweeps the joint, and moves the arm back to `start` (n; rad, m). `model` contains a hung
/// weight, `without` does not. If the motion is aborted, the arm moves back, too.
///
/// # Errors
/// A joint that does not follow, or a motion that was aborted.
pub fn measure(
    session: &mut ExcitationSession<'_>,
    [model, without]: [&Model; 2],
    known: &StaticParameters,
    plan: &SweepPlan,
    start: &[f64],
) -> Result<Vec<StaticPoint>, StaticFailure> {
    let result = session.move_to(&plan.posture, plan.speed).map_err(StaticFailure::from);
    let mut sweeper = Sweeper { session, known, plan };
    let points = result.and_then(|()| sweeper.sweeps(model, without));
    if let Err(StaticFailure::Stopped(stop)) = &points
        && stop.is_final()
    {
        return points;
    }
    match session.move_to(start, plan.speed) {
        Ok(()) => points,
        // What kept the arm from its start is graver than what ended the sweeps.
        Err(stop) => Err(stop.into()),
    }
}

/// Estimates the duration of [`measure`], s.
#[must_use]
pub fn duration_s(plan: &SweepPlan, start: &[f64]) -> f64 {
    let furthest = start.iter().zip(&plan.posture).map(|(a, b)| (b - a).abs()).fold(0.0, f64::max);
    let middle = 0.5 * (plan.lower + plan.upper);
    let mut at = plan.posture[plan.joint];
    let way_s = |from: f64, to: f64, speed: f64| (to - from).abs() / speed + RAMP_S;
    let mut sweeps_s = 0.0;
    for share in SPEEDS {
        let half = 0.5 * share * (plan.upper - plan.lower) - share * BEFORE_END;
        sweeps_s += way_s(at, middle - half, plan.speed) + 2.0 * way_s(-half, half, share * plan.speed);
        at = middle - half;
    }
    sweeps_s += way_s(at, plan.posture[plan.joint], plan.speed);
    2.0 * PEAK_OVER_MEAN * furthest / plan.speed + sweeps_s
}

struct Sweeper<'a, 'b> {
    session: &'a mut ExcitationSession<'b>,
    known: &'a StaticParameters,
    plan: &'a SweepPlan,
}

impl Sweeper<'_, '_> {
    fn sweeps(&mut self, model: &Model, without: &Model) -> Result<Vec<StaticPoint>, StaticFailure> {
        let SweepPlan { lower, upper, speed, .. } = *self.plan;
        let mut gravity = Gravity::new([model, without], self.known.joint);
        let mut points = Vec::new();
        let middle = 0.5 * (lower + upper);
        for share in SPEEDS {
            let half = 0.5 * share * (upper - lower) - share * BEFORE_END;
            // The first way leads to the end of the range; its offsets do not count.
            self.sweep(middle - half, speed)?;
            for end in [middle + half, middle - half] {
                let rows = self.sweep(end, share * speed)?;
                let steady = self.steady(&rows).ok_or(StaticFailure::DoesNotFollow)?;
                points.extend(self.points(steady, &mut gravity));
            }
        }
        self.sweep(self.session.posture(self.known.joint), speed)?;
        Ok(points)
    }

    /// Moves the setpoint at a constant speed until the joint is at `end` (rad, m).
    fn sweep(&mut self, end: f64, speed: f64) -> Result<Vec<Row>, StaticFailure> {
        let joint = self.known.joint;
        let period_s = self.session.period_s();
        let [lower, upper] = self.known.limits[joint];
        let mut setpoint = self.session.setpoint(joint);
        let way = end - self.session.positions()[joint];
        let direction = way.signum();
        let longest_s = MAX_DURATION * way.abs() / speed + MAX_EXTRA_S;
        let lag_s = LAG_S + self.known.damping / self.known.stiffness;
        let (mut rate, mut rows) = (0.0, Vec::new());
        for _ in 0..(longest_s / period_s).ceil() as u64 {
            let left = (end - self.session.positions()[joint]) * direction;
            // Braking takes half of the way at full speed.
            let is_braking = left <= rate * (0.5 * rate * RAMP_S / speed + lag_s);
            let change = speed * period_s / RAMP_S;
            rate = if is_braking { rate - change } else { (rate + change).min(speed) };
            if rate <= 0.0 {
                return Ok(rows);
            }
            let next = setpoint + direction * rate * period_s;
            setpoint = next.clamp(lower, upper);
            if setpoint != next {
                return Ok(rows);
            }
            let before = self.session.follow(joint, self.rounded(setpoint))?;
            self.check_limits()?;
            rows.push(Row {
                setpoint: before,
                q: self.session.positions().to_vec(),
                is_full_speed: rate == speed,
            });
        }
        Err(StaticFailure::DoesNotFollow)
    }

    /// Rounds a setpoint as the drive does, so that it is known exactly.
    fn rounded(&self, setpoint: f64) -> f64 {
        let step = self.known.setpoint_resolution;
        if step > 0.0 { (setpoint / step).round() * step } else { setpoint }
    }

    fn check_limits(&self) -> Result<(), AbortReason> {
        let positions = self.session.positions().iter().zip(&self.known.limits).enumerate();
        for (joint, (&position, [lower, upper])) in positions {
            if position < *lower || position > *upper {
                return Err(AbortReason::Limit { joint, position });
            }
        }
        Ok(())
    }

    /// Returns the part of a sweep in which the joint moves steadily; `None` if it does not.
    fn steady<'r>(&self, rows: &'r [Row]) -> Option<&'r [Row]> {
        let joint = self.known.joint;
        let position = |k: usize| rows[k].q[joint];
        let step = |k: usize| (rows[k].setpoint - rows[k - 1].setpoint).abs();
        let full: Vec<usize> = (1..rows.len()).filter(|&k| rows[k].is_full_speed).collect();
        let (&first, &last) = (full.first()?, full.last()?);
        let mean_step = (first..=last).map(step).sum::<f64>() / (last - first + 1) as f64;
        let least = (COMPARED_S / self.session.period_s()).ceil();
        let window = (COMPARED_COUNTS * self.known.resolution / mean_step).ceil().max(least) as usize;
        let start = position(0);
        let is_steady = |k: usize| {
            let way = (position(k) - position(k - window)).abs();
            let asked = (rows[k].setpoint - rows[k - window].setpoint).abs();
            STEADY.contains(&(way / asked)) && (position(k) - start).abs() > TURNED_AFTER
        };
        let begin = (first + window..=last).find(|&k| is_steady(k))?;
        // What is left of the reversal decays once more as long.
        let begin = begin + window;
        (begin < last).then(|| &rows[begin..=last])
    }

    /// Means of a sweep near each posture.
    fn points(&self, rows: &[Row], gravity: &mut Gravity<'_>) -> Vec<StaticPoint> {
        let SweepPlan { lower, upper, .. } = *self.plan;
        let joint = self.known.joint;
        let width = (upper - lower) / POSTURES as f64;
        let bin = |row: &Row| ((row.q[joint] - lower) / width).floor() as i64;
        let mut points = Vec::new();
        for near in rows.chunk_by(|a, b| bin(a) == bin(b)) {
            let way = (near[near.len() - 1].q[joint] - near[0].q[joint]).abs();
            if near.len() >= LEAST_SAMPLES && way >= LEAST_PART * width {
                points.push(gravity.point(near, self.session.period_s(), self.known.lead_s));
            }
        }
        points
    }
}

/// Mean velocity of a joint, by least squares, rad/s (m/s).
fn mean_speed(rows: &[Row], joint: usize, period_s: f64) -> f64 {
    let middle = 0.5 * (rows.len() - 1) as f64;
    let times = || (0..rows.len()).map(|k| k as f64 - middle);
    let moment: f64 = times().zip(rows).map(|(t, row)| t * row.q[joint]).sum();
    moment / times().map(|t| t * t).sum::<f64>() / period_s
}

/// Torques of gravity of a joint.
struct Gravity<'a> {
    models: [&'a Model; 2],
    data: [Data; 2],
    joint: usize,
}

impl<'a> Gravity<'a> {
    fn new(models: [&'a Model; 2], joint: usize) -> Self {
        Self { models, data: models.map(Data::new), joint }
    }

    /// Computes the torques of gravity of all joints into the data of both models.
    fn compute(&mut self, q: &[f64]) {
        for (model, data) in self.models.iter().zip(&mut self.data) {
            forward_kinematics(model, data, q);
            gravity(model, data);
        }
    }

    fn point(&mut self, rows: &[Row], period_s: f64, lead_s: f64) -> StaticPoint {
        let joint = self.joint;
        let count = rows.len() as f64;
        let mut torques = [0.0; 2];
        let mut q = vec![0.0; rows[0].q.len()];
        let mut offset = 0.0;
        for row in rows {
            self.compute(&row.q);
            for (sum, data) in torques.iter_mut().zip(&self.data) {
                *sum += data.gravity[joint] / count;
            }
            q.iter_mut().zip(&row.q).for_each(|(sum, q)| *sum += q / count);
            offset += (row.setpoint - row.q[joint]) / count;
        }
        let speed = mean_speed(rows, joint, period_s);
        self.compute(&q);
        let load_signs = self.data[0].gravity.iter().map(|g| g.signum()).collect();
        let slopes = (0..q.len()).map(|j| self.slope(&q, j)).collect();
        let [all, own] = torques;
        StaticPoint {
            position: q[joint],
            speed,
            gravity: own,
            weight: all - own,
            // Over the interval before a sample the joint was, on average, behind its position at the sample.
            offset: offset + lead_s * speed,
            slopes,
            load_signs,
        }
    }

    /// Derivative of the torque of the joint by the position of another one.
    fn slope(&mut self, q: &[f64], other: usize) -> f64 {
        let mut at = |by: f64| {
            let mut moved = q.to_vec();
            moved[other] += by;
            self.compute(&moved);
            self.data[0].gravity[self.joint]
        };
        (at(DIFFERENCE) - at(-DIFFERENCE)) / (2.0 * DIFFERENCE)
    }
}
