//! Sampling and queuing ports: typed ends of the module's channels.
//!
//! Reading a sampling port gives the latest value, its age and its validity, again and again; a value outlives its
//! writer. A queuing port gives each message once, in order. Neither end ever blocks: a dead or frozen peer costs
//! nothing. A value is readable as soon as it is written.

use std::cell::OnceCell;
use std::marker::PhantomData;
use std::rc::Rc;
use std::sync::atomic::Ordering::Relaxed;

use bateleur_contract::ReportKind;
use bateleur_message_format::Message;
use bateleur_ports::{Channel, ChannelError, ChannelType, Reader, Received, Refusal, Stamp, Writer};

use crate::faults::{Fate, PortFault};
use crate::time::Time;

/// Part of a port that must be connected before the first window: doing it there would cost 0.1–0.4 ms.
pub(crate) trait Connect {
    fn connect(&self);
}

impl Connect for Writer {
    fn connect(&self) {
        let _ = Writer::connect(self); // a peer that fails now is met again at the next send
    }
}

impl Connect for Reader {
    fn connect(&self) {
        let _ = Reader::connect(self); // as above
    }
}

/// Where a queue comes in. One that stands by attaches itself when it takes over: nobody would take what waits for it, and
/// once it were full its source could send nothing any more.
pub(crate) struct Inlet {
    pub(crate) reader: OnceCell<Reader>,
    kind: ChannelType,
    channel: Channel,
}

impl Inlet {
    pub(crate) fn new(kind: ChannelType, channel: Channel) -> Self {
        Self { reader: OnceCell::new(), kind, channel }
    }

    /// Receives from now on.
    pub(crate) fn attach(&self) -> Result<(), ChannelError> {
        if self.reader.get().is_none() {
            let _ = self.reader.set(self.kind.reader(&self.channel)?); // it was not set: one thread
        }
        Ok(())
    }
}

impl Connect for Inlet {
    fn connect(&self) {
        self.reader.get().iter().for_each(|reader| Connect::connect(*reader));
    }
}

/// What `read` of a sampling port gives.
#[derive(Debug)]
pub struct Reading<'a, T> {
    /// The latest value, in memory that nobody changes as long as it is looked at.
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

/// Where the messages of a source port leave the partition, and where an ordered fault meets them.
pub(crate) struct Outlet {
    writer: Rc<Writer>,
    /// A queue's channel for observers.
    observed: Option<Rc<Writer>>,
    pub(crate) fault: Rc<PortFault>,
}

impl Outlet {
    pub(crate) fn new(writer: Rc<Writer>, observed: Option<Rc<Writer>>) -> Self {
        Self { writer, observed, fault: Rc::default() }
    }

    /// Gives the number of receivers; a message that an ordered fault withholds has been received, as far as its sender can
    /// tell.
    pub(crate) fn put(&self, bytes: &[u8], stamp: Stamp, now_ns: u64) -> Result<usize, Refusal> {
        match self.fault.meet(bytes, stamp, now_ns) {
            Fate::Pass => self.send(bytes, stamp),
            Fate::Replace(bytes) => self.send(&bytes, stamp),
            Fate::Withhold => Ok(1),
        }
    }

    /// As [`Outlet::put`], without a copy where no fault waits for the message.
    fn put_in_place<T: Message>(&self, fill: impl FnOnce(&mut T), stamp: Stamp) -> Result<usize, Refusal> {
        if self.fault.is_idle() {
            return put_in_place(&self.writer, fill, stamp);
        }
        let mut value = T::new_zeroed();
        fill(&mut value);
        self.put(value.as_bytes(), stamp, stamp.source_ns)
    }

    /// Sends what was kept back and is due now.
    pub(crate) fn catch_up(&self, now_ns: u64) {
        while let Some(kept) = self.fault.next_due(now_ns) {
            let _ = self.send(&kept.bytes, kept.stamp); // lost, as a late message may be
        }
    }

