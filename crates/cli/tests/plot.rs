//! `--plot`.

mod common;

use common::{Folder, SQUARE, TWO_PARTS, sample};

/// The points of the path of a class: how often its data has the command.
#[track_caller]
fn count(svg: &str, class: &str, command: char) -> usize {
    let element = format!("<path class=\"{class}\"");
    assert_eq!(svg.matches(&element).count(), 1, "paths of class {class}");
    let from = svg.find(&element).expect("it was counted");
    let data = svg[from..].split(" d=\"").nth(1).expect("a path has data");
    data.split('"').next().expect("data ends").matches(command).count()
}

/// Whether every element is closed, in order.
fn is_well_formed(xml: &str) -> bool {
    let mut open: Vec<&str> = Vec::new();
    for tag in xml.split('<').skip(1) {
        let Some((tag, _)) = tag.split_once('>') else { return false };
        if tag.matches('"').count() % 2 != 0 {
            return false;
        }
        if let Some(name) = tag.strip_prefix('/') {
            if open.pop() != Some(name) {
                return false;
            }
        } else if !tag.ends_with('/') {
            open.push(tag.split(' ').next().unwrap_or(tag));
        }
    }
    open.is_empty()
}

#[test]
fn a_plot_shows_what_there_is() {
    let folder = Folder::new();
    let seen = format!(
        "{SQUARE}VERTEX_XY 9 2 2\nEDGE_SE2_XY 1 9 1 1 1 0 1\nEDGE_SE2 0 2 1 1 3.1 1 0 0 1 0 1\n"
    );
    folder.write("a & b.g2o", &seen);
    let mut command = folder.command("replay --plot map.svg --report out.json");
    assert!(command.arg("a & b.g2o").output().unwrap().status.success());
    let svg = folder.read("map.svg");
    assert!(is_well_formed(&svg), "{svg}");
    assert!(
        svg.starts_with("<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"1200\" height=\"1500\"")
    );
    // Four poses, the closures 3 0 and 0 2, a landmark.
    assert_eq!((count(&svg, "trajectory", 'M'), count(&svg, "trajectory", 'L')), (1, 3));
    assert_eq!((count(&svg, "closures", 'M'), count(&svg, "closures", 'L')), (2, 2));
    assert_eq!(count(&svg, "landmarks", 'h'), 1);
    // Each step is a dot of one kind or the other.
    assert_eq!((count(&svg, "explore", 'h'), count(&svg, "loop", 'h')), (2, 2));
    let error = folder.json("out.json")["error"].as_f64().unwrap();
    let shown: f64 =
        svg.split("error ").nth(1).unwrap().split(',').next().unwrap().parse().unwrap();
    assert!((shown / error - 1.0).abs() < 1e-6, "{shown} and {error}");
    for part in [
        "a &amp; b.g2o",
        "1/2 sum |r|^2",
        "x [m]",
        "y [m]",
        "trajectory (4 poses)",
        "loop closures (2)",
        "time of the update [ms]",
        "landmarks (1)",
    ] {
        assert!(svg.contains(part), "{part} is not in {svg}");
    }
}

#[test]
fn batches_have_dots_of_their_own() {
    let folder = Folder::with("square.g2o", SQUARE);
    folder.run("replay square.g2o --relinearize-every 2 --plot map.svg").done();
    let svg = folder.read("map.svg");
    assert_eq!((count(&svg, "explore", 'h'), count(&svg, "batch", 'h')), (2, 2));
}

/// Where no measurement ties a pose to the one before it, the line breaks.
#[test]
fn parts_are_lines_of_their_own() {
    let folder = Folder::with("two.g2o", TWO_PARTS);
    folder.run("optimize two.g2o --plot map.svg").done();
    let svg = folder.read("map.svg");
    assert_eq!((count(&svg, "trajectory", 'M'), count(&svg, "trajectory", 'L')), (2, 3));
    assert!(svg.contains("height=\"1088\"") && !svg.contains("[ms]"), "{svg}");
}

#[test]
fn a_map_in_space_is_seen_from_above() {
    let folder = Folder::new();
    folder.run(&format!("optimize {} --plot ball.svg", sample("sphere2500.g2o"))).done();
    let svg = folder.read("ball.svg");
    assert!(svg.contains("x [m] (seen from above)") && is_well_formed(&svg));
    assert!(svg.contains("trajectory (2500 poses)"));
    assert!(svg.len() < 300_000, "{} bytes for 2500 poses", svg.len());
}

#[cfg(not(feature = "png"))]
#[test]
fn a_png_names_the_feature_that_is_missing() {
    let folder = Folder::with("square.g2o", SQUARE);
    folder
        .run("replay square.g2o --plot map.png")
        .failed(2, &["map.png", "feature `png`", "--features png"]);
    assert_eq!(folder.list(), ["square.g2o"]);
}

#[cfg(feature = "png")]
#[test]
fn a_png_is_a_png_of_the_same_size() {
    let folder = Folder::with("square.g2o", SQUARE);
    for (command, height) in [("replay", 1500_u32), ("optimize", 1088)] {
        folder.run(&format!("{command} square.g2o --plot map.PNG --quiet")).done();
        let bytes = std::fs::read(folder.path("map.PNG")).unwrap();
        assert_eq!(&bytes[..8], b"\x89PNG\r\n\x1a\n");
        assert_eq!(&bytes[12..16], b"IHDR");
        let number = |at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap());
        assert_eq!((number(16), number(20)), (1200, height), "{command}");
        assert!(bytes.len() > 10_000, "{command}: {} bytes", bytes.len());
    }
}

#[test]
fn a_plot_that_cannot_be_is_found_before_the_work() {
    let folder = Folder::with("square.g2o", SQUARE);
    for command in ["replay", "optimize"] {
        let line = |plot: &str| format!("{command} square.g2o --output map.g2o --plot {plot}");
        folder.run(&line("map.pdf")).failed(2, &["map.pdf", ".svg or .png"]);
        folder.run(&line("map")).failed(2, &[".svg or .png"]);
        folder.run(&line("none/map.svg")).failed(1, &["none/map.svg", "folder"]);
    }
    assert_eq!(folder.list(), ["square.g2o"]);
}

/// Two robots that drive side by side, in turns, and once measure how far apart they are.
#[test]
fn robots_that_drive_at_once_have_a_line_each() {
    let mut text = String::new();
    for k in 0..5 {
        text += &format!("VERTEX_SE2 {} {k} 0 0\nVERTEX_SE2 {} {k} 3 0\n", 2 * k, 2 * k + 1);
    }
    for k in 2..10 {
        text += &format!("EDGE_SE2 {} {k} 1 0 0 100 0 0 100 0 400\n", k - 2);
    }
    text += "EDGE_PRIOR_SE2 0 0 0 0 9 0 0 9 0 9\nEDGE_PRIOR_SE2 1 0 3 0 9 0 0 9 0 9\n";
    text += "FACTOR_RANGE_SE2 6 7 3 1\n";
    let folder = Folder::with("two.g2o", &text);
    folder.run("replay two.g2o --plot map.svg").done();
    let svg = folder.read("map.svg");
    assert_eq!((count(&svg, "trajectory", 'M'), count(&svg, "trajectory", 'L')), (2, 8));
    assert_eq!((count(&svg, "closures", 'M'), count(&svg, "poses", 'h')), (1, 0));
}
