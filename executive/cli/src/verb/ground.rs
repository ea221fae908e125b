//! `bateleur fly`.
use super::{Code, FINE};
/// Fly.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {}
pub(crate) fn run(_: &Arguments) -> anyhow::Result<Code> {
    Ok(FINE)
}
