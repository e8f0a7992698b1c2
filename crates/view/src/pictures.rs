//! Pictures and rays: who has asked for which, and how large a picture may be to come in time.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use candle_core::{DType, Tensor};
use serde_json::json;

use crate::base::{Error, Image, Result};
use crate::data::{Camera, RayBuffer, Rays, View};
use crate::draw::{encode_jpeg, encode_png8};
use crate::run::RenderedView;

use super::http::Reply;
use super::perturbed::{Attack, PerturbedRenderer};
use super::picture::draw_layer;
use super::queue::{Queue, Rank, Work};
use super::request::Arguments;
use super::router::{Answer, json_reply};
use super::samples::RaySamples;
use super::shown::{MOST_RAYS, ShownRun, Weights};

/// The most pages whose turns are remembered.
const MOST_PAGES: usize = 1000;
/// Rays that are searched at once. A search remembers every operation on them.
const SEARCHED_RAYS: usize = 128;
/// Quality of pictures while the camera moves.
const MOVING_QUALITY: u8 = 82;

/// Makes pictures, one at a time.
#[derive(Default)]
pub struct Pictures {
    pub queue: Queue,
    /// The newest picture that each page's slot has asked for.
    turns: Mutex<HashMap<String, u64>>,
    /// Pictures that are being made are given up.
    stopping: AtomicBool,
}

impl Pictures {
    /// Gives up all pictures, for good.
    pub fn stop(&self) {
        self.stopping.store(true, Ordering::SeqCst);
    }

    pub fn is_stopping(&self) -> bool {
        self.stopping.load(Ordering::SeqCst)
    }

