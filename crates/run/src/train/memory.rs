//! Least memory of a training, checked before it is allocated. A system that runs out of memory kills the program
//! without a message.

use candle_core::Device;

use crate::base::{Error, Result};
use crate::data::{Scene, View};
use crate::field::{Order, encoded_channels, position_channels};
use crate::losses::LossTerm;
use crate::methods::{OCCUPANCY, parts};
use crate::model::Model;
use crate::runtime::free_memory_mib;
use crate::settings::{
    Core, Placing, PlanesConfig, Representation, Resolved, SrnConfig, TermNeeds, TermRays, VolumeConfig,
};
use crate::space::{CHUNKS_AT_ONCE, chunk_size};

/// A cell's number, its point and density, and its new depth.
const OF_A_LOOK: f64 = 6.0;

/// Weights, their gradient and Adam's two moments.
const COPIES: f64 = 4.0;
/// Of a sharpness-aware step: the gradient before the move, the move, and the parameters before it.
const COPIES_OF_MOVES: f64 = 3.0;
/// Outputs of a layer for density and its gradient: four of the values, the mask of active units, and two for each of three
/// tangents. A Laplacian has two more.
const OF_SLOPES: f64 = 11.0;
/// Numbers for each cell of LLFF's finest sampling grid.
const PER_CELL: f64 = 230.0;
/// Bytes of a number.
const NUMBER: f64 = 4.0;

/// An allocation, with the settings that decide its size.
struct Need {
    what: &'static str,
    settings: String,
    mib: f64,
}

/// Returns an error if a training with its evaluations needs more memory than this machine has free. Counts a lower
/// bound, so that nothing is rejected that could run.
///
/// # Errors
/// [`Error::Config`] names the settings, their need and the free memory.
pub fn check_memory(config: &Resolved, scene: &Scene, threads: usize) -> Result<()> {
    match free_memory_mib() {
        Some(free) => needs(config, scene, threads).iter().try_for_each(|need| check(need, free)),
        None => Ok(()),
    }
}

fn check(need: &Need, free: f64) -> Result<()> {
    if need.mib <= free {
        return Ok(());
    }
    let gib = |mib: f64| format!("{:.1} GiB", mib / 1024.0);
    Err(Error::Config(format!(
        "{}: {} take at least {}, but {} are free here; choose smaller numbers",
        need.settings,
        need.what,
        gib(need.mib),
        gib(free)
    )))
}

/// Returns the MiB that candle's graphs hold after the forward pass of a training step, for methods with fields.
/// Counts the output of every operation on the samples of each active chunk. The larger clean pass counts; a perturbed
/// one takes more.
pub fn graphs_mib(config: &Resolved, threads: usize) -> f64 {
    let (field, train) = (&config.field, &config.train);
    let together = config.regularizer.unseen_groups().last().map_or(1, |group| group.rays());
    let chunk = train.chunk.min(train.rays).max(together);
    let at_work = parts(train.rays.div_ceil(chunk)).min(threads);
    let (width, depth) = (field.width as f64, field.depth as f64);
    let (position, view) = (position_channels(field) as f64, encoded_channels(field.view_octaves) as f64);
    // A layer's product, its sum with the bias, its ReLU and that one's zeros; the encoding, its sines and their concatenation.
    let trunk = 4.0 * width * depth + 3.0 * position + field.skips.len() as f64 * (width + position);
    // The feature concatenated with the encoded direction, and the layers after it.
    let colour = 2.0 * width + width + view + 4.0 * (field.view_neurons() * field.view_depth) as f64;
    let samples = match (config.representation().has_coarse_loss(), config.samples()) {
        (true, _) => config.sampling.coarse + config.sampling.fine,
        // The coarse pass keeps no graph.
        (false, (_, fine)) => fine,
    } as f64;
    // The graph of the slopes stays beside that of the pass.
    let reads_slopes = terms_need(config, |needs| needs == TermNeeds::Slopes);
    let is_beside = reads_slopes && config.regularizer.rays == TermRays::Training;
    let slopes = if is_beside { OF_SLOPES * width * depth } else { 0.0 };
    let numbers = (at_work * chunk) as f64 * samples * (trunk + colour + slopes);
    // Terms in space come after the passes.
    numbers.max(numbers_in_space(config, threads)) * NUMBER / f64::from(1 << 20)
}

