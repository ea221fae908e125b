//! Rules about what joins modules: networks, addresses, links, relays, and who follows whose major frame.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::net::SocketAddr;

use bateleur_contract::packing::{Waiting, datagrams_needed};
use bateleur_contract::relay::{MOST_LINKS, SENDING_NS, share_of_a_window};

use super::Context;
use super::laid::Laid;
use crate::catalogue;
use crate::closed::{Kind, ModuleClock, Transport};
use crate::cycle::within;
use crate::defaults;
use crate::findings::{Finding, Span};
use crate::latency::Hop;
use crate::links::{self, Carried, LARGEST_DATAGRAM, LONGEST_GAP_MS, SMALLEST_DATAGRAM};
use crate::raw::{RawFile, RawLink, RawSchedule};
use crate::reader::At;
use crate::relays::{self, Crossing};
use crate::units::{ShowRate, ShowTime};
use bateleur_plan::timeline::gaps;

pub(super) fn check(cx: &Context<'_>, laid: &[Laid]) {
    let crossings = relays::crossings(cx.file, cx.names);
    addresses(cx);
    for network in &cx.file.networks {
        if let Some(rate) = network.rate.said().filter(|rate| rate.value.0 == 0) {
            let message = format!("network `{}` carries nothing", network.name.value);
            cx.note(&catalogue::RATE_EXCEEDED, &rate.span, message, "write the rate of its slowest part");
        }
    }
    for (place, link) in cx.file.links.iter().enumerate() {
        ends(cx, place, link);
        networks(cx, link);
        key(cx, link);
        gap(cx, link);
        size(cx, link);
        not_zero(cx, link);
        unused(cx, place, link, &crossings);
    }
    too_many(cx);
    transports(cx);
    carried(cx, &crossings);
    relay_names(cx, &crossings);
    relay_windows(cx, laid, &crossings);
    rates(cx);
    follows(cx);
    alignable(cx);
}

/// A partition on a path, and how the value comes to it.
#[derive(Clone, Copy)]
pub(super) struct Leg {
    pub(super) partition: usize,
    pub(super) hop: Option<Hop>,
}

/// Whether two partitions are on different modules.
pub(super) fn is_across(cx: &Context<'_>, one: usize, other: usize) -> bool {
    match (cx.names.module_of(cx.file, one), cx.names.module_of(cx.file, other)) {
        (Some(one), Some(other)) => one != other,
        _ => false,
    }
}

/// The partitions of a path with the relays between them; nothing where modules are not joined.
pub(super) fn legs(cx: &Context<'_>, stations: &[usize]) -> Option<Vec<Leg>> {
    let mut legs: Vec<Leg> = Vec::new();
    let first = cx.names.module_of(cx.file, *stations.first()?)?;
    for &partition in stations {
        let module = cx.names.module_of(cx.file, partition)?;
        if let Some(before) = legs.last() {
            let from = cx.names.module_of(cx.file, before.partition)?;
            if from != module {
                let link = &cx.file.links[cx.names.link_between(cx.file, from, module)?];
                let relay =
                    |module: usize| cx.names.partition(&relays::name(&cx.file.modules[module].name.value));
                let hop = Hop {
                    latency_ns: latency_ns(cx, link),
                    aligned_within_ns: aligned_within_ns(cx, from, module),
                    beside_first_ns: beside_ns(cx, (first, from), module),
                };
                legs.push(Leg { partition: relay(from)?, hop: None });
                legs.push(Leg { partition: relay(module)?, hop: Some(hop) });
            }
        }
        legs.push(Leg { partition, hop: None });
    }
    Some(legs)
}

/// The slowest network counts: it may be the one that is left.
fn latency_ns(cx: &Context<'_>, link: &RawLink) -> u64 {
    let networks =
        cx.names.link_networks(cx.file, link).into_iter().map(|network| &cx.file.networks[network]);
    let max_bytes = link.max_bytes.get().unwrap_or(defaults::MAX_BYTES);
    let latency = networks.map(|network| {
        let latency_ns = network.latency.get().map_or(defaults::NETWORK_LATENCY_NS, |latency| latency.0);
        let rate = network.rate.get().map_or(0, |rate| rate.0);
        latency_ns.saturating_add(bateleur_plan::local::time_on_the_wire_ns(max_bytes, rate))
    });
    latency.max().unwrap_or_default()
}

