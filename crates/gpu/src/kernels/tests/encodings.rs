//! Encodings of points and of view directions.

use super::*;

#[test]
fn waves() {
    let gpu = gpu();
    let (n, octaves, channels) = (50, 10, 64);
    let points = numbers(3 * n, 4.0, 4);
    let d_encoded = numbers(n * channels, 1.0, 5);
    let [points_buffer, d_buffer] = [&points, &d_encoded].map(|values| gpu.storage(values));
    let (encoded, d_points) = (gpu.numbers(n * channels), gpu.numbers(3 * n));
    let params = || params! { points: n, octaves, channels };
    run(&gpu, Kernel::new("frequency"), params(), &[(1, &points_buffer), (2, &encoded)], groups(3 * n));
    let buffers = [(1, &encoded), (2, &d_buffer), (3, &d_points)];
    run(&gpu, Kernel::new("frequency_back"), params(), &buffers, groups(3 * n));
    let points = var(&points, &[n, 3]);
    let expected = encode(&points, octaves).unwrap();
    let padded = Tensor::cat(&[&expected, &Tensor::zeros((n, 1), DType::F64, &Device::Cpu).unwrap()], 1).unwrap();
    near("frequency", &gpu.read_f32(&encoded, n * channels).unwrap(), &flat(&padded), 1e-6);
    let loss = (padded * wide(&d_encoded, &[n, channels])).unwrap().sum_all().unwrap();
    let gradient = flat(loss.backward().unwrap().get(&points).unwrap());
    near("frequency_back", &gpu.read_f32(&d_points, 3 * n).unwrap(), &gradient, 1e-5);
}

/// Gaussians of intervals along rays, of cones and of cylinders, their expected encoding, and the way back to shifts and edges.
#[test]
fn gaussians() {
    let gpu = gpu();
    let (all, rays, ray0, samples, octaves, channels) = (12, 9, 3, 5, 8, 48);
    let n = rays * samples;
    for cylinders in [false, true] {
        let packed: Vec<f32> = numbers(all * RAY, 1.0, 180).iter().map(|x| x.abs() + 0.01).collect();
        let widths: Vec<f32> = numbers(rays * samples, 0.2, 181).iter().map(|x| x.abs() + 0.05).collect();
        let edges: Vec<f32> = widths
            .chunks(samples)
            .flat_map(|widths| (0..=samples).map(|i| 2.0 + widths[..i].iter().sum::<f32>()))
            .collect();
        let [shift, d_encoded, d_edges] = [(3 * n, 0.1, 182), (n * channels, 1.0, 183), (edges.len(), 1.0, 184)]
            .map(|(n, size, seed)| numbers(n, size, seed));
        let [rays_buffer, edges_buffer, shift_buffer, d_buffer, d_t] =
            [&packed, &edges, &shift, &d_encoded, &d_edges].map(|values| gpu.storage(values));
        let [points, variances, encoded, d_points, d_variances] =
            [3 * n, 3 * n, n * channels, 3 * n, 3 * n].map(|count| gpu.numbers(count));
        let of_rays = || params! { rays, samples, columns: samples + 1, ray0 };
        let of_points = || params! { points: n, octaves, channels };
        let solids = |kernel: Kernel| kernel.with("CYLINDERS", cylinders);
        let buffers = [(1, &rays_buffer), (2, &edges_buffer), (3, &points), (4, &shift_buffer), (5, &variances)];
        run(&gpu, solids(Kernel::new("gaussians")).with("SHIFT", true), of_rays(), &buffers, groups(n));
        let buffers = [(1, &points), (2, &variances), (3, &encoded)];
        run(&gpu, Kernel::new("integrated"), of_points(), &buffers, groups(3 * n));
        let buffers = [(1, &encoded), (2, &d_buffer), (3, &d_points), (4, &d_variances)];
        run(&gpu, Kernel::new("integrated_back"), of_points(), &buffers, groups(3 * n));
        let buffers = [(1, &rays_buffer), (2, &edges_buffer), (3, &d_points), (4, &d_variances), (5, &d_t)];
        run(&gpu, solids(Kernel::new("gaussians_back")), of_rays(), &buffers, groups(edges.len()));

        let part = |at: usize, count: usize| -> Tensor {
            let of_chunk = packed[RAY * ray0..RAY * (ray0 + rays)].chunks(RAY);
            wide(&of_chunk.flat_map(|ray| ray[at..at + count].to_vec()).collect::<Vec<f32>>(), &[rays, count])
        };
        let footprint = Some(Footprint { radii: part(RAY - 1, 1), cylinders });
        let of_host = Rays { footprint, ..Rays::new(part(0, 3), part(3, 3), part(6, 3)).unwrap() };
        let (edges_var, shift_var) = (var(&edges, &[rays, samples + 1]), var(&shift, &[n, 3]));
        let still = gaussians_at(&of_host, &edges_var).unwrap().flatten(0, 1).unwrap();
        let moved = (&still + shift_var.pad_with_zeros(1, 0, 3).unwrap()).unwrap();
        let expected = encode_integrated(&moved, octaves).unwrap();
        let [mean, variance] = [0, 3].map(|first| flat(&moved.narrow(1, first, 3).unwrap()));
        near("gaussians, means", &gpu.read_f32(&points, 3 * n).unwrap(), &mean, 1e-6);
        near("gaussians, variances", &gpu.read_f32(&variances, 3 * n).unwrap(), &variance, 1e-6);
        near("integrated", &gpu.read_f32(&encoded, n * channels).unwrap(), &flat(&expected), 1e-5);
        let loss = (expected * wide(&d_encoded, &[n, channels])).unwrap().sum_all().unwrap();
        let gradients = loss.backward().unwrap();
        let of_shift = flat(gradients.get(&shift_var).unwrap());
        near("integrated_back", &gpu.read_f32(&d_points, 3 * n).unwrap(), &of_shift, 1e-4);
        let of_edges = (gradients.get(&edges_var).unwrap() + wide(&d_edges, &[rays, samples + 1])).unwrap();
        near("gaussians_back", &gpu.read_f32(&d_t, edges.len()).unwrap(), &flat(&of_edges), 1e-4);
    }
}

