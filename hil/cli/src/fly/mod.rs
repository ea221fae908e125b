//! `bateleur fly`: a whole flight, hardware-in-the-loop: starts the simulator, the module and the ground station, flies
//! the mission, and writes what happened into `target/flights/<run>/`: `summary.json`, `report.html`, the log of every
//! port (`ports.mcap`) and every window (`windows.csv`), the truth, the health log.
//!
//! Progress goes to standard error; the summary goes to standard output, as a table or as JSON. Exit codes: 0 the mission
//! was completed, 1 it was not, 2 it could not begin.

mod can;
mod executive;
mod fleet;
pub(crate) mod here;
pub(crate) mod hosts;
pub(crate) mod kept;
mod mission;
mod ready;
mod remains;
mod simulator;
mod standing;
mod viewer;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result, bail};
use bateleur_checker::Facts;
use bateleur_flight::airframe::Airframe;
use bateleur_flight::control::envelope::Envelope;
use bateleur_flight::guidance::{self, Corner};
use bateleur_ground::MissionPlan;
use bateleur_host::processor::Claim;
use bateleur_messages::ground;
use bateleur_messages::hil::Protocol;
use bateleur_monitor::event::Event;
use bateleur_monitor::{planned, why};
use bateleur_plan::{Attribute, PartitionId, Plan};
use bateleur_report::chains::ChainBound;
use bateleur_report::hosts as report_hosts;
use bateleur_report::reasons::Reason;
use bateleur_report::run::{Clock, FILE, Guarantee, Mission as MissionResult, Run};
use bateleur_report::{Inputs, Summary};
use bateleur_simulator::{LEVEL_OFF_M, Outside};

use super::air::{direction, seed, wind};
use super::{CANNOT_RUN, Code, FINE, Format, WRONG};
use crate::line::Line;
use bateleur_executive_cli::faults::Faults;
use bateleur_executive_cli::hosts::namespace::{self, Lan};
use bateleur_executive_cli::installed::{self, SCHEDULE};
use bateleur_executive_cli::output;
use bateleur_executive_cli::plan_file;
use bateleur_executive_cli::setting::parse_setting;
use fleet::Fleet;
use hosts::Hosts;
use mission::Flown;

