//! Rendering of whole views and their metrics.

use std::time::Instant;

use candle_core::DType;
use rayon::prelude::*;

use crate::base::{Error, Event, Image, Listener, Result};
use crate::data::{Camera, RayBuffer, Rays, Scene, View, seen_views};
use crate::methods::Renderer;
use crate::metrics::{Lpips, ViewMetrics, depth_errors, measure_depth, measure_unmasked};
use crate::model::Model;
use crate::runtime::Runtime;
use crate::settings::Resolved;

/// Chunks of each thread that an estimate of time is made from.
const CHUNKS_TIMED: usize = 4;

/// What evaluations are called in [`Event::Started`], with what is evaluated behind it.
pub const EVALUATING: &str = "evaluating";

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
    /// What was trained.
    pub model: &'a Model,
    /// The configuration that they were trained under.
    pub config: &'a Resolved,
    /// Bounds, coordinates and background of its rays, and the held-out views.
    pub scene: &'a Scene,
    /// Where views are rendered.
    pub runtime: &'a Runtime,
}

impl Viewer<'_> {
    /// Renders the view of a camera without any randomness, `config.eval.chunk` rays at a time.
    ///
    /// ```
    /// use augnerf::candle_core::DType;
    /// use augnerf::run::{Viewer, load_scene};
    /// use augnerf::runtime::Runtime;
    /// use augnerf::settings::{Preset, build, parse_assignment};
    /// use augnerf::train::Trainer;
    ///
    /// let small = ["data.width=16", "field.width=16", "train.rays=64"].map(|text| parse_assignment(text).unwrap());
    /// let (config, scene) = load_scene(build(Some(Preset::Smoke), None, &small)?, &())?;
    /// let runtime = Runtime::new("cpu", None)?;
    /// let trainer = Trainer::new(&config, &scene, DType::F32, &runtime)?;
    ///
    /// let viewer = Viewer { model: trainer.model(), config: &config, scene: &scene, runtime: &runtime };
    /// let view = viewer.render(&scene.path[0])?;
    /// assert_eq!((view.image.width, view.image.height, view.depth.len()), (16, 16, 256));
    /// // Sums of weights: 1 but for rounding.
    /// assert!(view.acc.iter().all(|acc| (0.0..1.00001).contains(acc)));
    /// # Ok::<(), augnerf::base::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Diverged`]: a colour that is not a number.
    pub fn render(&self, camera: &Camera) -> Result<RenderedView> {
        self.render_with(&*self.renderer()?, camera)
    }

    /// What renders the scene's rays with the model as it is now. To make it may take longer than a view: make one for many.
    ///
    /// # Errors
    /// Those of candle.
    pub fn renderer(&self) -> Result<Box<dyn Renderer>> {
        self.runtime.install(|| self.model.renderer(self.config, self.scene))
    }

    /// [`Viewer::render`] with a renderer at hand.
    ///
    /// # Errors
    /// The same.
    pub fn render_with(&self, renderer: &dyn Renderer, camera: &Camera) -> Result<RenderedView> {
        self.render_every(renderer, 1, camera)
    }

    /// Every `stride`-th pixel of the view across and down, from the first one on, as a picture of these.
    fn render_every(&self, renderer: &dyn Renderer, stride: usize, camera: &Camera) -> Result<RenderedView> {
        self.runtime.install(|| self.render_here(renderer, stride, camera))
    }

    fn render_here(&self, renderer: &dyn Renderer, stride: usize, camera: &Camera) -> Result<RenderedView> {
        let places = |size: usize| (0..size as u32).step_by(stride);
        let (width, height) = (places(camera.width).len(), places(camera.height).len());
        let pixels: Vec<(&Camera, u32, u32)> =
            places(camera.height).flat_map(|y| places(camera.width).map(move |x| (camera, x, y))).collect();
        self.prepare(renderer, camera)?;
        let [rgb, depth, acc] = self.render_pixels(renderer, &pixels)?;
        if let Some(bad) = rgb.iter().position(|value| !value.is_finite()) {
            return Err(Error::Diverged(format!(
                "the rendered colour of pixel ({}, {}) is not a number: the weights are broken; delete the \
                 newest checkpoint to fall back on the one before it",
                bad / 3 % width * stride,
                bad / 3 / width * stride
            )));
        }
        let image = Image { width, height, channels: 3, pixels: rgb };
        Ok(RenderedView { image, depth, acc })
    }

    /// What pictures of `camera` need.
    fn prepare(&self, renderer: &dyn Renderer, camera: &Camera) -> Result<()> {
        renderer.prepare(&self.rays(renderer, &[(camera, 0, 0)])?)
    }

    fn rays(&self, renderer: &dyn Renderer, pixels: &[(&Camera, u32, u32)]) -> Result<Rays> {
        let origin = self.config.data.origin_of_pixels();
        RayBuffer::new(pixels, self.scene.ndc.as_ref(), origin, renderer.ray_parts())
            .to_tensors(DType::F32, self.runtime.device())
    }

    /// Some pixels: colours, mean distances, accumulated weights.
    fn render_pixels(&self, renderer: &dyn Renderer, pixels: &[(&Camera, u32, u32)]) -> Result<[Vec<f32>; 3]> {
        let Viewer { config, runtime, .. } = *self;
        let render = |part: &[(&Camera, u32, u32)]| -> Result<[Vec<f32>; 3]> {
            let out = renderer.render(&self.rays(renderer, part)?)?;
            let host = |tensor: &candle_core::Tensor| tensor.to_dtype(DType::F32)?.flatten_all()?.to_vec1::<f32>();
            Ok([host(&out.rgb)?, host(&(out.depth / &out.acc)?)?, host(&out.acc)?])
        };
        let parts: Result<Vec<[Vec<f32>; 3]>> = if runtime.device().is_cpu() {
            pixels.par_chunks(config.eval.chunk).map(render).collect()
        } else {
            pixels.chunks(config.eval.chunk).map(render).collect()
        };
        let mut rendered: [Vec<f32>; 3] = Default::default();
        for part in parts? {
            rendered.iter_mut().zip(part).for_each(|(whole, part)| whole.extend(part));
        }
        Ok(rendered)
    }

    /// Seconds that views of `cameras` will take, from some rows in the middle of the first: enough to give each thread a
    /// few chunks. None where these would be a tenth of all rows or more, which are soon rendered, and where preparing the
    /// first view took longer than they did: what the others need beside it is not known.
    ///
    /// # Errors
    /// Those of candle.
    pub fn estimate_seconds(&self, cameras: &[&Camera]) -> Result<Option<f64>> {
        let Some(first) = cameras.first() else { return Ok(None) };
        let pixels: usize = cameras.iter().map(|camera| camera.width * camera.height).sum();
        let rows = (CHUNKS_TIMED * self.runtime.threads() * self.config.eval.chunk).div_ceil(first.width);
        let timed = rows * first.width;
        if rows > first.height || 10 * timed > pixels {
            return Ok(None);
        }
        self.runtime.install(|| {
            let renderer = self.model.renderer(self.config, self.scene)?;
            let preparing = Instant::now();
            self.prepare(&*renderer, first)?;
            let prepared = preparing.elapsed();
            let top = (first.height - rows) / 2;
            let started = Instant::now();
            let some: Vec<(&Camera, u32, u32)> =
                (top..top + rows).flat_map(|y| (0..first.width as u32).map(move |x| (*first, x, y as u32))).collect();
            self.render_pixels(&*renderer, &some)?;
            let rendered = started.elapsed();
            Ok((prepared <= rendered).then(|| rendered.as_secs_f64() / timed as f64 * pixels as f64))
        })
    }

    /// The errors of a rendered view's depth, as `depth_errors.gz` keeps them; none of a view without a depth of its own.
    pub(super) fn depth_errors(&self, view: &View, rendered: &RenderedView) -> Option<Vec<f32>> {
        let reference = view.depth.as_ref()?;
        Some(depth_errors(&self.scene_depth(&view.camera, rendered), &rendered.acc, reference))
    }

    /// Renders and measures every held-out view. `stop_check` may refuse to begin another, `each` is handed each that is done.
    pub fn evaluate(
        &self,
        lpips: &[Lpips],
        events: &dyn Listener,
        stop_check: impl Fn() -> Result<()>,
        each: impl FnMut(usize, &View, &RenderedView) -> Result<()>,
    ) -> Result<Vec<ViewMetrics>> {
        self.measure(EVALUATING, self.scene.test.iter().collect(), lpips, events, stop_check, each)
    }

    /// Renders and measures the training views of [`seen_views`] as they were trained on, corruption included.
    pub fn evaluate_training_views(
        &self,
        lpips: &[Lpips],
        events: &dyn Listener,
        stop_check: impl Fn() -> Result<()>,
    ) -> Result<Vec<ViewMetrics>> {
        let views = seen_views(self.scene, self.config).into_iter().map(|place| &self.scene.train[place]).collect();
        self.measure("evaluating training views", views, lpips, events, stop_check, |_, _, _| Ok(()))
    }

    /// Measures every `stride`-th pixel, across and down, of every held-out view and of the training views of [`seen_views`].
    pub(super) fn evaluate_sparsely(
        &self,
        stride: usize,
        stop_check: impl Fn() -> Result<()>,
    ) -> Result<[Vec<ViewMetrics>; 2]> {
        let renderer = self.renderer()?;
        let of_view = |view: &View| {
            stop_check()?;
            let rendered = self.render_every(&*renderer, stride, &view.camera)?;
            let (columns, rows) = (view.image.width, view.image.height);
            let mask = view.mask.as_ref().map(|mask| -> Vec<bool> {
                let kept = |y: usize| (0..columns).step_by(stride).map(move |x| mask[y * columns + x]);
                (0..rows).step_by(stride).flat_map(kept).collect()
            });
            measure_unmasked(&view.name, &rendered.image, &view.image.every(stride), mask.as_deref(), &[])
        };
        let seen = seen_views(self.scene, self.config);
        Ok([
            self.scene.test.iter().map(&of_view).collect::<Result<_>>()?,
            seen.into_iter().map(|place| of_view(&self.scene.train[place])).collect::<Result<_>>()?,
        ])
    }

    fn measure(
        &self,
        what: &'static str,
        views: Vec<&View>,
        lpips: &[Lpips],
        events: &dyn Listener,
        stop_check: impl Fn() -> Result<()>,
        mut each: impl FnMut(usize, &View, &RenderedView) -> Result<()>,
    ) -> Result<Vec<ViewMetrics>> {
        if views.is_empty() {
            return Ok(Vec::new());
        }
        events.on(Event::Started { what, parts: views.len() as u64 });
        let renderer = self.renderer()?;
        let mut metrics = Vec::with_capacity(views.len());
        for (index, view) in views.into_iter().enumerate() {
            stop_check()?;
            let rendered = self.render_with(&*renderer, &view.camera)?;
            let mut measured = measure_unmasked(&view.name, &rendered.image, &view.image, view.mask.as_deref(), lpips)?;
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
