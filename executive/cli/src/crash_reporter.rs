//! The helper that reads what a partition's process has written down before it ended by a fault: a report and a minidump are made of it.
//!
//! It has no privileges, and is handed the files that it writes. The report is written twice: first without what the program's file is
//! needed for, so that something is left where that file ends this process.

use std::fs::File;
use std::os::unix::fs::FileExt;

use anyhow::{Context, Result};
use bateleur_crash::{Binaries, Captured, CrashReport, Death, MOST_BYTES, PortOf, minidump};
use bateleur_host::helper::crash::{CrashOrder, DUMP_FD, MEMORY_FD, PROGRAM_FD, REPORT_FD};
use bateleur_system::handed_over::copy_of_inherited;

pub(crate) fn run(order: &str) -> Result<()> {
    bateleur_host::helper::begin(c"crash reporter");
    let order: CrashOrder = serde_json::from_str(order).context("the order is damaged")?;
    let inherited = |number| copy_of_inherited(number).map(File::from).map_err(anyhow::Error::msg);
    let memory = inherited(MEMORY_FD).context("the crash memory was not handed over")?;
    let report_file = inherited(REPORT_FD).context("the report's file was not handed over")?;
    let dump_file = inherited(DUMP_FD).context("the minidump's file was not handed over")?;
    let captured = Captured::read(&memory)?;
    let program = inherited(PROGRAM_FD).ok().map(|file| (order.program.clone(), file));
    let mut report = CrashReport::new(death(order), &captured);
    write(&report_file, &serde_json::to_vec_pretty(&report)?)?;
    let since_1970 = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
    let dump = minidump::write(&captured, since_1970.as_secs() as u32).context("no minidump")?;
    write(&dump_file, &dump)?;
    report.trace(&captured, &mut Binaries::new(program));
    write(&report_file, &serde_json::to_vec_pretty(&report)?)
}

fn death(order: CrashOrder) -> Death {
    let CrashOrder { partition, generation, time_ns, error, detail, program, ports } = order;
    let ports = ports.into_iter().map(|(name, source)| PortOf { name, source }).collect();
    Death { partition, generation, time_ns, error, detail, program, ports }
}

fn write(file: &File, bytes: &[u8]) -> Result<()> {
    anyhow::ensure!(
        bytes.len() as u64 <= MOST_BYTES,
        "{} bytes are more than a report may have",
        bytes.len()
    );
    file.set_len(0)?;
    file.write_all_at(bytes, 0)?;
    Ok(())
}
