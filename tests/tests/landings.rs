//! Aircraft that land by themselves: on the field, softly, and standing in the end.

use bateleur_tests::{
    Ended, ONE_PROCESS, among_others, bateleur, flight_schedule, is_long, laps_of_small_mission, repository,
    small_mission,
};
use serde_json::Value;

fn flight(options: &[&str]) -> Ended {
    let schedule = flight_schedule();
    let fixed = ["fly", "--fast", "--format", "json", "--schedule", schedule.to_str().unwrap()];
    let engine = if options.contains(&"--kill") { &[] } else { &ONE_PROCESS[..] };
    bateleur(&[&fixed[..], engine, options].concat()).end()
}

/// A landing after a lap of some 30 s; wind from another direction for each seed.
fn landing(seed: u32, options: &[&str]) -> Ended {
    let mission = small_mission().display().to_string();
    let (seed, from) = (seed.to_string(), (seed * 37 % 360).to_string());
    let own = ["--land", "--mission", &mission, "--seed", &seed, "--wind-from", &from];
    flight(&[&own[..], options].concat())
}

fn number(touchdown: &Value, name: &str) -> f64 {
    touchdown[name].as_f64().unwrap_or_else(|| panic!("no {name}: {touchdown}"))
}

#[test]
fn aircraft_land_against_the_wind_and_stand() {
    let _turn = among_others();
    let ultra_stick = repository().join("airframes/ultrastick25e.toml");
    let airframes = ["aerosonde", "rascal110", ultra_stick.to_str().unwrap()];
    let winds = [("0", "0", "calm"), ("3", "45", "light"), ("5", "160", "light"), ("5", "290", "light")];
    let each = airframes.iter().flat_map(|it| winds.map(|wind| (it, wind)));
    // Of twelve, every fifth: each wind, and each aircraft.
    let strides = if is_long() { each.clone().count() } else { 5 };
    for (airframe, (wind, from, turbulence)) in each.cycle().step_by(5).take(strides) {
        for seed in if is_long() { &["11", "12"][..] } else { &["11"] } {
            let air = ["--wind", wind, "--wind-from", from, "--turbulence", turbulence];
            let ended = flight(&[&["--land", "--airframe", airframe, "--seed", seed], &air[..]].concat());
            let ended = ended.expect_code(0);
            let (summary, about) =
                (ended.summary(), format!("{airframe}, {wind} m/s from {from}°, seed {seed}"));
            let touchdown = &summary["conditions"]["touchdown"];
            assert!(touchdown["standing_s"].is_f64(), "{about}: {touchdown}");
            assert!(number(touchdown, "sink_mps") < 3.5, "{about}: {touchdown}");
            assert!(number(touchdown, "along_m").abs() < 100.0, "{about}: {touchdown}");
            assert!(number(touchdown, "across_m").abs() < 10.0, "{about}: {touchdown}");
        }
    }
}

#[test]
fn landing_is_the_same_for_one_seed_and_survives_restarts_of_the_controller() {
    let _turn = among_others();
    let options = ["--land", "--seed", "5", "--wind", "4", "--turbulence", "light"];
    let digest = |more: &[&str]| {
        let ended = flight(&[&options[..], more].concat()).expect_code(0);
        let summary = ended.summary();
        assert!(number(&summary["conditions"]["touchdown"], "sink_mps") < 2.5, "{}", ended.stderr);
        summary["digest"].clone()
    };
    assert_eq!(digest(&[]), digest(&[]));
    // On the circle, on the slope, and shortly before and after the touch-down.
    let kills = ["controller@262", "controller@310", "estimator@270", "controller@230", "controller@285"];
    for kill in &kills[..if is_long() { 5 } else { 3 }] {
        digest(&["--kill", kill]);
    }
}

