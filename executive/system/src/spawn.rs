//! Starting a process in a sandbox: `clone3` into its control group and namespaces, then limits, then another user.
//!
//! Between `clone3` and `execveat` the child runs in a copy of a process with several threads, so it makes system
//! calls on memory that was prepared before and does nothing else: no allocation, no lock, no formatting.
#![allow(unsafe_code)]

use std::ffi::{CStr, CString, OsStr};
use std::fs::File;
use std::io::{self, Read};
use std::mem::zeroed;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, FromRawFd, OwnedFd};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use rustix::pipe::{PipeFlags, pipe_with};

use super::filter::Filters;
use super::lock_calls::{self, LockLimit};
use super::time::now_ns;
use super::users::HELPERS;
pub use super::users::User;
use super::view::View;
pub use super::wait::Spawned;
use super::{cpu_starvation, rules};

/// `clone3` only; the C library's binding is too narrow for it.
const CLONE_INTO_CGROUP: u64 = 0x2_0000_0000;

/// What is shut off from a process. Each flag but the first needs privileges that a machine may not give, or the first.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Namespaces {
    /// A user namespace, in which an ordinary user has the privileges for the others. Its one user number stands for the executive's.
    pub user: bool,
    /// A mount namespace whose tree is read-only but for the channels, and whose `/dev/shm` holds nothing else.
    pub mount: bool,
    /// A network namespace without any interface.
    pub network: bool,
    /// System V objects and POSIX queues of its own.
    pub ipc: bool,
    /// A host name of its own.
    pub uts: bool,
    /// Process numbers of its own: it can signal nobody else.
    pub pid: bool,
}

impl Namespaces {
    fn flags(self) -> u64 {
        let pairs = [
            (self.user, libc::CLONE_NEWUSER),
            (self.mount, libc::CLONE_NEWNS),
            (self.network, libc::CLONE_NEWNET),
            (self.ipc, libc::CLONE_NEWIPC),
            (self.uts, libc::CLONE_NEWUTS),
            (self.pid, libc::CLONE_NEWPID),
        ];
        pairs.iter().filter(|(wanted, _)| *wanted).fold(0, |flags, (_, flag)| flags | *flag as u64)
    }
}

/// What is shut off from a process, and what it may use. By default nothing is.
#[derive(Debug, Default)]
pub struct Walls<'a> {
    /// What is shut off from it.
    pub namespaces: Namespaces,
    /// Directories below `/dev/shm` that it sees and may write, in a mount namespace of its own.
    pub channels: &'a [PathBuf],
    /// Which system calls it may make; `None`: all.
    pub filters: Option<&'a Filters>,
    /// How many locks of byte ranges it may set; `None`: any number.
    pub locks: Option<LockLimit<'a>>,
    /// Which files it may open (see [`super::rules`]); `None`: what its user may.
    pub rules: Option<BorrowedFd<'a>>,
    /// Files through which it joins further groups.
    pub entrances: &'a [File],
    /// Limit of its data, bytes; 0: none.
    pub data_limit: u64,
    /// Limit of each file that it writes, bytes; 0: none.
    pub file_limit: u64,
    /// Limits of what the kernel counts for a process or its user; `None`: those of the executive.
    pub counts: Option<Counts>,
}

/// Limits of what the kernel keeps for a process or its user beside its memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Counts {
    /// Descriptors that it may have open.
    pub descriptors: u64,
    /// Signals and timers that may wait (`RLIMIT_SIGPENDING`).
    pub signals: u64,
    /// Bytes of POSIX message queues.
    pub queues: u64,
}

/// A process to start.
#[derive(Debug)]
pub struct Request<'a> {
    /// The program's file.
    pub program: &'a Path,
    /// Its arguments after the name.
    pub arguments: &'a [String],
    /// Its whole environment, `NAME=value`.
    pub environment: &'a [String],
    /// What it finds at descriptors 3, 4, …
    pub descriptors: &'a [BorrowedFd<'a>],
    /// What it finds at descriptor 0; else nothing to read.
    pub input: Option<BorrowedFd<'a>>,
    /// What it finds at descriptor 1; else the same as 2.
    pub output: Option<BorrowedFd<'a>>,
    /// What it finds at descriptor 2.
    pub errors: BorrowedFd<'a>,
    /// The control group that it starts in.
    pub group: Option<BorrowedFd<'a>>,
    /// What is shut off from it, and what it may use.
    pub walls: Walls<'a>,
    /// Whom it becomes; `None`: whoever the executive is.
    pub user: Option<User>,
    /// Whether it is killed when the thread that starts it ends.
    pub dies_with_starter: bool,
}

