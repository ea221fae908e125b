//! A partition that has been taken over tries everything that it should not be able to do: each attempt fails, and how it
//! fails is what the book promises. Where a wall is missing on this machine, the test says so and ends.

use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;
use std::time::Duration;

use bateleur_tests::{
    Ended, Sketch, Traces, alone, among_others, await_some, bateleur, children_of, process_named, taken,
};
use rustix::process::Signal;

const FILTERS: &str = "a partition that asks the kernel for what no partition needs is ended";
const RULES: &str = "a partition opens no file but those that it was granted";
const CHANNELS: &str = "a partition opens no channel but its own";
const SIGNALS: &str = "a partition can signal nobody else";
const MEMORY: &str = "a partition uses no more memory than it was granted";
const TASKS: &str = "a partition has no more threads and processes than it declared";
const READ_ONLY: &str = "a partition sees the file system read-only";

/// Whether this machine holds a promise.
fn holds(ended: &Ended, promise: &str) -> bool {
    let lacks = ended.stderr.contains(&format!("not guaranteed here: {promise}"));
    if lacks {
        eprintln!("skipped: not guaranteed here: {promise}");
    }
    !lacks
}

fn sketch(keys: &str) -> Sketch {
    let port = |name: &str, direction: &str, more: &str| {
        format!(
            "{name} = {{ direction = \"{direction}\", kind = \"sampling\", message = \"FunctionStatus\"{more} }}"
        )
    };
    let source =
        |partition: &str, name: &str| format!("[partition.{partition}.port]\n{}", port(name, "source", ""));
    let destination = |partition: &str| {
        format!("[partition.{partition}.port]\n{}", port("heard", "destination", ", refresh = \"60ms\""))
    };
    Sketch::new()
        .table("[[channel]]\nsource = \"before.count\"\ndestinations = [\"after.heard\"]")
        .table("[[channel]]\nsource = \"middle.own\"\ndestinations = [\"ear.heard\"]")
        .partition("before", "counter", 1000, &source("before", "count"))
        .partition("middle", "hostile", 3000, &format!("{keys}\n{}", source("middle", "own")))
        .partition("ear", "counter", 1000, &destination("ear"))
        .partition("after", "counter", 1000, &destination("after"))
}

/// A run in which `middle` makes one attempt, with further `keys` of its own.
fn run(attempt: &str, target: &str, keys: &str) -> Ended {
    let folder = tempfile::tempdir().unwrap();
    let attributes =
        format!("attributes = {{ attempt = \"{attempt}\", target = \"path:{target}\" }}\n{keys}");
    let schedule = sketch(&attributes).write(folder.path());
    let ended = bateleur(&["run", "--fast", "--schedule", &schedule, "--until", "0.6"]).end().expect_code(0);
    let others = ["before", "ear", "after"];
    let windows = ended.windows();
    let mut theirs = windows.iter().filter(|window| others.contains(&window.partition.as_str()));
    assert!(theirs.all(|window| window.closed_ns.is_some()), "others lost a window:\n{}", ended.stderr);
    assert!(ended.faults().iter().all(|fault| fault.partition == "middle"), "{:#?}", ended.faults());
    ended
}

/// What the partition said came of it.
#[track_caller]
fn came_of(ended: &Ended) -> String {
    let line = ended.stderr.lines().find_map(|line| line.split_once("came of it: "));
    line.unwrap_or_else(|| panic!("it said nothing; faults {:#?}\n{}", ended.faults(), ended.stderr))
        .1
        .to_owned()
}

/// That the attempt ended the partition as an illegal request.
#[track_caller]
fn assert_ended_by_it(attempt: &str, keys: &str) {
    let _turn = among_others();
    let ended = run(attempt, "", keys);
    if !holds(&ended, FILTERS) {
        return;
    }
    assert!(!ended.stderr.contains("came of it"), "it lived on:\n{}", ended.stderr);
    let faults = ended.faults();
    let first = faults.first().unwrap_or_else(|| panic!("no fault:\n{}", ended.stderr));
    assert_eq!(first.error, "illegal_request", "{first:?}");
    assert!(first.detail.contains("SIGSYS"), "{first:?}");
}

