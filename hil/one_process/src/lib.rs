//! The flight's partitions in one loop of one process.
//!
//! Responsible for: granting every window of a plan at its instant of module time, in the order of the virtual clock, with ports, reports
//! and logs as an executive has them. It must never go on where an executive would have done more than to note something: then the
//! flight is one for partitions, and ends here.

#![forbid(unsafe_code)]

mod channels;
mod functions;
mod health;

use std::collections::BTreeMap;
use std::path::Path;
use std::rc::Rc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Instant;

use bateleur_apex::{Hosted, Hosting};
use bateleur_contract::Clock;
use bateleur_contract::page::WindowGrant;
use bateleur_host::partition::describe;
use bateleur_monitor::event::Event;
use bateleur_monitor::health::log::WindowLog;
use bateleur_monitor::lines::Patience;
use bateleur_plan::{ModuleView, PartitionId, Plan, Timeline, TimelineWindow};
use bateleur_time::dispatcher::{Ending, Occurrence, ScheduleEpoch};
use bateleur_time::window_record::WindowRecord;
use thiserror::Error as ErrorOf;

use channels::Recorder;
use health::{Health, NotShown, seconds};

/// Module time between two exchanges with whoever is at the end of the line, ns: as an executive does it.
const EXCHANGE_NS: u64 = 100_000_000;

/// Attributes that are replaced, by partition.
pub type Overrides = BTreeMap<String, BTreeMap<String, serde_json::Value>>;

/// Why a flight can not begin, or can not go on in one process.
#[derive(Debug, ErrorOf)]
pub enum Error {
    /// The plan has what one process has not.
    #[error("one process can not show this plan: {0}; fly it with --engine partitions")]
    Plan(String),
    /// It came to what one process has not.
    #[error("one process can not show what follows: {0}; fly it with --engine partitions")]
    NotShown(String),
    /// A partition did not start.
    #[error("partition {partition}: {why}")]
    Start {
        /// Which one.
        partition: String,
        /// Why.
        why: String,
    },
    /// No memory for a channel.
    #[error("channel {0}")]
    Channel(String),
    /// A log can not be written.
    #[error("{0}")]
    Log(String),
}

/// What a flight in one process is made of.
pub struct Setup<'a> {
    /// The plan.
    pub plan: Plan,
    /// The module that flies.
    pub module: &'a str,
    /// Attributes that are not as the plan has them.
    pub overrides: &'a Overrides,
    /// The partition at the end of the ground's line.
    pub line: &'a str,
    /// Where its logs go.
    pub folder: &'a Path,
    /// Called where a partition waits for a device: the simulator.
    pub neighbour: Rc<dyn Fn()>,
}

/// The instant of an exchange.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reached {
    /// Module time, ns.
    pub module_ns: u64,
    /// Bytes that were written to the line so far.
    pub sent: u64,
}

/// What comes next in a major frame.
#[derive(Debug, Clone, Copy)]
enum Step {
    MinorFrame,
    /// A window, its core, and the place of its partition.
    Window(TimelineWindow, u32, usize),
}

/// A flight.
pub struct OneProcess {
    plan: Plan,
    partitions: Vec<(PartitionId, Hosted)>,
    /// The place of the partition at the line.
    line: usize,
    steps: Vec<(u64, Step)>,
    next: usize,
    major_frame_ns: u64,
    minor_frame_ns: u64,
    schedule: usize,
    major_frame: u64,
    minor_frames: u64,
    module_ns: u64,
    next_exchange_ns: u64,
    windows: u64,
    health: Health,
    window_log: WindowLog,
    recorder: Option<Recorder>,
}

/// Why a plan is one for partitions alone; `None`: it can be flown in one process.
#[must_use]
pub fn unsuitable(plan: &Plan, module: &str) -> Option<String> {
    let Some(view) = plan.module(module) else { return Some(format!("it has no module {module}")) };
    if plan.schedules.len() > 1 {
        return Some("it changes between schedules".into());
    }
    if plan[view.id()].follows.is_some() || view.crossing_channels().next().is_some() {
        return Some("its module does not fly alone".into());
    }
    view.partitions().find_map(|id| {
        let partition = &plan[id];
        let name = &partition.name;
        if !partition.replicas.is_empty() {
            return Some(format!("partition {name} has replicas"));
        }
        if functions::of(&partition.program).is_none() {
            return Some(format!("partition {name} runs {}, a program of its own", partition.program));
        }
        partition.standby.is_some().then(|| format!("partition {name} has a standby"))
    })
}

