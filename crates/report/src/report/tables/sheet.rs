//! Columns of text for other programs: only those that say something, with names and cells that none of them misreads.

use serde_json::Value;

use crate::base::columns::{AXIS, SETTING, SITES, field_order, file_name, find, has_hashes, plain_field};
use crate::base::csv::{csv_text, hash_cell};
use crate::report::record::EPOCHS;

/// A column's name, and its cell in each line.
pub type Column = (String, Vec<Value>);

/// Returns the column with a swept setting's own value: `rays` for `set.train.rays`.
pub type ColumnOf = fn(&str) -> Option<&'static str>;

/// Name and text of each field that all points share.
pub type Constants = Vec<(String, String)>;

/// The field with the PGD numbers of all sites, `t 3/0.01/0.5, xyz ...`, and what each number is.
const ATTACK_NUMBERS: &str = "attack_numbers";
const NUMBERS: [&str; 3] = ["steps", "step_size", "epsilon"];

/// Returns a cell as text. A number has all its digits, a missing one is empty.
pub(in crate::report) fn text(cell: &Value) -> String {
    match cell {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        Value::Number(number) if number.is_f64() => number.as_f64().expect("asked").to_string(),
        other => other.to_string(),
    }
}

/// Returns columns of equal length as CSV.
pub(super) fn csv_of(columns: &[Column]) -> String {
    let lines = columns.first().map_or(0, |(_, cells)| cells.len());
    let head = columns.iter().map(|(name, _)| name.clone()).collect();
    let line = |line: usize| columns.iter().map(|(_, cells)| text(&cells[line])).collect();
    csv_text(std::iter::once(head).chain((0..lines).map(line)))
}

fn texts(cells: &[Value]) -> Vec<String> {
    cells.iter().map(text).collect()
}

/// Returns whether a swept column holds what the field `name` does.
fn repeats(swept: &str, name: &str, column_of: ColumnOf) -> bool {
    swept.strip_prefix(SETTING) == Some(name) || column_of(swept).is_some_and(|column| file_name(column) == name)
}

/// Returns whether a column holds what a sweep varies.
fn is_swept(name: &str) -> bool {
    name.starts_with(AXIS) || name.starts_with(SETTING)
}

/// Leaves out the columns that no line has, those of constants, and those that repeat a swept column. Swept columns come next to `axes`.
pub(super) fn compact(mut columns: Vec<Column>, constants: &Constants, column_of: ColumnOf) -> Vec<Column> {
    // One order, whichever point has a field first. What is no field of the protocol stays before.
    let is_field = |name: &str| !["scene", "seed"].contains(&name) && find(name).is_some();
    columns.sort_by_key(|(name, _)| is_field(name).then(|| field_order(name)));
    let is_constant = |name: &str, cells: &[String]| {
        let known = constants.iter().find(|(constant, _)| constant == name);
        known.is_some_and(|(_, value)| cells.iter().all(|cell| cell.is_empty() || cell == value))
    };
    let is_told = |(name, cells): &Column| {
        let cells = texts(cells);
        cells.iter().any(|cell| !cell.is_empty()) && !is_constant(name, &cells)
    };
    let told = columns.into_iter().flat_map(readable).filter(is_told);
    let (mut swept, mut others): (Vec<Column>, Vec<Column>) = told.partition(|(name, _)| is_swept(name));
    swept.sort_by_key(|(name, _)| name.starts_with(SETTING));
    others.retain(|(name, cells)| {
        !swept.iter().any(|(own, values)| repeats(own, name, column_of) && texts(values) == texts(cells))
    });
    let at = others.iter().rposition(|(name, _)| ["row", "axes"].contains(&name.as_str())).map_or(0, |at| at + 1);
    others.splice(at..at, swept);
    others
}

/// Returns the fields that are equal in all lines. Epochs are a column of all files: they say how far a number can be trusted.
pub(super) fn constants_of(columns: Vec<Column>) -> Constants {
    let fields = columns.into_iter().flat_map(readable).filter(|(name, _)| !is_swept(name) && name != EPOCHS);
    let constant = |(name, cells): Column| {
        let first = text(cells.first()?);
        (!first.is_empty() && cells.iter().all(|cell| text(cell) == first)).then_some((name, first))
    };
    fields.filter_map(constant).collect()
}

/// Returns a column as other programs read it without loss.
fn readable((name, cells): Column) -> Vec<Column> {
    if let Some(columns) = (name == ATTACK_NUMBERS).then(|| attack_columns(&cells)).flatten() {
        return columns;
    }
    let cell = |cell: Value| if has_hashes(&name) { hash_cell(&text(&cell)).into() } else { cell };
    vec![(file_name(&name).into(), cells.into_iter().map(cell).collect())]
}

/// Returns the columns of a site's PGD numbers.
fn names_of(site: &str) -> [String; NUMBERS.len()] {
    NUMBERS.map(|number| format!("perturb.{site}.{number}"))
}

/// Returns PGD numbers by their settings' names: `perturb.t.steps`, `perturb.t.step_size`, ...
pub fn attack_numbers(numbers: &str) -> Vec<(String, String)> {
    let of_site = |site: &str| {
        let own = numbers.split(", ").find_map(|part| part.strip_prefix(site)?.strip_prefix(' '));
        let own: Vec<&str> = own.map_or(Vec::new(), |own| own.split('/').collect());
        let numbers = if own.len() == NUMBERS.len() { own } else { Vec::new() };
        names_of(site).into_iter().zip(numbers.into_iter().map(String::from))
    };
    SITES.into_iter().flat_map(of_site).collect()
}

