//! The program `link_model` between two sockets, on the wall clock; nothing here judges durations.
#![allow(clippy::unwrap_used)] // as in any test

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, UdpSocket};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::Duration;

struct Model {
    process: Child,
    output: BufReader<ChildStdout>,
}

impl Model {
    fn start(name: &str, settings: &serde_json::Value) -> Self {
        let path =
            std::env::temp_dir().join(format!("bateleur-link-model-{}-{name}.json", std::process::id()));
        std::fs::File::create(&path).unwrap().write_all(settings.to_string().as_bytes()).unwrap();
        let mut process = Command::new(env!("CARGO_BIN_EXE_link_model"))
            .arg(&path)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut output = BufReader::new(process.stdout.take().unwrap());
        let mut line = String::new();
        output.read_line(&mut line).unwrap();
        std::fs::remove_file(path).unwrap();
        assert_eq!(line, "ready\n");
        Self { process, output }
    }

    /// Ends it by its standard input; gives its counts.
    fn end(mut self) -> serde_json::Value {
        drop(self.process.stdin.take());
        let mut text = String::new();
        self.output.read_to_string(&mut text).unwrap();
        assert!(self.process.wait().unwrap().success());
        serde_json::from_str(&text).unwrap()
    }
}

fn socket() -> (UdpSocket, SocketAddr) {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    let address = socket.local_addr().unwrap();
    (socket, address)
}

#[test]
fn every_datagram_is_accounted_for_and_what_arrives_is_what_the_counts_say() {
    let ((one, at_one), (two, at_two)) = (socket(), socket());
    let [to_one, to_two] = [(); 2].map(|()| socket().1);
    let side = |listen: SocketAddr, peer: SocketAddr| serde_json::json!({ "listen": listen, "peer": peer });
    let settings = serde_json::json!({
        "model": { "seed": 4, "delay_ns": 200_000, "jitter_ns": 3_000_000, "loss": 0.2, "duplicate": 0.1 },
        "ways": [{ "network": "a", "link": 5, "first": side(to_two, at_one), "second": side(to_one, at_two) }],
    });
    let model = Model::start("counts", &settings);
    // Until nothing comes any more, long after the last is due; read meanwhile, so that no socket has to drop anything.
    two.set_read_timeout(Some(Duration::from_secs(2))).unwrap();
    let reader = std::thread::spawn(move || {
        let (mut arrived, mut buffer) = (Vec::new(), [0; 64]);
        while let Ok((length, from)) = two.recv_from(&mut buffer) {
            assert_eq!((length, from), (8, to_one));
            arrived.push(u64::from_le_bytes(buffer[..8].try_into().unwrap()));
        }
        arrived
    });
    let count = 300_u64;
    for number in 0..count {
        one.send_to(&number.to_le_bytes(), to_two).unwrap();
        if number % 16 == 0 {
            std::thread::sleep(Duration::from_millis(1)); // as above
        }
    }
    socket().0.send_to(b"not for you", to_two).unwrap();
    let arrived: Vec<u64> = reader.join().unwrap();
    let counts = model.end();
    let there = &counts[0];
    let number = |name: &str| there[name].as_u64().unwrap();
    assert_eq!(number("offered"), count);
    assert_eq!((number("handed_on"), number("on_the_way"), number("unsent")), (arrived.len() as u64, 0, 0));
    assert_eq!(number("arrivals"), arrived.len() as u64);
    let different: std::collections::BTreeSet<_> = arrived.iter().collect();
    assert_eq!(number("lost"), count - different.len() as u64);
    assert_eq!(number("duplicated"), (arrived.len() - different.len()) as u64);
    let firsts = {
        let mut seen = std::collections::BTreeSet::new();
        arrived.iter().copied().filter(|number| seen.insert(*number)).collect::<Vec<_>>()
    };
    let mut highest = 0;
    let reordered = firsts.iter().filter(|number| {
        let after = **number < highest;
        highest = highest.max(**number);
        after
    });
    assert_eq!(number("reordered"), reordered.count() as u64);
    assert_eq!(number("strangers"), 1);
    assert!(number("lost") > 20 && number("duplicated") > 10, "{there}");
}

#[test]
fn a_file_with_an_unknown_key_is_refused_with_its_place() {
    let path = std::env::temp_dir().join(format!("bateleur-link-model-{}-bad.json", std::process::id()));
    std::fs::write(&path, r#"{ "model": { "los": 0.1 }, "ways": [] }"#).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_link_model")).arg(&path).output().unwrap();
    std::fs::remove_file(path).unwrap();
    assert_eq!(output.status.code(), Some(2));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("`los`") && said.contains("line 1"), "{said}");
}
