//! How channels lie on shared-memory services: one definition for those who create, open and watch them.
//!
//! Responsible for: the iceoryx2 settings of a channel, the stamp on every message, and the three roles. The
//! *channel holder* creates every service before frame 0 and holds it; a *partition* only opens; an *observer* (recorder,
//! command line) reads without being able to slow a writer down. It must never create a service from a partition: a
//! killed creator would leave a name that nobody can use again.
//!
//! Every channel carries bytes, aligned for any message type; the message type's name and size are attributes of the
//! service, verified by whoever opens it. So the channel holder needs no message type to create a channel, and a partition
//! still can not open one with the wrong type.
//!
//! Every channel lies in a directory of its own, with everything that belongs to it: who can not reach the directory
//! can not reach the channel.

use std::path::PathBuf;
use std::time::Duration;

use iceoryx2::node::NodeCreationFailure;
use iceoryx2::port::BackpressureAction;
use iceoryx2::prelude::*;
use iceoryx2::service::attribute::{AttributeKey, AttributeSpecifier, AttributeValue, AttributeVerifier};
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;

mod ends;
mod rooted;
mod sealed;

pub use ends::{Reader, Received, Refusal, Unreceived, Writer};
use ends::{Reading, Writing};
pub use sealed::Handed;

/// The kind of service below every channel.
pub type Shared = rooted::Rooted;
/// A process' membership in the shared memory of one channel.
pub type Membership = Node<Shared>;
/// A channel that this process may attach to.
#[derive(Debug)]
pub enum Channel {
    /// One that was created or opened; holding it keeps it alive.
    Shared(PortFactory<Shared, [u8], Stamp>),
    /// One whose memory was handed over.
    Sealed(Handed),
}

/// Alignment of every message, bytes: enough for any plain message type.
pub const ALIGNMENT: usize = 16;
/// Prefix of every file in a channel's directory.
pub const PREFIX: &str = "bateleur_";
/// Observers that a channel admits beside its ports.
const OBSERVERS: usize = 4;
/// Messages that wait for an observer before the oldest is lost.
pub const OBSERVER_DEPTH: usize = 128;
/// How long a peer waits for a half-made resource. Bounds every wait inside a send or a receive; the default of one
/// second would cost a partition fifty windows.
const CREATION_TIMEOUT: Duration = Duration::from_millis(2);

/// Travels with every message.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ZeroCopySend)]
#[type_name("bateleur::Stamp")]
#[repr(C)]
pub struct Stamp {
    /// Module time at which the source wrote it, ns.
    pub source_ns: u64,
    /// Messages that this incarnation of the source had written, this one included.
    pub sequence: u64,
}

/// What a channel carries.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChannelType {
    /// The service's name.
    pub name: String,
    /// The message type's name.
    pub message: String,
    /// Bytes of a message; the most that one holds for a queue.
    pub size: usize,
    /// Queue length, or none for a sampling channel.
    pub depth: Option<usize>,
    /// Destination ports.
    pub destinations: usize,
    /// Sources beside the one of the plan: of a process that stands by, or of one that is dead and not yet cleared away.
    pub spare_writers: usize,
    /// Destinations beside those of the plan, as above.
    pub spare_readers: usize,
}

/// Why a channel could not be made, joined or opened.
#[derive(Debug, thiserror::Error)]
pub enum ChannelError {
    /// Its directory is not there, or is none.
    #[error("channel {0} has no directory")]
    Absent(String),
    /// The process can not join the channel's shared memory.
    #[error("cannot join the shared memory of channel {channel}: {reason:?}")]
    Join {
        /// The channel.
        channel: String,
        /// What the library said.
        reason: NodeCreationFailure,
    },
    /// The processes that are attached to the channel can not be listed.
    #[error("cannot list who is attached to channel {channel}: {reason}")]
    List {
        /// The channel.
        channel: String,
        /// What the library said.
        reason: String,
    },
    /// A name that the library refuses.
    #[error("\"{0}\" can not be the name of a shared-memory service")]
    Name(String),
    /// The service could not be created.
    #[error("cannot create channel {channel}: {reason}")]
    Create {
        /// The channel's service.
        channel: String,
        /// What the library said.
        reason: String,
    },
    /// The service could not be opened, or is of another type.
    #[error("cannot open channel {channel} for message {message}: {reason}")]
    Open {
        /// The channel's service.
        channel: String,
        /// The message type that was expected.
        message: String,
        /// What the library said.
        reason: String,
    },
    /// The port could not be made.
    #[error("cannot attach to channel {channel}: {reason}")]
    Attach {
        /// The channel's service.
        channel: String,
        /// What the library said.
        reason: String,
    },
}

