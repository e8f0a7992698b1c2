//! Derivatives of the encoding against the reference, and of that against finite differences.

use super::super::operator::ORDERS;
use super::*;

/// An operator for each of `count` points, no number of which is 0.
fn operators(count: usize, seed: u64) -> Vec<Operator<f64>> {
    signed(10 * count, seed).as_chunks().0.to_vec()
}

/// The same with derivatives counted as the finest cells count them, so that all of a point's numbers matter.
fn scaled(grid: &HashGrid, operators: &[Operator<f64>]) -> Vec<Operator<f64>> {
    let finest = f64::from(grid.levels.last().unwrap().resolution);
    let order = |i: usize| ORDERS[i].iter().sum::<usize>() as i32;
    operators.iter().map(|operator| std::array::from_fn(|i| operator[i] / finest.powi(order(i)))).collect()
}

#[test]
fn kernels_of_operators_follow_the_reference_with_the_same_bits_on_each_processor() {
    for grid in grids() {
        for count in [1, 16, 37, 530] {
            let points = inner_points(&grid, count);
            let (tables, d_out) = (signed(grid.entries() * grid.features(), 2), signed(count * grid.channels(), 3));
            let operators32: Vec<Operator<f32>> =
                scaled(&grid, &operators(count, 4)).iter().map(|operator| operator.map(|x| x as f32)).collect();
            let operators: Vec<Operator<f64>> = operators32.iter().map(|operator| operator.map(f64::from)).collect();
            let [points32, tables32, d_out32] = [&points, &tables, &d_out].map(|values| narrow(values));
            let [tables, d_out] =
                [&tables32, &d_out32].map(|values| values.iter().map(|x| f64::from(*x)).collect::<Vec<_>>());
            let expected = [
                reference::encode(&grid, &tables, &points, Some(&operators)),
                reference::table_gradient(&grid, &points, Some(&operators), &d_out),
            ];
            let all = on_each(|| {
                let mut found = [vec![0f32; d_out.len()], vec![0.0; tables.len()]];
                grid.encode(&tables32, &points32, Some(&operators32), &mut found[0]);
                let record = EncodingGradients { operators: Some(&operators32), ..record(&points32, &d_out32) };
                for (l, level) in grid.levels.iter().enumerate() {
                    let sum = &mut found[1][level.offset * grid.features..][..level.entries * grid.features];
                    grid.scatter(l, record, sum);
                }
                found
            });
            for (processor, found) in &all {
                for (found, expected) in found.iter().zip(&expected) {
                    let off = off(found, expected);
                    assert!(off < 2e-4, "{grid:?} {processor:?} {count}: {off}");
                }
                for (found, first) in found.iter().zip(&all[0].1) {
                    assert_eq!(bits(found), bits(first), "{grid:?} {processor:?} {count}");
                }
            }
        }
    }
}

#[test]
fn operators_are_finite_differences() {
    for interpolation in BOTH {
        let grid = HashGrid::new(4, 2, 7, (3, 30), interpolation);
        let (count, step) = (6, 1e-5);
        let points = inner_points(&grid, count);
        let tables = signed(grid.entries() * 2, 5);
        let apply = |order: [usize; 3], points: &[f64]| {
            let operator = ORDERS.map(|here| if here == order { 1.0 } else { 0.0 });
            reference::encode(&grid, &tables, points, Some(&[operator; 6]))
        };
        assert_eq!(apply([0; 3], &points), reference::encode(&grid, &tables, &points, None));
        for order in &ORDERS[1..] {
            // One derivative less, moved along the axis that is left.
            let axis = (0..3).find(|axis| order[*axis] > 0).unwrap();
            let mut below = *order;
            below[axis] -= 1;
            let [up, down] = [step, -step].map(|by| {
                let moved: Vec<f64> =
                    points.iter().enumerate().map(|(i, x)| if i % 3 == axis { x + by } else { *x }).collect();
                apply(below, &moved)
            });
            let found = apply(*order, &points);
            for ((found, up), down) in found.iter().zip(&up).zip(&down) {
                let expected = (up - down) / (2.0 * step);
                assert!((found - expected).abs() < 1e-4 * (1.0 + expected.abs()), "{order:?} {found} {expected}");
            }
            let bent = interpolation == Interpolation::Smoothstep || order.iter().all(|times| *times < 2);
            assert_eq!(found.iter().any(|x| x.abs() > 1e-3), bent, "{interpolation:?} {order:?}");
        }
    }
}

