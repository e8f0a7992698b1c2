//! The radiance field: an encoding, a trunk with skips, a density head and a view-dependent colour head.
//!
//! A field knows nothing of rays or attacks. It maps points and directions to raw colour and raw density, and accepts a
//! delta that is added to one trunk layer's output. A field with integrated encoding is queried at Gaussians, mean and
//! diagonal variance `[n, 6]`, instead of points `[n, 3]`.
//!
//! These files compute a field by candle's operations, in f32 and f64 on any device. In f32 on the CPU, `fast` computes
//! [`Field::frozen`] and [`Field::recording`] fields, and derivatives in space, in their place.

use std::sync::{Arc, Mutex, PoisonError};

use candle_core::{DType, Device, Shape, Tensor, Var};
use candle_nn::var_builder::SimpleBackend;
use candle_nn::{Init, Linear, VarBuilder};

use crate::base::place::is_ours_in_f32;
use crate::base::rng::{Random, Stream};
use crate::base::{Error, Result};
use crate::field::settings::{Core, FieldConfig, Precision};

mod activation;
mod density;
mod encoding;
mod fast;
mod grid;
mod inside;
mod nerf;
mod open;
mod rgb_limit;
pub mod settings;
mod spatial;
mod waves;

pub use activation::Cotangents;
pub use augnerf_fast::fused::forget as forget_buffers;
pub use augnerf_fast::{hash, peak_gflops};
pub use density::{Density, FieldDensity};
use encoding::encode_positions;
pub use encoding::{encode, encode_integrated, encoded_channels, position_channels};
pub use fast::TableRecord;
use fast::{FastField, PrefixCache};
use grid::Grid;
use hash::HashGrid;
use inside::Inside;
pub use inside::Queried;
pub use nerf::{FeatureDelta, Nerf, RawOutput};
pub use open::opening_factors;
pub use spatial::{DensityAt, Order, Spatial};

/// A network `(points, viewdirs) -> (raw rgb, raw density)`. One set of weights has four forms:
///
/// | form | gradients of the weights | computes with |
/// |---|---|---|
/// | as created, or [`opened`](Field::opened) | in candle's graph | candle |
/// | [`prepared`](Field::prepared) | in candle's graph | candle; derivatives in space with the fused core |
/// | [`recording`](Field::recording) | added up beside the graph | the fused core, if it applies |
/// | [`frozen`](Field::frozen) | none | the fused core, if it applies |
#[derive(Clone)]
pub struct Field {
    config: FieldConfig,
    nerf: Nerf,
    /// The hash grid, if it encodes positions.
    grid: Option<Grid>,
    /// The parameters as variables, in the order of [`Field::parameter_names`]. Empty if frozen.
    variables: Vec<(String, Var)>,
    /// For each layer, factors of its inputs, `[1, inputs]`, if some are hidden (see [`Field::opened`]). The weights above
    /// are multiplied by them.
    hidden: Option<Arc<Vec<Option<Tensor>>>>,
    /// What computes in candle's place, if it applies (see [`Field::prepared`]).
    fast: Option<FastField>,
}

/// Positions at which a field is queried.
pub struct QueryPoints<'a> {
    field: &'a Field,
    inputs: Inputs,
    /// The trunk below the feature delta, or all of it, which the fused core computes once for all queries at fixed points.
    trunk: Option<PrefixCache>,
}

impl<'a> QueryPoints<'a> {
    /// Keeps what depends on the points alone, for many queries without gradients of weights or points.
    pub fn kept(self) -> QueryPoints<'a> {
        QueryPoints { trunk: Some(PrefixCache::default()), ..self }
    }

    /// Returns the field.
    pub fn field(&self) -> &Field {
        self.field
    }

    /// Runs [`Field::forward`] at these points.
    ///
    /// # Errors
    /// Those of candle, if shapes do not fit.
    pub fn forward(&self, viewdirs: &Tensor, delta: Option<FeatureDelta>) -> Result<RawOutput> {
        let QueryPoints { field, inputs, trunk } = self;
        let Some(queried) = &inputs.queried else { return field.run(inputs, viewdirs, delta, trunk.as_ref()) };
        if queried.count() == 0 {
            let zeros = |shape: &[usize]| Tensor::zeros(shape, field.dtype(), field.device());
            return Ok(queried.over_all(RawOutput { rgb: zeros(&[0, 3])?, density: zeros(&[0])? })?);
        }
        let viewdirs = queried.rows_of_rays(viewdirs)?;
        let rows = delta.map(|delta| queried.rows(delta.delta)).transpose()?;
        let delta = delta.zip(rows.as_ref()).map(|(FeatureDelta { layer, .. }, delta)| FeatureDelta { layer, delta });
        Ok(queried.over_all(field.run(inputs, &viewdirs, delta, trunk.as_ref())?)?)
    }
}

