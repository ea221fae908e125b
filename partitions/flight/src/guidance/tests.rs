//! Guidance on a point mass that does what it is told: order, capture, corners.

use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

struct Flight {
    motion: Motion,
    airspeed: f64,
    heading: f64,
}

impl Flight {
    fn new(north: f64, east: f64, heading: f64, wind: Vector2<f64>) -> Self {
        let mut flight = Self {
            motion: Motion { position: Vector2::new(north, east), velocity: Vector2::zeros(), wind },
            airspeed: 22.0,
            heading,
        };
        flight.step(0.0);
        flight
    }

    /// Turns the air velocity as bank would, without lag.
    fn step(&mut self, acceleration: f64) {
        let dt = 0.02;
        self.heading += acceleration / self.airspeed * dt;
        let air = Vector2::new(self.heading.cos(), self.heading.sin()) * self.airspeed;
        self.motion.velocity = air + self.motion.wind;
        self.motion.position += self.motion.velocity * dt;
    }
}

fn fly(guidance: &mut Guidance, flight: &mut Flight, seconds: f64) -> Vec<(usize, f64)> {
    let mut order = Vec::new();
    for _ in 0..(seconds / 0.02) as usize {
        let before = guidance.reached;
        let next = guidance.next;
        let out = guidance.step(&flight.motion);
        if guidance.reached > before {
            order.push((next, out.cross_track_m));
        }
        flight.step(out.horizontal_mps2);
    }
    order
}

fn circuit(config: GuidanceConfig) -> Guidance {
    Guidance::new(config, &seed_waypoints()).unwrap()
}

#[test]
fn way_points_are_reached_in_order_for_two_laps() {
    let mut guidance = circuit(GuidanceConfig { laps: 2, lead_s: 0.0, ..GuidanceConfig::default() });
    let mut flight = Flight::new(0.0, 0.0, 0.0, Vector2::new(0.0, 5.0));
    let order: Vec<usize> = fly(&mut guidance, &mut flight, 200.0).iter().map(|x| x.0).collect();
    assert_eq!(order[..9], [0, 1, 2, 3, 0, 1, 2, 3, 0]);
    assert!(guidance.step(&flight.motion).finished);
}

#[test]
fn fly_through_passes_the_way_points_themselves() {
    let config = GuidanceConfig { corner: Corner::FlyThrough, lead_s: 0.0, ..GuidanceConfig::default() };
    let mut guidance = circuit(config);
    let mut flight = Flight::new(0.0, 0.0, 0.0, Vector2::zeros());
    let mut closest = f64::INFINITY;
    for _ in 0..(60.0 / 0.02) as usize {
        let out = guidance.step(&flight.motion);
        closest = closest.min((flight.motion.position - Vector2::new(500.0, 500.0)).norm());
        flight.step(out.horizontal_mps2);
    }
    assert!(closest < 2.0, "{closest}");
    assert!(guidance.reached >= 2);
}

#[test]
fn any_place_and_heading_leads_to_the_first_way_point_first() {
    for place in 0..8 {
        for heading in 0..6 {
            let bearing = f64::from(place) * 0.8;
            let (north, east) = (400.0 * bearing.cos() + 250.0, 900.0 * bearing.sin());
            let mut guidance = circuit(GuidanceConfig { lead_s: 0.0, ..GuidanceConfig::default() });
            let mut flight = Flight::new(north, east, f64::from(heading), Vector2::new(-4.0, 3.0));
            let order = fly(&mut guidance, &mut flight, 250.0);
            let seen: Vec<usize> = order.iter().map(|x| x.0).take(5).collect();
            assert_eq!(seen, [0, 1, 2, 3, 0], "from {north:.0} {east:.0} heading {heading}");
        }
    }
}

#[test]
fn radius_grows_with_the_wind() {
    let guidance = circuit(GuidanceConfig::default());
    assert_eq!(guidance.radius_m(&Vector2::zeros()), 70.0);
    let windy = guidance.radius_m(&Vector2::new(8.0, 0.0));
    assert!((105.0..125.0).contains(&windy), "{windy}");
}

#[test]
fn snapshot_goes_on_to_the_same_way_point() {
    let mut guidance = circuit(GuidanceConfig::default());
    let mut flight = Flight::new(0.0, 0.0, 0.0, Vector2::zeros());
    fly(&mut guidance, &mut flight, 60.0);
    let mut restarted = circuit(GuidanceConfig::default());
    restarted.resume(&guidance.snapshot());
    assert_eq!((restarted.next, restarted.reached), (guidance.next, guidance.reached));
    assert!(guidance.reached >= 2);
    let order = fly(&mut restarted, &mut flight, 60.0);
    assert_eq!(order[0].0, guidance.next);
}

