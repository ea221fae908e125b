//! The lines that `top` shows, for a terminal of any size.

use bateleur_control::status::LATENESS_BOUNDS_NS;
use bateleur_monitor::event_text::printable;

use super::board::{Board, Over, Row};
use super::screen::{Line, Style};
use crate::verb::ps::{heading, mode, process_table, us};

const HINTS: &str = "? keys   s sort   enter details   K kill   q leave";
const HELP: &[&str] = &[
    "arrows, j k, page, home, end   choose a partition",
    "enter                          its details, or the table alone",
    "s  <  r                        sort by the next column, by the one before, the other way round",
    "K  S  A                        kill, stop, start it (an order, as `bateleur kill`)",
    "F  T                           freeze it, thaw it",
    "I                              provoke a fault in it",
    "C                              change the schedule",
    "q, escape, ctrl-c              leave; the module goes on",
];

/// Lines for a terminal of `width` and `height`.
pub(super) fn lines(board: &Board, (width, height): (usize, usize)) -> Vec<Line> {
    let mut top: Vec<Line> =
        heading(&board.status).lines().flat_map(|line| wrapped(line, width)).map(plain).collect();
    let order = if board.reversed { ", reversed" } else { "" };
    top.push(Line::new(Style::Dim, format!("sorted by {}{order}", board.sorted_by.word())));
    top.push(Line::new(Style::Bold, columns(&HEADS.map(str::to_owned))));
    let mut bottom = over(board, width, height.saturating_sub(top.len() + 4));
    bottom.push(foot(board));
    // At least the chosen partition is seen.
    let room = height.saturating_sub(top.len() + bottom.len()).max(1);
    let first = board.at().saturating_sub(room - 1);
    let rows = board.rows.iter().enumerate().skip(first).take(room);
    let rows = rows.map(|(at, row)| {
        let style = if at == board.at() { Style::Reverse } else { Style::Plain };
        Line::new(style, format!("{:<width$}", columns(&cells(row))))
    });
    let mut all = top;
    all.extend(rows);
    let space = height.saturating_sub(all.len() + bottom.len());
    all.extend(std::iter::repeat_n(Line::default(), space));
    all.append(&mut bottom);
    all.truncate(height);
    all
}

fn plain(text: impl Into<String>) -> Line {
    Line::new(Style::Plain, text)
}

/// In pieces that fit, parted behind commas.
fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for piece in text.split_inclusive(", ") {
        let fits = |line: &String| line.is_empty() || line.len() + piece.trim_end().len() <= width;
        match lines.last_mut() {
            Some(last) if fits(last) => last.push_str(piece),
            _ => lines.push(piece.to_owned()),
        }
    }
    lines
}

const HEADS: [&str; 10] =
    ["PARTITION", "MODE", "PID", "GEN", "USE %", "LATE us", "MISSED", "OVERRUN", "MiB", "LAST FAULT"];

fn columns(cells: &[String; 10]) -> String {
    let [name, mode, pid, generation, used, late, missed, overruns, memory, fault] = cells;
    format!(
        "{name:<18}{mode:<11}{pid:>8}{generation:>5}{used:>7}{late:>9}{missed:>8}{overruns:>9}{memory:>7}  {fault}"
    )
}

fn cells(row: &Row) -> [String; 10] {
    let one = &row.partition;
    let dash = || "-".to_owned();
    [
        printable(&one.name),
        mode(one),
        one.pid.map_or_else(dash, |pid| pid.to_string()),
        one.generation.to_string(),
        one.use_ns.map_or_else(dash, |_| format!("{:.1}", 100.0 * row.share())),
        one.lateness_ns.map_or_else(dash, |late| us(late.max).to_string()),
        one.windows_missed.to_string(),
        one.overruns.to_string(),
        row.memory.map_or_else(dash, |bytes| format!("{:.1}", mib(bytes))),
        one.last_fault.as_ref().map_or_else(dash, |fault| {
            format!(
                "{} at {:.3} s -> {}",
                printable(&fault.error),
                fault.time_ns as f64 / 1e9,
                printable(&fault.action)
            )
        }),
    ]
}

