//! `--plot`: the map, and the time of each step, as a picture.
//!
//! The SVG is written here rather than by a plotting library, of which those at hand place points
//! on whole pixels and write an element for each line.

mod axes;
mod layer;
mod map;
pub(crate) mod pictures;
#[cfg(feature = "png")]
mod png;
mod svg;

use std::path::{Path, PathBuf};

use crate::error::Error;
use crate::files;
use crate::steps::StepName;
use axes::{Panel, Scale};
use layer::{BLACK, BLUE, Layer, Marks, VERMILION};
use svg::{Anchor, Pen, Svg};

pub(crate) use map::{Map, Places};
pub(crate) use pictures::Picture;

/// Of the picture, and of its panels, in pixels.
const WIDTH: u32 = 1200;
const LEFT: f64 = 105.0;
const RIGHT: f64 = 1165.0;
const MAP_TOP: f64 = 150.0;
const MAP_BOTTOM: f64 = 1028.0;
const TIMES_TOP: f64 = 1130.0;
const TIMES_BOTTOM: f64 = 1440.0;
/// Below a panel, for its ticks and label.
const BELOW: f64 = 60.0;
/// Room around what the map shows, as a share of its extent.
const MARGIN: f64 = 0.04;

/// A path that names a picture.
#[derive(Clone, Debug)]
pub(crate) struct PlotPath {
    path: PathBuf,
    kind: Kind,
}

#[derive(Clone, Copy, Debug)]
enum Kind {
    Svg,
    #[cfg(feature = "png")]
    Png,
}

impl PlotPath {
    /// For the command line.
    pub fn parse(text: &str) -> Result<Self, String> {
        let path = PathBuf::from(text);
        let extension = path.extension().map(|it| it.to_string_lossy().to_ascii_lowercase());
        let kind = match extension.as_deref() {
            Some("svg") => Kind::Svg,
            #[cfg(feature = "png")]
            Some("png") => Kind::Png,
            #[cfg(not(feature = "png"))]
            Some("png") => {
                return Err(
                    "this program was built without its feature `png` and draws .svg only; \
                            build it with `--features png` for .png"
                        .into(),
                );
            }
            _ => return Err("the extension says which picture: .svg or .png".into()),
        };
        Ok(Self { path, kind })
    }

    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// What a plot shows.
#[derive(Clone, Debug)]
pub(crate) struct Plot {
    /// The name of the file.
    pub title: String,
    /// What the map costs, and in which convention.
    pub subtitle: [String; 2],
    pub map: Picture,
    /// Kind and milliseconds of each step; without it there is no second panel.
    pub times: Option<Vec<(StepName, f64)>>,
}

impl Plot {
    /// Writes the picture, whole or not at all.
    pub fn save(&self, to: &PlotPath) -> Result<(), Error> {
        let svg = self.svg();
        match to.kind {
            Kind::Svg => files::write_text(&to.path, &svg),
            #[cfg(feature = "png")]
            Kind::Png => {
                let failed = |reason| Error::Draw { path: to.path.clone(), reason };
                files::write_bytes(&to.path, &png::draw(&svg).map_err(failed)?)
            }
        }
    }

    fn svg(&self) -> String {
        let bottom = if self.times.is_some() { TIMES_BOTTOM } else { MAP_BOTTOM };
        let mut svg = Svg::new(WIDTH, (bottom + BELOW) as u32);
        svg.text([LEFT, 40.0], 26, Anchor::Start, &self.title);
        svg.text([LEFT, 66.0], 16, Anchor::Start, &self.subtitle[0]);
        svg.text([LEFT, 88.0], 13, Anchor::Start, &self.subtitle[1]);
        self.draw_map(&mut svg);
        if let Some(times) = &self.times {
            draw_times(times, &mut svg);
        }
        svg.finish()
    }

