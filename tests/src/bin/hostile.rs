//! A partition that has been taken over: in one window of its first incarnation it makes the `attempt` that it is told, once,
//! and reports what came of it. What ends it shows in the health log.
//!
//! Paths come as "path:/…": a file that an attribute names is granted.
#![allow(unsafe_code)] // that is what it is for

use std::fs;
use std::io;
use std::process::ExitCode;

use bateleur_apex::{Context, Partition, PortKind, SamplingSource, StartError, Window};
use bateleur_messages::FunctionStatus;

struct Hostile {
    attempt: String,
    target: String,
    windows_left: u32,
    _sources: Vec<SamplingSource<FunctionStatus>>,
}

impl Partition for Hostile {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let names = context.port_names(PortKind::Sampling, bateleur_apex::Direction::Source);
        let sources = names.iter().map(|name| context.sampling_source(name)).collect::<Result<_, _>>()?;
        let target = context.attribute("target", String::new())?;
        let first = context.generation() == 0;
        Ok(Self {
            attempt: context.attribute("attempt", String::new())?,
            target: target.strip_prefix("path:").unwrap_or_default().to_owned(),
            windows_left: if first { 5 } else { 0 },
            _sources: sources,
        })
    }

    fn window(&mut self, window: &Window) {
        if self.attempt == "chatter" {
            let _ = io::Write::write_all(&mut io::stderr(), &[b'.'; 128 << 10]); // it goes on, whatever comes of it
            return;
        }
        self.windows_left = match self.windows_left {
            0 => return,
            1 => {
                window.report(&format!("came of it: {}", attempt(&self.attempt, &self.target)));
                0
            }
            left => left - 1,
        };
    }
}

/// What came of an attempt, in words.
fn attempt(name: &str, target: &str) -> String {
    match name {
        "read" => said(fs::read(target).map(|bytes| format!("{} bytes", bytes.len()))),
        "list" => said(list(target).map(|names| names.join(" "))),
        "channels" => channels().unwrap_or_else(|error| errno(&error)),
        "write" => said(fs::write(target, "hostile").map(|()| "written".into())),
        "append" => {
            let file = fs::OpenOptions::new().append(true).open(target);
            said(file.map(|_| "opened".into()))
        }
        "look" => neighbours().map_or_else(|error| errno(&error), |all| look_at(&all)),
        "signal" => neighbours().map_or_else(|error| errno(&error), |all| signal(&all)),
        "numbers" => numbers(),
        "interfaces" => said(fs::read_to_string("/proc/self/net/dev").map(|text| interfaces(&text))),
        "memory" => exhaust(),
        "babble" => babble(4 << 20),
        "flood" => babble(200 << 20),
        "stretch" => stretch(),
        "handle" => handle(),
        "fork" => forks(),
        "threads" => threads(),
        "udp" => said(std::net::UdpSocket::bind("127.0.0.1:0").map(|_| "bound".into())),
        "connect" => said(std::net::TcpStream::connect("127.0.0.1:22").map(|_| "connected".into())),
        call => dangerous(call),
    }
}

fn said(result: io::Result<String>) -> String {
    match result {
        Ok(text) => format!("[{text}]"),
        Err(error) => errno(&error),
    }
}

fn errno(error: &io::Error) -> String {
    let name = match error.raw_os_error() {
        Some(libc::EPERM) => "EPERM",
        Some(libc::ENOENT) => "ENOENT",
        Some(libc::ESRCH) => "ESRCH",
        Some(libc::EACCES) => "EACCES",
        Some(libc::EROFS) => "EROFS",
        Some(libc::ENOSYS) => "ENOSYS",
        Some(libc::EAGAIN) => "EAGAIN",
        Some(libc::ECONNREFUSED) => "ECONNREFUSED",
        _ => return error.to_string(),
    };
    format!("refused {name}")
}

fn list(folder: &str) -> io::Result<Vec<String>> {
    let mut names: Vec<_> = fs::read_dir(folder)?
        .flatten()
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort_unstable();
    Ok(names)
}

/// Who and which process it is, as it sees itself.
fn numbers() -> String {
    // SAFETY: both calls only tell.
    format!("user {}, process {}", unsafe { libc::getuid() }, unsafe { libc::getpid() })
}

/// The names of the network's interfaces: what stands before a colon.
fn interfaces(table: &str) -> String {
    let names = table.lines().filter_map(|line| line.split_once(':')).map(|(name, _)| name.trim());
    names.collect::<Vec<_>>().join(" ")
}

