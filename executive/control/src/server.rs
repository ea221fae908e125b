//! The thread that talks to clients.
//!
//! It holds at most a few of them, one request of each, and one answer: whatever clients do, that is all the
//! memory they get. It works in rounds with a pause after each, so that a flood takes a small part of a housekeeping
//! core and nothing else. It hands requests to the monitor through a queue and never waits for it.

use std::io::{self, Read, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use bateleur_system::thread;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::net::sockopt::socket_peercred;

use super::SOCKET;
use super::protocol::{Answer, Lines, Request};

/// Clients that are served at a time: an operator's screen, a script or two, and some that have forgotten to leave.
const MOST_CLIENTS: usize = 8;
/// Of these, clients of one process: it can not shut out the others.
const MOST_OF_PROCESS: usize = 4;
/// Connections that are taken in a round; the rest waits in the kernel.
const ACCEPTED_A_ROUND: usize = 4;
/// Rest after each round: 500 rounds a second at most, a percent or two of a core.
const REST: Duration = Duration::from_millis(2);
/// Longest wait for something to happen: how late the thread sees that it shall end.
const LOOK: Timespec = Timespec { tv_sec: 0, tv_nsec: 100_000_000 };
/// How long a request may take from its first byte to its last, and an answer to be read. Longer is no client that works.
const HANDLING: Duration = Duration::from_secs(5);
/// How long a client may say nothing. `bateleur top` asks every second.
const SILENCE: Duration = Duration::from_secs(30);
/// How long a silent client keeps its place when another one wants it: long enough for a client to ask after it has
/// connected.
const KEPT_PLACE: Duration = Duration::from_millis(250);

/// A request on its way to the monitor.
#[derive(Debug)]
pub struct Ordered {
    /// What is asked.
    pub request: Request,
    /// For a request whose client is handed over: its connection.
    pub connection: Option<OwnedFd>,
    client: u64,
    asker: Arc<UnixStream>,
}

impl Ordered {
    /// Whether its client has gone. One that has only said all that it will say has not.
    fn is_abandoned(&self) -> bool {
        let mut fds = [PollFd::new(&*self.asker, PollFlags::empty())];
        let looked = poll(&mut fds, Some(&Timespec { tv_sec: 0, tv_nsec: 0 }));
        looked.is_ok() && fds[0].revents().intersects(GONE)
    }
}

/// How the kernel says that a client has closed its connection.
const GONE: PollFlags = PollFlags::HUP.union(PollFlags::ERR).union(PollFlags::NVAL);

/// The monitor's end: requests out, answers in. Neither ever waits.
#[derive(Debug)]
pub struct Inbox {
    requests: Receiver<Ordered>,
    answers: SyncSender<(u64, Answer)>,
    waker: Arc<OwnedFd>,
}

impl Inbox {
    /// The next request whose client still waits for the answer: who has given up does not expect that it is carried out.
    #[must_use]
    pub fn take(&self) -> Option<Ordered> {
        self.requests.try_iter().find(|ordered| !ordered.is_abandoned())
    }

    /// Answers one. There is room for one answer to each client, so it is lost only with its client.
    pub fn answer(&self, ordered: &Ordered, answer: Answer) {
        let _ = self.answers.try_send((ordered.client, answer)); // the server has ended
        let _ = rustix::io::write(&*self.waker, &[0]); // full: it is awake anyway
    }
}

/// The server; ends when dropped.
#[derive(Debug)]
pub struct Server {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    waker: Arc<OwnedFd>,
}

impl Server {
    /// Opens the socket in the run's directory and serves it.
    ///
    /// # Errors
    /// The socket could not be made; a module can run without it.
    pub fn open(directory: &Path) -> io::Result<(Self, Inbox)> {
        let path = directory.join(SOCKET);
        let listener = UnixListener::bind(&path)?;
        // Whoever connects before this line is still asked who he is.
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600))?;
        listener.set_nonblocking(true)?;
        let (reader, writer) =
            rustix::pipe::pipe_with(rustix::pipe::PipeFlags::CLOEXEC | rustix::pipe::PipeFlags::NONBLOCK)?;
        let (waker, stop) = (Arc::new(writer), Arc::new(AtomicBool::new(false)));
        let (orders, requests) = sync_channel(MOST_CLIENTS);
        let (answers, ready) = sync_channel(MOST_CLIENTS);
        let table = Table { listener, wake: reader, orders, ready, clients: Vec::new(), number: 0 };
        let asked = stop.clone();
        let thread = thread::named("control").spawn(move || table.serve(&asked))?;
        let inbox = Inbox { requests, answers, waker: waker.clone() };
        Ok((Self { stop, thread: Some(thread), waker }, inbox))
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        let _ = rustix::io::write(&*self.waker, &[0]); // full: it is awake anyway
        if let Some(thread) = self.thread.take() {
            let _ = thread.join(); // a panic there was printed
        }
    }
}

