//! Corrupted training data (paper, tables 3 and A2). Held-out views stay as they are.
//!
//! Pixels are corrupted at the working resolution, clipped to 0..=1 and rounded to 8 bits, as a stored image would be.
//! Each view has its own random numbers from the run's seed.

use std::sync::Arc;

use rayon::prelude::*;

use super::pose::{Pose, Vec3, column, compose, from_columns};
use super::{Camera, LARGEST, Scene, View, camera_is_sound};
use crate::settings::{CorruptionConfig, CorruptionKind};
use augnerf_base::rng::{Random, Stream};
use augnerf_base::{Error, Image, Result, number_text};

/// The corruption of a scene's training views.
#[derive(Clone, Debug, PartialEq)]
pub struct Corrupted {
    /// Kind and numbers, as in tables: `gaussian-noise 3 (std 0.18)`.
    pub what: String,
    /// [`Scene::hash`] of the views before corruption.
    pub clean_hash: String,
}

/// Corrupts the training views of a scene. The same configuration and seed give the same bytes.
///
/// # Errors
/// If a moved camera is too far away to compute with, or NDC cannot express its pose.
pub fn corrupt(scene: &mut Scene, config: &CorruptionConfig, seed: u64) -> Result<()> {
    if !config.is_on() {
        return Ok(());
    }
    let corrupted = Corrupted { what: describe(config), clean_hash: scene.hash() };
    // Of a capture that goes around something, cameras may stand elsewhere.
    let stood_before = scene.ndc.is_some() && scene.train.iter().all(|view| view.camera.is_before_ndc());
    let random = |index: usize| Random::new(seed, Stream::Corruption, index as u64);
    scene.train.par_iter_mut().enumerate().for_each(|(i, view)| {
        let random = &mut random(i);
        match config.kind {
            CorruptionKind::None => {}
            CorruptionKind::GaussianNoise => {
                add_gaussian(Arc::make_mut(&mut view.image), config.gaussian_std(), random)
            }
            CorruptionKind::ShotNoise => count_photons(Arc::make_mut(&mut view.image), config.shot_photons(), random),
            CorruptionKind::Pepper => pepper(Arc::make_mut(&mut view.image), config.share, random),
            CorruptionKind::Poses => {
                let Camera { pose, .. } = &mut view.camera;
                *pose = misplaced(pose, config.degrees, config.offset, random);
            }
        }
    });
    if config.kind == CorruptionKind::Poses {
        check_places(&scene.train, config, stood_before)?;
    }
    if scene.ndc.is_some() {
        check_facing(&scene.train, config)?;
    }
    scene.corrupted = Some(corrupted);
    Ok(())
}

fn describe(config: &CorruptionConfig) -> String {
    let CorruptionConfig { kind, severity, share, degrees, offset } = *config;
    let numbers = match kind {
        CorruptionKind::None => return String::new(),
        CorruptionKind::GaussianNoise => format!("{severity} (std {})", config.gaussian_std()),
        CorruptionKind::ShotNoise => format!("{severity} ({} photons)", config.shot_photons()),
        CorruptionKind::Pepper => format!("{share}"),
        CorruptionKind::Poses => format!("{degrees} degrees, {offset} units"),
    };
    format!("{} {numbers}", kind.name())
}

/// Returns the nearest value in 8 bits.
fn stored(value: f64) -> f32 {
    (value.clamp(0.0, 1.0) * 255.0).round() as f32 / 255.0
}

fn add_gaussian(image: &mut Image, std: f64, random: &mut Random) {
    for pair in image.pixels.chunks_mut(2) {
        let (a, b) = random.normal_pair();
        for (value, noise) in pair.iter_mut().zip([a, b]) {
            *value = stored(f64::from(*value) + std * noise);
        }
    }
}

fn count_photons(image: &mut Image, photons: f64, random: &mut Random) {
    for value in &mut image.pixels {
        *value = stored(f64::from(random.poisson(f64::from(*value) * photons)) / photons);
    }
}

