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
    const fn told(self) -> Column {
        Column { in_caption: true, ..self }
    }

    const fn always(self) -> Column {
        Column { agreement: Agreement::Always, ..self }
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
pub const COLUMNS: [Column; 48] = [
    column("protocol").told().always(),
    column("dataset").told().always(),
    column("scene").always(),
    column("width").told().unless_varied(),
    column("height").told().unless_varied(),
    column("background").told().unless_varied(),
    column("ndc").told().unless_varied(),
    column("split").told().unless_varied(),
    column("views_trained").told().unless_varied(),
    column("views_evaluated").told().unless_varied(),
    column("corruption").told().unless_varied(),
    column("corruption_hash").per_seed(),
    column("data_hash").unless_varied(),
    column("mesh").told().always(),
    column("lpips_weights").always(),
    column("pixel_origin").told().unless_varied(),
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
    column("field_width").told(),
    column("field_depth").told(),
    column("init"),
    column("samples_coarse").told(),
    column("samples_fine").told(),
    column("rays").told(),
    column("steps").told(),
    column("density_activation").told(),
    column("learning_rate"),
    column("coarse_weight"),
    column("seed").per_seed(),
    column("redraws").per_seed(),
    column("config_hash").per_seed(),
    column("program").told().always(),
    column("code_revision").told().always(),
    column("device").always(),
];

/// The column of that name.
pub fn find(name: &str) -> Option<&'static Column> {
    COLUMNS.iter().find(|column| column.name == name)
}

/// Each seed has its own: no difference between rows.
pub fn is_per_seed(name: &str) -> bool {
    find(name).is_some_and(|column| column.per_seed)
}