    fn send(&self, bytes: &[u8], stamp: Stamp) -> Result<usize, Refusal> {
        let receivers = self.writer.put(bytes, stamp)?;
        if let Some(observed) = self.observed.as_ref().filter(|_| receivers > 0) {
            let _ = observed.put(bytes, stamp); // an observer's loss is no fault
        }
        Ok(receivers)
    }
}

/// The writing end of a sampling channel. A port without a channel swallows what is written.
pub struct SamplingSource<T> {
    pub(crate) outlet: Option<Rc<Outlet>>,
    time: Time,
    sequence: u64,
    message: PhantomData<T>,
}

impl<T: Message> SamplingSource<T> {
    /// A port on a writing end that the caller opened: for measuring. A partition asks its [`crate::Context`].
    pub fn new(writer: Option<Rc<Writer>>, time: Time) -> Self {
        Self::through(writer.map(|writer| Rc::new(Outlet::new(writer, None))), time)
    }

    pub(crate) fn through(outlet: Option<Rc<Outlet>>, time: Time) -> Self {
        Self { outlet, time, sequence: 0, message: PhantomData }
    }

    /// Replaces the channel's value.
    pub fn write(&mut self, value: &T) {
        self.sequence += 1;
        let stamp = Stamp { source_ns: self.time.now_ns(), sequence: self.sequence };
        if let Some(outlet) = &self.outlet
            && let Err(reason) = outlet.put(value.as_bytes(), stamp, stamp.source_ns)
        {
            refused(&self.time, &format!("cannot write {}: {reason}", T::NAME));
        }
    }

    /// Replaces the channel's value by what `fill` makes of a message in shared memory: nothing is copied, so that the
    /// size of `T` does not matter. The message holds what an earlier one left there: `fill` sets every field.
    pub fn write_in_place(&mut self, fill: impl FnOnce(&mut T)) {
        self.sequence += 1;
        let stamp = Stamp { source_ns: self.time.now_ns(), sequence: self.sequence };
        if let Some(outlet) = &self.outlet
            && let Err(reason) = outlet.put_in_place(fill, stamp)
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
pub(crate) const WAITING_AT_MOST: usize = 3;

impl<T: Message> SamplingDestination<T> {
    /// A port on a reading end that the caller opened: for measuring. A partition asks its [`crate::Context`].
    pub fn new(reader: Option<Rc<Reader>>, refresh_ns: u64, time: Time) -> Self {
        Self { reader, latest: None, updated: false, refresh_ns, time, message: PhantomData }
    }

    /// The latest value, as often as it is asked for; nothing before the first.
    pub fn read(&mut self) -> Option<Reading<'_, T>> {
        let now_ns = self.time.now_ns();
        self.take_latest(now_ns);
        let latest = self.latest.as_ref()?;
        let stamp = latest.stamp();
        let value = T::ref_from_bytes(latest.payload()).ok()?;
        let age_ns = now_ns.saturating_sub(stamp.source_ns);
        let (valid, updated) = (self.is_valid(&stamp, now_ns), std::mem::take(&mut self.updated));
        Some(Reading { value, age_ns, valid, updated, sequence: stamp.sequence })
    }

    /// A stamp of the future is nothing that a source writes: its value must not be valid until then.
    fn is_valid(&self, stamp: &Stamp, now_ns: u64) -> bool {
        now_ns.abs_diff(stamp.source_ns) <= self.refresh_ns
    }

    /// The latest value if it is valid.
    pub fn read_valid(&mut self) -> Option<&T> {
        self.read().filter(|reading| reading.valid).map(|reading| reading.value)
    }

    /// The latest value if it is valid and was not read before.
    pub fn read_updated(&mut self) -> Option<&T> {
        self.read().filter(|reading| reading.valid && reading.updated).map(|reading| reading.value)
    }

    fn take_latest(&mut self, now_ns: u64) {
        let Some(reader) = &self.reader else { return };
        for _ in 0..WAITING_AT_MOST {
            match reader.receive() {
                Ok(Some(received)) if received.payload().len() == size_of::<T>() => {
                    let is_last = self.leaves_nothing_newer(&received, now_ns);
                    self.latest = Some(received);
                    self.updated = true;
                    if is_last {
                        return;
                    }
                }
                Ok(Some(received)) => {
                    refused_length::<T>(&self.time, received.payload().len());
                }
                Ok(None) => return,
                Err(error) => return refused(&self.time, &format!("cannot read {}: {error}", T::NAME)),
            }
        }
    }

    /// One message of each source waits at most. So another can only be behind this one where the source has a
    /// successor since the last read; as long as this one is valid, that one is met at the next read. Looking for it
    /// every time would cost half of a read.
    fn leaves_nothing_newer(&self, received: &Received, now_ns: u64) -> bool {
        received.is_last_after(self.latest.as_ref()) && self.is_valid(&received.stamp(), now_ns)
    }
}

/// The writing end of a queuing channel. A port without a channel reports that nobody receives.
pub struct QueuingSource<T> {
    pub(crate) outlet: Option<Rc<Outlet>>,
    time: Time,
    sequence: u64,
    message: PhantomData<T>,
}

impl<T: Message> QueuingSource<T> {
    pub(crate) fn new(outlet: Option<Rc<Outlet>>, time: Time) -> Self {
        Self { outlet, time, sequence: 0, message: PhantomData }
    }