/// What a client is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// It may ask.
    Listening,
    /// The monitor has its request.
    Asked,
    /// It is to read its answer.
    Answered,
}

#[derive(Debug)]
struct Client {
    number: u64,
    process: i32,
    stream: Arc<UnixStream>,
    lines: Lines,
    phase: Phase,
    since: Instant,
    answer: Vec<u8>,
    sent: usize,
}

impl Client {
    fn wants(&self) -> PollFlags {
        match self.phase {
            Phase::Listening => PollFlags::IN,
            Phase::Asked => PollFlags::empty(),
            Phase::Answered => PollFlags::OUT,
        }
    }

    fn enter(&mut self, phase: Phase) {
        (self.phase, self.since) = (phase, Instant::now());
    }

    fn is_overdue(&self) -> bool {
        let limit = match self.phase {
            Phase::Listening if !self.lines.is_broken_off() => SILENCE,
            Phase::Asked => Duration::MAX,
            _ => HANDLING,
        };
        self.since.elapsed() > limit
    }

    fn may_give_way(&self) -> bool {
        self.phase == Phase::Listening && self.since.elapsed() > KEPT_PLACE
    }

    fn tell(&mut self, answer: &Answer) {
        (self.answer, self.sent) = (answer.line(), 0);
        self.enter(Phase::Answered);
    }

    /// Reads what has come; false: the client is gone, or has said too much.
    fn listen(&mut self) -> bool {
        let mut bytes = [0; 1024];
        let room = self.lines.room().min(bytes.len());
        if room == 0 {
            return true; // full of requests that wait their turn
        }
        match (&*self.stream).read(&mut bytes[..room]) {
            Ok(0) => self.lines.end(),
            Ok(count) => {
                if !self.lines.is_broken_off() {
                    self.since = Instant::now(); // of the request that begins here
                }
                self.lines.add(&bytes[..count]).is_ok()
            }
            Err(error) => is_passing(&error),
        }
    }

    /// Writes what is left of the answer; false: the client is gone.
    fn write(&mut self) -> bool {
        match (&*self.stream).write(&self.answer[self.sent..]) {
            Ok(count) => {
                self.sent += count;
                if self.sent == self.answer.len() {
                    self.answer = Vec::new();
                    self.enter(Phase::Listening);
                }
                true
            }
            Err(error) => is_passing(&error),
        }
    }
}

fn is_passing(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted)
}

#[derive(Debug)]
struct Table {
    listener: UnixListener,
    wake: OwnedFd,
    orders: SyncSender<Ordered>,
    ready: Receiver<(u64, Answer)>,
    clients: Vec<Client>,
    number: u64,
}

impl Table {
    fn serve(mut self, stop: &AtomicBool) {
        while !stop.load(Ordering::Acquire) {
            self.round();
            std::thread::sleep(REST);
        }
    }

    fn round(&mut self) {
        let found = self.look();
        let mut found: Vec<(u64, PollFlags)> =
            self.clients.iter().map(|client| client.number).zip(found).collect();
        while rustix::io::read(&self.wake, &mut [0; 64][..]).is_ok_and(|count| count > 0) {}
        while let Ok((number, answer)) = self.ready.try_recv() {
            if matches!(answer, Answer::Watching | Answer::Publishing) {
                // The observer has it now, and says so itself.
                self.clients.retain(|client| client.number != number);
            } else if let Some(client) = self.clients.iter_mut().find(|client| client.number == number) {
                client.tell(&answer);
            }
        }
        found.retain(|(_, seen)| !seen.is_empty());
        self.clients.retain_mut(|client| {
            let seen = found.iter().find(|(number, _)| *number == client.number);
            let seen = seen.map_or(PollFlags::empty(), |(_, seen)| *seen);
            let gone = seen.intersects(GONE) && !seen.contains(PollFlags::IN);
            !gone && attend(client, &self.orders) && !client.is_overdue()
        });
        self.accept();
    }

    /// Waits until something happens, and says what happened to each client.
    fn look(&self) -> Vec<PollFlags> {
        let mut fds =
            vec![PollFd::new(&self.wake, PollFlags::IN), PollFd::new(&self.listener, PollFlags::IN)];
        fds.extend(self.clients.iter().map(|client| PollFd::new(&*client.stream, client.wants())));
        let _ = poll(&mut fds, Some(&LOOK)); // a signal: looked at in the next round
        fds[2..].iter().map(PollFd::revents).collect()
    }

