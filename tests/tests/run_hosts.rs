//! `bateleur run --hosts`: all modules of a plan with one command, with a message type over the link that nothing here was built with.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::time::{Duration, UNIX_EPOCH};

use bateleur_recording::read;
use bateleur_tests::{among_others, await_some, bateleur, children_of, program, repository};
use rustix::process::Signal;

/// A radar on one host, and who sees its tracks on another; in `folder`, with the messages beside it.
fn schedule(folder: &Path) -> String {
    for file in ["messages/acme/Track.msg", "messages/acme/Echo.msg"] {
        let to = folder.join(file);
        fs::create_dir_all(to.parent().unwrap()).unwrap();
        fs::copy(repository().join("tests").join(file), to).unwrap();
    }
    let partition = |name: &str, module: &str, port: &str| {
        let radar = program("radar").display().to_string();
        let head =
            format!("[partition.{name}]\nprogram = \"{radar}\"\nmodule = \"{module}\"\nmemory = \"96MiB\"\n");
        format!(
            "{head}\n[partition.{name}.port]\n{port}, kind = \"sampling\", message = \"acme/Track\" }}\n\n"
        )
    };
    let window = |name: &str, offset_us: u32| {
        format!("    {{ partition = \"{name}\", offset = \"{offset_us}us\", duration = \"1ms\" }},\n")
    };
    let windows: String = [("radar", 200), ("relay_one", 2000), ("relay_two", 6000), ("screen", 8000)]
        .map(|(name, offset_us)| window(name, offset_us))
        .concat();
    let text = [
        "[network.a]\nrate = \"100Mbit/s\"\n\n",
        "[module.one]\ncores = [1]\naddresses = { a = \"10.99.0.1:15300\" }\n\n",
        "[module.two]\ncores = [1]\naddresses = { a = \"10.99.0.2:15300\" }\nfollows = \"one\"\n\n",
        "[link.tracks]\nmodules = [\"one\", \"two\"]\nkey = \"tracks.key\"\ngap = \"2ms\"\n\n",
        "[schedule.only]\nmajor_frame = \"20ms\"\nminor_frame = \"20ms\"\nwindow = [\n",
        &windows,
        "]\n\n",
        &partition("radar", "one", "track = { direction = \"source\""),
        &partition("screen", "two", "seen = { direction = \"destination\", refresh = \"1s\""),
        "[[channel]]\nsource = \"radar.track\"\ndestinations = [\"screen.seen\"]\n",
    ];
    let path = folder.join("two.toml");
    fs::write(&path, text.concat()).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn modules_of_a_plan_run_together_on_both_clocks_and_a_foreign_type_crosses() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let schedule = schedule(folder.path());
    let clocks = [&["--fast", "--until", "1"][..], &["--until", "4"]];
    for (clock, place) in clocks.iter().flat_map(|clock| [(clock, "--hosts"), (clock, "--hosts=loopback")]) {
        let run = [&["run", place, "--record", "--schedule", &schedule][..], clock].concat();
        let ended = bateleur(&run).end().expect_code(0);
        let apart = place == "--hosts" && is_root();
        let ended = ended.expect_words(&[if apart {
            "each in a network namespace, with the addresses of the plan"
        } else {
            "hosts: over the loopback interface"
        }]);
        let ended =
            ended.expect_words(&["these hosts have a key of their own", "screen: saw something at 2.5 m"]);
        let hosts = ended.folder().join("hosts");
        let log = read(hosts.join("two/ports.mcap"), |_| true).unwrap();
        let seen = log.tracks.values().find(|track| track.message == "acme/Track");
        assert!(seen.is_some_and(|track| track.samples.len() > 20), "{clock:?} {place}");
        let left: Vec<_> = fs::read_dir(&hosts).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        assert_eq!(left.len(), 2, "nothing but the hosts' folders: {left:?}");
        what_reads_a_run_knows_its_modules(&ended.folder());
    }
}

fn what_reads_a_run_knows_its_modules(run: &Path) {
    let run = run.to_str().unwrap();
    let links = bateleur(&["links", run]).end().expect_code(0);
    for words in ["module one at", "link tracks to two: ", "module two at", "link tracks to one: "] {
        assert!(links.stdout.contains(words), "{words:?} is missing in:\n{}", links.stdout);
    }
    // A module that ran there alone, long ago.
    let older = File::create(Path::new(run).join("health.ring")).unwrap();
    older.set_modified(UNIX_EPOCH + Duration::from_secs(1)).unwrap();
    for verb in ["health", "why", "crash"] {
        let advice = "holds the runs of several modules: name the folder of one, such as ";
        bateleur(&[verb, run]).end().expect_code(2).expect_words(&[advice, "hosts/one"]);
    }
}

