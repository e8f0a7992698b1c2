//! The constraint sets of a pass on the device: radii, random points, and steps of the search.

use augnerf_base::Result;
use augnerf_base::rng::Stream;
use augnerf_nerf::methods::{DeltaPlan, PassPlan};
use augnerf_nerf::perturb::{
    AttackGeometry, Distribution, Epsilon, Level, Norm, PaperSite, PassGeometry, PerSite, Radius, SampleDensity, Sets,
    SiteNumbers, StepUnit, output_range,
};
use augnerf_nerf::settings::{OutputPlace, Resolved};
use augnerf_scenes::Scene;
use candle_core::{DType, Device, Tensor};
use wgpu::Buffer;

use crate::device::{Gpu, groups};
use crate::kernels::Kernel;
use crate::params::Params;
use crate::record::{DeltaBuffers, GradientAt, PassAt, Recorder};

/// A length of direction at which no cap shortens a pixel.
const FAR: f64 = 1e30;

/// The sets of a kind of pass, coarse or fine.
pub(crate) struct PassSets {
    sites: Vec<SiteSet>,
}

/// The set of one site.
struct SiteSet {
    site: PaperSite,
    numbers: SiteNumbers,
    radius: SiteRadius,
    /// Numbers of a vector.
    size: usize,
    /// Vectors of a ray.
    per_ray: usize,
    /// The last sample of a ray has no delta.
    masks: bool,
}

enum SiteRadius {
    /// One for all.
    One(f64),
    /// That of `t`: kind, share, coarse, drawn, coarse gap, reach, as in `set.wgsl`.
    OfGaps(usize, [f64; 5]),
    /// That of `xyz`: a pixel, capped by a part of the ray; both times epsilon.
    Pixel { pixel: f64, cap: f64 },
}

impl SiteSet {
    fn is_box(&self) -> bool {
        self.numbers.norm != Norm::L2
    }

    /// Returns the threads of a ray that draw or ascend: one a vector, or one a number of boxes.
    fn threads_of_ray(&self) -> usize {
        self.per_ray * if self.is_box() { self.size } else { 1 }
    }

    fn each(&self, kernel: Kernel) -> Kernel {
        kernel.with("EACH", self.is_box())
    }

    fn has_pixel(&self) -> bool {
        matches!(self.radius, SiteRadius::Pixel { .. })
    }
}

impl PassSets {
    /// Returns the sets of a perturbed pass.
    pub(crate) fn new(config: &Resolved, scene: &Scene, plan: &PassPlan, delta_plan: &DeltaPlan) -> Result<PassSets> {
        let columns = config.field.encoding.t_vals(plan.sample_count);
        let run = AttackGeometry::new(config, scene);
        let perturb = &config.perturb;
        let t_vals = Tensor::zeros((1, columns), DType::F64, &Device::Cpu)?;
        let direction_norm = &Tensor::full(FAR, (1, 1), &Device::Cpu)?;
        let (samples, is_coarse) = (plan.sample_count, plan.is_coarse);
        let pass = PassGeometry { run, is_coarse, t_vals: &t_vals, samples, direction_norm };
        let sets = Sets::new(delta_plan.sites.iter().cloned(), &pass)?;
        let sites = sets.iter().map(|entry| {
            let (site, set) = (entry.site.at(), &entry.set);
            let numbers = config.numbers[site];
            let one = || -> Result<f64> { Ok(set.radius.flatten_all()?.to_vec1::<f64>()?[0]) };
            let radius = match site {
                PaperSite::T => of_gaps(&numbers, &pass)?,
                PaperSite::Xyz if is_capped(&numbers, perturb.xyz_radius) => {
                    let epsilon = numbers.radius(|epsilon| epsilon);
                    let (near, far) = run.bounds;
                    let cap = (far - near) / (2.0 * (run.cap_samples() as f64 - 1.0)) * epsilon;
                    SiteRadius::Pixel { pixel: one()?, cap }
                }
                PaperSite::Xyz | PaperSite::View | PaperSite::Feature | PaperSite::Rgb | PaperSite::Density => {
                    SiteRadius::One(one()?)
                }
            };
            let (size_of, per_ray) = match site {
                PaperSite::T => (1, columns),
                PaperSite::View => (2, 1),
                PaperSite::Xyz | PaperSite::Rgb => (3, plan.sample_count),
                PaperSite::Feature => (config.field.width, plan.sample_count),
                PaperSite::Density => (1, plan.sample_count),
            };
            Ok(SiteSet { site, numbers, radius, size: size_of, per_ray, masks: set.mask.is_some() })
        });
        Ok(PassSets { sites: sites.collect::<Result<_>>()? })
    }

