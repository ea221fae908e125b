//! All modules of a plan on this machine: what stands in place of their networks and their keys.
//!
//! Responsible for: addresses of the loopback interface in place of the plan's, and keys for links whose own are not there. It never
//! starts anything.

use std::collections::BTreeMap;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use bateleur_host::keys;
use bateleur_plan::{Plan, Protection};

/// Addresses that the loopback interface can give one run.
const MOST_ADDRESSES: usize = 254;

/// The place of the module that a target of `--set`, `--kill`, … lies on: PARTITION or PARTITION.PORT; `None`: no partition's.
pub fn place_of_target(plan: &Plan, target: &str) -> Option<usize> {
    let partition = target.split('.').next().unwrap_or(target);
    plan.partition(partition).map(|id| plan[id].module.index())
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

/// Keys in `folder`, for links whose own key is not there: between hosts on one machine nobody has to carry it.
///
/// # Errors
/// One can not be made.
pub fn missing_keys(schedule: &Path, plan: &Plan, folder: &Path) -> Result<BTreeMap<String, PathBuf>> {
    let schedule = schedule.parent().unwrap_or(Path::new(""));
    let folder = std::path::absolute(folder).context("cannot tell where the logs go")?;
    let mut made = BTreeMap::new();
    for link in &plan.links {
        let Protection::Key { file } = &link.protection else { continue };
        if schedule.join(file).exists() {
            continue;
        }
        let path = folder.join(format!("{}.key", link.name));
        let _ = std::fs::remove_file(&path); // left by a run that was killed
        keys::make(&path).with_context(|| format!("cannot make {}", path.display()))?;
        eprintln!(
            "             link {}: there is no {file}, so these hosts have a key of their own",
            link.name
        );
        made.insert(link.name.clone(), path);
    }
    Ok(made)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_address_of_a_plan_has_its_own_on_loopback() {
        let text = include_str!("../../../schedules/three-hosts.toml");
        let plan = crate::plan_file::read_text("three-hosts.toml", text).unwrap();
        let mapped = on_loopback(&plan, 0x0012_3456).unwrap();
        assert_eq!(mapped.len(), 6);
        let others: std::collections::BTreeSet<_> = mapped.values().collect();
        assert_eq!(others.len(), 6);
        assert!(mapped.values().all(|address| address.ip().is_loopback() && address.port() == 15300));
        assert!(mapped.values().all(|address| address.to_string().starts_with("127.52.86.")), "{mapped:?}");
    }
}
