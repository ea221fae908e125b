//! The page itself: one file with all that it needs, so that it is whole without any other network.

use bateleur_executive_cli::http::Reply;
use bateleur_monitor::inject::Fault;
use bateleur_report::html::{SCRIPT, STYLE};
use bateleur_report::plot::escape;
use serde_json::{Value, json};

use crate::scene::Port;
use crate::server::Source;

const PAGE: &str = include_str!("page.html");
const OWN_STYLE: &str = include_str!("page.css");
const OWN_SCRIPT: &str = include_str!("page.js");
/// No part of the page comes from elsewhere, none may be framed, and nothing that is shown runs: only its own script does.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; connect-src 'self'; base-uri 'none'; form-action 'none'; \
                      frame-ancestors 'none'; img-src data:";

/// The page of a module or a run. `nonce`: what tells its own script from any other; nobody can guess it.
pub(crate) fn reply(source: &Source, nonce: &str) -> Reply {
    let (title, about) = match source {
        Source::Live(live) => {
            let status = live.status();
            let partitions: Vec<&str> = status.partitions.iter().map(|one| one.name.as_str()).collect();
            let about = json!({
                "live": true,
                "partitions": partitions,
                "schedules": status.schedules,
                "faults": Fault::names().collect::<Vec<_>>(),
                "ports": ports(&live.ports()),
            });
            (format!("Module {}, PID {}, {} clock", status.module, status.pid, status.clock), about)
        }
        Source::Recorded(run) => {
            let (from_ns, to_ns) = run.span_ns();
            let about = json!({
                "live": false,
                "from_s": from_ns as f64 / 1e9,
                "to_s": to_ns as f64 / 1e9,
                "ports": ports(&run.ports()),
            });
            (run.name(), about)
        }
    };
    // Within an element for data nothing ends it but its own end.
    let about = about.to_string().replace('<', "\\u003c");
    let page = PAGE
        .replace("{{style}}", &format!("{STYLE}{OWN_STYLE}"))
        .replace("{{script}}", &format!("{SCRIPT}{OWN_SCRIPT}"))
        .replace("{{nonce}}", nonce)
        .replace("{{title}}", &escape(&title))
        .replace("{{about}}", &about);
    let policy = format!("{POLICY}; script-src 'nonce-{nonce}'");
    let headers = format!("Content-Security-Policy: {policy}\r\n");
    Reply { headers, ..Reply::of("text/html; charset=utf-8", page) }
}

fn ports(ports: &[Port]) -> Value {
    ports.iter().map(|port| json!({ "name": port.name, "fields": port.fields })).collect()
}
