//! Comparison of intervals with the truth.

use crate::cases::Case;
use opspace_identify::{Identification, Interval95};
use std::fmt;

/// Names of the quantities.
pub const NAMES: [&str; 7] = ["kp", "kv", "filter", "delay", "inertia", "Coulomb", "viscous"];

/// Estimate of one quantity.
#[derive(Clone, Copy, Debug)]
pub struct Estimate {
    pub truth: f64,
    pub value: Option<f64>,
    pub interval: Option<Interval95>,
}

impl Estimate {
    pub fn holds(&self) -> Option<bool> {
        let tolerance = 1e-9 * self.truth.abs();
        self.interval.map(|i| i.lower - tolerance <= self.truth && self.truth <= i.upper + tolerance)
    }

    /// Half of the width, relative to the truth; in ticks for a delay of 0.
    pub fn half_width(&self) -> Option<f64> {
        let scale = if self.truth == 0.0 { 1.0 } else { self.truth };
        self.interval.map(|i| 0.5 * (i.upper - i.lower) / scale)
    }
}

/// Outcome of a case.
pub struct Outcome {
    pub number: usize,
    pub elastic: bool,
    pub estimates: [Estimate; 7],
    pub refused: Option<String>,
    pub doubts: Vec<String>,
}

impl Outcome {
    pub fn new(number: usize, case: &Case, found: &Identification) -> Self {
        let truth = &case.truth;
        let servo = found.servo.as_ref();
        let friction = servo.and_then(|s| s.friction);
        let intervals = servo.map(|s| &s.intervals);
        let of = |truth: f64, value: Option<f64>, interval: Option<Interval95>| Estimate {
            truth,
            value,
            interval,
        };
        let estimates = [
            of(truth.kp, servo.map(|s| s.kp), intervals.and_then(|i| i.kp)),
            of(truth.kv, servo.map(|s| s.kv), intervals.and_then(|i| i.kv)),
            of(
                truth.filter_hz,
                servo.map(|s| s.velocity_filter_hz),
                intervals.and_then(|i| i.velocity_filter_hz),
            ),
            of(f64::from(truth.delay), servo.map(|s| f64::from(s.delay)), intervals.and_then(|i| i.delay)),
            of(truth.inertia(), servo.map(|s| s.inertia), intervals.and_then(|i| i.inertia)),
            of(truth.coulomb, friction.map(|f| f.coulomb), intervals.and_then(|i| i.coulomb)),
            of(truth.viscous, friction.map(|f| f.viscous), intervals.and_then(|i| i.viscous)),
        ];
        Self {
            number,
            elastic: truth.gear.is_some(),
            estimates,
            refused: found.no_torque_mode(),
            doubts: found.doubts.clone(),
        }
    }
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:3} {}", self.number, if self.elastic { "E" } else { " " })?;
        for (name, estimate) in NAMES.iter().zip(&self.estimates) {
            let percent = if *name == "delay" { 1.0 } else { 100.0 };
            let scale = if *name == "delay" || estimate.truth == 0.0 { 1.0 } else { estimate.truth };
            let error = estimate.value.map_or(f64::NAN, |v| percent * (v - estimate.truth) / scale);
            let width = estimate.half_width().map_or(f64::NAN, |w| percent * w);
            let mark = match estimate.holds() {
                None => '-',
                Some(true) => ' ',
                Some(false) => '!',
            };
            write!(f, " | {name} {error:7.2} ±{width:6.2}{mark}")?;
        }
        if let Some(reason) = &self.refused {
            write!(f, " | REFUSED {reason}")?;
        }
        if !self.doubts.is_empty() {
            write!(f, " | {}", self.doubts.join("; "))?;
        }
        Ok(())
    }
}

/// Coverage, median half-width and withheld estimates of each quantity, as a table.
pub fn summary(all: &[Outcome]) -> String {
    let mut text = "quantity   intervals  hold the truth  median half-width  withheld\n".to_owned();
    let (mut total, mut held) = (0, 0);
    for (index, name) in NAMES.iter().enumerate() {
        let of: Vec<&Estimate> = all.iter().map(|outcome| &outcome.estimates[index]).collect();
        let holds = of.iter().filter(|e| e.holds() == Some(true)).count();
        let mut widths: Vec<f64> = of.iter().filter_map(|e| e.half_width()).collect();
        widths.sort_by(f64::total_cmp);
        let median = widths.get(widths.len() / 2).copied().unwrap_or(f64::NAN);
        total += widths.len();
        held += holds;
        text += &format!(
            "{name:10} {:9}  {:13.1}%  {:16.2}%  {:7.1}%\n",
            widths.len(),
            100.0 * holds as f64 / widths.len() as f64,
            100.0 * median,
            100.0 * (all.len() - widths.len()) as f64 / all.len() as f64
        );
    }
    let possible = NAMES.len() * all.len();
    text += &format!(
        "all        {total:9}  {:13.1}%                    {:7.1}%\n",
        100.0 * held as f64 / total as f64,
        100.0 * (possible - total) as f64 / possible as f64
    );
    text + &format!(
        "refused {}, doubtful {}, neither {}",
        all.iter().filter(|o| o.refused.is_some()).count(),
        all.iter().filter(|o| o.refused.is_none() && !o.doubts.is_empty()).count(),
        all.iter().filter(|o| o.refused.is_none() && o.doubts.is_empty()).count()
    )
}
