//! What a crate is made from: the partition as the plan has it, with a name in Rust for everything.

use std::sync::Arc;

use anyhow::{Context, Result, anyhow, bail};
use bateleur_messages::Type;
use bateleur_messages::format::{Body, FieldKind, Member, rust_name};
use bateleur_plan::{Partition, PartitionId, Payload, Plan, Port, Role, Standby};

use super::names::{CARGO_FOLDERS, Fields, type_name};
use super::values::Reading;

/// Names that the skeleton uses itself, or takes in from elsewhere.
pub(super) const USED_TYPES: &[&str] = &[
    "Context",
    "Default",
    "Err",
    "ExitCode",
    "Field",
    "FieldKind",
    "FromBytes",
    "Harness",
    "HealthError",
    "Immutable",
    "IntoBytes",
    "Kept",
    "KnownLayout",
    "Message",
    "None",
    "Ok",
    "Option",
    "Partition",
    "QueuingDestination",
    "QueuingSource",
    "Response",
    "Result",
    "Retained",
    "SamplingDestination",
    "SamplingSource",
    "Some",
    "StartError",
    "String",
    "Takeover",
    "Vec",
    "Window",
];
/// Fields of its own.
const OWN_FIELDS: &[&str] = &["kept", "retained", "windows", "partition", "harness", "context", "window"];
/// What the library keeps for the smallest value: two copies, each with a header, in blocks of 64 bytes.
const SMALLEST_RETAINED: u64 = 160;

/// See the module's head.
pub(super) struct Skeleton {
    pub(super) partition: String,
    /// The file that is started.
    pub(super) program: String,
    pub(super) type_name: String,
    pub(super) ports: Vec<SkeletonPort>,
    pub(super) attributes: Vec<SkeletonAttribute>,
    /// `None`: nothing is kept.
    pub(super) retained_bytes: Option<u64>,
    pub(super) standby: bool,
    /// Errors come to it before any table.
    pub(super) error_handler: bool,
    /// What else the plan grants, as comments for the author.
    pub(super) grants: Vec<String>,
    /// The folder of message types of one's own, from the crate's; `None`: no port has such a type.
    pub(super) messages: Option<String>,
    shares: Vec<String>,
}

pub(super) struct SkeletonPort {
    pub(super) name: String,
    pub(super) field: String,
    pub(super) role: Role,
    /// Messages that wait in its channel at most; 0: it keeps the latest value.
    pub(super) depth: u32,
    pub(super) content: Content,
}

/// What a port carries.
pub(super) enum Content {
    Message {
        of: Arc<Type>,
        /// It is described beside the schedule file, and not among the flight's types.
        own: bool,
    },
    /// Plain bytes, as long as the channel's source sends them.
    Bytes(usize),
}

pub(super) struct SkeletonAttribute {
    pub(super) name: String,
    pub(super) field: String,
    pub(super) reading: Reading,
}

impl Skeleton {
    /// `messages`: the folder of message types of one's own, from the crate's.
    pub(super) fn of(plan: &Plan, partition: &Partition, messages: &str) -> Result<Self> {
        let program = program(partition)?;
        let mut fields = Fields::without(OWN_FIELDS);
        let mut ports = Vec::new();
        for id in plan.own_ports(partition) {
            let port = &plan[id];
            let (name, role, content) = (port.name.clone(), port.role, content(plan, port)?);
            let own_depth = if let Role::QueuingDestination { depth } = role { depth } else { 0 };
            let depth =
                port.channel.map_or(own_depth, |channel| plan.queue_depth(&plan[channel]).unwrap_or(0));
            ports.push(SkeletonPort { field: fields.field(&name, "port"), name, role, depth, content });
        }
        let mut attributes = Vec::new();
        for (name, value) in &partition.attributes {
            let reading = Reading::of(value);
            let field = match reading {
                Reading::Duration { .. } if !name.ends_with("_ns") => {
                    fields.field(&format!("{name}_ns"), "attribute")
                }
                _ => fields.field(name, "attribute"),
            };
            attributes.push(SkeletonAttribute { name: name.clone(), field, reading });
        }
        let named: Vec<String> = ports.iter().map(|port| port.content.type_name()).collect();
        let taken: Vec<&str> = USED_TYPES.iter().copied().chain(named.iter().map(String::as_str)).collect();
        let own = |port: &SkeletonPort| matches!(port.content, Content::Message { own: true, .. });
        let messages = ports.iter().any(own).then(|| messages.to_owned());
        // Its replicas are what it is.
        let other = |&id: &PartitionId| plan[plan.voter_of(id).unwrap_or(id)].name != partition.name;
        let others = plan.partition_ids().filter(other).map(|id| &plan[id]);
        let shares =
            others.filter(|other| other.program == partition.program).map(|other| other.name.clone());
        Ok(Self {
            partition: partition.name.clone(),
            type_name: type_name(&partition.name, &taken),
            program,
            ports,
            attributes,
            retained_bytes: (partition.retained_bytes > 0).then_some(partition.retained_bytes),
            standby: partition.standby == Some(Standby::Hot),
            error_handler: partition.error_handler,
            grants: grants(partition),
            messages,
            shares: shares.collect(),
        })
    }

    /// Whether a port carries a message type of the flight's, or one in which such a type is.
    pub(super) fn has_flight_messages(&self) -> bool {
        fn has(of: &Type) -> bool {
            let nested = |member: &Member| matches!(&member.body, Body::Nested(nested) if has(nested));
            bateleur_messages::find(of.name()).is_some() || of.members().iter().any(nested)
        }
        self.ports.iter().any(|port| matches!(&port.content, Content::Message { of, .. } if has(of)))
    }

