//! The identity of a configuration: its hashes.

use sha2::{Digest, Sha256};
use toml::{Table, Value};

use super::registry::{Effect, REGISTRY, Setting};
use super::{Config, PixelOrigin, Split, scene_name};
use crate::base::settings::IdleKind;
use crate::base::short_hash;
use crate::perturb::{PaperSite, Passes};

/// The scheme of hashes. Raise it when a default changes, and nothing is taken for what it was.
const SCHEME: &str = "augnerf 0.2.0";

impl Config {
    /// Returns a 12-digit content hash of [`Config::portable`].
    pub fn hash(&self) -> String {
        self.portable().text_hash()
    }

    /// Returns everything that can change a weight or a rendered held-out view, with the rest at its defaults. The scene
    /// counts by its name, not by its folder. How often a run logs, evaluates or saves does not count, nor do surfaces and the
    /// number of training views that it measures. Neither do regularizers of weight 0, and settings that the method does not read.
    pub fn portable(&self) -> Config {
        let mut named = self.named();
        named.regularizer.settle();
        let idle = named.idle();
        let mut portable = named.at_defaults(|setting| {
            setting.rule.effect != Effect::Numbers || idle.at(&setting.path).any(|idle| idle.kind != IdleKind::Noted)
        });
        portable.join_passes();
        portable
    }

    /// The coarse pass of a hash grid is never perturbed, so that `fine` and `both` are the same.
    fn join_passes(&mut self) {
        for site in PaperSite::ALL {
            if self.on_hash_grid() && self.perturb[site].passes == Passes::Fine {
                self.perturb[site].passes = Passes::Both;
            }
        }
    }

    /// Returns a name for all configurations whose steps take equally long. It omits what does not change the time of a
    /// step.
    pub fn step_shape(&self) -> String {
        let mut named = self.named();
        named.perturb.fill(1.0, 1, named.field.width);
        let idle = named.idle();
        let mut shape = named.at_defaults(|Setting { path, rule, .. }| {
            let is_of_steps = !rule.same_time && rule.effect != Effect::Path && !path.starts_with("eval.");
            !is_of_steps || idle.at(path).any(|idle| idle.kind != IdleKind::Noted)
        });
        shape.join_passes();
        shape.regularizer.weight = vec![1.0; shape.regularizer.kind.len()];
        for number in [&mut shape.train.sam_radius, &mut shape.train.clip_value, &mut shape.train.clip_norm] {
            *number = if *number > 0.0 { 1.0 } else { 0.0 };
        }
        shape.text_hash()
    }

    /// Returns a 12-digit hash of all settings that are not at their defaults. A setting that is added changes no hash.
    pub fn text_hash(&self) -> String {
        let mut read = self.clone();
        // What is left open is one of these, unless a scene's files say otherwise.
        read.data.split = read.data.split.filter(|split| *split != Split::Every);
        read.data.pixel_origin = read.data.pixel_origin.filter(|origin| *origin != PixelOrigin::Corner);
        let mut table = read.to_table();
        remove_equal(&mut table, &Config::default().to_table());
        short_hash(Sha256::new_with_prefix(format!("{SCHEME}\n{table}")))
    }

    /// Returns the configuration with the chosen settings at their defaults.
    pub(super) fn at_defaults(&self, chosen: impl Fn(&Setting) -> bool) -> Config {
        let (mut table, defaults) = (self.to_table(), Config::default().to_table());
        for Setting { path, .. } in REGISTRY.settings.iter().filter(|setting| chosen(setting)) {
            set_or_remove(&mut table, path, value_at(&defaults, path).cloned());
        }
        Config::from_table(&table).expect("defaults are values of settings")
    }

    /// Returns the configuration with its scene named after the folder, unless it has a name.
    fn named(&self) -> Config {
        let mut named = self.clone();
        if named.data.name.is_empty() {
            named.data.name = scene_name(&self.data);
        }
        named
    }
}

