//! What the first table comes to, in words: how much of each other tile's perceived error is left
//! with the tile that all are compared with.

use perceptile::metric::{Class, Coordinates, ScoredTile, digits};

use super::Evaluation;

/// One line for each tile, or each of its parts, after the first tile, which is the one that they are
/// compared with.
pub(super) fn lines(report: &Evaluation) -> Vec<String> {
    let of = |(place, other): (usize, &ScoredTile)| {
        let reference = report.reference(place)?;
        Some(match report.is_repeated_noise(other) {
            true => repeated(other, report.kernel_frames),
            false => line(reference, other),
        })
    };
    report.tiles.iter().enumerate().filter_map(of).collect()
}

/// Of white noise that repeats within the kernel: what else to compare with.
fn repeated(noise: &ScoredTile, seen: u64) -> String {
    let (name, frames) = (&noise.name, noise.shape.frames());
    format!(
        "{name} repeats after {frames} of the {seen} frames that the kernel sees, which adds error: \
         compare with 1, white noise that is new in every frame"
    )
}

fn line(reference: &ScoredTile, other: &ScoredTile) -> String {
    let (ours, theirs) = (&reference.name, &other.name);
    if reference.shape.dims() != other.shape.dims() {
        // Integrands of other dimensions are other integrands.
        return format!("{theirs} has samples of other dimensions than {ours}: not compared");
    }
    let perceived = |tile: &ScoredTile, class: Class| {
        tile.scores.class(class, Coordinates::All).map(|score| score.perceived.mean)
    };
    let ratio = |&class: &Class| {
        let quotient = perceived(reference, class)? / perceived(other, class)?;
        quotient.is_finite().then_some((class, quotient))
    };
    let ratios: Vec<(Class, f64)> = Class::ALL.iter().filter_map(ratio).collect();
    let by_ratio = |a: &&(Class, f64), b: &&(Class, f64)| a.1.total_cmp(&b.1);
    let (Some(&(least, low)), Some(&(most, high))) =
        (ratios.iter().min_by(by_ratio), ratios.iter().max_by(by_ratio))
    else {
        return format!("{theirs} has no error to compare with");
    };
    let (low, high) = (digits(low, 2), digits(high, 2));
    if low == high {
        return format!("{ours} has {low} of {theirs}'s perceived error");
    }
    let worse: Vec<&str> =
        ratios.iter().filter(|(_, ratio)| *ratio > 1.0).map(|&(class, _)| plural(class)).collect();
    let but = match &worse[..] {
        [] => String::new(),
        all if all.len() == ratios.len() => "; worse for all".into(),
        [one] => format!("; worse for {one}"),
        [some @ .., last] => format!("; worse for {} and {last}", some.join(", ")),
    };
    format!(
        "{ours} has {low}–{high} of {theirs}'s perceived error (least for {}, most for {}{but})",
        plural(least),
        plural(most)
    )
}

/// What the integrands of a class are called.
fn plural(class: Class) -> &'static str {
    match class {
        Class::Linear => "linear functions",
        Class::Edge => "edges",
        Class::AxisEdge => "axis edges",
        Class::Bump => "bumps",
        Class::Disk => "disks",
    }
}

#[cfg(test)]
mod tests {
    use super::super::table::tests::entry;
    use super::*;

    /// The verdict of two tiles with these errors in the order of the classes.
    fn verdict(ours: [f64; 5], theirs: [f64; 5]) -> String {
        let tile = |name: &str, levels: [f64; 5]| {
            let mut tile = entry(name, 2, 4, 1.0);
            for (score, level) in tile.scores.classes.iter_mut().zip(levels) {
                score.perceived.mean = level;
            }
            tile
        };
        line(&tile("ours", ours), &tile("FAST", theirs))
    }

    #[test]
    fn the_best_and_the_worst_class_are_named() {
        assert_eq!(
            verdict([0.2, 0.494, 0.3, 0.141, 0.4], [1.0; 5]),
            "ours has 0.14–0.49 of FAST's perceived error (least for bumps, most for edges)"
        );
        assert_eq!(verdict([0.5; 5], [1.0; 5]), "ours has 0.50 of FAST's perceived error");
    }

    #[test]
    fn where_it_is_worse_is_said() {
        let some = verdict([0.2, 1.2, 0.3, 0.1, 2.0], [1.0; 5]);
        assert!(
            some.ends_with("least for bumps, most for disks; worse for edges and disks)"),
            "{some}"
        );
        let all = verdict([2.0, 3.0, 2.0, 2.0, 2.0], [1.0; 5]);
        assert!(all.contains("has 2.0–3.0 of") && all.ends_with("; worse for all)"), "{all}");
    }

    #[test]
    fn what_cannot_be_compared_is_not() {
        assert!(verdict([0.1; 5], [0.0; 5]).contains("no error"));
        let text = line(&entry("flat", 2, 4, 0.5), &entry("deep", 3, 4, 0.5));
        assert!(text.contains("other dimensions"), "{text}");
    }
}
