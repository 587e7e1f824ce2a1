//! Exports a run from its history to an MCAP file.

use std::{path::Path, sync::Arc};

use cotorra_graph::{Stamped, Testbed};

use crate::{
    encoder::Encoder,
    mcap_file::{About, McapFile},
    sink::{RecordingError, Sink},
};

/// Writes events, in the order of time, to a file. It has everything of a recording but scans, which no history keeps.
pub struct Export {
    encoder: Encoder,
    file: McapFile,
}

impl Export {
    /// Creates the file.
    ///
    /// # Errors
    /// [`RecordingError`] if it exists already or cannot be created.
    pub fn create(path: &Path, testbed: Arc<Testbed>, about: About<'_>) -> Result<Self, RecordingError> {
        let mut export = Self { encoder: Encoder::new(testbed), file: McapFile::create(path, about)? };
        export.write(|encoder, out| encoder.begin(out))?;
        Ok(export)
    }

    /// Writes an event.
    ///
    /// # Errors
    /// [`RecordingError`] if the file cannot be written.
    pub fn event(&mut self, event: &Stamped) -> Result<(), RecordingError> {
        self.write(|encoder, out| encoder.event(event, out))
    }

    /// Finishes the file.
    ///
    /// # Errors
    /// [`RecordingError`] if the file may be incomplete.
    pub fn finish(mut self) -> Result<(), RecordingError> {
        self.file.finish()
    }

    fn write(
        &mut self,
        encode: impl FnOnce(&mut Encoder, &mut dyn FnMut(crate::Encoded<'_>)),
    ) -> Result<(), RecordingError> {
        let (file, mut written) = (&mut self.file, Ok(()));
        encode(&mut self.encoder, &mut |message| {
            if written.is_ok() {
                written = file.write(&message);
            }
        });
        written
    }
}
