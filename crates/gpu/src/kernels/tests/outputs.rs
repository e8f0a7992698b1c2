//! Activations of colour and density, with and without deltas, and density in space.

use super::*;

/// What `output.wgsl` and its users are asked for.
#[derive(Clone, Copy)]
struct Case {
    activation: usize,
    before: bool,
    ball: bool,
    deltas: bool,
    noise: bool,
    inside: bool,
}

const CASES: [Case; 5] = [
    Case { activation: 0, before: false, ball: false, deltas: false, noise: false, inside: false },
    Case { activation: 1, before: false, ball: false, deltas: false, noise: true, inside: true },
    Case { activation: 2, before: false, ball: true, deltas: true, noise: true, inside: false },
    Case { activation: 1, before: true, ball: false, deltas: true, noise: false, inside: true },
    Case { activation: 0, before: true, ball: true, deltas: true, noise: true, inside: false },
];

const PADDING: f64 = 0.01;
const LIMIT: f64 = 2.5;
const RGB_RADIUS: f64 = 0.2;
const DENSITY_RADIUS: f64 = 0.3;
const SAMPLES: usize = 5;

fn density_of(activation: usize, raw: f64) -> f64 {
    match activation {
        0 => raw.max(0.0),
        1 => (raw - 1.0).exp().ln_1p(),
        _ => (raw - 1.0).min(11.0).exp(),
    }
}

fn colour_of(raw: f64) -> f64 {
    (1.0 + 2.0 * PADDING) / (1.0 + (-raw.clamp(-LIMIT, LIMIT)).exp()) - PADDING
}

fn slope(of: impl Fn(f64) -> f64, at: f64) -> f64 {
    (of(at + 1e-6) - of(at - 1e-6)) / 2e-6
}

/// A sample in f64: what it shows, colour and density, and the deltas as they were used.
struct Sample {
    shown: [f64; 4],
    used: [f64; 4],
    raw: [f64; 4],
}

impl Case {
    fn sample(self, i: usize, raw: [f64; 4], noise: f64, is_inside: bool, delta: [f64; 4]) -> Sample {
        let mut used = [0.0; 4];
        if self.deltas {
            let norm = delta[..3].iter().map(|x| x * x).sum::<f64>().sqrt();
            for c in 0..3 {
                used[c] = match self.ball {
                    true => delta[c] * (RGB_RADIUS / norm).min(1.0),
                    false => delta[c].clamp(-RGB_RADIUS, RGB_RADIUS),
                };
            }
            let is_last = i % SAMPLES == SAMPLES - 1;
            used[3] = if is_last { 0.0 } else { delta[3].clamp(-DENSITY_RADIUS, DENSITY_RADIUS) };
        }
        let mut before = raw;
        if self.inside && !is_inside {
            before[3] = -1e4;
        }
        if self.before {
            (0..4).for_each(|c| before[c] += used[c]);
        }
        before[3] += noise;
        let mut shown: [f64; 4] = std::array::from_fn(|c| if c < 3 { colour_of(before[c]) } else { 0.0 });
        shown[3] = density_of(self.activation, before[3]);
        if !self.before {
            for c in 0..4 {
                let (low, high) = if c < 3 { (-PADDING, 1.0 + PADDING) } else { (0.0, f64::MAX) };
                used[c] = used[c].clamp(low - shown[c], high - shown[c]);
                shown[c] += used[c];
            }
        }
        Sample { shown, used, raw: before }
    }

    /// The gradients of raw colour and density.
    fn back(self, sample: &Sample, d: [f64; 4], is_inside: bool) -> [f64; 4] {
        std::array::from_fn(|c| {
            let raw = sample.raw[c];
            if c == 3 {
                return if self.inside && !is_inside {
                    0.0
                } else {
                    d[3] * slope(|raw| density_of(self.activation, raw), raw)
                };
            }
            // Beyond the limit it has the slope at the limit, if a step against the gradient leads back.
            let at = d[c] * slope(|raw| (1.0 + 2.0 * PADDING) / (1.0 + (-raw).exp()), raw.clamp(-LIMIT, LIMIT));
            let leads_away = raw > LIMIT && d[c] < 0.0 || raw < -LIMIT && d[c] > 0.0;
            if leads_away { 0.0 } else { at }
        })
    }
}

