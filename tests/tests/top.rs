//! `bateleur top` as whoever sits before it sees it: in a terminal (tmux), by what it shows after each key.

use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

use bateleur_tests::{Sketch, alone, await_some, bateleur, program};

/// How long the terminal may take to show something: a module restarts a partition in that time, too.
const PATIENCE: Duration = Duration::from_secs(30);

/// A terminal without a screen; ended when dropped.
struct Terminal {
    socket: PathBuf,
    _folder: tempfile::TempDir,
}

impl Terminal {
    /// Runs a line of a shell in a terminal of that size. `None`: there is no tmux, and that has been said; in CI that is a failure.
    fn running(line: &str, (width, height): (u32, u32)) -> Option<Self> {
        if Command::new("tmux").arg("-V").output().is_err() {
            let needed = std::env::var_os("CI").is_some_and(|value| value == "true");
            assert!(!needed, "a terminal is needed in CI: tests/terminal/prepare installs it");
            eprintln!("NOT TESTED in a terminal: there is no tmux (on Debian: tests/terminal/prepare)");
            return None;
        }
        let folder = tempfile::tempdir().unwrap();
        let terminal = Self { socket: folder.path().join("socket"), _folder: folder };
        let (width, height) = (width.to_string(), height.to_string());
        terminal.tmux(&["new-session", "-d", "-x", &width, "-y", &height, line]);
        Some(terminal)
    }

    fn tmux(&self, arguments: &[&str]) -> String {
        let mut tmux = Command::new("tmux");
        tmux.env("LC_ALL", "C.UTF-8").args(["-f", "/dev/null", "-S"]).arg(&self.socket).args(arguments);
        let ended = tmux.output().unwrap();
        assert!(ended.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&ended.stderr));
        String::from_utf8_lossy(&ended.stdout).into_owned()
    }

    fn press(&self, keys: &[&str]) {
        self.tmux(&[&["send-keys"], keys].concat());
    }

    fn shown(&self) -> String {
        self.tmux(&["capture-pane", "-p"])
    }

    /// Waits until what is shown is as wanted.
    #[track_caller]
    fn await_shown(&self, what: &str, wanted: impl Fn(&str) -> bool) -> String {
        let mut shown = String::new();
        let seen = await_some(PATIENCE, || {
            shown = self.shown();
            wanted(&shown).then_some(())
        });
        assert!(seen.is_some(), "{what} is not shown:\n{shown}");
        shown
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        let _ = Command::new("tmux").arg("-S").arg(&self.socket).arg("kill-server").output(); // it has ended
    }
}

/// The words of a partition's line.
fn row(shown: &str, partition: &str) -> Vec<String> {
    let line = shown.lines().find(|line| line.split_whitespace().next() == Some(partition));
    line.unwrap_or_default().split_whitespace().map(str::to_owned).collect()
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn keys_sort_show_details_and_kill_freeze_and_thaw_a_partition_and_the_terminal_is_given_back() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let keys = "restart = { start = \"cold\", budget = 50, within = \"10s\", then = \"idle\" }";
        let sketch =
            Sketch::new().partition("one", "counter", 1000, keys).partition("two", "counter", 1000, keys);
        let schedule = sketch.write(folder.path());
        let mut module = bateleur(&["run", "--schedule", &schedule]);
        module.await_words("2 partitions are ready");
        let top = program("bateleur").display().to_string();
        let line = format!(
            "echo BEFORE; '{top}' top --interval 0.2 --module {}; echo LEFT $?; sleep 600",
            module.pid()
        );
        let Some(terminal) = Terminal::running(&line, (110, 32)) else { return };
        let is = |partition: &'static str, at: usize, word: &'static str| {
            move |shown: &str| row(shown, partition).get(at).is_some_and(|found| found == word)
        };
        terminal
            .await_shown("the table", |shown| is("one", 1, "normal")(shown) && is("two", 1, "normal")(shown));
        let windows = |shown: &str| shown.lines().find(|line| line.contains(" windows, ")).map(str::to_owned);
        let before = windows(&terminal.shown());
        terminal.await_shown("another number of windows", |shown| windows(shown) != before);

        terminal.press(&["s", "r"]);
        terminal.await_shown("the other order", |shown| {
            shown.contains("sorted by name, reversed") && shown.find("\ntwo ") < shown.find("\none ")
        });
        terminal.press(&["r", "Home", "Down", "Enter"]);
        terminal.await_shown("details of two", |shown| {
            shown.contains("  windows: ")
                && shown.contains("lateness: median")
                && shown.matches("two").count() == 2
        });
        terminal.press(&["K"]);
        terminal.await_shown("a question", |shown| shown.contains("kill two? (y/n)"));
        terminal.press(&["n"]);
        terminal.await_shown("no question any more", |shown| !shown.contains("(y/n)"));
        assert!(is("two", 3, "0")(&terminal.shown()), "nobody said yes: {}", terminal.shown());
        terminal.press(&["K", "y"]);
        terminal
            .await_shown("the successor", |shown| is("two", 3, "1")(shown) && is("two", 1, "normal")(shown));
        terminal
            .await_shown("the fault", |shown| shown.contains("last fault: ") && shown.contains("SIGKILL"));
        assert!(is("one", 3, "0")(&terminal.shown()), "the other one is as it was");
        terminal.press(&["F", "y"]);
        terminal.await_shown("a frozen partition", is("two", 1, "frozen"));
        terminal.press(&["T"]);
        terminal.await_shown("it goes on", is("two", 1, "normal"));
        terminal.press(&["I"]);
        terminal.await_shown("the faults", |shown| {
            shown.contains("provoke a fault in two") && shown.contains("panic")
        });
        terminal.press(&["Enter"]);
        terminal.await_shown("the next successor", is("two", 3, "2"));
        terminal.press(&["?"]);
        terminal.await_shown("the keys", |shown| shown.contains("change the schedule"));

        terminal.tmux(&["resize-window", "-x", "50", "-y", "9"]);
        terminal.await_shown("the chosen one on a small terminal", is("two", 1, "normal"));
        terminal.press(&["q", "q", "q"]);
        let left = terminal.await_shown("the shell", |shown| shown.contains("LEFT 0"));
        assert!(
            left.contains("BEFORE") && !left.contains("PARTITION"),
            "what was there is there again:\n{left}"
        );
        assert!(!module.has_ended(), "the module goes on");
    }

    #[test]
    fn a_module_that_ends_gives_the_terminal_back() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let schedule = Sketch::new().partition("one", "counter", 1000, "").write(folder.path());
        let mut module = bateleur(&["run", "--schedule", &schedule]);
        module.await_words("1 partition is ready");
        let top = program("bateleur").display().to_string();
        let line = format!("'{top}' top --module {}; echo LEFT $?; sleep 600", module.pid());
        let Some(terminal) = Terminal::running(&line, (80, 24)) else { return };
        terminal.await_shown("the table", |shown| shown.contains("sorted by plan"));
        module.signal(rustix::process::Signal::INT);
        module.end();
        let left = terminal.await_shown("the shell", |shown| shown.contains("LEFT 0"));
        assert!(left.contains("the module has ended"), "{left}");
    }
}
