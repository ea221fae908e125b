//! Which partitions and links are down, for the sentence that says why a flight failed.

use std::collections::BTreeMap;

use bateleur_monitor::event::Event;

/// What the executive's events say of each partition.
#[derive(Debug, Default)]
pub(super) struct Standing {
    /// Partitions that were started anew at least once.
    restarted: Vec<String>,
    /// Those that are down now, and why.
    down: BTreeMap<String, String>,
    /// Links that are down now, and what is to be said of them.
    links: BTreeMap<String, String>,
}

impl Standing {
    /// With links of which none has been up.
    pub(super) fn new(links: Vec<String>) -> Self {
        let never = |name: String| (name.clone(), format!("link {name} was never up"));
        Self { links: links.into_iter().map(never).collect(), ..Self::default() }
    }

    /// Follows an event.
    pub(super) fn take(&mut self, event: &Event) {
        self.follow_link(event);
        match event {
            Event::Fault { partition, error, action, .. } if action.ends_with("restart") => {
                self.restarted.push(partition.clone());
                self.down.insert(partition.clone(), format!("{partition} had not come back from {error}"));
            }
            Event::Fault { partition, error, action, .. } if action == "idle" || action == "stop" => {
                let why = match self.restarted.contains(partition) {
                    true => "no restarts left".into(),
                    false => format!("{error}, by its health table"),
                };
                let state = if action == "idle" { "is idle" } else { "was stopped" };
                self.down.insert(partition.clone(), format!("{partition} {state}: {why}"));
            }
            Event::ModuleRestarted { .. } => self.down.clear(),
            Event::Recovered { partition, .. } => drop(self.down.remove(partition)),
            _ => {}
        }
    }

    /// A relay tells in its own words when a link comes and goes: "link NAME: up, …", "link NAME: down, …".
    fn follow_link(&mut self, event: &Event) {
        let (Event::Message { text, .. } | Event::Fault { detail: text, .. }) = event else { return };
        // Of several in a second only the last is told.
        let text = text.rsplit_once(", the last: ").map_or(text.as_str(), |(_, last)| last);
        let Some((name, what)) = text.strip_prefix("link ").and_then(|rest| rest.split_once(": ")) else {
            return;
        };
        if what.starts_with("up, ") {
            self.links.remove(name);
        } else if what.starts_with("down, ") {
            self.links.insert(name.to_owned(), format!("link {name} was {what}"));
        }
    }

    /// `failure`, and the partitions and links that were down then.
    pub(super) fn explain(&self, failure: String) -> String {
        let down: Vec<&str> = self.down.values().chain(self.links.values()).map(String::as_str).collect();
        if down.is_empty() { failure } else { format!("{failure} ({})", down.join("; ")) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(partition: &str, action: &str) -> Event {
        Event::Fault {
            time_s: 1.0,
            partition: partition.into(),
            error: "killed".into(),
            action: action.into(),
            detail: String::new(),
        }
    }

    fn explained(events: &[Event]) -> String {
        let mut standing = Standing::default();
        events.iter().for_each(|event| standing.take(event));
        standing.explain("it failed".into())
    }

    #[test]
    fn idle_partition_is_named_with_the_end_of_its_restarts() {
        let back = Event::Recovered { time_s: 2.0, partition: "estimator".into(), after_ms: 20.0 };
        let events = [fault("estimator", "warm_restart"), back, fault("estimator", "idle")];
        assert_eq!(explained(&events), "it failed (estimator is idle: no restarts left)");
        assert_eq!(explained(&events[..2]), "it failed");
        assert_eq!(explained(&events[..1]), "it failed (estimator had not come back from killed)");
    }

    #[test]
    fn link_that_was_never_up_or_went_down_is_named_and_one_that_came_back_is_not() {
        let says =
            |text: &str| Event::Message { time_s: 1.0, partition: "relay_fcu".into(), text: text.into() };
        let (up, down) = (says("link nav: up, nav is there"), {
            let detail = "link nav: down, nav is not heard".into();
            let (partition, error) = ("relay_fcu".into(), "application_error".into());
            Event::Fault { time_s: 2.0, partition, error, action: "ignore".into(), detail }
        });
        let explained = |events: &[Event]| {
            let mut standing = Standing::new(vec!["nav".into()]);
            events.iter().for_each(|event| standing.take(event));
            standing.explain("it failed".into())
        };
        assert_eq!(explained(&[]), "it failed (link nav was never up)");
        assert_eq!(explained(std::slice::from_ref(&up)), "it failed");
        let expected = "it failed (link nav was down, nav is not heard)";
        assert_eq!(explained(&[up.clone(), down.clone()]), expected);
        let last = says("2 more in 1.0 s, the last: link nav: down, nav is not heard");
        assert_eq!(explained(&[up.clone(), last]), expected);
        assert_eq!(explained(&[up.clone(), down, up]), "it failed");
    }

    #[test]
    fn partition_that_its_table_rests_at_once_is_named_with_the_table() {
        assert_eq!(
            explained(&[fault("imu", "idle")]),
            "it failed (imu is idle: killed, by its health table)"
        );
        assert_eq!(explained(&[fault("imu", "ignore")]), "it failed");
    }
}
