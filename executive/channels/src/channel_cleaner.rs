//! Removes everything that a dead process left in the channels that it was attached to, at whatever instant it was killed.
//!
//! The library's own clean-up does most of it, but a process killed between two of its file operations leaves things
//! that the clean-up waits for without end, or does not see: those are dealt with before and after. The owner of a
//! file can be read from its name: the ids in it hold the process number in bits 64 to 95.
//!
//! The channel cleaner is a process of its own, ended by the executive if it takes too long. What a partition has written over can
//! end it too: it says which channel it is at, and another one goes on, which removes files by their names alone there.

use std::io::Write;

use bateleur_host::helper::begin;
use bateleur_host::helper::orders::{BAD, Cleaning, Dead};
use bateleur_ports::{ChannelError, Domain, PREFIX};
use bateleur_system::tree::{Entry, Folder, NotRemoved};

/// Ids in file names have more digits than any 64-bit number.
const ID_DIGITS: usize = 20;
/// The mode of an object that is created but not yet sized.
const HALF_MADE_MODE: u32 = 0o200;
/// Folders of the library in a channel's directory.
const NODES: &std::ffi::CStr = c"nodes";
const SERVICES: &std::ffi::CStr = c"services";
/// A channel's own table: it outlives the process that made it.
const TABLE: &str = ".dynamic";
/// Folders within each other that the library makes, the channel's directory counted.
const LEVELS: u32 = 3;

