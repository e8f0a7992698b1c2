#![allow(clippy::needless_range_loop, reason = "rows of several tables are counted")]

use super::*;
use crate::grids::reference::{channels_last, error, fixture, on_any_threads, ramp, single, values, with_gradients};
use candle_core::Var;

fn lines(origins: &Tensor, directions: &Tensor) -> Arc<[Line]> {
    let rows = |tensor: &Tensor| tensor.to_vec2::<f64>().unwrap().into_iter().map(|row| [row[0], row[1], row[2]]);
    rows(origins).zip(rows(directions)).map(|(origin, direction)| Line { origin, direction }).collect()
}

fn reference_march() -> March {
    let lines = lines(&fixture("nv.march.o"), &fixture("nv.march.u"));
    March { lines, step: values(&fixture("nv.march.dt"))[0], pace: Pace::Even }
}

fn reference_grids() -> [Var; 2] {
    ["nv.march.template", "nv.march.warp"].map(|name| Var::from_tensor(&channels_last(&fixture(name))).unwrap())
}

/// Rays in all directions around and in the box, some of them beside it.
fn drawn(rays: usize, pace: Pace) -> March {
    let origins = (ramp(&[rays, 3], 0.2) * 2.5).unwrap();
    let towards = ((ramp(&[rays, 3], 1.1) * 0.9).unwrap() - &origins).unwrap();
    let unit = towards.broadcast_div(&towards.sqr().unwrap().sum_keepdim(1).unwrap().sqrt().unwrap()).unwrap();
    March { lines: lines(&origins, &unit), step: 0.13, pace }
}

const DRAWN: Pace = Pace::Drawn { jitter: 0.3, seed: 4, step: 7 };

fn identity() -> Tensor {
    let at = |i: usize| i as f64 - 1.0;
    let values = (0..27).flat_map(|i| [at(i % 3), at(i / 3 % 3), at(i / 9)]).collect::<Vec<f64>>();
    Tensor::from_vec(values, (3, 3, 3, 3), &Device::Cpu).unwrap()
}

/// A volume of which rays are filled or not, and a warp near the identity.
fn grids() -> [Tensor; 2] {
    let template = ((ramp(&[5, 6, 4, 4], 0.5) + 1.02).unwrap() * 0.9).unwrap();
    let warp = (identity() * 0.8).unwrap();
    [template, (warp + (ramp(&[3, 3, 3, 3], 0.1) * 0.05).unwrap()).unwrap()]
}

/// Result and gradients of `sum(out * cotangent)` in template and warp.
fn all_of(march: &March, grids: &[Tensor; 2]) -> Vec<Tensor> {
    let cotangent = ramp(&[march.lines.len(), 5], 0.6).to_dtype(grids[0].dtype()).unwrap();
    with_gradients(grids, &cotangent, |[template, warp]| march.forward(template, Some(warp)))
}

/// Asserts that positions and values of all samples are the original's, to 1e-9 of their size.
pub(crate) fn check_samples(march: &March, template: &Tensor, warp: &Tensor, name: &str) {
    let sides = |grid: &Tensor| Lattice { sides: [grid.dims()[0], grid.dims()[1], grid.dims()[2]] };
    let operation = Marched { march: march.clone(), template: sides(template), warp: Some(sides(warp)) };
    let (template, warp) = (values(template), values(warp));
    let expected = |what: &str| fixture(&format!("{name}.samples.{what}")).to_vec3::<f64>().unwrap();
    let alpha = fixture(&format!("{name}.samples.alpha")).to_vec2::<f64>().unwrap();
    let (points, rgb) = (expected("points"), expected("rgb"));
    let mut compared = 0;
    for ray in 0..points.len() {
        let mut mine = Vec::new();
        operation.follow(ray, &template, &warp, |sample| mine.push(sample));
        let is_inside = |k: &usize| is_inside([points[ray][*k][0], points[ray][*k][1], points[ray][*k][2]]);
        for (sample, k) in mine.iter().zip((0..points[ray].len()).filter(is_inside)) {
            let at = march.lines[ray].at(sample.t);
            let theirs = [&points[ray][k][..], &rgb[ray][k][..], &alpha[ray][k..=k]].concat();
            for (a, b) in at.iter().chain(&sample.value).zip(theirs) {
                assert!((a - b).abs() < 1e-9 * b.abs().max(1.0), "{name}, ray {ray}, sample {k}: {a} {b}");
            }
            compared += 1;
        }
    }
    assert!(compared > 20, "{compared}");
}