/// Returns the value at a dotted path.
pub fn value_at<'a>(table: &'a Table, path: &str) -> Option<&'a Value> {
    match path.split_once('.') {
        Some((section, rest)) => value_at(table.get(section)?.as_table()?, rest),
        None => table.get(path),
    }
}

/// Returns a table's values with their dotted paths. An empty section is a value.
pub fn leaves(table: &Table) -> Vec<(String, &Value)> {
    let mut found = Vec::new();
    for (key, value) in table {
        match value {
            Value::Table(inner) if !inner.is_empty() => {
                found.extend(leaves(inner).into_iter().map(|(path, value)| (format!("{key}.{path}"), value)));
            }
            value => found.push((key.clone(), value)),
        }
    }
    found
}

/// Sets the value at a dotted path, or removes it. Without its section there is nothing to do.
pub(super) fn set_or_remove(table: &mut Table, path: &str, value: Option<Value>) {
    let Some((section, rest)) = path.split_once('.') else {
        match value {
            Some(value) => table.insert(path.into(), value),
            None => table.remove(path),
        };
        return;
    };
    if let Some(inner) = table.get_mut(section).and_then(Value::as_table_mut) {
        set_or_remove(inner, rest, value);
    }
}

/// Removes the values that `defaults` has, too, and tables that are then empty.
fn remove_equal(table: &mut Table, defaults: &Table) {
    table.retain(|name, value| {
        let default = defaults.get(name);
        if let (Value::Table(inner), Some(Value::Table(defaults))) = (&mut *value, default) {
            remove_equal(inner, defaults);
            return !inner.is_empty();
        }
        Some(&*value) != default
    });
}

#[cfg(test)]
mod tests {
    use sha2::{Digest, Sha256};

    use crate::base::short_hash;
    use crate::settings::{Config, Preset, build, parse_assignment};

    fn set(preset: Option<&str>, texts: &[&str]) -> Config {
        let preset = preset.map(|name| Preset::parse(name).unwrap());
        let assignments: Vec<_> = texts.iter().map(|text| parse_assignment(text).unwrap()).collect();
        build(preset, None, &assignments).unwrap()
    }

    #[test]
    fn the_hash_follows_content_and_not_the_folder_above_the_scene() {
        let hash = |texts: &[&str]| set(None, texts).hash();
        assert_eq!(hash(&["data.dir=/a/fern"]), hash(&["data.dir=/b/c/fern"]));
        assert_ne!(hash(&["data.dir=/a/fern"]), hash(&["data.dir=/a/trex"]));
        assert_ne!(hash(&["seed=1"]), hash(&["seed=2"]));
        assert_eq!(hash(&["train.log_every=7"]), hash(&["eval.pictures=0"]));
        assert_eq!(hash(&["eval.mesh.resolution=64", "eval.mesh.box=[[-1,-1,-1],[1,1,1]]"]), hash(&[]));
        // What the default says counts as if nothing were said, and so do kinds that are left open.
        assert_eq!(hash(&["train.rays=1024", "data.split=every", "data.pixel_origin=corner"]), hash(&[]));
        // The perturbed pass counts only where there is one.
        assert_eq!(hash(&["perturb.lambda=1"]), hash(&[]));
        assert_ne!(hash(&["method=aug-nerf", "perturb.lambda=1"]), hash(&["method=aug-nerf"]));
    }

    /// Folders of runs and points of sweeps are known by these. If a default changed, raise the scheme.
    #[test]
    fn hashes_are_those_that_folders_are_known_by() {
        let aug = ["method=aug-nerf", "perturb.attack=calibrated", "perturb.rgb.passes=off"];
        for (preset, texts, hash) in [
            (None, &[][..], "398c42effb68"),
            (Some("smoke"), &["seed=3"], "362ceb78545b"),
            (Some("paper-llff"), &["seed=3"], "0a110bf6587d"),
            (Some("cpu"), &aug, "5bb8831133a2"),
        ] {
            assert_eq!(set(preset, texts).hash(), hash, "{preset:?} {texts:?}");
        }
        let defaults = Config::default().to_table().to_string();
        assert_eq!(
            short_hash(Sha256::new_with_prefix(defaults)),
            "1f2f42c211ab",
            "raise SCHEME, unless a setting was only added"
        );
    }

