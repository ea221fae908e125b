//! `bateleur ports list|echo|hz|pub`: the channels of a running module, what they carry, and how often; and messages of one's own.
//!
//! Messages are read by an observer, a process of the partitions' user that the executive starts: it can not slow a
//! writer down, and is gone when this program is. On the virtual clock it sees a part of the messages only.
//! Exit codes: 0 fine, 2 there is no such module or port.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, ErrorKind, Write};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use bateleur_control::{Answer, ChannelStatus, Client, Observation, Request};
use bateleur_messages::Type;
use bateleur_messages::format::{Leaf, Scalar};
use bateleur_monitor::event_text::printable;
use bateleur_recording::{values, word_of};
use serde_json::{Map, Value};

use super::target::{Target, channels, status};
use super::{Code, FINE, Format, publish};
use crate::hexadecimal::bytes_of;
use crate::printed::Printed;

/// Look at the channels of a running module.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Name every channel: its ports, its message, its rate and the age of its last message.
    List {
        /// Seconds for which messages are counted.
        #[arg(long = "for", value_name = "SECONDS", default_value_t = 1.0, value_parser = parse_seconds)]
        seconds: f64,
        #[command(flatten)]
        common: Common,
    },
    /// Print the messages of a port with their values by name.
    Echo {
        /// The port, PARTITION.PORT; either end of the channel.
        port: String,
        /// End after so many messages.
        #[arg(long, value_name = "N")]
        count: Option<u64>,
        #[command(flatten)]
        common: Common,
    },
    /// Measure how often messages come.
    Hz {
        /// The port, PARTITION.PORT; without one, all channels.
        port: Option<String>,
        /// Seconds for which messages are counted.
        #[arg(long = "for", value_name = "SECONDS", default_value_t = 5.0, value_parser = parse_seconds)]
        seconds: f64,
        #[command(flatten)]
        common: Common,
    },
    /// Write a message by the names of its fields into a port that the plan leaves to the operator (`operator = true`).
    Pub(publish::Arguments),
}

#[derive(Debug, clap::Args)]
struct Common {
    #[command(flatten)]
    target: Target,
    /// What to print.
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
}

fn parse_seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse::<f64>().ok().filter(|seconds| (0.1..=3600.0).contains(seconds));
    seconds.ok_or_else(|| format!("\"{text}\" is not a number of seconds from 0.1 to 3600"))
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    match &arguments.what {
        What::List { seconds, common } => list(common, *seconds),
        What::Echo { port, count, common } => echo(common, port, *count),
        What::Hz { port, seconds, common } => hz(common, port.as_deref(), *seconds),
        What::Pub(arguments) => publish::run(arguments),
    }
    .map(|()| FINE)
}

/// Messages as they come.
#[derive(Debug)]
pub struct Watch(BufReader<UnixStream>);

/// How long a look for the next message lasts, so that there is time for something else.
const LOOK: Duration = Duration::from_millis(100);
/// How long nothing may come before somebody who waits for it is told so.
const SILENCE: Duration = Duration::from_secs(2);

impl Watch {
    /// Of the channels with these ports; of all where there are none.
    ///
    /// # Errors
    /// The module refuses: there is no such port, or there are two observers already.
    pub fn start(mut client: Client, ports: &[String]) -> Result<Self> {
        match client.ask(&Request::Watch { ports: ports.to_vec() })? {
            Answer::Watching => {}
            other => bail!("the module's answer is not understood: {other:?}"),
        }
        let lines = client.into_lines();
        lines.get_ref().set_read_timeout(Some(LOOK)).context("cannot listen to the observer")?;
        Ok(Self(lines))
    }

