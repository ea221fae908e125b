//! Computers that are none: network namespaces, joined by virtual Ethernets.
//!
//! Whoever starts the modules goes into a namespace of its own, a flight with the simulator and the module that talks to it; every
//! other module gets one. For each network of the plan there is a bridge in the starter's. No namespace has a name, and nothing
//! lies outside of them: when the last process in one ends, however it ends, the kernel removes it with its interfaces. So
//! there is nothing to clean up, and the machine's own network is not touched.
#![allow(unsafe_code)]

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Write};
use std::net::{IpAddr, SocketAddr};
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::process::Command;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use bateleur_plan::{ModuleId, NetworkId, Plan};
use rustix::thread::{LinkNameSpaceType, UnshareFlags, move_into_link_name_space, unshare_unsafe};

/// What a process in a new namespace says when it is there, on its standard input.
const READY: u8 = b'r';
/// What it is told when its interfaces are there.
const GO_ON: u8 = b'g';
/// How long it may take to say so.
const PATIENCE: Duration = Duration::from_secs(20);

/// The starter's own namespace, with the bridges of all networks.
#[derive(Debug)]
pub struct Lan {
    networks: Vec<(NetworkId, String)>,
    /// Of all modules that have joined.
    ports: Vec<Port>,
}

/// Where a module's cable is plugged in.
#[derive(Debug)]
struct Port {
    network: NetworkId,
    name: String,
}

impl Lan {
    /// Takes the calling thread, and whatever it starts from now on, into a namespace of its own: as module `own`, or as none.
    ///
    /// # Errors
    /// The machine does not let it, see [`lack`]. The thread is where it was then.
    pub fn make(plan: &Plan, own: Option<ModuleId>) -> Result<Self> {
        let before = File::open("/proc/thread-self/ns/net").context("cannot open the network namespace")?;
        enter_new()?;
        Self::lay(plan, own).inspect_err(|_| {
            // Allowed to whoever was allowed to leave it.
            let _ = move_into_link_name_space(before.as_fd(), Some(LinkNameSpaceType::Network));
        })
    }

    /// Makes the bridges.
    fn lay(plan: &Plan, own: Option<ModuleId>) -> Result<Self> {
        ip(&["link", "set", "lo", "up"])?;
        let mut networks = Vec::new();
        for (own, address) in
            own.iter().flat_map(|own| plan[*own].addresses.iter().map(move |one| (own, one)))
        {
            let bridge = interface(address.network);
            // Forwards at once: it has no loops to find.
            ip(&["link", "add", &bridge, "type", "bridge", "forward_delay", "0"])?;
            configure(&bridge, address.socket, &others_on(plan, address.network, *own))?;
            networks.push((address.network, bridge));
        }
        for network in (0..plan.networks.len()).filter_map(|place| network_at(plan, place)) {
            if !networks.iter().any(|(known, _)| *known == network) {
                let bridge = interface(network);
                ip(&["link", "add", &bridge, "type", "bridge", "forward_delay", "0"])?;
                ip(&["link", "set", &bridge, "up"])?;
                networks.push((network, bridge));
            }
        }
        Ok(Self { networks, ports: Vec::new() })
    }

    /// Joins a process that waits in a namespace of its own (see `within`) to the networks of its module, and lets it go on.
    /// `line` is the other end of its standard input.
    ///
    /// # Errors
    /// It has ended, says nothing, or an interface can not be made.
    pub fn join(&mut self, plan: &Plan, module: ModuleId, pid: u32, mut line: &UnixStream) -> Result<()> {
        let mut said = [0];
        line.set_read_timeout(Some(PATIENCE))?;
        if line.read_exact(&mut said).is_err() || said != [READY] {
            bail!(
                "the namespace of module {} could not be made; its message stands above",
                plan[module].name
            );
        }
        let pid = pid.to_string();
        for address in &plan[module].addresses {
            let Some((_, bridge)) = self.networks.iter().find(|(network, _)| *network == address.network)
            else {
                continue;
            };
            let port = format!("m{}n{}", module.index(), address.network.index());
            let inside = interface(address.network);
            // Of a host that was killed and comes back: the kernel takes its time to remove a namespace. As a rule there is none.
            let _ = ip(&["link", "delete", &port]);
            ip(&["link", "add", &port, "type", "veth", "peer", "name", &inside, "netns", &pid])?;
            ip(&["link", "set", &port, "master", bridge, "up"])?;
            self.ports.retain(|known| known.name != port);
            self.ports.push(Port { network: address.network, name: port });
        }
        line.write_all(&[GO_ON]).with_context(|| format!("module {} has ended", plan[module].name))
    }

    /// Cuts a network, or mends it: at the ports of its bridge. The bridge itself has the address of the flight's own module, and
    /// the kernel forgets the ways of an interface that is down.
    ///
    /// # Errors
    /// `ip` refuses it.
    pub fn set(&self, plan: &Plan, network: &str, up: bool) -> Result<()> {
        let Some((network, _)) = self.networks.iter().find(|(id, _)| plan[*id].name == network) else {
            return Ok(());
        };
        for port in self.ports.iter().filter(|port| port.network == *network) {
            ip(&["link", "set", &port.name, if up { "up" } else { "down" }])?;
        }
        Ok(())
    }
}