#[test]
fn bad_missions_are_refused() {
    assert_eq!(Guidance::new(GuidanceConfig::default(), &[]).unwrap_err(), GuidanceError::Empty);
    let mut waypoints = seed_waypoints();
    waypoints[2].north_m = f64::NAN;
    let error = Guidance::new(GuidanceConfig::default(), &waypoints).unwrap_err();
    assert_eq!(error, GuidanceError::Value { index: 2 });
    let error = Guidance::new(GuidanceConfig::default(), &[seed_waypoints()[0]; 33]).unwrap_err();
    assert_eq!(error, GuidanceError::TooMany { count: 33 });
}

#[test]
fn cross_track_law_turns_towards_the_track() {
    let leg = Leg { from: Vector2::zeros(), to: Vector2::new(500.0, 0.0) };
    let north = Vector2::new(22.0, 0.0);
    assert!(track_acceleration(&leg.offset(&Vector2::new(100.0, 10.0)), &north, 0.0, 1.0) < 0.0);
    assert!(track_acceleration(&leg.offset(&Vector2::new(100.0, -10.0)), &north, 0.0, 1.0) > 0.0);
    let away = track_acceleration(&leg.offset(&Vector2::new(100.0, 0.0)), &-north, 0.0, 1.0);
    assert_eq!(away.abs(), HORIZONTAL_LIMIT_MPS2, "flying backwards it turns round");
}

/// Distance from a circle's centre over time, after it was reached.
fn held(guidance: &mut Guidance, flight: &mut Flight, seconds: f64) -> (f64, f64) {
    let (mut least, mut most) = (f64::INFINITY, 0.0f64);
    for _ in 0..(seconds / 0.02) as usize {
        let out = guidance.step(&flight.motion);
        assert!(out.holding);
        if out.on_arc && out.cross_track_m.abs() < 0.9 * out.radius_m {
            least = least.min(out.cross_track_m);
            most = most.max(out.cross_track_m);
        }
        flight.step(out.horizontal_mps2);
    }
    (least, most)
}

#[test]
fn mission_ends_in_a_circle_where_its_last_way_point_was() {
    for corner in [Corner::Fillet, Corner::FlyThrough] {
        let config = GuidanceConfig { corner, laps: 1, ..GuidanceConfig::default() };
        let mut guidance = circuit(config);
        let mut flight = Flight::new(0.0, 0.0, 0.0, Vector2::new(0.0, 3.0));
        while !guidance.step(&flight.motion).finished {
            let out = guidance.step(&flight.motion);
            flight.step(out.horizontal_mps2);
        }
        let at = flight.motion.position;
        held(&mut guidance, &mut flight, 10.0);
        let (least, most) = held(&mut guidance, &mut flight, 120.0);
        assert!(least > -6.0 && most < 6.0, "{corner:?}: {least} {most}");
        assert!((flight.motion.position - at).norm() < 260.0, "{corner:?}");
        assert_eq!((guidance.reached, guidance.next), (5, 1));
        let altitude = guidance.step(&flight.motion).altitude_m;
        assert_eq!(altitude, 160.0);
    }
}

#[test]
fn mission_may_go_round_for_ever() {
    let mut guidance =
        circuit(GuidanceConfig { laps: 1, finish: Finish::Circuit, ..GuidanceConfig::default() });
    let mut flight = Flight::new(0.0, 0.0, 0.0, Vector2::zeros());
    let order = fly(&mut guidance, &mut flight, 200.0);
    assert!(order.len() > 8 && guidance.step(&flight.motion).finished);
    assert!(!guidance.step(&flight.motion).holding);
}