/// Sets the first half of the drawn pixels to black, then the other half to white. A pixel that is drawn twice keeps
/// the last value.
fn pepper(image: &mut Image, share: f64, random: &mut Random) {
    let pixels = image.width * image.height;
    let draws = (share * pixels as f64).round() as usize;
    for draw in 0..draws {
        let pixel = random.below(pixels as u32) as usize;
        let value = if draw < draws / 2 { 0.0 } else { 1.0 };
        image.pixels[pixel * image.channels..][..image.channels].fill(value);
    }
    image.pixels.iter_mut().for_each(|value| *value = stored(f64::from(*value)));
}

/// Returns the pose rotated about its own origin by angles about the world's x, y and z axes (in that order), then
/// moved.
fn misplaced(pose: &Pose, degrees: f64, offset: f64, random: &mut Random) -> Pose {
    let mut within = |most: f64| (2.0 * random.uniform() - 1.0) * most;
    let angles: [f64; 3] = std::array::from_fn(|_| within(degrees).to_radians());
    let shift: Vec3 = std::array::from_fn(|_| within(offset));
    let turned = compose(&rotation(angles), pose);
    let origin: Vec3 = std::array::from_fn(|i| pose[i][3] + shift[i]);
    from_columns([column(&turned, 0), column(&turned, 1), column(&turned, 2), origin])
}

/// Returns R_z R_y R_x.
fn rotation([x, y, z]: [f64; 3]) -> Pose {
    let about = |angle: f64, axis: usize| -> Pose {
        let (sin, cos) = angle.sin_cos();
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut turn = [[0.0; 4]; 3];
        turn[axis][axis] = 1.0;
        (turn[u][u], turn[u][v], turn[v][u], turn[v][v]) = (cos, -sin, sin, cos);
        turn
    };
    compose(&about(z, 2), &compose(&about(y, 1), &about(x, 0)))
}

/// Checks that moved cameras have numbers that training computes with, and stand before the plane where NDC begin if all
/// `stood_before` it.
fn check_places(views: &[View], config: &CorruptionConfig, stood_before: bool) -> Result<()> {
    let refuse = |View { name, camera, .. }: &View, why: String| {
        let (offset, degrees, place) = (number_text(config.offset), config.degrees, column(&camera.pose, 3));
        Err(Error::Config(format!(
            "data.corruption.offset = {offset} with data.corruption.degrees = {degrees}: moved so far, training view {name} \
             stands at {place:?}, {why}"
        )))
    };
    if let Some(far) = views.iter().find(|view| !camera_is_sound(&view.camera)) {
        let why = format!("and training computes with numbers from -{LARGEST:e} to {LARGEST:e}; take a smaller offset");
        return refuse(far, why);
    }
    match views.iter().find(|view| stood_before && !view.camera.is_before_ndc()) {
        None => Ok(()),
        Some(beyond) => {
            let why = "beyond the plane z = -1 where normalized device coordinates begin; take a smaller offset or set \
                       data.ndc=false";
            refuse(beyond, why.into())
        }
    }
}

