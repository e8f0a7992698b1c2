//! The output side through its public interface: refusals, what a kill leaves, files that other
//! programs read.

use std::fs;
use std::path::Path;

use augnerf::base::Image;
use augnerf::base::files::{AtomicDir, clean_temporaries, write_atomic, write_named};
use augnerf::draw::{Reel, beside, depth_colour, depth_range, write_depth16, write_png8};
use augnerf::run::{Existing, RunDir, Scalars};

fn finished_run(path: &Path) {
    let run = RunDir::create(path, Existing::Refuse, 0).unwrap();
    write_atomic(&run.config(), b"seed = 1\n").unwrap();
    fs::write(run.checkpoints().join("weights"), "w").unwrap();
}

#[test]
fn an_existing_run_is_refused_unless_it_may_be_overwritten() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("run");
    finished_run(&path);
    fs::write(path.join("notes.txt"), "mine").unwrap();
    let error = RunDir::create(&path, Existing::Refuse, 0).unwrap_err();
    assert_eq!(error.exit_code(), 4);
    for part in [path.to_str().unwrap(), "--overwrite", "augnerf resume"] {
        assert!(error.to_string().contains(part), "{error}");
    }
    assert!(path.join("config.toml").exists());
    let run = RunDir::create(&path, Existing::Replace, 0).unwrap();
    assert!(!run.config().exists() && !run.checkpoints().join("weights").exists());
    assert_eq!(fs::read_to_string(path.join("notes.txt")).unwrap(), "mine");
}

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
fn a_file_in_the_way_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("file");
    fs::write(&file, "keep").unwrap();
    for path in [file.clone(), file.join("below/run")] {
        let error = RunDir::create(&path, Existing::Replace, 0).unwrap_err();
        assert_eq!(error.exit_code(), 4);
        assert!(error.to_string().contains("file"), "{error}");
    }
    assert_eq!(fs::read_to_string(&file).unwrap(), "keep");
}

#[test]
fn only_a_run_is_opened() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("file"), "").unwrap();
    for path in [dir.path().to_path_buf(), dir.path().join("missing"), dir.path().join("file")] {
        let error = RunDir::open(&path).unwrap_err();
        assert_eq!(error.exit_code(), 5);
        assert!(error.to_string().contains(path.to_str().unwrap()), "{error}");
    }
    finished_run(&dir.path().join("run"));
    assert!(RunDir::open(&dir.path().join("run")).is_ok());
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

#[test]
fn a_kill_while_a_checkpoint_is_written_leaves_the_last_one() {
    let dir = tempfile::tempdir().unwrap();
    finished_run(&dir.path().join("run"));
    let run = RunDir::open(&dir.path().join("run")).unwrap();
    let target = run.checkpoints().join("step-000010");
    let whole = AtomicDir::new(&target).unwrap();
    fs::write(whole.path().join("weights"), "ten").unwrap();
    whole.commit().unwrap();
    // A kill runs no destructor, and gives up the lock.
    let killed = AtomicDir::new(&run.checkpoints().join("step-000020")).unwrap();
    let left = run.checkpoints().join(killed.path().file_name().unwrap());
    drop(killed);
    fs::create_dir(&left).unwrap();
    fs::write(left.join("weights"), "twe").unwrap();
    assert!(!run.checkpoints().join("step-000020").exists());
    assert_eq!(clean_temporaries(&run.checkpoints()).unwrap(), 1);
    assert_eq!(fs::read_to_string(target.join("weights")).unwrap(), "ten");
    assert_eq!(clean_temporaries(&run.checkpoints()).unwrap(), 0);
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
