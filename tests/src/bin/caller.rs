//! A partition that calls: in each window it sends its name and the window's start to the address `to`, as one datagram.
//! Whoever listens there sees in which order windows of several modules came.

use std::net::UdpSocket;
use std::process::ExitCode;

use bateleur_apex::{Context, Partition, StartError, Window};

struct Caller {
    name: String,
    socket: UdpSocket,
}

impl Partition for Caller {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let to: String = context.attribute("to", String::new())?;
        let open = || {
            let socket = UdpSocket::bind("127.0.0.1:0")?;
            socket.connect(&to)?;
            Ok(socket)
        };
        let socket = open().map_err(|error: std::io::Error| StartError::Other(format!("{to}: {error}")))?;
        Ok(Self { name: context.name().to_owned(), socket })
    }

    fn window(&mut self, window: &Window) {
        let text = format!("{} {}", self.name, window.start_ns());
        let _ = self.socket.send(text.as_bytes()); // the listener counts what it hears
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Caller>()
}
