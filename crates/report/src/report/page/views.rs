//! One held-out view of each scene, as JPEG in the page.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use crate::base::{Image, Result};
use crate::data::resample::shrink;
use crate::draw::{depth_colour, depth_range, encode_jpeg, pixel_errors, scale_colour, stripe};
use crate::metrics::unmasked_or;

/// Limit on the bytes of all images in a page, as base64.
const MOST_BYTES: usize = 3 << 20;
/// Longest side and JPEG quality of images, tried in turn until all fit.
const SIZES: [(usize, u8); 4] = [(640, 88), (480, 82), (320, 78), (200, 74)];

/// The note of the section on its images.
pub const NOTE: &str = "Error: root of the mean squared difference of a pixel's three 8-bit colours to the ground truth. Error and depth \
     have one scale for all rows of a scene, whose ends are the outermost 2 % of values; near is bright. Grey: nothing there. \
     The pictures are JPEG, made smaller where all of them would take more than 3 MiB.";
/// The note of a masked view.
const MASKED: &str = "stripes of the ground truth: masked pixels, which have no error";

/// One row's rendering of the view.
#[derive(Clone, Debug)]
pub struct ViewOfRow {
    /// The row.
    pub label: String,
    /// Seed of its first point.
    pub seed: u64,
    /// The rendering.
    pub image: Image,
    /// Depth; NaN where nothing is solid.
    pub depth: Vec<f32>,
}

/// A view and its renderings by rows, images of one size.
#[derive(Clone, Debug)]
pub struct ViewOfScene {
    /// The scene.
    pub scene: String,
    /// The view's name.
    pub view: String,
    /// The photo.
    pub truth: Image,
    /// Which of its pixels count, row by row. `None` if all do.
    pub mask: Option<Vec<bool>>,
    /// The rows.
    pub rows: Vec<ViewOfRow>,
    /// Rows that are not shown, with reasons: `2 rows have no picture of it`.
    pub left_out: Vec<String>,
}

/// The images of a view as `data:` addresses.
#[derive(Clone, Debug)]
pub struct ShownScene {
    pub(super) scene: String,
    pub(super) view: String,
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) truth: String,
    pub(super) rows: Vec<ShownRow>,
    pub(super) note: String,
}

#[derive(Clone, Debug)]
pub(super) struct ShownRow {
    pub label: String,
    pub seed: u64,
    pub image: String,
    pub error: String,
    pub depth: String,
}

impl ShownRow {
    fn bytes(&self) -> usize {
        self.image.len() + self.error.len() + self.depth.len()
    }
}

impl ShownScene {
    /// Encodes a scene's images within its share of the page, one of `scenes`.
    pub fn new(view: &ViewOfScene, scenes: usize) -> Result<ShownScene> {
        let room = MOST_BYTES / scenes.max(1);
        for (side, quality) in SIZES {
            let shown = ShownScene::at(view, side, quality)?;
            if shown.bytes() <= room {
                return Ok(shown);
            }
        }
        let (side, quality) = SIZES[SIZES.len() - 1];
        let mut shown = ShownScene::at(view, side, quality)?;
        let all = shown.rows.len();
        while shown.bytes() > room && shown.rows.pop().is_some() {}
        let text = format!(
            "{} rows of {all} are left out: all pictures would take more than the page's",
            all - shown.rows.len()
        );
        shown.note = [shown.note, text].into_iter().filter(|text| !text.is_empty()).collect::<Vec<String>>().join("; ");
        Ok(shown)
    }

    fn bytes(&self) -> usize {
        self.truth.len() + self.rows.iter().map(ShownRow::bytes).sum::<usize>()
    }

