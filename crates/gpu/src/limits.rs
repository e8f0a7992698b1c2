//! What the device does not do, and how much it does at once.

use augnerf_base::{Error, Result};
use augnerf_nerf::settings::{
    ChangedEntries, Config, FieldConfig, Placing, Precision, Regularizer, Resolved, SecondPass,
};

use crate::device::Gpu;
use crate::network::Shape;
use crate::record::{Form, ON_RAYS, Scratch, most_parts};

/// Samples that the groups of one dispatch of a product reach.
const MOST_POINTS: usize = 64 * 65_535;
/// Positions of a ray that a group can sort.
const MOST_POSITIONS: usize = 2048;

/// Returns an error that names what a configuration asks for and the device does not do.
///
/// # Errors
/// [`Error::Config`].
pub fn check(config: &Resolved) -> Result<()> {
    check_fields(config)?;
    let refuse = |what: &str| Err(Error::Config(format!("device gpu does not train {what} yet; use --device cpu")));
    for (term, _) in config.regularizer.terms() {
        let on_rays = ON_RAYS.iter().any(|(known, _)| *known == term);
        if !on_rays && !matches!(term, Regularizer::L1 | Regularizer::Tv | Regularizer::Laplacian) {
            return refuse(&format!("with regularizer {}", term.name()));
        }
    }
    let (train, perturb, regularizer) = (&config.train, &config.perturb, &config.regularizer);
    let unsupported = [
        (!regularizer.unseen_groups().is_empty(), "with terms on unseen rays (regularizer.rays)"),
        (perturb.second == SecondPass::BestCase, "with perturb.kind = \"best-case\""),
        (perturb.second == SecondPass::Permuted, "with perturb.kind = \"permuted\""),
        (perturb.entries == ChangedEntries::Clean, "with perturb.entries = \"clean\""),
        (train.gradient_scaling, "with scaled gradients (train.gradient_scaling)"),
        (train.sam_radius > 0.0, "with sharpness-aware steps (train.sam_radius)"),
        (config.field.precision == Precision::Bf16, "in field.precision = \"bf16\""),
        (!train.chunk.is_multiple_of(2) && train.chunk < train.rays, "an odd train.chunk"),
    ];
    unsupported.iter().find(|(found, _)| *found).map_or(Ok(()), |(_, what)| refuse(what))
}

/// Returns the same error, and one for what this device lacks: a precision, large buffers, memory for a chunk of rays.
pub(crate) fn check_on(gpu: &Gpu, config: &Resolved) -> Result<()> {
    check(config)?;
    let (shape, (coarse, fine)) = (Shape::of(&config.field), config.samples());
    check_buffers(gpu, &config.field, &shape)?;
    rays_of_chunk(gpu, config, &shape, coarse.max(fine)).map(|_| ())
}

/// Returns an error for fields that the device neither trains nor renders.
pub(crate) fn check_fields(config: &Config) -> Result<()> {
    if !config.method.has_fields() {
        return Err(refused(&format!("method {}", config.method.name())));
    }
    check_field(&config.field)?;
    if config.sampling.kind == Placing::Occupancy {
        return Err(Error::Config(
            "device gpu does not compute sampling.kind = \"occupancy\" yet; use --device cpu, or train with --set \
             sampling.kind=resampled"
                .into(),
        ));
    }
    let (coarse, fine) = config.samples();
    if coarse.max(fine) + 1 > MOST_POSITIONS {
        return Err(refused(&format!("{} samples of a ray (at most {})", coarse.max(fine), MOST_POSITIONS - 1)));
    }
    Ok(())
}

/// Returns an error for a field whose density in space the device does not query.
pub(crate) fn check_density(config: &FieldConfig) -> Result<()> {
    if config.encoding.queries_gaussians() {
        return Err(refused("density in space of fields that are queried at Gaussians"));
    }
    check_field(config)
}

fn check_field(config: &FieldConfig) -> Result<()> {
    if !config.width.is_multiple_of(4) {
        return Err(refused(&format!("networks of width {}, which is no multiple of 4,", config.width)));
    }
    Ok(())
}

fn refused(what: &str) -> Error {
    Error::Config(format!("device gpu does not compute {what} yet; use --device cpu"))
}

/// Returns the samples whose numbers fit into the device's memory at once: those of [`Scratch`], and `more` bytes beside them.
pub(crate) fn samples_at_once(gpu: &Gpu, shape: &Shape, form: Form, more: usize) -> usize {
    let bytes = Scratch::bytes_per_sample(shape, form) + more;
    let widest = (4 * (shape.width + 4).max(shape.channels).max(shape.view_width)).max(form.bytes_of_trunk(shape));
    let parts = if form.trains { 4 * shape.weights() * most_parts(gpu, shape.weights()) } else { 0 };
    (gpu.budget().saturating_sub(parts) / bytes).min(gpu.largest_buffer() / widest).min(MOST_POINTS)
}

/// Returns an error for parameters that no buffer of the device holds.
pub(crate) fn check_buffers(gpu: &Gpu, config: &FieldConfig, shape: &Shape) -> Result<()> {
    // A number of a table has two words of its gradient.
    let table = shape.grid.as_ref().map_or(0, |grid| 8 * grid.entries() * grid.features());
    for (bytes, what, lower) in [
        (table, "the gradient of a hash table", format!("field.hash.log2_table ({})", config.hash.log2_table)),
        (4 * shape.weights(), "a network", format!("field.width ({})", config.width)),
    ] {
        if bytes > gpu.largest_buffer() {
            let mib = |bytes: usize| bytes.div_ceil(1 << 20);
            return Err(Error::Config(format!(
                "device gpu ({}) has buffers of {} MiB at most, and {what} needs {}; lower {lower}, or use --device cpu",
                gpu.adapter().name,
                mib(gpu.largest_buffer()),
                mib(bytes),
            )));
        }
    }
    Ok(())
}

/// Returns the rays whose samples fit into the device's memory at once: whole chunks of the host, an even number.
///
/// # Errors
/// A single chunk does not fit.
pub(crate) fn rays_of_chunk(gpu: &Gpu, config: &Resolved, shape: &Shape, samples: usize) -> Result<usize> {
    // Deltas of both passes, random ones, and the numbers that they are drawn from.
    let deltas = 4 * 5 * (shape.width + 8) * usize::from(config.method.is_augmented());
    let fits = samples_at_once(gpu, shape, Form::of_steps(gpu, config, shape), deltas) / samples;
    let unit = config.train.chunk.min(config.train.rays).next_multiple_of(2);
    // The draws of features are in one buffer, with a chunk more.
    let drawn = (gpu.largest_buffer() / (4 * (shape.width + 1) * samples)).saturating_sub(unit);
    let fits = if config.method.is_augmented() { fits.min(drawn) } else { fits };
    if fits < unit {
        return Err(Error::Config(format!(
            "device gpu ({}) has memory for {fits} rays of {samples} samples at once, which is less than a chunk; lower \
             train.chunk ({}) or field.width, or give a step more than its {} MiB with AUGNERF_GPU_MEMORY (in GiB)",
            gpu.adapter().name,
            config.train.chunk,
            gpu.budget() >> 20,
        )));
    }
    Ok((fits / unit * unit).min(config.train.rays))
}