fn mib(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 20)
}

fn foot(board: &Board) -> Line {
    match (&board.over, &board.said) {
        (Some(Over::Confirm { question, .. }), _) => Line::new(Style::Bold, printable(question)),
        (Some(Over::Choose { .. }), _) => plain("arrows or a letter choose, enter orders it, escape leaves"),
        (_, Some(Ok(done))) => Line::new(Style::Bold, printable(done)),
        (_, Some(Err(why))) => Line::new(Style::Bold, format!("refused: {}", printable(why))),
        _ => Line::new(Style::Dim, HINTS),
    }
}

/// What lies below the table, with `room` lines at most.
fn over(board: &Board, width: usize, room: usize) -> Vec<Line> {
    match &board.over {
        Some(Over::Help) => HELP.iter().take(room).map(|line| plain(*line)).collect(),
        Some(Over::Choose { title, of, chosen, .. }) => {
            let shown = room.saturating_sub(1).clamp(1, 12);
            let first = chosen.saturating_sub(shown - 1);
            let line = |(at, word): (usize, &String)| {
                let style = if at == *chosen { Style::Reverse } else { Style::Plain };
                Line::new(style, format!("  {}", printable(word)))
            };
            let list = of.iter().enumerate().skip(first).take(shown).map(line);
            std::iter::once(Line::new(Style::Bold, printable(title))).chain(list).collect()
        }
        _ if board.details => {
            let row = board.rows.get(board.at());
            row.map_or_else(Vec::new, |row| details(row, width).into_iter().take(room).collect())
        }
        _ => Vec::new(),
    }
}

/// All that is known of a partition.
fn details(row: &Row, width: usize) -> Vec<Line> {
    let one = &row.partition;
    let memory = row.memory.map_or_else(|| "not known".to_owned(), |bytes| format!("{:.1} MiB", mib(bytes)));
    let standby = one.standby.as_ref().map(|how| format!(", standby {}", printable(how))).unwrap_or_default();
    let mut lines = vec![
        Line::new(Style::Bold, printable(&one.name)),
        plain(format!(
            "  {}, {} restarts, resident memory {memory}{standby}",
            printable(&one.mode),
            one.restarts
        )),
        plain(format!(
            "  windows: {} of {} us, {} missed, {} overruns",
            one.windows,
            us(one.window_ns),
            one.windows_missed,
            one.overruns
        )),
    ];
    if let (Some(used), Some(slack)) = (one.use_ns, one.slack_ns) {
        lines.push(plain(format!(
            "  use: least {} us, mean {} us, most {} us; left over: least {} us, mean {} us",
            us(used.min),
            us(used.mean),
            us(used.max),
            us(slack.min),
            us(slack.mean)
        )));
    }
    if let Some(fault) = &one.last_fault {
        let at_s = fault.time_ns as f64 / 1e9;
        let (error, action) = (printable(&fault.error), printable(&fault.action));
        lines.push(plain(format!(
            "  last fault: {error} at {at_s:.3} s -> {action} ({})",
            printable(&fault.detail)
        )));
    }
    if !one.processes.is_empty() {
        lines.extend(process_table(one).lines().map(plain));
    }
    if let Some(late) = one.lateness_ns {
        lines.push(plain(format!(
            "  lateness: median {} us, 99 % {} us, most {} us",
            us(late.p50),
            us(late.p99),
            us(late.max)
        )));
        let mut before = 0;
        for (bound_ns, within) in LATENESS_BOUNDS_NS.iter().zip(late.within) {
            let own = within.saturating_sub(before);
            before = within;
            if own > 0 {
                let bar = bar(own, one.windows, width.saturating_sub(32));
                lines.push(plain(format!("  {:>8} us {own:>10}  {bar}", *bound_ns as f64 / 1e3)));
            }
        }
    }
    lines
}

