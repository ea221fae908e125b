//! A partition that has been taken over and does all it can to harm those that share nothing with it, again and again,
//! from its first window on: the attacks that its attribute `attacks` names, each for `each_ms` of module time, in turn.
//! It ends itself where the next one begins, so that nothing of the one before is left to the next.
//!
//! What is refused is tried again in the next window, and what ends it is tried again by its successor. Whatever an
//! attack takes it keeps until then. `tests/tests/attacks.rs` judges what others notice.
#![allow(unsafe_code)] // that is what it is for

use std::ffi::{CString, c_long};
use std::process::ExitCode;
use std::ptr::{null, null_mut};

use bateleur_apex::{Context, Direction, Partition, PortKind, SamplingSource, StartError, Window};
use bateleur_messages::FunctionStatus;

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

/// A system call by its number, with as many arguments as it has.
macro_rules! call {
    ($name:ident $(, $argument:expr)* $(,)?) => {
        // SAFETY: this program is there to make such calls; what they point to outlives them.
        unsafe { libc::syscall(libc::$name $(, $argument as c_long)*) }
    };
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

// Work in interrupt context.

fn block(signal: i32) {
    let mask: u64 = 1 << (signal - 1);
    call!(SYS_rt_sigprocmask, libc::SIG_BLOCK, &raw const mask, null::<u64>(), 8);
}

fn signal_event(signal: i32) -> libc::sigevent {
    // SAFETY: plain data, for which zero is a value.
    let mut event: libc::sigevent = unsafe { std::mem::zeroed() };
    event.sigev_notify = libc::SIGEV_SIGNAL;
    event.sigev_signo = signal;
    event
}

fn make_timer(held: &mut Held, clock: i32) -> bool {
    let (event, mut timer) = (signal_event(40), 0_i32);
    let made = call!(SYS_timer_create, clock, &raw const event, &raw mut timer) == 0;
    if made {
        held.timers.push(timer);
    }
    made
}

fn at(ns: u64) -> libc::timespec {
    libc::timespec { tv_sec: (ns / 1_000_000_000) as libc::time_t, tv_nsec: (ns % 1_000_000_000) as c_long }
}

const NEVER: libc::timespec = libc::timespec { tv_sec: 0, tv_nsec: 0 };

/// `count` timers that all expire at the start of the window after this one, some frames later, once all are set.
fn timers(held: &mut Held, turn: &Turn, count: usize) {
    block(40);
    turn.repeat(|| held.timers.len() < count && make_timer(held, libc::CLOCK_MONOTONIC));
    if held.strike_ns < now_ns() {
        (held.strike_ns, held.count) = (turn.next_ns + turn.frame_ns * (held.timers.len() as u64 / 2_000), 0);
    }
    let expiry = libc::itimerspec { it_interval: NEVER, it_value: at(held.strike_ns) };
    turn.repeat(|| {
        let Some(timer) = held.timers.get(held.count as usize) else { return false };
        call!(SYS_timer_settime, *timer, libc::TIMER_ABSTIME, &raw const expiry, null::<u8>());
        held.count += 1;
        true
    });
}

fn timers_that_repeat(held: &mut Held, turn: &Turn) {
    block(40);
    let often = libc::timespec { tv_sec: 0, tv_nsec: 1 };
    let expiry = libc::itimerspec { it_interval: often, it_value: often };
    turn.repeat(|| {
        make_timer(held, libc::CLOCK_MONOTONIC) && {
            let timer = held.timers[held.timers.len() - 1];
            call!(SYS_timer_settime, timer, 0, &raw const expiry, null::<u8>()) == 0
        }
    });
    // Those that a signal has been queued for go on once it is taken.
    let (mask, no_time) = (1_u64 << 39, NEVER);
    turn.repeat(|| call!(SYS_rt_sigtimedwait, &raw const mask, null::<u8>(), &raw const no_time, 8) > 0);
}

fn timers_of_processor_time(held: &mut Held, turn: &Turn) {
    block(40);
    let often = libc::timespec { tv_sec: 0, tv_nsec: 1_000 };
    let expiry = libc::itimerspec { it_interval: often, it_value: often };
    turn.repeat(|| {
        make_timer(held, libc::CLOCK_PROCESS_CPUTIME_ID) && {
            let timer = held.timers[held.timers.len() - 1];
            call!(SYS_timer_settime, timer, 0, &raw const expiry, null::<u8>()) == 0
        }
    });
}

fn timer_descriptors(held: &mut Held, turn: &Turn) {
    turn.repeat(|| {
        let made = call!(SYS_timerfd_create, libc::CLOCK_MONOTONIC, libc::TFD_NONBLOCK | libc::TFD_CLOEXEC);
        made >= 0 && {
            held.descriptors.push(made as i32);
            true
        }
    });
    if held.strike_ns < now_ns() {
        (held.strike_ns, held.count) = (turn.next_ns, 0);
    }
    let expiry = libc::itimerspec { it_interval: NEVER, it_value: at(held.strike_ns) };
    turn.repeat(|| {
        let Some(timer) = held.descriptors.get(held.count as usize) else { return false };
        call!(SYS_timerfd_settime, *timer, libc::TFD_TIMER_ABSTIME, &raw const expiry, null::<u8>());
        held.count += 1;
        true
    });
}

fn interval_timers() {
    [libc::SIGALRM, libc::SIGVTALRM, libc::SIGPROF].into_iter().for_each(block);
    let often = libc::timeval { tv_sec: 0, tv_usec: 1 };
    let interval = libc::itimerval { it_interval: often, it_value: often };
    for kind in 0..3 {
        call!(SYS_setitimer, kind, &raw const interval, null::<u8>());
    }
    let mask = 1_u64 << (libc::SIGALRM - 1);
    let no_time = NEVER;
    call!(SYS_rt_sigtimedwait, &raw const mask, null::<u8>(), &raw const no_time, 8);
    // SAFETY: a plain call; on aarch64 the C library makes it of another one.
    unsafe { libc::alarm(1) };
}

/// Threads that sleep until the window after this one begins.
fn sleepers(held: &mut Held, turn: &Turn) {
    let next_ns = turn.next_ns;
    turn.repeat(|| {
        let sleep = move || {
            let until = at(next_ns);
            call!(SYS_clock_nanosleep, libc::CLOCK_MONOTONIC, libc::TIMER_ABSTIME, &raw const until, 0);
        };
        held.count += 1;
        std::thread::Builder::new().stack_size(64 << 10).spawn(sleep).is_ok()
    });
}

fn queued_signals(held: &mut Held, turn: &Turn) {
    block(41);
    let own = call!(SYS_getpid);
    let mut information = [0_u8; 128];
    information[0] = 41;
    information[8..12].copy_from_slice(&libc::SI_QUEUE.to_le_bytes());
    turn.repeat(|| {
        held.count += 1;
        call!(SYS_rt_sigqueueinfo, own, 41, information.as_ptr()) == 0
    });
}

// Descriptors.

fn keep(held: &mut Held, descriptor: c_long) -> bool {
    if descriptor >= 0 {
        held.descriptors.push(descriptor as i32);
    }
    descriptor >= 0
}

fn watch(held: &mut Held) -> bool {
    let made = call!(SYS_inotify_init1, libc::IN_NONBLOCK);
    if made >= 0 {
        for folder in own_channels() {
            call!(SYS_inotify_add_watch, made, folder.as_ptr(), libc::IN_ALL_EVENTS);
        }
    }
    keep(held, made)
}

fn descriptors(held: &mut Held, turn: &Turn) {
    turn.repeat(|| {
        let made = match held.descriptors.len() % 6 {
            0 => call!(SYS_openat, libc::AT_FDCWD, c"/dev/null".as_ptr(), libc::O_RDWR),
            1 => call!(SYS_eventfd2, 0, 0),
            2 => call!(SYS_memfd_create, c"held".as_ptr(), 0),
            3 => call!(SYS_epoll_create1, 0),
            4 => {
                let mask = 1_u64;
                call!(SYS_signalfd4, -1, &raw const mask, 8, 0)
            }
            _ => call!(SYS_openat, libc::AT_FDCWD, c"/dev/zero".as_ptr(), libc::O_RDWR),
        };
        if keep(held, made) {
            return true;
        }
        let mut ends = [0_i32; 2];
        call!(SYS_pipe2, ends.as_mut_ptr(), 0) == 0 && {
            held.descriptors.extend(ends);
            true
        }
    });
}

/// Sets of watched descriptors that watch one another.
fn watched_descriptors(held: &mut Held, turn: &Turn) {
    turn.repeat(|| {
        let made = call!(SYS_epoll_create1, 0);
        if !keep(held, made) {
            return false;
        }
        let mut event = libc::epoll_event { events: 1, u64: 0 };
        for watched in held.descriptors.iter().rev().skip(1).take(64) {
            call!(SYS_epoll_ctl, made, libc::EPOLL_CTL_ADD, *watched, &raw mut event);
        }
        true
    });
}

// The disk.

fn allocate() {
    for mode in [libc::FALLOC_FL_KEEP_SIZE, 0, 0x10, 0x10 | libc::FALLOC_FL_KEEP_SIZE] {
        call!(SYS_fallocate, 2, mode, 0, HUGE);
        call!(SYS_fallocate, 1, mode, HUGE, HUGE);
    }
}

fn truncate() {
    for length in [60 << 20, HUGE, 1 << 44, 0] {
        call!(SYS_ftruncate, 2, length);
        call!(SYS_ftruncate, 1, length);
    }
}

fn write_anywhere() {
    let text = [b'.'; PAGE];
    for offset in [0_i64, 60 << 20, 63 << 20, HUGE, 1 << 40] {
        call!(SYS_pwrite64, 2, text.as_ptr(), PAGE, offset);
        call!(SYS_lseek, 2, offset, libc::SEEK_SET);
        call!(SYS_write, 2, text.as_ptr(), PAGE);
    }
    let into = &mut (50_i64 << 20);
    let from = call!(SYS_openat, libc::AT_FDCWD, c"/dev/zero".as_ptr(), libc::O_RDONLY);
    call!(SYS_copy_file_range, from, null::<u8>(), 2, std::ptr::from_mut(into), 1 << 20, 0);
    call!(SYS_sendfile, 2, from, null::<u8>(), 1 << 20);
    call!(SYS_close, from);
}

fn map_log() {
    let protection = libc::PROT_READ | libc::PROT_WRITE;
    for descriptor in [1, 2] {
        call!(SYS_ftruncate, descriptor, 8 << 20);
        let place = call!(SYS_mmap, 0, 8 << 20, protection, libc::MAP_SHARED, descriptor, 0);
        if place <= 0 {
            continue;
        }
        for page in (0..(8 << 20)).step_by(PAGE) {
            // SAFETY: inside the mapping, of a file that is as long; if it is not any more, this ends the process.
            unsafe { (place as *mut u8).add(page).write_volatile(b'.') };
        }
        call!(SYS_msync, place, 8 << 20, libc::MS_ASYNC);
        call!(SYS_munmap, place, 8 << 20);
    }
}

fn change_log() {
    let own = call!(SYS_getpid);
    for descriptor in [1, 2] {
        call!(SYS_fcntl, descriptor, libc::F_SETFL, 0);
        call!(SYS_fcntl, descriptor, libc::F_SETFL, libc::O_ASYNC | libc::O_NONBLOCK | libc::O_DIRECT);
        call!(SYS_fcntl, descriptor, libc::F_SETOWN, own);
        call!(SYS_fcntl, descriptor, libc::F_SETPIPE_SZ, 1 << 20);
        call!(SYS_fcntl, descriptor, libc::F_SETPIPE_SZ, PAGE);
        call!(SYS_fcntl, descriptor, libc::F_SETLEASE, libc::F_WRLCK);
        call!(SYS_fcntl, descriptor, libc::F_NOTIFY, 0x7fff_ffff);
        // SAFETY: plain data, for which zero is a value.
        let mut lock: libc::flock = unsafe { std::mem::zeroed() };
        lock.l_type = libc::F_WRLCK as libc::c_short;
        call!(SYS_fcntl, descriptor, libc::F_SETLK, &raw const lock);
        call!(SYS_flock, descriptor, libc::LOCK_EX | libc::LOCK_NB);
        call!(SYS_fchmod, descriptor, 0);
        call!(SYS_lseek, descriptor, 0, libc::SEEK_SET);
        call!(SYS_write, descriptor, c"overwritten\n".as_ptr(), 12);
        // A pipe that another one reads: it may be read from here too, or filled without an end of a line.
        let mut bytes = [0_u8; 64];
        call!(SYS_fcntl, descriptor, libc::F_SETFL, libc::O_NONBLOCK);
        call!(SYS_read, descriptor, bytes.as_mut_ptr(), bytes.len());
        call!(SYS_write, descriptor, bytes.as_ptr(), bytes.len());
    }
}

fn babble(held: &mut Held, turn: &Turn) {
    static TEXT: [u8; 1 << 20] = [b'x'; 1 << 20];
    turn.repeat(|| {
        held.count += 1;
        let length = if held.count.is_multiple_of(2) { TEXT.len() } else { 1 };
        call!(SYS_write, 2, TEXT.as_ptr(), length) > 0
    });
}

/// The folders of its own channels, as its memory map names them.
fn own_channels() -> Vec<CString> {
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap_or_default();
    let mut folders: Vec<String> = maps
        .lines()
        .filter_map(|line| line.find("/dev/shm/").map(|place| line[place..].trim_end_matches(" (deleted)")))
        .filter_map(|path| {
            let (run, rest) = path.split_once("/ports/")?;
            Some(format!("{run}/ports/{}", rest.split('/').next()?))
        })
        .collect();
    folders.sort_unstable();
    folders.dedup();
    folders.into_iter().filter_map(|folder| CString::new(folder).ok()).collect()
}

fn path(folder: &CString, name: &str) -> CString {
    let folder = folder.to_str().unwrap_or_default();
    CString::new(format!("{folder}/{name}")).unwrap_or_default()
}

fn open(path: &CString, flags: i32) -> c_long {
    call!(SYS_openat, libc::AT_FDCWD, path.as_ptr(), flags, 0o666)
}

fn fill_channel(held: &mut Held, turn: &Turn) {
    let text = [b'.'; 16 * PAGE];
    for folder in own_channels() {
        let file = open(&path(&folder, "fill"), libc::O_CREAT | libc::O_WRONLY | libc::O_APPEND);
        if file < 0 {
            continue;
        }
        turn.repeat(|| call!(SYS_write, file, text.as_ptr(), text.len()) > 0);
        call!(SYS_fallocate, file, 0, 0, 60 << 20);
        held.count += 1;
        call!(SYS_close, file);
    }
}

fn sparse_in_channel() {
    for folder in own_channels() {
        for (number, length) in [64_i64 << 20, HUGE, 1 << 44, i64::MAX].into_iter().enumerate() {
            let file = open(&path(&folder, &format!("sparse{number}")), libc::O_CREAT | libc::O_RDWR);
            call!(SYS_ftruncate, file, length);
            call!(SYS_fallocate, file, libc::FALLOC_FL_KEEP_SIZE, 0, length);
            call!(SYS_pwrite64, file, c"end".as_ptr(), 3, length - 3);
            call!(SYS_close, file);
        }
        call!(SYS_truncate, path(&folder, "sparse0").as_ptr(), 0);
    }
}

fn names_in_channel(held: &mut Held, turn: &Turn) {
    let folders = own_channels();
    turn.repeat(|| {
        held.count += 1;
        folders.iter().any(|folder| {
            let name = format!("{:0200}", held.count);
            let file = open(&path(folder, &name), libc::O_CREAT | libc::O_RDONLY);
            let link = path(folder, &format!("link{:0200}", held.count));
            call!(SYS_linkat, libc::AT_FDCWD, path(folder, &name).as_ptr(), libc::AT_FDCWD, link.as_ptr(), 0);
            call!(SYS_symlinkat, c"/etc/passwd".as_ptr(), libc::AT_FDCWD, link.as_ptr());
            call!(SYS_close, file);
            file >= 0
        })
    });
}

fn folders_in_channel(held: &mut Held, turn: &Turn) {
    if held.count == 0 {
        held.count = own_channels().len() as u64;
        if let Some(folder) = own_channels().first() {
            call!(SYS_chdir, folder.as_ptr());
        }
    }
    turn.repeat(|| {
        call!(SYS_mkdirat, libc::AT_FDCWD, c"d".as_ptr(), 0o777) == 0 && {
            let entered = call!(SYS_chdir, c"d".as_ptr()) == 0;
            call!(SYS_fchmodat, libc::AT_FDCWD, c"..".as_ptr(), 0);
            entered
        }
    });
}

fn chmod_all() {
    for folder in own_channels() {
        let names = std::fs::read_dir(folder.to_str().unwrap_or_default()).into_iter().flatten().flatten();
        for entry in names {
            let path = CString::new(entry.path().as_os_str().as_encoded_bytes()).unwrap_or_default();
            call!(SYS_fchmodat, libc::AT_FDCWD, path.as_ptr(), 0);
        }
        call!(SYS_fchmodat, libc::AT_FDCWD, folder.as_ptr(), 0);
        call!(SYS_fchownat, libc::AT_FDCWD, folder.as_ptr(), 0, 0, 0);
    }
    for descriptor in 0..64 {
        call!(SYS_fchmod, descriptor, 0);
        call!(SYS_fchown, descriptor, 0, 0);
    }
    for place in [c"/dev/shm", c"/proc/self", c"/dev/null", c"/tmp", c"."] {
        call!(SYS_fchmodat, libc::AT_FDCWD, place.as_ptr(), 0);
    }
    // SAFETY: it ends the process: who buries it finds what it left.
    unsafe { libc::_exit(0) }
}

/// Locks every file of its channels, and all that it has open, for as long as it lives.
fn lock_all(held: &mut Held) {
    if held.count > 0 {
        return;
    }
    held.count = 1;
    let mut folders: Vec<_> =
        own_channels().iter().filter_map(|path| path.to_str().ok().map(std::path::PathBuf::from)).collect();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            if entry.path().is_dir() {
                folders.push(entry.path());
            } else if let Ok(path) = CString::new(entry.path().as_os_str().as_encoded_bytes()) {
                let file = open(&path, libc::O_RDWR);
                lock(file as i32);
                keep(held, file);
            }
        }
    }
    (0..64).for_each(lock);
}

