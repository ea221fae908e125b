//! A byte stream to the world (a serial line) that gives the same bytes in the same window under both clocks.

use std::io::{self, ErrorKind, Read, Write};
use std::os::fd::AsFd;
use std::sync::atomic::Ordering::Relaxed;

use bateleur_contract::page::NOT_COUNTED;

use crate::time::Time;
use crate::window::Window;

/// A device that is read without blocking, with its bytes counted.
///
/// Under the virtual clock the executive knows how many bytes the world has sent; `receive` waits for all of them,
/// because the kernel may still be carrying them when a window begins. On the wall clock it takes what is there.
#[derive(Debug)]
pub struct Line<D> {
    device: D,
    time: Time,
}

impl<D: Read + Write + AsFd> Line<D> {
    pub(crate) fn new(device: D, time: Time) -> Self {
        Self { device, time }
    }

    /// Goes on over another device, because the one before is gone. What was received stays counted.
    pub fn replace(&mut self, device: D) {
        self.device = device;
    }

    /// Appends what has arrived to `out`, at most `limit` bytes. An error means that the device is gone.
    pub fn receive(&mut self, window: &Window, out: &mut Vec<u8>, limit: usize) -> io::Result<()> {
        let time = self.time.clone();
        let received = &time.page().device_received;
        let expected = match time.page().device_expected.load(Relaxed) {
            NOT_COUNTED => 0,
            expected => expected,
        };
        let mut buffer = [0; 1024];
        let end = out.len() + limit;
        while out.len() < end {
            let room = buffer.len().min(end - out.len());
            match self.device.read(&mut buffer[..room]) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(count) => {
                    out.extend_from_slice(&buffer[..count]);
                    received.fetch_add(count as u64, Relaxed);
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if is_empty(&error) => {
                    if received.load(Relaxed) >= expected {
                        return Ok(());
                    }
                    if !window.wait_readable(&self.device, window.end_ns()) {
                        // Lost on a device that was closed meanwhile: waited for once, not in every window.
                        received.store(expected, Relaxed);
                        return Ok(());
                    }
                }
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Sends as much of `bytes` as the device takes at once; gives how much that was.
    pub fn send(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut sent = 0;
        while sent < bytes.len() {
            match self.device.write(&bytes[sent..]) {
                Ok(0) => break,
                Ok(count) => sent += count,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if is_empty(&error) => break,
                Err(error) => return Err(error),
            }
        }
        self.time.page().device_sent.fetch_add(sent as u64, Relaxed);
        Ok(sent)
    }
}

fn is_empty(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut)
}
