//! Each kernel against the same in f64. A table of differences is printed with `--nocapture`.

use augnerf_core::base::rng::{Random, Stream};
use augnerf_core::field::encode_reference;
use augnerf_core::field::hash::{Domain, HashGrid, Level};
use augnerf_core::optimizer::{Adam, AdamSettings};
use augnerf_core::render::sampling::importance;
use augnerf_core::render::volume::composite_reference;
use augnerf_core::settings::{Contraction, Interpolation};
use candle_core::{DType, Device, Tensor, Var};
use wgpu::Buffer;

use super::*;
use crate::device::{Gpu, groups};
use crate::rays::RAY;
use crate::record::{FIXED_SCALE, OUT, Words};

fn gpu() -> Gpu {
    Gpu::open(0).expect("a device; install mesa-vulkan-drivers and libvulkan1")
}

/// Numbers between -size and size that no pattern of a kernel matches.
fn numbers(count: usize, size: f64, seed: u64) -> Vec<f32> {
    let mut random = Random::new(seed, Stream::Init, 0);
    (0..count).map(|_| (size * (2.0 * random.uniform() - 1.0)) as f32).collect()
}

fn wide(values: &[f32], shape: &[usize]) -> Tensor {
    Tensor::from_vec(values.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>(), shape, &Device::Cpu).unwrap()
}

fn var(values: &[f32], shape: &[usize]) -> Var {
    Var::from_tensor(&wide(values, shape)).unwrap()
}

fn flat(tensor: &Tensor) -> Vec<f64> {
    tensor.flatten_all().unwrap().to_vec1().unwrap()
}

fn run(gpu: &Gpu, kernel: Kernel, words: Words, buffers: &[(u32, &Buffer)], size: [u32; 3]) {
    let uniform = gpu.uniform(words.words());
    let bound: Vec<(u32, &Buffer)> = std::iter::once((0, &uniform)).chain(buffers.iter().copied()).collect();
    gpu.submit(&[gpu.dispatch(&kernel, &bound, size)]);
}

/// Compares by the norm of the difference over that of the reference.
#[track_caller]
fn near(kernel: &str, found: &[f32], expected: &[f64], allowed: f64) {
    assert_eq!(found.len(), expected.len());
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|x| x * x).sum::<f64>().sqrt();
    let difference = norm(&mut found.iter().zip(expected).map(|(a, b)| f64::from(*a) - b));
    let relative = difference / norm(&mut expected.iter().copied());
    println!("{kernel:28} {relative:.1e}");
    assert!(relative < allowed, "{kernel}: {relative:.1e}");
}

#[test]
fn random_numbers_have_the_hosts_bits() {
    let gpu = gpu();
    let (seed, step) = (0x1_2345_6789u64, 77u64);
    let now = gpu.uniform(&[seed as u32, (seed >> 32) as u32, step as u32, 0, 0, 0, 0, 0]);
    let (chunks, count, offset) = (3, 50, 21);
    let out = gpu.numbers(chunks * count);
    let blocks = (offset % 16 + count).div_ceil(16);
    let words = Words::default().u(Stream::Search.key() as usize).u(5).u(2).u(chunks).u(count).u(offset).u(blocks).u(0);
    run(&gpu, Kernel::new("random"), words, &[(1, &now), (2, &out)], groups(chunks * blocks));
    let expected = (0..chunks).flat_map(|chunk| {
        let mut random = Random::part(seed, Stream::Search, step, 5 + 2 * chunk as u64);
        (0..offset).for_each(|_| {
            random.uniform();
        });
        (0..count).map(|_| random.uniform() as f32).collect::<Vec<f32>>()
    });
    assert_eq!(gpu.read_f32(&out, chunks * count).unwrap(), expected.collect::<Vec<f32>>());
}

