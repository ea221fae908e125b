//! `bateleur links [FOLDER]`: how the links between hosts are: what each network carried, what got lost, came late, twice or out
//! of order, what was refused and why, how old the last word of the peer is, and how far the peer's clock is off.
//!
//! Without a folder it asks the modules that run on this machine; with one it says what stood at the end of a run or a flight.
//! All counters count since the relay was started. Exit codes: 0 fine, 2 there is no such module, folder, or link.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use bateleur_control::LINKS_FILE;
use bateleur_control::{Answer, Client, LinkName, Request, running};
use bateleur_messages::link::{DOWN, PLAN_DIFFERS, REASON_NAMES, UP};
use bateleur_messages::{LinkStatus, Message};
use bateleur_monitor::event_text::printable;
use bateleur_recording::{self as log, hosts};
use serde_json::{Value, json};
use zerocopy::FromBytes;

use super::ports::Watch;
use super::target::Target;
use super::{Code, FINE, Format};
use crate::hexadecimal::bytes_of;

/// How long a relay may take to say something, real time: it does in each of its windows.
const PATIENCE: Duration = Duration::from_secs(3);

/// Show how the links between hosts are.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The folder of a run or a flight, in place of what runs now.
    #[arg(conflicts_with = "module")]
    folder: Option<PathBuf>,
    #[command(flatten)]
    target: Target,
    /// What to print.
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
}

/// What the relay of a module said last.
struct Said {
    module: String,
    names: Vec<LinkName>,
    /// `None` if it has said nothing.
    status: Option<LinkStatus>,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    let said = match &arguments.folder {
        Some(folder) => of_folder(folder)?,
        None => of_running(&arguments.target)?,
    };
    match arguments.format {
        Format::Json => println!("{:#}", json!({ "modules": said.iter().map(json_of).collect::<Vec<_>>() })),
        Format::Text => print!("{}", said.iter().map(text_of).collect::<Vec<_>>().join("\n")),
    }
    Ok(FINE)
}

fn of_running(target: &Target) -> Result<Vec<Said>> {
    let all = match target.module {
        Some(_) => vec![target.choose()?],
        None => running(),
    };
    let mut said = Vec::new();
    for one in &all {
        let mut client = Client::connect(one)?;
        let names = match client.ask(&Request::Links)? {
            Answer::Links { links } => links,
            other => bail!("the module's answer is not understood: {other:?}"),
        };
        let module = one.module.clone();
        if names.is_empty() {
            continue;
        }
        let status = latest(client, &module)?;
        said.push(Said { module, names, status });
    }
    if said.is_empty() {
        bail!(
            "no module with a link runs on this machine: start one with `bateleur run` or `bateleur fly --hosts`"
        );
    }
    Ok(said)
}

/// The next word of a running relay.
pub(super) fn latest(client: Client, module: &str) -> Result<Option<LinkStatus>> {
    let mut watch = Watch::start(client, &[format!("relay_{module}.status")])?;
    let (begun, mut line) = (Instant::now(), Vec::new());
    while begun.elapsed() < PATIENCE {
        if let Some(observation) = watch.next(&mut line)? {
            return Ok(
                bytes_of(&observation.bytes).and_then(|bytes| LinkStatus::read_from_bytes(&bytes).ok())
            );
        }
    }
    Ok(None)
}

fn of_folder(folder: &Path) -> Result<Vec<Said>> {
    let mut folders: Vec<_> =
        hosts::of(folder).into_iter().map(|host| hosts::folder_of(folder, &host)).collect();
    // A run of one module is newer than the folders of a run of several beside it.
    if folders.is_empty() && !folder.join(LINKS_FILE).exists() {
        folders = hosts::folders_in(folder);
    }
    if folders.is_empty() {
        return Ok(vec![of_run(folder)?]);
    }
    let of_host = |folder: &PathBuf| Ok(Said { module: name_of(folder), ..of_run(folder)? });
    folders.iter().map(of_host).collect()
}

