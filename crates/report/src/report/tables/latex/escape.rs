//! Text that LaTeX prints unchanged.

/// Escapes text for any LaTeX engine and encoding; `\augnerfletter` prints the remaining letters.
pub(super) fn escape(text: &str) -> String {
    text.split_inclusive(' ').map(escape_word).collect()
}

/// Escapes a word with its trailing space. A word that is longer than most lines of the first column gets places to
/// break between letters.
fn escape_word(text: &str) -> String {
    let breaks = text.chars().count() > LONG_WORD;
    let mut escaped = String::with_capacity(text.len());
    let mut before = ' ';
    for (index, c) in text.chars().enumerate() {
        if breaks && index > 0 && index % BREAK_EVERY == 0 {
            escaped += "\\allowbreak{}";
        }
        match c {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => escaped.extend(['\\', c]),
            '\\' => escaped += "\\textbackslash{}",
            '~' => escaped += "\\textasciitilde{}",
            '^' => escaped += "\\textasciicircum{}",
            '<' => escaped += "\\textless{}",
            '>' => escaped += "\\textgreater{}",
            '|' => escaped += "\\textbar{}",
            // A minus sign, not a hyphen; two, as in a flag, are not a dash.
            '-' if matches!(before, ' ' | '[') => escaped += "$-$",
            '-' if before == '-' => escaped += "{}-",
            // A blank line would end the paragraph, an error in a caption.
            c if c.is_whitespace() || c.is_control() => escaped.push(' '),
            c if c.is_ascii() || ACCENTED.contains(c) => escaped.push(c),
            other => escaped += &special(other),
        }
        before = c;
    }
    escaped
}

/// Least letters of a word that may be broken, and letters between two such places.
const LONG_WORD: usize = 22;
const BREAK_EVERY: usize = 10;

/// Letters with accents that every encoding of LaTeX can compose.
const ACCENTED: &str =
    "ÀÁÂÃÄÅÆÇÈÉÊËÌÍÎÏÑÒÓÔÕÖØÙÚÛÜÝàáâãäåæçèéêëìíîïñòóôõöøùúûüýÿßĆćČčĎďĚěŁłŃńŇňŐőŒœŘřŚśŠšŤťŮůŰűŸŹźŻżŽž";

/// Signs and Greek letters in mathematics.
const SPECIAL: &[(char, &str)] = &[
    ('±', "$\\pm$"),
    ('†', "$\\dagger$"),
    ('‡', "$\\ddagger$"),
    ('§', "\\S{}"),
    ('¶', "\\P{}"),
    ('‖', "$\\|$"),
    ('·', "$\\cdot$"),
    ('×', "$\\times$"),
    ('−', "$-$"),
    ('–', "--"),
    ('—', "---"),
    ('…', "\\ldots{}"),
    ('≤', "$\\leq$"),
    ('≥', "$\\geq$"),
    ('≈', "$\\approx$"),
    ('∞', "$\\infty$"),
    ('°', "$^\\circ$"),
    ('²', "$^2$"),
    ('³', "$^3$"),
    ('⁰', "$^{0}$"),
    ('¹', "$^{1}$"),
    ('⁴', "$^{4}$"),
    ('⁵', "$^{5}$"),
    ('⁶', "$^{6}$"),
    ('⁷', "$^{7}$"),
    ('⁸', "$^{8}$"),
    ('⁹', "$^{9}$"),
    ('⁺', "$^{+}$"),
    ('⁻', "$^{-}$"),
    ('₀', "$_{0}$"),
    ('₁', "$_{1}$"),
    ('₂', "$_{2}$"),
    ('₃', "$_{3}$"),
    ('₄', "$_{4}$"),
    ('₅', "$_{5}$"),
    ('₆', "$_{6}$"),
    ('₇', "$_{7}$"),
    ('₈', "$_{8}$"),
    ('₉', "$_{9}$"),
    ('₊', "$_{+}$"),
    ('₋', "$_{-}$"),
    ('µ', "$\\mu$"),
    ('α', "$\\alpha$"),
    ('β', "$\\beta$"),
    ('γ', "$\\gamma$"),
    ('δ', "$\\delta$"),
    ('ε', "$\\varepsilon$"),
    ('ζ', "$\\zeta$"),
    ('η', "$\\eta$"),
    ('θ', "$\\theta$"),
    ('ι', "$\\iota$"),
    ('κ', "$\\kappa$"),
    ('λ', "$\\lambda$"),
    ('μ', "$\\mu$"),
    ('ν', "$\\nu$"),
    ('ξ', "$\\xi$"),
    ('ο', "$o$"),
    ('π', "$\\pi$"),
    ('ρ', "$\\rho$"),
    ('σ', "$\\sigma$"),
    ('ς', "$\\varsigma$"),
    ('τ', "$\\tau$"),
    ('υ', "$\\upsilon$"),
    ('φ', "$\\varphi$"),
    ('χ', "$\\chi$"),
    ('ψ', "$\\psi$"),
    ('ω', "$\\omega$"),
    ('Γ', "$\\Gamma$"),
    ('Δ', "$\\Delta$"),
    ('Θ', "$\\Theta$"),
    ('Λ', "$\\Lambda$"),
    ('Ξ', "$\\Xi$"),
    ('Π', "$\\Pi$"),
    ('Σ', "$\\Sigma$"),
    ('Υ', "$\\Upsilon$"),
    ('Φ', "$\\Phi$"),
    ('Ψ', "$\\Psi$"),
    ('Ω', "$\\Omega$"),
    ('ϵ', "$\\epsilon$"),
    ('↑', "$\\uparrow$"),
    ('↓', "$\\downarrow$"),
    ('∇', "$\\nabla$"),
    ('√', "$\\surd$"),
];

fn special(letter: char) -> String {
    let known = SPECIAL.iter().find(|(known, _)| *known == letter).map(|(_, text)| (*text).to_string());
    known.unwrap_or_else(|| format!("\\augnerfletter{{{:04X}}}", u32::from(letter)))
}

/// Prints the letter itself if the engine knows Unicode, otherwise its number, since the letter would be an error.
pub(super) const LETTER: &str =
    "\\providecommand{\\augnerfletter}[1]{\\ifdefined\\Umathchar\\char\"#1\\relax\\else[U+#1]\\fi}\n";

#[cfg(test)]
mod tests {
    use super::escape;

    #[test]
    fn special_characters_are_printed() {
        assert_eq!(
            escape("a_b & 5 % {x} \\ <~^>|"),
            concat!(
                "a\\_b \\& 5 \\% \\{x\\} \\textbackslash{} ",
                "\\textless{}\\textasciitilde{}\\textasciicircum{}\\textgreater{}\\textbar{}"
            )
        );
        assert_eq!(escape("1 ± 2 †§"), "1 $\\pm$ 2 $\\dagger$\\S{}");
        assert_eq!(escape("a\n\n\tb\u{0}c"), "a   b c");
        assert_eq!(escape("β₂ 4×10⁻⁵ m²"), "$\\beta$$_{2}$ 4$\\times$10$^{-}$$^{5}$ m$^2$");
        assert_eq!(escape("λ 中 é --force"), "$\\lambda$ \\augnerfletter{4E2D} é $-${}-force");
        assert_eq!(escape("-0.1 [-0.2, -0.0] pre-output"), "$-$0.1 [$-$0.2, $-$0.0] pre-output");
        let long = "x".repeat(23);
        assert_eq!(escape(&long).replace("\\allowbreak{}", "|"), "xxxxxxxxxx|xxxxxxxxxx|xxx");
    }
}
