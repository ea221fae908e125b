//! The function that reports the status and the supply voltages of the whole system.

use std::process::ExitCode;

use bateleur_apex::{
    Context, Direction, Partition, PortKind, QueuingDestination, QueuingSource, SamplingDestination,
    StartError, Window,
};
use bateleur_messages::parameter::{Answer, Parameters};
use bateleur_messages::telemetry::{FROM_ONBOARD_COMPUTER, Telemetry};
use bateleur_messages::{
    Custom, FunctionStatus, GroundMessage, Rate, SimulatorLink, TelemetryMessage, Watch,
};
use bateleur_onboard_computer::{Functions, primary, voltages};

/// Ground messages taken in one window at most; as many as the queue usually holds.
const ORDERS_PER_WINDOW: usize = 8;

struct OnBoardComputer {
    custom: SamplingDestination<Custom>,
    hil: SamplingDestination<FunctionStatus>,
    /// Where the plan has it.
    hil_link: Option<SamplingDestination<SimulatorLink>>,
    estimator: SamplingDestination<FunctionStatus>,
    controller: SamplingDestination<FunctionStatus>,
    servo: SamplingDestination<FunctionStatus>,
    rate: SamplingDestination<Rate>,
    ground: QueuingDestination<GroundMessage>,
    telemetry: QueuingSource<TelemetryMessage>,
    timeout_1: Watch,
    timeout_3: Watch,
}

impl Partition for OnBoardComputer {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        Ok(Self {
            custom: context.sampling_destination("custom")?,
            hil: context.sampling_destination("hil_status")?,
            hil_link: declared(context, "hil_link")
                .then(|| context.sampling_destination("hil_link"))
                .transpose()?,
            estimator: context.sampling_destination("estimator_status")?,
            controller: context.sampling_destination("controller_status")?,
            servo: context.sampling_destination("servo_status")?,
            rate: context.sampling_destination("rate")?,
            ground: context.queuing_destination("ground")?,
            telemetry: context.queuing_source("telemetry")?,
            timeout_1: Watch::default(),
            timeout_3: Watch::default(),
        })
    }

    fn window(&mut self, window: &Window) {
        // No ground message concerns this function, but it says that it has no parameters; none may fill its queue.
        let mut none: Parameters<()> = Parameters::new(FROM_ONBOARD_COMPUTER, &[]);
        for message in std::iter::from_fn(|| self.ground.receive()).take(ORDERS_PER_WINDOW) {
            let answer = none.take(&message, &mut (), window.start_ns());
            answer.iter().flat_map(Answer::messages).for_each(|message| {
                self.telemetry.send(&message);
            });
        }
        let Some(rate) = self.rate.read_valid() else { return };
        let primary_due = self.timeout_1.changed(rate.timeout_1);
        let secondary_due = self.timeout_3.changed(rate.timeout_3);
        if primary_due {
            let report = primary(window.start_ns(), &self.functions());
            self.telemetry.send(&TelemetryMessage::of(&Telemetry::Primary(report)));
            if let Some(link) = self.hil_link.as_mut().and_then(SamplingDestination::read_valid).copied() {
                self.telemetry.send(&TelemetryMessage::of(&Telemetry::Simulator(link)));
            }
        }
        if secondary_due {
            let report = voltages(window.start_ns(), self.custom.read_valid());
            self.telemetry.send(&TelemetryMessage::of(&Telemetry::Voltages(report)));
        }
    }
}

impl OnBoardComputer {
    fn functions(&mut self) -> Functions {
        Functions {
            hil: self.hil.read_valid().copied(),
            estimator: self.estimator.read_valid().copied(),
            controller: self.controller.read_valid().copied(),
            servo: self.servo.read_valid().copied(),
        }
    }
}

/// Whether the plan has the port.
fn declared(context: &Context, name: &str) -> bool {
    context.port_names(PortKind::Sampling, Direction::Destination).iter().any(|port| port == name)
}

fn main() -> ExitCode {
    bateleur_apex::run::<OnBoardComputer>()
}
