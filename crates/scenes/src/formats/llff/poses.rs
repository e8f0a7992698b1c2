//! `poses_bounds.npy`, and its conversion to poses and depth bounds in training units.

use std::path::Path;

use crate::pose::{self, Pose, Vec3};
use crate::{LARGEST, SMALLEST, WorldToScene, npy};
use augnerf_base::{Error, Result, number_text};

/// Numbers per row: a 3x5 matrix `[down | right | back | origin | (height, width, focal)]` and two bounds.
const COLUMNS: usize = 17;
/// The same of NeX, whose matrices have no last column: height, width and focal length stand in [`NEX_LENS`].
const NEX_COLUMNS: usize = 14;
/// NeX's file of `height, width, focal`, of `height, width, focal, x, y` (the principal point), or with two focal lengths.
const NEX_LENS: &str = "hwf_cxcy.npy";

/// The cameras of an LLFF capture.
#[derive(Clone, Debug, PartialEq)]
pub struct Poses {
    /// One camera-to-world matrix per view: columns right, up, back, origin.
    pub poses: Vec<Pose>,
    /// Nearest and farthest depth of each view.
    pub bounds: Vec<[f64; 2]>,
    /// Columns of the images for which the file was made.
    pub width: f64,
    /// Rows of these images.
    pub height: f64,
    /// Focal lengths of these images across and down, in pixels.
    pub focal: [f64; 2],
    /// Principal point of these images in pixels: the middle, except in NeX's scenes.
    pub centre: [f64; 2],
    /// From the file's units to the poses' current units.
    pub world: WorldToScene,
}

impl Poses {
    /// Reads `poses_bounds.npy`, in the file's own units.
    pub fn read(file: &Path) -> Result<Poses> {
        let npy::Array { shape, values } = npy::read_array(file)?;
        match shape[..] {
            [1..=usize::MAX, NEX_COLUMNS] => return Poses::read_nex(file, &values),
            [1..=usize::MAX, COLUMNS] => {}
            _ => {
                return Err(Error::Data(format!(
                    "{}: the array's shape is {shape:?}, but LLFF's is [N, {COLUMNS}]: a 3x5 matrix and two bounds per view",
                    file.display()
                )));
            }
        }
        check_rows(file, &values)?;
        let [height, width, focal] = intrinsics(&values);
        Ok(Poses::of_rows(&values, Lens { width, height, focal: [focal; 2], centre: [width / 2.0, height / 2.0] }))
    }

    /// Reads NeX's rows, whose lens is a file of its own.
    fn read_nex(file: &Path, values: &[f64]) -> Result<Poses> {
        let lens = file.with_file_name(NEX_LENS);
        if !lens.is_file() {
            return Err(Error::Data(format!(
                "{}: the array's shape is [{}, {NEX_COLUMNS}], as in NeX's scenes, but {NEX_LENS}, which has their focal length, is not \
                 beside it; LLFF's is [N, {COLUMNS}]",
                file.display(),
                values.len() / NEX_COLUMNS
            )));
        }
        let lens = Lens::read_nex(&lens)?;
        let row = |row: &[f64]| {
            let line = |i: usize| [&row[4 * i..4 * i + 4], &[[lens.height, lens.width, lens.focal[0]][i]]].concat();
            [line(0), line(1), line(2), row[12..].to_vec()].concat()
        };
        let rows: Vec<f64> = values.chunks_exact(NEX_COLUMNS).flat_map(row).collect();
        check_rows(file, &rows)?;
        Ok(Poses::of_rows(&rows, lens))
    }

    fn of_rows(rows: &[f64], Lens { width, height, focal, centre }: Lens) -> Poses {
        let rows = rows.chunks_exact(COLUMNS);
        Poses {
            poses: rows.clone().map(pose_of).collect(),
            bounds: rows.map(|row| [row[15], row[16]]).collect(),
            width,
            height,
            focal,
            centre,
            world: WorldToScene::default(),
        }
    }

    /// Takes the images for which the lens is given as `factor` times as large.
    pub(super) fn scale_images(&mut self, factor: f64) {
        self.width *= factor;
        self.height *= factor;
        self.focal = self.focal.map(|focal| focal * factor);
        self.centre = self.centre.map(|centre| centre * factor);
    }

    /// Scales origins and bounds so that the nearest bound becomes 1 / `bound_factor` (0: no scaling).
    pub fn scale_bounds(&mut self, bound_factor: f64) {
        if bound_factor > 0.0 {
            self.scale(1.0 / (self.nearest() * bound_factor));
        }
    }

    /// Expresses all poses in the frame of their average.
    pub fn recentre(&mut self) -> Result<()> {
        let Some(average) = pose::average(&self.poses) else {
            return Err(Error::Data(
                "the viewing directions cancel out, so the poses have no average to be recentred on; \
                 set data.recentre=false and data.ndc=false"
                    .into(),
            ));
        };
        self.place(&pose::inverse_rigid(&average));
        Ok(())
    }

