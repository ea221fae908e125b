//! What outlives a warm restart: the frames that are on their way over the line, in both directions, what has been reported, what
//! the ground has set, and the mission that went through here. So the ground hears no frame cut or twice, no order is lost in the
//! middle, and a ground station can still download what it uploaded.

use bateleur_apex::serial::Presence;
use bateleur_messages::frame::DecoderState;
use bateleur_messages::ground::{Step, Waypoint};
use bateleur_messages::mark::{MOST_MARKS, Mark, MarkKind};
use bateleur_messages::parameter::Changed;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use crate::downlink::KeptDownlink;
use crate::station::MOST_WAYPOINTS;
use crate::{Contingencies, Downlink, Uplink, contingency};

/// Plain data in a fixed size.
#[derive(Debug, Clone, Copy, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Kept {
    uplink: DecoderState,
    downlink: KeptDownlink,
    /// Not zero: the device was reported missing.
    missing: u64,
    contingencies: [u64; contingency::NUMBERS],
    /// Entries of the health log that were read, and those of them that were not told.
    notices_read: u64,
    notices_owed: u64,
    parameters: Changed,
    waypoint_count: u64,
    /// North, east, altitude, heading, airspeed; what is done there.
    waypoints: [[f64; 8]; MOST_WAYPOINTS],
    mark_count: u64,
    /// Index, count, list, kind; north, east, size: fence and rally points.
    marks: [[f64; 7]; 2 * MOST_MARKS],
}

impl Kept {
    /// What to keep.
    pub fn of(
        uplink: &Uplink,
        downlink: &Downlink,
        presence: &Presence,
        contingencies: &Contingencies,
        parameters: &Changed,
        (mission, marks): (&[Waypoint], &[Mark]),
        (notices_read, notices_owed): (u32, u64),
    ) -> Self {
        let mut waypoints = [[0.0; 8]; MOST_WAYPOINTS];
        for (place, w) in waypoints.iter_mut().zip(mission) {
            let [kind, amount, second] = w.step.to_numbers();
            let (north_m, east_m) = (w.north_m, w.east_m);
            *place = [north_m, east_m, w.altitude_m, w.heading_rad, w.airspeed_mps, kind, amount, second];
        }
        let mut kept_marks = [[0.0; 7]; 2 * MOST_MARKS];
        for (place, m) in kept_marks.iter_mut().zip(marks) {
            let heads = [m.index, m.count, m.list, m.kind as u8].map(f64::from);
            place[..4].copy_from_slice(&heads);
            place[4..].copy_from_slice(&[m.north_m, m.east_m, m.size]);
        }
        Self {
            uplink: uplink.state(),
            downlink: downlink.kept(),
            missing: u64::from(presence.is_reported()),
            contingencies: contingencies.kept(),
            notices_read: u64::from(notices_read),
            notices_owed,
            parameters: *parameters,
            waypoint_count: mission.len().min(MOST_WAYPOINTS) as u64,
            waypoints,
            mark_count: marks.len().min(2 * MOST_MARKS) as u64,
            marks: kept_marks,
        }
    }

    /// How many entries of the health log were read, and how many of them were not told.
    pub fn notices(&self) -> (u32, u64) {
        (self.notices_read as u32, self.notices_owed)
    }

    /// What the ground had set.
    pub fn parameters(&self) -> &Changed {
        &self.parameters
    }

    /// The mission that had gone to the Controller; empty where it makes no sense.
    pub fn mission(&self) -> Vec<Waypoint> {
        let count = usize::try_from(self.waypoint_count).unwrap_or(usize::MAX);
        let numbers = self.waypoints.get(..count).unwrap_or_default();
        if !numbers.iter().flatten().all(|number| number.is_finite()) {
            return Vec::new();
        }
        let waypoint = |(index, numbers): (u8, &[f64; 8])| {
            let [north_m, east_m, altitude_m, heading_rad, airspeed_mps, step @ ..] = *numbers;
            let count = count as u8; // MOST_WAYPOINTS at most
            let step = Step::from_numbers(step)?;
            Some(Waypoint { index, count, north_m, east_m, altitude_m, heading_rad, airspeed_mps, step })
        };
        (0..=u8::MAX).zip(numbers).map(waypoint).collect::<Option<_>>().unwrap_or_default()
    }

    /// The fence and the rally points that had gone to the Controller; empty where they make no sense.
    pub fn marks(&self) -> Vec<Mark> {
        let count = usize::try_from(self.mark_count).unwrap_or(usize::MAX);
        let numbers = self.marks.get(..count).unwrap_or_default();
        let mark = |&[index, count, list, kind, north_m, east_m, size]: &[f64; 7]| {
            let finite = [north_m, east_m, size].iter().all(|number| number.is_finite());
            let kind = MarkKind::of_number(kind).filter(|_| finite)?;
            // Casts saturate.
            let (index, count, list) = (index as u8, count as u8, list as u8);
            Some(Mark { index, count, list, kind, north_m, east_m, size })
        };
        numbers.iter().map(mark).collect::<Option<_>>().unwrap_or_default()
    }

