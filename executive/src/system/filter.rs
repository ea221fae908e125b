//! Which system calls a partition may make: three filters (seccomp), built before there is a process.
//!
//! - what no partition has any business with ends its process with SIGSYS, which health monitoring calls an illegal request;
//! - what a program may try in good faith, and shall not have, is refused (EPERM);
//! - of the rest, what is on a list is allowed, and everything else does not exist (ENOSYS): also what kernels to come
//!   will add. Programs and C libraries that probe for a new call fall back to an old one.
//!
//! The list holds what ordinary programs in Rust and C need. It never decides by a file's name, which it can not see: that is
//! the business of [`super::rules`].
#![allow(unsafe_code)]

use std::collections::BTreeMap;
use std::io;

use seccompiler::{
    BpfProgram, SeccompAction, SeccompCmpArgLen, SeccompCmpOp, SeccompCondition, SeccompFilter, SeccompRule,
};

/// What the plan grants, as far as it changes the filters.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Grants {
    /// Internet sockets, and those of CAN buses.
    pub network: bool,
    /// More than one thread or process.
    pub threads: bool,
    /// System V objects and POSIX queues, where they are not shared with others.
    pub objects: bool,
}

/// The filters of a partition.
#[derive(Debug, Clone)]
pub struct Filters(Vec<BpfProgram>);

type Rules = BTreeMap<i64, Vec<SeccompRule>>;
type Condition = Result<SeccompCondition, seccompiler::BackendError>;

/// `SECCOMP_SET_MODE_FILTER`; the C library has no binding.
const SET_MODE_FILTER: libc::c_ulong = 1;

impl Filters {
    /// The filters for `grants`.
    ///
    /// # Errors
    /// A processor for which none can be built.
    pub fn new(grants: Grants) -> io::Result<Self> {
        let build = || -> Result<Vec<BpfProgram>, seccompiler::BackendError> {
            let (deadly, refused) = (deadly(grants)?, refused()?);
            let mut allowed = allowed(grants)?;
            // A call is refused only where no other filter says that it does not exist.
            for call in refused.keys() {
                allowed.entry(*call).or_default();
            }
            let compile = |rules, otherwise, then| {
                let processor = std::env::consts::ARCH.try_into()?;
                SeccompFilter::new(rules, otherwise, then, processor)?.try_into()
            };
            let refusal = SeccompAction::Errno(libc::EPERM.unsigned_abs());
            let absence = SeccompAction::Errno(libc::ENOSYS.unsigned_abs());
            Ok(vec![
                compile(deadly, SeccompAction::Allow, SeccompAction::KillProcess)?,
                compile(refused, SeccompAction::Allow, refusal)?,
                compile(allowed, absence, SeccompAction::Allow)?,
            ])
        };
        build().map(Self).map_err(|error| io::Error::other(format!("no system call filter: {error}")))
    }

    /// Puts the filters on the calling thread. False: refused, as `errno` says.
    ///
    /// # Safety
    /// For a child between `clone3` and its program, which has given up gaining privileges.
    pub(super) unsafe fn apply(&self) -> bool {
        self.0.iter().all(|program| {
            // A filter's length is limited to 4096 by the kernel, which refuses a longer one.
            let program =
                libc::sock_fprog { len: program.len() as u16, filter: program.as_ptr().cast_mut().cast() };
            let no_flags: libc::c_ulong = 0;
            // SAFETY: the program outlives the call, and the kernel only reads it; both crates describe the kernel's structure.
            unsafe { libc::syscall(libc::SYS_seccomp, SET_MODE_FILTER, no_flags, &raw const program) == 0 }
        })
    }
}

fn rule(conditions: impl IntoIterator<Item = Condition>) -> Result<SeccompRule, seccompiler::BackendError> {
    SeccompRule::new(conditions.into_iter().collect::<Result<_, _>>()?)
}

fn is(argument: u8, value: libc::c_int) -> Condition {
    let word = u64::from(value.cast_unsigned());
    SeccompCondition::new(argument, SeccompCmpArgLen::Dword, SeccompCmpOp::Eq, word)
}

