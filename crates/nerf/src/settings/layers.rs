//! Presets, and the layers of settings that make one [`Config`].

use std::path::Path;

use toml::{Table, Value};

use super::identity::{leaves, value_at};
use super::registry::{REGISTRY, Setting, meant};
use super::{Config, DataConfig, Method, PerturbConfig, Placing, REGULARIZERS, over_run, word};
use crate::base::input::{TEXT_BYTES, read_named};
use crate::base::{Error, Result, number_text};

/// A named set of settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Preset {
    /// Half a minute to a minute on two cores, for any scene: a field on a hash grid.
    Fast,
    /// Seconds on two cores, for the built-in scene.
    Smoke,
    /// Minutes on two cores: width 64, 32 + 32 samples, 512 rays, 3,000 steps.
    Cpu,
    /// The paper's LLFF settings.
    PaperLlff,
    /// The paper's NeRF-Synthetic settings.
    PaperBlender,
    /// The released code's choices for LLFF scenes, with two radii that its defaults do not have (docs/paper.md).
    ReleasedLlff,
    /// The same for NeRF-Synthetic scenes.
    ReleasedBlender,
    /// Few photographs of any scene: the settings that a comparison over 24 scenes recommends, on a hash grid.
    FewViews,
    /// Few photographs as RegNeRF has them on LLFF scenes, on a hash grid.
    FewViewsLlff,
    /// Few photographs as DietNeRF has them on Blender's scenes, on a hash grid.
    FewViewsBlender,
}

/// The presets with their names on the command line, their files, and the sizes of methods without fields that suit them,
/// the general one first. Sizes name tables of `presets/srn.toml` and the like.
const PRESETS: [(Preset, &str, &str, &[&str]); 10] = [
    (Preset::Fast, "fast", include_str!("presets/fast.toml"), &["small"]),
    (Preset::Smoke, "smoke", include_str!("presets/smoke.toml"), &["small", "smoke"]),
    (Preset::Cpu, "cpu", include_str!("presets/cpu.toml"), &["small", "cpu"]),
    (Preset::PaperLlff, "paper-llff", include_str!("presets/paper-llff.toml"), &["paper"]),
    (Preset::PaperBlender, "paper-blender", include_str!("presets/paper-blender.toml"), &["paper"]),
    (Preset::ReleasedLlff, "released-llff", include_str!("presets/released-llff.toml"), &["paper"]),
    (Preset::ReleasedBlender, "released-blender", include_str!("presets/released-blender.toml"), &["paper"]),
    (Preset::FewViews, "few-views", include_str!("presets/few-views.toml"), &["small", "few-views"]),
    (Preset::FewViewsLlff, "few-views-llff", include_str!("presets/few-views-llff.toml"), OF_PAPERS),
    (Preset::FewViewsBlender, "few-views-blender", include_str!("presets/few-views-blender.toml"), OF_PAPERS),
];

/// The table of a layer for `sampling.kind = "occupancy"`.
const OCCUPIED: &str = "occupied";

const OF_PAPERS: &[&str] = &["small", "few-views-of-papers"];

impl Preset {
    /// Iterates over all presets with their names on the command line.
    pub fn all() -> impl Iterator<Item = (&'static str, Preset)> {
        PRESETS.iter().map(|(preset, name, ..)| (*name, *preset))
    }

    /// Returns the preset of a name.
    pub fn parse(name: &str) -> Result<Preset> {
        let found = Preset::all().find(|(known, _)| *known == name);
        found.map(|(_, preset)| preset).ok_or_else(|| {
            let names: Vec<&str> = Preset::all().map(|(known, _)| known).collect();
            Error::Config(format!("preset '{name}' does not exist; choose one of {}", names.join(", ")))
        })
    }

    /// Returns the settings of the preset.
    pub(super) fn table(self) -> Table {
        toml::from_str(self.file().0).expect("presets are valid TOML")
    }

