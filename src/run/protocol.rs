//! The protocol of a run: what stands beside each of its numbers.

use serde::Serialize;

use crate::augment::{Geometry, Passes, Site, StepUnit};
use crate::base::version;
use crate::data::Scene;
use crate::methods::{Model, step_over_radius};
use crate::metrics::Lpips;
use crate::settings::{
    Config, DensityActivation, EvalSplit, Init, LatticePoints, Objective, OutputPlace, PerturbField, PixelOrigin,
    RegularizedFields, Resample, Resolved, ResolvedPerturb, Schedule, SecondPass, Sizes,
};
use crate::train::checkpoint::State;

use super::surface;

/// Version of the evaluation protocol; numbers of different versions are not comparable.
pub const PROTOCOL: u32 = 1;

/// Where a number comes from: everything that two numbers must share to be compared.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Protocol {
    /// Version of the evaluation protocol.
    pub protocol: u32,
    /// Kind of scene: `llff`, `blender`, `transforms`, `builtin-blender`, `builtin-forward`.
    pub dataset: String,
    /// The scene's name.
    pub scene: String,
    /// Width of the evaluated views in pixels.
    pub width: usize,
    /// Height of the evaluated views in pixels.
    pub height: usize,
    /// `white`, `black`, or `none` for opaque photographs.
    pub background: String,
    /// Rays in normalised device coordinates.
    pub ndc: bool,
    /// Which views are evaluated: `test`, `val`, or `every-8` for hold-out.
    pub split: String,
    /// Views that were trained on.
    pub views_trained: usize,
    /// Views that were evaluated.
    pub views_evaluated: usize,
    /// Where in a pixel its ray goes through: `corner` or `centre`.
    pub pixel_origin: PixelOrigin,
    /// `nerf`, `aug-nerf`, `mip-nerf`, `aug-mip-nerf`.
    pub method: String,
    /// What fills the perturbed pass; this and all to `lambda` are empty without one.
    pub perturb_kind: Option<SecondPass>,
    /// Sites that are on, with their passes where these are not both: `t xyz view feature:fine`.
    pub levels: Option<String>,
    /// Which numbers fill the perturbation's unset fields: `paper` or `calibrated`.
    pub attack: Option<Sizes>,
    /// Steps, step size and epsilon of each level that is on: `t 3/0.01/0.5, ...`.
    pub attack_numbers: Option<String>,
    /// Unit of the step sizes.
    pub step_unit: Option<StepUnit>,
    /// Trunk layer that the feature delta is added to.
    pub injection_layer: Option<usize>,
    /// Network of the perturbed pass.
    pub perturb_field: Option<PerturbField>,
    /// How clean and perturbed loss are mixed.
    pub objective: Option<Objective>,
    /// Where the output deltas are added.
    pub output: Option<OutputPlace>,
    /// Where the perturbed fine pass takes its samples from.
    pub resample: Option<Resample>,
    /// Weight of the perturbed loss.
    pub lambda: Option<f64>,
    /// Regularizers with their weights: `l1 0.001, tv 0.0001`; this and all to
    /// `regularizer_fields` are empty without any.
    pub regularizers: Option<String>,
    /// Points that a regularizer's term is made of: `sampled 4096 of 64^3`, `full 64^3`.
    pub regularizer_points: Option<String>,
    /// Corners of the box that they cover.
    pub regularizer_domain: Option<String>,
    /// Which networks are regularized.
    pub regularizer_fields: Option<RegularizedFields>,
    /// Width of the trunk.
    pub field_width: usize,
    /// Layers of the trunk.
    pub field_depth: usize,
    /// How weights are drawn.
    pub init: Init,
    /// What turns raw density into density.
    pub density_activation: DensityActivation,
    /// Samples of the coarse pass (MipNeRF: intervals).
    pub samples_coarse: usize,
    /// Further samples of the fine pass (MipNeRF: its intervals).
    pub samples_fine: usize,
    /// Rays of a step.
    pub rays: usize,
    /// Weight updates.
    pub steps: u64,
    /// The learning rate and how it falls: `0.0005, times 0.1 every 250000`, `0.0005 to 0.000005`.
    pub learning_rate: String,
    /// Weight of the coarse pass's loss.
    pub coarse_weight: f64,
    /// Seed of all random streams.
    pub seed: u64,
    /// How often each field was drawn again because it started dead: `coarse 0, fine 1`.
    pub redraws: String,
    /// Hash of the resolved configuration.
    pub config_hash: String,
    /// Hash of everything that was loaded of the scene: poses and pixels of all views, before any corruption.
    pub data_hash: String,
    /// What was done to the training views: `gaussian-noise 3 (std 0.18)`; empty where nothing was.
    pub corruption: Option<String>,
    /// The same hash after that.
    pub corruption_hash: Option<String>,
    /// Version of the program.
    pub program: String,
    /// Revision of its code; all of them where several worked on the run.
    pub code_revision: String,
    /// `cpu`, `cuda`, `cuda-tf32`, `metal`; all of them where several did.
    pub device: String,
    /// How the surface behind `chamfer` and `f_score` was drawn and compared; empty where none was.
    pub mesh: Option<String>,
    /// Hash of the weights that each LPIPS backbone measured with: `squeeze 1a2b3c4d5e6f`; empty where none did.
    pub lpips_weights: Option<String>,
    /// Whose samples, pixels and width the attack's epsilons are measured in: `sampling` or `paper`; this and the next are
    /// empty without an attack.
    pub attack_geometry: Option<Geometry>,
    /// Step size over the radius of each site's set: `t 1.26, xyz 2.52, ...`.
    pub step_over_radius: Option<String>,
}

