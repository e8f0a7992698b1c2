//! Whose turn it is to compute: one at a time, since two at once would each take twice as long.

use std::collections::BTreeSet;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::base::Result;

/// How often one who waits looks whether there is still a reason to.
const PAUSE: Duration = Duration::from_millis(50);

/// Who comes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rank {
    /// A picture that was made small to be quick, or a ray.
    Quick,
    /// Empty space, which sharp pictures then leave out.
    EmptySpace,
    /// A picture that takes as long as it takes.
    Sharp,
}

/// A queue, in the order of ranks and then of arrival.
#[derive(Default)]
pub struct Queue {
    line: Mutex<Line>,
    moved: Condvar,
    /// A clone is held for each work.
    works: Arc<()>,
}

#[derive(Default)]
struct Line {
    is_busy: bool,
    arrived: u64,
    waiting: BTreeSet<(Rank, u64)>,
}

impl Queue {
    fn line(&self) -> MutexGuard<'_, Line> {
        self.line.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the number of works that have a place and are not at their end.
    pub fn unfinished(&self) -> usize {
        Arc::strong_count(&self.works) - 1
    }

    /// Waits for a turn.
    ///
    /// # Errors
    /// Those of `check`, which is asked now and then.
    fn take(&self, rank: Rank, check: &dyn Fn() -> Result<()>) -> Result<()> {
        let mut line = self.line();
        let own = (rank, line.arrived);
        line.arrived += 1;
        line.waiting.insert(own);
        loop {
            let checked = check();
            let is_next = !line.is_busy && line.waiting.first() == Some(&own);
            if checked.is_err() || is_next {
                line.waiting.remove(&own);
                line.is_busy |= checked.is_ok();
                self.moved.notify_all();
                return checked;
            }
            line = self.moved.wait_timeout(line, PAUSE).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

/// Work in parts, each of which has its own turn, so that who comes first need not wait for all of them.
pub struct Work<'a> {
    queue: &'a Queue,
    rank: Rank,
    check: &'a dyn Fn() -> Result<()>,
    /// When the part began that has its turn.
    since: Option<Instant>,
    spent: Duration,
    _unfinished: Arc<()>,
}

impl<'a> Work<'a> {
    /// Creates work without a turn. `check` gives it up by an error.
    pub fn new(queue: &'a Queue, rank: Rank, check: &'a dyn Fn() -> Result<()>) -> Work<'a> {
        Work { queue, rank, check, since: None, spent: Duration::ZERO, _unfinished: queue.works.clone() }
    }

    /// Ends the part before, if there is one, and waits for the turn of the next.
    ///
    /// # Errors
    /// Those of the check.
    pub fn next(&mut self) -> Result<()> {
        self.end();
        self.queue.take(self.rank, self.check)?;
        self.since = Some(Instant::now());
        Ok(())
    }

    /// Ends the last part. Returns the time of all parts, without the waits.
    pub fn end(&mut self) -> Duration {
        if let Some(since) = self.since.take() {
            self.spent += since.elapsed();
            self.queue.line().is_busy = false;
            self.queue.moved.notify_all();
        }
        self.spent
    }
}

impl Drop for Work<'_> {
    fn drop(&mut self) {
        self.end();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Error;

    #[test]
    fn ranks_come_in_their_order_and_who_gives_up_holds_up_nobody() {
        let queue = Queue::default();
        let order = Mutex::new(Vec::new());
        let go_on = || Ok(());
        let mut first = Work::new(&queue, Rank::Sharp, &go_on);
        first.next().unwrap();
        first.next().unwrap();
        std::thread::scope(|scope| {
            for (arrived, rank) in [Rank::Sharp, Rank::EmptySpace, Rank::Quick, Rank::Quick].into_iter().enumerate() {
                let (queue, order) = (&queue, &order);
                scope.spawn(move || {
                    let mut work = Work::new(queue, rank, &go_on);
                    work.next().unwrap();
                    order.lock().unwrap().push((rank, arrived));
                });
                while queue.line().waiting.len() <= arrived {
                    std::thread::yield_now();
                }
            }
            let gives_up = || Err(Error::Config("over".into()));
            assert!(Work::new(&queue, Rank::Quick, &gives_up).next().is_err());
            assert_eq!((queue.line().waiting.len(), queue.unfinished()), (4, 5));
            drop(first);
        });
        let order: Vec<_> = order.into_inner().unwrap();
        assert_eq!(order, [(Rank::Quick, 2), (Rank::Quick, 3), (Rank::EmptySpace, 1), (Rank::Sharp, 0)]);
        assert!(!queue.line().is_busy && queue.unfinished() == 0);
    }
}
