//! Diagnostics of the deltas' effect: measured per site at log steps, with forward passes only.

use std::path::Path;

use candle_core::{DType, Tensor};
use serde::Serialize;

use crate::base::input::{TABLE_BYTES, read_text};
use crate::base::{Error, Result};
use crate::perturb::PaperSite;
use crate::settings::columns::{InactiveBy, LEAST_SHIFT};

/// A site whose gain is below this fraction of the clean loss is inactive in a step.
const INACTIVE_SHARE: f64 = 1e-4;
/// Number of last log steps whose mean shift decides whether a site is inactive in a run.
const LAST_LOGS: usize = 10;

/// Number of steps of an 8-bit colour between 0 and 1.
const EIGHT_BIT: f64 = 255.0;

/// Returns the mean absolute difference between colours of the same rays, in 8-bit steps.
pub fn colour_shift(moved: &Tensor, unmoved: &Tensor) -> Result<f64> {
    Ok(EIGHT_BIT * (moved - unmoved)?.abs()?.mean_all()?.to_dtype(DType::F64)?.to_scalar::<f64>()?)
}

/// The effect of one site's deltas in one step, coarse + fine.
#[derive(Clone, Debug, PartialEq)]
pub struct SiteDiagnostics {
    /// The site's name.
    pub site: String,
    /// Loss with this site's deltas only, minus the loss without deltas.
    pub gain: f64,
    /// The same minus the loss with uniform random deltas of the same constraint set.
    pub gain_over_random: f64,
    /// Fraction of entries at the set's bound, as a mean over the passes. `None` if nothing may move.
    pub share_at_bound: Option<f64>,
    /// The gain is below 1e-4 of the clean loss.
    pub inactive: bool,
    /// Mean absolute change of the rays' colours through this site's deltas only, in 8-bit steps. It is a mean over the
    /// passes with this site.
    pub shift: f64,
}

impl SiteDiagnostics {
    /// Returns the diagnostics of a site from its gain, its gain over random deltas and its shift, in this order, in a step
    /// with this clean loss.
    pub fn new(
        site: &str,
        [gain, gain_over_random, shift]: [f64; 3],
        share_at_bound: Option<f64>,
        clean_loss: f64,
    ) -> SiteDiagnostics {
        let inactive = gain < INACTIVE_SHARE * clean_loss;
        SiteDiagnostics { site: site.to_string(), gain, gain_over_random, share_at_bound, inactive, shift }
    }

    /// Returns the numbers by their columns, without missing ones.
    pub fn columns(&self) -> Vec<(String, f64)> {
        let inactive = f64::from(u8::from(self.inactive));
        let numbers =
            [Some(self.gain), Some(self.gain_over_random), self.share_at_bound, Some(inactive), Some(self.shift)];
        let named = site_columns(&self.site).into_iter().zip(numbers);
        named.filter_map(|(name, number)| number.map(|number| (name, number))).collect()
    }
}

/// The effect of a site's deltas over all logged steps of a run, read from `scalars.csv`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SiteSummary {
    /// The site's name.
    #[serde(rename = "level")]
    pub site: String,
    /// Number of logged steps.
    pub steps: usize,
    /// Mean gain over the loss without deltas.
    pub mean_gain: f64,
    /// Mean gain over random deltas of the same constraint set.
    pub mean_gain_over_random: f64,
    /// Mean fraction of entries at the set's bound. `None` if nothing may move.
    pub mean_share_at_bound: Option<f64>,
    /// Fraction of logged steps with a gain below 1e-4 of the clean loss.
    pub inactive_share: f64,
    /// The deltas move the rendered colours by less than half an 8-bit step on average over the last log steps. For a
    /// run that logged no shift: the site was inactive at more than half of the logged steps.
    pub inactive: bool,
    /// Mean shift of the rendered colour over the last log steps, in 8-bit steps. `None` if it was not logged.
    pub last_shift: Option<f64>,
}

/// Returns the columns of `scalars.csv` with one site's diagnostics.
pub fn site_columns(site: &str) -> [String; 5] {
    ["gain", "gain_over_random", "share_at_bound", "inactive", "shift"].map(|what| format!("{what}.{site}"))
}

