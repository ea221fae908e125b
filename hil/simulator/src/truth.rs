//! The log of what was really the case: one record for each answered step.
//!
//! The file begins with one line of JSON (format, version, bytes in a record, and for each field its name, kind,
//! elements and offset; then the conditions of the flight). After the line feed follow the records as they lie in
//! memory, little endian, without gaps: any tool can read them from the header alone.

use bateleur_messages::hil::Actuators;
use bateleur_messages::{Field, FieldKind, Message};
use bateleur_plant::Truth;
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use thiserror::Error;
use zerocopy::{FromBytes, IntoBytes};

/// Name of the format, in every header.
pub const FORMAT: &str = "bateleur-truth";
/// Raised when the meaning of a field changes; a new field alone is told apart by the table.
pub const VERSION: u32 = 1;
/// Buffer of the writer, bytes: some three seconds of flight between two system calls.
const BUFFER_BYTES: usize = 1 << 16;

bateleur_message_macro::messages!(bateleur_messages::format, "msg");

impl TruthRecord {
    /// The record of one instant.
    pub fn new(time_ns: u64, truth: &Truth, actuators: &Actuators) -> Self {
        Self {
            time_ns,
            position_ned_m: truth.position_ned_m.into(),
            velocity_ned_mps: truth.velocity_ned_mps.into(),
            euler_rad: [truth.roll_rad, truth.pitch_rad, truth.yaw_rad],
            rates_radps: truth.rates_radps.into(),
            specific_force_mps2: truth.specific_force_mps2.into(),
            airspeed_mps: truth.airspeed_mps,
            alpha_rad: truth.alpha_rad,
            beta_rad: truth.beta_rad,
            wind_ned_mps: truth.wind_ned_mps.into(),
            gust_ned_mps: truth.gust_ned_mps.into(),
            surfaces_rad: [
                truth.surfaces.aileron_rad,
                truth.surfaces.elevator_rad,
                truth.surfaces.rudder_rad,
            ],
            throttle: truth.throttle,
            gps_slow_error_ned_m: truth.gps_slow_error_ned_m.into(),
            barometer_bias_m: truth.barometer_bias_m,
            accelerometer_bias_mps2: truth.accelerometer_bias_mps2.into(),
            gyroscope_bias_radps: truth.gyroscope_bias_radps.into(),
            timers_us: [
                actuators.aileron_left_us,
                actuators.aileron_right_us,
                actuators.elevator_us,
                actuators.rudder_us,
                actuators.throttle_us,
            ],
            autopilot: actuators.autopilot,
            on_ground: u16::from(truth.on_ground),
            crashed: u16::from(truth.crashed),
        }
    }
}

/// The first line of a log.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// [`FORMAT`].
    pub format: String,
    /// [`VERSION`].
    pub version: u32,
    /// Bytes in a record.
    pub record_bytes: usize,
    /// The record's fields in order.
    pub fields: Vec<HeaderField>,
    /// Name of the airframe.
    pub airframe: String,
    /// Seed of all chance.
    pub seed: u64,
    /// Mean wind, m/s.
    pub wind_speed_mps: f64,
    /// Where it comes from, rad clockwise from north.
    pub wind_from_rad: f64,
    /// Level of turbulence.
    pub turbulence: String,
    /// Errors of the sensors, where they are not the usual ones.
    #[serde(default)]
    pub sensors: Option<String>,
    /// Faults of sensors, actuators and air, as they were asked for.
    #[serde(default)]
    pub faults: Vec<String>,
    /// How the aircraft differs from its file, as it was asked for.
    #[serde(default)]
    pub plant: Vec<String>,
}

/// One field of a record, as the header tells it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HeaderField {
    /// Name, with its unit.
    pub name: String,
    /// Kind of each element: uint16, uint64 or float64.
    pub kind: String,
    /// Elements.
    pub count: usize,
    /// Bytes from the start of the record.
    pub offset: usize,
}

impl Header {
    /// The header of a log written by this version.
    pub fn new(options: &crate::Options) -> Self {
        let conditions = &options.conditions;
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            record_bytes: size_of::<TruthRecord>(),
            fields: fields(),
            airframe: options.airframe.name.clone(),
            seed: conditions.seed,
            wind_speed_mps: conditions.wind_speed_mps,
            wind_from_rad: conditions.wind_from_rad,
            turbulence: format!("{:?}", conditions.turbulence).to_lowercase(),
            sensors: options.outside.sensors.clone(),
            faults: conditions.faults.iter().map(ToString::to_string).collect(),
            plant: plant(options),
        }
    }
}

/// How the aircraft was changed, in the words of the options.
fn plant(options: &crate::Options) -> Vec<String> {
    let outside = &options.outside;
    let changes = outside.plant.iter().map(ToString::to_string);
    let seed = outside.vary_seed.unwrap_or(options.conditions.seed);
    changes.chain(outside.vary.iter().map(|ranges| format!("{ranges}, seed {seed}"))).collect()
}

fn fields() -> Vec<HeaderField> {
    let kind = |kind: FieldKind| kind.ros2_name().to_owned();
    let entry = |field: &Field| HeaderField {
        name: field.name.to_owned(),
        kind: kind(field.kind),
        count: field.count,
        offset: field.offset,
    };
    TruthRecord::FIELDS.iter().map(entry).collect()
}

