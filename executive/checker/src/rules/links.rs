//! Rules about what joins modules: networks, addresses, links, relays, and who follows whose major frame.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::net::SocketAddr;

use bateleur_contract::relay::{MOST_LINKS, SENDING_NS, share_of_a_window};

use super::Context;
use crate::catalogue;
use crate::closed::{ModuleClock, Transport};
use crate::cycle::within;
use crate::defaults;
use crate::findings::{Finding, Span};
use crate::links::{self, LARGEST_DATAGRAM, LONGEST_GAP_MS, SMALLEST_DATAGRAM, Sending};
use crate::model::{LinkId, ModuleId, NetworkId, PartitionId, Schedule};
use crate::raw::{RawLink, RawModule, RawSchedule};
use crate::reader::At;
use crate::units::{ShowRate, ShowTime};
use bateleur_plan::timeline::gaps;

pub(super) fn check(cx: &Context<'_>) {
    addresses(cx);
    for network in &cx.file.networks {
        if let Some(rate) = network.rate.said().filter(|rate| rate.value.0 == 0) {
            let message = format!("network `{}` carries nothing", network.name.value);
            cx.note(&catalogue::RATE_EXCEEDED, &rate.span, message, "write the rate of its slowest part");
        }
    }
    for (id, link) in cx.links() {
        joined(cx, id, link);
        networks(cx, id, link);
        key(cx, link);
        gap(cx, link);
        size(cx, link);
        not_zero(cx, link);
        unused(cx, id, link);
    }
    too_many(cx);
    transports(cx);
    carried(cx);
    relay_windows(cx);
    rates(cx);
    follows(cx);
    alignable(cx);
}

