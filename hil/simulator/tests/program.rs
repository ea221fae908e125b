//! The program: its ready line, its exit codes, its ends.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a panic here is a failed test")]

use std::io::{BufRead, BufReader, Read};
use std::net::UdpSocket;
use std::process::{Child, Command, Stdio};

fn simulator(arguments: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_simulator"))
        .args(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

fn ready_line(child: &mut Child) -> serde_json::Value {
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    serde_json::from_str(&line).unwrap()
}

fn errors(child: &mut Child) -> String {
    let mut text = String::new();
    child.stderr.take().unwrap().read_to_string(&mut text).unwrap();
    text
}

#[test]
fn ends_with_its_standard_input_and_completes_the_log() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("truth.log");
    let arguments = ["--listen", "127.0.0.1:0", "--ready", "--until-stdin-closes", "--truth"];
    let mut child = simulator(&[&arguments[..], &[log.to_str().unwrap()]].concat());
    let ready = ready_line(&mut child);
    assert!(ready["listening"].as_str().unwrap().starts_with("127.0.0.1:"));
    drop(child.stdin.take());
    assert!(child.wait().unwrap().success());
    assert_eq!(bateleur_simulator::truth::read(&log).unwrap(), []);
}

#[test]
fn ends_cleanly_on_sigterm() {
    let mut child = simulator(&["--listen", "127.0.0.1:0", "--ready"]);
    ready_line(&mut child);
    let killed = Command::new("kill").arg(child.id().to_string()).status().unwrap();
    assert!(killed.success());
    assert!(child.wait().unwrap().success());
    assert_eq!(errors(&mut child), "", "nothing happened, so there is nothing to tell");
}

#[test]
fn person_at_a_terminal_is_told_where_it_listens() {
    let mut child = simulator(&["--listen", "127.0.0.1:0", "--until-stdin-closes"]);
    drop(child.stdin.take());
    assert!(child.wait().unwrap().success());
    let said = errors(&mut child);
    assert!(said.contains("listens on 127.0.0.1:") && !said.contains("127.0.0.1:0,"), "{said}");
}

#[test]
fn taken_port_and_unknown_airframe_exit_with_2_and_say_what_to_do() {
    let taken = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let mut child = simulator(&["--listen", &address]);
    assert_eq!(child.wait().unwrap().code(), Some(2));
    assert!(errors(&mut child).contains("choose another port with --listen"));
    let mut child = simulator(&["--listen", "127.0.0.1:0", "--airframe", "concorde"]);
    assert_eq!(child.wait().unwrap().code(), Some(2));
    assert!(errors(&mut child).contains("embedded are \"aerosonde\""));
}
