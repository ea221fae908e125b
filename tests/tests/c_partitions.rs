//! Partitions in C, under the executive. Each checks itself: it reports what fails, and `done`.

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use bateleur_tests::{
    Ended, Sketch, alone, among_others, bateleur, c_library, channel_between, compile_c, program, repository,
};

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
    // An error that a handler among the processes was told of is no failure of the partition.
    let failed: Vec<_> = ended.faults().into_iter().filter(|fault| fault.action != "error_handler").collect();
    assert!(failed.is_empty(), "{failed:?}");
}

/// The keys of one end of a pair that plays ping and pong with messages of type `Number`.
fn sampling(name: &str) -> String {
    format!(
        "threads = 2\n[partition.{name}.port]\n\
         out = {{ direction = \"source\", kind = \"sampling\", message = \"Number\" }}\n\
         in = {{ direction = \"destination\", kind = \"sampling\", message = \"Number\", refresh = \"100ms\" }}"
    )
}

#[test]
fn ports_processes_and_objects_do_in_c_what_the_header_says() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let messages = folder.path().join("messages");
    std::fs::create_dir(&messages).unwrap();
    std::fs::write(messages.join("Number.msg"), "int32 number\n").unwrap();
    let header = Command::new(program("message_header")).arg(&messages).output().unwrap();
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
fn partition_in_c_that_was_built_with_other_fields_is_refused_at_its_start() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let messages = folder.path().join("messages");
    std::fs::create_dir(&messages).unwrap();
    let include = format!("-I{}", folder.path().display());
    let keys = sampling("ping");
    let tables = channel_between("ping.out", "pong.in") + &channel_between("pong.out", "ping.in");
    // As many bytes each; a unit and a nested type make another one, too.
    for (built, plan) in [
        ("int32 number\n", "uint32 number\n"),
        ("int32 number\n", "int32 number  # [m]\n"),
        ("int32 number\n", "int32 other\n"),
        ("Inner inner\nint32 number\n", "Inner inner\nint32 number\n"),
    ] {
        let write = |text: &str, inner: &str| {
            std::fs::write(messages.join("Number.msg"), text).unwrap();
            std::fs::write(messages.join("Inner.msg"), inner).unwrap();
        };
        write(built, "float32 value\n");
        let header = Command::new(program("message_header")).arg(&messages).output().unwrap();
        std::fs::write(folder.path().join("messages.h"), header.stdout).unwrap();
        let pong = compile_c("sampling", folder.path(), "pong", &["-DPONG", &include]);
        let ping = compile_c("sampling", folder.path(), "ping", &[&include]);
        let schedule = Sketch::new().table(&tables);
        let schedule = schedule.partition_at("ping", &ping, 1000, &keys).partition_at(
            "pong",
            &pong,
            1000,
            &sampling("pong"),
        );
        write(plan, "uint32 value\n");
        let schedule = schedule.write(folder.path());
        let ended = bateleur(&["run", "--fast", "--until", "1", "--schedule", &schedule]).end();
        assert_ne!(ended.code, Some(0), "{built} for {plan}");
        ended.expect_words(&["carries Number, which has other fields in the plan than in this program"]);
    }
}

#[test]
fn lists_of_queuing_ports_work_in_c() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let ports = |name: &str, direction: &str, more: &str| {
        let port = |port: &str| {
            format!("{port} = {{ direction = \"{direction}\", kind = \"queuing\", max_size = 16{more} }}\n")
        };
        format!("threads = 2\n[partition.{name}.port]\n{}{}", port("one"), port("two"))
    };
    let tables =
        channel_between("sender.one", "receiver.one") + &channel_between("sender.two", "receiver.two");
    let (sends, receives) = (ports("sender", "source", ""), ports("receiver", "destination", ", depth = 4"));
    let wide = ["-DRECEIVER", "-DAPEX_IDENTIFIER_BITS=64"];
    for flags in [&wide[..1], &wide] {
        let partitions: [InC<'_>; 2] =
            [("sender", "lists", &[], &sends), ("receiver", "lists", flags, &receives)];
        expect_all_done(&run(folder.path(), &tables, &partitions), &partitions);
    }
}

#[test]
fn name_services_answer_in_c_what_the_plan_says() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let table = "[name_service.stations]\nground = \"10.77.0.1:14550\"\nrelay = \"10.77.0.2:14550\"\n";
    let partitions: [InC<'_>; 2] = [
        ("narrow", "name_services", &[], "threads = 2"),
        ("wide", "name_services", &["-DAPEX_IDENTIFIER_BITS=64"], "threads = 2"),
    ];
    expect_all_done(&run(folder.path(), table, &partitions), &partitions);
}

