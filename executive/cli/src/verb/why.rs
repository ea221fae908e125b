//! `bateleur why`: who had the processor when a window began or ended late, was lost, or was not closed, a sentence each, from
//! `why.jsonl` of a run on the wall clock.
//!
//! The executive has the kernel trace which thread and which interrupt has each of its processors (tracefs), and looks into the
//! trace after the event. Where the kernel has no tracefs, or the executive is not root, the answer is who used the processor shortly
//! after the event, by the kernel's counters, and says so. Exit codes: 0 it was read, 1 something in it is damaged, 2 it could not
//! be read.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::{Context, Result};
use bateleur_monitor::why::{Answer, FILE};

use super::notes::{Notes, file_of};
use super::{Code, FINE, Format, WRONG};

/// Say who had the processor when a window was late, lost or not closed.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The folder of a run, or the file itself [default: target/runs/latest].
    #[arg(value_name = "FOLDER|FILE")]
    path: Option<PathBuf>,
    #[command(flatten)]
    notes: Notes,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    let notes = &arguments.notes;
    let path = file_of(arguments.path.as_deref(), FILE)?;
    let text = std::fs::read_to_string(&path).with_context(|| {
        format!(
            "cannot read {} (name the folder of a run on the wall clock; on the virtual clock nobody takes a processor)",
            path.display()
        )
    })?;
    let (mut answers, damaged) = read(&text);
    notes.choose(&mut answers, |answer| &answer.partition);
    match notes.format {
        Format::Json => println!("{}", serde_json::to_string_pretty(&answers)?),
        Format::Text => print!("{}", sentences(&answers)),
    }
    if damaged > 0 {
        eprintln!("{damaged} lines of {} are damaged or were cut off", path.display());
    }
    Ok(if damaged == 0 { FINE } else { WRONG })
}

/// The answers, and how many lines are none.
fn read(text: &str) -> (Vec<Answer>, usize) {
    let lines = text.lines().map(serde_json::from_str);
    let (good, bad): (Vec<_>, Vec<_>) = lines.partition(Result::is_ok);
    (good.into_iter().flatten().collect(), bad.len())
}

fn sentences(answers: &[Answer]) -> String {
    if answers.is_empty() {
        return "no window was late, lost or left open\n".into();
    }
    let lines = answers.iter().map(|answer| {
        let unasked = match answer.unasked {
            0 => String::new(),
            count => format!("              ({count} more before it were not looked into)\n"),
        };
        format!("{unasked}{:>11.3} s  {}\n", answer.time_s, plain(&answer.sentence()))
    });
    let mut text: String = lines.collect();
    if answers.len() > 1 {
        text.push_str(&sums(answers));
    }
    text
}

/// How often it was whom.
fn sums(answers: &[Answer]) -> String {
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for answer in answers {
        *counts.entry(plain(&answer.taker.words())).or_default() += 1;
    }
    let mut counts: Vec<_> = counts.into_iter().collect();
    counts.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    let lines = counts.into_iter().map(|(words, count)| format!("{count:>8} x {words}\n"));
    format!("\n{} answers:\n{}", answers.len(), lines.collect::<String>())
}

/// Without the control characters that a terminal would obey: names of threads come from programs.
fn plain(text: &str) -> String {
    text.replace(char::is_control, "\u{fffd}")
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINE: &str = r#"{"time_s":1.5,"monotonic_s":9.5,"frame":75,"kind":"late_start","partition":"imu","core":1,"span_ms":8.2,"taker":"thread","name":"hog","tid":7,"priority":"real-time priority 99","of":null,"took_ms":8.0,"shares":[{"taker":"host","ms":8.0}],"slices":[],"steal_ms":0,"source":"trace"}"#;

    #[test]
    fn answers_are_sentences_and_a_line_that_was_cut_off_is_counted() {
        let (answers, damaged) = read(&format!("{LINE}\n{LINE}\n{{\"time_s\":1"));
        assert_eq!((answers.len(), damaged), (2, 1));
        let text = sentences(&answers);
        let sentence = "      1.500 s  imu's window on core 1 began 8.2 ms late in frame 75: thread hog (TID 7, real-time priority 99) \
                        had the processor for 8.0 ms of 8.2\n";
        assert!(text.starts_with(sentence), "{text}");
        assert!(
            text.ends_with("2 answers:\n       2 x thread hog (TID 7, real-time priority 99)\n"),
            "{text}"
        );
        assert_eq!(sentences(&[]), "no window was late, lost or left open\n");
    }
}
