//! The logs of a run when things end badly: the persistent one outlives a killed executive, and a full disk stops nobody.

use std::process::Command;

use bateleur_tests::{PATIENCE, Process, Sketch, alone, among_others, await_some, bateleur, children_of};
use rustix::process::Signal;

fn two_partitions(folder: &std::path::Path) -> String {
    let sketch = Sketch::new().partition("first", "counter", 2000, "");
    sketch.partition("second", "counter", 2000, "").write(folder)
}

#[test]
fn log_that_may_not_grow_any_more_costs_records_and_not_the_module() {
    let _turn = among_others();
    let scratch = tempfile::tempdir().unwrap();
    let schedule = two_partitions(scratch.path());
    let limited = "ulimit -S -f 400; exec \"$0\" run --fast --until 120 --schedule \"$1\" --output \"$2\"";
    let program = bateleur_tests::program("bateleur");
    let mut run = Command::new("sh");
    run.args(["-c", limited]).arg(program).arg(&schedule).arg(scratch.path().join("out"));
    let ended = run.output().unwrap();
    let said = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(1), "{said}");
    assert!(said.contains("windows.csv") && said.contains("stopped after 120.00 s"), "{said}");
}

#[test]
fn module_that_may_open_too_few_files_says_so_and_not_that_the_machine_lacks_something() {
    let scratch = tempfile::tempdir().unwrap();
    let schedule = two_partitions(scratch.path());
    let limited = "ulimit -n 100; exec \"$0\" run --fast --until 1 --schedule \"$1\" --output \"$2\"";
    let mut run = Command::new("sh");
    run.args(["-c", limited]).arg(bateleur_tests::program("bateleur"));
    let ended = run.arg(&schedule).arg(scratch.path().join("out")).output().unwrap();
    let said = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(2), "{said}");
    assert!(said.contains("may open 100 files") && said.contains("ulimit -n"), "{said}");
    assert!(!said.contains("not guaranteed here"), "{said}");
}

#[test]
fn executive_killed_after_a_fault_leaves_it_in_the_persistent_log() {
    let _turn = among_others();
    let scratch = tempfile::tempdir().unwrap();
    let schedule = two_partitions(scratch.path());
    let mut run = bateleur(&["run", "--schedule", &schedule, "--kill", "first@0.5"]);
    run.await_words("first: killed");
    let folder = run.folder();
    let read = |more: &[&str]| bateleur(&[&["health", folder.to_str().unwrap()], more].concat()).end();
    // The disk is asked by a thread of its own: soon, not at once.
    let noted = await_some(PATIENCE, || read(&[]).stdout.contains("killed").then_some(()));
    assert!(noted.is_some(), "read while it is written: {}", read(&[]).stdout);
    run.signal(Signal::KILL);
    let told = read(&["--partition", "first", "--format", "json"]).expect_code(0).summary();
    // A machine with other work may stop a window late before.
    let entries = told["entries"].as_array().unwrap();
    let fault = entries.iter().find(|entry| entry["error"] == "killed").expect("the kill is in the log");
    assert_eq!((&fault["action"], &fault["generation"]), (&"cold_restart".into(), &0.into()), "{told}");
    let all = read(&[]).expect_code(0).stdout;
    assert!(all.contains("a run began") && all.contains("first[0]: killed (ended by SIGKILL)"), "{all}");
    // Cut off in the middle of its second record.
    let path = folder.join("health.ring");
    std::fs::OpenOptions::new().write(true).open(&path).unwrap().set_len(64 + 256 + 100).unwrap();
    let cut = read(&[]).expect_code(1).stdout;
    assert!(cut.contains("a run began") && cut.contains("1 records are damaged"), "{cut}");
    std::fs::write(&path, "something else, and long enough that it could have a header of sixty-four bytes")
        .unwrap();
    read(&[]).expect_code(2).expect_words(&["health.ring", "this is no health log"]);
    std::fs::remove_file(&path).unwrap();
    read(&[]).expect_code(2).expect_words(&["health.ring"]);
}

/// The entries that came, each as what it says of its fields.
fn heard(listening: &std::os::unix::net::UnixDatagram) -> Vec<String> {
    let mut bytes = [0; 8192];
    std::iter::from_fn(|| {
        let length = listening.recv(&mut bytes).ok()?;
        Some(String::from_utf8_lossy(&bytes[..length]).into_owned())
    })
    .collect()
}

/// A small file system of its own, which is gone when this is dropped.
struct Disk(std::path::PathBuf);

