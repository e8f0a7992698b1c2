//! Products of layers.

use std::collections::BTreeSet;

use super::super::products::{HALF, NATIVE_HALF};
use naga::valid::{Capabilities, ValidationFlags, Validator};

use super::*;

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
        let params = || params! { m, n, k1: k, lda1: k, every2: 1usize }.rest_is_zero();
        let c = of(m * n);
        let size = tile.groups(m, n, 1);
        let rest = params().and(params! { ldw: n, ldc: n, relu: true, ldx: n });
        run(&gpu, tile.kernel("product"), rest, &[(1, &a_buffer), (3, &w_buffer), (4, &c)], size);
        let expected = a.matmul(&weights).unwrap().broadcast_add(&bias).unwrap().relu().unwrap();
        near(&format!("product, {n} columns"), &gpu.read_f32(&c, m * n).unwrap(), &flat(&expected), 1e-6);
        let tile = Tile::of(k, Tiles::Small);
        let (c, size) = (of(m * k), tile.groups(m, k, 1));
        let rest = params! { m, n: k, k1: n, lda1: n, every2: 1usize, ldw: n, ldc: k, ldx: k }.rest_is_zero();
        run(&gpu, tile.kernel("product_back"), rest, &[(1, &d_buffer), (3, &w_buffer), (4, &c)], size);
        let expected = d.matmul(&weights.t().unwrap()).unwrap();
        near(&format!("product_back, {n} columns"), &gpu.read_f32(&c, m * k).unwrap(), &flat(&expected), 1e-6);
        let tile = Tile::of(n, Tiles::Small);
        // Three parts of 32 rows, which `reduce` adds.
        let (parts, parameters) = (3, (k + 1) * n);
        let (c, sum) = (of(parts * parameters), of(parameters));
        let rest = params().and(params! { ldw: n, ldc: n, part_rows: 32usize, parameters });
        let size = tile.groups(k, n, parts);
        run(&gpu, tile.kernel("weights"), rest, &[(1, &a_buffer), (3, &d_buffer), (4, &c)], size);
        let reduce = params! { numbers: parameters, parts, of_part: parameters };
        run(&gpu, Kernel::new("reduce"), reduce, &[(1, &c), (2, &sum)], groups(parameters));
        let of_weights = a.t().unwrap().matmul(&d).unwrap();
        let expected = Tensor::cat(&[&of_weights, &d.sum_keepdim(0).unwrap()], 0).unwrap();
        near(&format!("weights, {n} columns"), &gpu.read_f32(&sum, parameters).unwrap(), &flat(&expected), 1e-6);
    }
}

/// Compiles a text to SPIR-V, as for Vulkan, to Metal's language and, without matrix units, to DirectX's. Returns the words of the first.
fn compile(kernel: &Kernel) -> usize {
    let text = kernel.text();
    let module = naga::front::wgsl::parse_str(&text).unwrap_or_else(|e| panic!("{}", e.emit_to_string(&text)));
    let info = Validator::new(ValidationFlags::all(), Capabilities::all())
        .validate(&module)
        .unwrap_or_else(|e| panic!("{:?}: {}", kernel, e.emit_to_string(&text)));
    let options = naga::back::msl::Options { fake_missing_bindings: true, lang_version: (2, 4), ..Default::default() };
    naga::back::msl::write_string(&module, &info, &options, &Default::default()).unwrap();
    if !kernel.has_matrices() {
        let (mut text, options, pipeline) = (String::new(), Default::default(), Default::default());
        naga::back::hlsl::Writer::new(&mut text, &options, &pipeline).write(&module, &info, None).unwrap();
    }
    let options = naga::back::spv::Options { lang_version: (1, 6), ..naga::back::spv::Options::default() };
    naga::back::spv::write_vec(&module, &info, &options, None).unwrap().len()
}

/// Every kernel, without its parts, with each of them, and with all.
#[test]
fn all_texts_are_translated() {
    for name in NAMES {
        let lines = parts(name).iter().flat_map(|part| part.lines());
        let flags: BTreeSet<&'static str> = lines.filter_map(|line| line.trim().strip_prefix("//#if ")).collect();
        let kernel = |chosen: &dyn Fn(&str) -> bool| {
            // Laplacians are parts of jets.
            let is_on = |flag: &str| chosen(flag) || flag == "JETS" && chosen("LAPLACIAN");
            let kernel = Kernel::new(name).set("FEATURES", 2).set("MOST", 64);
            flags.iter().fold(kernel, |kernel, flag| kernel.with(flag, is_on(flag)))
        };
        assert!(compile(&kernel(&|_| false)) > 100 && compile(&kernel(&|_| true)) > 100, "{name}");
        flags.iter().for_each(|alone| assert!(compile(&kernel(&|flag| flag == *alone)) > 100, "{name} {alone}"));
    }
}