/// The sums of tables in 64-bit fixed point.
fn fixed_sums(gpu: &Gpu, sums: &Buffer, count: usize) -> Vec<f32> {
    let bytes = gpu.read(&[sums]).unwrap().remove(0);
    let pairs: Vec<u64> = bytemuck::pod_collect_to_vec(&bytes[..8 * count]);
    pairs.iter().map(|sum| (*sum as i64 as f64 / 2f64.powi(56)) as f32).collect()
}

#[test]
fn hash_grids() {
    let gpu = gpu();
    let (n, features, levels) = (200, 2, 5);
    for (contraction, interpolation) in [
        (Contraction::None, Interpolation::Linear),
        (Contraction::Axes, Interpolation::Smoothstep),
        (Contraction::Ball, Interpolation::Linear),
    ] {
        let grid = HashGrid::new(levels, features, 9, (4, 60), interpolation);
        let domain = Domain::new([-1.0, -0.9, -0.8], [0.8, 0.9, 1.0], contraction);
        let channels = grid.channels().next_multiple_of(4);
        let points = numbers(3 * n, 1.3, 6);
        let (tables, d_encoded) = (numbers(grid.entries() * features, 1.0, 7), numbers(n * channels, 1.0, 8));
        let [points_buffer, tables_buffer, d_buffer] = [&points, &tables, &d_encoded].map(|values| gpu.storage(values));
        let [unit, inside, encoded] = [3 * n, n, n * channels].map(|count| gpu.numbers(count));
        let [d_points, sums, flags] = [3 * n, 2 * tables.len(), 8].map(|count| gpu.numbers(count));
        let of_grid = |name| Kernel::new(name).set("FEATURES", features);
        let buffers = [(1, &points_buffer), (2, &unit), (3, &inside)];
        run(&gpu, Kernel::new("domain"), domain_params(&domain, n), &buffers, groups(n));
        let buffers = [(1, &unit), (2, &tables_buffer), (3, &encoded)];
        run(&gpu, of_grid("encode"), grid_params(&grid, n, channels, FIXED_SCALE), &buffers, groups(n * levels));
        let buffers = [(1, &unit), (2, &d_buffer), (3, &sums), (4, &flags)];
        run(&gpu, of_grid("scatter"), grid_params(&grid, n, channels, FIXED_SCALE), &buffers, groups(n * levels));
        let buffers = [(1, &unit), (2, &tables_buffer), (3, &d_buffer), (4, &d_points)];
        run(&gpu, of_grid("slope"), grid_params(&grid, n, channels, FIXED_SCALE), &buffers, groups(n));
        let buffers = [(1, &points_buffer), (2, &inside), (3, &d_points)];
        run(&gpu, Kernel::new("domain_back"), domain_params(&domain, n), &buffers, groups(n));
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
        let expected = hash_reference::encode(&grid, &tables, &unit, None);
        let found = gpu.read_f32(&encoded, n * channels).unwrap();
        let found: Vec<f32> = found.chunks(channels).flat_map(|row| row[..grid.channels()].to_vec()).collect();
        near("encode", &found, &expected, 1e-5);
        let d_unit = hash_reference::point_gradient(&grid, &tables, &unit, &d_encoded);
        let mut d_space = vec![0.0; 3 * n];
        domain.backward(&points, &d_unit, &mut d_space);
        near("slope, domain_back", &gpu.read_f32(&d_points, 3 * n).unwrap(), &d_space, 1e-5);
        let of_tables = hash_reference::table_gradient(&grid, &unit, None, &d_encoded);
        near("scatter", &fixed_sums(&gpu, &sums, tables.len()), &of_tables, 1e-5);
    }
}