    /// Appends a message.
    pub fn send(&mut self, message: &T) -> Sent {
        let stamp = Stamp { source_ns: self.time.now_ns(), sequence: self.sequence + 1 };
        let Some(outlet) = &self.outlet else { return Sent::NoReceiver };
        let sent = match outlet.put(message.as_bytes(), stamp, stamp.source_ns) {
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
        } else {
            self.time.page().port_refusals.fetch_add(1, Relaxed);
        }
        sent
    }
}

/// Messages of a wrong length that are passed over in one call, most: reading takes a bounded time whatever the writer does.
pub(crate) const REFUSED_AT_ONCE: usize = 64;

/// The reading end of a queuing channel.
pub struct QueuingDestination<T> {
    pub(crate) inlet: Option<Rc<Inlet>>,
    time: Time,
    message: PhantomData<T>,
}

impl<T: Message> QueuingDestination<T> {
    pub(crate) fn new(inlet: Option<Rc<Inlet>>, time: Time) -> Self {
        Self { inlet, time, message: PhantomData }
    }

    /// Takes the oldest message.
    pub fn receive(&mut self) -> Option<T> {
        let reader = self.inlet.as_ref()?.reader.get()?;
        for _ in 0..REFUSED_AT_ONCE {
            match reader.receive() {
                Ok(received) => {
                    let received = received?;
                    match T::read_from_bytes(received.payload()) {
                        Ok(message) => return Some(message),
                        // The one behind it is as good as ever.
                        Err(_) => refused_length::<T>(&self.time, received.payload().len()),
                    }
                }
                Err(error) => {
                    refused(&self.time, &format!("cannot receive {}: {error}", T::NAME));
                    return None;
                }
            }
        }
        None
    }
}

fn put_in_place<T: Message>(
    writer: &Writer,
    fill: impl FnOnce(&mut T),
    stamp: Stamp,
) -> Result<usize, Refusal> {
    writer.put_in_place(size_of::<T>(), stamp, |bytes| {
        // As long as the message, and aligned for any.
        if let Ok(message) = T::mut_from_bytes(bytes) {
            fill(message);
        }
    })
}

fn refused_length<T: Message>(time: &Time, found: usize) {
    refused(time, &format!("{} of {found} bytes where {} belong", T::NAME, size_of::<T>()));
}

pub(crate) fn refused(time: &Time, what: &str) {
    time.page().port_refusals.fetch_add(1, Relaxed);
    time.page().report(ReportKind::PortError, what);
}

#[cfg(test)]
mod tests {
    use bateleur_messages::Rate;
    use bateleur_ports::{Channel, ChannelType, Domain, Membership};

    use super::*;

    /// A channel in a domain of its own, under a clock that stands still until it is set.
    struct Bed {
        time: Time,
        kind: ChannelType,
        channel: Channel,
        _node: Membership,
        _folder: tempfile::TempDir,
    }

