//! Orders from the control socket, carried out and answered in the monitor's step on either clock: a few in each, so that no flood of
//! them makes a step long.

use crate::act::{Act, STANDBY};
use crate::inject::Fault;
use crate::lifecycle::{Next, Phase, StandbyState};
use crate::monitor::Monitor;
use crate::observers::{channel_list, link_names};
use crate::partition::Partition;
use bateleur_contract::Clock;
use bateleur_contract::{ProcessRow, ProcessState, ProcessTable};
use bateleur_control::status::ProcessStatus;
use bateleur_control::{Answer, Ordered, PartitionStatus, Request, Status};
use bateleur_plan::did_you_mean;
use bateleur_system::time::now_ns;
use bateleur_time::schedule_switch::Requested;

/// Orders that are carried out in one step.
const ORDERS_A_STEP: usize = 4;

impl Monitor {
    /// Carries out what operators have ordered.
    pub(crate) fn serve_requests(&mut self, module_ns: u64) {
        while let Some((pid, channels)) = self.operator.observers.next_ended() {
            self.cleanups.add_helper(pid, channels);
        }
        for _ in 0..ORDERS_A_STEP {
            let Some(ordered) = self.operator.take() else { return };
            let answer = self.answer(&ordered, module_ns);
            self.operator.answer(&ordered, answer);
        }
    }

    fn answer(&mut self, ordered: &Ordered, module_ns: u64) -> Result<Answer, String> {
        let module = &self.operator.about.module;
        match &ordered.request {
            Request::Ports => Ok(Answer::Ports { channels: channel_list(&self.plan, module) }),
            Request::Links => Ok(Answer::Links { links: link_names(&self.plan, module) }),
            Request::Watch { ports } => {
                let module = module.clone();
                self.operator.observers.watch(&self.plan, &module, ordered, ports)
            }
            Request::Publish { .. } if self.clock == Clock::Virtual => {
                Err("on the virtual clock nothing may happen at an instant of real time: plan it, or run on the wall clock".into())
            }
            Request::Publish { port } => {
                let origin_ns = now_ns().saturating_sub(module_ns);
                let module = module.clone();
                let answer = self.operator.observers.publish(&self.plan, &module, ordered, port, origin_ns)?;
                if answer == Answer::Publishing {
                    let place = port.split_once('.').and_then(|(partition, _)| self.place_of(partition).ok());
                    self.note_order(place, &format!("messages for {port}, by the operator"), module_ns);
                }
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
        // Of whom it is about: a standby that takes over at once is the next one.
        let of_standby = u32::from(matches!(act, Act::KillStandby));
        let generation = self.partitions[place].life.generation() + of_standby;
        let text = self.carry_out_order(place, act, module_ns).map_err(|why| format!("{name} {why}"))?;
        self.note_order_of(Some(place), generation, &format!("{}, by the operator", act.name()), module_ns);
        Ok(Answer::Done { text: format!("{name} {text}") })
    }

    fn inject(&mut self, target: &str, fault: &str, module_ns: u64) -> Result<Answer, String> {
        let fault: Fault = fault.parse()?;
        let aim = fault.aim(&self.plan, target)?;
        self.provoke(fault, &aim, module_ns)?;
        if let Some(place) = aim.place().and_then(|partition| self.places[partition]) {
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
        let mut names = self.partitions.iter().map(Partition::name);
        names.clone().position(|known| known == name).ok_or_else(|| {
            format!("the module has no partition \"{name}\": {}", did_you_mean(name, &mut names))
        })
    }

    fn status(&self, module_ns: u64) -> Status {
        let (current, next) = (self.schedule_switch.current(), self.schedule_switch.next());
        let schedule = &self.plan.schedules[current];
        let totals = self.kept.totals();
        Status {
            module_ns,
            schedules: self.plan.schedules.iter().map(|schedule| schedule.name.clone()).collect(),
            schedule: schedule.name.clone(),
            next_schedule: (next != current).then(|| self.plan.schedules[next].name.clone()),
            minor_frame_ns: schedule.minor_frame_ns,
            major_frame_ns: schedule.major_frame_ns,
            lost_windows: totals.lost,
            windows: totals.windows,
            late_windows: totals.late,
            window_overruns: totals.overruns,
            alignment: self.alignment.as_ref().map(crate::align::Alignment::status),
            partitions: self.partitions.iter().map(status_of).collect(),
            ..self.operator.about.clone()
        }
    }
}

fn status_of(partition: &Partition) -> PartitionStatus {
    let mode = match partition.life.phase() {
        Phase::Starting => "starting",
        Phase::Running if partition.life.is_held() => "frozen",
        Phase::Running => "normal",
        Phase::CleaningUp(Next::Rest(_)) | Phase::Resting(_) | Phase::Ending(_) => "idle",
        _ => "restarting",
    };
    let standby = |state| match state {
        StandbyState::Ready => "ready",
        StandbyState::Starting => "starting",
        _ => "absent",
    };
    PartitionStatus {
        name: partition.name().to_owned(),
        pid: partition.active.process.as_ref().map(|process| process.pid),
        mode: mode.into(),
        generation: partition.life.generation(),
        standby: partition.life.standby().map(|state| standby(state).into()),
        processes: partition
            .active
            .sandbox
            .table
            .as_ref()
            .map(|table| processes_of(table))
            .unwrap_or_default(),
        ..partition.figures.status()
    }
}

fn processes_of(table: &ProcessTable) -> Vec<ProcessStatus> {
    let (handler, rows) = table.read();
    let status = |row: ProcessRow| ProcessStatus {
        state: ProcessState::from_number(row.state).map_or("unknown", ProcessState::name).into(),
        name: row.name,
        priority: row.priority,
        base_priority: row.base_priority,
        period_ns: known(row.period_ns),
        capacity_ns: known(row.capacity_ns),
        deadline_ns: known(row.deadline_ns),
        run_ns: row.run_ns,
        switches: row.switches,
        starts: row.starts,
        errors: row.errors,
        stack_bytes: known(row.stack.into()),
        stack_used_bytes: known(row.stack_used.into()),
    };
    rows.into_iter().chain(handler).map(status).collect()
}

/// In a table, nothing is 0.
fn known(value: u64) -> Option<u64> {
    (value != 0).then_some(value)
}