fn name_of(folder: &Path) -> String {
    folder.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

fn of_run(folder: &Path) -> Result<Said> {
    let names = folder.join(LINKS_FILE);
    let text = std::fs::read(&names)
        .with_context(|| format!("cannot read {}: it was no run with links", names.display()))?;
    let names: Vec<LinkName> =
        serde_json::from_slice(&text).with_context(|| format!("{} is not understood", names.display()))?;
    let path = folder.join(bateleur_recording::PORTS_FILE);
    if !path.exists() {
        bail!(
            "{} is not there: what relays say is kept by `bateleur run --record`, and by every flight",
            path.display()
        );
    }
    let mut found = None;
    log::for_each(&path, |entry| {
        if entry.message == LinkStatus::NAME {
            let module = entry.topic.trim_start_matches("/relay_").split('/').next().unwrap_or_default();
            found = LinkStatus::read_from_bytes(entry.bytes).ok().map(|status| (module.to_owned(), status));
        }
    })?;
    let (module, status) = found.unzip();
    Ok(Said { module: module.unwrap_or_else(|| name_of(folder)), names, status })
}

fn state(code: u64) -> &'static str {
    match code {
        DOWN => "down",
        UP => "up",
        PLAN_DIFFERS => "the peer has another plan",
        _ => "not understood",
    }
}

/// The place of a link in what its relay says.
pub(super) fn place_of(status: &LinkStatus, id: u64) -> Option<usize> {
    let count = usize::try_from(status.links).ok()?;
    status.id.iter().take(count).position(|known| *known == id)
}

fn json_of(said: &Said) -> Value {
    let link = |name: &LinkName| {
        let mut value = json!({ "link": name.name, "peer": name.peer });
        let Some((status, place)) =
            said.status.as_ref().and_then(|status| Some((status, place_of(status, name.id)?)))
        else {
            return value;
        };
        let measured = status.exchanges[place] > 0;
        value["state"] = state(status.state[place]).into();
        value["messages"] = json!({
            "sent": status.messages_sent[place],
            "received": status.messages_received[place],
            "lost": status.messages_lost[place],
            "late": status.messages_late[place],
            "overflowed": status.messages_overflowed[place],
        });
        value["datagrams_lost"] = status.datagrams_lost[place].into();
        value["peer_lives"] = status.peer_lives[place].into();
        value["clock"] = json!({
            "exchanges": status.exchanges[place],
            "offset_ns": measured.then_some(status.offset_ns[place]),
            "uncertainty_ns": measured.then_some(status.uncertainty_ns[place]),
            "round_trip_ns": measured.then_some(status.round_trip_ns[place]),
        });
        let rejected = REASON_NAMES.iter().enumerate().map(|(reason, name)| {
            ((*name).to_owned(), Value::from(status.rejected[LinkStatus::refusal(place, reason)]))
        });
        value["rejected"] = Value::Object(rejected.collect());
        let networks = name.networks.iter().enumerate().map(|(number, network)| {
            let path = LinkStatus::path(place, number);
            json!({
                "network": network,
                "up": status.up[path] == 1,
                "sent": status.sent[path],
                "unsent": status.unsent[path],
                "received": status.received[path],
                "lost": status.lost[path],
                "late": status.late[path],
                "duplicated": status.duplicated[path],
                "redundant": status.redundant[path],
                "reordered": status.reordered[path],
                "age_ns": age_ns(status, path),
                "latency_ns": said_ns(status.latency_ns[path]),
                "allowed_ns": said_ns(status.allowed_ns[path]),
            })
        });
        value["networks"] = networks.collect();
        value
    };
    json!({
        "module": said.module,
        "time_ns": said.status.as_ref().map(|status| status.time_ns),
        "starts": said.status.as_ref().map(|status| status.starts),
        "links": said.names.iter().map(link).collect::<Vec<_>>(),
    })
}

/// A time that is 0 where it is not known.
fn said_ns(time_ns: f64) -> Option<f64> {
    (time_ns > 0.0).then_some(time_ns)
}

/// How long datagrams are on their way of late, in words.
fn way(status: &LinkStatus, path: usize) -> String {
    let us = |time_ns: f64| time_ns / 1e3;
    match (said_ns(status.latency_ns[path]), said_ns(status.allowed_ns[path])) {
        (None, _) => String::new(),
        (Some(latency_ns), None) => format!(", up to {:.1} us on the way", us(latency_ns)),
        (Some(latency_ns), Some(allowed_ns)) => {
            format!(", up to {:.1} of {:.1} us on the way", us(latency_ns), us(allowed_ns))
        }
    }
}

/// How long ago the peer was heard on a network, ns; `None`: never.
fn age_ns(status: &LinkStatus, path: usize) -> Option<u64> {
    let heard_ns = status.heard_ns[path];
    (heard_ns > 0).then(|| status.time_ns.saturating_sub(heard_ns))
}

fn text_of(said: &Said) -> String {
    let module = printable(&said.module);
    match &said.status {
        Some(status) => text(&module, &said.names, status),
        None => format!("module {module}: its relay says nothing\n"),
    }
}