impl OneProcess {
    /// Makes channels and starts the partitions.
    ///
    /// # Errors
    /// The plan needs more than one process, a partition does not start, or a log can not be written.
    pub fn start(setup: Setup<'_>) -> Result<Self, Error> {
        let Setup { plan, module, overrides, line, folder, neighbour } = setup;
        if let Some(why) = unsuitable(&plan, module) {
            return Err(Error::Plan(why));
        }
        let view = plan.module(module).ok_or_else(|| Error::Plan("it has no such module".into()))?;
        let channels = channels::make(view)?;
        let recorder = Recorder::begin(folder, view, &channels)?;
        let mut partitions = Vec::new();
        for id in view.partitions() {
            let name = &plan[id].name;
            let wrong = |why: String| Error::Start { partition: name.clone(), why };
            let none = BTreeMap::new();
            let overrides = overrides.get(name).unwrap_or(&none);
            let hosting = Hosting {
                description: describe(&plan, &plan[id], (module, Clock::Virtual, ""), overrides),
                channels: &channels,
                neighbour: neighbour.clone(),
            };
            let start = functions::of(&plan[id].program)
                .ok_or_else(|| wrong(format!("{} is no partition of a flight", plan[id].program)))?;
            partitions.push((id, start(hosting).map_err(|error| wrong(error.to_string()))?));
        }
        let place = |id: PartitionId| partitions.iter().position(|(other, _)| *other == id);
        let timeline = Timeline::of(&plan, view.id(), plan.initial_schedule());
        let log = |error: std::io::Error| Error::Log(format!("{}: {error}", folder.display()));
        Ok(Self {
            line: plan.partition(line).and_then(place).unwrap_or(0),
            steps: steps(&timeline, place),
            next: 0,
            major_frame_ns: timeline.major_frame_ns,
            minor_frame_ns: timeline.minor_frame_ns,
            schedule: plan.initial_schedule().index(),
            major_frame: 0,
            minor_frames: 0,
            module_ns: 0,
            next_exchange_ns: 0,
            windows: 0,
            health: Health::begin(folder, &plan, partitions.len()).map_err(log)?,
            window_log: WindowLog::create(folder, Patience::Wait).map_err(log)?,
            recorder: Some(recorder),
            partitions,
            plan,
        })
    }

    /// Partitions that fly.
    #[must_use]
    pub fn partitions(&self) -> usize {
        self.partitions.len()
    }

    /// Flies to the next exchange.
    ///
    /// # Errors
    /// The flight is one for partitions, or a log can not be written.
    pub fn advance(&mut self) -> Result<Reached, Error> {
        loop {
            if self.next == self.steps.len() {
                self.next = 0;
                self.major_frame += 1;
            }
            let (offset_ns, step) = self.steps[self.next];
            self.next += 1;
            let at_ns = self.major_frame * self.major_frame_ns + offset_ns;
            match step {
                Step::Window(window, core, place) => self.window((window, core, place), at_ns),
                Step::MinorFrame => {
                    self.minor_frames = at_ns / self.minor_frame_ns;
                    self.module_ns = at_ns;
                    let stepped = self.health.step(&self.plan, &mut self.partitions, at_ns);
                    stepped.map_err(|NotShown(what)| Error::NotShown(what))?;
                    if at_ns >= self.next_exchange_ns {
                        self.next_exchange_ns = at_ns + EXCHANGE_NS;
                        if let Some(recorder) = &mut self.recorder {
                            recorder.turn()?;
                        }
                        let sent = self.partitions[self.line].1.page().device_sent.load(Relaxed);
                        return Ok(Reached { module_ns: at_ns, sent });
                    }
                }
            }
        }
    }

