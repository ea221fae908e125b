//! Health monitoring, in three places: what an error is (the monitor), what to do about it ([`decision`], pure), and
//! doing it (the monitor again, by the mechanisms of [`bateleur_host::partition`]). What happened stands in the [`log`], and what
//! has to outlive everything in the [`ring`]. The [`journal`] of the machine is told as well.

pub mod decision;
pub mod journal;
pub mod log;
pub mod record;
pub mod ring;
