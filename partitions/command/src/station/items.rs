//! Mission items of MAVLink, and the Controller's list of way-points.
//!
//! Responsible for the meaning of each item. It must never pass on one that would be flown as something else than what the ground station
//! shows: what is not flown is refused, with its number and the reason.

use bateleur_mavlink::Runway;
use bateleur_mavlink::common::{MISSION_ITEM_INT_DATA, MavCmd, MavFrame, MavMissionResult as Verdict};
use bateleur_messages::ground::{Step, Waypoint};

use super::mission::MOST_WAYPOINTS;

/// Airspeed before any item has named one, m/s.
const USUAL_MPS: f64 = 22.0;
/// Heights of a take-off, m above the runway, and how far a touch-down may lie above or below it: the field is level.
const TAKE_OFF_M: std::ops::RangeInclusive<f64> = 20.0..=1_000.0;
const LEVEL_M: f64 = 10.0;

/// Why an item is refused for its command, or for its frame.
pub(super) const COMMAND: Refused = (Verdict::MAV_MISSION_UNSUPPORTED, "this command is not flown here");
pub(super) const FRAME: Refused = (Verdict::MAV_MISSION_UNSUPPORTED_FRAME, "its frame is not known here");

/// The verdict on an item, and the reason for a person.
pub(super) type Refused = (Verdict, &'static str);

/// What an item says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Read {
    /// This airspeed, m/s, from here on.
    Speed(f64),
    /// An entry of the list, without its place in it and its airspeed. A jump names an item.
    Entry(Waypoint),
    /// Nothing that is flown: it marks a place in the list.
    Mark,
}

/// One item, as the ground station counts them.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Item {
    Speed(f64),
    /// The way-point of this place in the Controller's list.
    Waypoint(usize),
}

/// The Controller's way-points as items.
#[derive(Debug, Clone, Default)]
pub(super) struct Items {
    pub(super) waypoints: Vec<Waypoint>,
}

impl Items {
    fn list(&self) -> Vec<Item> {
        let (mut items, mut speed_mps) = (Vec::new(), USUAL_MPS);
        for (place, waypoint) in self.waypoints.iter().enumerate() {
            if waypoint.airspeed_mps != speed_mps {
                speed_mps = waypoint.airspeed_mps;
                items.push(Item::Speed(speed_mps));
            }
            items.push(Item::Waypoint(place));
        }
        items
    }

    /// Number of items.
    pub(super) fn count(&self) -> u16 {
        self.list().len() as u16 // two for each way-point at most
    }

    /// The item of a way-point; 0 where it is not known.
    pub(super) fn place_of(&self, waypoint: u32) -> u16 {
        let place = self.list().iter().position(|item| *item == Item::Waypoint(waypoint as usize));
        place.unwrap_or(0) as u16 // as above
    }

    /// The way-point of an item, or the one behind it; `None`: there is no such item.
    pub(super) fn waypoint_at(&self, seq: u16) -> Option<u8> {
        self.list().iter().skip(usize::from(seq)).find_map(|item| match item {
            Item::Waypoint(place) => u8::try_from(*place).ok(),
            Item::Speed(_) => None,
        })
    }

    /// The item with this number, without whom it is for.
    pub(super) fn item(&self, seq: u16, runway: &Runway) -> Option<MISSION_ITEM_INT_DATA> {
        let item = self.list().get(usize::from(seq)).copied()?;
        let message = MISSION_ITEM_INT_DATA {
            seq,
            autocontinue: 1,
            frame: MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT,
            ..MISSION_ITEM_INT_DATA::DEFAULT
        };
        Some(match item {
            Item::Speed(speed_mps) => MISSION_ITEM_INT_DATA {
                command: MavCmd::MAV_CMD_DO_CHANGE_SPEED,
                frame: MavFrame::MAV_FRAME_MISSION,
                param2: speed_mps as f32,
                param3: -1.0,
                ..message
            },
            Item::Waypoint(place) => self.write(self.waypoints.get(place)?, runway, message),
        })
    }

