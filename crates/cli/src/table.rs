//! Tables for people.

use comfy_table::{Cell, CellAlignment, Table, presets};

/// The convention of `error` and `chi2`, printed beside them.
pub(crate) const CONVENTION: &str =
    "error = 1/2 sum |r|^2 (robust: sum rho), chi2 = sum |r|^2, r = whitened Log(z^-1 xi^-1 xj)";

/// No line is longer, but for names of files.
const WIDTH: usize = 80;
/// Frame and padding of a table of two columns.
const FRAME: usize = 7;

/// Rows of a name and a value under a title.
#[derive(Debug)]
pub(crate) struct Rows {
    title: [String; 2],
    rows: Vec<[String; 2]>,
}

impl Rows {
    pub(crate) fn new(title: &str, value: &str) -> Self {
        Self { title: [title.into(), value.into()], rows: Vec::new() }
    }

    /// A value that is too long for a line goes on in the next.
    pub(crate) fn add(&mut self, name: &str, value: impl ToString) {
        self.rows.push([name.into(), value.to_string()]);
    }
}

impl std::fmt::Display for Rows {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let names = self.rows.iter().chain([&self.title]).map(|[name, _]| name.chars().count());
        let room = WIDTH.saturating_sub(FRAME + names.max().unwrap_or(0));
        let mut table = Table::new();
        table.load_style(presets::UTF8_FULL_CONDENSED);
        table.set_header(&self.title);
        for [name, value] in &self.rows {
            let value = broken(value, room).join("\n");
            table.add_row([Cell::new(name), Cell::new(value).set_alignment(CellAlignment::Left)]);
        }
        table.fmt(f)
    }
}

/// Lines of at most `room` letters, broken at spaces, rather behind a comma; a word is never broken.
pub(crate) fn broken(text: &str, room: usize) -> Vec<String> {
    let mut lines = Vec::new();
    for line in text.lines() {
        let mut rest: Vec<&str> = line.split(' ').collect();
        while !rest.is_empty() {
            let mut length = 0;
            let fits = rest.iter().take_while(|word| {
                length += word.chars().count() + 1;
                length <= room + 1
            });
            let mut count = fits.count().max(1);
            if count < rest.len() {
                let comma = rest[..count].iter().rposition(|word| word.ends_with([',', ';', ':']));
                count = comma.map(|at| at + 1).filter(|at| 2 * at > count).unwrap_or(count);
            }
            lines.push(rest[..count].join(" "));
            rest.drain(..count);
        }
    }
    lines
}

/// Rows of a name and figures under titles.
#[derive(Debug)]
pub(crate) struct Columns(Table);

impl Columns {
    pub(crate) fn new<const N: usize>(titles: [&str; N]) -> Self {
        let mut table = Table::new();
        table.load_style(presets::UTF8_FULL_CONDENSED);
        table.set_header(titles.iter().enumerate().map(|(at, title)| cell(at, title)));
        Self(table)
    }

    pub(crate) fn add<const N: usize>(&mut self, row: [String; N]) {
        self.0.add_row(row.iter().enumerate().map(|(at, text)| cell(at, text)));
    }
}

/// Figures stand under each other.
fn cell(column: usize, text: &str) -> Cell {
    let alignment = if column == 0 { CellAlignment::Left } else { CellAlignment::Right };
    Cell::new(text).set_alignment(alignment)
}

impl std::fmt::Display for Columns {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(f)
    }
}

/// A number for people: ten digits at most, no trailing zeros.
pub(crate) fn number(x: f64) -> String {
    let size = x.abs();
    if x == 0.0 {
        return "0".into();
    }
    if !(1e-4..1e10).contains(&size) {
        return format!("{x:.6e}");
    }
    let digits = (9 - size.log10().floor() as i32).clamp(0, 9) as usize;
    let text = format!("{x:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
}

/// A number of which four digits say enough.
pub(crate) fn short(x: f64) -> String {
    let size = x.abs();
    if x == 0.0 {
        return "0".into();
    }
    if !(1e-4..1e7).contains(&size) {
        return format!("{x:.3e}");
    }
    let digits = (3 - size.log10().floor() as i32).clamp(0, 7) as usize;
    format!("{x:.digits$}")
}

/// Milliseconds in a unit that fits.
pub(crate) fn milliseconds(ms: f64) -> String {
    match ms {
        ms if ms >= 1000.0 => format!("{:.2} s", ms / 1000.0),
        ms if ms >= 1.0 => format!("{ms:.2} ms"),
        ms => format!("{:.1} us", 1000.0 * ms),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_values_go_on_in_the_next_line() {
        let text = "mean 1.5 ms, p50 2.5 ms, p99 12.75 ms";
        assert_eq!(broken(text, 30), ["mean 1.5 ms, p50 2.5 ms,", "p99 12.75 ms"]);
        assert_eq!(broken("a name_that_is_too_long b", 9), ["a", "name_that_is_too_long", "b"]);
        assert_eq!(broken("as it is", 8), ["as it is"]);
        let mut rows = Rows::new("data set", "x.g2o");
        rows.add("a row", text.repeat(4));
        rows.add("nothing", "");
        assert!(rows.to_string().lines().all(|line| line.chars().count() <= WIDTH));
        assert_eq!(rows.to_string().matches("12.75").count(), 4);
    }

    #[test]
    fn four_digits_are_short() {
        let expected =
            [(0.0, "0"), (103.53, "103.5"), (0.927, "0.9270"), (1e9, "1.000e9"), (f64::NAN, "NaN")];
        for (x, text) in expected {
            assert_eq!(short(x), text);
        }
    }

    #[test]
    fn numbers_are_short() {
        let expected = [
            (0.0, "0"),
            (3_266.887_310_142, "3266.88731"),
            (1e-9, "1.000000e-9"),
            (123_456_789.25, "123456789.2"),
            (3.5e12, "3.500000e12"),
            (-0.5, "-0.5"),
            (f64::NAN, "NaN"),
        ];
        for (x, text) in expected {
            assert_eq!(number(x), text);
        }
    }
}
