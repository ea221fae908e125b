//! Standard output, for everything that a verb prints: the one place that knows whether it was taken.
//!
//! Nobody who reads any more (`| head`, a closed terminal) is no error. Everything else is, such as a full disk: whoever takes the
//! output for a file would else find an empty one, and a code that says that all went well. It must never end a verb: a
//! flight goes on, and its code tells in the end.

use std::io::{Error, ErrorKind, Result, Write};
use std::sync::{Mutex, PoisonError};

/// What kept the first piece from being written.
static FAILURE: Mutex<Option<Error>> = Mutex::new(None);

/// Standard output.
pub struct Printed;

impl Write for Printed {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        noted(std::io::stdout().write(bytes))
    }

    fn flush(&mut self) -> Result<()> {
        noted(std::io::stdout().flush())
    }
}

/// The result, of which an error is kept for [`finish`].
pub fn noted<T>(result: Result<T>) -> Result<T> {
    if let Err(error) = &result
        && is_failure(error.kind())
    {
        let mut failure = FAILURE.lock().unwrap_or_else(PoisonError::into_inner);
        failure.get_or_insert_with(|| match error.raw_os_error() {
            Some(number) => Error::from_raw_os_error(number),
            None => error.kind().into(),
        });
    }
    result
}

fn is_failure(kind: ErrorKind) -> bool {
    !matches!(kind, ErrorKind::BrokenPipe | ErrorKind::Interrupted)
}

/// Writes what is still held back, and says what could not be written of all that was printed.
pub fn finish() -> Option<Error> {
    let _ = Printed.flush(); // kept
    FAILURE.lock().unwrap_or_else(PoisonError::into_inner).take()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn output_that_nobody_reads_any_more_is_no_failure_and_a_full_disk_is() {
        assert!(!is_failure(ErrorKind::BrokenPipe));
        assert!(is_failure(ErrorKind::StorageFull));
        assert!(noted::<()>(Err(Error::from_raw_os_error(28))).is_err());
        assert_eq!(finish().map(|error| error.kind()), Some(ErrorKind::StorageFull));
        assert!(finish().is_none(), "it is said once");
    }
}
