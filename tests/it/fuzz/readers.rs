//! The readers, each with sound files to begin with and the way that the program takes to it.

use std::fs;
use std::path::{Path, PathBuf};

use augnerf::base::{Error, Result};
use augnerf::data::cameras::Dataparser;
use augnerf::data::{self, WorldToScene, images};
use augnerf::methods::SiteSummary;
use augnerf::metrics::{Backbone, Lpips};
use augnerf::report::tables::{Table, points_csv};
use augnerf::run::{Foreign, Matching, Networks, RunDir, Scalars, Truth, pictures as listed, score};
use augnerf::settings::{Axes, Config, DataConfig, Method, Preset, build, parse_assignment};
use augnerf::space::{read_mesh, sample};
use augnerf::sweep::{Definition, Failure, Point, PointResult, SweepFolder, SweepOutputs, expand};
use augnerf::train::checkpoint;
use candle_core::{DType, Device};

use super::formats::Format;
use super::{results, seeds};
use crate::common::files::seal;
use crate::common::{tiny_config, tiny_scene, trained};
use crate::sweep_run::Costs;

type Read = dyn Fn(&[u8]) -> Result<()>;

/// A reader of files.
pub struct Reader {
    /// What it reads.
    pub name: &'static str,
    pub format: Format,
    /// Sound files.
    pub seeds: Vec<Vec<u8>>,
    /// What is said of files that are not whole: too small, or broken on purpose.
    pub lacks: &'static [&'static str],
    /// Reads a file of these bytes.
    pub read: Box<Read>,
}

pub fn reader(
    name: &'static str,
    format: Format,
    seeds: Vec<Vec<u8>>,
    read: impl Fn(&[u8]) -> Result<()> + 'static,
) -> Reader {
    Reader { name, format, seeds, lacks: &[], read: Box::new(read) }
}

/// All readers, their files in folders below `folder`.
pub fn all(folder: &Path) -> Vec<Reader> {
    let below = |name: &str| {
        let path = folder.join(name);
        fs::create_dir_all(&path).unwrap();
        path
    };
    let mut all = vec![
        weights(&below("legacy"), "weights, legacy", "pth", Format::Pickle, seeds::legacy()),
        weights(&below("zip"), "weights, zip", "pth", Format::Archive, seeds::zipped()),
        weights(&below("safetensors"), "weights, safetensors", "safetensors", Format::Safetensors, seeds::network()),
        meshes(below("ply").join("a.ply"), "mesh, ply", Format::Ply, ply_seeds()),
        meshes(below("obj").join("a.obj"), "mesh, obj", Format::Text, vec![seeds::OBJ.into()]),
        llff(below("llff"), "scene, poses_bounds.npy", "poses_bounds.npy", seeds::poses(3)),
        llff(below("nex poses"), "scene, poses of NeX", "poses_bounds.npy", seeds::nex_poses(3)),
        llff(below("nex lens"), "scene, hwf_cxcy.npy", "hwf_cxcy.npy", seeds::nex_lens()),
        registered(below("registered")),
        second_model(below("second model")),
        folder_masks(below("folder masks")),
        unknown(below("unknown")),
        transforms(below("transforms")),
        colmap(below("colmap cameras"), "scene, colmap cameras.bin", "cameras.bin"),
        colmap(below("colmap images"), "scene, colmap images.bin", "images.bin"),
        colmap(below("colmap points"), "scene, colmap points3D.bin", "points3D.bin"),
        colmap(below("colmap cameras text"), "scene, colmap cameras.txt", "cameras.txt"),
        colmap(below("colmap images text"), "scene, colmap images.txt", "images.txt"),
        colmap(below("colmap points text"), "scene, colmap points3D.txt", "points3D.txt"),
        blender(below("blender")),
        masks(below("mask")),
        depth_maps(below("depth")),
        pictures(below("png").join("a.png"), "picture, png", Format::Png, seeds::pngs()),
        pictures(below("jpeg").join("a.jpg"), "picture, jpeg", Format::Bytes, seeds::jpegs()),
        pictures(below("webp").join("a.webp"), "picture, webp", Format::Bytes, seeds::webps()),
        scored(below("score")),
        configs(below("config").join("config.toml")),
        reader("--set", Format::Text, seeds::ASSIGNMENTS.map(Vec::from).to_vec(), |bytes| {
            let assignment = parse_assignment(&String::from_utf8_lossy(bytes))?;
            build(Some(Preset::Smoke), None, &[assignment]).map(drop)
        }),
        sweeps(below("sweep").join("sweep.toml")),
        cameras(below("path").join("path.json"), "cameras, json", Format::Text, seeds::CAMERAS.map(Vec::from).to_vec()),
        cameras(below("poses").join("poses.npy"), "cameras, npy", Format::Npy, vec![seeds::camera_poses()]),
        foreign(below("tar").join("a.tar"), "import, torch", Format::Archive, seeds::checkpoint_tars()),
        foreign(
            below("own").join("a.safetensors"),
            "import, safetensors",
            Format::Safetensors,
            vec![seeds::exported()],
        ),
        dataparser(below("dataparser")),
    ];
    all.extend(runs(&below("run")));
    all.extend(sweep_folders(&below("folder")));
    all.extend(results::all(&below("results")));
    all
}

