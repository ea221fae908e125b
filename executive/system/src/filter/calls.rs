//! The system calls of a partition, family by family: which are there for every program, which a plan may grant by name, which are
//! refused, and which end the process. The book's page of system calls is made from these tables.

/// A call's number and what the C library calls it.
pub(super) type Named = (libc::c_long, &'static str);

macro_rules! named {
    ($($call:ident),* $(,)?) => { &[$((libc::$call, stringify!($call))),*] };
}

/// Calls that x86-64 has beside the newer ones; younger processors never had them.
macro_rules! of_old {
    ($($call:ident),* $(,)?) => {{
        #[cfg(target_arch = "x86_64")]
        const OF_OLD: &[Named] = named![$($call),*];
        #[cfg(not(target_arch = "x86_64"))]
        const OF_OLD: &[Named] = &[];
        OF_OLD
    }};
}

/// Calls that are let through for one reason.
#[derive(Debug)]
pub(super) struct Family {
    /// What they are for.
    pub(super) reason: &'static str,
    /// What bounds what they cost others.
    pub(super) bound: &'static str,
    /// The calls.
    pub(super) calls: &'static [Named],
    /// Those of x86-64 alone.
    pub(super) of_old: &'static [Named],
}

impl Family {
    /// All calls that this processor has.
    pub(super) fn all(&self) -> impl Iterator<Item = &'static Named> {
        self.calls.iter().chain(self.of_old)
    }
}

/// What every partition may do.
pub(super) const ORDINARY: &[Family] = &[
    Family {
        reason: "Read and write what is open.",
        bound: "Descriptors: 256 and 16 for each port (`RLIMIT_NOFILE`). Pipes and their content count as the partition's memory.",
        calls: named![
            SYS_read,
            SYS_write,
            SYS_readv,
            SYS_writev,
            SYS_pread64,
            SYS_pwrite64,
            SYS_preadv,
            SYS_pwritev,
            SYS_lseek,
            SYS_close,
            SYS_close_range,
            SYS_dup,
            SYS_dup3,
            SYS_pipe2,
        ],
        of_old: of_old![SYS_dup2, SYS_pipe],
    },
    Family {
        reason: "Look at files and open them; make and remove them in the directories of its channels.",
        bound: "Which files: rules about files and the view of the file system. Size: `RLIMIT_FSIZE`. What lies in a channel's directory counts as the partition's memory and is removed when it has ended.",
        calls: named![
            SYS_openat,
            SYS_newfstatat,
            SYS_fstat,
            SYS_statx,
            SYS_fstatfs,
            SYS_faccessat,
            SYS_faccessat2,
            SYS_readlinkat,
            SYS_getdents64,
            SYS_getcwd,
            SYS_mkdirat,
            SYS_unlinkat,
            SYS_renameat,
            SYS_renameat2,
            SYS_ftruncate,
            SYS_flock,
            SYS_umask,
        ],
        of_old: of_old![
            SYS_open,
            SYS_creat,
            SYS_stat,
            SYS_lstat,
            SYS_access,
            SYS_readlink,
            SYS_getdents,
            SYS_mkdir,
            SYS_rmdir,
            SYS_unlink,
            SYS_rename,
        ],
    },
    Family {
        reason: "Wait for several descriptors, or for a thread.",
        bound: "One timer of the kernel for each thread that waits.",
        calls: named![
            SYS_ppoll,
            SYS_pselect6,
            SYS_epoll_create1,
            SYS_epoll_ctl,
            SYS_epoll_pwait,
            SYS_epoll_pwait2,
            SYS_eventfd2,
            SYS_futex,
            SYS_nanosleep,
            SYS_clock_nanosleep,
            SYS_restart_syscall,
            SYS_sched_yield,
        ],
        of_old: of_old![SYS_poll, SYS_select, SYS_epoll_create, SYS_epoll_wait, SYS_eventfd, SYS_pause],
    },
    Family {
        reason: "Manage its own memory.",
        bound: "The partition's memory; the tables for it are counted there too.",
        calls: named![
            SYS_brk,
            SYS_mmap,
            SYS_munmap,
            SYS_mremap,
            SYS_mprotect,
            SYS_mlock,
            SYS_mlock2,
            SYS_munlock,
            SYS_mlockall,
            SYS_munlockall,
            SYS_memfd_create,
        ],
        of_old: of_old![],
    },
    Family {
        reason: "Handle signals, and send them within the partition.",
        bound: "64 queued signals (`RLIMIT_SIGPENDING`). Whom they reach: namespace of process numbers, rules about signals.",
        calls: named![
            SYS_rt_sigaction,
            SYS_rt_sigprocmask,
            SYS_rt_sigreturn,
            SYS_rt_sigpending,
            SYS_rt_sigtimedwait,
            SYS_rt_sigsuspend,
            SYS_sigaltstack,
            SYS_signalfd4,
            SYS_kill,
            SYS_tkill,
            SYS_tgkill,
        ],
        of_old: of_old![SYS_signalfd],
    },
    Family {
        reason: "Begin and end: the program, its threads' ends, what the C library arranges for each thread.",
        bound: "Threads and processes as declared (`threads`).",
        calls: named![
            SYS_execve,
            SYS_execveat,
            SYS_exit,
            SYS_exit_group,
            SYS_wait4,
            SYS_waitid,
            SYS_set_tid_address,
            SYS_set_robust_list,
            SYS_get_robust_list,
            SYS_rseq,
        ],
        of_old: of_old![SYS_arch_prctl],
    },
    Family {
        reason: "Ask who and where it is, what it was given and used, what time it is.",
        bound: "Nothing is kept or put off.",
        calls: named![
            SYS_getpid,
            SYS_getppid,
            SYS_gettid,
            SYS_getpgid,
            SYS_getsid,
            SYS_getuid,
            SYS_geteuid,
            SYS_getgid,
            SYS_getegid,
            SYS_getresuid,
            SYS_getresgid,
            SYS_getgroups,
            SYS_capget,
            SYS_sched_getaffinity,
            SYS_sched_getscheduler,
            SYS_sched_getparam,
            SYS_sched_getattr,
            SYS_sched_get_priority_max,
            SYS_sched_get_priority_min,
            SYS_sched_rr_get_interval,
            SYS_getcpu,
            SYS_getpriority,
            SYS_getrlimit,
            SYS_getrusage,
            SYS_clock_gettime,
            SYS_clock_getres,
            SYS_gettimeofday,
            SYS_times,
            SYS_uname,
            SYS_sysinfo,
            SYS_getrandom,
        ],
        of_old: of_old![SYS_time, SYS_getpgrp],
    },
];