#[test]
fn range_finder_brings_the_touch_down_to_its_place_and_none_of_its_faults_makes_one_hard() {
    let _turn = among_others();
    for seed in 31..if is_long() { 55 } else { 34 } {
        let land = |fault: &[&str]| {
            let ended = landing(seed, &[&["--wind", "2"], fault].concat()).expect_code(0);
            ended.summary()["conditions"]["touchdown"].clone()
        };
        let sound = land(&[]);
        let (along_m, sink_mps) = (number(&sound, "along_m"), number(&sound, "sink_mps"));
        assert!(along_m.abs() < 15.0 && sink_mps < 1.0, "seed {seed}: {sound}");
        // From the pattern to the flare.
        for (place, kind) in
            ["range_lost", "range_stuck", "range_shift=-2.5", "range_shift=2.5"].iter().enumerate()
        {
            let before_s = 3.0 + 11.0 * f64::from((place as u32 + seed) % 4);
            let fault = format!("{kind}@{}", number(&sound, "time_s") - before_s);
            let touchdown = land(&["--fault", &fault]);
            assert!(touchdown["standing_s"].is_f64(), "seed {seed}, {fault}: {touchdown}");
            assert!(number(&touchdown, "sink_mps") < 2.0, "seed {seed}, {fault}: {touchdown}");
            assert!(number(&touchdown, "along_m").abs() < 120.0, "seed {seed}, {fault}: {touchdown}");
        }
    }
}

/// Mass, inertia and derivatives off their file: this one's wing stalls in the first turn, at a load that its file allows.
#[test]
fn wing_that_stalls_before_its_file_says_so_flies_again_and_lands() {
    let _turn = among_others();
    for seed in ["100014", "100088"] {
        let air = ["--airframe", "vtail60", "--seed", seed, "--wind", "3", "--wind-from", "100"];
        let ended =
            flight(&[&air[..], &["--vary", "mass=10%,inertia=10%,derivatives=20%", "--land"]].concat());
        let ended = ended.expect_code(0);
        let stalled = |fault: &bateleur_tests::Fault| fault.detail.contains("the wing has stalled");
        assert!(ended.faults().iter().any(stalled), "seed {seed} stalls no more: {}", ended.stderr);
        let touchdown = ended.summary()["conditions"]["touchdown"].clone();
        assert!(number(&touchdown, "sink_mps") < 2.0, "{touchdown}");
    }
}

/// The touch-down of a whole mission in a light wind, with faults.
fn with_faults(airframe: &str, seed: usize, faults: &[&str]) -> Value {
    let seed = seed.to_string();
    let faults = faults.iter().flat_map(|fault| ["--fault", fault]);
    let air = ["--land", "--airframe", airframe, "--seed", &seed, "--wind", "3"];
    let ended = flight(&air.into_iter().chain(faults).collect::<Vec<_>>()).expect_code(0);
    ended.summary()["conditions"]["touchdown"].clone()
}

const AIRFRAMES: [&str; 5] = ["ultrastick25e", "vtail60", "aerosonde", "rascal110", "zagi"];

/// Gusts of three metres a second in the last metres; an aircraft that goes onto its nose is lost, too.
#[test]
fn aircraft_land_in_moderate_air_and_stay_off_their_noses() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let mission = laps_of_small_mission(folder.path(), 1).display().to_string();
    let (mut lost, mut landed) = (Vec::new(), 0);
    for airframe in AIRFRAMES {
        for seed in 71..if is_long() { 91 } else { 74 } {
            let (seed, from) = (seed.to_string(), (seed * 37 % 360).to_string());
            let air = ["--wind", "3", "--wind-from", &from, "--turbulence", "moderate"];
            let own = ["--land", "--mission", &mission, "--airframe", airframe, "--seed", &seed];
            let summary = flight(&[&own[..], &air[..]].concat()).summary();
            let reason = summary["failure"].as_str().unwrap_or_default();
            if reason.contains("was lost") || reason.contains("came down") {
                lost.push((airframe, seed));
            }
            landed += usize::from(summary["completed"] == true);
        }
    }
    // Two of five were damaged where the normal acceleration was followed down to the ground.
    assert!(landed >= 10 && 12 * lost.len() <= landed, "{lost:?}, {landed} landed");
}

