//! Samples in occupied cells: what is left out, what stays the same, and what does not go with them.

use crate::common::program::{Place, set};
use crate::common::{
    assert_refused, assert_same_bytes, assert_says, flat, parameters, put_on_grid, tiny_config, tiny_scene, trained,
};
use augnerf::base::rng::{Random, Stream};
use augnerf::data::{RayBuffer, RayParts, Rays};
use augnerf::field::{Density, Field, FieldDensity};
use augnerf::methods::Fields;
use augnerf::perturb::{PaperSite, Passes};
use augnerf::render::{
    Composite, Occupancy, OccupiedDensity, Pass, PlacedSamples, clean_pass, photometric_loss, sampling,
};
use augnerf::settings::{Config, Contraction, DensityActivation, Method, PixelOrigin, Placing, Resolved, Spacing};
use candle_core::{DType, Device, Tensor};

const BOUNDS: (f64, f64) = (2.0, 6.0);
const INTERVALS: usize = 40;
const THRESHOLD: f64 = 0.005;

/// A field on a grid, in a box that the rays of the tiny scene enter and leave.
fn config(method: Method, change: impl FnOnce(&mut Config)) -> Resolved {
    tiny_config(method, |config| {
        put_on_grid(config, 9);
        config.field.density_activation = DensityActivation::Exp;
        config.sampling.kind = Placing::Occupancy;
        let occupancy = &mut config.sampling.occupancy;
        (occupancy.intervals, occupancy.cells) = (INTERVALS, 16);
        (occupancy.refresh, occupancy.warmup, occupancy.first_rays) = (2, 4, 16);
        change(config);
    })
}

/// Rays through the rows of a test view.
fn rays(dtype: DType) -> Rays {
    let scene = tiny_scene();
    let pixels: Vec<_> = (0..48).map(|i| (&scene.test[0].camera, i % 16, 5 * (i / 16))).collect();
    let rays = RayBuffer::new(&pixels, None, PixelOrigin::Corner, RayParts::default());
    rays.to_tensors(dtype, &Device::Cpu).unwrap()
}

/// A pass over all intervals, or over those of cells.
fn rendered(field: &Field, rays: &Rays, placed: &PlacedSamples) -> Composite {
    clean_pass(field, Pass::noiseless(rays, placed, Some([1.0; 3]))).unwrap().composite
}

/// All intervals of rays.
fn all_intervals(rays: &Rays) -> PlacedSamples {
    let edges = INTERVALS + 1;
    let t_vals = sampling::stratified(BOUNDS, Spacing::Depth, rays.len(), edges, None, &rays.origins).unwrap();
    PlacedSamples::all(t_vals)
}

fn placed(occupancy: &Occupancy, field: &Field, rays: &Rays) -> PlacedSamples {
    let intervals = occupancy.march(rays, BOUNDS, None).unwrap();
    occupancy.place(field, rays, &intervals).unwrap()
}

fn most_apart(a: &Tensor, b: &Tensor) -> f64 {
    flat(a).iter().zip(flat(b)).fold(0.0, |most, (a, b)| most.max((a - b).abs()))
}

/// All sites are attacked. Cells are looked at in their first steps, at random later, and after the stop.
#[test]
fn it_has_the_same_bytes_on_threads_and_after_a_stop() {
    for contraction in [Contraction::None, Contraction::Ball] {
        let config = config(Method::AugNerf, |config| {
            PaperSite::ALL.into_iter().for_each(|site| config.perturb[site].passes = Passes::Fine);
            config.field.hash.contraction = Some(contraction);
        });
        let once = assert_same_bytes(&config, &["coarse", "occupancy"]);
        assert!(once.iter().all(|value| value.is_finite()), "{contraction:?}");
        let depths = &once[once.len() - 16usize.pow(3)..];
        let known = depths.iter().filter(|depth| **depth > 0.0).count();
        assert!(known > 2000, "{contraction:?}: {known} cells were looked at");
    }
}