/// A learning rate and how it falls, in words.
fn learning_rate(config: &Resolved) -> String {
    let train = &config.train;
    let start = train.learning_rate;
    match train.schedule {
        Schedule::Exponential => format!("{start}, times {} every {}", train.decay_rate, config.decay_steps),
        Schedule::LogLinear => format!("{start} to {}", train.final_learning_rate),
    }
}

impl Protocol {
    /// The protocol of a run at a checkpoint's state.
    pub fn new(config: &Resolved, scene: &Scene, state: &State) -> Protocol {
        let camera = scene.test.first().or(scene.train.first()).map(|view| view.camera);
        let perturb = config.method.is_augmented().then_some(&config.perturb);
        let regularizer = Some(&config.regularizer).filter(|regularizer| !regularizer.kind.is_empty());
        let in_space = regularizer.filter(|regularizer| regularizer.has_space_terms());
        let deltas = perturb.filter(|perturb| perturb.source().is_some());
        let named = Model::parts(config).into_iter().zip(&state.redraws).map(|(role, draws)| format!("{role} {draws}"));
        Protocol {
            protocol: PROTOCOL,
            dataset: scene.kind.to_string(),
            scene: config.data.name.clone(),
            width: camera.map_or(0, |camera| camera.width),
            height: camera.map_or(0, |camera| camera.height),
            background: match scene.background {
                None => "none".into(),
                Some([1.0, 1.0, 1.0]) => "white".into(),
                Some(_) => "black".into(),
            },
            ndc: scene.ndc.is_some(),
            split: split_name(config),
            views_trained: scene.train.len(),
            views_evaluated: scene.test.len(),
            pixel_origin: config.data.pixel_origin,
            method: config.method.name().into(),
            perturb_kind: perturb.map(|perturb| perturb.second),
            levels: deltas.map(levels),
            attack: deltas.map(|perturb| perturb.sizes),
            attack_numbers: deltas.map(attack_numbers),
            step_unit: deltas.map(|perturb| perturb.step_unit),
            injection_layer: deltas
                .filter(|perturb| perturb.numbers[Site::Feature].on())
                .map(|perturb| perturb.injection_layer),
            perturb_field: perturb.map(|perturb| perturb.field),
            objective: perturb.map(|perturb| perturb.objective),
            output: deltas.map(|perturb| perturb.output),
            resample: deltas.map(|perturb| perturb.resample),
            lambda: perturb.map(|perturb| perturb.lambda),
            regularizers: regularizer.map(|regularizer| {
                let terms = regularizer.terms().map(|(term, weight)| format!("{} {weight}", term.name()));
                terms.collect::<Vec<String>>().join(", ")
            }),
            regularizer_points: in_space.map(|regularizer| match regularizer.points {
                LatticePoints::Full => format!("full {}^3", regularizer.lattice),
                LatticePoints::Sampled => {
                    let place = if regularizer.jitter { "" } else { " at midpoints" };
                    format!("sampled {} of {}^3{place}", regularizer.points_per_step, regularizer.lattice)
                }
            }),
            regularizer_domain: in_space.map(|regularizer| format!("{:?}", regularizer.domain)),
            regularizer_fields: regularizer.map(|regularizer| regularizer.fields),
            field_width: config.field.width,
            field_depth: config.field.depth,
            init: config.field.init,
            density_activation: config.field.density_activation,
            samples_coarse: config.sampling.coarse,
            samples_fine: config.sampling.fine,
            rays: config.train.rays,
            steps: state.step,
            learning_rate: learning_rate(config),
            coarse_weight: config.train.coarse_weight,
            seed: config.seed,
            redraws: named.collect::<Vec<String>>().join(", "),
            config_hash: config.hash(),
            data_hash: match &scene.corrupted {
                Some(corrupted) => corrupted.clean_hash.clone(),
                None => scene.hash(),
            },
            corruption: scene.corrupted.as_ref().map(|corrupted| corrupted.what.clone()),
            corruption_hash: scene.corrupted.is_some().then(|| scene.hash()),
            program: version().into(),
            code_revision: state.revisions.join(" + "),
            device: state.devices.join(" + "),
            mesh: surface::describe(config, scene),
            lpips_weights: None,
            attack_geometry: deltas.map(|perturb| perturb.geometry),
            step_over_radius: deltas.map(|_| ratios(config, scene)),
        }
    }

