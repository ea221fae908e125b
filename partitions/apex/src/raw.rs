//! Ports of whatever message type the plan says, as bytes with their stamps: for a partition that hands messages on, such
//! as a relay.
//!
//! The stamp is the caller's: who hands on keeps the time and the number that the source gave. These ports must never make up
//! either. Everything else is as with typed ports.

use std::rc::Rc;
use std::sync::atomic::Ordering::Relaxed;

use bateleur_contract::{PortDescription, PortKind};
use bateleur_ports::{Reader, Received, Refusal, Stamp};

use crate::ports::{Inlet, Outlet, REFUSED_AT_ONCE, Sent, WAITING_AT_MOST, refused};
use crate::time::Time;

/// The writing end of a sampling channel. A port without a channel swallows what is written.
pub struct RawSamplingSource {
    outlet: Option<Rc<Outlet>>,
    time: Time,
}

impl RawSamplingSource {
    pub(crate) fn new(outlet: Option<Rc<Outlet>>, time: Time) -> Self {
        Self { outlet, time }
    }

    /// Replaces the channel's value. Bytes of another length than the channel's are refused by its readers; plain bytes may be
    /// fewer.
    pub fn write(&mut self, bytes: &[u8], stamp: Stamp) {
        if let Some(outlet) = &self.outlet
            && let Err(reason) = outlet.put(bytes, stamp, self.time.now_ns())
        {
            refused(&self.time, &format!("cannot write {} bytes: {reason}", bytes.len()));
        }
    }
}

/// What a sampling port holds.
#[derive(Debug)]
pub struct RawReading<'a> {
    /// The latest value, in shared memory.
    pub bytes: &'a [u8],
    /// What its source said of it.
    pub stamp: Stamp,
    /// This port had not read this value before.
    pub updated: bool,
}

/// The reading end of a sampling channel.
pub struct RawSamplingDestination {
    reader: Option<Rc<Reader>>,
    described: PortDescription,
    latest: Option<Received>,
    time: Time,
}

impl RawSamplingDestination {
    pub(crate) fn new(reader: Option<Rc<Reader>>, described: PortDescription, time: Time) -> Self {
        Self { reader, described, latest: None, time }
    }

    /// The latest value, as often as it is asked for; nothing before the first.
    pub fn read(&mut self) -> Option<RawReading<'_>> {
        let updated = self.take_latest();
        let latest = self.latest.as_ref()?;
        Some(RawReading { bytes: latest.payload(), stamp: latest.stamp(), updated })
    }

    fn take_latest(&mut self) -> bool {
        let Some(reader) = &self.reader else { return false };
        let mut updated = false;
        for _ in 0..WAITING_AT_MOST {
            match reader.receive() {
                Ok(Some(received)) if self.described.carries(received.payload().len()) => {
                    self.latest = Some(received);
                    updated = true;
                }
                Ok(Some(received)) => {
                    let found = received.payload().len();
                    let fewer = if self.described.is_plain() { "1 to " } else { "" };
                    let most = self.described.size;
                    refused(&self.time, &format!("message of {found} bytes where {fewer}{most} belong"));
                }
                Ok(None) => break,
                Err(error) => {
                    refused(&self.time, &format!("cannot read: {error}"));
                    break;
                }
            }
        }
        updated
    }
}

/// The writing end of a queuing channel. A port without a channel reports that nobody receives.
pub struct RawQueuingSource {
    outlet: Option<Rc<Outlet>>,
    time: Time,
}

impl RawQueuingSource {
    pub(crate) fn new(outlet: Option<Rc<Outlet>>, time: Time) -> Self {
        Self { outlet, time }
    }

    /// Appends a message.
    pub fn send(&mut self, bytes: &[u8], stamp: Stamp) -> Sent {
        let sent = self.put(bytes, stamp);
        if sent != Sent::Queued {
            self.time.page().port_refusals.fetch_add(1, Relaxed);
        }
        sent
    }

    /// As [`RawQueuingSource::send`], for a sender that asks again until there is room: what does not fit is no refusal. False: it is not sent.
    pub(crate) fn offer(&mut self, bytes: &[u8], stamp: Stamp) -> bool {
        self.put(bytes, stamp) == Sent::Queued
    }