/// Matrix units are not on the machines that run the tests.
#[test]
fn products_by_matrix_units_compile() {
    for name in ["product", "product_back", "weights"] {
        for columns in [64, 256] {
            let kernel = Tile::of(columns, Tiles::Matrices).kernel(name).with("F16", true);
            assert!(compile(&kernel) > 1000);
            let in_f16 = ["A1_IN_F16", "A2_IN_F16", "W_IN_F16", "C_IN_F16", "X_IN_F16", "Y_IN_F16"];
            let kernel = in_f16.iter().fold(kernel, |kernel, flag| kernel.with(flag, true));
            let of_two = kernel.with("SECOND", true).with("DELTA", name == "product").with("MASK", name != "product");
            let is_back = name != "product";
            assert!(compile(&of_two.with("OPEN", is_back).with("ADD", is_back).with("LIVE", is_back)) > 1000);
        }
    }
}

#[test]
fn trunks_compile() {
    for (name, flag) in [("trunk", "DELTA"), ("trunk_back", "OPEN")] {
        for width in [64, 128, 256] {
            let rows = trunk_rows(width, 64, 48 << 10).unwrap();
            assert_eq!(rows * width, 1 << 14);
            let kernel = Kernel::new(name).set("WIDTH", width).set("ROWS", rows);
            assert!(
                compile(&kernel) > 1000 && compile(&kernel.with(flag, true).with("LIVE", name == "trunk_back")) > 1000
            );
        }
    }
    assert_eq!(trunk_rows(256, 64, 32 << 10), Some(32));
    assert!(
        [(96, 64), (64, 80), (64, 40)].iter().all(|(width, channels)| trunk_rows(*width, *channels, 1 << 20).is_none())
    );
}

#[test]
fn tiles_of_f32_are_translated() {
    for (name, flags) in [
        ("product", &["SECOND", "DELTA", "JETS"][..]),
        ("product_back", &["MASK", "ADD", "OPEN", "LIVE", "JETS"]),
        ("weights", &["SECOND", "LIVE", "JETS"]),
    ] {
        for (columns, tiles) in [4, 16, 32, 64].map(|n| (n, Tiles::Small)).into_iter().chain([(256, Tiles::Large)]) {
            let kernel = Tile::of(columns, tiles).kernel(name);
            assert!(compile(&kernel) > 1000);
            let in_f16 = ["A1_IN_F16", "A2_IN_F16", "W_IN_F16", "C_IN_F16", "X_IN_F16", "Y_IN_F16"];
            assert!(compile(&in_f16.iter().fold(kernel.clone(), |kernel, flag| kernel.with(flag, true))) > 1000);
            // Deltas and lists are of samples, not of jets.
            let of = |left_out: &str| {
                let on = flags.iter().filter(|flag| **flag != left_out);
                on.fold(kernel.clone(), |kernel, flag| kernel.with(flag, true))
            };
            assert!(compile(&of("JETS")) > 1000 && compile(&of("LIVE")) > 1000 || name == "product");
            assert!(compile(&of("DELTA")) > 1000 || name != "product");
        }
    }
}

/// The flag of products by matrix units whose matrices are arrays in f32, so that any device runs them.
pub(in crate::kernels) const EMULATED: &str = "EMULATED";

