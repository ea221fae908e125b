//! Carries out the faults that the executive orders through the control page: the partition misbehaves as ordered, at
//! the start of its next window. For tests; see `bateleur inject`.
//!
//! It must never do anything that was not ordered. What the partition's cage forbids shows as the cage's answer: a
//! refused call, a signal, a death.
#![allow(unsafe_code)] // to misbehave

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::rc::Rc;
use std::time::{Duration, Instant};

use bateleur_contract::sealed::MEMORY_NAME;
use bateleur_contract::{ControlPage, FaultKind, FaultOrder};
use bateleur_ports::Stamp;

/// Messages of one port that are kept back at a time; a fault that delays more lets the rest pass in time.
const KEPT_BACK: usize = 256;
/// Threads that the order for threads starts: far more than a partition declares.
const THREADS: usize = 32;
/// Generations of the fork bomb: each doubles the processes, to 256, which a machine without a limit survives.
const GENERATIONS: u32 = 8;
/// Bytes that are written by the wild writes: enough to hit something that matters in most cases.
const WILD_BYTES: usize = 2_000;
/// How far from something of its own a wild write goes, bytes.
const WILD_REACH: u64 = 1 << 20;
/// For how long the order to run on computes after a window: as long as all others of a frame have theirs.
const RUNS_ON: Duration = Duration::from_millis(20);
/// How the order to exit ends.
const EXIT_CODE: i32 = 3;

/// What becomes of a message that is about to be sent.
pub(crate) enum Fate {
    /// It is sent as it is.
    Pass,
    /// It is lost, or sent later.
    Withhold,
    /// It is sent like this.
    Replace(Vec<u8>),
}

/// A message that was kept back.
pub(crate) struct KeptBack {
    due_ns: u64,
    pub(crate) stamp: Stamp,
    pub(crate) bytes: Vec<u8>,
}

/// The faults of one source port.
#[derive(Default)]
pub(crate) struct PortFault {
    order: Cell<Option<FaultOrder>>,
    /// The message that is sent again and again.
    stuck: RefCell<Vec<u8>>,
    kept: RefCell<VecDeque<KeptBack>>,
}

impl PortFault {
    /// The next messages meet `order`.
    fn set(&self, order: FaultOrder) {
        self.order.set((order.messages > 0).then_some(order));
        self.stuck.borrow_mut().clear();
    }

    /// Every message passes.
    pub(crate) fn is_idle(&self) -> bool {
        self.order.get().is_none() && self.kept.borrow().is_empty()
    }

    /// What becomes of a message. While older ones are kept back, it waits behind them: a channel keeps its order.
    pub(crate) fn meet(&self, bytes: &[u8], stamp: Stamp, now_ns: u64) -> Fate {
        let order = self.order.get();
        if let Some(order) = order {
            let left = order.messages - 1;
            self.order.set((left > 0).then_some(FaultOrder { messages: left, ..order }));
        }
        match order.map(|order| (order.kind, order.argument)) {
            Some((FaultKind::Drop, _)) => Fate::Withhold,
            Some((FaultKind::Corrupt, seed)) => Fate::Replace(corrupted(bytes, seed ^ stamp.sequence)),
            Some((FaultKind::Bias, _)) => Fate::Replace(biased(bytes)),
            Some((FaultKind::Swap, seed)) => Fate::Replace(swapped(bytes, seed)),
            Some((FaultKind::Stuck, _)) => {
                let mut stuck = self.stuck.borrow_mut();
                if stuck.is_empty() {
                    stuck.extend_from_slice(bytes);
                }
                Fate::Replace(stuck.clone())
            }
            Some((FaultKind::Delay, delay_ns)) => {
                self.keep_back(bytes, stamp, now_ns.saturating_add(delay_ns))
            }
            _ if self.kept.borrow().is_empty() => Fate::Pass,
            _ => self.keep_back(bytes, stamp, 0),
        }
    }

    fn keep_back(&self, bytes: &[u8], stamp: Stamp, due_ns: u64) -> Fate {
        let mut kept = self.kept.borrow_mut();
        if kept.len() >= KEPT_BACK {
            return Fate::Pass;
        }
        kept.push_back(KeptBack { due_ns, stamp, bytes: bytes.to_vec() });
        Fate::Withhold
    }

    /// The next message whose time has come.
    pub(crate) fn next_due(&self, now_ns: u64) -> Option<KeptBack> {
        let mut kept = self.kept.borrow_mut();
        if kept.front()?.due_ns <= now_ns { kept.pop_front() } else { None }
    }
}

