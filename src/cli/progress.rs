//! Progress bars on a terminal, plain lines elsewhere.

use std::io::{IsTerminal, Write};
use std::sync::{Mutex, MutexGuard};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::base::{Error, Event, Listener, Result, shown};
use crate::run::EVALUATING;
use crate::runtime::in_background;

/// Seconds of a year.
const YEAR: f64 = 365.25 * 86_400.0;

/// Shortest time between two progress lines without a terminal.
const LINE_EVERY: Duration = Duration::from_secs(10);

/// Prints a line on standard error. If the reader has gone away (`2>&1 | head`), training continues.
pub fn report(line: &str) {
    let _ = writeln!(std::io::stderr(), "{}", shown(line));
}

/// Prints a result on standard output. A reader may close it early (`| head`).
///
/// # Errors
/// [`Error::Output`]: it cannot be written for another reason, such as a full disk.
pub fn print(text: &str) -> Result<()> {
    let mut out = std::io::stdout();
    printed(writeln!(out, "{text}").and_then(|()| out.flush()))
}

/// Prints text for people, which may quote names from files, with control characters escaped.
pub fn print_shown(text: &str) -> Result<()> {
    print(&shown(text))
}

/// Names the files of a command's result that exist, to open, and the next command, after the result itself.
pub fn open_next(console: &Console, files: &[std::path::PathBuf], command: &str) {
    for file in files.iter().filter(|file| file.is_file()) {
        console.say(&format!("open: {}", file.display()));
    }
    console.say(&format!("next: {command}"));
}

/// Formats seconds for people.
pub fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 120.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s if s < 172_800.0 => format!("{:.1} h", s / 3600.0),
        s if s < 2.0 * YEAR => format!("{:.1} days", s / 86_400.0),
        s => format!("{:.0} years", s / YEAR),
    }
}

/// Turns the result of writing to standard output into that of a command: a closed pipe is no error.
pub fn printed(written: std::io::Result<()>) -> Result<()> {
    match written {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Error::Output(format!("standard output: {error}; the result was not printed")))
        }
        _ => Ok(()),
    }
}

/// Prints notes and progress on standard error.
pub struct Console {
    quiet: bool,
    /// Progress is drawn: not if several trainings run at once.
    bars: bool,
    progress: Mutex<Option<Progress>>,
}

impl Console {
    /// Returns a console that prints nothing if `quiet`.
    pub fn new(quiet: bool) -> Console {
        Console { quiet, bars: true, progress: Mutex::new(None) }
    }

    /// Returns a console without bars, for several trainings at once.
    pub fn without_bars(quiet: bool) -> Console {
        Console { bars: false, ..Console::new(quiet) }
    }

    /// Prints a line unless quiet, above the bar if there is one.
    pub fn say(&self, line: &str) {
        match &*self.progress() {
            Some(progress) if progress.is_drawn() => progress.bar.println(shown(line)),
            _ if self.quiet => {}
            _ => report(line),
        }
    }

    fn progress(&self) -> MutexGuard<'_, Option<Progress>> {
        self.progress.lock().expect("no panic while drawing")
    }

    fn draw(&self, event: Event<'_>) {
        let mut progress = self.progress();
        match (event, &mut *progress) {
            (Event::Started { what, parts }, _) => *progress = Some(Progress::over_parts(self.quiet, what, parts)),
            (Event::TrainingStarted { first, steps, rays }, _) => {
                *progress = Some(Progress::of_training(self.quiet, first, steps, rays));
            }
            (Event::Advanced, Some(progress)) => progress.advance(),
            (Event::Stepped { step, loss, psnr }, Some(progress)) => progress.step(step, loss, psnr),
            (Event::Finished | Event::TrainingFinished, Some(_)) => *progress = None,
            _ => {}
        }
    }
}

impl Listener for Console {
    fn on(&self, event: Event<'_>) {
        match event {
            Event::Note(line) => self.say(line),
            Event::PointStarted { label, ended, points, steps, seconds_left } => {
                let left =
                    seconds_left.map_or(String::new(), |left| format!("; about {} left in total", duration(left)));
                self.say(&format!("[{}/{points}] {label} ({steps} steps){left}", ended + 1));
            }
            Event::PointFinished { label, psnr } => {
                let psnr = psnr.map_or(String::new(), |psnr| format!(", PSNR {psnr:.2} dB"));
                self.say(&format!("done: {label}{psnr}"));
            }
            Event::PointFailed { label, reason } => self.say(&format!("FAILED: {label}: {reason}")),
            _ if self.bars => self.draw(event),
            _ => {}
        }
    }
}

