//! The parameters of kernels, by the names that their texts give them.

use std::collections::HashMap;

use naga::{AddressSpace, ArraySize, Module, ScalarKind, TypeInner};

/// Values for the members of a kernel's struct of parameters.
#[derive(Clone)]
pub(crate) struct Params {
    values: Vec<(&'static str, Value)>,
    /// Members without a value are 0.
    rest_is_zero: bool,
}

/// Makes [`Params`] as a struct is made: `params! { rays, samples: pass.samples }`.
macro_rules! params {
    (@ $name:ident) => { $crate::params::Value::from($name) };
    (@ $name:ident $value:expr) => { $crate::params::Value::from($value) };
    ($($name:ident $(: $value:expr)?),* $(,)?) => {
        $crate::params::Params::new(vec![$((stringify!($name), params!(@ $name $($value)?))),*])
    };
}

impl Params {
    pub(crate) fn new(values: Vec<(&'static str, Value)>) -> Params {
        Params { values, rest_is_zero: false }
    }

    /// Adds those of `more`.
    pub(crate) fn and(mut self, more: Params) -> Params {
        self.values.extend(more.values);
        self.rest_is_zero |= more.rest_is_zero;
        self
    }

    /// Lets the kernel have parameters that it does not read in this use.
    pub(crate) fn rest_is_zero(self) -> Params {
        Params { rest_is_zero: true, ..self }
    }
}

/// Numbers of one kind.
#[derive(Clone)]
pub(crate) struct Value {
    is_float: bool,
    words: Vec<u32>,
}

impl From<usize> for Value {
    fn from(value: usize) -> Value {
        Value::from([value])
    }
}

impl From<bool> for Value {
    fn from(value: bool) -> Value {
        Value::from([usize::from(value)])
    }
}

impl<const N: usize> From<[usize; N]> for Value {
    fn from(values: [usize; N]) -> Value {
        Value { is_float: false, words: values.map(|value| value as u32).to_vec() }
    }
}

impl From<f64> for Value {
    fn from(value: f64) -> Value {
        Value::from([value])
    }
}

impl<const N: usize> From<[f64; N]> for Value {
    fn from(values: [f64; N]) -> Value {
        Value { is_float: true, words: values.map(|value| (value as f32).to_bits()).to_vec() }
    }
}

impl FromIterator<usize> for Value {
    fn from_iter<I: IntoIterator<Item = usize>>(values: I) -> Value {
        Value { is_float: false, words: values.into_iter().map(|value| value as u32).collect() }
    }
}

/// A struct of parameters in a kernel's text.
#[derive(Clone)]
pub(crate) struct Layout {
    words: usize,
    members: Vec<Member>,
}

/// So many numbers of one kind, from a word of the struct on.
#[derive(Clone)]
struct Member {
    name: String,
    first: usize,
    count: usize,
    is_float: bool,
}

/// The structs of a kernel by their bindings.
pub(crate) type Layouts = HashMap<u32, Layout>;

/// Returns the structs of a text's parameters.
pub(crate) fn layouts(text: &str) -> Layouts {
    let module = naga::front::wgsl::parse_str(text).unwrap_or_else(|e| panic!("{}", e.emit_to_string(text)));
    let uniforms = module.global_variables.iter().filter(|(_, variable)| variable.space == AddressSpace::Uniform);
    let of = |(_, variable): (_, &naga::GlobalVariable)| {
        let binding = variable.binding.as_ref().expect("a uniform has a binding").binding;
        (binding, Layout::of(&module, variable.ty))
    };
    uniforms.map(of).collect()
}

impl Layout {
    fn of(module: &Module, of: naga::Handle<naga::Type>) -> Layout {
        let TypeInner::Struct { members, span } = &module.types[of].inner else { panic!("parameters are a struct") };
        let member = |member: &naga::StructMember| {
            let (count, is_float) = numbers(module, member.ty);
            let name = member.name.clone().expect("members of texts have names");
            Member { name, first: member.offset as usize / 4, count, is_float }
        };
        Layout { words: *span as usize / 4, members: members.iter().map(member).collect() }
    }

