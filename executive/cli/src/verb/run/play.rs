//! `bateleur run --play FILE`: takes out of a recording what comes into a module from outside, for the player that drives it.
//!
//! From outside come the ports that the plan leaves to the operator, the channels of other modules, which are the relay's here, and
//! what the partitions write in whose place the recording is to stand.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::os::fd::{AsFd, AsRawFd};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use bateleur_host::helper::playing::Head;
use bateleur_host::partition::message_name;
use bateleur_monitor::run_order::Play;
use bateleur_plan::{ModuleView, PartitionId, Plan, PortId, did_you_mean};
use bateleur_recording::{Entry, Layout, LogReader, topic};
use bateleur_system::handed_over;

use crate::plan_file;

/// A recording that a module is to be driven by.
#[derive(Debug, clap::Args)]
pub(super) struct Recorded {
    /// A recording drives the inputs of the module; `bateleur play` says so.
    #[arg(long, hide = true, value_name = "FILE", requires = "fast", conflicts_with_all = ["hosts", "together"])]
    play: Option<PathBuf>,
    /// The recording stands in the place of this partition too.
    #[arg(long, hide = true, value_name = "PARTITION", requires = "play")]
    in_place_of: Vec<String>,
}

/// The messages, and what the executive is told of them.
pub(super) struct Prepared {
    _messages: File,
    pub(super) play: Play,
}

impl Recorded {
    /// Whether there is one.
    pub(super) fn is_asked_for(&self) -> bool {
        self.play.is_some()
    }

    /// What is to be played; `None`: nothing. An error where the plan can not be read was printed.
    pub(super) fn prepare(
        &self,
        schedule: &Path,
        module: Option<&str>,
    ) -> Result<std::result::Result<Option<Prepared>, ()>> {
        let Some(log) = &self.play else { return Ok(Ok(None)) };
        let Some(plan) = plan_file::read_or_say(schedule)? else { return Ok(Err(())) };
        let view = module_of(&plan, module)?;
        let partitions = self.partitions(&view)?;
        let local = plan.local(view.id());
        let inputs = Inputs::of(&local, view.name(), &partitions)?;
        let (messages, count) = inputs.take(log).with_context(|| format!("{}", log.display()))?;
        let ports: Vec<String> = inputs.ports.iter().map(|&port| local.port_path(port)).collect();
        let s = if ports.len() == 1 { "" } else { "s" };
        eprintln!(
            "{}: {count} messages for {} port{s} of module {}: {}",
            log.display(),
            ports.len(),
            view.name(),
            ports.join(", ")
        );
        let names = partitions.iter().map(|&id| plan[id].name.clone()).collect();
        let messages_fd = messages.as_fd().as_raw_fd();
        Ok(Ok(Some(Prepared { _messages: messages, play: Play { messages_fd, partitions: names, ports } })))
    }

    /// The partitions that do not run: those that are named, and the relay.
    fn partitions(&self, view: &ModuleView<'_>) -> Result<Vec<PartitionId>> {
        let plan = view.plan();
        let mut found: Vec<PartitionId> = plan.relay_of(view.id()).into_iter().collect();
        for name in &self.in_place_of {
            let Some(id) = view.partitions().find(|&id| plan[id].name == *name) else {
                let known: Vec<&str> = view.partitions().map(|id| plan[id].name.as_str()).collect();
                bail!("module {} has no partition \"{name}\": {}", view.name(), did_you_mean(name, known));
            };
            found.push(id);
        }
        found.sort_unstable();
        found.dedup();
        Ok(found)
    }
}

fn module_of<'a>(plan: &'a Plan, name: Option<&str>) -> Result<ModuleView<'a>> {
    let names: Vec<&str> = plan.modules.iter().map(|module| module.name.as_str()).collect();
    let name = match (name, names.as_slice()) {
        (Some(name), _) => name,
        (None, [only]) => only,
        (None, _) => bail!("the plan has several modules: choose one with --module ({})", names.join(", ")),
    };
    plan.module(name)
        .with_context(|| format!("the plan has no module \"{name}\"; it has {}", names.join(", ")))
}

/// What comes into a module from outside, and what comes out of it.
struct Inputs<'a> {
    plan: &'a Plan,
    ports: Vec<PortId>,
    outputs: Vec<PortId>,
}