#[test]
fn circle_far_away_is_joined_along_its_tangent_from_any_side() {
    for (north, east, heading) in
        [(900.0, 0.0, 0.0), (0.0, -800.0, 1.0), (-700.0, 500.0, 3.0), (30.0, 40.0, 2.0)]
    {
        let mut guidance = circuit(GuidanceConfig::default());
        let mut flight = Flight::new(north, east, heading, Vector2::new(4.0, -3.0));
        guidance.hold_at(&Vector2::zeros(), &flight.motion, 120.0, 20.0);
        held(&mut guidance, &mut flight, 75.0);
        let (least, most) = held(&mut guidance, &mut flight, 100.0);
        assert!(least > -6.0 && most < 6.0, "from {north} {east}: {least} {most}");
        let out = guidance.step(&flight.motion);
        assert_eq!((out.altitude_m, out.airspeed_mps), (120.0, 20.0));
        let radius_m = guidance.held().unwrap().radius_m;
        assert!((flight.motion.position.norm() - radius_m).abs() < 6.0);
    }
}

#[test]
fn circle_begins_where_it_was_asked_for_and_the_mission_goes_on_after_it() {
    let mut guidance = circuit(GuidanceConfig::default());
    let mut flight = Flight::new(0.0, 0.0, 0.0, Vector2::zeros());
    fly(&mut guidance, &mut flight, 50.0);
    let (next, reached) = (guidance.next, guidance.reached);
    guidance.hold_here(&flight.motion, 150.0, 22.0);
    let (least, most) = held(&mut guidance, &mut flight, 60.0);
    assert!(least > -13.0 && most < 13.0, "{least} {most}");
    assert_eq!((guidance.next, guidance.reached), (next, reached));
    let numbers = guidance.path();
    let mut other = circuit(GuidanceConfig::default());
    other.resume_path(&numbers);
    assert_eq!((other.path(), other.held()), (numbers, guidance.held()));
    guidance.release();
    assert_eq!(fly(&mut guidance, &mut flight, 80.0)[0].0, next);
}

/// An entry at 100 m and 22 m/s.
fn entry(north_m: f64, east_m: f64, step: Step) -> Waypoint {
    Waypoint { north_m, east_m, altitude_m: 100.0, airspeed_mps: 22.0, heading_rad: 0.0, step }
}

/// Flies a list on the point mass; entries in the order in which they were reached, and when, s.
fn flown(guidance: &mut Guidance, flight: &mut Flight, seconds: f64) -> Vec<(usize, f64)> {
    let mut order = Vec::new();
    for frame in 0..(seconds / 0.02) as usize {
        let (before, next) = (guidance.reached, guidance.next);
        guidance.observe(0.02, 100.0);
        let out = guidance.step(&flight.motion);
        if guidance.reached > before {
            order.push((next, frame as f64 * 0.02));
        }
        flight.step(out.horizontal_mps2);
    }
    order
}

fn listed(list: &[Waypoint]) -> Guidance {
    Guidance::new(GuidanceConfig { lead_s: 0.0, laps: 2, ..GuidanceConfig::default() }, list).unwrap()
}

#[test]
fn jumps_are_made_so_often_and_nested_ones_each_time_anew() {
    let list = [
        entry(500.0, 0.0, Step::Pass),
        entry(500.0, 500.0, Step::Pass),
        entry(0.0, 0.0, Step::Jump(0, 1)),
        entry(0.0, 500.0, Step::Pass),
        entry(0.0, 0.0, Step::Jump(0, 1)),
    ];
    for wind in [Vector2::zeros(), Vector2::new(4.0, -5.0)] {
        let (mut guidance, mut flight) = (listed(&list), Flight::new(0.0, 0.0, 0.0, wind));
        let order: Vec<_> = flown(&mut guidance, &mut flight, 600.0).iter().map(|one| one.0).collect();
        assert_eq!(order, [0, 1, 0, 1, 3, 0, 1, 0, 1, 3], "{wind:?}");
        assert!(guidance.is_finished() && guidance.step(&flight.motion).holding);
    }
}

#[test]
fn jump_that_leads_nowhere_and_a_list_that_flies_nowhere_are_refused() {
    let refused = |list: &[Waypoint]| Guidance::new(GuidanceConfig::default(), list).unwrap_err();
    let place = entry(500.0, 0.0, Step::Pass);
    let jump = |to| entry(0.0, 0.0, Step::Jump(to, 3));
    assert_eq!(refused(&[place, jump(1)]), GuidanceError::Jump { index: 1 });
    assert_eq!(refused(&[place, jump(9)]), GuidanceError::Jump { index: 1 });
    assert_eq!(refused(&[place, jump(2), jump(1)]), GuidanceError::Jump { index: 1 });
    assert_eq!(refused(&[entry(0.0, 0.0, Step::TakeOff)]), GuidanceError::Empty);
    assert!(Guidance::new(GuidanceConfig::default(), &[place, jump(2), jump(0)]).is_ok());
}

