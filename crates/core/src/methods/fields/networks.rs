//! The fields of one experiment, and their parameters by name.

use candle_core::{DType, Device, Tensor, Var};

use crate::base::Result;
use crate::field::{Field, TableRecord};
use crate::settings::{Config, PerturbField};

/// Coarse and fine field, and the further field of the released code's perturbed pass.
#[derive(Clone)]
pub struct Fields {
    /// Places samples, and is the whole model where there is no fine field.
    pub coarse: Field,
    /// Rendered and evaluated, where there are two.
    fine: Option<Field>,
    /// The coarse field renders the fine pass, too.
    one: bool,
    /// The perturbed pass's own field (`perturb.field = "separate"`); never evaluated.
    pub adversarial: Option<Field>,
}

impl Fields {
    /// Freshly drawn fields. `draws` says how often each field of [`Fields::roles`] was drawn
    /// before: 0 for the first draw, one more for each dead start.
    pub fn init(config: &Config, draws: &[u64], dtype: DType, device: &Device) -> Result<Fields> {
        // Far apart, so that redraws of one field never meet another's numbers.
        const ROLE_STRIDE: u64 = 1 << 32;
        let fields = draws.iter().enumerate().map(|(role, draw)| {
            Field::init(&config.field, config.seed, role as u64 * ROLE_STRIDE + draw, dtype, device)
        });
        Ok(Fields::from_fields(config, fields.collect::<Result<Vec<Field>>>()?))
    }

    /// Names of the fields that a configuration has, in the fixed order of parameters: `coarse`,
    /// `fine`, `adversarial`.
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

    /// Names and shapes of all parameters (`coarse.trunk.0.weight`, ...), in their fixed order.
    pub fn parameter_names(config: &Config) -> Vec<(String, Vec<usize>)> {
        let of_field = Field::parameter_names(&config.field);
        let named = |role| of_field.iter().map(move |(name, shape)| (format!("{role}.{name}"), shape.clone()));
        Fields::roles(config).into_iter().flat_map(named).collect()
    }

    /// Fields over given values, in the order of [`Fields::parameter_names`].
    pub fn from_parameters(config: &Config, values: Vec<Tensor>) -> Result<Fields> {
        let per_field = Field::parameter_names(&config.field).len();
        let fields = values.chunks(per_field).map(|part| Field::from_parameters(&config.field, part.to_vec()));
        Ok(Fields::from_fields(config, fields.collect::<Result<Vec<Field>>>()?))
    }

    fn from_fields(config: &Config, fields: Vec<Field>) -> Fields {
        let mut fields = Fields::roles(config).into_iter().zip(fields).collect::<std::collections::HashMap<_, _>>();
        Fields {
            coarse: fields.remove("coarse").expect("there is always a coarse field"),
            fine: fields.remove("fine"),
            one: config.sampling.fine > 0 && !config.representation().has_fine_field(),
            adversarial: fields.remove("adversarial"),
        }
    }

    /// The field of the fine pass; none where there is no such pass.
    pub fn fine(&self) -> Option<&Field> {
        self.fine.as_ref().or(self.one.then_some(&self.coarse))
    }

    /// The field that is rendered and measured.
    pub fn evaluated(&self) -> &Field {
        self.fine().unwrap_or(&self.coarse)
    }

    /// The fields with their names, in the fixed order.
    pub fn by_role(&self) -> Vec<(&'static str, &Field)> {
        let optional = [("fine", &self.fine), ("adversarial", &self.adversarial)];
        let further = optional.into_iter().filter_map(|(role, field)| field.as_ref().map(|field| (role, field)));
        std::iter::once(("coarse", &self.coarse)).chain(further).collect()
    }

    /// The same weights, each field with a record of their gradients of its own.
    pub fn recording(&self) -> Result<Fields> {
        self.map(Field::recording)
    }

    /// The fields that are looked at, with the same weights and without gradients.
    pub fn frozen(&self) -> Result<Fields> {
        let fine = self.fine.as_ref().map(Field::frozen).transpose()?;
        Ok(Fields { coarse: self.coarse.frozen()?, fine, one: self.one, adversarial: None })
    }

    /// The same weights, laid out for the fused core where it applies (see [`Field::prepared`]).
    pub fn prepared(&self) -> Result<Fields> {
        self.map(Field::prepared)
    }

    fn map(&self, change: impl Fn(&Field) -> Result<Field>) -> Result<Fields> {
        let optional = |field: &Option<Field>| field.as_ref().map(&change).transpose();
        Ok(Fields {
            coarse: change(&self.coarse)?,
            fine: optional(&self.fine)?,
            one: self.one,
            adversarial: optional(&self.adversarial)?,
        })
    }

    /// What the fields recorded, in the order of all parameters; none where a field does not record.
    pub fn recorded(&self) -> Result<Vec<Option<Tensor>>> {
        let mut gradients = Vec::new();
        for (_, field) in self.by_role() {
            gradients.extend(field.recorded()?);
        }
        Ok(gradients)
    }

    /// What the gradients of hash grids are made of, field by field in the fixed order.
    pub fn table_records(&self) -> Vec<Vec<TableRecord>> {
        self.by_role().into_iter().map(|(_, field)| field.table_records()).collect()
    }

    /// Gradients made of records, field by field, in the order of all parameters; none but those of hash grids.
    pub fn table_gradients(&self, records: &[Vec<TableRecord>]) -> Result<Vec<Option<Tensor>>> {
        let mut gradients = Vec::new();
        for ((_, field), records) in self.by_role().into_iter().zip(records) {
            let mut of_field = vec![None; field.variables().len()];
            if let Some(gradient) = field.table_gradient(records)? {
                of_field[0] = Some(gradient);
            }
            gradients.extend(of_field);
        }
        Ok(gradients)
    }

    /// All parameters with their names, in the fixed order.
    pub fn variables(&self) -> Vec<(String, Var)> {
        let named = |(role, field): (&str, &Field)| -> Vec<(String, Var)> {
            field.variables().iter().map(|(name, var)| (format!("{role}.{name}"), var.clone())).collect()
        };
        self.by_role().into_iter().flat_map(named).collect()
    }
}
