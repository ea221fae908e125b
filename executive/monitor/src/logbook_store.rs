//! Logbooks on the disk: files that are begun once and gone on with by every later run in the same folder.
//!
//! Responsible for: that a message which a partition was told is stored is on the disk, whatever becomes of the executive or the machine.
//! A file has its full size from the beginning, so that a disk which fills up later does not stop it. It must never hold up the monitor:
//! on the wall clock a thread of its own writes and synchronises; on the virtual clock, where no time passes meanwhile, its caller does,
//! so that each run is the same.

use std::fs::{File, OpenOptions};
use std::io::{self, Read};
use std::os::fd::AsFd;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use bateleur_contract::{Clock, Logbook, LogbookSizes, MappedWords};
use bateleur_host::logbooks::{LogbookMemories, of_module, sizes};
use bateleur_plan::ModuleView;
use bateleur_system::thread;

/// The folder of the files in that of a run.
pub const FOLDER: &str = "logbooks";
/// What a file begins with.
const MAGIC: &[u8; 8] = b"BTLRLOG1";
/// Bytes of the head: magic, sizes, the last message that was removed, checksum.
const HEAD: usize = 32;
/// Bytes of a record before its content: checksum of the rest, length, number.
const RECORD: usize = 16;
/// The length that says that a message was aborted.
const ABORTED: u32 = u32::MAX;
/// How long the last messages may take to be on the disk when a run ends.
const LAST: Duration = Duration::from_secs(2);

/// A message of a file; `None`: it was aborted.
type Content = Option<Vec<u8>>;

/// The files of a module's logbooks.
#[derive(Debug)]
pub struct LogbookStores {
    shared: Arc<Shared>,
    /// `None` on the virtual clock.
    thread: Option<Keeper>,
}

#[derive(Debug, Default)]
struct Shared {
    stores: Mutex<Vec<Store>>,
    trouble: Mutex<Option<Lost>>,
}

/// Says that there is something to store, and hears that the thread has ended.
#[derive(Debug)]
struct Keeper {
    wake: SyncSender<()>,
    ended: Receiver<()>,
}

/// A logbook that can not be stored.
#[derive(Debug)]
pub struct Lost {
    /// Its file.
    pub log: String,
    /// Why.
    pub why: String,
}

impl LogbookStores {
    /// Opens the files in the folder of a run, and fills the memories from them. `warm`: the memories are those of a dead executive, and
    /// have messages that it did not store. `anew`: the files are begun anew, as they are for each run on the virtual clock.
    ///
    /// # Errors
    /// A file can not be read or made, or a memory not be mapped; with which one.
    pub fn open(
        view: &ModuleView<'_>,
        output: &Path,
        memories: &LogbookMemories,
        clock: Clock,
        (warm, anew): (bool, bool),
    ) -> io::Result<Self> {
        let folder = output.join(FOLDER);
        let mut stores = Vec::new();
        for (name, logbook) in of_module(view) {
            let Some(memory) = memories.get(&name) else { continue };
            bateleur_system::folders::make(&folder)?;
            let path = folder.join(name);
            let store = Store::open(&path, memory, sizes(logbook), warm, anew);
            let named = |error| io::Error::other(format!("{}: {error}", path.display()));
            stores.push(store.map_err(named)?);
        }
        let shared = Arc::new(Shared { stores: Mutex::new(stores), ..Shared::default() });
        let is_needed = clock == Clock::Wall && !lock(&shared.stores).is_empty();
        let thread = if is_needed { Some(Keeper::start(shared.clone())?) } else { None };
        Ok(Self { shared, thread })
    }

    /// Has stored what was written, soon; on the virtual clock, when this returns.
    pub fn store(&self) {
        match &self.thread {
            None => self.shared.store(),
            Some(keeper) => {
                let _ = keeper.wake.try_send(()); // it has not yet looked since the last time
            }
        }
    }

    /// A logbook that can not be stored, once for each.
    pub fn take_trouble(&self) -> Option<Lost> {
        lock(&self.shared.trouble).take()
    }
}

impl Drop for LogbookStores {
    fn drop(&mut self) {
        match self.thread.take() {
            None => self.shared.store(),
            Some(Keeper { wake, ended }) => {
                drop(wake);
                let _ = ended.recv_timeout(LAST); // a disk that hangs must not keep the run from ending
            }
        }
    }
}

