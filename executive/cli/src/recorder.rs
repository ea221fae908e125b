//! The recorder: attaches to every channel of a module as an observer and writes what it carries into `ports.mcap`, or
//! into the next part of it where the recorder before has ended.
//!
//! It is told when to read (a byte on standard input) and says when it has (a byte on standard output), so that under
//! the virtual clock nothing is lost, however fast time goes. It can not slow a writer down. What it reads may be damaged and
//! end it: so it says in shared memory which channel it is at.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::sync::atomic::AtomicU32;
use std::sync::atomic::Ordering::Relaxed;

use anyhow::{Context, Result};
use bateleur_channels::observe;
use bateleur_contract::Mapped;
use bateleur_host::helper::orders::OrderedChannel;
use bateleur_host::helper::recording::{ATTACH_ANEW, DONE, LEFT_OUT, NO_ROOM, READ, RecorderOrder};
use bateleur_messages::Type;
use bateleur_ports::{Channel, Domain, Membership, OBSERVER_DEPTH, Reader};
use bateleur_recording::{ChannelId, LogError, PortLog, topic};

struct Observed {
    log: ChannelId,
    ordered: OrderedChannel,
    /// Its place in the order.
    place: usize,
    /// `None`: it is kept off until the channel is made anew.
    end: Option<End>,
    /// It was told that something was no message.
    told: bool,
}

/// Its end of a channel.
struct End {
    reader: Reader,
    _channel: Channel,
    _node: Option<Membership>,
}

/// The log was opened by the executive, whose output folder the recorder's user may not enter.
const LOG: &str = "/proc/self/fd/3";
/// The texts of the message types, by their names.
const TYPES: &str = "/proc/self/fd/5";
/// Where it says what it is at.
const PLACE: &str = "/proc/self/fd/4";

pub(crate) fn run(order: &str) -> Result<()> {
    bateleur_host::helper::begin(c"recorder");
    let RecorderOrder { order, without, part } =
        serde_json::from_str(order).context("the recorder's order is damaged")?;
    let place = File::options().read(true).write(true).open(PLACE).context("nobody knows what it is at")?;
    let types = File::open(TYPES)
        .map_err(anyhow::Error::from)
        .and_then(|file| Ok(serde_json::from_reader(BufReader::new(file))?));
    let mut recorder = Recorder {
        types: types.context("the message types are not known")?,
        domain: Domain { root: order.root.clone() },
        log: PortLog::create(LOG)?,
        observed: Vec::new(),
        at: Mapped::new(place).context("nobody knows what it is at")?,
    };
    if let Err(error) = recorder.serve(order.channels, &without, part == 0) {
        // Without its end the log says of itself that it was cut short.
        let _ = recorder.log.flush();
        std::mem::forget(recorder.log);
        drop(recorder.observed);
        if error.downcast_ref().is_some_and(LogError::is_full) {
            eprintln!("recorder: {error:#}");
            std::process::exit(NO_ROOM);
        }
        return Err(error);
    }
    recorder.log.finish()?;
    Ok(())
}

fn answer(word: char) -> std::io::Result<()> {
    let mut output = std::io::stdout().lock();
    output.write_all(&[word as u8])?;
    output.flush()
}

struct Recorder {
    /// The texts of the message types, by their names.
    types: BTreeMap<String, String>,
    domain: Domain,
    log: PortLog,
    observed: Vec<Observed>,
    /// The place of the channel that it is at, plus one; 0: none.
    at: Mapped<AtomicU32>,
}

impl Recorder {
    /// Does what it is ordered to, until nobody orders any more.
    fn serve(&mut self, channels: Vec<OrderedChannel>, without: &[String], strictly: bool) -> Result<()> {
        self.attach(channels, without, strictly)?;
        answer(DONE)?;
        let mut orders = std::io::stdin().lock();
        let mut word = [0; 1];
        while orders.read(&mut word)? == 1 {
            let left_out = match char::from(word[0]) {
                READ => self.read_all()?,
                ATTACH_ANEW => {
                    let mut names = String::new();
                    orders.read_line(&mut names)?;
                    self.attach_anew(&names);
                    false
                }
                other => anyhow::bail!("the executive has ordered {other:?}"),
            };
            answer(if left_out { LEFT_OUT } else { DONE })?;
        }
        Ok(())
    }

    /// Attaches to every channel but those `without`. `strictly`: one that it can not attach to is an error; a later recorder
    /// keeps off it.
    fn attach(&mut self, channels: Vec<OrderedChannel>, without: &[String], strictly: bool) -> Result<()> {
        for (place, ordered) in channels.into_iter().enumerate() {
            self.at.store(place as u32 + 1, Relaxed);
            let end = match without.contains(&ordered.name) {
                true => None,
                false => match End::of(&self.domain, &ordered) {
                    Ok(end) => Some(end),
                    Err(error) if strictly => return Err(error),
                    Err(error) => {
                        eprintln!("recorder: nothing of {} from now on: {error:#}", ordered.name);
                        None
                    }
                },
            };
            // Bytes without a message type have no fields to name: they are left out.
            let Some(definition) = self.types.get(&ordered.message) else { continue };
            let message = Type::from_schema(&ordered.message, definition)?;
            let (partition, port) = ordered.source.split_once('.').unwrap_or((&ordered.source, "port"));
            let log = self.log.add_channel(&topic(partition, port), &message)?;
            self.observed.push(Observed { log, ordered, place, end, told: false });
        }
        self.at.store(0, Relaxed);
        Ok(())
    }

    /// Channels that were damaged have been made anew: what it still maps of the old ones is not looked at any more.
    fn attach_anew(&mut self, names: &str) {
        let renewed: Vec<&str> = names.split_whitespace().collect();
        for one in self.observed.iter_mut().filter(|one| renewed.contains(&one.ordered.name.as_str())) {
            self.at.store(one.place as u32 + 1, Relaxed);
            std::mem::forget(one.end.take()); // letting go of it would look into damaged memory
            match End::of(&self.domain, &one.ordered) {
                Ok(end) => one.end = Some(end),
                Err(error) => {
                    eprintln!("recorder: nothing of {} from now on: {error:#}", one.ordered.name);
                }
            }
        }
        self.at.store(0, Relaxed);
    }

    /// Reads what has been written; true: for the first time something of a channel is no message of its type, and was left out.
    fn read_all(&mut self) -> Result<bool> {
        let mut left_out = false;
        for one in &mut self.observed {
            let Some(end) = &one.end else { continue };
            self.at.store(one.place as u32 + 1, Relaxed);
            // A reader that fails once has met a dying writer; what the writer sent before is still there next time.
            // And one that writes without end must not keep it from the others.
            for _ in 0..=OBSERVER_DEPTH {
                let Ok(Some(sample)) = end.reader.receive() else { break };
                let stamp = sample.stamp();
                match self.log.write(one.log, stamp.sequence, stamp.source_ns, sample.payload()) {
                    Err(wrong @ LogError::Size { .. }) => {
                        if !std::mem::replace(&mut one.told, true) {
                            left_out = true;
                            eprintln!("recorder: {wrong}: it is left out, as all such that follow");
                        }
                    }
                    written => written?,
                }
            }
        }
        self.at.store(0, Relaxed);
        Ok(left_out)
    }
}

impl End {
    fn of(domain: &Domain, ordered: &OrderedChannel) -> Result<Self> {
        let (reader, channel, node) = observe(domain, ordered, "recorder")?;
        Ok(Self { reader, _channel: channel, _node: node })
    }
}