/// Sockets that a partition with `network = true` makes and uses.
pub(super) const NETWORK: Family = Family {
    reason: "Sockets of UDP.",
    bound: "6 sockets. What they have received counts as the partition's memory (version 2 of control groups), or as 640 KiB beside it (version 1). No larger room for what is sent, no incomplete datagrams, no socket filters, no busy polling, no pinned pages.",
    calls: named![SYS_bind, SYS_connect],
    of_old: of_old![],
};

/// What sockets are used by, however a partition came by them.
pub(super) const SOCKET_CALLS: &[Named] = named![
    SYS_sendto,
    SYS_recvfrom,
    SYS_sendmsg,
    SYS_recvmsg,
    SYS_sendmmsg,
    SYS_recvmmsg,
    SYS_shutdown,
    SYS_getsockopt,
    SYS_getsockname,
    SYS_getpeername,
];

/// What a plan may grant by name (`system_calls`): it costs others something, and most programs do without. Each stands under its name
/// in the plan's closed set.
pub(super) const GRANTABLE: &[(&str, Family)] = &[
    (
        "timers",
        Family {
            reason: "Timers of the kernel, which expire at any instant.",
            bound: "64 POSIX timers (`RLIMIT_SIGPENDING`), one `timerfd` for each descriptor, three interval timers. Each expiry interrupts whoever has the processor.",
            calls: named![
                SYS_timer_create,
                SYS_timer_settime,
                SYS_timer_gettime,
                SYS_timer_getoverrun,
                SYS_timer_delete,
                SYS_timerfd_create,
                SYS_timerfd_settime,
                SYS_timerfd_gettime,
                SYS_getitimer,
                SYS_setitimer,
            ],
            of_old: of_old![SYS_alarm],
        },
    ),
    (
        "inotify",
        Family {
            reason: "Notification of changes to files.",
            bound: "128 instances for each user, as the machine is set up.",
            calls: named![SYS_inotify_init1, SYS_inotify_add_watch, SYS_inotify_rm_watch],
            of_old: of_old![SYS_inotify_init],
        },
    ),
    (
        "local_sockets",
        Family {
            reason: "Pairs of connected sockets within the partition.",
            bound: "Their content counts as the partition's memory. Descriptors in flight: as many as may be open.",
            calls: named![SYS_socketpair],
            of_old: of_old![],
        },
    ),
    (
        "tcp",
        Family {
            reason: "Sockets of TCP, with `network = true`.",
            bound: "As other sockets; the kernel goes over it by up to 64 KiB for each connection, and by what has not been accepted.",
            calls: named![SYS_listen, SYS_accept, SYS_accept4],
            of_old: of_old![],
        },
    ),
    (
        "can",
        Family {
            reason: "Sockets of CAN, with `network = true`: `socket` with that family.",
            bound: "Descriptors. The frames that wait in each socket are counted nowhere: `net.core.rmem_max` twice at most, and what it sent.",
            calls: named![],
            of_old: of_old![],
        },
    ),
    (
        "ipc_objects",
        Family {
            reason: "System V memory, semaphores and queues, and POSIX message queues, within the partition.",
            bound: "They count as the partition's memory and end with it. Only where it has an IPC namespace of its own.",
            calls: named![
                SYS_shmget,
                SYS_shmat,
                SYS_shmdt,
                SYS_shmctl,
                SYS_semget,
                SYS_semop,
                SYS_semctl,
                SYS_semtimedop,
                SYS_msgget,
                SYS_msgsnd,
                SYS_msgrcv,
                SYS_msgctl,
                SYS_mq_open,
                SYS_mq_unlink,
                SYS_mq_timedsend,
                SYS_mq_timedreceive,
                SYS_mq_notify,
                SYS_mq_getsetattr,
            ],
            of_old: of_old![],
        },
    ),
    (
        "queued_signals",
        Family {
            reason: "Signals that carry a value (`sigqueue`).",
            bound: "64 queued signals (`RLIMIT_SIGPENDING`).",
            calls: named![SYS_rt_sigqueueinfo, SYS_rt_tgsigqueueinfo],
            of_old: of_old![],
        },
    ),
    (
        "memory_control",
        Family {
            reason: "Memory barriers across threads, every advice about memory, synchronisation of mappings.",
            bound: "None: they interrupt processors and queue work in the kernel.",
            calls: named![SYS_membarrier, SYS_madvise, SYS_mincore, SYS_msync],
            of_old: of_old![],
        },
    ),
    (
        "file_operations",
        Family {
            reason: "Reserve, copy, link and time-stamp its own files, change their owner and mode, change the working directory.",
            bound: "The partition's memory; read-ahead and `sync_file_range` make the disk work.",
            calls: named![
                SYS_fallocate,
                SYS_truncate,
                SYS_fchmod,
                SYS_fchmodat,
                SYS_fchown,
                SYS_fchownat,
                SYS_utimensat,
                SYS_linkat,
                SYS_symlinkat,
                SYS_sync_file_range,
                SYS_fadvise64,
                SYS_readahead,
                SYS_splice,
                SYS_tee,
                SYS_vmsplice,
                SYS_sendfile,
                SYS_copy_file_range,
                SYS_statfs,
                SYS_chdir,
                SYS_fchdir,
            ],
            of_old: of_old![
                SYS_chmod,
                SYS_chown,
                SYS_lchown,
                SYS_utime,
                SYS_utimes,
                SYS_futimesat,
                SYS_link,
                SYS_symlink,
            ],
        },
    ),
];

