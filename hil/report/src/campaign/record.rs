//! What a campaign leaves on the disk: its plan, and a line for each flight.
//!
//! A line is written at once and whole; one that a crash or a full disk cut off is recognised by its missing end, and is taken
//! away before the next one is written.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Name of the results in a campaign's folder.
pub const RESULTS: &str = "flights.jsonl";
/// Name of the plan in a campaign's folder.
const PLAN: &str = "campaign.json";

/// What is flown: two campaigns with the same plan fly the same flights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Flights in all, those of other shards included.
    pub flights: u64,
    /// Seed of the first flight; the next one has the next.
    pub seed: u64,
    /// This part of it, and how many parts there are: flights whose number, divided by the second, leaves the first.
    pub shard: (u64, u64),
    /// What conditions are drawn from: a sentence for each.
    pub space: BTreeMap<String, String>,
    /// Options that every flight has.
    pub common: Vec<String>,
    /// Digest of the schedule file.
    pub schedule: String,
    /// Digest of the programs of a flight.
    pub programs: String,
    /// The programs' version.
    pub version: String,
}

impl Plan {
    /// Numbers of the flights of this part.
    pub fn numbers(&self) -> impl Iterator<Item = u64> + use<> {
        let (part, parts) = self.shard;
        (part..self.flights).step_by(usize::try_from(parts.max(1)).unwrap_or(usize::MAX))
    }

    /// Whether a flight belongs to this part.
    pub fn has(&self, number: u64) -> bool {
        let (part, parts) = self.shard;
        number < self.flights && number % parts.max(1) == part
    }

    /// Why the flights of two plans do not belong together; nothing where they do. Flights and shards may differ.
    pub fn disagreement(&self, other: &Self) -> Option<String> {
        let said = |what: &str, a: &dyn std::fmt::Debug, b: &dyn std::fmt::Debug| {
            Some(format!("{what}: {a:?} and {b:?}"))
        };
        if self.seed != other.seed {
            return said("seed", &self.seed, &other.seed);
        }
        let names = self.space.keys().chain(other.space.keys());
        for name in names {
            let (a, b) = (self.space.get(name), other.space.get(name));
            if a != b {
                return said(name, &a.map_or("", |text| text), &b.map_or("", |text| text));
            }
        }
        if self.common != other.common {
            return said("options", &self.common.join(" "), &other.common.join(" "));
        }
        if self.schedule != other.schedule {
            return Some("the schedule files are not the same".into());
        }
        (self.version != other.version).then(|| format!("version: {} and {}", self.version, other.version))
    }
}

/// One flight.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Flown {
    /// Its number in the campaign, from 0 on.
    pub number: u64,
    /// Its seed.
    pub seed: u64,
    /// What to type to fly it again.
    pub command: String,
    /// The conditions that were drawn, for a person and for plots.
    pub conditions: BTreeMap<String, f64>,
    /// The mission was completed.
    pub completed: bool,
    /// Why not.
    pub failure: Option<String>,
    /// The figures that its summary has.
    pub figures: BTreeMap<String, f64>,
    /// Digest of all actuator words.
    pub digest: Option<String>,
    /// Module time, s.
    pub module_time_s: Option<f64>,
    /// Real time, s.
    pub wall_time_s: f64,
    /// Its logs, where they were kept.
    pub folder: Option<PathBuf>,
    /// What flew it, in a campaign that does not fly partitions alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub engine: Option<String>,
    /// It was flown a second time, as partitions, and compared.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub compared: bool,
}

/// Why a campaign's folder can not be used.
#[derive(Debug, Error)]
pub enum CampaignError {
    /// The file system refused.
    #[error("{}: {why}", path.display())]
    File {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        why: std::io::Error,
    },
    /// The plan is damaged.
    #[error("{}: {why}", path.display())]
    Plan {
        /// Which file.
        path: PathBuf,
        /// What is wrong.
        why: serde_json::Error,
    },
    /// Folders of campaigns that fly different flights.
    #[error("{} and {} are not parts of one campaign: {why}", a.display(), b.display())]
    Mixed {
        /// The first.
        a: PathBuf,
        /// The other.
        b: PathBuf,
        /// What differs.
        why: String,
    },
}

fn file(path: &Path) -> impl Fn(std::io::Error) -> CampaignError + '_ {
    move |why| CampaignError::File { path: path.to_path_buf(), why }
}

impl Plan {
    /// A digest of files, in their order.
    pub fn digest_of(paths: &[impl AsRef<Path>]) -> Result<String, CampaignError> {
        let mut hasher = blake3::Hasher::new();
        for path in paths {
            let path = path.as_ref();
            let mut opened = File::open(path).map_err(file(path))?;
            std::io::copy(&mut opened, &mut hasher).map_err(file(path))?;
        }
        Ok(hasher.finalize().to_hex().to_string())
    }

    /// A name that only campaigns with the same flights have: the number of flights and the shard do not count.
    pub fn name(&self) -> String {
        let same = Self { flights: 0, shard: (0, 1), ..self.clone() };
        let text = serde_json::to_vec(&same).unwrap_or_default(); // plain data: it can not fail
        format!("seed{}-{}", self.seed, &blake3::hash(&text).to_hex()[..8])
    }

    /// Why the flights of two plans may not come out the same; nothing where they must.
    pub fn other_programs(&self, other: &Self) -> Option<String> {
        (self.programs != other.programs).then(|| "the programs have changed since".into())
    }

    /// Why two plans are not the same part; nothing where they are.
    pub fn other_shard(&self, other: &Self) -> Option<String> {
        let (a, b) = (self.shard, other.shard);
        (a != b).then(|| format!("it is shard {}/{}, not {}/{}", a.0, a.1, b.0, b.1))
    }