    fn accept(&mut self) {
        for _ in 0..ACCEPTED_A_ROUND {
            let Ok((stream, _)) = self.listener.accept() else { return };
            let Some(process) = trusted_peer(&stream) else { continue };
            if stream.set_nonblocking(true).is_err() {
                continue;
            }
            let own = self.clients.iter().filter(|client| client.process == process).count();
            if !self.make_room(process, own) {
                let _ = (&stream).write(&Answer::Busy.line()); // it asks again, or does not
                continue;
            }
            self.number += 1;
            self.clients.push(Client {
                number: self.number,
                process,
                stream: Arc::new(stream),
                lines: Lines::default(),
                phase: Phase::Listening,
                since: Instant::now(),
                answer: Vec::new(),
                sent: 0,
            });
        }
    }

    /// A place for one more client of `process`, which has `own`; false: there is none.
    fn make_room(&mut self, process: i32, own: usize) -> bool {
        if self.clients.len() < MOST_CLIENTS && own < MOST_OF_PROCESS {
            return true;
        }
        let crowded = own >= MOST_OF_PROCESS;
        let candidates = self.clients.iter().enumerate();
        let silent = candidates
            .filter(|(_, client)| client.may_give_way() && (!crowded || client.process == process))
            .min_by_key(|(_, client)| client.since);
        let Some(place) = silent.map(|(place, _)| place) else { return false };
        self.clients.remove(place);
        true
    }
}

/// One step of a conversation; false: it is over.
fn attend(client: &mut Client, orders: &SyncSender<Ordered>) -> bool {
    if client.phase == Phase::Listening && !client.listen() {
        return false;
    }
    if client.phase == Phase::Listening {
        match client.lines.next_request() {
            None => return true,
            Some(Err(why)) => client.tell(&Answer::refused(why)),
            Some(Ok(request)) => {
                let connection = match &request {
                    Request::Watch { .. } | Request::Publish { .. } => {
                        client.stream.try_clone().ok().map(OwnedFd::from)
                    }
                    _ => None,
                };
                let asker = client.stream.clone();
                match orders.try_send(Ordered { request, connection, client: client.number, asker }) {
                    Ok(()) => client.enter(Phase::Asked),
                    Err(_) => client.tell(&Answer::Busy),
                }
            }
        }
    }
    client.phase != Phase::Answered || client.write()
}

