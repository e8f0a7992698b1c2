//! A scene in words, for `data check`.

use super::{Camera, Rig, Scene, View, pose};
use augnerf_base::first_names;

/// Factor between the bounds above which samples that are even in depth are too sparse near the camera.
const WIDE: f64 = 20.0;
/// Largest number of view names that are printed.
const NAMES: usize = 6;

impl Scene {
    /// Returns label and value of everything that a user should check before training.
    pub fn describe(&self) -> Vec<(String, String)> {
        let mut rows: Vec<(String, String)> = Vec::new();
        let mut row = |label: &str, value: String| rows.push((label.into(), value));
        row("scene", self.name.clone());
        row("kind", self.kind.into());
        row("training views", names(&self.train));
        row("held-out views", names(&self.test));
        if let Some(view) = self.train.first() {
            let Camera { width, height, focal, centre, .. } = view.camera;
            row("resolution", format!("{width} x {height} pixels"));
            row("focal length", format!("{:.3} x {:.3} pixels (first view)", focal[0], focal[1]));
            row("principal point", format!("{:.3}, {:.3} (first view)", centre[0], centre[1]));
        }
        for (label, words) in &self.space.notes {
            row(label, words.clone());
        }
        row("near, far", format!("{:.4} to {:.4}", self.near, self.far));
        row("coordinates", if self.ndc.is_some() { "NDC" } else { "world" }.into());
        self.describe_place(&mut row);
        row("background", self.background.map_or("none (opaque photographs)".into(), |c| format!("{c:?}")));
        row("exact depth", self.depth_words().into());
        let corrupted = self.corrupted.as_ref().map_or("none", |corrupted| &corrupted.what);
        row("corruption", format!("{corrupted} (training views)"));
        row("video path", format!("{} cameras", self.path.len()));
        rows
    }

    /// Describes where the cameras are, what they look at, how far that is, and how the scene's units follow from the
    /// capture's.
    fn describe_place(&self, row: &mut impl FnMut(&str, String)) {
        let cameras: Vec<Camera> = self.train.iter().chain(&self.test).map(|view| view.camera).collect();
        if cameras.is_empty() {
            return;
        }
        let (rig, world) = (Rig::of(&cameras), &self.space.world);
        let sides = pose::sub(rig.extent[1], rig.extent[0]);
        let spread =
            rig.spread.map_or("all around".into(), |spread| format!("within {spread:.0} degrees of their mean"));
        let [x, y, z] = sides;
        row("cameras", format!("within {x:.3} x {y:.3} x {z:.3} scene units, viewing directions {spread}"));
        row(
            "looking at",
            rig.subject.map_or("no common point".into(), |subject| {
                let ([x, y, z], [least, median, most]) = (subject.focus, subject.depths);
                format!(
                    "[{x:.3}, {y:.3}, {z:.3}], distance {median:.3} ({least:.3} to {most:.3}), radius {:.3}",
                    subject.radius
                )
            }),
        );
        let text = |[x, y, z]: [f64; 3]| format!("[{x:.3}, {y:.3}, {z:.3}]");
        match (self.space.domain, self.format().and_then(|format| format.kind.object_half())) {
            (Some([low, high]), _) => {
                row("box", format!("{} to {} (meshes, smoothness, hash grids)", text(low), text(high)))
            }
            (None, Some(half)) => {
                row("box", format!("the format's: within {half} of the origin along each axis (meshes)"))
            }
            (None, None) => {}
        }
        let [x, y, z] = pose::column(&world.rotation_and_origin, 3);
        row(
            "scene units",
            match *world == super::WorldToScene::default() {
                true => "the capture's own".into(),
                false => {
                    format!(
                        "scale {:.5} scene units per capture unit, the capture's origin at [{x:.4}, {y:.4}, {z:.4}]",
                        world.scale
                    )
                }
            },
        );
        // LLFF's authors sample such scenes in disparity.
        if self.ndc.is_none() && self.near > 0.0 && self.far / self.near > WIDE {
            let times = self.far / self.near;
            row("wide bounds", format!("far is {times:.0} times near: try --set sampling.spacing=disparity"));
        }
    }
}

impl Scene {
    /// Returns what is known of the held-out views' depth.
    fn depth_words(&self) -> &'static str {
        match (self.test.iter().any(View::has_depth), self.has_exact_depth()) {
            (true, true) => "yes",
            (true, false) => "no (depth maps in steps of 8 bits)",
            (false, _) => "no",
        }
    }
}

fn names(views: &[View]) -> String {
    let names: Vec<&str> = views.iter().map(|view| view.name.as_str()).collect();
    format!("{} ({})", views.len(), first_names(&names, NAMES))
}

#[cfg(test)]
mod tests {
    use crate::settings::{DataConfig, DataKind};

    #[test]
    fn depth_in_steps_of_8_bits_is_not_called_exact() {
        let config = DataConfig { kind: DataKind::BuiltinBlender, width: 8, ..DataConfig::default() };
        let mut scene = crate::load(&config, 0, &()).unwrap();
        let words = |scene: &crate::Scene| {
            scene.describe().into_iter().find(|(label, _)| label == "exact depth").expect("a line").1
        };
        assert_eq!(words(&scene), "yes");
        // NeRF-Synthetic's test views have depth maps, too.
        scene.kind = DataKind::Blender.name();
        assert_eq!(words(&scene), "no (depth maps in steps of 8 bits)");
        scene.test.iter_mut().for_each(|view| view.depth = None);
        assert_eq!(words(&scene), "no");
    }
}