    /// The protocol of an evaluation that measured LPIPS with these backbones.
    pub fn with_lpips(self, lpips: &[Lpips]) -> Protocol {
        let named = lpips.iter().map(|lpips| format!("{} {}", lpips.backbone().name(), lpips.weights_hash()));
        let lpips_weights = (!lpips.is_empty()).then(|| named.collect::<Vec<String>>().join(", "));
        Protocol { lpips_weights, ..self }
    }
}

fn levels(perturb: &ResolvedPerturb) -> String {
    let named = perturb.sites_on().map(|(site, config)| match config.passes {
        Passes::Coarse => format!("{}:coarse", site.name()),
        Passes::Fine => format!("{}:fine", site.name()),
        Passes::Both | Passes::Off => site.name().to_string(),
    });
    named.collect::<Vec<String>>().join(" ")
}

fn attack_numbers(perturb: &ResolvedPerturb) -> String {
    let on = perturb.numbers.iter().filter(|(_, numbers)| numbers.on());
    let numbers = on
        .map(|(site, numbers)| format!("{} {}/{}/{}", site.name(), numbers.steps, numbers.step_size, numbers.epsilon));
    numbers.collect::<Vec<String>>().join(", ")
}

/// Step over radius of each site, with three figures.
fn ratios(config: &Resolved, scene: &Scene) -> String {
    let ratios = step_over_radius(config, scene).expect("tensors of a single ray");
    let three = |ratio: f64| format!("{ratio:.2e}").parse::<f64>().expect("just printed");
    ratios.iter().map(|(site, ratio)| format!("{} {}", site.name(), three(*ratio))).collect::<Vec<String>>().join(", ")
}

/// Which views are evaluated: `test`, `val`, or `every-8` for every 8th view held out.
pub fn split_name(config: &Config) -> String {
    let split = match (config.data.kind.has_splits(), config.data.eval_split) {
        (true, EvalSplit::Val) => "val".to_string(),
        (true, EvalSplit::Test) => "test".to_string(),
        (false, _) => format!("every-{}", config.data.holdout),
    };
    match config.data.test_skip {
        1 => split,
        skip => format!("{split}-skip-{skip}"),
    }
}
