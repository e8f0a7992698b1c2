//! Runs the points of a sweep: alone or next to other workers on the same folder, from wherever an
//! earlier one was stopped or killed.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use crate::base::{Class, Error, Event, Listener, Result};
use crate::metrics::PSNR;
use crate::runtime::Runtime;

use super::claim::{Claim, Progress, Sharing};
use super::folder::SweepFolder;
use super::pace::{Pace, spent};
use super::point_folder::{Failure, PointFolder, PointResult};
use super::points::Point;

/// Between two looks at points that other workers hold.
const LOOK_EVERY: Duration = Duration::from_millis(500);
/// After so many turns of a scheduler that were too short for its evaluation, a point fails.
const MOST_SHORT_TURNS: u32 = 5;

/// What trains a point.
pub trait Work: Sync {
    /// Trains and measures a point on `runtime`, going on from what an earlier try left in `folder`. A signal's
    /// number in `stop` asks for a stop with [`Error::Interrupted`].
    fn run(
        &self,
        point: &Point,
        folder: &PointFolder,
        runtime: &Runtime,
        progress: &Progress,
        stop: &AtomicUsize,
    ) -> Result<PointResult>;
}

/// How a sweep is run.
#[derive(Clone, Debug)]
pub struct Options {
    /// Points at once; the cores are shared among them.
    pub jobs: usize,
    /// Stop at the first failure.
    pub fail_fast: bool,
    /// Try failed points again.
    pub retry_failed: bool,
    /// Measure finished points again that lack one of these metrics.
    pub remeasure: Vec<String>,
    /// How points are divided among workers.
    pub sharing: Sharing,
}

/// Runs the points of a sweep, beside other runners on the same folder.
pub struct Runner<'a> {
    /// The sweep's folder.
    pub folder: &'a SweepFolder,
    /// What is to be run, in this order.
    pub points: &'a [Point],
    /// Where they are trained: its threads are shared among the jobs.
    pub runtime: &'a Runtime,
    /// What trains a point.
    pub work: &'a dyn Work,
    /// Jobs at once, retries, limits.
    pub options: Options,
    /// Hears of each point when it begins and ends.
    pub events: &'a dyn Listener,
    /// Holds a signal's number when it is time to stop.
    pub stop: &'a AtomicUsize,
}

/// What a runner does next.
enum Next<'a> {
    Run(&'a Point, PointFolder, Claim),
    /// Others work on all that is left: who they are.
    Wait(Vec<String>),
    Nothing,
}