#[test]
fn mutexes_wide_identifiers_and_an_error_handler_work_in_c() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let partitions: [InC<'_>; 2] =
        [("mutexes", "mutexes", &[], "threads = 3"), ("handler", "handler", &[], "threads = 8")];
    let ended = run(folder.path(), "", &partitions);
    expect_all_done(&ended, &partitions);
    let errors: Vec<String> = ended.faults().into_iter().map(|fault| fault.error).collect();
    // One application error before NORMAL; the other one is of the same kind and told a second later.
    let expected = [
        "application_error",
        "numeric_error",
        "memory_violation",
        "stack_overflow",
        "deadline_missed",
        "application_error",
    ];
    assert_eq!(errors, expected, "as its handler was told");
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
fn panic_that_is_ordered_ends_a_partition_in_c_as_one_in_rust() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let program = compile_c("periodic", folder.path(), "own", &[]);
    let keys = "threads = 5\nrestart = { start = \"cold\", budget = 0, within = \"10s\", then = \"idle\" }";
    let schedule = Sketch::new().partition_at("own", &program, 1000, keys).write(folder.path());
    let run = ["run", "--fast", "--until", "2", "--inject", "own:panic@1", "--schedule", &schedule];
    let faults = bateleur(&run).end().expect_code(0).faults();
    let exit = |fault: &bateleur_tests::Fault| fault.error == "exit" && fault.detail.contains("panicked");
    assert!(faults.len() == 1 && exit(&faults[0]), "{faults:?}");
}

#[test]
fn partition_in_c_that_is_started_by_hand_says_who_starts_it() {
    let folder = tempfile::tempdir().unwrap();
    let program = compile_c("hello", folder.path(), "hello", &[]);
    let output = Command::new(program).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("this program is a partition: an executive starts it"), "{said}");
    assert!(!output.status.success());
}

/// Whether a program is there; in CI it has to be.
fn is_there(program: &str) -> bool {
    let there = Command::new(program).arg("--version").output().is_ok();
    let needed = std::env::var_os("CI").is_some_and(|value| value == "true");
    assert!(there || !needed, "{program} is needed in CI: tests/c/prepare installs it");
    if !there {
        eprintln!("NOT TESTED with {program}: it is not there (on Debian: tests/c/prepare)");
    }
    there
}

#[track_caller]
fn succeeds(command: &mut Command) {
    let output = command.output().unwrap();
    let words = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    assert!(output.status.success(), "{command:?}\n{}{}", words(&output.stdout), words(&output.stderr));
}

/// The library for C, installed as the page says.
fn installed() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let own = repository().join("partitions/apex_c");
    for (file, place) in [
        (own.join("include/apex.h"), "include/apex.h"),
        (c_library().join("libbateleur_apex_c.a"), "lib/libbateleur_apex_c.a"),
        (own.join("bateleur_apex_c.pc"), "lib/pkgconfig/bateleur_apex_c.pc"),
    ] {
        let to = folder.path().join(place);
        std::fs::create_dir_all(to.parent().unwrap()).unwrap();
        std::fs::copy(file, to).unwrap();
    }
    folder
}

#[test]
fn new_writes_a_partition_in_c_that_builds_without_a_warning_and_runs() {
    if !is_there("pkg-config") {
        return;
    }
    let _turn = among_others();
    let (installed, folder) = (installed(), tempfile::tempdir().unwrap());
    let messages = folder.path().join("messages/plant");
    std::fs::create_dir_all(&messages).unwrap();
    std::fs::write(messages.join("Level.msg"), "float64 level  # [m]\nuint8[8] flags\n").unwrap();
    let sources = "processes = 1\nthreads = 3\n[partition.one.port]\n\
        level = { direction = \"source\", kind = \"sampling\", message = \"plant/Level\" }\n\
        double = { direction = \"source\", kind = \"sampling\", message = \"Pressure\" }\n\
        raw-bytes = { direction = \"source\", kind = \"sampling\", max_size = 12 }\n\
        orders = { direction = \"source\", kind = \"queuing\", message = \"plant/Level\" }\n";
    let destinations = "processes = 1\nthreads = 3\n[partition.two.port]\n\
        level = { direction = \"destination\", kind = \"sampling\", message = \"plant/Level\", refresh = \"50ms\" }\n\
        double = { direction = \"destination\", kind = \"sampling\", message = \"Pressure\", refresh = \"50ms\" }\n\
        raw-bytes = { direction = \"destination\", kind = \"sampling\", max_size = 12, refresh = \"1s\" }\n\
        orders = { direction = \"destination\", kind = \"queuing\", message = \"plant/Level\", depth = 3 }\n";
    let ports = ["level", "double", "raw-bytes", "orders"];
    let tables: String =
        ports.map(|port| channel_between(&format!("one.{port}"), &format!("two.{port}"))).concat();
    let names = [("one", sources), ("two", destinations)];
    let built = |name: &str| folder.path().join("built").join(name);
    let sketch = names.iter().fold(Sketch::new().table(&tables), |sketch, (name, keys)| {
        sketch.partition_at(name, &built(name), 1000, keys)
    });
    let schedule = sketch.write(folder.path());
    let library = repository().display().to_string();
    let programs = program("message_header").parent().unwrap().display().to_string();
    let path = format!("{programs}:{}", std::env::var("PATH").unwrap_or_default());
    for (name, _) in names {
        let source = folder.path().join("sources").join(name);
        let new = ["new", name, "--language", "c", "--schedule", &schedule, "--library", &library, "--dir"];
        bateleur(&[&new[..], &[source.to_str().unwrap()]].concat()).end().expect_code(0);
        let mut build = Command::new(source.join("build"));
        let flags = ("CFLAGS", "-Wpedantic -Werror");
        build.envs([flags, ("PATH", &path)]).env("PKG_CONFIG_PATH", installed.path().join("lib/pkgconfig"));
        succeeds(&mut build);
        let again = bateleur(&[&new[..], &[source.to_str().unwrap()]].concat()).end().expect_code(2);
        again.expect_words(&["has main.c, build already, and nothing is written over"]);
    }
    for folder in [folder.path().to_owned(), folder.path().join("built")] {
        std::fs::set_permissions(folder, std::fs::Permissions::from_mode(0o755)).unwrap();
    }
    let run = ["run", "--fast", "--record", "--until", "3", "--schedule", &schedule];
    let ended = bateleur(&run).end().expect_code(0);
    assert!(ended.faults().is_empty(), "{:?}", ended.faults());
    let mut counts = std::collections::BTreeMap::new();
    bateleur_recording::for_each(ended.folder().join(bateleur_recording::PORTS_FILE), |entry| {
        *counts.entry(entry.topic.to_owned()).or_insert(0) += 1;
    })
    .unwrap();
    // Plain bytes are not recorded.
    for (port, least) in [("level", 100), ("double", 100), ("orders", 2)] {
        assert!(
            counts.get(&format!("/one/{port}")).is_some_and(|count| *count >= least),
            "{port}: {counts:?}"
        );
    }
}