/// How far apart the frames of two modules may begin, ns; `None`: anyhow.
pub(super) fn aligned_within_ns(cx: &Context<'_>, one: usize, other: usize) -> Option<u64> {
    let (first, own) = followed_to_the_end(cx, one);
    let (second, others) = followed_to_the_end(cx, other);
    (first == second).then_some(own.saturating_add(others))
}

/// How much later than planned the frames of `module` may begin against those of a path's first module; where both have no common
/// phase, against those of the module `from` before it.
fn beside_ns(cx: &Context<'_>, (first, from): (usize, usize), module: usize) -> u64 {
    if first == module {
        return 0;
    }
    aligned_within_ns(cx, first, module).or_else(|| aligned_within_ns(cx, from, module)).unwrap_or(0)
}

fn followed_to_the_end(cx: &Context<'_>, module: usize) -> (usize, u64) {
    let (mut at, mut error_ns) = (module, 0_u64);
    for _ in 0..cx.file.modules.len() {
        let raw = &cx.file.modules[at];
        let Some(leader) = raw.follows.said().and_then(|leader| cx.names.module(&leader.value)) else {
            break;
        };
        let within = raw.follows_within.get().map_or(defaults::FOLLOWS_WITHIN_NS, |within| within.0);
        error_ns = error_ns.saturating_add(within);
        at = leader;
    }
    (at, error_ns)
}

fn addresses(cx: &Context<'_>) {
    let mut seen: HashMap<SocketAddr, (&Span, &str)> = HashMap::new();
    for module in &cx.file.modules {
        for (_, socket) in &module.addresses {
            let name = module.name.value.as_str();
            let Some((first, other)) = seen.insert(socket.value, (&socket.span, name)) else { continue };
            let message = format!("modules `{other}` and `{name}` are both at {}", socket.value);
            let message =
                if other == name { format!("module `{name}` is at {} twice", socket.value) } else { message };
            let mend = "give each interface of each module a number or a port of its own";
            let finding = Finding::new(&catalogue::ADDRESS_TWICE, &socket.span, message, mend);
            cx.add(finding.also(first, "it is here before"));
        }
    }
}

fn ends(cx: &Context<'_>, place: usize, link: &RawLink) {
    let Some(said) = link.modules.said() else { return };
    let name = &link.name.value;
    let names: BTreeSet<&str> = said.value.iter().map(|module| module.value.as_str()).collect();
    if said.value.len() != 2 || names.len() != 2 {
        let message = format!("link `{name}` joins {} module(s)", names.len());
        let mend = "name two modules, such as `modules = [\"fcu\", \"nav\"]`";
        cx.note(&catalogue::LINK_ENDS, &said.span, message, mend);
        return;
    }
    let Some([one, other]) = cx.names.link_ends(link) else { return };
    let Some(first) = cx.names.link_between(cx.file, one, other).filter(|&first| first != place) else {
        return;
    };
    let (one, other) = (&cx.file.modules[one].name.value, &cx.file.modules[other].name.value);
    let message = format!("modules `{one}` and `{other}` are joined twice");
    let finding = Finding::new(&catalogue::LINK_ENDS, &said.span, message, "keep one of the two links");
    cx.add(finding.also(&cx.file.links[first].name.span, "the first link"));
}

