//! Sweeps without training: definitions, expansion, order, claims, failures. A fake trainer takes
//! microseconds.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::common::{assert_says, needs};
use augnerf::base::{Error, Event, Listener, Result};
use augnerf::perturb::{Epsilon, PaperSite};
use augnerf::report::{PointResult, Status, TableSpec};
use augnerf::runtime::Runtime;
use augnerf::settings::{Config, Regularizer, SecondPass, parse_assignment};
use augnerf::sweep::{
    Change, Claim, Definition, Failure, Options, Overrides, Point, PointFolder, Progress, Runner, Sharing, StepSeconds,
    SweepFolder, Unmeasured, Work, begin, evaluations_per_step, expand,
};
use tempfile::TempDir;

pub const BASE: &str = r#"
title = "a test"
preset = "smoke"
scenes = ["builtin"]
seeds = [0, 1]
baseline = "NeRF"

[[row]]
name = "NeRF"

[[row]]
name = "Aug-NeRF"
set = { method = "aug-nerf", "perturb.t.steps" = 3 }
"#;

/// A step of a width-64 network takes a second, one with a perturbed pass four.
pub fn costs(configs: &[&Config]) -> Result<StepSeconds> {
    let seconds = |config: &Config| if config.method.name() == "nerf" { 1.0 } else { 4.0 };
    Ok(configs.iter().map(|config| (*config, seconds(config))).collect())
}

pub fn parse(text: &str) -> Result<Definition> {
    Definition::parse(text, "test.toml")
}

pub fn points_of(text: &str) -> Result<Vec<Point>> {
    expand(&parse(text)?, None, &costs)
}

fn labels(points: &[Point]) -> Vec<String> {
    points.iter().map(Point::label).collect()
}

/// Counts how often each point was trained; fails where it is told to.
#[derive(Default)]
pub struct Fake {
    trained: Mutex<BTreeMap<String, usize>>,
    fails: Vec<&'static str>,
    panics: Vec<&'static str>,
    /// Sets the stop flag when so many points were begun.
    stop_at: Option<usize>,
    milliseconds: u64,
    /// The step of the checkpoint that it goes on from.
    first: u32,
    /// What the first training ends with.
    ends: Option<fn() -> Error>,
}

impl Fake {
    pub fn count(&self) -> usize {
        self.trained.lock().unwrap().values().sum()
    }
}

impl Work for Fake {
    fn run(
        &self,
        point: &Point,
        _: &PointFolder,
        _: &Runtime,
        progress: &Progress,
        stop: &AtomicUsize,
    ) -> Result<PointResult> {
        let label = point.label();
        *self.trained.lock().unwrap().entry(label.clone()).or_default() += 1;
        if let Some(error) = self.ends.filter(|_| self.count() == 1) {
            return Err(error());
        }
        progress.begin(self.first.into(), 10);
        std::thread::sleep(std::time::Duration::from_millis(self.milliseconds));
        if self.stop_at == Some(self.count()) {
            stop.store(15, Ordering::SeqCst);
            return Err(Error::Interrupted { signal: 15, message: "stopped".into() });
        }
        if self.fails.contains(&label.as_str()) {
            return Err(Error::Diverged("the loss is not a number\nsecond line".into()));
        }
        assert!(!self.panics.contains(&label.as_str()), "a defect");
        let psnr = 20.0 + point.config.seed as f64;
        Ok(PointResult { metrics: vec![("psnr".into(), Some(psnr))], ..PointResult::default() })
    }
}

pub const OPTIONS: Options =
    Options { jobs: 1, fail_fast: false, retry_failed: false, remeasure: Vec::new(), sharing: Sharing::Locks };

/// Begins a sweep in a folder of its own.
pub fn sweep(text: &str) -> (TempDir, SweepFolder, Vec<Point>) {
    let dir = TempDir::new().unwrap();
    let folder = SweepFolder::new(&dir.path().join("sweep"));
    let points = begun(&folder, &parse(text).unwrap(), false).unwrap();
    (dir, folder, points)
}

/// Begins it, or goes on with it, without data.
pub fn begun(folder: &SweepFolder, definition: &Definition, extend: bool) -> Result<Vec<Point>> {
    begin(folder, definition, None, extend, &costs, &|_, _| Ok(()))
}

pub fn run(folder: &SweepFolder, points: &[Point], work: &dyn Work, options: Options) -> Result<Vec<Unmeasured>> {
    run_heard(folder, points, work, options, (&(), &AtomicUsize::new(0)))
}

/// The same with somebody who hears of it and may stop it.
pub fn run_heard(
    folder: &SweepFolder,
    points: &[Point],
    work: &dyn Work,
    options: Options,
    (events, stop): (&dyn Listener, &AtomicUsize),
) -> Result<Vec<Unmeasured>> {
    let runtime = &Runtime::new("cpu", Some(2)).unwrap();
    Runner { folder, points, runtime, work, options, events, stop }.run()
}

