//! Other modules that use this one's processors: found, told of once each, and looked for when a partition had no processor in
//! its windows.
//!
//! It must never hold against a partition what somebody else has taken from it, nor look often.

use bateleur_contract::Clock;

use super::watched::Life;
use super::{Monitor, seconds};
use crate::event::Event;
use bateleur_host::instance;
use bateleur_host::machine::taken_by;
use bateleur_system::cpu_starvation::Spell;
use bateleur_time::window_record::WindowRecord;

/// Between two looks, module time, ns.
const LOOK_NS: u64 = 5_000_000_000;
/// What the persistent log calls it; no error of a table.
const NO_PROCESSOR: &str = "no_processor";

/// See the module's head.
#[derive(Debug, Default)]
pub(super) struct Neighbours {
    next_look_ns: u64,
    /// Processes of the modules that were told of.
    told: Vec<i32>,
    /// Windows in which a partition had no processor.
    starved: u64,
}

impl Monitor {
    /// Says which modules have begun since to use this one's processors. Those before were found when the machine was examined.
    pub(super) fn look_for_neighbours(&mut self, module_ns: u64) {
        if module_ns < self.neighbours.next_look_ns {
            return;
        }
        self.neighbours.next_look_ns = module_ns + LOOK_NS;
        let mut cores: Vec<u32> =
            self.watched.iter().flat_map(|watched| watched.sandbox.cores()).copied().collect();
        cores.dedup();
        let mut others = instance::later_ones();
        self.neighbours.told.retain(|pid| others.iter().any(|other| other.pid == *pid));
        others.retain(|other| !self.neighbours.told.contains(&other.pid));
        if let Some(text) = taken_by(&cores, &others) {
            let theirs = others.iter().filter(|other| other.cores.iter().any(|core| cores.contains(core)));
            self.neighbours.told.extend(theirs.map(|other| other.pid));
            self.tell_of_neighbour(text, module_ns);
        }
    }

    /// Whether the partition could not close its window because it had no processor for most of it. Known from the second window
    /// in a row on that it does not close: nobody asks the kernel for more of what goes well.
    pub(super) fn had_no_processor(&mut self, place: usize, record: &WindowRecord, module_ns: u64) -> bool {
        let watched = &mut self.watched[place];
        let Life::Running(process) = &watched.life else { return false };
        if self.clock == Clock::Virtual {
            return false; // its gate has waited until it had one
        }
        let before = watched.spell.replace((module_ns, Spell::begin(process.pid)));
        let covers = |begun_ns| record.granted_ns.is_some_and(|granted_ns| granted_ns >= begun_ns);
        let starved = before.is_some_and(|(begun_ns, spell)| {
            covers(begun_ns)
                && spell.is_of(process.pid)
                && spell.has_starved(record.occurrence.window.duration_ns())
        });
        if starved {
            self.neighbours.starved += 1;
            if self.neighbours.starved == 1 {
                self.tell_starved(place, module_ns);
            }
        }
        starved
    }

    fn tell_starved(&mut self, place: usize, module_ns: u64) {
        let sandbox = &self.watched[place].sandbox;
        let why = taken_by(sandbox.cores(), &instance::others())
            .unwrap_or_else(|| "something of a higher priority than its own has it".into());
        let text =
            format!("{} had no processor in its window and is not to blame for it: {why}", sandbox.name);
        self.tell_of_neighbour(text, module_ns);
    }

    fn tell_of_neighbour(&mut self, text: String, module_ns: u64) {
        self.health_log.note_module(NO_PROCESSOR, text.clone(), module_ns);
        let partition = self.operator.about.module.clone();
        self.events.tell(&Event::Message { time_s: seconds(module_ns), partition, text });
    }

    /// Says at the end how often it was so.
    pub(super) fn count_starved(&mut self, module_ns: u64) {
        let starved = self.neighbours.starved;
        if starved > 1 {
            let text = format!("partitions had no processor in {starved} windows that they did not close");
            self.tell_of_neighbour(text, module_ns);
        }
    }
}
