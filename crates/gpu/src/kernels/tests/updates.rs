//! Random numbers, checks and Adam.

use super::*;

#[test]
fn random_numbers_have_the_hosts_bits() {
    let gpu = gpu();
    let (seed, step) = (0x1_2345_6789u64, 77u64);
    let now = gpu.uniform(&[seed as u32, (seed >> 32) as u32, step as u32, 0, 0, 0, 0, 0]);
    let (chunks, count, offset) = (3, 50, 21);
    let out = gpu.numbers(chunks * count);
    let blocks = (offset % 16 + count).div_ceil(16);
    let params = params! { stream: Stream::Search as usize, part: 5usize, part_step: 2usize, chunks, count, offset, blocks, first: 0usize };
    run(&gpu, Kernel::new("random"), params, &[(1, &now), (2, &out)], groups(chunks * blocks));
    let expected = (0..chunks).flat_map(|chunk| {
        let mut random = Random::part(seed, Stream::Search, step, 5 + 2 * chunk as u64);
        (0..offset).for_each(|_| {
            random.uniform();
        });
        (0..count).map(|_| random.uniform() as f32).collect::<Vec<f32>>()
    });
    assert_eq!(gpu.read_f32(&out, chunks * count).unwrap(), expected.collect::<Vec<f32>>());
}

/// Numbers, and those of tables, whose gradients are limited, and weights that decay.
#[test]
fn adam() {
    let gpu = gpu();
    let (count, features, steps) = (60, 3, 4);
    let start = numbers(count, 1.0, 15);
    let weights = || Kernel::new("adam_weights");
    let tables = || Kernel::new("adam_tables").set("FEATURES", features);
    const NONE: f64 = 3e38;
    for (name, kernel, decay, limit, factor) in [
        ("fine.weight", weights(), 0.0, NONE, None),
        ("fine.table", tables(), 0.0, NONE, None),
        ("fine.weight", weights().with("DECAY", true), 0.3, 0.05, None),
        ("fine.weight", weights().with("NORM", true), 0.0, NONE, Some(0.3f32)),
        ("fine.table", tables().with("NORM", true), 0.0, 0.05, Some(0.3)),
    ] {
        let settings = AdamSettings { beta2: 0.99, epsilon: 1e-15, weight_decay: decay };
        let (factor_buffer, ones) = (gpu.storage(&[factor.unwrap_or(1.0)]), gpu.storage(&vec![1.0; count]));
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
                &[0.0, 0.0, 0.0, 0.0, (0.01 / corrections[0]) as f32, corrections[1] as f32, 0.01, 0.0]
                    .map(f32::to_bits),
            );
            let unit = if is_table { 1.0 / FIXED_SCALE } else { 1.0 };
            let params = params! { numbers: count, beta1: 0.9, beta2: settings.beta2, epsilon: settings.epsilon, unit, field: 0usize, limit, decay };
            let mut buffers = vec![(1, &now), (2, &values), (3, &first), (4, &second), (5, &flags), (6, &sums_buffer)];
            buffers.extend(factor.map(|_| (7, &factor_buffer)));
            buffers.extend((decay > 0.0).then_some((8, &ones)));
            run(&gpu, kernel.clone(), params, &buffers, groups(count));
            let of_host = wide(&gradient, &[count / features, features]).clamp(-limit, limit).unwrap();
            let of_host = (of_host * f64::from(factor.unwrap_or(1.0))).unwrap();
            reference.update(&[Some(of_host)], 0.01, step).unwrap();
            let left: Vec<u32> = bytemuck::pod_collect_to_vec(&gpu.read(&[&sums_buffer]).unwrap()[0]);
            assert!(left.iter().all(|word| *word == 0), "sums are made 0");
        }
        near(&format!("adam, {name}"), &gpu.read_f32(&values, count).unwrap(), &flat(var.as_tensor()), 1e-6);
        let moments = &reference.moments()[0];
        near(&format!("adam, {name}, second"), &gpu.read_f32(&second, count).unwrap(), &flat(&moments.second), 1e-5);
    }
}

/// The factor that limits the norm of gradients of weights and of tables.
#[test]
fn norms_are_limited() {
    let gpu = gpu();
    let (weights, tables, limit) = (numbers(9000, 1.0, 170), numbers(500, 1.0, 171), 0.6);
    let fixed = tables.iter().map(|g| (f64::from(*g) * 2f64.powi(56)) as i64 as u64);
    let fixed: Vec<u32> = fixed.flat_map(|sum| [sum as u32, (sum >> 32) as u32]).collect();
    let fixed_buffer = gpu.numbers(fixed.len());
    gpu.write(&fixed_buffer, bytemuck::cast_slice(&fixed));
    let (sums, factor) = (gpu.numbers(4), gpu.numbers(1));
    let params = params! { numbers: weights.len(), first: 0usize, unit: 0.5, limit };
    run(&gpu, Kernel::new("norm"), params, &[(1, &gpu.storage(&weights)), (2, &sums)], [3, 1, 1]);
    let params = params! { numbers: tables.len(), first: 3usize, unit: 1.0 / FIXED_SCALE, limit };
    run(&gpu, Kernel::new("norm").with("TABLES", true), params, &[(1, &fixed_buffer), (2, &sums)], [1, 1, 1]);
    let all = weights.iter().map(|g| 0.5 * f64::from(*g)).chain(tables.iter().map(|g| f64::from(*g)));
    let found = all.map(|g| g.clamp(-limit, limit).powi(2)).sum::<f64>().sqrt();
    for norm in [0.5 * found, 2.0 * found] {
        let params = params! { sums: 4usize, norm };
        run(&gpu, Kernel::new("norm_factor"), params, &[(1, &sums), (2, &factor)], [1, 1, 1]);
        near("norm_factor", &gpu.read_f32(&factor, 1).unwrap(), &[(norm / found).min(1.0)], 1e-6);
    }
}

