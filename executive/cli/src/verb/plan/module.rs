//! What the planner takes from a schedule file that may not have a schedule yet: modules with their cores, partitions with replicas and relays,
//! chains. It is read leniently here; the whole file is checked when the schedule is in it.

use std::collections::BTreeSet;
use std::path::Path;

use anyhow::{Context, Result, bail};
use bateleur_checker::planner::Bound;
use bateleur_checker::{RELAY_PREFIX, numbered};
use bateleur_contract::REPLICAS;
use bateleur_plan::units::{ShowTime, duration_ns};
use toml::{Table, Value};

/// The file.
pub(super) struct Module {
    document: Table,
    pub(super) modules: Vec<Computer>,
    pub(super) partitions: Vec<Partition>,
}

/// One computer.
pub(super) struct Computer {
    pub(super) name: String,
    cores: Vec<u32>,
}

/// One partition; a voter, a replica or a relay too.
pub(super) struct Partition {
    pub(super) name: String,
    /// The place of its module.
    pub(super) module: usize,
    /// The place of its voter; `None`: it is no replica.
    voter: Option<usize>,
}

fn tables<'a>(document: &'a Table, key: &str) -> impl Iterator<Item = (&'a String, &'a Table)> + use<'a> {
    let named = document.get(key).and_then(Value::as_table);
    named.into_iter().flatten().filter_map(|(name, value)| Some((name, value.as_table()?)))
}

fn texts(value: Option<&Value>) -> Vec<&str> {
    value.and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_str).collect()
}

