//! Pitots that are wrong in random ways, on an aircraft whose lift follows its elevator.

use super::*;
use crate::GRAVITY_MPS2;
use crate::airframe::tests::aerosonde;
use crate::airframe::{Airframe, built_in};
use crate::kept::tests::again;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

const DT_S: f64 = 0.02;

/// What a pitot makes of an airspeed, `since_s` after it broke.
type Wrong = fn(f64, f64, &mut World) -> f64;

/// Airspeed that wanders with gusts; the elevator is the one that carries the load, as the airframe file has it but for a factor.
struct World {
    airframe: Airframe,
    chance: ChaCha8Rng,
    airspeed_mps: f64,
    gust_mps: f64,
    load: f64,
    lie: f64,
    held_mps: f64,
}

impl World {
    fn new(airframe: &Airframe, seed: u64) -> Self {
        let mut world = Self {
            airframe: *airframe,
            chance: ChaCha8Rng::seed_from_u64(seed),
            airspeed_mps: 22.0,
            gust_mps: 0.0,
            load: 1.0,
            lie: 1.0,
            held_mps: 0.0,
        };
        world.lie = 1.0 + 0.15 * (2.0 * world.unit() - 1.0);
        world
    }

    fn unit(&mut self) -> f64 {
        f64::from(self.chance.next_u32()) / f64::from(u32::MAX)
    }

    fn noise(&mut self) -> f64 {
        (0..12).map(|_| self.unit()).sum::<f64>() - 6.0
    }

    /// The true airspeed, and what a sound pitot makes of it.
    fn step(&mut self) -> Frame {
        let gust = self.noise();
        self.gust_mps += -self.gust_mps * DT_S / 10.0 + 2.3 * (2.0 * DT_S / 10.0).sqrt() * gust;
        self.load = low_pass(self.load, 1.0 + 0.5 * self.unit(), 2.0, DT_S);
        let true_mps = (self.airspeed_mps + self.gust_mps).max(12.0);
        let (a, m, g) = (&self.airframe.aerodynamics, &self.airframe.mass, &self.airframe.geometry);
        let normal_mps2 = -self.load * GRAVITY_MPS2;
        let lift = 2.0 * m.mass_kg * self.load * GRAVITY_MPS2 / (1.2 * g.wing_area_m2);
        // The coefficient that carries it, and the elevator that holds its angle of attack.
        let coefficient = lift / (true_mps * true_mps) * self.lie;
        let slope = a.lift_alpha * a.pitch_elevator / a.pitch_alpha - a.lift_elevator;
        let level = a.lift_0 - a.lift_alpha * a.pitch_0 / a.pitch_alpha;
        let elevator_rad = (level - coefficient) / slope + 0.002 * self.noise();
        Frame {
            apart_mps: 0.0,
            away: 0.0,
            learnt_mps: None,
            pitot_mps: Some(true_mps + 0.08 * self.noise()),
            density_kgpm3: 1.2,
            elevator_rad,
            pitch_rate_radps: 0.0,
            normal_mps2,
            change_mps2: 0.0,
            flying: true,
            judged: true,
            dt_s: DT_S,
        }
    }
}

fn airframes() -> Vec<Airframe> {
    let rascal = Airframe::from_toml(built_in("rascal110").unwrap()).unwrap();
    vec![aerosonde(), rascal]
}

/// Flies for some seconds; the time at which the pitot was rejected, s.
fn fly(world: &mut World, watch: &mut AirspeedWatch, seconds: f64, wrong: Option<Wrong>) -> Option<f64> {
    let airframe = world.airframe;
    (0..(seconds / DT_S) as u32).find_map(|frame| {
        let since_s = f64::from(frame) * DT_S;
        let mut now = world.step();
        if let (Some(wrong), Some(true_mps)) = (wrong, now.pitot_mps) {
            now.pitot_mps = Some(wrong(true_mps, since_s, world).max(0.0));
        }
        watch.step(&airframe, &now);
        (!watch.is_believed()).then_some(since_s)
    })
}

#[test]
fn sound_pitot_in_gusts_is_believed_whatever_the_airframe_file_has_wrong() {
    for airframe in airframes() {
        for seed in 0..60 {
            let (mut world, mut watch) = (World::new(&airframe, seed), AirspeedWatch::default());
            let rejected = fly(&mut world, &mut watch, 300.0, None);
            assert_eq!(rejected, None, "seed {seed}, the file is {} of the truth", world.lie);
        }
    }
}

