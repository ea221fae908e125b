//! A flight on several hosts, all of them on this machine: one executive for each module of the plan.
//!
//! In real time each module has a network namespace of its own, as if it were a computer. On the virtual
//! clock the modules share one file, their relays talk over addresses of the loopback interface, and what a network does to
//! datagrams is modelled, see [`model`].

pub(super) mod model;

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use bateleur_executive_cli::hosts::{Keys, namespace, on_loopback, shared_clock};
pub(super) use bateleur_executive_cli::hosts::{concerns_setting, place_of_target};
use bateleur_plan::Plan;
use model::{Cut, Death, LinkModel};

use super::{Arguments, partition_running};

/// Below a flight's folder: a folder for each host.
pub(super) use bateleur_report::hosts::FOLDER;

/// The options of a flight on several hosts.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Several hosts")]
pub(crate) struct Options {
    /// Fly all modules of the plan, each as if it were a computer of its own: in network namespaces that are joined by
    /// virtual Ethernets (root needed), or with --fast on one virtual clock.
    #[arg(long, conflicts_with = "module")]
    pub(crate) hosts: bool,
    /// What the networks between the hosts do to datagrams, with --fast: delay=TIME, jitter=TIME, loss=SHARE,
    /// duplicate=SHARE, reorder=SHARE, reorder_by=TIME, bandwidth=RATE, seed=N, with commas between.
    #[arg(long, value_name = "KEY=VALUE,…", value_parser = model::parse, requires = "hosts")]
    pub(crate) link: Option<LinkModel>,
    /// Cut a network for a while of module time (may be repeated).
    #[arg(long, value_name = "NETWORK@FROM-UNTIL", value_parser = model::parse_cut, requires = "hosts")]
    pub(crate) cut: Vec<Cut>,
    /// Kill a host at a module time: its executive, with everything in it; with -UNTIL it is started anew then, from nothing
    /// (may be repeated).
    #[arg(long, value_name = "MODULE@SECONDS[-UNTIL]", value_parser = model::parse_kill, requires = "hosts")]
    pub(crate) kill_host: Vec<Death>,
}

impl Options {
    /// A line for each that was planned for later than the flight's end.
    pub(super) fn not_reached(&self, module_time_s: f64) -> Vec<String> {
        let cuts = self.cut.iter().map(|cut| (format!("--cut {}@{}", cut.network, cut.from_s), cut.from_s));
        let deaths = self
            .kill_host
            .iter()
            .map(|death| (format!("--kill-host {}@{}", death.module, death.at_s), death.at_s));
        let late = cuts.chain(deaths).filter(|(_, at_s)| *at_s > module_time_s);
        late.map(|(what, _)| format!("{what} was not reached: it ended at {module_time_s:.2} s")).collect()
    }
}

/// What is the same for all hosts of a flight.
pub(super) struct Hosts {
    /// The modules, in the order of the plan.
    pub(super) modules: Vec<String>,
    /// On the virtual clock: the file that they share.
    together: Option<PathBuf>,
    /// Addresses in place of the plan's.
    addresses: BTreeMap<SocketAddr, SocketAddr>,
    /// Keys in place of the plan's.
    keys: Keys,
    /// What the modelled networks do.
    model: Option<serde_json::Value>,
    /// That of the flight.
    pub(super) folder: PathBuf,
}

impl Hosts {
    /// Makes what the hosts need in the flight's folder.
    pub(super) fn prepare(arguments: &Arguments, plan: &Plan, folder: &Path) -> Result<Self> {
        check(arguments, plan)?;
        let modules: Vec<String> = plan.modules.iter().map(|module| module.name.clone()).collect();
        for module in &modules {
            let path = folder.join(FOLDER).join(module);
            bateleur_system::folders::make(&path)
                .with_context(|| format!("cannot make the folder {}", path.display()))?;
        }
        let (addresses, model) = match arguments.fast {
            true => (on_loopback(plan, std::process::id())?, Some(model::table(arguments)?)),
            false => (BTreeMap::new(), None),
        };
        Ok(Self {
            modules,
            together: arguments.fast.then(shared_clock),
            addresses,
            keys: Keys::missing(&arguments.schedule, plan)?,
            model,
            folder: folder.to_owned(),
        })
    }

    /// The folder of a host.
    pub(super) fn folder_of(&self, module: &str) -> PathBuf {
        self.folder.join(FOLDER).join(module)
    }

