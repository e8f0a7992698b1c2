//! What shipped sweeps promise: controls, equal cost, and points that hang on no clock.

use std::path::Path;
use std::sync::atomic::Ordering;

use augnerf::base::Error;
use augnerf::perturb::{Epsilon, Geometry, PaperSite};
use augnerf::settings::{Config, Representation, SecondPass, Sizes};
use augnerf::sweep::{Definition, Point, StepSeconds, SweepFolder, begin, expand};
use tempfile::TempDir;

use crate::common::files::ending;
use crate::sweep_run::{BASE, Slower, costs, parse, points_of};

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

/// Sweeps that docs/sweeps.md says to lack a control: what describes beside a sweep that has them.
/// `NAME*` is all that begin so.
fn named_without_controls() -> Vec<String> {
    let page = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/sweeps.md")).unwrap();
    let (_, controls) = page.split_once("\nThese lack one or both:\n").expect("the page lists them");
    let listed = controls.trim_start().split("\n\n").next().expect("split gives one");
    listed.split('`').skip(1).step_by(2).map(String::from).collect()
}

/// What could explain an augmented row's result without an attack is trained beside it, in every shipped sweep but those that
/// the page names, which lack it indeed.
#[test]
fn every_shipped_sweep_with_an_augmented_row_has_its_controls() {
    let named = named_without_controls();
    let fits = |pattern: &String, name: &String| match pattern.strip_suffix('*') {
        Some(start) => name.starts_with(start),
        None => pattern == name,
    };
    let (mut augmented, mut lacking) = (0, Vec::new());
    for (name, definition) in shipped() {
        let points = expand(&definition, None, &costs).unwrap();
        let of_row = |row: &str| points.iter().find(|point| point.places.iter().any(|place| place.row == row)).unwrap();
        // Rows with a second pass, each with what it is compared with: settings of that pass and of the scene.
        let passes: Vec<(String, SecondPass, String, &Config)> = definition
            .row
            .iter()
            .filter_map(|row| {
                let config = &of_row(&row.name).config;
                let baseline = row.baseline.clone().or(definition.baseline.clone()).unwrap_or_default();
                let trained_on = format!("{:?}", config.data.corruption);
                config
                    .method
                    .is_augmented()
                    .then(|| (baseline + &trained_on, config.perturb.second, row.name.clone(), config))
            })
            .collect();
        for (group, second, row, config) in &passes {
            // A row beside no other, or beside the same method in another precision, says nothing of augmentation.
            let baseline = definition.row.iter().find(|other| other.name == *row).and_then(|row| row.baseline.clone());
            let baseline = baseline.or(definition.baseline.clone());
            if baseline.is_none_or(|baseline| of_row(&baseline).config.method == config.method) {
                continue;
            }
            // Levels and variants of the method by themselves have the whole method's controls.
            let whole = PaperSite::ALL.into_iter().all(|site| config.perturb[site].on());
            let is_whole = whole && !name.starts_with("variants");
            if *second != SecondPass::WorstCase || !is_whole {
                continue;
            }
            augmented += 1;
            let of_kind = |kind| passes.iter().filter(move |pass| pass.1 == kind && pass.0 == *group);
            let mut lack = |is_there: bool, what: &str| {
                if !is_there {
                    lacking.push((name.clone(), format!("{name}: no {what} '{row}'")));
                }
            };
            lack(of_kind(SecondPass::FreshJitter).count() > 0, "second clean pass beside");
            let same_sets = |other: &Config| {
                (other.method, other.perturb.sizes, other.perturb.geometry)
                    == (config.method, config.perturb.sizes, config.perturb.geometry)
            };
            // The study and the comparison over scenes ask of the calibrated attack alone whether it is the worst case that helps.
            let asks_of_one = name.starts_with("study_") || name == "scenes";
            let unasked = asks_of_one && config.perturb.sizes == Sizes::Paper;
            let uniform = of_kind(SecondPass::Uniform).filter(|pass| same_sets(pass.3)).count();
            lack(unasked || uniform > 0, "uniform draws in the sets of");
        }
        if name.starts_with("variants") {
            let kinds: Vec<SecondPass> = passes.iter().map(|pass| pass.1).collect();
            assert!(kinds.contains(&SecondPass::FreshJitter) && kinds.contains(&SecondPass::Uniform));
        }
        let corrupted = |point: &Point| point.config.data.corruption.is_on();
        assert!(
            named.iter().any(|pattern| fits(pattern, &name))
                || points.iter().all(|point| !corrupted(point))
                || points.iter().any(|point| !corrupted(point)),
            "{name}: nothing says what the corruption costs"
        );
    }
    assert!(augmented > 25, "{augmented}");
    let unnamed = lacking.iter().filter(|(name, _)| !named.iter().any(|pattern| fits(pattern, name)));
    assert_eq!(unnamed.map(|(_, why)| why.as_str()).collect::<Vec<_>>(), [""; 0], "and docs/sweeps.md does not say so");
    let unfounded = named.iter().filter(|pattern| !lacking.iter().any(|(name, _)| fits(pattern, name)));
    assert_eq!(unfounded.collect::<Vec<_>>(), Vec::<&String>::new(), "lack nothing, and docs/sweeps.md says so");
}

