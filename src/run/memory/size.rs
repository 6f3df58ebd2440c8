//! Numbers of bytes as people read them: in the unit that leaves few digits.

/// A number of bytes, with 1024 of a unit in the next: `45.8 TB`.
pub fn size(bytes: u64) -> String {
    const UNITS: [&str; 6] = ["KB", "MB", "GB", "TB", "PB", "EB"];
    if bytes < 1024 {
        return format!("{bytes} B");
    }
    let power = (bytes.ilog2() / 10).max(1);
    let value = bytes as f64 / f64::from(power * 10).exp2();
    // Four digits are not made shorter by a point.
    let decimals = usize::from(value < 999.5 && power > 1);
    format!("{value:.decimals$} {}", UNITS[power as usize - 1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_have_the_unit_that_leaves_few_digits() {
        for (bytes, text) in [
            (0, "0 B"),
            (1023, "1023 B"),
            (1536, "2 KB"),
            (791 << 20, "791.0 MB"),
            (1020 << 20, "1020 MB"),
            (48_006_259_441_664, "43.7 TB"),
            (1 << 53, "8.0 PB"),
            (u64::MAX, "16.0 EB"),
        ] {
            assert_eq!(size(bytes), text);
        }
    }
}