#[test]
fn pitots_that_are_wrong_in_any_way_are_found_in_seconds() {
    let kinds: [(&str, f64, Wrong); 6] = [
        ("zero", 3.0, |_, _, _| 0.0),
        ("leaks", 8.0, |true_mps, _, _| 0.75 * true_mps),
        ("reads too much", 8.0, |true_mps, _, _| 1.3 * true_mps),
        ("ices", 15.0, |true_mps, since_s, _| true_mps - 0.5 * since_s),
        ("noisy", 3.0, |true_mps, _, world| true_mps + 3.0 * world.noise()),
        ("frozen", 1.0, |true_mps, since_s, world| {
            if since_s == 0.0 {
                world.held_mps = true_mps;
            }
            world.held_mps
        }),
    ];
    for airframe in airframes() {
        for (name, within_s, wrong) in kinds {
            for seed in 0..20 {
                let (mut world, mut watch) = (World::new(&airframe, seed), AirspeedWatch::default());
                assert_eq!(fly(&mut world, &mut watch, 60.0, None), None, "{name}, seed {seed}");
                let found_s = fly(&mut world, &mut watch, 60.0, Some(wrong));
                // An elevator that tells the lift badly is averaged for longer.
                let within_s = within_s * watch.longer(&airframe);
                assert!(found_s.is_some_and(|s| s < within_s), "{name}, seed {seed}: {found_s:?}");
            }
        }
    }
}

/// Gains that are made for a third of the airspeed lose the aircraft before the verdict.
#[test]
fn what_is_flown_on_until_the_verdict_is_never_far_below_the_airspeed() {
    for airframe in airframes() {
        for seed in 0..40 {
            let (mut world, mut watch) = (World::new(&airframe, seed), AirspeedWatch::default());
            fly(&mut world, &mut watch, 60.0, None);
            let mut least = f64::INFINITY;
            let falls_mps2 = 0.2 * (1.0 + seed as f64);
            for frame in 0..1_500 {
                let now = world.step();
                let true_mps = now.pitot_mps.unwrap();
                let told_mps = (true_mps - falls_mps2 * DT_S * f64::from(frame)).max(0.0);
                let flown = watch.step(&airframe, &Frame { pitot_mps: Some(told_mps), ..now }).unwrap();
                least = least.min(flown / true_mps);
            }
            assert!(least > 0.45, "seed {seed}: {least} of the airspeed");
        }
    }
}

#[test]
fn pitot_that_agrees_again_is_taken_back_and_lift_tells_the_airspeed_until_then() {
    let (mut world, mut watch) = (World::new(&aerosonde(), 5), AirspeedWatch::default());
    let airframe = world.airframe;
    fly(&mut world, &mut watch, 60.0, None);
    fly(&mut world, &mut watch, 60.0, Some(|_, _, _| 0.0));
    assert!(!watch.is_believed());
    let mut worst = 0.0_f64;
    let back = (0..5_000).find(|_| {
        let now = world.step();
        let flown = watch.step(&airframe, &now).unwrap();
        worst = worst.max((flown - now.pitot_mps.unwrap()).abs());
        watch.is_believed()
    });
    let back_s = f64::from(back.unwrap()) * DT_S;
    assert!((25.0..60.0).contains(&back_s), "{back_s}");
    assert!(worst < 3.5, "{worst} m/s off");
}

#[test]
fn pitot_that_moves_away_from_the_inertial_values_is_found_sooner_and_a_gust_is_none() {
    for airframe in airframes() {
        for seed in 0..10 {
            // Moved away for so long of each ten seconds, s; and what the pitot tells of the airspeed.
            let found_s = |apart_s: f64, share: f64| {
                let (mut world, mut watch) = (World::new(&airframe, seed), AirspeedWatch::default());
                fly(&mut world, &mut watch, 60.0, None);
                (0..(60.0 / DT_S) as u32).map(|frame| f64::from(frame) * DT_S).find(|since_s| {
                    let now = world.step();
                    let apart_mps = if since_s % 10.0 < apart_s { -6.0 } else { 0.0 };
                    let pitot_mps = now.pitot_mps.map(|true_mps| share * true_mps);
                    watch.step(&airframe, &Frame { apart_mps, pitot_mps, ..now });
                    !watch.is_believed()
                })
            };
            assert_eq!(found_s(1.5, 1.0), None, "seed {seed}: sound, in gusts");
            let (alone_s, both_s) = (found_s(0.0, 0.8), found_s(10.0, 0.8).unwrap());
            assert!(alone_s.is_none_or(|alone_s| both_s < alone_s), "seed {seed}: {alone_s:?}, {both_s}");
        }
    }
}