/// A part of `all` as a bar of `most` characters at most; what is there is seen.
fn bar(part: u64, all: u64, most: usize) -> String {
    let length = (part as f64 / all.max(1) as f64 * most as f64).ceil() as usize;
    "#".repeat(length.min(most))
}

#[cfg(test)]
mod tests {
    use bateleur_control::status::{Lateness, Spread};
    use bateleur_control::{LastFault, PartitionStatus, Status};
    use crossterm::event::{KeyCode, KeyEvent};

    use super::*;

    fn board(partitions: usize) -> Board {
        let partition = |number: usize| PartitionStatus {
            name: format!("partition{number}"),
            pid: Some(i32::MAX),
            mode: "normal".into(),
            windows: 1000,
            window_ns: 1_000_000,
            use_ns: Some(Spread { min: 1000, mean: 250_000, max: 900_000 }),
            slack_ns: Some(Spread { min: 100_000, mean: 750_000, max: 999_000 }),
            lateness_ns: Some(Lateness {
                max: 7_000,
                within: [0, 900, 900, 990, 1000, 1000, 1000, 1000, 1000, 1000, 1000, 1000],
                ..Lateness::default()
            }),
            last_fault: Some(LastFault {
                time_ns: 1_500_000_000,
                error: "killed\x1b[2J".into(),
                action: "warm_restart".into(),
                detail: "ended by SIGKILL".into(),
            }),
            ..PartitionStatus::default()
        };
        let partitions = (0..partitions).map(partition).collect();
        Board::of(Status { module: "fcu".into(), clock: "wall".into(), partitions, ..Status::default() })
    }

    fn text(lines: &[Line]) -> String {
        lines.iter().map(|line| format!("{}\n", line.text)).collect()
    }

    #[test]
    fn every_terminal_is_filled_and_shows_the_chosen_partition() {
        let keys = ["", "?", "K", "I", "C", "\n"];
        for partitions in [0, 1, 9, 60] {
            for keys in keys {
                let mut board = board(partitions);
                (0..partitions / 2).for_each(|_| drop(board.press(KeyEvent::from(KeyCode::Down))));
                for key in keys.chars() {
                    let code = if key == '\n' { KeyCode::Enter } else { KeyCode::Char(key) };
                    board.press(KeyEvent::from(code));
                }
                for size in [(0, 0), (1, 1), (20, 6), (80, 24), (132, 40), (300, 100)] {
                    let shown = lines(&board, size);
                    assert_eq!(shown.len(), size.1, "{size:?} {keys:?}");
                    let chosen = shown.iter().any(|line| line.text.starts_with(&board.chosen));
                    assert!(size.1 < 24 || chosen, "{size:?} {keys:?}\n{}", text(&shown));
                }
            }
        }
    }

    #[test]
    fn details_say_all_that_is_known_and_nothing_that_a_terminal_would_obey() {
        let mut board = board(3);
        board.press(KeyEvent::from(KeyCode::Enter));
        let shown = text(&lines(&board, (100, 30)));
        for words in [
            "windows: 1000 of 1000 us",
            "use: least 1 us, mean 250 us, most 900 us; left over: least 100 us, mean 750 us",
            "at 1.500 s -> warm_restart (ended by SIGKILL)",
            "       1 us        900  ####",
            "      10 us         10  #",
        ] {
            assert!(shown.contains(words), "{words} is not in\n{shown}");
        }
        assert!(!shown.contains('\x1b'), "{shown:?}");
    }

    #[test]
    fn answers_stand_at_the_foot() {
        let mut board = board(2);
        board.press(KeyEvent::from(KeyCode::Char('K')));
        let foot = |board: &Board| lines(board, (80, 24)).pop().unwrap().text;
        assert_eq!(foot(&board), "kill partition0? (y/n)");
        board.press(KeyEvent::from(KeyCode::Char('y')));
        board.answered(Err("it is idle".into()));
        assert_eq!(foot(&board), "refused: it is idle");
    }
}
