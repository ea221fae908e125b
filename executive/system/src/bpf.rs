//! Programs inside the kernel (BPF) that it runs for a control group: making their memory, loading them, attaching them, and the
//! instructions of which they are put together.
#![allow(unsafe_code)]

use std::io;
use std::os::fd::{AsRawFd, BorrowedFd, FromRawFd, OwnedFd};

// Numbers of `linux/bpf.h`, which the C library's binding does not have.
const MAP_CREATE: libc::c_int = 0;
const MAP_UPDATE: libc::c_int = 2;
const MAP_DELETE: libc::c_int = 3;
const MAP_NEXT_KEY: libc::c_int = 4;
const PROGRAM_LOAD: libc::c_int = 5;
const PROGRAM_ATTACH: libc::c_int = 8;
/// Programs of groups above and below run too.
const ALLOW_MULTI: u32 = 2;

/// What a map is looked up by.
#[derive(Debug, Clone, Copy)]
#[repr(u32)]
pub(crate) enum Lookup {
    /// Any bytes, of which it holds as many as it has entries.
    Hash = 1,
    /// Numbers from 0 on.
    Array = 2,
}

/// When a program runs: what the kernel calls its type and where it is attached.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Hook {
    /// A socket of the internet is made.
    SocketCreate,
    /// It is closed for good.
    SocketRelease,
    /// A packet is about to leave by an interface.
    PacketLeaves,
}

impl Hook {
    const fn numbers(self) -> (u32, u32) {
        match self {
            Self::SocketCreate => (9, 2),
            Self::SocketRelease => (9, 34),
            Self::PacketLeaves => (8, 1),
        }
    }
}

#[repr(C)]
struct MapShape {
    kind: u32,
    key_size: u32,
    value_size: u32,
    entries: u32,
}

#[repr(C)]
struct Element {
    map: u32,
    key: u64,
    /// Or the next key.
    value: u64,
    flags: u64,
}

#[repr(C)]
struct Program {
    kind: u32,
    length: u32,
    instructions: u64,
    license: u64,
    log_level: u32,
    log_size: u32,
    log: u64,
    kernel: u32,
    flags: u32,
    name: [u8; 16],
    interface: u32,
    attach: u32,
}

#[repr(C)]
struct Attachment {
    group: u32,
    program: u32,
    attach: u32,
    flags: u32,
}

/// Makes the call; a descriptor or 0.
///
/// # Safety
/// What `attributes` points to is what the kernel expects of `command`.
unsafe fn bpf<T>(command: libc::c_int, attributes: &T) -> io::Result<libc::c_long> {
    // SAFETY: the kernel reads as many bytes as it is told of; what they point to is the caller's promise.
    let done =
        unsafe { libc::syscall(libc::SYS_bpf, command, std::ptr::from_ref(attributes), size_of::<T>()) };
    if done < 0 { Err(io::Error::last_os_error()) } else { Ok(done) }
}

/// Memory of programs, which lives as long as they do.
#[derive(Debug)]
pub(crate) struct Map {
    file: OwnedFd,
    key_size: usize,
    value_size: usize,
}

impl Map {
    /// Sizes in bytes.
    pub(crate) fn new(
        lookup: Lookup,
        key_size: usize,
        value_size: usize,
        entries: usize,
    ) -> io::Result<Self> {
        let shape = MapShape {
            kind: lookup as u32,
            key_size: key_size as u32,
            value_size: value_size as u32,
            entries: entries as u32,
        };
        // SAFETY: numbers only; the kernel returns a new descriptor, which nobody else owns.
        let file = unsafe { bpf(MAP_CREATE, &shape).map(|map| OwnedFd::from_raw_fd(map as i32)) }?;
        Ok(Self { file, key_size, value_size })
    }

    fn element(&self, key: *const u8, value: *const u8) -> Element {
        Element { map: self.file.as_raw_fd().cast_unsigned(), key: key as u64, value: value as u64, flags: 0 }
    }

