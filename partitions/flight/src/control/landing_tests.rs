//! Aircraft that the ground holds up, while their heights have them in the air.

use super::*;
use crate::airframe::built_in;
use crate::airframe::tests::aerosonde;
use crate::control::tests::level_state;
use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rand_distr::{Distribution, StandardNormal};

const DT_S: f64 = 0.02;
const WITHIN_S: f64 = 30.0;

/// A frame of a landing with power; whether a range finder has measured the height.
fn frame_of(
    landing: &mut Landing,
    (airframe, envelope): (&Airframe, &Envelope),
    height: (&NavigationState, bool),
    s: &Signals,
) -> Flown {
    let config = LandingConfig::default();
    landing.step((airframe, envelope, &config), height, (s, 0.0), (150.0, 22.0), None, DT_S)
}

/// A landing that stands in a phase; time until it has found the ground, s. `sinks`: with the vertical speed asked for, and gusts.
fn found_s(phase: Phase, seed: u64, sinks: bool) -> Option<f64> {
    let airframe = aerosonde();
    let (envelope, config) = (Envelope::new(&airframe), LandingConfig::default());
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let mut between =
        |low: f64, high: f64| low + (high - low) * f64::from(chance.next_u32()) / f64::from(u32::MAX);
    let stall_mps = envelope.stall_mps(&airframe, 1.2);
    // On the ground it may be anywhere; so slow that no wing carries it, where it was to climb.
    let (height_m, most_mps) = match phase {
        Phase::Round => (between(0.0, 40.0), 0.8 * stall_mps),
        _ => (between(9.0, 30.0), 1.5 * stall_mps),
    };
    let (flown_mps, airspeed_mps) =
        (between(if phase == Phase::Round { 0.0 } else { 4.0 }, most_mps), between(0.0, 60.0));
    // On its slope, and not down before the time is over.
    let (flown_mps, height_m) =
        if sinks { (1.5 * stall_mps, height_m + 30.0) } else { (flown_mps, height_m) };
    let mut state = level_state();
    (state.velocity, state.wind) = (Vector3::new(flown_mps, 0.0, 0.0), Vector2::zeros());
    let north_m = if sinks { -height_m / config.slope_rad.tan() } else { between(-200.0, -50.0) };
    state.position = Vector3::new(north_m, 0.0, -height_m);
    let mut landing = Landing::new(&config, &state, 90.0, Vector2::zeros());
    (landing.phase, landing.rounds) = (phase, MOST_ROUNDS);
    let s = Signals { airspeed_mps, density_kgpm3: 1.2, normal_mps2: -GRAVITY_MPS2, ..Signals::default() };
    for frame in 0..(WITHIN_S / DT_S) as u32 {
        let flown = frame_of(&mut landing, (&airframe, &envelope), (&state, false), &s);
        if landing.is_on_ground() {
            return Some(f64::from(frame) * DT_S);
        }
        let gust_mps: f64 = StandardNormal.sample(&mut chance);
        let asked_mps = match flown {
            Flown::Loops(approach) => approach.climb_mps,
            _ => 3.0,
        };
        if sinks {
            state.velocity.z +=
                ((0.5 * gust_mps - asked_mps - state.velocity.z) * DT_S / 0.5).clamp(-0.2, 0.2);
            state.position += state.velocity * DT_S;
        } else {
            state.position.x += flown_mps * DT_S;
        }
    }
    None
}

#[test]
fn aircraft_that_the_ground_holds_up_knows_it_whatever_its_heights_and_its_pitot_say() {
    for phase in [Phase::Final, Phase::Round] {
        for seed in 0..200 {
            let found = found_s(phase, seed, false);
            assert!(found.is_some_and(|found_s| found_s < 25.0), "{phase:?}, seed {seed}: {found:?}");
        }
    }
}

#[test]
fn aircraft_that_sinks_through_gusts_or_climbs_away_is_not_on_the_ground() {
    for phase in [Phase::Final, Phase::Round] {
        for seed in 0..200 {
            let found = found_s(phase, seed, true);
            assert!(found.is_none(), "{phase:?}, seed {seed}: {found:?}");
        }
    }
}

