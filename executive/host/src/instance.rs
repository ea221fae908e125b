//! One run of one module on this machine: its name, its files in `/dev/shm`, its control group; and what earlier runs
//! that were killed have left behind.
//!
//! Everything that a run makes outside its output folder carries the run's name. Its record is locked for as long as its process
//! lives, so whoever comes later, the guard process or the next start, can tell what nobody owns: also from inside a container that
//! has the machine's `/dev/shm` and none of its processes. A process number alone must never decide that somebody is dead.

use std::fs::{self, File};
use std::hash::{BuildHasher, RandomState};
use std::io::{
    self,
    ErrorKind::{AlreadyExists, NotFound},
};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use serde::{Deserialize, Serialize};

use rustix::fs::{FlockOperation, flock};

use bateleur_system::cgroup;
use bateleur_system::processes::process;
use bateleur_system::trace;
use bateleur_system::tree::{self, Folder, NotRemoved};
use bateleur_system::users::{self, HELPERS, Users};

/// Where shared memory lies: a tmpfs on every Linux.
const SHARED_MEMORY: &str = "/dev/shm";
/// First part of every run's name.
const NAME: &str = "bateleur";
/// The record's file inside a run's directory.
const RECORD: &str = "instance.json";
/// Holds the directories of channels that were rebuilt until they are removed. No partition reaches it.
const DISCARDED: &str = "discarded";
/// How long a process may take that is dying.
const DYING: Duration = Duration::from_secs(10);
/// A run's directory without a record that somebody holds is removed when it is older: before, its run may still be making it.
const MAKING: Duration = Duration::from_secs(10);

/// What a run leaves in its directory for those who clean up after it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Instance {
    /// The run's name: `bateleur.<module>.<process>`, with more behind it where that name was taken.
    pub name: String,
    /// The executive's process.
    pub pid: i32,
    /// When that process was started, clock ticks since boot: a number that is used again is not the same process.
    pub started_ticks: u64,
    /// The run's control group, where it has one.
    pub group: Option<PathBuf>,
    /// Its groups of version 1.
    #[serde(default)]
    pub accounts: Vec<PathBuf>,
    /// The processors that its dispatchers have; none on the virtual clock, and in the records of older versions.
    #[serde(default)]
    pub cores: Vec<u32>,
    /// First user number of its partitions, where they have users of their own.
    #[serde(default)]
    pub users: Option<u32>,
    /// Whether the record is locked while the process lives. Those of older versions are not: their process is looked for.
    #[serde(default)]
    pub locked: bool,
    /// A supervisor starts another executive after this one: what can wait is not cleaned up before.
    #[serde(default)]
    pub supervised: bool,
}

