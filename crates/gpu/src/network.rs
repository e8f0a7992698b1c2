//! A field's parameters on the device: matrices `[inputs + 1, outputs]` whose last row is the bias, one after another.

use std::ops::Range;

use augnerf_base::Result;
use augnerf_nerf::field::hash::{Domain, HashGrid};
use augnerf_nerf::field::{Field, encoded_channels, opening_factors, position_channels};
use augnerf_nerf::settings::{Encoding, FieldConfig};
use candle_core::{DType, Device, Tensor};
use wgpu::Buffer;

use crate::device::Gpu;

/// Returns the size that pads `numbers` to fours.
pub(crate) fn padded(numbers: usize) -> usize {
    numbers.next_multiple_of(4)
}

/// A layer's matrix. Inputs and outputs are padded to fours by weights that are 0 and stay so.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Layer {
    pub(crate) offset: usize,
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
}

impl Layer {
    /// Returns its columns in products: those of wide layers apart from the four that come after the head's feature, which would fill a
    /// tile with nothing.
    pub(crate) fn products(&self) -> impl Iterator<Item = Range<usize>> {
        let wide = match self.outputs / 64 * 64 {
            wide if wide > 0 && self.outputs - wide == 4 => wide,
            _ => self.outputs,
        };
        [0..wide, wide..self.outputs].into_iter().filter(|columns| !columns.is_empty())
    }

    /// Returns the place after its last number.
    pub(crate) fn end(&self) -> usize {
        self.offset + (self.inputs + 1) * self.outputs
    }
}

/// One of the host's layers in a matrix of the device.
struct HostLayer {
    layer: Layer,
    /// Its first column, and their number.
    first: usize,
    outputs: usize,
    /// Inputs of its one or two operands.
    inputs: [usize; 2],
}

impl HostLayer {
    /// The row of one of the host's inputs.
    fn row(&self, input: usize) -> usize {
        if input < self.inputs[0] { input } else { padded(self.inputs[0]) + input - self.inputs[0] }
    }

    fn all_inputs(&self) -> usize {
        self.inputs.iter().sum()
    }

    /// Returns the places of the host's weights `[outputs, inputs]`, and then of its biases.
    fn places(&self) -> impl Iterator<Item = usize> {
        let Layer { offset, inputs, outputs } = self.layer;
        let of_output = move |output: usize| (0..self.all_inputs()).map(move |input| (self.row(input), output));
        let weights = (0..self.outputs).flat_map(of_output);
        let biases = (0..self.outputs).map(move |output| (inputs, output));
        weights.chain(biases).map(move |(row, output)| offset + row * outputs + self.first + output)
    }
}

/// The sizes of a field's networks, padded to fours.
#[derive(Clone, Debug)]
pub(crate) struct Shape {
    /// Of a position's encoding.
    pub(crate) channels: usize,
    pub(crate) octaves: usize,
    /// The field is queried at Gaussians.
    pub(crate) is_integrated: bool,
    /// Of a view direction's encoding.
    pub(crate) view_channels: usize,
    pub(crate) view_octaves: usize,
    pub(crate) width: usize,
    pub(crate) view_width: usize,
    pub(crate) skips: Vec<usize>,
    pub(crate) trunk: Vec<Layer>,
    /// The feature for the colour's layers, then density.
    pub(crate) head: Layer,
    pub(crate) view: Vec<Layer>,
    pub(crate) rgb: Layer,
    pub(crate) grid: Option<HashGrid>,
    pub(crate) domain: Option<Domain>,
    /// Without padding: channels of positions and directions, and neurons between trunk and colour.
    unpadded: [usize; 3],
}

impl Shape {
    pub(crate) fn of(config: &FieldConfig) -> Shape {
        let unpadded = [position_channels(config), encoded_channels(config.view_octaves), config.view_neurons()];
        let [channels, view_channels, view_width] = unpadded.map(padded);
        let width = config.width;
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
        let (grid, domain) = (config.encoding == Encoding::Hash).then(|| config.hash.grid()).unzip();
        Shape {
            channels,
            octaves: config.position_octaves,
            is_integrated: config.encoding.queries_gaussians(),
            view_channels,
            view_octaves: config.view_octaves,
            width,
            view_width,
            skips: config.skips.clone(),
            trunk: (0..config.depth).map(|i| layer(of_trunk(i), width)).collect(),
            head: layer(width, width + 4),
            view: (0..config.view_depth)
                .map(|i| layer(if i == 0 { width + view_channels } else { view_width }, view_width))
                .collect(),
            rgb: layer(view_width, 4),
            grid,
            domain,
            unpadded,
        }
    }

    /// Returns the number of weights and biases, with padding.
    pub(crate) fn weights(&self) -> usize {
        self.rgb.end()
    }

    /// Whether layer `i` of the trunk (from 0) reads the encoding beside the layer below.
    pub(crate) fn skips_to(&self, i: usize) -> bool {
        i > 0 && self.skips.contains(&i)
    }

