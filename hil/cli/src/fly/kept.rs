//! What was flown, kept in the flight's folder, in `inputs/`: the schedule file, and mission and airframe where they were files. A flight
//! can be replayed and flown again when the files have long been changed.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use super::Arguments;

/// The folder of the copies, in the flight's.
const FOLDER: &str = "inputs";
/// Names of the copies.
const SCHEDULE: &str = "schedule.toml";
const MISSION: &str = "mission.toml";
const AIRFRAME: &str = "airframe.toml";

/// The texts of the files that a flight is made of, as they were when it began: somebody may edit them meanwhile.
pub(super) struct Inputs(Vec<(&'static str, Vec<u8>)>);

impl Inputs {
    /// Reads them.
    pub(super) fn read(arguments: &Arguments) -> Result<Self> {
        let airframe = arguments.airframe.as_ref().map(PathBuf::from).filter(|path| path.is_file());
        let files = [
            (SCHEDULE, Some(arguments.schedule.clone())),
            (MISSION, arguments.mission.clone()),
            (AIRFRAME, airframe),
        ];
        let given = files.into_iter().filter_map(|(name, path)| Some((name, path?)));
        let read = |(name, path): (&'static str, PathBuf)| {
            let text = std::fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?;
            Ok((name, text))
        };
        given.map(read).collect::<Result<_>>().map(Self)
    }

    /// Writes them into the flight's folder.
    pub(super) fn keep(&self, folder: &Path) -> Result<()> {
        let folder = folder.join(FOLDER);
        let kept = bateleur_system::folders::make(&folder).and_then(|()| {
            self.0.iter().try_for_each(|(name, text)| std::fs::write(folder.join(name), text))
        });
        kept.with_context(|| format!("cannot keep what was flown in {}", folder.display()))
    }
}

/// The arguments of a flight with the files as they were flown, where they are others by now or gone; and a sentence for each of
/// those.
pub(crate) fn as_flown(folder: &Path, mut arguments: Arguments) -> (Arguments, Vec<String>) {
    let mut changed = Vec::new();
    let mut take = |path: &mut PathBuf, name: &str| {
        let copy = folder.join(FOLDER).join(name);
        let Ok(flown) = std::fs::read(&copy) else { return };
        let why = match std::fs::read(&*path) {
            Ok(now) if now == flown => return,
            Ok(_) => "is not as it was flown",
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => "is not here",
            Err(_) => "can not be read",
        };
        changed.push(format!("{} {why}: taking the copy in the flight's folder", path.display()));
        *path = copy;
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