pub fn statuses(folder: &SweepFolder, points: &[Point]) -> Vec<Status> {
    points.iter().map(|point| folder.point(&point.id).record(point).unwrap().status).collect()
}

#[test]
fn points_come_seed_by_seed_in_the_order_of_rows() {
    let points = points_of(BASE).unwrap();
    assert_eq!(
        labels(&points),
        [
            "NeRF · builtin · seed 0",
            "Aug-NeRF · builtin · seed 0",
            "NeRF · builtin · seed 1",
            "Aug-NeRF · builtin · seed 1"
        ]
    );
    assert!(points.iter().all(|point| point.id == point.config.hash() && point.no_data.is_none()));
}

#[test]
fn axes_combine_as_a_product_or_one_at_a_time_and_equal_points_are_one() {
    let axes = r#"
[[axis]]
name = "steps"
keys = ["perturb.t.steps", "perturb.xyz.steps"]
values = [1, 3]

[[axis]]
name = "layer"
panel = "features"
keys = ["perturb.injection_layer"]
values = [1, 2, 3]
"#;
    let product = points_of(&format!("{BASE}{axes}")).unwrap();
    // Steps and layer change nothing in a NeRF: all its six places are one point.
    assert_eq!(product.len(), 2 * (1 + 6));
    assert_eq!(product[0].places.len(), 6);
    assert!(labels(&product).contains(&"Aug-NeRF, steps = 1, features layer = 3 · builtin · seed 0".to_string()));
    let config = &product[1].config.perturb;
    let steps = [PaperSite::T, PaperSite::Xyz].map(|site| config[site].steps);
    assert_eq!((steps, config.injection_layer), ([Some(1); 2], 1));
    let single = points_of(&format!("combine = \"one-at-a-time\"\n{BASE}{axes}")).unwrap();
    assert_eq!(single.len(), 2 * (1 + 5));
    let plain = BASE.replace("name = \"NeRF\"", "name = \"NeRF\"\naxes = false");
    assert!(points_of(&format!("{plain}{axes}")).unwrap()[0].places[0].axes.is_empty());
}

/// A seed holds out the same views in every row and in any selection of seeds, others than the next seed's; and a table may hold
/// seeds of several splits because the definition says so.
#[test]
fn settings_by_seed_go_with_the_seed_under_rows() {
    let text = BASE
        .replace("[\"builtin\"]", "[\"builtin-forward\"]")
        .replace("[0, 1]", "[10, 11, 13]\nby_seed = { \"data.holdout_offset\" = [0, 3, 6], \"train.steps\" = [20] }")
        .replace("set = { method", "set = { \"train.steps\" = 30, method");
    let points = points_of(&text).unwrap();
    let of = |seed| points.iter().filter(move |point| point.config.seed == seed);
    let offsets = |seed| of(seed).map(|point| point.config.data.holdout_offset).collect::<Vec<_>>();
    assert_eq!([offsets(10), offsets(11), offsets(13)], [vec![3; 2], vec![6; 2], vec![3; 2]]);
    assert!(of(10).map(|point| point.config.train.steps).eq([20, 30]));
    let definition = parse(&text).unwrap();
    assert_eq!(parse(&definition.to_toml()).unwrap(), definition);
    let TableSpec { must_match, by_seed, .. } = definition.table("t", &points);
    assert!([must_match, by_seed].iter().all(|columns| columns.iter().any(|column| column == "split")));
    assert!(parse(BASE).unwrap().table("t", &points_of(BASE).unwrap()).by_seed.is_empty());
    let offsets = expand(&with_settings(&definition, &["data.holdout_offset=1"]), None, &costs).unwrap();
    assert!(offsets.iter().all(|point| point.config.data.holdout_offset == 1), "the command line's setting");
    refused(&text.replace("[20]", "[]"), &["by_seed.\"train.steps\""]);
    refused(&text.replace("data.holdout_offset", "data.hold"), &["data.hold"]);
}

/// A definition with settings of the command line.
fn with_settings(definition: &Definition, settings: &[&str]) -> Definition {
    let mut other = definition.clone();
    let set = settings.iter().map(|text| parse_assignment(text).unwrap()).collect();
    other.apply(Overrides { set, ..Overrides::default() }).unwrap();
    other
}

/// Demands that a definition is refused with words.
#[track_caller]
fn refused(text: &str, words: &[&str]) {
    let error = points_of(text).expect_err(text);
    assert_eq!(error.exit_code(), 2, "{error}");
    assert_says(&error.to_string(), words);
}

