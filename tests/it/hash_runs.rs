//! Fields on a hash grid through everything that is done with a run, and through every kind of second pass.

use crate::common::files::rows;
use crate::common::program::{Place, set};
use crate::common::{parameters, put_on_grid, tiny_config, trained};
use augnerf::perturb::{PaperSite, Passes};
use augnerf::settings::{DensityActivation, Method, OutputPlace};

/// A run of half a second on the embedded scene at 16 x 16, in a box that rays enter and leave.
const SMALL: &str = "data.width=16 field.encoding=hash field.width=16 field.view_width=16 field.hash.levels=4 \
    field.hash.log2_table=10 field.hash.coarsest=4 field.hash.finest=32 sampling.coarse=16 sampling.fine=16 \
    train.rays=128 train.chunk=64";

/// A run of NeRF and one of Aug-NeRF, which are evaluated, rendered, compared, and drawn as a mesh.
#[test]
fn runs_on_a_grid_go_through_every_command() {
    let place = Place::new();
    for method in ["nerf", "aug-nerf"] {
        let small = set(&format!("{SMALL} train.steps=80 eval.pictures=0"));
        place.run(&format!("train --quiet --preset fast --method {method} --out {method}{small}"), 0);
    }
    let metrics = place.json("nerf/metrics.json");
    assert!(metrics["mean"]["psnr"].as_f64().unwrap() > 15.0, "{metrics}");
    assert!(metrics["protocol"]["hash_grid"].as_str().unwrap().contains("4 x 2, 2^10, 4 to 32"), "{metrics}");
    place.run("eval --quiet nerf", 0);
    assert_eq!(place.json("nerf/metrics.json"), metrics, "the checkpoint gives the numbers of the trained fields");
    place.run("render --quiet nerf --frames 2", 0);
    for file in ["rgb_001.png", "depth_001.png", "depth.json"] {
        assert!(place.at("nerf/renders/path").join(file).is_file(), "{file}");
    }

    place.run("compare -q nerf aug-nerf --out compared", 0);
    let report = place.json("compared/compare.json");
    for run in report["runs"].as_array().unwrap() {
        assert_eq!(run["protocol"]["hash_grid"], report["runs"][0]["protocol"]["hash_grid"]);
        assert!(run["protocol"]["hash_grid"].is_string(), "{run}");
    }
    place.run("compare -q nerf aug-nerf --ray 8,8 --out ray", 0);
    let densities = rows(&place.text("ray/ray.csv")).into_iter().map(|row| row["density"].parse::<f64>().unwrap());
    let densities: Vec<f64> = densities.collect();
    assert!(densities.iter().any(|density| *density > 0.0) && densities.contains(&0.0));

    place.run("mesh nerf --quiet --resolution 24 --threshold 1 --cap", 0);
    let report = place.json("nerf/mesh/mesh.json");
    assert_eq!(report["closed"], true, "{report}");
    assert!(report["area"].as_f64().unwrap() > 0.05, "{report}");
    let table = rows(&place.printed("eval --smoothness --quiet --lattice 8 nerf"));
    assert!(
        table.iter().all(|row| row["tv"].parse::<f64>().unwrap() > 0.0 && row["laplacian"].is_empty()),
        "{table:?}"
    );
}

/// The methods' small configuration on a grid.
fn on_a_grid(method: Method, change: impl FnOnce(&mut augnerf::settings::Config)) -> augnerf::settings::Resolved {
    tiny_config(method, |config| {
        put_on_grid(config, 10);
        config.field.density_activation = DensityActivation::Exp;
        (config.field.hash.coarsest, config.field.hash.finest) = (4, Some(32));
        config.train.adam_epsilon = 1e-15;
        change(config);
    })
}

/// Each site alone has its delta and an effect on what is learned; that of colours, in which the loss is convex, raises it.
#[test]
fn each_site_is_attacked_alone_on_a_grid() {
    let nerf = parameters(&trained(&on_a_grid(Method::Nerf, |_| {}), 2), &["coarse", "fine"]);
    for (site, output) in PaperSite::ALL
        .into_iter()
        .flat_map(|site| [OutputPlace::After, OutputPlace::Before].map(|output| (site, output)))
    {
        let config = on_a_grid(Method::AugNerf, |config| {
            for each in PaperSite::ALL {
                config.perturb[each].passes = if each == site { Passes::Fine } else { Passes::Off };
            }
            config.perturb.output = output;
        });
        let mut trainer = trained(&config, 2);
        assert_ne!(parameters(&trainer, &["coarse", "fine"]), nerf, "{}", site.name());
        let stats = trainer.step(true).unwrap();
        assert_eq!(stats.sites.iter().map(|measured| measured.site.as_str()).collect::<Vec<_>>(), [site.name()]);
        let measured = &stats.sites[0];
        assert!(measured.gain.is_finite() && measured.shift > 0.0, "{measured:?}");
        assert!(site != PaperSite::Rgb || measured.gain > 0.0, "{measured:?}");
    }
}