#[test]
fn pitot_that_comes_away_from_satellites_and_wind_is_found_sooner_and_a_gust_is_none() {
    for airframe in airframes() {
        for seed in 0..10 {
            // Away by so much for so long of each ten seconds, s; and what the pitot tells of the airspeed.
            let found_s = |away: f64, away_s: f64, share: f64| {
                let (mut world, mut watch) = (World::new(&airframe, seed), AirspeedWatch::default());
                fly(&mut world, &mut watch, 60.0, None);
                (0..(60.0 / DT_S) as u32).map(|frame| f64::from(frame) * DT_S).find(|since_s| {
                    let now = world.step();
                    let away = if since_s % 10.0 < away_s { away } else { 0.0 };
                    let pitot_mps = now.pitot_mps.map(|true_mps| share * true_mps);
                    watch.step(&airframe, &Frame { away, pitot_mps, ..now });
                    !watch.is_believed()
                })
            };
            for away in [-2.0, 2.0] {
                assert_eq!(found_s(away, 1.5, 1.0), None, "seed {seed}: sound, in gusts");
            }
            let (alone_s, both_s) = (found_s(0.0, 0.0, 0.8), found_s(-1.1, 10.0, 0.8).unwrap());
            assert!(alone_s.is_none_or(|alone_s| both_s < alone_s), "seed {seed}: {alone_s:?}, {both_s}");
        }
    }
}

#[test]
fn where_lift_tells_nothing_satellites_and_wind_find_the_pitot_but_not_before_it_could_have_told() {
    let airframe = aerosonde();
    for away in [-2.0, -1.1, 0.0, 1.1, 2.0] {
        let (mut world, mut watch) = (World::new(&airframe, 8), AirspeedWatch::default());
        let found = (0..3_000).find(|_| {
            // An elevator that is down tells of no lift at all.
            let now = Frame { away, elevator_rad: 0.3, ..world.step() };
            watch.step(&airframe, &now);
            assert_eq!(watch.by_lift_mps(), None);
            !watch.is_believed()
        });
        let found_s = found.map(|frame| f64::from(frame) * DT_S);
        let expected = if away.abs() > 1.5 { Some(SETTLED_S + PATIENCE_S) } else { None };
        let near = |(is_s, should_s): (f64, f64)| (is_s - should_s).abs() < 0.1;
        assert!(found_s.zip(expected).map_or(found_s == expected, near), "{away}: {found_s:?}");
    }
}

#[test]
fn lift_that_tells_another_airspeed_than_before_is_learnt_anew_without_a_pitot_and_forgotten_with_it() {
    for airframe in airframes() {
        let off = |learns: bool, flying: bool| {
            let (mut world, mut watch) = (World::new(&airframe, 7), AirspeedWatch::default());
            fly(&mut world, &mut watch, 60.0, None);
            let factor = watch.factor;
            // The aircraft flies at another lift, of which the file has more wrong.
            world.lie *= 1.3;
            let mut told = Vec::new();
            for _ in 0..12_000 {
                let now = world.step();
                let learnt_mps = now.pitot_mps.filter(|_| learns);
                let frame = Frame { pitot_mps: None, learnt_mps, flying, ..now };
                watch.step(&airframe, &frame);
                told.push(watch.by_lift_mps().unwrap_or(0.0) / now.pitot_mps.unwrap());
            }
            assert_eq!(watch.factor, factor);
            let off = told[9_000..].iter().sum::<f64>() / 3_000.0 - 1.0;
            let now = world.step();
            watch.step(&airframe, &now);
            assert!(watch.is_believed() && watch.correction == 1.0, "it was only silent");
            off
        };
        assert!(off(true, true).abs() < 0.05 && off(false, true).abs() > 0.08, "{}", off(true, true));
        assert_eq!(off(true, false), off(false, false), "nothing is learnt while nobody flies");
    }
}

