//! A running module: what three threads have last heard of it. All of it has a bound: a module that runs for a year takes no more.

use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use anyhow::{Result, bail};
use bateleur_control::{Answer, ChannelStatus, Client, LinkName, Request, Running, Status};
use bateleur_executive_cli::{Watch, bytes_of, channels, links_text, status};
use bateleur_messages::{LinkStatus, Message, State, Type};
use bateleur_recording::Tail;
use bateleur_report::health::{self, HealthEntry};
use bateleur_report::run::Clock;
use bateleur_report::windows::{self, Window};
use zerocopy::FromBytes;

use crate::air::{self, Air, Place};
use crate::scene::{Choice, MOST_ENTRIES, MOST_LINES, MOST_WINDOWS, PLOT_NS, Plot, Port, Scene};

/// Between two questions for the module's figures.
const ASK: Duration = Duration::from_millis(100);
/// Between two looks at the logs.
const LOOK: Duration = Duration::from_millis(50);
/// Messages of all ports that are kept, bytes; each port has an equal part of them.
const MOST_BYTES: usize = 16 << 20;
/// Messages of one port that are kept: half a minute at 50 Hz.
const MOST_MESSAGES: usize = 2048;

/// See the module's head.
#[derive(Debug)]
pub(crate) struct Live {
    running: Running,
    channels: Vec<Channel>,
    board: Arc<Mutex<Board>>,
}

/// A channel, and how its messages are read.
#[derive(Debug, Clone)]
struct Channel {
    status: ChannelStatus,
    message: Option<Arc<Type>>,
}

/// What was heard.
#[derive(Debug, Default)]
struct Board {
    status: Option<Status>,
    /// Unix time at module time 0, ms, and how far it may be off; on the wall clock.
    origin_ms: Option<(f64, f64)>,
    windows: VecDeque<Window>,
    health: VecDeque<HealthEntry>,
    /// By source port: module time, ns, and bytes.
    messages: BTreeMap<String, VecDeque<(u64, Vec<u8>)>>,
    air: Air,
    links: String,
    waypoints: Vec<Place>,
    /// Why no messages are heard.
    deaf: Option<String>,
    /// Why the module is not heard.
    ended: Option<String>,
}

impl Live {
    /// Begins to listen to a module.
    ///
    /// # Errors
    /// It does not answer.
    pub(crate) fn start(running: Running) -> Result<Self> {
        let mut client = Client::connect(&running)?;
        let first = status(&mut client)?;
        let folder = first.folder.clone();
        let read = |status: ChannelStatus| {
            let message = Type::from_schema(&status.message, &status.definition).ok().map(Arc::new);
            Channel { status, message }
        };
        let channels: Vec<Channel> = channels(&mut client)?.into_iter().map(read).collect();
        let links = match client.ask(&Request::Links)? {
            Answer::Links { links } => links,
            other => bail!("the module's answer is not understood: {other:?}"),
        };
        let waypoints = air::waypoints(&folder);
        let board = Board { status: Some(first), waypoints, ..Board::default() };
        let live = Self { running, channels, board: Arc::new(Mutex::new(board)) };
        live.follow_status(client)?;
        live.follow_logs(&folder)?;
        live.follow_ports(links)?;
        Ok(live)
    }

    fn follow_status(&self, mut client: Client) -> Result<()> {
        let board = self.board.clone();
        spawn("status", move || {
            loop {
                let asked = Instant::now();
                match status(&mut client) {
                    Ok(status) => lock(&board).take_status(status, asked.elapsed()),
                    Err(error) => return lock(&board).end(&format!("{error:#}")),
                }
                std::thread::sleep(ASK);
            }
        })
    }

    fn follow_logs(&self, folder: &Path) -> Result<()> {
        let board = self.board.clone();
        let (mut windows, mut health) =
            (Tail::of_last(folder.join(windows::FILE)), Tail::of_last(folder.join(health::FILE)));
        spawn("logs", move || {
            loop {
                let new: Vec<Window> =
                    windows.lines().iter().filter_map(|line| Window::parse(line)).collect();
                let (entries, _) = health::parse(&health.lines().join("\n"));
                {
                    let mut board = lock(&board);
                    board.windows.extend(new);
                    board.health.extend(entries);
                    drop_first(&mut board.windows, MOST_WINDOWS);
                    drop_first(&mut board.health, MOST_ENTRIES);
                    if board.ended.is_some() {
                        return;
                    }
                }
                std::thread::sleep(LOOK);
            }
        })
    }

