//! Recorded paths: timed poses read from CSV and interpolated by splines.
//!
//! ```text
//! x_d(t): C² cubic spline through (t_k, x_k)        ẋ_d = ẍ_d = 0 at both ends
//! ```
//!
//! This crate reads no files: the reader of a task file also reads the recorded file that the task file names, with
//! [`parse`], into [`RecordedPath::samples`].

use crate::orientation;
use crate::orientation::rotation_vector_rates;
use crate::references::blend::laid;
use crate::references::ramp::minimum_jerk;
use crate::references::target::Target;
use nalgebra::{Matrix3, Quaternion, SVector, UnitQuaternion, Vector3, Vector4};
use opspace_backend::quantity::Positive;
use opspace_model::{Motion, Placement};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::path::PathBuf;
use thiserror::Error;

/// A recorded path to follow. Its first sample is at the start.
///
/// The path is the C² cubic spline through the samples, with zero velocity and acceleration at both ends. It should be
/// recorded from rest to rest: a motion that is already in progress at the first sample is caught up within the first
/// two intervals, at any velocity that this requires.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct RecordedPath {
    /// CSV file with the columns `time_s,x_m,y_m,z_m` and, if the frame rotates, `qw,qx,qy,qz`. A relative path is
    /// relative to the task file.
    pub file: PathBuf,
    /// True (the default) if the path is moved to begin at the start pose, with its translations and rotations relative
    /// to the task's axes; false if it is followed in world coordinates, as recorded.
    #[serde(default = "yes")]
    pub relative: bool,
    /// Duration over which the offset of the start pose from a path that is not relative is faded out by the minimum-jerk
    /// ramp, s.
    #[serde(default = "default_approach_s")]
    pub approach_s: Positive,
    /// Samples in the file.
    #[serde(skip)]
    pub samples: Vec<PoseSample>,
}

/// Compares file and options but not the samples, because the comparison runs in the control loop.
impl PartialEq for RecordedPath {
    fn eq(&self, other: &Self) -> bool {
        self.file == other.file && self.relative == other.relative && self.approach_s == other.approach_s
    }
}

fn yes() -> bool {
    true
}

fn default_approach_s() -> Positive {
    Positive::literal(1.0)
}

/// A timed pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseSample {
    /// Time, s; only differences matter. In samples that are read from a file, the first time is 0.
    pub time_s: f64,
    /// Position, m.
    pub position: [f64; 3],
    /// Orientation: a unit quaternion (w, x, y, z) of either sign.
    pub quaternion: Option<[f64; 4]>,
}

impl RecordedPath {
    /// Returns true if there are at least two samples, with increasing times.
    #[must_use]
    pub fn is_read(&self) -> bool {
        self.samples.len() > 1 && self.samples.windows(2).all(|pair| pair[0].time_s < pair[1].time_s)
    }
}

/// Error in the file of a recorded path.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{reason}")]
pub struct RecordedError {
    /// Line number, from 1; `None` for the file as a whole.
    pub line: Option<u64>,
    /// Reason of the error.
    pub reason: RecordedReason,
}

/// Reason why a recorded path is rejected.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum RecordedReason {
    /// The first line lacks a required column.
    #[error(
        "no column `{name}`: a recorded path has the columns time_s, x_m, y_m, z_m and, for an orientation, all of \
         qw, qx, qy, qz"
    )]
    MissingColumn {
        /// The column.
        name: &'static str,
    },
    /// The first line contains an unknown column.
    #[error(
        "unknown column `{name}`: a recorded path has the columns time_s, x_m, y_m, z_m and, for an orientation, \
         qw, qx, qy, qz"
    )]
    UnknownColumn {
        /// The column.
        name: String,
    },
    /// The first line contains a column twice.
    #[error("column `{name}` is given twice")]
    RepeatedColumn {
        /// The column.
        name: String,
    },
    /// The number of values in a line differs from the number of columns.
    #[error("{values} values for {columns} columns")]
    Values {
        /// Number of values in the line.
        values: u64,
        /// Number of columns in the first line.
        columns: u64,
    },
    /// A time that is no number of seconds, also since 1970.
    #[error(
        "column `time_s`: expected seconds, from -1e10 to 1e10, got '{value}'; divide milliseconds by 1e3, microseconds by 1e6, \
         nanoseconds by 1e9"
    )]
    Seconds {
        /// Text in the file.
        value: String,
    },
    /// A value that is not a finite number, or too large for a position.
    #[error("column `{column}`: expected a number from -1e9 to 1e9, got '{value}'")]
    Number {
        /// Column of the value.
        column: &'static str,
        /// Text in the file.
        value: String,
    },
    /// A sample that is not later than the previous one, or by too little for its velocity to be a number.
    #[error("column `time_s`: {time_s} s is not after the previous {previous_s} s, by at least 1 ns")]
    Time {
        /// Time of the sample, s.
        time_s: f64,
        /// Time of the previous sample, s.
        previous_s: f64,
    },
    /// A quaternion whose length is not 1.
    #[error("columns `qw`, `qx`, `qy`, `qz`: the quaternion's length is {length}, not 1")]
    Length {
        /// Length of the quaternion.
        length: f64,
    },
    /// A rotation between two samples that is too large to determine its direction.
    #[error(
        "columns `qw`, `qx`, `qy`, `qz`: {angle_rad:.3} rad from the previous orientation; sample more often: \
         consecutive orientations must differ by less than a quarter turn"
    )]
    Turn {
        /// Angle between the two orientations, rad.
        angle_rad: f64,
    },
    /// Fewer than two samples.
    #[error("{count} samples: at least 2 are needed")]
    TooShort {
        /// Number of samples.
        count: usize,
    },
    /// Invalid CSV syntax.
    #[error("{message}")]
    Syntax {
        /// Message of the CSV reader.
        message: String,
    },
}

