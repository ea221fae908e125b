//! Rules about channels: that both ends fit each other, in kind, message and time, and where they lead all together.

use std::collections::hash_map::Entry;
use std::collections::{BTreeSet, HashMap};

use super::Context;
use crate::catalogue::{self, Rule};
use crate::closed::{Direction, Kind};
use crate::cycle::most_between;
use crate::findings::{Finding, Span};
use crate::latency::{self, Station};
use crate::model::{PartitionId, PortId, Schedule};
use crate::raw::{RawChannel, RawPort};
use crate::reader::At;
use crate::units::ShowTime;
use crate::ways;
use bateleur_plan::timeline::gaps;

/// One end of a channel: how the channel names it, and the port.
#[derive(Clone, Copy)]
struct End<'a> {
    said: &'a At<String>,
    id: PortId,
    port: &'a RawPort,
    owner: PartitionId,
}

impl<'a> End<'a> {
    fn of(cx: &Context<'a>, said: &'a At<String>, id: PortId) -> Option<Self> {
        let port = cx.file.ports.get(id.0)?;
        Some(Self { said, id, port, owner: PartitionId(port.partition) })
    }

    fn name(&self) -> &str {
        &self.said.value
    }
}

/// The known ends of each channel.
fn ends<'a>(cx: &Context<'a>) -> impl Iterator<Item = (&'a RawChannel, Option<End<'a>>, Vec<End<'a>>)> {
    cx.file.channels.iter().zip(&cx.plan.channels).map(|(raw, channel)| {
        let source = raw.source.said().and_then(|said| End::of(cx, said, channel.source));
        let destinations = raw.destinations.items().iter().zip(&channel.destinations);
        (raw, source, destinations.filter_map(|(said, id)| End::of(cx, said, *id)).collect())
    })
}

pub(super) fn check(cx: &Context<'_>) {
    for (channel, source, destinations) in ends(cx) {
        direction(cx, source.as_slice(), Direction::Source, &catalogue::SOURCE_DIRECTION);
        direction(cx, &destinations, Direction::Destination, &catalogue::DESTINATION_DIRECTION);
        count(cx, channel, source.as_ref());
        for (source, destination) in
            source.iter().flat_map(|source| destinations.iter().map(move |end| (source, end)))
        {
            itself(cx, source, destination);
            kind(cx, source, destination);
            payload(cx, source, destination);
            time(cx, source, destination);
        }
        if let Some(source) = &source {
            unread(cx, source, &destinations);
        }
    }
    once(cx);
    loops(cx);
}

/// Notes a sampling source whose values are written more often than anybody looks.
fn unread(cx: &Context<'_>, source: &End<'_>, destinations: &[End<'_>]) {
    if source.port.kind.word() != Some(Kind::Sampling) || destinations.is_empty() {
        return;
    }
    if destinations.iter().any(|end| is_across(cx, source.owner, end.owner)) {
        return; // the relay looks in each of its windows, whoever looks then
    }
    for schedule in &cx.plan.schedules {
        let writes = schedule.occurrences(source.owner);
        let readers = destinations.iter().map(|end| schedule.occurrences(end.owner));
        let read: BTreeSet<u64> =
            readers.flat_map(|reads| read_writes(&writes, &reads, schedule.major_frame_ns)).collect();
        if writes.is_empty() || read.is_empty() || read.len() >= writes.len() {
            continue;
        }
        let (name, schedule) = (source.name(), &schedule.name);
        let message = format!(
            "{} of {} values of `{name}` in schedule `{schedule}` are read",
            read.len(),
            writes.len()
        );
        let mend = "nothing, if that is meant; else let a reader run as often as the writer";
        cx.note(&catalogue::UNREAD_WRITES, &source.said.span, message, mend);
        break;
    }
}

/// Whether two partitions are on different modules.
fn is_across(cx: &Context<'_>, one: PartitionId, other: PartitionId) -> bool {
    cx.module_of(one).is_some_and(|one| cx.module_of(other).is_some_and(|other| other != one))
}

/// The starts of the writing windows, in the major frame, whose last value some reading window sees.
fn read_writes(writes: &[(u64, u64)], reads: &[(u64, u64)], major: u64) -> Vec<u64> {
    let station = |windows: &[(u64, u64)]| Station { windows: windows.to_vec(), hop: None };
    let ways = latency::ways(&[station(writes), station(reads)], major);
    let cycle = i64::try_from(major).unwrap_or(i64::MAX);
    let start =
        |way: &Vec<latency::Visit>| way.first().map(|visit| visit.start_ns.rem_euclid(cycle).unsigned_abs());
    ways.iter().filter_map(start).collect()
}

/// From partition to partition by a channel, and where that names its source.
type Edge<'a> = (PartitionId, PartitionId, &'a Span);

