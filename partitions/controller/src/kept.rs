//! What outlives a warm restart: all that the ground has said, the place in the mission and on the path, and the memory of
//! the laws, all of it.

use bateleur_flight::control::memory::{self, ControllerSnapshot};
use bateleur_flight::guidance::{MAX_WAYPOINTS, Step, Waypoint};
use bateleur_messages::ground::{LoopId, Order};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use crate::areas::Areas;
use crate::manoeuvre::Tasks;
use crate::orders::{Answer, Orders};
use crate::waypoints::{List, Waypoints};

/// [`Kept::switches`]: the autopilot flies.
const AUTOPILOT: u32 = 1;
/// [`Kept::switches`]: navigation is on.
const NAVIGATION: u32 = 2;
/// [`Kept::switches`]: an altitude is held.
const HOLD: u32 = 4;

/// Bytes of the laws, up to the next number.
const LAWS: usize = memory::BYTES.next_multiple_of(8);

type Points = [[f64; 8]; MAX_WAYPOINTS];

/// Plain numbers in a fixed size.
#[derive(Debug, Clone, Copy, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Kept {
    switches: u32,
    /// One bit a loop.
    loops: u32,
    targets: [f64; LoopId::ALL.len()],
    hold_altitude_m: f64,
    /// Module time of the last step, ns.
    last_ns: u64,
    /// The laws and the guidance.
    laws: [u8; LAWS],
    staged_count: u32,
    staged_there: u32,
    flown_count: u32,
    flown_there: u32,
    /// What is flown in place of the orders, and the fence.
    tasks: u32,
    reserved: u32,
    staged: Points,
    flown: Points,
    pub(crate) areas: Areas,
}

impl Kept {
    /// What to keep.
    pub(crate) fn new(
        orders: &Orders,
        tasks: Tasks,
        (waypoints, areas): (&Waypoints, Areas),
        laws: &ControllerSnapshot,
        hold_altitude_m: Option<f64>,
        last_ns: Option<u64>,
    ) -> Self {
        let on = |on: bool, bit: u32| if on { bit } else { 0 };
        let is_on = |id: &LoopId| orders.target(*id).is_some();
        Self {
            switches: on(orders.autopilot, AUTOPILOT)
                | on(orders.navigation, NAVIGATION)
                | on(hold_altitude_m.is_some(), HOLD),
            loops: LoopId::ALL.into_iter().filter(is_on).map(|id| 1 << (id as u32)).sum(),
            targets: LoopId::ALL.map(|id| orders.target(id).unwrap_or(0.0)),
            hold_altitude_m: hold_altitude_m.unwrap_or(0.0),
            last_ns: last_ns.unwrap_or(0),
            laws: padded(laws),
            staged_count: waypoints.staged.count as u32,
            staged_there: waypoints.staged.there,
            flown_count: waypoints.flown.count as u32,
            flown_there: waypoints.flown.there,
            tasks: tasks.to_bits(),
            reserved: 0,
            staged: waypoints.staged.points.map(to_numbers),
            flown: waypoints.flown.points.map(to_numbers),
            areas,
        }
    }

    /// Whether it can be gone on from. Memory that something else has written into is better forgotten whole.
    pub fn is_sane(&self) -> bool {
        let counts = self.staged_count.max(self.flown_count) as usize <= MAX_WAYPOINTS;
        let finite = self.targets.iter().all(|number| number.is_finite());
        let points = self.staged.iter().chain(&self.flown).flatten().all(|number| number.is_finite());
        let whole = self.flown_count == self.flown_there.count_ones();
        counts && finite && points && whole && self.areas.is_sane() && self.hold_altitude_m.is_finite()
    }

    /// Switches and targets.
    pub fn orders(&self) -> Orders {
        let is_on = |id: &LoopId| self.loops & (1 << (*id as u32)) != 0;
        let mut orders = Orders {
            autopilot: self.switches & AUTOPILOT != 0,
            navigation: self.switches & NAVIGATION != 0,
            ..Orders::default()
        };
        for id in LoopId::ALL.into_iter().filter(is_on) {
            let target = self.targets[id as usize];
            let _: Answer = orders.take(&Order::Loop { id, on: true, target }); // checks the target
        }
        orders
    }

    /// What is flown in place of the orders.
    pub(crate) fn tasks(&self) -> Tasks {
        Tasks::from_bits(self.tasks)
    }

    /// The way-points.
    pub fn waypoints(&self) -> Waypoints {
        let list = |count: u32, there, points: &Points| List {
            count: count as usize,
            there,
            points: points.map(from_numbers),
        };
        Waypoints {
            staged: list(self.staged_count, self.staged_there, &self.staged),
            flown: list(self.flown_count, self.flown_there, &self.flown),
        }
    }

    /// The altitude that was held.
    pub fn hold_altitude_m(&self) -> Option<f64> {
        (self.switches & HOLD != 0).then_some(self.hold_altitude_m)
    }

    /// Where the laws stood, and the mission.
    pub fn laws(&self) -> Option<ControllerSnapshot> {
        ControllerSnapshot::from_bytes(self.laws.first_chunk()?)
    }

    /// Module time of the last step, ns.
    pub fn last_ns(&self) -> Option<u64> {
        (self.last_ns > 0).then_some(self.last_ns)
    }
}

fn padded(laws: &ControllerSnapshot) -> [u8; LAWS] {
    let mut bytes = [0; LAWS];
    bytes[..memory::BYTES].copy_from_slice(&laws.to_bytes());
    bytes
}

fn to_numbers(p: Waypoint) -> [f64; 8] {
    let [kind, amount, second] = p.step.to_numbers();
    [p.north_m, p.east_m, p.altitude_m, p.airspeed_mps, p.heading_rad, kind, amount, second]
}

fn from_numbers(numbers: [f64; 8]) -> Waypoint {
    let [north_m, east_m, altitude_m, airspeed_mps, heading_rad, step @ ..] = numbers;
    Waypoint { north_m, east_m, altitude_m, airspeed_mps, heading_rad, step: Step::from_numbers(step) }
}