fn lock(descriptor: i32) {
    // SAFETY: plain data, for which zero is a value.
    let mut whole: libc::flock = unsafe { std::mem::zeroed() };
    whole.l_type = libc::F_WRLCK as libc::c_short;
    call!(SYS_fcntl, descriptor, libc::F_OFD_SETLK, &raw const whole);
    call!(SYS_fcntl, descriptor, libc::F_SETLK, &raw const whole);
    call!(SYS_flock, descriptor, libc::LOCK_EX | libc::LOCK_NB);
}

fn change_folder(held: &mut Held) {
    call!(SYS_umask, 0o777);
    let places = own_channels();
    if let Some(folder) = places.get(held.count as usize % places.len().max(1)) {
        call!(SYS_chdir, folder.as_ptr());
    }
    for name in [c"made", c"made/again", c"../made", c"../../made"] {
        call!(SYS_mkdirat, libc::AT_FDCWD, name.as_ptr(), 0o777);
        call!(SYS_openat, libc::AT_FDCWD, name.as_ptr(), libc::O_CREAT | libc::O_RDWR, 0o777);
    }
    call!(SYS_renameat2, libc::AT_FDCWD, c".".as_ptr(), libc::AT_FDCWD, c"../elsewhere".as_ptr(), 0);
    held.count += 1;
}

