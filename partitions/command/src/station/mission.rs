//! The mission protocol: a ground station's items become the Controller's way-points, and back.
//!
//! An upload is collected whole and checked before the first order goes to the Controller, and acknowledged when the Controller has
//! taken every way-point. Way-points that came over another line are known as well.
//!
//! To the Controller a way-point of a list as long as its own is one that moves, and its mission goes on. An upload of as many as it has
//! is therefore opened with a way-point of a list of another length: then it puts the new one together, and begins it.

use bateleur_mavlink::Runway;
use bateleur_mavlink::common::{
    MISSION_ACK_DATA, MISSION_COUNT_DATA, MISSION_ITEM_INT_DATA, MISSION_REQUEST_INT_DATA, MavFrame,
    MavMessage, MavMissionResult as Verdict, MavMissionType, MavSeverity,
};
use bateleur_messages::ground::{Order, Waypoint};
use bateleur_messages::mark::{MOST_MARKS, Mark};
use bateleur_messages::telemetry::{ACCEPTED, Acknowledge};

use super::items::{self, COMMAND, FRAME, Items, Read, Refused};
use super::marks::{self, Marks};
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
/// What has come in of a list.
#[derive(Debug)]
enum Received {
    Mission(Vec<Read>),
    Marks(Vec<Mark>),
}

impl Received {
    fn len(&self) -> usize {
        match self {
            Self::Mission(items) => items.len(),
            Self::Marks(marks) => marks.len(),
        }
    }
}

/// What is going on.
#[derive(Debug)]
enum Transfer {
    None,
    /// Items come in.
    Receiving {
        kind: MavMissionType,
        peer: Peer,
        count: u16,
        items: Received,
        until_ns: u64,
        tries: u32,
    },
    /// They go to the Controller.
    Loading {
        kind: MavMissionType,
        peer: Peer,
        orders: Vec<Order>,
        /// What has to be taken before these, see the module; whether it was sent.
        opening: Option<(Order, bool)>,
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
    marks: Marks,
    /// Way-points that the Controller has, as it says.
    told: usize,
    transfer: Transfer,
}

impl Missions {
    pub(super) fn new(runway: Runway) -> Self {
        Self { runway, items: Items::default(), marks: Marks::default(), told: 0, transfer: Transfer::None }
    }

    /// The Controller's way-points, as they were known before.
    pub(super) fn resume(&mut self, waypoints: Vec<Waypoint>) {
        self.items.waypoints = waypoints;
    }

    /// The Controller's fence and rally points, as they were known before.
    pub(super) fn resume_marks(&mut self, marks: Vec<Mark>) {
        self.marks = Marks::of(marks);
    }

