//! Logbooks on the disk: a file for each, which every later run with the same folder goes on with.
//!
//! Responsible for: that a message which a partition was told is stored is on the disk, whatever becomes of the executive or the machine.
//! A file has its full size from the beginning, so that a disk which fills up later does not stop it, and places for more messages than are
//! kept, so that none is lost before its successors are on the disk. It must never hold up the monitor: on the wall clock a thread of its own
//! writes and synchronises; on the virtual clock, where no time passes meanwhile, its caller does, so that each run is the same.

use std::fs::File;
use std::io::{self, Read};
use std::os::fd::AsFd;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use bateleur_contract::{Clock, Logbook, LogbookSizes, MappedWords};
use bateleur_host::logbooks::{LogbookMemories, of_module, sizes};
use bateleur_plan::ModuleView;
use bateleur_system::{folders, thread};
use rustix::fs::{FallocateFlags, FlockOperation, Mode, OFlags, fallocate, flock};
use rustix::io::Errno;

/// What a file begins with.
const MAGIC: &[u8; 8] = b"BTLRLOG1";
/// Bytes of the head: magic, sizes, the last message that was removed, checksum.
const HEAD: usize = 32;
/// Bytes of a record before its content: checksum of the rest, length, number.
const RECORD: usize = 16;
/// The length that says that a message was aborted.
const ABORTED: u32 = u32::MAX;
/// No message has a higher number.
const LAST_NUMBER: u64 = 1 << 60;
/// What the name of a file ends with that is not gone on with.
const OLD: &str = ".old";
/// How long the last messages may take to be on the disk when a run ends.
const LAST: Duration = Duration::from_secs(2);
/// Bytes that a logbook may write at once, and each time that it is looked at from then on: a partition wears no disk out.
const BURST: i64 = 1 << 20;
const SHARE: i64 = 4 << 10;

/// A message of a file; `None`: it was aborted.
pub type Content = Option<Vec<u8>>;

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
    trouble: Mutex<Vec<Lost>>,
}

/// Says that there is something to store, and hears that the thread has ended.
#[derive(Debug)]
struct Keeper {
    wake: SyncSender<()>,
    ended: Receiver<()>,
}

/// A logbook that can not be stored.
#[derive(Debug, PartialEq, Eq)]
pub struct Lost {
    /// Its file.
    pub log: String,
    /// Why.
    pub why: String,
}

/// How a run begins with its logbooks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Beginning {
    /// Without a message, as each run on the virtual clock does.
    Anew,
    /// With what is in the files.
    FromFiles,
    /// With the memories of an executive that has died, which have messages that it did not store.
    AfterDeath,
}

impl LogbookStores {
    /// Opens the files of a module in `folder`, and fills the memories from them.
    ///
    /// # Errors
    /// A file can not be read or made, another module uses it, or a memory can not be mapped; with which one.
    pub fn open(
        view: &ModuleView<'_>,
        folder: &Path,
        memories: &LogbookMemories,
        clock: Clock,
        beginning: Beginning,
    ) -> io::Result<Self> {
        let mut stores = Vec::new();
        for (name, logbook) in of_module(view) {
            let Some(memory) = memories.get(&name) else { continue };
            folders::make(folder)?;
            let path = folder.join(name);
            let store = Store::open(&path, memory, sizes(logbook), beginning);
            let named = |error| io::Error::other(format!("{}: {error}", path.display()));
            stores.push(store.map_err(named)?);
        }
        let shared = Arc::new(Shared { stores: Mutex::new(stores), ..Shared::default() });
        let is_needed = clock == Clock::Wall && !lock(&shared.stores).is_empty();
        let thread = if is_needed { Some(Keeper::start(shared.clone())?) } else { None };
        Ok(Self { shared, thread })
    }

    /// Has stored what was written, soon; on the virtual clock, when this returns. Asked for in each minor frame.
    pub fn store(&self) {
        match &self.thread {
            None => self.shared.store(),
            Some(keeper) => {
                // One that is full has not yet looked since the last time.
                if let Err(TrySendError::Disconnected(())) = keeper.wake.try_send(()) {
                    self.shared.tell("logbooks", "the thread that writes them has ended");
                }
            }
        }
    }