/// Columns in the file of a recorded path; the last four are all present or all absent.
pub const COLUMNS: [&str; 8] = ["time_s", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"];

/// Largest magnitude of a position, m: squares of it are far from the largest number.
const MAX_NUMBER: f64 = 1e9;

/// Largest magnitude of a time, s: seconds since 1970 are below it until 2286.
const MAX_TIME_S: f64 = 1e10;

/// Shortest interval between two samples, s.
const MIN_INTERVAL_S: f64 = 1e-9;

/// Tolerance of a quaternion's length; the error of a quaternion written with four digits is smaller.
const LENGTH_TOLERANCE: f64 = 1e-3;

/// Reads the samples from a CSV text whose first line contains the column names, in any order. Times may begin anywhere, as those
/// since 1970 do: the first sample has time 0.
///
/// # Errors
/// The first error in the text, with its line.
pub fn parse(text: &str) -> Result<Vec<PoseSample>, RecordedError> {
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_bytes());
    let headers = reader.headers().map_err(|e| syntax(text, &e))?.clone();
    let first_line = line_at(text, 0);
    let places = places(&headers).map_err(|reason| RecordedError { line: Some(first_line), reason })?;
    let mut samples: Vec<PoseSample> = Vec::new();
    let mut first: Option<FileTime> = None;
    let mut previous = FileTime::default();
    for record in reader.records() {
        let record = record.map_err(|e| syntax(text, &e))?;
        let line = record.position().map(|position| line_at(text, position.byte()));
        let at = |reason| RecordedError { line, reason };
        let value = |column: usize| places[column].and_then(|place| record.get(place));
        let mut numbers = [0.0; COLUMNS.len()];
        for (column, number) in numbers.iter_mut().enumerate().skip(1) {
            let Some(value) = value(column) else { continue };
            let parsed = value.parse().ok().filter(|parsed: &f64| parsed.abs() <= MAX_NUMBER);
            let column = COLUMNS[column];
            *number = parsed.ok_or_else(|| at(RecordedReason::Number { column, value: value.to_owned() }))?;
        }
        let time = value(0).unwrap_or_default();
        let time =
            FileTime::new(time).ok_or_else(|| at(RecordedReason::Seconds { value: time.to_owned() }))?;
        let [_, x, y, z, q @ ..] = numbers;
        let quaternion = places[4].map(|_| unit(q)).transpose().map_err(at)?;
        let time_s = time.after(*first.get_or_insert(time));
        let sample = PoseSample { time_s, position: [x, y, z], quaternion };
        if let Some(before) = samples.last() {
            if time_s - before.time_s < MIN_INTERVAL_S {
                let (time_s, previous_s) = (time.seconds(), previous.seconds());
                return Err(at(RecordedReason::Time { time_s, previous_s }));
            }
            turns_little(&sample, before).map_err(at)?;
        }
        samples.push(sample);
        previous = time;
    }
    if samples.len() < 2 {
        return Err(RecordedError { line: None, reason: RecordedReason::TooShort { count: samples.len() } });
    }
    Ok(samples)
}