/// What the relay of a module said last, in lines.
#[must_use]
pub fn text(module: &str, names: &[LinkName], status: &LinkStatus) -> String {
    let mut out = String::new();
    let _ = writeln!(out, "module {module} at {:.3} s", status.time_ns as f64 / 1e9);
    for name in names {
        match place_of(status, name.id) {
            Some(place) => link_text(&mut out, status, place, name),
            None => drop(writeln!(out, "  link {}: its relay says nothing of it", printable(&name.name))),
        }
    }
    out
}

fn link_text(out: &mut String, status: &LinkStatus, place: usize, name: &LinkName) {
    let (link, peer) = (printable(&name.name), printable(&name.peer));
    let _ = writeln!(out, "  link {link} to {peer}: {}", state(status.state[place]));
    let _ = writeln!(
        out,
        "    messages: {} sent, {} received, {} lost, {} late, {} overflowed; {} datagrams came on no network",
        status.messages_sent[place],
        status.messages_received[place],
        status.messages_lost[place],
        status.messages_late[place],
        status.messages_overflowed[place],
        status.datagrams_lost[place],
    );
    if status.exchanges[place] > 0 {
        let us = |ns: f64| ns / 1e3;
        let _ = writeln!(
            out,
            "    clock of {peer}: {:+.1} us, within {:.1} us; there and back {:.1} us",
            us(status.offset_ns[place]),
            us(status.uncertainty_ns[place]),
            us(status.round_trip_ns[place]),
        );
    }
    for (number, network) in name.networks.iter().enumerate() {
        let path = LinkStatus::path(place, number);
        let heard = match age_ns(status, path) {
            Some(age_ns) => format!("heard {:.1} ms ago", age_ns as f64 / 1e6),
            None => "never heard".to_owned(),
        };
        let _ = writeln!(
            out,
            "    network {}: {}, {heard}{}; {} sent, {} received, {} lost, {} late, {} twice, {} duplicates from the other network, {} out of order",
            printable(network),
            if status.up[path] == 1 { "up" } else { "down" },
            way(status, path),
            status.sent[path],
            status.received[path],
            status.lost[path],
            status.late[path],
            status.duplicated[path],
            status.redundant[path],
            status.reordered[path],
        );
    }
    let refused = REASON_NAMES.iter().enumerate().filter_map(|(reason, why)| {
        let count = status.rejected[LinkStatus::refusal(place, reason)];
        (count > 0).then(|| format!("{count} {why}"))
    });
    let refused: Vec<String> = refused.collect();
    if !refused.is_empty() {
        let _ = writeln!(out, "    refused: {}", refused.join(", "));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said() -> Said {
        let mut status = LinkStatus { time_ns: 2_000_000_000, starts: 1, links: 1, ..LinkStatus::default() };
        status.id[0] = 4;
        status.state[0] = UP;
        status.messages_sent[0] = 11;
        status.exchanges[0] = 3;
        status.offset_ns[0] = -1500.0;
        status.up[0] = 1;
        status.heard_ns[0] = 1_980_000_000;
        (status.latency_ns[0], status.allowed_ns[0]) = (41_000.0, 623_040.0);
        status.rejected[LinkStatus::refusal(0, 5)] = 7;
        let networks = vec!["a".to_owned(), "b".to_owned()];
        let names = vec![LinkName { id: 4, name: "nav".into(), peer: "fcu".into(), networks }];
        Said { module: "nav".into(), names, status: Some(status) }
    }

    #[test]
    fn a_link_is_shown_with_its_networks_and_what_was_refused() {
        let text = text_of(&said());
        for part in [
            "link nav to fcu: up",
            "11 sent",
            "-1.5 us",
            "network a: up, heard 20.0 ms ago, up to 41.0 of 623.0 us on the way;",
            "network b: down, never heard;",
            "7 key",
        ] {
            assert!(text.contains(part), "no {part:?} in\n{text}");
        }
    }

    #[test]
    fn programs_are_told_the_same() {
        let value = json_of(&said());
        let link = &value["links"][0];
        assert_eq!((&link["link"], &link["state"]), (&"nav".into(), &"up".into()));
        assert_eq!(link["rejected"]["key"], 7);
        assert_eq!(link["networks"][0]["age_ns"], 20_000_000);
        assert_eq!(link["networks"][1]["age_ns"], Value::Null);
        assert_eq!(link["networks"][0]["latency_ns"], 41_000.0);
        assert_eq!(link["networks"][1]["latency_ns"], Value::Null);
        assert_eq!(link["clock"]["offset_ns"], -1500.0);
    }
}
