//! The monitor's part in the alignment of major frames: it brings what a relay has told, or what the machine's disciplined clock
//! says, to the [`Aligner`], tells what has changed, and writes `alignment.csv`.

use std::path::Path;
use std::sync::Arc;

use crate::lines::{LineLog, Patience};
use bateleur_control::status::AlignmentStatus;
use bateleur_plan::Timeline;
use bateleur_time::alignment::{Aligner, Change, Following, Measured, Realtime, Reference, State};
use bateleur_time::partition_control::PartitionControl;
use bateleur_time::schedule_switch::ScheduleSwitch;

/// Name of the log in a run's folder.
const FILE: &str = "alignment.csv";
/// Its heading.
const HEADING: &str =
    "frame,time_ns,state,measured_ns,uncertainty_ns,phase_ns,deviation_ns,drift_ppb,shift_ns\n";

/// What a module that follows works with.
pub struct Alignment {
    aligner: Aligner,
    /// The relay's place in the plan, where another module is followed.
    relay: Option<usize>,
    /// When module time 0 was, CLOCK_MONOTONIC, ns.
    origin_ns: u64,
    /// The last of the relay's reports.
    seen: u32,
    /// The frame of which the disciplined clock was asked last.
    asked: Option<u64>,
    /// The frame that the log ends with.
    logged: Option<u64>,
    log: Option<LineLog>,
}

impl Alignment {
    /// `relay`: its place in the plan. `resets`: of the module so far; each start has a log of its own. A log that can not be made
    /// keeps nobody from flying.
    #[must_use]
    pub fn new(
        following: Following,
        timelines: &[Timeline],
        relay: Option<usize>,
        origin_ns: u64,
        folder: &Path,
        resets: u32,
    ) -> Self {
        let name = if resets == 0 { FILE.to_owned() } else { format!("alignment.reset-{resets}.csv") };
        let mut log = LineLog::create(&folder.join(name), 0, Patience::Lose).ok();
        if let Some(log) = &mut log {
            log.push(HEADING.as_bytes());
        }
        Self {
            aligner: Aligner::new(following, timelines),
            relay,
            origin_ns,
            seen: 0,
            asked: None,
            logged: None,
            log,
        }
    }

    /// What the disciplined clock says of the newest frame, asked once for each.
    fn ask(&mut self, frame: u64, frame_ns: u64) -> Option<Measured> {
        if self.asked.replace(frame) == Some(frame) {
            return None;
        }
        match Realtime.sample() {
            Ok(sample) => {
                self.aligner.silent(None);
                self.aligner.read(frame, self.origin_ns + frame_ns, &sample)
            }
            Err(why) => {
                self.aligner.silent(Some(why));
                None
            }
        }
    }

    fn write(&mut self, frame: u64, module_ns: u64) {
        if self.logged.replace(frame) == Some(frame) {
            return;
        }
        let Some(log) = &mut self.log else { return };
        let (law, figures) = (self.aligner.law(), self.aligner.figures());
        let number = |number: Option<f64>| number.map_or_else(String::new, |number| format!("{number:.0}"));
        let line = format!(
            "{frame},{module_ns},{},{},{:.0},{},{:.0},{:.0},{}\n",
            self.aligner.state().name(),
            number(figures.measured_ns),
            figures.uncertainty_ns,
            number(law.phase_ns()),
            law.deviation_ns(),
            law.drift_ppb(),
            figures.shift_ns
        );
        log.push(line.as_bytes()); // a full disk: the frames are aligned all the same
    }

    /// How it is now.
    pub(crate) fn status(&self) -> AlignmentStatus {
        let (law, figures) = (self.aligner.law(), self.aligner.figures());
        AlignmentStatus {
            follows: self.aligner.following().reference.name().to_owned(),
            state: self.aligner.state().name().to_owned(),
            error_ns: law.phase_ns().map(|phase| phase.round() as i64),
            deviation_ns: law.deviation_ns().round() as u64,
            uncertainty_ns: figures.uncertainty_ns.round() as u64,
            drift_ppb: law.drift_ppb().round() as i64,
            correction_ns: figures.shift_ns,
            measurements: figures.measurements,
            refused: figures.refused,
            lost: figures.lost,
        }
    }

    /// Looks at what was measured, and decides about the next frame's end. `page_of`: the active control of the partition
    /// at a place of the plan.
    pub(crate) fn step(
        &mut self,
        schedule_switch: &ScheduleSwitch,
        page_of: impl Fn(usize) -> Option<Arc<PartitionControl>>,
        module_ns: u64,
    ) -> Option<Found> {
        let (frame, frame_ns) = (schedule_switch.newest_frame(), schedule_switch.newest_frame_ns());
        let measured = match self.aligner.following().reference {
            Reference::Module(_) => self.relay.and_then(page_of).and_then(|control| {
                let told = control.page.alignment_since(&mut self.seen)?;
                self.aligner.heard(&told, frame)
            }),
            Reference::Realtime => self.ask(frame, frame_ns),
        };
        let before = self.aligner.state();
        let change = self.aligner.step(schedule_switch, module_ns, measured);
        self.write(frame, module_ns);
        match change? {
            Change::Lost(why) => Some(Found::Lost(why)),
            Change::Locked => Some(Found::Locked(self.locked(before))),
        }
    }

    fn locked(&self, before: State) -> String {
        let status = self.status();
        let again = if before == State::Lost { " again" } else { "" };
        format!(
            "major frames follow {}{again}: {:.1} us beside, drift {:.2} ppm",
            status.follows,
            status.error_ns.unwrap_or_default() as f64 / 1e3,
            status.drift_ppb as f64 / 1e3
        )
    }
}

/// What has changed, in words.
pub(crate) enum Found {
    /// Whoever is followed was lost.
    Lost(String),
    /// It is followed.
    Locked(String),
}