    fn write(
        &self,
        waypoint: &Waypoint,
        runway: &Runway,
        mut message: MISSION_ITEM_INT_DATA,
    ) -> MISSION_ITEM_INT_DATA {
        let circle = |message: &mut MISSION_ITEM_INT_DATA, command, amount: f64, radius_m: f64| {
            message.command = command;
            (message.param1, message.param3) = (amount as f32, radius_m as f32);
        };
        match waypoint.step {
            Step::Pass => {
                message.command = MavCmd::MAV_CMD_NAV_WAYPOINT;
                message.param4 = waypoint.heading_rad.to_degrees() as f32;
            }
            Step::Turns { turns, radius_m } => {
                circle(&mut message, MavCmd::MAV_CMD_NAV_LOITER_TURNS, turns, radius_m);
            }
            Step::Time { seconds, radius_m } => {
                circle(&mut message, MavCmd::MAV_CMD_NAV_LOITER_TIME, seconds, radius_m);
            }
            Step::Unlimited { radius_m } => {
                circle(&mut message, MavCmd::MAV_CMD_NAV_LOITER_UNLIM, 0.0, radius_m);
            }
            Step::Altitude { radius_m } => {
                message.command = MavCmd::MAV_CMD_NAV_LOITER_TO_ALT;
                message.param2 = radius_m as f32;
            }
            Step::TakeOff => message.command = MavCmd::MAV_CMD_NAV_TAKEOFF,
            Step::Land => message.command = MavCmd::MAV_CMD_NAV_LAND,
            Step::Return => message.command = MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH,
            Step::Jump { to, times } => {
                message.command = MavCmd::MAV_CMD_DO_JUMP;
                message.param1 = f32::from(self.place_of(u32::from(to)));
                message.param2 = if times == 0 { -1.0 } else { f32::from(times) };
            }
        }
        if waypoint.step.has_place() {
            (message.x, message.y) = runway.units(waypoint.north_m, waypoint.east_m);
        }
        match waypoint.step {
            Step::Jump { .. } | Step::Return => message.frame = MavFrame::MAV_FRAME_MISSION,
            _ => message.z = waypoint.altitude_m as f32,
        }
        message
    }
}

/// What an item says.
pub(super) fn read(m: &MISSION_ITEM_INT_DATA, runway: &Runway) -> Result<Read, Refused> {
    let number = |value: f32| if value.is_finite() { f64::from(value) } else { 0.0 };
    let at = |step: [f64; 3], radius: &'static str, verdict: Verdict| {
        let step = Step::from_numbers(step).ok_or((verdict, radius))?;
        Ok(Read::Entry(Waypoint { step, ..place(m, runway)? }))
    };
    let circle = "turns 0 to 1000, seconds 0 to 86400, radius 10 to 10000 m or 0";
    let first = Verdict::MAV_MISSION_INVALID_PARAM1;
    match m.command {
        MavCmd::MAV_CMD_NAV_WAYPOINT => place(m, runway).map(Read::Entry),
        MavCmd::MAV_CMD_NAV_LOITER_TURNS => at([1.0, number(m.param1), number(m.param3)], circle, first),
        MavCmd::MAV_CMD_NAV_LOITER_TIME => at([2.0, number(m.param1), number(m.param3)], circle, first),
        MavCmd::MAV_CMD_NAV_LOITER_TO_ALT => {
            at([3.0, 0.0, number(m.param2)], circle, Verdict::MAV_MISSION_INVALID_PARAM2)
        }
        MavCmd::MAV_CMD_NAV_LOITER_UNLIM => {
            at([4.0, 0.0, number(m.param3)], circle, Verdict::MAV_MISSION_INVALID_PARAM3)
        }
        MavCmd::MAV_CMD_NAV_TAKEOFF => take_off(m, runway),
        MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH => Ok(Read::Entry(nowhere(Step::Return))),
        MavCmd::MAV_CMD_NAV_LAND => land(m, runway),
        MavCmd::MAV_CMD_DO_JUMP => jump(m),
        // Where the landing of a plan begins: a mark for other autopilots.
        MavCmd::MAV_CMD_DO_LAND_START => Ok(Read::Mark),
        MavCmd::MAV_CMD_DO_CHANGE_SPEED if m.param1 != 0.0 => {
            let text = "only airspeed is flown: give parameter 1 as 0, not ground or climb speed";
            Err((Verdict::MAV_MISSION_INVALID_PARAM1, text))
        }
        MavCmd::MAV_CMD_DO_CHANGE_SPEED => match f64::from(m.param2) {
            speed_mps if Waypoint::AIRSPEEDS_MPS.contains(&speed_mps) => Ok(Read::Speed(speed_mps)),
            _ => Err((Verdict::MAV_MISSION_INVALID_PARAM2, "airspeed between 5 and 100 m/s")),
        },
        _ => Err(COMMAND),
    }
}

