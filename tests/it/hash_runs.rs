//! Fields on a hash grid through everything that is done with a run, and through every kind of second pass.

use std::path::Path;
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

use crate::common::files::{json, points_of, rows, text};
use crate::common::program::{printed, succeed};
use crate::common::{parameters, tiny_config, trained};
use augnerf::augment::{Passes, Site};
use augnerf::settings::{DensityActivation, Encoding, Method, OutputPlace, PerturbField, REGULARIZERS, Regularizer};
use tempfile::TempDir;

/// A run of half a second on the embedded scene at 16 x 16, in a box that rays enter and leave.
const SMALL: &str = "data.width=16 field.encoding=hash field.width=16 field.view_width=16 field.hash.levels=4 \
    field.hash.log2_table=10 field.hash.coarsest=4 field.hash.finest=32 sampling.coarse=16 sampling.fine=16 \
    train.rays=128 train.chunk=64";

fn small() -> Vec<&'static str> {
    SMALL.split_whitespace().flat_map(|setting| ["--set", setting]).collect()
}

/// A run of NeRF and one of Aug-NeRF, which tests add folders of their own to: one at a time, as a run's lock demands.
fn pair() -> (MutexGuard<'static, ()>, [&'static str; 2]) {
    static ALONE: Mutex<()> = Mutex::new(());
    let alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    static DIR: OnceLock<(TempDir, [String; 2])> = OnceLock::new();
    let (_, runs) = DIR.get_or_init(|| {
        let dir = TempDir::new().unwrap();
        let runs = ["nerf", "aug-nerf"].map(|method| {
            let out = dir.path().join(method).display().to_string();
            let train = ["train", "--quiet", "--preset", "fast", "--method", method, "--out", &out];
            let short = ["--set", "train.steps=80", "--set", "eval.pictures=0"];
            succeed(&[&train[..], &small(), &short].concat());
            out
        });
        (dir, runs)
    });
    (alone, runs.each_ref().map(String::as_str))
}

#[test]
fn a_run_on_a_grid_is_evaluated_and_rendered() {
    let (_alone, [run, _]) = pair();
    let path = Path::new(run).join("metrics.json");
    let metrics = json(&path);
    assert!(metrics["mean"]["psnr"].as_f64().unwrap() > 15.0, "{metrics}");
    assert!(metrics["protocol"]["hash_grid"].as_str().unwrap().contains("4 x 2, 2^10, 4 to 32"), "{metrics}");
    succeed(&["eval", "--quiet", run]);
    assert_eq!(json(&path), metrics, "the checkpoint gives the same numbers as the trained fields");
    succeed(&["render", "--quiet", run, "--frames", "2"]);
    for file in ["rgb_001.png", "depth_001.png", "depth.json"] {
        assert!(Path::new(run).join("renders/path").join(file).is_file(), "{file}");
    }
}

#[test]
fn runs_on_a_grid_are_compared_and_profiled() {
    let dir = TempDir::new().unwrap();
    let (_alone, [a, b]) = pair();
    let [compared, ray] = ["compared", "ray"].map(|name| dir.path().join(name).display().to_string());
    succeed(&["compare", "-q", a, b, "--out", &compared]);
    let report = json(&Path::new(&compared).join("compare.json"));
    for run in report["runs"].as_array().unwrap() {
        assert_eq!(run["protocol"]["hash_grid"], report["runs"][0]["protocol"]["hash_grid"]);
        assert!(run["protocol"]["hash_grid"].is_string(), "{run}");
    }
    succeed(&["compare", "-q", a, b, "--ray", "8,8", "--out", &ray]);
    let table = rows(&text(&Path::new(&ray).join("ray.csv")));
    let density = |row: &std::collections::HashMap<String, String>| row["density"].parse::<f64>().unwrap();
    assert!(table.iter().any(|row| density(row) > 0.0) && table.iter().any(|row| density(row) == 0.0));
}

#[test]
fn a_run_on_a_grid_is_drawn_as_a_mesh() {
    let (_alone, [run, _]) = pair();
    let draw = ["mesh", run, "--quiet", "--resolution", "24", "--threshold", "1", "--cap"];
    succeed(&draw);
    let report = json(&Path::new(run).join("mesh/mesh.json"));
    assert_eq!(report["closed"], true, "{report}");
    assert!(report["area"].as_f64().unwrap() > 0.05, "{report}");
    let table = rows(&printed(&["eval", "--smoothness", "--quiet", "--lattice", "8", run]));
    assert!(
        table.iter().all(|row| row["tv"].parse::<f64>().unwrap() > 0.0 && row["laplacian"].is_empty()),
        "{table:?}"
    );
}

#[test]
fn weights_of_terms_are_balanced_on_a_grid() {
    let further = ["--set", "field.hash.interpolation=smoothstep", "--set", "regularizer.points_per_step=64"];
    let balance = ["train", "--balance=3", "--quiet", "--preset", "fast"];
    let table = rows(&printed(&[&balance[..], &small(), &further].concat()));
    // The scene has no triangulated points.
    assert_eq!(table.len(), 5 * (REGULARIZERS.len() - 1), "five shares of each term: {table:?}");
    for row in table.into_iter().filter(|row| row["term_norm"].parse() != Ok(0.0)) {
        assert!(row["weight"].parse::<f64>().unwrap() > 0.0, "{row:?}");
    }
}

