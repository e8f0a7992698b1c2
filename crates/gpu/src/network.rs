//! A field's parameters on the device: matrices `[inputs + 1, outputs]` whose last row is the bias, one after another.

use augnerf_core::base::Result;
use augnerf_core::field::hash::{HashGrid, Level};
use augnerf_core::field::{encoded_channels, position_channels};
use augnerf_core::settings::{Contraction, Encoding, FieldConfig, Interpolation};
use candle_core::{Device, Tensor};
use wgpu::Buffer;

use crate::device::Gpu;

/// A layer's matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Layer {
    pub(crate) offset: usize,
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
}

impl Layer {
    fn end(&self) -> usize {
        self.offset + (self.inputs + 1) * self.outputs
    }
}

/// The sizes of a field's networks.
#[derive(Clone, Debug)]
pub(crate) struct Shape {
    /// Of a position's encoding.
    pub(crate) channels: usize,
    /// Of a view direction's encoding.
    pub(crate) view_channels: usize,
    pub(crate) width: usize,
    pub(crate) view_width: usize,
    pub(crate) skips: Vec<usize>,
    pub(crate) trunk: Vec<Layer>,
    /// The feature for the colour's layers, and density in the last column.
    pub(crate) head: Layer,
    pub(crate) view: Vec<Layer>,
    pub(crate) rgb: Layer,
    pub(crate) grid: Option<GridShape>,
}

/// The sizes of a hash grid.
#[derive(Clone, Debug)]
pub(crate) struct GridShape {
    /// Resolution, entries, offset, and 1 if each vertex has its own entry, of each level.
    pub(crate) levels: Vec<[u32; 4]>,
    pub(crate) features: usize,
    pub(crate) smooth: bool,
    pub(crate) low: [f64; 3],
    pub(crate) high: [f64; 3],
    pub(crate) contraction: u32,
}

impl GridShape {
    fn of(config: &FieldConfig) -> Option<GridShape> {
        if config.encoding != Encoding::Hash {
            return None;
        }
        let hash = &config.hash;
        let [low, high] = hash.bounds.unwrap_or([[-1.5; 3], [1.5; 3]]);
        let contraction = match hash.contraction.unwrap_or(Contraction::None) {
            Contraction::None => 0,
            Contraction::Axes => 1,
            Contraction::Ball => 2,
        };
        let smooth = hash.interpolation == Interpolation::Smoothstep;
        let resolutions = (hash.coarsest as u32, hash.finest.unwrap_or(2048) as u32);
        let grid = HashGrid::new(hash.levels, hash.features, hash.log2_table as u32, resolutions, hash.interpolation);
        let level = |l: &Level| [l.resolution, l.entries as u32, l.offset as u32, u32::from(l.dense)];
        let levels = grid.levels().iter().map(level).collect();
        Some(GridShape { levels, features: hash.features, smooth, low, high, contraction })
    }

    pub(crate) fn entries(&self) -> usize {
        self.levels.last().map_or(0, |[_, entries, offset, _]| (entries + offset) as usize)
    }
}

impl Shape {
    pub(crate) fn of(config: &FieldConfig) -> Shape {
        let (width, view_width) = (config.width, config.view_neurons());
        let channels = position_channels(config);
        let view_channels = encoded_channels(config.view_octaves);
        let mut offset = 0;
        let mut layer = |inputs: usize, outputs: usize| {
            let layer = Layer { offset, inputs, outputs };
            offset = layer.end();
            layer
        };
        let of_trunk = |i: usize| match i {
            0 => channels,
            i if config.skips.contains(&i) => channels + width,
            _ => width,
        };
        let trunk = (0..config.depth).map(|i| layer(of_trunk(i), width)).collect();
        let head = layer(width, width + 1);
        let of_view = |i: usize| if i == 0 { width + view_channels } else { view_width };
        let view = (0..config.view_depth).map(|i| layer(of_view(i), view_width)).collect();
        let rgb = layer(view_width, 3);
        let grid = GridShape::of(config);
        Shape { channels, view_channels, width, view_width, skips: config.skips.clone(), trunk, head, view, rgb, grid }
    }

    /// Returns the number of weights and biases.
    pub(crate) fn weights(&self) -> usize {
        self.rgb.end()
    }

    /// Whether layer `i` of the trunk (from 0) reads the encoding beside the layer below.
    pub(crate) fn skips_to(&self, i: usize) -> bool {
        i > 0 && self.skips.contains(&i)
    }

    /// Returns where the host's layers are, in the order of its parameters: the matrix and the first of its columns.
    fn host_layers(&self) -> Vec<(Layer, usize, usize)> {
        let whole = |layer: &Layer| (*layer, 0, layer.outputs);
        let heads = [(self.head, self.width, 1), (self.head, 0, self.width)];
        self.trunk.iter().map(whole).chain(heads).chain(self.view.iter().map(whole)).chain([whole(&self.rgb)]).collect()
    }

    /// Returns the matrices of the host's weights `[outputs, inputs]` and biases, in the order of its parameters.
    pub(crate) fn to_device(&self, parameters: &[Tensor]) -> Result<Vec<f32>> {
        let mut values = vec![0f32; self.weights()];
        for ((layer, first, outputs), pair) in self.host_layers().into_iter().zip(parameters.chunks(2)) {
            let [weight, bias] = [&pair[0], &pair[1]].map(|tensor| tensor.flatten_all()?.to_vec1::<f32>());
            let (weight, bias) = (weight?, bias?);
            for output in 0..outputs {
                let column = layer.offset + first + output;
                for input in 0..layer.inputs {
                    values[column + input * layer.outputs] = weight[output * layer.inputs + input];
                }
                values[column + layer.inputs * layer.outputs] = bias[output];
            }
        }
        Ok(values)
    }

