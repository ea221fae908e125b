//! A partition that writes its windows into a logbook, and says what it finds there when it starts.
//!
//! The attribute `how`: `write`; `overwrite`; `flood` (as many as there is room for in each window); `clear` (every tenth window).

use std::process::ExitCode;

use bateleur_apex::{Context, Logbook, Partition, StartError, Window, WriteStatus};

struct Scribe {
    log: Logbook,
    how: String,
    found: Option<String>,
    count: u64,
}

fn number(message: &[u8]) -> u64 {
    let text = std::str::from_utf8(message).ok();
    text.and_then(|text| text.strip_prefix("entry ")?.trim().parse().ok()).unwrap_or(0)
}

impl Scribe {
    /// From the newest entry to the oldest the numbers fall by ones, but for entries that were aborted.
    fn is_whole(&self) -> bool {
        let all = (0..).map_while(|entry| self.log.read(entry));
        let written = all.filter(|(status, _)| *status != WriteStatus::Aborted);
        let numbers: Vec<u64> = written.map(|(_, message)| number(&message)).collect();
        self.how == "overwrite" || numbers.windows(2).all(|pair| pair[0] == pair[1] + 1)
    }
}

impl Partition for Scribe {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let log = context.logbook("log")?;
        let (counts, newest) = (
            log.counts(),
            (0..).map_while(|entry| log.read(entry)).find(|(status, _)| *status != WriteStatus::Aborted),
        );
        let count = newest.map_or(0, |(_, message)| number(&message));
        let how = context.attribute("how", "write".to_owned())?;
        let found = format!(
            "found {count} of {} stored, {} under way, {} aborted",
            counts.logged, counts.in_progress, counts.aborted
        );
        Ok(Self { log, how, found: Some(found), count })
    }

    fn window(&mut self, window: &Window) {
        if let Some(found) = self.found.take() {
            window.report(&found);
        }
        if !self.is_whole() {
            window.report("FAILED: an entry is missing");
        }
        loop {
            let message = format!("entry {:>8}", self.count + 1);
            let written = match self.how.as_str() {
                "overwrite" => self.log.overwrite(message.as_bytes()),
                _ => self.log.write(message.as_bytes()),
            };
            self.count += u64::from(written.is_ok());
            if written.is_err() || self.how != "flood" {
                break;
            }
        }
        if self.how == "clear" && self.count.is_multiple_of(10) {
            let _ = self.log.clear(); // what was written in this window is under way
        }
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Scribe>()
}
