//! Orders from the control socket, taken in the monitor's step on either clock: a few in each, so that no flood of them
//! makes a step long.

use std::sync::Arc;

use super::Monitor;
use super::observers::{Observers, StartObserver};
use super::watched::{Life, Then};
use crate::inject::Fault;
use crate::planned::{Act, STANDBY};
use bateleur_control::{Answer, Inbox, Ordered, Request, Status};
use bateleur_plan::did_you_mean;
use bateleur_time::schedule_switch::Requested;
use bateleur_time::stall::Stall;

/// Orders that are carried out in one step.
const ORDERS_A_STEP: usize = 4;

/// What operators work with.
#[derive(Default)]
pub struct Operator {
    inbox: Option<Inbox>,
    /// What does not change in a status.
    pub(super) about: Status,
    pub(super) stall: Arc<Stall>,
    pub(super) observers: Observers,
}

impl Operator {
    /// `stall`: shared with the dispatchers. `inbox`: where orders come from; `None` if there is no socket. `about`: the module's name, its process, its clock.
    #[must_use]
    pub fn new(
        inbox: Option<Inbox>,
        about: Status,
        stall: Arc<Stall>,
        start_observer: Option<StartObserver>,
    ) -> Self {
        Self { inbox, about, stall, observers: Observers::new(start_observer) }
    }
}

impl Monitor {
    /// Carries out what operators have ordered.
    pub(super) fn serve_requests(&mut self, module_ns: u64) {
        self.look_at_observers();
        for _ in 0..ORDERS_A_STEP {
            let Some(ordered) = self.operator.inbox.as_ref().and_then(Inbox::take) else { return };
            let answer = self.answer(&ordered, module_ns).unwrap_or_else(Answer::refused);
            if let Some(inbox) = &self.operator.inbox {
                inbox.answer(&ordered, answer);
            }
        }
    }

    fn answer(&mut self, ordered: &Ordered, module_ns: u64) -> Result<Answer, String> {
        match &ordered.request {
            Request::Ports => Ok(Answer::Ports { channels: self.channel_list() }),
            Request::Links => Ok(Answer::Links { links: self.link_names() }),
            Request::Watch { ports } => {
                let (answer, observer) = self.watch(ordered, ports)?;
                self.take_on(observer);
                Ok(answer)
            }
            Request::Status => Ok(Answer::Status(Box::new(self.status(module_ns)))),
            Request::Kill { partition } => match partition.strip_suffix(STANDBY) {
                Some(partition) => self.act_on(partition, Act::KillStandby, module_ns),
                None => self.act_on(partition, Act::Kill, module_ns),
            },
            Request::Stop { partition } => self.act_on(partition, Act::Stop, module_ns),
            Request::Start { partition } => self.act_on(partition, Act::Start, module_ns),
            Request::Freeze { partition } => self.act_on(partition, Act::Freeze, module_ns),
            Request::Thaw { partition } => self.act_on(partition, Act::Thaw, module_ns),
            Request::Inject { target, fault } => self.inject(target, fault, module_ns),
            Request::Schedule { name } => self.change_schedule(name, module_ns),
        }
    }

    fn act_on(&mut self, name: &str, act: Act, module_ns: u64) -> Result<Answer, String> {
        let place = self.place_of(name)?;
        let partition = self.watched[place].sandbox.id.index();
        let text = self.carry_out(partition, act, module_ns).map_err(|why| format!("{name} {why}"))?;
        self.note_order(Some(place), &format!("{}, by the operator", act.name()), module_ns);
        Ok(Answer::Done { text: format!("{name} {text}") })
    }

    fn inject(&mut self, target: &str, fault: &str, module_ns: u64) -> Result<Answer, String> {
        let fault: Fault = fault.parse()?;
        let aim = fault.aim(&self.plan, target)?;
        self.provoke(fault, &aim, module_ns)?;
        if let Some(place) = aim.partition.and_then(|partition| self.places[partition]) {
            let text = format!("fault {fault} aimed at {target}, by the operator");
            self.note_order(Some(place), &text, module_ns);
        }
        Ok(Answer::Done { text: format!("{fault} is provoked in {target}") })
    }

    fn change_schedule(&mut self, name: &str, module_ns: u64) -> Result<Answer, String> {
        let schedules = || self.plan.schedules.iter().map(|schedule| schedule.name.as_str());
        let unknown = format!("the plan has no schedule \"{name}\": {}", did_you_mean(name, schedules()));
        let text = match self.request_schedule(name, module_ns).map_err(|_| unknown)? {
            Requested::Pending => format!("schedule {name} takes effect with the next major frame"),
            Requested::Already => format!("schedule {name} runs already"),
        };
        Ok(Answer::Done { text })
    }

    /// The place of the partition called `name`.
    fn place_of(&self, name: &str) -> Result<usize, String> {
        let mut names = self.watched.iter().map(|watched| watched.sandbox.name.as_str());
        names.clone().position(|known| known == name).ok_or_else(|| {
            format!("the module has no partition \"{name}\": {}", did_you_mean(name, &mut names))
        })
    }

    fn status(&self, module_ns: u64) -> Status {
        let partitions = self.watched.iter().map(|watched| {
            let (mode, pid) = match &watched.life {
                Life::Starting(process, _) => ("starting", Some(process.pid)),
                Life::Running(process) if watched.held => ("frozen", Some(process.pid)),
                Life::Running(process) => ("normal", Some(process.pid)),
                Life::Dead(_, Then::Successor) | Life::Unstarted(_) => ("restarting", None),
                Life::Dead(_, Then::Rest) | Life::Gone => ("idle", None),
            };
            bateleur_control::PartitionStatus {
                name: watched.sandbox.name.clone(),
                pid,
                mode: mode.into(),
                generation: watched.generation,
                standby: watched.standby.as_ref().map(|standby| standby.state().into()),
                ..watched.figures.status()
            }
        });
        let (current, next) = (self.schedule_switch.current(), self.schedule_switch.next());
        let schedule = &self.plan.schedules[current];
        Status {
            module_ns,
            schedule: schedule.name.clone(),
            next_schedule: (next != current).then(|| self.plan.schedules[next].name.clone()),
            minor_frame_ns: schedule.minor_frame_ns,
            major_frame_ns: schedule.major_frame_ns,
            lost_windows: self.totals.lost,
            windows: self.totals.windows,
            late_windows: self.totals.late,
            window_overruns: self.totals.overruns,
            alignment: self.alignment.as_ref().map(super::align::Alignment::status),
            partitions: partitions.collect(),
            ..self.operator.about.clone()
        }
    }
}
