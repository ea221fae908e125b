//! What a partition's process has written down of its end, on its way to a helper.

use crate::crashes::tells_of;
use crate::lifecycle::PairMember;
use crate::monitor::Monitor;
use bateleur_host::helper::crash::CrashOrder;
use bateleur_plan::{Closed, PartitionError};

impl Monitor {
    /// The process of the partition at `place` has ended by this error, or is about to be ended for it: what it has written down of that
    /// waits for a helper.
    pub(crate) fn collect_crash(
        &mut self,
        place: usize,
        member: PairMember,
        (error, detail): (PartitionError, &str),
        module_ns: u64,
    ) {
        let partition = &mut self.partitions[place];
        let stands_by = u32::from(member == PairMember::Standby);
        let (generation, exit_code) = (partition.life.generation() + stands_by, partition.exit_code);
        let Some(process) = partition.member(member) else { return };
        let Some((memory, signal)) = process.sandbox.take_crash() else { return };
        if !tells_of(error, exit_code, signal) {
            return;
        }
        let sandbox = &process.sandbox;
        let plan = &self.plan;
        let ports = plan.own_ports(&plan[sandbox.id]).filter_map(|port| {
            let source = plan[plan[port].channel?].source;
            Some((plan[port].name.clone(), plan.port_path(source)))
        });
        let order = CrashOrder {
            partition: sandbox.name.clone(),
            generation,
            time_ns: module_ns,
            error: error.name().into(),
            detail: detail.to_owned(),
            program: sandbox.program().display().to_string(),
            ports: ports.collect(),
        };
        self.kept.crashes.add(order, memory);
    }

    /// Looks after the helper that is at work, and those who wait.
    pub(crate) fn look_at_crashes(&mut self, module_ns: u64) {
        if self.kept.crashes.is_idle() {
            return;
        }
        let partitions = &self.partitions;
        let comes_back = |name: &str| {
            partitions.iter().any(|partition| partition.name() == name && partition.life.is_coming())
        };
        if let Some(text) = self.kept.crashes.look(comes_back) {
            let module = self.operator.about.module.clone();
            self.kept.say(&module, text, module_ns);
        }
    }
}
