//! What the ground gets from a function that has a [`FunctionShell`] around it.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use bateleur_apex::{
    Context, Harness, Partition, QueuingDestination, QueuingSource, Retained, Sent, StartError, Window,
};
use bateleur_function_shell::{FunctionShell, Verdict};
use bateleur_messages::frame::Frame;
use bateleur_messages::ground::{Order, ParameterSetting};
use bateleur_messages::parameter::{ASKED_BY_LINE, Changed, Kind, Parameters, Row, name_bytes};
use bateleur_messages::telemetry::{
    ACCEPTED, Acknowledge, FROM_SERVO, NOT_UNDERSTOOD, REFUSED, Refusal, Telemetry,
};
use bateleur_messages::{GroundMessage, TelemetryMessage};

static ROWS: &[Row<f64>] = &[Row::settable(
    "TST_HOLD",
    Kind::Real,
    (0.0, 10.0),
    |hold_s| Some(*hold_s),
    |hold_s, value| {
        *hold_s = value;
        true
    },
)];

fn table() -> Parameters<f64> {
    Parameters::new(FROM_SERVO, ROWS)
}

/// Holds for one second, if the ground has not set another time.
struct Function {
    shell: FunctionShell<f64>,
    retained: Retained<Changed>,
    later: Option<GroundMessage>,
}

impl Partition for Function {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let mut shell = FunctionShell::open(context, FROM_SERVO, 1.0, table)?;
        let mut retained = context.retained()?;
        shell.resume(retained.load().as_ref());
        Ok(Self { shell, retained, later: None })
    }

    fn window(&mut self, window: &Window) {
        let (now_ns, mut configured) = (window.start_ns(), None);
        if let Some(message) = self.later.take() {
            self.shell.answer(&message, Verdict::Accepted, now_ns);
        }
        self.shell.take_orders(
            now_ns,
            &mut self.later,
            |_, hold_s| configured = Some(*hold_s),
            |later, hold_s, order, message| match order {
                Order::Autopilot { .. } => Verdict::Accepted,
                Order::Navigation { .. } => Verdict::Refused(Refusal::InFlight),
                Order::InitialiseSensors { .. } if *hold_s < 9.0 => {
                    *later = Some(*message);
                    Verdict::Later
                }
                _ => Verdict::NotUnderstood,
            },
        );
        assert!(configured.is_none_or(|hold_s| hold_s == *self.shell.settings()));
        self.retained.store(self.shell.changed());
        window.report(&format!("holds for {} s", self.shell.settings()));
    }
}

struct Ground {
    orders: QueuingSource<GroundMessage>,
    telemetry: QueuingDestination<TelemetryMessage>,
}

impl Ground {
    fn of(harness: &mut Harness) -> Self {
        Self {
            orders: harness.queuing_destination("ground", 16).unwrap(),
            telemetry: harness.queuing_source("telemetry", 16).unwrap(),
        }
    }

    fn order(&mut self, order: Order) {
        self.send(order.letter(), order.data());
    }

    fn send(&mut self, letter: u8, data: Vec<u8>) {
        let message = GroundMessage::from_frame(&Frame { letter, data }).unwrap();
        assert_eq!(self.orders.send(&message), Sent::Queued);
    }

    fn set(&mut self, name: &str, value: f64) {
        let name = name_bytes(name);
        self.order(Order::SetParameter(ParameterSetting {
            of: FROM_SERVO,
            asker: ASKED_BY_LINE,
            name,
            value,
        }));
    }

    /// Letter, result and reason of each acknowledgement that has come.
    fn acknowledged(&mut self) -> Vec<(u8, u8, Option<Refusal>)> {
        let mut all = Vec::new();
        while let Some(message) = self.telemetry.receive() {
            let frame = Frame { letter: message.letter, data: message.bytes().to_vec() };
            if let Ok(Telemetry::Acknowledge(one)) = Telemetry::of(&frame) {
                let Acknowledge { letter, result, from: FROM_SERVO, .. } = one else { panic!("{one:?}") };
                all.push((letter, result, Refusal::of(&one)));
            }
        }
        all
    }
}

#[test]
fn each_order_is_answered_as_the_function_decides_and_one_that_can_not_be_read_is_not_understood() {
    let mut harness = Harness::new("function").unwrap();
    harness.retained(4096).unwrap();
    let mut ground = Ground::of(&mut harness);
    let mut function = harness.start::<Function>().unwrap();
    ground.order(Order::Autopilot { on: true });
    ground.order(Order::Navigation { on: true });
    ground.order(Order::Hil { on: true });
    ground.send(b'A', vec![7; 9]);
    ground.order(Order::InitialiseSensors { sensors: 1 });
    function.window();
    let refused = (b'N', REFUSED, Some(Refusal::InFlight));
    assert_eq!(
        ground.acknowledged(),
        [(b'A', ACCEPTED, None), refused, (b'H', NOT_UNDERSTOOD, None), (b'A', NOT_UNDERSTOOD, None)]
    );
    function.window();
    assert_eq!(ground.acknowledged(), [(b'I', ACCEPTED, None)], "it is answered when it was carried out");
}

#[test]
fn parameter_that_was_set_is_in_force_at_once_and_after_a_warm_restart() {
    let mut harness = Harness::new("function").unwrap();
    harness.retained(4096).unwrap();
    let mut ground = Ground::of(&mut harness);
    let mut function = harness.start::<Function>().unwrap();
    ground.set("TST_HOLD", 2.5);
    ground.set("TST_HOLD", 11.0);
    function.window();
    let out_of_range = Some(Refusal::OutOfRange);
    assert_eq!(ground.acknowledged(), [(b'Y', ACCEPTED, None), (b'Y', REFUSED, out_of_range)]);
    assert_eq!(harness.reports(), ["holds for 2.5 s"]);
    drop(function);
    let mut successor = harness.start::<Function>().unwrap();
    successor.window();
    assert_eq!(harness.reports(), ["holds for 2.5 s"]);
}

#[test]
fn flood_of_orders_is_taken_eight_in_a_window() {
    let mut harness = Harness::new("function").unwrap();
    harness.retained(4096).unwrap();
    let mut ground = Ground::of(&mut harness);
    let mut function = harness.start::<Function>().unwrap();
    (0..12).for_each(|_| ground.order(Order::Autopilot { on: true }));
    function.window();
    assert_eq!(ground.acknowledged().len(), 8);
    function.window();
    assert_eq!(ground.acknowledged().len(), 4);
}