/// C = A W + b with ReLU, D W^T, and A^T D with the sums of D, in all tiles that run here.
#[test]
fn products() {
    let gpu = gpu();
    let (m, k) = (70, 24);
    for n in [4, 16, 32, 64] {
        let tile = Tile::of(n, Tiles::Small);
        let (a, w, d) = (numbers(m * k, 1.0, 1), numbers((k + 1) * n, 1.0, 2), numbers(m * n, 1.0, 3));
        let of = |count: usize| gpu.numbers(count);
        let [a_buffer, w_buffer, d_buffer] = [&a, &w, &d].map(|values| gpu.storage(values));
        let (a, w, d) = (wide(&a, &[m, k]), wide(&w, &[k + 1, n]), wide(&d, &[m, n]));
        let (weights, bias) = (w.narrow(0, 0, k).unwrap(), w.narrow(0, k, 1).unwrap());
        let words = || Words::default().u(m).u(n).u(k).u(0).u(k).u(1).u(1);
        let c = of(m * n);
        let size = [m.div_ceil(tile.rows) as u32, n.div_ceil(tile.columns) as u32, 1];
        let rest = words().u(n).u(0).u(n).u(0).u(1).u(n).u(0).u(0).u(0);
        run(&gpu, tile.kernel("product"), rest, &[(1, &a_buffer), (3, &w_buffer), (4, &c)], size);
        let expected = a.matmul(&weights).unwrap().broadcast_add(&bias).unwrap().relu().unwrap();
        near(&format!("product, {n} columns"), &gpu.read_f32(&c, m * n).unwrap(), &flat(&expected), 1e-6);
        let tile = Tile::of(k, Tiles::Small);
        let (c, size) = (of(m * k), [m.div_ceil(tile.rows) as u32, k.div_ceil(tile.columns) as u32, 1]);
        let rest = Words::default().u(m).u(k).u(n).u(0).u(n).u(1).u(1).u(n).u(0).u(k).u(0).u(0).u(k).u(0).u(0).u(0);
        run(&gpu, tile.kernel("product_back"), rest, &[(1, &d_buffer), (3, &w_buffer), (4, &c)], size);
        let expected = d.matmul(&weights.t().unwrap()).unwrap();
        near(&format!("product_back, {n} columns"), &gpu.read_f32(&c, m * k).unwrap(), &flat(&expected), 1e-6);
        let tile = Tile::of(n, Tiles::Small);
        // Three parts of 32 rows, which `reduce` adds.
        let (parts, parameters) = (3, (k + 1) * n);
        let (c, sum) = (of(parts * parameters), of(parameters));
        let rest = words().u(n).u(0).u(0).u(0).u(0).u(0).u(32).u(parameters).u(0).u(0);
        let size = [k.div_ceil(tile.rows) as u32, n.div_ceil(tile.columns) as u32, parts as u32];
        run(&gpu, tile.kernel("weights"), rest, &[(1, &a_buffer), (3, &d_buffer), (4, &c)], size);
        let reduce = Words::default().u(parameters).u(parts).u(parameters).u(0);
        run(&gpu, Kernel::new("reduce"), reduce, &[(1, &c), (2, &sum)], groups(parameters));
        let of_weights = a.t().unwrap().matmul(&d).unwrap();
        let expected = Tensor::cat(&[&of_weights, &d.sum_keepdim(0).unwrap()], 0).unwrap();
        near(&format!("weights, {n} columns"), &gpu.read_f32(&sum, parameters).unwrap(), &flat(&expected), 1e-6);
    }
}

