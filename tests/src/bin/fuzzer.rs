//! A partition that makes random system calls with random and with chosen arguments: own descriptors, files, addresses of
//! all that it has mapped (its control page, its channels, its stack), nothing, lengths and flags of every size.
//!
//! Attributes: `seed`; `network`, whether it is granted one: calls that end it at once are left out; `from_ms`, the module time at which it
//! begins; `each_ms`: it makes calls and only computes in turns of that length, if given; `threads`, how many more threads do the same, in
//! windows and beyond them; `at_generation`, for a finding: what an incarnation of that number did. What it does depends on the seed and the incarnation alone, as far as the kernel's
//! answers do. How far it came stands in its retained memory; with `tells` a successor says it on standard error.
#![allow(unsafe_code)] // that is what it is for

use std::ffi::{CString, c_long};
use std::process::ExitCode;
use std::sync::Arc;

use bateleur_apex::{Context, Direction, Partition, PortKind, Retained, SamplingSource, StartError, Window};
use bateleur_messages::FunctionStatus;
use bateleur_system::filter::{Grants, deadly_numbers};

struct Fuzzer {
    random: Random,
    scene: Arc<Scene>,
    from_ns: u64,
    each_ns: u64,
    retained: Retained<[u64; 3]>,
    steps: u64,
    generation: u64,
    more_threads: u64,
    sources: Vec<SamplingSource<FunctionStatus>>,
}

/// What arguments are made of.
struct Scene {
    numbers: Vec<i64>,
    paths: Vec<CString>,
    addresses: Vec<u64>,
    arena: u64,
    /// Memory that may be unmapped, protected and given back.
    toy: u64,
}

/// Bytes of the memory that most pointers lead to.
const ARENA: usize = 1 << 20;
/// Beyond the last number of a call that any kernel has.
const NUMBERS: i64 = 480;

/// SplitMix64.
#[derive(Clone)]
struct Random(u64);

