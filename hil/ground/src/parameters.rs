//! The parameters of the functions, for the person at the ground station: asked for one function after the other, listed when all
//! have answered, set one at a time.

use bateleur_messages::ground::{Order, ParameterSetting};
use bateleur_messages::parameter::{ASKED_BY_LINE, Gatherer, Kind, ParameterValue, function_of, name_bytes};
use bateleur_messages::telemetry::{Acknowledge, FUNCTIONS, Refusal, Telemetry, function_name};

/// See the module.
#[derive(Debug)]
pub struct ParameterDesk {
    gatherer: Gatherer,
    /// Beginning of the names that are to be listed when all is known.
    listing: Option<String>,
}

impl Default for ParameterDesk {
    fn default() -> Self {
        let functions = FUNCTIONS.into_iter().map(|(number, _)| number);
        Self { gatherer: Gatherer::new(functions, ASKED_BY_LINE), listing: None }
    }
}

impl ParameterDesk {
    /// Begins to ask for all; those whose names begin with `beginning` are listed when they are known.
    pub fn list(&mut self, beginning: &str) {
        self.gatherer.begin();
        self.listing = Some(beginning.to_ascii_uppercase());
    }

    /// Nothing is asked for.
    pub fn is_idle(&self) -> bool {
        self.listing.is_none()
    }

    /// Takes what came down.
    pub fn take(&mut self, telemetry: &Telemetry) {
        match telemetry {
            Telemetry::Parameter(value) => self.gatherer.take(value),
            Telemetry::Acknowledge(answer) => self.gatherer.answered(answer),
            _ => {}
        }
    }

    /// True for what a list consists of, which is not shown one by one, and for what there is not: a refusal has said so.
    pub fn hides(&self, telemetry: &Telemetry) -> bool {
        match telemetry {
            Telemetry::Parameter(value) => {
                self.listing.is_some() || value.refusal() == Some(Refusal::NoSuchParameter)
            }
            Telemetry::Acknowledge(Acknowledge { letter, .. }) => *letter == b'R',
            _ => false,
        }
    }

    /// Questions that are due at `now_ns` of the caller's clock, and the list, once, when it is whole.
    pub fn step(&mut self, now_ns: u64) -> (Vec<Order>, Option<String>) {
        let questions = self.gatherer.due(now_ns);
        let list = if self.gatherer.is_done() { self.listing.take() } else { None };
        (questions, list.map(|beginning| self.text(&beginning)))
    }

    fn text(&self, beginning: &str) -> String {
        let chosen = self.gatherer.known().filter(|value| value.name().starts_with(beginning));
        let mut lines: Vec<String> = chosen.map(describe_parameter).collect();
        if lines.is_empty() {
            lines.push(format!("no parameter begins with \"{beginning}\""));
        }
        let silent = self.gatherer.silent().filter_map(function_name);
        lines.extend(silent.map(|name| format!("{name} does not answer: its parameters are missing")));
        lines.join("\n") + "\n"
    }
}

/// The order that sets a parameter, by its name; `None` if no function has names like that.
pub(crate) fn setting(name: &str, value: f64) -> Option<Order> {
    let name = name.to_ascii_uppercase();
    let of = function_of(&name)?;
    Some(Order::SetParameter(ParameterSetting { of, asker: ASKED_BY_LINE, name: name_bytes(&name), value }))
}

/// One parameter as a line of text.
pub fn describe_parameter(value: &ParameterValue) -> String {
    let limits = match (value.settable, Kind::from_number(value.kind)) {
        (0, _) => "fixed".to_owned(),
        (_, Kind::Real) => format!("{} to {}", value.lowest, value.highest),
        _ => format!("{} to {}, whole", value.lowest, value.highest),
    };
    // Enough digits for a gain, and none for a number that has none.
    let number = format!("{:.9}", value.value);
    let number = number.trim_end_matches('0').trim_end_matches('.');
    format!("{:<16}  {number:>16}  {limits}", value.name())
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_messages::telemetry::{FROM_CONTROLLER, NOT_UNDERSTOOD};

    fn value(name: &str, index: u16, settable: u8) -> ParameterValue {
        ParameterValue {
            from: FROM_CONTROLLER,
            index,
            count: 2,
            settable,
            value: 0.4,
            highest: 1.0,
            name: name_bytes(name),
            ..ParameterValue::default()
        }
    }

    #[test]
    fn list_is_shown_when_all_have_answered_or_are_given_up() {
        let mut desk = ParameterDesk::default();
        desk.list("ctl_a");
        let mut list = None;
        for step in 0..40 {
            let (questions, text) = desk.step(step * 100_000_000);
            for question in questions {
                let Order::ReadParameter { of, index, .. } = question else { panic!("{question:?}") };
                match (of, index) {
                    (FROM_CONTROLLER, 0) => desk.take(&Telemetry::Parameter(value("CTL_ALT_P", 0, 1))),
                    (FROM_CONTROLLER, _) => desk.take(&Telemetry::Parameter(value("CTL_MASS", 1, 0))),
                    (2, _) => {}
                    (of, _) => desk.take(&Telemetry::Acknowledge(Acknowledge {
                        letter: b'R',
                        first: of,
                        result: NOT_UNDERSTOOD,
                        ..Acknowledge::default()
                    })),
                }
            }
            list = list.or(text);
        }
        assert_eq!(
            list.unwrap(),
            "CTL_ALT_P                      0.4  0 to 1\nimu does not answer: its parameters are missing\n"
        );
        assert!(desk.is_idle());
    }

    #[test]
    fn parameter_that_does_not_exist_has_no_value_to_be_shown() {
        let desk = ParameterDesk::default();
        let refused = |reason: Refusal| {
            let value = ParameterValue { reason: reason as u32, ..value("CTL_LAPZ", 0, 0) };
            desk.hides(&Telemetry::Parameter(value))
        };
        assert!(refused(Refusal::NoSuchParameter));
        assert!(!refused(Refusal::OutOfRange), "what stands is shown");
    }

    #[test]
    fn parameter_is_set_at_the_function_that_its_name_begins_with() {
        let Some(Order::SetParameter(order)) = setting("ctl_laps", 3.0) else { panic!() };
        assert_eq!((order.of, &order.name[..9]), (FROM_CONTROLLER, &b"CTL_LAPS\0"[..]));
        assert_eq!(setting("XYZ_LAPS", 3.0), None);
    }
}