/// Fly the mission hardware-in-the-loop.
#[derive(Debug, Clone, clap::Args)]
pub struct Arguments {
    /// The schedule file.
    #[arg(long, short, default_value = SCHEDULE, value_parser = installed::schedule())]
    pub(crate) schedule: PathBuf,
    /// The module that flies; may be left out where the file has one.
    #[arg(long, short)]
    pub(crate) module: Option<String>,
    /// Fly on the virtual clock: as fast as the machine can, the same flight for the same seed.
    #[arg(long)]
    pub(crate) fast: bool,
    /// On the virtual clock: the processor of the flight.
    #[arg(skip)]
    pub(crate) processor: Option<u32>,
    /// What flies the partitions.
    #[arg(long, value_enum, default_value_t)]
    pub(crate) engine: here::Engine,
    /// Seed of everything random.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = seed, allow_negative_numbers = true)]
    pub(crate) seed: u64,
    /// Mean wind, m/s.
    #[arg(long, value_name = "M/S", default_value_t = 0.0, value_parser = wind, allow_negative_numbers = true)]
    pub(crate) wind: f64,
    /// Where the wind comes from, degrees clockwise from north.
    #[arg(long, value_name = "DEG", default_value_t = 0.0, value_parser = direction, allow_negative_numbers = true)]
    pub(crate) wind_from: f64,
    /// Gusts.
    #[arg(long, value_name = "LEVEL", default_value = "calm", value_parser = ["calm", "light", "moderate", "severe"])]
    pub(crate) turbulence: String,
    /// The aircraft, for the simulator and for the laws: aerosonde, rascal110, ultrastick25e, vtail60, zagi, or the file of
    /// an airframe.
    #[arg(long, value_name = "NAME|FILE")]
    pub(crate) airframe: Option<String>,
    #[command(flatten)]
    pub(crate) outside: Outside,
    #[command(flatten)]
    pub(crate) hosts: hosts::Options,
    #[command(flatten)]
    pub(crate) can: can::Options,
    #[command(flatten)]
    pub(crate) faults: Faults,
    /// Replace an attribute of the plan (may be repeated).
    #[arg(long, value_name = "PARTITION.ATTRIBUTE=VALUE")]
    pub(crate) set: Vec<String>,
    /// Way-points, laps and limits, instead of the usual two laps of four way-points.
    #[arg(long, value_name = "FILE")]
    pub(crate) mission: Option<PathBuf>,
    /// Who takes off, instead of what the mission says: the simulator's safety pilot (`pilot`), or the aircraft by itself (`autopilot`).
    #[arg(long, value_name = "WHO", value_parser = ["pilot", "autopilot"])]
    pub(crate) take_off: Option<String>,
    /// Land after the laps, and fly until the aircraft stands; as `landing = true` in the mission.
    #[arg(long)]
    pub(crate) land: bool,
    /// What module and simulator speak: native, mavlink (over UDP), mavlink-tcp; instead of what the plan says.
    #[arg(long, value_name = "NAME")]
    pub(crate) protocol: Option<Protocol>,
    /// Start no simulator: fly one of somebody else's, which listens at `--simulator` (port 0: the protocol's usual one).
    #[arg(long)]
    pub(crate) no_simulator: bool,
    /// Address of the simulator; port 0 takes a free one.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:0")]
    pub(crate) simulator: SocketAddr,
    /// Show the aircraft to a FlightGear that listens at that address (`--native-fdm=socket,in,50,,PORT,udp`).
    #[arg(long, value_name = "ADDRESS:PORT", conflicts_with = "no_simulator")]
    pub(crate) flightgear: Option<SocketAddr>,
    /// Let the simulator follow its own clock instead of the module's; on the wall clock only.
    #[arg(long, conflicts_with = "fast")]
    pub(crate) free_running: bool,
    /// Folder of this flight; the default is one of its own below target/flights.
    #[arg(long, short)]
    pub(crate) output: Option<PathBuf>,
    /// Show the flight on a page in a browser while it lasts; its address is printed.
    #[arg(long, conflicts_with = "hosts")]
    pub(crate) view: bool,
    /// End when standard input does: for programs that start it.
    #[arg(long)]
    pub(crate) until_stdin_closes: bool,
    /// Refuse to fly where this machine lacks something.
    #[arg(long, value_name = "HOW", value_parser = ["strict"])]
    pub(crate) require: Option<String>,
    /// What to print at the end.
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    let Some(plan) = plan_file::read_or_say(&arguments.schedule)? else { return Ok(CANNOT_RUN) };
    let mission = read_mission(arguments, &plan)?;
    let air = arguments.wind != 0.0 || arguments.turbulence != "calm";
    if arguments.no_simulator && (air || arguments.outside != Outside::default()) {
        bail!(
            "--wind, --turbulence, --fault, --sensors, --vary and --plant are for this project's simulator; \
             --no-simulator flies somebody else's"
        );
    }
    if arguments.engine == here::Engine::OneProcess
        && let Some(what) = here::unsuitable(arguments, &plan)
    {
        bail!("one process can not show {what}: fly it with --engine partitions");
    }
    if let Some(folder) = &arguments.output {
        output::refuse_used(folder)?;
    }
    // One process is left where the kernel puts it.
    let is_bound = arguments.fast && arguments.engine == here::Engine::Partitions;
    let claim = is_bound.then(|| Claim::take(&plan.cores()));
    let processor = claim.as_ref().map(Claim::processor);
    let set = settings(arguments, &plan, &mission)?;
    let arguments = &Arguments { set, processor, ..arguments.clone() };
    let kept = kept::Inputs::read(arguments)?;
    let unflyable = unflyable(arguments, &plan, &mission);
    unflyable.iter().for_each(|note| eprintln!("{note}"));
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM, signal_hook::consts::SIGHUP] {
        signal_hook::flag::register(signal, stop.clone()).context("cannot watch for signals")?;
    }
    if arguments.until_stdin_closes {
        let stop = stop.clone();
        std::thread::spawn(move || {
            let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink()); // closed either way
            stop.store(true, Ordering::Release);
        });
    }
    let folder = FlightFolder::make(arguments)?;
    keep_waypoints(&mission, &folder.path)?;
    let begun = Instant::now();
    let Some(flown) = fly(arguments, &plan, &mission, &folder.path, stop.clone())? else {
        if stop.load(Ordering::Acquire) {
            bail!("interrupted before the partitions were ready");
        }
        return Ok(CANNOT_RUN);
    };
    drop(claim);
    let folder = folder.keep();
    let mut record = record(arguments, &flown, begun.elapsed().as_secs_f64());
    record.notes.extend(unflyable);
    std::fs::write(folder.join(FILE), serde_json::to_vec_pretty(&record)?)
        .context("cannot write run.json")?;
    kept.keep(&folder)?;
    let summary = bateleur_report::write(&folder, &inputs(arguments, &plan, &mission, &folder))?;
    print_summary(arguments, &summary, &folder)?;
    Ok(if summary.completed { FINE } else { WRONG })
}

