//! A partition that has been taken over and does all it can to harm those that share nothing with it, again and again,
//! from its first window on: the attacks that its attribute `attacks` names, each for `each_ms` of module time, in turn.
//! It ends itself where the next one begins, so that nothing of the one before is left to the next.
//!
//! What is refused is tried again in the next window, and what ends it is tried again by its successor. Whatever an
//! attack takes it keeps until then. `tests/tests/attacks.rs` judges what others notice.
#![allow(unsafe_code)] // that is what it is for

/// A system call by its number, with as many arguments as it has.
macro_rules! call {
    ($name:ident $(, $argument:expr)* $(,)?) => {
        // SAFETY: this program is there to make such calls; what they point to outlives them.
        unsafe { libc::syscall(libc::$name $(, $argument as c_long)*) }
    };
}

mod descriptors;
mod disk;
mod kernel_memory;
mod processors;
mod sockets;
mod timers;

use std::ffi::{CString, c_long};
use std::process::ExitCode;
use std::ptr::{null, null_mut};

use bateleur_apex::{Context, Direction, Partition, PortKind, SamplingSource, StartError, Window};
use bateleur_messages::FunctionStatus;

use descriptors::*;
use disk::*;
use kernel_memory::*;
use processors::*;
use sockets::*;
use timers::*;

struct Attacker {
    attacks: Vec<String>,
    each_ns: u64,
    /// From its window's end to the start of the window after it.
    gap_ns: u64,
    /// Computes when an attack is at its end, so that a window is used as long whatever is refused.
    busy: bool,
    /// Which one is under way.
    place: Option<u64>,
    held: Held,
    sources: Vec<SamplingSource<FunctionStatus>>,
}

/// What an attack has taken so far.
#[derive(Default)]
struct Held {
    descriptors: Vec<i32>,
    timers: Vec<i32>,
    count: u64,
    strike_ns: u64,
}

/// The window as an attack sees it; instants of CLOCK_MONOTONIC.
struct Turn {
    until_ns: u64,
    /// When the next partition's window begins.
    next_ns: u64,
    frame_ns: u64,
}

impl Turn {
    /// Makes one attempt after the other until one is refused or the window is nearly over.
    fn repeat(&self, mut attempt: impl FnMut() -> bool) {
        while now_ns() < self.until_ns && attempt() {}
    }
}

impl Partition for Attacker {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let names = context.port_names(PortKind::Sampling, Direction::Source);
        Ok(Self {
            sources: names.iter().map(|name| context.sampling_source(name)).collect::<Result<_, _>>()?,
            attacks: context.attribute("attacks", Vec::new())?,
            each_ns: context.attribute("each_ms", 1_000_u64)? * 1_000_000,
            gap_ns: context.attribute("gap_us", 500_u64)? * 1_000,
            busy: context.attribute("busy", false)?,
            place: None,
            held: Held::default(),
        })
    }

    fn window(&mut self, window: &Window) {
        let place = window.start_ns() / self.each_ns;
        if *self.place.get_or_insert(place) != place {
            // SAFETY: it ends the process.
            unsafe { libc::_exit(1) }
        }
        self.sources.iter_mut().for_each(|port| port.write(&FunctionStatus::default()));
        let Some(attack) = self.attacks.get(place as usize % self.attacks.len().max(1)) else { return };
        let (module_ns, now_ns) = (window.now_ns(), now_ns());
        let left_ns = window.end_ns().saturating_sub(module_ns);
        let turn = Turn {
            until_ns: now_ns + left_ns * 4 / 5,
            next_ns: now_ns + left_ns + self.gap_ns,
            frame_ns: window.minor_frame_ns(),
        };
        carry_out(attack, &mut self.held, &turn);
        turn.repeat(|| self.busy);
    }
}

fn now_ns() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64 // never negative
}

const HUGE: i64 = 3 << 30;
const PAGE: usize = 4096;

fn carry_out(attack: &str, held: &mut Held, turn: &Turn) {
    match attack {
        "nothing" => {}
        "computes" => turn.repeat(|| true),
        "timers_2500" => timers(held, turn, 2_500),
        "timers_20000" => timers(held, turn, 20_000),
        "timers_that_repeat" => timers_that_repeat(held, turn),
        "timers_of_processor_time" => timers_of_processor_time(held, turn),
        "timer_descriptors" => timer_descriptors(held, turn),
        "interval_timers" => interval_timers(),
        "queued_signals" => queued_signals(held, turn),
        "watches" => turn.repeat(|| watch(held)),
        "descriptors" => descriptors(held, turn),
        "allocate" => allocate(),
        "truncate" => truncate(),
        "write_anywhere" => write_anywhere(),
        "map_log" => map_log(),
        "change_log" => change_log(),
        "babble" => babble(held, turn),
        "fill_channel" => fill_channel(held, turn),
        "sparse_in_channel" => sparse_in_channel(),
        "names_in_channel" => names_in_channel(held, turn),
        "folders_in_channel" => folders_in_channel(held, turn),
        "chmod" => chmod_all(),
        "lock_all" => lock_all(held),
        "change_folder" => change_folder(held),
        "udp" => internet(held, turn, libc::SOCK_DGRAM),
        "incomplete_datagrams" => incomplete_datagrams(held, turn),
        "silent_neighbours" => silent_neighbours(held, turn),
        "many_neighbours" => many_neighbours(held, turn),
        "can_frames" => can_frames(held, turn),
        "tcp" => internet(held, turn, libc::SOCK_STREAM),
        "tcp_never_accepted" => tcp_never_accepted(held, turn),
        "tcp_timers" => tcp_timers(held, turn),
        "groups_of_hosts" => groups_of_hosts(held, turn),
        "datagrams_between_sockets" => socket_pairs(held, turn, libc::SOCK_DGRAM),
        "streams_between_sockets" => socket_pairs(held, turn, libc::SOCK_STREAM),
        "descriptors_in_flight" => in_flight(held, turn),
        "filters_of_sockets" => filters_of_sockets(held, turn),
        "pipes" => pipes(held, turn),
        "message_queues" => message_queues(held, turn),
        "system_v" => system_v(held, turn),
        "watched_descriptors" => watched_descriptors(held, turn),
        "locked_memory" => locked_memory(),
        "small_mappings" => small_mappings(held, turn),
        "named_mappings" => named_mappings(held, turn),
        "huge_pages" => huge_pages(held),
        "file_locks" => file_locks(held, turn),
        "absent_names" => absent_names(held, turn),
        "barriers" => barriers(turn),
        "drain" => drain(held, turn),
        "open_and_close" => open_and_close(held, turn),
        "make_and_remove" => make_and_remove(held, turn),
        "futexes" => futexes(turn),
        "page_faults" => page_faults(turn),
        "long_reads" => long_reads(),
        "tell_tale_files" => tell_tale_files(turn),
        "splices" => splices(held, turn),
        "execute_itself" => execute_itself(),
        // SAFETY: it ends the process.
        "exit" => unsafe { libc::_exit(0) },
        "exit_with_much" => exit_with_much(held, turn),
        "stop_all" => {
            for process in [0, -1] {
                call!(SYS_kill, process, libc::SIGSTOP);
            }
        }
        "kill_all" => {
            call!(SYS_kill, -1, libc::SIGKILL);
            call!(SYS_kill, 0, libc::SIGKILL);
        }
        "children" => children(turn),
        "sleepers" => sleepers(held, turn),
        other => eprintln!("no attack is called {other}"),
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Attacker>()
}
