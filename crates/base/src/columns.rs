//! The columns of a run's protocol: what captions state, and what rows must share to be compared; their names and cells in files.
//!
//! Settings name the columns that depend on them. A setting's own `column` holds its value; `run::Protocol` makes the
//! others.

use Applies::*;

use crate::csv::{hash_cell, plain_hash};
use crate::settings::{Effect, Registry, Setting};

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

/// The trainings that have a value in a column; `applies` of `augnerf_nerf::settings::columns` tells whether one is among them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Applies {
    /// All.
    Always,
    /// Those with a second pass.
    Augmented,
    /// Those with deltas.
    Perturbed,
    /// Those with deltas at `xyz`.
    PerturbedXyz,
    /// Those with deltas at `feature`.
    PerturbedFeature,
    /// Those with deltas at `density`.
    PerturbedDensity,
    /// Those whose loss has a term next to the colour loss.
    Regularized,
    /// Those of radiance fields.
    Fields,
    /// Those of fields on a hash grid.
    HashGrid,
    /// Those of fields without a hash grid.
    NoHashGrid,
    /// Those of fields with a coarse pass.
    CoarsePass,
    /// Those of fields with a coarse pass that are queried at intervals.
    Intervals,
    /// Those whose steps use rays.
    Rays,
    /// Those whose steps use rays of one image.
    OneImage,
    /// Those that begin with the middle of images.
    Precrop,
    /// Those whose learning rate warms up.
    WarmUp,
    /// Those of captures without splits of their own.
    NoSplits,
    /// Those of SRN.
    Srn,
    /// Those of Neural Volumes.
    Nv,
    /// Those of LLFF.
    Llff,
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
    /// The trainings that have a value in it. It is empty for others.
    pub applies: Applies,
}

const fn column(name: &'static str) -> Column {
    Column { name, caption: CaptionRule::Nowhere, agreement: Agreement::Free, per_seed: false, applies: Always }
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

    const fn of(self, applies: Applies) -> Column {
        Column { applies, ..self }
    }

    /// Returns whether other columns and settings decide the column completely.
    pub fn is_derived(&self, registry: &Registry) -> bool {
        self.per_seed && !registry.settings.iter().any(|setting| self.follows(setting))
    }

    /// Returns whether the setting decides the column's value.
    pub fn follows(&self, setting: &Setting) -> bool {
        let is_of_views = VIEWS.contains(&self.name) && is_read(setting);
        is_of_views || setting.rule.all_columns().any(|name| name == self.name)
    }

    /// Returns the setting whose value it holds, or `None` if it holds what a run found.
    pub fn setting<'a>(&self, registry: &'a Registry) -> Option<&'a Setting> {
        registry.settings.iter().find(|setting| setting.rule.column == Some(self.name))
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
    column("perturb_kind").of(Augmented),
    column("levels").of(Perturbed),
    column("attack").of(Perturbed),
    column("attack_numbers").of(Perturbed),
    column("step_unit").of(Perturbed),
    column("injection_layer").of(PerturbedFeature),
    column("entries").where_differing().of(Augmented),
    column("perturb_field").where_differing().of(Augmented),
    column("objective").where_differing().of(Augmented),
    column("output").where_differing().of(Perturbed),
    column("resample").where_differing().of(Perturbed),
    column("lambda").of(Augmented),
    column("lambda_schedule").where_differing().of(Augmented),
    column("regularizers").of(Regularized),
    column("unseen").where_differing().of(Regularized),
    column("regularizer_points").of(Regularized),
    column("regularizer_domain").of(Regularized),
    column("regularizer_fields").of(Regularized),
    column("field_width").in_caption().of(Fields),
    column("field_depth").in_caption().of(Fields),
    column("init").where_differing().of(Fields),
    column("density_activation").in_caption().of(Fields),
    column("samples_coarse").in_caption().of(CoarsePass),
    column("samples_fine").in_caption().of(CoarsePass),
    column("rays").in_caption().of(Rays),
    column("steps").in_caption(),
    column("epochs"),
    column("learning_rate").in_caption(),
    column("coarse_weight").in_caption().of(NoHashGrid),
    column("seed").per_seed(),
    column("redraws").per_seed(),
    column("config_hash").per_seed(),
    column(DATA_HASH).unless_varied(),
    column("corruption").in_caption().unless_varied(),
    column("corruption_hash").per_seed(),
    column("program").in_caption().always(),
    column("code_revision").in_caption().always(),
    column("device").where_differing().always(),
    column("mesh").in_caption().always(),
    column("lpips_weights").for_lpips(),
    // Newer than the first results, whose points lack these columns.
    column("attack_geometry").where_differing().of(Perturbed),
    column("step_over_radius").of(Perturbed),
    column("training_views").in_caption().unless_varied(),
    column("validation").in_caption().unless_varied().of(NoSplits),
    column("views_seen").in_caption().unless_varied(),
    column("views_seed").where_differing().unless_varied(),
    column("encoding").where_differing().of(Fields),
    column("position_octaves").where_differing().of(NoHashGrid),
    column("view_octaves").where_differing().of(Fields),
    column("skips").where_differing().of(Fields),
    column("frequency_steps").where_differing().of(Fields),
    column("rgb_padding").where_differing().of(Fields),
    column("rgb_limit").where_differing().of(Fields),
    column("resample_padding").where_differing().of(Intervals),
    column("anneal").where_differing().of(Fields),
    column("jitter").where_differing().of(Fields),
    column("density_noise").where_differing().of(Fields),
    column("batching").where_differing().of(Rays),
    column("precrop_steps").where_differing().of(OneImage),
    column("precrop_fraction").where_differing().of(Precrop),
    column("warmup_share").where_differing().of(WarmUp),
    column("warmup_from").where_differing().of(WarmUp),
    column("dead_start_share").where_differing().of(Fields),
    column("chunk").where_differing().of(Rays),
    column("eval_chunk").where_differing(),
    column("xyz_radius").where_differing().of(PerturbedXyz),
    column("norms").where_differing().of(Perturbed),
    column("perturb_last").where_differing().of(PerturbedDensity),
    column("core").where_differing().of(Fields),
    column("precision").where_differing(),
    column("instructions").where_differing(),
    column(INACTIVE_BY).of(Perturbed),
    column("view_depth").where_differing().of(Fields),
    column("view_width").where_differing().of(Fields),
    column("adam").where_differing(),
    column("clip").where_differing(),
    column("gradient_scaling").where_differing().of(Fields),
    column("sam").where_differing(),
    column("hash_grid").where_differing().of(HashGrid),
    column("occupancy").in_caption().of(HashGrid),
    column("spacing").where_differing().of(Fields),
    column("masks").in_caption().unless_varied(),
    column("parent").where_differing(),
    column("srn").of(Srn),
    column("nv").of(Nv),
    column("llff").of(Llff),
];

