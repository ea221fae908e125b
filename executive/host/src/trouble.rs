//! A log that can not be written, because the disk is full or gone: said once, counted always. It must never stop the module.

use std::io;

/// What is known of one log's troubles.
#[derive(Debug, Default)]
pub struct Trouble {
    lost: u64,
    said: bool,
    unsaid: Option<String>,
}

impl Trouble {
    /// Takes notice of how an attempt to write one record ended.
    pub fn note(&mut self, written: io::Result<()>) {
        if let Err(error) = written {
            self.lose(1, &error.to_string());
        }
    }

    /// Takes notice of `records` that were lost.
    pub fn lose(&mut self, records: u64, why: &str) {
        self.lost += records;
        if records > 0 && !self.said {
            self.said = true;
            self.unsaid = Some(why.to_owned());
        }
    }

    /// Why records were lost, the first time that one was; then never again.
    pub fn take(&mut self) -> Option<String> {
        self.unsaid.take()
    }

    /// Records lost so far.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trouble_is_said_once_and_counted_always() {
        let mut trouble = Trouble::default();
        trouble.note(Ok(()));
        assert_eq!((trouble.take(), trouble.lost()), (None, 0));
        trouble.note(Err(io::ErrorKind::StorageFull.into()));
        assert!(trouble.take().is_some());
        trouble.note(Err(io::ErrorKind::StorageFull.into()));
        assert_eq!((trouble.take(), trouble.lost()), (None, 2));
    }
}
