//! The program that runs as root, without the command line before it: what it reads, what it refuses, which privileges it keeps, and a
//! disk that hangs under it.

use std::fs::File;
use std::io::Read;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::time::{Duration, Instant};

use bateleur_tests::{
    Sketch, among_others, await_some, bateleur, channel_between, daemon, ports_of, process_named,
};
use rustix::process::Signal;
use serde_json::json;

/// A compiled plan of two partitions, in `folder`.
fn compiled(folder: &Path) -> String {
    let sketch = Sketch::new()
        .table(&channel_between("one.numbers", "other.numbers"))
        .partition("one", "neighbour", 1000, &ports_of("one", &[("numbers", "source", "sampling")]))
        .partition("other", "neighbour", 1000, &ports_of("other", &[("numbers", "destination", "sampling")]));
    let (schedule, plan) = (sketch.write(folder), folder.join("test.plan"));
    let plan = plan.to_str().unwrap().to_owned();
    bateleur(&["check", "--compile", &plan, &schedule]).end().expect_code(0);
    plan
}

fn order(folder: &Path, order: &serde_json::Value) -> String {
    let path = folder.join("test.order");
    std::fs::write(&path, order.to_string()).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn compiled_plan_is_run_as_its_order_says() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let plan = compiled(folder.path());
    let out = folder.path().join("out");
    let order = order(folder.path(), &json!({ "fast": true, "until_ns": 1_000_000_000, "output": out }));
    daemon(&[&plan, &order])
        .end()
        .expect_code(0)
        .expect_words(&["2 partitions are ready", "stopped after 1.00 s"]);
    assert!(out.join("windows.csv").exists() && out.join("health.jsonl").exists());
}

#[test]
fn what_is_no_plan_or_no_order_is_refused_by_name_before_anything_starts() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let plan = compiled(folder.path());
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let mut damaged = std::fs::read(&plan).unwrap();
    let last = damaged.len() - 20;
    damaged[last] ^= 1;
    let refused = |arguments: &[&str], words: &str| {
        let ended = daemon(arguments).end().expect_code(2).expect_words(&[words]);
        assert!(!ended.stderr.contains("ready"), "{}", ended.stderr);
    };
    let schedule = folder.path().join("test.toml");
    refused(
        &[schedule.to_str().unwrap()],
        "test.toml: it is no compiled plan: `bateleur check --compile FILE`",
    );
    refused(&[&write("damaged", &damaged)], "damaged: it is damaged");
    refused(&["/nowhere"], "cannot read /nowhere");
    refused(&["/dev/zero"], "it is longer than 32 MiB");
    refused(&["fd:77"], "descriptor 77 was not handed over");
    refused(
        &[&plan, &write("order", b"{\"fasst\": true}")],
        "it is no order of a run: unknown field `fasst`",
    );
    refused(&[&plan, &write("order", b"{\"module\": \"nav\"}")], "the plan has no module \"nav\"");
    refused(&[], "usage: bateleurd PLAN [ORDER]");
}

#[test]
fn plan_is_not_written_over_something_else_nor_where_it_can_not_be_used() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let plan = compiled(folder.path());
    let schedule = folder.path().join("test.toml").to_str().unwrap().to_owned();
    bateleur(&["check", "--compile", &schedule, &schedule])
        .end()
        .expect_code(2)
        .expect_words(&["is read by this command"]);
    let notes = folder.path().join("notes");
    std::fs::write(&notes, "mine").unwrap();
    bateleur(&["check", "--compile", notes.to_str().unwrap(), &schedule]).end().expect_code(2);
    assert_eq!(std::fs::read_to_string(&notes).unwrap(), "mine");
    bateleur(&["check", "--compile", &plan, &schedule]).end().expect_code(0);
    std::fs::write(&schedule, "nothing").unwrap();
    let before = std::fs::read(&plan).unwrap();
    bateleur(&["check", "--compile", &plan, &schedule]).end().expect_code(2);
    assert_eq!(std::fs::read(&plan).unwrap(), before, "the file that was there stays");
}

/// A line of `/proc/PID/status`.
fn status(pid: i32, key: &str) -> String {
    let text = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    text.lines().find_map(|line| line.strip_prefix(key)).unwrap_or_else(|| panic!("{key}")).trim().to_owned()
}