/// Returns the text of a product by matrix units with a matrix of a sum as 8 numbers of each of 32 threads, and operands where they
/// are in shared memory: the first number's place, and the steps to the next row and column.
pub(in crate::kernels) fn without_matrix_units(text: &str) -> String {
    let functions = "
        var<private> lane_of_matrix: u32;
        fn left_at(i: u32) -> f32 { return unpack2x16float(left[i / 4u][i / 2u % 2u])[i % 2u]; }
        fn right_at(i: u32) -> f32 { return unpack2x16float(right[i / 4u][i / 2u % 2u])[i % 2u]; }
        fn multiply_add(a: vec3<u32>, b: vec3<u32>, c: array<f32, 8>) -> array<f32, 8> {
            var sums = c;
            let row = lane_of_matrix / 2u;
            // Mesa unrolls what it knows the end of, for half a minute.
            for (var i = 0u; i < min(8u, 8u * p.m); i++) {
                let column = lane_of_matrix % 2u * 8u + i;
                for (var k = 0u; k < min(16u, 16u * p.m); k++) {
                    sums[i] += left_at(a.x + row * a.y + k * a.z) * right_at(b.x + k * b.y + column * b.z);
                }
            }
            return sums;
        }
        fn store_lines(matrix: array<f32, 8>, at: u32, stride: u32) {
            var values = matrix;
            for (var i = 0u; i < 8u; i++) {
                stage[at + lane_of_matrix / 2u * stride + lane_of_matrix % 2u * 8u + i] = values[i];
            }
        }";
    let line = |line: &str| -> Option<String> {
        let (before, call) = line.split_once("coopLoad").or_else(|| line.split_once("coopStoreT("))?;
        let (matrix, place) = call.split_once('&')?;
        let (at, stride) = place.split_once('[')?.1.rsplit_once("], ")?;
        let stride = stride.trim_end_matches(");");
        Some(match (line.contains("coopStore"), matrix.starts_with('T')) {
            (true, _) => format!("{before}store_lines({matrix}{at}, {stride});"),
            // Places and strides of operands are in fours.
            (_, true) => format!("{before}vec3<u32>(4u * ({at}), 4u * {stride}, 1u);"),
            (_, false) => format!("{before}vec3<u32>(4u * ({at}), 1u, 4u * {stride});"),
        })
    };
    // Operands stay in f16, two in a word.
    let text = text.replace(NATIVE_HALF, HALF);
    let kept = text.lines().filter(|text| !text.starts_with("enable "));
    let text: Vec<String> = kept.map(|text| line(text).unwrap_or_else(|| text.to_string())).collect();
    let text =
        text.join("\n").replace("coop_mat16x16<f32, C>", "array<f32, 8>").replace("coopMultiplyAdd", "multiply_add");
    let lane = "let lane = thread % 32u;";
    let text = text.replace("f16", "f32").replace(lane, &format!("{lane} lane_of_matrix = lane;"));
    [&text, functions].concat()
}

/// Numbers between -1 and 1 of 11 bits, which f16 does not round.
fn of_11_bits(count: usize, seed: u64) -> Vec<f32> {
    numbers(count, 1.0, seed).iter().map(|x| (1024.0 * x).round() / 1024.0).collect()
}

/// Copies numbers to f16.
fn halved(gpu: &Gpu, from: &Buffer, count: usize) -> Buffer {
    let to = gpu.numbers(count.div_ceil(2));
    run(gpu, Kernel::new("halve"), params! { numbers: count }, &[(1, from), (2, &to)], groups(count.div_ceil(4)));
    to
}

fn read_f16(gpu: &Gpu, buffer: &Buffer, count: usize) -> Vec<f32> {
    let words: Vec<half::f16> = bytemuck::cast_slice(&gpu.read(&[buffer]).unwrap()[0])[..count].to_vec();
    words.into_iter().map(f32::from).collect()
}

/// What f16 cannot hold is clamped, and what is not a number stays.
#[test]
fn numbers_in_f16() {
    let gpu = gpu();
    let values = [1.0, -0.333_333_34, 1e6, f32::NEG_INFINITY, f32::NAN, 65_504.0, 3e-8, 0.0];
    let found = read_f16(&gpu, &halved(&gpu, &gpu.storage(&values), 8), 8);
    assert!(found[4].is_nan());
    let expected = [1.0, -0.333_251_95, 65_504.0, -65_504.0, 65_504.0, 5.960_464_5e-8, 0.0];
    let others: Vec<f32> = found.iter().copied().filter(|x| !x.is_nan()).collect();
    assert_eq!(others, expected);
}