/// How far a child had come when it failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
enum Step {
    Descriptors = 1,
    Groups,
    Session,
    UserNamespace,
    Mounts,
    Limits,
    User,
    Privileges,
    Rules,
    Filters,
    Execute,
}

impl Step {
    fn text(number: u8) -> &'static str {
        const TEXTS: [&str; 11] = [
            "arranging its descriptors",
            "joining its control groups",
            "opening its session",
            "mapping its user",
            "making its view of the file system",
            "setting its limits",
            "changing its user",
            "giving up privileges",
            "restricting it to its files",
            "restricting it to its system calls",
            "executing it",
        ];
        TEXTS.get(usize::from(number).wrapping_sub(1)).copied().unwrap_or("starting it")
    }
}

/// Everything the child needs, made before there is a child.
struct Prepared<'a> {
    program: OwnedFd,
    filters: Option<&'a Filters>,
    /// Who counts its locks of byte ranges, and how many there may be.
    locks: Option<(OwnedFd, u32)>,
    rules: Option<OwnedFd>,
    _strings: Vec<CString>,
    arguments: Vec<*const libc::c_char>,
    environment: Vec<*const libc::c_char>,
    descriptors: Vec<i32>,
    input: OwnedFd,
    output: i32,
    errors: i32,
    user: Option<User>,
    /// What user and group number stand for in a user namespace of its own.
    maps: Option<[CString; 2]>,
    view: Option<View>,
    entrances: Vec<i32>,
    data_limit: u64,
    file_limit: u64,
    counts: Option<Counts>,
    dies_with_starter: bool,
    trouble: i32,
}

/// Starts a process.
///
/// # Errors
/// What the kernel refused, and at which step.
pub fn spawn(request: &Request<'_>) -> io::Result<Spawned> {
    let (reader, low_writer) = pipe_with(PipeFlags::CLOEXEC)?;
    let writer = rustix::io::fcntl_dupfd_cloexec(&low_writer, OUT_OF_THE_WAY)?;
    drop(low_writer);
    let prepared = prepare(request, writer.as_raw_fd())?;
    let mut pidfd: i32 = -1;
    // SAFETY: `clone_args` is plain data, all zero is "nothing asked for".
    let mut arguments: libc::clone_args = unsafe { zeroed() };
    arguments.flags = libc::CLONE_PIDFD as u64 | request.walls.namespaces.flags();
    arguments.pidfd = (&raw mut pidfd) as u64;
    arguments.exit_signal = libc::SIGCHLD as u64;
    if let Some(group) = request.group {
        arguments.flags |= CLONE_INTO_CGROUP;
        arguments.cgroup = group.as_raw_fd() as u64;
    }
    // SAFETY: without CLONE_VM the child has a copy of the address space; it only runs `child`, which keeps to
    // async-signal-safe calls and never returns.
    let pid = unsafe { libc::syscall(libc::SYS_clone3, &raw mut arguments, size_of::<libc::clone_args>()) };
    match pid {
        -1 => Err(io::Error::last_os_error()),
        0 => child(&prepared),
        _ => {
            drop(writer);
            // SAFETY: the kernel stored a new descriptor there, which nobody else owns.
            let pidfd = unsafe { OwnedFd::from_raw_fd(pidfd) };
            confirm(reader, pidfd, pid as i32)
        }
    }
}

/// How long a child may take to its program, waits for a processor apart. One that is held before (a frozen group, a file
/// system that does not answer) must not hold the executive.
const START_PATIENCE_NS: u64 = 2_000_000_000;
/// The same with such waits, for the executive waits too.
const STARVED_PATIENCE_NS: u64 = 10_000_000_000;