/// The input of a field's networks.
struct Inputs {
    /// Points `[n, 3]`, Gaussians `[n, 6]`, or features `[n, channels]`, of the points that are queried.
    values: Tensor,
    /// Where density can be. `None` if it can be everywhere.
    inside: Option<Inside>,
    /// `None` if all are.
    queried: Option<Queried>,
}

impl Inputs {
    /// Removes raw density `[n]` where there can be none.
    fn only_inside(&self, raw: Tensor) -> Result<Tensor> {
        Ok(match &self.inside {
            Some(inside) => inside.only(&raw)?,
            None => raw,
        })
    }
}

impl Field {
    /// Returns names and shapes of all parameters in their fixed order: `trunk.0.weight`, `trunk.0.bias`, ...,
    /// `rgb.bias`. A hash grid's `table` comes before them.
    pub fn parameter_names(config: &FieldConfig) -> Vec<(String, Vec<usize>)> {
        let mut names = Vec::new();
        let number = Tensor::zeros((), DType::F32, &Device::Cpu).expect("a number");
        let shapes = Field::from_source(config, |name, shape, _| {
            names.push((name.to_string(), shape.dims().to_vec()));
            number.broadcast_as(shape)
        });
        shapes.expect("a number has any shape");
        names
    }

    /// Creates a field with weights drawn from `seed`'s stream `Init` at `index`.
    pub fn init(config: &FieldConfig, seed: u64, index: u64, dtype: DType, device: &Device) -> Result<Field> {
        let mut random = Random::new(seed, Stream::Init, index);
        let mut parameters = Vec::new();
        Field::from_source(config, |_, shape, init| {
            let values = match init {
                Init::Uniform { lo, up } => random
                    .uniform_tensor(shape.dims(), dtype, device)
                    .map_err(candle_core::Error::wrap)?
                    .affine(up - lo, lo)?,
                _ => Tensor::zeros(shape, dtype, device)?,
            };
            parameters.push(values.clone());
            Ok(values)
        })?;
        Field::from_parameters(config, parameters)
    }

    /// Creates a field with given parameter values, in the order of [`Field::parameter_names`]. The values are copied.
    ///
    /// # Errors
    /// If shapes are wrong, or the type or device of the values does not support the precision.
    pub fn from_parameters(config: &FieldConfig, values: Vec<Tensor>) -> Result<Field> {
        let expected = Field::parameter_names(config).len();
        if values.len() != expected {
            return Err(tensor_error(format!("{} parameters given, {expected} expected", values.len())));
        }
        if config.precision == Precision::Bf16 && !(config.core == Core::Fused && values.iter().all(is_ours_in_f32)) {
            return Err(Error::Config(
                "field.precision = \"bf16\" needs the fused core, which needs f32 weights on the CPU: run with \
                 device cpu, or choose field.precision = \"f32\""
                    .into(),
            ));
        }
        let (mut values, mut variables) = (values.into_iter(), Vec::with_capacity(expected));
        let field = Field::from_source(config, |name, shape, _| {
            let value = values.next().expect("as many as names");
            if value.shape() != shape {
                candle_core::bail!("{name} has shape {:?}, expected {:?}", value.dims(), shape.dims());
            }
            let variable = Var::from_tensor(&value.copy()?)?;
            let tensor = variable.as_tensor().clone();
            variables.push((name.to_string(), variable));
            Ok(tensor)
        })?;
        Ok(Field { variables, ..field })
    }

    /// Returns a field without variables, whose parameters are what `source` returns for name, shape and distribution. It
    /// is asked in the order of [`Field::parameter_names`].
    fn from_source(
        config: &FieldConfig,
        source: impl FnMut(&str, &Shape, Init) -> candle_core::Result<Tensor> + Send,
    ) -> Result<Field> {
        // The source decides on type and device.
        let builder = VarBuilder::from_backend(Box::new(Source(Mutex::new(source))), DType::F32, Device::Cpu);
        let grid = Grid::new(config, &builder)?;
        let nerf = Nerf::new(config, builder)?;
        let (config, variables) = (config.clone(), Vec::new());
        Ok(Field { config, nerf, grid, variables, hidden: None, fast: None })
    }