/// Derivatives along x, y and z in the rows after each point's encoding, and Laplacians in second jets, against central differences.
#[test]
fn jets_of_waves() {
    let gpu = gpu();
    let (n, octaves, channels, h) = (40, 6, 40, 1e-6);
    let points = numbers(3 * n, 2.0, 41);
    let (points_buffer, encoded) = (gpu.storage(&points), gpu.numbers(8 * n * channels));
    let params = params! { points: n, octaves, channels };
    let buffers = [(1, &points_buffer), (2, &encoded)];
    run(&gpu, Kernel::new("frequency").with("JETS", true).with("LAPLACIAN", true), params, &buffers, groups(3 * n));
    let of = |shift: [f64; 3]| -> Vec<f64> {
        let shift = Tensor::new(&shift, &Device::Cpu).unwrap();
        let points = wide(&points, &[n, 3]).broadcast_add(&shift).unwrap();
        flat(&encode(&points, octaves).unwrap().pad_with_zeros(1, 0, 1).unwrap())
    };
    let found = gpu.read_f32(&encoded, 8 * n * channels).unwrap();
    let (first, second) = found.split_at(4 * n * channels);
    near("frequency, jets", first, &jets(of, n, channels, h), 1e-5);
    let (value, wide) = (of([0.0; 3]), 100.0 * h);
    let mut laplacians = vec![0.0; n * channels];
    for (axis, by) in (0..3).flat_map(|axis| [(axis, wide), (axis, -wide)]) {
        let moved = of(std::array::from_fn(|i| if i == axis { by } else { 0.0 }));
        laplacians.iter_mut().zip(moved.iter().zip(&value)).for_each(|(sum, (a, b))| *sum += (a - b) / (wide * wide));
    }
    near("frequency, Laplacians", second, &second_jets(&value, &laplacians, channels), 1e-5);
}

/// The rows of second jets: values, Laplacians, and two of 0.
fn second_jets(values: &[f64], laplacians: &[f64], channels: usize) -> Vec<f64> {
    let zeros = vec![0.0; 2 * channels];
    let points = values.chunks(channels).zip(laplacians.chunks(channels));
    points.flat_map(|(value, laplacian)| [value, laplacian, &zeros].concat()).collect()
}

/// The rows of points' jets: `[points, 4, channels]` from what a shift of all points makes of `[points, channels]`.
fn jets(of: impl Fn([f64; 3]) -> Vec<f64>, points: usize, channels: usize, h: f64) -> Vec<f64> {
    let value = of([0.0; 3]);
    let along = [0, 1, 2].map(|axis| {
        let [above, below] = [h, -h].map(|h| of(std::array::from_fn(|i| if i == axis { h } else { 0.0 })));
        above.iter().zip(below).map(|(above, below)| (above - below) / (2.0 * h)).collect::<Vec<f64>>()
    });
    let rows = (0..points).flat_map(|point| std::iter::once(&value).chain(&along).map(move |row| (point, row)));
    rows.flat_map(|(point, row)| row[channels * point..channels * (point + 1)].to_vec()).collect()
}

