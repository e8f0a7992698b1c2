//! The work of a chunk of rays: its clean passes, its search, its perturbed passes.

use augnerf_core::base::rng::Stream;
use augnerf_core::methods::{coarse_weight, loss_weights};
use augnerf_core::perturb::{Draw, PaperSite};
use augnerf_core::settings::{DeltaSource, OutputPlace, PerturbField, Regularizer, Resample, Resolved, SecondPass};
use wgpu::Buffer;

use crate::device::groups;
use crate::kernels::Kernel;
use crate::network::FieldBuffers;
use crate::record::{DeltaBuffers, ON_RAYS, PassAt, PassLoss, Recorder, Resampling, Wanted, Words};
use crate::sets::{Deltas, DrawAt, HostChunks, Stretch};

use super::Steps;
use super::results::{COARSE, FINE, SECOND_COARSE, SECOND_FINE, alone, at_random, bounded, first_of};

/// Records the work of a chunk of rays.
pub(super) struct ChunkRecorder<'a> {
    pub(super) steps: &'a Steps,
    pub(super) ray0: usize,
    pub(super) rays: usize,
    /// With diagnostics.
    pub(super) log: bool,
}

/// The random numbers of a clean pass: one part of a stream for all rays of the step, or one for each chunk of the host.
#[derive(Clone, Copy, PartialEq)]
enum CleanPass {
    First,
    Second,
}

impl<'a> ChunkRecorder<'a> {
    pub(super) fn record(&self, recorder: &mut Recorder<'a>) {
        let steps = self.steps;
        let slots = [COARSE, FINE];
        let (clean_weight, perturbed_weight) = loss_weights(&steps.config, 0);
        self.clean(recorder, CleanPass::First, clean_weight, slots);
        if !steps.config.method.is_augmented() {
            return;
        }
        match steps.config.perturb.second {
            SecondPass::Clean => {
                self.clean(recorder, CleanPass::Second, perturbed_weight, [SECOND_COARSE, SECOND_FINE])
            }
            SecondPass::Perturbed(source) => self.perturbed(recorder, source, perturbed_weight),
        }
    }

