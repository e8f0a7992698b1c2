//! The fields of one experiment, and their parameters by name.

use candle_core::{DType, Device, Tensor, Var};

use crate::base::Result;
use crate::field::{Field, TableRecord};
use crate::perturb::settings::PerturbField;
use crate::render::settings::{Placing, SamplingConfig};
use crate::render::{Evaluation, Occupancy};
use crate::settings::Config;

/// The name of [`Occupancy::depths`] among the parameters.
pub const OCCUPANCY: &str = "occupancy";

/// The coarse and the fine field, and the additional field of the released code's perturbed pass.
#[derive(Clone)]
pub struct Fields {
    /// With their names, in the fixed order.
    fields: Vec<(&'static str, Field)>,
    /// There is a fine pass. Without a field of its own it queries the coarse one.
    has_fine_pass: bool,
    /// The cells that samples are placed in, if they place them. They are the last of the parameters, and no gradient reaches
    /// them.
    occupancy: Option<Occupancy>,
}

impl Fields {
    /// Returns randomly initialized fields. `draws` is the number of earlier draws of each field of [`Fields::roles`]:
    /// 0 at first, and one more for each dead start.
    pub fn init(config: &Config, draws: &[u64], dtype: DType, device: &Device) -> Result<Fields> {
        // Far apart, so that redraws of one field never use another's numbers.
        const ROLE_STRIDE: u64 = 1 << 32;
        let fields = draws.iter().enumerate().map(|(role, draw)| {
            Field::init(&config.field, config.seed, role as u64 * ROLE_STRIDE + draw, dtype, device)
        });
        let all_occupied = || Ok(Tensor::zeros(Occupancy::cells(&config.sampling.occupancy), dtype, device)?);
        Fields::from_fields(config, fields.collect::<Result<Vec<Field>>>()?, all_occupied)
    }

    /// Returns the names of a configuration's fields, in the fixed order of parameters: `coarse`, `fine`,
    /// `adversarial`.
    pub fn roles(config: &Config) -> Vec<&'static str> {
        let mut roles = vec!["coarse"];
        if config.sampling.fine > 0 && config.representation().has_fine_field() {
            roles.push("fine");
        }
        if config.method.is_augmented() && config.perturb.field == PerturbField::Separate {
            roles.push("adversarial");
        }
        roles
    }

    /// Returns names and shapes of all parameters (`coarse.trunk.0.weight`, ...), in their fixed order.
    pub fn parameter_names(config: &Config) -> Vec<(String, Vec<usize>)> {
        let names_of_field = Field::parameter_names(&config.field);
        let named = |role| names_of_field.iter().map(move |(name, shape)| (format!("{role}.{name}"), shape.clone()));
        let mut names: Vec<(String, Vec<usize>)> = Fields::roles(config).into_iter().flat_map(named).collect();
        if config.sampling.kind == Placing::Occupancy {
            names.push((OCCUPANCY.into(), vec![Occupancy::cells(&config.sampling.occupancy)]));
        }
        names
    }

    /// Returns fields with given values, in the order of [`Fields::parameter_names`].
    pub fn from_parameters(config: &Config, values: Vec<Tensor>) -> Result<Fields> {
        let per_field = Field::parameter_names(&config.field).len();
        let of_fields = values.chunks(per_field).take(Fields::roles(config).len());
        let fields = of_fields.map(|part| Field::from_parameters(&config.field, part.to_vec()));
        let fields = fields.collect::<Result<Vec<Field>>>()?;
        Fields::from_fields(config, fields, || Ok(values.last().expect("a field has parameters").clone()))
    }

    /// `depths` returns those of occupied cells, if these place samples.
    fn from_fields(config: &Config, fields: Vec<Field>, depths: impl FnOnce() -> Result<Tensor>) -> Result<Fields> {
        let sampling = &config.sampling;
        let fields = Fields::roles(config).into_iter().zip(fields).collect();
        let (_, domain) = config.field.hash.grid();
        let has_occupancy = sampling.kind == Placing::Occupancy;
        let occupancy = has_occupancy.then(|| Occupancy::new(&sampling.occupancy, domain, &depths()?)).transpose()?;
        Ok(Fields { fields, has_fine_pass: sampling.fine > 0, occupancy })
    }