    /// Returns the sites that move in a step of the search.
    pub(crate) fn moving(&self, step: usize) -> Vec<PaperSite> {
        self.sites.iter().filter(|set| step < set.numbers.pgd.steps).map(|set| set.site).collect()
    }

    pub(crate) fn sites(&self) -> impl Iterator<Item = PaperSite> {
        self.sites.iter().map(|set| set.site)
    }

    /// Returns the number of steps of the search.
    pub(crate) fn steps(&self) -> usize {
        self.sites.iter().map(|set| set.numbers.pgd.steps).max().unwrap_or(0)
    }

    fn set(&self, site: PaperSite) -> &SiteSet {
        self.sites.iter().find(|set| set.site == site).expect("a site that is on")
    }
}

/// Returns whether the radius of `xyz` depends on the length of a ray's direction.
fn is_capped(numbers: &SiteNumbers, radius: Radius) -> bool {
    radius == Radius::Pixel && matches!(numbers.epsilon, Epsilon::Units(_))
}

fn of_gaps(numbers: &SiteNumbers, pass: &PassGeometry) -> Result<SiteRadius> {
    const LARGEST: f64 = 0.5;
    let density = pass.sample_density()?;
    let SampleDensity { coarse, drawn } = density;
    let (near, far) = pass.run.bounds;
    let coarse_gap = (far - near) / (pass.run.coarse_samples as f64 - 1.0);
    Ok(match (numbers.epsilon, density.uniform()) {
        (Epsilon::Units(epsilon), Some(density)) => {
            SiteRadius::OfGaps(0, [(epsilon / density).min(LARGEST), coarse, drawn, coarse_gap, 0.0])
        }
        (Epsilon::Units(epsilon), None) => SiteRadius::OfGaps(1, [epsilon, coarse, drawn, coarse_gap, 0.0]),
        (Epsilon::Reach, _) => {
            SiteRadius::OfGaps(2, [LARGEST, coarse, drawn, coarse_gap, numbers.radius(|epsilon| epsilon)])
        }
    })
}

/// The buffers of a pass's sets for a chunk of rays.
pub(crate) struct SetBuffers {
    deltas: PerSite<Option<Buffer>>,
    /// Random points, for the diagnostics.
    random: PerSite<Option<Buffer>>,
    /// Deltas of the output level as the complete pass used them, for the diagnostics.
    used: PerSite<Option<Buffer>>,
}

impl SetBuffers {
    pub(crate) fn new(gpu: &Gpu, sets: &PassSets, rays: usize) -> SetBuffers {
        let of = |site: PaperSite| {
            let set = sets.sites.iter().find(|set| set.site == site)?;
            Some(gpu.numbers(rays * set.per_ray * set.size))
        };
        SetBuffers {
            deltas: PerSite::from_fn(of),
            random: PerSite::from_fn(of),
            used: PerSite::from_fn(|site| of(site).filter(|_| site.spec().level == Level::Output)),
        }
    }

