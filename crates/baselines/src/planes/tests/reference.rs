//! The authors' functions: `llff.*` of `tests/fixtures/baselines.safetensors`.

use candle_core::{DType, Device, Tensor};

use crate::base::Image;
use crate::data::formats::llff::{POSES_FILE, Poses};
use crate::data::{Camera, Rays, npy};
use crate::grids::alpha_over::alpha_over;
use crate::grids::planes::plane_sample;
use crate::grids::reference::{error, fixture, values, with_gradients};
use crate::methods::Renderer;
use crate::planes::PlanesRenderer;
use crate::planes::blend::{blend, blend_weight};
use crate::planes::geometry::{Viewpoint, depths, inputs_of, nearest};
use crate::planes::mpi::{Mpi, stored};
use crate::planes::sweep::{Window, sweep};

use super::{f64s, made};

const WIDTH: usize = 8;
const HEIGHT: usize = 6;
/// Numbers that the fixture has in f32.
const ROUNDED: f64 = 2e-7;
/// Our weights have no factor that the authors' blend adds 1e-10 beside.
const BLENDED: f64 = 1e-8;

/// The authors' homographies put the principal point one row higher than the middle.
fn eye(c2w: &[f64], focal: f64) -> Viewpoint {
    let row = |r: usize| std::array::from_fn(|c| c2w[4 * r + c]);
    let centre = [0.5 * WIDTH as f64, 0.5 * HEIGHT as f64 - 1.0];
    let camera = Camera { width: WIDTH, height: HEIGHT, focal: [focal; 2], centre, pose: [row(0), row(1), row(2)] };
    Viewpoint { camera, shift: 0.0 }
}

fn eyes() -> Vec<Viewpoint> {
    values(&fixture("llff.c2w")).chunks(12).map(|c2w| eye(c2w, 7.25)).collect()
}

fn goal() -> Viewpoint {
    eye(&values(&fixture("llff.goal_c2w")), 7.25)
}

fn planes() -> Vec<f64> {
    let [near, far] = values(&fixture("llff.near_far"))[..] else { panic!("two bounds") };
    depths(near, far, 4)
}

/// Planes of one view, `[planes, height, width, 4]`.
fn mpi(view: usize) -> Tensor {
    let mpi = fixture("llff.mpis").narrow(0, view, 1).unwrap().squeeze(0).unwrap();
    mpi.permute((2, 0, 1, 3)).unwrap().contiguous().unwrap()
}

fn goal_rays() -> Vec<([f64; 3], [f64; 3])> {
    (0..HEIGHT * WIDTH).map(|i| goal().ray([(i % WIDTH) as f64, (i / WIDTH) as f64])).collect()
}

/// Colour times weight and sum of weights from the goal, `[rays, 4]`.
fn rendered(view: usize, planes_of_view: &Tensor) -> Tensor {
    let places = eyes()[view].places(&goal_rays(), &planes());
    alpha_over(&plane_sample(planes_of_view, &places).unwrap()).unwrap()
}

/// The views' poses and the goal's as LLFF's own file holds them, read.
#[test]
fn poses_of_a_file_are_the_authors() {
    let of = |name: &str| values(&fixture(name));
    let poses = [of("llff.poses"), of("llff.goal")].concat();
    let bounds = [of("llff.bounds"), vec![1.0, 2.0]].concat();
    let rows: Vec<f64> = poses.chunks(15).zip(bounds.chunks(2)).flat_map(|row| [row.0, row.1].concat()).collect();
    let bytes: Vec<u8> = rows.iter().flat_map(|value| value.to_le_bytes()).collect();
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join(POSES_FILE);
    std::fs::write(&file, [npy::header("<f8", &[7, 17]), bytes].concat()).unwrap();
    let found = Poses::read(&file).unwrap();
    assert_eq!((found.height, found.width, found.focal), (HEIGHT as f64, WIDTH as f64, [7.25; 2]));
    let read: Vec<f64> = found.poses.into_iter().flatten().flatten().collect();
    assert_eq!(read, [of("llff.c2w"), of("llff.goal_c2w")].concat());
}

