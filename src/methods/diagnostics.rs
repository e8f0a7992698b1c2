//! Do the deltas do anything? Measured per site at log steps, forward passes only.

use std::path::Path;

use serde::Serialize;

use crate::augment::Site;
use crate::base::{Error, Result};

/// A site whose gain is under this share of the clean loss is inactive.
const INACTIVE_SHARE: f64 = 1e-4;

/// What one site's deltas did in one step, coarse + fine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SiteDiagnostics {
    /// The site.
    pub site: Site,
    /// Loss with this site's deltas alone, minus the loss without any.
    pub gain: f64,
    /// The same minus the loss with uniform random deltas of the same set.
    pub gain_over_random: f64,
    /// Share of entries at the set's bound, mean of the passes; none where nothing may move.
    pub share_at_bound: Option<f64>,
    /// The gain is under 1e-4 of the clean loss.
    pub inactive: bool,
}

impl SiteDiagnostics {
    /// The numbers by their columns, missing ones left out.
    pub fn columns(&self) -> Vec<(String, f64)> {
        let inactive = f64::from(u8::from(self.inactive));
        let numbers = [Some(self.gain), Some(self.gain_over_random), self.share_at_bound, Some(inactive)];
        let named = columns(self.site).into_iter().zip(numbers);
        named.filter_map(|(name, number)| number.map(|number| (name, number))).collect()
    }
}

/// What a site's deltas did over all logged steps of a run, read back from `scalars.csv`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SiteSummary {
    /// The site's name.
    #[serde(rename = "level")]
    pub site: &'static str,
    /// Logged steps.
    pub steps: usize,
    /// Mean gain over the loss without deltas.
    pub mean_gain: f64,
    /// Mean gain over random deltas of the same set.
    pub mean_gain_over_random: f64,
    /// Mean share of entries at the set's bound; none where nothing may move.
    pub mean_share_at_bound: Option<f64>,
    /// Share of logged steps at which the site was inactive.
    pub inactive_share: f64,
    /// Inactive at more than half of the logged steps: the row does not test this site.
    pub inactive: bool,
}

/// The columns of `scalars.csv` that hold one site's diagnostics.
pub fn columns(site: Site) -> [String; 4] {
    ["gain", "gain_over_random", "share_at_bound", "inactive"].map(|what| format!("{what}.{}", site.name()))
}

impl SiteSummary {
    /// Summarises every site that has diagnostics in a run's `scalars.csv`, up to the step of the
    /// checkpoint in question: a killed run may have logged further, and half a line at the end.
    pub fn read(scalars: &Path, last_step: u64) -> Result<Vec<SiteSummary>> {
        let broken = |error: csv::Error| Error::Checkpoint(format!("cannot read {}: {error}", scalars.display()));
        let text = std::fs::read_to_string(scalars).map_err(|error| broken(error.into()))?;
        let whole = text.rfind('\n').map_or("", |end| &text[..end]);
        let mut reader = csv::Reader::from_reader(whole.as_bytes());
        let header = reader.headers().map_err(broken)?.clone();
        let mut rows = reader.records().collect::<std::result::Result<Vec<_>, _>>().map_err(broken)?;
        rows.retain(|row| row.get(0).and_then(|step| step.parse::<u64>().ok()).is_some_and(|step| step <= last_step));
        let column = |name: &str| -> Vec<f64> {
            let Some(index) = header.iter().position(|found| found == name) else { return Vec::new() };
            rows.iter().filter_map(|row| row.get(index).and_then(|cell| cell.parse().ok())).collect()
        };
        let summarise = |site: Site| {
            let values = columns(site).map(|name| column(&name));
            let steps = values[0].len();
            if steps == 0 {
                return None;
            }
            let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
            let inactive_share = mean(&values[3]);
            Some(SiteSummary {
                site: site.name(),
                steps,
                mean_gain: mean(&values[0]),
                mean_gain_over_random: mean(&values[1]),
                mean_share_at_bound: (!values[2].is_empty()).then(|| mean(&values[2])),
                inactive_share,
                inactive: inactive_share > 0.5,
            })
        };
        Ok(Site::ALL.into_iter().filter_map(summarise).collect())
    }
}

/// Sums over chunks and passes.
#[derive(Default)]
pub(super) struct Sums(Vec<SiteSums>);

struct SiteSums {
    site: Site,
    gain: f64,
    gain_over_random: f64,
    at_bound: f64,
    /// Shares of chunks that `at_bound` counts.
    bounded: f64,
}

impl Sums {
    pub(super) fn add(&mut self, site: Site, share: f64, gain: f64, gain_over_random: f64, at_bound: Option<f64>) {
        let index = self.index(site);
        let sums = &mut self.0[index];
        sums.gain += share * gain;
        sums.gain_over_random += share * gain_over_random;
        if let Some(at_bound) = at_bound {
            sums.at_bound += share * at_bound;
            sums.bounded += share;
        }
    }

    pub(super) fn merge(&mut self, other: Sums) {
        for sums in other.0 {
            let index = self.index(sums.site);
            let mine = &mut self.0[index];
            mine.gain += sums.gain;
            mine.gain_over_random += sums.gain_over_random;
            mine.at_bound += sums.at_bound;
            mine.bounded += sums.bounded;
        }
    }

    fn index(&mut self, site: Site) -> usize {
        self.0.iter().position(|sums| sums.site == site).unwrap_or_else(|| {
            self.0.push(SiteSums { site, gain: 0.0, gain_over_random: 0.0, at_bound: 0.0, bounded: 0.0 });
            self.0.len() - 1
        })
    }

    pub(super) fn finish(self, clean_loss: f64) -> Vec<SiteDiagnostics> {
        let finish = |sums: SiteSums| SiteDiagnostics {
            site: sums.site,
            gain: sums.gain,
            gain_over_random: sums.gain_over_random,
            share_at_bound: (sums.bounded > 0.0).then(|| sums.at_bound / sums.bounded),
            inactive: sums.gain < INACTIVE_SHARE * clean_loss,
        };
        self.0.into_iter().map(finish).collect()
    }
}
