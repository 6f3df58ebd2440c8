//! The scores as a table for people.

use perceptile::metric::{Class, Coordinates, Histogram, ScoredTile, ShownScore, figure, ratio};

use super::{Evaluation, verdict};

/// Spaces between two columns.
const GAP: usize = 3;

/// One block of the table: one score over all coordinates or pairs of them, a row per tile.
struct TableSection {
    part: ShownScore,
    coordinates: Coordinates,
    /// Whether to show the figures of the whole tile.
    uniformity: bool,
}

/// The whole text that the command prints: the first table and what it comes to, or `all` tables.
pub(super) fn table(report: &Evaluation, all: bool) -> String {
    let against = &report.against;
    let mut lines = vec![
        format!("kernel      {} ({})", report.kernel, report.kernel_origin),
        format!(
            "integrands  {} of each class, set {}; ± is the standard error over them",
            report.options.integrands, report.options.set
        ),
        "scores      mean square error over a class; lower is better".to_owned(),
        "            1 is white noise that is new in every frame; a tile repeats, and a kernel longer \
         than it is folded at its period"
            .to_owned(),
    ];
    if report.tiles.len() > report.parts {
        lines.push(format!("÷ {against}  the ratio to {against}: 2 means twice its error"));
    }
    let columns =
        report.tiles.iter().map(|entry| Coordinates::of(report.options.domain, entry.shape.dims()));
    let columns = columns.max_by_key(|columns| columns.len()).unwrap_or(&[]);
    let mut left_out = 0;
    for &coordinates in columns {
        for (place, part) in ShownScore::ALL.into_iter().enumerate() {
            let is_first = place == 0 && coordinates == Coordinates::All;
            let section = TableSection { part, coordinates, uniformity: is_first }.lines(report);
            if all || is_first {
                lines.extend(section);
            } else if !section.is_empty() {
                left_out += 1;
            }
        }
    }
    let verdict = verdict::lines(report);
    lines.extend((!verdict.is_empty()).then(String::new));
    lines.extend(verdict);
    if left_out > 0 {
        let rest = "after 8 and 16 bits, and means over a period";
        lines.push(format!("\n--all shows {left_out} more tables: {rest}"));
    }
    lines.push(String::new());
    lines.join("\n")
}

/// A cell of a row, and its number that is compared.
type Cell = (String, f64);

impl TableSection {
    /// Heading and rows; nothing if no tile has such a score.
    fn lines(&self, report: &Evaluation) -> Vec<String> {
        let figures = |(place, entry)| Some((place, entry, self.figures(entry)?));
        let rows: Vec<_> = report.tiles.iter().enumerate().filter_map(figures).collect();
        if rows.is_empty() {
            return Vec::new();
        }
        let classes = Class::of(report.options.domain);
        let mut heading: Vec<String> = classes.iter().map(Class::to_string).collect();
        if self.uniformity {
            heading.extend(["bias·√N", "histogram (rms)", "residual"].map(String::from));
        }
        let mut lines = vec![[vec![String::new()], heading].concat()];
        for (place, entry, figures) in &rows {
            let cells = figures.iter().map(|(text, _)| text.clone());
            let is_repeated = report.is_repeated_noise(entry);
            let name = match is_repeated {
                true => format!("{}, {} frames repeated", entry.name, entry.shape.frames()),
                false => entry.name.clone(),
            };
            lines.push([name].into_iter().chain(cells).collect());
            // Integrands of other dimensions are other integrands: no comparison.
            if let Some(reference) = report.reference(*place)
                && let Some(compared) = self.figures(reference)
                && !is_repeated
                && entry.shape.dims() == reference.shape.dims()
            {
                let pairs = figures.iter().zip(&compared);
                let quotients = pairs.map(|(theirs, ours)| quotient(theirs, ours));
                lines
                    .push([format!("÷ {}", reference.name)].into_iter().chain(quotients).collect());
            }
        }
        let pairs = if self.coordinates == Coordinates::Pairs {
            ", random pairs of dimensions"
        } else {
            ""
        };
        let title = [String::new(), format!("{}{pairs}", self.part.title)];
        title.into_iter().chain(aligned(&lines)).collect()
    }

