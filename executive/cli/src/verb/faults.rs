//! The options of `run` and `fly` that plan what happens to partitions.

use bateleur_executive::planned::{Act, PlannedAct};

/// What happens to partitions, and when.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "What happens to partitions")]
pub(crate) struct Faults {
    /// Kill a partition's process at a module time (may be repeated).
    #[arg(long, value_name = "PARTITION@SECONDS", value_parser = parse_when)]
    kill: Vec<When>,
    /// End a partition until it is started (may be repeated).
    #[arg(long, value_name = "PARTITION@SECONDS", value_parser = parse_when)]
    stop: Vec<When>,
    /// Start a partition that is idle or stopped, from nothing (may be repeated).
    #[arg(long, value_name = "PARTITION@SECONDS", value_parser = parse_when)]
    start: Vec<When>,
    /// Hold a partition: it gets no windows until it is thawed (may be repeated).
    #[arg(long, value_name = "PARTITION@SECONDS", value_parser = parse_when)]
    freeze: Vec<When>,
    /// Let a partition go on that is held (may be repeated).
    #[arg(long, value_name = "PARTITION@SECONDS", value_parser = parse_when)]
    thaw: Vec<When>,
}

/// A partition and a module time.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct When {
    partition: String,
    at_s: f64,
}

impl Faults {
    /// All of them, as the executive takes them.
    pub(crate) fn planned(&self) -> Vec<PlannedAct> {
        let act = |act: Act, when: &When| PlannedAct {
            act,
            partition: when.partition.clone(),
            at_ns: (when.at_s * 1e9) as u64,
        };
        let all = self.lists().into_iter();
        all.flat_map(|(_, what, list)| list.iter().map(move |when| act(what, when))).collect()
    }

    /// A line for each whose time did not come.
    pub(crate) fn not_reached(&self, module_time_s: f64) -> Vec<String> {
        let lists = self.lists().into_iter();
        let all = lists.flat_map(|(name, _, list)| list.iter().map(move |when| (name, when)));
        let missed = all.filter(|(_, when)| when.at_s > module_time_s);
        let line = |(name, When { partition, at_s }): (&str, &When)| {
            format!("{name} {partition}@{at_s} was not reached: it ended at {module_time_s:.2} s")
        };
        missed.map(line).collect()
    }

    /// The options again, for another program.
    pub(crate) fn arguments(&self) -> Vec<String> {
        let all = self.lists().into_iter();
        all.flat_map(|(name, _, list)| {
            list.iter().flat_map(move |when| [name.to_owned(), format!("{}@{}", when.partition, when.at_s)])
        })
        .collect()
    }

    fn lists(&self) -> [(&'static str, Act, &[When]); 5] {
        [
            ("--kill", Act::Kill, &self.kill),
            ("--stop", Act::Stop, &self.stop),
            ("--start", Act::Start, &self.start),
            ("--freeze", Act::Freeze, &self.freeze),
            ("--thaw", Act::Thaw, &self.thaw),
        ]
    }
}

fn parse_when(text: &str) -> Result<When, String> {
    let wrong = || format!("\"{text}\" is not PARTITION@SECONDS, such as estimator@100");
    let (partition, at) = text.split_once('@').ok_or_else(wrong)?;
    let at_s: f64 = at.parse().map_err(|_| wrong())?;
    if at_s.is_finite() && at_s >= 0.0 {
        Ok(When { partition: partition.into(), at_s })
    } else {
        Err(wrong())
    }
}
