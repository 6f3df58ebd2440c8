//! Reads a kernel from its text form, whose grammar stands in `spec`; errors point at the place.
//!
//! A plain recursive descent over the characters; it nowhere recurses, so depth is no danger.

use std::fmt;
use std::str::FromStr;

use crate::kernel::prefix::Prefix;
use crate::kernel::spec::{
    ClassKind, ClassSpec, Factor, KernelSpec, MAX_CLASSES, SpecProblem, Truncation, check_weight,
};

/// Why a text is not a kernel, and where.
///
/// Its text has three lines: the problem, the part of the text around it, and a caret below the
/// character meant.
#[derive(Debug, Clone, PartialEq)]
pub struct ParseError {
    /// The whole text.
    pub text: String,
    /// Position in it in bytes, at a character or at its end.
    pub at: usize,
    /// What is wrong there.
    pub problem: SpecProblem,
}

impl std::error::Error for ParseError {}

impl fmt::Display for ParseError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        /// Characters shown on each side of the place.
        const AROUND: usize = 40;
        let (before, after) = self.text.split_at(self.at);
        let column = before.chars().count();
        let shown = |c: char| if c.is_control() { ' ' } else { c };
        let mut excerpt: String = before.chars().skip(column.saturating_sub(AROUND)).collect();
        let caret = excerpt.chars().count();
        excerpt.extend(after.chars().take(AROUND));
        let excerpt: String = excerpt.chars().map(shown).collect();
        writeln!(f, "{} (at character {})", self.problem, column + 1)?;
        writeln!(f, "  {}", excerpt.trim_end())?;
        write!(f, "  {:caret$}^", "")
    }
}

impl FromStr for KernelSpec {
    type Err = ParseError;

    /// Reads the text form.
    fn from_str(text: &str) -> Result<Self, ParseError> {
        let mut parser = Parser { text, at: 0 };
        parser.mixture().map_err(|(at, problem)| ParseError { text: text.to_owned(), at, problem })
    }
}

/// Files hold the text form.
impl TryFrom<String> for KernelSpec {
    type Error = ParseError;

    fn try_from(text: String) -> Result<Self, ParseError> {
        text.parse()
    }
}

/// A problem and its position in bytes.
type Placed = (usize, SpecProblem);

/// A name that may stand in a product, and how it is written.
struct FactorName {
    name: &'static str,
    usage: &'static str,
}

const FACTORS: [FactorName; 12] = [
    FactorName { name: "none", usage: "`none`, without arguments" },
    FactorName {
        name: "gaussian",
        usage: "`gaussian(SIGMA)` or `gaussian(SIGMA, radius=PIXELS)`, in pixels",
    },
    FactorName { name: "box_xy", usage: "`box_xy(PIXELS)`, a whole number of pixels across" },
    FactorName { name: "binomial", usage: "`binomial(N)`, where 2 is 3x3 pixels" },
    FactorName { name: "fovvideovdp", usage: "`fovvideovdp(FPS)`, in frames per second" },
    FactorName { name: "ema", usage: "`ema(ALPHA)`, the weight of the newest frame" },
    FactorName {
        name: "exponential",
        usage: "`exponential(ALPHA)`, the weight of the newest frame",
    },
    FactorName {
        name: "gaussian_t",
        usage: "`gaussian_t(SIGMA)` or `gaussian_t(SIGMA, radius=FRAMES)`, in frames",
    },
    FactorName { name: "binomial_t", usage: "`binomial_t(N)`, where 2 is 3 frames" },
    FactorName { name: "box", usage: "`box(FRAMES)`, a whole number of frames" },
    FactorName { name: "every", usage: "`every(FRAMES)`, a whole number of frames" },
    FactorName { name: "table", usage: "`table(\"FILE.npy\", origin=(T, Y, X))`" },
];

/// One argument of a factor, with its place.
struct Argument<'a> {
    at: usize,
    name: Option<&'a str>,
    value: Value<'a>,
}

