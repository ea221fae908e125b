//! How many locks of byte ranges a partition may set: the kernel keeps them in memory that no control group counts, and bounds their
//! number nowhere.
//!
//! A filter (seccomp) hands each `fcntl` that may make such a lock to a thread of the executive, which lets the first ones go on as they
//! are and refuses the rest with ENOLCK. It never looks at the arguments in the partition's memory, which the partition may change
//! meanwhile: every call counts, and one call makes three locks at most.
#![allow(unsafe_code)]

use std::io::{self, IoSliceMut};
use std::mem::{MaybeUninit, zeroed};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::sync::Arc;

use crate::thread;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::net::{
    AddressFamily, RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, SocketFlags, SocketType, recvmsg,
    socketpair,
};

/// Where a process that is being started sends what its calls are seen by. The thread that counts lives as long as one of these.
#[derive(Debug, Clone)]
pub struct LockCounter(Arc<OwnedFd>);

impl LockCounter {
    /// Starts the thread that counts.
    ///
    /// # Errors
    /// No sockets or no thread are to be had.
    pub fn start() -> io::Result<Self> {
        let flags = SocketFlags::CLOEXEC;
        let (sender, receiver) = socketpair(AddressFamily::UNIX, SocketType::SEQPACKET, flags, None)?;
        thread::named("lock calls").spawn(move || count_all(&receiver))?;
        Ok(Self(Arc::new(sender)))
    }
}

/// Who counts the calls of a process that is to be started, and how many it may make.
#[derive(Debug, Clone, Copy)]
pub struct LockLimit<'a> {
    /// Who counts.
    pub counter: &'a LockCounter,
    /// Calls that may set a lock, over the life of the process and its children.
    pub calls: u32,
}

impl LockLimit<'_> {
    pub(super) fn sender(&self) -> BorrowedFd<'_> {
        self.counter.0.as_fd()
    }
}

/// Commands of `fcntl` that can make a lock. What removes one can too: it may leave two pieces of a longer one.
const COMMANDS: [libc::c_int; 4] = [libc::F_SETLK, libc::F_SETLKW, libc::F_OFD_SETLK, libc::F_OFD_SETLKW];
/// Where the filter finds a call's number and the lower half of its second argument (`struct seccomp_data`).
const NUMBER: u32 = 0;
const COMMAND: u32 = if cfg!(target_endian = "little") { 24 } else { 28 };
const INSTRUCTIONS: usize = 10;

/// Calls of other architectures end the process in the other filters, whose answers outrank this one's.
fn filter() -> [libc::sock_filter; INSTRUCTIONS] {
    let instruction =
        |code: u32, k: u32, jump: usize| libc::sock_filter { code: code as u16, jt: jump as u8, jf: 0, k };
    let load = |place| instruction(libc::BPF_LD | libc::BPF_W | libc::BPF_ABS, place, 0);
    let jump_if = |value, jump| instruction(libc::BPF_JMP | libc::BPF_JEQ | libc::BPF_K, value, jump);
    let answer = |value| instruction(libc::BPF_RET | libc::BPF_K, value, 0);
    let [first, second, third, fourth] = COMMANDS.map(|command| command.cast_unsigned());
    [
        load(NUMBER),
        jump_if(libc::SYS_fcntl as u32, 1),
        answer(libc::SECCOMP_RET_ALLOW),
        load(COMMAND),
        jump_if(first, 4),
        jump_if(second, 3),
        jump_if(third, 2),
        jump_if(fourth, 1),
        answer(libc::SECCOMP_RET_ALLOW),
        answer(libc::SECCOMP_RET_USER_NOTIF),
    ]
}

/// Puts the filter on the calling thread and sends what its calls are seen by, with `calls`, to the thread at the other end of `counter`.
/// False: refused, as `errno` says.
///
/// # Safety
/// For a child between `clone3` and its program, which has given up gaining privileges.
pub(super) unsafe fn apply(counter: i32, calls: u32) -> bool {
    let mut instructions = filter();
    let program = libc::sock_fprog { len: instructions.len() as u16, filter: instructions.as_mut_ptr() };
    // SAFETY: the kernel reads the program, a local one, and gives a descriptor, which is sent and closed at once.
    unsafe {
        let listener = libc::syscall(
            libc::SYS_seccomp,
            libc::c_ulong::from(libc::SECCOMP_SET_MODE_FILTER),
            libc::SECCOMP_FILTER_FLAG_NEW_LISTENER,
            &raw const program,
        ) as i32;
        listener >= 0 && send(counter, listener, calls) && libc::close(listener) == 0
    }
}

