//! The rays of a training step.

use std::sync::Arc;

use crate::base::rng::{Random, Stream};
use crate::base::{Error, Image, Result};
use crate::data::settings::PixelOrigin;
use crate::data::{Camera, Ndc, RayBuffer, RayParts, Scene, UnseenRay, View};
use crate::render::settings::SamplingConfig;
use crate::settings::{Batching, Resolved};

/// The training views' pixels, and the order in which they are drawn. A batch is a function of the seed and the step.
pub struct Batches {
    seed: u64,
    rays: usize,
    /// Says how many of them the first steps have.
    sampling: SamplingConfig,
    batching: Batching,
    precrop_steps: u64,
    precrop_fraction: f64,
    cameras: Vec<Camera>,
    /// Shared with the scene.
    images: Vec<Arc<Image>>,
    /// The pixels of each view outside its mask, row by row. `None` without a mask.
    unmasked: Vec<Option<Vec<u32>>>,
    /// Number of pixels in the views before each view, without masked ones, followed by the total.
    offsets: Vec<usize>,
    ndc: Option<Ndc>,
    pixel_origin: PixelOrigin,
    /// The parts of rays that the method needs.
    parts: RayParts,
    /// The shuffled pixels of one epoch over all images.
    epoch: Option<(u64, Vec<u32>)>,
}

/// One step's rays and their true colours.
pub struct Batch {
    /// One ray for each of `target`'s colours.
    pub rays: RayBuffer,
    /// RGB, `[rays, 3]`.
    pub target: Vec<f32>,
}

impl Batches {
    /// Creates batches over the training views of `scene`. It is an error if a batch is larger than the pixels it is
    /// drawn from.
    pub fn new(config: &Resolved, scene: &Scene, parts: RayParts) -> Result<Batches> {
        let unmasked: Vec<Option<Vec<u32>>> = scene.train.iter().map(unmasked).collect();
        let pixels = |(view, unmasked): (&View, &Option<Vec<u32>>)| {
            unmasked.as_ref().map_or(view.camera.width * view.camera.height, Vec::len)
        };
        let batches = Batches {
            seed: config.seed,
            rays: config.train.rays,
            batching: config.batching,
            precrop_steps: config.precrop_steps,
            precrop_fraction: config.train.precrop_fraction,
            cameras: scene.train.iter().map(|view| view.camera).collect(),
            images: scene.train.iter().map(|view| view.image.clone()).collect(),
            offsets: running_sums(scene.train.iter().zip(&unmasked).map(pixels)),
            unmasked,
            ndc: scene.ndc,
            pixel_origin: config.data.origin_of_pixels(),
            parts,
            sampling: config.sampling.clone(),
            epoch: None,
        };
        batches.check()?;
        Ok(batches)
    }

    fn check(&self) -> Result<()> {
        let (available, owner) = match self.batching {
            Batching::AllImages => (self.pixels(), "all training images have"),
            Batching::OneImage => {
                let smallest = (0..self.cameras.len()).map(|view| self.usable_pixels(view, 0));
                (smallest.min().unwrap_or(0), "one image (its central part during train.precrop_steps) has")
            }
        };
        if u32::try_from(available).is_err() {
            return Err(Error::Config(format!(
                "the training images have {available} pixels, more than 2^32 - 1; raise data.downscale"
            )));
        }
        if self.rays > available {
            return Err(Error::Config(format!(
                "train.rays = {} is out of range: it must be at most {available}, the pixels that {owner}{}",
                self.rays,
                if self.unmasked.iter().any(Option::is_some) { " beside its mask" } else { "" }
            )));
        }
        Ok(())
    }

    /// Returns the first pixel, and the number of pixels, that a step uses along a side of `size`.
    fn central_range(&self, size: usize, step: u64) -> (u32, u32) {
        if step >= self.precrop_steps {
            return (0, size as u32);
        }
        let used = ((size as f64 * self.precrop_fraction).round() as usize).clamp(1, size);
        (((size - used) / 2) as u32, used as u32)
    }

    /// Returns the cameras of the training views.
    pub fn cameras(&self) -> &[Camera] {
        &self.cameras
    }

    /// Returns rays of any cameras.
    pub fn rays_of(&self, pixels: &[UnseenRay]) -> RayBuffer {
        let rays: Vec<(&Camera, u32, u32)> = pixels.iter().map(|(camera, x, y)| (camera, *x, *y)).collect();
        RayBuffer::new(&rays, self.ndc.as_ref(), self.pixel_origin, self.parts)
    }