    /// Writes it into a campaign's folder: all of it, or the older one stays.
    pub fn write(&self, folder: &Path) -> Result<(), CampaignError> {
        let (path, draft) = (folder.join(PLAN), folder.join("campaign.json.new"));
        let text =
            serde_json::to_vec_pretty(self).map_err(|why| CampaignError::Plan { path: path.clone(), why })?;
        std::fs::write(&draft, text).map_err(file(&draft))?;
        std::fs::rename(&draft, &path).map_err(file(&path))
    }
}

/// The plan in a campaign's folder; nothing where there is none.
pub fn read_plan(folder: &Path) -> Result<Option<Plan>, CampaignError> {
    let path = folder.join(PLAN);
    let bytes = match std::fs::read(&path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(why) => return Err(CampaignError::File { path, why }),
    };
    serde_json::from_slice(&bytes).map(Some).map_err(|why| CampaignError::Plan { path, why })
}

/// Flights that were read, by number, and what was not readable.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Lines {
    /// The flights; where a number occurs twice, its last line.
    pub flights: BTreeMap<u64, Flown>,
    /// Lines that are no flights.
    pub damaged: u64,
    /// Numbers that occur twice with another outcome.
    pub contradictions: Vec<u64>,
    /// What else a reader should know.
    pub notes: Vec<String>,
}

impl Lines {
    /// Adds a flight.
    pub fn add(&mut self, flight: Flown) {
        let number = flight.number;
        let other = self.flights.insert(number, flight);
        let same = |other: &Flown, flight: &Flown| {
            (other.completed, &other.digest, &other.command)
                == (flight.completed, &flight.digest, &flight.command)
        };
        if other.is_some_and(|other| !same(&other, &self.flights[&number])) {
            self.contradictions.push(number);
        }
    }
}

/// The results in a campaign's folder; nothing if it has none yet. A last line without its end does not count.
pub fn read(folder: &Path) -> Result<Lines, CampaignError> {
    let path = folder.join(RESULTS);
    let mut lines = Lines::default();
    let opened = match File::open(&path) {
        Ok(opened) => opened,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(lines),
        Err(why) => return Err(CampaignError::File { path, why }),
    };
    let mut reader = BufReader::new(opened);
    let mut line = Vec::new();
    while reader.read_until(b'\n', &mut line).map_err(file(&path))? > 0 {
        match (line.ends_with(b"\n"), serde_json::from_slice(&line)) {
            (true, Ok(flight)) => lines.add(flight),
            _ => lines.damaged += 1,
        }
        line.clear();
    }
    Ok(lines)
}

/// Takes away a last line that has no end. Gives the number of bytes that were taken.
pub fn repair(folder: &Path) -> Result<u64, CampaignError> {
    let path = folder.join(RESULTS);
    let mut opened = match OpenOptions::new().read(true).write(true).open(&path) {
        Ok(opened) => opened,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(0),
        Err(why) => return Err(CampaignError::File { path, why }),
    };
    let whole = whole_bytes(&mut opened).map_err(file(&path))?;
    let length = opened.metadata().map_err(file(&path))?.len();
    if whole < length {
        opened.set_len(whole).map_err(file(&path))?;
    }
    Ok(length - whole)
}

/// Bytes up to the end of the last whole line, looked for from the end.
fn whole_bytes(opened: &mut File) -> std::io::Result<u64> {
    const PIECE: u64 = 4096;
    let mut end = opened.metadata()?.len();
    while end > 0 {
        let start = end.saturating_sub(PIECE);
        let mut piece = vec![0; (end - start) as usize];
        opened.seek(SeekFrom::Start(start))?;
        opened.read_exact(&mut piece)?;
        if let Some(place) = piece.iter().rposition(|byte| *byte == b'\n') {
            return Ok(start + place as u64 + 1);
        }
        end = start;
    }
    Ok(0)
}

/// Appends a flight, in one piece, and waits until the disk has it: a campaign that is stopped loses no flight that it has told of.
pub fn append(results: &mut File, flight: &Flown) -> std::io::Result<()> {
    let mut line = serde_json::to_vec(flight)?;
    line.push(b'\n');
    results.write_all(&line)?;
    results.sync_data()
}

/// Joins the results of several folders: shards of one campaign.
pub fn join(folders: &[PathBuf]) -> Result<(Plan, Lines), CampaignError> {
    let mut joined: Option<(PathBuf, Plan)> = None;
    let mut all = Lines::default();
    for folder in folders {
        let plan = read_plan(folder)?.ok_or_else(|| {
            let why =
                std::io::Error::new(std::io::ErrorKind::NotFound, "there is no campaign in this folder");
            CampaignError::File { path: folder.join(PLAN), why }
        })?;
        match &mut joined {
            None => joined = Some((folder.clone(), Plan { shard: (0, 1), ..plan })),
            Some((first, common)) => {
                if let Some(why) = common.disagreement(&plan) {
                    return Err(CampaignError::Mixed { a: first.clone(), b: folder.clone(), why });
                }
                if let Some(note) = common.other_programs(&plan) {
                    all.notes.push(format!("{}: {note} {} was flown", folder.display(), first.display()));
                }
                common.flights = common.flights.max(plan.flights);
            }
        }
        let lines = read(folder)?;
        all.damaged += lines.damaged;
        all.contradictions.extend(lines.contradictions);
        lines.flights.into_values().for_each(|flight| all.add(flight));
    }
    let nothing = || {
        let why = std::io::Error::new(std::io::ErrorKind::InvalidInput, "no folder was named");
        CampaignError::File { path: PathBuf::new(), why }
    };
    let (_, plan) = joined.ok_or_else(nothing)?;
    Ok((plan, all))
}
