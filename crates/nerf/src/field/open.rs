//! Which channels of the encodings are open.

use candle_core::{DType, Device, Tensor};

use crate::base::Result;
use crate::field::settings::{Encoding, FieldConfig};

use super::{encoded_channels, position_channels};

/// Returns for each layer, in the order of parameters, the factors of its inputs, `[1, inputs]`, or `None` if all are 1.
/// `fraction` of the opening is over ([`FieldConfig::frequency_steps`]).
pub fn opening_factors(
    config: &FieldConfig,
    fraction: f64,
    dtype: DType,
    device: &Device,
) -> Result<Vec<Option<Tensor>>> {
    // Channels next to each other that open at once: one of each axis, or a level's features.
    let at_once = match config.encoding {
        Encoding::Positional | Encoding::Integrated => 3,
        Encoding::Hash => config.hash.features,
    };
    let position_factors = channel_factors(position_channels(config), at_once, fraction);
    let view_factors = channel_factors(encoded_channels(config.view_octaves), 3, fraction);
    let open = vec![1.0; config.width];
    let concatenated = |first: &[f64], second: &[f64]| Some([first, second].concat());
    let trunk_factors = (0..config.depth).map(|i| match i {
        0 => Some(position_factors.clone()),
        i if config.skips.contains(&i) => concatenated(&position_factors, &open),
        _ => None,
    });
    let view_layer_factors =
        (0..config.view_depth).map(|i| if i == 0 { concatenated(&open, &view_factors) } else { None });
    let (heads, rgb) = ([None, None], [None]);
    let row = |factors: Vec<f64>| Tensor::from_vec(factors.clone(), (1, factors.len()), device)?.to_dtype(dtype);
    let rows = trunk_factors
        .chain(heads)
        .chain(view_layer_factors)
        .chain(rgb)
        .map(|factors| Ok(factors.map(row).transpose()?));
    rows.collect()
}