/// Returns the names of the sites whose diagnostics a log has: the built-in ones in their order, then others in the log's.
pub fn logged_sites<'a>(header: impl Iterator<Item = &'a str>) -> Vec<String> {
    // A gain alone is not a site's: sharpness-aware steps log that of weights.
    let mut names: Vec<String> =
        header.filter_map(|column| column.strip_prefix("inactive.")).map(str::to_string).collect();
    let order = |name: &String| PaperSite::of_name(name).map_or(PaperSite::ALL.len(), |site| site as usize);
    names.sort_by_key(order);
    names
}

impl SiteSummary {
    /// Returns the criterion of `inactive`.
    pub fn inactive_by(&self) -> InactiveBy {
        if self.last_shift.is_some() { InactiveBy::Colour } else { InactiveBy::Loss }
    }

    /// Summarizes every site that has diagnostics in a run's `scalars.csv`, up to the step of the checkpoint. A killed
    /// run may have logged further, with half a line at the end.
    pub fn read(scalars: &Path, last_step: u64) -> Result<Vec<SiteSummary>> {
        let broken = |error: csv::Error| Error::Checkpoint(format!("cannot read {}: {error}", scalars.display()));
        let text = read_text(scalars, TABLE_BYTES).map_err(|error| broken(error.into()))?;
        let complete_lines = text.rfind('\n').map_or("", |end| &text[..end]);
        let mut reader = csv::Reader::from_reader(complete_lines.as_bytes());
        let header = reader.headers().map_err(broken)?.clone();
        // Only these columns, since a log may be long.
        let sites = logged_sites(header.iter());
        let names = sites.iter().flat_map(|site| site_columns(site));
        let indices = names.filter_map(|name| Some((header.iter().position(|column| column == name)?, name)));
        let mut logged: Vec<(usize, String, Vec<f64>)> =
            indices.map(|(index, name)| (index, name, Vec::new())).collect();
        for row in reader.records() {
            let row = row.map_err(broken)?;
            if row.get(0).and_then(|step| step.parse::<u64>().ok()).is_some_and(|step| step <= last_step) {
                let number = |index: usize| row.get(index).and_then(|cell| cell.parse::<f64>().ok());
                logged.iter_mut().for_each(|(index, _, values)| values.extend(number(*index)));
            }
        }
        let column = |name: &str| {
            let column = logged.iter().find(|(_, column, _)| column == name);
            column.map(|(.., values)| values.clone()).unwrap_or_default()
        };
        Ok(SiteSummary::of_columns(&sites, column))
    }

    /// Summarizes the numbers that a run logged of `sites` in each column, in the order of steps.
    pub fn of_columns(sites: &[String], column: impl Fn(&str) -> Vec<f64>) -> Vec<SiteSummary> {
        let summarize = |site: &String| {
            let values = site_columns(site).map(|name| column(&name));
            let steps = values[0].len();
            if steps == 0 {
                return None;
            }
            let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
            let inactive_share = mean(&values[3]);
            let last = &values[4][values[4].len().saturating_sub(LAST_LOGS)..];
            let last_shift = (!last.is_empty()).then(|| mean(last));
            Some(SiteSummary {
                site: site.clone(),
                steps,
                mean_gain: mean(&values[0]),
                mean_gain_over_random: mean(&values[1]),
                mean_share_at_bound: (!values[2].is_empty()).then(|| mean(&values[2])),
                inactive_share,
                inactive: last_shift.map_or(inactive_share > 0.5, |shift| shift < LEAST_SHIFT),
                last_shift,
            })
        };
        sites.iter().filter_map(summarize).collect()
    }
}

/// The effect of one site's deltas in one pass of one chunk.
#[derive(Clone, Copy, Default)]
pub(super) struct SiteEffect {
    /// The chunk's fraction of the step's rays.
    pub(super) fraction: f64,
    pub(super) gain: f64,
    pub(super) gain_over_random: f64,
    /// Mean absolute change of the rays' colours, in 8-bit steps.
    pub(super) shift: f64,
    pub(super) at_bound: Option<f64>,
}

