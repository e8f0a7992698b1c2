//! The columns of a run's protocol, as readers meet them: what captions tell, what rows must share to be compared. The
//! values are those of `run::Protocol`; which settings a column speaks of stands with the settings.

use super::registry::{Effect, REGISTRY, Setting};

/// When rows of one scene must agree in a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Agreement {
    /// They may differ.
    Free,
    /// Unless their definition gives them different settings that decide it.
    UnlessVaried,
    /// Always.
    Always,
    /// Where a table has a metric that needs LPIPS, and both rows have weights.
    ForLpips,
}

/// A column of the protocol.
#[derive(Clone, Copy, Debug)]
pub struct Column {
    /// Its name in files.
    pub name: &'static str,
    /// A table's caption tells it, where all lines of a scene share it.
    pub in_caption: bool,
    /// When rows of one scene must agree in it.
    pub agreement: Agreement,
    /// Each seed has its own: no difference between rows.
    pub per_seed: bool,
}

const fn column(name: &'static str) -> Column {
    Column { name, in_caption: false, agreement: Agreement::Free, per_seed: false }
}

impl Column {
    const fn in_caption(self) -> Column {
        Column { in_caption: true, ..self }
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

    /// It says nothing that other columns and settings do not decide.
    pub fn is_derived(&self) -> bool {
        self.per_seed && !REGISTRY.settings.iter().any(|setting| self.follows(setting))
    }

    /// The setting decides what stands in it.
    pub fn follows(&self, setting: &Setting) -> bool {
        // All that is read of a scene, before any corruption.
        let is_read = setting.path.starts_with("data.")
            && !setting.path.starts_with("data.corruption.")
            && setting.rule.effect == Effect::Numbers;
        setting.rule.columns.contains(&self.name) || self.name == "data_hash" && is_read
    }
}

/// All columns, in the order in which captions tell them.
pub const COLUMNS: [Column; 50] = [
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
    column("corruption").in_caption().unless_varied(),
    column("corruption_hash").per_seed(),
    column("data_hash").unless_varied(),
    column("mesh").in_caption().always(),
    column("lpips_weights").for_lpips(),
    column("attack_geometry"),
    column("step_over_radius"),
    column("pixel_origin").in_caption().unless_varied(),
    column("method"),
    column("perturb_kind"),
    column("levels"),
    column("attack"),
    column("attack_numbers"),
    column("step_unit"),
    column("injection_layer"),
    column("perturb_field"),
    column("objective"),
    column("output"),
    column("resample"),
    column("lambda"),
    column("regularizers"),
    column("regularizer_points"),
    column("regularizer_domain"),
    column("regularizer_fields"),
    column("field_width").in_caption(),
    column("field_depth").in_caption(),
    column("init"),
    column("samples_coarse").in_caption(),
    column("samples_fine").in_caption(),
    column("rays").in_caption(),
    column("steps").in_caption(),
    column("density_activation").in_caption(),
    column("learning_rate"),
    column("coarse_weight"),
    column("seed").per_seed(),
    column("redraws").per_seed(),
    column("config_hash").per_seed(),
    column("program").in_caption().always(),
    column("code_revision").in_caption().always(),
    column("device").always(),
];

/// The column of that name.
pub fn find(name: &str) -> Option<&'static Column> {
    COLUMNS.iter().find(|column| column.name == name)
}

/// Whether two rows disagree in a column that they must agree in.
pub fn disagree(name: &str, a: &str, b: &str) -> bool {
    let is_missing = a.is_empty() || b.is_empty();
    // What was not measured is no other measurement.
    let may_be_missing = find(name).is_some_and(|column| column.agreement == Agreement::ForLpips);
    a != b && !(is_missing && may_be_missing)
}

/// Each seed has its own: no difference between rows.
pub fn is_per_seed(name: &str) -> bool {
    find(name).is_some_and(|column| column.per_seed)
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
