//! The names of the Linux hypervisor.

use bateleur_apex::processes::standard::MAX_ERROR_MESSAGE_SIZE;
use log::{Level, LevelFilter, Log, Metadata, Record, SetLoggerError};

use crate::convert::call;

/// Stands for the partition that runs this program; partitions name it where they need a type with the traits of `a653rs`.
#[derive(Debug, Clone, Copy)]
pub struct ApexLinuxPartition;

impl ApexLinuxPartition {
    /// The partition's name in the plan.
    pub fn get_partition_name() -> String {
        bateleur_apex::processes::current::partition_name()
    }
}

static LOGGER: ApexLogger = ApexLogger();

/// Where `log` goes: every line to standard error, and so into the partition's log; warnings and errors into the module's log too.
#[derive(Debug, Clone, Copy)]
pub struct ApexLogger();

impl ApexLogger {
    /// Takes up what `log` is told, up to a level.
    ///
    /// # Errors
    /// The program has a logger.
    pub fn install_logger(level: LevelFilter) -> Result<(), SetLoggerError> {
        log::set_logger(&LOGGER)?;
        log::set_max_level(level);
        Ok(())
    }

    /// Panics are logged as errors.
    pub fn install_panic_hook() {
        std::panic::set_hook(Box::new(|panic| log::error!("{panic}")));
    }
}

impl Log for ApexLogger {
    fn enabled(&self, _: &Metadata<'_>) -> bool {
        true
    }

    fn log(&self, record: &Record<'_>) {
        let text = record.args().to_string();
        for line in text.lines() {
            eprintln!("{:5} {line}", record.level());
            if record.level() <= Level::Warn {
                let line = &line.as_bytes()[..line.len().min(MAX_ERROR_MESSAGE_SIZE)];
                // A thread that is no process of the partition has said it on standard error.
                let _ = call(|services| services.report_application_message(line));
            }
        }
    }

    fn flush(&self) {}
}
