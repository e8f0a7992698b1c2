//! The columns of a run's protocol ([`crate::base::columns`]), as configurations have them.

use super::registry::REGISTRY;
use super::{Batching, Config, Encoding, Method, Placing, Schedule};
pub use crate::base::columns::*;
use crate::perturb::PaperSite;

/// Returns whether a configuration has a value in a column.
pub fn applies(column: &Column, config: &Config) -> bool {
    let Config { method, train, .. } = config;
    let (of_fields, of_rays) = (method.has_fields(), method.learns_from_rays());
    let on_hash_grid = config.field.encoding == Encoding::Hash;
    let places = config.sampling.kind == Placing::Resampled;
    let of_one_image = of_rays && train.batching == Some(Batching::OneImage);
    let perturbed_at = |site: PaperSite| perturbed(config) && config.perturb[site].on();
    match column.applies {
        Applies::Always => true,
        Applies::Augmented => method.is_augmented(),
        Applies::Perturbed => perturbed(config),
        Applies::PerturbedXyz => perturbed_at(PaperSite::Xyz),
        Applies::PerturbedFeature => perturbed_at(PaperSite::Feature),
        Applies::PerturbedDensity => perturbed_at(PaperSite::Density),
        Applies::Regularized => regularized(config),
        Applies::Fields => of_fields,
        Applies::HashGrid => of_fields && on_hash_grid,
        Applies::NoHashGrid => of_fields && !on_hash_grid,
        Applies::CoarsePass => of_fields && places,
        Applies::Intervals => of_fields && places && config.field.encoding.at_intervals(),
        Applies::Rays => of_rays,
        Applies::OneImage => of_one_image,
        Applies::Precrop => of_one_image && train.precrop_steps != Some(0),
        Applies::WarmUp => train.schedule == Schedule::LogLinear,
        Applies::NoSplits => !config.data.has_splits(),
        Applies::Srn => *method == Method::Srn,
        Applies::Nv => *method == Method::Nv,
        Applies::Llff => *method == Method::Llff,
    }
}

/// Returns whether there are deltas.
pub fn perturbed(config: &Config) -> bool {
    config.method.is_augmented() && config.perturb.second.perturbs()
}

/// Returns whether the loss has a term next to the colour loss.
pub fn regularized(config: &Config) -> bool {
    !config.regularizer.kind.is_empty()
}

/// Returns the column with a swept setting's own value: `rays` for `set.train.rays`.
pub fn column_of_setting(swept: &str) -> Option<&'static str> {
    let path = swept.strip_prefix(SETTING)?;
    // The field holds the steps of the run, which are those of the setting if it has ended.
    if path == "train.steps" {
        return Some("steps");
    }
    REGISTRY.get(path)?.rule.column
}

/// Least shift of an active site. A site is inactive in a run if its deltas move the rendered colours by less than
/// this, in 8-bit steps, on average over rays and channels. Single colours may move further. Unlike a fraction of the
/// loss, the shift does not depend on training progress.
pub const LEAST_SHIFT: f64 = 0.5;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::settings::Effect;

    /// Settings that can change numbers, but for which no column speaks.
    const UNSPOKEN: [(&str, &str); 1] =
        [("train.collapse_steps", "ends a run that has collapsed; the numbers of one that goes on are the same")];

    #[test]
    fn every_setting_that_can_change_a_number_has_a_column() {
        for setting in REGISTRY.settings.iter().filter(|setting| setting.rule.effect == Effect::Numbers) {
            let spoken = COLUMNS.iter().any(|column| column.follows(setting));
            let excused = UNSPOKEN.iter().any(|(path, _)| *path == setting.path);
            assert!(spoken != excused, "{}: a column of the protocol, or a reason in UNSPOKEN", setting.path);
        }
    }

    #[test]
    fn columns_are_distinct_and_known() {
        for (index, column) in COLUMNS.iter().enumerate() {
            assert!(COLUMNS[..index].iter().all(|other| other.name != column.name), "{}", column.name);
            let holders = REGISTRY.settings.iter().filter(|setting| setting.rule.column == Some(column.name));
            assert!(holders.count() <= 1, "{} holds the value of several settings", column.name);
        }
        for setting in &REGISTRY.settings {
            assert!(setting.rule.all_columns().all(|name| find(name).is_some()), "{}", setting.path);
        }
    }

    #[test]
    fn masks_are_those_of_the_views() {
        let masks = find("masks").unwrap();
        for (path, follows) in [("data.views_seed", true), ("data.masks", true), ("train.steps", false)] {
            let setting = REGISTRY.settings.iter().find(|setting| setting.path == path).unwrap();
            assert_eq!(masks.follows(setting), follows, "{path}");
        }
    }

    #[test]
    fn sites_are_the_papers() {
        assert_eq!(PaperSite::ALL.map(PaperSite::name), SITES);
    }
}
