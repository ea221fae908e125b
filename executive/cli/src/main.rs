//! The command line of Bateleur: one module a verb, whose head is its manual page.
//!
//! Exit codes: 0 fine, 1 it ran and something was wrong, 2 it could not run, or what it printed could not be written.

/// As that of the standard library, but a line that nobody reads any more (`| head`, a closed terminal) is dropped: it is no reason to
/// end a flight.
macro_rules! eprintln {
    ($($words:tt)*) => {{
        let _ = std::io::Write::write_fmt(&mut std::io::stderr(), format_args!("{}\n", format_args!($($words)*)));
    }};
}

/// As above, on standard output: see [`printed`].
macro_rules! print {
    ($($words:tt)*) => {{
        let _ = std::io::Write::write_fmt(&mut crate::printed::Printed, format_args!($($words)*));
    }};
}

/// As above, a line.
macro_rules! println {
    () => { print!("\n") };
    ($($words:tt)*) => { print!("{}\n", format_args!($($words)*)) };
}

mod doctor;
mod line;
mod observer;
mod output;
mod plan_file;
mod printed;
mod recorder;
mod said;
mod verb;
mod words;

use std::process::ExitCode;

use bateleur_control::Request;
use clap::{CommandFactory, Parser, Subcommand};

/// A time- and space-partitioned executive for Linux, and the flight control unit that flies on it.
#[derive(Debug, Parser)]
#[command(name = "bateleur", version, about, arg_required_else_help = true)]
struct Arguments {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    Airframe(verb::airframe::Arguments),
    Bench(verb::bench::Arguments),
    Campaign(Box<verb::campaign::Arguments>),
    Check(verb::check::Arguments),
    Compare(verb::compare::Arguments),
    Completions(verb::completions::Arguments),
    Doctor(verb::doctor::Arguments),
    Export(verb::export::Arguments),
    Fly(Box<verb::fly::Arguments>),
    Gateway(verb::gateway::Arguments),
    Ground(verb::ground::Arguments),
    Health(verb::health::Arguments),
    Key(verb::key::Arguments),
    Links(verb::links::Arguments),
    /// Kill a partition of a running module; its health table says what follows.
    Kill(verb::order::Arguments),
    /// End a partition of a running module until it is started; its windows pass.
    Stop(verb::order::Arguments),
    /// Start a partition that is idle or stopped, from nothing and with a new budget of restarts.
    Start(verb::order::Arguments),
    /// Hold a partition: it gets no windows until it is thawed.
    Freeze(verb::order::Arguments),
    /// Let a held partition go on where it was.
    Thaw(verb::order::Arguments),
    Inject(verb::inject::Arguments),
    Ports(verb::ports::Arguments),
    Ps(verb::ps::Arguments),
    Man(verb::man::Arguments),
    New(verb::new::Arguments),
    Plan(verb::plan::Arguments),
    Record(verb::record::Arguments),
    Run(Box<verb::run::Arguments>),
    Replay(verb::replay::Arguments),
    /// Change a running module to another schedule, with its next major frame.
    Schedule(verb::order::Schedule),
    Top(verb::top::Arguments),
    Schema(verb::schema::Arguments),
    Show(verb::show::Arguments),
    #[command(flatten)]
    Helper(verb::helper::Helper),
}

/// A file would grow beyond what this process may write (Linux, signal(7)).
const SIGXFSZ: i32 = 25;

fn main() -> ExitCode {
    // Such a write fails then, and costs records and not the module. Programs that are started die of it as before.
    let _ = signal_hook::flag::register(SIGXFSZ, std::sync::Arc::default()); // as before, too
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            if error.use_stderr() {
                let _ = error.print(); // nobody reads
                return verb::CANNOT_RUN.into();
            }
            let _ = printed::noted(error.print()); // help that was asked for
            return ended(verb::FINE).into();
        }
    };
    let result = match arguments.verb {
        Verb::Airframe(arguments) => verb::airframe::run(&arguments),
        Verb::Bench(arguments) => verb::bench::run(&arguments),
        Verb::Campaign(arguments) => verb::campaign::run(&arguments),
        Verb::Check(arguments) => verb::check::run(&arguments),
        Verb::Compare(arguments) => verb::compare::run(&arguments),
        Verb::Completions(arguments) => verb::completions::run(&arguments, Arguments::command()),
        Verb::Doctor(arguments) => verb::doctor::run(&arguments),
        Verb::Export(arguments) => verb::export::run(&arguments),
        Verb::Fly(arguments) => verb::fly::run(&arguments),
        Verb::Gateway(arguments) => verb::gateway::run(&arguments),
        Verb::Ground(arguments) => verb::ground::run(&arguments),
        Verb::Health(arguments) => verb::health::run(&arguments),
        Verb::Key(arguments) => verb::key::run(&arguments),
        Verb::Links(arguments) => verb::links::run(&arguments),
        Verb::Kill(arguments) => verb::order::run(&arguments, |partition| Request::Kill { partition }),
        Verb::Stop(arguments) => verb::order::run(&arguments, |partition| Request::Stop { partition }),
        Verb::Start(arguments) => verb::order::run(&arguments, |partition| Request::Start { partition }),
        Verb::Freeze(arguments) => verb::order::run(&arguments, |partition| Request::Freeze { partition }),
        Verb::Thaw(arguments) => verb::order::run(&arguments, |partition| Request::Thaw { partition }),
        Verb::Inject(arguments) => verb::inject::run(&arguments),
        Verb::Ports(arguments) => verb::ports::run(&arguments),
        Verb::Record(arguments) => verb::record::run(&arguments),
        Verb::Ps(arguments) => verb::ps::run(&arguments),
        Verb::Schedule(arguments) => verb::order::schedule(&arguments),
        Verb::Top(arguments) => verb::top::run(&arguments),
        Verb::Man(arguments) => verb::man::run(&arguments, Arguments::command()),
        Verb::New(arguments) => verb::new::run(&arguments),
        Verb::Plan(arguments) => verb::plan::run(&arguments),
        Verb::Replay(arguments) => verb::replay::run(&arguments),
        Verb::Run(arguments) => verb::run::run(&arguments),
        Verb::Schema(_) => verb::schema::run(),
        Verb::Show(arguments) => verb::show::run(&arguments),
        Verb::Helper(helper) => verb::helper::run(&helper),
    };
    match result {
        Ok(code) => ended(code).into(),
        Err(error) => {
            eprintln!("bateleur: {}", said::causes(&error));
            ended(verb::CANNOT_RUN).into()
        }
    }
}

/// The code of a verb that is over, unless what it printed could not be written.
fn ended(code: verb::Code) -> verb::Code {
    match printed::finish() {
        None => code,
        Some(error) => {
            eprintln!("bateleur: what was printed could not be written to the standard output: {error}");
            verb::CANNOT_RUN
        }
    }
}

#[cfg(test)]
#[path = "../../checker/tests/plan_support/schema_check.rs"]
mod schema_check;

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
}