#[test]
fn depths_and_inputs_are_the_authors() {
    let bounds = values(&fixture("llff.bounds"));
    let bound = |pick: fn(f64, f64) -> f64, start: f64| bounds.iter().copied().fold(start, pick);
    let found = depths(0.9 * bound(f64::min, f64::INFINITY), 2.0 * bound(f64::max, 0.0), 4);
    assert!(error(&f64s(found, &[4]), &fixture("llff.depths")) < 1e-15);
    let expected = values(&fixture("llff.inputs_of"));
    for (view, expected) in expected.chunks(6).enumerate() {
        let mut found = inputs_of(&eyes(), view, 5, None);
        // A sixth index, the view again, is of use in the authors' training alone.
        found.push(view);
        assert_eq!(found.iter().map(|input| *input as f64).collect::<Vec<f64>>(), expected);
        // One that is left out gives its place to the next.
        let others = inputs_of(&eyes(), view, 5, Some(expected[1] as usize));
        assert!(!others.contains(&(expected[1] as usize)) && others.len() == 5, "{others:?}");
    }
}

#[test]
fn sweep_volumes_are_the_authors() {
    let pixels = values(&fixture("llff.images"));
    let image = |view: usize| Image {
        width: WIDTH,
        height: HEIGHT,
        channels: 3,
        pixels: pixels[view * 144..][..144].iter().map(|value| *value as f32).collect(),
    };
    let (eyes, images): (Vec<Viewpoint>, Vec<Image>) = (eyes(), (0..6).map(image).collect());
    let inputs = inputs_of(&eyes, 0, 5, None);
    let seen: Vec<(&Viewpoint, &Image)> = inputs.iter().map(|&view| (&eyes[view], &images[view])).collect();
    let window = Window { left: 0, top: 0, width: WIDTH, height: HEIGHT };
    let found = sweep(&eyes[0], &seen, &planes(), window, DType::F64, &Device::Cpu).unwrap();
    let expected = fixture("llff.psv").permute((3, 1, 2, 0, 4)).unwrap().reshape((4, 6, 8, 15)).unwrap();
    assert!(error(&found, &expected) < ROUNDED);
    let fast = sweep(&eyes[0], &seen, &planes(), window, DType::F32, &Device::Cpu).unwrap();
    assert!(error(&fast, &expected) < 1e-6);
    // A window is a part of the whole, and what is beyond the view repeats its edge.
    let window = Window { left: 3, top: 2, width: 8, height: 8 };
    let part = sweep(&eyes[0], &seen, &planes(), window, DType::F64, &Device::Cpu).unwrap();
    let own = part.narrow(1, 0, 4).unwrap().narrow(2, 0, 5).unwrap().contiguous().unwrap();
    let whole = found.narrow(1, 2, 4).unwrap().narrow(2, 3, 5).unwrap().contiguous().unwrap();
    assert_eq!(values(&own), values(&whole));
    let [edge, beyond] = [4, 7].map(|column| values(&part.narrow(2, column, 1).unwrap()));
    assert_eq!(edge, beyond);
}

#[test]
fn places_and_renderings_are_the_authors() {
    let expected = values(&fixture("llff.coordinates"));
    for (view, expected) in expected.chunks(4 * 48 * 2).enumerate() {
        let places = eyes()[view].places(&goal_rays(), &planes());
        for (i, [x, y]) in places.of_rays.iter().enumerate() {
            let at = 2 * (i % 4 * 48 + i / 4);
            assert!((x - expected[at]).abs() < 1e-5 && (y - expected[at + 1]).abs() < 1e-5, "{view} {i}: {x} {y}");
        }
    }
    let expected = fixture("llff.rendered");
    for view in 0..6 {
        let expected = expected.narrow(0, view, 1).unwrap().reshape((48, 4)).unwrap();
        assert!(error(&rendered(view, &mpi(view)), &expected) < ROUNDED, "{view}");
    }
}

/// Views from the nearest on with their weights.
fn weights(count: usize) -> Vec<(usize, f64)> {
    let near = nearest(&eyes(), goal().position());
    let weight = |&(view, distance): &(usize, f64)| (view, blend_weight(&eyes()[view], distance, near[0].1, &planes()));
    near.iter().take(count).map(weight).collect()
}