#[test]
fn a_sweep_of_grids_ends_in_its_table() {
    let dir = TempDir::new().unwrap();
    let settings = SMALL.split_whitespace().map(|setting| {
        let (name, value) = setting.split_once('=').unwrap();
        let value = if value.parse::<u32>().is_ok() { value.to_string() } else { format!("\"{value}\"") };
        format!("\"{name}\" = {value}\n")
    });
    let definition = format!(
        "title = \"grids\"\npreset = \"fast\"\nscenes = [\"builtin\"]\nseeds = [0, 1]\nmetrics = [\"psnr\", \"tv\"]\n\
         baseline = \"NeRF\"\n[set]\n{}\"train.steps\" = 10\n\"eval.pictures\" = 0\n[[row]]\nname = \"NeRF\"\n\
         [[row]]\nname = \"Aug-NeRF\"\nset = {{ method = \"aug-nerf\" }}\n",
        settings.collect::<String>()
    );
    let file = dir.path().join("grids.toml").display().to_string();
    std::fs::write(&file, definition).unwrap();
    let out = dir.path().join("out").display().to_string();
    succeed(&["sweep", "run", &file, "--out", &out, "--quiet"]);
    let points = points_of(&Path::new(&out).join("results"));
    assert_eq!(points.len(), 4, "two rows, two seeds");
    for point in points {
        assert!(
            point["psnr"].parse::<f64>().unwrap() > 5.0 && point["hash_grid"].contains("4 x 2, 2^10, 4 to 32"),
            "{point:?}"
        );
    }
}

/// The methods' small configuration on a grid.
fn on_a_grid(method: Method, change: impl FnOnce(&mut augnerf::settings::Config)) -> augnerf::settings::Resolved {
    tiny_config(method, |config| {
        config.field.encoding = Encoding::Hash;
        config.field.density_activation = DensityActivation::Exp;
        (config.field.hash.levels, config.field.hash.log2_table) = (4, 10);
        (config.field.hash.coarsest, config.field.hash.finest) = (4, Some(32));
        config.train.adam_epsilon = 1e-15;
        change(config);
    })
}

/// Each site alone has its delta and an effect on what is learned; that of colours, in which the loss is convex, raises it.
#[test]
fn each_site_is_attacked_alone_on_a_grid() {
    let nerf = parameters(&trained(&on_a_grid(Method::Nerf, |_| {}), 2), &["coarse", "fine"]);
    for (site, output) in
        Site::ALL.into_iter().flat_map(|site| [OutputPlace::After, OutputPlace::Before].map(|output| (site, output)))
    {
        let config = on_a_grid(Method::AugNerf, |config| {
            for (each, section) in config.perturb.sites.iter_mut() {
                section.passes = if each == site { Passes::Fine } else { Passes::Off };
            }
            config.perturb.output = output;
        });
        let mut trainer = trained(&config, 2);
        assert_ne!(parameters(&trainer, &["coarse", "fine"]), nerf, "{}", site.name());
        let stats = trainer.step(true).unwrap();
        assert_eq!(stats.sites.iter().map(|measured| measured.site.as_str()).collect::<Vec<_>>(), [site.name()]);
        let measured = &stats.sites[0];
        assert!(measured.gain.is_finite() && measured.shift > 0.0, "{measured:?}");
        assert!(site != Site::Rgb || measured.gain > 0.0, "{measured:?}");
    }
}

/// A separate field learns from the perturbed loss alone; the evaluated one from the clean loss alone.
#[test]
fn a_separate_field_leaves_the_evaluated_grid_alone() {
    let with = |method, field| on_a_grid(method, |config| config.perturb.field = field);
    let start = trained(&with(Method::AugNerf, PerturbField::Separate), 0);
    let nerf = trained(&with(Method::Nerf, PerturbField::Shared), 2);
    let shared = trained(&with(Method::AugNerf, PerturbField::Shared), 2);
    let separate = trained(&with(Method::AugNerf, PerturbField::Separate), 2);
    let evaluated = |trainer| parameters(trainer, &["coarse", "fine"]);
    assert!(!evaluated(&nerf).is_empty());
    assert_ne!(evaluated(&nerf), evaluated(&shared));
    assert_eq!(evaluated(&nerf), evaluated(&separate));
    assert_ne!(parameters(&start, &["adversarial"]), parameters(&separate, &["adversarial"]));
}

/// The distortion loss is reported, and descended: with it rays end in one place more than without.
#[test]
fn the_distortion_loss_is_descended_on_a_grid() {
    let spread = |weight: f64| {
        let config = on_a_grid(Method::Nerf, |config| {
            config.regularizer.kind = vec![Regularizer::Distortion];
            config.regularizer.weight = vec![weight];
        });
        trained(&config, 60).step(false).unwrap().term("regularizer.distortion").unwrap()
    };
    let (weak, strong) = (spread(1e-9), spread(0.3));
    assert!(strong > 0.0 && strong < 0.9 * weak, "{strong} with the term, {weak} without");
}