    /// What the executive of the module at `place` is told beside what every executive is.
    pub(super) fn arguments(&self, plan: &Plan, place: usize) -> Vec<String> {
        let mut list = vec!["--module".to_owned(), self.modules[place].clone()];
        if let Some(file) = &self.together {
            list.extend(["--together".to_owned(), file.display().to_string()]);
            list.extend(["--place".to_owned(), format!("{place}/{}", self.modules.len())]);
        }
        for (planned, other) in &self.addresses {
            list.extend(["--address".to_owned(), format!("{planned}={other}")]);
        }
        for (link, file) in self.keys.files() {
            list.extend(["--key".to_owned(), format!("{link}={}", file.display())]);
        }
        let module = plan.module(&self.modules[place]);
        let relay = module.and_then(|view| plan.relay_of(view.id())).map(|relay| &plan[relay].name);
        if let (Some(relay), Some(model)) = (relay, &self.model) {
            let attribute = bateleur_contract::relay::MODEL_ATTRIBUTE;
            list.extend(["--set".to_owned(), format!("{relay}.{attribute}={model}")]);
        }
        list
    }
}

impl Drop for Hosts {
    fn drop(&mut self) {
        // The last module removes it, unless it was killed.
        let _ = self.together.as_ref().map(std::fs::remove_file); // as a rule it is gone
    }
}

fn check(arguments: &Arguments, plan: &Plan) -> Result<()> {
    if plan.modules.len() < 2 {
        bail!(
            "{} has one module: --hosts is for several, such as schedules/two-hosts.toml",
            arguments.schedule.display()
        );
    }
    let hosts = &arguments.hosts;
    if let Some(lack) = namespace::lack(plan).filter(|_| !arguments.fast) {
        bail!(
            "hosts on one machine need network namespaces: {lack}. Run it as root, or on the virtual clock with --fast, which needs \
             none"
        );
    }
    if hosts.link.is_some() && !arguments.fast {
        bail!("--link models networks on the virtual clock: add --fast");
    }
    if arguments.no_simulator {
        bail!("--hosts flies with this project's simulator, which it can place: leave --no-simulator out");
    }
    if let Some(cut) =
        hosts.cut.iter().find(|cut| !plan.networks.iter().any(|network| network.name == cut.network))
    {
        let known: Vec<&str> = plan.networks.iter().map(|network| network.name.as_str()).collect();
        bail!("there is no network {}: the plan has {}", cut.network, known.join(", "));
    }
    hosts.kill_host.iter().try_for_each(|death| check_death(death, plan))?;
    check_lives(&hosts.kill_host)
}

/// A host dies once in each of its lives.
fn check_lives(deaths: &[Death]) -> Result<()> {
    for (place, one) in deaths.iter().enumerate() {
        let after = |other: &&Death| {
            let until_s = one.back_s.unwrap_or(f64::INFINITY);
            other.module == one.module && (one.at_s..=until_s).contains(&other.at_s)
        };
        let mut others =
            deaths.iter().enumerate().filter(|(other, _)| *other != place).map(|(_, other)| other);
        if let Some(other) = others.find(after) {
            bail!(
                "--kill-host: {} is dead from {} s on, and can not be killed at {} s; let it come back before",
                one.module,
                one.at_s,
                other.at_s
            );
        }
    }
    Ok(())
}

fn check_death(Death { module, back_s, .. }: &Death, plan: &Plan) -> Result<()> {
    if plan.module(module).is_none() {
        let known: Vec<&str> = plan.modules.iter().map(|module| module.name.as_str()).collect();
        bail!("there is no module {module}: the plan has {}", known.join(", "));
    }
    for program in ["command", "hil_interface"] {
        if back_s.is_some() && plan.modules[place_of(plan, program)?].name == *module {
            bail!(
                "{module} has the lines to the ground and to the simulator, and its end is the flight's: it can be killed \
                 (--kill-host {module}@SECONDS), and not come back"
            );
        }
    }
    Ok(())
}

/// The place of the module that runs a program's partition.
pub(super) fn place_of(plan: &Plan, program: &str) -> Result<usize> {
    let partition = partition_running(plan, program)?;
    Ok(plan.partition(&partition).map_or(0, |id| plan[id].module.index()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cut_and_death_whose_time_did_not_come_are_told() {
        let cut = ["a@10-20", "a@300-310"].map(|text| model::parse_cut(text).unwrap()).to_vec();
        let kill_host = ["nav@100-110", "nav@9999"].map(|text| model::parse_kill(text).unwrap()).to_vec();
        let options = Options { cut, kill_host, ..Options::default() };
        let expected = ["--cut a@300", "--kill-host nav@9999"]
            .map(|what| format!("{what} was not reached: it ended at 205.10 s"));
        assert_eq!(options.not_reached(205.1), expected);
    }
}