    /// So many bytes were written to the line by whoever is at its other end.
    pub fn expect(&mut self, bytes: u64) {
        self.partitions[self.line].1.page().device_expected.store(bytes, Relaxed);
    }

    fn window(&mut self, (window, core, place): (TimelineWindow, u32, usize), start_ns: u64) {
        let end_ns = start_ns + window.duration_ns();
        let major_frame_ns = self.major_frame * self.major_frame_ns;
        let (schedule, begun) = (self.schedule as u32, Instant::now());
        self.partitions[place].1.window(&WindowGrant {
            start_ns,
            end_ns,
            minor_frames: self.minor_frames,
            minor_frame_ns: self.minor_frame_ns,
            major_frame: self.major_frame,
            major_frame_ns,
            schedule,
            next_schedule: schedule,
            schedule_since_ns: 0,
        });
        self.windows += 1;
        let took_ns = begun.elapsed().as_nanos() as u64;
        let epoch = ScheduleEpoch { number: 0, schedule: self.schedule, after: None, since_ns: 0 };
        let record = WindowRecord {
            occurrence: Occurrence {
                window,
                core,
                epoch,
                major_frame: self.major_frame,
                minor_frames: self.minor_frames,
                minor_frame_ns: self.minor_frame_ns,
                start_ns,
                end_ns,
                late_ns: 0,
            },
            member: 0,
            ending: Ending::default(),
            missed: None,
            requested: None,
            granted_ns: Some(start_ns),
            opened_ns: Some(start_ns),
            closed_ns: Some(start_ns + took_ns),
        };
        let (plan, id) = (&self.plan, self.partitions[place].0);
        self.window_log.write(&record, &plan[id].name, &plan.schedules[self.schedule].name);
    }

    /// What happened since the last look.
    pub fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.health.events)
    }

    /// Ends the flight and its logs; the last event says so.
    pub fn finish(&mut self, reason: &str) -> Vec<Event> {
        let Some(recorder) = self.recorder.take() else { return Vec::new() };
        self.health.finish(&self.plan, &self.partitions, self.module_ns);
        self.window_log.finish();
        let time_s = seconds(self.module_ns);
        let mut events = self.take_events();
        if let Err(error) = recorder.finish() {
            let (log, reason) = (bateleur_recording::PORTS_FILE.to_owned(), error.to_string());
            events.push(Event::LogLost { time_s, log, reason });
        }
        events.push(Event::Stopped {
            reason: reason.to_owned(),
            module_time_s: time_s,
            windows: self.windows,
            late_windows: 0,
            late_switches: 0,
            lost_windows: 0,
            too_late_switches: 0,
            resets: 0,
            window_overruns: 0,
            spun_s: 0.0,
            lost_records: 0,
            unwritten_records: 0,
        });
        events
    }
}

/// At one instant a minor frame is announced first, then windows open in the order of the cores.
fn steps(timeline: &Timeline, place: impl Fn(PartitionId) -> Option<usize>) -> Vec<(u64, Step)> {
    let frames = (0..timeline.major_frame_ns / timeline.minor_frame_ns.max(1))
        .map(|minor| (minor * timeline.minor_frame_ns, 0, Step::MinorFrame));
    let windows = timeline.cores.iter().enumerate().flat_map(|(lane, line)| {
        let of_line = line.windows.iter().filter_map(|window| Some((*window, place(window.partition)?)));
        let core = line.core;
        of_line.map(move |(window, place)| (window.start_ns, lane + 1, Step::Window(window, core, place)))
    });
    let mut all: Vec<_> = frames.chain(windows).collect();
    all.sort_by_key(|(at_ns, lane, _)| (*at_ns, *lane));
    all.into_iter().map(|(at_ns, _, step)| (at_ns, step)).collect()
}

/// The module that flies where the plan has one.
#[must_use]
pub fn only_module(plan: &Plan) -> Option<ModuleView<'_>> {
    match plan.modules.as_slice() {
        [only] => plan.module(&only.name),
        _ => None,
    }
}