pub fn write(path: &Path, bytes: &[u8]) {
    fs::write(path, bytes).unwrap();
}

/// LPIPS weights whose linear layers are sound. The files hold the first two tensors alone.
fn weights(dir: &Path, name: &'static str, ending: &str, format: Format, seed: Vec<u8>) -> Reader {
    write(&dir.join("squeeze_lin_v0.1.safetensors"), &seeds::linear());
    let (dir, file) = (dir.to_path_buf(), dir.join(format!("squeezenet1_1_features.{ending}")));
    let reader = reader(name, format, vec![seed], move |bytes| {
        write(&file, bytes);
        Lpips::load(&dir, Backbone::Squeeze, &Device::Cpu).map(drop)
    });
    Reader { lacks: &["lacks the tensor 3.squeeze.weight"], ..reader }
}

fn ply_seeds() -> Vec<Vec<u8>> {
    ["ascii", "binary_little_endian", "binary_big_endian"].map(seeds::ply).to_vec()
}

/// Meshes, and points on those that are read.
fn meshes(file: PathBuf, name: &'static str, format: Format, seeds: Vec<Vec<u8>>) -> Reader {
    reader(name, format, seeds, move |bytes| {
        write(&file, bytes);
        sample(&read_mesh(&file)?, 16, 0).map(drop)
    })
}

/// A picture of another program, measured against a sound one.
fn scored(dir: PathBuf) -> Reader {
    let truth = dir.join("truth");
    write_pictures(&truth, 1);
    let sound = fs::read(truth.join("0.png")).unwrap();
    let own = dir.join("own");
    fs::create_dir_all(&own).unwrap();
    reader("picture, score", Format::Png, vec![sound], move |bytes| {
        write(&own.join("0.png"), bytes);
        let truth = Truth::Pictures(listed(&truth, "_truth")?);
        score(&listed(&own, "_rgb")?, &truth, Matching::Name, None, &[], &()).map(drop)
    })
}

/// Cameras of renderings.
fn cameras(file: PathBuf, name: &'static str, format: Format, seeds: Vec<Vec<u8>>) -> Reader {
    let like = tiny_scene().train[0].camera;
    reader(name, format, seeds, move |bytes| {
        write(&file, bytes);
        data::cameras::read(&file, &like, &WorldToScene::default(), Axes::Opengl, None).map(drop)
    })
}

