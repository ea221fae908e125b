//! A partition with message types of its own, in a folder that `bateleur` was not built with: writes what a radar sees where the plan
//! gives it a port `track`, and reads that of another where the plan gives it a port `seen`.

use std::process::ExitCode;

use bateleur_apex::{
    Context, Direction, Partition, PortKind, SamplingDestination, SamplingSource, StartError, Window,
};

mod types {
    bateleur_apex::messages!("messages");
}
use types::acme::{Echo, Track};

struct Radar {
    sweeps: u32,
    track: Option<SamplingSource<Track>>,
    seen: Option<SamplingDestination<Track>>,
}

impl Partition for Radar {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let has = |name: &str, direction| {
            context.port_names(PortKind::Sampling, direction).iter().any(|port| port == name)
        };
        let (tracks, sees) = (has("track", Direction::Source), has("seen", Direction::Destination));
        let track = if tracks { Some(context.sampling_source("track")?) } else { None };
        let seen = if sees { Some(context.sampling_destination("seen")?) } else { None };
        Ok(Self { sweeps: 0, track, seen })
    }

    fn window(&mut self, window: &Window) {
        self.sweeps += 1;
        if let Some(track) = &mut self.track {
            let echo = |number: u8| Echo { range: 1.5 + f32::from(number), closing: -40, ..Echo::default() };
            let (measured_ns, sweeps) = (window.start_ns(), self.sweeps);
            let echoes = [echo(0), echo(1)];
            track.write(&Track { measured_ns, mode: Track::MODE_SWEEP, sweeps, echoes });
        }
        if let Some(seen) = self.seen.as_mut().and_then(SamplingDestination::read_valid)
            && self.sweeps == 10
        {
            window.report(&format!("saw something at {} m", seen.echoes[1].range));
        }
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Radar>()
}
