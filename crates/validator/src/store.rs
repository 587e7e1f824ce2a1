//! What a validator keeps on its disk: the blocks that are final with the signatures that made them so, and its notes of the
//! height that is being decided. One line of JSON each; a line that was being written when the power went is no line.

use std::{
    fs::{File, OpenOptions},
    io::{self, BufRead, BufReader, Read, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
};

use serde::{Serialize, de::DeserializeOwned};

use crate::wire::{Decided, Note};

/// Why the files of a validator are of no use.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// A file cannot be read or written.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Why not.
        reason: io::Error,
    },
    /// A line is not what a validator writes.
    #[error("{}, line {line}: {reason}; the file is damaged, or of another version", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// The line, the first being 1.
        line: usize,
        /// What is wrong.
        reason: String,
    },
    /// Another process has it.
    #[error("{} is being used by another validator", path.display())]
    Locked {
        /// The file.
        path: PathBuf,
    },
}

/// Lines that are only ever added to.
struct Log {
    path: PathBuf,
    file: File,
    /// Where each line begins, and where the next one will.
    starts: Vec<u64>,
}

impl Log {
    /// Opens it, and reads what it has.
    fn open<T: DeserializeOwned>(
        path: PathBuf,
        mut each: impl FnMut(T) -> Result<(), String>,
    ) -> Result<Self, StoreError> {
        let failed = |reason| StoreError::File { path: path.clone(), reason };
        let file = OpenOptions::new().create(true).read(true).append(true).open(&path).map_err(failed)?;
        if file.try_lock().is_err() {
            return Err(StoreError::Locked { path });
        }
        let mut starts = vec![0];
        let mut reader = BufReader::new(&file);
        let mut line = Vec::new();
        loop {
            line.clear();
            let length = reader.read_until(b'\n', &mut line).map_err(failed)?;
            if line.last() != Some(&b'\n') {
                break;
            }
            let damaged =
                |reason: String| StoreError::Line { path: path.clone(), line: starts.len(), reason };
            let item = serde_json::from_slice(&line).map_err(|reason| damaged(reason.to_string()))?;
            each(item).map_err(damaged)?;
            starts.push(starts[starts.len() - 1] + length as u64);
        }
        file.set_len(starts[starts.len() - 1]).map_err(failed)?;
        Ok(Self { path, file, starts })
    }

    fn append(&mut self, item: &impl Serialize) -> Result<(), StoreError> {
        let mut line = serde_json::to_vec(item).expect("it has no maps");
        line.push(b'\n');
        self.file.write_all(&line).map_err(|reason| StoreError::File { path: self.path.clone(), reason })?;
        self.starts.push(self.starts[self.starts.len() - 1] + line.len() as u64);
        Ok(())
    }

    fn sync(&mut self) -> Result<(), StoreError> {
        self.file.sync_data().map_err(|reason| StoreError::File { path: self.path.clone(), reason })
    }

    fn read<T: DeserializeOwned>(&mut self, index: usize) -> Result<Option<T>, StoreError> {
        let (Some(start), Some(end)) = (self.starts.get(index), self.starts.get(index + 1)) else {
            return Ok(None);
        };
        let mut line = vec![0; (end - start) as usize];
        let read = self.file.seek(SeekFrom::Start(*start)).and_then(|_| self.file.read_exact(&mut line));
        read.map_err(|reason| StoreError::File { path: self.path.clone(), reason })?;
        let damaged = |reason: serde_json::Error| StoreError::Line {
            path: self.path.clone(),
            line: index + 1,
            reason: reason.to_string(),
        };
        serde_json::from_slice(&line).map(Some).map_err(damaged)
    }
}

/// The blocks that are final, from the first on.
pub(crate) struct Blocks(Log);

impl Blocks {
    pub(crate) fn open(folder: &Path) -> Result<Self, StoreError> {
        let mut next = 1;
        Log::open(folder.join("blocks.jsonl"), |decided: Decided| {
            let height = decided.height().0;
            if height != next {
                return Err(format!("block {next} is to be here, not block {height}"));
            }
            next += 1;
            Ok(())
        })
        .map(Self)
    }

    /// How many there are: the number of the last.
    pub(crate) fn len(&self) -> u64 {
        self.0.starts.len() as u64 - 1
    }

    /// The block with that number.
    pub(crate) fn read(&mut self, number: u64) -> Result<Option<Decided>, StoreError> {
        let Some(index) = number.checked_sub(1).and_then(|index| usize::try_from(index).ok()) else {
            return Ok(None);
        };
        self.0.read(index)
    }