    /// What the section shows of a tile, if it has such a score.
    fn figures(&self, entry: &ScoredTile) -> Option<Vec<Cell>> {
        let scores = (self.part.scores)(entry);
        let of_class = |&class: &Class| {
            let score = (self.part.ratio)(scores.class(class, self.coordinates)?)?;
            Some((ratio(score), score.mean))
        };
        let classes = Class::of(scores.options.domain);
        let mut figures: Vec<_> = classes.iter().map(of_class).collect::<Option<_>>()?;
        if self.uniformity {
            let Histogram { smallest, largest, rms } = scores.histogram;
            figures.push((figure(scores.bias), scores.bias));
            figures.push((format!("{smallest:.2}–{largest:.2} ({})", figure(rms)), rms));
            figures.push((figure(scores.residual), scores.residual));
        }
        Some(figures)
    }
}

/// The cell below `theirs`: its number divided by that of the tile to compare with. What stands before
/// an error is divided, so the quotient ends where that ends.
fn quotient(theirs: &Cell, ours: &Cell) -> String {
    let quotient = theirs.1 / ours.1;
    let text = if quotient.is_finite() { figure(quotient) } else { "–".into() };
    let error = theirs.0.find(" ±").map_or(0, |at| theirs.0[at..].chars().count());
    text + &" ".repeat(error)
}

/// Rows with their columns below each other, the first to the left and the others to the right.
fn aligned(rows: &[Vec<String>]) -> Vec<String> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let widths: Vec<usize> = (0..columns)
        .map(|column| {
            rows.iter().filter_map(|row| row.get(column)).map(|it| it.chars().count()).max()
        })
        .map(|width| width.unwrap_or(0))
        .collect();
    let row = |cells: &Vec<String>| {
        let mut text = format!("{:1$}", cells[0], widths[0]);
        for (cell, width) in cells.iter().zip(&widths).skip(1) {
            text += &format!("{cell:>0$}", width + GAP);
        }
        text.trim_end().to_owned()
    };
    rows.iter().map(row).collect()
}

#[cfg(test)]
pub(super) mod tests {
    use perceptile::domain::Domain;
    use perceptile::metric::{ClassScore, Ratio, ScoreOptions, Scores};
    use perceptile::tile::TileShape;

    use super::*;