fn networks(cx: &Context<'_>, link: &RawLink) {
    let Some(ends) = cx.names.link_ends(link) else { return };
    let carrying = cx.names.link_networks(cx.file, link);
    let name = &link.name.value;
    for said in link.networks.said().into_iter().flat_map(|list| &list.value) {
        let Some(network) = cx.names.network(cx.file, &said.value) else { continue };
        for module in ends.iter().map(|&module| &cx.file.modules[module]) {
            let mut addresses = module.addresses.iter();
            if !addresses.any(|(name, _)| cx.names.network(cx.file, &name.value) == Some(network)) {
                let message =
                    format!("module `{}` has no address on network `{}`", module.name.value, said.value);
                let mend = format!("add `addresses = {{ {} = \"10.77.0.1:15300\" }}` to it", said.value);
                let finding = Finding::new(&catalogue::NO_NETWORK, &said.span, message, mend);
                cx.add(finding.also(&module.name.span, "the module"));
            }
        }
    }
    let span = link.networks.said().map_or(&link.name.span, |said| &said.span);
    let ends = ends.map(|module| cx.file.modules[module].name.value.as_str());
    match carrying.as_slice() {
        [] if link.networks.said().is_some_and(|said| !said.value.is_empty()) => {}
        [] => {
            let message = format!(
                "no network carries link `{name}`: `{}` and `{}` have none in common",
                ends[0], ends[1]
            );
            let mend = "give both modules an address on one network, better on two";
            cx.note(&catalogue::NO_NETWORK, span, message, mend);
        }
        [only] => {
            let message = format!("link `{name}` has one network, `{}`", cx.file.networks[*only].name.value);
            let mend =
                "nothing, if one cut may part the modules; else give both an address on a second network";
            cx.note(&catalogue::ONE_NETWORK, span, message, mend);
        }
        [_, _] => {}
        several => {
            let message = format!("link `{name}` has {} networks", several.len());
            let mend = "choose two, such as `networks = [\"a\", \"b\"]`";
            cx.note(&catalogue::TOO_MANY_NETWORKS, span, message, mend);
        }
    }
}

fn key(cx: &Context<'_>, link: &RawLink) {
    let name = &link.name.value;
    let bare = link.unauthenticated.said().filter(|said| said.value);
    match (link.key.said(), bare) {
        (Some(key), Some(bare)) => {
            let message = format!("link `{name}` has a key, and is not to use it");
            let mend = "remove `unauthenticated`, or `key`";
            let finding = Finding::new(&catalogue::NO_KEY, &bare.span, message, mend);
            cx.add(finding.also(&key.span, "the key"));
        }
        (None, None) if link.key.is_absent() => {
            let message = format!("link `{name}` has no key");
            let mend = format!(
                "add `key = \"keys/{name}.key\"` (`bateleur key FILE` makes one), or `unauthenticated = true` where \
                 nobody else is on the network"
            );
            cx.note(&catalogue::NO_KEY, &link.name.span, message, mend);
        }
        (Some(key), None) => {
            if let Some(fault) = cx.keys.and_then(|keys| keys.fault(&key.value)) {
                let message = format!("the key of link `{name}`, `{}`: {fault}", key.value);
                let mend = "make one with `bateleur key FILE`, and carry it to the other host";
                cx.note(&catalogue::KEY_FILE, &key.span, message, mend);
            }
        }
        _ => {}
    }
}

fn gap(cx: &Context<'_>, link: &RawLink) {
    let Some(gap) = link.gap.said() else { return };
    let ms = gap.value.0 / 1_000_000;
    let fits = gap.value.0.is_multiple_of(1_000_000) && ms.is_power_of_two() && ms <= LONGEST_GAP_MS;
    if !fits {
        let message = format!("the gap of link `{}` is {}", link.name.value, ShowTime(gap.value.0));
        let near = ms.clamp(1, LONGEST_GAP_MS).next_power_of_two();
        let mend =
            format!("choose a power of two from \"1ms\" to \"{LONGEST_GAP_MS}ms\", such as \"{near}ms\"");
        cx.note(&catalogue::BAD_GAP, &gap.span, message, mend);
    }
}

fn size(cx: &Context<'_>, link: &RawLink) {
    let Some(max) = link.max_bytes.said() else { return };
    if !(SMALLEST_DATAGRAM..=LARGEST_DATAGRAM).contains(&max.value) {
        let message = format!("a datagram of link `{}` has up to {} bytes", link.name.value, max.value);
        let mend = format!(
            "write a number from {SMALLEST_DATAGRAM} to {LARGEST_DATAGRAM}; {} fits into one Ethernet frame",
            defaults::MAX_BYTES
        );
        cx.note(&catalogue::DATAGRAM_SIZE, &max.span, message, mend);
    }
}

fn not_zero(cx: &Context<'_>, link: &RawLink) {
    for (key, field) in [("skew", &link.skew), ("lost_after", &link.lost_after)] {
        if let Some(time) = field.said().filter(|time| time.value.0 == 0) {
            cx.note(&catalogue::ZERO_TIME, &time.span, format!("`{key}` is zero"), "write a time above zero");
        }
    }
}

