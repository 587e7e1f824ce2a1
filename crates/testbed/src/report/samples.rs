//! The service times of a run, which may last for days. The newest are in memory, older ones in a file without a name.

use std::{
    cmp::Reverse,
    collections::{BTreeMap, BinaryHeap},
    fs::{self, File},
    io,
    os::unix::fs::FileExt,
    path::Path,
    time::Duration,
};

use cotorra_graph::{NodeId, ServiceId, ServiceTime, Timestamp};

/// Maximum number of samples in memory, unless they cannot be written.
const IN_MEMORY: usize = 1 << 16;
/// Stands for a missing answer, and for a missing radio unit.
const NONE: u64 = u64::MAX;

/// A sample, with indices instead of names: 40 bytes.
type Packed = [u64; 5];
const SIZE: usize = size_of::<Packed>();

/// The service times of a run.
#[derive(Debug, Default)]
pub struct Samples {
    services: Names<ServiceId>,
    nodes: Names<NodeId>,
    /// The newest samples.
    recent: Vec<Packed>,
    /// All older samples.
    written: Option<File>,
    count_written: usize,
    /// The latest emission.
    end: Timestamp,
    /// The most by which a later sample was emitted before an earlier one.
    disorder: Duration,
}

impl Samples {
    /// Keeps older samples in a file in this folder. The file has no name once this returns, and ends with the process.
    ///
    /// # Errors
    /// Errors of [`File::options`].
    pub fn in_folder(folder: &Path) -> io::Result<Self> {
        let path = folder.join("samples");
        let file = File::options().read(true).write(true).create_new(true).open(&path)?;
        fs::remove_file(path)?;
        Ok(Self { written: Some(file), ..Self::default() })
    }

    /// Returns the number of samples.
    pub fn len(&self) -> usize {
        self.count_written + self.recent.len()
    }

    /// Whether there are no samples.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the latest emission.
    pub fn end(&self) -> Timestamp {
        self.end
    }

    /// Returns all samples by emission. Those emitted at the same time keep their order of arrival.
    pub fn iter(&self) -> impl Iterator<Item = ServiceTime> + '_ {
        let mut came = (0..self.len()).map_while(|place| self.read(place)).enumerate();
        let mut waiting = BinaryHeap::new();
        let mut newest = 0;
        std::iter::from_fn(move || {
            let disorder = self.disorder.as_nanos() as u64;
            let is_first = |waiting: &BinaryHeap<Reverse<(u64, usize, Packed)>>, newest: u64| {
                waiting.peek().is_some_and(|Reverse((emitted, ..))| emitted + disorder < newest)
            };
            while !is_first(&waiting, newest) {
                let Some((place, packed)) = came.next() else { break };
                newest = newest.max(packed[0]);
                waiting.push(Reverse((packed[0], place, packed)));
            }
            waiting.pop().map(|Reverse((.., packed))| self.unpack(packed))
        })
    }

    pub(super) fn push(&mut self, sample: &ServiceTime) {
        let pair = |a: usize, b: usize| (a as u64) << 32 | b as u64;
        let attachment = sample.attachment.as_ref().map_or(NONE, |node| self.nodes.place(node) as u64);
        self.recent.push([
            sample.emitted.as_nanos(),
            sample.took.map_or(NONE, |took| took.as_nanos() as u64),
            pair(self.services.place(&sample.service), self.nodes.place(&sample.robot)),
            pair(sample.sequence as usize, self.nodes.place(&sample.server)),
            attachment,
        ]);
        self.end = self.end.max(sample.emitted);
        self.disorder = self.disorder.max(self.end.since(sample.emitted));
        if self.recent.len().is_multiple_of(IN_MEMORY) {
            self.write();
        }
    }

    /// Moves samples from memory into the file. If that fails they stay, and the next call writes all of them.
    fn write(&mut self) {
        let Some(file) = &self.written else { return };
        let bytes: Vec<u8> = self.recent.iter().flatten().flat_map(|word| word.to_le_bytes()).collect();
        match file.write_all_at(&bytes, (self.count_written * SIZE) as u64) {
            Ok(()) => {
                self.count_written += self.recent.len();
                self.recent.clear();
            }
            Err(error) => tracing::warn!("cannot write samples to disk, and keep them in memory: {error}"),
        }
    }

    fn read(&self, place: usize) -> Option<Packed> {
        if let Some(recent) = place.checked_sub(self.count_written) {
            return self.recent.get(recent).copied();
        }
        let mut bytes = [0; SIZE];
        let read = self.written.as_ref()?.read_exact_at(&mut bytes, (place * SIZE) as u64);
        read.inspect_err(|error| tracing::error!("cannot read samples back: {error}")).ok()?;
        let mut words =
            bytes.chunks_exact(8).map(|word| u64::from_le_bytes(word.try_into().expect("8 bytes")));
        Some([(); 5].map(|()| words.next().expect("5 words")))
    }

    fn unpack(&self, [emitted, took, service_robot, sequence_server, attachment]: Packed) -> ServiceTime {
        let (high, low) = (|pair: u64| (pair >> 32) as usize, |pair: u64| pair as u32 as usize);
        ServiceTime {
            service: self.services.list[high(service_robot)].clone(),
            robot: self.nodes.list[low(service_robot)].clone(),
            sequence: high(sequence_server) as u32,
            emitted: Timestamp::from_nanos(emitted),
            took: (took != NONE).then(|| Duration::from_nanos(took)),
            attachment: (attachment != NONE).then(|| self.nodes.list[attachment as usize].clone()),
            server: self.nodes.list[low(sequence_server)].clone(),
            parts: None,
            lost_at: None,
        }
    }
}

