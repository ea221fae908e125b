//! A flight within this process: the simulator and the nine partitions take turns in one loop.

use std::cell::RefCell;
use std::io;
use std::path::Path;
use std::rc::Rc;

use anyhow::{Context, Result, bail};
use bateleur_ground::Pilot;
use bateleur_messages::hil::{PilotOrder, Protocol};
use bateleur_monitor::event::Event;
use bateleur_one_process::{OneProcess, Overrides, Reached, Setup, only_module};
use bateleur_plan::Plan;
use bateleur_plant::Turbulence;
use bateleur_simulator::{Options, Server, airframe};

use super::executive::{Question, settings};
use super::simulator::Simulator;
use super::{Arguments, partition_running};
use crate::line::Line;
use bateleur_executive_cli::setting::parse_setting;

/// What flies the partitions.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Engine {
    /// Each partition is a process of its own, as in an aircraft.
    #[default]
    Partitions,
    /// All are in this process, in one loop: quicker, and without everything that needs processes (virtual clock only).
    OneProcess,
}

impl Engine {
    /// As it is written.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Partitions => "partitions",
            Self::OneProcess => "one-process",
        }
    }
}

/// What is said where a flight came to what one process has not.
pub(crate) const ONE_PROCESS_ENDS: &str = "one process can not show what follows";

/// The simulator of a flight within this process.
pub(super) type Neighbour = Rc<RefCell<Server>>;

/// What one process can not show of what was asked for; nothing where it can.
pub(crate) fn unsuitable(arguments: &Arguments, plan: &Plan) -> Option<String> {
    let asked = [
        (!arguments.fast, "the wall clock (give --fast)"),
        (!arguments.faults.arguments().is_empty(), "kills, faults of processes and schedule changes"),
        (arguments.hosts.hosts || plan.modules.len() > 1, "several hosts"),
        (arguments.no_simulator, "a simulator of somebody else's"),
        (arguments.view, "the page of a module (--view)"),
        (super::can::is_between(plan), "a CAN bus"),
        (arguments.require.is_some(), "the promises of a machine (--require)"),
        (arguments.protocol == Some(Protocol::MavlinkTcp), "MAVLink over TCP"),
    ];
    if let Some((_, what)) = asked.iter().find(|(asked, _)| *asked) {
        return Some((*what).to_owned());
    }
    let module = only_module(plan)?;
    bateleur_one_process::unsuitable(plan, module.name())
}

/// Takes the simulator's address, as a process of its own would.
pub(super) fn simulator(
    arguments: &Arguments,
    folder: &Path,
    protocol: Protocol,
) -> Result<(Simulator, Neighbour)> {
    let mut options = Options {
        listen: arguments.simulator,
        protocol,
        airframe: airframe(arguments.airframe.as_deref().unwrap_or("aerosonde"))?,
        truth: Some(folder.join("truth.bin")),
        flightgear: arguments.flightgear,
        ..Options::default()
    };
    options.conditions.seed = arguments.seed;
    options.conditions.wind_speed_mps = arguments.wind;
    options.conditions.wind_from_rad = arguments.wind_from.to_radians();
    options.conditions.turbulence = match arguments.turbulence.as_str() {
        "light" => Turbulence::Light,
        "moderate" => Turbulence::Moderate,
        "severe" => Turbulence::Severe,
        _ => Turbulence::Calm,
    };
    arguments.outside.apply(&mut options)?;
    let server = Rc::new(RefCell::new(Server::bind(&options)?));
    let address = server.borrow().address();
    Ok((Simulator::here(address, protocol, server.clone()), server))
}

/// The safety pilot of a simulator within this process.
pub(super) struct NearPilot(pub(super) Neighbour);

impl Pilot for NearPilot {
    fn order(&mut self, order: PilotOrder) {
        self.0.borrow_mut().order(order);
    }
}

/// The module of a flight within this process, as its executive would be seen.
pub(super) struct Module {
    flight: OneProcess,
    /// What it has said before its first instant.
    said: Vec<Event>,
    stopped: Option<String>,
}

impl Module {
    pub(super) fn start(
        arguments: &Arguments,
        plan: &Plan,
        folder: &Path,
        (simulator, neighbour): (&Simulator, &Neighbour),
        line: &Line,
    ) -> Result<Self> {
        let Some(module) = only_module(plan) else { bail!("the plan has several modules") };
        let server = neighbour.clone();
        let flight = OneProcess::start(Setup {
            plan: plan.clone(),
            module: module.name(),
            overrides: &overrides(arguments, plan, simulator, line)?,
            line: &partition_running(plan, "command")?,
            folder,
            neighbour: Rc::new(move || server.borrow_mut().serve_waiting()),
        })?;
        let said = vec![Event::Ready { partitions: flight.partitions(), module: None }];
        Ok(Self { flight, said, stopped: None })
    }

    pub(super) fn take_events(&mut self) -> Vec<Event> {
        let mut events = std::mem::take(&mut self.said);
        events.extend(self.flight.take_events());
        events
    }

    pub(super) fn has_ended(&self) -> bool {
        self.stopped.is_some()
    }

    /// Flies to the next instant at which an executive would ask.
    pub(super) fn question(&mut self) -> io::Result<Question> {
        match self.flight.advance() {
            Ok(Reached { module_ns, sent }) => Ok(Question { module_ns, sent }),
            Err(error) => {
                self.stopped = Some(error.to_string());
                Err(io::Error::other(error.to_string()))
            }
        }
    }

    pub(super) fn answer(&mut self, bytes: u64) {
        self.flight.expect(bytes);
    }

    pub(super) fn finish(&mut self) -> Vec<Event> {
        let reason = self.stopped.clone().unwrap_or_else(|| "the mission is over".into());
        let mut events = std::mem::take(&mut self.said);
        events.extend(self.flight.finish(&reason));
        events
    }
}

/// What a flight sets, and what was asked for, which counts more.
fn overrides(arguments: &Arguments, plan: &Plan, simulator: &Simulator, line: &Line) -> Result<Overrides> {
    let own = settings(arguments, plan, simulator, line)?;
    let own = own.into_iter().map(|(partition, setting)| format!("{partition}.{setting}"));
    let mut overrides = Overrides::new();
    for text in own.chain(arguments.set.iter().cloned()) {
        let setting = parse_setting(&text).map_err(anyhow::Error::msg).context("--set")?;
        if plan.partition(&setting.partition).is_none() {
            bail!("--set {text}: the plan has no partition {}", setting.partition);
        }
        overrides.entry(setting.partition).or_default().insert(setting.attribute, setting.value);
    }
    Ok(overrides)
}
