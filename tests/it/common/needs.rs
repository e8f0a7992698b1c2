//! What the repository does not hold. Tests that need it are `#[ignore]`d with the variable's name; run all the same
//! (`--include-ignored`), they fail where the variable is unset.

use std::path::PathBuf;

/// The folder of scenes in `AUGNERF_DATA`.
pub fn data() -> PathBuf {
    folder("AUGNERF_DATA")
}

/// A scene below it, such as `nerf_llff_data/fern`.
pub fn scene(relative: &str) -> PathBuf {
    data().join(relative)
}

/// The folder of LPIPS weights in `AUGNERF_LPIPS_WEIGHTS`.
pub fn lpips_weights() -> PathBuf {
    folder("AUGNERF_LPIPS_WEIGHTS")
}

fn folder(variable: &str) -> PathBuf {
    let folder = std::env::var_os(variable).map(PathBuf::from);
    folder.unwrap_or_else(|| panic!("{variable} is not set: this test reads what it names"))
}
