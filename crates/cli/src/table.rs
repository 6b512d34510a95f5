//! Tables for people.

use comfy_table::{Cell, CellAlignment, Table, presets};

/// The convention of `error` and `chi2`, printed beside them.
pub(crate) const CONVENTION: &str =
    "error = 1/2 sum |r|^2 (robust: sum rho), chi2 = sum |r|^2, r = whitened Log(z^-1 xi^-1 xj)";

/// Rows of a name and a value under a title.
#[derive(Debug)]
pub(crate) struct Rows(Table);

impl Rows {
    pub(crate) fn new(title: &str, value: &str) -> Self {
        let mut table = Table::new();
        table.load_style(presets::UTF8_FULL_CONDENSED);
        table.set_header([title, value]);
        Self(table)
    }

    pub(crate) fn add(&mut self, name: &str, value: impl ToString) {
        self.0.add_row([
            Cell::new(name),
            Cell::new(value.to_string()).set_alignment(CellAlignment::Left),
        ]);
    }
}

impl std::fmt::Display for Rows {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(f)
    }
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
