//! Runs the points of a sweep: alone or next to other workers on the same folder, from wherever an
//! earlier one was stopped or killed.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use crate::base::{Error, Event, INTERNAL, Listener, Result};
use crate::metrics::PSNR;
use crate::report::PointResult;
use crate::run::RunDir;
use crate::runtime::Runtime;

use super::claim::{Claim, Progress, Sharing, is_taken};
use super::folder::SweepFolder;
use super::pace::{Pace, spent};
use super::point_folder::{Failure, PointFolder};
use super::points::Point;
use super::worker;

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

/// A finished point that could not be measured again. It keeps its earlier result.
#[derive(Clone, Debug, PartialEq)]
pub struct Unmeasured {
    /// The point's row, scene, axes and seed in words.
    pub label: String,
    /// Why.
    pub failure: Failure,
}

/// What the jobs of a runner share.
struct Shared {
    /// Points to be done again, with the time at which they ended.
    again: Mutex<HashMap<String, SystemTime>>,
    unmeasured: Mutex<Vec<Unmeasured>>,
    pace: Mutex<Pace>,
    /// For whom is waited, as it was said last.
    said: Mutex<Vec<String>>,
}

impl Shared {
    /// Whether the point has not ended, or is to be done again and no worker has done so yet.
    fn is_to_do(&self, point: &Point, folder: &PointFolder) -> bool {
        let at = folder.finished_at().or(folder.failed_at());
        !folder.ended() || at.is_some() && lock(&self.again).get(&point.id) == at.as_ref()
    }

    /// Keeps why a finished point was not measured again.
    fn give_up(&self, label: &str, failure: &Failure) {
        lock(&self.unmeasured).push(Unmeasured { label: label.into(), failure: failure.clone() });
    }
}