// The kernel's memory.

fn loopback(port: u16) -> libc::sockaddr_in {
    // SAFETY: plain data, for which zero is a value.
    let mut address: libc::sockaddr_in = unsafe { std::mem::zeroed() };
    address.sin_family = libc::AF_INET as libc::sa_family_t;
    address.sin_port = port.to_be();
    address.sin_addr.s_addr = u32::from_be_bytes([127, 0, 0, 1]).to_be();
    address
}

fn widen(socket: c_long) {
    let much = 64 << 20_i32;
    for option in [libc::SO_RCVBUF, libc::SO_SNDBUF, libc::SO_RCVBUFFORCE, libc::SO_SNDBUFFORCE] {
        call!(SYS_setsockopt, socket, libc::SOL_SOCKET, option, &raw const much, 4);
    }
}

/// Sockets that are written to and never read.
fn internet(held: &mut Held, turn: &Turn, kind: i32) {
    static BYTES: [u8; 60_000] = [0; 60_000];
    let length = size_of::<libc::sockaddr_in>();
    turn.repeat(|| {
        let receiver = call!(SYS_socket, libc::AF_INET, kind | libc::SOCK_NONBLOCK, 0);
        if !keep(held, receiver) {
            return false;
        }
        widen(receiver);
        let mut address = loopback(0);
        let mut room = length as libc::socklen_t;
        call!(SYS_bind, receiver, &raw const address, length);
        call!(SYS_getsockname, receiver, &raw mut address, &raw mut room);
        if kind == libc::SOCK_STREAM {
            call!(SYS_listen, receiver, 128);
        }
        let sender = call!(SYS_socket, libc::AF_INET, kind | libc::SOCK_NONBLOCK, 0);
        widen(sender);
        call!(SYS_connect, sender, &raw const address, length);
        let accepted = call!(SYS_accept4, receiver, null::<u8>(), null::<u8>(), libc::SOCK_NONBLOCK);
        keep(held, accepted);
        for _ in 0..64 {
            if call!(SYS_sendto, sender, BYTES.as_ptr(), BYTES.len(), 0, 0, 0) <= 0 {
                break;
            }
        }
        keep(held, sender)
    });
    // The first ones once more: what did not fit before may fit now.
    for sender in held.descriptors.iter().take(64) {
        call!(SYS_sendto, *sender, BYTES.as_ptr(), BYTES.len(), libc::MSG_DONTWAIT, 0, 0);
    }
}

