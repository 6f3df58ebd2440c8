//! The scores as a table for people.

use perceptile::metric::{Class, Domain, Histogram, Ratio, ScoredTile, ShownScore};

use super::Evaluation;

/// Characters of the columns: one for each class, then bias, histogram and residual.
const WIDTHS: [usize; 8] = [16, 16, 16, 16, 16, 16, 20, 16];

/// One block of the table: one score in one domain, a row per tile.
struct TableSection {
    part: ShownScore,
    domain: Domain,
    /// Whether to show the figures of the whole tile.
    uniformity: bool,
}

/// The whole text that the command prints.
pub(super) fn table(report: &Evaluation) -> String {
    let mut lines = vec![
        format!("kernel      {} ({})", report.kernel, report.kernel_origin),
        format!(
            "integrands  {} of each class, set {}; ± is the standard error over them",
            report.options.integrands, report.options.set
        ),
        "scores      mean square over a class, divided by white noise's; lower is better"
            .to_owned(),
    ];
    let domains = report.tiles.iter().map(|entry| Domain::of(entry.shape.dims()));
    let domains = domains.max_by_key(|domains| domains.len()).unwrap_or(&[]);
    for &domain in domains {
        for (place, part) in ShownScore::ALL.into_iter().enumerate() {
            let uniformity = place == 0 && domain == Domain::All;
            lines.extend(TableSection { part, domain, uniformity }.lines(report));
        }
    }
    lines.push(String::new());
    lines.join("\n")
}

impl TableSection {
    /// Heading and rows; nothing if no tile has such a score.
    fn lines(&self, report: &Evaluation) -> Vec<String> {
        let figures = |entry| Some((entry, self.figures(entry)?));
        let rows: Vec<_> = report.tiles.iter().filter_map(figures).collect();
        if rows.is_empty() {
            return Vec::new();
        }
        // The tile to compare with comes first, if not with this score.
        let reference = &report.tiles[0];
        let compared = self.figures(reference);
        let against = format!("÷ {}", reference.name);
        let names = report.tiles.iter().map(|entry| &entry.name).chain([&against]);
        let label = names.map(|name| name.chars().count()).max().unwrap_or(0) + 2;
        let row = |name: &str, cells: &mut dyn Iterator<Item = String>| {
            let cells = cells.zip(WIDTHS).map(|(cell, width)| format!("{cell:>width$}"));
            format!("{name:label$}") + &cells.collect::<String>()
        };
        let pairs = if self.domain == Domain::Pairs { ", random pairs of dimensions" } else { "" };
        let mut lines = vec![String::new(), format!("{}{pairs}", self.part.title)];
        let mut heading = Class::ALL.map(|class| class.to_string()).to_vec();
        if self.uniformity {
            heading.extend(["bias·√N", "histogram (rms)", "residual"].map(String::from));
        }
        lines.push(row("", &mut heading.into_iter()));
        for (entry, figures) in &rows {
            lines.push(row(&entry.name, &mut figures.iter().map(|(text, _)| text.clone())));
            // Integrands of other dimensions are other integrands: no comparison.
            if let Some(compared) = &compared
                && entry.name != reference.name
                && entry.shape.dims() == reference.shape.dims()
            {
                let pairs = figures.iter().zip(compared).enumerate();
                let mut quotients = pairs.map(|(at, ((_, a), (_, b)))| quotient(at, a / b));
                lines.push(row(&against, &mut quotients).trim_end().to_owned());
            }
        }
        lines
    }

    /// What the section shows of a tile, if it has such a score: each cell, and its number that is
    /// compared.
    fn figures(&self, entry: &ScoredTile) -> Option<Vec<(String, f64)>> {
        let scores = (self.part.scores)(entry);
        let of_class = |&class: &Class| {
            let Ratio { mean, standard_error } =
                (self.part.ratio)(scores.class(class, self.domain)?)?;
            Some((format!("{mean:.4} ±{standard_error:.4}"), mean))
        };
        let mut figures: Vec<_> = Class::ALL.iter().map(of_class).collect::<Option<_>>()?;
        if self.uniformity {
            let Histogram { smallest, largest, rms } = scores.histogram;
            figures.push((format!("{:.2}", scores.bias), scores.bias));
            figures.push((format!("{smallest:.2}–{largest:.2} ({rms:.4})"), rms));
            figures.push((format!("{:.2}", scores.residual), scores.residual));
        }
        Some(figures)
    }
}

