//! The file of needs: what each partition asks for.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, bail};
use bateleur_checker::planner::{Need, Request};
use bateleur_plan::units::{TIME_UNITS, duration_ns};
use serde::{Deserialize, Deserializer};

use super::from_run::Run;
use super::module::{Module, Partition};
use crate::words::nearest;

/// The whole file.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Needs {
    /// What the schedule is to be called.
    pub(super) name: Option<String>,
    minor_frame: Option<Time>,
    major_frame: Option<Time>,
    gap: Option<Time>,
    need: BTreeMap<String, Asked>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Asked {
    period: Time,
    duration: Time,
    core: Option<u32>,
    offset: Option<Time>,
}

/// A time as the schedule file writes it.
#[derive(Debug, Clone, Copy)]
struct Time(u64);

impl<'de> Deserialize<'de> for Time {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        duration_ns(&text).map(Self).map_err(|error| {
            serde::de::Error::custom(format!(
                "`{text}` is not a time: {error}; write a number and {TIME_UNITS}"
            ))
        })
    }
}

impl Needs {
    pub(super) fn read(path: &Path) -> Result<Self> {
        let text =
            std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
        toml::from_str(&text).map_err(|error: toml::de::Error| {
            let shown = error.to_string().replace(error.message(), &in_words_of_the_file(error.message()));
            anyhow::anyhow!("{}: {}", path.display(), shown.trim_end())
        })
    }

    /// What the planner is asked: every partition of the module file with its need, from here or else from a run.
    pub(super) fn wanted(&self, module: &Module, run: Option<&Run>) -> Result<Wanted> {
        if let Some(stranger) = self.need.keys().find(|name| module.partition(name).is_none()) {
            let known = module.partitions.iter().map(|partition| partition.name.as_str());
            match nearest(stranger, known) {
                Some(near) => bail!("there is no partition `{stranger}`: did you mean `{near}`?"),
                None => bail!("there is no partition `{stranger}` in the schedule file"),
            }
        }
        let gap_ns = self.gap.map_or(0, |time| time.0);
        let (mut needs, mut members, turns) = (Vec::new(), Vec::new(), module.turns());
        for turn in &turns {
            let each = turn.iter().map(|&place| self.need(module, &module.partitions[place], run));
            let each = each.collect::<Result<Vec<Need>>>()?;
            needs.push(one_after_the_other(&each, gap_ns)?);
            members.push(each);
        }
        let turn_of = |place: usize| turns.iter().position(|turn| turn.contains(&place)).unwrap_or_default();
        let mut chains = module.chains()?;
        for chain in &mut chains {
            chain.stations.iter_mut().for_each(|station| *station = turn_of(*station));
            chain.stations.dedup();
        }
        chains.dedup();
        let request = Request {
            modules: module.modules.iter().map(|module| module.name.clone()).collect(),
            needs,
            chains,
            minor_frame_ns: self.minor_frame.map(|time| time.0),
            major_frame_ns: self.major_frame.map(|time| time.0),
            gap_ns,
        };
        Ok(Wanted { request, members })
    }

    fn need(&self, module: &Module, partition: &Partition, run: Option<&Run>) -> Result<Need> {
        let (cores, name) = (module.cores(partition), partition.name.as_str());
        if let Some(asked) = self.need.get(name) {
            return asked.need(name, cores, module.modules[partition.module].name.as_str());
        }
        let measured = run.map(|run| run.need(name)).transpose()?.flatten();
        let (period_ns, duration_ns) = measured.with_context(|| {
            format!(
                "partition `{name}` has no need: add `{name} = {{ period = \"20ms\", duration = \"1ms\" }}` to `[need]`"
            )
        })?;
        Ok(Need { name: name.to_owned(), period_ns, duration_ns, cores, offset_ns: None })
    }
}

/// What the planner is asked.
pub(super) struct Wanted {
    pub(super) request: Request,
    /// Of each need of the request, the partitions that have their windows in it, one after the other with the gap between them.
    pub(super) members: Vec<Vec<Need>>,
}

/// The need of partitions that take their turns one right after the other.
fn one_after_the_other(each: &[Need], gap_ns: u64) -> Result<Need> {
    let [first, others @ ..] = each else { bail!("nobody needs a window") };
    let mut need = first.clone();
    for other in others {
        let (one, other_name) = (&first.name, &other.name);
        if other.period_ns != first.period_ns || other.cores != first.cores {
            bail!(
                "`{one}` and `{other_name}` are replicas of one module: give them the same period and core"
            );
        }
        if other.offset_ns.is_some() {
            bail!("`{other_name}` runs right behind `{one}`: ask for the offset of `{one}` alone");
        }
        need.name = format!("{}`, `{other_name}", need.name);
        need.duration_ns = need.duration_ns.saturating_add(gap_ns).saturating_add(other.duration_ns);
    }
    Ok(need)
}