    /// The next message; `None` if nothing has come yet. `line` holds what has come of it so far.
    ///
    /// # Errors
    /// The module has ended, or its observer.
    pub fn next(&mut self, line: &mut Vec<u8>) -> Result<Option<Observation>> {
        match self.0.read_until(b'\n', line) {
            Ok(0) => bail!("the module, or its observer, has ended"),
            Ok(_) if line.ends_with(b"\n") => {
                let observation = serde_json::from_slice(line).context("the observer's line is damaged");
                line.clear();
                observation.map(Some)
            }
            Ok(_) => Ok(None),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => Ok(None),
            Err(error) => Err(error).context("cannot listen to the observer"),
        }
    }

    /// All that comes in `seconds`.
    fn for_each(&mut self, seconds: f64, mut each: impl FnMut(Observation)) -> Result<()> {
        let (begun, mut line) = (Instant::now(), Vec::new());
        while begun.elapsed().as_secs_f64() < seconds {
            if let Some(observation) = self.next(&mut line)? {
                each(observation);
            }
        }
        Ok(())
    }
}

/// The values of a message by name, a line for each field, with the unit and the name of a value where there are such.
fn lines(message: &Type, bytes: &[u8]) -> String {
    let line = |leaf: &Leaf| {
        let numbers: Vec<Scalar> = leaf.numbers(bytes).collect();
        let unit = if leaf.unit.is_empty() { String::new() } else { format!(" {}", leaf.unit) };
        let names: Vec<&str> = numbers.iter().filter_map(|number| leaf.choice(*number)).collect();
        let names = if names.is_empty() { String::new() } else { format!(" ({})", names.join(", ")) };
        let values = match (leaf.count, numbers.as_slice()) {
            (None, [one]) => word_of(*one),
            (None, _) => Value::Null,
            (Some(_), all) => all.iter().map(|number| word_of(*number)).collect(),
        };
        format!("  {}: {values}{unit}{names}\n", leaf.path)
    };
    message.leaves().iter().map(line).collect()
}

fn echo(common: &Common, port: &str, count: Option<u64>) -> Result<()> {
    let mut client = common.target.connect()?;
    let channels = channels(&mut client)?;
    let mut watch = Watch::start(client, &[port.to_owned()])?;
    let (mut line, mut seen, mut output) = (Vec::new(), 0, Printed);
    let mut silent = Some(Instant::now());
    while count.is_none_or(|count| seen < count) {
        let Some(observation) = watch.next(&mut line)? else {
            if silent.take_if(|since| since.elapsed() > SILENCE).is_some() {
                eprintln!(
                    "bateleur: {port} carries nothing yet; waiting for its first message (Ctrl-C ends this)"
                );
            }
            continue;
        };
        (seen, silent) = (seen + 1, None);
        if output.write_all(message_text(&observation, &channels, common.format).as_bytes()).is_err() {
            return Ok(()); // nobody reads any more
        }
    }
    Ok(())
}

fn message_text(observation: &Observation, channels: &[ChannelStatus], format: Format) -> String {
    let channel = channels.iter().find(|channel| channel.source == observation.source);
    let message = channel.and_then(|channel| Type::from_schema(&channel.message, &channel.definition).ok());
    let bytes = bytes_of(&observation.bytes).unwrap_or_default();
    match format {
        Format::Json => {
            let source = &observation.source;
            let (sequence, source_ns) = (observation.sequence, observation.source_ns);
            let values = match message {
                Some(message) => values(&message, &bytes, word_of),
                // Bytes without a message type have no fields to name.
                None => Map::from_iter([("bytes".to_owned(), observation.bytes.clone().into())]),
            };
            format!(
                "{}\n",
                serde_json::json!({ "source": source, "sequence": sequence, "source_ns": source_ns, "values": values })
            )
        }
        Format::Text => {
            let time_s = observation.source_ns as f64 / 1e9;
            let lines = match message {
                Some(message) => lines(&message, &bytes),
                None => format!("  bytes: \"{}\"\n", observation.bytes),
            };
            format!("{time_s:.6} s  #{}\n{}", observation.sequence, printable_lines(&lines))
        }
    }
}

fn printable_lines(text: &str) -> String {
    text.lines().map(|line| format!("{}\n", printable(line))).collect()
}

