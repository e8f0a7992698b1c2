//! The one channel by which long work tells how it goes.
//!
//! The library prints nothing. Whoever wants to show something hands a [`Listener`] in; `&()` listens to nothing.

/// Something that happened during long work.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event<'a> {
    /// A sentence worth reading.
    Note(&'a str),
    /// A stretch of `parts` equal parts begins: pictures to read, views to render, planes to query.
    Started {
        /// What is done, as in "reading images".
        what: &'a str,
        /// How many parts it has.
        parts: u64,
    },
    /// One part of the stretch is done. Several threads send it, in any order.
    Advanced,
    /// The stretch is over, or was given up.
    Finished,
    /// Training begins, or goes on.
    TrainingStarted {
        /// Steps finished before: 0, or those of the checkpoint.
        first: u64,
        /// Steps of the whole training.
        steps: u64,
        /// Rays of a step.
        rays: usize,
    },
    /// A training step is done; sent for every step.
    Stepped {
        /// Steps finished, this one included.
        step: u64,
        /// What was minimised.
        loss: f64,
        /// PSNR of the step's rays in dB; none where their error is 0.
        psnr: Option<f64>,
    },
    /// No more steps follow in this session: the last was taken, a signal came, or an error.
    TrainingFinished,
    /// A point of a sweep is begun.
    PointStarted {
        /// Its row, scene, axes and seed in words.
        label: &'a str,
        /// Points that are done or failed by now.
        ended: usize,
        /// Points of the sweep.
        points: usize,
        /// Steps that it trains.
        steps: u64,
        /// Seconds until the whole sweep is done, by what its points took so far; none before the first one is done.
        seconds_left: Option<f64>,
    },
    /// A point of a sweep is measured.
    PointFinished {
        /// As when it was begun.
        label: &'a str,
        /// Mean PSNR of the held-out views in dB.
        psnr: Option<f64>,
    },
    /// A point of a sweep ended without a result.
    PointFailed {
        /// As when it was begun.
        label: &'a str,
        /// The error's words.
        reason: &'a str,
    },
}

/// Who is told what happens. Events come from whichever thread works.
pub trait Listener: Sync {
    /// Hears of one event.
    fn on(&self, event: Event<'_>);
}

/// Listens to nothing.
impl Listener for () {
    fn on(&self, _event: Event<'_>) {}
}
