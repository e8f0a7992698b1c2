//! Positions along rays, compositing and its sums.

use super::*;

#[test]
fn compositing() {
    let gpu = gpu();
    let (n, samples) = (40, 45);
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
    let params = params! { rays: n, samples, columns: samples, ray0: 0usize, background: [1.0, 0.5, 0.25], has_background: true };
    let params = params.and(params! { weight: 0.7, near: near_end, far: far_end }.rest_is_zero());
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
    run(&gpu, Kernel::new("composite").with("BACK", true), params, &buffers, crate::device::rows(n));
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
    let params = params! { coarse, columns: coarse, fine, intervals: 0usize, padding: 1e-5, narrowest: 1e-5, mode: 0usize, rays: n };
    let kernel = Kernel::new("resample").set("MOST", (coarse + fine).next_power_of_two());
    run(&gpu, kernel, params, &[(1, &t_buffer), (2, &w_buffer), (3, &u_buffer), (4, &out)], crate::device::rows(n));
    let expected =
        importance(&wide(&t_vals, &[n, coarse]), &wide(&weights, &[n, coarse]), &wide(&u, &[n, fine])).unwrap();
    near("resample", &gpu.read_f32(&out, n * (coarse + fine)).unwrap(), &flat(&expected), 1e-5);
}

/// Random rays: unit directions are not needed, and their lengths are those of the directions.
fn random_rays(rays: usize, seed: u64) -> Vec<f32> {
    let mut values = numbers(rays * RAY, 1.0, seed);
    for ray in values.chunks_mut(RAY) {
        ray[18] = ray[3..6].iter().map(|x| x * x).sum::<f32>().sqrt();
    }
    values
}

/// Positions that grow along each ray.
fn growing(rays: usize, columns: usize, seed: u64) -> Vec<f32> {
    let gaps = numbers(rays * columns, 0.4, seed);
    let of_ray = |gaps: &[f32]| {
        let next = |t: &mut f32, gap: &f32| {
            *t += gap.abs() + 0.01;
            Some(*t)
        };
        gaps.iter().scan(2.0, next).collect::<Vec<f32>>()
    };
    gaps.chunks(columns).flat_map(of_ray).collect()
}

/// Positions, their points with a shift of each, and what points' gradients give to positions. Chunks begin at a ray.
#[test]
fn positions_and_points() {
    let gpu = gpu();
    let (all, ray0, rays, samples) = (13, 3, 10, 6);
    for columns in [samples, samples + 1] {
        let (jitter, rows) = (numbers(rays * columns, 1.0, 100), numbers(2 * columns, 1.0, 101));
        let [jitter_buffer, rows_buffer] = [&jitter, &rows].map(|values| gpu.storage(values));
        let found = gpu.numbers(rays * columns);
        let params = params! { rays, columns };
        let buffers = [(1, &rows_buffer), (2, &jitter_buffer), (3, &found)];
        run(&gpu, Kernel::new("sample"), params, &buffers, groups(rays * columns));
        let (widths, lower) = (wide(&rows[..columns], &[columns]), wide(&rows[columns..], &[columns]));
        let jitter = wide(&jitter, &[rays, columns]);
        let expected = jitter.broadcast_mul(&widths).unwrap().broadcast_add(&lower).unwrap();
        near("sample", &gpu.read_f32(&found, rays * columns).unwrap(), &flat(&expected), 1e-6);

        let (packed, t_vals) = (random_rays(all, 102), growing(rays, columns, 103));
        let (shift, d) = (numbers(3 * rays * samples, 0.1, 104), numbers(3 * rays * samples, 1.0, 105));
        let d_t_before = numbers(rays * columns, 1.0, 106);
        let [rays_buffer, t_buffer, shift_buffer, d_buffer, d_t] =
            [&packed, &t_vals, &shift, &d, &d_t_before].map(|values| gpu.storage(values));
        let [plain, shifted] = [(); 2].map(|()| gpu.numbers(3 * rays * samples));
        let params = || params! { rays, samples, columns, ray0 };
        let buffers = [(1, &rays_buffer), (2, &t_buffer), (3, &plain)];
        run(&gpu, Kernel::new("points"), params(), &buffers, groups(rays * samples));
        let buffers = [(1, &rays_buffer), (2, &t_buffer), (3, &shifted), (4, &shift_buffer)];
        run(&gpu, Kernel::new("points").with("SHIFT", true), params(), &buffers, groups(rays * samples));
        let buffers = [(1, &rays_buffer), (2, &d_buffer), (3, &d_t)];
        run(&gpu, Kernel::new("t_back"), params(), &buffers, groups(rays * columns));

        let part = |at: usize| {
            let of_rays = packed[RAY * ray0..RAY * (ray0 + rays)].chunks(RAY);
            let values: Vec<f32> = of_rays.flat_map(|ray| ray[at..at + 3].to_vec()).collect();
            wide(&values, &[rays, 1, 3])
        };
        let t_vals = var(&t_vals, &[rays, columns]);
        let middles = match columns > samples {
            true => ((t_vals.narrow(1, 0, samples).unwrap() + t_vals.narrow(1, 1, samples).unwrap()).unwrap() * 0.5)
                .unwrap(),
            false => t_vals.as_tensor().clone(),
        };
        let points = middles.unsqueeze(2).unwrap().broadcast_mul(&part(3)).unwrap().broadcast_add(&part(0)).unwrap();
        near("points", &gpu.read_f32(&plain, 3 * rays * samples).unwrap(), &flat(&points), 1e-6);
        let moved = (&points + wide(&shift, &[rays, samples, 3])).unwrap();
        near("points, shifted", &gpu.read_f32(&shifted, 3 * rays * samples).unwrap(), &flat(&moved), 1e-6);
        let loss = (points * wide(&d, &[rays, samples, 3])).unwrap().sum_all().unwrap();
        let gradient = flat(loss.backward().unwrap().get(&t_vals).unwrap());
        let expected: Vec<f64> = gradient.iter().zip(&d_t_before).map(|(d, before)| d + f64::from(*before)).collect();
        near("t_back", &gpu.read_f32(&d_t, rays * columns).unwrap(), &expected, 1e-6);
    }
}

