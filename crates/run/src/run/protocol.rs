//! The protocol of a run: provenance that accompanies each of its numbers.

use serde::ser::{Serialize, SerializeMap, Serializer};
use serde_json::Value;

use crate::base::distinct;
use crate::data::{Camera, RayGroup, Scene, View, epochs};
use crate::methods::step_over_radius;
use crate::metrics::{Lpips, share};
use crate::model::Model;
use crate::perturb::{PaperSite, Passes, PerSite, SiteNumbers};
use crate::revision::version;
use crate::settings::columns::{COLUMNS, applies, find, perturbed, regularized};
use crate::settings::registry::REGISTRY;
use crate::settings::{
    Config, Core, Encoding, EvalSplit, HashConfig, LatticePoints, OccupancyConfig, PerturbConfig, Placing, Precision,
    Regularizer, RegularizerConfig, Representation, Resolved, SamDirection, SamplingConfig, Schedule, TermRays,
    TrainConfig, TrainViews, WeightSchedule, value_at, word,
};
use crate::train::checkpoint::State;

use super::columns::cell;
use super::surface;

/// Version of the evaluation protocol; numbers of different versions are not comparable.
pub const PROTOCOL: u32 = 1;

/// The columns that need the photos' pixels. They are empty for a scene that is not read.
pub(super) const OF_PIXELS: [&str; 2] = ["data_hash", "masks"];

/// Provenance of a number: everything that two numbers must share to be compared. Has a value for each of [`COLUMNS`],
/// in their order.
#[derive(Clone, Debug, PartialEq)]
pub struct Protocol(Vec<(&'static str, Value)>);

impl Serialize for Protocol {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.0.len()))?;
        self.0.iter().try_for_each(|(name, value)| map.serialize_entry(name, value))?;
        map.end()
    }
}

impl Protocol {
    /// Returns the protocol of a run at a checkpoint's state.
    pub fn new(config: &Resolved, scene: &Scene, state: &State) -> Protocol {
        let table = config.to_table();
        let found = [of_settings(config), of_scene(config, scene), of_state(config, scene, state)].concat();
        let value = |name: &'static str| {
            let column = find(name).expect("a column");
            if !applies(column, config) {
                return Value::Null;
            }
            let set = column.setting(&REGISTRY).and_then(|setting| value_at(&table, &setting.path));
            let set = set.map(|value| serde_json::to_value(value).expect("plain data"));
            let own = || found.iter().find(|(known, _)| *known == name).map(|(_, value)| value.clone());
            set.or_else(own).unwrap_or_default()
        };
        Protocol(COLUMNS.iter().map(|column| (column.name, value(column.name))).collect())
    }

    /// Returns as text the columns about scene and views. Nothing else is known of images that were rendered
    /// elsewhere.
    pub fn of_views(config: &Resolved, scene: &Scene) -> Vec<(&'static str, String)> {
        const OF_VIEWS: [&str; 9] =
            ["protocol", "dataset", "scene", "width", "height", "background", "split", "views_evaluated", "data_hash"];
        let found = [of_settings(config), of_scene(config, scene)].concat();
        let known = |name| found.iter().find(|(known, _)| *known == name).map(|(_, value)| cell(value));
        OF_VIEWS.into_iter().filter_map(|name| Some((name, known(name)?))).collect()
    }

    /// Adds the LPIPS backbones of an evaluation.
    pub fn with_lpips(mut self, lpips: &[Lpips]) -> Protocol {
        let named = lpips.iter().map(|lpips| format!("{} {}", lpips.backbone().name(), lpips.weights_hash()));
        let named = (!lpips.is_empty()).then(|| named.collect::<Vec<String>>().join(", "));
        self.set("lpips_weights", named.into());
        self
    }

    /// Returns a column's value.
    ///
    /// # Panics
    /// If there is no such column.
    pub fn get(&self, column: &str) -> &Value {
        let known = self.0.iter().find(|(name, _)| *name == column);
        &known.unwrap_or_else(|| panic!("{column} is not a column of the protocol")).1
    }

    /// Returns a column's value as text; empty for none.
    pub fn text(&self, column: &str) -> String {
        cell(self.get(column))
    }

    /// Sets a column.
    ///
    /// # Panics
    /// If there is no such column.
    pub fn set(&mut self, column: &str, value: Value) {
        let known = self.0.iter_mut().find(|(name, _)| *name == column);
        known.unwrap_or_else(|| panic!("{column} is not a column of the protocol")).1 = value;
    }
}

