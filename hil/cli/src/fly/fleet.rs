//! The executives of a flight: one, or one for each host. To the ground station they are one aircraft.

use std::io;
use std::path::PathBuf;

use anyhow::{Context, Result};
use bateleur_executive_cli::hosts::namespace::Lan;
use bateleur_monitor::event::Event;
use bateleur_plan::Plan;
use bateleur_report::hosts::{self as report_hosts, Host};

use super::Arguments;
use super::executive::{Executive, Question};
use super::here::Module;
use super::hosts::Hosts;
use super::hosts::model::{Cut, Death};

/// See the module's head.
pub(super) struct Fleet {
    /// With the ground's line; on the virtual clock the one that asks.
    main: Main,
    others: Vec<(Host, Executive)>,
    /// Starts of hosts that were killed and came back.
    former: Vec<Host>,
    /// What they said that nobody has taken yet.
    said: Vec<Event>,
    /// The main one's module, where there are several.
    module: Option<String>,
    joined: Option<Joined>,
    /// Hosts that are ready, and their partitions.
    ready: usize,
    partitions: usize,
}

/// What flies the module with the ground's line.
enum Main {
    Executive(Box<Executive>),
    Here(Box<Module>),
}

impl Main {
    fn take_events(&mut self) -> Vec<Event> {
        match self {
            Self::Executive(executive) => executive.take_events(),
            Self::Here(module) => module.take_events(),
        }
    }

    fn has_ended(&mut self) -> bool {
        match self {
            Self::Executive(executive) => executive.ended().is_some(),
            Self::Here(module) => module.has_ended(),
        }
    }

    fn question(&mut self) -> io::Result<Option<Question>> {
        match self {
            Self::Executive(executive) => executive.question(),
            Self::Here(module) => module.question().map(Some),
        }
    }

    fn answer(&mut self, bytes: u64, stop: bool) -> io::Result<()> {
        match self {
            Self::Executive(executive) => executive.answer(bytes, stop),
            Self::Here(_) if stop => Err(io::ErrorKind::ConnectionAborted.into()), // as an executive that has ended
            Self::Here(module) => {
                module.answer(bytes);
                Ok(())
            }
        }
    }

    fn kill(&mut self) {
        if let Self::Executive(executive) = self {
            executive.kill();
        }
    }

    fn ask_to_stop(&mut self) {
        if let Self::Executive(executive) = self {
            executive.ask_to_stop();
        }
    }

    fn finish(&mut self) -> Vec<Event> {
        match self {
            Self::Executive(executive) => executive.finish(),
            Self::Here(module) => module.finish(),
        }
    }
}

/// What is there only while several hosts fly.
struct Joined {
    plan: Plan,
    lan: Option<Lan>,
    cuts: Vec<Cut>,
    /// What was done to each cut so far: nothing, cut, mended.
    done: Vec<usize>,
    /// Those that have still to be killed, and those that are dead and come back.
    deaths: Vec<Death>,
    dead: Vec<Death>,
    folder: PathBuf,
    _hosts: Hosts,
}

impl Fleet {
    pub(super) fn of_one(main: Executive) -> Self {
        Self::of_main(Main::Executive(Box::new(main)))
    }

    /// One within this process.
    pub(super) fn here(module: Module) -> Self {
        Self::of_main(Main::Here(Box::new(module)))
    }

    fn of_main(main: Main) -> Self {
        let (others, former, said) = (Vec::new(), Vec::new(), Vec::new());
        Self { main, others, former, said, module: None, joined: None, ready: 0, partitions: 0 }
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
        let joined = Joined {
            plan: plan.clone(),
            lan,
            done: vec![0; cuts.len()],
            cuts,
            deaths: arguments.hosts.kill_host.clone(),
            dead: Vec::new(),
            folder: hosts.folder.clone(),
            _hosts: hosts,
        };
        let others = others.into_iter().map(|(name, host)| (Host::of_module(&name), host)).collect();
        Self { others, module: Some(module), joined: Some(joined), ..Self::of_one(main) }
    }

    /// Events since the last look. What all hosts say of themselves comes once: that of the main one, and that all are ready.
    pub(super) fn take_events(&mut self) -> Vec<Event> {
        let mut events = self.main.take_events();
        events.append(&mut self.said);
        for (host, other) in &self.others {
            let of_all = |event: &Event| matches!(event, Event::Guarantees { .. } | Event::Stopped { .. });
            events.extend(in_our_time(host, other).filter(|event| !of_all(event)));
        }
        let ready_before = self.ready;
        events.retain(|event| match event {
            Event::Ready { partitions, .. } => {
                self.ready += 1;
                self.partitions += partitions;
                false
            }
            _ => true,
        });
        if self.ready > ready_before && self.ready == self.others.len() + 1 {
            events.push(Event::Ready { partitions: self.partitions, module: None });
        }
        events
    }

