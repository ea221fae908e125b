//! What was flown, kept in the flight's folder: the schedule file, and mission and airframe where they were files. A flight can be
//! replayed and flown again when the files have long been changed.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use super::Arguments;

/// Name of the schedule file's copy.
pub(crate) const SCHEDULE: &str = "schedule.toml";
/// That of the mission's.
const MISSION: &str = "mission.toml";
/// That of the airframe's.
const AIRFRAME: &str = "airframe.toml";

/// Copies the files that a flight was made of.
pub(super) fn keep(folder: &Path, arguments: &Arguments) -> Result<()> {
    let airframe = arguments.airframe.as_ref().map(PathBuf::from).filter(|path| path.is_file());
    let files = [
        (Some(arguments.schedule.clone()), SCHEDULE),
        (arguments.mission.clone(), MISSION),
        (airframe, AIRFRAME),
    ];
    for (from, name) in files.into_iter().filter_map(|(from, name)| Some((from?, name))) {
        std::fs::copy(&from, folder.join(name))
            .with_context(|| format!("cannot keep a copy of {} in {}", from.display(), folder.display()))?;
    }
    Ok(())
}

/// The arguments of a flight with the files as they were flown, where they are others by now or gone; and which those are.
pub(crate) fn as_flown(folder: &Path, mut arguments: Arguments) -> (Arguments, Vec<PathBuf>) {
    let mut changed = Vec::new();
    let mut take = |path: &mut PathBuf, name: &str| {
        let copy = folder.join(name);
        let Ok(flown) = std::fs::read(&copy) else { return };
        if std::fs::read(&*path).is_ok_and(|now| now == flown) {
            return;
        }
        changed.push(std::mem::replace(path, copy));
    };
    take(&mut arguments.schedule, SCHEDULE);
    if let Some(mission) = &mut arguments.mission {
        take(mission, MISSION);
    }
    if let Some(airframe) = &mut arguments.airframe {
        let mut path = PathBuf::from(&*airframe);
        take(&mut path, AIRFRAME);
        *airframe = path.display().to_string();
    }
    (arguments, changed)
}
