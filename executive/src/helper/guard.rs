//! Waits for the executive's end. Where the executive did not end by itself, ends its partitions and removes its
//! control group and shared memory: also after `kill -9`, nothing is left.

use std::io::{self, Read};

use crate::instance::Instance;

/// Said by an executive that has cleaned up after itself.
pub const FAREWELL: u8 = b'.';

/// The guard's life. Its standard input is a pipe whose other end only the executive holds.
pub fn run(instance: &str) -> io::Result<()> {
    super::custodian::name_process(c"guard");
    let instance: Instance = serde_json::from_str(instance)?;
    let mut said = Vec::new();
    io::stdin().read_to_end(&mut said)?;
    if said.last() != Some(&FAREWELL) {
        instance.clean_up();
    }
    Ok(())
}
