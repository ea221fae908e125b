//! `bateleur ports pub PORT FIELD=VALUE …`: writes a message by the names of its fields into a port that the plan leaves to the
//! operator.

use std::io::{BufRead, BufReader, ErrorKind, Write};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail};
use bateleur_control::{Answer, ChannelStatus, Publication, Request};
use bateleur_messages::Type;
use bateleur_messages::format::{FieldKind, Leaf, Scalar};
use bateleur_plan::did_you_mean;

use super::target::{Target, channels};
use crate::hexadecimal::{bytes_of, digits_of};

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The port, PARTITION.PORT; either end of the channel.
    port: String,
    /// Fields by name: `height=12.5`, `mode=HOLD`, `points[2].x=1`, `gains=[1, 2, 3]`; what is left out is zero.
    #[arg(value_name = "FIELD=VALUE", conflicts_with = "bytes")]
    values: Vec<String>,
    /// The message as hexadecimal digits, for a port of plain bytes.
    #[arg(long, value_name = "DIGITS")]
    bytes: Option<String>,
    /// Write it so often a second, until Ctrl-C.
    #[arg(long, value_name = "HZ", value_parser = parse_rate)]
    rate: Option<f64>,
    /// End after so many messages; 1 without `--rate`.
    #[arg(long, value_name = "N")]
    count: Option<u64>,
    #[command(flatten)]
    target: Target,
}

fn parse_rate(text: &str) -> Result<f64, String> {
    let rate = text.parse::<f64>().ok().filter(|rate| (0.01..=1000.0).contains(rate));
    rate.ok_or_else(|| format!("\"{text}\" is not a number of messages a second from 0.01 to 1000"))
}

pub(super) fn run(arguments: &Arguments) -> Result<()> {
    let mut client = arguments.target.connect()?;
    let channels = channels(&mut client)?;
    let message = match channels.iter().find(|channel| has_port(channel, &arguments.port)) {
        Some(channel) => Some(message(channel, arguments)?),
        None => None, // the module says what there is
    };
    match client.ask(&Request::Publish { port: arguments.port.clone() })? {
        Answer::Publishing => {}
        other => bail!("the module's answer is not understood: {other:?}"),
    }
    let bytes = message.ok_or_else(|| anyhow!("no channel has a port {}", arguments.port))?;
    let line = serde_json::to_string(&Publication { bytes: digits_of(&bytes) })? + "\n";
    let mut publisher = client.into_lines();
    let last = arguments.count.or_else(|| arguments.rate.is_none().then_some(1));
    let (begun, mut sent) = (Instant::now(), 0);
    while last.is_none_or(|last| sent < last) {
        let receivers = publish(&mut publisher, line.as_bytes())?;
        sent += 1;
        if sent == 1 || last == Some(sent) {
            let s = if receivers == 1 { "" } else { "s" };
            println!("#{sent} of {} bytes into {}: {receivers} receiver{s}", bytes.len(), arguments.port);
        }
        if let Some(rate) = arguments.rate {
            let due = begun + Duration::from_secs_f64(sent as f64 / rate);
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
        }
    }
    Ok(())
}

/// Has one message written; how many took it.
fn publish(publisher: &mut BufReader<UnixStream>, line: &[u8]) -> Result<u64> {
    let mut answer = String::new();
    let read = publisher.get_mut().write_all(line).and_then(|()| publisher.read_line(&mut answer));
    match read {
        Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
            bail!("the publisher does not answer: the module is stopped, or hangs")
        }
        Ok(0) | Err(_) => bail!("the module, or its publisher, has ended"),
        Ok(_) => {}
    }
    match serde_json::from_str(&answer).context("the publisher's line is damaged")? {
        Answer::Published { receivers, .. } => Ok(receivers),
        Answer::Refused { why } => bail!(why),
        other => bail!("the publisher's answer is not understood: {other:?}"),
    }
}

fn has_port(channel: &ChannelStatus, port: &str) -> bool {
    channel.source == port || channel.destinations.iter().any(|destination| destination == port)
}

/// The bytes of the message that is asked for.
fn message(channel: &ChannelStatus, arguments: &Arguments) -> Result<Vec<u8>> {
    let of = Type::from_schema(&channel.message, &channel.definition);
    if let Some(digits) = &arguments.bytes {
        let bytes = bytes_of(digits).filter(|bytes| !bytes.is_empty());
        let bytes = bytes.context("--bytes takes pairs of hexadecimal digits")?;
        let lengths = of.map_or(1..=channel.size, |of| of.size()..=of.size());
        if !lengths.contains(&bytes.len()) {
            bail!("a message of {} has {} bytes, not {}", channel.source, channel.size, bytes.len());
        }
        return Ok(bytes);
    }
    let Ok(of) = of else {
        bail!("{} carries plain bytes, which have no fields: give them with --bytes", channel.source);
    };
    let mut bytes = vec![0; of.size()];
    for assignment in &arguments.values {
        let (path, value) = assignment.split_once('=').with_context(|| {
            format!("\"{assignment}\" is not FIELD=VALUE, such as {}=1", first_field(&of))
        })?;
        assign(&of, path.trim(), value.trim(), &mut bytes)?;
    }
    Ok(bytes)
}