/// A flare whose range finder has the ground metres too low, so that the heights are never low; time until it has found the ground, s. On the
/// ground the height bounces, and the vertical speed strays from it; in the air it sinks as it is asked to.
fn flare_found_s(seed: u64, on_ground: bool) -> Option<f64> {
    let airframe = aerosonde();
    let (envelope, config) = (Envelope::new(&airframe), LandingConfig::default());
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let mut normal = || -> f64 { StandardNormal.sample(&mut chance) };
    let mut state = level_state();
    (state.velocity, state.wind) = (Vector3::new(16.0, 0.0, 0.0), Vector2::zeros());
    let stray_mps = 0.2 * normal();
    let low_m = 4.6 + normal().abs();
    state.position = Vector3::new(-20.0, 0.0, if on_ground { -low_m } else { -6.0 });
    let mut landing = Landing::new(&config, &state, 50.0, Vector2::zeros());
    (landing.phase, landing.rounds) = (Phase::Flare, MOST_ROUNDS);
    let s =
        Signals { airspeed_mps: 16.0, density_kgpm3: 1.2, normal_mps2: -GRAVITY_MPS2, ..Signals::default() };
    let (mut bump_m, mut bump_mps) = (0.0, 0.0);
    for frame in 0..1_000 {
        let flown = frame_of(&mut landing, (&airframe, &envelope), (&state, true), &s);
        if landing.is_on_ground() {
            return Some(f64::from(frame) * DT_S);
        }
        let Flown::Loops(approach) = flown else { return None };
        if on_ground {
            // Bumps of a decimetre, a second long.
            bump_mps += DT_S * (-40.0 * bump_m - 2.0 * bump_mps) + 0.12 * normal();
            bump_m += DT_S * bump_mps;
            (state.position.z, state.velocity.z) = (-low_m - bump_m, stray_mps - bump_mps);
        } else {
            state.velocity.z += ((-approach.climb_mps - state.velocity.z) * DT_S / 0.5) + 0.05 * normal();
            state.position.z += state.velocity.z * DT_S;
            if state.altitude_m() < 1.2 {
                return None;
            }
        }
    }
    None
}

#[test]
fn ground_under_a_range_finder_that_sees_it_too_low_is_found_over_bumps() {
    for seed in 0..200 {
        let found = flare_found_s(seed, true);
        assert!(found.is_some_and(|found_s| found_s < 7.0), "seed {seed}: {found:?}");
        let found = flare_found_s(seed, false);
        assert!(found.is_none(), "in the air, seed {seed}: {found:?}");
    }
}

#[test]
fn nose_wheel_is_kept_off_the_ground_where_nothing_damps_the_pitch() {
    for name in ["aerosonde", "rascal110", "ultrastick25e", "vtail60", "zagi"] {
        let airframe = Airframe::from_toml(built_in(name).unwrap()).unwrap();
        let landing = landing_in(Phase::Touched);
        let pitch_rad = |pitches_blind| {
            let s = Signals { pitches_blind, ..Signals::default() };
            match landing.on_wheels(&airframe, &s, false) {
                Aim::Attitude { pitch_rad, .. } => pitch_rad,
                Aim::Climb { .. } => f64::NAN,
            }
        };
        let nose = !wheels::has_tail_wheel(&airframe);
        assert_eq!(nose, pitch_rad(true) >= wheels::stance_rad(&airframe) + OFF_NOSE_WHEEL_RAD, "{name}");
        assert_eq!(!nose, pitch_rad(false) < 0.0, "{name}");
    }
    let stance_rad = wheels::stance_rad(&aerosonde());
    assert!((stance_rad - (0.06f64 / 0.61).atan()).abs() < 1e-12, "{stance_rad}");
}

/// Rising air holds it up at 40 m for some seconds, and the pitot says that it is too slow to fly.
#[test]
fn aircraft_that_rising_air_held_up_goes_on_with_its_approach() {
    let airframe = aerosonde();
    let (envelope, config) = (Envelope::new(&airframe), LandingConfig::default());
    let mut state = level_state();
    state.position = Vector3::new(-100.0, 0.0, -40.0);
    let mut landing = Landing::new(&config, &state, 50.0, Vector2::zeros());
    (landing.phase, landing.rounds) = (Phase::Final, MOST_ROUNDS);
    let s =
        Signals { airspeed_mps: 5.0, density_kgpm3: 1.2, normal_mps2: -GRAVITY_MPS2, ..Signals::default() };
    let mut seen = Vec::new();
    for frame in 0..400 {
        state.velocity.z = if frame < 230 { 0.0 } else { 1.5 };
        state.position.z += state.velocity.z * DT_S;
        frame_of(&mut landing, (&airframe, &envelope), (&state, false), &s);
        if seen.last() != Some(&landing.phase) {
            seen.push(landing.phase);
        }
    }
    assert_eq!(seen, [Phase::Final, Phase::Touched, Phase::Final]);
}

