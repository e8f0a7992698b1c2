//! Kernels against sums in f64 of what they read, and each implementation against the portable one.

use super::panels::{Form, Masks, Packed, Slab, filled_up, padded};
use super::product::{Bias, ByRay, Finish, Lhs, Out, Rows, Source};
use super::*;
use crate::simd::{round, tests::on_each};

/// Numbers in -1..1 of all magnitudes, some of them 0, -0 or subnormal.
fn numbers(seed: usize, count: usize) -> Vec<f32> {
    let number = |i: usize| {
        let bits = ((seed * 1_000_003 + i + 1) as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let unit = (bits >> 40) as f32 / (1 << 23) as f32 - 1.0;
        match bits >> 8 & 31 {
            0 => 0.0,
            1 => -0.0,
            2 => unit * 1e-40,
            3 => unit * 1e-3,
            _ => unit,
        }
    };
    (0..count).map(number).collect()
}

/// As the field's precision has it between layers.
fn kept(pairs: bool, value: f32) -> f64 {
    f64::from(if pairs { f32::from_bits(round(value) << 16) } else { value })
}

/// The two numbers of a word of bf16.
fn numbers_of(word: f32) -> [f32; 2] {
    [word.to_bits() << 16, word.to_bits() & 0xffff_0000].map(f32::from_bits)
}

fn forms(pairs: bool) -> (Form, Form) {
    if pairs { (Form::Across, Form::Down) } else { (Form::Single, Form::Single) }
}

/// Rows in panels, as the left side of products and as gradients of weights read them.
fn slabs(pairs: bool, values: &[f32], rows: usize, columns: usize) -> (Slab, Slab) {
    let (left, right) = forms(pairs);
    let (mut left, mut right) = (Slab::new(left, rows, columns), Slab::new(right, rows, columns));
    let across = pairs.then(|| left.rows_mut(0));
    Rows::Given(values).finish(rows, columns, Finish { across, panels: Some(right.rows_mut(0)), ..Finish::default() });
    if !pairs {
        let panels = Some(left.rows_mut(0));
        Rows::Given(values).finish(rows, columns, Finish { panels, ..Finish::default() });
    }
    (left, right)
}

/// The numbers of rows in panels.
fn read(slab: &Slab, rows: usize, columns: usize) -> Vec<f32> {
    let panels = slab.rows(0);
    let number = |row: usize, column: usize| {
        let word = |row: usize, column: usize| panels.words[panels.shape.offset(row, column)];
        match panels.shape.form {
            Form::Single => word(row, column),
            Form::Across => numbers_of(word(row, column / 2 * 2))[column % 2],
            Form::Down => numbers_of(word(row, column))[row % 2],
        }
    };
    (0..rows * columns).map(|i| number(i / columns, i % columns)).collect()
}

/// What a layer gives in all ways in which it is used.
#[derive(Debug, PartialEq)]
struct Found {
    parts: Vec<(&'static str, Vec<u32>)>,
}

impl Found {
    fn of(&self, name: &str) -> Vec<f32> {
        let (_, bits) = self.parts.iter().find(|(part, _)| *part == name).unwrap();
        bits.iter().map(|bits| f32::from_bits(*bits)).collect()
    }
}

#[derive(Clone, Copy, Debug)]
struct Case {
    pairs: bool,
    rows: usize,
    inputs: usize,
    outputs: usize,
}

struct Given {
    x: Vec<f32>,
    encoded: Vec<f32>,
    weights: Vec<f32>,
    bias: Vec<f32>,
    d: Vec<f32>,
    delta: Vec<f32>,
}

impl Case {
    const ENCODED: usize = 7;

    fn given(self) -> Given {
        let Case { rows, inputs, outputs, .. } = self;
        Given {
            x: numbers(1, rows * inputs),
            encoded: numbers(2, rows * Case::ENCODED),
            weights: numbers(3, outputs * (Case::ENCODED + inputs)),
            bias: numbers(4, outputs),
            d: numbers(5, rows),
            delta: numbers(6, rows * outputs),
        }
    }

    fn run(self, given: &Given) -> Found {
        let Case { pairs, rows, inputs, outputs } = self;
        let all = Case::ENCODED + inputs;
        let (x, x_down) = slabs(pairs, &given.x, rows, inputs);
        let of_encoding = Packed::new(false, (outputs, all), (Case::ENCODED, 1), &given.weights);
        let of_below = Packed::new(pairs, (outputs, all), (inputs, 1), &given.weights[Case::ENCODED..]);
        let sources = [
            Source { lhs: Lhs::Rows(&given.encoded), weights: &of_encoding },
            Source { lhs: Lhs::Panels(x.rows(0)), weights: &of_below },
        ];
        let bias = filled_up(&given.bias);
        let (left, right) = forms(pairs);
        let (mut y, mut y_down) = (Slab::new(left, rows, outputs), Slab::new(right, rows, outputs));
        let mut masks = Masks::new(Form::Single, rows, outputs);
        let mut plain = vec![0.5f32; rows * outputs];
        let finish = Finish {
            bias: Some(Bias { values: &bias, of_rays: (0, 0) }),
            relu: true,
            positive: Some(masks.rows_mut(0)),
            out: Some(Out { values: &mut plain, stride: outputs, accumulate: false }),
            across: pairs.then(|| y.rows_mut(0)),
            delta: Some(&given.delta),
            panels: Some(y_down.rows_mut(0)),
            ..Finish::default()
        };
        Rows::Products(&sources).finish(rows, outputs, finish);
        let mut added = vec![0.5f32; rows * outputs];
        let out = Some(Out { values: &mut added, stride: outputs, accumulate: true });
        Rows::Products(&sources).finish(rows, outputs, Finish { out, ..Finish::default() });
        let y = if pairs { y } else { slabs(pairs, &given.delta, rows, outputs).0 };
        let head = Head::new(&given.weights[..2 * outputs], &given.bias[..2.min(outputs)].repeat(2)[..2]);
        let mut of_head = vec![0f32; 2 * rows];
        head_forward(&head, &[y.rows(0)], &mut of_head);
        let mut head_weights = numbers(7, 2 * outputs);
        head_gradient(&of_head, 2, y_down.rows(0), &mut head_weights);

        // Back: dz stands for the numbers that were given to the layer above.
        let (dz, dz_down) = slabs(pairs, &given.delta, rows, outputs);
        let mut weights = numbers(8, outputs * all);
        weight_gradient(dz_down.rows(0), x_down.rows(0), rows, &mut weights[Case::ENCODED..], all);
        let mut of_bias = numbers(9, outputs);
        bias_gradient(dz_down.rows(0), rows, &mut of_bias);
        let back = Packed::new(pairs, (inputs, 1), (outputs, all), &given.weights[Case::ENCODED..]);
        let mut input_masks = Masks::new(Form::Single, rows, inputs);
        let positive = Some(input_masks.rows_mut(0));
        Rows::Given(&given.x).finish(rows, inputs, Finish { positive, ..Finish::default() });
        let rays: Vec<usize> = (0..rows).map(|row| row / 3).collect();
        let mut by_ray = vec![0f32; rows.div_ceil(3) * padded(inputs)];
        let (mut dx, mut dx_out) = (Slab::new(right, rows, inputs), vec![0f32; rows * inputs]);
        let row = filled_up(&given.weights[..inputs]);
        let finish = Finish {
            density: Some((&given.d, &row)),
            out: Some(Out { values: &mut dx_out, stride: inputs, accumulate: false }),
            mask: Some(input_masks.rows(0)),
            by_ray: Some(ByRay { sums: &mut by_ray, rays: &rays }),
            panels: Some(dx.rows_mut(0)),
            ..Finish::default()
        };
        let sources = [Source { lhs: Lhs::Panels(dz.rows(0)), weights: &back }];
        Rows::Products(&sources).finish(rows, inputs, finish);
        let mut few = vec![0f32; rows * inputs];
        let rows_of_weights = [row.clone(), row].concat();
        let out = Some(Out { values: &mut few, stride: inputs, accumulate: false });
        Rows::Few { dz: &of_head, weights: &rows_of_weights, outputs: 2 }.finish(
            rows,
            inputs,
            Finish { out, ..Finish::default() },
        );
        let parts = [
            ("plain", plain),
            ("added", added),
            ("y", read(&y, rows, outputs)),
            ("y down", read(&y_down, rows, outputs)),
            ("head", of_head),
            ("head weights", head_weights),
            ("weights", weights),
            ("bias", of_bias),
            ("dx", read(&dx, rows, inputs)),
            ("dx out", dx_out),
            ("by ray", by_ray),
            ("few", few),
        ];
        Found { parts: parts.map(|(name, values)| (name, values.iter().map(|v| v.to_bits()).collect())).into() }
    }
}

fn cases() -> impl Iterator<Item = Case> {
    let sizes = [(1, 1), (2, 31), (4, 64), (63, 32), (64, 33), (65, 100), (130, 4), (96, 64)];
    let rows = [0, 1, 2, 5, 6, 7, 12, 27];
    let each = move |pairs| {
        sizes
            .into_iter()
            .flat_map(move |(inputs, outputs)| rows.into_iter().map(move |rows| Case { pairs, rows, inputs, outputs }))
    };
    [false, true].into_iter().flat_map(each)
}

fn assert_near(found: f32, expected: f64, scale: f64, what: &str) {
    assert!((f64::from(found) - expected).abs() <= scale, "{what}: {found}, expected {expected} within {scale:e}");
}

#[test]
fn products_are_those_of_f64() {
    for case in cases() {
        let Case { pairs, rows, inputs, outputs } = case;
        let (given, all) = (case.given(), Case::ENCODED + inputs);
        let found = case.run(&given);
        let sum_of = |count: usize, term: &dyn Fn(usize) -> f64| -> f64 { (0..count).map(term).sum() };
        let (plain, down) = (found.of("plain"), found.of("y down"));
        // A sum of n products of magnitude 1 is off by less than n roundings.
        let near = 1e-7 * (all + outputs + rows) as f64;
        let rounding = if pairs { 4e-3 } else { 0.0 };
        for (row, o) in (0..rows * outputs).map(|i| (i / outputs, i % outputs)) {
            let weight = |i: usize| given.weights[o * all + i];
            let of_encoding =
                sum_of(Case::ENCODED, &|i| f64::from(given.encoded[row * Case::ENCODED + i]) * f64::from(weight(i)));
            let of_below =
                sum_of(inputs, &|i| kept(pairs, given.x[row * inputs + i]) * kept(pairs, weight(Case::ENCODED + i)));
            let added = found.of("added")[row * outputs + o];
            assert_near(added, of_encoding + of_below + 0.5, near, &format!("{case:?} added"));
            let y = (of_encoding + of_below + f64::from(given.bias[o])).max(0.0);
            assert_near(plain[row * outputs + o], y, near, &format!("{case:?} forward"));
            let y = y + f64::from(given.delta[row * outputs + o]);
            assert_near(down[row * outputs + o], y, near + rounding * y.abs(), &format!("{case:?} layout"));
        }
        let (dx, before) = (found.of("dx out"), numbers(8, outputs * all));
        for (row, i) in (0..rows * inputs).map(|at| (at / inputs, at % inputs)) {
            let of_dz = sum_of(outputs, &|o| {
                kept(pairs, given.delta[row * outputs + o]) * kept(pairs, given.weights[o * all + Case::ENCODED + i])
            });
            let expected = of_dz + f64::from(given.d[row]) * f64::from(given.weights[i]);
            assert_near(dx[row * inputs + i], expected, near, &format!("{case:?} backward"));
            let masked = if given.x[row * inputs + i] > 0.0 { expected } else { 0.0 };
            let found = found.of("dx")[row * inputs + i];
            assert_near(found, masked, near + rounding * masked.abs(), &format!("{case:?} mask"));
        }
        let weights = found.of("weights");
        for (o, i) in (0..outputs * inputs).map(|at| (at / inputs, at % inputs)) {
            let gradient = sum_of(rows, &|row| {
                kept(pairs, given.delta[row * outputs + o]) * kept(pairs, given.x[row * inputs + i])
            });
            let at = o * all + Case::ENCODED + i;
            assert_near(weights[at], gradient + f64::from(before[at]), near, &format!("{case:?} weights"));
        }
        for (o, found) in found.of("bias").into_iter().enumerate() {
            let gradient = sum_of(rows, &|row| kept(pairs, given.delta[row * outputs + o]));
            assert_near(found, gradient + f64::from(numbers(9, outputs)[o]), near, &format!("{case:?} bias"));
        }
        let (y, head) = (found.of("y"), found.of("head"));
        for (row, j) in (0..2 * rows).map(|at| (at / 2, at % 2)) {
            let dot = sum_of(outputs, &|o| f64::from(y[row * outputs + o]) * f64::from(given.weights[j * outputs + o]));
            let bias = f64::from(given.bias[j.min(outputs - 1)]);
            assert_near(head[2 * row + j], dot + bias, near, &format!("{case:?} head"));
        }
        for (j, o) in (0..2 * outputs).map(|at| (at / outputs, at % outputs)) {
            let gradient = sum_of(rows, &|row| f64::from(head[2 * row + j]) * f64::from(down[row * outputs + o]));
            let expected = gradient + f64::from(numbers(7, 2 * outputs)[j * outputs + o]);
            let off = near * (outputs as f64 + expected.abs());
            assert_near(found.of("head weights")[j * outputs + o], expected, off, &format!("{case:?} head's weights"));
        }
    }
}

#[test]
fn every_implementation_gives_the_same_bits() {
    for case in cases() {
        let given = case.given();
        let found = on_each(|| case.run(&given));
        for (processor, other) in &found[1..] {
            for (found, expected) in other.parts.iter().zip(&found[0].1.parts) {
                assert_eq!(found, expected, "{case:?} on {processor:?}");
            }
        }
    }
}

/// Pairs are rounded once a product and sum, with sums near 0 and results that are subnormal.
#[test]
fn pairs_of_all_magnitudes_give_the_same_bits() {
    let (rows, inputs, outputs) = (64, 64, 64);
    let number = |i: usize| f32::from_bits(((i as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) as u32);
    let finite = |from: usize, count: usize| -> Vec<f32> {
        (from..).map(number).filter(|v| v.is_finite() && v.abs() < 1e18).take(count).collect()
    };
    let (x, weights) = (finite(0, rows * inputs), finite(1 << 20, inputs * outputs));
    let found = on_each(|| {
        let (left, _) = slabs(true, &x, rows, inputs);
        let packed = Packed::new(true, (outputs, inputs), (inputs, 1), &weights);
        let mut y = vec![0f32; rows * outputs];
        let out = Some(Out { values: &mut y, stride: outputs, accumulate: false });
        let sources = [Source { lhs: Lhs::Panels(left.rows(0)), weights: &packed }];
        Rows::Products(&sources).finish(rows, outputs, Finish { out, ..Finish::default() });
        y.into_iter().map(f32::to_bits).collect::<Vec<u32>>()
    });
    assert!(found.iter().all(|(_, bits)| *bits == found[0].1));
}

#[test]
fn nan_stays_nan() {
    for pairs in [false, true] {
        let case = Case { pairs, rows: 5, inputs: 40, outputs: 24 };
        let mut given = case.given();
        given.x[2 * 40 + 3] = f32::NAN;
        let found = case.run(&given);
        let (plain, weights) = (found.of("plain"), found.of("weights"));
        assert!(plain[2 * 24..3 * 24].iter().all(|v| v.is_nan()) && plain[..2 * 24].iter().all(|v| v.is_finite()));
        let of_input = |i: usize| (0..24).map(move |o| o * 47 + 7 + i);
        assert!(of_input(3).all(|at| weights[at].is_nan()) && of_input(4).all(|at| weights[at].is_finite()));
    }
}

/// Rows out of the midst of others, neighbours or not, from odd and even numbers on.
#[test]
fn rows_are_brought_together() {
    let (rows, columns) = (41, 70);
    let values = numbers(1, rows * columns);
    for pairs in [false, true] {
        let (_, all) = slabs(pairs, &values, rows, columns);
        let mut masks = Masks::new(Form::Single, rows, columns);
        let positive = Some(masks.rows_mut(0));
        Rows::Given(&values).finish(rows, columns, Finish { positive, ..Finish::default() });
        let mut gathered = panels::Gathered::default();
        for chosen in [vec![0, 1, 2], vec![3, 4, 5], vec![1, 2, 8, 9, 11, 40], vec![40], vec![7], vec![2, 3, 5]] {
            let given: Vec<f32> = chosen.iter().flat_map(|row| &values[row * columns..][..columns]).copied().collect();
            let (_, expected) = slabs(pairs, &given, chosen.len(), columns);
            let (mut found_sum, mut expected_sum) = (vec![0f32; columns], vec![0f32; columns]);
            bias_gradient(expected.rows(0), chosen.len(), &mut expected_sum);
            let found = gathered.rows(&all, &chosen);
            let number = |row: usize, column: usize| {
                let word = found.words[found.shape.offset(found.start + row, column)];
                if pairs { numbers_of(word)[row % 2] } else { word }
            };
            for (row, column) in (0..chosen.len() * columns).map(|at| (at / columns, at % columns)) {
                let kept = kept(pairs, given[row * columns + column]);
                assert_eq!(f64::from(number(row, column)), kept, "{pairs} {chosen:?}");
            }
            if chosen.len() % 2 == 0 {
                bias_gradient(found, chosen.len(), &mut found_sum);
                assert_eq!(found_sum, expected_sum, "{pairs} {chosen:?}");
            }
            let bits = gathered.masks(&masks, &chosen);
            for (row, column) in (0..chosen.len() * columns).map(|at| (at / columns, at % columns)) {
                let word = bits.words[bits.shape.offset(bits.start + row, column) / 16];
                assert_eq!(word >> (column % 16) & 1 == 1, given[row * columns + column] > 0.0);
            }
        }
    }
}
