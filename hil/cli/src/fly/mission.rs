//! The ground station's side of a flight, on either clock.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use bateleur_ground::{Mission, MissionPlan, Outcome, Pilot, Progress, Severity, UdpPilot};
use bateleur_messages::hil::{PilotOrder, Protocol};
use bateleur_messages::telemetry::Primary;
use bateleur_monitor::event::Event;
use bateleur_report::hosts::Host;

use super::Arguments;
use super::fleet::Fleet;
use super::here::NearPilot;
use super::simulator::Simulator;
use super::standing::Standing;
use crate::line::Line;

/// Wall clock: between two steps of the ground station.
const STEP: Duration = Duration::from_millis(50);
/// Module time between two lines of progress on the wall clock, ns.
const REPORT_NS: u64 = 5_000_000_000;
/// The same on the virtual clock.
const FAST_REPORT_NS: u64 = 25_000_000_000;
/// Module time for which the flight goes on after the simulator has died, so that the aircraft's own monitoring tells.
const AFTER_SIMULATOR_NS: u64 = 2_000_000_000;

/// How long the aircraft may miss its simulator before the flight is given up, real time: long enough for one that
/// somebody looks into with a debugger by mistake, short enough for whoever waits at the terminal.
const SIMULATOR_PATIENCE: Duration = Duration::from_secs(4);

/// How a flight went.
pub(super) struct Flown {
    /// Why the mission was not completed.
    pub(super) failure: Option<String>,
    /// Way-points that the aircraft said it reached.
    pub(super) waypoints_reached: u32,
    /// Module time, s.
    pub(super) module_time_s: f64,
    /// What the executive told of the run as a whole.
    pub(super) events: Vec<Event>,
    /// The hosts, the one whose time counts first; `None` if there was one.
    pub(super) hosts: Vec<Host>,
}

/// Flies; `None` if the executive could not start, and has said why.
pub(super) fn fly(
    arguments: &Arguments,
    plan: MissionPlan,
    simulator: Simulator,
    line: Line,
    fleet: Fleet,
    stop: Arc<AtomicBool>,
) -> Result<Option<Flown>> {
    let (pilot, links) = (FieldPilot::of(&simulator)?, fleet.links());
    let mut flight = Flight {
        mission: Mission::new(plan),
        simulator,
        line,
        fleet,
        pilot,
        stop,
        events: Vec::new(),
        ready: None,
        report_ns: if arguments.fast { FAST_REPORT_NS } else { REPORT_NS },
        reported_ns: 0,
        latest: None,
        standing: Standing::new(links),
        failure: None,
        simulator_lost_ns: None,
        simulator_silent: None,
    };
    if arguments.fast {
        flight.fast()
    } else {
        flight.wall()
    }
    Ok(flight.finish())
}

/// Who holds the sticks in this flight.
enum FieldPilot {
    /// The one of our simulator, who repeats what he understood.
    Ours(UdpPilot),
    /// As above, in this process.
    Near(NearPilot),
    /// One of somebody else's, who may not.
    Theirs(Option<UdpPilot>),
}

impl FieldPilot {
    fn of(simulator: &Simulator) -> Result<Self> {
        if let Some(server) = simulator.near() {
            return Ok(Self::Near(NearPilot(server.clone())));
        }
        let call = || UdpPilot::new(simulator.address).context("cannot reach the simulated safety pilot");
        Ok(match (simulator.is_ours(), simulator.protocol) {
            (true, _) => Self::Ours(call()?),
            (false, Protocol::Native) => Self::Theirs(Some(call()?)),
            // MAVLink has no word for it between these two, and a datagram from elsewhere might confuse the other end.
            (false, _) => Self::Theirs(None),
        })
    }
}

impl Pilot for FieldPilot {
    fn order(&mut self, order: PilotOrder) {
        match self {
            Self::Ours(pilot) => pilot.order(order),
            Self::Near(pilot) => pilot.order(order),
            Self::Theirs(pilot) => {
                if let Some(pilot) = pilot {
                    pilot.order(order);
                }
                if !pilot.as_mut().is_some_and(Pilot::confirmed) {
                    eprintln!(
                        "             now the simulator's own pilot has to take off: nobody here can call him"
                    );
                }
            }
        }
    }

    fn confirmed(&mut self) -> bool {
        match self {
            Self::Ours(pilot) => pilot.confirmed(),
            Self::Near(_) | Self::Theirs(_) => true,
        }
    }
}

