//! From the module to Foxglove: one thread for the messages, one for the health log and the figures, and the SDK's own for the clients.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use bateleur_control::{ChannelStatus, Client, Observation, Status};
use bateleur_executive_cli::{Target, Watch, bytes_of, channels, stand_aside, status};
use bateleur_messages::Type;
use bateleur_messages::format::schema_name;
use bateleur_recording::{CDR_HEADER, MESSAGE_ENCODING, SCHEMA_ENCODING, Tail, topic};
use foxglove::websocket::{Capability, ChannelView, Client as Viewer, ServerListener};
use foxglove::{ChannelBuilder, Context, PartialMetadata, RawChannel, Schema, SinkId, WebSocketServerHandle};
use serde_json::{Value, json};

use crate::json::schema_of;

/// Messages that wait for a client; it loses the oldest beyond them. Half a minute of all ports of the delivered flight.
const BACKLOG: usize = 1 << 14;
/// Between two looks at the health log, and two broadcasts of module time.
const LOOK: Duration = Duration::from_millis(50);
/// Between two questions for the figures.
const ASK: Duration = Duration::from_millis(500);
/// Entries of the health log that are kept for who comes later.
const MOST_ENTRIES: usize = 1024;
/// The topic of the health log.
const HEALTH_TOPIC: &str = "/health";
/// The health log in a run's folder.
const HEALTH_FILE: &str = "health.jsonl";

/// Serves the module until it ends or a signal comes.
pub(crate) fn run(target: &Target, listen: SocketAddr) -> Result<()> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register(signal, stop.clone()).context("cannot watch for signals")?;
    }
    let running = target.choose()?;
    stand_aside(&running.cores);
    let mut client = Client::connect(&running)?;
    let (channels, first) = (channels(&mut client)?, status(&mut client)?);
    let context = Context::new();
    let ports = channels.iter().map(|channel| Ok((channel.source.clone(), Port::of(&context, channel)?)));
    let ports: BTreeMap<String, Port> = ports.collect::<Result<_>>()?;
    let mut figures = Figures::of(&context, client, &first)?;
    let watch = Watch::start(Client::connect(&running)?, &[])?;
    let server = context
        .websocket_server()
        .name(format!("bateleur {}", first.module))
        .bind(listen.ip().to_string(), listen.port())
        .capabilities([Capability::Time])
        .listener(figures.newcomers.clone())
        .message_backlog_size(BACKLOG)
        .start_blocking()
        .with_context(|| format!("cannot listen at {listen}"))?;
    eprintln!("foxglove: ws://{}", SocketAddr::new(listen.ip(), server.port()));
    let now_ns = Arc::new(AtomicU64::new(first.module_ns));
    let heard = std::thread::Builder::new().name("ports".into()).spawn({
        let (stop, now_ns) = (stop.clone(), now_ns.clone());
        move || hear(watch, ports, &stop, &now_ns)
    })?;
    figures.follow(&server, &stop, &now_ns);
    stop.store(true, Ordering::Release);
    let said = heard.join().unwrap_or_else(|_| "the thread of the ports has died".to_owned());
    eprintln!("foxglove: {said}");
    server.stop().wait_blocking();
    Ok(())
}

/// Hands all messages on until the module ends; says what it was.
fn hear(
    mut watch: Watch,
    mut ports: BTreeMap<String, Port>,
    stop: &AtomicBool,
    now_ns: &AtomicU64,
) -> String {
    let (mut line, mut count, mut lost) = (Vec::new(), 0_u64, 0_u64);
    while !stop.load(Ordering::Acquire) {
        let observation = match watch.next(&mut line) {
            Ok(Some(observation)) => observation,
            Ok(None) => continue,
            Err(_) => break, // the module has ended: the other thread says so
        };
        let Some(port) = ports.get_mut(&observation.source) else { continue };
        now_ns.store(observation.source_ns, Ordering::Release);
        lost += port.hand_on(&observation);
        count += 1;
    }
    stop.store(true, Ordering::Release);
    format!("{count} messages handed on, {lost} not seen")
}

/// A channel of the module, as Foxglove has it.
struct Port {
    channel: Arc<RawChannel>,
    /// Bytes of a message; `None`: bytes without a type.
    size: Option<usize>,
    /// Number of the last message.
    last: Option<u64>,
}

impl Port {
    fn of(context: &Arc<Context>, channel: &ChannelStatus) -> Result<Self> {
        let (partition, port) = channel.source.split_once('.').unwrap_or(("", &channel.source));
        let message = Type::from_schema(&channel.message, &channel.definition).ok();
        let (encoding, schema) = match &message {
            Some(message) => {
                let text = message.schema().into_bytes();
                (MESSAGE_ENCODING, Schema::new(schema_name(message.name()), SCHEMA_ENCODING, text))
            }
            None => ("json", json_schema("bateleur/bytes", &json!({ "bytes": "" }))),
        };
        let builder = ChannelBuilder::new(topic(partition, port)).context(context);
        let channel = builder
            .message_encoding(encoding)
            .schema(schema)
            .build_raw()
            .with_context(|| format!("cannot offer {}", channel.source))?;
        Ok(Self { channel, size: message.map(|message| message.size()), last: None })
    }

