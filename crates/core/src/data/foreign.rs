//! What other programs write in the place of what is read here: keys and kinds of files. To name another, add its line.

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