    /// Names of the links between the hosts.
    pub(super) fn links(&self) -> Vec<String> {
        let links = self.joined.iter().flat_map(|joined| &joined.plan.links);
        links.map(|link| link.name.clone()).collect()
    }

    /// Whether nobody flies any more: the main one has ended.
    pub(super) fn has_ended(&mut self) -> bool {
        self.main.has_ended()
    }

    /// A host that ended before it was ready, so that the flight can not begin.
    pub(super) fn ended_before_ready(&mut self) -> Option<String> {
        if self.ready > self.others.len() {
            return None;
        }
        let ended = self.others.iter_mut().find_map(|(host, other)| other.ended().map(|_| host.name()));
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
        let mut lines = joined.cut(now_s);
        for death in joined.deaths.extract_if(.., |death| now_s >= death.at_s).collect::<Vec<_>>() {
            match self.others.iter_mut().find(|(host, _)| host.module == death.module) {
                Some((_, host)) => host.kill(),
                None => self.main.kill(),
            }
            lines.push(format!("host {} is killed", death.module));
            joined.dead.push(death);
        }
        let is_due = |death: &mut Death| death.back_s.is_some_and(|back_s| now_s >= back_s);
        let due: Vec<Death> = joined.dead.extract_if(.., is_due).collect();
        for Death { module, .. } in due {
            lines.push(match self.bring_back(&module, module_ns) {
                Ok(()) => format!("host {module} is started again"),
                Err(error) => format!("! host {module} can not be started again: {error:#}"),
            });
        }
        lines
    }

    /// Starts the module of a host that was killed. On the virtual clock the others wait meanwhile: its frames begin at an
    /// instant that depends on the plan alone.
    fn bring_back(&mut self, module: &str, module_ns: u64) -> Result<()> {
        let joined = self.joined.as_mut().context("there is one host")?;
        let other = self.others.iter_mut().find(|(host, _)| host.module == module);
        let (host, before) = other.context("it is the one with the ground's line")?;
        let mut next = Host { start: host.start + 1, shift_ns: 0, ..host.clone() };
        let folder = report_hosts::folder_of(&joined.folder, &next);
        bateleur_system::folders::make(&folder)
            .with_context(|| format!("cannot make the folder {}", folder.display()))?;
        let is_joint = before.is_joint();
        let mut choices = Vec::new();
        if is_joint {
            let plan = &joined.plan;
            let begin_ns = (module_ns + plan.health.reset.startup_ns)
                .next_multiple_of(plan[plan.initial_schedule()].major_frame_ns);
            choices = vec!["--back-at".to_owned(), begin_ns.to_string()];
        } else {
            // Its module time begins here; what its relay measures is better.
            next.shift_ns = i64::try_from(module_ns).unwrap_or(i64::MAX);
        }
        let mut executive = before.again(folder, choices)?;
        let id = joined.plan.module(module).map(|view| view.id());
        if let (Some(lan), Some(id)) = (&mut joined.lan, id) {
            executive.join(lan, &joined.plan, id)?;
        }
        self.said.extend(in_our_time(host, before));
        self.former.push(std::mem::replace(host, next));
        *before = executive;
        if is_joint {
            // Of what it says "ready" counts no more: the flight has begun.
            self.said.extend(before.await_ready()?);
        }
        Ok(())
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

    /// The hosts, the main one first, each start of one that came back; none where there is one host.
    pub(super) fn hosts(&self) -> Vec<Host> {
        let main = self.module.iter().map(|main| Host::of_module(main));
        let others = self.others.iter().map(|(host, _)| host.clone());
        main.chain(self.former.iter().cloned()).chain(others).collect()
    }
}

/// Events of a host since the last look. One that came back in real time counts from its own beginning.
fn in_our_time(host: &Host, executive: &Executive) -> impl Iterator<Item = Event> {
    let by_s = host.shift_ns as f64 / 1e9;
    executive.take_events().into_iter().map(move |event| event.later(by_s))
}

impl Joined {
    /// Cuts and mends networks as is due; gives a line for each.
    fn cut(&mut self, now_s: f64) -> Vec<String> {
        let mut lines = Vec::new();
        for (cut, done) in self.cuts.iter().zip(&mut self.done) {
            for (step, at_s, up) in [(0, cut.from_s, false), (1, cut.until_s, true)] {
                if *done != step || now_s < at_s {
                    continue;
                }
                *done += 1;
                let what = if up { "is there again" } else { "is cut" };
                lines.push(format!("network {} {what}", cut.network));
                // On the virtual clock the relays' model cuts.
                let set = self.lan.as_ref().map(|lan| lan.set(&self.plan, &cut.network, up));
                if let Some(Err(error)) = set {
                    lines.push(format!("! {error:#}"));
                }
            }
        }
        lines
    }
}
