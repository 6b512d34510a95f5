//! A corpus of broken and odd files: each is refused with one paragraph that names the line or the
//! variables, or, where it still means something, done right. None panics, none hangs.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod common;

use std::fs;
use std::process::Stdio;
use std::thread;
use std::time::{Duration, Instant};

use common::Folder;

/// How the program has to end.
enum End {
    /// Code 1, and these parts in the message.
    Refused(&'static [&'static str]),
    /// Code 0, these parts in the table, and these in the warnings.
    Done(&'static [&'static str], &'static [&'static str]),
}
use End::{Done, Refused};

/// A case: what it is, the file, how it is called (`FILE` stands for it), and how that ends.
type Case = (&'static str, Vec<u8>, &'static str, End);

const I3: &str = "100 0 0 100 0 400";
const I6: &str = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1";

/// Longer than any case takes, also on a busy machine.
const PATIENCE: Duration = Duration::from_secs(60);

fn chain() -> String {
    format!(
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_SE2 2 2 0 0\n\
         EDGE_SE2 0 1 1 0 0 {I3}\nEDGE_SE2 1 2 1 0 0 {I3}\n"
    )
}

fn with(line: &str) -> Vec<u8> {
    format!("{}{line}\n", chain()).into_bytes()
}

#[rustfmt::skip]
fn corpus() -> Vec<Case> {
    let text = |s: String| s.into_bytes();
    let replay = "replay FILE";
    vec![
        // --- Problems that are not determined ---------------------------------------------------
        ("no prior", text(chain()), "replay FILE --prior none",
            Refused(&["connected component of pose 0", "Leave `--prior` out"])),
        ("no prior, all at once", text(chain()), "optimize FILE --prior none",
            Refused(&["connected component of pose 0"])),
        ("an edge of no information", with("VERTEX_SE2 3 3 0 0\nEDGE_SE2 2 3 1 0 0 0 0 0 0 0 0"), replay,
            Refused(&["at pose 3", "3: 3 of 3 directions unconstrained: x, y, theta"])),
        ("an edge that leaves the heading open", with("VERTEX_SE2 3 3 0 0\nEDGE_SE2 2 3 1 0 0 100 0 0 100 0 0"), replay,
            Refused(&["at pose 3", "3: 1 of 3 directions unconstrained: theta"])),
        ("a landmark of no information", with("VERTEX_XY 9 1 1\nEDGE_SE2_XY 1 9 1 1 0 0 0"), replay,
            Done(&["converged"], &["1 landmark", "held back"])),
        ("a landmark seen by one bearing", with("VERTEX_XY 9 1 1\nEDGE_BEARING_SE2_XY 1 9 0.7 400"), replay,
            Done(&["converged"], &["1 landmark", "held back"])),
        ("a landmark seen by two bearings", with("VERTEX_XY 9 1 1\nEDGE_BEARING_SE2_XY 0 9 0.78 400\nEDGE_BEARING_SE2_XY 2 9 2.36 400"), replay,
            Done(&["converged", "variables        ┆ 4"], &[])),
        ("an island", with(&format!("VERTEX_SE2 7 0 5 0\nVERTEX_SE2 8 1 5 0\nEDGE_SE2 7 8 1 0 0 {I3}")), replay,
            Done(&["converged", "on 2 poses, pose 0"], &[])),
        ("an island that nothing holds", with(&format!("VERTEX_SE2 7 0 5 0\nVERTEX_SE2 8 1 5 0\nEDGE_SE2 7 8 1 0 0 {I3}\nFIX 0")), "replay FILE --prior none",
            Refused(&["connected component of pose"])),
        ("a vertex that nothing measures", with("VERTEX_SE2 9 5 5 0"), replay,
            Done(&["converged"], &[])),
        ("landmarks only", b"VERTEX_XY 0 1 1\nVERTEX_XY 1 2 2\n".to_vec(), replay,
            Refused(&["holds no pose"])),

        // --- Numbers ------------------------------------------------------------------------------
        ("NaN in a measurement", with(&format!("EDGE_SE2 0 2 nan 0 0 {I3}")), replay,
            Refused(&["bad.g2o:6", "field 3 (x) of EDGE_SE2 is `nan`", "not finite"])),
        ("an infinite vertex", b"VERTEX_SE2 0 inf 0 0\n".to_vec(), replay,
            Refused(&["bad.g2o:1", "field 2 (x) of VERTEX_SE2 is `inf`"])),
        ("infinite information", with("EDGE_SE2 0 2 2 0 0 1 0 0 inf 0 1"), replay,
            Refused(&["bad.g2o:6", "field 9 (I22)"])),
        ("a word for a number", with(&format!("EDGE_SE2 0 2 two 0 0 {I3}")), replay,
            Refused(&["bad.g2o:6", "`two`", "not a number"])),
        ("negative information", with("EDGE_SE2 0 2 2 0 0 -100 0 0 100 0 400"), replay,
            Refused(&["bad.g2o:6", "information matrix", "not positive semi-definite"])),
        ("indefinite information", with("EDGE_SE2 0 2 2 0 0 1 2 0 1 0 1"), replay,
            Refused(&["bad.g2o:6", "smallest eigenvalue is -1.000e0"])),
        ("a quaternion of no length", text(format!("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 0 0 0 0 0 0 1\nEDGE_SE3:QUAT 0 1 1 0 0 0 0 0 0 {I6}\n")), replay,
            Refused(&["bad.g2o:3", "quaternion", "length zero"])),
        ("a quaternion that is not quite one", text(format!("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 0 0 0 0 0 0 1.1\nEDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 {I6}\n")), replay,
            Done(&["converged"], &["1 quaternions are off unit length", "normalized"])),
        ("numbers that overflow when they are squared", with("EDGE_SE2 0 2 1e200 0 0 1e200 0 0 1e200 0 1e200"), replay,
            Refused(&["bad.g2o:6", "field 3 (x) of EDGE_SE2 is `1e200`", "too large"])),
        ("a measurement that overflows when it is squared", with("EDGE_SE2 0 2 1e200 0 0 1 0 0 1 0 1"), "optimize FILE --elimination qr",
            Refused(&["bad.g2o:6", "too large"])),
        ("a measurement that overflows with its weight", with("EDGE_SE2 0 2 1e50 0 0 1e100 0 0 1 0 1"), replay,
            Refused(&["bad.g2o:6", "`1e50`", "beyond 1e25"])),
        ("a chain that grows beyond all numbers", text(format!("EDGE_SE2 0 1 1.7e308 0 0 {I3}\nEDGE_SE2 1 2 1.7e308 0 0 {I3}\n")), replay,
            Refused(&["bad.g2o:1", "too large"])),
        ("a negative range", with("VERTEX_XY 9 1 1\nFACTOR_RANGE_SE2_XY 1 9 -1 400"), replay,
            Refused(&["bad.g2o:7", "range"])),

        // --- Ids ------------------------------------------------------------------------------------
        ("a duplicate vertex", with("VERTEX_SE2 1 9 9 9"), replay,
            Refused(&["bad.g2o:6", "vertex 1 was given before, in line 2"])),
        ("a missing vertex", with(&format!("EDGE_SE2 2 77 1 0 0 {I3}")), replay,
            Refused(&["bad.g2o:6", "vertex 77 is not in the file"])),
        ("an id beyond 64 bits", with(&format!("EDGE_SE2 2 18446744073709551616 1 0 0 {I3}")), replay,
            Refused(&["bad.g2o:6", "field 2 (to)", "not an id"])),
        ("a negative id", with("VERTEX_SE2 -1 0 0 0"), replay,
            Refused(&["bad.g2o:6", "`-1`", "not an id"])),
        ("the largest id", with(&format!("VERTEX_SE2 18446744073709551615 3 0 0\nEDGE_SE2 2 18446744073709551615 1 0 0 {I3}")), replay,
            Done(&["converged", "steps (poses)    ┆ 4"], &[])),
        ("an edge from a pose to itself", with(&format!("EDGE_SE2 1 1 0 0 0 {I3}")), replay,
            Refused(&["bad.g2o:6", "leads from 1 to itself"])),
        ("a pose used as a landmark", with("EDGE_SE2_XY 0 2 1 1 1 0 1"), replay,
            Refused(&["bad.g2o:6", "2 is used as a 2D landmark"])),
        ("a pose in space among poses in the plane", with(&format!("EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 1 {I6}")), replay,
            Refused(&["bad.g2o:6", "used as a 3D pose"])),
        ("a fixed vertex that is not there", with("FIX 12"), replay,
            Refused(&["bad.g2o:6", "vertex 12 is not in the file"])),
        ("a sensor that is not there", b"VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_TRACKXYZ 1 1 1 1\nEDGE_SE3_TRACKXYZ 0 1 5 1 1 1 1 0 0 1 0 1\n".to_vec(), replay,
            Refused(&["bad.g2o:3", "sensor offset 5 is not in the file", "PARAMS_SE3OFFSET 5"])),
        ("repeated edges", with(&format!("EDGE_SE2 0 1 1 0 0 {I3}\nEDGE_SE2 1 0 -1 0 0 {I3}")), replay,
            Done(&["converged", "factors          ┆ 4"], &[])),

        // --- Lines ----------------------------------------------------------------------------------
        ("a short line", with("EDGE_SE2 0 2 1 0 0 100 0 0"), replay,
            Refused(&["bad.g2o:6", "EDGE_SE2 has 8 fields after the tag, not 11"])),
        ("a long line", with(&format!("EDGE_SE2 0 2 1 0 0 {I3} 7 7")), replay,
            Refused(&["bad.g2o:6", "EDGE_SE2 has 13 fields after the tag, not 11"])),
        ("an unknown tag", with("EDGE_WHATEVER 0 1 2"), replay,
            Refused(&["bad.g2o:6", "`EDGE_WHATEVER`", "leniently"])),
        ("an unknown tag, leniently", with("EDGE_WHATEVER 0 1 2"), "replay FILE --lenient",
            Done(&["converged"], &["1 bad lines were skipped", "EDGE_WHATEVER"])),
        ("two dialects", with(&format!("EDGE2 0 2 1 0 0 {I3}")), replay,
            Refused(&["bad.g2o:6", "another dialect", "g2o since line 1"])),
        ("a file cut in the middle of a line", { let mut all = text(chain()); all.truncate(all.len() - 9); all }, replay,
            Refused(&["bad.g2o:5", "cut off"])),
        ("edges before vertices", text(format!("EDGE_SE2 0 1 1 0 0 {I3}\nVERTEX_SE2 1 1 0 0\nVERTEX_SE2 0 0 0 0\n")), replay,
            Done(&["converged", "steps (poses)    ┆ 2"], &[])),
        ("DOS line ends", text(chain().replace('\n', "\r\n")), replay,
            Done(&["converged", "steps (poses)    ┆ 3"], &[])),
        ("a byte order mark", text(format!("\u{feff}{}", chain())), replay,
            Done(&["converged", "steps (poses)    ┆ 3"], &[])),
        ("blank lines, tabs and comments", text(format!("# made by hand\n\n   \n{}", chain().replace(' ', "\t  "))), replay,
            Done(&["converged", "steps (poses)    ┆ 3"], &[])),
        ("a line of two megabytes", with(&"7 ".repeat(1 << 20)), replay,
            Refused(&["bad.g2o:6", "longer than"])),

        // --- Not text -------------------------------------------------------------------------------
        ("an empty file", Vec::new(), replay, Refused(&["bad.g2o", "no vertex or edge line was found"])),
        ("comments only", b"# nothing\n#\n".to_vec(), replay, Refused(&["no vertex or edge line was found"])),
        ("binary garbage", (0..4096_u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect(), replay,
            Refused(&["bad.g2o:1"])),
        ("NUL bytes", with("EDGE_SE2 0 1 \0\0\0\0"), replay, Refused(&["bad.g2o:6", "NUL bytes"])),
        ("a compressed file", b"\x1f\x8b\x08\x00\x00\x00\x00\x00\x00\x03\xcb\x48\xcd\xc9\xc9\x07\x00".to_vec(), replay,
            Refused(&["bad.g2o: cannot be read"])),
        ("UTF-16", "VERTEX_SE2 0 0 0 0\n".encode_utf16().flat_map(u16::to_le_bytes).collect(), replay,
            Refused(&["bad.g2o:1", "NUL bytes"])),
        ("no file", Vec::new(), "replay nowhere.g2o", Refused(&["nowhere.g2o", "cannot be read"])),
        ("a folder", Vec::new(), "replay .", Refused(&["cannot be read"])),

        // --- Other dialects -----------------------------------------------------------------------
        ("an unusable name", b"VERTEX_SE2 1.0 A0 0 0 0\nVERTEX_SE2 2.0 0A 0 0 0\n".to_vec(), replay,
            Refused(&["bad.g2o:2", "0A"])),
        ("a variance of nothing", b"VERTEX_SE2 1.0 A0 0 0 0\nVERTEX_XY L0 1 1\nEDGE_RANGE 1.0 A0 L0 1.4 0\n".to_vec(), replay,
            Refused(&["bad.g2o:3", "covariance"])),
        ("a TORO matrix in another order", text("VERTEX2 0 0 0 0\nVERTEX2 1 1 0 0\nEDGE2 0 1 1 0 0 100 0 0 100 0 400\n".into()), replay,
            Refused(&["bad.g2o:3", "not positive semi-definite", "another order"])),
    ]
}

#[test]
fn each_broken_file_is_told_from_the_others() {
    let corpus = corpus();
    assert!(corpus.len() >= 25);
    let mut failures = Vec::new();
    for (name, bytes, line, end) in corpus {
        if let Err(problem) = check(&bytes, line, &end) {
            failures.push(format!("{name}: {problem}"));
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

fn check(bytes: &[u8], line: &str, end: &End) -> Result<(), String> {
    let folder = Folder::new();
    fs::write(folder.path("bad.g2o"), bytes).unwrap();
    let before = folder.list();
    let mut child = folder
        .command(&line.replace("FILE", "bad.g2o"))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // What it says fits into the pipes, so that waiting for its end cannot block it.
    let begun = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if begun.elapsed() > PATIENCE {
            child.kill().unwrap();
            return Err("hangs".into());
        }
        thread::sleep(Duration::from_millis(2));
    }
    let output = child.wait_with_output().unwrap();
    let (out, err) =
        (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap());
    let told = format!("code {:?}, {out}{err}", output.status.code());
    let missing = |text: &str, parts: &[&str]| {
        parts.iter().find(|p| !text.contains(**p)).map(|p| p.to_string())
    };
    if err.contains("panicked") || folder.list() != before {
        return Err(told);
    }
    match end {
        Refused(parts) => {
            let one_paragraph = err.starts_with("error: ") && err.trim_end().lines().count() == 1;
            if output.status.code() != Some(1) || !out.is_empty() || !one_paragraph {
                return Err(told);
            }
            missing(&err, parts).map_or(Ok(()), |part| Err(format!("`{part}` is not in {told}")))
        }
        Done(results, warnings) => {
            if output.status.code() != Some(0) || (warnings.is_empty() && !err.is_empty()) {
                return Err(told);
            }
            let part = missing(&out, results).or_else(|| missing(&err, warnings));
            part.map_or(Ok(()), |part| Err(format!("`{part}` is not in {told}")))
        }
    }
}
