//! Limits on a definition's names and margins. They appear in file names, tables and figures, which cannot hold every
//! text of TOML.

use super::definition::{Definition, scene_name};
use crate::base::{Error, Result};

type Checked = std::result::Result<(), String>;

/// Returns an error for control characters, which terminals obey and SVG cannot hold.
pub fn check_name(what: &str, name: &str) -> Checked {
    match name.chars().find(|letter| letter.is_control()) {
        None => Ok(()),
        Some(letter) => Err(format!(
            "{what} \"{}\" contains the control character U+{:04X}; remove it",
            name.escape_debug(),
            u32::from(letter)
        )),
    }
}

/// What pandas or R read as a missing value, in lower case.
const MISSING: [&str; 15] = [
    "", "#n/a", "#n/a n/a", "#na", "-1.#ind", "-1.#qnan", "-nan", "1.#ind", "1.#qnan", "<na>", "n/a", "na", "nan",
    "none", "null",
];

/// Returns an error for a name that pandas or R read from CSV files as something else than text: as a missing value, a number
/// or a truth value.
pub fn check_text(what: &str, name: &str) -> Checked {
    let text = name.trim().to_lowercase();
    let digits = text.trim_start_matches(['+', '-']);
    let is_hexadecimal =
        || digits.strip_prefix("0x").is_some_and(|digits| digits.chars().all(|c| c.is_ascii_hexdigit() || c == '.'));
    // R has complex numbers.
    let is_complex = || {
        let parts =
            digits.strip_suffix('i').filter(|parts| parts.starts_with(|c: char| c.is_ascii_digit() || c == '.'));
        parts.is_some_and(|parts| parts.chars().all(|c| c.is_ascii_digit() || ".e+-".contains(c)))
    };
    let meant = if MISSING.contains(&text.as_str()) {
        "missing value"
    } else if text.parse::<f64>().is_ok() || is_hexadecimal() || is_complex() {
        "number"
    } else if ["true", "false"].contains(&text.as_str()) || ["T", "F"].contains(&name.trim()) {
        "truth value"
    } else {
        return Ok(());
    };
    let kind = what.rsplit(' ').find(|word| !word.ends_with("name")).unwrap_or("row").trim_end_matches("'s");
    Err(format!(
        "{what} '{name}' is one that pandas and R read as a {meant} in points.csv and table.csv; choose another, such as '{kind} {name}'"
    ))
}

/// Lists names in quotes, since a name may have a comma.
pub(super) fn quoted(names: &[impl AsRef<str>]) -> String {
    names.iter().map(|name| format!("'{}'", name.as_ref())).collect::<Vec<_>>().join(", ")
}

impl Definition {
    /// Checks that tables and figures can print all names of the definition.
    pub(super) fn check_words(&self) -> Checked {
        let is_break = |letter: char| letter == '\n' || letter == '\t';
        check_name("title", &self.full_title().replace(is_break, " "))?;
        self.scenes.iter().try_for_each(|scene| check_name("the scene's name", &scene_name(scene)))?;
        self.quoted.iter().try_for_each(|method| check_name("the quoted method", method))?;
        self.row.iter().try_for_each(|row| check_name("the row's name", &row.name))?;
        for axis in self.all_axes() {
            check_name("the axis's name", &axis.name)?;
            check_name(&format!("the panel of axis '{}'", axis.name), &axis.panel)?;
            for point in axis.points()? {
                check_name(&format!("the value on axis '{}'", axis.name), &point.label)?;
            }
        }
        Ok(())
    }

    /// Checks that other programs read the names of rows and scenes as text. Folders of earlier versions may have other names.
    ///
    /// # Errors
    /// [`Error::Config`]: names the row or scene.
    pub fn check_texts(&self) -> Result<()> {
        let rows = self.row.iter().map(|row| check_text("the row's name", &row.name));
        let scenes = self.scenes.iter().map(|scene| check_text("the scene's name", &scene_name(scene)));
        rows.chain(scenes).collect::<Checked>().map_err(Error::Config)
    }