/// Notes the groups of partitions in which sampling channels lead around.
fn loops(cx: &Context<'_>) {
    let edges = sampling_edges(cx);
    let mut told = BTreeSet::new();
    for &(from, _, _) in &edges {
        if told.contains(&from) {
            continue;
        }
        let Some(way) = way_back(&edges, from) else { continue };
        let first_step = |edge: &&Edge<'_>| way.starts_with(&[edge.0, edge.1]);
        let Some((_, _, said)) = edges.iter().find(first_step) else { continue };
        told.extend(reachable_both_ways(&edges, from));
        let names: Vec<&str> = way.iter().map(|&partition| cx.partition_name(partition)).collect();
        let message = format!("sampling channels lead around: {}", names.join(" → "));
        let mend = "nothing, if a feedback is meant: whoever comes first in the minor frame reads the value of the one before";
        cx.note(&catalogue::LOOP, said, message, mend);
    }
}

/// Partition to partition, with where the channel names its source.
fn sampling_edges<'a>(cx: &Context<'a>) -> Vec<Edge<'a>> {
    let mut edges = Vec::new();
    for (_, source, destinations) in ends(cx) {
        let source = source.filter(|source| source.port.kind.word() == Some(Kind::Sampling));
        let Some(source) = source else { continue };
        let others = destinations.into_iter().map(|end| end.owner).filter(|other| *other != source.owner);
        edges.extend(others.map(|other| (source.owner, other, &source.said.span)));
    }
    edges
}