fn first_field(of: &Type) -> &str {
    of.leaves().first().map_or("height", |leaf| leaf.path.as_str())
}

/// Writes one field, or all elements of an array.
fn assign(of: &Type, path: &str, value: &str, bytes: &mut [u8]) -> Result<()> {
    let Some(list) = value.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) else {
        let place = of.place(path)?;
        let leaf = of.leaves().iter().find(|leaf| covers(leaf, place.offset));
        return write(leaf, place.kind, path, value, &mut bytes[place.offset..]);
    };
    let leaf = of.leaves().iter().find(|leaf| leaf.path == path);
    let Some(count) = leaf.and_then(|leaf| leaf.count) else {
        of.place(path)?; // one that there is not is told first
        bail!("{path} is one value, not a list");
    };
    let values: Vec<&str> = list.split(',').map(str::trim).collect();
    if values.len() != count {
        bail!("{path} has {count} elements, and the list {}", values.len());
    }
    values
        .iter()
        .enumerate()
        .try_for_each(|(place, value)| assign(of, &format!("{path}[{place}]"), value, bytes))
}

fn covers(leaf: &Leaf, offset: usize) -> bool {
    (leaf.offset..leaf.offset + leaf.elements() * leaf.kind.size()).contains(&offset)
}

fn write(leaf: Option<&Leaf>, kind: FieldKind, path: &str, value: &str, bytes: &mut [u8]) -> Result<()> {
    let choices = leaf.map(|leaf| &*leaf.choices).unwrap_or_default();
    let named = choices.iter().find(|(name, _)| name.eq_ignore_ascii_case(value));
    let scalar = match (named, value) {
        (Some((_, number)), _) => Some(Scalar::Whole(*number)),
        (None, "true") => Some(Scalar::Bool(true)),
        (None, "false") => Some(Scalar::Bool(false)),
        (None, text) => {
            let whole = text.parse().ok().map(Scalar::Whole);
            whole.or_else(|| text.parse().ok().map(Scalar::Real))
        }
    };
    let Some(scalar) = scalar else {
        let names = choices.iter().map(|(name, _)| name.as_str());
        match choices {
            [] => bail!("{path}: \"{value}\" is no number"),
            _ => bail!("{path}: there is no value \"{value}\": {}", did_you_mean(value, names)),
        }
    };
    scalar.write(kind, bytes).with_context(|| match kind.range() {
        Some((lowest, highest)) => {
            format!("{path}: {value} is not a whole number from {lowest} to {highest}")
        }
        None => format!("{path}: {value} can not be written"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of() -> Type {
        let text = "uint8 MODE_OFF = 0\nuint8 MODE_HOLD = 3\nfloat32 height  # [m] Above the runway.\nint16[3] gains  # Gains.\n\
                    uint8 mode  # [@enum MODE] What it does.\nbool armed  # Whether.\n";
        Type::from_schema("Limit", text).unwrap()
    }

    fn made(values: &[&str]) -> Result<Vec<u8>, String> {
        let (of, mut bytes) = (of(), vec![0; of().size()]);
        for value in values {
            let (path, value) = value.split_once('=').unwrap();
            assign(&of, path, value, &mut bytes).map_err(|error| error.to_string())?;
        }
        Ok(bytes)
    }

    #[test]
    fn fields_are_written_by_name_and_read_back() {
        let bytes =
            made(&["mode=hold", "height=-12.5", "gains=[1, -2, 3]", "gains[1]=7", "armed=true"]).unwrap();
        let values = bateleur_recording::values(&of(), &bytes, bateleur_recording::word_of);
        let expected = serde_json::json!({ "mode": 3, "height": -12.5, "gains": [1, 7, 3], "armed": true });
        assert_eq!(serde_json::Value::from(values), expected);
    }

    #[test]
    fn what_a_field_can_not_hold_is_refused_by_name() {
        let refused = |value: &str| made(&[value]).unwrap_err();
        assert!(refused("hieght=1").contains("did you mean height?"));
        assert!(refused("mode=hodl").contains("HOLD"), "{}", refused("mode=hodl"));
        assert!(refused("mode=256").contains("from 0 to 255"));
        assert!(refused("gains=[1, 2]").contains("3 elements"));
        assert!(refused("gains=1").contains("gains[0]"));
        assert!(refused("gains[3]=1").contains("3 elements"));
        assert!(refused("height=[1]").contains("one value"));
        assert!(refused("height=high").contains("no number"));
        assert!(refused("armed=2").contains("from 0 to 1"));
    }
}