#[test]
fn verdict_outlives_a_restart_and_nonsense_does_not() {
    let (mut world, mut watch) = (World::new(&aerosonde(), 6), AirspeedWatch::default());
    fly(&mut world, &mut watch, 60.0, None);
    fly(&mut world, &mut watch, 10.0, Some(|_, _, _| 0.0));
    assert!(!watch.is_believed() && watch.by_lift_mps().is_some());
    assert_eq!(again(&watch), Some(watch));
    for factor in [-1.0, 0.0, 9.0] {
        assert_eq!(again(&AirspeedWatch { factor, ..watch }), None, "{factor}");
    }
}

#[test]
fn nothing_is_said_while_others_move_the_elevator() {
    let (mut world, mut watch) = (World::new(&aerosonde(), 7), AirspeedWatch::default());
    let airframe = world.airframe;
    for _ in 0..3_000 {
        let frame = Frame { pitot_mps: Some(3.0), flying: false, ..world.step() };
        assert_eq!(watch.step(&airframe, &frame), Some(3.0));
    }
    assert!(watch.is_believed());
}

/// A blocked pitot falls in a descent: what opens the throttle for it has loops at the wrong gains before lift alone has told.
#[test]
fn pitot_that_lift_and_inertial_values_speak_against_is_not_flown_on_before_the_verdict() {
    let zagi = Airframe::from_toml(built_in("zagi").unwrap()).unwrap();
    for airframe in airframes().into_iter().chain([zagi]) {
        for seed in 0..20 {
            let (mut world, mut watch) = (World::new(&airframe, seed), AirspeedWatch::default());
            fly(&mut world, &mut watch, 60.0, None);
            let sound_mps = world.step().pitot_mps.unwrap();
            for share in [0.3, 0.5, 0.65] {
                let flown_mps = watch.flown_mps(Some(share * sound_mps), (share - 1.0) * sound_mps).unwrap();
                assert!(flown_mps > 0.7 * sound_mps, "seed {seed}: {flown_mps} m/s of {sound_mps} m/s");
            }
            assert_eq!(watch.flown_mps(Some(sound_mps), 0.0), Some(sound_mps), "seed {seed}");
            // Fast, where the lift coefficient is small.
            for _ in 0..100 {
                world.airspeed_mps *= 1.005;
                fly(&mut world, &mut watch, 0.3, None);
            }
            let sound_mps = world.step().pitot_mps.unwrap();
            let flown_mps = watch.flown_mps(Some(0.3 * sound_mps), -0.7 * sound_mps).unwrap();
            assert!(flown_mps > 0.5 * sound_mps, "seed {seed}: {flown_mps} m/s of {sound_mps} m/s");
        }
    }
}

#[test]
fn pitot_that_is_silent_is_not_believed_until_it_speaks_again() {
    let (mut world, mut watch) = (World::new(&aerosonde(), 8), AirspeedWatch::default());
    let airframe = world.airframe;
    fly(&mut world, &mut watch, 60.0, None);
    for silent_s in [0.4, 0.9, 1.1, 20.0] {
        for _ in 0..(silent_s / DT_S) as u32 {
            let frame = Frame { pitot_mps: None, ..world.step() };
            assert!(watch.step(&airframe, &frame).is_some());
        }
        assert_eq!(watch.is_believed(), silent_s < 1.0, "{silent_s} s");
        world.airspeed_mps += 8.0;
        fly(&mut world, &mut watch, 0.1, None);
        assert!(watch.is_believed(), "{silent_s} s");
        world.airspeed_mps -= 8.0;
    }
    // On the ground lift says nothing more, and the pitot is as silent as before.
    for _ in 0..100 {
        watch.step(&airframe, &Frame { pitot_mps: None, judged: false, ..world.step() });
    }
    assert!(!watch.is_believed() && watch.by_lift_mps().is_some());
    watch.step(&airframe, &Frame { pitot_mps: None, flying: false, ..world.step() });
    assert!(!watch.is_believed() && watch.by_lift_mps().is_none());
    watch.step(&airframe, &Frame { flying: false, ..world.step() });
    assert!(watch.is_believed());
}
