//! Rules about names: how they are written, that none is used twice, and that what they refer to is there.

use std::collections::HashMap;

use super::Context;
use crate::catalogue::{self, Rule};
use bateleur_plan::bounds::LONGEST_NAME;
use bateleur_plan::words::{did_you_mean, listed, nearest};

use crate::names::port_path;
use crate::reader::At;

pub(super) fn check(cx: &Context<'_>) {
    let file = cx.file;
    present(cx);
    set(cx, "module", file.modules.iter().map(|module| &module.name));
    set(cx, "network", file.networks.iter().map(|network| &network.name));
    set(cx, "link", file.links.iter().map(|link| &link.name));
    set(cx, "partition", file.partitions.iter().map(|partition| &partition.name));
    set(cx, "schedule", file.schedules.iter().map(|schedule| &schedule.name));
    for owner in 0..file.partitions.len() {
        set(cx, "port", file.ports.iter().filter(|port| port.partition == owner).map(|port| &port.name));
    }
    for partition in &file.partitions {
        set(cx, "process", partition.declared.iter().map(|process| &process.name));
    }
    unique(cx, "chain", file.chains.iter().filter_map(|chain| chain.name.said()));
    modules(cx);
    networks(cx);
    partitions(cx);
    ports(cx);
    messages(cx);
}

fn present(cx: &Context<'_>) {
    let file = cx.file;
    for (what, empty) in [("module", file.modules.is_empty()), ("partition", file.partitions.is_empty())] {
        if empty {
            let message = format!("the file has no {what}");
            cx.note(&catalogue::MISSING_KEY, &(0..0), message, format!("add `[{what}.NAME]`"));
        }
    }
}

fn set<'n>(cx: &Context<'_>, what: &str, names: impl Iterator<Item = &'n At<String>> + Clone) {
    for name in names.clone() {
        well_formed(cx, what, name);
    }
    unique(cx, what, names);
}

fn well_formed(cx: &Context<'_>, what: &str, name: &At<String>) {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    let fault = if name.value.is_empty() {
        "is empty".to_owned()
    } else if !name.value.chars().all(plain) {
        "has more in it than letters a to z and A to Z, digits, `_` and `-`".to_owned()
    } else if name.value.len() > LONGEST_NAME {
        format!("has {} characters, and {LONGEST_NAME} is the most", name.value.len())
    } else {
        return;
    };
    let message = format!("the {what} name `{}` {fault}", name.value);
    cx.note(&catalogue::BAD_NAME, &name.span, message, "choose a short plain name");
}

fn unique<'n>(cx: &Context<'_>, what: &str, names: impl Iterator<Item = &'n At<String>>) {
    let mut seen: HashMap<String, &At<String>> = HashMap::new();
    for name in names {
        match seen.get(&name.value.to_lowercase()) {
            None => {
                seen.insert(name.value.to_lowercase(), name);
            }
            Some(first) => twice(cx, what, first, name),
        }
    }
}

fn twice(cx: &Context<'_>, what: &str, first: &At<String>, second: &At<String>) {
    let message = if first.value == second.value {
        format!("two {what}s are called `{}`", second.value)
    } else {
        format!("the {what} names `{}` and `{}` differ only in case", first.value, second.value)
    };
    let finding =
        super::Finding::new(&catalogue::DUPLICATE_NAME, &second.span, message, "rename one of the two");
    cx.add(finding.also(&first.span, "the first one is here"));
}

fn modules(cx: &Context<'_>) {
    let of_partitions = cx.file.partitions.iter().filter_map(|partition| partition.module.said());
    let followed = cx.file.modules.iter().filter_map(|module| module.follows.said());
    let joined = cx.file.links.iter().filter_map(|link| link.modules.said()).flat_map(|list| &list.value);
    for module in of_partitions.chain(followed).chain(joined) {
        if cx.names.module(&module.value).is_none() {
            let known = cx.file.modules.iter().map(|module| module.name.value.as_str());
            unknown(cx, &catalogue::UNKNOWN_MODULE, ("module", module), known);
        }
    }
}

fn networks(cx: &Context<'_>) {
    let of_modules = cx.file.modules.iter().flat_map(|module| &module.addresses).map(|(network, _)| network);
    let of_links = cx.file.links.iter().filter_map(|link| link.networks.said()).flat_map(|list| &list.value);
    for network in of_modules.chain(of_links) {
        if cx.names.network(cx.file, &network.value).is_none() {
            let known = cx.file.networks.iter().map(|network| network.name.value.as_str());
            unknown(cx, &catalogue::UNKNOWN_NETWORK, ("network", network), known);
        }
    }
}