fn corrupted(bytes: &[u8], seed: u64) -> Vec<u8> {
    let mut random = Random(seed);
    let mut bytes = bytes.to_vec();
    if !bytes.is_empty() {
        for _ in 0..bytes.len().div_ceil(8) {
            let place = random.below(bytes.len() as u64) as usize;
            bytes[place] ^= random.next() as u8 | 1; // at least one bit is wrong
        }
    }
    bytes
}

/// Numbers of other sizes than a double's are rare in messages, and left alone.
fn biased(bytes: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for word in bytes.as_chunks_mut::<8>().0 {
        let value = f64::from_le_bytes(*word);
        // What has another exponent is a counter, a time, a word of flags, or zero, which may be either.
        if (1e-12..1e12).contains(&value.abs()) {
            *word = (value * 1.1 + 0.1).to_le_bytes();
        }
    }
    bytes
}

/// The same two fields as long as `seed` is the same.
fn swapped(bytes: &[u8], seed: u64) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    let words = bytes.as_chunks_mut::<8>().0;
    if let Some(others) = (words.len() as u64).checked_sub(1).filter(|others| *others > 0) {
        let mut random = Random(seed);
        let (one, further) = (random.below(words.len() as u64) as usize, 1 + random.below(others) as usize);
        words.swap(one, (one + further) % words.len());
    }
    bytes
}

/// The faults of a partition, looked at in each window.
pub(crate) struct Faults {
    seen: u32,
    /// It runs on when it has closed this window.
    runs_on: bool,
    /// By the port's place in the description; `None`: not a source.
    ports: Vec<Option<Rc<PortFault>>>,
}

impl Faults {
    /// What was ordered for a predecessor is not carried out.
    pub(crate) fn new(page: &ControlPage, ports: Vec<Option<Rc<PortFault>>>) -> Self {
        let mut seen = 0;
        while page.fault_since(&mut seen).is_some() {} // of a predecessor
        Self { seen, runs_on: false, ports }
    }

    /// Carries out what was ordered since the last window.
    pub(crate) fn carry_out(&mut self, page: &ControlPage) {
        while let Some(order) = page.fault_since(&mut self.seen) {
            match order.kind {
                kind if kind.is_of_port() => {
                    if let Some(Some(port)) = self.ports.get(order.port as usize) {
                        port.set(order);
                    }
                }
                FaultKind::RunOn => self.runs_on = true,
                _ => misbehave(&order, page),
            }
        }
    }

    /// The window is closed. What is computed now touches no port: a run on the virtual clock stays the same.
    pub(crate) fn after_window(&mut self) {
        if std::mem::take(&mut self.runs_on) {
            let begun = Instant::now();
            while begun.elapsed() < RUNS_ON {
                std::hint::spin_loop();
            }
        }
    }
}

fn misbehave(order: &FaultOrder, page: &ControlPage) {
    match order.kind {
        FaultKind::Panic => panic_as_ordered(),
        FaultKind::Abort => std::process::abort(),
        FaultKind::Exit => std::process::exit(EXIT_CODE),
        FaultKind::Hang => loop {
            std::thread::sleep(Duration::from_secs(3600));
        },
        FaultKind::Spin => spin(),
        FaultKind::Allocate => allocate(),
        FaultKind::ForkBomb => fork_bomb(),
        FaultKind::Threads => threads(),
        FaultKind::IllegalCall => illegal_call(),
        FaultKind::NullWrite => write_byte(std::hint::black_box(8), 1),
        FaultKind::WildWrite => wild_write(order.argument),
        FaultKind::WildPage => wild_page(page, order.argument),
        FaultKind::WildPorts => wild_ports(order.argument),
        FaultKind::StackOverflow => {
            std::hint::black_box(recurse(std::hint::black_box(1)));
        }
        FaultKind::DivideByZero => divide_by_zero(),
        FaultKind::IllegalInstruction => illegal_instruction(),
        FaultKind::BusError => bus_error(),
        FaultKind::Drop
        | FaultKind::Delay
        | FaultKind::Corrupt
        | FaultKind::Stuck
        | FaultKind::Bias
        | FaultKind::Swap
        | FaultKind::RunOn => {}
    }
}

#[allow(clippy::panic)] // it is the order
fn panic_as_ordered() -> ! {
    panic!("it was ordered to panic")
}

fn spin() -> ! {
    loop {
        std::hint::spin_loop();
    }
}

