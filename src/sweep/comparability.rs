//! What must be equal for rows to stand in one table.

use super::definition::Definition;
use super::points::Point;
use crate::report::TableSpec;
use crate::settings::{CorruptionConfig, DataConfig};

impl Definition {
    /// What tables and plots of these points need to know.
    pub fn table(&self, name: &str, points: &[Point]) -> TableSpec {
        TableSpec {
            name: name.to_string(),
            title: self.title.clone(),
            metrics: self.metrics.clone(),
            rows: self.rows(),
            must_match: must_match(points),
        }
    }
}

/// Protocol fields that must be equal in all rows of a scene: all of the evaluation, but for those
/// that the points differ in by definition.
fn must_match(points: &[Point]) -> Vec<String> {
    let always = ["protocol", "program", "code_revision", "device", "dataset", "scene", "mesh"];
    let varies = |setting: fn(&DataConfig) -> String| {
        points.iter().any(|point| {
            let first = points.iter().find(|first| first.scene == point.scene).expect("the point itself");
            setting(&first.config.data) != setting(&point.config.data)
        })
    };
    // What of the evaluation hangs on which setting; `data_hash` on all of them.
    let size = varies(|data| format!("{:?} {}", data.downscale, data.width));
    let views = varies(|data| format!("{} {} {:?}", data.holdout, data.test_skip, data.eval_split));
    let background = varies(|data| format!("{:?}", data.background));
    let ndc = varies(|data| data.ndc.to_string());
    let pixel_origin = varies(|data| format!("{:?}", data.pixel_origin));
    let corruption = varies(|data| format!("{:?}", data.corruption));
    let data = varies(|data| {
        let read = DataConfig { dir: String::new(), corruption: CorruptionConfig::default(), ..data.clone() };
        toml::to_string(&read).expect("plain data")
    });
    let of_settings = [
        (size, &["width", "height"][..]),
        (views, &["split", "views_trained", "views_evaluated"]),
        (background, &["background"]),
        (ndc, &["ndc"]),
        (pixel_origin, &["pixel_origin"]),
        (corruption, &["corruption"]),
        (data, &["data_hash"]),
    ];
    let controlled = of_settings.into_iter().filter(|(varies, _)| !varies).flat_map(|(_, fields)| fields);
    always.iter().chain(controlled).map(|field| field.to_string()).collect()
}
