//! Numbers as people read them: three significant digits, and no more than a score has.

/// A number with three significant digits.
pub fn figure(value: f64) -> String {
    let scientific = format!("{value:.2e}");
    let exponent = scientific.split('e').nth(1).and_then(|digits| digits.parse::<i32>().ok());
    match exponent {
        _ if value == 0.0 => "0".to_owned(),
        Some(exponent @ -4..6) => format!("{value:.*}", (2 - exponent).max(0) as usize),
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
            (0.000_285, "0.000285"),
            (0.000_028_51, "2.85e-5"),
            (0.9996, "1.00"),
            (1.5, "1.50"),
            (-12.34, "-12.3"),
            (123_456.0, "123456"),
            (1.5e9, "1.50e9"),
        ] {
            assert_eq!(figure(value), text);
        }
    }
}
