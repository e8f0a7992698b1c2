//! GIFs that grow frame by frame. No frame stays in memory.

use std::fmt::Display;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::pictures::{on_paper, quantise, unwritable};
use crate::base::{Image, Result};

/// Sampling factor of the colour quantization: 1 is best and slowest, 30 worst.
const GIF_SPEED: i32 = 1;
/// Shortest frame of a GIF in hundredths of a second; viewers slow down shorter ones.
const GIF_SHORTEST: u64 = 2;

/// Returns how many hundredths of a second frame `index` is shown, from the rounded times of its start and end. If
/// `fps` does not divide 100, frames differ by one, so that the total length is right.
fn delay(index: usize, fps: f64) -> u16 {
    let start = |index: usize| (index as f64 * 100.0 / fps).round() as u64;
    let length = start(index + 1).saturating_sub(start(index));
    length.clamp(GIF_SHORTEST, u16::MAX as u64) as u16
}

/// A video as a GIF that repeats forever; each frame has its own 256 colours. A kill leaves a partial file, so write into
/// a folder that appears as a whole.
pub struct Reel {
    path: PathBuf,
    encoder: gif::Encoder<BufWriter<File>>,
    size: (u16, u16),
    fps: f64,
    count: usize,
    /// Frames and their times. As many as there are threads are quantized at once.
    waiting: Vec<(Vec<u8>, u16)>,
}

impl Reel {
    /// Starts a video of frames of `size` (width, height), at `fps` frames a second; a GIF shows at most 50.
    ///
    /// # Errors
    /// The rate is not positive; frames are too large for a GIF; the file cannot be written.
    pub fn begin(path: &Path, (width, height): (usize, usize), fps: f64) -> Result<Reel> {
        let failed = |reason: &dyn Display| unwritable(path, &reason.to_string());
        if !(fps.is_finite() && fps > 0.0) {
            return Err(failed(&format!("the frame rate is {fps}; it must be positive")));
        }
        let side =
            |length| u16::try_from(length).map_err(|_| failed(&format!("{length} pixels are too many for a GIF")));
        let size = (side(width)?, side(height)?);
        let writer = BufWriter::new(File::create(path).map_err(|error| failed(&error))?);
        let mut encoder = gif::Encoder::new(writer, size.0, size.1, &[]).map_err(|error| failed(&error))?;
        encoder.set_repeat(gif::Repeat::Infinite).map_err(|error| failed(&error))?;
        Ok(Reel { path: path.to_path_buf(), encoder, size, fps, count: 0, waiting: Vec::new() })
    }

    /// Adds the next frame.
    ///
    /// # Errors
    /// The file cannot be written.
    ///
    /// # Panics
    /// If the frame has another size.
    pub fn add(&mut self, frame: &Image) -> Result<()> {
        let (width, height) = self.size;
        assert_eq!((frame.width, frame.height), (width.into(), height.into()), "frames have one size");
        self.waiting.push((quantise(&on_paper(frame)), delay(self.count, self.fps)));
        self.count += 1;
        if self.waiting.len() < rayon::current_num_threads() { Ok(()) } else { self.write_waiting() }
    }

    fn write_waiting(&mut self) -> Result<()> {
        let (width, height) = self.size;
        let coloured = |(rgb, delay): (Vec<u8>, u16)| gif::Frame {
            delay,
            ..gif::Frame::from_rgb_speed(width, height, &rgb, GIF_SPEED)
        };
        let frames: Vec<gif::Frame> = std::mem::take(&mut self.waiting).into_par_iter().map(coloured).collect();
        let written = frames.iter().try_for_each(|frame| self.encoder.write_frame(frame));
        written.map_err(|error| unwritable(&self.path, &error.to_string()))
    }

    /// Writes the rest and closes the file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(mut self) -> Result<()> {
        self.write_waiting()?;
        let failed = |error: &dyn Display| unwritable(&self.path, &error.to_string());
        let mut writer = self.encoder.into_inner().map_err(|error| failed(&error))?;
        writer.flush().map_err(|error| failed(&error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frame_times_add_up() {
        let total: u64 = (0..48).map(|index| delay(index, 24.0) as u64).sum();
        assert_eq!(total, 200);
        assert_eq!(delay(0, 1000.0), 2);
        assert_eq!(delay(0, 1e-9), u16::MAX);
    }

    #[test]
    fn what_no_gif_shows_is_refused() {
        let refusal = |size, fps| Reel::begin(Path::new("never"), size, fps).err().unwrap().to_string();
        assert!(refusal((70_000, 1), 24.0).contains("too many") && refusal((1, 1), 0.0).contains("positive"));
    }
}
