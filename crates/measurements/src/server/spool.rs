//! Spools: batches that are kept in a file during a server's outage, in order, each with its number and a checksum. A
//! batch is durable before it is acknowledged. The process that fills the file locks it. A file without a lock was left
//! behind, and the next process that opens the same history takes it in.
//!
//! The file begins with [`MAGIC`]. A record is its length (4 bytes), its number (8), the FNV-1a of number and content
//! (8), and the content. Little-endian throughout.

use std::{
    fs::{self, File, OpenOptions, TryLockError},
    hash::{BuildHasher, Hasher, RandomState},
    io::{self, ErrorKind, Write},
    os::unix::fs::FileExt,
    path::{Path, PathBuf},
    sync::Arc,
};

use cotorra_graph::Timestamp;

use crate::{
    codec::{
        ReadError,
        binary::{self, Bytes},
    },
    error::{Error, Result},
    run::{Entry, Gap, RunId},
};

const MAGIC: &[u8; 16] = b"cotorra spool 6\n";
const HEADER: usize = 20;

/// A file of batches that wait for the server.
#[derive(Debug)]
pub(super) struct Spool {
    path: PathBuf,
    file: Arc<File>,
    /// Id of the process that fills the spool.
    pub writer: String,
    /// End of the last whole record.
    end: u64,
    bound: u64,
    /// Buffer for encoding.
    bytes: Vec<u8>,
}

/// A record of a spool.
#[derive(Debug, PartialEq)]
pub(super) enum Record {
    Batch { events: Vec<Entry>, gaps: Vec<(RunId, Gap)> },
    End { run: RunId, at: Timestamp },
}

/// Content of the file after a place.
#[derive(Debug)]
pub(super) enum Next {
    /// A record's number, the record, and the place after it.
    Record(u64, Record, u64),
    /// The end, or a torn record that was never acknowledged.
    End,
    /// Bytes that no process wrote.
    Damage(String),
}

fn fnv(parts: &[&[u8]]) -> u64 {
    let bytes = parts.iter().copied().flatten();
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x100_0000_01b3))
}

/// Returns the prefix of the names of a history's spools.
fn prefix(history: &str) -> String {
    format!("{:016x}-", fnv(&[history.as_bytes()]))
}

fn spool_error(path: &Path) -> impl Fn(io::Error) -> Error {
    move |cause| Error::Spool { spool: path.to_string_lossy().into(), cause: Arc::new(cause) }
}

impl Spool {
    /// Creates an empty spool of at most `bound` bytes for a history.
    pub fn create(folder: &Path, history: &str, bound: u64) -> Result<Self> {
        fs::create_dir_all(folder).map_err(spool_error(folder))?;
        loop {
            // Keys of the standard library's hash maps are random.
            let writer = format!("{:016x}", RandomState::new().build_hasher().finish());
            let path = folder.join(format!("{}{writer}.spool", prefix(history)));
            let create = || -> io::Result<Option<File>> {
                let file = OpenOptions::new().read(true).write(true).create_new(true).open(&path)?;
                match file.try_lock() {
                    Ok(()) => {}
                    // Another process looked for spools left behind, and locked it first.
                    Err(TryLockError::WouldBlock) => return Ok(None),
                    Err(TryLockError::Error(e)) => return Err(e),
                }
                (&file).write_all(MAGIC)?;
                file.sync_all()?;
                File::open(folder)?.sync_all()?;
                Ok(Some(file))
            };
            match create() {
                Ok(Some(file)) => {
                    let end = MAGIC.len() as u64;
                    let file = Arc::new(file);
                    return Ok(Self { path, file, writer, end, bound, bytes: Vec::new() });
                }
                Ok(None) => {}
                Err(e) if e.kind() == ErrorKind::AlreadyExists => {}
                Err(e) => return Err(spool_error(&path)(e)),
            }
        }
    }