#[test]
fn activations() {
    let gpu = gpu();
    let (n, columns) = (60, 12);
    for (seed, case) in (50..).step_by(10).zip(CASES) {
        let random = |count: usize, size: f64, which: u64| numbers(count, size, seed + which);
        let (raw, head, d) = (random(4 * n, 4.0, 0), random(n * columns, 3.0, 1), random(4 * n, 1.0, 2));
        let (noise, rgb, density) = (random(n, 0.5, 3), random(3 * n, 0.4, 4), random(n, 0.6, 5));
        let inside: Vec<u32> = (0..n).map(|i| u32::from(i % 3 > 0)).collect();
        let [raw_buffer, head_buffer, d_buffer, noise_buffer, rgb_buffer, density_buffer] =
            [&raw, &head, &d, &noise, &rgb, &density].map(|values| gpu.storage(values));
        let inside_buffer = gpu.numbers(n);
        gpu.write(&inside_buffer, bytemuck::cast_slice(&inside));
        let [values, used_rgb, used_density, d_raw, d_head] =
            [4 * n, 3 * n, n, 4 * n, n * columns].map(|count| gpu.numbers(count));
        let params = || {
            let Case { activation, before, ball: rgb_ball, .. } = case;
            params! { points: n, samples: SAMPLES, columns, activation, padding: PADDING, limit: LIMIT, rgb_ball, before }
                .and(params! { rgb_radius: RGB_RADIUS, density_radius: DENSITY_RADIUS, masks_last: true })
        };
        let some = |on: bool, buffer| on.then_some(buffer);
        let mut buffers = vec![(1, &raw_buffer), (2, &head_buffer), (3, &values)];
        buffers.extend(some(case.inside, (4, &inside_buffer)));
        buffers.extend(some(case.noise, (5, &noise_buffer)));
        if case.deltas {
            buffers.extend([(6, &rgb_buffer), (7, &density_buffer), (8, &used_rgb), (9, &used_density)]);
        }
        let kernel = Kernel::new("activate").with("INSIDE", case.inside).with("NOISE", case.noise);
        let kernel = kernel.with("RGB", case.deltas).with("DENSITY", case.deltas);
        run(&gpu, kernel, params(), &buffers, groups(n));
        let mut buffers = vec![(1, &raw_buffer), (2, &head_buffer), (3, &d_buffer), (4, &d_raw), (5, &d_head)];
        let deltas_count = case.deltas && case.before;
        buffers.extend(some(case.inside, (6, &inside_buffer)));
        buffers.extend(some(case.noise, (7, &noise_buffer)));
        if deltas_count {
            buffers.extend([(8, &used_rgb), (9, &used_density)]);
        }
        let kernel = Kernel::new("activate_back").with("INSIDE", case.inside).with("NOISE", case.noise);
        let kernel = kernel.with("BEFORE_RGB", deltas_count).with("BEFORE_DENSITY", deltas_count);
        run(&gpu, kernel, params(), &buffers, groups(n));

        let samples: Vec<Sample> = (0..n)
            .map(|i| {
                let of_head = head[columns * i + columns - 4];
                let raw = [raw[4 * i], raw[4 * i + 1], raw[4 * i + 2], of_head].map(f64::from);
                let delta = [rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2], density[i]].map(f64::from);
                let noise = if case.noise { f64::from(noise[i]) } else { 0.0 };
                case.sample(i, raw, noise, inside[i] == 1, delta)
            })
            .collect();
        let shown: Vec<f64> = samples.iter().flat_map(|sample| sample.shown).collect();
        near("activate", &gpu.read_f32(&values, 4 * n).unwrap(), &shown, 1e-6);
        if case.deltas {
            let used: Vec<f64> = samples.iter().flat_map(|sample| sample.used[..3].to_vec()).collect();
            near("activate, used colours", &gpu.read_f32(&used_rgb, 3 * n).unwrap(), &used, 1e-6);
            let used: Vec<f64> = samples.iter().map(|sample| sample.used[3]).collect();
            near("activate, used densities", &gpu.read_f32(&used_density, n).unwrap(), &used, 1e-6);
        }
        let backs: Vec<[f64; 4]> = samples
            .iter()
            .enumerate()
            .map(|(i, sample)| case.back(sample, std::array::from_fn(|c| f64::from(d[4 * i + c])), inside[i] == 1))
            .collect();
        let expected: Vec<f64> = backs.iter().flat_map(|back| back[..3].to_vec()).collect();
        let found: Vec<f32> =
            gpu.read_f32(&d_raw, 4 * n).unwrap().chunks(4).flat_map(|row| row[..3].to_vec()).collect();
        near("activate_back, colour", &found, &expected, 1e-5);
        let found = gpu.read_f32(&d_head, n * columns).unwrap();
        let found: Vec<f32> = found.chunks(columns).map(|row| row[columns - 4]).collect();
        near("activate_back, density", &found, &backs.iter().map(|back| back[3]).collect::<Vec<f64>>(), 1e-5);
        if !case.deltas && !case.noise || case.inside {
            density_alone(&gpu, case, &head, &inside, columns);
        }
    }
}

