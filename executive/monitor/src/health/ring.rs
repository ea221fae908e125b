//! The persistent health log, `health.ring`: a file of the shape of [`super::record`] that is begun once and gone on with by
//! every later run in the same folder.
//!
//! Responsible for: that what was noted is on the disk soon, whatever becomes of the executive or the machine. It must never
//! hold up the monitor: a thread of its own writes and synchronises. The file has its full size from the beginning, so that
//! a disk which fills up later does not stop it.

use std::fs::{File, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::record::{Contents, Entry, HEADER, Ring, read};
use bateleur_host::trouble::Trouble;
use bateleur_plan::LogPolicy;
use bateleur_system::thread;
use bateleur_time::run_page::Heartbeat;

/// Name of the file in a run's folder.
pub const FILE: &str = "health.ring";
/// A file is read up to here, bytes: none that the checker allows is larger.
const MOST_BYTES: u64 = 1 << 27;
/// Entries that wait for the disk; more are dropped and counted.
const WAITING: usize = 1024;
/// Between two signs of life of a thread that has nothing to write.
const BEAT: Duration = Duration::from_millis(500);
/// How long the last entries may take to be on the disk when a run ends.
const LAST_ENTRIES: Duration = Duration::from_secs(2);

/// Takes entries; a thread of its own has them on the disk soon.
#[derive(Debug)]
pub struct RingLog {
    entries: Option<SyncSender<Entry>>,
    ended: Receiver<()>,
    trouble: Arc<Mutex<Trouble>>,
}

impl RingLog {
    /// Goes on with the log at `path`, or begins one of at most `bytes`. A log of another size or policy, and whatever else
    /// is called so, is kept beside it as `health.ring.old`.
    ///
    /// # Errors
    /// The file can not be opened, moved or written, or it is none.
    pub fn open(path: &Path, bytes: u64, policy: LogPolicy, beat: Heartbeat) -> io::Result<Self> {
        let mut ring = Ring::new(bytes, policy);
        let file = match found(path)? {
            Some(found) if found.get(..HEADER) == Some(&ring.header()[..]) => {
                let last = read(&found).ok().and_then(|log| Some(log.entries.last()?.sequence));
                ring.next = last.unwrap_or(0) + 1;
                OpenOptions::new().write(true).open(path)?
            }
            other => {
                if other.is_some() {
                    std::fs::rename(path, path.with_extension("ring.old"))?;
                }
                begin(path, &ring)?
            }
        };
        Self::with_file(file, ring, beat)
    }

    fn with_file(file: File, ring: Ring, beat: Heartbeat) -> io::Result<Self> {
        let (entries, waiting) = sync_channel(WAITING);
        let (done, ended) = sync_channel(1);
        let trouble = Arc::new(Mutex::new(Trouble::default()));
        let keeper = Keeper { file, ring, trouble: trouble.clone(), beat };
        thread::named("health log").spawn(move || {
            keeper.keep(&waiting);
            let _ = done.send(()); // nobody waits any more
        })?;
        Ok(Self { entries: Some(entries), ended, trouble })
    }

    /// Notes an entry. Never waits.
    pub fn note(&mut self, entry: Entry) {
        if self.entries.as_ref().is_none_or(|entries| entries.try_send(entry).is_err()) {
            self.trouble().lose(1, "the disk can not keep up");
        }
    }

    /// What went wrong with the disk.
    pub fn trouble(&self) -> MutexGuard<'_, Trouble> {
        self.trouble.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits a little until everything is on the disk.
    pub fn finish(&mut self) {
        if self.entries.take().is_some() && self.ended.recv_timeout(LAST_ENTRIES).is_err() {
            // A disk that hangs must not keep the run from ending.
            self.trouble().lose(1, "the disk did not take the last records in time");
        }
    }
}

/// The content of the file at `path`, if there is one.
fn found(path: &Path) -> io::Result<Option<Vec<u8>>> {
    match std::fs::metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
        // A device or a pipe might never come to its end.
        Ok(about) if !about.is_file() => Err(io::Error::other("it is no ordinary file")),
        Ok(_) => {
            let mut bytes = Vec::new();
            File::open(path)?.take(MOST_BYTES).read_to_end(&mut bytes)?;
            Ok(Some(bytes))
        }
    }
}

/// An empty log of full size.
fn begin(path: &Path, ring: &Ring) -> io::Result<File> {
    let file = OpenOptions::new().write(true).create_new(true).open(path)?;
    // Where the file system can not reserve, the file has holes, and a full disk is told when it is met.
    if rustix::fs::fallocate(&file, rustix::fs::FallocateFlags::empty(), 0, ring.bytes()).is_err() {
        file.set_len(ring.bytes())?;
    }
    file.write_all_at(&ring.header(), 0)?;
    file.sync_all()?;
    Ok(file)
}