/// A scene has its own settings in every row, and a row still overrides them.
#[test]
fn settings_by_scene_go_with_the_scene_under_rows() {
    let text = BASE
        .replace("[\"builtin\"]", "[\"builtin\", \"builtin:3\"]")
        .replace("[0, 1]", "[0]\nby_scene = { \"builtin:3\" = { train = { rays = 64 }, \"train.steps\" = 20 } }")
        .replace("set = { method", "set = { \"train.steps\" = 30, method");
    let definition = parse(&text).unwrap();
    assert_eq!(parse(&definition.to_toml()).unwrap(), definition);
    let of = |definition: &Definition| -> Vec<(String, u64, usize)> {
        let points = expand(definition, None, &costs).unwrap();
        points.into_iter().map(|point| (point.scene, point.config.train.steps, point.config.train.rays)).collect()
    };
    let plain = parse(BASE).unwrap();
    let (_, steps, rays) = of(&plain)[0];
    let [a, b, c, d] = &of(&definition)[..] else { panic!("four points") };
    assert_eq!([(a.1, a.2), (b.1, b.2)], [(steps, rays), (30, rays)]);
    assert_eq!([(c.1, c.2), (d.1, d.2)], [(20, 64), (30, 64)]);
    // The command line's setting is that of all scenes.
    let mut other = with_settings(&definition, &["train.rays=32", "train.steps=10"]);
    assert!(of(&other).iter().all(|(_, _, rays)| *rays == 32), "{other:?}");
    assert_eq!(of(&other)[2].1, 10);
    // Scenes that the command line leaves out take their settings with them.
    other.apply(Overrides { scenes: Some(vec!["builtin".into()]), ..Overrides::default() }).unwrap();
    assert!(other.by_scene.is_empty());
    let of_ship = text.replace("{ \"builtin:3\" =", "{ ship =");
    refused(&of_ship, &["by_scene.\"ship\"", "the scenes are builtin, builtin:3"]);
    refused(&text.replace("train = { rays", "train = { rais"), &["by_scene", "train.rais"]);
    let twice = text.replace("= 20 } }", "= 20 }, \"builtin-3\" = { \"train.rays\" = 8 } }");
    refused(&twice, &["settings of scene 'builtin:3' under two names"]);
}

#[test]
fn wrong_definitions_are_refused_with_words() {
    let values = |count: usize| (1..=count).map(|i| format!("{i},")).collect::<String>();
    let replace = |from: &str, to: &str| BASE.replace(from, to);
    let axis =
        |keys: &str, values: &str| format!("{BASE}[[axis]]\nname = \"a\"\nkeys = [{keys}]\nvalues = [{values}]\n");
    let cases: Vec<(String, Vec<&str>)> = vec![
        (replace("\"perturb.t.steps\" = 3", "\"perturb.t.epsilon\" = 0.9"), vec!["Aug-NeRF", "0.9", "0.5"]),
        (replace("name = \"Aug-NeRF\"", "name = \"NeRF\""), vec!["rows", "NeRF", "twice"]),
        (replace("name = \"Aug-NeRF\"", "name = \" \""), vec!["name"]),
        (
            replace("set = { method = \"aug-nerf\", \"perturb.t.steps\" = 3 }", ""),
            vec!["NeRF", "Aug-NeRF", "same configuration"],
        ),
        (replace("seeds = [0, 1]", "seeds = []"), vec!["seeds", "empty"]),
        (replace("seeds = [0, 1]", "seeds = [1, 1]"), vec!["seeds", "1", "twice"]),
        (replace("scenes = [\"builtin\"]", "scenes = []"), vec!["scenes", "empty"]),
        (replace("scenes = [\"builtin\"]", "scenes = [\"a/fern\", \"b/fern\"]"), vec!["scenes", "fern", "twice"]),
        (replace("preset = \"smoke\"", "preset = \"smok\""), vec!["smok", "choose one of"]),
        (replace("baseline = \"NeRF\"", "baseline = \"NERF\""), vec!["baseline", "NERF", "Aug-NeRF"]),
        (format!("metrics = [\"pnsr\"]\n{BASE}"), vec!["metric", "pnsr", "psnr"]),
        (axis("\"train.rays\"", ""), vec!["axis 'a'", "empty"]),
        (axis("\"train.rays\"", "8, 8"), vec!["axis 'a'", "8", "twice"]),
        (replace("seeds = [0, 1]", "seeds = [9223372036854775807, 9223372036854775808]"), vec!["seed"]),
        (format!("published = \"tab9\"\n{BASE}"), vec!["no row 'NeRF' in tab9", "clean", "add `ours = true`"]),
        (
            format!("published = \"tab1\"\n{BASE}\n[[row]]\nname = \"LLFF\"\nset = {{ method = \"llff\" }}\n"),
            vec!["'LLFF'", "was trained on others", "ours = true"],
        ),
        (
            axis("\"train.rays\"", "8, 16") + "[[row]]\nname = \"Twin\"\n",
            vec!["'NeRF'", "'Twin'", "same configuration"],
        ),
        (axis("", "8"), vec!["axis 'a'", "keys"]),
        (
            replace("\"perturb.t.steps\"", "\"trian.steps\""),
            vec!["cannot run: Aug-NeRF (builtin): its set: trian.steps: unknown key"],
        ),
        (
            axis("\"train.rays\"", &values(999)).replace("seeds = [0, 1]", "seeds = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]"),
            vec!["19980 points", "10000"],
        ),
    ];
    cases.iter().for_each(|(text, words)| refused(text, words));
}

