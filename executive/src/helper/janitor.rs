//! Removes everything that a dead process left in the channels that it was attached to, at whatever instant it was killed.
//!
//! The library's own clean-up does most of it, but a process killed between two of its file operations leaves things
//! that the clean-up waits for without end, or does not see: those are dealt with before and after. The owner of a
//! file can be read from its name: the ids in it hold the process number in bits 64 to 95.
//!
//! The janitor is a process of its own, ended by the executive if it takes too long. What a partition has written over can
//! end it too: it says which channel it is at, and another one goes on, which removes files by their names alone there.

use std::fs::{self, DirEntry};
use std::io::Write;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::Path;

use bateleur_ports::{ChannelError, Domain, PREFIX};

/// Ids in file names have more digits than any 64-bit number.
const ID_DIGITS: usize = 20;
/// The mode of an object that is created but not yet sized.
const HALF_MADE_MODE: u32 = 0o200;

/// Buries process `pid`, which must have been reaped, before its successor is started. `channels`: the directories of
/// those that it was attached to. `damaged`: those among them whose memory must not be looked at.
///
/// # Errors
/// The last channel that could not be looked through; the others are cleared all the same.
pub fn run(domain: &Domain, pid: u32, channels: &[String], damaged: &[String]) -> Result<(), ChannelError> {
    super::custodian::name_process(c"janitor");
    let mut result = Ok(());
    for channel in channels {
        if damaged.contains(channel) {
            remove_remains(&domain.directory(channel), pid);
            continue;
        }
        let _ = writeln!(std::io::stdout(), "{channel}"); // an executive that is gone needs no word
        if let Err(error) = clear(domain, channel, pid) {
            result = Err(error);
        }
    }
    result
}

fn clear(domain: &Domain, channel: &str, pid: u32) -> Result<(), ChannelError> {
    let directory = domain.directory(channel);
    remove_half_made(&directory, pid);
    unseal_hidden_tags(&directory, pid);
    let cleared = domain.clear_dead(channel).map(|_left| ()); // what is left is removed by name below
    remove_remains(&directory, pid);
    cleared
}

/// An object without a size would make whoever opens it wait for its size.
fn remove_half_made(directory: &Path, pid: u32) {
    for entry in entries(directory, PREFIX).filter(|entry| is_owned(entry, pid)) {
        if entry.metadata().is_ok_and(|about| about.size() == 0 || about.mode() & 0o777 == HALF_MADE_MODE) {
            let _ = fs::remove_file(entry.path()); // a live peer removed it meanwhile
        }
    }
}

/// A tag that was not yet made readable is not listed, and the clean-up would then give up half way.
fn unseal_hidden_tags(directory: &Path, pid: u32) {
    let nodes = entries(&directory.join("nodes"), "").filter(|entry| is_owned(entry, pid));
    for tag in nodes.flat_map(|node| entries(&node.path(), PREFIX)) {
        let _ = fs::set_permissions(tag.path(), fs::Permissions::from_mode(0o400)); // as above
    }
}

fn remove_remains(directory: &Path, pid: u32) {
    let all = entries(&directory.join("nodes"), "").chain(entries(directory, PREFIX));
    for entry in all.filter(|entry| is_owned(entry, pid)) {
        let path = entry.path();
        let _ = if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) }; // as above
    }
}

fn entries(place: &Path, prefix: &str) -> impl Iterator<Item = DirEntry> + use<> {
    let prefix = prefix.to_owned();
    let all: Vec<_> = fs::read_dir(place).into_iter().flatten().flatten().collect();
    all.into_iter().filter(move |entry| entry.file_name().to_string_lossy().starts_with(&prefix))
}

fn is_owned(entry: &DirEntry, pid: u32) -> bool {
    owners(&entry.file_name().to_string_lossy()).any(|owner| owner == pid)
}

/// The processes whose ids stand in a file's name: one for a port, two for a connection.
fn owners(name: &str) -> impl Iterator<Item = u32> {
    let numbers = name.split(|c: char| !c.is_ascii_digit()).filter(|digits| digits.len() >= ID_DIGITS);
    numbers.filter_map(|digits| digits.parse::<u128>().ok()).map(|id| (id >> 64) as u32) // bits 64 to 95
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let channels = ["a.b".to_owned()];
        run(&domain, 1_234, &channels, &channels).unwrap();
        assert_eq!([port(dead), node(dead)].map(|path| path.exists()), [false, false]);
        assert_eq!([port(alive), node(alive)].map(|path| path.exists()), [true, true]);
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
