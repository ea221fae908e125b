//! A partition with windows on two cores, one after the other.

use bateleur_tests::{Ended, Window, alone, among_others, bateleur, program};

/// `roams` has a window of 3 ms on core 0 and, touching it, one on core 1, in each minor frame of 20 ms; `stays` follows on core 1.
fn schedule(roams: &str) -> String {
    let partition = |name: &str, runs: &str| {
        let path = program(runs);
        format!(
            "[partition.{name}]\nprogram = \"{}\"\nmodule = \"test\"\nmemory = \"32MiB\"\nhealth = {{ silence = \"ignore\" }}\n",
            path.display()
        )
    };
    format!(
        "[module.test]\ncores = [0, 1]\n{}{}
[schedule.only]
major_frame = \"40ms\"
minor_frame = \"20ms\"
window = [
    {{ partition = \"roams\", offset = \"2ms\", duration = \"2ms\", core = 0 }},
    {{ partition = \"roams\", offset = \"4ms\", duration = \"2ms\", core = 1 }},
    {{ partition = \"stays\", offset = \"6ms\", duration = \"2ms\", core = 1 }},
]
",
        partition("roams", roams),
        partition("stays", "counter")
    )
}

fn run(roams: &str, arguments: &[&str]) -> Ended {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("two_cores.toml");
    std::fs::write(&path, schedule(roams)).unwrap();
    bateleur(&[&["run", "--schedule", path.to_str().unwrap()][..], arguments].concat()).end().expect_code(0)
}

fn of<'a>(windows: &'a [Window], partition: &'a str, core: u32) -> impl Iterator<Item = &'a Window> + Clone {
    windows.iter().filter(move |window| window.partition == partition && window.core == core)
}

/// Every window that both dispatchers came to on time was granted, and none while the other core still had the partition.
fn assert_handed_over(ended: &Ended) {
    let windows = ended.windows();
    let (first, second) = (of(&windows, "roams", 0), of(&windows, "roams", 1));
    assert!(first.clone().count() > 40 && second.clone().count() > 40);
    for window in &windows {
        let late = |other: &&Window| other.late && other.planned_end_ns == window.planned_start_ns;
        let held_up = window.late || windows.iter().any(|other| late(&other));
        let lost = window.flags.contains(['S', 'M']);
        assert!(!lost || held_up, "{window:?}");
    }
    // What could not be handed over in time says so, and is rare.
    let refused = windows.iter().filter(|window| window.flags.contains('H')).count();
    assert!(refused * 4 <= windows.len(), "{refused} of {} windows", windows.len());
    let granted = |core| of(&windows, "roams", core).filter(|window| window.granted_ns.is_some()).count();
    assert!(granted(0) > 20 && granted(1) > 20, "{} and {}", granted(0), granted(1));
    assert!(of(&windows, "stays", 1).filter(|window| window.closed_ns.is_some()).count() > 20);
}

#[test]
fn partition_has_its_windows_on_both_cores_on_the_virtual_clock() {
    let _turn = among_others();
    let ended = run("counter", &["--fast", "--until", "2"]);
    assert!(ended.windows().iter().all(|window| window.closed_ns.is_some()));
    assert!(ended.faults().is_empty());
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn partition_has_its_windows_on_both_cores_on_the_wall_clock() {
        let _turn = alone();
        let ended = run("counter", &["--until", "2"]);
        assert_handed_over(&ended);
        // A host that holds a processor up makes both.
        let of_the_host = ["window_overrun", "late_dispatcher", "processor_taken"];
        assert!(
            ended.faults().iter().all(|fault| of_the_host.contains(&fault.error.as_str())),
            "{:?}",
            ended.faults()
        );
    }

    #[test]
    fn spinner_is_moved_from_core_to_core_and_takes_no_window_from_others() {
        let _turn = alone();
        let ended = run("hanger", &["--until", "2"]);
        assert_handed_over(&ended);
        let windows = ended.windows();
        let overruns = of(&windows, "roams", 1).filter(|window| window.is_overrun()).count();
        assert!(overruns > 20, "it never closes one: {overruns}");
    }
}
