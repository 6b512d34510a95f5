//! The layers of each picture: a solved map, a graph and what is left of it, an estimate and the truth.

use std::collections::{BTreeMap, HashMap};

use evergraph::evaluate::{self, Fit, PosePairs, Similarity};
use evergraph::formats::{Trajectory, symbol};
use evergraph::model::{FactorId, Point3};

use super::layer::{BLACK, BLUE, GREEN, GREY, Layer, ORANGE, Place, VERMILION};
use super::map::{EdgeKind, Map, Places};
use super::svg::Pen;
use crate::fit::{STRAINED, TORN};
use crate::table::short;

/// A map and what is drawn on it, from the bottom to the top.
#[derive(Clone, Debug)]
pub(crate) struct Picture {
    pub(super) layers: Vec<Layer>,
    pub(super) in_space: bool,
}

const fn pen(class: &'static str, colour: &'static str, width: f64, opacity: f64) -> Pen {
    Pen { class, colour, width, opacity }
}

/// The poses of a graph.
const TRAJECTORY: Pen = pen("trajectory", BLUE, 1.4, 1.0);
/// A pose that no line leads to.
const LONE: Pen = pen("poses", BLUE, 4.0, 1.0);
const LANDMARKS: Pen = pen("landmarks", GREEN, 5.0, 0.9);
/// What lies below, to be compared with.
const BELOW: Pen = pen("below", GREY, 4.0, 0.6);
const SHIFTS: Pen = pen("shifts", VERMILION, 1.2, 0.8);

/// A map, and in colours how much its measurements contradict it.
pub(crate) fn of_fit(map: &Map, fit: &Fit) -> Picture {
    let residuals: HashMap<FactorId, f64> = fit.residuals.iter().copied().collect();
    let residual = |factor: &FactorId| residuals.get(factor).copied().unwrap_or(0.0);
    let beyond = |range: fn(f64) -> bool| -> Vec<Vec<Place>> {
        let edges = map.edges.iter().filter(|edge| range(residual(&edge.factor)));
        edges.map(|edge| edge.ends.to_vec()).collect()
    };
    let closures = pen("closures", GREY, 1.0, 0.7);
    let others = pen("others", GREEN, 1.0, 0.4);
    let strained = beyond(|it| it > STRAINED && it <= TORN);
    // What is no number contradicts anything.
    let torn = beyond(|it| it > TORN || it.is_nan());
    let (strained_pen, torn_pen) =
        (pen("strained", ORANGE, 2.0, 0.9), pen("torn", VERMILION, 2.0, 0.9));
    let [driven, lone] = trajectory(&map.trajectory, TRAJECTORY, LONE, "trajectory");
    let layers = vec![
        Layer::lines(closures, map.ends_of(EdgeKind::Closure)).counted("loop closures"),
        Layer::lines(others, map.ends_of(EdgeKind::Other))
            .counted("other measurements of two poses"),
        driven,
        lone,
        landmarks(&map.landmarks, LANDMARKS, "landmarks"),
        Layer::lines(strained_pen, strained)
            .counted(&format!("edges with residuals of {STRAINED} to {TORN} sigma")),
        Layer::lines(torn_pen, torn).counted(&format!("of more than {TORN} sigma")),
    ];
    Picture { layers, in_space: map.in_space }
}

/// A graph below what is left of it: its trajectory without the nodes that went, and how far the others
/// moved, `furthest` (m) at most.
pub(crate) fn of_reduction(full: &Map, kept: &Places, furthest: f64) -> Picture {
    let poses = || full.trajectory.iter().flatten();
    let here = |places: &HashMap<u64, Place>, list: &[(u64, Place)]| -> Vec<(u64, Place)> {
        list.iter().filter_map(|(id, _)| Some((*id, *places.get(id)?))).collect()
    };
    let moved = |places: &HashMap<u64, Place>, (id, from): &(u64, Place)| {
        places.get(id).map(|to| vec![*from, *to])
    };
    let mut shifts: Vec<Vec<Place>> = poses().filter_map(|it| moved(&kept.poses, it)).collect();
    shifts.extend(full.landmarks.iter().filter_map(|it| moved(&kept.landmarks, it)));
    let gone = poses().filter(|(id, _)| !kept.poses.contains_key(id));
    let gone_landmarks = full.landmarks.iter().filter(|(id, _)| !kept.landmarks.contains_key(id));
    let gone: Vec<Place> = gone.chain(gone_landmarks).map(|it| it.1).collect();

    let left: Vec<Vec<(u64, Place)>> =
        full.trajectory.iter().map(|line| here(&kept.poses, line)).collect();
    let below_lone = Pen { class: "below-poses", width: 7.0, ..BELOW };
    let [below, below_lone] = trajectory(&full.trajectory, BELOW, below_lone, "full graph");
    let [above, lone] = trajectory(&left, TRAJECTORY, LONE, "reduced graph");
    let layers = vec![
        below,
        below_lone,
        above,
        lone,
        landmarks(&here(&kept.landmarks, &full.landmarks), LANDMARKS, "landmarks kept"),
        Layer::dots(pen("removed", BLACK, 2.6, 0.8), gone).counted("nodes removed"),
        Layer::lines(SHIFTS, shifts).labelled(format!("shifts, {} m at most", short(furthest))),
    ];
    Picture { layers, in_space: full.in_space }
}