/// Columns and their values.
type Found = Vec<(&'static str, Value)>;

/// Returns the columns that combine several settings.
fn of_settings(config: &Resolved) -> Found {
    let perturb = Some(&config.perturb).filter(|_| perturbed(config));
    let regularizer = Some(&config.regularizer).filter(|_| regularized(config));
    let in_space = regularizer.filter(|regularizer| regularizer.has_space_terms());
    vec![
        ("protocol", PROTOCOL.into()),
        ("scene", config.data.name.clone().into()),
        ("training_views", training_views(config).into()),
        ("validation", (config.data.validation > 0).then(|| format!("every-{}", config.data.validation)).into()),
        ("levels", perturb.map(|perturb| levels(perturb, config.representation())).into()),
        ("attack_numbers", perturb.map(|_| attack_numbers(&config.numbers)).into()),
        ("norms", perturb.map(|_| norms(&config.numbers)).into()),
        ("regularizers", regularizer.map(regularizers).into()),
        ("unseen", regularizer.and_then(|_| unseen(config)).into()),
        ("regularizer_points", in_space.map(regularizer_points).into()),
        ("regularizer_domain", in_space.map(|regularizer| format!("{:?}", regularizer.domain)).into()),
        ("learning_rate", learning_rate(config).into()),
        ("adam", adam(&config.train).into()),
        ("anneal", anneal(config).into()),
        ("clip", clip(&config.train).into()),
        ("sam", sam(&config.train).into()),
        ("srn", config.srn.text().into()),
        ("nv", config.nv.text().into()),
        ("llff", config.llff.text().into()),
        ("hash_grid", (config.field.encoding == Encoding::Hash).then(|| hash_grid(&config.field.hash)).into()),
        (
            "occupancy",
            (config.sampling.kind == Placing::Occupancy).then(|| occupancy(&config.sampling.occupancy)).into(),
        ),
        ("config_hash", config.hash().into()),
        ("program", version().into()),
    ]
}

/// Returns the name of the colour behind transparent pixels, `none` for a scene without them.
pub(super) fn background(scene: &Scene) -> &'static str {
    match scene.background {
        None => "none",
        Some([1.0, 1.0, 1.0]) => "white",
        Some(_) => "black",
    }
}

/// Returns the columns of the loaded scene.
fn of_scene(config: &Resolved, scene: &Scene) -> Found {
    let corrupted = scene.corrupted.as_ref();
    let data_hash = corrupted.map_or_else(|| scene.is_read().then(|| scene.hash()), |it| Some(it.clean_hash.clone()));
    vec![
        ("dataset", scene.kind.into()),
        ("split", split_name(config, scene.lacks_split).into()),
        ("width", side(scene, |camera| camera.width)),
        ("height", side(scene, |camera| camera.height)),
        ("background", background(scene).into()),
        ("ndc", scene.ndc.is_some().into()),
        ("views_trained", scene.train.len().into()),
        ("views_evaluated", scene.test.len().into()),
        ("views_seen", config.seen_views(scene).len().into()),
        ("data_hash", data_hash.into()),
        ("corruption", corrupted.map(|corrupted| corrupted.what.clone()).into()),
        ("corruption_hash", corrupted.map(|_| scene.hash()).into()),
        ("mesh", surface::describe(config, scene).into()),
        ("masks", masks(scene).into()),
        ("step_over_radius", perturbed(config).then(|| ratios(config, scene)).into()),
    ]
}

