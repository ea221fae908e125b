//! Tables, from their text to frames and back.

use super::*;
use bateleur_messages::catalogue;

use crate::{Assembly, DISTRIBUTION_BOARD, Outcome, from_attributes};
use bateleur_messages::{Custom, Message, Range, RawAnalog, RawGps, ServoTimers};
use zerocopy::{FromBytes, IntoBytes};

fn board() -> Table {
    from_attributes(DISTRIBUTION_BOARD, None, catalogue()).unwrap()
}

/// A message through frames and back, at this module time, where the frame with the identifier `lost` does not come.
fn through<T: Message>(port: &str, message: &T, now_ns: u64, lost: Option<u32>) -> Option<(T, usize)> {
    let table = board();
    let layout = table.layout(port).unwrap();
    let mut assembly = Assembly::new(layout.clone());
    let frames = layout.frames(message.as_bytes(), now_ns);
    assert!(frames.is_sorted_by_key(Frame::priority) && frames.iter().all(|frame| frame.data().len() <= 8));
    let mut whole = None;
    for frame in frames.iter().filter(|frame| Some(frame.id().number()) != lost) {
        match assembly.take(frame, now_ns) {
            Outcome::Whole(bytes, missing) => whole = Some((T::read_from_bytes(&bytes).unwrap(), missing)),
            Outcome::Part | Outcome::Withheld => {}
            Outcome::Foreign => panic!("{frame} is its own"),
        }
    }
    whole
}

fn analog() -> RawAnalog {
    RawAnalog {
        measured_ns: 40_500_000,
        interval_ns: 20_000_000,
        specific_force_mps2: [0.1, -0.2, -9.81],
        rates_radps: [0.01, -1.5, 3.0],
        field_gauss: [0.09584, -0.04861, -0.22624],
        static_pressure_pa: 101_325.12,
        differential_pressure_pa: 296.4,
        temperature_k: 288.15,
    }
}

#[test]
fn sensors_come_back_within_half_a_step_and_times_exactly() {
    let (back, missing) = through("raw_analog", &analog(), 40_500_000, None).unwrap();
    assert_eq!((missing, back.measured_ns, back.interval_ns), (0, 40_500_000, 20_000_000));
    let near =
        |a: [f64; 3], b: [f64; 3], step: f64| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 0.5001 * step);
    assert!(near(back.specific_force_mps2, analog().specific_force_mps2, 0.0005), "{back:?}");
    assert!(near(back.rates_radps, analog().rates_radps, 0.00002), "{back:?}");
    assert!(near(back.field_gauss, analog().field_gauss, 0.00001), "{back:?}");
    assert!((back.static_pressure_pa - 101_325.12).abs() < 0.0051, "{back:?}");
    let fix = RawGps {
        measured_ns: 80_000_000,
        latitude_rad: -0.594_231_6,
        longitude_rad: 0.327_078_9,
        altitude_m: 160.25,
        velocity_ned_mps: [22.0, -0.5, 1.25],
        satellites: 11,
        fix: 3,
        ..RawGps::default()
    };
    let (back, _) = through("raw_gps", &fix, 200_500_000, None).unwrap();
    assert_eq!((back.measured_ns, back.satellites, back.fix), (80_000_000, 11, 3));
    assert!((back.latitude_rad - fix.latitude_rad).abs() < 1e-9 && (back.altitude_m - 160.25).abs() < 1e-3);
    let timers = ServoTimers {
        aileron_left_us: 1500,
        throttle_us: 2000,
        autopilot: 1,
        cycle: 70_000,
        ..ServoTimers::default()
    };
    let range = Range { measured_ns: 180_000_000, distance_m: 7.125, least_m: 0.2, most_m: 40.0 };
    assert_eq!(through("range", &range, 200_500_000, None), Some((range, 0)));
    assert_eq!(through("timers", &timers, 0, None), Some((timers, 0)));
}

