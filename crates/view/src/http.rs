//! Connections of the page: HTTP/1.1, as far as a browser needs it. What is read before the token is checked has limits of
//! size, and a silent connection is closed, so that strangers use up neither memory nor descriptors.

use std::io::{self, BufRead, BufReader, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

/// The most bytes of a request before its body. Browsers send cookies of other pages on this computer, too.
const MOST_HEAD_BYTES: usize = 64 << 10;
/// The most lines among them.
const MOST_HEADERS: usize = 100;
/// After this time a connection whose other side neither sends nor reads is closed, and one whose request has no end yet.
pub const SILENCE: Duration = Duration::from_secs(15);

/// A request without its body.
pub struct Request {
    /// `GET`, `POST` or another.
    pub method: String,
    /// Path and query.
    pub url: String,
    is_http_1_1: bool,
    headers: Vec<(String, String)>,
}

impl Request {
    /// Reads the bytes before the body. Returns `None` if they are no request.
    fn of(head: &[u8]) -> Option<Request> {
        let mut headers = [httparse::EMPTY_HEADER; MOST_HEADERS];
        let mut request = httparse::Request::new(&mut headers);
        if request.parse(head).ok()?.is_partial() {
            return None;
        }
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        Some(Request {
            method: request.method?.into(),
            url: request.path?.into(),
            is_http_1_1: request.version? == 1,
            headers: request.headers.iter().map(|header| (header.name.into(), text(header.value))).collect(),
        })
    }

    /// Returns the value of a header.
    pub fn header(&self, name: &str) -> Option<&str> {
        let found = self.headers.iter().find(|(header, _)| header.eq_ignore_ascii_case(name));
        found.map(|(_, value)| value.as_str())
    }

    /// Returns the bytes of its body; `u64::MAX` if their number is unknown, as in chunks.
    pub fn body_length(&self) -> u64 {
        match (self.header("Transfer-Encoding"), self.header("Content-Length")) {
            (None, None) => 0,
            (None, Some(length)) => length.parse().unwrap_or(u64::MAX),
            (Some(_), _) => u64::MAX,
        }
    }

    /// Returns whether another request may follow on its connection.
    pub fn stays_open(&self) -> bool {
        let closes = self.header("Connection").is_some_and(|value| value.to_ascii_lowercase().contains("close"));
        self.is_http_1_1 && !closes
    }
}

/// A connection, which is closed when it is dropped, whatever was sent on it.
pub struct Connection {
    input: BufReader<TcpStream>,
}

impl Connection {
    /// Takes a connection that was accepted.
    ///
    /// # Errors
    /// Its limits of time cannot be set.
    pub fn new(stream: TcpStream) -> io::Result<Connection> {
        // On some systems it does not wait if its listener does not.
        stream.set_nonblocking(false)?;
        stream.set_read_timeout(Some(SILENCE))?;
        stream.set_write_timeout(Some(SILENCE))?;
        stream.set_nodelay(true)?;
        Ok(Connection { input: BufReader::new(stream) })
    }

    /// Reads the next request without its body. Returns `None` if none follows.
    ///
    /// # Errors
    /// The connection failed or was silent; what was sent is no request, or is too long, or comes too slowly.
    pub fn request(&mut self) -> io::Result<Option<Request>> {
        let (mut head, mut begun) = (Vec::new(), None);
        while !head.ends_with(b"\r\n\r\n") {
            let sent = self.input.fill_buf()?;
            if sent.is_empty() {
                return if head.is_empty() { Ok(None) } else { Err(ErrorKind::UnexpectedEof.into()) };
            }
            let end = sent.iter().position(|byte| *byte == b'\n').map_or(sent.len(), |at| at + 1);
            head.extend_from_slice(&sent[..end]);
            self.input.consume(end);
            if head.len() > MOST_HEAD_BYTES || begun.get_or_insert_with(Instant::now).elapsed() > SILENCE {
                return Err(ErrorKind::InvalidData.into());
            }
        }
        Request::of(&head).map(Some).ok_or_else(|| ErrorKind::InvalidData.into())
    }

    /// Reads the body of the last request.
    ///
    /// # Errors
    /// The connection failed, was silent or ended before it.
    pub fn body(&mut self, length: u64) -> io::Result<Vec<u8>> {
        let mut body = Vec::new();
        self.input.by_ref().take(length).read_to_end(&mut body)?;
        if body.len() as u64 == length { Ok(body) } else { Err(ErrorKind::UnexpectedEof.into()) }
    }

    /// Answers the last request. `stays_open` tells the other side whether it may send another one.
    ///
    /// # Errors
    /// The connection failed, or its other side does not read.
    pub fn answer<'a>(
        &mut self,
        status: u16,
        headers: impl Iterator<Item = (&'a str, &'a str)>,
        body: &[u8],
        stays_open: bool,
    ) -> io::Result<()> {
        let (length, connection) = (body.len(), if stays_open { "keep-alive" } else { "close" });
        // The words after the status are optional.
        let mut head = format!("HTTP/1.1 {status} \r\nContent-Length: {length}\r\nConnection: {connection}\r\n");
        for (name, value) in headers {
            head += &format!("{name}: {value}\r\n");
        }
        let mut output = self.input.get_ref();
        output.write_all(format!("{head}\r\n").as_bytes())?;
        output.write_all(body)
    }
}

