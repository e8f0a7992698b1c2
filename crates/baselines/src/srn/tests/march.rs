//! Marches in f32 on packed weights against those of candle's operations in f64.

use candle_core::{DType, Device, Tensor};

use crate::base::rng::{Random, Stream};
use crate::data::Rays;
use crate::methods::Gradients;
use crate::settings::SrnConfig;
use crate::srn::fast::{Lines, Network};
use crate::srn::network::Srn;
use crate::srn::step::{Sums, Weights};

/// Rays that look about from near (0, 0, 4), and colours.
struct Given {
    origins: Vec<f32>,
    directions: Vec<f32>,
    viewdirs: Vec<f32>,
    z_0: Vec<f32>,
    target: Vec<f32>,
}

impl Given {
    fn new(rays: usize) -> Given {
        let mut random = Random::new(3, Stream::March, 0);
        let mut uniform = |count: usize| -> Vec<f32> {
            random.uniform_values(count).into_iter().map(|value| 2.0 * value - 1.0).collect()
        };
        let origins = uniform(3 * rays).chunks(3).flat_map(|o| [o[0], o[1], 4.0 + o[2]]).collect();
        let directions: Vec<f32> = uniform(2 * rays).chunks(2).flat_map(|d| [0.5 * d[0], 0.5 * d[1], -1.0]).collect();
        let unit = |d: &[f32]| {
            let norm = d.iter().map(|d| d * d).sum::<f32>().sqrt();
            [d[0] / norm, d[1] / norm, d[2] / norm]
        };
        let viewdirs = directions.chunks(3).flat_map(unit).collect();
        // Some rays start behind their camera, so that some depths end there.
        let z_0 = uniform(rays);
        Given { origins, directions, viewdirs, z_0, target: uniform(3 * rays) }
    }

    fn lines(&self) -> Lines<'_> {
        Lines { origins: &self.origins, directions: &self.directions, viewdirs: &self.viewdirs, z_0: &self.z_0 }
    }

    fn rays(&self, dtype: DType) -> Rays {
        let tensor = |values: &[f32]| {
            Tensor::from_slice(values, (values.len() / 3, 3), &Device::Cpu).unwrap().to_dtype(dtype).unwrap()
        };
        Rays::new(tensor(&self.origins), tensor(&self.directions), tensor(&self.viewdirs)).unwrap()
    }
}

/// Every parameter away from its special start.
fn srn(config: &SrnConfig) -> Srn {
    let srn = Srn::init(config, 5, DType::F32, &Device::Cpu).unwrap();
    let mut random = Random::new(5, Stream::March, 1);
    let moved = srn.parameters.variables.iter().map(|(_, var)| {
        let noise = random.normal_tensor(var.dims(), DType::F32, &Device::Cpu).unwrap();
        (var.as_tensor() + (noise * 0.05).unwrap()).unwrap()
    });
    Srn::from_parameters(config, moved.collect()).unwrap()
}

fn in_f64(srn: &Srn) -> Srn {
    let values = srn.parameters.variables.iter().map(|(_, var)| var.to_dtype(DType::F64).unwrap()).collect();
    Srn::from_parameters(srn.config(), values).unwrap()
}

fn values(tensor: &Tensor) -> Vec<f64> {
    tensor.to_dtype(DType::F64).unwrap().flatten_all().unwrap().to_vec1().unwrap()
}

/// Largest difference over the largest number.
fn difference(found: impl IntoIterator<Item = f64>, expected: &[f64]) -> f64 {
    let largest = expected.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
    found.into_iter().zip(expected).fold(0.0, |far: f64, (a, b)| far.max((a - b).abs())) / largest
}

/// Widths that fill panels and that do not, few rays and many; weights of the loss at which gradients at the cell's outputs are
/// cut and at which they are not.
#[test]
fn marches_and_gradients_are_those_of_f64() {
    for (width, rays, weight) in [(256, 20, 1.0), (96, 7, 1.0), (20, 1, 1.0), (8, 33, 1.0), (64, 20, 1e4)] {
        let config = SrnConfig { width, phi_layers: 3, pixel_layers: 2, steps: 4, ..SrnConfig::default() };
        let (srn, given) = (srn(&config), Given::new(rays));
        let weights = Weights { image: weight / rays as f64, depth: 0.5 * weight / rays as f64 };
        let exact = in_f64(&srn);
        let z_0 = Tensor::from_slice(&given.z_0, (rays, 1), &Device::Cpu).unwrap().to_dtype(DType::F64).unwrap();
        let march = exact.march(&given.rays(DType::F64), &z_0).unwrap();
        let mut sums = Sums::new(None, &exact);
        sums.add_plain(&exact, &march, &given.target, weights).unwrap();
        let network = Network::of(&srn).unwrap();
        let tape = network.march(given.lines(), true);
        let single = |values: &[f32]| values.iter().map(|value| f64::from(*value)).collect::<Vec<f64>>();
        let far =
            [difference(single(&tape.colour), &values(&march.colour)), difference(single(&tape.z), &values(&march.z))];
        assert!(far.iter().all(|far| *far < 1e-4), "width {width}: {far:?}");
        let shown = network.march(given.lines(), false);
        assert!(shown.colour == tape.colour && shown.z == tape.z, "width {width}");
        let mut of_fast = Sums::new(Some(&network), &srn);
        of_fast.add_packed(&network, given.lines(), &given.target, weights);
        let (Gradients(found), Gradients(expected)) =
            (of_fast.gradients(&srn).unwrap(), sums.gradients(&exact).unwrap());
        for ((name, _), (found, expected)) in srn.parameters.variables.iter().zip(found.iter().zip(&expected)) {
            let far = difference(values(found.as_ref().unwrap()), &values(expected.as_ref().unwrap()));
            assert!(far < 2e-3, "width {width}, {name}: {far}");
        }
    }
}