/// Returns one side of the evaluated views in pixels. If views differ, returns the sides in the order of the views:
/// `1080/1920`.
fn side(scene: &Scene, of: fn(&Camera) -> usize) -> Value {
    let views = if scene.test.is_empty() { &scene.train } else { &scene.test };
    let text = sides(views.iter().map(|view| of(&view.camera)));
    text.parse::<usize>().map_or(text.into(), Value::from)
}

/// Joins the distinct sides in their order: `800`, `1080/1920`; `0` if there are none.
fn sides(all: impl Iterator<Item = usize>) -> String {
    let different = distinct(all);
    if different.is_empty() { "0".into() } else { different.iter().map(usize::to_string).collect::<Vec<_>>().join("/") }
}

/// Returns in words how much of the views is masked, or `None` if nothing is.
fn masks(scene: &Scene) -> Option<String> {
    let of = |views: &[View]| {
        let views = views.iter().map(|view| 1.0 - share(view.mask.as_deref()));
        let (count, sum) = views.fold((0, 0.0), |(count, sum), share| (count + 1, sum + share));
        format!("{:.2} %", 100.0 * sum / f64::from(count.max(1)))
    };
    let any = scene.train.iter().chain(&scene.test).any(|view| view.mask.is_some());
    any.then(|| format!("{} of trained, {} of evaluated pixels left out", of(&scene.train), of(&scene.test)))
}

/// Returns the columns of the run's progress and devices.
fn of_state(config: &Resolved, scene: &Scene, state: &State) -> Found {
    let redraws = Model::parts(config).into_iter().zip(&state.redraws).map(|(role, draws)| format!("{role} {draws}"));
    let by_device = |of: fn(&str) -> &'static str| {
        let mut all: Vec<&str> = state.devices.iter().map(|device| of(device)).collect();
        all.dedup();
        all.join(" + ")
    };
    // The fused core runs on CPUs; see `Field::prepared`. A GPU has kernels of its own.
    let on_gpu = state.devices.iter().any(|device| device == "gpu");
    let core = match config.field.core {
        Core::Plain if on_gpu => by_device(|device| if device == "gpu" { "gpu" } else { "plain" }),
        Core::Plain => "plain".into(),
        Core::Fused => by_device(|device| match device {
            "cpu" => "fused",
            "gpu" => "gpu",
            _ => "plain",
        }),
    };
    let precision = match config.field.precision {
        Precision::Bf16 => "bf16".into(),
        Precision::F16 => "f16".into(),
        Precision::F32 => by_device(|device| if device == "cuda-tf32" { "tf32" } else { "f32" }),
    };
    let seen = scene.training_pixels().and_then(|pixels| epochs(config.rays_of_steps(state.step), pixels));
    vec![
        ("steps", state.step.into()),
        ("epochs", seen.into()),
        ("redraws", redraws.collect::<Vec<String>>().join(", ").into()),
        ("code_revision", state.revisions.join(" + ").into()),
        ("device", devices(state).into()),
        ("core", core.into()),
        ("precision", precision.into()),
        ("instructions", state.instructions.join(" + ").into()),
    ]
}

/// Returns the kinds of devices, a GPU with its adapters: `cpu + gpu (NVIDIA H200, Vulkan, driver 580.159)`.
fn devices(state: &State) -> String {
    let named = state.devices.iter().map(|device| match device.as_str() {
        "gpu" if !state.adapters.is_empty() => format!("gpu ({})", state.adapters.join("; ")),
        device => device.to_string(),
    });
    named.collect::<Vec<String>>().join(" + ")
}

/// Returns a learning rate and its schedule in words.
fn learning_rate(config: &Resolved) -> String {
    let train = &config.train;
    let start = train.learning_rate;
    match train.schedule {
        Schedule::Exponential if train.decay_rate == 1.0 => format!("{start}, constant"),
        Schedule::Exponential => format!("{start}, times {} every {}", train.decay_rate, config.decay_steps),
        Schedule::LogLinear => format!("{start} to {}", train.final_learning_rate),
    }
}

