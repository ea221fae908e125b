//! Schedules with the minor frames of their windows.

use std::collections::BTreeMap;

use crate::catalogue;
use crate::closed::ChangeAction;
use crate::findings::Finding;
use crate::model::{Module, ModuleId, PartitionId, Schedule, Window};
use crate::raw::{RawSchedule, RawWindow};
use crate::reader::At;
use bateleur_plan::bounds::{MOST_MINOR_FRAMES, MOST_WINDOWS};

use super::health::starts_cold;
use super::{Resolver, each_once};

/// How many minor frames make the major frame; `None` where a rule objects.
pub(crate) fn minor_frames(major_ns: u64, minor_ns: u64) -> Option<u64> {
    let whole = minor_ns > 0 && major_ns > 0 && major_ns.is_multiple_of(minor_ns);
    whole.then(|| major_ns / minor_ns).filter(|frames| *frames <= MOST_MINOR_FRAMES)
}

/// A window, and where it is if that is known.
struct Placed {
    window: Window,
    core: Option<(ModuleId, u32)>,
}

impl Resolver<'_> {
    pub(super) fn schedules(&self, modules: &[Module]) -> Vec<Schedule> {
        self.file.schedules.iter().map(|raw| self.schedule(raw, modules)).collect()
    }

    fn schedule(&self, raw: &RawSchedule, modules: &[Module]) -> Schedule {
        let (major_ns, minor_ns) = (raw.major_frame.ns(0), raw.minor_frame.ns(0));
        let mut windows: Vec<Placed> =
            raw.windows.iter().map(|raw| self.window(raw, minor_ns, modules)).collect();
        if let Some(frames) = minor_frames(major_ns, minor_ns)
            && !self.too_many(raw, &windows, frames)
        {
            for (placed, raw) in windows.iter_mut().zip(&raw.windows) {
                if placed.core.is_some() && placed.window.duration_ns > 0 {
                    placed.window.minor = indices(raw, frames);
                }
            }
        }
        Schedule {
            name: raw.name.value.clone(),
            major_frame_ns: major_ns,
            minor_frame_ns: minor_ns,
            // The only schedule need not say so.
            initial: raw.initial.or(self.file.schedules.len() == 1).unwrap_or_default(),
            windows: windows.into_iter().map(|placed| placed.window).collect(),
            change_actions: raw.change_actions.iter().map(|said| self.change_action(said)).collect(),
        }
    }

    /// A window in no minor frame yet.
    fn window(&self, raw: &RawWindow, minor_ns: u64, modules: &[Module]) -> Placed {
        let partition = raw.partition.said().map_or(self.nobody.partition, |name| self.names.partition(name));
        let module = self.owners.get(partition.0).copied().unwrap_or(self.nobody.module);
        // The first of the module where it says none.
        let core = modules[module.0].cores.first().and_then(|first| raw.core.or(*first));
        let offset_ns = raw.offset.ns(u64::MAX);
        // What reaches past the minor frame is reported as that, not as an overlap with the next frame.
        let end_ns = offset_ns.saturating_add(raw.duration.ns(0)).min(minor_ns);
        let duration_ns = end_ns.saturating_sub(offset_ns);
        let minor = Vec::new();
        let window = Window { partition, offset_ns, duration_ns, core: core.unwrap_or_default(), minor };
        Placed { window, core: core.map(|core| (module, core)) }
    }

    /// Reports that a core has more windows in a major frame than any may have: to lay them out could take all memory there is.
    fn too_many(&self, raw: &RawSchedule, windows: &[Placed], frames: u64) -> bool {
        let mut counts: BTreeMap<(ModuleId, u32), u64> = BTreeMap::new();
        for (placed, raw) in windows.iter().zip(&raw.windows) {
            let Some(core) = placed.core else { continue };
            *counts.entry(core).or_default() += match raw.minor.said() {
                Some(minor) => frames.min(minor.value.len() as u64),
                None => frames,
            };
        }
        // The first of equals.
        let most = counts.into_iter().rev().max_by_key(|&(_, count)| count);
        let Some(((module, core), count)) = most.filter(|(_, count)| *count > MOST_WINDOWS) else {
            return false;
        };
        let module = &self.file.modules[module.0].name.value;
        let message = format!("core {core} of `{module}` has {count} windows in a major frame");
        let mend =
            format!("shorten the major frame, or let windows recur less often: {MOST_WINDOWS} is the most");
        let finding = Finding::new(&catalogue::TOO_MANY_WINDOWS, &raw.name.span, message, mend);
        self.findings.add(match raw.major_frame.said() {
            Some(major) => finding.also(&major.span, "the major frame"),
            None => finding,
        });
        true
    }

    fn change_action(&self, (name, action): &(At<String>, At<ChangeAction>)) -> (PartitionId, ChangeAction) {
        let partition = self.names.partition(name);
        let cold = self.file.partitions.get(partition.0).is_none_or(starts_cold);
        // A restart is as warm as the partition can be.
        let action = match action.value {
            ChangeAction::WarmRestart if cold => ChangeAction::ColdRestart,
            action => action,
        };
        (partition, action)
    }
}

/// The minor frames that have a window, each once, without those that do not exist.
fn indices(window: &RawWindow, frames: u64) -> Vec<u32> {
    let all = || (0..u32::try_from(frames).unwrap_or(u32::MAX)).collect();
    let said = || window.minor.items().iter().map(|index| index.value);
    match window.minor.is_absent() {
        true => all(),
        false => each_once(said().filter(|index| u64::from(*index) < frames)),
    }
}