    /// Returns the host's layers, in the order of its parameters.
    fn host_layers(&self) -> Vec<HostLayer> {
        let [channels, view_channels, view_width] = self.unpadded;
        let width = self.width;
        let at = |layer: &Layer, first: usize, outputs: usize, inputs: [usize; 2]| HostLayer {
            layer: *layer,
            first,
            outputs,
            inputs,
        };
        let of_trunk = |(i, layer): (usize, &Layer)| match i {
            0 => at(layer, 0, width, [channels, 0]),
            i if self.skips_to(i) => at(layer, 0, width, [channels, width]),
            _ => at(layer, 0, width, [width, 0]),
        };
        let of_view = |(i, layer): (usize, &Layer)| {
            at(layer, 0, view_width, if i == 0 { [width, view_channels] } else { [view_width, 0] })
        };
        let heads = [at(&self.head, width, 1, [width, 0]), at(&self.head, 0, width, [width, 0])];
        let trunk = self.trunk.iter().enumerate().map(of_trunk);
        let view = self.view.iter().enumerate().map(of_view);
        trunk.chain(heads).chain(view).chain([at(&self.rgb, 0, 3, [view_width, 0])]).collect()
    }

    /// Returns the matrices of the host's weights `[outputs, inputs]` and biases, in the order of its parameters.
    pub(crate) fn to_device(&self, parameters: &[Tensor]) -> Result<Vec<f32>> {
        let mut values = vec![0f32; self.weights()];
        for (host, pair) in self.host_layers().into_iter().zip(parameters.chunks(2)) {
            let [weight, bias] = [&pair[0], &pair[1]].map(|tensor| tensor.flatten_all()?.to_vec1::<f32>());
            for (place, value) in host.places().zip(weight?.into_iter().chain(bias?)) {
                values[place] = value;
            }
        }
        Ok(values)
    }

    /// Returns the factors of all weights and biases where `share` of the encodings' opening is over
    /// ([`FieldConfig::frequency_steps`]).
    pub(crate) fn opening(&self, config: &FieldConfig, share: f64) -> Result<Vec<f32>> {
        let mut values = vec![1f32; self.weights()];
        let factors = opening_factors(config, share, DType::F32, &Device::Cpu)?;
        for (host, factor) in self.host_layers().into_iter().zip(factors) {
            let Some(factor) = factor else { continue };
            let of_inputs = factor.flatten_all()?.to_vec1::<f32>()?;
            for (place, factor) in host.places().zip(of_inputs.repeat(host.outputs)) {
                values[place] = factor;
            }
        }
        Ok(values)
    }

    /// Returns 1 for weights, which can decay, and 0 for biases.
    pub(crate) fn decays(&self) -> Vec<f32> {
        let mut values = vec![0f32; self.weights()];
        for host in self.host_layers() {
            host.places().take(host.outputs * host.all_inputs()).for_each(|place| values[place] = 1.0);
        }
        values
    }

    /// Returns the host's weights and biases, in the order of its parameters.
    pub(crate) fn to_host(&self, values: &[f32]) -> Result<Vec<Tensor>> {
        let mut parameters = Vec::new();
        for host in self.host_layers() {
            let (outputs, inputs) = (host.outputs, host.all_inputs());
            let mut weight: Vec<f32> = host.places().map(|place| values[place]).collect();
            let bias = weight.split_off(outputs * inputs);
            parameters.push(Tensor::from_vec(weight, (outputs, inputs), &Device::Cpu)?);
            parameters.push(Tensor::from_vec(bias, outputs, &Device::Cpu)?);
        }
        Ok(parameters)
    }
}

/// Parameters and moments of matrices or tables, and what their gradient is summed in.
#[derive(Clone)]
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
#[derive(Clone)]
pub(crate) struct FieldBuffers {
    pub(crate) weights: Learned,
    /// The weights in f16, as products read them.
    pub(crate) halves: Option<Buffer>,
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
        Ok(FieldBuffers { weights: Learned::new(gpu, &weights, of_weights, 1), halves: None, tables })
    }

    /// Iterates over its weights and its tables.
    pub(crate) fn learned(&self) -> impl Iterator<Item = &Learned> {
        std::iter::once(&self.weights).chain(&self.tables)
    }

    /// Returns the same field with weights of its own, which are those that passes read. Gradients and the rest are shared.
    pub(crate) fn with_own_weights(&self, gpu: &Gpu) -> FieldBuffers {
        let weights = Learned { values: gpu.numbers(self.weights.count), ..self.weights.clone() };
        FieldBuffers { weights, ..self.clone() }
    }

    /// Copies a field's current parameters, as passes read them, to the device.
    pub(crate) fn of(gpu: &Gpu, shape: &Shape, field: &Field) -> Result<FieldBuffers> {
        FieldBuffers::new(gpu, shape, &field.opened_parameters(), None)
    }

    /// Reads parameters, first and second moments, in the host's order and shapes.
    pub(crate) fn read(&self, gpu: &Gpu, shape: &Shape) -> Result<[Vec<Tensor>; 3]> {
        let mut read: [Vec<Tensor>; 3] = Default::default();
        if let (Some(tables), Some(grid)) = (&self.tables, &shape.grid) {
            for (to, buffer) in read.iter_mut().zip([&tables.values, &tables.first, &tables.second]) {
                let values = gpu.read_f32(buffer, tables.count)?;
                to.push(Tensor::from_vec(values, (grid.entries(), grid.features()), &Device::Cpu)?);
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
            read.push(Tensor::from_vec(values, (grid.entries(), grid.features()), &Device::Cpu)?);
        }
        let scaled = gpu.read_f32(&self.weights.gradient, self.weights.count)?;
        read.extend(shape.to_host(&scaled.iter().map(|g| g / loss_scale as f32).collect::<Vec<f32>>())?);
        Ok(read)
    }
}
