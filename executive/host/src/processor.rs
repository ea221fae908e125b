//! Which processor a module on the virtual clock takes: one window follows the other, on any, and modules that run at a time share the
//! processors out.

use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};

use bateleur_system::sched;

/// How many modules may share a processor and be counted.
const MOST: usize = 64;

/// Counts one more module on a processor until it is dropped. It locks nobody out.
#[derive(Debug)]
pub struct Claim {
    processor: u32,
    /// A name in the kernel's table of sockets, which ends with the process.
    _name: Option<UnixDatagram>,
}

impl Claim {
    /// The processor with the fewest modules, of those that this process may use. At a tie the plan's first, or the last one if that may not
    /// be used.
    #[must_use]
    pub fn take(planned: &[u32]) -> Self {
        Self::of(&sched::allowed_cores(), planned, "bateleur")
    }

    /// Which one it is.
    #[must_use]
    pub fn processor(&self) -> u32 {
        self.processor
    }

    /// A module on the wall clock does not count: its windows go before, and on the other processors its monitor needs room.
    fn of(allowed: &[u32], planned: &[u32], prefix: &str) -> Self {
        let last = allowed.last().copied().unwrap_or(0);
        let own = planned.first().copied().filter(|core| allowed.contains(core)).unwrap_or(last);
        let others = allowed.iter().copied().filter(|core| *core != own);
        let all: Vec<u32> = [own].into_iter().chain(others).collect();
        (0..MOST)
            .flat_map(|number| all.iter().map(move |core| (number, *core)))
            .find_map(|(number, processor)| {
                let name = SocketAddr::from_abstract_name(format!("{prefix}.processor.{processor}.{number}"));
                let name = UnixDatagram::bind_addr(&name.ok()?).ok()?;
                Some(Self { processor, _name: Some(name) })
            })
            .unwrap_or(Self { processor: own, _name: None })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modules_share_the_processors_out_and_leave_them_again() {
        let prefix = format!("bateleur-test-{}", std::process::id());
        let take = |allowed: &[u32]| Claim::of(allowed, &[1, 2], &prefix);
        let mut claims: Vec<Claim> = (0..5).map(|_| take(&[0, 1, 2])).collect();
        let processors: Vec<u32> = claims.iter().map(Claim::processor).collect();
        assert_eq!(processors, [1, 0, 2, 1, 0]);
        drop(claims.remove(1));
        assert_eq!(take(&[0, 1, 2]).processor(), 0, "the place of the one that has ended");
        assert_eq!(take(&[5]).processor(), 5);
    }
}