#[test]
fn records_with_and_without_operators_add_up() {
    let grid = HashGrid::new(5, 2, 8, (4, 64), Interpolation::Smoothstep);
    let points = narrow(&numbers(3 * 700, 1));
    let d_out = narrow(&signed(700 * grid.channels(), 2));
    let mut twice = [0.0; 10];
    twice[0] = 2.0;
    let operators = vec![twice; 700];
    let gradient = |records: &[EncodingGradients]| {
        let mut sum = vec![f32::NAN; grid.entries() * 2];
        grid.table_gradient(records, &mut sum);
        sum
    };
    let plain = record(&points, &d_out);
    let found = gradient(&[EncodingGradients { operators: Some(&operators), ..plain }, plain]);
    let expected: Vec<f64> = gradient(&[plain]).iter().map(|x| 3.0 * f64::from(*x)).collect();
    assert!(off(&found, &expected) < 1e-5);
}

/// Derivatives in the scene of a function of the cube's coordinates, whose derivatives in the cube are known.
#[test]
fn a_domain_s_operators_are_finite_differences() {
    // x y + 2 y^2 z + sin(3 x) z, and what an operator takes of it.
    let value = |[x, y, z]: [f64; 3]| x * y + 2.0 * y * y * z + (3.0 * x).sin() * z;
    let derivatives = |[x, y, z]: [f64; 3]| {
        let (sin, cos) = (3.0 * x).sin_cos();
        let first = [y + 3.0 * cos * z, x + 4.0 * y * z, 2.0 * y * y + sin];
        let second = [-9.0 * sin * z, 4.0 * z, 0.0];
        let mixed = [1.0, 3.0 * cos, 4.0 * y];
        let [[a, b, c], [d, e, f], [g, h, i]] = [first, second, mixed];
        [value([x, y, z]), a, b, c, d, e, f, g, h, i]
    };
    const STEP: f64 = 1e-4;
    for contraction in CONTRACTIONS {
        let domain = Domain::new([-2.0, 0.0, 1.0], [2.0, 1.0, 4.0], contraction);
        let place = |point: [f64; 3]| {
            let (mut unit, mut inside) = ([0.0; 3], [false]);
            domain.map(&point, &mut unit, &mut inside);
            (unit, inside[0])
        };
        for point in [[0.3, 0.6, 1.2], [-3.1, 0.2, 2.0], [5.0, -4.0, 9.0], [-1.9, 0.95, 3.9], [0.1, 0.4, 40.0]] {
            let (unit, inside) = place(point);
            let apply = |value: f64, gradient: [f64; 3], laplacian: f64| {
                let operator = domain.operator(point, value, gradient, laplacian);
                operator.iter().zip(derivatives(unit)).map(|(a, b)| a * b).sum::<f64>()
            };
            let mut laplacian = 0.0;
            for axis in 0..3 {
                let [up, middle, down] = [STEP, 0.0, -STEP].map(|by| {
                    let mut moved = point;
                    moved[axis] += by;
                    if inside { value(place(moved).0) } else { 0.0 }
                });
                laplacian += (up - 2.0 * middle + down) / (STEP * STEP);
                let (found, expected) =
                    (apply(0.0, [0, 1, 2].map(|i| f64::from(u8::from(i == axis))), 0.0), (up - down) / (2.0 * STEP));
                assert!((found - expected).abs() < 1e-7, "{contraction:?} {point:?} {axis}: {found} {expected}");
            }
            let found = apply(0.0, [0.0; 3], 1.0);
            assert!((found - laplacian).abs() < 1e-6, "{contraction:?} {point:?}: {found} {laplacian}");
            assert_eq!(apply(1.0, [0.0; 3], 0.0), value(unit));
        }
    }
}
