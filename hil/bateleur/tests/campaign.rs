//! What `bateleur campaign` prints of results that are there, and what it refuses.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod support;

use std::collections::BTreeMap;
use std::fs::OpenOptions;
use std::path::Path;

use bateleur_report::campaign::{Figure, Flown, Plan, RESULTS, append};
use support::{assert_golden, bateleur, bateleur_in};

fn plan(part: u64, parts: u64) -> Plan {
    Plan {
        flights: 40,
        seed: 100,
        shard: (part, parts),
        space: BTreeMap::from([("wind, m/s".to_owned(), "0..8".to_owned())]),
        common: Vec::new(),
        schedule: "abc".into(),
        programs: "def".into(),
        version: "0.1.0".into(),
    }
}

fn flown(number: u64) -> Flown {
    let completed = number != 7 && number != 20;
    let figure = |figure: &Figure| (figure.name.to_owned(), (number + 1) as f64 * 0.1);
    Flown {
        number,
        seed: 100 + number,
        command: format!("bateleur fly --fast --seed={} --kill=estimator@{number}.5", 100 + number),
        conditions: BTreeMap::new(),
        completed,
        failure: (!completed).then(|| "it hangs: no end after 300 s (--patience)".to_owned()),
        figures: if completed { Figure::ALL.iter().map(figure).collect() } else { BTreeMap::new() },
        digest: Some(format!("digest {number}")),
        module_time_s: Some(205.0),
        wall_time_s: 5.0,
        folder: None,
        engine: None,
        compared: false,
    }
}

fn write(folder: &Path, plan: &Plan) {
    std::fs::create_dir_all(folder).unwrap();
    plan.write(folder).unwrap();
    let mut results = OpenOptions::new().create(true).append(true).open(folder.join(RESULTS)).unwrap();
    plan.numbers()
        .filter(|number| *number != 39)
        .for_each(|number| append(&mut results, &flown(number)).unwrap());
}

#[test]
fn shards_are_joined_into_one_table() {
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("all/shard-0-of-2"), &plan(0, 2));
    write(&folder.path().join("all/shard-1-of-2"), &plan(1, 2));
    let shards = ["all/shard-0-of-2", "all/shard-1-of-2"];
    let ended = bateleur_in(folder.path(), &[&["campaign", "merge"], &shards[..]].concat());
    assert_eq!((ended.code, ended.stderr.as_str()), (1, ""), "two failed, one is missing");
    assert_golden("campaign.txt", &ended.stdout);
    let ended =
        bateleur_in(folder.path(), &[&["campaign", "merge", "--output", "joined"], &shards[..]].concat());
    assert!(ended.stdout.ends_with("report: joined/report.html\n"));
    let again = bateleur_in(folder.path(), &["campaign", "merge", "joined", "--format", "json"]);
    let result: serde_json::Value = serde_json::from_str(&again.stdout).unwrap();
    assert_eq!((&result["flown"], &result["completed"]), (&39.into(), &37.into()));
    assert_eq!(result["failed"][1]["command"], "bateleur fly --fast --seed=120 --kill=estimator@20.5");
    assert!(
        folder.path().join("joined/report.html").exists()
            && folder.path().join("joined/result.json").exists()
    );
}

#[test]
fn campaign_that_makes_no_sense_is_refused_before_anything_flies() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("out");
    let output = output.to_str().unwrap();
    for (options, words) in [
        (&["--wind", "8..2"][..], "is not FROM..TO"),
        (&["--shard", "4/4"], "is no shard"),
        (&["--kill-only", "estimater"], "did you mean `estimator`?"),
        (&["--flights", "0"], "0 is not in"),
        (&["--schedule", "nowhere.toml"], "cannot read nowhere.toml"),
        (&["--seed", "18446744073709551615"], "beyond the last seed"),
        (&["--", "--wnd=3"], "the options after -- are not for every flight"),
        (&["--", "--seed=3"], "the options after -- are not for every flight"),
    ] {
        let ended = bateleur(&[&["campaign", "--output", output], options].concat());
        assert_eq!((ended.code, ended.stdout.as_str()), (2, ""), "{options:?}");
        assert!(ended.stderr.contains(words), "{options:?}: {}", ended.stderr);
    }
    assert!(!Path::new(output).exists());
}