    fn put(&mut self, bytes: &[u8], stamp: Stamp) -> Sent {
        let Some(outlet) = &self.outlet else { return Sent::NoReceiver };
        match outlet.put(bytes, stamp, self.time.now_ns()) {
            Ok(0) => Sent::NoReceiver,
            Ok(_) => Sent::Queued,
            Err(Refusal::Full) => Sent::Full,
            Err(reason) => {
                refused(&self.time, &format!("cannot send {} bytes: {reason}", bytes.len()));
                Sent::NoReceiver
            }
        }
    }
}

/// A message out of a queue.
#[derive(Debug)]
pub struct RawMessage(Received);

impl RawMessage {
    /// The message.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        self.0.payload()
    }

    /// What its source said of it.
    #[must_use]
    pub fn stamp(&self) -> Stamp {
        self.0.stamp()
    }
}

/// The reading end of a queuing channel.
pub struct RawQueuingDestination {
    inlet: Option<Rc<Inlet>>,
    /// Of the longest message.
    bytes: usize,
    time: Time,
}

impl RawQueuingDestination {
    pub(crate) fn new(inlet: Option<Rc<Inlet>>, bytes: usize, time: Time) -> Self {
        Self { inlet, bytes, time }
    }

    /// Whether a message waits.
    #[must_use]
    pub fn has_messages(&self) -> bool {
        let reader = self.inlet.as_ref().and_then(|inlet| inlet.reader.get());
        reader.is_some_and(Reader::has_messages)
    }

    /// How many messages wait, where the channel can tell without giving them.
    pub(crate) fn waiting(&self) -> Option<usize> {
        self.inlet.as_ref()?.reader.get()?.waiting()
    }