/// The shortest way from a partition back to itself, both ends included.
fn way_back(edges: &[Edge<'_>], from: PartitionId) -> Option<Vec<PartitionId>> {
    let mut before: HashMap<PartitionId, PartitionId> = HashMap::new();
    let mut queue = std::collections::VecDeque::from([from]);
    while let Some(at) = queue.pop_front() {
        for &(_, next, _) in edges.iter().filter(|edge| edge.0 == at) {
            if next == from {
                let mut way = vec![from, at];
                while let Some(&earlier) =
                    way.last().filter(|&&last| last != from).and_then(|last| before.get(last))
                {
                    way.push(earlier);
                }
                way.reverse();
                return Some(way);
            }
            if let Entry::Vacant(place) = before.entry(next) {
                place.insert(at);
                queue.push_back(next);
            }
        }
    }
    None
}

/// The partitions that `from` reaches and that reach it.
fn reachable_both_ways(edges: &[Edge<'_>], from: PartitionId) -> BTreeSet<PartitionId> {
    let reach = |forward: bool| {
        let mut seen = BTreeSet::from([from]);
        let mut stack = vec![from];
        while let Some(at) = stack.pop() {
            for edge in edges {
                let (here, there) = if forward { (edge.0, edge.1) } else { (edge.1, edge.0) };
                if here == at && seen.insert(there) {
                    stack.push(there);
                }
            }
        }
        seen
    };
    reach(true).intersection(&reach(false)).copied().collect()
}

fn direction(cx: &Context<'_>, ends: &[End<'_>], wanted: Direction, rule: &'static Rule) {
    for end in ends {
        let Some(said) = end.port.direction.said().filter(|said| said.value.0 != wanted) else { continue };
        let message = format!("`{}` is a {}, and a {wanted} belongs here", end.name(), said.value.0);
        let mend = format!("swap the ends of the channel, or make the port a {wanted}");
        cx.add(Finding::new(rule, &end.said.span, message, mend).also(&said.span, "the port says so here"));
    }
}

fn count(cx: &Context<'_>, channel: &RawChannel, source: Option<&End<'_>>) {
    let Some(list) = channel.destinations.said() else { return };
    if list.value.is_empty() {
        let mend = "name at least one port, or remove the channel";
        let finding = Finding::new(&catalogue::NO_DESTINATION, &list.span, "the channel leads nowhere", mend);
        cx.add(finding.also(&channel.span, "the channel"));
    }
    let Some(kind) = source.and_then(|source| source.port.kind.said()) else { return };
    if kind.value.0 == Kind::Queuing && list.value.len() > 1 {
        let message = format!("a queuing channel has {} destinations", list.value.len());
        let mend = "keep one, and add a source port and a channel for each of the others";
        let finding = Finding::new(&catalogue::QUEUING_SEVERAL_DESTINATIONS, &list.span, message, mend);
        cx.add(finding.also(&kind.span, "its source is queuing"));
    }
}

fn itself(cx: &Context<'_>, source: &End<'_>, destination: &End<'_>) {
    if source.owner == destination.owner {
        let name = cx.partition_name(source.owner);
        let message = format!("partition `{name}` sends to itself");
        let mend = "keep the value inside the partition, or name another destination";
        let finding = Finding::new(&catalogue::SELF_CHANNEL, &destination.said.span, message, mend);
        cx.add(finding.also(&source.said.span, "the source"));
    }
}

fn kind(cx: &Context<'_>, source: &End<'_>, destination: &End<'_>) {
    let (Some(from), Some(to)) = (source.port.kind.said(), destination.port.kind.said()) else { return };
    if from.value.0 != to.value.0 {
        let (name, one, other) = (destination.name(), to.value.0, from.value.0);
        let message = format!("`{name}` is {one}, but its source `{}` is {other}", source.name());
        let mend = "give both ports the same kind";
        let finding = Finding::new(&catalogue::KIND_MIXED, &destination.said.span, message, mend);
        cx.add(finding.also(&from.span, format!("{other} here")).also(&to.span, format!("{one} here")));
    }
}

/// What a port carries, and where it says so.
#[derive(PartialEq)]
enum Carried<'a> {
    Message(&'a str),
    Bytes(u32),
}

fn carried(port: &RawPort) -> Option<(Carried<'_>, &Span)> {
    match (port.message.said(), port.max_size.said()) {
        (Some(message), None) => Some((Carried::Message(&message.value), &message.span)),
        (None, Some(size)) => Some((Carried::Bytes(size.value), &size.span)),
        _ => None,
    }
}

impl std::fmt::Display for Carried<'_> {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Message(name) => write!(formatter, "`{name}`"),
            Self::Bytes(size) => write!(formatter, "up to {size} bytes"),
        }
    }
}

fn payload(cx: &Context<'_>, source: &End<'_>, destination: &End<'_>) {
    let (Some((from, here)), Some((to, there))) = (carried(source.port), carried(destination.port)) else {
        return;
    };
    let is_unknown = |carried: &Carried<'_>| match carried {
        Carried::Message(name) => cx.catalogue.size_of(name).is_none(),
        Carried::Bytes(_) => false,
    };
    if is_unknown(&from) || is_unknown(&to) {
        // Another rule reports it; what was meant may well be the same.
        return;
    }
    let rule = match (&from, &to) {
        (Carried::Bytes(from), Carried::Bytes(to)) if from > to => &catalogue::DESTINATION_TOO_SMALL,
        (Carried::Bytes(_), Carried::Bytes(_)) => return,
        _ if from == to => return,
        _ => &catalogue::MESSAGE_MISMATCH,
    };
    let message = format!("`{}` sends {from}, but `{}` takes {to}", source.name(), destination.name());
    let mend = match from {
        Carried::Message(name) => format!("let both say `message = \"{name}\"`"),
        Carried::Bytes(size) => format!("let both say `max_size = {size}`"),
    };
    let finding = Finding::new(rule, &destination.said.span, message, mend);
    cx.add(finding.also(here, "what is sent").also(there, "what is taken"));
}

fn time(cx: &Context<'_>, source: &End<'_>, destination: &End<'_>) {
    for schedule in &cx.plan.schedules {
        let writes = schedule.starts(source.owner);
        let reads = schedule.starts(destination.owner);
        if writes.is_empty() || reads.is_empty() {
            continue;
        }
        let found = stale(cx, schedule, &writes, source, destination)
            || overflowing(cx, schedule, (&writes, &reads), source, destination);
        if found {
            // The next schedule would say the same.
            break;
        }
    }
}

