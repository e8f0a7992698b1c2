//! The paper's numbers, and what is known about their measurement.

use serde::Deserialize;

use crate::data::epochs;
use crate::metrics::{PSNR, SSIM};
use crate::report::{PublishedKey, Record};

/// What the paper states, and does not state, about the protocol of its tables.
pub const PUBLISHED_NOTE: &str = "\
The paper's SRN, LLFF, NV and NeRF rows of tables 1 and 2 and the NeRF row of table 4 are quoted from the NeRF paper, \
which scored SRN at 504x376 (LLFF) and 512x512 (Blender), the others at 1008x752 and 800x800; the paper's own runs are \
at 504x378 and 400x400, 500000 steps, width 256. SRN's SSIM on orchids is that of fern (0.611), and the average made of \
it; the NeRF paper has 0.449. \
In table A1 the NeRF row of width 128 equals the quoted one of width 256. The paper gives no seeds, no samples a ray \
and no rays a step (its released code does), no LPIPS backbone and no severity of its noises: its numbers stand beside \
ours and are not subtracted.";

/// One row of the paper's tables, and how its numbers were measured as far as known.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct PublishedRow {
    /// `tab1`, ...
    pub table: String,
    /// `llff` or `blender`.
    pub dataset: String,
    /// The scene's name.
    pub scene: String,
    /// `clean`, or the change of the training views or the network.
    pub condition: String,
    /// The method as the paper names it.
    pub method: String,
    /// PSNR in dB.
    pub psnr: f64,
    /// SSIM.
    pub ssim: f64,
    /// LPIPS of an unnamed backbone.
    pub lpips: f64,
    /// Geometric mean of the three as errors; see [`crate::metrics::average`].
    pub average: f64,
    /// The source of the numbers.
    pub source: String,
    /// Width of the evaluated views in pixels.
    pub width: usize,
    /// Height of the evaluated views in pixels. SRN's are half as high as the other quoted ones, because of its memory.
    pub height: usize,
    /// Number of weight updates.
    pub steps: Option<u64>,
    /// Width of the trunk.
    pub field_width: Option<usize>,
    /// Number of layers of the trunk. The paper has the "same MLP architecture" as NeRF.
    pub field_depth: Option<usize>,
    /// Coarse samples of a ray.
    pub samples_coarse: Option<usize>,
    /// Fine samples of a ray.
    pub samples_fine: Option<usize>,
    /// Rays of a step.
    pub rays: Option<usize>,
    /// Number of training views. LLFF was not trained on any of them.
    pub views_trained: Option<usize>,
    /// Number of evaluated views: every eighth of an LLFF scene. Of a Blender scene's 200 test views the NeRF paper takes all,
    /// the released code every eighth.
    pub views_evaluated: Option<usize>,
    /// Samples and rays come from the paper's released code, since the paper gives none. There is none of MipNeRF.
    pub by_released_code: bool,
    /// So does the number of evaluated views, which the paper gives for LLFF scenes alone.
    pub evaluated_by_released_code: bool,
    /// A known error of the numbers, or what else is to be known; empty otherwise.
    pub remark: String,
}

/// Returns every row of the paper's tables, in order.
pub fn published_rows() -> Vec<PublishedRow> {
    let mut reader = csv::Reader::from_reader(include_str!("published.csv").as_bytes());
    reader.deserialize().map(|row| row.expect("the copy in this program is whole")).collect()
}

impl PublishedKey {
    /// Returns whether a row of the paper's tables has this table, condition and method.
    pub fn names(&self, row: &PublishedRow) -> bool {
        (&self.table, &self.condition, &self.method) == (&row.table, &row.condition, &row.method)
    }

    /// Returns an error if the paper's tables have no such row.
    pub fn check(&self) -> std::result::Result<(), String> {
        if published_rows().iter().any(|row| self.names(row)) {
            return Ok(());
        }
        Err(format!(
            "the paper has no row '{}' in {} under condition {}: add `ours = true`, or name its row there with \
             `published`",
            self.method, self.table, self.condition
        ))
    }

    /// Returns the paper's row for a scene, or `None` if the paper does not have the scene.
    pub fn find(&self, scene: &str) -> Option<PublishedRow> {
        published_rows().into_iter().find(|row| self.names(row) && row.scene == scene)
    }
}

impl PublishedRow {
    /// Returns the number for one of our metrics. LPIPS and the average have none: the paper does not name its
    /// backbone, and numbers of different backbones do not compare.
    pub fn metric(&self, name: &str) -> Option<f64> {
        let numbers = [(PSNR.key, self.psnr), (SSIM.key, self.ssim)];
        numbers.into_iter().find(|(key, _)| *key == name).map(|(_, number)| number)
    }

    /// Returns how often a training pixel was seen: 158 times on fern, 32 times on the chair.
    pub fn epochs(&self) -> Option<f64> {
        epochs(self.steps? as f64 * self.rays? as f64, self.width * self.height * self.views_trained?)
    }