    /// Returns the spools that processes left behind for the same history, and locks them.
    pub fn left_behind(folder: &Path, history: &str) -> Result<Vec<Self>> {
        let prefix = prefix(history);
        let mut found = Vec::new();
        let look = || -> io::Result<Vec<PathBuf>> {
            fs::read_dir(folder)?.map(|entry| entry.map(|entry| entry.path())).collect()
        };
        let mut paths = look().map_err(spool_error(folder))?;
        paths.sort();
        for path in paths {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            let Some(writer) = name.strip_prefix(&prefix).and_then(|rest| rest.strip_suffix(".spool")) else {
                continue;
            };
            let writer = writer.to_owned();
            let open = || -> io::Result<Option<(File, u64)>> {
                let file = OpenOptions::new().read(true).write(true).open(&path)?;
                match file.try_lock() {
                    Ok(()) => {}
                    Err(TryLockError::WouldBlock) => return Ok(None),
                    Err(TryLockError::Error(e)) => return Err(e),
                }
                let end = file.metadata()?.len();
                Ok(Some((file, end)))
            };
            match open() {
                Ok(Some((file, end))) => {
                    found.push(Self { path, file: Arc::new(file), writer, end, bound: 0, bytes: Vec::new() });
                }
                Ok(None) => {}
                // Another process took it in and removed it.
                Err(e) if e.kind() == ErrorKind::NotFound => {}
                Err(e) => return Err(spool_error(&path)(e)),
            }
        }
        Ok(found)
    }

    /// Returns the place of the first record.
    pub const fn begin() -> u64 {
        MAGIC.len() as u64
    }

    /// Returns the place of the next record.
    pub fn end(&self) -> u64 {
        self.end
    }

    pub fn name(&self) -> String {
        self.path.to_string_lossy().into_owned()
    }

    /// Adds a batch, which is durable when this returns. Gaps without events are accepted beyond the bound: they record
    /// events that found no room.
    pub fn push_batch(&mut self, number: u64, events: &[Entry], gaps: &[(RunId, Gap)]) -> Result<()> {
        self.bytes.clear();
        self.bytes.push(0);
        binary::write_integer(events.len() as i64, &mut self.bytes);
        for entry in events {
            binary::write(entry, &mut self.bytes);
        }
        for (run, gap) in gaps {
            let (from, until) = (gap.from.as_nanos().cast_signed(), gap.until.as_nanos().cast_signed());
            for n in [run.0, from, until, gap.events.cast_signed()] {
                binary::write_integer(n, &mut self.bytes);
            }
        }
        self.push(number, events.is_empty())
    }

    /// Adds the end of a run, which is durable when this returns.
    pub fn push_end(&mut self, number: u64, run: RunId, at: Timestamp) -> Result<()> {
        self.bytes.clear();
        self.bytes.push(1);
        binary::write_integer(run.0, &mut self.bytes);
        binary::write_integer(at.as_nanos().cast_signed(), &mut self.bytes);
        self.push(number, true)
    }

    fn push(&mut self, number: u64, small: bool) -> Result<()> {
        let size = (HEADER + self.bytes.len()) as u64;
        if self.end + size > self.bound && !small {
            return Err(Error::SpoolFull { spool: self.name().into(), megabytes: self.bound / 1_000_000 });
        }
        let number = number.to_le_bytes();
        let mut record = Vec::with_capacity(size as usize);
        record.extend((self.bytes.len() as u32).to_le_bytes());
        record.extend(number);
        record.extend(fnv(&[&number, &self.bytes]).to_le_bytes());
        record.extend(&self.bytes);
        // At a fixed place, so that the remains of a failed push are overwritten.
        self.file
            .write_all_at(&record, self.end)
            .and_then(|()| self.file.sync_data())
            .map_err(spool_error(&self.path))?;
        self.end += size;
        Ok(())
    }

    /// Removes all records.
    pub fn clear(&mut self) -> Result<()> {
        self.file
            .set_len(Self::begin())
            .and_then(|()| self.file.sync_data())
            .map_err(spool_error(&self.path))?;
        self.end = Self::begin();
        self.bytes = Vec::new();
        Ok(())
    }

    /// Removes the file.
    pub fn remove(&self) -> Result<()> {
        match fs::remove_file(&self.path) {
            Err(e) if e.kind() != ErrorKind::NotFound => Err(spool_error(&self.path)(e)),
            _ => Ok(()),
        }
    }

    /// Renames a damaged file, and returns its new path.
    pub fn put_aside(&self) -> Result<PathBuf> {
        let aside = self.path.with_extension("damaged");
        fs::rename(&self.path, &aside).map_err(spool_error(&self.path))?;
        Ok(aside)
    }

