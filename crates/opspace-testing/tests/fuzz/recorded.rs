//! Recorded paths as CSV.

use crate::edits::{apply_to_text, edited};
use crate::inputs::for_each_input;
use crate::limits::Target;
use crate::{CORPUS, text, texts};
use opspace_control::recorded::{COLUMNS, parse};
use opspace_control::{CartesianReference, PoseSample, RecordedPath, Target as PoseTarget, Trajectory};
use opspace_model::Placement;

/// Most memory for one file, bytes.
const MOST_BYTES: usize = 32 << 20;

/// Largest deviation of the length of a quaternion from 1.
const ROUNDING: f64 = 1e-9;

/// Number of times at which a path is evaluated.
const TIMES: usize = 40;

/// An error has a reason and an existing line. Accepted samples are finite, with increasing times and unit quaternions,
/// and the same when they are written and read again; the path through them is finite at all times.
#[test]
#[ignore = "a fuzz target, which runs for a minute or longer: .ci/run fuzz"]
fn recorded() {
    let mut seeds = texts(CORPUS, ".csv");
    seeds.push(text("tasks/paths/figure-eight.csv"));
    let target = Target::new("recorded", MOST_BYTES);
    for_each_input(edited(seeds.len()), 3000, |(seed, edits)| {
        let text = apply_to_text(&seeds, *seed, edits);
        target.check(text.as_bytes(), edits.is_empty(), || match parse(&text) {
            Ok(samples) => {
                check_samples(&samples);
                check_path(samples);
                true
            }
            Err(error) => {
                assert!(!error.to_string().trim().is_empty(), "{error:?}");
                let lines = text.split('\n').count() as u64;
                assert!(
                    error.line.is_none_or(|line| (1..=lines).contains(&line)),
                    "{error:?} of {lines} lines"
                );
                false
            }
        });
    });
}

fn check_samples(samples: &[PoseSample]) {
    assert!(samples.len() > 1 && samples.windows(2).all(|pair| pair[0].time_s < pair[1].time_s));
    for sample in samples {
        assert!(sample.time_s.is_finite() && sample.position.iter().all(|x| x.is_finite()), "{sample:?}");
        if let Some(q) = sample.quaternion {
            let length = q.iter().map(|x| x * x).sum::<f64>().sqrt();
            assert!((length - 1.0).abs() < ROUNDING, "{sample:?}");
        }
    }
    let turns = samples[0].quaternion.is_some();
    assert!(samples.iter().all(|sample| sample.quaternion.is_some() == turns));
    let mut written = COLUMNS[..if turns { 8 } else { 4 }].join(",") + "\n";
    for sample in samples {
        let numbers = [sample.time_s].into_iter().chain(sample.position);
        let numbers = numbers.chain(sample.quaternion.into_iter().flatten());
        written += &(numbers.map(|x| format!("{x:?}")).collect::<Vec<_>>().join(",") + "\n");
    }
    let again = parse(&written).unwrap_or_else(|error| panic!("{error}: {written}"));
    assert_eq!(again.len(), samples.len());
    for (one, other) in again.iter().zip(samples) {
        assert_eq!((one.time_s, one.position), (other.time_s, other.position));
        // A unit quaternion is normalised once more.
        let (one, other) = (one.quaternion.unwrap_or_default(), other.quaternion.unwrap_or_default());
        assert!(one.iter().zip(other).all(|(a, b)| (a - b).abs() < ROUNDING));
    }
}

fn check_path(samples: Vec<PoseSample>) {
    let (first_s, last_s) = (samples[0].time_s, samples[samples.len() - 1].time_s);
    for relative in [true, false] {
        let file = format!("file = \"path.csv\"\nrelative = {relative}");
        let mut path: RecordedPath = toml::from_str(&file).expect("a path");
        path.samples.clone_from(&samples);
        let mut trajectory = Trajectory::new(&CartesianReference::Recorded(path));
        let home = Placement::from_rpy([0.1, 0.2, 0.3], [0.4, 0.5, 0.6]);
        trajectory.start(&home, &PoseTarget::at_rest(home), &nalgebra::Matrix3::identity());
        for k in 0..=TIMES {
            let at = trajectory.at((last_s - first_s) * k as f64 / TIMES as f64);
            let motions = [at.velocity, at.acceleration];
            let numbers = motions.iter().flat_map(|motion| motion.linear.iter().chain(&motion.angular));
            let pose = at.placement.translation.iter().chain(&at.placement.rotation);
            assert!(numbers.chain(pose).all(|x| x.is_finite()), "{at:?} at {k} of {TIMES}");
        }
    }
}