/// Returns levels, features, table, resolutions, interpolation and box of a hash grid.
fn hash_grid(hash: &HashConfig) -> String {
    let HashConfig { levels, features, log2_table, coarsest, finest, interpolation, bounds, contraction } = hash;
    let interpolation = word(interpolation);
    let finest = finest.filter(|_| *levels > 1).map_or_else(String::new, |finest| format!(" to {finest}"));
    let place = bounds.map_or_else(String::new, |bounds| format!(", box {bounds:?}"));
    let contraction =
        contraction.map_or_else(String::new, |contraction| format!(", contraction {}", word(contraction)));
    format!("{levels} x {features}, 2^{log2_table}, {coarsest}{finest}, {interpolation}{place}{contraction}")
}

/// Returns intervals, cells, threshold, decay, looks, first rays and the light behind which samples are hidden.
fn occupancy(config: &OccupancyConfig) -> String {
    let OccupancyConfig { intervals, first_rays, cells, threshold, decay, refresh, warmup, transmittance } = config;
    format!(
        "{intervals} intervals, {cells}^3 cells from depth {threshold}, decay {decay} every {refresh} steps, all of them in the first \
         {warmup}, from {first_rays} rays, hidden below {transmittance}"
    )
}

/// Returns which training views were used, or `None` for all.
fn training_views(config: &Config) -> Option<String> {
    config.data.train_views.as_ref().map(|views| match views {
        TrainViews::Number(number) => format!("{number} drawn"),
        TrainViews::Ruled(ruled) => String::from(*ruled),
        TrainViews::Named(names) => names.join(" "),
    })
}

/// Returns the active sites, each with its pass if it takes part in only one.
fn levels(perturb: &PerturbConfig, representation: Representation) -> String {
    let named = perturb.sites_on().map(|(site, config)| match config.passes {
        Passes::Coarse => format!("{}:coarse", site.name()),
        Passes::Fine => format!("{}:fine", site.name()),
        // A coarse pass that only places samples is not perturbed.
        Passes::Both if !representation.has_coarse_loss() => format!("{}:fine", site.name()),
        Passes::Both | Passes::Off => site.name().to_string(),
    });
    named.collect::<Vec<String>>().join(" ")
}

fn attack_numbers(numbers: &PerSite<SiteNumbers>) -> String {
    let on = numbers.iter().filter(|(_, numbers)| numbers.on());
    let numbers = on.map(|(site, numbers)| {
        format!("{} {}/{}/{}", site.name(), numbers.pgd.steps, numbers.pgd.step_size, numbers.epsilon)
    });
    numbers.collect::<Vec<String>>().join(", ")
}

/// Returns step size over radius of each site, with three digits.
fn ratios(config: &Resolved, scene: &Scene) -> String {
    let ratios = step_over_radius(config, scene).expect("tensors of a single ray");
    let three = |ratio: f64| format!("{ratio:.2e}").parse::<f64>().expect("just printed");
    ratios.iter().map(|(site, ratio)| format!("{} {}", site.name(), three(*ratio))).collect::<Vec<String>>().join(", ")
}

/// Returns the norms of the constraint sets. A site of one number a sample has no norm to choose.
fn norms(numbers: &PerSite<SiteNumbers>) -> String {
    let on = numbers.iter().filter(|(site, numbers): &(PaperSite, _)| numbers.on() && !site.spec().scalar);
    let named = on.map(|(site, numbers)| format!("{} {}", site.name(), numbers.norm.name()));
    named.collect::<Vec<String>>().join(", ")
}

fn adam(train: &TrainConfig) -> String {
    let decay = if train.weight_decay > 0.0 { format!(", weight decay {}", train.weight_decay) } else { String::new() };
    format!("beta2 {}, epsilon {:e}{decay}", train.adam_beta2, train.adam_epsilon)
}