    /// Returns a reader, which works while records are added.
    pub fn reader(&self) -> SpoolReader {
        SpoolReader { file: self.file.clone(), path: self.path.clone() }
    }
}

/// Reads a spool.
pub(super) struct SpoolReader {
    file: Arc<File>,
    path: PathBuf,
}

impl SpoolReader {
    /// Returns the record at `place`, if it ends at `end` or before.
    pub fn next(&self, place: u64, end: u64) -> Result<Next> {
        if end < Spool::begin() {
            // The process was killed while it created the file.
            return Ok(Next::End);
        }
        if place == Spool::begin() {
            let mut magic = [0; MAGIC.len()];
            self.file.read_exact_at(&mut magic, 0).map_err(spool_error(&self.path))?;
            if &magic != MAGIC {
                return Ok(Next::Damage("it is not a spool of this version".to_owned()));
            }
        }
        let left = end.saturating_sub(place);
        if left < HEADER as u64 {
            return Ok(Next::End);
        }
        let mut header = [0; HEADER];
        self.file.read_exact_at(&mut header, place).map_err(spool_error(&self.path))?;
        let (length, rest) = header.split_at(4);
        let (number, sum) = rest.split_at(8);
        let length = u32::from_le_bytes(length.try_into().expect("four bytes were split off"));
        if left < HEADER as u64 + u64::from(length) {
            return Ok(Next::End);
        }
        let mut content = vec![0; length as usize];
        self.file.read_exact_at(&mut content, place + HEADER as u64).map_err(spool_error(&self.path))?;
        let behind = place + HEADER as u64 + u64::from(length);
        if fnv(&[number, &content]).to_le_bytes() != sum {
            // A crash of the machine tears the last record.
            return Ok(if behind == end {
                Next::End
            } else {
                Next::Damage("a checksum is wrong".to_owned())
            });
        }
        let number = u64::from_le_bytes(number.try_into().expect("eight bytes were split off"));
        match record(&content) {
            Ok(record) => Ok(Next::Record(number, record, behind)),
            Err(ReadError::Unreadable(detail)) => Ok(Next::Damage(detail)),
            Err(ReadError::Engine(error)) => Err(error),
        }
    }
}

