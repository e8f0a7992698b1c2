//! Connections of the page: HTTP/1.1, as far as a browser needs it. A request has limits of size and of time, so that strangers
//! use up neither memory nor descriptors.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::time::{Duration, Instant};

/// The most bytes of a request before its body. Browsers send cookies of other pages on this computer, too.
const MOST_HEAD_BYTES: usize = 64 << 10;
/// The most lines among them.
const MOST_HEADERS: usize = 100;
/// How long a connection may be silent between requests, and how long a request may take from its first byte to its last.
const PATIENCE: Duration = Duration::from_secs(15);
/// How long the other side may go on sending after a refusal that it has not read.
const FAREWELL: Duration = Duration::from_secs(1);
/// What a page may load: its own script, style and pictures.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Why there is no request, or no body.
pub enum Missing {
    /// Nobody is there to be told.
    Sender,
    /// What was sent gets this answer.
    Refused(Reply),
}

impl From<io::Error> for Missing {
    fn from(_: io::Error) -> Missing {
        Missing::Sender
    }
}

/// A request without its body.
#[derive(Debug)]
pub struct Request {
    /// `GET`, `POST` or another.
    pub method: String,
    /// Path and query.
    pub url: String,
    /// The bytes of its body. `None` if it does not say how many they are, as in chunks.
    pub body_length: Option<u64>,
    /// Whether another request may follow on its connection.
    pub stays_open: bool,
    headers: Vec<(String, String)>,
}

impl Request {
    /// Reads a request from the first of `bytes`, and returns it with their number. `None` if more bytes are missing.
    ///
    /// # Errors
    /// The answer, if they are no request.
    fn of(bytes: &[u8]) -> Result<Option<(Request, usize)>, Reply> {
        let mut headers = [httparse::EMPTY_HEADER; MOST_HEADERS];
        let mut parsed = httparse::Request::new(&mut headers);
        let length = match parsed.parse(bytes) {
            Ok(httparse::Status::Complete(length)) => length,
            Ok(httparse::Status::Partial) => return Ok(None),
            Err(httparse::Error::TooManyHeaders) => return Err(too_long()),
            Err(error) => return Err(Reply::refused(400, &format!("This is no request of HTTP/1.1: {error}."))),
        };
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        let mut request = Request {
            method: parsed.method.unwrap_or_default().into(),
            url: parsed.path.unwrap_or_default().into(),
            body_length: None,
            stays_open: parsed.version == Some(1),
            headers: parsed.headers.iter().map(|header| (header.name.into(), text(header.value))).collect(),
        };
        let closes = request.header("Connection").is_some_and(|value| value.to_ascii_lowercase().contains("close"));
        request.stays_open &= !closes;
        request.body_length = request.length_of_body()?;
        Ok(Some((request, length)))
    }

    fn length_of_body(&self) -> Result<Option<u64>, Reply> {
        let mut lengths = self.all("Content-Length");
        let Some(length) = lengths.next() else { return Ok(self.header("Transfer-Encoding").is_none().then_some(0)) };
        // Two lengths, or a length and chunks: a proxy might read another end of the body.
        let is_one = lengths.next().is_none() && self.header("Transfer-Encoding").is_none();
        let number = length.parse().ok().filter(|_| is_one && length.bytes().all(|byte| byte.is_ascii_digit()));
        number.map(Some).ok_or_else(|| Reply::refused(400, "Content-Length must be one whole number."))
    }

    fn all(&self, name: &str) -> impl Iterator<Item = &str> {
        self.headers
            .iter()
            .filter(move |(header, _)| header.eq_ignore_ascii_case(name))
            .map(|(_, value)| value.as_str())
    }

    /// Returns the value of a header.
    pub fn header(&self, name: &str) -> Option<&str> {
        self.all(name).next()
    }
}

/// An answer.
#[derive(Debug)]
pub struct Reply {
    /// Its number: 200 if all is well.
    pub status: u16,
    /// Its type.
    pub kind: &'static str,
    /// Its content.
    pub body: Vec<u8>,
    /// Headers of its own.
    pub headers: Vec<(&'static str, String)>,
}

impl Reply {
    /// Answers with a file.
    pub fn new(kind: &'static str, body: Vec<u8>) -> Reply {
        Reply { status: 200, kind, body, headers: Vec::new() }
    }

