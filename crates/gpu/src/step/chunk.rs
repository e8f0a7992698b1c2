//! The work of a chunk of rays: its clean passes, its search, its perturbed passes.

use augnerf_base::rng::Stream;
use augnerf_nerf::methods::{DeltaPlan, PassPlan, SampleSource};
use augnerf_nerf::perturb::{Distribution, PaperSite};
use augnerf_nerf::settings::{OutputPlace, Regularizer, Resolved, SecondPass};
use wgpu::Buffer;

use crate::device::groups;
use crate::kernels::Kernel;
use crate::record::{DeltaBuffers, ON_RAYS, PassAt, PassLoss, Recorder, Resampling, Wanted};
use crate::sets::{Deltas, DrawAt, HostChunks, PassSets, Stretch};

use super::Steps;
use super::results::{alone, at_random, bounded, first_of, slot};

/// Records the work of a chunk of rays.
pub(super) struct ChunkRecorder<'a> {
    pub(super) steps: &'a Steps,
    pub(super) ray0: usize,
    pub(super) rays: usize,
    /// With diagnostics.
    pub(super) log: bool,
}

/// The random numbers of a pass. `OfStep` are those of the step, of stream `Jitter`. `Redrawn` are new ones, of stream `Search` with
/// one part for each chunk. Perturbed passes have `OfStep`, as the clean passes that they repeat.
#[derive(Clone, Copy, PartialEq)]
enum Randoms {
    OfStep,
    Redrawn,
}

impl<'a> ChunkRecorder<'a> {
    /// Records the passes of the plan.
    pub(super) fn record(&self, recorder: &mut Recorder<'a>) {
        let plan = &self.steps.plan;
        let (clean_weight, second_weight) = self.steps.weights.passes;
        for pass in &plan.clean {
            self.clean(recorder, Randoms::OfStep, pass, clean_weight);
        }
        for pass in &plan.second {
            match &pass.deltas {
                Some(delta_plan) => self.perturbed(recorder, pass, delta_plan, second_weight),
                None => self.clean(recorder, Randoms::Redrawn, pass, second_weight),
            }
        }
    }

