//! Which system calls a partition may make: four filters (seccomp), built before there is a process.
//!
//! - what no partition has any business with ends its process with SIGSYS, which health monitoring calls an illegal request;
//! - what a program may try in good faith, and shall not have, is refused (EPERM);
//! - synchronisation with the disk is answered as done;
//! - of the rest, what is on a list is allowed, and everything else does not exist (ENOSYS): also what kernels to come
//!   will add. Programs and C libraries that probe for a new call fall back to an old one.
//!
//! Every call on the list has its reason in `calls.rs`. The filters never decide by a file's name, which they can not see: that is
//! the business of [`super::rules`].
#![allow(unsafe_code)]

mod calls;

use std::collections::BTreeMap;
use std::io;

use calls::{
    CHILDREN_OF_OLD, DEADLY, DEADLY_OF_OLD, DEADLY_SOMETIMES, DONE, Family, GRANTABLE, NETWORK, Named,
    ORDINARY, REFUSED, REFUSED_OF_OLD, SOCKET_CALLS,
};
use seccompiler::{
    BpfProgram, SeccompAction, SeccompCmpArgLen, SeccompCmpOp, SeccompCondition, SeccompFilter, SeccompRule,
};

/// What the plan grants, as far as it changes the filters.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Grants {
    /// Internet sockets, and those of CAN buses.
    pub network: bool,
    /// More than one thread or process.
    pub threads: bool,
    /// Every control of a device.
    pub devices: bool,
    /// What the plan grants by name, as far as this machine can keep it within the partition.
    pub named: Vec<&'static str>,
}

/// The filters of a partition.
#[derive(Debug, Clone)]
pub struct Filters(Vec<BpfProgram>);

type Rules = BTreeMap<i64, Vec<SeccompRule>>;
type RuleList = Result<Vec<SeccompRule>, seccompiler::BackendError>;
type Condition = Result<SeccompCondition, seccompiler::BackendError>;

/// `SECCOMP_SET_MODE_FILTER`; the C library has no binding.
const SET_MODE_FILTER: libc::c_ulong = 1;