#[test]
fn what_is_not_measured_and_what_did_not_come_is_not_a_number() {
    let nothing = RawAnalog { rates_radps: [f64::NAN; 3], ..analog() };
    let (back, _) = through("raw_analog", &nothing, 0, None).unwrap();
    assert!(back.rates_radps.iter().all(|rate| rate.is_nan()) && !back.static_pressure_pa.is_nan());
    let (back, missing) = through("raw_analog", &analog(), 0, Some(0x110)).unwrap();
    assert_eq!(missing, 1);
    assert!(back.specific_force_mps2.iter().all(|force| force.is_nan()) && !back.rates_radps[0].is_nan());
}

#[test]
fn a_message_whose_whole_numbers_did_not_come_is_withheld() {
    assert_eq!(through("custom", &Custom::default(), 0, Some(0x120)), None, "sticks are not made up");
    assert_eq!(through("raw_gps", &RawGps::default(), 0, Some(0x133)), None, "its last frame never came");
}

#[test]
fn parts_of_an_earlier_set_do_not_fill_a_later_one() {
    let table = board();
    let layout = table.layout("raw_analog").unwrap();
    let mut assembly = Assembly::new(layout.clone());
    let frames = layout.frames(analog().as_bytes(), 0);
    frames.iter().for_each(|frame| drop(assembly.take(frame, 0)));
    let Outcome::Whole(bytes, missing) = assembly.take(&frames[4], 1) else { panic!() };
    assert_eq!(missing, 4);
    assert!(RawAnalog::read_from_bytes(&bytes).unwrap().rates_radps[0].is_nan());
    let other = Frame::classic(Id::Standard(0x7ff), &[]);
    assert_eq!(assembly.take(&other, 0), Outcome::Foreign);
    assert_eq!(assembly.take(&Frame::remote(frames[4].id(), 4).unwrap(), 0), Outcome::Foreign);
}

#[test]
fn frames_of_a_set_that_was_broken_off_do_not_complete_a_later_one() {
    let table = board();
    let layout = table.layout("raw_analog").unwrap();
    let mut assembly = Assembly::new(layout.clone());
    let frames = layout.frames(analog().as_bytes(), 0);
    let mut later = |forgets: bool, later_ns: u64| {
        frames[..4].iter().for_each(|frame| drop(assembly.take(frame, 0)));
        if forgets {
            assembly.forget();
        }
        let Outcome::Whole(_, missing) = assembly.take(&frames[4], later_ns) else { panic!() };
        missing
    };
    assert_eq!(later(false, 20_000_000), 0, "a set may take two windows");
    assert_eq!(later(false, 10_000_000_000), 4, "and not ten seconds");
    assert_eq!(later(true, 0), 4);
}

const DBC: &str = r#"VERSION ""

NS_ :

BS_:

BU_: Node

BO_ 272 Accel: 8 Node
 SG_ X : 0|20@1- (0.0005,0) [0|0] "m/s2" Vector__XXX
 SG_ Y : 20|20@1- (0.0005,0) [0|0] "m/s2" Vector__XXX
 SG_ Z : 40|20@1- (0.0005,0) [0|0] "m/s2" Vector__XXX

BO_ 273 Gyro: 6 Node
 SG_ RollDegrees : 7|16@0- (0.01,0) [0|0] "deg/s" Vector__XXX

BO_ 2147484000 Wide: 8 Node
 SG_ Mux M : 0|8@1+ (1,0) [0|0] "" Vector__XXX
 SG_ Inner m0 : 8|8@1+ (1,0) [0|0] "" Vector__XXX
 SG_ Exact : 16|32@1- (1,0) [0|0] "" Vector__XXX

SIG_VALTYPE_ 2147484000 Exact : 1;
"#;

fn with_dbc(fields: &str) -> Result<Table, TableError> {
    Table::parse(
        "t.toml",
        &format!("[port.raw_analog]\nmessage = \"RawAnalog\"\n[port.raw_analog.fields]\n{fields}"),
        Some(("a.dbc", DBC)),
    )
}