fn unused(cx: &Context<'_>, place: usize, link: &RawLink, crossings: &[Crossing]) {
    let Some(ends) = cx.names.link_ends(link) else { return };
    let first = cx.names.link_between(cx.file, ends[0], ends[1]) == Some(place);
    if first && !crossings.iter().any(|one| ends.contains(&one.from) && ends.contains(&one.to)) {
        let message = format!("no channel leads over link `{}`", link.name.value);
        let mend = "remove it, or move a partition to the other module";
        cx.note(&catalogue::LINK_UNUSED, &link.name.span, message, mend);
    }
}

fn too_many(cx: &Context<'_>) {
    for (number, module) in cx.file.modules.iter().enumerate() {
        let has = |link: &&RawLink| cx.names.link_ends(link).is_some_and(|ends| ends.contains(&number));
        let links: Vec<&RawLink> = cx.file.links.iter().filter(has).collect();
        let Some(first_beyond) = links.get(MOST_LINKS) else { continue };
        let message = format!("module `{}` has {} links", module.name.value, links.len());
        let mend =
            format!("join it with {MOST_LINKS} others at most, and let one of those carry for the rest");
        let finding = Finding::new(&catalogue::TOO_MANY_LINKS, &first_beyond.name.span, message, mend);
        cx.add(finding.also(&module.name.span, "the module"));
    }
}

fn transports(cx: &Context<'_>) {
    let mut seen: BTreeMap<usize, &RawLink> = BTreeMap::new();
    let of = |link: &RawLink| link.transport.get().map_or(defaults::TRANSPORT, |word| word.0);
    for link in &cx.file.links {
        if of(link) == Transport::Zenoh {
            let span = link.transport.said().map_or(&link.name.span, |said| &said.span);
            let message = format!(
                "link `{}` would speak `zenoh`, which the program `relay` does not contain",
                link.name.value
            );
            let mend = "leave `transport` out: it is \"udp\" then; gateway/zenoh is for relays that are built by hand";
            cx.add(Finding::new(&catalogue::TRANSPORT_ABSENT, span, message, mend));
        }
    }
    for link in &cx.file.links {
        for module in cx.names.link_ends(link).into_iter().flatten() {
            let first = *seen.entry(module).or_insert(link);
            if of(first) == of(link) {
                continue;
            }
            let span = link.transport.said().map_or(&link.name.span, |said| &said.span);
            let message = format!(
                "the relay of `{}` would speak `{}` on link `{}` and `{}` on link `{}`",
                cx.file.modules[module].name.value,
                of(first),
                first.name.value,
                of(link),
                link.name.value
            );
            let mend = "give all links of a module one transport";
            let finding = Finding::new(&catalogue::TRANSPORTS_DIFFER, span, message, mend);
            cx.add(finding.also(&first.name.span, "the other link"));
            return;
        }
    }
}

/// Every crossing has a link.
fn carried(cx: &Context<'_>, crossings: &[Crossing]) {
    for one in crossings {
        if cx.names.link_between(cx.file, one.from, one.to).is_some() {
            continue;
        }
        let destinations = cx.file.channels[one.channel].destinations.said();
        let Some(said) = destinations.and_then(|list| list.value.get(one.place)) else { continue };
        let (from, to) = (&cx.file.modules[one.from].name.value, &cx.file.modules[one.to].name.value);
        let message =
            format!("the channel to `{}` leads from module `{from}` to `{to}`, and no link does", said.value);
        let mend = format!(
            "add `[link.NAME]` with `modules = [\"{from}\", \"{to}\"]`, or put both partitions on one module"
        );
        let finding = Finding::new(&catalogue::NO_LINK, &said.span, message, mend);
        let source = cx.file.channels[one.channel].source.said();
        cx.add(match source {
            Some(source) => finding.also(&source.span, "its source"),
            None => finding,
        });
    }
}

fn needing(crossings: &[Crossing]) -> BTreeSet<usize> {
    crossings.iter().flat_map(|one| [one.from, one.to]).collect()
}

