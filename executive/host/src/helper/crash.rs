//! What the helper is told that reads what a dead process has left.
//!
//! It finds the process's crash memory at [`MEMORY_FD`], the files that it is to write behind that, and the partition's program last.

use std::fs::{DirEntry, File};
use std::io;
use std::path::Path;

use serde::{Deserialize, Serialize};

/// The crash memory.
pub const MEMORY_FD: i32 = 3;
/// The report (JSON).
pub const REPORT_FD: i32 = 4;
/// The minidump.
pub const DUMP_FD: i32 = 5;
/// The program, where it could be opened.
pub const PROGRAM_FD: i32 = 6;

/// The folder of the reports, in a run's folder.
pub const FOLDER: &str = "crashes";
/// How the names of a report and of a minidump end.
pub const REPORT: &str = "json";
/// See [`REPORT`].
pub const DUMP: &str = "dmp";
/// Bytes of a file in it, most.
pub const MOST_BYTES: u64 = 256 << 10;
/// Reports of one partition in a run, most: the first ones, because later ones may follow from them.
pub const MOST_OF_A_PARTITION: u32 = 8;
/// Reports of a run, most.
pub const MOST_OF_A_RUN: u32 = 64;

/// Removes the reports of an earlier run in the same folder.
pub fn remove_earlier(run: &Path) {
    let folder = run.join(FOLDER);
    let files = std::fs::read_dir(&folder).into_iter().flatten().flatten();
    let ours = |path: &Path| path.extension().is_some_and(|end| end == REPORT || end == DUMP);
    for path in files.map(|file| file.path()).filter(|path| ours(path)) {
        let _ = std::fs::remove_file(path); // one that stays is not written over
    }
    let _ = std::fs::remove_dir(folder); // there is none, as a rule; one with something else in it stays
}

/// What the helper writes, and the program that it reads.
#[derive(Debug)]
pub struct CrashFiles {
    /// The report.
    pub report: File,
    /// The minidump.
    pub dump: File,
    /// The partition's program, where it can be opened, and as the map of the process's memory names it.
    pub program: (Option<File>, String),
}

/// Makes the files of a report in the folder of a run. Takes as long as the disk takes. `None`: there are enough reports.
///
/// # Errors
/// They can not be made.
pub fn make_files(run: &Path, order: &CrashOrder) -> io::Result<Option<CrashFiles>> {
    let folder = run.join(FOLDER);
    match std::fs::create_dir(&folder) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(error),
        _ => {}
    }
    let is_report = |file: &DirEntry| file.path().extension().is_some_and(|end| end == REPORT);
    if std::fs::read_dir(&folder)?.flatten().filter(is_report).count() >= MOST_OF_A_RUN as usize {
        return Ok(None);
    }
    for number in 1..=MOST_OF_A_PARTITION {
        let path = folder.join(format!("{}-{number}.{REPORT}", order.partition));
        let report = match File::create_new(&path) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => continue,
            report => report?,
        };
        let dump = File::create(path.with_extension(DUMP))?;
        let name = std::fs::canonicalize(&order.program).unwrap_or_else(|_| order.program.clone().into());
        let program = (File::open(&order.program).ok(), name.display().to_string());
        return Ok(Some(CrashFiles { report, dump, program }));
    }
    Ok(None)
}

/// What the helper is told, as its one argument.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CrashOrder {
    /// The partition.
    pub partition: String,
    /// Incarnations before the one that died.
    pub generation: u32,
    /// Module time at which it was found dead, ns.
    pub time_ns: u64,
    /// The error.
    pub error: String,
    /// What the health log says beside it.
    pub detail: String,
    /// The partition's program.
    pub program: String,
    /// Its ports, and for each the port that its messages come from.
    pub ports: Vec<(String, String)>,
}