/// What was seen of a channel.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Seen {
    messages: u64,
    first_ns: u64,
    last_ns: u64,
    least_ns: u64,
    most_ns: u64,
    lost: u64,
    sequence: u64,
}

impl Seen {
    fn add(&mut self, observation: &Observation) {
        if self.messages == 0 {
            self.first_ns = observation.source_ns;
            self.least_ns = u64::MAX;
        } else {
            let since_ns = observation.source_ns.saturating_sub(self.last_ns);
            (self.least_ns, self.most_ns) = (self.least_ns.min(since_ns), self.most_ns.max(since_ns));
            // A lower number is a successor's, which counts anew.
            self.lost += observation.sequence.saturating_sub(self.sequence + 1);
        }
        self.messages += 1;
        (self.last_ns, self.sequence) = (observation.source_ns, observation.sequence);
    }

    /// Messages a second of module time.
    fn rate_hz(&self) -> Option<f64> {
        let over_ns = self.last_ns.checked_sub(self.first_ns).filter(|over| *over > 0)?;
        Some((self.messages - 1) as f64 * 1e9 / over_ns as f64)
    }
}

fn count(watch: &mut Watch, seconds: f64) -> Result<BTreeMap<String, Seen>> {
    let mut seen: BTreeMap<String, Seen> = BTreeMap::new();
    watch.for_each(seconds, |observation| {
        seen.entry(observation.source.clone()).or_default().add(&observation);
    })?;
    Ok(seen)
}

fn list(common: &Common, seconds: f64) -> Result<()> {
    let mut client = common.target.connect()?;
    let channels = channels(&mut client)?;
    let mut watch = Watch::start(client, &[])?;
    let mut seen = count(&mut watch, seconds)?;
    drop(watch);
    let now_ns = status(&mut common.target.connect()?)?.module_ns;
    let mut rows = Vec::new();
    for channel in channels {
        let seen = seen.remove(&channel.source).unwrap_or_default();
        let age_ns = (seen.messages > 0).then(|| now_ns.saturating_sub(seen.last_ns));
        rows.push((channel, seen.rate_hz(), age_ns));
    }
    match common.format {
        Format::Json => {
            let rows = rows.iter().map(|(channel, rate_hz, age_ns)| {
                let mut row = serde_json::to_value(channel).unwrap_or_default();
                row["rate_hz"] = (*rate_hz).into();
                row["last_age_ns"] = (*age_ns).into();
                row
            });
            println!("{:#}", Value::from_iter(rows));
        }
        Format::Text => {
            println!(
                "{:<30}{:<18}{:>6}{:>10}{:>9}{:>10}  DESTINATIONS",
                "SOURCE", "MESSAGE", "BYTES", "KIND", "HZ", "AGE ms"
            );
            for (channel, rate_hz, age_ns) in rows {
                let dash = || "-".to_owned();
                println!(
                    "{:<30}{:<18}{:>6}{:>10}{:>9}{:>10}  {}",
                    printable(&channel.source),
                    printable(&channel.message),
                    channel.size,
                    channel.queue_depth.map_or_else(|| "sampling".into(), |depth| format!("queue {depth}")),
                    rate_hz.map_or_else(dash, |rate| format!("{rate:.1}")),
                    age_ns.map_or_else(dash, |age| format!("{:.1}", age as f64 / 1e6)),
                    printable(&channel.destinations.join(" "))
                );
            }
        }
    }
    Ok(())
}

/// What was seen, with those channels that carried nothing.
fn with_silent(mut seen: BTreeMap<String, Seen>, channels: &[ChannelStatus]) -> BTreeMap<String, Seen> {
    for channel in channels {
        seen.entry(channel.source.clone()).or_default();
    }
    seen
}

