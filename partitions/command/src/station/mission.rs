//! The mission protocol: a ground station's items become the Controller's way-points, and back.
//!
//! An upload is collected whole and checked before the first order goes to the Controller, and acknowledged when the Controller has
//! taken every way-point. Way-points that came over another line are known as well.
//!
//! To the Controller a way-point of a list as long as its own is one that moves, and its mission goes on. An upload of as many as it has
//! is therefore opened with a way-point of a list of another length: then it puts the new one together, and begins it.

use bateleur_mavlink::Runway;
use bateleur_mavlink::common::{
    MISSION_ACK_DATA, MISSION_COUNT_DATA, MISSION_ITEM_INT_DATA, MISSION_REQUEST_INT_DATA, MavCmd, MavFrame,
    MavMessage, MavMissionResult as Verdict, MavMissionType, MavSeverity,
};
use bateleur_messages::ground::{Order, Waypoint};
use bateleur_messages::telemetry::{ACCEPTED, Acknowledge};

use super::{Out, Peer, why};

/// Way-points that the Controller can hold.
pub(crate) const MOST_WAYPOINTS: usize = 32;
/// With a change of speed before each.
const MOST_ITEMS: u16 = 2 * MOST_WAYPOINTS as u16;
/// How long an item or an answer may take, module time, ns; then it is asked for again.
const PATIENCE_NS: u64 = 1_000_000_000;
/// Times that an item or an answer is asked for.
const TRIES: u32 = 5;
/// Way-points that are on their way to the Controller at once: half of what its queue holds.
const ON_THE_WAY: usize = 4;
/// Airspeed before any item has named one, m/s.
const USUAL_MPS: f64 = 22.0;

/// Why an item is refused for its command, or for its frame.
const COMMAND: (Verdict, &str) = (Verdict::MAV_MISSION_UNSUPPORTED, "only way-points and speeds are flown");
const FRAME: (Verdict, &str) = (Verdict::MAV_MISSION_UNSUPPORTED_FRAME, "its frame is not known here");

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
    waypoints: Vec<Waypoint>,
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
        self.list().len() as u16 // MOST_ITEMS at most
    }

    /// The item of a way-point; 0 where it is not known.
    pub(super) fn place_of(&self, waypoint: u32) -> u16 {
        let place = self.list().iter().position(|item| *item == Item::Waypoint(waypoint as usize));
        place.unwrap_or(0) as u16 // MOST_ITEMS at most
    }
}

/// What is going on.
#[derive(Debug)]
enum Transfer {
    None,
    /// Items come in.
    Receiving {
        peer: Peer,
        count: u16,
        items: Vec<(MavCmd, Option<Waypoint>, f64)>,
        until_ns: u64,
        tries: u32,
    },
    /// Way-points go to the Controller.
    Loading {
        peer: Peer,
        waypoints: Vec<Waypoint>,
        /// What has to be taken before these, see the module; whether it was sent.
        opening: Option<(Waypoint, bool)>,
        taken: Vec<bool>,
        sent: usize,
        until_ns: u64,
        tries: u32,
    },
}

/// See the module.
#[derive(Debug)]
pub(super) struct Missions {
    runway: Runway,
    items: Items,
    /// Way-points that the Controller has, as it says.
    told: usize,
    transfer: Transfer,
}

impl Missions {
    pub(super) fn new(runway: Runway) -> Self {
        Self { runway, items: Items::default(), told: 0, transfer: Transfer::None }
    }

    /// The Controller's way-points, as they were known before.
    pub(super) fn resume(&mut self, waypoints: Vec<Waypoint>) {
        self.items.waypoints = waypoints;
    }

    pub(super) fn waypoints(&self) -> &[Waypoint] {
        &self.items.waypoints
    }

    pub(super) fn items(&self) -> &Items {
        &self.items
    }

    /// The Controller has so many way-points.
    pub(super) fn told(&mut self, count: u32) {
        self.told = count as usize;
    }

    /// A way-point went to the Controller, whoever sent it.
    pub(super) fn ordered(&mut self, order: &Order) {
        let Order::Waypoint(waypoint) = order else { return };
        let (index, count) = (usize::from(waypoint.index), usize::from(waypoint.count));
        if matches!(&self.transfer, Transfer::Loading { opening: Some((opening, _)), .. } if opening == waypoint)
        {
            return; // no part of any mission
        }
        let list = &mut self.items.waypoints;
        if list.len() != count {
            list.truncate(count);
        }
        // One that comes out of order is passed over: the list is known when it has come in order.
        if index == list.len() {
            list.push(*waypoint);
        } else if let Some(place) = list.get_mut(index) {
            *place = *waypoint;
        }
    }