/// Sockets with datagrams that are begun and never finished, so that the kernel keeps them.
fn incomplete_datagrams(held: &mut Held, turn: &Turn) {
    // All together are less than a datagram may have.
    static BYTES: [u8; 15_000] = [0; 15_000];
    turn.repeat(|| {
        let socket = call!(SYS_socket, libc::AF_INET, libc::SOCK_DGRAM | libc::SOCK_NONBLOCK, 0);
        if !keep(held, socket) {
            return false;
        }
        widen(socket);
        let address = loopback(9);
        let length = size_of::<libc::sockaddr_in>();
        call!(SYS_connect, socket, &raw const address, length);
        let cork = 1_i32;
        for level in [libc::SOL_UDP, libc::IPPROTO_UDPLITE] {
            call!(SYS_setsockopt, socket, level, libc::UDP_CORK, &raw const cork, 4);
        }
        call!(SYS_write, socket, BYTES.as_ptr(), BYTES.len());
        call!(SYS_sendto, socket, BYTES.as_ptr(), BYTES.len(), libc::MSG_MORE, &raw const address, length);
        // SAFETY: plain data, for which zero is a value.
        let mut message: libc::mmsghdr = unsafe { std::mem::zeroed() };
        let mut part = libc::iovec { iov_base: BYTES.as_ptr().cast_mut().cast(), iov_len: BYTES.len() };
        (message.msg_hdr.msg_iov, message.msg_hdr.msg_iovlen) = (&raw mut part, 1);
        message.msg_hdr.msg_flags = libc::MSG_MORE;
        call!(SYS_sendmsg, socket, &raw const message.msg_hdr, libc::MSG_MORE);
        call!(SYS_sendmmsg, socket, &raw mut message, 1, libc::MSG_MORE);
        true
    });
}