#[test]
fn a_dbcs_signals_are_as_good_as_own_ones_in_the_messages_unit() {
    let table = with_dbc(
        "\"specific_force_mps2[0]\" = { signal = \"Accel.X\" }\n\
         \"rates_radps[0]\" = { signal = \"Gyro.RollDegrees\", scale = 0.017453292519943295 }\n\
         temperature_k = { signal = \"Wide.Exact\" }\n",
    )
    .unwrap();
    let layout = table.layout("raw_analog").unwrap();
    let message = RawAnalog {
        specific_force_mps2: [-1.5, 0.0, 0.0],
        rates_radps: [1.0, 0.0, 0.0],
        temperature_k: 288.25,
        ..RawAnalog::default()
    };
    let frames = layout.frames(message.as_bytes(), 0);
    // The extended identifier's first eleven bits are zeros: it wins.
    assert_eq!(frames[0].id(), Id::Extended(352));
    assert_eq!(frames[1].to_string(), "110#48F40F", "as the board's own");
    assert_eq!(frames[2].to_string(), "111#1662", "5730 hundredths of a degree, the high byte first");
    let mut assembly = Assembly::new(layout.clone());
    let outcomes: Vec<Outcome> = frames.iter().map(|frame| assembly.take(frame, 0)).collect();
    let Outcome::Whole(bytes, 0) = &outcomes[2] else { panic!("{outcomes:?}") };
    let back = RawAnalog::read_from_bytes(bytes).unwrap();
    assert_eq!((back.specific_force_mps2[0], back.temperature_k), (-1.5, 288.25));
    assert!((back.rates_radps[0] - 1.0).abs() < 1e-4);
}

#[test]
fn signals_that_overlap_are_refused_by_name() {
    let overlapping = DBC.replace("SG_ Y : 20|20", "SG_ Y : 19|20");
    let error = Table::parse("t.toml", "", Some(("a.dbc", &overlapping))).unwrap_err().to_string();
    assert!(
        error.contains("message Accel (110)") && error.contains("signals X and Y overlap at bit 19"),
        "{error}"
    );
    let own = "\"rates_radps[0]\" = { frame = \"100\", start = 0, bits = 9 }\n\"rates_radps[1]\" = { frame = \"100\", start = 8, bits = 8 }\n";
    let error = with_dbc(own).unwrap_err().to_string();
    assert!(error.starts_with("t.toml:5: ") && error.contains("overlap at bit 8 of frame 100"), "{error}");
}

#[test]
fn dbc_file_that_is_not_there_or_too_long_is_refused_as_what_it_is() {
    let error =
        from_attributes(DISTRIBUTION_BOARD, Some("/nowhere/a.dbc"), catalogue()).unwrap_err().to_string();
    assert!(error.contains("cannot read the DBC file /nowhere/a.dbc"), "{error}");
    let error = from_attributes(DISTRIBUTION_BOARD, Some("/dev/zero"), catalogue()).unwrap_err().to_string();
    assert!(error.contains("/dev/zero") && error.contains("longer than 1 MiB"), "{error}");
}

/// What is said of this DBC file, with an empty table.
fn said_of(dbc: &str) -> String {
    Table::parse("t.toml", "", Some(("a.dbc", dbc))).unwrap_err().to_string()
}