    /// Returns the batch of a step.
    pub fn batch(&mut self, step: u64) -> Batch {
        let mut pixels = match self.batching {
            Batching::AllImages => self.next_pixels(step),
            Batching::OneImage => self.pixels_of_one_image(step),
        };
        pixels.truncate(self.sampling.rays_at(self.rays, step));
        let rays: Vec<(&Camera, u32, u32)> = pixels.iter().map(|&(view, x, y)| (&self.cameras[view], x, y)).collect();
        let rays = RayBuffer::new(&rays, self.ndc.as_ref(), self.pixel_origin, self.parts);
        let target = pixels.iter().flat_map(|&(view, x, y)| {
            let start = (y as usize * self.cameras[view].width + x as usize) * 3;
            self.images[view].pixels[start..start + 3].iter().copied()
        });
        Batch { target: target.collect(), rays }
    }

    /// Returns the next part of a permutation of all pixels. Every epoch has its own permutation.
    fn next_pixels(&mut self, step: u64) -> Vec<(usize, u32, u32)> {
        let (total, rays) = (self.pixels(), self.rays);
        let per_epoch = (total / rays) as u64;
        let epoch = step / per_epoch;
        if self.epoch.as_ref().is_none_or(|(cached, _)| *cached != epoch) {
            let order = Random::new(self.seed, Stream::Batches, epoch).distinct(total, total as u32);
            self.epoch = Some((epoch, order));
        }
        let (_, order) = self.epoch.as_ref().expect("just made");
        let start = (step % per_epoch) as usize * rays;
        order[start..start + rays].iter().map(|&flat| self.locate(flat as usize)).collect()
    }

    /// Returns the number of pixels in all views.
    fn pixels(&self) -> usize {
        self.offsets[self.cameras.len()]
    }

    /// Returns view, column and row of a pixel, given its number among those of all views.
    fn locate(&self, flat: usize) -> (usize, u32, u32) {
        let view = self.offsets.partition_point(|&offset| offset <= flat) - 1;
        let (index, width) = (flat - self.offsets[view], self.cameras[view].width);
        let pixel = self.unmasked[view].as_ref().map_or(index, |unmasked| unmasked[index] as usize);
        (view, (pixel % width) as u32, (pixel / width) as u32)
    }

    /// Returns the number of pixels of a view that a step can use.
    fn usable_pixels(&self, view: usize, step: u64) -> usize {
        let ((_, width), (_, height)) = self.central_part(view, step);
        self.unmasked[view].as_ref().map_or((width * height) as usize, |_| self.unmasked_in_centre(view, step).len())
    }

    /// Returns the first pixel, and the number of pixels, that a step uses in both directions.
    fn central_part(&self, view: usize, step: u64) -> ((u32, u32), (u32, u32)) {
        let camera = &self.cameras[view];
        (self.central_range(camera.width, step), self.central_range(camera.height, step))
    }

    /// Returns the pixels of a masked view that a step can use.
    fn unmasked_in_centre(&self, view: usize, step: u64) -> Vec<(u32, u32)> {
        let ((x0, width), (y0, height)) = self.central_part(view, step);
        let (columns, unmasked) = (self.cameras[view].width as u32, self.unmasked[view].as_deref().unwrap_or_default());
        let pixels = unmasked.iter().map(|flat| (flat % columns, flat / columns));
        pixels.filter(|(x, y)| (x0..x0 + width).contains(x) && (y0..y0 + height).contains(y)).collect()
    }

    /// Returns distinct pixels of one image, of its central part during pre-crop.
    fn pixels_of_one_image(&self, step: u64) -> Vec<(usize, u32, u32)> {
        let mut random = Random::new(self.seed, Stream::Batches, step);
        let view = random.below(self.cameras.len() as u32) as usize;
        if self.unmasked[view].is_some() {
            let pixels = self.unmasked_in_centre(view, step);
            let chosen = random.distinct(self.rays, pixels.len() as u32);
            return chosen.iter().map(|&index| pixels[index as usize]).map(|(x, y)| (view, x, y)).collect();
        }
        let ((x0, width), (y0, height)) = self.central_part(view, step);
        let chosen = random.distinct(self.rays, width * height);
        chosen.iter().map(|&flat| (view, x0 + flat % width, y0 + flat / width)).collect()
    }
}

/// Returns the pixels outside a view's mask, row by row.
fn unmasked(view: &View) -> Option<Vec<u32>> {
    let mask = view.mask.as_ref()?;
    Some(mask.iter().enumerate().filter(|(_, counts)| **counts).map(|(flat, _)| flat as u32).collect())
}

