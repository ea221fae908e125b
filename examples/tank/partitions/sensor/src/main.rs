//! The partition `sensor`: measures how full the tank is. The tank is computed here; a device would be opened in `start`.

use std::process::ExitCode;

use bateleur_apex::{Context, Partition, Retained, SamplingDestination, SamplingSource, StartError, Window};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

mod types {
    bateleur_apex::messages!("../../messages");
}
use types::{Level, Valve};

/// What the next incarnation finds after a warm restart: the tank is as full as it was.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
struct Kept {
    height_m: f64,
}

struct Sensor {
    level: SamplingSource<Level>,
    inlet: SamplingDestination<Valve>,
    retained: Retained<Kept>,
    full_m: f64,
    drain_mps: f64,
    fill_mps: f64,
    height_m: f64,
    before_ns: Option<u64>,
}

impl Partition for Sensor {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let mut retained = context.retained::<Kept>()?;
        let full_m = context.attribute("full_m", 2.0)?;
        // It comes from an incarnation that failed: believed only where it makes sense.
        let before_m = retained.load().map(|kept| kept.height_m);
        Ok(Self {
            level: context.sampling_source("level")?,
            inlet: context.sampling_destination("inlet")?,
            retained,
            full_m,
            drain_mps: context.attribute("drain_mps", 0.5)?,
            fill_mps: context.attribute("fill_mps", 1.0)?,
            height_m: before_m.filter(|height_m| (0.0..=full_m).contains(height_m)).unwrap_or(full_m),
            before_ns: None,
        })
    }

    fn window(&mut self, window: &Window) {
        let measured_ns = window.start_ns();
        let passed_ns = measured_ns - self.before_ns.replace(measured_ns).unwrap_or(measured_ns);
        let is_open = self.inlet.read_valid().is_some_and(|valve| valve.state == Valve::STATE_OPEN);
        let rise_mps = if is_open { self.fill_mps - self.drain_mps } else { -self.drain_mps };
        self.height_m = (self.height_m + rise_mps * passed_ns as f64 * 1e-9).clamp(0.0, self.full_m);
        self.retained.store(&Kept { height_m: self.height_m });
        self.level.write(&Level { measured_ns, height_m: self.height_m });
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Sensor>()
}

#[cfg(test)]
mod tests {
    use bateleur_apex::Harness;

    use super::*;

    #[test]
    fn tank_drains_until_its_inlet_is_open() -> Result<(), StartError> {
        let mut harness = Harness::new("sensor")?;
        harness.retained(4096)?;
        let mut level = harness.sampling_source::<Level>("level")?;
        let mut inlet = harness.sampling_destination::<Valve>("inlet", 100_000_000)?;
        let mut partition = harness.start::<Sensor>()?;
        let mut heights_m = Vec::new();
        for state in [Valve::STATE_CLOSED, Valve::STATE_CLOSED, Valve::STATE_OPEN] {
            inlet.write(&Valve { state, ..Valve::default() });
            partition.window();
            heights_m.extend(level.read().map(|reading| reading.value.height_m));
        }
        assert!(heights_m[1] < heights_m[0] && heights_m[2] > heights_m[1], "{heights_m:?}");
        Ok(())
    }
}