    /// Takes the oldest message. Only one may be held at a time.
    pub fn receive(&mut self) -> Option<RawMessage> {
        let reader = self.inlet.as_ref()?.reader.get()?;
        for _ in 0..REFUSED_AT_ONCE {
            match reader.receive() {
                Ok(received) => {
                    let received = received?;
                    let found = received.payload().len();
                    if PortKind::Queuing.carries(true, self.bytes, found) {
                        return Some(RawMessage(received));
                    }
                    let most = self.bytes;
                    refused(&self.time, &format!("message of {found} bytes where 1 to {most} belong"));
                }
                Err(error) => {
                    refused(&self.time, &format!("cannot receive: {error}"));
                    return None;
                }
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use bateleur_messages::{GroundMessage, Rate};
    use zerocopy::IntoBytes;

    use super::*;
    use crate::{Context, Harness, Partition, StartError, Window};

    /// Hands on what it hears, as it is.
    struct Echo {
        rate: RawSamplingDestination,
        again: RawSamplingSource,
        orders: RawQueuingDestination,
        answers: RawQueuingSource,
        sent: Vec<Sent>,
    }

    impl Partition for Echo {
        fn start(context: &mut Context) -> Result<Self, StartError> {
            let (again, bytes) = context.raw_sampling_source("again")?;
            assert_eq!(bytes, size_of::<Rate>());
            Ok(Self {
                rate: context.raw_sampling_destination("rate")?.0,
                again,
                orders: context.raw_queuing_destination("orders")?.0,
                answers: context.raw_queuing_source("answers")?.0,
                sent: Vec::new(),
            })
        }

        fn window(&mut self, _window: &Window) {
            if let Some(reading) = self.rate.read().filter(|reading| reading.updated) {
                self.again.write(reading.bytes, Stamp { source_ns: 77, ..reading.stamp });
            }
            while let Some(order) = self.orders.receive() {
                self.sent.push(self.answers.send(order.bytes(), order.stamp()));
            }
        }
    }

    /// Sends bytes that are no message, then one that is.
    struct Careless {
        answers: RawQueuingSource,
    }

    impl Partition for Careless {
        fn start(context: &mut Context) -> Result<Self, StartError> {
            Ok(Self { answers: context.raw_queuing_source("answers")?.0 })
        }

        fn window(&mut self, _window: &Window) {
            let message = GroundMessage::default();
            for bytes in [&[1, 2, 3][..], message.as_bytes()] {
                assert_eq!(self.answers.send(bytes, Stamp::default()), Sent::Queued);
            }
        }
    }

    #[test]
    fn message_of_a_wrong_length_in_a_queue_is_an_error_and_hides_none_behind_it() {
        let mut harness = Harness::new("careless").unwrap();
        let mut answers = harness.queuing_source::<GroundMessage>("answers", 4).unwrap();
        let mut careless = harness.start::<Careless>().unwrap(); // its messages die with it
        careless.window();
        assert_eq!(answers.receive(), Some(GroundMessage::default()));
        assert_eq!(answers.receive(), None);
        let reports = harness.reports();
        assert!(reports[0].starts_with("GroundMessage of 3 bytes where "), "{reports:?}");
    }

    #[test]
    fn message_of_a_wrong_length_is_an_error_and_is_not_handed_on() {
        let mut harness = Harness::new("echo").unwrap();
        let mut rate = harness.sampling_destination::<Rate>("rate", 40_000_000).unwrap();
        let mut again = harness.sampling_source::<Rate>("again").unwrap();
        let mut orders = harness.queuing_destination::<GroundMessage>("orders", 4).unwrap();
        let mut answers = harness.queuing_source::<GroundMessage>("answers", 4).unwrap();
        let mut echo = harness.start::<Echo>().unwrap();
        let put = |outlet: &Option<Rc<Outlet>>, bytes: &[u8]| {
            assert_eq!(outlet.as_ref().unwrap().put(bytes, Stamp::default(), 0).ok(), Some(1));
        };
        rate.write(&Rate { synchronize: 5, ..Rate::default() });
        echo.window();
        put(&rate.outlet, &[7; 3]);
        put(&orders.outlet, &[]);
        orders.send(&GroundMessage { letter: 1, ..GroundMessage::default() });
        echo.window();
        assert_eq!(answers.receive().map(|answer| answer.letter), Some(1));
        assert_eq!(answers.receive(), None);
        let reading = again.read().unwrap();
        assert_eq!((reading.value.synchronize, reading.updated), (5, true), "the last good value stands");
        let found = harness.reports();
        let expected = [
            format!("message of 3 bytes where {} belong", size_of::<Rate>()),
            format!("message of 0 bytes where 1 to {} belong", size_of::<GroundMessage>()),
        ];
        assert_eq!(found, expected);
    }

    #[test]
    fn messages_of_any_type_are_handed_on_with_the_stamp_that_the_caller_gives() {
        let mut harness = Harness::new("echo").unwrap();
        let mut rate = harness.sampling_destination::<Rate>("rate", 40_000_000).unwrap();
        let mut again = harness.sampling_source::<Rate>("again").unwrap();
        let mut orders = harness.queuing_destination::<GroundMessage>("orders", 4).unwrap();
        let mut answers = harness.queuing_source::<GroundMessage>("answers", 2).unwrap();
        let mut echo = harness.start::<Echo>().unwrap();
        rate.write(&Rate { synchronize: 5, ..Rate::default() });
        rate.write(&Rate { synchronize: 6, ..Rate::default() });
        (0..3).for_each(|_| assert_eq!(orders.send(&GroundMessage::default()), Sent::Queued));
        echo.window();
        let reading = again.read().unwrap();
        assert_eq!((reading.value.synchronize, reading.sequence, reading.updated), (6, 2, true));
        assert_eq!(reading.age_ns, 20_000_000 - 77);
        assert_eq!(echo.partition.sent[..2], [Sent::Queued, Sent::Queued]);
        assert_ne!(echo.partition.sent[2], Sent::Queued);
        assert!(answers.receive().is_some() && answers.receive().is_some() && answers.receive().is_none());
        echo.window();
        assert!(!again.read().unwrap().updated);
    }

    #[test]
    fn a_port_of_another_kind_is_refused() {
        struct Wrong;
        impl Partition for Wrong {
            fn start(context: &mut Context) -> Result<Self, StartError> {
                context.raw_queuing_source("rate").map(|_| Self)
            }
            fn window(&mut self, _window: &Window) {}
        }
        let mut harness = Harness::new("wrong").unwrap();
        let _rate = harness.sampling_destination::<Rate>("rate", 1).unwrap();
        let error = harness.start::<Wrong>().err().unwrap().to_string();
        assert!(error.contains("Sampling Destination") && error.contains("Queuing Source"), "{error}");
    }
}
