//! `bateleur ps`: the modules that run on this machine, and how each of their partitions is: mode, process, generation,
//! windows, how much of them it uses, how late they begin, the last fault. `--processes` adds the ARINC 653 processes of partitions that
//! have several, as they were at the end of their partition's last window.
//!
//! Shows the modules of this user; as root, of every user. Exit codes: 0 fine, also where none runs; 2 the module that was
//! asked for does not run, or does not answer.

use std::fmt::Write;

use anyhow::Result;
use bateleur_control::status::{AlignmentStatus, Lateness, Spread};
use bateleur_control::{ChooseError, Client, PartitionStatus, SharedCore, Status, running, shared_cores};
use bateleur_monitor::event_text::printable;

use super::target::{Target, status};
use super::{Code, FINE, Format};

/// Show the running modules and their partitions.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    target: Target,
    /// Show the processes of partitions too.
    #[arg(long)]
    processes: bool,
    /// What to print.
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    let here = running();
    let mut shared = shared_cores(&here);
    let all = match arguments.target.module {
        Some(_) => vec![arguments.target.choose()?],
        None => here,
    };
    shared.retain(|shared| all.iter().any(|one| shared.pids.contains(&one.pid)));
    let mut statuses = Vec::new();
    for one in &all {
        match Client::connect(one).map_err(anyhow::Error::from).and_then(|mut client| status(&mut client)) {
            Ok(status) => statuses.push(status),
            // One that ends just now must not hide the others.
            Err(error) if arguments.target.module.is_none() => eprintln!("bateleur: {error:#}"),
            Err(error) => return Err(error),
        }
    }
    match arguments.format {
        Format::Json => println!("{:#}", serde_json::json!({ "modules": statuses, "shared_cores": shared })),
        Format::Text if statuses.is_empty() => {
            eprintln!("{}", ChooseError::None);
        }
        Format::Text => {
            let tables: Vec<_> = statuses.iter().map(|status| tables(status, arguments.processes)).collect();
            print!("{}{}", tables.join("\n"), sharing(&shared));
        }
    }
    Ok(FINE)
}

/// A line for each processor that several modules have.
fn sharing(shared: &[SharedCore]) -> String {
    let line = |shared: &SharedCore| {
        let pids: Vec<_> = shared.pids.iter().map(ToString::to_string).collect();
        format!(
            "\nprocessor {} is that of several modules (PID {}): each takes the windows of the others\n",
            shared.core,
            pids.join(", ")
        )
    };
    shared.iter().map(line).collect()
}

/// The table of a module, and behind it, where they are asked for, those of the processes of its partitions.
pub(crate) fn tables(status: &Status, processes: bool) -> String {
    let several = status.partitions.iter().filter(|partition| processes && !partition.processes.is_empty());
    several.fold(table(status), |text, partition| text + "\n" + &process_table(partition))
}

/// The processes of a partition, a line for each.
pub(crate) fn process_table(partition: &PartitionStatus) -> String {
    let name = printable(&partition.name);
    let mut text = format!(
        "{name:<34}{:<9}{:>5}{:>12}{:>12}{:>12}{:>10}{:>8}{:>8}{:>16}\n",
        "STATE",
        "PRIO",
        "PERIOD ms",
        "DEADLINE ms",
        "RUN ms",
        "SWITCHES",
        "STARTS",
        "ERRORS",
        "STACK used/all"
    );
    let ms = |ns: Option<u64>| ns.map_or_else(|| "-".to_owned(), |ns| format!("{}", ns as f64 / 1e6));
    for process in &partition.processes {
        let priority = match process.priority == process.base_priority {
            true => process.priority.to_string(),
            false => format!("{}>{}", process.base_priority, process.priority),
        };
        let stack = match (process.stack_used_bytes, process.stack_bytes) {
            (_, None) => "-".to_owned(),
            (None, Some(all)) => format!("-/{all}"),
            (Some(used), Some(all)) => format!("{used}/{all}"),
        };
        let _ = writeln!(
            text,
            "  {:<32}{:<9}{priority:>5}{:>12}{:>12}{:>12.3}{:>10}{:>8}{:>8}{stack:>16}",
            printable(&process.name),
            printable(&process.state),
            ms(process.period_ns),
            ms(process.capacity_ns),
            process.run_ns as f64 / 1e6,
            process.switches,
            process.starts,
            process.errors,
        ); // writing to a string can not fail
    }
    text
}

