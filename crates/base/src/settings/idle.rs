//! Settings that have no effect in a configuration, with the reason.

/// What happens to a setting without effect, besides a note.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IdleKind {
    /// Nothing.
    Noted,
    /// Hashes hold its default.
    Unhashed,
    /// Hashes and files of runs hold its default.
    Dropped,
}

/// Settings without effect.
pub struct Idle {
    /// What happens to them besides a note.
    pub kind: IdleKind,
    /// Their dotted names. A section stands for all of its settings.
    paths: Vec<String>,
    /// The reason.
    pub why: String,
}

/// All settings of a configuration without effect. The first that names a setting gives its reason.
#[derive(Default)]
pub struct IdleSettings(Vec<Idle>);

impl IdleSettings {
    /// Adds the settings `names` of a section, if `holds`. The section is empty for complete paths.
    pub fn add(&mut self, kind: IdleKind, section: &str, names: &[&str], holds: bool, why: impl Into<String>) {
        if holds {
            let paths = names.iter().map(|name| format!("{section}{name}")).collect();
            self.0.push(Idle { kind, paths, why: why.into() });
        }
    }

    /// Iterates over what is said of a setting.
    pub fn at(&self, path: &str) -> impl Iterator<Item = &Idle> {
        let covers = move |idle: &&Idle| {
            let after = |name: &String| path.strip_prefix(name.as_str());
            idle.paths.iter().filter_map(after).any(|rest| rest.is_empty() || rest.starts_with('.'))
        };
        self.0.iter().filter(covers)
    }
}