/// Matrices in f16 give the numbers of f32 while these have 11 bits, and are rounded where they are left.
#[test]
fn products_of_matrices_in_f16() {
    let gpu = gpu();
    let (m, n) = (200, 64);
    let parameters = (n + 1) * n;
    let [a, w, d, x] = [(m * n, 220), (parameters, 221), (m * n, 222), (m * n, 223)].map(|(count, seed)| {
        let full = gpu.storage(&of_11_bits(count, seed));
        let half = halved(&gpu, &full, count);
        [full, half]
    });
    let sizes = || params! { m, n, k1: n, k2: 0usize, lda1: n, every2: 1usize, ldw: n, ldc: n }.rest_is_zero();
    let part_rows = m.next_multiple_of(16);
    let all = ["A1_IN_F16", "W_IN_F16", "C_IN_F16", "X_IN_F16", "Y_IN_F16"];
    for (name, flag, params, from, by, count, rows) in [
        ("product", "DELTA", sizes().and(params! { relu: true, ldx: n }), &a, &w, m * n, m),
        ("product_back", "MASK", sizes().and(params! { ldx: n }), &d, &w, m * n, m),
        ("weights", "", sizes().and(params! { part_rows, parameters }), &a, &d, parameters, n),
    ] {
        let of = |tiles: Tiles, in_f16: &[&'static str]| {
            let (tile, is_matrix) = (Tile::of(n, tiles), tiles == Tiles::Matrices);
            let (c, y) = (gpu.numbers(count), gpu.numbers(count));
            let kernel = tile.kernel(name).with("F16", is_matrix).with(EMULATED, is_matrix).with(flag, true);
            let kernel = in_f16.iter().fold(kernel, |kernel, flag| kernel.with(flag, true));
            let half = |matrix: &str| usize::from(in_f16.iter().any(|flag| flag.starts_with(matrix)));
            let mut bound = vec![(1, &from[half("A1")]), (3, &by[half("W")]), (4, &c)];
            match name {
                "product" => bound.extend([(5, &x[0]), (6, &y)]),
                "product_back" => bound.push((5, &x[half("X")])),
                _ => {}
            }
            run(&gpu, kernel, params.clone(), &bound, tile.groups(rows, n, 1));
            let read = |buffer: &Buffer, matrix: &str| match half(matrix) {
                1 => read_f16(&gpu, buffer, count),
                _ => gpu.read_f32(buffer, count).unwrap(),
            };
            let left = if name == "product" { [read(&c, "C"), read(&y, "Y")].concat() } else { read(&c, "C") };
            left.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>()
        };
        let narrow = |values: &[f64]| values.iter().map(|x| *x as f32).collect::<Vec<f32>>();
        let expected = of(Tiles::Small, &[]);
        // A gradient's parts and a delta are in f32.
        let left: Vec<&str> = all.into_iter().filter(|flag| name != "weights" || !flag.starts_with('C')).collect();
        let left: Vec<&str> =
            left.into_iter().filter(|flag| name == "product_back" || !flag.starts_with('X')).collect();
        let read: Vec<&str> = left.iter().copied().filter(|flag| !flag.starts_with(['C', 'Y'])).collect();
        for tiles in [Tiles::Small, Tiles::Matrices] {
            near(&format!("{name}, read in f16, {tiles:?}"), &narrow(&of(tiles, &read)), &expected, 1e-6);
            near(&format!("{name}, in f16, {tiles:?}"), &narrow(&of(tiles, &left)), &expected, 4e-4);
        }
    }
}

