//! A partition beside one that misbehaves, which notices what is taken from it and raises an error then: a message that
//! is lost, comes twice or is refused, and a resource that it needs a little of and does not get.
//!
//! It sends numbers through each of its sources, one a window, and expects from each queuing destination the number
//! after the one before, from each sampling destination none that is older than the one before. A port that only a
//! misbehaving partition is at the other end of is not judged: its name begins with `loose`.
#![allow(unsafe_code)] // system calls

use std::io;
use std::process::ExitCode;

use bateleur_apex::{
    Context, Direction, Partition, PortKind, QueuingDestination, QueuingSource, SamplingDestination,
    SamplingSource, Sent, StartError, Window,
};
use bateleur_messages::{FunctionStatus, GroundMessage};

struct Neighbour {
    number: u64,
    sampled: Vec<(String, SamplingSource<FunctionStatus>)>,
    queued: Vec<(String, QueuingSource<GroundMessage>)>,
    samples: Vec<(String, SamplingDestination<FunctionStatus>, u64)>,
    queues: Vec<(String, QueuingDestination<GroundMessage>, Option<u64>)>,
    needs: Vec<String>,
}

impl Partition for Neighbour {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let (source, destination) = (Direction::Source, Direction::Destination);
        let mut made = Self {
            number: 0,
            sampled: Vec::new(),
            queued: Vec::new(),
            samples: Vec::new(),
            queues: Vec::new(),
            needs: context.attribute("needs", Vec::new())?,
        };
        for name in context.port_names(PortKind::Sampling, source) {
            let port = context.sampling_source(&name)?;
            made.sampled.push((name, port));
        }
        for name in context.port_names(PortKind::Queuing, source) {
            let port = context.queuing_source(&name)?;
            made.queued.push((name, port));
        }
        for name in context.port_names(PortKind::Sampling, destination) {
            let port = context.sampling_destination(&name)?;
            made.samples.push((name, port, 0));
        }
        for name in context.port_names(PortKind::Queuing, destination) {
            let port = context.queuing_destination(&name)?;
            made.queues.push((name, port, None));
        }
        Ok(made)
    }

    fn window(&mut self, window: &Window) {
        let tell = |name: &str, what: String| {
            if !name.starts_with("loose") {
                window.report(&format!("{name}: {what}"));
            }
        };
        self.number += 1;
        let mut message = GroundMessage::default();
        message.data[..8].copy_from_slice(&self.number.to_le_bytes());
        for (_, port) in &mut self.sampled {
            port.write(&FunctionStatus { accepted: self.number, ..FunctionStatus::default() });
        }
        for (name, port) in &mut self.queued {
            if port.send(&message) == Sent::Full {
                tell(name, format!("message {} is refused", self.number));
            }
        }
        for (name, port, last) in &mut self.samples {
            match port.read_valid().map(|status| status.accepted) {
                // The other one needs a window to begin with.
                None if self.number > 5 => tell(name, format!("no valid message in window {}", self.number)),
                Some(number) if number < *last => tell(name, format!("message {number} after {last}")),
                Some(number) => *last = number,
                None => {}
            }
        }
        for (name, port, last) in &mut self.queues {
            while let Some(message) = port.receive() {
                let mut bytes = [0; 8];
                bytes.copy_from_slice(&message.data[..8]);
                let number = u64::from_le_bytes(bytes);
                if last.is_some_and(|last| number != last + 1) {
                    tell(name, format!("message {number} after {last:?}"));
                }
                *last = Some(number);
            }
        }
        for need in &self.needs {
            if let Err(error) = take_and_give_back(need) {
                window.report(&format!("it is denied {need}: {error}"));
            }
        }
    }
}

/// A little of a resource, given back at once.
fn take_and_give_back(resource: &str) -> io::Result<()> {
    let close = |descriptor: i64| match descriptor {
        -1 => Err(io::Error::last_os_error()),
        // SAFETY: it was made by the caller, who does not keep it.
        _ if unsafe { libc::close(descriptor as i32) } == 0 => Ok(()),
        _ => Err(io::Error::last_os_error()),
    };
    // SAFETY: system calls that make a descriptor, or a mapping that nobody else knows, which are given back.
    unsafe {
        match resource {
            "pipes" => {
                let mut ends = [0; 2];
                match libc::pipe2(ends.as_mut_ptr(), libc::O_CLOEXEC) {
                    0 => ends.iter().try_for_each(|end| close((*end).into())),
                    _ => Err(io::Error::last_os_error()),
                }
            }
            "events" => close(libc::eventfd(0, libc::EFD_CLOEXEC).into()),
            "files" => close(libc::open(c"/dev/null".as_ptr(), libc::O_RDONLY | libc::O_CLOEXEC).into()),
            "memory_files" => close(libc::memfd_create(c"need".as_ptr(), libc::MFD_CLOEXEC).into()),
            "watches" => close(libc::inotify_init1(libc::IN_CLOEXEC).into()),
            "timer_descriptors" => {
                close(libc::timerfd_create(libc::CLOCK_MONOTONIC, libc::TFD_CLOEXEC).into())
            }
            "udp" => close(libc::socket(libc::AF_INET, libc::SOCK_DGRAM | libc::SOCK_CLOEXEC, 0).into()),
            "timers" => {
                let mut timer: libc::c_int = 0;
                let none = std::ptr::null::<libc::sigevent>();
                match libc::syscall(libc::SYS_timer_create, libc::CLOCK_MONOTONIC, none, &raw mut timer) {
                    0 => {
                        libc::syscall(libc::SYS_timer_delete, timer);
                        Ok(())
                    }
                    _ => Err(io::Error::last_os_error()),
                }
            }
            "memory" => {
                let (bytes, protection) = (64 << 10, libc::PROT_READ | libc::PROT_WRITE);
                let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_POPULATE;
                let place = libc::mmap(std::ptr::null_mut(), bytes, protection, flags, -1, 0);
                match place {
                    libc::MAP_FAILED => Err(io::Error::last_os_error()),
                    _ => {
                        libc::munmap(place, bytes);
                        Ok(())
                    }
                }
            }
            other => Err(io::Error::other(format!("{other} is nothing that this program knows"))),
        }
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Neighbour>()
}
