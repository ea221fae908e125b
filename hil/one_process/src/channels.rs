//! The channels of a plan in this process' memory, and the log of what they carry.

use std::collections::BTreeMap;
use std::path::Path;

use bateleur_host::partition::message_name;
use bateleur_messages::Type;
use bateleur_plan::ModuleView;
use bateleur_ports::{Channel, ChannelType, Handed, Reader};
use bateleur_recording::{ChannelId, PORTS_FILE, PortLog, topic};

use crate::Error;

/// Messages of a channel that are read at once, most; a ring keeps no more for those who only look.
const AT_ONCE: usize = 128;

/// The memory of every channel, by its name.
pub(crate) type Channels = BTreeMap<String, Handed>;

/// Makes the channels of a module.
pub(crate) fn make(view: ModuleView<'_>) -> Result<Channels, Error> {
    let plan = view.plan();
    let one = |id| {
        let kind = kind_of(view, id);
        let memory = Handed::alone(&kind, false).map_err(|error| Error::Channel(error.to_string()))?;
        Ok((plan.port_path(plan[id].source), memory))
    };
    view.channels().map(one).collect()
}

fn kind_of(view: ModuleView<'_>, id: bateleur_plan::ChannelId) -> ChannelType {
    let plan = view.plan();
    let channel = &plan[id];
    ChannelType {
        name: plan.port_path(channel.source),
        message: message_name(&plan[channel.source]),
        size: plan[channel.source].payload.max_size_bytes(),
        depth: plan.queue_depth(channel).map(|depth| depth as usize),
        destinations: channel.destinations.len(),
        spare_writers: 0,
        spare_readers: 0,
    }
}

/// Writes what the channels carry into `ports.mcap`, as a recorder does.
pub(crate) struct Recorder {
    log: PortLog,
    observed: Vec<(ChannelId, Reader)>,
}

impl Recorder {
    pub(crate) fn begin(folder: &Path, view: ModuleView<'_>, channels: &Channels) -> Result<Self, Error> {
        let wrong = |error: bateleur_recording::LogError| Error::Log(error.to_string());
        let mut log = PortLog::create(folder.join(PORTS_FILE)).map_err(wrong)?;
        let (plan, mut observed) = (view.plan(), Vec::new());
        for id in view.channels() {
            let kind = kind_of(view, id);
            let (Some(definition), Some(memory)) =
                (plan.messages.get(&kind.message), channels.get(&kind.name))
            else {
                continue; // bytes without fields to name
            };
            let refused = |error: &dyn std::fmt::Display| Error::Channel(format!("{}: {error}", kind.name));
            let message = Type::from_schema(&kind.message, definition).map_err(|error| refused(&error))?;
            let (partition, port) = kind.name.split_once('.').unwrap_or((&kind.name, "port"));
            let logged = log.add_channel(&topic(partition, port), &message).map_err(wrong)?;
            let end = Channel::Sealed(memory.again(0).map_err(|error| refused(&error))?);
            observed.push((logged, kind.observer(&end).map_err(|error| refused(&error))?));
        }
        Ok(Self { log, observed })
    }

    /// Reads what has been written since the last time.
    pub(crate) fn turn(&mut self) -> Result<(), Error> {
        for (logged, reader) in &self.observed {
            for _ in 0..AT_ONCE {
                let Ok(Some(message)) = reader.receive() else { break };
                let stamp = message.stamp();
                let written = self.log.write(*logged, stamp.sequence, stamp.source_ns, message.payload());
                written.map_err(|error| Error::Log(error.to_string()))?;
            }
        }
        Ok(())
    }

    pub(crate) fn finish(mut self) -> Result<(), Error> {
        self.turn()?;
        self.log.finish().map_err(|error| Error::Log(error.to_string()))
    }
}