fn fly(
    arguments: &Arguments,
    plan: &Plan,
    mission: &MissionPlan,
    folder: &Path,
    stop: Arc<AtomicBool>,
) -> Result<Option<Flown>> {
    let protocol = protocol(arguments, plan)?;
    can::check(arguments, plan)?;
    if arguments.hosts.hosts {
        return fly_hosts(arguments, plan, mission, folder, protocol, stop);
    }
    if arguments.engine == here::Engine::OneProcess {
        return fly_here(arguments, plan, mission, folder, protocol, stop);
    }
    let mut simulator = match arguments.no_simulator {
        true => simulator::Simulator::of_somebody_else(arguments, protocol),
        false => simulator::Simulator::start(arguments, plan, folder, protocol)?,
    };
    simulator.can = can::Can::start(arguments, plan, folder, simulator.address)?;
    let line = Line::open()?;
    let executive = executive::Executive::start(arguments, plan, folder, &simulator, &line)?;
    let _viewer = arguments.view.then(|| viewer::Viewer::start(executive.pid())).transpose()?;
    if arguments.fast {
        // Not before: processes that are started inherit the place.
        simulator::stand(std::process::id() as i32, arguments, plan);
    }
    mission::fly(arguments, mission.clone(), simulator, line, Fleet::of_one(executive), stop)
}

/// The same within this process.
fn fly_here(
    arguments: &Arguments,
    plan: &Plan,
    mission: &MissionPlan,
    folder: &Path,
    protocol: Protocol,
    stop: Arc<AtomicBool>,
) -> Result<Option<Flown>> {
    let (simulator, neighbour) = here::simulator(arguments, folder, protocol)?;
    let line = Line::open()?;
    let module = here::Module::start(arguments, plan, folder, (&simulator, &neighbour), &line)?;
    mission::fly(arguments, mission.clone(), simulator, line, Fleet::here(module), stop)
}

/// The same with one executive for each module of the plan.
fn fly_hosts(
    arguments: &Arguments,
    plan: &Plan,
    mission: &MissionPlan,
    folder: &Path,
    protocol: Protocol,
    stop: Arc<AtomicBool>,
) -> Result<Option<Flown>> {
    let hosts = Hosts::prepare(arguments, plan, folder)?;
    let id = |place: usize| plan.module(&hosts.modules[place]).map(|view| view.id());
    // The simulator and this program are where the module is that talks to it.
    let near = hosts::place_of(plan, "hil_interface")?;
    let main = hosts::place_of(plan, "command")?;
    let mut lan = match (arguments.fast, id(near)) {
        (false, Some(near)) => Some(Lan::make(plan, Some(near))?),
        _ => None,
    };
    let simulator = simulator::Simulator::start(arguments, plan, folder, protocol)?;
    let line = Line::open()?;
    let mut started = Vec::new();
    for (place, module) in hosts.modules.iter().enumerate() {
        let apart = lan.as_mut().zip(id(place)).filter(|_| place != near);
        let interfaces = apart.as_ref().map(|(_, id)| namespace::interfaces(plan, *id));
        let ends = (&simulator, &line);
        let mut executive = executive::Executive::of_host(arguments, plan, &hosts, place, ends, interfaces)?;
        if let Some((lan, id)) = apart {
            executive.join(lan, plan, id)?;
        }
        started.push((module.clone(), executive));
    }
    let first = started.remove(main);
    let fleet = Fleet::of_hosts(arguments, plan, hosts, first, started, lan);
    let flown = mission::fly(arguments, mission.clone(), simulator, line, fleet, stop)?;
    if let Some(flown) = &flown {
        join_logs(arguments, plan, folder, &flown.hosts)?;
    }
    Ok(flown)
}

