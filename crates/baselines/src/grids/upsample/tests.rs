use candle_core::Var;

use super::*;
use crate::grids::reference::{error, fixture, ramp};

/// `[1, c, z, y, x]` to `[z, y, x, c]`.
fn lattice(tensor: &Tensor) -> Tensor {
    tensor.squeeze(0).unwrap().permute((1, 2, 3, 0)).unwrap().contiguous().unwrap()
}

/// The finer lattice as it is said: each cell eight times.
fn finer(x: &Tensor) -> Tensor {
    (0..3).fold(x.clone(), |x, axis| {
        let twice: Vec<u32> = (0..2 * x.dim(axis).unwrap() as u32).map(|cell| cell / 2).collect();
        x.index_select(&Tensor::new(twice, x.device()).unwrap(), axis).unwrap()
    })
}

/// Result and gradients of `sum(out * cotangent)` in x, weight and bias.
fn all_of(
    of: impl Fn(&Tensor, &Tensor, &Tensor) -> Tensor,
    arguments: &[Tensor; 3],
    cotangent: &Tensor,
) -> Vec<Tensor> {
    let [x, weight, bias] = arguments.each_ref().map(|tensor| Var::from_tensor(tensor).unwrap());
    let out = of(&x, &weight, &bias);
    let gradients = (&out * cotangent).unwrap().sum_all().unwrap().backward().unwrap();
    std::iter::once(out).chain([x, weight, bias].map(|var| gradients.get(&var).unwrap().clone())).collect()
}

fn up(x: &Tensor, weight: &Tensor, bias: &Tensor) -> Tensor {
    convolution(x, weight, bias).unwrap()
}

fn f32_of(tensor: &Tensor) -> Tensor {
    tensor.to_dtype(DType::F32).unwrap()
}

fn case(sides: [usize; 3], inputs: usize, outputs: usize) -> ([Tensor; 3], Tensor) {
    let [z, y, x] = sides;
    let arguments = [ramp(&[z, y, x, inputs], 0.3), ramp(&[TAPS, inputs, outputs], 0.6), ramp(&[outputs], 0.9)];
    (arguments, ramp(&[2 * z, 2 * y, 2 * x, outputs], 0.2))
}

/// With a kernel that copies, values and gradients are those of torch's nearest neighbours.
#[test]
fn copies_are_torch_s() {
    let x = lattice(&fixture("llff.up.x"));
    let channels = x.dim(3).unwrap();
    let one = Tensor::eye(channels, DType::F64, &Device::Cpu).unwrap().unsqueeze(0).unwrap();
    let zeros = Tensor::zeros((TAPS / 2, channels, channels), DType::F64, &Device::Cpu).unwrap();
    let copy = Tensor::cat(&[&zeros, &one, &zeros], 0).unwrap();
    let bias = Tensor::zeros(channels, DType::F64, &Device::Cpu).unwrap();
    let found = all_of(up, &[x.clone(), copy, bias], &lattice(&fixture("llff.up.cotangent")));
    assert_eq!(error(&found[0], &lattice(&fixture("llff.up.out"))), 0.0);
    assert_eq!(error(&finer(&x), &lattice(&fixture("llff.up.out"))), 0.0);
    assert!(error(&found[1], &lattice(&fixture("llff.up.grad.x"))) < 1e-14);
}

#[test]
fn it_is_the_convolution_of_the_finer_lattice() {
    let slow = |x: &Tensor, weight: &Tensor, bias: &Tensor| {
        let x = finer(x);
        let (z, y, width, _) = x.dims4().unwrap();
        Conv3d::convolution([z, y, width], 1, 1).forward(&x, weight, bias).unwrap()
    };
    for (sides, inputs, outputs) in [([1, 1, 1], 2, 3), ([2, 3, 4], 5, 2), ([3, 2, 5], 33, 8)] {
        let (arguments, cotangent) = case(sides, inputs, outputs);
        let expected = all_of(slow, &arguments, &cotangent);
        let plain = all_of(up, &arguments, &cotangent);
        let fast = all_of(up, &arguments.each_ref().map(f32_of), &f32_of(&cotangent));
        for ((expected, plain), fast) in expected.iter().zip(&plain).zip(&fast) {
            assert!(error(plain, expected) < 1e-13, "{sides:?}: {}", error(plain, expected));
            assert!(error(fast, expected) < 3e-6, "{sides:?}: {}", error(fast, expected));
        }
    }
}

#[test]
fn other_kernels_are_refused() {
    let ([x, weight, bias], _) = case([2, 2, 2], 2, 2);
    let said = convolution(&x, &weight.narrow(0, 0, 8).unwrap(), &bias).unwrap_err();
    assert!(said.to_string().contains("27 taps, not 8"), "{said}");
}