impl Filters {
    /// The filters for `grants`.
    ///
    /// # Errors
    /// A processor for which none can be built.
    pub fn new(grants: &Grants) -> io::Result<Self> {
        let build = || -> Result<Vec<BpfProgram>, seccompiler::BackendError> {
            let (deadly, refused) = (deadly(grants)?, refused(grants)?);
            let mut allowed = allowed(grants)?;
            allowed.extend(whole(DONE));
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
                compile(whole(DONE), SeccompAction::Allow, SeccompAction::Errno(0))?,
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

/// The calls whatever their arguments.
fn whole<'a>(calls: impl IntoIterator<Item = &'a Named>) -> Rules {
    calls.into_iter().map(|(call, _)| (*call, Vec::new())).collect()
}

/// A call with any of `values` as an argument.
fn one_of(argument: u8, values: &[libc::c_int]) -> RuleList {
    values.iter().map(|value| rule([is(argument, *value)])).collect()
}

/// Flags of `clone` that no child has: namespaces, and another parent.
const FLAGS_OF_NONE: u64 = (libc::CLONE_PARENT
    | libc::CLONE_NEWNS
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

fn deadly(grants: &Grants) -> Result<Rules, seccompiler::BackendError> {
    let mut rules = whole(DEADLY.iter().chain(DEADLY_OF_OLD));
    rules.insert(libc::SYS_prctl, vec![rule([is(0, libc::PR_SET_PDEATHSIG)])?]);
    rules.insert(libc::SYS_ioctl, one_of(1, &[TIOCSTI, TIOCLINUX])?);
    let mut sockets = vec![rule(
        [libc::AF_UNIX, libc::AF_NETLINK, libc::AF_INET, libc::AF_INET6, libc::AF_CAN]
            .map(|family| is_not(0, family)),
    )?];
    if !grants.network {
        sockets.push(rule([is(0, libc::AF_CAN)])?);
    }
    if grants.network {
        sockets.extend(internet_sockets(&[libc::SOCK_RAW, SOCK_PACKET])?);
    } else {
        sockets.extend(one_of(0, &[libc::AF_INET, libc::AF_INET6])?);
    }
    rules.insert(libc::SYS_socket, sockets);
    if !grants.threads {
        rules.insert(libc::SYS_clone, Vec::new());
        rules.extend(whole(CHILDREN_OF_OLD));
    }
    Ok(rules)
}

fn refused(grants: &Grants) -> Result<Rules, seccompiler::BackendError> {
    let mut rules = whole(REFUSED.iter().chain(REFUSED_OF_OLD));
    let not_granted = GRANTABLE.iter().filter(|(name, _)| !grants.named.contains(name));
    rules.extend(whole(not_granted.flat_map(|(_, family)| family.all())));
    // These are allowed with some arguments.
    let in_part = [libc::SYS_madvise, libc::SYS_fchmod, libc::SYS_fchmodat];
    rules.retain(|call, _| !in_part.contains(call) && !is_old_chmod(*call));
    // The machine's pool of huge pages counts as nobody's memory.
    for (call, argument, flag) in HUGE_PAGES {
        rules.entry(*call).or_insert(vec![rule([bits_are(*argument, *flag, *flag)])?]);
    }
    // A path to a socket is neither a file that is opened nor an address: nothing else stands in its way. Netlink is asked by
    // the C library's resolver, which does without.
    let mut sockets = one_of(0, &[libc::AF_UNIX, libc::AF_NETLINK])?;
    // The kernel keeps more for TCP than it counts: it lets no connection starve, and asks nobody before one is accepted.
    if !grants.named.contains(&TCP) {
        sockets.extend(internet_sockets(&[libc::SOCK_STREAM])?);
    }
    // It counts the frames that wait in a socket of CAN as nobody's memory, and nothing counts such sockets.
    if !grants.named.contains(&CAN) {
        sockets.push(rule([is(0, libc::AF_CAN)])?);
    }
    rules.insert(libc::SYS_socket, sockets);
    // A datagram that is never complete waits for ever, as nobody's memory.
    for (call, argument) in [(libc::SYS_sendto, 3), (libc::SYS_sendmsg, 2), (libc::SYS_sendmmsg, 3)] {
        let more = libc::MSG_MORE as u64;
        rules.entry(call).or_insert(vec![rule([bits_are(argument, more, more)])?]);
    }
    Ok(rules)
}

/// Sockets of the internet of these types.
fn internet_sockets(kinds: &[libc::c_int]) -> RuleList {
    let families = [libc::AF_INET, libc::AF_INET6];
    let all = families.iter().flat_map(|family| kinds.iter().map(move |kind| (*family, *kind)));
    all.map(|(family, kind)| rule([is(0, family), bits_are(1, SOCKET_TYPE, u64::from(kind.cast_unsigned()))]))
        .collect()
}

#[cfg(target_arch = "x86_64")]
fn is_old_chmod(call: i64) -> bool {
    call == libc::SYS_chmod
}

/// Only x86-64 has it.
#[cfg(not(target_arch = "x86_64"))]
fn is_old_chmod(_call: i64) -> bool {
    false
}

fn allowed(grants: &Grants) -> Result<Rules, seccompiler::BackendError> {
    let mut rules = whole(ORDINARY.iter().flat_map(Family::all));
    rules.insert(libc::SYS_prctl, one_of(0, PROCESS_CONTROLS)?);
    // Limits can be read.
    rules.insert(libc::SYS_prlimit64, vec![rule([bits_are(2, u64::MAX, 0)])?]);
    rules.insert(libc::SYS_fcntl, one_of(1, DESCRIPTOR_CONTROLS)?);
    let of_sockets = if grants.network { NETWORK_REQUESTS } else { &[] };
    let requests = [ORDINARY_REQUESTS, of_sockets].concat();
    rules.insert(libc::SYS_ioctl, if grants.devices { Vec::new() } else { one_of(1, &requests)? });
    rules.insert(libc::SYS_madvise, one_of(2, MEMORY_ADVICE)?);
    let usable = |argument| -> RuleList {
        USABLE_BY_OWNER.iter().map(|bit| rule([bits_are(argument, SPECIAL_MODES | bit, *bit)])).collect()
    };
    rules.insert(libc::SYS_fchmod, usable(1)?);
    rules.insert(libc::SYS_fchmodat, usable(2)?);
    #[cfg(target_arch = "x86_64")]
    rules.insert(libc::SYS_chmod, usable(1)?);
    if grants.threads {
        rules.insert(libc::SYS_clone, vec![rule([bits_are(0, FLAGS_OF_NONE, 0)])?]);
        rules.extend(whole(CHILDREN_OF_OLD));
    }
    let granted = GRANTABLE.iter().filter(|(name, _)| grants.named.contains(name));
    rules.extend(whole(granted.flat_map(|(_, family)| family.all())));
    if grants.network {
        rules.extend(whole(NETWORK.all()));
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
        // Frames of a CAN bus, whose raw sockets see that bus and nothing else. Refused where the plan does not name them.
        let raw = bits_are(1, SOCKET_TYPE, u64::from(libc::SOCK_RAW.cast_unsigned()));
        sockets.push(rule([is(0, libc::AF_CAN), raw, is(2, libc::CAN_RAW)])?);
        sockets.extend(one_of(0, &[libc::AF_UNIX, libc::AF_NETLINK])?);
        rules.insert(libc::SYS_socket, sockets);
    }
    if grants.network || grants.named.contains(&LOCAL_SOCKETS) {
        rules.extend(whole(SOCKET_CALLS));
        let of_sockets = [is(1, libc::SOL_SOCKET)];
        let harmless = SOCKET_OPTIONS_OF_NONE.iter().map(|option| is_not(2, *option));
        let of_protocols =
            [libc::SOL_SOCKET, libc::SOL_UDP, libc::IPPROTO_UDPLITE].map(|level| is_not(1, level));
        rules.insert(
            libc::SYS_setsockopt,
            vec![
                rule(of_sockets.into_iter().chain(harmless))?,
                rule(of_protocols.into_iter().chain([is_not(2, TCP_ULP)]))?,
            ],
        );
    }
    Ok(rules)
}

/// The name of a system call that can be deadly.
#[must_use]
pub fn name_of(number: i64) -> Option<&'static str> {
    let sometimes = DEADLY_SOMETIMES.iter().chain(CHILDREN_OF_OLD);
    let mut all = DEADLY.iter().chain(DEADLY_OF_OLD).chain(sometimes);
    all.find(|(call, _)| *call == number).map(|(_, name)| plain(name))
}

fn plain(name: &'static str) -> &'static str {
    name.trim_start_matches("SYS_")
}

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

/// Commands of `fcntl`: copies, flags, locks and seals. No signals about descriptors, no leases, no larger pipes.
const DESCRIPTOR_CONTROLS: &[libc::c_int] = &[
    libc::F_DUPFD,
    libc::F_DUPFD_CLOEXEC,
    libc::F_GETFD,
    libc::F_SETFD,
    libc::F_GETFL,
    libc::F_SETFL,
    libc::F_GETLK,
    libc::F_SETLK,
    libc::F_SETLKW,
    libc::F_OFD_GETLK,
    libc::F_OFD_SETLK,
    libc::F_OFD_SETLKW,
    libc::F_GETPIPE_SZ,
    libc::F_ADD_SEALS,
    libc::F_GET_SEALS,
];

/// Requests of `ioctl` without a device: whether it is a terminal, how much can be read, whether to wait, whether to close.
const ORDINARY_REQUESTS: &[libc::c_int] = &[
    libc::TCGETS as libc::c_int,
    libc::TIOCGWINSZ as libc::c_int,
    libc::FIONREAD as libc::c_int,
    libc::FIONBIO as libc::c_int,
    libc::FIOCLEX as libc::c_int,
    libc::FIONCLEX as libc::c_int,
];

/// Requests of `ioctl` with the network: names, numbers, addresses, states and sizes of interfaces, and what is unsent. They only read.
const NETWORK_REQUESTS: &[libc::c_int] = &[
    libc::SIOCGIFNAME as libc::c_int,
    libc::SIOCGIFCONF as libc::c_int,
    libc::SIOCGIFFLAGS as libc::c_int,
    libc::SIOCGIFADDR as libc::c_int,
    libc::SIOCGIFDSTADDR as libc::c_int,
    libc::SIOCGIFBRDADDR as libc::c_int,
    libc::SIOCGIFNETMASK as libc::c_int,
    libc::SIOCGIFMTU as libc::c_int,
    libc::SIOCGIFHWADDR as libc::c_int,
    libc::SIOCGIFINDEX as libc::c_int,
    libc::TIOCOUTQ as libc::c_int,
];

/// Advice of `madvise` that changes the partition's own pages only and puts nothing off.
const MEMORY_ADVICE: &[libc::c_int] = &[
    libc::MADV_NORMAL,
    libc::MADV_RANDOM,
    libc::MADV_SEQUENTIAL,
    libc::MADV_DONTNEED,
    libc::MADV_FREE,
    libc::MADV_NOHUGEPAGE,
    libc::MADV_DONTDUMP,
    libc::MADV_DODUMP,
    libc::MADV_WIPEONFORK,
];

/// A file may be given modes with which its owner reads or writes it, so that whoever cleans up as that user can open it.
const USABLE_BY_OWNER: [u64; 2] = [0o400, 0o200];
/// The bits of another user, another group and a directory's owner, which no file gets.
const SPECIAL_MODES: u64 = 0o7000;

/// Calls that take huge pages, the argument that asks for it, and its flag.
const HUGE_PAGES: &[(i64, u8, u64)] = &[
    (libc::SYS_mmap, 3, libc::MAP_HUGETLB as u64),
    (libc::SYS_memfd_create, 1, libc::MFD_HUGETLB as u64),
    (libc::SYS_shmget, 2, libc::SHM_HUGETLB as u64),
];

/// The family that lets a partition with the network make connections.
const TCP: &str = "tcp";
/// The family that lets a partition with the network use the machine's CAN buses.
const CAN: &str = "can";
/// The family that lets a partition use sockets that it did not make by `socket`.
const LOCAL_SOCKETS: &str = "local_sockets";

/// Options of sockets that put programs, polling or pinned pages into the kernel, or let more of what was sent wait there (numbers
/// of `asm-generic/socket.h`). Of the level of UDP there are none: they keep datagrams back, or hand them to other parts of the kernel.
const SOCKET_OPTIONS_OF_NONE: &[libc::c_int] = &[
    libc::SO_ATTACH_FILTER,
    libc::SO_ATTACH_BPF,
    libc::SO_ATTACH_REUSEPORT_CBPF,
    libc::SO_ATTACH_REUSEPORT_EBPF,
    libc::SO_SNDBUF,
    libc::SO_SNDBUFFORCE,
    libc::SO_BUSY_POLL,
    libc::SO_ZEROCOPY,
    libc::SO_TXTIME,
    SO_PREFER_BUSY_POLL,
    SO_BUSY_POLL_BUDGET,
    SO_RESERVE_MEM,
];
const SO_PREFER_BUSY_POLL: libc::c_int = 69;
const SO_BUSY_POLL_BUDGET: libc::c_int = 70;
const SO_RESERVE_MEM: libc::c_int = 73;
/// Loads a protocol above TCP into the kernel.
const TCP_ULP: libc::c_int = 31;

/// Every allowed call with its reason and its bound, as the book's page shows it.
#[must_use]
pub fn page() -> String {
    let row =
        |calls: String, family: &Family| format!("| {calls} | {} | {} |\n", family.reason, family.bound);
    let names = |family: &Family| {
        // Without those of x86-64 alone: the page is the same on every processor.
        let new = family.calls.iter().map(|(_, name)| format!("`{}`", plain(name)));
        new.collect::<Vec<_>>().join(" ")
    };
    let mut text = String::from("| calls | what for | what bounds it |\n|---|---|---|\n");
    ORDINARY.iter().chain([&NETWORK]).for_each(|family| text += &row(names(family), family));
    text += "\n| `system_calls` | calls | what for | what bounds it |\n|---|---|---|---|\n";
    for (name, family) in GRANTABLE {
        text += &format!("| `{name}` {}", row(names(family), family));
    }
    text
}

/// The names of the families of calls that a plan may grant.
pub fn grantable() -> impl Iterator<Item = &'static str> {
    GRANTABLE.iter().map(|(name, _)| *name)
}

/// The numbers of all calls that end a process with these grants, whatever their arguments are; for who makes calls at
/// random.
#[must_use]
pub fn deadly_numbers(grants: &Grants) -> Vec<i64> {
    let rules = deadly(grants).unwrap_or_default();
    rules.into_iter().filter_map(|(call, conditions)| conditions.is_empty().then_some(call)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn every_grant() -> impl Iterator<Item = Grants> {
        let named = GRANTABLE.iter().map(|(name, _)| *name);
        let all: Vec<&'static str> = named.collect();
        (0..16).map(move |bits| Grants {
            network: bits & 1 != 0,
            threads: bits & 2 != 0,
            devices: bits & 4 != 0,
            named: if bits & 8 != 0 { all.clone() } else { Vec::new() },
        })
    }

    #[test]
    fn the_kernel_takes_filters_of_this_length() {
        for grants in every_grant() {
            let filters = Filters::new(&grants).unwrap();
            assert!(filters.0.iter().all(|program| program.len() < 4096), "{grants:?}");
        }
    }

    #[test]
    fn nothing_deadly_is_on_the_list_of_what_is_allowed() {
        for grants in every_grant() {
            let (deadly, allowed) = (deadly(&grants).unwrap(), allowed(&grants).unwrap());
            // An empty list of rules concerns the whole call.
            let both = deadly.iter().find(|(call, rules)| rules.is_empty() && allowed.contains_key(*call));
            assert_eq!(both, None, "{grants:?}");
        }
    }

    #[test]
    fn one_thread_ends_at_clone_and_several_may_clone() {
        let one = Grants::default();
        assert!(deadly(&one).unwrap().contains_key(&libc::SYS_clone));
        let several = Grants { threads: true, ..one };
        assert!(!deadly(&several).unwrap().contains_key(&libc::SYS_clone));
        assert_eq!(allowed(&several).unwrap()[&libc::SYS_clone].len(), 1, "without namespaces");
    }

    const PAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/src/system-calls.md");

    #[test]
    fn the_book_says_of_every_allowed_call_what_it_is_for_and_what_bounds_it() {
        let text = std::fs::read_to_string(PAGE).unwrap();
        let (before, rest) = text.split_once("<!-- made: calls -->\n").unwrap();
        let (made, after) = rest.split_once("<!-- /made -->").unwrap();
        if std::env::var_os("BLESS").is_some() {
            let text = format!("{before}<!-- made: calls -->\n\n{}\n<!-- /made -->{after}", page());
            return std::fs::write(PAGE, text).unwrap();
        }
        assert!(
            made.trim() == page().trim(),
            "{PAGE} differs; run again with BLESS=1 if this is meant:\n{}",
            page()
        );
    }

    #[test]
    fn no_call_is_on_two_lists() {
        let granted = GRANTABLE.iter().flat_map(|(_, family)| family.all());
        let all = ORDINARY.iter().chain([&NETWORK]).flat_map(Family::all).chain(granted).chain(SOCKET_CALLS);
        let mut names: Vec<_> = all
            .chain(REFUSED)
            .chain(REFUSED_OF_OLD)
            .chain(DEADLY)
            .chain(DEADLY_OF_OLD)
            .map(|(_, name)| name)
            .collect();
        let count = names.len();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), count);
    }
}
