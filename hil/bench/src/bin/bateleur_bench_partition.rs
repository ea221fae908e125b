//! The partition that `bateleur bench` measures with. What it does in its windows says its attribute `does`:
//!
//! - `touch`: writes and reads its ports, and closes the window at once;
//! - `fill`: as above, then holds the processor until shortly before the window's end;
//! - `spin`: never closes a window. Four threads and a forked child spin, each noting the last instant of every frame at
//!   which it ran; after `frames` frames the table goes to standard error.
//!
//! Where `says_origin` asks for it, it says the machine's instant of module time 0 (`origin …`) in its first window, and the instant at
//! which it has taken over from one that it stood by (`took_over …`). It must never be part of a flight.
#![allow(unsafe_code)] // a table shared with a forked child

use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use bateleur_apex::{
    Context, Direction, Partition, PortKind, SamplingDestination, SamplingSource, StartError, Takeover,
    Window,
};
use bateleur_messages::Rates;
use rustix::time::{ClockId, clock_gettime};

/// Threads that spin, the window's own among them.
const THREADS: usize = 4;
/// All that spin: the threads and the forked child.
const SPINNERS: usize = THREADS + 1;
/// How long before the end a filled window is closed, ns: about what closing takes, so that there is no slack to speak of
/// and yet no overrun.
const MARGIN_NS: u64 = 5_000;
/// How long a spinner holds the processor before it lets the next one have it, ns.
const TURN_NS: u64 = 300_000;
/// Turns between two short sleeps: threads that sleep wake by timers, also while they are being held.
const TURNS_AWAKE: u32 = 5;

struct Bench {
    does: Does,
    says_origin: bool,
    sources: Vec<SamplingSource<Rates>>,
    destinations: Vec<SamplingDestination<Rates>>,
}

enum Does {
    Touch,
    Fill,
    Spin(Arc<Table>),
}

impl Partition for Bench {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let does: String = context.attribute("does", "touch".into())?;
        let frames: usize = context.attribute("frames", 1000)?;
        let does = match does.as_str() {
            "touch" => Does::Touch,
            "fill" => Does::Fill,
            "spin" => Does::Spin(start_threads(frames)?),
            other => return Err(StartError::Other(format!("does = \"{other}\": touch, fill or spin"))),
        };
        let open = |direction| context.port_names(PortKind::Sampling, direction);
        let (sources, destinations) = (open(Direction::Source), open(Direction::Destination));
        let sources = sources.iter().map(|name| context.sampling_source(name)).collect::<Result<_, _>>()?;
        let destinations =
            destinations.iter().map(|name| context.sampling_destination(name)).collect::<Result<_, _>>()?;
        Ok(Self { does, says_origin: context.attribute("says_origin", false)?, sources, destinations })
    }

    fn take_over(&mut self, _: &Takeover) {
        if self.says_origin {
            eprintln!("took_over {}", monotonic_ns());
        }
    }

    fn window(&mut self, window: &Window) {
        if std::mem::take(&mut self.says_origin) {
            eprintln!("origin {}", monotonic_ns().saturating_sub(window.now_ns()));
        }
        for port in &mut self.destinations {
            std::hint::black_box(port.read());
        }
        self.sources.iter_mut().for_each(|port| port.write(&Rates::default()));
        match &self.does {
            Does::Touch => {}
            Does::Fill => {
                let until_ns = window.end_ns().saturating_sub(MARGIN_NS);
                while window.now_ns() < until_ns {
                    std::hint::spin_loop();
                }
            }
            Does::Spin(table) => spin_and_tell(table, window),
        }
    }
}

/// The last instant of each frame at which each spinner ran, ns after the frame's start; shared with the child.
struct Table {
    cells: &'static [AtomicU64],
    frames: usize,
    /// CLOCK_MONOTONIC at module time 0, ns; 0: not known yet.
    origin_ns: AtomicU64,
    frame_ns: AtomicU64,
    begun: AtomicBool,
}

