//! The parameter protocol, for the values that Command itself has. What a ground station asks of them stands at each; a change is refused with its reason, and the
//! value that stands is told.

use bateleur_mavlink::common::{
    MavMessage, MavParamError, MavParamType, MavSeverity, PARAM_ERROR_DATA, PARAM_REQUEST_READ_DATA,
    PARAM_SET_DATA, PARAM_VALUE_DATA,
};

use super::streams::Rates;
use super::{Out, Peer, Setup};

/// Parameters told in one window, most: a whole list must not push telemetry out of the line.
const A_WINDOW: usize = 2;

/// One parameter.
#[derive(Debug, Clone)]
struct Parameter {
    name: &'static str,
    value: f32,
    /// What it may be set to; none: it belongs to the plan.
    range: Option<std::ops::RangeInclusive<f32>>,
}

/// See the module.
#[derive(Debug)]
pub(super) struct Parameters {
    all: Vec<Parameter>,
    /// Those that are still to be told of a list.
    telling: std::ops::Range<usize>,
}

impl Parameters {
    pub(super) fn new(setup: &Setup) -> Self {
        let fixed = |name, value: f64| Parameter { name, value: value as f32, range: None };
        let rate = |name, value| Parameter { name, value, range: Some(0.0..=50.0) };
        Self {
            all: vec![
                fixed("SYS_ID", f64::from(setup.system)),
                rate("RATE_ATTITUDE", 10.0),
                rate("RATE_POSITION", 5.0),
                rate("RATE_HUD", 5.0),
                fixed("RUNWAY_LAT", setup.runway.latitude_deg),
                fixed("RUNWAY_LON", setup.runway.longitude_deg),
                fixed("RUNWAY_ALT", setup.runway.altitude_m),
            ],
            telling: 0..0,
        }
    }

    pub(super) fn rates(&self) -> Rates {
        let hz = |name| self.all.iter().find(|one| one.name == name).map_or(0.0, |one| f64::from(one.value));
        Rates { attitude_hz: hz("RATE_ATTITUDE"), position_hz: hz("RATE_POSITION"), hud_hz: hz("RATE_HUD") }
    }

    pub(super) fn list(&mut self) {
        self.telling = 0..self.all.len();
    }

    pub(super) fn window(&mut self, out: &mut Out) {
        for _ in 0..A_WINDOW {
            let Some(place) = self.telling.next() else { return };
            self.tell(place, out);
        }
    }

    pub(super) fn read(&mut self, message: &PARAM_REQUEST_READ_DATA, peer: Peer, out: &mut Out) {
        let place = match usize::try_from(message.param_index) {
            Ok(place) => Some(place).filter(|place| *place < self.all.len()),
            Err(_) => self.place(&message.param_id),
        };
        match place {
            Some(place) => self.tell(place, out),
            None => refuse(&message.param_id, MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST, peer, out),
        }
    }

    pub(super) fn set(&mut self, message: &PARAM_SET_DATA, peer: Peer, out: &mut Out) {
        let Some(place) = self.place(&message.param_id) else {
            return refuse(&message.param_id, MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST, peer, out);
        };
        let parameter = &mut self.all[place];
        let error = match &parameter.range {
            None => Some((
                MavParamError::MAV_PARAM_ERROR_READ_ONLY,
                format!("{} belongs to the schedule file", parameter.name),
            )),
            // What is not a number is in no range.
            Some(range) if !range.contains(&message.param_value) => Some((
                MavParamError::MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE,
                format!("{}: {} to {}", parameter.name, range.start(), range.end()),
            )),
            Some(_) => {
                parameter.value = message.param_value;
                None
            }
        };
        if let Some((error, text)) = error {
            out.text(MavSeverity::MAV_SEVERITY_WARNING, &text);
            refuse(&message.param_id, error, peer, out);
        }
        self.tell(place, out);
    }

    fn place(&self, id: &[u8; 16]) -> Option<usize> {
        let end = id.iter().position(|byte| *byte == 0).unwrap_or(id.len());
        self.all.iter().position(|one| one.name.as_bytes() == &id[..end])
    }

    fn tell(&self, place: usize, out: &mut Out) {
        let Parameter { name, value, .. } = &self.all[place];
        let mut message = PARAM_VALUE_DATA {
            param_value: *value,
            param_count: self.all.len() as u16,
            param_index: place as u16,
            param_type: MavParamType::MAV_PARAM_TYPE_REAL32,
            ..PARAM_VALUE_DATA::DEFAULT
        };
        message.param_id = (*name).into();
        out.say(&MavMessage::PARAM_VALUE(message));
    }
}

fn refuse(id: &[u8; 16], error: MavParamError, peer: Peer, out: &mut Out) {
    out.say(&MavMessage::PARAM_ERROR(PARAM_ERROR_DATA {
        param_index: -1,
        target_system: peer.0,
        target_component: peer.1,
        param_id: (*id).into(),
        error,
    }));
}
