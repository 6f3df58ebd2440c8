//! Times as people type them: `90s`, `10m`, `2h`, or a number of seconds.

use std::time::Duration;

use perceptile::run::checkpointer::Every;

/// Reads a time.
///
/// # Errors
/// Another unit, and what is no time that can pass.
pub fn parse(text: &str) -> Result<Duration, String> {
    let (number, unit) = match text.find(|c: char| c.is_ascii_alphabetic()) {
        Some(at) => text.split_at(at),
        None => (text, "s"),
    };
    let factor = match unit {
        "s" => 1.0,
        "m" => 60.0,
        "h" => 3600.0,
        _ => return Err(format!("the unit of `{text}` must be s, m or h")),
    };
    let seconds: f64 = number.parse().map_err(|_| format!("`{text}` is not a time such as 10m"))?;
    Duration::try_from_secs_f64(seconds * factor)
        .map_err(|_| format!("`{text}` is not a time that can pass"))
}

/// Reads how often something is done: a time, or steps as in `500steps`.
///
/// # Errors
/// What is neither, and 0.
pub fn parse_every(text: &str) -> Result<Every, String> {
    let positive = || format!("`{text}` must be more than 0");
    if let Some(steps) = text.strip_suffix("steps") {
        let steps: u32 = steps
            .parse()
            .map_err(|_| format!("`{text}` is not a number of steps such as 500steps"))?;
        return if steps > 0 { Ok(Every::Steps(steps)) } else { Err(positive()) };
    }
    let time = parse(text)
        .map_err(|error| format!("{error}, nor is it a number of steps such as 500steps"))?;
    if time.is_zero() { Err(positive()) } else { Ok(Every::Time(time)) }
}

/// Reads the time after which a worker counts as lost.
///
/// # Errors
/// A time outside [0.2 s, 1 h].
pub fn parse_silence(text: &str) -> Result<Duration, String> {
    let time = parse(text)?;
    let range = Duration::from_millis(200)..=Duration::from_secs(3600);
    if range.contains(&time) { Ok(time) } else { Err(format!("{text} is not from 0.2s to 1h")) }
}

/// Seconds as people say them: `34 s`, `9 min 23 s`, `2 h 5 min`, `3 d 4 h`.
pub fn in_words(seconds: f64) -> String {
    let all = seconds.max(0.0).round() as u64;
    let two = |unit: u64, large: &str, small: &str, of: u64| {
        let rest = all % unit / of;
        let rest = if rest > 0 { format!(" {rest} {small}") } else { String::new() };
        format!("{} {large}{rest}", all / unit)
    };
    match all {
        0..10 => format!("{seconds:.1} s"),
        10..60 => format!("{all} s"),
        60..3600 => two(60, "min", "s", 1),
        3600..86_400 => two(3600, "h", "min", 60),
        _ => two(86_400, "d", "h", 3600),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_said_in_two_units_at_most() {
        for (seconds, words) in [
            (0.04, "0.0 s"),
            (2.34, "2.3 s"),
            (34.4, "34 s"),
            (59.7, "1 min"),
            (563.0, "9 min 23 s"),
            (7500.0, "2 h 5 min"),
            (273_600.0, "3 d 4 h"),
        ] {
            assert_eq!(in_words(seconds), words);
        }
    }

    #[test]
    fn all_flags_read_the_same_times() {
        let seconds = Duration::from_secs_f64;
        for (text, time) in [("90", 90.0), ("90s", 90.0), ("0.5m", 30.0), ("2h", 7200.0)] {
            assert_eq!(parse(text), Ok(seconds(time)), "{text}");
            assert_eq!(parse_every(text), Ok(Every::Time(seconds(time))), "{text}");
            assert_eq!(parse_silence(text).is_ok(), time <= 3600.0, "{text}");
        }
        assert_eq!(parse_every("500steps"), Ok(Every::Steps(500)));
        for wrong in ["", "s", "-1s", "nans", "infs", "1.5steps", "5days", "steps", "5 m"] {
            assert!(parse(wrong).is_err(), "{wrong}");
            assert!(parse_every(wrong).is_err(), "{wrong}");
        }
        assert!(parse_every("0s").is_err() && parse_every("0steps").is_err());
        assert!(parse_silence("0.1s").is_err());
    }
}
