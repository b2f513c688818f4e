//! Shards: parts of a suite that are run by separate processes.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::num::NonZero;
use std::str::FromStr;

/// One of several parts of a suite, written `2/8`: the runs 2, 10, 18 and so on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Shard {
    /// Number of the part, from 1.
    index: usize,
    /// Number of parts.
    count: NonZero<usize>,
}

impl Shard {
    /// Creates the part with a number, from 1, of `count` parts; `None` if there is no such part.
    #[must_use]
    pub fn new(index: usize, count: usize) -> Option<Self> {
        let count = NonZero::new(count)?;
        (1..=count.get()).contains(&index).then_some(Self { index, count })
    }

    /// Number of the part, from 1.
    #[must_use]
    pub fn index(self) -> usize {
        self.index
    }

    /// Number of parts.
    #[must_use]
    pub fn count(self) -> usize {
        self.count.get()
    }

    /// True if the run with this number, from 1, belongs to the part.
    #[must_use]
    pub fn contains(self, number: usize) -> bool {
        number >= 1 && (number - 1) % self.count == self.index - 1
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let parts =
            text.split_once('/').and_then(|(index, count)| Some((index.parse().ok()?, count.parse().ok()?)));
        let shard = parts.and_then(|(index, count)| Self::new(index, count));
        shard.ok_or_else(|| format!("expected a part such as 1/8 (1 to 8 of 8), got {text}"))
    }
}

impl TryFrom<String> for Shard {
    type Error = String;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse()
    }
}

impl From<Shard> for String {
    fn from(shard: Shard) -> Self {
        shard.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::Shard;

    /// Every run belongs to exactly one of the parts; parts that do not exist are refused.
    #[test]
    fn shards_divide_the_runs() {
        for count in 1..=7 {
            for number in 1..=20 {
                let holders = (1..=count).filter_map(|index| Shard::new(index, count));
                assert_eq!(holders.filter(|shard| shard.contains(number)).count(), 1);
            }
        }
        assert_eq!("2/8".parse::<Shard>().map(|shard| shard.to_string()), Ok("2/8".to_owned()));
        for wrong in ["", "1", "0/3", "4/3", "1/0", "a/b", "-1/3", "1/3/5"] {
            assert!(wrong.parse::<Shard>().is_err(), "{wrong}");
        }
    }
}
