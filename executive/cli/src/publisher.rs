//! The publisher: writes into one channel what its client sends, a [`Publication`] a line on its connection, and answers each. It ends
//! some time after its client; the executive then clears what it leaves.

use std::io::{BufRead, BufReader, ErrorKind, Write};
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use bateleur_channels::publish;
use bateleur_control::{Answer, Publication};
use bateleur_host::helper::orders::Order;
use bateleur_ports::{Domain, Stamp};
use bateleur_system::time::now_ns;

use crate::hexadecimal::bytes_of;

/// The longest line: two digits for each byte of the longest message, and the words around them.
const LONGEST_LINE: u64 = 1 << 20;
/// How long a client may leave an answer unread.
const PATIENCE: Duration = Duration::from_secs(10);

pub(crate) fn run(order: &str, origin_ns: u64, lingers: Duration) -> Result<()> {
    bateleur_host::helper::begin(c"publisher");
    let order: Order = serde_json::from_str(order).context("the publisher's order is damaged")?;
    let [ordered] = order.channels.as_slice() else { bail!("the publisher's order is not of one channel") };
    // The server's end of the connection never waited; this one does.
    let connection = UnixStream::from(std::io::stdout().as_fd().try_clone_to_owned()?);
    connection.set_nonblocking(false)?;
    connection.set_write_timeout(Some(PATIENCE))?;
    let mut answers = connection.try_clone()?;
    let attached = publish(&Domain { root: order.root.clone() }, ordered, "publisher");
    let (writer, twin, _node) = match attached {
        Ok(attached) => attached,
        Err(error) => {
            answers
                .write_all(&Answer::refused(format!("{error}; does its partition write into it?")).line())?;
            return Ok(());
        }
    };
    answers.write_all(&Answer::Publishing.line())?;
    let (mut lines, mut line, mut sequence) = (BufReader::new(connection), Vec::new(), 0);
    loop {
        line.clear();
        match std::io::Read::take(&mut lines, LONGEST_LINE).read_until(b'\n', &mut line) {
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            Ok(0) | Err(_) => break, // the client has gone
            Ok(_) => {}
        }
        let stamp = Stamp { source_ns: now_ns().saturating_sub(origin_ns), sequence: sequence + 1 };
        let answer = match message_of(&line, ordered.size).and_then(|bytes| {
            let receivers = writer.put(&bytes, stamp).map_err(|error| error.to_string())?;
            if let Some(twin) = &twin {
                let _ = twin.put(&bytes, stamp); // an observer's loss is no fault
            }
            Ok(receivers as u64)
        }) {
            Ok(receivers) => {
                sequence += 1;
                Answer::Published { sequence, receivers }
            }
            Err(why) => Answer::refused(why),
        };
        if answers.write_all(&answer.line()).is_err() {
            break;
        }
    }
    // A reader that has not looked since then would find nothing, where the memory goes with its writer.
    if ordered.sealed.is_none() {
        std::thread::sleep(lingers);
    }
    Ok(())
}

/// The message in a client's line.
fn message_of(line: &[u8], most: usize) -> Result<Vec<u8>, String> {
    let publication: Publication =
        serde_json::from_slice(line).map_err(|error| format!("that line is no message: {error}"))?;
    let bytes = bytes_of(&publication.bytes).ok_or("a message is given as hexadecimal digits")?;
    if bytes.is_empty() || bytes.len() > most {
        return Err(format!("a message of this channel has 1 to {most} bytes, not {}", bytes.len()));
    }
    Ok(bytes)
}
