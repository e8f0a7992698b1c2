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

/// Asks on the terminal, and returns whether the answer is yes.
///
/// # Errors
/// [`Error::Config`]: the answer cannot be read.
pub fn says_yes(question: &str) -> Result<bool> {
    report(&format!("{question} [y/N]"));
    let mut answer = String::new();
    std::io::stdin().read_line(&mut answer).map_err(|e| Error::Config(format!("cannot read the answer: {e}")))?;
    Ok(["y", "yes"].contains(&answer.trim().to_ascii_lowercase().as_str()))
}

/// Removes a bar.
fn clear(bar: &ProgressBar) {
    if in_background() {
        bar.set_draw_target(ProgressDrawTarget::hidden());
    }
    bar.finish_and_clear();
}

/// Prints a result on standard output. A reader may close it early (`| head`).
///
/// # Errors
/// [`Error::Output`]: it cannot be written for another reason, such as a full disk.
pub fn print(text: &str) -> Result<()> {
    print_to_reader(text).map(|_| ())
}

/// Does the same for a command that prints again and again. Returns whether there is still a reader.
///
/// # Errors
/// Those of [`print`].
pub fn print_to_reader(text: &str) -> Result<bool> {
    let mut out = std::io::stdout();
    let written = writeln!(out, "{text}").and_then(|()| out.flush());
    let is_gone = written.as_ref().is_err_and(|error| error.kind() == std::io::ErrorKind::BrokenPipe);
    printed(written).map(|()| !is_gone)
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
    bar: Mutex<Option<Bar>>,
}

/// The current progress bar.
enum Bar {
    Stretch(Stretch),
    Training(TrainingBar),
}

impl Console {
    /// Returns a console that prints nothing if `quiet`.
    pub fn new(quiet: bool) -> Console {
        Console { quiet, bars: true, bar: Mutex::new(None) }
    }

    /// Returns a console without bars, for several trainings at once.
    pub fn without_bars(quiet: bool) -> Console {
        Console { bars: false, ..Console::new(quiet) }
    }

    /// Prints a line unless quiet.
    pub fn say(&self, line: &str) {
        match &*self.bar() {
            Some(Bar::Training(bar)) => bar.say(line),
            _ if self.quiet => {}
            _ => report(line),
        }
    }

    fn bar(&self) -> MutexGuard<'_, Option<Bar>> {
        self.bar.lock().expect("no panic while drawing")
    }

    fn draw(&self, event: Event<'_>) {
        let mut bar = self.bar();
        match (event, &mut *bar) {
            (Event::Started { what, parts }, _) => *bar = Some(Bar::Stretch(Stretch::new(self.quiet, what, parts))),
            (Event::Advanced, Some(Bar::Stretch(stretch))) => stretch.advance(),
            (Event::Finished, Some(Bar::Stretch(stretch))) => {
                clear(&stretch.bar);
                *bar = None;
            }
            (Event::TrainingStarted { first, steps, rays }, _) => {
                *bar = Some(Bar::Training(TrainingBar::new(self.quiet, first, steps, rays)));
            }
            (Event::Stepped { step, loss, psnr }, Some(Bar::Training(bar))) => bar.stepped(step, loss, psnr),
            (Event::TrainingFinished, Some(Bar::Training(training))) => {
                training.finish();
                *bar = None;
            }
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

/// Progress over equal parts: the number done, and ETA.
struct Stretch {
    quiet: bool,
    what: String,
    parts: u64,
    done: u64,
    bar: ProgressBar,
    started: Instant,
    line_at: Instant,
}

impl Stretch {
    /// Starts a bar. Without a terminal an evaluation prints its number of views, since it may take as long as training.
    fn new(quiet: bool, what: &str, parts: u64) -> Stretch {
        let bar = if quiet || !std::io::stderr().is_terminal() {
            if what.starts_with(EVALUATING) && !quiet {
                report(&format!("{what}: {parts} view{}", if parts == 1 { "" } else { "s" }));
            }
            ProgressBar::hidden()
        } else {
            let style = ProgressStyle::with_template("{msg:>12} {wide_bar} {pos}/{len} ETA {eta}");
            let bar = ProgressBar::new(parts).with_style(style.expect("a valid template"));
            let bar = bar.with_message(what.to_string());
            if !in_background() {
                bar.tick();
            }
            bar
        };
        let now = Instant::now();
        Stretch { quiet, what: what.to_string(), parts, done: 0, bar, started: now, line_at: now }
    }

    fn advance(&mut self) {
        self.done += 1;
        if !in_background() {
            self.bar.set_position(self.done);
        }
        if !self.quiet && self.bar.is_hidden() && self.line_at.elapsed() >= LINE_EVERY && self.done < self.parts {
            self.line_at = Instant::now();
            let left =
                self.started.elapsed().as_secs_f64() / self.done as f64 * self.parts.saturating_sub(self.done) as f64;
            report(&format!("{} {}/{}  ETA {}", self.what, self.done, self.parts, duration(left)));
        }
    }
}

/// Progress of training: step, loss, PSNR, rays/s and ETA.
struct TrainingBar {
    quiet: bool,
    bar: Option<ProgressBar>,
    rays: f64,
    first: u64,
    total: u64,
    started: Instant,
    line_at: Option<Instant>,
}

impl TrainingBar {
    /// Returns a bar from step `first` to `total`, with `rays` rays per step.
    fn new(quiet: bool, first: u64, total: u64, rays: usize) -> TrainingBar {
        let bar = (!quiet && std::io::stderr().is_terminal()).then(|| {
            let style = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} ETA {eta}");
            let bar = ProgressBar::new(total).with_style(style.expect("a valid template")).with_position(first);
            bar.reset_eta();
            bar
        });
        TrainingBar { quiet, bar, rays: rays as f64, first, total, started: Instant::now(), line_at: None }
    }

    /// Shows a finished step.
    fn stepped(&mut self, step: u64, loss: f64, psnr: Option<f64>) {
        let done = step - self.first;
        let seconds = self.started.elapsed().as_secs_f64();
        let rate = done as f64 / seconds;
        let psnr = psnr.map_or("-".into(), |psnr| format!("{psnr:.2}"));
        let state = format!("loss {loss:.4}  PSNR {psnr} dB  {:.0} rays/s", rate * self.rays);
        match &self.bar {
            Some(_) if in_background() => {}
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
    fn say(&self, line: &str) {
        match &self.bar {
            Some(bar) if !in_background() => bar.println(shown(line)),
            _ if self.quiet => {}
            _ => report(line),
        }
    }

    /// Removes the bar.
    fn finish(&self) {
        if let Some(bar) = &self.bar {
            clear(bar);
        }
    }
}
