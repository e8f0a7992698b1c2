//! The server: connections, and who may ask.

use std::collections::HashMap;
use std::io;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crate::base::{Error, Result};

use super::http::{Connection, Missing, Reply, Request};
use super::pictures::Pictures;
use super::router::Router;
use super::shown::ShownRun;

/// The most connections at once. A page has at most six. Pictures are made for one at a time.
const MOST_CONNECTIONS: usize = 64;
/// How often the server looks for a connection and for its end.
const PAUSE: Duration = Duration::from_millis(10);
/// Pause after a connection that cannot be accepted, as without descriptors, and for how long such failures may follow each
/// other.
const PAUSE_AFTER_ERROR: Duration = Duration::from_millis(200);
const HOPELESS: Duration = Duration::from_secs(20);
/// How long the server waits for its last answers.
const FAREWELL: Duration = Duration::from_secs(2);
/// The most bytes of a body.
const MOST_BODY_BYTES: u64 = 4 << 20;

/// The server of one page with one or two runs.
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
    token: String,
    router: Router,
    /// A clone is held for each connection.
    connections: Arc<()>,
    /// A clone is held for each request that is being answered.
    answering: Arc<()>,
}

impl Server {
    /// Listens at `wanted` for pages that show `runs`, which must be of one scene. Port 0 takes a free one.
    ///
    /// # Errors
    /// [`Error::Config`]: the runs' scenes differ. [`Error::Output`]: the port is taken or the address is not of this computer.
    pub fn bind(runs: Vec<Arc<ShownRun>>, wanted: SocketAddr) -> Result<Server> {
        if let Some(other) = runs.iter().skip(1).find(|run| !are_of_one_scene(&runs[0], run)) {
            return Err(Error::Config(format!(
                "{} and {} have different scenes or units, so no camera can show both: view runs of one scene",
                runs[0].label, other.label
            )));
        }
        let failed = |why: String| {
            Error::Output(format!("{wanted}: cannot listen there: {why}; choose another --host or --port"))
        };
        let listen = || -> io::Result<(TcpListener, SocketAddr)> {
            let listener = TcpListener::bind(wanted)?;
            listener.set_nonblocking(true)?;
            let address = listener.local_addr()?;
            Ok((listener, address))
        };
        let (listener, address) = listen().map_err(|e| failed(e.to_string()))?;
        let mut secret = [0u8; 16];
        getrandom::fill(&mut secret).map_err(|e| failed(format!("no random numbers for its token ({e})")))?;
        let token = secret.iter().map(|byte| format!("{byte:02x}")).collect();
        Ok(Server {
            listener,
            address,
            token,
            router: Router { runs, pictures: Pictures::default() },
            connections: Arc::default(),
            answering: Arc::default(),
        })
    }

    /// Returns the address to open on this computer.
    pub fn url(&self) -> String {
        let mut address = self.address;
        if address.ip().is_unspecified() {
            address.set_ip(if address.is_ipv4() { Ipv4Addr::LOCALHOST.into() } else { Ipv6Addr::LOCALHOST.into() });
        }
        format!("http://{address}/{}/", self.token)
    }

    /// Returns whether other computers can reach it.
    pub fn is_public(&self) -> bool {
        !self.address.ip().is_loopback()
    }

    /// Returns whether it listens at every interface of this computer, so that other computers have another address than
    /// [`Server::url`].
    pub fn is_everywhere(&self) -> bool {
        self.address.ip().is_unspecified()
    }

    /// Returns the number of pictures and rays that were asked for and are neither made nor given up.
    pub fn unfinished(&self) -> usize {
        self.router.pictures.queue.unfinished()
    }

    /// Finds the empty space of the runs, which makes their pictures faster, whenever no small picture is asked for. Returns
    /// when it is found, or the server stops.
    ///
    /// # Errors
    /// Those of [`ShownRun::find_empty_space`].
    pub fn find_empty_space(&self) -> Result<()> {
        match self.router.runs.iter().try_for_each(|run| self.router.pictures.find_empty_space(run)) {
            Err(Error::Interrupted { .. }) => Ok(()),
            found => found,
        }
    }

    /// Answers until `stop` is not 0. What is being answered then gets a short time to end. A thread whose other side neither
    /// reads nor writes is left behind, so that it holds nobody up.
    ///
    /// # Errors
    /// [`Error::Output`]: no connection can be accepted any more.
    pub fn serve(self: &Arc<Self>, stop: &AtomicUsize) -> Result<()> {
        let ended = self.accept(stop);
        self.router.pictures.stop();
        let until = Instant::now() + FAREWELL;
        while Instant::now() < until && Arc::strong_count(&self.answering) > 1 {
            std::thread::sleep(PAUSE);
        }
        ended
    }

    fn accept(self: &Arc<Self>, stop: &AtomicUsize) -> Result<()> {
        let mut failing = None;
        while stop.load(Ordering::SeqCst) == 0 {
            match self.listener.accept() {
                Ok((stream, _)) => {
                    failing = None;
                    self.begin(stream);
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    failing = None;
                    std::thread::sleep(PAUSE);
                }
                Err(error) if failing.get_or_insert_with(Instant::now).elapsed() > HOPELESS => {
                    let address = self.address;
                    return Err(Error::Output(format!(
                        "{address}: no connection to the page can be accepted any more: {error}"
                    )));
                }
                Err(_) => {
                    std::thread::sleep(PAUSE_AFTER_ERROR);
                }
            }
        }
        Ok(())
    }