impl<'a> Inputs<'a> {
    fn of(plan: &'a Plan, module: &str, played: &[PartitionId]) -> Result<Self> {
        let view = plan.module(module).with_context(|| format!("the plan has no module \"{module}\""))?;
        let sources = view.channels().map(|id| plan[id].source);
        let (ports, outputs): (Vec<PortId>, Vec<PortId>) =
            sources.partition(|&id| plan[id].operator || played.contains(&plan[id].partition));
        ensure!(
            !ports.is_empty(),
            "nothing comes into module {module} from outside that a recording could drive: name a partition in whose place it is \
             to stand with --in-place-of PARTITION, or leave a port to the operator (operator = true)"
        );
        Ok(Self { plan, ports, outputs })
    }

    fn topic(&self, port: PortId) -> String {
        let path = self.plan.port_path(port);
        let (partition, name) = path.split_once('.').unwrap_or((&path, "port"));
        topic(partition, name)
    }

    /// Writes the messages of the inputs down for the player; gives how many they are.
    fn take(&self, log: &Path) -> Result<(File, u64)> {
        let mut wanted: BTreeMap<String, Wanted<'_>> = BTreeMap::new();
        for (&port, channel) in self.ports.iter().zip(0..) {
            let message = message_name(&self.plan[port]);
            let definition = self.plan.messages.get(&message).map_or("", String::as_str);
            let path = self.plan.port_path(port);
            wanted.insert(self.topic(port), Wanted { channel, path, message, definition, layout: None });
        }
        let mut file = handed_over::file("recorded messages").context("no memory for the messages")?;
        let mut output = BufWriter::new(&mut file);
        let (mut count, mut fault) = (0, None);
        let mut reader = LogReader::open(log)?;
        let ending = loop {
            let step = reader.step(&mut |entry| {
                let Some(wanted) = wanted.get_mut(entry.topic).filter(|_| fault.is_none()) else { return };
                match wanted.write(&entry, &mut output) {
                    Ok(()) => count += 1,
                    Err(error) => fault = Some(error),
                }
            })?;
            if let Some(fault) = fault {
                return Err(fault);
            }
            if let Some(ending) = step {
                break ending;
            }
        };
        if let Some(flaw) = ending.flaw() {
            eprintln!("{} {flaw}", log.display());
        }
        let recorded: Vec<&str> = reader.ports().map(|(topic, _, _)| topic).collect();
        let absent: Vec<&str> = wanted
            .iter()
            .filter(|(topic, _)| !recorded.contains(&topic.as_str()))
            .map(|(_, wanted)| wanted.path.as_str())
            .collect();
        ensure!(
            absent.is_empty(),
            "the recording has nothing of {}: it is of another plan, or the port carries plain bytes, which are not recorded",
            absent.join(", ")
        );
        ensure!(
            self.outputs.iter().any(|&port| recorded.contains(&self.topic(port).as_str())),
            "the recording has no port that the module writes itself: there is nothing to compare"
        );
        output.flush()?;
        drop(output);
        Ok((file, count))
    }
}

/// A port whose messages are looked for.
struct Wanted<'a> {
    channel: u32,
    path: String,
    message: String,
    definition: &'a str,
    /// Of the plan; read when the first message is met.
    layout: Option<Layout>,
}

impl Wanted<'_> {
    fn write(&mut self, entry: &Entry<'_>, output: &mut impl Write) -> Result<()> {
        if self.layout.is_none() {
            self.layout = Layout::parse(&self.message, self.definition);
            let same = self.message == entry.message && self.layout.as_ref() == entry.layout;
            ensure!(
                same && self.layout.is_some(),
                "{} is {} in the plan and {} with other fields in the recording",
                self.path,
                self.message,
                entry.message
            );
        }
        let size = self.layout.as_ref().map_or(0, Layout::size);
        if entry.bytes.len() != size {
            return Ok(()); // no message: nobody got it then
        }
        let head = Head {
            time_ns: entry.time_ns,
            sequence: entry.sequence.into(),
            channel: self.channel,
            length: u32::try_from(size)?,
        };
        output.write_all(&head.to_bytes())?;
        output.write_all(entry.bytes)?;
        Ok(())
    }
}