impl Drop for Disk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).status(); // the test has failed or not before
    }
}

/// Mounts a file system of `size` in `folder`; `None` if this user can not.
fn small_disk(folder: &std::path::Path, size: &str) -> Option<Disk> {
    if !rustix::process::geteuid().is_root() {
        eprintln!("not tried: only root can mount a small disk");
        return None;
    }
    let small = folder.join("small");
    std::fs::create_dir(&small).unwrap();
    let size = format!("size={size}");
    let mount = Command::new("mount").args(["-t", "tmpfs", "-o", &size, "none"]).arg(&small).status();
    assert!(mount.unwrap().success(), "root can mount");
    Some(Disk(small))
}

#[test]
fn full_disk_is_said_once_for_each_log_and_the_module_goes_on_and_its_exit_code_says_so() {
    let _turn = among_others();
    let scratch = tempfile::tempdir().unwrap();
    let schedule = two_partitions(scratch.path());
    let Some(disk) = small_disk(scratch.path(), "64k") else { return };
    let output = disk.0.join("out");
    let mut arguments = vec!["run", "--fast", "--until", "60", "--schedule", &schedule];
    arguments.extend(["--output", output.to_str().unwrap(), "--kill", "first@50"]);
    let ended = bateleur(&arguments).end().expect_code(1);
    drop(disk);
    let said = &ended.stderr;
    for log in ["windows.csv", "health.jsonl"] {
        let words = format!("{log} can not be written any more: No space left on device");
        assert_eq!(said.matches(&words).count(), 1, "{log}:\n{said}");
    }
    // One window passes while the killed partition starts anew.
    assert!(said.contains("stopped after 60.00 s") && said.contains("5999 windows"), "{said}");
    assert!(said.contains("records are missing in logs that could not be written"), "{said}");
}