/// Weights of other programs and of this one, as far as to the settings that they ask for.
fn foreign(file: PathBuf, name: &'static str, format: Format, seeds: Vec<Vec<u8>>) -> Reader {
    let reader = reader(name, format, seeds, move |bytes| {
        write(&file, bytes);
        let foreign = Foreign::open(&file)?;
        if let Networks::Own { config } = foreign.networks() {
            Config::from_toml(config, "its configuration")?;
        }
        foreign.settings().map(drop)
    });
    Reader { lacks: &["cannot be read", "here both have the same layers"], ..reader }
}

/// The way to nerfstudio's units, beside a capture with a way of its own.
fn dataparser(dir: PathBuf) -> Reader {
    let file = dir.join("dataparser_transforms.json");
    let rows = "[[0.8, -0.6, 0.0, 1.5], [0.6, 0.8, 0.0, -2.0], [0.0, 0.0, 1.0, 0.25]]";
    let capture = dir.join("transforms.json");
    write(&capture, format!("{{\"applied_transform\": {rows}, \"applied_scale\": 1.0}}").as_bytes());
    let seed = format!("{{\"transform\": {rows}, \"scale\": 0.25}}").into_bytes();
    let camera = tiny_scene().train[0].camera.pose;
    reader("cameras, dataparser_transforms.json", Format::Text, vec![seed], move |bytes| {
        write(&file, bytes);
        Dataparser::read(&file, &capture).map(|dataparser| _ = dataparser.to_capture(&camera))
    })
}

fn config_of(dir: &Path) -> DataConfig {
    DataConfig { dir: dir.display().to_string(), downscale: Some(1), ..DataConfig::default() }
}

fn load(mut config: DataConfig) -> Result<()> {
    config.kind = data::detect(&config)?;
    data::load(&config, 0, &()).map(drop)
}

fn write_pictures(dir: &Path, count: usize) {
    fs::create_dir_all(dir).unwrap();
    (0..count).for_each(|i| seeds::picture(16, 12).save(dir.join(format!("{i}.png"))).unwrap());
}

/// A file of an LLFF scene beside sound ones. Poses of every other file are put on a sphere.
fn llff(dir: PathBuf, name: &'static str, file: &'static str, seed: Vec<u8>) -> Reader {
    write_pictures(&dir.join("images"), 3);
    write(&dir.join("poses_bounds.npy"), &seeds::nex_poses(3));
    write(&dir.join("hwf_cxcy.npy"), &seeds::nex_lens());
    reader(name, Format::Npy, vec![seed], move |bytes| {
        write(&dir.join(file), bytes);
        let spherify = bytes.iter().fold(0, |sum, byte| sum ^ byte) & 1 == 1;
        load(DataConfig { spherify, ndc: !spherify, ..config_of(&dir) }).or_else(|error| match error {
            // Cameras side by side fit none.
            Error::Data(message) if spherify && message.contains("fit no sphere") => Ok(()),
            error => Err(error),
        })
    })
}

/// The list of the photos that have poses, where there are more.
fn registered(dir: PathBuf) -> Reader {
    write_pictures(&dir.join("images"), 4);
    write(&dir.join("poses_bounds.npy"), &seeds::poses(3));
    reader("scene, view_imgs.txt", Format::Text, vec![b"0.png\n1.png\n3.png\n".to_vec()], move |bytes| {
        write(&dir.join("view_imgs.txt"), bytes);
        load(config_of(&dir))
    })
}

/// A file that is no scene's own, but may be one under another name.
fn unknown(dir: PathBuf) -> Reader {
    let seeds = vec![seeds::transforms("\"camera_angle_x\": 0.7")];
    let reader = reader("no scene, JSON", Format::Text, seeds, move |bytes| {
        write(&dir.join("cams.json"), bytes);
        load(config_of(&dir))
    });
    Reader { lacks: &["rename it to transforms.json"], ..reader }
}

