//! Signals that are injected do to a partition, process 1 of its namespace, what they do to any process; where one does
//! nothing, that is said.

use bateleur_tests::{Ended, Sketch, alone, among_others, bateleur};

/// Every signal that ends a process, and what the health table calls that.
const DEADLY: [(&str, &str, &str); 18] = [
    ("sighup", "killed", "ended by signal 1"),
    ("sigint", "killed", "ended by signal 2"),
    ("sigquit", "killed", "ended by signal 3"),
    ("sigill", "illegal_request", "ended by SIGILL"),
    ("sigtrap", "killed", "ended by signal 5"),
    ("sigabrt", "exit", "aborted"),
    ("sigbus", "memory_violation", "ended by SIGBUS"),
    ("sigfpe", "numeric_error", "ended by SIGFPE"),
    ("sigkill", "killed", "ended by SIGKILL"),
    ("sigusr1", "killed", "ended by signal 10"),
    ("sigsegv", "memory_violation", "ended by SIGSEGV"),
    ("sigusr2", "killed", "ended by signal 12"),
    ("sigalrm", "killed", "ended by signal 14"),
    ("sigterm", "killed", "ended by signal 15"),
    ("sigxcpu", "killed", "ended by signal 24"),
    ("sigxfsz", "killed", "ended by signal 25"),
    ("sigvtalrm", "killed", "ended by signal 26"),
    ("sigsys", "illegal_request", "ended by SIGSYS"),
];

/// Time from one to the next, s: a restart lies between.
const STEP_S: f64 = 0.5;

/// A run of one partition, in which the injections come one after the other.
fn run(program: &str, keys: &str, clock: &[&str], injections: &[&str]) -> Ended {
    let folder = tempfile::tempdir().unwrap();
    let keys = format!("restart = {{ budget = 100, within = \"60s\", then = \"idle\" }}\n{keys}");
    let schedule = Sketch::new().partition("victim", program, 2000, &keys).write(folder.path());
    let until = (injections.len() as f64 * STEP_S + 2.0).to_string();
    let mut arguments = vec!["run".to_owned(), "--schedule".into(), schedule, "--until".into(), until];
    arguments.extend(clock.iter().map(|word| (*word).to_owned()));
    for (number, fault) in injections.iter().enumerate() {
        let at = (number as f64 + 1.0) * STEP_S;
        arguments.extend(["--inject".into(), format!("victim:{fault}@{at}")]);
    }
    bateleur(&arguments).end().expect_code(0)
}

/// What ended the partition or made it silent.
fn ends(ended: &Ended) -> Vec<(String, String)> {
    let of_partition = |fault: &bateleur_tests::Fault| {
        fault.partition == "victim" && !["window_overrun", "startup_timeout"].contains(&fault.error.as_str())
    };
    let all = ended.faults().into_iter().filter(of_partition);
    all.map(|fault| (fault.error, fault.detail)).collect()
}

fn assert_each_does_what_the_table_says(program: &str, keys: &str, clock: &[&str]) {
    let mut injections: Vec<&str> = DEADLY.iter().map(|(name, ..)| *name).collect();
    injections.extend(["sigpipe", "sigcont", "sigstop"]);
    let ended = run(program, keys, clock, &injections);
    let found = ends(&ended);
    let expected = DEADLY.iter().map(|(_, error, detail)| (*error, *detail)).chain([("silence", "")]);
    assert_eq!(found.len(), DEADLY.len() + 1, "{found:#?}\n{}", ended.stderr);
    for ((error, detail), expected) in found.iter().zip(expected) {
        assert!(error == expected.0 && detail.starts_with(expected.1), "{error}: {detail}, not {expected:?}");
    }
    // Rust ignores the one, and the other finds nothing to go on.
    let orders = ended.orders();
    let told = |why: &str| orders.iter().filter(|order| order.contains(why)).count();
    assert_eq!((told("nothing was done: victim: it ignores sigpipe"), orders.len()), (1, 2), "{orders:#?}");
    assert_eq!(told("nothing was done: victim: it is not stopped"), 1, "{orders:#?}");
}

/// Without a word to the kernel: this one uses no library.
const NO_LIBRARY: &str = "attributes = { computes_ms = 0 }";

#[test]
fn each_signal_does_to_a_partition_what_the_table_says() {
    let _turn = among_others();
    assert_each_does_what_the_table_says("counter", "", &["--fast"]);
}

#[test]
fn each_signal_does_to_a_partition_without_the_library_what_the_table_says() {
    let _turn = among_others();
    assert_each_does_what_the_table_says("impostor", NO_LIBRARY, &["--fast"]);
}

#[test]
fn signal_that_a_partition_handles_is_given_to_its_handler_and_that_is_said() {
    let _turn = among_others();
    let ended = run("hostile", "attributes = { attempt = \"handle\" }", &["--fast"], &["sigusr1"]);
    assert_eq!(ends(&ended), []);
    ended.expect_words(&["came of it: has a handler", "fault sigusr1 is provoked, and it has a handler"]);
}

#[test]
fn fault_that_a_partition_does_not_carry_out_is_said_to_have_come_to_nothing() {
    let _turn = among_others();
    let ended = run("impostor", NO_LIBRARY, &["--fast"], &["panic"]);
    assert_eq!(ends(&ended), []);
    assert_eq!(ended.orders(), ["fault panic has come to nothing: the partition goes on"]);
    ended.expect_words(&["victim: fault panic has come to nothing"]);
    let ended = run("counter", "", &["--fast"], &["panic", "hang"]);
    assert_eq!(ended.orders(), [""; 0], "both were carried out");
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn each_signal_does_to_a_partition_on_the_wall_clock_what_the_table_says() {
        let _turn = alone();
        assert_each_does_what_the_table_says("counter", "", &[]);
    }
}
