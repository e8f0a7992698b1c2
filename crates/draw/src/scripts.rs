//! Raised and lowered digits, which fonts often lack: as wide as smaller digits.

/// Size of these digits, relative to the letters'.
pub(super) const SCALE: f64 = 0.66;

const SUPERSCRIPTS: &str = "⁰¹²³⁴⁵⁶⁷⁸⁹⁺⁻";
const SUBSCRIPTS: &str = "₀₁₂₃₄₅₆₇₈₉₊₋";
const PLAIN: &str = "0123456789+−";

/// Returns the plain digit or sign of a raised or lowered one.
pub(super) fn plain(letter: char) -> Option<char> {
    let of = |set: &str| PLAIN.chars().nth(set.chars().position(|known| known == letter)?);
    of(SUPERSCRIPTS).or_else(|| of(SUBSCRIPTS))
}

/// Returns an integer in raised digits.
pub(super) fn raised(number: i32) -> String {
    let digit = |letter: char| match letter {
        '-' => '⁻',
        digit => SUPERSCRIPTS.chars().nth(digit as usize - '0' as usize).expect("a digit"),
    };
    number.to_string().chars().map(digit).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn raised_digits_have_plain_ones() {
        assert_eq!((raised(-105), raised(23)), ("⁻¹⁰⁵".into(), "²³".into()));
        assert_eq!((plain('⁻'), plain('₂'), plain('2')), (Some('−'), Some('2'), None));
    }
}
