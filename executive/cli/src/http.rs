//! A small server of HTTP/1.1 for what people and scrapers look at: one request a connection, nothing kept of it.
//!
//! Whatever a client does (silence, garbage, floods, never reading its answer), memory, threads and time of each are bounded.
//! It answers a request only if its `Host` is an address or `localhost`, and its `Origin`, if it has one, is that host: a page of somebody
//! else's that a browser shows can not reach it, whatever its name resolves to.

use std::fmt::Write as _;
use std::io::{self, Read, Write};
use std::net::{IpAddr, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Connections at a time; one more is closed.
const MOST_CONNECTIONS: usize = 32;
/// Bytes of a request's head, most.
const MOST_HEAD: usize = 16 << 10;
/// Bytes of its body, most.
const MOST_BODY: usize = 8 << 10;
/// Headers of a request, most.
const MOST_HEADERS: usize = 64;
/// How long a request may take from its first byte to its last, and a piece of an answer until it is taken.
const PATIENCE: Duration = Duration::from_secs(5);

/// A request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Asked {
    /// `GET`, `POST`, ….
    pub method: String,
    /// Without what follows the question mark.
    pub path: String,
    /// Names and values behind the question mark.
    pub query: Vec<(String, String)>,
    /// The content's type.
    pub content_type: String,
    /// The types that are wanted, as the client says it; empty: any.
    pub accept: String,
    /// The content.
    pub body: Vec<u8>,
}

impl Asked {
    /// The value of that name.
    #[must_use]
    pub fn value(&self, name: &str) -> Option<&str> {
        self.query.iter().find(|(known, _)| known == name).map(|(_, value)| value.as_str())
    }

    /// Whether `token` is the one that was asked with, in a time that says nothing of where they differ.
    #[must_use]
    pub fn has_token(&self, token: &str) -> bool {
        let given = self.value("token").unwrap_or_default();
        constant_time_eq::constant_time_eq(given.as_bytes(), token.as_bytes())
    }
}

/// What is answered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reply {
    /// Such as 200.
    pub code: u16,
    /// The content's type.
    pub kind: &'static str,
    /// Further headers, each with its line end.
    pub headers: String,
    /// The content.
    pub body: Vec<u8>,
}

impl Reply {
    /// With content.
    #[must_use]
    pub fn of(kind: &'static str, body: impl Into<Vec<u8>>) -> Self {
        Self { code: 200, kind, headers: String::new(), body: body.into() }
    }

    /// A refusal, in words.
    #[must_use]
    pub fn refused(code: u16, why: &str) -> Self {
        Self { code, ..Self::of("text/plain; charset=utf-8", format!("{why}\n")) }
    }
}

/// The client's end, for answers that come in pieces. A piece that is not taken in time is an error.
#[derive(Debug)]
pub struct Stream(TcpStream);

impl Stream {
    /// Begins an answer without an end.
    ///
    /// # Errors
    /// The client is gone.
    pub fn begin(&mut self, kind: &str) -> io::Result<()> {
        self.0.set_nodelay(true)?;
        self.0.write_all(head(200, kind, "", None).as_bytes())
    }

    /// Gives a piece.
    ///
    /// # Errors
    /// The client is gone, or does not read.
    pub fn give(&mut self, piece: &[u8]) -> io::Result<()> {
        self.0.write_all(piece)
    }

    fn reply(&mut self, reply: &Reply) -> io::Result<()> {
        let head = head(reply.code, reply.kind, &reply.headers, Some(reply.body.len()));
        self.0.write_all(head.as_bytes())?;
        self.0.write_all(&reply.body)
    }
}

/// Answers a request: at once, or itself in pieces, and then there is nothing to be given back.
pub type Answer = dyn Fn(&Asked, &mut Stream) -> Option<Reply> + Send + Sync;

/// Serves until the program ends.
///
/// # Errors
/// The socket can take no more connections.
pub fn serve(listener: &TcpListener, answer: &Arc<Answer>) -> io::Result<()> {
    let open = Arc::new(AtomicUsize::new(0));
    loop {
        let stream = match listener.accept() {
            Ok((stream, _)) => stream,
            Err(error) if is_of_one(&error) => continue,
            Err(error) => return Err(error),
        };
        if open.fetch_add(1, Ordering::AcqRel) >= MOST_CONNECTIONS {
            open.fetch_sub(1, Ordering::AcqRel);
            continue;
        }
        let (answer, served) = (answer.clone(), open.clone());
        let spawned = std::thread::Builder::new().name("http".into()).spawn(move || {
            let _ = attend(stream, &*answer); // the client is gone
            served.fetch_sub(1, Ordering::AcqRel);
        });
        if spawned.is_err() {
            open.fetch_sub(1, Ordering::AcqRel);
        }
    }
}

/// An error of one connection, not of the socket.
fn is_of_one(error: &io::Error) -> bool {
    use io::ErrorKind::{ConnectionAborted, ConnectionReset, Interrupted, TimedOut};
    matches!(error.kind(), ConnectionAborted | ConnectionReset | Interrupted | TimedOut)
}