    /// Returns the host's weights and biases, in the order of its parameters.
    pub(crate) fn to_host(&self, values: &[f32]) -> Result<Vec<Tensor>> {
        let mut parameters = Vec::new();
        for (layer, first, outputs) in self.host_layers() {
            let at = |input: usize, output: usize| values[layer.offset + input * layer.outputs + first + output];
            let weight = (0..outputs).flat_map(|output| (0..layer.inputs).map(move |input| at(input, output)));
            parameters.push(Tensor::from_vec(weight.collect(), (outputs, layer.inputs), &Device::Cpu)?);
            let bias = (0..outputs).map(|output| at(layer.inputs, output)).collect();
            parameters.push(Tensor::from_vec(bias, outputs, &Device::Cpu)?);
        }
        Ok(parameters)
    }
}

/// Parameters and moments of matrices or tables, and what their gradient is summed in.
pub(crate) struct Learned {
    pub(crate) values: Buffer,
    pub(crate) first: Buffer,
    pub(crate) second: Buffer,
    /// Of matrices: the gradient. Of tables: two words a number.
    pub(crate) gradient: Buffer,
    pub(crate) count: usize,
}

impl Learned {
    fn new(gpu: &Gpu, values: &[f32], moments: Option<[Vec<f32>; 2]>, words: usize) -> Learned {
        let moment = |i: usize| match &moments {
            Some(moments) => gpu.storage(&moments[i]),
            None => gpu.numbers(values.len()),
        };
        Learned {
            first: moment(0),
            second: moment(1),
            values: gpu.storage(values),
            gradient: gpu.numbers(words * values.len()),
            count: values.len(),
        }
    }
}

/// A field on the device.
pub(crate) struct FieldBuffers {
    pub(crate) weights: Learned,
    pub(crate) tables: Option<Learned>,
}

impl FieldBuffers {
    /// Copies a field's parameters, with their moments, to the device.
    pub(crate) fn new(
        gpu: &Gpu,
        shape: &Shape,
        parameters: &[Tensor],
        moments: Option<[Vec<Tensor>; 2]>,
    ) -> Result<FieldBuffers> {
        let tables = usize::from(shape.grid.is_some());
        let flat = |tensor: &Tensor| tensor.flatten_all()?.to_vec1::<f32>();
        let weights = shape.to_device(&parameters[tables..])?;
        let (mut of_weights, mut of_tables) = (None, None);
        if let Some([first, second]) = &moments {
            of_weights = Some([shape.to_device(&first[tables..])?, shape.to_device(&second[tables..])?]);
            if tables == 1 {
                of_tables = Some([flat(&first[0])?, flat(&second[0])?]);
            }
        }
        let tables = match tables {
            1 => Some(Learned::new(gpu, &flat(&parameters[0])?, of_tables, 2)),
            _ => None,
        };
        Ok(FieldBuffers { weights: Learned::new(gpu, &weights, of_weights, 1), tables })
    }

    /// Reads parameters, first and second moments, in the host's order and shapes.
    pub(crate) fn read(&self, gpu: &Gpu, shape: &Shape) -> Result<[Vec<Tensor>; 3]> {
        let mut read: [Vec<Tensor>; 3] = Default::default();
        if let (Some(tables), Some(grid)) = (&self.tables, &shape.grid) {
            for (to, buffer) in read.iter_mut().zip([&tables.values, &tables.first, &tables.second]) {
                let values = gpu.read_f32(buffer, tables.count)?;
                to.push(Tensor::from_vec(values, (grid.entries(), grid.features), &Device::Cpu)?);
            }
        }
        let Learned { values, first, second, count, .. } = &self.weights;
        for (to, buffer) in read.iter_mut().zip([values, first, second]) {
            to.extend(shape.to_host(&gpu.read_f32(buffer, *count)?)?);
        }
        Ok(read)
    }

    /// Reads the gradients that were summed, in the host's order and shapes.
    pub(crate) fn gradients(&self, gpu: &Gpu, shape: &Shape, loss_scale: f64) -> Result<Vec<Tensor>> {
        let mut read = Vec::new();
        if let (Some(tables), Some(grid)) = (&self.tables, &shape.grid) {
            let bytes = gpu.read(&[&tables.gradient])?.remove(0);
            let sums: Vec<[u32; 2]> = bytemuck::pod_collect_to_vec(&bytes[..8 * tables.count]);
            let value =
                |[low, high]: [u32; 2]| ((u64::from(high) << 32 | u64::from(low)) as i64 as f64 / 2f64.powi(56)) as f32;
            let values = sums.into_iter().map(value).collect();
            read.push(Tensor::from_vec(values, (grid.entries(), grid.features), &Device::Cpu)?);
        }
        let scaled = gpu.read_f32(&self.weights.gradient, self.weights.count)?;
        read.extend(shape.to_host(&scaled.iter().map(|g| g / loss_scale as f32).collect::<Vec<f32>>())?);
        Ok(read)
    }
}
