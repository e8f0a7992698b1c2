//! The readers of what was collected, of what single runs left, and of the small files beside them.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicUsize;

use augnerf::base::{Error, Result};
use augnerf::report::tables::Table;
use augnerf::run::{DepthErrors, RunDir};
use augnerf::settings::Method;
use augnerf::sweep::verify::{Archive, Outcome, Verifier};
use augnerf::sweep::{
    Collector, Definition, Point, PointFolder, PointResult, PublishedCosts, Results, StepCosts, SweepFolder,
    SweepOutputs, Trainings, expand,
};
use augnerf::train::checkpoint;

use super::formats::{Format, packed};
use super::readers::{Reader, reader, write};
use super::seeds;
use crate::common::{runtime, tiny_config, trained};
use crate::sweep_run::Costs;

/// All of them, their files in folders below `folder`.
pub fn all(folder: &Path) -> Vec<Reader> {
    let mut all = collected(folder);
    all.extend(points(folder));
    all.extend([depth_errors(folder), step_seconds(folder), run_lock(folder), sums(folder), extended(folder)]);
    all
}

/// A folder of its own for the reader of a file.
fn own(folder: &Path, name: &str) -> PathBuf {
    let path = folder.join(name);
    fs::create_dir_all(&path).unwrap();
    path
}

