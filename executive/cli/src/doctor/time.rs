//! What moves a window: priority, throttling, other work on the core, the clock.

use super::root::{cores_in, list_of};
use super::{Finding, Root, Subject};

pub(super) fn findings(root: &Root, subject: &Subject) -> Vec<Finding> {
    vec![
        kernel(root),
        preemption(root),
        priority(root),
        throttling(root),
        group_scheduling(root),
        isolation(root, subject),
        ticks(root, subject),
        interrupts(root, subject),
        clock_source(root),
    ]
}

/// `cgroup.kill` came with it; entering a group by `clone3` (5.7) and waiting on a descriptor (5.4) are older.
const KERNEL: (u32, u32) = (5, 14);

fn kernel(root: &Root) -> Finding {
    const TOPIC: &str = "kernel";
    let release = root.text("proc/sys/kernel/osrelease").unwrap_or_default();
    let mut numbers =
        release.split(|letter: char| !letter.is_ascii_digit()).map_while(|part| part.parse().ok());
    let version = (numbers.next().unwrap_or(0), numbers.next().unwrap_or(0));
    if version >= KERNEL {
        return Finding::well(TOPIC, release);
    }
    Finding::lacks(
        TOPIC,
        format!("{release}, older than {}.{}", KERNEL.0, KERNEL.1),
        "no cgroup.kill: what a killed executive leaves behind has to be ended by hand; before 5.7 no partition can be started into its group",
        "a kernel of 5.14 or newer",
    )
}

fn preemption(root: &Root) -> Finding {
    const TOPIC: &str = "PREEMPT_RT";
    let said = root.text("sys/kernel/realtime").is_some_and(|text| text == "1");
    let version = root.text("proc/sys/kernel/version").unwrap_or_default();
    if said || version.contains("PREEMPT_RT") {
        return Finding::well(TOPIC, "a real-time kernel");
    }
    Finding::lacks(
        TOPIC,
        "not a real-time kernel",
        "a system call or an interrupt of somebody else delays a switch for as long as the kernel holds its core: the median stays, the rare delay (one in a thousand and beyond) is not bounded",
        "a kernel with CONFIG_PREEMPT_RT (in Linux since 6.12; distributions: linux-image-rt, kernel-rt)",
    )
}

const CAP_SYS_NICE: u32 = 23;

fn priority(root: &Root) -> Finding {
    const TOPIC: &str = "real-time priority";
    let limit = root.limit("Max realtime priority").unwrap_or(0);
    match (root.has_capability(CAP_SYS_NICE), limit) {
        (true, _) => Finding::well(TOPIC, "CAP_SYS_NICE"),
        (false, 98..) => Finding::well(TOPIC, format!("limit of {limit}")),
        (false, _) => Finding::lacks(
            TOPIC,
            format!("no CAP_SYS_NICE, and a limit of {limit} where the dispatcher needs 98"),
            "windows start when the ordinary scheduler finds time and end 0.2 to 0.8 ms late",
            "sudo, or the unit docs/bateleur.service; for a login: `@realtime - rtprio 98` in /etc/security/limits.d/bateleur.conf",
        ),
    }
}

fn throttling(root: &Root) -> Finding {
    const TOPIC: &str = "real-time throttling";
    let runtime_us: i64 = root.number("proc/sys/kernel/sched_rt_runtime_us").unwrap_or(-1);
    let period_us: i64 = root.number("proc/sys/kernel/sched_rt_period_us").unwrap_or(1_000_000);
    if runtime_us < 0 {
        return Finding::note(TOPIC, "off", "a fault at real-time priority can hold a core for ever");
    }
    if runtime_us * 100 < period_us * 95 {
        return Finding::lacks(
            TOPIC,
            format!("real-time work may have {runtime_us} us of each {period_us} us"),
            format!(
                "a schedule that uses more of a core is stopped for up to {} us, the dispatcher with it",
                period_us - runtime_us
            ),
            "sysctl -w kernel.sched_rt_runtime_us=950000",
        );
    }
    Finding::note(
        TOPIC,
        format!("real-time work may have {runtime_us} us of each {period_us} us"),
        format!(
            "nothing below 95 % of a core (`bateleur check` warns from 90 %); beyond it everything stops for {} us a period, the dispatcher with it",
            period_us - runtime_us
        ),
    )
}