fn attend(stream: TcpStream, answer: &Answer) -> io::Result<()> {
    stream.set_write_timeout(Some(PATIENCE))?;
    let mut stream = Stream(stream);
    let reply = match read(&mut stream.0)? {
        Ok(asked) => answer(&asked, &mut stream),
        Err(refused) => Some(refused),
    };
    if let Some(reply) = reply {
        stream.reply(&reply)?;
    }
    let _ = stream.0.shutdown(std::net::Shutdown::Write); // it is gone already
    Ok(())
}

/// Reads a request; `Ok(Err(…))`: it is refused.
fn read(stream: &mut TcpStream) -> io::Result<Result<Asked, Reply>> {
    let begun = Instant::now();
    let mut bytes = Vec::new();
    let mut piece = [0; 4096];
    loop {
        match parse(&bytes) {
            Parsed::Whole(asked) => return Ok(Ok(asked)),
            Parsed::Refused(reply) => return Ok(Err(reply)),
            Parsed::Partial => {}
        }
        let Some(left) = PATIENCE.checked_sub(begun.elapsed()).filter(|left| !left.is_zero()) else {
            return Err(io::ErrorKind::TimedOut.into());
        };
        stream.set_read_timeout(Some(left))?;
        match stream.read(&mut piece)? {
            0 => return Err(io::ErrorKind::UnexpectedEof.into()),
            count => bytes.extend_from_slice(&piece[..count]),
        }
    }
}

enum Parsed {
    Whole(Asked),
    Partial,
    Refused(Reply),
}

fn parse(bytes: &[u8]) -> Parsed {
    let refused = |code, why| Parsed::Refused(Reply::refused(code, why));
    let mut headers = [httparse::EMPTY_HEADER; MOST_HEADERS];
    let mut request = httparse::Request::new(&mut headers);
    let length = match request.parse(bytes) {
        Ok(httparse::Status::Complete(length)) => length,
        Ok(httparse::Status::Partial) if bytes.len() <= MOST_HEAD => return Parsed::Partial,
        Ok(httparse::Status::Partial) => return refused(431, "the head of this request is too long"),
        Err(_) => return refused(400, "this is no request of HTTP/1.1"),
    };
    let named = |name: &str| {
        let all = request.headers.iter().filter(|header| header.name.eq_ignore_ascii_case(name));
        let values: Vec<&str> = all.map(|header| std::str::from_utf8(header.value).unwrap_or("?")).collect();
        match values.as_slice() {
            [] => Ok(""),
            [value] => Ok(*value),
            _ => Err(()), // two that differ would be read in two ways
        }
    };
    let (Ok(host), Ok(origin), Ok(content), Ok(content_type), Ok("")) = (
        named("host"),
        named("origin"),
        named("content-length"),
        named("content-type"),
        named("transfer-encoding"),
    ) else {
        return refused(400, "a header stands twice, or the content comes in pieces");
    };
    // A list, which may stand in several headers.
    let wanted = request.headers.iter().filter(|header| header.name.eq_ignore_ascii_case("accept"));
    let wanted: Vec<&str> = wanted.filter_map(|header| std::str::from_utf8(header.value).ok()).collect();
    if !is_plain_host(host) {
        return refused(403, "ask by an address or localhost: other names may be somebody else's");
    }
    if !origin.is_empty() && origin.strip_prefix("http://") != Some(host) {
        return refused(403, "asked by the page of somebody else");
    }
    let content = if content.is_empty() { Ok(0) } else { content.parse::<usize>() };
    let Some(content) = content.ok().filter(|content| *content <= MOST_BODY) else {
        return refused(413, "the content of this request is too long");
    };
    let Some(body) = bytes.get(length..length + content) else { return Parsed::Partial };
    let target = request.path.unwrap_or_default();
    let (path, query) = target.split_once('?').unwrap_or((target, ""));
    let pairs = query.split('&').filter(|pair| !pair.is_empty());
    let pair = |pair: &str| {
        let (name, value) = pair.split_once('=').unwrap_or((pair, ""));
        (decoded(name), decoded(value))
    };
    Parsed::Whole(Asked {
        method: request.method.unwrap_or_default().into(),
        path: path.into(),
        query: pairs.map(pair).collect(),
        content_type: content_type.into(),
        accept: wanted.join(","),
        body: body.to_vec(),
    })
}

/// Whether a `Host` is an address or `localhost`, with or without a port. Any other name may be made to resolve to this machine.
fn is_plain_host(host: &str) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.parse::<u16>().is_ok() => name,
        _ => host,
    };
    let inner = name.strip_prefix('[').and_then(|name| name.strip_suffix(']'));
    name.eq_ignore_ascii_case("localhost")
        || host.parse::<SocketAddr>().is_ok()
        || inner.unwrap_or(name).parse::<IpAddr>().is_ok()
}

