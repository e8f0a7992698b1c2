//! Settings over those of a run. A run's file has a number for each setting, also for those that nobody chose. If settings
//! of this call change the default of another one, a number that the run had by default is opened again. It is then filled
//! as in a run from scratch. What follows from the scene alone stays as the run has it.

use std::collections::BTreeSet;

use toml::{Table, Value};

use super::identity::{remove, value_at};
use super::layers::{Preset, complete, lay_over, layer_keys};
use super::registry::Section;
use super::{Config, DataConfig, Extent, Method, word};
use crate::augment::{Site, StepUnit};
use crate::base::{Error, Result};
use crate::data::{known_bounds, may_have_box};

/// Settings that are filled in and whose default depends on other settings, without those of sites.
const FILLED_IN: [&str; 10] = [
    "train.precrop_steps",
    "regularizer.weight",
    "regularizer.unseen_rays",
    "regularizer.unseen_poses",
    "field.hash.contraction",
    "field.hash.bounds",
    "nv.step",
    "llff.near",
    "llff.far",
    "perturb.step_unit",
];

/// Iterates over all settings that are filled in and whose default depends on other settings.
fn filled_in() -> impl Iterator<Item = String> {
    let of_site = |site: Site| ["step_size", "epsilon"].map(|key| format!("perturb.{}.{key}", site.name()));
    FILLED_IN.into_iter().map(String::from).chain(Site::ALL.into_iter().flat_map(of_site))
}

/// Removes from a run's `file` the numbers that it has by default, if the settings `given` in this call change the default.
/// Any other file stays as it is: a person chose what it says.
///
/// # Errors
/// [`Error::Config`] names settings to give if the file does not tell whether they were chosen, or if they were chosen for
/// what is now something else.
pub(super) fn reopen(file: &mut Table, given: &Table, preset: Option<Preset>) -> Result<()> {
    let Some(run) = config_of(file.clone(), preset).filter(|run| run.perturb.is_filled_in()) else { return Ok(()) };
    let mut over = OverRun { table: run.to_table(), run, file, given, preset };
    over.reopen_encoding();
    over.reopen_layer()?;
    over.reopen_numbers()?;
    over.check_terms()?;
    over.check_steps()
}

/// Returns the configuration of a table, or `None` if a value is wrong by itself, which [`super::build`] reports.
fn config_of(table: Table, preset: Option<Preset>) -> Option<Config> {
    let config: Config = complete(table, preset).try_into().ok()?;
    let is_sound = config.check("").is_ok() && config.method.representation(config.field.encoding).is_some();
    is_sound.then_some(config)
}

/// A run's settings, and those of this call.
struct OverRun<'a> {
    run: Config,
    /// The same as a table.
    table: Table,
    /// The run's file, from which defaults are removed.
    file: &'a mut Table,
    given: &'a Table,
    preset: Option<Preset>,
}