#[test]
fn daemon_has_the_capabilities_that_its_page_names_and_no_other() {
    if !rustix::process::geteuid().is_root() {
        return eprintln!("not tried: an ordinary user has no capability to drop");
    }
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let page = std::fs::read_to_string(bateleur_tests::repository().join("docs/src/trusted.md")).unwrap();
    let used = bateleur_system::privileges::USED;
    let (mut numbers, mut named) = (0_u64, page.matches("`CAP_").count());
    for (one, name, _) in used {
        assert!(page.contains(&format!("`{name}`")), "{name} is not on the page");
        numbers |= one.bits();
    }
    named -= page.matches("`CAP_SYS_ADMIN` alone").count();
    assert_eq!(named, used.len(), "the page names no other");
    compiled(folder.path());
    let schedule = folder.path().join("test.toml").display().to_string();
    let mut module = bateleur(&["run", "--schedule", &schedule]);
    module.await_words("partitions are ready");
    for key in ["CapEff:", "CapPrm:", "CapBnd:"] {
        let has = u64::from_str_radix(&status(module.pid(), key), 16).unwrap();
        assert_eq!(has & !numbers, 0, "{key} {has:x}");
    }
    assert_eq!(status(module.pid(), "Name:"), "bateleurd");
    let guard = process_named(module.pid(), "guard");
    assert_eq!(u64::from_str_radix(&status(guard.pid, "CapEff:"), 16).unwrap() & !numbers, 0);
    for helper in ["channel-holder", "one"] {
        let process = process_named(module.pid(), helper);
        assert_eq!(status(process.pid, "CapEff:"), "0000000000000000", "{helper}");
    }
    module.signal(Signal::TERM);
    module.end().expect_code(0);
}

fn pipe(path: &Path) -> File {
    let mode = rustix::fs::Mode::from_raw_mode(0o666);
    rustix::fs::mknodat(rustix::fs::CWD, path, rustix::fs::FileType::Fifo, mode, 0).unwrap();
    let flags = rustix::fs::OFlags::NONBLOCK.bits().cast_signed();
    File::options().read(true).custom_flags(flags).open(path).unwrap()
}

/// Logs on a disk that hangs: pipes of one page that nobody reads.
#[test]
fn disk_that_hangs_delays_no_restart_and_no_order_on_the_wall_clock() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let plan = compiled(folder.path());
    let out = folder.path().join("out");
    std::fs::create_dir(&out).unwrap();
    let pipes = ["windows.csv", "health.jsonl"].map(|name| pipe(&out.join(name)));
    for one in &pipes {
        rustix::pipe::fcntl_setpipe_size(one, 4096).unwrap();
    }
    let order = order(folder.path(), &json!({ "output": out }));
    let mut module = daemon(&[&plan, &order]);
    module.await_words("partitions are ready");
    // 100 windows in a second are 8 KB of lines; each death is a line more.
    let begun = Instant::now();
    let mut killed = 0;
    while begun.elapsed() < Duration::from_secs(10) {
        process_named(module.pid(), "one").signal(Signal::KILL);
        killed += 1;
        let back = || (module.said().matches("one: back after").count() == killed).then_some(());
        assert!(await_some(Duration::from_secs(5), back).is_some(), "{}", module.said());
        std::thread::sleep(Duration::from_millis(2_500)); // less often than the budget allows
    }
    bateleur(&["kill", "other", "--module", &module.pid().to_string()]).end().expect_code(0);
    let told = || module.said().contains("other: back after").then_some(());
    assert!(await_some(Duration::from_secs(5), told).is_some(), "{}", module.said());
    // The disk is back: nothing was lost.
    let readers = pipes.map(|mut pipe| {
        std::thread::spawn(move || {
            let (mut text, mut bytes) = (Vec::new(), [0; 4096]);
            let begun = Instant::now();
            while begun.elapsed() < Duration::from_secs(10) {
                match pipe.read(&mut bytes) {
                    Ok(0) => break,
                    Ok(count) => text.extend_from_slice(&bytes[..count]),
                    Err(_) => std::thread::sleep(Duration::from_millis(1)),
                }
            }
            String::from_utf8(text).unwrap()
        })
    });
    module.signal(Signal::TERM);
    module.end().expect_code(0);
    let [windows, health] = readers.map(|reader| reader.join().unwrap());
    assert!(windows.lines().count() > 1000 && windows.ends_with('\n'), "{}", windows.lines().count());
    assert_eq!(health.matches("\"killed\"").count(), killed + 1, "{health}");
}
