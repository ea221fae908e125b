//! Events as lines for a person.

use std::fmt;

use crate::event::Event;

/// What helps whoever runs the module by hand without a line to the ground.
const GROUND_HINT: &str =
    "\n             (a line without a radio: docs/src/three-terminals.md, or `cargo fly`, which makes one)";

/// Nothing where there is nothing to say.
impl fmt::Display for Event {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&text_of(self))
    }
}

fn text_of(event: &Event) -> String {
    match event {
        Event::Guarantees { list } => {
            let lacking = list.iter().filter(|guarantee| !guarantee.held);
            let lines: Vec<_> = lacking
                .map(|lack| format!("not guaranteed here: {} ({})", lack.promise, lack.detail))
                .collect();
            lines.join("\n")
        }
        Event::Ready { partitions, module } => {
            let module = module.as_ref().map_or_else(String::new, |module| format!("module {module}: "));
            match partitions {
                1 => format!("{module}1 partition is ready"),
                _ => format!("{module}{partitions} partitions are ready"),
            }
        }
        Event::Fault { time_s, partition, error, action, detail } => {
            let line = format!("{time_s:9.3} s  {partition}: {error} ({}) -> {action}", printable(detail));
            let lacks_line = detail.starts_with("ground link") && !detail.contains("is gone");
            if lacks_line { line + GROUND_HINT } else { line }
        }
        Event::ModuleFault { time_s, error, action, detail } => {
            format!("{time_s:9.3} s  module: {error} ({}) -> {action}", printable(detail))
        }
        Event::ModuleRestarted { time_s, after_ms } => {
            format!("{time_s:9.3} s  module: frame 0 again after {after_ms:.1} ms")
        }
        Event::Recovered { time_s, partition, after_ms } => {
            format!("{time_s:9.3} s  {partition}: back after {after_ms:.1} ms")
        }
        Event::Message { time_s, partition, text } | Event::Undone { time_s, partition, text } => {
            format!("{time_s:9.3} s  {partition}: {}", printable(text))
        }
        Event::ScheduleRequested { time_s, schedule, by } => {
            format!("{time_s:9.3} s  {by}: asks for schedule {schedule}")
        }
        Event::ScheduleChanged { time_s, schedule, before } => {
            format!("{time_s:9.3} s  schedule {schedule} after {before}")
        }
        Event::LogLost { time_s, log, reason } => {
            format!("{time_s:9.3} s  {log} can not be written any more: {}", printable(reason))
        }
        Event::LogCut { time_s, log, reason } => format!("{time_s:9.3} s  {log} ends: {}", printable(reason)),
        Event::LogLacks { time_s, log, reason } => format!("{time_s:9.3} s  {log}: {}", printable(reason)),
        Event::Stopped {
            reason,
            module_time_s,
            windows,
            late_windows,
            window_overruns,
            lost_records,
            lost_windows,
            unwritten_records,
            ..
        } => {
            let mut lost = String::new();
            if *lost_windows > 0 {
                lost = format!(", {lost_windows} lost because the dispatcher came too late");
            }
            if *lost_records > 0 {
                lost += &format!("\n{lost_records} window records were lost: the log could not keep up");
            }
            if *unwritten_records > 0 {
                lost +=
                    &format!("\n{unwritten_records} records are missing in logs that could not be written");
            }
            format!(
                "stopped after {module_time_s:.2} s: {reason}; {windows} windows, {late_windows} late, {window_overruns} overrun{lost}"
            )
        }
    }
}

/// Words of another process without the control characters that a terminal would obey.
#[must_use]
pub fn printable(text: &str) -> String {
    text.chars().map(|letter| if letter.is_control() { '\u{fffd}' } else { letter }).collect()
}