/// The modules of a link, where they are known, and two.
fn ends(cx: &Context<'_>, id: LinkId) -> Option<[ModuleId; 2]> {
    Some(cx.plan[id].ends).filter(|ends| ends[0] != cx.nobody.module)
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

fn joined(cx: &Context<'_>, id: LinkId, link: &RawLink) {
    let Some(said) = link.modules.said() else { return };
    let name = &link.name.value;
    let names: BTreeSet<&str> = said.value.iter().map(|module| module.value.as_str()).collect();
    if said.value.len() != 2 || names.len() != 2 {
        let message = format!("link `{name}` joins {} module(s)", names.len());
        let mend = "name two modules, such as `modules = [\"fcu\", \"nav\"]`";
        cx.note(&catalogue::LINK_ENDS, &said.span, message, mend);
        return;
    }
    let Some([one, other]) = ends(cx, id) else { return };
    let Some(first) = cx.plan.link_between(one, other).filter(|&first| first != id) else { return };
    let message =
        format!("modules `{}` and `{}` are joined twice", cx.module_name(one), cx.module_name(other));
    let finding = Finding::new(&catalogue::LINK_ENDS, &said.span, message, "keep one of the two links");
    cx.add(finding.also(&cx.file.links[first.0].name.span, "the first link"));
}

fn networks(cx: &Context<'_>, id: LinkId, link: &RawLink) {
    let Some(ends) = ends(cx, id) else { return };
    let carrying = &cx.plan[id].networks;
    let name = &link.name.value;
    for said in link.networks.items() {
        let named = carrying.iter().find(|network| cx.plan[**network].name == said.value);
        let Some(&network) = named else { continue };
        for module in ends.iter().filter(|module| cx.plan[**module].address_on(network).is_none()) {
            let message =
                format!("module `{}` has no address on network `{}`", cx.module_name(*module), said.value);
            let mend = format!("add `addresses = {{ {} = \"10.77.0.1:15300\" }}` to it", said.value);
            let finding = Finding::new(&catalogue::NO_NETWORK, &said.span, message, mend);
            cx.add(finding.also(&cx.file.modules[module.0].name.span, "the module"));
        }
    }
    let span = link.networks.said().map_or(&link.name.span, |said| &said.span);
    let ends = ends.map(|module| cx.module_name(module));
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
            let message = format!("link `{name}` has one network, `{}`", cx.plan[*only].name);
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

fn unused(cx: &Context<'_>, id: LinkId, link: &RawLink) {
    let Some([one, other]) = ends(cx, id) else { return };
    let carries = |from: ModuleId| cx.plan.carried(id, from).next().is_some();
    if cx.plan.link_between(one, other) == Some(id) && !carries(one) && !carries(other) {
        let message = format!("no channel leads over link `{}`", link.name.value);
        let mend = "remove it, or move a partition to the other module";
        cx.note(&catalogue::LINK_UNUSED, &link.name.span, message, mend);
    }
}

fn too_many(cx: &Context<'_>) {
    for (id, module) in cx.modules() {
        let links: Vec<LinkId> = cx.plan.links_of(id).collect();
        let Some(first_beyond) = links.get(MOST_LINKS) else { continue };
        let message = format!("module `{}` has {} links", module.name.value, links.len());
        let mend =
            format!("join it with {MOST_LINKS} others at most, and let one of those carry for the rest");
        let span = &cx.file.links[first_beyond.0].name.span;
        let finding = Finding::new(&catalogue::TOO_MANY_LINKS, span, message, mend);
        cx.add(finding.also(&module.name.span, "the module"));
    }
}

fn transports(cx: &Context<'_>) {
    let mut seen: BTreeMap<ModuleId, LinkId> = BTreeMap::new();
    let of = |id: LinkId| cx.plan[id].transport;
    let span = |link: &RawLink| link.transport.said().map_or(&link.name.span, |said| &said.span).clone();
    for (id, link) in cx.links() {
        if of(id) == Transport::Zenoh {
            let message = format!(
                "link `{}` would speak `zenoh`, which the program `relay` does not contain",
                link.name.value
            );
            let mend = "leave `transport` out: it is \"udp\" then; gateway/zenoh is for relays that are built by hand";
            cx.add(Finding::new(&catalogue::TRANSPORT_ABSENT, &span(link), message, mend));
        }
    }
    for (id, link) in cx.links() {
        for module in ends(cx, id).into_iter().flatten() {
            let first = *seen.entry(module).or_insert(id);
            if of(first) == of(id) {
                continue;
            }
            let other = &cx.file.links[first.0].name;
            let message = format!(
                "the relay of `{}` would speak `{}` on link `{}` and `{}` on link `{}`",
                cx.module_name(module),
                of(first),
                other.value,
                of(id),
                link.name.value
            );
            let mend = "give all links of a module one transport";
            let finding = Finding::new(&catalogue::TRANSPORTS_DIFFER, &span(link), message, mend);
            cx.add(finding.also(&other.span, "the other link"));
            return;
        }
    }
}

/// Everything that crosses has a link.
fn carried(cx: &Context<'_>) {
    for (raw, channel) in cx.file.channels.iter().zip(&cx.plan.channels) {
        let Some(from) = cx.module_of(cx.plan[channel.source].partition) else { continue };
        for (said, destination) in raw.destinations.items().iter().zip(&channel.destinations) {
            let Some(to) = cx.module_of(cx.plan[*destination].partition) else { continue };
            if to == from || cx.plan.link_between(from, to).is_some() {
                continue;
            }
            let (from, to) = (cx.module_name(from), cx.module_name(to));
            let message = format!(
                "the channel to `{}` leads from module `{from}` to `{to}`, and no link does",
                said.value
            );
            let mend = format!(
                "add `[link.NAME]` with `modules = [\"{from}\", \"{to}\"]`, or put both partitions on one module"
            );
            let finding = Finding::new(&catalogue::NO_LINK, &said.span, message, mend);
            cx.add(match raw.source.said() {
                Some(source) => finding.also(&source.span, "its source"),
                None => finding,
            });
        }
    }
}

fn relay_windows(cx: &Context<'_>) {
    for (relay, raw_relay) in cx.partitions().filter(|(_, partition)| partition.generated) {
        let (name, module) = (cx.partition_name(relay), cx.plan[relay].module);
        for (raw, schedule) in cx.schedules() {
            if schedule.runs(relay) {
                in_windows(cx, (raw, schedule), (module, relay));
            } else if !cx.has_window_of_nobody(schedule) {
                let message = format!(
                    "`{name}` carries what crosses at module `{}`, and has no window in schedule `{}`",
                    cx.module_name(module),
                    schedule.name
                );
                let mend = format!(
                    "add `{{ partition = \"{name}\", offset = \"…\", duration = \"500us\" }}` to its windows"
                );
                let finding = Finding::new(&catalogue::RELAY_NOT_SCHEDULED, &raw.name.span, message, mend);
                cx.add(finding.also(&raw_relay.name.span, "the module"));
            }
        }
    }
}

/// Gap, load and patience of each link of a module, against the windows of its relay, and all of them against the shortest.
fn in_windows<'a>(
    cx: &Context<'a>,
    (raw, schedule): (&'a RawSchedule, &'a Schedule),
    (module, relay): (ModuleId, PartitionId),
) {
    let starts = schedule.starts(relay);
    let waits = || gaps(&starts, schedule.major_frame_ns);
    let (Some(shortest), Some(longest)) = (waits().min(), waits().max()) else { return };
    let (name, mut sent) = (cx.partition_name(relay), Vec::new());
    let first_of_two = |id: &LinkId| {
        let [one, other] = cx.plan[*id].ends;
        cx.plan.link_between(one, other) == Some(*id)
    };
    for id in cx.plan.links_of(module).filter(first_of_two) {
        let link = &cx.file.links[id.0];
        let datagrams = load(cx, schedule, (module, name), id);
        gap_fits(cx, name, link, datagrams.unwrap_or(1), shortest);
        takes_all(cx, (raw, schedule), (module, relay), id, longest);
        sent.extend(datagrams);
        let patience = cx.plan[id].lost_after_ns;
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
    long_enough(cx, (raw, schedule), relay, &sent);
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
fn long_enough<'a>(
    cx: &Context<'a>,
    pair: (&'a RawSchedule, &'a Schedule),
    relay: PartitionId,
    sent: &[u64],
) {
    let durations = cx.windows_of(pair, relay).filter_map(|window| window.duration.said());
    let Some(shortest) = durations.min_by_key(|said| said.value.0) else { return };
    let datagrams = sent.iter().copied().fold(0, u64::saturating_add);
    let takes_ns = datagrams.saturating_mul(SENDING_NS);
    if takes_ns <= shortest.value.0 {
        return;
    }
    let message = format!(
        "`{}` sends {datagrams} datagram(s) for {} link(s) in a window, which take up to {}, and has one of {}",
        cx.partition_name(relay),
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
fn takes_all<'a>(
    cx: &Context<'a>,
    (raw, schedule): (&'a RawSchedule, &'a Schedule),
    (module, relay): (ModuleId, PartitionId),
    id: LinkId,
    longest: u64,
) {
    let Some(sender) = cx.plan[id].peer_of(module) else { return };
    let Some(come) = most_that_come(cx, schedule, sender, id, longest) else { return };
    let networks = cx.plan.links_of(module).map(|link| cx.plan[link].networks.len()).sum();
    let share = share_of_a_window(networks) as u64;
    if come <= share {
        return;
    }
    let name = cx.partition_name(relay);
    let own = cx.windows_of((raw, schedule), relay).next();
    let span = own.and_then(|window| window.duration.said()).map_or(&raw.name.span, |said| &said.span);
    let message = format!(
        "`{name}` takes {share} datagrams of a network of link `{}` in a window, and up to {come} come between two of its windows",
        cx.plan[id].name
    );
    let other = cx.plan.relay_of(sender).map_or("?", |relay| cx.partition_name(relay));
    let mend = format!("give `{name}` more windows, or `{other}` fewer with `minor`");
    cx.note(&catalogue::RELAY_TAKES_TOO_FEW, span, message, mend);
}

/// The most datagrams of a network of a link that a module's relay sends within a span of time.
fn most_that_come(
    cx: &Context<'_>,
    schedule: &Schedule,
    sender: ModuleId,
    link: LinkId,
    span: u64,
) -> Option<u64> {
    let sending = Sending::of(cx.plan, schedule, link, sender)?;
    let starts = schedule.starts(cx.plan.relay_of(sender)?);
    let windows = starts.iter().map(|&start| within(&starts, (start, span), schedule.major_frame_ns));
    // And of one more: what datagrams are late by on their way is not the same for all.
    let windows = windows.max().unwrap_or_default() + 1;
    Some(windows.saturating_mul(sending.datagrams.min(sending.most)))
}

/// Looks at what a link has to send in a window; gives the datagrams that the relay makes of it.
fn load(cx: &Context<'_>, schedule: &Schedule, (module, relay): (ModuleId, &str), id: LinkId) -> Option<u64> {
    let Sending { load, datagrams: needed, most } = Sending::of(cx.plan, schedule, id, module)?;
    if needed > most {
        let link = &cx.file.links[id.0];
        let gap = link.gap.said().map_or(&link.name.span, |said| &said.span);
        let span = link.max_bytes.said().map_or(gap, |said| &said.span);
        let message = format!(
            "`{relay}` has up to {} bytes for link `{}` in a window, which need up to {needed} datagrams of {} bytes, and the gap \
             lets it send {most}",
            links::load_bytes(&load),
            link.name.value,
            cx.plan[id].max_bytes
        );
        let enough = links::enough_bytes(&load, most)
            .map_or_else(String::new, |bytes| format!("let `max_bytes` be {bytes}, "));
        let mend = format!("{enough}make the gap smaller against the window, or let less cross");
        cx.note(&catalogue::WINDOW_LOAD, span, message, mend);
    }
    Some(needed.min(most))
}

/// What is promised on each network from each module is there.
fn rates(cx: &Context<'_>) {
    for (place, network) in cx.file.networks.iter().enumerate() {
        let Some(rate) = network.rate.said().filter(|rate| rate.value.0 > 0) else { continue };
        for (id, module) in cx.modules() {
            let mine =
                cx.plan.links_of(id).filter(|link| cx.plan[*link].networks.contains(&NetworkId(place)));
            let mine: Vec<LinkId> = mine.collect();
            let promised = |link: &LinkId| {
                let gap = cx.file.links[link.0].gap.said()?;
                Some(links::reserved_bits_per_s(cx.plan[*link].max_bytes, gap.value.0))
            };
            let used: u64 = mine.iter().filter_map(promised).fold(0, u64::saturating_add);
            let Some(last) = mine.last().filter(|_| used > rate.value.0) else { continue };
            let message = format!(
                "module `{}` may send {} on network `{}`, which carries {}",
                module.name.value,
                ShowRate(used),
                network.name.value,
                ShowRate(rate.value.0)
            );
            let last = &cx.file.links[last.0];
            let span = last.gap.said().map_or(&last.name.span, |gap: &At<_>| &gap.span);
            let mend = "make gaps longer or `max_bytes` smaller";
            let finding = Finding::new(&catalogue::RATE_EXCEEDED, span, message, mend);
            cx.add(finding.also(&rate.span, "the network"));
        }
    }
}

fn follows(cx: &Context<'_>) {
    for (id, module) in cx.modules() {
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
        let Some(leader) = cx.plan[id].follows else { continue };
        if comes_back(cx, id) {
            let message = format!("module `{}` follows itself, through `{}`", module.name.value, said.value);
            let message =
                if leader == id { format!("module `{}` follows itself", module.name.value) } else { message };
            let mend = "let one of them follow nobody";
            cx.note(&catalogue::FOLLOWS_IN_CIRCLE, &said.span, message, mend);
        } else if cx.plan.link_between(id, leader).is_none() {
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
    let aligned = |module: &&RawModule| module.follows.said().is_some() || on_realtime(module);
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

fn on_realtime(module: &RawModule) -> bool {
    module.clock.word() == Some(ModuleClock::Realtime)
}

/// Whether following leads from a module back to it.
fn comes_back(cx: &Context<'_>, module: ModuleId) -> bool {
    let led = std::iter::successors(cx.plan[module].follows, |at| cx.plan[*at].follows);
    led.take(cx.file.modules.len()).any(|leader| leader == module)
}
