//! Scales from numbers to pixels, and the frame with ticks around what they show.

use super::svg::{Anchor, Pen, Pixel, Svg};

/// About how far ticks stand apart, in pixels.
const TICK_SPACING: f64 = 110.0;
const TICK_TEXT: u32 = 15;
/// From so many times its extent on, a range is far from 0.
const FAR: f64 = 1e3;
const LABEL_TEXT: u32 = 17;
const GRID: Pen = Pen { class: "grid", colour: "#e4e4e4", width: 1.0, opacity: 1.0 };

/// A range of numbers laid over a range of pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scale {
    numbers: [f64; 2],
    pixels: [f64; 2],
    logarithmic: bool,
}

impl Scale {
    /// Proportional; an empty range becomes one around its only number.
    pub fn linear(numbers: [f64; 2], pixels: [f64; 2]) -> Self {
        let [low, high] = numbers;
        let numbers = if high > low { numbers } else { [low - 0.5, low + 0.5] };
        Self { numbers, pixels, logarithmic: false }
    }

    /// By powers of ten, from the one below `low` to the one above `high`, both above 0.
    pub fn logarithmic([low, high]: [f64; 2], pixels: [f64; 2]) -> Self {
        let (low, high) = (low.log10().floor(), high.log10().ceil());
        Self { numbers: [low, high.max(low + 1.0)], pixels, logarithmic: true }
    }

    /// Where a number stands.
    pub fn place(&self, x: f64) -> f64 {
        let x = if self.logarithmic { x.log10() } else { x };
        let [low, high] = self.numbers;
        let [from, to] = self.pixels;
        from + (x - low) / (high - low) * (to - from)
    }

    /// What ticks are counted from: 0, or near the range where the range is far off, so that their
    /// text stays short.
    fn origin(&self) -> (f64, String) {
        let [low, high] = self.numbers;
        let (extent, middle) = (high - low, 0.5 * low + 0.5 * high);
        let unit = 10_f64.powf(extent.log10().ceil());
        let origin = (middle / unit).round() * unit;
        let is_far = middle.abs() > FAR * extent && unit > 0.0 && origin.is_finite();
        if self.logarithmic || !is_far {
            return (0.0, String::new());
        }
        let sign = if origin < 0.0 { '+' } else { '-' };
        (origin, format!(" {sign} {}", tick_text(origin.abs(), unit)))
    }

    /// Round numbers within the range, with their text.
    fn ticks(&self) -> Vec<(f64, String)> {
        let [low, high] = self.numbers;
        if self.logarithmic {
            let powers = low as i32..=high as i32;
            return powers.map(|power| (10_f64.powi(power), power_text(power))).collect();
        }
        let length = (self.pixels[1] - self.pixels[0]).abs();
        let step = round_step((high - low) / (length / TICK_SPACING));
        let (origin, _) = self.origin();
        let (first, last) = (((low - origin) / step).ceil(), ((high - origin) / step).floor());
        let count = last - first;
        // Beyond the resolution of the numbers there are no ticks.
        if !(0.0..=100.0).contains(&count) {
            return Vec::new();
        }
        (0..=count as u32)
            .map(|k| (first + f64::from(k)) * step)
            .map(|x| (origin + x, tick_text(x, step)))
            .collect()
    }
}

/// The smallest of 1, 2 and 5 times a power of ten that is no less than `least`.
fn round_step(least: f64) -> f64 {
    let power = 10_f64.powf(least.log10().floor());
    let factors = [1.0, 2.0, 5.0, 10.0];
    power * factors.into_iter().find(|factor| factor * power >= least).unwrap_or(10.0)
}

/// As many decimals as the step has.
fn tick_text(x: f64, step: f64) -> String {
    let x = if x == 0.0 { 0.0 } else { x };
    if x.abs() >= 1e9 || step < 1e-6 {
        return format!("{x:e}");
    }
    let decimals = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{x:.decimals$}")
}

fn power_text(power: i32) -> String {
    if (-4..=4).contains(&power) {
        tick_text(10_f64.powi(power), 10_f64.powi(power))
    } else {
        format!("1e{power}")
    }
}

/// A rectangle of the picture with two scales.
#[derive(Clone, Copy, Debug)]
pub(super) struct Panel {
    pub x: Scale,
    pub y: Scale,
}

