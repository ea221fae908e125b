//! The gateway's command line, which the programs `can_gateway` and `bateleur gateway` share.
//!
//! `run` carries frames until it is told to end (SIGINT, SIGTERM); every option may also stand in a TOML file, where a
//! flag outdoes it. `status` asks a running gateway. Exit codes: 0 fine, 1 it ran and something is wrong, 2 it could not run.

use std::io::Write;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, Result, bail};
use serde::Deserialize;

use crate::node::{Node, Options};
use crate::server::ServerOptions;
use crate::status;
use bateleur_can_core::bus::BusName;
use bateleur_can_core::identity::{session, usual_identity};
use bateleur_can_core::wire::{cannelloni, native};
use bateleur_can_core::{Ids, Protocol, Rules, Settings};

/// What to do.
#[derive(Debug, clap::Subcommand)]
pub enum Verb {
    /// Carry frames between a bus and the network until it is told to end.
    Run(Box<Run>),
    /// Ask a running gateway how it is.
    Status(Ask),
}

/// How to run. Every option may stand in the file that --config names, with the same name.
#[derive(Debug, Default, Clone, clap::Args, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct Run {
    /// A TOML file with these options, such as: bus = "socketcan:can0".
    #[arg(long, short, value_name = "FILE")]
    #[serde(skip)]
    pub config: Option<PathBuf>,
    /// socketcan:can0, slcan:/dev/ttyUSB0 (with @500000 for the bit rate, ,230400 for the serial line), slcan-pty:PATH (be the
    /// adapter of a new pseudo terminal), replay:FILE, none.
    #[arg(long, short, value_name = "BUS")]
    pub bus: Option<String>,
    /// Its name, for its status. [default: can]
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// native (finds others by itself) or cannelloni (to fixed peers). [default: native]
    #[arg(long, value_name = "NAME")]
    pub protocol: Option<String>,
    /// Own UDP address. [default: 0.0.0.0:15210, cannelloni 0.0.0.0:20000]
    #[arg(long, value_name = "ADDRESS:PORT")]
    pub listen: Option<SocketAddr>,
    /// Where it asks who is there, instead of broadcasting; with cannelloni, its peers (may be repeated).
    #[arg(long, value_name = "ADDRESS:PORT")]
    pub peer: Vec<SocketAddr>,
    /// Listen to these computers alone (may be repeated).
    #[arg(long, value_name = "ADDRESS")]
    pub only_from: Vec<IpAddr>,
    /// Who it is, up to 16 hexadecimal digits; the default is drawn from this machine and the name.
    #[arg(long, value_name = "HEX")]
    pub identity: Option<String>,
    /// Identifiers that are forwarded from the bus to the network: all, or 100-1ff,2a0. [default: all]
    #[arg(long, value_name = "IDS")]
    pub forward: Option<String>,
    /// Identifiers of values that are sent again and again: the newest takes the place of one that waits. [default: none]
    #[arg(long, value_name = "IDS")]
    pub newest_wins: Option<String>,
    /// A frame that is older is given up, ms. [default: 1000]
    #[arg(long, value_name = "MS")]
    pub max_age_ms: Option<f64>,
    /// A frame waits so long for others to share its datagram, ms. [default: 0]
    #[arg(long, value_name = "MS")]
    pub flush_after_ms: Option<f64>,
    /// Frames that wait, in each direction. [default: 4096]
    #[arg(long, value_name = "FRAMES")]
    pub buffer: Option<usize>,
    /// Serve clients of socketcand (python-can's, for example) there, TCP. [default port: 29536]
    #[arg(long, value_name = "ADDRESS:PORT", num_args = 0..=1, default_missing_value = "0.0.0.0:29536")]
    pub socketcand: Option<SocketAddr>,
    /// The name under which those clients open the bus. [default: can0]
    #[arg(long, value_name = "NAME")]
    pub socketcand_bus: Option<String>,
    /// Tell the network by broadcast that there is such a server.
    #[arg(long)]
    pub beacon: bool,
    /// Write every frame into this file, as candump -l does; behind what it holds already.
    #[arg(long, value_name = "FILE")]
    pub log: Option<PathBuf>,
    /// Where its status is told. [default: bateleur-can-NAME.sock in the folder for such files]
    #[arg(long, value_name = "PATH")]
    pub status: Option<PathBuf>,
    /// Print its addresses as one line of JSON when it listens, and end when standard input closes: for programs that start it.
    #[arg(long)]
    #[serde(skip)]
    pub ready: bool,
}