/// Where a module's shared memory lies: nothing of two modules, or of two runs, can meet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Domain {
    /// Directory on a tmpfs. Each channel has a directory in it.
    pub root: String,
}

impl Domain {
    /// The directory of a channel, given one of its services (see [`ChannelType::home`]).
    #[must_use]
    pub fn directory(&self, home: &str) -> PathBuf {
        std::path::Path::new(&self.root).join(home)
    }

    /// Joins the channel whose directory is `home`, as `name`. Nobody cleans up by himself: after a death only the
    /// channel cleaner does.
    pub fn join(&self, home: &str, name: &str) -> Result<Membership, ChannelError> {
        set_log_level(LogLevel::Fatal);
        let node_name = name.try_into().map_err(|_| ChannelError::Name(name.into()))?;
        NodeBuilder::new()
            .name(&node_name)
            .config(&self.config(home)?)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Shared>()
            .map_err(|reason| ChannelError::Join { channel: home.into(), reason })
    }

    /// Removes what dead processes left in the channel whose directory is `home`. Joins nothing for it, which would cost as
    /// much as the clearing. Gives the number of those whose remains could not be removed.
    pub fn clear_dead(&self, home: &str) -> Result<usize, ChannelError> {
        set_log_level(LogLevel::Fatal);
        let mut left = 0;
        let clear = |found: NodeState<Shared>| {
            if let NodeState::Dead(dead) = found
                && dead.try_remove_stale_resources().is_err()
            {
                left += 1;
            }
            CallbackProgression::Continue
        };
        Membership::list(&self.config(home)?, clear)
            .map_err(|reason| ChannelError::List { channel: home.into(), reason: format!("{reason:?}") })?;
        Ok(left)
    }

    fn config(&self, home: &str) -> Result<Config, ChannelError> {
        let directory = self.directory(home).to_string_lossy().into_owned();
        let mut config = Config::default();
        let root = Path::new(directory.as_bytes()).map_err(|_| ChannelError::Name(directory.clone()))?;
        config.global.set_root_path(&root);
        config.global.prefix =
            FileName::new(PREFIX.as_bytes()).map_err(|_| ChannelError::Name(PREFIX.into()))?;
        config.global.creation_timeout = CREATION_TIMEOUT;
        config.global.node.cleanup_dead_nodes_on_creation = false;
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        config.global.service.cleanup_dead_nodes_on_open = false;
        config.defaults.publish_subscribe.subscriber_expired_connection_buffer = 4;
        Ok(config)
    }
}

impl ChannelType {
    /// Creates the channel (the channel holder, once, before frame 0).
    pub fn create(&self, node: &Membership) -> Result<Channel, ChannelError> {
        let failed = |reason: String| ChannelError::Create { channel: self.name.clone(), reason };
        let builder = self.builder(node)?;
        let attributes = AttributeSpecifier::new()
            .define(&attribute_key()?, &self.attribute()?)
            .map_err(|error| failed(format!("{error:?}")))?;
        let readers = self.destinations + self.spare_readers + OBSERVERS;
        let writers = 1 + self.spare_writers;
        let builder = match self.depth {
            None => builder
                .enable_safe_overflow(true)
                .history_size(1)
                .subscriber_max_buffer_size(OBSERVER_DEPTH)
                .subscriber_max_borrowed_samples(2),
            Some(depth) => builder
                .enable_safe_overflow(false)
                .history_size(0)
                .subscriber_max_buffer_size(depth)
                .subscriber_max_borrowed_samples(1),
        };
        builder
            .max_publishers(writers)
            .max_subscribers(readers)
            .max_nodes(readers + writers + 2) // the channel holder and a channel cleaner
            .create_with_attributes(&attributes)
            .map(Channel::Shared)
            .map_err(|error| failed(format!("{error:?}")))
    }