impl Module {
    pub(super) fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("cannot read {} (name another file with --schedule)", path.display()))?;
        let document: Table = toml::from_str(&text)
            .map_err(|error| anyhow::anyhow!("{}: {}", path.display(), error.to_string().trim_end()))?;
        let computer = |(name, table): (&String, &Table)| {
            let cores = table.get("cores").and_then(Value::as_array).into_iter().flatten();
            let cores =
                cores.filter_map(Value::as_integer).filter_map(|core| u32::try_from(core).ok()).collect();
            Computer { name: name.clone(), cores }
        };
        let modules: Vec<Computer> = tables(&document, "module").map(computer).collect();
        let on = |name: &str, module: &str, voter| {
            let place = modules.iter().position(|known| known.name == module && !known.cores.is_empty());
            place.map(|module| Partition { name: name.to_owned(), module, voter }).with_context(|| {
                format!(
                    "{}: partition `{name}` has no module with cores: see `bateleur check`",
                    path.display()
                )
            })
        };
        let mut partitions = Vec::new();
        for (name, table) in tables(&document, "partition") {
            let module = table.get("module").and_then(Value::as_str).unwrap_or_default();
            let voter = partitions.len();
            partitions.push(on(name, module, None)?);
            let Some(said) = table.get("replicas") else { continue };
            let modules = texts(Some(said));
            for number in 0..REPLICAS {
                let module = modules.get(number).copied().unwrap_or(module);
                partitions.push(on(&numbered(name, number + 1), module, Some(voter))?);
            }
        }
        let mut file = Self { document, modules, partitions };
        for module in file.crossed() {
            let name = format!("{RELAY_PREFIX}{}", file.modules[module].name);
            file.partitions.push(Partition { name, module, voter: None });
        }
        Ok(file)
    }

    /// The modules that a channel leads to or from another one: each has a relay, which no table names.
    fn crossed(&self) -> BTreeSet<usize> {
        let mut crossed = BTreeSet::new();
        let channels = self.document.get("channel").and_then(Value::as_array).into_iter().flatten();
        for channel in channels.filter_map(Value::as_table) {
            let source = channel.get("source").and_then(Value::as_str);
            let ports = source.into_iter().chain(texts(channel.get("destinations")));
            let owners = ports.filter_map(|port| self.partition(port.split('.').next()?));
            let reached: BTreeSet<usize> = owners
                .flat_map(|owner| self.replicas(owner).chain([owner]))
                .map(|place| self.partitions[place].module)
                .collect();
            if reached.len() > 1 {
                crossed.extend(reached);
            }
        }
        crossed
    }

    pub(super) fn partition(&self, name: &str) -> Option<usize> {
        self.partitions.iter().position(|partition| partition.name == name)
    }

    /// The replicas of a partition, in their order.
    fn replicas(&self, voter: usize) -> impl Iterator<Item = usize> {
        (0..self.partitions.len()).filter(move |&place| self.partitions[place].voter == Some(voter))
    }

    /// The cores that a partition may have.
    pub(super) fn cores(&self, partition: &Partition) -> Vec<(usize, u32)> {
        self.modules[partition.module].cores.iter().map(|&core| (partition.module, core)).collect()
    }

    /// The partitions that take their turns one right after the other: the replicas on one module together, as nobody may write between them
    /// what they read, and every other partition alone.
    pub(super) fn turns(&self) -> Vec<Vec<usize>> {
        let mut turns: Vec<Vec<usize>> = Vec::new();
        for (place, partition) in self.partitions.iter().enumerate() {
            let of = |partition: &Partition| Some((partition.voter?, partition.module));
            let with = |other: usize| of(partition).is_some() && of(&self.partitions[other]) == of(partition);
            match turns.iter_mut().find(|turn| with(turn[0])) {
                Some(turn) => turn.push(place),
                None => turns.push(vec![place]),
            }
        }
        turns
    }

    /// The chains within one module, by the partitions on their way. One that leads through replicas is one through each.
    pub(super) fn chains(&self) -> Result<Vec<Bound>> {
        let chains = self.document.get("chain").and_then(Value::as_array).into_iter().flatten();
        let mut bounds = Vec::new();
        for chain in chains.filter_map(Value::as_table) {
            let name = chain.get("name").and_then(Value::as_str).unwrap_or("?");
            let age = chain.get("max_age").and_then(Value::as_str).unwrap_or_default();
            let max_age_ns = duration_ns(age).with_context(|| format!("the age of chain `{name}`"))?;
            let mut owners = Vec::new();
            for port in texts(chain.get("path")) {
                let owner = port.split('.').next().unwrap_or_default();
                let Some(owner) = self.partition(owner) else {
                    bail!("chain `{name}` names `{port}`, and there is no partition `{owner}`");
                };
                owners.push(owner);
            }
            owners.dedup();
            let module = |&station: &usize| self.partitions[station].module;
            for number in 0..REPLICAS {
                let replica_of = |owner: usize| self.replicas(owner).nth(number);
                let through = owners.iter().flat_map(|&owner| replica_of(owner).into_iter().chain([owner]));
                let stations: Vec<usize> = through.collect();
                if stations.iter().all(|station| Some(module(station)) == stations.first().map(module)) {
                    bounds.push(Bound { name: name.to_owned(), stations, max_age_ns });
                }
            }
            bounds.dedup(); // without replicas they are the same
        }
        Ok(bounds)
    }

    /// The schedule that is replaced: the initial one, or the only one; a new one where there is none.
    pub(super) fn schedule_name(&self) -> String {
        let schedules: Vec<(&String, &Table)> = tables(&self.document, "schedule").collect();
        let initial = schedules.iter().find(|(_, table)| says_initial(table));
        let name = initial.or(schedules.first()).map(|(name, _)| (*name).clone());
        name.unwrap_or_else(|| "planned".to_owned())
    }

    /// Whether the planned schedule is the one that the module starts with.
    pub(super) fn is_initial(&self, name: &str) -> bool {
        let mut others = tables(&self.document, "schedule").filter(|(other, _)| *other != name);
        !others.any(|(_, table)| says_initial(table))
    }

    /// What the length of a silence becomes where the planned schedule's minor frame is another than before: it is counted in windows.
    pub(super) fn silence_note(&self, name: &str, minor_ns: u64) -> Option<String> {
        let (_, schedule) = tables(&self.document, "schedule").find(|(other, _)| *other == name)?;
        let before_ns = duration_ns(schedule.get("minor_frame")?.as_str()?).ok()?;
        let windows = self.document.get("health")?.get("silence_windows")?.as_integer()?;
        let windows = u64::try_from(windows).ok().filter(|_| before_ns != minor_ns)?;
        let silence = |minor_ns: u64| ShowTime(minor_ns.saturating_mul(windows));
        Some(format!(
            "note: `silence_windows` = {windows} counts windows: of a partition with one in each minor frame a silence is {} and no longer {}",
            silence(minor_ns),
            silence(before_ns)
        ))
    }

    /// The file with the schedule in it.
    pub(super) fn with_schedule(&self, name: &str, text: &str) -> Result<String> {
        let mut document = self.document.clone();
        let planned: Table = toml::from_str(text)?;
        let schedules = document.entry("schedule").or_insert_with(|| Value::Table(Table::new()));
        let planned = planned.get("schedule").and_then(|table| table.get(name)).cloned();
        if let (Some(schedules), Some(planned)) = (schedules.as_table_mut(), planned) {
            // What else the old one says, such as what becomes of partitions at a change, stays.
            let mut merged = schedules.get(name).and_then(Value::as_table).cloned().unwrap_or_default();
            merged.extend(planned.as_table().cloned().unwrap_or_default());
            schedules.insert(name.to_owned(), Value::Table(merged));
        }
        Ok(toml::to_string(&document)?)
    }
}

fn says_initial(schedule: &Table) -> bool {
    schedule.get("initial").and_then(Value::as_bool).unwrap_or(false)
}
