//! The kernels against the reference, and the reference against closed forms and finite differences.

use super::Contraction;
use super::*;
use crate::adam::Update;
use crate::simd::tests::on_each;

mod operators;
mod reference;

const BOTH: [Interpolation; 2] = [Interpolation::Linear, Interpolation::Smoothstep];

/// Numbers in 0..1 that look random.
fn numbers(count: usize, seed: u64) -> Vec<f64> {
    let number = |i: usize| {
        let mut x = (seed << 32 | i as u64).wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        x = (x ^ x >> 32).wrapping_mul(0xd6e8_feb8_6659_fd93);
        ((x ^ x >> 32) >> 11) as f64 / (1u64 << 53) as f64
    };
    (0..count).map(number).collect()
}

/// The same about 0.
fn signed(count: usize, seed: u64) -> Vec<f64> {
    numbers(count, seed).iter().map(|x| 2.0 * x - 1.0).collect()
}

/// The gradients in the encodings themselves.
fn record<'a>(points: &'a [f32], d_out: &'a [f32]) -> EncodingGradients<'a> {
    EncodingGradients { points, d_out, operators: None }
}

fn narrow(values: &[f64]) -> Vec<f32> {
    values.iter().map(|value| *value as f32).collect()
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|value| value.to_bits()).collect()
}

/// The largest difference, over 1 and the largest magnitude.
fn off(found: &[f32], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let scale = expected.iter().fold(1f64, |most, value| most.max(value.abs()));
    let differences = found.iter().zip(expected).map(|(a, b)| (f64::from(*a) - b).abs());
    differences.fold(0f64, |most, difference| if difference > most || difference.is_nan() { difference } else { most })
        / scale
}

/// Points that stand in every level's cell a little away from its faces: rounding moves none to another cell.
fn inner_points(grid: &HashGrid, count: usize) -> Vec<f64> {
    let inner = |point: &[f64]| {
        grid.levels.iter().all(|level| {
            point.iter().all(|x| {
                let position = (x * f64::from(level.resolution)).fract();
                (0.01..0.99).contains(&position)
            })
        })
    };
    let candidates = numbers(3000 * 30, 1).iter().map(|x| f64::from(*x as f32)).collect::<Vec<_>>();
    let found: Vec<f64> =
        candidates.chunks_exact(3).filter(|point| inner(point)).take(count).flatten().copied().collect();
    assert_eq!(found.len(), 3 * count);
    found
}

/// Grids of each kind: dense, hashed with few and with many vertices an entry, one level, each number of features.
fn grids() -> Vec<HashGrid> {
    let sizes =
        [(1, 2, 17, (4, 4)), (5, 2, 12, (4, 64)), (4, 2, 3, (5, 40)), (16, 2, 14, (16, 512)), (3, 1, 10, (3, 50))];
    let mut grids = Vec::new();
    for interpolation in BOTH {
        let of = |(levels, features, log2, ends)| HashGrid::new(levels, features, log2, ends, interpolation);
        grids.extend(sizes.into_iter().map(of));
        grids.extend((3..=8).map(|features| of((3, features, 9, (4, 33)))));
    }
    grids
}

#[test]
fn sizes_are_the_paper_s() {
    let grid = HashGrid::new(16, 2, 14, (16, 512), Interpolation::Linear);
    let resolutions: Vec<u32> = grid.levels().iter().map(|level| level.resolution).collect();
    assert_eq!(resolutions, [16, 20, 25, 32, 40, 50, 64, 80, 101, 128, 161, 203, 256, 322, 406, 512]);
    assert_eq!((grid.levels()[0].entries, grid.levels()[0].dense), (17 * 17 * 17, true));
    assert!(grid.levels()[2..].iter().all(|level| !level.dense && level.entries == 1 << 14));
    assert_eq!(grid.levels()[3].offset, 17usize.pow(3) + 21usize.pow(3) + (1 << 14));
    assert_eq!((grid.entries(), grid.channels()), (17usize.pow(3) + 21usize.pow(3) + 14 * (1 << 14), 32));
    let ends = HashGrid::new(7, 2, 19, (16, 2048), Interpolation::Linear);
    assert_eq!((ends.levels()[0].resolution, ends.levels()[6].resolution), (16, 2048));
}