/// The lock on a run's record: the run counts as living until this is dropped, or its process is gone. A descriptor that ends with
/// `exec`, so that no helper or partition keeps it.
#[derive(Debug)]
pub struct Alive(#[allow(dead_code)] File);

/// Names that are tried before a run is given up.
const NAMES: usize = 16;

impl Instance {
    /// The run of `module` by this process, whose dispatchers have `cores` and whose partitions the user numbers from `users` on. Makes its
    /// directory.
    pub fn create(module: &str, cores: Vec<u32>, users: Option<u32>) -> io::Result<(Self, Alive)> {
        let pid = std::process::id() as i32;
        let mut instance = Self {
            name: format!("{NAME}.{module}.{pid}"),
            pid,
            started_ticks: started_ticks(pid).unwrap_or(0),
            group: None,
            accounts: Vec::new(),
            cores,
            users,
            locked: true,
            supervised: false,
        };
        let record = instance.make_directory()?;
        // Locked before there is anything in it that somebody could believe.
        flock(&record, FlockOperation::LockExclusive)?;
        instance.record()?;
        Ok((instance, Alive(record)))
    }

    /// Gives the empty record. The name with the process in it can be foreseen and another run may have it: a process of the same number
    /// in another container, or somebody who does not want this one to start. Or another start removes the directory while it is empty.
    /// Then another name is drawn.
    fn make_directory(&mut self) -> io::Result<File> {
        let plain = self.name.clone();
        let make = |instance: &Self| {
            // Whatever the user's umask says: a record that others could write is not believed.
            fs::DirBuilder::new().mode(0o755).create(instance.directory())?;
            File::create_new(instance.directory().join(RECORD))
        };
        let mut made = make(self);
        for _ in 0..NAMES {
            match &made {
                Err(error) if matches!(error.kind(), AlreadyExists | NotFound) => {}
                _ => break,
            }
            self.name = format!("{plain}-{:08x}", RandomState::new().hash_one(0) as u32);
            made = make(self);
        }
        made
    }

    /// Notes the control groups, for those who clean up.
    pub fn set_groups(&mut self, group: Option<&Path>, accounts: Vec<PathBuf>) -> io::Result<()> {
        self.group = group.map(Path::to_owned);
        self.accounts = accounts;
        self.record()
    }

    /// The module's name in its plan.
    #[must_use]
    pub fn module(&self) -> &str {
        let module = self.name.strip_prefix(NAME).and_then(|rest| rest.strip_prefix('.'));
        module.and_then(|rest| rest.rsplit_once('.')).map_or("", |(module, _)| module)
    }

    /// The run's directory.
    #[must_use]
    pub fn directory(&self) -> PathBuf {
        Path::new(SHARED_MEMORY).join(&self.name)
    }

    /// Where the run's shared memory lies: a directory of which nothing of two runs can meet.
    #[must_use]
    pub fn ports_root(&self) -> PathBuf {
        self.directory().join("ports")
    }

    /// The directory of a channel.
    #[must_use]
    pub fn channel_directory(&self, channel: &str) -> PathBuf {
        self.ports_root().join(channel)
    }

    /// Makes a directory for each channel. What holds them is the executive's, so that no partition can put another in its place.
    ///
    /// Where partitions have users of their own, a channel's directory is the executive's too, and whoever reaches it may write: its
    /// ends by their mount namespaces, helpers by their group. Where `users` share one number, it is that one's.
    pub fn make_channel_directories(&self, channels: &[String], users: Option<Users>) -> io::Result<()> {
        let (mode, owner) = match are_separate(users) {
            true => (0o750, (None, Some(HELPERS))),
            false => (0o755, (None, None)),
        };
        make_directory(&self.ports_root(), mode, owner)?;
        channels.iter().try_for_each(|channel| self.make_channel_directory(channel, users))
    }

    fn make_channel_directory(&self, channel: &str, users: Option<Users>) -> io::Result<()> {
        let shared = users.map(|_| HELPERS);
        let (mode, owner) = match are_separate(users) {
            true => (0o777, (None, None)),
            false => (0o700, (shared, shared)),
        };
        make_directory(&self.channel_directory(channel), mode, owner)
    }

    /// Makes the directories of channels anew: what a partition has touched is put aside whole, whatever it has made of it. Whoever is
    /// attached to them keeps what was put aside; nobody else sees it. Gives where it is, to be removed.
    ///
    /// # Errors
    /// One could not be put aside or made.
    pub fn remake_channel_directories(
        &self,
        channels: &[String],
        users: Option<Users>,
    ) -> io::Result<Vec<PathBuf>> {
        let discarded = self.directory().join(DISCARDED);
        match fs::DirBuilder::new().mode(0o700).create(&discarded) {
            Err(error) if error.kind() != AlreadyExists => return Err(error),
            _ => {}
        }
        let mut aside = Vec::new();
        for channel in channels {
            let place = discarded.join(format!("{channel}.{:016x}", RandomState::new().hash_one(0)));
            match tree::put_aside(&self.channel_directory(channel), &place) {
                Err(error) if error.kind() == NotFound => {} // somebody was faster
                put => {
                    put?;
                    aside.push(place);
                }
            }
            self.make_channel_directory(channel, users)?;
        }
        Ok(aside)
    }

    fn record(&self) -> io::Result<()> {
        fs::write(self.directory().join(RECORD), serde_json::to_vec(self)?)
    }

    /// Ends what is left of the run and removes what it made.
    ///
    /// # Errors
    /// What could not be removed: the next start tries again.
    pub fn clean_up(&self) -> Result<(), NotRemoved> {
        let groups = || self.group.iter().chain(&self.accounts);
        // Before anything is removed: a helper may make anew what it misses.
        groups().for_each(|group| cgroup::remove(group));
        self.remove_all_but_the_record()?;
        match groups().find(|group| group.exists()) {
            // A process that can not die yet keeps its group, and the record is all that the next start knows of it.
            Some(stuck) => Err(NotRemoved {
                path: stuck.clone(),
                why: io::Error::other("a process in it has not ended"),
            }),
            // The record goes last: what a guard leaves that is killed itself, the next start finds by it.
            None => tree::remove(&self.directory()),
        }
    }

    fn remove_all_but_the_record(&self) -> Result<(), NotRemoved> {
        let failed = |why| NotRemoved { path: self.directory(), why };
        let folder = match Folder::open(&self.directory()) {
            Err(error) if error.kind() == NotFound => return Ok(()),
            folder => folder.map_err(failed)?,
        };
        let entries = folder.entries().map_err(failed)?;
        let others = entries.iter().filter(|entry| entry.name.to_bytes() != RECORD.as_bytes());
        others.map(|entry| folder.remove(&entry.name)).fold(Ok(()), Result::and)
    }

    fn is_alive(&self) -> bool {
        let record = self.directory().join(RECORD);
        match self.locked && record.exists() {
            true => is_locked(&record),
            false => started_ticks(self.pid) == Some(self.started_ticks),
        }
    }

    /// Whether it lives, and goes on living: an executive that was killed holds its lock until its memory is gone, and that is waited for.
    fn stays_alive(&self) -> bool {
        let begun = Instant::now();
        // A process that has taken its SIGKILL and does not exit yet looks like any other, for microseconds.
        let mut looks = 2;
        while self.is_alive() {
            let dies = process(self.pid).is_some_and(|it| it.dying && it.started_ticks == self.started_ticks);
            looks -= u32::from(!dies);
            if looks == 0 || begun.elapsed() > DYING {
                return true;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        false
    }
}

/// Removes what killed runs have left: their directories and groups, and what only looks like a run's directory.
/// Gives the names, and what could not be removed.
pub fn clean_leftovers() -> (Vec<String>, Vec<NotRemoved>) {
    let dead = records(is_own).filter(|instance| !instance.stays_alive());
    // As they were at their ends: one that was beginning may have had no groups yet.
    let dead: Vec<_> = dead.filter_map(|dead| trusted_record(&dead.directory(), is_own)).collect();
    let runs = dead.into_iter().map(|instance| (instance.clean_up(), instance.name));
    let runs: Vec<_> = runs.collect();
    // What the runs before did not take: it has no record, or none that may be believed.
    let wrecks = directories().filter_map(|path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        // Whose record was removed and nothing after it. One that is being made takes another name.
        if is_own_directory(&path) && fs::remove_dir(&path).is_ok() {
            return Some((Ok(()), name));
        }
        is_wreck(&path).then(|| (tree::remove(&path), name))
    });
    let all: Vec<_> = runs.into_iter().chain(wrecks.collect::<Vec<_>>()).collect();
    let (mut names, mut left) = (Vec::new(), Vec::new());
    for (removed, name) in all {
        names.push(name);
        left.extend(removed.err());
    }
    (names, left)
}

/// Whether something called like a run's directory is none: nobody's run is in it. For root, what partitions or helpers have made,
/// whatever it says about itself; else one of this user without a record that can be believed.
fn is_wreck(path: &Path) -> bool {
    let Ok(about) = fs::symlink_metadata(path) else { return false };
    if is_own(0) && users::is_of_a_run(about.uid()) {
        return true;
    }
    let age = || SystemTime::now().duration_since(about.modified().ok()?).ok();
    is_own(about.uid())
        && about.is_dir()
        && trusted_record(path, is_own).is_none()
        && !is_locked(&path.join(RECORD))
        && age().is_some_and(|age| age > MAKING)
}

fn is_own_directory(path: &Path) -> bool {
    fs::symlink_metadata(path).is_ok_and(|about| about.is_dir() && is_own(about.uid()))
}

/// Whether a process holds the lock on a record.
fn is_locked(record: &Path) -> bool {
    let open = || {
        let flags = rustix::fs::OFlags::RDONLY | rustix::fs::OFlags::NOFOLLOW | rustix::fs::OFlags::NONBLOCK;
        rustix::fs::open(record, flags | rustix::fs::OFlags::CLOEXEC, rustix::fs::Mode::empty())
    };
    open().is_ok_and(|file| {
        flock(&file, FlockOperation::NonBlockingLockShared) == Err(rustix::io::Errno::WOULDBLOCK)
    })
}

/// The runs of this user that live; for root, those of every user but the partitions'.
#[must_use]
pub fn living() -> Vec<Instance> {
    let may_see = |user| is_own(user) || (is_own(0) && !users::is_of_a_run(user));
    records(may_see).filter(Instance::is_alive).collect()
}

/// Those of them that are not of this process.
#[must_use]
pub fn others() -> Vec<Instance> {
    let own = std::process::id() as i32;
    living().into_iter().filter(|other| other.pid != own).collect()
}

/// Removes the kernel's traces that runs have left. That takes the kernel a tenth of a second.
pub fn sweep_traces() {
    let living: Vec<String> = living().into_iter().map(|instance| instance.name).collect();
    trace::sweep(&format!("{NAME}."), |name| living.iter().any(|one| one == name));
}

/// Those of them whose process began after this one.
#[must_use]
pub fn later_ones() -> Vec<Instance> {
    let own_ticks = started_ticks(std::process::id() as i32).unwrap_or(0);
    others().into_iter().filter(|other| other.started_ticks >= own_ticks).collect()
}

fn records(trusted: impl Fn(u32) -> bool) -> impl Iterator<Item = Instance> {
    directories().filter_map(move |path| trusted_record(&path, &trusted))
}

/// Whether each partition has a user of its own.
fn are_separate(users: Option<Users>) -> bool {
    users.is_some_and(|users| users.partitions.is_some())
}

/// Makes a directory of that mode, whatever the umask is.
fn make_directory(path: &Path, mode: u32, (owner, group): (Option<u32>, Option<u32>)) -> io::Result<()> {
    fs::DirBuilder::new().mode(0o700).create(path)?;
    std::os::unix::fs::chown(path, owner, group)?;
    fs::set_permissions(path, fs::Permissions::from_mode(mode))
}

/// What is called like a run's directory.
fn directories() -> impl Iterator<Item = PathBuf> {
    let entries = fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten();
    let ours = entries.filter(|entry| entry.file_name().to_string_lossy().starts_with(&format!("{NAME}.")));
    ours.map(|entry| entry.path())
}

fn is_own(user: u32) -> bool {
    user == rustix::process::geteuid().as_raw()
}

/// The record in a run's directory, if a trusted user made it. Anybody, a partition too, may make a directory in `/dev/shm`
/// that looks like a run: believing it would remove whatever folder and end whatever control group it names.
fn trusted_record(directory: &Path, trusted: impl Fn(u32) -> bool) -> Option<Instance> {
    let about = fs::symlink_metadata(directory).ok()?;
    if !about.is_dir() || !trusted(about.uid()) || about.mode() & WRITABLE_BY_OTHERS != 0 {
        return None;
    }
    let instance: Instance = serde_json::from_slice(&fs::read(directory.join(RECORD)).ok()?).ok()?;
    let name = directory.file_name()?;
    let groups_fit =
        instance.group.iter().chain(&instance.accounts).all(|group| group.file_name() == Some(name));
    (name == instance.name.as_str() && groups_fit).then_some(instance)
}

/// Mode bits that let somebody else put files into a directory.
const WRITABLE_BY_OTHERS: u32 = 0o022;

/// When a process was started, clock ticks since boot; `None`: it has ended.
fn started_ticks(pid: i32) -> Option<u64> {
    process(pid).filter(|process| !process.has_ended()).map(|process| process.started_ticks)
}

#[cfg(test)]
pub(crate) mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    /// A record without a directory.
    pub(crate) fn instance(pid: i32, cores: &[u32]) -> Instance {
        Instance {
            name: format!("bateleur.fcu.{pid}"),
            pid,
            started_ticks: 1,
            group: None,
            accounts: Vec::new(),
            cores: cores.to_vec(),
            users: None,
            locked: true,
            supervised: false,
        }
    }

    #[test]
    fn a_living_run_is_left_alone_and_a_dead_one_is_removed() {
        let (living, _alive) = Instance::create("instance_test", Vec::new(), None).unwrap();
        // A process number that can not exist stands for an executive that was killed.
        let dead = Instance { name: "bateleur.instance_test.dead".into(), ..instance(i32::MAX, &[]) };
        fs::create_dir(dead.directory()).unwrap();
        dead.record().unwrap();
        dead.make_channel_directories(&["imu.rates".into()], None).unwrap();
        let segment = dead.channel_directory("imu.rates").join("segment");
        fs::write(&segment, "left").unwrap();
        let (cleaned, _) = clean_leftovers();
        assert!(cleaned.contains(&dead.name));
        assert!(!segment.exists() && !dead.directory().exists());
        assert!(living.directory().exists());
        assert_eq!(living.module(), "instance_test");
        assert!(super::living().contains(&living));
        living.clean_up().unwrap();
        assert!(!living.directory().exists());
    }

    #[test]
    fn whoever_is_killed_while_it_cleans_up_leaves_the_record_to_the_next_start() {
        // Held: whoever cleans up beside this test leaves it alone.
        let (instance, _alive) = Instance::create("instance_halfway", Vec::new(), None).unwrap();
        for file in 0..2000 {
            fs::create_dir_all(instance.ports_root().join(file.to_string())).unwrap();
            fs::write(instance.directory().join(format!("segment{file}")), "").unwrap();
        }
        let directory = instance.directory();
        let left_without_record = || {
            let record = directory.join(RECORD).exists();
            let entries = fs::read_dir(&directory).into_iter().flatten();
            if record { 0 } else { entries.count() }
        };
        std::thread::scope(|scope| {
            let removal = scope.spawn(|| instance.clean_up());
            let mut looks = 0;
            while directory.exists() {
                assert_eq!(left_without_record(), 0);
                looks += 1;
            }
            removal.join().unwrap().unwrap();
            assert!(looks > 1, "{looks}");
        });
    }

    #[test]
    fn a_directory_whose_guard_was_killed_before_its_last_step_is_removed_at_once() {
        let path = Path::new(SHARED_MEMORY).join(format!("bateleur.instance_empty.{}", std::process::id()));
        fs::create_dir(&path).unwrap();
        clean_leftovers();
        assert!(!path.exists());
    }

    /// Whether the run's record, as whoever starts next reads it, is that of one who lives. Not by [`clean_leftovers`], which would look
    /// at the runs of others too.
    fn is_taken_for_living(instance: &Instance) -> bool {
        trusted_record(&instance.directory(), is_own).is_some_and(|read| read.is_alive())
    }

    #[test]
    fn a_run_whose_process_can_not_be_seen_from_here_lives_as_long_as_its_lock_is_held() {
        let (mut unseen, alive) = Instance::create("instance_unseen", Vec::new(), None).unwrap();
        // As its own container numbers it: here there is no such process.
        unseen.pid = i32::MAX;
        unseen.set_groups(None, Vec::new()).unwrap();
        assert!(is_taken_for_living(&unseen), "also after its record was written anew");
        drop(alive);
        assert!(!is_taken_for_living(&unseen), "its executive is gone");
        unseen.clean_up().unwrap();
    }

    #[test]
    fn a_record_stays_as_long_as_a_group_that_it_names_could_not_be_removed() {
        let (mut instance, alive) = Instance::create("instance_stuck", Vec::new(), None).unwrap();
        let folder = tempfile::tempdir().unwrap();
        // A folder that is not empty goes as little as a group with a process that can not die.
        let stuck = folder.path().join(&instance.name);
        fs::create_dir(&stuck).unwrap();
        fs::write(stuck.join("process"), "").unwrap();
        instance.set_groups(Some(&stuck), Vec::new()).unwrap();
        fs::create_dir(instance.directory().join("ports")).unwrap();
        drop(alive);
        assert!(instance.clean_up().is_err(), "and says so");
        assert!(trusted_record(&instance.directory(), is_own).is_some(), "the next start finds it");
        assert!(!instance.directory().join("ports").exists());
        fs::remove_dir_all(&stuck).unwrap();
        instance.clean_up().unwrap();
        assert!(!instance.directory().exists());
    }

    #[test]
    fn a_lock_is_kept_by_no_child_that_the_executive_starts() {
        let (instance, alive) = Instance::create("instance_child", Vec::new(), None).unwrap();
        let mut child = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        drop(alive);
        // Between `fork` and `exec` a child of another test has it too.
        let still_lives = |_| {
            std::thread::sleep(Duration::from_millis(1));
            is_taken_for_living(&instance)
        };
        let living = (0..1000).all(still_lives);
        child.kill().unwrap();
        child.wait().unwrap();
        instance.clean_up().unwrap();
        assert!(!living);
    }

    #[test]
    fn a_run_of_an_older_version_without_a_lock_lives_as_long_as_its_process() {
        let (mut older, alive) = Instance::create("instance_older", Vec::new(), None).unwrap();
        drop(alive);
        older.locked = false;
        older.record().unwrap();
        assert!(is_taken_for_living(&older), "its process is this one");
        older.started_ticks += 1;
        older.record().unwrap();
        assert!(!is_taken_for_living(&older), "another process has its number");
        older.clean_up().unwrap();
    }

    #[test]
    fn a_name_that_somebody_has_taken_before_keeps_no_module_from_starting() {
        let (first, _one) = Instance::create("instance_taken", Vec::new(), None).unwrap();
        let (second, _other) = Instance::create("instance_taken", Vec::new(), None).unwrap();
        let (name, module) = (second.name.clone(), second.module().to_owned());
        assert!(is_taken_for_living(&second));
        first.clean_up().unwrap();
        second.clean_up().unwrap();
        assert!(name.starts_with(&format!("{}-", first.name)), "{name}");
        assert_eq!(module, "instance_taken");
    }

    #[test]
    fn a_planted_record_that_names_another_folder_is_not_believed() {
        let victim = tempfile::tempdir_in(SHARED_MEMORY).unwrap();
        let planted = Path::new(SHARED_MEMORY).join(format!("bateleur.planted.{}", std::process::id()));
        let name = victim.path().file_name().unwrap().to_string_lossy().into_owned();
        let instance = Instance { name, ..instance(i32::MAX, &[]) };
        fs::create_dir(&planted).unwrap();
        fs::write(planted.join(RECORD), serde_json::to_vec(&instance).unwrap()).unwrap();
        assert_eq!(trusted_record(&planted, is_own), None);
        clean_leftovers();
        assert!(victim.path().exists());
        fs::remove_dir_all(&planted).unwrap();
    }

    #[test]
    fn a_channel_is_made_anew_whatever_was_made_of_its_directory_and_the_others_stay_as_they_are() {
        let (instance, _alive) = Instance::create("instance_remade", Vec::new(), None).unwrap();
        let channels = ["a.out", "b.out", "c.out"].map(str::to_owned);
        instance.make_channel_directories(&channels, None).unwrap();
        let directory = |channel: &str| instance.channel_directory(channel);
        fs::write(directory("a.out").join("segment"), "kept").unwrap();
        fs::create_dir_all(directory("b.out").join("deep/deeper")).unwrap();
        fs::set_permissions(directory("b.out"), fs::Permissions::from_mode(0o0)).unwrap();
        fs::remove_dir(directory("c.out")).unwrap();
        std::os::unix::fs::symlink("/", directory("c.out")).unwrap();
        for _ in 0..2 {
            let aside = instance.remake_channel_directories(&channels[1..], None).unwrap();
            assert_eq!(aside.len(), 2, "{aside:?}");
            assert!(aside.iter().all(|path| path.symlink_metadata().is_ok()));
            for channel in ["b.out", "c.out"] {
                let about = fs::symlink_metadata(directory(channel)).unwrap();
                assert!(about.is_dir() && about.mode() & 0o700 == 0o700, "{channel}");
                assert_eq!(fs::read_dir(directory(channel)).unwrap().count(), 0, "{channel}");
            }
        }
        assert_eq!(fs::read_to_string(directory("a.out").join("segment")).unwrap(), "kept");
        instance.clean_up().unwrap();
        assert!(!instance.directory().exists());
    }

    /// A directory that is called like a run's; what it holds says that its run is dead, and names something of somebody else.
    fn wreck(name: &str, victim: &Path, owner: Option<u32>, seconds_old: i64) -> PathBuf {
        let path = Path::new(SHARED_MEMORY).join(format!("{NAME}.{name}.{}", std::process::id()));
        fs::create_dir(&path).unwrap();
        let record = format!("{{\"name\":\"x\",\"pid\":1,\"started_ticks\":1,\"group\":{victim:?}}}");
        fs::write(path.join(RECORD), record).unwrap();
        fs::create_dir(path.join("ports")).unwrap();
        std::os::unix::fs::symlink(victim, path.join("ports/link")).unwrap();
        std::os::unix::fs::chown(&path, owner, owner).unwrap();
        let then = SystemTime::now() - Duration::from_secs(seconds_old.unsigned_abs());
        File::open(&path).unwrap().set_modified(then).unwrap();
        path
    }

    #[test]
    fn what_partitions_and_helpers_have_made_in_place_of_a_run_is_removed_and_not_believed() {
        if !is_own(0) {
            return eprintln!("skipped: needs root");
        }
        let victim = tempfile::tempdir().unwrap();
        fs::write(victim.path().join("file"), "kept").unwrap();
        let owners = [HELPERS, users::first_of_run(7, &[])];
        let wrecks = owners.map(|owner| wreck(&format!("wreck{owner}"), victim.path(), Some(owner), 0));
        let helper = wreck("stranger", victim.path(), Some(61_000), 3600);
        let (_, left) = clean_leftovers();
        assert!(wrecks.iter().all(|path| !path.exists()), "{left:?}");
        assert!(helper.exists(), "another user's is his");
        assert!(victim.path().join("file").exists());
        tree::remove(&helper).unwrap();
    }

    #[test]
    fn a_directory_without_a_record_is_removed_unless_its_run_may_still_be_making_it() {
        let victim = tempfile::tempdir().unwrap();
        let (old, new) = (wreck("old", victim.path(), None, 60), wreck("new", victim.path(), None, 0));
        let held = wreck("held", victim.path(), None, 60);
        let lock = File::open(held.join(RECORD)).unwrap();
        flock(&lock, FlockOperation::LockExclusive).unwrap();
        clean_leftovers();
        assert_eq!([&old, &new, &held].map(|path| path.exists()), [false, true, true]);
        assert!(victim.path().exists());
        [new, held].iter().for_each(|path| tree::remove(path).unwrap());
    }
}
