//! The page as a user meets it: `augnerf view`, its addresses and how it ends.

use std::io::{BufRead, BufReader};
use std::net::{Ipv4Addr, TcpListener};
use std::process::{Child, Command, Stdio};

use crate::common::assert_says;
use crate::common::program::{Place, augnerf, demand, set};

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

/// What is printed can be opened here, and names are addresses, too.
#[test]
fn the_address_of_an_interface_opens_on_this_computer() {
    let place = Place::trained(&set("data.width=16 train.rays=64 train.steps=40 eval.pictures=0"));
    let out = place.at("run");
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
    let taken = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    place.says(&format!("view run --port {port}"), 4, &[&port, "cannot listen there"]);
}

/// It says first what it does. A signal ends it before it has an address, or else as it ends every page.
#[cfg(unix)]
#[test]
fn a_page_that_may_not_be_ready_yet_ends() {
    use std::os::unix::process::ExitStatusExt;
    let small = "data.width=16 train.rays=64 train.steps=1 eval.pictures=0 field.width=256 field.depth=8";
    let place = Place::trained(&set(small));
    let mut command = place.command("view run --port 0 --threads 1");
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut first = String::new();
    let mut errors = BufReader::new(child.stderr.take().unwrap());
    errors.read_line(&mut first).unwrap();
    assert_says(&first, &["opening run"]);
    assert!(Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap().success());
    let ended = child.wait().unwrap();
    let printed = std::io::read_to_string(child.stdout.take().unwrap()).unwrap();
    match ended.signal() {
        // Signals are caught before the address is printed.
        Some(15) => assert_eq!(printed, ""),
        _ => assert!(ended.code() == Some(0) && printed.starts_with("http://") && printed.lines().count() == 1),
    }
}
