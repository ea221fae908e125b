//! `bateleur record`: writes every message of every channel of a running module into an MCAP file, from now until Ctrl-C,
//! `--for`, or the module's end. As `bateleur run --record`, but at any time; on the virtual clock it sees a part of the
//! messages only. Exit codes: 0 fine, 2 it could not begin.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use bateleur_messages::Type;
use bateleur_recording::{LogError, PortLog, topic};

use super::ports::Watch;
use super::target::{Target, channels};
use super::{Code, FINE};
use crate::hexadecimal::bytes_of;
use crate::output::{LOG_BEGINNING, refuse_file};

/// Record the ports of a running module.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    target: Target,
    /// The file.
    #[arg(long, short, default_value = "ports.mcap")]
    output: PathBuf,
    /// End after so many seconds.
    #[arg(long = "for", value_name = "SECONDS", value_parser = parse_span)]
    seconds: Option<f64>,
}

fn parse_span(text: &str) -> Result<f64, String> {
    let seconds = text.parse::<f64>().ok().filter(|seconds| seconds.is_finite() && *seconds > 0.0);
    seconds.ok_or_else(|| format!("\"{text}\" is not a number of seconds above 0"))
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    refuse_file(&arguments.output, LOG_BEGINNING, &[])?;
    if arguments.output.metadata().is_ok_and(|about| about.is_file() && about.len() > 0) {
        bail!(
            "{} holds a recording already: name another file with --output, or remove this one",
            arguments.output.display()
        );
    }
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM, signal_hook::consts::SIGHUP] {
        signal_hook::flag::register(signal, stop.clone()).context("cannot watch for signals")?;
    }
    let mut client = arguments.target.connect()?;
    let mut log = PortLog::create(&arguments.output)?;
    let mut tracks = BTreeMap::new();
    for channel in channels(&mut client)? {
        // Bytes without a message type have no fields to name: they are left out.
        let Ok(message) = Type::from_schema(&channel.message, &channel.definition) else { continue };
        let (partition, port) = channel.source.split_once('.').unwrap_or((&channel.source, "port"));
        tracks.insert(channel.source.clone(), log.add_channel(&topic(partition, port), &message)?);
    }
    let mut watch = Watch::start(client, &[])?;
    let mut left_out: BTreeMap<String, u64> = BTreeMap::new();
    let (begun, mut line, mut messages) = (Instant::now(), Vec::new(), 0_u64);
    let is_over = || arguments.seconds.is_some_and(|seconds| begun.elapsed().as_secs_f64() >= seconds);
    while !stop.load(Ordering::Acquire) && !is_over() {
        let observation = match watch.next(&mut line) {
            Ok(Some(observation)) => observation,
            Ok(None) => continue,
            Err(error) => {
                eprintln!("bateleur: {error:#}");
                break;
            }
        };
        let (Some(track), Some(bytes)) = (tracks.get(&observation.source), bytes_of(&observation.bytes))
        else {
            continue;
        };
        match log.write(*track, observation.sequence, observation.source_ns, &bytes) {
            Err(LogError::Size { .. }) => *left_out.entry(observation.source).or_default() += 1,
            written => {
                written?;
                messages += 1;
            }
        }
    }
    log.finish()?;
    for (port, count) in left_out {
        eprintln!("bateleur: {count} messages of {port} have another length than its type, and are left out");
    }
    println!("{messages} messages in {}", arguments.output.display());
    Ok(FINE)
}