/// Straight on, wherever the item lies; its height counts.
fn take_off(m: &MISSION_ITEM_INT_DATA, runway: &Runway) -> Result<Read, Refused> {
    let altitude_m = altitude(m, runway)?;
    if !TAKE_OFF_M.contains(&altitude_m) {
        return Err((Verdict::MAV_MISSION_INVALID_PARAM7, "a take-off ends at 20 to 1000 m"));
    }
    Ok(Read::Entry(Waypoint { altitude_m, ..nowhere(Step::TakeOff) }))
}

fn land(m: &MISSION_ITEM_INT_DATA, runway: &Runway) -> Result<Read, Refused> {
    if altitude(m, runway)?.abs() > LEVEL_M {
        let text = "a landing is on the runway's level: give an altitude of 0 above it";
        return Err((Verdict::MAV_MISSION_INVALID_PARAM7, text));
    }
    // Zeros stand for no place: the runway's origin.
    if (m.x, m.y) == (0, 0) {
        return Ok(Read::Entry(nowhere(Step::Land)));
    }
    let level = MISSION_ITEM_INT_DATA { frame: relative(m.frame), z: 0.0, ..m.clone() };
    Ok(Read::Entry(Waypoint { step: Step::Land, heading_rad: 0.0, ..place(&level, runway)? }))
}

fn jump(m: &MISSION_ITEM_INT_DATA) -> Result<Read, Refused> {
    let times = match m.param2 {
        -1.0 => 0.0,
        times if times >= 1.0 => f64::from(times),
        _ => {
            return Err((
                Verdict::MAV_MISSION_INVALID_PARAM2,
                "a jump is made 1 to 65535 times, or -1: always",
            ));
        }
    };
    let step = Step::from_numbers([8.0, f64::from(m.param1), times]);
    let step = step.ok_or((Verdict::MAV_MISSION_INVALID_PARAM1, "a jump names an item of the list"))?;
    Ok(Read::Entry(nowhere(step)))
}

/// The same frame with heights above the runway.
#[allow(deprecated)] // older ground stations still send these frames
fn relative(frame: MavFrame) -> MavFrame {
    match frame {
        MavFrame::MAV_FRAME_GLOBAL | MavFrame::MAV_FRAME_GLOBAL_INT => {
            MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT
        }
        frame => frame,
    }
}

fn nowhere(step: Step) -> Waypoint {
    Waypoint {
        index: 0,
        count: 0,
        north_m: 0.0,
        east_m: 0.0,
        altitude_m: 0.0,
        heading_rad: 0.0,
        airspeed_mps: USUAL_MPS,
        step,
    }
}

/// m above the runway.
#[allow(deprecated)] // older ground stations still send these frames
fn altitude(m: &MISSION_ITEM_INT_DATA, runway: &Runway) -> Result<f64, Refused> {
    match m.frame {
        MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT | MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT_INT => {
            Ok(f64::from(m.z))
        }
        MavFrame::MAV_FRAME_GLOBAL | MavFrame::MAV_FRAME_GLOBAL_INT => Ok(f64::from(m.z) - runway.altitude_m),
        MavFrame::MAV_FRAME_LOCAL_NED => Ok(-f64::from(m.z)),
        _ => Err(FRAME),
    }
}

/// The place of an item on the map, m north and east of the runway.
pub(super) fn on_map(m: &MISSION_ITEM_INT_DATA, runway: &Runway) -> Result<(f64, f64), Refused> {
    #[allow(deprecated)] // older ground stations still send these frames
    let (north_m, east_m) = match m.frame {
        MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT
        | MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
        | MavFrame::MAV_FRAME_GLOBAL
        | MavFrame::MAV_FRAME_GLOBAL_INT => runway.metres_of_units(m.x, m.y),
        MavFrame::MAV_FRAME_LOCAL_NED => (f64::from(m.x) * 1e-4, f64::from(m.y) * 1e-4),
        _ => return Err(FRAME),
    };
    if north_m.abs() > Waypoint::FARTHEST_M {
        return Err((Verdict::MAV_MISSION_INVALID_PARAM5_X, "more than 50 km from the runway"));
    }
    if east_m.abs() > Waypoint::FARTHEST_M {
        return Err((Verdict::MAV_MISSION_INVALID_PARAM6_Y, "more than 50 km from the runway"));
    }
    Ok((north_m, east_m))
}

