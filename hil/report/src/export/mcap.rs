//! The ports' log once more, with an index, in chunks, and with the health log beside it: what viewers like best.
//!
//! The recorder's own log is readable by the same viewers, but has no index: a recorder that is killed must not lose one.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use ::mcap::records::MessageHeader;
use ::mcap::{McapError, WriteOptions, Writer};
use serde_json::json;

use super::chrome::each_fault;
use super::{ExportError, Exported, check_folder};
use crate::health;
use bateleur_messages::format::schema_name;
use bateleur_recording::PORTS_FILE;
use bateleur_recording::{self as log, CDR_HEADER, Entry, LogError, MESSAGE_ENCODING, SCHEMA_ENCODING};

/// How messages are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Encoding {
    /// CDR with ROS 2 definitions, as in the recorder's log: small; Foxglove and ROS tools read it.
    #[default]
    Cdr,
    /// JSON with JSON schemas: large; every MCAP tool reads it.
    Json,
}

/// Bytes gathered before they become a chunk.
const CHUNK_BYTES: u64 = 1 << 20;
/// The health log's topic.
const HEALTH_TOPIC: &str = "/health";

/// Writes the ports and the health log of a run's `folder` to `path`.
pub fn mcap(folder: &Path, path: &Path, encoding: Encoding) -> Result<Exported, ExportError> {
    check_folder(folder)?;
    let source = folder.join(PORTS_FILE);
    let same = |a: &Path, b: &Path| a.canonicalize().is_ok_and(|a| b.canonicalize().is_ok_and(|b| a == b));
    if same(&source, path) {
        return Err(ExportError::OwnInput(path.to_path_buf()));
    }
    let mut output = Output::create(path, encoding)?;
    let mut exported = Exported::default();
    // Faults are few; they come first, so that the log is read once.
    match each_fault(folder, |entry| output.fault(&entry)) {
        Ok((_, broken)) => exported.note_broken(health::FILE, broken),
        Err(error) => exported.note(health::FILE, error),
    }
    match log::for_each(&source, |entry| output.message(&entry)) {
        Ok(ending) => exported.note_ending(&ending),
        Err(error) => exported.note(PORTS_FILE, error),
    }
    output.finish(path, &mut exported)?;
    exported.or_nothing()
}

struct Output {
    writer: Writer<BufWriter<File>>,
    encoding: Encoding,
    channels: HashMap<String, u16>,
    unreadable: BTreeMap<String, u64>,
    records: u64,
    error: Option<McapError>,
}

impl Output {
    fn create(path: &Path, encoding: Encoding) -> Result<Self, ExportError> {
        let wrong = |why| ExportError::Write { path: path.to_path_buf(), why };
        let file = File::create(path).map_err(wrong)?;
        let options = WriteOptions::new()
            .compression(None)
            .chunk_size(Some(CHUNK_BYTES))
            .library(concat!("bateleur ", env!("CARGO_PKG_VERSION")));
        let writer = options
            .create(BufWriter::new(file))
            .map_err(|why| LogError::Container { path: path.to_path_buf(), why })?;
        let (channels, unreadable) = (HashMap::new(), BTreeMap::new());
        Ok(Self { writer, encoding, channels, unreadable, records: 0, error: None })
    }

    fn message(&mut self, entry: &Entry<'_>) {
        let Some(layout) = entry.layout else { return self.refuse(entry.topic) };
        let name = schema_name(entry.message);
        let payload = match self.encoding {
            Encoding::Cdr if entry.bytes.len() == layout.size() => Some([&CDR_HEADER, entry.bytes].concat()),
            Encoding::Cdr => None,
            Encoding::Json => layout.json(entry.bytes).and_then(|json| serde_json::to_vec(&json).ok()),
        };
        let Some(payload) = payload else { return self.refuse(entry.topic) };
        let encoding = self.encoding;
        let schema = || match encoding {
            Encoding::Cdr => (SCHEMA_ENCODING, layout.definition()),
            Encoding::Json => ("jsonschema", layout.json_schema(&name).to_string()),
        };
        let kind = if encoding == Encoding::Cdr { MESSAGE_ENCODING } else { "json" };
        self.put(entry.topic, &name, kind, schema, entry.sequence, entry.time_ns, &payload);
    }

    fn fault(&mut self, entry: &health::HealthEntry) {
        let Ok(payload) = serde_json::to_vec(entry) else { return };
        let text = || json!({ "type": ["string", "null"] });
        let whole = || json!({ "type": ["integer", "null"] });
        let schema = || {
            let properties = json!({
                "time_ns": whole(), "partition": text(), "generation": whole(), "error": text(),
                "action": text(), "detail": text(), "recovered_ns": whole(),
            });
            (
                "jsonschema",
                json!({ "title": "health", "type": "object", "properties": properties }).to_string(),
            )
        };
        self.put(HEALTH_TOPIC, "bateleur/health", "json", schema, 0, entry.time_ns, &payload);
    }

    #[allow(clippy::too_many_arguments)] // the parts of one message
    fn put(
        &mut self,
        topic: &str,
        schema_name: &str,
        kind: &str,
        schema: impl Fn() -> (&'static str, String),
        sequence: u32,
        time_ns: u64,
        payload: &[u8],
    ) {
        if self.error.is_some() {
            return;
        }
        let written = self.channel(topic, schema_name, kind, schema).and_then(|channel_id| {
            let header = MessageHeader { channel_id, sequence, log_time: time_ns, publish_time: time_ns };
            self.writer.write_to_known_channel(&header, payload)
        });
        match written {
            Ok(()) => self.records += 1,
            Err(error) => self.error = Some(error),
        }
    }

    fn channel(
        &mut self,
        topic: &str,
        schema_name: &str,
        kind: &str,
        schema: impl Fn() -> (&'static str, String),
    ) -> Result<u16, McapError> {
        if let Some(id) = self.channels.get(topic) {
            return Ok(*id);
        }
        let (encoding, text) = schema();
        let schema = self.writer.add_schema(schema_name, encoding, text.as_bytes())?;
        let id = self.writer.add_channel(schema, topic, kind, &BTreeMap::new())?;
        self.channels.insert(topic.to_owned(), id);
        Ok(id)
    }

    fn refuse(&mut self, topic: &str) {
        *self.unreadable.entry(topic.to_owned()).or_default() += 1;
    }

    fn finish(mut self, path: &Path, exported: &mut Exported) -> Result<(), ExportError> {
        for (topic, count) in std::mem::take(&mut self.unreadable) {
            exported.note(&topic, format_args!("{count} messages do not fit what the log says of them"));
        }
        exported.records = self.records;
        let container = |why| LogError::Container { path: path.to_path_buf(), why };
        if let Some(error) = self.error {
            return Err(container(error).into());
        }
        self.writer.finish().map_err(container)?;
        Ok(())
    }
}