/// A look that comes after the first steps is at all cells, too, if it is the first.
#[test]
fn the_first_look_is_at_all_cells() {
    let config = config(Method::Nerf, |config| (config.sampling.occupancy.warmup, config.train.steps) = (0, 3));
    let depths = parameters(&trained(&config, 2), &["occupancy"]);
    assert!(depths.len() == 16usize.pow(3) && depths.iter().all(|depth| *depth > 0.0));
}

/// A step that is interrupted leaves the cells as they were, so that it can be taken again.
#[test]
fn an_interrupted_step_leaves_the_cells() {
    let config = config(Method::Nerf, |_| {});
    let mut trainer = trained(&config, 2);
    let before = parameters(&trainer, &["coarse", "occupancy"]);
    let stop = || Err(augnerf::base::Error::Config("stop".into()));
    assert!(trainer.step_unless(false, true, &stop).is_err());
    assert_eq!(parameters(&trainer, &["coarse", "occupancy"]), before);
}

/// Rays that meet nothing are the background, alone or beside others, and the field is not queried there.
#[test]
fn rays_that_meet_no_cell_are_background() {
    let config = config(Method::Nerf, |_| {});
    for dtype in [DType::F32, DType::F64] {
        let fields = Fields::init(&config, &[0], dtype, &Device::Cpu).unwrap();
        let rays = rays(dtype);
        let away = Rays { origins: (&rays.origins * 10.0).unwrap(), directions: rays.directions.clone(), ..rays };
        let field = fields.coarse().frozen().unwrap();
        let placed = placed(fields.occupancy().unwrap(), &field, &away);
        assert_eq!(placed.queried.as_ref().unwrap().count(), 0);
        let out = rendered(&field, &away, &placed);
        assert!(flat(&out.rgb).iter().all(|colour| *colour == 1.0) && flat(&out.acc).iter().all(|acc| *acc == 0.0));
    }
}

/// With all cells occupied and nothing hidden it is the pass over all intervals, with its gradients: by kernels, and in double
/// precision by candle.
#[test]
fn with_all_cells_occupied_it_is_the_pass_over_all_intervals() {
    let config = config(Method::Nerf, |config| config.sampling.occupancy.transmittance = 0.0);
    for (dtype, tolerance) in [(DType::F32, 2e-5), (DType::F64, 1e-5)] {
        let fields = Fields::init(&config, &[0], dtype, &Device::Cpu).unwrap();
        let (field, rays) = (fields.coarse().recording().unwrap(), rays(dtype));
        let target = Tensor::zeros((rays.len(), 3), dtype, &Device::Cpu).unwrap();
        let results = [all_intervals(&rays), placed(fields.occupancy().unwrap(), &field.frozen().unwrap(), &rays)].map(
            |placed| {
                let count = placed.queried.as_ref().map(|queried| queried.count());
                assert!(count.is_none_or(|count| (100..rays.len() * INTERVALS).contains(&count)), "{count:?}");
                let field = fields.coarse().recording().unwrap();
                let out = rendered(&field, &rays, &placed);
                let store = photometric_loss(&out.rgb, &target).unwrap().backward().unwrap();
                let records = field.table_records();
                let mut gradients = field.recorded().unwrap();
                gradients[0] = field.table_gradient(&records).unwrap();
                let of_graph = field.variables().iter().map(|(_, var)| store.get(var).cloned());
                let gradients: Vec<Tensor> = gradients
                    .into_iter()
                    .zip(of_graph)
                    .map(|(recorded, of_graph)| recorded.or(of_graph).unwrap())
                    .collect();
                ([out.rgb, out.depth, out.acc], gradients)
            },
        );
        let [(full, full_gradients), (sparse, gradients)] = results;
        for (full, sparse) in full.iter().zip(&sparse) {
            assert!(most_apart(full, sparse) < tolerance, "{dtype:?}: {}", most_apart(full, sparse));
        }
        for (i, (full, sparse)) in full_gradients.iter().zip(&gradients).enumerate() {
            let scale = flat(full).iter().fold(1e-9, |most: f64, value| most.max(value.abs()));
            assert!(most_apart(full, sparse) < 1e-3 * scale, "{dtype:?} {i}: {} of {scale}", most_apart(full, sparse));
        }
    }
}