impl Keeper {
    fn start(shared: Arc<Shared>) -> io::Result<Self> {
        let ((wake, woken), (done, ended)) = (sync_channel(1), sync_channel(1));
        thread::named("logbooks").spawn(move || {
            for () in woken {
                shared.store();
            }
            shared.store();
            let _ = done.send(()); // nobody waits any more
        })?;
        Ok(Self { wake, ended })
    }
}

impl Shared {
    fn store(&self) {
        for store in &mut *lock(&self.stores) {
            let Err(error) = store.store() else { continue };
            if !std::mem::replace(&mut store.has_told, true) {
                let log = format!("{FOLDER}/{}", store.name);
                *lock(&self.trouble) = Some(Lost { log, why: error.to_string() });
            }
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A logbook and its file.
#[derive(Debug)]
struct Store {
    name: String,
    file: File,
    memory: Logbook<MappedWords>,
    sizes: LogbookSizes,
    /// The last message that is in the file.
    stored: u64,
    /// The last one that was removed.
    cleared: u64,
    has_told: bool,
}

impl Store {
    fn open(path: &Path, memory: impl AsFd, sizes: LogbookSizes, warm: bool, anew: bool) -> io::Result<Self> {
        let words = MappedWords::new(memory).map_err(io::Error::other)?;
        let memory =
            Logbook::over(words, sizes).ok_or_else(|| io::Error::other("its memory is too small"))?;
        let found = if anew { None } else { found(path)? };
        let (file, Found { cleared, first, messages }) =
            match found.as_deref().map(|bytes| read(bytes, sizes)) {
                Some(Some(there)) => (writable(path, found.as_deref().unwrap_or_default())?, there),
                other => {
                    if other.is_some() {
                        std::fs::rename(path, beside(path))?;
                    }
                    (begin(path, sizes)?, Found::default())
                }
            };
        let stored = first + messages.len() as u64 - 1;
        if warm {
            memory.set_stored(stored);
        } else {
            memory.begin();
            messages.iter().zip(first..).for_each(|(content, number)| {
                memory.put_stored(number, content.as_deref());
            });
            memory.set_cleared(cleared);
        }
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Ok(Self { name, file, memory, sizes, stored, cleared, has_told: false })
    }

    /// Writes what is in the memory and not in the file, at most as much as may be on its way.
    fn store(&mut self) -> io::Result<()> {
        let cleared = self.memory.cleared();
        // A partition can write anything there; it removes what it has seen stored.
        if cleared > self.cleared && cleared <= self.stored {
            self.file.write_all_at(&head(self.sizes, cleared), 0)?;
            self.cleared = cleared;
        }
        let (mut written, mut content) = (self.stored, Vec::new());
        while written - self.stored < self.sizes.in_progress.into() {
            let Some(whole) = self.memory.claim(written, &mut content) else { break };
            written += 1;
            let bytes = record(written, whole.then_some(&content[..]));
            self.file.write_all_at(&bytes, place(self.sizes, written))?;
        }
        if written > self.stored {
            self.file.sync_data()?;
            self.stored = written;
            self.memory.set_stored(written);
        }
        Ok(())
    }
}

/// The file at `path`, which has this content. That of another user's run, which this one may not write, stays beside a copy.
fn writable(path: &Path, content: &[u8]) -> io::Result<File> {
    let opened = OpenOptions::new().write(true).open(path);
    if opened.as_ref().is_err_and(|error| error.kind() == io::ErrorKind::PermissionDenied) {
        std::fs::rename(path, beside(path))?;
        std::fs::write(path, content)?;
        return OpenOptions::new().write(true).open(path);
    }
    opened
}

/// Where a file stays that is not gone on with.
fn beside(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".old");
    name.into()
}

/// The content of the file at `path`, if there is one.
fn found(path: &Path) -> io::Result<Option<Vec<u8>>> {
    // A pipe would wait for somebody who writes.
    match std::fs::metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(error),
        Ok(about) if !about.is_file() => return Err(io::Error::other("it is no ordinary file")),
        Ok(_) => {}
    }
    let mut bytes = Vec::new();
    File::open(path)?.read_to_end(&mut bytes)?;
    Ok(Some(bytes))
}

/// Bytes of a record.
fn record_bytes(sizes: LogbookSizes) -> usize {
    RECORD + sizes.message as usize
}

/// Where the record of a message lies.
fn place(sizes: LogbookSizes, number: u64) -> u64 {
    HEAD as u64 + (number % u64::from(sizes.logged)) * record_bytes(sizes) as u64
}

fn head(sizes: LogbookSizes, cleared: u64) -> [u8; HEAD] {
    let mut head = [0; HEAD];
    head[..8].copy_from_slice(MAGIC);
    head[8..12].copy_from_slice(&sizes.message.to_le_bytes());
    head[12..16].copy_from_slice(&sizes.logged.to_le_bytes());
    head[16..24].copy_from_slice(&cleared.to_le_bytes());
    let sum = crc32fast::hash(&head[..24]);
    head[24..28].copy_from_slice(&sum.to_le_bytes());
    head
}

fn record(number: u64, content: Option<&[u8]>) -> Vec<u8> {
    let mut bytes = vec![0; 4];
    bytes.extend(content.map_or(ABORTED, |content| content.len() as u32).to_le_bytes());
    bytes.extend(number.to_le_bytes());
    bytes.extend(content.unwrap_or_default());
    let sum = crc32fast::hash(&bytes[4..]);
    bytes[..4].copy_from_slice(&sum.to_le_bytes());
    bytes
}

/// An empty file of full size.
fn begin(path: &Path, sizes: LogbookSizes) -> io::Result<File> {
    let whole = place(sizes, 0) + u64::from(sizes.logged) * record_bytes(sizes) as u64;
    let file = OpenOptions::new().write(true).create(true).truncate(true).open(path)?;
    // Where the file system can not reserve, the file has holes, and a full disk is told when it is met.
    match rustix::fs::fallocate(&file, rustix::fs::FallocateFlags::empty(), 0, whole) {
        Ok(()) => {}
        Err(rustix::io::Errno::OPNOTSUPP) => file.set_len(whole)?,
        Err(error) => return Err(error.into()),
    }
    file.write_all_at(&head(sizes, 0), 0)?;
    file.sync_all()?;
    Ok(file)
}

/// What a file has.
#[derive(Debug, PartialEq, Eq)]
struct Found {
    cleared: u64,
    /// The number of the first message.
    first: u64,
    messages: Vec<Content>,
}

impl Default for Found {
    fn default() -> Self {
        Self { cleared: 0, first: 1, messages: Vec::new() }
    }
}

/// `None`: it is no logbook, or one of other sizes. The number of messages on their way may have changed: none of them is in a file.
fn read(bytes: &[u8], sizes: LogbookSizes) -> Option<Found> {
    let (start, records) = bytes.split_at_checked(HEAD)?;
    let cleared = u64::from_le_bytes(start[16..24].try_into().ok()?);
    if start != head(sizes, cleared) {
        return None;
    }
    let logged = u64::from(sizes.logged);
    let mut kept: Vec<Option<(u64, Content)>> =
        records.chunks_exact(record_bytes(sizes)).take(sizes.logged as usize).map(read_record).collect();
    kept.resize(sizes.logged as usize, None);
    let newest = kept.iter().flatten().map(|(number, _)| *number).max().unwrap_or(0);
    // The executive may have died within the next one.
    let next = (newest + 1) % logged;
    let is_torn = kept[next as usize].is_none()
        && records
            .chunks(record_bytes(sizes))
            .nth(next as usize)
            .is_some_and(|bytes| bytes.iter().any(|byte| *byte != 0));
    let newest = newest + u64::from(is_torn);
    let first = newest.saturating_sub(logged).max(cleared.min(newest)) + 1;
    let content = |number: u64| match kept[(number % logged) as usize].take() {
        Some((found, content)) if found == number => content,
        _ => None,
    };
    Some(Found { cleared, first, messages: (first..=newest).map(content).collect() })
}

/// `None`: there is none, or it is damaged.
fn read_record(bytes: &[u8]) -> Option<(u64, Content)> {
    let word = |at: usize| Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?));
    let (sum, length) = (word(0)?, word(4)?);
    let number = u64::from_le_bytes(bytes.get(8..16)?.try_into().ok()?);
    let end = if length == ABORTED { RECORD } else { RECORD + length as usize };
    let is_whole = number > 0 && bytes.get(4..end).map(crc32fast::hash) == Some(sum);
    is_whole.then(|| (number, (length != ABORTED).then(|| bytes[RECORD..end].to_vec())))
}

