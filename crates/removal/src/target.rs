//! The target information: what the removed factors say of the blanket.

use std::cell::OnceCell;
use std::collections::BTreeSet;
use std::ops::Range;

use evergraph_model::{Pose2, Pose3, World};
use nalgebra::{DMatrix, DVector};

use crate::member::Member;
use crate::motion::{carried, pose_of, world_of};
use crate::neighborhood::Neighborhood;
use crate::rank_qr::{RANK_TOLERANCE, back_substitute, column_norms, echelon};

/// The square root `[R_t | d_t]` of the target (section II-A of the GLC paper; equations 12 and 13
/// of the laser paper):
///
/// ```text
/// Λ_t = R_tᵀ R_t = Λ_kk - Λ_km Λ_mm⁻¹ Λ_mk
/// η_t = R_tᵀ d_t = η_k  - Λ_km Λ_mm⁻¹ η_m        η = -Σ Jᵀ r
/// ```
///
/// in the tangents of the blanket where its members are seen, from the estimate on: ξ = 0 there.
#[derive(Clone, Debug)]
pub(crate) struct Target {
    /// The blanket.
    pub(crate) members: Vec<Member>,
    /// First column of each member, and their number at the end.
    pub(crate) offsets: Vec<usize>,
    /// `R_t`, one row per pivot; in row echelon form but for the columns of held members.
    pub(crate) root: DMatrix<f64>,
    pub(crate) rhs: DVector<f64>,
    pub(crate) pivots: Vec<usize>,
    /// Norms of the columns of the whitened Jacobian stack: what ranks are measured by.
    pub(crate) scales: Vec<f64>,
    /// For each world whose common motion no factor sees, the pose that was held.
    pub(crate) held: Vec<(World, usize)>,
    /// `½ ‖d_m‖² = ½ η_mᵀ Λ_mm⁻¹ η_m`: error that goes when the nodes are at their best.
    pub(crate) explained: f64,
    /// Directions of the removed nodes that no factor determines.
    pub(crate) free: usize,
    /// [`right_inverse`](Self::right_inverse), once it has been asked for.
    pub(crate) inverse: OnceCell<DMatrix<f64>>,
}

/// A direction of which this share of a column's norm is known, or less, has its minimum up to
/// `1 / share` away, and computing with that loses the share `ε / share` of every other gradient; left
/// where it is, it loses its own, which is `share` of what the column could have. They are equal at
/// the root of the machine's precision.
const WEAK: f64 = 1e-8;

/// Rows `[A | b]` on some members.
struct Rows {
    members: Vec<usize>,
    matrix: DMatrix<f64>,
}