/// Why a log could not be written or read.
#[derive(Debug, Error)]
pub enum TruthError {
    /// The file system refused.
    #[error("truth log {}: {error}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        error: io::Error,
    },
    /// The first line is not a header.
    #[error("{} does not begin with a truth log's header: {why}", path.display())]
    NoHeader {
        /// The file.
        path: PathBuf,
        /// What is wrong with the line.
        why: String,
    },
    /// The log's fields are not the ones that this program knows.
    #[error("{} was written by another version: {difference}; read it with the program that wrote it", path.display())]
    OtherVersion {
        /// The file.
        path: PathBuf,
        /// The first difference.
        difference: String,
    },
}

/// Writes a log.
#[derive(Debug)]
pub struct TruthWriter {
    file: BufWriter<File>,
    path: PathBuf,
}

impl TruthWriter {
    /// Creates the file and writes its header.
    ///
    /// # Errors
    /// When the file cannot be created or written.
    pub fn create(path: &Path, header: &Header) -> Result<Self, TruthError> {
        let fail = |error: io::Error| TruthError::Io { path: path.to_owned(), error };
        let file = BufWriter::with_capacity(BUFFER_BYTES, File::create(path).map_err(fail)?);
        let mut writer = Self { file, path: path.to_owned() };
        let line = serde_json::to_string(header).map_err(|error| fail(error.into()))?;
        writer.bytes(line.as_bytes())?;
        writer.bytes(b"\n")?;
        Ok(writer)
    }

    /// Appends one record.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn append(&mut self, record: &TruthRecord) -> Result<(), TruthError> {
        self.bytes(record.as_bytes())
    }

    /// Hands everything to the system.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn flush(&mut self) -> Result<(), TruthError> {
        self.file.flush().map_err(|error| TruthError::Io { path: self.path.clone(), error })
    }

    fn bytes(&mut self, bytes: &[u8]) -> Result<(), TruthError> {
        self.file.write_all(bytes).map_err(|error| TruthError::Io { path: self.path.clone(), error })
    }
}

/// Reads the records of a log. A last record that was cut off is left out.
///
/// # Errors
/// When the file cannot be read, is no truth log, or has other fields.
pub fn read(path: &Path) -> Result<Vec<TruthRecord>, TruthError> {
    Ok(read_with_header(path)?.1)
}

/// Reads a log with its header.
///
/// # Errors
/// As [`read`].
pub fn read_with_header(path: &Path) -> Result<(Header, Vec<TruthRecord>), TruthError> {
    let bytes = std::fs::read(path).map_err(|error| TruthError::Io { path: path.to_owned(), error })?;
    let no_header = |why: String| TruthError::NoHeader { path: path.to_owned(), why };
    let end =
        bytes.iter().position(|byte| *byte == b'\n').ok_or_else(|| no_header("it has no line".into()))?;
    let header: Header =
        serde_json::from_slice(&bytes[..end]).map_err(|error| no_header(error.to_string()))?;
    if let Some(difference) = difference(&header) {
        return Err(TruthError::OtherVersion { path: path.to_owned(), difference });
    }
    let records = bytes[end + 1..].chunks_exact(size_of::<TruthRecord>());
    Ok((header, records.filter_map(|record| TruthRecord::read_from_bytes(record).ok()).collect()))
}

fn difference(header: &Header) -> Option<String> {
    if header.format != FORMAT || header.version != VERSION {
        return Some(format!("it is {} {}, not {FORMAT} {VERSION}", header.format, header.version));
    }
    let own = fields();
    let differs = own.iter().zip(&header.fields).find(|(own, other)| own != other);
    match differs {
        Some((own, other)) => Some(format!("its field `{}` stands where `{}` belongs", other.name, own.name)),
        None if own.len() != header.fields.len() || header.record_bytes != size_of::<TruthRecord>() => {
            Some(format!("it has {} fields, not {}", header.fields.len(), own.len()))
        }
        None => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Options;

    #[test]
    fn log_is_read_back_and_a_cut_record_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("truth.log");
        let header = Header::new(&Options::default());
        let mut writer = TruthWriter::create(&path, &header).unwrap();
        let record = TruthRecord { time_ns: 7, airspeed_mps: 22.0, crashed: 1, ..TruthRecord::default() };
        writer.append(&record).unwrap();
        writer.append(&record).unwrap();
        writer.bytes(&[1, 2, 3]).unwrap();
        writer.flush().unwrap();
        assert_eq!(read_with_header(&path).unwrap(), (header, vec![record, record]));
    }

    #[test]
    fn log_with_other_fields_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("truth.log");
        let mut header = Header::new(&Options::default());
        header.fields[1].name = "somewhere".into();
        TruthWriter::create(&path, &header).unwrap().flush().unwrap();
        let message = read(&path).unwrap_err().to_string();
        assert!(message.contains("`somewhere`") && message.contains("`position_ned_m`"), "{message}");
    }

    #[test]
    fn something_else_is_no_log() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("truth.log");
        std::fs::write(&path, "hello\n").unwrap();
        assert!(matches!(read(&path), Err(TruthError::NoHeader { .. })));
    }

    #[test]
    fn every_byte_of_a_record_is_described() {
        let last = TruthRecord::FIELDS.last().unwrap();
        assert_eq!(last.offset + last.kind.size() * last.count, size_of::<TruthRecord>());
    }
}
