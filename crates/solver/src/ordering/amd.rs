//! Approximate minimum degree (faer's port of AMD) for graphs too large for rows of bits.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::amd;

use super::groups::Groups;

/// Orders `n` variables, `last` (if given) after all others: it is left out of the graph that AMD
/// sees and appended.
pub(super) fn order(n: usize, groups: &Groups, last: Option<u32>) -> Vec<u32> {
    // Columns of the adjacency matrix, each row once.
    let mut pairs: Vec<(u32, u32)> = Vec::new();
    for group in groups.iter() {
        for &a in group {
            pairs.extend(
                group
                    .iter()
                    .filter(|&&b| b != a && Some(a) != last && Some(b) != last)
                    .map(|&b| (a, b)),
            );
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    let mut column_starts = vec![0_usize; n + 1];
    for &(a, _) in &pairs {
        column_starts[a as usize + 1] += 1;
    }
    for i in 0..n {
        column_starts[i + 1] += column_starts[i];
    }
    let rows: Vec<usize> = pairs.iter().map(|&(_, b)| b as usize).collect();
    let pattern = SymbolicSparseColMatRef::new_checked(n, n, &column_starts, None, &rows);
    let (mut order, mut inverse) = (vec![0_usize; n], vec![0_usize; n]);
    let mut memory = MemBuffer::new(amd::order_scratch::<usize>(n, rows.len()));
    let found = amd::order(
        &mut order,
        &mut inverse,
        pattern,
        amd::Control::default(),
        MemStack::new(&mut memory),
    );
    if found.is_err() {
        // AMD fails only when its index type overflows; any order is right, if not sparse.
        order = (0..n).collect();
    }
    let mut order: Vec<u32> =
        order.into_iter().map(|v| v as u32).filter(|&v| Some(v) != last).collect();
    order.extend(last);
    order
}