    /// Sets all bytes of the value at `key` to zero.
    pub(crate) fn zero(&self, key: u32) -> io::Result<()> {
        let (key, value) = (key.to_ne_bytes(), vec![0_u8; self.value_size]);
        if self.key_size != key.len() {
            return Err(io::ErrorKind::InvalidInput.into());
        }
        // SAFETY: the kernel reads a key and a value that are as long as the map was made for.
        unsafe { bpf(MAP_UPDATE, &self.element(key.as_ptr(), value.as_ptr())) }.map(drop)
    }

    /// Removes every key.
    pub(crate) fn clear(&self) -> io::Result<()> {
        let mut key = vec![0_u8; self.key_size];
        loop {
            let first = Element {
                value: key.as_mut_ptr() as u64,
                ..self.element(std::ptr::null(), std::ptr::null())
            };
            // SAFETY: without a key the kernel writes the first one, as long as the map was made for.
            match unsafe { bpf(MAP_NEXT_KEY, &first) } {
                Err(error) if error.raw_os_error() == Some(libc::ENOENT) => return Ok(()),
                Err(error) => return Err(error),
                Ok(_) => {}
            }
            // SAFETY: the kernel reads a key of that length.
            match unsafe { bpf(MAP_DELETE, &self.element(key.as_ptr(), std::ptr::null())) } {
                Err(error) if error.raw_os_error() != Some(libc::ENOENT) => return Err(error),
                _ => {}
            }
        }
    }

    /// Two instructions: `to` is this map.
    pub(crate) fn point_at(&self, to: u64) -> [u64; 2] {
        const MAP_BY_DESCRIPTOR: u64 = 1;
        set_wide(to, MAP_BY_DESCRIPTOR, self.file.as_raw_fd().cast_unsigned().into())
    }
}

/// Loads a program and lets the kernel run it for `group`.
///
/// # Errors
/// The kernel has no such programs, or this process may not load them (CAP_BPF and CAP_NET_ADMIN).
pub(crate) fn attach(group: BorrowedFd<'_>, instructions: &[u64], hook: Hook) -> io::Result<()> {
    let mut name = [0; 16];
    name[..8].copy_from_slice(b"bateleur");
    let (kind, attach) = hook.numbers();
    let program = Program {
        kind,
        length: instructions.len() as u32,
        instructions: instructions.as_ptr() as u64,
        license: c"MIT or Apache-2.0".as_ptr() as u64,
        log_level: 0,
        log_size: 0,
        log: 0,
        kernel: 0,
        flags: 0,
        name,
        interface: 0,
        attach,
    };
    // SAFETY: the kernel reads the instructions and the text; it returns a new descriptor, which nobody else owns.
    let program = unsafe { bpf(PROGRAM_LOAD, &program).map(|program| OwnedFd::from_raw_fd(program as i32)) }?;
    let attachment = Attachment {
        group: group.as_raw_fd().cast_unsigned(),
        program: program.as_raw_fd().cast_unsigned(),
        attach,
        flags: ALLOW_MULTI,
    };
    // SAFETY: numbers only.
    unsafe { bpf(PROGRAM_ATTACH, &attachment) }.map(drop)
}

// The machine's instructions of eight bytes (Linux, Documentation/bpf/standardization/instruction-set.rst).

/// Registers: the result, arguments, what calls leave alone, the stack's end.
pub(crate) const R0: u64 = 0;
pub(crate) const R1: u64 = 1;
pub(crate) const R2: u64 = 2;
pub(crate) const R3: u64 = 3;
pub(crate) const R4: u64 = 4;
pub(crate) const R6: u64 = 6;
pub(crate) const R7: u64 = 7;
pub(crate) const R8: u64 = 8;
pub(crate) const R9: u64 = 9;
pub(crate) const R10: u64 = 10;