/// A column's cell in the row below: the tile's number divided by that of the tile to compare with.
fn quotient(column: usize, quotient: f64) -> String {
    let text = if quotient.is_finite() { format!("{quotient:.3}") } else { "–".into() };
    if column >= Class::ALL.len() {
        return text;
    }
    // Below the numbers of the class, not below their errors.
    format!("{:<1$}", format!("{text:>7}"), WIDTHS[column])
}

#[cfg(test)]
mod tests {
    use perceptile::metric::{ClassScore, ScoreOptions, Scores};
    use perceptile::tile::TileShape;

    use super::*;

    /// A tile whose every score is `level`, its bias and residual half of it.
    fn entry(name: &str, dims: usize, frames: usize, level: f64) -> ScoredTile {
        let shape = TileShape::new(8, 8, frames, 1, dims).unwrap();
        let ratio = Ratio { mean: level, standard_error: level / 100.0 };
        let classes = Domain::of(dims)
            .iter()
            .flat_map(|&domain| Class::ALL.map(|class| (class, domain)))
            .map(|(class, domain)| ClassScore {
                class,
                domain,
                perceived: ratio,
                half_period: (frames > 1).then_some(ratio),
                whole_period: ratio,
                whole_period_perceived: None,
                bias: level,
            })
            .collect();
        let scores = Scores {
            options: ScoreOptions::default(),
            classes,
            bias: level / 2.0,
            histogram: Histogram { smallest: 0.9, largest: 1.1, rms: level / 10.0 },
            residual: level / 2.0,
        };
        ScoredTile {
            name: name.into(),
            path: None,
            shape,
            after_8_bits: scores.clone(),
            after_16_bits: scores.clone(),
            scores,
            spectra: None,
        }
    }

    fn text(tiles: Vec<ScoredTile>) -> String {
        let against = tiles[0].name.clone();
        table(&Evaluation {
            kernel: "none".into(),
            kernel_origin: "the default".into(),
            options: ScoreOptions::default(),
            against,
            tiles,
        })
    }

    #[test]
    fn rows_align_and_compare_with_the_first_tile() {
        let text = text(vec![entry("stbn", 2, 4, 0.5), entry("ours", 2, 4, 0.1)]);
        let lines: Vec<&str> = text.lines().collect();
        let first = lines.iter().position(|line| *line == "perceived error").unwrap();
        let [heading, stbn, ours, comparison] = lines[first + 1..first + 5] else { panic!() };
        assert!(heading.ends_with("residual"));
        assert_eq!(heading.chars().count(), stbn.chars().count());
        assert_eq!(stbn.chars().count(), ours.chars().count());
        assert!(ours.contains("0.1000 ±0.0010") && ours.contains("0.90–1.10 (0.0100)"), "{ours}");
        assert!(comparison.starts_with("÷ stbn") && comparison.matches("0.200").count() == 8);
        let place = |line: &str, word: &str| {
            line.char_indices().position(|(byte, _)| line[byte..].starts_with(word)).unwrap()
        };
        assert_eq!(place(ours, "0.1000"), place(comparison, "0.200"));
        // No tile has the last kind of score.
        assert!(!text.contains("perceived\n") && text.contains("mean of half a period"));
    }

    #[test]
    fn tiles_of_other_dimensions_are_not_compared() {
        let text = text(vec![entry("flat", 2, 1, 0.5), entry("deep", 3, 4, 0.1)]);
        assert!(!text.contains('÷'));
        let pairs: Vec<&str> =
            text.lines().skip_while(|line| !line.contains("random pairs")).collect();
        assert!(pairs.iter().any(|line| line.starts_with("deep")));
        assert!(!pairs.iter().any(|line| line.starts_with("flat")));
        // A tile of one frame has no half period.
        let half: Vec<&str> =
            text.lines().skip_while(|line| !line.contains("half")).skip(2).take(2).collect();
        assert!(half[0].starts_with("deep") && half[1].is_empty(), "{half:?}");
    }

    #[test]
    fn nothing_divided_by_nothing_is_a_dash() {
        let text = text(vec![entry("zero", 2, 1, 0.0), entry("also", 2, 1, 0.0)]);
        assert!(text.contains('–') && !text.contains("NaN"), "{text}");
    }
}
