//! Logs that no recorder writes: put together record by record.

use std::path::{Path, PathBuf};

use bateleur_recording::CDR_HEADER;

const MAGIC: &[u8] = b"\x89MCAP0\r\n";

fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat()
}

/// A record of any kind.
pub(crate) fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
    [&[opcode][..], &(body.len() as u64).to_le_bytes(), body].concat()
}

/// The message type `X` as number 1.
pub(crate) fn schema(definition: &str) -> Vec<u8> {
    let name = text("bateleur/msg/X");
    record(3, &[&1_u16.to_le_bytes()[..], &name, &text("ros2msg"), &text(definition)].concat())
}

/// A channel that carries it.
pub(crate) fn channel(id: u16, topic: &str) -> Vec<u8> {
    let numbers = [id.to_le_bytes(), 1_u16.to_le_bytes()].concat();
    record(4, &[&numbers[..], &text(topic), &text("cdr"), &[0; 4]].concat())
}

/// A message.
pub(crate) fn message(channel: u16, sequence: u32, time_ns: u64, bytes: &[u8]) -> Vec<u8> {
    message_behind(&CDR_HEADER, channel, sequence, time_ns, bytes)
}

/// A message behind another header than ours.
pub(crate) fn message_behind(
    header: &[u8; 4],
    channel: u16,
    sequence: u32,
    time_ns: u64,
    bytes: &[u8],
) -> Vec<u8> {
    let (channel, sequence, time) = (channel.to_le_bytes(), sequence.to_le_bytes(), time_ns.to_le_bytes());
    record(5, &[&channel[..], &sequence, &time, &time, header, bytes].concat())
}

/// A whole log of these records.
pub(crate) fn write(path: &Path, records: &[Vec<u8>]) -> PathBuf {
    let (head, end, foot) =
        (record(1, &[text(""), text("hand")].concat()), record(15, &[0; 4]), record(2, &[0; 20]));
    std::fs::write(path, [MAGIC, &head, &records.concat(), &end, &foot, MAGIC].concat()).unwrap();
    path.to_path_buf()
}