fn terms_need(config: &Resolved, what: impl Fn(TermNeeds) -> bool) -> bool {
    let terms = &config.regularizer;
    terms.terms().any(|(term, weight)| weight > 0.0 && what(LossTerm::of(term, terms).needs()))
}

/// Returns the numbers that terms in space keep of the active chunks of points on the CPU, if they read derivatives.
fn numbers_in_space(config: &Resolved, threads: usize) -> f64 {
    if !terms_need(config, |needs| matches!(needs, TermNeeds::Density(Order::Gradient | Order::Laplacian))) {
        return 0.0;
    }
    let at_once = chunk_size(&Device::Cpu) * threads.min(CHUNKS_AT_ONCE);
    let points = at_once.min(config.regularizer.quadrature(0, 0).count());
    points as f64 * OF_SLOPES * (config.field.width * config.field.depth) as f64
}

fn needs(config: &Resolved, scene: &Scene, threads: usize) -> Vec<Need> {
    let (field, train) = (&config.field, &config.train);
    let mib = |numbers: f64| numbers * NUMBER / f64::from(1 << 20);
    let parameters = Model::parameter_names(config);
    let size = |(_, shape): &(String, Vec<usize>)| shape.iter().map(|&n| n as f64).product::<f64>();
    let (cells, parameters): (Vec<_>, Vec<_>) = parameters.into_iter().partition(|(name, _)| name == OCCUPANCY);
    let (tables, layers): (Vec<_>, Vec<_>) = parameters.iter().partition(|(name, _)| name.ends_with(".table"));
    let (tables, layers) = (tables.into_iter().map(size).sum::<f64>(), layers.into_iter().map(size).sum::<f64>());
    let copies = COPIES + if train.sam_radius > 0.0 { COPIES_OF_MOVES } else { 0.0 };
    let mut needs = vec![Need {
        what: "weights, their gradient and Adam's moments",
        settings: sizes(config, tables > layers),
        mib: mib(copies * (tables + layers)),
    }];
    needs.extend(cells.iter().map(|cells| Need {
        what: "occupied cells, and an update of all of them,",
        settings: format!("sampling.occupancy.cells = {}", config.sampling.occupancy.cells),
        mib: mib((COPIES + OF_A_LOOK) * size(cells)),
    }));
    // The fused core works in tiles; candle's operations keep each layer's output for all points.
    if config.method.has_fields() && field.core == Core::Plain {
        let samples = match config.sampling.kind {
            Placing::Resampled => config.sampling.coarse + config.sampling.fine,
            Placing::Occupancy => config.sampling.occupancy.intervals,
        } as f64;
        let width = field.width as f64;
        needs.push(Need {
            what: "the layers' outputs of the active chunks, which the backward pass needs,",
            settings: format!(
                "train.chunk = {} of {} rays on {threads} threads, field.core = \"plain\"",
                train.chunk, train.rays
            ),
            mib: graphs_mib(config, threads),
        });
        let pixels = scene.test.iter().map(|view| view.camera.width * view.camera.height).max().unwrap_or(0);
        needs.push(Need {
            what: "a layer's input and output of a chunk",
            settings: format!("eval.chunk = {}, field.core = \"plain\"", config.eval.chunk),
            mib: mib(2.0 * config.eval.chunk.min(pixels) as f64 * samples * width),
        });
    }
    if config.representation() == Representation::Srn {
        needs.push(marches(config, threads));
    }
    if config.representation() == Representation::Planes {
        needs.push(windows(config, scene));
    }
    needs
}

/// Returns the memory of LLFF's network and blending for each reference's window, without the allocator's overhead.
/// Windows of 64 to 128 pixels took 920 to 1,080 bytes for each cell of the finest sampling grid.
fn windows(config: &Resolved, scene: &Scene) -> Need {
    let PlanesConfig { planes, window, references, .. } = config.llff;
    let cells = |view: &View| view.camera.width.min(window) * view.camera.height.min(window) * planes;
    let references = references.min(scene.train.len().saturating_sub(1));
    let cells = references * scene.train.iter().map(cells).min().unwrap_or(0);
    Need {
        what: "the layers' outputs of a step's windows, which the backward pass needs,",
        settings: format!("llff.window = {window} with llff.planes = {planes} and llff.references = {references}"),
        mib: cells as f64 * PER_CELL * NUMBER / f64::from(1 << 20),
    }
}

