//! The text of socketcand, over TCP: messages between `<` and `>`, words between blanks.
//!
//! The server greets (`< hi >`), the client opens a bus (`< open vcan0 >`) and asks for raw mode; then frames go both ways. No CAN FD.

use crate::frame::{Frame, Id, Kind};

/// The port that servers use.
pub const PORT: u16 = 29_536;
/// The port that beacons are sent to.
pub const BEACON_PORT: u16 = 42_000;
/// Longest message that is collected, bytes; the real ones stay below 80.
pub const MESSAGE_BYTES: usize = 256;

/// What a client says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Request {
    /// `< open NAME >`.
    Open(String),
    /// `< rawmode >`.
    RawMode,
    /// `< send ID LENGTH BYTES… >`.
    Send(Frame),
    /// `< echo >`: is the server alive?
    Echo,
    /// Anything else, or a frame that is none; the words.
    Unknown(String),
}

/// Finds messages in a stream.
#[derive(Debug, Default)]
pub struct Decoder {
    message: Vec<u8>,
    inside: bool,
    /// Messages that were too long, or did not end before the next one began.
    pub refused: u64,
}

impl Decoder {
    /// One that has read nothing.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes a byte; gives the words of the message that it ends.
    pub fn push(&mut self, byte: u8) -> Option<String> {
        match byte {
            b'<' => {
                self.refused += u64::from(self.inside);
                self.message.clear();
                self.inside = true;
            }
            b'>' if self.inside => {
                self.inside = false;
                return Some(String::from_utf8_lossy(&self.message).trim().to_owned());
            }
            _ if self.inside && self.message.len() < MESSAGE_BYTES => self.message.push(byte),
            _ if self.inside => {
                self.refused += 1;
                self.inside = false;
            }
            _ => {}
        }
        None
    }
}

/// What a client means.
pub fn request(words: &str) -> Request {
    let unknown = || Request::Unknown(words.to_owned());
    let mut parts = words.split_ascii_whitespace();
    match parts.next() {
        Some("open") => parts.next().map_or_else(unknown, |name| Request::Open(name.to_owned())),
        Some("rawmode") => Request::RawMode,
        Some("echo") => Request::Echo,
        Some("send") => sent(parts).map_or_else(unknown, Request::Send),
        _ => unknown(),
    }
}

/// Three digits or fewer are a standard identifier, as in the real server.
fn sent<'a>(mut parts: impl Iterator<Item = &'a str>) -> Option<Frame> {
    let id = parts.next()?;
    let number = u32::from_str_radix(id, 16).ok()?;
    let id = if id.len() > 3 { Id::extended(number) } else { Id::standard(number) }?;
    let length: usize = parts.next()?.parse().ok()?;
    let data: Vec<u8> = parts.map(|byte| u8::from_str_radix(byte, 16)).collect::<Result<_, _>>().ok()?;
    (data.len() == length).then(|| Frame::new(id, Kind::Data, &data).ok())?
}

/// The message that tells a client of a frame at `time_ns`. `None` if the protocol has none for it (FD, remote, errors).
pub fn frame(frame: &Frame, time_ns: u64) -> Option<String> {
    if frame.kind() != Kind::Data {
        return None;
    }
    let data: String = frame.data().iter().map(|byte| format!("{byte:02X}")).collect();
    let (seconds, micros) = (time_ns / 1_000_000_000, time_ns / 1_000 % 1_000_000);
    Some(format!("< frame {} {seconds}.{micros:06} {data} >", frame.id()))
}

/// The beacon that a server broadcasts.
pub fn beacon(name: &str, address: &str, bus: &str) -> String {
    format!(
        "<CANBeacon name=\"{}\" type=\"SocketCAN\" description=\"Bateleur CAN gateway\">\
         <URL>can://{address}</URL><Bus name=\"{}\"/></CANBeacon>",
        escaped(name),
        escaped(bus)
    )
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn messages(text: &[u8]) -> Vec<String> {
        let mut decoder = Decoder::new();
        text.iter().filter_map(|byte| decoder.push(*byte)).collect()
    }

    #[test]
    fn several_messages_in_one_segment_and_one_in_several_are_read() {
        assert_eq!(messages(b"< open vcan0 >< rawmode >"), ["open vcan0", "rawmode"]);
        let mut decoder = Decoder::new();
        assert!(b"< ope".iter().all(|byte| decoder.push(*byte).is_none()));
        let rest: Vec<String> = b"n can1 >".iter().filter_map(|byte| decoder.push(*byte)).collect();
        assert_eq!(
            rest.iter().map(|words| request(words)).collect::<Vec<_>>(),
            [Request::Open("can1".into())]
        );
    }

    #[test]
    fn frames_are_read_as_clients_send_them_and_written_as_they_expect_them() {
        let sent = request("send 1AAAAAAA 2 1 f1");
        assert_eq!(sent, Request::Send(Frame::classic(Id::Extended(0x1aaa_aaaa), &[1, 0xf1])));
        assert_eq!(request("send 7f 0"), Request::Send(Frame::classic(Id::Standard(0x7f), &[])));
        let heard = Frame::classic(Id::Standard(0x123), &[0x1a, 0x22, 3, 0x44]);
        assert_eq!(frame(&heard, 23_424_242_000).unwrap(), "< frame 123 23.424242 1A220344 >");
        assert_eq!(frame(&Frame::classic(Id::Extended(1), &[]), 0).unwrap(), "< frame 00000001 0.000000  >");
        assert_eq!(frame(&Frame::remote(Id::Standard(1), 0).unwrap(), 0), None);
    }

    #[test]
    fn what_is_no_request_is_told_apart() {
        for words in [
            "",
            "send",
            "send xyz 0",
            "send 1 9 0 0 0 0 0 0 0 0 0",
            "send 1 2 3",
            "send 1 1 100",
            "open",
            "fly",
        ] {
            assert_eq!(request(words), Request::Unknown(words.into()));
        }
        let mut decoder = Decoder::new();
        let endless = [b"<".to_vec(), vec![b'a'; 1_000], b"> <<< rawmode >".to_vec()].concat();
        let read: Vec<String> = endless.iter().filter_map(|byte| decoder.push(*byte)).collect();
        assert_eq!((read, decoder.refused), (vec!["rawmode".to_owned()], 3));
    }

    #[test]
    fn the_beacon_is_the_one_that_clients_look_for() {
        let text = beacon("north & south", "127.0.0.1:29536", "vcan0");
        assert!(text.starts_with("<CANBeacon name=\"north &amp; south\" type=\"SocketCAN\""));
        assert!(text.ends_with("<URL>can://127.0.0.1:29536</URL><Bus name=\"vcan0\"/></CANBeacon>"));
    }

    proptest! {
        #[test]
        fn message_behind_any_bytes_is_read_and_what_is_no_request_is_unknown(
            bytes in proptest::collection::vec(any::<u8>(), 0..300)
        ) {
            let all = messages(&[bytes.as_slice(), b"< send 123 1 ff >"].concat());
            let (last, before) = all.split_last().unwrap();
            prop_assert_eq!(request(last), Request::Send(Frame::classic(Id::Standard(0x123), &[0xff])));
            for words in before {
                let known = ["open", "rawmode", "echo", "send"];
                let is_known = words.split_ascii_whitespace().next().is_some_and(|word| known.contains(&word));
                prop_assert!(is_known || request(words) == Request::Unknown(words.clone()));
            }
        }
    }
}
