//! `bateleur metrics`: the figures of every module that this user may control, in the text format of OpenMetrics, or in that of Prometheus
//! before it: windows, lateness, restarts, memory and links. Prints them once, or serves them to scrapers with `--listen`, at `/metrics`.
//!
//! Each value says by its labels of which module it is, by name and process, so that ten modules stand side by side. Counters
//! begin at 0 with each run. Exit codes: 0 fine, 2 it could not listen.

use std::fmt;
use std::net::{SocketAddr, TcpListener};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context, Result};
use bateleur_control::status::LATENESS_BOUNDS_NS;
use bateleur_control::{Answer, Client, LinkName, PartitionStatus, Request, Running, Status, running};
use bateleur_messages::LinkStatus;
use bateleur_messages::link::UP;
use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, EncodeMetric, MetricEncoder, NoLabelSet};
use prometheus_client::metrics::MetricType;
use prometheus_client::metrics::counter::ConstCounter;
use prometheus_client::metrics::gauge::ConstGauge;
use prometheus_client::registry::{Registry, Unit};

use super::links;
use super::target::status;
use super::{Code, FINE};
use crate::http::{self, Reply};

/// How the figures are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Text {
    /// OpenMetrics 1.0.
    Openmetrics,
    /// The text format of Prometheus 0.0.4, for older scrapers and `promtool check metrics`.
    Prometheus,
}

impl Text {
    const fn kind(self) -> &'static str {
        match self {
            Self::Openmetrics => "application/openmetrics-text; version=1.0.0; charset=utf-8",
            Self::Prometheus => "text/plain; version=0.0.4; charset=utf-8",
        }
    }

    /// What a scraper takes, by its header `Accept`.
    fn wanted(accept: &str) -> Self {
        let older = accept.contains("text/plain") && !accept.contains("application/openmetrics-text");
        if older { Self::Prometheus } else { Self::Openmetrics }
    }
}

/// Give the figures of running modules in the format of OpenMetrics.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Serve them at this address, until Ctrl-C, instead of printing them once. Whoever reaches it may read them.
    #[arg(long, value_name = "ADDRESS:PORT")]
    listen: Option<SocketAddr>,
    /// How they are written. A scraper says itself what it takes.
    #[arg(long, value_enum, default_value = "openmetrics", conflicts_with = "listen")]
    format: Text,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    let Some(address) = arguments.listen else {
        print!("{}", text(arguments.format)?);
        return Ok(FINE);
    };
    let listener = TcpListener::bind(address).with_context(|| format!("cannot listen at {address}"))?;
    eprintln!("metrics: http://{}/metrics", listener.local_addr()?);
    // One scrape at a time: a module has few places for clients.
    let one = Mutex::new(());
    let answer: Arc<http::Answer> = Arc::new(move |asked, _| {
        if asked.path != "/metrics" {
            return Some(Reply::refused(404, "the figures are at /metrics"));
        }
        let _turn = one.lock().unwrap_or_else(PoisonError::into_inner);
        let wanted = Text::wanted(&asked.accept);
        Some(text(wanted).map_or_else(
            |error| Reply::refused(503, &format!("{error:#}")),
            |text| Reply::of(wanted.kind(), text),
        ))
    });
    http::serve(&listener, &answer).context("cannot take more connections")?;
    Ok(FINE)
}

/// The figures of all modules that this user may control.
fn text(format: Text) -> Result<String> {
    let mut registry = Registry::with_prefix("bateleur");
    // One that ends meanwhile is left out.
    let modules = running().iter().filter_map(|one| Module::ask(one).ok()).collect();
    registry.register_collector(Box::new(Modules(modules)));
    let mut text = String::new();
    prometheus_client::encoding::text::encode(&mut text, &registry).context("cannot write the figures")?;
    Ok(match format {
        Text::Openmetrics => text,
        Text::Prometheus => as_prometheus(&text),
    })
}

/// The text of OpenMetrics as Prometheus had it before: a counter is described by the name that its values have, and nothing says units and
/// the end.
fn as_prometheus(text: &str) -> String {
    let counters: Vec<&str> =
        text.lines().filter_map(|line| line.strip_prefix("# TYPE ")?.strip_suffix(" counter")).collect();
    let line = |line: &str| {
        if line == "# EOF" || line.starts_with("# UNIT ") {
            return String::new();
        }
        for kind in ["# HELP ", "# TYPE "] {
            if let Some((name, rest)) = line.strip_prefix(kind).and_then(|rest| rest.split_once(' '))
                && counters.contains(&name)
            {
                return format!("{kind}{name}_total {rest}\n");
            }
        }
        format!("{line}\n")
    };
    text.lines().map(line).collect()
}

