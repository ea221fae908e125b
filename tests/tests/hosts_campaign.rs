//! Networks that are cut, hosts that die and a simulator that pauses, at random instants of a flight on several hosts, from a
//! seed, in virtual time: every flight ends, in the way that the table in the book says, and nobody's module is started anew but
//! the dead host's.
//!
//! `BATELEUR_HOSTS_FLIGHTS` says how many (the first of each kind), `BATELEUR_HOSTS_SEED` from which seed (1).

use std::time::Duration;

use bateleur_tests::{Ended, among_others, bateleur, is_long, repository, small_mission};

/// SplitMix64.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (mixed ^ (mixed >> 31)) % limit
    }

    /// Seconds between `from` and `to`, to a tenth.
    fn seconds(&mut self, from: f64, to: f64) -> f64 {
        from + self.below(((to - from) * 10.0) as u64 + 1) as f64 / 10.0
    }
}

/// What a flight suffers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// One network is cut.
    One,
    /// Both are, for two seconds at most.
    Both,
    /// A host dies and comes back.
    Back,
    /// A host dies for good.
    Death,
    /// The simulator pauses.
    Pause,
}

const KINDS: [Kind; 5] = [Kind::One, Kind::Both, Kind::Back, Kind::Death, Kind::Pause];

/// The options of flight `number` of a campaign, and what they are.
fn drawn(seed: u64, number: u64) -> (Kind, Vec<String>) {
    let kind = KINDS[(number % KINDS.len() as u64) as usize];
    let mut random = Random(seed.wrapping_mul(1_000_003).wrapping_add(number));
    let from_s = random.seconds(30.0, if is_long() { 150.0 } else { 60.0 });
    let span = |length_s: f64| format!("{from_s:.1}-{:.1}", from_s + length_s);
    let options = match kind {
        Kind::One => {
            let network = ["a", "b"][random.below(2) as usize];
            let longest_s = if is_long() { 30.0 } else { 10.0 };
            vec!["--cut".to_owned(), format!("{network}@{}", span(random.seconds(0.1, longest_s)))]
        }
        Kind::Both => {
            let both = span(random.seconds(0.1, 2.0));
            let cut = |network: &str| ["--cut".to_owned(), format!("{network}@{both}")];
            ["a", "b"].into_iter().flat_map(cut).collect()
        }
        Kind::Back => vec!["--kill-host".to_owned(), format!("nav@{}", span(random.seconds(0.1, 2.0)))],
        Kind::Death => vec!["--kill-host".to_owned(), format!("nav@{from_s:.1}")],
        // Each withheld answer costs two seconds of real time.
        Kind::Pause => {
            vec!["--fault".to_owned(), format!("pause@{from_s:.1}..{:.1}", from_s + random.seconds(0.1, 0.3))]
        }
    };
    (kind, options)
}

fn judge(kind: Kind, ended: &Ended, which: &str) {
    let summary = ended.summary();
    let said = &ended.stderr;
    let completed = summary["completed"] == true;
    assert!(
        completed || summary["failure"].as_str().is_some_and(|why| !why.is_empty()),
        "{which}: {summary}"
    );
    let (downs, ups) = (said.matches("link nav: down").count(), said.matches("link nav: up").count());
    match kind {
        Kind::One => assert!(completed && downs == 0, "{which}: {said}"),
        Kind::Both | Kind::Pause => assert!(completed && ups == 2 + downs, "{which}: {said}"),
        // At both ends, before and after.
        Kind::Back => {
            assert!(completed && said.contains("host nav is started again") && ups >= 4, "{which}: {said}");
        }
        Kind::Death => assert!(!completed && downs == 1, "{which}: {said}"),
    }
    assert!(!said.contains("frame 0 again"), "{which}: no module is reset: {said}");
    let restarts = ended.faults().into_iter().filter(|fault| fault.action.ends_with("restart"));
    assert_eq!(restarts.count(), 0, "{which}: {:?}", ended.faults());
}

fn number(name: &str, usual: u64) -> u64 {
    std::env::var(name).ok().map_or(usual, |text| text.parse().unwrap())
}

#[test]
fn cuts_and_deaths_at_random_instants_end_as_the_book_says() {
    let _turn = among_others();
    let seed = number("BATELEUR_HOSTS_SEED", 1);
    // Over sooner than the two laps of the schedule, and not before the last instant that is drawn.
    let mission = small_mission();
    for number in 0..number("BATELEUR_HOSTS_FLIGHTS", KINDS.len() as u64) {
        let (kind, options) = drawn(seed, number);
        let schedule = repository().join("schedules/two-hosts.toml");
        let flight_seed = (seed + number).to_string();
        let mut arguments =
            vec!["fly", "--fast", "--hosts", "--format", "json", "--seed", &flight_seed, "--schedule"];
        arguments.push(schedule.to_str().unwrap());
        arguments.extend(options.iter().map(String::as_str));
        if !is_long() {
            arguments.extend(["--mission", mission.to_str().unwrap()]);
        }
        let which = format!("flight {number} of seed {seed}: {}", arguments.join(" "));
        eprintln!("{which}");
        judge(kind, &bateleur(&arguments).end_within(Duration::from_secs(300)), &which);
    }
}