#[cfg(test)]
mod tests {
    use std::net::{Ipv4Addr, Shutdown, TcpListener};

    use super::*;

    #[test]
    fn a_request_has_its_headers_and_the_length_of_its_body() {
        let of = |headers: &str| Request::of(format!("POST /a?b=c HTTP/1.1\r\n{headers}\r\n").as_bytes()).unwrap();
        let request = of("Host: here:80\r\ncontent-length: 12\r\n");
        assert_eq!((request.method.as_str(), request.url.as_str()), ("POST", "/a?b=c"));
        assert_eq!((request.header("host"), request.header("Origin")), (Some("here:80"), None));
        assert!(request.body_length() == 12 && request.stays_open());
        assert!(of("").body_length() == 0 && !of("Connection: Close\r\n").stays_open());
        for unknown in ["Transfer-Encoding: chunked\r\nContent-Length: 2\r\n", "Content-Length: -1\r\n"] {
            assert_eq!(of(unknown).body_length(), u64::MAX);
        }
        assert!(!Request::of(b"GET / HTTP/1.0\r\n\r\n").unwrap().stays_open());
        for wrong in ["", "\r\n\r\n", "GET /\r\n\r\n", "GET / HTTP/2\r\n\r\n", "GET / HTTP/1.1\r\nno colon\r\n\r\n"] {
            assert!(Request::of(wrong.as_bytes()).is_none(), "{wrong}");
        }
    }

    /// Both sides of a connection.
    fn connected() -> (TcpStream, Connection) {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let client = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        (client, Connection::new(listener.accept().unwrap().0).unwrap())
    }

    #[test]
    fn requests_follow_each_other_on_a_connection() {
        let (mut client, mut connection) = connected();
        client.write_all(b"POST /a HTTP/1.1\r\nContent-Length: 3\r\n\r\nxyzGET /b HTTP/1.1\r\n\r\n").unwrap();
        client.shutdown(Shutdown::Write).unwrap();
        assert_eq!(connection.request().unwrap().unwrap().url, "/a");
        assert_eq!(connection.body(3).unwrap(), b"xyz");
        connection.answer(200, [("X-Step", "7")].into_iter(), b"body", true).unwrap();
        assert_eq!(connection.request().unwrap().unwrap().url, "/b");
        assert!(connection.body(1).is_err() && connection.request().unwrap().is_none());
        drop(connection);
        let answer = io::read_to_string(client).unwrap();
        let head = "HTTP/1.1 200 \r\nContent-Length: 4\r\nConnection: keep-alive\r\nX-Step: 7\r\n\r\n";
        assert_eq!(answer, format!("{head}body"));
    }

    #[test]
    fn heads_without_an_end_are_errors() {
        let (mut client, mut connection) = connected();
        client.write_all(b"GET / HTTP/1.1\r\nHost: ").unwrap();
        drop(client);
        assert!(connection.request().is_err());
        let (mut client, mut connection) = connected();
        let line = format!("a: {}\r\n", "b".repeat(1000));
        // It ends when nobody reads any more.
        let writes = std::thread::spawn(move || while client.write_all(line.as_bytes()).is_ok() {});
        assert!(connection.request().is_err());
        drop(connection);
        writes.join().unwrap();
    }
}
