//! What shipped sweeps promise: controls, equal cost, and points that hang on no clock.

use std::path::Path;
use std::sync::atomic::Ordering;

use augnerf::base::Error;
use augnerf::perturb::{Epsilon, PaperSite};
use augnerf::settings::{Config, DeltaSource, Representation, SecondPass};
use augnerf::sweep::{Definition, Point, PublishedCosts, StepCosts, SweepFolder, begin, expand};
use tempfile::TempDir;

use crate::common::files::ending;
use crate::sweep_run::{BASE, Costs, Slower, parse, points_of};

/// Every shipped sweep by its file's name, with one seed.
fn shipped() -> Vec<(String, Definition)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("sweeps");
    let read = |path: std::path::PathBuf| {
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        let mut definition = Definition::read(&path).unwrap();
        definition.seeds.truncate(1);
        (name, definition)
    };
    ending(&folder, ".toml").into_iter().map(read).collect()
}

/// Beside the worst case over all sites a sweep trains a second clean pass and uniform deltas, but where docs/sweeps.md says that
/// it lacks one. Sweeps within the method, of its variants and precisions, need none.
#[test]
fn every_shipped_sweep_with_an_augmented_row_has_its_controls() {
    let page = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/sweeps.md")).unwrap();
    let (_, listed) = page.split_once("\nThese lack one or both:\n").expect("the page lists them");
    let listed: Vec<&str> = listed.trim_start().split("\n\n").next().unwrap().split('`').skip(1).step_by(2).collect();
    let is_listed = |name: &str| listed.iter().any(|listed| name.starts_with(listed.trim_end_matches('*')));
    let is_within = |name: &str| ["variants", "precision"].iter().any(|start| name.starts_with(start));
    let lacks = |(name, definition): &(String, Definition)| {
        let points = expand(definition, None, &Costs).unwrap();
        let has = |second: SecondPass| {
            let whole = |config: &Config| PaperSite::ALL.into_iter().all(|site| config.perturb.sites[site].on());
            let augmented = points.iter().map(|point| &point.config).filter(|config| config.method.is_augmented());
            augmented.filter(|config| whole(config)).any(|config| config.perturb.second == second)
        };
        let [worst, uniform] = [DeltaSource::WorstCase, DeltaSource::Uniform].map(SecondPass::Perturbed);
        let is_excused = is_listed(name) || is_within(name) || !has(worst);
        !is_excused && [SecondPass::Clean, uniform].into_iter().any(|control| !has(control))
    };
    let lacking: Vec<String> = shipped().into_iter().filter(lacks).map(|(name, _)| name).collect();
    assert_eq!(lacking, Vec::<String>::new(), "lack a control, and docs/sweeps.md does not say so");
}

/// The paper's claim is a smaller gap between seen and unseen views: every table has it, and every curve held-out values on its
/// way, about twenty of them.
#[test]
fn every_shipped_sweep_tells_seen_from_unseen_views() {
    let mut sweeps = 0;
    for (name, definition) in shipped() {
        assert!(definition.metrics.iter().any(|metric| metric == "gap"), "{name}: no gap");
        for point in expand(&definition, None, &Costs).unwrap() {
            let (train, eval) = (&point.config.train, &point.config.eval);
            // LLFF shows seen views from their own planes, so that its gap says little, and predicts planes for each evaluation.
            let few = match point.config.representation() {
                Representation::Planes => 2..101,
                _ if name == "smoke" => 2..3,
                // Steps are varied there, and a short point has its last evaluation alone.
                _ if name.starts_with("scenes") => 0..101,
                _ => 10..101,
            };
            // Their steps are those of a machine that has the scene.
            let unknown =
                point.no_data.is_some() && point.places.iter().all(|place| place.row.ends_with("equal seconds"));
            if unknown {
                continue;
            }
            let between = (train.steps - 1).checked_div(train.eval_every).unwrap_or(0);
            assert!(few.contains(&between) && eval.train_views != Some(0), "{name}, {}: {between}", point.label());
        }
        sweeps += 1;
    }
    assert!(sweeps > 15);
}

