//! The scores as a table for people.

use perceptile::metric::{Class, Domain, Ratio, ScoredTile, ShownScore};

use super::Evaluation;

/// Characters of a column of numbers.
const COLUMN: usize = 16;
/// Characters of the column of histograms.
const HISTOGRAM: usize = 20;

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
        format!("kernel      {}", report.kernel),
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
        let rows: Vec<(&ScoredTile, Vec<Ratio>)> =
            report.tiles.iter().filter_map(|entry| Some((entry, self.ratios(entry)?))).collect();
        let Some(reference) = report.tiles.iter().find(|entry| entry.name == report.against) else {
            return Vec::new();
        };
        if rows.is_empty() {
            return Vec::new();
        }
        let against = format!("÷ {}", reference.name);
        let label = report
            .tiles
            .iter()
            .map(|entry| &entry.name)
            .chain([&against])
            .map(|name| name.chars().count())
            .max()
            .unwrap_or(0)
            + 2;
        let pairs = if self.domain == Domain::Pairs { ", random pairs of dimensions" } else { "" };
        let mut lines = vec![String::new(), format!("{}{pairs}", self.part.title)];
        let mut heading = " ".repeat(label);
        heading.extend(Class::ALL.map(|class| format!("{class:>COLUMN$}")));
        if self.uniformity {
            heading += &format!("{:>COLUMN$}{:>HISTOGRAM$}", "bias·√N", "histogram (rms)");
            heading += &format!("{:>COLUMN$}", "residual");
        }
        lines.push(heading);
        for (entry, ratios) in rows {
            lines.push(self.row(entry, &ratios, label));
            // Integrands of other dimensions are other integrands: no comparison.
            if entry.name != reference.name && entry.shape.dims() == reference.shape.dims() {
                lines.extend(self.comparison(entry, reference, &against, label));
            }
        }
        lines
    }

    /// The section's score of each class, if the tile has them.
    fn ratios(&self, entry: &ScoredTile) -> Option<Vec<Ratio>> {
        Class::ALL
            .iter()
            .map(|&class| (self.part.ratio)((self.part.scores)(entry).class(class, self.domain)?))
            .collect()
    }

    fn row(&self, entry: &ScoredTile, ratios: &[Ratio], label: usize) -> String {
        let mut row = format!("{:label$}", entry.name);
        for Ratio { mean, standard_error } in ratios {
            row += &format!("{:>COLUMN$}", format!("{mean:.4} ±{standard_error:.4}"));
        }
        if self.uniformity {
            let scores = (self.part.scores)(entry);
            let histogram = scores.histogram;
            let cells = format!(
                "{:.2}–{:.2} ({:.4})",
                histogram.smallest, histogram.largest, histogram.rms
            );
            row += &format!("{:>COLUMN$.2}{cells:>HISTOGRAM$}", scores.bias);
            row += &format!("{:>COLUMN$.2}", scores.residual);
        }
        row
    }

    /// The row below: the tile's scores divided by those of the tile to compare with.
    fn comparison(
        &self,
        entry: &ScoredTile,
        reference: &ScoredTile,
        against: &str,
        label: usize,
    ) -> Option<String> {
        let quotient = |ours: f64, theirs: f64| {
            let quotient = ours / theirs;
            let text = if quotient.is_finite() { format!("{quotient:.3}") } else { "–".into() };
            // Below the numbers, not below their errors.
            format!("{:<COLUMN$}", format!("{text:>7}"))
        };
        let (ours, theirs) = (self.ratios(entry)?, self.ratios(reference)?);
        let mut row = format!("{against:label$}");
        row.extend(ours.iter().zip(&theirs).map(|(a, b)| quotient(a.mean, b.mean)));
        if self.uniformity {
            let (ours, theirs) = ((self.part.scores)(entry), (self.part.scores)(reference));
            let plain = |ours: f64, theirs: f64| quotient(ours, theirs).trim().to_owned();
            row += &format!("{:>COLUMN$}", plain(ours.bias, theirs.bias));
            row += &format!("{:>HISTOGRAM$}", plain(ours.histogram.rms, theirs.histogram.rms));
            row += &format!("{:>COLUMN$}", plain(ours.residual, theirs.residual));
        }
        Some(row.trim_end().to_owned())
    }
}

#[cfg(test)]
mod tests {
    use perceptile::metric::{ClassScore, Histogram, ScoreOptions, Scores};
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
