//! Sound files to begin with.

use std::io::Cursor;

use image::{DynamicImage, ImageBuffer, ImageFormat, Rgb, Rgba};

use super::formats::archive;

/// Names, shapes and values of a network's first tensors.
fn tensors() -> Vec<(&'static str, Vec<usize>)> {
    vec![("0.weight", vec![64, 3, 3, 3]), ("0.bias", vec![64])]
}

/// A state dictionary as `torch.save` describes it, its storages keyed `0`, `1`, ...
fn state(tensors: &[(&str, Vec<usize>)]) -> Vec<u8> {
    let mut pickle = b"\x80\x02ccollections\nOrderedDict\nq\x00)Rq\x01(".to_vec();
    let text = |text: &str| [&b"X"[..], &(text.len() as u32).to_le_bytes(), text.as_bytes()].concat();
    let sizes = |sizes: &[usize]| {
        let sizes: Vec<u8> =
            sizes.iter().flat_map(|size| [&b"J"[..], &(*size as i32).to_le_bytes()].concat()).collect();
        [&b"("[..], &sizes, b"t"].concat()
    };
    for (key, (name, shape)) in tensors.iter().enumerate() {
        let count = shape.iter().product::<usize>() as i32;
        let strides: Vec<usize> = (0..shape.len()).map(|axis| shape[axis + 1..].iter().product()).collect();
        pickle.extend(text(name));
        pickle.extend(b"ctorch._utils\n_rebuild_tensor_v2\n((");
        pickle.extend(
            [text("storage"), b"ctorch\nFloatStorage\n".to_vec(), text(&key.to_string()), text("cpu")].concat(),
        );
        pickle.extend([&b"J"[..], &count.to_le_bytes(), b"tQK\x00"].concat());
        pickle.extend([sizes(shape), sizes(&strides)].concat());
        pickle.extend(b"\x89ccollections\nOrderedDict\n)RtR");
    }
    pickle.extend(b"u.");
    pickle
}

fn values(shape: &[usize]) -> Vec<u8> {
    (0..shape.iter().product::<usize>()).flat_map(|value| (value as f32 * 0.001).to_le_bytes()).collect()
}

/// As PyTorch wrote before version 1.6.
pub fn legacy() -> Vec<u8> {
    let mut file = b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19.\x80\x02M\xe9\x03.".to_vec();
    file.extend(b"\x80\x02}q\x01U\x0dlittle_endianq\x02\x88s.");
    file.extend(state(&tensors()));
    file.extend(b"\x80\x02]q\x01(X\x01\x00\x00\x000X\x01\x00\x00\x001e.");
    for (_, shape) in tensors() {
        file.extend(shape.iter().product::<usize>().to_le_bytes());
        file.extend(values(&shape));
    }
    file
}

/// As it writes since.
pub fn zipped() -> Vec<u8> {
    let contents: Vec<Vec<u8>> = tensors().iter().map(|(_, shape)| values(shape)).collect();
    let pickle = state(&tensors());
    archive(&[
        (b"net/data.pkl", &pickle),
        (b"net/data/0", &contents[0]),
        (b"net/data/1", &contents[1]),
        (b"net/version", b"3\n"),
    ])
}

/// A safetensors file of these tensors.
pub fn safetensors(tensors: &[(&str, Vec<usize>)]) -> Vec<u8> {
    safetensors_with(tensors, serde_json::json!({}))
}

/// The same with a header that has begun.
fn safetensors_with(tensors: &[(&str, Vec<usize>)], header: serde_json::Value) -> Vec<u8> {
    let serde_json::Value::Object(mut header) = header else { unreachable!("a header is an object") };
    let mut data = Vec::new();
    for (name, shape) in tensors {
        let start = data.len();
        data.extend(values(shape));
        let place = serde_json::json!({"dtype": "F32", "shape": shape, "data_offsets": [start, data.len()]});
        header.insert((*name).to_string(), place);
    }
    let header = serde_json::to_vec(&header).unwrap();
    [&(header.len() as u64).to_le_bytes()[..], &header, &data].concat()
}

/// The network's first tensors as safetensors.
pub fn network() -> Vec<u8> {
    safetensors(&tensors())
}

/// The same as `augnerf export` writes it.
pub fn exported() -> Vec<u8> {
    let config = augnerf::settings::Config::default().to_toml();
    let said = serde_json::json!({"format": 1, "step": 7, "config": config}).to_string();
    safetensors_with(&tensors(), serde_json::json!({"__metadata__": {"augnerf": said}}))
}

/// The linear layer that belongs to them.
pub fn linear() -> Vec<u8> {
    safetensors(&[("lin0.model.1.weight", vec![1, 64, 1, 1])])
}

/// A small picture.
pub fn picture(width: u32, height: u32) -> image::RgbImage {
    ImageBuffer::from_fn(width, height, |x, y| Rgb([(x * 13) as u8, (y * 17) as u8, (x * y) as u8]))
}

