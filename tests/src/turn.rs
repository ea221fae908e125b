//! Who may run at the same time: tests in virtual time together, tests on the wall clock alone.

use std::fs::File;

use rustix::fs::{FlockOperation, flock};

/// Held as long as a test runs.
#[derive(Debug)]
pub struct Turn(#[allow(dead_code)] File);

/// Waits until no test on the wall clock runs.
pub fn among_others() -> Turn {
    take(FlockOperation::LockShared)
}

/// Waits until no other test runs, and keeps others waiting. Its test lies in a module `alone`, by which `.config/nextest.toml` knows it.
pub fn alone() -> Turn {
    let name = std::env::var("NEXTEST_TEST_NAME").unwrap_or_default();
    assert!(name.is_empty() || name.contains("::alone::"), "{name} is to lie in a module `alone`");
    take(FlockOperation::LockExclusive)
}

fn take(how: FlockOperation) -> Turn {
    // Whoever waits to be alone keeps this one meanwhile: those who come later do not pass him.
    let _queue = lock("bateleur-tests.queue", how);
    Turn(lock("bateleur-tests.turn", how))
}

fn lock(name: &str, how: FlockOperation) -> File {
    let path = std::env::temp_dir().join(name);
    let file =
        File::options().create(true).append(true).open(&path).expect("a lock file in the temporary folder");
    flock(&file, how).expect("the temporary folder allows locks");
    file
}
