//! Rendering of whole views and their metrics.

use std::path::Path;

use super::Protocol;

use candle_core::DType;
use rayon::prelude::*;
use serde::Serialize;

use crate::base::csv::csv_of_named;
use crate::base::files::{write_atomic, write_json};
use crate::base::{Error, Event, Image, Listener, Result};
use crate::data::{Camera, RayBuffer, Scene, View};
use crate::methods::{AttackSummary, Model};
use crate::metrics::{Lpips, MeanMetrics, ViewMetrics, measure, measure_depth};
use crate::runtime::Runtime;
use crate::settings::Resolved;
use crate::space::Chamfer;

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
    /// The configuration that they were trained under.
    pub config: &'a Resolved,
    /// The scene.
    pub scene: &'a Scene,
    /// Where to compute.
    pub runtime: &'a Runtime,
}

impl Viewer<'_> {
    /// Renders the view of a camera without any randomness, `config.eval.chunk` rays at a time.
    ///
    /// # Errors
    /// [`Error::Diverged`]: a colour that is not a number.
    pub fn render(&self, camera: &Camera) -> Result<RenderedView> {
        self.runtime.install(|| self.render_here(camera))
    }

    fn render_here(&self, camera: &Camera) -> Result<RenderedView> {
        let Viewer { model, config, scene, runtime } = *self;
        let device = runtime.device();
        let painter = model.painter(config, scene)?;
        let (width, height) = (camera.width as u32, camera.height as u32);
        let pixels: Vec<(&Camera, u32, u32)> =
            (0..height).flat_map(|y| (0..width).map(move |x| (camera, x, y))).collect();
        let render = |part: &[(&Camera, u32, u32)]| -> Result<[Vec<f32>; 3]> {
            let rays = RayBuffer::new(part, scene.ndc.as_ref(), config.data.pixel_origin, painter.ray_parts())
                .to_tensors(DType::F32, device)?;
            let out = painter.paint(&rays)?;
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

    /// Renders and measures every held-out view. `going` may refuse to begin another, `each` is handed each that is done.
    pub fn evaluate(
        &self,
        lpips: &[Lpips],
        events: &dyn Listener,
        going: impl Fn() -> Result<()>,
        mut each: impl FnMut(usize, &View, &RenderedView) -> Result<()>,
    ) -> Result<Vec<ViewMetrics>> {
        let views = &self.scene.test;
        events.on(Event::Started { what: "evaluating", parts: views.len() as u64 });
        let mut metrics = Vec::with_capacity(views.len());
        for (index, view) in views.iter().enumerate() {
            going()?;
            let rendered = self.render(&view.camera)?;
            let mut measured = measure(&view.name, &rendered.image, &view.image, lpips)?;
            if let Some(reference) = &view.depth {
                let depth = self.scene_depth(&view.camera, &rendered);
                let exact = self.scene.has_exact_depth();
                measure_depth(&mut measured, &view.camera, &depth, &rendered.acc, reference, exact);
            }
            metrics.push(measured);
            each(index, view, &rendered)?;
            events.on(Event::Advanced);
        }
        events.on(Event::Finished);
        Ok(metrics)
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
    /// Of measured views, and of a surface where one was measured.
    pub fn new(
        views: Vec<ViewMetrics>,
        surface: Option<Chamfer>,
        protocol: Protocol,
        attack: Vec<AttackSummary>,
    ) -> Report {
        let mut mean = MeanMetrics::from_views(&views);
        mean.set("chamfer", surface.as_ref().map(|surface| surface.chamfer));
        mean.set("f_score", surface.and_then(|surface| surface.scores.first().map(|score| score.f_score)));
        Report { mean, views, protocol, attack }
    }

    /// Writes `metrics.json` and `metrics.csv`.
    pub fn write(&self, json: &Path, csv: &Path) -> Result<()> {
        write_json(json, self)?;
        write_atomic(csv, self.csv().as_bytes())
    }

    /// Levels of the attack that had no effect on the loss.
    pub fn inactive_levels(&self) -> Vec<&'static str> {
        self.attack.iter().filter(|level| level.inactive).map(|level| level.level).collect()
    }

    /// One row a view, each with the whole protocol; a missing metric is an empty cell.
    fn csv(&self) -> String {
        let inactive = self.inactive_levels();
        let rows = self.views.iter().map(|view| {
            let mut row = columns(view);
            row.extend(columns(&self.protocol));
            row.push(("inactive_levels".into(), inactive.join(" ")));
            row
        });
        csv_of_named(rows)
    }
}

/// The fields of a flat struct as text, in their order; null is an empty cell.
pub fn columns(row: &impl Serialize) -> Vec<(String, String)> {
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