/// The messages of a file from the newest on; `None` for one that was aborted.
///
/// # Errors
/// There is no such file, or it is no logbook; with words for a person.
pub fn read_file(path: &Path) -> io::Result<Vec<Content>> {
    let bytes = found(path)?.ok_or(io::ErrorKind::NotFound)?;
    let no_logbook = || io::Error::other("it is no logbook");
    let word =
        |at: usize| bytes.get(at..at + 4).and_then(|bytes| Some(u32::from_le_bytes(bytes.try_into().ok()?)));
    let (message, logged) = (word(8).ok_or_else(no_logbook)?, word(12).ok_or_else(no_logbook)?);
    // Before memory is taken for so many.
    if logged == 0 || u64::from(logged) * (RECORD as u64 + u64::from(message)) > bytes.len() as u64 {
        return Err(no_logbook());
    }
    let found = read(&bytes, LogbookSizes { message, logged, in_progress: 1 }).ok_or_else(no_logbook)?;
    Ok(found.messages.into_iter().rev().collect())
}

/// The files of logbooks in the folder of a run, by name.
#[must_use]
pub fn files(output: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(output.join(FOLDER)).into_iter().flatten().flatten();
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    files.sort();
    files
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZES: LogbookSizes = LogbookSizes { message: 8, logged: 4, in_progress: 2 };

    fn memory(sizes: LogbookSizes) -> File {
        let file = tempfile::tempfile().unwrap();
        file.set_len(sizes.bytes()).unwrap();
        file
    }

    /// A partition's side of a memory.
    fn partition(memory: &File) -> Logbook<MappedWords> {
        Logbook::over(MappedWords::new(memory).unwrap(), SIZES).unwrap()
    }

    fn opened(path: &Path) -> (Logbook<MappedWords>, Store) {
        let memory = memory(SIZES);
        let store = Store::open(path, &memory, SIZES, false, false).unwrap();
        (partition(&memory), store)
    }

    fn all(path: &Path) -> Vec<Content> {
        read_file(path).unwrap()
    }

    fn written(path: &Path, messages: &[&[u8]]) {
        let (partition, mut store) = opened(path);
        for message in messages {
            partition.write(message).unwrap();
            store.store().unwrap();
        }
    }

    fn contents(messages: &[&[u8]]) -> Vec<Content> {
        messages.iter().map(|message| Some(message.to_vec())).collect()
    }

    #[test]
    fn next_run_goes_on_with_what_is_in_the_file_and_numbers_go_round() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        for run in 0..7_u8 {
            written(&path, &[&[run, 0], &[run, 1], &[run, 2]]);
            let expected = [[run, 2], [run, 1], [run, 0], [run.wrapping_sub(1), 2]];
            let count = if run == 0 { 3 } else { 4 };
            assert_eq!(
                all(&path),
                expected[..count].iter().map(|two| Some(two.to_vec())).collect::<Vec<_>>()
            );
        }
    }

    #[test]
    fn log_02_what_was_torn_by_a_death_is_aborted_and_the_others_are_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        for messages in 1..=6 {
            for torn in [1, 4, 8, 15, 17] {
                let _ = std::fs::remove_file(&path);
                let bodies: Vec<Vec<u8>> = (0..messages).map(|number| vec![number; 3]).collect();
                written(&path, &bodies.iter().map(Vec::as_slice).collect::<Vec<_>>());
                let before = all(&path);
                // The executive dies when so many bytes of the next record are written.
                let next = u64::from(messages) + 1;
                let file = OpenOptions::new().write(true).open(&path).unwrap();
                let bytes = record(next, Some(&[9; 8]));
                file.write_all_at(&bytes[..torn], place(SIZES, next)).unwrap();
                let mut expected: Vec<Content> = vec![None];
                expected.extend(before.into_iter().take(3));
                let found = all(&path);
                assert_eq!(found, expected[..found.len()], "{messages} messages, {torn} bytes");
                assert_eq!(found.len(), expected.len().min(usize::from(messages) + 1));
                let (partition, mut store) = opened(&path);
                partition.write(b"on").unwrap();
                store.store().unwrap();
                assert_eq!(all(&path)[..2], [Some(b"on".to_vec()), None]);
            }
        }
    }

    #[test]
    fn file_of_other_sizes_and_whatever_else_is_called_so_are_kept_beside() {
        let folder = tempfile::tempdir().unwrap();
        let (path, old) = (folder.path().join("log"), folder.path().join("log.old"));
        for content in [&b"notes"[..], &[0; 500], &head(LogbookSizes { message: 9, ..SIZES }, 0)] {
            std::fs::write(&path, content).unwrap();
            written(&path, &[b"a"]);
            assert_eq!((std::fs::read(&old).unwrap(), all(&path)), (content.to_vec(), contents(&[b"a"])));
        }
    }

    #[test]
    fn messages_that_were_removed_are_gone_in_the_next_run_too() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let (partition, mut store) = opened(&path);
        partition.write(b"a").unwrap();
        store.store().unwrap();
        partition.clear().unwrap();
        partition.write(b"b").unwrap();
        store.store().unwrap();
        assert_eq!(all(&path), contents(&[b"b"]));
        let (partition, _) = opened(&path);
        let mut message = Vec::new();
        assert!(partition.read(0, &mut message).is_some() && message == b"b");
        assert_eq!(partition.read(1, &mut message), None);
    }

    /// A thread that hangs in the disk holds what the others would wait for.
    #[test]
    fn log_01_no_service_and_no_monitor_waits_for_a_disk_that_hangs() {
        let folder = tempfile::tempdir().unwrap();
        let (partition, store) = opened(&folder.path().join("log"));
        let shared = Arc::new(Shared { stores: Mutex::new(vec![store]), ..Shared::default() });
        let hanging = shared.stores.lock().unwrap();
        let stores =
            LogbookStores { thread: Some(Keeper::start(shared.clone()).unwrap()), shared: shared.clone() };
        let begun = std::time::Instant::now();
        assert!(
            partition.write(b"a").is_ok() && partition.write(b"b").is_ok() && partition.write(b"c").is_err()
        );
        (0..100).for_each(|_| stores.store());
        assert!(stores.take_trouble().is_none() && partition.overwrite(b"d").is_ok());
        assert!(begun.elapsed() < Duration::from_secs(1), "nothing of it waits");
        drop(hanging);
        drop(stores);
        assert_eq!(all(&folder.path().join("log")), contents(&[b"d", b"a"]));
    }

    #[test]
    fn disk_that_refuses_is_told_once_and_what_is_on_its_way_stays_there() {
        let folder = tempfile::tempdir().unwrap();
        let (partition, mut store) = opened(&folder.path().join("log"));
        store.file = File::open(folder.path().join("log")).unwrap(); // for reading only
        let shared = Arc::new(Shared { stores: Mutex::new(vec![store]), ..Shared::default() });
        let stores = LogbookStores { shared, thread: None };
        partition.write(b"a").unwrap();
        stores.store();
        assert_eq!(stores.take_trouble().unwrap().log, "logbooks/log");
        stores.store();
        assert!(stores.take_trouble().is_none());
        assert_eq!(partition.counts().in_progress, 1);
    }

    /// A file can be damaged anywhere: what is read is bounded, and a run begins.
    #[test]
    fn damaged_files_are_read_or_kept_beside() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let mut random = 7_u64;
        for _ in 0..2000 {
            let _ = std::fs::remove_file(&path);
            written(&path, &[b"a", b"bb", b"ccc", b"dddd", b"eeeee"]);
            let mut bytes = std::fs::read(&path).unwrap();
            for _ in 0..3 {
                random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                let place = (random >> 33) as usize % bytes.len();
                bytes[place] ^= 1 << (random >> 60 & 7);
            }
            bytes.truncate(if random & 64 == 0 {
                bytes.len()
            } else {
                (random >> 20) as usize % bytes.len()
            });
            std::fs::write(&path, &bytes).unwrap();
            let found = read_file(&path).unwrap_or_default();
            assert!(found.len() <= 4 && found.iter().flatten().all(|message| message.len() <= 8));
            written(&path, &[b"next"]);
            // A damaged record in the place of the next one is taken for one that was torn.
            assert!(all(&path)[..2].contains(&Some(b"next".to_vec())));
        }
    }
}
