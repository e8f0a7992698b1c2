//! Rendering of whole views and their metrics.

use std::path::Path;

use candle_core::{DType, Device};
use rayon::prelude::*;
use serde::Serialize;

use crate::config::{
    Attack, Config, DataKind, EvalSplit, Init, LEVELS, Method, Objective, OutputPlace, Passes, PerturbConfig,
    PerturbField, PerturbKind, PixelOrigin, Resample, StepUnit,
};
use crate::data::{Camera, Image, Progress, RayBuffer, Scene, View};
use crate::error::{Error, Result};
use crate::metrics::{Lpips, MeanMetrics, ViewMetrics, measure};
use crate::model::Model;
use crate::output::{revision, version, write_atomic, write_json};
use crate::render::render_rays;
use crate::train::{AttackSummary, Volume};

/// Version of the evaluation protocol; numbers of different versions are not comparable.
pub const PROTOCOL: u32 = 1;

/// One rendered view, row-major.
pub struct RenderedView {
    /// RGB, background included.
    pub image: Image,
    /// Mean distance along the ray in units of `t_vals` (the view's z axis; NDC where the scene
    /// uses it): the weights' mean of t. NaN where nothing was accumulated.
    pub depth: Vec<f32>,
    /// Accumulated weight, 0..=1.
    pub acc: Vec<f32>,
}

/// A trained model in its scene, ready to be looked at.
#[derive(Clone, Copy)]
pub struct Viewer<'a> {
    /// The networks.
    pub model: &'a Model,
    /// The resolved configuration that they were trained under.
    pub config: &'a Config,
    /// The scene.
    pub scene: &'a Scene,
    /// Where to compute.
    pub device: &'a Device,
}

impl Viewer<'_> {
    /// Renders the view of a camera without any randomness, `config.eval.chunk` rays at a time.
    pub fn render(&self, camera: &Camera) -> Result<RenderedView> {
        let Viewer { model, config, scene, device } = *self;
        let volume = Volume::of(scene);
        let samples = (config.sampling.coarse, config.sampling.fine);
        let (coarse, fine) = (model.coarse.frozen(), model.fine.as_ref().map(|field| field.frozen()));
        let (width, height) = (camera.width as u32, camera.height as u32);
        let pixels: Vec<(&Camera, u32, u32)> =
            (0..height).flat_map(|y| (0..width).map(move |x| (camera, x, y))).collect();
        let render = |part: &[(&Camera, u32, u32)]| -> Result<[Vec<f32>; 3]> {
            let rays =
                RayBuffer::new(part, scene.ndc.as_ref(), config.data.pixel_origin).to_tensors(DType::F32, device)?;
            let out = render_rays(&coarse, fine.as_ref(), &rays, volume.bounds, samples, volume.background)?;
            let host = |tensor: &candle_core::Tensor| tensor.to_dtype(DType::F32)?.flatten_all()?.to_vec1::<f32>();
            Ok([host(&out.rgb)?, host(&(out.depth / &out.acc)?)?, host(&out.acc)?])
        };
        let parts: Result<Vec<[Vec<f32>; 3]>> = if device.is_cpu() {
            pixels.par_chunks(config.eval.chunk).map(render).collect()
        } else {
            pixels.chunks(config.eval.chunk).map(render).collect()
        };
        let (mut rgb, mut depth, mut acc) = (Vec::new(), Vec::new(), Vec::new());
        for [part_rgb, part_depth, part_acc] in parts? {
            rgb.extend(part_rgb);
            depth.extend(part_depth);
            acc.extend(part_acc);
        }
        if let Some(bad) = rgb.iter().position(|value| !value.is_finite()) {
            return Err(Error::Diverged(format!(
                "the rendered colour of pixel ({}, {}) is not a number: the weights are broken; delete the \
                 newest checkpoint to fall back on the one before it",
                bad / 3 % camera.width,
                bad / 3 / camera.width
            )));
        }
        let image = Image { width: camera.width, height: camera.height, channels: 3, pixels: rgb };
        Ok(RenderedView { image, depth, acc })
    }

    /// Renders and measures every held-out view. `each` is handed each view when it is done.
    pub fn evaluate(
        &self,
        lpips: &[Lpips],
        progress: &dyn Progress,
        mut each: impl FnMut(usize, &View, &RenderedView) -> Result<()>,
    ) -> Result<Vec<ViewMetrics>> {
        let views = &self.scene.test;
        progress.start("evaluating", views.len() as u64);
        let mut metrics = Vec::with_capacity(views.len());
        for (index, view) in views.iter().enumerate() {
            let rendered = self.render(&view.camera)?;
            metrics.push(measure(&view.name, &rendered.image, &view.image, lpips)?);
            each(index, view, &rendered)?;
            progress.advance();
        }
        progress.finish();
        Ok(metrics)
    }
}

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
    /// `nerf` or `aug-nerf`.
    pub method: String,
    /// What fills the perturbed pass; this and all to `lambda` are empty without one.
    pub perturb_kind: Option<PerturbKind>,
    /// Levels that are on, with their passes where these are not both: `t xyz view feature:fine`.
    pub levels: Option<String>,
    /// Which numbers fill the perturbation's unset fields: `paper` or `calibrated`.
    pub attack: Option<Attack>,
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
    /// Width of the trunk.
    pub field_width: usize,
    /// Layers of the trunk.
    pub field_depth: usize,
    /// How weights are drawn.
    pub init: Init,
    /// Samples of the coarse pass.
    pub samples_coarse: usize,
    /// Further samples of the fine pass.
    pub samples_fine: usize,
    /// Rays of a step.
    pub rays: usize,
    /// Weight updates.
    pub steps: u64,
    /// Seed of all random streams.
    pub seed: u64,
    /// How often each field was drawn again because it started dead: `coarse 0, fine 1`.
    pub redraws: String,
    /// Hash of the resolved configuration.
    pub config_hash: String,
    /// Version of the program.
    pub program: String,
    /// Revision of its code.
    pub code_revision: String,
}