fn relay_names(cx: &Context<'_>, crossings: &[Crossing]) {
    for module in needing(crossings) {
        let module = &cx.file.modules[module].name.value;
        let own = cx.names.partition(&relays::name(module)).map(|place| &cx.file.partitions[place]);
        if let Some(taken) = own.filter(|partition| !partition.generated) {
            let message = format!("`{}` is the name of the relay of module `{module}`", taken.name.value);
            let mend = "rename the partition; a relay needs windows in the schedules, and no table";
            cx.note(&catalogue::RELAY_NAME_TAKEN, &taken.name.span, message, mend);
        }
    }
}

/// The generated relay of a module.
fn relay_of(cx: &Context<'_>, module: usize) -> Option<usize> {
    let place = cx.names.partition(&relays::name(&cx.file.modules[module].name.value))?;
    cx.file.partitions[place].generated.then_some(place)
}

fn relay_windows(cx: &Context<'_>, laid: &[Laid], crossings: &[Crossing]) {
    let unknown = |schedule: &&crate::raw::RawSchedule| {
        schedule.windows.iter().any(|window| cx.names.owner(window).is_none())
    };
    for module in needing(crossings) {
        let Some(relay) = relay_of(cx, module) else { continue };
        let name = &cx.file.partitions[relay].name.value;
        for (schedule, laid) in cx.file.schedules.iter().zip(laid) {
            let has = schedule.windows.iter().any(|window| cx.names.owner(window) == Some(relay));
            if has {
                in_windows(cx, (schedule, laid), (module, relay), crossings);
            } else if !unknown(&schedule) {
                let module = &cx.file.modules[module].name;
                let message = format!(
                    "`{name}` carries what crosses at module `{}`, and has no window in schedule `{}`",
                    module.value, schedule.name.value
                );
                let mend = format!(
                    "add `{{ partition = \"{name}\", offset = \"…\", duration = \"500us\" }}` to its windows"
                );
                let finding =
                    Finding::new(&catalogue::RELAY_NOT_SCHEDULED, &schedule.name.span, message, mend);
                cx.add(finding.also(&module.span, "the module"));
            }
        }
    }
}

/// Gap, load and patience of each link of a module, against the windows of its relay, and all of them against the shortest.
fn in_windows(
    cx: &Context<'_>,
    (schedule, laid): (&RawSchedule, &Laid),
    (module, relay): (usize, usize),
    crossings: &[Crossing],
) {
    let mut sent: Vec<u64> = Vec::new();
    let mut windows = laid.windows(relay);
    windows.sort_unstable();
    let starts: Vec<u64> = windows.iter().map(|window| window.0).collect();
    let (Some(shortest), Some(longest)) = (gaps(&starts, laid.major).min(), gaps(&starts, laid.major).max())
    else {
        return;
    };
    let name = &cx.file.partitions[relay].name.value;
    for (place, link) in cx.file.links.iter().enumerate() {
        let Some(ends) = cx.names.link_ends(link).filter(|ends| ends.contains(&module)) else { continue };
        if cx.names.link_between(cx.file, ends[0], ends[1]) != Some(place) {
            continue;
        }
        let datagrams = load(cx, laid, (module, &windows), link, crossings);
        gap_fits(cx, name, link, datagrams.unwrap_or(1), shortest);
        takes_all(cx, (schedule, laid), (module, relay), link, (crossings, longest));
        sent.extend(datagrams);
        let patience = link.lost_after.get().map_or(defaults::LOST_AFTER_NS, |after| after.0);
        if patience < longest.saturating_mul(2) {
            let span = link.lost_after.said().map_or(&link.name.span, |said| &said.span);
            let message = format!(
                "a network of link `{}` counts as down after {} of silence, and `{name}` sends every {} at best",
                link.name.value,
                ShowTime(patience),
                ShowTime(longest)
            );
            let mend = format!("set `lost_after` to {} or more", ShowTime(longest.saturating_mul(2)));
            cx.note(&catalogue::SILENCE_TOO_SHORT, span, message, mend);
        }
    }
    long_enough(cx, (schedule, relay), &sent);
}

