//! All modules of a plan on this machine: what stands in place of their networks and their keys.
//!
//! Responsible for: network namespaces with the plan's addresses, or addresses of the loopback interface in their place, and keys
//! for links whose own are not there.

pub mod namespace;

use std::collections::BTreeMap;
use std::fs::File;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::os::fd::AsRawFd;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use bateleur_host::keys;
use bateleur_plan::{PartitionId, Plan, Protection};

/// Addresses that the loopback interface can give one run.
const MOST_ADDRESSES: usize = 254;

/// The place of the module that a target of `--set`, `--kill`, … lies on: PARTITION or PARTITION.PORT; `None`: no partition's.
pub fn place_of_target(plan: &Plan, target: &str) -> Option<usize> {
    let partition = target.split('.').next().unwrap_or(target);
    plan.partition(partition).map(|id| plan[id].module.index())
}

/// Whether a `--set` for a partition concerns the module at `place`: it, or one of its replicas, runs there. `otherwise`: the module that
/// refuses what is aimed at no partition.
pub fn concerns_setting(plan: &Plan, partition: &str, place: usize, otherwise: usize) -> bool {
    let takes = |id: &PartitionId| plan.takes_settings_of(*id, partition);
    match plan.partition(partition) {
        Some(_) => plan.partition_ids().filter(takes).any(|id| plan[id].module.index() == place),
        None => otherwise == place,
    }
}

/// The file in which modules on one virtual clock share it. Of this machine: a virtual clock needs memory that is really shared.
pub fn shared_clock() -> PathBuf {
    Path::new("/dev/shm").join(format!("bateleur-hosts.{}", std::process::id()))
}

/// Addresses of the loopback interface for all of the plan's, which other runs at the same time do not have: by the number of
/// this process.
///
/// # Errors
/// The plan has more than there are.
pub fn on_loopback(plan: &Plan, process: u32) -> Result<BTreeMap<SocketAddr, SocketAddr>> {
    let all: Vec<SocketAddr> =
        plan.modules.iter().flat_map(|module| &module.addresses).map(|address| address.socket).collect();
    if all.len() > MOST_ADDRESSES {
        bail!("the plan has {} addresses, and one run on one machine {MOST_ADDRESSES} at most", all.len());
    }
    // 127.0 is everybody's.
    let [_, _, high, low] = process.to_be_bytes();
    let address = |(place, planned): (usize, SocketAddr)| {
        let host = u8::try_from(place + 1).unwrap_or(u8::MAX);
        let ip = IpAddr::V4(Ipv4Addr::new(127, high.max(1), low, host));
        (planned, SocketAddr::new(ip, planned.port()))
    };
    Ok(all.into_iter().enumerate().map(address).collect())
}

/// Keys for links whose own file is not there: between hosts on one machine nobody has to carry it. They are gone with this value,
/// and with this process however it ends.
#[derive(Debug, Default)]
pub struct Keys(BTreeMap<String, File>);

impl Keys {
    /// Makes those that the plan's links lack.
    ///
    /// # Errors
    /// One can not be made.
    pub fn missing(schedule: &Path, plan: &Plan) -> Result<Self> {
        let schedule = schedule.parent().unwrap_or(Path::new(""));
        let mut made = BTreeMap::new();
        for link in &plan.links {
            let Protection::Key { file } = &link.protection else { continue };
            if schedule.join(file).exists() {
                continue;
            }
            let key = keys::make_in_memory().with_context(|| format!("no key for link {}", link.name))?;
            eprintln!(
                "             link {}: there is no {file}, so these hosts have a key of their own",
                link.name
            );
            made.insert(link.name.clone(), key);
        }
        Ok(Self(made))
    }

    /// Each link, and where a module's process finds its key.
    pub fn files(&self) -> impl Iterator<Item = (&str, PathBuf)> {
        let process = std::process::id();
        self.0
            .iter()
            .map(move |(link, key)| (link.as_str(), format!("/proc/{process}/fd/{}", key.as_raw_fd()).into()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_address_of_a_plan_has_its_own_on_loopback() {
        let text = include_str!("../../../../schedules/three-hosts.toml");
        let plan = crate::plan_file::read_text("three-hosts.toml", text).unwrap();
        let mapped = on_loopback(&plan, 0x0012_3456).unwrap();
        assert_eq!(mapped.len(), 6);
        let others: std::collections::BTreeSet<_> = mapped.values().collect();
        assert_eq!(others.len(), 6);
        assert!(mapped.values().all(|address| address.ip().is_loopback() && address.port() == 15300));
        assert!(mapped.values().all(|address| address.to_string().starts_with("127.52.86.")), "{mapped:?}");
    }
}
