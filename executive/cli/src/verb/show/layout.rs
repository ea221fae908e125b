//! Places the nodes of a graph in layers from left to right, so that few lines cross and none leads through a node.
//!
//! A line over several layers gets a point in each layer between, and lines that share a *bus* share those points: a value
//! that goes to many is drawn as one line that branches. The order within a layer is found by the mean of the neighbours,
//! as Sugiyama, Tagawa and Toda (1981) do; everything is decided by numbers of the input, so that the same graph gives the
//! same picture.

use std::collections::{BTreeMap, BTreeSet};

/// A line to be placed, from a node in an earlier layer to one in a later layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Line {
    pub(super) from: usize,
    pub(super) to: usize,
    /// Lines of one bus that begin at the same node (or end at the same, see `gathers`) share their points.
    pub(super) bus: usize,
    /// The bus gathers at the end of its lines instead of spreading from their beginning.
    pub(super) gathers: bool,
}

/// A point of the layout: a node, or where a bus goes through a layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Point {
    Node(usize),
    Through { bus: usize, end: usize, layer: usize },
}

/// Where everything is.
pub(super) struct Layout {
    /// Layer and height above zero of the middle, pixels.
    pub(super) places: BTreeMap<Point, (usize, i64)>,
    /// The points of each line, in the order of the lines.
    pub(super) routes: Vec<Vec<Point>>,
    /// The height of the whole, pixels.
    pub(super) height: i64,
}

const NODE_HEIGHT: i64 = 46;
const LINE_HEIGHT: i64 = 16;
const SWEEPS: usize = 24;

/// Places `layers` (the layer of each node) and `lines`.
pub(super) fn place(layers: &[usize], lines: &[Line]) -> Layout {
    let routes: Vec<Vec<Point>> = lines.iter().map(|line| route(layers, line)).collect();
    let count = layers.iter().max().map_or(0, |last| last + 1);
    let mut rows: Vec<Vec<Point>> = vec![Vec::new(); count];
    for (node, &layer) in layers.iter().enumerate() {
        rows[layer].push(Point::Node(node));
    }
    let mut beside: BTreeMap<Point, BTreeSet<Point>> = BTreeMap::new();
    for route in &routes {
        for pair in route.windows(2) {
            beside.entry(pair[0]).or_default().insert(pair[1]);
            beside.entry(pair[1]).or_default().insert(pair[0]);
        }
        for point in route {
            if let Point::Through { layer, .. } = *point
                && !rows[layer].contains(point)
            {
                rows[layer].push(*point);
            }
        }
    }
    order(&mut rows, &beside);
    let heights = settle(&rows, &beside);
    let least = heights.values().min().copied().unwrap_or(0);
    let most = heights.values().max().copied().unwrap_or(0);
    let layer_of = |point: &Point| match *point {
        Point::Node(node) => layers[node],
        Point::Through { layer, .. } => layer,
    };
    let places = heights.iter().map(|(point, y)| (*point, (layer_of(point), y - least + NODE_HEIGHT)));
    Layout { places: places.collect(), routes, height: most - least + 2 * NODE_HEIGHT }
}

fn route(layers: &[usize], line: &Line) -> Vec<Point> {
    let end = if line.gathers { line.to } else { line.from };
    let between = layers[line.from] + 1..layers[line.to];
    let through = between.map(|layer| Point::Through { bus: line.bus, end, layer });
    std::iter::once(Point::Node(line.from)).chain(through).chain([Point::Node(line.to)]).collect()
}

fn ranks(rows: &[Vec<Point>]) -> BTreeMap<Point, i64> {
    let row = |row: &Vec<Point>| {
        // Relative to the middle, so that rows of different lengths compare.
        let middle = i64::try_from(row.len()).unwrap_or(0);
        row.iter()
            .enumerate()
            .map(move |(place, point)| (*point, i64::try_from(place).unwrap_or(0) * 2 - middle))
            .collect::<Vec<_>>()
    };
    rows.iter().flat_map(row).collect()
}