/// Whether a window's last datagram is a gap before the first of the next window, `shortest` after it.
fn gap_fits(cx: &Context<'_>, relay: &str, link: &RawLink, datagrams: u64, shortest: u64) {
    let Some(gap) = link.gap.said().filter(|gap| gap.value.0.saturating_mul(datagrams) > shortest) else {
        return;
    };
    let several = match datagrams {
        1 => String::new(),
        more => format!(" sends up to {more} datagrams of it in a window and"),
    };
    let message = format!(
        "the gap of link `{}` is {}, and `{relay}`{several} has a window every {}",
        link.name.value,
        ShowTime(gap.value.0),
        ShowTime(shortest)
    );
    let mend = match datagrams {
        1 => "shorten the gap, or give the relay fewer windows with `minor`",
        _ => "shorten the gap, let `max_bytes` be larger, or give the relay windows that are further apart",
    };
    cx.note(&catalogue::GAP_TOO_LONG, &gap.span, message, mend);
}

/// Whether the shortest window of a relay is as long as sending takes that has so many datagrams for each link.
fn long_enough(cx: &Context<'_>, (schedule, relay): (&RawSchedule, usize), sent: &[u64]) {
    let own = schedule.windows.iter().filter(|window| cx.names.owner(window) == Some(relay));
    let Some(shortest) = own.filter_map(|window| window.duration.said()).min_by_key(|said| said.value.0)
    else {
        return;
    };
    let datagrams = sent.iter().copied().fold(0, u64::saturating_add);
    let takes_ns = datagrams.saturating_mul(SENDING_NS);
    if takes_ns <= shortest.value.0 {
        return;
    }
    let message = format!(
        "`{}` sends {datagrams} datagram(s) for {} link(s) in a window, which take up to {}, and has one of {}",
        cx.file.partitions[relay].name.value,
        sent.len(),
        ShowTime(takes_ns),
        ShowTime(shortest.value.0)
    );
    let mend = format!(
        "let the window last {} or longer, let `max_bytes` be larger where a link needs several, or let less cross",
        ShowTime(takes_ns)
    );
    cx.note(&catalogue::RELAY_WINDOW_SHORT, &shortest.span, message, mend);
}

/// Whether a relay takes in a window what may have come over a link since the one before, `longest` ago: else more and more waits,
/// until the link is dead.
fn takes_all(
    cx: &Context<'_>,
    (schedule, laid): (&RawSchedule, &Laid),
    (module, relay): (usize, usize),
    link: &RawLink,
    (crossings, longest): (&[Crossing], u64),
) {
    let Some(sender) = cx.names.link_ends(link).and_then(|ends| ends.into_iter().find(|&end| end != module))
    else {
        return;
    };
    let Some(come) = most_that_come(cx, laid, sender, link, (crossings, longest)) else { return };
    let of_module = |link: &RawLink| match cx.names.link_ends(link) {
        Some(ends) if ends.contains(&module) => cx.names.link_networks(cx.file, link).len(),
        _ => 0,
    };
    let share = share_of_a_window(cx.file.links.iter().map(of_module).sum()) as u64;
    if come <= share {
        return;
    }
    let name = &cx.file.partitions[relay].name.value;
    let own = schedule.windows.iter().find(|window| cx.names.owner(window) == Some(relay));
    let span = own.and_then(|window| window.duration.said()).map_or(&schedule.name.span, |said| &said.span);
    let message = format!(
        "`{name}` takes {share} datagrams of a network of link `{}` in a window, and up to {come} come between two of its windows",
        link.name.value
    );
    let other = relays::name(&cx.file.modules[sender].name.value);
    let mend = format!("give `{name}` more windows, or `{other}` fewer with `minor`");
    cx.note(&catalogue::RELAY_TAKES_TOO_FEW, span, message, mend);
}

/// The most datagrams of a network of a link that a module's relay sends within a span of time.
fn most_that_come(
    cx: &Context<'_>,
    laid: &Laid,
    sender: usize,
    link: &RawLink,
    (crossings, span): (&[Crossing], u64),
) -> Option<u64> {
    let mut windows = laid.windows(relay_of(cx, sender)?);
    windows.sort_unstable();
    let need = needs(cx, laid, (sender, &windows), link, crossings)?;
    let starts: Vec<u64> = windows.iter().map(|window| window.0).collect();
    // And of one more: what datagrams are late by on their way is not the same for all.
    let most =
        starts.iter().map(|&start| within(&starts, (start, span), laid.major)).max().unwrap_or_default();
    let sending = most + 1;
    Some(sending.saturating_mul(need.datagrams.min(need.most)))
}

