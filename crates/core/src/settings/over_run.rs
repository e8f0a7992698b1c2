//! Settings over the file of a run, which has a number for each setting, also for those that nobody chose; and over a preset
//! that has a term of the loss.

use toml::{Table, Value};

use super::Config;
use super::identity::{remove, value_at};
use crate::perturb::PaperSite;

/// A setting, and numbers that belong to its value.
struct Numbers {
    of: String,
    paths: Vec<String>,
}

impl Numbers {
    /// Removes the numbers from a layer if `given` has another value than `before`.
    fn forget(&self, layer: &mut Table, before: &Table, given: &Table) {
        let Some(now) = value_at(given, &self.of) else { return };
        if value_at(before, &self.of).map(as_list) != Some(as_list(now)) {
            self.paths.iter().for_each(|path| remove(layer, path));
        }
    }
}

/// A value and a list of it alone are the same setting.
fn as_list(value: &Value) -> Vec<Value> {
    value.as_array().cloned().unwrap_or_else(|| vec![value.clone()])
}

fn numbers() -> [Numbers; 5] {
    let of_sites = |keys: &[&str]| -> Vec<String> {
        let of_site = |site: PaperSite| keys.iter().map(move |key| format!("perturb.{}.{key}", site.name()));
        PaperSite::ALL.into_iter().flat_map(of_site).collect()
    };
    let attack = [vec!["perturb.step_unit".into()], of_sites(&["step_size", "epsilon"])].concat();
    let terms = ["weight", "schedule", "unseen_rays", "unseen_poses"].map(|key| format!("regularizer.{key}"));
    let of = |of: &str, paths: &[String]| Numbers { of: of.into(), paths: paths.to_vec() };
    [
        of("perturb.attack", &attack),
        of("perturb.geometry", &attack),
        of("perturb.step_unit", &of_sites(&["step_size"])),
        of("regularizer.kind", &terms),
        of("train.batching", &["train.precrop_steps".into()]),
    ]
}

/// Removes from a run's `file` the numbers of each setting to which this call gives another value. They are then filled in as
/// in a run from scratch. Any other file stays as it is, because a person chose what it says.
pub(super) fn reopen(file: &mut Table, given: &Table) {
    let run: Option<Config> = file.clone().try_into().ok().filter(|run: &Config| run.perturb.is_filled_in());
    // With the settings that are newer than the run, at their defaults.
    let Some(run) = run.map(|run| run.to_table()) else { return };
    numbers().iter().for_each(|numbers| numbers.forget(file, &run, given));
}

/// Removes from a `preset` the numbers of its term of the loss, such as the weight, if later layers name another term.
pub(super) fn forget_term(preset: &mut Table, given: &Table) {
    let before = preset.clone();
    let of_term = numbers().into_iter().filter(|numbers| numbers.of == "regularizer.kind");
    of_term.for_each(|numbers| numbers.forget(preset, &before, given));
}

#[cfg(test)]
mod tests {
    use tempfile::NamedTempFile;

    use crate::settings::{Config, DataKind, Extent, Preset, build, parse_assignment};

    fn built(preset: Option<Preset>, file: Option<&NamedTempFile>, texts: &[&str]) -> Config {
        let assignments: Vec<_> = texts.iter().map(|text| parse_assignment(text).unwrap()).collect();
        build(preset, file.map(NamedTempFile::path), &assignments).unwrap()
    }

    /// Settings as a run has them.
    fn resolved(config: Config) -> Config {
        let extent = Extent { near: 2.0, far: 6.0, domain: None, pixels: 16 };
        config.resolve(DataKind::BuiltinBlender, extent).unwrap().into_draft()
    }

    fn file_of(text: &str) -> NamedTempFile {
        let file = NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        file
    }

    #[test]
    fn numbers_over_a_run_are_those_of_what_changes() {
        let (aug, calibrated) = ("method=aug-nerf", "perturb.attack=calibrated");
        for (texts, given) in [
            (&["method=nerf"][..], &[aug, calibrated][..]),
            (&[aug], &[calibrated]),
            (&[aug, calibrated], &["perturb.attack=paper"]),
            (&[aug, calibrated], &["perturb.geometry=paper"]),
            (&[aug], &[calibrated, "perturb.feature.epsilon=0.02"]),
            (&[aug, "perturb.rgb.step_size=0.7"], &["perturb.rgb.steps=3"]),
            // What does not change keeps what was chosen for it.
            (&[aug, calibrated, "perturb.rgb.epsilon=0.5"], &[calibrated, "train.steps=9"]),
            (&["regularizer.kind=tv", "regularizer.weight=0.5"], &["regularizer.kind=tv", "seed=3"]),
            (&["regularizer.kind=tv"], &["regularizer.kind=l1"]),
            (&["regularizer.kind=tv"], &["regularizer.kind=['l1','tv']"]),
            (&["regularizer.kind=tv"], &["regularizer.kind=[]"]),
            (&["train.batching=all-images"], &["train.batching=one-image"]),
        ] {
            let run = file_of(&resolved(built(Some(Preset::Cpu), None, texts)).to_toml());
            let at_once = built(Some(Preset::Cpu), None, &[texts, given].concat());
            assert_eq!(resolved(built(None, Some(&run), given)), resolved(at_once), "{texts:?} {given:?}");
        }
    }

    #[test]
    fn another_term_than_the_preset_s_has_its_own_weight() {
        let weight = |texts: &[&str]| built(Some(Preset::FewViews), None, texts).regularizer.weight;
        let (empty, own): ([f64; 0], _) = ([], [0.03]);
        assert_eq!(weight(&[]), own);
        assert_eq!(weight(&["regularizer.kind=occlusion"]), own);
        assert_eq!(weight(&["regularizer.kind=['occlusion']"]), own);
        assert_eq!(weight(&["regularizer.kind=tv"]), built(None, None, &["regularizer.kind=tv"]).regularizer.weight);
        assert_eq!(weight(&["regularizer.kind=tv", "regularizer.weight=1e-7"]), [1e-7]);
        assert_eq!(weight(&["regularizer.kind=[]"]), empty);
    }

    #[test]
    fn a_file_that_is_no_run_s_keeps_what_it_says() {
        let file = file_of("[regularizer]\nkind = \"tv\"\nweight = 3.8e-6\n\n[perturb.t]\nepsilon = 0.5\n");
        let found = built(None, Some(&file), &["regularizer.kind=l1", "perturb.attack=calibrated"]);
        assert_eq!(found.regularizer.weight, [3.8e-6]);
        assert_eq!(found.perturb.sites[crate::perturb::PaperSite::T].epsilon, Some(0.5.into()));
    }
}
