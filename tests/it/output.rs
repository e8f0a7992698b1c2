//! Videos as other programs read them.

use std::fs;

use augnerf::base::Image;
use augnerf::draw::{Reel, depth_colour, depth_range};

/// A slope of depths with nothing in its first rows.
fn depths(size: usize, shift: usize) -> Vec<f32> {
    let depth = |i: usize| if i < 9 * size { f32::INFINITY } else { 4.0 + ((i + shift) % size) as f32 / size as f32 };
    (0..size * size).map(depth).collect()
}

#[test]
fn a_video_reads_back() {
    let folder = tempfile::tempdir().unwrap();
    let (size, file) = (160, folder.path().join("video.gif"));
    let (near, far) = depth_range(&depths(size, 0), None).unwrap();
    let frame = |i| depth_colour(&depths(size, i), size, size, near, far, None).unwrap();
    let frames: Vec<Image> = (0..12).map(frame).collect();
    let mut reel = Reel::begin(&file, (size, size), 24.0).unwrap();
    frames.iter().for_each(|frame| reel.add(frame).unwrap());
    reel.finish().unwrap();
    let mut options = gif::DecodeOptions::new();
    options.set_color_output(gif::ColorOutput::RGBA);
    let mut decoder = options.read_info(fs::File::open(file).unwrap()).unwrap();
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
