//! CSV text.

/// Letter before a hash in a cell. Without it, other programs read `7797e1855047` as a number.
const HASH: char = 'h';
/// Least digits of a hash.
const HASH_DIGITS: usize = 7;

/// Returns a hash with a letter in front; another text stays. [`plain_hash`] removes the letter.
pub fn hash_cell(text: &str) -> String {
    if is_hash(text) { format!("{HASH}{text}") } else { text.into() }
}

/// Returns the text that was given to [`hash_cell`].
pub fn plain_hash(cell: &str) -> &str {
    cell.strip_prefix(HASH).filter(|hash| is_hash(hash)).unwrap_or(cell)
}

/// Returns whether a text begins with a hash. It may have an end, such as `-dirty`.
fn is_hash(text: &str) -> bool {
    text.bytes().take_while(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f')).count() >= HASH_DIGITS
}

/// Longest column name that is read: ten times the longest of this program.
const MOST_NAME: usize = 400;

/// Returns the column names of a table.
///
/// # Errors
/// If the head is not readable, or a name is too long. Readers keep the name with every cell of its column.
pub fn column_names<R: std::io::Read>(reader: &mut csv::Reader<R>) -> Result<Vec<String>, String> {
    let names: Vec<String> = reader.headers().map_err(|e| e.to_string())?.iter().map(String::from).collect();
    match names.iter().find(|name| name.len() > MOST_NAME) {
        Some(name) => Err(format!("a column's name has {} bytes, at most {MOST_NAME} are read", name.len())),
        None => Ok(names),
    }
}

/// Returns rows of equal length as CSV, including the head, quoted where necessary.
pub fn csv_text(rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for row in rows {
        writer.write_record(row).expect("rows are as long as the head, and memory takes them");
    }
    let bytes = writer.into_inner().expect("memory takes everything");
    String::from_utf8(bytes).expect("made of strings")
}

/// Returns rows of named cells as CSV, with the names of the first row as head. Without rows the text is empty.
pub fn csv_of_named<N: Into<String>>(rows: impl IntoIterator<Item = Vec<(N, String)>>) -> String {
    let mut head = true;
    let lines = rows.into_iter().flat_map(|row| {
        let (names, values): (Vec<String>, Vec<String>) =
            row.into_iter().map(|(name, value)| (name.into(), value)).unzip();
        let first = std::mem::take(&mut head).then_some(names);
        first.into_iter().chain(std::iter::once(values))
    });
    csv_text(lines)
}

/// Returns a number with all its digits, so that reading restores it. A missing number is empty.
pub fn csv_number(value: Option<f64>) -> String {
    value.map_or(String::new(), |value| value.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_quoted_and_missing_numbers_are_empty() {
        let row = |a: &str, b: Option<f64>| vec![("a,b".to_string(), a.to_string()), ("c".into(), csv_number(b))];
        assert_eq!(csv_of_named([row("x\"y", Some(0.1)), row("", None)]), "\"a,b\",c\n\"x\"\"y\",0.1\n,\n");
        assert_eq!(csv_of_named::<String>([]), "");
    }

    #[test]
    fn no_hash_is_a_number() {
        for text in ["7797e1855047", "123456789012-dirty", "0123456", "abc", "unknown", "", "fern-NeRF-0", "hex"] {
            let cell = hash_cell(text);
            assert!(cell.parse::<f64>().is_err() && plain_hash(&cell) == text && plain_hash(text) == text, "{cell}");
        }
    }
}
