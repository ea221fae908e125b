//! The executives of a flight: one, or one for each host. To the ground station they are one aircraft.

use std::io;

use bateleur_executive::event::Event;
use bateleur_executive::plan::Plan;

use super::Arguments;
use super::executive::{Executive, Question};
use super::hosts::Hosts;
use super::hosts::model::Cut;
use super::hosts::namespace::Lan;

/// See the module's head.
pub(super) struct Fleet {
    /// With the ground's line; on the virtual clock the one that asks.
    main: Executive,
    others: Vec<(String, Executive)>,
    /// The main one's module, where there are several.
    module: Option<String>,
    joined: Option<Joined>,
    /// Hosts that are ready, and their partitions.
    ready: usize,
    partitions: usize,
}

/// What is there only while several hosts fly.
struct Joined {
    plan: Plan,
    lan: Option<Lan>,
    cuts: Vec<Cut>,
    /// What was done to each cut so far: nothing, cut, mended.
    done: Vec<usize>,
    kills: Vec<(String, f64)>,
    _hosts: Hosts,
}

impl Fleet {
    pub(super) fn of_one(main: Executive) -> Self {
        Self { main, others: Vec::new(), module: None, joined: None, ready: 0, partitions: 0 }
    }

    pub(super) fn of_hosts(
        arguments: &Arguments,
        plan: &Plan,
        hosts: Hosts,
        (module, main): (String, Executive),
        others: Vec<(String, Executive)>,
        lan: Option<Lan>,
    ) -> Self {
        let cuts = arguments.hosts.cut.clone();
        let kills = arguments.hosts.kill_host.clone();
        let done = vec![0; cuts.len()];
        let joined = Joined { plan: plan.clone(), lan, cuts, done, kills, _hosts: hosts };
        Self { main, others, module: Some(module), joined: Some(joined), ready: 0, partitions: 0 }
    }

    /// Events since the last look. What all hosts say of themselves comes once: that of the main one, and that all are ready.
    pub(super) fn take_events(&mut self) -> Vec<Event> {
        let mut events = self.main.take_events();
        for (_, other) in &self.others {
            let of_all = |event: &Event| matches!(event, Event::Guarantees { .. } | Event::Stopped { .. });
            events.extend(other.take_events().into_iter().filter(|event| !of_all(event)));
        }
        let ready_before = self.ready;
        events.retain(|event| match event {
            Event::Ready { partitions } => {
                self.ready += 1;
                self.partitions += partitions;
                false
            }
            _ => true,
        });
        if self.ready > ready_before && self.ready == self.others.len() + 1 {
            events.push(Event::Ready { partitions: self.partitions });
        }
        events
    }

    /// Whether nobody flies any more: the main one has ended.
    pub(super) fn has_ended(&mut self) -> bool {
        self.main.ended().is_some()
    }

    /// A host that ended before it was ready, so that the flight can not begin.
    pub(super) fn ended_before_ready(&mut self) -> Option<String> {
        if self.ready > self.others.len() {
            return None;
        }
        let ended = self.others.iter_mut().find_map(|(name, other)| other.ended().map(|_| name.clone()));
        ended.map(|name| format!("module {name} could not start"))
    }

    /// See [`Executive::question`].
    pub(super) fn question(&mut self) -> io::Result<Option<Question>> {
        self.main.question()
    }

    /// See [`Executive::answer`]. At the end the others are asked first, so that none sees the main one go.
    pub(super) fn answer(&mut self, bytes: u64, stop: bool) -> io::Result<()> {
        if stop {
            self.others.iter_mut().for_each(|(_, other)| other.ask_to_stop());
        }
        self.main.answer(bytes, stop)
    }

    /// Does to hosts and networks what is due; gives a line for each.
    pub(super) fn perform(&mut self, module_ns: u64) -> Vec<String> {
        let Some(joined) = &mut self.joined else { return Vec::new() };
        let now_s = module_ns as f64 / 1e9;
        let mut lines = Vec::new();
        for (cut, done) in joined.cuts.iter().zip(&mut joined.done) {
            for (step, at_s, up) in [(0, cut.from_s, false), (1, cut.until_s, true)] {
                if *done != step || now_s < at_s {
                    continue;
                }
                *done += 1;
                let what = if up { "is there again" } else { "is cut" };
                lines.push(format!("network {} {what}", cut.network));
                // On the virtual clock the relays' model cuts.
                let set = joined.lan.as_ref().map(|lan| lan.set(&joined.plan, &cut.network, up));
                if let Some(Err(error)) = set {
                    lines.push(format!("! {error:#}"));
                }
            }
        }
        for (name, _) in joined.kills.extract_if(.., |(_, at_s)| now_s >= *at_s) {
            match self.others.iter_mut().find(|(other, _)| *other == name) {
                Some((_, host)) => host.kill(),
                None => self.main.kill(),
            }
            lines.push(format!("host {name} is killed"));
        }
        lines
    }

    /// Asks all to stop and waits until they have; gives the events of the main one's end, and of others what went wrong.
    pub(super) fn finish(&mut self) -> Vec<Event> {
        self.main.ask_to_stop();
        self.others.iter_mut().for_each(|(_, other)| other.ask_to_stop());
        let mut events = self.main.finish();
        let mut lost = 0;
        for (_, other) in &mut self.others {
            for event in other.finish() {
                if let Event::Stopped { lost_records, .. } = event {
                    lost += lost_records;
                }
            }
        }
        for event in &mut events {
            if let Event::Stopped { lost_records, .. } = event {
                *lost_records += lost;
            }
        }
        events
    }

    /// The modules, the main one first; none where there is one host.
    pub(super) fn modules(&self) -> Vec<String> {
        let Some(main) = &self.module else { return Vec::new() };
        std::iter::once(main).chain(self.others.iter().map(|(name, _)| name)).cloned().collect()
    }
}
