//! Requests, answers, and the lines that carry them. No sockets, no time.

use serde::{Deserialize, Serialize};

use super::status::{ChannelStatus, LinkName, Status};

/// Bytes of a request with its line end: the longest sensible one names a file for a recording (a path has 4096 bytes at
/// most). A client that sends more without a line end is cut off; a larger value would only let it hold more memory.
pub const LONGEST_REQUEST: usize = 8192;

/// What a client asks.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "ask", rename_all = "snake_case", deny_unknown_fields)]
pub enum Request {
    /// How the module and its partitions are.
    Status,
    /// Ends a partition's process with SIGKILL; its health table decides what follows.
    Kill {
        /// The partition.
        partition: String,
    },
    /// Ends a partition until it is started.
    Stop {
        /// The partition.
        partition: String,
    },
    /// Starts a partition that is idle or stopped.
    Start {
        /// The partition.
        partition: String,
    },
    /// Holds a partition: it gets no windows until it is thawed.
    Freeze {
        /// The partition.
        partition: String,
    },
    /// Lets a held partition go on.
    Thaw {
        /// The partition.
        partition: String,
    },
    /// The channels.
    Ports,
    /// What the links of the module are called.
    Links,
    /// From now on the connection carries every message of some channels, as an [`super::Observation`] a line; nothing more
    /// can be asked on it.
    Watch {
        /// Ports of the channels, `partition.port`; `None`: all channels.
        ports: Vec<String>,
    },
    /// From now on each line of the client, a [`super::Publication`], is a message that is written into a port which the plan leaves to
    /// the operator, and each is answered; nothing more can be asked on the connection.
    Publish {
        /// Either end of the port's channel, `partition.port`.
        port: String,
    },
    /// Provokes a fault, as the monitor injects them.
    Inject {
        /// A partition, a port or a part of the executive.
        target: String,
        /// The fault.
        fault: String,
    },
    /// Changes to another schedule with the next major frame.
    Schedule {
        /// The schedule.
        name: String,
    },
}

/// What it is told.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "answer", rename_all = "snake_case")]
pub enum Answer {
    /// The order was carried out.
    Done {
        /// What was done.
        text: String,
    },
    /// It was not.
    Refused {
        /// Why, and what to do about it.
        why: String,
    },
    /// The server has too many clients: nothing was asked yet, and it may be tried again.
    Busy,
    /// An observer has the connection.
    Watching,
    /// A publisher has the connection.
    Publishing,
    /// A message was written.
    Published {
        /// How many of this publisher it was.
        sequence: u64,
        /// Ports that it was sent to, and processes that look on.
        receivers: u64,
    },
    /// The figures.
    Status(Box<Status>),
    /// The links.
    Links {
        /// In the order of the plan.
        links: Vec<LinkName>,
    },
    /// The channels.
    Ports {
        /// In the order of the plan.
        channels: Vec<ChannelStatus>,
    },
}

impl Answer {
    /// A refusal.
    pub fn refused(why: impl Into<String>) -> Self {
        Self::Refused { why: why.into() }
    }

    /// As a line.
    #[must_use]
    pub fn line(&self) -> Vec<u8> {
        let mut line =
            serde_json::to_vec(self).unwrap_or_else(|_| br#"{"answer":"refused","why":"-"}"#.to_vec());
        line.push(b'\n');
        line
    }
}

/// A client has sent more than [`LONGEST_REQUEST`] bytes without a line end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TooLong;

/// Takes bytes as they come and gives lines; holds [`LONGEST_REQUEST`] bytes at most.
#[derive(Debug, Default)]
pub struct Lines {
    waiting: Vec<u8>,
}

impl Lines {
    /// Bytes that it can still take.
    #[must_use]
    pub fn room(&self) -> usize {
        LONGEST_REQUEST - self.waiting.len()
    }

    /// Adds bytes.
    ///
    /// # Errors
    /// They do not fit: the line in them has no end within its limit.
    pub fn add(&mut self, bytes: &[u8]) -> Result<(), TooLong> {
        if bytes.len() > self.room() {
            return Err(TooLong);
        }
        self.waiting.extend_from_slice(bytes);
        if self.room() == 0 && !self.waiting.contains(&b'\n') { Err(TooLong) } else { Ok(()) }
    }