    /// Hands it to those of the next incarnation. What does not make sense is forgotten.
    pub fn resume(
        &self,
        uplink: &mut Uplink,
        downlink: &mut Downlink,
        presence: &mut Presence,
        contingencies: &mut Contingencies,
    ) {
        contingencies.resume(self.contingencies);
        uplink.resume(&self.uplink);
        downlink.resume(&self.downlink);
        *presence = Presence::after(self.missing != 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Delivery;
    use bateleur_apex::serial::Change;
    use bateleur_messages::TelemetryMessage;
    use bateleur_messages::frame::encode;
    use bateleur_messages::ground::Order;

    const CYCLE: u64 = 20_000_000;

    struct Command {
        uplink: Uplink,
        downlink: Downlink,
        presence: Presence,
    }

    impl Command {
        fn new(kept: Option<&Kept>) -> Self {
            let (mut uplink, mut downlink) = (Uplink::new(), Downlink::new(57_600));
            let mut presence = Presence::default();
            if let Some(kept) = kept {
                kept.resume(&mut uplink, &mut downlink, &mut presence, &mut Contingencies::default());
            }
            Self { uplink, downlink, presence }
        }

        /// One window: takes what has come up and some telemetry; gives what goes down, and the orders.
        fn window(&mut self, number: u64, up: &[u8]) -> (Vec<u8>, Vec<Delivery>) {
            let orders = self.uplink.take(up);
            for place in 0..number % 3 {
                let mut message =
                    TelemetryMessage { letter: b'P', length: 90, ..TelemetryMessage::default() };
                message.data[0] = (number + place) as u8;
                self.downlink.push(message);
            }
            let mut due = self.downlink.due(number * CYCLE).to_vec();
            due.truncate(100); // the line takes no more at once
            self.downlink.sent(due.len());
            (due, orders)
        }

        fn kept(&self) -> Kept {
            let contingencies = Contingencies::default();
            Kept::of(
                &self.uplink,
                &self.downlink,
                &self.presence,
                &contingencies,
                &Changed::default(),
                (&[], &[]),
                (0, 0),
            )
        }
    }

    /// What the ground hears and is heard of in 60 windows, with a restart at the end of some of them.
    fn line(restarted: impl Fn(u64) -> bool) -> (Vec<Vec<u8>>, Vec<Delivery>) {
        let mut up = Vec::new();
        for on in [true, false, true] {
            let order = Order::Autopilot { on };
            encode(order.letter(), &order.data(), &mut up);
        }
        let mut command = Command::new(None);
        let (mut down, mut orders) = (Vec::new(), Vec::new());
        for number in 0..60 {
            let piece = up.get(number as usize..number as usize + 1).unwrap_or_default();
            let (bytes, some) = command.window(number, piece);
            down.push(bytes);
            orders.extend(some);
            if restarted(number) {
                command = Command::new(Some(&command.kept()));
            }
        }
        (down, orders)
    }

    #[test]
    fn warm_restart_after_any_window_is_not_heard_on_the_line() {
        let undisturbed = line(|_| false);
        assert_eq!(undisturbed.1.len(), 3);
        for at in 0..60 {
            assert_eq!(line(|number| number == at), undisturbed, "restarted after window {at}");
        }
        assert_eq!(line(|_| true), undisturbed, "restarted after each window");
    }

    #[test]
    fn device_that_was_reported_missing_is_not_reported_again_after_a_warm_restart() {
        let mut command = Command::new(None);
        assert_eq!(command.presence.failed(0), Some(Change::Lost));
        let mut again = Command::new(Some(&command.kept()));
        assert_eq!(again.presence.failed(CYCLE), None);
        assert_eq!(again.presence.opened(), Some(Change::Found));
    }

    #[test]
    fn mission_is_known_after_a_warm_restart_and_noise_is_none() {
        let waypoint = |index| Waypoint {
            index,
            count: 2,
            north_m: 500.0,
            east_m: f64::from(index),
            altitude_m: 160.0,
            heading_rad: 1.0,
            airspeed_mps: 22.0,
            step: Step::Turns { turns: f64::from(index), radius_m: -90.0 },
        };
        let mission = [waypoint(0), waypoint(1)];
        let rally = Mark { index: 1, count: 2, size: 90.0, ..Mark::none(7, MarkKind::Rally) };
        let marks = [Mark { kind: MarkKind::ExclusionCircle, ..rally }, rally];
        let (uplink, downlink) = (Uplink::new(), Downlink::new(57_600));
        let kept = Kept::of(
            &uplink,
            &downlink,
            &Presence::default(),
            &Contingencies::default(),
            &Changed::default(),
            (&mission, &marks),
            (7, 2),
        );
        assert_eq!((kept.mission(), kept.notices()), (mission.to_vec(), (7, 2)));
        assert_eq!(kept.marks(), marks);
        assert_eq!(Kept { mark_count: 9_999, ..kept }.marks(), []);
        assert_eq!(Kept { waypoint_count: 9_999, ..kept }.mission(), []);
        assert_eq!(Kept { waypoints: [[f64::NAN; 8]; MOST_WAYPOINTS], ..kept }.mission(), []);
    }

    #[test]
    fn retained_memory_full_of_noise_keeps_the_line_going() {
        for byte in [0x01, 0x3f, 0xa5, 0xff] {
            let noise = Kept::read_from_bytes(&vec![byte; size_of::<Kept>()]).unwrap();
            let mut command = Command::new(Some(&noise));
            let mut frame = Vec::new();
            encode(b'H', &[1], &mut frame);
            // The first may end what noise began.
            let heard = (1..5).filter(|number| !command.window(*number, &frame).1.is_empty()).count();
            assert!(heard >= 2, "{byte:#x}: {heard} orders");
        }
    }
}
