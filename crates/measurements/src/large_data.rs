//! Large data of sensors, in files of a run's folder. The oldest files are removed first.
//!
//! Each sensor has a folder with segments. `N.data` has the bytes of readings one after the other, beginning with reading
//! N; `N.index` has an entry for each. An entry is written after its bytes, with check sums of both, so that readings that a
//! killed process left half-written are ignored.

use std::{
    collections::VecDeque,
    fs::{self, File, OpenOptions},
    io,
    os::unix::fs::FileExt as _,
    path::{Path, PathBuf},
};

use cotorra_graph::{DataFormat, LargeData, NodeId, SensorId, Timestamp};

/// Bytes of an entry in an index.
const ENTRY: usize = 52;
/// Number of segments that share the kept bytes. A segment is larger if a reading is.
const SHARE: u64 = 8;
/// Most attempts to read when files are removed meanwhile.
const LOOKS: usize = 3;

/// Returns the folder of a sensor's large data within a run's folder.
fn folder_of(run: &Path, robot: &NodeId, sensor: &SensorId) -> PathBuf {
    run.join("sensors").join(robot.as_str()).join(sensor.as_str())
}

/// Large data as it is stored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredData<B = Vec<u8>> {
    /// Time of the measurement.
    pub measured: Timestamp,
    /// Description, as in its event.
    pub data: LargeData,
    /// The data.
    pub bytes: B,
}

/// Writes the large data of one sensor of a run.
#[derive(Debug)]
pub struct LargeDataWriter {
    folder: PathBuf,
    keep: u64,
    /// Segments, oldest first.
    segments: VecDeque<Segment>,
    /// Whether the last segment is complete.
    is_closed: bool,
}

#[derive(Debug)]
struct Segment {
    first: u64,
    entries: u64,
    bytes: u64,
}

impl Segment {
    fn size(&self) -> u64 {
        self.bytes + self.entries * ENTRY as u64
    }

    fn files(&self, folder: &Path) -> [PathBuf; 2] {
        files(folder, self.first)
    }
}

/// Returns the paths of a segment's data and index.
fn files(folder: &Path, first: u64) -> [PathBuf; 2] {
    ["data", "index"].map(|kind| folder.join(format!("{first}.{kind}")))
}

impl LargeDataWriter {
    /// Creates a writer into a run's folder. The files of this sensor never exceed `keep` bytes.
    pub fn new(run: &Path, robot: &NodeId, sensor: &SensorId, keep: u64) -> Self {
        let folder = folder_of(run, robot, sensor);
        Self { folder, keep, segments: VecDeque::new(), is_closed: false }
    }

    /// Adds a reading, whose number is above that of the one before. Removes the oldest readings to make room.
    ///
    /// # Errors
    /// When the reading is larger than the bound, or the system cannot write it. The next one may succeed.
    pub fn append(&mut self, reading: &StoredData<&[u8]>) -> io::Result<()> {
        let bytes = reading.bytes.len() as u64;
        let size = bytes + ENTRY as u64;
        if size > self.keep {
            let problem =
                format!("a reading has {size} bytes, more than the {} bytes kept in all", self.keep);
            return Err(io::Error::new(io::ErrorKind::FileTooLarge, problem));
        }
        while self.segments.iter().map(Segment::size).sum::<u64>() + size > self.keep {
            let Some(oldest) = self.segments.front() else { break };
            for file in oldest.files(&self.folder) {
                fs::remove_file(file).or_else(|e| if is_gone(&e) { Ok(()) } else { Err(e) })?;
            }
            self.segments.pop_front();
        }
        let fits = |last: &&mut Segment| !self.is_closed && last.size() + size <= self.keep / SHARE;
        let segment = match self.segments.back_mut().filter(fits) {
            Some(segment) => segment,
            None => {
                fs::create_dir_all(&self.folder)?;
                self.is_closed = false;
                self.segments.push_back(Segment { first: reading.data.sequence, entries: 0, bytes: 0 });
                self.segments.back_mut().expect("it was just put there")
            }
        };
        let [data, index] = segment.files(&self.folder);
        let entry = Entry::of(reading, segment.bytes).written();
        let written = write_at(&data, reading.bytes, segment.bytes)
            .and_then(|()| write_at(&index, &entry, segment.entries * ENTRY as u64));
        // A part of the reading may be written.
        segment.bytes += bytes;
        segment.entries += 1;
        self.is_closed = written.is_err();
        written
    }
}

fn is_gone(error: &io::Error) -> bool {
    error.kind() == io::ErrorKind::NotFound
}

fn write_at(file: &Path, bytes: &[u8], offset: u64) -> io::Result<()> {
    let file = OpenOptions::new().write(true).create(true).truncate(false).open(file)?;
    file.write_all_at(bytes, offset)
}

/// An entry of an index.
#[derive(Debug, PartialEq)]
struct Entry {
    measured: Timestamp,
    data: LargeData,
    offset: u64,
    /// Check sum of the bytes.
    sum: u32,
}

impl Entry {
    fn of(reading: &StoredData<&[u8]>, offset: u64) -> Self {
        Self { measured: reading.measured, data: reading.data, offset, sum: sum(reading.bytes) }
    }