    /// Returns some deltas of all sites.
    pub(crate) fn of_pass<'a>(
        &'a self,
        sets: &PassSets,
        which: Deltas,
        layer: usize,
        before: bool,
    ) -> DeltaBuffers<'a> {
        let of = |site: PaperSite| match which {
            Deltas::Searched => self.deltas[site].as_ref(),
            Deltas::Random => self.random[site].as_ref(),
            Deltas::Used => self.used[site].as_ref().or(self.deltas[site].as_ref()),
        };
        let output = |site: PaperSite| {
            let buffer = of(site)?;
            let set = sets.set(site);
            let SiteRadius::One(radius) = set.radius else { unreachable!("one radius for all samples") };
            Some((buffer, radius, if site == PaperSite::Rgb { set.numbers.norm == Norm::L2 } else { set.masks }))
        };
        DeltaBuffers {
            t: of(PaperSite::T),
            xyz: of(PaperSite::Xyz),
            view: of(PaperSite::View),
            feature: of(PaperSite::Feature).map(|buffer| (buffer, layer)),
            rgb: output(PaperSite::Rgb),
            density: output(PaperSite::Density),
            before,
        }
    }
}

/// The deltas of a pass.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Deltas {
    /// Those of the search.
    Searched,
    /// The same, with those of the output level as the complete pass used them.
    Used,
    /// Random ones, for the diagnostics.
    Random,
}

/// Random numbers of a chunk of rays, in parts of the host's chunks.
#[derive(Clone, Copy)]
pub(crate) struct HostChunks {
    /// Rays of a chunk of the host.
    pub(crate) size: usize,
    pub(crate) ray0: usize,
    pub(crate) rays: usize,
}

impl HostChunks {
    /// Returns complete chunks and their number, and the rays of a last smaller one.
    fn split(self) -> (usize, usize) {
        (self.rays / self.size, self.rays % self.size)
    }

    /// Returns the number of the first chunk.
    fn first(self) -> usize {
        self.ray0 / self.size
    }
}

impl<'a> Recorder<'a> {
    /// Records so many words of a stream from an offset on: `count` of each of `chunks`.
    pub(crate) fn random(&mut self, now: &Buffer, numbers: &Buffer, at: Stretch) {
        let Stretch { stream, part, part_step, chunks, count, offset, first } = at;
        if count == 0 || chunks == 0 {
            return;
        }
        let blocks = (offset % 16 + count).div_ceil(16);
        let params = params! { stream: stream as usize, part, part_step, chunks, count, offset, blocks, first };
        self.run(Kernel::new("random"), params, &[(1, now), (2, numbers)], groups(chunks * blocks));
    }

    /// Records the map of uniform numbers to normal ones: `count` (even) of each of `chunks`.
    pub(crate) fn normal(&mut self, numbers: &Buffer, chunks: usize, count: usize, scale: f64, first: usize) {
        if count * chunks > 0 {
            let params = params! { chunks, count, scale, first };
            self.run(Kernel::new("normal"), params, &[(1, numbers)], groups(chunks * count / 2));
        }
    }

    /// The parameters of a set's kernels.
    fn set_params(&self, set: &SiteSet, pass: &PassAt, rest: SetParams) -> Params {
        let (mut radius, [mut pixel, mut cap], mut of_gaps) = (0.0, [0.0; 2], (0, [0.0; 5]));
        match set.radius {
            SiteRadius::One(of_all) => radius = of_all,
            SiteRadius::Pixel { pixel: of_pixel, cap: of_ray } => (pixel, cap) = (of_pixel, of_ray),
            SiteRadius::OfGaps(kind, numbers) => of_gaps = (kind, numbers),
        }
        let (kind, [share, coarse, drawn, coarse_gap, reach]) = of_gaps;
        let (near, far) = rest.range.unwrap_or(self.bounds);
        let SetParams { stride, offset, gaussian, chunk, normals, first, first_distance, .. } = rest;
        let (vectors, pgd) = (pass.rays * set.per_ray, &set.numbers.pgd);
        let masks_last = if set.masks { pass.samples } else { 0 };
        let ball = set.numbers.norm == Norm::L2;
        params! { vectors, size: set.size, ball, per_ray: set.per_ray, radius, near, far, masks_last }
            .and(params! { step: pgd.step_size, relative: pgd.unit == StepUnit::Relative, stride, offset, gaussian })
            .and(params! { chunk, normals, first, first_distance, ray0: pass.ray0, pixel, cap })
            .and(params! { kind, share, coarse, drawn, coarse_gap, reach })
    }