    /// Checks that margins of equivalence are positive and belong to metrics of the table.
    pub(super) fn check_margins(&self) -> Checked {
        for (metric, margin) in &self.equivalence {
            if !self.metrics.contains(metric) {
                let metrics = self.metrics.join(", ");
                return Err(format!(
                    "equivalence.{metric}: {metric} is not a metric of the sweep; its metrics are {metrics}"
                ));
            }
            if !(margin.is_finite() && *margin > 0.0) {
                return Err(format!(
                    "equivalence.{metric} = {margin} is out of range: the largest difference that counts as none must be \
                     a finite number above 0"
                ));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What `pandas.read_csv` reads as missing: its default list.
    const OF_PANDAS: [&str; 19] = [
        "", "#N/A", "#N/A N/A", "#NA", "-1.#IND", "-1.#QNAN", "-NaN", "-nan", "1.#IND", "1.#QNAN", "<NA>", "N/A", "NA",
        "NULL", "NaN", "None", "n/a", "nan", "null",
    ];

    #[test]
    fn names_are_text_in_pandas_and_r() {
        let said = |name: &str| check_text("the row's name", name).err().unwrap_or_default();
        assert!(OF_PANDAS.iter().all(|name| said(name).contains("missing value")));
        for name in [
            "NONE",
            " na ",
            "1e5",
            "-3",
            "+.5",
            "007",
            "inf",
            "-Infinity",
            "0x1F",
            "2i",
            "1-2.5i",
            "TRUE",
            "false",
            "T",
        ] {
            assert!(said(name).contains(&format!("such as 'row {name}'")), "{name}: {}", said(name));
        }
        for name in ["NeRF", "No attack", "t", "None, 3 seeds", "1e5 steps", "+ TV", "0xyz", "hi", "i", "Ti", "F-NeRF"]
        {
            assert_eq!(said(name), "", "{name}");
        }
        let scene = check_text("the scene's name", "0042").unwrap_err();
        assert!(scene.contains("read as a number") && scene.contains("'scene 0042'"), "{scene}");
    }

    /// Returns the error of a definition with these texts.
    fn said(title: &str, scene: &str, row: &str, rest: &str) -> String {
        let text = format!(
            "title = {title}\npreset = \"smoke\"\nscenes = [{scene}]\nseeds = [0]\n{rest}\n[[row]]\nname = {row}\n"
        );
        let parsed = Definition::parse(&text, "x.toml");
        parsed.err().map_or(String::new(), |error: Error| error.to_string())
    }

    #[test]
    fn control_characters_are_refused_when_the_definition_is_read() {
        assert_eq!(said(r#""a\n\nb""#, r#""builtin""#, r#""NeRF\u03b1""#, ""), "");
        let esc = said(r#""t""#, r#""builtin""#, r#""Ne\u001bRF""#, "");
        assert!(
            esc.contains(r"x.toml: the row's name") && esc.contains(r"Ne\u{1b}RF") && esc.contains("U+001B"),
            "{esc}"
        );
        for (title, scene, row, rest) in [
            (r#""t\u0000""#, r#""builtin""#, r#""NeRF""#, ""),
            (r#""t""#, r#""a/fern\n""#, r#""NeRF""#, ""),
            (r#""t""#, r#""builtin""#, r#""Ne\nRF""#, ""),
            (r#""t""#, r#""builtin""#, r#""NeRF""#, r#"axis = [{ name = "a\u0007", keys = ["seed"], values = [1] }]"#),
            (
                r#""t""#,
                r#""builtin""#,
                r#""NeRF""#,
                r#"axis = [{ name = "a", keys = ["data.dir"], values = ["\u0085"] }]"#,
            ),
        ] {
            assert!(said(title, scene, row, rest).contains("control character"), "{title} {scene} {row} {rest}");
        }
    }

    #[test]
    fn margins_are_of_metrics_and_positive() {
        let stated =
            |margins: &str| said(r#""t""#, r#""builtin""#, r#""NeRF""#, &format!("equivalence = {{ {margins} }}"));
        assert_eq!(stated("psnr = 0.3, ssim = 0.01"), "");
        assert!(stated("psn = 0.3").contains("equivalence.psn: psn is not a metric"), "{}", stated("psn = 0.3"));
        for wrong in ["psnr = 0.0", "psnr = -0.3", "psnr = inf", "psnr = nan"] {
            assert!(stated(wrong).contains("finite number above 0"), "{wrong}");
        }
    }
}