    /// Logbooks that can not be stored, each once.
    pub fn take_trouble(&self) -> Vec<Lost> {
        std::mem::take(&mut *lock(&self.shared.trouble))
    }

    /// Stores what is left, and waits a little for that; what went wrong.
    pub fn finish(&mut self) -> Vec<Lost> {
        match self.thread.take() {
            None => self.shared.store_all(),
            Some(Keeper { wake, ended }) => {
                drop(wake);
                // A disk that hangs must not keep the run from ending.
                if ended.recv_timeout(LAST).is_err() {
                    self.shared.tell("logbooks", "the disk did not take the last messages in time");
                }
            }
        }
        self.take_trouble()
    }
}

impl Drop for LogbookStores {
    fn drop(&mut self) {
        if self.thread.is_some() {
            self.finish();
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
            shared.store_all();
            let _ = done.send(()); // nobody waits any more
        })?;
        Ok(Self { wake, ended })
    }
}

impl Shared {
    fn store(&self) {
        for store in &mut *lock(&self.stores) {
            store.budget = (store.budget + SHARE).min(BURST);
            self.note(store);
        }
    }

    /// As much as there is, whatever it costs.
    fn store_all(&self) {
        for store in &mut *lock(&self.stores) {
            store.budget = i64::MAX;
            self.note(store);
        }
    }

    fn note(&self, store: &mut Store) {
        let Err(error) = store.store() else { return };
        if !std::mem::replace(&mut store.has_told, true) {
            self.tell(&format!("logbook {}", store.name), &error.to_string());
        }
    }