    /// Adds the next one, and returns when it is on the disk.
    pub(crate) fn append(&mut self, decided: &Decided) -> Result<(), StoreError> {
        assert_eq!(decided.height().0, self.len() + 1, "blocks are decided one after the other");
        self.0.append(decided)?;
        self.0.sync()
    }
}

/// The notes of the height that is being decided.
pub(crate) struct Notes {
    log: Log,
    is_on_disk: bool,
}

impl Notes {
    /// Opens them; returns what was noted.
    pub(crate) fn open(folder: &Path) -> Result<(Self, Vec<Note>), StoreError> {
        let mut notes = Vec::new();
        let log = Log::open(folder.join("notes.jsonl"), |note| {
            notes.push(note);
            Ok(())
        })?;
        Ok((Self { log, is_on_disk: true }, notes))
    }

    pub(crate) fn append(&mut self, note: &Note) -> Result<(), StoreError> {
        self.is_on_disk = false;
        self.log.append(note)
    }

    /// Returns when all is on the disk.
    pub(crate) fn sync(&mut self) -> Result<(), StoreError> {
        if !self.is_on_disk {
            self.log.sync()?;
            self.is_on_disk = true;
        }
        Ok(())
    }

    /// Forgets them.
    pub(crate) fn clear(&mut self) -> Result<(), StoreError> {
        self.log
            .file
            .set_len(0)
            .map_err(|reason| StoreError::File { path: self.log.path.clone(), reason })?;
        self.log.starts.truncate(1);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::block::tests::{GENESIS, block};

    fn note(round: u32) -> Note {
        Note::Block {
            height: crate::context::Height(1),
            round,
            block: block(&GENESIS, 1_001, &[round as u8]),
        }
    }

    #[test]
    fn notes_are_there_again_but_for_a_torn_one() {
        let folder = tempfile::tempdir().unwrap();
        let (mut notes, noted) = Notes::open(folder.path()).unwrap();
        assert_eq!(noted, []);
        notes.append(&note(0)).unwrap();
        notes.append(&note(1)).unwrap();
        notes.sync().unwrap();
        assert!(matches!(Notes::open(folder.path()), Err(StoreError::Locked { .. })));
        drop(notes);
        let path = folder.path().join("notes.jsonl");
        let length = fs::metadata(&path).unwrap().len();
        OpenOptions::new().write(true).open(&path).unwrap().set_len(length - 1).unwrap();
        let (mut notes, noted) = Notes::open(folder.path()).unwrap();
        assert_eq!(noted, [note(0)]);
        notes.append(&note(2)).unwrap();
        drop(notes);
        let (mut notes, noted) = Notes::open(folder.path()).unwrap();
        assert_eq!(noted, [note(0), note(2)]);
        notes.clear().unwrap();
        drop(notes);
        assert_eq!(Notes::open(folder.path()).unwrap().1, []);
    }

    #[test]
    fn blocks_are_read_by_number_and_damage_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let mut blocks = Blocks::open(folder.path()).unwrap();
        let mut position = GENESIS;
        let mut decided = Vec::new();
        for number in 0..3 {
            let next: Decided = serde_json::from_value(serde_json::json!({
                "round": number, "signatures": [], "block": block(&position, 2_000 + number, b"")
            }))
            .unwrap();
            position = next.block.position();
            blocks.append(&next).unwrap();
            decided.push(next);
        }
        for at in [2, 0, 1] {
            assert_eq!(blocks.read(at as u64 + 1).unwrap().as_ref(), Some(&decided[at]));
        }
        assert_eq!(blocks.read(0).unwrap(), None);
        assert_eq!(blocks.read(4).unwrap(), None);
        assert_eq!(blocks.read(u64::MAX).unwrap(), None);
        drop(blocks);
        assert_eq!(Blocks::open(folder.path()).unwrap().len(), 3);
        let path = folder.path().join("blocks.jsonl");
        let text = fs::read_to_string(&path).unwrap();
        let without_the_second: String = text.lines().step_by(2).map(|line| format!("{line}\n")).collect();
        fs::write(&path, without_the_second).unwrap();
        let error = Blocks::open(folder.path()).err().unwrap().to_string();
        assert!(error.contains("line 2: block 2 is to be here, not block 3"), "{error}");
    }
}
