//! A partition with an error handler: raises the errors that its attributes name, says what its handler is told, and does
//! there what another attribute says.

use std::process::ExitCode;

use bateleur_apex::{Context, HealthError, Partition, Response, Retained, StartError, Window};

struct Handler {
    found: Option<String>,
    windows: Retained<u64>,
    count: u64,
    /// An error is raised in this window, counted over all incarnations, and in those after it until `raise_times` are.
    raise_at: u64,
    raise_times: u64,
    response: String,
    /// The process ends by itself in this window, with this code.
    exit_at: u64,
    exit_code: i32,
}

impl Partition for Handler {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let mut windows = context.retained::<u64>()?;
        let count = windows.load();
        Ok(Self {
            found: Some(format!("{:?} found {count:?}", context.start_condition())),
            windows,
            count: count.unwrap_or(0),
            raise_at: context.attribute("raise_at", 0)?,
            raise_times: context.attribute("raise_times", 1)?,
            response: context.attribute("response", "go_on".into())?,
            exit_at: context.attribute("exit_at", 0)?,
            exit_code: context.attribute("exit_code", 0)?,
        })
    }

    const ERROR_HANDLER: bool = true;

    fn error_handler(&mut self, error: &HealthError, window: &Window) -> Response {
        window.report(&format!("the handler is told of {:?}: {}", error.code, error.message));
        match self.response.as_str() {
            "warm" => Response::WarmRestart,
            "cold" => Response::ColdRestart,
            "idle" => Response::Idle,
            "raise" => {
                window.raise("raised in the handler");
                Response::GoOn
            }
            "die" => std::process::abort(),
            "hang" => loop {
                std::thread::sleep(std::time::Duration::from_secs(3600));
            },
            _ => Response::GoOn,
        }
    }

    fn window(&mut self, window: &Window) {
        if let Some(found) = self.found.take() {
            window.report(&found);
        }
        self.count += 1;
        self.windows.store(&self.count);
        if self.count == self.exit_at {
            std::process::exit(self.exit_code);
        }
        if self.count >= self.raise_at && self.count - self.raise_at < self.raise_times {
            window.raise("what it is");
        }
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Handler>()
}
