//! The options of `run` and `fly` that plan what happens to partitions.

use bateleur_monitor::inject::{EXECUTIVE, Fault};
use bateleur_monitor::planned::{Act, Killings, PlannedAct, STANDBY};

/// As Linux numbers it.
const SIGKILL: i32 = 9;

/// What happens to partitions, and when.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "What happens to partitions")]
pub struct Faults {
    /// Kill a partition's process, the one that stands by (PARTITION.standby), or the `executive`, at a module time (may be repeated).
    #[arg(long, value_name = "PARTITION@SECONDS", value_parser = parse_when)]
    kill: Vec<When>,
    /// End a partition until it is started (may be repeated).
    #[arg(long, value_name = "PARTITION@SECONDS", value_parser = parse_when)]
    stop: Vec<When>,
    /// Start a partition that is idle or stopped, from nothing (may be repeated).
    #[arg(long, value_name = "PARTITION@SECONDS", value_parser = parse_when)]
    start: Vec<When>,
    /// Hold a partition: it gets no windows until it is thawed (may be repeated).
    #[arg(long, value_name = "PARTITION@SECONDS", value_parser = parse_when)]
    freeze: Vec<When>,
    /// Let a partition go on that is held (may be repeated).
    #[arg(long, value_name = "PARTITION@SECONDS", value_parser = parse_when)]
    thaw: Vec<When>,
    /// Provoke a fault at a module time (may be repeated); see `bateleur inject --help`.
    #[arg(long, value_name = "TARGET:FAULT@SECONDS", value_parser = parse_injection)]
    inject: Vec<Injection>,
    /// Ask for another schedule at a module time; it takes effect with the next major frame (may be repeated).
    #[arg(long, value_name = "NAME@SECONDS", value_parser = parse_schedule_change)]
    schedule_at: Vec<ScheduleChange>,
    /// Kill a partition, chosen at random, in every such period of module time.
    #[arg(long, value_name = "SECONDS", value_parser = parse_period)]
    kill_every: Option<f64>,
    /// Seed of the choice.
    #[arg(long, value_name = "NUMBER", default_value_t = 1, requires = "kill_every")]
    kill_seed: u64,
}

/// A fault, whom it hits, and a module time.
#[derive(Debug, Clone, PartialEq)]
pub struct Injection {
    target: String,
    fault: Fault,
    at_s: f64,
}

/// A schedule and a module time.
#[derive(Debug, Clone, PartialEq)]
pub struct ScheduleChange {
    schedule: String,
    at_s: f64,
}

/// A partition and a module time.
#[derive(Debug, Clone, PartialEq)]
pub struct When {
    partition: String,
    at_s: f64,
}

impl Faults {
    /// All of them, as the executive takes them.
    pub fn planned(&self) -> Vec<PlannedAct> {
        let act = |act: Act, when: &When| {
            // A partition of that name is hit by the signal as by the kill.
            if act == Act::Kill && when.partition == EXECUTIVE {
                let at_ns = (when.at_s * 1e9) as u64;
                return PlannedAct {
                    act: Act::Inject(Fault::Signal(SIGKILL)),
                    partition: EXECUTIVE.into(),
                    at_ns,
                };
            }
            let behind = when.partition.strip_suffix(STANDBY).filter(|_| act == Act::Kill);
            PlannedAct {
                act: if behind.is_some() { Act::KillStandby } else { act },
                partition: behind.unwrap_or(&when.partition).to_owned(),
                at_ns: (when.at_s * 1e9) as u64,
            }
        };
        let all = self.lists().into_iter();
        let acts = all.flat_map(|(_, what, list)| list.iter().map(move |when| act(what, when)));
        let injections = self.inject.iter().map(|one| PlannedAct {
            act: Act::Inject(one.fault),
            partition: one.target.clone(),
            at_ns: (one.at_s * 1e9) as u64,
        });
        acts.chain(injections).collect()
    }

    /// Changes of schedule, and their module times, ns.
    pub fn schedule_changes(&self) -> Vec<(String, u64)> {
        let change = |change: &ScheduleChange| (change.schedule.clone(), (change.at_s * 1e9) as u64);
        self.schedule_at.iter().map(change).collect()
    }

    /// The options again, for another program.
    pub fn arguments(&self) -> Vec<String> {
        self.arguments_for(true, |_| true)
    }