    fn follow_ports(&self, links: Vec<LinkName>) -> Result<()> {
        let board = self.board.clone();
        let most_bytes = MOST_BYTES / self.channels.len().max(1);
        let kinds = self.channels.iter().map(|one| (one.status.source.clone(), one.status.message.clone()));
        let kinds: BTreeMap<String, String> = kinds.collect();
        let mut watch = match Client::connect(&self.running)
            .map_err(Into::into)
            .and_then(|client| Watch::start(client, &[]))
        {
            Ok(watch) => watch,
            Err(error) => {
                lock(&board).deaf = Some(format!("no messages are shown: {error:#}"));
                return Ok(());
            }
        };
        let module = self.running.module.clone();
        spawn("ports", move || {
            let mut line = Vec::new();
            loop {
                let seen = match watch.next(&mut line) {
                    Ok(Some(seen)) => seen,
                    Ok(None) => continue,
                    Err(error) => {
                        return lock(&board).deaf = Some(format!("no more messages are shown: {error:#}"));
                    }
                };
                let Some(bytes) = bytes_of(&seen.bytes) else { continue };
                let mut board = lock(&board);
                match kinds.get(&seen.source).map(String::as_str) {
                    Some(State::NAME) => {
                        if let Ok(state) = State::read_from_bytes(&bytes) {
                            board.air.add(seen.source_ns, state);
                        }
                    }
                    Some(LinkStatus::NAME) => {
                        if let Ok(status) = LinkStatus::read_from_bytes(&bytes) {
                            board.links = links_text(&module, &links, &status);
                        }
                    }
                    _ => {}
                }
                let room = (most_bytes / bytes.len().max(1)).min(MOST_MESSAGES);
                let kept = board.messages.entry(seen.source).or_default();
                if kept.back().is_some_and(|(last_ns, _)| *last_ns > seen.source_ns) {
                    kept.clear(); // module time has begun anew
                }
                kept.push_back((seen.source_ns, bytes));
                drop_first(kept, room);
            }
        })
    }

    /// The ports that there are to choose from.
    pub(crate) fn ports(&self) -> Vec<Port> {
        let port = |channel: &Channel| {
            let fields = channel.message.as_ref()?.leaves().iter().map(|leaf| leaf.path.clone()).collect();
            Some(Port { name: channel.status.source.clone(), fields })
        };
        self.channels.iter().filter_map(port).collect()
    }

    /// What is the case now, and the Unix time at which the aircraft's state was written, ms.
    pub(crate) fn scene(&self, choice: &Choice) -> (Scene, Option<f64>) {
        let board = lock(&self.board);
        let status = board.status.clone();
        let written = board.air.state.as_ref().map(|(time_ns, _)| *time_ns).zip(board.origin_ms);
        let note = board.ended.clone().or_else(|| board.deaf.clone()).unwrap_or_default();
        let scene = Scene {
            time_ns: status.as_ref().map_or(0, |status| status.module_ns),
            clock: clock(status.as_ref()),
            windows: board.windows.iter().cloned().collect(),
            health: board.health.iter().cloned().collect(),
            air: board.air.clone(),
            waypoints: board.waypoints.clone(),
            links: board.links.clone(),
            plot: self.plot(&board, choice).unwrap_or_default(),
            note,
            status,
        };
        (scene, written.map(|(time_ns, (origin_ms, _))| origin_ms + time_ns as f64 / 1e6))
    }

    fn plot(&self, board: &Board, choice: &Choice) -> Option<Plot> {
        let channel = self.channels.iter().find(|channel| channel.status.source == choice.port)?;
        let leaf = channel.message.as_ref()?.leaves().iter().find(|leaf| leaf.path == choice.field)?;
        let mut lines = vec![Vec::new(); leaf.elements().min(MOST_LINES)];
        let messages = board.messages.get(&choice.port).into_iter().flatten();
        let last_ns = board.messages.get(&choice.port).and_then(VecDeque::back).map_or(0, |last| last.0);
        for (time_ns, bytes) in messages.filter(|(time_ns, _)| time_ns + PLOT_NS >= last_ns) {
            let values = leaf.numbers(bytes).zip(&mut lines);
            values.for_each(|(value, line)| line.push((*time_ns as f64 / 1e9, value.real())));
        }
        let title = format!("{} {}", choice.port, choice.field);
        Some(Plot { title, unit: leaf.unit.clone(), lines })
    }

    /// What it said first: its name, its partitions, its schedules.
    pub(crate) fn status(&self) -> Status {
        lock(&self.board).status.clone().unwrap_or_default()
    }

    /// Gives an order, and says what was answered.
    pub(crate) fn order(&self, request: &Request) -> Result<String, String> {
        let asked = Client::connect(&self.running).and_then(|mut client| client.ask(request));
        match asked {
            Ok(Answer::Done { text }) => Ok(text),
            Ok(other) => Err(format!("the module's answer is not understood: {other:?}")),
            Err(error) => Err(error.to_string()),
        }
    }
}

impl Board {
    fn take_status(&mut self, status: Status, took: Duration) {
        if clock(Some(&status)) == Clock::Wall {
            let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
            let took_ms = took.as_secs_f64() * 1e3;
            // The answer is as old as half of what it took, give or take the same; the best one counts.
            let origin_ms = now.as_secs_f64() * 1e3 - 0.5 * took_ms - status.module_ns as f64 / 1e6;
            if self.origin_ms.is_none_or(|(_, off_ms)| took_ms < off_ms) {
                self.origin_ms = Some((origin_ms, took_ms));
            }
        }
        self.status = Some(status);
    }

    fn end(&mut self, why: &str) {
        self.ended = Some(format!("This is the last that was heard: {why}"));
    }
}

fn clock(status: Option<&Status>) -> Clock {
    if status.is_some_and(|status| status.clock == "virtual") { Clock::Virtual } else { Clock::Wall }
}

fn drop_first<T>(list: &mut VecDeque<T>, most: usize) {
    let surplus = list.len().saturating_sub(most);
    list.drain(..surplus);
}

fn lock(board: &Mutex<Board>) -> MutexGuard<'_, Board> {
    board.lock().unwrap_or_else(PoisonError::into_inner)
}

fn spawn(name: &str, work: impl FnOnce() + Send + 'static) -> Result<()> {
    std::thread::Builder::new().name(name.into()).spawn(work)?;
    Ok(())
}
