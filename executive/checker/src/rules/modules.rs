//! Rules about modules: their cores, and that they have something to run.

use std::collections::HashMap;

use super::Context;
use crate::catalogue;
use crate::findings::{Finding, Span};
use crate::model::ModuleId;
use crate::raw::RawModule;

pub(super) fn check(cx: &Context<'_>) {
    for (id, module) in cx.modules() {
        cores(cx, module);
        repeated(cx, module);
        unused(cx, id, module);
        empty(cx, id, module);
    }
}

/// Notes cores without any window, in a module that has windows.
fn unused(cx: &Context<'_>, id: ModuleId, module: &RawModule) {
    let windows = || cx.plan.schedules.iter().flat_map(|schedule| &schedule.windows);
    let mine = || windows().filter(|window| cx.plan[window.partition].module == id);
    // A window that was left out for a fault may be the one that seems to be missing.
    if windows().any(|window| window.minor.is_empty()) || mine().next().is_none() {
        return;
    }
    for core in module.cores.items() {
        if !mine().any(|window| window.core == core.value) {
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
        for core in list.items() {
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
    for core in module.cores.items().iter().chain(module.housekeeping_cores.items()) {
        let Some(first) = seen.insert(core.value, &core.span) else { continue };
        let message = format!("core {} of module `{}` is named twice", core.value, module.name.value);
        let mend = "name it once: under `cores` or under `housekeeping_cores`";
        let finding = Finding::new(&catalogue::CORE_TWICE, &core.span, message, mend);
        cx.add(finding.also(first, "it is named here before"));
    }
}

fn empty(cx: &Context<'_>, id: ModuleId, module: &RawModule) {
    // A partition whose module is not known may be meant for any.
    let used = cx.partitions().any(|(partition, _)| cx.module_of(partition).is_none_or(|owner| owner == id));
    if !used {
        let message = format!("module `{}` has no partition", module.name.value);
        let mend = format!("remove it, or move a partition to it with `module = \"{}\"`", module.name.value);
        cx.note(&catalogue::EMPTY_MODULE, &module.name.span, message, mend);
    }
}
