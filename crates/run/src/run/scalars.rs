//! `scalars.csv`: one row per logged step, the same bytes whether or not a run was interrupted.

use std::fs::File;
use std::path::{Path, PathBuf};

use crate::base::files::write_atomic;
use crate::base::input::{TABLE_BYTES, read_bytes};
use crate::base::{Error, Result};

const STEP: &str = "step";

/// A growing table of scalars with fixed columns. Every row reaches the file in one write, before [`Scalars::append`]
/// returns.
///
/// Append a row before saving the checkpoint of its step. If a crash of the machine matters, call [`Scalars::sync`] in
/// between. [`Scalars::resume`] keeps the rows up to the checkpoint's step, and training then repeats the rows after
/// it.
#[derive(Debug)]
pub struct Scalars {
    path: PathBuf,
    columns: Vec<String>,
    writer: csv::Writer<File>,
}

impl Scalars {
    /// Creates a table with the column `step`, then `columns`, and replaces an existing file. Names contain only ASCII
    /// letters, digits and `_ . / -`, so that a row is always one line.
    pub fn create(path: &Path, columns: &[&str]) -> Result<Scalars> {
        check_columns(path, columns)?;
        write_atomic(path, header(columns).as_bytes())?;
        Scalars::open(path, columns)
    }

    /// Continues a table at `step`, the step of the checkpoint. Later rows and an unfinished last line are cut off. A
    /// missing file is created. Other columns are an error.
    pub fn resume(path: &Path, columns: &[&str], step: u64) -> Result<Scalars> {
        if !path.exists() {
            return Scalars::create(path, columns);
        }
        check_columns(path, columns)?;
        let bytes = read_bytes(path, TABLE_BYTES).map_err(|error| Error::unreadable(path, &error))?;
        let kept = rows_up_to(&bytes, &header(columns), columns.len(), step)
            .map_err(|reason| Error::Checkpoint(format!("cannot continue {}: {reason}", path.display())))?;
        write_atomic(path, &kept)?;
        Scalars::open(path, columns)
    }

    fn open(path: &Path, columns: &[&str]) -> Result<Scalars> {
        let file = File::options().append(true).open(path).map_err(|error| Error::unwritable(path, &error))?;
        let writer = csv::WriterBuilder::new().has_headers(false).from_writer(file);
        let columns = columns.iter().map(|column| column.to_string()).collect();
        Ok(Scalars { path: path.to_path_buf(), columns, writer })
    }

    /// Appends the row of `step`. Columns that `values` does not name stay empty. A number that is not finite is an
    /// [`Error::Diverged`], a name without a column an [`Error::Output`]; neither writes anything.
    pub fn append(&mut self, step: u64, values: &[(&str, f64)]) -> Result<()> {
        let mut cells = vec![String::new(); self.columns.len() + 1];
        cells[0] = step.to_string();
        for &(name, value) in values {
            let column = self.columns.iter().position(|column| column == name).ok_or_else(|| {
                Error::Output(format!(
                    "cannot write {}: it has no column '{name}', only {}",
                    self.path.display(),
                    self.columns.join(", ")
                ))
            })?;
            check_finite(step, name, value)?;
            cells[column + 1] = value.to_string();
        }
        self.writer
            .write_record(&cells)
            .map_err(std::io::Error::from)
            .and_then(|()| self.writer.flush())
            .map_err(|error| Error::unwritable(&self.path, &error))
    }

    /// Waits until every row is on the disk.
    pub fn sync(&mut self) -> Result<()> {
        self.writer.get_ref().sync_data().map_err(|error| Error::unwritable(&self.path, &error))
    }
}

/// Returns an [`Error::Diverged`] if `value` is not finite.
pub fn check_finite(step: u64, name: &str, value: f64) -> Result<()> {
    if value.is_finite() {
        return Ok(());
    }
    Err(Error::Diverged(format!("'{name}' is {value} at step {step}")))
}

fn check_columns(path: &Path, columns: &[&str]) -> Result<()> {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"_./-".contains(&byte);
    for (index, column) in columns.iter().enumerate() {
        let unusable = column.is_empty() || !column.bytes().all(plain) || *column == STEP;
        if unusable || columns[..index].contains(column) {
            return Err(Error::Output(format!(
                "cannot write {}: '{column}' is not a column name, or occurs twice",
                path.display()
            )));
        }
    }
    Ok(())
}

