//! What an executive does when its supervisor has died: it starts another one, which watches it from then on.
//!
//! Responsible for: noticing that, and handing over what a supervisor needs. The module goes on meanwhile and is not touched.

use std::io;
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use bateleur_monitor::run_order::RunOrder;
use bateleur_system::handed_over::{self, copy_of_inherited};
use bateleur_system::thread;
use bateleur_system::wait::await_any_end;
use rustix::process::{Pid, PidfdFlags, getpid, getppid, pidfd_open};

use crate::say;

/// How long one question waits for the supervisor's end, ns.
const QUESTION_NS: u64 = 3_600_000_000_000;
/// A supervisor that ends sooner than this after its start is not followed before it is over.
const BREATH: Duration = Duration::from_secs(1);

/// Watches the supervisor of this executive, and starts another one whenever it has died. To be called before the descriptors of
/// `order` are taken.
///
/// # Errors
/// The machine has no memory, descriptor or thread for it.
pub fn watch(compiled: &[u8], order: &RunOrder) -> Result<(), String> {
    let parent = getppid();
    let supervisor = parent.and_then(|parent| pidfd_open(parent, PidfdFlags::empty()).ok());
    // One that died meanwhile has left its number to somebody else.
    let supervisor = supervisor.filter(|_| getppid() == parent);
    let succession = Succession::new(compiled, order)?;
    let started = thread::named("supervision").spawn(move || succession.keep_supervised(supervisor));
    started.map(drop).map_err(|error| format!("cannot watch the supervisor: {error}"))
}

/// What the next supervisor is told and given.
struct Succession {
    plan: OwnedFd,
    order: OwnedFd,
    /// Kept open for it.
    _handed: Vec<OwnedFd>,
}

impl Succession {
    fn new(compiled: &[u8], order: &RunOrder) -> Result<Self, String> {
        let cannot = |error: io::Error| format!("cannot prepare for another supervisor: {error}");
        let (mut order, mut handed) = (order.clone(), Vec::new());
        let mut copy = |number: &mut i32| {
            let copy = copy_of_inherited(*number)?;
            *number = copy.as_raw_fd();
            handed.push(copy);
            Ok::<_, String>(())
        };
        order.events_fd.iter_mut().try_for_each(&mut copy)?;
        if let Some(supervised) = &mut order.supervised {
            copy(&mut supervised.page_fd)?;
            supervised.retained_fds.values_mut().try_for_each(&mut copy)?;
            supervised.memory_block_fds.values_mut().try_for_each(&mut copy)?;
            let own = pidfd_open(getpid(), PidfdFlags::empty()).map_err(|error| cannot(error.into()))?;
            let own = handed_over::copy(own).map_err(cannot)?;
            supervised.executive_fd = Some(own.as_raw_fd());
            handed.push(own);
        }
        let text = serde_json::to_vec(&order).map_err(|error| cannot(error.into()))?;
        Ok(Self {
            plan: handed_over::text("plan", compiled).map_err(cannot)?,
            order: handed_over::text("order", &text).map_err(cannot)?,
            _handed: handed,
        })
    }

    fn keep_supervised(&self, first: Option<OwnedFd>) {
        let await_end = |process: OwnedFd| while !await_any_end(&[process.as_fd()], QUESTION_NS) {};
        first.into_iter().for_each(await_end);
        loop {
            say("bateleur: the supervisor has died; another one is started");
            let begun = Instant::now();
            let next = self
                .start()
                .and_then(|child| Ok((pidfd_open(Pid::from_child(&child), PidfdFlags::empty())?, child)));
            match next {
                Ok((process, mut child)) => {
                    await_end(process);
                    let _ = child.wait(); // it has ended
                }
                Err(error) => return say(&format!("bateleur: no supervisor can be started: {error}")),
            }
            std::thread::sleep(BREATH.saturating_sub(begun.elapsed()));
        }
    }

    fn start(&self) -> io::Result<Child> {
        for file in [&self.plan, &self.order] {
            rustix::fs::seek(file, rustix::fs::SeekFrom::Start(0))?; // the one before has read them
        }
        let arguments = [&self.plan, &self.order].map(|file| format!("fd:{}", file.as_raw_fd()));
        Command::new(std::env::current_exe()?).args(arguments).spawn()
    }
}