    /// What the author should know beside the files.
    pub(super) fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if let Some(bytes) = self.retained_bytes.filter(|bytes| *bytes < SMALLEST_RETAINED) {
            notes.push(format!(
                "`retained` is {bytes} bytes, and even the smallest value takes {SMALLEST_RETAINED}: give it 4KiB"
            ));
        }
        for other in &self.shares {
            notes.push(format!("partition `{other}` runs `{}` too, with this code", self.program));
        }
        notes
    }

    /// Derives for memory that is shared or kept.
    pub(super) fn needs_zerocopy(&self) -> bool {
        self.retained_bytes.is_some() || self.has_bytes()
    }

    /// Any type of `bateleur-messages`.
    pub(super) fn needs_messages(&self) -> bool {
        self.ports.iter().any(|port| !matches!(port.content, Content::Message { own: true, .. }))
    }

    pub(super) fn has_bytes(&self) -> bool {
        self.ports.iter().any(|port| matches!(port.content, Content::Bytes(_)))
    }

    /// The sizes of plain bytes that its ports carry, each once.
    pub(super) fn byte_sizes(&self) -> Vec<usize> {
        let mut sizes: Vec<usize> = self
            .ports
            .iter()
            .filter_map(|port| match port.content {
                Content::Bytes(size) => Some(size),
                Content::Message { .. } => None,
            })
            .collect();
        sizes.sort_unstable();
        sizes.dedup();
        sizes
    }
}

impl Content {
    /// The type in Rust.
    pub(super) fn type_name(&self) -> String {
        match self {
            Self::Message { of, own: false } => of.name().to_owned(),
            Self::Message { of, own: true } => own_path(of),
            Self::Bytes(size) => format!("Bytes{size}"),
        }
    }

    /// The type as the schedule file has it.
    pub(super) fn message_name(&self) -> String {
        match self {
            Self::Message { of, .. } => of.name().to_owned(),
            Self::Bytes(_) => self.type_name(),
        }
    }

    /// A value that is fit to be sent, field by field.
    pub(super) fn fields(&self) -> Vec<String> {
        let Self::Message { of, .. } = self else { return Vec::new() };
        of.members().iter().map(|field| format!("{}: {}", rust_name(&field.name), value(field))).collect()
    }
}

/// The path of a type of one's own.
fn own_path(of: &Type) -> String {
    match of.name().split_once('/') {
        Some((package, name)) => format!("types::{}::{name}", rust_name(package)),
        None => format!("types::{}", of.name()),
    }
}

/// What a field says that says nothing.
fn value(field: &Member) -> String {
    let one = match &field.body {
        Body::Plain(FieldKind::F64 | FieldKind::F32) => "0.0".to_owned(),
        Body::Plain(_) => "0".to_owned(),
        Body::Nested(nested) => format!("{}::default()", own_path(nested)),
    };
    match (field.name.as_str(), &field.body, field.count) {
        ("valid_ns", Body::Plain(FieldKind::U64), None) => "window.start_ns()".to_owned(),
        // The attitude that turns nothing.
        ("quaternion", Body::Plain(FieldKind::F64), Some(4)) => "[1.0, 0.0, 0.0, 0.0]".to_owned(),
        (_, _, None) => one,
        (_, _, Some(count)) => format!("[{one}; {count}]"),
    }
}

/// The program's file name, which has to be one for cargo.
fn program(partition: &Partition) -> Result<String> {
    let name = partition.program.rsplit('/').next().unwrap_or_default();
    let plain = |letter: char| letter.is_ascii_alphanumeric() || letter == '_' || letter == '-';
    if name.is_empty() || !name.chars().all(plain) || name.starts_with('-') {
        bail!(
            "cargo builds no program called `{name}`: write `program = \"{0}\"` in [partition.{0}]",
            partition.name
        );
    }
    if CARGO_FOLDERS.contains(&name) {
        bail!(
            "cargo keeps the name `{name}` for a folder of its own: choose another `program` in [partition.{}]",
            partition.name
        );
    }
    Ok(name.to_owned())
}

fn content(plan: &Plan, port: &Port) -> Result<Content> {
    match &port.payload {
        Payload::Message { name, .. } => {
            if let Some(of) = bateleur_messages::find(name) {
                return Ok(Content::Message { of: of.clone(), own: false });
            }
            let text =
                plan.messages.get(name).with_context(|| format!("the plan has no text of `{name}`"))?;
            let of = Type::from_schema(name, text)
                .map_err(|faults| anyhow!("the text of `{name}` can not be read: {faults}"))?;
            Ok(Content::Message { of: Arc::new(of), own: true })
        }
        Payload::Bytes { max_size_bytes } => {
            let source = port.channel.map(|channel| &plan[plan[channel].source]);
            Ok(Content::Bytes(source.map_or(*max_size_bytes, |source| source.payload.max_size_bytes())))
        }
    }
}

fn grants(partition: &Partition) -> Vec<String> {
    let mut grants = Vec::new();
    if !partition.devices.is_empty() {
        grants.push(
            "Devices are opened in `start`; `context.line(device)` makes a serial line of one.".to_owned(),
        );
    }
    if partition.network {
        grants.push(
            "Sockets are opened in `start`; wait with `window.wait_readable`, never in the socket."
                .to_owned(),
        );
    }
    if !partition.logbooks.is_empty() {
        let names: Vec<String> = partition
            .logbooks
            .iter()
            .map(|logbook| format!("`context.logbook(\"{}\")`", logbook.name))
            .collect();
        grants.push(format!("Logbooks are asked for in `start`: {}.", names.join(", ")));
    }
    if !partition.may_set_schedule.is_empty() {
        grants.push("`context.module_schedules()` says which schedule runs and asks for another.".to_owned());
    }
    grants
}