fn is_not(argument: u8, value: libc::c_int) -> Condition {
    let word = u64::from(value.cast_unsigned());
    SeccompCondition::new(argument, SeccompCmpArgLen::Dword, SeccompCmpOp::Ne, word)
}

fn bits_are(argument: u8, mask: u64, value: u64) -> Condition {
    SeccompCondition::new(argument, SeccompCmpArgLen::Qword, SeccompCmpOp::MaskedEq(mask), value)
}

/// A call and what the C library calls its number.
type Named = (libc::c_long, &'static str);

macro_rules! named {
    ($($call:ident),* $(,)?) => { &[$((libc::$call, stringify!($call))),*] };
}

fn whole(calls: &[libc::c_long]) -> Rules {
    calls.iter().map(|call| (*call, Vec::new())).collect()
}

/// Flags of `clone` that make a namespace.
const NAMESPACES: u64 = (libc::CLONE_NEWNS
    | libc::CLONE_NEWCGROUP
    | libc::CLONE_NEWUTS
    | libc::CLONE_NEWIPC
    | libc::CLONE_NEWUSER
    | libc::CLONE_NEWPID
    | libc::CLONE_NEWNET) as u64;
/// The bits of a socket's type that are its type.
const SOCKET_TYPE: u64 = 0xf;
/// Raw frames, in the manner of long ago.
const SOCK_PACKET: libc::c_int = 10;
/// Puts letters into a terminal's input, as if somebody had typed them.
const TIOCSTI: libc::c_int = 0x5412;
/// Does the same, among others, on a console.
const TIOCLINUX: libc::c_int = 0x541c;

fn deadly(grants: Grants) -> Result<Rules, seccompiler::BackendError> {
    let mut rules: Rules = DEADLY.iter().chain(DEADLY_OF_OLD).map(|(call, _)| (*call, Vec::new())).collect();
    rules.insert(libc::SYS_prctl, vec![rule([is(0, libc::PR_SET_PDEATHSIG)])?]);
    rules.insert(libc::SYS_ioctl, vec![rule([is(1, TIOCSTI)])?, rule([is(1, TIOCLINUX)])?]);
    let mut sockets = vec![rule(
        [libc::AF_UNIX, libc::AF_NETLINK, libc::AF_INET, libc::AF_INET6, libc::AF_CAN]
            .map(|family| is_not(0, family)),
    )?];
    if !grants.network {
        sockets.push(rule([is(0, libc::AF_CAN)])?);
    }
    for family in [libc::AF_INET, libc::AF_INET6] {
        match grants.network {
            true => {
                for raw in [libc::SOCK_RAW, SOCK_PACKET] {
                    let kind = bits_are(1, SOCKET_TYPE, u64::from(raw.cast_unsigned()));
                    sockets.push(rule([is(0, family), kind])?);
                }
            }
            false => sockets.push(rule([is(0, family)])?),
        }
    }
    rules.insert(libc::SYS_socket, sockets);
    if !grants.threads {
        rules.extend(whole(CHILDREN));
    }
    Ok(rules)
}

fn refused() -> Result<Rules, seccompiler::BackendError> {
    let mut rules = whole(REFUSED);
    // A path to a socket is neither a file that is opened nor an address: nothing else stands in its way. Netlink is asked by
    // the C library's resolver, which does without.
    let families = [libc::AF_UNIX, libc::AF_NETLINK].map(|family| rule([is(0, family)]));
    rules.insert(libc::SYS_socket, families.into_iter().collect::<Result<_, _>>()?);
    Ok(rules)
}

fn allowed(grants: Grants) -> Result<Rules, seccompiler::BackendError> {
    let mut rules = whole(ALLOWED);
    rules.extend(whole(ALLOWED_OF_OLD));
    let controls = PROCESS_CONTROLS.iter().map(|option| rule([is(0, *option)]));
    rules.insert(libc::SYS_prctl, controls.collect::<Result<_, _>>()?);
    // Its own limits; those of others can only be read, and of others there are only its own children.
    rules.insert(libc::SYS_prlimit64, vec![rule([is(0, 0)])?, rule([bits_are(2, u64::MAX, 0)])?]);
    if grants.threads {
        let plain = || rule([bits_are(0, NAMESPACES, 0)]);
        rules.insert(libc::SYS_clone, vec![plain()?]);
        rules.extend(whole(&CHILDREN[1..]));
    }
    if grants.network {
        rules.extend(whole(NETWORK));
        let mut sockets = Vec::new();
        for family in [libc::AF_INET, libc::AF_INET6] {
            for (kind, protocol) in [
                (libc::SOCK_STREAM, 0),
                (libc::SOCK_STREAM, libc::IPPROTO_TCP),
                (libc::SOCK_DGRAM, 0),
                (libc::SOCK_DGRAM, libc::IPPROTO_UDP),
            ] {
                let kind = bits_are(1, SOCKET_TYPE, u64::from(kind.cast_unsigned()));
                sockets.push(rule([is(0, family), kind, is(2, protocol)])?);
            }
        }
        // Frames of a CAN bus, whose raw sockets see that bus and nothing else.
        let raw = bits_are(1, SOCKET_TYPE, u64::from(libc::SOCK_RAW.cast_unsigned()));
        sockets.push(rule([is(0, libc::AF_CAN), raw, is(2, libc::CAN_RAW)])?);
        for family in [libc::AF_UNIX, libc::AF_NETLINK] {
            sockets.push(rule([is(0, family)])?);
        }
        rules.insert(libc::SYS_socket, sockets);
    }
    if grants.objects {
        rules.extend(whole(OBJECTS));
    }
    Ok(rules)
}

/// No partition has any business with these.
const DEADLY: &[Named] = named![
    // Others' processes.
    SYS_ptrace,
    SYS_process_vm_readv,
    SYS_process_vm_writev,
    SYS_kcmp,
    SYS_pidfd_getfd,
    // Its own place in time.
    SYS_sched_setaffinity,
    SYS_sched_setscheduler,
    SYS_sched_setparam,
    SYS_sched_setattr,
    SYS_setpriority,
    SYS_ioprio_set,
    // Its own place in space.
    SYS_mount,
    SYS_umount2,
    SYS_pivot_root,
    SYS_chroot,
    SYS_move_mount,
    SYS_open_tree,
    SYS_fsopen,
    SYS_fsconfig,
    SYS_fsmount,
    SYS_fspick,
    SYS_mount_setattr,
    SYS_setns,
    SYS_unshare,
    SYS_open_by_handle_at,
    // Programs inside the kernel, and doors into it that have often been forced.
    SYS_bpf,
    SYS_perf_event_open,
    SYS_userfaultfd,
    SYS_io_uring_setup,
    SYS_io_uring_enter,
    SYS_io_uring_register,
    SYS_keyctl,
    SYS_add_key,
    SYS_request_key,
    SYS_fanotify_init,
    SYS_personality,
    // The machine.
    SYS_kexec_load,
    SYS_reboot,
    SYS_init_module,
    SYS_finit_module,
    SYS_delete_module,
    SYS_swapon,
    SYS_swapoff,
    SYS_acct,
    SYS_quotactl,
    SYS_sethostname,
    SYS_setdomainname,
    SYS_settimeofday,
    SYS_clock_settime,
    SYS_syslog,
];

/// As above; only this processor has them.
#[cfg(target_arch = "x86_64")]
const DEADLY_OF_OLD: &[Named] = named![SYS_kexec_file_load, SYS_iopl, SYS_ioperm, SYS_modify_ldt,];
#[cfg(not(target_arch = "x86_64"))]
const DEADLY_OF_OLD: &[Named] = named![];

/// What is deadly for some partitions, or with some arguments.
const DEADLY_SOMETIMES: &[Named] = named![SYS_prctl, SYS_ioctl, SYS_socket, SYS_clone,];

#[cfg(target_arch = "x86_64")]
const CHILDREN_OF_OLD: &[Named] = named![SYS_fork, SYS_vfork];
#[cfg(not(target_arch = "x86_64"))]
const CHILDREN_OF_OLD: &[Named] = named![];

/// The name of a system call that can be deadly.
#[must_use]
pub fn name_of(number: i64) -> Option<&'static str> {
    let sometimes = DEADLY_SOMETIMES.iter().chain(CHILDREN_OF_OLD);
    let mut all = DEADLY.iter().chain(DEADLY_OF_OLD).chain(sometimes);
    all.find(|(call, _)| *call == number).map(|(_, name)| name.trim_start_matches("SYS_"))
}