#[test]
fn failures_and_panics_cost_their_own_point_and_are_retried_when_asked() {
    let (_dir, folder, points) = sweep(BASE);
    let (fails, panics) = (vec!["Aug-NeRF · builtin · seed 0"], vec!["NeRF · builtin · seed 1"]);
    run(&folder, &points, &Fake { fails, panics, ..Fake::default() }, OPTIONS).unwrap();
    assert_eq!(statuses(&folder, &points), [Status::Done, Status::Failed, Status::Failed, Status::Done]);
    let records = folder.records(&parse(BASE).unwrap(), &points).unwrap();
    assert_eq!((records[0].row.as_str(), records[0].metric("psnr")), ("NeRF", Some(20.0)));
    assert_eq!(records[2].reason, "the loss is not a number");
    assert!(records[1].reason.contains("a defect"), "{}", records[1].reason);
    assert!(records[2].result.metrics.is_empty());
    // Not by themselves.
    run(&folder, &points, &Fake::default(), OPTIONS).unwrap();
    assert_eq!(statuses(&folder, &points)[1], Status::Failed);
    let second = Fake::default();
    run(&folder, &points, &second, Options { retry_failed: true, ..OPTIONS }).unwrap();
    assert_eq!((second.count(), statuses(&folder, &points)), (2, vec![Status::Done; 4]));
}

/// What is forgiven is what had failed when the runner came: it neither tries its own failures for ever nor takes
/// back another's.
#[test]
fn a_failure_is_retried_once_a_runner_and_under_its_claim() {
    let (_dir, folder, points) = sweep(BASE);
    let broken = || Fake { fails: vec!["NeRF · builtin · seed 0"], ..Fake::default() };
    run(&folder, &points, &broken(), OPTIONS).unwrap();
    let retry = || Options { retry_failed: true, ..OPTIONS };
    let second = broken();
    run(&folder, &points, &second, retry()).unwrap();
    assert_eq!((second.count(), statuses(&folder, &points)[0]), (1, Status::Failed));
    let both = [broken(), broken()];
    std::thread::scope(|scope| {
        for fake in &both {
            scope.spawn(|| run(&folder, &points, fake, retry()).unwrap());
        }
    });
    assert!((1..=2).contains(&(both[0].count() + both[1].count())));
    assert_eq!(statuses(&folder, &points)[0], Status::Failed);
}

/// An evaluation begins with its first view again: turns that are too short for it lead nowhere.
#[test]
fn turns_that_are_too_short_for_an_evaluation_fail_the_point_at_last() {
    let (_dir, folder, points) = sweep(BASE);
    let one = &points[..1];
    let turn = |first: u32, sharing: Sharing| {
        run(&folder, one, &Fake { stop_at: Some(1), first, ..Fake::default() }, Options { sharing, ..OPTIONS })
    };
    // One that trained got further, and a person may stop as often as they like.
    let waits = [(9, Sharing::Scheduler), (10, Sharing::Locks), (10, Sharing::Scheduler)];
    let waits = waits.into_iter().flat_map(|(first, sharing)| [(first, sharing, Status::Waiting); 4]);
    for (first, sharing, status) in waits.chain([(10, Sharing::Scheduler, Status::Failed)]) {
        assert!(matches!(turn(first, sharing), Err(Error::Interrupted { .. })), "{first} {sharing:?}");
        assert_eq!(statuses(&folder, one), [status], "{first} {sharing:?}");
    }
    let failure = folder.point(&one[0].id).failure().unwrap().unwrap();
    assert!(failure.reason.contains("5 turns were stopped before its evaluation was"), "{}", failure.reason);
    // Tried again it has as many turns as before.
    run(&folder, one, &Fake::default(), Options { retry_failed: true, ..OPTIONS }).unwrap();
    assert_eq!(statuses(&folder, one), [Status::Done]);
    assert!(!folder.point(&one[0].id).path().join("stops.json").exists());
}

#[test]
fn a_full_disk_stops_the_sweep_and_fails_no_point() {
    let (_dir, folder, points) = sweep(BASE);
    let fake = Fake { ends: Some(|| Error::Output("no space left".into())), ..Fake::default() };
    assert_eq!(run(&folder, &points, &fake, OPTIONS).unwrap_err().exit_code(), 4);
    assert_eq!(statuses(&folder, &points), [Status::Waiting; 4]);
}

/// Keeps the numbers of `[3/14]` that are said where a point begins.
#[derive(Default)]
struct Counters(Mutex<Vec<(usize, usize)>>);

