//! Renders complete views and measures their metrics.

use candle_core::DType;

use crate::base::{Error, Event, Image, Listener, Result};
use crate::data::{Camera, RayBuffer, Rays, Scene, View};
use crate::methods::Renderer;
use crate::metrics::{Floor, Lpips, ViewMetrics, depth_errors, measure_depth, measure_unmasked};
use crate::model::Model;
use crate::runtime::Runtime;
use crate::settings::Resolved;

/// Parts for each thread between two checks whether a view is still wanted.
const PARTS_OF_A_SLICE: usize = 2;

/// Name of an evaluation in [`Event::Started`]; what is evaluated follows.
pub const EVALUATING: &str = "evaluating";

/// One rendered view, row-major.
pub struct RenderedView {
    /// RGB, background included.
    pub image: Image,
    /// Mean distance along the ray in units of `t_vals` (the view's z axis; NDC if the scene uses it): the weights'
    /// mean of t. NaN if nothing was accumulated.
    pub depth: Vec<f32>,
    /// Accumulated weight, 0..=1.
    pub acc: Vec<f32>,
}

/// A trained model in its scene, ready to render.
#[derive(Clone, Copy)]
pub struct Viewer<'a> {
    /// The trained model.
    pub model: &'a Model,
    /// The configuration of its training.
    pub config: &'a Resolved,
    /// The scene, with bounds, coordinates and background of its rays, and the held-out views.
    pub scene: &'a Scene,
    /// Runtime that renders.
    pub runtime: &'a Runtime,
}