/// What makes a thread or a process: of those that declared more than one. `clone` is first, because it is looked at more
/// closely. `clone3`, whose flags a filter can not see, is nobody's: C libraries then take `clone`.
const CHILDREN: &[libc::c_long] = &[
    libc::SYS_clone,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_fork,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_vfork,
];

/// What a program may try in good faith, and shall not have.
const REFUSED: &[libc::c_long] = &[
    libc::SYS_setsid,
    libc::SYS_setpgid,
    libc::SYS_setuid,
    libc::SYS_setgid,
    libc::SYS_setreuid,
    libc::SYS_setregid,
    libc::SYS_setresuid,
    libc::SYS_setresgid,
    libc::SYS_setgroups,
    libc::SYS_setfsuid,
    libc::SYS_setfsgid,
    libc::SYS_capset,
    libc::SYS_adjtimex,
    libc::SYS_clock_adjtime,
    libc::SYS_mknodat,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_mknod,
];

/// First arguments of `prctl`: names, and what restricts further or only tells.
const PROCESS_CONTROLS: &[libc::c_int] = &[
    libc::PR_SET_NAME,
    libc::PR_GET_NAME,
    libc::PR_GET_PDEATHSIG,
    libc::PR_GET_DUMPABLE,
    libc::PR_GET_SECCOMP,
    libc::PR_CAPBSET_READ,
    libc::PR_GET_TIMERSLACK,
    libc::PR_SET_TIMERSLACK,
    libc::PR_SET_NO_NEW_PRIVS,
    libc::PR_GET_NO_NEW_PRIVS,
    libc::PR_GET_THP_DISABLE,
    libc::PR_SET_THP_DISABLE,
    libc::PR_SET_VMA,
];