    impl Bed {
        fn new(name: &str) -> Self {
            let folder = tempfile::tempdir().unwrap();
            let domain = Domain { root: folder.path().display().to_string() };
            let node = domain.join(name, "test").unwrap();
            let kind = ChannelType {
                name: name.into(),
                message: "Rate".into(),
                size: size_of::<Rate>(),
                depth: None,
                destinations: 1,
                spare_writers: 0,
                spare_readers: 0,
            };
            let channel = kind.create(&node).unwrap();
            let time = Time::standing();
            Self { time, kind, channel, _node: node, _folder: folder }
        }

        fn source(&self) -> SamplingSource<Rate> {
            let writer = self.kind.writer(&self.channel).unwrap();
            SamplingSource::new(Some(Rc::new(writer)), self.time.clone())
        }

        fn destination(&self, refresh_ns: u64) -> SamplingDestination<Rate> {
            let reader = self.kind.reader(&self.channel).unwrap();
            SamplingDestination::new(Some(Rc::new(reader)), refresh_ns, self.time.clone())
        }

        fn pass(&self, nanoseconds: u64) {
            self.time.page().now_ns.fetch_add(nanoseconds, Relaxed);
        }
    }

    fn rate(synchronize: u64) -> Rate {
        Rate { synchronize, ..Rate::default() }
    }

    #[test]
    fn a_value_that_was_filled_in_place_is_read_again_and_again_with_its_age() {
        let bed = Bed::new("place");
        let (mut source, mut destination) = (bed.source(), bed.destination(10));
        assert!(destination.read().is_none());
        source.write_in_place(|value| *value = rate(7));
        source.write_in_place(|value| *value = rate(8));
        let first = destination.read().unwrap();
        assert_eq!((first.value.synchronize, first.updated, first.valid, first.sequence), (8, true, true, 2));
        bed.pass(11);
        let again = destination.read().unwrap();
        assert_eq!(
            (again.value.synchronize, again.updated, again.valid, again.age_ns),
            (8, false, false, 11)
        );
    }

    #[test]
    fn a_value_with_a_stamp_of_the_future_is_not_valid_until_it_is_nearly_due() {
        let bed = Bed::new("future");
        let (mut source, mut destination) = (bed.source(), bed.destination(10));
        bed.pass(1000);
        source.write(&rate(7));
        bed.time.page().now_ns.store(0, Relaxed); // its source was ahead by 1000 ns
        assert_eq!(destination.read().map(|reading| (reading.age_ns, reading.valid)), Some((0, false)));
        bed.pass(990);
        assert_eq!(destination.read().map(|reading| reading.valid), Some(true));
        bed.pass(21);
        assert_eq!(destination.read().map(|reading| reading.valid), Some(false));
    }

    #[test]
    fn what_a_dead_source_left_hides_its_successors_value_for_one_read_while_it_is_valid() {
        let bed = Bed::new("valid");
        let (mut dead, mut destination) = (bed.source(), bed.destination(10));
        dead.write(&rate(1));
        assert_eq!(destination.read().map(|reading| reading.value.synchronize), Some(1));
        dead.write(&rate(2));
        drop(dead);
        let mut successor = bed.source();
        successor.write(&rate(3));
        let seen: Vec<_> =
            (0..2).map(|_| destination.read().map(|reading| reading.value.synchronize)).collect();
        assert_eq!(seen, [Some(2), Some(3)]);
    }

    #[test]
    fn what_a_dead_source_left_hides_nothing_once_it_is_no_longer_valid() {
        let bed = Bed::new("stale");
        let (mut dead, mut destination) = (bed.source(), bed.destination(10));
        dead.write(&rate(1));
        assert_eq!(destination.read().map(|reading| reading.value.synchronize), Some(1));
        dead.write(&rate(2));
        drop(dead);
        bed.pass(11);
        let mut successor = bed.source();
        successor.write(&rate(3));
        assert_eq!(destination.read().map(|reading| reading.value.synchronize), Some(3));
    }
}