/// Masks in a folder, and instant-ngp's beside the photos.
fn folder_masks(dir: PathBuf) -> Reader {
    write_pictures(&dir.join("views"), 4);
    fs::create_dir_all(dir.join("masks")).unwrap();
    write(&dir.join("transforms.json"), &seeds::transforms("\"camera_angle_x\": 0.7"));
    reader("scene, masks in folders", Format::Png, vec![seeds::depth_map()], move |bytes| {
        write(&dir.join("masks/1.png"), bytes);
        write(&dir.join("views/dynamic_mask_2.png"), bytes);
        let masks = if bytes.len() % 2 == 0 { "masks" } else { "beside" };
        load(DataConfig { masks: masks.into(), ..config_of(&dir) })
    })
}

fn transforms(dir: PathBuf) -> Reader {
    write_pictures(&dir.join("views"), 4);
    let keys = [
        "\"camera_angle_x\": 0.7,\n  \"orthographic\": false,\n  \"masks\": null",
        "\"camera_angle_x\": 0.7",
        "\"camera_model\": \"OPENCV\",\n  \"fl_x\": 30.5,\n  \"fl_y\": 30,\n  \"cx\": 16,\n  \"cy\": 12,\n  \"w\": 32,\n  \
         \"h\": 24,\n  \"k1\": 0.05,\n  \"k2\": -0.01,\n  \"p1\": 0.001,\n  \"aabb_scale\": 4",
        "\"fl_x\": 20,\n  \"sharpness\": NaN,\n  \"mask_path\": \"/home/me/mask.png\",\n  \"train_filenames\": [\"views/1\", \
         \"views/3\"],\n  \"val_filenames\": [\"views/2\"],\n  \"test_filenames\": [\"./views/0\"]",
    ];
    image::GrayImage::from_fn(16, 12, |x, _| image::Luma([u8::from(x < 9)])).save(dir.join("mask.png")).unwrap();
    reader("scene, transforms.json", Format::Text, keys.map(seeds::transforms).to_vec(), move |bytes| {
        write(&dir.join("transforms.json"), bytes);
        load(config_of(&dir))
    })
}

/// One file of a COLMAP model beside sound ones of the others.
fn colmap(dir: PathBuf, name: &'static str, file: &'static str) -> Reader {
    write_pictures(&dir.join("images"), 4);
    let model = dir.join("sparse/0");
    fs::create_dir_all(&model).unwrap();
    let is_text = file.ends_with(".txt");
    crate::colmap::fuzz_model().write(&model, is_text);
    let sound = fs::read(model.join(file)).unwrap();
    let format = if is_text { Format::Text } else { Format::Bytes };
    reader(name, format, vec![sound], move |bytes| {
        write(&model.join(file), bytes);
        load(config_of(&dir))
    })
}

/// A second model beside a sound one, which is read if it has more photos.
fn second_model(dir: PathBuf) -> Reader {
    write_pictures(&dir.join("images"), 4);
    let models = ["sparse/0", "sparse/1"].map(|name| dir.join(name));
    for model in &models {
        fs::create_dir_all(model).unwrap();
        crate::colmap::fuzz_model().write(model, false);
    }
    let file = models[1].join("images.bin");
    let sound = fs::read(&file).unwrap();
    reader("scene, second colmap model", Format::Bytes, vec![sound], move |bytes| {
        write(&file, bytes);
        load(config_of(&dir))
    })
}

fn blender(dir: PathBuf) -> Reader {
    write_pictures(&dir.join("views"), 4);
    let sound = seeds::transforms("\"camera_angle_x\": 0.7");
    write(&dir.join("transforms_test.json"), &sound);
    reader("scene, transforms_train.json", Format::Text, vec![sound], move |bytes| {
        write(&dir.join("transforms_train.json"), bytes);
        load(config_of(&dir))
    })
}

fn masks(dir: PathBuf) -> Reader {
    write_pictures(&dir.join("views"), 4);
    write(&dir.join("transforms.json"), &seeds::transforms("\"camera_angle_x\": 0.7, \"mask_path\": \"mask.png\""));
    reader("scene, mask", Format::Png, vec![seeds::depth_map()], move |bytes| {
        write(&dir.join("mask.png"), bytes);
        load(config_of(&dir))
    })
}