    /// Notes what a page has asked for. Returns the check whether it is still wanted.
    fn wanted<'a>(
        &'a self,
        arguments: &Arguments,
        has_gone: &'a dyn Fn() -> bool,
    ) -> std::result::Result<impl Fn() -> Result<()> + 'a, String> {
        let (page, turn) = arguments.turn()?;
        let mut turns = self.turns.lock().unwrap_or_else(PoisonError::into_inner);
        if turns.len() >= MOST_PAGES && !turns.contains_key(&page) {
            turns.clear();
        }
        let newest = turns.entry(page.clone()).or_default();
        *newest = turn.max(*newest);
        drop(turns);
        Ok(move || {
            let turns = self.turns.lock().unwrap_or_else(PoisonError::into_inner);
            let is_old = turns.get(&page).is_some_and(|newest| *newest > turn);
            given_up(self.is_stopping() || is_old || has_gone())
        })
    }

    /// Finds the empty space of a run, whenever no quick picture is asked for.
    ///
    /// # Errors
    /// [`Error::Interrupted`]: the server stops. Those of [`ShownRun::find_empty_space`].
    pub fn find_empty_space(&self, run: &ShownRun) -> Result<()> {
        let check = || given_up(self.is_stopping());
        let mut work = Work::new(&self.queue, Rank::EmptySpace, &check);
        run.find_empty_space(&mut || work.next())
    }

    /// Renders what a page asks for: as large as it asks, or with `within` as large as so many milliseconds allow.
    pub fn picture(&self, runs: &[Arc<ShownRun>], arguments: &Arguments, has_gone: &dyn Fn() -> bool) -> Answer {
        let (run, weights) = run_of(runs, arguments)?;
        let (camera, layer) = (camera_of(runs, run, arguments)?, arguments.layer()?);
        let attack = arguments.attack(&sites_of(&weights))?;
        let within: Option<f64> = arguments.get("within").map(|_| arguments.number("within")).transpose()?;
        let check = self.wanted(arguments, has_gone)?;
        let rank = if within.is_some() { Rank::Quick } else { Rank::Sharp };
        let mut work = Work::new(&self.queue, rank, &check);
        work.next()?;
        let camera = within.map_or(camera, |within| run.camera_within(&camera, within / 1000.0, attack.as_ref()));
        let view = match &attack {
            Some(attack) => {
                perturbed_view(run, &weights, &camera, arguments.view(&runs[0].scene)?, attack, &mut || work.next())?
            }
            None => run.viewer(&weights).render_unless(weights.renderer(), &camera, MOST_RAYS, &mut || work.next())?,
        };
        let spent = work.end();
        run.note_cost(attack.as_ref(), camera.width * camera.height, spent);
        let depths = runs[0].weights().map_or(weights.depths, |first| first.depths);
        let image = draw_layer(layer, &view, &camera, (&run.scene, run.config.data.origin_of_pixels()), depths)?;
        let mut reply = match arguments.get("moving") {
            Some(_) => Reply::new("image/jpeg", encode_jpeg(&image, MOVING_QUALITY)?),
            None => png(&image)?,
        };
        reply.headers = vec![("X-Milliseconds", spent.as_millis().to_string())];
        Ok(reply)
    }

    /// Returns the photograph of a view.
    pub fn photograph(&self, runs: &[Arc<ShownRun>], arguments: &Arguments) -> Answer {
        png(&arguments.view(&runs[0].scene)?.ok_or_else(|| "view is missing".to_string())?.read()?.image)
    }

    /// Returns the samples along the ray of a pixel.
    pub fn ray(&self, runs: &[Arc<ShownRun>], arguments: &Arguments, has_gone: &dyn Fn() -> bool) -> Answer {
        let (run, weights) = run_of(runs, arguments)?;
        let camera = camera_of(runs, run, arguments)?;
        let (x, y): (u32, u32) = (arguments.number("x")?, arguments.number("y")?);
        if x as usize >= camera.width || y as usize >= camera.height {
            return Err(
                format!("x={x}, y={y}: outside the picture of {} x {} pixels", camera.width, camera.height).into()
            );
        }
        let perturbed = weights
            .perturbed
            .as_ref()
            .ok_or_else(|| "only fields on the processor have samples to show".to_string())?;
        let photo = arguments.view(&runs[0].scene)?.map(View::read).transpose()?;
        let attack = arguments.attack(&perturbed.sites())?;
        let check = self.wanted(arguments, has_gone)?;
        let mut work = Work::new(&self.queue, Rank::Quick, &check);
        work.next()?;
        let of = |attack: &Attack| -> Result<RaySamples> {
            let (rays, target) = rays_of(run, perturbed, &camera, &[(x, y)], photo.as_ref())?;
            let norm = f64::from(rays.direction_norm.flatten_all()?.to_vec1::<f32>()?[0]);
            RaySamples::of(&perturbed.pass(&rays, target.as_ref(), attack, 0)?, norm)
        };
        let clean = Attack { sites: Vec::new(), scale: 0.0 };
        let (clean, attacked) =
            run.runtime.install(|| -> Result<_> { Ok((of(&clean)?, attack.as_ref().map(of).transpose()?)) })?;
        Ok(json_reply(&json!({ "clean": clean, "attacked": attacked })))
    }
}

/// # Errors
/// [`Error::Interrupted`], if it is so.
fn given_up(is_given_up: bool) -> Result<()> {
    match is_given_up {
        true => Err(Error::Interrupted { signal: 0, message: "superseded".into() }),
        false => Ok(()),
    }
}

fn run_of<'a>(
    runs: &'a [Arc<ShownRun>],
    arguments: &Arguments,
) -> std::result::Result<(&'a ShownRun, Arc<Weights>), String> {
    let index: usize = arguments.number("run")?;
    let run = runs.get(index).ok_or_else(|| format!("run={index}: the page has {} runs, from 0", runs.len()))?;
    let weights = run.weights().ok_or_else(|| "the training has not made a step yet".to_string())?;
    Ok((run, weights))
}

/// Returns the camera. Views are named as the first run has them: another run may have other views.
fn camera_of(runs: &[Arc<ShownRun>], run: &ShownRun, arguments: &Arguments) -> std::result::Result<Camera, String> {
    arguments.camera(&runs[0].scene, run.scene.ndc.is_some())
}

fn sites_of(weights: &Weights) -> Vec<&'static str> {
    weights.perturbed.as_ref().map(|perturbed| perturbed.sites()).unwrap_or_default()
}

