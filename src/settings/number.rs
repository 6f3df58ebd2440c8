//! Whole numbers as people type them. The standard library calls `1e4` an invalid digit; people are
//! told the rule instead.

use std::num::IntErrorKind;
use std::str::FromStr;

/// Reads a whole number.
///
/// # Errors
/// What is none, and what is too large.
pub fn whole<T: FromStr<Err = std::num::ParseIntError>>(text: &str) -> Result<T, String> {
    text.parse().map_err(|error: std::num::ParseIntError| match error.kind() {
        IntErrorKind::PosOverflow => "it is too large".to_owned(),
        _ => "it must be a whole number in digits, such as 256".to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_whole_number_is_told_the_rule() {
        assert_eq!(whole::<u64>("10000"), Ok(10_000));
        for wrong in ["1e4", "1.5", "-1", "", "1_000", "many"] {
            assert!(whole::<u64>(wrong).unwrap_err().contains("whole number in digits"), "{wrong}");
        }
        assert_eq!(whole::<u64>("99999999999999999999"), Err("it is too large".into()));
    }
}