/// What `augnerf verify` does. What it finds wrong is refused, and fit for a terminal.
fn verify(results: &Path) -> Result<()> {
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

/// A sweep whose points are done, each with the files of its run.
pub fn done_sweep(path: &Path) -> (SweepFolder, Definition, Vec<Point>) {
    let definition = Definition::parse(seeds::SMALL_SWEEP, "small.toml").unwrap();
    let points = expand(&definition, None, &Costs).unwrap();
    let folder = SweepFolder::new(path);
    drop(folder.lock().unwrap());
    folder.begin(&definition, &points, None).unwrap();
    for (point, psnr) in points.iter().zip([21.5, 22.25]) {
        let of_point: PointFolder = folder.point(&point.id);
        of_point.begin(point).unwrap();
        let run = of_point.run();
        fs::create_dir_all(run.join("renders")).unwrap();
        let protocol = [("protocol", "1"), ("steps", "1200"), ("code_revision", "abc")];
        let protocol = protocol.map(|(name, text)| (name.to_string(), text.to_string())).to_vec();
        let metrics = vec![("psnr".into(), Some(psnr)), ("ssim".into(), None)];
        of_point.finish(&PointResult { metrics, protocol, inactive_levels: Vec::new() }).unwrap();
        write(&run.join("timing.json"), seeds::TIMING.as_bytes());
        write(&run.join("scalars.csv"), seeds::CURVES.as_bytes());
        write(&RunDir::surface_picture_in(&run), &seeds::pngs()[0]);
    }
    (folder, definition, points)
}

/// The files beside a sweep's tables: read for all that is made of them, and, of two, with every table and figure.
fn collected(folder: &Path) -> Vec<Reader> {
    let (from, definition, points) = done_sweep(&own(folder, "done"));
    let outputs = SweepOutputs::of_folder(&from, &definition, &points).unwrap();
    let collect = |results: &Path| {
        let all = Collector {
            outputs: &outputs,
            definition: &definition,
            points: &points,
            name: "small",
            force: false,
            with_timing: false,
        };
        all.write(&Results::take(results).unwrap()).unwrap();
    };
    let tables = |results: &Path| {
        let archive = Archive::read(results, None)?;
        let spec = archive.definition.table(&archive.provenance.name, &archive.points);
        archive.outputs.scalars.values().for_each(|scalars| drop(scalars.pairs("step", "psnr")));
        Table::new(&spec, &archive.outputs.records, true).map(drop)
    };
    let of_file = |(name, file, format, whole): (&'static str, &'static str, Format, bool)| {
        let results = own(folder, &name.replace(' ', "_")).join("small");
        collect(&results);
        let path = results.join(file);
        reader(name, format, vec![fs::read(&path).unwrap()], move |bytes| {
            write(&path, bytes);
            if whole { verify(&results) } else { tables(&results) }
        })
    };
    [
        ("results, points.csv", "points.csv", Format::Text, false),
        ("results, timing.csv", "timing.csv", Format::Text, false),
        ("results, scalars.csv.gz", "scalars.csv.gz", Format::Gzip, false),
        ("results, provenance.toml", "provenance.toml", Format::Text, false),
        ("figures of points.csv", "points.csv", Format::Text, true),
        ("figures of scalars.csv.gz", "scalars.csv.gz", Format::Gzip, true),
        ("ids of provenance.toml", "provenance.toml", Format::Text, true),
    ]
    .map(of_file)
    .into()
}

/// The files of a sweep's folder that tables and figures are made of.
fn points(folder: &Path) -> Vec<Reader> {
    let of_file = |(name, file, format, seeds): (&'static str, &'static str, Format, Vec<Vec<u8>>)| {
        let (sweep, definition, points) = done_sweep(&own(folder, &name.replace(' ', "_")));
        let path = sweep.point(&points[0].id).path().join(file);
        let seeds = if seeds.is_empty() { vec![fs::read(&path).unwrap()] } else { seeds };
        reader(name, format, seeds, move |bytes| {
            write(&path, bytes);
            sweep.point(&points[0].id).begin(&points[0])?;
            let outputs = SweepOutputs::of_folder(&sweep, &definition, &points)?;
            outputs.scalars.values().for_each(|scalars| drop(scalars.pairs("step", "psnr")));
            Ok(())
        })
    };
    let mut readers: Vec<Reader> = [
        ("point, config.toml", "config.toml", Format::Text, Vec::new()),
        ("point, scalars.csv", "run/scalars.csv", Format::Text, Vec::new()),
        ("point, timing.json", "run/timing.json", Format::Text, Vec::new()),
        ("point, surface.png", "run/renders/surface.png", Format::Png, seeds::pngs()),
    ]
    .map(of_file)
    .into();
    let (sweep, _, _) = done_sweep(&own(folder, "definition"));
    let path = sweep.path().join("sweep.toml");
    readers.push(reader("sweep, sweep.toml", Format::Text, vec![fs::read(&path).unwrap()], move |bytes| {
        write(&path, bytes);
        sweep.definition().map(drop)
    }));
    readers
}

fn depth_errors(folder: &Path) -> Reader {
    let path = own(folder, "depth").join("depth_errors.gz");
    let views = [vec![0.5f32, f32::NAN, -1e-7], Vec::new(), vec![3.0; 40]];
    let content: Vec<u8> = views
        .iter()
        .flat_map(|view| {
            [(view.len() as u32).to_le_bytes().to_vec(), view.iter().flat_map(|v| v.to_le_bytes()).collect()].concat()
        })
        .collect();
    reader("run, depth_errors.gz", Format::Gzip, vec![packed(&content)], move |bytes| {
        write(&path, bytes);
        DepthErrors::read(&path).map(drop)
    })
}

fn step_seconds(folder: &Path) -> Reader {
    let (dir, config) = (own(folder, "seconds"), tiny_config(Method::Nerf, |_| {}));
    let seed = format!("{{\"seconds\": {{\n  \"{}\": 0.25,\n  \"0123456789ab\": 1e-3\n}}}}\n", config.step_shape());
    reader("sweep, step_seconds.json", Format::Text, vec![seed.into_bytes()], move |bytes| {
        write(&dir.join("step_seconds.json"), bytes);
        let seconds = PublishedCosts::beside(&dir, &Costs)?.seconds_per_step(&config)?;
        assert!(seconds.is_finite() && seconds > 0.0, "a step of {seconds} s");
        Ok(())
    })
}

/// Who holds a run, as another process says.
fn run_lock(folder: &Path) -> Reader {
    let dir = own(folder, "lock");
    write(&dir.join("config.toml"), b"");
    let held = File::create(dir.join("run.lock")).unwrap();
    held.lock().unwrap();
    let reader = reader("run, run.lock", Format::Text, vec![b"4711".to_vec()], move |bytes| {
        let _held = &held;
        write(&dir.join("run.lock"), bytes);
        RunDir::take(&dir).map(drop)
    });
    Reader { lacks: &["is in use by process 4711"], ..reader }
}

/// The checksums of a run's only checkpoint.
fn sums(folder: &Path) -> Reader {
    let checkpoints = own(folder, "sums");
    let path = trained(&tiny_config(Method::Nerf, |_| {}), 2).save(&checkpoints).unwrap().join("SHA256SUMS");
    reader("checkpoint, SHA256SUMS", Format::Text, vec![fs::read(&path).unwrap()], move |bytes| {
        write(&path, bytes);
        checkpoint::newest_whole(&checkpoints).map(drop)
    })
}

/// A sweep file that another one starts from.
fn extended(folder: &Path) -> Reader {
    let dir = own(folder, "extended");
    let path = dir.join("above.toml");
    write(&path, b"extends = \"base.toml\"\nseeds = [3]\n[[row]]\nname = \"NeRF\"\nset = { \"train.steps\" = 9 }\n");
    reader("sweep, extended", Format::Text, vec![seeds::SMALL_SWEEP.into()], move |bytes| {
        write(&dir.join("base.toml"), bytes);
        expand(&Definition::read(&path)?, None, &Costs).map(drop)
    })
}
