//! Which forbidden system call ended a process: the kernel says so in its log, and nowhere else.
//!
//! Responsible for: an answer where there is one. The log can be read by root, on a machine whose records no audit service
//! takes, in the first namespace of process numbers; the kernel drops records where there are many. It must never hold up
//! its caller for longer than it says, nor believe what a process could have written.

use std::fmt;
use std::fs::File;
use std::io::Read;
use std::os::fd::AsFd;
use std::os::unix::fs::OpenOptionsExt;

use crate::wait::await_any_end;

use super::filter;

/// The kernel's log, a record at a time.
const LOG: &str = "/dev/kmsg";
/// What the kernel calls a record about a system call that a filter answered.
const SECCOMP: &str = "audit: type=1326 ";
/// A record is not longer, bytes.
const LONGEST: usize = 8192;
/// Records looked through at a time, most.
const RECORDS: usize = 4096;
/// The kernel writes the record by a thread of its own, soon after the end: so long it is waited for, ns.
const PATIENCE_NS: u64 = 3_000_000;

/// `AUDIT_ARCH_X86_64`.
#[cfg(target_arch = "x86_64")]
const PROCESSOR: &str = "c000003e";
/// `AUDIT_ARCH_AARCH64`.
#[cfg(target_arch = "aarch64")]
const PROCESSOR: &str = "c00000b7";

/// A system call that ended a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Call {
    /// Its number; `None` if it was one of another processor's way to call (32 bits).
    number: Option<i64>,
}

impl fmt::Display for Call {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.number.map(|number| (number, filter::name_of(number))) {
            Some((number, Some(name))) => write!(f, "system call {number} ({name})"),
            Some((number, None)) => write!(f, "system call {number}"),
            None => f.write_str("a system call in the manner of another processor"),
        }
    }
}

/// Reads what the kernel has written since the last look.
#[derive(Debug)]
pub struct KernelLog(Option<File>);

impl KernelLog {
    /// From now on; where it can not be read, nothing is ever found.
    #[must_use]
    pub fn open() -> Self {
        let nonblocking = rustix::fs::OFlags::NONBLOCK.bits().cast_signed();
        let file = File::options().read(true).custom_flags(nonblocking).open(LOG).ok();
        // Its end is a place in the records, not in bytes: seek from the end by nothing.
        Self(file.filter(|file| rustix::fs::seek(file, rustix::fs::SeekFrom::End(0)).is_ok()))
    }

    /// The call that ended process `pid`. Waits for some milliseconds at most.
    pub fn call_that_ended(&mut self, pid: i32) -> Option<Call> {
        let mut tries = 0;
        loop {
            let found = self.look(pid);
            tries += 1;
            if found.is_some() || tries == 2 {
                return found;
            }
            await_any_end(&[self.0.as_ref()?.as_fd()], PATIENCE_NS);
        }
    }

    fn look(&mut self, pid: i32) -> Option<Call> {
        let file = self.0.as_mut()?;
        let mut record = [0; LONGEST];
        let mut found = None;
        for _ in 0..RECORDS {
            match file.read(&mut record) {
                Ok(0) => break,
                Ok(length) => found = call_in(&String::from_utf8_lossy(&record[..length]), pid).or(found),
                // Written over before it was read, or interrupted: on with the next.
                Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => {}
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(_) => break,
            }
        }
        found
    }
}

/// The call of process `pid` that a record tells of. What a process can choose in it, its name and program, the kernel
/// writes in quotation marks without blanks, or as hexadecimal digits: no word of it can be taken for another.
fn call_in(record: &str, pid: i32) -> Option<Call> {
    let (_, text) = record.lines().next()?.split_once(';')?;
    let words = text.strip_prefix(SECCOMP)?;
    let value = |key: &str| words.split(' ').find_map(|word| word.strip_prefix(key)?.strip_prefix('='));
    if value("pid")?.parse() != Ok(pid) || value("sig") != Some("31") {
        return None;
    }
    let number = (value("arch")? == PROCESSOR).then(|| value("syscall")?.parse().ok()).flatten();
    Some(Call { number })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(arch: &str, number: i64) -> String {
        format!(
            "5,1234,22962451447,-;audit: type=1326 audit(1795250408.872:257): auid=4294967295 uid=61653 gid=61653 \
             ses=4294967295 pid=19913 comm=\"middle\" exe=\"/tmp/hostile\" sig=31 arch={arch} syscall={number} compat=0 \
             ip=0x7f5b95eae829 code=0x80000000\n SUBSYSTEM=none\n"
        )
    }

    #[test]
    fn call_is_told_by_number_and_name() {
        let call = call_in(&record(PROCESSOR, libc::SYS_mount), 19913).unwrap();
        assert_eq!(call.to_string(), format!("system call {} (mount)", libc::SYS_mount));
        let unnamed = call_in(&record(PROCESSOR, 9999), 19913).unwrap();
        assert_eq!(unnamed.to_string(), "system call 9999");
    }

    #[test]
    fn call_of_another_process_or_another_kind_of_record_is_not_taken() {
        assert_eq!(call_in(&record(PROCESSOR, 1), 19914), None);
        assert_eq!(call_in(&record(PROCESSOR, 1).replace("1326", "1400"), 19913), None);
        assert_eq!(call_in("4,1,2,-;middle: type=1326 pid=19913 sig=31 syscall=1", 19913), None);
        assert_eq!(call_in("", 1), None);
    }

    #[test]
    fn call_in_the_manner_of_another_processor_has_no_number_that_could_mislead() {
        let call = call_in(&record("40000003", 11), 19913).unwrap();
        assert_eq!(call.to_string(), "a system call in the manner of another processor");
    }
}
