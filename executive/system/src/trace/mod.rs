//! The kernel's own trace of who has a processor: an instance of tracefs for one run, with a ring for each of its processors.
//!
//! The kernel writes and overwrites; nothing is read until somebody asks ([`Trace::read`]), and then by whoever asks. The file system is
//! mounted for this process alone, at no place: a machine that shows no tracefs is not changed by a run.

mod decode;

use std::collections::{HashMap, VecDeque};
use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::{AsFd, OwnedFd};

use rustix::fs::{AtFlags, Mode, OFlags, mkdirat, openat, unlinkat};
use rustix::mount::{FsMountFlags, FsOpenFlags, MountAttrFlags, fsconfig_create, fsmount, fsopen};

use decode::{Format, Formats, Role};

/// Bytes of a processor's ring, in KiB: some 28 000 switches between threads.
const RING_KIB: u32 = 2_048;
/// Of the rings of all other processors, which stay empty: the kernel makes at least two pages of it.
const LEAST_KIB: u32 = 4;
/// Room for one page of a ring, whatever the machine's pages are.
const PAGE: usize = 1 << 16;
/// Pages that are read at once, most: a ring that is filled faster than it is read must end.
const MOST_PAGES: usize = 1_024;
/// Names of threads that are remembered, most.
const MOST_NAMES: usize = 4_096;

/// Which events are traced, where the kernel has them: the folder, and what they mean.
const EVENTS: [(&str, Role); 16] = [
    ("sched/sched_switch", Role::Switch),
    ("sched/sched_waking", Role::Waking),
    ("irq/irq_handler_entry", Role::Begin),
    ("irq/irq_handler_exit", Role::End),
    ("irq/softirq_entry", Role::SoftBegin),
    ("irq/softirq_exit", Role::SoftEnd),
    // The processor's own: on x86 they are no handlers.
    ("irq_vectors/local_timer_entry", Role::OwnBegin("timer")),
    ("irq_vectors/local_timer_exit", Role::OwnEnd("timer")),
    ("irq_vectors/call_function_entry", Role::OwnBegin("call from another processor")),
    ("irq_vectors/call_function_exit", Role::OwnEnd("call from another processor")),
    ("irq_vectors/call_function_single_entry", Role::OwnBegin("call from another processor")),
    ("irq_vectors/call_function_single_exit", Role::OwnEnd("call from another processor")),
    // What ends the idle time of a processor for a thread that another one has woken.
    ("irq_vectors/reschedule_entry", Role::OwnBegin("call from another processor")),
    ("irq_vectors/reschedule_exit", Role::OwnEnd("call from another processor")),
    ("ipi/ipi_entry", Role::OwnBegin("call from another processor")),
    ("ipi/ipi_exit", Role::OwnEnd("call from another processor")),
];

/// An interrupt.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Interrupt {
    /// A device's, by its number.
    Device(i32),
    /// Work that the kernel does after interrupts, by its number.
    Soft(u32),
    /// One of the processor's own.
    Own(&'static str),
}

/// What happened on a processor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum What {
    /// Another thread has it from now on; 0: none.
    Switch {
        /// Who had it waits for something else than a processor.
        sleeps: bool,
        /// Who has it.
        to: i32,
    },
    /// A thread that slept is to run from now on; who was woken on another processor is not seen.
    Waking(i32),
    /// An interrupt has it from now on.
    Begin(Interrupt),
    /// It had it until now.
    End(Interrupt),
    /// Events before this one were lost.
    Lost,
}

/// One event.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Event {
    /// CLOCK_MONOTONIC, ns.
    pub at_ns: u64,
    /// The thread that has had the processor up to now, or was interrupted on it; 0: none. Kernels leave out switches (6.18 those from an
    /// idle processor, in some builds): this is what each event knows of them.
    pub thread: i32,
    /// What.
    pub what: What,
}

/// What threads and interrupts are called.
#[derive(Debug, Default)]
pub struct Names {
    threads: HashMap<i32, Thread>,
    devices: HashMap<i32, String>,
}

