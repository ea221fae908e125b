//! A flight of one process, flown again as partitions: every actuator word has to be the same.

use std::path::Path;

use bateleur_report::campaign::Flown;
use bateleur_simulator::truth::{self, TruthRecord};

/// One flight in so many is flown again.
pub(super) const ONE_IN: f64 = 20.0;
/// Name of the truth in a flight's folder.
const TRUTH: &str = "truth.bin";
/// The words of a record, in their order.
const WORDS: [&str; 6] = ["left aileron", "right aileron", "elevator", "rudder", "throttle", "autopilot"];

/// Whether the flight with this seed is flown again.
pub(super) fn is_drawn(seed: u64) -> bool {
    bateleur_plant::drawn(seed, "flown again") * ONE_IN < 1.0
}

/// What differs between a flight in one process, in the first folder, and the same as partitions; nothing where they are equal.
pub(super) fn difference((one, first): (&Flown, &Path), (other, second): (&Flown, &Path)) -> Option<String> {
    let said = |flown: &Flown| flown.failure.clone().unwrap_or_else(|| "completed".into());
    let found = match (truth::read(&first.join(TRUTH)), truth::read(&second.join(TRUTH))) {
        (Ok(first), Ok(second)) => word(&first, &second),
        (Err(error), _) => Some(format!("its words can not be read ({error})")),
        (_, Err(error)) => Some(format!("the words as partitions can not be read ({error})")),
    };
    let found = found.or_else(|| {
        (one.completed != other.completed)
            .then(|| format!("it ended as \"{}\", and as partitions as \"{}\"", said(one), said(other)))
    });
    found.map(|what| format!("seed {}: one process and partitions are not the same flight: {what}", one.seed))
}

/// The first word that differs.
fn word(one: &[TruthRecord], partitions: &[TruthRecord]) -> Option<String> {
    for (here, there) in one.iter().zip(partitions) {
        let words = |record: &TruthRecord| {
            let [left, right, elevator, rudder, throttle] = record.timers_us;
            [left, right, elevator, rudder, throttle, record.autopilot]
        };
        let (at_s, pairs) = (here.time_ns as f64 / 1e9, words(here).into_iter().zip(words(there)));
        if here.time_ns != there.time_ns {
            let other_s = there.time_ns as f64 / 1e9;
            return Some(format!("a sensor set of {at_s:.3} s is one of {other_s:.3} s as partitions"));
        }
        if let Some((name, (one, other))) = WORDS.iter().zip(pairs).find(|(_, (one, other))| one != other) {
            return Some(format!("at {at_s:.3} s the word of {name} is {one}, and {other} as partitions"));
        }
    }
    let (one, other) = (one.len(), partitions.len());
    (one != other).then(|| format!("it has {one} sets of words, and {other} as partitions"))
}

#[cfg(test)]
mod tests {
    use bateleur_simulator::Options;
    use bateleur_simulator::truth::{Header, TruthWriter};

    use super::*;

    fn record(step: u64) -> TruthRecord {
        let word = |place: u64| 1000 + (bateleur_plant::drawn(step, &place.to_string()) * 1000.0) as u16;
        TruthRecord {
            time_ns: step * 20_000_000,
            timers_us: [word(0), word(1), word(2), word(3), word(4)],
            autopilot: 1,
            ..TruthRecord::default()
        }
    }

    fn folder(records: &[TruthRecord]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let header = Header::new(&Options::default());
        let mut writer = TruthWriter::create(&folder.path().join(TRUTH), &header).unwrap();
        records.iter().for_each(|record| writer.append(record).unwrap());
        writer.flush().unwrap();
        folder
    }

    fn flown(completed: bool) -> Flown {
        serde_json::from_value(serde_json::json!({
            "number": 0, "seed": 77, "command": "", "conditions": {}, "completed": completed, "failure": null,
            "figures": {}, "digest": null, "module_time_s": null, "wall_time_s": 1.0, "folder": null
        }))
        .unwrap()
    }

    #[test]
    fn changed_word_is_found_and_named_wherever_it_is() {
        let all: Vec<TruthRecord> = (0..500).map(record).collect();
        let (one, good) = (folder(&all), flown(true));
        let compared = |other: &[TruthRecord]| {
            let other = folder(other);
            difference((&good, one.path()), (&good, other.path()))
        };
        assert_eq!(compared(&all), None);
        for trial in 0..60 {
            let step = (bateleur_plant::drawn(trial, "step") * 500.0) as usize;
            let place = (trial % 6) as usize;
            let mut other = all.clone();
            let changed = match place {
                5 => &mut other[step].autopilot,
                place => &mut other[step].timers_us[place],
            };
            *changed ^= 1;
            let found = compared(&other).unwrap();
            let at = format!("at {:.3} s the word of {} is ", step as f64 * 0.02, WORDS[place]);
            assert!(found.starts_with("seed 77: ") && found.contains(&at), "{found}");
        }
        assert!(compared(&all[..499]).unwrap().contains("500 sets of words, and 499"));
        assert!(compared(&all[1..]).unwrap().contains("0.000 s is one of 0.020 s"));
    }

    #[test]
    fn other_ends_and_missing_words_are_differences() {
        let all: Vec<TruthRecord> = (0..5).map(record).collect();
        let (one, other, none) = (folder(&all), folder(&all), tempfile::tempdir().unwrap());
        let found = difference((&flown(true), one.path()), (&flown(false), other.path())).unwrap();
        assert!(found.contains("it ended as \"completed\""), "{found}");
        let found = difference((&flown(true), one.path()), (&flown(true), none.path())).unwrap();
        assert!(found.contains("the words as partitions can not be read"), "{found}");
    }

    #[test]
    fn one_flight_in_twenty_is_drawn_whatever_the_first_seed_is() {
        for first in [1, 920_001, u64::MAX / 2] {
            let drawn = (first..first + 10_000).filter(|seed| is_drawn(*seed)).count();
            assert!((420..580).contains(&drawn), "{drawn} of 10000");
        }
    }
}