/// Functions of the kernel.
pub(crate) const MAP_LOOKUP: i32 = 1;
pub(crate) const MAP_STORE: i32 = 2;
pub(crate) const NOW_NS: i32 = 5;
pub(crate) const LOAD_BYTES: i32 = 26;

/// `R0` is what the program answers.
pub(crate) const EXIT: u64 = instruction(0x95, 0, 0, 0, 0);

pub(crate) const fn instruction(operation: u64, to: u64, from: u64, offset: i16, number: i32) -> u64 {
    let offset = offset.cast_unsigned() as u64;
    let number = number.cast_unsigned() as u64;
    operation | to << 8 | from << 12 | offset << 16 | number << 32
}

pub(crate) const fn set(to: u64, number: i32) -> u64 {
    instruction(0xb7, to, 0, 0, number)
}

pub(crate) const fn add(to: u64, number: i32) -> u64 {
    instruction(0x07, to, 0, 0, number)
}

pub(crate) const fn copy(to: u64, from: u64) -> u64 {
    instruction(0xbf, to, from, 0, 0)
}

pub(crate) const fn call(function: i32) -> u64 {
    instruction(0x85, 0, 0, 0, function)
}

/// `to` is the four bytes at `offset` from where `from` points.
pub(crate) const fn load_word(to: u64, from: u64, offset: i16) -> u64 {
    instruction(0x61, to, from, offset, 0)
}

/// Skips `count` instructions where `register` is `number`.
pub(crate) const fn skip_if(register: u64, number: i32, count: i16) -> u64 {
    instruction(0x15, register, 0, count, number)
}

/// Skips `count` instructions where `register` is not `number`.
pub(crate) const fn skip_unless(register: u64, number: i32, count: i16) -> u64 {
    instruction(0x55, register, 0, count, number)
}

/// Two instructions: `to` is a number of 64 bits.
pub(crate) fn set_wide(to: u64, from: u64, number: u64) -> [u64; 2] {
    let half = |number: u64| (number as u32).cast_signed();
    [instruction(0x18, to, from, 0, half(number)), instruction(0, 0, 0, 0, half(number >> 32))]
}

/// What tests of such programs have in common: a control group that has them, and a process inside of it.
#[cfg(test)]
pub(crate) mod group {
    use std::io;
    use std::os::fd::BorrowedFd;
    use std::process::{Command, Stdio};

    use crate::cgroup::Group;

    /// Set in the process inside of the group.
    const INSIDE: &str = "BATELEUR_TEST_INSIDE";

    /// A group that `limit` gave its programs; `None`: this machine has none of both, which is said.
    pub(crate) fn limited<T>(
        name: &str,
        limit: impl FnOnce(BorrowedFd<'_>) -> io::Result<T>,
    ) -> Option<(Group, T)> {
        let Ok(group) = Group::beside_self(&format!("bateleur.{name}_test.{}", std::process::id())) else {
            eprintln!("skipped: no control group of version 2 that may be used here");
            return None;
        };
        match limit(group.as_fd()) {
            Err(error) if error.kind() == io::ErrorKind::PermissionDenied => {
                eprintln!("skipped: no programs for control groups here: {error}");
                None
            }
            made => Some((group, made.unwrap())),
        }
    }

    /// Whether a test passes in a process of its own that was made before it came into the group: sockets belong to the group of who
    /// makes them.
    pub(crate) fn passes_inside(group: &Group, test: &str) -> bool {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", test, "--nocapture"])
            .env(INSIDE, "1")
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        std::fs::write(group.path().join("cgroup.procs"), child.id().to_string()).unwrap();
        drop(child.stdin.take());
        child.wait().unwrap().success()
    }

    /// Whether this is that process; it goes on when it is in the group.
    pub(crate) fn is_inside() -> bool {
        std::env::var_os(INSIDE).is_some() && io::stdin().read_line(&mut String::new()).is_ok()
    }
}
