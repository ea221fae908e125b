//! The function that turns actuator commands into timer values, or passes the safety pilot through.
//!
//! Responsible for: a pulse width for each actuator in every cycle, whatever is missing. It must never leave the
//! actuators to a command that is old, not finite, or from a Controller that idles.
//!
//! Who has the actuators, in this order:
//!
//! 1. the Controller, while the ground has the autopilot on and an engaged command arrives;
//! 2. the last output, for at most `hold` after the Controller's last command: a restart of the Controller takes a
//!    few cycles, and a surface that jumps to another place and back is worse than one that stands still;
//! 3. the safety pilot: with the autopilot off, with a Controller that says it idles, and after the hold time;
//! 4. where there are no sticks either: the last output for `hold`, then surfaces neutral and half throttle, so that
//!    a stable aircraft neither turns nor glides into the ground at once.

mod parameters;
mod settings;

pub use parameters::{Memory, parameters};
pub use settings::Settings;

use bateleur_flight::servo::{ActuatorCommand as Deflections, ServoMap};
use bateleur_messages::ground::{Order, OrderError};
use bateleur_messages::telemetry::ServoTelemetry;
use bateleur_messages::{ActuatorCommand, Custom, FunctionStatus, ServoTimers};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Pulse widths that a receiver can really give, µs. A receiver without a transmitter gives none at all (0), and the
/// widest that radios use with extended travel are 900 and 2100.
const STICK_US: std::ops::RangeInclusive<u16> = 850..=2150;
/// Where actuators go when nobody has them, µs: surfaces neutral, half throttle.
const NOBODY_US: [u16; 5] = [1500; 5];
/// [`ServoTelemetry`] and [`Kept`] list the timers in this order: left and right aileron, elevator, rudder, throttle.
type TimersUs = [u16; 5];

/// Who is behind the timer values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// The Controller.
    Autopilot,
    /// The safety pilot's sticks.
    Pilot,
    /// Nobody at the moment: the last output stands.
    Held,
    /// Nobody for longer than the hold time.
    Nobody,
}

/// What outlives a warm restart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Kept {
    /// Module time of the last output that had somebody behind it, ns.
    pub led_ns: u64,
    /// Output cycles so far.
    pub cycle: u32,
    /// 1 while the ground has the autopilot on.
    pub autopilot: u16,
    /// 1 when the Controller was behind the last output.
    pub from_controller: u16,
    /// The last output, µs.
    pub timers_us: TimersUs,
    /// Unused, zero.
    pub reserved: [u16; 3],
}

/// The function.
#[derive(Debug)]
pub struct Servo {
    map: ServoMap,
    hold_ns: u64,
    kept: Kept,
    source: Source,
    accepted: u64,
    missing: u64,
}

impl Servo {
    /// A function for an aircraft with the travel of `map`, that lets the last output stand for `hold_ns`. It goes on
    /// where `kept` stood; without it, at the module's start, the autopilot is off and the throttle is closed.
    pub fn new(map: ServoMap, hold_ns: u64, kept: Option<Kept>) -> Self {
        let at_rest = Kept {
            led_ns: 0,
            cycle: 0,
            autopilot: 0,
            from_controller: 0,
            timers_us: [1500, 1500, 1500, 1500, 1000],
            reserved: [0; 3],
        };
        let kept = kept.filter(|kept| kept.timers_us.iter().all(|timer| STICK_US.contains(timer)));
        Self { map, hold_ns, kept: kept.unwrap_or(at_rest), source: Source::Nobody, accepted: 0, missing: 0 }
    }

    /// Takes an order of the ground.
    pub fn order(&mut self, order: Result<Order, OrderError>) -> bool {
        let Ok(Order::Autopilot { on }) = order else { return false };
        self.kept.autopilot = u16::from(on);
        true
    }

    /// The timer values of the cycle at `now_ns`, from the command and the sticks that are valid now.
    pub fn step(
        &mut self,
        now_ns: u64,
        command: Option<&ActuatorCommand>,
        sticks: Option<&Custom>,
    ) -> ServoTimers {
        let command = command.filter(|command| is_finite(command));
        self.count(command.is_some(), sticks.is_some());
        let (source, timers_us) = self.choose(now_ns, command, sticks.and_then(stick_timers));
        if matches!(source, Source::Autopilot | Source::Pilot) {
            self.kept.led_ns = now_ns;
            self.kept.from_controller = u16::from(source == Source::Autopilot);
        }
        self.source = source;
        self.kept.timers_us = timers_us;
        self.kept.cycle = self.kept.cycle.wrapping_add(1);
        self.timers()
    }