impl Target {
    /// Eliminates the removed nodes from the whitened stack `[J_m J_k | b]`, `b = -r`:
    ///
    /// ```text
    /// Qᵀ [J_m  J_k | b] = [R_mm  R_mk | d_m]
    ///                     [ 0    R_t  | d_t]
    /// ```
    ///
    /// A group of nodes goes one at a time by minimum degree, each front holding the rows that touch
    /// the node, so that large groups cost what a sparse elimination does. Where a node has a free
    /// direction, `J_m` does not see it and nothing else depends on it.
    ///
    /// When a common motion of the whole clique changes no residual, the columns of one pose are a
    /// combination of the others, `J_1 = -Σ J_k A_k` with A of [`carried`]. In coordinates relative
    /// to that pose its columns are zero, and are made *exactly* that before anything is eliminated;
    /// otherwise rounding leaves a weak prior with every removal, and they add up.
    pub(crate) fn of(neighborhood: &Neighborhood) -> Self {
        let members = &neighborhood.members;
        let removed = neighborhood.removed;
        let dims: Vec<usize> = members.iter().map(|m| m.value.dim()).collect();
        let starts = starts(dims.iter().copied());
        let mut rows: Vec<Rows> = neighborhood
            .factors
            .iter()
            .map(|read| Rows { members: read.members.to_vec(), matrix: read.rows.clone() })
            .collect();
        let scales = stack_norms(&rows, &starts);

        // Hold a pose of each world in which all is relative.
        let mut held = Vec::new();
        for (world, place) in poses(&members[removed..]) {
            let place = removed + place;
            let motions: Vec<_> =
                members.iter().map(|m| carried(&members[place].value, &m.value)).collect();
            if rows.iter().all(|r| is_relative(r, &motions, &starts)) {
                held.push((world, place, motions));
            }
        }
        for (_, place, _) in &held {
            for block in &mut rows {
                if let Some(columns) = block.columns_of(*place, &dims) {
                    block.matrix.columns_mut(columns.start, columns.len()).fill(0.0);
                }
            }
        }

        // Eliminate the nodes.
        let (mut explained, mut free) = (0.0, 0);
        for node in elimination_order(&rows, members.len(), removed) {
            let (front, rest): (Vec<_>, Vec<_>) =
                rows.into_iter().partition(|r| r.members.contains(&node));
            rows = rest;
            let mut order: Vec<usize> = vec![node];
            let others: BTreeSet<usize> =
                front.iter().flat_map(|r| &r.members).copied().filter(|&m| m != node).collect();
            order.extend(others);
            let mut stack = stack(&front, &order, &dims);
            let column_scales = gather(&scales, &order, &starts);
            let pivots = echelon(&mut stack, dims[node], &column_scales);
            let width = stack.ncols() - 1;
            explained += 0.5 * stack.column(width).rows(0, pivots.len()).norm_squared();
            free += dims[node] - pivots.len();
            let mut below = stack
                .view(
                    (pivots.len(), dims[node]),
                    (stack.nrows() - pivots.len(), width + 1 - dims[node]),
                )
                .into_owned();
            order.remove(0);
            // Only what a later front reads again is worth making small first.
            if removed > 1 && below.nrows() > below.ncols() {
                let n = below.ncols();
                let mut scales = column_scales[dims[node]..].to_vec();
                scales.push(0.0);
                let rank = echelon(&mut below, n, &scales).len();
                below = below.rows(0, rank).into_owned();
            }
            rows.push(Rows { members: order, matrix: below });
        }

        // What is left is on the blanket.
        let order: Vec<usize> = (removed..members.len()).collect();
        let mut root = stack(&rows, &order, &dims);
        let scales = gather(&scales, &order, &starts);
        let n = scales.len();
        let pivots = echelon(&mut root, n, &scales);
        let rhs = root.column(n).rows(0, pivots.len()).into_owned();
        let mut target = Self {
            members: members[removed..].to_vec(),
            offsets: starts[removed..].iter().map(|s| s - starts[removed]).collect(),
            root: root.view((0, 0), (pivots.len(), n)).into_owned(),
            rhs,
            pivots,
            scales,
            held: held.iter().map(|&(world, place, _)| (world, place - removed)).collect(),
            explained,
            free,
            inverse: OnceCell::new(),
        };
        for (_, place, motions) in &held {
            target.fill(place - removed, &motions[removed..]);
        }
        target
    }

    /// Writes the columns of a held pose: `R_1 = -Σ R_k A_k`.
    fn fill(&mut self, held: usize, motions: &[Option<DMatrix<f64>>]) {
        let mut columns = DMatrix::zeros(self.rank(), self.dim_of(held));
        for (k, motion) in motions.iter().enumerate() {
            if let (Some(motion), true) = (motion, k != held) {
                columns -= self.root.columns_range(self.columns(k)) * motion;
            }
        }
        self.root.columns_range_mut(self.columns(held)).copy_from(&columns);
    }

    /// Columns of all members together.
    pub(crate) fn dim(&self) -> usize {
        self.scales.len()
    }

    /// Rank of `Λ_t`.
    pub(crate) fn rank(&self) -> usize {
        self.pivots.len()
    }