struct Flight {
    mission: Mission,
    simulator: Simulator,
    line: Line,
    fleet: Fleet,
    pilot: FieldPilot,
    stop: Arc<AtomicBool>,
    events: Vec<Event>,
    ready: Option<Instant>,
    report_ns: u64,
    reported_ns: u64,
    latest: Option<Progress>,
    standing: Standing,
    failure: Option<String>,
    simulator_lost_ns: Option<u64>,
    /// Since when the aircraft says that the simulator does not answer, real time.
    simulator_silent: Option<Instant>,
}

impl Flight {
    /// The executive asks at every step of module time, and waits for the answer.
    fn fast(&mut self) {
        loop {
            self.take_events();
            match self.fleet.question() {
                Ok(Some(question)) => {
                    self.line.await_bytes(question.sent);
                    let over = self.step(question.module_ns);
                    if self.fleet.answer(self.line.link.bytes_sent(), over).is_err() {
                        return;
                    }
                }
                Ok(None) if self.is_alive() => {}
                _ => return,
            }
        }
    }

    fn wall(&mut self) {
        while self.is_alive() {
            self.take_events();
            let over = match self.ready {
                Some(ready) => self.step(ready.elapsed().as_nanos() as u64),
                None => self.stop.load(Ordering::Acquire),
            };
            if over {
                return;
            }
            std::thread::sleep(STEP);
        }
    }

    /// Whether there is an aircraft: its executive runs, and nothing that it needs for its start has failed.
    fn is_alive(&mut self) -> bool {
        if self.fleet.has_ended() {
            return false;
        }
        let missing = self.fleet.ended_before_ready();
        let alive = missing.is_none() && !self.is_interrupted_before_ready();
        self.failure = missing.or(self.failure.take());
        alive
    }

    /// The virtual clock asks nobody before all hosts are there.
    fn is_interrupted_before_ready(&self) -> bool {
        self.ready.is_none() && self.stop.load(Ordering::Acquire)
    }

    /// One step of the ground station; true: the flight is over.
    fn step(&mut self, module_ns: u64) -> bool {
        let mut lines = self.fleet.perform(module_ns);
        lines.extend(self.simulator.can.iter_mut().flat_map(|can| can.perform(module_ns)));
        for line in lines {
            eprintln!("{:9.3} s  {line}", module_ns as f64 / 1e9);
        }
        let progress = self.mission.step(module_ns, &mut self.line.link, &mut self.pilot);
        for event in &progress.events {
            let mark = if event.severity == Severity::Info { "" } else { "! " };
            eprintln!("{:9.3} s  {mark}{}", event.time_ns as f64 / 1e9, event.text);
        }
        if module_ns >= self.reported_ns + self.report_ns {
            self.reported_ns = module_ns;
            eprintln!("{}", describe(&progress));
        }
        let over = progress.is_over();
        self.latest = Some(progress);
        over || self.is_cut_short(module_ns)
    }

    fn is_cut_short(&mut self, module_ns: u64) -> bool {
        if self.stop.load(Ordering::Acquire) {
            return true;
        }
        if let Some(reason) = self.simulator.ended() {
            let lost_ns = *self.simulator_lost_ns.get_or_insert_with(|| {
                eprintln!("{:9.3} s  ! {reason}", module_ns as f64 / 1e9);
                module_ns
            });
            self.failure = Some(reason);
            return module_ns >= lost_ns + AFTER_SIMULATOR_NS;
        }
        if self.simulator_silence() >= SIMULATOR_PATIENCE {
            let simulator = &self.simulator;
            let somebody_elses = (!simulator.is_ours()).then_some(simulator.protocol);
            let reason = unanswered(simulator.address, somebody_elses, simulator.is_stopped());
            eprintln!("{:9.3} s  ! {reason}", module_ns as f64 / 1e9);
            self.failure = Some(reason);
            return true;
        }
        false
    }

    /// How long the aircraft's telemetry says that HIL mode is on and the simulator does not answer.
    fn simulator_silence(&mut self) -> Duration {
        let misses = |primary: Primary| primary.hil != 0 && primary.hil_ready == 0;
        if self.mission.board().primary.is_some_and(|latest| misses(latest.message)) {
            self.simulator_silent.get_or_insert_with(Instant::now).elapsed()
        } else {
            self.simulator_silent = None;
            Duration::ZERO
        }
    }