fn record(content: &[u8]) -> std::result::Result<Record, ReadError> {
    let (what, content) =
        content.split_first().ok_or_else(|| ReadError::Unreadable("it is empty".to_owned()))?;
    let mut bytes = Bytes(content);
    let timestamp = |n: i64| Timestamp::from_nanos(n.cast_unsigned());
    if *what == 1 {
        return Ok(Record::End { run: RunId(bytes.plain_integer()?), at: timestamp(bytes.plain_integer()?) });
    }
    let events = (0..bytes.plain_integer()?).map(|_| bytes.entry()).collect::<std::result::Result<_, _>>()?;
    let mut gaps = Vec::new();
    while !bytes.0.is_empty() {
        let run = RunId(bytes.plain_integer()?);
        let (from, until) = (timestamp(bytes.plain_integer()?), timestamp(bytes.plain_integer()?));
        gaps.push((run, Gap { from, until, events: bytes.plain_integer()?.cast_unsigned() }));
    }
    Ok(Record::Batch { events, gaps })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::notice;

    const HISTORY: &str = "mysql://db:3306/cotorra";

    fn entry(n: u64) -> Entry {
        Entry { run: RunId(1), stamped: notice(n, &format!("number {n}")) }
    }

    fn filled(folder: &Path, batches: u64) -> Spool {
        let mut spool = Spool::create(folder, HISTORY, 1_000_000).unwrap();
        for n in 0..batches {
            let gap = Gap { from: Timestamp::ZERO, until: Timestamp::MAX, events: n };
            spool.push_batch(n, &[entry(n)], &[(RunId(7), gap)]).unwrap();
        }
        spool.push_end(batches, RunId(1), Timestamp::from_nanos(9)).unwrap();
        spool
    }

    /// Returns the numbers of its records, and whether damage follows them.
    fn numbers(spool: &Spool) -> (Vec<u64>, bool) {
        let (reader, mut place, mut numbers) = (spool.reader(), Spool::begin(), Vec::new());
        loop {
            match reader.next(place, spool.end()).unwrap() {
                Next::Record(number, _, behind) => {
                    numbers.push(number);
                    place = behind;
                }
                Next::End => return (numbers, false),
                Next::Damage(_) => return (numbers, true),
            }
        }
    }

    #[test]
    fn a_spool_left_behind_is_found_once() {
        let folder = tempfile::tempdir().unwrap();
        let spool = filled(folder.path(), 3);
        assert!(Spool::left_behind(folder.path(), HISTORY).unwrap().is_empty(), "its process lives");
        drop(spool);
        assert!(Spool::left_behind(folder.path(), "mysql://db:3306/another").unwrap().is_empty());
        let found = Spool::left_behind(folder.path(), HISTORY).unwrap();
        assert!(Spool::left_behind(folder.path(), HISTORY).unwrap().is_empty(), "someone has it");
        let [spool] = &found[..] else { panic!("one was left, and not {}", found.len()) };
        assert_eq!(numbers(spool), (vec![0, 1, 2, 3], false));
        let Next::Record(0, Record::Batch { events, gaps }, _) =
            spool.reader().next(Spool::begin(), spool.end()).unwrap()
        else {
            panic!("the first record is a batch")
        };
        assert_eq!(events, [entry(0)]);
        assert_eq!(gaps, [(RunId(7), Gap { from: Timestamp::ZERO, until: Timestamp::MAX, events: 0 })]);
        spool.remove().unwrap();
        drop(found);
        assert!(Spool::left_behind(folder.path(), HISTORY).unwrap().is_empty());
    }

    /// Cutting off the last record anywhere leaves all records before it.
    #[test]
    fn a_torn_record_leaves_those_before_it() {
        let folder = tempfile::tempdir().unwrap();
        let whole = filled(folder.path(), 3);
        let size = whole.end();
        let path = whole.path.clone();
        drop(whole);
        let bytes = fs::read(&path).unwrap();
        for cut in 0..size {
            fs::write(&path, &bytes[..cut as usize]).unwrap();
            let found = Spool::left_behind(folder.path(), HISTORY).unwrap();
            let (numbers, damaged) = numbers(&found[0]);
            assert!(!damaged && numbers.len() < 4, "{cut}");
            assert_eq!(numbers, (0..numbers.len() as u64).collect::<Vec<_>>());
        }
        // The file may be as long as it was to be, and not be filled.
        let mut torn = bytes.clone();
        torn[bytes.len() - 2..].fill(0);
        fs::write(&path, &torn).unwrap();
        assert_eq!(numbers(&Spool::left_behind(folder.path(), HISTORY).unwrap()[0]), (vec![0, 1, 2], false));
    }

    #[test]
    fn damage_is_reported() {
        let folder = tempfile::tempdir().unwrap();
        let spool = filled(folder.path(), 3);
        let (size, path) = (spool.end(), spool.path.clone());
        drop(spool);
        let bytes = fs::read(&path).unwrap();
        for at in 0..size as usize {
            let mut damaged = bytes.clone();
            damaged[at] ^= 0x55;
            fs::write(&path, &damaged).unwrap();
            let found = Spool::left_behind(folder.path(), HISTORY).unwrap();
            let (numbers, damaged) = numbers(&found[0]);
            assert!(damaged || numbers.len() < 4, "byte {at}");
        }
    }

    #[test]
    fn no_file_outgrows_its_bound_but_for_gaps_and_ends() {
        let folder = tempfile::tempdir().unwrap();
        let mut spool = Spool::create(folder.path(), HISTORY, 1000).unwrap();
        let mut taken = 0;
        let error = loop {
            match spool.push_batch(taken, &[entry(taken)], &[]) {
                Ok(()) => taken += 1,
                Err(error) => break error,
            }
        };
        assert!(matches!(error, Error::SpoolFull { .. }) && taken > 10 && spool.end() <= 1000);
        spool
            .push_batch(
                taken,
                &[],
                &[(RunId(1), Gap { from: Timestamp::ZERO, until: Timestamp::ZERO, events: 3 })],
            )
            .unwrap();
        spool.push_end(taken + 1, RunId(1), Timestamp::ZERO).unwrap();
        assert_eq!(numbers(&spool).0.len() as u64, taken + 2);
        spool.clear().unwrap();
        assert_eq!(numbers(&spool), (vec![], false));
        spool.push_batch(taken, &[entry(0)], &[]).unwrap();
    }
}