/// Indices of the [`COLUMNS`] in the file; the quaternion has all four or none.
fn places(headers: &csv::StringRecord) -> Result<[Option<usize>; COLUMNS.len()], RecordedReason> {
    let mut places = [None; COLUMNS.len()];
    for (place, name) in headers.iter().enumerate() {
        let Some(column) = COLUMNS.iter().position(|column| *column == name) else {
            return Err(RecordedReason::UnknownColumn { name: name.to_owned() });
        };
        if places[column].replace(place).is_some() {
            return Err(RecordedReason::RepeatedColumn { name: name.to_owned() });
        }
    }
    let turns = places[4..].iter().any(Option::is_some);
    let needed = if turns { COLUMNS.len() } else { 4 };
    match (0..needed).find(|&column| places[column].is_none()) {
        Some(column) => Err(RecordedReason::MissingColumn { name: COLUMNS[column] }),
        None => Ok(places),
    }
}

/// Returns the normalised quaternion.
fn unit(q: [f64; 4]) -> Result<[f64; 4], RecordedReason> {
    let length = Vector4::from(q).norm();
    if (length - 1.0).abs() > LENGTH_TOLERANCE {
        return Err(RecordedReason::Length { length });
    }
    Ok(q.map(|part| part / length))
}

/// Time in a file. The differences of its whole seconds are exact, and those of the rest are as exact as the file: a number of
/// seconds since 1970 would be rounded to 0.2 µs.
#[derive(Clone, Copy, Default)]
struct FileTime {
    whole_s: f64,
    rest_s: f64,
}

impl FileTime {
    fn new(text: &str) -> Option<Self> {
        let seconds: f64 = text.parse().ok().filter(|seconds: &f64| seconds.abs() <= MAX_TIME_S)?;
        let rounded = Self { whole_s: seconds.trunc(), rest_s: seconds.fract() };
        Some(Self::of_decimals(text).unwrap_or(rounded))
    }

    /// Reads a number without an exponent.
    fn of_decimals(text: &str) -> Option<Self> {
        let (whole, rest) = text.split_once('.')?;
        let sign = if whole.starts_with('-') { "-" } else { "" };
        Some(Self { whole_s: whole.parse().ok()?, rest_s: format!("{sign}0.{rest}").parse().ok()? })
            .filter(|_| rest.bytes().all(|byte| byte.is_ascii_digit()))
    }

    /// Time after another one, s.
    fn after(self, first: Self) -> f64 {
        (self.whole_s - first.whole_s) + (self.rest_s - first.rest_s)
    }

    fn seconds(self) -> f64 {
        self.whole_s + self.rest_s
    }
}

/// Checks that the orientation turns by less than a quarter turn from one sample to the next.
fn turns_little(sample: &PoseSample, previous: &PoseSample) -> Result<(), RecordedReason> {
    if let (Some(q), Some(previous)) = (sample.quaternion, previous.quaternion) {
        let cosine = Vector4::from(q).dot(&Vector4::from(previous)).abs();
        let angle_rad = 2.0 * cosine.min(1.0).acos();
        if angle_rad > std::f64::consts::FRAC_PI_2 {
            return Err(RecordedReason::Turn { angle_rad });
        }
    }
    Ok(())
}

/// Returns the line number, from 1, of a record that starts at a byte position of the reader, which includes preceding
/// empty lines.
fn line_at(text: &str, byte: u64) -> u64 {
    let bytes = text.as_bytes();
    let from = usize::try_from(byte).map_or(bytes.len(), |byte| byte.min(bytes.len()));
    let empty = bytes[from..].iter().take_while(|byte| matches!(byte, b'\r' | b'\n')).count();
    1 + bytes[..from + empty].iter().filter(|byte| **byte == b'\n').count() as u64
}

fn syntax(text: &str, error: &csv::Error) -> RecordedError {
    let line = error.position().map(|position| line_at(text, position.byte()));
    let reason = match error.kind() {
        csv::ErrorKind::UnequalLengths { expected_len, len, .. } => {
            RecordedReason::Values { values: *len, columns: *expected_len }
        }
        _ => RecordedReason::Syntax { message: error.to_string() },
    };
    RecordedError { line, reason }
}

/// Position (m) and quaternion (w, x, y, z).
type Row = SVector<f64, 7>;

