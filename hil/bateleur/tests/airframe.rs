//! What `bateleur airframe` prints, and how it ends.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod support;

use support::{assert_golden, bateleur, bateleur_in, repository};

#[test]
fn what_follows_from_each_delivered_airframe_is_as_it_was() {
    for name in ["aerosonde", "rascal110", "ultrastick25e", "zagi", "vtail60"] {
        let ended = bateleur(&["airframe", &format!("airframes/{name}.toml")]);
        assert_eq!((ended.code, ended.stderr.as_str()), (0, ""));
        assert_golden(&format!("airframe_{name}.txt"), &ended.stdout);
    }
    assert_eq!(
        bateleur(&["airframe", "rascal110"]).stdout,
        bateleur(&["airframe", "airframes/rascal110.toml"]).stdout
    );
}

#[test]
fn faults_of_a_file_are_shown_with_their_lines_and_their_mends() {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(repository().join("airframes/aerosonde.toml")).unwrap();
    let text = text
        .replace("lift_alpha =", "lift_alfa =")
        .replace("mass_kg = 11.0", "mass_kg = \"heavy\"")
        .replace("[-1.0, 0.0, 0.0]", "[-1.0, 0.0]");
    std::fs::write(folder.path().join("mine.toml"), text).unwrap();
    let ended = bateleur_in(folder.path(), &["airframe", "mine.toml"]);
    assert_eq!((ended.code, ended.stderr.as_str()), (2, ""));
    assert_golden("airframe_faults.txt", &ended.stdout);
    let json = bateleur_in(folder.path(), &["airframe", "mine.toml", "--format", "json"]);
    let json: serde_json::Value = serde_json::from_str(&json.stdout).unwrap();
    assert_eq!(json["flaws"].as_array().map(Vec::len), Some(4));
    assert_eq!((&json["flaws"][0]["line"], &json["flaws"][0]["column"]), (&14.into(), &11.into()));
}

#[test]
fn value_that_the_laws_cannot_use_is_shown_at_its_place() {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(repository().join("airframes/aerosonde.toml")).unwrap();
    std::fs::write(folder.path().join("mine.toml"), text.replace("yaw_beta = 0.073", "yaw_beta = -0.073"))
        .unwrap();
    let ended = bateleur_in(folder.path(), &["airframe", "mine.toml"]);
    assert_eq!(ended.code, 2);
    assert!(ended.stdout.contains("mine.toml:47:12"), "{}", ended.stdout);
    assert!(ended.stdout.contains("the laws need a positive number"), "{}", ended.stdout);
}

#[test]
fn file_that_is_not_there_is_answered_with_the_names_that_are() {
    let ended = bateleur(&["airframe", "nowhere.toml"]);
    assert_eq!((ended.code, ended.stdout.as_str()), (2, ""));
    assert!(ended.stderr.contains("nowhere.toml") && ended.stderr.contains("rascal110"), "{}", ended.stderr);
}