    fn tell(&self, log: &str, why: &str) {
        let lost = Lost { log: log.to_owned(), why: why.to_owned() };
        let mut trouble = lock(&self.trouble);
        if !trouble.contains(&lost) {
            trouble.push(lost);
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
    /// Bytes that may be written now.
    budget: i64,
    has_told: bool,
}

impl Store {
    fn open(path: &Path, memory: impl AsFd, sizes: LogbookSizes, beginning: Beginning) -> io::Result<Self> {
        let words = MappedWords::new(memory).map_err(io::Error::other)?;
        let memory =
            Logbook::over(words, sizes).ok_or_else(|| io::Error::other("its memory is too small"))?;
        let (file, found) = match beginning {
            Beginning::Anew => (begin(path, sizes)?, Found::default()),
            Beginning::FromFiles | Beginning::AfterDeath => file_of(path, sizes)?,
        };
        // What a death has torn stands whole in its memory, if that is of the same run.
        let whole = found.first + found.messages.len() as u64 - 1 - u64::from(found.is_torn);
        let goes_on = beginning == Beginning::AfterDeath
            && (whole..=whole + u64::from(sizes.in_progress)).contains(&memory.newest());
        let stored = if goes_on { whole } else { whole + u64::from(found.is_torn) };
        if !goes_on {
            memory.begin();
            memory.set_cleared(found.cleared);
            for (content, number) in found.messages.iter().zip(found.first..) {
                memory.put_stored(number, content.as_deref());
            }
        }
        memory.set_stored(stored);
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Ok(Self { name, file, memory, sizes, stored, cleared: found.cleared, budget: BURST, has_told: false })
    }

    /// Writes what is in the memory and not in the file, as far as its budget allows.
    fn store(&mut self) -> io::Result<()> {
        // As many rounds as what may be on its way needs: whoever writes on meanwhile waits for the next time.
        for _ in 0..=self.sizes.in_progress {
            let before = self.stored;
            self.store_claimed()?;
            if self.stored == before {
                break;
            }
        }
        Ok(())
    }

    /// One round: as much as may be claimed.
    fn store_claimed(&mut self) -> io::Result<()> {
        let cleared = self.memory.cleared();
        // A partition can write anything there; it removes what it has seen stored.
        if cleared > self.cleared && cleared <= self.stored {
            self.file.write_all_at(&head(self.sizes, cleared), 0)?;
            self.file.sync_data()?;
            self.cleared = cleared;
        }
        let (mut written, mut content) = (self.stored, Vec::new());
        while written - self.stored < self.memory.most_claimed() && self.budget > 0 {
            let Some(whole) = self.memory.claim(written, &mut content) else { break };
            written += 1;
            let bytes = record(written, whole.then_some(&content[..]));
            self.budget -= bytes.len() as i64;
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

/// The file at `path` with what is in it, which no other module uses. What can not be gone on with stays beside: another user's, of which
/// this is a copy, and whatever else has the name.
fn file_of(path: &Path, sizes: LogbookSizes) -> io::Result<(File, Found)> {
    let (writable, bytes) = match found(path, OFlags::RDWR, file_bytes(sizes)) {
        Ok((file, bytes)) => {
            take(&file)?;
            (Some(file), bytes)
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            return Ok((begin(path, sizes)?, Found::default()));
        }
        Err(_) => {
            let read = found(path, OFlags::RDONLY, file_bytes(sizes));
            read.as_ref().map_or(Ok(()), |(file, _)| take(file))?;
            (None, read.map_or_else(|_| Vec::new(), |(_, bytes)| bytes))
        }
    };
    let there = read(&bytes, sizes);
    let file = match writable.filter(|_| there.is_some()) {
        Some(file) => {
            reserve(&file, sizes)?;
            file
        }
        None => {
            put_beside(path)?;
            let file = begin(path, sizes)?;
            if there.is_some() {
                file.write_all_at(&bytes, 0)?;
            }
            file
        }
    };
    // What a dead executive has written may still be on its way.
    file.sync_all()?;
    Ok((file, there.unwrap_or_default()))
}

/// An ordinary file, and its content; of a longer one than `most`, nothing.
fn found(path: &Path, access: OFlags, most: u64) -> io::Result<(File, Vec<u8>)> {
    // A pipe would wait for somebody who writes, and a link leads where somebody else wants.
    let flags = access | OFlags::NONBLOCK | OFlags::NOFOLLOW | OFlags::CLOEXEC;
    let file = File::from(rustix::fs::open(path, flags, Mode::empty())?);
    let about = file.metadata()?;
    if !about.is_file() {
        return Err(io::Error::other("it is no ordinary file"));
    }
    let mut bytes = Vec::new();
    if about.len() <= most {
        (&file).take(most).read_to_end(&mut bytes)?;
    }
    Ok((file, bytes))
}

/// Keeps a file that is not gone on with, under a name that nothing has.
fn put_beside(path: &Path) -> io::Result<()> {
    let names = std::iter::once(OLD.to_owned()).chain((2..).map(|number| format!("{OLD}-{number}")));
    let beside = names.map(|end| {
        let mut name = path.as_os_str().to_owned();
        name.push(end);
        PathBuf::from(name)
    });
    let free = beside.take(1000).find(|path| path.symlink_metadata().is_err());
    std::fs::rename(path, free.ok_or_else(|| io::Error::other("too many files of its name end with .old"))?)
}

/// Nobody else uses it: two modules that store into one file would store over each other.
fn take(file: &File) -> io::Result<()> {
    flock(file, FlockOperation::NonBlockingLockExclusive).map_err(|error| match error {
        Errno::WOULDBLOCK => io::Error::other(
            "another module that runs has its logbooks in this folder: name another one with `--logbooks`",
        ),
        error => error.into(),
    })
}

/// Room for all of it. Where the file system can not reserve, the file has holes, and a full disk is told when it is met.
fn reserve(file: &File, sizes: LogbookSizes) -> io::Result<()> {
    match fallocate(file, FallocateFlags::empty(), 0, file_bytes(sizes)) {
        Err(Errno::OPNOTSUPP) => file.set_len(file_bytes(sizes)),
        reserved => Ok(reserved?),
    }
}

/// An empty file of full size, in the place of whatever has its name: whole when it has it.
fn begin(path: &Path, sizes: LogbookSizes) -> io::Result<File> {
    if let Ok((file, _)) = found(path, OFlags::RDONLY, 0) {
        take(&file)?; // not under the hands of another module
    }
    let folder = path.parent().unwrap_or(Path::new("."));
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let new = folder.join(format!(".{name}.new"));
    let _ = std::fs::remove_file(&new); // of a start that was killed
    let flags = OFlags::RDWR | OFlags::CREATE | OFlags::EXCL | OFlags::NOFOLLOW | OFlags::CLOEXEC;
    let file = File::from(rustix::fs::open(&new, flags, Mode::from_raw_mode(0o644))?);
    let made = reserve(&file, sizes).and_then(|()| {
        file.write_all_at(&head(sizes, 0), 0)?;
        file.sync_all()?;
        take(&file)?;
        std::fs::rename(&new, path)
    });
    if let Err(error) = made {
        let _ = std::fs::remove_file(&new); // the error is told
        return Err(error);
    }
    File::open(folder)?.sync_all()?;
    Ok(file)
}

/// Bytes of a record.
fn record_bytes(sizes: LogbookSizes) -> usize {
    RECORD + sizes.message as usize
}

fn file_bytes(sizes: LogbookSizes) -> u64 {
    HEAD as u64 + (sizes.places() * record_bytes(sizes)) as u64
}

/// Where the record of a message lies.
fn place(sizes: LogbookSizes, number: u64) -> u64 {
    HEAD as u64 + (number % sizes.places() as u64) * record_bytes(sizes) as u64
}

fn head(sizes: LogbookSizes, cleared: u64) -> [u8; HEAD] {
    let mut head = [0; HEAD];
    head[..8].copy_from_slice(MAGIC);
    for (number, place) in [sizes.message, sizes.logged, sizes.in_progress].into_iter().zip([8, 12, 16]) {
        head[place..place + 4].copy_from_slice(&number.to_le_bytes());
    }
    head[20..28].copy_from_slice(&cleared.to_le_bytes());
    let sum = crc32fast::hash(&head[..28]);
    head[28..32].copy_from_slice(&sum.to_le_bytes());
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

/// What a file has.
#[derive(Debug, PartialEq, Eq)]
struct Found {
    cleared: u64,
    /// The number of the first message.
    first: u64,
    messages: Vec<Content>,
    /// The newest of them was not written to its end.
    is_torn: bool,
}

impl Default for Found {
    fn default() -> Self {
        Self { cleared: 0, first: 1, messages: Vec::new(), is_torn: false }
    }
}

/// `None`: it is no logbook, or one of other sizes.
fn read(bytes: &[u8], sizes: LogbookSizes) -> Option<Found> {
    let (start, records) = bytes.split_at_checked(HEAD)?;
    let cleared = u64::from_le_bytes(start[20..28].try_into().ok()?);
    if start != head(sizes, cleared) || cleared >= LAST_NUMBER {
        return None;
    }
    let places = sizes.places() as u64;
    let mut kept: Vec<Option<(u64, Content)>> =
        records.chunks(record_bytes(sizes)).map(read_record).collect();
    kept.resize(places as usize, None);
    let newest = kept.iter().flatten().map(|(number, _)| *number).max().unwrap_or(0).max(cleared);
    // The executive may have died within the next one.
    let next = ((newest + 1) % places) as usize;
    let is_torn = kept[next].is_none()
        && records
            .chunks(record_bytes(sizes))
            .nth(next)
            .is_some_and(|bytes| bytes.iter().any(|byte| *byte != 0));
    let newest = newest + u64::from(is_torn);
    let first = newest.saturating_sub(u64::from(sizes.logged)).max(cleared) + 1;
    let content = |number: u64| match kept[(number % places) as usize].take() {
        Some((found, content)) if found == number => content,
        _ => None,
    };
    Some(Found { cleared, first, messages: (first..=newest).map(content).collect(), is_torn })
}

/// `None`: there is none, or it is damaged.
fn read_record(bytes: &[u8]) -> Option<(u64, Content)> {
    let word = |at: usize| Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?));
    let (sum, length) = (word(0)?, word(4)?);
    let number = u64::from_le_bytes(bytes.get(8..16)?.try_into().ok()?);
    let end = if length == ABORTED { RECORD } else { RECORD + length as usize };
    let is_whole = (1..LAST_NUMBER).contains(&number) && bytes.get(4..end).map(crc32fast::hash) == Some(sum);
    is_whole.then(|| (number, (length != ABORTED).then(|| bytes[RECORD..end].to_vec())))
}

/// The messages of a file from the newest on; `None` for one that was aborted. One that is being written is read again.
///
/// # Errors
/// There is no such file, or it is no logbook; with words for a person.
pub fn read_file(path: &Path) -> io::Result<Vec<Content>> {
    let mut tries = 0;
    loop {
        let found = read_once(path)?;
        tries += 1;
        if !found.is_torn || tries == 3 {
            return Ok(found.messages.into_iter().rev().collect());
        }
        std::thread::sleep(Duration::from_millis(10));
    }
}

fn read_once(path: &Path) -> io::Result<Found> {
    let no_logbook = || io::Error::other("it is no logbook");
    let most = file_bytes(LogbookSizes {
        message: bateleur_plan::bounds::LONGEST_BYTES,
        logged: bateleur_plan::bounds::MOST_LOGGED,
        in_progress: bateleur_plan::bounds::MOST_IN_PROGRESS,
    });
    let (_, bytes) = found(path, OFlags::RDONLY, most)?;
    let word = |at: usize| Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?));
    let sizes = || Some(LogbookSizes { message: word(8)?, logged: word(12)?, in_progress: word(16)? });
    let sizes = sizes().ok_or_else(no_logbook)?;
    // Before memory is taken for so many.
    if sizes.logged == 0 || file_bytes(sizes) > bytes.len() as u64 {
        return Err(no_logbook());
    }
    read(&bytes, sizes).ok_or_else(no_logbook)
}

/// The files of logbooks in a folder, by name, without those that are not gone on with.
#[must_use]
pub fn files(folder: &Path) -> Vec<PathBuf> {
    let is_logbook = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        path.is_file() && !name.starts_with('.') && name.contains('.') && !name.contains(OLD)
    };
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.path()).filter(is_logbook).collect();
    files.sort();
    files
}

