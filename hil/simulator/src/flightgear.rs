//! The aircraft's pose for FlightGear, which draws it: `fgfs --fdm=null --native-fdm=socket,in,50,,5500,udp`.
//!
//! A datagram of 408 bytes for each answered step: FlightGear's structure `FGNetFDM`, version 24, big endian. What this aircraft does not
//! have (tanks, engine temperatures, flaps) is zero.

use std::io;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::time::{SystemTime, UNIX_EPOCH};

use bateleur_plant::Truth;

/// Bytes of a datagram.
pub const BYTES: usize = 408;
/// Version of the structure.
const VERSION: u32 = 24;
const FEET: f64 = 1.0 / 0.3048;
const KNOTS: f64 = 3600.0 / 1852.0;
/// Air density at sea level in the standard atmosphere, kg/m³.
const SEA_LEVEL_KGPM3: f64 = 1.225;
/// What FlightGear is told to be the full travel of a surface, rad: it draws ±1.
const FULL_RAD: f64 = 0.5;
/// How far one sees, m.
const VISIBILITY_M: f64 = 20_000.0;
/// A running engine, in FlightGear's numbers.
const RUNNING: u32 = 2;

/// Sends poses; it never waits, and what does not go out is lost.
#[derive(Debug)]
pub struct FlightGear {
    socket: UdpSocket,
    to: SocketAddr,
}

impl FlightGear {
    /// To the FlightGear that listens at that address.
    ///
    /// # Errors
    /// There is no socket to be had.
    pub fn at(to: SocketAddr) -> io::Result<Self> {
        let any = if to.is_ipv4() { Ipv4Addr::UNSPECIFIED.into() } else { Ipv6Addr::UNSPECIFIED.into() };
        let socket = UdpSocket::bind(SocketAddr::new(any, 0))?;
        socket.set_nonblocking(true)?;
        Ok(Self { socket, to })
    }

    /// Shows where the aircraft is.
    pub fn show(&self, truth: &Truth) {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        // Nobody listens, or not yet: it goes on.
        let _ = self.socket.send_to(&datagram(truth, now.as_secs() as u32), self.to);
    }
}

/// The structure; `now_s`: Unix time, by which FlightGear sets the sun.
#[must_use]
pub fn datagram(truth: &Truth, now_s: u32) -> [u8; BYTES] {
    let mut out = Writer { bytes: [0; BYTES], at: 0 };
    let body = truth.attitude.inverse_transform_vector(&truth.velocity_ned_mps);
    let Truth { velocity_ned_mps: velocity, rates_radps: rates, specific_force_mps2: force, .. } = truth;
    let calibrated_mps = truth.airspeed_mps * (truth.density_kgpm3 / SEA_LEVEL_KGPM3).max(0.0).sqrt();
    out.word(VERSION);
    out.word(0); // so that what follows is aligned
    out.doubles([truth.geodetic.longitude_rad, truth.geodetic.latitude_rad, truth.geodetic.altitude_m]);
    out.floats([-truth.position_ned_m.z, truth.roll_rad, truth.pitch_rad, truth.yaw_rad]);
    out.floats([truth.alpha_rad, truth.beta_rad, rates.x, rates.y, rates.z]);
    out.floats([calibrated_mps * KNOTS, -velocity.z * FEET]);
    out.floats([velocity.x, velocity.y, velocity.z, body.x, body.y, body.z].map(|speed| speed * FEET));
    out.floats([force.x, force.y, force.z].map(|force| force * FEET));
    out.floats([0.0, truth.beta_rad.to_degrees()]); // no warning of a stall
    // One engine of four.
    out.word(1);
    out.words([RUNNING, 0, 0, 0]);
    out.floats([truth.propeller_radps * 60.0 / std::f64::consts::TAU, 0.0, 0.0, 0.0]);
    out.floats([0.0; 8 * 4]); // fuel flow and pressure, temperatures, pressures of the engines
    out.word(0); // tanks
    out.floats([0.0; 4]);
    out.word(3);
    let on_ground = u32::from(truth.on_ground);
    out.words([on_ground; 3]);
    out.floats([1.0; 3]); // the gear is down
    out.floats([0.0; 2 * 3]); // steering, compression
    out.word(now_s);
    out.word(0); // what is added to it
    out.floats([VISIBILITY_M]);
    // As FlightGear counts: an elevator that pitches down, ailerons that roll right, a rudder that turns right.
    let part = |angle_rad: f64| (angle_rad / FULL_RAD).clamp(-1.0, 1.0);
    let surfaces = &truth.surfaces;
    let aileron = part(surfaces.aileron_rad);
    out.floats([part(surfaces.elevator_rad), 0.0, 0.0, 0.0, aileron, -aileron, -part(surfaces.rudder_rad)]);
    out.floats([0.0; 3]); // nose wheel, speed brake, spoilers
    debug_assert_eq!(out.at, BYTES);
    out.bytes
}

struct Writer {
    bytes: [u8; BYTES],
    at: usize,
}

impl Writer {
    fn put(&mut self, bytes: &[u8]) {
        self.bytes[self.at..self.at + bytes.len()].copy_from_slice(bytes);
        self.at += bytes.len();
    }

    fn word(&mut self, value: u32) {
        self.put(&value.to_be_bytes());
    }

    fn words<const N: usize>(&mut self, values: [u32; N]) {
        values.iter().for_each(|value| self.word(*value));
    }

    fn doubles<const N: usize>(&mut self, values: [f64; N]) {
        values.iter().for_each(|value| self.put(&value.to_be_bytes()));
    }

    fn floats<const N: usize>(&mut self, values: [f64; N]) {
        values.iter().for_each(|value| self.put(&(*value as f32).to_be_bytes()));
    }
}
