//! A partition that asks for schedule `wants` in its window number `at`, says what it was answered, and says what it sees
//! of the module's schedules whenever that changes.

use std::process::ExitCode;

use bateleur_apex::{Context, ModuleSchedules, Partition, ScheduleStatus, StartError, Window};

struct Switcher {
    schedules: ModuleSchedules,
    wants: String,
    windows_left: u64,
    seen: Option<ScheduleStatus>,
}

impl Partition for Switcher {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        Ok(Self {
            schedules: context.module_schedules(),
            wants: context.attribute("wants", String::new())?,
            windows_left: context.attribute("at", 0_u64)?,
            seen: None,
        })
    }

    fn window(&mut self, window: &Window) {
        let status = self.schedules.get_module_schedule_status();
        if self.seen.replace(status) != Some(status) {
            let since_ms = status.time_of_last_switch_ns / 1_000_000;
            window.report(&format!("{} then {} since {since_ms}", status.current.0, status.next.0));
        }
        if self.windows_left == 0 && !self.wants.is_empty() {
            let wants = std::mem::take(&mut self.wants);
            let answer = self
                .schedules
                .get_module_schedule_id(&wants)
                .and_then(|schedule| self.schedules.set_module_schedule(schedule));
            window.report(&format!("{wants}: {answer:?}"));
        }
        self.windows_left = self.windows_left.saturating_sub(1);
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Switcher>()
}
