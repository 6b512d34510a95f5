//! What is drawn on a map: lines or dots of one pen, and what the legend says of them.

use super::svg::Pen;

/// Colours that everybody can tell apart: M. Okabe and K. Ito, "Color universal design" (2008).
pub(super) const BLUE: &str = "#0072b2";
pub(super) const VERMILION: &str = "#d55e00";
pub(super) const ORANGE: &str = "#e69f00";
pub(super) const GREEN: &str = "#009e73";
pub(super) const BLACK: &str = "#000";
pub(super) const GREY: &str = "#8c8c8c";

/// A place in metres, seen from above.
pub(crate) type Place = [f64; 2];

/// The marks of a pen.
#[derive(Clone, Debug)]
pub(super) struct Layer {
    pub pen: Pen,
    pub marks: Marks,
    /// For the legend; a layer without one is not in it.
    pub label: Option<String>,
}

/// Where a pen goes.
#[derive(Clone, Debug)]
pub(super) enum Marks {
    Lines(Vec<Vec<Place>>),
    Dots(Vec<Place>),
}

impl Layer {
    pub fn lines(pen: Pen, lines: Vec<Vec<Place>>) -> Self {
        Self { pen, marks: Marks::Lines(lines), label: None }
    }

    pub fn dots(pen: Pen, dots: Vec<Place>) -> Self {
        Self { pen, marks: Marks::Dots(dots), label: None }
    }

    /// With a place in the legend, unless it is empty.
    pub fn labelled(self, label: impl Into<String>) -> Self {
        let label = (self.len() > 0).then(|| label.into());
        Self { label, ..self }
    }

    /// The same, with how many lines or dots there are.
    pub fn counted(self, name: &str) -> Self {
        let count = self.len();
        self.labelled(format!("{name} ({count})"))
    }

    fn len(&self) -> usize {
        match &self.marks {
            Marks::Lines(lines) => lines.len(),
            Marks::Dots(dots) => dots.len(),
        }
    }

    /// Everything that has to be seen.
    pub fn places(&self) -> Box<dyn Iterator<Item = Place> + '_> {
        match &self.marks {
            Marks::Lines(lines) => Box::new(lines.iter().flatten().copied()),
            Marks::Dots(dots) => Box::new(dots.iter().copied()),
        }
    }
}