/// Whom to ask, and how to show it.
#[derive(Debug, clap::Args)]
pub struct Ask {
    /// The gateway's name.
    #[arg(long, value_name = "NAME", default_value = "can")]
    pub name: String,
    /// Where it tells its status, if it was told to do so elsewhere.
    #[arg(long, value_name = "PATH")]
    pub status: Option<PathBuf>,
    /// text or json.
    #[arg(long, value_name = "FORMAT", default_value = "text", value_parser = ["text", "json"])]
    pub format: String,
}

/// Does it; gives the exit code.
///
/// # Errors
/// It could not run: exit code 2.
pub fn perform(verb: &Verb) -> Result<u8> {
    match verb {
        Verb::Run(arguments) => run(arguments),
        Verb::Status(arguments) => ask(arguments),
    }
}

fn run(arguments: &Run) -> Result<u8> {
    let options = arguments.clone().with_file()?.options()?;
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register(signal, stop.clone()).context("cannot watch for signals")?;
    }
    let name = options.name.clone();
    let mut node = Node::new(options)?;
    if arguments.ready {
        let ready = serde_json::json!({ "listening": node.address(), "socketcand": node.server_address() });
        println!("{ready}");
        std::io::stdout().flush().context("cannot say that it is ready")?;
        let stop = stop.clone();
        std::thread::spawn(move || {
            let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink()); // its end is what counts
            stop.store(true, std::sync::atomic::Ordering::Relaxed);
        });
    }
    // One write a line: several programs of a flight share one standard error.
    let say = |text: &str| std::io::stderr().write_all(format!("gateway {name}: {text}\n").as_bytes());
    node.run(&stop, &mut |text| drop(say(text)));
    let counters = node.counters();
    let (bus_in, bus_out, lost) = (counters.bus_in, counters.bus_out, counters.lost());
    let _ = say(&format!("ends; {bus_in} frames from the bus, {bus_out} to it, {lost} lost"));
    Ok(0)
}

fn ask(arguments: &Ask) -> Result<u8> {
    let path = arguments.status.clone().unwrap_or_else(|| status::usual_path(&arguments.name));
    let status = status::ask(&path).with_context(|| {
        let others = match status::running() {
            names if names.is_empty() => "none runs where they usually tell it".to_owned(),
            names => format!("there are --name {}", names.join(", --name ")),
        };
        format!("no gateway tells its status at {}; {others}", path.display())
    })?;
    let text = match arguments.format.as_str() {
        "json" => format!("{status:#}\n"),
        _ => status::text(&status),
    };
    let _ = std::io::stdout().write_all(text.as_bytes()); // nobody reads
    let mut targets = status["targets"].as_array().into_iter().flatten();
    let is_shared = !status["same_identity"].is_null() || targets.any(|target| target["shared"] == true);
    let is_well = !is_shared && status["bus_state"] != "off" && !status["bus_state"].is_null();
    Ok(u8::from(!is_well))
}

impl Run {
    /// With what the file says where no flag says otherwise.
    fn with_file(self) -> Result<Self> {
        let Some(path) = &self.config else { return Ok(self) };
        let text =
            std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
        let file = Self::parse(&text, path)?;
        let many =
            |flags: Vec<SocketAddr>, file: Vec<SocketAddr>| if flags.is_empty() { file } else { flags };
        Ok(Self {
            bus: self.bus.or(file.bus),
            name: self.name.or(file.name),
            protocol: self.protocol.or(file.protocol),
            listen: self.listen.or(file.listen),
            peer: many(self.peer, file.peer),
            only_from: if self.only_from.is_empty() { file.only_from } else { self.only_from },
            identity: self.identity.or(file.identity),
            forward: self.forward.or(file.forward),
            newest_wins: self.newest_wins.or(file.newest_wins),
            max_age_ms: self.max_age_ms.or(file.max_age_ms),
            flush_after_ms: self.flush_after_ms.or(file.flush_after_ms),
            buffer: self.buffer.or(file.buffer),
            socketcand: self.socketcand.or(file.socketcand),
            socketcand_bus: self.socketcand_bus.or(file.socketcand_bus),
            beacon: self.beacon || file.beacon,
            log: self.log.or(file.log),
            status: self.status.or(file.status),
            config: self.config,
            ready: self.ready,
        })
    }

