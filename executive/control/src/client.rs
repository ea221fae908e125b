//! A client of the control socket. Every wait has an end.

use std::io::{self, BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use super::discovery::Running;
use super::protocol::{Answer, Request};

/// How long an answer may take: on the virtual clock the module answers between two minor frames, and one of them can
/// last as long as a hanging partition is waited for (5 s).
const PATIENCE: Duration = Duration::from_secs(10);
/// Between two tries at a server that is busy with others.
const AGAIN: Duration = Duration::from_millis(100);

/// Why there was no answer.
#[derive(Debug, thiserror::Error)]
pub enum AskError {
    /// The socket can not be used.
    #[error("cannot reach the module {module} (PID {pid}) by its control socket: {why}")]
    Unreachable {
        /// The module.
        module: String,
        /// Its process.
        pid: i32,
        /// What the system said.
        why: io::Error,
    },
    /// It said nothing for too long.
    #[error(
        "the module {module} (PID {pid}) has not answered for {} s: it is stopped, or hangs; what it was asked for is given up",
        PATIENCE.as_secs()
    )]
    Silent {
        /// The module.
        module: String,
        /// Its process.
        pid: i32,
    },
    /// It ended the conversation.
    #[error("the module {0} ended the conversation: it is ending, or another user's")]
    Closed(String),
    /// It has too many clients, and had them for as long as was waited.
    #[error("the module {0} is busy with other clients: try again, or end one of them")]
    Busy(String),
    /// It answered, but not what this program understands.
    #[error("the module's answer is not understood; it runs another build of this program? ({0})")]
    Strange(String),
    /// It refused.
    #[error("{0}")]
    Refused(String),
}

/// A conversation with a module.
#[derive(Debug)]
pub struct Client {
    running: Running,
    stream: BufReader<UnixStream>,
}

impl Client {
    /// Connects.
    ///
    /// # Errors
    /// The socket refuses: another user's module, or one that is just ending.
    pub fn connect(running: &Running) -> Result<Self, AskError> {
        let stream = UnixStream::connect(&running.socket).and_then(|stream| {
            stream.set_read_timeout(Some(PATIENCE))?;
            stream.set_write_timeout(Some(PATIENCE))?;
            Ok(stream)
        });
        let stream = stream.map_err(|source| unreachable(running, source))?;
        Ok(Self { running: running.clone(), stream: BufReader::new(stream) })
    }

    /// Asks and waits for the answer; tries again while the server is busy with other clients.
    ///
    /// # Errors
    /// No answer, or a refusal.
    pub fn ask(&mut self, request: &Request) -> Result<Answer, AskError> {
        let begun = Instant::now();
        loop {
            let answer = self.ask_once(request);
            if !matches!(answer, Err(AskError::Busy(_))) || begun.elapsed() > PATIENCE {
                return answer;
            }
            std::thread::sleep(AGAIN);
            *self = Self::connect(&self.running)?;
        }
    }

    fn ask_once(&mut self, request: &Request) -> Result<Answer, AskError> {
        let mut line = serde_json::to_vec(request).map_err(|error| AskError::Strange(error.to_string()))?;
        line.push(b'\n');
        // A server that is busy says so and closes: what it said is still there to be read.
        let _ = self.stream.get_mut().write_all(&line);
        let mut answer = String::new();
        match self.stream.read_line(&mut answer) {
            Ok(0) => Err(AskError::Closed(self.running.module.clone())),
            Err(error) if error.kind() == io::ErrorKind::ConnectionReset => {
                Err(AskError::Closed(self.running.module.clone()))
            }
            Err(source) => Err(unreachable(&self.running, source)),
            Ok(_) => match serde_json::from_str(&answer) {
                Ok(Answer::Refused { why }) => Err(AskError::Refused(why)),
                Ok(Answer::Busy) => Err(AskError::Busy(self.running.module.clone())),
                Ok(answer) => Ok(answer),
                Err(error) => Err(AskError::Strange(error.to_string())),
            },
        }
    }

    /// The lines that follow, for a request that is answered by more than one.
    #[must_use]
    pub fn into_lines(self) -> BufReader<UnixStream> {
        self.stream
    }
}

fn unreachable(running: &Running, why: io::Error) -> AskError {
    let (module, pid) = (running.module.clone(), running.pid);
    match why.kind() {
        // What a limit on reading gives.
        io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => AskError::Silent { module, pid },
        _ => AskError::Unreachable { module, pid, why },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn module_that_is_stopped_is_said_not_to_answer_and_not_to_be_unavailable() {
        let running = Running { module: "fcu".into(), pid: 7, socket: "control".into(), cores: Vec::new() };
        let silent = unreachable(&running, io::ErrorKind::WouldBlock.into()).to_string();
        assert!(silent.starts_with("the module fcu (PID 7) has not answered for 10 s: "), "{silent}");
        let gone = unreachable(&running, io::ErrorKind::NotFound.into()).to_string();
        assert!(gone.contains("cannot reach"), "{gone}");
    }
}
