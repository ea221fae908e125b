//! The plan's ports, as the services of ARINC 653 reach them: by name, with messages of any length up to their size.
#![allow(unsafe_code)] // threads share what is reached under the partition's one lock

use std::cell::RefCell;
use std::collections::VecDeque;

use bateleur_contract::{Direction, PortDescription, PortKind};
use bateleur_ports::Stamp;
use bateleur_processes::ports::{Ports, QueuingConfiguration, Received, SamplingConfiguration, Written};
use bateleur_processes::standard::{Name, PortDirection, SystemTime};

use crate::context::{Context, StartError};
use crate::raw::{RawQueuingDestination, RawQueuingSource, RawSamplingDestination, RawSamplingSource};

/// The ports of the plan, for the services that take [`Ports`]. Those that the main process has created are open.
#[derive(Default)]
pub struct PlanPorts {
    all: Vec<PlanPort>,
    /// The partition's time, for what is sent.
    pub(crate) now: SystemTime,
}

struct PlanPort {
    /// Without an equal if the plan's name is too long for one.
    name: Option<Name>,
    described: PortDescription,
    end: Option<End>,
}

// SAFETY: it is reached under the partition's one lock only, by one thread at a time, with everything that it shares with other ports.
unsafe impl Send for PlanPorts {}

/// An open port. A source counts its messages.
enum End {
    Writes(RawSamplingSource, u64),
    Reads(RawSamplingDestination),
    Sends(RawQueuingSource, u64),
    Receives(RefCell<Queue>),
}

/// A queuing destination.
struct Queue {
    port: RawQueuingDestination,
    /// The number of the last message that was taken from the channel; 0: none yet.
    last: u64,
    /// Taken from the channel to count them, and not yet received.
    counted: VecDeque<(Vec<u8>, Received)>,
}

impl PlanPorts {
    /// Looks up what the plan says, once.
    pub(crate) fn declare(&mut self, context: &Context) {
        if self.all.is_empty() {
            let port = |described: &PortDescription| PlanPort {
                name: Name::new(&described.name),
                described: described.clone(),
                end: None,
            };
            self.all = context.described_ports().iter().map(port).collect();
        }
    }

    /// Opens the port with this name, which the plan has.
    ///
    /// # Errors
    /// Its channel can not be opened.
    pub(crate) fn open(&mut self, context: &mut Context, name: &str) -> Result<(), StartError> {
        let name = Name::new(name);
        let Some(port) = self.all.iter_mut().find(|port| port.name == name) else { return Ok(()) };
        let plans = port.described.name.as_str();
        port.end = Some(match (port.described.kind, port.described.direction) {
            (PortKind::Sampling, Direction::Source) => End::Writes(context.raw_sampling_source(plans)?.0, 0),
            (PortKind::Sampling, Direction::Destination) => {
                End::Reads(context.raw_sampling_destination(plans)?.0)
            }
            (PortKind::Queuing, Direction::Source) => End::Sends(context.raw_queuing_source(plans)?.0, 0),
            (PortKind::Queuing, Direction::Destination) => {
                let port_of_plan = context.raw_queuing_destination(plans)?.0;
                End::Receives(RefCell::new(Queue { port: port_of_plan, last: 0, counted: VecDeque::new() }))
            }
        });
        Ok(())
    }

    /// The port of this kind with a name, and how it is called from here on.
    fn named(&self, kind: PortKind, name: &Name) -> Option<(usize, &PortDescription)> {
        let is_it = |port: &PlanPort| port.described.kind == kind && port.name == Some(*name);
        let key = self.all.iter().position(is_it)?;
        Some((key, &self.all[key].described))
    }

    /// Messages that a queue holds.
    fn depth(&self, key: usize) -> usize {
        self.all.get(key).map_or(0, |port| port.described.depth.max(1) as usize)
    }

    fn end(&mut self, key: usize) -> Option<&mut End> {
        self.all.get_mut(key)?.end.as_mut()
    }
}

impl Ports for PlanPorts {
    fn sampling(&self, name: &Name) -> Option<SamplingConfiguration> {
        let (key, port) = self.named(PortKind::Sampling, name)?;
        let refresh = SystemTime::try_from(port.refresh_ns).unwrap_or(SystemTime::MAX);
        Some(SamplingConfiguration { key, max_size: size(port), direction: direction(port), refresh })
    }

    fn queuing(&self, name: &Name) -> Option<QueuingConfiguration> {
        let (key, port) = self.named(PortKind::Queuing, name)?;
        let max_messages = i32::try_from(port.depth.max(1)).unwrap_or(i32::MAX);
        Some(QueuingConfiguration { key, max_size: size(port), max_messages, direction: direction(port) })
    }

    fn write(&mut self, key: usize, message: &[u8], now: SystemTime) {
        let Some(End::Writes(port, sequence)) = self.end(key) else { return };
        *sequence += 1;
        port.write(message, Stamp { source_ns: now as u64, sequence: *sequence });
    }

    fn read(&mut self, key: usize, into: &mut Vec<u8>) -> Option<Written> {
        let Some(End::Reads(port)) = self.end(key) else { return None };
        let reading = port.read()?;
        into.extend_from_slice(reading.bytes);
        let at = SystemTime::try_from(reading.stamp.source_ns).unwrap_or(SystemTime::MAX);
        Some(Written { at, sequence: reading.stamp.sequence })
    }