/// What a relay has to send over a link in a window.
struct Need {
    load: Vec<Waiting>,
    /// The datagrams that it needs for that.
    datagrams: u64,
    /// Those that the gap lets it send.
    most: u64,
}

fn needs(
    cx: &Context<'_>,
    laid: &Laid,
    (module, windows): (usize, &[(u64, u64)]),
    link: &RawLink,
    crossings: &[Crossing],
) -> Option<Need> {
    let (ends, gap) = (cx.names.link_ends(link)?, link.gap.said()?);
    let max_bytes = link.max_bytes.get().unwrap_or(defaults::MAX_BYTES);
    if gap.value.0 == 0 || max_bytes < SMALLEST_DATAGRAM {
        return None; // reported already
    }
    let outgoing = crossings.iter().filter(|one| one.from == module && ends.contains(&one.to));
    // A channel crosses each link once, however many destinations it has there.
    let channels: BTreeMap<usize, usize> = outgoing.map(|one| (one.channel, one.source)).collect();
    let carried: Vec<Carried> =
        channels.values().filter_map(|&source| carried_of(cx, laid, source)).collect();
    let starts: Vec<u64> = windows.iter().map(|window| window.0).collect();
    let load = links::window_load(&carried, &starts, laid.major);
    let shortest = windows.iter().map(|(start, end)| end - start).min().unwrap_or_default();
    let (datagrams, most) = (datagrams_needed(&load, max_bytes), links::datagrams_in(shortest, gap.value.0));
    Some(Need { load, datagrams, most })
}

/// Looks at what a link has to send in a window; gives the datagrams that the relay makes of it.
fn load(
    cx: &Context<'_>,
    laid: &Laid,
    (module, windows): (usize, &[(u64, u64)]),
    link: &RawLink,
    crossings: &[Crossing],
) -> Option<u64> {
    let Need { load, datagrams: needed, most } = needs(cx, laid, (module, windows), link, crossings)?;
    let (gap, max_bytes) = (link.gap.said()?, link.max_bytes.get().unwrap_or(defaults::MAX_BYTES));
    if needed > most {
        let span = link.max_bytes.said().map_or(&gap.span, |said| &said.span);
        let message = format!(
            "`{}` has up to {} bytes for link `{}` in a window, which need up to {needed} datagrams of {max_bytes} bytes, and the gap \
             lets it send {most}",
            relays::name(&cx.file.modules[module].name.value),
            links::load_bytes(&load),
            link.name.value
        );
        let enough = links::enough_bytes(&load, most)
            .map_or_else(String::new, |bytes| format!("let `max_bytes` be {bytes}, "));
        let mend = format!("{enough}make the gap smaller against the window, or let less cross");
        cx.note(&catalogue::WINDOW_LOAD, span, message, mend);
    }
    Some(needed.min(most))
}

fn carried_of(cx: &Context<'_>, laid: &Laid, source: usize) -> Option<Carried> {
    let port = &cx.file.ports[source];
    let bytes = match (port.message.said(), port.max_size.get()) {
        (Some(message), _) => u64::try_from(cx.catalogue.size_of(&message.value)?).ok()?,
        (None, size) => size?.into(),
    };
    let queuing = port.kind.get()?.0 == Kind::Queuing;
    Some(Carried { bytes, queuing, writes: laid.starts(port.partition) })
}

/// What is promised on each network from each module is there.
fn rates(cx: &Context<'_>) {
    for (place, network) in cx.file.networks.iter().enumerate() {
        let Some(rate) = network.rate.said().filter(|rate| rate.value.0 > 0) else { continue };
        for (number, module) in cx.file.modules.iter().enumerate() {
            let mine: Vec<&RawLink> = links_on(cx.file, cx, place, number);
            let used: u64 = mine.iter().filter_map(|link| reserved(link)).fold(0, u64::saturating_add);
            let Some(last) = mine.last().filter(|_| used > rate.value.0) else { continue };
            let message = format!(
                "module `{}` may send {} on network `{}`, which carries {}",
                module.name.value,
                ShowRate(used),
                network.name.value,
                ShowRate(rate.value.0)
            );
            let span = last.gap.said().map_or(&last.name.span, |gap: &At<_>| &gap.span);
            let mend = "make gaps longer or `max_bytes` smaller";
            let finding = Finding::new(&catalogue::RATE_EXCEEDED, span, message, mend);
            cx.add(finding.also(&rate.span, "the network"));
        }
    }
}