#[test]
fn same_run_on_the_virtual_clock_comes_out_the_same() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let schedule = schedule(folder.path());
    let heard = |hosts: &str| {
        let kill = ["--kill", "screen@1"];
        let run = ["run", hosts, "--fast", "--until", "2", "--record", "--schedule", &schedule];
        let ended = bateleur(&[&run[..], &kill].concat()).end().expect_code(0);
        let ended = ended.expect_words(&["screen: killed"]);
        let log = read(ended.folder().join("hosts/two/ports.mcap"), |_| true).unwrap();
        log.tracks.into_iter().map(|(topic, track)| (topic, track.samples)).collect::<Vec<_>>()
    };
    let (once, again, elsewhere) = (heard("--hosts"), heard("--hosts"), heard("--hosts=loopback"));
    assert!(once.iter().any(|(_, samples)| samples.len() > 50));
    assert!(once == again, "the messages on the second host are others");
    assert!(once == elsewhere, "they depend on what carries the datagrams");
}

fn is_root() -> bool {
    rustix::process::geteuid().is_root()
}

fn network_of(process: i32) -> Option<PathBuf> {
    fs::read_link(format!("/proc/{process}/ns/net")).ok()
}

#[test]
fn modules_have_networks_of_their_own_and_nothing_is_left_when_the_starter_is_killed() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let schedule = schedule(folder.path());
    for clock in [&[][..], &["--fast", "--until", "1000000"]] {
        let run = [&["run", "--hosts", "--schedule", &schedule][..], clock].concat();
        let mut run = bateleur(&run);
        run.await_words("screen: saw something");
        let starter = run.pid();
        let all = children_of(starter);
        assert!(all.len() >= 6, "two modules, their partitions and relays: {all:?}");
        let networks: BTreeSet<_> = all.iter().filter_map(|process| network_of(process.pid)).collect();
        if is_root() {
            assert!(networks.len() >= 2, "a namespace for each module: {networks:?}");
            let own = network_of(std::process::id() as i32).unwrap();
            assert!(!networks.contains(&own), "nobody is in the machine's network");
        }
        run.signal(Signal::KILL);
        let gone = await_some(Duration::from_secs(30), || {
            all.iter().all(|process| !process.is_alive()).then_some(())
        });
        let left: Vec<_> = all.iter().filter(|process| process.is_alive()).collect();
        assert!(gone.is_some(), "still there with {clock:?}: {left:?}");
        let clock_file = Path::new("/dev/shm").join(format!("bateleur-hosts.{starter}"));
        assert!(!clock_file.exists(), "the shared clock is left with {clock:?}");
        let output = run.folder().join("hosts");
        let left = fs::read_dir(&output).unwrap().flatten().map(|entry| entry.file_name());
        let left: Vec<_> = left.collect();
        assert_eq!(left.len(), 2, "nothing but the hosts' folders: {left:?}");
    }
}

#[test]
fn namespaces_that_can_not_be_are_refused_where_they_were_asked_for_and_done_without_elsewhere() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let schedule = schedule(folder.path());
    let text = fs::read_to_string(&schedule).unwrap();
    let text = text.replace("10.99.0.1", "127.99.0.1").replace("10.99.0.2", "127.99.0.2");
    fs::write(&schedule, text).unwrap();
    let run = ["run", "--hosts=namespaces", "--fast", "--until", "1", "--schedule", &schedule];
    let words = if is_root() { "the address 127.99.0.1, of one computer" } else { "need root" };
    bateleur(&run).end().expect_code(2).expect_words(&[words, "--hosts=loopback"]);
    let run = ["run", "--hosts", "--fast", "--until", "1", "--schedule", &schedule];
    bateleur(&run).end().expect_code(0).expect_words(&["over the loopback interface (", words]);
}

#[test]
fn module_that_can_not_run_ends_the_others_and_one_module_alone_is_refused() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let schedule = schedule(folder.path());
    let text = fs::read_to_string(&schedule).unwrap();
    let at = text.find("[partition.screen]").unwrap();
    let (before, after) = text.split_at(at);
    fs::write(&schedule, before.to_owned() + &after.replacen("/radar\"", "/no_such_program\"", 1)).unwrap();
    let run = ["run", "--hosts", "--schedule", &schedule];
    bateleur(&run).end().expect_code(2).expect_words(&["there is no program"]);
    let one = repository().join("schedule.toml");
    let run = ["run", "--hosts", "--schedule", one.to_str().unwrap()];
    bateleur(&run).end().expect_code(2).expect_words(&["has one module: leave --hosts out"]);
}
