//! How long the rest of a sweep takes, by what its points took so far.

use crate::base::files::read_json;
use crate::runtime::Timing;

use super::budget::evaluations_per_step;
use super::folder::SweepFolder;
use super::point_folder::PointFolder;
use super::points::Point;

/// Seconds that points took, by their network evaluations: points of one sweep differ many times in cost.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pace {
    seconds: f64,
    evaluations: f64,
}

impl Pace {
    /// That of the points that are done, whoever trained them.
    pub fn of(folder: &SweepFolder, points: &[&Point]) -> Pace {
        let mut pace = Pace::default();
        for point in points {
            let folder = folder.point(&point.id);
            if folder.finished_at().is_some()
                && let Some(seconds) = spent(&folder)
            {
                pace.add(point, seconds);
            }
        }
        pace
    }

    /// A point is done that took so many seconds.
    pub fn add(&mut self, point: &Point, seconds: f64) {
        self.seconds += seconds;
        self.evaluations += evaluations(point);
    }

    /// Seconds of points, one after the other; none before one is done.
    pub fn seconds_of<'a>(&self, points: impl Iterator<Item = &'a Point>) -> Option<f64> {
        let rate = Some(self.seconds / self.evaluations).filter(|rate| rate.is_finite() && *rate > 0.0)?;
        Some(points.map(evaluations).sum::<f64>() * rate)
    }
}

/// Seconds of training and evaluation, as the run says; none where it does not.
pub fn spent(folder: &PointFolder) -> Option<f64> {
    let timing: Timing = read_json(&folder.run().join("timing.json"), "").ok()??;
    Some(timing.seconds_training + timing.seconds_evaluation)
}

fn evaluations(point: &Point) -> f64 {
    evaluations_per_step(&point.config) * point.config.train.steps as f64
}
