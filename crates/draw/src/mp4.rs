//! Videos as MP4 (H.264), which the program ffmpeg makes of their frames.

use std::io::ErrorKind;
use std::path::Path;
use std::process::{Command, Stdio};

/// Most characters that are quoted of what ffmpeg says.
const MOST_QUOTED: usize = 200;

/// Writes `NAME.mp4` next to its frames `NAME_000.png`, `NAME_001.png`, ..., as any browser plays it. An odd side
/// grows by a pixel.
///
/// # Errors
/// ffmpeg is not on the path, or fails. The sentence names no file, and a partial file is removed.
pub fn write_mp4(folder: &Path, name: &str, fps: f64) -> Result<(), String> {
    let (frames, rate, video) = (format!("{name}_%03d.png"), fps.to_string(), format!("{name}.mp4"));
    let mut ffmpeg = Command::new("ffmpeg");
    ffmpeg.current_dir(folder).stdin(Stdio::null()).args(["-nostdin", "-loglevel", "error", "-y"]);
    ffmpeg.args(["-framerate", &rate, "-i", &frames]);
    // 4:2:0 stores colour for two columns and two rows together.
    ffmpeg.args(["-vf", "scale=ceil(iw/2)*2:ceil(ih/2)*2"]);
    ffmpeg.args(["-c:v", "h264", "-crf", "17", "-pix_fmt", "yuv420p", "-movflags", "+faststart", &video]);
    let ended = ffmpeg.output().map_err(|error| match error.kind() {
        ErrorKind::NotFound => "to get MP4 as well, install ffmpeg and render again".to_string(),
        _ => format!("no MP4: ffmpeg does not start ({error})"),
    })?;
    if ended.status.success() {
        return Ok(());
    }
    let _ = std::fs::remove_file(folder.join(&video));
    let said = String::from_utf8_lossy(&ended.stderr);
    let last = said.lines().rfind(|line| !line.trim().is_empty()).map(str::trim);
    let quoted: String = last.map_or(ended.status.to_string(), |line| line.chars().take(MOST_QUOTED).collect());
    Err(format!("no MP4: ffmpeg failed ({quoted})"))
}