/// Makes one log of those of all hosts.
fn join_logs(arguments: &Arguments, plan: &Plan, folder: &Path, hosts: &[report_hosts::Host]) -> Result<()> {
    let joined = |(id, link): (usize, &bateleur_plan::Link)| report_hosts::Joined {
        id: id as u64,
        modules: link.ends.map(|end| plan[end].name.clone()),
    };
    // On one virtual clock there is one time, whatever relays measure over a network that delays one way more than the other.
    let measured = plan.links.iter().enumerate().filter(|_| !arguments.fast);
    let links: Vec<_> = measured.map(joined).collect();
    let hosts = report_hosts::shifts(folder, hosts, &links);
    for note in report_hosts::merge(folder, &hosts).context("cannot join the hosts' logs")? {
        eprintln!("             {note}");
    }
    Ok(())
}

/// Writes down the way-points, for those who look at the flight while it goes on.
fn keep_waypoints(mission: &MissionPlan, folder: &Path) -> Result<()> {
    let place = |point: &ground::Waypoint| -> bateleur_view::Place {
        [point.north_m, point.east_m, point.altitude_m]
    };
    let places: Vec<_> = mission.waypoints.iter().map(place).collect();
    let path = folder.join(bateleur_view::MISSION_FILE);
    std::fs::write(&path, serde_json::to_vec(&places)?)
        .with_context(|| format!("cannot write {}", path.display()))
}

/// What module and simulator speak: what was asked for, or what the plan says.
fn protocol(arguments: &Arguments, plan: &Plan) -> Result<Protocol> {
    if let Some(protocol) = arguments.protocol {
        if protocol != Protocol::Native && can::is_between(plan) {
            bail!(
                "--protocol {protocol}: the distribution board between simulator and CAN bus speaks native"
            );
        }
        return Ok(protocol);
    }
    if can::is_between(plan) {
        return Ok(Protocol::Native);
    }
    let prefix = format!("{}.protocol=", partition_running(plan, "hil_interface")?);
    if let Some(word) = arguments.set.iter().rev().find_map(|set| set.strip_prefix(&prefix)) {
        return Ok(word.trim_matches('"').parse()?);
    }
    match attribute(plan, "hil_interface", "protocol") {
        Some(Attribute::String(word)) => Ok(word.parse()?),
        _ => Ok(Protocol::default()),
    }
}

/// A program in the folder of this one.
fn beside_self(name: &str) -> Result<PathBuf> {
    let own = std::env::current_exe().context("cannot find this program")?;
    Ok(own.parent().map(|folder| folder.join(name)).unwrap_or_else(|| name.into()))
}

/// The partition that runs program `name`, so that a plan may call its partitions as it likes.
pub(crate) fn partition_running(plan: &Plan, name: &str) -> Result<String> {
    let partition = running(plan, name)?;
    // Who sets something in a replica sets it in all of them.
    Ok(plan[plan.voter_of(partition).unwrap_or(partition)].name.clone())
}

/// The first partition that runs the program.
pub(crate) fn running(plan: &Plan, name: &str) -> Result<PartitionId> {
    let runs = |program: &str| program.rsplit('/').next() == Some(name);
    match plan.partitions.iter().position(|partition| runs(&partition.program)) {
        Some(place) => Ok(PartitionId(place)),
        None => bail!(
            "no partition of the plan runs the program {name}, which a flight needs: this verb is for flights, and `bateleur run` runs \
             any plan"
        ),
    }
}

/// The programs that talk to the simulator and to the ground.
const OF_EVERY_FLIGHT: [&str; 2] = ["hil_interface", "command"];

