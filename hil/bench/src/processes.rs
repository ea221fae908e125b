//! Figures of partitions of several processes: services, switches, and how late an urgent process runs.

use std::time::Duration;

use anyhow::{Context, Result};

use super::row::{Reach, Row};
use super::sketch::{Sketched, schedule};
use super::statistics::{median, quantile};
use super::{Settings, module, probe};

/// A frame, and the partition's window in it: offset and length, us. Who computes for more than 95 % of a second at real-time priority is held
/// back by the kernel.
const FRAME_US: u64 = 20_000;
const WINDOW_US: (u64, u64) = (500, 15_000);
/// Before the end of the window no wait of a millisecond begins any more, us.
const BEFORE_END_US: u64 = 3_000;
/// Rounds of two threads for the reference of a switch.
const FUTEX_ROUNDS: u32 = 20_000;

/// The rows of partitions of several processes.
pub(super) fn rows(settings: &Settings) -> Result<Vec<Row>> {
    let mut rows = services(settings)?;
    rows.extend(switches(settings)?);
    rows.extend(releases(settings)?);
    rows.extend(traits(settings)?);
    Ok(rows)
}

/// Sampling ports by the traits of `a653rs`.
fn traits(settings: &Settings) -> Result<Vec<Row>> {
    const LENGTH_S: f64 = 5.0;
    let partition = |name: &str, window, direction: &str| {
        let mut partition = Sketched::new(name, "", &[window]);
        partition.program = "bateleur_bench_a653rs".into();
        partition.attributes.clear();
        partition.threads = 2;
        let refresh = if direction == "destination" { "refresh = \"1s\"\n" } else { "" };
        partition.more = format!(
            "[partition.{name}.port.data]\ndirection = \"{direction}\"\nkind = \"sampling\"\nmax_size = 64\n{refresh}"
        );
        partition
    };
    let partitions =
        [partition("writes", (500, 8_000), "source"), partition("reads", (10_000, 8_000), "destination")];
    let channel = "\n[[channel]]\nsource = \"writes.data\"\ndestinations = [\"reads.data\"]\n";
    let text = schedule(settings.core, FRAME_US, &partitions, &[]) + channel;
    let [write, read] = medians(settings, ["write", "read"], || {
        let ended = module::start(&text, LENGTH_S)?.end()?;
        Ok([values(&ended.words_of("writes")), values(&ended.words_of("reads"))].concat())
    })?;
    let [raw_write, raw_read] = super::ports::raw(settings.core, if settings.quick { 20 } else { 300 })?;
    let row = |name: &str, value: f64, raw: f64| {
        Row::measured(name, "ns", value, Some(raw), Reach::Times(1.5), super::ports::RAW)
    };
    Ok(vec![
        row("a653rs, sampling port, write, 64 B", write, raw_write),
        row("a653rs, sampling port, read again, 64 B", read, raw_read),
    ])
}

/// Names and values in what a partition has said, ns.
fn values(words: &str) -> Vec<(String, f64)> {
    let lines = words.lines().filter_map(|line| {
        let (name, value) = line.rsplit_once(' ')?;
        Some((name.rsplit(' ').next()?.to_owned(), value.parse().ok()?))
    });
    lines.collect()
}

/// What a partition that measures has said: names and values, ns.
fn said(settings: &Settings, attributes: &str, threads: u32, length_s: f64) -> Result<Vec<(String, f64)>> {
    let mut partition = Sketched::new("own", "", &[WINDOW_US]);
    partition.program = "bateleur_bench_processes".into();
    attributes.clone_into(&mut partition.attributes);
    partition.threads = threads;
    let text = schedule(settings.core, FRAME_US, &[partition], &[]);
    Ok(values(&module::start(&text, length_s)?.end()?.words_of("own")))
}

