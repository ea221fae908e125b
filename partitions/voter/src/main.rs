//! The partition that stands for three replicas: it writes what most of them say, and says which of them says something else.
//!
//! The plan makes it of a partition with `replicas`, with its name and its ports. For a port `p` it has the ports `p_1` to `p_3`
//! beside, one for each replica.

use std::process::ExitCode;

use bateleur_apex::{
    Context, Partition, RawQueuingDestination, RawQueuingSource, RawSamplingDestination, RawSamplingSource,
    Retained, Sent, Stamp, StartError, Window,
};
use bateleur_message_format::{Scalar, Type};
use bateleur_voter::queues::Merger;
use bateleur_voter::standing::{Conduct, Standing, Verdict};
use bateleur_voter::{Ballot, Difference, Election, OUTVOTED_BYTES, OUTVOTED_PORT, REPLICAS};

/// Numbers that are kept over a restart: the scale of the first fields.
const SCALE: usize = 2048;
/// Between two verdicts on a replica on another module, ns.
const APART_NS: u64 = 5_000_000_000;
/// Messages of one replica that are taken from a queue in a window: a replica that babbles can not take the voter's time.
const TAKEN: usize = 16;

pub(crate) struct Voter {
    values: Vec<Value>,
    messages: Vec<Messages>,
    orders: Vec<Orders>,
    /// Where a replica on another module is told that it is outvoted.
    elsewhere: [Option<Elsewhere>; REPLICAS],
    scale: Box<[f64; SCALE]>,
    retained: Retained<[f64; SCALE]>,
}

/// A sampling port.
struct Value {
    name: String,
    outvotes: bool,
    from: [RawSamplingDestination; REPLICAS],
    to: RawSamplingSource,
    election: Election,
    standing: Standing,
    /// What each has written last: a copy, which it can not change any more.
    written: [(Vec<u8>, u64); REPLICAS],
    /// Those that have written since the last vote.
    fresh: [bool; REPLICAS],
    /// A single one had written at the end of the last window.
    waits: bool,
    /// It has been said that two differ and nobody knows which is right.
    undecided: bool,
    sequence: u64,
}

/// Why a replica is outvoted.
struct Reason {
    text: String,
    /// When it wrote the wrong value that it is outvoted for; `None`: it is late or silent.
    wrong_since_ns: Option<u64>,
}

/// A replica on another module, which is told here that it is outvoted. It starts again with its own memory and may differ for long: it is
/// outvoted once in [`APART_NS`], or its restarts would be used up.
struct Elsewhere {
    port: RawSamplingSource,
    told: u64,
    /// From when on it may be outvoted again: for being late, and for a wrong value, which a late one does not put off.
    next_ns: [u64; 2],
}

/// A queue that leaves the partition.
struct Messages {
    from: [RawQueuingDestination; REPLICAS],
    to: RawQueuingSource,
    merger: Merger,
    sequence: u64,
}

/// A queue that comes to the partition: each replica gets all of it.
struct Orders {
    from: RawQueuingDestination,
    to: [RawQueuingSource; REPLICAS],
}

impl Partition for Voter {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let masked: Vec<String> = context.attribute("not_outvoted", Vec::new())?;
        let mut names = |list| context.attribute::<Vec<String>>(list, Vec::new());
        let (values, messages, orders) = (names("values")?, names("messages")?, names("orders")?);
        let value = |name: &String| Value::open(context, name, !masked.contains(name));
        let values = values.iter().map(value).collect::<Result<_, _>>()?;
        let messages = messages.iter().map(|name| Messages::open(context, name)).collect::<Result<_, _>>()?;
        let orders = orders.iter().map(|name| Orders::open(context, name)).collect::<Result<_, _>>()?;
        let mut elsewhere = [const { None }; REPLICAS];
        for (number, replica) in (1..).zip(&mut elsewhere) {
            *replica = Elsewhere::open(context, number)?;
        }
        let retained = context.retained()?;
        let mut voter = Self { values, messages, orders, elsewhere, scale: Box::new([0.0; SCALE]), retained };
        if let Some(kept) = voter.retained.load() {
            let fields = voter.values.iter_mut().flat_map(|value| value.election.scale());
            fields.zip(kept).for_each(|(largest, kept)| *largest = kept);
        }
        Ok(voter)
    }

    fn window(&mut self, window: &Window) {
        self.orders.iter_mut().for_each(Orders::pass);
        let elsewhere = &mut self.elsewhere;
        let mut outvote = |replica: usize, reason: &Reason| {
            let elsewhere = elsewhere[replica].as_mut();
            if elsewhere.is_none_or(|replica| replica.is_told(reason, window.start_ns())) {
                window.outvote(replica, &reason.text);
            }
        };
        self.values.iter_mut().for_each(|value| value.decide(window, &mut outvote));
        let rank = |replica| (self.values.iter().map(|value| value.standing.rank(replica)).max(), replica);
        self.messages.iter_mut().for_each(|messages| messages.pass(rank, window.start_ns()));
        let fields = self.values.iter_mut().flat_map(|value| value.election.scale());
        self.scale.iter_mut().zip(fields).for_each(|(kept, largest)| *kept = *largest);
        self.retained.store(&self.scale);
    }
}