    fn file(self) -> (&'static str, &'static [&'static str]) {
        let row = PRESETS.iter().find(|(preset, ..)| *preset == self);
        row.map(|(_, _, text, sizes)| (*text, *sizes)).expect("each preset has a row")
    }
}

/// Returns the layer between preset and file, for the method and the encoding that the settings name. Later layers are
/// searched first.
fn representation_layer(layers: [&Table; 2], preset: Option<Preset>) -> Option<Table> {
    let named = |path: &str| layers.iter().find_map(|layer| value_at(layer, path)).cloned();
    let method = named("method").map_or(Some(Method::default()), |method| method.try_into::<Method>().ok())?;
    let encoding = named("field.encoding").map_or(Some(method.encoding()), |encoding| encoding.try_into().ok())?;
    let is_occupied = named("sampling.kind").is_some_and(|kind| kind == word(Placing::Occupancy).into());
    let of_preset = preset.map_or(&["paper"][..], |preset| preset.file().1);
    let sizes: Vec<&str> = is_occupied.then_some(OCCUPIED).into_iter().chain(of_preset.iter().copied()).collect();
    Some(sized(method.representation(encoding)?.layer()?, &sizes))
}

/// Returns a method's layer with its tables of some sizes.
fn sized(layer: &str, sizes: &[&str]) -> Table {
    let mut layer: Table = toml::from_str(layer).expect("presets are valid TOML");
    let own: Vec<Value> = sizes.iter().filter_map(|size| layer.remove(*size)).collect();
    // What remains besides sections are other sizes.
    layer.retain(|name, _| REGISTRY.knows(name));
    own.into_iter().filter_map(|own| own.try_into().ok()).for_each(|own| merge(&mut layer, own));
    layer
}

/// More parts than the name of any setting has.
const DEEPEST: usize = 8;

/// Splits `a.b=v` into its path and its value. Text is taken as it is typed, and a number without a fraction as a whole
/// number where the setting is one. Any other value that is not TOML (a bare word) becomes a string.
pub fn parse_assignment(text: &str) -> Result<(Vec<String>, Value)> {
    let Some((key, value)) = text.split_once('=') else {
        return Err(Error::Config(format!("--set {text}: write it as section.field=value, such as train.steps=2000")));
    };
    let path: Vec<String> = key.trim().split('.').map(|part| part.trim().to_string()).collect();
    if path.iter().any(String::is_empty) {
        return Err(Error::Config(format!("--set {text}: '{key}' is not a setting; write it as section.field=value")));
    }
    let value = typed(value.trim(), REGISTRY.get(&path.join(".")));
    Ok((path, value))
}

/// Largest whole number that a float holds exactly, with all below.
const MOST_EXACT: f64 = 9_007_199_254_740_992.0;

/// Returns what was typed as a value of the setting's type.
fn typed(text: &str, setting: Option<&Setting>) -> Value {
    let is = |kind: &str| setting.is_some_and(|setting| setting.kind == kind);
    let parsed = toml::from_str::<Table>(&format!("v = {text}")).ok().and_then(|mut table| table.remove("v"));
    // `.5`, which TOML does not have.
    let begins = text.trim_start_matches(['+', '-']).starts_with(|c: char| c.is_ascii_digit() || c == '.');
    let number = || text.parse::<f64>().ok().filter(|number| begins && number.is_finite()).map(Value::Float);
    match parsed.or_else(number) {
        Some(Value::String(text)) => Value::String(text),
        Some(_) if is("text") => Value::String(text.into()),
        Some(Value::Float(whole)) if is("whole number") && whole.fract() == 0.0 && whole.abs() <= MOST_EXACT => {
            Value::Integer(whole as i64)
        }
        Some(value) => value,
        None => Value::String(text.into()),
    }
}

/// Layers preset, the named method's settings, file and assignments over the defaults, and checks the result.
/// Assignments are `(path, value)` in order. Over the file of a run, numbers that belong to a value that is assigned anew,
/// such as the attack's, are those of the new value. A preset's weight does not go to another term.
///
/// ```
/// # mod augnerf { pub use augnerf_base as base; pub use augnerf_nerf::*; }
/// use augnerf::settings::{Preset, build, parse_assignment};
///
/// let steps = parse_assignment("train.steps=20")?;
/// let config = build(Some(Preset::Smoke), None, &[steps])?;
/// assert_eq!((config.train.steps, config.field.width), (20, 64));
///
/// let unknown = parse_assignment("train.stepz=20")?;
/// let refusal = build(None, None, &[unknown]).unwrap_err();
/// assert!(refusal.to_string().contains("train.steps"));
/// # Ok::<(), augnerf::base::Error>(())
/// ```
pub fn build(preset: Option<Preset>, file: Option<&Path>, assignments: &[(Vec<String>, Value)]) -> Result<Config> {
    let mut base = preset.map_or_else(Table::new, Preset::table);
    let mut table = file.map_or_else(|| Ok(Table::new()), read)?;
    check_passes(&table, assignments)?;
    let mut given = Table::new();
    assignments.iter().try_for_each(|(path, value)| assign(&mut given, path, value.clone()))?;
    over_run::reopen(&mut table, &given);
    merge(&mut table, given);
    if let Some(layer) = representation_layer([&table, &base], preset) {
        merge(&mut base, layer);
    }
    over_run::forget_term(&mut base, &table);
    merge(&mut base, table);
    Config::from_toml(&base.to_string(), "settings")
}

/// Returns an error for passes that `perturb.levels` would ignore: those set after it, and in a file also those beside it.
fn check_passes(file: &Table, assignments: &[(Vec<String>, Value)]) -> Result<()> {
    let last = assignments.iter().rposition(|(path, _)| path.join(".") == "perturb.levels");
    let (levels, mut named, later) = match last {
        Some(last) => (Some(&assignments[last].1), Table::new(), &assignments[last + 1..]),
        None => (value_at(file, "perturb.levels"), file.clone(), assignments),
    };
    later.iter().try_for_each(|(path, value)| assign(&mut named, path, value.clone()))?;
    PerturbConfig::check_levels(levels, &named)
}

/// Reads a configuration file.
fn read(path: &Path) -> Result<Table> {
    let text = read_named(path, TEXT_BYTES)
        .map_err(|e| Error::Config(format!("cannot read the configuration file {}: {e}", path.display())))?;
    let wrong = |e: toml::de::Error| Error::Config(format!("{}: {e}", path.display()));
    let layer = toml::from_str(&text).map_err(wrong)?;
    check_keys(&layer, &path.display().to_string())?;
    // Also checks types and choices, while the file and its lines can still be named.
    toml::from_str::<Config>(&text).map_err(wrong)?;
    Ok(layer)
}

/// Returns section `data` of the defaults with assignments over them. It decides the preset if none is named. Nothing
/// else is checked yet.
pub fn data_section(assignments: &[(Vec<String>, Value)]) -> Result<DataConfig> {
    let mut table = Table::new();
    for (path, value) in assignments.iter().filter(|(path, _)| path[0] == "data") {
        assign(&mut table, path, value.clone())?;
    }
    Ok(Config::from_table(&table).expect("each assignment was checked").data)
}

/// Merges `over` into `base`, table by table.
fn merge(base: &mut Table, over: Table) {
    for (key, value) in over {
        match (base.get_mut(&key), value) {
            (Some(Value::Table(inner)), Value::Table(over)) => merge(inner, over),
            (_, value) => {
                base.insert(key, value);
            }
        }
    }
}

fn assign(table: &mut Table, path: &[String], value: Value) -> Result<()> {
    merge(table, layer_of("--set", path, value)?);
    Ok(())
}

/// Checks one assignment by itself. `origin` begins the error: `--set`, or the part of a sweep file that holds it.
///
/// # Errors
/// [`Error::Config`]: no such setting, or a value of another type.
pub fn check_assignment(origin: &str, path: &[String], value: &Value) -> Result<()> {
    layer_of(origin, path, value.clone()).map(|_| ())
}

/// Returns the layer that sets one setting.
fn layer_of(origin: &str, path: &[String], value: Value) -> Result<Table> {
    let name = path.join(".");
    let origin = format!("{origin} {name}");
    if path.len() > DEEPEST {
        return Err(Error::Config(format!("{origin}: no setting has a name of {} parts", path.len())));
    }
    let mut layer = Table::new();
    let (last, parents) = path.split_last().expect("an assignment has a key");
    let shown = match &value {
        Value::String(text) => text.clone(),
        Value::Float(number) => number_text(*number),
        other => other.to_string(),
    };
    if REGISTRY.sections.iter().any(|row| row.path == name) && !value.is_table() {
        let inner = REGISTRY.settings.iter().find(|setting| setting.path.starts_with(&format!("{name}.")));
        let inner = inner.map_or("", |setting| &setting.path);
        return Err(Error::Config(format!(
            "{origin}: '{shown}' is the value of a setting, and {name} is a section; set one of its settings, such as {inner}"
        )));
    }
    layer.insert(last.clone(), value);
    for parent in parents.iter().rev() {
        let inner = std::mem::take(&mut layer);
        layer.insert(parent.clone(), Value::Table(inner));
    }
    check_keys(&layer, &origin)?;
    // Checked alone first, so that the message can name the assignment.
    Config::from_table(&layer).map_err(|e| {
        let set = if origin.starts_with("--") { "--set " } else { "" };
        let hint = regularizer_hint(&shown, set).filter(|_| name == "method");
        Error::Config(format!("{origin}: {}", hint.unwrap_or_else(|| refusal(&name, &shown, e.message()))))
    })?;
    Ok(layer)
}

/// Returns how the regularizer of a name is set that stands in the place of a method, or `None` if there is none. `set`
/// stands before the setting.
pub fn regularizer_hint(name: &str, set: &str) -> Option<String> {
    let is_named = REGULARIZERS.iter().any(|term| term.name() == name);
    is_named.then(|| format!("{name} is a regularizer; use {set}regularizer.kind={name}"))
}

/// Says that a value has the wrong type, and what is allowed; otherwise what the check of the setting says.
fn refusal(path: &str, value: &str, message: &str) -> String {
    let starts = ["invalid type", "unknown variant", "invalid value", "expected "];
    // "expected a ..." is a setting's own sentence.
    let of_type = starts.iter().any(|start| message.starts_with(start)) && !message.starts_with("expected a ");
    let Some(setting) = REGISTRY.get(path).filter(|setting| of_type && !setting.kind.is_empty()) else {
        return message.into();
    };
    let kind = match setting.kind.as_str() {
        "whole number" => "a whole number from 0".into(),
        "number" => "a number".into(),
        kind if kind.ends_with("text") && !setting.rule.allowed.is_empty() => setting.rule.allowed.into(),
        kind @ ("text" | "true or false") => kind.into(),
        kind if kind.starts_with('[') => kind.into(),
        kind if kind.starts_with("list of: ") => {
            let names = &kind["list of: ".len()..];
            let one =
                names.rsplit_once(", ").map_or(format!("a {names}"), |(first, last)| format!("{first} or {last}"));
            format!("{one}, nor a list of them; [] is none")
        }
        choices => format!("one of {choices}"),
    };
    let value: String = value.chars().take(80).collect();
    format!("'{value}' is not {kind}")
}

/// Returns an error for unknown keys, with the nearest known one. serde's own message lists fields but not the path.
fn check_keys(layer: &Table, origin: &str) -> Result<()> {
    let unknown = leaves(layer).into_iter().find(|(key, _)| !REGISTRY.knows(key));
    unknown.map_or(Ok(()), |(key, _)| {
        // A very long name is cut: its beginning is enough.
        let key: String = key.chars().take(200).collect();
        Err(Error::Config(format!("{origin}: unknown key '{key}'; did you mean {}?", meant(&key))))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perturb::PaperSite;
    use crate::settings::{Batching, TrainConfig};

    fn set(texts: &[&str]) -> Result<Config> {
        let assignments: Result<Vec<_>> = texts.iter().map(|t| parse_assignment(t)).collect();
        build(None, None, &assignments?)
    }

    #[test]
    fn every_format_names_a_preset() {
        crate::data::FORMATS
            .iter()
            .for_each(|format| assert!(Preset::parse(format.preset).is_ok(), "{}", format.preset));
    }

    #[test]
    fn assignments_reach_nested_fields_and_later_ones_win() {
        let config = set(&["train.steps=7", "perturb.t.epsilon=0.25", "data.dir=a b", "train.steps=9"]).unwrap();
        assert_eq!(config.train.steps, 9);
        assert_eq!(config.perturb[PaperSite::T].epsilon, Some(0.25.into()));
        assert_eq!(config.data.dir, "a b");
    }

    /// People type values as they would anywhere.
    #[test]
    fn values_are_read_as_they_are_meant() {
        let typed =
            ["data.name=360", "train.steps=1e4", "regularizer.kind=tv", "regularizer.weight=.5", "train.rays=+6.4e1"];
        let config = set(&typed).unwrap();
        assert_eq!((config.data.name.as_str(), config.train.steps, config.train.rays), ("360", 10_000, 64));
        assert_eq!(config.regularizer.weight, [0.5]);
        for name in ["2024-01-01", "true", "[a]", "1_000", "'quoted'"] {
            let config = set(&[&format!("data.name={name}")]).unwrap();
            assert_eq!(config.data.name, name.trim_matches('\''));
        }
        for (wrong, words) in [
            ("train.steps=many", "--set train.steps: 'many' is not a whole number"),
            ("train.steps=1.5", "'1.5' is not a whole number"),
            ("train.steps=-3", "'-3' is not a whole number"),
            ("field.width=heavy", "'heavy' is not a whole number"),
            ("data.near=close", "'close' is not a number"),
            ("sampling.jitter=yes", "'yes' is not true or false"),
            ("method=nerv", "'nerv' is not one of nerf, aug-nerf, "),
            ("method=tv", "--set method: tv is a regularizer; use --set regularizer.kind=tv"),
            ("train.steps=1e30", "'1e30' is not a whole number"),
            ("train.learning_rate=-1e300", "train.learning_rate = -1e300 is out of range"),
            ("train.learning_rate=nan", "train.learning_rate = NaN is out of range: it must be positive"),
            ("field.width=7", "field.width = 7 is out of range: it must be even"),
            ("data.holdout=1", "at least 2"),
            ("field.skips=[8]", "1 to 7"),
            ("perturb.t.epsilon=0.6", "perturb.t.epsilon = 0.6 is out of range: it must be 0 to 0.5"),
            ("regularizer.kind=none", "orientation or sparse-depth, nor a list of them; [] is none"),
            (
                "regularizer=tv",
                "'tv' is the value of a setting, and regularizer is a section; set one of its settings, such as \
              regularizer.kind",
            ),
            ("perturb.levels=rgb", "perturb.levels: 'rgb' is not input, feature or output, nor a list of them"),
            ("perturb.steps=0", "'perturb.t.steps' or 'perturb.xyz.steps' or "),
            ("regularizer.kind=['tv','tv']", "regularizer.kind names tv twice; name each term once"),
            ("regularizer.weight=1", "regularizer.weight has 1 number and regularizer.kind names 0 terms"),
            ("field.skips=[3,3]", "field.skips names layer 3 twice; name each layer once"),
            ("TRAIN.STEPS=5", "did you mean 'train.steps'?"),
            ("Data.Dir=x", "did you mean 'data.dir'?"),
        ] {
            let message = set(&[wrong]).unwrap_err().to_string();
            assert!(message.contains(words), "{wrong}: {message}");
        }
    }

    /// A misspelt table would be left out in silence.
    #[test]
    fn tables_of_layers_are_sections_or_sizes() {
        let is_size = |name: &str| name == OCCUPIED || PRESETS.iter().any(|(.., sizes)| sizes.contains(&name));
        for method in Method::ALL {
            let Some(layer) = method.representation(method.encoding()).and_then(|found| found.layer()) else {
                continue;
            };
            let layer: Table = toml::from_str(layer).unwrap();
            assert!(layer.keys().all(|name| REGISTRY.knows(name) || is_size(name)), "{}: {layer:?}", method.name());
        }
    }

    /// Occupied cells have tables and intervals of their own, over which few views and settings lie.
    #[test]
    fn occupied_cells_have_settings_of_their_own() {
        let of = |preset: Preset, settings: &[&str]| {
            let settings: Vec<_> = settings.iter().map(|text| parse_assignment(text).unwrap()).collect();
            let config = build(Some(preset), None, &settings).unwrap();
            (config.train.rays, config.field.hash.log2_table, config.sampling.occupancy.intervals)
        };
        let occupied = "sampling.kind=occupancy";
        assert_eq!(of(Preset::Fast, &[occupied]), (1024, 15, 192));
        assert_eq!(of(Preset::Fast, &[occupied, "field.hash.log2_table=16"]), (1024, 16, 192));
        assert_eq!(of(Preset::FewViews, &[occupied]), (128, 15, 192));
        assert_eq!(of(Preset::Fast, &[]), (1024, 17, 256));
    }

    /// A method without fields has its own size for a preset; the original's where none is named.
    #[test]
    fn methods_without_fields_have_a_size_for_each_preset() {
        let method = |name: &str, preset| build(preset, None, &[parse_assignment(&format!("method={name}")).unwrap()]);
        let of = |name: &str, preset| method(name, preset).unwrap().train;
        for preset in [None, Some(Preset::PaperBlender), Some(Preset::ReleasedLlff)] {
            let (srn, nv) = (of("srn", preset), of("nv", preset));
            assert_eq!((srn.rays, srn.learning_rate, srn.steps, srn.decay_rate), (262_144, 5e-5, 175_000, 1.0));
            assert_eq!((nv.rays, nv.learning_rate, nv.steps, nv.decay_rate), (262_144, 1e-4, 500_000, 1.0));
            // More rays than one picture has.
            let batches = |train: &TrainConfig| (train.batching, train.precrop_steps);
            assert_eq!([batches(&srn), batches(&nv)], [(Some(Batching::AllImages), Some(0)); 2]);
        }
        // An SRN has nothing that a plain background could empty.
        let small = of("srn", Some(Preset::Cpu));
        assert_eq!((small.batching, small.precrop_steps), (Some(Batching::AllImages), Some(0)));
        assert_eq!(of("nv", Some(Preset::Cpu)).batching, None);
        let steps = ["srn", "nv", "llff"].map(|name| [Preset::Cpu, Preset::Fast].map(|p| of(name, Some(p)).steps));
        assert_eq!(steps, [[10_000, 1_500], [5_000, 1_500], [1_500, 1_500]]);
        let nv = |preset| method("nv", Some(preset)).unwrap().nv;
        let sides = [Preset::PaperLlff, Preset::Cpu, Preset::Smoke].map(|p| (nv(p).resolution, nv(p).divide));
        assert_eq!(sides, [(128, 1), (64, 4), (32, 4)]);
        for (name, preset) in Preset::all() {
            for baseline in ["srn", "nv", "llff"] {
                // The preset is its term, and these methods have none.
                if preset == Preset::FewViews {
                    let refusal = method(baseline, Some(preset)).unwrap_err().to_string();
                    assert!(refusal.contains("regularizer.kind = \"occlusion\" with method"), "{refusal}");
                    continue;
                }
                let config = method(baseline, Some(preset)).unwrap_or_else(|e| panic!("{name}, {baseline}: {e}"));
                assert_eq!(Config::from_toml(&config.to_toml(), name).unwrap(), config, "{name}, {baseline}");
            }
        }
    }

    #[test]
    fn every_preset_is_valid_and_survives_being_written_out() {
        for (name, preset) in Preset::all() {
            let config = build(Some(preset), None, &[]).unwrap_or_else(|e| panic!("{name}: {e}"));
            assert_eq!(Config::from_toml(&config.to_toml(), name).unwrap(), config, "{name}");
        }
    }

    #[test]
    fn the_released_presets_are_the_released_code() {
        for preset in [Preset::ReleasedLlff, Preset::ReleasedBlender] {
            let mut config = build(Some(preset), None, &[]).unwrap();
            let numbers = config.perturb.fill(0.1, 1, 512);
            let p = &config.perturb;
            assert_eq!((p.lambda, p.injection_layer, p.perturb_last), (0.5, 8, true));
            assert_eq!(p.output, crate::settings::OutputPlace::Before);
            for site in [PaperSite::Feature, PaperSite::Density] {
                let numbers = numbers[site];
                assert_eq!((numbers.pgd.steps, numbers.pgd.step_size, numbers.epsilon), (1, 1e-5, 1e-5.into()));
            }
            let on: Vec<PaperSite> = p.sites_on().map(|(site, _)| site).collect();
            assert_eq!(on, [PaperSite::T, PaperSite::Xyz, PaperSite::Feature, PaperSite::Density]);
            assert!(!config.sampling.jitter);
        }
    }
}