    /// Opens the channel; fails where it is absent or of another message type.
    pub fn open(&self, node: &Membership) -> Result<Channel, ChannelError> {
        let failed = |reason: String| ChannelError::Open {
            channel: self.name.clone(),
            message: self.message.clone(),
            reason,
        };
        let verifier = AttributeVerifier::new()
            .require(&attribute_key()?, &self.attribute()?)
            .map_err(|error| failed(format!("{error:?}")))?;
        let opened = self.builder(node)?.open_with_attributes(&verifier);
        opened.map(Channel::Shared).map_err(|error| failed(format!("{error:?}")))
    }

    /// The writing end.
    pub fn writer(&self, channel: &Channel) -> Result<Writer, ChannelError> {
        let service = match channel {
            Channel::Shared(service) => service,
            Channel::Sealed(handed) => return Ok(Writer(Writing::Sealed(handed.writer(self)?))),
        };
        service
            .publisher_builder()
            .initial_max_slice_len(self.size)
            .max_loaned_samples(1)
            // The library's default retries for ever, which would hang a writer on a frozen or dead reader.
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .set_backpressure_handler(|_| BackpressureAction::DiscardDataAndFail)
            .create()
            .map(|publisher| Writer(Writing::Shared(publisher)))
            .map_err(|error| self.attach_failed(format!("{error:?}")))
    }

    /// The reading end of a destination port.
    pub fn reader(&self, channel: &Channel) -> Result<Reader, ChannelError> {
        match channel {
            Channel::Shared(service) => self.reader_with(service, self.depth.unwrap_or(1)),
            Channel::Sealed(handed) => Ok(Reader(Reading::Sealed(handed.reader(self)?))),
        }
    }

    /// A reading end that keeps more of a sampling channel, for an observer.
    pub fn observer(&self, channel: &Channel) -> Result<Reader, ChannelError> {
        match channel {
            Channel::Shared(service) => self.reader_with(service, OBSERVER_DEPTH),
            Channel::Sealed(handed) => Ok(Reader(Reading::Sealed(handed.observer(self)?))),
        }
    }

    fn reader_with(
        &self,
        service: &PortFactory<Shared, [u8], Stamp>,
        buffer: usize,
    ) -> Result<Reader, ChannelError> {
        service
            .subscriber_builder()
            .buffer_size(buffer)
            .create()
            .map(|subscriber| Reader(Reading::Shared(subscriber)))
            .map_err(|error| self.attach_failed(format!("{error:?}")))
    }

    fn attach_failed(&self, reason: String) -> ChannelError {
        ChannelError::Attach { channel: self.name.clone(), reason }
    }

    fn builder(
        &self,
        node: &Membership,
    ) -> Result<iceoryx2::service::builder::publish_subscribe::Builder<[u8], Stamp, Shared>, ChannelError>
    {
        let name = self.name.as_str().try_into().map_err(|_| ChannelError::Name(self.name.clone()))?;
        let alignment = Alignment::new(ALIGNMENT).ok_or_else(|| ChannelError::Name(self.name.clone()))?;
        Ok(node
            .service_builder(&name)
            .publish_subscribe::<[u8]>()
            .user_header::<Stamp>()
            .payload_alignment(alignment))
    }

    fn attribute(&self) -> Result<AttributeValue, ChannelError> {
        let text = format!("{}/{}", self.message, self.size);
        text.as_str().try_into().map_err(|_| ChannelError::Name(text.clone()))
    }

    /// The sampling channel on which observers see what a queue carries: a queue itself has one destination, and an
    /// observer that reads too slowly must not make it full.
    pub fn observed(&self) -> Self {
        Self {
            name: format!("{}{OBSERVED}", self.name),
            depth: None,
            destinations: 0,
            spare_readers: 0,
            ..self.clone()
        }
    }

    /// The channel whose directory holds this service: a queue's twin for observers lies beside it.
    #[must_use]
    pub fn home(&self) -> &str {
        self.name.strip_suffix(OBSERVED).unwrap_or(&self.name)
    }
}

/// What the name of a queue's twin ends with. A port's name holds no dot.
const OBSERVED: &str = ".observed";