impl OverRun<'_> {
    /// Returns the settings of this call over what is left of the run's. Their scene counts as the run's.
    fn now(&self) -> Option<Config> {
        let mut table = self.file.clone();
        lay_over(&mut table, self.given.clone());
        let mut now = config_of(table, self.preset)?;
        now.data.kind = self.run.data.kind;
        Some(now)
    }

    /// Returns the run's value of a setting that this call takes from there.
    fn kept(&self, path: &str) -> Option<Value> {
        let is_kept = value_at(self.given, path).is_none() && value_at(self.file, path).is_some();
        value_at(&self.table, path).filter(|_| is_kept).cloned()
    }

    /// Opens the encoding if it is that of the run's method and another method is given.
    fn reopen_encoding(&mut self) {
        let method = value_at(self.given, "method").and_then(|method| method.clone().try_into::<Method>().ok());
        let (of_run, usual) = (self.run.method.encoding(), method.unwrap_or(self.run.method).encoding());
        if usual != of_run && self.run.field.encoding == of_run && self.kept("field.encoding").is_some() {
            remove(self.file, "field.encoding");
        }
    }

    /// Opens what a representation starts from if another one is given.
    fn reopen_layer(&mut self) -> Result<()> {
        let Some(now) = self.now() else { return Ok(()) };
        let representations = [self.run.representation(), now.representation()];
        if representations[0] == representations[1] {
            return Ok(());
        }
        let without_preset = defaults(&self.run, None);
        let of_presets = Preset::ALL.map(|(_, preset)| defaults(&self.run, Some(preset)));
        let after = defaults(&now, self.preset);
        let mut unclear = Vec::new();
        for path in representations.into_iter().flat_map(layer_keys).collect::<BTreeSet<String>>() {
            let Some(kept) = self.kept(&path) else { continue };
            let is = |defaults: &Table| value_at(defaults, &path) == Some(&kept);
            if is(&after) {
                continue;
            }
            if is(&without_preset) || now.without_effect(&path).is_some() {
                remove(self.file, &path);
            } else if of_presets.iter().any(is) {
                unclear.push((path, kept));
            }
        }
        let (method, encoding) = (now.method.name(), word(now.field.encoding));
        let of_fields =
            if now.method.has_fields() { format!(", field.encoding = \"{encoding}\"") } else { String::new() };
        none_of(&unclear, || {
            format!(
                "method = \"{method}\"{of_fields} over a run of another kind, in which {} may have been chosen or be of a preset",
                listed(&unclear)
            )
        })
    }

    /// Opens numbers whose default changes.
    fn reopen_numbers(&mut self) -> Result<()> {
        let Some(now) = self.now() else { return Ok(()) };
        let frame = |data: &DataConfig| (data.ndc, data.spherify, data.rescale, data.recentre, data.bound_factor);
        let (before, after) = (&self.run.data, &now.data);
        let same_frame = frame(before) == frame(after);
        let same_ends = same_frame && (before.near, before.far) == (after.near, after.far);
        let scene = |same: bool| if same { 1.0 } else { 3.0 };
        let extents = [extent(before, 1.0, 1.0), extent(before, 2.0, 2.0)];
        let extent = extent(after, scene(same_ends), scene(same_frame));
        let mut unclear = Vec::new();
        for path in filled_in() {
            let Some(kept) = self.kept(&path) else { continue };
            let [default, elsewhere] = extents.map(|extent| default_of(&path, &self.run, extent));
            if default == default_of(&path, &now, extent) {
                continue;
            }
            let is_known = default == elsewhere;
            if is_known && default.as_ref() != Some(&kept) {
                continue;
            }
            if is_known || now.without_effect(&path).is_some() {
                remove(self.file, &path);
            } else {
                unclear.push((path, kept));
            }
        }
        none_of(&unclear, || {
            format!(
                "{}: the run may have chosen or filled this in, and the default is another one here",
                listed(&unclear)
            )
        })
    }

    /// Removes weights and schedules of terms if there are none. Chosen ones belong to the run's terms.
    fn check_terms(&mut self) -> Result<()> {
        let Some(now) = self.now() else { return Ok(()) };
        if now.regularizer.kind == self.run.regularizer.kind {
            return Ok(());
        }
        let extent = extent(&self.run.data, 1.0, 1.0);
        let chosen = |path: &'static str| {
            let kept = self.kept(path)?;
            (default_of(path, &self.run, extent).as_ref() != Some(&kept)).then(|| (path.to_string(), kept))
        };
        let chosen: Vec<_> = ["regularizer.weight", "regularizer.schedule"].into_iter().filter_map(chosen).collect();
        if now.regularizer.kind.is_empty() {
            chosen.iter().for_each(|(path, _)| remove(self.file, path));
            return Ok(());
        }
        let names =
            |config: &Config| config.regularizer.kind.iter().map(|term| term.name()).collect::<Vec<&str>>().join(", ");
        none_of(&chosen, || {
            format!(
                "regularizer.kind names {}, and the run chose {} for {}",
                names(&now),
                listed(&chosen),
                names(&self.run)
            )
        })
    }

    /// Rejects step sizes that the run chose in another unit.
    fn check_steps(&self) -> Result<()> {
        let Some(now) = self.now() else { return Ok(()) };
        let [before, after] = [&self.run, &now].map(unit_of_steps);
        let step_size = |site: Site| {
            let path = format!("perturb.{}.step_size", site.name());
            let kept = self.kept(&path).filter(|_| now.without_effect(&path).is_none())?;
            Some((path, kept))
        };
        let kept: Vec<_> = Site::ALL.into_iter().filter(|_| before != after).filter_map(step_size).collect();
        none_of(&kept, || {
            let [before, after] = [before, after].map(word);
            format!("perturb.step_unit is \"{after}\" here and \"{before}\" in the run, which has {}", listed(&kept))
        })
    }
}

/// Returns an error that asks for `settings` unless there are none. `why` begins it.
fn none_of(settings: &[(String, Value)], why: impl FnOnce() -> String) -> Result<()> {
    if settings.is_empty() {
        return Ok(());
    }
    let paths: Vec<&str> = settings.iter().map(|(path, _)| path.as_str()).collect();
    Err(Error::Config(format!("{}; set {}, too", why(), paths.join(", "))))
}

/// Returns settings with their values in words.
fn listed(settings: &[(String, Value)]) -> String {
    settings.iter().map(|(path, value)| format!("{path} = {value}")).collect::<Vec<_>>().join(", ")
}

/// Returns the settings of a configuration's method, encoding and kind of scene with nothing chosen, as far as the kind
/// fills them.
fn defaults(config: &Config, preset: Option<Preset>) -> Table {
    let (method, encoding, kind) = (config.method.name(), word(config.field.encoding), config.data.kind);
    let named = format!("method = \"{method}\"\nfield.encoding = \"{encoding}\"\ndata.kind = \"{}\"\n", kind.name());
    let named = toml::from_str(&named).expect("words are plain data");
    let defaults: Config = complete(named, preset).try_into().expect("presets are valid");
    defaults.filled(kind).into_draft().to_table()
}

/// Returns what a setting is in a configuration that leaves it open. `None` if it stays open.
fn default_of(path: &str, config: &Config, extent: Extent) -> Option<Value> {
    let (kind, mut table) = (config.data.kind, config.to_table());
    remove(&mut table, path);
    let open: Config = table.try_into().ok()?;
    value_at(&open.filled(kind).resolve(extent).into_draft().to_table(), path).cloned()
}

/// Returns the extent of a scene. Ends of rays and box that its files state are numbered: other numbers, another scene.
fn extent(data: &DataConfig, ends: f64, side: f64) -> Extent {
    let (near, far) = known_bounds(data).unwrap_or((ends, 4.0 * ends));
    Extent { near, far, domain: may_have_box(data).then_some([[-side; 3], [side; 3]]), pixels: 1 }
}

/// Returns the unit of step sizes.
fn unit_of_steps(config: &Config) -> StepUnit {
    config.perturb.clone().resolve(1.0, config.sampling.coarse, config.field.width).step_unit
}

#[cfg(test)]
mod tests;