    /// Returns the same field with the low frequencies of its encodings alone (FreeNeRF, equation 3): of the channels of each
    /// axis, of which there are n, number i is multiplied by clamp(fraction n + 1 - i, 0, 1). Of a hash grid these are levels.
    /// `fraction` 1 opens all. What is hidden is computed from the current parameters, which are shared.
    ///
    /// Hidden channels are hidden in the layers that read them: a channel times a factor is a column of weights times it.
    ///
    /// # Panics
    /// The field is frozen.
    pub fn opened(&self, fraction: f64) -> Result<Field> {
        let factors = if fraction < 1.0 {
            Some(opening_factors(&self.config, fraction, self.dtype(), self.device())?)
        } else {
            None
        };
        let mut layers = self.variables[usize::from(self.grid.is_some())..].chunks_exact(2).enumerate();
        let nerf = self.nerf.map(|_| {
            let (i, variables) = layers.next().expect("weight and bias of each layer");
            let [weight, bias] = [0, 1].map(|part| variables[part].1.as_tensor());
            let weight = match factors.as_ref().and_then(|factors| factors[i].as_ref()) {
                Some(factor) => weight.broadcast_mul(factor)?,
                None => weight.clone(),
            };
            Ok(Linear::new(weight, Some(bias.clone())))
        })?;
        Ok(Field { nerf, hidden: factors.map(Arc::new), fast: None, ..self.clone() })
    }

    /// Returns the current parameters as passes read them, in the order of [`Field::parameter_names`]: weights of hidden
    /// inputs are multiplied ([`Field::opened`]).
    pub fn opened_parameters(&self) -> Vec<Tensor> {
        let table = self.grid.iter().map(|grid| grid.table.detach());
        table.chain(self.parameters_of_layers().map(Tensor::detach)).collect()
    }

    /// Multiplies gradients of the layers' weights and biases, in the order of parameters, by the factors of hidden inputs.
    fn hide(&self, layer_gradients: &mut [Option<Tensor>]) -> Result<()> {
        let Some(hidden) = &self.hidden else { return Ok(()) };
        for (gradient, factor) in layer_gradients.iter_mut().step_by(2).zip(&**hidden) {
            if let (Some(gradient), Some(factor)) = (gradient, factor) {
                *gradient = gradient.broadcast_mul(factor)?;
            }
        }
        Ok(())
    }

    /// Returns the same field with a copy of its current weights in the layout of the fused core, if it applies: to f32 weights
    /// on the CPU, unless `field.core` is plain. Fields derived from it share the copy. After an update of the weights it
    /// is out of date.
    pub fn prepared(&self) -> Result<Field> {
        let weight = self.nerf.density.weight();
        if self.fast.is_some() || self.config.core == Core::Plain || !is_ours_in_f32(weight) {
            return Ok(self.clone());
        }
        Ok(Field { fast: Some(FastField::new(self)?), ..self.clone() })
    }

    /// Returns a field with the same weights and a record of their gradients. Backward passes through it add to the
    /// record (see [`Field::recorded`]). If the fused core does not apply, candle's gradient store has them.
    pub fn recording(&self) -> Result<Field> {
        let field = self.prepared()?;
        Ok(Field { fast: field.fast.as_ref().map(FastField::recording), ..field })
    }

    /// Returns the gradients of the weights that backward passes through this field have added up, in the order of
    /// parameters. Entries are `None` if the field does not record, and for a hash grid's table: see
    /// [`Field::table_records`].
    pub fn recorded(&self) -> Result<Vec<Option<Tensor>>> {
        let shapes = self.parameters_of_layers().map(|parameter| parameter.dims().to_vec()).collect();
        let recorded = self.fast.as_ref().map(|fast| fast.recorded(shapes)).transpose()?.flatten();
        let Some(recorded) = recorded else { return Ok(vec![None; self.variables.len()]) };
        let mut layer_gradients: Vec<Option<Tensor>> = recorded.into_iter().map(Some).collect();
        self.hide(&mut layer_gradients)?;
        Ok(self.grid.iter().map(|_| None).chain(layer_gradients).collect())
    }

    /// Returns the hash grid that encodes positions, if there is one. Its table is the first parameter.
    pub fn hash_grid(&self) -> Option<&HashGrid> {
        self.grid.as_ref().map(|grid| &*grid.shape)
    }

