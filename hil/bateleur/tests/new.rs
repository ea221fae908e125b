//! What `bateleur new` writes and says.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod support;

use std::fs;
use std::path::Path;
use std::process::Command;

use support::{Ended, assert_golden, bateleur_in, repository};

/// A folder with a schedule file in it, outside of any checkout.
fn folder(schedule: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("schedule.toml"), schedule).unwrap();
    folder
}

/// Two partitions that have everything that a schedule file can say of one.
fn everything() -> String {
    fs::read_to_string(repository().join("hil/bateleur/tests/new/everything.toml")).unwrap()
}

fn new_in(folder: &Path, arguments: &[&str]) -> Ended {
    let mut all = vec!["new"];
    all.extend(arguments);
    bateleur_in(folder, &all)
}

/// As [`new_in`], for a crate that takes its library from here.
fn new_alone(folder: &Path, partition: &str) -> Ended {
    new_in(folder, &[partition, "--library", repository().to_str().unwrap()])
}

/// A text with this machine's folders under names that are the same everywhere.
fn portable(text: &str, folder: &Path) -> String {
    let folder = folder.canonicalize().unwrap();
    let repository = repository();
    text.replace(folder.to_str().unwrap(), "FOLDER").replace(repository.to_str().unwrap(), "CHECKOUT")
}

