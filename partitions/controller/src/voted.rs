//! A replica beside what its voter hands on: how far its own command was off.
//!
//! The voter may be on another host: what it hands on is compared with the command that it was made of, also if it comes some cycles later.

use bateleur_flight::servo;
use bateleur_messages::ActuatorCommand;

/// Cycles after which what the voter hands on is too old to be compared: its port's values are valid for two.
const REMEMBERED: usize = 4;

/// The last commands, newest first, each with the time of its cycle, ns.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct OwnCommands([Option<(u64, servo::ActuatorCommand)>; REMEMBERED]);

impl OwnCommands {
    /// Remembers the command of the cycle at `now_ns`; nothing else than one that flies is compared.
    pub(crate) fn remember(&mut self, now_ns: u64, command: &ActuatorCommand) {
        self.0.rotate_right(1);
        self.0[0] = flies(command).map(|command| (now_ns, command));
    }

    /// What was voted at `voted_ns`, less the own command of the cycle of `cycle_ns` in which that was.
    pub(crate) fn off(
        &self,
        voted: &ActuatorCommand,
        voted_ns: u64,
        cycle_ns: u64,
    ) -> Option<servo::ActuatorCommand> {
        // The vote has the time of one of the commands that it was made of, whose windows lie near each other.
        let off_ns = |one: &&(u64, servo::ActuatorCommand)| one.0.abs_diff(voted_ns);
        let (_, own) = self.0.iter().flatten().min_by_key(off_ns).filter(|one| off_ns(one) < cycle_ns / 2)?;
        let voted = flies(voted)?;
        Some(servo::ActuatorCommand {
            throttle: voted.throttle - own.throttle,
            aileron_rad: voted.aileron_rad - own.aileron_rad,
            elevator_rad: voted.elevator_rad - own.elevator_rad,
            rudder_rad: voted.rudder_rad - own.rudder_rad,
        })
    }
}

fn flies(command: &ActuatorCommand) -> Option<servo::ActuatorCommand> {
    let ActuatorCommand { throttle, aileron_rad, elevator_rad, rudder_rad, engaged, .. } = *command;
    let finite = [throttle, aileron_rad, elevator_rad, rudder_rad].iter().all(|number| number.is_finite());
    (engaged == 1 && finite).then_some(servo::ActuatorCommand {
        throttle,
        aileron_rad,
        elevator_rad,
        rudder_rad,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn command(throttle: f64) -> ActuatorCommand {
        ActuatorCommand { throttle, engaged: 1, ..ActuatorCommand::default() }
    }

    #[test]
    fn vote_is_compared_with_the_command_that_it_was_made_of() {
        let mut own = OwnCommands::default();
        assert_eq!(own.off(&command(0.5), 5, 20), None);
        for cycle in 0..20 {
            own.remember(20 * cycle, &command(cycle as f64));
        }
        for late in 0..REMEMBERED as u64 {
            let cycle = 19 - late;
            for between in [-3, 0, 3] {
                let voted_ns = (20 * cycle).saturating_add_signed(between);
                let off = own.off(&command(cycle as f64 + 0.25), voted_ns, 20).unwrap();
                assert_eq!(off, servo::ActuatorCommand { throttle: 0.25, ..Default::default() }, "{late}");
            }
        }
        assert_eq!(own.off(&command(0.5), 20 * 14 + 3, 20), None, "forgotten");
    }

    #[test]
    fn what_does_not_fly_is_not_compared() {
        let mut own = OwnCommands::default();
        own.remember(0, &command(0.5));
        assert_eq!(own.off(&ActuatorCommand { engaged: 0, ..command(0.6) }, 3, 20), None);
        own.remember(20, &ActuatorCommand { engaged: 0, ..command(0.5) });
        assert_eq!(own.off(&command(0.6), 23, 20), None);
        own.remember(40, &command(0.5));
        assert!(own.off(&command(0.6), 43, 20).is_some());
    }
}
