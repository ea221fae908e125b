//! Crates that `bateleur new` writes are built, tested and run as they are: in a checkout and outside of any; and so is the
//! program of the page about it.

use std::fs;
use std::path::{Path, PathBuf};

use bateleur_recording::{Ending, read};
use bateleur_tests::{among_others, bateleur, cargo, copy, crates_target, empty_folder, repository};

const BOTH: [&str; 2] = ["talker", "match"];

/// The schedule file of two partitions with everything, whose programs are those built here.
fn schedule(folder: &Path) -> String {
    let mut text = fs::read_to_string(repository().join("hil/bateleur/tests/new/everything.toml")).unwrap();
    for name in BOTH {
        let built = crates_target().join("release").join(name);
        text = text.replace(&format!("program = \"{name}\""), &format!("program = \"{}\"", built.display()));
    }
    let path = folder.join("schedule.toml");
    fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

/// Both run, hear each other, keep what is to be kept, and one is taken over from.
fn assert_runs(schedule: &str) {
    let run = ["run", "--fast", "--schedule", schedule, "--until", "2", "--record", "--kill", "talker@1"];
    let ended = bateleur(&run).end().expect_code(0);
    let windows = ended.windows();
    for name in BOTH {
        let closed = windows.iter().filter(|window| window.partition == name && window.closed_ns.is_some());
        assert_eq!(closed.count(), 100, "{name}");
    }
    let faults: Vec<(String, String)> =
        ended.faults().into_iter().map(|fault| (fault.partition, fault.action)).collect();
    assert_eq!(faults, [("talker".to_owned(), "takeover".to_owned())]);
    for words in
        ["0 windows before this one, a_rather", "gain = 3.14", "50 windows before this one", "match: runs"]
    {
        assert!(ended.stderr.contains(words), "{words}:\n{}", ended.stderr);
    }
    let log = read(ended.folder().join("ports.mcap"), |_| false).unwrap();
    assert_eq!(log.ending, Ending::Complete);
    let count = |topic: &str| log.counts.get(topic).copied().unwrap_or(0);
    assert_eq!((count("/talker/state"), count("/match/self")), (100, 100));
    // In one of fifty windows of each incarnation. What plain bytes mean nobody knows: they are in no log.
    assert_eq!(count("/talker/telemetry"), 2);
}

#[test]
fn new_partitions_outside_of_a_checkout_pass_their_lints_and_tests_and_run() {
    let _turn = among_others();
    let folder = empty_folder("alone");
    let schedule = schedule(&folder);
    let library = repository();
    for name in BOTH {
        let dir = folder.join(name);
        let (dir, library) = (dir.to_str().unwrap(), library.to_str().unwrap());
        let new = ["new", name, "--schedule", &schedule, "--dir", dir, "--library", library];
        bateleur(&new).end().expect_code(0);
        let own = Path::new(dir);
        cargo(own, &["clippy", "--offline", "--release", "--all-targets", "--", "-D", "warnings"]);
        cargo(own, &["test", "--offline", "--release"]);
        cargo(own, &["build", "--offline", "--release"]);
    }
    assert_runs(&schedule);
    fs::remove_dir_all(folder).unwrap();
}

/// A copy of the checkout, without what was made in it before.
fn checkout(name: &str, made: &[&str]) -> PathBuf {
    let copied = crates_target().join(name);
    for name in made {
        let _ = fs::remove_dir_all(copied.join("partitions").join(name));
    }
    fs::create_dir_all(&copied).unwrap();
    for entry in fs::read_dir(repository()).unwrap() {
        let name = entry.unwrap().file_name();
        if !["target", "docs"].iter().any(|left_out| name == *left_out)
            && !name.to_string_lossy().starts_with('.')
        {
            copy(&repository().join(&name), &copied.join(&name));
        }
    }
    copied
}

#[test]
fn new_partitions_in_a_checkout_are_members_of_it_and_run() {
    let _turn = among_others();
    let checkout = checkout("checkout", &BOTH);
    let schedule = schedule(&checkout);
    for name in BOTH {
        bateleur(&["new", name, "--schedule", &schedule]).end().expect_code(0);
        cargo(&checkout, &["test", "--offline", "--release", "-p", &format!("bateleur-{name}")]);
        cargo(&checkout, &["build", "--offline", "--release", "-p", &format!("bateleur-{name}")]);
    }
    assert_runs(&schedule);
}

/// The blocks of a page that are fenced as `fence` and hold `words`: exactly one.
fn block<'p>(page: &'p str, fence: &str, words: &str) -> &'p str {
    let blocks = page.split("\n```").filter_map(|block| block.strip_prefix(fence)?.strip_prefix('\n'));
    let found: Vec<&str> = blocks.filter(|block| block.contains(words)).collect();
    assert_eq!(found.len(), 1, "{words}: {found:?}");
    found[0]
}

#[test]
fn program_of_the_page_is_what_can_be_made_of_a_new_partition_and_does_what_the_page_says() {
    let _turn = among_others();
    let page = fs::read_to_string(repository().join("docs/src/new-partition.md")).unwrap();
    let checkout = checkout("page", &["height_watch"]);
    let change = |path: &str, change: &dyn Fn(&str) -> String| {
        let path = checkout.join(path);
        let text = fs::read_to_string(&path).unwrap();
        fs::write(&path, change(&text)).unwrap();
    };
    // Another version: the two copies are built in one folder, where their packages have to be told apart.
    change("Cargo.toml", &|text| {
        assert!(text.contains("\nversion = \"0.1.0\"\n"), "another version: correct this test");
        text.replace("version = \"0.1.0\"", "version = \"0.1.0-page\"")
    });
    // 1. The schedule file.
    let schedule = checkout.join("schedule.toml").to_str().unwrap().to_owned();
    bateleur(&["new", "height_watch", "--add", "--schedule", &schedule]).end().expect_code(0);
    change("schedule.toml", &|text| {
        let (rest, _) = text.split_once("[partition.height_watch]").unwrap();
        rest.to_owned() + block(&page, "toml", "program    = \"height_watch\"")
    });
    bateleur(&["new", "height_watch", "--schedule", &schedule]).end().expect_code(0);
    // 3. The message type.
    let message = block(&page, "text", "What HeightWatch says");
    fs::create_dir_all(checkout.join("messages")).unwrap();
    fs::write(checkout.join("messages/HeightWarning.msg"), message.to_owned() + "\n").unwrap();
    // 4. What is filled in, and its test.
    let program = block(&page, "rust,ignore", "impl Partition for HeightWatch");
    let test = block(&page, "rust,ignore", "Harness::new").replace('\n', "\n        ");
    let main = format!(
        "{program}\n\n#[cfg(test)]\nmod tests {{\n    use bateleur_apex::Harness;\n\n    use super::*;\n\n    #[test]\n    \
         fn warns() -> Result<(), StartError> {{\n        {test}\n        Ok(())\n    }}\n}}\n"
    );
    fs::write(checkout.join("partitions/height_watch/src/main.rs"), main).unwrap();
    let package = "bateleur-height-watch";
    cargo(&checkout, &["fmt", "--check", "--package", package]);
    cargo(
        &checkout,
        &["clippy", "--offline", "--release", "-p", package, "--all-targets", "--", "-D", "warnings"],
    );
    cargo(&checkout, &["test", "--offline", "--release", "-p", package]);
}