/// Names with their indices.
#[derive(Debug)]
struct Names<T> {
    list: Vec<T>,
    places: BTreeMap<T, usize>,
}

impl<T> Default for Names<T> {
    fn default() -> Self {
        Self { list: Vec::new(), places: BTreeMap::new() }
    }
}

impl<T: Ord + Clone> Names<T> {
    fn place(&mut self, name: &T) -> usize {
        self.places.get(name).copied().unwrap_or_else(|| {
            self.places.insert(name.clone(), self.list.len());
            self.list.push(name.clone());
            self.list.len() - 1
        })
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph_testing as base;
    use proptest::{collection::vec, option, prelude::*};

    use super::*;

    fn sample(number: u32, emitted: u64, took: Option<u64>) -> ServiceTime {
        ServiceTime {
            robot: format!("robot{}", number % 3).parse().unwrap(),
            sequence: number,
            attachment: (!number.is_multiple_of(4)).then(|| format!("R{}", number % 4).parse().unwrap()),
            ..base::service_time("cloud", Timestamp::from_nanos(emitted), took.map(Duration::from_nanos))
        }
    }

    proptest! {
        #[test]
        fn samples_come_back_by_emission_wherever_they_are(
            times in vec((0..50_u64, option::of(0..99_u64)), 0..60),
            write_each in 1..9_usize,
        ) {
            let folder = tempfile::tempdir().unwrap();
            let mut samples = Samples::in_folder(folder.path()).unwrap();
            prop_assert_eq!(folder.path().read_dir().unwrap().count(), 0);
            let mut all = Vec::new();
            for (number, (emitted, took)) in times.into_iter().enumerate() {
                let next = sample(number as u32, emitted, took);
                samples.push(&next);
                all.push(next);
                if number.is_multiple_of(write_each) {
                    samples.write();
                }
            }
            all.sort_by_key(|sample| sample.emitted);
            prop_assert_eq!(samples.len(), all.len());
            prop_assert_eq!(samples.iter().collect::<Vec<_>>(), all);
        }
    }

    #[test]
    fn memory_is_bounded_and_nothing_is_lost() {
        let folder = tempfile::tempdir().unwrap();
        let mut samples = Samples::in_folder(folder.path()).unwrap();
        let count = 3 * IN_MEMORY + 5;
        (0..count).for_each(|n| samples.push(&sample(n as u32, n as u64, Some(1))));
        assert_eq!((samples.recent.len(), samples.len()), (5, count));
        assert!(samples.iter().map(|sample| sample.sequence as usize).eq(0..count));
    }

    #[test]
    fn samples_that_cannot_be_written_stay_in_memory() {
        let mut samples = Samples { written: Some(File::open("/dev/null").unwrap()), ..Samples::default() };
        let count = IN_MEMORY + 1;
        (0..count).for_each(|n| samples.push(&sample(n as u32, n as u64, Some(1))));
        assert_eq!((samples.recent.len(), samples.iter().count()), (count, count));
    }
}