fn clip(train: &TrainConfig) -> Option<String> {
    let limits = [("value", train.clip_value), ("norm", train.clip_norm)];
    let set: Vec<String> =
        limits.iter().filter(|(_, limit)| *limit > 0.0).map(|(name, limit)| format!("{name} {limit}")).collect();
    (!set.is_empty()).then(|| set.join(", "))
}

fn anneal(config: &Resolved) -> Option<String> {
    let SamplingConfig { anneal_steps, anneal_start, anneal_middle, .. } = config.sampling;
    (anneal_steps > 0).then(|| format!("from {anneal_start} at {anneal_middle} in {anneal_steps} steps"))
}

fn sam(train: &TrainConfig) -> Option<String> {
    let direction = if train.sam_direction == SamDirection::Random { " random" } else { "" };
    (train.sam_radius > 0.0).then(|| format!("{}{direction}", train.sam_radius))
}

fn regularizers(regularizer: &RegularizerConfig) -> String {
    let described = |((term, weight), schedule): ((Regularizer, f64), WeightSchedule)| {
        let share = match term {
            Regularizer::Occlusion => format!(" in {} of the ray", regularizer.occlusion_share),
            _ => String::new(),
        };
        let is_unseen = term.group() == Some(RayGroup::One) && regularizer.rays == TermRays::Unseen;
        let rays = if is_unseen { " on unseen rays" } else { "" };
        let moves = match schedule {
            WeightSchedule::Constant => String::new(),
            _ => format!(" {}", schedule.described()),
        };
        format!("{} {weight}{moves}{share}{rays}", term.name())
    };
    let terms = regularizer.terms().zip(regularizer.schedules()).map(described);
    terms.collect::<Vec<String>>().join(", ")
}

fn unseen(config: &Resolved) -> Option<String> {
    let regularizer = &config.regularizer;
    let poses =
        if regularizer.reads_unseen_cameras() { format!(", {}", config.unseen_poses.name()) } else { String::new() };
    (!regularizer.unseen_groups().is_empty()).then(|| format!("{} rays{poses}", config.unseen_rays))
}

fn regularizer_points(regularizer: &RegularizerConfig) -> String {
    match regularizer.points {
        LatticePoints::Full => format!("full {}^3", regularizer.lattice),
        LatticePoints::Sampled => {
            let place = if regularizer.jitter { "" } else { " at midpoints" };
            format!("sampled {} of {}^3{place}", regularizer.points_per_step, regularizer.lattice)
        }
    }
}