    fn config(&self) -> &'a Resolved {
        &self.steps.config
    }

    /// Weight of the squared error of a channel.
    fn weight(&self, weight: f64) -> f64 {
        weight / (3 * self.config().train.rays) as f64
    }

    fn pass(&self, field: &'a FieldBuffers, is_coarse: bool, t_vals: &'a Buffer, slot: usize) -> PassAt<'a> {
        let (coarse, fine) = self.config().samples();
        let samples = if is_coarse { coarse } else { fine };
        PassAt {
            field,
            ray0: self.ray0,
            rays: self.rays,
            samples,
            columns: self.config().field.encoding.t_vals(samples),
            t_vals,
            noise: None,
            deltas: DeltaBuffers::default(),
            out: &self.steps.buffers.outs[slot],
        }
    }

    /// Records words of the clean pass's stream: `per_ray` numbers a ray, `before` a ray in the stream before them.
    fn numbers(&self, recorder: &mut Recorder<'a>, which: CleanPass, to: &Buffer, kind: Numbers, before: &[Numbers]) {
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
            CleanPass::First => {
                let offset = words_before(rays_of_step) + self.ray0 * kind.per_ray;
                draw(self.rays, 1, 0, offset, 0, Stream::Jitter);
            }
            CleanPass::Second => {
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
    fn noise(&self, recorder: &mut Recorder<'a>, which: CleanPass, is_coarse: bool) -> Option<&'a Buffer> {
        if self.config().density_noise == 0.0 {
            return None;
        }
        let kinds = self.kinds();
        let index = if is_coarse { 1 } else { 2 };
        let noise = &self.steps.buffers.noise;
        self.numbers(recorder, which, noise, kinds[index], &kinds[..index]);
        Some(noise)
    }

    /// Records a clean pass of both fields and its gradients.
    fn clean(&self, recorder: &mut Recorder<'a>, which: CleanPass, weight: f64, [coarse_slot, fine_slot]: [usize; 2]) {
        let steps = self.steps;
        let (config, buffers) = (self.config(), &steps.buffers);
        let kinds = self.kinds();
        self.numbers(recorder, which, &buffers.jitter, kinds[0], &[]);
        let columns = config.field.encoding.t_vals(config.sampling.coarse);
        let words = Words::default().u(self.rays).u(columns).u(0).u(0);
        let bound = [(1, &buffers.rows), (2, &buffers.jitter), (3, &buffers.t_coarse)];
        recorder.run(Kernel::new("sample"), words, &bound, groups(self.rays * columns));
        let coarse = self.pass(steps.coarse(), true, &buffers.t_coarse, coarse_slot);
        let is_first = which == CleanPass::First;
        let loss_of = |weight: f64, is_evaluated: bool| {
            let counts = |term: Regularizer| is_first && steps.counts_in_pass(term, is_evaluated);
            let of = |term: Regularizer| config.regularizer.terms().find(|(known, _)| *known == term && counts(term));
            let per_ray = |(_, weight): (Regularizer, f64)| weight / config.train.rays as f64;
            PassLoss {
                weight: self.weight(weight),
                terms: ON_RAYS.map(|(term, _)| of(term).map_or(0.0, per_ray)),
                occlusion_share: config.regularizer.occlusion_share,
            }
        };
        let trained = Wanted { weights: true, ..Wanted::default() };
        if config.representation().has_coarse_loss() {
            let noise = self.noise(recorder, which, true);
            let coarse = PassAt { noise, ..coarse };
            let weight = weight * coarse_weight(&steps.config);
            recorder.forward(&coarse, Some(loss_of(weight, steps.fine().is_none())));
            recorder.back(&coarse, trained);
        } else {
            recorder.place_by_density(&coarse);
        }
        let Some(field) = steps.fine() else { return };
        // The way back leaves the weights of the samples as they are.
        let t_fine = if is_first { &buffers.t_fine } else { &buffers.t_second };
        self.numbers(recorder, which, &buffers.u, kinds[3], &kinds[..3]);
        recorder.resample(self.resampling(), &buffers.t_coarse, &buffers.u, t_fine);
        let noise = self.noise(recorder, which, false);
        let fine = PassAt { noise, ..self.pass(field, false, t_fine, fine_slot) };
        recorder.forward(&fine, Some(loss_of(weight, true)));
        recorder.back(&fine, trained);
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

    /// Records the perturbed passes on the clean pass's samples.
    fn perturbed(&self, recorder: &mut Recorder<'a>, source: DeltaSource, weight: f64) {
        let steps = self.steps;
        let buffers = &steps.buffers;
        let separate = (self.config().perturb.field == PerturbField::Separate).then(|| steps.field("adversarial"));
        let own = separate.flatten();
        if self.config().representation().has_coarse_loss() {
            let field = own.unwrap_or_else(|| steps.coarse());
            let noise = self.noise(recorder, CleanPass::First, true);
            let pass = PassAt { noise, ..self.pass(field, true, &buffers.t_coarse, SECOND_COARSE) };
            self.perturbed_pass(recorder, 0, source, pass, weight * coarse_weight(&steps.config));
        }
        let Some(field) = steps.fine() else { return };
        let mut t_vals = &buffers.t_fine;
        if self.config().perturb.resample == Resample::Perturbed && self.config().representation().has_coarse_loss() {
            let t_coarse =
                match steps.sets[0].as_ref().is_some_and(|sets| sets.sites().any(|site| site == PaperSite::T)) {
                    true => recorder.moved_t_vals(),
                    false => &buffers.t_coarse,
                };
            let kinds = self.kinds();
            self.numbers(recorder, CleanPass::First, &buffers.u, kinds[3], &kinds[..3]);
            recorder.resample(self.resampling(), t_coarse, &buffers.u, &buffers.t_second);
            t_vals = &buffers.t_second;
        }
        let noise = self.noise(recorder, CleanPass::First, false);
        let pass = PassAt { noise, ..self.pass(own.unwrap_or(field), false, t_vals, SECOND_FINE) };
        self.perturbed_pass(recorder, 1, source, pass, weight);
    }

    /// Records the draws, the search, the perturbed pass with its gradients, and the diagnostics before it.
    fn perturbed_pass(
        &self,
        recorder: &mut Recorder<'a>,
        index: usize,
        source: DeltaSource,
        pass: PassAt<'a>,
        weight: f64,
    ) {
        let steps = self.steps;
        let perturb = &self.config().perturb;
        let sets = steps.sets[index].as_ref().expect("a perturbed pass has sets");
        let buffers = steps.buffers.sets[index].as_ref().expect("a perturbed pass has deltas");
        let before = perturb.output == OutputPlace::Before;
        recorder.radii(sets, buffers, &pass);
        let draw = if source == DeltaSource::Gaussian { Draw::Gaussian } else { Draw::Uniform };
        let at = self.draw_at(index, &pass, draw, Stream::Search, false);
        recorder.draw(&at);
        let deltas = buffers.of_pass(sets, Deltas::Searched, perturb.injection_layer, before);
        let pass = PassAt { deltas, ..pass };
        let loss = PassLoss { weight: self.weight(weight), ..PassLoss::default() };
        if source == DeltaSource::WorstCase {
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

    fn draw_at<'b>(&self, index: usize, pass: &'b PassAt<'a>, draw: Draw, stream: Stream, random: bool) -> DrawAt<'b>
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
        let at = self.draw_at(index, pass, Draw::Uniform, Stream::Diagnostics, true);
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