/// Whether a child says how it came to its program.
fn speaks_in_time(reader: &OwnedFd, pid: i32) -> bool {
    let begun_ns = now_ns();
    loop {
        crate::wait::await_any_end(&[reader.as_fd()], START_PATIENCE_NS);
        if crate::wait::is_readable(reader.as_fd()) {
            return true;
        }
        let elapsed_ns = now_ns().saturating_sub(begun_ns);
        if cpu_starvation::has_had(pid, elapsed_ns, START_PATIENCE_NS, STARVED_PATIENCE_NS) {
            return false;
        }
    }
}

fn confirm(reader: OwnedFd, pidfd: OwnedFd, pid: i32) -> io::Result<Spawned> {
    let mut trouble = [0; 5];
    if !speaks_in_time(&reader, pid) {
        let _ = rustix::process::pidfd_send_signal(&pidfd, rustix::process::Signal::KILL); // ended already
        crate::wait::await_any_end(&[pidfd.as_fd()], START_PATIENCE_NS);
        let _ = crate::wait::ended(&Spawned { pid, pidfd });
        return Err(io::Error::new(io::ErrorKind::TimedOut, "it did not come as far as its program"));
    }
    match File::from(reader).read(&mut trouble)? {
        5 => {
            let _ = rustix::process::waitid(
                rustix::process::WaitId::PidFd(pidfd.as_fd()),
                rustix::process::WaitIdOptions::EXITED,
            );
            let code = i32::from_le_bytes([trouble[1], trouble[2], trouble[3], trouble[4]]);
            let error = io::Error::from_raw_os_error(code);
            Err(io::Error::new(error.kind(), format!("{} failed: {error}", Step::text(trouble[0]))))
        }
        _ => Ok(Spawned { pid, pidfd }),
    }
}

/// Lowest number of the descriptors that must not be overwritten while the child arranges its first ones.
const OUT_OF_THE_WAY: i32 = 100;

fn prepare<'a>(request: &Request<'a>, trouble: i32) -> io::Result<Prepared<'a>> {
    let low_program = rustix::fs::open(
        request.program,
        rustix::fs::OFlags::PATH | rustix::fs::OFlags::CLOEXEC,
        rustix::fs::Mode::empty(),
    )
    .map_err(|error| {
        let error = io::Error::from(error);
        io::Error::new(error.kind(), format!("{}: {error}", request.program.display()))
    })?;
    let program = rustix::io::fcntl_dupfd_cloexec(low_program, OUT_OF_THE_WAY)?;
    let name = request.program.file_name().unwrap_or(OsStr::new("partition")).as_bytes();
    let mut strings = vec![CString::new(name)?];
    for text in request.arguments.iter().chain(request.environment) {
        strings.push(CString::new(text.as_str())?);
    }
    let (arguments, environment) = strings.split_at(1 + request.arguments.len());
    let pointers =
        |list: &[CString]| list.iter().map(|text| text.as_ptr()).chain([std::ptr::null()]).collect();
    let input = match request.input {
        Some(input) => input.try_clone_to_owned()?,
        None => File::open("/dev/null")?.into(),
    };
    let walls = &request.walls;
    let out_of_the_way = |descriptor| rustix::io::fcntl_dupfd_cloexec(descriptor, OUT_OF_THE_WAY);
    let rules = walls.rules.map(out_of_the_way).transpose()?;
    let locks = match walls.locks {
        Some(limit) => Some((out_of_the_way(limit.sender())?, limit.calls)),
        None => None,
    };
    Ok(Prepared {
        program,
        filters: walls.filters,
        locks,
        rules,
        arguments: pointers(arguments),
        environment: pointers(environment),
        _strings: strings,
        descriptors: request.descriptors.iter().map(AsRawFd::as_raw_fd).collect(),
        input,
        output: request.output.map_or(request.errors.as_raw_fd(), |output| output.as_raw_fd()),
        errors: request.errors.as_raw_fd(),
        user: request.user.clone(),
        maps: walls.namespaces.user.then(user_maps).transpose()?,
        view: walls.namespaces.mount.then(|| View::new(walls.channels)).transpose()?,
        entrances: walls.entrances.iter().map(AsRawFd::as_raw_fd).collect(),
        data_limit: walls.data_limit,
        file_limit: walls.file_limit,
        counts: walls.counts,
        dies_with_starter: request.dies_with_starter,
        trouble,
    })
}

