//! One run of one module on this machine: its name, its files in `/dev/shm`, its control group; and what earlier runs
//! that were killed have left behind.
//!
//! Everything that a run makes outside its output folder carries the run's name. Its record is locked for as long as its process
//! lives, so whoever comes later, the guard process or the next start, can tell what nobody owns: also from inside a container that
//! has the machine's `/dev/shm` and none of its processes. A process number alone must never decide that somebody is dead.

use std::fs::{self, File};
use std::hash::{BuildHasher, RandomState};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use bateleur_ports::Domain;
use rustix::fs::{FlockOperation, flock};

use crate::machine::PARTITION_USER;
use crate::system::cgroup;

/// Where shared memory lies: a tmpfs on every Linux.
const SHARED_MEMORY: &str = "/dev/shm";
/// First part of every run's name.
const NAME: &str = "bateleur";
/// The record's file inside a run's directory.
const RECORD: &str = "instance.json";

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
    /// Whether the record is locked while the process lives. Those of older versions are not: their process is looked for.
    #[serde(default)]
    pub locked: bool,
}

/// The lock on a run's record: the run counts as living until this is dropped, or its process is gone. A descriptor that ends with
/// `exec`, so that no helper or partition keeps it.
#[derive(Debug)]
pub struct Alive(#[allow(dead_code)] File);

/// Names that are tried before a run is given up.
const NAMES: usize = 16;

impl Instance {
    /// The run of `module` by this process, whose dispatchers have `cores`. Makes its directory.
    pub fn create(module: &str, cores: Vec<u32>) -> io::Result<(Self, Alive)> {
        let pid = std::process::id() as i32;
        let mut instance = Self {
            name: format!("{NAME}.{module}.{pid}"),
            pid,
            started_ticks: started_ticks(pid).unwrap_or(0),
            group: None,
            accounts: Vec::new(),
            cores,
            locked: true,
        };
        instance.make_directory()?;
        // Locked before there is anything in it that somebody could believe.
        let record = File::create(instance.directory().join(RECORD))?;
        flock(&record, FlockOperation::LockExclusive)?;
        instance.record()?;
        Ok((instance, Alive(record)))
    }

    /// The name with the process in it can be foreseen and another run may have it: a process of the same number in another
    /// container, or somebody who does not want this one to start. Then another name is drawn.
    fn make_directory(&mut self) -> io::Result<()> {
        let plain = self.name.clone();
        // Whatever the user's umask says: a record that others could write is not believed.
        let make = |instance: &Self| fs::DirBuilder::new().mode(0o755).create(instance.directory());
        let mut made = make(self);
        for _ in 0..NAMES {
            match &made {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
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

    /// The run's ports.
    #[must_use]
    pub fn domain(&self) -> Domain {
        let root = self.directory().join("ports").to_string_lossy().into_owned();
        Domain { root }
    }

    /// Makes a directory for each channel, owned by the partitions' user. What holds them is the executive's, so that no
    /// partition can put another in its place.
    pub fn make_channel_directories(&self, channels: &[String], owner: Option<u32>) -> io::Result<()> {
        let domain = self.domain();
        let make = |path: &Path, mode| fs::DirBuilder::new().mode(mode).create(path);
        make(Path::new(&domain.root), 0o755)?;
        for channel in channels {
            let directory = domain.directory(channel);
            make(&directory, 0o700)?;
            std::os::unix::fs::chown(&directory, owner, owner)?;
        }
        Ok(())
    }

    /// Removes everything that lies in the directories of channels. Nobody may be attached to them.
    pub fn empty_channel_directories(&self, channels: &[String]) -> io::Result<()> {
        for channel in channels {
            for entry in fs::read_dir(self.domain().directory(channel))? {
                let path = entry?.path();
                if path.is_dir() { fs::remove_dir_all(&path)? } else { fs::remove_file(&path)? }
            }
        }
        Ok(())
    }

    fn record(&self) -> io::Result<()> {
        fs::write(self.directory().join(RECORD), serde_json::to_vec(self)?)
    }

    /// Ends what is left of the run and removes what it made.
    pub fn clean_up(&self) {
        let groups = || self.group.iter().chain(&self.accounts);
        groups().for_each(|group| cgroup::remove(group));
        if !groups().any(|group| group.exists()) {
            let _ = fs::remove_dir_all(self.directory()); // gone already, or not ours: the next start tries again
            return;
        }
        // A process that can not die yet keeps its group, and the record is all that the next start knows of it.
        for entry in fs::read_dir(self.directory()).into_iter().flatten().flatten() {
            let path = entry.path();
            let _ = match entry.file_name() == RECORD {
                true => continue,
                false if path.is_dir() => fs::remove_dir_all(&path),
                false => fs::remove_file(&path),
            }; // as above
        }
    }

    fn is_alive(&self) -> bool {
        match File::open(self.directory().join(RECORD)) {
            Ok(record) if self.locked => {
                flock(&record, FlockOperation::NonBlockingLockShared) == Err(rustix::io::Errno::WOULDBLOCK)
            }
            _ => started_ticks(self.pid) == Some(self.started_ticks),
        }
    }
}

/// Removes what killed runs have left; gives their names.
pub fn clean_leftovers() -> Vec<String> {
    let dead: Vec<_> = records(is_own).filter(|instance| !instance.is_alive()).collect();
    dead.iter().for_each(Instance::clean_up);
    dead.into_iter().map(|instance| instance.name).collect()
}

/// The runs of this user that live; for root, those of every user but the partitions'.
#[must_use]
pub fn living() -> Vec<Instance> {
    let may_see = |user| is_own(user) || (is_own(0) && user != PARTITION_USER);
    records(may_see).filter(Instance::is_alive).collect()
}

fn records(trusted: impl Fn(u32) -> bool) -> impl Iterator<Item = Instance> {
    let entries = fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten();
    let ours = entries.filter(|entry| entry.file_name().to_string_lossy().starts_with(&format!("{NAME}.")));
    ours.filter_map(move |entry| trusted_record(&entry.path(), &trusted))
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

/// Field 22 of /proc/PID/stat; the name before it may hold anything, so fields are counted from its closing bracket.
fn started_ticks(pid: i32) -> Option<u64> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    let after_name = stat.rsplit_once(')')?.1;
    let mut fields = after_name.split_ascii_whitespace();
    if fields.next()? == "Z" {
        return None;
    }
    fields.nth(18)?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_living_run_is_left_alone_and_a_dead_one_is_removed() {
        let (living, _alive) = Instance::create("instance_test", Vec::new()).unwrap();
        // A process number that can not exist stands for an executive that was killed.
        let dead = Instance {
            name: "bateleur.instance_test.dead".into(),
            pid: i32::MAX,
            started_ticks: 1,
            group: None,
            accounts: Vec::new(),
            cores: Vec::new(),
            locked: true,
        };
        fs::create_dir(dead.directory()).unwrap();
        dead.record().unwrap();
        dead.make_channel_directories(&["imu.rates".into()], None).unwrap();
        let segment = dead.domain().directory("imu.rates").join("segment");
        fs::write(&segment, "left").unwrap();
        let cleaned = clean_leftovers();
        assert!(cleaned.contains(&dead.name));
        assert!(!segment.exists() && !dead.directory().exists());
        assert!(living.directory().exists());
        assert_eq!(living.module(), "instance_test");
        assert!(super::living().contains(&living));
        living.clean_up();
        assert!(!living.directory().exists());
    }

    /// Whether the run's record, as whoever starts next reads it, is that of one who lives. Not by [`clean_leftovers`], which would look
    /// at the runs of others too.
    fn is_taken_for_living(instance: &Instance) -> bool {
        trusted_record(&instance.directory(), is_own).unwrap().is_alive()
    }

    #[test]
    fn a_run_whose_process_can_not_be_seen_from_here_lives_as_long_as_its_lock_is_held() {
        let (mut unseen, alive) = Instance::create("instance_unseen", Vec::new()).unwrap();
        // As its own container numbers it: here there is no such process.
        unseen.pid = i32::MAX;
        unseen.set_groups(None, Vec::new()).unwrap();
        assert!(is_taken_for_living(&unseen), "also after its record was written anew");
        drop(alive);
        assert!(!is_taken_for_living(&unseen), "its executive is gone");
        unseen.clean_up();
    }

    #[test]
    fn a_record_stays_as_long_as_a_group_that_it_names_could_not_be_removed() {
        let (mut instance, alive) = Instance::create("instance_stuck", Vec::new()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        // A folder that is not empty goes as little as a group with a process that can not die.
        let stuck = folder.path().join(&instance.name);
        fs::create_dir(&stuck).unwrap();
        fs::write(stuck.join("process"), "").unwrap();
        instance.set_groups(Some(&stuck), Vec::new()).unwrap();
        fs::create_dir(instance.directory().join("ports")).unwrap();
        drop(alive);
        instance.clean_up();
        assert!(trusted_record(&instance.directory(), is_own).is_some(), "the next start finds it");
        assert!(!instance.directory().join("ports").exists());
        fs::remove_dir_all(&stuck).unwrap();
        instance.clean_up();
        assert!(!instance.directory().exists());
    }

    #[test]
    fn a_lock_is_kept_by_no_child_that_the_executive_starts() {
        let (instance, alive) = Instance::create("instance_child", Vec::new()).unwrap();
        let mut child = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        drop(alive);
        let living = is_taken_for_living(&instance);
        child.kill().unwrap();
        child.wait().unwrap();
        instance.clean_up();
        assert!(!living);
    }

    #[test]
    fn a_run_of_an_older_version_without_a_lock_lives_as_long_as_its_process() {
        let (mut older, alive) = Instance::create("instance_older", Vec::new()).unwrap();
        drop(alive);
        older.locked = false;
        older.record().unwrap();
        assert!(is_taken_for_living(&older), "its process is this one");
        older.started_ticks += 1;
        older.record().unwrap();
        assert!(!is_taken_for_living(&older), "another process has its number");
        older.clean_up();
    }

    #[test]
    fn a_name_that_somebody_has_taken_before_keeps_no_module_from_starting() {
        let (first, _one) = Instance::create("instance_taken", Vec::new()).unwrap();
        let (second, _other) = Instance::create("instance_taken", Vec::new()).unwrap();
        let (name, module) = (second.name.clone(), second.module().to_owned());
        assert!(is_taken_for_living(&second));
        first.clean_up();
        second.clean_up();
        assert!(name.starts_with(&format!("{}-", first.name)), "{name}");
        assert_eq!(module, "instance_taken");
    }

    #[test]
    fn a_planted_record_that_names_another_folder_is_not_believed() {
        let victim = tempfile::tempdir_in(SHARED_MEMORY).unwrap();
        let planted = Path::new(SHARED_MEMORY).join(format!("bateleur.planted.{}", std::process::id()));
        let name = victim.path().file_name().unwrap().to_string_lossy().into_owned();
        let (group, accounts, cores) = (None, Vec::new(), Vec::new());
        let instance =
            Instance { name, pid: i32::MAX, started_ticks: 1, group, accounts, cores, locked: true };
        fs::create_dir(&planted).unwrap();
        fs::write(planted.join(RECORD), serde_json::to_vec(&instance).unwrap()).unwrap();
        assert_eq!(trusted_record(&planted, is_own), None);
        clean_leftovers();
        assert!(victim.path().exists());
        fs::remove_dir_all(&planted).unwrap();
    }
}
