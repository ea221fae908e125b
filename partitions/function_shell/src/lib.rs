//! What every flight function has around its task: the ports to and from the ground, orders, and parameters that the ground may set.

#![forbid(unsafe_code)]

use bateleur_apex::{Context, QueuingDestination, QueuingSource, StartError};
use bateleur_messages::ground::Order;
use bateleur_messages::parameter::{Changed, Parameters};
use bateleur_messages::telemetry::{ACCEPTED, Acknowledge, NOT_UNDERSTOOD, Refusal, Telemetry};
use bateleur_messages::{GroundMessage, TelemetryMessage};

/// Ground messages taken in one window at most; as many as the queue usually holds. A long list takes a few windows.
const ORDERS_PER_WINDOW: usize = 8;

/// What becomes of an order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// It is carried out.
    Accepted,
    /// It was understood, and is not carried out.
    Refused(Refusal),
    /// The function does not know it.
    NotUnderstood,
    /// The answer comes when the order is carried out: [`FunctionShell::answer`].
    Later,
}

/// The ports `ground` and `telemetry` of a function, and its settings.
pub struct FunctionShell<S: 'static> {
    /// The function: a `FROM_…` constant.
    from: u8,
    plan: S,
    settings: S,
    parameters: Parameters<S>,
    table: fn() -> Parameters<S>,
    ground: QueuingDestination<GroundMessage>,
    telemetry: QueuingSource<TelemetryMessage>,
}

impl<S: Copy> FunctionShell<S> {
    /// The shell of function `from` (a `FROM_…` constant) with the settings of the plan and its table of parameters.
    ///
    /// # Errors
    /// The plan lacks one of the two ports.
    pub fn open(
        context: &mut Context,
        from: u8,
        plan: S,
        table: fn() -> Parameters<S>,
    ) -> Result<Self, StartError> {
        Ok(Self {
            from,
            plan,
            settings: plan,
            parameters: table(),
            table,
            ground: context.queuing_destination("ground")?,
            telemetry: context.queuing_source("telemetry")?,
        })
    }

    /// Takes the plan's settings, and what the ground had set before a warm restart.
    pub fn resume(&mut self, changed: Option<&Changed>) -> S {
        (self.settings, self.parameters) = (self.plan, (self.table)());
        if let Some(changed) = changed {
            self.parameters.resume(changed, &mut self.settings);
        }
        self.settings
    }

    /// What the plan says, and what the ground has set since.
    #[must_use]
    pub fn settings(&self) -> &S {
        &self.settings
    }

    /// What the ground has set, for retained memory.
    #[must_use]
    pub fn changed(&self) -> &Changed {
        self.parameters.changed()
    }

    /// Takes what the ground has sent. Messages about parameters are answered from the table, and `configure` gets settings that they
    /// have changed; every other order goes to `order`, with the settings and its
    /// message. Both get the `function`.
    pub fn take_orders<F>(
        &mut self,
        now_ns: u64,
        function: &mut F,
        mut configure: impl FnMut(&mut F, &S),
        mut order: impl FnMut(&mut F, &S, Order, &GroundMessage) -> Verdict,
    ) {
        for _ in 0..ORDERS_PER_WINDOW {
            let Some(message) = self.ground.receive() else { return };
            match self.answer_about_parameters(&message, now_ns) {
                Some(true) => configure(function, &self.settings),
                Some(false) => {}
                None => {
                    let parsed = Order::parse(message.letter, message.bytes());
                    let verdict = parsed
                        .map_or(Verdict::NotUnderstood, |one| order(function, &self.settings, one, &message));
                    self.answer(&message, verdict, now_ns);
                }
            }
        }
    }

    /// Takes what the ground has sent, for a function that is only switched on and off; the last such order.
    pub fn take_switch(&mut self, now_ns: u64) -> Option<bool> {
        let mut switch = None;
        let order = |switch: &mut Option<bool>, _: &S, order, _: &GroundMessage| match order {
            Order::Hil { on } => {
                *switch = Some(on);
                Verdict::Accepted
            }
            _ => Verdict::NotUnderstood,
        };
        self.take_orders(now_ns, &mut switch, |_, _| {}, order);
        switch
    }

    /// Takes what the ground has sent, for a function that no other order concerns: none may fill its queue.
    pub fn take_parameters(&mut self, now_ns: u64) {
        for _ in 0..ORDERS_PER_WINDOW {
            let Some(message) = self.ground.receive() else { return };
            self.answer_about_parameters(&message, now_ns);
        }
    }

    /// Whether the settings are others now; `None` if the message is not about parameters.
    fn answer_about_parameters(&mut self, message: &GroundMessage, now_ns: u64) -> Option<bool> {
        let answer = self.parameters.take(message, &mut self.settings, now_ns)?;
        for message in answer.messages() {
            self.telemetry.send(&message);
        }
        Some(answer.changed)
    }

    /// Answers an order.
    pub fn answer(&mut self, message: &GroundMessage, verdict: Verdict, now_ns: u64) {
        let answer = match verdict {
            Verdict::Accepted => Acknowledge::of(message, self.from, ACCEPTED, now_ns),
            Verdict::Refused(why) => Acknowledge::refused(message, self.from, why, now_ns),
            Verdict::NotUnderstood => Acknowledge::of(message, self.from, NOT_UNDERSTOOD, now_ns),
            Verdict::Later => return,
        };
        self.send(&Telemetry::Acknowledge(answer));
    }

    /// Sends telemetry to the ground; what has no room in the queue is lost.
    pub fn send(&mut self, telemetry: &Telemetry) {
        self.telemetry.send(&TelemetryMessage::of(telemetry));
    }
}