impl Protocol {
    /// The protocol of a run after `steps` steps.
    pub fn new(config: &Config, scene: &Scene, steps: u64, redraws: &[u64]) -> Protocol {
        let camera = scene.test.first().or(scene.train.first()).map(|view| view.camera);
        let perturb = (config.method == Method::AugNerf).then_some(&config.perturb);
        let deltas = perturb.filter(|perturb| perturb.kind != PerturbKind::FreshJitter);
        let named = Model::roles(config).into_iter().zip(redraws).map(|(role, draws)| format!("{role} {draws}"));
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
            perturb_kind: perturb.map(|perturb| perturb.kind),
            levels: deltas.map(levels),
            attack: deltas.map(|perturb| perturb.attack),
            attack_numbers: deltas.map(attack_numbers),
            step_unit: deltas.and_then(|perturb| perturb.step_unit),
            injection_layer: deltas.filter(|perturb| perturb.feature.on()).map(|perturb| perturb.injection_layer),
            perturb_field: perturb.map(|perturb| perturb.field),
            objective: perturb.map(|perturb| perturb.objective),
            output: deltas.map(|perturb| perturb.output),
            resample: deltas.map(|perturb| perturb.resample),
            lambda: perturb.map(|perturb| perturb.lambda),
            field_width: config.field.width,
            field_depth: config.field.depth,
            init: config.field.init,
            samples_coarse: config.sampling.coarse,
            samples_fine: config.sampling.fine,
            rays: config.train.rays,
            steps,
            seed: config.seed,
            redraws: named.collect::<Vec<String>>().join(", "),
            config_hash: config.hash(),
            program: version().into(),
            code_revision: revision().into(),
        }
    }
}

fn levels(perturb: &PerturbConfig) -> String {
    let named =
        LEVELS.into_iter().filter(|&level| perturb.delta(level).on()).map(|level| match perturb.delta(level).passes {
            Passes::Coarse => format!("{}:coarse", level.name()),
            Passes::Fine => format!("{}:fine", level.name()),
            Passes::Both | Passes::Off => level.name().to_string(),
        });
    named.collect::<Vec<String>>().join(" ")
}

fn attack_numbers(perturb: &PerturbConfig) -> String {
    let numbers = LEVELS.into_iter().filter(|&level| perturb.delta(level).on()).map(|level| {
        let delta = perturb.delta(level);
        let text = |number: Option<f64>| number.map_or(String::new(), |number| number.to_string());
        let steps = delta.steps.map_or(String::new(), |steps| steps.to_string());
        format!("{} {steps}/{}/{}", level.name(), text(delta.step_size), text(delta.epsilon))
    });
    numbers.collect::<Vec<String>>().join(", ")
}

/// Which views are evaluated: `test`, `val`, or `every-8` for every 8th view held out.
pub fn split_name(config: &Config) -> String {
    let split = match (config.data.kind, config.data.eval_split) {
        (DataKind::Blender | DataKind::BuiltinBlender, EvalSplit::Val) => "val".to_string(),
        (DataKind::Blender | DataKind::BuiltinBlender, _) => "test".to_string(),
        _ => format!("every-{}", config.data.holdout),
    };
    match config.data.test_skip {
        1 => split,
        skip => format!("{split}-skip-{skip}"),
    }
}

/// `metrics.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Means over the views.
    pub mean: MeanMetrics,
    /// Every view.
    pub views: Vec<ViewMetrics>,
    /// Where the numbers come from.
    pub protocol: Protocol,
    /// What the attack did over the logged steps, one entry a level; empty without one.
    pub attack: Vec<AttackSummary>,
}

impl Report {
    /// Writes `metrics.json` and `metrics.csv`.
    pub fn write(&self, json: &Path, csv: &Path) -> Result<()> {
        write_json(json, self)?;
        write_atomic(csv, &self.csv(csv)?)
    }

    /// One row a view, each with the whole protocol; a missing metric is an empty cell.
    fn csv(&self, path: &Path) -> Result<Vec<u8>> {
        let unwritable =
            |error: &dyn std::fmt::Display| Error::Output(format!("cannot write {}: {error}", path.display()));
        let inactive: Vec<&str> = self.attack.iter().filter(|level| level.inactive).map(|level| level.level).collect();
        let mut writer = csv::WriterBuilder::new().has_headers(false).from_writer(Vec::new());
        for (index, view) in self.views.iter().enumerate() {
            let mut row = columns(view);
            row.extend(columns(&self.protocol));
            row.push(("inactive_levels".into(), inactive.join(" ")));
            if index == 0 {
                writer.write_record(row.iter().map(|(name, _)| name)).map_err(|e| unwritable(&e))?;
            }
            writer.write_record(row.iter().map(|(_, value)| value)).map_err(|e| unwritable(&e))?;
        }
        writer.into_inner().map_err(|e| unwritable(&e))
    }
}

/// The fields of a flat struct as text, in their order; null is an empty cell.
fn columns(row: &impl Serialize) -> Vec<(String, String)> {
    let serde_json::Value::Object(fields) = serde_json::to_value(row).expect("plain data") else {
        unreachable!("rows are structs")
    };
    let text = |value: serde_json::Value| match value {
        serde_json::Value::Null => String::new(),
        serde_json::Value::String(text) => text,
        other => other.to_string(),
    };
    fields.into_iter().map(|(name, value)| (name, text(value))).collect()
}
