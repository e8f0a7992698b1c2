//! A run with one held-out view, and what runs that are shown together must share.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use crate::base::{Error, Result};
use crate::data::{Camera, Ndc, View};
use crate::run::{Protocol, Viewer};
use crate::settings::{Config, leaves};
use crate::train::checkpoint::State;

/// A run with one held-out view.
#[derive(Clone, Debug)]
pub struct RunView {
    /// Label in images and files.
    pub label: String,
    /// Completed steps, and all steps.
    pub steps: (u64, u64),
    /// Figures name the steps: the runs that are shown together differ in them, or one is unfinished.
    names_steps: bool,
    /// Provenance of its numbers.
    pub protocol: Protocol,
    /// The held-out view.
    pub view: View,
    /// Its index among the run's held-out views, from 0.
    pub index: usize,
    /// Mapping of its rays to normalized device coordinates, if any.
    pub ndc: Option<Ndc>,
    /// Ends of a ray's interval in the units of `t_vals`.
    pub bounds: (f64, f64),
    /// Position of a pixel's ray from the pixel's corner.
    pub(super) shift: f64,
    /// The field is queried at Gaussians of intervals, not at points.
    pub queries_gaussians: bool,
    /// Every setting that can change a number, by its name in `config.toml`.
    pub(super) settings: Vec<(String, String)>,
}

/// Lets the figures of runs that are shown together name their steps, if they differ in them or one is unfinished.
pub fn name_steps<'a>(runs: impl Iterator<Item = &'a mut RunView>) {
    let mut runs: Vec<&mut RunView> = runs.collect();
    let alike = runs.iter().all(|run| run.steps.0 >= run.steps.1 && run.steps.0 == runs[0].steps.0);
    runs.iter_mut().for_each(|run| run.names_steps = !alike);
}

impl RunView {
    /// Reads a run at a checkpoint's state. `view` is a held-out view's name, or its number from 0.
    pub fn new(label: String, viewer: &Viewer, state: &State, view: &str) -> Result<RunView> {
        let Viewer { config, scene, .. } = *viewer;
        let names: Vec<&str> = scene.test.iter().map(|known| known.name.as_str()).collect();
        let index = find_view(&label, &names, view)?;
        Ok(RunView {
            label,
            steps: (state.step, config.train.steps),
            names_steps: false,
            protocol: Protocol::new(config, scene, state),
            view: scene.test[index].read()?,
            index,
            ndc: scene.ndc,
            bounds: scene.bounds(),
            shift: config.data.origin_of_pixels().shift(),
            queries_gaussians: config.field.encoding.queries_gaussians(),
            settings: settings(config),
        })
    }

    /// Returns its name in figures: the label, with the steps if [`name_steps`] found that they matter.
    pub fn caption(&self) -> String {
        let (label, (done, all)) = (&self.label, self.steps);
        match self.names_steps {
            false => label.clone(),
            true if done < all => format!("{label} (unfinished: step {done} of {all})"),
            true => format!("{label} ({done} steps)"),
        }
    }

    /// Returns an error if the run shows another scene, view, resolution, camera or photo than `first`.
    pub fn check_alike(&self, first: &RunView) -> Result<()> {
        let differ = |what: &str, own: String, other: String| {
            Err(Error::Config(format!(
                "{} and {} do not match: {what} is {other} in the first and {own} in the second; give runs that \
                 agree in it",
                first.label, self.label
            )))
        };
        // Numbers have all their digits, so that equal texts are equal numbers.
        let facts = |run: &RunView| {
            let Camera { width, height, focal, centre, pose } = run.view.camera;
            [
                ("the scene", run.protocol.text("scene")),
                ("the kind of scene", run.protocol.text("dataset")),
                ("the resolution", format!("{width} x {height}")),
                ("the held-out view", format!("{} ({})", run.view.name, run.protocol.text("split"))),
                ("the background", run.protocol.text("background")),
                ("the focal length", format!("{focal:?}")),
                ("the principal point", format!("{centre:?}")),
                ("the camera's location", format!("{:?}", pose.map(|row| row[3]))),
                ("the camera's orientation", format!("{:?}", pose.map(|row| [row[0], row[1], row[2]]))),
            ]
        };
        for ((what, own), (_, other)) in facts(self).into_iter().zip(facts(first)) {
            if own != other {
                return differ(what, own, other);
            }
        }
        let others = self.view.image.pixels.iter().zip(&first.view.image.pixels).filter(|(a, b)| a != b).count();
        if others > 0 {
            let values = self.view.image.pixels.len();
            return differ("the photo", "one".into(), format!("another ({others} of {values} values)"));
        }
        if self.view.mask != first.view.mask {
            return differ("the photo's mask", "one".into(), "another, or none".into());
        }
        Ok(())
    }

    /// Returns an error if the run's rays have other ends than those of `first`. Measurements from near to far would
    /// not compare.
    pub fn check_same_interval(&self, first: &RunView) -> Result<()> {
        if self.bounds == first.bounds {
            return Ok(());
        }
        let words = |run: &RunView| format!("{} to {}", run.bounds.0, run.bounds.1);
        Err(Error::Config(format!(
            "rays of {} run from {}, but those of {} from {}: --ray needs one interval; give runs that agree in \
             data.near and data.far (without --ray, runs may differ in them)",
            self.label,
            words(self),
            first.label,
            words(first)
        )))
    }

