//! Many flights as one result: what was flown, how each flight ended, and how the figures spread.
//!
//! Responsible for: the file of results, one whole line a flight; joining several of them; percentiles, worst flights and
//! failures, as text, JSON and one HTML page. It must never leave a flight out silently: what failed, what is missing and what
//! could not be read is counted and said, and figures say over how many flights they are.

mod page;
mod record;
mod result;
mod text;

pub use page::page;
pub use record::{CampaignError, Flown, Lines, Plan, RESULTS, append, join, read, read_plan, repair};
pub use result::{CampaignResult, Failure, Figure, Spread};
pub use text::text;
