//! Two modules on one processor: who is robbed of it is not to blame, and both learn of each other.

use bateleur_tests::{PATIENCE, Sketch, alone, await_some, bateleur, program};
use rustix::process::Signal;

/// A module whose one partition computes nearly all the time, above the other's partition.
fn spinning_module(folder: &std::path::Path) -> String {
    let text = format!(
        "[module.second]\ncores = [1]\n\n[health]\nsilence_windows = 100000\n\n\
         [schedule.only]\nmajor_frame = \"20ms\"\nminor_frame = \"20ms\"\ninitial = true\n\
         window = [{{ partition = \"spinner\", offset = \"0us\", duration = \"19500us\" }}]\n\n\
         [partition.spinner]\nprogram = \"{}\"\nmodule = \"second\"\nmemory = \"16MiB\"\npriority = 50\n",
        program("hanger").display()
    );
    let path = folder.join("second.toml");
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

/// `health`: the table of the module that is robbed.
#[track_caller]
fn assert_not_to_blame(health: &str) {
    if !rustix::process::geteuid().is_root() {
        return eprintln!("not tried: windows without priority share their processor");
    }
    let _turn = alone();
    let folder = tempfile::tempdir().unwrap();
    let sketch = Sketch::new().table(health).partition("victim", "counter", 2000, "priority = 1");
    let schedule = sketch.write(folder.path());
    let mut first = bateleur(&["run", "--schedule", &schedule, "--until", "100"]);
    first.await_words("1 partition is ready");
    let mut second = bateleur(&["run", "--schedule", &spinning_module(folder.path()), "--until", "100"]);
    second.await_words("1 partition is ready");
    let taken = format!("module second (PID {}) also uses processor", second.pid());
    first.await_words(&taken);
    first.await_words("victim had no processor in its window and is not to blame for it: ");
    // Far more windows than silence takes.
    std::thread::sleep(std::time::Duration::from_secs(3));
    for module in [&second, &first] {
        module.signal(Signal::INT);
    }
    let second_pid = second.pid();
    second.end().expect_code(0);
    let ended = first.end().expect_code(0);
    let faults = ended.faults();
    let of_others = ["window_overrun", "late_dispatcher", "processor_taken"];
    let harmless = |fault: &bateleur_tests::Fault| of_others.contains(&fault.error.as_str());
    assert!(faults.iter().all(harmless), "{faults:#?}");
    let taken: Vec<&str> = faults
        .iter()
        .filter(|fault| fault.error == "processor_taken")
        .map(|fault| fault.detail.as_str())
        .collect();
    let names_other = |detail: &&str| detail.contains(&format!("of module second (PID {})", second_pid));
    assert!(taken.iter().any(names_other), "{taken:#?}");
    let takers: std::collections::BTreeSet<_> =
        taken.iter().map(|detail| detail.split(" had it").next()).collect();
    assert_eq!(takers.len(), taken.len(), "each is told once: {taken:#?}");
    ended.expect_words(&["partitions had no processor in "]);
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn partition_whose_processor_another_living_module_takes_is_not_restarted_for_silence() {
        assert_not_to_blame("");
    }

    #[test]
    fn living_module_takes_the_processor_where_one_window_is_a_silence_and_nobody_is_restarted() {
        assert_not_to_blame("[health]\nsilence_windows = 1\n");
    }

    #[test]
    fn living_module_says_when_another_one_begins_to_use_its_processor() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let schedule = Sketch::new().partition("quiet", "counter", 500, "").write(folder.path());
        let mut first = bateleur(&["run", "--schedule", &schedule, "--until", "100"]);
        first.await_words("1 partition is ready");
        let second = bateleur(&["run", "--schedule", &schedule, "--until", "100"]);
        first.await_words(&format!("module test (PID {}) also uses processor", second.pid()));
        // The other one has found the first when it examined the machine.
        assert!(second.said().contains(&format!("module test (PID {}) also uses processor", first.pid())));
        second.signal(Signal::INT);
        second.end().expect_code(0);
        first.signal(Signal::INT);
        let ended = first.end().expect_code(0);
        assert_eq!(ended.stderr.matches(") also uses processor").count(), 1, "said once: {}", ended.stderr);
    }

    #[test]
    fn partition_that_computes_or_sleeps_on_beside_a_living_module_is_restarted_for_silence() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        for how in ["spin", "sleep"] {
            let keys = format!("attributes = {{ how = \"{how}\", after = 10 }}");
            let schedule = Sketch::new().partition("hanger", "hanger", 2000, &keys).write(folder.path());
            let module = bateleur(&["run", "--schedule", &schedule, "--until", "100"]);
            let silent = await_some(PATIENCE, || module.said().contains("hanger: silence").then_some(()));
            assert!(silent.is_some(), "{how}: {}", module.said());
            module.signal(Signal::INT);
            module.end().expect_code(0);
        }
    }
}