/// C² cubic spline through the samples of a path, with zero velocity and acceleration at both ends. Its quaternion is
/// the normalised spline through the components.
///
/// A cubic spline has two free conditions, but zero velocity and acceleration at both ends are four. The other two
/// degrees of freedom come from an additional knot, with a free value, within each of the first and the last interval
/// (Biagiotti and Melchiorri 2008, *Trajectory Planning for Automatic Machines and Robots*, §4.4.4).
#[derive(Clone, Debug)]
pub(crate) struct Spline {
    turns: bool,
    /// Times of the knots after the first sample, s.
    times: Vec<f64>,
    values: Vec<Row>,
    /// Second derivatives at the knots.
    bends: Vec<Row>,
}

impl Spline {
    /// Creates the spline; `None` if the samples are not a valid path.
    pub(crate) fn new(path: &RecordedPath) -> Option<Self> {
        if !path.is_read() {
            return None;
        }
        let samples = &path.samples;
        let turns = samples.iter().all(|sample| sample.quaternion.is_some());
        let mut times = Vec::with_capacity(samples.len() + 2);
        let mut values: Vec<Row> = Vec::with_capacity(samples.len() + 2);
        let mut before = Vector4::new(1.0, 0.0, 0.0, 0.0);
        for sample in samples {
            let mut q = sample.quaternion.filter(|_| turns).map_or(before, Vector4::from);
            // Selects the sign that is closer to the previous quaternion.
            if q.dot(&before) < 0.0 {
                q = -q;
            }
            before = q;
            let [x, y, z] = sample.position;
            times.push(sample.time_s - samples[0].time_s);
            values.push(Row::from([x, y, z, q[0], q[1], q[2], q[3]]));
        }
        let last = times.len() - 1;
        let (first_value, last_value) = (values[0], values[last]);
        // The values of the free knots are those of the ends plus a multiple of the unknown second derivative.
        let (begin, end) = if last == 1 {
            (times[1] / 3.0, times[1] * 2.0 / 3.0)
        } else {
            (0.5 * times[1], 0.5 * (times[last - 1] + times[last]))
        };
        times.insert(last, end);
        values.insert(last, last_value);
        times.insert(1, begin);
        values.insert(1, first_value);
        let bends = bends(&times, &mut values);
        Some(Self { turns, times, values, bends })
    }

    /// Interpolated row and its first two derivatives.
    fn row(&self, time_s: f64) -> [Row; 3] {
        let last = self.times.len() - 1;
        let next = self.times.partition_point(|t| *t <= time_s);
        if time_s <= 0.0 || next > last {
            let value = self.values[if next > last { last } else { 0 }];
            return [value, Row::zeros(), Row::zeros()];
        }
        let k = next - 1;
        let (h, u) = (self.times[next] - self.times[k], time_s - self.times[k]);
        let (y, bend) = (self.values[k], self.bends[k]);
        let third = (self.bends[next] - bend) / h;
        let slope = (self.values[next] - y) / h - (bend * 2.0 + self.bends[next]) * (h / 6.0);
        [
            y + (slope + (bend / 2.0 + third * (u / 6.0)) * u) * u,
            slope + (bend + third * (u / 2.0)) * u,
            bend + third * u,
        ]
    }

    /// Recorded target at `time_s` (s) after the first sample.
    fn at(&self, time_s: f64) -> Target {
        let [row, velocity, acceleration] = self.row(time_s);
        let linear = |row: &Row| row.fixed_rows::<3>(0).into_owned();
        let quaternion = |row: &Row| Quaternion::new(row[3], row[4], row[5], row[6]);
        let [q, dq, ddq] = [quaternion(&row), quaternion(&velocity), quaternion(&acceleration)];
        // ω is the vector part of 2 q̇ q*/|q|²; the scalar part is due to the change of |q|. The derivative is
        // analogous.
        let squared = q.norm_squared();
        let omega = (dq * q.conjugate()).imag() * (2.0 / squared);
        let alpha = (ddq * q.conjugate()).imag() * (2.0 / squared) - omega * (2.0 * q.dot(&dq) / squared);
        Target {
            placement: Placement {
                translation: linear(&row),
                rotation: *UnitQuaternion::from_quaternion(q).to_rotation_matrix().matrix(),
            },
            velocity: Motion { linear: linear(&velocity), angular: omega },
            acceleration: Motion { linear: linear(&acceleration), angular: alpha },
        }
    }
}

