//! What a process does about a signal, as the kernel knows it.

use std::fs;

/// What becomes of a signal that reaches a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Disposition {
    /// What signal(7) says.
    Default,
    /// Nothing.
    Ignored,
    /// A handler of its own.
    Handled,
}

/// What process `pid` does about signal number `signal`; the default where the kernel does not tell.
pub fn of(pid: i32, signal: i32) -> Disposition {
    disposition(&status(pid), signal)
}

fn status(pid: i32) -> String {
    fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default()
}

/// A line of the file (proc_pid_status(5)). The name, which the process chooses, is on one line, its ends of lines escaped.
fn field<'a>(status: &'a str, name: &str) -> Option<&'a str> {
    status.lines().find_map(|line| line.strip_prefix(name)).map(str::trim)
}

fn disposition(status: &str, signal: i32) -> Disposition {
    let has = |name| {
        let mask = field(status, name).and_then(|text| u64::from_str_radix(text, 16).ok()).unwrap_or(0);
        mask >> (signal - 1) & 1 == 1
    };
    if has("SigIgn:") {
        Disposition::Ignored
    } else if has("SigCgt:") {
        Disposition::Handled
    } else {
        Disposition::Default
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_of_the_kernel_are_read() {
        let status = "Name:\tSigIgn: ffff\nState:\tT (stopped)\nSigIgn:\t0000000000001000\nSigCgt:\t0000000000000440\n";
        let of = |signal| disposition(status, signal);
        assert_eq!(
            (of(13), of(7), of(11)),
            (Disposition::Ignored, Disposition::Handled, Disposition::Handled)
        );
        assert_eq!((of(15), disposition("", 15)), (Disposition::Default, Disposition::Default));
        assert_eq!(field(status, "State:"), Some("T (stopped)"));
    }
}