/// What is left out absorbs less than its cells' threshold allows: N intervals of optical depth d each, 1 - exp(-N d) of the light.
#[test]
fn what_is_left_out_does_not_change_pictures() {
    let config = config(Method::Nerf, |config| {
        (config.train.learning_rate, config.train.adam_epsilon) = (2e-2, 1e-15);
        (config.sampling.occupancy.threshold, config.train.steps) = (THRESHOLD, 400);
    });
    let mut trainer = trained(&config, 399);
    trainer.step(true).unwrap();
    let rays = rays(DType::F32);
    let fields = trainer.model().unwrap().fields().unwrap().frozen().unwrap();
    let (field, occupancy) = (fields.evaluated(), fields.occupancy().unwrap());
    occupancy.update(field, BOUNDS, true, &mut Random::new(1, Stream::Occupancy, 0)).unwrap();
    let sparse = placed(occupancy, field, &rays);
    let all = Fields::init(&config, &[0], DType::F32, &Device::Cpu).unwrap();
    let count = |placed: &PlacedSamples| placed.queried.as_ref().unwrap().count();
    let (queried, in_box) = (count(&sparse), count(&placed(all.occupancy().unwrap(), all.coarse(), &rays)));
    assert!(queried > 10 && queried < in_box, "{queried} samples are queried, of {in_box} in the box");
    let (full, sparse) = (rendered(field, &rays, &all_intervals(&rays)), rendered(field, &rays, &sparse));
    let off: f64 =
        flat(&(&full.rgb - &sparse.rgb).unwrap().abs().unwrap()).iter().sum::<f64>() / (3 * rays.len()) as f64;
    let skipped = (in_box - queried) as f64 / rays.len() as f64;
    let bound = 1.0 - (-THRESHOLD * skipped).exp();
    assert!(off < bound, "colours differ by {off}, {bound} is allowed; {queried} of {in_box} intervals");
    let evaluated = fields.evaluation(&config.sampling, BOUNDS, Some([1.0; 3])).render(&rays).unwrap();
    assert_eq!(flat(&evaluated.rgb), flat(&sparse.rgb), "an evaluation has the same samples");

    // In space, density is the field's in occupied cells, and 0 in others.
    let points = Tensor::rand(-1.5f32, 1.5, (4000, 3), &Device::Cpu).unwrap();
    let (own, occupied) = (FieldDensity::new(field).unwrap(), OccupiedDensity::new(field, occupancy).unwrap());
    let densities = |density: &dyn Density| flat(&density.density(&points, [0.0; 3]).unwrap());
    let (own, occupied) = (densities(&own), densities(&occupied));
    assert!(own.iter().zip(&occupied).all(|(own, occupied)| *occupied == 0.0 || own == occupied));
    let empty = occupied.iter().filter(|density| **density == 0.0).count();
    assert!((1..4000).contains(&empty), "{empty}");
}

/// Noise of a perturbed pass's output is not added where space is empty, and its terms are those of all rays.
#[test]
fn each_site_alone_changes_what_is_learned() {
    let nerf = parameters(&trained(&config(Method::Nerf, |_| {}), 3), &["coarse"]);
    for site in PaperSite::ALL {
        let config = config(Method::AugNerf, |config| {
            PaperSite::ALL.into_iter().for_each(|each| config.perturb[each].passes = Passes::Off);
            config.perturb[site].passes = Passes::Fine;
        });
        let mut trainer = trained(&config, 3);
        assert_ne!(parameters(&trainer, &["coarse"]), nerf, "{}", site.name());
        let stats = trainer.step(true).unwrap();
        let measured = &stats.sites[0];
        assert!(measured.gain.is_finite() && measured.shift > 0.0, "{measured:?}");
        assert!(site != PaperSite::Rgb || measured.gain > 0.0, "{measured:?}");
    }
}

