//! The partition `match`: say here in a sentence what it is for, and what it must never do.
//!
//! `bateleur new` made it from the schedule file. It runs as it is, and what it sends are zeros. Once `window` has
//! more than a few lines, put what it computes into `src/lib.rs`, which knows no ports and no clock.

use std::process::ExitCode;

use bateleur_apex::{
    Context, Partition, QueuingDestination, SamplingDestination, SamplingSource, StartError, Window,
};
use bateleur_messages::{Field, FieldKind, Message, Rate, State, TelemetryMessage};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Messages of `9th` that one window takes at most: as many as may wait there.
const PORT_9TH_DEPTH: u32 = 4;

/// Messages of `from_a_very_long_name_of_thirt` that one window takes at most: as many as may wait there.
const FROM_A_VERY_LONG_NAME_OF_THIRT_DEPTH: u32 = 2;

/// Plain bytes: give them a meaning, or a message type of their own.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
struct Bytes64([u8; 64]);

impl Message for Bytes64 {
    const NAME: &'static str = "bytes";
    const FIELDS: &'static [Field] =
        &[Field { name: "bytes", unit: "", kind: FieldKind::U8, count: 64, offset: 0 }];
}

struct Match {
    state: SamplingDestination<State>,
    port_9th: QueuingDestination<TelemetryMessage>,
    from_a_very_long_name_of_thirt: QueuingDestination<Bytes64>,
    self_port: SamplingSource<Rate>,
    /// Windows of this incarnation.
    windows: u64,
}

impl Partition for Match {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        // Before the first window, with all the time of `startup_timeout`: here it may allocate, read files and fail. The
        // text of an error is what the operator reads.
        Ok(Self {
            state: context.sampling_destination("State")?,
            port_9th: context.queuing_destination("9th")?,
            from_a_very_long_name_of_thirt: context.queuing_destination("from_a_very_long_name_of_thirt")?,
            self_port: context.sampling_source("self")?,
            windows: 0,
        })
    }

    fn window(&mut self, window: &Window) {
        if self.windows == 0 {
            window.report("runs");
        }
        // None before the first message, and none once the last is older than the port's `refresh`.
        let _state = self.state.read_valid();
        for _ in 0..PORT_9TH_DEPTH {
            let Some(_message) = self.port_9th.receive() else { break };
        }
        for _ in 0..FROM_A_VERY_LONG_NAME_OF_THIRT_DEPTH {
            let Some(_message) = self.from_a_very_long_name_of_thirt.receive() else { break };
        }
        // Compute here. Nothing may block, and every loop needs a bound; the time is `window.start_ns()` or
        // `window.now_ns()`, never the system's. `window.report` tells the operator, `window.raise` is a health error.
        self.windows += 1;
        self.self_port.write(&Rate {
            synchronize: 0,
            execute: 0,
            timeout_1: 0,
            timeout_2: 0,
            timeout_3: 0,
            synchronize_ns: 0,
            sensor_cutoff_ns: 0,
        });
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Match>()
}

#[cfg(test)]
mod tests {
    use bateleur_apex::Harness;

    use super::*;

    #[test]
    fn windows_read_every_destination_and_write_every_source() -> Result<(), StartError> {
        let mut harness = Harness::new("match")?;
        let mut state = harness.sampling_destination::<State>("State", 40_000_000)?;
        let mut port_9th = harness.queuing_destination::<TelemetryMessage>("9th", 4)?;
        let mut from_a_very_long_name_of_thirt =
            harness.queuing_destination::<Bytes64>("from_a_very_long_name_of_thirt", 2)?;
        let mut self_port = harness.sampling_source::<Rate>("self")?;
        let mut partition = harness.start::<Match>()?;
        state.write(&State::default());
        port_9th.send(&TelemetryMessage::default());
        from_a_very_long_name_of_thirt.send(&Bytes64([0; 64]));
        partition.window();
        assert!(self_port.read().is_some());
        Ok(())
    }
}