    /// Those that `hit` a target of another program; `chance`: with kills by chance.
    pub fn arguments_for(&self, chance: bool, hit: impl Fn(&str) -> bool) -> Vec<String> {
        let all = self.lists().into_iter();
        let hit = &hit;
        let acts = all.flat_map(|(name, _, list)| {
            let list = list.iter().filter(|when| hit(&when.partition));
            list.flat_map(move |when| [name.to_owned(), format!("{}@{}", when.partition, when.at_s)])
        });
        let injections =
            self.inject.iter().filter(|one| hit(&one.target)).flat_map(|one| {
                ["--inject".to_owned(), format!("{}:{}@{}", one.target, one.fault, one.at_s)]
            });
        let chance = self.kill_every.filter(|_| chance).into_iter().flat_map(|period_s| {
            let seed = self.kill_seed.to_string();
            ["--kill-every".to_owned(), period_s.to_string(), "--kill-seed".to_owned(), seed]
        });
        let changes = self.schedule_at.iter().flat_map(|ScheduleChange { schedule, at_s }| {
            ["--schedule-at".to_owned(), format!("{schedule}@{at_s}")]
        });
        acts.chain(injections).chain(changes).chain(chance).collect()
    }

    /// Kills by chance, if they are asked for.
    pub fn killings(&self) -> Option<Killings> {
        let every_ns = (self.kill_every? * 1e9) as u64;
        Some(Killings { every_ns, seed: self.kill_seed })
    }

    fn lists(&self) -> [(&'static str, Act, &[When]); 5] {
        [
            ("--kill", Act::Kill, &self.kill),
            ("--stop", Act::Stop, &self.stop),
            ("--start", Act::Start, &self.start),
            ("--freeze", Act::Freeze, &self.freeze),
            ("--thaw", Act::Thaw, &self.thaw),
        ]
    }
}

fn parse_period(text: &str) -> Result<f64, String> {
    let number = text.strip_suffix('s').unwrap_or(text).parse::<f64>();
    number.ok().filter(|period_s| (0.1..1e6).contains(period_s)).ok_or_else(|| {
        format!("\"{text}\" is no period: give seconds of module time, 0.1 at least, such as 5s")
    })
}

fn parse_when(text: &str) -> Result<When, String> {
    let (partition, at_s) =
        name_at(text).ok_or_else(|| format!("\"{text}\" is not PARTITION@SECONDS, such as estimator@100"))?;
    Ok(When { partition, at_s })
}

fn parse_schedule_change(text: &str) -> Result<ScheduleChange, String> {
    let (schedule, at_s) =
        name_at(text).ok_or_else(|| format!("\"{text}\" is not NAME@SECONDS, such as ground@100"))?;
    Ok(ScheduleChange { schedule, at_s })
}

/// What happens to whom at a module time, s.
fn name_at(text: &str) -> Option<(String, f64)> {
    let (name, at) = text.split_once('@')?;
    let at_s: f64 = at.parse().ok()?;
    (at_s.is_finite() && at_s >= 0.0).then(|| (name.to_owned(), at_s))
}

fn parse_injection(text: &str) -> Result<Injection, String> {
    let wrong = || format!("\"{text}\" is not TARGET:FAULT@SECONDS, such as imu:panic@100");
    let (target, rest) = text.split_once(':').ok_or_else(wrong)?;
    let (fault, at) = rest.rsplit_once('@').ok_or_else(wrong)?;
    let at_s = at.parse().ok().filter(|at: &f64| at.is_finite() && *at >= 0.0).ok_or_else(wrong)?;
    Ok(Injection { target: target.into(), fault: fault.parse()?, at_s })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn injection_is_read_and_handed_on_as_it_was() {
        let one = parse_injection("imu.orientation:delay=10/50ms@12.5").unwrap();
        assert_eq!((one.target.as_str(), one.at_s), ("imu.orientation", 12.5));
        let faults = Faults { inject: vec![one.clone()], ..Faults::default() };
        let again = faults.arguments();
        assert_eq!(again[0], "--inject");
        assert_eq!(parse_injection(&again[1]), Ok(one));
        assert!(parse_injection("imu:pnic@1").unwrap_err().contains("did you mean `panic`?"));
        assert!(parse_injection("imu@1").unwrap_err().contains("TARGET:FAULT@SECONDS"));
    }
}
