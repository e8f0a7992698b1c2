//! The output side through its public interface: refusals, and files that other programs read.

use std::fs;
use std::path::Path;

use augnerf::base::Image;
use augnerf::base::files::{write_atomic, write_named};
use augnerf::draw::{Reel, beside, depth_colour, depth_range, write_depth16, write_png8};
use augnerf::run::{Existing, RunDir, Scalars};

#[test]
fn a_strangers_folder_is_never_touched() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("config.toml"), "theirs").unwrap();
    fs::write(dir.path().join("main.py"), "theirs").unwrap();
    for existing in [Existing::Refuse, Existing::Replace] {
        let error = RunDir::create(dir.path(), existing, 0).unwrap_err();
        assert!(error.to_string().contains("not a run folder"), "{error}");
    }
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2);
}

#[test]
fn two_trainers_do_not_share_a_run() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("run");
    let first = RunDir::create(&path, Existing::Refuse, 0).unwrap();
    write_atomic(&first.config(), b"").unwrap();
    let error = RunDir::create(&path, Existing::Replace, 0).unwrap_err();
    assert!(error.to_string().contains("run") && error.exit_code() == 4, "{error}");
    assert!(first.config().exists());
    let mut second = RunDir::open(&path).unwrap();
    assert!(second.lock().is_err());
    drop(first);
    second.lock().unwrap();
    second.lock().unwrap();
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_an_output_error() {
    let full = Path::new("/dev/full");
    assert_eq!(write_named(full, b"x").unwrap_err().exit_code(), 4);
    assert_eq!(write_png8(full, &ramp(8, 8)).unwrap_err().exit_code(), 4);
    assert_eq!(Scalars::create(full, &["loss"]).unwrap_err().exit_code(), 4);
    assert!(!full.metadata().unwrap().is_file());
}

fn ramp(width: usize, height: usize) -> Image {
    let pixels = (0..width * height)
        .flat_map(|i| [(i % width) as f32 / width as f32, (i / width) as f32 / height as f32, 0.3])
        .collect();
    Image { width, height, channels: 3, pixels }
}

/// A ball before a slanted plane, with nothing behind the upper corner.
fn ball_depth(size: usize, shift: f32) -> Vec<f32> {
    (0..size * size)
        .map(|i| {
            let x = (i % size) as f32 / size as f32 * 2.0 - 1.0 - shift;
            let y = (i / size) as f32 / size as f32 * 2.0 - 1.0;
            let inside = 0.3 - x * x - y * y;
            match inside {
                inside if inside > 0.0 => 4.0 - inside.sqrt(),
                _ if y < -0.6 => f32::INFINITY,
                _ => 5.0 - y,
            }
        })
        .collect()
}

/// Writes to `AUGNERF_LOOK` if it is set, for a look at the pictures, else to a temporary folder.
#[test]
fn pictures_read_back() {
    let temporary = tempfile::tempdir().unwrap();
    let dir = std::env::var("AUGNERF_LOOK").map_or(temporary.path().to_path_buf(), Into::into);
    let size = 160;
    let depth = ball_depth(size, 0.0);
    let (near, far) = depth_range(&depth, None).unwrap();
    let coloured = depth_colour(&depth, size, size, near, far, None).unwrap();
    let joined = beside(&[&ramp(size, size), &ramp(size, size), &coloured], 4).unwrap();
    write_png8(&dir.join("joined.png"), &joined).unwrap();
    let read = image::open(dir.join("joined.png")).unwrap().into_rgb8();
    assert_eq!(read.into_raw(), augnerf::draw::quantise(&joined.pixels));

    write_depth16(&dir.join("depth.png"), &depth, size, size, 8.0).unwrap();
    let read = image::open(dir.join("depth.png")).unwrap().into_luma16().into_raw();
    for (&value, &depth) in read.iter().zip(&depth) {
        let back = value as f32 / 65535.0 * 8.0;
        assert!(if depth.is_finite() { (back - depth).abs() < 1e-3 } else { value == 0 }, "{back} {depth}");
    }

    let frames: Vec<Image> = (0..12)
        .map(|i| depth_colour(&ball_depth(size, i as f32 * 0.05), size, size, near, far, None).unwrap())
        .collect();
    let mut reel = Reel::begin(&dir.join("video.gif"), (size, size), 24.0).unwrap();
    frames.iter().for_each(|frame| reel.add(frame).unwrap());
    reel.finish().unwrap();
    check_gif(&fs::read(dir.join("video.gif")).unwrap(), &frames);
}

fn check_gif(bytes: &[u8], frames: &[Image]) {
    let mut options = gif::DecodeOptions::new();
    options.set_color_output(gif::ColorOutput::RGBA);
    let mut decoder = options.read_info(bytes).unwrap();
    assert_eq!(decoder.repeat(), gif::Repeat::Infinite);
    let mut count = 0;
    while let Some(read) = decoder.read_next_frame().unwrap() {
        let expected = augnerf::draw::quantise(&frames[count].pixels);
        let close = |(read, expected): (&[u8], &[u8])| (0..3).all(|c| read[c].abs_diff(expected[c]) < 24);
        let pairs = read.buffer.chunks_exact(4).zip(expected.chunks_exact(3));
        let share = pairs.clone().filter(|&pair| close(pair)).count() as f64 / pairs.len() as f64;
        assert!(share > 0.98, "frame {count}: {share}");
        count += 1;
    }
    assert_eq!(count, frames.len());
}