/// The child: from here to its program. Reports the step and the error through the pipe when something fails.
fn child(prepared: &Prepared<'_>) -> ! {
    let step = become_program(prepared);
    let mut report = [step as u8, 0, 0, 0, 0];
    report[1..].copy_from_slice(&errno().to_le_bytes());
    // SAFETY: writes five bytes of a local array, then ends the process without running any destructor.
    unsafe {
        libc::write(prepared.trouble, report.as_ptr().cast(), report.len());
        libc::_exit(127)
    }
}

fn errno() -> i32 {
    // SAFETY: the location is this thread's own.
    unsafe { *libc::__errno_location() }
}

fn become_program(prepared: &Prepared<'_>) -> Step {
    // SAFETY: each function below makes system calls only, on data of `prepared`, which outlives them.
    unsafe {
        // Before the descriptors, which are put in the place of others.
        if !prepared.entrances.iter().all(|entrance| libc::write(*entrance, c"0".as_ptr().cast(), 1) == 1) {
            return Step::Groups;
        }
        if !arrange_descriptors(prepared) {
            return Step::Descriptors;
        }
        if libc::setsid() < 0 {
            return Step::Session;
        }
        if prepared.maps.as_ref().is_some_and(|maps| !map_user(maps)) {
            return Step::UserNamespace;
        }
        // Whatever the executive's is. The ends of a channel are users of their own: what lies in its directory is for all that
        // reach the directory. The executive's own user makes nothing that others may write.
        libc::umask(if prepared.user.is_some() { 0 } else { 0o022 });
        if prepared.view.as_ref().is_some_and(|view| !view.enter()) {
            return Step::Mounts;
        }
        if !set_limits(prepared) {
            return Step::Limits;
        }
        if !change_user(prepared) {
            return Step::User;
        }
        if !give_up_privileges(prepared) {
            return Step::Privileges;
        }
        if prepared.rules.as_ref().is_some_and(|rules| !rules::apply(rules.as_raw_fd())) {
            return Step::Rules;
        }
        if prepared.locks.as_ref().is_some_and(|(to, calls)| !lock_calls::apply(to.as_raw_fd(), *calls)) {
            return Step::Filters;
        }
        // After the last descriptor that is opened here, beside the hundreds of an executive of many partitions.
        if let Some(counts) = prepared.counts {
            limit(libc::RLIMIT_NOFILE, counts.descriptors);
        }
        // Last of all: what follows is on the list of what is allowed.
        if prepared.filters.is_some_and(|filters| !filters.apply()) {
            return Step::Filters;
        }
        libc::syscall(
            libc::SYS_execveat,
            prepared.program.as_raw_fd(),
            c"".as_ptr(),
            prepared.arguments.as_ptr(),
            prepared.environment.as_ptr(),
            libc::AT_EMPTY_PATH,
        );
        Step::Execute
    }
}

/// The lines of `uid_map` and `gid_map`: a number that is not 0 loses every privilege in the namespace with its program.
fn user_maps() -> io::Result<[CString; 2]> {
    let own = [rustix::process::geteuid().as_raw(), rustix::process::getegid().as_raw()];
    let [user, group] = own.map(|own| CString::new(format!("{HELPERS} {own} 1")));
    Ok([user?, group?])
}

/// Says what the numbers in the new user namespace stand for.
unsafe fn map_user(maps: &[CString; 2]) -> bool {
    let write = |path: &CStr, text: &CStr| {
        // SAFETY: texts that outlive the calls.
        unsafe {
            let file = libc::open(path.as_ptr(), libc::O_WRONLY | libc::O_CLOEXEC);
            let length = text.count_bytes();
            file >= 0
                && libc::write(file, text.as_ptr().cast(), length) == length as isize
                && libc::close(file) == 0
        }
    };
    // Without the first, nobody but root may say the group.
    write(c"/proc/self/setgroups", c"deny")
        && write(c"/proc/self/uid_map", &maps[0])
        && write(c"/proc/self/gid_map", &maps[1])
}