/// The same numbers as in small tiles, but for their order in sums. All have 11 bits, so that f16 rounds none.
#[test]
fn matrix_units_have_the_places_of_tiles() {
    let gpu = gpu();
    let (m, every) = (200, 5);
    let halves = |count: usize, seed: u64| -> Buffer { gpu.storage(&of_11_bits(count, seed)) };
    for (k, n) in [(40, 64), (132, 132)] {
        let parameters = (k + 8 + 1) * n;
        let [a1, w, d, made] =
            [(m * k, 190), (parameters, 191), (m * n, 192), (m * k, 193)].map(|(count, seed)| halves(count, seed));
        let (a2, delta) = (halves(m / every * 8, 194), halves(m * n, 195));
        let sizes = || params! { m, ldw: n }.rest_is_zero();
        let inputs = || sizes().and(params! { n, k1: k, k2: 8usize, lda1: k, lda2: 8usize, every2: every, ldc: n });
        let forward = inputs().and(params! { relu: true, ldx: n });
        let back = sizes().and(params! { n: k, k1: n, lda1: n, every2: 1usize, w_from: 4 * n, ldc: k, ldx: k });
        let weights = inputs().and(params! { part_rows: 112usize, parts: 2usize, parameters });
        // Two of three rows have a gradient.
        let rows: Vec<u32> = (0..m as u32).filter(|row| row % 3 != 1).collect();
        let live = gpu.numbers(m + 1);
        gpu.write(&live, bytemuck::cast_slice(&[&[rows.len() as u32], &rows[..]].concat()));
        for (name, flags, params, buffers, columns, rows, parts, count) in [
            ("product", &["SECOND", "DELTA"][..], forward, vec![&a1, &a2, &w], n, m, 1, m * n),
            ("product_back", &["MASK", "OPEN", "LIVE"], back, vec![&d, &d, &w], k, m, 1, m * k),
            ("weights", &["SECOND", "LIVE"], weights, vec![&a1, &a2, &d], n, k + 8, 2, 2 * parameters),
        ] {
            let [small, emulated] = [Tiles::Small, Tiles::Matrices].map(|tiles| {
                let (tile, is_matrix) = (Tile::of(columns, tiles), tiles == Tiles::Matrices);
                let (c, open) = (gpu.numbers(count), gpu.numbers(count));
                let kernel = tile.kernel(name).with("F16", is_matrix).with(EMULATED, is_matrix);
                let kernel = flags.iter().fold(kernel, |kernel, flag| kernel.with(flag, true));
                let mut bound: Vec<(u32, &Buffer)> = (1..).zip(buffers.iter().copied()).chain([(4, &c)]).collect();
                match name {
                    "product" => bound.extend([(5, &delta), (6, &open)]),
                    "product_back" => {
                        bound.remove(1);
                        bound.extend([(5, &made), (6, &open), (7, &live)]);
                    }
                    _ => bound.push((7, &live)),
                }
                run(&gpu, kernel, params.clone(), &bound, tile.groups(rows, columns, parts));
                [&c, &open].map(|buffer| gpu.read_f32(buffer, count).unwrap())
            });
            let wide = |values: &[f32]| values.iter().map(|x| f64::from(*x)).collect::<Vec<f64>>();
            near(&format!("{name} by matrix units"), &emulated[0], &wide(&small[0]), 1e-6);
            if name != "weights" {
                near(&format!("{name} by matrix units, open"), &emulated[1], &wide(&small[1]), 1e-6);
            }
        }
    }
}

/// A text of each kind as the templates write it, to be read. `AUGNERF_UPDATE_DOCS=1` writes the files anew.
#[test]
fn written_texts_are_those_of_the_files() {
    let product = |tiles: Tiles| Tile::of(64, tiles).kernel("product").with("F16", tiles == Tiles::Matrices);
    for (kernel, file) in [
        (product(Tiles::Small), "tiled_product"),
        (product(Tiles::Matrices), "matrices_product"),
        (Kernel::new("trunk").set("WIDTH", 64).set("ROWS", 64), "trunk"),
    ] {
        let file = format!("{}/templates/written/{file}.wgsl", env!("CARGO_MANIFEST_DIR"));
        if std::env::var_os("AUGNERF_UPDATE_DOCS").is_some() {
            std::fs::write(&file, kernel.text()).unwrap();
        }
        assert_eq!(std::fs::read_to_string(&file).unwrap(), kernel.text(), "{file}");
    }
}

/// Large tiles are chosen on discrete cards alone.
#[test]
fn all_tiles_of_f32_have_the_same_bits() {
    let gpu = gpu();
    // As many inputs as outputs.
    let (m, n) = (200, 256);
    let parameters = (n + 1) * n;
    let [a, w, d] =
        [(m * n, 177), (parameters, 178), (m * n, 179)].map(|(count, seed)| gpu.storage(&numbers(count, 1.0, seed)));
    let sizes = || params! { m, n, k1: n, lda1: n, every2: 1usize, ldw: n, ldc: n }.rest_is_zero();
    let part_rows = m.next_multiple_of(16);
    for (name, params, from, by, count, rows) in [
        ("product", sizes().and(params! { relu: true, ldx: n }), &a, &w, m * n, m),
        ("product_back", sizes().and(params! { ldx: n }), &d, &w, m * n, m),
        ("weights", sizes().and(params! { part_rows, parameters }), &a, &d, parameters, n),
    ] {
        let [small, large] = [Tiles::Small, Tiles::Large].map(|tiles| {
            let (tile, c) = (Tile::of(n, tiles), gpu.numbers(count));
            let buffers = [(1, from), (3, by), (4, &c)];
            run(&gpu, tile.kernel(name), params.clone(), &buffers, tile.groups(rows, n, 1));
            gpu.read_f32(&c, count).unwrap()
        });
        assert_eq!(small, large, "{name}");
        assert!(small.iter().filter(|x| x.abs() > 1.0).count() > count / 10, "{name}");
    }
}