#[cfg(test)]
mod tests {
    use std::fs::OpenOptions;

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
        let store = Store::open(path, &memory, SIZES, Beginning::FromFiles).unwrap();
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
                let found = all(&path);
                assert_eq!((&found[0], &found[1]), (&Some(b"on".to_vec()), &None), "{messages} {torn}");
            }
        }
    }

    #[test]
    fn file_of_other_sizes_and_whatever_else_is_called_so_are_kept_beside() {
        let folder = tempfile::tempdir().unwrap();
        let (path, old) = (folder.path().join("log"), folder.path().join("log.old"));
        let other = head(LogbookSizes { message: 9, ..SIZES }, 0);
        for (number, content) in [&b"notes"[..], b"", &[0; 500], &other, &[7; 5000]].into_iter().enumerate() {
            std::fs::write(&path, content).unwrap();
            written(&path, &[b"a"]);
            let name =
                if number == 0 { old.clone() } else { folder.path().join(format!("log.old-{}", number + 1)) };
            assert_eq!((std::fs::read(name).unwrap(), all(&path)), (content.to_vec(), contents(&[b"a"])));
        }
    }

    #[test]
    fn link_and_pipe_in_the_place_of_a_file_are_put_beside_and_lead_nowhere() {
        let folder = tempfile::tempdir().unwrap();
        let (path, victim) = (folder.path().join("log"), folder.path().join("victim"));
        let open = |beginning| {
            let memory = memory(SIZES);
            let store = Store::open(&path, &memory, SIZES, beginning).unwrap();
            assert!(path.symlink_metadata().unwrap().is_file());
            drop(store);
            std::fs::remove_file(&path).unwrap();
        };
        for beginning in [Beginning::FromFiles, Beginning::Anew] {
            std::fs::write(&victim, "mine").unwrap();
            for target in [&victim, &folder.path().join("nowhere")] {
                std::os::unix::fs::symlink(target, &path).unwrap();
                open(beginning);
            }
            let mode = Mode::from_raw_mode(0o600);
            rustix::fs::mknodat(rustix::fs::CWD, &path, rustix::fs::FileType::Fifo, mode, 0).unwrap();
            open(beginning);
            assert_eq!(std::fs::read_to_string(&victim).unwrap(), "mine");
            assert!(!folder.path().join("nowhere").exists());
        }
    }

    #[test]
    fn two_modules_do_not_store_into_one_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let (_, _store) = opened(&path);
        for beginning in [Beginning::FromFiles, Beginning::Anew] {
            for sizes in [SIZES, LogbookSizes { message: 9, ..SIZES }] {
                let refused = Store::open(&path, memory(sizes), sizes, beginning).unwrap_err();
                assert!(refused.to_string().contains("another module that runs"), "{refused}");
            }
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "it was not put beside");
    }

    #[test]
    fn executive_that_follows_a_dead_one_stores_what_was_on_its_way_and_fills_a_memory_that_does_not_belong_to_the_file()
     {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let memory = memory(SIZES);
        let open = |beginning| Store::open(&path, &memory, SIZES, beginning).unwrap();
        let mut first = open(Beginning::FromFiles);
        let partition = partition(&memory);
        partition.write(b"a").unwrap();
        first.store().unwrap();
        partition.write(b"b").unwrap();
        // It dies within the record of the next one.
        first.file.write_all_at(&record(2, Some(b"b"))[..5], place(SIZES, 2)).unwrap();
        drop(first);
        let mut second = open(Beginning::AfterDeath);
        second.store().unwrap();
        assert_eq!(all(&path), contents(&[b"b", b"a"]));
        drop(second);
        // A death before the memory was filled, and a file that is gone.
        partition.begin();
        let mut third = open(Beginning::AfterDeath);
        assert_eq!(partition.newest(), 2);
        for message in [b"3", b"4", b"5"] {
            partition.write(message).unwrap();
            third.store().unwrap();
        }
        drop(third);
        std::fs::remove_file(&path).unwrap();
        let mut fourth = open(Beginning::AfterDeath);
        assert_eq!(partition.newest(), 0);
        partition.write(b"c").unwrap();
        fourth.store().unwrap();
        assert_eq!(all(&path), contents(&[b"c"]));
    }

    #[test]
    fn partition_that_writes_without_end_gets_its_share_of_the_disk_and_all_of_it_at_the_end() {
        let folder = tempfile::tempdir().unwrap();
        let (partition, mut store) = opened(&folder.path().join("log"));
        store.budget = 0;
        let shared = Arc::new(Shared { stores: Mutex::new(vec![store]), ..Shared::default() });
        let mut stores = LogbookStores { shared, thread: None };
        let mut count = 0;
        for _ in 0..10 * SHARE / RECORD as i64 {
            count += u64::from(partition.write(b"12345678").is_ok());
            if count.is_multiple_of(400) {
                lock(&stores.shared.stores)[0].budget = -SHARE; // nothing is left of it
            }
            stores.store();
        }
        assert!(count > 400, "{count}");
        lock(&stores.shared.stores)[0].budget = i64::MIN / 2;
        while partition.write(b"last").is_ok() {}
        stores.store();
        assert!(partition.counts().in_progress > 0);
        assert_eq!(stores.finish(), []);
        assert_eq!(partition.counts().in_progress, 0);
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
        drop(store);
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
        assert!(stores.take_trouble().is_empty() && partition.overwrite(b"d").is_ok());
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
        assert_eq!(stores.take_trouble()[0].log, "logbook log");
        stores.store();
        assert_eq!(stores.take_trouble(), []);
        assert_eq!(partition.counts().in_progress, 1);
    }

    /// A file can be damaged anywhere: what is read is bounded, and a run begins.
    #[test]
    fn damaged_files_are_read_or_kept_beside() {
        let mut random = 7_u64;
        for _ in 0..300 {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("log");
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
            assert!(all(&path).iter().take(2).any(|message| *message == Some(b"next".to_vec())));
        }
    }
}