const NETWORK: &[libc::c_long] =
    &[libc::SYS_bind, libc::SYS_connect, libc::SYS_listen, libc::SYS_accept, libc::SYS_accept4];

const OBJECTS: &[libc::c_long] = &[
    libc::SYS_shmget,
    libc::SYS_shmat,
    libc::SYS_shmdt,
    libc::SYS_shmctl,
    libc::SYS_semget,
    libc::SYS_semop,
    libc::SYS_semctl,
    libc::SYS_semtimedop,
    libc::SYS_msgget,
    libc::SYS_msgsnd,
    libc::SYS_msgrcv,
    libc::SYS_msgctl,
    libc::SYS_mq_open,
    libc::SYS_mq_unlink,
    libc::SYS_mq_timedsend,
    libc::SYS_mq_timedreceive,
    libc::SYS_mq_notify,
    libc::SYS_mq_getsetattr,
];

/// What ordinary programs need.
const ALLOWED: &[libc::c_long] = &[
    // Descriptors.
    libc::SYS_read,
    libc::SYS_write,
    libc::SYS_readv,
    libc::SYS_writev,
    libc::SYS_pread64,
    libc::SYS_pwrite64,
    libc::SYS_preadv,
    libc::SYS_pwritev,
    libc::SYS_preadv2,
    libc::SYS_pwritev2,
    libc::SYS_close,
    libc::SYS_close_range,
    libc::SYS_dup,
    libc::SYS_dup3,
    libc::SYS_fcntl,
    libc::SYS_flock,
    libc::SYS_ioctl,
    libc::SYS_lseek,
    libc::SYS_pipe2,
    libc::SYS_splice,
    libc::SYS_tee,
    libc::SYS_vmsplice,
    libc::SYS_sendfile,
    libc::SYS_copy_file_range,
    libc::SYS_fsync,
    libc::SYS_fdatasync,
    libc::SYS_sync_file_range,
    libc::SYS_ftruncate,
    libc::SYS_fallocate,
    libc::SYS_fadvise64,
    libc::SYS_readahead,
    // Files: which ones is not decided here.
    libc::SYS_openat,
    libc::SYS_openat2,
    libc::SYS_newfstatat,
    libc::SYS_fstat,
    libc::SYS_statx,
    libc::SYS_statfs,
    libc::SYS_fstatfs,
    libc::SYS_faccessat,
    libc::SYS_faccessat2,
    libc::SYS_readlinkat,
    libc::SYS_getdents64,
    libc::SYS_getcwd,
    libc::SYS_chdir,
    libc::SYS_fchdir,
    libc::SYS_truncate,
    libc::SYS_mkdirat,
    libc::SYS_unlinkat,
    #[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
    libc::SYS_renameat,
    libc::SYS_renameat2,
    libc::SYS_linkat,
    libc::SYS_symlinkat,
    libc::SYS_fchmod,
    libc::SYS_fchmodat,
    libc::SYS_fchown,
    libc::SYS_fchownat,
    libc::SYS_utimensat,
    libc::SYS_umask,
    libc::SYS_inotify_init1,
    libc::SYS_inotify_add_watch,
    libc::SYS_inotify_rm_watch,
    // Waiting.
    libc::SYS_ppoll,
    libc::SYS_pselect6,
    libc::SYS_epoll_create1,
    libc::SYS_epoll_ctl,
    libc::SYS_epoll_pwait,
    libc::SYS_epoll_pwait2,
    libc::SYS_eventfd2,
    libc::SYS_signalfd4,
    libc::SYS_timerfd_create,
    libc::SYS_timerfd_settime,
    libc::SYS_timerfd_gettime,
    libc::SYS_futex,
    libc::SYS_futex_waitv,
    libc::SYS_nanosleep,
    libc::SYS_clock_nanosleep,
    // Memory.
    libc::SYS_brk,
    libc::SYS_mmap,
    libc::SYS_munmap,
    libc::SYS_mremap,
    libc::SYS_mprotect,
    libc::SYS_madvise,
    libc::SYS_msync,
    libc::SYS_mincore,
    libc::SYS_mlock,
    libc::SYS_mlock2,
    libc::SYS_munlock,
    libc::SYS_mlockall,
    libc::SYS_munlockall,
    libc::SYS_memfd_create,
    libc::SYS_membarrier,
    // Signals: whom they reach is not decided here.
    libc::SYS_rt_sigaction,
    libc::SYS_rt_sigprocmask,
    libc::SYS_rt_sigreturn,
    libc::SYS_rt_sigpending,
    libc::SYS_rt_sigtimedwait,
    libc::SYS_rt_sigsuspend,
    libc::SYS_rt_sigqueueinfo,
    libc::SYS_rt_tgsigqueueinfo,
    libc::SYS_sigaltstack,
    libc::SYS_kill,
    libc::SYS_tkill,
    libc::SYS_tgkill,
    libc::SYS_restart_syscall,
    // The process and its threads.
    libc::SYS_execve,
    libc::SYS_execveat,
    libc::SYS_exit,
    libc::SYS_exit_group,
    libc::SYS_wait4,
    libc::SYS_waitid,
    libc::SYS_set_tid_address,
    libc::SYS_set_robust_list,
    libc::SYS_get_robust_list,
    libc::SYS_rseq,
    libc::SYS_sched_yield,
    libc::SYS_sched_getaffinity,
    libc::SYS_sched_getscheduler,
    libc::SYS_sched_getparam,
    libc::SYS_sched_getattr,
    libc::SYS_sched_get_priority_max,
    libc::SYS_sched_get_priority_min,
    libc::SYS_sched_rr_get_interval,
    libc::SYS_getcpu,
    libc::SYS_getpriority,
    libc::SYS_getrlimit,
    libc::SYS_setrlimit,
    libc::SYS_getrusage,
    libc::SYS_getpid,
    libc::SYS_getppid,
    libc::SYS_gettid,
    libc::SYS_getpgid,
    libc::SYS_getsid,
    libc::SYS_getuid,
    libc::SYS_geteuid,
    libc::SYS_getgid,
    libc::SYS_getegid,
    libc::SYS_getresuid,
    libc::SYS_getresgid,
    libc::SYS_getgroups,
    libc::SYS_capget,
    // Time and the machine.
    libc::SYS_clock_gettime,
    libc::SYS_clock_getres,
    libc::SYS_gettimeofday,
    libc::SYS_times,
    libc::SYS_getitimer,
    libc::SYS_setitimer,
    libc::SYS_timer_create,
    libc::SYS_timer_settime,
    libc::SYS_timer_gettime,
    libc::SYS_timer_getoverrun,
    libc::SYS_timer_delete,
    libc::SYS_uname,
    libc::SYS_sysinfo,
    libc::SYS_getrandom,
    // Pairs of sockets, and sockets that it was granted.
    libc::SYS_socketpair,
    libc::SYS_sendto,
    libc::SYS_recvfrom,
    libc::SYS_sendmsg,
    libc::SYS_recvmsg,
    libc::SYS_sendmmsg,
    libc::SYS_recvmmsg,
    libc::SYS_shutdown,
    libc::SYS_getsockopt,
    libc::SYS_setsockopt,
    libc::SYS_getsockname,
    libc::SYS_getpeername,
];

