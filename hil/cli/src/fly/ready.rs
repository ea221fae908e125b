//! What a process that the flight has started says first: that it is ready, and where it listens.

use std::io::{BufRead, BufReader, ErrorKind, Read};
use std::net::SocketAddr;
use std::sync::mpsc::channel;
use std::time::Duration;

/// How long it may take to say so. A process that hangs at its start would otherwise hang the flight without a word.
const PATIENCE: Duration = Duration::from_secs(20);

/// The first line of `output`.
///
/// # Errors
/// It can not be read, or does not come in time.
pub(super) fn first_line(output: impl Read + Send + 'static) -> std::io::Result<String> {
    line_within(output, PATIENCE)
}

/// The address in it; nothing where it is another line.
pub(super) fn address(line: &str) -> Option<SocketAddr> {
    let ready: serde_json::Value = serde_json::from_str(line).ok()?;
    ready.get("listening")?.as_str()?.parse().ok()
}

fn line_within(output: impl Read + Send + 'static, patience: Duration) -> std::io::Result<String> {
    let (sender, receiver) = channel();
    // It ends with the process at the latest.
    std::thread::spawn(move || {
        let mut line = String::new();
        let read = BufReader::new(output).read_line(&mut line);
        sender.send(read.map(|_| line))
    });
    let in_vain = |_| Err(std::io::Error::new(ErrorKind::TimedOut, format!("no line within {patience:?}")));
    receiver.recv_timeout(patience).unwrap_or_else(in_vain)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use std::os::unix::net::UnixStream;

    #[test]
    fn process_that_says_nothing_is_given_up_and_what_one_says_is_read() {
        let (mut process, output) = UnixStream::pair().unwrap();
        let silent = line_within(output.try_clone().unwrap(), Duration::from_millis(1));
        assert_eq!(silent.unwrap_err().kind(), ErrorKind::TimedOut);
        let (mut other, output) = UnixStream::pair().unwrap();
        other.write_all(b"{\"listening\": \"127.0.0.1:7\"}\n").unwrap();
        let line = first_line(output).unwrap();
        assert_eq!(address(&line), Some("127.0.0.1:7".parse().unwrap()));
        assert_eq!(address("hello"), None);
        process.write_all(b"late\n").unwrap(); // for the thread that waits
    }
}
