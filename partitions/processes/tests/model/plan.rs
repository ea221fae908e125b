//! What a script begins with.

use bateleur_processes::standard::{INFINITE_TIME_VALUE as FOREVER, SystemTime};
use rand::{Rng, RngExt};

use crate::calls::DRAWS;
use crate::ms;

/// Period of the partition, ns.
pub(crate) const PERIOD: SystemTime = 10_000_000;

/// What a script begins with.
#[derive(Debug)]
pub(crate) struct Plan {
    pub(crate) processes: Vec<PlannedProcess>,
    /// Their priorities.
    pub(crate) mutexes: [i32; 2],
    pub(crate) by_priority: bool,
    pub(crate) handler: bool,
    /// Every other call is one of these draws: what seldom meets in ordinary scripts meets in those that like it.
    pub(crate) liked: Vec<u32>,
}

#[derive(Debug)]
pub(crate) struct PlannedProcess {
    pub(crate) priority: i32,
    pub(crate) period: SystemTime,
    pub(crate) capacity: SystemTime,
}

impl Plan {
    pub(crate) fn random(random: &mut impl Rng) -> Self {
        let handler = random.random_range(0..8) != 0;
        let mut process = || PlannedProcess {
            priority: [10, 10, 20, 30][random.random_range(0..4)],
            period: [FOREVER, FOREVER, PERIOD, 2 * PERIOD][random.random_range(0..4)],
            // Without a handler, the first late process would end the script.
            capacity: if handler { [FOREVER, ms(4), ms(10)][random.random_range(0..3)] } else { FOREVER },
        };
        let processes = (0..5).map(|_| process()).collect();
        let by_priority = random.random_range(0..2) == 1;
        let liked = (0..6).map(|_| random.random_range(0..DRAWS)).collect();
        Self { processes, mutexes: [20, 40], by_priority, handler, liked }
    }
}
