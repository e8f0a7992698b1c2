//! What other programs write in the place of what is read here: keys, layouts of folders, kinds of files. To name another,
//! add its line.

/// The key of the focal length, by which all intrinsics are known.
pub(super) const FOCAL: &str = "fl_x";

/// A key of a `transforms.json`, keys that mean the same elsewhere (in lower case, without `_`), and what to do with them.
const KEYS: [(&str, &str, &str); 8] = [
    (
        "frames",
        "images views cameras poses data shots extrinsics",
        "write a list \"frames\" of objects with \"file_path\" and \"transform_matrix\"",
    ),
    (
        "file_path",
        "imagepath rgbpath imgpath colorpath colourpath image imagename imagefile img imgname rgb filename filepath file path name \
         relpath",
        "rename it to \"file_path\"",
    ),
    (
        "transform_matrix",
        "cameratoworld camtoworld camera2world cam2world c2w c2wmatrix camtoworldmatrix pose posematrix camerapose matrix transform \
         transformation transformmatrix twc matrixworld",
        "if it leads from the camera to the world, rename it to \"transform_matrix\", and set data.axes=opencv if y points down",
    ),
    (
        "transform_matrix",
        "worldtocamera worldtocam world2camera world2cam w2c w2cmatrix extrinsic extrinsics extrinsicmatrix viewmatrix tcw rt",
        "write its inverse as \"transform_matrix\" (camera to world), and set data.axes=opencv if y points down",
    ),
    (
        "transform_matrix",
        "rotation r rot rotationmatrix orientation quaternion qvec q rvec position translation t tvec center location",
        "write rotation and position as one 4x4 matrix \"transform_matrix\" (camera to world)",
    ),
    (
        FOCAL,
        "k kmatrix intrinsics intrinsic intrinsicmatrix intrinsicsmatrix cameraintrinsics cameraintrinsic cameramatrix camk camerak",
        "write its numbers as \"fl_x\", \"fl_y\", \"cx\" and \"cy\", in pixels",
    ),
    (
        FOCAL,
        "fx flx focalx focallengthx f fl focal focallength focallengthpx fy fly",
        "it is called \"fl_x\" here (and the vertical one \"fl_y\"), in pixels",
    ),
    (
        FOCAL,
        "fov fovx hfov camerafov xfov fovdegrees fieldofview anglex cameraanglex",
        "write the horizontal field of view as \"camera_angle_x\", in radians",
    ),
];

/// Names the first of the keys that is there in the place of `own`, and what to do with it.
pub(super) fn instead<'a>(own: &str, mut there: impl Iterator<Item = &'a str>) -> Option<String> {
    there.find_map(|key| {
        let plain = key.to_lowercase().replace(['_', '-', ' '], "");
        let means = |known: &&(&str, &str, &str)| known.0 == own && known.1.split(' ').any(|other| other == plain);
        let (.., advice) = KEYS.iter().find(means).filter(|_| key != own)?;
        Some(format!("\"{key}\" is there: {advice}"))
    })
}

const OPENCV: &str = "write its matrices (camera to world, OpenCV's axes) as transform_matrix and its focal length as fl_x into a \
    transforms.json, and read that with data.axes=opencv";
const INVERSE: &str = "write the inverses of its matrices (world to camera, OpenCV's axes) as transform_matrix and its focal \
    length as fl_x into a transforms.json, and read that with data.axes=opencv";
const QUATERNIONS: &str = "turn each line (time, position, quaternion x y z w; camera to world) into a transform_matrix of a \
    transforms.json, with the focal length as fl_x, and read that with data.axes=opencv";
const NPZ: &str = "write its cameras into a transforms.json: decompose the first three rows of world_mat_N into intrinsics and \
    pose; .npz files are not read";

