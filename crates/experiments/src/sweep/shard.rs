//! A shard: one of several equal parts of a sweep's runs, with a folder and a journal of its own.

use std::{fmt, fs, io, num::NonZero, path::Path, str::FromStr};

use cotorra_testbed::write_file;
use serde::{Deserialize, Serialize};

use super::{SweepError, plan::Plan};
use crate::{batch::BatchError, journal::Journal};

/// Name of the file that says what a shard is.
const RECORD: &str = "shard.json";

/// One of several parts of a sweep's runs, written `I/N`: from `1/N` to `N/N`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Shard {
    shards: NonZero<usize>,
    /// From 0.
    index: usize,
}

/// Error of reading a shard.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidShard {
    /// The text is not two whole numbers.
    #[error("`{0}` is not a shard: write it like 3/40, the third of 40")]
    Form(String),
    /// There are no shards at all.
    #[error("there is no shard of 0: write it like 3/40, the third of 40")]
    Empty,
    /// There is no shard of that number.
    #[error("there is no shard {0}/{1}: the shards are 1/{1} to {1}/{1}")]
    Range(usize, usize),
}

impl Shard {
    /// Returns the shard among `shards` that holds the run at this place.
    ///
    /// Each stretch of as many runs as there are shards gives one to each shard. It begins one shard further than the last
    /// stretch: no shard gets all runs with the same value.
    pub(super) fn of_place(place: usize, shards: NonZero<usize>) -> Self {
        Self { shards, index: (place % shards + place / shards) % shards }
    }

    /// Returns the places of its runs among all runs of a sweep.
    ///
    /// # Errors
    /// [`SweepError::Shards`] if there are fewer runs than shards.
    pub(super) fn places(self, runs: usize) -> Result<Vec<usize>, SweepError> {
        Self::check(self.shards, runs)?;
        Ok((0..runs).filter(|&place| Self::of_place(place, self.shards) == self).collect())
    }

    /// Checks that each shard of a sweep with so many runs has one at least.
    ///
    /// # Errors
    /// [`SweepError::Shards`].
    pub fn check(shards: NonZero<usize>, runs: usize) -> Result<(), SweepError> {
        let shards = shards.get();
        if shards > runs { Err(SweepError::Shards { shards, runs }) } else { Ok(()) }
    }

    /// Returns the number of shards.
    pub fn shards(self) -> NonZero<usize> {
        self.shards
    }

    /// Returns the name of its folder within the folder of the sweep.
    pub fn folder(self) -> String {
        format!("shard-{}-of-{}", self.index + 1, self.shards)
    }
}

impl FromStr for Shard {
    type Err = InvalidShard;

    fn from_str(text: &str) -> Result<Self, InvalidShard> {
        let form = || InvalidShard::Form(text.to_owned());
        let (number, shards) = text.split_once('/').ok_or_else(form)?;
        let [number, shards] = [number, shards].map(str::parse::<usize>);
        let (number, shards) = (number.map_err(|_| form())?, shards.map_err(|_| form())?);
        let shards = NonZero::new(shards).ok_or(InvalidShard::Empty)?;
        match number.checked_sub(1) {
            Some(index) if index < shards.get() => Ok(Self { shards, index }),
            _ => Err(InvalidShard::Range(number, shards.get())),
        }
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index + 1, self.shards)
    }
}

impl TryFrom<String> for Shard {
    type Error = InvalidShard;

    fn try_from(text: String) -> Result<Self, InvalidShard> {
        text.parse()
    }
}

impl From<Shard> for String {
    fn from(shard: Shard) -> Self {
        shard.to_string()
    }
}

/// The record of a shard, so that it can be merged without the testbed file.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Record {
    pub(super) shard: Shard,
    #[serde(flatten)]
    pub(super) plan: Plan,
}

impl Record {
    /// Writes the record beside a journal.
    ///
    /// # Errors
    /// [`FolderError`](cotorra_testbed::FolderError).
    pub(super) fn write(&self, journal: &Journal) -> Result<(), SweepError> {
        let text = serde_json::to_string(self).expect("a record is valid JSON");
        Ok(write_file(journal.path(), RECORD, text + "\n").map_err(BatchError::from)?)
    }

    /// Reads the record of a folder; `None` if it is no folder of a shard.
    pub(super) fn read(folder: &Path) -> io::Result<Option<Self>> {
        let text = match fs::read(folder.join(RECORD)) {
            Ok(text) => text,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(error),
        };
        let record: Self = serde_json::from_slice(&text).map_err(|error| {
            let hint = "if it is of an earlier version of cotorra, run the shard again";
            io::Error::other(format!("{RECORD}: {error}; {hint}"))
        })?;
        if record.plan.is_whole() {
            Ok(Some(record))
        } else {
            Err(io::Error::other(format!(
                "{RECORD} does not have a first seed and a key for each combination"
            )))
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn shards(of: usize) -> Vec<Shard> {
        (1..=of).map(|number| format!("{number}/{of}").parse().unwrap()).collect()
    }

    proptest! {
        #[test]
        fn shards_in_any_order_cover_each_run_once(
            (runs, of, order) in (1_usize..500).prop_flat_map(|runs| (Just(runs), 1..=runs))
                .prop_flat_map(|(runs, of)| (Just(runs), Just(of), Just(shards(of)).prop_shuffle())),
        ) {
            let each: Vec<_> = order.iter().map(|shard| shard.places(runs).unwrap()).collect();
            let mut all = each.concat();
            all.sort_unstable();
            prop_assert_eq!(all, (0..runs).collect::<Vec<_>>());
            // They are of equal size, but for one run.
            prop_assert!(each.iter().all(|places| places.len() == runs / of || places.len() == runs.div_ceil(of)));
        }
    }

    #[test]
    fn a_shard_gets_each_value_of_an_axis() {
        for of in 2..=4 {
            for shard in shards(of) {
                let values: std::collections::BTreeSet<_> =
                    shard.places(40).unwrap().iter().map(|place| place % of).collect();
                assert_eq!(values.len(), of, "{shard}");
            }
        }
    }

    #[test]
    fn invalid_shards_are_rejected_with_those_that_there_are() {
        for (text, said) in [
            ("3", "write it like 3/40"),
            ("/4", "write it like 3/40"),
            ("-1/4", "write it like 3/40"),
            ("1/4/2", "write it like 3/40"),
            ("1/0", "there is no shard of 0"),
            ("0/4", "there is no shard 0/4: the shards are 1/4 to 4/4"),
            ("4/3", "there is no shard 4/3: the shards are 1/3 to 3/3"),
        ] {
            let wrong = text.parse::<Shard>().unwrap_err().to_string();
            assert!(wrong.contains(said), "{text}: {wrong}");
        }
        let few = "1/5".parse::<Shard>().unwrap().places(4).unwrap_err().to_string();
        assert!(few.contains("more shards (5) than runs (4)"), "{few}");
    }
}