    /// Returns how the fields are rendered for evaluation.
    pub fn evaluation<'a>(
        &'a self,
        sampling: &'a SamplingConfig,
        bounds: (f64, f64),
        background: Option<[f32; 3]>,
    ) -> Evaluation<'a> {
        let (coarse, fine, occupancy) = (self.coarse(), self.fine(), self.occupancy());
        Evaluation { coarse, fine, occupancy, sampling, bounds, background }
    }

    /// Returns the cells that place samples, if they do.
    pub fn occupancy(&self) -> Option<&Occupancy> {
        self.occupancy.as_ref()
    }

    /// Returns the field that places samples. It is the complete model if there is no fine pass.
    pub fn coarse(&self) -> &Field {
        &self.fields[0].1
    }

    /// Returns the field of the fine pass, or `None` if there is no such pass.
    pub fn fine(&self) -> Option<&Field> {
        self.has_fine_pass.then(|| self.get("fine").unwrap_or_else(|| self.coarse()))
    }

    /// Returns the field that is rendered and measured.
    pub fn evaluated(&self) -> &Field {
        self.fine().unwrap_or_else(|| self.coarse())
    }

    /// Returns the field of a name, one of [`Fields::roles`].
    pub fn get(&self, role: &str) -> Option<&Field> {
        self.by_role().find(|(name, _)| *name == role).map(|(_, field)| field)
    }

    /// Iterates over the fields with their names, in the fixed order.
    pub fn by_role(&self) -> impl Iterator<Item = (&'static str, &Field)> {
        self.fields.iter().map(|(role, field)| (*role, field))
    }

    /// Returns the same fields as they are after `step` finished steps: what `field.frequency_steps` still hide is hidden. The
    /// parameters are shared; what is hidden is computed from their current values.
    pub fn at_step(&self, config: &Config, step: u64) -> Result<Fields> {
        let end = config.field.frequency_steps;
        if end == 0 {
            return Ok(self.clone());
        }
        self.map(|field| field.opened(step.min(end) as f64 / end as f64))
    }

    /// Returns fields with the same weights, each with its own record of their gradients.
    pub fn recording(&self) -> Result<Fields> {
        self.map(Field::recording)
    }

    /// Returns the fields with the same weights, without gradients.
    pub fn frozen(&self) -> Result<Fields> {
        self.map(Field::frozen)
    }

    /// Returns the same weights in the layout of the fused core if it applies (see [`Field::prepared`]).
    pub fn prepared(&self) -> Result<Fields> {
        self.map(Field::prepared)
    }

    fn map(&self, change: impl Fn(&Field) -> Result<Field>) -> Result<Fields> {
        let fields = self.by_role().map(|(role, field)| Ok((role, change(field)?)));
        Ok(Fields { fields: fields.collect::<Result<_>>()?, ..self.clone() })
    }

    /// Returns what the fields recorded, in the order of all parameters. An entry is `None` if its field does not
    /// record.
    pub fn recorded(&self) -> Result<Vec<Option<Tensor>>> {
        let mut gradients = Vec::new();
        for (_, field) in self.by_role() {
            gradients.extend(field.recorded()?);
        }
        Ok(gradients)
    }

    /// Returns what the gradients of hash grids are made of, recorded since the last call, field by field in the fixed order.
    pub fn table_records(&self) -> Vec<Vec<TableRecord>> {
        self.by_role().map(|(_, field)| field.table_records()).collect()
    }

    /// Returns the gradients of hash grids from those of the records that `counts` accepts, field by field, in the order of
    /// all parameters. Other entries are `None`.
    pub fn table_gradients(
        &self,
        records: &[Vec<TableRecord>],
        counts: impl Fn(&TableRecord) -> bool,
    ) -> Result<Vec<Option<Tensor>>> {
        let mut gradients = Vec::new();
        for ((_, field), records) in self.by_role().zip(records) {
            let mut field_gradients = vec![None; field.variables().len()];
            if let Some(gradient) = field.table_gradient(records.iter().filter(|record| counts(record)))? {
                field_gradients[0] = Some(gradient);
            }
            gradients.extend(field_gradients);
        }
        Ok(gradients)
    }

    /// Returns all parameters with their names, in the fixed order.
    pub fn variables(&self) -> Vec<(String, Var)> {
        let named = |(role, field): (&str, &Field)| -> Vec<(String, Var)> {
            field.variables().iter().map(|(name, var)| (format!("{role}.{name}"), var.clone())).collect()
        };
        let occupancy = self.occupancy.iter().map(|occupancy| (OCCUPANCY.into(), occupancy.depths().clone()));
        self.by_role().flat_map(named).chain(occupancy).collect()
    }
}