    #[test]
    fn what_a_hash_field_does_not_read_makes_no_other_experiment() {
        let hash = |texts: &[&str]| set(None, &[&["field.encoding=hash"], texts].concat()).hash();
        for unread in ["train.coarse_weight=0.5", "field.position_octaves=3"] {
            assert_eq!(hash(&[unread]), hash(&[]), "{unread}");
            assert_ne!(set(None, &[unread]).hash(), set(None, &[]).hash(), "{unread}");
        }
        let one_level = "field.hash.levels=1";
        assert_eq!(hash(&[one_level, "field.hash.finest=64"]), hash(&[one_level]));
        assert_ne!(hash(&["field.hash.finest=64"]), hash(&[]));
        // Only the fine pass has a perturbed one.
        let aug = "method=aug-nerf";
        assert_eq!(hash(&[aug, "perturb.t.passes=fine"]), hash(&[aug]));
        assert_ne!(hash(&[aug, "perturb.t.passes=off"]), hash(&[aug]));
        assert_ne!(set(None, &[aug, "perturb.t.passes=fine"]).hash(), set(None, &[aug]).hash());
    }

    /// Nor do sections of other methods, and those of fields in a method without.
    #[test]
    fn what_a_method_does_not_read_makes_no_other_experiment() {
        let hash = |method: &str, texts: &[&str]| set(Some("cpu"), &[&[method], texts].concat()).hash();
        let (nerf, srn, nv, llff) = ("method=nerf", "method=srn", "method=nv", "method=llff");
        for (method, unread) in [
            (nerf, "srn.width=64"),
            (nerf, "nv.divide=2"),
            (nerf, "llff.planes=16"),
            (srn, "field.width=32"),
            (srn, "sampling.coarse=7"),
            (srn, "perturb.lambda=0.5"),
            (srn, "train.coarse_weight=0.5"),
            (srn, "llff.planes=16"),
            (nv, "srn.width=64"),
            (nv, "nv.kl=1"),
            (llff, "train.rays=7"),
            (llff, "train.batching=one-image"),
            (llff, "field.encoding=hash"),
        ] {
            assert_eq!(hash(method, &[unread]), hash(method, &[]), "{method} {unread}");
        }
        for (method, read) in [
            (nerf, "field.width=32"),
            (srn, "srn.width=64"),
            (srn, "train.rays=7"),
            (nv, "nv.divide=2"),
            (nv, "nv.code=variational"),
            (llff, "llff.planes=16"),
        ] {
            assert_ne!(hash(method, &[read]), hash(method, &[]), "{method} {read}");
            let shape = |texts: &[&str]| set(Some("cpu"), &[&[method], texts].concat()).step_shape();
            assert_ne!(shape(&[read]), shape(&[]), "{method} {read}");
        }
        assert_eq!(hash(nv, &["nv.code=variational", "nv.kl=0.001"]), hash(nv, &["nv.code=variational"]));
        assert_eq!(hash(nv, &["nv.warp=false", "nv.warp_resolution=5"]), hash(nv, &["nv.warp=false"]));
    }

    /// Points outside the box leave the backward pass, and second derivatives take time.
    #[test]
    fn a_grid_s_box_and_interpolation_change_how_long_a_step_takes() {
        let shape = |text: &str| set(None, &["field.encoding=hash", text]).step_shape();
        let settings = [
            "field.hash.bounds=[[-1,-1,-1],[1,1,1]]",
            "field.hash.contraction=ball",
            "field.hash.interpolation=smoothstep",
            "seed=1",
        ];
        let shapes = settings.map(shape);
        assert!((0..4).all(|i| shapes[..i].iter().all(|other| *other != shapes[i])), "{shapes:?}");
        assert_eq!(shape("train.learning_rate=0.5"), shape("train.learning_rate=0.25"));
        let positional = |text: &str| set(None, &[text]).step_shape();
        assert_eq!(positional(settings[0]), positional(settings[3]));
    }
}