    /// Returns the records for the table of the hash grid that backward passes have left since the last call, in their order.
    pub fn table_records(&self) -> Vec<TableRecord> {
        let records = self.fast.as_ref().and_then(FastField::table_records);
        records.map(|mut records| std::mem::take(&mut *records)).unwrap_or_default()
    }

    /// Adds a record to those of a field that records.
    pub(crate) fn add_table_record(&self, record: Option<TableRecord>) {
        let records = self.fast.as_ref().and_then(FastField::table_records);
        debug_assert!(record.is_none() || records.is_some(), "the field does not record");
        if let Some(mut records) = records {
            records.extend(record);
        }
    }

    /// Returns the gradient of the hash grid's table, `[entries, features]`, from records in their order. `None`
    /// without a grid or records.
    pub fn table_gradient<'a>(&self, records: impl IntoIterator<Item = &'a TableRecord>) -> Result<Option<Tensor>> {
        let mut records = records.into_iter().peekable();
        let grid = self.grid.as_ref().filter(|_| records.peek().is_some());
        grid.map(|grid| fast::table_gradient(grid, records)).transpose()
    }

    /// Returns the fused core, if it applies and candle's graph needs no gradients of the weights.
    fn fast(&self) -> Option<&FastField> {
        self.fast.as_ref().filter(|fast| fast.records() || self.variables.is_empty())
    }

    /// Iterates over weight and bias of all layers, in the order of parameters.
    fn parameters_of_layers(&self) -> impl Iterator<Item = &Tensor> {
        self.nerf.layers().flat_map(|layer| [layer.weight(), nerf::bias(layer)])
    }

    /// Returns a field with the same weights (shared, not copied) that never computes their gradients.
    pub fn frozen(&self) -> Result<Field> {
        let detached = |layer: &Linear| Ok(Linear::new(layer.weight().detach(), Some(nerf::bias(layer).detach())));
        let grid = self.grid.as_ref().map(Grid::detached);
        let fast = self.fast.as_ref().map(FastField::detached);
        Field { nerf: self.nerf.map(detached)?, grid, variables: Vec::new(), fast, ..self.clone() }.prepared()
    }

    /// Returns the parameters in their fixed order. Empty for a frozen field.
    pub fn variables(&self) -> &[(String, Var)] {
        &self.variables
    }

    /// Returns the configuration of the field.
    pub fn config(&self) -> &FieldConfig {
        &self.config
    }

    /// Returns the type of weights, points and outputs.
    pub fn dtype(&self) -> DType {
        self.nerf.density.weight().dtype()
    }

    /// Returns the device of the weights.
    pub fn device(&self) -> &Device {
        self.nerf.density.weight().device()
    }

    /// Returns raw colour and density of points `[n, 3]` along unit directions `viewdirs [rays, 3]`. All rays have the
    /// same number of points, and the points of a ray are consecutive.
    pub fn forward(&self, points: &Tensor, viewdirs: &Tensor, delta: Option<FeatureDelta>) -> Result<RawOutput> {
        self.query_points(points, None)?.forward(viewdirs, delta)
    }

    /// Returns points `[n, 3]` at which it is queried, all or those that are `queried`.
    pub fn query_points(&self, points: &Tensor, queried: Option<&Queried>) -> Result<QueryPoints<'_>> {
        Ok(QueryPoints { field: self, inputs: self.inputs(points, queried)?, trunk: None })
    }

    /// Runs the networks on their inputs, along `viewdirs [rays, 3]`.
    fn run(
        &self,
        inputs: &Inputs,
        viewdirs: &Tensor,
        delta: Option<FeatureDelta>,
        trunk: Option<&PrefixCache>,
    ) -> Result<RawOutput> {
        if let Some(fast) = self.fast() {
            return fast.forward(inputs, viewdirs, delta, trunk);
        }
        let (n, _) = inputs.values.dims2()?;
        let directions = self.encode_views(viewdirs, n / viewdirs.dim(0)?.max(1))?;
        let raw = self.nerf.forward(&encode_positions(&self.config, &inputs.values)?, &directions, delta)?;
        Ok(RawOutput { density: inputs.only_inside(raw.density)?, ..raw })
    }

    /// Returns the networks' input at `positions`: the positions, or their features in the hash grid.
    fn inputs(&self, positions: &Tensor, queried: Option<&Queried>) -> Result<Inputs> {
        let rows = queried.map(|queried| queried.rows(positions)).transpose()?;
        let queried = queried.cloned();
        let positions = rows.as_ref().unwrap_or(positions);
        let Some(grid) = &self.grid else { return Ok(Inputs { values: positions.clone(), inside: None, queried }) };
        let values = match self.fast() {
            Some(fast) => fast.features(grid, positions)?,
            None => grid.encode(positions)?,
        };
        Ok(Inputs { values, inside: grid.inside(positions)?, queried })
    }

    /// Returns 1 where density can be and 0 elsewhere, for points `[n, 3]`, as `[n]`. `None` if it is 1 everywhere.
    pub fn inside(&self, points: &Tensor) -> Result<Option<Tensor>> {
        let inside = self.grid.as_ref().map(|grid| grid.inside(points)).transpose()?.flatten();
        Ok(inside.map(|inside| inside.mask(points)).transpose()?)
    }

    /// Returns raw density, `[n]`, without colour.
    pub fn raw_density(&self, points: &Tensor) -> Result<Tensor> {
        match self.fast().filter(|fast| !fast.records()) {
            Some(fast) if points.track_op() => return fast.raw_density_in_graph(self, points),
            Some(fast) => return fast.raw_density(self, points),
            None => {}
        }
        let inputs = self.inputs(points, None)?;
        let hidden = self.nerf.trunk(&encode_positions(&self.config, &inputs.values)?, None)?;
        inputs.only_inside(self.nerf.raw_density(&hidden)?)
    }

    /// Returns colour from raw colour, of any shape: a sigmoid, padded by `field.rgb_padding` on both sides. Within it raw
    /// colour is limited by `field.rgb_limit`; beyond it, its gradient is that at the limit if it leads back, and 0 otherwise.
    pub fn activate_rgb(&self, raw: &Tensor) -> Result<Tensor> {
        let limit = self.config.rgb_limit;
        let rgb = match limit > 0.0 {
            true => candle_nn::ops::sigmoid(&rgb_limit::limited(raw, limit)?)?,
            false => candle_nn::ops::sigmoid(raw)?,
        };
        let padding = self.config.rgb_padding;
        Ok(if padding > 0.0 { rgb.affine(1.0 + 2.0 * padding, -padding)? } else { rgb })
    }

    /// Returns density from raw density, of any shape.
    pub fn activate_density(&self, raw: &Tensor) -> Result<Tensor> {
        Ok(activation::activate_density(self.config.density_activation, raw)?)
    }

    /// Returns the positions at which this field is queried for `points [n, 3]`. With integrated encoding these are
    /// Gaussians `[n, 6]` around them, with a `variance` along each axis, length^2. Otherwise they are the points.
    pub fn positions(&self, points: &Tensor, variance: [f64; 3]) -> Result<Tensor> {
        if !self.config.encoding.queries_gaussians() {
            return Ok(points.clone());
        }
        let variance = Tensor::new(&variance, points.device())?.to_dtype(points.dtype())?;
        Ok(Tensor::cat(&[points, &variance.broadcast_as(points.shape())?], 1)?)
    }

    /// Encodes unit directions `[rays, 3]` once per ray, and repeats them for its samples:
    /// `[rays * samples, 3 + 6 view_octaves]`.
    fn encode_views(&self, viewdirs: &Tensor, samples: usize) -> Result<Tensor> {
        let (rays, _) = viewdirs.dims2()?;
        let encoded = encode(viewdirs, self.config.view_octaves)?; // [rays, channels]
        let channels = encoded.dim(1)?;
        let repeated = encoded.unsqueeze(1)?.broadcast_as((rays, samples, channels))?;
        Ok(repeated.contiguous()?.reshape((rays * samples, channels))?)
    }
}

fn tensor_error(message: String) -> Error {
    candle_core::Error::Msg(message).into()
}

/// Parameters from a function of name, shape and distribution, for candle's builder.
struct Source<F>(Mutex<F>);

impl<F: FnMut(&str, &Shape, Init) -> candle_core::Result<Tensor> + Send> SimpleBackend for Source<F> {
    fn get(&self, shape: Shape, name: &str, init: Init, _: DType, _: &Device) -> candle_core::Result<Tensor> {
        (self.0.lock().unwrap_or_else(PoisonError::into_inner))(name, &shape, init)
    }

    fn get_unchecked(&self, name: &str, _: DType, _: &Device) -> candle_core::Result<Tensor> {
        candle_core::bail!("{name} was asked for without its shape")
    }

    fn contains_tensor(&self, _: &str) -> bool {
        true
    }
}
