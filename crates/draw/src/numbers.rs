//! Numbers as figures write them: one spelling for one number, and one style along an axis.

use super::scripts::raised;

/// Least significant digits of values along an axis; more where two values would look alike.
const DIGITS: usize = 3;
/// Sizes of numbers that are written without powers of ten.
const PLAIN: std::ops::RangeInclusive<f64> = 1e-3..=99_999.0;

/// Returns a number with the digits that a step between ticks asks for.
pub fn number(value: f64, step: f64) -> String {
    numbers(&[value], step).remove(0)
}

/// Returns evenly spaced numbers with the digits of their step, all with one power of ten if they need one.
pub fn numbers(values: &[f64], step: f64) -> Vec<String> {
    let largest = values.iter().map(|value| value.abs()).fold(0.0, f64::max);
    let decimals = |step: f64| (-step.log10().floor()).clamp(0.0, 6.0) as usize;
    if largest == 0.0 || PLAIN.contains(&largest) {
        return values.iter().map(|value| format!("{value:.*}", decimals(step))).collect();
    }
    let exponent = largest.log10().floor() as i32;
    let unit = 10f64.powi(exponent);
    let text = |value: &f64| match value / unit {
        0.0 => "0".to_string(),
        share => times(format!("{share:.*}", decimals(step / unit)), exponent),
    };
    values.iter().map(text).collect()
}

/// Returns values of a setting as their axis shows them: three digits unless more tell them apart. If one is smaller
/// or larger than is easily read, all are powers of ten.
pub fn values(values: &[f64]) -> Vec<String> {
    let with = |digits: usize| values.iter().map(|value| to_digits(*value, digits)).collect::<Vec<f64>>();
    let alike =
        |rounded: &[f64]| (0..values.len()).any(|i| (0..i).any(|j| rounded[i] == rounded[j] && values[i] != values[j]));
    let rounded = (DIGITS..17).map(with).find(|rounded| !alike(rounded)).unwrap_or_else(|| values.to_vec());
    let is_plain = |value: &f64| *value == 0.0 || PLAIN.contains(&value.abs());
    let text = if rounded.iter().all(is_plain) { |value: f64| value.to_string() } else { power };
    rounded.into_iter().map(text).collect()
}

/// Returns a number as a power of ten: `10⁻⁵`, `3×10⁻⁵`.
pub fn power(value: f64) -> String {
    if value == 0.0 {
        return "0".into();
    }
    let text = format!("{value:e}");
    let (share, exponent) = text.split_once('e').expect("an exponent is written");
    times(share.to_string(), exponent.parse().expect("an integer"))
}

fn times(share: String, exponent: i32) -> String {
    let power = match exponent {
        0 => return share,
        1 => "10".to_string(),
        other => format!("10{}", raised(other)),
    };
    match share.as_str() {
        "1" => power,
        "-1" => format!("-{power}"),
        _ => format!("{share}×{power}"),
    }
}

fn to_digits(value: f64, digits: usize) -> f64 {
    format!("{value:.*e}", digits - 1).parse().expect("a number's own digits")
}

/// Returns a value of a setting alone, as [`values`] does; other texts as they are.
pub fn short(text: &str) -> String {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => values(&[value]).remove(0),
        _ => text.to_string(),
    }
}

/// Rounds long fractions in a text to four digits: 0.8333333333333334 as 0.8333, and 0.0000003 as 3e-7. Files have all
/// digits.
pub fn rounded(text: &str) -> String {
    let part = |part: &str| {
        let end = part.trim_end_matches([' ', ',', '/', ';', ')']);
        match end.parse::<f64>() {
            Ok(number) if number != 0.0 && number.abs() < 1e-5 => format!("{number:e}{}", &part[end.len()..]),
            Ok(number) if end.len() > 8 && end.contains('.') => {
                format!("{}{}", to_digits(number, 4), &part[end.len()..])
            }
            _ => part.to_string(),
        }
    };
    text.split_inclusive([' ', ',', '/', ';', ')']).map(part).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_has_one_spelling_and_an_axis_one_style() {
        assert_eq!(values(&[1e-5, 1e-4, 1e-3, 0.01, 0.1]), ["10⁻⁵", "10⁻⁴", "10⁻³", "10⁻²", "10⁻¹"]);
        assert_eq!(values(&[0.001, 0.003, 0.1]), ["0.001", "0.003", "0.1"]);
        assert_eq!(values(&[0.0, 3e-5]), ["0", "3×10⁻⁵"]);
        assert_eq!(values(&[1000.0, 1001.0]), ["1000", "1001"]);
        assert_eq!(values(&[0.01568627450980392, 0.0627]), ["0.0157", "0.0627"]);
        assert_eq!((short("1.0"), short("0.00001"), short("1e-5")), ("1".into(), "10⁻⁵".into(), "10⁻⁵".into()));
        assert_eq!((short("sampling"), short("500000")), ("sampling".into(), "5×10⁵".into()));
    }

    #[test]
    fn long_fractions_are_rounded_and_nothing_else_is_changed() {
        let text = "t 3/0.8333333333333334/0.25, rgb 1/2.5/0.01568627450980392";
        assert_eq!(rounded(text), "t 3/0.8333/0.25, rgb 1/2.5/0.01569");
        assert_eq!(rounded("tv 0.0000003"), "tv 3e-7");
        for same in ["709e22912345", "coarse 0, fine 1", "0.00001", "123456789", ""] {
            assert_eq!(rounded(same), same);
        }
    }

    #[test]
    fn ticks_have_the_digits_of_their_step() {
        assert_eq!(numbers(&[-0.5, 0.0, 0.5], 0.5), ["-0.5", "0.0", "0.5"]);
        assert_eq!(numbers(&[0.0, 2e-4, 4e-4], 2e-4), ["0", "2×10⁻⁴", "4×10⁻⁴"]);
        assert_eq!(numbers(&[2e6, 2.5e6], 5e5), ["2.0×10⁶", "2.5×10⁶"]);
        assert_eq!(number(20.25, 0.02), "20.25");
    }
}