#[derive(Debug)]
struct Module {
    status: Status,
    /// Resident memory of each partition's process, bytes.
    memory: Vec<Option<u64>>,
    links: Vec<LinkName>,
    relay: Option<LinkStatus>,
}

impl Module {
    fn ask(running: &Running) -> Result<Self> {
        let mut client = Client::connect(running)?;
        let status = status(&mut client)?;
        let links = match client.ask(&Request::Links)? {
            Answer::Links { links } => links,
            _ => Vec::new(),
        };
        // A relay that is down leaves its links without figures, and the module with its own.
        let relay =
            if links.is_empty() { None } else { links::latest(client, &running.module).ok().flatten() };
        let memory = status.partitions.iter().map(|one| one.pid.and_then(resident)).collect();
        Ok(Self { status, memory, links, relay })
    }

    fn labels(&self) -> Labels {
        vec![("module", self.status.module.clone()), ("pid", self.status.pid.to_string())]
    }
}

/// Resident memory of a process, bytes, as the kernel counts it.
pub(super) fn resident(pid: i32) -> Option<u64> {
    let text = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kib: u64 = line.trim().strip_suffix(" kB")?.parse().ok()?;
    Some(kib * 1024)
}

type Labels = Vec<(&'static str, String)>;

/// A value with its labels.
type Sample<T> = (Labels, T);

#[derive(Debug)]
struct Modules(Vec<Module>);

impl Modules {
    fn of_modules<T>(&self, value: impl Fn(&Module) -> Option<T>) -> Vec<Sample<T>> {
        self.0.iter().filter_map(|module| Some((module.labels(), value(module)?))).collect()
    }

    fn of_partitions<T>(&self, value: impl Fn(&PartitionStatus, Option<u64>) -> Option<T>) -> Vec<Sample<T>> {
        let of_one = |module: &Module| {
            let both = module.status.partitions.iter().zip(&module.memory);
            let labelled = both.filter_map(|(partition, memory)| {
                let labels = [module.labels(), vec![("partition", partition.name.clone())]].concat();
                Some((labels, value(partition, *memory)?))
            });
            labelled.collect::<Vec<_>>()
        };
        self.0.iter().flat_map(of_one).collect()
    }

    fn of_links<T>(&self, value: impl Fn(&LinkStatus, usize) -> T) -> Vec<Sample<T>> {
        let of_one = |module: &Module| {
            let Some(relay) = &module.relay else { return Vec::new() };
            let labelled = module.links.iter().filter_map(|link| {
                let own = vec![("link", link.name.clone()), ("peer", link.peer.clone())];
                Some(([module.labels(), own].concat(), value(relay, links::place_of(relay, link.id)?)))
            });
            labelled.collect()
        };
        self.0.iter().flat_map(of_one).collect()
    }
}

/// Nanoseconds in seconds.
fn seconds(ns: u64) -> f64 {
    ns as f64 / 1e9
}

impl Collector for Modules {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> Result<(), fmt::Error> {
        let out = &mut encoder;
        gauges(
            out,
            "module_time",
            "Module time.",
            Some(&Unit::Seconds),
            self.of_modules(|module| Some(seconds(module.status.module_ns))),
        )?;
        counters(out, "windows", "Windows granted.", self.of_partitions(|one, _| Some(one.windows)))?;
        let help = "Windows that passed ungranted.";
        counters(out, "windows_missed", help, self.of_partitions(|one, _| Some(one.windows_missed)))?;
        let help = "Windows that were not closed in time.";
        counters(out, "window_overruns", help, self.of_partitions(|one, _| Some(one.overruns)))?;
        let help = "Windows whose start the dispatcher reached late.";
        counters(out, "late_windows", help, self.of_modules(|module| Some(module.status.late_windows)))?;
        let help = "Restarts of a partition.";
        counters(out, "restarts", help, self.of_partitions(|one, _| Some(one.restarts)))?;
        let help = "Whether a partition runs in its windows.";
        let runs = self.of_partitions(|one, _| Some(f64::from(u8::from(one.mode == "normal"))));
        gauges(out, "partition_up", help, None, runs)?;
        let help = "The longest time from a window's grant to its closing.";
        let longest = self.of_partitions(|one, _| one.use_ns.map(|used| seconds(used.max)));
        gauges(out, "window_longest_use", help, Some(&Unit::Seconds), longest)?;
        let help = "Resident memory of a partition's process.";
        let memory = self.of_partitions(|_, memory| memory.map(|bytes| bytes as f64));
        gauges(out, "partition_memory", help, Some(&Unit::Bytes), memory)?;
        self.lateness(out)?;
        let up = self.of_links(|relay, place| f64::from(u8::from(relay.state[place] == UP)));
        gauges(out, "link_up", "Whether a link is up.", None, up)?;
        let sent = self.of_links(|relay, place| relay.messages_sent[place]);
        counters(out, "link_messages_sent", "Messages sent over a link.", sent)?;
        let received = self.of_links(|relay, place| relay.messages_received[place]);
        counters(out, "link_messages_received", "Messages received over a link.", received)?;
        let lost = self.of_links(|relay, place| relay.messages_lost[place]);
        counters(out, "link_messages_lost", "Messages of a link that never came.", lost)
    }
}

impl Modules {
    fn lateness(&self, out: &mut DescriptorEncoder<'_>) -> fmt::Result {
        let help = "From the planned start of a window to its grant.";
        let (unit, kind) = (Unit::Seconds, MetricType::Histogram);
        let samples = self.of_partitions(|one, _| Some((one.lateness_ns?, one.windows)));
        if samples.is_empty() {
            return Ok(());
        }
        let mut metric = out.encode_descriptor("window_lateness", help, Some(&unit), kind)?;
        for (labels, (lateness, count)) in samples {
            // The encoder adds up: each step has those that are in none before it.
            let mut before = 0;
            let steps = LATENESS_BOUNDS_NS.iter().zip(lateness.within).map(|(bound_ns, within)| {
                let own = within.saturating_sub(before);
                before = within;
                (seconds(*bound_ns), own)
            });
            let mut steps: Vec<(f64, u64)> = steps.collect();
            steps.push((f64::MAX, count.saturating_sub(before)));
            let mut member = metric.encode_family(&labels)?;
            member.encode_histogram::<NoLabelSet>(seconds(lateness.sum), count, &steps, None)?;
        }
        Ok(())
    }
}

fn counters(
    out: &mut DescriptorEncoder<'_>,
    name: &str,
    help: &str,
    samples: Vec<Sample<u64>>,
) -> fmt::Result {
    family(out, (name, help, None, MetricType::Counter), samples, |value, to| {
        ConstCounter::new(value).encode(to)
    })
}

fn gauges(
    out: &mut DescriptorEncoder<'_>,
    name: &str,
    help: &str,
    unit: Option<&Unit>,
    samples: Vec<Sample<f64>>,
) -> fmt::Result {
    family(out, (name, help, unit, MetricType::Gauge), samples, |value, to| ConstGauge::new(value).encode(to))
}

/// Nothing without a sample: some parsers refuse a family that has none.
fn family<T>(
    out: &mut DescriptorEncoder<'_>,
    (name, help, unit, kind): (&str, &str, Option<&Unit>, MetricType),
    samples: Vec<Sample<T>>,
    encode: impl Fn(T, MetricEncoder<'_>) -> fmt::Result,
) -> fmt::Result {
    if samples.is_empty() {
        return Ok(());
    }
    let mut metric = out.encode_descriptor(name, help, unit, kind)?;
    samples.into_iter().try_for_each(|(labels, value)| encode(value, metric.encode_family(&labels)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn older_scrapers_get_counters_by_the_name_of_their_values_and_no_line_that_they_do_not_know() {
        let text = "# HELP b_windows Windows granted.\n# TYPE b_windows counter\nb_windows_total{m=\"x\"} 4\n\
                    # HELP b_time_seconds Time.\n# TYPE b_time_seconds gauge\n# UNIT b_time_seconds seconds\n\
                    b_time_seconds{m=\"# EOF\"} 1.5\n# EOF\n";
        assert_eq!(
            as_prometheus(text),
            "# HELP b_windows_total Windows granted.\n# TYPE b_windows_total counter\nb_windows_total{m=\"x\"} 4\n\
             # HELP b_time_seconds Time.\n# TYPE b_time_seconds gauge\nb_time_seconds{m=\"# EOF\"} 1.5\n"
        );
        for (accept, wanted) in [
            ("", Text::Openmetrics),
            ("*/*", Text::Openmetrics),
            ("text/plain;version=0.0.4;q=1,*/*;q=0.1", Text::Prometheus),
            ("application/openmetrics-text;version=1.0.0,text/plain;version=0.0.4;q=0.5", Text::Openmetrics),
        ] {
            assert_eq!(Text::wanted(accept), wanted, "{accept}");
        }
    }
}