    /// How many were lost before it.
    fn hand_on(&mut self, observation: &Observation) -> u64 {
        let meta = PartialMetadata::with_log_time(observation.source_ns);
        match self.size {
            Some(size) => {
                let bytes = bytes_of(&observation.bytes).unwrap_or_default();
                if bytes.len() == size {
                    self.channel.log_with_meta(&[&CDR_HEADER, bytes.as_slice()].concat(), meta);
                }
            }
            None => {
                let text = json!({ "bytes": observation.bytes }).to_string();
                self.channel.log_with_meta(text.as_bytes(), meta);
            }
        }
        // A lower number is a successor's, which counts anew.
        let before = self.last.replace(observation.sequence);
        before.map_or(0, |before| observation.sequence.saturating_sub(before + 1))
    }
}

/// Viewers that have just asked for the health log.
#[derive(Default)]
struct Newcomers(Mutex<Vec<SinkId>>);

impl Newcomers {
    fn take(&self) -> Vec<SinkId> {
        std::mem::take(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl ServerListener for Newcomers {
    fn on_subscribe(&self, viewer: Viewer, channel: ChannelView<'_>) {
        if channel.topic() == HEALTH_TOPIC {
            let mut newcomers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            newcomers.extend(viewer.sink_id());
        }
    }
}

/// The health log and the figures.
struct Figures {
    client: Client,
    newcomers: Arc<Newcomers>,
    health: Tail,
    health_channel: Arc<RawChannel>,
    module_channel: Arc<RawChannel>,
}

impl Figures {
    fn of(context: &Arc<Context>, client: Client, first: &Status) -> Result<Self> {
        let entry = json!({
            "time_ns": 0, "level": "", "partition": "", "generation": 0, "error": "", "action": "", "detail": "", "recovered_ns": 0,
        });
        let offer = |topic: &str, name: &str, example: &Value| {
            let builder = ChannelBuilder::new(topic).context(context).message_encoding("json");
            let channel = builder.schema(json_schema(name, example)).build_raw();
            channel.with_context(|| format!("cannot offer {topic}"))
        };
        Ok(Self {
            client,
            newcomers: Arc::default(),
            health: Tail::from_first(first.folder.join(HEALTH_FILE)),
            health_channel: offer(HEALTH_TOPIC, "bateleur/health", &entry)?,
            module_channel: offer("/module", "bateleur/module", &serde_json::to_value(first)?)?,
        })
    }

    /// Hands them on until the module ends.
    fn follow(&mut self, server: &WebSocketServerHandle, stop: &AtomicBool, now_ns: &AtomicU64) {
        let (mut asked, mut shown_ns) = (None::<Instant>, 0);
        let mut entries: Vec<String> = Vec::new();
        while !stop.load(Ordering::Acquire) {
            let time_ns = now_ns.load(Ordering::Acquire);
            if time_ns < shown_ns {
                server.clear_session(None); // module time has begun anew
                entries.clear();
            }
            shown_ns = time_ns;
            server.broadcast_time(time_ns);
            // Who has come since is shown the whole log: faults are few, and they are what he came for.
            for sink in self.newcomers.take() {
                entries.iter().for_each(|line| self.log_fault(line, Some(sink)));
            }
            let new = self.health.lines();
            new.iter().for_each(|line| self.log_fault(line, None));
            entries.extend(new);
            let surplus = entries.len().saturating_sub(MOST_ENTRIES);
            entries.drain(..surplus);
            if asked.is_none_or(|asked| asked.elapsed() > ASK) {
                asked = Some(Instant::now());
                match status(&mut self.client) {
                    Ok(status) => {
                        now_ns.fetch_max(status.module_ns, Ordering::AcqRel);
                        let text = serde_json::to_vec(&status).unwrap_or_default();
                        let meta = PartialMetadata::with_log_time(status.module_ns);
                        self.module_channel.log_with_meta(&text, meta);
                    }
                    Err(error) => return eprintln!("foxglove: {error:#}"),
                }
            }
            std::thread::sleep(LOOK);
        }
        self.health.lines().iter().for_each(|line| self.log_fault(line, None));
    }

    /// To one viewer, or to all who want it.
    fn log_fault(&self, line: &str, viewer: Option<SinkId>) {
        let time_ns = serde_json::from_str::<Value>(line).ok().and_then(|entry| entry["time_ns"].as_u64());
        if let Some(time_ns) = time_ns {
            let meta = PartialMetadata::with_log_time(time_ns);
            self.health_channel.log_with_meta_to_sink(line.as_bytes(), meta, viewer);
        }
    }
}

fn json_schema(name: &str, example: &Value) -> Schema {
    let mut schema = schema_of(example);
    schema["title"] = name.into();
    Schema::new(name, "jsonschema", schema.to_string().into_bytes())
}
