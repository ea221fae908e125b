//! A partition that runs within the caller's process: the same code, one call for each window.
//!
//! Responsible for: ports, time, reports and windows as an executive gives them. What only an executive and a process of its own
//! give is not here: isolation, the end of a window, restarts, retained memory, faults.

use std::collections::BTreeMap;
use std::os::fd::AsRawFd;
use std::rc::Rc;
use std::sync::atomic::Ordering::Relaxed;

use bateleur_contract::page::WindowGrant;
use bateleur_contract::sealed::SealedDescriptors;
use bateleur_contract::{Clock, ControlPage, Description, Mapped};
use bateleur_ports::Handed;
use rustix::fs::{MemfdFlags, ftruncate, memfd_create};

use crate::context::{Context, StartError, Started};
use crate::run::Partition;
use crate::time::{Neighbour, Time};
use crate::window::Window;

/// What a partition is started with.
pub struct Hosting<'a> {
    /// As the plan has it. Retained memory is not given.
    pub description: Description,
    /// The memory of every channel, by its name. It must live as long as the partition starts.
    pub channels: &'a BTreeMap<String, Handed>,
    /// Called where the partition waits for a device: whoever answers at its other end, in this process too, does so then.
    pub neighbour: Rc<dyn Fn()>,
}

/// A partition of whatever type.
trait Windows {
    fn window(&mut self, window: &Window);
}

impl<P: Partition> Windows for P {
    fn window(&mut self, window: &Window) {
        Partition::window(self, window);
    }
}

/// A partition that has started.
pub struct Hosted {
    partition: Box<dyn Windows>,
    time: Time,
    _started: Started,
    reports_seen: u32,
}

impl Hosted {
    /// Starts it, at module time 0 of the virtual clock.
    ///
    /// # Errors
    /// What its `start` says, and what an executive would: a port or an attribute that it does not ask for. No memory.
    pub fn start<P: Partition + 'static>(hosting: Hosting<'_>) -> Result<Self, StartError> {
        let Hosting { mut description, channels, neighbour } = hosting;
        description.retained_bytes = 0;
        for port in description.ports.iter_mut().filter(|port| !port.channel.is_empty()) {
            let Some(memory) = channels.get(&port.channel) else {
                return Err(StartError::Other(format!("there is no channel {}", port.channel)));
            };
            port.sealed = Some(SealedDescriptors {
                ring: memory.ring.as_raw_fd(),
                index: memory.index.as_ref().map(AsRawFd::as_raw_fd),
                checked: memory.checked,
            });
        }
        let time = Time::new(Rc::new(page()?), Clock::Virtual).granted_by_caller(&description.partition);
        let time = time.beside(Neighbour(neighbour));
        let mut context = Context::new(description, time.clone(), None)?;
        let partition = Box::new(P::start(&mut context)?);
        let started = context.finish()?;
        started.connect();
        Ok(Self { partition, time, _started: started, reports_seen: 0 })
    }

    /// One window.
    pub fn window(&mut self, granted: &WindowGrant) {
        let page = self.time.page();
        page.now_ns.store(granted.start_ns, Relaxed);
        page.publish_grant(page.grant.load(Relaxed).wrapping_add(1), granted);
        let (_, window) = Window::granted(&self.time);
        self.partition.window(&window);
    }

    /// Its control page, as its executive sees it.
    pub fn page(&self) -> &ControlPage {
        self.time.page()
    }

    /// What it has reported since the last look.
    pub fn reports(&mut self) -> Vec<bateleur_contract::Reported> {
        let page = self.time.page();
        if page.reports_so_far() == self.reports_seen {
            return Vec::new();
        }
        page.reports_since(&mut self.reports_seen)
    }
}

fn page() -> Result<Mapped<ControlPage>, StartError> {
    let refused = |error: &dyn std::fmt::Display| StartError::Other(format!("no control page: {error}"));
    let memory = memfd_create("page", MemfdFlags::CLOEXEC).map_err(|error| refused(&error))?;
    ftruncate(&memory, size_of::<ControlPage>() as u64).map_err(|error| refused(&error))?;
    let page = Mapped::<ControlPage>::new(memory).map_err(|error| refused(&error))?;
    page.initialise();
    Ok(page)
}
