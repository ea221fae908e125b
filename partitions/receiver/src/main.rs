//! The driver of a satellite receiver that speaks UBX: its solutions go to the port `raw`.

use std::process::ExitCode;

use bateleur_apex::serial::{Change, Presence};
use bateleur_apex::{Context, Partition, SamplingSource, StartError, Window};
use bateleur_messages::RawGps;
use bateleur_receiver::{Decoder, Epoch, Heard, Link, LinkError, Orders, Place, Settings};

/// Bytes taken in one window, most: eight times what a line of 115200 baud carries in 20 ms.
const BYTES_PER_WINDOW: usize = 2048;
/// A receiver that says nothing for so long is asked for everything again, ns.
const SILENCE_NS: u64 = 3_000_000_000;
/// A converter from which not one byte has come for so long is dialled anew, ns: one that vanished without a word leaves a
/// connection that the kernel believes in for a quarter of an hour.
const DIAL_AGAIN_NS: u64 = 10_000_000_000;
/// Fastest and slowest solutions of any receiver of that kind, ms.
const PERIODS_MS: std::ops::RangeInclusive<u64> = 40..=10_000;

struct Driver {
    name: String,
    place: Place,
    baud: u32,
    ask: bool,
    link: Option<Link>,
    presence: Presence,
    decoder: Decoder,
    orders: Orders,
    raw: SamplingSource<RawGps>,
    heard_ns: u64,
    /// When the last byte came, or the line was opened, ns.
    byte_ns: u64,
    /// It was dialled anew because nothing came: a connection alone is not yet news.
    mute: bool,
    silent: bool,
    damaged_told: u64,
    refused_told: u64,
}

impl Partition for Driver {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let name: String = context.attribute("device", "/dev/ttyUSB0".into())?;
        let baud = context.attribute("baud", 9_600_u32)?;
        if baud == 0 {
            return Err(StartError::Other(
                "attribute baud = 0: give the speed of the line, such as 9600".into(),
            ));
        }
        let period_ms = context.duration_ns("period", 200_000_000)? / 1_000_000;
        if !PERIODS_MS.contains(&period_ms) {
            return Err(StartError::Other(format!(
                "attribute period: {period_ms} ms is none of 40 ms to 10 s"
            )));
        }
        let latency_ns = context.duration_ns("latency", 80_000_000)?;
        Ok(Self {
            place: name.parse().map_err(|error| StartError::Other(format!("attribute {error}")))?,
            name,
            baud,
            ask: context.attribute("configure", true)?,
            link: None,
            presence: Presence::default(),
            decoder: Decoder::new(Epoch::new(latency_ns)),
            orders: Orders::new(Settings { period_ms: period_ms as u16 }),
            raw: context.sampling_source("raw")?,
            heard_ns: 0,
            byte_ns: 0,
            mute: false,
            silent: false,
            damaged_told: 0,
            refused_told: 0,
        })
    }

    fn window(&mut self, window: &Window) {
        let now_ns = window.now_ns();
        if self.presence.is_due(now_ns) && self.link.is_none() {
            match Link::open(&self.place, self.baud) {
                Ok(link) => {
                    self.link = Some(link);
                    (self.heard_ns, self.byte_ns) = (now_ns, now_ns);
                    self.orders.again();
                }
                Err(error) => self.lost(window, &error),
            }
        }
        if let Err(error) = self.exchange(window, now_ns).and_then(|()| self.watch(now_ns)) {
            self.lost(window, &error);
        }
        self.complain(window, now_ns);
    }
}

impl Driver {
    fn exchange(&mut self, window: &Window, now_ns: u64) -> Result<(), LinkError> {
        let Some(link) = &mut self.link else { return Ok(()) };
        if !link.is_up()? {
            return Ok(());
        }
        let mut buffer = [0; BYTES_PER_WINDOW];
        let count = link.receive(&mut buffer)?;
        if count > 0 {
            (self.byte_ns, self.mute) = (now_ns, false);
        }
        if !self.mute && !self.presence.is_open() && self.presence.opened() == Some(Change::Found) {
            window.report(&format!("receiver {} is there", self.name));
        }
        for heard in self.decoder.take(&buffer[..count], now_ns) {
            match heard {
                Heard::Solution(raw) => {
                    self.raw.write(&raw);
                    self.heard_ns = now_ns;
                }
                Heard::Answer { class, number, granted } => self.orders.answered(class, number, granted),
            }
        }
        if let Some(orders) = self.orders.due(now_ns).filter(|_| self.ask) {
            link.send(&orders)?;
        }
        Ok(())
    }

    /// Gives up a connection over which nothing comes.
    fn watch(&self, now_ns: u64) -> Result<(), LinkError> {
        match &self.link {
            Some(link) if link.is_connection() && now_ns >= self.byte_ns + DIAL_AGAIN_NS => {
                Err(LinkError::Mute(DIAL_AGAIN_NS / 1_000_000_000))
            }
            _ => Ok(()),
        }
    }

    fn lost(&mut self, window: &Window, error: &LinkError) {
        self.link = None;
        self.mute = matches!(error, LinkError::Mute(_));
        if self.presence.failed(window.now_ns()) == Some(Change::Lost) {
            window.raise(&format!("receiver {} {error}", self.name));
        }
    }

    /// Says once what is wrong with a line that is there.
    fn complain(&mut self, window: &Window, now_ns: u64) {
        let silent = self.presence.is_open() && now_ns > self.heard_ns + SILENCE_NS;
        if silent && !self.silent {
            window
                .raise(&format!("receiver {} says no solution: is its speed {} baud?", self.name, self.baud));
            self.orders.again();
        }
        self.silent = silent;
        let damaged = self.decoder.counters().damaged;
        if damaged >= self.damaged_told + 10 {
            self.damaged_told = damaged;
            window.report(&format!("receiver {}: {damaged} packets damaged so far", self.name));
        }
        if self.orders.refused() > self.refused_told {
            self.refused_told = self.orders.refused();
            window.report(&format!("receiver {} refused {} orders", self.name, self.refused_told));
        }
    }
}

pub(crate) fn main() -> ExitCode {
    bateleur_apex::run::<Driver>()
}
