//! What is asked for, and what is answered.
//!
//! | address | answer |
//! |---|---|
//! | `GET /` | the page |
//! | `GET /events` | of a running module: its parts, as events, as soon as they change |
//! | `GET /at?t=SECONDS` | of a recorded run: its parts at a module time |
//! | `POST /order` | an order to the module, in the words of the control socket |
//!
//! Each needs the token.

use std::collections::BTreeMap;
use std::io;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use bateleur_control::Request;
use bateleur_executive_cli::http::{Asked, Reply, Stream};
use serde_json::{Map, Value, json};

use crate::draw;
use crate::live::Live;
use crate::page;
use crate::recorded::Recorded;
use crate::scene::Choice;

/// Pages that are kept up to date at a time.
const MOST_PAGES: usize = 4;
/// From one look at what has changed to the next.
const TICK: Duration = Duration::from_millis(40);
/// The same for parts that are larger.
const SLOW_TICK: Duration = Duration::from_millis(200);
/// Those.
const SLOW: [&str; 5] = ["map", "frame", "partitions", "health", "plot"];

/// What is shown.
#[derive(Debug)]
pub(crate) enum Source {
    Live(Live),
    Recorded(Recorded),
}

/// See the module's head.
#[derive(Debug)]
pub(crate) struct Server {
    source: Source,
    token: String,
    nonce: String,
    pages: AtomicUsize,
}

impl Server {
    pub(crate) fn new(source: Source, token: String, nonce: String) -> Self {
        Self { source, token, nonce, pages: AtomicUsize::new(0) }
    }

    /// Answers a request.
    pub(crate) fn answer(&self, asked: &Asked, stream: &mut Stream) -> Option<Reply> {
        if !asked.has_token(&self.token) {
            return Some(Reply::refused(
                403,
                "the address that `bateleur view` printed has a token in it: take that one",
            ));
        }
        let choice = Choice {
            port: asked.value("port").unwrap_or_default().into(),
            field: asked.value("field").unwrap_or_default().into(),
        };
        let seconds = asked.value("t").and_then(|text| text.parse::<f64>().ok()).filter(|time| *time >= 0.0);
        match (asked.method.as_str(), asked.path.as_str(), &self.source) {
            ("GET", "/", source) => Some(page::reply(source, &self.nonce)),
            ("GET", "/events", Source::Live(live)) => self.stream(live, &choice, stream),
            ("GET", "/at", Source::Recorded(run)) => Some(match seconds {
                Some(time_s) => at(run, &choice, time_s),
                None => Reply::refused(400, "t is the module time in seconds"),
            }),
            ("POST", "/order", Source::Live(live)) => Some(order(live, asked)),
            ("GET" | "POST", "/" | "/events" | "/at" | "/order", _) => {
                Some(Reply::refused(405, "this is not done here"))
            }
            _ => Some(Reply::refused(404, "there is no such thing")),
        }
    }

    fn stream(&self, live: &Live, choice: &Choice, stream: &mut Stream) -> Option<Reply> {
        if self.pages.fetch_add(1, Ordering::AcqRel) >= MOST_PAGES {
            self.pages.fetch_sub(1, Ordering::AcqRel);
            return Some(Reply::refused(503, "too many pages are open: close one of them"));
        }
        let _ = give_events(live, choice, stream); // the page was closed
        self.pages.fetch_sub(1, Ordering::AcqRel);
        None
    }
}

fn give_events(live: &Live, choice: &Choice, stream: &mut Stream) -> io::Result<()> {
    stream.begin("text/event-stream")?;
    let mut shown: BTreeMap<&str, String> = BTreeMap::new();
    let mut slow: Option<Instant> = None;
    loop {
        let with_slow = slow.is_none_or(|last| last.elapsed() >= SLOW_TICK);
        if with_slow {
            slow = Some(Instant::now());
        }
        let (scene, written_ms) = live.scene(choice);
        let mut changed = Map::new();
        for (name, text) in draw::parts(&scene) {
            if (with_slow || !SLOW.contains(&name)) && shown.get(name) != Some(&text) {
                changed.insert(name.into(), text.as_str().into());
                shown.insert(name, text);
            }
        }
        let fresh = changed.contains_key("numbers");
        let event = json!({ "parts": changed, "written_ms": written_ms.filter(|_| fresh) });
        stream.give(format!("data: {event}\n\n").as_bytes())?;
        std::thread::sleep(TICK);
    }
}

fn at(run: &Recorded, choice: &Choice, time_s: f64) -> Reply {
    let scene = run.scene(choice, (time_s * 1e9) as u64);
    let parts: Map<String, Value> =
        draw::parts(&scene).into_iter().map(|(name, text)| (name.to_owned(), text.into())).collect();
    json_reply(&json!({ "parts": parts }))
}

fn order(live: &Live, asked: &Asked) -> Reply {
    // A form of somebody else's page can not send this type.
    if asked.content_type != "application/json" {
        return Reply::refused(400, "an order is application/json");
    }
    let request = match serde_json::from_slice(&asked.body) {
        Ok(Request::Status | Request::Ports | Request::Links | Request::Watch { .. }) => {
            return Reply::refused(400, "this is no order");
        }
        Ok(request) => request,
        Err(error) => return Reply::refused(400, &format!("not an order: {error}")),
    };
    match live.order(&request) {
        Ok(text) => json_reply(&json!({ "done": text })),
        Err(why) => json_reply(&json!({ "refused": why })),
    }
}

fn json_reply(value: &Value) -> Reply {
    Reply::of("application/json", value.to_string())
}