impl Table {
    fn new(frames: usize) -> Result<Self, StartError> {
        let count = frames * SPINNERS;
        let bytes = count * size_of::<AtomicU64>();
        let protection = libc::PROT_READ | libc::PROT_WRITE;
        let flags = libc::MAP_SHARED | libc::MAP_ANONYMOUS;
        // SAFETY: a new mapping at an address of the kernel's choice, never unmapped.
        let address = unsafe { libc::mmap(std::ptr::null_mut(), bytes, protection, flags, -1, 0) };
        if address == libc::MAP_FAILED {
            return Err(StartError::Other("no memory for the table of instants".into()));
        }
        // SAFETY: the mapping is that long, aligned to a page, zero, and lives as long as the process; atomics are all
        // that anybody makes of it.
        let cells = unsafe { std::slice::from_raw_parts(address.cast::<AtomicU64>(), count) };
        let (origin_ns, frame_ns) = (AtomicU64::new(0), AtomicU64::new(1));
        Ok(Self { cells, frames, origin_ns, frame_ns, begun: AtomicBool::new(false) })
    }

    /// Notes that `spinner` runs now; false: all frames are over.
    fn note(&self, spinner: usize, now_ns: u64) -> bool {
        let module_ns = now_ns.saturating_sub(self.origin_ns.load(Ordering::Relaxed));
        let frame_ns = self.frame_ns.load(Ordering::Relaxed);
        let frame = (module_ns / frame_ns) as usize;
        if frame < self.frames {
            self.cells[frame * SPINNERS + spinner].store(module_ns % frame_ns, Ordering::Relaxed);
        }
        frame < self.frames
    }

    /// Spins until all frames are over.
    fn spin(&self, spinner: usize) {
        let mut turns = 0;
        let mut now_ns = monotonic_ns();
        while self.note(spinner, now_ns) {
            let until_ns = now_ns + TURN_NS;
            while now_ns < until_ns && self.note(spinner, now_ns) {
                now_ns = monotonic_ns();
            }
            turns += 1;
            if turns % TURNS_AWAKE == 0 {
                std::thread::sleep(Duration::from_micros(100));
            } else {
                std::thread::yield_now();
            }
            now_ns = monotonic_ns();
        }
    }
}

/// Threads that exist before the first window are moved to the partition's core with it.
fn start_threads(frames: usize) -> Result<Arc<Table>, StartError> {
    let table = Arc::new(Table::new(frames)?);
    for spinner in 1..THREADS {
        let table = table.clone();
        let spin = move || {
            while !table.begun.load(Ordering::Acquire) {
                std::thread::park();
            }
            table.spin(spinner);
        };
        let thread = std::thread::Builder::new().spawn(spin);
        let thread = thread.map_err(|error| StartError::Other(format!("cannot start a thread: {error}")))?;
        THREADS_WAITING.with_borrow_mut(|waiting| waiting.push(thread.thread().clone()));
    }
    Ok(table)
}

thread_local! {
    static THREADS_WAITING: std::cell::RefCell<Vec<std::thread::Thread>> = const { std::cell::RefCell::new(Vec::new()) };
}

fn spin_and_tell(table: &Table, window: &Window) {
    if table.begun.load(Ordering::Relaxed) {
        return;
    }
    table.frame_ns.store(window.minor_frame_ns().max(1), Ordering::Relaxed);
    table.origin_ns.store(monotonic_ns().saturating_sub(window.now_ns()), Ordering::Relaxed);
    // SAFETY: the child touches atomics in shared memory, reads the clock, sleeps, and ends.
    unsafe {
        if libc::fork() == 0 {
            table.spin(THREADS);
            libc::_exit(0);
        }
    }
    table.begun.store(true, Ordering::Release);
    THREADS_WAITING.with_borrow(|waiting| waiting.iter().for_each(std::thread::Thread::unpark));
    table.spin(0);
    let last = |frame: &[AtomicU64]| frame.iter().map(|cell| cell.load(Ordering::Relaxed)).max().unwrap_or(0);
    let all: Vec<String> = table.cells.chunks(SPINNERS).map(|frame| last(frame).to_string()).collect();
    eprintln!("last {}", all.join(","));
}

fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64 // never negative
}

fn main() -> ExitCode {
    bateleur_apex::run::<Bench>()
}