    pub(super) fn message(
        &mut self,
        message: &MavMessage,
        system: u8,
        peer: Peer,
        now_ns: u64,
        out: &mut Out,
    ) {
        use MavMessage as M;
        match message {
            M::MISSION_COUNT(m) if m.target_system == system => {
                self.count(m, peer, now_ns, out);
            }
            M::MISSION_ITEM_INT(m) if m.target_system == system => self.item(m, peer, now_ns, out),
            M::MISSION_ITEM(m) if m.target_system == system => {
                let scale = if m.frame == MavFrame::MAV_FRAME_LOCAL_NED { 1e4 } else { 1e7 };
                let item = MISSION_ITEM_INT_DATA {
                    param1: m.param1,
                    param2: m.param2,
                    param3: m.param3,
                    param4: m.param4,
                    x: (f64::from(m.x) * scale).round() as i32,
                    y: (f64::from(m.y) * scale).round() as i32,
                    z: m.z,
                    seq: m.seq,
                    command: m.command,
                    target_system: m.target_system,
                    target_component: m.target_component,
                    frame: m.frame,
                    current: m.current,
                    autocontinue: m.autocontinue,
                    mission_type: m.mission_type,
                };
                self.item(&item, peer, now_ns, out);
            }
            M::MISSION_REQUEST_LIST(m) if m.target_system == system => {
                let count = if is_mission(m.mission_type) { self.items.count() } else { 0 };
                out.say(&M::MISSION_COUNT(MISSION_COUNT_DATA {
                    count,
                    target_system: peer.0,
                    target_component: peer.1,
                    mission_type: m.mission_type,
                    ..MISSION_COUNT_DATA::DEFAULT
                }));
            }
            M::MISSION_REQUEST_INT(m) if m.target_system == system => {
                self.answer(m.seq, m.mission_type, peer, out)
            }
            M::MISSION_REQUEST(m) if m.target_system == system => {
                self.answer(m.seq, m.mission_type, peer, out)
            }
            M::MISSION_CLEAR_ALL(m) if m.target_system == system => match clears_mission(m.mission_type) {
                true => {
                    let text = "way-points are replaced, not cleared";
                    out.text(MavSeverity::MAV_SEVERITY_WARNING, text);
                    verdict(Verdict::MAV_MISSION_DENIED, m.mission_type, peer, out);
                }
                false => verdict(Verdict::MAV_MISSION_ACCEPTED, m.mission_type, peer, out),
            },
            M::MISSION_REQUEST_PARTIAL_LIST(m) if m.target_system == system => {
                verdict(Verdict::MAV_MISSION_UNSUPPORTED, m.mission_type, peer, out);
            }
            M::MISSION_WRITE_PARTIAL_LIST(m) if m.target_system == system => {
                verdict(Verdict::MAV_MISSION_UNSUPPORTED, m.mission_type, peer, out);
            }
            M::MISSION_SET_CURRENT(m) if m.target_system == system => {
                let text = "way-points are flown in their order: none can be chosen";
                out.text(MavSeverity::MAV_SEVERITY_WARNING, text);
                let kind = MavMissionType::MAV_MISSION_TYPE_MISSION;
                verdict(Verdict::MAV_MISSION_UNSUPPORTED, kind, peer, out);
            }
            // The ground station has given up.
            M::MISSION_ACK(m) if m.target_system == system && m.mavtype != Verdict::MAV_MISSION_ACCEPTED => {
                if matches!(&self.transfer, Transfer::Receiving { peer: from, .. } if *from == peer) {
                    self.transfer = Transfer::None;
                }
            }
            _ => {}
        }
    }

    /// The Controller's answer to a way-point.
    pub(super) fn answered(&mut self, answer: &Acknowledge, out: &mut Out) {
        let Transfer::Loading { peer, opening, taken, .. } = &mut self.transfer else { return };
        if answer.letter != b'W' {
            return;
        }
        let peer = *peer;
        if let Some((_, sent)) = opening
            && answer.result == ACCEPTED
        {
            if *sent {
                *opening = None;
            }
            return;
        }
        if answer.result == ACCEPTED {
            taken.iter_mut().skip(usize::from(answer.first)).take(1).for_each(|place| *place = true);
            if taken.iter().all(|taken| *taken) {
                self.transfer = Transfer::None;
                verdict(Verdict::MAV_MISSION_ACCEPTED, MavMissionType::MAV_MISSION_TYPE_MISSION, peer, out);
            }
            return;
        }
        out.text(MavSeverity::MAV_SEVERITY_WARNING, &format!("mission refused: {}", why(answer)));
        self.end(Verdict::MAV_MISSION_DENIED, peer, out);
    }

