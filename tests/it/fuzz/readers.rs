//! The readers, each with the way that the program takes to a file: those of `tests/fixtures/sound`, some captures, a run's
//! folder, a sweep's and its results.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicUsize;

use augnerf::base::{Error, Result};
use augnerf::data::cameras;
use augnerf::data::{self, WorldToScene, images};
use augnerf::mesh::{read_mesh, sample};
use augnerf::methods::SiteSummary;
use augnerf::metrics::{Backbone, Lpips};
use augnerf::report::tables::{Table, points_csv};
use augnerf::run::{DepthErrors, Foreign, Matching, RunDir, Scalars, Truth, pictures, score};
use augnerf::settings::columns::column_of_setting;
use augnerf::settings::{Axes, Config, DataConfig, Method, build, parse_assignment};
use augnerf::sweep::verify::{Archive, Outcome, Verifier};
use augnerf::sweep::{Definition, StepSeconds, SweepFolder, SweepOutputs, Trainings, expand};
use augnerf::train::checkpoint;
use candle_core::{DType, Device};

use crate::common::files::{copy, entries, files, fixture, seal};
use crate::common::program::{Place, tiny_sweep};
use crate::common::{runtime, tiny_config, tiny_scene, trained};
use crate::sweep_run::costs;

/// A file that can be damaged, and how it is read.
pub struct Reader {
    pub file: PathBuf,
    pub read: Box<dyn Fn() -> Result<()>>,
}

