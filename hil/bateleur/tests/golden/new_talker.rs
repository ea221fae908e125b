//! The partition `talker`: say here in a sentence what it is for, and what it must never do.
//!
//! `bateleur new` made it from the schedule file. It runs as it is, and what it sends are zeros. Once `window` has
//! more than a few lines, put what it computes into `src/lib.rs`, which knows no ports and no clock.

use std::process::ExitCode;

use bateleur_apex::{
    Context, HealthError, Partition, QueuingSource, Response, Retained, SamplingDestination, SamplingSource,
    StartError, Takeover, Window,
};
use bateleur_messages::{Field, FieldKind, Message, Rate, State, TelemetryMessage};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// In one of so many windows a message goes into each queue: a full one helps nobody.
const SEND_EVERY: u64 = 50;

/// Plain bytes: give them a meaning, or a message type of their own.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
struct Bytes64([u8; 64]);

impl Message for Bytes64 {
    const NAME: &'static str = "bytes";
    const FIELDS: &'static [Field] =
        &[Field { name: "bytes", unit: "", kind: FieldKind::U8, count: 64, offset: 0 }];
}

/// What the next incarnation finds after a warm restart: plain data, with padding written out as fields.
#[derive(Debug, Clone, Copy, Default, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
struct Kept {
    /// Windows so far, of all incarnations.
    windows: u64,
}

struct Talker {
    state: SamplingSource<State>,
    telemetry: QueuingSource<TelemetryMessage>,
    blackbox: QueuingSource<Bytes64>,
    in_port: SamplingDestination<Rate>,
    /// Attribute `a_rather_long_name_of_a_thing`.
    a_rather_long_name_of_a_thing: String,
    /// Attribute `gain`.
    gain: f64,
    /// Attribute `list`.
    list: Vec<f64>,
    /// Attribute `max speed`.
    max_speed: u64,
    /// Attribute `mixed`.
    mixed: (String, u64),
    /// Attribute `on`.
    on: bool,
    /// Attribute `path`.
    path: String,
    /// Attribute `points`.
    points: Vec<Vec<f64>>,
    /// Attribute `sync_period`, ns.
    sync_period_ns: u64,
    /// Attribute `type`.
    type_attribute: i64,
    retained: Retained<Kept>,
    kept: Kept,
    /// Windows of this incarnation.
    windows: u64,
}

impl Partition for Talker {
    const ERROR_HANDLER: bool = true;

    #[allow(clippy::approx_constant)] // a value of the schedule file, not of mathematics
    fn start(context: &mut Context) -> Result<Self, StartError> {
        // Before the first window, with all the time of `startup_timeout`: here it may allocate, read files and fail. The
        // text of an error is what the operator reads.
        let mut retained = context.retained::<Kept>()?;
        // Nothing after a cold start. It comes from an incarnation that failed: believe only what makes sense.
        let kept = retained.load().unwrap_or_default();
        // What stands beside the name of an attribute holds where the schedule file says nothing.
        Ok(Self {
            state: context.sampling_source("state")?,
            telemetry: context.queuing_source("telemetry")?,
            blackbox: context.queuing_source("blackbox")?,
            in_port: context.sampling_destination("in")?,
            a_rather_long_name_of_a_thing: context
                .attribute("a_rather_long_name_of_a_thing", String::new())?,
            gain: context.attribute("gain", 3.14)?,
            list: context.attribute("list", vec![1.0, 2.5])?,
            max_speed: context.attribute("max speed", 3)?,
            mixed: context.attribute("mixed", ("a".to_owned(), 1))?,
            on: context.attribute("on", true)?,
            path: context.attribute("path", "fillet".to_owned())?,
            points: context.attribute("points", vec![vec![1.0, 2.0], vec![3.0, 4.0]])?,
            sync_period_ns: context.duration_ns("sync_period", 20_000_000)?,
            type_attribute: context.attribute("type", -2)?,
            retained,
            kept,
            windows: 0,
        })
    }

    fn take_over(&mut self, _takeover: &Takeover) {
        // It stood by until now: what `start` loaded is long out of date.
        self.kept = self.retained.load().unwrap_or_default();
    }

