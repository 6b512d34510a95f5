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
    // Four poses, the closures 3 0 and 0 2, a landmark, no edge of a large residual.
    assert_eq!((count(&svg, "trajectory", 'M'), count(&svg, "trajectory", 'L')), (1, 3));
    assert_eq!((count(&svg, "closures", 'M'), count(&svg, "closures", 'L')), (2, 2));
    assert_eq!(count(&svg, "landmarks", 'h'), 1);
    assert_eq!((count(&svg, "strained", 'M'), count(&svg, "torn", 'M')), (0, 0));
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
    assert_eq!((count(&svg, "closures", 'M'), count(&svg, "poses", 'h')), (0, 0));
    // A range is no loop closure.
    assert_eq!(count(&svg, "others", 'M'), 1);
    assert!(svg.contains("other measurements of two poses (1)") && !svg.contains("loop closures"));
}

/// Every measurement of the file is motion or closure, repeated ones too.
#[test]
fn loop_closures_are_counted_as_simulate_counts_them() {
    let folder = Folder::new();
    let made = folder.run("simulate manhattan --poses 300 --seed 2 --output map.g2o").done();
    let told: usize = made
        .out
        .split(" loop closures")
        .next()
        .unwrap()
        .rsplit(' ')
        .next()
        .unwrap()
        .parse()
        .unwrap();
    assert!(told > 20, "{}", made.out);
    let again = "EDGE_SE2 0 9 1 0 0 1e-9 0 0 1e-9 0 1e-9\n";
    folder.write("more.g2o", &format!("{}{again}{again}", folder.read("map.g2o")));
    for (file, closures) in [("map.g2o", told), ("more.g2o", told + 2)] {
        folder.run(&format!("optimize {file} --plot map.svg")).done();
        let svg = folder.read("map.svg");
        assert_eq!(count(&svg, "closures", 'M'), closures);
        assert!(svg.contains(&format!("loop closures ({closures})")), "{closures}");
    }
}

/// The wrong edge is weak, so that it alone is contradicted.
#[test]
fn edges_of_large_residuals_have_colours() {
    let with = |metres: f64| format!("{SQUARE}EDGE_SE2 0 2 {metres} 1 3.1416 1 0 0 1 0 1\n");
    let folder = Folder::new();
    for (metres, strained, torn) in [(1.0, 0, 0), (8.5, 1, 0), (15.0, 0, 1)] {
        folder.write("square.g2o", &with(metres));
        folder.run("optimize square.g2o --plot map.svg --report out.json").done();
        let svg = folder.read("map.svg");
        let edges = (count(&svg, "strained", 'M'), count(&svg, "torn", 'M'));
        assert_eq!(edges, (strained, torn), "{metres}: {}", folder.json("out.json")["fit"]);
        assert_eq!(svg.contains("edges with residuals of 5 to 10 sigma (1)"), strained == 1);
        assert_eq!(svg.contains("of more than 10 sigma (1)"), torn == 1);
        assert!(svg.contains("loop closures (2)") && svg.contains("per degree of freedom"));
    }
}

#[test]
fn a_reduced_graph_lies_over_the_full_one() {
    let folder = Folder::new();
    folder.run("simulate manhattan --poses 60 --seed 3 --landmarks --output full.g2o").done();
    let remove =
        "remove full.g2o --keep-every 2 --output half.g2o --plot gone.svg --report out.json";
    folder.run(remove).done();
    let removed = folder.json("out.json")["removed"].as_u64().unwrap() as usize;
    assert!(removed > 20);
    folder.run("compare full.g2o half.g2o --plot both.svg").done();
    for name in ["gone.svg", "both.svg"] {
        let svg = folder.read(name);
        assert!(is_well_formed(&svg), "{name}");
        assert_eq!(count(&svg, "removed", 'h'), removed, "{name}");
        assert_eq!(count(&svg, "below", 'L'), 59, "{name}");
        assert_eq!(count(&svg, "trajectory", 'L'), 59 - removed, "{name}");
        for part in ["full graph (60 poses)", "landmarks kept", " m at most", "KLD"] {
            assert!(svg.contains(part), "{part} is not in {name}");
        }
        assert!(svg.contains(&format!("reduced graph ({} poses)", 60 - removed)), "{name}");
        assert!(svg.contains(&format!("nodes removed ({removed})")), "{name}");
    }
    folder.run("remove full.g2o --fraction 0.1 --plot full.g2o").failed(2, &["full.g2o"]);
    folder.run("compare full.g2o half.g2o --plot a.svg --report a.svg").failed(2, &["two of"]);
}

/// The truth is the estimate, turned and moved, but for one pose.
#[test]
fn an_estimate_lies_over_the_truth() {
    let folder = Folder::new();
    let vertices = |at: [[f64; 2]; 4]| -> String {
        let lines = at.iter().enumerate();
        lines.map(|(id, [x, y])| format!("VERTEX_SE2 {id} {x} {y} 0\n")).collect()
    };
    folder.write("map.g2o", &vertices([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.5]]));
    folder.write("truth.g2o", &vertices([[10.0, 5.0], [10.0, 9.0], [6.0, 9.0], [6.0, 5.0]]));
    folder.run("evaluate map.g2o --truth truth.g2o --plot map.svg --report out.json").done();
    let svg = folder.read("map.svg");
    assert!(is_well_formed(&svg), "{svg}");
    assert_eq!((count(&svg, "below", 'L'), count(&svg, "trajectory", 'L')), (3, 3));
    assert_eq!(count(&svg, "shifts", 'M'), 4);
    let furthest = folder.json("out.json")["ate"]["translation"]["max"].as_f64().unwrap();
    let told = svg.split("between pairs, ").nth(1).unwrap().split(' ').next().unwrap();
    assert!((told.parse::<f64>().unwrap() - furthest).abs() < 1e-3 && furthest < 0.5, "{told}");
    for part in ["truth (4 poses)", "estimate (4 poses)", "ATE"] {
        assert!(svg.contains(part), "{part}");
    }
    folder
        .run("evaluate map.g2o --truth truth.g2o --plot truth.svg --report truth.svg")
        .failed(2, &["two of"]);
}