/// An error where the plan can not be flown.
pub(crate) fn check_flies(plan: &Plan) -> Result<()> {
    OF_EVERY_FLIGHT.iter().try_for_each(|program| partition_running(plan, program).map(drop))
}

pub(crate) fn read_mission(arguments: &Arguments, plan: &Plan) -> Result<MissionPlan> {
    let own_take_off = arguments.take_off.as_deref().map(|who| who == "autopilot");
    if let Some(path) = &arguments.mission {
        let mut mission = MissionPlan::from_file(path)?;
        mission.own_take_off = own_take_off.unwrap_or(mission.own_take_off);
        mission.landing |= arguments.land;
        let our_pilot = !arguments.no_simulator && !mission.own_take_off;
        if our_pilot && mission.engage_altitude_m > LEVEL_OFF_M {
            bail!(
                "{}: engage_altitude_m is {}, and the safety pilot climbs to {LEVEL_OFF_M} m only: give less, or \
                 take_off = \"autopilot\"",
                path.display(),
                mission.engage_altitude_m
            );
        }
        return Ok(mission);
    }
    let laps = attribute(plan, "controller", "laps").and_then(|laps| match laps {
        Attribute::Integer(laps @ 1..=1000) => Some(*laps as u32),
        _ => None,
    });
    let thesis = MissionPlan::thesis();
    let own_take_off = own_take_off.unwrap_or(thesis.own_take_off);
    Ok(MissionPlan { laps: laps.unwrap_or(thesis.laps), own_take_off, landing: arguments.land, ..thesis })
}

fn attribute<'a>(plan: &'a Plan, program: &str, name: &str) -> Option<&'a Attribute> {
    plan[running(plan, program).ok()?].attributes.get(name)
}

/// The attributes that are replaced: those asked for, and the laps of a mission of one's own, after which the aircraft is to circle.
pub(crate) fn settings(arguments: &Arguments, plan: &Plan, mission: &MissionPlan) -> Result<Vec<String>> {
    let mut settings = arguments.set.clone();
    if arguments.mission.is_some() && asked(arguments, plan, "controller", "laps").is_none() {
        settings.push(format!("{}.laps={}", partition_running(plan, "controller")?, mission.laps));
    }
    Ok(settings)
}

/// What `--set` asks of an attribute.
fn asked(arguments: &Arguments, plan: &Plan, program: &str, name: &str) -> Option<serde_json::Value> {
    let partition = partition_running(plan, program).ok()?;
    let settings = arguments.set.iter().rev().filter_map(|text| parse_setting(text).ok());
    let mut found = settings.filter(|setting| setting.partition == partition && setting.attribute == name);
    found.next().map(|setting| setting.value)
}

/// An attribute as it was flown with: asked for, or the plan's.
fn in_effect(arguments: &Arguments, plan: &Plan, program: &str, name: &str) -> Option<serde_json::Value> {
    let planned = || serde_json::to_value(attribute(plan, program, name)?).ok();
    asked(arguments, plan, program, name).or_else(planned)
}

/// The folder of a flight that has not begun yet: a start that fails leaves nothing behind.
struct FlightFolder {
    path: PathBuf,
    is_new: bool,
    begun: bool,
}

impl FlightFolder {
    fn make(arguments: &Arguments) -> Result<Self> {
        let path = arguments.output.clone().unwrap_or_else(|| {
            let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
            let name = format!("{}-{}-seed{}", date(seconds), std::process::id(), arguments.seed);
            installed::outputs("flights").join(name)
        });
        let is_new = !path.exists();
        bateleur_system::folders::make(&path)
            .with_context(|| format!("cannot make the folder {}", path.display()))?;
        Ok(Self { path, is_new, begun: false })
    }

    /// There was a flight: what it left stays.
    fn keep(mut self) -> PathBuf {
        self.begun = true;
        self.path.clone()
    }
}

impl Drop for FlightFolder {
    fn drop(&mut self) {
        if self.begun {
            return;
        }
        // It is the disk's tidiness only, and the reason of the failure is told already.
        let _ = if self.is_new { std::fs::remove_dir_all(&self.path) } else { output::clear(&self.path) };
    }
}

