//! What the ground has switched on.

use std::f64::consts::PI;
use std::ops::RangeInclusive;

use bateleur_messages::ground::{LoopId, Order};
use bateleur_messages::telemetry::Refusal;

/// The answer to an order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// Done.
    Accepted,
    /// Understood, but not possible now.
    Refused(Refusal),
    /// Not an order for this function, or a value that no aircraft can fly.
    NotUnderstood,
}

/// Switches and targets.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Orders {
    /// The autopilot flies.
    pub autopilot: bool,
    /// Along the way-points.
    pub navigation: bool,
    pub(crate) targets: [Option<f64>; LoopId::ALL.len()],
}

impl Orders {
    /// The target of a loop that the ground has switched on.
    pub fn target(&self, id: LoopId) -> Option<f64> {
        self.targets[id as usize]
    }

    /// Takes an order. Switching the autopilot off switches all loops off too: the next time it is switched on, it does
    /// not fly a target that somebody gave an hour ago. Navigation stays, because it may be switched on before.
    pub fn take(&mut self, order: &Order) -> Answer {
        match *order {
            Order::Autopilot { on } => {
                self.autopilot = on;
                if !on {
                    self.targets = Default::default();
                }
            }
            Order::Navigation { on } => self.navigation = on,
            Order::Loop { id, on: false, .. } => self.targets[id as usize] = None,
            Order::Loop { id, on: true, target } if range(id).contains(&target) => {
                self.targets[id as usize] = Some(target);
            }
            _ => return Answer::NotUnderstood,
        }
        Answer::Accepted
    }
}

/// Targets that make sense for some aircraft; the laws limit them further to what this one can do.
fn range(id: LoopId) -> RangeInclusive<f64> {
    match id {
        LoopId::RollAngle => -1.05..=1.05, // 60°, where the laws end
        LoopId::RollRate => -3.0..=3.0,
        LoopId::PitchRate => -1.0..=1.0,
        LoopId::Airspeed => 10.0..=60.0,
        LoopId::Altitude => -500.0..=5_000.0,
        LoopId::ClimbRate => -10.0..=10.0,
        LoopId::Heading => -2.0 * PI..=2.0 * PI,
        LoopId::Axial => -5.0..=5.0,
        LoopId::Lateral => -5.0..=5.0,
        LoopId::Normal => -35.0..=0.0, // 3.5 g
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_messages::ground::EstimatorOrder;

    #[test]
    fn a_loop_is_switched_on_with_its_target_and_off_again() {
        let mut orders = Orders::default();
        let order = |on| Order::Loop { id: LoopId::RollAngle, on, target: 0.3 };
        assert_eq!(orders.take(&order(true)), Answer::Accepted);
        assert_eq!(orders.target(LoopId::RollAngle), Some(0.3));
        assert_eq!(orders.target(LoopId::RollRate), None);
        assert_eq!(orders.take(&order(false)), Answer::Accepted);
        assert_eq!(orders.target(LoopId::RollAngle), None);
    }

    #[test]
    fn a_target_that_no_aircraft_can_fly_changes_nothing() {
        let mut orders = Orders::default();
        orders.take(&Order::Loop { id: LoopId::Airspeed, on: true, target: 25.0 });
        let wild = Order::Loop { id: LoopId::Airspeed, on: true, target: 900.0 };
        assert_eq!(orders.take(&wild), Answer::NotUnderstood);
        assert_eq!(orders.target(LoopId::Airspeed), Some(25.0));
    }

    #[test]
    fn the_autopilot_forgets_its_loops_when_it_is_switched_off() {
        let mut orders = Orders::default();
        orders.take(&Order::Autopilot { on: true });
        orders.take(&Order::Loop { id: LoopId::RollAngle, on: true, target: 0.3 });
        orders.take(&Order::Autopilot { on: false });
        assert_eq!(orders, Orders::default());
    }

    #[test]
    fn an_order_for_another_function_is_not_understood() {
        let order = Order::Estimator(EstimatorOrder::Enable);
        assert_eq!(Orders::default().take(&order), Answer::NotUnderstood);
    }
}