/// Cgroup v1 `cpu` groups have a real-time budget of their own, which is nothing at first.
fn group_scheduling(root: &Root) -> Finding {
    const TOPIC: &str = "real-time group scheduling";
    let mounts = root.text("proc/self/mounts").unwrap_or_default();
    let groups = root.text("proc/self/cgroup").unwrap_or_default();
    let mount = mounts.lines().map(|line| line.split(' ').collect::<Vec<_>>()).find_map(|fields| {
        let is_cpu = fields.get(2) == Some(&"cgroup") && fields.get(3)?.split(',').any(|word| word == "cpu");
        is_cpu.then(|| fields[1].to_owned())
    });
    let own = groups.lines().find_map(|line| {
        let (_, rest) = line.split_once(':')?;
        let (controllers, path) = rest.split_once(':')?;
        controllers.split(',').any(|name| name == "cpu").then(|| path.to_owned())
    });
    let Some(file) = mount
        .zip(own)
        .map(|(mount, own)| format!("{}/cpu.rt_runtime_us", format!("{mount}{own}").trim_end_matches('/')))
    else {
        return Finding::well(TOPIC, "no cgroup v1 cpu group");
    };
    match root.number::<i64>(&file) {
        None => Finding::well(TOPIC, "not in this kernel"),
        Some(0) => Finding::lacks(
            TOPIC,
            format!("this process is in a v1 cpu group without a real-time budget ({file} is 0)"),
            "SCHED_FIFO is refused (EPERM), so windows start when the ordinary scheduler finds time",
            format!("echo 940000 > {file}, or move the shell to the top: echo $$ > {}", top_tasks(&mounts)),
        ),
        Some(budget) => Finding::well(TOPIC, format!("this v1 cpu group may have {budget} us")),
    }
}

fn top_tasks(mounts: &str) -> String {
    let fields = mounts.lines().map(|line| line.split(' ').collect::<Vec<_>>());
    let at = fields
        .filter(|fields| fields.len() > 3 && fields[2] == "cgroup")
        .find_map(|fields| fields[3].split(',').any(|word| word == "cpu").then(|| fields[1].to_owned()));
    format!("{}/cgroup.procs", at.unwrap_or_default())
}

fn isolation(root: &Root, subject: &Subject) -> Finding {
    const TOPIC: &str = "isolated cores";
    let mut isolated = cores_in(&root.text("sys/devices/system/cpu/isolated").unwrap_or_default());
    isolated.extend(cores_in(&root.text("sys/fs/cgroup/cpuset.cpus.isolated").unwrap_or_default()));
    let shared = without(&subject.cores, &isolated);
    if shared.is_empty() {
        return Finding::well(TOPIC, format!("{:?}, all that the plan names", subject.cores));
    }
    Finding::lacks(
        TOPIC,
        format!("the scheduler places ordinary work on {shared:?} of the plan's {:?}", subject.cores),
        "that work gives way at once, but leaves cold caches and its kernel work behind: microseconds at a window's start, more in the rare case",
        format!(
            "kernel parameter isolcpus={0}, or a cgroup v2 cpuset partition: cpuset.cpus={0}, cpuset.cpus.partition=isolated",
            list_of(&subject.cores)
        ),
    )
}

