//! Raised and lowered digits, which fonts often lack: drawn as smaller digits.

/// Size of these digits, relative to the letters'.
pub(super) const SCALE: f64 = 0.66;
/// Baselines of raised and of lowered digits above that of the letters, in em.
const RAISED: f64 = 0.36;
const LOWERED: f64 = -0.14;

const SUPERSCRIPTS: &str = "⁰¹²³⁴⁵⁶⁷⁸⁹⁺⁻";
const SUBSCRIPTS: &str = "₀₁₂₃₄₅₆₇₈₉₊₋";
const PLAIN: &str = "0123456789+−";

/// Returns the plain digit or sign of a raised or lowered one, and its baseline in em.
pub(super) fn plain(letter: char) -> Option<(char, f64)> {
    let of = |set: &str| PLAIN.chars().nth(set.chars().position(|known| known == letter)?);
    of(SUPERSCRIPTS).map(|plain| (plain, RAISED)).or_else(|| of(SUBSCRIPTS).map(|plain| (plain, LOWERED)))
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
        assert_eq!(plain('⁻'), Some(('−', RAISED)));
        assert_eq!((plain('₂'), plain('2')), (Some(('2', LOWERED)), None));
    }
}
