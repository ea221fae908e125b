//! What a plan says of the five flight functions that the loop calls.

use std::collections::BTreeMap;

use anyhow::{Result, anyhow, bail};
use bateleur_main_cycle::{Given, Instants, OUTPUTS, Settings, Topics, Validity};
use bateleur_plan::{Attribute, ModuleId, PartitionId, Plan, Role};
use serde_json::Value;

use super::fly::partition_running;

/// The programs, in the order of the loop.
const FUNCTIONS: [&str; 5] = ["gps", "imu", "estimator", "controller", "servo"];

/// Attributes by partition.
pub(super) struct Attributes(BTreeMap<String, Given>);

impl Attributes {
    /// Those of the plan.
    pub(super) fn of(plan: &Plan) -> Self {
        let all = plan.partitions.iter();
        Self(all.map(|partition| (partition.name.clone(), given(&partition.attributes))).collect())
    }

    /// Replaces one.
    pub(super) fn set(&mut self, partition: &str, attribute: &str, value: Value) {
        self.0.entry(partition.to_owned()).or_default().insert(attribute.to_owned(), value);
    }

    /// The aircraft, by name or file, as `bateleur fly` hands it on.
    pub(super) fn set_airframe(&mut self, plan: &Plan, program: &str, airframe: &str) -> Result<()> {
        let value = std::fs::read_to_string(airframe).unwrap_or_else(|_| airframe.to_owned());
        self.set(&partition_running(plan, program)?, "airframe", value.into());
        Ok(())
    }
}

/// Attributes as the partitions get them. They are plain values: turning them can not fail.
fn given(attributes: &BTreeMap<String, Attribute>) -> Given {
    let value = |attribute: &Attribute| serde_json::to_value(attribute).unwrap_or_default();
    attributes.iter().map(|(name, attribute)| (name.clone(), value(attribute))).collect()
}

/// The functions' settings, and where the log has what they take and give.
pub(super) fn read(plan: &Plan, module: Option<&str>, given: &Attributes) -> Result<(Settings, Topics)> {
    if let Some(voter) = plan.partitions.iter().find(|partition| !partition.replicas.is_empty()) {
        bail!("`{}` has replicas: a plain loop has one of each function", voter.name);
    }
    let names: Vec<String> =
        FUNCTIONS.iter().map(|program| partition_running(plan, program)).collect::<Result<_>>()?;
    let of = |program: usize| given.0.get(&names[program]).cloned().unwrap_or_default();
    let look = Look { plan, names: &names };
    let given = [of(0), of(1), of(2), of(3), of(4)];
    let settings = Settings::read(given, instants(plan, module, &names)?, look.validity()?)?;
    Ok((settings, look.topics()?))
}

/// When each runs. The loop has one order and one period: a plan in which a function runs more seldom, more often, or before the one
/// whose values it uses is not such a loop.
fn instants(plan: &Plan, module: Option<&str>, names: &[String]) -> Result<Instants> {
    let home = |name: &String| plan.partition(name).map(|id| plan[id].module);
    let homes: Vec<ModuleId> = names.iter().filter_map(home).collect();
    if let Some(other) = homes.iter().find(|id| module.is_some_and(|module| plan[**id].name != module)) {
        bail!("the functions run on module `{}`, which is not the one that flew", plan[*other].name);
    }
    let schedule = plan.schedules.iter().find(|schedule| schedule.initial);
    let schedule = schedule.ok_or_else(|| anyhow!("the plan has no initial schedule"))?;
    let mut offsets = Vec::new();
    for name in names {
        let id = plan.partition(name);
        let windows: Vec<_> = schedule.windows.iter().filter(|window| Some(window.partition) == id).collect();
        match windows.as_slice() {
            [one] if one.minor.len() == schedule.minor_frames() as usize => offsets.push(one.offset_ns),
            _ => {
                bail!("`{name}` does not have one window in every minor frame: a plain loop can not do that")
            }
        }
    }
    let [gps_ns, imu_ns, estimator_ns, controller_ns, servo_ns] = offsets[..] else {
        bail!("the plan lacks a function");
    };
    if !offsets.is_sorted() {
        bail!("the windows are not in the order {}: a plain loop has that one", FUNCTIONS.join(", "));
    }
    let period_ns = schedule.minor_frame_ns;
    Ok(Instants { gps_ns, imu_ns, estimator_ns, controller_ns, servo_ns, period_ns })
}

struct Look<'a> {
    plan: &'a Plan,
    names: &'a [String],
}

impl Look<'_> {
    /// A destination port's period of validity.
    fn refresh_ns(&self, function: usize, port: &str) -> Result<u64> {
        let id = self.partition(function)?;
        let found = self.plan[id].ports.iter().map(|port| &self.plan[*port]).find(|found| found.name == port);
        match found.map(|found| found.role) {
            Some(Role::SamplingDestination { refresh_ns }) => Ok(refresh_ns),
            _ => bail!("`{}` has no sampling port `{port}` that it reads", self.names[function]),
        }
    }

    fn partition(&self, function: usize) -> Result<PartitionId> {
        let name = &self.names[function];
        self.plan.partition(name).ok_or_else(|| anyhow!("the plan has no partition `{name}`"))
    }

    fn validity(&self) -> Result<Validity> {
        Ok(Validity {
            gps_raw_ns: self.refresh_ns(0, "raw")?,
            imu_raw_ns: self.refresh_ns(1, "raw")?,
            estimator_gps_ns: [self.refresh_ns(2, "gps_position")?, self.refresh_ns(2, "gps_velocity")?],
            estimator_imu_ns: [
                self.refresh_ns(2, "acceleration")?,
                self.refresh_ns(2, "orientation")?,
                self.refresh_ns(2, "magnetization")?,
                self.refresh_ns(2, "pressure")?,
            ],
            estimator_command_ns: self.refresh_ns(2, "command").ok(),
            controller_ns: [
                self.refresh_ns(3, "state")?,
                self.refresh_ns(3, "acceleration")?,
                self.refresh_ns(3, "orientation")?,
                self.refresh_ns(3, "pressure")?,
            ],
            controller_range_ns: self.refresh_ns(3, "range").ok(),
            servo_ns: [self.refresh_ns(4, "command")?, self.refresh_ns(4, "custom")?],
        })
    }

    /// The topic of the source that a port reads.
    fn source(&self, function: usize, port: &str) -> Result<String> {
        let (plan, id) = (self.plan, self.partition(function)?);
        let is_it = |end: &&bateleur_plan::PortId| plan[**end].partition == id && plan[**end].name == port;
        let channel = plan.channels.iter().find(|channel| channel.destinations.iter().any(|end| is_it(&end)));
        let Some(channel) = channel else { bail!("`{}.{port}` has no channel", self.names[function]) };
        let source = &plan[channel.source];
        Ok(bateleur_recording::topic(&plan[source.partition].name, &source.name))
    }

    fn topics(&self) -> Result<Topics> {
        let outputs = OUTPUTS.map(|(program, port)| {
            let function = FUNCTIONS.iter().position(|name| *name == program).unwrap_or_default();
            bateleur_recording::topic(&self.names[function], port)
        });
        let ground = |function| self.source(function, "ground");
        Ok(Topics {
            sensors: [self.source(0, "raw")?, self.source(1, "raw")?, self.source(4, "custom")?],
            range: self.source(3, "range").ok(),
            orders: [ground(1)?, ground(2)?, ground(3)?, ground(4)?],
            outputs,
        })
    }
}