/// The names of the paper's sites, in the order of a pass.
pub const SITES: [&str; 6] = ["t", "xyz", "view", "feature", "rgb", "density"];

/// The column that says by which criterion sites of a run are inactive.
pub const INACTIVE_BY: &str = "inactive_by";

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

/// Fields that have another name in files, where their own is a keyword of Python.
const RENAMED: [(&str, &str); 1] = [("lambda", "perturb_lambda")];
/// Columns of hashes.
const HASHES: [&str; 6] = ["id", "config_hash", "data_hash", "corruption_hash", "code_revision", "parent"];

/// Returns whether cells of a column are hashes.
pub fn has_hashes(name: &str) -> bool {
    HASHES.contains(&name)
}

/// Returns the name of a field in files.
pub fn file_name(name: &str) -> &str {
    RENAMED.iter().find(|(own, _)| *own == name).map_or(name, |(_, other)| other)
}

/// Returns a field's name and cell in files.
pub fn file_field((name, cell): (String, String)) -> (String, String) {
    let cell = if has_hashes(&name) { hash_cell(&cell) } else { cell };
    (file_name(&name).into(), cell)
}

/// Returns the name and text that were given to [`file_field`].
pub fn plain_field((name, cell): (String, String)) -> (String, String) {
    let cell = if has_hashes(&name) { plain_hash(&cell).to_string() } else { cell };
    (RENAMED.iter().find(|(_, other)| *other == name).map_or(name, |(own, _)| own.to_string()), cell)
}

#[cfg(test)]
mod tests {
    use super::disagree;

    #[test]
    fn what_was_not_measured_is_no_other_measurement() {
        assert!(disagree("lpips_weights", "squeeze 1", "squeeze 2") && !disagree("lpips_weights", "squeeze 1", ""));
        assert!(disagree("mesh", "", "64"));
    }
}
