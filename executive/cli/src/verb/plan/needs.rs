//! The file of needs: what each partition asks for.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, bail};
use bateleur_executive::plan::planner::{Need, Request};
use bateleur_executive::plan::units::{TIME_UNITS, duration_ns};
use serde::{Deserialize, Deserializer};

use super::module::Module;
use crate::words::nearest;

/// The whole file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Needs {
    /// What the schedule is to be called.
    pub(super) name: Option<String>,
    minor_frame: Option<Time>,
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
        toml::from_str(&text)
            .map_err(|error| anyhow::anyhow!("{}: {}", path.display(), error.to_string().trim_end()))
    }

    /// What the planner is asked: every partition of the module file with its need.
    pub(super) fn request(&self, module: &Module) -> Result<Request> {
        if let Some(stranger) = self.need.keys().find(|name| module.partition(name).is_none()) {
            let known = module.partitions.iter().map(|partition| partition.name.as_str());
            match nearest(stranger, known) {
                Some(near) => bail!("there is no partition `{stranger}`: did you mean `{near}`?"),
                None => bail!("there is no partition `{stranger}` in the schedule file"),
            }
        }
        let needs = module.partitions.iter().map(|partition| {
            let asked = self.need.get(&partition.name).with_context(|| {
                format!(
                    "partition `{0}` has no need: add `{0} = {{ period = \"20ms\", duration = \"1ms\" }}` to `[need]`",
                    partition.name
                )
            })?;
            asked.need(&partition.name, module.cores(partition), module.modules[partition.module].name.as_str())
        });
        Ok(Request {
            modules: module.modules.iter().map(|module| module.name.clone()).collect(),
            needs: needs.collect::<Result<_>>()?,
            chains: module.chains()?,
            minor_frame_ns: self.minor_frame.map(|time| time.0),
            gap_ns: self.gap.map_or(0, |time| time.0),
        })
    }
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
