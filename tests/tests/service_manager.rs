//! What a service manager hears of a run: that it is up, that it lives, and that it ends.

use std::fs::{File, read_to_string};
use std::os::unix::net::UnixDatagram;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;

use bateleur_tests::{Sketch, alone, await_some, executive_of, program};
use rustix::process::{Pid, Signal, kill_process};

/// A run as a service.
struct Service {
    process: Child,
    folder: tempfile::TempDir,
}

impl Service {
    fn pid(&self) -> i32 {
        self.process.id() as i32
    }

    fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.process), signal).unwrap();
    }

    fn said(&self) -> String {
        read_to_string(self.folder.path().join("stderr")).unwrap()
    }

    #[track_caller]
    fn end(&mut self) {
        let ended = await_some(Duration::from_secs(60), || self.process.try_wait().unwrap());
        assert!(ended.as_ref().is_some_and(ExitStatus::success), "{ended:?}: {}", self.said());
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        let _ = self.process.kill(); // it has ended
        let _ = self.process.wait();
    }
}

/// A manager's socket, in a folder.
struct Manager {
    folder: tempfile::TempDir,
    socket: UnixDatagram,
    heard: Vec<String>,
}

impl Manager {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let socket = UnixDatagram::bind(folder.path().join("notify")).unwrap();
        socket.set_nonblocking(true).unwrap();
        Self { folder, socket, heard: Vec::new() }
    }

    /// Runs a module of one partition whose health table of the module is `module`, as a service with a watchdog of 0.4 s.
    fn run(&self, module: &str) -> Service {
        let folder = tempfile::tempdir().unwrap();
        let health = format!("[health.module]\n{module}\n");
        let schedule = Sketch::new().table(&health).partition("one", "counter", 500, "").write(folder.path());
        let mut command = Command::new(program("bateleur"));
        command.args(["run", "--until", "60", "--schedule", &schedule, "--output"]);
        command.arg(folder.path().join("out")).stdin(Stdio::null()).stdout(Stdio::null());
        command.stderr(File::create(folder.path().join("stderr")).unwrap());
        command.env("NOTIFY_SOCKET", self.folder.path().join("notify")).env("WATCHDOG_USEC", "400000");
        Service { process: command.spawn().unwrap(), folder }
    }

    fn listen(&mut self) -> &[String] {
        let mut bytes = [0; 512];
        while let Ok(count) = self.socket.recv(&mut bytes) {
            self.heard.push(String::from_utf8(bytes[..count].to_vec()).unwrap());
        }
        &self.heard
    }

    fn count(&mut self, words: &str) -> usize {
        self.listen().iter().filter(|heard| heard.starts_with(words)).count()
    }

    #[track_caller]
    fn await_count(&mut self, words: &str, count: usize) {
        let heard = await_some(Duration::from_secs(60), || (self.count(words) >= count).then_some(()));
        assert!(heard.is_some(), "{words} was not heard {count} times: {:?}", self.heard);
    }
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn service_is_up_when_frames_begin_lives_while_it_runs_and_says_that_it_ends() {
        let _turn = alone();
        for module in
            ["executive_died = \"shutdown\"", "executive_died = \"reset\"\nexecutive_hung = \"reset\""]
        {
            let mut manager = Manager::new();
            let mut run = manager.run(module);
            manager.await_count("READY=1", 1);
            assert!(
                run.said().contains("1 partition is ready"),
                "before the partitions are ready: {}",
                run.said()
            );
            manager.await_count("WATCHDOG=1", 5);
            assert_eq!(
                (manager.count("READY=1"), manager.count("STOPPING=1")),
                (1, 0),
                "{:?}",
                manager.heard
            );
            run.signal(Signal::TERM);
            run.end();
            assert_eq!(
                (manager.count("READY=1"), manager.count("STOPPING=1")),
                (1, 1),
                "{:?}",
                manager.heard
            );
        }
    }

    #[test]
    fn service_lives_on_while_its_executive_is_replaced_and_says_so_and_not_when_its_supervisor_is_stopped() {
        let _turn = alone();
        let mut manager = Manager::new();
        let mut run = manager.run("executive_died = \"reset\"\nexecutive_hung = \"reset\"");
        manager.await_count("READY=1", 1);
        executive_of(run.pid()).signal(Signal::KILL);
        manager.await_count("STATUS=executive_died", 1);
        let again =
            await_some(Duration::from_secs(60), || run.said().contains("frame 0 again").then_some(()));
        assert!(again.is_some(), "{}", run.said());
        let so_far = manager.count("WATCHDOG=1");
        manager.await_count("WATCHDOG=1", so_far + 4);
        assert_eq!(manager.count("READY=1"), 1, "{:?}", manager.heard);
        run.signal(Signal::STOP);
        std::thread::sleep(Duration::from_millis(300));
        let so_far = manager.count("WATCHDOG=1");
        std::thread::sleep(Duration::from_millis(1_500));
        assert_eq!(manager.count("WATCHDOG=1"), so_far, "a supervisor that hangs gives no sign of life");
        run.signal(Signal::CONT);
        manager.await_count("WATCHDOG=1", so_far + 2);
        run.signal(Signal::TERM);
        run.end();
    }

    #[test]
    fn service_of_which_nothing_runs_any_more_is_not_said_to_live() {
        let _turn = alone();
        let mut manager = Manager::new();
        let mut run = manager.run("executive_died = \"shutdown\"");
        manager.await_count("READY=1", 1);
        run.signal(Signal::STOP);
        std::thread::sleep(Duration::from_millis(300));
        let so_far = manager.count("WATCHDOG=1");
        std::thread::sleep(Duration::from_millis(1_500));
        assert_eq!(manager.count("WATCHDOG=1"), so_far, "an executive that is stopped");
        run.signal(Signal::CONT);
        run.signal(Signal::TERM);
        run.end();
    }
}