enum Value<'a> {
    Number(&'a str),
    Text(String),
    Triple([(usize, &'a str); 3]),
}

struct Parser<'a> {
    text: &'a str,
    at: usize,
}

impl<'a> Parser<'a> {
    fn mixture(&mut self) -> Result<KernelSpec, Placed> {
        let mut classes = Vec::new();
        loop {
            let at = self.skip_blanks();
            if classes.len() == MAX_CLASSES {
                return Err((at, SpecProblem::Classes { classes: MAX_CLASSES + 1 }));
            }
            classes.push(self.class()?);
            if !self.eat('+') {
                break;
            }
        }
        if self.peek().is_some() {
            return Err(self.unexpected("`*`, `@`, `of`, `+` or the end"));
        }
        KernelSpec::new(classes).map_err(|problem| (self.at, problem))
    }

    fn class(&mut self) -> Result<ClassSpec, Placed> {
        let at = self.skip_blanks();
        let mut weight = 1.0;
        if self.peek().is_some_and(|c| c.is_ascii_digit() || matches!(c, '-' | '.')) {
            weight = self.number()?.parse().unwrap_or(f64::NAN);
            check_weight(weight).map_err(|problem| (at, problem))?;
            if !self.eat(':') {
                return Err(self.unexpected("`:` and a kernel after its weight"));
            }
        }
        Ok(ClassSpec { weight, kind: self.kind()?, prefix: self.prefix()? })
    }

    /// `of` and the samples of a pixel, if a class says them.
    fn prefix(&mut self) -> Result<Option<Prefix>, Placed> {
        let at = self.skip_blanks();
        if self.word() != Some("of") {
            self.at = at;
            return Ok(None);
        }
        let at = self.skip_blanks();
        let least = self.count()?;
        let mut prefix = Prefix { least, most: Some(least) };
        let end = self.skip_blanks();
        if self.text[end..].starts_with("..") {
            self.at += 2;
            let has_end = self.peek().is_some_and(|c| c.is_ascii_digit());
            prefix.most = if has_end { Some(self.count()?) } else { None };
        }
        prefix.check().map_err(|problem| (at, problem))?;
        Ok(Some(prefix))
    }

    /// A number of samples, without a sign, a point or an exponent.
    fn count(&mut self) -> Result<u32, Placed> {
        let from = self.skip_blanks();
        let rest = &self.text[from..];
        let length = rest.find(|c: char| !c.is_ascii_digit()).unwrap_or(rest.len());
        if length == 0 {
            return Err(self.unexpected("a number of samples, such as `4`, `1..16` or `1..`"));
        }
        self.at += length;
        // One that does not fit is too large for any tile.
        Ok(rest[..length].parse().unwrap_or(u32::MAX))
    }

    fn kind(&mut self) -> Result<ClassKind, Placed> {
        let at = self.skip_blanks();
        for (name, kind) in [("column", ClassKind::Column), ("frame", ClassKind::Frame)] {
            if self.word() == Some(name) {
                return match self.peek() {
                    Some('*' | '@' | '(') => Err((at, SpecProblem::Alone { name })),
                    _ => Ok(kind),
                };
            }
            self.at = at;
        }
        let mut factors = vec![self.factor()?];
        while self.eat('*') {
            factors.push(self.factor()?);
        }
        let truncation = if self.eat('@') { Some(self.truncation()?) } else { None };
        Ok(ClassKind::Product { factors, truncation })
    }

    fn factor(&mut self) -> Result<Factor, Placed> {
        let at = self.skip_blanks();
        let Some(word) = self.word() else {
            return Err(self.unexpected("a kernel, such as `gaussian(2.1)`"));
        };
        let Some(name) = FACTORS.iter().find(|known| known.name == word) else {
            for name in ["column", "frame"] {
                if word == name {
                    return Err((at, SpecProblem::Alone { name }));
                }
            }
            let names: Vec<&str> = FACTORS.iter().map(|known| known.name).collect();
            let known = format!("{}, column and frame", names.join(", "));
            return Err((at, SpecProblem::Name { name: shortened(word), known }));
        };
        let mut arguments = if self.eat('(') { self.arguments()? } else { Vec::new() };
        let places: Vec<(Option<&str>, usize)> =
            arguments.iter().map(|argument| (argument.name, argument.at)).collect();
        let usage = |at| (at, SpecProblem::Arguments { name: name.name, usage: name.usage });
        let wrong = || usage(at);

        let factor = match name.name {
            "none" => Factor::None,
            "gaussian" | "gaussian_t" => {
                let radius = match take(&mut arguments, Some("radius")) {
                    None => None,
                    Some(argument) => {
                        Some(whole(&argument, "radius", "a whole number from 0 to 8191")?)
                    }
                };
                let sigma = real(take(&mut arguments, None)).ok_or_else(wrong)?;
                match name.name {
                    "gaussian" => Factor::Gaussian { sigma, radius },
                    _ => Factor::GaussianTime { sigma, radius },
                }
            }
            "fovvideovdp" => {
                Factor::FovVideoVdp { fps: real(take(&mut arguments, None)).ok_or_else(wrong)? }
            }
            // Two names of one filter: renderers have the first, FAST's textures the second.
            "ema" | "exponential" => {
                Factor::Ema { alpha: real(take(&mut arguments, None)).ok_or_else(wrong)? }
            }
            "box_xy" => {
                let pixels = take(&mut arguments, None).ok_or_else(wrong)?;
                let rule = "a whole number from 1 to 16384";
                Factor::BoxSpace { pixels: whole(&pixels, "pixels", rule)? }
            }
            "binomial" | "binomial_t" => {
                let n = take(&mut arguments, None).ok_or_else(wrong)?;
                let n = whole(&n, "n", "a whole number from 1 to 512")?;
                match name.name {
                    "binomial" => Factor::Binomial { n },
                    _ => Factor::BinomialTime { n },
                }
            }
            "box" | "every" => {
                let frames = take(&mut arguments, None).ok_or_else(wrong)?;
                let frames = whole(&frames, "frames", "a whole number from 1 to 16384")?;
                if name.name == "box" { Factor::Box { frames } } else { Factor::Every { frames } }
            }
            _ => {
                let origin = take(&mut arguments, Some("origin")).ok_or_else(wrong)?;
                let Value::Triple(numbers) = origin.value else { return Err(usage(origin.at)) };
                let mut origin = [0; 3];
                for (index, (at, number)) in origin.iter_mut().zip(numbers) {
                    let number = Argument { at, name: None, value: Value::Number(number) };
                    *index = whole(&number, "origin", "whole numbers from 0 to 16383")?;
                }
                match take(&mut arguments, None).map(|argument| argument.value) {
                    Some(Value::Text(file)) => Factor::Table { file, origin },
                    _ => return Err(wrong()),
                }
            }
        };
        if let Some(more) = arguments.first() {
            return Err(usage(more.at));
        }
        factor.check().map_err(|problem| {
            // The number meant is the argument of its name, or the one without a name.
            let named = match &problem {
                SpecProblem::Value { name, .. } => Some(*name),
                _ => None,
            };
            let place = places.iter().find(|(name, _)| name.is_some() && *name == named);
            let place = place.or_else(|| places.iter().find(|(name, _)| name.is_none()));
            (place.map_or(at, |&(_, at)| at), problem)
        })?;
        Ok(factor)
    }

    /// What stands between the parentheses, and the closing one.
    fn arguments(&mut self) -> Result<Vec<Argument<'a>>, Placed> {
        let mut arguments = Vec::new();
        if self.eat(')') {
            return Ok(arguments);
        }
        loop {
            let mut at = self.skip_blanks();
            let mut name = None;
            if self.peek().is_some_and(|c| c.is_ascii_alphabetic()) {
                name = self.word();
                if !self.eat('=') {
                    self.at = at;
                    return Err(self.unexpected("a number"));
                }
                at = self.skip_blanks();
            }
            let value = match self.peek() {
                Some('"') => Value::Text(self.quoted()?),
                Some('(') => Value::Triple(self.triple()?),
                _ => Value::Number(self.number()?),
            };
            arguments.push(Argument { at, name, value });
            if self.eat(')') {
                return Ok(arguments);
            }
            if !self.eat(',') {
                return Err(self.unexpected("`,` or `)`"));
            }
        }
    }

    fn triple(&mut self) -> Result<[(usize, &'a str); 3], Placed> {
        let mut numbers = [(0, ""); 3];
        for (number, (open, what)) in
            numbers.iter_mut().zip([('(', "`(`"), (',', "`,`"), (',', "`,`")])
        {
            if !self.eat(open) {
                return Err(self.unexpected(what));
            }
            *number = (self.skip_blanks(), self.number()?);
        }
        if self.eat(')') { Ok(numbers) } else { Err(self.unexpected("`)`")) }
    }

    fn truncation(&mut self) -> Result<Truncation, Placed> {
        const BOX: &str = "a box `WIDTHxHEIGHTxFRAMES` or a share `PERCENT%`";
        self.skip_blanks();
        let mut places = [self.at; 3];
        let mut sizes = [self.number().map_err(|(at, _)| (at, self.unexpected(BOX).1))?; 3];
        let truncation = if self.eat('%') {
            Truncation::Share { percent: sizes[0].parse().unwrap_or(f64::NAN) }
        } else {
            for axis in 1..3 {
                if !self.eat('x') {
                    return Err(self.unexpected(if axis == 1 { "`x` or `%`" } else { "`x`" }));
                }
                places[axis] = self.skip_blanks();
                sizes[axis] = self.number()?;
            }
            let mut lengths = [0; 3];
            for (axis, name) in ["width", "height", "frames"].into_iter().enumerate() {
                let value = Value::Number(sizes[axis]);
                let argument = Argument { at: places[axis], name: None, value };
                lengths[axis] = whole(&argument, name, "a whole number from 1 to 16384")?;
            }
            Truncation::Box { width: lengths[0], height: lengths[1], frames: lengths[2] }
        };
        truncation.check().map_err(|problem| {
            let axis = match &problem {
                SpecProblem::Value { name: "height", .. } => 1,
                SpecProblem::Value { name: "frames", .. } => 2,
                _ => 0,
            };
            (places[axis], problem)
        })?;
        Ok(truncation)
    }

    /// A name: letters, digits and `_`.
    fn word(&mut self) -> Option<&'a str> {
        let at = self.skip_blanks();
        let rest = &self.text[at..];
        let inside = |c: char| c.is_alphanumeric() || c == '_';
        let length = rest.find(|c| !inside(c)).unwrap_or(rest.len());
        self.at += length;
        rest.get(..length).filter(|word| !word.is_empty())
    }

    /// A number as it is written: `[+-] digits [. digits] [e [+-] digits]`.
    fn number(&mut self) -> Result<&'a str, Placed> {
        let from = self.skip_blanks();
        let bytes = self.text.as_bytes();
        let digits = |mut at: usize| {
            while bytes.get(at).is_some_and(u8::is_ascii_digit) {
                at += 1;
            }
            at
        };
        let sign = |at: usize| at + usize::from(matches!(bytes.get(at), Some(b'+' | b'-')));
        let whole = sign(from);
        let mut to = digits(whole);
        let mut some = to > whole;
        if bytes.get(to) == Some(&b'.') {
            let end = digits(to + 1);
            some |= end > to + 1;
            to = end;
        }
        if !some {
            return Err(self.unexpected("a number"));
        }
        if matches!(bytes.get(to), Some(b'e' | b'E')) {
            let exponent = sign(to + 1);
            let end = digits(exponent);
            if end > exponent {
                to = end;
            }
        }
        self.at = to;
        Ok(&self.text[from..to])
    }

    /// A text in double quotes, in which `\"` and `\\` stand for `"` and `\`.
    fn quoted(&mut self) -> Result<String, Placed> {
        let mut text = String::new();
        let mut chars = self.text[self.at..].char_indices().skip(1);
        while let Some((at, c)) = chars.next() {
            match c {
                '"' => {
                    self.at += at + 1;
                    return Ok(text);
                }
                '\\' => match chars.next() {
                    Some((_, escaped @ ('"' | '\\'))) => text.push(escaped),
                    _ => {
                        self.at += at;
                        return Err(self.unexpected("`\\\"` or `\\\\` after a backslash"));
                    }
                },
                c => text.push(c),
            }
        }
        self.at = self.text.len();
        Err(self.unexpected("`\"` at the end of the file's name"))
    }

    /// Goes to the next character that is not blank, and gives its place.
    fn skip_blanks(&mut self) -> usize {
        let rest = &self.text[self.at..];
        self.at += rest.len() - rest.trim_start().len();
        self.at
    }

    fn peek(&mut self) -> Option<char> {
        let at = self.skip_blanks();
        self.text[at..].chars().next()
    }

    fn eat(&mut self, wanted: char) -> bool {
        let found = self.peek() == Some(wanted);
        if found {
            self.at += wanted.len_utf8();
        }
        found
    }

    /// What stands at the place of the parser is not what may stand there.
    fn unexpected(&mut self, expected: &'static str) -> Placed {
        let at = self.skip_blanks();
        let found = match (self.peek(), self.word()) {
            (None, _) => "the end".to_owned(),
            (_, Some(word)) => format!("`{}`", shortened(word)),
            (Some(c), None) => format!("`{}`", c.escape_debug()),
        };
        self.at = at;
        (at, SpecProblem::Unexpected { expected, found })
    }
}