    fn send(&mut self, key: usize, message: &[u8]) -> bool {
        let source_ns = self.now as u64;
        let Some(End::Sends(port, sequence)) = self.end(key) else { return false };
        let accepted = port.offer(message, Stamp { source_ns, sequence: *sequence + 1 });
        *sequence += u64::from(accepted);
        accepted
    }

    fn receive(&mut self, key: usize, into: &mut Vec<u8>) -> Option<Received> {
        let Some(End::Receives(queue)) = self.end(key) else { return None };
        queue.get_mut().receive(into)
    }

    fn next_length(&self, key: usize) -> Option<usize> {
        match self.all.get(key).and_then(|port| port.end.as_ref()) {
            Some(End::Receives(queue)) => queue.borrow_mut().next_length(),
            _ => None,
        }
    }

    fn clear(&mut self, key: usize) {
        let most = self.depth(key);
        let Some(End::Receives(queue)) = self.end(key) else { return };
        let queue = queue.get_mut();
        queue.counted.clear();
        // Not more than it can hold: its source may be sending.
        (0..most).take_while(|_| queue.take(&mut Vec::new()).is_some()).count();
    }

    fn count(&self, key: usize) -> i32 {
        match self.all.get(key).and_then(|port| port.end.as_ref()) {
            Some(End::Receives(queue)) => queue.borrow_mut().count(self.depth(key)),
            // What a source has accepted lies at the destination.
            _ => 0,
        }
    }
}

impl Queue {
    fn receive(&mut self, into: &mut Vec<u8>) -> Option<Received> {
        into.clear();
        let Some((message, received)) = self.counted.pop_front() else { return self.take(into) };
        into.extend_from_slice(&message);
        Some(received)
    }

    /// The oldest message of the channel. The numbers of its source say whether one is missing before it.
    fn take(&mut self, into: &mut Vec<u8>) -> Option<Received> {
        let message = self.port.receive()?;
        into.extend_from_slice(message.bytes());
        let sequence = message.stamp().sequence;
        let overflow = self.last != 0 && sequence > self.last + 1;
        self.last = sequence;
        Some(Received { overflow })
    }

    /// Of the oldest message, which is taken from the channel to know.
    fn next_length(&mut self) -> Option<usize> {
        self.fetch(1);
        self.counted.front().map(|(message, _)| message.len())
    }

    /// Messages that have arrived, `most` at the most. A channel that does not tell how many it holds has to give them.
    fn count(&mut self, most: usize) -> i32 {
        let waiting = self.port.waiting().unwrap_or_else(|| {
            self.fetch(most);
            0
        });
        (self.counted.len() + waiting).min(most) as i32 // at most the depth of a queue
    }

    /// Takes messages from the channel until `most` are here.
    fn fetch(&mut self, most: usize) {
        while self.counted.len() < most {
            let mut message = Vec::new();
            let Some(received) = self.take(&mut message) else { break };
            self.counted.push_back((message, received));
        }
    }
}

fn size(port: &PortDescription) -> i32 {
    i32::try_from(port.size).unwrap_or(i32::MAX)
}

fn direction(port: &PortDescription) -> PortDirection {
    match port.direction {
        Direction::Source => PortDirection::Source,
        Direction::Destination => PortDirection::Destination,
    }
}

#[cfg(test)]
mod tests {
    use std::rc::Rc;

    use bateleur_ports::{Channel, ChannelType, Handed, Refusal};

    use super::*;
    use crate::ports::Inlet;
    use crate::time::Time;

    #[test]
    fn counting_a_sealed_queue_makes_no_room_for_its_source_and_asking_for_a_length_takes_one() {
        let kind = ChannelType {
            name: "queue".into(),
            message: "bytes".into(),
            size: 8,
            depth: Some(3),
            destinations: 1,
            spare_writers: 0,
            spare_readers: 0,
        };
        let handed = Handed::alone(&kind, false).unwrap();
        let inlet = Inlet::new(kind.clone(), Channel::Sealed(handed.again(0).unwrap()));
        inlet.attach().unwrap();
        let port = RawQueuingDestination::new(Some(Rc::new(inlet)), 8, Time::standing());
        let mut queue = Queue { port, last: 0, counted: VecDeque::new() };
        let writer = kind.writer(&Channel::Sealed(handed)).unwrap();
        let send = |sequence: u64| writer.put(&[sequence as u8], Stamp { source_ns: 0, sequence });
        assert_eq!(queue.count(3), 0);
        assert!((1..4).all(|sequence| send(sequence).is_ok()));
        for _ in 0..2 {
            assert_eq!(queue.count(3), 3);
            assert!(matches!(send(4), Err(Refusal::Full)), "the queue holds three");
        }
        assert_eq!((queue.next_length(), queue.count(3)), (Some(1), 3));
        let mut message = Vec::new();
        let order = std::iter::from_fn(|| queue.receive(&mut message).map(|_| message[0]));
        assert_eq!(order.collect::<Vec<u8>>(), [1, 2, 3]);
        assert_eq!(queue.count(3), 0);
    }
}