/// A word as it was before a browser wrote it into an address.
fn decoded(text: &str) -> String {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        let digit = |byte: Option<u8>| byte.and_then(|byte| char::from(byte).to_digit(16));
        match byte {
            b'+' => bytes.push(b' '),
            b'%' => match (digit(rest.next()), digit(rest.next())) {
                (Some(high), Some(low)) => bytes.push((high << 4 | low) as u8),
                _ => bytes.push(b'?'),
            },
            byte => bytes.push(byte),
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

fn head(code: u16, kind: &str, more: &str, length: Option<usize>) -> String {
    let phrase = match code {
        200 => "OK",
        204 => "No Content",
        400 => "Bad Request",
        403 => "Forbidden",
        404 => "Not Found",
        405 => "Method Not Allowed",
        413 => "Content Too Large",
        431 => "Request Header Fields Too Large",
        503 => "Service Unavailable",
        _ => "Refused",
    };
    let mut head = format!(
        "HTTP/1.1 {code} {phrase}\r\nContent-Type: {kind}\r\nConnection: close\r\nCache-Control: no-store\r\n\
         X-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\n{more}"
    );
    if let Some(length) = length {
        let _ = write!(head, "Content-Length: {length}\r\n");
    }
    head.push_str("\r\n");
    head
}

#[cfg(test)]
mod tests {
    use super::*;

    fn served() -> SocketAddr {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let answer: Arc<Answer> = Arc::new(|asked, _| Some(Reply::of("text/plain", format!("{asked:?}"))));
        std::thread::spawn(move || serve(&listener, &answer));
        address
    }

    fn answer_to(address: SocketAddr, request: &[u8]) -> String {
        let mut stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        let _ = stream.write_all(request); // it may be refused before its last byte
        let mut text = Vec::new();
        let _ = stream.read_to_end(&mut text);
        String::from_utf8_lossy(&text).into_owned()
    }

    #[test]
    fn hosts_that_another_could_own_and_pages_of_others_are_refused() {
        let address = served();
        for (host, origin, code) in [
            ("127.0.0.1:80", "", 200),
            ("localhost", "", 200),
            ("LOCALHOST:8080", "", 200),
            ("[::1]:80", "", 200),
            ("192.0.2.7", "http://192.0.2.7", 200),
            ("localhost:1", "http://localhost:1", 200),
            ("localhost:1", "http://localhost:2", 403),
            ("localhost", "null", 403),
            ("localhost", "https://localhost", 403),
            ("evil.example:80", "", 403),
            ("127.0.0.1.evil.example", "", 403),
            ("localhost.evil.example", "", 403),
            ("", "", 403),
        ] {
            let origin = if origin.is_empty() { String::new() } else { format!("Origin: {origin}\r\n") };
            let said =
                answer_to(address, format!("GET / HTTP/1.1\r\nHost: {host}\r\n{origin}\r\n").as_bytes());
            assert!(said.starts_with(&format!("HTTP/1.1 {code} ")), "{host} {origin}: {said}");
        }
    }

    #[test]
    fn bodies_and_queries_are_read_and_what_is_too_long_or_said_twice_is_refused() {
        let address = served();
        let said = answer_to(
            address,
            b"POST /a?b=%c3%a4+c&d HTTP/1.1\r\nHost: localhost\r\nContent-Length: 3\r\n\r\nxyz",
        );
        for part in ["path: \"/a\"", "(\"b\", \"ä c\"), (\"d\", \"\")", "body: [120, 121, 122]"] {
            assert!(said.contains(part), "{part} is not in {said}");
        }
        let long = format!("GET /{} HTTP/1.1\r\nHost: localhost\r\n\r\n", "x".repeat(2 * MOST_HEAD));
        assert!(answer_to(address, &long.as_bytes()[..MOST_HEAD + 4096]).starts_with("HTTP/1.1 431 "));
        for (head, code) in [
            ("Content-Length: 999999999", 413),
            ("Content-Length: -1", 413),
            ("Host: localhost", 400),
            ("Transfer-Encoding: chunked", 400),
            ("no colon", 400),
        ] {
            let said =
                answer_to(address, format!("GET / HTTP/1.1\r\nHost: localhost\r\n{head}\r\n\r\n").as_bytes());
            assert!(said.starts_with(&format!("HTTP/1.1 {code} ")), "{head}: {said}");
        }
    }

    #[test]
    fn silent_clients_keep_no_place_for_long() {
        let address = served();
        let silent: Vec<_> =
            (0..2 * MOST_CONNECTIONS).map(|_| TcpStream::connect(address).unwrap()).collect();
        let begun = Instant::now();
        let heard = loop {
            let said = answer_to(address, b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n");
            if said.starts_with("HTTP/1.1 200") || begun.elapsed() > 10 * PATIENCE {
                break said;
            }
            std::thread::sleep(Duration::from_millis(100));
        };
        assert!(heard.starts_with("HTTP/1.1 200"), "{heard}");
        drop(silent);
    }

    proptest::proptest! {
        #[test]
        fn any_bytes_are_refused_or_waited_for(bytes in proptest::collection::vec(proptest::num::u8::ANY, 0..300)) {
            let _ = parse(&bytes);
            let with_head = [b"GET / HTTP/1.1\r\nHost: localhost\r\n", bytes.as_slice()].concat();
            let _ = parse(&with_head);
            let _ = decoded(&String::from_utf8_lossy(&bytes));
        }
    }
}
