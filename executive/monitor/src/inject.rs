//! Faults that can be provoked in a running module: what they are called, whom they hit, and how they get there.
//!
//! Written `KIND`, `KIND=COUNT` or `KIND=COUNT/TIME`, against a partition (`imu`), a source port (`imu.orientation`), or a part of the
//! executive: `executive`, `dispatcher`, `monitor`. What a signal does is done by the executive; its threads stall themselves; all else
//! is carried out by the partition's own library at the start of its next window.

use std::fmt;
use std::str::FromStr;

use bateleur_contract::{FaultKind, FaultOrder};
use serde::{Deserialize, Serialize};

use bateleur_plan::units::{ShowTime, duration_ns};
use bateleur_plan::{Plan, Role, did_you_mean};

/// A thread that a stall is aimed at.
pub const DISPATCHER: &str = "dispatcher";
/// The other one.
pub const MONITOR: &str = "monitor";
/// The executive's process, which signals are aimed at; a partition of that name goes first.
pub const EXECUTIVE: &str = "executive";
/// A stall that is longer would be a module that stands still, ns.
const LONGEST_STALL_NS: u64 = 10_000_000_000;
/// A delay that is longer is a loss, ns.
const LONGEST_DELAY_NS: u64 = 60_000_000_000;

/// Signals by their name without `SIG`, as numbered by Linux on x86-64 and aarch64 alike.
const SIGNALS: [(&str, i32); 21] = [
    ("sighup", 1),
    ("sigint", 2),
    ("sigquit", 3),
    ("sigill", 4),
    ("sigtrap", 5),
    ("sigabrt", 6),
    ("sigbus", 7),
    ("sigfpe", 8),
    ("sigkill", 9),
    ("sigusr1", 10),
    ("sigsegv", 11),
    ("sigusr2", 12),
    ("sigpipe", 13),
    ("sigalrm", 14),
    ("sigterm", 15),
    ("sigcont", 18),
    ("sigstop", 19),
    ("sigxcpu", 24),
    ("sigxfsz", 25),
    ("sigvtalrm", 26),
    ("sigsys", 31),
];

/// A fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Fault {
    /// What a signal does to a process.
    Signal(i32),
    /// The partition misbehaves.
    Misbehave(FaultKind),
    /// The next messages of a source port are dropped, delayed or corrupted.
    Messages {
        /// Which of the three.
        kind: FaultKind,
        /// How many.
        count: u32,
        /// For a delay, ns.
        delay_ns: u64,
    },
    /// A dispatcher or the monitor does nothing for that long, ns.
    Stall(u64),
}

/// What the monitor is about to do to its own process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum OwnFault {
    /// It does nothing for that long, ns.
    Stall(u64),
    /// The process gets this signal.
    Signal(i32),
}

/// Where a fault goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Aim {
    /// A partition, or one of its ports.
    Partition {
        /// Its place in the plan.
        place: usize,
        /// The port's place in the partition's description; 0 for other faults.
        port: u32,
    },
    /// The executive's process.
    Executive,
    /// Its dispatchers.
    Dispatcher,
    /// Its monitor.
    Monitor,
}

impl Aim {
    /// At a partition as a whole.
    #[must_use]
    pub fn partition(place: usize) -> Self {
        Self::Partition { place, port: 0 }
    }

    /// The partition's place in the plan; `None`: it is a part of the executive.
    #[must_use]
    pub fn place(&self) -> Option<usize> {
        match *self {
            Self::Partition { place, .. } => Some(place),
            Self::Executive | Self::Dispatcher | Self::Monitor => None,
        }
    }

    /// What it is called among parts of the executive.
    pub(crate) fn part(&self) -> &'static str {
        match self {
            Self::Monitor => MONITOR,
            Self::Executive => EXECUTIVE,
            Self::Dispatcher | Self::Partition { .. } => DISPATCHER,
        }
    }
}