/// The heading of a module and a line for each partition.
pub(crate) fn table(status: &Status) -> String {
    let mut text = heading(status);
    let _ = writeln!(
        text,
        "{:<18}{:<11}{:>8}{:>4}{:>9}{:>8}{:>8}  {:>20}{:>8}  {:>18}  LAST FAULT",
        "PARTITION",
        "MODE",
        "PID",
        "GEN",
        "WINDOWS",
        "MISSED",
        "OVERRUN",
        "USE min/mean/max us",
        "SLACK",
        "LATE p50/p99/max us",
    );
    for partition in &status.partitions {
        let _ = writeln!(text, "{}", line(partition)); // writing to a string can not fail
    }
    text
}

pub(crate) fn heading(status: &Status) -> String {
    let next =
        status.next_schedule.as_ref().map(|name| format!(", then {}", printable(name))).unwrap_or_default();
    format!(
        "module {} (PID {}), {} clock, {:.1} s, schedule {} ({} ms in {} ms){next}, {} windows, {} late, {} lost, {} overrun\n",
        printable(&status.module),
        status.pid,
        printable(&status.clock),
        status.module_ns as f64 / 1e9,
        printable(&status.schedule),
        status.minor_frame_ns / 1_000_000,
        status.major_frame_ns / 1_000_000,
        status.windows,
        status.late_windows,
        status.lost_windows,
        status.window_overruns
    ) + &status.alignment.as_ref().map(alignment).unwrap_or_default()
}

/// How the major frames lie to those that they follow.
fn alignment(alignment: &AlignmentStatus) -> String {
    let error = alignment.error_ns.map_or_else(
        || "nothing measured".to_owned(),
        |error| {
            let (error_us, deviation_us) = (error as f64 / 1e3, alignment.deviation_ns as f64 / 1e3);
            format!("{error_us:.1} us beside (deviation {deviation_us:.1} us)")
        },
    );
    format!(
        "major frames follow {}: {}, {error}, drift {:.2} ppm, last correction {:.1} us, {} measurements, {} not believed, lost {} times\n",
        printable(&alignment.follows),
        printable(&alignment.state),
        alignment.drift_ppb as f64 / 1e3,
        alignment.correction_ns as f64 / 1e3,
        alignment.measurements,
        alignment.refused,
        alignment.lost
    )
}

fn line(partition: &PartitionStatus) -> String {
    let dash = || "-".to_owned();
    let spread = |spread: Spread| format!("{}/{}/{}", us(spread.min), us(spread.mean), us(spread.max));
    let late = |late: Lateness| format!("{}/{}/{}", us(late.p50), us(late.p99), us(late.max));
    let fault = partition.last_fault.as_ref().map_or_else(dash, |fault| {
        let time_s = fault.time_ns as f64 / 1e9;
        format!("{} at {time_s:.3} s -> {}", printable(&fault.error), printable(&fault.action))
    });
    format!(
        "{:<18}{:<11}{:>8}{:>4}{:>9}{:>8}{:>8}  {:>20}{:>8}  {:>19}  {fault}",
        printable(&partition.name),
        mode(partition),
        partition.pid.map_or_else(dash, |pid| pid.to_string()),
        partition.generation,
        partition.windows,
        partition.windows_missed,
        partition.overruns,
        partition.use_ns.map_or_else(dash, spread),
        partition.slack_ns.map_or_else(dash, |slack| us(slack.mean).to_string()),
        partition.lateness_ns.map_or_else(dash, late),
    )
}

/// `normal+1`: another process stands by, ready.
pub(crate) fn mode(partition: &PartitionStatus) -> String {
    let ready = partition.standby.as_deref() == Some("ready");
    format!("{}{}", printable(&partition.mode), if ready { "+1" } else { "" })
}

pub(crate) fn us(nanoseconds: u64) -> u64 {
    nanoseconds.saturating_add(500) / 1000
}

#[cfg(test)]
mod tests {
    use bateleur_control::LastFault;
    use bateleur_control::status::ProcessStatus;

    use super::*;

