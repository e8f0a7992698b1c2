//! Captures in LLFF's format that go around an object, which normalized device coordinates cannot show.

use std::path::Path;

use super::{POSES_FILE, Poses};
use crate::pose::{self, Pose};
use crate::settings::{DataConfig, DataKind};

/// Largest turn from the mean of a forward-facing capture's cameras, in degrees. Published ones turn by less than 30.
const MOST_TURN: f64 = 40.0;
/// NDC's near plane.
const NEAR_PLANE: f64 = -1.0;

/// Switches `data.ndc` off and `data.spherify` on if a capture goes around an object, and returns the reason. `None` if
/// nothing changed: another format, coordinates that are set otherwise, or poses that face forward or are not readable.
pub fn settle_orbit(config: &mut DataConfig) -> Option<String> {
    let asked = config.kind == DataKind::Llff && config.ndc && !config.spherify && config.recognise_orbits;
    let why = asked.then(|| why_around(config)).flatten()?;
    (config.ndc, config.spherify) = (false, true);
    Some(format!(
        "{}: {why}, so it goes around something: read without NDC and spherified (data.ndc=false, data.spherify=true; \
         data.recognise_orbits=false keeps NDC); where bounds are wide, try sampling.spacing=disparity",
        config.dir
    ))
}

fn why_around(config: &DataConfig) -> Option<String> {
    // Errors in the poses are reported when they are loaded.
    let mut poses = Poses::read(&Path::new(&config.dir).join(POSES_FILE)).ok()?;
    poses.scale_bounds(config.bound_factor);
    if config.recentre {
        poses.recentre().ok()?;
    }
    around(&poses.poses)
}

/// Returns why recentred and scaled poses do not face forward, or `None` if they do.
pub(super) fn around(poses: &[Pose]) -> Option<String> {
    let turn = |p: &Pose| pose::column(p, 2)[2].clamp(-1.0, 1.0).acos().to_degrees();
    let turn = poses.iter().map(turn).fold(0.0, f64::max);
    let beyond = poses.iter().filter(|p| p[2][3] < NEAR_PLANE).count();
    match beyond {
        0 if turn <= MOST_TURN => None,
        0 => Some(format!("its cameras turn up to {turn:.0} degrees from their mean")),
        _ => Some(format!(
            "{beyond} of its {} cameras stand beyond the near plane, and they turn up to {turn:.0} degrees from their mean",
            poses.len()
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn looking(back: [f64; 3], origin: [f64; 3]) -> Pose {
        pose::look_along(back, [0.0, 1.0, 0.0], origin).unwrap()
    }

    #[test]
    fn cameras_that_turn_far_or_stand_beyond_the_near_plane_go_around() {
        let forward = [looking([0.3, 0.0, 1.0], [0.5, 0.0, 0.4]), looking([-0.3, 0.1, 1.0], [-0.5, 0.1, -0.9])];
        assert_eq!(around(&forward), None);
        let turned = [forward[0], looking([1.0, 0.0, 1.0], [1.0, 0.0, 0.0])];
        assert!(around(&turned).unwrap().contains("45 degrees"));
        let beyond = [forward[0], looking([0.0, 0.0, 1.0], [0.0, 0.0, -1.2])];
        assert!(around(&beyond).unwrap().contains("1 of its 2 cameras"));
    }
}
