//! The partition `watch`: opens the inlet of the tank where it is low, and closes it where it is high. It must never take an old
//! measurement for a fresh one.

use std::process::ExitCode;

use bateleur_apex::{Context, Partition, SamplingDestination, SamplingSource, StartError, Window};

mod types {
    bateleur_apex::messages!("../../messages");
}
use types::{Level, Valve};

struct Watch {
    level: SamplingDestination<Level>,
    inlet: SamplingSource<Valve>,
    low_m: f64,
    high_m: f64,
    state: u8,
    was_blind: bool,
}

impl Partition for Watch {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let (low_m, high_m) = (context.attribute("low_m", 1.0)?, context.attribute("high_m", 1.5)?);
        if low_m >= high_m {
            return Err(StartError::Other(format!("low_m = {low_m} has to be below high_m = {high_m}")));
        }
        Ok(Self {
            level: context.sampling_destination("level")?,
            inlet: context.sampling_source("inlet")?,
            low_m,
            high_m,
            state: Valve::STATE_CLOSED,
            was_blind: false,
        })
    }

    fn window(&mut self, window: &Window) {
        // None before the first measurement, and none once the last is older than the port's `refresh`.
        let level = self.level.read_valid();
        let state = match &level {
            Some(level) if level.height_m < self.low_m => Valve::STATE_OPEN,
            Some(level) if level.height_m <= self.high_m => self.state,
            _ => Valve::STATE_CLOSED,
        };
        if level.is_none() && !self.was_blind {
            window.report("no measurement: the inlet is closed");
        } else if state != self.state {
            let what = if state == Valve::STATE_OPEN { "opens" } else { "closes" };
            window.report(&format!("{what} the inlet"));
        }
        self.was_blind = level.is_none();
        self.state = state;
        let measured_ns = level.map_or(0, |level| level.measured_ns);
        self.inlet.write(&Valve { measured_ns, state, reserved: [0; 7] });
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Watch>()
}

#[cfg(test)]
mod tests {
    use bateleur_apex::Harness;

    use super::*;

    #[test]
    fn inlet_opens_low_closes_high_and_closes_without_a_measurement() -> Result<(), StartError> {
        let mut harness = Harness::new("watch")?;
        let mut level = harness.sampling_destination::<Level>("level", 40_000_000)?;
        let mut inlet = harness.sampling_source::<Valve>("inlet")?;
        let mut partition = harness.start::<Watch>()?;
        for (height_m, state) in [
            (1.2, Valve::STATE_CLOSED),
            (0.9, Valve::STATE_OPEN),
            (1.2, Valve::STATE_OPEN),
            (1.6, Valve::STATE_CLOSED),
            (0.9, Valve::STATE_OPEN),
        ] {
            level.write(&Level { measured_ns: 1, height_m });
            partition.window();
            assert_eq!(inlet.read().map(|reading| reading.value.state), Some(state), "{height_m} m");
        }
        (0..5).for_each(|_| partition.window());
        assert_eq!(inlet.read().map(|reading| reading.value.state), Some(Valve::STATE_CLOSED));
        assert_eq!(harness.reports().last().map(String::as_str), Some("no measurement: the inlet is closed"));
        Ok(())
    }
}