#[test]
fn waves() {
    let gpu = gpu();
    let (n, octaves, channels) = (50, 10, 64);
    let points = numbers(3 * n, 4.0, 4);
    let d_encoded = numbers(n * channels, 1.0, 5);
    let [points_buffer, d_buffer] = [&points, &d_encoded].map(|values| gpu.storage(values));
    let (encoded, d_points) = (gpu.numbers(n * channels), gpu.numbers(3 * n));
    let words = || Words::default().u(n).u(octaves).u(channels).u(0);
    run(&gpu, Kernel::new("frequency"), words(), &[(1, &points_buffer), (2, &encoded)], groups(3 * n));
    let buffers = [(1, &encoded), (2, &d_buffer), (3, &d_points)];
    run(&gpu, Kernel::new("frequency_back"), words(), &buffers, groups(3 * n));
    let points = var(&points, &[n, 3]);
    let expected = encode_reference(&points, octaves).unwrap();
    let padded = Tensor::cat(&[&expected, &Tensor::zeros((n, 1), DType::F64, &Device::Cpu).unwrap()], 1).unwrap();
    near("frequency", &gpu.read_f32(&encoded, n * channels).unwrap(), &flat(&padded), 1e-6);
    let loss = (padded * wide(&d_encoded, &[n, channels])).unwrap().sum_all().unwrap();
    let gradient = flat(loss.backward().unwrap().get(&points).unwrap());
    near("frequency_back", &gpu.read_f32(&d_points, 3 * n).unwrap(), &gradient, 1e-5);
}

#[test]
fn hash_grids() {
    let gpu = gpu();
    let (n, features, levels) = (200, 2, 5);
    for (contraction, number, interpolation) in [
        (Contraction::None, 0, Interpolation::Linear),
        (Contraction::Axes, 1, Interpolation::Smoothstep),
        (Contraction::Ball, 2, Interpolation::Linear),
    ] {
        let grid = HashGrid::new(levels, features, 9, (4, 60), interpolation);
        let (low, high) = ([-1.0, -0.9, -0.8], [0.8, 0.9, 1.0]);
        let domain = Domain::new(low, high, contraction);
        let channels = grid.channels().next_multiple_of(4);
        let points = numbers(3 * n, 1.3, 6);
        let (tables, d_encoded) = (numbers(grid.entries() * features, 1.0, 7), numbers(n * channels, 1.0, 8));
        let [points_buffer, tables_buffer, d_buffer] = [&points, &tables, &d_encoded].map(|values| gpu.storage(values));
        let [unit, inside, encoded] = [3 * n, n, n * channels].map(|count| gpu.numbers(count));
        let [d_points, sums, flags] = [3 * n, 2 * tables.len(), 8].map(|count| gpu.numbers(count));
        let box_words = || {
            let words = low.iter().fold(Words::default(), |words, x| words.f(*x)).u(n);
            high.iter().fold(words, |words, x| words.f(*x)).u(number)
        };
        let smooth = usize::from(interpolation == Interpolation::Smoothstep);
        let words = || {
            let words = Words::default().u(n).u(levels).f(FIXED_SCALE).u(smooth).u(channels).u(0).u(0).u(0);
            let of = |l: &Level| [l.resolution as usize, l.entries, l.offset, usize::from(l.dense)];
            let all = grid.levels().iter().map(of).chain(std::iter::repeat([1, 1, 0, 1])).take(32).flatten();
            all.fold(words, Words::u)
        };
        let of_grid = |name| Kernel::new(name).set("FEATURES", features);
        run(&gpu, Kernel::new("domain"), box_words(), &[(1, &points_buffer), (2, &unit), (3, &inside)], groups(n));
        let buffers = [(1, &unit), (2, &tables_buffer), (3, &encoded)];
        run(&gpu, of_grid("encode"), words(), &buffers, groups(n * levels));
        let buffers = [(1, &unit), (2, &d_buffer), (3, &sums), (4, &flags)];
        run(&gpu, of_grid("scatter"), words(), &buffers, groups(n * levels));
        let buffers = [(1, &unit), (2, &tables_buffer), (3, &d_buffer), (4, &d_points)];
        run(&gpu, of_grid("slope"), words(), &buffers, groups(n));
        let buffers = [(1, &points_buffer), (2, &inside), (3, &d_points)];
        run(&gpu, Kernel::new("domain_back"), box_words(), &buffers, groups(n));
        let doubles = |values: &[f32]| values.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>();
        let (points, tables) = (doubles(&points), doubles(&tables));
        let d_encoded: Vec<f64> =
            doubles(&d_encoded).chunks(channels).flat_map(|row| row[..grid.channels()].to_vec()).collect();
        let mut expected_unit = vec![0.0; 3 * n];
        domain.map(&points, &mut expected_unit, &mut vec![false; n]);
        let unit = gpu.read_f32(&unit, 3 * n).unwrap();
        near("domain", &unit, &expected_unit, 1e-6);
        // From where the device put them: a rounding may put a point into the next cell.
        let unit = doubles(&unit);
        let mut expected = vec![0.0; n * grid.channels()];
        grid.encode_reference(&tables, &unit, &mut expected);
        let found = gpu.read_f32(&encoded, n * channels).unwrap();
        let found: Vec<f32> = found.chunks(channels).flat_map(|row| row[..grid.channels()].to_vec()).collect();
        near("encode", &found, &expected, 1e-5);
        let (mut d_unit, mut d_space) = (vec![0.0; 3 * n], vec![0.0; 3 * n]);
        grid.point_gradient_reference(&tables, &unit, &d_encoded, &mut d_unit);
        domain.backward(&points, &d_unit, &mut d_space);
        near("slope, domain_back", &gpu.read_f32(&d_points, 3 * n).unwrap(), &d_space, 1e-5);
        let mut of_tables = vec![0.0; tables.len()];
        grid.table_gradient_reference(&unit, &d_encoded, &mut of_tables);
        let bytes = gpu.read(&[&sums]).unwrap().remove(0);
        let pairs: Vec<u64> = bytemuck::pod_collect_to_vec(&bytes[..8 * tables.len()]);
        let found: Vec<f32> = pairs.iter().map(|sum| (*sum as i64 as f64 / 2f64.powi(56)) as f32).collect();
        near("scatter", &found, &of_tables, 1e-5);
    }
}