/// Datagrams to computers that are not there: they wait until the kernel no longer asks for them, and the sockets are closed.
fn silent_neighbours(held: &mut Held, turn: &Turn) {
    static BYTES: [u8; 1_400] = [0; 1_400];
    turn.repeat(|| {
        let socket = call!(SYS_socket, libc::AF_INET, libc::SOCK_DGRAM | libc::SOCK_NONBLOCK, 0);
        if socket < 0 {
            return false;
        }
        widen(socket);
        held.count += 1;
        let mut address = loopback(9);
        let number = 1 + held.count as u32 % 1_000;
        address.sin_addr.s_addr = (u32::from_be_bytes([10, 99, 1, 0]) + number).to_be();
        let length = size_of::<libc::sockaddr_in>();
        while call!(SYS_sendto, socket, BYTES.as_ptr(), BYTES.len(), 0, &raw const address, length) > 0
            && now_ns() < turn.until_ns
        {
            held.strike_ns += 1;
            if held.strike_ns.is_multiple_of(100) {
                break; // the kernel keeps no more for one neighbour
            }
        }
        call!(SYS_close, socket);
        true
    });
}

/// Connections that are written to, closed by who made them, and never accepted: they need no descriptor.
fn tcp_never_accepted(held: &mut Held, turn: &Turn) {
    static BYTES: [u8; 60_000] = [0; 60_000];
    let Some((_, address)) = listener(held) else { return };
    turn.repeat(|| {
        let client = call!(SYS_socket, libc::AF_INET, libc::SOCK_STREAM, 0);
        let made = call!(SYS_connect, client, &raw const address, size_of::<libc::sockaddr_in>()) == 0;
        while call!(SYS_sendto, client, BYTES.as_ptr(), BYTES.len(), libc::MSG_DONTWAIT, 0, 0) > 0 {}
        call!(SYS_close, client);
        made
    });
}

/// One socket that listens, and where.
fn listener(held: &mut Held) -> Option<(i32, libc::sockaddr_in)> {
    let mut address = loopback(0);
    if held.descriptors.is_empty() {
        let listener = call!(SYS_socket, libc::AF_INET, libc::SOCK_STREAM | libc::SOCK_NONBLOCK, 0);
        call!(SYS_bind, listener, &raw const address, size_of::<libc::sockaddr_in>());
        call!(SYS_listen, listener, 4_096);
        keep(held, listener);
    }
    let listener = held.descriptors.first().copied()?;
    let mut room = size_of::<libc::sockaddr_in>() as libc::socklen_t;
    call!(SYS_getsockname, listener, &raw mut address, &raw mut room);
    Some((listener, address))
}

/// Connections whose acknowledgements are due all at once, and whose keep-alive runs out.
fn tcp_timers(held: &mut Held, turn: &Turn) {
    let length = size_of::<libc::sockaddr_in>();
    let Some((listener, address)) = listener(held) else { return };
    turn.repeat(|| {
        let client = call!(SYS_socket, libc::AF_INET, libc::SOCK_STREAM | libc::SOCK_NONBLOCK, 0);
        if !keep(held, client) {
            return false;
        }
        for (level, option, value) in [
            (libc::SOL_SOCKET, libc::SO_KEEPALIVE, 1_i32),
            (libc::IPPROTO_TCP, libc::TCP_KEEPIDLE, 1),
            (libc::IPPROTO_TCP, libc::TCP_KEEPINTVL, 1),
            (libc::IPPROTO_TCP, libc::TCP_NODELAY, 1),
        ] {
            call!(SYS_setsockopt, client, level, option, &raw const value, 4);
        }
        call!(SYS_connect, client, &raw const address, length);
        let server = call!(SYS_accept4, listener, null::<u8>(), null::<u8>(), libc::SOCK_NONBLOCK);
        keep(held, server)
    });
    turn.repeat(|| {
        held.count += 1;
        let Some(socket) = held.descriptors.get(held.count as usize) else {
            held.count = 0;
            return false;
        };
        call!(SYS_sendto, *socket, c"x".as_ptr(), 1, libc::MSG_DONTWAIT, 0, 0);
        true
    });
}

/// Multicast groups and sources.
fn groups_of_hosts(held: &mut Held, turn: &Turn) {
    turn.repeat(|| {
        let socket = call!(SYS_socket, libc::AF_INET, libc::SOCK_DGRAM, 0);
        for group in 0..64_u32 {
            held.count += 1;
            let many = u32::from_be_bytes([239, 1, 0, 0]) + (held.count as u32 % 60_000);
            let request = libc::ip_mreq {
                imr_multiaddr: libc::in_addr { s_addr: many.to_be() },
                imr_interface: libc::in_addr { s_addr: u32::from_be_bytes([127, 0, 0, 1]).to_be() },
            };
            let joined = call!(
                SYS_setsockopt,
                socket,
                libc::IPPROTO_IP,
                libc::IP_ADD_MEMBERSHIP,
                &raw const request,
                size_of_val(&request)
            );
            if group > 0 && joined != 0 {
                break;
            }
        }
        keep(held, socket)
    });
}

fn socket_pairs(held: &mut Held, turn: &Turn, kind: i32) {
    static BYTES: [u8; 32 << 10] = [0; 32 << 10];
    turn.repeat(|| {
        let mut ends = [0_i32; 2];
        if call!(SYS_socketpair, libc::AF_UNIX, kind | libc::SOCK_NONBLOCK, 0, ends.as_mut_ptr()) != 0 {
            return false;
        }
        for end in ends {
            widen(end.into());
            while call!(SYS_write, end, BYTES.as_ptr(), BYTES.len()) > 0 {}
            // Many small ones take more of the kernel's memory than they are long.
            while call!(SYS_write, end, BYTES.as_ptr(), 1) > 0 {}
        }
        held.descriptors.extend(ends);
        true
    });
}