fn stale(
    cx: &Context<'_>,
    schedule: &Schedule,
    writes: &[u64],
    source: &End<'_>,
    destination: &End<'_>,
) -> bool {
    let Some(refresh) = destination.port.refresh.said().filter(|refresh| refresh.value.0 > 0) else {
        return false;
    };
    if destination.port.kind.word() != Some(Kind::Sampling) {
        return false;
    }
    let (name, limit) = (destination.name(), ShowTime(refresh.value.0));
    let period = gaps(writes, schedule.major_frame_ns).max().unwrap_or_default();
    let age = age_when_read(cx, schedule, source, destination);
    let (message, needed) = if refresh.value.0 < period {
        let period = ShowTime(period);
        (format!("`{name}` is valid for {limit}, but its source is written every {period} at best"), period)
    } else if refresh.value.0 < age {
        let age = ShowTime(age);
        (format!("`{name}` is valid for {limit}, but is up to {age} old when its window opens"), age)
    } else {
        return false;
    };
    let mend = format!("make the refresh period longer than {needed}");
    let finding = Finding::new(&catalogue::REFRESH_TOO_SHORT, &refresh.span, message, mend);
    cx.add(finding.also(&source.said.span, "the source"));
    true
}

/// The greatest age of a value as a reading window opens, counted from the opening of the window that wrote it.
fn age_when_read(cx: &Context<'_>, schedule: &Schedule, source: &End<'_>, destination: &End<'_>) -> u64 {
    let Some(legs) = ways::legs(cx.plan, &[source.owner, destination.owner]) else { return 0 };
    let stations = ways::stations(schedule, &legs);
    let ways = latency::ways(&stations, schedule.major_frame_ns);
    let age = |way: &Vec<latency::Visit>| match way.as_slice() {
        [write, .., read] => read.start_ns.abs_diff(write.start_ns),
        _ => 0,
    };
    ways.iter().map(age).max().unwrap_or_default().saturating_add(latency::phase_error_ns(&stations))
}

fn overflowing(
    cx: &Context<'_>,
    schedule: &Schedule,
    (writes, reads): (&[u64], &[u64]),
    source: &End<'_>,
    destination: &End<'_>,
) -> bool {
    let Some(depth) = destination.port.depth.said().filter(|depth| depth.value > 0) else { return false };
    // Over a link they come in the bursts of the relay: all that were written since its last window.
    let major_ns = schedule.major_frame_ns;
    let burst = ways::legs(cx.plan, &[source.owner, destination.owner])
        .filter(|legs| legs.len() > 2)
        .map_or(0, |legs| most_between(writes, &schedule.starts(legs[1].0), major_ns));
    let most = most_between(writes, reads, major_ns) + burst;
    if destination.port.kind.word() != Some(Kind::Queuing) || most <= u64::from(depth.value) {
        return false;
    }
    let name = destination.name();
    let message =
        format!("`{name}` holds {} of up to {most} messages that come between two reads", depth.value);
    let mend = format!("make it {most} deep, or let its partition run more often");
    let finding = Finding::new(&catalogue::QUEUE_TOO_SHALLOW, &depth.span, message, mend);
    cx.add(finding.also(&source.said.span, "one message in each window of the source"));
    true
}

/// Every port is in one channel.
fn once(cx: &Context<'_>) {
    let mut sources = HashMap::new();
    let mut sinks = HashMap::new();
    for (_, source, destinations) in ends(cx) {
        if let Some(end) = source {
            claim(cx, &mut sources, &end, (&catalogue::SOURCE_TWICE, "is the source of two channels"));
        }
        for end in destinations {
            claim(cx, &mut sinks, &end, (&catalogue::DESTINATION_TWICE, "is fed twice"));
        }
    }
}

fn claim<'a>(
    cx: &Context<'_>,
    claimed: &mut HashMap<PortId, &'a Span>,
    end: &End<'a>,
    (rule, what): (&'static Rule, &str),
) {
    let Some(first) = claimed.get(&end.id) else {
        claimed.insert(end.id, &end.said.span);
        return;
    };
    let mend = match end.port.direction.word() {
        Some(Direction::Source) => "list all its destinations in one channel",
        _ => "keep one of the two, or add a port for the other",
    };
    let finding = Finding::new(rule, &end.said.span, format!("`{}` {what}", end.name()), mend);
    cx.add(finding.also(first, "it is here before"));
}