/// Seconds since 1970 as "20261121-093000", UTC (the usual civil-calendar arithmetic on 400-year eras).
fn date(seconds: u64) -> String {
    let (days, rest) = (seconds / 86_400, seconds % 86_400);
    let shifted = days + 719_468;
    let (era, day_of_era) = (shifted / 146_097, shifted % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted_month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted_month + 2) / 5 + 1;
    let month = if shifted_month < 10 { shifted_month + 3 } else { shifted_month - 9 };
    let year = era * 400 + year_of_era + u64::from(month <= 2);
    format!("{year:04}{month:02}{day:02}-{:02}{:02}{:02}", rest / 3_600, rest % 3_600 / 60, rest % 60)
}

fn record(arguments: &Arguments, flown: &Flown, wall_time_s: f64) -> Run {
    Run {
        clock: if arguments.fast { Clock::Virtual } else { Clock::Wall },
        seed: arguments.seed,
        wall_time_s,
        module_time_s: flown.module_time_s,
        schedule: arguments.schedule.display().to_string(),
        foreign_simulator: arguments.no_simulator,
        mission: MissionResult {
            completed: flown.failure.is_none(),
            failure: flown.failure.clone(),
            waypoints_reached: Some(flown.waypoints_reached),
        },
        guarantees: guarantees(&flown.events),
        lost_records: lost_records(&flown.events),
        notes: [not_reached(arguments, flown.module_time_s), undone(&flown.events)].concat(),
        arguments: std::env::args().skip(1).collect(),
    }
}

/// What was planned for later than the flight's end.
fn not_reached(arguments: &Arguments, module_time_s: f64) -> Vec<String> {
    let faults = &arguments.faults;
    let end_ns = (module_time_s * 1e9) as u64;
    let mut notes = planned::not_reached(&faults.planned(), &faults.schedule_changes(), end_ns);
    notes.extend(arguments.outside.not_reached(module_time_s));
    notes.extend(arguments.can.not_reached(module_time_s));
    notes.extend(arguments.hosts.not_reached(module_time_s));
    notes
}

/// What was planned and could not be done: a test of faults that tested less than it seems.
fn undone(events: &[Event]) -> Vec<String> {
    let note = |event: &Event| match event {
        Event::Undone { time_s, partition, text } => Some(format!("{partition}: {text} (at {time_s:.2} s)")),
        _ => None,
    };
    events.iter().filter_map(note).collect()
}

fn guarantees(events: &[Event]) -> Vec<Guarantee> {
    let list = events.iter().find_map(|event| match event {
        Event::Guarantees { list } => Some(list),
        _ => None,
    });
    let all = list.into_iter().flatten();
    all.map(|one| Guarantee { promise: one.promise.clone(), held: one.held, detail: one.detail.clone() })
        .collect()
}

fn lost_records(events: &[Event]) -> u64 {
    let lost = events.iter().find_map(|event| match event {
        Event::Stopped { lost_records, .. } => Some(*lost_records),
        _ => None,
    });
    lost.unwrap_or(0)
}

/// What the report of a flight has to know besides the logs in its folder.
///
/// # Errors
/// Schedule or mission can not be read.
pub(crate) fn inputs_of(arguments: &Arguments, folder: &Path) -> Result<Option<Inputs>> {
    let Some(plan) = plan_file::read_or_say(&arguments.schedule)? else { return Ok(None) };
    let mission = read_mission(arguments, &plan)?;
    let arguments = &Arguments { set: settings(arguments, &plan, &mission)?, ..arguments.clone() };
    Ok(Some(inputs(arguments, &plan, &mission, folder)))
}

fn inputs(arguments: &Arguments, plan: &Plan, mission: &MissionPlan, folder: &Path) -> Inputs {
    let (chains, reasons) = (chains(plan), reasons(folder));
    let mut inputs = Inputs { laps: mission.laps, chains, reasons, ..Inputs::default() };
    inputs.waypoints = mission.waypoints.iter().map(waypoint).collect();
    inputs.sequence = mission.sequence();
    let given = |program, name| in_effect(arguments, plan, program, name);
    if let Some(aiding) = given("estimator", "pressure_aiding").and_then(|value| value.as_bool()) {
        inputs.pressure_aiding = aiding;
    }
    if given("controller", "path").is_some_and(|value| value == "fly_through") {
        inputs.guidance.corner = Corner::FlyThrough;
    }
    inputs.guidance.radius_m = given("controller", "radius_m").and_then(|value| value.as_f64());
    if let Some(airframe) = airframe(arguments, plan) {
        inputs.guidance = inputs.guidance.of_airframe(&airframe);
    }
    inputs
}