impl Panel {
    /// Where a point stands.
    pub fn place(&self, [x, y]: [f64; 2]) -> Pixel {
        [self.x.place(x), self.y.place(y)]
    }

    /// Draws grid, frame, ticks and labels (a name and what stands behind it); what the panel shows
    /// goes on top.
    pub fn draw(&self, svg: &mut Svg, x_label: [&str; 2], y_label: [&str; 2]) {
        let ([left, right], [bottom, top]) = (self.x.pixels, self.y.pixels);
        let columns: Vec<(f64, String)> =
            self.x.ticks().into_iter().map(|(x, text)| (self.x.place(x), text)).collect();
        let rows: Vec<(f64, String)> =
            self.y.ticks().into_iter().map(|(y, text)| (self.y.place(y), text)).collect();
        svg.lines(GRID, columns.iter().map(|(x, _)| [[*x, top], [*x, bottom]]));
        svg.lines(GRID, rows.iter().map(|(y, _)| [[left, *y], [right, *y]]));
        svg.frame([left, top], [right - left, bottom - top]);
        for (x, text) in &columns {
            svg.text([*x, bottom + 21.0], TICK_TEXT, Anchor::Middle, text);
        }
        for (y, text) in &rows {
            svg.text([left - 8.0, y + 5.0], TICK_TEXT, Anchor::End, text);
        }
        let middle = [0.5 * (left + right), 0.5 * (bottom + top)];
        let label = |scale: Scale, [name, rest]: [&str; 2]| {
            let (_, origin) = scale.origin();
            format!("{name}{origin}{rest}")
        };
        let (x_label, y_label) = (label(self.x, x_label), label(self.y, y_label));
        svg.text([middle[0], bottom + 46.0], LABEL_TEXT, Anchor::Middle, &x_label);
        svg.upward_text([left - 84.0, middle[1]], LABEL_TEXT, &y_label);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(scale: Scale) -> Vec<String> {
        scale.ticks().into_iter().map(|(_, text)| text).collect()
    }

    #[test]
    fn ticks_are_round() {
        let pixels = [0.0, 500.0];
        assert_eq!(texts(Scale::linear([-1.2, 9.0], pixels)), ["0", "5"]);
        assert_eq!(texts(Scale::linear([0.0, 1.0], pixels)), ["0.0", "0.5", "1.0"]);
        assert_eq!(texts(Scale::logarithmic([0.02, 3.0], pixels)), ["0.01", "0.1", "1", "10"]);
        assert_eq!(texts(Scale::linear([-2.0, -2.0], pixels)).len(), 3);
    }

    #[test]
    fn far_from_zero_ticks_are_counted_from_near_by() {
        let scale = Scale::linear([3_999_989.5, 4_000_010.5], [0.0, 500.0]);
        assert_eq!(scale.origin(), (4e6, " - 4000000".into()));
        assert_eq!(texts(scale), ["-10", "-5", "0", "5", "10"]);
        assert!(scale.ticks().iter().all(|(x, _)| (x - 4e6).abs() <= 10.0));
        let scale = Scale::linear([-5e5 - 1.0, -5e5 + 1.0], [0.0, 500.0]);
        assert_eq!(scale.origin(), (-5e5, " + 500000".into()));
        assert_eq!(Scale::linear([-40.0, 60.0], [0.0, 500.0]).origin(), (0.0, String::new()));
    }

    #[test]
    fn ranges_that_no_number_resolves_have_few_ticks_or_none() {
        for numbers in [[0.0, f64::MAX], [-f64::MAX, f64::MAX], [1e300, 1e300], [0.0, 5e-324]] {
            assert!(texts(Scale::linear(numbers, [0.0, 500.0])).len() <= 101, "{numbers:?}");
        }
    }

    #[test]
    fn numbers_fall_on_their_pixels() {
        let scale = Scale::linear([0.0, 10.0], [100.0, 0.0]);
        assert_eq!([0.0, 2.5, 10.0].map(|x| scale.place(x)), [100.0, 75.0, 0.0]);
        let scale = Scale::logarithmic([1.0, 100.0], [0.0, 200.0]);
        assert_eq!([1.0, 10.0, 100.0].map(|x| scale.place(x)), [0.0, 100.0, 200.0]);
    }
}