fn channel_factors(channels: usize, at_once: usize, fraction: f64) -> Vec<f64> {
    let open = fraction * (channels / at_once) as f64 + 1.0;
    (0..channels).map(|channel| (open - (channel / at_once) as f64).clamp(0.0, 1.0)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::rng::{Random, Stream};
    use crate::field::Field;
    use crate::field::settings::Core;

    /// Of 2 octaves: x, sin x, cos x, sin 2x, cos 2x, each of three axes.
    #[test]
    fn low_frequencies_open_first() {
        let first_axis = |fraction: f64| channel_factors(15, 3, fraction).into_iter().step_by(3).collect::<Vec<f64>>();
        assert_eq!(first_axis(0.0), [1.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(first_axis(0.3), [1.0, 1.0, 0.5, 0.0, 0.0]);
        assert_eq!(first_axis(1.0), [1.0; 5]);
        assert_eq!(channel_factors(8, 2, 0.375), [1.0, 1.0, 1.0, 1.0, 0.5, 0.5, 0.0, 0.0]);
    }

    fn configs() -> [FieldConfig; 2] {
        let network = FieldConfig {
            width: 16,
            depth: 3,
            skips: vec![2],
            position_octaves: 3,
            view_octaves: 2,
            ..FieldConfig::default()
        };
        let mut grid = FieldConfig { encoding: Encoding::Hash, skips: Vec::new(), ..network.clone() };
        (grid.hash.levels, grid.hash.log2_table, grid.hash.bounds) = (4, 8, Some([[-1.0; 3], [1.0; 3]]));
        [network, grid]
    }

    /// The same field with its weights multiplied by hand.
    fn by_hand(field: &Field, config: &FieldConfig, fraction: f64) -> (Field, Vec<Option<Tensor>>) {
        let factors = opening_factors(config, fraction, field.dtype(), field.device()).unwrap();
        let tables = usize::from(field.hash_grid().is_some());
        let factor = |i: usize| i.checked_sub(tables).filter(|i| i % 2 == 0).and_then(|i| factors[i / 2].clone());
        let factors: Vec<Option<Tensor>> = (0..field.variables().len()).map(factor).collect();
        let values = field.variables().iter().zip(&factors).map(|((_, var), factor)| match factor {
            Some(factor) => var.as_tensor().broadcast_mul(factor).unwrap(),
            None => var.as_tensor().clone(),
        });
        (Field::from_parameters(config, values.collect()).unwrap(), factors)
    }

    fn largest(tensor: &Tensor) -> f64 {
        tensor.abs().unwrap().max_all().unwrap().to_dtype(DType::F64).unwrap().to_scalar().unwrap()
    }

    /// Output and gradients of a hidden field are those of weights multiplied by hand, by candle's graph in f64, by the fused
    /// core, and for density's slope in space.
    #[test]
    fn hidden_channels_are_columns_of_zeros() {
        for config in configs() {
            for (dtype, core, most) in [(DType::F64, Core::Plain, 1e-12), (DType::F32, Core::Fused, 1e-5)] {
                let config = FieldConfig { core, ..config.clone() };
                let field = Field::init(&config, 5, 0, dtype, &Device::Cpu).unwrap();
                let (multiplied, factors) = by_hand(&field, &config, 0.3);
                let mut random = Random::new(1, Stream::Jitter, 0);
                let points = random.uniform_tensor(&[40, 3], dtype, &Device::Cpu).unwrap().affine(1.6, -0.8).unwrap();
                let ahead = Tensor::new(&[[0.0f64, 0.6, 0.8]], &Device::Cpu).unwrap().to_dtype(dtype).unwrap();
                let gradients = |field: &Field| {
                    let recording = field.recording().unwrap();
                    let raw = recording.forward(&points, &ahead, None).unwrap();
                    let sum = (raw.rgb.sqr().unwrap().sum_all().unwrap()
                        + raw.density.sqr().unwrap().sum_all().unwrap())
                    .unwrap();
                    let store = sum.backward().unwrap();
                    let gradients_in_graph = field.variables().iter().map(|(_, var)| store.get(var).cloned());
                    let recorded = recording.recorded().unwrap();
                    let gradients: Vec<_> =
                        gradients_in_graph.zip(recorded).map(|(graph, recorded)| recorded.or(graph)).collect();
                    (raw.density.detach(), gradients)
                };
                let opened = field.opened(0.3).unwrap();
                let ((density, found), (expected, by_hand)) = (gradients(&opened), gradients(&multiplied));
                assert!(largest(&(density - expected).unwrap()) <= most);
                let mut compared = 0;
                let mut compare = |found: &[Option<Tensor>], by_hand: &[Option<Tensor>]| {
                    for ((found, by_hand), factor) in found.iter().zip(by_hand).zip(&factors) {
                        let (Some(found), Some(by_hand)) = (found, by_hand) else { continue };
                        let factor = factor.clone().unwrap_or_else(|| by_hand.ones_like().unwrap());
                        let expected = by_hand.broadcast_mul(&factor).unwrap();
                        let scale = 1.0 + largest(&expected);
                        assert!(largest(&(found - expected).unwrap()) <= most * scale, "{dtype:?}");
                        compared += 1;
                    }
                };
                compare(&found, &by_hand);
                // Density's slope, and the gradients of its sum.
                let slopes = |field: &Field| {
                    let field = field.prepared().unwrap();
                    let spatial = field.spatial_up_to(crate::field::Order::Gradient, &points).unwrap();
                    let ones = Some(spatial.at.density.ones_like().unwrap());
                    let along = Some(spatial.at.gradient.ones_like().unwrap());
                    let cotangents = crate::field::Cotangents { density: ones, gradient: along, laplacian: None };
                    (spatial.at.gradient.clone(), spatial.weight_gradients(&cotangents).unwrap().0)
                };
                let ((slope, found), (expected, by_hand)) = (slopes(&opened), slopes(&multiplied));
                assert!(largest(&(slope - expected).unwrap()) <= most * 10.0);
                compare(&found, &by_hand);
                assert!(compared >= 20, "{compared}");
                // All open again.
                let reopened = opened.opened(1.0).unwrap();
                let [a, b] = [&reopened, &field]
                    .map(|field| gradients(field).0.to_dtype(DType::F64).unwrap().to_vec1::<f64>().unwrap());
                assert_eq!(a, b);
            }
        }
    }
}