/// Descriptors that are held by no process, only by messages.
fn in_flight(held: &mut Held, turn: &Turn) {
    turn.repeat(|| {
        let mut ends = [0_i32; 2];
        if call!(SYS_socketpair, libc::AF_UNIX, libc::SOCK_STREAM, 0, ends.as_mut_ptr()) != 0 {
            return false;
        }
        let mut pipe = [0_i32; 2];
        call!(SYS_pipe2, pipe.as_mut_ptr(), libc::O_NONBLOCK);
        call!(SYS_fcntl, pipe[1], libc::F_SETPIPE_SZ, 1 << 20);
        // Each message carries 16 descriptors, and the socket itself among them: they hold one another.
        let carried: Vec<i32> = ends.iter().chain(&pipe).copied().cycle().take(16).collect();
        let mut control = vec![0_u64; 2 + carried.len() / 2];
        let mut byte = 0_u8;
        let mut part = libc::iovec { iov_base: (&raw mut byte).cast(), iov_len: 1 };
        // SAFETY: plain data; the control message lies in a buffer that is long enough and aligned.
        let message = unsafe {
            let mut message: libc::msghdr = std::mem::zeroed();
            message.msg_iov = &raw mut part;
            message.msg_iovlen = 1;
            message.msg_control = control.as_mut_ptr().cast();
            message.msg_controllen = (control.len() * 8) as _;
            let header = libc::CMSG_FIRSTHDR(&raw const message);
            (*header).cmsg_level = libc::SOL_SOCKET;
            (*header).cmsg_type = libc::SCM_RIGHTS;
            (*header).cmsg_len = libc::CMSG_LEN(64) as _;
            std::ptr::copy_nonoverlapping(carried.as_ptr().cast(), libc::CMSG_DATA(header), 64);
            message
        };
        let mut sent = 0;
        while call!(SYS_sendmsg, ends[0], &raw const message, libc::MSG_DONTWAIT) > 0 {
            sent += 1;
        }
        for descriptor in ends.iter().chain(&pipe) {
            call!(SYS_close, *descriptor);
        }
        held.count += sent;
        sent > 0
    });
}

/// Programs that a socket runs on each datagram.
fn filters_of_sockets(held: &mut Held, turn: &Turn) {
    let accept = libc::sock_filter { code: 0x06, jt: 0, jf: 0, k: 0xffff };
    let load = libc::sock_filter { code: 0x28, jt: 0, jf: 0, k: 0 };
    let mut program = vec![load; 4_095];
    program.push(accept);
    let filter = libc::sock_fprog { len: 4_096, filter: program.as_mut_ptr() };
    turn.repeat(|| {
        let mut ends = [0_i32; 2];
        if call!(SYS_socketpair, libc::AF_UNIX, libc::SOCK_DGRAM, 0, ends.as_mut_ptr()) != 0 {
            return false;
        }
        for end in ends {
            let size = size_of::<libc::sock_fprog>();
            call!(SYS_setsockopt, end, libc::SOL_SOCKET, libc::SO_ATTACH_FILTER, &raw const filter, size);
            call!(SYS_write, end, c"x".as_ptr(), 1);
        }
        held.descriptors.extend(ends);
        true
    });
}

fn pipes(held: &mut Held, turn: &Turn) {
    static BYTES: [u8; 1 << 20] = [0; 1 << 20];
    turn.repeat(|| {
        let mut ends = [0_i32; 2];
        if call!(SYS_pipe2, ends.as_mut_ptr(), libc::O_NONBLOCK) != 0 {
            return false;
        }
        held.descriptors.extend(ends);
        call!(SYS_fcntl, ends[1], libc::F_SETPIPE_SZ, 1 << 20);
        call!(SYS_write, ends[1], BYTES.as_ptr(), PAGE) > 0
    });
}

fn message_queues(held: &mut Held, turn: &Turn) {
    turn.repeat(|| {
        held.count += 1;
        let name = CString::new(format!("q{}", held.count)).unwrap_or_default();
        let flags = libc::O_CREAT | libc::O_RDWR | libc::O_NONBLOCK;
        let made = call!(SYS_mq_open, name.as_ptr(), flags, 0o600, null::<u8>());
        while made >= 0 && call!(SYS_mq_timedsend, made, name.as_ptr(), 2, 0, null::<u8>()) == 0 {}
        keep(held, made)
    });
}

fn system_v(held: &mut Held, turn: &Turn) {
    static MESSAGE: [u8; 8_192] = [1; 8_192];
    turn.repeat(|| {
        held.count += 1;
        let queue = call!(SYS_msgget, libc::IPC_PRIVATE, 0o600);
        call!(SYS_msgsnd, queue, MESSAGE.as_ptr(), 8_000, libc::IPC_NOWAIT);
        let set = call!(SYS_semget, libc::IPC_PRIVATE, 32_000, 0o600);
        let memory = call!(SYS_shmget, libc::IPC_PRIVATE, 1 << 20, 0o600);
        let place = call!(SYS_shmat, memory, null::<u8>(), 0);
        if place > 0 {
            // SAFETY: in the middle of the memory that was just attached.
            unsafe { (place as *mut u8).add(PAGE).write_volatile(1) };
        }
        queue >= 0 || set >= 0 || memory >= 0
    });
}

fn locked_memory() {
    call!(SYS_mlockall, libc::MCL_CURRENT | libc::MCL_FUTURE);
    let protection = libc::PROT_READ | libc::PROT_WRITE;
    let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS;
    let place = call!(SYS_mmap, 0, 256 << 20, protection, flags, -1, 0);
    if place > 0 {
        call!(SYS_mlock2, place, 256 << 20, 1);
        call!(SYS_mlock, place, 16 << 20);
        call!(SYS_munlockall);
        call!(SYS_munmap, place, 256 << 20);
    }
}

