//! Numbers for people: three digits say all that a score can be trusted for, and an error says where
//! the digits end, so neither is ever shown as 0 if it is not.

use crate::metric::Ratio;

/// A number with three significant digits.
pub fn figure(value: f64) -> String {
    digits(value, 3)
}

/// A ratio with its standard error: `0.00278 ±0.000001`.
pub fn ratio(Ratio { mean, standard_error }: Ratio) -> String {
    format!("{} ±{}", figure(mean), digits(standard_error, 1))
}

/// A number with so many significant digits; with an exponent where zeros would hide them.
pub fn digits(value: f64, significant: i32) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let scientific = format!("{value:.*e}", significant as usize - 1);
    let exponent = scientific.split('e').nth(1).and_then(|digits| digits.parse::<i32>().ok());
    match exponent {
        Some(exponent @ -6..6) => {
            format!("{value:.*}", (significant - 1 - exponent).max(0) as usize)
        }
        _ => scientific,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_three_digits() {
        for (value, text) in [
            (0.0, "0"),
            (0.114_09, "0.114"),
            (0.000_028_51, "0.0000285"),
            (2.851e-9, "2.85e-9"),
            (0.9996, "1.00"),
            (805.238, "805"),
            (123_456.0, "123456"),
            (1.5e9, "1.50e9"),
            (f64::NAN, "NaN"),
        ] {
            assert_eq!(figure(value), text);
        }
    }

    #[test]
    fn an_error_is_never_shown_as_nothing() {
        let text = |mean, standard_error| ratio(Ratio { mean, standard_error });
        assert_eq!(text(0.002_779, 0.000_001_2), "0.00278 ±0.000001");
        assert_eq!(text(1.002, 0.0213), "1.00 ±0.02");
        assert_eq!(text(0.5, 3e-9), "0.500 ±3e-9");
        assert_eq!(text(0.5, 0.0), "0.500 ±0");
    }
}