impl Listener for Counters {
    fn on(&self, event: Event<'_>) {
        if let Event::PointStarted { ended, points, .. } = event {
            self.0.lock().unwrap().push((ended + 1, points));
        }
    }
}

/// Its result stays, so nothing in the folder says that it failed: the runner returns it, and the next one tries again.
#[test]
fn a_point_that_cannot_be_measured_again_stays_done_and_is_returned() {
    let (_dir, folder, points) = sweep(BASE);
    run(&folder, &points, &Fake::default(), OPTIONS).unwrap();
    let lacking = PointResult { metrics: vec![("psnr".into(), None)], ..PointResult::default() };
    for index in [0, 2] {
        folder.point(&points[index].id).finish(&lacking).unwrap();
    }
    let again = |fails: Vec<&'static str>| {
        let (fake, counters) = (Fake { fails, ..Fake::default() }, Counters::default());
        let options = Options { remeasure: vec!["psnr".into()], ..OPTIONS };
        let unmeasured = run_heard(&folder, &points, &fake, options, (&counters, &AtomicUsize::new(0))).unwrap();
        assert_eq!(statuses(&folder, &points), [Status::Done; 4]);
        let unmeasured: Vec<(String, u8)> =
            unmeasured.into_iter().map(|point| (point.label, point.failure.exit_code)).collect();
        (fake.count(), unmeasured, counters.0.into_inner().unwrap())
    };
    let broken = "NeRF · builtin · seed 0";
    let failed = vec![(broken.to_string(), 6)];
    assert_eq!(again(vec![broken]), (2, failed.clone(), vec![(3, 4), (4, 4)]));
    let own = folder.point(&points[0].id);
    assert_eq!((own.result().unwrap(), own.failure().unwrap()), (Some(lacking), None));
    assert_eq!(again(vec![broken]), (1, failed, vec![(4, 4)]), "once a runner");
    assert_eq!(again(Vec::new()), (1, Vec::new(), vec![(4, 4)]));
    assert_eq!(again(Vec::new()), (0, Vec::new(), Vec::new()));
}

/// Older versions marked a finished point as failed if it could not be measured again.
#[test]
fn the_run_of_a_finished_point_is_never_deleted() {
    let (_dir, folder, points) = sweep(BASE);
    run(&folder, &points, &Fake::default(), OPTIONS).unwrap();
    let own = folder.point(&points[0].id);
    let checkpoint = own.run().join("checkpoint");
    std::fs::create_dir(own.run()).unwrap();
    std::fs::write(&checkpoint, "hours").unwrap();
    let failure = Failure { reason: "the checkpoint is damaged".into(), exit_code: 5 };
    own.fail(&failure).unwrap();
    own.finish(&PointResult::default()).unwrap();
    let retry = |remeasure: Vec<String>| {
        let fake = Fake::default();
        run(&folder, &points, &fake, Options { retry_failed: true, remeasure, ..OPTIONS }).unwrap();
        assert!(checkpoint.exists() && statuses(&folder, &points) == [Status::Done; 4]);
        fake.count()
    };
    assert_eq!(retry(Vec::new()), 0, "the point is done");
    assert_eq!(retry(vec!["psnr".into()]), 1);
    assert_eq!(own.failure().unwrap(), None);
    // Without a result the checkpoint is what failed.
    std::fs::remove_file(own.path().join("result.json")).unwrap();
    own.fail(&failure).unwrap();
    run(&folder, &points, &Fake::default(), Options { retry_failed: true, ..OPTIONS }).unwrap();
    assert!(!checkpoint.exists());
}

/// A command such as `augnerf eval` may take a run after the runner looked at it.
#[test]
fn a_run_that_is_taken_at_the_last_moment_stops_no_sweep() {
    let taken = || Fake { ends: Some(|| Error::InUse("run is in use by process 4711".into())), ..Fake::default() };
    let (_dir, folder, points) = sweep(BASE);
    // A task of a scheduler has one point, which is left for the next task.
    let task = Options { sharing: Sharing::Scheduler, ..OPTIONS };
    let error = run(&folder, &points[..1], &taken(), task).unwrap_err();
    assert!(matches!(&error, Error::InUse(text) if text.contains("process 4711")), "{error}");
    assert_eq!(statuses(&folder, &points), [Status::Waiting; 4]);
    let fake = taken();
    run(&folder, &points, &fake, OPTIONS).unwrap();
    assert_eq!((fake.count(), statuses(&folder, &points)), (1 + 4, vec![Status::Done; 4]));
}

#[test]
fn fail_fast_leaves_the_rest_waiting() {
    let (_dir, folder, points) = sweep(BASE);
    let fake = Fake { fails: vec!["NeRF · builtin · seed 0"], ..Fake::default() };
    run(&folder, &points, &fake, Options { fail_fast: true, ..OPTIONS }).unwrap();
    assert_eq!(statuses(&folder, &points), [Status::Failed, Status::Waiting, Status::Waiting, Status::Waiting]);
}