/// The medians over the runs of the values with these names.
fn medians<const N: usize>(
    settings: &Settings,
    names: [&str; N],
    measure: impl Fn() -> Result<Vec<(String, f64)>>,
) -> Result<[f64; N]> {
    let mut found = [(); N].map(|()| Vec::new());
    for _ in 0..settings.runs {
        let said = measure()?;
        for (name, values) in names.iter().zip(&mut found) {
            let value = said.iter().find(|(known, _)| known == name);
            values.push(value.with_context(|| format!("the partition did not say {name}: {said:?}"))?.1);
        }
    }
    Ok(found.map(|values| median(&values).unwrap_or_default()))
}

fn services(settings: &Settings) -> Result<Vec<Row>> {
    let samples = if settings.quick { 50 } else { 500 };
    let attributes = format!("measures = \"services\", samples = {samples}");
    let names = ["mutex", "GET_TIME", "SET_EVENT", "SIGNAL_SEMAPHORE", "DISPLAY_BLACKBOARD"];
    let costs = medians(settings, names, || said(settings, &attributes, 2, 2.0))?;
    let about = "pthread_mutex_lock and _unlock without contention, in the same process";
    let row = |place: usize| {
        let name = format!("process, service {}", names[place]);
        Row::measured(name, "ns", costs[place], Some(costs[0]), Reach::Times(5.0), about)
    };
    Ok((1..names.len()).map(row).collect())
}

fn switches(settings: &Settings) -> Result<Vec<Row>> {
    let (samples, length_s) = if settings.quick { (10, 3.0) } else { (60, 8.0) };
    let of = |measures: &str, processes: u32| {
        // As many switches by 64 as by 16: the run has to come to its end.
        let samples = samples * 16 / processes.max(16);
        let attributes = format!("measures = \"{measures}\", processes = {processes}, samples = {samples}");
        medians(settings, [measures], || said(settings, &attributes, processes + 1, length_s))
            .map(|[cost]| cost)
    };
    let (two, four, many) = (of("switch", 2)?, of("switch", 4)?, of("switch", 64)?);
    let (bare_two, bare_four, bare_many) = (of("handover", 2)?, of("handover", 4)?, of("handover", 64)?);
    let references = (0..settings.runs).map(|_| probe::futex_switch(settings.core, FUTEX_ROUNDS));
    let reference = median(&references.collect::<Result<Vec<_>>>()?).map(|us| us * 1e3);
    let futex = "hand-over between two threads on one core by futex";
    let among = "the same among 4";
    Ok(vec![
        Row::measured("process, futex inside a partition", "ns", bare_two, reference, Reach::Stated, futex),
        Row::measured(
            "process, futex inside a partition, among 64",
            "ns",
            bare_many,
            Some(bare_four),
            Reach::Stated,
            among,
        ),
        Row::measured("process, switch by a semaphore", "ns", two, reference, Reach::Times(2.0), futex),
        Row::measured("process, switch among 64", "ns", many, Some(four), Reach::Times(1.3), among),
    ])
}

fn releases(settings: &Settings) -> Result<Vec<Row>> {
    let samples = if settings.quick { 300_u32 } else { 5_000 };
    let last_us = WINDOW_US.0 + WINDOW_US.1 - BEFORE_END_US;
    let attributes = format!(
        "measures = \"release\", samples = {samples}, frame = \"{FRAME_US}us\", from = \"{}us\", to = \"{last_us}us\"",
        WINDOW_US.0
    );
    let length_s = f64::from(samples) / 500.0 + 1.0;
    let [half, worst] = medians(settings, ["p50", "p999"], || said(settings, &attributes, 3, length_s))?;
    let length = Duration::from_millis(u64::from(samples));
    let timer = probe::cyclic(settings.core, 1_000, length)?;
    let of = |share: f64| quantile(&timer, share).map(|us| us * 1e3);
    let about = "clock_nanosleep to an absolute instant, on the same core";
    Ok(vec![
        Row::measured("process, release, p50", "ns", half, of(0.5), Reach::Times(1.5), about),
        Row::measured("process, release, p99.9", "ns", worst, of(0.999), Reach::Times(2.0), about),
    ])
}