#[test]
fn circles_are_flown_for_their_turns_and_their_time_from_anywhere_and_left_towards_the_next_place() {
    for (case, heading) in (0..24).zip((0..).map(|case| f64::from(case) * 0.9)) {
        let bearing = f64::from(case) * 0.7;
        let wind = Vector2::new((bearing * 3.0).cos(), (bearing * 3.0).sin()) * f64::from(case % 4) * 2.5;
        let radius_m = [0.0, 150.0, -150.0][case as usize % 3];
        let list = [
            entry(600.0, 0.0, Step::Turns(2.0, radius_m)),
            entry(600.0, 900.0, Step::Time(60.0, radius_m)),
            entry(-400.0, 300.0, Step::Pass),
        ];
        let mut guidance = listed(&list);
        let mut flight = Flight::new(900.0 * bearing.cos(), 900.0 * bearing.sin(), heading, wind);
        let (mut turned, mut last, mut on_first) = (0.0, None, 0.0);
        let mut order = Vec::new();
        for frame in 0..40_000 {
            let (before, next) = (guidance.reached, guidance.next);
            guidance.observe(0.02, 100.0);
            let out = guidance.step(&flight.motion);
            if guidance.reached > before {
                order.push((next, f64::from(frame) * 0.02));
            }
            if next == 0 && out.on_arc {
                let away = flight.motion.position - Vector2::new(600.0, 0.0);
                let bearing = away.y.atan2(away.x);
                turned += last.map_or(0.0, |last| wrap_angle(bearing - last));
                last = Some(bearing);
                on_first += 0.02;
                assert!(
                    on_first < 5.0 || out.cross_track_m.abs() < 40.0,
                    "case {case}: {}",
                    out.cross_track_m
                );
            }
            flight.step(out.horizontal_mps2);
        }
        let places: Vec<_> = order.iter().map(|one| one.0).collect();
        assert_eq!(places, [0, 1, 2], "case {case}");
        let turns = f64::abs(turned) / std::f64::consts::TAU;
        assert!((1.9..3.4).contains(&turns), "case {case}: {turns} turns");
        assert!(radius_m == 0.0 || turned * radius_m > 0.0, "case {case}: the wrong way round");
        assert!(order[1].1 - order[0].1 > 60.0, "case {case}: {order:?}");
    }
}

#[test]
fn circle_until_a_height_waits_for_it_and_one_for_good_is_left_by_order_alone() {
    let list = [
        entry(600.0, 0.0, Step::Altitude(0.0)),
        entry(600.0, 600.0, Step::Unlimited(0.0)),
        entry(0.0, 0.0, Step::Pass),
    ];
    let (mut guidance, mut flight) = (listed(&list), Flight::new(0.0, 0.0, 0.0, Vector2::new(0.0, 4.0)));
    let mut at = |guidance: &mut Guidance, altitude_m: f64, seconds: f64| {
        for _ in 0..(seconds / 0.02) as usize {
            guidance.observe(0.02, altitude_m);
            let out = guidance.step(&flight.motion);
            flight.step(out.horizontal_mps2);
        }
        flight.motion.position
    };
    at(&mut guidance, 40.0, 300.0);
    assert_eq!((guidance.next, guidance.reached), (0, 0));
    at(&mut guidance, 98.0, 300.0);
    assert_eq!((guidance.next, guidance.reached, guidance.is_finished()), (1, 2, true));
    // Somebody else flies meanwhile; then it is the same circle again.
    guidance.disengage();
    let place = at(&mut guidance, 100.0, 300.0);
    assert!((place - Vector2::new(600.0, 600.0)).norm() < 150.0, "{place}");
    assert!(guidance.go_on_with(2) && !guidance.go_on_with(3));
    at(&mut guidance, 100.0, 120.0);
    assert_eq!((guidance.next, guidance.reached, guidance.is_finished()), (2, 3, true));
}

