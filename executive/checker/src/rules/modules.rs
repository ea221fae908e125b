//! Rules about modules: their cores, and that they have something to run.

use std::collections::HashMap;

use super::Context;
use super::laid::Laid;
use crate::catalogue;
use crate::findings::{Finding, Span};
use crate::raw::RawModule;

pub(super) fn check(cx: &Context<'_>, laid: &[Laid]) {
    for (place, module) in cx.file.modules.iter().enumerate() {
        cores(cx, module);
        repeated(cx, module);
        unused(cx, laid, place);
    }
    empty(cx);
}

/// Notes cores without any window, in a module that has windows.
fn unused(cx: &Context<'_>, laid: &[Laid], place: usize) {
    let module = &cx.file.modules[place];
    let sound = cx.file.schedules.iter().zip(laid).all(|(schedule, laid)| {
        // A window that was left out for a fault may be the one that seems to be missing.
        let places: std::collections::BTreeSet<usize> = laid.slots.iter().map(|slot| slot.window).collect();
        places.len() == schedule.windows.len()
    });
    let slots = || laid.iter().flat_map(|laid| &laid.slots).filter(|slot| slot.module == place);
    if !sound || slots().next().is_none() {
        return;
    }
    for core in module.cores.said().into_iter().flat_map(|list| &list.value) {
        if !slots().any(|slot| slot.core == core.value) {
            let message =
                format!("no window of any schedule is on core {} of `{}`", core.value, module.name.value);
            let mend = "move some windows to it with `core`, or take it from the list";
            cx.note(&catalogue::UNUSED_CORE, &core.span, message, mend);
        }
    }
}

/// The last core that a fixed set of Linux names; no machine that flies has more.
const LAST_CORE: u32 = 1023;

fn cores(cx: &Context<'_>, module: &RawModule) {
    for (key, list) in [("cores", &module.cores), ("housekeeping_cores", &module.housekeeping_cores)] {
        for core in list.said().into_iter().flat_map(|list| &list.value) {
            cx.at_in_range(key, core, 0, LAST_CORE);
        }
    }
    if let Some(cores) = module.cores.said().filter(|cores| cores.value.is_empty()) {
        let message = format!("module `{}` has no core", module.name.value);
        cx.note(&catalogue::NO_CORE, &cores.span, message, "give it at least one, such as `cores = [1]`");
    }
}

fn repeated(cx: &Context<'_>, module: &RawModule) {
    let mut seen: HashMap<u32, &Span> = HashMap::new();
    let lists = [module.cores.said(), module.housekeeping_cores.said()];
    for core in lists.into_iter().flatten().flat_map(|list| &list.value) {
        let Some(first) = seen.insert(core.value, &core.span) else { continue };
        let message = format!("core {} of module `{}` is named twice", core.value, module.name.value);
        let mend = "name it once: under `cores` or under `housekeeping_cores`";
        let finding = Finding::new(&catalogue::CORE_TWICE, &core.span, message, mend);
        cx.add(finding.also(first, "it is named here before"));
    }
}

fn empty(cx: &Context<'_>) {
    let used = |name: &str| {
        let mut modules = cx.file.partitions.iter().map(|partition| &partition.module);
        // A partition whose module is not known may be meant for any.
        modules.any(|module| {
            module.said().is_none_or(|said| said.value == name || cx.names.module(&said.value).is_none())
        })
    };
    for module in cx.file.modules.iter().filter(|module| !used(&module.name.value)) {
        let message = format!("module `{}` has no partition", module.name.value);
        let mend = format!("remove it, or move a partition to it with `module = \"{}\"`", module.name.value);
        cx.note(&catalogue::EMPTY_MODULE, &module.name.span, message, mend);
    }
}