#[test]
fn entries_are_those_of_equation_4() {
    let level = Level { resolution: 1000, entries: 1 << 14, offset: 0, dense: false };
    assert_eq!(level.entry([5, 0, 0]), 5);
    assert_eq!(level.entry([0, 1, 0]), 2_654_435_761 % (1 << 14));
    assert_eq!(
        level.entry([7, 3, 2]),
        (7 ^ (3 * 2_654_435_761u64 % (1 << 32)) ^ (2 * 805_459_861)) as usize % (1 << 14)
    );
}

#[test]
fn kernels_follow_the_reference_with_the_same_bits_on_each_processor() {
    for grid in grids() {
        for count in [1, 15, 16, 37, 530] {
            let points = inner_points(&grid, count);
            let (tables, d_out) = (signed(grid.entries() * grid.features(), 2), signed(count * grid.channels(), 3));
            let [points32, tables32, d_out32] = [&points, &tables, &d_out].map(|values| narrow(values));
            let [tables, d_out] =
                [&tables32, &d_out32].map(|values| values.iter().map(|x| f64::from(*x)).collect::<Vec<_>>());
            let expected = [
                reference::encode(&grid, &tables, &points, None),
                reference::point_gradient(&grid, &tables, &points, &d_out),
                reference::table_gradient(&grid, &points, None, &d_out),
            ];
            let all = on_each(|| {
                let mut found = [vec![0f32; d_out.len()], vec![0.0; points.len()], vec![0.0; tables.len()]];
                grid.encode(&tables32, &points32, None, &mut found[0]);
                grid.point_gradient(&tables32, &points32, &d_out32, &mut found[1]);
                for (l, level) in grid.levels.iter().enumerate() {
                    let sum = &mut found[2][level.offset * grid.features..][..level.entries * grid.features];
                    grid.scatter(l, record(&points32, &d_out32), sum);
                }
                found
            });
            for (processor, found) in &all {
                // Positions in cells lose digits as resolution grows: 512 of 2^24.
                for (found, (expected, most)) in found.iter().zip(expected.iter().zip([1e-4, 3e-4, 1e-4])) {
                    let off = off(found, expected);
                    assert!(off < most, "{grid:?} {processor:?} {count}: {off}");
                }
                for (found, first) in found.iter().zip(&all[0].1) {
                    assert_eq!(bits(found), bits(first), "{grid:?} {processor:?} {count}");
                }
            }
        }
    }
}

/// Dyadic numbers, of which nothing is rounded.
#[test]
fn a_linear_function_is_reproduced_exactly() {
    let grid = HashGrid::new(3, 2, 15, (4, 16), Interpolation::Linear);
    assert!(grid.levels.iter().all(|level| level.dense));
    let slope = [[0.5f32, -1.25, 2.0], [3.0, 0.25, -0.75]];
    let linear = |feature: usize, x: [f32; 3]| 0.125 + (0..3).map(|axis| slope[feature][axis] * x[axis]).sum::<f32>();
    let mut tables = vec![0.0; grid.entries() * 2];
    for level in &grid.levels {
        let side = level.resolution + 1;
        for number in 0..side.pow(3) {
            let vertex = [number % side, number / side % side, number / (side * side)];
            let entry = level.offset + level.entry(vertex);
            for feature in 0..2 {
                tables[2 * entry + feature] = linear(feature, vertex.map(|v| v as f32 / level.resolution as f32));
            }
        }
    }
    let points: Vec<f32> = numbers(300, 7).iter().map(|x| (x * 1024.0).round() as f32 / 1024.0).collect();
    let points = [&points[..], &[0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.25, 1.0, 0.0]].concat();
    let mut out = vec![0.0; points.len() / 3 * 6];
    grid.encode(&tables, &points, None, &mut out);
    let d_out: Vec<f32> = (0..out.len()).map(|i| [1.0, 0.0, 0.0, 0.0, 0.0, 0.5][i % 6]).collect();
    let mut d_points = vec![0.0; points.len()];
    grid.point_gradient(&tables, &points, &d_out, &mut d_points);
    for ((point, out), d) in points.as_chunks::<3>().0.iter().zip(out.chunks_exact(6)).zip(d_points.chunks_exact(3)) {
        for (channel, found) in out.iter().enumerate() {
            assert_eq!(*found, linear(channel % 2, *point), "{point:?} {channel}");
        }
        assert_eq!(d, std::array::from_fn::<f32, 3, _>(|axis| slope[0][axis] + 0.5 * slope[1][axis]), "{point:?}");
    }
}

