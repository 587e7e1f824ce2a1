//! A run that was recorded in a history, as an MCAP file afterwards.

use std::{path::Path, sync::Arc};

use cotorra_graph::{Stamped, Testbed};

use crate::{
    encoder::Encoder,
    mcap_file::{About, McapFile},
    sink::{RecordingError, Sink},
};

/// Writes events, in the order of time, into a file. It has all that a recording has but scans, which no history keeps.
pub struct Export {
    encoder: Encoder,
    file: McapFile,
}

impl Export {
    /// Makes the file.
    ///
    /// # Errors
    /// [`RecordingError`] if there is one already or it cannot be made.
    pub fn create(path: &Path, testbed: Arc<Testbed>, about: About<'_>) -> Result<Self, RecordingError> {
        let mut export = Self { encoder: Encoder::new(testbed), file: McapFile::create(path, about)? };
        export.write(|encoder, out| encoder.begin(out))?;
        Ok(export)
    }

    /// Writes what happened.
    ///
    /// # Errors
    /// [`RecordingError`] if the file cannot be written.
    pub fn event(&mut self, event: &Stamped) -> Result<(), RecordingError> {
        self.write(|encoder, out| encoder.event(event, out))
    }

    /// Ends the file.
    ///
    /// # Errors
    /// [`RecordingError`] if it may not be complete.
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