/// A frame of a landing, with these velocity and wind along its course, m/s.
fn stepped(
    airframe: &Airframe,
    landing: &mut Landing,
    airspeed_mps: f64,
    flown_mps: f64,
    wind_mps: f64,
) -> Flown {
    let mut state = level_state();
    state.position = Vector3::new(-300.0, 0.0, -20.0);
    (state.velocity, state.wind) = (Vector3::new(flown_mps, 0.0, 0.0), Vector2::new(wind_mps, 0.0));
    let s = Signals { airspeed_mps, density_kgpm3: 1.2, normal_mps2: -GRAVITY_MPS2, ..Signals::default() };
    frame_of(landing, (airframe, &Envelope::new(airframe)), (&state, false), &s)
}

fn landing_in(phase: Phase) -> Landing {
    let mut landing = Landing::new(&LandingConfig::default(), &level_state(), 50.0, Vector2::zeros());
    (landing.phase, landing.course_rad, landing.rounds) = (phase, 0.0, MOST_ROUNDS);
    landing
}

#[test]
fn approach_keeps_what_a_gust_from_ahead_gives_and_asks_no_less_for_one_from_behind() {
    let asked_mps = |gust_mps: f64| match stepped(
        &aerosonde(),
        &mut landing_in(Phase::Final),
        18.0,
        14.0 - gust_mps,
        -4.0,
    ) {
        Flown::Loops(approach) => approach.airspeed_mps.unwrap(),
        other => panic!("{other:?}"),
    };
    let still_mps = asked_mps(0.0);
    assert!((asked_mps(3.0) - still_mps - 3.0).abs() < 1e-9);
    assert!((asked_mps(9.0) - still_mps - MOST_FOR_SHEAR_MPS).abs() < 1e-9);
    assert_eq!(asked_mps(-3.0), still_mps);
}

/// With the elevator up it would fly again, with a neutral one go onto its nose.
#[test]
fn tail_is_held_where_it_stands_in_a_strong_wind_and_goes_down_where_it_rolls() {
    let rascal = Airframe::from_toml(built_in("rascal110").unwrap()).unwrap();
    let stall_mps = Envelope::new(&rascal).stall_mps(&rascal, 1.2);
    let mut landing = landing_in(Phase::Rolling);
    let mut goes_down = |airspeed: f64, flown_mps: f64, wind: f64| match stepped(
        &rascal,
        &mut landing,
        airspeed * stall_mps,
        flown_mps,
        -wind * stall_mps,
    ) {
        Flown::Wheels(command) => {
            assert!(command.elevator_rad < 0.0);
            true
        }
        Flown::Loops(Approach { aim: Some(Aim::Attitude { .. }), bank_rad: 0.0, .. }) => false,
        other => panic!("{other:?}"),
    };
    for (airspeed, wind, down) in [(0.9, 0.9, false), (0.9, 0.5, false), (0.7, 0.9, false), (0.7, 0.5, true)]
    {
        assert_eq!(goes_down(airspeed, 1.0, wind), down, "{airspeed}, {wind}");
        assert!(goes_down(airspeed, 5.0, wind), "{airspeed}, {wind}, rolling");
    }
}

#[test]
fn flare_that_begins_at_the_wrong_place_comes_down_nearer_to_the_right_one() {
    for slope_mps in [0.8, 1.2, 1.8] {
        let whole_s = float_s(FLARE_M, slope_mps);
        for percent in (70..=140).step_by(5) {
            let place_s = whole_s * f64::from(percent) / 100.0;
            let (mut height_m, mut sink_mps, mut time_s) = (FLARE_M, slope_mps, 0.0);
            while height_m > STANDING_HEIGHT_M {
                let asked_mps = flare_to_mps(height_m, slope_mps, Some(place_s - time_s), true);
                sink_mps = low_pass(sink_mps, asked_mps, SINKS_LATE_S, DT_S);
                (height_m, time_s) = (height_m - sink_mps * DT_S, time_s + DT_S);
            }
            let (off_s, before_s) = ((time_s - place_s).abs(), (whole_s - place_s).abs());
            assert!(off_s < 0.7 * before_s + 0.4, "{slope_mps} m/s, {percent} %: {off_s} of {before_s} s");
            assert!(sink_mps < 1.2 * TOUCH_SINK_MPS, "{slope_mps} m/s, {percent} %: {sink_mps}");
        }
    }
}
