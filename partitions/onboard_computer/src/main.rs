//! The function that reports the status and the supply voltages of the whole system.

use std::process::ExitCode;

use bateleur_apex::{Context, Partition, SamplingDestination, StartError, Window};
use bateleur_function_shell::FunctionShell;
use bateleur_messages::parameter::Parameters;
use bateleur_messages::telemetry::{FROM_ONBOARD_COMPUTER, Telemetry};
use bateleur_messages::{Custom, FunctionStatus, Rate, SimulatorLink, Watch};
use bateleur_onboard_computer::{Functions, primary, voltages};

pub(crate) struct OnBoardComputer {
    custom: SamplingDestination<Custom>,
    hil: SamplingDestination<FunctionStatus>,
    /// Where the plan has it.
    hil_link: Option<SamplingDestination<SimulatorLink>>,
    estimator: SamplingDestination<FunctionStatus>,
    controller: SamplingDestination<FunctionStatus>,
    servo: SamplingDestination<FunctionStatus>,
    rate: SamplingDestination<Rate>,
    /// It has no parameters, and says so.
    shell: FunctionShell<()>,
    timeout_1: Watch,
    timeout_3: Watch,
}

impl Partition for OnBoardComputer {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        Ok(Self {
            custom: context.sampling_destination("custom")?,
            hil: context.sampling_destination("hil_status")?,
            hil_link: context.optional_destination("hil_link")?,
            estimator: context.sampling_destination("estimator_status")?,
            controller: context.sampling_destination("controller_status")?,
            servo: context.sampling_destination("servo_status")?,
            rate: context.sampling_destination("rate")?,
            shell: FunctionShell::open(context, FROM_ONBOARD_COMPUTER, (), no_parameters)?,
            timeout_1: Watch::default(),
            timeout_3: Watch::default(),
        })
    }

    fn window(&mut self, window: &Window) {
        self.shell.take_parameters(window.start_ns());
        let Some(rate) = self.rate.read_valid() else { return };
        let primary_due = self.timeout_1.changed(rate.timeout_1);
        let secondary_due = self.timeout_3.changed(rate.timeout_3);
        if primary_due {
            let report = primary(window.start_ns(), &self.functions());
            self.shell.send(&Telemetry::Primary(report));
            if let Some(link) = self.hil_link.as_mut().and_then(SamplingDestination::read_valid).copied() {
                self.shell.send(&Telemetry::Simulator(link));
            }
        }
        if secondary_due {
            let report = voltages(window.start_ns(), self.custom.read_valid());
            self.shell.send(&Telemetry::Voltages(report));
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

fn no_parameters() -> Parameters<()> {
    Parameters::new(FROM_ONBOARD_COMPUTER, &[])
}

pub(crate) fn main() -> ExitCode {
    bateleur_apex::run::<OnBoardComputer>()
}
