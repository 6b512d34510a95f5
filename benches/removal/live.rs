//! Half of the poses, chosen at random, go while the map is made, fifty poses after they came in.

use std::collections::{BTreeSet, HashMap};
use std::time::Instant;

use evergraph::formats::{Document, Record};
use evergraph::model::VariableId;
use evergraph::removal::{Removal, shuffled};
use evergraph::{Replayer, optimize_to_the_end};
use rayon::prelude::*;

use crate::{Failure, divergence, gauge, optimum, read, replayer, short};

const SEED: u64 = 1;
/// Poses between the newest and the one that goes.
const LAG: usize = 50;

/// Maps each file.
pub fn run(files: &[&str]) -> Result<bool, Failure> {
    println!(
        "| graph | poses | removed | error at the end of mapping | optimized | full graph | KLD covariance | \
         KLD mean | shift, rms m | max m |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    let rows: Vec<Result<String, Failure>> = files.par_iter().map(|file| row(file)).collect();
    for row in rows {
        println!("{}", row?);
    }
    Ok(true)
}

fn row(file: &str) -> Result<String, Failure> {
    let document = read(file)?;
    let poses = poses(&document)?;
    // The first holds the map.
    let mut gone = shuffled(&poses[1..], SEED);
    gone.truncate(poses.len() / 2);
    let gone: BTreeSet<u64> = gone.into_iter().collect();
    let document = without_late(&document, &poses, &gone)?;
    let (full, _) = optimum(&document)?;

    let begun = Instant::now();
    let mut reduced = replayer(&document)?;
    let (removed, constant) = map(&mut reduced, &poses, &gone)?;
    eprintln!("{}: {:.1} s", short(file), begun.elapsed().as_secs_f64());
    let live = reduced.smoother().error()? + constant;
    let optimized = optimize_to_the_end(reduced.smoother_mut())?.error + constant;

    let divergence = divergence(&full, &reduced)?;
    Ok(format!(
        "| {} | {} | {removed} | {live:.4} | {optimized:.4} | {:.4} | {:.4} | {:.4} | {:.4} | {:.4} |",
        short(file),
        poses.len(),
        full.smoother().error()?,
        divergence.covariance,
        divergence.mean,
        divergence.rms_shift_m,
        divergence.max_shift_m
    ))
}

/// The file's ids of its poses, in the order they come in.
fn poses(document: &Document) -> Result<Vec<u64>, Failure> {
    let mut replayer = replayer(document)?;
    while replayer.step()?.is_some() {}
    let replay = replayer.replay();
    let mut poses: Vec<(VariableId, u64)> =
        replay.ids().filter_map(|(id, _)| Some((replay.pose(id)?, id))).collect();
    poses.sort_unstable();
    Ok(poses.into_iter().map(|(_, id)| id).collect())
}

/// The document without measurements of nodes that are gone by then.
fn without_late(
    document: &Document,
    poses: &[u64],
    gone: &BTreeSet<u64>,
) -> Result<Document, Failure> {
    let place: HashMap<u64, usize> = poses.iter().enumerate().map(|(k, &id)| (id, k)).collect();
    let is_late = |record: &Record| match record {
        Record::Edge { from, to, .. } => match (place.get(from), place.get(to)) {
            (Some(&a), Some(&b)) => a.abs_diff(b) >= LAG && gone.contains(&poses[a.min(b)]),
            _ => false,
        },
        _ => false,
    };
    let lines = document.lines().iter().filter(|line| !is_late(&line.record)).cloned();
    Ok(Document::from_records(document.name(), document.dialect(), lines)?)
}

/// Replays everything, and takes nodes out as soon as they are old enough. How many went, and by what
/// that changed the error.
fn map(
    replayer: &mut Replayer,
    poses: &[u64],
    gone: &BTreeSet<u64>,
) -> Result<(usize, f64), Failure> {
    let mut waiting = poses.iter().enumerate().filter(|(_, id)| gone.contains(id)).peekable();
    let (mut removed, mut constant) = (0, 0.0);
    while replayer.step()?.is_some() {
        let old = |&(place, _): &(usize, &u64)| place + LAG < replayer.poses();
        let due: Vec<u64> =
            std::iter::from_fn(|| waiting.next_if(old)).map(|(_, &id)| id).collect();
        let spared = gauge(replayer);
        for id in due {
            let node = replayer.replay().pose(id).ok_or("a pose that never came")?;
            let smoother = replayer.smoother_mut();
            let plan = Removal::new(smoother.graph(), smoother).sparing(&spared).plan(node)?;
            constant += plan.constant();
            smoother.apply(plan.into_change())?;
            removed += 1;
        }
    }
    Ok((removed, constant))
}
