//! The page as a user meets it: `augnerf view` and `train --view`, their addresses and how they end.

use std::io::{BufRead, BufReader};
use std::net::{Ipv4Addr, TcpListener};
use std::process::{Child, Command, Stdio};

use crate::common::assert_says;
use crate::common::files::files;
use crate::common::learning::Small;
use crate::common::program::{augnerf, demand};

/// The program with a page, killed when it is dropped.
struct Page {
    child: Child,
    url: String,
}

impl Page {
    /// Starts a command that prints the address of its page first.
    fn start(command: &mut Command) -> Page {
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut url = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut url).unwrap();
        Page { child, url: url.trim_end().into() }
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        // It may have ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Strangers use up no descriptors, and a page that had none for a while goes on.
#[cfg(unix)]
#[test]
fn strangers_do_not_end_the_page() {
    use crate::view::{ask, get, place_of, said};
    let (_dir, out) = Small { method: "nerf", settings: "" }.once();
    let view = "ulimit -n 40; exec \"$0\" view \"$1\" --port 0 --quiet --threads 1";
    let program = env!("CARGO_BIN_EXE_augnerf");
    let mut page = Page::start(Command::new("sh").args(["-c", view, program, out.to_str().unwrap()]));
    let place = place_of(&page.url).to_string();
    for _ in 0..100 {
        assert_eq!(ask("POST", &format!("{place}/"), "", "x").status, 403);
        let claims = said(&place, b"POST / HTTP/1.1\r\nContent-Length: 99999999\r\n\r\n");
        assert!(claims.starts_with("HTTP/1.1 403 "), "{claims}");
    }
    assert_eq!(get(&page.url).status, 200);
    let host = place.strip_prefix("http://").unwrap();
    let idle: Vec<_> = (0..60).map(|_| std::net::TcpStream::connect(host).unwrap()).collect();
    std::thread::sleep(std::time::Duration::from_secs(1));
    drop(idle);
    assert_eq!(get(&page.url).status, 200);
    assert!(page.child.try_wait().unwrap().is_none());
}

/// What is printed can be opened here, and names are addresses, too.
#[test]
fn the_address_of_an_interface_opens_on_this_computer() {
    let (_dir, out) = Small { method: "nerf", settings: "" }.once();
    let view = ["view", out.to_str().unwrap(), "--port", "0", "--host"];
    let everywhere = ["warning: other computers can reach this page", "replace the address's host by"];
    for (host, words) in [("0.0.0.0", &everywhere[..]), ("localhost", &["open this address"])] {
        let mut page = Page::start(&mut augnerf(&[&view[..], &[host]].concat()));
        assert!(page.url.starts_with("http://127.0.0.1:"), "{host}: {}", page.url);
        assert_eq!(crate::view::get(&page.url).status, 200);
        page.child.kill().unwrap();
        let said = std::io::read_to_string(page.child.stderr.take().unwrap()).unwrap();
        assert_says(&said, words);
        assert_says(&said, &[&format!("opening {}", out.display())]);
    }
    let said = demand(&mut augnerf(&[&view[..], &["no such name"]].concat()), 2);
    assert_says(&said, &["no such name", "127.0.0.1 is this computer alone"]);
}

/// It says first what it does. A signal ends it before it has an address, or else as it ends every page.
#[cfg(unix)]
#[test]
fn a_page_that_may_not_be_ready_yet_ends() {
    use std::os::unix::process::ExitStatusExt;
    let (_dir, out) = Small { method: "nerf", settings: "field.width=256 field.depth=8" }.once();
    let mut command = augnerf(&["view", out.to_str().unwrap(), "--port", "0", "--threads", "1"]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut first = String::new();
    let mut errors = BufReader::new(child.stderr.take().unwrap());
    errors.read_line(&mut first).unwrap();
    assert_says(&first, &["opening", out.to_str().unwrap()]);
    assert!(Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap().success());
    let ended = child.wait().unwrap();
    let printed = std::io::read_to_string(child.stdout.take().unwrap()).unwrap();
    match ended.signal() {
        // Signals are caught before the address is printed.
        Some(15) => assert_eq!(printed, ""),
        _ => assert!(ended.code() == Some(0) && printed.starts_with("http://") && printed.lines().count() == 1),
    }
}

/// A page that cannot be opened leaves no run behind, and replaces none.
#[test]
fn a_page_that_cannot_be_opened_creates_no_run() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("run");
    let taken = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let train = |further: &[&str], code: i32| {
        let run = ["train", "--preset", "smoke", "--quiet", "--out", out.to_str().unwrap()];
        let small = ["--set", "data.width=16", "--set", "train.rays=64", "--set", "train.steps=4"];
        demand(&mut augnerf(&[&run[..], &small, further].concat()), code)
    };
    assert_says(&train(&["--port", &port], 2), &["--port and --host", "add --view"]);
    assert_says(&train(&["--view", "--port", &port], 4), &[&port, "cannot listen there"]);
    assert!(!out.exists());
    // With --quiet, too, the address is printed: it has a secret.
    assert_says(&train(&["--view", "--port", "0"], 0), &["look at it: http://127.0.0.1:"]);
    let before = files(&out, &[]);
    train(&["--overwrite", "--host", "127.0.0.1"], 2);
    train(&["--overwrite", "--view", "--port", &port], 4);
    assert!(files(&out, &[]) == before, "the run is as before");
}
