//! The columns of a run's protocol for readers: what captions state, and what rows must share to be compared.
//!
//! Settings name the columns that depend on them. A setting's own `column` holds its value; `run::Protocol` makes the
//! others.

use super::registry::{Effect, REGISTRY, Setting};
use super::{Batching, Config, Encoding, Method, Schedule};
use crate::perturb::PaperSite;

/// When rows of one scene must agree in a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Agreement {
    /// They may differ.
    Free,
    /// They must agree, unless their definition gives them different settings that decide the column.
    UnlessVaried,
    /// They must always agree.
    Always,
    /// They must agree if a table has a metric that needs LPIPS and both rows have weights.
    ForLpips,
}

/// Where tables name a column of the protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CaptionRule {
    /// In the caption if all lines of a scene share it, otherwise in a note.
    Always,
    /// In a note if the lines of a scene differ in it.
    Differing,
    /// Nowhere: rows are made to differ in it, and their names say so.
    Nowhere,
}

/// A column of the protocol.
#[derive(Clone, Copy, Debug)]
pub struct Column {
    /// Its name in files.
    pub name: &'static str,
    /// Where tables name it.
    pub caption: CaptionRule,
    /// When rows of one scene must agree in it.
    pub agreement: Agreement,
    /// Each seed has its own value, which is no difference between rows.
    pub per_seed: bool,
    /// Returns whether the column applies to a configuration. It is empty otherwise.
    pub applies: fn(&Config) -> bool,
}

const fn column(name: &'static str) -> Column {
    Column { name, caption: CaptionRule::Nowhere, agreement: Agreement::Free, per_seed: false, applies: |_| true }
}

impl Column {
    const fn in_caption(self) -> Column {
        Column { caption: CaptionRule::Always, ..self }
    }

    const fn where_differing(self) -> Column {
        Column { caption: CaptionRule::Differing, ..self }
    }

    const fn always(self) -> Column {
        Column { agreement: Agreement::Always, ..self }
    }

    const fn for_lpips(self) -> Column {
        Column { agreement: Agreement::ForLpips, ..self }
    }

    const fn unless_varied(self) -> Column {
        Column { agreement: Agreement::UnlessVaried, ..self }
    }

    const fn per_seed(self) -> Column {
        Column { per_seed: true, ..self }
    }

    const fn of(self, applies: fn(&Config) -> bool) -> Column {
        Column { applies, ..self }
    }

    /// Returns whether other columns and settings decide the column completely.
    pub fn is_derived(&self) -> bool {
        self.per_seed && !REGISTRY.settings.iter().any(|setting| self.follows(setting))
    }

    /// Returns whether the setting decides the column's value.
    pub fn follows(&self, setting: &Setting) -> bool {
        let is_of_views = VIEWS.contains(&self.name) && is_read(setting);
        is_of_views || setting.rule.all_columns().any(|name| name == self.name)
    }

    /// Returns the setting whose value it holds, or `None` if it holds what a run found.
    pub fn setting(&self) -> Option<&'static Setting> {
        REGISTRY.settings.iter().find(|setting| setting.rule.column == Some(self.name))
    }
}

const DATA_HASH: &str = "data_hash";

/// Columns that say something of the views, whichever setting chose them: their hash, and how much of them is masked.
const VIEWS: [&str; 2] = [DATA_HASH, "masks"];

/// Returns whether the setting decides what is read of a scene, before any corruption.
fn is_read(setting: &Setting) -> bool {
    setting.path.starts_with("data.")
        && !setting.path.starts_with("data.corruption.")
        && setting.rule.effect == Effect::Numbers
}

/// Returns whether there is a second pass.
fn augmented(config: &Config) -> bool {
    config.method.is_augmented()
}

/// Returns whether there are deltas.
pub fn perturbed(config: &Config) -> bool {
    augmented(config) && config.perturb.source().is_some()
}

fn perturbed_at(config: &Config, site: PaperSite) -> bool {
    perturbed(config) && config.perturb[site].on()
}

/// Returns whether the loss has a term next to the colour loss.
pub fn regularized(config: &Config) -> bool {
    !config.regularizer.kind.is_empty()
}

/// Returns whether radiance fields are trained.
fn of_fields(config: &Config) -> bool {
    config.method.has_fields()
}

fn on_hash_grid(config: &Config) -> bool {
    of_fields(config) && config.field.encoding == Encoding::Hash
}