/// The process at the other end, if it is this user's or root's: whatever the file's mode says.
fn trusted_peer(stream: &UnixStream) -> Option<i32> {
    let peer = socket_peercred(stream.as_fd()).ok()?;
    let trusted = peer.uid.is_root() || peer.uid == rustix::process::geteuid();
    trusted.then(|| peer.pid.as_raw_nonzero().get())
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead, BufReader};

    use super::*;

    /// A server whose monitor answers every request with its own text.
    struct Bench {
        directory: tempfile::TempDir,
        _server: Server,
        inbox: Inbox,
    }

    impl Bench {
        fn new() -> Self {
            let directory = tempfile::tempdir().unwrap();
            let (server, inbox) = Server::open(directory.path()).unwrap();
            Self { directory, _server: server, inbox }
        }

        fn connect(&self) -> UnixStream {
            let stream = UnixStream::connect(self.directory.path().join(SOCKET)).unwrap();
            stream.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
            stream
        }

        /// Plays the monitor until a line comes.
        fn line(&self, stream: &UnixStream) -> Option<String> {
            let mut reader = BufReader::new(stream);
            let mut line = String::new();
            for _ in 0..500 {
                while let Some(ordered) = self.inbox.take() {
                    let text = format!("{:?}", ordered.request);
                    self.inbox.answer(&ordered, Answer::Done { text });
                }
                match reader.read_line(&mut line) {
                    Ok(0) => return None,
                    Ok(_) => return Some(line),
                    Err(error) if is_passing(&error) => {}
                    Err(_) => return None,
                }
            }
            panic!("neither an answer nor an end");
        }

        /// The answer; `None` if the server has hung up, before the question or after it.
        fn ask(&self, mut stream: &UnixStream, text: &str) -> Option<String> {
            stream.write_all(text.as_bytes()).ok()?;
            self.line(stream)
        }
    }

    const STATUS: &str = "{\"ask\":\"status\"}\n";

    #[test]
    fn request_is_answered_again_and_again() {
        let bench = Bench::new();
        let client = bench.connect();
        for _ in 0..3 {
            assert!(bench.ask(&client, STATUS).unwrap().contains("Status"));
        }
    }

    #[test]
    fn socket_is_for_its_user_alone() {
        let bench = Bench::new();
        let about = std::fs::metadata(bench.directory.path().join(SOCKET)).unwrap();
        assert_eq!(about.permissions().mode() & 0o777, 0o600);
    }

    #[test]
    fn garbage_is_refused_and_the_conversation_goes_on() {
        let bench = Bench::new();
        let client = bench.connect();
        for garbage in ["\u{0}\u{1}\n", "[[[[[[[\n", "{\"ask\":\"kill\"}\n", "null\n"] {
            assert!(bench.ask(&client, garbage).unwrap().contains("refused"), "{garbage}");
        }
        assert!(bench.ask(&client, STATUS).unwrap().contains("Status"));
    }

    #[test]
    fn line_without_an_end_ends_the_conversation_and_no_other() {
        let bench = Bench::new();
        let (endless, other) = (bench.connect(), bench.connect());
        let _ = (&endless).write(&[b'x'; 20_000]); // it may be cut off before the last byte
        assert_eq!(bench.line(&endless), None);
        assert!(bench.ask(&other, STATUS).unwrap().contains("Status"));
    }

    #[test]
    fn silent_clients_give_way_to_one_that_asks() {
        let bench = Bench::new();
        let silent: Vec<_> = (0..100).map(|_| bench.connect()).collect();
        let heard = (0..100).find_map(|_| {
            let line = bench.ask(&bench.connect(), STATUS);
            std::thread::sleep(Duration::from_millis(20));
            line.filter(|line| line.contains("Status"))
        });
        assert!(heard.is_some());
        drop(silent);
    }

    #[test]
    fn client_that_never_reads_is_dropped_and_others_are_served() {
        let bench = Bench::new();
        let deaf = bench.connect();
        deaf.set_nonblocking(true).unwrap();
        let mut asked = 0;
        // Until neither the socket nor the server takes more.
        for _ in 0..2000 {
            asked += usize::from((&deaf).write(STATUS.as_bytes()).is_ok());
            while let Some(ordered) = bench.inbox.take() {
                bench.inbox.answer(&ordered, Answer::Done { text: "x".repeat(50_000) });
            }
        }
        assert!(asked > 0);
        let other = bench.connect();
        assert!(bench.ask(&other, STATUS).unwrap().contains("Status"));
    }

    #[test]
    fn order_whose_client_has_given_up_is_not_carried_out_when_a_stopped_executive_goes_on() {
        let bench = Bench::new();
        // Nobody takes orders meanwhile.
        let mut hasty = bench.connect();
        hasty.write_all(b"{\"ask\":\"kill\",\"partition\":\"imu\"}\n").unwrap();
        let mut patient = bench.connect();
        patient.write_all(STATUS.as_bytes()).unwrap();
        patient.shutdown(std::net::Shutdown::Write).unwrap(); // it has said all, and waits
        std::thread::sleep(Duration::from_millis(50));
        drop(hasty);
        let taken = (0..500).find_map(|_| {
            std::thread::sleep(Duration::from_millis(2));
            bench.inbox.take()
        });
        assert_eq!(taken.unwrap().request, Request::Status);
        assert!(bench.inbox.take().is_none());
    }

    #[test]
    fn requests_of_a_client_that_says_no_more_are_all_answered_the_last_one_without_a_line_end() {
        let bench = Bench::new();
        let mut client = bench.connect();
        client.write_all(format!("{STATUS}{{\"ask\":\"links\"}}").as_bytes()).unwrap();
        client.shutdown(std::net::Shutdown::Write).unwrap();
        assert!(bench.line(&client).unwrap().contains("Status"));
        assert!(bench.line(&client).unwrap().contains("Links"));
        assert_eq!(bench.line(&client), None, "and then it is over");
    }

    #[test]
    fn client_that_leaves_before_its_answer_is_forgotten() {
        let bench = Bench::new();
        let mut client = bench.connect();
        client.write_all(STATUS.as_bytes()).unwrap();
        let ordered = (0..500).find_map(|_| {
            std::thread::sleep(Duration::from_millis(2));
            bench.inbox.take()
        });
        drop(client);
        std::thread::sleep(Duration::from_millis(20));
        bench.inbox.answer(&ordered.unwrap(), Answer::Done { text: "late".into() });
        assert!(bench.ask(&bench.connect(), STATUS).unwrap().contains("Status"));
    }
}