/// At a vertex only its own entry counts; gradients are those of the cell above, on the last face of the one below.
#[test]
fn vertices_and_faces_belong_to_one_cell() {
    for interpolation in BOTH {
        for log2 in [3, 17] {
            let grid = HashGrid::new(1, 2, log2, (8, 8), interpolation);
            let tables = narrow(&signed(grid.entries() * 2, 8));
            for vertex in [[0, 0, 0], [8, 8, 8], [3, 8, 0], [5, 2, 7]] {
                let point = vertex.map(|v| v as f32 / 8.0);
                let mut out = [0.0; 2];
                grid.encode(&tables, &point, None, &mut out);
                assert_eq!(out, tables[2 * grid.levels[0].entry(vertex)..][..2], "{vertex:?}");
                let mut sum = vec![0.0; tables.len()];
                grid.table_gradient(&[record(&point, &[2.0, 3.0])], &mut sum);
                assert_eq!(sum[2 * grid.levels[0].entry(vertex)..][..2], [2.0, 3.0]);
                assert_eq!(sum.iter().filter(|value| **value != 0.0).count(), 2);
                let mut d_point = [0.0; 3];
                grid.point_gradient(&tables, &point, &[1.0, 0.0], &mut d_point);
                for axis in 0..3 {
                    let mut ends = [vertex; 2];
                    ends[0][axis] -= u32::from(vertex[axis] == 8);
                    ends[1][axis] = ends[0][axis] + 1;
                    let [low, high] = ends.map(|end| tables[2 * grid.levels[0].entry(end)]);
                    let expected = if interpolation == Interpolation::Linear { 8.0 * (high - low) } else { 0.0 };
                    assert_eq!(d_point[axis], expected, "{vertex:?} {axis}");
                }
            }
        }
    }
}

/// Vertices whose hashes agree read one entry, and what pulls on either is added up there.
#[test]
fn colliding_vertices_share_one_entry() {
    on_each(|| BOTH.map(colliding_vertices));

    fn colliding_vertices(interpolation: Interpolation) {
        let grid = HashGrid::new(1, 2, 8, (32, 32), interpolation);
        let level = &grid.levels()[0];
        let first = [3, 5, 7];
        let vertices = (0..32u32.pow(3)).map(|i| [i % 32, i / 32 % 32, i / 1024]);
        let second = vertices.into_iter().find(|&v| v != first && level.entry(v) == level.entry(first)).unwrap();
        let points: Vec<f32> = [first, second].concat().iter().map(|&k| k as f32 / 32.0).collect();
        let entry = 2 * level.entry(first);
        let tables = narrow(&signed(grid.entries() * 2, 12));
        let mut out = [0.0; 4];
        grid.encode(&tables, &points, None, &mut out);
        assert_eq!([&out[..2], &out[2..]], [&tables[entry..][..2]; 2], "at a vertex stands its entry alone");
        let mut sum = vec![0.0; tables.len()];
        grid.scatter(0, record(&points, &[1.0, -2.0, 0.5, 0.25]), &mut sum);
        assert_eq!(sum[entry..][..2], [1.5, -1.75]);
        sum[entry..][..2].fill(0.0);
        assert!(sum.iter().all(|value| *value == 0.0), "nothing lands elsewhere");
    }
}

#[test]
fn nan_stays_with_its_point() {
    on_each(|| {
        let grid = HashGrid::new(4, 2, 6, (4, 32), Interpolation::Linear);
        let tables = narrow(&signed(grid.entries() * 2, 10));
        let mut points = narrow(&numbers(60, 11));
        let mut expected = vec![0.0; 20 * 8];
        grid.encode(&tables, &points, None, &mut expected);
        points[3 * 7 + 1] = f32::NAN;
        let mut out = vec![0.0; 20 * 8];
        grid.encode(&tables, &points, None, &mut out);
        assert!(out[56..64].iter().all(|value| value.is_nan()));
        assert_eq!((&out[..56], &out[64..]), (&expected[..56], &expected[64..]));
        let mut d_points = vec![0.0; 60];
        grid.point_gradient(&tables, &points, &expected, &mut d_points);
        let nan: Vec<usize> = (0..60).filter(|i| d_points[*i].is_nan()).collect();
        assert!(nan.iter().all(|i| i / 3 == 7) && !nan.is_empty(), "{nan:?}");
        // Far outside there is no such cell, and nothing beyond the table is read.
        grid.encode(&tables, &[f32::MAX, f32::INFINITY, -1e9], None, &mut out[..8]);
    });
}