impl Fault {
    /// Every word that names one.
    pub fn names() -> impl Iterator<Item = &'static str> {
        let kinds = FaultKind::ALL.into_iter().map(FaultKind::name);
        kinds.chain(["stall"]).chain(SIGNALS.iter().map(|(name, _)| *name))
    }

    /// The order that goes through the control page; `None` if it goes another way. `seed`: of what is random in it.
    #[must_use]
    pub fn order(&self, aim: &Aim, seed: u64) -> Option<FaultOrder> {
        match *self {
            Self::Misbehave(kind) => Some(FaultOrder { kind, port: 0, messages: 0, argument: seed }),
            Self::Messages { kind, count, delay_ns } => {
                let argument = if kind == FaultKind::Delay { delay_ns } else { seed };
                let Aim::Partition { port, .. } = *aim else { return None };
                Some(FaultOrder { kind, port, messages: count, argument })
            }
            Self::Signal(_) | Self::Stall(_) => None,
        }
    }

    /// Whom of `plan` it hits when it is aimed at `target`.
    ///
    /// # Errors
    /// There is no such target, or it can not have this fault.
    pub fn aim(&self, plan: &Plan, target: &str) -> Result<Aim, String> {
        match self {
            Self::Stall(_) if target == DISPATCHER => Ok(Aim::Dispatcher),
            Self::Stall(_) if target == MONITOR => Ok(Aim::Monitor),
            Self::Stall(_) => {
                Err(format!("only {DISPATCHER} and {MONITOR} stall: aim it at one of them, not at {target}"))
            }
            Self::Messages { .. } => aim_at_port(plan, target),
            Self::Signal(_) | Self::Misbehave(_) => match plan.partition(target) {
                Some(found) => Ok(Aim::partition(found.index())),
                None if target == EXECUTIVE && matches!(self, Self::Signal(_)) => Ok(Aim::Executive),
                None => Err(unknown_partition(plan, target)),
            },
        }
    }
}

fn unknown_partition(plan: &Plan, name: &str) -> String {
    let names = plan.partitions.iter().map(|partition| partition.name.as_str());
    format!("there is no partition \"{name}\": {}", did_you_mean(name, names))
}

fn aim_at_port(plan: &Plan, target: &str) -> Result<Aim, String> {
    let Some((partition, name)) = target.split_once('.') else {
        return Err(format!("\"{target}\" is not PARTITION.PORT, which faults of messages are aimed at"));
    };
    let id = plan.partition(partition).ok_or_else(|| unknown_partition(plan, partition))?;
    let ports: Vec<_> = plan.own_ports(&plan[id]).collect();
    let Some(place) = ports.iter().position(|port| plan[*port].name == name) else {
        let names = ports.iter().map(|port| plan[*port].name.as_str());
        return Err(format!("{partition} has no port \"{name}\": {}", did_you_mean(name, names)));
    };
    let port = &plan[ports[place]];
    if !matches!(port.role, Role::SamplingSource | Role::QueuingSource) {
        let source = port.channel.map(|channel| plan.port_path(plan[channel].source));
        let mend = source.map_or_else(String::new, |source| format!(": aim at its source, {source}"));
        return Err(format!(
            "{target} is a destination, and messages meet their faults where they are sent{mend}"
        ));
    }
    Ok(Aim::Partition { place: id.index(), port: place as u32 })
}

impl TryFrom<String> for Fault {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Fault> for String {
    fn from(fault: Fault) -> Self {
        fault.to_string()
    }
}

impl FromStr for Fault {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, rest) = text.split_once('=').map_or((text, None), |(name, rest)| (name, Some(rest)));
        if let Some((_, number)) = SIGNALS.iter().find(|(known, _)| *known == name) {
            return plain(Self::Signal(*number), text, rest);
        }
        if name == "stall" {
            let given = rest.ok_or_else(|| "a stall needs a time: stall=20ms".to_owned())?;
            return Ok(Self::Stall(time(given, LONGEST_STALL_NS)?));
        }
        match FaultKind::from_name(name) {
            Some(kind) if kind.is_of_port() => messages(kind, text, rest.unwrap_or("1")),
            Some(kind) => plain(Self::Misbehave(kind), text, rest),
            None => Err(format!("there is no fault \"{name}\": {}", did_you_mean(name, Self::names()))),
        }
    }
}

fn plain(fault: Fault, text: &str, rest: Option<&str>) -> Result<Fault, String> {
    match rest {
        None => Ok(fault),
        Some(_) => Err(format!("\"{text}\": this fault takes no number")),
    }
}

fn messages(kind: FaultKind, text: &str, rest: &str) -> Result<Fault, String> {
    let (count, delay) = rest.split_once('/').map_or((rest, None), |(count, delay)| (count, Some(delay)));
    let count = count.parse().ok().filter(|count| *count > 0);
    let count =
        count.ok_or_else(|| format!("\"{text}\": how many messages? For example {}=10", kind.name()))?;
    let delay_ns = match (kind, delay) {
        (FaultKind::Delay, Some(delay)) => time(delay, LONGEST_DELAY_NS)?,
        (FaultKind::Delay, None) => {
            return Err(format!("\"{text}\": for how long? For example delay=10/50ms"));
        }
        (_, None) => 0,
        (_, Some(_)) => return Err(format!("\"{text}\": only a delay takes a time")),
    };
    Ok(Fault::Messages { kind, count, delay_ns })
}