    fn at(view: &ViewOfScene, side: usize, quality: u8) -> Result<ShownScene> {
        let Image { width, height, .. } = view.truth;
        let scale = (side as f64 / width.max(height) as f64).min(1.0);
        let size = |length: usize| ((length as f64 * scale).round() as usize).clamp(1, length);
        let encode = |picture: &Image| -> Result<String> {
            let small = shrink(picture, size(width), size(height));
            Ok(format!("data:image/jpeg;base64,{}", STANDARD.encode(encode_jpeg(&small, quality)?)))
        };
        let (mask, mut truth) = (view.mask.as_deref(), view.truth.clone());
        // Masked pixels have no error, as in a comparison.
        let counted = |row: &ViewOfRow| unmasked_or(row.image.clone(), &view.truth, mask);
        let errors: Vec<Vec<f32>> = view.rows.iter().map(|row| pixel_errors(&counted(row), &view.truth)).collect();
        let every_error: Vec<f32> = errors.iter().flatten().copied().collect();
        // If all pixels equal the ground truth, the scale still needs a length.
        let top = depth_range(&every_error, None).map_or(1.0, |(_, top)| top).max(1.0 / 255.0);
        let depths: Vec<f32> = view.rows.iter().flat_map(|row| row.depth.iter().copied()).collect();
        let (near, far) = depth_range(&depths, None).unwrap_or((0.0, 1.0));
        let shown = |(row, errors): (&ViewOfRow, Vec<f32>)| -> Result<ShownRow> {
            let pixels = errors.iter().flat_map(|error| scale_colour(error / top)).collect();
            Ok(ShownRow {
                label: row.label.clone(),
                seed: row.seed,
                image: encode(&row.image)?,
                error: encode(&Image { width, height, channels: 3, pixels })?,
                depth: encode(&depth_colour(&row.depth, width, height, near, far, None)?)?,
            })
        };
        mask.iter().for_each(|mask| stripe(&mut truth, mask));
        let left_out = view.left_out.iter().map(String::as_str);
        let notes: Vec<&str> = mask.map(|_| MASKED).into_iter().chain(left_out).collect();
        Ok(ShownScene {
            scene: view.scene.clone(),
            view: view.view.clone(),
            width: size(width),
            height: size(height),
            truth: encode(&truth)?,
            rows: view.rows.iter().zip(errors).map(shown).collect::<Result<_>>()?,
            note: notes.join("; "),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(seed: u32, side: usize) -> Image {
        let value =
            |i: usize| ((i as u32).wrapping_mul(2_654_435_761).wrapping_add(seed * 97) >> 8) as f32 / 16_777_216.0;
        Image { width: side, height: side, channels: 3, pixels: (0..side * side * 3).map(value).collect() }
    }

    #[test]
    fn pictures_take_their_share_and_what_is_left_out_is_said() {
        let row = |seed: u32| ViewOfRow {
            label: format!("row {seed}"),
            seed: 0,
            image: noise(seed, 700),
            depth: vec![1.0; 700 * 700],
        };
        let view = |rows: u32| ViewOfScene {
            scene: "fern".into(),
            view: "image000".into(),
            truth: noise(0, 700),
            mask: None,
            rows: (1..=rows).map(row).collect(),
            left_out: vec![],
        };
        let one = ShownScene::new(&view(1), 1).unwrap();
        assert_eq!((one.width, one.height, one.note.as_str()), (640, 640, ""));
        let shared = ShownScene::new(&view(2), 4).unwrap();
        assert!(shared.width < 640 && shared.bytes() <= MOST_BYTES / 4 && shared.rows.len() == 2, "{}", shared.width);
        let many = ShownScene::new(&view(3), 100).unwrap();
        assert!(
            many.bytes() <= MOST_BYTES / 100 && many.rows.len() < 3 && many.note.contains("left out"),
            "{}",
            many.note
        );
    }

    /// What is masked can be anything: errors and their scale stay.
    #[test]
    fn masked_pixels_have_no_error_and_stripes() {
        let truth = noise(0, 16);
        let rendered = Image { pixels: truth.pixels.iter().rev().copied().collect(), ..truth };
        let mask: Vec<bool> = (0..256).map(|pixel| pixel % 16 < 10).collect();
        let mut other = rendered.clone();
        let masked = other.pixels.chunks_exact_mut(3).zip(&mask).filter(|(_, counts)| !**counts);
        masked.for_each(|(texel, _)| texel.fill(0.0));
        let shown = |image: &Image, mask: Option<&[bool]>| {
            let row = ViewOfRow { label: "row".into(), seed: 0, image: image.clone(), depth: vec![1.0; 256] };
            let view = ViewOfScene {
                scene: "fern".into(),
                view: "image000".into(),
                truth: truth.clone(),
                mask: mask.map(<[bool]>::to_vec),
                rows: vec![row],
                left_out: vec!["left out".into()],
            };
            ShownScene::new(&view, 1).unwrap()
        };
        let (a, b) = (shown(&rendered, Some(&mask)), shown(&other, Some(&mask)));
        assert!(a.rows[0].image != b.rows[0].image && a.rows[0].error == b.rows[0].error);
        assert_eq!(a.note, format!("{MASKED}; left out"));
        let plain = shown(&other, None);
        assert!(plain.rows[0].error != b.rows[0].error && plain.truth != b.truth);
        assert_eq!(plain.note, "left out");
        // A mask that leaves all changes no picture.
        let all = shown(&other, Some(&[true; 256]));
        assert!(all.truth == plain.truth && all.rows[0].error == plain.rows[0].error);
    }
}