/// A thread, as it was when it last got a processor or gave it away.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Thread {
    /// What it calls itself.
    pub name: String,
    /// The kernel's priority of it: 0 (real time, 99) to 139 (nice 19); -1 is work with a deadline.
    pub priority: i32,
}

impl Names {
    /// A thread's.
    #[must_use]
    pub fn thread(&self, id: i32) -> Option<&Thread> {
        self.threads.get(&id)
    }

    /// An interrupt's.
    #[must_use]
    pub fn interrupt(&self, interrupt: Interrupt) -> String {
        const SOFT: [&str; 10] = [
            "high tasklet",
            "timer",
            "network send",
            "network receive",
            "block device",
            "block poll",
            "tasklet",
            "scheduler",
            "high-resolution timer",
            "RCU",
        ];
        match interrupt {
            Interrupt::Device(number) => match self.devices.get(&number) {
                Some(name) => format!("{number} ({name})"),
                None => number.to_string(),
            },
            Interrupt::Soft(number) => SOFT
                .get(number as usize)
                .map_or_else(|| format!("soft {number}"), |name| format!("soft {number} ({name})")),
            Interrupt::Own(name) => name.to_owned(),
        }
    }

    fn note_thread(&mut self, id: i32, name: &[u8], priority: i32) {
        let name = text_of(name);
        match self.threads.get_mut(&id) {
            Some(known) if known.name == name => known.priority = priority,
            _ => {
                if self.threads.len() >= MOST_NAMES {
                    self.threads.clear();
                }
                self.threads.insert(id, Thread { name: name.into_owned(), priority });
            }
        }
    }

    fn note_device(&mut self, number: i32, name: &[u8]) {
        if !self.devices.contains_key(&number) && self.devices.len() < MOST_NAMES {
            self.devices.insert(number, text_of(name).into_owned());
        }
    }
}

fn text_of(name: &[u8]) -> std::borrow::Cow<'_, str> {
    let end = name.iter().position(|byte| *byte == 0).unwrap_or(name.len());
    String::from_utf8_lossy(&name[..end])
}

/// See the module's head. Dropped, the instance is removed.
#[derive(Debug)]
pub struct Trace {
    root: OwnedFd,
    path: String,
    formats: Formats,
    rings: Vec<(u32, File)>,
    names: Names,
    page: Vec<u8>,
}

impl Trace {
    /// Traces `cores` from now on, in an instance of this name.
    ///
    /// # Errors
    /// This kernel has no tracefs, or this user may not use it.
    pub fn begin(name: &str, cores: &[u32]) -> io::Result<Self> {
        let root = mount()?;
        let path = path_of(name)?;
        mkdirat(&root, &path, Mode::from_raw_mode(0o700))?;
        // Removes the instance where something fails.
        let mut trace = Self {
            root,
            path,
            formats: Formats::default(),
            rings: Vec::new(),
            names: Names::default(),
            page: vec![0; PAGE],
        };
        trace.furnish(cores)?;
        Ok(trace)
    }

    fn furnish(&mut self, cores: &[u32]) -> io::Result<()> {
        self.write("tracing_on", "0")?;
        self.write("trace_clock", "mono")?;
        self.write("buffer_size_kb", &LEAST_KIB.to_string())?;
        for core in cores {
            self.write(&format!("per_cpu/cpu{core}/buffer_size_kb"), &RING_KIB.to_string())?;
        }
        self.write("tracing_cpumask", &mask_of(cores))?;
        // Names come with each switch: the table that the kernel would keep of them is not needed.
        let _ = self.write("options/record-cmd", "0");
        for (event, role) in EVENTS {
            let Ok(format) = self.text(&format!("events/{event}/format")) else { continue };
            let Some((number, format)) = Format::parse(&format, role) else { continue };
            self.formats.add(number, format);
            if let Err(error) = self.write(&format!("events/{event}/enable"), "1")
                && role == Role::Switch
            {
                return Err(error);
            }
        }
        if !self.formats.has_switch() {
            return Err(io::Error::other("the kernel does not trace switches between threads"));
        }
        for core in cores {
            let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC;
            let ring = openat(
                &self.root,
                format!("{}/per_cpu/cpu{core}/trace_pipe_raw", self.path),
                flags,
                Mode::empty(),
            )?;
            self.rings.push((*core, File::from(ring)));
        }
        self.write("tracing_on", "1")
    }