#[test]
fn aircraft_without_one_of_its_rates_or_forces_lands() {
    let _turn = among_others();
    let flights = [
        ("gyroscope_stuck=x@50", 5),
        ("gyroscope_stuck=y@50", 4),
        ("gyroscope_stuck=z@50", 1),
        ("accelerometer_stuck=x@50", 5),
        ("accelerometer_stuck=y@50", 2),
    ];
    for (fault, count) in flights {
        for airframe in &AIRFRAMES[..if is_long() { 5 } else { count }] {
            for seed in 41..if is_long() { 51 } else { 42 } {
                let touchdown = with_faults(airframe, seed, &[fault]);
                assert!(
                    number(&touchdown, "sink_mps") < 2.0,
                    "{airframe}, {fault}, seed {seed}: {touchdown}"
                );
            }
        }
    }
}

/// Steered by the integral of a rate that sticks, 14 of 53 drawn ones were lost.
#[test]
fn light_aircraft_without_its_yaw_rate_rolls_straight_on() {
    let _turn = among_others();
    for seed in if is_long() { 101..161 } else { 103..107 } {
        let (seed, from) = (seed.to_string(), (seed * 37 % 360).to_string());
        let own =
            ["--land", "--airframe", "ultrastick25e", "--seed", &seed, "--fault", "gyroscope_stuck=z@60"];
        let air = ["--wind", "5", "--wind-from", &from, "--turbulence", "light"];
        flight(&[&own[..], &air[..]].concat()).expect_code(0);
    }
}

/// Gusts from behind near the ground: with the margins of a pitot the first one stalled, and one in fifty.
#[test]
fn light_aircraft_without_a_pitot_lands_in_gusts() {
    let _turn = among_others();
    for seed in 2_000_058..if is_long() { 2_000_108 } else { 2_000_060 } {
        let own =
            ["--land", "--airframe", "rascal110", "--seed", &seed.to_string(), "--fault", "pitot_lost@100"];
        let air = ["--wind", "0.46", "--wind-from", "118", "--turbulence", "light"];
        let vary = ["--vary", "mass=10%,inertia=10%,derivatives=20%"];
        flight(&[&own[..], &air[..], &vary[..]].concat()).expect_code(0);
    }
}

/// Nothing but the way through the air tells the heading, and the gyroscope turns it away.
#[test]
fn aircraft_whose_gyroscope_shifts_without_a_magnetometer_flies_on_and_lands() {
    let _turn = among_others();
    for seed in 61..if is_long() { 101 } else { 66 } {
        let degps = [-4.4, 1.0, 2.5, -2.0, 4.8][(seed + seed / 5) % 5];
        let (airframe, at_s) = (AIRFRAMES[seed % 5], 70 + seed % 7 * 20);
        let shift = format!("gyroscope_shift={degps}@{at_s}");
        let touchdown = with_faults(airframe, seed, &["magnetometer_lost@60", &shift]);
        assert!(number(&touchdown, "sink_mps") < 2.0, "{airframe}, {shift}, seed {seed}: {touchdown}");
    }
}

/// The heights that are left may be many metres off: the ground is where it holds the aircraft up.
#[test]
fn aircraft_whose_static_port_is_blocked_lands_and_knows_that_it_stands() {
    let _turn = among_others();
    for seed in 51..if is_long() { 71 } else { 56 } {
        let (airframe, fault) = (AIRFRAMES[seed % 5], ["static_blocked@60", "static_slow=8@60"][seed % 2]);
        let touchdown = with_faults(airframe, seed, &[fault, "range_lost@100"]);
        assert!(touchdown["standing_s"].is_f64(), "{airframe}, {fault}: {touchdown}");
        assert!(number(&touchdown, "sink_mps") < 3.0, "{airframe}, {fault}: {touchdown}");
    }
}

#[test]
fn plan_that_finishes_with_a_landing_lands_without_an_order() {
    let _turn = among_others();
    let mission = tempfile::tempdir().unwrap();
    let path = mission.path().join("mission.toml");
    let text = "laps = 1\nloiter_s = 150\nwaypoint = [\n\
        { north_m = 400, east_m = 0, altitude_m = 100 },\n{ north_m = 0, east_m = 300, altitude_m = 100 },\n]\n";
    std::fs::write(&path, text).unwrap();
    let ended =
        flight(&["--mission", path.to_str().unwrap(), "--set", "controller.finish=land"]).expect_code(0);
    let flown = ended.summary()["conditions"]["touchdown"].clone();
    assert!(number(&flown, "sink_mps") < 1.5, "{flown}: {}", ended.stderr);
}

