//! Figures of size: 4, 16 and 64 partitions with four ports each, in the same number of windows.

use anyhow::Result;

use super::Settings;
use super::restart::{VICTIM, restarts, victim};
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
    let mut switch = [const { Ok(Vec::new()) }; SIZES.len()];
    let mut restart = [const { Ok(Vec::new()) }; SIZES.len()];
    for _ in 0..settings.runs {
        for (place, size) in SIZES.into_iter().enumerate() {
            add(&mut switch[place], || switch_us(settings, size).map(|us| vec![us]));
            add(&mut restart[place], || {
                let kills = if settings.quick { 2 } else { 10 };
                Ok(restarts(&module(settings, size), kills)?.window_ms)
            });
        }
    }
    let mut rows = Vec::new();
    for (place, size) in SIZES.into_iter().enumerate() {
        let reach = if place == 0 { Reach::Stated } else { Reach::Times(1.5) };
        rows.push(row(format!("{size} partitions, processor time per switch"), "us", &switch, place, reach));
        rows.push(row(format!("{size} partitions, restart, p50"), "ms", &restart, place, reach));
    }
    Ok(rows)
}

/// Samples over the runs, or why there are none.
type Samples = Result<Vec<f64>>;

/// Adds what a run gives. One that fails fails its row, and no other.
fn add(samples: &mut Samples, run: impl FnOnce() -> Result<Vec<f64>>) {
    if let Ok(gathered) = samples {
        match run() {
            Ok(more) => gathered.extend(more),
            Err(error) => *samples = Err(error),
        }
    }
}

fn row(name: String, unit: &str, of_sizes: &[Samples], place: usize, reach: Reach) -> Row {
    let value = match &of_sizes[place] {
        Ok(samples) => median(samples).ok_or_else(|| "nothing was seen".to_owned()),
        Err(error) => Err(format!("{error:#}")),
    };
    let of_four = of_sizes[0].as_ref().ok().and_then(|samples| median(samples));
    match value {
        Ok(value) => Row::measured(name, unit, value, of_four, reach, "four partitions in as many windows"),
        Err(why) => Row::impossible(name, why),
    }
}

/// Processor time of one switch, us.
fn switch_us(settings: &Settings, size: usize) -> Result<f64> {
    let per_second = WINDOWS as f64 / (FRAME_US as f64 / 1e6);
    Ok(used_by_switches(&module(settings, size), settings.seconds / 2.0, per_second)?.whole_us)
}

/// Partitions in a ring, each of which writes to the next two. The first, which is killed, has one window of the frame whatever their
/// number, so that its wait for that window is the same; the others have the rest in turn.
fn module(settings: &Settings, size: usize) -> String {
    let windows = |place: usize| -> Vec<(u64, u64)> {
        let (first, step) = if place == 0 { (0, WINDOWS) } else { (place, size - 1) };
        (first..WINDOWS).step_by(step).map(|number| (number as u64 * WINDOW_US, WINDOW_US)).collect()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn run_that_fails_fails_its_row_and_no_other() {
        let mut of_sizes: [Samples; 2] = [Ok(vec![2.0]), Ok(Vec::new())];
        add(&mut of_sizes[1], || Ok(vec![6.0]));
        let ratio = |of_sizes: &[Samples]| row("x".into(), "ms", of_sizes, 1, Reach::Times(2.0)).ratio;
        assert_eq!(ratio(&of_sizes), Some(3.0));
        add(&mut of_sizes[0], || anyhow::bail!("it did not begin"));
        add(&mut of_sizes[0], || Ok(vec![2.0]));
        let four = row("y".into(), "ms", &of_sizes, 0, Reach::Stated);
        assert_eq!((four.value, four.about.as_str()), (None, "it did not begin"));
        assert_eq!(row("x".into(), "ms", &of_sizes, 1, Reach::Stated).value, Some(6.0));
    }
}