/// What the partition is told of each of these calls, without and with the family that grants it. Calls that only ask are answered.
const BY_NEED: &[(&str, &str, &str, &str)] = &[
    ("timer", "refused EPERM", "timers", "allowed 0"),
    ("timerfd", "refused EPERM", "timers", "allowed"),
    ("inotify", "refused EPERM", "inotify", "allowed"),
    ("reserve", "refused EPERM", "file_operations", ""),
    ("mode", "refused ENOSYS", "file_operations", "refused"),
    ("synchronise", "allowed 0", "", ""),
    ("splice", "refused EPERM", "file_operations", ""),
    ("queue", "refused EPERM", "ipc_objects", "allowed"),
    ("value", "refused EPERM", "queued_signals", ""),
    ("barrier", "refused EPERM", "memory_control", "allowed"),
    ("advice", "refused ENOSYS", "memory_control", ""),
    ("pipe", "refused ENOSYS", "", ""),
    ("device", "refused ENOSYS", "", ""),
    ("limits", "refused EPERM", "", ""),
    ("huge", "refused EPERM", "", ""),
];

#[test]
fn calls_that_others_pay_for_are_refused_unless_the_plan_names_them() {
    let _turn = among_others();
    for (attempt, without, family, with) in BY_NEED {
        let ended = run(attempt, "", "");
        if !holds(&ended, FILTERS) {
            return;
        }
        assert_eq!(came_of(&ended), *without, "{attempt}");
        if !family.is_empty() {
            let said = came_of(&run(attempt, "", &format!("system_calls = [\"{family}\"]")));
            assert!(said.contains(with) && said != *without, "{attempt} with {family}: {said}");
        }
    }
}

macro_rules! ended_by {
    ($($name:ident: $attempt:literal, $keys:literal;)*) => {
        $(#[test]
        fn $name() {
            assert_ended_by_it($attempt, $keys);
        })*
    };
}

ended_by! {
    partition_that_traces_processes_is_ended: "ptrace", "";
    partition_that_reads_others_memory_is_ended: "process_vm", "";
    partition_that_changes_its_affinity_is_ended: "affinity", "";
    partition_that_changes_its_scheduling_class_is_ended: "class", "";
    partition_that_changes_its_scheduling_attributes_is_ended: "attributes", "";
    partition_that_changes_its_priority_is_ended: "priority", "";
    partition_that_wants_to_outlive_the_executive_is_ended: "death", "";
    partition_that_types_into_a_terminal_is_ended: "type", "";
    partition_that_mounts_is_ended: "mount", "";
    partition_that_copies_a_mount_is_ended: "open_tree", "";
    partition_that_changes_its_root_is_ended: "chroot", "";
    partition_that_joins_a_namespace_is_ended: "setns", "";
    partition_that_makes_a_namespace_is_ended: "unshare", "";
    partition_that_loads_a_program_into_the_kernel_is_ended: "bpf", "";
    partition_that_counts_events_of_the_processor_is_ended: "perf", "";
    partition_that_uses_the_kernels_keys_is_ended: "keyctl", "";
    partition_that_uses_io_uring_is_ended: "io_uring", "";
    partition_that_handles_page_faults_is_ended: "userfaultfd", "";
    partition_that_loads_another_kernel_is_ended: "kexec", "";
    partition_that_reboots_the_machine_is_ended: "reboot", "";
    partition_that_loads_a_module_is_ended: "module", "";
    partition_that_changes_its_personality_is_ended: "personality", "";
    partition_that_sets_the_clock_is_ended: "clock", "";
    partition_without_network_that_opens_a_socket_is_ended: "inet", "";
    partition_without_network_that_opens_a_stream_is_ended: "inet6", "";
    partition_without_network_that_binds_a_port_is_ended: "udp", "";
    partition_without_network_that_connects_is_ended: "connect", "";
    partition_with_network_that_opens_a_raw_socket_is_ended: "raw", "network = true";
    partition_with_network_that_opens_a_packet_socket_is_ended: "packet", "network = true";
    partition_with_network_that_opens_a_virtual_machine_socket_is_ended: "vsock", "network = true";
    partition_with_network_that_opens_a_cipher_socket_is_ended: "alg", "network = true";
    partition_of_one_thread_that_forks_is_ended: "fork", "";
    partition_of_one_thread_that_starts_another_is_ended: "threads", "";
}