/// Synchronisation with the disk: done, without the kernel. What a partition can write lies in memory, and to ask for a file that it
/// only reads would make the disk work.
pub(super) const DONE: &[Named] = named![SYS_fsync, SYS_fdatasync];

/// No partition has any business with these: they end its process.
pub(super) const DEADLY: &[Named] = named![
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
    // Programs inside the kernel, and interfaces of it that are often attacked.
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

/// As above; only x86-64 has them.
pub(super) const DEADLY_OF_OLD: &[Named] = of_old![SYS_kexec_file_load, SYS_iopl, SYS_ioperm, SYS_modify_ldt];

/// What is deadly for some partitions, or with some arguments.
pub(super) const DEADLY_SOMETIMES: &[Named] = named![SYS_prctl, SYS_ioctl, SYS_socket, SYS_clone];

/// What makes a thread or a process beside `clone`, whose flags are looked at: of those that declared more than one. `clone3`,
/// whose flags a filter can not see, is nobody's: C libraries then take `clone`.
pub(super) const CHILDREN_OF_OLD: &[Named] = of_old![SYS_fork, SYS_vfork];

/// What a program may try in good faith, and nobody is granted.
pub(super) const REFUSED: &[Named] = named![
    SYS_setsid,
    SYS_setpgid,
    SYS_setuid,
    SYS_setgid,
    SYS_setreuid,
    SYS_setregid,
    SYS_setresuid,
    SYS_setresgid,
    SYS_setgroups,
    SYS_setfsuid,
    SYS_setfsgid,
    SYS_capset,
    SYS_setrlimit,
    SYS_adjtimex,
    SYS_clock_adjtime,
    SYS_mknodat,
];

/// As above; only x86-64 has it.
pub(super) const REFUSED_OF_OLD: &[Named] = of_old![SYS_mknod];