    /// Moves the point that all cameras look at to the origin, and their mean direction from it to +z. Scales so that
    /// the cameras' root mean square distance is 1.
    pub fn spherify(&mut self) -> Result<()> {
        let frame = self.sphere_frame().ok_or_else(|| {
            Error::Data(
                "the cameras look at no common point, so their poses fit no sphere; set data.spherify=false".into(),
            )
        })?;
        self.place(&pose::inverse_rigid(&frame));
        let square = self.poses.iter().map(|p| pose::dot(pose::column(p, 3), pose::column(p, 3))).sum::<f64>();
        self.scale((self.poses.len() as f64 / square).sqrt());
        Ok(())
    }

    /// Returns the smallest bound of all views.
    pub fn nearest(&self) -> f64 {
        self.bounds.iter().map(|b| b[0]).fold(f64::INFINITY, f64::min)
    }

    /// Returns the largest bound of all views.
    pub fn farthest(&self) -> f64 {
        self.bounds.iter().map(|b| b[1]).fold(0.0, f64::max)
    }

    fn place(&mut self, motion: &Pose) {
        self.poses.iter_mut().for_each(|p| *p = pose::compose(motion, p));
        self.world = self.world.moved(motion);
    }

    fn scale(&mut self, factor: f64) {
        self.world = self.world.scaled(factor);
        self.poses.iter_mut().flatten().for_each(|row| row[3] *= factor);
        self.bounds.iter_mut().flatten().for_each(|bound| *bound *= factor);
    }

    fn sphere_frame(&self) -> Option<Pose> {
        let centre = pose::focus_point(&self.poses)?;
        let up = pose::mean(self.poses.iter().map(|p| pose::sub(pose::column(p, 3), centre)));
        let up = pose::normalized(up)?;
        // A vector that is hardly ever parallel to `up`; this one is nerf-pytorch's.
        const HELPER: Vec3 = [0.1, 0.2, 0.3];
        let first = pose::normalized(pose::cross(HELPER, up))?;
        let second = pose::normalized(pose::cross(up, first))?;
        Some(pose::from_columns([first, second, up, centre]))
    }
}

/// The lens of all images of a capture.
struct Lens {
    width: f64,
    height: f64,
    focal: [f64; 2],
    centre: [f64; 2],
}

impl Lens {
    fn read_nex(file: &Path) -> Result<Lens> {
        let values = npy::read_array(file)?.values;
        let lens = match values[..] {
            [height, width, focal] => Lens { width, height, focal: [focal; 2], centre: [width / 2.0, height / 2.0] },
            [height, width, focal, x, y] => Lens { width, height, focal: [focal; 2], centre: [x, y] },
            [height, width, across, down, x, y] => Lens { width, height, focal: [across, down], centre: [x, y] },
            _ => {
                return Err(Error::Data(format!(
                    "{} has {} numbers, but 3 (height, width, focal length), 5 (and the principal point) or 6 (two focal lengths) \
                     are needed",
                    file.display(),
                    values.len()
                )));
            }
        };
        if let Some(wrong) = values.iter().find(|value| !(SMALLEST..=LARGEST).contains(*value)) {
            return Err(Error::Data(format!(
                "{} has {}: every number must be from {SMALLEST:e} to {LARGEST:e}",
                file.display(),
                number_text(*wrong)
            )));
        }
        Ok(lens)
    }
}

fn check_rows(file: &Path, rows: &[f64]) -> Result<()> {
    for (view, row) in rows.chunks_exact(COLUMNS).enumerate() {
        check_row(row, &rows[..COLUMNS])
            .map_err(|what| Error::Data(format!("{}: view {view} (counted from 0) {what}", file.display())))?;
    }
    Ok(())
}

/// Returns height, width and focal length of a row.
fn intrinsics(row: &[f64]) -> [f64; 3] {
    [row[4], row[9], row[14]]
}

/// Converts the file's columns down, right, back to right, up, back.
fn pose_of(row: &[f64]) -> Pose {
    std::array::from_fn(|i| {
        let line = &row[5 * i..];
        [line[1], -line[0], line[2], line[3]]
    })
}

