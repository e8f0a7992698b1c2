//! Tables of text as CSV.

/// Rows of equally many cells, the head among them, quoted where a cell asks for it.
pub fn csv_text(rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for row in rows {
        writer.write_record(&row).expect("rows are as long as the head, and memory takes them");
    }
    let bytes = writer.into_inner().expect("memory takes everything");
    String::from_utf8(bytes).expect("made of strings")
}

/// Rows of named cells under the first row's names; nothing of no rows.
pub fn csv_of_named(rows: impl IntoIterator<Item = Vec<(String, String)>>) -> String {
    let mut head = true;
    let lines = rows.into_iter().flat_map(|row| {
        let (names, values): (Vec<String>, Vec<String>) = row.into_iter().unzip();
        let first = std::mem::take(&mut head).then_some(names);
        first.into_iter().chain(std::iter::once(values))
    });
    csv_text(lines)
}

/// A number with all its digits, so that reading gives the same; empty where it is missing.
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
        assert_eq!(csv_of_named([]), "");
    }
}
