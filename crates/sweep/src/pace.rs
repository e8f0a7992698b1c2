//! Estimates the remaining time of a sweep from the points that are done.

use crate::base::files::read_json;
use crate::runtime::Timing;

use super::budget::evaluations_per_step;
use super::folder::SweepFolder;
use super::point_folder::PointFolder;
use super::points::Point;

/// Seconds that points took, by their network evaluations, since the costs of a sweep's points differ many times.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pace {
    seconds: f64,
    evaluations: f64,
}

impl Pace {
    /// Reads the points that are done, of any worker.
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

    /// Adds a point that took `seconds`.
    pub fn add(&mut self, point: &Point, seconds: f64) {
        self.seconds += seconds;
        self.evaluations += evaluations(point);
    }

    /// Returns the seconds of points, one after the other, or `None` before any point is done.
    pub fn seconds_of<'a>(&self, points: impl Iterator<Item = &'a Point>) -> Option<f64> {
        let rate = Some(self.seconds / self.evaluations).filter(|rate| rate.is_finite() && *rate > 0.0)?;
        Some(points.map(evaluations).sum::<f64>() * rate)
    }
}

/// Returns the seconds of training and evaluation from the run's files, or `None` if they are missing.
pub fn spent(folder: &PointFolder) -> Option<f64> {
    let timing: Timing = read_json(&folder.run().join("timing.json"), "").ok()??;
    Some(timing.seconds_training + timing.seconds_evaluation)
}

fn evaluations(point: &Point) -> f64 {
    evaluations_per_step(&point.config) * point.config.train.steps as f64
}
