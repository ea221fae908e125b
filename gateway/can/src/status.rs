//! What a running gateway says about itself, over a socket in the file system: whoever connects is told once, as JSON.

use std::fs;
use std::io::{self, ErrorKind, Read, Write};
use std::net::SocketAddr;
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Serialize;
use serde_json::Value;

use crate::server::ServerCounters;
use bateleur_can_core::Counters;
use bateleur_can_core::bus::BusState;
use bateleur_can_core::{Protocol, State, TargetStatus};

/// How long an answer is waited for.
const PATIENCE: Duration = Duration::from_secs(3);
/// Longest answer that is read, bytes.
const ANSWER_BYTES: u64 = 1 << 20;

/// Everything.
#[derive(Debug, Clone, Serialize)]
pub struct Status {
    /// The gateway's name.
    pub name: String,
    /// Its process.
    pub pid: u32,
    /// How long it has run, s.
    pub uptime_s: f64,
    /// Its bus.
    pub bus: String,
    /// How its controller is; `None` if the bus is not there.
    pub bus_state: Option<BusState>,
    /// Where it is in its life.
    pub state: State,
    /// What it speaks.
    pub protocol: Protocol,
    /// Who it is.
    pub identity: String,
    /// Where it listens.
    pub address: Option<SocketAddr>,
    /// Another gateway with the same identity.
    pub same_identity: Option<SocketAddr>,
    /// Frames that wait for the network.
    pub waiting_for_network: usize,
    /// Frames that wait for the bus.
    pub waiting_for_bus: usize,
    /// Its targets.
    pub targets: Vec<TargetStatus>,
    /// What became of everything.
    pub counters: Counters,
    /// Frames that did not get to where they were meant to, for any reason.
    pub lost_frames: u64,
    /// The socketcand server's, where there is one.
    pub server: Option<ServerCounters>,
}

/// Before and behind a gateway's name in the name of its socket.
const BEFORE: &str = "bateleur-can-";
const BEHIND: &str = ".sock";

/// Where the gateway called `name` tells its status, unless it was told otherwise.
pub fn usual_path(name: &str) -> PathBuf {
    usual_folder().join(format!("{BEFORE}{name}{BEHIND}"))
}

/// The names of the gateways that tell their status in the usual folder.
pub fn running() -> Vec<String> {
    running_in(&usual_folder())
}

fn running_in(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let name = |path: &Path| {
        let name = path.file_name()?.to_str()?.strip_prefix(BEFORE)?.strip_suffix(BEHIND)?.to_owned();
        UnixStream::connect(path).is_ok().then_some(name)
    };
    let mut names: Vec<String> = entries.filter_map(|entry| name(&entry.path())).collect();
    names.sort();
    names
}

fn usual_folder() -> PathBuf {
    match std::env::var_os("XDG_RUNTIME_DIR") {
        Some(folder) => PathBuf::from(folder),
        None if rustix::process::geteuid().is_root() && Path::new("/run").is_dir() => "/run".into(),
        None => std::env::temp_dir(),
    }
}

/// The gateway's end.
#[derive(Debug)]
pub struct Teller {
    listener: UnixListener,
    path: PathBuf,
}

impl Teller {
    /// Listens at `path`.
    ///
    /// # Errors
    /// A gateway tells there already, or the folder can not be written.
    pub fn bind(path: &Path) -> io::Result<Self> {
        if UnixStream::connect(path).is_ok() {
            return Err(io::Error::new(
                ErrorKind::AddrInUse,
                "a gateway of this name runs already (--name gives another)",
            ));
        }
        match fs::remove_file(path) {
            Ok(()) => {}
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(error) => return Err(error),
        }
        let listener = UnixListener::bind(path)?;
        listener.set_nonblocking(true)?;
        Ok(Self { listener, path: path.into() })
    }

    /// Readable when somebody asks.
    pub fn descriptor(&self) -> BorrowedFd<'_> {
        self.listener.as_fd()
    }

    /// Answers whoever asks.
    pub fn answer(&self, status: impl Fn() -> Status) {
        while let Ok((mut stream, _)) = self.listener.accept() {
            // One that does not read must not hold up frames: what does not fit at once is not said.
            let ready = stream.set_nonblocking(true);
            if let (Ok(()), Ok(mut text)) = (ready, serde_json::to_vec(&status())) {
                text.push(b'\n');
                let _ = stream.write_all(&text); // it has gone
            }
        }
    }
}

impl Drop for Teller {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.path); // somebody tidied up
    }
}

/// Asks the gateway that tells at `path`.
///
/// # Errors
/// None tells there.
pub fn ask(path: &Path) -> io::Result<Value> {
    let stream = UnixStream::connect(path)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    let mut text = String::new();
    stream.take(ANSWER_BYTES).read_to_string(&mut text)?;
    serde_json::from_str(&text).map_err(|error| io::Error::new(ErrorKind::InvalidData, error))
}

/// The status as a person reads it.
pub fn text(status: &Value) -> String {
    let word = |key: &str| match &status[key] {
        Value::String(text) => text.clone(),
        Value::Null => "-".into(),
        other => other.to_string(),
    };
    let bus_state = match status["bus_state"].as_str() {
        Some(state) => format!("error {state}").replace("error off", "bus-off"),
        None => "not there".into(),
    };
    let mut out = format!(
        "gateway {} (process {}, {:.0} s)\nbus      {}, {bus_state}\nnetwork  {}, {}, identity {}\nstate    {}\n",
        word("name"),
        word("pid"),
        status["uptime_s"].as_f64().unwrap_or(0.0),
        word("bus"),
        word("address"),
        word("protocol"),
        word("identity"),
        word("state"),
    );
    if let Some(address) = status["same_identity"].as_str() {
        out += &format!("WRONG    {address} has the same identity: give each gateway its own\n");
    }
    out += &format!(
        "waiting  {} for the network, {} for the bus\n",
        word("waiting_for_network"),
        word("waiting_for_bus")
    );
    out += &format!("lost     {} frames in all\n", word("lost_frames"));
    for target in status["targets"].as_array().into_iter().flatten() {
        out += &format!(
            "target   {} at {}: {}{}, {} frames from it, {} lost, {} datagrams late, {} repeated\n",
            target["identity"].as_str().unwrap_or("-"),
            target["address"].as_str().unwrap_or("-"),
            if target["present"] == true { "there" } else { "LOST" },
            if target["shared"] == true { ", WRONG: two gateways have this identity" } else { "" },
            target["frames"],
            target["lost_frames"],
            target["late"],
            target["repeated"],
        );
    }
    for table in ["counters", "server"] {
        for (name, value) in status[table].as_object().into_iter().flatten() {
            let parts: Vec<(String, &Value)> = match value.as_object() {
                Some(parts) => parts.iter().map(|(part, value)| (format!("{name} {part}"), value)).collect(),
                None => vec![(name.clone(), value)],
            };
            for (name, value) in parts.iter().filter(|(_, value)| **value != 0) {
                out += &format!("  {:<28} {value}\n", name.replace('_', " "));
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gateways_that_run_are_listed_and_those_that_were_killed_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(format!("{BEFORE}{name}{BEHIND}"));
        let _tail = Teller::bind(&place("tail")).unwrap();
        let _wing = Teller::bind(&place("wing")).unwrap();
        drop(UnixListener::bind(place("dead")).unwrap()); // its file stays
        fs::write(folder.path().join("other.sock"), "").unwrap();
        assert_eq!(running_in(folder.path()), ["tail", "wing"]);
    }
}
