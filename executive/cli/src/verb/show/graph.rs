//! The channels as a graph of the partitions: boxes from left to right in the order of their windows, solid lines for
//! sampling, dashed for queuing. A plan for several modules has each box's module under its name, and thick lines where a
//! channel crosses; relays are no ends of channels and not drawn.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

use bateleur_plan::{Kind, Module, PartitionId, Plan};

use super::layout::{self, Layout, Line, Point};
use super::picture::{colour, escaped};

const COLUMN: i64 = 190;
const BOX_WIDTH: i64 = 130;
const BOX_HEIGHT: i64 = 32;
const MARGIN: i64 = 24;
/// Room below for what the lines mean.
const FOOT: i64 = 40;

/// What goes from one partition to another by channels of one kind.
#[derive(Debug, Default)]
struct Link {
    /// "port → port", from the first partition to the second.
    there: Vec<String>,
    /// From the second to the first: queuing channels that answer each other are one line.
    back: Vec<String>,
    /// The link between modules that carries it.
    carrier: Option<String>,
}

/// By the earlier partition, the later one, whether it is queuing, and whether a sampling link leads back.
type Links = BTreeMap<(usize, usize, bool, bool), Link>;

/// The partitions in the order of their first windows in the initial schedule.
fn in_order_of_time(plan: &Plan) -> Vec<PartitionId> {
    let windows = &plan[plan.initial_schedule()].windows;
    let first = |id: PartitionId| {
        let mine = windows.iter().filter(|window| window.partition == id);
        mine.filter_map(|window| Some((window.minor.first().copied()?, window.offset_ns))).min()
    };
    let mut ids: Vec<PartitionId> = plan.partition_ids().filter(|&id| !plan[id].relay).collect();
    ids.sort_by_key(|&id| (first(id).is_none(), first(id), id));
    ids
}

fn links(plan: &Plan, order: &[PartitionId]) -> Links {
    let place = |id: PartitionId| order.iter().position(|&other| other == id).unwrap_or(0);
    let mut links = Links::new();
    for channel in &plan.channels {
        let source = &plan[channel.source];
        for &destination in &channel.destinations {
            let (from, to) = (place(source.partition), place(plan[destination].partition));
            if from == to {
                continue;
            }
            let (queuing, back) = (channel.kind == Kind::Queuing, from > to);
            let link = links.entry((from.min(to), from.max(to), queuing, back && !queuing)).or_default();
            let (one, other) = (plan[source.partition].module, plan[plan[destination].partition].module);
            link.carrier = plan.link_between(one, other).map(|link| plan[link].name.clone());
            let text = format!("{} → {}", source.name, plan[destination].name);
            if back { link.back.push(text) } else { link.there.push(text) }
        }
    }
    links
}

/// The layer of each partition: behind everybody that it takes something from, or gives something back to.
fn layers(links: &Links, count: usize) -> Vec<usize> {
    let mut layers = vec![0; count];
    for node in 0..count {
        let before = links.keys().filter(|key| key.1 == node).map(|key| layers[key.0] + 1);
        layers[node] = before.max().unwrap_or(0);
    }
    layers
}

/// The graph for Graphviz.
pub(super) fn dot(plan: &Plan) -> String {
    let mut out = String::from("digraph channels {\n    rankdir = LR;\n    node [shape = box];\n");
    let own = |module: &Module| {
        let mine = plan.partitions.iter().filter(|partition| !partition.relay);
        mine.filter(|partition| plan[partition.module].name == module.name).collect::<Vec<_>>()
    };
    for module in &plan.modules {
        let several = plan.modules.len() > 1;
        if several {
            let _ = writeln!(out, "    subgraph \"cluster_{0}\" {{ label = \"{0}\";", module.name);
        }
        for partition in own(module) {
            let _ = writeln!(out, "    \"{}\";", partition.name);
        }
        if several {
            out.push_str("    }\n");
        }
    }
    for channel in &plan.channels {
        let source = &plan[channel.source];
        for &destination in &channel.destinations {
            let to = &plan[destination];
            let style = if channel.kind == Kind::Queuing { ", style = dashed" } else { "" };
            let (one, other) = (plan[source.partition].module, plan[to.partition].module);
            let wide = if one == other { "" } else { ", penwidth = 3" };
            let _ = writeln!(
                out,
                "    \"{}\" -> \"{}\" [label = \"{} → {}\"{style}{wide}];",
                plan[source.partition].name, plan[to.partition].name, source.name, to.name
            );
        }
    }
    out + "}\n"
}

