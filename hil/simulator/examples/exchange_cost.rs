//! What one exchange costs without the socket: a flight of five minutes, the sticks passed straight through.

use bateleur_messages::frame::Decoder;
use bateleur_messages::hil::{Actuators, PILOT_TAKE_OFF, Packet, PilotOrder};
use bateleur_simulator::{Options, Session};
use std::time::{Duration, Instant};

const CYCLES: u64 = 15_000;

fn main() -> anyhow::Result<()> {
    let path = std::env::temp_dir().join(format!("exchange_cost.{}.truth", std::process::id()));
    let mut session = Session::new(&Options { truth: Some(path.clone()), ..Options::default() })?;
    let (mut request, mut reply) = (Vec::new(), Vec::new());
    Packet::Pilot(PilotOrder { order: PILOT_TAKE_OFF, reserved: 0 }).write(&mut request);
    session.take(&request, &mut reply);

    let mut actuators = Actuators::default();
    let mut costs = Vec::new();
    for cycle in 1..=CYCLES {
        request.clear();
        reply.clear();
        Packet::Actuators(Actuators { module_ns: cycle * 20_000_000, ..actuators }).write(&mut request);
        let start = Instant::now();
        session.take(&request, &mut reply);
        costs.push(start.elapsed());
        pass_through(&reply, &mut actuators);
    }
    costs.sort_unstable();
    let mean = costs.iter().sum::<Duration>() / CYCLES as u32;
    println!("mean {mean:?}, 99 % {:?}, longest {:?}", costs[costs.len() * 99 / 100], costs[costs.len() - 1]);
    session.flush()?;
    let records = bateleur_simulator::truth::read(&path)?;
    let flew = records.iter().all(|record| record.crashed == 0) && records[records.len() - 1].on_ground == 0;
    anyhow::ensure!(flew, "the aircraft did not stay in the air, so the figures say nothing");
    std::fs::remove_file(path)?;
    Ok(())
}

fn pass_through(reply: &[u8], actuators: &mut Actuators) {
    for frame in Decoder::new().extend(reply) {
        if let Ok(Packet::Custom(custom)) = Packet::of(&frame) {
            actuators.aileron_left_us = custom.pilot_aileron_us;
            actuators.aileron_right_us = custom.pilot_aileron_us;
            actuators.elevator_us = custom.pilot_elevator_us;
            actuators.rudder_us = custom.pilot_rudder_us;
            actuators.throttle_us = custom.pilot_throttle_us;
        }
    }
}