/// A product of two inputs, the second shared by rows, with a delta on the way to the next layer; and the way back
/// through a ReLU, added to what is there, and kept before the ReLU.
#[test]
fn products_in_parts() {
    let gpu = gpu();
    let (m, k1, k2, every) = (70, 12, 8, 5);
    for n in [4, 16, 32, 64] {
        let tile = Tile::of(n, Tiles::Small);
        let (a1, a2) = (numbers(m * k1, 1.0, 170), numbers(m / every * k2, 1.0, 171));
        let (w, delta) = (numbers((k1 + k2 + 1) * n, 1.0, 172), numbers(m * n, 1.0, 173));
        let [a1_buffer, a2_buffer, w_buffer, delta_buffer] = [&a1, &a2, &w, &delta].map(|values| gpu.storage(values));
        let (c, moved) = (gpu.numbers(m * n), gpu.numbers(m * n));
        let params = || params! { m, n, k1, k2, lda1: k1, lda2: k2, every2: every }.rest_is_zero();
        let size = tile.groups(m, n, 1);
        let buffers = [(1, &a1_buffer), (2, &a2_buffer), (3, &w_buffer), (4, &c), (5, &delta_buffer), (6, &moved)];
        let kernel = tile.kernel("product").with("SECOND", true).with("DELTA", true);
        run(&gpu, kernel, params().and(params! { ldw: n, ldc: n, relu: true, ldx: n }), &buffers, size);
        let shared: Vec<f32> = (0..m).flat_map(|row| a2[k2 * (row / every)..][..k2].to_vec()).collect();
        let a = Tensor::cat(&[&wide(&a1, &[m, k1]), &wide(&shared, &[m, k2])], 1).unwrap();
        let w = wide(&w, &[k1 + k2 + 1, n]);
        let (weights, bias) = (w.narrow(0, 0, k1 + k2).unwrap(), w.narrow(0, k1 + k2, 1).unwrap());
        let expected = a.matmul(&weights).unwrap().broadcast_add(&bias).unwrap().relu().unwrap();
        near("product, two inputs", &gpu.read_f32(&c, m * n).unwrap(), &flat(&expected), 1e-6);
        let expected = (expected + wide(&delta, &[m, n])).unwrap();
        near("product, delta", &gpu.read_f32(&moved, m * n).unwrap(), &flat(&expected), 1e-6);

        let d = numbers(m * n, 1.0, 174);
        let d_buffer = gpu.storage(&d);
        let (parts, parameters) = (3, (k1 + k2 + 1) * n);
        let (of_parts, sum) = (gpu.numbers(parts * parameters), gpu.numbers(parameters));
        let size = tile.groups(k1 + k2, n, parts);
        let buffers = [(1, &a1_buffer), (2, &a2_buffer), (3, &d_buffer), (4, &of_parts)];
        let rest = params().and(params! { ldw: n, ldc: n, part_rows: 32usize, parameters });
        run(&gpu, tile.kernel("weights").with("SECOND", true), rest, &buffers, size);
        let reduce = params! { numbers: parameters, parts, of_part: parameters };
        run(&gpu, Kernel::new("reduce"), reduce, &[(1, &of_parts), (2, &sum)], groups(parameters));
        let d = wide(&d, &[m, n]);
        let of_weights = a.t().unwrap().matmul(&d).unwrap();
        let expected = Tensor::cat(&[&of_weights, &d.sum_keepdim(0).unwrap()], 0).unwrap();
        near("weights, two inputs", &gpu.read_f32(&sum, parameters).unwrap(), &flat(&expected), 1e-6);

        // To inputs 4 to 12, which a ReLU made.
        let (inputs, from) = (8, 4);
        let tile = Tile::of(inputs, Tiles::Small);
        let (made, there) = (numbers(m * inputs, 1.0, 175), numbers(m * inputs, 1.0, 176));
        let (made_buffer, c, open) = (gpu.storage(&made), gpu.storage(&there), gpu.numbers(m * inputs));
        let rest = params! { m, n: inputs, k1: n, lda1: n, every2: 1usize, ldw: n, w_from: from * n };
        let rest = rest.and(params! { ldc: inputs, ldx: inputs }.rest_is_zero());
        let kernel = tile.kernel("product_back").with("MASK", true).with("ADD", true).with("OPEN", true);
        let buffers = [(1, &d_buffer), (3, &w_buffer), (4, &c), (5, &made_buffer), (6, &open)];
        let size = tile.groups(m, inputs, 1);
        run(&gpu, kernel, rest, &buffers, size);
        let back = d.matmul(&w.narrow(0, from, inputs).unwrap().t().unwrap()).unwrap();
        let added = flat(&(back + wide(&there, &[m, inputs])).unwrap());
        near("product_back, open", &gpu.read_f32(&open, m * inputs).unwrap(), &added, 1e-6);
        let passed = added.iter().zip(&made).map(|(d, made)| if *made > 0.0 { *d } else { 0.0 });
        let passed: Vec<f64> = passed.collect();
        near("product_back, ReLU", &gpu.read_f32(&c, m * inputs).unwrap(), &passed, 1e-6);
    }
}