/// Returns 0, the first, the sum of the first two, ..., the total.
fn running_sums(numbers: impl Iterator<Item = usize>) -> Vec<usize> {
    let mut sum = 0;
    std::iter::once(0)
        .chain(numbers.map(|number| {
            sum += number;
            sum
        }))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::settings::DataKind;
    use crate::settings::Config;

    fn scene() -> Scene {
        let camera = |width, height| Camera {
            width,
            height,
            focal: [10.0, 10.0],
            centre: [width as f64 / 2.0, height as f64 / 2.0],
            pose: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 4.0]],
        };
        let view = |index: usize| {
            let camera = camera(8, 6);
            // Every pixel's colour names it.
            let pixels = (0..48).flat_map(|p| [index as f32, (p % 8) as f32, (p / 8) as f32]).collect();
            let image = Image { width: 8, height: 6, channels: 3, pixels };
            View::new(index.to_string(), camera, image)
        };
        Scene {
            name: "test".into(),
            kind: "blender",
            train: (0..3).map(view).collect(),
            test: vec![],
            near: 2.0,
            far: 6.0,
            ndc: None,
            background: None,
            path: vec![],
            corrupted: None,
            lacks_split: false,
            space: Default::default(),
        }
    }

    fn batches(batching: Batching, rays: usize) -> Batches {
        let mut config = Config::default();
        config.train.rays = rays;
        config.train.batching = Some(batching);
        config.train.precrop_steps = Some(5);
        let (config, scene) = (config.resolve(DataKind::Blender, scene().extent()).unwrap(), scene());
        Batches::new(&config, &scene, RayParts::default()).unwrap()
    }

    #[test]
    fn an_epoch_shows_every_pixel_once_and_the_next_in_another_order() {
        let mut batches = batches(Batching::AllImages, 12);
        let mut epoch = |first: u64| -> Vec<Vec<f32>> {
            let targets: Vec<f32> = (first..first + 12).flat_map(|step| batches.batch(step).target).collect();
            targets.chunks(3).map(<[f32]>::to_vec).collect()
        };
        let (first, second) = (epoch(0), epoch(12));
        assert_ne!(first, second);
        let sorted = |mut pixels: Vec<Vec<f32>>| {
            pixels.sort_by(|a, b| a.partial_cmp(b).unwrap());
            pixels.dedup();
            pixels.len()
        };
        assert_eq!((sorted(first), sorted(second)), (144, 144));
    }

    #[test]
    fn one_image_batches_are_distinct_pixels_of_one_view_and_central_at_first() {
        let mut batches = batches(Batching::OneImage, 10);
        for step in 0..10 {
            let target = batches.batch(step).target;
            let pixels: Vec<&[f32]> = target.chunks(3).collect();
            assert!(pixels.iter().all(|p| p[0] == pixels[0][0]));
            let distinct = |i: usize| pixels[..i].iter().all(|p| *p != pixels[i]);
            assert!((0..pixels.len()).all(distinct));
            if step < 5 {
                assert!(pixels.iter().all(|p| (2.0..6.0).contains(&p[1]) && (1.0..5.0).contains(&p[2])), "{pixels:?}");
            }
        }
    }

    /// Of every view the left half counts, so that the mask cuts through the central part, too.
    fn masked(batching: Batching, rays: usize) -> Result<Batches> {
        let mut config = Config::default();
        config.train.rays = rays;
        config.train.batching = Some(batching);
        config.train.precrop_steps = Some(5);
        let mut scene = scene();
        let left: Arc<[bool]> = (0..48).map(|pixel| pixel % 8 < 4).collect();
        scene.train.iter_mut().for_each(|view| view.mask = Some(left.clone()));
        Batches::new(&config.resolve(DataKind::Blender, scene.extent()).unwrap(), &scene, RayParts::default())
    }

    #[test]
    fn masked_pixels_are_never_drawn_and_all_others_are() {
        let mut epochs = masked(Batching::AllImages, 12).unwrap();
        let targets: Vec<f32> = (0..6).flat_map(|step| epochs.batch(step).target).collect();
        let mut pixels: Vec<&[f32]> = targets.chunks(3).collect();
        assert!(pixels.iter().all(|pixel| pixel[1] < 4.0));
        pixels.sort_by(|a, b| a.partial_cmp(b).unwrap());
        pixels.dedup();
        assert_eq!(pixels.len(), 72);
        let mut batches = masked(Batching::OneImage, 6).unwrap();
        for step in 0..10 {
            let batch = batches.batch(step);
            assert_eq!((batch.rays.len(), batch.target.len()), (6, 18));
            let pixels: Vec<&[f32]> = batch.target.chunks(3).collect();
            assert!((0..6).all(|i| pixels[..i].iter().all(|pixel| *pixel != pixels[i])));
            let from = if step < 5 { 2.0..4.0 } else { 0.0..4.0 };
            assert!(pixels.iter().all(|pixel| from.contains(&pixel[1])), "{step}: {pixels:?}");
        }
        // The central part is 4 x 3, of which the left half counts.
        let message = masked(Batching::OneImage, 7).err().expect("too many").to_string();
        assert!(message.contains("at most 6") && message.contains("mask"), "{message}");
    }

    #[test]
    fn batches_are_a_function_of_the_step() {
        let (mut a, mut b) = (batches(Batching::AllImages, 10), batches(Batching::AllImages, 10));
        a.batch(3);
        a.batch(40);
        assert_eq!(a.batch(17).target, b.batch(17).target);
        assert_eq!(a.batch(17).rays.directions, b.batch(17).rays.directions);
    }
}