fn header(columns: &[&str]) -> String {
    let names: Vec<&str> = std::iter::once(STEP).chain(columns.iter().copied()).collect();
    names.join(",") + "\n"
}

/// Returns the bytes of a table without rows after step `last` and without an unfinished line.
fn rows_up_to(bytes: &[u8], header: &str, columns: usize, last: u64) -> std::result::Result<Vec<u8>, String> {
    let whole = bytes.iter().rposition(|&byte| byte == b'\n').map_or(0, |end| end + 1);
    let mut kept = header.as_bytes().to_vec();
    for (index, line) in bytes[..whole].split_inclusive(|&byte| byte == b'\n').enumerate() {
        if index == 0 {
            if line != header.as_bytes() {
                let found = String::from_utf8_lossy(line);
                return Err(format!(
                    "its columns are '{}', but this run's are '{}'",
                    found.trim_end(),
                    header.trim_end()
                ));
            }
            continue;
        }
        let step = step_of(line, columns).ok_or_else(|| format!("line {} is not a row of this table", index + 1))?;
        if step <= last {
            kept.extend_from_slice(line);
        }
    }
    Ok(kept)
}

fn step_of(line: &[u8], columns: usize) -> Option<u64> {
    let text = std::str::from_utf8(line).ok()?;
    let mut cells = text.trim_end_matches('\n').split(',');
    let step = cells.next()?.parse().ok()?;
    (cells.count() == columns).then_some(step)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    const COLUMNS: [&str; 2] = ["loss", "psnr/train"];

    fn write_steps(table: &mut Scalars, steps: std::ops::RangeInclusive<u64>) {
        for step in steps {
            table.append(step, &[("loss", 1.0 / step as f64)]).unwrap();
        }
    }

    #[test]
    fn numbers_read_back_exactly_and_missing_ones_are_empty() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("scalars.csv");
        let mut table = Scalars::create(&path, &COLUMNS).unwrap();
        table.append(1, &[("psnr/train", 0.1 + 0.2)]).unwrap();
        table.append(2, &[("psnr/train", 20.0), ("loss", -1e-7)]).unwrap();
        let text = fs::read_to_string(&path).unwrap();
        assert_eq!(text, "step,loss,psnr/train\n1,,0.30000000000000004\n2,-0.0000001,20\n");
    }

    #[test]
    fn a_resumed_table_equals_an_undisturbed_one() {
        let dir = tempfile::tempdir().unwrap();
        let (straight, broken) = (dir.path().join("a.csv"), dir.path().join("b.csv"));
        write_steps(&mut Scalars::create(&straight, &COLUMNS).unwrap(), 1..=20);
        write_steps(&mut Scalars::create(&broken, &COLUMNS).unwrap(), 1..=13);
        let whole = fs::read(&broken).unwrap();
        let row_10 = whole.windows(4).position(|bytes| bytes == b"\n11,").unwrap() + 1;
        for length in row_10..=whole.len() {
            fs::write(&broken, &whole[..length]).unwrap();
            write_steps(&mut Scalars::resume(&broken, &COLUMNS, 10).unwrap(), 11..=20);
            assert_eq!(fs::read(&broken).unwrap(), fs::read(&straight).unwrap(), "killed after {length} bytes");
        }
    }

    #[test]
    fn a_table_killed_within_its_header_starts_again() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("scalars.csv");
        fs::write(&path, "step,lo").unwrap();
        Scalars::resume(&path, &COLUMNS, 0).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "step,loss,psnr/train\n");
    }

    #[test]
    fn what_does_not_belong_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("scalars.csv");
        let mut table = Scalars::create(&path, &COLUMNS).unwrap();
        let before = fs::read(&path).unwrap();
        assert_eq!(table.append(3, &[("loss", f64::NAN)]).unwrap_err().exit_code(), 6);
        assert_eq!(table.append(3, &[("lost", 1.0)]).unwrap_err().exit_code(), 4);
        assert_eq!(fs::read(&path).unwrap(), before);
        assert_eq!(Scalars::resume(&path, &["other"], 3).unwrap_err().exit_code(), 5);
        fs::write(&path, "step,loss,psnr/train\n1,2\n").unwrap();
        let error = Scalars::resume(&path, &COLUMNS, 3).unwrap_err().to_string();
        assert!(error.contains("line 2") && error.contains("scalars.csv"), "{error}");
        for columns in [["a,b", "c"], ["a", "a"], ["step", "a"], ["", "a"]] {
            assert!(Scalars::create(&path, &columns).is_err());
        }
    }
}