/// Returns PGD numbers as one text again.
fn joined_numbers(columns: &[(String, String)]) -> String {
    let cell = |name: &String| {
        let is_of = |known: &str| known == name || known.strip_prefix(SETTING) == Some(name);
        columns.iter().find(|(known, _)| is_of(known)).map_or("", |(_, cell)| cell)
    };
    let of_site = |site: &str| {
        let numbers = names_of(site).iter().map(cell).collect::<Vec<&str>>().join("/");
        (numbers.len() >= NUMBERS.len()).then(|| format!("{site} {numbers}"))
    };
    SITES.into_iter().filter_map(of_site).collect::<Vec<String>>().join(", ")
}

/// Returns a column for each PGD number of any line, or `None` if a text has another form.
fn attack_columns(cells: &[Value]) -> Option<Vec<Column>> {
    let lines: Vec<Vec<(String, String)>> = cells.iter().map(|cell| attack_numbers(&text(cell))).collect();
    if lines.iter().zip(cells).any(|(line, cell)| joined_numbers(line) != text(cell)) {
        return None;
    }
    let column = |name: String| {
        let cell = |line: &Vec<(String, String)>| {
            line.iter().find(|(known, _)| *known == name).map_or(Value::Null, |(_, number)| number.clone().into())
        };
        let cells = lines.iter().map(cell).collect();
        (name, cells)
    };
    Some(SITES.into_iter().flat_map(names_of).map(column).collect())
}

/// Returns a point's fields from its cells and constants: the opposite of [`readable`].
pub(super) fn fields_of(cells: Vec<(String, String)>, column_of: ColumnOf) -> Vec<(String, String)> {
    let is_number = |name: &str| SITES.into_iter().any(|site| names_of(site).iter().any(|own| own == name));
    let numbers = cells.iter().any(|(name, _)| is_number(name.strip_prefix(SETTING).unwrap_or(name)));
    let joined = numbers.then(|| (ATTACK_NUMBERS.to_string(), joined_numbers(&cells)));
    let own = cells.into_iter().filter(|(name, _)| !is_number(name)).map(plain_field);
    let mut fields: Vec<(String, String)> = own.chain(joined).collect();
    let of_setting = |(name, cell): &(String, String)| {
        let column = column_of(name)?;
        let is_lacking = !fields.iter().any(|(known, _)| known == column);
        is_lacking.then(|| (column.to_string(), cell.clone()))
    };
    let repeated: Vec<(String, String)> = fields.iter().filter_map(of_setting).collect();
    fields.extend(repeated);
    fields
}

#[cfg(test)]
mod tests {
    use super::*;

    fn column(name: &str, cells: &[&str]) -> Column {
        (name.into(), cells.iter().map(|cell| Value::from(*cell)).collect())
    }

    #[test]
    fn columns_that_say_nothing_are_left_out_and_come_back() {
        let numbers = ["t 3/0.01/0.5, xyz 1/0.1/1", "xyz 1/0.1/1"];
        let protocol = || {
            vec![
                column("width", &["101", "101"]),
                column("lambda", &["0.1", "0.2"]),
                column("masks", &["", ""]),
                column("data_hash", &["7797e1855047", "deadbeef0123"]),
                column("attack_numbers", &numbers),
                column("set.perturb.xyz.steps", &["1", "1"]),
                column("set.perturb.t.steps", &["3", ""]),
                column("axis.steps", &["3", "1"]),
            ]
        };
        let constants = constants_of(protocol());
        let of = |name: &str| constants.iter().find(|(known, _)| known == name).map(|(_, text)| text.as_str());
        assert_eq!([of("width"), of("perturb.xyz.epsilon"), of("masks")], [Some("101"), Some("1"), None]);
        let place =
            vec![column("id", &["123e45678901", "abc"]), column("row", &["A", "B"]), column("seed", &["0", "1"])];
        let told = compact([place, protocol()].concat(), &constants, |_| None);
        let csv = csv_of(&told);
        let lines: Vec<&str> = csv.lines().collect();
        assert_eq!(
            lines,
            [
                "id,row,axis.steps,set.perturb.xyz.steps,set.perturb.t.steps,seed,perturb.t.step_size,perturb.t.epsilon,\
                 perturb_lambda,data_hash",
                "h123e45678901,A,3,1,3,0,0.01,0.5,0.1,h7797e1855047",
                "abc,B,1,1,,1,,,0.2,hdeadbeef0123",
            ]
        );
        for (line, numbers) in numbers.into_iter().enumerate() {
            let cells = told.iter().map(|(name, cells)| (name.clone(), text(&cells[line])));
            let fields = fields_of(cells.chain(constants.clone()).collect(), |_| None);
            let of = |name: &str| fields.iter().find(|(known, _)| known == name).map(|(_, text)| text.as_str());
            assert_eq!((of("attack_numbers"), of("width")), (Some(numbers), Some("101")));
            assert_eq!((of("lambda"), of("perturb.xyz.epsilon")), (Some(["0.1", "0.2"][line]), None));
            assert_eq!(of("data_hash"), Some(["7797e1855047", "deadbeef0123"][line]));
        }
    }

    /// Another form of the numbers, such as that of a later program, stays one text.
    #[test]
    fn numbers_of_another_form_stay_text() {
        for text in ["t 3", "t 3/1/2/4", "u 3/1/2", "xyz 1/1/1, t 1/1/1"] {
            let kept = compact(vec![column("attack_numbers", &[text])], &Vec::new(), |_| None);
            assert_eq!(kept, [column("attack_numbers", &[text])]);
            let cells = [("attack_numbers".to_string(), text.to_string())].to_vec();
            assert_eq!(fields_of(cells.clone(), |_| None), cells);
        }
    }
}
