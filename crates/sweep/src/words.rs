//! Limits on a definition's names and margins. They appear in file names, tables and figures, which cannot hold every
//! text of TOML.

use super::definition::{Definition, scene_name};

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

    /// Returns the error of a definition with these texts.
    fn said(title: &str, scene: &str, row: &str, rest: &str) -> String {
        let text = format!(
            "title = {title}\npreset = \"smoke\"\nscenes = [{scene}]\nseeds = [0]\n{rest}\n[[row]]\nname = {row}\n"
        );
        let parsed = Definition::parse(&text, "x.toml");
        parsed.err().map_or(String::new(), |error| error.to_string())
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