/// Sends a descriptor and a number, without allocating.
unsafe fn send(to: i32, descriptor: i32, number: u32) -> bool {
    let mut bytes = number.to_ne_bytes();
    let mut ancillary = [0_u64; 4];
    let mut part = libc::iovec { iov_base: bytes.as_mut_ptr().cast(), iov_len: bytes.len() };
    // SAFETY: all that the message points to are local arrays of the lengths that are said, aligned as a header of ancillary data is.
    unsafe {
        let mut message: libc::msghdr = zeroed();
        message.msg_iov = &raw mut part;
        message.msg_iovlen = 1;
        message.msg_control = ancillary.as_mut_ptr().cast();
        message.msg_controllen = libc::CMSG_SPACE(size_of::<i32>() as u32) as _;
        let header = libc::CMSG_FIRSTHDR(&raw const message);
        if header.is_null() {
            return false;
        }
        (*header).cmsg_level = libc::SOL_SOCKET;
        (*header).cmsg_type = libc::SCM_RIGHTS;
        (*header).cmsg_len = libc::CMSG_LEN(size_of::<i32>() as u32) as _;
        libc::CMSG_DATA(header).cast::<i32>().write_unaligned(descriptor);
        libc::sendmsg(to, &raw const message, 0) == bytes.len() as isize
    }
}

/// The calls of one process and its children.
#[derive(Debug)]
struct Calls {
    listener: OwnedFd,
    left: u32,
}

/// The life of the thread: until nobody can start a process that it would have to count for.
fn count_all(receiver: &OwnedFd) {
    let mut all: Vec<Calls> = Vec::new();
    loop {
        let listeners = all.iter().map(|calls| PollFd::new(&calls.listener, PollFlags::IN));
        let mut wanted: Vec<_> =
            [PollFd::new(receiver, PollFlags::IN)].into_iter().chain(listeners).collect();
        if poll(&mut wanted, None).is_err() {
            continue; // a signal
        }
        let seen: Vec<PollFlags> = wanted.iter().map(PollFd::revents).collect();
        drop(wanted);
        let mut seen = seen.into_iter();
        let is_asked = seen.next().is_some_and(|flags| !flags.is_empty());
        all.retain_mut(|calls| match seen.next() {
            Some(flags) if flags.contains(PollFlags::IN) => {
                calls.answer();
                true
            }
            // Nobody is left whose calls would be seen here.
            Some(flags) => flags.is_empty(),
            None => true,
        });
        if is_asked {
            match receive(receiver) {
                Ok(Some(calls)) => all.push(calls),
                Ok(None) => return,
                Err(_lost) => {} // no descriptor left: that process has no locks
            }
        }
    }
}

/// What a process that is being started has sent; nothing: there will be no more.
fn receive(receiver: &OwnedFd) -> io::Result<Option<Calls>> {
    let mut bytes = [0; size_of::<u32>()];
    let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(1))];
    let mut ancillary = RecvAncillaryBuffer::new(&mut space);
    let got = recvmsg(receiver, &mut [IoSliceMut::new(&mut bytes)], &mut ancillary, RecvFlags::CMSG_CLOEXEC)?;
    if got.bytes == 0 {
        return Ok(None);
    }
    let descriptors = ancillary.drain().filter_map(|message| match message {
        RecvAncillaryMessage::ScmRights(descriptors) => Some(descriptors),
        _ => None,
    });
    let listener = descriptors.flatten().next().ok_or(io::ErrorKind::InvalidData)?;
    Ok(Some(Calls { listener, left: u32::from_ne_bytes(bytes) }))
}

