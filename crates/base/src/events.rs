//! The channel through which long work reports its progress.
//!
//! The library prints nothing. To show progress, pass a [`Listener`]; `&()` ignores all events.

/// Something that happened during long work.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event<'a> {
    /// A sentence to read.
    Note(&'a str),
    /// A stage of `parts` equal parts begins: images to read, views to render, planes to query.
    Started {
        /// What is being done, as in "reading photos".
        what: &'a str,
        /// Number of parts.
        parts: u64,
    },
    /// One part of the stage is done. Several threads send it, in any order.
    Advanced,
    /// The stage is over, or was abandoned.
    Finished,
    /// Training begins or resumes.
    TrainingStarted {
        /// Steps that were finished before: 0, or those of the checkpoint.
        first: u64,
        /// Steps of the complete training.
        steps: u64,
        /// Rays per step.
        rays: usize,
    },
    /// Training steps are done. It is sent for every step, on a GPU once for several, with the last one's numbers.
    Stepped {
        /// Finished steps, including this one.
        step: u64,
        /// The training loss.
        loss: f64,
        /// PSNR of the step's rays in dB. `None` if their error is 0.
        psnr: Option<f64>,
    },
    /// No more steps follow in this session: the last step is done, a signal arrived, or an error occurred.
    TrainingFinished,
    /// A point of a sweep begins.
    PointStarted {
        /// Its row, scene, axes and seed in words.
        label: &'a str,
        /// Number of points that are done or failed so far, without those that will be done again.
        ended: usize,
        /// Number of points in the sweep.
        points: usize,
        /// Number of its training steps.
        steps: u64,
        /// Estimated seconds of the remaining trainings, from the points so far. `None` before the first one is done, and
        /// if only finished points are measured again.
        seconds_left: Option<f64>,
    },
    /// A point of a sweep is measured.
    PointFinished {
        /// The label at its start.
        label: &'a str,
        /// Mean PSNR of the held-out views in dB.
        psnr: Option<f64>,
    },
    /// A point of a sweep ended without a result.
    PointFailed {
        /// The label at its start.
        label: &'a str,
        /// The error's message.
        reason: &'a str,
    },
}

/// A receiver of events. They come from any working thread.
pub trait Listener: Sync {
    /// Receives one event.
    fn on(&self, event: Event<'_>);
}

/// A closure receives the events.
impl<F: Fn(Event<'_>) + Sync> Listener for F {
    fn on(&self, event: Event<'_>) {
        self(event);
    }
}

/// Ignores all events.
impl Listener for () {
    fn on(&self, _event: Event<'_>) {}
}
