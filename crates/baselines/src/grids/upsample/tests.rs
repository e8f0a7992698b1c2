use super::*;
use crate::grids::reference::{channels_last, error, fixture, ramp, single, with_gradients};

/// The finer lattice as it is said: each cell eight times.
fn finer(x: &Tensor) -> Tensor {
    (0..3).fold(x.clone(), |x, axis| {
        let twice: Vec<u32> = (0..2 * x.dim(axis).unwrap() as u32).map(|cell| cell / 2).collect();
        x.index_select(&Tensor::new(twice, x.device()).unwrap(), axis).unwrap()
    })
}

fn up([x, weight, bias]: [&Tensor; 3]) -> Result<Tensor> {
    convolution(x, weight, bias)
}

fn case(sides: [usize; 3], inputs: usize, outputs: usize) -> ([Tensor; 3], Tensor) {
    let [z, y, x] = sides;
    let arguments = [ramp(&[z, y, x, inputs], 0.3), ramp(&[TAPS, inputs, outputs], 0.6), ramp(&[outputs], 0.9)];
    (arguments, ramp(&[2 * z, 2 * y, 2 * x, outputs], 0.2))
}

/// With a kernel that copies, values and gradients are those of torch's nearest neighbours.
#[test]
fn copies_are_torch_s() {
    let x = channels_last(&fixture("llff.up.x"));
    let channels = x.dim(3).unwrap();
    let one = Tensor::eye(channels, DType::F64, &Device::Cpu).unwrap().unsqueeze(0).unwrap();
    let zeros = Tensor::zeros((TAPS / 2, channels, channels), DType::F64, &Device::Cpu).unwrap();
    let copy = Tensor::cat(&[&zeros, &one, &zeros], 0).unwrap();
    let bias = Tensor::zeros(channels, DType::F64, &Device::Cpu).unwrap();
    let found = with_gradients(&[x.clone(), copy, bias], &channels_last(&fixture("llff.up.cotangent")), up);
    assert_eq!(error(&found[0], &channels_last(&fixture("llff.up.out"))), 0.0);
    assert_eq!(error(&finer(&x), &channels_last(&fixture("llff.up.out"))), 0.0);
    assert!(error(&found[1], &channels_last(&fixture("llff.up.grad.x"))) < 1e-14);
}

#[test]
fn it_is_the_convolution_of_the_finer_lattice() {
    let slow = |[x, weight, bias]: [&Tensor; 3]| {
        let x = finer(x);
        let (z, y, width, _) = x.dims4().unwrap();
        Conv3d::convolution([z, y, width], 1, 1).forward(&x, weight, bias)
    };
    for (sides, inputs, outputs) in [([1, 1, 1], 2, 3), ([2, 3, 4], 5, 2), ([3, 2, 5], 33, 8)] {
        let (arguments, cotangent) = case(sides, inputs, outputs);
        let expected = with_gradients(&arguments, &cotangent, slow);
        let plain = with_gradients(&arguments, &cotangent, up);
        let fast = with_gradients(&arguments.each_ref().map(single), &single(&cotangent), up);
        for ((expected, plain), fast) in expected.iter().zip(&plain).zip(&fast) {
            assert!(error(plain, expected) < 1e-13, "{sides:?}: {}", error(plain, expected));
            assert!(error(fast, expected) < 3e-6, "{sides:?}: {}", error(fast, expected));
        }
    }
}
