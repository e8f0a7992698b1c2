//! What tests hold operations to: numbers of the original modules, finite differences, any number of threads.

use std::fmt::Debug;
use std::path::Path;

use candle_core::{DType, Device, Tensor, Var};

/// A tensor of `tests/fixtures/baselines.safetensors`, in f64.
pub(crate) fn fixture(name: &str) -> Tensor {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/baselines.safetensors");
    let bytes = std::fs::read(file).unwrap();
    let tensors = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let view = tensors.tensor(name).unwrap_or_else(|_| panic!("no tensor {name}"));
    let values: Vec<f64> = match view.dtype() {
        safetensors::Dtype::F32 => {
            view.data().as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes).into()).collect()
        }
        safetensors::Dtype::F64 => {
            view.data().as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect()
        }
        other => panic!("{name} is {other:?}"),
    };
    Tensor::from_vec(values, view.shape(), &Device::Cpu).unwrap()
}

/// `[1, channels, z, y, x]`, or `[channels, z, y, x]`, with channels last.
pub(crate) fn channels_last(grid: &Tensor) -> Tensor {
    let grid = grid.flatten_to(grid.rank() - 4).unwrap();
    grid.permute([1, 2, 3, 0]).unwrap().contiguous().unwrap()
}

pub(crate) fn single(tensor: &Tensor) -> Tensor {
    tensor.to_dtype(DType::F32).unwrap()
}

/// The result of an operation, and the gradients of `sum(result * cotangent)` in its arguments.
pub(crate) fn with_gradients<const N: usize, E: Debug>(
    arguments: &[Tensor; N],
    cotangent: &Tensor,
    operation: impl Fn([&Tensor; N]) -> Result<Tensor, E>,
) -> Vec<Tensor> {
    let variables = arguments.each_ref().map(|tensor| Var::from_tensor(tensor).unwrap());
    let out = operation(variables.each_ref().map(Var::as_tensor)).unwrap();
    let store = (&out * cotangent).unwrap().sum_all().unwrap().backward().unwrap();
    std::iter::once(out).chain(variables.iter().map(|var| store.get(var).unwrap().clone())).collect()
}

/// Smooth numbers between -1 and 1.
pub(crate) fn ramp(shape: &[usize], phase: f64) -> Tensor {
    let n: usize = shape.iter().product();
    let values: Vec<f64> = (0..n).map(|i| (i as f64 * 0.73 + phase).sin()).collect();
    Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
}

pub(crate) fn values(tensor: &Tensor) -> Vec<f64> {
    tensor.to_dtype(DType::F64).unwrap().contiguous().unwrap().flatten_all().unwrap().to_vec1().unwrap()
}

/// Largest difference over the largest number of `expected` (or 1e-300).
pub(crate) fn error(found: &Tensor, expected: &Tensor) -> f64 {
    assert_eq!(found.dims(), expected.dims());
    let (found, expected) = (values(found), values(expected));
    let size = expected.iter().fold(1e-300f64, |size, value| size.max(value.abs()));
    let of = |(a, b): (&f64, &f64)| if (a - b).is_nan() { f64::INFINITY } else { (a - b).abs() };
    found.iter().zip(&expected).map(of).fold(0.0, f64::max) / size
}

/// Asserts that the gradients of a scalar function of variables are those of central differences.
pub(crate) fn check_differences(variables: &[Var], tolerance: f64, function: impl Fn() -> Tensor) {
    const STEP: f64 = 1e-5;
    let gradients = function().backward().unwrap();
    for (index, var) in variables.iter().enumerate() {
        let found = gradients.get(var).unwrap_or_else(|| panic!("variable {index} has no gradient"));
        let (shape, at) = (var.dims().to_vec(), values(var));
        let moved = |place: usize, by: f64| {
            let mut at = at.clone();
            at[place] += by;
            var.set(&Tensor::from_vec(at, &shape[..], &Device::Cpu).unwrap()).unwrap();
            function().to_scalar::<f64>().unwrap()
        };
        let slope = |place: usize| (moved(place, STEP) - moved(place, -STEP)) / (2.0 * STEP);
        let expected: Vec<f64> = (0..at.len()).map(slope).collect();
        var.set(&Tensor::from_vec(at, &shape[..], &Device::Cpu).unwrap()).unwrap();
        let expected = Tensor::from_vec(expected, &shape[..], &Device::Cpu).unwrap();
        let error = error(found, &expected);
        assert!(error < tolerance, "variable {index}: {error}");
    }
}

/// What `work` gives on one, two and three threads, which must be the same to the bit.
pub(crate) fn on_any_threads(work: impl Fn() -> Vec<Tensor> + Sync) -> Vec<Tensor> {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(&work)
    };
    let one = run(1);
    for threads in [2, 3] {
        for (index, (a, b)) in one.iter().zip(run(threads)).enumerate() {
            let bits = |tensor: &Tensor| values(tensor).into_iter().map(f64::to_bits).collect::<Vec<u64>>();
            assert_eq!(bits(a), bits(&b), "result {index} on {threads} threads");
        }
    }
    one
}
