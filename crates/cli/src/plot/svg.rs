//! The few elements of SVG that a plot is made of.
//!
//! All lines of a kind are one path with a tenth of a pixel of resolution: a graph of 10,000 poses
//! takes some 200 kB, and every viewer draws it at once.

use std::fmt::Write;

/// A place in pixels, y pointing down.
pub(super) type Pixel = [f64; 2];

/// How lines and dots are drawn.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pen {
    /// What is drawn, as the class of its element.
    pub class: &'static str,
    pub colour: &'static str,
    /// Of a line, or the diameter of a dot, in pixels.
    pub width: f64,
    pub opacity: f64,
}

/// Where a text is anchored.
#[derive(Clone, Copy, Debug)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

/// A picture that grows by elements.
#[derive(Debug)]
pub(super) struct Svg(String);

/// Writing to a string cannot fail.
macro_rules! add {
    ($svg:expr, $($part:tt)*) => {{ let _ = write!($svg.0, $($part)*); }};
}

impl Svg {
    /// A white picture.
    pub fn new(width: u32, height: u32) -> Self {
        let mut svg = Self(String::new());
        add!(
            svg,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\" font-family=\"'DejaVu Sans',Verdana,sans-serif\">\n\
             <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
        );
        svg
    }

    /// Draws each line through its points, all of them as one element; what is not finite breaks a
    /// line.
    pub fn lines<L: IntoIterator<Item = Pixel>>(
        &mut self,
        pen: Pen,
        lines: impl IntoIterator<Item = L>,
    ) {
        self.open(pen, "butt");
        for line in lines {
            let mut last = None;
            for at in line {
                let here = tenths(at);
                match (last, here) {
                    (None, Some([x, y])) => add!(self, "M{x} {y}"),
                    // What falls on the same tenth of a pixel cannot be seen.
                    (Some(last), Some(here)) if last == here => {}
                    (Some(_), Some([x, y])) => add!(self, "L{x} {y}"),
                    (_, None) => {}
                }
                last = here;
            }
        }
        self.close();
    }

    /// Draws dots, all of them as one element: lines of no length with round ends.
    pub fn dots(&mut self, pen: Pen, dots: impl IntoIterator<Item = Pixel>) {
        self.open(pen, "round");
        for [x, y] in dots.into_iter().filter_map(tenths) {
            add!(self, "M{x} {y}h0");
        }
        self.close();
    }

    fn open(&mut self, Pen { class, colour, width, opacity }: Pen, cap: &str) {
        add!(
            self,
            "<path class=\"{class}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\" \
             stroke-opacity=\"{opacity}\" stroke-linejoin=\"round\" stroke-linecap=\"{cap}\" d=\""
        );
    }

    fn close(&mut self) {
        self.0.push_str("\"/>\n");
    }

    /// A rectangle without a filling.
    pub fn frame(&mut self, [x, y]: Pixel, [width, height]: [f64; 2]) {
        add!(
            self,
            "<rect x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" fill=\"none\" \
             stroke=\"#333\"/>\n"
        );
    }

    /// A line of text on its base line.
    pub fn text(&mut self, [x, y]: Pixel, size: u32, anchor: Anchor, text: &str) {
        self.label(&format!("x=\"{x:.1}\" y=\"{y:.1}\""), size, anchor, text);
    }

    /// A line of text that reads upwards, centred at a place.
    pub fn upward_text(&mut self, [x, y]: Pixel, size: u32, text: &str) {
        let place = format!("transform=\"translate({x:.1} {y:.1}) rotate(-90)\"");
        self.label(&place, size, Anchor::Middle, text);
    }

    fn label(&mut self, place: &str, size: u32, anchor: Anchor, text: &str) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let text = escaped(text);
        add!(
            self,
            "<text {place} font-size=\"{size}\" text-anchor=\"{anchor}\" fill=\"#222\">{text}</text>\n"
        );
    }

    /// The file's text.
    pub fn finish(mut self) -> String {
        self.0.push_str("</svg>\n");
        self.0
    }
}

/// Rounded to a tenth of a pixel; `None` for what is not finite.
fn tenths(at: Pixel) -> Option<Pixel> {
    // The sum turns -0 into 0.
    let rounded = at.map(|x| (10.0 * x).round() / 10.0 + 0.0);
    rounded.iter().all(|x| x.is_finite()).then_some(rounded)
}

/// Text as XML has it; control characters, which XML cannot hold, become question marks.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            c if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') => out.push('?'),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    const PEN: Pen = Pen { class: "a", colour: "red", width: 1.0, opacity: 1.0 };

    #[test]
    fn lines_of_a_kind_are_one_element() {
        let mut svg = Svg::new(10, 10);
        let nan = [f64::NAN, 0.0];
        svg.lines(PEN, [vec![[0.0, 1.0], [0.01, 1.0], [2.04, 3.06]], vec![[5.0, 5.0], nan]]);
        svg.dots(PEN, [[1.0, 2.0], nan]);
        let text = svg.finish();
        assert!(text.contains("d=\"M0 1L2 3.1M5 5\""), "{text}");
        assert!(text.contains("d=\"M1 2h0\""), "{text}");
    }

    #[test]
    fn text_is_escaped() {
        assert_eq!(escaped("a<b>&\u{1}é"), "a&lt;b&gt;&amp;?é");
    }
}