fn without_hash_grid(config: &Config) -> bool {
    of_fields(config) && config.field.encoding != Encoding::Hash
}

fn at_intervals(config: &Config) -> bool {
    of_fields(config) && config.field.encoding.at_intervals()
}

/// Returns whether steps use rays.
fn of_rays(config: &Config) -> bool {
    config.method.learns_from_rays()
}

fn warmed_up(config: &Config) -> bool {
    config.train.schedule == Schedule::LogLinear
}

fn of_one_image(config: &Config) -> bool {
    of_rays(config) && config.train.batching == Some(Batching::OneImage)
}

fn cropped(config: &Config) -> bool {
    of_one_image(config) && config.train.precrop_steps != Some(0)
}

/// All columns, in the order of files.
pub const COLUMNS: &[Column] = &[
    column("protocol").in_caption().always(),
    column("dataset").in_caption().always(),
    column("scene").always(),
    column("width").in_caption().unless_varied(),
    column("height").in_caption().unless_varied(),
    column("background").in_caption().unless_varied(),
    column("ndc").in_caption().unless_varied(),
    column("split").in_caption().unless_varied(),
    column("views_trained").in_caption().unless_varied(),
    column("views_evaluated").in_caption().unless_varied(),
    column("pixel_origin").in_caption().unless_varied(),
    column("method"),
    column("perturb_kind").of(augmented),
    column("levels").of(perturbed),
    column("attack").of(perturbed),
    column("attack_numbers").of(perturbed),
    column("step_unit").of(perturbed),
    column("injection_layer").of(|config| perturbed_at(config, PaperSite::Feature)),
    column("entries").where_differing().of(augmented),
    column("perturb_field").where_differing().of(augmented),
    column("objective").where_differing().of(augmented),
    column("output").where_differing().of(perturbed),
    column("resample").where_differing().of(perturbed),
    column("lambda").of(augmented),
    column("lambda_schedule").where_differing().of(augmented),
    column("regularizers").of(regularized),
    column("unseen").where_differing().of(regularized),
    column("regularizer_points").of(regularized),
    column("regularizer_domain").of(regularized),
    column("regularizer_fields").of(regularized),
    column("field_width").in_caption().of(of_fields),
    column("field_depth").in_caption().of(of_fields),
    column("init").where_differing().of(of_fields),
    column("density_activation").in_caption().of(of_fields),
    column("samples_coarse").in_caption().of(of_fields),
    column("samples_fine").in_caption().of(of_fields),
    column("rays").in_caption().of(of_rays),
    column("steps").in_caption(),
    column("epochs"),
    column("learning_rate").in_caption(),
    column("coarse_weight").in_caption().of(without_hash_grid),
    column("seed").per_seed(),
    column("redraws").per_seed(),
    column("config_hash").per_seed(),
    column(DATA_HASH).unless_varied(),
    column("corruption").in_caption().unless_varied(),
    column("corruption_hash").per_seed(),
    column("program").in_caption().always(),
    column("code_revision").in_caption().always(),
    column("device").always(),
    column("mesh").in_caption().always(),
    column("lpips_weights").for_lpips(),
    // Newer than the first results, whose points lack these columns.
    column("attack_geometry").where_differing().of(perturbed),
    column("step_over_radius").of(perturbed),
    column("training_views").in_caption().unless_varied(),
    column("validation").in_caption().unless_varied().of(|config| !config.data.has_splits()),
    column("views_seen").in_caption().unless_varied(),
    column("views_seed").where_differing().unless_varied(),
    column("encoding").where_differing().of(of_fields),
    column("position_octaves").where_differing().of(without_hash_grid),
    column("view_octaves").where_differing().of(of_fields),
    column("skips").where_differing().of(of_fields),
    column("frequency_steps").where_differing().of(of_fields),
    column("rgb_padding").where_differing().of(of_fields),
    column("rgb_limit").where_differing().of(of_fields),
    column("resample_padding").where_differing().of(at_intervals),
    column("anneal").where_differing().of(of_fields),
    column("jitter").where_differing().of(of_fields),
    column("density_noise").where_differing().of(of_fields),
    column("batching").where_differing().of(of_rays),
    column("precrop_steps").where_differing().of(of_one_image),
    column("precrop_fraction").where_differing().of(cropped),
    column("warmup_share").where_differing().of(warmed_up),
    column("warmup_from").where_differing().of(warmed_up),
    column("dead_start_share").where_differing().of(of_fields),
    column("chunk").where_differing().of(of_rays),
    column("eval_chunk").where_differing(),
    column("xyz_radius").where_differing().of(|config| perturbed_at(config, PaperSite::Xyz)),
    column("norms").where_differing().of(perturbed),
    column("perturb_last").where_differing().of(|config| perturbed_at(config, PaperSite::Density)),
    column("core").where_differing().of(of_fields),
    column("precision").where_differing(),
    column("instructions").where_differing(),
    column(INACTIVE_BY).of(perturbed),
    column("view_depth").where_differing().of(of_fields),
    column("view_width").where_differing().of(of_fields),
    column("adam").where_differing(),
    column("clip").where_differing(),
    column("gradient_scaling").where_differing().of(of_fields),
    column("sam").where_differing(),
    column("hash_grid").where_differing().of(on_hash_grid),
    column("spacing").where_differing().of(of_fields),
    column("masks").in_caption().unless_varied(),
    column("parent").where_differing(),
    column("srn").of(|config| config.method == Method::Srn),
    column("nv").of(|config| config.method == Method::Nv),
    column("llff").of(|config| config.method == Method::Llff),
];