    /// Returns the coarse and fine samples of a ray: `64 + 128`.
    fn samples(&self) -> Option<String> {
        Some(format!("{} + {}", self.samples_coarse?, self.samples_fine?))
    }

    /// Returns everything that is known of the measurement, for readers.
    pub fn protocol(&self) -> String {
        let in_code = |is_of_code| if is_of_code { " in the released code" } else { "" };
        let (code, its) = (in_code(self.by_released_code), in_code(self.evaluated_by_released_code));
        let known = [
            self.steps.map(|steps| format!(", {steps} steps")),
            self.field_width.map(|width| format!(", width {width}")),
            self.field_depth.map(|depth| format!(", {depth} layers")),
            self.samples().map(|samples| format!(", {samples} samples{code}")),
            self.rays.map(|rays| format!(", {rays} rays a step{code}")),
            self.views_trained.map(|trained| format!(", {trained} views trained on")),
            self.views_evaluated.map(|evaluated| format!(" and {evaluated} evaluated{its}")),
        ];
        let known: String = known.into_iter().flatten().collect();
        let remark = if self.remark.is_empty() { String::new() } else { format!("; {}", self.remark) };
        format!("{}, {}x{}{known}{remark}", self.source, self.width, self.height)
    }

    /// Returns the known differences of a measured point: `101x76 instead of 504x378, steps 2000 instead of 500000`;
    /// empty if there are none. Values that either lacks are skipped.
    pub fn difference(&self, record: &Record) -> String {
        let both = |names: [&str; 2], between: &str| match names.map(|name| record.protocol(name)) {
            ["", _] | [_, ""] => String::new(),
            [first, second] => format!("{first}{between}{second}"),
        };
        let (size, samples) = (both(["width", "height"], "x"), both(["samples_coarse", "samples_fine"], " + "));
        let number = |name| record.protocol(name).to_string();
        let of_code = |is_of_code| if is_of_code { " of the released code" } else { "" };
        let (code, its) = (of_code(self.by_released_code), of_code(self.evaluated_by_released_code));
        let text = |number: Option<usize>| number.map(|number| number.to_string());
        let pairs = [
            ("", size, Some(format!("{}x{}", self.width, self.height)), ""),
            ("steps ", number("steps"), self.steps.map(|steps| steps.to_string()), ""),
            ("field_width ", number("field_width"), text(self.field_width), ""),
            ("field_depth ", number("field_depth"), text(self.field_depth), ""),
            ("samples ", samples, self.samples(), code),
            ("rays ", number("rays"), text(self.rays), code),
            ("views_trained ", number("views_trained"), text(self.views_trained), ""),
            ("views_evaluated ", number("views_evaluated"), text(self.views_evaluated), its),
        ];
        let differing = pairs.into_iter().filter_map(|(name, ours, theirs, whose)| {
            let theirs = theirs.filter(|theirs| !ours.is_empty() && *theirs != ours)?;
            Some(format!("{name}{ours} instead of {theirs}{whose}"))
        });
        differing.collect::<Vec<String>>().join(", ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::Status;

    fn find(table: &str, condition: &str, method: &str, scene: &str) -> Option<PublishedRow> {
        let key = PublishedKey { table: table.into(), condition: condition.into(), method: method.into() };
        key.find(scene)
    }

    fn text(table: &str, condition: &str, method: &str, scene: &str) -> String {
        find(table, condition, method, scene).unwrap().protocol()
    }

    #[test]
    fn rows_are_found_by_key_and_scene() {
        assert_eq!(published_rows().len(), 57);
        let row = find("tab4", "clean", "+ Feature & (Pre-) Output Aug.", "fern").unwrap();
        assert_eq!((row.psnr, row.ssim, row.lpips, row.average), (26.32, 0.810, 0.199, 0.059));
        assert_eq!((row.metric("psnr"), row.metric("ssim"), row.metric("psnr_float")), (Some(26.32), Some(0.81), None));
        // The paper does not name the backbone.
        assert_eq!((row.metric("lpips_vgg"), row.metric("average_squeeze")), (None, None));
        assert_eq!(find("tab4", "clean", "NeRF", "chair"), None);
    }

    #[test]
    fn the_paper_saw_its_pixels_often() {
        let seen = |table, method, scene| find(table, "clean", method, scene).unwrap().epochs();
        assert_eq!(seen("tab4", "Aug-NeRF", "fern").map(f64::round), Some(158.0));
        assert_eq!(seen("tab2", "Aug-NeRF", "chair"), Some(32.0));
        // The NeRF paper's steps and MipNeRF's rays are not stated.
        assert_eq!((seen("tab4", "NeRF", "fern"), seen("tab1", "MipNeRF", "fern")), (None, None));
    }

    #[test]
    fn quoted_rows_say_so() {
        let fern = ", 17 views trained on and 3 evaluated";
        let blender = ", 100 views trained on and 200 evaluated";
        let quoted = "quoted from the NeRF paper, 1008x752, width 256, 8 layers, 64 + 128 samples, 4096 rays a step";
        assert_eq!(text("tab4", "clean", "NeRF", "fern"), format!("{quoted}{fern}"));
        let elsewhere = "; one network trained on other scenes, whose inputs are this scene's training views";
        assert_eq!(text("tab1", "clean", "LLFF", "fern"), format!("quoted from the NeRF paper, 1008x752{elsewhere}"));
        assert_eq!(text("tab1", "clean", "SRN", "fern"), format!("quoted from the NeRF paper, 504x376{fern}"));
        assert_eq!(text("tab2", "clean", "SRN", "drums"), format!("quoted from the NeRF paper, 512x512{blender}"));
        assert_eq!(text("tab2", "clean", "NV", "chair"), format!("quoted from the NeRF paper, 800x800{blender}"));
        let code = "in the released code";
        let released = format!(", 100 views trained on and 25 evaluated {code}");
        let own = |size: &str, width: usize, fine: usize, views: &str| {
            format!(
                "the paper's own run, {size}, 500000 steps, width {width}, 8 layers, 64 + {fine} samples {code}, 1024 \
                 rays a step {code}{views}"
            )
        };
        assert_eq!(text("tab4", "clean", "Aug-NeRF", "fern"), own("504x378", 256, 64, fern));
        assert_eq!(text("tabA2", "pepper_noise", "NeRF", "fern"), own("504x378", 256, 64, fern));
        assert_eq!(text("tabA1", "width_128_full_res", "NeRF", "chair"), own("800x800", 128, 128, &released));
        assert_eq!(text("tabA1", "width_512_half_res", "Aug-NeRF", "chair"), own("400x400", 512, 128, &released));
        let mip = "the paper's own run, 504x378, 500000 steps, width 256, 8 layers";
        assert_eq!(text("tab1", "clean", "MipNeRF", "fern"), format!("{mip}{fern}"));
        // No released code says how many it evaluates.
        assert!(text("tab2", "clean", "MipNeRF", "chair").ends_with(", 100 views trained on"));
    }

    /// The paper prints fern's SSIM for SRN on orchids; the number is kept and has a remark.
    #[test]
    fn a_number_that_is_another_scene_s_says_so() {
        let srn = |scene| find("tab1", "clean", "SRN", scene).unwrap();
        assert_eq!(srn("orchids").ssim, srn("fern").ssim);
        assert!(
            text("tab1", "clean", "SRN", "orchids")
                .ends_with("4 evaluated; its SSIM is that of fern, the NeRF paper has 0.449")
        );
        let remarked = |row: &&PublishedRow| row.method != "LLFF" && !row.remark.is_empty();
        assert_eq!(published_rows().iter().filter(remarked).count(), 1);
        assert!(PUBLISHED_NOTE.contains("0.449") && !PUBLISHED_NOTE.contains("1008x756"));
    }

    #[test]
    fn differences_name_what_is_known_to_differ() {
        let mut record = Record {
            scene: "fern".into(),
            row: "Aug-NeRF".into(),
            seed: Some(0),
            status: Status::Done,
            ..Record::default()
        };
        let mut set = |fields: &[(&str, &str)]| {
            record.result.protocol = fields.iter().map(|(name, text)| (name.to_string(), text.to_string())).collect();
            record.clone()
        };
        let record = set(&[("width", "101"), ("height", "76"), ("steps", "500000"), ("field_width", "64")]);
        let own = find("tab4", "clean", "Aug-NeRF", "fern").unwrap();
        assert_eq!(own.difference(&record), "101x76 instead of 504x378, field_width 64 instead of 256");
        let quoted = find("tab1", "clean", "SRN", "fern").unwrap();
        assert_eq!(quoted.difference(&record), "101x76 instead of 504x376");
        // Everything that a point states and that the papers or the code state too.
        let small = [("field_depth", "4"), ("samples_coarse", "32"), ("samples_fine", "16"), ("rays", "512")];
        let record = set(&[&small[..], &[("views_trained", "8"), ("views_evaluated", "2")]].concat());
        let (depth, views) =
            ("field_depth 4 instead of 8", "views_trained 8 instead of 17, views_evaluated 2 instead of 3");
        let code =
            "samples 32 + 16 instead of 64 + 64 of the released code, rays 512 instead of 1024 of the released code";
        assert_eq!(own.difference(&record), format!("{depth}, {code}, {views}"));
        let nerf = find("tab4", "clean", "NeRF", "fern").unwrap();
        let paper = "samples 32 + 16 instead of 64 + 128, rays 512 instead of 4096";
        assert_eq!(nerf.difference(&record), format!("{depth}, {paper}, {views}"));
        assert_eq!(quoted.difference(&record), views);
        let chair = find("tab2", "clean", "Aug-NeRF", "chair").unwrap().difference(&record);
        assert!(chair.ends_with("views_evaluated 2 instead of 25 of the released code"), "{chair}");
    }
}
