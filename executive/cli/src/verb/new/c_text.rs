//! The files of a partition in C: templates, and what is put into them.

use anyhow::Result;
use bateleur_messages::format::c_name;
use bateleur_plan::Role;
use serde::Serialize;

use super::quoted;
use super::skeleton::{Content, Skeleton, SkeletonPort};
use crate::templates::{Written, filled};

const MAIN: &str = include_str!("../../../templates/partition_c/main.c");
const BUILD: &str = include_str!("../../../templates/partition_c/build");

/// The script that builds it.
pub(super) const SCRIPT: &str = "build";

/// What the templates take.
#[derive(Serialize)]
struct Values<'a> {
    partition: &'a str,
    /// The program and its folder, from that of the source, as a shell takes them.
    program: String,
    out: String,
    /// The folders of message types, each with a blank before it.
    folders: String,
    ports: Vec<PortText>,
    samples: bool,
    takes: bool,
    sends: bool,
}

#[derive(Serialize)]
struct PortText {
    /// As a string of C.
    name: String,
    field: String,
    kind: &'static str,
    direction: &'static str,
    r#type: String,
    /// `[N]` of plain bytes.
    length: String,
    size: String,
    depth: u32,
    refresh: String,
}

/// `main.c` and [`SCRIPT`]. `program`: what is built, from the source's folder; `folders`: those of message types, likewise.
pub(super) fn files(skeleton: &Skeleton, program: &str, folders: &[String]) -> Result<Vec<Written>> {
    let out = program.rsplit_once('/').map_or(".", |(folder, _)| folder);
    let has = |role: fn(Role) -> bool| skeleton.ports.iter().any(|port| role(port.role));
    let values = Values {
        partition: &skeleton.partition,
        program: quoted(program.to_owned()),
        out: quoted(out.to_owned()),
        folders: folders.iter().map(|folder| format!(" {}", quoted(folder.clone()))).collect(),
        ports: skeleton.ports.iter().map(port).collect(),
        samples: has(|role| matches!(role, Role::SamplingDestination { .. })),
        takes: has(|role| matches!(role, Role::QueuingDestination { .. })),
        sends: has(|role| role == Role::QueuingSource),
    };
    Ok(vec![("main.c", filled(MAIN, &values)?), (SCRIPT, filled(BUILD, &values)?)])
}

fn port(port: &SkeletonPort) -> PortText {
    let (kind, direction) = match port.role {
        Role::SamplingSource => ("SAMPLING", "SOURCE"),
        Role::SamplingDestination { .. } => ("SAMPLING", "DESTINATION"),
        Role::QueuingSource => ("QUEUING", "SOURCE"),
        Role::QueuingDestination { .. } => ("QUEUING", "DESTINATION"),
    };
    let refresh = match port.role {
        Role::SamplingDestination { refresh_ns } => format!("INT64_C({refresh_ns})"),
        _ => "1".to_owned(), // it means nothing, and has to be above 0
    };
    // A keyword of C is no name there.
    let field = format!("port_{}", port.field.trim_start_matches("r#"));
    let (kind_of, length, size) = match &port.content {
        Content::Message { of, .. } => {
            let name = c_name(of.name());
            (name.clone(), String::new(), format!("sizeof({name})"))
        }
        Content::Bytes(size) => ("char".to_owned(), format!("[{size}]"), size.to_string()),
    };
    PortText {
        name: format!("\"{}\"", port.name),
        field,
        kind,
        direction,
        r#type: kind_of,
        length,
        size,
        depth: port.depth,
        refresh,
    }
}