/// The ports of the three replicas for a port.
fn each<T>(
    name: &str,
    mut open: impl FnMut(&str) -> Result<T, StartError>,
) -> Result<[T; REPLICAS], StartError> {
    let opened = (1..=REPLICAS).map(|number| open(&format!("{name}_{number}")));
    let opened: Vec<T> = opened.collect::<Result<_, _>>()?;
    opened.try_into().map_err(|_| StartError::Other(format!("port {name} has no three replicas")))
}

impl Value {
    fn open(context: &mut Context, name: &str, outvotes: bool) -> Result<Self, StartError> {
        let of = context.message_type(name).map(|(message, text)| Type::from_schema(message, text));
        let of = of.transpose().map_err(|faults| StartError::Other(format!("port {name}: {faults}")))?;
        Ok(Self {
            from: each(name, |port| Ok(context.raw_sampling_destination(port)?.0))?,
            to: context.raw_sampling_source(name)?.0,
            name: name.to_owned(),
            outvotes,
            election: Election::new(of.as_ref()),
            standing: Standing::default(),
            written: Default::default(),
            fresh: [false; REPLICAS],
            waits: false,
            undecided: false,
            sequence: 0,
        })
    }

    fn decide(&mut self, window: &Window, outvote: &mut impl FnMut(usize, &Reason)) {
        for ((port, written), fresh) in self.from.iter_mut().zip(&mut self.written).zip(&mut self.fresh) {
            if let Some(reading) = port.read().filter(|reading| reading.updated) {
                written.0.clear();
                written.0.extend_from_slice(reading.bytes);
                written.1 = reading.stamp.source_ns;
                *fresh = true;
            }
        }
        let count = self.fresh.iter().filter(|fresh| **fresh).count();
        let is_awaited = |replica: usize| !self.fresh[replica] && !self.standing.is_away(replica);
        let is_alone = count == 1 && (0..REPLICAS).any(is_awaited);
        // The others may be a window later, on another host. It is asked again in the next one.
        let waits = std::mem::replace(&mut self.waits, is_alone);
        if count == 0 || (is_alone && !waits) {
            return;
        }
        let fresh = std::mem::take(&mut self.fresh);
        self.waits = false;
        let ballot = |replica: usize| {
            let (bytes, source_ns) = &self.written[replica];
            fresh[replica].then_some(Ballot { bytes, source_ns: *source_ns })
        };
        let ballots = std::array::from_fn(ballot);
        let outcome = self.election.vote(ballots, window.minor_frame_ns(), (&self.standing, !self.outvotes));
        let undecided = std::mem::replace(&mut self.undecided, outcome.source_ns.is_none());
        match outcome.source_ns {
            Some(source_ns) => {
                self.sequence += 1;
                self.to.write(self.election.message(), Stamp { source_ns, sequence: self.sequence });
            }
            None if !undecided => {
                window.raise(&format!("{}: replicas differ, and none is in the majority", self.name));
            }
            None => {}
        }
        if outcome.source_ns.is_none() {
            return;
        }
        for (replica, difference) in outcome.differences.iter().enumerate() {
            let conduct = match (fresh[replica], difference) {
                (false, _) => Conduct::Silent,
                (true, Some(_)) if self.outvotes => Conduct::Differs,
                (true, _) => Conduct::Agrees,
            };
            let text = match self.standing.note(replica, conduct) {
                Some(Verdict::Differs) => describe(&self.name, difference.as_ref()),
                Some(Verdict::Silent) if self.outvotes => format!("{}: writes nothing", self.name),
                Some(Verdict::Silent) | None => continue,
            };
            // What is late or missing may be the network's fault.
            let is_wrong = difference.as_ref().is_some_and(|difference| difference.field.is_some());
            let wrong_since_ns = is_wrong.then_some(self.written[replica].1);
            outvote(replica, &Reason { text, wrong_since_ns });
        }
    }
}