fn depth_maps(dir: PathBuf) -> Reader {
    write_pictures(&dir.join("views"), 4);
    let sound = seeds::transforms("\"camera_angle_x\": 0.7");
    write(&dir.join("transforms_train.json"), &sound);
    write(&dir.join("transforms_test.json"), &sound);
    reader("scene, depth map", Format::Png, vec![seeds::depth_map()], move |bytes| {
        write(&dir.join("views/0_depth_0000.png"), bytes);
        load(config_of(&dir))
    })
}

fn pictures(file: PathBuf, name: &'static str, format: Format, seeds: Vec<Vec<u8>>) -> Reader {
    reader(name, format, seeds, move |bytes| {
        write(&file, bytes);
        let (width, height) = images::size(&file)?;
        images::read(&file, (width.min(5), height.min(5))).map(drop)
    })
}

fn configs(file: PathBuf) -> Reader {
    let presets = Preset::ALL.map(|(_, preset)| build(Some(preset), None, &[]).unwrap().to_toml().into_bytes());
    let seeds = presets.into_iter().chain([b"method = \"aug-nerf\"\ntrain.steps = 20\n".to_vec()]).collect();
    reader("settings", Format::Text, seeds, move |bytes| {
        write(&file, bytes);
        let config = build(None, Some(&file), &[])?;
        // What is read can be written and hashed.
        Config::from_toml(&config.to_toml(), "again").map(|again| drop(again.hash()))
    })
}

/// Sweep files, and the points of those that are read.
fn sweeps(file: PathBuf) -> Reader {
    let shipped = crate::common::files::files(&Path::new(env!("CARGO_MANIFEST_DIR")).join("sweeps"), &[]);
    let shipped = shipped
        .into_iter()
        .filter(|(place, _)| place.extension().is_some_and(|end| end == "toml"))
        .map(|(_, bytes)| bytes)
        .filter(|bytes| !String::from_utf8_lossy(bytes).contains("\nextends"));
    let seeds = [seeds::SWEEP, seeds::SMALL_SWEEP].map(Vec::from).into_iter().chain(shipped).collect();
    reader("sweep", Format::Text, seeds, move |bytes| {
        write(&file, bytes);
        let definition = Definition::read(&file)?;
        Definition::parse(&definition.to_toml(), "again")?;
        expand(&definition, None, &Costs).map(drop)
    })
}

/// The files of a run folder.
fn runs(dir: &Path) -> Vec<Reader> {
    let config = tiny_config(Method::Nerf, |_| {});
    let checkpoint = trained(&config, 2).save(&dir.join("checkpoints")).unwrap();
    write(&dir.join("config.toml"), config.to_toml().as_bytes());
    let sound = |name: &str| vec![fs::read(checkpoint.join(name)).unwrap()];
    let (state, tensors) = (checkpoint.clone(), checkpoint.clone());
    let (own, clocks, scalars) = (dir.to_path_buf(), dir.to_path_buf(), dir.join("scalars.csv"));
    let with_tensors = config.clone();
    vec![
        reader("run, config.toml", Format::Text, vec![config.to_toml().into_bytes()], move |bytes| {
            write(&own.join("config.toml"), bytes);
            RunDir::open(&own)?.read_config().map(drop)
        }),
        reader("run, timing.json", Format::Text, vec![seeds::TIMING.into()], move |bytes| {
            write(&clocks.join("config.toml"), b"");
            write(&clocks.join("timing.json"), bytes);
            RunDir::open(&clocks)?.read_timing().map(drop)
        }),
        reader("run, scalars.csv", Format::Text, vec![SCALARS.into()], move |bytes| {
            write(&scalars, bytes);
            SiteSummary::read(&scalars, 3)?;
            Scalars::resume(&scalars, &["loss", "gain.t", "inactive.t"], 3).map(drop)
        }),
        reader("checkpoint, state.json", Format::Text, sound("state.json"), move |bytes| {
            write(&state.join("state.json"), bytes);
            seal(&state);
            checkpoint::check_config(&state, &checkpoint::load_state(&state)?, &config)
        }),
        reader("checkpoint, tensors", Format::Safetensors, sound("state.safetensors"), move |bytes| {
            write(&tensors.join("state.safetensors"), bytes);
            seal(&tensors);
            checkpoint::load_model(&tensors, &with_tensors, DType::F32, &Device::Cpu).map(drop)
        }),
    ]
}

