//! Which modules run on this machine, and which of them is meant.

use std::collections::BTreeSet;
use std::path::PathBuf;

use serde::Serialize;

use super::SOCKET;
use bateleur_host::instance::{self, Instance};

/// A module that runs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Running {
    /// Its name in its plan.
    pub module: String,
    /// The executive's process.
    pub pid: i32,
    /// Its control socket.
    pub socket: PathBuf,
    /// The processors that its dispatchers have.
    pub cores: Vec<u32>,
}

/// A processor that the dispatchers of several modules have: each takes the windows of the others.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SharedCore {
    /// The processor.
    pub core: u32,
    /// The executives' processes.
    pub pids: Vec<i32>,
}

/// The processors that more than one of `list` has.
#[must_use]
pub fn shared_cores(list: &[Running]) -> Vec<SharedCore> {
    let cores: BTreeSet<u32> = list.iter().flat_map(|running| running.cores.iter().copied()).collect();
    let owners = cores.into_iter().map(|core| {
        let has = list.iter().filter(|running| running.cores.contains(&core));
        SharedCore { core, pids: has.map(|running| running.pid).collect() }
    });
    owners.filter(|shared| shared.pids.len() > 1).collect()
}

/// Why no module could be chosen.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ChooseError {
    /// None runs.
    #[error(
        "no module runs on this machine that this user may control: start one with `bateleur run` or `bateleur fly`"
    )]
    None,
    /// None that is called so.
    #[error("no module \"{asked}\" runs on this machine; running: {known}")]
    NoSuch {
        /// What was asked for.
        asked: String,
        /// Those that run.
        known: String,
    },
    /// Several.
    #[error("several modules run on this machine: choose one with --module NAME or --module PID ({known})")]
    Several {
        /// Those that run.
        known: String,
    },
}

/// The modules that this user may control, in the order of their processes' numbers.
#[must_use]
pub fn running() -> Vec<Running> {
    // One that is still starting has no socket yet.
    let all = instance::living();
    let mut list: Vec<_> = all.iter().map(of_instance).filter(|running| running.socket.exists()).collect();
    list.sort_by_key(|running| running.pid);
    list
}

fn of_instance(instance: &Instance) -> Running {
    Running {
        module: instance.module().to_owned(),
        pid: instance.pid,
        socket: instance.directory().join(SOCKET),
        cores: instance.cores.clone(),
    }
}

/// The one of `list` that `asked` names, by its module or by its process; without a name, the only one.
///
/// # Errors
/// None or several fit.
pub fn choose<'a>(list: &'a [Running], asked: Option<&str>) -> Result<&'a Running, ChooseError> {
    let fits = |running: &&Running| {
        asked.is_none_or(|asked| running.module == asked || asked.parse() == Ok(running.pid))
    };
    let fitting: Vec<_> = list.iter().filter(fits).collect();
    match (fitting.as_slice(), asked) {
        ([only], _) => Ok(only),
        ([], _) if list.is_empty() => Err(ChooseError::None),
        ([], asked) => {
            Err(ChooseError::NoSuch { asked: asked.unwrap_or_default().into(), known: names(list.iter()) })
        }
        (several, _) => Err(ChooseError::Several { known: names(several.iter().copied()) }),
    }
}

fn names<'a>(list: impl Iterator<Item = &'a Running>) -> String {
    let names: Vec<_> = list.map(|running| format!("{} with PID {}", running.module, running.pid)).collect();
    names.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(module: &str, pid: i32) -> Running {
        Running { module: module.into(), pid, socket: PathBuf::new(), cores: Vec::new() }
    }

    #[test]
    fn modules_whose_dispatchers_have_one_processor_are_named_and_one_alone_is_not() {
        let on = |pid, cores: &[u32]| Running { cores: cores.to_vec(), ..of("fcu", pid) };
        let list = [on(7, &[1, 2]), on(8, &[2, 3]), on(9, &[])];
        assert_eq!(shared_cores(&list), [SharedCore { core: 2, pids: vec![7, 8] }]);
        assert_eq!(shared_cores(&list[1..]), []);
    }

    #[test]
    fn the_only_module_needs_no_name() {
        assert_eq!(choose(&[of("fcu", 7)], None).unwrap().pid, 7);
        assert_eq!(choose(&[], None), Err(ChooseError::None));
    }

    #[test]
    fn two_runs_of_one_module_are_told_apart_by_their_process() {
        let list = [of("fcu", 7), of("fcu", 8)];
        assert!(matches!(choose(&list, None), Err(ChooseError::Several { .. })));
        assert!(matches!(choose(&list, Some("fcu")), Err(ChooseError::Several { .. })));
        assert_eq!(choose(&list, Some("8")).unwrap().pid, 8);
    }

    #[test]
    fn a_module_that_does_not_run_is_refused_with_those_that_do() {
        let error = choose(&[of("fcu", 7)], Some("relay")).unwrap_err().to_string();
        assert!(error.contains("relay") && error.contains("fcu with PID 7"), "{error}");
    }
}