    fn parse(text: &str, path: &Path) -> Result<Self> {
        toml::from_str(text).map_err(|error| {
            let before = error.span().map_or(0, |span| span.start).min(text.len());
            let line = 1 + text[..before].matches('\n').count();
            anyhow::anyhow!("{}:{line}: {}", path.display(), error.message())
        })
    }

    /// As a gateway takes them.
    fn options(self) -> Result<Options> {
        let Some(bus) = &self.bus else {
            bail!("which bus? --bus socketcan:can0, for example (--help lists them)")
        };
        let bus: BusName = bus.parse()?;
        if let (BusName::Replay(replayed), Some(log)) = (&bus, &self.log)
            && (replayed == log
                || replayed.canonicalize().ok().is_some_and(|file| log.canonicalize().ok() == Some(file)))
        {
            bail!("--log {}: that is the log that is replayed; give another file", log.display());
        }
        let protocol = match self.protocol.as_deref() {
            None | Some("native") => Protocol::Native,
            Some("cannelloni") => Protocol::Cannelloni,
            Some(other) => bail!("there is no protocol \"{other}\"; there are native and cannelloni"),
        };
        let port = match protocol {
            Protocol::Native => native::PORT,
            Protocol::Cannelloni => cannelloni::PORT,
        };
        if protocol == Protocol::Cannelloni && self.peer.is_empty() {
            bail!("cannelloni goes to fixed peers: name one with --peer ADDRESS:PORT");
        }
        let name = self.name.unwrap_or_else(|| "can".into());
        if name.is_empty() || name.contains('/') {
            bail!("--name \"{name}\": a name is part of a file's name, and has no / in it");
        }
        let listen = self.listen.unwrap_or(SocketAddr::from((Ipv4Addr::UNSPECIFIED, port)));
        let everybody = SocketAddr::from((Ipv4Addr::BROADCAST, port));
        let peers = if self.peer.is_empty() { vec![everybody] } else { self.peer };
        let identity = match &self.identity {
            Some(text) => u64::from_str_radix(text, 16)
                .map_err(|_| anyhow::anyhow!("--identity \"{text}\": up to 16 hexadecimal digits"))?,
            None => usual_identity(&name, listen.port()),
        };
        let ids = |text: Option<String>, usual: Ids| text.map_or(Ok(usual), |text| text.parse::<Ids>());
        let ring = Rules {
            capacity: self.buffer.unwrap_or(4_096),
            max_age_ns: ns(self.max_age_ms, 1_000.0, "--max-age-ms")?,
            newest_wins: ids(self.newest_wins, Ids::None)?,
        };
        if !(1..=1 << 20).contains(&ring.capacity) {
            bail!("--buffer {}: between 1 and {} frames", ring.capacity, 1 << 20);
        }
        let settings = Settings {
            protocol,
            forward: ids(self.forward, Ids::All)?,
            flush_after_ns: ns(self.flush_after_ms, 0.0, "--flush-after-ms")?,
            only_from: self.only_from.clone(),
            ring: ring.clone(),
            ..Settings::new(identity, session(), peers)
        };
        let server = self.socketcand.map(|listen| ServerOptions {
            listen,
            bus: self.socketcand_bus.unwrap_or_else(|| "can0".into()),
            beacon: self.beacon,
            only_from: self.only_from,
        });
        Ok(Options {
            bus,
            listen,
            settings,
            to_bus: ring,
            server,
            status: Some(self.status.unwrap_or_else(|| status::usual_path(&name))),
            log: self.log,
            name,
        })
    }
}