impl Runner<'_> {
    /// Runs until nothing is left, a signal comes, or, with `fail_fast`, a point fails. An error is
    /// one of the whole sweep (a full disk, a signal); failed points are in the folder.
    pub fn run(&self) -> Result<()> {
        let runnable: Vec<&Point> = self.points.iter().filter(|point| point.no_data.is_none()).collect();
        for point in &runnable {
            let folder = self.folder.point(&point.id);
            folder.begin(point)?;
            folder.clean_up(self.options.sharing)?;
        }
        let again = self.to_do_again(&runnable)?;
        let failed = AtomicBool::new(false);
        let said = Mutex::new(Vec::new());
        let pace = Mutex::new(Pace::of(self.folder, &runnable));
        let worker = || -> Result<()> {
            let runtime = self.runtime.share(self.options.jobs)?;
            loop {
                if failed.load(Ordering::SeqCst) && self.options.fail_fast {
                    return Ok(());
                }
                match self.next(&runnable, &again)? {
                    Next::Nothing => return Ok(()),
                    Next::Wait(others) => {
                        self.say_who_works(others, &said);
                        std::thread::sleep(LOOK_EVERY);
                    }
                    Next::Run(point, folder, claim) => {
                        if runtime.install(|| self.run_point(point, &folder, &runtime, claim, &pace))?.is_err() {
                            failed.store(true, Ordering::SeqCst);
                        }
                    }
                }
            }
        };
        std::thread::scope(|scope| {
            let workers: Vec<_> = (0..self.options.jobs).map(|_| scope.spawn(worker)).collect();
            let ended: Vec<Result<()>> = workers
                .into_iter()
                .map(|worker| worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
                .collect();
            ended.into_iter().collect()
        })
    }

    /// The points to be done again, with the time at which they ended: failures and gaps that are there now, and no
    /// later ones. A gap can stay: not every scene has every metric.
    fn to_do_again(&self, points: &[&Point]) -> Result<HashMap<String, SystemTime>> {
        let mut again = HashMap::new();
        for point in points {
            let folder = self.folder.point(&point.id);
            let ended = match folder.failed_at() {
                Some(at) => Some(at).filter(|_| self.options.retry_failed),
                None if folder.lacks(&self.options.remeasure)? => folder.finished_at(),
                None => None,
            };
            again.extend(ended.map(|at| (point.id.clone(), at)));
        }
        Ok(again)
    }

    /// Says for whom is waited, when that changes.
    fn say_who_works(&self, others: Vec<String>, said: &Mutex<Vec<String>>) {
        let mut said = said.lock().expect("no panic while speaking");
        if *said != others {
            let who = others.join(", ");
            self.events.on(Event::Note(&format!("waiting for points that others work on: {who}")));
            *said = others;
        }
    }

    fn next<'a>(&self, points: &[&'a Point], again: &HashMap<String, SystemTime>) -> Result<Next<'a>> {
        let mut others = Vec::new();
        for point in points {
            self.check_stop()?;
            let folder = self.folder.point(&point.id);
            let again = || {
                let ended = folder.failed_at().or(folder.finished_at());
                ended.is_some() && again.get(&point.id) == ended.as_ref()
            };
            if folder.ended() && !again() {
                continue;
            }
            let Some(claim) = Claim::take(folder.path(), self.options.sharing)? else {
                if self.options.sharing == Sharing::Locks {
                    others.push(
                        Claim::look(folder.path()).map_or("a worker that just began".into(), |claim| claim.who()),
                    );
                }
                continue;
            };
            // Another worker may have finished it between the look and the claim.
            if !folder.ended() || again() {
                folder.clean()?;
                folder.clear_failure()?;
                return Ok(Next::Run(point, folder, claim));
            }
        }
        others.sort();
        others.dedup();
        Ok(if others.is_empty() { Next::Nothing } else { Next::Wait(others) })
    }

    fn check_stop(&self) -> Result<()> {
        match self.stop.load(Ordering::SeqCst) {
            0 => Ok(()),
            signal => Err(Error::Interrupted {
                signal: signal as i32,
                message: format!(
                    "stopped by signal {signal}; nothing is lost: the same command goes on with {}",
                    self.folder.path().display()
                ),
            }),
        }
    }

    /// Runs a claimed point. The outer error is one of the sweep, the inner one of the point.
    fn run_point(
        &self,
        point: &Point,
        folder: &PointFolder,
        runtime: &Runtime,
        claim: Claim,
        pace: &Mutex<Pace>,
    ) -> Result<std::result::Result<(), ()>> {
        let begun = Instant::now();
        let label = point.label();
        self.say_what_begins(point, &label, pace);
        if !claim.is_locked {
            self.events.on(Event::Note(&format!("{label}: no locks here; start no other worker on this point")));
        }
        let outcome = match self.work(point, folder, runtime, &claim) {
            Ok(result) => Ok(result),
            Err(error @ Error::Interrupted { .. }) => match self.evaluation_too_long(folder, &claim)? {
                Some(failure) => Err(failure),
                None => {
                    self.check_stop()?;
                    return Err(error);
                }
            },
            // A full disk is no point's fault, and every other one's as well.
            Err(error @ Error::Output(_)) => return Err(error),
            Err(error) => Err(Failure { reason: error.to_string(), exit_code: error.exit_code() }),
        };
        match &outcome {
            Ok(result) => {
                folder.finish(result)?;
                let seconds = spent(folder).unwrap_or_else(|| begun.elapsed().as_secs_f64());
                pace.lock().unwrap_or_else(PoisonError::into_inner).add(point, seconds);
                self.events.on(Event::PointFinished { label: &label, psnr: result.metric(PSNR.key) });
            }
            Err(failure) => {
                folder.fail(failure)?;
                self.events.on(Event::PointFailed { label: &label, reason: &failure.reason });
            }
        }
        Ok(outcome.map(|_| ()).map_err(|_| ()))
    }

    /// A scheduler whose turns are shorter than the evaluation would run it from its first view again and again. None where
    /// this turn had more to do, or a person stopped it.
    fn evaluation_too_long(&self, folder: &PointFolder, claim: &Claim) -> Result<Option<Failure>> {
        if self.options.sharing == Sharing::Locks || !claim.progress.only_evaluates() {
            return Ok(None);
        }
        let stops = folder.count_stop()?;
        Ok((stops >= MOST_SHORT_TURNS).then(|| Failure {
            reason: format!(
                "the training is done, and {stops} turns were stopped before its evaluation was: give a turn more time \
                 (sweep submit --time) and try again with --retry-failed"
            ),
            exit_code: Class::Internal.exit_code(),
        }))
    }

    fn say_what_begins(&self, point: &Point, label: &str, pace: &Mutex<Pace>) {
        let open = |point: &&Point| !self.folder.point(&point.id).ended();
        let ended = self.points.len() - self.points.iter().filter(open).count();
        let left = self.points.iter().filter(|point| point.no_data.is_none()).filter(open);
        let pace = *pace.lock().unwrap_or_else(PoisonError::into_inner);
        let seconds_left = pace.seconds_of(left).map(|seconds| seconds / self.options.jobs as f64);
        let (points, steps) = (self.points.len(), point.config.train.steps);
        self.events.on(Event::PointStarted { label, ended, points, steps, seconds_left });
    }

    /// A panic is a defect of this program; it fails its point and no other.
    fn work(&self, point: &Point, folder: &PointFolder, runtime: &Runtime, claim: &Claim) -> Result<PointResult> {
        let run = std::panic::AssertUnwindSafe(|| self.work.run(point, folder, runtime, &claim.progress, self.stop));
        std::panic::catch_unwind(run).unwrap_or_else(|panic| {
            let text = panic.downcast_ref::<String>().map(String::as_str).or(panic.downcast_ref::<&str>().copied());
            Err(Error::Tensor(candle_core::Error::Msg(format!("panic: {}", text.unwrap_or("without words")))))
        })
    }
}
