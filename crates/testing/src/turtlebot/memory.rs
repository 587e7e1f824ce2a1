//! A serial port in memory, for devices in virtual time.

use std::{
    io::{self, ErrorKind, Read, Write},
    sync::Arc,
};

use parking_lot::Mutex;

/// A port in memory: what each end wrote and the other did not read.
#[derive(Clone, Default)]
pub struct Memory(Arc<Mutex<(Vec<u8>, Vec<u8>)>>);

impl Memory {
    /// Passes bytes to the driver, and returns those that it wrote.
    pub fn exchange(&self, bytes: Vec<u8>) -> Vec<u8> {
        let (arrived, written) = &mut *self.0.lock();
        arrived.extend(bytes);
        std::mem::take(written)
    }
}

impl Read for Memory {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let (arrived, _) = &mut *self.0.lock();
        let read = arrived.len().min(buffer.len());
        buffer[..read].copy_from_slice(&arrived[..read]);
        arrived.drain(..read);
        if read == 0 { Err(ErrorKind::WouldBlock.into()) } else { Ok(read) }
    }
}

impl Write for Memory {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().1.extend(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
