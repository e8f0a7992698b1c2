//! What differs between two definitions of a sweep, in words.

use toml::{Table, Value};

use super::definition::Definition;

/// Most differences that are named.
const NAMED: usize = 6;

/// Names what differs: `title`, `row 'NeRF': set.train.steps`. Rows and axes are matched by their names.
pub(super) fn differences(before: &Definition, after: &Definition) -> String {
    let table = |definition| {
        let mut table = Table::try_from(definition).expect("plain data");
        // What the command line changed stands in the values.
        table.remove("changed");
        table
    };
    let tables = [before, after].map(table);
    let mut found = Vec::new();
    let [before, after] = &tables;
    compare("", before, after, &mut found);
    let more = found.len().saturating_sub(NAMED);
    found.truncate(NAMED);
    if more > 0 {
        found.push(format!("{more} more"));
    }
    found.join(", ")
}

fn compare(prefix: &str, before: &Table, after: &Table, found: &mut Vec<String>) {
    let keys = before.keys().chain(after.keys().filter(|key| !before.contains_key(*key)));
    for key in keys {
        let path = format!("{prefix}{key}");
        match (before.get(key), after.get(key)) {
            (a, b) if a == b => {}
            (Some(Value::Table(a)), Some(Value::Table(b))) => compare(&format!("{path}."), a, b, found),
            (Some(Value::Array(a)), Some(Value::Array(b))) if ["row", "axis"].contains(&key.as_str()) => {
                compare_named(key, a, b, found);
            }
            (Some(Value::Array(a)), None) | (None, Some(Value::Array(a)))
                if ["row", "axis"].contains(&key.as_str()) =>
            {
                found.extend(a.iter().map(|part| format!("{key} '{}'", name(part))));
            }
            (Some(Value::Array(_) | Value::Table(_)), Some(_)) => found.push(path),
            (Some(a), Some(b)) => found.push(format!("{path} ({} is now {})", text(a), text(b))),
            (Some(a), None) => found.push(format!("{path} ({}, now absent)", text(a))),
            (None, Some(b)) => found.push(format!("{path} (new: {})", text(b))),
            (None, None) => {}
        }
    }
}

fn compare_named(what: &str, before: &[Value], after: &[Value], found: &mut Vec<String>) {
    let in_both = |parts: &[Value], part: &Value| parts.iter().any(|other| name(other) == name(part));
    found.extend(
        before.iter().filter(|part| !in_both(after, part)).map(|part| format!("{what} '{}' is gone", name(part))),
    );
    found.extend(
        after.iter().filter(|part| !in_both(before, part)).map(|part| format!("{what} '{}' is new", name(part))),
    );
    let order = |parts: &[Value], others: &[Value]| -> Vec<String> {
        parts.iter().filter(|part| in_both(others, part)).map(name).collect()
    };
    if order(before, after) != order(after, before) {
        found.push(format!("the order of {what}s"));
    }
    for part in after {
        let same = before.iter().find(|other| name(other) == name(part));
        if let (Some(Value::Table(a)), Value::Table(b)) = (same, part) {
            compare(&format!("{what} '{}': ", name(part)), a, b, found);
        }
    }
}

fn text(value: &Value) -> String {
    match value {
        Value::String(text) => format!("'{text}'"),
        Value::Array(_) | Value::Table(_) => "several values".into(),
        other => other.to_string(),
    }
}

fn name(part: &Value) -> String {
    part.get("name").and_then(Value::as_str).unwrap_or_default().to_string()
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
        assert_eq!(said(|_| {}), "");
        assert_eq!(said(|after| after.title = "B".into()), "title ('A' is now 'B')");
        assert_eq!(said(|after| after.seeds = vec![0, 1]), "seeds");
        assert_eq!(said(|after| after.row[0].name = "N".into()), "row 'NeRF' is gone, row 'N' is new");
        assert_eq!(said(|after| after.row.reverse()), "the order of rows");
        let steps = |after: &mut Definition| {
            after.row[1].set.insert("train.steps".into(), 7.into());
        };
        assert_eq!(said(steps), "row 'Aug': set.train.steps (new: 7)");
    }
}
