//! The picture as PNG: the SVG, drawn with the one font that the program brings along.

use std::sync::Arc;

use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::{Options, Tree, fontdb};

/// DejaVu Sans, the glyphs of ASCII and a few signs; licence and origin stand beside it.
const FONT: &[u8] = include_bytes!("../../assets/DejaVuSans-subset.ttf");
const FAMILY: &str = "DejaVu Sans";

/// Draws an SVG; says why where it cannot.
pub(super) fn draw(svg: &str) -> Result<Vec<u8>, String> {
    let mut fonts = fontdb::Database::new();
    fonts.load_font_data(FONT.to_vec());
    let options =
        Options { font_family: FAMILY.into(), fontdb: Arc::new(fonts), ..Options::default() };
    let tree = Tree::from_str(svg, &options).map_err(|error| error.to_string())?;
    let size = tree.size().to_int_size();
    let mut pixels = Pixmap::new(size.width(), size.height())
        .ok_or_else(|| "there is no memory for its pixels".to_string())?;
    resvg::render(&tree, Transform::identity(), &mut pixels.as_mut());
    pixels.encode_png().map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::svg::{Anchor, Svg};

    /// Wherever the program runs: no font of the system is asked for.
    #[test]
    fn text_is_drawn() {
        let empty = Svg::new(200, 50);
        let mut written = Svg::new(200, 50);
        written.text([10.0, 30.0], 20, Anchor::Start, "error 3266.9");
        let [empty, written] = [empty, written].map(|svg| {
            let bytes = draw(&svg.finish()).unwrap();
            let pixels = Pixmap::decode_png(&bytes).unwrap();
            pixels.pixels().iter().filter(|pixel| pixel.red() < 128).count()
        });
        assert_eq!(empty, 0);
        assert!(written > 300, "{written} dark pixels");
    }
}
