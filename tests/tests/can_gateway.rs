//! The CAN gateway as a program, with other people's programs on its buses.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};

use bateleur_tests::{PATIENCE, Peer, among_others, await_some, program};
use serde_json::{Value, json};

/// A gateway that runs; it ends when dropped.
struct Gateway {
    child: Child,
    _input: ChildStdin,
    ready: Value,
}

impl Gateway {
    fn start(folder: &Path, name: &str, arguments: &[&str]) -> Self {
        let mut child = Command::new(program("can_gateway"))
            .args(["run", "--ready", "--listen", "127.0.0.1:0", "--name", name, "--status"])
            .arg(folder.join(name))
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let input = child.stdin.take().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        Self { child, _input: input, ready: serde_json::from_str(&line).unwrap() }
    }

    fn address(&self) -> &str {
        self.ready["listening"].as_str().unwrap()
    }

    fn port_of_server(&self) -> String {
        self.ready["socketcand"].as_str().unwrap().rsplit(':').next().unwrap().to_owned()
    }
}

impl Drop for Gateway {
    fn drop(&mut self) {
        let _ = self.child.kill(); // it may have ended
        let _ = self.child.wait(); // as above
    }
}

fn status(folder: &Path, name: &str) -> Value {
    let told = Command::new(program("can_gateway"))
        .args(["status", "--format", "json", "--status"])
        .arg(folder.join(name))
        .output()
        .unwrap();
    serde_json::from_slice(&told.stdout).unwrap()
}

fn frame(id: u32, extended: bool, data: &[u8]) -> Value {
    json!({ "id": id, "extended": extended, "data": data })
}

fn say(peer: &mut Peer, frames: &[Value]) {
    frames.iter().for_each(|frame| peer.say(frame));
    peer.say(&Value::Null);
}

#[test]
fn nodes_of_python_can_meet_over_socketcand_two_gateways_and_a_serial_adapter() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let first = Gateway::start(
        folder.path(),
        "first",
        &["--bus", "none", "--socketcand", "127.0.0.1:0", "--socketcand-bus", "vcan0"],
    );
    let link = folder.path().join("can0");
    let adapter = format!("slcan-pty:{}", link.display());
    let _second = Gateway::start(folder.path(), "second", &["--bus", &adapter, "--peer", first.address()]);
    let port = first.port_of_server();
    let over_tcp = ["--interface", "socketcand", "--channel", "vcan0", "--port", &port, "--expect", "50"];
    let Some(mut over_tcp) = Peer::start("bus.py", &over_tcp) else { return };
    let Some(mut serial) = Peer::start(
        "bus.py",
        &["--interface", "slcan", "--channel", link.to_str().unwrap(), "--expect", "3"],
    ) else {
        return;
    };
    let found = await_some(PATIENCE, || (status(folder.path(), "first")["state"] == "forward").then_some(()));
    assert!(found.is_some(), "they never found each other");
    let three =
        [frame(0x123, false, &[1, 2, 3]), frame(0x1abc_def0, true, &[]), frame(0x7ff, false, &[255; 8])];
    let fifty: Vec<Value> = (0..50_u8).map(|value| frame(0x100, false, &[value, 0, 0x2a])).collect();
    say(&mut over_tcp, &three);
    say(&mut serial, &fifty);
    assert_eq!(over_tcp.finish()["heard"], Value::from(fifty));
    let mut heard = serial.finish()["heard"].as_array().unwrap().clone();
    let mut expected = three.to_vec();
    // Frames that wait together are sent in the order of arbitration.
    [&mut heard, &mut expected].into_iter().for_each(|list| list.sort_by_key(|frame| frame["id"].as_u64()));
    assert_eq!(heard, expected);
    for name in ["first", "second"] {
        let status = status(folder.path(), name);
        assert_eq!(status["lost_frames"], 0, "{status:#}");
    }
}

#[test]
fn what_can_not_run_says_why_and_ends_with_two() {
    let run = |arguments: &[&str]| {
        let ended = Command::new(program("can_gateway")).args(arguments).output().unwrap();
        assert_eq!(ended.status.code(), Some(2), "{arguments:?}");
        String::from_utf8(ended.stderr).unwrap()
    };
    assert!(run(&["run"]).contains("--bus socketcan:can0"));
    assert!(run(&["run", "--bus", "slcan:/dev/nowhere9"]).contains("plugged in"));
    let no_interface = run(&["run", "--bus", "socketcan:nocan9"]);
    assert!(
        no_interface.contains("no CAN sockets") || no_interface.contains("no such interface"),
        "{no_interface}"
    );
    assert!(run(&["run", "--bus", "can0"]).contains("names no bus"));
    assert!(run(&["run", "--config", "/nowhere.toml"]).contains("cannot read"));
    assert!(run(&["status", "--status", "/nowhere"]).contains("no gateway tells"));
}