#[test]
fn a_stop_leaves_the_rest_for_the_next_run() {
    let (_dir, folder, points) = sweep(BASE);
    let error = run(&folder, &points, &Fake { stop_at: Some(3), ..Fake::default() }, OPTIONS).unwrap_err();
    assert_eq!(error.exit_code(), 143);
    assert_eq!(statuses(&folder, &points), [Status::Done, Status::Done, Status::Waiting, Status::Waiting]);
    let second = Fake::default();
    run(&folder, &points, &second, OPTIONS).unwrap();
    assert_eq!(second.count(), 2);
}

#[test]
fn runners_and_jobs_share_the_points() {
    let text = BASE.replace("[0, 1]", "[0, 1, 2, 3, 4, 5, 6, 7, 8, 9]");
    let (_dir, folder, points) = sweep(&text);
    let fake = Fake { milliseconds: 5, ..Fake::default() };
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| run(&folder, &points, &fake, Options { jobs: 2, ..OPTIONS }).unwrap());
        }
    });
    assert!(fake.trained.lock().unwrap().values().all(|&times| times == 1), "{:?}", fake.trained);
    assert_eq!(statuses(&folder, &points), [Status::Done; 20]);
}

#[test]
fn a_claim_is_seen_and_the_point_of_a_killed_worker_is_free_at_once() {
    let (_dir, folder, points) = sweep(BASE);
    let point = folder.point(&points[0].id);
    point.begin(&points[0]).unwrap();
    let take = || Claim::take(point.path(), Sharing::Locks).unwrap();
    let claim = take().unwrap();
    claim.progress.begin(7, 10);
    assert!(take().is_none());
    assert_eq!(statuses(&folder, &points)[0], Status::Running);
    let seen = Claim::look(point.path()).unwrap();
    assert!(seen.alive && seen.pid == std::process::id() && (seen.step, seen.steps) == (7, 10));
    let note = std::fs::read(point.path().join("claim.json")).unwrap();
    drop(claim);
    assert!(Claim::look(point.path()).is_none());
    // A kill: the lock goes, the note stays.
    std::fs::write(point.path().join("claim.json"), &note).unwrap();
    let fate = Claim::look(point.path()).unwrap().fate();
    assert_says(&fate, &[&format!("process {}", std::process::id()), "was killed at step 7"]);
    let fake = Fake::default();
    run(&folder, &points[..1], &fake, OPTIONS).unwrap();
    assert_eq!((fake.count(), statuses(&folder, &points)[0]), (1, Status::Done));
}

/// Files from before `perturb.levels` name every site that is off.
#[test]
fn a_definition_in_other_words_goes_on_with_its_points() {
    let row = |set: &str| format!("{BASE}[[row]]\nname = \"Input\"\nset = {{ method = \"aug-nerf\", {set} }}\n");
    let off: Vec<String> =
        ["feature", "rgb", "density"].map(|site| format!("\"perturb.{site}.passes\" = \"off\"")).into();
    let (_dir, folder, before) = sweep(&row(&off.join(", ")));
    let now = parse(&row("\"perturb.levels\" = [\"input\"]")).unwrap();
    let points = begun(&folder, &now, false).unwrap();
    assert_eq!(labels(&points), labels(&before));
    assert_eq!(folder.compare(&now).unwrap(), Change::None);
    let other = parse(&row("\"perturb.levels\" = [\"output\"]")).unwrap();
    assert!(begun(&folder, &other, false).unwrap_err().to_string().contains("--extend"));
    // What makes no other experiment is as the definition says it now.
    let mut seldom = now.clone();
    seldom.set.insert("train.eval_every".into(), 7.into());
    begun(&folder, &seldom, true).unwrap();
    let points = folder.points(None).unwrap().unwrap();
    assert_eq!(labels(&points), labels(&before));
    assert!(points.iter().all(|point| point.config.train.eval_every == 7));
    let mut renamed = now;
    renamed.title = "another question".into();
    let message = begun(&folder, &renamed, false).unwrap_err().to_string();
    assert!(message.contains("no point is new, so that --extend costs no training"), "{message}");
}

/// Counts measurements; each takes longer than the one before.
#[derive(Default)]
pub struct Slower(pub AtomicUsize);

impl Slower {
    pub fn measure(&self, configs: &[&Config]) -> Result<StepSeconds> {
        let seconds = || 1.5f64.powi(self.0.fetch_add(1, Ordering::SeqCst) as i32);
        Ok(configs.iter().map(|config| (*config, seconds())).collect())
    }
}