/// Folders that this program writes, like [`LAYOUTS`].
pub(super) const OWN: &[(&str, &str, &str)] = &[
    (
        "config.toml scene.json checkpoints",
        "a run of augnerf, not a scene",
        "use `augnerf view HERE`, `augnerf eval HERE` or `augnerf render HERE`",
    ),
    (
        "sweep.toml provenance.toml",
        "the results of a sweep of augnerf, not a scene",
        "use `augnerf verify HERE` or `augnerf report HERE`",
    ),
    (
        "sweep.toml points",
        "a sweep of augnerf, not a scene",
        "use `augnerf sweep status HERE` or `augnerf compare HERE`",
    ),
];

/// Layouts of other programs that are not read: entries that are all there, a name, and what to do. Of several that fit, the
/// first one counts.
///
/// Entries are in lower case. `*` stands for any letters but `/`, `|` for another way to write the entry. After a colon stands
/// what the file's first lines hold. In the advice, `SCENE` stands for a folder of your choice, `HERE` for the one that was
/// found, `FILE` for the first entry in it, `PHOTOS` for the folder of its photos.
pub(super) const LAYOUTS: &[(&str, &str, &str)] = &[
    (
        "meta_data.json",
        "a scene in the layout of SDFStudio",
        "write its frames into a transforms.json (rgb_path as file_path, camtoworld as transform_matrix, of intrinsics fl_x, fl_y, \
         cx and cy), and read that with data.axes=opencv",
    ),
    ("keyframes", "a raw capture of Polycam", "ns-process-data polycam --data HERE"),
    ("exr_rgbd", "a raw capture of Record3D", "ns-process-data record3d --data HERE"),
    (
        "rgbd metadata",
        "a raw capture of Record3D",
        "export it there as `EXR + RGB sequence`, convert that with `ns-process-data record3d --data FOLDER --output-dir SCENE`, \
         then check SCENE",
    ),
    ("cameras.npz", "a scene in the layout of DTU (IDR, NeuS)", NPZ),
    ("cameras_sphere.npz", "a scene in the layout of NeuS", NPZ),
    ("cams", "a scene in the layout of MVSNet", INVERSE),
    (
        "bundle*.out",
        "a reconstruction of Bundler",
        "reconstruct the photos with COLMAP, or write its cameras into a transforms.json",
    ),
    ("opensfm", "a project of OpenDroneMap", "ns-process-data odm --data HERE"),
    ("pose intrinsics.txt", "a scene in the layout of NSVF", OPENCV),
    ("*/pose/*.txt */intrinsics/*.txt", "a scene in the layout of NeRF++", OPENCV),
    ("*/pose/*.txt */intrinsics.txt", "a scene in the layout of DeepVoxels", OPENCV),
    ("*.pose.txt|*/*.pose.txt", "a scene in the layout of 7-Scenes", OPENCV),
    ("pose/*.txt", "a scene in the layout of ScanNet", OPENCV),
    ("traj*.txt results", "a scene in the layout of Replica (NICE-SLAM)", OPENCV),
    ("traj_w_c.txt", "a scene in the layout of Replica (Semantic-NeRF)", OPENCV),
    ("groundtruth.txt", "a sequence in the layout of TUM RGB-D", QUATERNIONS),
    ("mav0", "a sequence in the layout of EuRoC", "reconstruct the photos in mav0/cam0/data with COLMAP"),
    ("calib.txt poses.txt", "a sequence in the layout of KITTI", OPENCV),
    (
        "*.csv:#name|*.csv:heading,pitch,roll",
        "an export of RealityCapture",
        "ns-process-data realitycapture --data PHOTOS --csv HERE/FILE",
    ),
    (
        "*.nvm",
        "a reconstruction of VisualSFM",
        "write its cameras into a transforms.json, and read that with data.axes=opencv: of each line the focal length is fl_x, the \
         quaternion (w x y z, world to camera) inverted is the rotation, and the next three numbers are the position",
    ),
    (
        "sfm_data.json",
        "a reconstruction of OpenMVG",
        "export it with `openMVG_main_openMVG2Colmap -i HERE/sfm_data.json -o SCENE/sparse/0`, then check SCENE",
    ),
    (
        "reconstruction.json",
        "a reconstruction of OpenSfM",
        "export it with `opensfm export_colmap`, then check that folder",
    ),
    (
        "dataset.json camera",
        "a scene in the layout of Nerfies",
        "write orientation (world to camera, to be inverted) and position of camera/*.json as transform_matrix into a \
         transforms.json, and read that with data.axes=opencv",
    ),
    ("odometry.csv", "a capture of Stray Scanner", QUATERNIONS),
    (
        "cameras.json point_cloud",
        "the output of 3D Gaussian splatting, not its scene",
        "name the folder that it was trained on (source_path in its cfg_args)",
    ),
    (
        "cameras.json",
        "a list of cameras in a format that is not read (cameras.json)",
        "write the cameras into a transforms.json, or name the COLMAP folder that they are from",
    ),
    (
        "cameras.xml|*.xml:<document",
        "an export of Metashape",
        "ns-process-data metashape --data PHOTOS --xml HERE/FILE",
    ),
    ("*.sfm", "a project of Meshroom", "export its cameras for COLMAP or nerfstudio, and check that folder"),
    (
        "database.db",
        "a COLMAP project without a model",
        "run `colmap mapper --database_path HERE/database.db --image_path HERE/images --output_path HERE/sparse`, then check HERE",
    ),
];

