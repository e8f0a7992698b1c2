use super::*;
use crate::grids::reference::{channels_last, error, fixture, on_any_threads, ramp, single, with_gradients};

/// Weights `[out, in, z, y, x]`, or `[in, out, z, y, x]` of transposed convolutions, in the order of taps.
fn in_order(product: &Conv3d, weight: &Tensor, transposed: bool) -> Tensor {
    let axes = if transposed { [2, 3, 4, 0, 1] } else { [2, 3, 4, 1, 0] };
    let weight = weight.permute(axes).unwrap().contiguous().unwrap();
    let (_, height, width, inputs, outputs) = weight.dims5().unwrap();
    let flat = weight.reshape(((), inputs, outputs)).unwrap();
    let order: Vec<u32> = product.kernel().iter().map(|[z, y, x]| ((z * height + y) * width + x) as u32).collect();
    flat.index_select(&Tensor::new(order, &Device::Cpu).unwrap(), 0).unwrap()
}

/// Result and gradients of `sum(out * cotangent)` in x, weight and bias.
fn all_of(product: &Conv3d, arguments: &[Tensor; 3], cotangent: &Tensor) -> Vec<Tensor> {
    with_gradients(arguments, cotangent, |[x, weight, bias]| product.forward(x, weight, bias))
}

/// Numbers of the original modules, in f64 to 1e-6 (they are rounded to f32) and in f32 to 1e-5.
#[test]
fn numbers_are_those_of_torch() {
    let sides = |name: &str| {
        let (_, _, z, y, x) = fixture(&format!("{name}.x")).dims5().unwrap();
        [z, y, x]
    };
    let cases = [
        ("nv.deconv", Conv3d::transposed(sides("nv.deconv"))),
        ("llff.conv.plain", Conv3d::convolution(sides("llff.conv.plain"), 1, 1)),
        ("llff.conv.stride2", Conv3d::convolution(sides("llff.conv.stride2"), 2, 1)),
        ("llff.conv.dilation2", Conv3d::convolution(sides("llff.conv.dilation2"), 1, 2)),
    ];
    for (name, product) in cases {
        let of = |what: &str| fixture(&format!("{name}.{what}"));
        let weight = |what: &str| in_order(&product, &of(what), name == "nv.deconv");
        let arguments = [channels_last(&of("x")), weight("weight"), of("bias")];
        let cotangent = channels_last(&of("cotangent"));
        let expected =
            [channels_last(&of("out")), channels_last(&of("grad.x")), weight("grad.weight"), of("grad.bias")];
        for (found, expected) in all_of(&product, &arguments, &cotangent).iter().zip(&expected) {
            assert!(error(found, expected) < 1e-6, "{name}, plain: {}", error(found, expected));
        }
        let found = all_of(&product, &arguments.each_ref().map(single), &single(&cotangent));
        for (found, expected) in found.iter().zip(&expected) {
            assert!(error(found, expected) < 1e-5, "{name}, fast: {}", error(found, expected));
        }
    }
}

/// All kinds of products over odd, even and single cells, few channels and many.
fn shapes() -> Vec<(Conv3d, [Tensor; 3], Tensor)> {
    let kinds: [(usize, usize); 4] = [(1, 1), (2, 1), (1, 2), (0, 0)];
    let sizes = [([1, 1, 1], 40, 36), ([2, 3, 5], 3, 40), ([5, 6, 7], 35, 4), ([9, 8, 6], 5, 6)];
    let mut all = Vec::new();
    for (stride, dilation) in kinds {
        for (sides, inputs, outputs) in sizes {
            let product = match stride {
                0 => Conv3d::transposed(sides).leaky(0.2),
                _ => Conv3d::convolution(sides, stride, dilation).leaky(0.5),
            };
            let [z, y, x] = sides;
            let weight = ramp(&[product.kernel().len(), inputs, outputs], 0.4);
            let arguments = [ramp(&[z, y, x, inputs], 0.1), weight, ramp(&[outputs], 0.9)];
            let [z, y, x] = product.plan.sides;
            all.push((product, arguments, ramp(&[z, y, x, outputs], 0.7)));
        }
    }
    all
}

#[test]
fn fast_products_are_the_plain_ones_on_any_number_of_threads() {
    for (product, arguments, cotangent) in shapes() {
        let plain = all_of(&product, &arguments, &cotangent);
        let (arguments, cotangent) = (arguments.each_ref().map(single), single(&cotangent));
        let fast = on_any_threads(|| all_of(&product, &arguments, &cotangent));
        for (index, (fast, plain)) in fast.iter().zip(&plain).enumerate() {
            let error = error(fast, plain);
            assert!(error < 3e-6, "{:?} -> {:?}, {index}: {error}", product.plan.sources, product.plan.sides);
        }
    }
}
