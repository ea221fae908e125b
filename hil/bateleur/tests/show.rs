//! What `bateleur show` prints and draws. The pictures of the book are its own.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod support;

use support::{assert_golden, assert_kept, bateleur, repository};

#[test]
fn the_flight_schedule_is_shown_as_text() {
    let ended = bateleur(&["show"]);
    assert_eq!((ended.code, ended.stderr.as_str()), (0, ""));
    assert_golden("show.txt", &ended.stdout);
    assert!(ended.stdout.lines().all(|line| line.chars().count() <= 100));
}

#[test]
fn the_pictures_in_the_book_are_drawn_by_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (frames, graph, dot) = (path("frames.svg"), path("graph.svg"), path("graph.dot"));
    let ended = bateleur(&["show", "schedule.toml", "--svg", &frames, "--graph", &graph, "--dot", &dot]);
    assert_eq!(ended.code, 0, "{}", ended.stderr);
    let read = |path: &str| std::fs::read_to_string(path).unwrap();
    assert_kept(&repository().join("docs/src/images/frames.svg"), &read(&frames));
    assert_kept(&repository().join("docs/src/images/channels.svg"), &read(&graph));
    assert_golden("graph.dot", &read(&dot));
    for picture in [read(&frames), read(&graph)] {
        assert!(picture.starts_with("<svg xmlns=") && picture.ends_with("</svg>\n"));
        for name in ["rate_generator", "hil_interface", "imu", "onboard_computer", "command"] {
            assert!(picture.contains(name), "{name}");
        }
    }
}

#[test]
fn several_cores_and_uneven_frames_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("two.toml");
    std::fs::write(
        &path,
        r#"
[module.fcu]
cores = [1, 2]

[partition.one]
program = "one"
module = "fcu"
memory = "1MiB"

[partition.two]
program = "two"
module = "fcu"
memory = "1MiB"

[schedule.slow]
major_frame = "40ms"
minor_frame = "10ms"
initial = true
window = [
    { partition = "one", offset = "1ms", duration = "4ms" },
    { partition = "two", offset = "0ms", duration = "2ms", core = 2, minor = [0, 2] },
]

[schedule.fast]
major_frame = "40ms"
minor_frame = "10ms"
window = [
    { partition = "two", offset = "1ms", duration = "100us", core = 1 },
    { partition = "one", offset = "0ms", duration = "2ms", core = 2, minor = [0, 2] },
]
"#,
    )
    .unwrap();
    let ended = bateleur(&["show", path.to_str().unwrap()]);
    assert_eq!(ended.code, 0, "{}", ended.stderr);
    assert_golden("show_two_cores.txt", &ended.stdout);
    let only = bateleur(&["show", path.to_str().unwrap(), "--only", "fast"]);
    assert!(!only.stdout.contains("`slow`") && only.stdout.contains("`fast`"), "{}", only.stdout);
    let wrong = bateleur(&["show", path.to_str().unwrap(), "--only", "fats"]);
    assert_eq!(
        (wrong.code, wrong.stderr.as_str()),
        (2, "bateleur: there is no schedule fats: did you mean fast?\n")
    );
}

#[test]
fn a_broken_file_is_answered_as_by_check() {
    let ended = bateleur(&["show", "tests/schedule/window_overlap.toml"]);
    assert_eq!((ended.code, ended.stdout.as_str()), (2, ""));
    assert!(ended.stderr.contains("T03-window-overlap"), "{}", ended.stderr);
}