#[test]
fn compositing() {
    let gpu = gpu();
    let (n, samples) = (40, 9);
    let (near_end, far_end) = (2.0, 6.0);
    let positive = |values: Vec<f32>| values.into_iter().map(f32::abs).collect::<Vec<f32>>();
    let values = positive(numbers(4 * n * samples, 1.0, 9));
    let t_vals: Vec<f32> = positive(numbers(n * samples, 0.4, 10))
        .chunks(samples)
        .flat_map(|gaps| {
            let mut t = near_end as f32;
            let next = |gap: &f32| {
                t += gap;
                t
            };
            gaps.iter().map(next).collect::<Vec<f32>>()
        })
        .collect();
    let mut rays = positive(numbers(n * RAY, 1.0, 11));
    rays.chunks_mut(RAY).for_each(|ray| ray[18] += 0.5);
    let column = |from: usize, count: usize| {
        rays.chunks(RAY).flat_map(|ray| ray[from..from + count].to_vec()).collect::<Vec<f32>>()
    };
    let (target, norms) = (column(15, 3), column(18, 1));
    let [rays_buffer, t_buffer, values_buffer] = [&rays, &t_vals, &values].map(|values| gpu.storage(values));
    let [weights, out, before, d_values, d_t] =
        [n * samples, n * OUT, n * samples, 4 * n * samples, n * samples].map(|count| gpu.numbers(count));
    let words = Words::default().u(n).u(samples).u(samples).u(0).f(1.0).f(0.5).f(0.25).u(1);
    let words = words.f(0.7).f(0.0).f(near_end).f(far_end);
    let buffers = [
        (1, &rays_buffer),
        (2, &t_buffer),
        (3, &values_buffer),
        (4, &weights),
        (5, &out),
        (6, &before),
        (7, &d_values),
        (8, &d_t),
    ];
    run(&gpu, Kernel::new("composite").with("BACK", true), words, &buffers, [n.div_ceil(32) as u32, 1, 1]);
    let part =
        |from: usize, count: usize| values.chunks(4).flat_map(|v| v[from..from + count].to_vec()).collect::<Vec<f32>>();
    let (rgb, density, t) =
        (var(&part(0, 3), &[n, samples, 3]), var(&part(3, 1), &[n, samples]), var(&t_vals, &[n, samples]));
    let norms = wide(&norms, &[n, 1]);
    let expected = composite_reference(&rgb, &density, &t, &norms, Some([1.0, 0.5, 0.25])).unwrap();
    near("composite, weights", &gpu.read_f32(&weights, n * samples).unwrap(), &flat(&expected.weights), 1e-5);
    let found = gpu.read_f32(&out, n * OUT).unwrap();
    let of = |from: usize, count: usize| {
        found.chunks(OUT).flat_map(|ray| ray[from..from + count].to_vec()).collect::<Vec<f32>>()
    };
    near("composite, colour", &of(0, 3), &flat(&expected.rgb), 1e-5);
    near("composite, depth", &of(3, 1), &flat(&expected.depth), 1e-5);
    let loss = ((&expected.rgb - wide(&target, &[n, 3])).unwrap().sqr().unwrap().sum_all().unwrap() * 0.7).unwrap();
    let gradients = loss.backward().unwrap();
    let d = gpu.read_f32(&d_values, 4 * n * samples).unwrap();
    let of = |from: usize, count: usize| d.chunks(4).flat_map(|d| d[from..from + count].to_vec()).collect::<Vec<f32>>();
    near("composite, d colour", &of(0, 3), &flat(gradients.get(&rgb).unwrap()), 1e-5);
    near("composite, d density", &of(3, 1), &flat(gradients.get(&density).unwrap()), 1e-4);
    near("composite, d t", &gpu.read_f32(&d_t, n * samples).unwrap(), &flat(gradients.get(&t).unwrap()), 1e-4);
}

