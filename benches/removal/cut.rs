//! Half of the nodes go in the middle of a replay, and the rest of the file comes after.

use std::collections::{BTreeSet, HashMap};
use std::time::Instant;

use evergraph::formats::{Document, Record};
use evergraph::model::VariableId;
use evergraph::removal::{Offset, Options, Recovery, shuffled};
use evergraph::{Replayer, Rules, Thinning, optimize_to_the_end};
use rayon::prelude::*;

use crate::{Failure, divergence, gauge, optimum, read, replayer, short};

const SEED: u64 = 1;

/// What is compared: a name and its options.
fn variants() -> Vec<(&'static str, Options)> {
    let tree = |recovery, offset| Options::tree().with_recovery(recovery).with_offset(offset);
    vec![
        ("dense, gradient", Options::dense()),
        ("GLC, gradient", tree(Recovery::Glc, Offset::KeepGradient)),
        ("GLC, paper offset", tree(Recovery::Glc, Offset::Zero)),
        ("nonlinear, gradient", tree(Recovery::Nonlinear, Offset::KeepGradient)),
        ("nonlinear, paper offset", tree(Recovery::Nonlinear, Offset::Zero)),
        ("composition", tree(Recovery::Composition, Offset::KeepGradient)),
    ]
}

/// Cuts each `FILE:POSES`.
pub fn run(files: &[&str]) -> Result<bool, Failure> {
    println!(
        "| graph | cut at | removed | later edges left out | recovery | KLD covariance | KLD mean | \
         shift, rms m | max m |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for file in files {
        let (file, poses) = file.rsplit_once(':').ok_or("a file to cut needs :POSES")?;
        let poses: usize = poses.parse()?;
        let cut = Cut::of(&read(file)?, poses)?;
        let (full, _) = optimum(&cut.document)?;
        let rows: Vec<Result<String, Failure>> =
            variants().par_iter().map(|(name, options)| cut.row(&full, name, options)).collect();
        for row in rows {
            println!(
                "| {} | {poses} | {} | {} | {} |",
                short(file),
                cut.nodes.len(),
                cut.left_out,
                row?
            );
        }
    }
    Ok(true)
}

/// A file without the measurements that come too late, of nodes that are gone by then.
struct Cut {
    document: Document,
    /// Poses before the cut.
    poses: usize,
    /// The file's ids of what goes.
    nodes: Vec<u64>,
    left_out: usize,
}

impl Cut {
    fn of(document: &Document, poses: usize) -> Result<Self, Failure> {
        let early = up_to(document, poses)?;
        let mut ids: Vec<u64> = early.replay().ids().map(|(id, _)| id).collect();
        ids.sort_unstable();
        let known: BTreeSet<u64> = ids.iter().copied().collect();
        // The first holds the map, the last is what the next is measured from.
        let inner = ids.get(1..ids.len().saturating_sub(1)).ok_or("the cut leaves nothing")?;
        let mut nodes = shuffled(inner, SEED);
        nodes.truncate(ids.len() / 2);
        let gone: BTreeSet<u64> = nodes.iter().copied().collect();
        let too_late = |record: &Record| match record {
            Record::Edge { from, to, .. } => {
                [(from, to), (to, from)].iter().any(|(a, b)| gone.contains(a) && !known.contains(b))
            }
            _ => false,
        };
        let left_out = document.records().filter(|record| too_late(record)).count();
        let lines = document.lines().iter().filter(|line| !too_late(&line.record)).cloned();
        let document = Document::from_records(document.name(), document.dialect(), lines)?;
        Ok(Self { document, poses, nodes, left_out })
    }

    /// Replays to the cut, removes, replays the rest, and compares.
    fn row(&self, full: &Replayer, name: &str, options: &Options) -> Result<String, Failure> {
        let begun = Instant::now();
        let mut reduced = up_to(&self.document, self.poses)?;
        optimize_to_the_end(reduced.smoother_mut())?;
        let variable: HashMap<u64, VariableId> = reduced.replay().ids().collect();
        let nodes: Vec<VariableId> = self.nodes.iter().map(|id| variable[id]).collect();
        let spared = gauge(&reduced);
        let rules = Rules::default().with_options(*options).sparing(&spared);
        let removed = Thinning::run(reduced.smoother_mut(), &nodes, &rules, || ());
        let seconds = || begun.elapsed().as_secs_f64();
        if let Err(error) = removed {
            return Ok(format!("{name} | {error} |  |  | "));
        }
        while reduced.step()?.is_some() {}
        optimize_to_the_end(reduced.smoother_mut())?;
        let divergence = divergence(full, &reduced)?;
        eprintln!("{name}: {:.1} s", seconds());
        Ok(format!(
            "{name} | {:.4} | {:.4} | {:.4} | {:.4}",
            divergence.covariance, divergence.mean, divergence.rms_shift_m, divergence.max_shift_m
        ))
    }
}

/// The replay up to a number of poses.
fn up_to(document: &Document, poses: usize) -> Result<Replayer, Failure> {
    let mut replayer = replayer(document)?;
    while replayer.poses() < poses {
        if replayer.step()?.is_none() {
            return Err(format!("{} has fewer than {poses} poses", document.name()).into());
        }
    }
    Ok(replayer)
}
