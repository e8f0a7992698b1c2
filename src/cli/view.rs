//! `augnerf view`.

use std::net::{IpAddr, Ipv4Addr, SocketAddr, ToSocketAddrs};
use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;

use crate::base::{Error, Result};
use crate::runtime::host_name;
use crate::view::{Server, ShownRun};

use super::progress::{Console, print, report};
use super::signals::catch_signals_of_server;
use super::{Compute, Moved, whole};

pub const EXAMPLES: &str = "Examples:
  augnerf view RUN                         # open the address that it prints; RUN may be training
  augnerf view runs/fern-nerf-* runs/fern-aug-nerf-*

The page turns, pans, zooms and flies, shows colour, depth, accumulation and normals, two runs or the worst case of the \
attack beside the clean pass, and the samples along a ray. It records camera paths for `augnerf render --cameras`. Ctrl-C \
ends it. From a server: ssh -L 7007:127.0.0.1:7007 SERVER.";

/// The port unless another is asked for.
const PORT: u16 = 7007;

#[derive(Args)]
#[command(next_help_heading = "Experiment")]
pub struct ViewArguments {
    /// Run folders of one scene (newest checkpoints)
    #[arg(required = true, num_args = 1..=8)]
    runs: Vec<PathBuf>,
    #[command(flatten)]
    sources: Moved,
    #[command(flatten)]
    place: Place,
    #[command(flatten)]
    compute: Compute,
}

/// Where the page is served.
#[derive(Args)]
#[command(next_help_heading = "Page")]
pub struct Place {
    /// Port of the page; 0 takes a free one [default: 7007, or a free one if that is taken]
    #[arg(long, value_name = "N", value_parser = whole::<u16>(0..=u16::MAX.into()))]
    port: Option<u16>,
    /// Address or name of the interface; others than 127.0.0.1 let other computers in [default: 127.0.0.1]
    #[arg(long, value_name = "ADDRESS", value_parser = address)]
    host: Option<IpAddr>,
}

/// Reads an address, or a name of this computer such as localhost.
fn address(text: &str) -> std::result::Result<IpAddr, String> {
    let bare = text.strip_prefix('[').and_then(|text| text.strip_suffix(']')).unwrap_or(text);
    if let Ok(address) = bare.parse() {
        return Ok(address);
    }
    let found: Vec<IpAddr> = (text, 0).to_socket_addrs().into_iter().flatten().map(|address| address.ip()).collect();
    let found = found.iter().find(|address| address.is_ipv4()).or(found.first()).copied();
    found.ok_or_else(|| {
        "no such address or name of this computer: 127.0.0.1 is this computer alone, 0.0.0.0 all of its networks".into()
    })
}

impl Place {
    /// Opens the page of some runs.
    fn open(&self, runs: Vec<Arc<ShownRun>>) -> Result<Arc<Server>> {
        let host = self.host.unwrap_or(IpAddr::V4(Ipv4Addr::LOCALHOST));
        let at = |port| Server::bind(runs.clone(), SocketAddr::new(host, port));
        let server = match self.port {
            Some(port) => at(port)?,
            None => match at(PORT) {
                Err(Error::Output(_)) => at(0)?,
                server => server?,
            },
        };
        Ok(Arc::new(server))
    }
}

/// Warns if other computers can reach the page, and says at which address.
fn warn_of_others(server: &Server, console: &Console) {
    if server.is_public() {
        console.say(
            "warning: other computers can reach this page. It is plain HTTP: whoever reads the network can read the address, \
             with which anyone can look. An ssh tunnel to 127.0.0.1 is safer",
        );
    }
    if server.is_everywhere() {
        let name = host_name();
        console.say(&format!(
            "on another computer, replace the address's host by this computer's name ({name}) or IP address"
        ));
    }
}

impl ViewArguments {
    pub fn run(self) -> Result<()> {
        let runtime = self.compute.runtime_or("cpu")?;
        let console = Console::new(self.compute.quiet);
        let open = |folder: &PathBuf| {
            console.say(&format!("opening {}", folder.display()));
            ShownRun::open(folder, self.sources.data.as_deref(), &runtime, &console).map(Arc::new)
        };
        let runs = self.runs.iter().map(open).collect::<Result<Vec<_>>>()?;
        let server = self.place.open(runs)?;
        // Until now a signal ends the program at once: nothing is lost.
        let stop = catch_signals_of_server()?;
        warn_of_others(&server, &console);
        print(&server.url())?;
        console.say("open this address in a browser; Ctrl-C ends the page");
        let finder = server.clone();
        // It ends with the program.
        std::thread::spawn(move || {
            if let Err(error) = finder.find_empty_space() {
                report(&format!("no empty space is skipped: {error}"));
            }
        });
        server.serve(&stop)
    }
}
