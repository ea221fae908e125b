//! The player: the source of some channels of a module on the virtual clock. It writes what a recording has of them, each message with
//! its own time and number, when it is told that module time has come so far.

use std::collections::BTreeMap;
use std::io::{ErrorKind, Read, Write};
use std::ops::Range;
use std::os::unix::fs::FileExt;

use anyhow::{Context, Result, ensure};
use bateleur_channels::publish;
use bateleur_host::helper::orders::OrderedChannel;
use bateleur_host::helper::playing::{Head, NEVER, ORDER_BYTES, PlayerOrder};
use bateleur_ports::{Domain, Membership, Stamp, Writer};
use bateleur_system::handed_over::inherited;

/// The messages were handed over by the executive.
const MESSAGES: i32 = 3;

/// One channel that it writes into.
struct Source {
    writer: Writer,
    twin: Option<Writer>,
    _node: Option<Membership>,
    /// A message that was not taken was told.
    told: bool,
    name: String,
}

/// The messages of a group of channels, in the order of module time.
#[derive(Debug, Default)]
struct Group {
    messages: Vec<Message>,
    next: usize,
}

#[derive(Debug, Clone)]
struct Message {
    head: Head,
    bytes: Range<usize>,
}

pub(crate) fn run(order: &str) -> Result<()> {
    bateleur_host::helper::begin(c"player");
    let PlayerOrder { order, groups, from_ns } =
        serde_json::from_str(order).context("the player's order is damaged")?;
    let file = std::fs::File::from(inherited(MESSAGES).map_err(anyhow::Error::msg)?);
    let mut recorded = vec![0; usize::try_from(file.metadata()?.len())?];
    // Not from where another one has stopped to read.
    file.read_exact_at(&mut recorded, 0)?;
    let mut grouped = grouped(&recorded, &groups, &order.channels, from_ns)?;
    let domain = Domain { root: order.root.clone() };
    let mut sources = order
        .channels
        .iter()
        .map(|ordered| {
            let (writer, twin, _node) = publish(&domain, ordered, "player")?;
            Ok(Source { writer, twin, _node, told: false, name: ordered.source.clone() })
        })
        .collect::<Result<Vec<_>>>()?;
    let (mut orders, mut answers) = (std::io::stdin().lock(), std::io::stdout().lock());
    let mut answer = |next_ns: u64| {
        answers.write_all(&next_ns.to_le_bytes())?;
        answers.flush()
    };
    answer(0)?; // it is attached
    let mut words = [0; ORDER_BYTES];
    loop {
        match orders.read_exact(&mut words) {
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(()),
            read => read?,
        }
        let [a, b, c, d, instant @ ..] = words;
        let next_ns = match grouped.get_mut(&u32::from_le_bytes([a, b, c, d])) {
            None => NEVER,
            Some(group) => group.play(u64::from_le_bytes(instant), &recorded, &mut sources),
        };
        answer(next_ns)?;
    }
}

/// The messages by the groups of their channels.
fn grouped(
    recorded: &[u8],
    groups: &[u32],
    channels: &[OrderedChannel],
    from_ns: u64,
) -> Result<BTreeMap<u32, Group>> {
    let mut grouped: BTreeMap<u32, Group> = BTreeMap::new();
    let mut rest = recorded;
    while !rest.is_empty() {
        let (head, behind) = Head::split(rest).context("the recorded messages end within one")?;
        let (begin, length) = (recorded.len() - behind.len(), head.length as usize);
        ensure!(length <= behind.len(), "the recorded messages end within one");
        let place = head.channel as usize;
        let channel = channels.get(place).context("a recorded message is of no channel")?;
        ensure!((1..=channel.size).contains(&length), "a recorded message does not fit {}", channel.source);
        rest = &behind[length..];
        if let Some(group) = groups.get(place).filter(|_| head.time_ns >= from_ns) {
            let message = Message { head, bytes: begin..begin + length };
            grouped.entry(*group).or_default().messages.push(message);
        }
    }
    for group in grouped.values_mut() {
        group.messages.sort_by_key(|message| message.head.time_ns); // those of one time stay in their order
    }
    Ok(grouped)
}

impl Group {
    /// Writes what is before an instant; gives the time of the next message.
    fn play(&mut self, before_ns: u64, recorded: &[u8], sources: &mut [Source]) -> u64 {
        while let Some(message) =
            self.messages.get(self.next).filter(|message| message.head.time_ns < before_ns)
        {
            self.next += 1;
            let Some(source) = sources.get_mut(message.head.channel as usize) else { continue };
            source.write(&recorded[message.bytes.clone()], message.head);
        }
        self.messages.get(self.next).map_or(NEVER, |message| message.head.time_ns)
    }
}

impl Source {
    fn write(&mut self, bytes: &[u8], head: Head) {
        let stamp = Stamp { source_ns: head.time_ns, sequence: head.sequence };
        match self.writer.put(bytes, stamp) {
            Ok(_) => {
                if let Some(twin) = &self.twin {
                    let _ = twin.put(bytes, stamp); // an observer's loss is no fault
                }
            }
            // It is missing in the new recording, and so told with the comparison.
            Err(error) if !std::mem::replace(&mut self.told, true) => {
                eprintln!("player: {} #{}: {error}; the next such is not told", self.name, head.sequence);
            }
            Err(_) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn channel(size: usize) -> OrderedChannel {
        OrderedChannel {
            name: "a.out".into(),
            source: "a.out".into(),
            message: String::new(),
            size,
            depth: None,
            destinations: 1,
            spare_writers: 0,
            spare_readers: 0,
            sealed: None,
        }
    }

    fn written(messages: &[(u64, u32, &[u8])]) -> Vec<u8> {
        let one = |(time_ns, channel, bytes): &(u64, u32, &[u8])| {
            let head = Head { time_ns: *time_ns, sequence: 1, channel: *channel, length: bytes.len() as u32 };
            [&head.to_bytes()[..], bytes].concat()
        };
        messages.iter().flat_map(one).collect()
    }

    #[test]
    fn messages_are_sorted_by_time_and_those_before_the_start_are_left_out() {
        let recorded = written(&[(30, 0, b"c"), (10, 0, b"a"), (30, 1, b"d"), (20, 0, b"bb")]);
        let mut groups = grouped(&recorded, &[0, 0], &[channel(2), channel(2)], 15).unwrap();
        let texts: Vec<&[u8]> =
            groups[&0].messages.iter().map(|message| &recorded[message.bytes.clone()]).collect();
        assert_eq!(texts, [&b"bb"[..], b"c", b"d"]);
        let group = groups.get_mut(&0).unwrap();
        assert_eq!(group.play(20, &recorded, &mut []), 20, "the instant itself is not played");
        assert_eq!(group.play(21, &recorded, &mut []), 30);
        assert_eq!(group.play(31, &recorded, &mut []), NEVER);
    }

    #[test]
    fn messages_that_end_early_or_do_not_fit_their_channel_are_refused() {
        let whole = written(&[(1, 0, b"ab")]);
        let refused = |bytes: &[u8]| grouped(bytes, &[0], &[channel(1)], 0).unwrap_err().to_string();
        assert!(refused(&whole).contains("does not fit a.out"));
        assert!(refused(&whole[..whole.len() - 1]).contains("end within one"));
        assert!(refused(&whole[..5]).contains("end within one"));
        assert!(refused(&written(&[(1, 7, b"a")])).contains("of no channel"));
    }
}
