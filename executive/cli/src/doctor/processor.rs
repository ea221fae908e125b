//! What the processor itself does to a window: frequency, sleep, a sibling that shares it, a host below it.

use super::root::{cores_in, list_of};
use super::{Finding, Root, Subject};

pub(super) fn findings(root: &Root, subject: &Subject) -> Vec<Finding> {
    let mut findings = vec![frequency(root, subject), idle(root, subject), siblings(root, subject)];
    findings.extend(host(root));
    findings
}

fn frequency(root: &Root, subject: &Subject) -> Finding {
    const TOPIC: &str = "frequency governor";
    let governor =
        |core: &u32| root.text(&format!("sys/devices/system/cpu/cpu{core}/cpufreq/scaling_governor"));
    let governors: Vec<(u32, String)> =
        subject.cores.iter().filter_map(|core| Some((*core, governor(core)?))).collect();
    if governors.is_empty() {
        return Finding::well(TOPIC, "no frequency scaling to be seen");
    }
    match governors.iter().find(|(_, governor)| governor != "performance") {
        None => Finding::well(TOPIC, "performance"),
        Some((core, governor)) => Finding::lacks(
            TOPIC,
            format!("{governor} on processor {core}"),
            "a core that was idle begins slowly: computing takes a multiple at first, changing the frequency tens to hundreds of microseconds",
            subject
                .cores
                .iter()
                .map(|core| {
                    format!("echo performance > /sys/devices/system/cpu/cpu{core}/cpufreq/scaling_governor")
                })
                .collect::<Vec<_>>()
                .join("; "),
        ),
    }
}

/// The longest exit from a sleep state that is left alone, us: about as late as a dispatcher wakes anyway.
const IDLE_US: u64 = 10;

fn idle(root: &Root, subject: &Subject) -> Finding {
    const TOPIC: &str = "idle states";
    let mut deepest: Option<(u64, String)> = None;
    for core in &subject.cores {
        let folder = format!("sys/devices/system/cpu/cpu{core}/cpuidle");
        for state in root.names(&folder) {
            let disabled = root.text(&format!("{folder}/{state}/disable")).is_some_and(|text| text != "0");
            let latency = root.number::<u64>(&format!("{folder}/{state}/latency")).filter(|_| !disabled);
            if let Some(latency) = latency.filter(|us| deepest.as_ref().is_none_or(|(most, _)| us > most)) {
                deepest = Some((latency, root.text(&format!("{folder}/{state}/name")).unwrap_or(state)));
            }
        }
    }
    match deepest {
        None => Finding::well(TOPIC, "none to be seen"),
        Some((us, name)) if us <= IDLE_US => {
            Finding::well(TOPIC, format!("deepest is {name}, {us} us to leave"))
        }
        Some((us, name)) => Finding::lacks(
            TOPIC,
            format!("{name} takes {us} us to leave"),
            format!("up to {us} us at the start of a window after an idle stretch"),
            format!(
                "cpupower -c {} idle-set -D {IDLE_US}; or for as long as it is held open: exec 3> /dev/cpu_dma_latency; printf '\\0\\0\\0\\0' >&3",
                list_of(&subject.cores)
            ),
        ),
    }
}

fn siblings(root: &Root, subject: &Subject) -> Finding {
    const TOPIC: &str = "hyper-threads";
    let siblings = |core: u32| {
        let list = root.text(&format!("sys/devices/system/cpu/cpu{core}/topology/thread_siblings_list"));
        cores_in(&list.unwrap_or_default()).into_iter().filter(move |sibling| *sibling != core)
    };
    let shared: Vec<u32> = subject.cores.iter().flat_map(|core| siblings(*core)).collect();
    if shared.is_empty() {
        return Finding::well(TOPIC, "none beside the plan's cores");
    }
    Finding::lacks(
        TOPIC,
        format!("processors {shared:?} share a core with the plan's {:?}", subject.cores),
        "what runs there slows a window to as little as half, unseen by the schedule: budgets do not hold",
        shared
            .iter()
            .map(|core| format!("echo 0 > /sys/devices/system/cpu/cpu{core}/online"))
            .chain(["or kernel parameter nosmt".into()])
            .collect::<Vec<_>>()
            .join("; "),
    )
}

fn host(root: &Root) -> Option<Finding> {
    let about = root.text("proc/cpuinfo")?;
    let flags = about.lines().find(|line| line.starts_with("flags"))?;
    flags.split_whitespace().any(|flag| flag == "hypervisor").then(|| {
        Finding::note(
            "virtual machine",
            "a hypervisor is below this kernel",
            "the host takes whole cores away for 0.3 to 12 ms now and then: judge the median to p99.9 here, not the worst case",
        )
    })
}