fn small_mappings(held: &mut Held, turn: &Turn) {
    turn.repeat(|| {
        held.count += 1;
        let protection = if held.count.is_multiple_of(2) { libc::PROT_READ } else { libc::PROT_NONE };
        // A page in each two mebibytes has a page table of its own.
        let place = (1_u64 << 40) + held.count * (2 << 20);
        let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_POPULATE | libc::MAP_FIXED_NOREPLACE;
        call!(SYS_mmap, place, PAGE, protection, flags, -1, 0) > 0
    });
}

/// Mappings with a name each, which the kernel keeps.
fn named_mappings(held: &mut Held, turn: &Turn) {
    turn.repeat(|| {
        held.count += 1;
        let protection = if held.count.is_multiple_of(2) { libc::PROT_READ } else { libc::PROT_NONE };
        let place = call!(SYS_mmap, 0, PAGE, protection, libc::MAP_PRIVATE | libc::MAP_ANONYMOUS, -1, 0);
        let name = CString::new(format!("{:079}", held.count)).unwrap_or_default();
        place > 0 && call!(SYS_prctl, libc::PR_SET_VMA, 0, place, PAGE, name.as_ptr()) == 0
    });
}

/// Pages of the machine's own pool, which no partition's memory counts.
fn huge_pages(held: &mut Held) {
    let bytes = 2_usize << 20;
    let protection = libc::PROT_READ | libc::PROT_WRITE;
    for _ in 0..64 {
        let file = call!(SYS_memfd_create, c"huge".as_ptr(), libc::MFD_HUGETLB);
        call!(SYS_ftruncate, file, bytes);
        call!(SYS_mmap, 0, bytes, protection, libc::MAP_SHARED | libc::MAP_POPULATE, file, 0);
        let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_HUGETLB | libc::MAP_POPULATE;
        call!(SYS_mmap, 0, bytes, protection, flags, -1, 0);
        if !keep(held, file) {
            return;
        }
    }
}

/// Locks of single bytes, which can not be joined.
fn file_locks(held: &mut Held, turn: &Turn) {
    if held.descriptors.is_empty() {
        let file = call!(SYS_memfd_create, c"locks".as_ptr(), 0);
        keep(held, file);
    }
    let Some(file) = held.descriptors.first().copied() else { return };
    turn.repeat(|| {
        held.count += 1;
        // SAFETY: plain data, for which zero is a value.
        let mut byte: libc::flock = unsafe { std::mem::zeroed() };
        (byte.l_type, byte.l_start, byte.l_len) = (libc::F_WRLCK as libc::c_short, 2 * held.count as i64, 1);
        call!(SYS_fcntl, file, libc::F_OFD_SETLK, &raw const byte) == 0
    });
}

/// Names that are asked for and not there are remembered by the kernel.
fn absent_names(held: &mut Held, turn: &Turn) {
    let folders = own_channels();
    turn.repeat(|| {
        held.count += 1;
        for folder in folders.iter().map(|folder| folder.to_str().unwrap_or_default()).chain(["/usr/lib"]) {
            let name = CString::new(format!("{folder}/{:0200}", held.count)).unwrap_or_default();
            call!(SYS_faccessat, libc::AT_FDCWD, name.as_ptr(), 0);
        }
        true
    });
}

// The processors.

fn barriers(turn: &Turn) {
    // Registrations of the expedited kinds.
    for command in [2, 4, 16, 64, 128] {
        call!(SYS_membarrier, command, 0, 0);
    }
    turn.repeat(|| {
        for command in [2, 8, 32, 128] {
            call!(SYS_membarrier, command, 0, 0);
        }
        true
    });
    // Waits for every processor.
    call!(SYS_membarrier, 1, 0, 0);
}

/// Work that the kernel does on every processor, or in threads of its own.
fn drain(held: &mut Held, turn: &Turn) {
    turn.repeat(|| {
        held.count += 1;
        let file = call!(SYS_memfd_create, c"drain".as_ptr(), 2);
        call!(SYS_ftruncate, file, 64 * PAGE);
        call!(SYS_fcntl, file, 1033, 8); // F_ADD_SEALS, F_SEAL_WRITE
        call!(SYS_fadvise64, file, 0, 0, libc::POSIX_FADV_DONTNEED);
        call!(SYS_close, file);
        for descriptor in [1, 2] {
            call!(SYS_sync_file_range, descriptor, 0, 0, 7);
            call!(SYS_fadvise64, descriptor, 0, 0, libc::POSIX_FADV_DONTNEED);
            call!(SYS_fdatasync, descriptor);
            call!(SYS_fsync, descriptor);
        }
        let program = open(&c"/proc/self/exe".to_owned(), libc::O_RDONLY);
        call!(SYS_fadvise64, program, 0, 0, libc::POSIX_FADV_DONTNEED);
        call!(SYS_readahead, program, 0, 1 << 30);
        call!(SYS_close, program);
        true
    });
}

fn open_and_close(held: &mut Held, turn: &Turn) {
    turn.repeat(|| {
        held.count += 1;
        let null = open(&c"/dev/null".to_owned(), libc::O_RDONLY);
        let event = call!(SYS_eventfd2, 0, 0);
        let memory = call!(SYS_memfd_create, c"storm".as_ptr(), 0);
        let mut ends = [-1_i32; 2];
        call!(SYS_pipe2, ends.as_mut_ptr(), 0);
        let mut sockets = [-1_i32; 2];
        call!(SYS_socketpair, libc::AF_UNIX, libc::SOCK_STREAM, 0, sockets.as_mut_ptr());
        for descriptor in [null, event, memory] {
            call!(SYS_close, descriptor);
        }
        for descriptor in ends.iter().chain(&sockets).filter(|descriptor| **descriptor > 2) {
            call!(SYS_close, *descriptor);
        }
        true
    });
}