fn check_row(row: &[f64], first: &[f64]) -> std::result::Result<(), String> {
    if let Some(at) = row.iter().position(|v| v.is_nan() || v.abs() > LARGEST) {
        let found = number_text(row[at]);
        return Err(format!(
            "has {found} in column {at}: every number must be finite, from -{LARGEST:e} to {LARGEST:e}"
        ));
    }
    let [near, far] = [row[15], row[16]];
    if !(near >= SMALLEST && near < far) {
        return Err(format!(
            "has the depth bounds {} and {}, but 0 < near < far is needed, near at least {SMALLEST:e}",
            number_text(near),
            number_text(far)
        ));
    }
    let [height, width, focal] = intrinsics(row);
    if [height, width, focal].iter().any(|v| *v < SMALLEST) {
        return Err(format!(
            "has height {}, width {}, focal length {}: all must be positive, at least {SMALLEST:e}",
            number_text(height),
            number_text(width),
            number_text(focal)
        ));
    }
    let same = intrinsics(row).iter().zip(intrinsics(first)).all(|(a, b)| (a - b).abs() <= 1e-3 * b);
    if !same {
        return Err(format!(
            "has height {height}, width {width}, focal length {focal}, unlike view 0 {:?}: \
             LLFF scenes are of one camera",
            intrinsics(first)
        ));
    }
    pose::check_rotation(&pose_of(row)).map_err(|what| format!("has no rotation in its matrix but {what}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring() -> Poses {
        let at = |i: usize| {
            let angle = i as f64 * 0.7;
            let origin = [5.0 + 3.0 * angle.cos(), 1.0 + 3.0 * angle.sin(), 2.0];
            pose::look_along(pose::sub(origin, [5.0, 1.0, 0.5]), [0.0, 0.0, 1.0], origin).unwrap()
        };
        let poses: Vec<Pose> = (0..9).map(at).collect();
        Poses {
            bounds: vec![[2.0, 5.0]; 9],
            poses,
            width: 8.0,
            height: 6.0,
            focal: [7.0; 2],
            centre: [4.0, 3.0],
            world: WorldToScene::default(),
        }
    }

    /// The same capture as LLFF and as NeX write it.
    #[test]
    fn nex_rows_are_read_with_their_lens() {
        let dir = tempfile::tempdir().unwrap();
        let array = |name: &str, shape: &[usize], values: &[f64]| {
            let mut bytes = npy::header("<f8", shape);
            bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
            let file = dir.path().join(name);
            std::fs::write(&file, bytes).unwrap();
            file
        };
        let (pose, bounds) = ([0.0, 1.0, 0.0, 5.0, -1.0, 0.0, 0.0, 6.0, 0.0, 0.0, 1.0, 7.0], [2.0, 9.0]);
        let nex = array("poses_bounds.npy", &[1, 14], &[&pose[..], &bounds].concat());
        let said = Poses::read(&nex).unwrap_err().to_string();
        assert!(said.contains("hwf_cxcy.npy") && said.contains("[1, 14]"), "{said}");
        array("hwf_cxcy.npy", &[6, 1], &[30.0, 40.0, 50.0, 51.0, 19.0, 16.0]);
        let read = Poses::read(&nex).unwrap();
        let with = |row: usize, last: f64| [&pose[4 * row..4 * row + 4], &[last]].concat();
        let rows = [with(0, 30.0), with(1, 40.0), with(2, 50.0), bounds.to_vec()].concat();
        let llff = Poses::read(&array("llff.npy", &[1, 17], &rows)).unwrap();
        assert_eq!((llff.focal, llff.centre), ([50.0; 2], [20.0, 15.0]));
        assert_eq!(read, Poses { focal: [50.0, 51.0], centre: [19.0, 16.0], ..llff });
        for (shape, lens, words) in [([2], &[1.0, 2.0][..], "has 2 numbers"), ([3], &[1.0, 2.0, f64::NAN], "NaN")] {
            array("hwf_cxcy.npy", &shape, lens);
            let said = Poses::read(&nex).unwrap_err().to_string();
            assert!(said.contains(words), "{said}");
        }
    }

    #[test]
    fn recentred_poses_average_to_the_identity() {
        let mut poses = ring();
        poses.recentre().unwrap();
        let average = pose::average(&poses.poses).unwrap();
        for (i, row) in average.iter().enumerate() {
            assert!(row.iter().enumerate().all(|(j, v)| (v - f64::from(i == j)).abs() < 1e-12), "{average:?}");
        }
    }

    #[test]
    fn spherified_cameras_look_at_the_origin_from_distance_one() {
        let mut poses = ring();
        poses.spherify().unwrap();
        for p in &poses.poses {
            let (origin, back) = (pose::column(p, 3), pose::column(p, 2));
            assert!((pose::length(origin) - 1.0).abs() < 1e-12);
            assert!(pose::length(pose::sub(origin, back)) < 1e-9);
        }
    }

    #[test]
    fn the_way_from_the_file_s_units_is_kept() {
        let mut poses = ring();
        let file = poses.poses.clone();
        poses.scale_bounds(0.75);
        poses.recentre().unwrap();
        poses.spherify().unwrap();
        for (file, now) in file.iter().zip(&poses.poses) {
            let placed = poses.world.camera(file);
            assert!(placed.iter().flatten().zip(now.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-9), "{placed:?}");
        }
    }

    #[test]
    fn bounds_and_origins_scale_together() {
        let mut poses = ring();
        let distance = |p: &Poses| pose::length(pose::sub(pose::column(&p.poses[0], 3), pose::column(&p.poses[1], 3)));
        let before = distance(&poses) / poses.nearest();
        poses.scale_bounds(0.75);
        assert!((poses.nearest() - 1.0 / 0.75).abs() < 1e-12);
        assert!((distance(&poses) / poses.nearest() - before).abs() < 1e-12);
    }

    #[test]
    fn parallel_cameras_fit_no_sphere() {
        let mut poses = ring();
        let first = poses.poses[0];
        poses.poses.iter_mut().for_each(|p| *p = first);
        assert!(poses.spherify().unwrap_err().to_string().contains("data.spherify"));
    }
}