/// The channels of its module, beside its own, whose place it knows.
fn channels() -> io::Result<String> {
    let maps = fs::read_to_string("/proc/self/maps")?;
    let root = maps
        .lines()
        .find_map(|line| line.split_once("/dev/shm/")?.1.split_once("/ports/"))
        .map(|found| found.0);
    let ports = format!("/dev/shm/{}/ports", root.ok_or(io::ErrorKind::NotFound)?);
    let listed = said(list(&ports).map(|names| names.join(" ")));
    let opened = said(list(&format!("{ports}/before.count")).map(|names| names.join(" ")));
    Ok(format!("list {listed}, open {opened}"))
}

/// Numbers, as the machine sees them, of the executive and of what was started about when this process was.
fn neighbours() -> io::Result<Vec<i32>> {
    let status = fs::read_to_string("/proc/self/status")?;
    let number = |key: &str| {
        let line = status.lines().find_map(|line| line.strip_prefix(key));
        line.and_then(|text| text.trim().parse::<i32>().ok()).ok_or(io::ErrorKind::NotFound)
    };
    let (own, executive) = (number("Pid:")?, number("PPid:")?);
    let near = (own - 60..own + 60).filter(|pid| *pid > 1 && *pid != own);
    Ok([executive].into_iter().chain(near).collect())
}

/// What of other processes can be read.
fn look_at(processes: &[i32]) -> String {
    let files = ["status", "cmdline", "environ", "maps", "mem", "fd", "root/etc/passwd"];
    let paths = processes.iter().flat_map(|pid| files.map(|file| format!("/proc/{pid}/{file}")));
    let open = |path: &String| fs::File::open(path).is_ok();
    let opened: Vec<_> = paths.filter(open).collect();
    format!("opened {}", opened.len())
}

/// How many other processes a signal reaches.
fn signal(processes: &[i32]) -> String {
    // SAFETY: signal 0 only asks whether it could be sent.
    let reached = processes.iter().filter(|pid| unsafe { libc::kill(**pid, 0) } == 0).count();
    format!("reached {reached}")
}

/// Touches far more than any test grants.
fn exhaust() -> String {
    let mut block = vec![0_u8; 512 << 20];
    block.iter_mut().step_by(4096).for_each(|byte| *byte = 1);
    format!("touched {} bytes", std::hint::black_box(&block).len())
}

fn babble(bytes: usize) -> String {
    let block = [b'.'; 64 << 10];
    let all = (0..bytes / block.len()).all(|_| io::Write::write_all(&mut io::stderr(), &block).is_ok());
    if all { format!("wrote {} KiB", bytes >> 10) } else { "could not write".into() }
}

/// Takes a signal that would end it.
fn handle() -> String {
    extern "C" fn ignore(_: libc::c_int) {}
    // SAFETY: the handler does nothing.
    let before = unsafe { libc::signal(libc::SIGUSR1, ignore as *const () as libc::sighandler_t) };
    if before == libc::SIG_ERR { "no handler" } else { "has a handler" }.into()
}

/// Has the place behind its standard error grow by anything but writing at its end.
fn stretch() -> String {
    const FAR: i64 = 1 << 30;
    let page = 4096;
    // SAFETY: plain calls on a descriptor; a mapping, where there is one, is not touched.
    let calls = unsafe {
        [
            libc::fallocate(2, libc::FALLOC_FL_KEEP_SIZE, 0, FAR) == 0,
            libc::posix_fallocate(2, 0, FAR) == 0,
            libc::ftruncate(2, FAR) == 0,
            libc::pwrite(2, c"x".as_ptr().cast(), 1, FAR) == 1,
            libc::lseek(2, FAR, libc::SEEK_SET) == FAR,
            libc::mmap(std::ptr::null_mut(), page, libc::PROT_WRITE, libc::MAP_SHARED, 2, 0)
                != libc::MAP_FAILED,
        ]
    };
    format!("{} of {} worked", calls.iter().filter(|worked| **worked).count(), calls.len())
}

/// Forks until it is refused; the children stay.
fn forks() -> String {
    for count in 0..1000 {
        // SAFETY: the process has one thread; the child only waits for its end.
        match unsafe { libc::fork() } {
            -1 => return format!("{count} forked, then {}", errno(&io::Error::last_os_error())),
            0 => loop {
                std::thread::sleep(std::time::Duration::from_secs(1));
            },
            _ => {}
        }
    }
    "1000 forked".into()
}

fn threads() -> String {
    for count in 0..1000 {
        let thread = std::thread::Builder::new().stack_size(64 << 10).spawn(|| {
            loop {
                std::thread::park();
            }
        });
        if let Err(error) = thread {
            return format!("{count} started, then {}", errno(&error));
        }
    }
    "1000 started".into()
}