    /// The next whole request, or what is wrong with it.
    pub fn next_request(&mut self) -> Option<Result<Request, String>> {
        loop {
            let end = self.waiting.iter().position(|byte| *byte == b'\n')?;
            let line: Vec<u8> = self.waiting.drain(..=end).collect();
            if !line.trim_ascii().is_empty() {
                let parsed = serde_json::from_slice(&line);
                return Some(parsed.map_err(|error| format!("not a request: {error}")));
            }
        }
    }

    /// Nothing more comes: what has begun is whole. False: there is nothing left.
    pub fn end(&mut self) -> bool {
        let Some(last) = self.waiting.last() else { return false };
        if *last != b'\n' && self.room() > 0 {
            self.waiting.push(b'\n');
        }
        true
    }

    /// Whether a request has begun and not ended.
    #[must_use]
    pub fn is_broken_off(&self) -> bool {
        !self.waiting.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn request_in_pieces_is_one_request() {
        let mut lines = Lines::default();
        for piece in [&b"{\"ask\":\"ki"[..], b"ll\",\"partition\"", b":\"imu\"}", b"\n\n{\"ask\""] {
            assert_eq!(lines.next_request(), None);
            lines.add(piece).unwrap();
        }
        assert_eq!(lines.next_request(), Some(Ok(Request::Kill { partition: "imu".into() })));
        assert_eq!(lines.next_request(), None);
        assert!(lines.is_broken_off());
    }

    #[test]
    fn request_without_a_line_end_is_whole_when_nothing_more_comes() {
        let mut lines = Lines::default();
        lines.add(b"\n{\"ask\":\"status\"}").unwrap();
        assert_eq!(lines.next_request(), None);
        assert!(lines.end());
        assert_eq!(lines.next_request(), Some(Ok(Request::Status)));
        assert!(!lines.end());
    }

    #[test]
    fn unknown_request_is_refused_with_what_is_known() {
        let mut lines = Lines::default();
        lines.add(b"{\"ask\":\"fly\"}\n").unwrap();
        let why = lines.next_request().unwrap().unwrap_err();
        assert!(why.contains("fly") && why.contains("status"), "{why}");
    }

    #[test]
    fn line_without_an_end_is_cut_off_at_the_limit() {
        let mut lines = Lines::default();
        assert_eq!(lines.add(&[b'x'; LONGEST_REQUEST - 1]), Ok(()));
        assert_eq!(lines.add(b"x"), Err(TooLong));
    }

    proptest! {
        #[test]
        fn any_bytes_in_any_pieces_hold_bounded_memory_and_end_in_answers(
            pieces in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..600), 0..80)
        ) {
            let mut lines = Lines::default();
            for piece in pieces {
                let fits = piece.len() <= lines.room();
                if lines.add(&piece).is_err() {
                    prop_assert!(!fits || lines.room() == 0);
                    return Ok(());
                }
                while lines.next_request().is_some() {}
                prop_assert!(lines.waiting.len() <= LONGEST_REQUEST);
                prop_assert!(!lines.waiting.contains(&b'\n'));
            }
        }

        #[test]
        fn what_is_written_is_read_whatever_the_pieces(
            names in prop::collection::vec(".{0,40}", 0..20), cut in 1_usize..50
        ) {
            let asked: Vec<_> = names.into_iter().map(|partition| Request::Kill { partition }).collect();
            let text: Vec<u8> = asked.iter().flat_map(|request| {
                let mut line = serde_json::to_vec(request).unwrap();
                line.push(b'\n');
                line
            }).collect();
            let (mut lines, mut read) = (Lines::default(), Vec::new());
            for piece in text.chunks(cut) {
                lines.add(piece).unwrap();
                while let Some(request) = lines.next_request() {
                    read.push(request.unwrap());
                }
            }
            prop_assert_eq!(read, asked);
        }
    }
}
