//! The text of `README.md`: the tables of ports and attributes, whose last columns are the author's.

use std::fmt::Write;

use bateleur_plan::Role;

use super::skeleton::Skeleton;

pub(super) fn text(skeleton: &Skeleton) -> String {
    let mut out = format!(
        "# {}\n\nSay here what the partition is for, and what it must never do.\n",
        skeleton.partition
    );
    if !skeleton.ports.is_empty() {
        out += "\n| port | direction | message | |\n|---|---|---|---|\n";
    }
    for port in &skeleton.ports {
        let role = match port.role {
            Role::SamplingSource => "source, sampling",
            Role::SamplingDestination { .. } => "destination, sampling",
            Role::QueuingSource => "source, queuing",
            Role::QueuingDestination { .. } => "destination, queuing",
        };
        let _ = writeln!(out, "| `{}` | {role} | `{}` | |", port.name, port.content.type_name());
    }
    if !skeleton.attributes.is_empty() {
        out += "\n| attribute | default | |\n|---|---|---|\n";
    }
    for attribute in &skeleton.attributes {
        let _ =
            writeln!(out, "| `{}` | `{}` | |", attribute.name.escape_debug(), attribute.reading.default());
    }
    if skeleton.retained_bytes.is_some() {
        out += "\nKept over a warm restart: the number of windows.\n";
    }
    out
}
