//! A project of one's own, as `bateleur init` makes it and as it lies in `examples`: it is built, tested and flown outside of this
//! workspace, a partition is added to it, and what its crates link can be packaged.

use std::fs;
use std::path::{Path, PathBuf};

use bateleur_tests::{
    Sketch, among_others, bateleur, building, cargo, channel_between, copy, crates_target, empty_folder,
    expect_success, program, repository,
};

/// The example, from the root of the repository.
const EXAMPLE: &str = "examples/tank";
/// What a partition of another project links.
const LINKED: [&str; 7] =
    ["apex", "contract", "message-format", "message-macro", "messages", "ports", "processes"];

/// The files below a folder, by their paths in it; without `target`.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut open = vec![folder.to_owned()];
    while let Some(next) = open.pop() {
        for entry in fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            match path.is_dir() {
                true if path.ends_with("target") => {}
                true => open.push(path),
                false => found.push(path.strip_prefix(folder).unwrap().to_owned()),
            }
        }
    }
    found.sort();
    found
}

/// The way to this repository from the example, and from anywhere else.
fn as_from_anywhere(text: &str) -> String {
    text.replace("\"../../", &format!("\"{}/", repository().display()))
}

/// A text whose paths out of `folder` are whole ones: how long the relative ones are depends on where this repository lies.
fn resolved(folder: &Path, text: &str) -> String {
    let mut pieces = text.split("path = \"");
    let mut whole = pieces.next().unwrap_or_default().to_owned();
    for piece in pieces {
        let (path, rest) = piece.split_once('"').unwrap();
        let found = fs::canonicalize(folder.join(path))
            .map_or_else(|_| path.into(), |path| path.display().to_string());
        whole.push_str(&format!("path = \"{found}\"{rest}"));
    }
    whole
}

#[test]
fn example_is_what_init_makes() {
    let made = empty_folder("tank");
    fs::remove_dir(&made).unwrap();
    let library = repository();
    let init = ["init", made.to_str().unwrap(), "--library", library.to_str().unwrap()];
    bateleur(&init).end().expect_code(0);
    let example = repository().join(EXAMPLE);
    let names = |folder: &Path| -> Vec<PathBuf> {
        files(folder).into_iter().filter(|path| path != Path::new("Cargo.lock")).collect()
    };
    assert_eq!(names(&example), names(&made));
    for name in names(&made) {
        let [ours, theirs] = [&example, &made].map(|folder| fs::read_to_string(folder.join(&name)).unwrap());
        let [ours, theirs] =
            [(&example, ours), (&made, theirs)].map(|(folder, text)| resolved(folder, &text));
        assert_eq!(ours, theirs, "{}: `bateleur init {EXAMPLE}`", name.display());
    }
    // The second time nothing is written over.
    bateleur(&init).end().expect_code(2).expect_words(&["nothing is written over"]);
    fs::remove_dir_all(made).unwrap();
}

/// A copy of the example where it is no part of this repository, with what it is built into beside the other crates.
fn project(name: &str) -> PathBuf {
    let copied = crates_target().join(name);
    let _ = fs::remove_file(copied.join("schedule.toml"));
    let _ = fs::remove_dir_all(copied.join("partitions/height"));
    copy(&repository().join(EXAMPLE), &copied);
    let manifest = copied.join("Cargo.toml");
    fs::write(&manifest, as_from_anywhere(&fs::read_to_string(&manifest).unwrap())).unwrap();
    fs::copy(repository().join("Cargo.lock"), copied.join("Cargo.lock")).unwrap();
    let _ = std::os::unix::fs::symlink(crates_target(), copied.join("target")); // it is there
    copied
}