/// An estimate laid over the truth by `similarity`, and how far apart the poses of pairs are, `furthest` (m)
/// at most.
pub(crate) fn of_truth(
    [estimate, truth]: [&evaluate::Map; 2],
    pairs: &PosePairs,
    similarity: &Similarity,
    furthest: f64,
) -> Picture {
    let above = |point: Point3| [point.x(), point.y()];
    let laid = |point: Point3| above(similarity.transform_point(&point));
    let apart: Vec<Vec<Place>> = pairs
        .pairs()
        .iter()
        .map(|it| vec![laid(it.estimate.translation()), above(it.truth.translation())])
        .collect();
    let true_lone = Pen { class: "below-poses", width: 7.0, ..BELOW };
    let true_points = Pen { class: "true-landmarks", width: 9.0, ..BELOW };
    let (lines, true_lines) =
        (robots(&estimate.trajectory, laid), robots(&truth.trajectory, above));
    let [below, below_lone] = trajectory(&true_lines, BELOW, true_lone, "truth");
    let [on_top, lone] = trajectory(&lines, TRAJECTORY, LONE, "estimate");
    let true_landmarks: Vec<_> = truth.landmarks.iter().map(|(id, it)| (*id, above(*it))).collect();
    let seen: Vec<_> = estimate.landmarks.iter().map(|(id, it)| (*id, laid(*it))).collect();
    let layers = vec![
        below,
        below_lone,
        Layer::lines(SHIFTS, apart)
            .labelled(format!("between pairs, {} m at most", short(furthest))),
        on_top,
        lone,
        landmarks(&true_landmarks, true_points, "true landmarks"),
        landmarks(&seen, LANDMARKS, "landmarks"),
    ];
    Picture { layers, in_space: !pairs.is_planar() }
}

/// The lines, with the number of all their poses in the legend, and the poses that no line leads to.
fn trajectory(lines: &[Vec<(u64, Place)>], line: Pen, lone: Pen, name: &str) -> [Layer; 2] {
    let poses: usize = lines.iter().map(Vec::len).sum();
    let places = |line: &Vec<(u64, Place)>| line.iter().map(|it| it.1).collect();
    let all: Vec<Vec<Place>> = lines.iter().filter(|it| !it.is_empty()).map(places).collect();
    let alone = all.iter().filter(|line| line.len() == 1).map(|line| line[0]).collect();
    let label = format!("{name} ({poses} poses)");
    [Layer::lines(line, all).labelled(label), Layer::dots(lone, alone)]
}

fn landmarks(places: &[(u64, Place)], pen: Pen, name: &str) -> Layer {
    Layer::dots(pen, places.iter().map(|it| it.1).collect()).counted(name)
}

/// A line for each robot: ids of one robot begin with the same letter.
fn robots(trajectory: &Trajectory, place: impl Fn(Point3) -> Place) -> Vec<Vec<(u64, Place)>> {
    let mut lines: BTreeMap<u64, Vec<(u64, Place)>> = BTreeMap::new();
    for (at, pose) in trajectory.poses().iter().enumerate() {
        let id = trajectory.ids().map_or(at as u64, |ids| ids[at]);
        let robot = symbol(id).map_or(0, |(letter, _)| u64::from(u32::from(letter)));
        lines.entry(robot).or_default().push((id, place(pose.translation())));
    }
    lines.into_values().collect()
}