/// Endings of files that are no photos, and of photos that are not read.
pub(super) const VIDEOS: [&str; 7] = ["mp4", "mov", "avi", "mkv", "webm", "m4v", "insv"];
pub(super) const UNREAD: [&str; 9] = ["heic", "heif", "avif", "tif", "tiff", "dng", "cr2", "nef", "arw"];
pub(super) const ARCHIVES: [&str; 7] = ["zip", "tar", "gz", "tgz", "7z", "rar", "xz"];

/// How files of other kinds begin: where, with what, and their kind.
const BEGINNINGS: [(usize, &[u8], &str); 13] = [
    (4, b"ftypheic", "HEIC"),
    (4, b"ftypheix", "HEIC"),
    (4, b"ftyphevc", "HEIC"),
    (4, b"ftypmif1", "HEIC"),
    (4, b"ftypmsf1", "HEIC"),
    (4, b"ftypavif", "AVIF"),
    (4, b"ftyp", "a video (MP4)"),
    (0, b"II*\0", "TIFF or a raw photo"),
    (0, b"MM\0*", "TIFF or a raw photo"),
    (0, b"GIF8", "GIF"),
    (0, b"BM", "BMP"),
    (0, b"\xff\x0a", "JPEG XL"),
    (0, b"<", "a web page or XML"),
];

/// Returns the kind of a file that is called like a photo and is none, by its first bytes.
pub(super) fn kind_of(bytes: &[u8]) -> Option<&'static str> {
    let fits = |(at, begin, _): &&(usize, &[u8], &str)| bytes.get(*at..).is_some_and(|rest| rest.starts_with(begin));
    BEGINNINGS.iter().find(fits).map(|(.., kind)| *kind)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_of_other_programs_are_known_however_they_are_spelt() {
        for (own, there, words) in [
            ("fl_x", &["w", "h", "K"][..], "\"K\" is there: write its numbers"),
            ("fl_x", &["Camera_Intrinsics"], "\"Camera_Intrinsics\" is there"),
            ("fl_x", &["fx"], "it is called \"fl_x\" here"),
            ("transform_matrix", &["camToWorld"], "rename it to \"transform_matrix\""),
            ("transform_matrix", &["w2c"], "its inverse"),
            ("file_path", &["rgb_path", "camtoworld"], "rename it to \"file_path\""),
        ] {
            let said = instead(own, there.iter().copied()).unwrap();
            assert!(said.contains(words), "{said}");
        }
        assert_eq!(instead("fl_x", ["fl_x", "cx"].into_iter()), None);
    }
}