    fn take_events(&mut self) {
        for event in self.fleet.take_events() {
            say(&event);
            self.standing.take(&event);
            if matches!(event, Event::Ready { .. }) {
                self.ready = Some(Instant::now());
            }
            // What happened in flight stands in the logs; here the frame of the run is kept.
            if matches!(event, Event::Guarantees { .. } | Event::Ready { .. } | Event::Stopped { .. }) {
                self.events.push(event);
            }
        }
    }

    fn finish(mut self) -> Option<Flown> {
        self.take_events();
        let rest = self.fleet.finish();
        rest.iter().for_each(say);
        self.events.extend(rest);
        self.simulator.finish();
        self.events.iter().find(|event| matches!(event, Event::Ready { .. }))?;
        let module_time_s = self.events.iter().rev().find_map(|event| match event {
            Event::Stopped { module_time_s, .. } => Some(*module_time_s),
            _ => None,
        });
        let latest_ns = self.latest.as_ref().map_or(0, |progress| progress.time_ns);
        let ended = self.events.iter().rev().find_map(|event| match event {
            Event::Stopped { reason, .. } => Some(format!(": {reason}")),
            _ => None,
        });
        let failure = match self.latest.as_ref().map(|progress| &progress.outcome) {
            Some(Outcome::Finished) => None,
            _ if self.stop.load(Ordering::Acquire) => Some("it was interrupted".into()),
            Some(Outcome::Failed(why)) => Some(self.failure.unwrap_or_else(|| why.clone())),
            _ => Some(self.failure.unwrap_or_else(|| {
                format!("the executive ended before the mission did{}", ended.unwrap_or_default())
            })),
        };
        let failure = failure.map(|failure| match self.stop.load(Ordering::Acquire) {
            true => failure,
            false => self.standing.explain(failure),
        });
        Some(Flown {
            failure,
            waypoints_reached: self.latest.map_or(0, |progress| progress.waypoints_reached),
            module_time_s: module_time_s.unwrap_or(latest_ns as f64 / 1e9),
            events: self.events,
            hosts: self.fleet.hosts(),
        })
    }
}

/// That the simulator is silent, where it should be, and what is known of why.
fn unanswered(address: SocketAddr, somebody_elses: Option<Protocol>, is_stopped: bool) -> String {
    let why = match somebody_elses {
        _ if is_stopped => ": its process is stopped (SIGSTOP)".to_owned(),
        None => String::new(),
        Some(protocol) => {
            format!(": does it listen there (--simulator), and speak {} (--protocol)?", protocol.name())
        }
    };
    format!("the simulator at {address} has not answered for {} s{why}", SIMULATOR_PATIENCE.as_secs())
}

fn describe(progress: &Progress) -> String {
    let number = |value: Option<f64>, unit: &str| {
        value.map_or_else(|| format!("   - {unit}"), |value| format!("{value:6.1} {unit}"))
    };
    let next = progress.next_waypoint.map_or_else(|| " - ".into(), |next| format!("WP{next}"));
    let silent = progress
        .estimator_silent_ns
        .map_or_else(String::new, |silent_ns| format!("  ! no estimate for {:.0} s", silent_ns as f64 / 1e9));
    format!(
        "{:9.3} s  {:<12} to {next}  {}  {}  {}/{} way-points{silent}",
        progress.time_ns as f64 / 1e9,
        progress.phase.name(),
        number(progress.altitude_m, "m"),
        number(progress.airspeed_mps, "m/s"),
        progress.waypoints_reached,
        progress.waypoints_to_reach
    )
}

/// One event as a line for a person.
fn say(event: &Event) {
    let text = event.to_string();
    if !text.is_empty() {
        eprintln!("{text}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn simulator_that_does_not_answer_is_named_with_its_address_and_what_to_look_at() {
        let address = SocketAddr::from(([127, 0, 0, 1], 15_400));
        assert_eq!(
            unanswered(address, Some(Protocol::Native), false),
            "the simulator at 127.0.0.1:15400 has not answered for 4 s: does it listen there (--simulator), and speak \
             native (--protocol)?"
        );
        assert!(unanswered(address, None, true).ends_with("for 4 s: its process is stopped (SIGSTOP)"));
        assert!(unanswered(address, None, false).ends_with("for 4 s"));
    }
}