/// Calls that x86-64 has and newer processors never had: the library takes the ones above there.
#[cfg(target_arch = "x86_64")]
const ALLOWED_OF_OLD: &[libc::c_long] = &[
    libc::SYS_arch_prctl,
    libc::SYS_open,
    libc::SYS_creat,
    libc::SYS_stat,
    libc::SYS_lstat,
    libc::SYS_access,
    libc::SYS_readlink,
    libc::SYS_mkdir,
    libc::SYS_rmdir,
    libc::SYS_unlink,
    libc::SYS_rename,
    libc::SYS_link,
    libc::SYS_symlink,
    libc::SYS_chmod,
    libc::SYS_chown,
    libc::SYS_lchown,
    libc::SYS_utime,
    libc::SYS_utimes,
    libc::SYS_futimesat,
    libc::SYS_getdents,
    libc::SYS_pipe,
    libc::SYS_dup2,
    libc::SYS_poll,
    libc::SYS_select,
    libc::SYS_epoll_create,
    libc::SYS_epoll_wait,
    libc::SYS_eventfd,
    libc::SYS_signalfd,
    libc::SYS_inotify_init,
    libc::SYS_time,
    libc::SYS_alarm,
    libc::SYS_pause,
    libc::SYS_getpgrp,
];

#[cfg(not(target_arch = "x86_64"))]
const ALLOWED_OF_OLD: &[libc::c_long] = &[];