/// As much of a word as a message needs.
fn shortened(word: &str) -> String {
    word.chars().take(40).collect()
}

/// Takes the first argument of that name.
fn take<'a>(arguments: &mut Vec<Argument<'a>>, name: Option<&str>) -> Option<Argument<'a>> {
    let place = arguments.iter().position(|argument| argument.name == name)?;
    Some(arguments.remove(place))
}

fn real(argument: Option<Argument<'_>>) -> Option<f64> {
    match argument?.value {
        Value::Number(text) => text.parse().ok(),
        _ => None,
    }
}

fn whole(argument: &Argument<'_>, name: &'static str, rule: &'static str) -> Result<u32, Placed> {
    let value = match &argument.value {
        Value::Number(text) => match text.parse() {
            Ok(number) => return Ok(number),
            Err(_) => (*text).to_owned(),
        },
        Value::Text(text) => format!("\"{text}\""),
        Value::Triple(_) => "three numbers".to_owned(),
    };
    Err((argument.at, SpecProblem::Value { name, value, rule }))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::kernel::spec::{MAX_BINOMIAL, MAX_LENGTH};

    fn error(text: &str) -> ParseError {
        text.parse::<KernelSpec>().expect_err(text)
    }

    #[test]
    fn the_paper_s_kernel_and_a_column_class_read_as_they_are_meant() {
        let spec: KernelSpec =
            "0.9: gaussian(2.1) * fovvideovdp(60) @ 7x7x8 + 0.1: column".parse().unwrap();
        let factors =
            vec![Factor::Gaussian { sigma: 2.1, radius: None }, Factor::FovVideoVdp { fps: 60.0 }];
        let truncation = Some(Truncation::Box { width: 7, height: 7, frames: 8 });
        let expected = KernelSpec::new(vec![
            ClassSpec {
                weight: 0.9,
                kind: ClassKind::Product { factors, truncation },
                prefix: None,
            },
            ClassSpec { weight: 0.1, kind: ClassKind::Column, prefix: None },
        ]);
        assert_eq!(Ok(spec), expected);
    }

    #[test]
    fn blanks_mean_nothing_and_names_are_read_in_full() {
        for (loose, tight) in [
            (
                "\t gaussian ( 2.1 , radius = 3 )\n* ema( .2 ) @ 7 x 7 x 8 ",
                "gaussian(2.1, radius=3) * ema(0.2) @ 7x7x8",
            ),
            ("2:frame+1e-3:none@50.5%", "2: frame + 0.001: none @ 50.5%"),
            ("gaussian_t(1)*box(3)", "gaussian_t(1) * box(3)"),
            ("box_xy(3)*exponential(.1)", "box_xy(3) * ema(0.1)"),
            ("binomial(2)*binomial_t(4)", "binomial(2) * binomial_t(4)"),
            (
                "table(\"a \\\"b\\\\.npy\", origin=(0,1,2))",
                "table(\"a \\\"b\\\\.npy\", origin=(0, 1, 2))",
            ),
            ("1: gaussian(1e300, radius=0)", "gaussian(1e300, radius=0)"),
            ("3: gaussian(+2)", "3: gaussian(2)"),
        ] {
            let spec: KernelSpec = loose.parse().unwrap();
            assert_eq!(spec.to_string(), tight);
        }
    }

    /// Each nonsense is refused, at the place where it stands, with a word that helps.
    #[test]
    fn nonsense_is_refused_where_it_stands() {
        for (text, place, word) in [
            ("", "", "expected a kernel"),
            ("gaussian(-1)", "-1", "sigma is -1, but must be"),
            ("gaussian(0)", "0)", "sigma is 0"),
            ("gaussian(1e999)", "1e999", "sigma is inf"),
            ("gaussian(nan)", "nan", "expected a number, found `nan`"),
            ("gaussian", "gaussian", "`gaussian(SIGMA)`"),
            ("gaussian()", "gaussian", "`gaussian(SIGMA)`"),
            ("gaussian(1, 2)", "2)", "`gaussian(SIGMA)`"),
            ("gaussian(1, radius=2, radius=3)", "3)", "`gaussian(SIGMA)`"),
            ("gaussian(1, size=2)", "2)", "`gaussian(SIGMA)`"),
            ("gaussian(1, radius=-2)", "-2", "radius is -2"),
            ("gaussian(1, radius=2.5)", "2.5", "radius is 2.5"),
            ("gaussian(1, radius=9000)", "9000", "radius is 9000"),
            ("gaussian(1e9)", "1e9", "more than 16384 pixels"),
            ("gaussian(2.1) trailing", "trailing", "found `trailing`"),
            ("gaussian(2.1) *", "", "expected a kernel"),
            ("gaussian(2.1) + ", "", "expected a kernel"),
            ("gaussian(2.1", "", "`,` or `)`"),
            ("gausian(2.1)", "gausian", "no kernel named `gausian`"),
            (
                "gausian(2.1)",
                "gausian",
                "gaussian_t, binomial_t, box, every, table, column and frame",
            ),
            ("binomial(0)", "0)", "n is 0"),
            ("binomial_t(513)", "513", "n is 513"),
            ("box_xy(2.5)", "2.5", "pixels is 2.5"),
            ("exponential(0)", "0)", "alpha is 0"),
            ("Gaussian(2.1)", "Gaussian", "no kernel named `Gaussian`"),
            ("none(1)", "1)", "without arguments"),
            ("fovvideovdp(4)", "4)", "above 4"),
            ("fovvideovdp(1e6)", "1e6", "at most 65536"),
            ("ema(0)", "0)", "alpha is 0"),
            ("ema(1.01)", "1.01", "alpha is 1.01"),
            ("ema(1e-9)", "1e-9", "more than 16384 frames"),
            ("gaussian_t(1e9)", "1e9", "more than 16384 frames"),
            ("box(0)", "0)", "frames is 0"),
            ("box(1.5)", "1.5", "frames is 1.5"),
            ("box(4294967296)", "4294967296", "frames is 4294967296"),
            ("table(\"k.npy\")", "table", "origin=(T, Y, X)"),
            ("table(\"k.npy\", origin=3)", "3)", "origin=(T, Y, X)"),
            ("table(\"k.npy\", origin=(1,2))", "))", "expected `,`"),
            ("table(\"k.npy\", origin=(1,-2,3))", "-2", "origin is -2"),
            ("table(\"k.npy\", origin=(1,99999,3))", "(1,99999", "origin is 99999"),
            ("table(3, origin=(1,2,3))", "table", "origin=(T, Y, X)"),
            ("table(\"k.npy", "", "expected `\"`"),
            ("table(\"k\\n\")", "\\n", "after a backslash"),
            ("column @ 3x3x3", "column", "stands alone"),
            ("gaussian(1) * frame", "frame", "stands alone"),
            ("gaussian(1) @ 7x7", "", "expected `x`, found the end"),
            ("gaussian(1) @ 7x0x8", "0x8", "height is 0"),
            ("gaussian(1) @ 7x7x99999", "99999", "frames is 99999"),
            ("gaussian(1) @ 0%", "0%", "share is 0"),
            ("gaussian(1) @ 101%", "101", "share is 101"),
            ("gaussian(1) @ all", "all", "PERCENT%"),
            ("gaussian(1) of", "", "a number of samples"),
            ("gaussian(1) of few", "few", "a number of samples"),
            ("gaussian(1) of 0", "0", "samples is 0"),
            ("gaussian(1) of 65", "65", "samples is 65"),
            ("column of 0..4", "0..4", "samples is 0"),
            ("column of 4..2 + frame", "4..2", "samples is 2"),
            ("column of 4 of 2", "of 2", "expected"),
            ("every(0)", "0", "frames is 0"),
            ("0: column", "0:", "weight is 0"),
            ("-1: column", "-1", "weight is -1"),
            ("1e999: column", "1e999", "weight is inf"),
            ("0.5 column", "column", "expected `:`"),
            ("ä(1)", "ä", "no kernel named `ä`"),
            ("gaussian(1) ; \u{7}", "; \u{7}", "found `;`"),
        ] {
            let error = error(text);
            let expected = if place.is_empty() { text.len() } else { text.find(place).unwrap() };
            assert_eq!(error.at, expected, "{text}: {error}");
            assert!(error.to_string().contains(word), "{text}: {error}");
        }
        assert!(error(&vec!["none"; 65].join("+")).to_string().contains("1 to 64"));
    }

    #[test]
    fn prefixes_are_written_with_and_without_blanks() {
        for (text, least, most) in [
            ("none of 4", 4, Some(4)),
            ("none of 1..16", 1, Some(16)),
            ("none of 1 .. 16", 1, Some(16)),
            ("none of 2..", 2, None),
            ("none of\t2 .. + column", 2, None),
        ] {
            let spec: KernelSpec = text.parse().unwrap();
            assert_eq!(spec.classes()[0].prefix, Some(Prefix { least, most }), "{text}");
        }
    }

    #[test]
    fn the_caret_stands_below_the_place() {
        let text = "0.9: gaussian(2.1) * ema(1.5) + column";
        assert_eq!(
            error(text).to_string(),
            "alpha is 1.5, but must be above 0 and at most 1 (at character 26)\n  \
             0.9: gaussian(2.1) * ema(1.5) + column\n                           ^"
        );
        let long = format!("{} * ema(7)", vec!["none"; 100].join("\n*\t"));
        let shown = error(&long).to_string();
        let lines: Vec<&str> = shown.lines().collect();
        assert_eq!(lines.len(), 3);
        assert_eq!(lines[1].chars().nth(lines[2].len() - 1), Some('7'));
    }

    #[test]
    fn limits_in_messages_are_those_of_the_code() {
        assert_eq!((MAX_LENGTH, MAX_BINOMIAL), (16384, 512));
    }

    fn factor() -> impl Strategy<Value = Factor> {
        let sigma = prop_oneof![0.01..10.0, Just(1e-300), Just(0.1 + 0.2)];
        let radius = prop::option::of(0..8192_u32);
        let index = 0..MAX_LENGTH;
        prop_oneof![
            Just(Factor::None),
            (sigma.clone(), radius.clone())
                .prop_map(|(sigma, radius)| Factor::Gaussian { sigma, radius }),
            (sigma, radius).prop_map(|(sigma, radius)| Factor::GaussianTime { sigma, radius }),
            (4.0001..65536.0).prop_map(|fps| Factor::FovVideoVdp { fps }),
            (0.01..=1.0).prop_map(|alpha| Factor::Ema { alpha }),
            (1..=MAX_LENGTH).prop_map(|frames| Factor::Box { frames }),
            (1..=MAX_LENGTH).prop_map(|pixels| Factor::BoxSpace { pixels }),
            (1..=MAX_BINOMIAL).prop_map(|n| Factor::Binomial { n }),
            (1..=MAX_BINOMIAL).prop_map(|n| Factor::BinomialTime { n }),
            (1..=MAX_LENGTH).prop_map(|frames| Factor::Every { frames }),
            (any::<String>(), [index.clone(), index.clone(), index])
                .prop_map(|(file, origin)| Factor::Table { file, origin }),
        ]
    }

    fn class() -> impl Strategy<Value = ClassSpec> {
        let size = 1..=MAX_LENGTH;
        let truncation = prop_oneof![
            (size.clone(), size.clone(), size)
                .prop_map(|(width, height, frames)| { Truncation::Box { width, height, frames } }),
            (1e-12..=100.0).prop_map(|percent| Truncation::Share { percent }),
        ];
        let kind = prop_oneof![
            8 => (prop::collection::vec(factor(), 1..5), prop::option::of(truncation))
                .prop_map(|(factors, truncation)| ClassKind::Product { factors, truncation }),
            1 => Just(ClassKind::Column),
            1 => Just(ClassKind::Frame),
        ];
        let prefix = (1..=64_u32, prop::option::of(0..64_u32)).prop_map(|(least, more)| Prefix {
            least,
            most: more.map(|more| (least + more).min(64)),
        });
        (prop_oneof![1e-9..1e9, Just(1.0)], kind, prop::option::of(prefix))
            .prop_map(|(weight, kind, prefix)| ClassSpec { weight, kind, prefix })
    }

    proptest! {
        #[test]
        fn what_is_printed_reads_as_the_same(classes in prop::collection::vec(class(), 1..4)) {
            let spec = KernelSpec::new(classes).unwrap();
            prop_assert_eq!(spec.to_string().parse::<KernelSpec>(), Ok(spec.clone()));
            let json = serde_json::to_string(&spec).unwrap();
            prop_assert_eq!(serde_json::from_str::<KernelSpec>(&json).unwrap(), spec);
        }

        /// Any text is read or refused with a message; never a panic.
        #[test]
        fn any_text_gets_an_answer(text in any::<String>()) {
            if let Err(error) = text.parse::<KernelSpec>() {
                prop_assert!(error.to_string().lines().count() == 3);
            }
        }

        /// The same for texts that nearly read: a good one with a few characters changed.
        #[test]
        fn damaged_text_gets_an_answer(
            classes in prop::collection::vec(class(), 1..3),
            damage in prop::collection::vec((any::<prop::sample::Index>(), any::<char>()), 1..4),
        ) {
            let text = KernelSpec::new(classes).unwrap().to_string();
            let mut chars: Vec<char> = text.chars().collect();
            for (place, c) in damage {
                *place.get_mut(&mut chars) = c;
            }
            let text: String = chars.into_iter().collect();
            match text.parse::<KernelSpec>() {
                Err(error) => prop_assert!(error.to_string().lines().count() >= 3),
                Ok(spec) => prop_assert_eq!(spec.to_string().parse::<KernelSpec>(), Ok(spec)),
            }
        }
    }
}