#[test]
fn a_dbcs_identifier_above_the_standard_ones_without_the_extended_flag_is_refused_and_not_cut() {
    let said = said_of(&DBC.replace("BO_ 272 Accel", "BO_ 419365155 Accel"));
    assert!(said.contains("a.dbc: message Accel has the identifier 419365155"), "{said}");
    assert!(said.ends_with("write BO_ 2566848803"), "{said}");
    // Cut to 16 bits this one is 272 itself.
    let said = said_of(&DBC.replace("BO_ 272 Accel: ", "BO_\t65808  Accel :"));
    assert!(said.contains("identifier 65808") && said.contains("write BO_ 2147549456"), "{said}");
    let said = said_of(&DBC.replace("BO_ 272 Accel", "BO_ 1073742096 Accel"));
    assert!(said.contains("identifier 1073742096") && said.contains("536870911 at most"), "{said}");
    let spoken = format!("{DBC}\nCM_ \"once it was BO_ 65809 Accel: and BO_ 999999 Gyro:\";\n");
    assert!(Table::parse("t.toml", "", Some(("a.dbc", &spoken))).is_ok(), "a comment is no message");
}

#[test]
fn a_dbcs_float_of_another_length_and_a_factor_of_0_are_refused_by_name() {
    let short = DBC.replace("Exact : 16|32@1-", "Exact : 16|16@1-");
    assert!(
        said_of(&short).contains("a.dbc: Wide.Exact is a float of 32 bits by its SIG_VALTYPE_ and has 16")
    );
    let double = DBC.replace("Exact : 1;", "Exact : 2;");
    assert!(said_of(&double).contains("Wide.Exact is a float of 64 bits by its SIG_VALTYPE_ and has 32"));
    let said = said_of(&DBC.replace("SG_ Y : 20|20@1- (0.0005,0)", "SG_ Y : 20|20@1- (0,0)"));
    assert!(said.starts_with("a.dbc: Accel.Y: the scale (a DBC's factor) must be a number other"), "{said}");
}

#[test]
fn two_messages_or_signals_of_one_name_in_a_dbc_are_refused() {
    let said = said_of(&DBC.replace("BO_ 273 Gyro", "BO_ 273 Accel"));
    assert!(said.starts_with("a.dbc: two messages (110 and 111) are called Accel: rename"), "{said}");
    let said = said_of(&DBC.replace("SG_ Y : 20|20", "SG_ X : 20|20"));
    assert!(said.starts_with("a.dbc: Accel.X is there twice: rename"), "{said}");
}

#[test]
fn signals_that_a_dbc_keeps_for_no_message_are_left_alone() {
    let kept = "BO_ 3221225472 VECTOR__INDEPENDENT_SIG_MSG: 0 Vector__XXX\n SG_ Spare : 0|8@1+ (1,0) [0|0] \"\" Vector__XXX\n\n";
    let mut errors = Vec::new();
    let text = DBC.replacen("BO_ ", &format!("{kept}BO_ "), 1);
    assert!(text.contains("INDEPENDENT"));
    Signals::read("a.dbc", &text, &mut errors);
    assert_eq!(errors, Vec::<String>::new());
}

#[test]
fn a_dbc_file_in_windows_1252_is_read_and_a_table_that_is_not_utf_8_is_refused() {
    let own =
        |name: &str| std::env::temp_dir().join(format!("bateleur-can-map-{}-{name}", std::process::id()));
    let (dbc, table) = (own("a.dbc"), own("a.toml"));
    let (dbc_path, table_path) = (dbc.to_str().unwrap(), table.to_str().unwrap());
    let (before, after) = DBC.split_once("deg/s").unwrap();
    std::fs::write(&dbc, [before.as_bytes(), b"\xb0/s", after.as_bytes()].concat()).unwrap();
    let fields = "[port.raw_analog]\nmessage = \"RawAnalog\"\nfields = { \"rates_radps[0]\" = { signal = \"Gyro.RollDegrees\" } }\n";
    let read = from_attributes(fields, Some(dbc_path), catalogue());
    std::fs::write(&table, b"# \xb0\n").unwrap();
    let refused = from_attributes(table_path, None, catalogue()).unwrap_err().to_string();
    std::fs::remove_file(&dbc).unwrap();
    std::fs::remove_file(&table).unwrap();
    assert_eq!(read.unwrap().layout("raw_analog").unwrap().ids().next(), Some(Id::Standard(0x111)));
    assert!(refused.contains("a.toml is not UTF-8 text"), "{refused}");
}