fn ticks(root: &Root, subject: &Subject) -> Finding {
    const TOPIC: &str = "ticks and callbacks";
    let listed = |name: &str| cores_in(&root.boot_parameter(name).unwrap_or_default());
    let full = root.text("sys/devices/system/cpu/nohz_full").map(|list| cores_in(&list)).unwrap_or_default();
    let ticking = without(&subject.cores, &full);
    // nohz_full moves the callbacks away as well.
    let calling = without(&without(&subject.cores, &full), &listed("rcu_nocbs"));
    if ticking.is_empty() && calling.is_empty() {
        return Finding::well(TOPIC, "none on the plan's cores while one thread runs");
    }
    let cores = list_of(&subject.cores);
    Finding::lacks(
        TOPIC,
        format!("the timer ticks on {ticking:?}, RCU callbacks run on {calling:?}"),
        "each tick takes a few microseconds from whatever window it falls into (100 to 1000 a second), callbacks more",
        format!("kernel parameters nohz_full={cores} rcu_nocbs={cores}"),
    )
}

fn interrupts(root: &Root, subject: &Subject) -> Finding {
    const TOPIC: &str = "interrupt affinity";
    let numbers = root.names("proc/irq").into_iter().filter(|name| name.parse::<u32>().is_ok());
    let there: Vec<String> = numbers
        .filter(|number| {
            let list =
                |file: &str| root.text(&format!("proc/irq/{number}/{file}")).filter(|text| !text.is_empty());
            let cores =
                list("effective_affinity_list").or_else(|| list("smp_affinity_list")).unwrap_or_default();
            cores_in(&cores).iter().any(|core| subject.cores.contains(core))
        })
        .collect();
    if there.is_empty() {
        return Finding::well(TOPIC, "none arrives on the plan's cores");
    }
    let others = others(root, subject);
    if others.is_empty() {
        return Finding::lacks(
            TOPIC,
            format!("{} arrive on the plan's cores, and there is no other core", there.len()),
            "each takes 1 to 20 us from whatever window it falls into",
            "a machine with another core, left out of the plan's `cores`",
        );
    }
    let others = list_of(&others);
    Finding::lacks(
        TOPIC,
        format!("{} arrive on the plan's cores: {}", there.len(), there.join(" ")),
        "each takes 1 to 20 us from whatever window it falls into; a busy disk or network sends thousands a second",
        format!(
            "kernel parameter irqaffinity={others}; now: for i in {}; do echo {others} > /proc/irq/$i/smp_affinity_list; done (stop irqbalance first)",
            there.join(" ")
        ),
    )
}

/// Processors of the machine that the plan leaves to everything else.
fn others(root: &Root, subject: &Subject) -> Vec<u32> {
    without(&cores_in(&root.text("sys/devices/system/cpu/online").unwrap_or_default()), &subject.cores)
}

fn without(cores: &[u32], taken: &[u32]) -> Vec<u32> {
    cores.iter().copied().filter(|core| !taken.contains(core)).collect()
}

/// Clocks that a program reads without entering the kernel.
const QUICK_CLOCKS: [&str; 4] = ["tsc", "kvm-clock", "hyperv_clocksource_tsc_page", "arch_sys_counter"];

fn clock_source(root: &Root) -> Finding {
    const TOPIC: &str = "clock source";
    let folder = "sys/devices/system/clocksource/clocksource0";
    let current = root.text(&format!("{folder}/current_clocksource")).unwrap_or_else(|| "not known".into());
    if QUICK_CLOCKS.contains(&current.as_str()) {
        return Finding::well(TOPIC, current);
    }
    let available = root.text(&format!("{folder}/available_clocksource")).unwrap_or_default();
    let better = QUICK_CLOCKS.iter().find(|clock| available.split_whitespace().any(|there| there == **clock));
    let mend = match better {
        Some(clock) => {
            format!("echo {clock} > /{folder}/current_clocksource; kernel parameter clocksource={clock}")
        }
        None => {
            "the firmware's or the hypervisor's settings: the kernel found no better clock that it trusts"
                .into()
        }
    };
    Finding::lacks(
        TOPIC,
        current,
        "each look at the time is a system call of about a microsecond instead of 0.03 us, and a switch looks several times",
        mend,
    )
}