/// Weights and accumulations from density alone.
#[test]
fn marches() {
    let gpu = gpu();
    let (all, ray0, rays, samples) = (70, 4, 50, 70);
    for columns in [samples, samples + 1] {
        let (packed, t_vals) = (random_rays(all, 110), growing(rays, columns, 111));
        let density: Vec<f32> = numbers(rays * samples, 1.0, 112).iter().map(|x| x.abs()).collect();
        let [rays_buffer, t_buffer, density_buffer] = [&packed, &t_vals, &density].map(|values| gpu.storage(values));
        let (weights, out) = (gpu.numbers(rays * samples), gpu.numbers(all * OUT));
        let params = params! { rays, samples, columns, ray0 };
        let buffers = [(1, &rays_buffer), (2, &t_buffer), (3, &density_buffer), (4, &weights), (5, &out)];
        let kernel = Kernel::new("march").with("WEIGHTS", true).with("ACC", true);
        run(&gpu, kernel, params, &buffers, crate::device::rows(rays));
        let norms: Vec<f32> = packed.chunks(RAY).skip(ray0).take(rays).map(|ray| ray[18]).collect();
        let rgb = Tensor::zeros((rays, samples, 3), DType::F64, &Device::Cpu).unwrap();
        let (density, t_vals) = (wide(&density, &[rays, samples]), wide(&t_vals, &[rays, columns]));
        let expected = composite_reference(&rgb, &density, &t_vals, &wide(&norms, &[rays, 1]), None).unwrap();
        near("march, weights", &gpu.read_f32(&weights, rays * samples).unwrap(), &flat(&expected.weights), 1e-5);
        let out = gpu.read_f32(&out, all * OUT).unwrap();
        let found: Vec<f32> = out.chunks(OUT).skip(ray0).take(rays).map(|ray| ray[6]).collect();
        near("march, accumulation", &found, &flat(&expected.weights.sum(1).unwrap()), 1e-5);
    }
}

