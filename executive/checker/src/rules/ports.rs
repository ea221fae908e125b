//! Rules about single ports: what each kind and direction needs, and that somebody is at the other end.

use super::Context;
use crate::catalogue::{self, Rule};
use crate::closed::{Direction, Kind};
use crate::findings::Span;
use crate::model::{Channel, PortId};
use crate::raw::{RawChannel, RawPort};
use crate::reader::Field;
use bateleur_plan::bounds::{DEEPEST_QUEUE, LONGEST_BYTES};

pub(super) fn check(cx: &Context<'_>) {
    for port in &cx.file.ports {
        if let (Some(kind), Some(direction)) = (port.kind.get(), port.direction.get()) {
            refresh(cx, port, kind.0, direction.0);
            depth(cx, port, kind.0, direction.0);
            if direction.0 == Direction::Destination {
                let said = port.operator.said().filter(|operator| operator.value);
                misplaced(cx, "operator", said.map(|at| &at.span), (kind.0, direction.0));
            }
        }
        payload(cx, port);
    }
    unconnected(cx);
}

fn refresh(cx: &Context<'_>, port: &RawPort, kind: Kind, direction: Direction) {
    if (kind, direction) != (Kind::Sampling, Direction::Destination) {
        misplaced(cx, "refresh", port.refresh.said().map(|at| &at.span), (kind, direction));
        return;
    }
    let name = &port.name;
    match &port.refresh {
        Field::Absent => {
            let message = format!("sampling destination `{}` has no `refresh`", name.value);
            let mend = "add the age up to which a value is valid, such as `refresh = \"40ms\"`";
            cx.note(&catalogue::REFRESH_MISSING, &name.span, message, mend);
        }
        Field::Said(refresh) if refresh.value.0 == 0 => {
            let message = format!("the refresh period of `{}` is zero", name.value);
            let mend = "write the age up to which a value is valid, such as \"40ms\"";
            cx.note(&catalogue::REFRESH_ZERO, &refresh.span, message, mend);
        }
        Field::Said(_) | Field::Broken => {}
    }
}

fn depth(cx: &Context<'_>, port: &RawPort, kind: Kind, direction: Direction) {
    if (kind, direction) != (Kind::Queuing, Direction::Destination) {
        misplaced(cx, "depth", port.depth.said().map(|at| &at.span), (kind, direction));
        return;
    }
    let name = &port.name;
    match &port.depth {
        Field::Absent => {
            let message = format!("queuing destination `{}` has no `depth`", name.value);
            let mend = "add how many messages may wait, such as `depth = 8`";
            cx.note(&catalogue::DEPTH_MISSING, &name.span, message, mend);
        }
        Field::Said(depth) if depth.value == 0 => {
            let message = format!("the queue of `{}` holds no message", name.value);
            cx.note(
                &catalogue::DEPTH_ZERO,
                &depth.span,
                message,
                "write how many messages may wait, such as 8",
            );
        }
        Field::Said(depth) => cx.at_in_range("depth", depth, 1, DEEPEST_QUEUE),
        Field::Broken => {}
    }
}

fn misplaced(cx: &Context<'_>, key: &str, span: Option<&Span>, (kind, direction): (Kind, Direction)) {
    if let Some(span) = span {
        let message = format!("a {kind} {direction} has no `{key}`");
        let mend = match key {
            "refresh" => "remove it: only a sampling destination has one",
            "operator" => "remove it: the operator writes, into a source",
            _ => "remove it: only a queuing destination has one",
        };
        cx.note(&catalogue::MISPLACED_KEY, span, message, mend);
    }
}

fn payload(cx: &Context<'_>, port: &RawPort) {
    if port.message.is_absent() && port.max_size.is_absent() {
        let message = format!("port `{}` does not say what it carries", port.name.value);
        let mend = "add `message = \"TYPE\"`, or `max_size = 256` for plain bytes";
        cx.note(&catalogue::PAYLOAD_MISSING, &port.name.span, message, mend);
    }
    if let Some(size) = port.max_size.said() {
        size_of(cx, port, size);
    }
}

fn size_of(cx: &Context<'_>, port: &RawPort, size: &crate::reader::At<u32>) {
    let rule: &'static Rule = &catalogue::PAYLOAD_TWICE;
    if let Some(message) = port.message.said() {
        let text = format!("port `{}` has both a message type and a size", port.name.value);
        let finding = super::Finding::new(rule, &size.span, text, "remove `max_size`: the type has a size");
        cx.add(finding.also(&message.span, "the message type"));
    } else if size.value == 0 {
        let message = format!("the longest message of `{}` has no byte", port.name.value);
        cx.note(&catalogue::PAYLOAD_ZERO, &size.span, message, "write its size in bytes, such as 256");
    } else {
        cx.at_in_range("max_size", size, 1, LONGEST_BYTES);
    }
}

fn unconnected(cx: &Context<'_>) {
    let nobody = cx.nobody.port;
    let is_unknown = |channel: &Channel| channel.source == nobody || channel.destinations.contains(&nobody);
    let is_broken = |channel: &RawChannel| channel.destinations.said().is_none();
    if cx.plan.channels.iter().any(is_unknown) || cx.file.channels.iter().any(is_broken) {
        // The channel of an unknown port, or one without an end, may well be the one that seems to be missing.
        return;
    }
    for (place, port) in cx.file.ports.iter().enumerate() {
        let id = PortId(place);
        if cx.plan[id].channel.is_none() {
            let message = format!("port `{}` is in no channel", cx.plan.port_path(id));
            let mend = "add it to a `[[channel]]`, or remove it";
            cx.note(&catalogue::PORT_UNCONNECTED, &port.name.span, message, mend);
        }
    }
}