/// Why this machine, or the plan, does not let modules be hosts in namespaces; `None`: it does.
#[must_use]
pub fn lack(plan: &Plan) -> Option<String> {
    if !rustix::process::geteuid().is_root() {
        return Some("network namespaces need root".to_owned());
    }
    if let Err(error) = ip(&["-V"]) {
        return Some(format!("{error:#}"));
    }
    let mut known = BTreeMap::new();
    for module in &plan.modules {
        for address in &module.addresses {
            let ip = address.socket.ip();
            if ip.is_loopback() {
                return Some(format!(
                    "the plan gives module {} the address {ip}, of one computer",
                    module.name
                ));
            }
            if let Some(other) = known.insert(ip, &module.name).filter(|other| **other != module.name) {
                return Some(format!("modules {other} and {} have one address, {ip}", module.name));
            }
        }
    }
    None
}

/// What the process of a module is told about its interfaces: for each the name, the own address, and the others'.
#[must_use]
pub fn interfaces(plan: &Plan, module: ModuleId) -> Vec<String> {
    let one = |address: &bateleur_plan::Address| {
        let others = others_on(plan, address.network, module);
        let all = std::iter::once(address.socket.ip()).chain(others);
        let all: Vec<String> = all.map(|ip| ip.to_string()).collect();
        format!("{}={}", interface(address.network), all.join(","))
    };
    plan[module].addresses.iter().map(one).collect()
}

fn others_on(plan: &Plan, network: NetworkId, own: ModuleId) -> Vec<IpAddr> {
    let modules = plan.modules.iter().enumerate().filter(|(place, _)| *place != own.index());
    modules.filter_map(|(_, module)| Some(module.address_on(network)?.ip())).collect()
}

/// Every network is on some module's list, or nobody needs it.
fn network_at(plan: &Plan, place: usize) -> Option<NetworkId> {
    let addresses = plan.modules.iter().flat_map(|module| &module.addresses);
    addresses.map(|address| address.network).find(|network| network.index() == place)
}

/// A name of its own for each network, however long the plan's is: Linux allows 15 characters.
fn interface(network: NetworkId) -> String {
    format!("net{}", network.index())
}

/// The hidden verb `within`: goes into a new namespace, says so, waits until the interfaces are there, gives them their
/// addresses, and becomes `bateleur` with `arguments`.
pub(crate) fn within(interfaces: &[String], arguments: &[String]) -> Result<()> {
    enter_new()?;
    // Unbuffered: the rest of standard input is the executive's.
    let mut line = UnixStream::from(rustix::io::dup(std::io::stdin())?);
    line.write_all(&[READY]).context("whoever started this does not listen on its standard input")?;
    // Nothing: whoever started this has died.
    if line.read(&mut [0])? == 0 {
        return Ok(());
    }
    drop(line);
    ip(&["link", "set", "lo", "up"])?;
    for one in interfaces {
        let (name, addresses) = one.split_once('=').context("an interface is written NAME=ADDRESS,…")?;
        let addresses: Vec<IpAddr> = addresses.split(',').map(str::parse).collect::<Result<_, _>>()?;
        let (own, others) = addresses.split_first().context("an interface has an address")?;
        configure(name, SocketAddr::new(*own, 0), others)?;
    }
    let error = Command::new(std::env::current_exe()?).args(arguments).exec();
    Err(error).context("cannot start the module")
}

fn enter_new() -> Result<()> {
    // SAFETY: only the network namespace changes; no descriptor table or memory is unshared, and whoever has open sockets keeps
    // them.
    let entered = unsafe { unshare_unsafe(UnshareFlags::NEWNET) };
    entered.context("cannot make a network namespace")
}

/// Gives an interface its address, and the way to everybody else on it, whatever their numbers are.
fn configure(name: &str, own: SocketAddr, others: &[IpAddr]) -> Result<()> {
    let whole = |ip: &IpAddr| format!("{ip}/{}", if ip.is_ipv4() { 32 } else { 128 });
    let mut address = vec!["address", "add"];
    let own = whole(&own.ip());
    address.push(&own);
    // Nobody else has it: it need not be asked for first.
    if own.contains(':') {
        address.push("nodad");
    }
    address.extend(["dev", name]);
    ip(&address)?;
    ip(&["link", "set", name, "up"])?;
    for other in others {
        ip(&["route", "replace", &whole(other), "dev", name])?;
    }
    Ok(())
}

fn ip(arguments: &[&str]) -> Result<()> {
    let output = Command::new("ip")
        .args(arguments)
        .output()
        .context("cannot start `ip`, which makes the networks: install the package iproute2")?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        bail!("`ip {}` failed: {}", arguments.join(" "), said.trim());
    }
    Ok(())
}