impl Calls {
    /// Answers one call that waits. It can be gone: its thread was ended.
    fn answer(&mut self) {
        // As long as the kernel's, which may have grown since this was written.
        let mut asked = [0_u64; 32];
        // SAFETY: the kernel writes its structure, of 80 bytes today, into an array of zeros that is longer.
        let got = unsafe {
            libc::ioctl(self.listener.as_raw_fd(), libc::SECCOMP_IOCTL_NOTIF_RECV, asked.as_mut_ptr())
        };
        if got != 0 {
            return;
        }
        let goes_on = self.left > 0;
        self.left = self.left.saturating_sub(1);
        let answer = libc::seccomp_notif_resp {
            id: asked[0], // the structure begins with it
            val: 0,
            error: if goes_on { 0 } else { -libc::ENOLCK },
            flags: if goes_on { libc::SECCOMP_USER_NOTIF_FLAG_CONTINUE as u32 } else { 0 },
        };
        // SAFETY: the kernel reads a structure of its own shape.
        unsafe {
            libc::ioctl(self.listener.as_raw_fd(), libc::SECCOMP_IOCTL_NOTIF_SEND, &raw const answer);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs::File;

    use super::*;
    use crate::spawn::{Request, Walls, spawn};
    use crate::wait::{await_any_end, ended};

    /// Set in the process whose calls are counted.
    const INSIDE: &str = "BATELEUR_TEST_LOCK_CALLS";
    const CALLS: u32 = 50;

    fn lock(file: &File, command: libc::c_int, kind: libc::c_int, start: i64) -> Result<(), i32> {
        // SAFETY: plain data, for which zero is a value.
        let mut range: libc::flock = unsafe { zeroed() };
        (range.l_type, range.l_start, range.l_len) = (kind as libc::c_short, start, 1);
        // SAFETY: a descriptor that is open, and a local structure.
        let done = unsafe { libc::fcntl(file.as_raw_fd(), command, &raw mut range) };
        if done == 0 { Ok(()) } else { Err(io::Error::last_os_error().raw_os_error().unwrap_or(0)) }
    }

    #[test]
    fn process_that_is_counted_sets_as_many_locks_as_it_may_with_its_children_by_any_command() {
        if std::env::var_os(INSIDE).is_none() {
            return;
        }
        let file = tempfile::tempfile().unwrap();
        let commands = [libc::F_SETLK, libc::F_OFD_SETLK, libc::F_SETLKW, libc::F_OFD_SETLKW];
        let set = |first: u32, count: u32| {
            let lock =
                |n: u32| lock(&file, commands[n as usize % 4], libc::F_WRLCK, 2 * i64::from(first + n));
            (0..count).filter(|n| lock(*n).is_ok()).count()
        };
        assert_eq!(set(0, CALLS / 2), CALLS as usize / 2);
        // SAFETY: the child makes system calls and ends.
        let child = unsafe { libc::fork() };
        if child == 0 {
            let own = set(1_000, CALLS / 2 - 1);
            // SAFETY: ends the child.
            unsafe { libc::_exit(own as i32) }
        }
        let mut status = 0;
        // SAFETY: a child of this process, and a local number.
        unsafe { libc::waitpid(child, &raw mut status, 0) };
        assert_eq!(libc::WEXITSTATUS(status) as u32, CALLS / 2 - 1);
        assert_eq!(lock(&file, libc::F_SETLK, libc::F_UNLCK, 0), Ok(()), "the last call that is let through");
        for command in commands {
            assert_eq!(lock(&file, command, libc::F_WRLCK, 1 << 20), Err(libc::ENOLCK));
        }
        assert_eq!(lock(&file, libc::F_GETLK, libc::F_WRLCK, 1 << 20), Ok(()), "questions are free");
        std::process::exit(77); // seen by who started it
    }

    #[test]
    fn one_thread_counts_for_each_process_apart_and_ends_with_the_last_who_could_start_one() {
        let counter = LockCounter::start().unwrap();
        let nothing = File::options().write(true).open("/dev/null").unwrap();
        let test = "lock_calls::tests::process_that_is_counted_sets_as_many_locks_as_it_may_with_its_children_by_any_command";
        let start = || {
            spawn(&Request {
                program: &std::env::current_exe().unwrap(),
                arguments: &["--exact".into(), test.into(), "--nocapture".into()],
                environment: &[format!("{INSIDE}=1")],
                descriptors: &[],
                input: None,
                output: None,
                errors: nothing.as_fd(),
                group: None,
                walls: Walls {
                    locks: Some(LockLimit { counter: &counter, calls: CALLS }),
                    ..Walls::default()
                },
                user: None,
                dies_with_starter: false,
            })
            .unwrap()
        };
        let processes = [start(), start(), start()];
        for process in processes {
            assert!(await_any_end(&[process.pidfd.as_fd()], 60_000_000_000));
            assert_eq!(ended(&process).unwrap().code(), Some(77));
        }
        let counts = || {
            let threads = std::fs::read_dir("/proc/self/task").unwrap().flatten();
            let names = threads.filter_map(|thread| std::fs::read_to_string(thread.path().join("comm")).ok());
            names.filter(|name| name.trim() == "lock calls").count()
        };
        assert_eq!(counts(), 1);
        drop(counter);
        while counts() > 0 {
            std::thread::yield_now(); // for ever where it does not end
        }
    }
}