/// The graph as a picture.
pub(super) fn svg(plan: &Plan) -> String {
    let order = in_order_of_time(plan);
    let links = links(plan, &order);
    let layers = layers(&links, order.len());
    let hub = hub(&links, order.len());
    let line = |&(from, to, queuing, back): &(usize, usize, bool, bool)| {
        // A sampling value spreads from its source; queues gather at whoever has most of them.
        let gathers = if queuing { to == hub } else { back };
        Line { from, to, bus: usize::from(queuing) * 2 + usize::from(back), gathers }
    };
    let lines: Vec<Line> = links.keys().map(line).collect();
    let layout = layout::place(&layers, &lines);
    let columns = layers.iter().max().map_or(1, |last| i64::try_from(last + 1).unwrap_or(1));
    let width = columns * COLUMN - (COLUMN - BOX_WIDTH) + 2 * MARGIN;
    let height = layout.height + FOOT;
    let mut body = String::new();
    edges(&mut body, &links, &layout, &order);
    boxes(&mut body, plan, &layout, &order);
    foot(&mut body, height - 14);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" \
         font-family=\"sans-serif\" font-size=\"13\" fill=\"#222222\">\n<title>the channels between the partitions</title>\n\
         <defs><marker id=\"tip\" viewBox=\"0 0 8 8\" refX=\"8\" refY=\"4\" markerWidth=\"7\" markerHeight=\"7\" \
         orient=\"auto-start-reverse\"><path d=\"M0 0 8 4 0 8Z\" fill=\"#444444\"/></marker></defs>\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"#ffffff\"/>\n{body}</svg>\n"
    )
}

/// The partition with most queues.
fn hub(links: &Links, count: usize) -> usize {
    let queues = |node: usize| links.keys().filter(|key| key.2 && (key.0 == node || key.1 == node)).count();
    (0..count).max_by_key(|&node| (queues(node), std::cmp::Reverse(node))).unwrap_or(0)
}

fn centre(layout: &Layout, point: Point) -> (i64, i64) {
    let (layer, y) = layout.places.get(&point).copied().unwrap_or_default();
    (MARGIN + BOX_WIDTH / 2 + i64::try_from(layer).unwrap_or(0) * COLUMN, y)
}

fn edges(body: &mut String, links: &Links, layout: &Layout, order: &[PartitionId]) {
    let mut drawn = BTreeSet::new();
    for ((key, link), route) in links.iter().zip(&layout.routes) {
        let (from, to, queuing, back) = *key;
        let writer = if back { to } else { from };
        let stroke = if queuing { "#888888" } else { colour(order[writer]) };
        let dash = if queuing { " stroke-dasharray=\"5 4\"" } else { "" };
        for (step, pair) in route.windows(2).enumerate() {
            let start = step == 0 && !link.back.is_empty();
            let end = step + 2 == route.len() && !link.there.is_empty();
            if !drawn.insert((pair[0], pair[1], queuing, back)) {
                continue;
            }
            let tips = [(start, " marker-start=\"url(#tip)\""), (end, " marker-end=\"url(#tip)\"")];
            let tips: String = tips.iter().filter(|tip| tip.0).map(|tip| tip.1).collect();
            let width = if link.carrier.is_some() { "3.2" } else { "1.6" };
            let over = link.carrier.iter().map(|name| format!("over link {name}:"));
            let words: Vec<String> = over.chain([link.there.join(", "), link.back.join(", ")]).collect();
            let _ = writeln!(
                body,
                "<path d=\"{}\" fill=\"none\" stroke=\"{stroke}\" stroke-width=\"{width}\"{dash}{tips}><title>{}</title></path>",
                curve(layout, pair[0], pair[1]),
                escaped(&words.join(" "))
            );
        }
    }
}

/// From the right side of one point to the left side of the next; a line also crosses the column that it ends in.
fn curve(layout: &Layout, from: Point, to: Point) -> String {
    let half = BOX_WIDTH / 2;
    let ((x1, y1), (x2, y2)) = (centre(layout, from), centre(layout, to));
    let (left, right, bend) = (x1 + half, x2 - half, (COLUMN - BOX_WIDTH) / 2);
    let through = match to {
        Point::Through { .. } => format!(" H{}", x2 + half),
        Point::Node(_) => String::new(),
    };
    format!("M{left} {y1} C{} {y1} {} {y2} {right} {y2}{through}", left + bend, right - bend)
}

fn boxes(body: &mut String, plan: &Plan, layout: &Layout, order: &[PartitionId]) {
    for (node, &id) in order.iter().enumerate() {
        let (x, y) = centre(layout, Point::Node(node));
        let _ = writeln!(
            body,
            "<rect x=\"{}\" y=\"{}\" width=\"{BOX_WIDTH}\" height=\"{BOX_HEIGHT}\" rx=\"4\" fill=\"{}\"/>\
             <text x=\"{x}\" y=\"{}\" text-anchor=\"middle\" fill=\"#ffffff\">{}</text>",
            x - BOX_WIDTH / 2,
            y - BOX_HEIGHT / 2,
            colour(id),
            y + 4,
            escaped(&plan[id].name)
        );
        if plan.modules.len() > 1 {
            let _ = writeln!(
                body,
                "<text x=\"{x}\" y=\"{}\" text-anchor=\"middle\" font-size=\"10\" fill=\"#666666\">on {}</text>",
                y + BOX_HEIGHT / 2 + 11,
                escaped(&plan[plan[id].module].name)
            );
        }
    }
}

fn foot(body: &mut String, y: i64) {
    let _ = writeln!(
        body,
        "<path d=\"M{MARGIN} {0}h40\" stroke=\"#222222\" stroke-width=\"1.6\"/><text x=\"{1}\" y=\"{y}\">sampling, in the colour of the writer</text>\
         <path d=\"M340 {0}h40\" stroke=\"#888888\" stroke-width=\"1.6\" stroke-dasharray=\"5 4\"/><text x=\"390\" y=\"{y}\">queuing</text>",
        y - 4,
        MARGIN + 50
    );
}