/// Returns which views are evaluated. `test` is a fixed split; `every-8` holds out every 8th view, and
/// `every-8-from-3` starts at view 3, counted from 0. The suffix `-val` means validation views. `lacks_split` is the scene's:
/// [`Scene::lacks_split`].
pub fn split_name(config: &Config, lacks_split: bool) -> String {
    let data = &config.data;
    let split = match (data.has_splits() && !lacks_split, data.eval_split) {
        (true, EvalSplit::Val) => "val".to_string(),
        (true, EvalSplit::Test) => "test".to_string(),
        (false, eval_split) => {
            let from = if data.holdout_offset == 0 { String::new() } else { format!("-from-{}", data.holdout_offset) };
            let kept = if eval_split == EvalSplit::Val { "-val" } else { "" };
            format!("every-{}{from}{kept}", data.holdout)
        }
    };
    match data.test_skip {
        1 => split,
        skip => format!("{split}-skip-{skip}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::load_scene;
    use crate::settings::{Preset, build, parse_assignment};

    /// A column has the value of a setting or a computed one, never both.
    #[test]
    fn every_column_has_one_source() {
        let small = [parse_assignment("data.width=8").unwrap()];
        let (config, scene) = load_scene(build(Some(Preset::Smoke), None, &small).unwrap(), &()).unwrap();
        let state = State { redraws: vec![0, 1], ..State::default() };
        let found = [of_settings(&config), of_scene(&config, &scene), of_state(&config, &scene, &state)].concat();
        for column in COLUMNS {
            let here = found.iter().filter(|(name, _)| *name == column.name).count();
            let measured = usize::from(["lpips_weights", "inactive_by"].contains(&column.name));
            assert_eq!(here + measured + usize::from(column.setting(&REGISTRY).is_some()), 1, "{}", column.name);
        }
        assert!(found.iter().all(|(name, _)| find(name).is_some()));
    }

    /// 40 views of 8 x 8 pixels, and half of each.
    #[test]
    fn a_pixel_is_seen_as_often_as_rays_cover_what_counts() {
        let small = ["data.width=8", "train.rays=64"].map(|text| parse_assignment(text).unwrap());
        let (config, mut scene) = load_scene(build(Some(Preset::Smoke), None, &small).unwrap(), &()).unwrap();
        let seen = |scene: &Scene, step| {
            Protocol::new(&config, scene, &State { step, ..State::default() }).get("epochs").as_f64()
        };
        assert_eq!([0, 10, 40].map(|step| seen(&scene, step)), [Some(0.0), Some(0.25), Some(1.0)]);
        let half: std::sync::Arc<[bool]> = (0..64).map(|pixel| pixel % 2 == 0).collect();
        scene.train.iter_mut().for_each(|view| view.mask = Some(half.clone()));
        assert_eq!(seen(&scene, 40), Some(2.0));
        scene.train.clear();
        assert_eq!(seen(&scene, 40), None);
    }

    #[test]
    fn a_gpu_is_named_with_its_adapters() {
        let small = [parse_assignment("data.width=8").unwrap()];
        let (config, scene) = load_scene(build(Some(Preset::Smoke), None, &small).unwrap(), &()).unwrap();
        let of = |devices: &[&str], adapters: &[&str]| {
            let own = |names: &[&str]| names.iter().map(|name| name.to_string()).collect();
            let state = State { devices: own(devices), adapters: own(adapters), ..State::default() };
            let protocol = Protocol::new(&config, &scene, &state);
            ["device", "core", "precision"].map(|column| protocol.text(column))
        };
        assert_eq!(of(&["cpu"], &[]), ["cpu", "fused", "f32"]);
        assert_eq!(of(&["gpu"], &["A, driver 1"]), ["gpu (A, driver 1)", "gpu", "f32"]);
        assert_eq!(of(&["cpu", "gpu"], &["A", "B"]), ["cpu + gpu (A; B)", "fused + gpu", "f32"]);
    }

    #[test]
    fn splits_are_named_by_all_that_makes_them() {
        let named_where = |lacks_split: bool, texts: &[&str]| {
            let texts: Vec<_> = texts.iter().map(|text| parse_assignment(text).unwrap()).collect();
            split_name(&build(None, None, &texts).unwrap(), lacks_split)
        };
        let named = |texts: &[&str]| named_where(false, texts);
        assert_eq!(named(&["data.kind=llff"]), "every-8");
        assert_eq!(named(&["data.kind=llff", "data.holdout=5", "data.holdout_offset=3"]), "every-5-from-3");
        assert_eq!(named(&["data.kind=llff", "data.validation=4", "data.eval_split=val"]), "every-8-val");
        assert_eq!(named(&["data.kind=blender", "data.eval_split=val", "data.test_skip=2"]), "val-skip-2");
        // Training views that are held out in place of a split without photos.
        let held_out = |texts: &[&str]| named_where(true, &[&["data.kind=blender"][..], texts].concat());
        assert_eq!((named(&["data.kind=blender"]), held_out(&[])), ("test".into(), "every-8".into()));
        assert_eq!(held_out(&["data.holdout=4", "data.eval_split=val", "data.test_skip=2"]), "every-4-val-skip-2");
    }
}
