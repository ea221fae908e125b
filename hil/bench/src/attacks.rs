//! Figures of attacks: when a neighbour's windows start, and how soon an unrelated partition is back, while a partition does what it can.
//!
//! The attackers are programs of the tests, which must lie beside this one.

use anyhow::{Context, Result, bail};

use super::Settings;
use super::module::{Line, start};
use super::restart::{self, KILLS, Restarts, victim};
use super::row::{Reach, Row};
use super::sketch::{Sketched, schedule};
use super::statistics::{median, quantile};

const FRAME_US: u64 = 10_000;
/// How long each attack goes on before the next one has its turn, ms.
const TURN_MS: u64 = 500;
/// The attacks of `attacker`, each in turn with one that only computes.
const ATTACKS: [(&str, &str); 2] =
    [("timers_2500", "a neighbour's timers"), ("timer_descriptors", "a neighbour's timer descriptors")];
const COMPUTES: &str = "computes";

/// Starts of the windows that follow those of the attacker: with each attack beside those without, in the same module.
pub(super) fn rows(settings: &Settings) -> Result<Vec<Row>> {
    let own = std::env::current_exe().context("cannot find this program")?;
    for program in ["attacker", "fuzzer", "litterer", "counter"] {
        if !own.with_file_name(program).is_file() {
            bail!(
                "there is no program {program} beside this one: cargo build --release -p bateleur-tests --bins"
            );
        }
    }
    let mut rows = Vec::new();
    for (attack, name) in ATTACKS {
        let runs = (0..settings.runs).map(|_| in_turns(settings, attack)).collect::<Result<Vec<_>>>()?;
        rows.extend(judged(name, &runs)?);
    }
    let runs = (1..=settings.runs as u64).map(|seed| fuzzed(settings, seed)).collect::<Result<Vec<_>>>()?;
    rows.extend(judged("a neighbour's random system calls", &runs)?);
    rows.push(restarts(settings)?);
    Ok(rows)
}

/// Restarts of a partition that is killed, beside one that closes the directory of its channel and exits, ten times in four seconds.
fn restarts(settings: &Settings) -> Result<Row> {
    let kills = if settings.quick { 3 } else { KILLS };
    let medians = |lives: u64| -> Result<Option<f64>> {
        let runs = (0..settings.runs).map(|_| restart::restarts(&beside_litterer(settings, lives), kills));
        let runs = runs.collect::<Result<Vec<Restarts>>>()?;
        Ok(median(&runs.iter().filter_map(|run| quantile(&run.window_ms, 0.5)).collect::<Vec<_>>()))
    };
    let value = medians(1_000_000)?.context("no restart was seen")?;
    let about = "the same partition while its neighbour leaves its channel as it is";
    let name = "restart beside one that closes its channel, p50";
    Ok(Row::measured(name, "ms", value, medians(0)?, Reach::Times(1.2), about))
}

/// One that closes its channel in each of its first `lives`, whoever hears it, and the one that is killed.
fn beside_litterer(settings: &Settings, lives: u64) -> String {
    let port = |partition: &str, name: &str, keys: &str| {
        format!(
            "[partition.{partition}.port.{name}]\nkind = \"sampling\"\nmessage = \"FunctionStatus\"\n{keys}\n"
        )
    };
    let litterer = Sketched {
        program: "litterer".into(),
        attributes: format!("how = \"closed\", after = 15, lives = {lives}"),
        more: MANY_RESTARTS.to_owned() + &port("litterer", "count", "direction = \"source\""),
        ..Sketched::new("litterer", "", &[(10_000, 500)])
    };
    let peer = Sketched {
        program: "counter".into(),
        attributes: String::new(),
        more: MANY_RESTARTS.to_owned()
            + &port("peer", "heard", "direction = \"destination\"\nrefresh = \"1s\""),
        ..Sketched::new("peer", "", &[(12_000, 500)])
    };
    let victim = victim(MANY_RESTARTS, &[(2_000, 500)]);
    let channel = "[[channel]]\nsource = \"litterer.count\"\ndestinations = [\"peer.heard\"]\n";
    schedule(settings.core, restart::FRAME_US, &[victim, litterer, peer], &[]) + channel
}

const MANY_RESTARTS: &str =
    "restart = { start = \"cold\", budget = 1000000, within = \"1s\", then = \"idle\" }\n";

/// What is left out at the beginning of each turn, in which the attacker is started anew, ms.
const CHANGE_MS: u64 = 100;

/// Starts of windows in one run, us: with the attack, without.
type Starts = (Vec<f64>, Vec<f64>);

fn judged(name: &str, runs: &[Starts]) -> Result<Vec<Row>> {
    let about =
        "a neighbour that computes as long and asks the kernel for nothing, in turns in the same module";
    let row = |words: &str, share, times| {
        let over = |pick: fn(&Starts) -> &Vec<f64>| {
            let of_each: Vec<f64> = runs.iter().filter_map(|run| quantile(pick(run), share)).collect();
            median(&of_each)
        };
        let value = over(|run| &run.0).context("no window was taken")?;
        let name = format!("window start beside {name}, {words}");
        anyhow::Ok(Row::measured(name, "us", value, over(|run| &run.1), Reach::Times(times), about))
    };
    Ok(vec![row("p50", 0.5, 1.1)?, row("p99", 0.99, 1.3)?])
}

/// The partition that is attacked, whose window is the next one.
fn neighbour() -> Sketched {
    Sketched::new("neighbour", "touch", &[(3_500, 1_500)])
}

fn in_turns(settings: &Settings, attack: &str) -> Result<Starts> {
    let attacker = Sketched {
        program: "attacker".into(),
        attributes: format!("attacks = [\"{attack}\", \"{COMPUTES}\"], each_ms = {TURN_MS}, busy = true"),
        ..many_restarts()
    };
    starts(settings, attacker)
}

fn fuzzed(settings: &Settings, seed: u64) -> Result<Starts> {
    let fuzzer = Sketched {
        program: "fuzzer".into(),
        attributes: format!("seed = {seed}, each_ms = {TURN_MS}"),
        ..many_restarts()
    };
    starts(settings, fuzzer)
}

fn many_restarts() -> Sketched {
    Sketched { more: MANY_RESTARTS.into(), ..Sketched::new("attacker", "", &[(0, 3_000)]) }
}

fn starts(settings: &Settings, attacker: Sketched) -> Result<Starts> {
    let text = schedule(settings.core, FRAME_US, &[attacker, neighbour()], &[]);
    // Both have had their turn, and as often.
    let seconds = settings.seconds.max(2.0 * TURN_MS as f64 / 1e3);
    let ended = start(&text, seconds)?.end()?;
    let turn = |line: &Line| line.planned_start_ns / (TURN_MS * 1_000_000);
    let is_settled = |line: &&Line| line.planned_start_ns / 1_000_000 % TURN_MS >= CHANGE_MS;
    let (attacked, quiet): (Vec<&Line>, Vec<&Line>) =
        ended.of("neighbour").filter(is_settled).partition(|line| turn(line).is_multiple_of(2));
    // A window that is lost began as late as it is long, at least.
    let length_us = |line: &Line| (line.planned_end_ns - line.planned_start_ns) as f64 / 1e3;
    let start_us = |line: &Line| line.start_us().unwrap_or_else(|| length_us(line));
    let of = |lines: Vec<&Line>| lines.into_iter().map(start_us).collect();
    Ok((of(attacked), of(quiet)))
}