    fn set_kernel(&self, name: &'static str, set: &SiteSet) -> Kernel {
        Kernel::new(name).with("PIXEL", set.has_pixel()).with("BOUNDED", set.site == PaperSite::T)
    }

    /// The buffers of a set's kernels: the delta, the rays and the positions that its radii and bounds depend on.
    fn set_buffers<'b>(&self, set: &SiteSet, delta: &'b Buffer, pass: &PassAt<'b>) -> Vec<(u32, &'b Buffer)>
    where
        'a: 'b,
    {
        let mut bound = vec![(1, delta)];
        bound.extend(set.has_pixel().then_some((2, self.rays)));
        bound.extend((set.site == PaperSite::T).then_some((3, pass.t_vals)));
        bound
    }

    /// Records a random point of every set of a pass.
    pub(crate) fn draw(&mut self, at: &DrawAt) {
        let DrawAt { sets, buffers, pass, draw, stream, chunks, now, numbers, .. } = *at;
        let (whole, rest) = chunks.split();
        for set in &sets.sites {
            let number = 2 * chunks.first() as u64 + u64::from(at.is_coarse);
            let part = set.site.part(number) as usize;
            let part_step = (set.site.part(number + 2) - set.site.part(number)) as usize;
            let of_ray = set.per_ray * set.size;
            let per_chunk = chunks.size * of_ray;
            let gaussian = draw == Distribution::Gaussian;
            let ball = set.numbers.norm == Norm::L2 && !gaussian;
            let normals = if gaussian || ball { per_chunk.next_multiple_of(2) } else { per_chunk };
            let distances = (whole + 1) * normals;
            let vectors = chunks.size * set.per_ray;
            let stretch = |chunks: usize, chunk: usize, count: usize, offset: usize, first: usize| Stretch {
                stream,
                part: part + chunk * part_step,
                part_step,
                chunks,
                count,
                offset,
                first,
            };
            let of_rest = (rest * of_ray).next_multiple_of(if gaussian || ball { 2 } else { 1 });
            self.random(now, numbers, stretch(whole, 0, normals, 0, 0));
            self.random(now, numbers, stretch(1, whole, of_rest, 0, whole * normals));
            if gaussian || ball {
                self.normal(numbers, whole, normals, 1.0, 0);
                self.normal(numbers, 1, of_rest, 1.0, whole * normals);
            }
            if ball {
                self.random(now, numbers, stretch(whole, 0, vectors, normals, distances));
                let first = distances + whole * vectors;
                self.random(now, numbers, stretch(1, whole, rest * set.per_ray, of_rest, first));
            }
            let params =
                SetParams { gaussian, chunk: vectors, normals, first_distance: distances, ..SetParams::default() };
            let params = self.set_params(set, pass, params);
            let to = if at.random { &buffers.random } else { &buffers.deltas };
            let delta = to[set.site].as_ref().expect("a site that is on");
            let mut bound = self.set_buffers(set, delta, pass);
            bound.push((4, numbers));
            self.run(set.each(self.set_kernel("draw", set)), params, &bound, groups(pass.rays * set.threads_of_ray()));
        }
    }

    /// Records a step of the search of one site, from where the pass put its delta.
    pub(crate) fn ascend(
        &mut self,
        sets: &PassSets,
        buffers: &SetBuffers,
        pass: &PassAt,
        site: PaperSite,
        (gradient, stride, offset): GradientAt,
    ) {
        let set = sets.set(site);
        let params = self.set_params(set, pass, SetParams { stride, offset, ..SetParams::default() });
        let delta = buffers.deltas[site].as_ref().expect("a site that is on");
        let mut bound = self.set_buffers(set, delta, pass);
        bound.push((4, gradient));
        let used = self.used(site);
        bound.extend(used.map(|used| (5, used)));
        let kernel = set.each(self.set_kernel("ascend", set).with("USED", used.is_some()));
        self.run(kernel, params, &bound, groups(pass.rays * set.threads_of_ray()));
    }

    /// Keeps the deltas of the output level as the last pass used them.
    pub(crate) fn keep_used(&mut self, sets: &PassSets, buffers: &SetBuffers, pass: &PassAt) {
        for set in &sets.sites {
            if let (Some(from), Some(to)) = (self.used(set.site), &buffers.used[set.site]) {
                let count = pass.rays * set.per_ray * set.size;
                let params = params! { numbers: count };
                self.run(Kernel::new("copy"), params, &[(1, from), (2, to)], groups(count));
            }
        }
    }

    /// Records the count of numbers on the edge of a site's set, after the pass that used them. `padding` is that of
    /// colours.
    pub(crate) fn at_bound(
        &mut self,
        sets: &PassSets,
        buffers: &SetBuffers,
        pass: &PassAt,
        site: PaperSite,
        (counts, first): (&Buffer, usize),
        padding: f64,
    ) {
        let set = sets.set(site);
        let is_output = site.spec().level == Level::Output && !pass.deltas.before;
        let range = is_output.then(|| output_range(site, padding));
        // Values lie as their gradients do.
        let offset = if is_output { self.gradient_of(site, OutputPlace::After).2 } else { 0 };
        let params = self.set_params(set, pass, SetParams { offset, first, range, ..SetParams::default() });
        let delta = match self.used(site) {
            Some(used) => used,
            None => buffers.deltas[site].as_ref().expect("a site that is on"),
        };
        let mut bound = self.set_buffers(set, delta, pass);
        bound.push((4, counts));
        if is_output {
            bound.push((5, &self.scratch.values));
        }
        let kernel = self.set_kernel("at_bound", set).with("OUTPUT", is_output);
        self.run(kernel, params, &bound, groups(pass.rays * set.per_ray));
    }
}