    fn config(&self) -> &'a Resolved {
        &self.steps.config
    }

    /// Weight of the squared error of a channel.
    fn weight(&self, weight: f64) -> f64 {
        weight / (3 * self.config().train.rays) as f64
    }

    fn pass(&self, plan: &PassPlan, is_second: bool, t_vals: &'a Buffer, noise: Option<&'a Buffer>) -> PassAt<'a> {
        PassAt {
            field: self.steps.field(plan.field),
            ray0: self.ray0,
            rays: self.rays,
            samples: plan.sample_count,
            columns: self.config().field.encoding.t_vals(plan.sample_count),
            t_vals,
            noise,
            deltas: DeltaBuffers::default(),
            out: &self.steps.buffers.outs[slot(plan, is_second)],
        }
    }

    /// Records words of the clean pass's stream: `per_ray` numbers a ray, `before` a ray in the stream before them.
    fn numbers(&self, recorder: &mut Recorder<'a>, which: Randoms, to: &Buffer, kind: Numbers, before: &[Numbers]) {
        let buffers = &self.steps.buffers;
        let rays_of_step = self.config().train.rays;
        let even = |count: usize, kind: &Numbers| if kind.normal { count.next_multiple_of(2) } else { count };
        let words_before = |rays: usize| before.iter().map(|kind| even(rays * kind.per_ray, kind)).sum::<usize>();
        let mut draw = |rays: usize, chunks: usize, part: usize, offset: usize, first: usize, stream: Stream| {
            let count = even(rays * kind.per_ray, &kind);
            let at = Stretch { stream, part, part_step: 1, chunks, count, offset, first };
            recorder.random(&buffers.now, to, at);
            if kind.normal {
                recorder.normal(to, chunks, count, kind.scale, first);
            }
        };
        match which {
            Randoms::OfStep => {
                let offset = words_before(rays_of_step) + self.ray0 * kind.per_ray;
                draw(self.rays, 1, 0, offset, 0, Stream::Jitter);
            }
            Randoms::Redrawn => {
                let chunk = self.config().train.chunk;
                let (whole, rest) = (self.rays / chunk, self.rays % chunk);
                let part = self.ray0 / chunk;
                draw(chunk, whole, part, words_before(chunk), 0, Stream::Search);
                let first = whole * chunk * kind.per_ray;
                draw(rest, usize::from(rest > 0), part + whole, words_before(rest), first, Stream::Search);
            }
        }
    }

    /// The numbers of a clean pass, in the order of its stream: jitter, noise of coarse and fine samples, places in the
    /// CDF.
    fn kinds(&self) -> [Numbers; 4] {
        let config = self.config();
        let (coarse, fine) = config.samples();
        let scale = config.density_noise;
        let noise = |samples: usize| Numbers { per_ray: if scale == 0.0 { 0 } else { samples }, normal: true, scale };
        let uniform = |per_ray: usize| {
            let per_ray = if config.sampling.jitter { per_ray } else { 0 };
            Numbers { per_ray, normal: false, scale: 1.0 }
        };
        let encoding = config.field.encoding;
        let drawn = if config.sampling.fine > 0 { encoding.t_vals(config.sampling.fine) } else { 0 };
        [uniform(encoding.t_vals(config.sampling.coarse)), noise(coarse), noise(fine), uniform(drawn)]
    }

    /// Records the noise of a pass, and returns it.
    fn noise(&self, recorder: &mut Recorder<'a>, which: Randoms, is_coarse: bool) -> Option<&'a Buffer> {
        if self.config().density_noise == 0.0 {
            return None;
        }
        let kinds = self.kinds();
        let index = if is_coarse { 1 } else { 2 };
        let noise = &self.steps.buffers.noise;
        self.numbers(recorder, which, noise, kinds[index], &kinds[..index]);
        Some(noise)
    }

    /// Records the samples of a pass, and returns them.
    fn samples(&self, recorder: &mut Recorder<'a>, which: Randoms, plan: &PassPlan) -> &'a Buffer {
        let buffers = &self.steps.buffers;
        let is_first = which == Randoms::OfStep && plan.deltas.is_none();
        let t_fine = if is_first { &buffers.t_fine } else { &buffers.t_second };
        match plan.samples {
            SampleSource::OfCleanPass if plan.is_coarse => &buffers.t_coarse,
            SampleSource::OfCleanPass => &buffers.t_fine,
            SampleSource::Stratified => self.stratified(recorder, which),
            SampleSource::PlacedByDensity => {
                let t_vals = self.stratified(recorder, which);
                let sample_count = self.config().sampling.coarse;
                let placing = PassPlan { is_coarse: true, field: "coarse", sample_count, ..plan.clone() };
                recorder.place_by_density(&self.pass(&placing, !is_first, t_vals, None));
                self.resample(recorder, which, t_vals, t_fine)
            }
            SampleSource::Occupied => unreachable!("refused before"),
            // The way back leaves the weights of the coarse samples as they are.
            SampleSource::Resampled => {
                let moves = |sets: &PassSets| plan.deltas.is_some() && sets.sites().any(|site| site == PaperSite::T);
                let t_coarse = match self.steps.sets[0].as_ref().is_some_and(moves) {
                    true => recorder.moved_t_vals(),
                    false => &buffers.t_coarse,
                };
                self.resample(recorder, which, t_coarse, t_fine)
            }
        }
    }

    /// Records samples in bins between near and far.
    fn stratified(&self, recorder: &mut Recorder<'a>, which: Randoms) -> &'a Buffer {
        let (config, buffers) = (self.config(), &self.steps.buffers);
        self.numbers(recorder, which, &buffers.jitter, self.kinds()[0], &[]);
        let columns = config.field.encoding.t_vals(config.sampling.coarse);
        let params = params! { rays: self.rays, columns };
        let bound = [(1, &buffers.rows), (2, &buffers.jitter), (3, &buffers.t_coarse)];
        recorder.run(Kernel::new("sample"), params, &bound, groups(self.rays * columns));
        &buffers.t_coarse
    }

    /// Records fine samples from the weights of the coarse ones.
    fn resample(
        &self,
        recorder: &mut Recorder<'a>,
        which: Randoms,
        t_coarse: &'a Buffer,
        t_fine: &'a Buffer,
    ) -> &'a Buffer {
        let (kinds, u) = (self.kinds(), &self.steps.buffers.u);
        self.numbers(recorder, which, u, kinds[3], &kinds[..3]);
        recorder.resample(self.resampling(), t_coarse, u, t_fine);
        t_fine
    }

    /// Records a clean pass and its gradients.
    fn clean(&self, recorder: &mut Recorder<'a>, which: Randoms, plan: &PassPlan, weight: f64) {
        let config = self.config();
        let t_vals = self.samples(recorder, which, plan);
        let noise = self.noise(recorder, which, plan.is_coarse);
        let pass = self.pass(plan, which == Randoms::Redrawn, t_vals, noise);
        let weight_of = |term: Regularizer| {
            let counts = plan.counts(term.is_of_evaluated_pass()) && self.steps.weights.has(term);
            counts.then(|| self.steps.weights.of_term(term) / config.train.rays as f64)
        };
        let loss = PassLoss {
            weight: self.weight(weight * plan.weight),
            terms: ON_RAYS.map(|(term, _)| weight_of(term)),
            occlusion_share: config.regularizer.occlusion_share,
        };
        recorder.forward(&pass, Some(loss));
        recorder.back(&pass, Wanted { weights: true, ..Wanted::default() });
    }

    fn resampling(&self) -> Resampling {
        let config = self.config();
        let intervals = config.field.encoding.at_intervals();
        Resampling {
            rays: self.rays,
            coarse: config.sampling.coarse,
            columns: config.field.encoding.t_vals(config.sampling.coarse),
            fine: config.field.encoding.t_vals(config.sampling.fine),
            intervals,
            padding: config.sampling.resample_padding,
            mode: match (config.sampling.jitter, intervals) {
                (false, _) => 2,
                (true, true) => 1,
                (true, false) => 0,
            },
        }
    }

    /// Records the draws of a perturbed pass, its search, the pass with its gradients, and the diagnostics before it.
    fn perturbed(&self, recorder: &mut Recorder<'a>, plan: &PassPlan, delta_plan: &DeltaPlan, weight: f64) {
        let (index, source) = (slot(plan, false), delta_plan.source);
        let t_vals = self.samples(recorder, Randoms::OfStep, plan);
        let noise = self.noise(recorder, Randoms::OfStep, plan.is_coarse);
        let pass = self.pass(plan, true, t_vals, noise);
        let steps = self.steps;
        let perturb = &self.config().perturb;
        let sets = steps.sets[index].as_ref().expect("a perturbed pass has sets");
        let buffers = steps.buffers.sets[index].as_ref().expect("a perturbed pass has deltas");
        let before = perturb.output == OutputPlace::Before;
        let draw = if source == SecondPass::Gaussian { Distribution::Gaussian } else { Distribution::Uniform };
        let at = self.draw_at(index, &pass, draw, Stream::Search, false);
        recorder.draw(&at);
        let deltas = buffers.of_pass(sets, Deltas::Searched, perturb.injection_layer, before);
        let pass = PassAt { deltas, ..pass };
        let loss = PassLoss { weight: self.weight(weight * plan.weight), ..PassLoss::default() };
        if source == SecondPass::WorstCase {
            // A loss without a weight: lambda may be 0.
            let searched = PassLoss { weight: self.weight(1.0), ..PassLoss::default() };
            for step in 0..sets.steps() {
                let moving = sets.moving(step);
                let on = |site: PaperSite| moving.contains(&site);
                let wanted = Wanted {
                    weights: false,
                    t: on(PaperSite::T),
                    xyz: on(PaperSite::Xyz),
                    view: on(PaperSite::View),
                    feature: on(PaperSite::Feature),
                };
                recorder.forward(&pass, Some(searched));
                recorder.back(&pass, wanted);
                for site in moving {
                    let gradient = recorder.gradient_of(site, perturb.output);
                    recorder.ascend(sets, buffers, &pass, site, gradient);
                }
            }
        }
        if self.log {
            self.diagnose(recorder, index, &pass);
        }
        recorder.forward(&pass, Some(loss));
        recorder.back(&pass, Wanted { weights: true, ..Wanted::default() });
    }

    fn draw_at<'b>(
        &self,
        index: usize,
        pass: &'b PassAt<'a>,
        draw: Distribution,
        stream: Stream,
        random: bool,
    ) -> DrawAt<'b>
    where
        'a: 'b,
    {
        let steps = self.steps;
        DrawAt {
            sets: steps.sets[index].as_ref().expect("a perturbed pass has sets"),
            buffers: steps.buffers.sets[index].as_ref().expect("a perturbed pass has deltas"),
            pass,
            draw,
            stream,
            is_coarse: index == 0,
            random,
            chunks: HostChunks {
                size: self.config().train.chunk.min(self.config().train.rays),
                ray0: self.ray0,
                rays: self.rays,
            },
            now: &steps.buffers.now,
            numbers: &steps.buffers.numbers,
        }
    }

    /// Records the passes without deltas, with each site's alone, and with random ones.
    fn diagnose(&self, recorder: &mut Recorder<'a>, index: usize, pass: &PassAt<'a>) {
        let steps = self.steps;
        let perturb = &self.config().perturb;
        let sets = steps.sets[index].as_ref().expect("a perturbed pass has sets");
        let buffers = steps.buffers.sets[index].as_ref().expect("a perturbed pass has deltas");
        let before = perturb.output == OutputPlace::Before;
        let at = self.draw_at(index, pass, Distribution::Uniform, Stream::Diagnostics, true);
        recorder.draw(&at);
        // The shares at bounds are those of the deltas that the complete pass uses.
        recorder.forward(pass, None);
        let padding = self.config().field.rgb_padding;
        for site in sets.sites() {
            let counts = (&steps.buffers.counts, bounded(index, site));
            recorder.at_bound(sets, buffers, pass, site, counts, padding);
        }
        let first = first_of(index);
        recorder.keep_used(sets, buffers, pass);
        let [used, random] =
            [Deltas::Used, Deltas::Random].map(|which| buffers.of_pass(sets, which, perturb.injection_layer, before));
        let render = |recorder: &mut Recorder<'a>, deltas: DeltaBuffers<'a>, slot: usize| {
            recorder.forward(&PassAt { deltas, out: &steps.buffers.outs[slot], ..*pass }, None);
        };
        render(recorder, DeltaBuffers { before, ..DeltaBuffers::default() }, first);
        for site in sets.sites() {
            render(recorder, used.only(site), alone(first, site));
            render(recorder, random.only(site), at_random(first, site));
        }
    }
}

/// Random numbers of a clean pass.
#[derive(Clone, Copy)]
struct Numbers {
    per_ray: usize,
    normal: bool,
    scale: f64,
}