    fn draw_map(&self, svg: &mut Svg) {
        let Picture { layers, in_space } = &self.map;
        let panel = equal_axes(layers.iter().flat_map(Layer::places));
        let view = if *in_space { " [m] (seen from above)" } else { " [m]" };
        panel.draw(svg, ["x", view], ["y", " [m]"]);
        let mut entries = Vec::new();
        for Layer { pen, marks, label } in layers {
            let mut key = *pen;
            match marks {
                Marks::Lines(lines) => {
                    let places = |line: &Vec<[f64; 2]>| {
                        line.iter().map(|&at| panel.place(at)).collect::<Vec<_>>()
                    };
                    svg.lines(*pen, lines.iter().map(places));
                    key.width = pen.width.clamp(2.0, 4.0);
                }
                Marks::Dots(dots) => {
                    svg.dots(*pen, dots.iter().map(|&at| panel.place(at)));
                    key.width = pen.width.max(8.0);
                }
            }
            if let Some(label) = label {
                entries.push((key, label.clone()));
            }
        }
        legend(svg, MAP_TOP - 12.0, entries);
    }
}

/// A panel in which a metre is as long in x as in y, around all points.
fn equal_axes(points: impl Iterator<Item = [f64; 2]>) -> Panel {
    let [x, y] = points.fold([[f64::INFINITY, f64::NEG_INFINITY]; 2], |[x, y], at| {
        [[x[0].min(at[0]), x[1].max(at[0])], [y[0].min(at[1]), y[1].max(at[1])]]
    });
    let (width, height) = (RIGHT - LEFT, MAP_BOTTOM - MAP_TOP);
    let extent = |[low, high]: [f64; 2]| high - low;
    let metres_per_pixel = (extent(x) / width).max(extent(y) / height);
    // Without extent, a metre around the only point there is.
    let metres_per_pixel = if metres_per_pixel > 0.0 { metres_per_pixel } else { 1.0 / height };
    let range = |[low, high]: [f64; 2], pixels: f64| {
        let middle = 0.5 * low + 0.5 * high;
        let half = (0.5 + MARGIN) * pixels * metres_per_pixel;
        [middle - half, middle + half]
    };
    Panel {
        x: Scale::linear(range(x, width), [LEFT, RIGHT]),
        y: Scale::linear(range(y, height), [MAP_BOTTOM, MAP_TOP]),
    }
}

/// Shortest time that a logarithmic scale shows (ms): what clocks resolve.
const SHORTEST: f64 = 1e-4;

fn draw_times(times: &[(StepName, f64)], svg: &mut Svg) {
    let shown = |ms: f64| ms.max(SHORTEST);
    let all = times.iter().map(|(_, ms)| shown(*ms));
    let low = all.clone().fold(f64::INFINITY, f64::min);
    let range = if low.is_finite() { [low, all.fold(low, f64::max)] } else { [0.01, 1.0] };
    let panel = Panel {
        x: Scale::linear([0.0, times.len().max(1) as f64], [LEFT, RIGHT]),
        y: Scale::logarithmic(range, [TIMES_BOTTOM, TIMES_TOP]),
    };
    panel.draw(svg, ["step", ""], ["time of the update", " [ms]"]);
    let mut entries = Vec::new();
    for (name, class, text, colour, width) in [
        (StepName::Explore, "explore", "new ground", BLUE, 2.2),
        (StepName::Loop, "loop", "known ground", VERMILION, 2.6),
        (StepName::Batch, "batch", "batch", BLACK, 5.0),
    ] {
        let of_kind = times.iter().enumerate().filter(|(_, (kind, _))| *kind == name);
        let count = of_kind.clone().count();
        if count > 0 {
            let pen = Pen { class, colour, width, opacity: 0.8 };
            let place = |(step, (_, ms)): (usize, &(StepName, f64))| {
                panel.place([(step + 1) as f64, shown(*ms)])
            };
            svg.dots(pen, of_kind.map(place));
            entries
                .push((Pen { class: "key", width: 8.0, ..pen }, format!("{text} ({count} steps)")));
        }
    }
    legend(svg, TIMES_TOP - 12.0, entries);
}

/// Samples with what they stand for, in rows of which the last is at `y`.
fn legend(svg: &mut Svg, y: f64, entries: Vec<(Pen, String)>) {
    const SIZE: u32 = 15;
    /// Of a letter, about, as a share of the size.
    const ADVANCE: f64 = 0.55;
    const ROW: f64 = 21.0;
    let (mut x, mut row) = (LEFT, 0.0);
    let mut placed = Vec::new();
    for (pen, text) in entries {
        let width = 36.0 + ADVANCE * f64::from(SIZE) * text.chars().count() as f64;
        if x > LEFT && x + width > RIGHT {
            (x, row) = (LEFT, row + 1.0);
        }
        placed.push((x, row, pen, text));
        x += width + 30.0;
    }
    for (x, its_row, pen, text) in placed {
        let y = y - (row - its_row) * ROW;
        let pen = Pen { class: "key", opacity: 1.0, ..pen };
        let middle = y - 5.0;
        if pen.width > 4.0 {
            svg.dots(pen, [[x + 14.0, middle]]);
        } else {
            svg.lines(pen, [[[x, middle], [x + 28.0, middle]]]);
        }
        svg.text([x + 36.0, y], SIZE, Anchor::Start, &text);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_metre_is_as_long_both_ways() {
        let panel = equal_axes([[0.0, 0.0], [100.0, 3.0]].into_iter());
        let [a, b] = [[0.0, 0.0], [1.0, 1.0]].map(|at| panel.place(at));
        assert!((b[0] - a[0] + b[1] - a[1]).abs() < 1e-9, "{a:?} {b:?}");
        for at in [[0.0, 0.0], [100.0, 3.0]].map(|at| panel.place(at)) {
            assert!((LEFT..RIGHT).contains(&at[0]) && (MAP_TOP..MAP_BOTTOM).contains(&at[1]));
        }
    }

    #[test]
    fn nothing_at_all_and_absurd_extents_are_drawn() {
        let pen = Pen { class: "trajectory", colour: BLUE, width: 1.0, opacity: 1.0 };
        let map = |points: &[[f64; 2]]| Picture {
            layers: vec![Layer::lines(pen, vec![points.to_vec()])],
            in_space: false,
        };
        for points in [&[][..], &[[3.0, 4.0]], &[[-1e308, 0.0], [1e308, 1e-300]]] {
            let plot = Plot {
                title: "<&>".into(),
                subtitle: ["".into(), "".into()],
                map: map(points),
                times: Some(Vec::new()),
            };
            let svg = plot.svg();
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{points:?}: {svg}");
            #[cfg(feature = "png")]
            png::draw(&svg).expect("it is a picture");
        }
    }
}
