//! Progress bars on a terminal, plain lines elsewhere.

use std::io::{IsTerminal, Write};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use crate::base::Progress;
use crate::run::Reporter;
use crate::train::StepStats;

/// Where there is no terminal, a line at most so often.
const LINE_EVERY: Duration = Duration::from_secs(10);

/// Prints a line on standard error. A reader that has gone away (`2>&1 | head`) is no reason to
/// stop training.
pub fn report(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// Prints a result on standard output; a reader that has seen enough may close it.
pub fn print(text: &str) {
    let _ = writeln!(std::io::stdout(), "{text}");
}

/// Draws loading and rendering, on standard error.
pub struct Screen {
    quiet: bool,
    bar: Mutex<ProgressBar>,
}

impl Screen {
    /// A screen that shows nothing if `quiet`.
    pub fn new(quiet: bool) -> Screen {
        Screen { quiet, bar: Mutex::new(ProgressBar::hidden()) }
    }

    /// Prints a line unless quiet.
    pub fn say(&self, line: &str) {
        if !self.quiet {
            report(line);
        }
    }
}

impl Progress for Screen {
    fn start(&self, label: &str, total: u64) {
        let mut bar = self.bar.lock().expect("no panic while drawing");
        *bar = if self.quiet || !std::io::stderr().is_terminal() {
            ProgressBar::hidden()
        } else {
            let style = ProgressStyle::with_template("{msg:>12} {wide_bar} {pos}/{len} ETA {eta}");
            ProgressBar::new(total).with_style(style.expect("a valid template")).with_message(label.to_string())
        };
    }

    fn advance(&self) {
        self.bar.lock().expect("no panic while drawing").inc(1);
    }

    fn finish(&self) {
        self.bar.lock().expect("no panic while drawing").finish_and_clear();
    }
}

/// Tells a person at a terminal how one experiment goes.
pub struct Console {
    screen: Screen,
    bar: Mutex<Option<TrainingBar>>,
}

impl Console {
    /// A console that shows nothing if `quiet`.
    pub fn new(quiet: bool) -> Console {
        Console { screen: Screen::new(quiet), bar: Mutex::new(None) }
    }

    fn bar(&self) -> std::sync::MutexGuard<'_, Option<TrainingBar>> {
        self.bar.lock().expect("no panic while drawing")
    }
}

impl Reporter for Console {
    fn say(&self, line: &str) {
        match &*self.bar() {
            Some(bar) => bar.say(line),
            None => self.screen.say(line),
        }
    }

    fn begin(&self, first: u64, total: u64, rays: usize) {
        *self.bar() = Some(TrainingBar::new(self.screen.quiet, first, total, rays));
    }

    fn stepped(&self, stats: &StepStats) {
        if let Some(bar) = &mut *self.bar() {
            bar.stepped(stats.step, stats.loss, stats.psnr());
        }
    }

    fn trained(&self) {
        if let Some(bar) = self.bar().take() {
            bar.finish();
        }
    }

    fn progress(&self) -> &dyn Progress {
        &self.screen
    }
}

/// Tells a person how several experiments at once go: lines, no bars.
pub struct Lines {
    screen: Screen,
}

impl Lines {
    /// Lines that are not printed if `quiet`.
    pub fn new(quiet: bool) -> Lines {
        Lines { screen: Screen::new(quiet) }
    }
}

impl Reporter for Lines {
    fn say(&self, line: &str) {
        self.screen.say(line);
    }

    fn begin(&self, _first: u64, _total: u64, _rays: usize) {}

    fn stepped(&self, _stats: &StepStats) {}

    fn trained(&self) {}

    fn progress(&self) -> &dyn Progress {
        &()
    }
}

/// Draws training: step, loss, PSNR, rays/s and ETA.
pub struct TrainingBar {
    quiet: bool,
    bar: Option<ProgressBar>,
    rays: f64,
    first: u64,
    total: u64,
    started: Instant,
    line_at: Option<Instant>,
}

impl TrainingBar {
    /// A bar from step `first` to `total`, of `rays` rays each.
    pub fn new(quiet: bool, first: u64, total: u64, rays: usize) -> TrainingBar {
        let bar = (!quiet && std::io::stderr().is_terminal()).then(|| {
            let style = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} ETA {eta}");
            let bar = ProgressBar::new(total).with_style(style.expect("a valid template")).with_position(first);
            bar.reset_eta();
            bar
        });
        TrainingBar { quiet, bar, rays: rays as f64, first, total, started: Instant::now(), line_at: None }
    }

    /// Shows a finished step.
    pub fn stepped(&mut self, step: u64, loss: f64, psnr: Option<f64>) {
        let done = step - self.first;
        let seconds = self.started.elapsed().as_secs_f64();
        let rate = done as f64 / seconds;
        let psnr = psnr.map_or("-".into(), |psnr| format!("{psnr:.2}"));
        let state = format!("loss {loss:.4}  PSNR {psnr} dB  {:.0} rays/s", rate * self.rays);
        match &self.bar {
            Some(bar) => {
                bar.set_message(state);
                bar.set_position(step);
            }
            None if self.quiet => {}
            None if self.line_at.is_none_or(|at| at.elapsed() >= LINE_EVERY) || step == self.total => {
                self.line_at = Some(Instant::now());
                let left = Duration::try_from_secs_f64((self.total - step) as f64 / rate).unwrap_or(Duration::MAX);
                report(&format!("step {step}/{}  {state}  ETA {}", self.total, indicatif::HumanDuration(left)));
            }
            None => {}
        }
    }

    /// Prints a line above the bar.
    pub fn say(&self, line: &str) {
        match &self.bar {
            Some(bar) => bar.println(line),
            None if self.quiet => {}
            None => report(line),
        }
    }

    /// Takes the bar away.
    pub fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
