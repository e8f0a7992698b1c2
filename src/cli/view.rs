//! `augnerf view`, and what `train --view` shows.

use std::net::{IpAddr, Ipv4Addr, SocketAddr, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use clap::Args;

use crate::base::{Error, Result};
use crate::methods::Model;
use crate::run::{Audience, Finished, Job, Setup};
use crate::runtime::host_name;
use crate::view::{Server, ShownRun};

use super::progress::{Console, print, report};
use super::signals::catch_signals_of_server;
use super::{Compute, Moved, whole};

pub const EXAMPLES: &str = "Examples:
  augnerf view RUN                         # open the address that it prints
  augnerf view runs/fern-nerf-* runs/fern-aug-nerf-*
  augnerf train --view                     # a training as it goes

The page turns, pans, zooms and flies, shows colour, depth, accumulation and normals, two runs or the worst case of the \
attack beside the clean pass, and the samples along a ray. It records camera paths for `augnerf render --cameras`. Ctrl-C \
ends it. From a server: ssh -L 7007:127.0.0.1:7007 SERVER.";

/// The port unless another is asked for.
const PORT: u16 = 7007;
/// Least time between two weights of a training that are shown, and how many times longer than making them ready it is.
const LEAST_PAUSE: Duration = Duration::from_secs(2);
const PAUSE_OVER_WORK: u32 = 10;
/// Time until the next attempt after one that failed, of which each is told.
const PAUSE_AFTER_ERROR: Duration = Duration::from_secs(60);

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

/// Flags for looking at a training as it goes.
#[derive(Args)]
#[command(next_help_heading = "Page")]
pub struct Live {
    /// Serve a page that shows the training as it goes, and print its address
    #[arg(long)]
    view: bool,
    #[command(flatten)]
    place: Place,
}

impl Live {
    /// Checks that flags of the page come with a page.
    ///
    /// # Errors
    /// [`Error::Config`]: they do not.
    pub fn check(&self) -> Result<()> {
        match !self.view && (self.place.port.is_some() || self.place.host.is_some()) {
            true => Err(Error::Config("--port and --host are of the page: add --view".into())),
            false => Ok(()),
        }
    }

    /// Opens the page of a training in `folder`, if it is asked for. The folder is not touched: a port that is taken must leave
    /// no run behind, and replace none.
    ///
    /// # Errors
    /// Those of [`Server::bind`].
    pub fn open(&self, setup: &Setup, folder: &Path) -> Result<Option<LivePage>> {
        if !self.view {
            return Ok(None);
        }
        let Setup { config, scene, runtime, .. } = setup;
        let label = folder.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let run = Arc::new(ShownRun::of_training(label, config.clone(), (*scene).clone(), runtime.clone()));
        let server = self.place.open(vec![run.clone()])?;
        Ok(Some(LivePage { run, server, next: Mutex::default() }))
    }
}

/// A page that shows a training as it goes.
pub struct LivePage {
    run: Arc<ShownRun>,
    server: Arc<Server>,
    /// When the next weights may be shown.
    next: Mutex<Option<Instant>>,
}

impl LivePage {
    /// Prints the page's address and trains. The page ends with the training.
    pub fn train(&self, job: Job, signal: &AtomicUsize, console: &Console) -> Result<Finished> {
        warn_of_others(&self.server, console);
        // Also with --quiet: nobody can guess the address.
        report(&format!("look at it: {}", self.server.url()));
        self.during(|| job.before(self).train(console, signal))
    }

    /// Does `work` while the page answers. The page ends with it.
    fn during<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        let stop = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                if let Err(error) = self.server.serve(&stop) {
                    report(&format!("the page has ended and the training continues: {error}"));
                }
            });
            // Also if the work ends by a panic.
            let _ends = Ends(&stop);
            work()
        })
    }
}

/// Stops the server when it is dropped.
struct Ends<'a>(&'a AtomicUsize);

impl Drop for Ends<'_> {
    fn drop(&mut self) {
        self.0.store(1, Ordering::SeqCst);
    }
}

impl Audience for LivePage {
    fn looks(&self) -> bool {
        let next = *self.next.lock().unwrap_or_else(PoisonError::into_inner);
        self.server.is_watched() && next.is_none_or(|next| Instant::now() >= next)
    }

    fn see(&self, step: u64, model: &Model) -> Result<()> {
        let started = Instant::now();
        let mut pause = LEAST_PAUSE;
        if let Err(error) = self.run.show_copy(step, model) {
            // It is the page's matter alone: the training goes on, and finds what is not a number by itself.
            report(&format!("the page cannot show step {step}: {error}"));
            pause = PAUSE_AFTER_ERROR;
        }
        let pause = pause.max(PAUSE_OVER_WORK * started.elapsed());
        *self.next.lock().unwrap_or_else(PoisonError::into_inner) = Some(Instant::now() + pause);
        Ok(())
    }
}