    fn written(&self) -> [u8; ENTRY] {
        let LargeData { sequence, format, width, height, bytes } = self.data;
        let format = DataFormat::ALL.iter().position(|known| *known == format).unwrap_or_default() as u32;
        let mut entry = [0; ENTRY];
        for (place, figure) in
            [sequence, self.measured.as_nanos(), self.offset, bytes].into_iter().enumerate()
        {
            entry[8 * place..8 * place + 8].copy_from_slice(&figure.to_le_bytes());
        }
        for (place, figure) in [width, height, format, self.sum].into_iter().enumerate() {
            entry[32 + 4 * place..36 + 4 * place].copy_from_slice(&figure.to_le_bytes());
        }
        let own = sum(&entry[..48]);
        entry[48..].copy_from_slice(&own.to_le_bytes());
        entry
    }

    /// Reads an entry; `None` if it was never written whole.
    fn read(entry: &[u8; ENTRY]) -> Option<Self> {
        let long = |place: usize| {
            u64::from_le_bytes(entry[8 * place..8 * place + 8].try_into().expect("it has 8 bytes"))
        };
        let short = |at: usize| u32::from_le_bytes(entry[at..at + 4].try_into().expect("it has 4 bytes"));
        let format = *DataFormat::ALL.get(short(40) as usize)?;
        let data =
            LargeData { sequence: long(0), format, width: short(32), height: short(36), bytes: long(3) };
        let measured = Timestamp::from_nanos(long(1));
        let is_whole = short(48) == sum(&entry[..48]);
        is_whole.then_some(Self { measured, data, offset: long(2), sum: short(44) })
    }
}

/// Returns the FNV-1a of bytes, which is not zero for zeros.
fn sum(bytes: &[u8]) -> u32 {
    bytes.iter().fold(0x811c_9dc5, |sum: u32, byte| (sum ^ u32::from(*byte)).wrapping_mul(0x0100_0193))
}

/// The requested reading.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WantedData {
    /// The reading with this number.
    Number(u64),
    /// The last reading up to this number.
    UpTo(u64),
}

/// Reads large data of a sensor from a run's folder, also while the run goes on; `None` if it is missing or was removed.
///
/// # Errors
/// When the system cannot read it.
pub fn read_large_data(
    run: &Path,
    robot: &NodeId,
    sensor: &SensorId,
    wanted: WantedData,
) -> io::Result<Option<StoredData>> {
    let folder = folder_of(run, robot, sensor);
    for _ in 0..LOOKS {
        let segments = segments(&folder)?;
        let (WantedData::Number(number) | WantedData::UpTo(number)) = wanted;
        for first in segments.iter().rev().filter(|first| **first <= number) {
            match read_segment(&folder, *first, wanted) {
                Ok(None) if matches!(wanted, WantedData::UpTo(_)) => {}
                Err(error) if is_gone(&error) => {}
                read => return read,
            }
        }
        if segments.is_empty() || matches!(wanted, WantedData::Number(_)) {
            break;
        }
    }
    Ok(None)
}

/// Returns the first number of each segment, in order.
fn segments(folder: &Path) -> io::Result<Vec<u64>> {
    let entries = match fs::read_dir(folder) {
        Err(error) if is_gone(&error) => return Ok(Vec::new()),
        entries => entries?,
    };
    let mut segments = Vec::new();
    for entry in entries {
        let name = entry?.file_name();
        segments.extend(name.to_str().and_then(|name| name.strip_suffix(".index")?.parse::<u64>().ok()));
    }
    segments.sort_unstable();
    Ok(segments)
}

fn read_segment(folder: &Path, first: u64, wanted: WantedData) -> io::Result<Option<StoredData>> {
    let [data, index] = files(folder, first);
    let index = File::open(index)?;
    let entry = |place: u64| -> io::Result<Option<Entry>> {
        let mut entry = [0; ENTRY];
        index.read_exact_at(&mut entry, place * ENTRY as u64)?;
        Ok(Entry::read(&entry))
    };
    let (WantedData::Number(number) | WantedData::UpTo(number)) = wanted;
    // Entries are in the order of numbers; a torn one is at the end.
    let (mut from, mut to) = (0, index.metadata()?.len() / ENTRY as u64);
    while from < to {
        let middle = from + (to - from) / 2;
        match entry(middle)? {
            Some(entry) if entry.data.sequence <= number => from = middle + 1,
            _ => to = middle,
        }
    }
    let data = File::open(data)?;
    for place in (0..from).rev() {
        let Some(entry) = entry(place)? else { continue };
        if matches!(wanted, WantedData::Number(number) if entry.data.sequence != number) {
            break;
        }
        if let Some(stored) = read_bytes(&data, entry)? {
            return Ok(Some(stored));
        }
    }
    Ok(None)
}

fn read_bytes(file: &File, entry: Entry) -> io::Result<Option<StoredData>> {
    let Entry { measured, data, offset, sum: expected } = entry;
    let is_there =
        offset.checked_add(data.bytes).is_some_and(|end| end <= file.metadata().map_or(0, |of| of.len()));
    let Some(length) = usize::try_from(data.bytes).ok().filter(|_| is_there) else { return Ok(None) };
    let mut bytes = vec![0; length];
    file.read_exact_at(&mut bytes, offset)?;
    Ok((sum(&bytes) == expected).then_some(StoredData { measured, data, bytes }))
}

#[cfg(test)]
mod tests;