/// Evaluations and seconds may agree to the step, and both are unknown where the scene is not at hand: no mistake in the file.
#[test]
fn budgets_of_two_kinds_may_come_to_the_same_steps() {
    let equal = |name: &str, kind: &str| {
        format!("[[row]]\nname = \"{name}\"\nbudget = {{ kind = \"{kind}\", like = \"Aug-NeRF\" }}\n")
    };
    let both = equal("evaluations", "evaluations") + &equal("seconds", "seconds");
    let points = points_of(&format!("{BASE}{both}")).unwrap();
    assert_eq!(points.iter().filter(|point| point.places.len() == 2).count(), 2, "a step of Costs takes 4 to 1");
    let absent = BASE.replace("[\"builtin\"]", "[\"nerf_llff_data/nowhere\"]").replace("\"smoke\"", "\"cpu\"");
    let points = points_of(&format!("{absent}{both}")).unwrap();
    assert!(points.iter().any(|point| point.without_budget && point.places.len() == 2));
    let twice = equal("evaluations", "evaluations") + &equal("again", "evaluations");
    assert!(points_of(&format!("{BASE}{twice}")).unwrap_err().to_string().contains("the same configuration"));
}

/// The points of a table in `results` do not hang on the clock of the day on which it is made again.
#[test]
fn seconds_beside_the_tables_are_used_again() {
    let definition = parse(&format!("{BASE}budget = {{ kind = \"seconds\", like = \"NeRF\" }}\n")).unwrap();
    let dir = TempDir::new().unwrap();
    let [first, results, second] = ["first", "results", "second"].map(|name| dir.path().join(name));
    std::fs::create_dir(&results).unwrap();
    let start = |folder: &Path, costs: &dyn StepCosts| {
        let costs = PublishedCosts::beside(&results, costs)?;
        let points = begin(&SweepFolder::new(folder), &definition, None, false, &costs, &|_, _| Ok(()))?;
        Ok::<_, Error>(points.into_iter().map(|point| point.id).collect::<Vec<_>>())
    };
    let slower = Slower::default();
    let published = start(&first, &slower).unwrap();
    std::fs::copy(first.join("step_seconds.json"), results.join("step_seconds.json")).unwrap();
    assert_eq!(start(&second, &slower).unwrap(), published);
    assert_eq!(slower.0.load(Ordering::SeqCst), 2, "nothing is measured again");
    assert!(second.join("step_seconds.json").is_file());
    for wrong in ["{\"seconds\": {\"1da64b355f14\": 0}}", "{\"seconds\": {\"1da64b355f14\": -1.5}}", "[1]", "{"] {
        std::fs::write(results.join("step_seconds.json"), wrong).unwrap();
        let refused = start(&dir.path().join("third"), &slower).unwrap_err().to_string();
        assert!(refused.contains("step_seconds.json") && refused.contains("delete it"), "{wrong}: {refused}");
    }
}

#[test]
fn an_axis_sets_what_all_its_points_share() {
    let axis = "[[axis]]\nname = \"step size\"\nkeys = [\"perturb.feature.step_size\"]\nset = { \"perturb.feature.epsilon\" = \"reach\", perturb = { \
                lambda = 0.5 } }\nvalues = [1e-3, 1e-2]\n";
    let points = points_of(&format!("{BASE}{axis}")).unwrap();
    let augmented: Vec<&Point> = points.iter().filter(|point| point.config.method.is_augmented()).collect();
    assert_eq!(augmented.len(), 4);
    for point in augmented {
        let perturb = &point.config.perturb;
        assert_eq!((perturb.sites[PaperSite::Feature].epsilon, perturb.lambda), (Some(Epsilon::Reach), 0.5));
        assert!(perturb.sites[PaperSite::Feature].step_size.is_some());
    }
    let unknown = points_of(&format!("{BASE}{}", axis.replace("lambda", "lamda"))).unwrap_err().to_string();
    assert!(unknown.contains("lamda"), "{unknown}");
    let definition = parse(&format!("{BASE}{axis}")).unwrap();
    assert_eq!(parse(&definition.to_toml()).unwrap(), definition);
}