    fn error_handler(&mut self, error: &HealthError, window: &Window) -> Response {
        // An error that the plan leaves to this partition. Another answer ends it: see `Response`.
        window.report(&format!("{:?}: {}", error.code, error.message));
        Response::GoOn
    }

    fn window(&mut self, window: &Window) {
        if self.windows == 0 {
            let told = [
                format!("{} windows before this one", self.kept.windows),
                format!("a_rather_long_name_of_a_thing = {:?}", self.a_rather_long_name_of_a_thing),
                format!("gain = {:?}", self.gain),
                format!("list = {:?}", self.list),
                format!("max speed = {:?}", self.max_speed),
                format!("mixed = {:?}", self.mixed),
                format!("on = {:?}", self.on),
                format!("path = {:?}", self.path),
                format!("points = {:?}", self.points),
                format!("sync_period = {:?}", self.sync_period_ns),
                format!("type = {:?}", self.type_attribute),
            ];
            window.report(&told.join(", ")); // its first 128 bytes
        }
        // None before the first message, and none once the last is older than the port's `refresh`.
        let _in_port = self.in_port.read_valid();
        // Compute here. Nothing may block, and every loop needs a bound; the time is `window.start_ns()` or
        // `window.now_ns()`, never the system's. `window.report` tells the operator, `window.raise` is a health error.
        self.windows += 1;
        self.kept.windows += 1;
        self.state.write(&State {
            valid_ns: window.start_ns(),
            position_ned_m: [0.0; 3],
            velocity_ned_mps: [0.0; 3],
            quaternion: [1.0, 0.0, 0.0, 0.0],
            euler_rad: [0.0; 3],
            rates_radps: [0.0; 3],
            specific_force_mps2: [0.0; 3],
            wind_ne_mps: [0.0; 2],
            gyro_bias_radps: [0.0; 3],
            accel_bias_mps2: [0.0; 3],
            attitude_sigma_rad: [0.0; 3],
            velocity_sigma_mps: [0.0; 3],
            position_sigma_m: [0.0; 3],
            status: 0,
            rejected: 0,
            health: 0,
        });
        if self.windows.is_multiple_of(SEND_EVERY) {
            // Anything but `Sent::Queued` means that it was not taken: try again, or let it go. Never wait.
            self.telemetry.send(&TelemetryMessage { letter: 0, length: 0, data: [0; 126] });
            self.blackbox.send(&Bytes64([0; 64]));
        }
        self.retained.store(&self.kept);
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Talker>()
}

#[cfg(test)]
mod tests {
    use bateleur_apex::Harness;

    use super::*;

    #[test]
    fn windows_read_every_destination_and_write_every_source() -> Result<(), StartError> {
        let mut harness = Harness::new("talker")?;
        harness.retained(4096)?;
        let mut state = harness.sampling_source::<State>("state")?;
        let mut telemetry = harness.queuing_source::<TelemetryMessage>("telemetry", 8)?;
        let mut blackbox = harness.queuing_source::<Bytes64>("blackbox", 8)?;
        let mut in_port = harness.sampling_destination::<Rate>("in", 40_000_000)?;
        let mut partition = harness.start::<Talker>()?;
        in_port.write(&Rate::default());
        (0..SEND_EVERY).for_each(|_| partition.window());
        assert!(state.read().is_some());
        assert!(telemetry.receive().is_some());
        assert!(blackbox.receive().is_some());
        Ok(())
    }

    #[test]
    fn what_is_kept_outlives_a_warm_restart() -> Result<(), StartError> {
        let mut harness = Harness::new("talker")?;
        harness.retained(4096)?;
        let _state = harness.sampling_source::<State>("state")?;
        let _telemetry = harness.queuing_source::<TelemetryMessage>("telemetry", 8)?;
        let _blackbox = harness.queuing_source::<Bytes64>("blackbox", 8)?;
        let _in_port = harness.sampling_destination::<Rate>("in", 40_000_000)?;
        let mut first = harness.start::<Talker>()?;
        first.window();
        first.window();
        drop(first);
        let mut second = harness.start::<Talker>()?;
        assert_eq!(second.partition.kept.windows, 2);
        // One that stood by has to look again.
        second.partition.kept = Kept::default();
        second.take_over();
        assert_eq!(second.partition.kept.windows, 2);
        Ok(())
    }
}