/// Clocks differ from one look to the next: the points of a sweep are decided once.
#[test]
fn points_are_fixed_when_a_sweep_begins() {
    let text = format!("{BASE}budget = {{ kind = \"seconds\", like = \"NeRF\" }}\n");
    let definition = parse(&text).unwrap();
    let dir = TempDir::new().unwrap();
    let folder = SweepFolder::new(dir.path());
    let slower = Slower::default();
    let measure = |configs: &[&Config]| slower.measure(configs);
    let ids = |points: Vec<Point>| points.into_iter().map(|point| point.id).collect::<Vec<_>>();
    let start = || ids(begin(&folder, &definition, None, false, &measure, &|_, _| Ok(())).unwrap());
    let (a, b) = std::thread::scope(|scope| {
        let (a, b) = (scope.spawn(start), scope.spawn(start));
        (a.join().unwrap(), b.join().unwrap())
    });
    assert_eq!(a, b);
    assert_eq!(slower.0.load(Ordering::SeqCst), 2, "one measurement for each of the two shapes");
    assert_eq!(start(), a);
    assert_eq!(ids(folder.points(None).unwrap().unwrap()), a);
}

/// Without its scene a row's budget is unknown: it is no other row's point, and gets its steps when the scene comes.
#[test]
#[ignore = "needs AUGNERF_DATA"]
fn a_budget_waits_for_its_scene() {
    let data = needs::data();
    let text = format!(
        "{}[[row]]\nname = \"NeRF, equal\"\nbudget = {{ kind = \"seconds\", like = \"Aug-NeRF\" }}\n",
        BASE.replace("[\"builtin\"]", "[\"nerf_llff_data/fern\"]").replace("\"smoke\"", "\"cpu\"")
    );
    let definition = parse(&text).unwrap();
    let dir = TempDir::new().unwrap();
    let folder = SweepFolder::new(dir.path());
    let nowhere = begin(&folder, &definition, Some(Path::new("/nowhere")), false, &costs, &|_, _| Ok(())).unwrap();
    assert_eq!(nowhere.len(), 6);
    assert!(nowhere.iter().all(|point| point.no_data.is_some()));
    assert_eq!(nowhere.iter().filter(|point| point.without_budget).count(), 2);
    let here = begin(&folder, &definition, Some(&data), false, &costs, &|_, _| Ok(())).unwrap();
    assert!(here.iter().all(|point| point.no_data.is_none() && !point.without_budget));
    assert_eq!(here[2].config.train.steps, 4 * here[0].config.train.steps);
    // Read back without the data: the same points.
    let back = folder.points(Some(Path::new("/nowhere"))).unwrap().unwrap();
    assert!(here.iter().zip(&back).all(|(a, b)| a.id == b.id));
}

#[test]
fn a_changed_configuration_of_a_point_is_noticed() {
    let (_dir, folder, points) = sweep(BASE);
    run(&folder, &points[..1], &Fake::default(), OPTIONS).unwrap();
    let config = folder.point(&points[0].id).path().join("config.toml");
    let text = std::fs::read_to_string(&config).unwrap();
    std::fs::write(&config, text.replace("seed = 0", "seed = 9")).unwrap();
    let error = run(&folder, &points, &Fake::default(), OPTIONS).unwrap_err();
    assert!(error.to_string().contains("was changed"), "{error}");
}

#[test]
fn budgets_give_cheap_rows_more_steps() {
    let text = |kind: &str| format!("{BASE}budget = {{ kind = \"{kind}\", like = \"NeRF\" }}\n");
    let points = points_of(&text("seconds")).unwrap();
    let nerf = points[0].config.train.steps;
    assert_eq!(points[1].config.train.steps, nerf / 4);
    // Evaluations are what is counted where nobody says otherwise.
    let points = points_of(&format!("{BASE}budget = {{ like = \"NeRF\" }}\n")).unwrap();
    // A clean pass 3, a perturbed pass 3, three search steps of 2 each.
    assert_eq!(points[1].config.train.steps, nerf / 4);
    let decay = |index: usize| points[index].config.train.decay_steps.unwrap() as f64;
    assert_eq!(decay(1) / decay(0), points[1].config.train.steps as f64 / nerf as f64, "the schedule is stretched too");
    let ratio = evaluations_per_step(&points[1].config) / evaluations_per_step(&points[0].config);
    assert_eq!(ratio, 4.0);
}

/// Of 48 samples that are placed and 32 that are trained, on a hash grid.
#[test]
fn passes_that_only_place_samples_cost_a_forward_pass() {
    let text = BASE.replace("\"smoke\"", "\"fast\"") + "budget = { kind = \"evaluations\", like = \"NeRF\" }\n";
    let points = points_of(&text).unwrap();
    let (nerf, augmented) = (&points[0].config, &points[1].config);
    assert_eq!((nerf.samples(), augmented.method.is_augmented()), ((48, 32), true));
    let evaluations = |config: &Config| evaluations_per_step(config) / config.train.rays as f64;
    assert_eq!(evaluations(nerf), f64::from(48 + 3 * 32));
    assert_eq!(evaluations(augmented), f64::from(48 + 3 * 32 + (3 + 3 * 2) * 32));
    let mut with_slopes = nerf.clone();
    with_slopes.regularizer.kind = vec![Regularizer::Orientation];
    assert_eq!(evaluations(&with_slopes), evaluations(nerf) + f64::from(4 * 32));
    assert_eq!(augmented.train.steps, nerf.train.steps / 3);
    let mut second = augmented.clone();
    second.perturb.second = SecondPass::FreshJitter;
    assert_eq!(evaluations(&second), 2.0 * evaluations(nerf));
    second.perturb.second = SecondPass::Uniform;
    assert_eq!(evaluations(&second), evaluations(nerf) + f64::from(3 * 32));
}

