//! What partitions report, told as an executive tells it: the same entries, at the same instants, to the same partitions.

use std::io;
use std::path::Path;

use bateleur_apex::Hosted;
use bateleur_monitor::event::Event;
use bateleur_monitor::health::decision::{Decision, Situation, decide, reported_error};
use bateleur_monitor::health::log::{Fault, HealthLog};
use bateleur_monitor::health::record::Level;
use bateleur_monitor::lines::Patience;
use bateleur_monitor::repeats::{Allowance, Repeats, Untold};
use bateleur_plan::{Closed, PartitionError, PartitionId, PartitionState, Plan};
use bateleur_time::run_page::Heartbeat;

/// What is remembered of one partition.
#[derive(Debug, Default)]
struct Series {
    repeats: Repeats,
    messages: Allowance,
}

/// The health log of a flight in one process.
#[derive(Debug)]
pub(crate) struct Health {
    log: HealthLog,
    series: Vec<Series>,
    pub(crate) events: Vec<Event>,
}

/// An error after which a plan wants more than to go on.
#[derive(Debug)]
pub(crate) struct NotShown(pub(crate) String);

impl Health {
    pub(crate) fn begin(folder: &Path, plan: &Plan, partitions: usize) -> io::Result<Self> {
        let log = HealthLog::create(folder, plan.health.log, Patience::Wait, Heartbeat::of_health_log(None))?;
        let series = (0..partitions).map(|_| Series::default()).collect();
        Ok(Self { log, series, events: Vec::new() })
    }

    /// The step of a monitor, at the start of a minor frame.
    pub(crate) fn step(
        &mut self,
        plan: &Plan,
        partitions: &mut [(PartitionId, Hosted)],
        module_ns: u64,
    ) -> Result<(), NotShown> {
        for (place, (id, hosted)) in partitions.iter_mut().enumerate() {
            let name = &plan[*id].name;
            self.tell_repeats(place, name, module_ns, false);
            for report in hosted.reports() {
                match reported_error(report.kind) {
                    None => self.message(place, name, &report.text, module_ns),
                    Some(error) => self.error(plan, (place, *id), error, report.text, module_ns)?,
                }
            }
        }
        let notices = self.log.take_notices();
        if !notices.is_empty() {
            for (_, hosted) in partitions.iter().filter(|(id, _)| plan[*id].health_texts) {
                notices.iter().for_each(|notice| hosted.page().notify(notice.severity, &notice.text));
            }
        }
        Ok(())
    }

    fn message(&mut self, place: usize, name: &str, text: &str, module_ns: u64) {
        if let Some(text) = self.series[place].messages.record(text, module_ns) {
            self.log.note_message(name, 0, text.clone(), module_ns);
            self.events.push(Event::Message { time_s: seconds(module_ns), partition: name.to_owned(), text });
        }
    }

    fn error(
        &mut self,
        plan: &Plan,
        (place, id): (usize, PartitionId),
        error: PartitionError,
        detail: String,
        module_ns: u64,
    ) -> Result<(), NotShown> {
        let (partition, state) = (&plan[id], PartitionState::Normal);
        let situation = Situation { state, alive: true, handler: partition.error_handler, recent: 0 };
        let decision = decide(error, &plan.health.levels, &partition.health, &partition.restart, &situation);
        if decision != Decision::Ignore {
            let (name, error, action) = (&partition.name, error.name(), decision.name());
            return Err(NotShown(format!("{name}: {error} -> {action} ({detail})")));
        }
        if self.series[place].repeats.is_told(error, decision, &detail, module_ns) {
            self.tell(&partition.name, error, decision, detail, module_ns);
        }
        Ok(())
    }

    fn tell_repeats(&mut self, place: usize, name: &str, module_ns: u64, all: bool) {
        while let Some(Untold { error, decision, detail }) =
            self.series[place].repeats.take_untold(module_ns, all)
        {
            self.tell(name, error, decision, detail, module_ns);
        }
    }

    fn tell(
        &mut self,
        name: &str,
        error: PartitionError,
        decision: Decision,
        detail: String,
        module_ns: u64,
    ) {
        let fault = Fault {
            time_ns: module_ns,
            level: Level::Partition,
            partition: Some(name.to_owned()),
            generation: 0,
            error: error.name().into(),
            action: decision.name().into(),
            detail,
            recovered_ns: None,
        };
        self.log.note(&fault);
        self.log.write(&fault);
        self.events.push(Event::Fault {
            time_s: seconds(module_ns),
            partition: name.to_owned(),
            error: fault.error,
            action: fault.action,
            detail: fault.detail,
        });
    }

    /// Tells what was not told yet, and ends the log.
    pub(crate) fn finish(&mut self, plan: &Plan, partitions: &[(PartitionId, Hosted)], module_ns: u64) {
        for (place, (id, _)) in partitions.iter().enumerate() {
            self.tell_repeats(place, &plan[*id].name, module_ns, true);
        }
        self.log.finish();
    }
}

pub(crate) fn seconds(module_ns: u64) -> f64 {
    module_ns as f64 / 1e9
}