/// A stretch of random words: `count` of each of `chunks`, from `offset` on, to `first`.
#[derive(Clone, Copy)]
pub(crate) struct Stretch {
    pub(crate) stream: Stream,
    pub(crate) part: usize,
    pub(crate) part_step: usize,
    pub(crate) chunks: usize,
    pub(crate) count: usize,
    pub(crate) offset: usize,
    pub(crate) first: usize,
}

/// What is drawn, and where to.
#[derive(Clone, Copy)]
pub(crate) struct DrawAt<'a> {
    pub(crate) sets: &'a PassSets,
    pub(crate) buffers: &'a SetBuffers,
    pub(crate) pass: &'a PassAt<'a>,
    pub(crate) draw: Distribution,
    pub(crate) stream: Stream,
    pub(crate) is_coarse: bool,
    /// Into the random deltas, not the search's.
    pub(crate) random: bool,
    pub(crate) chunks: HostChunks,
    pub(crate) now: &'a Buffer,
    pub(crate) numbers: &'a Buffer,
}

/// Parameters that only some of the sets' kernels read.
#[derive(Clone, Copy, Default)]
struct SetParams {
    stride: usize,
    offset: usize,
    gaussian: bool,
    chunk: usize,
    normals: usize,
    first: usize,
    first_distance: usize,
    range: Option<(f64, f64)>,
}

/// Returns the numbers that drawing needs for a chunk of rays.
pub(crate) fn numbers_to_draw(sets: &PassSets, rays: usize, chunk: usize) -> usize {
    let of =
        |set: &SiteSet| (rays.next_multiple_of(chunk) + chunk) * set.per_ray * (set.size + 1) + 2 * rays / chunk + 4;
    sets.sites.iter().map(of).max().unwrap_or(1)
}
