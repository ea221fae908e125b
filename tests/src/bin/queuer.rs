//! A partition that sends a message a window where the plan gives it a queuing port `out`, and says when one is refused
//! because the queue is full; and takes all messages where it has a port `in`, and says how many there were.

use std::process::ExitCode;

use bateleur_apex::{
    Context, Direction, Partition, PortKind, QueuingDestination, QueuingSource, Sent, StartError, Window,
};
use bateleur_messages::GroundMessage;

struct Queuer {
    out: Option<QueuingSource<GroundMessage>>,
    into: Option<QueuingDestination<GroundMessage>>,
    refusals: u64,
    heard: u64,
}

impl Partition for Queuer {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let has = |name: &str, direction| {
            context.port_names(PortKind::Queuing, direction).iter().any(|port| port == name)
        };
        let (sends, hears) = (has("out", Direction::Source), has("in", Direction::Destination));
        let out = if sends { Some(context.queuing_source("out")?) } else { None };
        let into = if hears { Some(context.queuing_destination("in")?) } else { None };
        Ok(Self { out, into, refusals: 0, heard: 0 })
    }

    fn window(&mut self, window: &Window) {
        if let Some(out) = &mut self.out
            && out.send(&GroundMessage::default()) == Sent::Full
        {
            self.refusals += 1;
            window.report(&format!("refused {}", self.refusals));
        }
        let Some(into) = &mut self.into else { return };
        while into.receive().is_some() {
            self.heard += 1;
            window.report(&format!("heard {}", self.heard));
        }
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Queuer>()
}
