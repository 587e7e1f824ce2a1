//! Keeps large data of sensors in the run's folder, on a thread that makes its bytes and writes them. In real time the run
//! never waits for it: what finds no room is lost and counted. In virtual time the run waits, so that nothing is.

use std::{
    collections::{BTreeMap, VecDeque},
    io,
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
    sync::Arc,
    thread::{self, JoinHandle},
};

use cotorra_graph::{NodeId, SensorId, Testbed};
use cotorra_measurements::{LargeDataWriter, StoredData, WantedData, read_large_data};
use cotorra_recording::Pace;
use cotorra_robot_middleware::SensedData;
use parking_lot::{Condvar, Mutex};

/// Readings that wait, at most, and their bytes; one that is larger waits alone.
const WAITING: usize = 1024;
const WAITING_BYTES: u64 = 64 << 20;

/// How many bytes are kept of each sensor with large data.
type Keep = BTreeMap<(NodeId, SensorId), u64>;

/// A run whose large data is kept.
pub(crate) struct Keeping {
    keeper: Keeper,
    thread: Option<JoinHandle<()>>,
}

/// Takes large data, and gives back what is kept. Clones may be used from any thread.
#[derive(Clone)]
pub(crate) struct Keeper(Arc<Shared>);

struct Shared {
    folder: PathBuf,
    pace: Pace,
    queue: Mutex<Queue>,
    changed: Condvar,
}

#[derive(Default)]
struct Queue {
    /// The first may be being written.
    waiting: VecDeque<Arc<SensedData>>,
    bytes: u64,
    is_closing: bool,
    /// Readings that are not kept, and why the first is not.
    lost: u64,
    why: Option<String>,
}

impl Queue {
    fn has_room(&self, bytes: u64) -> bool {
        let has_room = self.waiting.len() < WAITING && self.bytes.saturating_add(bytes) <= WAITING_BYTES;
        has_room || self.waiting.is_empty()
    }

    fn lose(&mut self, why: impl FnOnce() -> String) {
        self.lost += 1;
        self.why.get_or_insert_with(|| {
            let why = why();
            tracing::error!("the run goes on, but not all large data of sensors is kept: {why}");
            why
        });
    }
}

impl Keeping {
    /// Begins in a run's folder; `None` if no sensor has large data.
    pub(crate) fn begin(testbed: &Testbed, folder: &Path, pace: Pace) -> io::Result<Option<Self>> {
        let sensors = testbed.graph.robots().flat_map(|(node, robot)| {
            let kept = |sensor: &cotorra_graph::Sensor| {
                Some(((node.id.clone(), sensor.id.clone()), sensor.kind.keep_bytes()?))
            };
            robot.sensors.iter().filter_map(kept).collect::<Vec<_>>()
        });
        let keep: Keep = sensors.collect();
        if keep.is_empty() {
            return Ok(None);
        }
        let mut keeping = Self { keeper: Keeper::of_folder(folder, pace), thread: None };
        let keeper = keeping.keeper.clone();
        let thread = thread::Builder::new().name("sensors".to_owned()).spawn(move || keeper.write(&keep))?;
        keeping.thread = Some(thread);
        Ok(Some(keeping))
    }

    /// What takes large data, and gives it back.
    pub(crate) fn keeper(&self) -> Keeper {
        self.keeper.clone()
    }

    /// Writes what waits; says what is not kept, if anything is not.
    pub(crate) fn finish(mut self) -> Option<String> {
        self.join();
        let queue = self.keeper.0.queue.lock();
        let why = queue.why.as_ref()?;
        Some(format!("{} readings of sensors with large data are not kept: {why}", queue.lost))
    }

    fn join(&mut self) {
        let Some(thread) = self.thread.take() else { return };
        self.keeper.0.queue.lock().is_closing = true;
        self.keeper.0.changed.notify_all();
        let _ = thread.join();
    }
}

impl Drop for Keeping {
    fn drop(&mut self) {
        self.join();
    }
}

impl Keeper {
    /// What a folder has, to which nothing is written as long as nobody does.
    pub(crate) fn of_folder(folder: &Path, pace: Pace) -> Self {
        let folder = folder.to_owned();
        Self(Arc::new(Shared { folder, pace, queue: Mutex::default(), changed: Condvar::new() }))
    }

    /// Takes large data; it can be read from now on.
    pub(crate) fn keep(&self, data: SensedData) {
        let bytes = data.data.bytes;
        let mut queue = self.0.queue.lock();
        while self.0.pace == Pace::Waiting && !queue.has_room(bytes) {
            self.0.changed.wait(&mut queue);
        }
        if queue.has_room(bytes) {
            queue.bytes += bytes;
            queue.waiting.push_back(Arc::new(data));
            drop(queue);
            self.0.changed.notify_all();
        } else {
            queue.lose(|| "they came faster than they could be written".to_owned());
        }
    }

    /// Reads large data of a sensor; `None` if it is not there, or not any more.
    ///
    /// # Errors
    /// When the system cannot read it.
    pub(crate) fn read(
        &self,
        robot: &NodeId,
        sensor: &SensorId,
        wanted: WantedData,
    ) -> io::Result<Option<StoredData>> {
        let mut queue = self.0.queue.lock();
        // What was deleted does not depend on how fast that was.
        while self.0.pace == Pace::Waiting && !queue.waiting.is_empty() {
            self.0.changed.wait(&mut queue);
        }
        let is_wanted = |one: &&Arc<SensedData>| {
            let is_number = match wanted {
                WantedData::Number(number) => one.data.sequence == number,
                WantedData::UpTo(number) => one.data.sequence <= number,
            };
            is_number && one.robot == *robot && one.sensor == *sensor
        };
        let waits = queue.waiting.iter().rev().find(is_wanted).cloned();
        drop(queue);
        match waits {
            Some(one) => {
                let SensedData { measured, data, .. } = *one;
                Ok(Some(StoredData { measured, data, bytes: one.content.bytes().to_vec() }))
            }
            None => read_large_data(&self.0.folder, robot, sensor, wanted),
        }
    }

    /// Writes what comes, until nothing more does.
    fn write(&self, keep: &Keep) {
        let mut writers = BTreeMap::new();
        let mut queue = self.0.queue.lock();
        loop {
            let Some(one) = queue.waiting.front().map(Arc::clone) else {
                if queue.is_closing {
                    return;
                }
                self.0.changed.wait(&mut queue);
                continue;
            };
            drop(queue);
            let of = (one.robot.clone(), one.sensor.clone());
            let keep = keep.get(&of).copied().unwrap_or_default();
            let writer = writers
                .entry(of)
                .or_insert_with(|| LargeDataWriter::new(&self.0.folder, &one.robot, &one.sensor, keep));
            // Virtual time waits for this thread: it goes on, come what may.
            let written = catch_unwind(AssertUnwindSafe(|| {
                let bytes = one.content.bytes();
                writer.append(&StoredData { measured: one.measured, data: one.data, bytes: &bytes[..] })
            }));
            let written =
                written.unwrap_or_else(|_| Err(io::Error::other("a panic, please report it as a bug")));
            queue = self.0.queue.lock();
            queue.waiting.pop_front();
            queue.bytes -= one.data.bytes;
            if let Err(error) = written {
                queue.lose(|| format!("sensor {} of robot {}: {error}", one.sensor, one.robot));
            }
            self.0.changed.notify_all();
        }
    }
}

#[cfg(test)]
mod tests;
