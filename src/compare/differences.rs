//! What differs between runs that are shown together.

use serde::Serialize;

use super::run_view::RunView;
use crate::run::columns;

/// Fields of the protocol that follow from others.
const DERIVED: [&str; 3] = ["config_hash", "redraws", "corruption_hash"];
/// Settings that the protocol has a field for.
const SPOKEN: [&str; 35] = [
    "seed",
    "method",
    "data.name",
    "data.kind",
    "data.downscale",
    "data.width",
    "data.holdout",
    "data.test_skip",
    "data.eval_split",
    "data.background",
    "data.ndc",
    "data.pixel_origin",
    "field.width",
    "field.depth",
    "field.init",
    "field.density_activation",
    "sampling.coarse",
    "sampling.fine",
    "train.rays",
    "train.steps",
    "train.learning_rate",
    "train.decay_rate",
    "train.decay_steps",
    "train.schedule",
    "train.final_learning_rate",
    "train.coarse_weight",
    "perturb.kind",
    "perturb.attack",
    "perturb.lambda",
    "perturb.objective",
    "perturb.field",
    "perturb.output",
    "perturb.resample",
    "perturb.step_unit",
    "perturb.injection_layer",
];
/// The same for the fields of each level of the attack.
const SPOKEN_OF_LEVELS: [&str; 4] = [".passes", ".steps", ".step_size", ".epsilon"];

/// One thing in which runs differ.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// A field of the protocol, or a setting of `config.toml` that it does not speak of.
    pub name: String,
    /// Each run's value; empty where it has none.
    pub values: Vec<String>,
}

fn spoken_of(setting: &str) -> bool {
    let of_level = setting.starts_with("perturb.") && SPOKEN_OF_LEVELS.iter().any(|end| setting.ends_with(end));
    // The protocol's fields say all of the regularizers and of corruption.
    of_level
        || setting.starts_with("regularizer.")
        || setting.starts_with("data.corruption.")
        || SPOKEN.contains(&setting)
}

/// In what the runs differ: fields of their protocols first, then settings that these do not speak of.
/// A setting of the perturbed pass differs between runs that have one.
pub fn differences(runs: &[&RunView]) -> Vec<Difference> {
    let mut found = Vec::new();
    let mut compare = |rows: Vec<Vec<(String, String)>>, skip: &dyn Fn(&str) -> bool| {
        let names = rows.iter().flatten().map(|(name, _)| name).collect::<Vec<_>>();
        for (index, name) in names.iter().enumerate() {
            if skip(name) || names[..index].contains(name) {
                continue;
            }
            let value = |row: &Vec<(String, String)>| row.iter().find(|(own, _)| own == *name).map(|(_, v)| v.clone());
            let values: Vec<Option<String>> = rows.iter().map(value).collect();
            let mut counted = values.iter().filter(|value| value.is_some() || !name.starts_with("perturb."));
            let first = counted.next();
            if counted.any(|value| Some(value) != first) {
                let values = values.into_iter().map(Option::unwrap_or_default).collect();
                found.push(Difference { name: name.to_string(), values });
            }
        }
    };
    compare(runs.iter().map(|run| columns(&run.protocol)).collect(), &|name| DERIVED.contains(&name));
    compare(runs.iter().map(|run| run.settings.clone()).collect(), &spoken_of);
    found
}

/// One run's side of the differences as a line of text.
pub(super) fn difference_text(differences: &[Difference], run: usize) -> String {
    let own = differences.iter().filter(|difference| !difference.values[run].is_empty());
    let named = own.map(|difference| {
        let Difference { name, values } = difference;
        // A setting keeps the name that --set knows it by; a field of the protocol becomes words.
        let name = if name.contains('.') { name.clone() } else { name.replace('_', " ") };
        format!("{name} {}", short(&values[run]))
    });
    named.collect::<Vec<String>>().join("; ")
}

/// A text with its long fractions rounded to four digits: 0.8333333333333334 as 0.8333. Files have all of them.
fn short(text: &str) -> String {
    let rounded = |part: &str| {
        let end = part.trim_end_matches([' ', ',', '/', ';']);
        match end.parse::<f64>() {
            Ok(number) if end.len() > 8 && end.contains('.') => {
                let number: f64 = format!("{number:.3e}").parse().expect("written as a number");
                format!("{number}{}", &part[end.len()..])
            }
            _ => part.to_string(),
        }
    };
    text.split_inclusive([' ', ',', '/', ';']).map(rounded).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_fractions_are_rounded_and_nothing_else_is_changed() {
        let text = "t 3/0.8333333333333334/0.25, rgb 1/2.5/0.01568627450980392";
        assert_eq!(short(text), "t 3/0.8333/0.25, rgb 1/2.5/0.01569");
        for same in ["709e22912345", "coarse 0, fine 1", "0.00001", "123456789", ""] {
            assert_eq!(short(same), same);
        }
    }

    #[test]
    fn what_the_protocol_speaks_of_is_not_told_twice() {
        for setting in ["seed", "train.learning_rate", "perturb.t.steps", "perturb.rgb.epsilon", "data.corruption.kind"]
        {
            assert!(spoken_of(setting), "{setting}");
        }
        for setting in ["train.warmup_share", "perturb.t.norm", "field.encoding", "sampling.jitter"] {
            assert!(!spoken_of(setting), "{setting}");
        }
    }
}