fn encoded(picture: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

/// PNG files of all kinds that are written here.
pub fn pngs() -> Vec<Vec<u8>> {
    let rgb = DynamicImage::ImageRgb8(picture(9, 7));
    let clear =
        DynamicImage::ImageRgba8(ImageBuffer::from_fn(8, 8, |x, y| Rgba([x as u8, y as u8, 9, (x * 30) as u8])));
    let kinds = [rgb.to_luma8().into(), rgb.to_luma16().into(), rgb.to_rgba16().into(), rgb, clear];
    kinds.iter().map(|picture: &DynamicImage| encoded(picture, ImageFormat::Png)).collect()
}

/// JPEG files.
pub fn jpegs() -> Vec<Vec<u8>> {
    let rgb = DynamicImage::ImageRgb8(picture(24, 17));
    let grey = rgb.to_luma8().into();
    [rgb, grey].iter().map(|picture: &DynamicImage| encoded(picture, ImageFormat::Jpeg)).collect()
}

/// WebP files, which are written without loss alone.
pub fn webps() -> Vec<Vec<u8>> {
    let rgb = DynamicImage::ImageRgb8(picture(24, 17));
    let clear = rgb.to_rgba8().into();
    [rgb, clear].iter().map(|picture: &DynamicImage| encoded(picture, ImageFormat::WebP)).collect()
}

/// A depth map as NeRF-Synthetic's: four equal channels.
pub fn depth_map() -> Vec<u8> {
    let map = ImageBuffer::from_fn(16, 12, |x, _| Rgba([if x < 4 { 0 } else { 120 }; 4]));
    encoded(&DynamicImage::ImageRgba8(map), ImageFormat::Png)
}

/// `poses_bounds.npy` of `views` cameras side by side, of pictures of 16 x 12.
pub fn poses(views: usize) -> Vec<u8> {
    let row = |view: usize| {
        let (x, turn) = (view as f64 * 0.1, view as f64 * 0.02);
        let (sin, cos) = turn.sin_cos();
        [0.0, cos, sin, x, 12.0, -1.0, 0.0, 0.0, 0.1 * x, 16.0, 0.0, -sin, cos, 0.0, 14.0, 1.0, 5.0]
    };
    super::formats::npy((views, 17), &(0..views).flat_map(row).collect::<Vec<f64>>())
}

/// The same as NeX writes them, without the lens.
pub fn nex_poses(views: usize) -> Vec<u8> {
    let row = |view: usize| {
        let (sin, cos) = (view as f64 * 0.02).sin_cos();
        [0.0, cos, sin, view as f64 * 0.1, -1.0, 0.0, 0.0, 0.0, 0.0, -sin, cos, 0.0, 1.0, 5.0]
    };
    super::formats::npy((views, 14), &(0..views).flat_map(row).collect::<Vec<f64>>())
}

/// NeX's lens of these images.
pub fn nex_lens() -> Vec<u8> {
    super::formats::npy((6, 1), &[12.0, 16.0, 14.0, 14.5, 8.5, 5.5])
}

/// `transforms.json` of four views with these keys beside the frames.
pub fn transforms(keys: &str) -> Vec<u8> {
    let frame = |i: usize| {
        let (sin, cos) = (i as f64 * 0.7).sin_cos();
        let (x, z) = (4.0 * sin, 4.0 * cos);
        format!(
            "    {{\n      \"file_path\": \"./views/{i}\",\n      \"transform_matrix\": [\n        [{cos}, 0.0, {sin}, {x}],\n\
             \x20       [0.0, 1.0, 0.0, 0.5],\n        [{}, 0.0, {cos}, {z}],\n        [0.0, 0.0, 0.0, 1.0]\n      ]\n    }}",
            -sin
        )
    };
    let frames: Vec<String> = (0..4).map(frame).collect();
    format!("{{\n  {keys},\n  \"frames\": [\n{}\n  ]\n}}\n", frames.join(",\n")).into_bytes()
}

/// A PLY file of a square, in a format.
pub fn ply(format: &str) -> Vec<u8> {
    let corners = [[0f32, 0.0, 0.5], [1.0, 0.0, 0.5], [1.0, 1.0, 0.5], [0.0, 1.0, 0.5]];
    let mut file = format!(
        "ply\nformat {format} 1.0\ncomment a square\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
         property uchar red\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
    )
    .into_bytes();
    if format == "ascii" {
        file.extend(b"0 0 0.5 9\n1 0 0.5 9\n1 1 0.5 9\n0 1 0.5 9\n3 0 1 2\n4 0 2 3 1\n");
        return file;
    }
    let big = format == "binary_big_endian";
    for corner in corners {
        corner.iter().for_each(|v| file.extend(if big { v.to_be_bytes() } else { v.to_le_bytes() }));
        file.push(9);
    }
    for face in [&[0i32, 1, 2][..], &[0, 2, 3, 1]] {
        file.push(face.len() as u8);
        face.iter().for_each(|i| file.extend(if big { i.to_be_bytes() } else { i.to_le_bytes() }));
    }
    file
}

pub const OBJ: &str = "# a square\nmtllib a.mtl\no part\nv 0 0 0.5 1 0 0\nv 1 0 0.5\nv 1 1 0.5\nv 0 1 0.5\nvt 0.5 0.5\nvn 0 0 1\n\
                       usemtl b\nf 1/1/1 2//1 -2 4\nl 1 2 3\nf -4 -3 -2\n";

pub const SWEEP: &str = r#"title = "a test"
preset = "smoke"
scenes = ["builtin", "builtin-forward"]
seeds = [0, 1]
metrics = ["psnr", "ssim"]
baseline = "NeRF"
combine = "one-at-a-time"

[set]
"train.steps" = 40
"data.downscale" = 8

[[axis]]
name = "rays"
keys = ["train.rays"]
values = [16, 32]

[[row]]
name = "NeRF"

[[row]]
name = "+ TV Reg."
set = { "regularizer.kind" = "tv", "regularizer.weight" = 1e-5 }

[[row]]
name = "Aug-NeRF"
axes = false
set = { method = "aug-nerf", "perturb.t.steps" = 3 }
"#;

/// A sweep of few points, for the files of its folder.
pub const SMALL_SWEEP: &str = r#"title = "a test"
preset = "smoke"
scenes = ["builtin"]
seeds = [0]
metrics = ["psnr"]
baseline = "NeRF"
[[row]]
name = "NeRF"
[[row]]
name = "Aug-NeRF"
set = { method = "aug-nerf" }
"#;

/// Arguments of `--set`.
pub const ASSIGNMENTS: [&str; 16] = [
    "train.steps=2000",
    "method=aug-nerf",
    "perturb.t.epsilon=0.25",
    "perturb.levels=[\"input\"]",
    "perturb.rgb.norm=l2",
    "perturb.attack=calibrated",
    "regularizer.kind=[\"tv\",\"l1\"]",
    "regularizer.points_per_step=64",
    "eval.mesh.box=[[-1,-1,-1],[1,1,1]]",
    "eval.mesh.threshold=3",
    "data.dir=a b",
    "data.near=1.5",
    "field.skips=[1,2]",
    "field.width=64",
    "data.corruption.kind=pepper",
    "train.precrop_steps=0",
];

/// A run's `timing.json`.
pub const TIMING: &str = r#"{
  "seconds_training": 12.5, "seconds_evaluation": 0.1, "rays_per_second": null, "peak_memory_mib": 100.5, "device": "cpu",
  "threads": 2, "host": {"name": "a", "os": "linux", "arch": "x86_64", "cpu": "one", "cpus": 2}, "started_unix": 1,
  "finished_unix": 2, "sessions": 1
}
"#;

