//! What the sensor partitions published, beside the truth where it is of the same kind.

use super::{ESTIMATE, GPS, TRUTH, WANTED, chart, series, told, truth};
use crate::flight::{Flight, seconds};
use crate::plot::{Chart, Series, Style};
use bateleur_messages::{GpsPosition, GpsVelocity};

/// Colours of three components.
const THREE: [u8; 3] = [TRUTH, ESTIMATE, WANTED];
const BODY: [&str; 3] = ["x, forward", "y, right", "z, down"];

/// Receiver, gyroscope, accelerometer, magnetometer, pressures.
pub(super) fn charts(flight: &Flight) -> Vec<Chart> {
    vec![
        position(flight, "Latitude of the fixes", |fix| fix.latitude_rad),
        position(flight, "Longitude of the fixes", |fix| fix.longitude_rad),
        velocity(flight, "North velocity of the receiver", 0),
        velocity(flight, "East velocity of the receiver", 1),
        rate(flight, "Gyroscope x, roll rate", 0),
        rate(flight, "Gyroscope y, pitch rate", 1),
        rate(flight, "Gyroscope z, yaw rate", 2),
        specific_force(flight),
        airspeed(flight),
        pressure_altitude(flight),
        field(flight),
    ]
}

fn position(flight: &Flight, title: &str, angle_rad: impl Fn(&GpsPosition) -> f64) -> Chart {
    let fixes = flight.fixes.iter().map(|(time, fix)| (seconds(*time), angle_rad(fix).to_degrees()));
    // A thousandth of a degree is a hundred metres.
    Chart {
        least_range: 1e-3, ..chart(title, "°", vec![series("fixes", GPS, Style::Dots, fixes.collect())])
    }
}

fn velocity(flight: &Flight, title: &str, axis: usize) -> Chart {
    let fixes = flight.velocities.iter();
    let fixes = fixes.map(|(time, fix): &(u64, GpsVelocity)| (seconds(*time), fix.velocity_ned_mps[axis]));
    let lines = vec![
        series("fixes", GPS, Style::Dots, fixes.collect()),
        series("truth", TRUTH, Style::Line, truth(flight, |at| at.velocity_ned_mps[axis])),
    ];
    Chart { least_range: 2.0, ..chart(title, "m/s", lines) }
}

fn rate(flight: &Flight, title: &str, axis: usize) -> Chart {
    let measured = told(&flight.rates, |rates| rates.rates_radps[axis].to_degrees());
    let lines = vec![
        series("measured", GPS, Style::Line, measured),
        series("truth", TRUTH, Style::Line, truth(flight, |at| at.rates_radps[axis].to_degrees())),
    ];
    Chart { least_range: 4.0, ..chart(title, "°/s", lines) }
}

fn specific_force(flight: &Flight) -> Chart {
    let axis = |axis: usize| told(&flight.accelerations, |force| force.specific_force_mps2[axis]);
    Chart { least_range: 2.0, ..chart("Accelerometer", "m/s²", three(axis)) }
}

fn field(flight: &Flight) -> Chart {
    let axis = |axis: usize| told(&flight.fields, |field| field.field_gauss[axis]);
    Chart { least_range: 0.1, ..chart("Magnetometer", "gauss", three(axis)) }
}

fn three(points: impl Fn(usize) -> Vec<(f64, f64)>) -> Vec<Series> {
    (0..3).map(|axis| series(BODY[axis], THREE[axis], Style::Line, points(axis))).collect()
}

fn airspeed(flight: &Flight) -> Chart {
    let measured = told(&flight.pressures, |pressure| pressure.airspeed_mps);
    let lines = vec![
        series("pitot", GPS, Style::Line, measured),
        series("truth", TRUTH, Style::Line, truth(flight, |at| at.airspeed_mps)),
    ];
    Chart { least_range: 2.0, ..chart("Airspeed by the pitot tube", "m/s", lines) }
}

fn pressure_altitude(flight: &Flight) -> Chart {
    let measured = told(&flight.pressures, |pressure| pressure.height_m);
    let lines = vec![
        series("barometer", GPS, Style::Line, measured),
        series("truth", TRUTH, Style::Line, truth(flight, |at| -at.position_ned_m[2])),
    ];
    Chart {
        least_range: 10.0,
        ..chart("Height by the static pressure, above where it was zeroed", "m", lines)
    }
}
