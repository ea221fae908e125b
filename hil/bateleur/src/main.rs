//! The program `bateleur`: the verbs of all crates as one command line.
//!
//! Exit codes: 0 fine, 1 it ran and something was wrong, 2 it could not run, or what it printed could not be written.

#[macro_use(eprintln, print)]
extern crate bateleur_executive_cli;

mod completions;
mod man;

use std::process::ExitCode;

use bateleur_executive_cli::{CANNOT_RUN, Code, FINE, printed, said};
use clap::{CommandFactory, Parser, Subcommand};

/// A time- and space-partitioned executive for Linux, and the flight control unit that flies on it.
#[derive(Debug, Parser)]
#[command(name = "bateleur", version, next_display_order = None)]
struct Arguments {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    #[command(flatten)]
    Module(bateleur_executive_cli::Verb),
    #[command(flatten)]
    Flight(bateleur_hil_cli::Verb),
    Bench(bateleur_bench::Arguments),
    Completions(completions::Arguments),
    Man(man::Arguments),
}

/// A file would grow beyond what this process may write (Linux, signal(7)).
const SIGXFSZ: i32 = 25;

/// What to do first, for whoever has just installed it.
const FIRST_STEPS: &str = "\
bateleur: a partitioned executive for Linux, and the flight control unit that flies on it

  bateleur fly --fast      fly the mission on the virtual clock: a few seconds, then a report
  bateleur fly --view      fly in real time, seen on a page in a browser
  bateleur ps              the partitions of what runs; `bateleur kill estimator` ends one of them
  bateleur check           check schedule.toml, the plan that is flown; `bateleur show` draws it
  bateleur doctor          what this machine can promise, and how to mend what it can not
  bateleur init FOLDER     begin a project of one's own

`bateleur help` lists all verbs; `bateleur VERB --help` explains one.
";

fn main() -> ExitCode {
    if std::env::args_os().len() == 1 {
        eprintln!("{}", FIRST_STEPS.trim_end());
        return CANNOT_RUN.into();
    }
    // Such a write fails then, and costs records and not the module. Programs that are started die of it as before.
    let _ = signal_hook::flag::register(SIGXFSZ, std::sync::Arc::default()); // as before, too
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            if error.use_stderr() {
                let _ = error.print(); // nobody reads
                return CANNOT_RUN.into();
            }
            let _ = printed::noted(error.print()); // help that was asked for
            return ended(FINE).into();
        }
    };
    let result = match arguments.verb {
        Verb::Module(verb) => verb.run(),
        Verb::Flight(verb) => verb.run(),
        Verb::Bench(arguments) => bateleur_bench::run(&arguments),
        Verb::Completions(arguments) => completions::run(&arguments, Arguments::command()),
        Verb::Man(arguments) => man::run(&arguments, Arguments::command()),
    };
    match result {
        Ok(code) => ended(code).into(),
        Err(error) => {
            eprintln!("bateleur: {}", said::causes(&error));
            ended(CANNOT_RUN).into()
        }
    }
}

/// The code of a verb that is over, unless what it printed could not be written.
fn ended(code: Code) -> Code {
    match printed::finish() {
        None => code,
        Some(error) => {
            eprintln!("bateleur: what was printed could not be written to the standard output: {error}");
            CANNOT_RUN
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::Arguments;

    #[test]
    fn every_verb_stands_in_the_page_of_the_command_line() {
        let page = include_str!("../../../docs/src/command-line.md");
        let (_, table) = page.split_once("| verb | for |").unwrap();
        let table = table.split("\n\n").next().unwrap();
        for verb in Arguments::command().get_subcommands().filter(|verb| !verb.is_hide_set()) {
            assert!(table.contains(&format!("`{}`", verb.get_name())), "{} is not in it", verb.get_name());
        }
    }

    #[test]
    fn no_verb_of_one_crate_hides_that_of_another() {
        let command = Arguments::command();
        let mut names: Vec<&str> = command.get_subcommands().map(clap::Command::get_name).collect();
        let all = names.len();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), all, "{names:?}");
    }
}