#[test]
fn resampling() {
    let gpu = gpu();
    let (n, coarse, fine) = (30, 12, 20);
    let sorted = |values: Vec<f32>, size: usize| -> Vec<f32> {
        let sort = |row: &[f32]| {
            let mut row = row.to_vec();
            row.sort_by(f32::total_cmp);
            row
        };
        values.chunks(size).flat_map(sort).collect()
    };
    let t_vals = sorted(numbers(n * coarse, 1.0, 12), coarse);
    let weights: Vec<f32> = numbers(n * coarse, 1.0, 13).iter().map(|x| x.max(0.0)).collect();
    let u: Vec<f32> = numbers(n * fine, 1.0, 14).iter().map(|x| x.abs().min(0.999)).collect();
    let [t_buffer, w_buffer, u_buffer] = [&t_vals, &weights, &u].map(|values| gpu.storage(values));
    let out = gpu.numbers(n * (coarse + fine));
    let words = Words::default().u(coarse).u(coarse).u(fine).u(0).f(1e-5).f(1e-5).u(0).u(n);
    let kernel = Kernel::new("resample").set("MOST", (coarse + fine).next_power_of_two());
    run(&gpu, kernel, words, &[(1, &t_buffer), (2, &w_buffer), (3, &u_buffer), (4, &out)], crate::device::rows(n));
    let expected =
        importance(&wide(&t_vals, &[n, coarse]), &wide(&weights, &[n, coarse]), &wide(&u, &[n, fine])).unwrap();
    near("resample", &gpu.read_f32(&out, n * (coarse + fine)).unwrap(), &flat(&expected), 1e-5);
}