#[test]
fn aircraft_that_lose_their_power_glide_to_the_runway_and_stand() {
    let _turn = among_others();
    let winds = [("0", "0", "calm"), ("5", "160", "light")];
    for (airframe, (wind, from, turbulence)) in
        ["aerosonde", "rascal110"].iter().flat_map(|it| winds.map(|wind| (it, wind)))
    {
        for fault in ["throttle_stuck=0@75", "throttle_stuck=0@130"] {
            let air = ["--wind", wind, "--wind-from", from, "--turbulence", turbulence, "--fault", fault];
            let ended = flight(&[&["--airframe", airframe, "--seed", "21"], &air[..]].concat());
            let (about, ended) = (format!("{airframe}, {wind} m/s, {fault}"), ended.expect_code(1));
            let touchdown = &ended.summary()["conditions"]["touchdown"];
            assert!(touchdown["standing_s"].is_f64(), "{about}: {touchdown} {}", ended.stderr);
            assert!(number(touchdown, "sink_mps") < 3.5, "{about}: {touchdown}");
            assert!(
                ended.stderr.contains("it landed while flying the laps; the aircraft has no power"),
                "{}",
                ended.stderr
            );
            let told =
                |fault: &&bateleur_tests::Fault| fault.detail.contains("no power: gliding to the runway");
            assert_eq!(ended.faults().iter().filter(told).count(), 1, "{about}");
        }
    }
}

#[test]
fn aircraft_that_lose_their_power_on_the_approach_are_told_so_and_come_down_softly() {
    let _turn = among_others();
    for seed in 41..if is_long() { 61 } else { 43 } {
        let land = |more: &[&str]| landing(seed, &[&["--wind", "3", "--turbulence", "light"], more].concat());
        let sound = land(&[]).expect_code(0).summary()["conditions"]["touchdown"].clone();
        for before_s in [70.0, 45.0, 25.0] {
            let fault = format!("throttle_stuck=0@{}", number(&sound, "time_s") - before_s);
            let ended = land(&["--fault", &fault]);
            let touchdown = ended.summary()["conditions"]["touchdown"].clone();
            let about = format!("seed {seed}, {fault}: {touchdown}");
            assert!(touchdown["standing_s"].is_f64(), "{about}");
            assert!(number(&touchdown, "sink_mps") < 3.5, "{about}");
            let told = |fault: &bateleur_tests::Fault| fault.detail.contains("no power");
            assert!(ended.faults().iter().any(told), "{about}");
        }
    }
}

#[test]
fn what_is_lost_in_flight_has_the_plans_ladder_flown() {
    let _turn = among_others();
    let lost = |set: &[&str], fault: &str| {
        let set: Vec<&str> = set.iter().flat_map(|one| ["--set", one]).collect();
        flight(&[&["--seed", "22", "--wind", "3", "--fault", fault], &set[..]].concat()).expect_code(1)
    };
    let battery = lost(&["command.low_battery=land", "command.low_battery_v=38.5"], "battery=5%@100");
    let touchdown = &battery.summary()["conditions"]["touchdown"];
    assert!(touchdown["standing_s"].is_f64(), "{touchdown} {}", battery.stderr);
    assert!(battery.stderr.contains("it landed while flying the laps"), "{}", battery.stderr);
    for (set, fault, told) in [
        ("command.lost_satellites=return", "gps_lost@90", "the receiver has no fix for 30 s: return"),
        ("command.lost_pitot=return", "pitot_frozen@90", "the pitot is not believed for 10 s: return"),
    ] {
        let ended = lost(&[set], fault);
        let circles = "the aircraft flies back to the runway and circles there";
        assert!(ended.stderr.contains(circles), "{fault}: {}", ended.stderr);
        assert!(ended.stderr.contains(told), "{fault}: {}", ended.stderr);
    }
}