/// The name of a folder of sound files, and how each of them is read.
type Kind = (&'static str, fn(&Path) -> Result<()>);

/// All readers, their files in folders below `folder`.
pub fn all(folder: &Path) -> Vec<Reader> {
    copy(&fixture("sound"), folder);
    fs::create_dir_all(folder.join("import")).unwrap();
    fs::write(folder.join("config/defaults.toml"), Config::default().to_toml()).unwrap();
    for name in ["nerf_pytorch.tar", "hostile/short_storage.tar", "hostile/missing_storage.tar"] {
        let from = fixture(name);
        fs::copy(&from, folder.join("import").join(from.file_name().unwrap())).unwrap();
    }
    for name in ["colmap_split", "masks_llff", "masks_dynamic"] {
        copy(&fixture("captures3").join(name), &folder.join("scenes").join(name));
    }
    let kinds: [Kind; 8] = [
        ("mesh", |file| sample(&read_mesh(file)?, 16, 0).map(drop)),
        ("picture", read_picture),
        ("cameras", |file| {
            cameras::read(file, &tiny_scene().train[0].camera, &WorldToScene::default(), Axes::Opengl).map(drop)
        }),
        ("import", read_foreign),
        ("weights", |file| Lpips::load(file.parent().unwrap(), Backbone::Squeeze, &Device::Cpu).map(drop)),
        ("config", |file| {
            // What is read can be written and hashed.
            let config = build(None, Some(file), &[])?;
            Config::from_toml(&config.to_toml(), "again").map(|again| drop(again.hash()))
        }),
        ("sweep", |file| {
            let definition = Definition::read(file)?;
            Definition::parse(&definition.to_toml(), "again")?;
            expand(&definition, None, &costs).map(drop)
        }),
        ("extended", |file| expand(&Definition::read(&file.with_file_name("above.toml"))?, None, &costs).map(drop)),
    ];
    let of_kind = |(kind, read): (&str, fn(&Path) -> Result<()>)| each(&folder.join(kind), move |file, _| read(file));
    let mut all: Vec<Reader> = kinds.into_iter().flat_map(of_kind).collect();
    all.push(reader(folder.join("assignments.txt"), |file| {
        let text = fs::read(file).unwrap();
        let one = |text: &str| build(None, None, &[parse_assignment(text)?]).map(drop);
        String::from_utf8_lossy(&text).lines().try_for_each(one)
    }));
    for scene in fs::read_dir(folder.join("scenes")).unwrap() {
        all.extend(each(&scene.unwrap().path(), |_, scene| read_scene(scene)));
    }
    all.extend(run(&folder.join("run")));
    all.extend(sweep(folder));
    all
}

fn reader(file: PathBuf, read: impl Fn(&Path) -> Result<()> + 'static) -> Reader {
    Reader { file: file.clone(), read: Box::new(move || read(&file)) }
}

/// Readers of each file below a folder, of the file and the folder: but of a folder's pictures those of the first view.
fn each(folder: &Path, read: impl Fn(&Path, &Path) -> Result<()> + Copy + 'static) -> Vec<Reader> {
    let is_other_view = |file: &Path| {
        let stem = file.file_stem().unwrap().to_str().unwrap();
        folder.parent().is_some_and(|above| above.ends_with("scenes"))
            && stem.ends_with(|digit: char| digit.is_ascii_digit())
            && !["0", "0_depth_0000", "0001"].contains(&stem)
    };
    let paths = files(folder, &[]).into_iter().map(|(place, _)| folder.join(place));
    let of_file = |file: PathBuf| {
        let folder = folder.to_path_buf();
        reader(file, move |file| read(file, &folder))
    };
    paths.filter(|file| !is_other_view(file)).map(of_file).collect()
}

fn read_scene(folder: &Path) -> Result<()> {
    let masks = match folder.file_name().unwrap().to_str().unwrap() {
        "masks_llff" => "masks",
        "masks_dynamic" => "beside",
        _ => "",
    };
    let spherify = ["around", "masks_llff"].iter().any(|name| folder.ends_with(name));
    let dir = folder.display().to_string();
    let mut config = DataConfig { dir, downscale: Some(1), spherify, ndc: !spherify, ..DataConfig::default() };
    if !masks.is_empty() {
        config.masks = masks.into();
    }
    config.kind = data::detect(&config)?;
    data::load(&config, 0, &()).map(drop)
}

/// A picture of a scene; a small one is also measured against itself, which takes the memory of two.
fn read_picture(file: &Path) -> Result<()> {
    let (width, height) = images::size(file)?;
    images::read(file, (width.min(5), height.min(5)))?;
    if width * height > 1 << 20 {
        return Ok(());
    }
    let folder = tempfile::tempdir_in(file.parent().unwrap().parent().unwrap()).unwrap();
    fs::copy(file, folder.path().join(file.file_name().unwrap())).unwrap();
    let truth = Truth::Pictures(pictures(folder.path(), "_truth")?);
    score(&pictures(folder.path(), "_rgb")?, &truth, Matching::Name, Some([1.0; 3]), &[], &()).map(drop)
}

/// Weights of another program, as far as to the settings that they ask for.
fn read_foreign(file: &Path) -> Result<()> {
    Foreign::open(file)?.settings().map(drop)
}

/// The files of a run's folder, with a checkpoint whose sums are those of its files.
fn run(folder: &Path) -> Vec<Reader> {
    let config = tiny_config(Method::Nerf, |_| {});
    trained(&config, 3).save(&folder.join("checkpoints")).unwrap();
    fs::write(folder.join("config.toml"), config.to_toml()).unwrap();
    let lock = folder.join("run.lock");
    fs::write(&lock, "4711").unwrap();
    let held = File::open(&lock).unwrap();
    held.lock().unwrap();
    let own = folder.to_path_buf();
    let mut readers = each(folder, read_run);
    readers.retain(|reader| reader.file != lock);
    readers.push(reader(lock, move |_| {
        let _held = &held;
        RunDir::take(&own).map(drop)
    }));
    readers
}

fn read_run(file: &Path, folder: &Path) -> Result<()> {
    let checkpoints = folder.join("checkpoints");
    if file.starts_with(&checkpoints) && !file.ends_with("SHA256SUMS") {
        seal(file.parent().unwrap());
    }
    let run = RunDir::open(folder)?;
    let config = run.read_config()?;
    run.read_timing()?;
    let scalars = folder.join("scalars.csv");
    SiteSummary::read(&scalars, 3)?;
    Scalars::resume(&scalars, &["loss", "gain.t", "inactive.t"], 3)?;
    DepthErrors::read(&folder.join("depth_errors.gz"))?;
    let (Some(newest), _) = checkpoint::newest_whole(&checkpoints)? else { return Ok(()) };
    checkpoint::check_config(&newest, &checkpoint::load_state(&newest)?, &config)?;
    checkpoint::load_model(&newest, &config, DType::F32, &Device::Cpu).map(drop)
}

/// Files of a sweep that is done, of one that is not, and of results: whatever is made of them.
fn sweep(folder: &Path) -> Vec<Reader> {
    let place = Place::new();
    let rows = [("Aug-NeRF", "method = \"aug-nerf\"")];
    place.write("small.toml", tiny_sweep(&[0], &["psnr"], "train.steps=2 eval.pictures=0", &rows));
    place.run("sweep run small.toml --quiet", 0);
    let [done, open, results] = ["done", "open", "results/small"].map(|name| folder.join(name));
    [&done, &open].into_iter().for_each(|sweep| copy(&place.at("runs/small"), sweep));
    copy(&place.at("results/small"), &results);
    for (point, name) in entries(&open.join("points")).iter().zip(["claim.json", "failed.json"]) {
        fs::remove_file(point.join("result.json")).unwrap();
        fs::copy(fixture("sound/point").join(name), point.join(name)).unwrap();
    }
    let seconds = folder.join("step_seconds.json");
    let config = tiny_config(Method::Nerf, |_| {});
    let shape = config.step_shape();
    fs::write(&seconds, format!("{{\"seconds\": {{\"{shape}\": 0.25, \"0123456789ab\": 1e-3}}}}\n")).unwrap();
    let readers = [each(&done, read_sweep), each(&open, read_sweep), each(&results, read_results)];
    let mut readers: Vec<Reader> = readers.into_iter().flatten().collect();
    readers.retain(|reader| is_read(&reader.file));
    readers.push(reader(seconds, move |file| {
        let published = StepSeconds::published(file.parent().unwrap(), &[&config])?;
        let seconds = published.and_then(|published| published.of(&config)).unwrap_or(1.0);
        assert!(seconds.is_finite() && seconds > 0.0, "a step of {seconds} s");
        Ok(())
    }));
    readers
}

/// Is it one of the files that others are made of?
fn is_read(file: &Path) -> bool {
    let of_sweep = "sweep.toml points.json config.toml result.json timing.json scalars.csv claim.json failed.json";
    let of_results = "points.csv timing.csv scalars.csv.gz provenance.toml";
    of_sweep.split(' ').chain(of_results.split(' ')).any(|name| file.ends_with(name))
}

fn read_sweep(_: &Path, path: &Path) -> Result<()> {
    let folder = SweepFolder::new(path);
    let definition = folder.definition()?;
    let points = folder.points(None)?.unwrap_or_default();
    points.iter().for_each(|point| drop(point.label()));
    points.iter().try_for_each(|point| folder.point(&point.id).begin(point))?;
    let records = folder.records(&definition, &points)?;
    Table::new(&definition.table("test", &points), &records, true)?;
    let outputs = SweepOutputs::of_folder(&folder, &definition, &points)?;
    outputs.scalars.values().for_each(|scalars| drop(scalars.pairs("step", "psnr")));
    drop(points_csv(&outputs.records, &[], &vec![], column_of_setting));
    Ok(())
}

/// Tables of results and, of one in sixteen, all that `augnerf verify` makes and compares. What it finds wrong is refused, and
/// fit for a terminal.
fn read_results(file: &Path, results: &Path) -> Result<()> {
    let archive = Archive::read(results, None)?;
    let sweep = &archive.sweep;
    Table::new(&sweep.definition.table(&sweep.name, &sweep.points), &sweep.outputs.records, true)?;
    if fs::read(file).unwrap().iter().fold(0, |sum: u8, byte| sum ^ byte) % 16 != 0 {
        return Ok(());
    }
    let trainings = Trainings::new(runtime().clone(), (Vec::new(), String::new()), true, &());
    let verifier = Verifier {
        data_root: None,
        trainings: &trainings,
        runtime: runtime(),
        update: false,
        all: false,
        retrain: 0,
        retrain_seed: 0,
        any_revision: false,
        stop: &AtomicUsize::new(0),
    };
    let mut lines = Vec::new();
    verifier.verify(results, &mut |_, findings| {
        lines.extend(findings.lines.clone());
        Ok(())
    })?;
    let stray = |text: &str| text.chars().any(|character| character.is_control() && !['\n', '\t'].contains(&character));
    for line in &lines {
        assert!(!stray(&line.text) && line.text.len() < 20_000, "no line for people: {:?}", line.text);
    }
    let wrong = lines.into_iter().find(|line| line.outcome == Outcome::Wrong);
    wrong.map_or(Ok(()), |line| Err(Error::Mismatch(line.text)))
}