/// Returns the memory of each layer's product, bias, sum and normalized output, at every step along the rays of the active
/// chunks.
fn marches(config: &Resolved, threads: usize) -> Need {
    let (train, srn) = (&config.train, &config.srn);
    let chunk = train.chunk.min(train.rays).max(1);
    let at_work = parts(train.rays.div_ceil(chunk)).min(threads);
    let kept = 4 * (srn.phi_layers * (srn.steps + 1) + srn.pixel_layers);
    Need {
        what: "the layers' outputs of the active chunks, which the backward pass needs,",
        settings: format!(
            "train.chunk = {} of {} rays on {threads} threads, srn.width = {} with srn.steps = {}",
            train.chunk, train.rays, srn.width, srn.steps
        ),
        mib: (at_work * chunk) as f64 * (kept * srn.width) as f64 * NUMBER / f64::from(1 << 20),
    }
}

/// Returns the settings that most of the weights depend on.
fn sizes(config: &Resolved, of_tables: bool) -> String {
    let (field, hash) = (&config.field, &config.field.hash);
    match config.representation() {
        Representation::HashNerf if of_tables => {
            let (table, levels, features) = (hash.log2_table, hash.levels, hash.features);
            format!(
                "field.hash.log2_table = {table} with field.hash.levels = {levels} of field.hash.features = {features}"
            )
        }
        Representation::Nerf | Representation::MipNerf | Representation::HashNerf => {
            format!("field.width = {} with field.depth = {}", field.width, field.depth)
        }
        Representation::Srn => {
            let SrnConfig { width, phi_layers, pixel_layers, .. } = config.srn;
            format!("srn.width = {width} with srn.phi_layers = {phi_layers} and srn.pixel_layers = {pixel_layers}")
        }
        Representation::Volume => {
            let VolumeConfig { resolution, divide, warp_resolution, .. } = config.nv;
            format!("nv.resolution = {resolution}, nv.divide = {divide} and nv.warp_resolution = {warp_resolution}")
        }
        Representation::Planes => "method = \"llff\"".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{DataKind, build, parse_assignment};

    fn needs_of(settings: &[&str]) -> Vec<Need> {
        let assignments: Vec<_> = settings.iter().map(|text| parse_assignment(text).unwrap()).collect();
        let config = build(None, None, &assignments).unwrap().resolve(DataKind::Blender, crate::bench::EXTENT).unwrap();
        needs(&config, &scene_of(3), 2)
    }

    fn scene_of(views: usize) -> Scene {
        let mut scene = crate::bench::scene();
        scene.train = vec![scene.train[0].clone(); views];
        scene
    }

    #[test]
    fn networks_that_no_memory_holds_are_refused_in_a_sentence() {
        // 63 inner layers of 4096 x 4096, the feature's, and the view layer of half that width, in each of two
        // networks.
        let [need] = &needs_of(&["field.width=4096", "field.depth=64"])[..] else { panic!("one need") };
        let inner = 4.0 * 4.0 * 2.0 * 64.5 * 4096.0 * 4096.0 / f64::from(1 << 20);
        assert!((1.0..1.01).contains(&(need.mib / inner)), "{}", need.mib);
        let refusal = check(need, 16.0 * 1024.0).unwrap_err().to_string();
        for words in ["field.width = 4096", "field.depth = 64", "GiB", "16.0 GiB are free"] {
            assert!(refusal.contains(words), "{words}: {refusal}");
        }
        assert!(check(need, 40.0 * 1024.0).is_ok());
    }

    #[test]
    fn a_table_that_no_memory_holds_is_refused_by_what_makes_it_large() {
        let hash = "field.encoding=hash";
        let needs = needs_of(&[hash, "field.hash.log2_table=24", "field.hash.levels=32", "field.hash.features=8"]);
        let refusal = check(&needs[0], 1024.0).unwrap_err().to_string();
        for words in ["field.hash.log2_table = 24", "field.hash.levels = 32", "field.hash.features = 8"] {
            assert!(refusal.contains(words), "{words}: {refusal}");
        }
        let small = needs_of(&[hash, "field.hash.log2_table=8", "field.width=1024"]);
        assert!(small[0].settings.starts_with("field.width = 1024"), "{}", small[0].settings);
    }

    #[test]
    fn graphs_of_a_hash_field_count_the_channels_of_its_grid() {
        let of = |texts: &[&str]| needs_of(&[&["field.encoding=hash", "field.core=plain"], texts].concat())[1].mib;
        let usual = of(&[]);
        assert_eq!(of(&["field.position_octaves=20"]), usual);
        // Two chunks of 32 rays of 32 samples in the fine pass; three tensors of the 32 channels that 16 further levels have.
        let further = 2.0 * 32.0 * 32.0 * 3.0 * 32.0 * 4.0 / f64::from(1 << 20);
        assert!((of(&["field.hash.levels=32"]) - usual - further).abs() < 1e-9);
        assert_eq!(of(&["sampling.coarse=64"]), usual);
    }

    #[test]
    fn marches_count_by_their_layers_and_steps() {
        let of = |settings: &[&str]| needs_of(&[&["method=srn", "train.rays=1024"], settings].concat())[1].mib;
        // Two chunks of 128 rays: 4 layers at 11 points each, and 5, of four tensors of 256 numbers.
        assert_eq!(of(&[]), 4.0 * 256.0 * 49.0 * 256.0 * 4.0 / f64::from(1 << 20));
        assert_eq!(of(&["train.chunk=1024", "srn.steps=21"]), 4.0 * 1024.0 * 93.0 * 256.0 * 4.0 / f64::from(1 << 20));
    }

    #[test]
    fn windows_count_as_far_as_views_reach() {
        let of = |settings: &[&str]| needs_of(&[&["method=llff", "llff.references=2"], settings].concat())[1].mib;
        let camera = crate::bench::scene().train[0].camera;
        let mib = |[x, y]: [usize; 2], planes: usize| (2 * x * y * planes) as f64 * 920.0 / f64::from(1 << 20);
        assert_eq!(of(&["llff.window=16", "llff.crop=8"]), mib([16, 16], 32));
        assert_eq!(of(&["llff.window=1024", "llff.planes=64"]), mib([camera.width, camera.height], 64));
        // Each of three views has two others, whatever number is set.
        assert_eq!(of(&["llff.window=16", "llff.crop=8", "llff.references=5"]), mib([16, 16], 32));
    }

    #[test]
    fn chunks_of_the_plain_core_count_by_the_rays_that_there_are() {
        let all = needs_of(&["field.core=plain", "train.chunk=1048576", "eval.chunk=1048576"]);
        let [_, training, evaluation] = &all[..] else { panic!("three needs") };
        // 1,024 rays, 64 coarse and 64 fine samples; four tensors of each of 8 layers of 256 numbers are most of it.
        let trunk = 1024.0 * 128.0 * 4.0 * 8.0 * 256.0 * 4.0 / f64::from(1 << 20);
        assert!((1.1..1.3).contains(&(training.mib / trunk)), "{} of {trunk}", training.mib);
        let refusal = check(training, 100.0).unwrap_err().to_string();
        assert!(refusal.contains("train.chunk = 1048576 of 1024 rays on 2 threads"), "{refusal}");
        // Two threads have at most two active chunks.
        let of = |chunk: &str| needs_of(&["field.core=plain", chunk])[1].mib / training.mib;
        assert_eq!(of("train.chunk=512"), 1.0);
        assert_eq!(of("train.chunk=256"), 0.5);
        // Terms that read derivatives: 11 tensors a layer beside the pass, or of 1,024 points on each of two threads after it.
        let with = |term: &[&str]| needs_of(&[&["field.core=plain", "train.chunk=2"], term].concat())[1].mib;
        let slopes = |points: f64| points * 11.0 * 8.0 * 256.0 * 4.0 / f64::from(1 << 20);
        let orientation = with(&["regularizer.kind=orientation"]) - with(&[]);
        assert!((orientation - slopes(2.0 * 2.0 * 128.0)).abs() < 1e-9);
        assert_eq!(with(&["regularizer.kind=tv"]), slopes(2.0 * 1024.0));
        assert_eq!(with(&["regularizer.kind=l1"]), with(&[]));
        assert!(evaluation.mib < training.mib);
        assert_eq!(needs_of(&["train.chunk=1048576"]).len(), 1);
    }
}
