//! The health log in the journal of systemd, where there is one: an entry with fields of its own, by the journal's native protocol.
//!
//! Responsible for: datagrams that hold one whole entry each. A monitor that waits for the journal, or is held up by its absence, would be
//! worse than an entry that is lost: nothing here waits, and what the journal did not take is counted.

use std::io::{self, ErrorKind, Write};
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};

use super::record::{Entry, Level};
use bateleur_host::trouble::Trouble;

/// Where the journal listens.
const SOCKET: &str = "/run/systemd/journal/socket";
/// What entries of this kind are found by: `journalctl MESSAGE_ID=…`.
const MESSAGE_ID: &str = "b3c1f0d27e944a1f9a5e61b0c7d48e52";

/// A way to the journal.
#[derive(Debug)]
pub struct Journal {
    module: String,
    path: PathBuf,
    socket: UnixDatagram,
    trouble: Trouble,
}

impl Journal {
    /// The machine's journal, for the entries of `module`; `None`: it has none.
    #[must_use]
    pub fn of(module: &str) -> Option<Self> {
        Self::at(Path::new(SOCKET), module)
    }

    fn at(path: &Path, module: &str) -> Option<Self> {
        let socket = UnixDatagram::unbound().ok().filter(|_| path.exists())?;
        socket.set_nonblocking(true).ok()?;
        Some(Self { module: module.to_owned(), path: path.to_owned(), socket, trouble: Trouble::default() })
    }

    /// Adds an entry.
    pub(super) fn note(&mut self, entry: &Entry, severity: u32, text: &str) {
        let bytes = self.datagram(entry, severity, text);
        // By its name each time: a journal that was started anew has another socket there.
        let sent = self.socket.send_to(&bytes, &self.path).map(drop);
        // One that has been stopped for good is no loss: the entry stands in the health log.
        let sent = sent.or_else(|error| if is_gone(&error) { Ok(()) } else { Err(error) });
        self.trouble.note(sent);
    }

    fn datagram(&self, entry: &Entry, severity: u32, text: &str) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(512);
        let mut put = |name: &str, value: &str| field(&mut bytes, name, value);
        put("MESSAGE", text);
        put("PRIORITY", &severity.to_string());
        put("SYSLOG_IDENTIFIER", "bateleur");
        put("MESSAGE_ID", MESSAGE_ID);
        put("BATELEUR_MODULE", &self.module);
        if !entry.partition.is_empty() {
            put("BATELEUR_PARTITION", &entry.partition);
        }
        put("BATELEUR_LEVEL", level(entry.level));
        put("BATELEUR_ERROR", &entry.error);
        if !entry.action.is_empty() {
            put("BATELEUR_ACTION", &entry.action);
        }
        put("BATELEUR_DETAIL", &entry.detail);
        put("BATELEUR_GENERATION", &entry.generation.to_string());
        put("BATELEUR_TIME_NS", &entry.time_ns.to_string());
        put("BATELEUR_FRAME", &entry.frame.to_string());
        bytes
    }

    /// What went wrong.
    pub(super) fn trouble(&mut self) -> &mut Trouble {
        &mut self.trouble
    }
}

fn level(level: Level) -> &'static str {
    match level {
        Level::Process => "process",
        Level::Partition => "partition",
        Level::Module => "module",
    }
}

fn is_gone(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::NotFound | ErrorKind::ConnectionRefused)
}

/// A field in the journal's format: a line, or with its length (64 bits, little endian) where the value has line feeds in it.
fn field(bytes: &mut Vec<u8>, name: &str, value: &str) {
    bytes.extend_from_slice(name.as_bytes());
    if value.contains('\n') {
        bytes.push(b'\n');
        bytes.extend_from_slice(&(value.len() as u64).to_le_bytes());
    } else {
        bytes.push(b'=');
    }
    let _ = bytes.write_all(value.as_bytes()); // to memory
    bytes.push(b'\n');
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(detail: &str) -> Entry {
        Entry {
            sequence: 0,
            time_ns: 7_000_000,
            frame: 3,
            generation: 2,
            level: Level::Partition,
            partition: "imu".into(),
            error: "killed".into(),
            action: "warm_restart".into(),
            detail: detail.into(),
        }
    }

    /// The fields of a datagram, as the journal's documents say that they are read.
    fn fields(mut bytes: &[u8]) -> Vec<(String, String)> {
        let mut found = Vec::new();
        while !bytes.is_empty() {
            let end = bytes.iter().position(|byte| *byte == b'\n').unwrap();
            let line = std::str::from_utf8(&bytes[..end]).unwrap();
            bytes = &bytes[end + 1..];
            if let Some((name, value)) = line.split_once('=') {
                found.push((name.to_owned(), value.to_owned()));
                continue;
            }
            let (length, rest) = bytes.split_first_chunk::<8>().unwrap();
            let (value, rest) = rest.split_at(u64::from_le_bytes(*length) as usize);
            found.push((line.to_owned(), String::from_utf8(value.to_vec()).unwrap()));
            bytes = rest.strip_prefix(b"\n").unwrap();
        }
        found
    }

    #[test]
    fn entry_is_one_datagram_and_no_text_in_it_can_forge_a_field() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("socket");
        let listening = UnixDatagram::bind(&path).unwrap();
        let mut journal = Journal::at(&path, "fcu").unwrap();
        let forged = "one\nPRIORITY=0\nBATELEUR_PARTITION=gps\n=";
        for detail in ["ended by SIGKILL", "a=b", "", forged] {
            journal.note(&entry(detail), 3, &format!("imu: killed ({detail})"));
            let mut bytes = [0; 4096];
            let length = listening.recv(&mut bytes).unwrap();
            let found = fields(&bytes[..length]);
            let of = |name: &str| -> Vec<&str> {
                found.iter().filter(|field| field.0 == name).map(|field| field.1.as_str()).collect()
            };
            assert_eq!(of("BATELEUR_DETAIL"), [detail]);
            assert_eq!(of("MESSAGE"), [format!("imu: killed ({detail})")]);
            assert_eq!((of("PRIORITY"), of("BATELEUR_PARTITION")), (vec!["3"], vec!["imu"]));
            assert_eq!((of("BATELEUR_TIME_NS"), of("BATELEUR_LEVEL")), (vec!["7000000"], vec!["partition"]));
        }
        assert_eq!(journal.trouble().lost(), 0);
    }

    #[test]
    fn journal_that_does_not_read_costs_entries_that_are_counted_and_one_that_has_ended_costs_none() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("socket");
        assert!(Journal::at(&path, "fcu").is_none());
        let deaf = UnixDatagram::bind(&path).unwrap();
        let mut journal = Journal::at(&path, "fcu").unwrap();
        (0..10_000).for_each(|_| journal.note(&entry("x"), 3, "x"));
        let lost = journal.trouble().lost();
        assert!(lost > 0 && lost < 10_000, "{lost}");
        assert!(journal.trouble().take().is_some());
        drop(deaf);
        journal.note(&entry("x"), 3, "x");
        std::fs::remove_file(&path).unwrap();
        journal.note(&entry("x"), 3, "x");
        assert_eq!(journal.trouble().lost(), lost);
        // Started anew, it is found.
        let anew = UnixDatagram::bind(&path).unwrap();
        journal.note(&entry("x"), 3, "x");
        assert!(anew.recv(&mut [0; 4096]).unwrap() > 0);
    }
}