    #[test]
    fn module_that_follows_says_whom_and_how_far_it_is_beside() {
        let following = AlignmentStatus {
            follows: "nav".into(),
            state: "locked".into(),
            error_ns: Some(-1_250),
            deviation_ns: 400,
            drift_ppb: 12_340,
            correction_ns: 1_200,
            measurements: 500,
            refused: 2,
            lost: 1,
            ..AlignmentStatus::default()
        };
        assert_eq!(
            alignment(&following),
            "major frames follow nav: locked, -1.2 us beside (deviation 0.4 us), drift 12.34 ppm, last correction 1.2 us, 500 measurements, 2 not believed, lost 1 times\n"
        );
        let nothing =
            AlignmentStatus { follows: "nav".into(), state: "seeking".into(), ..AlignmentStatus::default() };
        assert!(alignment(&nothing).contains("nav: seeking, nothing measured, drift"));
    }

    #[test]
    fn processes_have_a_table_for_each_partition_that_has_several_and_only_where_they_are_asked_for() {
        let fast = ProcessStatus {
            name: "fa\u{1b}st".into(),
            state: "waiting".into(),
            priority: 30,
            base_priority: 20,
            period_ns: Some(20_000_000),
            capacity_ns: Some(2_500_000),
            run_ns: 1_234_567,
            switches: 12,
            starts: 2,
            errors: 1,
            stack_bytes: Some(262_144),
            stack_used_bytes: Some(5_000),
            ..ProcessStatus::default()
        };
        let slow = ProcessStatus { name: "slow".into(), state: "running".into(), ..ProcessStatus::default() };
        let own =
            PartitionStatus { name: "own".into(), processes: vec![fast, slow], ..PartitionStatus::default() };
        let imu = PartitionStatus { name: "imu".into(), ..PartitionStatus::default() };
        let status = Status { partitions: vec![imu, own], ..Status::default() };
        assert_eq!(tables(&status, false), table(&status));
        let expected = [
            "own                               STATE     PRIO   PERIOD ms DEADLINE ms      RUN ms  SWITCHES  STARTS  ERRORS  STACK used/all",
            "  fa\u{fffd}st                           waiting  20>30          20         2.5       1.235        12       2       1     5000/262144",
            "  slow                            running      0           -           -       0.000         0       0       0               -",
            "",
        ];
        assert_eq!(tables(&status, true), table(&status) + "\n" + &expected.join("\n"));
    }

    #[test]
    fn processor_of_several_modules_is_named_with_their_processes() {
        let shared = [SharedCore { core: 1, pids: vec![7, 8] }];
        assert!(sharing(&shared).contains("processor 1 is that of several modules (PID 7, 8): each takes"));
        assert_eq!(sharing(&[]), "");
    }

    #[test]
    fn table_has_a_line_for_each_partition_and_obeys_no_control_character() {
        let fault = LastFault {
            time_ns: 1_500_000_000,
            error: "kil\u{1b}led".into(),
            action: "warm_restart".into(),
            detail: String::new(),
        };
        let imu = PartitionStatus {
            name: "imu".into(),
            pid: Some(42),
            mode: "normal".into(),
            generation: 1,
            windows: 100,
            use_ns: Some(Spread { min: 1_000, mean: 2_400, max: 99_600 }),
            slack_ns: Some(Spread { min: 1, mean: 400_000, max: 2 }),
            lateness_ns: Some(Lateness { p50: 0, p99: 12_000, max: 1_000_000, ..Lateness::default() }),
            last_fault: Some(fault),
            ..PartitionStatus::default()
        };
        let gps = PartitionStatus { name: "gps".into(), mode: "idle".into(), ..PartitionStatus::default() };
        let status = Status {
            module: "fcu".into(),
            pid: 7,
            clock: "wall".into(),
            module_ns: 2_000_000_000,
            schedule: "flight".into(),
            minor_frame_ns: 20_000_000,
            major_frame_ns: 100_000_000,
            windows: 100,
            partitions: vec![imu, gps],
            ..Status::default()
        };
        assert_eq!(
            table(&status),
            "module fcu (PID 7), wall clock, 2.0 s, schedule flight (20 ms in 100 ms), 100 windows, 0 late, 0 lost, 0 overrun\n\
             PARTITION         MODE            PID GEN  WINDOWS  MISSED OVERRUN   USE min/mean/max us   SLACK  LATE p50/p99/max us  LAST FAULT\n\
             imu               normal           42   1      100       0       0               1/2/100     400            0/12/1000  killed at 1.500 s -> warm_restart\n"
                .replace("killed", "kil\u{fffd}led")
                + "gps               idle              -   0        0       0       0                     -       -                    -  -\n"
        );
    }
}