#[test]
fn example_passes_its_own_script_and_takes_a_partition_more() {
    let _turn = among_others();
    let project = project("tank");
    let path = std::env::var("PATH").unwrap_or_default();
    let programs = program("bateleur").parent().unwrap().display().to_string();
    expect_success(building("./ci", &project).env("PATH", format!("{programs}:{path}")));
    let schedule = project.join("schedule.toml").display().to_string();
    // One more, which reads a type of the project.
    bateleur(&["new", "height", "--add", "--schedule", &schedule]).end().expect_code(0);
    let text = fs::read_to_string(&schedule).unwrap();
    let text = text
        .replace("destinations = [\"watch.level\"]", "destinations = [\"watch.level\", \"height.level\"]");
    let (text, _) = text.split_once("# What it reads").unwrap();
    let port = "level = { direction = \"destination\", kind = \"sampling\", message = \"Level\", refresh = \"40ms\" }\n";
    fs::write(&schedule, text.to_owned() + port).unwrap();
    let new = bateleur(&["new", "height", "--schedule", &schedule]).end().expect_code(0);
    assert!(new.stdout.contains("`\"partitions/height\",` is now among its members"), "{}", new.stdout);
    assert!(!new.stdout.contains("name it:"), "the schedule file names what cargo builds: {}", new.stdout);
    cargo(&project, &["fmt", "--check"]);
    cargo(&project, &["clippy", "--release", "-p", "height", "--all-targets", "--", "-D", "warnings"]);
    cargo(&project, &["test", "--release", "-p", "height"]);
    cargo(&project, &["build", "--release", "-p", "height"]);
    let run = bateleur(&["run", "--fast", "--schedule", &schedule, "--until", "3"]).end().expect_code(0);
    run.expect_words(&["3 partitions are ready", "height: runs", "watch: opens the inlet"]);
}

#[test]
fn crates_that_a_partition_links_can_be_packaged() {
    let _turn = among_others();
    let target = crates_target();
    let mut command = building(&std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned()), &repository());
    command.args(["package", "--offline", "--no-verify", "--allow-dirty", "--target-dir"]).arg(&target);
    for name in LINKED {
        command.arg("-p").arg(format!("bateleur-{name}"));
    }
    expect_success(&mut command);
    for name in LINKED {
        let manifest = repository().join("partitions").join(name.replace('-', "_")).join("Cargo.toml");
        let text = fs::read_to_string(manifest).unwrap();
        for key in ["description = ", "license.workspace = true", "readme = "] {
            assert!(text.contains(key), "{name} has no {key:?}");
        }
    }
}

#[test]
fn hundred_ports_of_a_hundred_types_are_planned_started_and_recorded() {
    const TYPES: usize = 100;
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("messages")).unwrap();
    let (mut sources, mut destinations, mut sketch) = (String::new(), String::new(), Sketch::new());
    for number in 0..TYPES {
        let text = format!("uint64 of_{number}\nfloat64[{}] values # [m]\n", number + 1);
        fs::write(folder.path().join(format!("messages/Type{number}.msg")), text).unwrap();
        let port = format!("kind = \"sampling\", message = \"Type{number}\"");
        sources += &format!("port{number} = {{ direction = \"source\", {port} }}\n");
        destinations +=
            &format!("port{number} = {{ direction = \"destination\", {port}, refresh = \"1s\" }}\n");
        let name = format!("port{number}");
        sketch = sketch.table(&channel_between(&format!("from.{name}"), &format!("to.{name}")));
    }
    let schedule = sketch
        .partition("from", "untyped", 1000, &format!("[partition.from.port]\n{sources}"))
        .partition("to", "untyped", 1000, &format!("[partition.to.port]\n{destinations}"))
        .write(folder.path());
    let run = ["run", "--fast", "--schedule", &schedule, "--until", "1", "--record"];
    let ended = bateleur(&run).end().expect_code(0).expect_words(&["2 partitions are ready"]);
    let log = bateleur_recording::read(ended.folder().join("ports.mcap"), |_| true).unwrap();
    for number in 0..TYPES {
        let track = log.track(&format!("/from/port{number}"), &format!("Type{number}"));
        assert!(track.is_some_and(|track| track.samples.len() >= 49), "Type{number}");
    }
}
