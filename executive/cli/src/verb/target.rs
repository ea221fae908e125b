//! Which of the running modules a verb means.

use anyhow::{Result, bail};
use bateleur_control::{Answer, AskError, ChannelStatus, Client, Request, Running, Status, choose, running};
use bateleur_monitor::event_text::printable;
use bateleur_system::processes::process;

/// Chooses a running module.
#[derive(Debug, Clone, clap::Args)]
pub struct Target {
    /// The module, by its name or by its executive's process number; may be left out where one runs.
    #[arg(long, short, value_name = "NAME|PID")]
    pub module: Option<String>,
}

impl Target {
    /// The module.
    ///
    /// # Errors
    /// None or several fit.
    pub fn choose(&self) -> Result<Running> {
        let running = running();
        let below = self.module.as_deref().and_then(|asked| executive_below(asked, &running));
        Ok(choose(&running, below.as_deref().or(self.module.as_deref()))?.clone())
    }

    /// A conversation with it.
    pub(crate) fn connect(&self) -> Result<Client> {
        Ok(Client::connect(&self.choose()?)?)
    }

    /// Gives it an order, and says what it answers.
    pub(crate) fn order(&self, request: &Request) -> Result<()> {
        let module = self.choose()?;
        if let Answer::Done { text } = Client::connect(&module)?.ask(request)? {
            // Several people may have modules of one name on a machine: whose it was has to be seen.
            println!("{} (module {}, PID {})", printable(&text), module.module, module.pid);
        }
        Ok(())
    }
}

/// The number of the executive whose supervisor has the number `asked`: that of `bateleur run`, which is what a shell knows.
fn executive_below(asked: &str, running: &[Running]) -> Option<String> {
    let asked: i32 = asked.parse().ok()?;
    let is_below = |one: &&Running| process(one.pid).is_some_and(|executive| executive.parent == asked);
    running.iter().find(is_below).map(|one| one.pid.to_string())
}

/// The figures of a module.
///
/// # Errors
/// It gives no answer, or one that is not understood.
pub fn status(client: &mut Client) -> Result<Status> {
    match client.ask(&Request::Status)? {
        Answer::Status(status) => Ok(*status),
        other => Err(AskError::Strange(format!("{other:?}")).into()),
    }
}

/// The channels of a module.
///
/// # Errors
/// It gives no answer, or one that is not understood.
pub fn channels(client: &mut Client) -> Result<Vec<ChannelStatus>> {
    match client.ask(&Request::Ports)? {
        Answer::Ports { channels } => Ok(channels),
        other => bail!("the module's answer is not understood: {other:?}"),
    }
}