    pub(crate) fn columns(&self, member: usize) -> Range<usize> {
        self.offsets[member]..self.offsets[member + 1]
    }

    pub(crate) fn dim_of(&self, member: usize) -> usize {
        self.columns(member).len()
    }

    pub(crate) fn is_regular(&self) -> bool {
        self.rank() == self.dim()
    }

    /// A point where the target is least, `R_t d = d_t`. Directions that are hardly known ([`WEAK`])
    /// stay where they are.
    pub(crate) fn minimum(&self) -> DVector<f64> {
        // Columns that waited were taken by the share that was left of them, so the weak are last.
        let weak = |&(row, &column): &(usize, &usize)| {
            self.root[(row, column)].abs() <= WEAK * self.scales[column]
        };
        let last = self.pivots.iter().enumerate().rev().take_while(weak).count();
        back_substitute(&self.root, &self.pivots[..self.rank() - last], self.rhs.as_slice())
    }

    /// `η_t`.
    pub(crate) fn gradient(&self) -> DVector<f64> {
        self.root.tr_mul(&self.rhs)
    }

    /// Whether the target knows nothing of where `member` is in the world: a common motion that
    /// nothing sees can take it anywhere.
    pub(crate) fn is_relative(&self, member: usize) -> bool {
        world_of(self.members[member].value.kind())
            .is_some_and(|world| self.held.iter().any(|held| held.0 == world))
    }

    /// The held poses, in the order of their worlds.
    pub(crate) fn held(&self) -> impl Iterator<Item = usize> {
        self.held.iter().map(|&(_, place)| place)
    }

    /// For a pair of which only the relative position is known, the pose of the two that can be
    /// held, `second` before `first`.
    pub(crate) fn holdable(&self, first: usize, second: usize) -> Option<usize> {
        let world = |m: usize| world_of(self.members[m].value.kind());
        if !self.is_relative(first) || world(first) != world(second) {
            return None;
        }
        let is_pose = |&m: &usize| pose_of(self.members[m].value.kind()).is_some();
        [second, first].into_iter().find(is_pose)
    }
}

/// The first pose of each world among the members: plane, space, then worlds of users by their first pose. The order
/// decides which held pose is the root.
fn poses(members: &[Member]) -> Vec<(World, usize)> {
    let mut found: Vec<(World, usize)> = Vec::new();
    for (place, member) in members.iter().enumerate() {
        if let Some(world) = pose_of(member.value.kind())
            && world.dim() == member.value.dim()
            && found.iter().all(|known| known.0 != world)
        {
            found.push((world, place));
        }
    }
    let (plane, space) = (World::of::<Pose2, 3>(), World::of::<Pose3, 6>());
    // Stable, so that other worlds stay in order.
    found.sort_by_key(|&(world, _)| (world != plane, world != plane && world != space));
    found
}

impl Rows {
    /// The columns of a member in the matrix.
    fn columns_of(&self, member: usize, dims: &[usize]) -> Option<Range<usize>> {
        let place = self.members.iter().position(|&m| m == member)?;
        let start: usize = self.members[..place].iter().map(|&m| dims[m]).sum();
        Some(start..start + dims[member])
    }
}

/// Running sums, from 0.
fn starts(dims: impl Iterator<Item = usize>) -> Vec<usize> {
    let mut starts = vec![0];
    starts.extend(dims.scan(0, |end, dim| {
        *end += dim;
        Some(*end)
    }));
    starts
}

/// A column of a factor counts as no smaller than this share of the factor's largest. What cancels
/// within a factor, as in the columns of the root of a root shift, leaves rounding of the size of the
/// others, which must not be measured by itself. Three orders of magnitude are left for columns of
/// different units.
const WITHIN_A_FACTOR: f64 = 1e-3;