/// Ends where the cage ends it: a refused allocation aborts.
fn allocate() {
    let mut taken: Vec<Vec<u8>> = Vec::new();
    loop {
        taken.push(std::hint::black_box(vec![1; 1 << 20]));
    }
}

/// Every process forks in each generation; the children then compute without end, and the partition goes on.
fn fork_bomb() {
    let partition = std::process::id();
    for _ in 0..GENERATIONS {
        // SAFETY: the child calls nothing but what may be called in a copy of a process with several threads.
        let _ = unsafe { libc::fork() }; // refused by the cage: that is its answer
    }
    if std::process::id() != partition {
        spin();
    }
}

fn threads() {
    for _ in 0..THREADS {
        let _ = std::thread::Builder::new().stack_size(1 << 16).spawn(|| spin()); // the cage's limit is the answer
    }
}

/// Calls that a partition has no business with. With a filter the first one ends it; without, the kernel refuses.
fn illegal_call() {
    let nothing = std::ptr::null::<u8>();
    // SAFETY: no memory is handed over that the kernel could write; without privileges each call is refused.
    unsafe {
        libc::syscall(libc::SYS_mount, nothing, nothing, nothing, 0, nothing);
        libc::syscall(libc::SYS_ptrace, libc::PTRACE_ATTACH, 1, nothing, nothing);
        libc::syscall(libc::SYS_init_module, nothing, 0, nothing);
        libc::syscall(libc::SYS_bpf, 0, nothing, 0);
    }
}

pub(crate) fn write_byte(address: usize, value: u8) {
    // SAFETY: there is none: that is the order.
    unsafe { (address as *mut u8).write_volatile(value) };
}

/// Around what it has: its stack, its heap, its code and constants.
fn wild_write(seed: u64) {
    let mut random = Random(seed);
    let heap = Box::new(0_u8);
    let own = [
        std::ptr::from_ref(&random) as usize,
        std::ptr::from_ref(&*heap) as usize,
        wild_write as *const () as usize,
    ];
    for _ in 0..WILD_BYTES {
        let near = own[random.below(own.len() as u64) as usize] as u64;
        let address = near.wrapping_add(random.below(2 * WILD_REACH)).wrapping_sub(WILD_REACH);
        write_byte(address as usize, random.next() as u8);
    }
}

fn wild_page(page: &ControlPage, seed: u64) {
    let start = std::ptr::from_ref(page) as usize;
    wild_range(start, size_of::<ControlPage>(), &mut Random(seed));
}

/// The memory of its ports that it may write: its own messages, and what it shares with its peers.
fn wild_ports(seed: u64) {
    let mut random = Random(seed);
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap_or_default();
    // The page and the retained memory are files in memory too.
    let is_a_ports = |line: &&str| !line.contains("/memfd:") || line.contains(MEMORY_NAME);
    let shared = maps.lines().filter(|line| line.contains(" rw-s ")).filter(is_a_ports);
    let ranges: Vec<(usize, usize)> = shared.filter_map(range).collect();
    for _ in 0..WILD_BYTES {
        if ranges.is_empty() {
            return;
        }
        let (start, end) = ranges[random.below(ranges.len() as u64) as usize];
        write_byte(start + random.below((end - start) as u64) as usize, random.next() as u8);
    }
}

fn range(line: &str) -> Option<(usize, usize)> {
    let (start, end) = line.split(' ').next()?.split_once('-')?;
    let (start, end) = (usize::from_str_radix(start, 16).ok()?, usize::from_str_radix(end, 16).ok()?);
    (end > start).then_some((start, end))
}

fn wild_range(start: usize, length: usize, random: &mut Random) {
    for _ in 0..WILD_BYTES {
        write_byte(start + random.below(length as u64) as usize, random.next() as u8);
    }
}

#[allow(unconditional_recursion)] // it is the order
pub(crate) fn recurse(depth: u64) -> u64 {
    let frame = std::hint::black_box([depth; 64]);
    recurse(std::hint::black_box(frame[0] + 1)) + frame[63]
}

/// A trap of the processor, not a signal sent: process 1 of a namespace does not hear signals that it sends itself.
#[cfg(target_arch = "x86_64")]
fn divide_by_zero() {
    // SAFETY: the instruction traps, and the process ends here.
    unsafe {
        std::arch::asm!("xor edx, edx", "xor ecx, ecx", "mov eax, 1", "div ecx", out("eax") _, out("ecx") _, out("edx") _)
    };
}