    /// Returns the words of a kernel's parameters.
    ///
    /// # Panics
    /// A value is none of the struct's, or comes twice, or has another type, or is missing where no [rest is 0](Params::rest_is_zero).
    pub(crate) fn words(&self, kernel: &str, params: &Params) -> Vec<u32> {
        let mut words = vec![0; self.words];
        for (i, (name, value)) in params.values.iter().enumerate() {
            let is_new = params.values[..i].iter().all(|(known, _)| known != name);
            assert!(is_new, "parameter {name} of kernel {kernel} comes twice");
            let found = self.members.iter().find(|member| member.name == *name);
            let Member { first, count, is_float, .. } =
                found.unwrap_or_else(|| panic!("kernel {kernel} has no parameter {name}"));
            let is_right = value.words.len() == *count && value.is_float == *is_float;
            assert!(is_right, "parameter {name} of kernel {kernel} has another type");
            words[*first..][..*count].copy_from_slice(&value.words);
        }
        let is_given = |member: &Member| params.values.iter().any(|(name, _)| *name == member.name);
        let missing = self.members.iter().find(|member| !is_given(member) && !params.rest_is_zero);
        assert!(missing.is_none(), "kernel {kernel} needs parameter {}", missing.map_or("", |member| &member.name));
        words
    }
}

/// Returns how many numbers a type has, and whether these are floats.
fn numbers(module: &Module, of: naga::Handle<naga::Type>) -> (usize, bool) {
    match &module.types[of].inner {
        TypeInner::Scalar(scalar) => (1, scalar.kind == ScalarKind::Float),
        TypeInner::Vector { size, scalar } => (*size as usize, scalar.kind == ScalarKind::Float),
        TypeInner::Array { base, size: ArraySize::Constant(size), .. } => {
            // Those of four numbers have no gaps.
            let (count, is_float) = numbers(module, *base);
            (count * size.get() as usize, is_float)
        }
        inner => panic!("parameters of type {inner:?}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "
        struct Some { rays: u32, low: vec3<f32>, level: array<vec4<u32>, 2>, near: f32 }
        @group(0) @binding(3) var<uniform> p: Some;
        @compute @workgroup_size(1) fn main() { _ = p.rays; }";

    fn words(params: Params) -> Vec<u32> {
        layouts(TEXT)[&3].words("some", &params)
    }

    #[test]
    fn values_are_where_the_text_reads_them() {
        let level: Value = (1..=8).collect();
        let (low, near) = ([0.5, 1.0, 2.0], 4.0);
        let [a, b, c, d] = [0.5f32, 1.0, 2.0, 4.0].map(f32::to_bits);
        let expected = [7, 0, 0, 0, a, b, c, 0, 1, 2, 3, 4, 5, 6, 7, 8, d, 0, 0, 0];
        assert_eq!(words(params! { near, level, low, rays: 7usize }), expected);
        assert_eq!(words(params! { rays: 7usize }.and(params! { near }.rest_is_zero()))[..5], [7, 0, 0, 0, 0]);
    }

    #[test]
    #[should_panic(expected = "kernel some has no parameter ray")]
    fn other_names_are_refused() {
        words(params! { ray: 7usize }.rest_is_zero());
    }

    #[test]
    #[should_panic(expected = "parameter near of kernel some has another type")]
    fn other_types_are_refused() {
        words(params! { near: 7usize }.rest_is_zero());
    }

    #[test]
    #[should_panic(expected = "parameter near of kernel some comes twice")]
    fn values_come_once() {
        words(params! { near: 1.0 }.and(params! { near: 2.0 }));
    }

    #[test]
    #[should_panic(expected = "kernel some needs parameter low")]
    fn nothing_is_left_out() {
        words(params! { rays: 7usize });
    }
}