/// Norm of every scalar column of all rows together.
fn stack_norms(rows: &[Rows], starts: &[usize]) -> Vec<f64> {
    let mut norms = vec![0.0_f64; starts[starts.len() - 1]];
    for block in rows {
        let columns = block.members.iter().flat_map(|&m| starts[m]..starts[m + 1]);
        let own = column_norms(&block.matrix, block.matrix.ncols() - 1);
        let floor = WITHIN_A_FACTOR * own.iter().copied().fold(0.0, f64::max);
        for (column, norm) in columns.zip(own) {
            norms[column] = norms[column].hypot(norm.max(floor));
        }
    }
    norms
}

/// Whether a common motion changes none of the rows: `Σ J_k A_k = 0` to the tolerance that ranks
/// are told with, beside the sum of the magnitudes.
fn is_relative(rows: &Rows, motions: &[Option<DMatrix<f64>>], starts: &[usize]) -> bool {
    let directions = motions.iter().flatten().map(|m| m.ncols()).next().unwrap_or(0);
    let (count, mut column) = (rows.matrix.nrows(), 0);
    let mut sum = DMatrix::<f64>::zeros(count, directions);
    let mut size = DMatrix::<f64>::zeros(count, directions);
    for &m in &rows.members {
        let dim = starts[m + 1] - starts[m];
        if let Some(motion) = &motions[m] {
            let block = rows.matrix.columns(column, dim);
            sum += block * motion;
            size += block.abs() * motion.abs();
        }
        column += dim;
    }
    (0..count).all(|i| {
        let floor = WITHIN_A_FACTOR * size.row(i).max();
        let cancels = |j| f64::abs(sum[(i, j)]) <= RANK_TOLERANCE * size[(i, j)].max(floor);
        (0..directions).all(cancels)
    })
}

/// The removed nodes by minimum degree; ties to the lower place.
fn elimination_order(rows: &[Rows], members: usize, removed: usize) -> Vec<usize> {
    if removed == 1 {
        return vec![0];
    }
    let mut neighbors: Vec<BTreeSet<usize>> = vec![BTreeSet::new(); members];
    for block in rows {
        for &a in &block.members {
            neighbors[a].extend(block.members.iter().copied().filter(|&b| b != a));
        }
    }
    let mut queue: BTreeSet<(usize, usize)> =
        (0..removed).map(|m| (neighbors[m].len(), m)).collect();
    let mut order = Vec::with_capacity(removed);
    while let Some((_, node)) = queue.pop_first() {
        order.push(node);
        let clique = std::mem::take(&mut neighbors[node]);
        for &a in &clique {
            let degree = neighbors[a].len();
            neighbors[a].extend(clique.iter().copied().filter(|&b| b != a));
            neighbors[a].remove(&node);
            if a < removed {
                queue.remove(&(degree, a));
                queue.insert((neighbors[a].len(), a));
            }
        }
    }
    order
}

/// Rows under each other, columns of the members in `order` and the right-hand side.
fn stack(rows: &[Rows], order: &[usize], dims: &[usize]) -> DMatrix<f64> {
    let count = rows.iter().map(|r| r.matrix.nrows()).sum();
    let firsts = starts(order.iter().map(|&m| dims[m]));
    let width = firsts[order.len()];
    // Where each member stands; `order` has every member of the rows.
    let mut column_of = vec![usize::MAX; dims.len()];
    order.iter().zip(&firsts).for_each(|(&m, &first)| column_of[m] = first);
    let mut stack = DMatrix::zeros(count, width + 1);
    let mut top = 0;
    for block in rows {
        let height = block.matrix.nrows();
        let mut source = 0;
        for (column, dim) in
            block.members.iter().map(|&m| (column_of[m], dims[m])).chain([(width, 1)])
        {
            stack
                .view_mut((top, column), (height, dim))
                .copy_from(&block.matrix.columns(source, dim));
            source += dim;
        }
        top += height;
    }
    stack
}

fn gather(scales: &[f64], order: &[usize], starts: &[usize]) -> Vec<f64> {
    order.iter().flat_map(|&m| scales[starts[m]..starts[m + 1]].iter().copied()).collect()
}