#[cfg(test)]
mod tests {
    use super::*;

    fn every_grant() -> impl Iterator<Item = Grants> {
        (0..8).map(|bits| Grants { network: bits & 1 != 0, threads: bits & 2 != 0, objects: bits & 4 != 0 })
    }

    #[test]
    fn the_kernel_takes_filters_of_this_length() {
        for grants in every_grant() {
            let filters = Filters::new(grants).unwrap();
            assert!(filters.0.iter().all(|program| program.len() < 4096), "{grants:?}");
        }
    }

    #[test]
    fn nothing_deadly_is_on_the_list_of_what_is_allowed() {
        for grants in every_grant() {
            let (deadly, allowed) = (deadly(grants).unwrap(), allowed(grants).unwrap());
            // An empty list of rules concerns the whole call.
            let both = deadly.iter().find(|(call, rules)| rules.is_empty() && allowed.contains_key(*call));
            assert_eq!(both, None, "{grants:?}");
        }
    }

    #[test]
    fn one_thread_ends_at_clone_and_several_may_clone() {
        let one = Grants::default();
        assert!(deadly(one).unwrap().contains_key(&libc::SYS_clone));
        let several = Grants { threads: true, ..one };
        assert!(!deadly(several).unwrap().contains_key(&libc::SYS_clone));
        assert_eq!(allowed(several).unwrap()[&libc::SYS_clone].len(), 1, "without namespaces");
    }
}