fn png(image: &Image) -> Answer {
    let made = encode_png8(image).map_err(|reason| Error::Output(format!("cannot encode a picture: {reason}")))?;
    Ok(Reply::new("image/png", made))
}

/// Returns what a photograph shows at pixels of a picture of its camera in another size, `[pixels, 3]`.
fn photographed(photo: &Image, camera: &Camera, pixels: &[(u32, u32)]) -> Result<Tensor> {
    let Image { width, height, channels, pixels: values } = photo;
    // `with_size` keeps the vertical field of view, around the middle of the columns.
    let scale = *height as f64 / camera.height as f64;
    let left = 0.5 * (*width as f64 - scale * camera.width as f64);
    let colours: Vec<f32> = pixels
        .iter()
        .flat_map(|&(x, y)| {
            let at = |value: f64, size: usize| (value.max(0.0) as usize).min(size - 1);
            let (x, y) = (at(left + scale * (f64::from(x) + 0.5), *width), at(scale * (f64::from(y) + 0.5), *height));
            let first = channels * (y * width + x);
            [values[first], values[first + 1], values[first + 2]]
        })
        .collect();
    Ok(Tensor::from_vec(colours, (pixels.len(), 3), &candle_core::Device::Cpu)?)
}

/// Returns the rays through pixels, and the colours of a photograph there.
fn rays_of(
    run: &ShownRun,
    perturbed: &PerturbedRenderer,
    camera: &Camera,
    pixels: &[(u32, u32)],
    photo: Option<&View>,
) -> Result<(Rays, Option<Tensor>)> {
    let of_camera: Vec<(&Camera, u32, u32)> = pixels.iter().map(|&(x, y)| (camera, x, y)).collect();
    let (ndc, origin) = (run.scene.ndc.as_ref(), run.config.data.origin_of_pixels());
    let rays = RayBuffer::new(&of_camera, ndc, origin, perturbed.ray_parts());
    let target = photo.map(|photo| photographed(&photo.image, camera, pixels)).transpose()?;
    Ok((rays.to_tensors(DType::F32, run.runtime.device())?, target))
}

/// Renders a view with the deltas of an attack.
fn perturbed_view(
    run: &ShownRun,
    weights: &Weights,
    camera: &Camera,
    view: Option<&View>,
    attack: &Attack,
    stop_check: &mut dyn FnMut() -> Result<()>,
) -> Result<RenderedView> {
    let perturbed = weights.perturbed.as_ref().expect("it has sites");
    // Read once: it may be a file.
    let photo = view.map(View::read).transpose()?;
    let (width, height) = (camera.width, camera.height);
    let pixels: Vec<(u32, u32)> = (0..height as u32).flat_map(|y| (0..width as u32).map(move |x| (x, y))).collect();
    let parts: Vec<(u64, &[(u32, u32)])> = (0..).zip(pixels.chunks(SEARCHED_RAYS)).collect();
    let render = |parts: &[(u64, &[(u32, u32)])]| -> Result<[Vec<f32>; 3]> {
        let (part, pixels) = parts[0];
        let (rays, target) = rays_of(run, perturbed, camera, pixels, photo.as_ref())?;
        let out = perturbed.pass(&rays, target.as_ref(), attack, part)?.composite;
        let host = |tensor: &Tensor| tensor.flatten_all()?.to_vec1::<f32>();
        Ok([host(&out.rgb)?, host(&(out.depth / &out.acc)?)?, host(&out.acc)?])
    };
    let mut rendered: [Vec<f32>; 3] = Default::default();
    for parts in parts.chunks(run.runtime.threads()) {
        stop_check()?;
        for part in run.runtime.install(|| run.runtime.over_parts(parts, 1, render))? {
            rendered.iter_mut().zip(part).for_each(|(whole, part)| whole.extend(part));
        }
    }
    let [pixels, depth, acc] = rendered;
    Ok(RenderedView { image: Image { width, height, channels: 3, pixels }, depth, acc })
}