/// The paper's claim is a smaller gap between seen and unseen views: every table has it, and every curve held-out values on its
/// way, about twenty of them.
#[test]
fn every_shipped_sweep_tells_seen_from_unseen_views() {
    let mut sweeps = 0;
    for (name, definition) in shipped() {
        assert!(definition.metrics.iter().any(|metric| metric == "gap"), "{name}: no gap");
        for point in expand(&definition, None, &costs).unwrap() {
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

/// A row's name says whose sets uniform draws are taken from; but the study's have the geometry that each block chose.
#[test]
fn uniform_draws_are_named_by_their_sets() {
    let mut rows = 0;
    for (name, definition) in shipped() {
        if name.starts_with("study_") {
            continue;
        }
        for point in expand(&definition, None, &costs).unwrap() {
            let perturb = &point.config.perturb;
            let uniform = perturb.second == SecondPass::Uniform;
            if !point.config.method.is_augmented() || !uniform {
                continue;
            }
            for row in point.places.iter().map(|place| &place.row).filter(|row| row.contains("niform draws")) {
                rows += 1;
                assert_eq!(row.contains("calibrated"), perturb.sizes == Sizes::Calibrated, "{name}: {row}");
                assert_eq!(row.contains("paper's geometry"), perturb.geometry == Geometry::Paper, "{row}");
            }
        }
    }
    assert!(rows > 7, "{rows}");
}

/// The study's rivals differ in what their names say, and in nothing that each block chooses (results/study/PLAN.md).
#[test]
fn controls_of_the_study_have_the_sets_and_weight_of_its_attack() {
    let mut blocks = 0;
    for (name, definition) in shipped().into_iter().filter(|(name, _)| name.starts_with("study_")) {
        let points = expand(&definition, None, &costs).unwrap();
        let perturb = |row: &str| {
            let point = points.iter().find(|point| point.places.iter().any(|place| place.row == row));
            point.map(|point| point.config.perturb.clone())
        };
        let Some(uniform) = perturb("Uniform draws, calibrated") else { continue };
        let attack = perturb("Aug-NeRF calibrated").unwrap();
        let clean = perturb("NeRF + second clean pass").unwrap();
        assert_eq!(uniform.second, SecondPass::Uniform, "{name}");
        assert_eq!((uniform.sizes, uniform.geometry), (Sizes::Calibrated, attack.geometry), "{name}");
        assert_eq!((uniform.lambda, clean.lambda), (attack.lambda, attack.lambda), "{name}");
        assert_eq!(perturb("Aug-NeRF, paper's geometry").unwrap().geometry, Geometry::Paper, "{name}");
        blocks += 1;
    }
    assert_eq!(blocks, 5);
}

#[test]
fn equal_cost_is_four_steps_of_nerf_by_evaluations_where_nobody_says_otherwise() {
    let text = format!("{BASE}[[row]]\nname = \"NeRF, equal\"\nbudget = {{ like = \"Aug-NeRF\" }}\n");
    let points = points_of(&text).unwrap();
    let steps = |row: &str| points.iter().find(|point| point.places[0].row == row).unwrap().config.train.steps;
    assert_eq!(steps("NeRF, equal"), 4 * steps("Aug-NeRF"));
}

/// Evaluations and seconds may agree to the step, and both are unknown where the scene is not at hand: no mistake in the file.
#[test]
fn budgets_of_two_kinds_may_come_to_the_same_steps() {
    let equal = |name: &str, kind: &str| {
        format!("[[row]]\nname = \"{name}\"\nbudget = {{ kind = \"{kind}\", like = \"Aug-NeRF\" }}\n")
    };
    let both = equal("evaluations", "evaluations") + &equal("seconds", "seconds");
    let points = points_of(&format!("{BASE}{both}")).unwrap();
    assert_eq!(points.iter().filter(|point| point.places.len() == 2).count(), 2, "a step of costs takes 4 to 1");
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
    let start = |folder: &Path, slower: &Slower| {
        let measure = |configs: &[&Config]| match StepSeconds::published(&results, configs)? {
            Some(published) => Ok(published),
            None => slower.measure(configs),
        };
        let points = begin(&SweepFolder::new(folder), &definition, None, false, &measure, &|_, _| Ok(()))?;
        Ok::<_, Error>(points.into_iter().map(|point| point.id).collect::<Vec<_>>())
    };
    let slower = Slower::default();
    let published = start(&first, &slower).unwrap();
    std::fs::copy(first.join("step_seconds.json"), results.join("step_seconds.json")).unwrap();
    assert_eq!(start(&second, &slower).unwrap(), published);
    assert_eq!(slower.0.load(Ordering::SeqCst), 2, "nothing is measured again");
    assert!(second.join("step_seconds.json").is_file());
    // A file that lacks one of the shapes says nothing of this sweep: seconds of two clocks are not compared.
    let whole = std::fs::read_to_string(results.join("step_seconds.json")).unwrap();
    let mut file: serde_json::Value = serde_json::from_str(&whole).unwrap();
    let shapes = file["seconds"].as_object_mut().unwrap();
    let (missing, other) = (shapes.keys().next().unwrap().clone(), shapes.keys().nth(1).unwrap().clone());
    shapes.remove(&missing);
    shapes.insert(other.clone(), 1e6.into());
    std::fs::write(results.join("step_seconds.json"), file.to_string()).unwrap();
    let partial = dir.path().join("partial");
    start(&partial, &Slower::default()).unwrap();
    let kept: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(partial.join("step_seconds.json")).unwrap()).unwrap();
    assert!(kept["seconds"][&missing].is_f64() && kept["seconds"][&other].as_f64().unwrap() < 10.0, "{kept}");
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
        assert_eq!((perturb[PaperSite::Feature].epsilon, perturb.lambda), (Some(Epsilon::Reach), 0.5));
        assert!(perturb[PaperSite::Feature].step_size.is_some());
    }
    let unknown = points_of(&format!("{BASE}{}", axis.replace("lambda", "lamda"))).unwrap_err().to_string();
    assert!(unknown.contains("lamda"), "{unknown}");
    let definition = parse(&format!("{BASE}{axis}")).unwrap();
    assert_eq!(parse(&definition.to_toml()).unwrap(), definition);
}