#[test]
fn blends_of_any_number_are_the_authors() {
    let (distances, expected) = (values(&fixture("llff.distance")), values(&fixture("llff.blend_weights")));
    let all = weights(6);
    let first = all[0].0;
    for ((view, weight), (_, distance)) in all.into_iter().zip(nearest(&eyes(), goal().position())) {
        assert!((distance - distances[view]).abs() < 1e-14);
        assert!((weight - expected[view] / expected[first]).abs() < 1e-14, "{view}");
    }
    for count in [1, 2, 5, 6] {
        let renderings =
            weights(count).into_iter().map(|(view, weight)| (rendered(view, &mpi(view)), weight)).collect();
        let found = blend(renderings, None).unwrap();
        let expected = fixture(&format!("llff.blend.{count}")).reshape((48, 3)).unwrap();
        assert!(error(&found.rgb, &expected) < BLENDED, "{count}");
    }
}

#[test]
fn slopes_of_a_blend_are_torch_s() {
    let index: Vec<usize> = values(&fixture("llff.pair.index")).into_iter().map(|view| view as usize).collect();
    let pair = weights(2);
    assert_eq!(pair.iter().map(|(view, _)| *view).collect::<Vec<usize>>(), index);
    let blended = |mpis: [&Tensor; 2]| -> crate::base::Result<Tensor> {
        let renderings = pair.iter().zip(mpis).map(|((view, weight), mpi)| (rendered(*view, mpi), *weight));
        Ok(blend(renderings.collect(), None)?.rgb)
    };
    let cotangent = fixture("llff.pair.cotangent").reshape((48, 3)).unwrap();
    let found = with_gradients(&[mpi(index[0]), mpi(index[1])], &cotangent, blended);
    assert!(error(&found[0], &fixture("llff.pair.out").reshape((48, 3)).unwrap()) < BLENDED);
    let expected = fixture("llff.pair.grad.mpis");
    for (i, found) in found[1..].iter().enumerate() {
        let expected = expected.narrow(0, i, 1).unwrap().squeeze(0).unwrap().permute((2, 0, 1, 3)).unwrap();
        assert!(error(found, &expected.contiguous().unwrap()) < ROUNDED, "{i}");
    }
}

#[test]
fn eight_bits_are_the_authors() {
    let expected = values(&fixture("llff.stored"));
    let original = values(&fixture("llff.mpis"));
    for (i, expected) in expected.iter().enumerate() {
        let value = f64::from(stored(original[i])) / 255.0;
        let value = if i % 4 == 3 { (value + 1e-8).min(1.0) } else { value };
        assert!((value - expected).abs() < 1e-12, "{i}");
    }
}

/// The renderer's own way, from 8 bits, is that of the tensors' operations.
#[test]
fn a_renderer_shows_what_the_operations_give() {
    let loaded = |mpi: &Mpi| {
        let number = |(i, value): (usize, &u8)| {
            let value = f64::from(*value) / 255.0;
            if i % 4 == 3 { (value + 1e-8).min(1.0) } else { value }
        };
        f64s(mpi.planes.iter().enumerate().map(number).collect(), &[4, HEIGHT, WIDTH, 4])
    };
    let all: Vec<Mpi> = (0..6).map(|view| Mpi::new(eyes()[view], &mpi(view)).unwrap()).collect();
    let renderings: Vec<(Tensor, f64)> =
        weights(5).into_iter().map(|(view, weight)| (rendered(view, &loaded(&all[view])), weight)).collect();
    let total: f64 = renderings.iter().map(|(_, weight)| weight).sum();
    let expected = blend(renderings, None).unwrap();
    assert!(total > 0.0);
    let mpis = made(all, planes());
    let renderer = PlanesRenderer { mpis, eyes: eyes(), blend: 5, background: None };
    let flat = |i: usize| goal_rays().iter().flat_map(|ray| if i == 0 { ray.0 } else { ray.1 }).collect::<Vec<f64>>();
    let [origins, directions] = [0, 1].map(|i| f64s(flat(i), &[48, 3]));
    let rendered = renderer.render(&Rays::new(origins, directions.clone(), directions).unwrap()).unwrap();
    assert!(error(&rendered.rgb, &expected.rgb) < 1e-9);
    let expected: Vec<f64> = values(&expected.acc).into_iter().map(|acc| acc.min(1.0)).collect();
    assert!(error(&rendered.acc, &f64s(expected, &[48])) < 1e-9);
}
