//! `bateleur doctor`: what this machine gives a partitioned flight, what each lack costs, and how to mend it.
//!
//! Needs no root; as root it also tries what a run would. Nothing is changed and nothing keeps running. Exit codes:
//! 0 all is well, 1 something lacks, 2 the schedule file can not be used.

use std::path::{Path, PathBuf};

use crate::doctor::{Finding, Root, State, Subject, Tried, examine};
use anyhow::{Context, Result, anyhow};
use bateleur_contract::Clock;
use bateleur_host::machine::Machine;
use bateleur_plan::Plan;

use super::{CANNOT_RUN, Code, FINE, Format, WRONG};
use crate::installed::{self, SCHEDULE};
use crate::plan_file;

/// Say what this machine gives, what each lack costs and how to mend it.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The schedule file, for its cores and ports; where there is none, the machine's last core is looked at.
    #[arg(long, short, default_value = SCHEDULE, value_parser = installed::schedule())]
    schedule: PathBuf,
    /// The module of it; may be left out where the file has one.
    #[arg(long, short)]
    module: Option<String>,
    /// What to print.
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    let Some((plan, about)) = plan(arguments)? else { return Ok(CANNOT_RUN) };
    let name = module_name(&plan, arguments.module.as_deref())?;
    let view = plan.module(&name).with_context(|| format!("the plan has no module \"{name}\""))?;
    let machine = Machine::examine(&view, Clock::Wall, None);
    let subject = Subject {
        cores: machine.partitioned_cores(),
        ports: view.partitions().map(|id| plan[id].ports.len()).sum(),
    };
    let findings = examine(&Root::new("/"), &subject, &Tried::here(machine.guarantees.list()));
    machine.leave();
    let lacking = findings.iter().filter(|finding| finding.state == State::Lacks).count();
    let text = match arguments.format {
        Format::Json => format!(
            "{:#}\n",
            serde_json::json!({ "cores": subject.cores, "lacking": lacking, "findings": findings })
        ),
        Format::Text => text_of(&about, &subject, &findings, lacking),
    };
    print!("{text}");
    Ok(if lacking == 0 { FINE } else { WRONG })
}

/// The plan, and what to call it; `None` if it has faults, which were printed.
fn plan(arguments: &Arguments) -> Result<Option<(Plan, String)>> {
    if arguments.module.is_none() && arguments.schedule == Path::new(SCHEDULE) && !arguments.schedule.exists()
    {
        return Ok(Some((any_plan()?, "no schedule file here, so the last core is looked at".into())));
    }
    let plan = plan_file::read_or_say(&arguments.schedule)?;
    Ok(plan.map(|plan| (plan, format!("for {}", arguments.schedule.display()))))
}

/// The least plan, on the last core that this process may use.
fn any_plan() -> Result<Plan> {
    let core = bateleur_system::sched::allowed_cores().into_iter().max().unwrap_or(0);
    let text = format!(
        "[module.machine]\ncores = [{core}]\n[partition.any]\nprogram = \"any\"\nmodule = \"machine\"\nmemory = \"1MiB\"\n\
         [schedule.any]\nmajor_frame = \"20ms\"\nminor_frame = \"20ms\"\n\
         window = [{{ partition = \"any\", offset = \"0ms\", duration = \"1ms\" }}]\n"
    );
    plan_file::read_text("the least plan", &text).map_err(|report| anyhow!("{}", report.render(false)))
}

fn module_name(plan: &Plan, asked: Option<&str>) -> Result<String> {
    match (asked, plan.modules.as_slice()) {
        (Some(name), _) => Ok(name.to_owned()),
        (None, [only]) => Ok(only.name.clone()),
        (None, several) => {
            let names: Vec<_> = several.iter().map(|module| module.name.as_str()).collect();
            Err(anyhow!("the plan has several modules: choose one with --module ({})", names.join(", ")))
        }
    }
}

fn text_of(about: &str, subject: &Subject, findings: &[Finding], lacking: usize) -> String {
    let width =
        findings.iter().map(|finding| finding.topic.chars().count()).filter(|width| *width < 30).max();
    let width = width.unwrap_or(0);
    let mut text = format!("this machine, {about}, processors {:?} partitioned\n\n", subject.cores);
    for finding in findings {
        let state = match finding.state {
            State::Well => "well ",
            State::Note => "note ",
            State::Lacks => "LACKS",
        };
        text += &format!("{state}  {:width$}  {}\n", finding.topic, finding.found);
        for (what, words) in [("costs", &finding.costs), ("mend", &finding.mend)] {
            if !words.is_empty() {
                text += &format!("         {what:5}  {words}\n");
            }
        }
    }
    match lacking {
        0 => text + "\nno findings: all promises hold\n",
        1 => text + "\n1 finding: a run still works, with the costs listed\n",
        lacking => format!("{text}\n{lacking} findings: a run still works, with the costs listed\n"),
    }
}