fn links_on<'a>(file: &'a RawFile, cx: &Context<'_>, network: usize, module: usize) -> Vec<&'a RawLink> {
    let on = |link: &&RawLink| {
        cx.names.link_ends(link).is_some_and(|ends| ends.contains(&module))
            && cx.names.link_networks(file, link).contains(&network)
    };
    file.links.iter().filter(on).collect()
}

fn reserved(link: &RawLink) -> Option<u64> {
    let max_bytes = link.max_bytes.get().unwrap_or(defaults::MAX_BYTES);
    Some(links::reserved_bits_per_s(max_bytes, link.gap.get()?.0))
}

fn follows(cx: &Context<'_>) {
    for (place, module) in cx.file.modules.iter().enumerate() {
        if let Some(within) = module.follows_within.said() {
            if within.value.0 == 0 {
                cx.note(
                    &catalogue::ZERO_TIME,
                    &within.span,
                    "`follows_within` is zero",
                    "write a time above zero",
                );
            } else if module.follows.is_absent() && !on_realtime(module) {
                let message = format!("module `{}` follows nobody", module.name.value);
                cx.note(&catalogue::MISPLACED_KEY, &within.span, message, "remove it, or add `follows`");
            }
        }
        let Some(said) = module.follows.said() else { continue };
        if on_realtime(module) {
            let message = format!(
                "module `{}` follows both `{}` and the disciplined clock",
                module.name.value, said.value
            );
            let mend = "remove `follows`, or `clock = \"realtime\"`";
            cx.note(&catalogue::MISPLACED_KEY, &said.span, message, mend);
        }
        let Some(leader) = cx.names.module(&said.value) else { continue };
        if comes_back(cx, place) {
            let message = format!("module `{}` follows itself, through `{}`", module.name.value, said.value);
            let message = if leader == place {
                format!("module `{}` follows itself", module.name.value)
            } else {
                message
            };
            let mend = "let one of them follow nobody";
            cx.note(&catalogue::FOLLOWS_IN_CIRCLE, &said.span, message, mend);
        } else if cx.names.link_between(cx.file, place, leader).is_none() {
            let message =
                format!("no link joins `{}` and `{}`, which it follows", module.name.value, said.value);
            let mend = format!("follow a module that it has a link with, or add one to `{}`", said.value);
            cx.note(&catalogue::FOLLOWS_WITHOUT_LINK, &said.span, message, mend);
        }
    }
}

/// The end of a frame is moved to align it, and what it is moved by is agreed upon in a word that holds nine minutes.
const LONGEST_ALIGNED_NS: u64 = 540_000_000_000;

/// Notes major frames that are too long to be aligned with others.
fn alignable(cx: &Context<'_>) {
    let aligned = |module: &&crate::raw::RawModule| module.follows.said().is_some() || on_realtime(module);
    let Some(module) = cx.file.modules.iter().find(aligned) else { return };
    for schedule in &cx.file.schedules {
        let Some(major) = schedule.major_frame.said().filter(|major| major.value.0 > LONGEST_ALIGNED_NS)
        else {
            continue;
        };
        let message = format!(
            "the major frame of {} is too long for module `{}` to align it with another clock's",
            ShowTime(major.value.0),
            module.name.value
        );
        let mend =
            format!("shorten it to {}, or let the module keep its own time", ShowTime(LONGEST_ALIGNED_NS));
        let finding = Finding::new(&catalogue::FRAME_TOO_LONG, &major.span, message, mend);
        cx.add(finding.also(&module.name.span, "the module"));
    }
}

fn on_realtime(module: &crate::raw::RawModule) -> bool {
    module.clock.get().is_some_and(|clock| clock.0 == ModuleClock::Realtime)
}

/// Whether following leads from a module back to it.
fn comes_back(cx: &Context<'_>, module: usize) -> bool {
    let next = |at: usize| {
        let said = cx.file.modules[at].follows.said()?;
        cx.names.module(&said.value)
    };
    let mut at = module;
    for _ in 0..cx.file.modules.len() {
        match next(at) {
            Some(leader) if leader == module => return true,
            Some(leader) => at = leader,
            None => return false,
        }
    }
    false
}