#[test]
fn a_none_that_the_bits_can_not_hold_is_refused_and_so_is_one_of_a_float() {
    let one = |value: &str| {
        with_dbc(&format!("temperature_k = {{ {value} }}\n")).map_err(|error| error.to_string())
    };
    for (value, range) in [
        ("frame = \"100\", start = 0, bits = 16, signed = true, none = 65535", "from -32768 to 32767"),
        ("frame = \"100\", start = 0, bits = 16, none = -1", "from 0 to 65535"),
        ("frame = \"100\", start = 0, bits = 8, none = 300", "from 0 to 255"),
        ("signal = \"Accel.X\", none = 524288", "from -524288 to 524287"),
        ("frame = \"100\", start = 0, bits = 32, float = true, none = 0", "a float says by itself"),
        ("signal = \"Wide.Exact\", none = 0", "a float says by itself"),
    ] {
        let said = one(value).unwrap_err();
        assert!(said.starts_with("t.toml:4: raw_analog.temperature_k: none = "), "{value}: {said}");
        assert!(said.contains(range), "{value}: {said}");
    }
    for value in [
        "frame = \"100\", start = 0, bits = 16, none = 65535",
        "frame = \"100\", start = 0, bits = 64, signed = true, none = -9223372036854775808",
        "signal = \"Accel.X\", none = -524288",
    ] {
        assert!(one(value).is_ok(), "{value}: {:?}", one(value));
    }
}

#[test]
fn what_would_be_ignored_in_a_table_is_refused_with_its_line() {
    for (fields, words) in [
        (
            "temperature_k = { signal = \"Accel.X\", bits = 8, signed = false }",
            "t.toml:4: raw_analog.temperature_k: beside signal, bits, signed would say nothing",
        ),
        ("temperature_k = { signal = \"Accel.X\", frame = \"100\" }", "beside signal, frame would"),
        ("temperature_k = { constant = 1.0, scale = 2.0 }", "beside constant, scale would"),
        ("temperature_k = { signal = \"Accel.X\", scale = 0.0 }", "must be a number other than 0"),
        ("temperature_k = { signal = \"Accel.X\", scale = nan }", "must be a number other than 0"),
        ("temperature_k = { signal = \"Accel.X\", offset = inf }", "the offset a number"),
        (
            "\"rates_radps[+0]\" = { signal = \"Accel.X\" }\n\"rates_radps[0]\" = { signal = \"Accel.Y\" }",
            "t.toml:5: raw_analog.rates_radps[0] and raw_analog.rates_radps[+0] are the same field",
        ),
        (
            "temperature_k = { signal = \"Accel.X\" }\n\"temperature_k[0]\" = { signal = \"Accel.Y\" }",
            "t.toml:5: raw_analog.temperature_k[0] and raw_analog.temperature_k are the same field",
        ),
    ] {
        let said = with_dbc(&format!("{fields}\n")).unwrap_err().to_string();
        assert!(said.contains(words), "{words:?} is missing in:\n{said}");
    }
    let stamped = |message: &str, field: &str, stamp: &str| {
        let text = format!(
            "[port.a]\nmessage = \"{message}\"\nstamp = \"{stamp}\"\n\
             fields = {{ {field} = {{ frame = \"100\", start = 0, bits = 8 }} }}\n"
        );
        Table::parse("t.toml", &text, None).map_err(|error| error.to_string())
    };
    let said = stamped("RawAnalog", "temperature_k", "interval_ns").unwrap_err();
    assert_eq!(
        said,
        "t.toml:3: stamp = \"interval_ns\" is no time of measuring: of RawAnalog it is measured_ns"
    );
    assert!(
        stamped("ServoTimers", "cycle", "cycle")
            .unwrap_err()
            .contains("ServoTimers has none; leave stamp out")
    );
    assert!(stamped("RawAnalog", "temperature_k", "measured_ns").is_ok());
}

