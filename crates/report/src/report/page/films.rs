//! Videos and images of meshes in the page.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

/// A row's video, or the image of its mesh.
#[derive(Clone, Debug)]
pub struct Film {
    /// The row.
    pub(super) label: String,
    /// Seed of its point.
    pub(super) seed: u64,
    /// The file's name.
    pub(super) file: String,
    pub(super) data: String,
    pub(super) is_video: bool,
}

impl Film {
    /// Takes the bytes of an MP4, a GIF or a PNG, by the end of its name.
    pub fn new(label: &str, seed: u64, file: &str, bytes: &[u8]) -> Film {
        let is_video = file.ends_with(".mp4");
        let kind = match file.rsplit_once('.').map_or("", |(_, ending)| ending) {
            "mp4" => "video/mp4",
            "png" => "image/png",
            _ => "image/gif",
        };
        let data = format!("data:{kind};base64,{}", STANDARD.encode(bytes));
        Film { label: label.into(), seed, file: file.into(), data, is_video }
    }
}