/// The keys that the file may have.
const KEYS: [&str; 9] =
    ["name", "minor_frame", "major_frame", "gap", "need", "period", "duration", "core", "offset"];
/// A need as it may stand there.
const EXAMPLE: &str = "{ period = \"20ms\", duration = \"1ms\" }";

/// The library's "invalid type: integer `5`, expected a string" as a person who writes the file would say it; words of another shape
/// stay as they are.
fn in_words_of_the_file(message: &str) -> String {
    let quoted = || message.split('`').nth(1).unwrap_or_default();
    if let Some(rest) = message.strip_prefix("invalid type: ")
        && let Some((found, expected)) = rest.rsplit_once(", expected ")
    {
        let found = found.replace('`', "");
        return match expected {
            "a string" => format!("{found} is no time: write a text such as \"20ms\""),
            "u32" => format!("{found} is no core: write its number, such as 1"),
            "a map" => {
                format!("`[need]` has a line for each partition, such as imu = {EXAMPLE}; found {found}")
            }
            _ => format!("a need is a table such as {EXAMPLE}; found {found}"),
        };
    }
    if message.starts_with("invalid value: ") {
        return "a core is a whole number from 0 on".into();
    }
    if message.starts_with("missing field `need`") {
        return format!("the file has no `[need]`: give it one, with a line such as imu = {EXAMPLE}");
    }
    if message.starts_with("missing field ") {
        return format!("the need has no `{}`: write it as {EXAMPLE}", quoted());
    }
    if message.starts_with("unknown field ") {
        let known = message.split('`').skip(3).step_by(2).collect::<Vec<_>>();
        let known = if known.is_empty() { KEYS.to_vec() } else { known };
        return match nearest(quoted(), known.iter().copied()) {
            Some(near) => format!("there is no key `{}`: did you mean `{near}`?", quoted()),
            None => format!("there is no key `{}`: there are {}", quoted(), known.join(", ")),
        };
    }
    message.to_owned()
}

impl Asked {
    fn need(&self, name: &str, cores: Vec<(usize, u32)>, module: &str) -> Result<Need> {
        for (what, time) in [("period", self.period), ("duration", self.duration)] {
            if time.0 == 0 {
                bail!("the {what} of `{name}` is zero");
            }
        }
        let cores = match self.core {
            None => cores,
            Some(core) => match cores.iter().find(|known| known.1 == core) {
                Some(&known) => vec![known],
                None => bail!("`{name}` asks for core {core}, which module `{module}` does not have"),
            },
        };
        Ok(Need {
            name: name.to_owned(),
            period_ns: self.period.0,
            duration_ns: self.duration.0,
            cores,
            offset_ns: self.offset.map(|time| time.0),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(text: &str) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("needs.toml");
        std::fs::write(&path, text).unwrap();
        Needs::read(&path).unwrap_err().to_string()
    }

    #[test]
    fn mistakes_are_told_in_the_words_of_the_file_and_at_their_place() {
        for (text, expected) in [
            (
                "[need]\nimu = { period = 20, duration = \"1ms\" }\n",
                "integer 20 is no time: write a text such as \"20ms\"",
            ),
            ("[need]\nimu = { period = \"20ms\", duration = \"1ms\", core = \"one\" }\n", "is no core"),
            ("[need]\nimu = { period = \"20ms\" }\n", "the need has no `duration`: write it as { period"),
            ("[need]\nimu = 5\n", "a need is a table such as { period"),
            ("gap = \"1ms\"\n", "the file has no `[need]`"),
            (
                "[need]\nimu = { perod = \"20ms\", duration = \"1ms\" }\n",
                "there is no key `perod`: did you mean `period`?",
            ),
            ("[need]\nimu = { period = \"20 parsecs\", duration = \"1ms\" }\n", "`20 parsecs` is not a time"),
        ] {
            let said = refused(text);
            assert!(said.contains(expected), "{text}: {said}");
            for rust in ["struct", "u32", "expected a string", "field"] {
                assert!(!said.contains(rust), "{text}: {said}");
            }
        }
    }
}