fn time(text: &str, most_ns: u64) -> Result<u64, String> {
    let found = duration_ns(text).map_err(|error| format!("\"{text}\": {error}"))?;
    match found {
        0 => Err(format!("\"{text}\" is no time at all")),
        found if found > most_ns => {
            Err(format!("\"{text}\" is too long: {} s at most", most_ns / 1_000_000_000))
        }
        found => Ok(found),
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Signal(number) => {
                let name =
                    SIGNALS.iter().find(|(_, known)| *known == number).map_or("signal", |(name, _)| *name);
                f.write_str(name)
            }
            Self::Misbehave(kind) => f.write_str(kind.name()),
            Self::Messages { kind: FaultKind::Delay, count, delay_ns } => {
                write!(f, "delay={count}/{}", ShowTime(delay_ns))
            }
            Self::Messages { kind, count, .. } => write!(f, "{}={count}", kind.name()),
            Self::Stall(stall_ns) => write!(f, "stall={}", ShowTime(stall_ns)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_checker::{MessageCatalogue, check};

    struct Bytes;
    impl MessageCatalogue for Bytes {
        fn size_of(&self, _: &str) -> Option<usize> {
            Some(8)
        }
        fn names(&self) -> Vec<&str> {
            vec!["M"]
        }
    }

    fn plan() -> Plan {
        let text = "[module.m]\ncores = [0]\n\
            [partition.a]\nprogram = \"a\"\nmodule = \"m\"\nmemory = \"1MiB\"\n\
            [partition.a.port]\nfirst = { direction = \"source\", kind = \"sampling\", message = \"M\" }\n\
            out = { direction = \"source\", kind = \"sampling\", message = \"M\" }\n\
            [partition.b]\nprogram = \"b\"\nmodule = \"m\"\nmemory = \"1MiB\"\n\
            [partition.b.port]\nin = { direction = \"destination\", kind = \"sampling\", message = \"M\", refresh = \"1s\" }\n\
            [[channel]]\nsource = \"a.out\"\ndestinations = [\"b.in\"]\n\
            [schedule.s]\nmajor_frame = \"20ms\"\nminor_frame = \"20ms\"\ninitial = true\n\
            window = [{ partition = \"a\", offset = \"0ms\", duration = \"2ms\" }, { partition = \"b\", offset = \"4ms\", duration = \"2ms\" }]\n";
        check("a.toml", text, &Bytes).unwrap_or_else(|report| panic!("{}", report.render(false)))
    }

    #[test]
    fn every_fault_is_read_back_from_what_is_written() {
        for name in Fault::names() {
            let text = match name {
                "stall" => "stall=20ms".to_owned(),
                "delay" => "delay=10/50ms".to_owned(),
                "drop" | "corrupt" | "stuck" | "bias" | "swap" => format!("{name}=3"),
                name => name.to_owned(),
            };
            let fault: Fault = text.parse().unwrap();
            assert_eq!(fault.to_string(), text);
        }
    }

    #[test]
    fn mistyped_faults_are_refused_with_a_way_to_mend_them() {
        let refused = |text: &str| text.parse::<Fault>().unwrap_err();
        assert!(refused("pnic").contains("did you mean `panic`?"));
        assert!(refused("delay=10").contains("delay=10/50ms"));
        assert!(refused("drop=none").contains("drop=10"));
        assert!(refused("stall").contains("stall=20ms"));
        assert!(refused("stall=1min").contains("10 s at most"));
        assert!(refused("panic=3").contains("no number"));
        assert!(refused("drop=1/5ms").contains("only a delay"));
    }

    #[test]
    fn faults_are_aimed_by_name() {
        let plan = plan();
        let aim = |fault: &str, target: &str| fault.parse::<Fault>().unwrap().aim(&plan, target);
        assert_eq!(aim("panic", "b"), Ok(Aim::partition(1)));
        assert_eq!(aim("drop=3", "a.out"), Ok(Aim::Partition { place: 0, port: 1 }));
        assert_eq!(aim("stall=1ms", "dispatcher"), Ok(Aim::Dispatcher));
        assert_eq!(aim("stall=1ms", "monitor"), Ok(Aim::Monitor));
        assert_eq!(aim("sigkill", "executive"), Ok(Aim::Executive));
        assert!(aim("panic", "executive").unwrap_err().contains("no partition"), "it has no such library");
        assert!(aim("stall=1ms", "a").unwrap_err().contains("dispatcher and monitor"));
        assert!(aim("drop=3", "b.in").unwrap_err().contains("a.out"));
        assert!(aim("drop=3", "a.uot").unwrap_err().contains("did you mean `out`?"));
        assert!(aim("panic", "bb").unwrap_err().contains("no partition"));
    }
}
