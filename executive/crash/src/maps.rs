//! The map of a process's memory, as the kernel tells it (proc_pid_maps(5)) and a dead process has passed it on.

/// Lines that are looked at, most.
const MOST: usize = 1024;
/// Bytes of a path, most.
const LONGEST: usize = 1024;

/// One range of memory.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mapping {
    /// Its first address.
    pub from: u64,
    /// The address behind its last.
    pub to: u64,
    /// Code may run there.
    pub runs: bool,
    /// Where it begins in its file.
    pub offset: u64,
    /// Its file; empty: none, or what is no file.
    pub path: String,
}

impl Mapping {
    /// Whether an address lies in it.
    #[must_use]
    pub fn contains(&self, address: u64) -> bool {
        (self.from..self.to).contains(&address)
    }
}

/// Lines that are none are left out.
pub(crate) fn read(text: &[u8]) -> Vec<Mapping> {
    text.split(|byte| *byte == b'\n').take(MOST).filter_map(line).collect()
}

fn line(line: &[u8]) -> Option<Mapping> {
    let line = std::str::from_utf8(line).ok()?;
    let mut cells = line.splitn(6, ' ');
    let (from, to) = cells.next()?.split_once('-')?;
    let number = |text: &str| u64::from_str_radix(text, 16).ok();
    let (from, to) = (number(from)?, number(to)?);
    let access = cells.next()?;
    let offset = number(cells.next()?)?;
    let (_device, _inode) = (cells.next()?, cells.next()?);
    let path = cells.next().unwrap_or_default().trim_start();
    let is_file = path.starts_with('/') && path.len() <= LONGEST;
    let path = if is_file { path.to_owned() } else { String::new() };
    (from < to).then(|| Mapping { from, to, runs: access.as_bytes().get(2) == Some(&b'x'), offset, path })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_read_and_what_is_none_is_left_out() {
        let text = b"55d0-55e0 r-xp 00001000 fe:01 77                 /opt/a program\n\
                     7ffc-7ffd rw-p 00000000 00:00 0                  [stack]\nrubbish\n20-10 r-xp 0 0 0\n7f00-7f10 r--p 0";
        let found = read(text);
        assert_eq!(found.len(), 2);
        let program =
            Mapping { from: 0x55d0, to: 0x55e0, runs: true, offset: 0x1000, path: "/opt/a program".into() };
        assert_eq!(found[0], program);
        assert!(found[1].path.is_empty() && !found[1].runs && found[1].contains(0x7ffc));
    }
}