fn make_and_remove(held: &mut Held, turn: &Turn) {
    let folders = own_channels();
    turn.repeat(|| {
        held.count += 1;
        folders.iter().any(|folder| {
            let name = path(folder, &format!("storm{}", held.count));
            let file = open(&name, libc::O_CREAT | libc::O_RDWR);
            call!(SYS_write, file, c"x".as_ptr(), 1);
            call!(SYS_close, file);
            call!(SYS_unlinkat, libc::AT_FDCWD, name.as_ptr(), 0);
            call!(SYS_mkdirat, libc::AT_FDCWD, name.as_ptr(), 0o777);
            call!(SYS_unlinkat, libc::AT_FDCWD, name.as_ptr(), libc::AT_REMOVEDIR);
            file >= 0
        })
    });
}

fn futexes(turn: &Turn) {
    let words = [0_u32; 1_024];
    let short = libc::timespec { tv_sec: 0, tv_nsec: 1 };
    turn.repeat(|| {
        for word in &words {
            call!(SYS_futex, std::ptr::from_ref(word), libc::FUTEX_WAKE, i32::MAX);
            call!(SYS_futex, std::ptr::from_ref(word), libc::FUTEX_WAIT, 0, &raw const short);
            call!(SYS_futex, std::ptr::from_ref(word), 6, 0, &raw const short); // FUTEX_LOCK_PI
            call!(SYS_futex, std::ptr::from_ref(word), 7); // FUTEX_UNLOCK_PI
            if now_ns() >= turn.until_ns {
                break;
            }
        }
        true
    });
}

fn page_faults(turn: &Turn) {
    let protection = libc::PROT_READ | libc::PROT_WRITE;
    let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS;
    turn.repeat(|| {
        let bytes = 4_usize << 20;
        let place = call!(SYS_mmap, 0, bytes, protection, flags, -1, 0);
        if place <= 0 {
            return false;
        }
        for page in (0..bytes).step_by(PAGE) {
            // SAFETY: inside the mapping.
            unsafe { (place as *mut u8).add(page).write_volatile(1) };
        }
        call!(SYS_mprotect, place, bytes, libc::PROT_READ);
        call!(SYS_madvise, place, bytes, libc::MADV_DONTNEED);
        call!(SYS_madvise, place, bytes, libc::MADV_HUGEPAGE);
        call!(SYS_madvise, place, bytes, 25); // MADV_COLLAPSE
        call!(SYS_munmap, place, bytes) == 0
    });
}

/// Calls that take long inside the kernel.
fn long_reads() {
    let bytes = 16_usize << 20;
    let protection = libc::PROT_READ | libc::PROT_WRITE;
    let place = call!(SYS_mmap, 0, bytes, protection, libc::MAP_PRIVATE | libc::MAP_ANONYMOUS, -1, 0);
    call!(SYS_getrandom, place, bytes, 0);
    let zero = open(&c"/dev/zero".to_owned(), libc::O_RDONLY);
    call!(SYS_read, zero, place, bytes);
    call!(SYS_close, zero);
    call!(SYS_munmap, place, bytes);
}

/// Files whose reading asks every processor, or walks all that the kernel knows.
fn tell_tale_files(turn: &Turn) {
    let files = [
        "/proc/cpuinfo",
        "/proc/stat",
        "/proc/meminfo",
        "/proc/self/smaps",
        "/proc/self/pagemap",
        "/proc/self/sched",
        "/proc/self/mountinfo",
        "/proc/self/net/dev",
        "/sys/devices/system/cpu/online",
    ];
    turn.repeat(|| {
        for file in files {
            let _ = std::fs::File::open(file).and_then(|mut file| {
                let mut bytes = [0; 65_536];
                std::io::Read::read(&mut file, &mut bytes)
            });
        }
        true
    });
}

fn splices(held: &mut Held, turn: &Turn) {
    if held.descriptors.is_empty() {
        for _ in 0..2 {
            let mut ends = [0_i32; 2];
            call!(SYS_pipe2, ends.as_mut_ptr(), libc::O_NONBLOCK);
            held.descriptors.extend(ends);
        }
    }
    static BYTES: [u8; 65_536] = [0; 65_536];
    let [first_out, first_in, second_out, second_in] = held.descriptors[..] else { return };
    let part = libc::iovec { iov_base: BYTES.as_ptr().cast_mut().cast(), iov_len: BYTES.len() };
    turn.repeat(|| {
        call!(SYS_vmsplice, first_in, &raw const part, 1, 0);
        call!(SYS_tee, first_out, second_in, 65_536, 0);
        call!(SYS_splice, first_out, null::<u8>(), second_in, null::<u8>(), 65_536, libc::SPLICE_F_NONBLOCK);
        call!(SYS_splice, second_out, null::<u8>(), 2, null::<u8>(), 65_536, libc::SPLICE_F_NONBLOCK);
        true
    });
}

fn execute_itself() {
    let program = open(&c"/proc/self/exe".to_owned(), libc::O_PATH);
    let none: [*const libc::c_char; 1] = [null()];
    call!(SYS_execveat, program, c"".as_ptr(), none.as_ptr(), none.as_ptr(), libc::AT_EMPTY_PATH);
    call!(SYS_execve, c"/proc/self/exe".as_ptr(), none.as_ptr(), null_mut::<u8>());
}

/// Ends in its last moment with much to be given back.
fn exit_with_much(held: &mut Held, turn: &Turn) {
    descriptors(held, turn);
    if now_ns() < turn.until_ns {
        page_faults(turn);
        // SAFETY: it ends the process.
        unsafe { libc::_exit(0) }
    }
}

/// Children that end at once, as many as there may be.
fn children(turn: &Turn) {
    turn.repeat(|| {
        // SAFETY: the child ends at once.
        match unsafe { libc::fork() } {
            -1 => {
                call!(SYS_wait4, -1, null::<u8>(), libc::WNOHANG, null::<u8>());
                true
            }
            // SAFETY: it ends the process.
            0 => unsafe { libc::_exit(0) },
            _ => true,
        }
    });
}

fn main() -> ExitCode {
    bateleur_apex::run::<Attacker>()
}
