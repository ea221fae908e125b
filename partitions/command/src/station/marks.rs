//! The items of a fence and of rally points, and the Controller's marks.

use bateleur_mavlink::Runway;
use bateleur_mavlink::common::{
    MISSION_ITEM_INT_DATA, MavCmd, MavFrame, MavMissionResult as Verdict, MavMissionType,
};
use bateleur_messages::ground::{Order, Waypoint};
use bateleur_messages::mark::{MOST_MARKS, Mark, MarkKind};

use super::items::{COMMAND, Refused, on_map, place};

/// What went to the Controller, for a ground station that downloads it.
#[derive(Debug, Clone, Default)]
pub(super) struct Marks {
    fence: Vec<Mark>,
    rally: Vec<Mark>,
}

impl Marks {
    /// As they were known before.
    pub(super) fn of(marks: Vec<Mark>) -> Self {
        let (rally, fence) = marks.into_iter().partition(|mark| mark.kind == MarkKind::Rally);
        Self { fence, rally }
    }

    /// Both lists.
    pub(super) fn all(&self) -> impl Iterator<Item = &Mark> {
        self.fence.iter().chain(&self.rally)
    }

    /// One list; nothing for what is none of them.
    pub(super) fn list(&self, kind: MavMissionType) -> &[Mark] {
        match kind {
            MavMissionType::MAV_MISSION_TYPE_FENCE => &self.fence,
            MavMissionType::MAV_MISSION_TYPE_RALLY => &self.rally,
            _ => &[],
        }
    }

    /// A mark went to the Controller, whoever sent it.
    pub(super) fn ordered(&mut self, mark: &Mark) {
        let list = if mark.kind == MarkKind::Rally { &mut self.rally } else { &mut self.fence };
        if list.first().is_some_and(|first| (first.list, first.count) != (mark.list, mark.count)) {
            list.clear();
        }
        let index = usize::from(mark.index);
        // As with way-points: the list is known when it has come in order.
        if mark.count > 0 && index == list.len() && index < MOST_MARKS {
            list.push(*mark);
        } else if let Some(place) = list.get_mut(index) {
            *place = *mark;
        }
    }

    /// The item with this number, without whom it is for.
    pub(super) fn item(
        &self,
        seq: u16,
        kind: MavMissionType,
        runway: &Runway,
    ) -> Option<MISSION_ITEM_INT_DATA> {
        let mark = self.list(kind).get(usize::from(seq))?;
        let (x, y) = runway.units(mark.north_m, mark.east_m);
        let rally = mark.kind == MarkKind::Rally;
        Some(MISSION_ITEM_INT_DATA {
            seq,
            x,
            y,
            autocontinue: 1,
            frame: if rally { MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT } else { MavFrame::MAV_FRAME_GLOBAL },
            command: match mark.kind {
                MarkKind::Rally => MavCmd::MAV_CMD_NAV_RALLY_POINT,
                MarkKind::InclusionCorner => MavCmd::MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
                MarkKind::ExclusionCorner => MavCmd::MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
                MarkKind::InclusionCircle => MavCmd::MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION,
                MarkKind::ExclusionCircle => MavCmd::MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION,
            },
            param1: if rally { 0.0 } else { mark.size as f32 },
            z: if rally { mark.size as f32 } else { 0.0 },
            ..MISSION_ITEM_INT_DATA::DEFAULT
        })
    }
}

/// Whether a list of this kind is one of marks.
pub(super) fn is_marks(kind: MavMissionType) -> bool {
    matches!(kind, MavMissionType::MAV_MISSION_TYPE_FENCE | MavMissionType::MAV_MISSION_TYPE_RALLY)
}

/// That a list is empty; `None` where it is none of marks.
pub(super) fn none(kind: MavMissionType, list: u8) -> Option<Order> {
    match kind {
        MavMissionType::MAV_MISSION_TYPE_FENCE => {
            Some(Order::Fence(Mark::none(list, MarkKind::InclusionCorner)))
        }
        MavMissionType::MAV_MISSION_TYPE_RALLY => Some(Order::Rally(Mark::none(list, MarkKind::Rally))),
        _ => None,
    }
}

/// The orders that bring a list to the Controller.
pub(super) fn orders(marks: &[Mark], kind: MavMissionType, list: u8) -> Vec<Order> {
    let count = marks.len() as u8; // MOST_MARKS at most
    let order = |(index, mark): (u8, &Mark)| {
        let mark = Mark { index, count, list, ..*mark };
        if kind == MavMissionType::MAV_MISSION_TYPE_RALLY { Order::Rally(mark) } else { Order::Fence(mark) }
    };
    (0..count).zip(marks).map(order).collect()
}

/// What an item says, without its place in the list.
pub(super) fn read(m: &MISSION_ITEM_INT_DATA, runway: &Runway) -> Result<Mark, Refused> {
    let rally = m.mission_type == MavMissionType::MAV_MISSION_TYPE_RALLY;
    let kind = match m.command {
        MavCmd::MAV_CMD_NAV_RALLY_POINT if rally => {
            let Waypoint { north_m, east_m, altitude_m, .. } = place(m, runway)?;
            return Ok(Mark { north_m, east_m, size: altitude_m, ..Mark::none(0, MarkKind::Rally) });
        }
        MavCmd::MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION if !rally => MarkKind::InclusionCorner,
        MavCmd::MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION if !rally => MarkKind::ExclusionCorner,
        MavCmd::MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION if !rally => MarkKind::InclusionCircle,
        MavCmd::MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION if !rally => MarkKind::ExclusionCircle,
        MavCmd::MAV_CMD_NAV_FENCE_RETURN_POINT if !rally => {
            return Err((
                Verdict::MAV_MISSION_UNSUPPORTED,
                "a fence has no point to return to: set a rally point",
            ));
        }
        _ => return Err(COMMAND),
    };
    let ((north_m, east_m), size) = (on_map(m, runway)?, f64::from(m.param1));
    let sane = match kind.is_corner() {
        true => size.fract() == 0.0 && (3.0..=MOST_MARKS as f64).contains(&size),
        false => (1.0..=Waypoint::FARTHEST_M).contains(&size),
    };
    if !sane {
        let text = "a polygon has 3 to 32 corners, a circle a radius of 1 to 50000 m";
        return Err((Verdict::MAV_MISSION_INVALID_PARAM1, text));
    }
    Ok(Mark { north_m, east_m, size, ..Mark::none(0, kind) })
}
