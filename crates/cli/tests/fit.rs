//! How well a map fits its measurements.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use common::{Folder, SQUARE, number};

#[test]
fn a_poor_fit_is_told_with_its_worst_edges() {
    let poor = SQUARE.replace("1.05 0 1.56 100", "5.05 0 1.56 100");
    let folder = Folder::with("poor.g2o", &poor);
    for command in ["replay", "optimize"] {
        let ran = folder.run(&format!("{command} poor.g2o --report out.json")).done();
        assert!(ran.out.contains("Poor fit: chi2 per dof is"), "{}", ran.out);
        assert!(ran.out.contains("normalized residual"), "{}", ran.out);
        let fit = &folder.json("out.json")["fit"];
        assert_eq!((&fit["verdict"], &fit["degrees_of_freedom"]), (&"poor".into(), &3.into()));
        let lines: Vec<u64> =
            fit["worst"].as_array().unwrap().iter().filter_map(|it| it["line"].as_u64()).collect();
        assert_eq!(lines.len(), 4);
        assert!(lines.iter().all(|line| (5..=8).contains(line)), "{lines:?}");
        let all = fit["kinds"]["edges to a 2D pose"]["chi2"].as_f64().unwrap();
        assert!((all - number(fit, "chi2")).abs() < 1e-9 * all);
    }
    // From other start values the lines are still the file's.
    folder.run("optimize poor.g2o --init chordal --report out.json").done();
    assert!(folder.json("out.json")["fit"]["worst"][0]["line"].as_u64() >= Some(5));

    let told = folder.run("evaluate poor.g2o --truth poor.g2o --report out.json").done();
    assert!(told.out.contains("Poor fit") && told.out.contains("worst edge"), "{}", told.out);
    assert_eq!(folder.json("out.json")["fit"]["degrees_of_freedom"], 3);

    folder.write("good.g2o", SQUARE);
    let ran = folder.run("replay good.g2o").done();
    assert!(!ran.out.contains("Poor fit") && !ran.out.contains("normalized"), "{}", ran.out);
    assert!(ran.out.contains("worst edge") && ran.out.contains("sigma, line "), "{}", ran.out);
    let ran = folder.run("replay good.g2o --verbose").done();
    assert!(ran.out.contains("normalized residual") && ran.out.contains("count"), "{}", ran.out);
}

/// Sigmas ten times too large: no alarm, but a word on what is made of them.
#[test]
fn a_fit_that_is_too_good_is_mentioned() {
    let folder = Folder::new();
    folder.run("simulate manhattan --poses 100 --seed 3 --output map.g2o").done();
    let weak: String = folder
        .read("map.g2o")
        .lines()
        .map(|line| {
            let words: Vec<&str> = line.split(' ').collect();
            match words.as_slice() {
                ["EDGE_SE2", rest @ ..] => {
                    let [ends, weights] = [&rest[..5], &rest[5..]];
                    let weaker = |it: &&str| (0.01 * it.parse::<f64>().unwrap()).to_string();
                    let weights: Vec<String> = weights.iter().map(weaker).collect();
                    format!("EDGE_SE2 {} {}\n", ends.join(" "), weights.join(" "))
                }
                _ => format!("{line}\n"),
            }
        })
        .collect();
    folder.write("weak.g2o", &weak);
    let ran = folder.run("optimize weak.g2o --report out.json").done();
    assert_eq!(folder.json("out.json")["fit"]["verdict"], "below");
    assert!(ran.out.contains("covariances are") && !ran.out.contains("Poor"), "{}", ran.out);
    assert_eq!(ran.err, "");
}

#[test]
fn names_of_keys_are_printed() {
    let key = |letter: char, at: u64| (u64::from(u32::from(letter)) << 56) + at;
    let mut text = SQUARE.replace("1.05 0 1.56 100", "5.05 0 1.56 100");
    for id in 0..4 {
        text = text.replace(&format!("VERTEX_SE2 {id} "), &format!("VERTEX_SE2 {} ", key('x', id)));
        let next = (id + 1) % 4;
        let names = format!("EDGE_SE2 {} {} ", key('x', id), key('x', next));
        text = text.replace(&format!("EDGE_SE2 {id} {next} "), &names);
    }
    let folder = Folder::with("keys.g2o", &text);
    let ran = folder.run("replay keys.g2o --report out.json").done();
    assert!(ran.out.contains("on pose x0") && ran.out.contains(" x3 x0 "), "{}", ran.out);
    let worst = &folder.json("out.json")["fit"]["worst"][0];
    assert_eq!(worst["ids"].as_array().unwrap().len(), 2);
    assert!(worst["names"][0].as_str().unwrap().starts_with('x'), "{worst}");
    let ran = folder.run("info keys.g2o").done();
    assert!(ran.out.contains("ids x0 to x3"), "{}", ran.out);
}

/// One wrong edge in hundreds leaves chi2 as a whole where it belongs, and is told all the same.
#[test]
fn one_wrong_edge_is_found_in_a_good_fit() {
    let folder = Folder::new();
    folder.run("simulate manhattan --poses 1500 --seed 3 --output map.g2o").done();
    let lines = folder.read("map.g2o").lines().count();
    let wrong = "EDGE_SE2 0 200 15 0 0 0.4 0 0 1e-9 0 1e-9\n";
    folder.write("wrong.g2o", &format!("{}{wrong}", folder.read("map.g2o")));
    let ran = folder.run("optimize wrong.g2o --report out.json").done();
    let fit = &folder.json("out.json")["fit"];
    assert_eq!(fit["worst"][0]["line"].as_u64(), Some(lines as u64 + 1), "{fit}");
    let far = number(&fit["worst"][0], "normalized_residual");
    assert!(far > 10.0, "{far}");
    assert_ne!(fit["verdict"], "poor", "{fit}");
    assert!(ran.out.contains("Largest normalized residuals"), "{}", ran.out);
}
