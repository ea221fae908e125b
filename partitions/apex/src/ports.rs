//! Sampling and queuing ports: typed ends of the module's channels.
//!
//! Reading a sampling port gives the latest value, its age and its validity, again and again; a value outlives its
//! writer. A queuing port gives each message once, in order. Neither end ever blocks: a dead or frozen peer costs
//! nothing. A value is readable as soon as it is written.

use std::marker::PhantomData;
use std::rc::Rc;
use std::sync::atomic::Ordering::Relaxed;

use bateleur_contract::ReportKind;
use bateleur_messages::Message;
use bateleur_ports::{Reader, Received, Stamp, Writer};
use iceoryx2::port::update_connections::UpdateConnections;

use crate::time::Time;

/// Part of a port that must be connected before the first window: doing it there would cost 0.1–0.4 ms.
pub(crate) trait Connect {
    fn connect(&self);
}

impl Connect for Writer {
    fn connect(&self) {
        let _ = self.update_connections(); // a peer that fails now is met again at the next send
    }
}

impl Connect for Reader {
    fn connect(&self) {
        let _ = self.has_samples(); // as above
    }
}

/// What `read` of a sampling port gives.
#[derive(Debug)]
pub struct Reading<'a, T> {
    /// The latest value, in shared memory.
    pub value: &'a T,
    /// How long ago its source wrote it, ns.
    pub age_ns: u64,
    /// The age is within the port's refresh period.
    pub valid: bool,
    /// This port had not read this value before.
    pub updated: bool,
    /// The source's count of its messages.
    pub sequence: u64,
}

/// What `send` of a queuing port did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sent {
    /// In the queue.
    Queued,
    /// The queue is full; nothing was sent.
    Full,
    /// Nobody is there to receive; nothing was sent.
    NoReceiver,
}

/// The writing end of a sampling channel. A port without a channel swallows what is written.
pub struct SamplingSource<T> {
    writer: Option<Rc<Writer>>,
    time: Time,
    sequence: u64,
    message: PhantomData<T>,
}

impl<T: Message> SamplingSource<T> {
    pub(crate) fn new(writer: Option<Rc<Writer>>, time: Time) -> Self {
        Self { writer, time, sequence: 0, message: PhantomData }
    }

    /// Replaces the channel's value.
    pub fn write(&mut self, value: &T) {
        self.sequence += 1;
        let stamp = Stamp { source_ns: self.time.now_ns(), sequence: self.sequence };
        if let Some(writer) = &self.writer
            && let Err(reason) = put(writer, value.as_bytes(), stamp)
        {
            refused(&self.time, &format!("cannot write {}: {reason}", T::NAME));
        }
    }
}

/// The reading end of a sampling channel.
pub struct SamplingDestination<T> {
    reader: Option<Rc<Reader>>,
    latest: Option<Received>,
    updated: bool,
    refresh_ns: u64,
    time: Time,
    message: PhantomData<T>,
}

/// At most this many messages wait in a sampling port: one of a dead source, one of its successor. Then it is empty,
/// so that reading takes a bounded time whatever the writer does.
const WAITING_AT_MOST: usize = 3;

impl<T: Message> SamplingDestination<T> {
    pub(crate) fn new(reader: Option<Rc<Reader>>, refresh_ns: u64, time: Time) -> Self {
        Self { reader, latest: None, updated: false, refresh_ns, time, message: PhantomData }
    }