    pub(super) fn window(&mut self, now_ns: u64, out: &mut Out) {
        match &mut self.transfer {
            Transfer::None => {}
            Transfer::Receiving { peer, items, until_ns, tries, .. } => {
                if now_ns < *until_ns {
                    return;
                }
                (*tries, *until_ns) = (*tries + 1, now_ns + PATIENCE_NS);
                let peer = *peer;
                if *tries >= TRIES {
                    self.end(Verdict::MAV_MISSION_OPERATION_CANCELLED, peer, out);
                } else {
                    request(items.len(), peer, out);
                }
            }
            Transfer::Loading { peer, waypoints, opening, taken, sent, until_ns, tries } => {
                if now_ns >= *until_ns {
                    // Begin again with the first that is missing; one that was taken may be sent twice.
                    (*tries, *until_ns) = (*tries + 1, now_ns + PATIENCE_NS);
                    *sent = taken.iter().position(|taken| !taken).unwrap_or(0);
                    opening.iter_mut().for_each(|(_, sent)| *sent = false);
                }
                let peer = *peer;
                if *tries >= TRIES {
                    out.text(MavSeverity::MAV_SEVERITY_WARNING, "mission: the Controller does not answer");
                    return self.end(Verdict::MAV_MISSION_ERROR, peer, out);
                }
                if let Some((waypoint, sent)) = opening {
                    if !std::mem::replace(sent, true) {
                        out.orders.push(Order::Waypoint(*waypoint));
                    }
                    return;
                }
                let on_the_way = taken[..*sent].iter().filter(|taken| !**taken).count();
                for waypoint in waypoints[*sent..].iter().take(ON_THE_WAY.saturating_sub(on_the_way)) {
                    out.orders.push(Order::Waypoint(*waypoint));
                    *sent += 1;
                    *until_ns = now_ns + PATIENCE_NS;
                }
            }
        }
    }

    fn end(&mut self, result: Verdict, peer: Peer, out: &mut Out) {
        self.transfer = Transfer::None;
        verdict(result, MavMissionType::MAV_MISSION_TYPE_MISSION, peer, out);
    }

    fn count(&mut self, m: &MISSION_COUNT_DATA, peer: Peer, now_ns: u64, out: &mut Out) {
        if !is_mission(m.mission_type) {
            // Fences and rally points: none are flown, so none can be had but none.
            let result = match m.count {
                0 => Verdict::MAV_MISSION_ACCEPTED,
                _ => Verdict::MAV_MISSION_UNSUPPORTED,
            };
            return verdict(result, m.mission_type, peer, out);
        }
        if !matches!(self.transfer, Transfer::None)
            && !matches!(&self.transfer, Transfer::Receiving { peer: from, .. } if *from == peer)
        {
            return verdict(Verdict::MAV_MISSION_DENIED, m.mission_type, peer, out);
        }
        match m.count {
            0 => {
                out.text(MavSeverity::MAV_SEVERITY_WARNING, "way-points are replaced, not cleared");
                self.end(Verdict::MAV_MISSION_DENIED, peer, out);
            }
            1..=MOST_ITEMS => {
                let until_ns = now_ns + PATIENCE_NS;
                self.transfer =
                    Transfer::Receiving { peer, count: m.count, items: Vec::new(), until_ns, tries: 0 };
                request(0, peer, out);
            }
            _ => {
                let text = format!("mission refused: {MOST_WAYPOINTS} way-points at most");
                out.text(MavSeverity::MAV_SEVERITY_WARNING, &text);
                self.end(Verdict::MAV_MISSION_NO_SPACE, peer, out);
            }
        }
    }

    /// Whether item `seq` is the one that `peer` was asked for last. One that came twice is passed over: the right one is on its
    /// way, or is asked for again.
    fn awaits(&self, seq: u16, peer: Peer) -> bool {
        matches!(&self.transfer, Transfer::Receiving { peer: from, items, .. }
            if *from == peer && items.len() == usize::from(seq))
    }

    /// An item whose command or frame the dialect does not know.
    pub(super) fn foreign(&mut self, seq: u16, by_frame: bool, peer: Peer, out: &mut Out) {
        if self.awaits(seq, peer) {
            self.refuse(seq, if by_frame { FRAME } else { COMMAND }, peer, out);
        }
    }

