//! Partitions in C, under the executive. Each checks itself: it reports what fails, and `done`.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::Path;

use bateleur_tests::{Ended, Sketch, alone, among_others, bateleur, channel_between, compile_c, program};

/// A partition in C: its name, its source, flags of the compiler, keys in the schedule file.
type InC<'t> = (&'t str, &'t str, &'t [&'t str], &'t str);

/// Runs partitions in C for two seconds on the virtual clock.
fn run(folder: &Path, tables: &str, partitions: &[InC<'_>]) -> Ended {
    run_on(&["--fast"], folder, tables, partitions)
}

/// As above, on a clock.
fn run_on(clock: &[&str], folder: &Path, tables: &str, partitions: &[InC<'_>]) -> Ended {
    let compiled = std::thread::scope(|scope| {
        let compiling: Vec<_> = partitions
            .iter()
            .map(|(name, source, flags, _)| scope.spawn(|| compile_c(source, folder, name, flags)))
            .collect();
        compiling.into_iter().map(|program| program.join().unwrap()).collect::<Vec<_>>()
    });
    let sketch =
        partitions.iter().zip(compiled).fold(Sketch::new().table(tables), |sketch, (of, program)| {
            sketch.partition_at(of.0, &program, 1000, of.3)
        });
    let schedule = sketch.write(folder);
    bateleur(&[&["run", "--until", "2", "--schedule", &schedule], clock].concat()).end().expect_code(0)
}

/// Every one of the partitions has come to its end, and nothing has failed.
#[track_caller]
fn expect_all_done(ended: &Ended, partitions: &[InC<'_>]) {
    assert!(!ended.stderr.contains("FAILED"), "{}", ended.stderr);
    for (name, ..) in partitions {
        assert!(ended.stderr.contains(&format!("{name}: done")), "{name} is not done:\n{}", ended.stderr);
    }
    assert!(ended.faults().is_empty(), "{:?}", ended.faults());
}

#[test]
fn ports_processes_and_objects_do_in_c_what_the_header_says() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let sampling = |name: &str| {
        format!(
            "threads = 2\n[partition.{name}.port]\n\
             out = {{ direction = \"source\", kind = \"sampling\", message = \"Number\" }}\n\
             in = {{ direction = \"destination\", kind = \"sampling\", message = \"Number\", refresh = \"100ms\" }}"
        )
    };
    let messages = folder.path().join("messages");
    std::fs::create_dir(&messages).unwrap();
    std::fs::write(messages.join("Number.msg"), "int32 number\n").unwrap();
    let header = std::process::Command::new(program("message_header")).arg(&messages).output().unwrap();
    std::fs::write(folder.path().join("messages.h"), header.stdout).unwrap();
    let include = format!("-I{}", folder.path().display());
    let queuing = |name: &str, direction: &str| {
        let depth = if direction == "source" { "" } else { ", depth = 4" };
        format!(
            "threads = 2\n[partition.{name}.port]\n\
             queue = {{ direction = \"{direction}\", kind = \"queuing\", max_size = 16{depth} }}"
        )
    };
    let tables = [
        channel_between("ping.out", "pong.in"),
        channel_between("pong.out", "ping.in"),
        channel_between("sender.queue", "receiver.queue"),
    ];
    let keys =
        [sampling("ping"), sampling("pong"), queuing("sender", "source"), queuing("receiver", "destination")];
    let partitions: [InC<'_>; 12] = [
        ("hello", "hello", &[], "threads = 2"),
        ("refused", "refused", &[], "processes = 3"),
        ("ping", "sampling", &[&include], &keys[0]),
        ("pong", "sampling", &["-DPONG", &include], &keys[1]),
        ("sender", "queuing", &[], &keys[2]),
        ("receiver", "queuing", &["-DRECEIVER"], &keys[3]),
        ("periodic", "periodic", &[], "threads = 5"),
        ("priorities", "priorities", &[], "threads = 4"),
        ("buffers", "buffers", &[], "threads = 3"),
        ("blackboards", "blackboards", &[], "threads = 4"),
        ("semaphores", "semaphores", &[], "threads = 6"),
        ("events", "events", &[], "threads = 5"),
    ];
    let ended = run(folder.path(), &tables.concat(), &partitions);
    expect_all_done(&ended, &partitions);
    let log =
        |name: &str| std::fs::read_to_string(ended.folder().join(format!("partitions/{name}.log"))).unwrap();
    assert!(log("hello").contains("printed without an end of the file"), "{}", log("hello"));
    // Why a port is refused is said where the partition's words go.
    assert!(
        log("refused").contains("port \"nowhere\" is refused: the program asks for sampling source, 8 bytes")
    );
    assert!(log("ping").contains("the plan has sampling source, 4 bytes"), "{}", log("ping"));
}

#[test]
fn mutexes_wide_identifiers_and_an_error_handler_work_in_c() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let partitions: [InC<'_>; 2] =
        [("mutexes", "mutexes", &[], "threads = 3"), ("handler", "handler", &[], "threads = 8")];
    expect_all_done(&run(folder.path(), "", &partitions), &partitions);
}

#[test]
fn on_the_wall_clock_an_error_handler_in_c_starts_every_faulty_process_again() {
    let _turn = alone();
    let folder = tempfile::tempdir().unwrap();
    let ended = run_on(&[], folder.path(), "", &[("handler", "handler", &[], "threads = 8")]);
    assert!(!ended.stderr.contains("FAILED") && ended.stderr.contains("handler: done"), "{}", ended.stderr);
}

#[test]
fn faults_of_c_are_told_as_what_they_are() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let keys = "threads = 2\nrestart = { start = \"cold\", budget = 0, within = \"10s\", then = \"idle\" }";
    let division = if cfg!(target_arch = "x86_64") { "-DFAULT=division" } else { "-DFAULT=null_pointer" };
    let arithmetic = if cfg!(target_arch = "x86_64") { "numeric_error" } else { "memory_violation" };
    let kinds: [(&str, &str, &str, &str); 5] = [
        ("null", "-DFAULT=null_pointer", "memory_violation", "ended by SIGSEGV"),
        ("division", division, arithmetic, "ended by SIG"),
        ("stack", "-DFAULT=stack", "stack_overflow", "used more stack than it has"),
        ("aborted", "-DFAULT=aborted", "exit", "aborted"),
        ("double", "-DFAULT=double_free", "memory_violation", "free(): double free detected in tcache 2"),
    ];
    let flags = kinds.map(|(_, flag, ..)| [flag]);
    let partitions: Vec<InC<'_>> =
        kinds.iter().zip(&flags).map(|(kind, flags)| (kind.0, "faulty", &flags[..], keys)).collect();
    let ended = run(folder.path(), "", &partitions);
    let faults = ended.faults();
    for (name, _, error, detail) in kinds {
        let of: Vec<_> = faults.iter().filter(|fault| fault.partition == name).collect();
        assert!(
            of.len() == 1 && of[0].error == error && of[0].detail.contains(detail),
            "{name}: {of:?}\n{}",
            ended.stderr
        );
    }
    assert!(!ended.stderr.contains("FAILED"), "{}", ended.stderr);
}

#[test]
fn partition_in_c_that_is_started_by_hand_says_who_starts_it() {
    let folder = tempfile::tempdir().unwrap();
    let program = compile_c("hello", folder.path(), "hello", &[]);
    let output = std::process::Command::new(program).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("this program is a partition: an executive starts it"), "{said}");
    assert!(!output.status.success());
}
