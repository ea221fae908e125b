//! `bateleur view [FOLDER]`: a running module on a page in a browser: map, attitude, windows, health log, links, any field of any port, and
//! orders. With a folder it shows what a run or a flight recorded, and plays it.
//!
//! Prints the page's address, which has a token in it that is drawn at each start: whoever knows it may look, and give the orders that this
//! user may give. Serves this machine alone unless told otherwise, until Ctrl-C. Exit codes: 0 fine, 2 there is no such module or folder, or
//! it could not listen.

use std::io::Read;
use std::net::{SocketAddr, TcpListener};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use bateleur_control::Running;
use bateleur_executive_cli::{Code, FINE, Target, http, stand_aside};

use crate::live::Live;
use crate::recorded::Recorded;
use crate::server::{Server, Source};

/// Show a running module, or a recorded run, on a page in a browser.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The folder of a run or a flight, in place of what runs now.
    #[arg(conflicts_with = "module")]
    folder: Option<PathBuf>,
    #[command(flatten)]
    target: Target,
    /// Where the page is served; port 0 takes a free one. Another address than 127.0.0.1 lets other machines ask, without encryption.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:0")]
    listen: SocketAddr,
    /// Started by a flight: waits until its module runs, and ends when standard input does.
    #[arg(long, hide = true, requires = "module")]
    of_flight: bool,
}

/// How long a flight's module may take until it answers.
const START_PATIENCE: Duration = Duration::from_secs(60);
/// Between two looks whether it does.
const LOOK: Duration = Duration::from_millis(100);

/// Does it.
///
/// # Errors
/// It could not begin.
pub fn run(arguments: &Arguments) -> Result<Code> {
    let source = match &arguments.folder {
        Some(folder) => Source::Recorded(Recorded::open(folder)?),
        None => {
            if arguments.of_flight {
                std::thread::spawn(|| {
                    let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink()); // closed either way
                    std::process::exit(0);
                });
            }
            let running = choose(arguments)?;
            stand_aside(&running.cores);
            Source::Live(Live::start(running)?)
        }
    };
    let listener = TcpListener::bind(arguments.listen)
        .with_context(|| format!("cannot listen at {}", arguments.listen))?;
    let address = listener.local_addr().context("cannot tell the page's port")?;
    let token = secret().context("cannot draw a token")?;
    let nonce = secret().context("cannot draw a nonce")?;
    let server = Server::new(source, token.clone(), nonce);
    eprintln!("view: http://{address}/?token={token}");
    let answer: Arc<http::Answer> = Arc::new(move |asked, stream| server.answer(asked, stream));
    http::serve(&listener, &answer).context("cannot take more connections")?;
    Ok(FINE)
}

fn choose(arguments: &Arguments) -> Result<Running> {
    let begun = Instant::now();
    loop {
        let chosen = arguments.target.choose();
        if chosen.is_ok() || !arguments.of_flight || begun.elapsed() > START_PATIENCE {
            return chosen;
        }
        std::thread::sleep(LOOK);
    }
}

/// 128 bits that nobody can guess.
fn secret() -> std::io::Result<String> {
    let mut bytes = [0; 16];
    std::fs::File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}
