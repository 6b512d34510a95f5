//! The order in which a file was recorded, from its content.

use smallvec::SmallVec;

use crate::options::Order;
use crate::order::{Link, Node};

/// The order of a file, from its content. `has_order` says whether lines of its dialect are written as
/// they are recorded.
pub(crate) fn order_of(links: &[Link], nodes: &[Node], has_order: bool) -> Order {
    if links.iter().any(|link| link.time.is_some()) {
        return Order::Times;
    }
    if !has_order {
        return Order::Ids;
    }
    let (late, closures) = late_closures(links, nodes);
    if 2 * late > closures { Order::IdsForLateEdges } else { Order::Lines }
}

/// Of the measurements that name no new pose: those of which no pose is the newest at their line, although
/// a robot would have gone on by then; and all of them.
fn late_closures(links: &[Link], nodes: &[Node]) -> (usize, usize) {
    let poses = |link: &Link| -> SmallVec<[usize; 2]> {
        link.ends.iter().copied().filter(|&end| nodes[end].kind.is_pose()).collect()
    };
    let mut is_known = vec![false; nodes.len()];
    let (mut newest, mut late, mut closures) = (None, 0, 0);
    for ends in links.iter().map(poses).filter(|ends| !ends.is_empty()) {
        let new: SmallVec<[usize; 2]> =
            ends.iter().copied().filter(|&end| !is_known[end]).collect();
        if let Some(&last) = new.last() {
            newest = Some(last);
            new.iter().for_each(|&end| is_known[end] = true);
        } else {
            closures += 1;
            late += usize::from(!ends.iter().any(|&end| Some(end) == newest));
        }
    }
    (late, closures)
}