/// The processor gives 0 and goes on: in Rust the division itself panics.
#[cfg(not(target_arch = "x86_64"))]
fn divide_by_zero() {
    let zero = std::hint::black_box(0_u32);
    std::hint::black_box(1 / zero);
}

#[cfg(target_arch = "x86_64")]
pub(crate) fn illegal_instruction() {
    // SAFETY: the instruction traps, and the process ends here.
    unsafe { std::arch::asm!("ud2") };
}

#[cfg(target_arch = "aarch64")]
pub(crate) fn illegal_instruction() {
    // SAFETY: the instruction traps, and the process ends here.
    unsafe { std::arch::asm!("udf #0") };
}

#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
pub(crate) fn illegal_instruction() {
    std::process::abort();
}

/// An empty file, mapped for a page.
fn bus_error() {
    use rustix::mm::{MapFlags, ProtFlags, mmap};
    let Ok(file) = rustix::fs::memfd_create("empty", rustix::fs::MemfdFlags::CLOEXEC) else { return };
    // SAFETY: a fresh mapping at an address of the kernel's choice; reading it traps, and the process ends here.
    unsafe {
        let Ok(at) = mmap(std::ptr::null_mut(), 4096, ProtFlags::READ, MapFlags::SHARED, &file, 0) else {
            return;
        };
        std::hint::black_box(at.cast::<u8>().read_volatile());
    }
}

/// A small generator of its own (SplitMix64): the same seed is the same fault, and no crate is linked into every partition
/// for it.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    fn below(&mut self, limit: u64) -> u64 {
        self.next() % limit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn order(kind: FaultKind, messages: u32, argument: u64) -> FaultOrder {
        FaultOrder { kind, port: 0, messages, argument }
    }

    fn stamp(sequence: u64) -> Stamp {
        Stamp { source_ns: 0, sequence }
    }

    #[test]
    fn drop_of_two_messages_loses_two_and_no_third() {
        let port = PortFault::default();
        port.set(order(FaultKind::Drop, 2, 0));
        assert!(matches!(port.meet(b"1", stamp(1), 0), Fate::Withhold));
        assert!(matches!(port.meet(b"2", stamp(2), 0), Fate::Withhold));
        assert!(matches!(port.meet(b"3", stamp(3), 0), Fate::Pass));
        assert!(port.next_due(u64::MAX).is_none());
    }

    #[test]
    fn delayed_messages_come_in_order_and_later_ones_behind_them() {
        let port = PortFault::default();
        port.set(order(FaultKind::Delay, 1, 50));
        assert!(matches!(port.meet(b"1", stamp(1), 100), Fate::Withhold));
        assert!(matches!(port.meet(b"2", stamp(2), 120), Fate::Withhold));
        assert!(port.next_due(149).is_none());
        assert_eq!(port.next_due(150).unwrap().stamp.sequence, 1);
        assert_eq!(port.next_due(150).unwrap().stamp.sequence, 2);
        assert!(matches!(port.meet(b"3", stamp(3), 160), Fate::Pass));
    }

    #[test]
    fn corrupted_message_differs_and_is_the_same_for_the_same_seed() {
        let port = PortFault::default();
        let bytes = [7_u8; 24];
        let meet = || {
            port.set(order(FaultKind::Corrupt, 1, 99));
            match port.meet(&bytes, stamp(1), 0) {
                Fate::Replace(bytes) => bytes,
                _ => panic!("it was to be corrupted"),
            }
        };
        let first = meet();
        assert!(first.len() == 24 && first != bytes);
        assert_eq!(first, meet());
        assert!(matches!(port.meet(&bytes, stamp(2), 0), Fate::Pass));
    }

    #[test]
    fn messages_kept_back_are_bounded() {
        let port = PortFault::default();
        port.set(order(FaultKind::Delay, u32::MAX, 1));
        let kept =
            (0..2 * KEPT_BACK as u64).filter(|n| matches!(port.meet(b"x", stamp(*n), 0), Fate::Withhold));
        assert_eq!(kept.count(), KEPT_BACK);
    }

    #[test]
    fn port_memory_is_found_in_a_map_of_the_process() {
        let line = "7f0000001000-7f0000003000 rw-s 00000000 00:1a 7 /dev/shm/bateleur.fcu.1_x.data";
        assert_eq!(range(line), Some((0x7f00_0000_1000, 0x7f00_0000_3000)));
        assert_eq!(range("nonsense"), None);
    }
}