#[test]
fn mission_goes_on_where_it_stood_after_a_restart_in_any_frame() {
    let list = [
        entry(0.0, 0.0, Step::TakeOff),
        entry(500.0, 0.0, Step::Pass),
        entry(500.0, 500.0, Step::Turns(1.0, 0.0)),
        entry(0.0, 0.0, Step::Jump(1, 1)),
        entry(0.0, 500.0, Step::Time(20.0, -120.0)),
        entry(0.0, 0.0, Step::Land),
    ];
    let fly = |restarted: &dyn Fn(usize) -> bool| {
        let (mut guidance, mut flight) = (listed(&list), Flight::new(0.0, 0.0, 0.0, Vector2::new(3.0, 3.0)));
        let mut order = Vec::new();
        for frame in 0..20_000 {
            let (before, next) = (guidance.reached, guidance.next);
            guidance.observe(0.02, 100.0);
            let out = guidance.step(&flight.motion);
            if guidance.reached > before {
                order.push((next, frame));
            }
            flight.step(out.horizontal_mps2);
            if restarted(frame) {
                let (snapshot, path) = (guidance.snapshot(), guidance.path());
                guidance = listed(&list);
                guidance.resume(&snapshot);
                guidance.resume_path(&path);
            }
        }
        let ending = guidance.ending().map(|last| last.step);
        (order, flight.motion.position, ending)
    };
    let undisturbed = fly(&|_| false);
    let places: Vec<_> = undisturbed.0.iter().map(|one| one.0).collect();
    assert_eq!((&places[..], undisturbed.2), (&[1, 2, 1, 2, 4][..], Some(Step::Land)));
    assert_eq!(fly(&|_| true), undisturbed, "restarted after each frame");
    assert_eq!(fly(&|frame| frame % 97 == 0), undisturbed);
}

#[test]
fn place_inside_of_the_turn_is_reached_all_the_same() {
    for heading in 0..8 {
        let list = [entry(40.0, 30.0, Step::Pass), entry(700.0, 0.0, Step::Return)];
        let (mut guidance, mut flight) =
            (listed(&list), Flight::new(0.0, 0.0, f64::from(heading) * 0.8, Vector2::zeros()));
        let order = flown(&mut guidance, &mut flight, 180.0);
        assert_eq!(order.first().map(|one| one.0), Some(0), "heading {heading}");
        assert_eq!(guidance.ending().map(|last| last.step), Some(Step::Return));
    }
}

/// Flies one lap on a point mass whose bank lags; the time, s.
fn lap_of(places: &[Waypoint], wind: Vector2<f64>, corner: Corner) -> Option<f64> {
    let config = GuidanceConfig { laps: 1, corner, ..GuidanceConfig::default() };
    let mut guidance = Guidance::new(config, places).unwrap();
    let mut flight = Flight::new(0.0, 0.0, 0.0, wind);
    let mut flown_mps2 = 0.0;
    let end = (0..150_000).find(|_| {
        let out = guidance.step(&flight.motion);
        flown_mps2 += (out.horizontal_mps2 - flown_mps2) * 0.02 / 0.5;
        flight.step(flown_mps2);
        out.finished
    });
    end.map(|frame| 0.02 * f64::from(frame))
}

#[test]
fn lap_of_way_points_that_lie_anywhere_comes_to_its_end_in_any_wind() {
    for seed in 0..400 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let size_m = random.random_range(150.0..700.0);
        let count = random.random_range(3..7);
        let mut places: Vec<Waypoint> = Vec::new();
        while places.len() < count {
            let [north_m, east_m] = [(); 2].map(|()| random.random_range(-size_m..size_m));
            let one = entry(north_m, east_m, Step::Pass);
            let apart_m = |other: &Waypoint| (other.horizontal() - one.horizontal()).norm();
            if places.iter().all(|other| apart_m(other) > 100.0) {
                places.push(one);
            }
        }
        let (strong_mps, from_rad) = (random.random_range(0.0..0.6 * 22.0), random.random_range(0.0..6.3f64));
        let wind = strong_mps * Vector2::new(from_rad.cos(), from_rad.sin());
        let legs = (0..count).map(|i| places[i].horizontal() - places[(i + 1) % count].horizontal());
        let length_m = places[0].horizontal().norm() + legs.map(|leg| leg.norm()).sum::<f64>();
        let straight_s = length_m / 22.0 / (1.0 - (strong_mps / 22.0).powi(2));
        for corner in [Corner::Fillet, Corner::FlyThrough] {
            let time_s = lap_of(&places, wind, corner);
            let most_s = 2.0 * (straight_s + 25.0 * count as f64);
            assert!(
                time_s.is_some_and(|time_s| time_s < most_s),
                "seed {seed}, {corner:?}: {time_s:?}, {most_s:.0} s of {places:?} in {strong_mps:.1} m/s"
            );
        }
    }
}