    /// Takes what has happened on `core` since the last time, as far as the ring still has it: behind what is there, of which the newest
    /// `most` stay. Gives how many of these are new.
    ///
    /// # Errors
    /// The kernel does not give it.
    pub fn read(&mut self, core: u32, into: &mut VecDeque<Event>, most: usize) -> io::Result<usize> {
        let Some((_, ring)) = self.rings.iter_mut().find(|(of, _)| *of == core) else { return Ok(0) };
        let (mut events, mut newest) = (Vec::new(), 0);
        for _ in 0..MOST_PAGES {
            match ring.read(&mut self.page) {
                Ok(0) => break,
                Ok(count) => {
                    self.formats.decode(&self.page[..count], &mut events, &mut self.names);
                    newest += events.len();
                    let surplus = (into.len() + events.len()).saturating_sub(most);
                    into.drain(..surplus.min(into.len()));
                    into.extend(events.drain(..));
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(newest.min(into.len()))
    }

    /// What is called how.
    #[must_use]
    pub fn names(&self) -> &Names {
        &self.names
    }

    fn write(&self, file: &str, text: &str) -> io::Result<()> {
        let flags = OFlags::WRONLY | OFlags::TRUNC | OFlags::CLOEXEC;
        let file = openat(&self.root, format!("{}/{file}", self.path), flags, Mode::empty())?;
        File::from(file).write_all(text.as_bytes())
    }

    fn text(&self, file: &str) -> io::Result<String> {
        let file = openat(
            &self.root,
            format!("{}/{file}", self.path),
            OFlags::RDONLY | OFlags::CLOEXEC,
            Mode::empty(),
        )?;
        let mut text = String::new();
        File::from(file).read_to_string(&mut text)?;
        Ok(text)
    }
}

impl Drop for Trace {
    fn drop(&mut self) {
        self.rings.clear(); // an instance of which a file is open can not be removed
        remove_in(&self.root, &self.path);
    }
}

/// Removes the instances whose names begin so and are not `kept`: runs have left them. One that somebody has open can not be removed.
pub fn sweep(prefix: &str, kept: impl Fn(&str) -> bool) {
    let Ok(root) = mount() else { return };
    let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::CLOEXEC;
    let Ok(folder) = openat(&root, "instances", flags, Mode::empty()) else { return };
    let Ok(entries) = rustix::fs::Dir::read_from(&folder) else { return };
    for entry in entries.flatten() {
        let Ok(name) = entry.file_name().to_str() else { continue };
        if name.starts_with(prefix)
            && !kept(name)
            && let Ok(path) = path_of(name)
        {
            remove_in(&root, &path);
        }
    }
}

/// Whether there is an instance of this name.
#[must_use]
pub fn exists(name: &str) -> bool {
    let find = || -> io::Result<OwnedFd> {
        Ok(openat(mount()?, path_of(name)?, OFlags::PATH | OFlags::CLOEXEC, Mode::empty())?)
    };
    find().is_ok()
}

/// Why this machine traces nothing for this user; `None`: it does.
#[must_use]
pub fn lacking() -> Option<io::Error> {
    mount().err()
}

fn remove_in(root: &OwnedFd, path: &str) {
    let _ = unlinkat(root, path, AtFlags::REMOVEDIR); // there is none, or the next start removes it
}

/// tracefs, mounted at no place.
fn mount() -> io::Result<OwnedFd> {
    let context = fsopen("tracefs", FsOpenFlags::FSOPEN_CLOEXEC)?;
    fsconfig_create(context.as_fd())?;
    Ok(fsmount(context.as_fd(), FsMountFlags::FSMOUNT_CLOEXEC, MountAttrFlags::empty())?)
}

fn path_of(name: &str) -> io::Result<String> {
    match name.is_empty() || name.contains('/') || name.starts_with('.') {
        true => Err(io::ErrorKind::InvalidInput.into()),
        false => Ok(format!("instances/{name}")),
    }
}

/// Processors as the kernel reads a set of them: groups of 32 in hexadecimal, the last ones first.
fn mask_of(cores: &[u32]) -> String {
    let groups = cores.iter().max().map_or(1, |most| most / 32 + 1);
    let words = (0..groups).rev().map(|group| {
        let bits =
            cores.iter().filter(|core| *core / 32 == group).fold(0_u32, |bits, core| bits | 1 << (core % 32));
        format!("{bits:08x}")
    });
    words.collect::<Vec<_>>().join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processors_are_written_as_the_kernel_reads_them() {
        assert_eq!(mask_of(&[0]), "00000001");
        assert_eq!(mask_of(&[1, 3, 33]), "00000002,0000000a");
        assert_eq!(mask_of(&[64]), "00000001,00000000,00000000");
    }

    #[test]
    fn an_instance_has_a_plain_name() {
        for name in ["", "..", "a/b", ".hidden"] {
            assert!(path_of(name).is_err(), "{name}");
        }
    }

    #[test]
    fn threads_that_take_turns_on_a_processor_are_seen_with_their_names_in_order() {
        let core = crate::sched::allowed_cores()[0];
        let name = format!("bateleur-test-{}", std::process::id());
        let mut trace = match Trace::begin(&name, &[core]) {
            Ok(trace) => trace,
            Err(why) => return eprintln!("not tried: {why}"),
        };
        let mut before = VecDeque::new();
        trace.read(core, &mut before, 1 << 20).unwrap();
        let begun_ns = crate::time::now_ns();
        let thread = std::thread::Builder::new().name("taker of turns".into());
        let taker = thread.spawn(move || {
            crate::sched::bind(0, &[core]).unwrap();
            for _ in 0..50 {
                std::thread::sleep(std::time::Duration::from_millis(1));
            }
            rustix::thread::gettid().as_raw_nonzero().get()
        });
        let taker = taker.unwrap().join().unwrap();
        let mut events = VecDeque::new();
        trace.read(core, &mut events, 1 << 20).unwrap();
        let ended_ns = crate::time::now_ns();
        let turns = events
            .iter()
            .filter(|event| event.thread == taker && matches!(event.what, What::Switch { .. }))
            .count();
        assert!(turns >= 50, "{turns} of {}", events.len());
        let wakings = events.iter().filter(|event| event.what == What::Waking(taker)).count();
        assert!(wakings >= 40, "{wakings}: a thread that moves to the processor is woken on another one");
        let known = trace.names().thread(taker).map(|thread| (&*thread.name, thread.priority));
        assert_eq!(known, Some(("taker of turns", 120))); // 15 letters are kept
        assert!(events.make_contiguous().is_sorted_by_key(|event| event.at_ns));
        let late = events.iter().filter(|event| (begun_ns..ended_ns).contains(&event.at_ns)).count();
        assert!(late * 2 > events.len(), "their clock is CLOCK_MONOTONIC: {late} of {}", events.len());
        // Who gets the processor is whose the next event is. A kernel that leaves out switches leaves out those from an idle
        // processor, and now and then from a thread of its own.
        let mut has = None;
        for event in &events {
            assert!(has.is_none_or(|has| has != taker || event.thread == taker), "{event:?} after {has:?}");
            has = match event.what {
                What::Switch { to, .. } => Some(to),
                What::Lost => None,
                _ => Some(event.thread),
            };
        }
        assert!(exists(&name));
        drop(trace);
        assert!(!exists(&name), "it is removed");
    }
}
