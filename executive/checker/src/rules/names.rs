//! Rules about names: how they are written, that none is used twice, and that message types are there.

use std::collections::HashMap;

use super::Context;
use crate::catalogue;
use crate::reader::At;
use bateleur_plan::bounds::LONGEST_NAME;
use bateleur_plan::words::did_you_mean;

pub(super) fn check(cx: &Context<'_>) {
    let file = cx.file;
    present(cx);
    set(cx, "module", file.modules.iter().map(|module| &module.name));
    set(cx, "network", file.networks.iter().map(|network| &network.name));
    set(cx, "link", file.links.iter().map(|link| &link.name));
    set(cx, "partition", file.partitions.iter().map(|partition| &partition.name));
    set(cx, "memory block", file.memory_blocks.iter().map(|block| &block.name));
    set(cx, "name service", file.name_services.iter().map(|service| &service.name));
    for service in &file.name_services {
        set(cx, "service access point", service.addresses.iter().map(|(point, _)| point));
    }
    set(cx, "schedule", file.schedules.iter().map(|schedule| &schedule.name));
    for owner in 0..file.partitions.len() {
        set(cx, "port", file.ports.iter().filter(|port| port.partition == owner).map(|port| &port.name));
    }
    for partition in &file.partitions {
        set(cx, "process", partition.declared.iter().map(|process| &process.name));
        set(cx, "logbook", partition.logbooks.iter().map(|logbook| &logbook.name));
    }
    unique(cx, "chain", file.chains.iter().filter_map(|chain| chain.name.said()));
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

fn messages(cx: &Context<'_>) {
    if cx.findings.has(&catalogue::MESSAGES_UNUSABLE) {
        return; // none of one's own is known
    }
    for message in cx.file.ports.iter().filter_map(|port| port.message.said()) {
        if cx.catalogue.size_of(&message.value).is_none() {
            let name = &message.value;
            let text = format!("there is no message type `{name}`");
            let near = did_you_mean(name, cx.catalogue.names());
            let end = if near.ends_with('?') { "" } else { "." };
            let mend = format!(
                "{near}{end} A type of your own is a file beside the schedule file, `messages/{name}.msg`: see docs/src/new-partition.md"
            );
            cx.note(&catalogue::UNKNOWN_MESSAGE, &message.span, text, mend);
        }
    }
}