/// Features' derivatives in space, and what they give to tables, against central differences. Laplacians, where linear interpolation has
/// none, against the host's operators.
#[test]
fn jets_of_hash_grids() {
    let gpu = gpu();
    let (n, features, levels, h) = (100, 2, 5, 1e-7);
    for (contraction, interpolation) in [
        (Contraction::None, Interpolation::Smoothstep),
        (Contraction::Axes, Interpolation::Linear),
        (Contraction::Axes, Interpolation::Smoothstep),
        (Contraction::Ball, Interpolation::Smoothstep),
    ] {
        let bends = interpolation == Interpolation::Smoothstep;
        let grid = HashGrid::new(levels, features, 9, (4, 30), interpolation);
        let domain = Domain::new([-1.0, -0.9, -0.8], [0.8, 0.9, 1.0], contraction);
        let (own, channels) = (grid.channels(), grid.channels().next_multiple_of(4));
        let size = if contraction == Contraction::None { 0.7 } else { 1.3 };
        let points = numbers(3 * n, size, 42);
        // Second derivatives are large, and sums end at 128.
        let (first, second) = (numbers(4 * n * channels, 1.0, 44), numbers(4 * n * channels, 1e-4, 45));
        let (tables, d) = (numbers(grid.entries() * features, 1.0, 43), [first, second].concat());
        let [points_buffer, tables_buffer, d_buffer] = [&points, &tables, &d].map(|values| gpu.storage(values));
        let [unit, inside, encoded] = [3 * n, n, 8 * n * channels].map(|count| gpu.numbers(count));
        let [sums, flags] = [2 * tables.len(), 8].map(|count| gpu.numbers(count));
        let domain_params = domain_params(&domain, n);
        let kernel = |name| Kernel::new(name).set("FEATURES", features).with("JETS", true).with("LAPLACIAN", bends);
        let domain_uniform = gpu.uniform(&gpu.words(&kernel("encode"), 4, &domain_params));
        run(&gpu, Kernel::new("domain"), domain_params, &[(1, &points_buffer), (2, &unit), (3, &inside)], groups(n));
        let buffers = [(1, &unit), (2, &tables_buffer), (3, &encoded), (4, &domain_uniform), (5, &points_buffer)];
        run(&gpu, kernel("encode"), grid_params(&grid, n, channels, FIXED_SCALE), &buffers, groups(n * levels));
        let buffers = [(1, &unit), (2, &d_buffer), (3, &sums), (4, &flags), (5, &domain_uniform), (6, &points_buffer)];
        run(&gpu, kernel("scatter"), grid_params(&grid, n, channels, FIXED_SCALE), &buffers, groups(n * levels));

        let doubles = |values: &[f32]| values.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>();
        let (points, tables) = (doubles(&points), doubles(&tables));
        let unit_at = |shift: [f64; 3]| {
            let moved: Vec<f64> =
                points.chunks(3).flat_map(|p| [p[0] + shift[0], p[1] + shift[1], p[2] + shift[2]]).collect();
            let mut unit = vec![0.0; 3 * n];
            domain.map(&moved, &mut unit, &mut vec![false; n]);
            unit
        };
        let features_at = |shift: [f64; 3]| hash_reference::encode(&grid, &tables, &unit_at(shift), None);
        let narrow =
            |values: Vec<f32>| values.chunks(channels).flat_map(|row| row[..own].to_vec()).collect::<Vec<f32>>();
        let found = narrow(gpu.read_f32(&encoded, 8 * n * channels).unwrap());
        let (first, second) = found.split_at(4 * n * own);
        near("encode, jets", first, &jets(features_at, n, own, h), 1e-4);
        let of_point = |point: &[f64]| domain.operator([point[0], point[1], point[2]], 0.0, [0.0; 3], 1.0);
        let operators: Vec<[f64; 10]> = points.chunks(3).map(of_point).collect();
        if bends {
            let laplacians = hash_reference::encode(&grid, &tables, &unit_at([0.0; 3]), Some(&operators));
            near("encode, Laplacians", second, &second_jets(&features_at([0.0; 3]), &laplacians, own), 1e-4);
        }

        // The gradient of d . jets in the tables, in which jets are linear.
        let d = doubles(&narrow(d));
        let row =
            |row: usize| (0..n).flat_map(|point| d[own * (4 * point + row)..][..own].to_vec()).collect::<Vec<f64>>();
        let gradient_at = |shift: [f64; 3], d: &[f64]| hash_reference::table_gradient(&grid, &unit_at(shift), None, d);
        let mut expected = gradient_at([0.0; 3], &row(0));
        for axis in 0..3 {
            let [above, below] =
                [h, -h].map(|h| gradient_at(std::array::from_fn(|i| if i == axis { h } else { 0.0 }), &row(1 + axis)));
            for (sum, (above, below)) in expected.iter_mut().zip(above.iter().zip(below)) {
                *sum += (above - below) / (2.0 * h);
            }
        }
        if bends {
            let d = (0..n).flat_map(|point| d[own * (4 * (n + point) + 1)..][..own].to_vec()).collect::<Vec<f64>>();
            let of_laplacians = hash_reference::table_gradient(&grid, &unit_at([0.0; 3]), Some(&operators), &d);
            expected.iter_mut().zip(of_laplacians).for_each(|(sum, more)| *sum += more);
        }
        near("scatter, jets", &fixed_sums(&gpu, &sums, tables.len()), &expected, 1e-4);
    }
}