    fn refuse(&mut self, seq: u16, (result, reason): (Verdict, &str), peer: Peer, out: &mut Out) {
        out.text(MavSeverity::MAV_SEVERITY_WARNING, &format!("item {seq}: {reason}"));
        self.end(result, peer, out);
    }

    fn item(&mut self, m: &MISSION_ITEM_INT_DATA, peer: Peer, now_ns: u64, out: &mut Out) {
        let runway = self.runway;
        if !self.awaits(m.seq, peer) {
            return;
        }
        let Transfer::Receiving { count, items, until_ns, tries, .. } = &mut self.transfer else { return };
        let read = match m.command {
            MavCmd::MAV_CMD_NAV_WAYPOINT => waypoint(m, &runway).map(|waypoint| (Some(waypoint), 0.0)),
            MavCmd::MAV_CMD_DO_CHANGE_SPEED if m.param1 != 0.0 => {
                let text = "only airspeed is flown: give parameter 1 as 0, not ground or climb speed";
                Err((Verdict::MAV_MISSION_INVALID_PARAM1, text))
            }
            MavCmd::MAV_CMD_DO_CHANGE_SPEED => match f64::from(m.param2) {
                speed_mps if Waypoint::AIRSPEEDS_MPS.contains(&speed_mps) => Ok((None, speed_mps)),
                _ => Err((Verdict::MAV_MISSION_INVALID_PARAM2, "airspeed between 5 and 100 m/s")),
            },
            _ => Err(COMMAND),
        };
        match read {
            Err(why) => self.refuse(m.seq, why, peer, out),
            Ok((place, speed_mps)) => {
                items.push((m.command, place, speed_mps));
                (*until_ns, *tries) = (now_ns + PATIENCE_NS, 0);
                if items.len() < usize::from(*count) {
                    return request(items.len(), peer, out);
                }
                let waypoints = waypoints_of(items);
                if waypoints.is_empty() || waypoints.len() > MOST_WAYPOINTS {
                    let text = format!("mission refused: 1 to {MOST_WAYPOINTS} way-points");
                    out.text(MavSeverity::MAV_SEVERITY_WARNING, &text);
                    return self.end(Verdict::MAV_MISSION_NO_SPACE, peer, out);
                }
                if let Some((before, after)) = too_near(items) {
                    let text = format!(
                        "mission refused: items {before} and {after} are nearer than {} m to each \
                         other (the track is closed)",
                        Waypoint::NEAREST_M
                    );
                    out.text(MavSeverity::MAV_SEVERITY_WARNING, &text);
                    return self.end(Verdict::MAV_MISSION_INVALID, peer, out);
                }
                let opening = self.opening(&waypoints).map(|waypoint| (waypoint, false));
                let taken = vec![false; waypoints.len()];
                let until_ns = now_ns + PATIENCE_NS;
                self.transfer =
                    Transfer::Loading { peer, waypoints, opening, taken, sent: 0, until_ns, tries: 0 };
            }
        }
    }

    /// What these way-points must be opened with, see the module: nothing, unless the Controller may have as many.
    fn opening(&self, waypoints: &[Waypoint]) -> Option<Waypoint> {
        let taken = [waypoints.len(), self.items.waypoints.len(), self.told];
        if !taken[1..].contains(&waypoints.len()) {
            return None;
        }
        // Two at least: one that is whole with its first way-point would be flown.
        let count = (2..=MOST_WAYPOINTS).find(|count| !taken.contains(count))?;
        Some(Waypoint { index: 0, count: count as u8, ..*waypoints.first()? }) // MOST_WAYPOINTS at most
    }

    fn answer(&self, seq: u16, kind: MavMissionType, peer: Peer, out: &mut Out) {
        let item = self.items.list().get(usize::from(seq)).copied().filter(|_| is_mission(kind));
        let Some(item) = item else {
            return verdict(Verdict::MAV_MISSION_INVALID_SEQUENCE, kind, peer, out);
        };
        let mut message = MISSION_ITEM_INT_DATA {
            seq,
            target_system: peer.0,
            target_component: peer.1,
            autocontinue: 1,
            frame: MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT,
            ..MISSION_ITEM_INT_DATA::DEFAULT
        };
        match item {
            Item::Speed(speed_mps) => {
                message.command = MavCmd::MAV_CMD_DO_CHANGE_SPEED;
                message.frame = MavFrame::MAV_FRAME_MISSION;
                (message.param2, message.param3) = (speed_mps as f32, -1.0);
            }
            Item::Waypoint(place) => {
                let waypoint = &self.items.waypoints[place];
                message.command = MavCmd::MAV_CMD_NAV_WAYPOINT;
                (message.x, message.y) = self.runway.units(waypoint.north_m, waypoint.east_m);
                message.z = waypoint.altitude_m as f32;
                message.param4 = waypoint.heading_rad.to_degrees() as f32;
            }
        }
        out.say(&MavMessage::MISSION_ITEM_INT(message));
    }
}