/// What a lock guards is whole after a panic, too.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
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
    /// one of the whole sweep (a full disk, a signal); failed points are in the folder. Returns the finished points that
    /// could not be measured again.
    pub fn run(&self) -> Result<Vec<Unmeasured>> {
        worker::begun(self.folder);
        let ran = self.run_all();
        let reason = ran.as_ref().err().map_or(String::new(), ToString::to_string);
        worker::ended(self.folder, &reason);
        ran
    }

    fn run_all(&self) -> Result<Vec<Unmeasured>> {
        let runnable: Vec<&Point> = self.points.iter().filter(|point| point.no_data.is_none()).collect();
        for point in &runnable {
            let folder = self.folder.point(&point.id);
            folder.begin(point)?;
            folder.clean_up(self.options.sharing)?;
        }
        let shared = Shared {
            again: Mutex::new(self.to_do_again(&runnable)?),
            unmeasured: Mutex::default(),
            pace: Mutex::new(Pace::of(self.folder, &runnable)),
            said: Mutex::default(),
        };
        let failed = AtomicBool::new(false);
        let worker = || -> Result<()> {
            let runtime = self.runtime.share(self.options.jobs)?;
            loop {
                if failed.load(Ordering::SeqCst) && self.options.fail_fast {
                    return Ok(());
                }
                match self.next(&runnable, &shared)? {
                    Next::Nothing => return Ok(()),
                    Next::Wait(others) => {
                        self.say_who_works(others, &shared);
                        std::thread::sleep(LOOK_EVERY);
                    }
                    Next::Run(point, folder, claim) => {
                        match runtime.install(|| self.run_point(point, &folder, &runtime, claim, &shared)) {
                            // Another process took the run after the look at it.
                            Err(Error::InUse(_)) if self.options.sharing == Sharing::Locks => {
                                std::thread::sleep(LOOK_EVERY);
                            }
                            ended => _ = failed.fetch_or(ended?.is_err(), Ordering::SeqCst),
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
            ended.into_iter().collect::<Result<()>>()
        })?;
        Ok(std::mem::take(&mut *lock(&shared.unmeasured)))
    }

    /// The points to be done again, with the time at which they ended: failures and gaps that are there now, and no
    /// later ones. A gap can stay: not every scene has every metric.
    fn to_do_again(&self, points: &[&Point]) -> Result<HashMap<String, SystemTime>> {
        let mut again = HashMap::new();
        for point in points {
            let folder = self.folder.point(&point.id);
            let ended = match (folder.finished_at(), folder.failed_at()) {
                (Some(at), _) if folder.lacks(&self.options.remeasure)? => Some(at),
                (None, Some(at)) if self.options.retry_failed => Some(at),
                _ => None,
            };
            again.extend(ended.map(|at| (point.id.clone(), at)));
        }
        Ok(again)
    }

    /// Says for whom is waited, when that changes.
    fn say_who_works(&self, others: Vec<String>, shared: &Shared) {
        let mut said = lock(&shared.said);
        if *said != others {
            let who = others.join(", ");
            self.events.on(Event::Note(&format!("waiting for points that others work on: {who}")));
            *said = others;
        }
    }

    fn next<'a>(&self, points: &[&'a Point], shared: &Shared) -> Result<Next<'a>> {
        let mut others = Vec::new();
        for point in points {
            self.check_stop()?;
            let folder = self.folder.point(&point.id);
            if !shared.is_to_do(point, &folder) {
                continue;
            }
            // A task of a scheduler has no other point: it ends with the lock's error, and makes room for the next task.
            if self.options.sharing == Sharing::Locks
                && let Some(user) = user_of_run(&folder)
            {
                others.push(user);
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
            if shared.is_to_do(point, &folder) {
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
                    "stopped by signal {signal}; nothing is lost: the same command continues {}",
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
        shared: &Shared,
    ) -> Result<std::result::Result<(), ()>> {
        let begun = Instant::now();
        let label = point.label();
        self.say_what_begins(point, &label, shared);
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
            // A full disk is no point's fault, and every other one's as well. A run in use is no fault at all.
            Err(error @ (Error::Output(_) | Error::InUse(_))) => return Err(error),
            Err(error) => Err(Failure { reason: error.to_string(), exit_code: error.exit_code() }),
        };
        // Once a runner, whatever came of it.
        lock(&shared.again).remove(&point.id);
        match &outcome {
            Ok(result) => {
                folder.finish(result)?;
                let seconds = spent(folder).unwrap_or_else(|| begun.elapsed().as_secs_f64());
                lock(&shared.pace).add(point, seconds);
                self.events.on(Event::PointFinished { label: &label, psnr: result.metric(PSNR.key) });
            }
            Err(failure) => {
                match folder.finished_at() {
                    // It is done all the same.
                    Some(_) => shared.give_up(&label, failure),
                    None => folder.fail(failure)?,
                }
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
                 (sbatch --time) and try again with --retry-failed"
            ),
            exit_code: INTERNAL,
        }))
    }

    fn say_what_begins(&self, point: &Point, label: &str, shared: &Shared) {
        let is_to_do = |point: &&Point| shared.is_to_do(point, &self.folder.point(&point.id));
        let ended = self.points.len() - self.points.iter().filter(is_to_do).count();
        let is_left = |point: &&Point| point.no_data.is_none() && !self.folder.point(&point.id).ended();
        let pace = *lock(&shared.pace);
        let seconds_left = pace.seconds_of(self.points.iter().filter(is_left)).filter(|seconds| *seconds > 0.0);
        let seconds_left = seconds_left.map(|seconds| seconds / self.options.jobs as f64);
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

/// Names the process that has the run of a point without a worker, such as `augnerf eval`.
fn user_of_run(folder: &PointFolder) -> Option<String> {
    // The look locks a free run for a moment, in which no worker should want it.
    if is_taken(folder.path()) {
        return None;
    }
    let run = folder.run();
    RunDir::holder(&run).map(|holder| format!("{holder} (in {})", run.display()))
}
