//! A module of an ordinary user: its partitions are kept apart by user namespaces where the kernel allows them.

use std::path::Path;

use bateleur_tests::{Ended, ORDINARY, Sketch, among_others, bateleur, bateleur_as_ordinary};

fn sketch(attempt: &str, target: &str) -> Sketch {
    let port = "kind = \"sampling\", message = \"FunctionStatus\"";
    let attributes = format!("attributes = {{ attempt = \"{attempt}\", target = \"path:{target}\" }}");
    Sketch::new()
        .table("[[channel]]\nsource = \"middle.own\"\ndestinations = [\"ear.heard\"]")
        .partition(
            "middle",
            "hostile",
            3000,
            &format!("{attributes}\n[partition.middle.port]\nown = {{ direction = \"source\", {port} }}"),
        )
        .partition(
            "ear",
            "counter",
            1000,
            &format!(
                "[partition.ear.port]\nheard = {{ direction = \"destination\", {port}, refresh = \"60ms\" }}"
            ),
        )
}

/// A run of an ordinary user in which `middle` makes one attempt; `None`: this machine gives an ordinary user no namespaces.
fn run(folder: &Path, attempt: &str, target: &str) -> Option<Ended> {
    let schedule = sketch(attempt, target).write(folder);
    let started = bateleur_as_ordinary(&["run", "--schedule", &schedule, "--fast", "--until", "0.6"]);
    let ended = started.end().expect_code(0);
    let lacks = ended.stderr.contains("not guaranteed here: a partition sees the file system read-only");
    if lacks {
        eprintln!("skipped: no user namespaces here");
    }
    (!lacks).then_some(ended)
}

fn came_of(ended: &Ended) -> &str {
    let said = ended.stderr.lines().find_map(|line| line.split_once("came of it: "));
    said.unwrap_or_else(|| panic!("it said nothing:\n{}", ended.stderr)).1
}

#[test]
fn partitions_of_an_ordinary_user_have_namespaces_and_a_read_only_file_system_of_their_own() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    std::os::unix::fs::chown(folder.path(), Some(ORDINARY), None).unwrap();
    let own = folder.path().join("own");
    std::fs::write(&own, "of the user").unwrap();
    std::os::unix::fs::chown(&own, Some(ORDINARY), None).unwrap();
    let own = own.to_str().unwrap();
    // An attribute grants reading that file, so that it is the view of the file system which keeps it from writing.
    for (attempt, target, expected) in [
        ("numbers", "", "user 61653, process 1"),
        ("interfaces", "", "[lo]"),
        ("read", own, "refused EACCES"),
        ("write", own, "refused EROFS"),
        ("look", "", "opened 0"),
        ("signal", "", "reached 0"),
    ] {
        let Some(ended) = run(folder.path(), attempt, target) else { return };
        assert_eq!(came_of(&ended), expected, "{attempt}");
        assert!(ended.faults().is_empty(), "{attempt}: {:#?}", ended.faults());
    }
    assert_eq!(std::fs::read_to_string(own).unwrap(), "of the user");
}

#[test]
fn run_as_root_locks_no_user_out_of_his_folder() {
    let _turn = among_others();
    if !rustix::process::geteuid().is_root() {
        eprintln!("skipped: needs root");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    std::os::unix::fs::chown(folder.path(), Some(ORDINARY), Some(ORDINARY)).unwrap();
    let schedule = Sketch::new().partition("one", "counter", 500, "").write(folder.path());
    let output = folder.path().join("target/runs/latest");
    let run = [
        "run",
        "--schedule",
        &schedule,
        "--fast",
        "--until",
        "0.6",
        "--record",
        "--over",
        "--output",
        output.to_str().unwrap(),
    ];
    bateleur(&run).end().expect_code(0);
    let windows = || std::fs::read_to_string(output.join("windows.csv")).unwrap();
    let before = windows();
    std::fs::write(output.join("windows.csv"), "root's").unwrap();
    bateleur_as_ordinary(&run).end().expect_code(0);
    assert_eq!(windows().lines().count(), before.lines().count());
    assert!(output.join("health.ring.old").exists(), "what root's run left in the persistent log");
    // Nothing is left that only root can take away.
    for above in output.ancestors().take(3) {
        use std::os::unix::fs::MetadataExt;
        assert_eq!(std::fs::metadata(above).unwrap().uid(), ORDINARY, "{}", above.display());
    }
}