fn is_mission(kind: MavMissionType) -> bool {
    kind == MavMissionType::MAV_MISSION_TYPE_MISSION
}

fn clears_mission(kind: MavMissionType) -> bool {
    is_mission(kind) || kind == MavMissionType::MAV_MISSION_TYPE_ALL
}

/// Two items in a row, the last and the first among them, whose way-points are as good as one.
fn too_near(items: &[(MavCmd, Option<Waypoint>, f64)]) -> Option<(usize, usize)> {
    let places = items.iter().enumerate().filter_map(|(seq, (_, place, _))| Some((seq, (*place)?)));
    let points: Vec<_> = places.collect();
    let next = points.iter().cycle().skip(1);
    let mut legs = points.iter().zip(next).filter(|_| points.len() > 1);
    legs.find(|((_, from), (_, to))| from.distance_m(to) < Waypoint::NEAREST_M)
        .map(|((from, _), (to, _))| (*from, *to))
}

fn request(seq: usize, peer: Peer, out: &mut Out) {
    out.say(&MavMessage::MISSION_REQUEST_INT(MISSION_REQUEST_INT_DATA {
        seq: seq as u16, // MOST_ITEMS at most
        target_system: peer.0,
        target_component: peer.1,
        mission_type: MavMissionType::MAV_MISSION_TYPE_MISSION,
    }));
}

fn verdict(result: Verdict, mission_type: MavMissionType, peer: Peer, out: &mut Out) {
    out.say(&MavMessage::MISSION_ACK(MISSION_ACK_DATA {
        target_system: peer.0,
        target_component: peer.1,
        mavtype: result,
        mission_type,
        ..MISSION_ACK_DATA::DEFAULT
    }));
}

/// The way-point in an item, without its place in the list and its speed.
fn waypoint(m: &MISSION_ITEM_INT_DATA, runway: &Runway) -> Result<Waypoint, (Verdict, &'static str)> {
    #[allow(deprecated)] // older ground stations still send these frames
    let (north_m, east_m, altitude_m) = match m.frame {
        MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT | MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT_INT => {
            let (north_m, east_m) = runway.metres_of_units(m.x, m.y);
            (north_m, east_m, f64::from(m.z))
        }
        MavFrame::MAV_FRAME_GLOBAL | MavFrame::MAV_FRAME_GLOBAL_INT => {
            let (north_m, east_m) = runway.metres_of_units(m.x, m.y);
            (north_m, east_m, f64::from(m.z) - runway.altitude_m)
        }
        MavFrame::MAV_FRAME_LOCAL_NED => (f64::from(m.x) * 1e-4, f64::from(m.y) * 1e-4, -f64::from(m.z)),
        _ => return Err(FRAME),
    };
    if north_m.abs() > Waypoint::FARTHEST_M {
        return Err((Verdict::MAV_MISSION_INVALID_PARAM5_X, "more than 50 km from the runway"));
    }
    if east_m.abs() > Waypoint::FARTHEST_M {
        return Err((Verdict::MAV_MISSION_INVALID_PARAM6_Y, "more than 50 km from the runway"));
    }
    if !(0.0..=Waypoint::HIGHEST_M).contains(&altitude_m) {
        return Err((Verdict::MAV_MISSION_INVALID_PARAM7, "altitude between 0 and 10 km"));
    }
    let heading_rad = if m.param4.is_finite() { f64::from(m.param4).to_radians() } else { 0.0 };
    Ok(Waypoint { index: 0, count: 0, north_m, east_m, altitude_m, heading_rad, airspeed_mps: USUAL_MPS })
}

fn waypoints_of(items: &[(MavCmd, Option<Waypoint>, f64)]) -> Vec<Waypoint> {
    let (mut waypoints, mut airspeed_mps) = (Vec::new(), USUAL_MPS);
    for (_, place, speed_mps) in items {
        match place {
            None => airspeed_mps = *speed_mps,
            Some(waypoint) => waypoints.push(Waypoint { airspeed_mps, ..*waypoint }),
        }
    }
    let count = waypoints.len().min(usize::from(u8::MAX)) as u8;
    for (index, waypoint) in waypoints.iter_mut().enumerate() {
        (waypoint.index, waypoint.count) = (index.min(usize::from(u8::MAX)) as u8, count);
    }
    waypoints
}