fn partitions(cx: &Context<'_>) {
    let windows = cx.file.schedules.iter().flat_map(|schedule| &schedule.windows);
    for partition in windows.filter_map(|window| window.partition.said()) {
        if cx.names.partition(&partition.value).is_none() {
            if idle_relay(cx, partition) {
                continue;
            }
            let known = cx.file.partitions.iter().map(|partition| partition.name.value.as_str());
            unknown(cx, &catalogue::UNKNOWN_PARTITION, ("partition", partition), known);
        }
    }
}

/// Notes a window of a relay that carries nothing, and says whether it is one.
fn idle_relay(cx: &Context<'_>, partition: &At<String>) -> bool {
    let module = partition.value.strip_prefix(crate::relays::PREFIX);
    let Some(module) = module.filter(|module| cx.names.module(module).is_some()) else { return false };
    let message =
        format!("there is no `{}`: no channel leads to module `{module}` or from it", partition.value);
    let mend = format!("remove its window, or move a partition to `{module}`");
    cx.note(&catalogue::UNKNOWN_PARTITION, &partition.span, message, mend);
    true
}

fn ports(cx: &Context<'_>) {
    let known: Vec<String> = cx.file.ports.iter().map(|port| port_path(cx.file, port)).collect();
    let sources = cx.file.channels.iter().filter_map(|channel| channel.source.said());
    let destinations = cx.file.channels.iter().filter_map(|channel| channel.destinations.said());
    let paths = cx.file.chains.iter().filter_map(|chain| chain.path.said());
    for port in sources.chain(destinations.chain(paths).flat_map(|list| &list.value)) {
        if cx.names.port(&port.value).is_none() {
            unknown_port(cx, port, &known);
        }
    }
}

fn unknown_port(cx: &Context<'_>, port: &At<String>, known: &[String]) {
    let why = match port.value.split_once('.') {
        None => ": a port is written `partition.port`".to_owned(),
        Some((partition, _)) if cx.names.partition(partition).is_none() => {
            format!(": no partition is called `{partition}`")
        }
        Some(_) => String::new(),
    };
    let message = format!("there is no port `{}`{why}", port.value);
    // All ports of a plan are too many to list; what has only the partition's name in common is not alike.
    let own_name = |path: &str| path.split_once('.').map(|(_, name)| name.to_owned()).unwrap_or_default();
    let wanted = own_name(&port.value);
    let alike = |path: &&str| wanted.is_empty() || nearest(&wanted, [own_name(path).as_str()]).is_some();
    let mend = match nearest(&port.value, known.iter().map(String::as_str).filter(alike)) {
        Some(near) => format!("did you mean `{near}`?"),
        None => ports_beside(cx, port),
    };
    cx.note(&catalogue::UNKNOWN_PORT, &port.span, message, mend);
}

/// The ports of the partition that an unknown port names, if there are any.
fn ports_beside(cx: &Context<'_>, port: &At<String>) -> String {
    let partition = port.value.split('.').next().unwrap_or_default();
    let owner = cx.names.partition(partition);
    let ports = cx.file.ports.iter().filter(|port| Some(port.partition) == owner);
    let ports: Vec<&str> = ports.map(|port| port.name.value.as_str()).collect();
    if ports.is_empty() {
        "declare it under its partition as `[partition.NAME.port.PORT]`".to_owned()
    } else {
        format!("the ports of `{partition}` are {}", listed(ports))
    }
}

fn messages(cx: &Context<'_>) {
    for message in cx.file.ports.iter().filter_map(|port| port.message.said()) {
        if cx.catalogue.size_of(&message.value).is_none() {
            let name = &message.value;
            let text = format!("there is no message type {}", listed([name.as_str()]));
            let near = did_you_mean(name, cx.catalogue.names());
            let end = if near.ends_with('?') { "" } else { "." };
            let mend = format!(
                "{near}{end} A type of your own is a file beside the schedule file, `messages/{name}.msg`: see docs/src/new-partition.md"
            );
            cx.note(&catalogue::UNKNOWN_MESSAGE, &message.span, text, mend);
        }
    }
}

fn unknown<'c>(
    cx: &Context<'_>,
    rule: &'static Rule,
    (what, name): (&str, &At<String>),
    known: impl IntoIterator<Item = &'c str>,
) {
    let message = format!("there is no {what} {}", listed([name.value.as_str()]));
    cx.note(rule, &name.span, message, did_you_mean(&name.value, known));
}