/// What rows without a gradient are left out of: the same as products of gradients that are 0 there.
#[test]
fn products_of_rows_with_a_gradient() {
    let gpu = gpu();
    let (m, k, n, parts) = (300, 24, 64, 3);
    let (points, columns) = (m, 12);
    let is_live = |row: usize| row % 7 < 2 || row > 270;
    // Raw colours and densities: some rows have one alone that counts, and one of them is not a number.
    let (mut d_raw, mut d_head) = (vec![0f32; 4 * m], vec![0f32; columns * m]);
    for row in (0..m).filter(|row| is_live(*row)) {
        match row % 4 {
            3 => d_head[columns * row + columns - 4] = 0.5,
            channel => d_raw[4 * row + channel] = if row == 280 { f32::NAN } else { -1e-30 },
        }
    }
    let groups_of = crate::device::rows(m.div_ceil(256));
    let (live, counts) = (gpu.numbers(m + 1), gpu.numbers(2));
    let (d_raw, d_head) = (gpu.storage(&d_raw), gpu.storage(&d_head));
    let buffers = [(1, &d_raw), (2, &d_head), (3, &counts), (4, &live)];
    run(&gpu, Kernel::new("live"), params! { points, columns }, &buffers[..3], groups_of);
    run(&gpu, Kernel::new("live").with("LIST", true), params! { points, columns }, &buffers, groups_of);
    let expected: Vec<u32> = (0..m as u32).filter(|row| is_live(*row as usize)).collect();
    let found: Vec<u32> = bytemuck::pod_collect_to_vec(&gpu.read(&[&live]).unwrap()[0]);
    assert_eq!((found[0] as usize, &found[1..=expected.len()]), (expected.len(), &expected[..]));

    let (a, w, mut d) = (numbers(m * k, 1.0, 196), numbers((k + 1) * n, 1.0, 197), numbers(m * n, 1.0, 198));
    let written = gpu.storage(&d);
    (0..m).filter(|row| !is_live(*row)).for_each(|row| d[n * row..][..n].fill(0.0));
    let [a_buffer, w_buffer] = [&a, &w].map(|values| gpu.storage(values));
    let sizes = || params! { m, ldw: n, every2: 1usize }.rest_is_zero();
    let c = gpu.numbers(m * k);
    run(&gpu, Kernel::new("zero"), params! { numbers: m * k }, &[(1, &c)], groups(m * k));
    let tile = Tile::of(k, Tiles::Small);
    let params = sizes().and(params! { n: k, k1: n, lda1: n, ldc: k, ldx: k });
    let buffers = [(1, &written), (3, &w_buffer), (4, &c), (7, &live)];
    run(&gpu, tile.kernel("product_back").with("LIVE", true), params, &buffers, tile.groups(m, k, 1));
    let (a, d) = (wide(&a, &[m, k]), wide(&d, &[m, n]));
    let weights = wide(&w, &[k + 1, n]).narrow(0, 0, k).unwrap();
    let expected = flat(&d.matmul(&weights.t().unwrap()).unwrap());
    near("product_back, live", &gpu.read_f32(&c, m * k).unwrap(), &expected, 1e-6);

    let (tile, parameters) = (Tile::of(n, Tiles::Small), (k + 1) * n);
    let (of_parts, sum) = (gpu.numbers(parts * parameters), gpu.numbers(parameters));
    let params = sizes().and(params! { n, k1: k, lda1: k, ldc: n, part_rows: 112usize, parts, parameters });
    let buffers = [(1, &a_buffer), (3, &written), (4, &of_parts), (7, &live)];
    run(&gpu, tile.kernel("weights").with("LIVE", true), params, &buffers, tile.groups(k, n, parts));
    let reduce = params! { numbers: parameters, parts, of_part: parameters };
    run(&gpu, Kernel::new("reduce"), reduce, &[(1, &of_parts), (2, &sum)], groups(parameters));
    let of_weights = a.t().unwrap().matmul(&d).unwrap();
    let expected = flat(&Tensor::cat(&[&of_weights, &d.sum_keepdim(0).unwrap()], 0).unwrap());
    near("weights, live", &gpu.read_f32(&sum, parameters).unwrap(), &expected, 1e-6);
}

