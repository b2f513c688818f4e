//! The part of a suite that a process runs, given or read from the environment of a batch system.

use crate::console::{Exit, Failure};
use opspace_suite::shard::Shard;

/// Value of `--shard`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShardChoice {
    /// `2/8`.
    Given(Shard),
    /// `auto`, or `auto/8` with the number of parts.
    Auto(Option<usize>),
}

/// Parses the value of `--shard`.
pub fn shard_choice(text: &str) -> Result<ShardChoice, String> {
    match text.strip_prefix("auto") {
        None => text.parse().map(ShardChoice::Given),
        Some("") => Ok(ShardChoice::Auto(None)),
        Some(rest) => match rest.strip_prefix('/').and_then(|count| count.parse().ok()) {
            Some(count) if count > 0 => Ok(ShardChoice::Auto(Some(count))),
            _ => Err("expected `auto`, or `auto/8` with the number of parts".to_owned()),
        },
    }
}

impl ShardChoice {
    /// Returns the part, read from the environment of Slurm or Kubernetes if it is not given.
    pub fn resolve(self) -> Result<Shard, Failure> {
        self.resolve_in(|name| std::env::var(name).ok()).map_err(|message| Failure::Other(message, Exit::Bad))
    }

    fn resolve_in(self, env: impl Fn(&str) -> Option<String>) -> Result<Shard, String> {
        let count = match self {
            Self::Given(shard) => return Ok(shard),
            Self::Auto(count) => count,
        };
        let number = |name: &str| match env(name).map(|text| text.parse::<usize>()) {
            Some(Ok(number)) => Ok(Some(number)),
            Some(Err(_)) => Err(format!("--shard auto: {name} is not a whole number")),
            None => Ok(None),
        };
        let (name, index) = match (number(SLURM_ID)?, number(KUBERNETES_INDEX)?) {
            (Some(index), _) => (SLURM_ID, index),
            (None, Some(index)) => (KUBERNETES_INDEX, index),
            (None, None) => {
                return Err(format!(
                    "--shard auto: neither {SLURM_ID} nor {KUBERNETES_INDEX} is set; state the part, as in --shard 1/8"
                ));
            }
        };
        if let Some(count) = count {
            return Shard::new(index + 1, count).ok_or_else(|| {
                format!("--shard auto/{count}: {name} is {index}, but must be from 0 to {}", count - 1)
            });
        }
        if name == KUBERNETES_INDEX {
            return Err(format!(
                "--shard auto: {name} does not state the number of parts; use --shard auto/N with N completions"
            ));
        }
        let [first, last, count] = [
            number("SLURM_ARRAY_TASK_MIN")?,
            number("SLURM_ARRAY_TASK_MAX")?,
            number("SLURM_ARRAY_TASK_COUNT")?,
        ];
        let (Some(first), Some(last), Some(count)) = (first, last, count) else {
            return Err("--shard auto: SLURM_ARRAY_TASK_MIN, _MAX or _COUNT is not set; use --shard auto/N"
                .to_owned());
        };
        let step = number("SLURM_ARRAY_TASK_STEP")?.unwrap_or(1).max(1);
        let is_even = first <= index && index <= last && (index - first) % step == 0;
        // An array of a list of numbers has no step: the place of this number in it is unknown.
        if !is_even || (last - first) / step + 1 != count {
            return Err(format!(
                "--shard auto: the numbers of this array ({count} from {first} to {last}) are not evenly spaced; submit \
                 --array=0-{} and use --shard auto/{count}",
                count.saturating_sub(1)
            ));
        }
        Shard::new((index - first) / step + 1, count).ok_or_else(|| "--shard auto: no such part".to_owned())
    }
}

const SLURM_ID: &str = "SLURM_ARRAY_TASK_ID";
const KUBERNETES_INDEX: &str = "JOB_COMPLETION_INDEX";

#[cfg(test)]
mod tests {
    use super::{ShardChoice, shard_choice};

    fn resolved(choice: &str, env: &[(&str, &str)]) -> Result<String, String> {
        let value =
            |name: &str| env.iter().find(|(own, _)| *own == name).map(|(_, value)| (*value).to_owned());
        shard_choice(choice)?.resolve_in(value).map(|shard| shard.to_string())
    }

    fn slurm(ids: &'static str) -> Vec<(&'static str, &'static str)> {
        let names = ["ID", "MIN", "MAX", "STEP", "COUNT"].map(|name| match name {
            "ID" => "SLURM_ARRAY_TASK_ID",
            "MIN" => "SLURM_ARRAY_TASK_MIN",
            "MAX" => "SLURM_ARRAY_TASK_MAX",
            "STEP" => "SLURM_ARRAY_TASK_STEP",
            _ => "SLURM_ARRAY_TASK_COUNT",
        });
        names.into_iter().zip(ids.split(' ')).filter(|(_, value)| *value != "-").collect()
    }

    /// Checks arrays from 0 and from 1, with a step, and those whose numbers do not determine the part.
    #[test]
    fn part_is_read_from_slurm() {
        for (ids, expected) in
            [("0 0 2 1 3", "1/3"), ("3 1 3 1 3", "3/3"), ("14 10 14 2 3", "3/3"), ("7 7 7 1 1", "1/1")]
        {
            assert_eq!(resolved("auto", &slurm(ids)), Ok(expected.to_owned()), "{ids}");
        }
        for (ids, words) in [
            ("7 1 7 1 3", "evenly"),
            ("5 10 14 2 3", "evenly"),
            ("1 - - - -", "auto/N"),
            ("x 0 2 1 3", "whole"),
        ] {
            assert!(resolved("auto", &slurm(ids)).is_err_and(|error| error.contains(words)), "{ids}");
        }
        // One part that is submitted again.
        assert_eq!(resolved("auto/3", &slurm("2 2 2 1 1")), Ok("3/3".to_owned()));
        assert!(resolved("auto/3", &slurm("3 1 3 1 3")).is_err_and(|error| error.contains("from 0 to 2")));
    }

    #[test]
    fn part_is_read_from_kubernetes() {
        let env = [("JOB_COMPLETION_INDEX", "7")];
        assert_eq!(resolved("auto/8", &env), Ok("8/8".to_owned()));
        assert!(resolved("auto", &env).is_err_and(|error| error.contains("auto/N")));
        assert!(resolved("auto/7", &env).is_err_and(|error| error.contains("from 0 to 6")));
        assert!(resolved("auto", &[]).is_err_and(|error| error.contains("--shard 1/8")));
        for wrong in ["auto/", "auto/0", "auto/x", "automatic", "0/3", "4/3"] {
            assert!(shard_choice(wrong).is_err(), "{wrong}");
        }
        assert!(matches!(shard_choice("2/3"), Ok(ShardChoice::Given(_))));
    }
}
