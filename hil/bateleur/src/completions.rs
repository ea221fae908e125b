//! `bateleur completions`: the words that a shell completes this program's command line with, for the shell to read at its
//! start. Exit codes: 0 printed, 2 the shell is not known.

use anyhow::Result;
use clap_complete::Shell;

use bateleur_executive_cli::{Code, FINE};

/// Print what a shell needs to complete command lines.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "For example: bateleur completions bash > ~/.local/share/bash-completion/completions/bateleur\n\n\
    Exit codes: 0 printed; 2 the shell is not known."
)]
pub(crate) struct Arguments {
    /// The shell.
    #[arg(value_enum)]
    shell: Shell,
}

pub(crate) fn run(arguments: &Arguments, command: clap::Command) -> Result<Code> {
    // Those that the program starts itself are nobody's to type.
    let shown: Vec<_> = command.get_subcommands().filter(|verb| !verb.is_hide_set()).cloned().collect();
    let mut command =
        clap::Command::new("bateleur").args(command.get_arguments().cloned()).subcommands(shown);
    let mut text = Vec::new();
    clap_complete::generate(arguments.shell, &mut command, "bateleur", &mut text);
    print!("{}", String::from_utf8_lossy(&text));
    Ok(FINE)
}