/// Density without noise and deltas.
fn density_alone(gpu: &Gpu, case: Case, head: &[f32], inside: &[u32], columns: usize) {
    let n = inside.len();
    let (head_buffer, inside_buffer, out) = (gpu.storage(head), gpu.numbers(n), gpu.numbers(n));
    gpu.write(&inside_buffer, bytemuck::cast_slice(inside));
    let mut buffers = vec![(2, &head_buffer), (3, &out)];
    buffers.extend(case.inside.then_some((4, &inside_buffer)));
    let params = params! { points: n, columns, activation: case.activation };
    run(gpu, Kernel::new("density").with("INSIDE", case.inside), params, &buffers, groups(n));
    let raw = |i: usize| if case.inside && inside[i] == 0 { -1e4 } else { f64::from(head[columns * i + columns - 4]) };
    let expected: Vec<f64> = (0..n).map(|i| density_of(case.activation, raw(i))).collect();
    near("density", &gpu.read_f32(&out, n).unwrap(), &expected, 1e-6);
}

/// Density, its gradient and its Laplacian at points, what is integrated of them, and the way back, against central differences of
/// l1 density + tv |gradient of density| + bends |Laplacian of density| in the raw density, its three derivatives and its Laplacian.
#[test]
fn density_in_space() {
    let gpu = gpu();
    let (n, columns, l1, tv, volume) = (300, 12, 0.7, 0.4, 0.05);
    for (activation, bends) in (0..3).flat_map(|activation| [(activation, 0.0), (activation, 0.3)]) {
        let has_laplacian = bends > 0.0;
        let jets = if has_laplacian { 2 * n } else { n };
        let head = numbers(4 * jets * columns, 2.0, 90);
        let inside: Vec<u32> = (0..n).map(|i| u32::from(i % 4 > 0)).collect();
        let (head_buffer, inside_buffer) = (gpu.storage(&head), gpu.numbers(n));
        gpu.write(&inside_buffer, bytemuck::cast_slice(&inside));
        let [out, d_head, results] = [4 * jets, 4 * jets * columns, 2 * SLOT].map(|count| gpu.numbers(count));
        let params = || params! { points: n, columns, activation, l1, tv, laplacian: bends };
        let kernel = |name| Kernel::new(name).with("INSIDE", true).with("JETS", true).with("LAPLACIAN", has_laplacian);
        let buffers = |to| [(1, &head_buffer), (2, to), (3, &inside_buffer)];
        run(&gpu, kernel("space"), params(), &buffers(&out), groups(n));
        run(&gpu, kernel("space_back"), params(), &buffers(&d_head), groups(4 * jets * columns));
        // In two calls: the second adds to the first.
        for are_first in [1, 0] {
            let params = params! { points: n, slot: 1usize, volume, are_first };
            run(&gpu, kernel("integrals"), params, &[(1, &out), (2, &results)], [1, 1, 1]);
        }
        // Raw density, its gradient, and its Laplacian in the second jet.
        let place = |i: usize, row: usize| if row < 4 { 4 * i + row } else { 4 * (n + i) + 1 };
        let number = |values: &[f32], i: usize, row: usize| f64::from(values[columns * place(i, row) + columns - 4]);
        let rows = if has_laplacian { 5 } else { 4 };
        let jet =
            |i: usize| -> [f64; 5] { std::array::from_fn(|row| if row < rows { number(&head, i, row) } else { 0.0 }) };
        let density = |[raw, x, y, z, laplacian]: [f64; 5]| -> [f64; 5] {
            let of = |raw: f64| density_of(activation, raw);
            let slope = if activation == 0 && raw <= 0.0 { 0.0 } else { slope(of, raw) };
            let curve = match activation {
                0 => 0.0,
                1 => slope * (1.0 - slope),
                _ => of(raw),
            };
            let squared = x * x + y * y + z * z;
            [of(raw), slope * x, slope * y, slope * z, slope * laplacian + curve * squared]
        };
        let empty = [density_of(activation, -1e4), 0.0, 0.0, 0.0, 0.0];
        let expected: Vec<[f64; 5]> = (0..n).map(|i| if inside[i] == 1 { density(jet(i)) } else { empty }).collect();
        let mut out_rows: Vec<f64> = expected.iter().flat_map(|at| at[..4].to_vec()).collect();
        if has_laplacian {
            out_rows.extend(expected.iter().flat_map(|at| [at[4], 0.0, 0.0, 0.0]));
        }
        near("space", &gpu.read_f32(&out, 4 * jets).unwrap(), &out_rows, 1e-6);
        let parts = |at: [f64; 5]| {
            let length = at[1..4].iter().map(|x| x * x).sum::<f64>().sqrt();
            [at[0], length, if has_laplacian { at[4].abs() } else { 0.0 }]
        };
        let sum = |part: usize| 2.0 * volume * expected.iter().map(|at| parts(*at)[part]).sum::<f64>();
        let found = gpu.read_f32(&results, 2 * SLOT).unwrap();
        let found = [found[SLOT], found[SLOT + 1], found[SLOT + FIRST_TERM]];
        near("integrals", &found, &[sum(0), sum(1), sum(2)], 1e-5);

        // Slopes of density by differences need wider ones here.
        let h = 1e-3;
        let integrand = |jet: [f64; 5]| {
            let [density, length, laplacian] = parts(density(jet));
            l1 * density + tv * length + bends * laplacian
        };
        let expected: Vec<f64> = (0..n)
            .flat_map(|i| {
                let jet = jet(i);
                let slope = |row: usize| {
                    let moved =
                        |by: f64| integrand(std::array::from_fn(|j| if j == row { jet[j] + by } else { jet[j] }));
                    let is_flat = inside[i] == 0 || activation == 0 && jet[0] <= 0.0;
                    if is_flat { 0.0 } else { (moved(h) - moved(-h)) / (2.0 * h) }
                };
                (0..rows).map(slope).collect::<Vec<f64>>()
            })
            .collect();
        let d = gpu.read_f32(&d_head, 4 * jets * columns).unwrap();
        let found: Vec<f32> =
            (0..n).flat_map(|i| (0..rows).map(move |row| (i, row))).map(|(i, row)| number(&d, i, row) as f32).collect();
        near("space_back", &found, &expected, 1e-4);
        let [all, own] = [&d, &found].map(|numbers| numbers.iter().filter(|d| **d != 0.0).count());
        assert_eq!(all, own, "the other columns and rows have no gradient");
    }
}