impl Random {
    fn word(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut word = self.0;
        word = (word ^ (word >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        word = (word ^ (word >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        word ^ (word >> 31)
    }

    fn below(&mut self, count: u64) -> u64 {
        self.word() % count.max(1)
    }

    fn one_in(&mut self, count: u64) -> bool {
        self.below(count) == 0
    }

    fn of<T: Copy>(&mut self, list: &[T]) -> T {
        list[self.below(list.len() as u64) as usize]
    }
}

impl Partition for Fuzzer {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let names = context.port_names(PortKind::Sampling, Direction::Source);
        let sources = names.iter().map(|name| context.sampling_source(name)).collect::<Result<_, _>>()?;
        let seed: u64 = context.attribute("seed", 1)?;
        let more_threads: u64 = context.attribute("threads", 0)?;
        let grants = Grants {
            network: context.attribute("network", false)?,
            threads: more_threads > 0,
            ..Grants::default()
        };
        let mut never = deadly_numbers(&grants);
        if !grants.network {
            // It ends with every family that a filter lets through to the kernel elsewhere.
            never.push(libc::SYS_socket);
        }
        let at_generation: i64 = context.attribute("at_generation", -1)?;
        let generation = u64::try_from(at_generation).unwrap_or(context.generation().into());
        let mut retained = context.retained::<[u64; 3]>()?;
        if context.attribute("tells", false)?
            && let Some([generation, steps, call]) = retained.load()
        {
            eprintln!("incarnation {generation} ended in step {steps}, call {call}");
        }
        let scene = Scene::new(&never)?;
        Ok(Self {
            random: Random(seed.wrapping_mul(0x1_0000_0001) ^ generation << 32),
            scene: Arc::new(scene),
            from_ns: context.attribute("from_ms", 0_u64)? * 1_000_000,
            each_ns: context.attribute("each_ms", 0_u64)? * 1_000_000,
            retained,
            steps: 0,
            generation,
            more_threads,
            sources,
        })
    }

    fn window(&mut self, window: &Window) {
        self.sources.iter_mut().for_each(|port| port.write(&FunctionStatus::default()));
        if window.start_ns() < self.from_ns {
            return;
        }
        for number in 0..std::mem::take(&mut self.more_threads) {
            let (mut random, scene) = (Random(self.random.0 ^ (number + 1) << 56), self.scene.clone());
            let fuzz = move || {
                loop {
                    scene.step(&mut random);
                }
            };
            if std::thread::Builder::new().stack_size(256 << 10).spawn(fuzz).is_err() {
                break;
            }
        }
        let length = window.end_ns() - window.start_ns();
        // Now and then beyond the end of the window.
        let until_ns = match self.random.below(32) {
            0 => window.end_ns() + length,
            1 => window.end_ns(),
            _ => window.end_ns() - length / 4,
        };
        let is_pause =
            window.start_ns().checked_div(self.each_ns).is_some_and(|turn| !turn.is_multiple_of(2));
        while window.now_ns() < until_ns {
            if is_pause {
                continue;
            }
            let mut next = self.random.clone();
            self.steps += 1;
            let number = self.scene.choose(&mut next);
            self.retained.store(&[self.generation, self.steps, number as u64]);
            self.scene.step(&mut self.random);
        }
    }
}

impl Scene {
    fn new(never: &[i64]) -> Result<Self, StartError> {
        let protection = libc::PROT_READ | libc::PROT_WRITE;
        let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS;
        // SAFETY: a new mapping at an address of the kernel's choice.
        let arena = unsafe { libc::mmap(std::ptr::null_mut(), 2 * ARENA, protection, flags, -1, 0) };
        if arena == libc::MAP_FAILED {
            return Err(StartError::Other("no memory".into()));
        }
        let maps = std::fs::read_to_string("/proc/self/maps").unwrap_or_default();
        let start = |line: &str| u64::from_str_radix(line.split_once('-')?.0, 16).ok();
        let mut paths: Vec<String> = [
            ".",
            "..",
            "/",
            "/proc",
            "/proc/self",
            "/proc/self/fd",
            "/proc/self/fd/2",
            "/proc/self/mem",
            "/proc/self/exe",
            "/proc/self/task",
            "/proc/self/oom_score_adj",
            "/proc/self/timerslack_ns",
            "/proc/self/ns/net",
            "/proc/self/cgroup",
            "/proc/self/smaps",
            "/proc/sys/kernel/ns_last_pid",
            "/proc/stat",
            "/dev/null",
            "/dev/zero",
            "/dev/full",
            "/dev/urandom",
            "/dev/shm",
            "/dev/mqueue",
            "/dev/ptmx",
            "/dev/tty",
            "/tmp",
            "/tmp/fuzz",
            "/sys",
            "/sys/fs/cgroup",
            "/sys/devices/system/cpu/online",
            "/etc/passwd",
            "/usr/lib",
            "name",
            "name/name",
            "../name",
            "",
        ]
        .map(str::to_owned)
        .to_vec();
        for folder in own_channels(&maps) {
            paths.extend(
                ["", "/a", "/b", "/c", "/a/a", "/a/b", "/..", "/../.."].map(|end| format!("{folder}{end}")),
            );
            let entries = std::fs::read_dir(&folder).into_iter().flatten().flatten();
            paths.extend(entries.filter_map(|entry| entry.path().to_str().map(str::to_owned)));
        }
        Ok(Self {
            numbers: (0..NUMBERS).filter(|number| !never.contains(number)).collect(),
            paths: paths.into_iter().filter_map(|path| CString::new(path).ok()).collect(),
            addresses: maps.lines().filter_map(start).collect(),
            arena: arena as u64,
            toy: arena as u64 + ARENA as u64,
        })
    }

    /// The call of the next step. Half of them come from those whose arguments are known.
    fn choose(&self, random: &mut Random) -> i64 {
        let number = match random.below(3) {
            0 => random.of(&self.numbers),
            _ => random.of(SHAPES).0,
        };
        let allowed = self.numbers.contains(&number);
        // What ends this incarnation, or holds it until it is ended, is tried seldom.
        let is_rare = RARE.contains(&number) && !random.one_in(100);
        if allowed && !is_rare { number } else { libc::SYS_getpid }
    }

    fn step(&self, random: &mut Random) {
        let number = self.choose(random);
        let shape = SHAPES.iter().find(|(call, _)| *call == number).map_or("xxxxxx", |found| found.1);
        let mut arguments = [0_u64; 6];
        for (argument, kind) in arguments.iter_mut().zip(shape.chars()) {
            *argument = self.argument(kind, random);
        }
        let [a, b, c, d, e, f] = arguments;
        // SAFETY: none: whatever it does to this process, it is started again.
        let result = unsafe { libc::syscall(number as c_long, a, b, c, d, e, f) };
        // Most of what can be waited for is not: a call that waits costs an incarnation.
        if shape.ends_with('!') && (6..4096).contains(&result) && !random.one_in(8) {
            // SAFETY: a plain call.
            unsafe { libc::fcntl(result as i32, libc::F_SETFL, libc::O_NONBLOCK) };
        }
    }

    fn argument(&self, kind: char, random: &mut Random) -> u64 {
        match kind {
            'd' => match random.below(16) {
                0 => random.of(&[u64::MAX, libc::AT_FDCWD as u64, 1 << 31, 4_095]),
                1..=4 => random.below(6),
                _ => 6 + random.below(40),
            },
            'n' => random.of(&[
                0,
                1,
                2,
                4,
                8,
                16,
                24,
                32,
                64,
                128,
                511,
                4_095,
                4_096,
                4_097,
                65_536,
                1 << 20,
                1 << 24,
                1 << 31,
                1 << 40,
                u64::MAX,
                i64::MAX as u64,
            ]),
            'o' => random.of(&[0, 1, 4_096, 1 << 20, 1 << 26, 3 << 30, 1 << 44, i64::MAX as u64, u64::MAX]),
            'f' => match random.below(4) {
                0 => 0,
                1 => 1 << random.below(32),
                2 => 1 << random.below(32) | 1 << random.below(32),
                _ => random.word() & u64::from(u32::MAX),
            },
            'i' => random.below(20),
            's' => random.below(66),
            't' => random.of(&[0, 1, 2, u64::MAX, own_pid(), own_pid() + 1, 1 << 22]),
            'P' => random.of(&self.paths.iter().map(|path| path.as_ptr() as u64).collect::<Vec<_>>()),
            'T' => {
                let ns = random_short(random);
                self.words(random, &[0, ns])
            }
            'I' => {
                let base = self.pointer(random);
                let length = random.of(&[0, 1, 100, 4_096, 65_536]);
                self.words(random, &[base, length, base, 16, base, 1 << 40])
            }
            'S' => {
                let port = (40_000 + random.below(100)) as u16;
                let family = random.of(&[2_u64, 2, 10, 1, 29]);
                let word = family | u64::from(port.to_be()) << 16 | 0x0100_007f << 32;
                self.words(random, &[word, 0, 0, 0])
            }
            'p' | '!' => self.pointer(random),
            'a' => match random.below(256) {
                0 => random.of(&self.addresses),
                1..=16 => random.word() & !0xfff,
                _ => self.toy + (random.below(ARENA as u64) & !0xfff),
            },
            'R' => {
                random.of(&[2, 3, 4, 8, 15, 16, 21, 22, 23, 29, 30, 36, 38, 39, 41, 42, 47, 59, 0x5356_4d41])
            }
            'F' => random.of(&[2, 2, 2, 2, 10, 10, 10, 1]),
            'K' => random.of(&[1, 2, 1 | 2048, 2 | 2048]),
            'm' => {
                // Message headers: a name, parts, control data.
                let (name, control) = (self.pointer(random), self.pointer(random));
                let parts = self.argument('I', random);
                let length = random.below(32);
                self.words(random, &[name, length, parts, 1, control, 24, 0])
            }
            digit if digit.is_ascii_digit() => u64::from(digit) - u64::from('0'),
            _ => match random.below(8) {
                0 => random.word(),
                1 => self.argument('f', random),
                2 => self.argument('n', random),
                3 => self.argument('d', random),
                4 => self.argument('P', random),
                5 => self.argument('a', random),
                _ => self.pointer(random),
            },
        }
    }

    /// Mostly into the arena, behind which lie words of all kinds.
    fn pointer(&self, random: &mut Random) -> u64 {
        match random.below(1024) {
            0..=63 => 0,
            64..=79 => u64::MAX,
            80 => random.of(&self.addresses) + (random.below(64) << 3),
            _ => {
                let words: Vec<u64> = (0..8)
                    .map(|_| match random.below(6) {
                        0 => 0,
                        1 => random.below(256),
                        2 => self.arena + random.below(ARENA as u64 - 4_096),
                        3 => random.word(),
                        4 => random.of(&[4_096, 1_000_000, 1, u64::from(u32::MAX), 40 << 32]),
                        _ => 1 << random.below(64),
                    })
                    .collect();
                self.words(random, &words)
            }
        }
    }

    /// Puts words somewhere into the arena.
    fn words(&self, random: &mut Random, words: &[u64]) -> u64 {
        let place = self.arena + (random.below(ARENA as u64 - 4_096) & !7);
        // SAFETY: inside the arena, unless a call has unmapped it, which ends this incarnation.
        unsafe { std::ptr::copy_nonoverlapping(words.as_ptr(), place as *mut u64, words.len()) };
        place
    }
}

fn own_pid() -> u64 {
    std::process::id().into()
}

/// Nanoseconds that cost no incarnation to wait for, mostly.
fn random_short(random: &mut Random) -> u64 {
    random.of(&[0, 0, 1, 1_000, 100_000, 1_000_000, 19_000_000, 1_000_000_000])
}

/// The folders of its own channels, as its memory map names them.
fn own_channels(maps: &str) -> Vec<String> {
    let lines = maps.lines().filter_map(|line| line.find("/dev/shm/").map(|place| &line[place..]));
    let folder = |path: &str| {
        let (run, rest) = path.split_once("/ports/")?;
        Some(format!("{run}/ports/{}", rest.split('/').next()?))
    };
    let mut folders: Vec<String> = lines.filter_map(folder).collect();
    folders.sort_unstable();
    folders.dedup();
    folders
}

/// Calls that end this incarnation, or hold it until it is ended.
const RARE: &[c_long] = &[
    libc::SYS_exit,
    libc::SYS_exit_group,
    libc::SYS_execve,
    libc::SYS_execveat,
    libc::SYS_rt_sigreturn,
    libc::SYS_rt_sigsuspend,
    libc::SYS_rt_sigtimedwait,
    libc::SYS_rt_sigaction,
    libc::SYS_restart_syscall,
    libc::SYS_sigaltstack,
    libc::SYS_wait4,
    libc::SYS_waitid,
    libc::SYS_munmap,
    libc::SYS_mremap,
    libc::SYS_brk,
    libc::SYS_close_range,
    libc::SYS_set_tid_address,
    libc::SYS_set_robust_list,
    libc::SYS_rseq,
    libc::SYS_kill,
    libc::SYS_tkill,
    libc::SYS_tgkill,
    libc::SYS_rt_sigqueueinfo,
    libc::SYS_rt_tgsigqueueinfo,
    libc::SYS_ppoll,
    libc::SYS_pselect6,
    libc::SYS_flock,
    libc::SYS_prlimit64,
    libc::SYS_setrlimit,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_arch_prctl,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_pause,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_poll,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_select,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_alarm,
];

/// Calls whose arguments are known. A letter is a kind of argument; `!`: it makes a descriptor.
const SHAPES: &[(c_long, &str)] = &[
    (libc::SYS_read, "dpn"),
    (libc::SYS_write, "dpn"),
    (libc::SYS_readv, "dIi"),
    (libc::SYS_writev, "dIi"),
    (libc::SYS_pread64, "dpno"),
    (libc::SYS_pwrite64, "dpno"),
    (libc::SYS_preadv2, "dIioof"),
    (libc::SYS_pwritev2, "dIioof"),
    (libc::SYS_dup, "d!"),
    (libc::SYS_dup3, "ddf!"),
    (libc::SYS_close, "d"),
    (libc::SYS_fcntl, "dif"),
    (libc::SYS_fcntl, "dip"),
    (libc::SYS_ioctl, "dfp"),
    (libc::SYS_lseek, "doi"),
    (libc::SYS_pipe2, "pf"),
    (libc::SYS_splice, "dpdpnf"),
    (libc::SYS_tee, "ddnf"),
    (libc::SYS_vmsplice, "dIif"),
    (libc::SYS_sendfile, "ddpn"),
    (libc::SYS_copy_file_range, "dpdpnf"),
    (libc::SYS_fsync, "d"),
    (libc::SYS_sync_file_range, "doof"),
    (libc::SYS_ftruncate, "do"),
    (libc::SYS_truncate, "Po"),
    (libc::SYS_fallocate, "dioo"),
    (libc::SYS_fadvise64, "dooi"),
    (libc::SYS_readahead, "don"),
    (libc::SYS_openat, "dPff!"),
    (libc::SYS_openat, "dPi!"),
    (libc::SYS_openat2, "dPpi!"),
    (libc::SYS_newfstatat, "dPpf"),
    (libc::SYS_getdents64, "dpn"),
    (libc::SYS_chdir, "P"),
    (libc::SYS_fchdir, "d"),
    (libc::SYS_mkdirat, "dPf"),
    (libc::SYS_unlinkat, "dPf"),
    (libc::SYS_renameat2, "dPdPi"),
    (libc::SYS_linkat, "dPdPf"),
    (libc::SYS_symlinkat, "PdP"),
    (libc::SYS_fchmod, "df"),
    (libc::SYS_fchmodat, "dPff"),
    (libc::SYS_fchownat, "dPttf"),
    (libc::SYS_utimensat, "dPTf"),
    (libc::SYS_umask, "f"),
    (libc::SYS_inotify_init1, "f!"),
    (libc::SYS_inotify_add_watch, "dPf"),
    (libc::SYS_epoll_create1, "f!"),
    (libc::SYS_epoll_ctl, "didp"),
    (libc::SYS_epoll_pwait, "dpi0"),
    (libc::SYS_eventfd2, "if!"),
    (libc::SYS_signalfd4, "dp8f!"),
    (libc::SYS_timerfd_create, "if!"),
    (libc::SYS_timerfd_settime, "difp"),
    (libc::SYS_timer_create, "ipp"),
    (libc::SYS_timer_settime, "iipp"),
    (libc::SYS_timer_delete, "i"),
    (libc::SYS_setitimer, "ipp"),
    (libc::SYS_futex, "pfiTpi"),
    (libc::SYS_futex, "aiiTai"),
    (libc::SYS_futex_waitv, "pifTi"),
    (libc::SYS_nanosleep, "Tp"),
    (libc::SYS_clock_nanosleep, "iiTp"),
    (libc::SYS_mmap, "anffdo!"),
    (libc::SYS_mmap, "0nfidoo"),
    (libc::SYS_mprotect, "ani"),
    (libc::SYS_madvise, "ani"),
    (libc::SYS_msync, "anf"),
    (libc::SYS_mincore, "anp"),
    (libc::SYS_mlock2, "anf"),
    (libc::SYS_mlockall, "i"),
    (libc::SYS_munlock, "an"),
    (libc::SYS_munmap, "an"),
    (libc::SYS_mremap, "annfa"),
    (libc::SYS_memfd_create, "Pf!"),
    (libc::SYS_membarrier, "fii"),
    (libc::SYS_rt_sigprocmask, "ipp8"),
    (libc::SYS_rt_sigqueueinfo, "tsp"),
    (libc::SYS_kill, "ts"),
    (libc::SYS_tgkill, "tts"),
    (libc::SYS_clone, "f"),
    (libc::SYS_execveat, "dPppf"),
    (libc::SYS_wait4, "tpfp"),
    (libc::SYS_prctl, "Rxxxx"),
    (libc::SYS_prlimit64, "tipp"),
    (libc::SYS_getrandom, "pnf"),
    (libc::SYS_sched_yield, ""),
    (libc::SYS_socket, "FKi!"),
    (libc::SYS_socketpair, "1iip"),
    (libc::SYS_bind, "dSi"),
    (libc::SYS_connect, "dSi"),
    (libc::SYS_listen, "di"),
    (libc::SYS_accept4, "dppf!"),
    (libc::SYS_sendto, "dpnfSi"),
    (libc::SYS_recvfrom, "dpnfpp"),
    (libc::SYS_sendmsg, "dmf"),
    (libc::SYS_recvmsg, "dmf"),
    (libc::SYS_sendmmsg, "dmif"),
    (libc::SYS_setsockopt, "diipn"),
    (libc::SYS_setsockopt, "diipi"),
    (libc::SYS_getsockopt, "diipp"),
    (libc::SYS_shutdown, "di"),
    (libc::SYS_shmget, "inf"),
    (libc::SYS_shmat, "iaf"),
    (libc::SYS_shmctl, "iip"),
    (libc::SYS_semget, "inf"),
    (libc::SYS_semop, "ipi"),
    (libc::SYS_semctl, "iiip"),
    (libc::SYS_msgget, "if"),
    (libc::SYS_msgsnd, "ipnf"),
    (libc::SYS_msgrcv, "ipnif"),
    (libc::SYS_mq_open, "Pffp!"),
    (libc::SYS_mq_timedsend, "dpniT"),
    (libc::SYS_mq_notify, "dp"),
];

fn main() -> ExitCode {
    bateleur_apex::run::<Fuzzer>()
}