fn read(folder: &Path, path: &str) -> String {
    fs::read_to_string(folder.join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// Fails unless `cargo fmt` would leave the crate as it is.
fn assert_formatted(folder: &Path) {
    let mut command = Command::new("rustfmt");
    command.args(["--check", "--edition", "2024", "src/main.rs"]).current_dir(folder);
    let output = command.output().expect("rustfmt, which belongs to the tools of Rust");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
}

#[test]
fn the_crate_of_a_partition_with_everything_is_as_it_was() {
    let folder = folder(&everything());
    let ended = new_alone(folder.path(), "talker");
    assert_eq!((ended.code, ended.stderr.as_str()), (0, ""));
    assert_golden("new_talker.txt", &portable(&ended.stdout, folder.path()));
    let talker = folder.path().join("talker");
    assert_golden("new_talker.rs", &read(&talker, "src/main.rs"));
    assert_golden("new_talker_readme.md", &read(&talker, "README.md"));
    assert_golden("new_alone.toml", &portable(&read(&talker, "Cargo.toml"), folder.path()));
    let versions = repository().join("Cargo.lock");
    assert_eq!(
        read(&talker, "Cargo.lock"),
        fs::read_to_string(versions).unwrap(),
        "the versions that are tried"
    );
    assert_formatted(&talker);
}

#[test]
fn names_that_mean_something_else_in_rust_are_turned_into_others() {
    let folder = folder(&everything());
    let ended = new_alone(folder.path(), "match");
    assert_eq!((ended.code, ended.stderr.as_str()), (0, ""));
    let crate_folder = folder.path().join("match");
    assert_golden("new_match.rs", &read(&crate_folder, "src/main.rs"));
    assert!(read(&crate_folder, "Cargo.toml").starts_with("[package]\nname = \"partition-match\"\n"));
    assert_formatted(&crate_folder);
}

#[test]
fn every_partition_of_the_flight_is_laid_out_as_cargo_fmt_would() {
    let folder = folder(&fs::read_to_string(repository().join("schedule.toml")).unwrap());
    let nine = "rate_generator command onboard_computer hil_interface imu gps estimator controller servo";
    for partition in nine.split(' ') {
        let ended = new_alone(folder.path(), partition);
        assert_eq!((ended.code, ended.stderr.as_str()), (0, ""), "{partition}");
        assert_formatted(&folder.path().join(partition));
    }
}

/// The outline of a checkout, with a schedule file in it.
fn checkout() -> tempfile::TempDir {
    let checkout = folder(&everything());
    let make = |path: &str, text: &str| {
        let path = checkout.path().join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    };
    make(
        "Cargo.toml",
        "# Ours.\n[workspace]\nmembers = [\n    \"executive\",\n    \"partitions/apex\", # the library\n    \"tests\",\n]\n",
    );
    make("partitions/apex/Cargo.toml", "[package]\nname = \"bateleur-apex\"\n");
    make("tests/Cargo.toml", "[[bin]]\nname = \"match\"\n");
    checkout
}

#[test]
fn a_crate_in_a_checkout_becomes_a_member_and_the_manifest_stays_as_it_is() {
    let checkout = checkout();
    let ended = new_in(checkout.path(), &["talker"]);
    assert_eq!((ended.code, ended.stderr.as_str()), (0, ""));
    assert_golden("new_inside.txt", &portable(&ended.stdout, checkout.path()));
    let crate_folder = checkout.path().join("partitions/talker");
    assert_golden("new_inside.toml", &read(&crate_folder, "Cargo.toml"));
    assert!(!crate_folder.join("Cargo.lock").exists() && !crate_folder.join("rustfmt.toml").exists());
    assert_eq!(
        read(checkout.path(), "Cargo.toml"),
        "# Ours.\n[workspace]\nmembers = [\n    \"executive\",\n    \"partitions/apex\", # the library\n    \
         \"partitions/talker\",\n    \"tests\",\n]\n"
    );
}

#[test]
fn a_second_program_of_one_name_in_a_checkout_is_refused() {
    let checkout = checkout();
    let ended = new_in(checkout.path(), &["match"]);
    assert_eq!((ended.code, ended.stdout.as_str()), (2, ""));
    assert!(ended.stderr.contains("`tests` builds a program called `match` already"), "{}", ended.stderr);
    assert!(!checkout.path().join("partitions/match").exists());
    assert!(read(checkout.path(), "Cargo.toml").ends_with("    \"tests\",\n]\n"));
}

#[test]
fn nothing_is_written_over_and_nothing_is_written_beside_what_is_there() {
    let folder = folder(&everything());
    fs::create_dir_all(folder.path().join("talker/src")).unwrap();
    fs::write(folder.path().join("talker/src/main.rs"), "mine").unwrap();
    let ended = new_alone(folder.path(), "talker");
    assert_eq!((ended.code, ended.stdout.as_str()), (2, ""));
    assert!(
        ended.stderr.contains("talker has src/main.rs already, and nothing is written over"),
        "{}",
        ended.stderr
    );
    assert!(ended.stderr.contains("name another folder"), "{}", ended.stderr);
    assert_eq!(read(folder.path(), "talker/src/main.rs"), "mine");
    assert!(!folder.path().join("talker/Cargo.toml").exists());
    let library = repository();
    let elsewhere = ["talker", "--dir", "other/talker", "--library", library.to_str().unwrap()];
    assert_eq!(new_in(folder.path(), &elsewhere).code, 0);
    assert!(folder.path().join("other/talker/src/main.rs").is_file());
}

#[test]
fn a_partition_that_is_not_there_is_answered_with_what_to_add_and_added_on_request() {
    let folder = folder(&everything());
    let ended = new_in(folder.path(), &["talkers"]);
    assert_eq!((ended.code, ended.stdout.as_str()), (1, ""));
    assert_golden("new_missing.txt", &ended.stderr);
    assert_eq!(read(folder.path(), "schedule.toml"), everything(), "nothing was added");
    let ended = new_in(folder.path(), &["third", "--add", "--window", "1ms"]);
    assert_eq!((ended.code, ended.stderr.as_str()), (0, ""));
    assert_golden("new_added.txt", &ended.stdout);
    let text = read(folder.path(), "schedule.toml");
    assert!(
        text.starts_with(everything().split("]\n\n[partition.talker]").next().unwrap()),
        "the rest stays:\n{text}"
    );
    assert_eq!(bateleur_in(folder.path(), &["check", "--deny", "warnings"]).code, 0);
    // It needs no ports to run.
    assert_eq!(new_alone(folder.path(), "third").code, 0);
    assert_golden("new_third.rs", &read(folder.path(), "third/src/main.rs"));
    assert_formatted(&folder.path().join("third"));
    let again = new_in(folder.path(), &["third", "--add"]);
    assert!(again.code == 2 && again.stderr.contains("has a partition `third` already"), "{}", again.stderr);
}

#[test]
fn what_can_not_be_added_is_said_and_the_file_stays() {
    let several = everything().replace("[module.test]", "[module.other]\ncores = [2]\n\n[module.test]");
    for (schedule, arguments, words) in [
        (
            everything(),
            vec!["third", "--add", "--window", "19ms"],
            "no hole of the first core of `test` has room for 19ms",
        ),
        (everything(), vec!["third", "--add", "--window", "0s"], "a window has a length"),
        (everything(), vec!["third", "--add", "--window", "5"], "it has no unit: write a time such as 500us"),
        (everything(), vec!["a b", "--add"], "`a b` can not be a partition"),
        (
            everything(),
            vec!["third", "--add", "--module", "fcu"],
            "there is no module `fcu`: the file has test",
        ),
        (
            several,
            vec!["third", "--add"],
            "the file has the modules other, test: say which with --module NAME",
        ),
    ] {
        let folder = folder(&schedule);
        let ended = new_in(folder.path(), &arguments);
        assert_eq!(ended.code, 2, "{arguments:?}: {}", ended.stderr);
        assert!(ended.stderr.contains(words), "{arguments:?}: {}", ended.stderr);
        assert_eq!(read(folder.path(), "schedule.toml"), schedule);
    }
}

#[test]
fn a_channel_that_names_the_partition_too_early_is_answered_with_what_to_do() {
    let named = everything().replacen("destinations = [", "destinations = [\"third.rate\", ", 1);
    let folder = folder(&named);
    let ended = new_in(folder.path(), &["third", "--add"]);
    assert_eq!((ended.code, ended.stdout.as_str()), (2, ""), "{}", ended.stderr);
    let words = "nothing was added: take what names a port of `third` out, run `bateleur new third --add`";
    assert!(ended.stderr.contains(words), "{}", ended.stderr);
    assert_eq!(read(folder.path(), "schedule.toml"), named);
    let ended = new_in(folder.path(), &["talker"]);
    assert!(
        ended.code == 2 && ended.stderr.contains("nothing was written: mend that first"),
        "{}",
        ended.stderr
    );
}

#[test]
fn what_no_crate_can_be_made_of_is_refused_with_a_way_to_mend_it() {
    for (old, new, words) in [
        (
            "message = \"Rate\"",
            "message = \"Ratio\"",
            "A type of your own is a file beside the schedule file, `messages/Ratio.msg`",
        ),
        ("program = \"talker\"", "program = \"build\"", "cargo keeps the name `build`"),
        (
            "program = \"talker\"",
            "program = \"my talker\"",
            "write `program = \"talker\"` in [partition.talker]",
        ),
        ("program = \"talker\"", "program = \"bin/\"", "cargo builds no program called ``"),
    ] {
        let folder = folder(&everything().replace(old, new));
        let ended = new_alone(folder.path(), "talker");
        assert_eq!((ended.code, ended.stdout.as_str()), (2, ""), "{new}");
        assert!(ended.stderr.contains(words), "{new}: {}", ended.stderr);
        assert!(!folder.path().join("talker").exists());
    }
    let folder = folder(&everything());
    let ended = new_in(folder.path(), &["talker", "--library", "."]);
    assert!(ended.code == 2 && ended.stderr.contains("is no checkout of Bateleur"), "{}", ended.stderr);
}

#[test]
fn retained_memory_that_is_too_small_and_a_shared_program_are_noted() {
    let schedule =
        everything().replace("\"4KiB\"", "\"100B\"").replace("program = \"match\"", "program = \"talker\"");
    let folder = folder(&schedule);
    let ended = new_alone(folder.path(), "talker");
    assert_eq!(ended.code, 0, "{}", ended.stderr);
    for words in [
        "`retained` is 100 bytes, and even the smallest value takes 160",
        "partition `match` runs `talker` too",
    ] {
        assert!(ended.stdout.contains(words), "{words}: {}", ended.stdout);
    }
}

#[test]
fn the_crate_of_a_partition_with_replicas_is_theirs_whichever_of_them_is_named() {
    let folder = folder(&fs::read_to_string(repository().join("schedules/replicas.toml")).unwrap());
    let mut mains = Vec::new();
    for name in ["controller", "controller_1", "controller_3"] {
        let ended =
            new_in(folder.path(), &[name, "--dir", name, "--library", repository().to_str().unwrap()]);
        assert_eq!((ended.code, ended.stderr.as_str()), (0, ""), "{name}");
        // What the voter runs is the executive's own program, and that replicas share one is what they are for.
        let words = format!("program = \"{name}/target/release/controller\" in [partition.controller]");
        assert!(ended.stdout.contains(&words), "{}", ended.stdout);
        assert!(!ended.stdout.contains("too, with this code"), "{}", ended.stdout);
        assert_formatted(&folder.path().join(name));
        mains.push(read(folder.path(), &format!("{name}/src/main.rs")));
    }
    assert!(mains[0].contains("struct Controller {") && mains.iter().all(|main| *main == mains[0]));
}
