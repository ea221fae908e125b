//! Rules about channels: that both ends fit each other, in kind, message and time.

use std::collections::HashMap;

use super::Context;
use super::laid::Laid;
use super::windows::gaps;
use crate::plan::catalogue::{self, Rule};
use crate::plan::closed::{Direction, Kind};
use crate::plan::findings::{Finding, Span};
use crate::plan::raw::{RawChannel, RawPort};
use crate::plan::reader::At;
use crate::plan::units::ShowTime;

/// One end of a channel: how the channel names it, and the port.
#[derive(Clone, Copy)]
struct End<'a> {
    said: &'a At<String>,
    place: usize,
    port: &'a RawPort,
}

impl<'a> End<'a> {
    fn of(cx: &Context<'a>, said: &'a At<String>) -> Option<Self> {
        let place = cx.names.port(&said.value)?;
        Some(Self { said, place, port: &cx.file.ports[place] })
    }

    fn name(&self) -> &str {
        &self.said.value
    }
}

pub(super) fn check(cx: &Context<'_>, laid: &[Laid]) {
    for channel in &cx.file.channels {
        let source = channel.source.said().and_then(|said| End::of(cx, said));
        let destinations = destinations(cx, channel);
        direction(cx, source.as_slice(), Direction::Source, &catalogue::SOURCE_DIRECTION);
        direction(cx, &destinations, Direction::Destination, &catalogue::DESTINATION_DIRECTION);
        count(cx, channel, source.as_ref());
        for (source, destination) in
            source.iter().flat_map(|source| destinations.iter().map(move |end| (source, end)))
        {
            itself(cx, source, destination);
            kind(cx, source, destination);
            payload(cx, source, destination);
            time(cx, laid, source, destination);
        }
    }
    once(cx);
}

fn destinations<'a>(cx: &Context<'a>, channel: &'a RawChannel) -> Vec<End<'a>> {
    let list = channel.destinations.said().into_iter().flat_map(|list| &list.value);
    list.filter_map(|said| End::of(cx, said)).collect()
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
    if source.port.partition == destination.port.partition {
        let name = cx.partition_name(source.port.partition);
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

fn time(cx: &Context<'_>, laid: &[Laid], source: &End<'_>, destination: &End<'_>) {
    for laid in laid {
        let writes = laid.starts(source.port.partition);
        let reads = laid.starts(destination.port.partition);
        if writes.is_empty() || reads.is_empty() {
            continue;
        }
        let found = stale(cx, laid, &writes, source, destination)
            || overflowing(cx, laid, (&writes, &reads), source, destination);
        if found {
            // The next schedule would say the same.
            break;
        }
    }
}

fn stale(cx: &Context<'_>, laid: &Laid, writes: &[u64], source: &End<'_>, destination: &End<'_>) -> bool {
    let Some(refresh) = destination.port.refresh.said().filter(|refresh| refresh.value.0 > 0) else {
        return false;
    };
    let period = gaps(writes, laid.major).max().unwrap_or_default();
    if destination.port.kind.get().map(|kind| kind.0) != Some(Kind::Sampling) || refresh.value.0 >= period {
        return false;
    }
    let (name, limit) = (destination.name(), ShowTime(refresh.value.0));
    let message = format!(
        "`{name}` is valid for {limit}, but its source is written every {} at best",
        ShowTime(period)
    );
    let mend = format!("make the refresh period longer than {}", ShowTime(period));
    let finding = Finding::new(&catalogue::REFRESH_TOO_SHORT, &refresh.span, message, mend);
    cx.add(finding.also(&source.said.span, "the source"));
    true
}

fn overflowing(
    cx: &Context<'_>,
    laid: &Laid,
    (writes, reads): (&[u64], &[u64]),
    source: &End<'_>,
    destination: &End<'_>,
) -> bool {
    let Some(depth) = destination.port.depth.said().filter(|depth| depth.value > 0) else { return false };
    let most = most_between(writes, reads, laid.major);
    if destination.port.kind.get().map(|kind| kind.0) != Some(Kind::Queuing) || most <= u64::from(depth.value)
    {
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

/// How many instants of `writes` lie at most between two neighbours of `reads`, in a cycle.
fn most_between(writes: &[u64], reads: &[u64], cycle: u64) -> u64 {
    let spans = reads.iter().zip(gaps(reads, cycle));
    let inside = |start: u64, gap: u64| {
        let later = |write: &&u64| (**write + cycle - start) % cycle < gap;
        writes.iter().filter(later).count()
    };
    spans.map(|(&start, gap)| inside(start, gap)).max().unwrap_or_default() as u64
}

/// Every port is in one channel.
fn once(cx: &Context<'_>) {
    let mut sources = HashMap::new();
    let mut sinks = HashMap::new();
    for channel in &cx.file.channels {
        if let Some(end) = channel.source.said().and_then(|said| End::of(cx, said)) {
            claim(cx, &mut sources, &end, (&catalogue::SOURCE_TWICE, "is the source of two channels"));
        }
        for end in destinations(cx, channel) {
            claim(cx, &mut sinks, &end, (&catalogue::DESTINATION_TWICE, "is fed twice"));
        }
    }
}

fn claim<'a>(
    cx: &Context<'_>,
    claimed: &mut HashMap<usize, &'a Span>,
    end: &End<'a>,
    (rule, what): (&'static Rule, &str),
) {
    let Some(first) = claimed.get(&end.place) else {
        claimed.insert(end.place, &end.said.span);
        return;
    };
    let mend = match end.port.direction.get().map(|word| word.0) {
        Some(Direction::Source) => "list all its destinations in one channel",
        _ => "keep one of the two, or add a port for the other",
    };
    let finding = Finding::new(rule, &end.said.span, format!("`{}` {what}", end.name()), mend);
    cx.add(finding.also(first, "it is here before"));
}
