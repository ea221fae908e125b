//! What the executive and a recorder, which writes every message of a module into a log, say to each other.

use serde::{Deserialize, Serialize};

use super::orders::Order;

/// A recorder's answers, each a letter. An order is carried out:
pub const DONE: char = '.';
/// The same, and something was left out of the log that is no message of its channel's type:
pub const LEFT_OUT: char = '!';
/// Orders to a recorder, each a letter; it answers each with a byte. Read what has been written:
pub const READ: char = 'r';
/// Attach anew to the channels whose names follow, separated by spaces, until the end of the line:
pub const ATTACH_ANEW: char = 'a';

/// The exit code of a recorder whose disk has no room for more.
pub const NO_ROOM: i32 = 28;

/// What a recorder is told, as its one argument.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct RecorderOrder {
    /// The channels.
    pub order: Order,
    /// Those that it is to keep off until it is told to attach anew.
    pub without: Vec<String>,
    /// Parts of the log before its own. Only the first recorder ends where it can not attach itself to a channel.
    pub part: u32,
}