#[test]
fn samples_are_the_originals() {
    let [template, warp] = reference_grids();
    check_samples(&reference_march(), &template, &warp, "nv.march");
}

/// Colours, losses and all gradients of the original's march through given grids. The original also scales and shifts
/// the colours of each of its two cameras, which saw three rays each, and has a background for each ray.
#[test]
fn rays_and_gradients_are_the_originals() {
    let march = reference_march();
    let [template, warp] = reference_grids();
    let out = march.forward(&template, Some(warp.as_tensor())).unwrap();
    let (rgb, acc) = (out.narrow(1, 0, 3).unwrap(), out.narrow(1, 3, 1).unwrap());
    let behind = (1.0 - &acc).unwrap().broadcast_mul(&fixture("nv.march.bg").relu().unwrap()).unwrap();
    assert!(error(&(&rgb + &behind).unwrap(), &fixture("nv.march.plain.rgb")) < 1e-12);
    assert!(error(&acc, &fixture("nv.march.plain.acc")) < 1e-12);
    let of_cameras = |what: usize| {
        let each = fixture("nv.march.calibration").narrow(1, what, 1).unwrap().broadcast_as((2, 3, 3)).unwrap();
        each.contiguous().unwrap().reshape((6, 3)).unwrap()
    };
    let shown = (((rgb * of_cameras(0)).unwrap() + of_cameras(1)).unwrap() + behind).unwrap();
    assert!(error(&shown, &fixture("nv.march.rgb")) < 1e-12);
    let image = ((shown - fixture("nv.march.target")).unwrap() / 25.0).unwrap().sqr().unwrap().mean_all().unwrap();
    let prior = ((&acc + 0.1).unwrap().log().unwrap() + (1.1 - &acc).unwrap().log().unwrap()).unwrap();
    let prior = (prior.mean_all().unwrap() + 2.20727).unwrap();
    assert!(error(&image, &fixture("nv.march.irgbmse")) < 1e-12);
    assert!(error(&prior, &fixture("nv.march.alphapr").flatten_all().unwrap().mean(0).unwrap()) < 1e-12);
    let loss = (image + (prior * 0.01).unwrap()).unwrap();
    assert!(error(&loss, &fixture("nv.march.loss")) < 1e-12);
    let gradients = loss.backward().unwrap();
    let error_of = |var: &Var, name: &str| error(gradients.get(var).unwrap(), &channels_last(&fixture(name)));
    let of_template = error_of(&template, "nv.march.grad.template");
    assert!(of_template < 1e-6, "{of_template}");
    assert!(error_of(&warp, "nv.march.grad.warp") < 1e-11);
}

/// Where rays are filled or not, and steps drawn or not.
#[test]
fn marches_in_single_precision_are_those_in_double_on_any_number_of_threads() {
    for (march, name) in [(drawn(150, Pace::Even), "even"), (drawn(150, DRAWN), "drawn")] {
        let double = all_of(&march, &grids());
        let full = values(&double[0].narrow(1, 3, 1).unwrap()).iter().filter(|acc| **acc == 1.0).count();
        assert!((20..130).contains(&full), "{full} rays are full");
        let in_f32 = grids().each_ref().map(single);
        let found = on_any_threads(|| all_of(&march, &in_f32));
        for index in 0..3 {
            let error = error(&found[index], &double[index]);
            assert!(error < 2e-4, "{name} {index}: {error}");
        }
    }
}

#[test]
fn a_warp_that_moves_nothing_is_none() {
    let (march, [template, _]) = (drawn(150, DRAWN), grids());
    let template = Var::from_tensor(&template).unwrap();
    let slope = |out: Tensor| out.sqr().unwrap().sum_all().unwrap().backward().unwrap().get(&template).unwrap().clone();
    let of = |warp: Option<&Tensor>| slope(march.forward(&template, warp).unwrap());
    assert!(error(&of(None), &of(Some(&identity()))) < 1e-11);
}
