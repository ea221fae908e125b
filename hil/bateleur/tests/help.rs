//! What the program says of itself.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod support;

use support::{assert_golden, assert_kept, bateleur, repository};

#[test]
fn the_help_of_the_offline_verbs_is_as_it_was() {
    for verb in [
        "airframe",
        "campaign",
        "check",
        "compare",
        "completions",
        "init",
        "man",
        "new",
        "plan",
        "replay",
        "schema",
        "show",
    ] {
        let ended = bateleur(&[verb, "--help"]);
        assert_eq!((ended.code, ended.stderr.as_str()), (0, ""));
        assert_eq!(ended.stdout.matches("Exit codes").count(), 1, "{}", ended.stdout);
        assert_golden(&format!("help_{verb}.txt"), &ended.stdout);
    }
}

#[test]
fn the_schema_in_the_book_is_the_one_that_is_printed() {
    let ended = bateleur(&["schema"]);
    assert_eq!((ended.code, ended.stderr.as_str()), (0, ""));
    assert_kept(&repository().join("docs/schedule.schema.json"), &ended.stdout);
    let schedule = std::fs::read_to_string(repository().join("schedule.toml")).unwrap();
    assert!(schedule.starts_with("#:schema docs/schedule.schema.json\n"), "where editors look for it");
}

#[test]
fn a_negative_number_is_answered_with_the_range_and_not_taken_for_an_option() {
    for (verb, option, range) in [
        ("fly", "--wind", "between 0 and 50 m/s"),
        ("fly", "--wind-from", "between -360 and 360 degrees"),
        ("fly", "--seed", "a whole number from 0"),
        ("run", "--until", "a module time in seconds, 0 or above"),
    ] {
        for arguments in [vec![verb, option, "-999"], vec![verb, &format!("{option}=-999")]] {
            let ended = bateleur(&arguments);
            assert_eq!((ended.code, ended.stdout.as_str()), (2, ""), "{arguments:?}");
            assert!(ended.stderr.contains(range), "{arguments:?}: {}", ended.stderr);
        }
    }
}

#[test]
fn every_shell_gets_the_verbs() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let ended = bateleur(&["completions", shell]);
        assert_eq!(ended.code, 0, "{}", ended.stderr);
        for word in ["check", "deny", "show", "fly"] {
            assert!(ended.stdout.contains(word), "{shell}: {word}");
        }
        for hidden in ["observer", "recorder"] {
            assert!(!ended.stdout.contains(hidden), "{shell}: {hidden} is nobody's to type");
        }
    }
    assert_eq!(bateleur(&["completions", "tcsh"]).code, 2);
}

#[test]
fn every_verb_has_a_manual_page() {
    let folder = tempfile::tempdir().unwrap();
    let ended = bateleur(&["man", folder.path().join("man1").to_str().unwrap()]);
    assert_eq!((ended.code, ended.stdout.as_str()), (0, ""), "{}", ended.stderr);
    let mut pages: Vec<String> = std::fs::read_dir(folder.path().join("man1"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    pages.sort();
    for verb in
        ["airframe", "check", "compare", "fly", "ground", "new", "plan", "replay", "run", "schema", "show"]
    {
        assert!(pages.contains(&format!("bateleur-{verb}.1")), "{pages:?}");
    }
    assert!(bateleur(&["man"]).stdout.contains(".TH bateleur 1"));
    let occupied = folder.path().join("file");
    std::fs::write(&occupied, "").unwrap();
    assert_eq!(bateleur(&["man", occupied.to_str().unwrap()]).code, 2);
}