impl Viewer<'_> {
    /// Renders the view of a camera without any randomness, `config.eval.chunk` rays at a time.
    ///
    /// ```
    /// # mod augnerf { pub use augnerf_base as base; pub use augnerf_nerf::*; pub use augnerf_run::*; pub use candle_core; }
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
    /// let viewer = Viewer { model: trainer.model()?, config: &config, scene: &scene, runtime: &runtime };
    /// let view = viewer.render(&scene.path[0])?;
    /// assert_eq!((view.image.width, view.image.height, view.depth.len()), (16, 16, 256));
    /// // Sums of weights: 1 but for rounding.
    /// assert!(view.acc.iter().all(|acc| (0.0..1.00001).contains(acc)));
    /// # Ok::<(), augnerf::base::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Diverged`]: a colour is not a number.
    pub fn render(&self, camera: &Camera) -> Result<RenderedView> {
        self.render_with(&*self.renderer()?, camera)
    }

    /// Returns a renderer of the scene with the current model. Making one may take longer than a view, so use it for
    /// several.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn renderer(&self) -> Result<Box<dyn Renderer>> {
        self.runtime.install(|| self.model.renderer(self.config, self.scene, self.runtime))
    }

    /// Renders a view as [`Viewer::render`] does, with an existing renderer.
    ///
    /// # Errors
    /// The same.
    pub fn render_with(&self, renderer: &dyn Renderer, camera: &Camera) -> Result<RenderedView> {
        let chunk = self.chunk(renderer, usize::MAX);
        self.render_slices(renderer, 1, camera, [usize::MAX, chunk], &mut || Ok(()))
    }

    /// Renders a view as [`Viewer::render_with`] does, in slices of some parts for each thread, and parts of at most
    /// `most_rays` unless the renderer has a number of its own. `stop_check` is called before each slice, on the calling
    /// thread: it may wait, or end the view with an error.
    ///
    /// # Errors
    /// The same, and those of `stop_check`.
    pub fn render_unless(
        &self,
        renderer: &dyn Renderer,
        camera: &Camera,
        most_rays: usize,
        stop_check: &mut dyn FnMut() -> Result<()>,
    ) -> Result<RenderedView> {
        let chunk = self.chunk(renderer, most_rays);
        self.render_slices(renderer, 1, camera, [self.slice(chunk), chunk], stop_check)
    }

    /// Renders every `stride`-th pixel across and down, from the first one on, as an image of these. `stop_check` is called
    /// as in [`Viewer::render_unless`].
    pub(super) fn render_every(
        &self,
        renderer: &dyn Renderer,
        stride: usize,
        camera: &Camera,
        stop_check: &mut dyn FnMut() -> Result<()>,
    ) -> Result<RenderedView> {
        let chunk = self.chunk(renderer, usize::MAX);
        self.render_slices(renderer, stride, camera, [self.slice(chunk), chunk], stop_check)
    }

    /// Returns the number of pixels between two checks, for parts of `chunk` rays.
    fn slice(&self, chunk: usize) -> usize {
        PARTS_OF_A_SLICE * self.runtime.threads() * chunk
    }

    fn render_slices(
        &self,
        renderer: &dyn Renderer,
        stride: usize,
        camera: &Camera,
        [slice, chunk]: [usize; 2],
        stop_check: &mut dyn FnMut() -> Result<()>,
    ) -> Result<RenderedView> {
        let places = |size: usize| (0..size as u32).step_by(stride);
        let (width, height) = (places(camera.width).len(), places(camera.height).len());
        let pixels: Vec<(&Camera, u32, u32)> =
            places(camera.height).flat_map(|y| places(camera.width).map(move |x| (camera, x, y))).collect();
        stop_check()?;
        self.runtime.install(|| self.prepare(renderer, camera))?;
        let mut rendered: [Vec<f32>; 3] = Default::default();
        for pixels in pixels.chunks(slice) {
            stop_check()?;
            let parts = self.runtime.install(|| self.render_pixels(renderer, pixels, chunk))?;
            rendered.iter_mut().zip(parts).for_each(|(whole, parts)| whole.extend(parts));
        }
        let [rgb, depth, acc] = rendered;
        if let Some(bad) = rgb.iter().position(|value| !value.is_finite()) {
            return Err(Error::Diverged(format!(
                "the rendered colour of pixel ({}, {}) is not a number, so the weights are broken; delete the \
                 newest checkpoint to use the one before it",
                bad / 3 % width * stride,
                bad / 3 / width * stride
            )));
        }
        let image = Image { width, height, channels: 3, pixels: rgb };
        Ok(RenderedView { image, depth, acc })
    }

    /// Prepares what images of `camera` need.
    fn prepare(&self, renderer: &dyn Renderer, camera: &Camera) -> Result<()> {
        renderer.prepare(&self.rays(renderer, &[(camera, 0, 0)])?)
    }

    fn rays(&self, renderer: &dyn Renderer, pixels: &[(&Camera, u32, u32)]) -> Result<Rays> {
        let origin = self.config.data.origin_of_pixels();
        RayBuffer::new(pixels, self.scene.ndc.as_ref(), origin, renderer.ray_parts())
            .to_tensors(DType::F32, self.runtime.device())
    }

    /// Renders some pixels, `chunk` at once: colours, mean distances, accumulated weights.
    fn render_pixels(
        &self,
        renderer: &dyn Renderer,
        pixels: &[(&Camera, u32, u32)],
        chunk: usize,
    ) -> Result<[Vec<f32>; 3]> {
        let render = |part: &[(&Camera, u32, u32)]| -> Result<[Vec<f32>; 3]> {
            let out = renderer.render(&self.rays(renderer, part)?)?;
            let host = |tensor: &candle_core::Tensor| tensor.to_dtype(DType::F32)?.flatten_all()?.to_vec1::<f32>();
            Ok([host(&out.rgb)?, host(&(out.depth / &out.acc)?)?, host(&out.acc)?])
        };
        let mut rendered: [Vec<f32>; 3] = Default::default();
        for part in self.runtime.over_parts(pixels, chunk, render)? {
            rendered.iter_mut().zip(part).for_each(|(whole, part)| whole.extend(part));
        }
        Ok(rendered)
    }

    /// Returns the number of rays of a part.
    fn chunk(&self, renderer: &dyn Renderer, most_rays: usize) -> usize {
        renderer.chunk().unwrap_or(self.config.eval.chunk.min(most_rays))
    }

    /// Returns the errors of a rendered view's depth for `depth_errors.gz`, or `None` if the view has no depth of its
    /// own.
    pub(super) fn depth_errors(&self, view: &View, rendered: &RenderedView) -> Option<Vec<f32>> {
        let reference = view.depth.as_ref()?;
        Some(depth_errors(&self.scene_depth(&view.camera, rendered), &rendered.acc, reference))
    }

    /// Renders and measures every held-out view. `stop_check` may stop before a view; `each` receives each
    /// rendered view.
    pub fn evaluate(
        &self,
        lpips: &[Lpips],
        events: &dyn Listener,
        stop_check: impl Fn() -> Result<()>,
        each: impl FnMut(usize, &View, &RenderedView) -> Result<()>,
    ) -> Result<Vec<ViewMetrics>> {
        self.measure(EVALUATING, self.scene.test.iter().collect(), lpips, events, stop_check, each)
    }

    /// Renders and measures the training views of [`Config::seen_views`](crate::settings::Config::seen_views) as the training
    /// saw them, corruption included.
    pub fn evaluate_training_views(
        &self,
        lpips: &[Lpips],
        events: &dyn Listener,
        stop_check: impl Fn() -> Result<()>,
    ) -> Result<Vec<ViewMetrics>> {
        let views = self.config.seen_views(self.scene).into_iter().map(|place| &self.scene.train[place]).collect();
        self.measure("evaluating training views", views, lpips, events, stop_check, |_, _, _| Ok(()))
    }

    /// Measures every `stride`-th pixel, across and down, of every held-out view and of the training views of
    /// [`Config::seen_views`](crate::settings::Config::seen_views).
    pub(super) fn evaluate_sparsely(
        &self,
        stride: usize,
        stop_check: impl Fn() -> Result<()>,
    ) -> Result<[Vec<ViewMetrics>; 2]> {
        let (renderer, floor) = (self.renderer()?, self.floor());
        let of_view = |view: &View| -> Result<ViewMetrics> {
            stop_check()?;
            let rendered = self.render_every(&*renderer, stride, &view.camera, &mut || Ok(()))?;
            let (truth, mask) = every(view, stride);
            let mask = mask.as_deref();
            let mut measured = measure_unmasked(&view.name, &rendered.image, &truth, mask, &[])?;
            floor.map_or(Ok(()), |floor| floor.measure(&mut measured, &truth, mask))?;
            Ok(measured)
        };
        let seen = self.config.seen_views(self.scene);
        Ok([
            self.scene.test.iter().map(&of_view).collect::<Result<_>>()?,
            seen.into_iter().map(|place| of_view(&self.scene.train[place])).collect::<Result<_>>()?,
        ])
    }

    /// Returns the best single colour of the training views.
    fn floor(&self) -> Option<Floor> {
        self.runtime.install(|| Floor::of_views(&self.scene.train))
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
        let (renderer, floor) = (self.renderer()?, self.floor());
        let mut metrics = Vec::with_capacity(views.len());
        for (index, view) in views.into_iter().enumerate() {
            stop_check()?;
            let rendered = self.render_with(&*renderer, &view.camera)?;
            let mask = view.mask.as_deref();
            let mut measured = measure_unmasked(&view.name, &rendered.image, &view.image, mask, lpips)?;
            floor.map_or(Ok(()), |floor| floor.measure(&mut measured, &view.image, mask))?;
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

/// Returns every `stride`-th pixel of a photo and of its mask, across and down.
pub(super) fn every(view: &View, stride: usize) -> (Image, Option<Vec<bool>>) {
    let (columns, rows) = (view.image.width, view.image.height);
    let mask = view.mask.as_ref().map(|mask| {
        let kept = |y: usize| (0..columns).step_by(stride).map(move |x| mask[y * columns + x]);
        (0..rows).step_by(stride).flat_map(kept).collect()
    });
    (view.image.every(stride), mask)
}