#[test]
fn example_with_cmake_is_built_from_an_installed_library_and_runs() {
    if !is_there("cmake") || !is_there("pkg-config") {
        return;
    }
    let _turn = among_others();
    let (installed, folder) = (installed(), tempfile::tempdir().unwrap());
    let own = repository().join("partitions/apex_c");
    let build = folder.path().join("build");
    let mut configure = Command::new("cmake");
    configure.arg("-S").arg(own.join("examples/greeting")).arg("-B").arg(&build);
    succeeds(configure.env("PKG_CONFIG_PATH", installed.path().join("lib/pkgconfig")));
    succeeds(Command::new("cmake").arg("--build").arg(&build));
    for folder in [folder.path(), &build] {
        std::fs::set_permissions(folder, std::fs::Permissions::from_mode(0o755)).unwrap();
    }
    let sketch = Sketch::new().partition_at("greeting", &build.join("greeting"), 1000, "threads = 2");
    let schedule = sketch.write(folder.path());
    let ended = bateleur(&["run", "--fast", "--until", "1", "--schedule", &schedule]).end().expect_code(0);
    let greetings = ended.stderr.matches("greeting: good day at ").count();
    assert!((9..=10).contains(&greetings), "{greetings} in a second, one each 100 ms: {}", ended.stderr);
    assert!(ended.faults().is_empty(), "{:?}", ended.faults());
}

#[test]
fn partitions_in_c_compile_for_the_other_processor_in_both_languages() {
    let _turn = among_others();
    let other = if cfg!(target_arch = "x86_64") { "aarch64-linux-gnu" } else { "x86_64-linux-gnu" };
    let (c, cxx) = (format!("{other}-gcc"), format!("{other}-g++"));
    if !is_there(&c) || !is_there(&cxx) {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    // The one message that they have.
    std::fs::write(folder.path().join("Number.msg"), "int32 number\n").unwrap();
    let header = Command::new(program("message_header")).arg(folder.path()).output().unwrap();
    std::fs::write(folder.path().join("messages.h"), header.stdout).unwrap();
    let sources: Vec<PathBuf> = std::fs::read_dir(repository().join("tests/c"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "c"))
        .collect();
    assert!(sources.len() >= 12, "{sources:?}");
    let greeting = repository().join("partitions/apex_c/examples/greeting/greeting.c");
    for (source, compiler, language) in sources
        .iter()
        .map(|source| (source, &c, "-std=c99"))
        .chain([(&greeting, &c, "-std=c99"), (&greeting, &cxx, "-std=c++17")])
    {
        let mut compile = Command::new(compiler);
        compile.args([language, "-DFAULT=aborted", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-c"]);
        if language.starts_with("-std=c++") {
            compile.args(["-x", "c++"]);
        }
        compile.arg(source).arg("-I").arg(folder.path());
        compile.arg("-I").arg(repository().join("partitions/apex_c/include"));
        succeeds(compile.arg("-o").arg(folder.path().join("object.o")));
        let object = std::fs::read(folder.path().join("object.o")).unwrap();
        // e_machine of its ELF header: AArch64 183, x86-64 62.
        let machine = if cfg!(target_arch = "x86_64") { 183 } else { 62 };
        assert_eq!(u16::from_le_bytes([object[18], object[19]]), machine, "{}", source.display());
    }
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn on_the_wall_clock_an_error_handler_in_c_starts_every_faulty_process_again() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let ended = run_on(&[], folder.path(), "", &[("handler", "handler", &[], "threads = 8")]);
        assert!(
            !ended.stderr.contains("FAILED") && ended.stderr.contains("handler: done"),
            "{}",
            ended.stderr
        );
    }
}