#[test]
fn table_gradients_have_the_same_bytes_for_any_number_of_threads() {
    let grid = HashGrid::new(8, 2, 8, (4, 64), Interpolation::Linear);
    let records: Vec<(Vec<f32>, Vec<f32>)> = [700, 0, 33, 1]
        .iter()
        .map(|n| (narrow(&numbers(3 * n, *n as u64)), narrow(&signed(n * grid.channels(), 99 + *n as u64))))
        .collect();
    let records: Vec<EncodingGradients> = records.iter().map(|(points, d_out)| record(points, d_out)).collect();
    let sums = [1, 2, 3].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        // What was there is written over.
        let mut sum = vec![f32::NAN; grid.entries() * 2];
        pool.install(|| grid.table_gradient(&records, &mut sum));
        sum
    });
    assert_eq!(bits(&sums[0]), bits(&sums[1]));
    assert_eq!(bits(&sums[0]), bits(&sums[2]));
    let all =
        |pick: fn(&EncodingGradients) -> Vec<f32>| records.iter().flat_map(pick).map(f64::from).collect::<Vec<_>>();
    let (points, d_out) = (all(|record| record.points.to_vec()), all(|record| record.d_out.to_vec()));
    assert!(off(&sums[0], &reference::table_gradient(&grid, &points, None, &d_out)) < 1e-5);
}

/// The way from the scene into the cube, and back. Nothing is at infinity.
#[test]
fn points_come_back_from_the_cube() {
    let points = [[-1.3, 0.1, 1.5], [1.9, 0.9, 3.9], [0.2, 0.4, 2.0], [7.0, -3.0, 11.0], [-300.0, 0.5, 2.5]];
    for contraction in CONTRACTIONS {
        let domain = Domain::new([-2.0, 0.0, 1.0], [2.0, 1.0, 4.0], contraction);
        for point in points {
            let (mut unit, mut inside) = ([0.0; 3], [false]);
            domain.map(&point, &mut unit, &mut inside);
            let back = domain.point_at(unit).unwrap();
            let is_near = |axis: usize| (back[axis] - point[axis]).abs() < 1e-9 * (1.0 + point[axis].abs().powi(2));
            let is_clamped = contraction == Contraction::None && !inside[0];
            assert!(is_clamped || (0..3).all(is_near), "{contraction:?} {point:?} {back:?}");
        }
        let corner = domain.point_at([1.0; 3]);
        assert_eq!(corner, (contraction == Contraction::None).then_some([2.0, 1.0, 4.0]), "{contraction:?}");
    }
}

const CONTRACTIONS: [Contraction; 3] = [Contraction::None, Contraction::Axes, Contraction::Ball];

#[test]
fn boxes_and_balls_lie_in_the_cube_as_the_equations_say() {
    let place = |contraction, points: &[f64]| {
        let domain = Domain::new([-2.0, 0.0, 1.0], [2.0, 1.0, 4.0], contraction);
        let (mut unit, mut inside) = (vec![0.0; points.len()], vec![false; points.len() / 3]);
        domain.map(points, &mut unit, &mut inside);
        (unit, inside)
    };
    let points = [-2.0, 0.0, 1.0, 2.0, 1.0, 4.0, 0.0, 0.5, 5.5, -1e12, 0.5, 2.5];
    let (unit, inside) = place(Contraction::None, &points);
    assert_eq!(unit, [0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.5, 0.5, 1.0, 0.0, 0.5, 0.5]);
    assert_eq!(inside, [true, true, false, false]);
    let (unit, inside) = place(Contraction::Axes, &points);
    assert_eq!(unit[..9], [0.25, 0.25, 0.25, 0.75, 0.75, 0.75, 0.5, 0.5, 0.875]);
    assert!(unit[9] >= 0.0 && unit[9] < 1e-11 && inside == [true; 4]);
    let (unit, inside) = place(Contraction::Ball, &points);
    let corner = 0.5 + 0.25 * (2.0 - 1.0 / 3f64.sqrt()) / 3f64.sqrt();
    assert!((3..6).all(|i| (unit[i] - corner).abs() < 1e-12));
    assert_eq!(unit[6..9], [0.5, 0.5, 0.875]);
    assert!(unit[9] >= 0.0 && unit[9] < 1e-11 && inside == [true; 4]);
    for contraction in CONTRACTIONS {
        for bad in [f64::NAN, f64::INFINITY] {
            let (unit, inside) = place(contraction, &[9.0, bad, 0.0, 0.0, 0.5, 2.5]);
            assert!(unit[..3].iter().all(|x| x.is_nan()) && inside == [true, true]);
            assert_eq!(unit[3..], [0.5; 3]);
        }
    }
}