/// The column that says by which criterion sites of a run are inactive.
pub const INACTIVE_BY: &str = "inactive_by";

/// Least shift of an active site. A site is inactive in a run if its deltas move the rendered colours by less than
/// this, in 8-bit steps, on average over rays and channels. Single colours may move further. Unlike a fraction of the
/// loss, the shift does not depend on training progress.
pub const LEAST_SHIFT: f64 = 0.5;

/// The values of [`INACTIVE_BY`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InactiveBy {
    /// How far a site's deltas move the rendered colours.
    Colour,
    /// What the deltas add to the loss. Points of older programs, which lack the column, use it.
    Loss,
}

impl InactiveBy {
    /// Both values.
    pub const ALL: [InactiveBy; 2] = [InactiveBy::Loss, InactiveBy::Colour];

    /// Returns the name in files.
    pub const fn name(self) -> &'static str {
        match self {
            InactiveBy::Colour => "colour",
            InactiveBy::Loss => "loss",
        }
    }

    /// Returns the value of a name, or `Loss` for any other name, as in points without the column.
    pub fn of_name(name: &str) -> InactiveBy {
        if name == InactiveBy::Colour.name() { InactiveBy::Colour } else { InactiveBy::Loss }
    }

    /// Returns the description of sites that are inactive by this criterion.
    pub const fn meaning(self) -> &'static str {
        match self {
            InactiveBy::Colour => "sites that move the rendered colours by less than half an 8-bit step on average",
            InactiveBy::Loss => "sites without effect on the loss",
        }
    }
}

/// Prefix of the columns that hold the values of axes.
pub const AXIS: &str = "axis.";
/// Prefix of the columns that hold the settings that points differ in.
pub const SETTING: &str = "set.";

/// Returns the place of a field in a point's protocol: in the order of [`COLUMNS`], then unknown ones, then swept ones.
pub fn field_order(name: &str) -> usize {
    let is_swept = name.starts_with(AXIS) || name.starts_with(SETTING);
    COLUMNS.iter().position(|column| column.name == name).unwrap_or(COLUMNS.len() + usize::from(is_swept))
}

/// Returns the column of that name.
pub fn find(name: &str) -> Option<&'static Column> {
    COLUMNS.iter().find(|column| column.name == name)
}

/// Returns whether two rows disagree in a column in which they must agree.
pub fn disagree(name: &str, a: &str, b: &str) -> bool {
    let is_missing = a.is_empty() || b.is_empty();
    // A missing measurement does not contradict another one.
    let may_be_missing = find(name).is_some_and(|column| column.agreement == Agreement::ForLpips);
    a != b && !(is_missing && may_be_missing)
}

/// Returns whether each seed has its own value, which is no difference between rows.
pub fn is_per_seed(name: &str) -> bool {
    find(name).is_some_and(|column| column.per_seed)
}

#[cfg(test)]
mod tests {
    use super::super::registry::{Effect, REGISTRY};
    use super::{COLUMNS, disagree, find};

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
    fn what_was_not_measured_is_no_other_measurement() {
        assert!(disagree("lpips_weights", "squeeze 1", "squeeze 2") && !disagree("lpips_weights", "squeeze 1", ""));
        assert!(disagree("mesh", "", "64"));
    }
}