/// Milliseconds as nanoseconds.
fn ns(ms: Option<f64>, usual: f64, flag: &str) -> Result<u64> {
    let ms = ms.unwrap_or(usual);
    if !(0.0..=3_600_000.0).contains(&ms) {
        bail!("{flag} {ms}: between 0 and 3600000 ms");
    }
    Ok((ms * 1e6) as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(run: Run) -> String {
        run.options().unwrap_err().to_string()
    }

    fn bus() -> Run {
        Run { bus: Some("none".into()), ..Run::default() }
    }

    #[test]
    fn a_file_says_the_same_as_flags_and_a_flag_outdoes_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("gateway.toml");
        std::fs::write(
            &path,
            "bus = \"slcan:/dev/ttyUSB0@800000\"\nname = \"wing\"\npeer = [\"10.0.0.2:15210\"]\nidentity = \"2a\"\n\
             newest-wins = \"100-1ff\"\nmax-age-ms = 50\nsocketcand = \"127.0.0.1:29536\"\n",
        )
        .unwrap();
        let run = Run { config: Some(path), name: Some("tail".into()), ..Run::default() };
        let options = run.with_file().unwrap().options().unwrap();
        assert_eq!((options.name.as_str(), options.settings.identity), ("tail", 0x2a));
        assert_eq!(options.bus.to_string(), "slcan:/dev/ttyUSB0@800000");
        assert_eq!(options.settings.ring.max_age_ns, 50_000_000);
        assert_eq!(options.settings.discover, ["10.0.0.2:15210".parse().unwrap()]);
        assert_eq!(options.server.unwrap().bus, "can0");
    }

    #[test]
    fn what_is_wrong_in_a_file_is_named_with_its_line() {
        let parse = |text: &str| Run::parse(text, Path::new("g.toml")).unwrap_err().to_string();
        assert!(
            parse("bus = \"none\"\nbuss = 1\n").starts_with("g.toml:2: unknown field"),
            "{}",
            parse("\nbuss = 1\n")
        );
        assert!(parse("buffer = \"many\"\n").starts_with("g.toml:1:"));
        assert!(parse("listen = \"here\"\n").contains("g.toml:1:"));
    }

    #[test]
    fn options_that_make_no_sense_are_refused_with_what_would() {
        assert!(said(Run::default()).contains("socketcan:can0"));
        assert!(said(Run { protocol: Some("udp".into()), ..bus() }).contains("cannelloni"));
        assert!(said(Run { protocol: Some("cannelloni".into()), ..bus() }).contains("--peer"));
        assert!(said(Run { identity: Some("me".into()), ..bus() }).contains("hexadecimal"));
        assert!(said(Run { forward: Some("some".into()), ..bus() }).contains("100-1ff"));
        assert!(said(Run { max_age_ms: Some(-1.0), ..bus() }).contains("--max-age-ms"));
        assert!(said(Run { buffer: Some(0), ..bus() }).contains("--buffer"));
        assert!(said(Run { name: Some("a/b".into()), ..bus() }).contains("--name"));
        let replay = Run { bus: Some("replay:a.log".into()), log: Some("a.log".into()), ..Run::default() };
        assert!(said(replay).contains("that is the log that is replayed"));
    }

    #[test]
    fn gateways_of_one_name_that_listen_at_different_ports_have_different_identities() {
        let identity = |listen: Option<&str>| {
            let listen = listen.map(|listen| listen.parse().unwrap());
            Run { listen, ..bus() }.options().unwrap().settings.identity
        };
        assert_ne!(identity(Some("10.0.0.1:15210")), identity(Some("10.0.0.1:15211")));
        assert_eq!(
            identity(Some("10.0.0.1:15210")),
            identity(None),
            "the port that it has unless told another"
        );
    }

    #[test]
    fn names_and_ports_tell_gateways_of_one_machine_apart() {
        assert_eq!(usual_identity("a", 1), usual_identity("a", 1));
        assert_ne!(usual_identity("a", 1), usual_identity("b", 1));
        assert_ne!(usual_identity("a", 1), usual_identity("a", 2));
    }
}