#[test]
fn adam() {
    let gpu = gpu();
    let (count, features, steps) = (60, 3, 4);
    let settings = AdamSettings { beta2: 0.99, epsilon: 1e-15 };
    let start = numbers(count, 1.0, 15);
    for (name, kernel) in [
        ("fine.weight", Kernel::new("adam_weights")),
        ("fine.table", Kernel::new("adam_tables").set("FEATURES", features)),
    ] {
        let is_table = name == "fine.table";
        let var = Var::from_tensor(&wide(&start, &[count / features, features])).unwrap();
        let mut reference = Adam::new(settings, vec![(name.to_string(), var.clone())]).unwrap();
        let (values, first, second, flags) =
            (gpu.storage(&start), gpu.numbers(count), gpu.numbers(count), gpu.numbers(8));
        for step in 1..=steps {
            // Some entries have no gradient.
            let mut gradient = numbers(count, 0.1, 20 + step);
            gradient[..6 * step as usize].fill(0.0);
            let sums: Vec<u32> = match is_table {
                false => gradient.iter().map(|g| g.to_bits()).collect(),
                true => {
                    let fixed = gradient.iter().map(|g| (f64::from(*g) * 2f64.powi(56)) as i64 as u64);
                    fixed.flat_map(|sum| [sum as u32, (sum >> 32) as u32]).collect()
                }
            };
            let sums_buffer = gpu.numbers(sums.len());
            gpu.write(&sums_buffer, bytemuck::cast_slice(&sums));
            let corrections = [0.9, settings.beta2].map(|beta: f64| 1.0 - beta.powi(step as i32));
            let now = gpu.uniform(
                &[0.0, 0.0, 0.0, 0.0, (0.01 / corrections[0]) as f32, corrections[1] as f32, 0.0, 0.0]
                    .map(f32::to_bits),
            );
            let unit = if is_table { 1.0 / FIXED_SCALE } else { 1.0 };
            let words = Words::default().u(count).f(0.9).f(settings.beta2).f(settings.epsilon).f(unit).u(0).u(0).u(0);
            let buffers = [(1, &now), (2, &values), (3, &first), (4, &second), (5, &flags), (6, &sums_buffer)];
            run(&gpu, kernel.clone(), words, &buffers, groups(count));
            let of_host = wide(&gradient, &[count / features, features]);
            reference.update(&[Some(of_host)], 0.01, step).unwrap();
            let left: Vec<u32> = bytemuck::pod_collect_to_vec(&gpu.read(&[&sums_buffer]).unwrap()[0]);
            assert!(left.iter().all(|word| *word == 0), "sums are made 0");
        }
        near(&format!("adam, {name}"), &gpu.read_f32(&values, count).unwrap(), &flat(var.as_tensor()), 1e-6);
        let moments = &reference.moments()[0];
        near(&format!("adam, {name}, second"), &gpu.read_f32(&second, count).unwrap(), &flat(&moments.second), 1e-5);
    }
}

use naga::valid::{Capabilities, ValidationFlags, Validator};

/// Compiles a text to SPIR-V, as for Vulkan. Returns its words.
fn compile(kernel: &Kernel) -> usize {
    let text = kernel.text();
    let module = naga::front::wgsl::parse_str(&text).unwrap_or_else(|e| panic!("{}", e.emit_to_string(&text)));
    let info = Validator::new(ValidationFlags::all(), Capabilities::all())
        .validate(&module)
        .unwrap_or_else(|e| panic!("{:?}: {}", kernel, e.emit_to_string(&text)));
    let options = naga::back::spv::Options { lang_version: (1, 6), ..naga::back::spv::Options::default() };
    naga::back::spv::write_vec(&module, &info, &options, None).unwrap().len()
}

/// Matrix units are not on the machines that run the tests.
#[test]
fn products_by_matrix_units_compile() {
    for name in ["product", "product_back", "weights"] {
        for columns in [64, 256] {
            let kernel = Tile::of(columns, Tiles::Matrices).kernel(name).with("F16", true);
            assert!(compile(&kernel) > 1000);
            let of_two = kernel.with("SECOND", true).with("DELTA", name == "product").with("MASK", name != "product");
            assert!(compile(&of_two.with("OPEN", true).with("ADD", true)) > 1000);
        }
    }
}

#[test]
fn large_tiles_compile() {
    for name in ["product", "product_back", "weights"] {
        let kernel = Tile::of(256, Tiles::Large).kernel(name).with("SECOND", true);
        assert!(compile(&kernel) > 1000);
        assert!(compile(&kernel.with("JETS", true).with("MASK", name == "product_back")) > 1000);
    }
}