/// Checks that rotated cameras still face the scene. NDC have no rays that do not go towards -z.
fn check_facing(views: &[View], config: &CorruptionConfig) -> Result<()> {
    match views.iter().find(|view| !view.camera.faces_forward()) {
        None => Ok(()),
        Some(view) => Err(Error::Config(format!(
            "data.corruption.degrees = {}: turned so far, training view {} looks away from the scene's -z axis and has no \
             normalized device coordinates; take fewer degrees or set data.ndc=false",
            config.degrees, view.name
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::{check_rotation, dot};
    use crate::settings::{DataConfig, DataKind};

    const SIDE: usize = 300;

    fn flat(value: f32) -> Image {
        Image { width: SIDE, height: SIDE, channels: 3, pixels: vec![value; SIDE * SIDE * 3] }
    }

    fn random() -> Random {
        Random::new(5, Stream::Corruption, 0)
    }

    fn moments(image: &Image) -> (f64, f64) {
        let n = image.pixels.len() as f64;
        let mean = image.pixels.iter().map(|&v| f64::from(v)).sum::<f64>() / n;
        let var = image.pixels.iter().map(|&v| (f64::from(v) - mean).powi(2)).sum::<f64>() / n;
        (mean, var)
    }

    /// ImageNet-C's numbers, seen through what they do: where nothing is clipped, std and photons are those of the
    /// noise; white with noise of std s is clipped to a mean of 1 - s / sqrt(2 pi).
    #[test]
    fn severities_are_those_of_imagenet_c() {
        let of = |kind: CorruptionKind, severity: usize, value: f32| {
            let config = CorruptionConfig { kind, severity, ..CorruptionConfig::default() };
            let mut image = flat(value);
            match kind {
                CorruptionKind::GaussianNoise => add_gaussian(&mut image, config.gaussian_std(), &mut random()),
                _ => count_photons(&mut image, config.shot_photons(), &mut random()),
            }
            moments(&image)
        };
        for (severity, std, photons) in
            [(1, 0.08, 60.0), (2, 0.12, 25.0), (3, 0.18, 12.0), (4, 0.26, 5.0), (5, 0.38, 3.0)]
        {
            let (mean, _) = of(CorruptionKind::GaussianNoise, severity, 1.0);
            assert!(((1.0 - mean) / (std / std::f64::consts::TAU.sqrt()) - 1.0).abs() < 0.01, "{severity}: {mean}");
            let (mean, _) = of(CorruptionKind::GaussianNoise, severity, 0.5);
            assert!((mean - 0.5).abs() < 5.0 * std / ((SIDE * SIDE * 3) as f64).sqrt(), "{severity}: {mean}");
            // Poisson at 0.1: hardly ever above 1.
            let (mean, var) = of(CorruptionKind::ShotNoise, severity, 0.1);
            assert!(
                (mean / 0.1 - 1.0).abs() < 0.03 && (var * photons / 0.1 - 1.0).abs() < 0.03,
                "{severity}: {mean}, {var}"
            );
            assert_eq!(of(CorruptionKind::ShotNoise, severity, 0.0), (0.0, 0.0), "no light, no photons");
        }
    }

    /// 1 - exp(-0.3) = 25.9 % of pixels are reached; the second half, white, is never overwritten.
    #[test]
    fn pepper_covers_what_draws_with_replacement_reach() {
        let mut image = flat(0.5);
        pepper(&mut image, 0.3, &mut random());
        let share = |value: f32| {
            let hit = image.pixels.chunks(3).filter(|pixel| pixel.iter().all(|&v| v == value)).count();
            hit as f64 / (SIDE * SIDE) as f64
        };
        let white = 1.0 - (-0.15f64).exp();
        let tolerance = 5.0 * (0.25 / (SIDE * SIDE) as f64).sqrt();
        assert!((share(1.0) - white).abs() < tolerance, "{}", share(1.0));
        assert!((share(0.0) - white * (-0.15f64).exp()).abs() < tolerance, "{}", share(0.0));
    }

    #[test]
    fn poses_turn_and_move_within_their_bounds() {
        let pose = rotation([0.3, -0.8, 2.0]).map(|[a, b, c, _]| [a, b, c, 1.5]);
        let (mut farthest, mut shifts, mut turns) = ([0f64; 2], 0.0, [0.0; 3]);
        for i in 0..2000 {
            let moved = misplaced(&pose, 5.0, 0.1, &mut Random::new(1, Stream::Corruption, i));
            check_rotation(&moved).unwrap();
            shifts += (0..3).map(|axis| (moved[axis][3] - pose[axis][3]).powi(2)).sum::<f64>();
            // What turned the axes, R = moved pose^T: its angles about x, y, z, from first order in 5 degrees.
            let turn = |row: usize, of: usize| (0..3).map(|axis| moved[row][axis] * pose[of][axis]).sum::<f64>();
            for (angle, square) in [turn(2, 1), turn(0, 2), turn(1, 0)].into_iter().zip(&mut turns) {
                *square += angle.asin().to_degrees().powi(2);
            }
            for axis in 0..3 {
                let shift = (moved[axis][3] - pose[axis][3]).abs();
                assert!(shift <= 0.1);
                farthest[0] = farthest[0].max(shift);
                let turned = dot(column(&moved, axis), column(&pose, axis)).clamp(-1.0, 1.0).acos().to_degrees();
                // Two of three rotations turn an axis: at most about the root of 2 (3) times 5 degrees.
                assert!(turned < 5.0 * 3f64.sqrt(), "{turned}");
                farthest[1] = farthest[1].max(turned);
            }
        }
        // Even within +-a: a variance of a^2 / 3.
        assert!((shifts / 6000.0 / (0.01 / 3.0) - 1.0).abs() < 0.06, "{shifts}");
        assert!(turns.iter().all(|sum| (sum / 2000.0 / (25.0 / 3.0) - 1.0).abs() < 0.1), "{turns:?}");
        assert!(farthest[0] > 0.099 && farthest[1] > 5.0, "{farthest:?}");
        assert_eq!(misplaced(&pose, 0.0, 0.0, &mut random()).map(|row| row[3]), [1.5; 3]);
    }

    /// Half a turn would leave NDC without rays: the user hears of it.
    #[test]
    fn cameras_that_look_away_are_refused_where_rays_are_in_ndc() {
        let config = DataConfig { kind: DataKind::BuiltinForward, width: 16, ..DataConfig::default() };
        let clean = crate::load(&config, 0, &()).unwrap();
        let turn = |degrees: f64, scene: &Scene| {
            let poses = CorruptionConfig { kind: CorruptionKind::Poses, degrees, ..CorruptionConfig::default() };
            corrupt(&mut scene.clone(), &poses, 0)
        };
        turn(5.0, &clean).unwrap();
        let message = turn(180.0, &clean).unwrap_err().to_string();
        assert!(message.contains("data.corruption.degrees = 180") && message.contains("fewer degrees"), "{message}");
        turn(180.0, &Scene { ndc: None, ..clean.clone() }).unwrap();
    }

    /// Beyond 1e12 f32 cannot compute; NDC begin one unit before the origin.
    #[test]
    fn cameras_that_are_moved_too_far_are_refused() {
        let config = DataConfig { kind: DataKind::BuiltinForward, width: 16, ..DataConfig::default() };
        let clean = crate::load(&config, 0, &()).unwrap();
        let outside = Scene { ndc: None, ..clean.clone() };
        let moved = |offset: f64, scene: &Scene| {
            let poses = CorruptionConfig { kind: CorruptionKind::Poses, offset, ..CorruptionConfig::default() };
            corrupt(&mut scene.clone(), &poses, 0)
        };
        for (offset, named) in [(1e300, "1e300"), (1e14, "100000000000000")] {
            for scene in [&clean, &outside] {
                let message = moved(offset, scene).unwrap_err().to_string();
                assert!(message.contains(&format!("data.corruption.offset = {named} with")), "{message}");
                assert!(message.contains("from -1e12 to 1e12") && message.contains("degrees = 5"), "{message}");
            }
        }
        let message = moved(20.0, &clean).unwrap_err().to_string();
        assert!(message.contains("data.corruption.offset = 20") && message.contains("z = -1"), "{message}");
        moved(20.0, &outside).unwrap();
        moved(0.1, &clean).unwrap();
        // One that stood beyond it before is not the corruption's.
        let mut around = clean;
        around.train[0].camera.pose[2][3] = -1.5;
        moved(0.1, &around).unwrap();
    }

    /// A quarter turn about x takes y to z, then one about z leaves it.
    #[test]
    fn angles_are_applied_about_x_first() {
        let quarter = std::f64::consts::FRAC_PI_2;
        let turned = rotation([quarter, 0.0, quarter]);
        let y = [0, 1, 2].map(|row| turned[row][1].round());
        assert_eq!(y, [0.0, 0.0, 1.0]);
    }
}