    /// A tile whose every score is `level`, its bias and residual half of it.
    pub fn entry(name: &str, dims: usize, frames: usize, level: f64) -> ScoredTile {
        let shape = TileShape::new(8, 8, frames, 1, dims).unwrap();
        let ratio = Ratio { mean: level, standard_error: level / 100.0 };
        let classes = Coordinates::of(Domain::Square, dims)
            .iter()
            .flat_map(|&coordinates| Class::ALL.map(|class| (class, coordinates)))
            .map(|(class, coordinates)| ClassScore {
                class,
                coordinates,
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
        of(tiles, true)
    }

    fn of(tiles: Vec<ScoredTile>, all: bool) -> String {
        of_parts(tiles, 1, all)
    }

    fn of_parts(tiles: Vec<ScoredTile>, parts: usize, all: bool) -> String {
        let against = tiles[0].name.clone();
        let evaluation = Evaluation {
            kernel: "none".into(),
            kernel_origin: "the default".into(),
            kernel_frames: 8,
            options: ScoreOptions::default(),
            against,
            parts,
            tiles,
        };
        table(&evaluation, all)
    }

    #[test]
    fn parts_are_compared_with_the_same_part_of_the_first_tile() {
        let tiles =
            [("a-first-1", 0.1), ("a-first-2", 0.05), ("b-first-1", 0.2), ("b-first-2", 0.2)];
        let tiles = || tiles.map(|(name, level)| entry(name, 2, 8, level));
        let text = of_parts(tiles().into(), 2, false);
        for (against, quotient, verdict) in [
            ("÷ a-first-1", "2.00", "a-first-1 has 0.50 of b-first-1's perceived error"),
            ("÷ a-first-2", "4.00", "a-first-2 has 0.25 of b-first-2's perceived error"),
        ] {
            let line =
                |line: &&str| line.starts_with(against) && line.matches(quotient).count() > 4;
            assert_eq!(text.lines().filter(line).count(), 1, "{text}");
            assert!(text.lines().any(|line| line == verdict), "{text}");
        }
        // One tile's parts are not compared with each other.
        let alone = of_parts(tiles()[..2].to_vec(), 2, false);
        assert!(!alone.contains('÷') && !alone.contains("perceived error of"), "{alone}");
    }

    #[test]
    fn the_first_table_comes_with_a_verdict_and_the_others_on_request() {
        let tiles = || vec![entry("ours", 2, 4, 0.1), entry("stbn", 2, 4, 0.5)];
        let (first, all) = (of(tiles(), false), of(tiles(), true));
        let verdict = "ours has 0.20 of stbn's perceived error";
        for text in [&first, &all] {
            assert!(text.lines().any(|line| line == verdict), "{text}");
            assert!(
                text.contains("2 means twice its error") && text.contains("new in every frame")
            );
        }
        let tables = |text: &str| text.matches("axis edge").count();
        assert_eq!((tables(&first), tables(&all)), (1, 5));
        assert!(first.contains("--all shows 4 more tables") && !all.contains("--all"), "{first}");
        let alone = of(vec![entry("ours", 2, 4, 0.1)], false);
        assert!(!alone.contains('÷') && !alone.contains("perceived error of"), "{alone}");
    }

    #[test]
    fn white_noise_that_repeats_within_the_kernel_is_named_so_and_not_compared() {
        let mut white = entry("white", 2, 4, 1.3);
        let compared =
            |white: &ScoredTile| of(vec![entry("ours", 2, 4, 0.1), white.clone()], false);
        white.path = Some("white.npy".into());
        assert!(!compared(&white).contains("repeated") && compared(&white).contains("of white's"));
        white.path = None;
        let text = compared(&white);
        assert!(text.lines().any(|line| line.starts_with("white, 4 frames repeated")), "{text}");
        assert!(text.contains("compare with 1") && !text.contains("of white's"), "{text}");
        let quotients = text.lines().filter(|line| line.starts_with("÷ ours"));
        assert_eq!(quotients.count(), 1, "only the line that explains them: {text}");
        // As long as the kernel, it is as good as new.
        let mut long = entry("white", 2, 8, 1.0);
        long.path = None;
        assert!(!compared(&long).contains("repeated"));
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
        assert!(ours.contains("0.100 ±0.001") && ours.contains("0.90–1.10 (0.0100)"), "{ours}");
        assert!(comparison.starts_with("÷ stbn") && comparison.matches("0.200").count() == 8);
        let place = |line: &str, word: &str| {
            line.char_indices().position(|(byte, _)| line[byte..].starts_with(word)).unwrap()
        };
        assert_eq!(place(ours, "0.100"), place(comparison, "0.200"));
        // No tile has the last kind of score.
        assert!(!text.contains("perceived\n") && text.contains("mean of half a period"));
    }

    #[test]
    fn tiles_of_other_dimensions_are_not_compared() {
        let text = text(vec![entry("flat", 2, 1, 0.5), entry("deep", 3, 4, 0.1)]);
        assert!(text.contains("other dimensions than flat: not compared"), "{text}");
        assert_eq!(text.lines().filter(|line| line.starts_with('÷')).count(), 1);
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