/// Why windows were late, as the executive has answered; nothing on the virtual clock.
fn reasons(folder: &Path) -> Vec<Reason> {
    let text = std::fs::read_to_string(folder.join(why::FILE)).unwrap_or_default();
    let answers = text.lines().filter_map(|line| serde_json::from_str::<why::Answer>(line).ok());
    let reason = |answer: why::Answer| Reason {
        time_s: answer.time_s,
        frame: answer.frame,
        sentence: answer.sentence(),
        partition: answer.partition,
    };
    answers.map(reason).collect()
}

/// The aircraft as the laws see it; `None` if it can not be read, of which the Controller tells.
fn airframe(arguments: &Arguments, plan: &Plan) -> Option<Airframe> {
    let planned = || in_effect(arguments, plan, "controller", "airframe")?.as_str().map(str::to_owned);
    let value = arguments.airframe.clone().or_else(planned).unwrap_or_else(|| "aerosonde".into());
    Airframe::from_attribute(&value, |path| std::fs::read_to_string(path)).ok()
}

/// The way-points whose airspeed the aircraft does not fly, a sentence for each.
fn unflyable(arguments: &Arguments, plan: &Plan, mission: &MissionPlan) -> Vec<String> {
    let Some(airframe) = airframe(arguments, plan) else { return Vec::new() };
    let envelope = Envelope::new(&airframe);
    let (slowest_mps, fastest_mps) = (envelope.slowest_mps, envelope.fastest_mps);
    let sentence = |point: &ground::Waypoint| {
        let why = if point.airspeed_mps > fastest_mps {
            format!("full throttle holds {fastest_mps:.1} m/s level")
        } else if point.airspeed_mps < slowest_mps {
            format!("it does not fly slower than {slowest_mps:.1} m/s")
        } else {
            return None;
        };
        Some(format!("WP{}: airspeed_mps is {}, and {why}: flown at that", point.index, point.airspeed_mps))
    };
    mission.waypoints.iter().filter_map(sentence).collect()
}

/// As guidance has it.
fn waypoint(point: &ground::Waypoint) -> guidance::Waypoint {
    let ground::Waypoint { north_m, east_m, altitude_m, heading_rad, airspeed_mps, step, .. } = *point;
    let step = guidance::Step::from_numbers(step.to_numbers());
    guidance::Waypoint { north_m, east_m, altitude_m, airspeed_mps, heading_rad, step }
}

/// The chains of the plan, each with its worst age in any schedule.
fn chains(plan: &Plan) -> Vec<ChainBound> {
    let mut bounds: Vec<ChainBound> = Vec::new();
    for age in Facts::of(plan).schedules.into_iter().flat_map(|schedule| schedule.chains) {
        match bounds.iter_mut().find(|bound| bound.name == age.chain) {
            Some(bound) => bound.computed_ns = bound.computed_ns.max(age.age_ns),
            None => bounds.push(ChainBound {
                name: age.chain,
                partitions: age.way.into_iter().map(|step| step.partition).collect(),
                computed_ns: age.age_ns,
                allowed_ns: age.max_age_ns,
            }),
        }
    }
    bounds
}

fn print_summary(arguments: &Arguments, summary: &Summary, folder: &Path) -> Result<()> {
    match arguments.format {
        Format::Json => println!("{}", serde_json::to_string_pretty(summary)?),
        Format::Text => {
            print!("{}", bateleur_report::text::table(summary));
            println!("report: {}", folder.join("report.html").display());
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::date;

    #[test]
    fn dates_are_those_of_the_calendar() {
        assert_eq!(date(0), "19700101-000000");
        assert_eq!(date(951_782_399), "20000228-235959");
        assert_eq!(date(951_782_400), "20000229-000000");
        assert_eq!(date(1_795_224_600), "20261121-013000");
    }
}