/// Four rows a point: its value, and three derivatives, which have no bias and the value's ReLU.
#[test]
fn products_of_jets() {
    let gpu = gpu();
    let (points, k) = (18, 24);
    let m = 4 * points;
    for n in [4, 16, 32, 64] {
        let tile = Tile::of(n, Tiles::Small);
        let (a, w, d) = (numbers(m * k, 1.0, 180), numbers((k + 1) * n, 1.0, 181), numbers(m * n, 1.0, 182));
        let [a_buffer, w_buffer, d_buffer] = [&a, &w, &d].map(|values| gpu.storage(values));
        let params = || params! { m, n, k1: k, lda1: k, every2: 1usize }.rest_is_zero();
        let c = gpu.numbers(m * n);
        let size = tile.groups(m, n, 1);
        let rest = params().and(params! { ldw: n, ldc: n, relu: true, ldx: n });
        let buffers = [(1, &a_buffer), (3, &w_buffer), (4, &c)];
        run(&gpu, tile.kernel("product").with("JETS", true), rest, &buffers, size);
        let (a, d) = (wide(&a, &[m, k]), wide(&d, &[m, n]));
        let w = wide(&w, &[k + 1, n]);
        let (weights, bias) = (w.narrow(0, 0, k).unwrap(), flat(&w.narrow(0, k, 1).unwrap()));
        let plain = flat(&a.matmul(&weights).unwrap());
        let value = |row: usize, column: usize| plain[n * (row - row % 4) + column] + bias[column];
        let of = |i: usize| {
            let (row, column) = (i / n, i % n);
            let own = if row.is_multiple_of(4) { value(row, column) } else { plain[i] };
            if value(row, column) > 0.0 { own } else { 0.0 }
        };
        let expected: Vec<f64> = (0..m * n).map(of).collect();
        let made = gpu.read_f32(&c, m * n).unwrap();
        near("product, jets", &made, &expected, 1e-6);

        // Back through the ReLU of this layer's values, from a layer of as many outputs.
        let (next, back) = (numbers(n * n, 1.0, 183), gpu.numbers(m * n));
        let next_buffer = gpu.storage(&next);
        let kernel = tile.kernel("product_back").with("JETS", true).with("MASK", true);
        let rest = params! { m, n, k1: n, lda1: n, every2: 1usize, ldw: n, ldc: n, ldx: n }.rest_is_zero();
        run(&gpu, kernel, rest, &[(1, &d_buffer), (3, &next_buffer), (4, &back), (5, &c)], size);
        let plain = flat(&d.matmul(&wide(&next, &[n, n]).t().unwrap()).unwrap());
        let masked = |i: usize| if value(i / n, i % n) > 0.0 { plain[i] } else { 0.0 };
        let expected: Vec<f64> = (0..m * n).map(masked).collect();
        near("product_back, jets", &gpu.read_f32(&back, m * n).unwrap(), &expected, 1e-6);

        // Biases belong to values alone.
        let parameters = (k + 1) * n;
        let (of_parts, sum) = (gpu.numbers(parameters), gpu.numbers(parameters));
        let size = tile.groups(k, n, 1);
        let rest = params().and(params! { ldw: n, ldc: n, part_rows: m.next_multiple_of(16), parameters });
        let buffers = [(1, &a_buffer), (3, &d_buffer), (4, &of_parts)];
        run(&gpu, tile.kernel("weights").with("JETS", true), rest, &buffers, size);
        let reduce = params! { numbers: parameters, parts: 1usize, of_part: parameters };
        run(&gpu, Kernel::new("reduce"), reduce, &[(1, &of_parts), (2, &sum)], groups(parameters));
        let mut expected = flat(&a.t().unwrap().matmul(&d).unwrap());
        let d = flat(&d);
        expected.extend((0..n).map(|column| (0..points).map(|point| d[4 * n * point + column]).sum::<f64>()));
        near("weights, jets", &gpu.read_f32(&sum, parameters).unwrap(), &expected, 1e-6);
    }
}
