//! Figures of size: 4, 16 and 64 partitions with four ports each, in the same number of windows.

use anyhow::{Context, Result};

use super::Settings;
use super::restart::{VICTIM, restarts_ms, victim};
use super::row::{Reach, Row};
use super::sketch::{Link, Sketched, schedule};
use super::statistics::median;
use super::windows::used_by_switches;

const SIZES: [usize; 3] = [4, 16, 64];
/// Windows of a frame, whatever the number of partitions: only the number of partitions differs.
const WINDOWS: usize = 64;
const WINDOW_US: u64 = 250;
const FRAME_US: u64 = 20_000;

/// The cost of a switch and of a restart beside those of four partitions.
pub(super) fn rows(settings: &Settings) -> Result<Vec<Row>> {
    let mut switch = [const { Vec::new() }; SIZES.len()];
    let mut restart = [const { Vec::new() }; SIZES.len()];
    for _ in 0..settings.runs {
        for (place, size) in SIZES.into_iter().enumerate() {
            let per_second = WINDOWS as f64 / (FRAME_US as f64 / 1e6);
            let seconds = settings.seconds / 2.0;
            switch[place].push(used_by_switches(&module(settings, size), seconds, per_second)?.whole_us);
            restart[place].extend(restarts_ms(&module(settings, size), if settings.quick { 2 } else { 10 })?);
        }
    }
    let of_four = (median(&switch[0]), median(&restart[0]));
    let mut rows = Vec::new();
    for (place, size) in SIZES.into_iter().enumerate() {
        let times = (size / SIZES[0]) as f64;
        let (switch_reach, restart_reach) = if place == 0 {
            (Reach::Stated, Reach::Stated)
        } else {
            (Reach::Times(1.5), Reach::Times(times))
        };
        let value = median(&switch[place]).context("no run")?;
        let about = "four partitions in as many windows";
        rows.push(Row::measured(
            format!("{size} partitions, processor time per switch"),
            "us",
            value,
            of_four.0,
            switch_reach,
            about,
        ));
        let value = median(&restart[place]).context("no restart was seen")?;
        rows.push(Row::measured(
            format!("{size} partitions, restart, p50"),
            "ms",
            value,
            of_four.1,
            restart_reach,
            about,
        ));
    }
    Ok(rows)
}

/// Partitions in a ring, each of which writes to the next two.
fn module(settings: &Settings, size: usize) -> String {
    let windows = |place: usize| -> Vec<(u64, u64)> {
        (place..WINDOWS).step_by(size).map(|number| (number as u64 * WINDOW_US, WINDOW_US)).collect()
    };
    let restart = "restart = { start = \"cold\", budget = 1000, within = \"1s\", then = \"idle\" }\nhealth = { killed = \"cold_restart\" }\n";
    let partitions: Vec<Sketched> = (0..size)
        .map(|place| match place {
            0 => victim(restart, &windows(0)),
            _ => Sketched::new(format!("p{place}"), "fill", &windows(place)),
        })
        .collect();
    debug_assert_eq!(partitions[0].name, VICTIM);
    let links: Vec<Link> =
        (0..size).flat_map(|from| [1, 2].map(|step| Link { from, to: (from + step) % size })).collect();
    schedule(settings.core, FRAME_US, &partitions, &links)
}