/// Pairs of uniform numbers to pairs of normal ones, and sums and copies of numbers.
#[test]
fn numbers_in_place() {
    let gpu = gpu();
    let (first, count, scale) = (5, 60, 0.7);
    let uniform: Vec<f32> = numbers(first + count, 1.0, 160).iter().map(|x| x.abs()).collect();
    let buffer = gpu.storage(&uniform);
    let params = params! { chunks: 2usize, count: count / 2, scale, first };
    run(&gpu, Kernel::new("normal"), params, &[(1, &buffer)], groups(count / 2));
    let expected: Vec<f64> = uniform[first..]
        .chunks(2)
        .flat_map(|pair| {
            let (u, turns) = (f64::from(pair[0]), std::f64::consts::TAU * f64::from(pair[1]));
            let radius = scale * (-2.0 * (1.0 - u).ln()).sqrt();
            [radius * turns.cos(), radius * turns.sin()]
        })
        .collect();
    let found = gpu.read_f32(&buffer, first + count).unwrap();
    near("normal", &found[first..], &expected, 1e-5);
    assert_eq!(found[..first], uniform[..first], "numbers before the first stay");

    let [a, b] = [161, 162].map(|seed| numbers(count, 1.0, seed));
    let [a_buffer, b_buffer] = [&a, &b].map(|values| gpu.storage(values));
    let [sum, copied] = [(); 2].map(|()| gpu.numbers(count));
    let params = || params! { numbers: count };
    run(&gpu, Kernel::new("add"), params(), &[(1, &a_buffer), (2, &b_buffer), (3, &sum)], groups(count));
    run(&gpu, Kernel::new("copy"), params(), &[(1, &a_buffer), (2, &copied)], groups(count));
    let expected: Vec<f64> = a.iter().zip(&b).map(|(a, b)| f64::from(*a) + f64::from(*b)).collect();
    near("add", &gpu.read_f32(&sum, count).unwrap(), &expected, 1e-6);
    assert_eq!(gpu.read_f32(&copied, count).unwrap(), a);

    // From one buffer to another, and in place.
    let buffers = [(1, &b_buffer), (2, &sum), (3, &a_buffer)];
    run(&gpu, Kernel::new("multiply").with("FROM", true), params(), &buffers, groups(count));
    run(&gpu, Kernel::new("multiply"), params(), &[(1, &b_buffer), (2, &copied)], groups(count));
    let expected: Vec<f64> = a.iter().zip(&b).map(|(a, b)| f64::from(*a) * f64::from(*b)).collect();
    near("multiply", &gpu.read_f32(&sum, count).unwrap(), &expected, 1e-6);
    near("multiply, in place", &gpu.read_f32(&copied, count).unwrap(), &expected, 1e-6);
}

/// What is not finite sets the flag of its kind, and is named by its place.
#[test]
fn what_is_not_finite_sets_flags() {
    let gpu = gpu();
    let (count, slots, field) = (50, 3, 2);
    let check = |gradient: &[f32], results: &[f32]| -> Vec<u32> {
        let (gradient, results, flags) = (gpu.storage(gradient), gpu.storage(results), gpu.numbers(8));
        gpu.write(&flags, bytemuck::cast_slice(&[0, u32::MAX, u32::MAX, u32::MAX, 0, 0, 0, 0]));
        let params = params! { numbers: count, slots, field };
        let buffers = [(1, &gradient), (2, &results), (3, &flags)];
        run(&gpu, Kernel::new("check"), params, &buffers, groups(count));
        bytemuck::pod_collect_to_vec(&gpu.read(&[&flags]).unwrap()[0][..16])
    };
    let (gradient, results) = (numbers(count, 1.0, 163), numbers(SLOT * slots, 1.0, 164));
    const NONE: u32 = u32::MAX;
    assert_eq!(check(&gradient, &results), [0, NONE, NONE, NONE]);
    let with = |values: &[f32], at: usize, value: f32| {
        let mut values = values.to_vec();
        values[at] = value;
        values
    };
    assert_eq!(check(&with(&gradient, 31, f32::NAN), &results), [1, NONE, NONE, 31]);
    assert_eq!(check(&with(&with(&gradient, 31, f32::INFINITY), 7, f32::NAN), &results), [1, NONE, NONE, 7]);
    // The loss, TV and terms on rays of a slot; extremes may be infinite.
    for (at, flag) in [(SLOT, 8), (2 * SLOT + 1, 8), (14, 8), (18, 8), (SLOT + 2, 0), (13, 0)] {
        assert_eq!(check(&gradient, &with(&results, at, f32::INFINITY)), [flag, NONE, NONE, NONE], "{at}");
    }
}