/// Every shipped sweep expands, whatever data are there.
#[test]
fn shipped_sweeps_are_valid() {
    expand_shipped_sweeps(None);
}

/// With the scenes, their sizes and kinds are checked, too.
#[test]
#[ignore = "needs AUGNERF_DATA"]
fn shipped_sweeps_are_valid_with_their_scenes() {
    expand_shipped_sweeps(Some(&needs::data()));
}

fn expand_shipped_sweeps(data: Option<&Path>) {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("sweeps");
    let mut found = 0;
    for path in crate::common::files::ending(&dir, ".toml") {
        let definition = Definition::read(&path).unwrap_or_else(|e| panic!("{e}"));
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        let points = expand(&definition, data, &costs);
        let points = points.unwrap_or_else(|e| panic!("{name}: {e}"));
        assert!(points.len() >= 2 * definition.seeds.len(), "{name}");
        found += 1;
    }
    assert_eq!(found, 56);
}

#[test]
fn a_file_extends_another() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).unwrap();
    let read = |name: &str| Definition::read(&dir.path().join(name));
    write("base.toml", BASE);
    write(
        "small.toml",
        "extends = \"base.toml\"\nseeds = [7]\n[set]\n\"train.steps\" = 3\n\
         [[row]]\nname = \"Aug-NeRF\"\nset = { \"perturb.lambda\" = 0.7 }\n[[row]]\nname = \"New\"\nset = { \"train.rays\" = 7 }\n",
    );
    let (base, small) = (read("base.toml").unwrap(), read("small.toml").unwrap());
    let names = |definition: &Definition| definition.row.iter().map(|row| row.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&small), [names(&base), vec!["New".into()]].concat());
    let row = |definition: &Definition| definition.row.iter().find(|row| row.name == "Aug-NeRF").unwrap().set.clone();
    write("fewer.toml", "extends = \"small.toml\"\n[[row]]\nname = \"New\"\nremove = true\n");
    assert_eq!(names(&read("fewer.toml").unwrap()), names(&base));
    assert_eq!(row(&small).len(), row(&base).len() + 1, "settings of the row are kept");
    assert_eq!(small.seeds, [7]);
    assert_eq!(small.preset, base.preset);
    assert_eq!(parse(&small.to_toml()).unwrap(), small, "what is kept with the points stands alone");
    for (text, words) in [
        (
            "extends = \"small.toml\"\n[[row]]\nname = \"Nwe\"\nremove = true\n",
            "[[row]] \"Nwe\": remove = true, but small.toml has no row",
        ),
        ("extends = \"nowhere.toml\"\n", "nowhere.toml"),
        ("extends = \"self.toml\"\n", "extend each other"),
        ("extends = 3\n", "in quotes"),
    ] {
        write("self.toml", text);
        assert_says(&read("self.toml").unwrap_err().to_string(), &[words]);
    }
}

#[test]
fn the_figure_has_the_paper_s_axes_around_one_best_point() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("sweeps/paper/fig_strength_location.toml");
    let mut definition = Definition::read(&path).unwrap();
    definition.seeds = vec![0];
    let points = expand(&definition, None, &costs).unwrap();
    // NeRF; 7 axes with 5, 5, 5, 5, 5, 5 and 8 values that share the best point, plus equal sizes within a fixed epsilon.
    let best = points.iter().max_by_key(|point| point.places.len()).unwrap();
    assert_eq!(best.places.len(), 7, "{:?}", best.places);
    // Three axes of five step sizes whose epsilon goes with them, and two controls.
    assert_eq!(points.len(), 1 + 6 * 4 + 7 + 1 + 3 * 5 + 2);
    let with_it = |point: &&Point| point.places[0].axes.iter().any(|value| value.axis == "step size, epsilon with it");
    for point in points.iter().filter(with_it) {
        let reaching = point.config.perturb.sites().filter(|(_, site)| site.epsilon == Some(Epsilon::Reach)).count();
        let sites = [("input coordinates", 3), ("features", 1), ("output", 2)];
        let of_panel = sites.iter().find(|(panel, _)| *panel == point.places[0].axes[0].panel).unwrap().1;
        assert_eq!(reaching, of_panel, "{}", point.label());
    }
}