    /// Refuses in words.
    pub fn refused(status: u16, words: &str) -> Reply {
        Reply { status, ..Reply::new("text/plain; charset=utf-8", words.as_bytes().to_vec()) }
    }
}

fn too_long() -> Reply {
    Reply::refused(431, "The lines before the body are too long or too many.")
}

/// A connection.
pub struct Connection {
    stream: TcpStream,
    /// What was read and belongs to the next request or body.
    read: Vec<u8>,
    /// When the request must have come.
    deadline: Instant,
}

impl Connection {
    /// Takes a connection that was accepted.
    ///
    /// # Errors
    /// It cannot be set up.
    pub fn new(stream: TcpStream) -> io::Result<Connection> {
        // On some systems it does not wait if its listener does not.
        stream.set_nonblocking(false)?;
        stream.set_write_timeout(Some(PATIENCE))?;
        stream.set_nodelay(true)?;
        Ok(Connection { stream, read: Vec::new(), deadline: Instant::now() })
    }

    /// Waits for bytes until the deadline.
    fn fill(&mut self) -> Result<(), Missing> {
        let late = || Missing::Refused(Reply::refused(408, "The request has not come to its end in time."));
        let left = self.deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(late());
        }
        self.stream.set_read_timeout(Some(left))?;
        let mut some = [0; 16 << 10];
        match (&self.stream).read(&mut some) {
            Ok(0) => Err(Missing::Sender),
            Ok(length) => {
                self.read.extend_from_slice(&some[..length]);
                Ok(())
            }
            Err(error) if error.kind() == ErrorKind::Interrupted => Ok(()),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => Err(late()),
            Err(error) => Err(error.into()),
        }
    }

    /// Reads the next request without its body.
    ///
    /// # Errors
    /// None follows; what was sent is no request, or is too long, or comes too slowly.
    pub fn request(&mut self) -> Result<Request, Missing> {
        self.deadline = Instant::now() + PATIENCE;
        let mut seen = 0;
        loop {
            if self.read.len() > MOST_HEAD_BYTES {
                return Err(Missing::Refused(too_long()));
            }
            // At each new line, so that single bytes are not parsed again and again; and at the first bytes, which tell other
            // protocols.
            let is_new = self.read[seen..].contains(&b'\n') || seen == 0;
            if is_new && let Some((request, length)) = Request::of(&self.read).map_err(Missing::Refused)? {
                self.read.drain(..length);
                return Ok(request);
            }
            seen = self.read.len();
            match self.fill() {
                Err(_) if seen == 0 => return Err(Missing::Sender),
                filled => filled?,
            }
            if seen == 0 {
                self.deadline = Instant::now() + PATIENCE;
            }
        }
    }

    /// Reads the body of the last request, which ends by the same deadline.
    ///
    /// # Errors
    /// It ends before this length, or comes too slowly.
    pub fn body(&mut self, length: u64) -> Result<Vec<u8>, Missing> {
        while (self.read.len() as u64) < length {
            self.fill()?;
        }
        let rest = self.read.split_off(length as usize);
        Ok(std::mem::replace(&mut self.read, rest))
    }