/// Puts every descriptor where the contract wants it, out of the way first so that none overwrites another.
unsafe fn arrange_descriptors(prepared: &Prepared<'_>) -> bool {
    let standard = [prepared.input.as_raw_fd(), prepared.output, prepared.errors];
    let rules = prepared.rules.as_ref().map_or(-1, AsRawFd::as_raw_fd);
    let locks = prepared.locks.as_ref().map_or(-1, |(to, _)| to.as_raw_fd());
    let kept = [prepared.program.as_raw_fd(), prepared.trouble, rules, locks];
    // Above all that is still needed: an executive of many partitions has hundreds of descriptors open.
    let mut aside = OUT_OF_THE_WAY;
    for number in standard.iter().chain(&prepared.descriptors).chain(&kept) {
        aside = aside.max(*number + 1);
    }
    // SAFETY: descriptor numbers only; the caller owns the process.
    unsafe {
        for (place, from) in standard.iter().chain(&prepared.descriptors).enumerate() {
            if libc::dup3(*from, aside + place as i32, libc::O_CLOEXEC) < 0 {
                return false;
            }
        }
        let count = standard.len() + prepared.descriptors.len();
        for place in 0..count as i32 {
            if libc::dup2(aside + place, place) < 0 {
                return false;
            }
        }
        libc::syscall(libc::SYS_close_range, count as u32, u32::MAX, libc::CLOSE_RANGE_CLOEXEC) == 0
    }
}

/// Limits the process to `value`, or to what it was limited to already: who may not raise what whoever started the executive has lowered
/// keeps that.
fn limit(what: libc::__rlimit_resource_t, value: u64) -> bool {
    let mut limit = libc::rlimit { rlim_cur: value, rlim_max: value };
    // SAFETY: a local structure, not kept.
    let set = |limit: &libc::rlimit| unsafe { libc::setrlimit(what, &raw const *limit) == 0 };
    // SAFETY: as above.
    let lower = |limit: &mut libc::rlimit| unsafe { libc::getrlimit(what, &raw mut *limit) == 0 };
    set(&limit)
        || (lower(&mut limit) && limit.rlim_max < value && {
            limit.rlim_cur = limit.rlim_max;
            set(&limit)
        })
}

fn set_limits(prepared: &Prepared<'_>) -> bool {
    let data = prepared.data_limit == 0 || limit(libc::RLIMIT_DATA, prepared.data_limit);
    let files = prepared.file_limit == 0 || limit(libc::RLIMIT_FSIZE, prepared.file_limit);
    // Without privileges the hard limits may be lower already: lowering what can be lowered is all there is.
    if let Some(counts) = prepared.counts {
        limit(libc::RLIMIT_SIGPENDING, counts.signals);
        limit(libc::RLIMIT_MSGQUEUE, counts.queues);
    }
    if prepared.user.is_some() {
        limit(libc::RLIMIT_MEMLOCK, libc::RLIM_INFINITY);
        limit(libc::RLIMIT_RTPRIO, 0);
    }
    data && files && limit(libc::RLIMIT_CORE, 0)
}

unsafe fn change_user(prepared: &Prepared<'_>) -> bool {
    let Some(user) = &prepared.user else { return true };
    // SAFETY: plain system calls; the raw ones, because the library's would signal threads that the child has not.
    unsafe {
        libc::syscall(libc::SYS_setgroups, user.groups.len(), user.groups.as_ptr()) == 0
            && libc::syscall(libc::SYS_setresgid, user.group, user.group, user.group) == 0
            && libc::syscall(libc::SYS_setresuid, user.id, user.id, user.id) == 0
    }
}

unsafe fn give_up_privileges(prepared: &Prepared<'_>) -> bool {
    // SAFETY: plain system calls on numbers and a local set.
    unsafe {
        // After the change of user, which would clear it.
        if prepared.dies_with_starter && libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGKILL) != 0 {
            return false;
        }
        let mut none: libc::sigset_t = zeroed();
        libc::sigemptyset(&raw mut none);
        libc::sigprocmask(libc::SIG_SETMASK, &raw const none, std::ptr::null_mut());
        libc::prctl(libc::PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0
    }
}