/// One system call, with arguments that make it do nothing where it is allowed.
fn dangerous(name: &str) -> String {
    let (zero, mut id): (libc::c_long, libc::c_int) = (0, 0);
    let socket = |family: i32, kind: i32| (libc::SYS_socket, [family.into(), kind.into(), zero]);
    let (call, arguments) = match name {
        "setsid" => (libc::SYS_setsid, [zero; 3]),
        "setuid" => (libc::SYS_setuid, [zero; 3]),
        "death" => (libc::SYS_prctl, [libc::PR_SET_PDEATHSIG.into(), zero, zero]),
        "type" => (libc::SYS_ioctl, [zero, 0x5412, zero]),
        "affinity" => (libc::SYS_sched_setaffinity, [zero; 3]),
        "class" => (libc::SYS_sched_setscheduler, [zero; 3]),
        "attributes" => (libc::SYS_sched_setattr, [zero; 3]),
        "priority" => (libc::SYS_setpriority, [zero; 3]),
        "ptrace" => (libc::SYS_ptrace, [zero; 3]),
        "process_vm" => (libc::SYS_process_vm_readv, [1, zero, zero]),
        "mount" => (libc::SYS_mount, [zero; 3]),
        "open_tree" => (libc::SYS_open_tree, [zero; 3]),
        "chroot" => (libc::SYS_chroot, [zero; 3]),
        "setns" => (libc::SYS_setns, [zero; 3]),
        "unshare" => (libc::SYS_unshare, [libc::CLONE_NEWUSER.into(), zero, zero]),
        "bpf" => (libc::SYS_bpf, [zero; 3]),
        "perf" => (libc::SYS_perf_event_open, [zero; 3]),
        "keyctl" => (libc::SYS_keyctl, [zero; 3]),
        "io_uring" => (libc::SYS_io_uring_setup, [zero; 3]),
        "userfaultfd" => (libc::SYS_userfaultfd, [zero; 3]),
        "kexec" => (libc::SYS_kexec_load, [zero; 3]),
        "reboot" => (libc::SYS_reboot, [zero; 3]),
        "module" => (libc::SYS_init_module, [zero; 3]),
        "personality" => (libc::SYS_personality, [zero; 3]),
        "clock" => (libc::SYS_clock_settime, [zero; 3]),
        "inet" => socket(libc::AF_INET, libc::SOCK_DGRAM),
        "inet6" => socket(libc::AF_INET6, libc::SOCK_STREAM),
        "raw" => socket(libc::AF_INET, libc::SOCK_RAW),
        "packet" => socket(libc::AF_PACKET, libc::SOCK_RAW),
        "vsock" => socket(libc::AF_VSOCK, libc::SOCK_STREAM),
        "alg" => socket(libc::AF_ALG, libc::SOCK_SEQPACKET),
        "netlink" => socket(libc::AF_NETLINK, libc::SOCK_RAW),
        "unix" => socket(libc::AF_UNIX, libc::SOCK_STREAM),
        "namespace" => (libc::SYS_clone, [(libc::CLONE_NEWUSER | libc::SIGCHLD).into(), zero, zero]),
        "unknown" => (100_000, [zero; 3]),
        "timer" => {
            (libc::SYS_timer_create, [libc::CLOCK_MONOTONIC.into(), zero, (&raw mut id) as libc::c_long])
        }
        "timerfd" => (libc::SYS_timerfd_create, [libc::CLOCK_MONOTONIC.into(), zero, zero]),
        "inotify" => (libc::SYS_inotify_init1, [zero; 3]),
        "reserve" => (libc::SYS_fallocate, [2, libc::FALLOC_FL_KEEP_SIZE.into(), zero]),
        "mode" => (libc::SYS_fchmod, [0, zero, zero]),
        "queue" => (libc::SYS_msgget, [zero, 0o600, zero]),
        "value" => (libc::SYS_rt_sigqueueinfo, [zero; 3]),
        "barrier" => (libc::SYS_membarrier, [zero; 3]),
        "advice" => (libc::SYS_madvise, [zero, zero, libc::MADV_HWPOISON.into()]),
        "pipe" => (libc::SYS_fcntl, [2, libc::F_SETPIPE_SZ.into(), 1 << 20]),
        "device" => (libc::SYS_ioctl, [2, 0x1234, zero]),
        "limits" => (libc::SYS_setrlimit, [libc::RLIMIT_NOFILE.into(), zero, zero]),
        "splice" => (libc::SYS_splice, [zero; 3]),
        "huge" => {
            (libc::SYS_memfd_create, [c"huge".as_ptr() as libc::c_long, libc::MFD_HUGETLB.into(), zero])
        }
        "synchronise" => (libc::SYS_fsync, [zero; 3]),
        other => return format!("there is no attempt {other}"),
    };
    // SAFETY: null pointers and numbers only; where one of these is allowed it does nothing or fails.
    match unsafe { libc::syscall(call, arguments[0], arguments[1], arguments[2]) } {
        -1 => errno(&io::Error::last_os_error()),
        result => format!("allowed {result}"),
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Hostile>()
}