/// Progress over equal parts, or over the steps of a training: a bar on a terminal, lines elsewhere.
struct Progress {
    quiet: bool,
    bar: ProgressBar,
    /// What is done in each part.
    what: String,
    /// Rays per step of a training.
    rays: f64,
    first: u64,
    done: u64,
    last: u64,
    started: Instant,
    /// When the last line was printed.
    line_at: Option<Instant>,
}

impl Progress {
    fn new(quiet: bool, template: &str, first: u64, last: u64) -> Progress {
        let bar = if quiet || !std::io::stderr().is_terminal() {
            ProgressBar::hidden()
        } else {
            let style = ProgressStyle::with_template(template).expect("a valid template");
            ProgressBar::new(last).with_style(style).with_position(first)
        };
        bar.reset_eta();
        let (what, rays, started) = (String::new(), 0.0, Instant::now());
        Progress { quiet, bar, what, rays, first, done: first, last, started, line_at: None }
    }

    /// Starts a bar. Without a terminal an evaluation prints its number of views, since it may take as long as training.
    fn over_parts(quiet: bool, what: &str, parts: u64) -> Progress {
        let mut progress = Progress::new(quiet, "{msg:>12} {wide_bar} {pos}/{len} ETA {eta}", 0, parts);
        if progress.is_drawn() {
            progress.bar.set_message(what.to_string());
            progress.bar.tick();
        } else if what.starts_with(EVALUATING) && !quiet {
            report(&format!("{what}: {parts} view{}", if parts == 1 { "" } else { "s" }));
        }
        (progress.what, progress.line_at) = (what.into(), Some(progress.started));
        progress
    }

    /// Starts a bar from step `first` to `steps`, with `rays` rays per step.
    fn of_training(quiet: bool, first: u64, steps: u64, rays: usize) -> Progress {
        let mut progress = Progress::new(quiet, "{msg} {wide_bar} {pos}/{len} ETA {eta}", first, steps);
        progress.rays = rays as f64;
        progress
    }

    fn is_drawn(&self) -> bool {
        !self.bar.is_hidden() && !in_background()
    }

    fn advance(&mut self) {
        self.reach(self.done + 1);
        if self.is_line_due() && self.done < self.last {
            self.print(&format!("{} {}/{}", self.what, self.done, self.last));
        }
    }

    /// Shows a finished step.
    fn step(&mut self, step: u64, loss: f64, psnr: Option<f64>) {
        self.reach(step);
        let rate = (step - self.first) as f64 / self.started.elapsed().as_secs_f64();
        let psnr = psnr.map_or("-".into(), |psnr| format!("{psnr:.2}"));
        let state = format!("loss {loss:.4}  PSNR {psnr} dB  {:.0} rays/s", rate * self.rays);
        if self.is_line_due() || step == self.last {
            self.print(&format!("step {step}/{}  {state}", self.last));
        }
        if self.is_drawn() {
            self.bar.set_message(state);
        }
    }

    fn reach(&mut self, done: u64) {
        self.done = done;
        if self.is_drawn() {
            self.bar.set_position(done);
        }
    }

    fn is_line_due(&self) -> bool {
        self.line_at.is_none_or(|at| at.elapsed() >= LINE_EVERY)
    }

    /// Prints a line with the time left, unless quiet or on a terminal.
    fn print(&mut self, line: &str) {
        if self.quiet || !self.bar.is_hidden() {
            return;
        }
        self.line_at = Some(Instant::now());
        let done = (self.done - self.first).max(1) as f64;
        let left = self.started.elapsed().as_secs_f64() / done * (self.last - self.done) as f64;
        report(&format!("{line}  ETA {}", duration(left)));
    }
}

/// Removes the bar.
impl Drop for Progress {
    fn drop(&mut self) {
        if in_background() {
            self.bar.set_draw_target(ProgressDrawTarget::hidden());
        }
        self.bar.finish_and_clear();
    }
}