/// Why a channel could not be cleared.
#[derive(Debug, thiserror::Error)]
enum Uncleared {
    /// Its directory can not be entered, or is none.
    #[error("its directory can not be read: {0}")]
    Closed(#[from] std::io::Error),
    /// The library.
    #[error(transparent)]
    Library(#[from] ChannelError),
    /// Something in it stays.
    #[error(transparent)]
    NotRemoved(#[from] NotRemoved),
}

/// Cleans up after a process, which must have been reaped, before its successor is started. Says on standard output at which channel
/// it is, and which it could not clear; the others are cleared all the same.
///
/// # Errors
/// The order is damaged.
pub fn run(order: &str) -> Result<(), serde_json::Error> {
    begin(c"channel-cleaner");
    clean(&serde_json::from_str(order)?);
    Ok(())
}

fn clean(order: &Cleaning) {
    let domain = &Domain { root: order.root.clone() };
    let dead = order.dead;
    for channel in &order.channels {
        let cleared = match order.damaged.contains(channel) {
            true => Folder::open(&domain.directory(channel))
                .map_err(Uncleared::from)
                .and_then(|folder| Ok(remove_remains(&folder, dead)?)),
            false => {
                say(channel); // its memory may end this process
                clear(domain, channel, dead)
            }
        };
        if let Err(error) = cleared {
            eprintln!("channel-cleaner: {channel}: {error}");
            say(&format!("{} {channel}", BAD));
        }
    }
}

fn say(line: &str) {
    let _ = writeln!(std::io::stdout(), "{line}"); // an executive that is gone needs no word
}

fn clear(domain: &Domain, channel: &str, dead: Dead) -> Result<(), Uncleared> {
    let folder = Folder::open(&domain.directory(channel))?;
    remove_half_made(&folder, dead.pid)?;
    unseal_hidden_tags(&folder, dead.pid)?;
    let cleared = domain.clear_dead(channel).map(|_left| ()); // what is left is removed below
    remove_remains(&folder, dead)?;
    Ok(cleared?)
}

/// An object without a size would make whoever opens it wait for its size.
fn remove_half_made(folder: &Folder, pid: u32) -> Result<(), Uncleared> {
    for entry in
        folder.entries()?.iter().filter(|entry| entry.text().starts_with(PREFIX) && names(entry, pid))
    {
        if entry.about.st_size == 0 || entry.about.st_mode & 0o777 == HALF_MADE_MODE {
            folder.remove(&entry.name)?;
        }
    }
    Ok(())
}

/// A tag that was not yet made readable is not listed, and the clean-up would then give up half way.
fn unseal_hidden_tags(folder: &Folder, pid: u32) -> std::io::Result<()> {
    let Ok(nodes) = folder.inner(NODES) else { return Ok(()) }; // none was made yet
    for node in nodes.entries()?.iter().filter(|node| node.is_folder() && names(node, pid)) {
        let node = nodes.inner(&node.name)?;
        for tag in node.entries()?.iter().filter(|tag| tag.text().starts_with(PREFIX) && !tag.is_folder()) {
            node.set_mode(&tag.name, 0o400)?;
        }
    }
    Ok(())
}

fn remove_remains(folder: &Folder, dead: Dead) -> Result<(), NotRemoved> {
    match dead.user {
        Some(user) => remove_all_of(folder, user, LEVELS),
        None => remove_by_name(folder, dead.pid),
    }
}

/// Removes what is the dead user's own, whatever is in it.
fn remove_all_of(folder: &Folder, user: u32, levels: u32) -> Result<(), NotRemoved> {
    let mut result = Ok(());
    for entry in folder.entries().map_err(|why| folder.not_removed(why))? {
        let removed = match entry.about.st_uid == user {
            true => folder.remove(&entry.name),
            // What is somebody else's was not made by the dead one; it can have made something in it.
            false if entry.is_folder() && levels > 1 => match folder.inner(&entry.name) {
                Ok(inner) => remove_all_of(&inner, user, levels - 1),
                Err(_) => Ok(()), // closed to the dead one too
            },
            false => Ok(()),
        };
        result = result.and(removed);
    }
    result
}

/// Removes what carries the dead one's number, and what the library gives to nobody.
fn remove_by_name(folder: &Folder, pid: u32) -> Result<(), NotRemoved> {
    let listed = |folder: &Folder| folder.entries().map_err(|why| folder.not_removed(why));
    let mut result = Ok(());
    for entry in listed(folder)? {
        let text = entry.text();
        let known = text.starts_with(PREFIX) || [NODES, SERVICES].contains(&entry.name.as_c_str());
        if !known || (names(&entry, pid) && !text.ends_with(TABLE)) {
            result = result.and(folder.remove(&entry.name));
        }
    }
    if let Ok(nodes) = folder.inner(NODES) {
        for entry in listed(&nodes)? {
            let text = entry.text();
            let known = text.starts_with(PREFIX) || text.bytes().all(|byte| byte.is_ascii_digit());
            if !known || names(&entry, pid) {
                result = result.and(nodes.remove(&entry.name));
            }
        }
    }
    result
}

fn names(entry: &Entry, pid: u32) -> bool {
    owners(&entry.text()).any(|owner| owner == pid)
}

/// The processes whose ids stand in a file's name: one for a port, two for a connection.
fn owners(name: &str) -> impl Iterator<Item = u32> {
    let numbers = name.split(|c: char| !c.is_ascii_digit()).filter(|digits| digits.len() >= ID_DIGITS);
    numbers.filter_map(|digits| digits.parse::<u128>().ok()).map(|id| (id >> 64) as u32) // bits 64 to 95
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    /// Cleans up after process 1234 of `user` in the damaged channel `a.b`.
    fn clean_after(domain: &Domain, user: Option<u32>) {
        let channels = vec!["a.b".to_owned()];
        let dead = Dead { pid: 1_234, user };
        clean(&Cleaning { root: domain.root.clone(), dead, damaged: channels.clone(), channels });
    }

    #[test]
    fn a_damaged_channel_loses_the_dead_ones_files_by_their_names_and_no_others() {
        let root = tempfile::tempdir().unwrap();
        let domain = Domain { root: root.path().to_str().unwrap().into() };
        let directory = domain.directory("a.b");
        let [dead, alive] = [1_234_u128, 1_235].map(|pid| (pid << 64) | 77);
        let port = |id: u128| directory.join(format!("bateleur_{id}.connection"));
        let node = |id: u128| directory.join("nodes").join(id.to_string());
        for id in [dead, alive] {
            fs::create_dir_all(node(id)).unwrap();
            fs::write(node(id).join("bateleur_node.details"), "damaged").unwrap();
            fs::write(port(id), "damaged").unwrap();
        }
        clean_after(&domain, None);
        assert_eq!([port(dead), node(dead)].map(|path| path.exists()), [false, false]);
        assert_eq!([port(alive), node(alive)].map(|path| path.exists()), [true, true]);
    }

    /// A channel's directory with what a living and a dead one have in it, and with what the dead one has thrown in.
    fn littered() -> (tempfile::TempDir, Domain, std::path::PathBuf) {
        let root = tempfile::tempdir_in("/dev/shm").unwrap();
        let domain = Domain { root: root.path().to_str().unwrap().into() };
        let directory = domain.directory("a.b");
        let alive = 1_235_u128 << 64 | 77;
        fs::create_dir_all(directory.join(format!("nodes/{alive}"))).unwrap();
        fs::create_dir(directory.join("services")).unwrap();
        for kept in [format!("bateleur_ab_{alive}.data"), format!("nodes/bateleur_{alive}.node_monitor")] {
            fs::write(directory.join(kept), "").unwrap();
        }
        fs::create_dir_all(directory.join("litter/deeper")).unwrap();
        fs::create_dir_all(directory.join("nodes/litter")).unwrap();
        for number in 0..300 {
            fs::write(directory.join(format!("litter/{number}")), "").unwrap();
            fs::write(directory.join(format!("litter-{number}")), "").unwrap();
        }
        (root, domain, directory)
    }

    /// Everything below a directory, as paths from there.
    fn listed(directory: &std::path::Path) -> Vec<String> {
        let mut all = Vec::new();
        let mut folders = vec![directory.to_owned()];
        while let Some(folder) = folders.pop() {
            for path in fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()) {
                all.push(path.strip_prefix(directory).unwrap().display().to_string());
                if path.is_dir() {
                    folders.push(path);
                }
            }
        }
        all.sort();
        all
    }

    #[test]
    fn what_no_living_process_can_own_is_removed_with_the_dead_one() {
        let (_root, domain, directory) = littered();
        let table = format!("bateleur_ab_{}.dynamic", 1_234_u128 << 64 | 5);
        fs::write(directory.join(&table), "").unwrap();
        clean_after(&domain, None);
        let left = listed(&directory);
        assert_eq!(left.len(), 6, "{left:?}");
        assert!(left.contains(&table), "the channel's own table stays: {left:?}");
    }

    #[test]
    fn everything_of_a_dead_user_is_removed_wherever_it_lies_and_nothing_of_others() {
        if !rustix::process::geteuid().is_root() {
            return eprintln!("skipped: needs root to have two users");
        }
        let (_root, domain, directory) = littered();
        let before = listed(&directory);
        let user = 61_777;
        let give = |path: &std::path::Path| std::os::unix::fs::chown(path, Some(user), Some(user)).unwrap();
        // Named like the library's, deep, in folders of others; the folders closed.
        for path in ["bateleur_1", "services/bateleur_2", "nodes/bateleur_3", "nodes/9/bateleur_4"] {
            fs::create_dir_all(directory.join(path).parent().unwrap()).unwrap();
            fs::write(directory.join(path), "").unwrap();
            give(&directory.join(path));
        }
        for path in ["closed", "nodes/closed"] {
            fs::create_dir_all(directory.join(path).join("x/y/z")).unwrap();
            give(&directory.join(path));
            fs::set_permissions(directory.join(path), std::os::unix::fs::PermissionsExt::from_mode(0o0))
                .unwrap();
        }
        clean_after(&domain, Some(user));
        let left: Vec<_> = listed(&directory).into_iter().filter(|path| !before.contains(path)).collect();
        assert_eq!(left, ["nodes/9"], "made by another user");
        assert!(before.iter().all(|path| directory.join(path).exists()), "of others nothing is missing");
    }

    #[test]
    fn the_owners_are_read_from_a_file_name() {
        let id: u128 = (1_234 << 64) | 77;
        assert_eq!(
            owners(&format!("bateleur_{id}_{}.connection", id + (1 << 64))).collect::<Vec<_>>(),
            [1_234, 1_235]
        );
        assert_eq!(owners("bateleur_global_mgmt").count(), 0);
    }
}
