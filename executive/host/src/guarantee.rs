//! What this machine lets the executive promise, said at every start and in every report.

use serde::{Deserialize, Serialize};

/// One promise and whether it holds on this machine.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Guarantee {
    /// The promise, in a few words.
    pub promise: String,
    /// Whether it holds.
    pub held: bool,
    /// How it is kept, or what is missing and how to mend it.
    pub detail: String,
}

/// The promises of one run, in the order in which they were examined.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Guarantees(Vec<Guarantee>);

impl Guarantees {
    /// A promise that holds.
    pub fn held(&mut self, promise: &str, how: impl Into<String>) {
        self.0.push(Guarantee { promise: promise.into(), held: true, detail: how.into() });
    }

    /// A promise that does not hold.
    pub fn missing(&mut self, promise: &str, why: impl Into<String>) {
        self.0.push(Guarantee { promise: promise.into(), held: false, detail: why.into() });
    }

    /// Either, by the result of trying.
    pub fn examine<T, E: std::fmt::Display>(
        &mut self,
        promise: &str,
        tried: Result<T, E>,
        how: &str,
        mend: &str,
    ) -> Option<T> {
        match tried {
            Ok(value) => {
                self.held(promise, how);
                Some(value)
            }
            Err(error) => {
                self.missing(promise, format!("{error}; {mend}"));
                None
            }
        }
    }

    /// All of them.
    #[must_use]
    pub fn list(&self) -> &[Guarantee] {
        &self.0
    }

    /// Those that do not hold.
    pub fn lacking(&self) -> impl Iterator<Item = &Guarantee> {
        self.0.iter().filter(|guarantee| !guarantee.held)
    }
}
