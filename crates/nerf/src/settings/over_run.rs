//! Settings over the file of a run, which has a number for each setting, also for those that nobody chose; and over a preset
//! that has a term of the loss.

use toml::{Table, Value};

use super::Config;
use super::identity::{set_or_remove, value_at};
use crate::perturb::settings::Sizes;
use crate::perturb::{PaperSite, StepUnit};

/// A setting, and the settings whose numbers belong to its value. `*` is each site.
type Numbers = (&'static str, &'static [&'static str]);

const OF_ATTACK: &[&str] = &["perturb.step_unit", "perturb.*.step_size", "perturb.*.epsilon"];
const OF_TERMS: Numbers = (
    "regularizer.kind",
    &["regularizer.weight", "regularizer.schedule", "regularizer.unseen_rays", "regularizer.unseen_poses"],
);
const NUMBERS: [Numbers; 5] = [
    ("perturb.attack", OF_ATTACK),
    ("perturb.geometry", OF_ATTACK),
    ("perturb.step_unit", &["perturb.*.step_size"]),
    OF_TERMS,
    ("train.batching", &["train.precrop_steps"]),
];

/// Removes from a layer the numbers of each setting to which `given` gives another value than `before`.
fn forget(numbers: &[Numbers], layer: &mut Table, before: &Table, given: &Table) {
    let differs =
        |of: &str| value_at(given, of).is_some_and(|now| value_at(before, of).map(as_list) != Some(as_list(now)));
    for path in numbers.iter().filter(|(of, _)| differs(of)).flat_map(|(_, paths)| *paths) {
        PaperSite::ALL.into_iter().for_each(|site| set_or_remove(layer, &path.replace('*', site.name()), None));
    }
}

/// A value and a list of it alone are the same setting.
fn as_list(value: &Value) -> Vec<Value> {
    value.as_array().cloned().unwrap_or_else(|| vec![value.clone()])
}

/// Removes from a run's `file` the numbers of each setting to which this call gives another value. They are then filled in as
/// in a run from scratch. Any other file stays as it is, because a person chose what it says.
pub(super) fn reopen(file: &mut Table, given: &Table) {
    let run = Config::from_table(file).ok().filter(|run| run.perturb.is_filled_in());
    let Some(run) = run else { return };
    // With the settings that are newer than the run, at their defaults.
    *file = run.to_table();
    let before = file.clone();
    forget(&NUMBERS, file, &before, given);
    // The paper's step of a site that was off is a length, also where the others' steps are radii.
    if run.perturb.sizes == Sizes::Paper && run.perturb.step_unit == Some(StepUnit::Relative) {
        let of = |site: PaperSite, field: &str| format!("perturb.{}.{field}", site.name());
        let comes_on = |site: &PaperSite| !run.perturb[*site].on() && value_at(given, &of(*site, "passes")).is_some();
        PaperSite::ALL.into_iter().filter(comes_on).for_each(|site| set_or_remove(file, &of(site, "step_size"), None));
    }
}

/// Removes from a `preset` the numbers of its term of the loss, such as the weight, if later layers name another term.
pub(super) fn forget_term(preset: &mut Table, given: &Table) {
    let before = preset.clone();
    forget(&[OF_TERMS], preset, &before, given);
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
    fn a_site_that_comes_on_has_no_step_of_another_unit() {
        let radii = ["method=aug-nerf", "perturb.levels=output", "perturb.step_unit=relative"];
        let steps = ["perturb.rgb.step_size=1", "perturb.density.step_size=1"];
        let run = file_of(&resolved(built(Some(Preset::Cpu), None, &[&radii[..], &steps].concat())).to_toml());
        let comes_on = parse_assignment("perturb.t.passes=both").unwrap();
        let refused = build(None, Some(run.path()), std::slice::from_ref(&comes_on)).unwrap_err().to_string();
        assert!(refused.contains("set perturb.t.step_size, too"), "{refused}");
        let step = parse_assignment("perturb.t.step_size=0.5").unwrap();
        assert_eq!(build(None, Some(run.path()), &[comes_on, step]).unwrap().perturb.t.step_size, Some(0.5));
    }

    /// The layer of hash grids limits colours; a run from before that setting did not.
    #[test]
    fn settings_newer_than_a_run_are_at_their_defaults() {
        let mut run = resolved(built(None, None, &["field.encoding=hash"])).to_table();
        assert!(run["field"].as_table_mut().unwrap().remove("rgb_limit").is_some());
        let found = built(None, Some(&file_of(&run.to_string())), &["train.steps=9"]);
        assert_eq!((found.field.rgb_limit, found.train.steps), (0.0, 9));
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
        assert_eq!(found.perturb[crate::perturb::PaperSite::T].epsilon, Some(0.5.into()));
    }
}
