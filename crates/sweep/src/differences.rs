//! What differs between two definitions of a sweep, in words.

use toml::{Table, Value};

use crate::report::distinct;

use super::definition::Definition;

/// Most differences that are named.
const NAMED: usize = 6;

/// Names what differs: `title`, `set.train.steps`, `row "NeRF"`. Rows and axes are matched by their names.
pub(super) fn differences(before: &Definition, after: &Definition) -> String {
    let [before, after] = [before, after].map(parts);
    let only = |own: &[Part], others: &[Part]| own.iter().filter(|part| !others.contains(part)).cloned().collect();
    let changed: [Vec<Part>; 2] = [only(&before, &after), only(&after, &before)];
    let mut names = distinct(changed.into_iter().flatten().map(|(name, _)| name));
    let more = names.len().saturating_sub(NAMED);
    names.truncate(NAMED);
    if more > 0 {
        names.push(format!("{more} more"));
    }
    if names.is_empty() { "the order of rows or axes".into() } else { names.join(", ") }
}

/// Part of a definition, with its name.
type Part = (String, Value);

/// Returns keys, settings, rows and axes.
fn parts(definition: &Definition) -> Vec<Part> {
    let mut table = Table::try_from(definition).expect("plain data");
    // What the command line changed stands in the values.
    table.remove("changed");
    let mut parts = Vec::new();
    for (key, value) in table {
        match value {
            Value::Table(inner) => {
                parts.extend(inner.into_iter().map(|(name, value)| (format!("{key}.{name}"), value)));
            }
            Value::Array(inner) if ["row", "axis"].contains(&key.as_str()) => {
                parts.extend(inner.into_iter().map(|part| (format!("{key} {}", part["name"]), part)));
            }
            value => parts.push((key, value)),
        }
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    const BASE: &str = "title = \"A\"\npreset = \"smoke\"\nscenes = [\"builtin\"]\nseeds = [0]\n[set]\n\"train.steps\" = 5\n\
                        [[row]]\nname = \"NeRF\"\n[[row]]\nname = \"Aug\"\n[row.set]\nmethod = \"aug-nerf\"\n";

    fn said(change: impl Fn(&mut Definition)) -> String {
        let before: Definition = toml::from_str(BASE).unwrap();
        let mut after = before.clone();
        change(&mut after);
        differences(&before, &after)
    }

    #[test]
    fn what_differs_is_named() {
        assert_eq!(said(|after| after.title = "B".into()), "title");
        assert_eq!(said(|after| after.seeds = vec![0, 1]), "seeds");
        assert_eq!(said(|after| after.row[0].name = "N".into()), "row \"NeRF\", row \"N\"");
        assert_eq!(said(|after| after.row.reverse()), "the order of rows or axes");
        let steps = |after: &mut Definition| {
            after.row[1].set.insert("train.steps".into(), 7.into());
        };
        assert_eq!(said(steps), "row \"Aug\"");
    }
}