fn hz(common: &Common, port: Option<&str>, seconds: f64) -> Result<()> {
    let mut client = common.target.connect()?;
    let wanted = |channel: &ChannelStatus| {
        port.is_none_or(|port| channel.source == port || channel.destinations.iter().any(|end| end == port))
    };
    let channels: Vec<ChannelStatus> = channels(&mut client)?.into_iter().filter(wanted).collect();
    let ports: Vec<String> = port.into_iter().map(str::to_owned).collect();
    let seen = with_silent(count(&mut Watch::start(client, &ports)?, seconds)?, &channels);
    if common.format == Format::Json {
        let rows = seen.iter().map(|(source, seen)| {
            serde_json::json!({
                "source": source, "messages": seen.messages, "rate_hz": seen.rate_hz(), "lost": seen.lost,
                "period_min_ns": (seen.messages > 1).then_some(seen.least_ns),
                "period_max_ns": (seen.messages > 1).then_some(seen.most_ns),
            })
        });
        println!("{:#}", Value::from_iter(rows));
        return Ok(());
    }
    println!("{:<30}{:>10}{:>9}{:>22}{:>6}", "SOURCE", "MESSAGES", "HZ", "PERIOD min/max ms", "LOST");
    for (source, seen) in &seen {
        let period = match seen.messages {
            0 | 1 => "-".to_owned(),
            _ => format!("{:.2}/{:.2}", seen.least_ns as f64 / 1e6, seen.most_ns as f64 / 1e6),
        };
        println!(
            "{:<30}{:>10}{:>9}{period:>22}{:>6}",
            printable(source),
            seen.messages,
            seen.rate_hz().map_or_else(|| "-".to_owned(), |rate| format!("{rate:.1}")),
            seen.lost
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_have_their_names_units_and_words() {
        let schema = "uint32 MODE_SWEEP = 7\nuint32 mode # [@enum MODE]\nfloat32[2] range # [m]\nE[1] echoes\n===\nMSG: bateleur/E\nint32 x";
        let radar = Type::from_schema("Radar", schema).unwrap();
        let bytes: Vec<u8> = [7, 1.5_f32.to_bits(), f32::NAN.to_bits(), u32::MAX]
            .iter()
            .flat_map(|word| word.to_le_bytes())
            .collect();
        assert_eq!(lines(&radar, &bytes), "  mode: 7 (SWEEP)\n  range: [1.5,\"NaN\"] m\n  echoes[0].x: -1\n");
        let values = values(&radar, &bytes, word_of);
        assert_eq!((&values["mode"], &values["echoes"][0]["x"]), (&7.into(), &Value::from(-1)));
        assert!(lines(&radar, &bytes[..3]).starts_with("  mode: null\n  range: [] m\n"));
    }

    #[test]
    fn silent_channels_are_counted_too() {
        let heard = BTreeMap::from([("a.b".to_owned(), Seen { messages: 3, ..Seen::default() })]);
        let channel = |source: &str| ChannelStatus { source: source.to_owned(), ..ChannelStatus::default() };
        let all = with_silent(heard, &[channel("a.b"), channel("c.d")]);
        assert_eq!((all["a.b"].messages, all["c.d"].messages), (3, 0));
        assert_eq!(all["c.d"].rate_hz(), None);
    }

    #[test]
    fn hexadecimal_digits_are_bytes_and_nothing_else_is() {
        assert_eq!(bytes_of("00ff7a"), Some(vec![0, 0xff, 0x7a]));
        assert_eq!(bytes_of("0"), None);
        assert_eq!(bytes_of("zz"), None);
    }

    #[test]
    fn rate_is_counted_in_module_time_and_gaps_in_messages() {
        let mut seen = Seen::default();
        for (sequence, ms) in [(1, 0), (2, 20), (5, 80), (1, 100)] {
            seen.add(&Observation { sequence, source_ns: ms * 1_000_000, ..Observation::default() });
        }
        assert_eq!((seen.messages, seen.lost, seen.least_ns, seen.most_ns), (4, 2, 20_000_000, 60_000_000));
        assert_eq!(seen.rate_hz(), Some(30.0));
    }
}