/// Sums over chunks and passes, by site: of gain, gain over random, shift, share at the bound, and of the fractions behind
/// the last two.
#[derive(Default)]
pub(super) struct SiteSums(Vec<(String, [f64; 6])>);

impl SiteSums {
    pub(super) fn add(&mut self, site: &str, effect: SiteEffect) {
        let SiteEffect { fraction, gain, gain_over_random, shift, at_bound } = effect;
        let bounded = if at_bound.is_some() { fraction } else { 0.0 };
        let weighted = [gain, gain_over_random, shift, at_bound.unwrap_or(0.0)].map(|number| fraction * number);
        self.add_sums(site, &[&weighted[..], &[fraction, bounded]].concat());
    }

    pub(super) fn merge(&mut self, other: SiteSums) {
        other.0.iter().for_each(|(site, sums)| self.add_sums(site, sums));
    }

    fn add_sums(&mut self, site: &str, sums: &[f64]) {
        let index = self.0.iter().position(|(name, _)| name == site).unwrap_or_else(|| {
            self.0.push((site.to_string(), [0.0; 6]));
            self.0.len() - 1
        });
        self.0[index].1.iter_mut().zip(sums).for_each(|(sum, value)| *sum += value);
    }

    pub(super) fn finish(self, clean_loss: f64) -> Vec<SiteDiagnostics> {
        let finish = |(site, [gain, gain_over_random, shift, at_bound, passes, bounded]): (String, [f64; 6])| {
            let share_at_bound = (bounded > 0.0).then(|| at_bound / bounded);
            SiteDiagnostics::new(&site, [gain, gain_over_random, shift / passes], share_at_bound, clean_loss)
        };
        self.0.into_iter().map(finish).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn summary(text: &str, last_step: u64) -> SiteSummary {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        SiteSummary::read(file.path(), last_step).unwrap().remove(0)
    }

    /// The gain of a colour's deltas is a share of a loss that falls: it rose over 1e-4 late in runs whose colours never moved
    /// by more than 1/400 of an 8-bit step.
    #[test]
    fn a_site_is_inactive_where_its_last_logs_move_no_colour_whatever_the_loss_does() {
        let header = "step,gain.rgb,gain_over_random.rgb,share_at_bound.rgb,inactive.rgb,shift.rgb\n";
        let rows = |inactive: fn(u64) -> u8, shift: fn(u64) -> f64| -> String {
            (1..=30).map(|step| format!("{step},1e-6,1e-6,1,{},{}\n", inactive(step), shift(step))).collect()
        };
        let still = summary(&(header.to_string() + &rows(|_| 0, |_| 0.0025)), 30);
        assert!(still.inactive && still.inactive_share == 0.0, "{still:?}");
        // It moved colours at first: what counts is how the run ended.
        let late = header.to_string() + &rows(|_| 1, |step| if step <= 20 { 0.0 } else { 2.0 });
        let active = summary(&late, 30);
        assert!(!active.inactive && active.last_shift == Some(2.0), "{active:?}");
        assert_eq!(summary(&late, 25).last_shift, Some(1.0));
        let edge = summary(&(header.to_string() + &rows(|_| 1, |_| 0.5)), 30);
        assert!(!edge.inactive, "{edge:?}");
    }

    #[test]
    fn a_run_that_logged_no_shift_keeps_what_its_logs_said() {
        let header = "step,gain.rgb,gain_over_random.rgb,share_at_bound.rgb,inactive.rgb\n";
        let old = |inactive: [u8; 3]| -> SiteSummary {
            let rows: String = (1..=3).zip(inactive).map(|(step, flag)| format!("{step},1,1,1,{flag}\n")).collect();
            summary(&(header.to_string() + &rows), 3)
        };
        assert!(old([1, 1, 0]).inactive && !old([1, 0, 0]).inactive);
        assert_eq!((old([1, 1, 0]).last_shift, old([1, 1, 0]).inactive_by()), (None, InactiveBy::Loss));
        let header = header.replace('\n', ",shift.rgb\n");
        assert_eq!(summary(&(header + "1,1,1,1,0,0.1\n"), 1).inactive_by(), InactiveBy::Colour);
    }
}
