//! Corrupted training data: what is touched, what is not, and that it repeats.

use augnerf::data::{self, Scene, View};
use augnerf::settings::{CorruptionConfig, CorruptionKind, DataConfig, DataKind};

fn scene(kind: DataKind, corruption: CorruptionKind, seed: u64) -> Scene {
    let corruption = CorruptionConfig { kind: corruption, ..CorruptionConfig::default() };
    data::load(&DataConfig { kind, width: 24, corruption, ..DataConfig::default() }, seed, &()).unwrap()
}

fn bytes(views: &[View]) -> Vec<u8> {
    let of_view = |view: &View| {
        let numbers = view.camera.pose.iter().flatten().flat_map(|v| v.to_le_bytes());
        let pixels = view.image.pixels.iter().flat_map(|v| v.to_le_bytes());
        numbers.chain(pixels).collect::<Vec<u8>>()
    };
    views.iter().flat_map(of_view).collect()
}

const KINDS: [CorruptionKind; 4] =
    [CorruptionKind::GaussianNoise, CorruptionKind::ShotNoise, CorruptionKind::Pepper, CorruptionKind::Poses];

#[test]
fn training_views_alone_change_and_the_seed_decides_how() {
    for scene_kind in [DataKind::BuiltinBlender, DataKind::BuiltinForward] {
        let clean = scene(scene_kind, CorruptionKind::None, 0);
        assert!(clean.corrupted.is_none());
        for kind in KINDS {
            let noisy = scene(scene_kind, kind, 3);
            assert_eq!(bytes(&noisy.test), bytes(&clean.test), "{kind:?} touched held-out views");
            let changed = noisy.train.iter().zip(&clean.train).filter(|(a, b)| {
                let only = std::slice::from_ref;
                bytes(only(a)) != bytes(only(b))
            });
            assert_eq!(changed.count(), clean.train.len(), "{kind:?} left a view as it was");
            let of_pixels = noisy.train.iter().zip(&clean.train).all(|(a, b)| a.image == b.image);
            assert_eq!(of_pixels, kind == CorruptionKind::Poses, "{kind:?}");
            assert_eq!(bytes(&noisy.train), bytes(&scene(scene_kind, kind, 3).train), "{kind:?} does not repeat");
            assert_ne!(bytes(&noisy.train), bytes(&scene(scene_kind, kind, 4).train), "{kind:?} knows no seed");
            assert_eq!(noisy.corrupted.as_ref().unwrap().clean_hash, clean.hash());
            assert_ne!(noisy.hash(), clean.hash());
        }
    }
}

/// What is stored has 8 bits, and views have noise of their own.
#[test]
fn values_are_those_of_a_picture() {
    for kind in [CorruptionKind::GaussianNoise, CorruptionKind::ShotNoise, CorruptionKind::Pepper] {
        let noisy = scene(DataKind::BuiltinBlender, kind, 0);
        for value in noisy.train.iter().flat_map(|view| &view.image.pixels) {
            assert!((0.0..=1.0).contains(value) && (value * 255.0 - (value * 255.0).round()).abs() < 1e-4, "{value}");
        }
    }
    // Noise of two views, where neither is clipped.
    let [clean, noisy] = [CorruptionKind::None, CorruptionKind::GaussianNoise].map(|kind| {
        let views = scene(DataKind::BuiltinBlender, kind, 0).train;
        [0, 1].map(|i: usize| views[i].image.pixels.iter().map(|&v| f64::from(v)).collect::<Vec<f64>>())
    });
    let grey = |i: &usize| clean.iter().all(|view| (0.25..0.75).contains(&view[*i]));
    let shared: Vec<usize> = (0..clean[0].len()).filter(grey).collect();
    let product = |a: usize, b: usize| {
        let noise = |view: usize, i: usize| noisy[view][i] - clean[view][i];
        shared.iter().map(|&i| noise(a, i) * noise(b, i)).sum::<f64>()
    };
    let correlation = product(0, 1) / (product(0, 0) * product(1, 1)).sqrt();
    assert!(shared.len() > 50, "{}", shared.len());
    assert!(correlation.abs() < 4.0 / (shared.len() as f64).sqrt(), "{correlation} of {}", shared.len());
}

/// Numbers that a kind does not use must not make two equal corruptions different.
#[test]
fn unused_numbers_have_no_say() {
    let hash = |kind: CorruptionKind, severity: usize, degrees: f64| {
        let mut config = augnerf::settings::Config::default();
        config.data.corruption = CorruptionConfig { kind, severity, degrees, ..CorruptionConfig::default() };
        config.hash()
    };
    assert_eq!(hash(CorruptionKind::None, 1, 2.0), hash(CorruptionKind::None, 5, 3.0));
    assert_eq!(hash(CorruptionKind::GaussianNoise, 2, 2.0), hash(CorruptionKind::GaussianNoise, 2, 3.0));
    assert_ne!(hash(CorruptionKind::GaussianNoise, 1, 2.0), hash(CorruptionKind::GaussianNoise, 2, 2.0));
    assert_ne!(hash(CorruptionKind::Poses, 1, 2.0), hash(CorruptionKind::Poses, 1, 3.0));
}