const SCALARS: &str = "step,loss,gain.t,inactive.t\n1,0.5,,\n2,0.25,0.1,0\n3,1e-3,-0.2,1\n4,0.125,0,0\n";

/// Every record and the table of a sweep's folder.
fn records(folder: &SweepFolder, definition: &Definition) -> Result<()> {
    let points = folder.points(None)?.unwrap_or_default();
    points.iter().for_each(|point| drop(point.label()));
    let records = folder.records(definition, &points)?;
    Table::new(&definition.table("test", &points), &records, true).map(drop)
}

/// The files of a sweep's folder.
fn sweep_folders(dir: &Path) -> Vec<Reader> {
    let definition = Definition::parse(seeds::SMALL_SWEEP, "small.toml").unwrap();
    let points: Vec<Point> = expand(&definition, None, &Costs).unwrap();
    let begin = |name: &str| {
        let folder = SweepFolder::new(&dir.join(name));
        drop(folder.lock().unwrap());
        folder.begin(&definition, &points, None).unwrap();
        folder
    };
    let plan = begin("plan");
    let path = plan.path().join("points.json");
    let seed = fs::read(&path).unwrap();
    let own = definition.clone();
    let mut readers = vec![reader("sweep, points.json", Format::Text, vec![seed], move |bytes| {
        write(&path, bytes);
        records(&plan, &own)
    })];
    let metrics = vec![("psnr".to_string(), Some(21.5)), ("ssim".to_string(), None)];
    let protocol = vec![("scene".to_string(), "builtin".to_string()), ("revision".to_string(), "abc".to_string())];
    let result = PointResult { metrics, protocol, inactive_levels: vec!["t".into()] };
    let failure = Failure { reason: "it diverged".into(), exit_code: 6 };
    let json = |value: serde_json::Value| vec![value.to_string().into_bytes()];
    for (name, file, seed) in [
        ("sweep, result.json", "result.json", json(serde_json::to_value(&result).unwrap())),
        ("sweep, failed.json", "failed.json", json(serde_json::to_value(&failure).unwrap())),
        ("sweep, claim.json", "claim.json", vec![CLAIM.into()]),
    ] {
        let folder = begin(file);
        let point = folder.point(&points[0].id);
        fs::create_dir_all(point.path()).unwrap();
        let (path, definition) = (point.path().join(file), definition.clone());
        readers.push(reader(name, Format::Text, seed, move |bytes| {
            write(&path, bytes);
            records(&folder, &definition)
        }));
    }
    let (folder, own) = (begin("scored"), definition.clone());
    let path = folder.path().join("scored/a.json");
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    readers.push(reader("sweep, scored", Format::Text, vec![SCORED.into()], move |bytes| {
        write(&path, bytes);
        SweepOutputs::of_folder(&folder, &own, &[])
            .map(|outputs| drop(points_csv(&outputs.all_records(), &[], &vec![])))
    }));
    readers
}

const SCORED: &str = r#"{"row": "other", "scene": "builtin", "seed": 1, "predictions_sha256": "ab", "truth": "cd",
    "metrics": [["psnr", 20.5], ["ssim", null]], "protocol": [["width", "16"]]}"#;

const CLAIM: &str =
    r#"{"host": "a", "pid": 7, "nonce": 3, "step": 4, "steps": 40, "seconds": 1.5, "first": 0, "deaths": 1}"#;