    /// All of them, as far as they are known.
    pub(super) fn marks(&self) -> impl Iterator<Item = &Mark> {
        self.marks.all()
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
        let waypoint = match order {
            Order::Waypoint(waypoint) => waypoint,
            Order::Fence(mark) | Order::Rally(mark) => return self.marks.ordered(mark),
            _ => return,
        };
        let (index, count) = (usize::from(waypoint.index), usize::from(waypoint.count));
        if matches!(&self.transfer, Transfer::Loading { opening: Some((opening, _)), .. } if opening == order)
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
                let count = match m.mission_type {
                    kind if is_mission(kind) => self.items.count(),
                    kind => self.marks.list(kind).len() as u16, // MOST_MARKS at most
                };
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
                false => self.clear_marks(m.mission_type, peer, now_ns, out),
            },
            M::MISSION_REQUEST_PARTIAL_LIST(m) if m.target_system == system => {
                verdict(Verdict::MAV_MISSION_UNSUPPORTED, m.mission_type, peer, out);
            }
            M::MISSION_WRITE_PARTIAL_LIST(m) if m.target_system == system => {
                verdict(Verdict::MAV_MISSION_UNSUPPORTED, m.mission_type, peer, out);
            }
            M::MISSION_SET_CURRENT(m) if m.target_system == system => match self.items.waypoint_at(m.seq) {
                // MISSION_CURRENT says whether it is flown to.
                Some(index) => out.orders.push(Order::GoOnWith { index }),
                None => {
                    out.text(MavSeverity::MAV_SEVERITY_WARNING, "the mission has no such item");
                    let kind = MavMissionType::MAV_MISSION_TYPE_MISSION;
                    verdict(Verdict::MAV_MISSION_INVALID_SEQUENCE, kind, peer, out);
                }
            },
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
        if answer.letter == b'J' && answer.result != ACCEPTED {
            return out.text(MavSeverity::MAV_SEVERITY_WARNING, &format!("refused: {}", why(answer)));
        }
        let Transfer::Loading { kind, peer, orders, opening, taken, .. } = &mut self.transfer else { return };
        if orders.first().is_none_or(|order| answer.letter != order.letter()) {
            return;
        }
        let (kind, peer) = (*kind, *peer);
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
                verdict(Verdict::MAV_MISSION_ACCEPTED, kind, peer, out);
            }
            return;
        }
        out.text(MavSeverity::MAV_SEVERITY_WARNING, &format!("{} refused: {}", name(kind), why(answer)));
        self.end(Verdict::MAV_MISSION_DENIED, kind, peer, out);
    }

    pub(super) fn window(&mut self, now_ns: u64, out: &mut Out) {
        match &mut self.transfer {
            Transfer::None => {}
            Transfer::Receiving { kind, peer, items, until_ns, tries, .. } => {
                if now_ns < *until_ns {
                    return;
                }
                (*tries, *until_ns) = (*tries + 1, now_ns + PATIENCE_NS);
                let (kind, peer) = (*kind, *peer);
                if *tries >= TRIES {
                    self.end(Verdict::MAV_MISSION_OPERATION_CANCELLED, kind, peer, out);
                } else {
                    request(items.len(), kind, peer, out);
                }
            }
            Transfer::Loading { kind, peer, orders, opening, taken, sent, until_ns, tries } => {
                if now_ns >= *until_ns {
                    // Begin again with the first that is missing; one that was taken may be sent twice.
                    (*tries, *until_ns) = (*tries + 1, now_ns + PATIENCE_NS);
                    *sent = taken.iter().position(|taken| !taken).unwrap_or(0);
                    opening.iter_mut().for_each(|(_, sent)| *sent = false);
                }
                let (kind, peer) = (*kind, *peer);
                if *tries >= TRIES {
                    let text = format!("{}: the Controller does not answer", name(kind));
                    out.text(MavSeverity::MAV_SEVERITY_WARNING, &text);
                    return self.end(Verdict::MAV_MISSION_ERROR, kind, peer, out);
                }
                if let Some((order, sent)) = opening {
                    if !std::mem::replace(sent, true) {
                        out.orders.push(*order);
                    }
                    return;
                }
                let on_the_way = taken[..*sent].iter().filter(|taken| !**taken).count();
                for order in orders[*sent..].iter().take(ON_THE_WAY.saturating_sub(on_the_way)) {
                    out.orders.push(*order);
                    *sent += 1;
                    *until_ns = now_ns + PATIENCE_NS;
                }
            }
        }
    }

    fn end(&mut self, result: Verdict, kind: MavMissionType, peer: Peer, out: &mut Out) {
        self.transfer = Transfer::None;
        verdict(result, kind, peer, out);
    }

    /// Hands a list that is whole to the Controller.
    fn load(&mut self, kind: MavMissionType, peer: Peer, orders: Vec<Order>, now_ns: u64) {
        let opening = self.opening(&orders).map(|order| (order, false));
        let (taken, until_ns) = (vec![false; orders.len()], now_ns + PATIENCE_NS);
        self.transfer = Transfer::Loading { kind, peer, orders, opening, taken, sent: 0, until_ns, tries: 0 };
    }

    /// A fence without areas, or no rally points.
    fn clear_marks(&mut self, kind: MavMissionType, peer: Peer, now_ns: u64, out: &mut Out) {
        let Some(none) = marks::none(kind, list_number(now_ns)) else {
            return verdict(Verdict::MAV_MISSION_UNSUPPORTED, kind, peer, out);
        };
        if matches!(self.transfer, Transfer::None) {
            self.load(kind, peer, vec![none], now_ns);
        } else {
            verdict(Verdict::MAV_MISSION_DENIED, kind, peer, out);
        }
    }

    fn count(&mut self, m: &MISSION_COUNT_DATA, peer: Peer, now_ns: u64, out: &mut Out) {
        let kind = m.mission_type;
        if !is_mission(kind) && !marks::is_marks(kind) {
            return verdict(Verdict::MAV_MISSION_UNSUPPORTED, kind, peer, out);
        }
        if !matches!(self.transfer, Transfer::None)
            && !matches!(&self.transfer, Transfer::Receiving { peer: from, .. } if *from == peer)
        {
            return verdict(Verdict::MAV_MISSION_DENIED, m.mission_type, peer, out);
        }
        let most = if is_mission(kind) { MOST_ITEMS } else { MOST_MARKS as u16 };
        match m.count {
            0 if is_mission(kind) => {
                out.text(MavSeverity::MAV_SEVERITY_WARNING, "way-points are replaced, not cleared");
                self.end(Verdict::MAV_MISSION_DENIED, kind, peer, out);
            }
            0 => {
                self.transfer = Transfer::None;
                self.clear_marks(kind, peer, now_ns, out);
            }
            count if count <= most => {
                let items = match is_mission(kind) {
                    true => Received::Mission(Vec::new()),
                    false => Received::Marks(Vec::new()),
                };
                let until_ns = now_ns + PATIENCE_NS;
                self.transfer = Transfer::Receiving { kind, peer, count, items, until_ns, tries: 0 };
                request(0, kind, peer, out);
            }
            _ => {
                let text = match is_mission(kind) {
                    true => format!("mission refused: {MOST_WAYPOINTS} way-points at most"),
                    false => format!("{} refused: {MOST_MARKS} items at most", name(kind)),
                };
                out.text(MavSeverity::MAV_SEVERITY_WARNING, &text);
                self.end(Verdict::MAV_MISSION_NO_SPACE, kind, peer, out);
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

    fn refuse(&mut self, seq: u16, (result, reason): Refused, peer: Peer, out: &mut Out) {
        let Transfer::Receiving { kind, .. } = self.transfer else { return };
        out.text(MavSeverity::MAV_SEVERITY_WARNING, &format!("item {seq}: {reason}"));
        self.end(result, kind, peer, out);
    }

    fn item(&mut self, m: &MISSION_ITEM_INT_DATA, peer: Peer, now_ns: u64, out: &mut Out) {
        let runway = self.runway;
        if !self.awaits(m.seq, peer) {
            return;
        }
        let Transfer::Receiving { kind, count, items, until_ns, tries, .. } = &mut self.transfer else {
            return;
        };
        // An older message has no list's name: it is one of a mission.
        if m.mission_type != *kind {
            return;
        }
        let taken = match items {
            Received::Mission(items) => items::read(m, &runway).map(|item| items.push(item)),
            Received::Marks(marks) => marks::read(m, &runway).map(|mark| marks.push(mark)),
        };
        if let Err(why) = taken {
            return self.refuse(m.seq, why, peer, out);
        }
        (*until_ns, *tries) = (now_ns + PATIENCE_NS, 0);
        let (kind, got) = (*kind, items.len());
        if got < usize::from(*count) {
            return request(got, kind, peer, out);
        }
        let orders = match items {
            Received::Mission(items) => {
                items::list_of(items).map(|list| list.into_iter().map(Order::Waypoint).collect())
            }
            Received::Marks(marks) => Ok(marks::orders(marks, kind, list_number(now_ns))),
        };
        match orders {
            Ok(orders) => self.load(kind, peer, orders, now_ns),
            Err((result, text)) => {
                out.text(MavSeverity::MAV_SEVERITY_WARNING, &text);
                self.end(result, kind, peer, out);
            }
        }
    }

    /// What these way-points must be opened with, see the module: nothing, unless the Controller may have as many.
    fn opening(&self, orders: &[Order]) -> Option<Order> {
        let Some(Order::Waypoint(first)) = orders.first() else { return None };
        let taken = [orders.len(), self.items.waypoints.len(), self.told];
        if !taken[1..].contains(&orders.len()) {
            return None;
        }
        // Two at least: one that is whole with its first way-point would be flown.
        let count = (2..=MOST_WAYPOINTS).find(|count| !taken.contains(count))?;
        Some(Order::Waypoint(Waypoint { index: 0, count: count as u8, ..*first })) // MOST_WAYPOINTS at most
    }

    fn answer(&self, seq: u16, kind: MavMissionType, peer: Peer, out: &mut Out) {
        let item = match is_mission(kind) {
            true => self.items.item(seq, &self.runway),
            false => self.marks.item(seq, kind, &self.runway),
        };
        let Some(item) = item else {
            return verdict(Verdict::MAV_MISSION_INVALID_SEQUENCE, kind, peer, out);
        };
        out.say(&MavMessage::MISSION_ITEM_INT(MISSION_ITEM_INT_DATA {
            target_system: peer.0,
            target_component: peer.1,
            mission_type: kind,
            ..item
        }));
    }
}

fn is_mission(kind: MavMissionType) -> bool {
    kind == MavMissionType::MAV_MISSION_TYPE_MISSION
}

fn clears_mission(kind: MavMissionType) -> bool {
    is_mission(kind) || kind == MavMissionType::MAV_MISSION_TYPE_ALL
}

/// For a person.
fn name(kind: MavMissionType) -> &'static str {
    match kind {
        MavMissionType::MAV_MISSION_TYPE_FENCE => "fence",
        MavMissionType::MAV_MISSION_TYPE_RALLY => "rally points",
        _ => "mission",
    }
}

/// Another number for each list: a hundredth of a second tells two uploads apart.
fn list_number(now_ns: u64) -> u8 {
    (now_ns / 10_000_000) as u8
}

fn request(seq: usize, mission_type: MavMissionType, peer: Peer, out: &mut Out) {
    out.say(&MavMessage::MISSION_REQUEST_INT(MISSION_REQUEST_INT_DATA {
        seq: seq as u16, // MOST_ITEMS at most
        target_system: peer.0,
        target_component: peer.1,
        mission_type,
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