    /// Answers a connection on a thread of its own, so that a defect there ends nothing else. If there are too many, it is
    /// closed.
    fn begin(self: &Arc<Self>, stream: TcpStream) {
        let (server, connection) = (self.clone(), self.connections.clone());
        // One is the server's own.
        if Arc::strong_count(&connection) > MOST_CONNECTIONS + 1 {
            return;
        }
        let work = move || {
            let _connection = connection;
            // Its other side has gone, is silent or does not read: there is nobody to tell.
            let _ = server.converse(stream);
        };
        // Without a thread for it, it is closed.
        let _ = std::thread::Builder::new().name("page".into()).spawn(work);
    }

    fn converse(&self, stream: TcpStream) -> io::Result<()> {
        let mut connection = Connection::new(stream)?;
        loop {
            match self.exchange(&mut connection) {
                Ok(true) => {}
                Ok(false) => break,
                Err(Missing::Sender) => return Ok(()),
                Err(Missing::Refused(refusal)) => {
                    connection.answer(&refusal, true, false)?;
                    break;
                }
            }
        }
        connection.end();
        Ok(())
    }

    /// Answers the next request. Returns whether another one may follow.
    ///
    /// # Errors
    /// There is none, or it is refused. The body of a refused one is not read.
    fn exchange(&self, connection: &mut Connection) -> std::result::Result<bool, Missing> {
        let request = connection.request()?;
        let _answering = self.answering.clone();
        if self.router.pictures.is_stopping() {
            return Err(Missing::Sender);
        }
        self.check(&request).map_err(Missing::Refused)?;
        let length = request.body_length.filter(|length| *length <= MOST_BODY_BYTES);
        let too_long = || Reply::refused(413, "The request is too long, or does not say how long it is.");
        let body = connection.body(length.ok_or_else(|| Missing::Refused(too_long()))?)?;
        let reply = connection.watched(|has_gone| self.router.route(&request, &body, has_gone))?;
        connection.answer(&reply, request.method != "HEAD", request.stays_open)?;
        Ok(request.stays_open)
    }

    /// Refuses what comes from another page, or without the token.
    fn check(&self, request: &Request) -> std::result::Result<(), Reply> {
        let host = request.header("Host").unwrap_or_default();
        if request.header("Origin").is_some_and(|origin| !is_own(origin, host)) {
            let words =
                "Another page has asked for this. Open the address that augnerf printed. A proxy must pass on Host.";
            return Err(Reply::refused(403, words));
        }
        let given = request.url.split('/').nth(1).unwrap_or_default();
        let differences = given.bytes().zip(self.token.bytes()).fold(0, |found, (a, b)| found | (a ^ b));
        if given.len() != self.token.len() || differences != 0 {
            let words = "The address lacks its token. Open the whole address that augnerf printed.";
            return Err(Reply::refused(403, words));
        }
        Ok(())
    }
}

/// Returns whether a page from `origin` is of the server that is asked as `host`. It may be of https: a proxy may end TLS.
fn is_own(origin: &str, host: &str) -> bool {
    let (port, of_page) = match origin.split_once("://") {
        Some(("http", of_page)) => (":80", of_page),
        Some(("https", of_page)) => (":443", of_page),
        _ => return false,
    };
    let bare = |host: &str| host.strip_suffix(port).unwrap_or(host).to_ascii_lowercase();
    !host.is_empty() && bare(of_page) == bare(host)
}

/// Returns whether one camera can show both runs: whether they have the same scene in the same units.
fn are_of_one_scene(a: &ShownRun, b: &ShownRun) -> bool {
    let poses = |run: &ShownRun| {
        run.scene
            .train
            .iter()
            .chain(&run.scene.test)
            .map(|view| (view.name.clone(), view.camera.pose))
            .collect::<HashMap<_, _>>()
    };
    let (of_a, of_b) = (poses(a), poses(b));
    let mut common = of_a.iter().filter_map(|(name, pose)| Some((pose, of_b.get(name)?))).peekable();
    a.scene.name == b.scene.name && common.peek().is_some() && common.all(|(a, b)| a == b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_is_own_if_its_host_is() {
        for (origin, host, own) in [
            ("http://127.0.0.1:7007", "127.0.0.1:7007", true),
            ("https://127.0.0.1:7007", "127.0.0.1:7007", true),
            ("https://Runs.example", "runs.example", true),
            ("https://runs.example", "runs.example:443", true),
            ("http://runs.example:80", "runs.example", true),
            ("https://[::1]:7007", "[::1]:7007", true),
            ("https://runs.example", "runs.example:80", false),
            ("https://runs.example.evil.example", "runs.example", false),
            ("https://evil.example", "runs.example", false),
            ("http://127.0.0.1:7008", "127.0.0.1:7007", false),
            ("ftp://runs.example", "runs.example", false),
            ("null", "null", false),
            ("http://", "", false),
            ("", "", false),
        ] {
            assert_eq!(is_own(origin, host), own, "{origin} {host}");
        }
    }
}