/// Orders each row by the mean of the neighbours, forward and back.
fn order(rows: &mut [Vec<Point>], beside: &BTreeMap<Point, BTreeSet<Point>>) {
    for sweep in 0..SWEEPS {
        let count = rows.len();
        for step in 0..count {
            let layer = if sweep % 2 == 0 { step } else { count - 1 - step };
            let rank = ranks(rows);
            rows[layer]
                .sort_by_key(|point| (mean(beside.get(point), &rank, rank[point]), rank[point], *point));
        }
    }
}

/// The mean of the neighbours, in thousandths.
fn mean(neighbours: Option<&BTreeSet<Point>>, at: &BTreeMap<Point, i64>, own: i64) -> i64 {
    let values: Vec<i64> =
        neighbours.into_iter().flatten().filter_map(|point| at.get(point).copied()).collect();
    let count = i64::try_from(values.len()).unwrap_or(0);
    if count == 0 { own * 1000 } else { values.iter().sum::<i64>() * 1000 / count }
}

fn height(point: &Point) -> i64 {
    match point {
        Point::Node(_) => NODE_HEIGHT,
        Point::Through { .. } => LINE_HEIGHT,
    }
}

/// Heights that keep the order and the distances, and are near the mean of the neighbours.
fn settle(rows: &[Vec<Point>], beside: &BTreeMap<Point, BTreeSet<Point>>) -> BTreeMap<Point, i64> {
    let mut at: BTreeMap<Point, i64> = BTreeMap::new();
    for row in rows {
        let mut y = -row.iter().map(height).sum::<i64>() / 2;
        for point in row {
            at.insert(*point, y + height(point) / 2);
            y += height(point);
        }
    }
    for sweep in 0..SWEEPS {
        let layers: Vec<&Vec<Point>> =
            if sweep % 2 == 0 { rows.iter().collect() } else { rows.iter().rev().collect() };
        for row in layers {
            let wished: Vec<i64> =
                row.iter().map(|point| mean(beside.get(point), &at, at[point]) / 1000).collect();
            for (point, y) in row.iter().zip(spread(row, &wished)) {
                at.insert(*point, y);
            }
        }
    }
    at
}

/// The heights nearest to what is wished that keep the order and the distances: pressed together from both sides, and the
/// middle of the two.
fn spread(row: &[Point], wished: &[i64]) -> Vec<i64> {
    let apart = |above: usize| (height(&row[above]) + height(&row[above + 1])) / 2;
    let mut down = wished.to_vec();
    for place in 1..row.len() {
        down[place] = down[place].max(down[place - 1] + apart(place - 1));
    }
    let mut up = wished.to_vec();
    for place in (1..row.len()).rev() {
        up[place - 1] = up[place - 1].min(up[place] - apart(place - 1));
    }
    down.iter().zip(&up).map(|(down, up)| i64::midpoint(*down, *up)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_a_layer_keep_their_distance() {
        let layers = [0, 1, 1, 1, 2];
        let line = |from, to| Line { from, to, bus: from, gathers: false };
        let lines = [line(0, 1), line(0, 2), line(0, 3), line(0, 4), line(1, 4), line(3, 4)];
        let layout = place(&layers, &lines);
        for layer in 0..3 {
            let mut row: Vec<(i64, i64)> = layout
                .places
                .iter()
                .filter(|(_, at)| at.0 == layer)
                .map(|(point, at)| (at.1, height(point)))
                .collect();
            row.sort_unstable();
            for pair in row.windows(2) {
                assert!(pair[1].0 - pair[0].0 >= (pair[0].1 + pair[1].1) / 2 - 1, "{row:?}");
            }
        }
        assert_eq!(layout.routes[3].len(), 3, "through the layer between");
    }

    #[test]
    fn a_bus_is_one_line_until_it_branches() {
        let lines = [2, 3].map(|to| Line { from: 0, to, bus: 7, gathers: false });
        let layout = place(&[0, 1, 2, 2], &lines);
        assert_eq!(layout.routes[0][1], layout.routes[1][1]);
    }
}