/// Reads the log at `path`. One that is being written is read again where a record seems to be damaged: it may have been
/// in the middle of its way.
///
/// # Errors
/// There is no such file, or it is no health log; with words for a person.
pub fn read_file(path: &Path) -> io::Result<Contents> {
    let mut tries = 0;
    loop {
        let bytes = found(path)?.ok_or(io::ErrorKind::NotFound)?;
        let log = read(&bytes).map_err(io::Error::other)?;
        tries += 1;
        if log.damaged == 0 || tries == 3 {
            return Ok(log);
        }
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// The thread that writes.
struct Keeper {
    file: File,
    ring: Ring,
    trouble: Arc<Mutex<Trouble>>,
    beat: Heartbeat,
}

impl Keeper {
    fn keep(mut self, waiting: &Receiver<Entry>) {
        loop {
            self.beat.beat();
            let first = match waiting.recv_timeout(BEAT) {
                Ok(first) => first,
                Err(RecvTimeoutError::Timeout) => continue,
                Err(RecvTimeoutError::Disconnected) => return,
            };
            self.beat.rest(); // a disk that hangs is no fault of this program, and its end would mend nothing
            // What came meanwhile goes with it: one synchronisation for a burst.
            let burst: Vec<Entry> = std::iter::once(first).chain(waiting.try_iter().take(WAITING)).collect();
            for entry in burst {
                let written = self.write(entry);
                self.note(written);
            }
            let synchronised = self.file.sync_data();
            self.note(synchronised);
        }
    }

    fn write(&mut self, entry: Entry) -> io::Result<()> {
        // A full log that keeps what it has: as the plan says.
        let Some((place, bytes)) = self.ring.add(entry) else { return Ok(()) };
        self.file.write_all_at(&bytes, place)
    }

    fn note(&self, result: io::Result<()>) {
        self.trouble.lock().unwrap_or_else(PoisonError::into_inner).note(result);
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::super::record::{Level, RECORD};
    use super::*;

    fn entry(time_ns: u64) -> Entry {
        Entry {
            sequence: 0,
            time_ns,
            frame: 5,
            generation: 3,
            level: Level::Partition,
            partition: "estimator".into(),
            error: "killed".into(),
            action: "warm_restart".into(),
            detail: "ended by SIGKILL".into(),
        }
    }

    const FOUR: u64 = (HEADER + 4 * RECORD + 100) as u64;

    fn write(path: &Path, bytes: u64, policy: LogPolicy, times: &[u64]) {
        let mut log = RingLog::open(path, bytes, policy, Heartbeat::of_health_log(None)).unwrap();
        times.iter().for_each(|time_ns| log.note(entry(*time_ns)));
        log.finish();
        assert_eq!(log.trouble().take(), None);
        assert_eq!(log.trouble().lost(), 0);
    }

    fn times(path: &Path) -> Vec<u64> {
        read_file(path).unwrap().entries.iter().map(|entry| entry.time_ns).collect()
    }

    fn scratch() -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE);
        (folder, path)
    }

    #[test]
    fn what_is_noted_is_read_again() {
        let (_folder, path) = scratch();
        write(&path, FOUR, LogPolicy::Overwrite, &[7]);
        let log = read_file(&path).unwrap();
        assert_eq!(log.entries, [Entry { sequence: 1, ..entry(7) }]);
        assert_eq!((log.damaged, log.room, log.overwritten), (0, 4, 0));
    }

    #[test]
    fn later_runs_go_on_and_the_oldest_make_room() {
        let (_folder, path) = scratch();
        for run in [&[1, 2, 3][..], &[4], &[5, 6]] {
            write(&path, FOUR, LogPolicy::Overwrite, run);
        }
        assert_eq!(times(&path), [3, 4, 5, 6]);
        assert_eq!(read_file(&path).unwrap().overwritten, 2);
    }

    #[test]
    fn later_runs_go_on_and_the_first_stay() {
        let (_folder, path) = scratch();
        for run in [&[1, 2, 3][..], &[4, 5], &[6]] {
            write(&path, FOUR, LogPolicy::Keep, run);
        }
        assert_eq!(times(&path), [1, 2, 3, 4]);
    }

    #[test]
    fn log_that_was_cut_off_is_gone_on_with() {
        let (_folder, path) = scratch();
        write(&path, FOUR, LogPolicy::Overwrite, &[1, 2, 3]);
        let file = OpenOptions::new().write(true).open(&path).unwrap();
        file.set_len((HEADER + 2 * RECORD + 77) as u64).unwrap();
        assert_eq!((times(&path), read_file(&path).unwrap().damaged), (vec![1, 2], 1));
        write(&path, FOUR, LogPolicy::Overwrite, &[4]);
        assert_eq!((times(&path), read_file(&path).unwrap().damaged), (vec![1, 2, 4], 0));
    }

    #[test]
    fn log_of_another_size_and_what_is_no_log_are_kept_beside_it() {
        let (_folder, path) = scratch();
        write(&path, FOUR, LogPolicy::Overwrite, &[1]);
        write(&path, 2 * FOUR, LogPolicy::Overwrite, &[2]);
        assert_eq!(times(&path), [2]);
        assert_eq!(times(&path.with_extension("ring.old")), [1]);
        std::fs::write(&path, "something else").unwrap();
        write(&path, FOUR, LogPolicy::Overwrite, &[3]);
        assert_eq!(times(&path), [3]);
        assert_eq!(std::fs::read(path.with_extension("ring.old")).unwrap(), b"something else");
    }

    #[test]
    fn device_in_place_of_the_log_is_an_error_and_not_read_for_ever() {
        let (_folder, path) = scratch();
        std::os::unix::fs::symlink("/dev/full", &path).unwrap();
        assert!(RingLog::open(&path, FOUR, LogPolicy::Overwrite, Heartbeat::of_health_log(None)).is_err());
        assert!(read_file(&path).is_err());
    }

    #[test]
    fn disk_that_is_full_is_said_once_and_counted() {
        let full = OpenOptions::new().write(true).open("/dev/full").unwrap();
        let mut log =
            RingLog::with_file(full, Ring::new(FOUR, LogPolicy::Overwrite), Heartbeat::of_health_log(None))
                .unwrap();
        (0..5).for_each(|time_ns| log.note(entry(time_ns)));
        log.finish();
        assert!(log.trouble().take().is_some_and(|why| why.contains("No space left")));
        assert_eq!(log.trouble().take(), None);
        assert!(log.trouble().lost() >= 5);
    }
}