    /// Lets the last output stand for `hold_ns` from now on.
    pub fn configure(&mut self, hold_ns: u64) {
        self.hold_ns = hold_ns;
    }

    /// What outlives a warm restart.
    pub fn kept(&self) -> &Kept {
        &self.kept
    }

    /// Who is behind the last output.
    pub fn source(&self) -> Source {
        self.source
    }

    /// What the OnBoardComputer is told; `starts` is how often the function was started.
    pub fn status(&self, starts: u64) -> FunctionStatus {
        FunctionStatus {
            enabled: u32::from(self.kept.autopilot),
            ready: u32::from(self.follows()),
            accepted: self.accepted,
            refused: self.missing,
            starts,
        }
    }

    /// What the ground is told.
    pub fn telemetry(&self, time_ns: u64) -> ServoTelemetry {
        ServoTelemetry {
            time_ns,
            timers_us: self.kept.timers_us,
            autopilot: self.timers().autopilot,
            cycle: self.kept.cycle,
        }
    }

    /// Whether those have the actuators who shall have them.
    fn follows(&self) -> bool {
        match self.source {
            Source::Autopilot => true,
            Source::Pilot => self.kept.autopilot == 0,
            Source::Held => self.timers().autopilot == 1,
            Source::Nobody => false,
        }
    }

    fn choose(
        &self,
        now_ns: u64,
        command: Option<&ActuatorCommand>,
        sticks: Option<TimersUs>,
    ) -> (Source, TimersUs) {
        let autopilot = self.kept.autopilot == 1;
        if let Some(command) = command.filter(|command| autopilot && command.engaged == 1) {
            return (Source::Autopilot, self.timers_of(command));
        }
        let led_lately = self.kept.led_ns > 0 && now_ns.saturating_sub(self.kept.led_ns) <= self.hold_ns;
        // A Controller that is there and idles has let go; one that is silent may be back in a moment.
        if autopilot && command.is_none() && self.kept.from_controller == 1 && led_lately {
            return (Source::Held, self.kept.timers_us);
        }
        match sticks {
            Some(timers) => (Source::Pilot, timers),
            None if led_lately || self.kept.led_ns == 0 => (Source::Held, self.kept.timers_us),
            None => (Source::Nobody, NOBODY_US),
        }
    }

    /// Both aileron servos get the same pulse, positive rolls right: they are mounted as mirror images.
    fn timers_of(&self, command: &ActuatorCommand) -> TimersUs {
        let timers = self.map.to_timer(&Deflections {
            throttle: command.throttle,
            aileron_rad: command.aileron_rad,
            elevator_rad: command.elevator_rad,
            rudder_rad: command.rudder_rad,
        });
        [timers.aileron_us, timers.aileron_us, timers.elevator_us, timers.rudder_us, timers.throttle_us]
    }

    fn timers(&self) -> ServoTimers {
        let [aileron_left_us, aileron_right_us, elevator_us, rudder_us, throttle_us] = self.kept.timers_us;
        let held_for_controller = self.source == Source::Held && self.kept.from_controller == 1;
        ServoTimers {
            aileron_left_us,
            aileron_right_us,
            elevator_us,
            rudder_us,
            throttle_us,
            autopilot: u16::from(self.source == Source::Autopilot || held_for_controller),
            cycle: self.kept.cycle,
        }
    }

    fn count(&mut self, command: bool, sticks: bool) {
        let wanted = if self.kept.autopilot == 1 { command } else { sticks };
        *(if wanted { &mut self.accepted } else { &mut self.missing }) += 1;
    }
}

fn is_finite(command: &ActuatorCommand) -> bool {
    [command.throttle, command.aileron_rad, command.elevator_rad, command.rudder_rad]
        .iter()
        .all(|value| value.is_finite())
}

/// The sticks as they are; nothing where a channel is no pulse.
fn stick_timers(sticks: &Custom) -> Option<TimersUs> {
    let timers = [
        sticks.pilot_aileron_us,
        sticks.pilot_aileron_us,
        sticks.pilot_elevator_us,
        sticks.pilot_rudder_us,
        sticks.pilot_throttle_us,
    ];
    timers.iter().all(|timer| STICK_US.contains(timer)).then_some(timers)
}

#[cfg(test)]
mod tests;
