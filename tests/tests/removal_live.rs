//! Nodes go while the map is made.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use evergraph::formats::Document;
use evergraph::removal::{Removal, shuffled};
use evergraph::replay::ReplayOptions;
use evergraph::solver::{BatchSettings, Status};
use evergraph::{Replayer, Settings};
use evergraph_tests::{data_file, read, replay};

/// Half of the poses of a park go when they are fifty poses old. The map is then at its optimum all the
/// same: where every removal moved linearization points its error was 3,116, and 3,092 was due.
#[test]
fn a_map_keeps_its_optimum_while_poses_go() {
    let test = "a_map_keeps_its_optimum_while_poses_go";
    let Some(path) = data_file(test, "landmark/victoriaPark.txt") else { return };
    let document = read(&path);
    let poses = poses(&document);
    let goes = |place: &usize| *place > 0 && shuffled(&[false, true], *place as u64)[0];
    let mut waiting = (0..poses.len()).filter(goes).peekable();
    let (mut constant, mut removed) = (0.0, 0);
    let options = ReplayOptions::default();
    let mut replayer = Replayer::new(&document, &options, Settings::default()).unwrap();
    while replayer.step().unwrap().is_some() {
        let spared = [replayer.replay().gauge_priors()[0].factor];
        let newest = replayer.poses();
        while let Some(place) = waiting.next_if(|place| place + 50 < newest) {
            let node = replayer.replay().pose(poses[place]).unwrap();
            let smoother = replayer.smoother_mut();
            let plan =
                Removal::new(smoother.graph(), smoother).sparing(&spared).plan(node).unwrap();
            constant += plan.constant();
            smoother.apply(plan.into_change()).unwrap();
            removed += 1;
        }
    }
    assert!(removed > 3000, "{removed}");
    let live = replayer.smoother().error().unwrap() + constant;
    let report = replayer.smoother_mut().optimize(&BatchSettings::default()).unwrap();
    assert_eq!(report.status, Status::Converged);
    let optimum = report.error + constant;
    assert!(live < 1.001 * optimum, "{live} {optimum}");
    // Of the full graph, `references.json` has it; each constant is of the estimate of its time.
    assert!((optimum - 3092.06).abs() < 5.0, "{optimum}");
}

/// The file's ids of its poses, in the order they come in.
fn poses(document: &Document) -> Vec<u64> {
    let replayer = replay(document, Settings::default(), |_, _| ());
    let all = replayer.replay();
    let mut poses: Vec<_> = all.ids().filter_map(|(id, _)| Some((all.pose(id)?, id))).collect();
    poses.sort_unstable();
    poses.into_iter().map(|(_, id)| id).collect()
}