/// What comes of an attempt that is refused, where the promise holds.
#[track_caller]
fn assert_comes_of_it(promise: &str, attempt: &str, target: &str, keys: &str, expected: &[&str]) {
    let _turn = among_others();
    let ended = run(attempt, target, keys);
    if holds(&ended, promise) {
        let came = came_of(&ended);
        assert!(expected.contains(&came.as_str()), "{attempt} {target}: {came}");
        assert_eq!(ended.faults(), [], "it is refused and lives on");
    }
}

macro_rules! refused {
    ($($name:ident: $promise:ident, $attempt:literal, $target:literal, $keys:literal => $expected:expr;)*) => {
        $(#[test]
        fn $name() {
            assert_comes_of_it($promise, $attempt, $target, $keys, &$expected);
        })*
    };
}

/// Where something is hidden, and where it is only shut.
const SHUT: [&str; 2] = ["refused ENOENT", "refused EACCES"];
const READ_OR_RULED: [&str; 2] = ["refused EROFS", "refused EACCES"];

refused! {
    session_can_not_be_left: FILTERS, "setsid", "", "" => ["refused EPERM"];
    user_can_not_be_changed: FILTERS, "setuid", "", "" => ["refused EPERM"];
    namespace_can_not_be_made_by_a_child: FILTERS, "namespace", "", "threads = 4" => ["refused ENOSYS"];
    socket_to_the_kernel_is_refused: FILTERS, "netlink", "", "network = true" => ["refused EPERM"];
    socket_by_path_is_refused: FILTERS, "unix", "", "" => ["refused EPERM"];
    system_call_of_the_future_does_not_exist: FILTERS, "unknown", "", "" => ["refused ENOSYS"];
    passwords_can_not_be_read: RULES, "read", "/etc/shadow", "" => ["refused EACCES"];
    users_can_not_be_read: RULES, "read", "/etc/passwd", "" => ["refused EACCES"];
    home_can_not_be_listed: RULES, "list", "/root", "" => ["refused EACCES"];
    root_can_not_be_listed: RULES, "list", "/", "" => ["refused EACCES"];
    temporary_folder_can_not_be_listed: RULES, "list", "/tmp", "" => ["refused EACCES"];
    temporary_folder_can_not_be_written: RULES, "write", "/tmp/bateleur-hostile", "" => READ_OR_RULED;
    shared_memory_can_not_be_written: READ_ONLY, "write", "/dev/shm/bateleur-hostile", "" => READ_OR_RULED;
    libraries_can_not_be_written: RULES, "write", "/usr/lib/bateleur-hostile", "" => READ_OR_RULED;
    own_memory_can_not_be_opened_past_its_protection: RULES, "append", "/proc/self/mem", "" => READ_OR_RULED;
    kernels_settings_can_not_be_written: RULES, "append", "/proc/sys/kernel/core_pattern", "" => READ_OR_RULED;
    first_process_can_not_be_read: RULES, "read", "/proc/1/environ", "" => SHUT;
    disks_can_not_be_listed: RULES, "list", "/dev", "" => ["refused EACCES"];
    control_groups_can_not_be_listed: RULES, "list", "/sys/fs/cgroup", "" => ["refused EACCES"];
    control_group_can_not_be_left: RULES, "append", "/sys/fs/cgroup/unified/cgroup.procs", "" => ["refused EROFS", "refused EACCES", "refused ENOENT"];
    others_processes_can_not_be_read: RULES, "look", "", "" => ["opened 0"];
    others_processes_can_not_be_signalled: SIGNALS, "signal", "", "" => ["reached 0"];
    channels_of_others_can_be_neither_listed_nor_opened: CHANNELS, "channels", "", "" => ["list refused EACCES, open refused ENOENT", "list refused EACCES, open refused EACCES", "list [middle.own], open refused ENOENT"];
    network_that_was_granted_can_be_used: FILTERS, "udp", "", "network = true" => ["[bound]"];
    network_alone_is_no_grant_of_tcp: FILTERS, "connect", "", "network = true" => ["refused EPERM"];
    tcp_that_was_granted_can_be_used: FILTERS, "connect", "", "network = true\nsystem_calls = [\"tcp\"]" => ["refused ECONNREFUSED", "[connected]"];
}