/// Distortion over all pairs of samples, and its gradient in density. Positions stay as they are.
#[test]
fn distortion() {
    let gpu = gpu();
    let (rays, samples, weight, (near_end, far_end)) = (20, 75, 0.9, (2.0, 50.0));
    for columns in [samples, samples + 1] {
        let (packed, t_vals) = (random_rays(rays, 120), growing(rays, columns, 121));
        let values: Vec<f32> = numbers(4 * rays * samples, 1.0, 122).iter().map(|x| x.abs()).collect();
        let [rays_buffer, t_buffer, values_buffer] = [&packed, &t_vals, &values].map(|values| gpu.storage(values));
        let n = rays * samples;
        let [weights, out, before, d_values, d_t] =
            [n, rays * OUT, n, 4 * n, rays * columns].map(|count| gpu.numbers(count));
        let params = params! { rays, samples, columns, ray0: 0usize, background: [0.0; 3], has_background: false };
        let params = params.and(params! { near: near_end, far: far_end, distortion: weight }.rest_is_zero());
        let to = [&rays_buffer, &t_buffer, &values_buffer, &weights, &out, &before, &d_values, &d_t];
        let buffers: Vec<(u32, &Buffer)> = (1..).zip(to).collect();
        let kernel = Kernel::new("composite").with("BACK", true).with("DISTORTION", true);
        run(&gpu, kernel, params, &buffers, crate::device::rows(rays));

        let density: Vec<f32> = values.chunks(4).map(|value| value[3]).collect();
        let density = var(&density, &[rays, samples]);
        let norms: Vec<f32> = packed.chunks(RAY).map(|ray| ray[18]).collect();
        let rgb = Tensor::zeros((rays, samples, 3), DType::F64, &Device::Cpu).unwrap();
        let wide_t = wide(&t_vals, &[rays, columns]);
        let weights = composite_reference(&rgb, &density, &wide_t, &wide(&norms, &[rays, 1]), None).unwrap().weights;
        let along = wide_t.affine(1.0 / (far_end - near_end), -near_end / (far_end - near_end)).unwrap();
        // A ray of points ends at 1.
        let ends = match columns > samples {
            true => along,
            false => Tensor::cat(&[&along, &Tensor::ones((rays, 1), DType::F64, &Device::Cpu).unwrap()], 1).unwrap(),
        };
        let (low, high) = (ends.narrow(1, 0, samples).unwrap(), ends.narrow(1, 1, samples).unwrap());
        let (middles, widths) = (((&low + &high).unwrap() * 0.5).unwrap(), (high - low).unwrap());
        let apart = middles.unsqueeze(2).unwrap().broadcast_sub(&middles.unsqueeze(1).unwrap()).unwrap().abs().unwrap();
        let pairs = weights.unsqueeze(2).unwrap().broadcast_mul(&weights.unsqueeze(1).unwrap()).unwrap();
        let between = (pairs * apart).unwrap().sum((1, 2)).unwrap();
        let within = ((weights.sqr().unwrap() * widths).unwrap().sum(1).unwrap() / 3.0).unwrap();
        let spread = (between + within).unwrap();
        let found: Vec<f32> = gpu.read_f32(&out, rays * OUT).unwrap().chunks(OUT).map(|ray| ray[7]).collect();
        near("composite, distortion", &found, &flat(&spread), 1e-5);
        let gradients = (spread.sum_all().unwrap() * weight).unwrap().backward().unwrap();
        let d = gpu.read_f32(&d_values, 4 * n).unwrap();
        let found: Vec<f32> = d.chunks(4).map(|d| d[3]).collect();
        near("composite, d distortion", &found, &flat(gradients.get(&density).unwrap()), 1e-4);
    }
}

/// The host and the kernels mean the same sizes.
#[test]
fn sizes_are_those_of_the_kernels() {
    let text = include_str!("../../wgsl/sizes.wgsl");
    assert!(text.contains(&format!("OUT: u32 = {OUT}u;")) && text.contains(&format!("SLOT: u32 = {SLOT}u;")));
    assert!(FIRST_TERM + ON_RAYS.len() <= SLOT && 7 + ON_RAYS.len() <= OUT);
}

/// Sums and extremes over more rays than a group has threads, and the shift of colours between two passes.
#[test]
fn sums_over_rays() {
    let gpu = gpu();
    let (rays, slot) = (600, 2);
    let packed = random_rays(rays, 130);
    let [a, b] = [131, 132].map(|seed| numbers(rays * OUT, 1.0, seed));
    let [rays_buffer, a_buffer, b_buffer] = [&packed, &a, &b].map(|values| gpu.storage(values));
    let results = gpu.numbers(4 * SLOT);
    let buffers = [(1, &rays_buffer), (2, &a_buffer), (3, &results)];
    run(&gpu, Kernel::new("loss"), params! { rays, slot, numbers: FIRST_TERM + ON_RAYS.len() }, &buffers, [1, 1, 1]);
    let buffers = [(1, &a_buffer), (2, &b_buffer), (3, &results)];
    run(&gpu, Kernel::new("shift"), params! { rays, slot: 3usize }, &buffers, [1, 1, 1]);
    let found = gpu.read_f32(&results, 4 * SLOT).unwrap();

    let of = |values: &[f32], every: usize, at: usize| -> Vec<f64> {
        values.chunks(every).map(|ray| f64::from(ray[at])).collect()
    };
    let sum = |values: Vec<f64>| values.iter().sum::<f64>();
    let largest = |values: Vec<f64>| values.into_iter().fold(f64::MIN, f64::max);
    let smallest = |values: Vec<f64>| -values.into_iter().fold(f64::MAX, f64::min);
    let mut expected = vec![sum(of(&a, OUT, 5)) / (3 * rays) as f64, largest(of(&a, OUT, 6))];
    expected.extend((0..3).map(|c| largest(of(&a, OUT, c))));
    expected.extend((0..3).map(|c| smallest(of(&a, OUT, c))));
    expected.extend((15..18).map(|c| largest(of(&packed, RAY, c))));
    expected.extend((15..18).map(|c| smallest(of(&packed, RAY, c))));
    expected.extend((0..ON_RAYS.len()).map(|term| sum(of(&a, OUT, 7 + term)) / rays as f64));
    near("loss", &found[SLOT * slot..SLOT * slot + FIRST_TERM + ON_RAYS.len()], &expected, 1e-6);
    let apart = (0..3).flat_map(|c| of(&a, OUT, c).into_iter().zip(of(&b, OUT, c))).map(|(a, b)| (a - b).abs());
    near("shift", &found[3 * SLOT..3 * SLOT + 1], &[apart.sum::<f64>() / (3 * rays) as f64], 1e-6);
}