/// Computes the second derivatives M of a spline at its knots, with zero at both ends, and moves the values of the
/// second and the second-last knot so that the ends are at rest.
///
/// ```text
/// h₋ M₋ + 2(h₋ + h) M + h M₊ = 6 ((y₊ − y)/h − (y − y₋)/h₋)     at each knot within
/// y = y_end + M h_end²/6                                        at the free knots
/// ```
fn bends(times: &[f64], values: &mut [Row]) -> Vec<Row> {
    let last = times.len() - 1;
    let h = |k: usize| times[k + 1] - times[k];
    let share = |k: usize| {
        if k == 1 {
            h(0) * h(0) / 6.0
        } else if k == last - 1 {
            h(k) * h(k) / 6.0
        } else {
            0.0
        }
    };
    // Thomas' algorithm: the matrix is diagonally dominant.
    let mut upper = vec![0.0; times.len()];
    let mut bends = vec![Row::zeros(); times.len()];
    for k in 1..last {
        let (before, after) = (h(k - 1), h(k));
        let lower = before - 6.0 * share(k - 1) / before;
        let diagonal = 2.0 * (before + after) + 6.0 * share(k) * (1.0 / before + 1.0 / after);
        let slopes = (values[k + 1] - values[k]) / after - (values[k] - values[k - 1]) / before;
        let pivot = diagonal - lower * upper[k - 1];
        upper[k] = (after - 6.0 * share(k + 1) / after) / pivot;
        bends[k] = (slopes * 6.0 - bends[k - 1] * lower) / pivot;
    }
    for k in (1..last).rev() {
        let next = bends[k + 1];
        bends[k] -= next * upper[k];
    }
    bends[last] = Row::zeros();
    for k in [1, last - 1] {
        values[k] += bends[k] * share(k);
    }
    bends
}

/// A recorded path that starts at a given pose.
#[derive(Clone, Debug)]
pub(crate) struct RecordedMotion {
    spline: Spline,
    relative: bool,
    approach_s: f64,
    join: Join,
}

/// Connection of a path to the start pose.
#[derive(Clone, Copy, Debug)]
enum Join {
    /// Rigid displacement of the path: `turn` and `shift` transform its positions, `turn` and `own` its orientations.
    Laid { turn: Matrix3<f64>, shift: Vector3<f64>, own: Matrix3<f64> },
    /// The offset of the start pose from the path's first pose (`line` in m, `turn` as a rotation vector in rad) is
    /// added to the path and faded out.
    Faded { line: Vector3<f64>, turn: Vector3<f64> },
}

impl RecordedMotion {
    /// Creates the motion; `None` if the samples are not a valid path.
    pub(crate) fn new(path: &RecordedPath) -> Option<Self> {
        let nowhere = Vector3::zeros();
        Some(Self {
            spline: Spline::new(path)?,
            relative: path.relative,
            approach_s: path.approach_s.get(),
            join: Join::Faded { line: nowhere, turn: nowhere },
        })
    }

    pub(crate) fn start(&mut self, from: &Placement, axes: &Matrix3<f64>) {
        let first = self.spline.at(0.0).placement;
        self.join = if self.relative {
            Join::Laid {
                turn: *axes,
                shift: from.translation - axes * first.translation,
                own: first.rotation.transpose() * axes.transpose() * from.rotation,
            }
        } else {
            Join::Faded {
                line: from.translation - first.translation,
                turn: orientation::log(&(from.rotation * first.rotation.transpose())),
            }
        };
    }

    pub(crate) fn at(&self, time_s: f64) -> Target {
        let recorded = self.spline.at(time_s);
        match &self.join {
            Join::Laid { turn, shift, own } => laid(&recorded, turn, shift, own),
            Join::Faded { line, turn } => {
                let [s, ds, dds] = minimum_jerk(time_s, self.approach_s);
                let left = [1.0 - s, -ds, -dds];
                // A path without orientations does not change the frame's orientation.
                let turned = if self.spline.turns { left } else { [1.0, 0.0, 0.0] };
                displaced(&recorded, left.map(|s| line * s), turned.map(|s| turn * s))
            }
        }
    }
}

/// Returns `target`, displaced by a translation (m) and a rotation vector (rad) with their first two derivatives.
fn displaced(target: &Target, line: [Vector3<f64>; 3], turn: [Vector3<f64>; 3]) -> Target {
    let Target { placement, velocity, acceleration } = target;
    let (omega, alpha) = rotation_vector_rates(&turn[0], &turn[1], &turn[2]);
    let turn = orientation::exp(&turn[0]);
    let turned = turn * velocity.angular;
    Target {
        placement: Placement {
            translation: placement.translation + line[0],
            rotation: turn * placement.rotation,
        },
        velocity: Motion { linear: velocity.linear + line[1], angular: omega + turned },
        acceleration: Motion {
            linear: acceleration.linear + line[2],
            angular: alpha + omega.cross(&turned) + turn * acceleration.angular,
        },
    }
}