/// Opens, by its very path, what belongs to another partition.
#[test]
fn channel_of_another_can_not_be_opened_by_its_path() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let schedule = sketch("attributes = { attempt = \"channels\" }").write(folder.path());
    let mut module = bateleur(&["run", "--schedule", &schedule, "--until", "100"]);
    module.await_words("partitions are ready");
    let root = PathBuf::from(format!("/dev/shm/bateleur.test.{}/ports", module.pid()));
    assert!(root.join("before.count").is_dir(), "the channels of all lie in {root:?}");
    // As the partition sees it: through its own root, which only somebody outside can look through.
    let middle = process_named(module.pid(), "middle");
    let seen = PathBuf::from(format!("/proc/{}/root", middle.pid));
    let holds = !module.said().contains(&format!("not guaranteed here: {READ_ONLY}"));
    if holds {
        let within = |path: &str| seen.join(root.join(path).strip_prefix("/").unwrap());
        assert!(within("middle.own").is_dir(), "its own");
        assert!(!within("before.count").exists(), "another's");
    }
    module.signal(Signal::TERM);
    module.end().expect_code(0);
}

#[test]
fn output_folder_can_not_be_read() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let secret = folder.path().join("windows.csv");
    std::fs::write(&secret, "what others did").unwrap();
    // Open to everybody as far as file permissions go.
    std::os::unix::fs::chown(folder.path(), None, None).unwrap();
    let open = |path: &std::path::Path, mode| {
        std::fs::set_permissions(path, std::os::unix::fs::PermissionsExt::from_mode(mode)).unwrap();
    };
    open(folder.path(), 0o755);
    open(&secret, 0o644);
    let ended = run("read", secret.to_str().unwrap(), "");
    if holds(&ended, RULES) {
        assert_eq!(came_of(&ended), "refused EACCES");
    }
}

#[test]
fn partition_that_exceeds_its_memory_is_ended() {
    let _turn = among_others();
    let ended = run("memory", "", "");
    if !holds(&ended, MEMORY) {
        return;
    }
    assert!(!ended.stderr.contains("came of it"), "it got more than it was granted:\n{}", ended.stderr);
    let faults = ended.faults();
    let first = faults.first().expect("a fault");
    assert!(["memory_limit", "killed"].contains(&first.error.as_str()), "{first:?}");
}

#[test]
fn forks_end_at_what_was_declared() {
    assert_comes_of_it(TASKS, "fork", "", "threads = 5", &["4 forked, then refused EAGAIN"]);
}

#[test]
fn threads_end_at_what_was_declared() {
    assert_comes_of_it(TASKS, "threads", "", "threads = 3", &["2 started, then refused EAGAIN"]);
}

/// What the log of `middle` takes on the disk, bytes.
fn log_on_disk(folder: &std::path::Path) -> u64 {
    let logs = folder.join("partitions");
    let about = |name| logs.join(name).metadata().ok();
    let blocks = ["middle.log", "middle.log.old"].into_iter().filter_map(about);
    blocks.map(|about| about.len().max(about.blocks() * 512)).sum()
}

/// What the log of a partition may take, bytes.
const LOG_BOUND: u64 = (1 << 20) + (256 << 10) + (64 << 10);

#[test]
fn babbling_partition_does_not_fill_the_disk() {
    let _turn = among_others();
    let ended = run("babble", "", "");
    assert_eq!(came_of(&ended), "wrote 4096 KiB");
    let bytes = log_on_disk(&ended.folder());
    assert!((1..=LOG_BOUND).contains(&bytes), "4 MiB were written, {bytes} bytes are kept");
}