    /// The latest value, as often as it is asked for; nothing before the first.
    pub fn read(&mut self) -> Option<Reading<'_, T>> {
        self.take_latest();
        let latest = self.latest.as_ref()?;
        let stamp = *latest.user_header();
        let value = T::ref_from_bytes(latest.payload()).ok()?;
        let age_ns = self.time.now_ns().saturating_sub(stamp.source_ns);
        let updated = std::mem::take(&mut self.updated);
        Some(Reading { value, age_ns, valid: age_ns <= self.refresh_ns, updated, sequence: stamp.sequence })
    }

    /// The latest value if it is valid.
    pub fn read_valid(&mut self) -> Option<&T> {
        self.read().filter(|reading| reading.valid).map(|reading| reading.value)
    }

    /// The latest value if it is valid and was not read before.
    pub fn read_updated(&mut self) -> Option<&T> {
        self.read().filter(|reading| reading.valid && reading.updated).map(|reading| reading.value)
    }

    fn take_latest(&mut self) {
        let Some(reader) = &self.reader else { return };
        for _ in 0..WAITING_AT_MOST {
            match reader.receive() {
                Ok(Some(received)) if received.payload().len() == size_of::<T>() => {
                    self.latest = Some(received);
                    self.updated = true;
                }
                Ok(Some(received)) => {
                    let found = received.payload().len();
                    refused(
                        &self.time,
                        &format!("{} of {found} bytes where {} belong", T::NAME, size_of::<T>()),
                    );
                }
                Ok(None) => return,
                Err(error) => return refused(&self.time, &format!("cannot read {}: {error:?}", T::NAME)),
            }
        }
    }
}

/// The writing end of a queuing channel. A port without a channel reports that nobody receives.
pub struct QueuingSource<T> {
    writer: Option<Rc<Writer>>,
    observed: Option<Rc<Writer>>,
    time: Time,
    sequence: u64,
    message: PhantomData<T>,
}

impl<T: Message> QueuingSource<T> {
    pub(crate) fn new(writer: Option<Rc<Writer>>, observed: Option<Rc<Writer>>, time: Time) -> Self {
        Self { writer, observed, time, sequence: 0, message: PhantomData }
    }

    /// Appends a message.
    pub fn send(&mut self, message: &T) -> Sent {
        let stamp = Stamp { source_ns: self.time.now_ns(), sequence: self.sequence + 1 };
        let Some(writer) = &self.writer else { return Sent::NoReceiver };
        let sent = match put(writer, message.as_bytes(), stamp) {
            Ok(0) => Sent::NoReceiver,
            Ok(_) => Sent::Queued,
            Err(Refusal::Full) => Sent::Full,
            Err(reason) => {
                refused(&self.time, &format!("cannot send {}: {reason}", T::NAME));
                Sent::NoReceiver
            }
        };
        if sent == Sent::Queued {
            self.sequence += 1;
            if let Some(observed) = &self.observed {
                let _ = put(observed, message.as_bytes(), stamp); // an observer's loss is no fault
            }
        } else {
            self.time.page().port_refusals.fetch_add(1, Relaxed);
        }
        sent
    }
}

/// The reading end of a queuing channel.
pub struct QueuingDestination<T> {
    reader: Option<Rc<Reader>>,
    time: Time,
    message: PhantomData<T>,
}

impl<T: Message> QueuingDestination<T> {
    pub(crate) fn new(reader: Option<Rc<Reader>>, time: Time) -> Self {
        Self { reader, time, message: PhantomData }
    }

    /// Takes the oldest message.
    pub fn receive(&mut self) -> Option<T> {
        match self.reader.as_ref()?.receive() {
            Ok(received) => T::read_from_bytes(received?.payload()).ok(),
            Err(error) => {
                refused(&self.time, &format!("cannot receive {}: {error:?}", T::NAME));
                None
            }
        }
    }
}

enum Refusal {
    Full,
    Other(String),
}

impl std::fmt::Display for Refusal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Full => f.write_str("the queue is full"),
            Self::Other(reason) => f.write_str(reason),
        }
    }
}

fn put(writer: &Writer, bytes: &[u8], stamp: Stamp) -> Result<usize, Refusal> {
    use iceoryx2::port::SendError;
    let mut sample =
        writer.loan_slice_uninit(bytes.len()).map_err(|error| Refusal::Other(format!("{error:?}")))?;
    *sample.user_header_mut() = stamp;
    sample.write_from_slice(bytes).send().map_err(|error| match error {
        SendError::UnableToDeliver => Refusal::Full,
        other => Refusal::Other(format!("{other:?}")),
    })
}

fn refused(time: &Time, what: &str) {
    time.page().port_refusals.fetch_add(1, Relaxed);
    time.page().report(ReportKind::PortError, what);
}