#[test]
fn a_domain_s_jacobian_is_its_finite_difference() {
    for contraction in CONTRACTIONS {
        let domain = Domain::new([-2.0, 0.0, 1.0], [2.0, 1.0, 4.0], contraction);
        let points = [0.3, 0.6, 1.2, -3.1, 0.2, 2.0, 5.0, -4.0, 9.0, -1.9, 0.95, 3.9, 0.1, 0.4, 40.0];
        let d_unit = signed(points.len(), 13);
        let mut d_points = vec![0.0; points.len()];
        domain.backward(&points, &d_unit, &mut d_points);
        let loss = |points: &[f64]| {
            let (mut unit, mut inside) = (vec![0.0; points.len()], vec![false; points.len() / 3]);
            domain.map(points, &mut unit, &mut inside);
            let product = |i: usize| if inside[i / 3] { unit[i] * d_unit[i] } else { 0.0 };
            (0..points.len()).map(product).sum::<f64>()
        };
        const STEP: f64 = 1e-6;
        for i in 0..points.len() {
            let ends = [STEP, -STEP].map(|by| {
                let mut moved = points;
                moved[i] += by;
                loss(&moved)
            });
            let expected = (ends[0] - ends[1]) / (2.0 * STEP);
            assert!((expected - d_points[i]).abs() < 1e-8, "{contraction:?} {i}: {expected} {}", d_points[i]);
        }
    }
}

/// The scalar recursion of the paper where an entry has a gradient, nothing elsewhere.
#[test]
fn sparse_adam_moves_what_has_a_gradient() {
    for features in [1, 2, 3, 8] {
        let states = on_each(|| {
            let count = 101 * features;
            let start = narrow(&signed(count, 20));
            let mut state = [start.clone(), vec![0.0; count], vec![0.0; count]];
            let wide = |values: &Vec<f32>| values.iter().map(|x| f64::from(*x)).collect::<Vec<_>>();
            let mut expected = [wide(&state[0]), wide(&state[1]), wide(&state[2])];
            for t in 1..=5 {
                let mut gradient = narrow(&signed(count, 20 + t as u64));
                // Entries without gradient, and one of which only one feature has none.
                for (i, entry) in gradient.chunks_exact_mut(features).enumerate() {
                    match i {
                        7 if features > 1 => entry[0] = 0.0,
                        i if i % 3 != t as usize % 3 || i > 60 => entry.fill(0.0),
                        _ => {}
                    }
                }
                let corrections = [1.0 - 0.9f64.powi(t), 1.0 - 0.99f64.powi(t)];
                let adam = Update {
                    rate: 0.01 / corrections[0],
                    correction2: corrections[1],
                    betas: [0.9, 0.99],
                    epsilon: 1e-15,
                };
                let [values, first, second] = &mut state;
                adam.table(Moving { values, first, second }, &gradient, features);
                let [p, m, v] = &mut expected;
                for i in 0..count {
                    let entry = &gradient[i / features * features..][..features];
                    if entry.iter().any(|g| *g != 0.0) {
                        let g = f64::from(gradient[i]);
                        m[i] = 0.9 * m[i] + 0.1 * g;
                        v[i] = 0.99 * v[i] + 0.01 * g * g;
                        let step = 0.01 * (m[i] / corrections[0]) / ((v[i] / corrections[1]).sqrt() + 1e-15);
                        p[i] -= step;
                    }
                }
            }
            for (found, expected) in state.iter().zip(&expected) {
                assert!(off(found, expected) < 1e-6, "{features} {}", off(found, expected));
            }
            assert_eq!(bits(&state[0][61 * features..]), bits(&start[61 * features..]));
            state.map(|values| bits(&values))
        });
        assert!(states.iter().all(|(_, state)| *state == states[0].1));
    }
}
