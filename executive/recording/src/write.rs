//! Writing the log while the module runs.

use super::{CDR_HEADER, LogError, MESSAGE_ENCODING, SCHEMA_ENCODING};
use bateleur_messages::Type;
use bateleur_messages::format::schema_name;
use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions, Writer};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

/// Module time after which what was logged goes to the file, ns. A recorder that is killed loses at most this much; much
/// less would make many small chunks, which readers seek in slowly.
const FLUSH_AFTER_NS: u64 = 500_000_000;
/// Bytes after which it goes to the file anyway: bounds the memory that the log takes.
const FLUSH_AFTER_BYTES: usize = 1 << 20;

/// A channel of a log that is being written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ChannelId(usize);

/// The topic of a source port.
pub fn topic(partition: &str, port: &str) -> String {
    format!("/{partition}/{port}")
}

/// A log that is being written.
///
/// Messages are gathered in memory and written as whole chunks, so that a file that ends anywhere can be read up
/// to its last whole record. Dropping it finishes the file as [`PortLog::finish`] does, without telling of errors.
pub struct PortLog {
    path: PathBuf,
    writer: Writer<BufWriter<File>>,
    channels: Vec<Channel>,
    payload: Vec<u8>,
    unwritten_bytes: usize,
    unwritten_since_ns: Option<u64>,
}

struct Channel {
    id: u16,
    topic: String,
    message: String,
    size: usize,
}

impl PortLog {
    /// Creates the file; an older one is overwritten.
    pub fn create(path: impl AsRef<Path>) -> Result<Self, LogError> {
        let path = path.as_ref().to_path_buf();
        let file = File::create(&path).map_err(|why| LogError::File { path: path.clone(), why })?;
        let options = WriteOptions::new()
            .compression(None)
            .chunk_size(None)
            .disable_seeking(true)
            .library(concat!("bateleur ", env!("CARGO_PKG_VERSION")));
        let writer = options
            .create(BufWriter::new(file))
            .map_err(|why| LogError::Container { path: path.clone(), why })?;
        let payload = Vec::with_capacity(512);
        Ok(Self { path, writer, channels: Vec::new(), payload, unwritten_bytes: 0, unwritten_since_ns: None })
    }

    /// Adds the channel of one source port; see [`topic`].
    pub fn add_channel(&mut self, topic: &str, message: &Type) -> Result<ChannelId, LogError> {
        let schema_name = schema_name(message.name());
        let schema = message.schema();
        let id = self
            .writer
            .add_schema(&schema_name, SCHEMA_ENCODING, schema.as_bytes())
            .and_then(|schema| self.writer.add_channel(schema, topic, MESSAGE_ENCODING, &BTreeMap::new()))
            .map_err(|why| self.container(why))?;
        let (topic, name) = (topic.to_owned(), message.name().to_owned());
        self.channels.push(Channel { id, topic, message: name, size: message.size() });
        Ok(ChannelId(self.channels.len() - 1))
    }

    /// Logs one message as it lay in the port. `time_ns` is the source's module time, ns; the container counts
    /// sequences in 32 bits, so longer ones wrap.
    pub fn write(
        &mut self,
        channel: ChannelId,
        sequence: u64,
        time_ns: u64,
        bytes: &[u8],
    ) -> Result<(), LogError> {
        let known = self.channels.get(channel.0).ok_or(LogError::UnknownChannel(channel.0))?;
        if bytes.len() != known.size {
            return Err(LogError::Size {
                topic: known.topic.clone(),
                message: known.message.clone(),
                found: bytes.len(),
                expected: known.size,
            });
        }
        let header = MessageHeader {
            channel_id: known.id,
            sequence: sequence as u32,
            log_time: time_ns,
            publish_time: time_ns,
        };
        self.payload.clear();
        self.payload.extend_from_slice(&CDR_HEADER);
        self.payload.extend_from_slice(bytes);
        self.writer
            .write_to_known_channel(&header, &self.payload)
            .map_err(|why| LogError::Container { path: self.path.clone(), why })?;
        self.flush_when_due(time_ns)
    }

    fn flush_when_due(&mut self, time_ns: u64) -> Result<(), LogError> {
        self.unwritten_bytes += self.payload.len();
        let since = *self.unwritten_since_ns.get_or_insert(time_ns);
        let old = time_ns.saturating_sub(since) >= FLUSH_AFTER_NS;
        if old || self.unwritten_bytes >= FLUSH_AFTER_BYTES { self.flush() } else { Ok(()) }
    }

    /// Hands everything logged so far to the operating system, from where it survives the death of this process.
    pub fn flush(&mut self) -> Result<(), LogError> {
        (self.unwritten_bytes, self.unwritten_since_ns) = (0, None);
        self.writer.flush().map_err(|why| self.container(why))
    }

    /// Writes index and summary and ends the file.
    pub fn finish(mut self) -> Result<(), LogError> {
        self.writer.finish().map(|_| ()).map_err(|why| self.container(why))
    }

    fn container(&self, why: McapError) -> LogError {
        LogError::Container { path: self.path.clone(), why }
    }
}
