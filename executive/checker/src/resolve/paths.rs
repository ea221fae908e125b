//! Chains with every port on their way, also those that the file leaves out.

use crate::catalogue;
use crate::closed::Direction;
use crate::findings::Finding;
use crate::model::{Chain, Plan, PortId};
use crate::raw::RawChain;
use crate::reader::At;
use bateleur_plan::words::listed;

use super::Resolver;

impl Resolver<'_> {
    /// A chain of a plan that has its channels.
    pub(super) fn chain(&self, plan: &Plan, raw: &RawChain) -> Chain {
        Chain {
            name: raw.name.get().unwrap_or_default(),
            path: self.path(plan, raw.path.items()).unwrap_or_default(),
            max_age_ns: raw.max_age.ns(0),
        }
    }

    /// `None` where a port is not known or nothing leads on, which is reported.
    fn path(&self, plan: &Plan, said: &[At<String>]) -> Option<Vec<PortId>> {
        let ports: Vec<PortId> = said.iter().map(|path| self.names.port(path)).collect();
        let is_known =
            |port: &PortId| self.file.ports.get(port.0).is_some_and(|raw| raw.direction.said().is_some());
        if !ports.iter().all(is_known) {
            return None;
        }
        let mut path: Vec<PortId> = ports.first().copied().into_iter().collect();
        for (said, step) in said.windows(2).zip(ports.windows(2)) {
            let Some(between) = self.between(plan, step[0], step[1]) else {
                self.disconnected(plan, (&said[0], step[0]), &said[1]);
                return None;
            };
            path.extend(between);
            path.push(step[1]);
        }
        Some(path)
    }

    /// The port left out between two ports of a path, if there is one; nothing if there is no way.
    fn between(&self, plan: &Plan, from: PortId, to: PortId) -> Option<Option<PortId>> {
        let owner = |port: PortId| plan[port].partition;
        match (plan[from].direction(), plan[to].direction()) {
            (Direction::Destination, Direction::Source) => (owner(from) == owner(to)).then_some(None),
            (Direction::Source, Direction::Destination) => {
                self.destinations(plan, from).any(|port| port == to).then_some(None)
            }
            (Direction::Source, Direction::Source) => {
                self.destinations(plan, from).find(|&port| owner(port) == owner(to)).map(Some)
            }
            (Direction::Destination, Direction::Destination) => {
                let source = plan[plan[to].channel?].source;
                (source != to && owner(from) == owner(source)).then_some(Some(source))
            }
        }
    }

    /// The ports that a source port reaches.
    fn destinations<'p>(&self, plan: &'p Plan, source: PortId) -> impl Iterator<Item = PortId> + use<'p> {
        let nobody = self.nobody.port;
        let mine = plan.channels.iter().filter(move |channel| channel.source == source);
        mine.flat_map(|channel| channel.destinations.iter().copied()).filter(move |port| *port != nobody)
    }

    fn disconnected(&self, plan: &Plan, (from, port): (&At<String>, PortId), to: &At<String>) {
        let message = format!("nothing leads from `{}` to `{}`", from.value, to.value);
        // Through its channel, or through its partition.
        let onward: Vec<PortId> = match plan[port].direction() {
            Direction::Source => self.destinations(plan, port).collect(),
            Direction::Destination => {
                let beside = plan[plan[port].partition].ports.iter().copied();
                beside.filter(|other| plan[*other].direction() == Direction::Source).collect()
            }
        };
        let mut mend = "connect them by a channel, or name the ports between them".to_owned();
        if !onward.is_empty() {
            let onward: Vec<String> = onward.into_iter().map(|port| plan.port_path(port)).collect();
            let onward = listed(onward.iter().map(String::as_str));
            mend = format!("{mend}; `{}` leads to {onward}", from.value);
        }
        let finding = Finding::new(&catalogue::CHAIN_DISCONNECTED, &to.span, message, mend);
        self.findings.add(finding.also(&from.span, "the path is here before"));
    }
}
