//! What a terminal sees: the width of tables, interrupts.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use common::{Folder, SQUARE};

/// The file of `--steps` is begun with the first step and is under a temporary name until the last.
#[cfg(unix)]
#[test]
fn an_interrupt_leaves_no_temporary_files() {
    use std::os::unix::process::ExitStatusExt;
    use std::process::{Command, Stdio};

    let folder = Folder::new();
    folder.run("simulate manhattan --poses 3000 --seed 3 --output map.g2o").done();
    let line = "replay map.g2o --steps steps.csv --relinearize every --relinearize-every 1";
    let mut child =
        folder.command(line).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    // An interrupt is ignored by whatever a shell without job control starts in the background.
    let ignored =
        std::fs::read_to_string(format!("/proc/{}/status", child.id())).ok().and_then(|it| {
            let mask = it.lines().find_map(|line| line.strip_prefix("SigIgn:"))?.trim().to_string();
            Some(u64::from_str_radix(&mask, 16).ok()? & 2 != 0)
        });
    if ignored == Some(true) {
        child.kill().unwrap();
        child.wait().unwrap();
        println!("SKIPPED: interrupts are ignored here");
        return;
    }
    while !folder.list().iter().any(|name| name.ends_with(".tmp")) {
        assert_eq!(child.try_wait().unwrap(), None, "it ended before it could be interrupted");
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    let pid = child.id().to_string();
    assert!(Command::new("kill").args(["-INT", &pid]).status().unwrap().success());
    let status = child.wait().unwrap();
    assert_eq!((status.code(), status.signal()), (Some(130), None));
    assert_eq!(folder.list(), ["map.g2o"]);
}

#[test]
fn tables_fit_eighty_columns() {
    let folder = Folder::with("square.g2o", SQUARE);
    let more = "VERTEX_SE2 4 2 2 0\nEDGE_SE2 3 4 1 0 0.3 100 0 0 100 0 400\n\
                EDGE_SE2 2 4 1 0.1 0.3 100 0 0 100 0 400\n";
    folder.write("five.g2o", &format!("{SQUARE}{more}"));
    folder.write("poor.g2o", &SQUARE.replace("1.05 0 1.56 100", "5.05 0 1.56 100"));
    folder.run("remove five.g2o --fraction 0.2 --output less.g2o").done();
    // Long ids of long kinds, and nothing right about them.
    let key = 8_646_911_284_551_352_321_u64;
    let mut ranges: String =
        (0..9).map(|k| format!("VERTEX_SE3:QUAT {} {k} {} 0 0 0 0 1\n", key + k, k * k)).collect();
    for k in 0..8 {
        let (from, to) = (key + k, key + k + 1);
        ranges += &format!("FACTOR_RANGE_SE3 {from} {to} 77 1\n");
        ranges += &format!("EDGE_SE3_XYZ_PRIOR {from} 5 5 5 1 0 0 1 0 1\n");
        let i = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1";
        ranges += &format!("EDGE_SE3:QUAT {from} {to} 1 0 0 0 0 0 1 {i}\n");
    }
    folder.write("ranges.g2o", &ranges);
    for line in [
        "replay poor.g2o --verbose",
        "replay five.g2o --final-batch=best",
        "optimize poor.g2o --verbose",
        "info five.g2o --verbose",
        "evaluate five.g2o --truth five.g2o",
        "remove five.g2o --fraction 0.2",
        "compare five.g2o less.g2o",
        "audit five.g2o",
        "bench five.g2o",
        "bench five.g2o --batch",
        "optimize ranges.g2o --verbose",
        "info ranges.g2o --convention g2o",
    ] {
        let ran = folder.run(line).done();
        for text in ran.out.lines() {
            assert!(text.chars().count() <= 80, "{line}: {text}");
        }
    }
}