    /// Does `work`, which may ask meanwhile whether the other side has gone.
    ///
    /// # Errors
    /// The connection failed.
    pub fn watched<T>(&self, work: impl FnOnce(&dyn Fn() -> bool) -> T) -> io::Result<T> {
        self.stream.set_nonblocking(true)?;
        let has_gone = || match self.stream.peek(&mut [0]) {
            Ok(length) => length == 0,
            Err(error) => !matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted),
        };
        let done = work(&has_gone);
        self.stream.set_nonblocking(false)?;
        Ok(done)
    }

    /// Answers the last request, without the body if it asked for a `HEAD`. `stays_open` tells the other side whether it may
    /// send another one.
    ///
    /// # Errors
    /// The connection failed, or its other side does not read.
    pub fn answer(&mut self, reply: &Reply, has_body: bool, stays_open: bool) -> io::Result<()> {
        let fixed = [
            ("Connection", if stays_open { "keep-alive" } else { "close" }),
            ("Content-Type", reply.kind),
            ("Cache-Control", "no-store"),
            ("X-Content-Type-Options", "nosniff"),
            // The token is in the address.
            ("Referrer-Policy", "no-referrer"),
            ("Content-Security-Policy", POLICY),
        ];
        // The words after the status are optional.
        let mut head = format!("HTTP/1.1 {} \r\nContent-Length: {}\r\n", reply.status, reply.body.len());
        let own = reply.headers.iter().map(|(name, value)| (*name, value.as_str()));
        for (name, value) in fixed.into_iter().chain(own) {
            head += &format!("{name}: {value}\r\n");
        }
        let mut output = &self.stream;
        output.write_all(format!("{head}\r\n").as_bytes())?;
        output.write_all(if has_body { &reply.body } else { &[] })
    }

    /// Closes the connection after its last answer. Some systems drop an answer if bytes are unread when it is closed.
    pub fn end(mut self) {
        self.deadline = Instant::now() + FAREWELL;
        if self.stream.shutdown(Shutdown::Write).is_ok() {
            while self.fill().is_ok() {
                self.read.clear();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::net::{Ipv4Addr, TcpListener};

    use super::*;

    #[test]
    fn a_request_has_its_headers_and_the_length_of_its_body() {
        let of = |headers: &str| Request::of(format!("POST /a?b=c HTTP/1.1\r\n{headers}\r\n").as_bytes());
        let whole = |headers: &str| of(headers).unwrap().unwrap().0;
        let request = whole("Host: here:80\r\ncontent-length: 12\r\n");
        assert_eq!((request.method.as_str(), request.url.as_str()), ("POST", "/a?b=c"));
        assert_eq!((request.header("host"), request.header("Origin")), (Some("here:80"), None));
        assert!(request.body_length == Some(12) && request.stays_open);
        assert!(whole("").body_length == Some(0) && !whole("Connection: Close\r\n").stays_open);
        assert_eq!(whole("Transfer-Encoding: chunked\r\n").body_length, None);
        assert!(!Request::of(b"GET / HTTP/1.0\r\n\r\n").unwrap().unwrap().0.stays_open);
        let lengths = ["-1", "+1", "", "1 2", "much", "99999999999999999999", "1\r\nContent-Length: 1"];
        for wrong in lengths.into_iter().chain(["2\r\nTransfer-Encoding: chunked"]) {
            assert_eq!(of(&format!("Content-Length: {wrong}\r\n")).unwrap_err().status, 400, "{wrong}");
        }
        for wrong in ["GET /\r\n\r\n", "GET / HTTP/2\r\n\r\n", "GET / HTTP/1.1\r\nno colon\r\n\r\n", "\x16\x03\x01\x02"]
        {
            assert_eq!(Request::of(wrong.as_bytes()).unwrap_err().status, 400, "{wrong}");
        }
        assert_eq!(of(&"a: b\r\n".repeat(MOST_HEADERS + 1)).unwrap_err().status, 431);
        assert!(Request::of(b"").unwrap().is_none() && Request::of(b"GET / HT").unwrap().is_none());
    }

    /// Both sides of a connection.
    fn connected() -> (TcpStream, Connection) {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let client = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        (client, Connection::new(listener.accept().unwrap().0).unwrap())
    }

    fn status<T>(missing: Result<T, Missing>) -> Option<u16> {
        match missing.err().expect("no request") {
            Missing::Sender => None,
            Missing::Refused(reply) => Some(reply.status),
        }
    }

    #[test]
    fn requests_follow_each_other_on_a_connection() {
        let (mut client, mut connection) = connected();
        client.write_all(b"POST /a HTTP/1.1\r\nContent-Length: 3\r\n\r\nxyzGET /b HTTP/1.1\r\n\r\n").unwrap();
        assert_eq!(connection.request().ok().unwrap().url, "/a");
        assert_eq!(connection.body(3).ok().unwrap(), b"xyz");
        let reply = Reply { headers: vec![("X-Own", "7".into())], ..Reply::new("a/b", b"body".to_vec()) };
        connection.answer(&reply, true, true).unwrap();
        assert_eq!(connection.request().ok().unwrap().url, "/b");
        assert!(!connection.watched(|has_gone| has_gone()).unwrap());
        client.shutdown(Shutdown::Write).unwrap();
        while !connection.watched(|has_gone| has_gone()).unwrap() {}
        assert_eq!((status(connection.body(1)), status(connection.request())), (None, None));
        drop(connection);
        let answer = io::read_to_string(client).unwrap();
        let [first, last] =
            ["HTTP/1.1 200 \r\nContent-Length: 4\r\nConnection: keep-alive\r\n", "\r\nX-Own: 7\r\n\r\nbody"];
        assert!(answer.starts_with(first) && answer.ends_with(last), "{answer}");
    }

    #[test]
    fn requests_without_an_end_are_errors() {
        let (mut client, mut connection) = connected();
        client.write_all(b"GET / HTTP/1.1\r\nHost: ").unwrap();
        drop(client);
        assert_eq!(status(connection.request()), None);
        let (mut client, mut connection) = connected();
        // It ends when nobody reads any more.
        let writes = std::thread::spawn(move || while client.write_all(&[b'b'; 1000]).is_ok() {});
        assert_eq!(status(connection.request()), Some(431));
        drop(connection);
        writes.join().unwrap();
        // A byte now and then does not extend the time.
        let (mut client, mut connection) = connected();
        client.write_all(b"POST / HTTP/1.1\r\nContent-Length: 9\r\n\r\nx").unwrap();
        connection.request().ok().unwrap();
        connection.deadline = Instant::now();
        client.write_all(b"x").unwrap();
        assert_eq!(status(connection.body(9)), Some(408));
    }
}