    /// Converts a rendering's depths from NDC to scene units along the view's axis, as other runs have them.
    pub(super) fn leave_ndc(&mut self, depth: &mut [f32]) {
        if self.ndc.take().is_none() {
            return;
        }
        let camera = &self.view.camera;
        for (index, depth) in depth.iter_mut().enumerate() {
            let (x, y) = ((index % camera.width) as f64 + self.shift, (index / camera.width) as f64 + self.shift);
            let (origin, direction) = camera.ray(x, y);
            *depth = Ndc::world_t(origin, direction, (*depth).into()) as f32;
        }
    }

    /// Returns scene and view in words.
    pub(super) fn title(&self) -> String {
        let [scene, views_evaluated] = ["scene", "views_evaluated"].map(|column| self.protocol.text(column));
        let Camera { width, height, .. } = self.view.camera;
        let place = format!("{} of {views_evaluated}", self.index + 1);
        format!("{scene}, held-out view {} ({place}), {width} x {height} pixels", self.view.name)
    }

    /// Returns the unit of `t`. Without NDC a ray has length 1 along the view's axis.
    pub(super) fn depth_unit(&self) -> &'static str {
        if self.ndc.is_some() { "NDC" } else { "scene units" }
    }
}

/// Returns the index of the view with that name, or else with that number.
fn find_view(label: &str, names: &[&str], view: &str) -> Result<usize> {
    if names.is_empty() {
        return Err(Error::Config(format!(
            "{label}: its scene has no held-out view, and runs are shown at one; name runs of a scene that has"
        )));
    }
    let named = names.iter().position(|known| *known == view);
    let numbered = || view.parse().ok().filter(|&index: &usize| index < names.len());
    named.or_else(numbered).ok_or_else(|| {
        Error::Config(format!(
            "--view {view}: {label} has no such held-out view; give 0 to {}, or one of {}",
            names.len() - 1,
            names.join(", ")
        ))
    })
}

/// Returns labels of runs: `given` if there are any, otherwise the names of their folders. If two folders have the
/// same name, the labels are the parts of their paths after the common part. A repeated run or label, or a wrong
/// number of labels, is an error.
pub fn labels(runs: &[PathBuf], given: &[String]) -> Result<Vec<String>> {
    let place = |run: &Path| std::fs::canonicalize(run).unwrap_or_else(|_| run.to_path_buf());
    let places: Vec<PathBuf> = runs.iter().map(|run| place(run)).collect();
    if let Some(twice) = (1..runs.len()).find(|&index| places[..index].contains(&places[index])) {
        return Err(Error::Config(format!("{} is named twice; name each run once", runs[twice].display())));
    }
    if !given.is_empty() {
        return check_labels(runs, given);
    }
    let name = |place: &PathBuf| place.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let names: Vec<String> = places.iter().map(name).collect();
    let once = |name: &String| names.iter().filter(|other| *other == name).count() == 1;
    if names.iter().all(once) {
        return Ok(names);
    }
    let parts: Vec<Vec<_>> = places.iter().map(|place| place.iter().collect()).collect();
    let common = (0..).take_while(|&i| parts.iter().all(|own| i + 1 < own.len() && own[i] == parts[0][i])).count();
    let rest = |own: &Vec<&OsStr>| own[common..].iter().collect::<PathBuf>().display().to_string();
    Ok(parts.iter().map(rest).collect())
}

fn check_labels(runs: &[PathBuf], given: &[String]) -> Result<Vec<String>> {
    let refuse = |what: String| Err(Error::Config(format!("--label: {what}; give each run its own label")));
    if given.len() != runs.len() {
        return refuse(format!("{} labels for {} runs", given.len(), runs.len()));
    }
    for (index, label) in given.iter().enumerate() {
        if label.trim().is_empty() {
            return refuse("a label is blank".into());
        }
        if given[..index].contains(label) {
            return refuse(format!("`{label}` occurs twice"));
        }
    }
    Ok(given.to_vec())
}

/// Returns every setting that can change a number; section `perturb` only if there is a perturbed pass.
pub(super) fn settings(config: &Config) -> Vec<(String, String)> {
    let mut table = config.portable().to_table();
    if !config.method.is_augmented() {
        table.remove("perturb");
    }
    let text = |value: &toml::Value| value.as_str().map_or_else(|| value.to_string(), String::from);
    leaves(&table).into_iter().map(|(name, value)| (name, text(value))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_has_a_name_or_a_number_if_the_scene_holds_any_out() {
        let names = ["7", "a"];
        let found = ["7", "a", "0"].map(|view| find_view("run", &names, view).unwrap());
        assert_eq!(found, [0, 1, 0]);
        let refused = |names: &[&str], view| find_view("run", names, view).unwrap_err().to_string();
        assert!(refused(&names, "2").contains("give 0 to 1, or one of 7, a"));
        assert!(refused(&[], "0").contains("no held-out view"));
    }
}