#[test]
fn partition_whose_log_is_on_a_full_disk_is_not_blocked_and_that_is_said_once() {
    let _turn = among_others();
    let scratch = tempfile::tempdir().unwrap();
    let chatter = "attributes = { attempt = \"chatter\" }";
    let schedule = Sketch::new().partition("loud", "hostile", 2000, chatter).write(scratch.path());
    let Some(disk) = small_disk(scratch.path(), "64k") else { return };
    let output = disk.0.join("out");
    let mut arguments = vec!["run", "--fast", "--until", "10", "--schedule", &schedule];
    arguments.extend(["--output", output.to_str().unwrap(), "--kill", "loud@5"]);
    let ended = bateleur(&arguments).end().expect_code(1);
    drop(disk);
    let said = &ended.stderr;
    let words = "partitions/loud.log can not be written any more: No space left on device";
    assert_eq!(said.matches(words).count(), 1, "{said}");
    assert!(said.contains("stopped after 10.00 s") && !said.contains("window_overrun"), "{said}");
    assert!(said.contains("loud: back after"), "{said}");
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn a_fault_on_the_wall_clock_is_in_the_machines_journal_with_fields_of_its_own_and_a_trial_is_not() {
        if !rustix::process::geteuid().is_root() {
            eprintln!("skipped: a socket in the journal's place needs root");
            return;
        }
        let _turn = alone();
        let scratch = tempfile::tempdir().unwrap();
        let (schedule, socket) = (two_partitions(scratch.path()), scratch.path().join("socket"));
        let listening = std::os::unix::net::UnixDatagram::bind(&socket).unwrap();
        listening.set_nonblocking(true).unwrap();
        // In a mount namespace of its own: whatever journal this machine has hears nothing.
        let script = "mount --make-rprivate / && mount -t tmpfs run /run && mkdir -p /run/systemd/journal && touch /run/systemd/journal/socket \
        && mount --bind \"$1\" /run/systemd/journal/socket && exec \"$0\" run --schedule \"$2\" --output \"$3\" --until 3 --kill first@0.5 $4";
        let fly = |clock: &str| {
            let mut run = Command::new("unshare");
            run.args(["--mount", "--", "sh", "-c", script]).arg(bateleur_tests::program("bateleur"));
            run.arg(&socket).arg(&schedule).arg(scratch.path().join(format!("out{clock}"))).arg(clock);
            let ended = run.output().unwrap();
            assert!(
                ended.status.code().is_some_and(|code| code < 2),
                "{}",
                String::from_utf8_lossy(&ended.stderr)
            );
            heard(&listening)
        };
        let entries = fly("");
        let of = |words: &str| entries.iter().filter(|entry| entry.contains(words)).collect::<Vec<_>>();
        let faults = of("\nBATELEUR_ERROR=killed\n");
        assert_eq!(faults.len(), 1, "{entries:#?}");
        for field in [
            "MESSAGE=first: killed -> cold_restart (ended by SIGKILL)",
            "PRIORITY=3",
            "SYSLOG_IDENTIFIER=bateleur",
            "BATELEUR_MODULE=test",
            "BATELEUR_PARTITION=first",
            "BATELEUR_LEVEL=partition",
            "BATELEUR_ACTION=cold_restart",
            "BATELEUR_GENERATION=0",
        ] {
            assert!(faults[0].lines().any(|line| line == field), "{field} is not in\n{}", faults[0]);
        }
        assert_eq!(of("\nBATELEUR_ERROR=recovered\n").len(), 1, "{entries:#?}");
        assert_eq!(of("\nBATELEUR_ERROR=module_start\n").len(), 1, "{entries:#?}");
        assert_eq!(fly("--fast"), Vec::<String>::new(), "on the virtual clock");
    }

    #[test]
    fn recorder_that_a_full_disk_ends_is_followed_by_another_when_there_is_room_again() {
        let _turn = alone();
        let scratch = tempfile::tempdir().unwrap();
        let port = "[partition.first.port]\n\
        count = { direction = \"source\", kind = \"sampling\", message = \"FunctionStatus\" }";
        let ear = "[partition.second.port]\n\
        heard = { direction = \"destination\", kind = \"sampling\", message = \"FunctionStatus\", refresh = \"60ms\" }";
        let schedule = Sketch::new()
            .table("[[channel]]\nsource = \"first.count\"\ndestinations = [\"second.heard\"]")
            .partition("first", "counter", 2000, port)
            .partition("second", "counter", 2000, ear)
            .write(scratch.path());
        let Some(disk) = small_disk(scratch.path(), "16m") else { return };
        let output = disk.0.join("out");
        let run = ["run", "--schedule", &schedule, "--record", "--output", output.to_str().unwrap()];
        let mut run = bateleur(&run);
        run.await_words("2 partitions are ready");
        let filler = disk.0.join("filler");
        let full = std::fs::write(&filler, vec![0; 17 << 20]);
        assert_eq!(full.unwrap_err().kind(), std::io::ErrorKind::StorageFull);
        run.await_words("ports.mcap ends: the disk is full; messages are missing until there is room again");
        std::fs::remove_file(&filler).unwrap();
        let next = output.join("ports.part-1.mcap");
        let grows =
            await_some(PATIENCE, || next.metadata().is_ok_and(|about| about.len() > 10_000).then_some(()));
        assert!(grows.is_some(), "{}", run.said());
        run.signal(Signal::INT);
        let ended = run.end();
        assert_eq!(ended.stderr.matches("ports.mcap ends").count(), 1, "{}", ended.stderr);
        assert_eq!(ended.stderr.matches("ports.part-1.mcap").count(), 1, "{}", ended.stderr);
        let both =
            ["ports.mcap", "ports.part-1.mcap"].map(|name| output.join(name).metadata().unwrap().len());
        assert!(both.iter().all(|length| *length > 0), "{both:?}");
    }

    #[test]
    fn recorder_that_hangs_is_followed_by_another_and_holds_up_nobody() {
        let _turn = alone();
        let scratch = tempfile::tempdir().unwrap();
        let schedule = two_partitions(scratch.path());
        let run = ["run", "--schedule", &schedule, "--record", "--until", "9", "--kill", "first@3"];
        let mut run = bateleur(&run);
        run.await_words("2 partitions are ready");
        let is_recorder = |process: &Process| {
            std::fs::read(format!("/proc/{}/cmdline", process.pid))
                .is_ok_and(|line| line.split(|byte| *byte == 0).nth(1) == Some(b"recorder"))
        };
        let recorder = children_of(run.pid()).into_iter().find(is_recorder).expect("a recorder");
        recorder.signal(Signal::STOP);
        let ended = run.end().expect_code(0);
        // Whoever waited for it would do so for five seconds.
        let killed = ended.faults().into_iter().find(|fault| fault.error == "killed").expect("the kill");
        assert!(killed.time_ns < 5_000_000_000, "{killed:?}");
        let ended = ended.expect_words(&["ports.mcap ends: ", "another one goes on in ports.part-1.mcap"]);
        assert!(ended.folder().join("ports.part-1.mcap").exists());
    }
}