#[test]
fn partition_that_floods_its_standard_error_lives_on_and_fills_no_disk() {
    let _turn = among_others();
    let ended = run("flood", "", "");
    assert_eq!(came_of(&ended), "wrote 204800 KiB");
    assert!(ended.faults().is_empty(), "{:#?}", ended.faults());
    let bytes = log_on_disk(&ended.folder());
    assert!((1..=LOG_BOUND).contains(&bytes), "200 MiB were written, {bytes} bytes are kept");
    let log = std::fs::read(ended.folder().join("partitions/middle.log")).unwrap();
    let log = String::from_utf8_lossy(&log);
    assert!(log.contains(" bytes are left out here\n"), "the log says nothing of what is missing");
}

#[test]
fn standard_error_can_only_be_appended_to() {
    let _turn = among_others();
    let ended = run("stretch", "", "");
    assert_eq!(came_of(&ended), "0 of 6 worked");
}

/// An executive of many partitions has hundreds of descriptors open, a partition may have fewer: no step of a start may need one above its
/// limit.
#[test]
fn sixty_four_partitions_start_behind_all_walls_and_one_that_is_killed_comes_back() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let program = bateleur_tests::program("counter");
    let partition = |number: u32| {
        format!("[partition.p{number}]\nprogram = {program:?}\nmodule = \"test\"\nmemory = \"16MiB\"\n")
    };
    let window = |number: u32| {
        let offset = number * 300;
        format!("    {{ partition = \"p{number}\", offset = \"{offset}us\", duration = \"250us\" }},\n")
    };
    let text = format!(
        "[module.test]\ncores = [1]\n\n[schedule.only]\nmajor_frame = \"20ms\"\nminor_frame = \"20ms\"\nwindow = [\n{}]\n\n{}",
        (0..64).map(window).collect::<String>(),
        (0..64).map(partition).collect::<String>(),
    );
    let schedule = folder.path().join("many.toml");
    std::fs::write(&schedule, text).unwrap();
    let schedule = schedule.to_str().unwrap();
    let run = ["run", "--fast", "--schedule", schedule, "--until", "2", "--kill", "p63@1"];
    let ended = bateleur(&run).end().expect_code(0);
    let faults = ended.faults();
    assert!(faults.iter().all(|fault| fault.partition == "p63"), "{faults:#?}");
    assert!(faults.iter().any(|fault| fault.recovered_ns.is_some()), "{faults:#?}");
    assert!(ended.windows().iter().all(|window| window.partition == "p63" || window.closed_ns.is_some()));
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn partition_that_chatters_in_each_window_on_the_wall_clock_disturbs_nobody() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let schedule = sketch("attributes = { attempt = \"chatter\" }").write(folder.path());
        let ended = bateleur(&["run", "--schedule", &schedule, "--until", "6"]).end().expect_code(0);
        let faults = ended.faults();
        // The time that it takes to write is its own, and so are its overruns; the machine takes others' time by itself now and then.
        let of_the_machine = ["window_overrun", "late_dispatcher", "processor_taken"];
        let harmless = |fault: &bateleur_tests::Fault| of_the_machine.contains(&fault.error.as_str());
        assert!(faults.iter().all(harmless), "{faults:#?}");
        let windows = ended.windows();
        let theirs = windows.iter().filter(|window| window.partition != "middle");
        assert_eq!(taken(theirs), 0, "windows of others:\n{}", ended.stderr);
        let bytes = log_on_disk(&ended.folder());
        assert!((1..=LOG_BOUND).contains(&bytes), "{bytes} bytes are kept");
    }

    #[test]
    fn children_of_a_taken_partition_do_not_survive_the_executive() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let keys = "threads = 4\nattributes = { attempt = \"fork\" }";
        let schedule = sketch(keys).write(folder.path());
        let mut module = bateleur(&["run", "--schedule", &schedule, "--until", "100"]);
        module.await_words("came of it: 3 forked");
        let middle = process_named(module.pid(), "middle");
        let children =
            await_some(Duration::from_secs(5), || Some(children_of(middle.pid)).filter(|all| all.len() == 3));
        assert!(children.is_some(), "three children");
        let traces = Traces::of(module.pid());
        module.signal(Signal::KILL);
        drop(module);
        traces.expect_gone();
    }
}