/// The first steps have fewer rays, which double with every look.
#[test]
fn rays_of_the_first_steps_grow() {
    let config = config(Method::Nerf, |_| {});
    let rays: Vec<usize> = (0..7).map(|step| config.sampling.rays_at(config.train.rays, step)).collect();
    assert_eq!(rays, [16, 16, 32, 32, 64, 64, 64]);
    assert_eq!(config.sampling.rays_at(64, u64::MAX), 64);
    let sums = [0, 3, 7, 1000].map(|steps| config.rays_of_steps(steps));
    assert_eq!(sums, [0.0, 64.0, 288.0, 64.0 * 1000.0 - 160.0], "epochs count them");
}

#[test]
fn what_does_not_go_with_occupied_cells_is_refused() {
    assert_refused(&[
        ("sampling.kind=occupancy", &["sampling.kind", "hash grid", "field.encoding", "resampled"]),
        (
            "sampling.kind=occupancy; field.encoding=hash; sampling.density_noise=1",
            &["sampling.kind", "sampling.density_noise"],
        ),
        (
            "sampling.kind=occupancy; field.encoding=hash; sampling.spacing=disparity",
            &["sampling.spacing", "sampling.kind", "depth"],
        ),
        (
            "sampling.kind=occupancy; field.encoding=hash; regularizer.kind=cauchy; regularizer.weight=0.1",
            &["regularizer.kind = \"cauchy\"", "sampling.kind"],
        ),
        ("sampling.occupancy.cells=4", &["sampling.occupancy.cells", "8 to 256"]),
        ("sampling.occupancy.decay=1", &["sampling.occupancy.decay", "below 1"]),
    ]);
}

/// Preset `fast` takes them for objects, unless a setting says otherwise, and says what it takes.
#[test]
fn preset_fast_takes_occupied_cells_for_objects() {
    let place = Place::new();
    place.run("data export-builtin scene --width 40", 0);
    let small = set("data.width=40 eval.train_views=0");
    place.run(&format!("train --preset smoke --out run --quiet --set train.steps=2{small}"), 0);
    let (taken, refused) = ("only occupied cells of this object", "preset fast does not use occupied cells here");
    for (flags, said, kind) in [
        ("", Some(taken), "occupancy"),
        ("--preset fast --data scene --method aug-nerf", Some(taken), "occupancy"),
        ("--set sampling.kind=resampled", None, "resampled"),
        ("--set sampling.coarse=24", Some("sampling.coarse is set"), "resampled"),
        ("--set regularizer.kind=cauchy", Some(refused), "resampled"),
        ("--set field.encoding=positional", None, "resampled"),
        ("--preset fast --method srn", None, "resampled"),
        ("--data builtin-forward:3 --preset fast", None, "resampled"),
        ("--config run/config.toml --preset fast", None, "resampled"),
        ("--from run --set train.steps=4", None, "resampled"),
        ("--from run --preset fast --set train.steps=4", None, "resampled"),
        ("--preset few-views", None, "resampled"),
    ] {
        let size = if flags.contains("--data scene") { "" } else { " --set data.width=40" };
        let told = place.run(&format!("train --print-config {flags}{size}"), 0);
        assert_says(&told, &[said.unwrap_or(""), &format!("kind = \"{kind}\"\ncoarse = ")]);
        assert!(said.is_some() || !told.contains("occupied cells"), "{flags}: {told}");
    }
    // Cells of one scene say nothing of another.
    place.run(&format!("train --out occupied --quiet --set train.steps=2{small}"), 0);
    let other = "train --from occupied --restart --data scene --set train.steps=2 --out other";
    assert_says(&place.run(other, 2), &["--restart", "occupied cells", "sampling.kind=resampled"]);
    assert_says(
        &place.run(&other.replace("--data scene", "--data builtin-forward"), 2),
        &["--restart", "occupied cells"],
    );
    place.run(&format!("{other} --set sampling.kind=resampled --quiet"), 0);
    // Noise has no occupied cells.
    let timed = "bench --set field.encoding=hash --set sampling.kind=occupancy";
    assert_says(&place.run(timed, 2), &["sampling.kind = \"occupancy\"", "timing.json"]);
}