fn describe(port: &str, difference: Option<&Difference>) -> String {
    match difference {
        Some(Difference { field: Some(field), values: Some((own, most)) }) => {
            format!("{port}.{field} is {} and {} by most", number(*own), number(*most))
        }
        _ => format!("{port}: late, or other bytes"),
    }
}

/// A wrong number may be as large or as small as there are.
fn number(value: Scalar) -> String {
    match value {
        Scalar::Single(_) | Scalar::Real(_) => match value.real() {
            plain if plain == 0.0 || (1e-3..1e6).contains(&plain.abs()) => format!("{plain:.4}"),
            other => format!("{other:.3e}"),
        },
        _ => value.to_string(),
    }
}

impl Elsewhere {
    /// `None`: the replica of that number runs on the voter's module.
    fn open(context: &mut Context, number: usize) -> Result<Option<Self>, StartError> {
        let name = format!("{OUTVOTED_PORT}_{number}");
        if !context.has_port(&name) {
            return Ok(None);
        }
        Ok(Some(Self { port: context.raw_sampling_source(&name)?.0, told: 0, next_ns: [0; 2] }))
    }

    /// Tells it, where it wrote something wrong; false: it is too soon.
    fn is_told(&mut self, reason: &Reason, now_ns: u64) -> bool {
        let kind = usize::from(reason.wrong_since_ns.is_some());
        if now_ns < self.next_ns[kind] {
            return false;
        }
        self.next_ns[..=kind].fill(now_ns + APART_NS);
        if let Some(source_ns) = reason.wrong_since_ns {
            self.told += 1;
            let text = &reason.text.as_bytes()[..reason.text.len().min(OUTVOTED_BYTES as usize)];
            self.port.write(text, Stamp { source_ns, sequence: self.told });
        }
        true
    }
}

impl Messages {
    fn open(context: &mut Context, name: &str) -> Result<Self, StartError> {
        Ok(Self {
            from: each(name, |port| Ok(context.raw_queuing_destination(port)?.0))?,
            to: context.raw_queuing_source(name)?.0,
            merger: Merger::default(),
            sequence: 0,
        })
    }

    fn pass<R: Ord>(&mut self, rank: impl Fn(usize) -> R, now_ns: u64) {
        let sent = self.from.each_mut().map(|port| {
            let messages = std::iter::from_fn(|| port.receive());
            messages.take(TAKEN).map(|message| message.bytes().to_vec()).collect::<Vec<_>>()
        });
        for message in self.merger.take(sent, rank) {
            self.sequence += 1;
            // What has no room is lost, as it is where the partition itself sends it; the port counts it.
            let _: Sent = self.to.send(&message, Stamp { source_ns: now_ns, sequence: self.sequence });
        }
    }
}

impl Orders {
    fn open(context: &mut Context, name: &str) -> Result<Self, StartError> {
        Ok(Self {
            from: context.raw_queuing_destination(name)?.0,
            to: each(name, |port| Ok(context.raw_queuing_source(port)?.0))?,
        })
    }

    fn pass(&mut self) {
        for _ in 0..TAKEN {
            let Some(message) = self.from.receive() else { return };
            for port in &mut self.to {
                // One that is not there misses it, and differs, and starts again with what another one has made of it.
                let _: Sent = port.send(message.bytes(), message.stamp());
            }
        }
    }
}

pub(crate) fn main() -> ExitCode {
    bateleur_apex::run::<Voter>()
}