/// The way-point in an item, without its place in the list and its speed.
pub(super) fn place(m: &MISSION_ITEM_INT_DATA, runway: &Runway) -> Result<Waypoint, Refused> {
    let ((north_m, east_m), altitude_m) = (on_map(m, runway)?, altitude(m, runway)?);
    if !(0.0..=Waypoint::HIGHEST_M).contains(&altitude_m) {
        return Err((Verdict::MAV_MISSION_INVALID_PARAM7, "altitude between 0 and 10 km"));
    }
    let passed = m.command == MavCmd::MAV_CMD_NAV_WAYPOINT && m.param4.is_finite();
    let heading_rad = if passed { f64::from(m.param4).to_radians() } else { 0.0 };
    Ok(Waypoint { north_m, east_m, altitude_m, heading_rad, ..nowhere(Step::Pass) })
}

/// The list that the items make, and what is wrong with it as a whole.
pub(super) fn list_of(items: &[Read]) -> Result<Vec<Waypoint>, (Verdict, String)> {
    let (mut waypoints, mut airspeed_mps) = (Vec::<Waypoint>::new(), USUAL_MPS);
    // The entry of each item, or the one behind it: what a jump to it leads to.
    let mut entries = Vec::with_capacity(items.len());
    for item in items {
        entries.push(waypoints.len());
        match item {
            Read::Speed(speed_mps) => airspeed_mps = *speed_mps,
            Read::Entry(waypoint) => {
                let (north_m, east_m) = match waypoints.last() {
                    Some(before) if !waypoint.step.has_place() => (before.north_m, before.east_m),
                    _ => (waypoint.north_m, waypoint.east_m),
                };
                waypoints.push(Waypoint { airspeed_mps, north_m, east_m, ..*waypoint });
            }
            Read::Mark => {}
        }
    }
    let count = waypoints.len();
    if !(1..=MOST_WAYPOINTS).contains(&count) {
        let text = format!("mission refused: 1 to {MOST_WAYPOINTS} way-points");
        return Err((Verdict::MAV_MISSION_NO_SPACE, text));
    }
    if let Some((before, after)) = too_near(items) {
        let text = format!(
            "mission refused: items {before} and {after} are nearer than {} m to each other (the track is closed)",
            Waypoint::NEAREST_M
        );
        return Err((Verdict::MAV_MISSION_INVALID, text));
    }
    for (index, waypoint) in waypoints.iter_mut().enumerate() {
        (waypoint.index, waypoint.count) = (index as u8, count as u8); // MOST_WAYPOINTS at most
        if let Step::Jump { to, times } = waypoint.step {
            let entry = entries.get(usize::from(to)).filter(|entry| **entry < count);
            let Some(entry) = entry else {
                let text = format!("mission refused: it jumps to item {to}, and there is none to fly to");
                return Err((Verdict::MAV_MISSION_INVALID_PARAM1, text));
            };
            waypoint.step = Step::Jump { to: *entry as u8, times }; // as above
        }
    }
    Ok(waypoints)
}

/// Two items in a row whose way-points are as good as one; where all are passed, the last and the first among them.
fn too_near(items: &[Read]) -> Option<(usize, usize)> {
    let entries = items.iter().enumerate().filter_map(|(seq, item)| match item {
        Read::Entry(waypoint) => Some((seq, waypoint)),
        _ => None,
    });
    let points: Vec<_> = entries.collect();
    let closed = points.iter().all(|(_, waypoint)| waypoint.step == Step::Pass);
    let legs = if closed { points.len() } else { points.len().saturating_sub(1) };
    let mut legs = points.iter().zip(points.iter().cycle().skip(1)).take(legs).filter(|_| points.len() > 1);
    let both_passed = |from: &Waypoint, to: &Waypoint| from.step == Step::Pass && to.step == Step::Pass;
    legs.find(|((_, from), (_, to))| both_passed(from, to) && from.distance_m(to) < Waypoint::NEAREST_M)
        .map(|((from, _), (to, _))| (*from, *to))
}
