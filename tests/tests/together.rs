//! Several modules on one virtual clock: their windows come in one order, the same in every run, whatever happens to one of
//! them.

use std::net::UdpSocket;
use std::path::Path;
use std::time::Duration;

use bateleur_tests::{Started, among_others, bateleur, program};
use rustix::process::Signal;

const MS: u64 = 1_000_000;

/// Two modules whose partitions, of which one runs the program `b`, call one listener; the minor frames differ, and some windows begin at one instant.
fn schedule(to: &UdpSocket, b: &str) -> String {
    let caller = format!("network = true\nattributes = {{ to = \"{}\" }}", to.local_addr().unwrap());
    let partition = |name: &str, module: &str| {
        let (runs, keys) = if name == "b" && b == "hanger" { (b, "") } else { ("caller", caller.as_str()) };
        let path = program(runs);
        format!(
            "[partition.{name}]\nprogram = \"{}\"\nmodule = \"{module}\"\nmemory = \"32MiB\"\n{keys}\n",
            path.display()
        )
    };
    format!(
        "[module.one]\ncores = [1]\n[module.two]\ncores = [1]\n{}{}{}{}
[schedule.both]
major_frame = \"40ms\"
minor_frame = \"20ms\"
initial = true
window = [
    {{ partition = \"a\", offset = \"1ms\", duration = \"3ms\" }},
    {{ partition = \"b\", offset = \"9ms\", duration = \"1ms\" }},
    {{ partition = \"c\", offset = \"1ms\", duration = \"1ms\" }},
    {{ partition = \"d\", offset = \"2ms\", duration = \"9ms\" }},
]
",
        partition("a", "one"),
        partition("b", "one"),
        partition("c", "two"),
        partition("d", "two"),
    )
}

struct Pair {
    folder: tempfile::TempDir,
    listener: UdpSocket,
}

impl Pair {
    fn new(b: &str) -> Self {
        let listener = UdpSocket::bind("127.0.0.1:0").unwrap();
        listener.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
        // Room for all calls: on a busy machine many come before they are read.
        rustix::net::sockopt::set_socket_recv_buffer_size_force(&listener, 4 << 20).unwrap();
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("both.toml"), schedule(&listener, b)).unwrap();
        Self { folder, listener }
    }

    fn clock(&self) -> std::path::PathBuf {
        self.folder.path().join("clock")
    }

    fn start(&self, module: &str, place: &str, more: &[&str]) -> Started {
        let text = |path: &Path| path.to_str().unwrap().to_owned();
        let (plan, clock) = (text(&self.folder.path().join("both.toml")), text(&self.clock()));
        let run = ["run", "--fast", "--schedule", &plan, "--module", module];
        let joint = ["--together", &clock, "--place", place];
        bateleur(&[&run[..], &joint, more].concat())
    }

    /// What was heard until `module`s have ended.
    fn hear(&self, mut modules: Vec<Started>) -> Vec<(String, u64)> {
        let mut heard = Vec::new();
        let mut datagram = [0; 64];
        loop {
            match self.listener.recv(&mut datagram) {
                Ok(length) => {
                    let text = String::from_utf8_lossy(&datagram[..length]).into_owned();
                    let (name, start_ns) = text.split_once(' ').unwrap();
                    heard.push((name.to_owned(), start_ns.parse().unwrap()));
                }
                Err(_) if modules.is_empty() => return heard,
                Err(_) => modules.retain_mut(|module| !module.has_ended()),
            }
        }
    }
}

fn flight(kill: &[&str]) -> Vec<(String, u64)> {
    let pair = Pair::new("caller");
    let until = ["--until", "2"];
    let second = pair.start("two", "1/2", &until);
    let first = pair.start("one", "0/2", &[&until[..], kill].concat());
    let heard = pair.hear(vec![first, second]);
    assert!(!pair.clock().exists(), "the last one removes the file");
    heard
}

#[test]
fn windows_of_two_modules_come_in_one_order_and_in_the_same_in_every_run() {
    let _turn = among_others();
    let heard = flight(&[]);
    let frame = |minor: u64| {
        let at = move |offset: u64| minor * 20 * MS + offset * MS;
        [("a", at(1)), ("c", at(1)), ("d", at(2)), ("b", at(9))].map(|(name, at)| (name.to_owned(), at))
    };
    let expected: Vec<_> = (0..100).flat_map(frame).collect();
    assert_eq!(heard, expected);
    assert_eq!(flight(&[]), heard);
}

#[test]
fn restart_in_one_module_takes_no_module_time_of_the_other_and_the_order_stays() {
    let _turn = among_others();
    let kill = ["--kill", "a@1"];
    let heard = flight(&kill);
    assert!(heard.is_sorted_by_key(|(_, start_ns)| *start_ns), "{heard:?}");
    let count = |name: &str| heard.iter().filter(|(heard, _)| heard == name).count();
    assert_eq!((count("b"), count("c"), count("d")), (100, 100, 100));
    assert!((90..100).contains(&count("a")), "{}", count("a"));
    assert_eq!(flight(&kill), heard);
}

#[test]
fn module_that_is_killed_is_waited_for_no_more_and_the_other_flies_on() {
    let _turn = among_others();
    // It hangs in its window at 9 ms, for five seconds of real time: there it is killed.
    let pair = Pair::new("hanger");
    let second = pair.start("two", "1/2", &["--until", "3"]);
    let mut first = pair.start("one", "0/2", &["--until", "3"]);
    first.await_words("partitions are ready");
    std::thread::sleep(Duration::from_millis(500));
    first.signal(Signal::KILL);
    let heard = pair.hear(vec![second]);
    let of_d: Vec<u64> = heard.iter().filter(|(name, _)| name == "d").map(|(_, at)| *at).collect();
    assert_eq!(of_d, (0..150).map(|minor| minor * 20 * MS + 2 * MS).collect::<Vec<_>>());
    assert!(!pair.clock().exists());
}

#[test]
fn file_of_several_modules_that_is_something_else_is_refused_and_left() {
    let _turn = among_others();
    let pair = Pair::new("caller");
    std::fs::write(pair.clock(), "something else").unwrap();
    let ended = pair.start("one", "0/2", &["--until", "1"]).end().expect_code(2);
    ended.expect_words(&["give a name that nothing has yet"]);
    assert_eq!(std::fs::read_to_string(pair.clock()).unwrap(), "something else");
}