fn attribute_key() -> Result<AttributeKey, ChannelError> {
    "message".try_into().map_err(|_| ChannelError::Name("message".into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn domain(directory: &tempfile::TempDir) -> Domain {
        Domain { root: directory.path().to_string_lossy().into_owned() }
    }

    fn sampling(message: &str) -> ChannelType {
        ChannelType {
            name: "imu.rates".into(),
            message: message.into(),
            size: 24,
            depth: None,
            destinations: 1,
            spare_writers: 0,
            spare_readers: 0,
        }
    }

    #[test]
    fn a_channel_of_another_message_type_is_refused() {
        let directory = tempfile::tempdir().unwrap();
        let node = domain(&directory).join("imu.rates", "test").unwrap();
        let held = sampling("Rates").create(&node).unwrap();
        assert!(sampling("Rates").open(&node).is_ok());
        let error = sampling("Pressure").open(&node).unwrap_err();
        assert!(error.to_string().contains("for message Pressure"), "{error}");
        drop((held, node));
    }

    #[test]
    fn payloads_are_aligned_for_any_message() {
        let directory = tempfile::tempdir().unwrap();
        let node = domain(&directory).join("imu.rates", "test").unwrap();
        let kind = sampling("Rates");
        let channel = kind.create(&node).unwrap();
        let (writer, reader) = (kind.writer(&channel).unwrap(), kind.reader(&channel).unwrap());
        for _ in 0..3 {
            writer.put(&[7; 24], Stamp::default()).unwrap();
            let sample = reader.receive().unwrap().unwrap();
            assert_eq!(sample.payload().as_ptr() as usize % ALIGNMENT, 0);
        }
    }

    /// Names in a directory of the machine's shared memory that carry this crate's prefix.
    fn machine_wide() -> Vec<std::ffi::OsString> {
        let entries = std::fs::read_dir("/dev/shm").into_iter().flatten().flatten();
        let names = entries.map(|entry| entry.file_name());
        names.filter(|name| name.to_string_lossy().starts_with(PREFIX)).collect()
    }

    #[test]
    fn everything_of_a_channel_lies_in_its_directory() {
        let directory = tempfile::tempdir().unwrap();
        let domain = domain(&directory);
        let node = domain.join("imu.rates", "test").unwrap();
        let kind = ChannelType { depth: Some(4), ..sampling("Rates") };
        let (queue, twin) = (kind.create(&node).unwrap(), kind.observed().create(&node).unwrap());
        let (writer, reader) = (kind.writer(&queue).unwrap(), kind.reader(&queue).unwrap());
        writer.put(&[7; 24], Stamp::default()).unwrap();
        assert!(reader.receive().unwrap().is_some());
        assert_eq!(machine_wide(), Vec::<std::ffi::OsString>::new());
        assert_eq!(kind.observed().home(), kind.home());
        let beside: Vec<_> = std::fs::read_dir(directory.path()).unwrap().flatten().collect();
        assert_eq!(beside.len(), 1, "{beside:?}");
        drop((twin, writer, reader));
    }

    #[test]
    fn a_channel_admits_a_second_writer_only_where_it_was_made_for_one() {
        let directory = tempfile::tempdir().unwrap();
        let node = domain(&directory).join("imu.rates", "test").unwrap();
        for (spare_writers, expected) in [(0, 1), (2, 3)] {
            let name = format!("imu.rates{spare_writers}");
            let kind = ChannelType { name, spare_writers, ..sampling("Rates") };
            let channel = kind.create(&node).unwrap();
            let writers: Vec<_> = (0..4).filter_map(|_| kind.writer(&channel).ok()).collect();
            assert_eq!(writers.len(), expected);
        }
    }

    #[test]
    fn a_channel_admits_spare_readers_beside_its_observers() {
        let directory = tempfile::tempdir().unwrap();
        let node = domain(&directory).join("imu.rates", "test").unwrap();
        let kind = ChannelType { spare_readers: 2, ..sampling("Rates") };
        let channel = kind.create(&node).unwrap();
        let readers: Vec<_> = (0..20).filter_map(|_| kind.reader(&channel).ok()).collect();
        assert_eq!(readers.len(), 1 + 2 + OBSERVERS);
    }
}
