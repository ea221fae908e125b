//! What became of everything that a gateway met.

use serde::Serialize;

use crate::ring::GivenUp;

/// Counted since the start. Every frame that came and did not go on is in one of them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Counters {
    /// Frames from the bus.
    pub bus_in: u64,
    /// Reports of errors from the bus's controller.
    pub bus_errors: u64,
    /// Frames from the bus that the system had no room for, while the gateway did not run.
    pub bus_unkept: u64,
    /// Frames from the bus that are not to be forwarded.
    pub not_forwarded: u64,
    /// Frames on their way to the network that were given up.
    pub to_network: GivenUp,
    /// Frames put into datagrams.
    pub network_out: u64,
    /// Datagrams sent, each to each target.
    pub datagrams_out: u64,
    /// Datagrams that the system did not take.
    pub unsent_datagrams: u64,

    /// Datagrams received.
    pub datagrams_in: u64,
    /// Frames in those that were believed.
    pub network_in: u64,
    /// Datagrams that are missing by their numbers.
    pub lost_datagrams: u64,
    /// Frames in them.
    pub lost_frames: u64,
    /// Datagrams that came out of order, and were taken.
    pub late_datagrams: u64,
    /// Datagrams that came again, and were not.
    pub repeated_datagrams: u64,
    /// Own broadcasts that came back.
    pub own_echoes: u64,
    /// Datagrams of another gateway with the same identity.
    pub same_identity: u64,
    /// Datagrams that are none of a gateway's.
    pub foreign: u64,
    /// Datagrams of another version.
    pub other_version: u64,
    /// Datagrams with a flaw.
    pub malformed: u64,
    /// Sound datagrams of somebody who is not to be listened to.
    pub strangers: u64,
    /// Sound datagrams of somebody who has not shown that he gets what is sent to the address that they come from. Questions to
    /// everybody do not count.
    pub unproven_datagrams: u64,
    /// Frames in them.
    pub unproven_frames: u64,
    /// Reports of errors from another gateway's bus.
    pub remote_errors: u64,
    /// Targets that fell silent.
    pub targets_lost: u64,
    /// Targets that were started anew.
    pub target_restarts: u64,
    /// Times that a target was again the one that it had been before it was started anew: two have its identity.
    pub target_flips: u64,
    /// Events beyond those that could wait to be told.
    pub events_untold: u64,

    /// Frames written to the bus.
    pub bus_out: u64,
    /// Frames on their way to the bus that were given up.
    pub to_bus: GivenUp,
    /// Frames that the bus can not carry (FD on a classic one), or did not take.
    pub bus_refused: u64,
    /// Times that a serial adapter said no, to a frame or to an order, and lines of its that were none.
    pub adapter_denied: u64,
    /// Times that the controller had gone off the bus.
    pub bus_off: u64,
    /// Times that the bus had failed or ended, and was opened again.
    pub bus_reopened: u64,
    /// Times that the log's file did not take what was to be written.
    pub log_unwritten: u64,
}

impl Counters {
    /// Frames that did not get to where they were meant to, for any reason.
    pub fn lost(&self) -> u64 {
        self.to_network.total() + self.to_bus.total() + self.lost_frames + self.bus_refused + self.bus_unkept
    }

    /// Name and value of each, by name.
    pub fn list(&self) -> Vec<(String, u64)> {
        let mut list = Vec::new();
        if let Ok(serde_json::Value::Object(fields)) = serde_json::to_value(self) {
            for (name, value) in fields {
                match value {
                    serde_json::Value::Object(parts) => list.extend(
                        parts
                            .into_iter()
                            .map(|(part, value)| (format!("{name}_{part}"), value.as_u64().unwrap_or(0))),
                    ),
                    value => list.push((name, value.as_u64().unwrap_or(0))),
                }
            }
        }
        list
    }
}
