//! GIFs that grow frame by frame. No frame stays in memory.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::pictures::{check, on_paper, quantise, unwritable};
use crate::base::{Image, Result};

/// Sampling factor of the colour quantization: 1 is best and slowest, 30 worst.
const GIF_SPEED: i32 = 1;
/// Shortest frame of a GIF in hundredths of a second; viewers slow down shorter ones.
const GIF_SHORTEST: u64 = 2;

/// The result of encoding; the error lacks the file's name.
type Encoded<T> = std::result::Result<T, String>;

/// A GIF that repeats forever; each frame has its own 256 colours.
struct Gif<W: Write> {
    encoder: gif::Encoder<W>,
    size: (u16, u16),
    /// Frames and their times. As many as there are threads are quantized at once.
    waiting: Vec<(Vec<u8>, u16)>,
}

impl<W: Write> Gif<W> {
    fn begin(writer: W, (width, height): (usize, usize)) -> Encoded<Gif<W>> {
        let side = |length: usize| u16::try_from(length).map_err(|_| format!("{length} pixels are too many for a GIF"));
        let size = (side(width)?, side(height)?);
        let encoder = gif::Encoder::new(writer, size.0, size.1, &[]);
        let mut encoder = encoder.map_err(|error| error.to_string())?;
        encoder.set_repeat(gif::Repeat::Infinite).map_err(|error| error.to_string())?;
        Ok(Gif { encoder, size, waiting: Vec::new() })
    }

    /// Adds a frame that is shown for `delay` hundredths of a second.
    fn add(&mut self, frame: &Image, delay: u16) -> Encoded<()> {
        check(frame)?;
        let (width, height) = self.size;
        if (frame.width, frame.height) != (width.into(), height.into()) {
            let (w, h) = (frame.width, frame.height);
            return Err(format!("a frame has {w}x{h} pixels, but the first has {width}x{height}"));
        }
        self.waiting.push((quantise(&on_paper(frame)), delay));
        if self.waiting.len() < rayon::current_num_threads() { Ok(()) } else { self.write_waiting() }
    }

    fn write_waiting(&mut self) -> Encoded<()> {
        let (width, height) = self.size;
        let coloured = |(rgb, delay): (Vec<u8>, u16)| gif::Frame {
            delay,
            ..gif::Frame::from_rgb_speed(width, height, &rgb, GIF_SPEED)
        };
        let frames: Vec<gif::Frame> = std::mem::take(&mut self.waiting).into_par_iter().map(coloured).collect();
        frames.iter().try_for_each(|frame| self.encoder.write_frame(frame)).map_err(|error| error.to_string())
    }

    fn finish(mut self) -> Encoded<W> {
        self.write_waiting()?;
        self.encoder.into_inner().map_err(|error| error.to_string())
    }
}

/// Returns how many hundredths of a second frame `index` is shown, from the rounded times of its start and end. If
/// `fps` does not divide 100, frames differ by one, so that the total length is right.
fn delay(index: usize, fps: f64) -> u16 {
    let start = |index: usize| (index as f64 * 100.0 / fps).round() as u64;
    let length = start(index + 1).saturating_sub(start(index));
    length.clamp(GIF_SHORTEST, u16::MAX as u64) as u16
}

/// A video as a GIF. A kill leaves a partial file, so write into a folder that appears as a whole.
pub struct Reel {
    path: PathBuf,
    gif: Gif<BufWriter<File>>,
    fps: f64,
    count: usize,
}

impl Reel {
    /// Starts a video of frames of `size` (width, height), at `fps` frames a second; a GIF shows at most 50.
    ///
    /// # Errors
    /// The rate is not positive; frames are too large for a GIF; the file cannot be written.
    pub fn begin(path: &Path, size: (usize, usize), fps: f64) -> Result<Reel> {
        if !(fps.is_finite() && fps > 0.0) {
            return Err(unwritable(path, &format!("the frame rate is {fps}; it must be positive")));
        }
        let writer = File::create(path).map_err(|error| unwritable(path, &error.to_string()))?;
        let gif = Gif::begin(BufWriter::new(writer), size).map_err(|reason| unwritable(path, &reason))?;
        Ok(Reel { path: path.to_path_buf(), gif, fps, count: 0 })
    }

    /// Adds the next frame.
    ///
    /// # Errors
    /// The frame has another size; the file cannot be written.
    pub fn add(&mut self, frame: &Image) -> Result<()> {
        let delay = delay(self.count, self.fps);
        self.gif.add(frame, delay).map_err(|reason| unwritable(&self.path, &reason))?;
        self.count += 1;
        Ok(())
    }

    /// Writes the rest and closes the file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(self) -> Result<()> {
        let mut writer = self.gif.finish().map_err(|reason| unwritable(&self.path, &reason))?;
        writer.flush().map_err(|error| unwritable(&self.path, &error.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plain(width: usize, height: usize) -> Image {
        Image { width, height, channels: 3, pixels: vec![0.0; 3 * width * height] }
    }

    /// Encodes frames, each with its own time in hundredths of a second.
    fn timed_gif(frames: &[Image], delays: &[u16]) -> Encoded<Vec<u8>> {
        let first = frames.first().ok_or("no frames")?;
        let mut gif = Gif::begin(Vec::new(), (first.width, first.height))?;
        frames.iter().zip(delays).try_for_each(|(frame, &delay)| gif.add(frame, delay))?;
        gif.finish()
    }

    #[test]
    fn frame_times_add_up() {
        let total: u64 = (0..48).map(|index| delay(index, 24.0) as u64).sum();
        assert_eq!(total, 200);
        assert_eq!(delay(0, 1000.0), 2);
        assert_eq!(delay(0, 1e-9), u16::MAX);
    }

    #[test]
    fn bad_frames_are_errors() {
        let small = plain(1, 1);
        assert!(timed_gif(&[], &[]).is_err());
        assert!(timed_gif(&[small.clone(), plain(2, 1)], &[10, 10]).unwrap_err().contains("2x1"));
        assert!(timed_gif(&[plain(70_000, 1)], &[10]).unwrap_err().contains("too many"));
        assert!(Reel::begin(Path::new("never"), (1, 1), 0.0).is_err());
    }
}