/// The encoding of a view direction that two angles tilt, and the gradient in them.
#[test]
fn views() {
    let gpu = gpu();
    let (rays, samples, octaves, channels) = (30, 4, 4, 28);
    let mut random_rays = numbers(rays * RAY, 1.0, 45);
    for ray in random_rays.chunks_mut(RAY) {
        let view = [ray[6], ray[7], ray[8]].map(f64::from);
        let norm = view.iter().map(|x| x * x).sum::<f64>().sqrt();
        let view = view.map(|x| x / norm);
        let (u, w) = augnerf_scenes::tangents(view);
        for (to, x) in ray[6..15].iter_mut().zip(view.into_iter().chain(u).chain(w)) {
            *to = x as f32;
        }
    }
    let (tilt, d) = (numbers(2 * rays, 0.3, 46), numbers(rays * samples * channels, 1.0, 47));
    let [rays_buffer, tilt_buffer, d_buffer] = [&random_rays, &tilt, &d].map(|values| gpu.storage(values));
    let [plain, encoded, d_tilt] = [rays * channels, rays * channels, 2 * rays].map(|count| gpu.numbers(count));
    let params = || params! { rays, octaves, channels, ray0: 0usize };
    run(&gpu, Kernel::new("view"), params(), &[(1, &rays_buffer), (2, &plain)], groups(rays));
    let buffers = [(1, &rays_buffer), (2, &encoded), (3, &tilt_buffer)];
    run(&gpu, Kernel::new("view").with("TILT", true), params(), &buffers, groups(rays));
    let buffers = [(1, &rays_buffer), (2, &encoded), (3, &d_buffer), (4, &tilt_buffer), (5, &d_tilt)];
    run(&gpu, Kernel::new("view_back"), params().and(params! { samples }), &buffers, groups(rays));

    let part = |at: usize| -> Tensor {
        let values: Vec<f32> = random_rays.chunks(RAY).flat_map(|ray| ray[at..at + 3].to_vec()).collect();
        wide(&values, &[rays, 3])
    };
    let padded = |unit: &Tensor| encode(unit, octaves).unwrap().pad_with_zeros(1, 0, 1).unwrap();
    near("view", &gpu.read_f32(&plain, rays * channels).unwrap(), &flat(&padded(&part(6))), 1e-6);
    let tilt = var(&tilt, &[rays, 2]);
    let angle = |i: usize, at: usize| tilt.narrow(1, i, 1).unwrap().broadcast_mul(&part(at)).unwrap();
    let moved = ((part(6) + angle(0, 9)).unwrap() + angle(1, 12)).unwrap();
    let unit = moved.broadcast_div(&moved.sqr().unwrap().sum_keepdim(1).unwrap().sqrt().unwrap()).unwrap();
    let tilted = padded(&unit);
    near("view, tilted", &gpu.read_f32(&encoded, rays * channels).unwrap(), &flat(&tilted), 1e-6);
    let of_ray = wide(&d, &[rays, samples, channels]).sum(1).unwrap();
    let gradients = (tilted * of_ray).unwrap().sum_all().unwrap().backward().unwrap();
    near("view_back", &gpu.read_f32(&d_tilt, 2 * rays).unwrap(), &flat(gradients.get(&tilt).unwrap()), 1e-5);
}