/// A run's `scalars.csv` with curves.
pub const CURVES: &str =
    "step,loss,psnr,test_psnr,train_psnr\n10,0.5,12.5,,\n20,0.25,15,14.5,15.5\n40,0.125,18,17.25,18.5\n";

/// Files of cameras.
pub const CAMERAS: [&str; 2] = [
    r#"{"camera_type": "perspective", "render_height": 12, "render_width": 16, "fps": 24, "seconds": 1, "camera_path": [
{"camera_to_world": [1, 0, 0, 0.5, 0, 1, 0, 0.25, 0, 0, 1, 4, 0, 0, 0, 1], "fov": 50, "aspect": 1.3},
{"camera_to_world": [[1, 0, 0, 0.5], [0, 1, 0, 0.25], [0, 0, 1, 4], [0, 0, 0, 1]], "fl_x": 20, "cx": 8}]}"#,
    r#"{"w": 16, "h": 12, "fl_x": 20.5, "cy": 6, "frames": [
{"transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]},
{"camera_angle_x": 0.7, "transform_matrix": [[0, 0, 1, 4], [0, 1, 0, 0], [-1, 0, 0, 0]]}]}"#,
];

/// Cameras that are poses alone.
pub fn camera_poses() -> Vec<u8> {
    let header = "{'descr': '<f8', 'fortran_order': False, 'shape': (2, 3, 4), }\n";
    let pose = [1.0, 0.0, 0.0, 0.5, 0.0, 1.0, 0.0, 0.25, 0.0, 0.0, 1.0, 4.0f64];
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.bytes());
    bytes.extend(pose.repeat(2).into_iter().flat_map(f64::to_le_bytes));
    bytes
}

/// Checkpoints of nerf-pytorch, sound and broken.
pub fn checkpoint_tars() -> Vec<Vec<u8>> {
    vec![
        include_bytes!("../../fixtures/nerf_pytorch.tar").to_vec(),
        include_bytes!("../../fixtures/hostile/short_storage.tar").to_vec(),
        include_bytes!("../../fixtures/hostile/missing_storage.tar").to_vec(),
        include_bytes!("../../fixtures/hostile/coarse_5_fine_6_layers.tar").to_vec(),
    ]
}
