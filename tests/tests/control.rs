//! Control of a running module: figures, orders, and clients that mean harm.

use std::io::{Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use bateleur_tests::{Sketch, Started, alone, await_some, bateleur};
use serde_json::Value;

/// Two partitions that behave, in a module on the wall clock. The folder must live as long.
fn module(seconds: u32) -> (Started, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let keys = "restart = { start = \"cold\", budget = 50, within = \"10s\", then = \"idle\" }";
    let schedule =
        Sketch::new().partition("one", "counter", 1000, keys).partition("two", "counter", 1000, keys);
    let schedule = schedule.write(folder.path());
    let mut module = bateleur(&["run", "--schedule", &schedule, "--until", &seconds.to_string()]);
    module.await_words("2 partitions are ready");
    (module, folder)
}

fn ask(module: &Started, verb: &[&str]) -> bateleur_tests::Ended {
    let pid = module.pid().to_string();
    bateleur(&[verb, &["--module", &pid]].concat()).end()
}

fn status(module: &Started) -> Value {
    ask(module, &["ps", "--format", "json"]).expect_code(0).summary()["modules"][0].clone()
}

#[track_caller]
fn await_status(module: &Started, what: impl Fn(&Value) -> bool) -> Value {
    let mut last = Value::Null;
    let found = await_some(Duration::from_secs(20), || {
        last = status(module);
        what(&last).then(|| last.clone())
    });
    found.unwrap_or_else(|| panic!("it never came to that: {last:#}"))
}

#[test]
fn module_that_does_not_run_is_refused_and_said() {
    let ended = bateleur(&["kill", "imu", "--module", "no_such_module"]).end().expect_code(2);
    assert!(ended.stderr.contains("module"), "{}", ended.stderr);
}

/// Its control socket.
fn socket(module: &Started) -> PathBuf {
    PathBuf::from(format!("/dev/shm/bateleur.test.{}/control", module.pid()))
}

/// Does its worst until it is told to stop: connections by the hundred that say nothing, garbage, endless lines, floods
/// of requests whose answers nobody reads, and conversations broken off.
fn harm(socket: &std::path::Path, stop: &AtomicBool) {
    let connect = || UnixStream::connect(socket).ok().filter(|stream| stream.set_nonblocking(true).is_ok());
    let mut held: Vec<UnixStream> = Vec::new();
    let mut round = 0_u32;
    while !stop.load(Ordering::Acquire) {
        round += 1;
        for _ in 0..10 {
            let Some(mut stream) = connect() else { continue };
            let _ = match round % 5 {
                0 => Ok(()), // says nothing
                1 => stream.write_all(&[0xff; 4000]),
                2 => stream.write_all("{\"ask\":\"status\"}\n".repeat(200).as_bytes()),
                3 => stream.write_all(b"{\"ask\":\"kill\",\"partition\":\"nobody\"}\n{\"ask\":"),
                _ => stream.write_all(&[b'['; 9000]),
            };
            let _ = stream.read(&mut [0; 16]);
            held.push(stream);
        }
        if held.len() > 1000 {
            held.clear();
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Memory of the executive's own, kB.
fn resident_kb(pid: i32) -> u64 {
    let text = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = text.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
    line.split_ascii_whitespace().nth(1).unwrap().parse().unwrap()
}

fn descriptors(pid: i32) -> usize {
    std::fs::read_dir(format!("/proc/{pid}/fd")).unwrap().count()
}

/// Where the test below runs itself again as another user, the socket that he tries.
const TRIED: &str = "BATELEUR_TEST_SOCKET";

/// A partition that writes a count in each window, and one that reads it.
fn counting_module() -> (Started, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let source = "[partition.from.port]\ncount = { direction = \"source\", kind = \"sampling\", message = \"FunctionStatus\" }";
    let destination = "[partition.to.port]\nheard = { direction = \"destination\", kind = \"sampling\", message = \"FunctionStatus\", refresh = \"60ms\" }";
    let schedule = Sketch::new()
        .table("[[channel]]\nsource = \"from.count\"\ndestinations = [\"to.heard\"]")
        .partition("from", "counter", 1000, source)
        .partition("to", "counter", 1000, destination)
        .write(folder.path());
    let mut module = bateleur(&["run", "--schedule", &schedule, "--until", "100"]);
    module.await_words("2 partitions are ready");
    (module, folder)
}

fn observers(module: &Started) -> Vec<bateleur_tests::Process> {
    let mut all = bateleur_tests::children_of(module.pid());
    all.retain(|process| process.name == "observer");
    all
}

fn files_below(folder: &std::path::Path) -> usize {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries
        .map(|entry| match entry.file_type() {
            Ok(kind) if kind.is_dir() => 1 + files_below(&entry.path()),
            _ => 1,
        })
        .sum()
}

/// Faults that are planned happen the same way in every run on the virtual clock.
#[test]
fn planned_faults_end_as_the_table_says_and_the_same_in_every_run() {
    let _turn = bateleur_tests::among_others();
    let run = || {
        let folder = tempfile::tempdir().unwrap();
        let keys = "restart = { start = \"cold\", budget = 50, within = \"10s\", then = \"idle\" }";
        let source = format!(
            "{keys}\n[partition.one.port]\ncount = {{ direction = \"source\", kind = \"sampling\", message = \"FunctionStatus\" }}"
        );
        let destination = "[partition.two.port]\nheard = { direction = \"destination\", kind = \"sampling\", message = \"FunctionStatus\", refresh = \"60ms\" }";
        let schedule = Sketch::new()
            .table("[[channel]]\nsource = \"one.count\"\ndestinations = [\"two.heard\"]")
            .partition("one", "counter", 1000, &source)
            .partition("two", "counter", 1000, destination)
            .write(folder.path());
        let mut arguments = vec!["run", "--fast", "--record", "--until", "10", "--schedule", &schedule];
        let faults = [
            "one:panic@1",
            "one:exit@2",
            "one:null-write@3",
            "one:illegal-instruction@4",
            "one:divide-by-zero@5",
            "one:bus-error@6",
            "one:sigkill@7",
            "one.count:drop=5@8",
            "one:run-on@8", // at the same instant: both are carried out
            "one.count:delay=2/50ms@8.5",
            "one.count:corrupt=3@9",
        ];
        faults.iter().for_each(|fault| arguments.extend(["--inject", fault]));
        let ended = bateleur(&arguments).end().expect_code(0);
        let mut log = Vec::new();
        bateleur_recording::for_each(ended.folder().join("ports.mcap"), |entry| {
            log.push((entry.time_ns, entry.sequence, entry.bytes.to_vec()));
        })
        .unwrap();
        (ended.faults(), log)
    };
    let ((faults, log), (again, log_again)) = (run(), run());
    let errors: Vec<_> = faults
        .iter()
        .filter(|fault| fault.partition == "one" && fault.action != "ignore")
        .map(|fault| fault.error.as_str())
        .collect();
    let numeric = if cfg!(target_arch = "x86_64") { "numeric_error" } else { "exit" };
    assert_eq!(
        errors,
        ["exit", "exit", "memory_violation", "illegal_request", numeric, "memory_violation", "killed"],
        "{faults:#?}"
    );
    let gap = log.windows(2).find(|pair| pair[1].1 > pair[0].1 + 1).expect("five messages are missing");
    assert_eq!(gap[1].1 - gap[0].1, 6);
    assert_eq!(log, log_again);
    let outcome = |list: &[bateleur_tests::Fault]| {
        list.iter().map(|fault| (fault.time_ns, fault.error.clone(), fault.recovered_ns)).collect::<Vec<_>>()
    };
    assert_eq!(outcome(&faults), outcome(&again));
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    /// Both dispatchers are real-time at one priority, and neither knows of the other.
    #[test]
    fn second_module_on_a_processor_of_another_one_says_so_and_strict_doctor_and_ps_know() {
        const PROMISE: &str = "exclusive cores";
        let _turn = alone();
        let (first, folder) = module(30);
        let named = format!("PID {}", first.pid());
        let (second, _folder) = module(3);
        let said = second.said();
        let line = said.lines().find(|line| line.contains(PROMISE)).expect("it is missing");
        assert!(line.starts_with("not guaranteed here") && line.contains(&named), "{line}");
        let shown = ask(&first, &["ps", "--format", "json"]).expect_code(0).summary();
        let pids = shown["shared_cores"][0]["pids"].as_array().expect("a processor of two");
        assert!([&first, &second].iter().all(|module| pids.contains(&module.pid().into())), "{shown}");
        second.end().expect_code(0);
        let schedule = Sketch::new().partition("one", "counter", 1000, "").write(folder.path());
        bateleur(&["run", "--schedule", &schedule, "--require", "strict"])
            .end()
            .expect_code(2)
            .expect_words(&[PROMISE, &named]);
        let examined =
            bateleur(&["doctor", "--schedule", &schedule, "--format", "json"]).end().expect_code(1);
        let findings = examined.summary()["findings"].clone();
        let lacks = |finding: &Value| finding["topic"] == PROMISE && finding["state"] == "lacks";
        assert!(findings.as_array().unwrap().iter().any(lacks), "{findings}");
        first.signal(rustix::process::Signal::TERM);
        first.end().expect_code(0);
    }

    #[test]
    fn partition_is_killed_stopped_started_frozen_and_thawed_by_orders_that_stand_in_the_log() {
        let _turn = alone();
        let (module, _folder) = module(100);
        let at_first = await_status(&module, |status| status["windows"].as_u64() > Some(20));
        assert_eq!(at_first["module"], "test");
        assert_eq!(at_first["partitions"][0]["name"], "one");
        assert!(at_first["partitions"][0]["use_ns"]["mean"].as_u64().unwrap() > 0, "{at_first:#}");
        let words = |verb, words: &str| {
            let ended = ask(&module, &[verb, "two"]);
            assert!(ended.stdout.contains(words) || ended.stderr.contains(words), "{verb}: {ended:?}");
        };
        words("kill", "two is killed");
        let of_two = |status: &Value, key: &str| status["partitions"][1][key].clone();
        let back = await_status(&module, |status| of_two(status, "mode") == "normal");
        assert_eq!((of_two(&back, "generation"), of_two(&back, "restarts")), (1.into(), 1.into()));
        assert_eq!(of_two(&back, "last_fault")["error"], "killed");
        words("freeze", "two is frozen");
        let frozen = await_status(&module, |status| of_two(status, "mode") == "frozen");
        std::thread::sleep(Duration::from_millis(200));
        let later = status(&module);
        assert!(of_two(&later, "windows").as_u64() <= of_two(&frozen, "windows").as_u64().map(|n| n + 1));
        assert!(later["partitions"][0]["windows"].as_u64() > frozen["partitions"][0]["windows"].as_u64());
        words("thaw", "two goes on");
        await_status(&module, |status| {
            of_two(status, "windows").as_u64() > of_two(&later, "windows").as_u64()
        });
        words("stop", "two is stopped");
        await_status(&module, |status| of_two(status, "mode") == "idle");
        words("stop", "two is not running");
        words("start", "two is being started");
        await_status(&module, |status| of_two(status, "mode") == "normal");
        let wrong = ask(&module, &["kill", "tow"]).expect_code(2);
        assert!(wrong.stderr.contains("did you mean `two`?"), "{}", wrong.stderr);
        let table = ask(&module, &["top", "--once"]).expect_code(0);
        assert!(table.stdout.contains("module test") && table.stdout.contains("two"), "{}", table.stdout);
        module.signal(rustix::process::Signal::TERM);
        let ended =
            module.end().expect_code(0).expect_words(&["stopped by the operator", "frozen by the operator"]);
        let orders =
            ["kill", "freeze", "thaw", "stop", "start"].map(|order| format!("{order}, by the operator"));
        assert_eq!(ended.orders(), orders);
    }

    #[test]
    fn hostile_clients_take_no_window_bounded_memory_and_no_answers_from_others() {
        let _turn = alone();
        let (module, _folder) = module(12);
        let quiet = await_status(&module, |status| status["windows"].as_u64() > Some(50));
        let (memory, files) = (resident_kb(module.pid()), descriptors(module.pid()));
        let stop = Arc::new(AtomicBool::new(false));
        let attackers: Vec<_> = (0..2)
            .map(|_| {
                let (path, stop) = (socket(&module), stop.clone());
                std::thread::spawn(move || harm(&path, &stop))
            })
            .collect();
        std::thread::sleep(Duration::from_secs(3));
        // The attackers are one process; this one asks as another.
        let harmed = status(&module);
        assert!(
            harmed["windows"].as_u64() > quiet["windows"].as_u64().map(|before| before + 100),
            "{harmed:#}"
        );
        let more = resident_kb(module.pid()).saturating_sub(memory);
        assert!(more < 4096, "the executive has taken {more} kB more");
        let more = descriptors(module.pid()).saturating_sub(files);
        assert!(more <= 16, "{more} descriptors more");
        stop.store(true, Ordering::Release);
        attackers.into_iter().for_each(|attacker| attacker.join().unwrap());
        let ended = module.end().expect_code(0);
        // Where the machine held the dispatcher itself up, nobody in the module is to blame.
        let windows = ended.windows();
        let on_time = windows.iter().filter(|window| !window.late);
        assert_eq!(on_time.filter(|window| window.granted_ns.is_none()).count(), 0);
        assert!(ended.faults().iter().all(|fault| fault.error != "killed"), "{:#?}", ended.faults());
    }

    #[test]
    fn another_user_is_not_heard_even_where_the_mode_lets_him_in() {
        if let Some(path) = std::env::var_os(TRIED) {
            let mut stream = UnixStream::connect(path).unwrap();
            let _ = stream.write_all(b"{\"ask\":\"status\"}\n"); // it may be closed already
            assert_eq!(stream.read(&mut [0; 16]).unwrap_or(0), 0, "he was answered");
            return;
        }
        if !rustix::process::geteuid().is_root() {
            return; // there is nobody else to become
        }
        let _turn = alone();
        let (module, _folder) = module(100);
        std::fs::set_permissions(socket(&module), std::fs::Permissions::from_mode(0o666)).unwrap();
        let own = std::env::current_exe().unwrap();
        let mut other = std::process::Command::new(own);
        other.args(["--exact", "control::alone::another_user_is_not_heard_even_where_the_mode_lets_him_in"]);
        let ended = other.env(TRIED, socket(&module)).uid(61_653).gid(61_653).output().unwrap();
        assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stdout));
        assert!(String::from_utf8_lossy(&ended.stdout).contains("1 passed"));
        module.signal(rustix::process::Signal::TERM);
        module.end().expect_code(0);
    }

    #[test]
    fn messages_are_named_counted_and_recorded_and_a_killed_client_leaves_nothing() {
        let _turn = alone();
        let (module, folder) = counting_module();
        let traces = bateleur_tests::Traces::of(module.pid());
        let list = ask(&module, &["ports", "list", "--format", "json"]).expect_code(0).summary();
        assert_eq!(list[0]["source"], "from.count");
        assert_eq!(list[0]["destinations"], serde_json::json!(["to.heard"]));
        assert!(list[0]["rate_hz"].as_f64().unwrap() > 1.0, "{list:#}");
        // Either end names the channel.
        let echo =
            ask(&module, &["ports", "echo", "to.heard", "--count", "3", "--format", "json"]).expect_code(0);
        let values: Vec<Value> =
            echo.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert_eq!(values.len(), 3);
        assert!(
            values[0]["values"]["accepted"].as_u64() < values[2]["values"]["accepted"].as_u64(),
            "{values:#?}"
        );
        let wrong = ask(&module, &["ports", "echo", "from.cuont"]).expect_code(2);
        assert!(wrong.stderr.contains("did you mean `from.count`?"), "{}", wrong.stderr);
        let file = folder.path().join("recorded.mcap");
        ask(&module, &["record", "--for", "1", "--output", file.to_str().unwrap()]).expect_code(0);
        let mut recorded = 0;
        bateleur_recording::for_each(&file, |entry| recorded += u32::from(entry.topic == "/from/count"))
            .unwrap();
        assert!(recorded > 1, "{recorded} messages recorded");
        // The files in the channel's directory are those of before again, once the observers are buried.
        let gone = await_some(Duration::from_secs(10), || observers(&module).is_empty().then_some(()));
        assert!(gone.is_some(), "{:?}", observers(&module));
        std::thread::sleep(Duration::from_millis(500));
        let directory = format!("/dev/shm/bateleur.test.{}", module.pid());
        let before = files_below(directory.as_ref());
        for _ in 0..6 {
            let pid = module.pid().to_string();
            let client = bateleur(&["ports", "echo", "from.count", "--module", &pid]);
            let works =
                await_some(Duration::from_secs(10), || (!observers(&module).is_empty()).then_some(()));
            assert!(works.is_some(), "no observer: {}", client.said());
            client.signal(rustix::process::Signal::KILL);
            drop(client);
            let gone = await_some(Duration::from_secs(10), || observers(&module).is_empty().then_some(()));
            assert!(gone.is_some(), "{:?}", observers(&module));
        }
        let buried =
            await_some(Duration::from_secs(10), || (files_below(directory.as_ref()) <= before).then_some(()));
        assert!(buried.is_some(), "{} files where {before} were", files_below(directory.as_ref()));
        module.signal(rustix::process::Signal::TERM);
        module.end().expect_code(0);
        traces.expect_gone();
    }

    #[test]
    fn third_observer_is_refused_and_a_module_ends_with_clients_at_its_ports() {
        let _turn = alone();
        let (module, _folder) = counting_module();
        let pid = module.pid().to_string();
        let watch = || bateleur(&["ports", "echo", "from.count", "--module", &pid]);
        let clients = [watch(), watch()];
        let both = await_some(Duration::from_secs(10), || (observers(&module).len() == 2).then_some(()));
        assert!(both.is_some(), "{:?}", observers(&module));
        let third = ask(&module, &["ports", "hz", "from.count"]).expect_code(2);
        assert!(third.stderr.contains("2 observers are at work"), "{}", third.stderr);
        module.signal(rustix::process::Signal::TERM);
        module.end().expect_code(0);
        for client in clients {
            client.end().expect_code(2).expect_words(&["has ended"]);
        }
    }
}