#[test]
fn everything_that_can_not_be_meant_is_said_at_once_with_its_line() {
    let error = with_dbc(
        "temprature_k = { frame = \"100\", start = 0, bits = 8 }\n\
         rates_radps = { frame = \"100\", start = 8, bits = 8 }\n\
         static_pressure_pa = { frame = \"XYZ\", start = 8, bits = 8 }\n\
         differential_pressure_pa = { signal = \"Accel.XX\" }\n\
         interval_ns = { signal = \"Wide.Inner\" }\n\
         \"field_gauss[0]\" = { frame = \"101\", start = 500, bits = 20 }\n\
         \"field_gauss[1]\" = { frame = \"101\", start = 0, bits = 16, float = true }\n\
         \"field_gauss[2]\" = { frame = \"101\" }\n\
         measured_ns = { frame = \"101\", start = 0, bits = 8, scale = 0.0 }\n",
    )
    .unwrap_err()
    .to_string();
    for words in [
        "t.toml:4: RawAnalog has no field temprature_k; did you mean temperature_k?",
        "rates_radps[0], and so on",
        "\"XYZ\" is no identifier",
        "no signal Accel.XX; did you mean Accel.X?",
        "Wide.Inner is multiplexed",
        "20 bits from 500",
        "a float has 32 or 64 bits",
        "needs start and bits",
        "other than 0",
    ] {
        assert!(error.contains(words), "{words:?} is missing in:\n{error}");
    }
    let said = |text: &str| Table::parse("t.toml", text, None).unwrap_err().to_string();
    assert!(
        said("[port.a]\nmessage = \"RawGsp\"\nfields = {}\n")
            .contains("t.toml:2: there is no message RawGsp; did you mean RawGps?")
    );
    assert!(said("[port.a]\nmesage = 1\n").contains("t.toml:2: unknown field"));
    assert!(said("[sync]\nframe = \"900\"\n").contains("no identifier"));
    let early = "[port.a]\nmessage = \"Custom\"\ncomplete = \"100\"\nfields = { main_v = { frame = \"100\", start = 0, bits = 8 }, backup_v = { frame = \"101\", start = 0, bits = 8 } }\n";
    assert!(said(early).contains("the last frame of port a is 101"), "{}", said(early));
    let stamped = |more: &str| {
        said(&format!(
            "[port.a]\nmessage = \"RawGps\"\n{more}\nfields = {{ satellites = {{ frame = \"100\", start = 0, bits = 8 }} }}\n"
        ))
    };
    assert!(
        stamped("stamp = \"fix\"")
            .contains("t.toml:3: stamp = \"fix\" is no time of measuring: of RawGps it is measured_ns"),
        "{}",
        stamped("stamp = \"fix\"")
    );
    let age = "age = { frame = \"101\", start = 0, bits = 8 }";
    assert!(stamped(age).contains("has an age and no stamp"), "{}", stamped(age));
    assert!(
        from_attributes("/nowhere/table.toml", None, catalogue())
            .unwrap_err()
            .to_string()
            .contains("cannot read")
    );
    let mapped = "[port.custom]\nmessage = \"Custom\"\nfields = { main_v = { signal = \"Power.Main\" } }\n";
    let empty = Table::parse("t.toml", mapped, Some(("a.dbc", ""))).unwrap_err().to_string();
    assert_eq!(empty, "t.toml:3: the DBC file has no signal Power.Main, nor any other");
    let absent = Table::parse("t.toml", mapped, None).unwrap_err().to_string();
    assert!(absent.contains("there is none (attribute dbc)"), "{absent}");
    let no_dbc = Table::parse(
        "t",
        "[port.a]\nmessage = \"Custom\"\nfields = { main_v = { signal = \"A.B\" } }\n",
        Some(("b.dbc", "hello")),
    );
    assert!(no_dbc.unwrap_err().to_string().contains("it is no DBC file"));
}
