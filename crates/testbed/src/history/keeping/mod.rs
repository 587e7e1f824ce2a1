//! Stores large data of sensors in the run's folder, on a thread that encodes and writes it.
//!
//! In real time the run never waits: data without room in the queue is lost and counted. In virtual time the run waits, so
//! that nothing is lost.

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

/// Limits of the queue, readings and bytes. A larger reading waits alone.
const WAITING: usize = 1024;
const WAITING_BYTES: u64 = 64 << 20;

/// Bytes to keep of each sensor with large data.
type Keep = BTreeMap<(NodeId, SensorId), u64>;

/// The storage of a run's large data.
pub(crate) struct Keeping {
    keeper: Keeper,
    thread: Option<JoinHandle<()>>,
}

/// Handle to store and read large data. Clones can be used from any thread.
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
    /// The first may be in the course of being written.
    waiting: VecDeque<Arc<SensedData>>,
    bytes: u64,
    is_closing: bool,
    /// Number of lost readings, and the reason of the first loss.
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
    /// Starts storing in a run's folder; `None` if no sensor has large data.
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

    /// Returns a handle.
    pub(crate) fn keeper(&self) -> Keeper {
        self.keeper.clone()
    }

    /// Writes the rest of the queue. Returns a notice if data was lost.
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
    /// Creates a handle to a folder without a writing thread.
    pub(crate) fn of_folder(folder: &Path, pace: Pace) -> Self {
        let folder = folder.to_owned();
        Self(Arc::new(Shared { folder, pace, queue: Mutex::default(), changed: Condvar::new() }))
    }

    /// Queues large data, which can be read from now on.
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

    /// Reads large data of a sensor; `None` if it does not exist, or no longer.
    ///
    /// # Errors
    /// [`io::Error`] if the file cannot be read.
    pub(crate) fn read(
        &self,
        robot: &NodeId,
        sensor: &SensorId,
        wanted: WantedData,
    ) -> io::Result<Option<StoredData>> {
        let mut queue = self.0.queue.lock();
        // With an empty queue, the result does not depend on the speed of writing.
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

    /// Writes the queue until it is closed and empty.
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
            // Virtual time waits for this thread, so that a panic must not end it.
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
